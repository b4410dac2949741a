"""Rows of a comparison: one camera each, how good it is, and the hardware that it requires."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import Unquoted, require, three_digits
from mishutter.design.design import Design
from mishutter.evaluation.losses import AbstractLoss
from mishutter.evaluation.metrics import Metrics, SequenceMetrics
from mishutter.evaluation.speed_knowledge import (
    KNOWN_SPEED,
    UNKNOWN_SPEED,
    SpeedKnowledge,
    knowledge_of,
)
from mishutter.model.devices import least_efficiency
from mishutter.model.exposures import Exposures
from mishutter.model.frame_path import AT_REST
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.polynomials import profile_of
from mishutter.model.shutters.windows import RectShutter
from mishutter.search.frame_ties import FREE, SIMPLEST_FIRST

Choice = TypeVar("Choice")
"""Exposures along an axis, or in the plane."""

BEST_SNAPSHOT = "best snapshot"
BEST_PANNED_SNAPSHOT = "best panned snapshot"
SNAPSHOTS = (BEST_SNAPSHOT, BEST_PANNED_SNAPSHOT)
SAME_MOTION = "same motion"
OWN_BEST_MOTION = "own best motion"
STAGE, SHUTTER, FRAMES = "a stage", "a shutter", "a burst of frames"
SECOND_AXIS, TURNS = "a second axis of the stage", "a turning camera"
"""Parts that a camera may require beside a sensor at rest with an ordinary shutter."""
_NEEDS = {
    FRAMES: "registration",
    STAGE: "stage",
    SECOND_AXIS: "stage of two axes",
    SHUTTER: "shaped shutter",
    TURNS: "turning camera",
}
"""The needs of these parts in words: any camera takes frames, and software registers."""
ONE_EXPOSURE = frozenset({STAGE, SHUTTER})
"""Parts that a camera of one exposure may require."""
_PURCHASES = {
    frozenset[str](): "nothing",
    frozenset({STAGE}): "a stage",
    frozenset({SHUTTER}): "a shutter",
    frozenset({STAGE, SHUTTER}): "both",
}
LEAST_SHOWN = 0.005
"""Least difference of levels that two decimals show; dB."""
_SAME_SHARE = 0.005
"""Share by which exposures, and the light over them, of one camera may differ in two searches."""
WORTH_IT = 0.2
"""Gain over a simpler camera below which another is not worth what it needs; dB."""
_NUM_TIMES = 512
"""Times of an exposure at which two cameras are compared."""


@dataclass(frozen=True)
class Row:
    """One camera: its exposures, and how good they are."""

    reading: str  # `"same motion"` or `"own best motion"`
    name: str  # Name of the shutter, or of the way of its frames
    exposures: Exposures  # What it takes
    loss: float | None  # Value of the loss that tuned it; None on the same motion
    # Its metrics; of a burst those that a decoder has which registers its frames
    metrics: Metrics | SequenceMetrics
    decoder: SpeedKnowledge = UNKNOWN_SPEED  # Knowledge of the speed that the judging decoder has
    # Whether it is judged at the worst speed, and not by the mean over speeds
    at_worst: bool = False
    # The design that a search found; None for the reading *same motion* and for a burst
    design: Design | None = None
    hardware: frozenset[str] = ONE_EXPOSURE  # Parts that cameras of its kind may require

    def __repr__(self) -> str:
        """The name and the level; the table has the rest."""
        return f"Row({self.reading!r}, {self.name!r}, {self.level:.2f} dB, {self.setting})"

    @property
    def sequence(self) -> Exposures | None:
        """The frames of a burst, and any exposures in the plane; None of one exposure."""
        return self.exposures if self.exposures.shutter is None else None

    @property
    def motion(self) -> AbstractMotion:
        """The motion over the one exposure, of a row without a `sequence`."""
        return self._one.motion

    @property
    def shutter(self) -> AbstractShutter:
        """The profile of the one exposure, of a row without a `sequence`."""
        return self._one.shutter  # type: ignore[return-value]

    @property
    def _one(self) -> Exposures:
        is_one, got = self.exposures.shutter is not None, Unquoted(self.exposures.kind)
        require(is_one, "Row(exposures=...)", "be of one exposure along an axis", got)
        return self.exposures

    @cached_property
    def stroke(self) -> float:
        """Distance from the lowest to the highest position of the stage; px.

        It is that over the exposure or over a burst, with the pan, unless turning the camera makes
        that.
        """
        return self.exposures.stroke

    @cached_property
    def required_hardware(self) -> frozenset[str]:
        """Parts that are needed in addition to a camera at rest with an ordinary shutter.

        A stage that stands still and a shutter that stays open are not needed.
        """
        efficiency = np.asarray(self.metrics.efficiency)
        is_open = efficiency >= min(1 - 1e-6, least_efficiency(efficiency.dtype))
        stays = self.stroke < AT_REST
        idle = {STAGE: stays, SECOND_AXIS: stays, SHUTTER: is_open}
        return frozenset(part for part in self.hardware if not idle.get(part, False))

    @cached_property
    def parts(self) -> frozenset[str]:
        """The same, with a camera that turns where that makes the pan."""
        turns = bool(np.any(self.exposures.pan)) and (self.sequence is not None or self.pans)
        return self.required_hardware | ({TURNS} if turns else set())

    @cached_property
    def needs(self) -> tuple[str, ...]:
        """Its parts in words."""
        parts = self.parts - {STAGE} if SECOND_AXIS in self.parts else self.parts
        return tuple(words for part, words in _NEEDS.items() if part in parts)

    @property
    def is_in_plane(self) -> bool:
        """Whether its sensor moves along rows and columns."""
        return self.exposures.in_plane

    @property
    def is_free(self) -> bool:
        """Whether its sensor follows a path of no constant acceleration."""
        if self.is_in_plane:
            return self.exposures.kind == FREE
        return not all(frame.motion.accelerates_constantly for frame in self.exposures.along)

    @property
    def is_straight(self) -> bool:
        """Whether its sensor is at rest, or pans at a constant velocity."""
        if self.is_in_plane:
            return not self.exposures.moves
        return all(frame.motion.is_straight for frame in self.exposures.along)

    @property
    def rank(self) -> tuple[int, int, int]:
        """Rows in the order of what they need: software before hardware, then simple paths."""
        path = 0 if self.is_straight else 2 if self.is_free else 1
        if self.is_in_plane:
            path = SIMPLEST_FIRST.index(self.exposures.kind)
        return len(self.parts - {FRAMES}), len(self.parts), path

    @property
    def num_frames(self) -> int:
        """Number of frames, which are registered."""
        return self.exposures.num_frames

    @property
    def is_of_one_exposure(self) -> bool:
        """Whether it is a camera of one exposure, and no burst."""
        return FRAMES not in self.hardware

    @property
    def pans(self) -> bool:
        """Whether the pan of one exposure is more than counts as standing still."""
        if self.sequence is not None:
            return False
        return abs(float(self.motion.velocity)) * float(self.motion.exposure) >= AT_REST

    @property
    def pan_words(self) -> str:
        """The velocity of one exposure at its middle; px/s."""
        velocity = float(self.motion.velocity)
        return f"{velocity:,.0f}" if abs(velocity) >= 100 else f"{velocity:.3g}"

    @cached_property
    def kind(self) -> tuple[bool, bool]:
        """Whether the sensor follows another path than a parabola, and whether a shutter is made.

        Of rows that require the same parts, one of a lesser kind is simpler.
        """
        is_open = self.sequence is not None or isinstance(self.shutter, RectShutter)
        return self.is_free, not is_open

    @cached_property
    def _course(
        self,
    ) -> "tuple[Float[np.ndarray, 'times'], Float[np.ndarray, 'axes frames times']]":
        """Transmittance, and position of the sensor in px, over each exposure.

        The times lie inside: windows that jump at their ends may have either value there.
        """
        tau = (np.arange(_NUM_TIMES) + 0.5) * 2 / _NUM_TIMES - 1
        if self.sequence is None:
            half = self.motion.half_exposure
            tau = tau.astype(half.dtype)
            place = np.asarray(self.motion.position(tau * half))[None, None]
            return profile_of(self.shutter, tau)[0], place
        begin, end = np.transpose(self.exposures.lights)[..., None]
        times = begin + (end - begin) * (tau + 1) / 2
        return np.ones_like(tau), self.exposures.place(times)

    def is_same_camera_as(self, other: "Row") -> bool:
        """Whether another row is this camera: two searches may end in one place.

        It passes the same light on the same path, and has the same level by the same decoder.
        """
        kinds = [(each.num_frames, each.is_in_plane) for each in (self, other)]
        if kinds[0] != kinds[1]:
            return False
        own, others = (np.array([x.exposures, x.times]) for x in (self.exposures, other.exposures))
        if np.any(np.abs(own - others) > _SAME_SHARE * own[0]):
            return False
        if abs(self.margin_over(other)) >= LEAST_SHOWN:
            return False
        (light, path), (other_light, other_path) = self._course, other._course
        is_light_alike = np.abs(light - other_light).sum() <= _SAME_SHARE * light.sum()
        return bool(is_light_alike and np.abs(path - other_path).max() < AT_REST)

    @property
    def level(self) -> float:
        """Expected PSNR that judges it, within the tolerances of a scene that has any; dB."""
        return self.psnr if self.within is None else self.within

    @property
    def within(self) -> float | None:
        """Expected PSNR within the tolerances of the scene; dB.

        None for a scene without tolerances, and where a decoder that knows the speed, or the worst
        speed, judges: these judge the camera as designed.
        """
        level = None if self.at_worst else self.decoder.toleranced_psnr(self.metrics)
        return None if level is None else float(level)

    @property
    def psnr(self) -> float:
        """Expected PSNR of the camera as designed, by the judging decoder; dB."""
        worst = self.worst_psnr if self.at_worst else None
        return float(self.decoder.psnr(self.metrics)) if worst is None else worst

    @property
    def hides_speed(self) -> bool:
        """Whether the decoder looks for a speed that would gain something, and gains nothing."""
        if not self.decoder.finds_speed:
            return False
        unknown, known = (float(x.psnr(self.metrics)) for x in (UNKNOWN_SPEED, KNOWN_SPEED))
        return self.psnr <= unknown < known

    @property
    def worst_psnr(self) -> float | None:
        """PSNR at the worst speed by the judging decoder; None if it finds the speed; dB."""
        level = self.decoder.worst_psnr(self.metrics)
        return None if level is None else float(level)

    @property
    def setting(self) -> str:
        """Exposure, pan and stroke of the motion with units; a pan alone is without its stroke."""
        if self.sequence is not None:
            return self.sequence.setting
        motion = self.motion
        parts = [f"{three_digits(float(motion.exposure) * 1e3)} ms"]
        if self.pans:
            parts.append(f"pan {self.pan_words} px/s")
        if float(motion.sag) >= AT_REST:
            parts.append(f"stroke {self.stroke:.3g} px")
        return ", ".join(parts if len(parts) > 1 else [*parts, "at rest"])

    def judged_by(self, loss: AbstractLoss, scene: Scene) -> "Row":
        """The row as the decoder that a loss, or else a scene, names judges it."""
        return replace(self, decoder=knowledge_of(scene, loss), at_worst=loss.of_worst_speed)

    def margin_over(self, other: "Row") -> float:
        """Level above that of another row; 0 over itself, also where it is infinite; dB."""
        return 0.0 if self is other else self.level - other.level


def cameras_of(rows: Iterable[Row]) -> list[list[Row]]:
    """Rows of one reading, those that are the same camera together, in the order of their first."""
    cameras: list[list[Row]] = []
    for row in rows:
        same = next((each for each in cameras if each[0].is_same_camera_as(row)), None)
        if same is None:
            cameras.append([row])
        else:
            same.append(row)
    return cameras


def best_row(rows: Iterable[Row]) -> Row:
    """The row of the highest level: the simplest of equals, which no rounding tells apart."""
    every = list(rows)
    most = max(row.level for row in every)
    # Two searches that ended in one place differ by less than 1e-4 dB; an infinite level is equal.
    best = [row for row in every if row.level == most or most - row.level < 1e-4]
    return min(best, key=lambda row: (len(row.required_hardware), row.kind))


def choice_of(rows: Iterable[Row], own: Iterable[str] = ()) -> Row:
    """The row to take, by `simplest_of`.

    Of rows that are equally simple an ordinary snapshot comes first, at rest and then panned, then
    one of the user's.
    """
    order = {name: 2 for name in own} | {name: place for place, name in enumerate(SNAPSHOTS)}
    return simplest_of((row.level, (*row.rank, order.get(row.name, 3)), row) for row in rows)


def simplest_of(options: "Iterable[tuple[float, tuple[int, ...], Choice]]") -> "Choice":
    """The best of some options, or what is simpler and less than `WORTH_IT` below it.

    A simpler option that is that close replaces the one before until there is none: whatever is
    taken is worth what it needs beside each simpler one.
    """
    options = list(options)
    level, rank, top = max(options, key=lambda each: each[0])
    while True:
        near = [each for each in options if each[1] < rank and level - each[0] < WORTH_IT]
        if not near:
            return top
        level, rank, top = min(near, key=lambda each: (each[1], -each[0]))


def best_snapshot_of(rows: Iterable[Row]) -> Row:
    """The best snapshot that a scene allows, at rest or panned, among rows at their own motions."""
    own = (row for row in rows if row.reading == OWN_BEST_MOTION)
    return best_row(row for row in own if row.name in SNAPSHOTS)


def gain_over(level: float, other: float) -> float:
    """Gain of a level over another; dB. Equal ones, infinite too, have none, where `-` has NaN."""
    return 0.0 if level == other else level - other


def best_of_each_purchase(rows: Iterable[Row]) -> dict[str, Row]:
    """The best row of each purchase, the least first; no burst, which is another camera.

    The best row of a purchase is the best of all rows that need no more parts, and the simplest of
    equals: whoever has bought more may use less of it.
    """
    rows = [row for row in rows if row.reading == OWN_BEST_MOTION]
    return {
        name: best_row(enough)
        for parts, name in _PURCHASES.items()
        for enough in [[row for row in rows if row.required_hardware <= parts]]
        if any(row.required_hardware == parts for row in enough)
    }
