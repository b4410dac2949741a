"""Frames of a sensor at rest or on a known path, and their noise."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from mishutter.evaluation.instants import NODES, Instants
from mishutter.model.frame_path import AT_REST
from mishutter.pictures.registration.windows import splines

_ALIKE = 1.3
"""Exposures that blur a thing alike: the longest over the shortest of them."""
_MIDDLE = 0.3
"""Level at which frames are weighed."""
_DARKEST = 0.002
"""Level below which noise is taken to be that of this level, as counts below 0 say nothing."""

Level = np.ndarray | np.floating | float
"""Levels of pixels, of any shape; white = 1."""


class Part(NamedTuple):
    """A part of an exposure, in which the sensor keeps its velocity.

    All of the exposure where the sensor is at rest. Where it moves, one so short that no layer
    moves by much: what hides a layer that is blurred then hides it as a whole.
    """

    frame: int
    share: float  # Of the exposure
    time: float  # Its middle; s
    duration: float  # s
    place: Float[np.ndarray, "2"]  # Of the sensor in the mean, down and across; px
    velocity: Float[np.ndarray, "2"]  # Of the sensor; px/s

    def way(self, velocity: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        """Way of a thing on the sensor since the time 0; px."""
        return self.place + velocity * self.time

    def blur(self, velocity: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        """Way of a thing on the sensor within it; px."""
        return (velocity + self.velocity) * self.duration


@dataclass(frozen=True, eq=False)
class Stills:
    """Frames of a sensor at rest, or on a known path, in which things move.

    A thing of the velocity `v`, down and across, is at `p + c + v t` where it is at `p` at the time
    0, that of the picture, and the sensor displaces all by `c`.
    """

    light: Float[np.ndarray, "frames rows columns"]  # White = 1
    times: Float[np.ndarray, "frames"]  # Mid-exposures; s
    exposures: Float[np.ndarray, "frames"]  # s
    electrons: Float[np.ndarray, "frames"]  # Photo-electrons of a white pixel
    read_noise: float  # e-
    fastest: float  # Greatest speed; px/s
    moves: tuple[bool, bool]  # Whether things move down the columns, and across them
    # The sensor's places, down and across, in panels of each exposure; None of one at rest
    instants: Instants | None = None
    parts: tuple[Part, ...] = field(init=False)  # Of all frames, in their order

    def __post_init__(self) -> None:
        object.__setattr__(self, "parts", tuple(self._parts()))

    def _parts(self) -> list[Part]:
        parts, none = [], np.zeros(2)
        for k, (time, exposure) in enumerate(zip(self.times, self.exposures, strict=True)):
            alone, instants = Part(k, 1.0, float(time), float(exposure), none, none), self.instants
            if instants is None:
                parts.append(alone)
                continue
            time, place, weight, _ = instants.some(k)
            if np.max(np.ptp(place, axis=1)) < AT_REST:
                parts.append(alone._replace(place=place @ weight))
                continue
            panels = (x.reshape(-1, NODES) for x in (time, weight, *place))
            for t, w, *at in zip(*panels, strict=True):
                share = float(np.sum(w))
                if share > 0:
                    middle, centre = w @ t / share, np.array([w @ x for x in at]) / share
                    late = w * (t - middle)
                    velocity = np.array([late @ x for x in at]) / (late @ t)
                    lasting = share * float(exposure)
                    parts.append(Part(k, share, float(middle), lasting, centre, velocity))
        return parts

    @cached_property
    def coefficients(self) -> Float[np.ndarray, "frames rows columns"]:
        """Coefficients of the splines through the frames."""
        return splines(self.light)

    @property
    def rests(self) -> Bool[np.ndarray, "frames"]:
        """Whether the sensor stands still in each frame."""
        moving = {part.frame for part in self.parts if np.any(part.velocity)}
        return np.array([k not in moving for k in range(self.count)])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.light.shape[1], self.light.shape[2]

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.times)

    @property
    def middle(self) -> int:
        """The frame nearest to the time 0; the shortest of two. One at rest, if there is any."""
        return int(np.lexsort((self.exposures, np.round(np.abs(self.times), 9), ~self.rests))[0])

    @property
    def span(self) -> float:
        """Time from the first frame to the last; s."""
        return float(np.ptp(self.times))

    @property
    def exposure(self) -> float:
        """Mean exposure; s."""
        return float(np.mean(self.exposures))

    def ways(self, velocity: Float[np.ndarray, "2"]) -> Float[np.ndarray, "frames 2"]:
        """Mean way of a thing since the time 0, in each frame; px."""
        ways = self.times[:, None] * velocity
        for part in self.parts:
            ways[part.frame] += part.share * part.place
        return ways

    def noise(self, level: Level, frame: int) -> Level:
        """Variance of a pixel of some level in a frame."""
        return self._noise(level, float(self.electrons[frame]))

    def typical_noise(self, level: Level) -> Level:
        """The same of a frame that is as good as the frames are in the mean."""
        each, counts = np.unique(self.electrons, return_counts=True)
        pairs = zip(each.tolist(), counts.tolist(), strict=True)
        return self.count / sum(count / self._noise(level, one) for one, count in pairs)

    def _noise(self, level: Level, electrons: float) -> Level:
        return np.maximum(level, _DARKEST) / electrons + (self.read_noise / electrons) ** 2

    @property
    def weights(self) -> Float[np.ndarray, "frames"]:
        """Worth of each frame beside that of a typical one, at a middle level."""
        level = np.float64(_MIDDLE)
        each = np.array([float(self.noise(level, k)) for k in range(self.count)])
        return float(self.typical_noise(level)) / each

    def only(self, chosen: Bool[np.ndarray, "frames"]) -> "Stills":
        """Some of the frames."""
        return replace(
            self,
            light=self.light[chosen],
            times=self.times[chosen],
            exposures=self.exposures[chosen],
            electrons=self.electrons[chosen],
            instants=None if self.instants is None else self.instants.some(chosen),
        )

    @property
    def alike(self) -> Bool[np.ndarray, "frames"]:
        """The frames in which things are looked for.

        Those of one exposure blur a thing alike, the shortest least. Two tell a velocity, and four
        make it clear what hides what.
        """
        shortest = np.sort(self.exposures)
        groups = [self._of(each) for each in shortest.tolist()]
        for least in (4, 3, 2):
            for group in groups:
                if group.sum() >= min(least, self.count):
                    return group
        return np.ones(self.count, bool)

    def _of(self, exposure: float) -> Bool[np.ndarray, "frames"]:
        is_alike = (self.exposures >= exposure * 0.999) & (self.exposures <= exposure * _ALIKE)
        places = self.ways(np.zeros(2))
        beside = np.max(np.abs(places - places[self.middle]), axis=1)
        return is_alike & self.rests & (beside < AT_REST)
