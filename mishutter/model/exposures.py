"""Exposures of one picture, one or more in their order: what a camera takes, of whatever path."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, takewhile
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mishutter._core.checks import (
    Numbers,
    Unquoted,
    all_concrete,
    in_digits,
    require,
    require_known,
    three_digits,
)
from mishutter._core.slopes import largest_of
from mishutter.model.frame_path import (
    SINE,
    FramePath,
    Frames,
    Lights,
    TimedFrame,
    TimedFrames,
    frames_in,
)
from mishutter.model.limits import Limits
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_one_axis, require_scene, require_velocities
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.windows import RectShutter
from mishutter.model.stages import StagePath, StageUse
from mishutter.model.velocities import AbstractVelocities

ONE_EXPOSURE = "one exposure"
"""Kind of an exposure alone, which may have a shaped shutter."""
_MOST_NAMED = 3
"""Different exposures that are named one by one."""
_MOST_LISTED = 6
"""Most frames whose exposures are said in their order, where long and short ones take turns."""


@final
@dataclass(frozen=True)
class Exposures:
    """Exposures of one picture in their order, and the way of the sensor through them.

    Along one axis a stage goes between `TimedFrame`s as its limits allow; in the plane the frames
    are a whole `FramePath`. A decoder that aligns them restores several; one alone may
    have a shaped shutter.

    Attributes:
        kind: The path of the sensor over them, in words.
        frames: The exposures, as `simulate_frames` takes them.
        travel: Travel of the stage, or of an axis of it, from its lowest to its highest position,
            from rest to rest, within the limits that they were found for; px.
        psnr: PSNR of the best linear decoder, which knows the velocity from the frames, in the
            scene that they were found for; in linear light, dB.
        worst_psnr: The same at the worst of the scene's speeds; dB. None in the plane.
        pan: Velocity at which the camera turns meanwhile, which the stage does not follow; px/s, in
            the plane along rows and columns.
        registration_loss: Least loss, at the worst of the speeds, of a decoder that finds the speed
            in 64 x 64 px of the frames; dB. None of one frame.
        width_loss: Loss by things that enter and leave the scene's sensor, or an object of its
            width; dB. None of one frame, and where no width is known.
        shutter: The transmittance of one exposure behind the device; None of open ones that are
            registered.
        lit_travel: Travel of an axis from the first light to the last, where limits that count in
            directions of the plane have said it; px.
    """

    kind: str
    frames: Frames
    travel: float = 0.0
    psnr: float = math.nan
    worst_psnr: float | None = None
    pan: float | tuple[float, ...] = 0.0
    registration_loss: float | None = None
    width_loss: float | None = None
    shutter: AbstractShutter | None = None
    lit_travel: float | None = None

    @staticmethod
    def of_one(
        motion: AbstractMotion, shutter: AbstractShutter, limits: Limits | None = None
    ) -> "Exposures":
        """An exposure alone, about the time 0, whose pan limits give to the stage or the camera.

        Args:
            motion: Motion of the sensor.
            shutter: The shutter in front of it.
            limits: The limits that say what pans; the stage does without them.
        """
        turns = limits is not None and limits.pans == "camera"
        pan = float(motion.velocity) if turns else 0.0
        return Exposures(ONE_EXPOSURE, (TimedFrame(motion, 0.0),), pan=pan, shutter=shutter)

    def __post_init__(self) -> None:
        # Frames on a sine know it wherever they are handed on.
        whole = frames_in(self.frames, is_sine=self.kind == SINE)
        object.__setattr__(self, "frames", whole)

    def __repr__(self) -> str:
        return f"Exposures({self.text})"

    @property
    def text(self) -> str:
        """The exposures in words, their level, and its losses on a real sensor."""
        losses = {"registration": self.registration_loss, "borders": self.width_loss}
        said = [f"{loss:.2g} by {cause}" for cause, loss in losses.items() if loss is not None]
        less = f", less {' and '.join(said)}" if said else ""
        return f"{self.kind}, {self.setting}: {self.psnr:.2f} dB{less}"

    @property
    def level(self) -> float:
        """PSNR on a sensor of the scene's width; dB."""
        return self.level_of()

    def level_of(self, *, at_worst: bool = False) -> float:
        """PSNR on a sensor of the scene's width, in the mean or at the worst of the speeds; dB.

        Args:
            at_worst: Whether the worst counts, where it is known.
        """
        psnr = self.psnr if self.worst_psnr is None or not at_worst else self.worst_psnr
        return psnr - (self.width_loss or 0.0)

    @property
    def path(self) -> TimedFrames | FramePath:
        """The way of the sensor through them, along one axis or two."""
        return self.frames  # type: ignore[return-value]

    @property
    def along(self) -> TimedFrames:
        """The exposures, of those along an axis."""
        path = self.path
        require(
            isinstance(path, TimedFrames), "exposures", "be along one axis", Unquoted(self.kind)
        )
        return path  # type: ignore[return-value]

    @property
    def motion(self) -> AbstractMotion:
        """The motion over the first exposure along an axis."""
        return self.along[0].motion

    @property
    def in_plane(self) -> bool:
        """Whether the sensor has places along rows and columns."""
        return self.path.num_axes == 2

    @property
    def axes(self) -> tuple[str, ...]:
        """Endings of a table's columns for each axis."""
        return ("_x", "_y") if self.in_plane else ("",)

    @property
    def num_axes(self) -> int:
        """Axes of the stage that exposures need; 0 at rest."""
        return self._driven.num_moved

    @property
    def _turning(self) -> Float[np.ndarray, "axes"]:
        return np.atleast_1d(self.pan)

    @property
    def _driven(self) -> TimedFrames | FramePath:
        """The exposures as the stage makes them, beside a camera that turns."""
        return self.path.beside(self._turning)

    def _of_stage(self, limits: Limits) -> Limits:
        """Limits of the stage beside a camera that turns."""
        return limits.beside(float(np.linalg.norm(self._turning)))

    @property
    def times(self) -> list[float]:
        """Mid-exposures, from the middle of all; s."""
        return np.asarray(self.path.times, np.float64).tolist()

    @property
    def exposures(self) -> list[float]:
        """Time from the first to the last light of each; s."""
        return np.asarray(self.path.exposures, np.float64).tolist()

    @property
    def rests(self) -> list[bool]:
        """Whether the sensor stands still in each; in the plane, in all."""
        return self.path.rests

    @property
    def stroke(self) -> float:
        """Travel of the stage, or of an axis, from the first light of any row to the last; px."""
        if self.lit_travel is not None:
            return self.lit_travel
        gentle = self._driven.gentle_stroke
        # Within the limits that `travel` is of, a stage may have to turn round sooner.
        return min(gentle, self.travel) if self.travel else gentle

    def place(self, times: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "axes n q"]:
        """Places of the sensor at some times of each exposure, from one place for all; px.

        Args:
            times: Times on the clock of the exposures, a row for each; s.
        """
        return np.asarray(self.path.place(times), np.float64)

    def stage_paths(self, scene: Scene) -> dict[str, StagePath]:
        """The path of the stage along each axis, from rest to rest, by the ending of its columns.

        The run-up takes the greatest acceleration of the scene's limits, or that of the rest of the
        path where they have none. There is no path where the stage stays at rest, or no limit says
        how it gets to a velocity. In the plane each is about the middle of its travel.

        Args:
            scene: The scene whose limits the stage has.
        """
        require_scene(scene, in_plane=True)
        if not self.in_plane:
            require_one_axis(scene)
        return self.stage_paths_within(scene.limits)

    def stage_paths_within(self, limits: Limits) -> dict[str, StagePath]:
        """The same within some limits.

        Args:
            limits: Those of the stage.
        """
        if self.shutter is None:
            paths = self._driven.stage_paths(self._of_stage(limits))
            return dict(zip(self.axes, paths, strict=False))
        path = limits.stage_path(self.motion)
        return {} if path is None else {"": path}

    @property
    def num_frames(self) -> int:
        """Number of exposures."""
        return len(self.times)

    @property
    def lights(self) -> Lights:
        """First and last light of each; s."""
        pairs = zip(self.times, self.exposures, strict=True)
        return [(time - exposure / 2, time + exposure / 2) for time, exposure in pairs]

    @property
    def duration(self) -> float:
        """Time from the first light to the last; s."""
        times, exposures = self.times, self.exposures
        return times[-1] - times[0] + (exposures[0] + exposures[-1]) / 2

    @property
    def moves(self) -> bool:
        """Whether the sensor moves during some exposure."""
        return not all(self.rests)

    @property
    def num_rests(self) -> int:
        """Number of frames at rest before the first that moves.

        A later one does not count: the middle frame of a fan may be so slow that it seems at rest.
        """
        return len([*takewhile(bool, self.rests)])

    @property
    def setting(self) -> str:
        """Numbers of frames and their exposures; frames at rest before moving ones say so."""
        num_rests = self.num_rests if self.moves else 0
        kinds = Counter((f"{length} ms", k < num_rests) for k, length in enumerate(self._each))
        if len(kinds) > _MOST_NAMED:
            at_rest = [f"{num_rests} at rest"] if num_rests else []
            return ", ".join([f"{self.num_frames} of {self._range} ms", *at_rest])
        return _listed(
            f"{count} of {exposure}{' at rest' if is_still else ''}"
            for (exposure, is_still), count in kinds.items()
        )

    @property
    def lengths(self) -> str:
        """Exposures in words: each that occurs, with its number, or all in an order that counts."""
        kinds, every = Counter(self._each), self._each
        if len(kinds) > _MOST_NAMED:
            return f"{self._range} ms"
        if set(kinds.values()) == {1} or len(kinds) == 1:
            return f"{_listed(kinds)} ms"
        num_runs = 1 + sum(one != other for one, other in pairwise(every))
        if num_runs > len(kinds) and len(every) <= _MOST_LISTED:  # in an order that counts
            return f"{_listed(every)} ms"
        return f"{_listed(f'{count} of {exposure}' for exposure, count in kinds.items())} ms"

    @property
    def turning(self) -> str:
        """The camera's turning in words; empty where it does not turn."""
        speeds = ", ".join(in_digits(speed, 4) for speed in self._turning)
        return f"the camera turns at {speeds} px/s" if np.any(self._turning) else ""

    @property
    def _range(self) -> str:
        """The least and the greatest exposure; ms."""
        low, high = (three_digits(1e3 * each(self.exposures)) for each in (min, max))
        return f"{low} to {high}"

    @property
    def _each(self) -> list[str]:
        """Every exposure, in words; ms."""
        return [three_digits(1e3 * exposure) for exposure in self.exposures]

    def of_one_gain(self, frames: Iterable[np.ndarray]) -> list[np.ndarray]:
        """Frames as a sensor of one gain has them: in units of the white of the longest.

        Args:
            frames: Light of each exposure, in units of its own white.
        """
        longest = max(self.exposures)
        return [time / longest * each for time, each in zip(self.exposures, frames, strict=True)]

    def of_own_whites(self, frames: Iterable[np.ndarray]) -> list[np.ndarray]:
        """Frames that a sensor of one gain has recorded, each in units of its own white.

        Args:
            frames: Light of each exposure, in units of the white of the longest.
        """
        longest = max(self.exposures)
        return [each / (time / longest) for time, each in zip(self.exposures, frames, strict=True)]

    def use_within(self, limits: Limits) -> StageUse:
        """The demands of the exposures on a stage that runs up to them from rest.

        Where no path can be written, since no limit says how the stage reaches a velocity, it does
        so at once.

        Args:
            limits: Those of the stage.
        """
        if self.shutter is not None and (paths := self.stage_paths_within(limits)):
            return paths[""].use
        return self._driven.use(self._of_stage(limits))

    def share_of(self, limits: Limits) -> Numbers | float:
        """Greatest share of a limit that the path of a stage takes, which JAX may trace.

        Args:
            limits: Those of the stage.
        """
        use, path = self.use_within(limits), self._driven
        # In the plane a velocity that jumps takes an infinite one.
        in_plane = isinstance(path, FramePath)
        acceleration = path.acceleration(self._of_stage(limits)) if in_plane else use.acceleration
        pairs = (
            (use.stroke, limits.max_stroke),
            # What the camera turns by is no longer the stage's.
            (use.top_speed + float(np.linalg.norm(self._turning)), limits.max_top_speed),
            (use.travel, limits.max_travel),
            (acceleration, limits.max_acceleration),
        )
        shares = [taken / float(there) for taken, there in pairs if there is not None]
        return float(max(shares)) if all_concrete(shares) else largest_of(jnp.stack(shares))

    def with_travel(self, limits: Limits) -> "Exposures":
        """The sequence with the travel of its path within some limits.

        Args:
            limits: Those of the stage.
        """
        return replace(self, travel=float(self.use_within(limits).travel))

    def path_for_rows(self, readout: float, limits: Limits) -> FramePath:
        """The whole path that rows see which are exposed earlier and later.

        A stage reaches a velocity at once where no limit says how.

        Args:
            readout: Time from the first row to the last; s.
            limits: Those of the stage.
        """
        return self.path.path_for_rows(readout, self._of_stage(limits), self._turning)

    def for_rows(self, readout: float, limits: Limits) -> "Exposures":
        """The frames, with a way that goes on while rows are exposed earlier and later.

        It does not go on where the stage would leave its limits so: then the first and the last
        rows see how it comes from rest, and goes back to it.

        Args:
            readout: Time from the first row to the last; s.
            limits: Those of the stage.
        """
        going_on = self.path.for_rows(readout, self._of_stage(limits), self._turning)
        return replace(self, frames=going_on)


