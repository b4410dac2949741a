"""Searches for bursts: several frames of a picture in place of one exposure, registered.

Registration is taken to be perfect, and to cost nothing. A decoder that registers frames knows the
speed, so that their level is that of `burst_psnr`. Objects that are hidden in some frames, or
outside of the picture, do not count.

One more frame never hurts, so that the greatest numbers of frames alone are tried. What can do more
is never worse: frames that move may stand still, and a burst may be one exposure.
"""

import itertools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core import compiled, outside_trace, require, require_known
from mishutter.evaluation.frames import (
    FrameGroup,
    alternating_frames,
    errors_by_speed,
    in_parts,
    panned_frames,
    plan_of_frames,
    sine_frames,
    steps_of,
    still_frames,
    sweep_frames,
)
from mishutter.evaluation.lengths import distinct_speeds
from mishutter.evaluation.needs import Plan, sizes
from mishutter.evaluation.power import lost_share, power_on_grid
from mishutter.model import (
    AbstractMotion,
    Burst,
    FrameSequence,
    FreeMotion,
    Limits,
    LinearMotion,
    Scene,
    StillCamera,
    TimedFrame,
    filling_half_exposure,
    frequencies,
    noise_power,
    pixel_response,
    white_electrons,
)

STILLS, ONE_PARABOLA = "stills", "one parabola"
ALTERNATING, SINE, SWEEP, FAN = "alternating parabolas", "sine", "sweep", "fan of pans"
"""Paths of a sensor over a burst."""
_STEPS = 4
"""Steps of exposure and acceleration that a search begins with."""
_TOP_SPEEDS = (0.7, 1.2)
"""Top speeds of a sensor, over that of the fastest thing, that a search begins with too."""
_MOST_VELOCITIES = 64
"""Most frames on paths that give each a velocity of its own, whose transfer functions are many."""
_LEAST_GAIN = 0.005
"""Gain of a second exposure below which frames at rest have one; dB."""
_SATURATED = 1e-3
"""Gain of one more frame below which more frames are of no use; dB."""


class StillBurst(NamedTuple):
    """Registered frames of a camera at rest with an ordinary shutter.

    Attributes:
        num_frames: Number of frames.
        exposure: Exposure of each; s.
        psnr: PSNR of the best linear decoder, which knows the speed, in linear light; dB.
    """

    num_frames: int
    exposure: float
    psnr: float


class FrameTimes(NamedTuple):
    """When a camera may expose frames; all in s.

    Attributes:
        period: From one frame to the next.
        window: Longest time from the first light to the last of several frames.
        shortest: Shortest exposure.
        longest: Longest exposure that limits and a full pixel leave.
        dead_time: Least time from the end of a frame to the next.
        max_frames: Most frames; None for any number.
    """

    period: float
    window: float
    shortest: float
    longest: float
    dead_time: float = 0.0
    max_frames: int | None = None

    @staticmethod
    def of(scene: Scene, burst: Burst) -> "FrameTimes":
        """The times of a camera that takes a burst."""
        period, others = 1 / float(burst.frames_per_s), (float(burst.dead_time), burst.max_frames)
        return FrameTimes(period, _window(scene), *_exposures(scene), *others)

    def longest_of(self, num_frames: int) -> float:
        """Longest exposure of each of some frames: one alone waits for no other."""
        if num_frames == 1:
            return self.longest
        rest = self.window - (num_frames - 1) * self.period
        return min(self.longest, self.period - self.dead_time, rest)

    @property
    def numbers_of_frames(self) -> list[int]:
        """The numbers of frames that there is time for, ascending."""
        most = 1 + int(self.window / self.period)
        several = range(2, 1 + min(most, self.max_frames or most))
        return [1, *(n for n in several if self.longest_of(n) >= self.shortest)]

    @property
    def best_numbers(self) -> list[int]:
        """The numbers that may be best: the greatest, and the next if that leaves more time."""
        *fewer, most = self.numbers_of_frames
        return [most, *(n for n in fewer[-1:] if self.longest_of(n) > 1.01 * self.longest_of(most))]


