"""Searches for bursts: several frames of a picture in place of one exposure, registered.

Registration is taken to be perfect, and to cost nothing. A decoder that registers frames knows the
speed, so that their level is that of `burst_psnr`. Objects that are hidden in some frames, or
outside of the picture, do not count.

One more frame never hurts, so that a burst has as many as there is time for. Fewer of them may
move, where the travel of a stage is short: those before them stand still. What can do more is never
worse: frames that move may stand still, and a burst may be one exposure.
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
    ParabolicMotion,
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
_STEPS = 3
"""Steps of exposure and top speed that a search begins with."""
_STEP = 0.15
"""Step of a simplex."""
_FIRST_STEPS, _MOST_STEPS = 12, 60
"""Steps of a simplex on every path, for each of its numbers, and more of them on the best paths."""
_NUM_PANS, _NUM_PATHS = 2, 3
"""Pans of each path, and paths of all, that are searched further."""
_FEW = 3
"""Most frames that may gain by following one direction where both are alike."""
_SAME_LOSS, _SAME_SHARE = 1e-7, 1e-6
"""Shares within which an error and a top speed are found."""
_PIECES_OF_PERIOD = 32
"""Pieces of constant acceleration of the way of a sine from frame to frame."""
_TOP_SPEEDS = (0.7, 1.0, 1.2)
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


class _Way(NamedTuple):
    """The way of a sensor over a burst, as its velocity, which is linear between knots.

    Attributes:
        knots: Times; s, ascending.
        velocity: Velocity at each over the top speed.
        frames: Makes its frames of the top speed, px/s.
        half_of_parabola: Half the exposure of the parabola that it is, or its frames are; s. None
            where they are none.
        back: Makes the motion of every other frame, which goes the other way, of that of the first;
            None where none does.
    """

    knots: Float[np.ndarray, "k"]
    velocity: Float[np.ndarray, "k"]
    frames: Callable[[float], FrameGroup]
    half_of_parabola: float | None = None
    back: Callable[[Any], AbstractMotion] | None = None

    @property
    def steepest(self) -> float:
        """Greatest acceleration at the top speed 1; 1/s."""
        steps, changes = np.diff(self.knots), np.abs(np.diff(self.velocity))
        with np.errstate(divide="ignore"):
            return float(np.max(changes[changes > 0] / steps[changes > 0]))

    def places(self, top_speed: float, pan: float) -> Float[np.ndarray, "k"]:
        """Place at each knot; px."""
        velocity = pan + top_speed * self.velocity
        ways = np.diff(self.knots) * (velocity[1:] + velocity[:-1]) / 2
        return np.r_[0.0, np.cumsum(ways)]

    def velocity_at(self, time: float, top_speed: float, pan: float) -> float:
        """Velocity at a time, s; px/s."""
        return pan + top_speed * float(np.interp(time, self.knots, self.velocity))

    def travel(self, top_speed: float, pan: float) -> float:
        """Distance from the lowest place to the highest; px."""
        velocity, places = pan + top_speed * self.velocity, self.places(top_speed, pan)
        first, last, steps = velocity[:-1], velocity[1:], np.diff(self.knots)
        # Where the velocity changes its sign between two knots, the stage turns back.
        turns = first * last < 0
        first, last, steps = first[turns], last[turns], steps[turns]
        turned = places[:-1][turns] + first**2 / (first - last) * steps / 2
        return float(np.ptp(np.r_[places, turned]))


def _alternating(count: int, half: float, period: float) -> _Way:
    """Parabolas of alternating direction, between which the stage coasts at constant velocity."""
    velocity = np.outer((-1.0) ** np.arange(count), [-1, 0, 1]).ravel()

    def frames(top_speed: float) -> FrameGroup:
        return alternating_frames(count, half, top_speed / (2 * half))

    def back(motion: ParabolicMotion) -> FreeMotion:
        return FreeMotion(accelerations=-motion.acceleration[None], half_exposure=half)

    return _Way(_knots(count, half, period), velocity, frames, half, back)


def _sine(count: int, half: float, period: float) -> _Way:
    """A sine of half the frame rate, whose turning points are at the middles of the frames."""
    turn = np.pi / _PIECES_OF_PERIOD
    phases = turn * np.arange(-_PIECES_OF_PERIOD // 2, (2 * count - 1) * _PIECES_OF_PERIOD // 2 + 1)
    knots = steps_of(count)[0] * period + phases * period / np.pi
    # With this factor the trapezoids of the velocity add up to the way of the sine.
    velocity = np.sin(phases) * (turn / 2) / math.tan(turn / 2)

    def frames(top_speed: float) -> FrameGroup:
        stroke = top_speed * period / np.pi * (1 - math.cos(np.pi * half / period))
        return sine_frames(count, half, stroke, period)

    def back(motion: FreeMotion) -> FreeMotion:
        return eqx.tree_at(lambda path: path.accelerations, motion, replace_fn=jnp.negative)

    return _Way(knots, velocity, frames, back=back)


def _sweep(count: int, half: float, period: float) -> _Way:
    """One slow parabola over the whole burst."""
    knots, whole = _knots(count, half, period), (count - 1) * period / 2 + half

    def frames(top_speed: float) -> FrameGroup:
        return sweep_frames(count, half, top_speed / (2 * whole), period)

    return _Way(knots, knots / whole, frames, whole)


def _fan(count: int, half: float, period: float) -> _Way:
    """Frames at constant velocities in equal steps, between which the stage accelerates evenly."""
    velocity = np.repeat(np.linspace(-1, 1, count), 3)

    def frames(top_speed: float) -> FrameGroup:
        return panned_frames(count, half, top_speed)

    return _Way(_knots(count, half, period), velocity, frames)


def _knots(count: int, half: float, period: float) -> Float[np.ndarray, "k"]:
    """Beginning, middle and end of each frame; s."""
    return (steps_of(count)[:, None] * period + half * np.array([-1, 0, 1])).ravel()


_KINDS: dict[str, Callable[[int, float, float], _Way]] = {
    ALTERNATING: _alternating,
    SINE: _sine,
    SWEEP: _sweep,
    FAN: _fan,
}
"""Ways of a sensor over a burst, by their names."""


class _Room(NamedTuple):
    """The room that limits leave for the motion of some frames.

    Attributes:
        limits: The scene's limits.
        times: When frames may be exposed.
        num_frames: Number of frames that move.
    """

    limits: Limits
    times: FrameTimes
    num_frames: int

    @property
    def acceleration(self) -> float:
        """Greatest mechanical acceleration; px/s^2."""
        most = self.limits.max_acceleration
        return math.inf if most is None else float(most)

    @property
    def stroke(self) -> float:
        """Travel from the lowest to the highest position; px."""
        travel = self.limits.max_travel
        most = float(self.limits.max_stroke)
        return most if travel is None else min(most, float(travel))

    def first_light(self, half: float) -> float:
        """Beginning of the first frame of a half exposure, s, from the middle of all; s."""
        return float(steps_of(self.num_frames)[0]) * self.times.period - half

    def panned(self, pan: float) -> float:
        """Velocity of a stage for a pan, px/s: 0 where the camera turns."""
        return 0.0 if self.limits.pans == "camera" else pan

    def nearest_pan(self, pan: float, half: float) -> float:
        """The velocity nearest to one, at which all frames of a half exposure may pan; px/s."""
        most = min(float(self.limits.max_pan), float(self.limits.max_top_speed))
        if self.limits.pans == "stage":
            most = min(most, self.stroke / ((self.num_frames - 1) * self.times.period + 2 * half))
        return min(max(pan, -most), most)

    def largest_top_speed(self, way: _Way, pan: float) -> float:
        """The largest top speed of a way beside a pan, px/s."""
        most = max(float(self.limits.max_top_speed) - abs(pan), 0.0)
        if self.limits.has_stage and way.half_of_parabola is not None:
            numbers = jnp.asarray(way.half_of_parabola), jnp.asarray(pan)
            largest = float(self.limits.largest_acceleration(*numbers))
            most = min(most, 2 * largest * way.half_of_parabola)
        if self.acceleration < math.inf:
            most = min(most, self.acceleration / way.steepest)
        pan = self.panned(pan)
        if way.travel(most, pan) <= self.stroke:
            return most
        if pan == 0:
            return self.stroke / way.travel(1.0, pan)
        # The travel is convex in the top speed, and that of the pan alone is within the stroke.
        low, high = 0.0, most
        while high - low > _SAME_SHARE * most:
            middle = (low + high) / 2
            fits = way.travel(middle, pan) <= self.stroke
            low, high = (middle, high) if fits else (low, middle)
        return low


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
    alone. Before the frames that move there may be one at rest, or as many as leave the others the
    travel that they want. The limits hold over the burst, and the sensor may pan beside all that.
    The frames have the times of those of `best_still_burst`.
    """
    require_known("best_moving_burst", scene=scene)
    if scene.burst is None:
        return None
    times, whole = FrameTimes.of(scene, scene.burst), in_parts(scene).bare()
    pans = not (_is_mirrored(whole) and max(times.best_numbers) > _FEW)
    if not pans:
        # Without a pan a burst leaves as much at opposite speeds.
        speeds, weights = distinct_speeds(whole, folds=True)
        whole = whole.bare(speeds=speeds, weights=weights)
    slowest, fastest = (float(x) for x in whole.speed_range)
    farthest = max(abs(slowest), abs(fastest))
    tries = [
        _Try(kind, room, rests, pans, slowest, fastest)
        for count in sorted({*times.best_numbers, 1})
        for kind in _KINDS
        for moving in _moving_numbers(kind, count, _Room(scene.limits, times, count), farthest)
        for room in [_Room(scene.limits, times, moving)]
        # A stage that has to run up may have no time for frames at rest.
        for rests in sorted({count - moving, 0 if room.acceleration < math.inf else count - moving})
    ]
    return _best_of(whole, tries)


