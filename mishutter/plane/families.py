r"""Ways of a sensor over frames in the plane, each by a few numbers from 0 to 1.

The power that passes at a frequency follows the time that the sensor spends at each velocity: the
best paths fill the law of velocities evenly. Two sines of different frequency, one an axis,

$$\dot{\mathbf x} = \bigl(-V_x\sin(\omega - \delta)t,\; V_y\cos(\omega + \delta)t\bigr),$$

fill an ellipse as their phase runs; without the difference $\delta$ they are a circle. Parabolas
that alternate between two axes fill a cross, and constant velocities, one a frame, a ring.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from mishutter.evaluation.bursts import FrameTimes
from mishutter.evaluation.moving_bursts import ALTERNATING, SINE, SWEEP, steps_of, way_over_frames
from mishutter.model.limits import Limits
from mishutter.model.sequences import TimedFrame
from mishutter.model.stages import Knots
from mishutter.model.velocities import AbstractVelocities
from mishutter.plane.frames import PlaneFrames

STILLS, BRACKETED, PAN, CIRCLE, TWO_SINES, CROSSED, RING, FREE = (
    "stills",
    "stills of two exposures",
    "pan",
    "circle",
    "two sines",
    "crossed parabolas",
    "ring of velocities",
    "free path",
)
"""Ways beside those along one axis."""
_LEAST_PIECES = 64
"""Least number of pieces of constant acceleration in a path."""
_FASTEST = 1.5
"""Top speed of a way that may pay, over that of the fastest thing."""
_DUTY_OF_CROSS = 2 / 3
"""Duty at which the gaps between crossed parabolas take no more acceleration than these."""
_CLOSE = 1e-3
"""Share of a limit that a way may leave."""

Point = Float[np.ndarray, "d"]


class Room(NamedTuple):
    """The part that all ways share: the law of velocities, the limits and the times of frames."""

    velocities: AbstractVelocities
    limits: Limits
    times: FrameTimes

    @property
    def half_axes(self) -> Float[np.ndarray, "2"]:
        """Greatest components along the axis of the fastest and across it; px/s."""
        angle = self.velocities.axis
        return self.velocities.greatest(np.array([angle, angle + np.pi / 2]))

    @property
    def pan(self) -> Float[np.ndarray, "2"]:
        """Velocity along with the mean of the things, as the limits allow it; px/s."""
        return pan_of(self.velocities, self.limits)

    def exposure(self, num_frames: int, number: float) -> float:
        """Exposure from the shortest to the longest of so many frames; s."""
        longest = self.times.longest_of(num_frames)
        return self.times.shortest * (longest / self.times.shortest) ** number

    def of_stage(self, frames: PlaneFrames) -> PlaneFrames:
        """The frames as the stage makes them, beside a camera that turns."""
        return of_stage(frames, self.velocities, self.limits)

    def within(self, frames: PlaneFrames) -> PlaneFrames:
        """The frames on the same path as fast as the limits of the stage allow, or as it is."""
        stage = self.of_stage(frames)

        def slower(share: float) -> PlaneFrames:
            return eqx.tree_at(lambda x: x.velocities, stage, share * stage.velocities)

        # Shares are convex in the speed and 0 at rest: none of these steps leaves the limits.
        most, share = 1.0, self._share(stage)
        while share > 1 or (most < 1 and share < 1 - _CLOSE):
            most = most / share if math.isfinite(share) else 0.0
            share = self._share(slower(most)) if most else 1.0
        if most == 1:
            return frames
        return _moved(slower(most), self.pan) if stage is not frames else slower(most)

    def _share(self, stage: PlaneFrames) -> float:
        """Greatest share of a limit that the path of a stage takes."""
        limits, use = self.limits, stage.use(self.limits)
        pairs = (
            (use.stroke, limits.max_stroke),
            (use.travel, limits.max_travel),
            (use.top_speed, limits.max_top_speed),
            (stage.acceleration(limits), limits.max_acceleration),
        )
        return max(float(taken) / float(there) for taken, there in pairs if there is not None)

    def panned(self, frames: PlaneFrames) -> PlaneFrames:
        """The frames with the pan of the camera, within the limits."""
        return self.within(_moved(frames, self.pan))

    def at_rest(self, exposures: list[float]) -> PlaneFrames:
        """Frames at rest, one after the other."""
        moments = self.times.moments(exposures)
        whole = moments[-1] - moments[0] + (exposures[0] + exposures[-1]) / 2
        durations = np.full(_LEAST_PIECES, whole / _LEAST_PIECES)
        velocities = np.zeros((2, _LEAST_PIECES + 1))
        return PlaneFrames(moments, np.array(exposures), durations, velocities)

    def equal(
        self, exposure: float, velocities: np.ndarray, durations: np.ndarray, count: int
    ) -> PlaneFrames:
        """Frames of one exposure on a path along the law's axes; px/s."""
        angle = self.velocities.axis
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        period = self.times.period_of(exposure)
        moments = steps_of(count) * period
        missing = max(_LEAST_PIECES - durations.size, 0)
        durations = np.append(durations, np.zeros(missing))
        velocities = np.pad(turn @ velocities, ((0, 0), (0, missing)), mode="edge")
        return self.panned(PlaneFrames(moments, np.full(count, exposure), durations, velocities))

    def by_frame(
        self, count: int, exposure: float, ends: Float[np.ndarray, "2 n 2"]
    ) -> PlaneFrames:
        """Frames of constant acceleration from one velocity to another, and gaps as well."""
        gap = self.times.period_of(exposure) - exposure
        durations = np.tile([exposure, max(gap, 0.0)], count)[:-1]
        return self.equal(exposure, ends.reshape(2, -1), durations, count)


