"""Exposures of one picture, one or more in their order: what a camera takes, of whatever path."""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise, takewhile
from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Float

from mishutter._core.checks import require_known
from mishutter.model.limits import Limits
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_one_axis, require_scene, require_velocities
from mishutter.model.sequences import (
    SINE,
    SINGLE,
    FramePath,
    Frames,
    Lights,
    TimedFrame,
    along_sine,
    from_rest,
)
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

    Those along one axis are `TimedFrame`s, between which a stage goes as its limits allow; those in
    the plane are a whole `FramePath`. A decoder that aligns them restores several; one alone may
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
        lead: Time for which the way goes on before the first light and after the last, for rows
            that are exposed earlier and later; s.
        shutter: The transmittance of one exposure behind the device; None of open ones that are
            registered.
        lit_travel: Travel of an axis from the first light to the last, where limits that count in
            directions of the plane have said it; px.
    """

    kind: str
    frames: tuple[TimedFrame, ...] | FramePath
    travel: float = 0.0
    psnr: float = math.nan
    worst_psnr: float | None = None
    pan: float | tuple[float, ...] = 0.0
    registration_loss: float | None = None
    width_loss: float | None = None
    lead: float = 0.0
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
        return self.psnr - (self.width_loss or 0.0)

    @property
    def path(self) -> FramePath | None:
        """The whole path of exposures in the plane; None along an axis."""
        return self.frames if isinstance(self.frames, FramePath) else None

    @property
    def along(self) -> tuple[TimedFrame, ...]:
        """The exposures along an axis; none in the plane."""
        return () if isinstance(self.frames, FramePath) else self.frames

    @property
    def motion(self) -> AbstractMotion:
        """The motion over the first exposure along an axis."""
        return self.along[0].motion

    @property
    def axes(self) -> tuple[str, ...]:
        """Endings of a table's columns for each axis."""
        return ("",) if self.path is None else ("_x", "_y")

    @property
    def num_axes(self) -> int:
        """Axes of the stage that exposures in the plane need; 0 at rest."""
        driven = self._driven
        if driven is None or driven.stays:
            return 0
        sizes = np.linalg.svd(driven.velocities, compute_uv=False)
        return 1 if sizes[1] <= SINGLE * sizes[0] else 2

    @property
    def _turning(self) -> Float[np.ndarray, "axes"]:
        return np.atleast_1d(self.pan)

    @property
    def _driven(self) -> FramePath | None:
        """The path of the stage in the plane, beside a camera that turns; None along an axis."""
        return None if self.path is None else of_stage(self.path, self._turning)

    @property
    def times(self) -> list[float]:
        """Mid-exposures, from the middle of all; s."""
        if self.path is not None:
            return np.asarray(self.path.times).tolist()
        return [float(frame.time) for frame in self.along]

    @property
    def exposures(self) -> list[float]:
        """Time from the first to the last light of each; s."""
        if self.path is not None:
            return np.asarray(self.path.exposures).tolist()
        return [frame.exposure for frame in self.along]

    @property
    def rests(self) -> list[bool]:
        """Whether the sensor stands still in each; in the plane, in all."""
        if self.path is not None:
            return [self.path.stays] * self.num_frames
        return [frame.is_still for frame in self.along]

    @property
    def stroke(self) -> float:
        """Travel of the stage, or of an axis, from the first light of any row to the last; px."""
        if self.path is not None or self.lit_travel is not None:
            return self.lit_travel or 0.0
        gentle = float(self._knots(None, None).use.travel)
        # Within the limits that `travel` is of, a stage may have to turn round sooner.
        return min(gentle, self.travel) if self.travel else gentle

    def place(self, times: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "axes n q"]:
        """Places of the sensor at some times of each exposure, from one place for all; px.

        Args:
            times: Times on the clock of the exposures, a row for each; s.
        """
        if self.path is not None:
            return np.asarray(self.path.place(times), np.float64)
        pairs = zip(self.along, times, strict=True)
        ways = [(x.position, x.motion.position(time - x.time)) for x, time in pairs]
        return np.array([[place + np.asarray(way, np.float64) for place, way in ways]])

    def stage_paths(self, scene: Scene) -> dict[str, StagePath]:
        """The path of the stage along each axis, from rest to rest, by the ending of its columns.

        The run-up takes the greatest acceleration of the scene's limits, or that of the rest of the
        path where they have none. There is no path where the stage stays at rest, or no limit says
        how it gets to a velocity. In the plane each is about the middle of its travel.

        Args:
            scene: The scene whose limits the stage has.
        """
        require_scene(scene, in_plane=True)
        limits, driven = scene.limits, self._driven
        if driven is None:
            require_one_axis(scene)
            path = self.stage_path_within(limits)
            return {} if path is None else {"": path}
        return dict(zip(self.axes, driven.stage_paths(limits), strict=False))

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
        kinds = Counter(
            (f"{exposure * 1e3:.3g} ms", index < num_rests)
            for index, exposure in enumerate(self.exposures)
        )
        if len(kinds) > _MOST_NAMED:
            at_rest = [f"{num_rests} at rest"] if num_rests else []
            return ", ".join([f"{self.num_frames} of {self._range} ms", *at_rest])
        return " and ".join(
            f"{count} of {exposure}{' at rest' if is_still else ''}"
            for (exposure, is_still), count in kinds.items()
        )

    @property
    def lengths(self) -> str:
        """Exposures in words: each that occurs, with its number where stills differ in them."""
        kinds = Counter(f"{exposure * 1e3:.3g}" for exposure in self.exposures)
        if len(kinds) > _MOST_NAMED:
            return f"{self._range} ms"
        if self.moves or set(kinds.values()) == {1} or len(kinds) == 1:
            return f"{' and '.join(kinds)} ms"
        every = [f"{exposure * 1e3:.3g}" for exposure in self.exposures]
        num_runs = 1 + sum(one != other for one, other in pairwise(every))
        if num_runs > len(kinds) and len(every) <= _MOST_LISTED:  # in an order that counts
            return f"{', '.join(every[:-1])} and {every[-1]} ms"
        return f"{' and '.join(f'{count} of {exposure}' for exposure, count in kinds.items())} ms"

    @property
    def _range(self) -> str:
        """The least and the greatest exposure; ms."""
        return f"{min(self.exposures) * 1e3:.3g} to {max(self.exposures) * 1e3:.3g}"

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
        """The demands of the frames on a stage that runs up to them from rest.

        Where no path can be written, since no limit says how the stage reaches a velocity, it does
        so at once.

        Args:
            limits: Those of the stage.
        """
        if (driven := self._driven) is not None:
            return driven.use(limits)
        path = self.stage_path_within(limits)
        return self._knots(None, None).use if path is None else path.use

    def share_of(self, limits: Limits) -> float:
        """Greatest share of a limit that the path of a stage takes.

        Args:
            limits: Those of the stage.
        """
        use = self.use_within(limits)
        driven, acceleration = self._driven, use.acceleration
        if driven is not None:  # but for run-ups, which take all that there is
            acceleration = driven.acceleration(limits)
        pairs = (
            (use.stroke, limits.max_stroke),
            # What the camera turns by is no longer the stage's.
            (float(use.top_speed) + float(np.linalg.norm(self._turning)), limits.max_top_speed),
            (use.travel, limits.max_travel),
            (acceleration, limits.max_acceleration),
        )
        shares = (float(taken) / float(there) for taken, there in pairs if there is not None)
        return max(shares)

    def with_travel(self, limits: Limits) -> "Exposures":
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
        if self.shutter is not None:
            return limits.stage_path(self.motion)
        knots, first = self._knots_within(limits), self.along[0]
        if knots is None:
            return None
        return knots.path(float(first.time) - first.exposure / 2, self._ends(first)[0])

    def _knots_within(self, limits: Limits) -> Knots | None:
        """The way of the stage from rest to rest within some limits, where they say one."""
        most, jerk, top_speed = limits.of_run_up(self._turning[0])
        if most is None:
            at_once = self._knots(None, None)
            within = slice(at_once.first, at_once.last)
            gains = np.abs(np.diff(at_once.velocities)[within])[at_once.durations[within] == 0]
            jumps = np.any(gains > SINGLE * np.max(np.abs(at_once.velocities)))
            if jumps or (self.moves and self.num_rests > 0):
                return None
            most = float(at_once.use.acceleration)
        knots = self._knots(most, jerk, top_speed) if most > 0 else None
        return None if knots is None or not np.any(knots.velocities) else knots

    def path_for_rows(self, readout: float, limits: Limits) -> FramePath:
        """The exposures with the path that rows see which are exposed earlier and later.

        A stage reaches a velocity at once where no limit says how.

        Args:
            readout: Time from the first row to the last; s.
            limits: Those of the stage.
        """
        if self.path is not None:
            return self.path.for_rows(readout, limits)
        going_on = self.for_rows(readout, limits)
        way = going_on._knots_within(limits) or going_on._knots(None, None)
        # Before and after it the stage is at rest, and may reach a velocity at once.
        return FramePath(
            np.array(self.times, np.float64),
            np.array(self.exposures, np.float64),
            np.r_[readout, 0.0, way.durations, 0.0, readout],
            (np.pad(way.velocities, 2) + self._turning[0])[None],
            float(np.sum(way.durations[: way.first])) + readout,
            None if way.jerks is None else np.pad(way.jerks, 2),
        )

    def for_rows(self, readout: float, limits: Limits) -> "Exposures":
        """The frames, with a way that goes on while rows are exposed earlier and later.

        It does not go on where the stage would leave its limits so: then the first and the last
        rows see how it comes from rest, and goes back to it.

        Args:
            readout: Time from the first row to the last; s.
            limits: Those of the stage.
        """
        if self.path is not None:
            return replace(self, frames=self.path.for_rows(readout, limits))
        going_on = replace(self, lead=readout / 2)
        if not self.moves or not readout:
            return replace(self, lead=0.0)
        travel = float(going_on.use_within(limits).travel)
        fits = limits.have_room_for(travel=travel, stroke=going_on.stroke)
        return going_on if fits else replace(self, lead=0.0)

    def _of_stage(self, frame: TimedFrame) -> AbstractMotion:
        """The motion of the stage over a frame, beside a camera that turns."""
        pan = self._turning[0]
        return frame.motion.panned(frame.motion.velocity - pan) if pan else frame.motion

    def _ends(self, frame: TimedFrame) -> tuple[float, float]:
        """Places of the stage at the ends of a frame; px."""
        motion, place = self._of_stage(frame), frame.position - self._turning[0] * frame.time
        end = np.asarray(motion.position(np.array([float(motion.half_exposure)])))
        return place + place_at_begin(motion), place + float(end[0])

    def _knots(
        self, most: float | None, jerk: float | None, top_speed: float | None = None
    ) -> Knots:
        """The way of the stage from rest to rest at a greatest acceleration, jerk and speed."""
        ends = [self._ends(frame) for frame in self.along]

        def whole(span: tuple[float, float] | None) -> Knots:
            lit = [Knots.of_exposure(self._of_stage(frame)) for frame in self.along]
            pieces = lit[0].pieces
            each = zip(self.along, lit, ends, strict=True)
            for (frame, own, places), (after, other, others) in pairwise(each):
                gap = float(after.time - frame.time) - (after.exposure + frame.exposure) / 2
                way, start, end = others[0] - places[1], own.velocities[-1], other.velocities[0]
                ends_of_gap = float(way), gap, float(start), float(end)
                if gap <= 1e-9 * (after.time - frame.time):  # but for rounding
                    pieces.append(Piece(0.0, end))
                elif not np.any(own.velocities) and (
                    late := from_rest(
                        way, gap, end, run_up(end, float(other.accelerations[0]), most, jerk)
                    )
                ):
                    pieces += late
                elif self.kind == SINE and np.any(own.velocities):
                    pan = float(self._of_stage(frame).velocity)
                    half = frame.exposure / 2
                    pieces += along_sine(way, gap, start - pan, half, pan=pan, end=end)
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

        if len(self.along) == 1:
            return whole(None)
        if most is None:
            # A stage of any acceleration stays where it is in some frame.
            lit = [extent(Knots.of_exposure(self._of_stage(frame))) for frame in self.along]
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