def _is_mirrored(scene: Scene) -> bool:
    """Whether every speed is as likely as its opposite."""
    one, other = (
        np.concatenate(distinct_speeds(x, folds=False))
        for x in (scene, scene.bare(speeds=-scene.speeds))
    )
    return one.shape == other.shape and np.allclose(one, other)


def _moving_numbers(kind: str, count: int, room: _Room, farthest: float) -> list[int]:
    """Numbers of frames that may move, of some: all, all but one, or few.

    Of a sweep and a fan fewer frames are faster where the travel is limited, and one parabola needs
    less travel than several that alternate.
    """
    if kind == ALTERNATING:
        return sorted({count, count - 1, 1} - {0})
    if kind == SINE:
        return [number for number in (count - 1, count) if number > 1]
    way = max(_TOP_SPEEDS) * farthest * room.times.period / 4
    as_fast = math.ceil(room.stroke / way) if room.stroke < count * way else count
    numbers = {count, count - 1, count // 2, as_fast}
    return sorted(number for number in numbers if 1 < number <= _MOST_VELOCITIES)


class _Place(NamedTuple):
    """The frames at a point of the unit box of a search.

    Attributes:
        way: The way of those that move.
        top_speed: Its top speed; px/s.
        half: Half the exposure of each of them; s.
        rest: Exposure of those before them, which are at rest; s.
        pan: Velocity of those that move; px/s.
        num_rests: Number of those at rest.
    """

    way: _Way
    top_speed: float
    half: float
    rest: float
    pan: float
    num_rests: int = 0

    @property
    def groups(self) -> tuple[FrameGroup, FrameGroup]:
        """The frames that move, and those that do not."""
        group = self.way.frames(self.top_speed)
        rest = still_frames(1, self.rest / 2)
        return (
            group._replace(
                velocities=np.asarray(group.velocities) + self.pan,
                num_each=np.asarray(float(group.num_each)),
            ),
            rest._replace(num_each=np.asarray(float(self.num_rests))),
        )


class _Try(NamedTuple):
    """A search: a kind of path, for frames that may be preceded by some at rest.

    Attributes:
        kind: The path.
        room: The room of the frames that move.
        num_rests: Number of frames at rest.
        pans: Whether those that move may pan.
        slowest: Least of the speeds; px/s, either sign.
        fastest: Greatest of the speeds; px/s.
    """

    kind: str
    room: _Room
    num_rests: int
    pans: bool
    slowest: float
    fastest: float

    @property
    def num_frames(self) -> int:
        """Number of frames, those at rest included."""
        return self.room.num_frames + self.num_rests

    @property
    def may_pan(self) -> bool:
        """Whether frames may pan: a camera that turns does not rest for one of them."""
        limits = self.room.limits
        is_held = self.num_rests > 0 and limits.pans == "camera"
        return self.pans and float(limits.max_pan) > 0 and not is_held

    @property
    def slowest_pan(self) -> float:
        """Least velocity that is worth a pan; px/s."""
        return min(0.0, self.slowest)

    @property
    def pan_range(self) -> float:
        """Range of the velocities that are; px/s."""
        return max(0.0, self.fastest) - self.slowest_pan if self.may_pan else 0.0

    def at(self, point: Float[np.ndarray, "4"]) -> _Place:
        """The frames at a point: exposure, share of the top speed, exposure at rest, pan.

        There is no time for a frame at rest, which then lasts below the shortest exposure, where
        the stage takes all of it to run up.
        """
        room, times = self.room, self.room.times
        shortest, longest = times.shortest, times.longest_of(self.num_frames)
        half = shortest * (longest / shortest) ** float(point[0]) / 2
        pan = 0.0
        if self.may_pan:
            pan = room.nearest_pan(self.slowest_pan + float(point[3]) * self.pan_range, half)
        way = _KINDS[self.kind](room.num_frames, half, times.period)
        place = _Place(way, float(point[1]) * room.largest_top_speed(way, pan), half, 2 * half, pan)
        if not self.num_rests:
            return place
        start = way.velocity_at(room.first_light(half), place.top_speed, pan)
        left = 2 * (times.period - half - times.dead_time - abs(start) / room.acceleration)
        rest = shortest * max(min(left, longest) / shortest, 1e-9) ** float(point[2])
        return place._replace(rest=rest, num_rests=self.num_rests)

    @property
    def grids(self) -> list[list[Float[np.ndarray, "4"]]]:
        """Points that a search begins with, by pan."""
        pans = {0.0}
        if self.may_pan:
            pans |= {*np.linspace(self.slowest, self.fastest, 2 + _STEPS)[1:-1].tolist()}
        return [self._grid(pan) for pan in sorted(pans)]

    def _grid(self, pan: float) -> list[Float[np.ndarray, "4"]]:
        steps = np.arange(1, 1 + _STEPS) / _STEPS
        place = (pan - self.slowest_pan) / self.pan_range if self.may_pan else 0.0
        farthest = max(abs(self.fastest - pan), abs(self.slowest - pan))
        # One kind alone has to try frames that stand still.
        still = [0.0] if self.kind == ALTERNATING and not self.num_rests else []
        points = []
        for exposure, rest in itertools.product(steps, (0.5, 1.0) if self.num_rests else (1.0,)):
            most = self.at(np.array([exposure, 1.0, rest, place])).top_speed
            # Where the limits leave room for far more than pays, every step of it is too much.
            tops = [top * farthest / most for top in _TOP_SPEEDS if top * farthest < most]
            points += [np.array([exposure, x, rest, place]) for x in (*still, *steps, *tops)]
        return points

    @property
    def counts(self) -> list[bool]:
        """Whether each coordinate of a point makes a difference."""
        return [True, True, self.num_rests > 0, self.may_pan]

    @property
    def corners(self) -> list[Float[np.ndarray, "4"]]:
        """Points of the largest frames."""
        pans = (0.0, 1.0) if self.may_pan else (0.0,)
        return [np.array([x, 1.0, 1.0, pan]) for x, pan in itertools.product((0.0, 1.0), pans)]

    def sequence(self, place: _Place, errors: Float[np.ndarray, "n"], mean: float) -> FrameSequence:
        """The frames in their order."""
        room, way, count, half = self.room, place.way, self.room.num_frames, place.half
        group, pan = way.frames(place.top_speed), room.panned(place.pan)
        velocities = np.broadcast_to(np.asarray(group.velocities, np.float64) + place.pan, count)
        paths = [group.motion] * count
        if way.back is not None and count > 1:
            paths[1::2] = [way.back(group.motion)] * (count // 2)
        motions = [path.panned(velocity) for path, velocity in zip(paths, velocities, strict=True)]
        moments = steps_of(count) * room.times.period
        places = way.places(place.top_speed, place.pan)
        positions = np.interp(moments, way.knots, places)
        if self.num_rests:
            first = room.first_light(half)
            start = way.velocity_at(first, place.top_speed, pan)
            before = (
                np.interp(first, way.knots, places) - start * abs(start) / 2 / room.acceleration
            )
            motions = [StillCamera(half_exposure=place.rest / 2)] * self.num_rests + motions
            positions = np.r_[np.full(self.num_rests, before), positions]
        times = steps_of(self.num_frames) * room.times.period
        positions = positions - positions[self.num_rests]
        frames = zip(motions, times.tolist(), positions.tolist(), strict=True)
        return FrameSequence(
            self.kind if self.num_frames > 1 else ONE_PARABOLA,
            tuple(TimedFrame(*each) for each in frames),
            way.travel(place.top_speed, pan),
            _psnr(mean),
            _psnr(float(np.max(errors))),
            place.pan - pan,
        )


def _best_of(scene: Scene, tries: list[_Try]) -> FrameSequence:
    """The best exposures, top speed and pan: grids, and simplexes from the best of all of these."""
    from scipy.optimize import minimize

    weights = np.asarray(scene.weights, np.float64)
    groups = [group for each in tries for point in each.corners for group in each.at(point).groups]
    plan = plan_of_frames(scene, groups)

    def errors(place: _Place) -> Float[np.ndarray, "n"]:
        return np.asarray(_errors_of(scene, place.groups, plan), np.float64)

    def found(each: _Try, point: Float[np.ndarray, "4"]) -> _Found:
        place = each.at(point)
        is_possible = place.rest >= each.room.times.shortest
        error = float(weights @ errors(place)) if is_possible else math.inf
        return _Found(error, each, point)

    def improved(first: _Found, most: int) -> _Found:
        each, free = first.each, np.flatnonzero(first.each.counts)

        def whole(part: Float[np.ndarray, "d"]) -> Float[np.ndarray, "4"]:
            point = first.point.copy()
            point[free] = part
            return point

        inwards = np.diag(np.where(first.point > 0.5, -_STEP, _STEP))
        simplex = first.point + np.concatenate([np.zeros((1, 4)), inwards[free]])
        options = {
            "initial_simplex": simplex[:, free],
            "xatol": 1e-3,
            "fatol": _SAME_LOSS * first.error,
            "maxfev": most * free.size,
        }
        end: Any = minimize(
            lambda part: found(each, whole(part)).error,
            first.point[free],
            method="Nelder-Mead",
            bounds=[(0, 1)] * free.size,
            options=options,
        )
        return _Found(float(end.fun), each, whole(end.x))

    # Most paths and pans are seen to be worse before they are at their best.
    starts = []
    for each in tries:
        by_pan = [min((found(each, x) for x in points), key=_error) for points in each.grids]
        starts += sorted(by_pan, key=_error)[:_NUM_PANS]
    firsts = sorted((improved(start, _FIRST_STEPS) for start in starts), key=_error)
    ends = [improved(first, _MOST_STEPS) for first in firsts[:_NUM_PATHS]]
    error, each, point = min(ends, key=_error)
    place = each.at(point)
    return each.sequence(place, errors(place), error)


class _Found(NamedTuple):
    """A point of a search, and its error."""

    error: float
    each: _Try
    point: Float[np.ndarray, "4"]


def _error(found: _Found) -> float:
    return found.error


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