def pan_of(velocities: AbstractVelocities, limits: Limits) -> Float[np.ndarray, "2"]:
    """Velocity along with the mean of the things, as the limits allow it; px/s."""
    centre, most = velocities.centre, float(limits.max_pan)
    speed = float(np.hypot(*centre))
    return centre * min(1.0, most / speed) if speed > 0 else centre


def of_stage(frames: PlaneFrames, velocities: AbstractVelocities, limits: Limits) -> PlaneFrames:
    """Frames that move as the stage makes them, beside a camera that turns."""
    return _moved(frames, -pan_of(velocities, limits)) if limits.pans == "camera" else frames


def _moved(frames: PlaneFrames, velocity: Float[np.ndarray, "2"]) -> PlaneFrames:
    """The frames with a constant velocity beside their own; px/s."""
    return eqx.tree_at(lambda x: x.velocities, frames, frames.velocities + velocity[:, None])


class Family(NamedTuple):
    """A kind of way."""

    kind: str  # Its name
    num_axes: int  # Axes of the stage that it needs
    made: "Callable[[Room, int, Point], PlaneFrames]"  # Makes so many frames at a point of a box
    starts: tuple[tuple[float, ...], ...]  # Points that a search begins with
    least: int = 2  # Least number of frames


def _stills(room: Room, count: int, point: Point) -> PlaneFrames:
    return room.at_rest([room.exposure(count, float(point[0]))] * count)


def _bracketed(room: Room, count: int, point: Point) -> PlaneFrames:
    """One long exposure, and short ones that leave the time for it."""
    short = room.exposure(count, float(point[0]))
    times = room.times
    left = times.window - (count - 1) * times.period_of(short) - times.dead_time
    longest = max(min(times.longest, left), short)
    return room.at_rest([short * (longest / short) ** float(point[1]), *[short] * (count - 1)])


def _panning(room: Room, count: int, point: Point) -> PlaneFrames:
    return room.panned(_stills(room, count, point))


def _one_axis(kind: str) -> "Callable[[Room, int, Point], PlaneFrames]":
    def made(room: Room, count: int, point: Point) -> PlaneFrames:
        exposure = room.exposure(count, float(point[0]))
        way = way_over_frames(kind, count, exposure / 2, room.times.period_of(exposure))
        top = _FASTEST * float(point[1]) * room.half_axes[0]
        velocities = top * np.stack([way.velocities, 0 * way.velocities])
        return room.equal(exposure, velocities, way.durations, count)

    return made


