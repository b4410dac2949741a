"""Frames that a camera takes one after the other of the same picture, and what its sensor does."""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import require_known
from mishutter.model.exposures import AT_REST, AbstractExposures, AbstractPath
from mishutter.model.limits import Limits
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.stages import (
    Knots,
    Piece,
    StagePath,
    StageUse,
    extent,
    place_at_begin,
    run_up,
    transfer,
)

SINE = "sine"
"""Kind of a sequence whose stage follows a sine between its frames too."""
_SINGLE = 1e-5
"""Share of a number below which it is one of rounding, in single precision."""


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
    # Numbers, or ones that JAX traces
    time: float | Any
    position: float | Any = 0.0

    @property
    def exposure(self) -> float:
        """Time from its first to its last light; s."""
        return float(self.motion.exposure)

    @property
    def is_still(self) -> bool:
        """Whether its sensor stands still."""
        return float(self.motion.stroke) < AT_REST


class AbstractFrames(AbstractExposures):
    """Exposures of a sensor that moves along one axis."""

    frames: eqx.AbstractVar[tuple[TimedFrame, ...]]
    # Velocity at which the camera turns meanwhile, which the stage does not follow; px/s
    pan: eqx.AbstractVar[float]

    @property
    def times(self) -> list[float]:
        return [frame.time for frame in self.frames]

    @property
    def exposures(self) -> list[float]:
        return [frame.exposure for frame in self.frames]

    @property
    def rests(self) -> list[bool]:
        return [frame.is_still for frame in self.frames]

    def place(self, times: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "1 n q"]:
        pairs = zip(self.frames, times, strict=True)
        ways = [(x.position, x.motion.position(time - x.time)) for x, time in pairs]
        return np.array([[place + np.asarray(way, np.float64) for place, way in ways]])

    @abstractmethod
    def stage_path_within(self, limits: Limits) -> StagePath | None:
        """The path of the stage from rest to rest, within some limits."""

    def stage_paths(self, scene: Scene) -> dict[str, StagePath]:
        require_scene(scene)
        path = self.stage_path_within(scene.limits)
        return {} if path is None else {"": path}


@final
@dataclass(frozen=True)
class OneExposure(AbstractFrames):
    """An exposure alone, about the time 0, which may have a shaped shutter."""

    motion: AbstractMotion
    shutter: AbstractShutter  # The transmittance behind the device
    pan: float = 0.0
    kind: ClassVar = "one exposure"

    @staticmethod
    def of(motion: AbstractMotion, shutter: AbstractShutter, limits: Limits) -> "OneExposure":
        """The exposure of a motion, whose pan the limits give to the stage or to the camera."""
        pan = float(motion.velocity) if limits.pans == "camera" else 0.0
        return OneExposure(motion, shutter, pan)

    @property
    def frames(self) -> tuple[TimedFrame, ...]:
        return (TimedFrame(self.motion, 0.0),)

    @property
    def stroke(self) -> float:
        of_stage = self.motion.without_velocity() if self.pan else self.motion
        return float(of_stage.stroke)

    def stage_path_within(self, limits: Limits) -> StagePath | None:
        return limits.stage_path(self.motion)