class StillBursts:
    """The bursts of a camera at rest within the window of a scene's burst, by NumPy alone.

    Without a burst the window is as long as the longest exposure.

    The verdict on every scene names one of them, so that they must not cost a compiled program:
    the response of a frame at rest has a closed form.

    Args:
        scene: Speeds, light, noise and limits; concrete.
        at_worst: Whether the level is that at the worst of the speeds, and not of the mean error.
        window: Another window; s.
    """

    def __init__(
        self, scene: Scene, *, at_worst: bool = False, window: float | None = None
    ) -> None:
        self._window = _window(scene) if window is None else window
        self._scene, self._at_worst = in_parts(scene), at_worst
        self._shortest, self._longest = _exposures(scene)
        found = distinct_speeds(self._scene, folds=True)
        self._speeds, weights = (x.astype(np.float64) for x in found)
        self._weights = weights / weights.sum()
        motion = LinearMotion(half_exposure=self._longest / 2)
        count = sizes(self._scene, motion).num_frequencies
        self._frequency, self._power = frequencies(count), power_on_grid(self._scene, count)
        blur = float(scene.optics.lens_blur)
        self._aperture = np.asarray(pixel_response(self._frequency, blur)) ** 2

    def error(self, num_frames: int, exposure: float) -> float:
        """Squared error that is left by some frames of an exposure, s; white = 1."""
        return self._error(self._gained(num_frames, exposure))

    def _gained(self, num_frames: int, exposure: float) -> Float[np.ndarray, "n m"]:
        """Power of the picture over that of the noise in frames of an exposure, by speed."""
        scene = self._scene
        rate, mean, read = (
            float(x) for x in (scene.photon_rate, scene.picture.mean_level, scene.read_noise)
        )
        electrons = white_electrons(rate, exposure)
        noise = noise_power(1.0, mean, electrons, read)
        passed = np.sinc(self._frequency * exposure * self._speeds[:, None]) ** 2 * self._aperture
        lost = lost_share(self._power * electrons**2, passed, 0.0 * passed, noise)
        with np.errstate(divide="ignore"):
            return num_frames * (1 / lost - 1)

    def _error(self, gained: Float[np.ndarray, "n m"]) -> float:
        errors = np.mean(self._power / (1 + gained), axis=1)
        return float(np.max(errors) if self._at_worst else self._weights @ errors)

    def best(
        self, frames_per_s: float, *, max_frames: int | None = None, dead_time: float = 0.0
    ) -> StillBurst:
        """The burst of the least error at a frame rate, of any number of frames or at most some.

        Args:
            frames_per_s: The rate.
            max_frames: Most frames; None for any number.
            dead_time: Least time from the end of a frame to the next; s.
        """
        ends = self._window, self._shortest, self._longest
        return self.best_within(FrameTimes(1 / frames_per_s, *ends, dead_time, max_frames))

    def best_within(self, times: FrameTimes) -> StillBurst:
        """The burst of the least error of frames at these times."""
        numbers = times.numbers_of_frames
        bursts = [self._of(count, times.longest_of(count)) for count in numbers]
        return max(bursts, key=lambda burst: burst.psnr)

    def best_bracketed(self, times: FrameTimes) -> tuple[list[StillBurst], float]:
        """Frames of two exposures, the longer first, and their level together; dB."""
        from scipy.optimize import minimize

        found = []
        for count in times.best_numbers:
            longest = times.longest_of(count)
            equal = self._of(count, longest)
            ends = math.log(self._shortest), math.log(longest)
            found.append((10 ** (-equal.psnr / 10), (count,), (equal.exposure,)))
            for num_long in _some_numbers(count - 1):
                numbers = num_long, count - num_long

                def left(places: Float[np.ndarray, "2"], first: int, second: int) -> float:
                    exposures = [float(x) for x in np.exp(places)]
                    gained = self._gained(first, exposures[0]) + self._gained(second, exposures[1])
                    return self._error(gained)

                start = np.clip([ends[1], math.log(equal.exposure)], *ends)
                end: Any = minimize(left, start, numbers, method="Nelder-Mead", bounds=[ends] * 2)
                found.append((float(end.fun), numbers, tuple(np.exp(end.x))))
        error, numbers, exposures = min(found)
        level = _psnr(error)
        pairs = sorted(zip(exposures, numbers, strict=True), reverse=True)
        return [StillBurst(n, float(x), level) for x, n in pairs], level

    def number_that_equals(self, psnr: float, *, most: int) -> int | None:
        """The least number of frames, without a gap between them, that has a level.

        None where none up to some has it: frames that follow each other without a gap come to a
        level at which more of them, as short as that, are of no use.

        Args:
            psnr: The level; dB.
            most: The greatest number.
        """
        before = -math.inf
        for count in range(1, 1 + most):
            level = self._of(count, self._window / count).psnr
            if level >= psnr:
                return count
            if count > 1 and level < before + _SATURATED:
                return None
            before = level
        return None

    def rate_that_equals(self, psnr: float, *, most: float) -> float | None:
        """The least frame rate at which a burst has a level; 1/s.

        None where no rate up to some has it.

        Args:
            psnr: The level; dB.
            most: The greatest rate; 1/s.
        """
        from scipy.optimize import brentq

        count = self.number_that_equals(psnr, most=1 + int(most * self._window))
        if count is None:
            return None
        count = max(count, 2)

        def above(exposure: float) -> float:
            return _psnr(self.error(count, exposure)) - psnr

        # The shortest frames that are enough leave the longest time for the gaps between them.
        exposure = self._shortest
        if above(exposure) < 0:
            root: Any = brentq(above, exposure, self._of(count, self._window / count).exposure)
            exposure = float(root)
        rate = (count - 1) / (self._window - exposure)
        return rate if rate <= most else None

    def _of(self, num_frames: int, longest: float) -> StillBurst:
        """Some frames of the best exposure up to the longest, s."""
        from scipy.optimize import minimize_scalar

        longest = max(min(longest, self._longest), self._shortest)
        ends = math.log(self._shortest), math.log(longest)
        places = [*ends]
        if ends[0] < ends[1]:
            end: Any = minimize_scalar(
                lambda place: self.error(num_frames, math.exp(place)),
                bounds=ends,
                method="bounded",
                options={"xatol": 1e-3},
            )
            places.append(float(end.x))
        error, place = min((self.error(num_frames, math.exp(x)), x) for x in places)
        return StillBurst(num_frames, math.exp(place), _psnr(error))


