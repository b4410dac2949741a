"""Frames that a camera takes one after the other, and the path of its sensor through them.

They are said in two ways: a `TimedFrame` is an exposure along one axis, and the limits of a stage
say how it goes from one to the next; a `FramePath` is the whole path along one axis or two.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import as_numpy, namespace_of
from mishutter._core.modules import AbstractModule
from mishutter.model.limits import Limits
from mishutter.model.motion import AbstractMotion
from mishutter.model.stages import Knots, Piece, StagePath, StageUse, led

AT_REST = 0.05
"""Travel over an exposure below which its sensor counts as standing still; px."""
Lights = list[tuple[float, float]]
"""First and last light of exposures; s."""
SINE = "sine"
"""Kind of a sequence whose stage follows a sine between its frames too."""
SINGLE = 1e-5
"""Share of a number below which it is one of rounding, in single precision."""
_DIRECTIONS = np.arange(16) * np.pi / 16
"""Directions along which two axes keep a limit together."""


@partial(
    jax.tree_util.register_dataclass, data_fields=("motion", "time", "position"), meta_fields=()
)
@dataclass(frozen=True)
class TimedFrame:
    """An exposure of an open shutter, one of a sequence; all its numbers may be differentiated.

    Attributes:
        motion: Motion of the sensor, from its mid-exposure.
        time: Mid-exposure, from the middle of the sequence; s.
        position: Position of the sensor at mid-exposure, in a camera that pans; px.
    """

    motion: AbstractMotion
    time: float | Array
    position: float | Array = 0.0

    @property
    def exposure(self) -> float:
        """Time from its first to its last light; s."""
        return float(self.motion.exposure)

    @property
    def is_still(self) -> bool:
        """Whether its sensor stands still."""
        return float(self.motion.stroke) < AT_REST


@final
class FramePath(AbstractModule):
    """Frames of an open shutter, one after the other, and the path of the sensor through them.

    It has pieces of constant acceleration from the first light of any row to the last, along one
    axis or along rows and columns. All numbers may be differentiated.

    Attributes:
        times: Mid-exposures, ascending; s, shape `(n,)`.
        exposures: Exposures, of which 0 is no frame; s, shape `(n,)`.
        durations: Durations of the pieces, of which some may be 0; s, shape `(p,)`.
        velocities: Velocities along each axis at their ends; px/s, shape `(axes, p + 1)`.
        lead: Time by which the path begins before the first light, and ends after the last, for
            rows that are exposed earlier and later; s.
        jerks: Jerks of the pieces of a path along one axis; px/s^3, shape `(p,)`. None where the
            acceleration is constant in each.
    """

    times: Float[Array | np.ndarray, "n"]
    exposures: Float[Array | np.ndarray, "n"]
    durations: Float[Array | np.ndarray, "p"]
    velocities: Float[Array | np.ndarray, "axes p+1"]
    lead: float = eqx.field(static=True, default=0.0)
    jerks: Float[np.ndarray, "p"] | None = None

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return self.times.shape[0]

    @property
    def duration(self) -> float:
        """Time from the first light to the last; s, of concrete frames."""
        ends = np.asarray(self.times) + np.asarray(self.exposures) / 2
        return float(ends[-1] - self._begin)

    @property
    def _begin(self) -> Array | np.ndarray | np.floating:
        return self.times[0] - self.exposures[0] / 2

    def for_rows(self, readout: float, limits: Limits) -> "FramePath":
        """Known frames, with a path that goes on while rows are exposed earlier and later.

        It does not go on where the stage would leave its limits so: then the first and the last
        rows see how it comes from rest, and goes back to it.

        Args:
            readout: Time from the first row to the last; s.
            limits: Those of the stage.
        """
        if self.lead or self.stays or not readout:
            return self
        durations, velocities, _ = led(*self._known, readout / 2)
        going_on = replace(self, durations=durations, velocities=velocities, lead=readout / 2)
        use = going_on.use(limits)
        if limits.have_room_for(travel=float(use.travel), stroke=float(use.stroke)):
            return going_on
        knots = self.knots(limits)
        rest = max(readout / 2 - float(min(knots.durations[0], knots.durations[-1])), 0.0)
        ends = np.zeros((len(knots.velocities), 1))
        return replace(
            self,
            durations=np.r_[rest, knots.durations, rest],
            velocities=np.hstack([ends, knots.velocities, ends]),
            lead=rest + float(knots.durations[0]),
        )

    def place(
        self, time: Float[Array | np.ndarray, "*shape"]
    ) -> Float[Array | np.ndarray, "axes *shape"]:
        """Place of the sensor, from that at the begin of the path; px.

        Args:
            time: Time on the clock of `times`; s.
        """
        d, v, time, begin = as_numpy(self.durations, self.velocities, time, self._begin - self.lead)
        space = namespace_of(d, v, time, begin)
        ends = space.concatenate([space.zeros_like(d[:1]), space.cumsum(d)])
        places = Knots(d[None], v, self.jerks, 0, d.size).positions
        since = space.asarray(time, d.dtype) - begin
        piece = space.searchsorted(ends, since.ravel(), side="right").reshape(since.shape) - 1
        piece = space.clip(piece, 0, d.size - 1)
        lasts = d[piece]
        # Pieces without a length meet no time but one at their end.
        elapsed = since - ends[piece]
        share = elapsed / space.where(lasts > 0, lasts, 1.0)
        start, end = v[:, piece], v[:, piece + 1]
        share, elapsed = share[None], elapsed[None]
        way = start + share * (end - start) / 2
        if self.jerks is not None:
            way = way + (self.jerks * d * d / 2)[piece] * share * (share / 3 - 0.5)
        return places[:, piece] + elapsed * way

    @property
    def _known(self) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "axes p+1"]]:
        """Its pieces, of a concrete path."""
        return np.asarray(self.durations, np.float64), np.asarray(self.velocities, np.float64)

    @property
    def top_speed(self) -> float:
        """Greatest speed of the sensor; px/s, of concrete frames."""
        return float(np.max(np.linalg.norm(self._known[1], axis=0)))

    @property
    def bends(self) -> Float[np.ndarray, "k"]:
        """Times at which its velocity or its acceleration jumps; s, of a concrete path."""
        begin = float(self._begin) - self.lead
        return begin + np.append(0.0, np.cumsum(self._known[0]))

    @property
    def stays(self) -> bool:
        """Whether the sensor stands still in all frames; of concrete frames."""
        return self.top_speed * float(np.max(np.asarray(self.exposures))) < AT_REST

    def knots(self, limits: Limits) -> Knots:
        """The way from rest to rest, along each axis.

        The stage runs up straight to the velocity of the first light, at the greatest acceleration
        of the limits; at once where they have none.

        Args:
            limits: Those of the stage.
        """
        durations, velocities = self._known
        most = math.inf if limits.max_acceleration is None else float(limits.max_acceleration)
        times = [
            float(np.linalg.norm(v, math.inf if limits.axes == "each" else 2)) / most
            for v in (velocities[:, 0], velocities[:, -1])
        ]
        rest = np.zeros((len(velocities), 1))
        durations = np.r_[times[0], durations, times[1]]
        last = durations.size - 1
        return Knots(durations, np.hstack([rest, velocities, rest]), None, 1, last)

    def use(self, limits: Limits) -> StageUse:
        """The demands on each axis of a stage, or on both together where limits are of a disc.

        Args:
            limits: Those of the stage.
        """
        knots = self.knots(limits)
        if len(knots.velocities) == 1:
            return knots._replace(velocities=knots.velocities[0]).use
        angles = _DIRECTIONS if limits.axes == "disc" else np.array([0.0, np.pi / 2])
        if limits.axes == "one":
            x, y = knots.velocities[:, np.argmax(np.hypot(*knots.velocities))]
            angles = np.array([math.atan2(y, x)])
        units = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        if limits.axes == "disc":  # between two directions there may be that much more
            units = units / np.cos(_DIRECTIONS[1] / 2)
        use = knots._replace(velocities=units @ knots.velocities).use
        return StageUse(*(np.max(each) for each in use))

    def acceleration(self, limits: Limits) -> float:
        """Greatest acceleration of an axis or of both, infinite where a velocity jumps; px/s^2.

        Args:
            limits: Those of the stage.
        """
        gains = np.diff(np.asarray(self.velocities))
        size = np.linalg.norm(gains, math.inf if limits.axes == "each" else 2, axis=0)
        d = np.asarray(self.durations)
        if np.any(size[d == 0] > 0):
            return math.inf
        return float(np.max(size[d > 0] / d[d > 0], initial=0.0))

    def stage_paths(self, limits: Limits) -> list[StagePath]:
        """The paths of the stage along each axis, each about the middle of its travel.

        Args:
            limits: Those of the stage.
        """
        most = limits.max_acceleration
        most = self.acceleration(limits) if most is None else float(most)
        if self.stays or not 0 < most < math.inf:
            return []
        knots, paths = self.knots(replace(limits, max_acceleration=most)), []
        for velocities, places in zip(knots.velocities, knots.positions, strict=True):
            begin = float(places[knots.first] - (np.min(places) + np.max(places)) / 2)
            along = knots._replace(velocities=velocities)
            paths.append(along.path(float(self._begin) - self.lead, begin))
        return paths


PlaneFrames = FramePath
"""The public name of a path in the plane."""
Frames = Sequence[TimedFrame] | FramePath
"""Exposures of an open shutter, along one axis or in the plane."""


def num_frames_of(frames: Frames) -> int:
    """Number of exposures."""
    return frames.num_frames if isinstance(frames, FramePath) else len(frames)


def from_rest(way: float, gap: float, end: float, ups: list[Piece]) -> list[Piece] | None:
    """From a frame at rest, as late as a run-up or a constant acceleration lets the stage start."""
    if not way and not end:
        return [Piece(gap, 0.0)]
    knots = Knots.of(0.0, ups)
    duration, place = float(np.sum(knots.durations)), float(knots.positions[-1])
    # Numbers of frames may be those of single precision.
    if abs(place - way) <= SINGLE * abs(way) and duration <= gap * (1 + SINGLE):
        return [Piece(max(gap - duration, 0.0), 0.0), *ups]
    rise = 2 * way / end if end else 0.0
    if rise > 0 and duration <= rise <= gap:
        return [Piece(gap - rise, 0.0), Piece(rise, end)]
    return None


def along_sine(
    way: float, gap: float, speed: float, half: float, *, pan: float, end: float
) -> list[Piece]:
    """On from a frame along the sine about whose turning points the frames are."""
    # The frames end at the same speed on both sides of the fastest point.
    steps = sine_between(half, gap) * speed
    step = gap / (steps.size + 1)
    share = ((way - pan * gap) - step * speed) / (step * np.sum(steps))
    return [*(Piece(step, pan + share * each) for each in steps), Piece(step, end)]


def sine_between(half: float, gap: float) -> Float[np.ndarray, "n"]:
    """Velocities at equal steps between two frames about the turning points of a sine.

    They are over the velocity at the ends of the frames.
    """
    period, num_pieces = gap + 2 * half, 32
    times = half + gap * np.arange(1, num_pieces) / num_pieces
    return np.sin(np.pi * times / period) / np.sin(np.pi * half / period)