def _two_sines(room: Room, count: int, point: Point) -> PlaneFrames:
    exposure = room.exposure(count, float(point[0]))
    period = room.times.period_of(exposure)
    whole = (count - 1) * period + exposure
    fewest, most = 0.3, max(2.0, float(count))
    turns = fewest * (most / fewest) ** float(point[2])
    drift = 2.0 * float(point[3]) if point.size > 3 else 0.0  # turns by which the phase runs
    pieces = max(_LEAST_PIECES, 2 ** math.ceil(math.log2(32 * (turns + drift / 2))))
    time = np.linspace(-0.5, 0.5, pieces + 1)
    phases = [2 * np.pi * (turns + sign * drift / 2) * time for sign in (-1, 1)]
    # By these factors trapezoids of the velocities add up to the way of the sines.
    steps = [phase[1] - phase[0] for phase in phases]
    shares = [step / 2 / math.tan(step / 2) if step else 1.0 for step in steps]
    speeds = _FASTEST * float(point[1]) * room.half_axes
    velocities = np.stack(
        [
            -speeds[0] * shares[0] * np.sin(phases[0]),
            speeds[1] * shares[1] * np.cos(phases[1]),
        ]
    )
    return room.equal(exposure, velocities, np.full(pieces, whole / pieces), count)


def _crossed(room: Room, count: int, point: Point) -> PlaneFrames:
    longest = _DUTY_OF_CROSS * room.times.period_of(room.exposure(count, 1.0))
    shortest = min(room.times.shortest, longest)
    exposure = shortest * (longest / shortest) ** float(point[0])
    period = max(room.times.period_of(exposure), exposure / _DUTY_OF_CROSS)
    speeds = _FASTEST * float(point[1]) * room.half_axes
    ends = np.zeros((2, count, 2))
    for k in range(count):
        ends[k % 2, k] = speeds[k % 2] * np.array([-1, 1]) * (-1.0) ** (k // 2)
    times = room.times._replace(period=period)
    return room._replace(times=times).by_frame(count, exposure, ends)


def _ring(room: Room, count: int, point: Point) -> PlaneFrames:
    exposure = room.exposure(count, float(point[0]))
    angles = 2 * np.pi * (np.arange(count) + 0.5) / count
    speeds = _FASTEST * float(point[1]) * room.half_axes
    ends = speeds[:, None] * np.stack([np.cos(angles), np.sin(angles)])
    return room.by_frame(count, exposure, np.repeat(ends[..., None], 2, axis=2))


def _turning(*drift: float) -> tuple[tuple[float, ...], ...]:
    """Starts of sines at 0.72 of the top speed and some turns."""
    return tuple((1.0, 0.48, turns, *drift) for turns in (0.25, 0.5, 0.75))


FAMILIES = (
    Family(STILLS, 0, _stills, ((0.5,), (0.75,)), 1),
    Family(BRACKETED, 0, _bracketed, ((0.5, 0.5),)),
    Family(PAN, 1, _panning, ((0.5,), (0.75,)), 1),
    Family(SWEEP, 1, _one_axis(SWEEP), ((1.0, 0.7), (0.9, 0.45)), 1),
    Family(SINE, 1, _one_axis(SINE), ((1.0, 0.65),)),
    Family(ALTERNATING, 1, _one_axis(ALTERNATING), ((0.98, 0.7),)),
    Family(CIRCLE, 2, _two_sines, _turning(), 1),
    Family(TWO_SINES, 2, _two_sines, (*_turning(0.175), *_turning(0.5)), 1),
    Family(CROSSED, 2, _crossed, ((1.0, 0.7),)),
    Family(RING, 2, _ring, ((0.98, 0.45), (0.9, 0.45))),
)
"""Ways from the simplest to those of ever more turns."""


def frames_of(frames: Sequence[TimedFrame], angle: float = 0.0) -> PlaneFrames:
    """Frames along one axis as frames in the plane, of which the gaps say nothing."""
    every = [(frame, Knots.of_exposure(frame.motion)) for frame in frames]
    lengths = [knots.durations for _, knots in every]
    for index, ((before, _), (frame, _)) in enumerate(itertools.pairwise(every)):
        gap = frame.time - before.time - (frame.exposure + before.exposure) / 2
        lengths[index] = np.append(lengths[index], max(gap, 0.0))
    along = np.concatenate([knots.velocities for _, knots in every])
    return PlaneFrames(
        np.array([frame.time for frame, _ in every]),
        np.array([frame.exposure for frame, _ in every]),
        np.concatenate(lengths),
        np.stack([math.cos(angle) * along, math.sin(angle) * along]),
    )