def _some_numbers(most: int) -> list[int]:
    """Numbers from 1 to a greatest: all of few, and ever fewer of many."""
    return np.unique(np.geomspace(1, most, 12).round().astype(int)).tolist() if most else []


class _Room(NamedTuple):
    """The room of a stage for the motion of some frames beside a pan of the sensor.

    Attributes:
        limits: The scene's limits.
        times: When frames may be exposed.
        num_frames: Number of frames that move.
        pan: Velocity that all frames have; px/s.
    """

    limits: Limits
    times: FrameTimes
    num_frames: int
    pan: float

    @property
    def panned(self) -> float:
        """Travel that the pan takes from the stage; px."""
        return 0.0 if self.limits.pans == "camera" else abs(self.pan) * self.duration

    @property
    def duration(self) -> float:
        """Longest time from first to last light; s."""
        longest = self.times.longest_of(self.num_frames)
        return (self.num_frames - 1) * self.times.period + longest

    @property
    def stroke(self) -> float:
        """Travel from the lowest to the highest position that is left; px."""
        travel = self.limits.max_travel
        most = float(self.limits.max_stroke)
        most = most if travel is None else min(most, float(travel))
        return max(most - self.panned, 0.0)

    @property
    def top_speed(self) -> float:
        """Speed that is left; px/s."""
        return max(float(self.limits.max_top_speed) - abs(self.pan), 0.0)

    @property
    def acceleration(self) -> float:
        """Greatest mechanical acceleration; px/s^2."""
        most = self.limits.max_acceleration
        return math.inf if most is None else float(most)

    def largest_acceleration(self, half_exposure: float) -> float:
        """The largest $a$ of a parabola of this half exposure, s; px/s^2."""
        numbers = jnp.asarray(half_exposure), jnp.asarray(self.pan)
        return float(self.limits.largest_acceleration(*numbers))


class _Moving(NamedTuple):
    """Frames of a sensor that moves, and what they ask of its stage.

    Attributes:
        group: The frames.
        motions: Makes the motion of each without the pan, its direction right.
        positions: Places of the stage at their mid-exposures, without the pan; px.
        travel: From its lowest to its highest position, without the pan; px.
        start_speed: Speed of the stage at first light; px/s.
    """

    group: FrameGroup
    motions: Callable[[], list[AbstractMotion]]
    positions: Float[np.ndarray, "n"]
    travel: float
    start_speed: float