def _listed(words: Iterable[str]) -> str:
    """Words one after the other."""
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last


def frames_of(exposures: Frames | Exposures) -> Frames:
    """The frames of exposures, which may be alone."""
    return exposures.frames if isinstance(exposures, Exposures) else exposures


def open_frames(subject: str, exposures: Frames | Exposures) -> Frames:
    """The frames of exposures of an open shutter, as public functions take them.

    Args:
        subject: Name of the argument, in an error.
        exposures: `TimedFrame`s, `PlaneFrames`, or `Exposures` of either.
    """
    is_list = isinstance(exposures, Sequence) and not isinstance(exposures, str)
    is_known = isinstance(exposures, FramePath | Exposures) or (
        is_list and all(isinstance(frame, TimedFrame) for frame in exposures)
    )
    words = "be `TimedFrame`s, `PlaneFrames`, or `Exposures` as `best_sequence` returns them"
    require(is_known, subject, words, exposures)
    shutter = exposures.shutter if isinstance(exposures, Exposures) else None
    words = "be of an open shutter: `simulate_capture` takes one exposure behind another"
    require(shutter is None or isinstance(shutter, RectShutter), subject, words, shutter)
    return frames_of(exposures)


def path_for_rows(scene: Scene, exposures: Frames | Exposures) -> FramePath:
    """Known exposures with the path that rows of a scene's sensor see between them and beyond."""
    readout, limits = scene.sensor.readout_time, scene.limits
    require_known("path_for_rows", frames=frames_of(exposures), sensor=scene.sensor)
    if isinstance(exposures, Exposures):
        return exposures.path_for_rows(readout, limits)
    return frames_in(exposures).path_for_rows(readout, limits)


def exposures_in_plane(
    scene: Scene, kind: str, frames: FramePath, psnr: float, *, width_loss: float | None = None
) -> Exposures:
    """Frames with what they ask of a stage, beside a camera that turns where they move."""
    pan = np.zeros(2)
    if not frames.stays:
        pan = turned_by(require_velocities(scene), scene.limits)
    use = frames.beside(pan).use(scene.limits)
    return Exposures(
        kind,
        frames,
        float(use.travel),
        psnr,
        pan=(*pan.tolist(),),
        width_loss=width_loss,
        lit_travel=float(use.stroke),
    )


def turned_by(velocities: AbstractVelocities, limits: Limits) -> Float[np.ndarray, "2"]:
    """Velocity of a camera that pans by turning along with the mean of the things; px/s."""
    centre, most = velocities.centre, float(limits.max_pan) if limits.pans == "camera" else 0.0
    speed = float(np.hypot(*centre))
    return centre * min(1.0, most / speed) if speed > 0 else centre