@final
@dataclass(frozen=True)
class FrameSequence(AbstractFrames):
    """Frames of one picture in the order in which they are exposed, for a decoder that aligns them.

    Attributes:
        kind: The path of the sensor over the sequence, in words.
        frames: The frames.
        travel: Travel of the stage, from its lowest to its highest position, from rest to rest, as
            `stage_path_within` has it; px.
        psnr: PSNR of the best linear decoder, which knows the speed from the frames, in the scene
            that they were found for; in linear light, dB.
        worst_psnr: The same at the worst of the scene's speeds; dB.
        pan: Velocity at which the camera turns meanwhile, which the stage does not follow; px/s.
        lead: Time for which the way goes on before the first light and after the last, for rows
            that are exposed earlier and later; s.
        registration_loss: Least loss, at the worst of the speeds, of a decoder that finds the speed
            in 64 x 64 px of the frames; dB. None of one frame.
        width_loss: Loss by things that enter and leave the scene's sensor; dB. None of one frame,
            and of a sensor whose width is not known.
    """

    kind: str
    frames: tuple[TimedFrame, ...]
    travel: float
    psnr: float
    worst_psnr: float
    pan: float = 0.0
    registration_loss: float | None = None
    width_loss: float | None = None
    lead: float = 0.0

    def __repr__(self) -> str:
        return f"FrameSequence({self.text})"

    @property
    def text(self) -> str:
        """The frames in words, their level, and its losses on a real sensor."""
        losses = {
            "registration": self.registration_loss,
            "borders": self.width_loss,
        }
        said = [f"{loss:.2g} by {cause}" for cause, loss in losses.items() if loss is not None]
        less = f", less {' and '.join(said)}" if said else ""
        return f"{self.kind}, {self.setting}: {self.psnr:.2f} dB{less}"

    @property
    def stroke(self) -> float:
        """Travel of the stage from the first light of any row to the last, without run-ups; px."""
        gentle = float(self._knots(None, None).use.travel)
        # Within the limits that `travel` is of, a stage may have to turn round sooner.
        return min(gentle, self.travel) if self.travel else gentle

    def use_within(self, limits: Limits) -> StageUse:
        """The demands of the frames on a stage that runs up to them from rest.

        Where no path can be written, since no limit says how the stage reaches a velocity, it does
        so at once.

        Args:
            limits: Those of the stage.
        """
        path = self.stage_path_within(limits)
        return self._knots(None, None).use if path is None else path.use

    def with_travel(self, limits: Limits) -> "FrameSequence":
        """The sequence with the travel of its path within some limits.

        Args:
            limits: Those of the stage.
        """
        return replace(self, travel=float(self.use_within(limits).travel))

    def stage_path_within(self, limits: Limits) -> StagePath | None:
        r"""The whole path of the stage: rest, run-up, frames, run-out, rest.

        Between frames the stage follows the gentlest `transfer` of a ramp, a coast and a ramp that
        takes no more travel than those at the greatest acceleration. Between frames on a sine it
        follows that, and to one that moves it runs up from one at rest as late as it can.

        Args:
            limits: Those of the stage. Without one of its acceleration that is the greatest of the
                rest of the path.

        Returns:
            The path; None where the stage stays at rest. None also where a limit of the
            acceleration is missing and needed: the frames do not say how fast a stage reaches a
            velocity that it keeps, or from one to the next.
        """
        most, jerk, top_speed = limits.of_run_up(self.pan)
        if most is None:
            at_once = self._knots(None, None)
            within = slice(at_once.first, at_once.last)
            gains = np.abs(np.diff(at_once.velocities)[within])[at_once.durations[within] == 0]
            jumps = np.any(gains > _SINGLE * np.max(np.abs(at_once.velocities)))
            if jumps or (self.moves and self.num_rests > 0):
                return None
            most = float(at_once.use.acceleration)
        knots = self._knots(most, jerk, top_speed) if most > 0 else None
        if knots is None or not np.any(knots.velocities):
            return None
        first = self.frames[0]
        return knots.path(first.time - first.exposure / 2, self._ends(first)[0])

    def path(self, limits: Limits) -> "AxisPath":
        """Its frames and the way of the sensor through them, from rest to rest.

        A stage reaches a velocity at once where no limit says how.

        Args:
            limits: Those of the stage.
        """
        stage = self.stage_path_within(limits)
        if stage is None:
            first = self.frames[0]
            begin = first.time - first.exposure / 2, self._ends(first)[0]
            stage = self._knots(None, None).path(*begin)
        return AxisPath(np.array(self.times), np.array(self.exposures), stage, self.pan)

    def for_rows(self, readout: float, limits: Limits) -> "FrameSequence":
        """The frames, with a way that goes on while rows are exposed earlier and later.

        It does not go on where the stage would leave its limits so: then the first and the last
        rows see how it comes from rest, and goes back to it.

        Args:
            readout: Time from the first row to the last; s.
            limits: Those of the stage.
        """
        going_on = replace(self, lead=readout / 2)
        if not self.moves or not readout:
            return replace(self, lead=0.0)
        travel = float(going_on.use_within(limits).travel)
        fits = limits.have_room_for(travel=travel, stroke=going_on.stroke)
        return going_on if fits else replace(self, lead=0.0)

    def _of_stage(self, frame: TimedFrame) -> AbstractMotion:
        """The motion of the stage over a frame, beside a camera that turns."""
        return frame.motion.panned(frame.motion.velocity - self.pan) if self.pan else frame.motion

    def _ends(self, frame: TimedFrame) -> tuple[float, float]:
        """Places of the stage at the ends of a frame; px."""
        motion, place = self._of_stage(frame), frame.position - self.pan * frame.time
        end = np.asarray(motion.position(np.array([float(motion.half_exposure)])))
        return place + place_at_begin(motion), place + float(end[0])

    def _knots(
        self, most: float | None, jerk: float | None, top_speed: float | None = None
    ) -> Knots:
        """The way of the stage from rest to rest at a greatest acceleration, jerk and speed."""
        ends = [self._ends(frame) for frame in self.frames]

        def whole(span: tuple[float, float] | None) -> Knots:
            lit = [Knots.of_exposure(self._of_stage(frame)) for frame in self.frames]
            pieces = lit[0].pieces
            each = zip(self.frames, lit, ends, strict=True)
            for (frame, own, places), (after, other, others) in pairwise(each):
                gap = after.time - frame.time - (after.exposure + frame.exposure) / 2
                way, start, end = others[0] - places[1], own.velocities[-1], other.velocities[0]
                ends_of_gap = float(way), float(gap), float(start), float(end)
                if gap <= 1e-9 * (after.time - frame.time):  # but for rounding
                    pieces.append(Piece(0.0, end))
                elif not np.any(own.velocities) and (
                    late := _from_rest(
                        way, gap, end, run_up(end, float(other.accelerations[0]), most, jerk)
                    )
                ):
                    pieces += late
                elif self.kind == SINE and np.any(own.velocities):
                    pan = float(self._of_stage(frame).velocity)
                    half = frame.exposure / 2
                    pieces += _along_sine(way, gap, start - pan, half, pan=pan, end=end)
                else:
                    near = None if span is None else (span[0] - places[1], span[1] - places[1])
                    scale = sum(float(np.ptp(each.positions)) for each in (own, other))
                    pieces += transfer(
                        *ends_of_gap, acceleration=most, top_speed=top_speed, span=near, scale=scale
                    )
                pieces += other.pieces
            rates = float(lit[0].accelerations[0]), float(lit[-1].accelerations[-1])
            way = Knots.of(lit[0].velocities[0], pieces)
            if self.lead:
                way = way.led(self.lead)
                rates = float(way.accelerations[0]), float(way.accelerations[-1])
            return way.from_rest_to_rest(rates, most, jerk)

        if len(self.frames) == 1:
            return whole(None)
        if most is None:
            # A stage of any acceleration stays where it is in some frame.
            lit = [extent(Knots.of_exposure(self._of_stage(frame))) for frame in self.frames]
            low = min(begin + way[0] for (begin, _), way in zip(ends, lit, strict=True))
            high = max(begin + way[1] for (begin, _), way in zip(ends, lit, strict=True))
            margin = 1e-3 * (high - low)
            return whole((low - margin, high + margin))
        # No wider than by the greatest acceleration, at which the stage turns round soonest.
        steepest = whole((math.inf, -math.inf))
        low, high = extent(steepest)
        begin = ends[0][0] - float(steepest.positions[steepest.first])
        margin = 1e-9 * (high - low)
        return whole((low + begin - margin, high + begin + margin))