def _alternating(room: _Room, half: float, share: float) -> _Moving:
    """Parabolas of alternating direction, between which the stage coasts at constant velocity."""
    count = room.num_frames
    swing = 2 * half * (room.times.period - half) if count > 1 else half**2  # of acceleration 1
    a = share * min(room.largest_acceleration(half), room.stroke / swing)
    group = alternating_frames(count, half, a)
    odd = np.arange(count) % 2

    def motions() -> list[AbstractMotion]:
        back = FreeMotion(accelerations=[-a], half_exposure=half)
        return [back if k else group.motion for k in odd]

    return _Moving(group, motions, a * swing * odd, a * swing, 2 * a * half)


def _sine(room: _Room, half: float, share: float) -> _Moving:
    """A sine of half the frame rate, whose turning points are at the middles of the frames."""
    count, turn = room.num_frames, np.pi / room.times.period
    room_for = room.stroke / 2, room.top_speed / turn, room.acceleration / turn**2
    amplitude = share * min(room_for)
    stroke = amplitude * (1 - math.cos(turn * half))
    group = sine_frames(count, half, stroke, room.times.period)
    odd, start = np.arange(count) % 2, amplitude * turn * math.sin(turn * half)

    def motions() -> list[AbstractMotion]:
        back = eqx.tree_at(lambda path: path.accelerations, group.motion, replace_fn=jnp.negative)
        return [back if k else group.motion for k in odd]

    return _Moving(group, motions, 2 * amplitude * odd, 2 * amplitude, start)


def _sweep(room: _Room, half: float, share: float) -> _Moving:
    """One slow parabola over the whole burst."""
    count, period = room.num_frames, room.times.period
    whole = ((count - 1) * period + 2 * half) / 2
    a = share * min(room.largest_acceleration(whole), room.stroke / whole**2)
    group = sweep_frames(count, half, a, period)
    times = steps_of(count) * period

    def motions() -> list[AbstractMotion]:
        return [group.motion.panned(2 * a * time) for time in times]

    return _Moving(group, motions, a * times**2, a * whole**2, 2 * a * whole)


def _fan(room: _Room, half: float, share: float) -> _Moving:
    """Frames at constant velocities in equal steps, between which the stage accelerates evenly."""
    count, period = room.num_frames, room.times.period
    steps = 2 * steps_of(count) / (count - 1)
    times = steps_of(count) * period
    knots = np.sort(np.r_[times - half, 0.0, times + half])
    velocity = np.interp(knots, np.c_[times - half, times + half].ravel(), np.repeat(steps, 2))
    ways = np.diff(knots) * (velocity[1:] + velocity[:-1]) / 2
    places = np.r_[0.0, np.cumsum(ways)]
    travel = float(np.ptp(places))  # of the top speed 1
    top = min(room.top_speed, room.stroke / travel)
    if room.acceleration < math.inf:
        top = min(top, room.acceleration * (period - 2 * half) * (count - 1) / 2)
    top = share * top
    group = panned_frames(count, half, top)

    def motions() -> list[AbstractMotion]:
        return [group.motion.panned(velocity) for velocity in top * steps]

    return _Moving(group, motions, top * np.interp(times, knots, places), top * travel, top)


_KINDS: dict[str, Callable[[_Room, float, float], _Moving]] = {
    ALTERNATING: _alternating,
    SINE: _sine,
    SWEEP: _sweep,
    FAN: _fan,
}
"""Paths of a sensor over a burst, by their names."""


def best_still_burst(scene: Scene) -> FrameSequence | None:
    """The burst of least error of a camera at rest; None without `scene.burst`.

    The frames follow each other at the rate of the burst, with its dead time between them, and all
    of them within its window; no frame fills a pixel. They have one exposure, or two where that
    gains more than two decimals hide.
    """
    require_known("best_still_burst", scene=scene)
    if scene.burst is None:
        return None
    bursts, times = StillBursts(scene), FrameTimes.of(scene, scene.burst)
    equal = bursts.best_within(times)
    kinds, level = bursts.best_bracketed(times)
    if level < equal.psnr + _LEAST_GAIN:
        kinds = [equal]
    every = [StillCamera(half_exposure=x.exposure / 2) for x in kinds for _ in range(x.num_frames)]
    moments = steps_of(len(every)) * times.period
    frames = tuple(TimedFrame(*each) for each in zip(every, moments.tolist(), strict=True))
    groups = [still_frames(x.num_frames, x.exposure / 2) for x in kinds]
    errors = np.asarray(errors_by_speed(in_parts(scene), groups))
    return FrameSequence(STILLS, frames, 0.0, kinds[0].psnr, _psnr(float(np.max(errors))))