def frames_of(exposures: Frames | Exposures) -> Frames:
    """The frames of exposures, which may be alone."""
    return exposures.frames if isinstance(exposures, Exposures) else exposures


def path_for_rows(scene: Scene, exposures: Frames | Exposures) -> FramePath:
    """Known exposures with the path that rows of a scene's sensor see between them and beyond."""
    readout, limits = scene.sensor.readout_time, scene.limits
    require_known("path_for_rows", frames=frames_of(exposures), sensor=scene.sensor)
    if isinstance(exposures, FramePath):
        return exposures.for_rows(readout, limits)
    if not isinstance(exposures, Exposures):
        exposures = Exposures("", tuple(exposures))
    return exposures.path_for_rows(readout, limits)


def exposures_in_plane(
    scene: Scene, kind: str, frames: FramePath, psnr: float, *, width_loss: float | None = None
) -> Exposures:
    """Frames with what they ask of a stage, beside a camera that turns where they move."""
    pan = pan_over(scene, frames)
    use = of_stage(frames, pan).use(scene.limits)
    return Exposures(
        kind,
        frames,
        float(use.travel),
        psnr,
        pan=(*pan.tolist(),),
        width_loss=width_loss,
        lit_travel=float(use.stroke),
    )


def pan_over(scene: Scene, frames: FramePath) -> Float[np.ndarray, "2"]:
    """Velocity at which the camera turns over frames, 0 if they are at rest; px/s."""
    return np.zeros(2) if frames.stays else turned_by(require_velocities(scene), scene.limits)


def turned_by(velocities: AbstractVelocities, limits: Limits) -> Float[np.ndarray, "2"]:
    """Velocity of a camera that pans by turning along with the mean of the things; px/s."""
    centre, most = velocities.centre, float(limits.max_pan) if limits.pans == "camera" else 0.0
    speed = float(np.hypot(*centre))
    return centre * min(1.0, most / speed) if speed > 0 else centre


def of_stage(frames: FramePath, pan: Float[np.ndarray, "axes"]) -> FramePath:
    """Frames that move as the stage makes them, beside a camera that turns at a velocity, px/s."""
    if not np.any(pan):
        return frames
    velocity = frames.velocities - pan[:, None]
    return eqx.tree_at(lambda x: x.velocities, frames, velocity)


FrameSequence = PlaneBurst = Exposures
"""Its names in earlier versions, of exposures along one axis and in the plane."""