@final
class AxisPath(AbstractPath):
    """Frames along one axis, and the path of the sensor through them, from rest to rest.

    Attributes:
        times: Mid-exposures, ascending; s, shape `(n,)`.
        exposures: Exposures; s, shape `(n,)`.
        stage: The path of the stage.
        pan: Velocity at which the camera turns meanwhile; px/s.
    """

    times: Float[np.ndarray, "n"]
    exposures: Float[np.ndarray, "n"]
    stage: StagePath
    pan: float

    @staticmethod
    def of(frames: Sequence[TimedFrame], readout: float, limits: Limits) -> "AxisPath":
        """The path of frames whose rows are read one after another.

        Args:
            frames: The frames, which are known.
            readout: Time from the first row to the last; s.
            limits: Those of the stage.
        """
        require_known("AxisPath.of", frames=frames)
        alone = FrameSequence("", tuple(frames), 0.0, 0.0, 0.0)
        return alone.for_rows(readout, limits).path(limits)

    def for_rows(self, readout: float, limits: Limits) -> "AxisPath":
        return self

    @property
    def top_speed(self) -> float:
        return float(np.max(np.abs(self.stage.velocities + self.pan)))

    @property
    def bends(self) -> Float[np.ndarray, "k"]:
        return self.stage.times

    def place(self, time: Float[Array | np.ndarray, "*shape"]) -> Float[np.ndarray, "1 *shape"]:
        """Place of the sensor; px.

        Args:
            time: Time on the clock of `times`; s.
        """
        known = np.asarray(time)
        return (self.stage.at(known)[0] + self.pan * known)[None]


def _from_rest(way: float, gap: float, end: float, ups: list[Piece]) -> list[Piece] | None:
    """From a frame at rest, as late as a run-up or a constant acceleration lets the stage start."""
    if not way and not end:
        return [Piece(gap, 0.0)]
    knots = Knots.of(0.0, ups)
    duration, place = float(np.sum(knots.durations)), float(knots.positions[-1])
    # Numbers of frames may be those of single precision.
    if abs(place - way) <= _SINGLE * abs(way) and duration <= gap * (1 + _SINGLE):
        return [Piece(max(gap - duration, 0.0), 0.0), *ups]
    rise = 2 * way / end if end else 0.0
    if rise > 0 and duration <= rise <= gap:
        return [Piece(gap - rise, 0.0), Piece(rise, end)]
    return None


def _along_sine(
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