@outside_trace()
def best_moving_burst(scene: Scene) -> FrameSequence | None:
    """The burst of least error of a sensor that moves; None without `scene.burst`.

    The stage follows parabolas of alternating direction, a sine of half the frame rate, one slow
    parabola over the whole burst or a fan of pans, of at most 64 frames, or makes one exposure
    alone. Before the first of the frames that move there may be one at rest. The limits hold over
    the burst, and the sensor pans at the middle of the speeds, as far as it may. The frames have
    the times of those of `best_still_burst`.
    """
    require_known("best_moving_burst", scene=scene)
    if scene.burst is None:
        return None
    times, whole = FrameTimes.of(scene, scene.burst), in_parts(scene).bare()
    tries = [
        _Try(kind, _Room(scene.limits, times, count - rests, pan), rests)
        for count in sorted({*times.best_numbers, 1})
        for pan in _pans(scene, times, count)
        for rests in ((False, True) if pan == 0 or scene.limits.pans == "stage" else (False,))
        for kind in _kinds_of(count - rests)
    ]
    ends = [each.at(np.array([x, 1.0, 1.0])).groups for each in tries for x in (0.0, 1.0)]
    plan = plan_of_frames(whole, [group for groups in ends for group in groups])
    return max((_best_of(whole, each, plan) for each in tries), key=lambda found: found.psnr)


def _kinds_of(num_moving: int) -> list[str]:
    """The paths that some frames may follow: one alone is on a parabola."""
    if num_moving > _MOST_VELOCITIES:
        return [ALTERNATING, SINE]
    return [*_KINDS] if num_moving > 1 else [ALTERNATING] * num_moving


class _Place(NamedTuple):
    """The frames at a point of the unit box of a search.

    Attributes:
        moving: Those that move.
        rest: Exposure of the one before them, which is at rest; s. 0 without one.
        pan: Velocity of those that move; px/s.
    """

    moving: _Moving
    rest: float
    pan: float

    @property
    def groups(self) -> tuple[FrameGroup, FrameGroup]:
        """The frames that move, and the one that does not."""
        group = self.moving.group
        velocities = np.asarray(group.velocities) + self.pan
        rest = still_frames(1, (self.rest or float(group.motion.exposure)) / 2)
        return (
            group._replace(velocities=velocities, num_each=np.asarray(float(group.num_each))),
            rest._replace(num_each=np.asarray(float(self.rest > 0))),
        )


class _Try(NamedTuple):
    """A search: a kind of path, for frames that may be preceded by one at rest."""

    kind: str
    room: _Room
    rests: bool

    @property
    def num_frames(self) -> int:
        """Number of frames, that at rest included."""
        return self.room.num_frames + self.rests

    def at(self, place: Float[np.ndarray, "d"]) -> _Place:
        """The frames at a point: exposure, share of the largest acceleration, exposure at rest.

        There is no time for a frame at rest, which then lasts below the shortest exposure, where
        the stage takes all of it to run up.
        """
        room, times = self.room, self.room.times
        shortest, longest = times.shortest, times.longest_of(self.num_frames)
        half = shortest * (longest / shortest) ** float(place[0]) / 2
        moving = _KINDS[self.kind](room, half, float(place[1]))
        if not self.rests:
            return _Place(moving, 0.0, room.pan)
        run_up = (moving.start_speed + abs(room.pan)) / room.acceleration
        left = min(longest, 2 * (times.period - half - times.dead_time - run_up))
        rest = shortest * max(left / shortest, 1e-9) ** float(place[2])
        return _Place(moving, rest, room.pan)

    def sequence(self, place: _Place, errors: Float[np.ndarray, "n"], mean: float) -> FrameSequence:
        """The frames in their order."""
        room, moving, pan = self.room, place.moving, place.pan
        motions = [motion.panned(motion.velocity + pan) for motion in moving.motions()]
        times = steps_of(self.num_frames) * room.times.period
        positions = moving.positions + pan * times[self.rests :]
        if self.rests:
            half = np.asarray(-motions[0].half_exposure)
            start = float(motions[0].velocity_at(half))
            run_up = start * abs(start) / (2 * room.acceleration)
            before = positions[0] + float(motions[0].position(half)) - run_up
            motions = [StillCamera(half_exposure=place.rest / 2), *motions]
            positions = np.r_[before, positions]
        frames = zip(motions, times.tolist(), positions.tolist(), strict=True)
        kind = self.kind if self.num_frames > 1 else ONE_PARABOLA
        return FrameSequence(
            kind,
            tuple(TimedFrame(*each) for each in frames),
            moving.travel + room.panned,
            _psnr(mean),
            _psnr(float(np.max(errors))),
            pan if room.limits.pans == "camera" else 0.0,
        )


def _best_of(scene: Scene, each: _Try, plan: Plan) -> FrameSequence:
    """The best exposures and acceleration of some frames, by a grid and a simplex from its best."""
    from scipy.optimize import minimize

    weights = np.asarray(scene.weights, np.float64)

    def errors(place: _Place) -> Float[np.ndarray, "n"]:
        return np.asarray(_errors_of(scene, place.groups, plan), np.float64)

    def loss(point: Float[np.ndarray, "d"]) -> float:
        place = each.at(point)
        if each.rests and place.rest < each.room.times.shortest:
            return math.inf
        return float(weights @ errors(place))

    rests, steps = [(0.5, 1.0)] * each.rests, np.linspace(0, 1, _STEPS)
    grid = [np.array(point) for point in itertools.product(steps, steps, *rests)]
    # Where the limits leave room for far more than pays, every step of the grid is too much.
    fastest = float(np.max(np.abs(np.asarray(scene.speeds) - each.room.pan)))
    for exposure, *rest in itertools.product(steps[1:], *rests):
        most = each.at(np.array([exposure, 1.0, *rest])).moving.start_speed
        for speed in (top * fastest for top in _TOP_SPEEDS):
            if 0 < speed < most:
                grid.append(np.array([exposure, speed / most, *rest]))
    start = min(grid, key=loss)
    bounds, options = [(0, 1)] * start.size, {"xatol": 1e-3, "fatol": 1e-9}
    end: Any = minimize(loss, start, method="Nelder-Mead", bounds=bounds, options=options)
    place = each.at(end.x)
    return each.sequence(place, errors(place), float(end.fun))


@compiled
def _errors_of(
    scene: Scene, groups: tuple[FrameGroup, FrameGroup], plan: Plan
) -> Float[Array, "n"]:
    """The `errors_by_speed` as one program, which serves all frames of a kind."""
    return errors_by_speed(scene, groups, plan=plan)


def _window(scene: Scene) -> float:
    """Longest time from the first light of a burst to its last; s."""
    if scene.burst is None or scene.burst.window is None:
        return 2 * float(scene.limits.max_half_exposure)
    return float(scene.burst.window)


def _exposures(scene: Scene) -> tuple[float, float]:
    """Shortest and longest exposure that limits and a full pixel leave one frame; s.

    Raises:
        ValueError: if the shortest fills a pixel.
    """
    limits = scene.limits
    shortest, longest = 2 * float(limits.min_half_exposure), 2 * float(limits.max_half_exposure)
    full_well = scene.sensor.full_well
    if full_well is None:
        return shortest, longest
    filling = 2 * float(filling_half_exposure(full_well, scene.photon_rate))
    requirement = f"not be full within the shortest exposure, {shortest:g} s"
    require(shortest <= filling, "Sensor(full_well=...)", requirement, full_well)
    return shortest, min(longest, filling)


def _psnr(error: float) -> float:
    """The level of a squared error; dB. Without any error it is infinite."""
    return -10 * math.log10(error) if error > 0 else math.inf


def _pans(scene: Scene, times: FrameTimes, num_frames: int) -> list[float]:
    """Velocities to pan at: the middle of the speeds, as near as a sensor may; of a stage none too.

    The pan of a stage takes its stroke from the parabolas.
    """
    limits, on_stage = scene.limits, scene.limits.pans == "stage"
    most = min(float(limits.max_pan), float(limits.max_top_speed))
    if on_stage:
        most = min(most, float(limits.max_stroke) / _Room(limits, times, num_frames, 0.0).duration)
    middle = sum(float(speed) for speed in scene.speed_range) / 2
    pan = min(max(middle, -most), most)
    return [0.0, pan] if on_stage and pan else [pan]
