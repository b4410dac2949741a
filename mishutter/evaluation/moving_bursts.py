"""Searches for bursts of a sensor that moves: its path, exposures, top speed and pan.

Any number of the frames may move, and those before them stand still. What can do more is never
worse: frames that move may stand still or wait for each other, and where the speed is told a burst
may be one exposure. Of bursts within 0.05 dB of the best the simplest is taken: one exposure, then
frames that all move, on one sweep rather than a sine, alternating parabolas or a fan, then those
before which some are at rest.

A simplex on a level in NumPy is the faster search. JAX gradients of the same level by Optimistix's
BFGS from the same starts take 166 and 237 s of processor time on scenes of up to 6 and 12 frames,
as each path and number of frames is a program to compile, and 10 and 14 s once these are compiled,
for 3 and 3 s by the simplex; they end at 33.05 and 46.21 dB for 33.05 and 46.18.
"""

import itertools
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import require_known
from mishutter._core.compiling import outside_trace
from mishutter._core.parallel import alone_in_blas
from mishutter.evaluation.bursts import FrameTimes, moments_of, some_numbers
from mishutter.evaluation.needs import distinct_speeds
from mishutter.evaluation.open_frames import OpenFrames, Places, in_parts, psnr_of_error
from mishutter.evaluation.sequences import loss_of_width
from mishutter.evaluation.speed_knowledge import knowledge_of
from mishutter.model.limits import Limits
from mishutter.model.motion import (
    AbstractMotion,
    FreeMotion,
    LinearMotion,
    ParabolicMotion,
    StillCamera,
)
from mishutter.model.scene import Scene
from mishutter.model.sequences import SINE, FrameSequence, TimedFrame, sine_between
from mishutter.model.stages import Knots, StageUse, place_at_begin, run_up

ONE_PARABOLA, SWEEP, ALTERNATING, FAN = (
    "one parabola",
    "sweep",
    "alternating parabolas",
    "fan of pans",
)
"""Paths of a sensor over a burst, beside a sine."""
_STEPS = 3
"""Steps of exposure and top speed that a search begins with."""
_STEP = 0.15
"""Step of a simplex."""
_FIRST_STEPS, _MOST_STEPS = 12, 60
"""Steps of a simplex on every path, for each of its numbers, and more of them on the best paths."""
_ROUNDING = 1e-9
"""Share of a velocity that is one of rounding."""
_PIECES_OF_SINE = 32
"""Pieces of constant acceleration that stand for a sine within a frame."""
_OF_STARTS = 0.6
"""Share of a search's time until all starts are measured."""
_Numbers = np.ndarray


@dataclass(frozen=True)
class _Way:
    """The way of a sensor over frames that follow each other at equal times."""

    # Velocities over the top speed at the ends of equal pieces within each frame, and then between
    # those from it to the next, those after the last frame included
    velocity: Float[np.ndarray, "count k"]
    num_within: int  # Number of pieces within a frame
    half: float  # Half the exposure of a frame; s
    period: float  # Time from one frame to the next; s
    differ: bool  # Whether the frames see the picture differently, and not only mirrored
    jerk: float = math.inf  # Greatest jerk at the top speed 1; 1/s^2

    @cached_property
    def durations(self) -> Float[np.ndarray, "n"]:
        """Durations of the pieces from the first light to the last; s."""
        count, ends = self.velocity.shape
        between = ends - self.num_within
        gap = max(self.period - 2 * self.half, 0.0)
        own = np.repeat(
            [2 * self.half / self.num_within, gap / between], [self.num_within, between]
        )
        return np.tile(own, count)[:-between]

    @cached_property
    def velocities(self) -> Float[np.ndarray, "m"]:
        """Velocities at their ends over the top speed."""
        between = self.velocity.shape[1] - self.num_within - 1
        return self.velocity.ravel()[: self.velocity.size - between]

    @cached_property
    def rates(self) -> Float[np.ndarray, "n"]:
        """Accelerations in them at the top speed 1, infinite where a velocity jumps; 1/s."""
        gains, d = np.diff(self.velocities), self.durations
        jumps = np.where(abs(gains) > _ROUNDING, np.copysign(np.inf, gains), 0.0)
        return np.where(d > _ROUNDING * self.period, gains / np.where(d > 0, d, 1.0), jumps)

    @cached_property
    def steepest(self) -> float:
        """Greatest acceleration at the top speed 1; 1/s."""
        return float(np.max(abs(self.rates)))

    def knots(
        self,
        top_speed: Float[np.ndarray, "*shape"],  # px/s
        pan: float,  # px/s
        acceleration: float | None,
        jerk: float | None,
    ) -> Knots:
        """The way from rest to rest."""
        velocities = pan + top_speed[..., None] * self.velocities
        within = Knots(self.durations, velocities, None, 0, self.durations.size)
        # Without a limit on the jerk the run-up need not lead to an acceleration.
        ends = (0.0, 0.0) if jerk is None else self.rates[[0, -1]].tolist()
        accelerations = top_speed * ends[0], top_speed * ends[1]
        return within.from_rest_to_rest(accelerations, acceleration, jerk)

    def in_frames(self, top_speed: float, pan: float) -> Places:
        """Makes the places of the sensor in the frames that differ, at times within them; px."""
        rows = self.velocity if self.differ else self.velocity[:1]
        velocity = pan + top_speed * rows[:, : self.num_within + 1]
        step = 2 * self.half / self.num_within
        ways = (velocity[:, 1:] + velocity[:, :-1]) * (step / 2)
        places = np.cumsum(ways, axis=1) - ways

        def at(times: _Numbers) -> _Numbers:
            share = (times + self.half) / step
            piece = np.clip(share.astype(int), 0, self.num_within - 1)
            share, start = share - piece, velocity[:, piece]
            gain = velocity[:, piece + 1] - start
            place = places[:, piece] + share * step * (start + share * gain / 2)
            return place - np.mean(place, axis=1)[:, None]

        return at

    def motions(self, top_speed: float, pan: float) -> list[AbstractMotion]:
        """The motion of each frame, from its mid-exposure."""
        velocity = pan + top_speed * self.velocity[:, : self.num_within + 1]
        return [_motion(each, self.half) for each in velocity]


def _motion(velocities: Float[np.ndarray, "k"], half: float) -> AbstractMotion:
    """The motion of an exposure by its velocities at the ends of equal pieces, px/s."""
    count = velocities.size - 1
    middle = float(np.interp(count / 2, np.arange(count + 1), velocities))
    rates = np.diff(velocities) / (4 * half / count)
    if not np.any(rates):
        still = StillCamera(half_exposure=half)
        return LinearMotion(half_exposure=half, velocity=middle) if middle else still
    if count == 1 and rates[0] > 0:
        return ParabolicMotion(acceleration=float(rates[0]), half_exposure=half, velocity=middle)
    return FreeMotion(accelerations=rates, half_exposure=half, velocity=middle)


def steps_of(num_frames: int) -> Float[np.ndarray, "{num_frames}"]:
    """Places of the frames from the middle of the burst, in periods."""
    return np.arange(num_frames) - (num_frames - 1) / 2


def _alternating(count: int, half: float, period: float) -> _Way:
    """Parabolas of alternating direction, between which the stage coasts at constant velocity."""
    velocity = np.outer((-1.0) ** np.arange(count), [-1, 1])
    return _Way(velocity, 1, half, period, False, 0.0 if count == 1 else math.inf)


def _sine(count: int, half: float, period: float) -> _Way:
    """A sine of half the frame rate, whose turning points are at the middles of the frames."""
    turn = np.pi * half / period
    steps = np.linspace(-turn, turn, _PIECES_OF_SINE + 1)
    # By this factor the trapezoids of the velocity add up to the way of the sine.
    within = np.sin(steps) * np.tan(turn / _PIECES_OF_SINE) / (turn / _PIECES_OF_SINE)
    gap = period - 2 * half
    between = np.zeros(0)
    if gap > _ROUNDING * period:
        between = sine_between(half, gap)
        step = gap / (between.size + 1)
        way = 2 * period / np.pi * math.cos(turn)
        between = between * ((way - step * within[-1]) / (step * np.sum(between)))
    row = np.append(within, between)
    velocity = np.outer((-1.0) ** np.arange(count), row / np.max(row))
    return _Way(velocity, _PIECES_OF_SINE, half, period, False, (np.pi / period) ** 2)


def _sweep(count: int, half: float, period: float) -> _Way:
    """One slow parabola over the whole burst."""
    whole = (count - 1) * period / 2 + half
    velocity = (steps_of(count)[:, None] * period + half * np.array([-1, 1])) / whole
    return _Way(velocity, 1, half, period, True, 0.0)


def _fan(count: int, half: float, period: float) -> _Way:
    """Frames at constant velocities in equal steps, between which the stage accelerates evenly."""
    velocity = np.repeat(np.linspace(-1, 1, count)[:, None], 2, axis=1)
    return _Way(velocity, 1, half, period, True)


_KINDS: dict[str, Callable[[int, float, float], _Way]] = {
    SWEEP: _sweep,
    SINE: _sine,
    ALTERNATING: _alternating,
    FAN: _fan,
}
"""Ways of a sensor over a burst, by their names, from the simplest for a stage on: one motion, a
motion of one frequency, and motions of ever more turns."""


def way_over_frames(kind: str, count: int, half: float, period: float) -> _Way:
    """The way of a sensor over a burst, at the top speed 1."""
    return _KINDS[kind](count, half, period)


class _Room:
    """The room that limits leave for the motion of frames."""

    def __init__(self, limits: Limits) -> None:
        self.pans = limits.pans
        self.max_pan, self._most_speed = float(limits.max_pan), float(limits.max_top_speed)
        self._stroke = float(limits.max_stroke)
        self._travel, self.acceleration, self.jerk = (
            None if x is None else float(x)
            for x in (limits.max_travel, limits.max_acceleration, limits.max_jerk)
        )

    def panned(self, pan: float) -> float:
        """Velocity of a stage for a pan, px/s: 0 where the camera turns."""
        return 0.0 if self.pans == "camera" else pan

    def _share(self, use: StageUse, beside: float) -> Float[np.ndarray, "*shape"]:
        """Share of the limits that a way takes beside a speed of the camera, px/s."""
        share = np.maximum(use.stroke / self._stroke, (use.top_speed + beside) / self._most_speed)
        return share if self._travel is None else np.maximum(share, use.travel / self._travel)

    def nearest_pan(self, pan: float, duration: float) -> float:
        """The velocity nearest to one at which frames may pan for some time, s; px/s."""
        most = min(self.max_pan, self._most_speed)
        if self.pans == "stage" and pan:

            def share(velocity: _Numbers) -> _Numbers:
                velocities = np.repeat(velocity[:, None], 2, axis=1)
                within = Knots(np.array([duration]), velocities, None, 0, 1)
                none = np.zeros(velocity.shape)
                knots = within.from_rest_to_rest((none, none), self.acceleration, self.jerk)
                return self._share(knots.use, 0.0)

            most = _largest_within(share, min(most, abs(pan)))
        return min(max(pan, -most), most)

    def largest_top_speed(self, way: _Way, pan: float, num_rests: int = 0) -> float:
        """The largest top speed of a way beside a pan, px/s."""
        most = max(self._most_speed - abs(pan), 0.0)
        if self.acceleration is not None:
            most = min(most, self.acceleration / way.steepest)
        if self.jerk is not None and way.jerk > 0:
            most = min(most, self.jerk / way.jerk)
        of_stage = self.panned(pan)
        beside = abs(pan - of_stage)

        def share(top: _Numbers) -> _Numbers:
            knots = way.knots(top, of_stage, self.acceleration, self.jerk)
            # From a frame at rest on, the run-up is one of the burst.
            knots = knots._replace(first=0) if num_rests else knots
            return self._share(knots.use, beside)

        return _largest_within(share, most)


def _largest_within(share: Callable[[_Numbers], _Numbers], most: float) -> float:
    """The largest number up to some whose share of the limits is at most 1.

    Travels are convex in a speed, so that a chord is never below them.
    """
    if most <= 0:
        return 0.0
    none, half, all_of_it = share(most * np.array([0.0, 0.5, 1.0]))
    if all_of_it <= 1:
        return most
    if none >= 1 - _ROUNDING:
        return 0.0
    if none == 0 and abs(all_of_it - 2 * half) <= _ROUNDING * half:
        return most / float(all_of_it)
    low = most * (1 - none) / (all_of_it - none)
    low, high, _, _ = _around_one(share, np.geomspace(low, most, 16))
    low, high, under, over = _around_one(share, np.linspace(low, high, 16))
    return low + (high - low) * max(1 - under, 0.0) / (over - under) if over > 1 else low


def _around_one(
    share: Callable[[_Numbers], _Numbers], places: _Numbers
) -> tuple[float, float, float, float]:
    """The neighbours of some places between which shares exceed 1, and the shares there."""
    shares = share(places)
    after = max(int(np.argmax(shares > 1)), 1)
    low, high, under, over = *places[after - 1 : after + 1], *shares[after - 1 : after + 1]
    return float(low), float(high), float(under), float(over)


@outside_trace()
@alone_in_blas()
def best_moving_burst(
    scene: Scene, *, progress: Callable[[float], None] = lambda share: None
) -> FrameSequence | None:
    """The burst of least error of a sensor that moves; None without `scene.burst`.

    The stage follows parabolas of alternating direction, a sine of half the rate of its frames, one
    slow parabola over the whole burst or a fan of pans, of at most 64 frames. Before the frames
    that move there may be some at rest. Limits on stroke, travel, top speed, acceleration and jerk
    hold for the path that `FrameSequence.stage_path` has, and the sensor may pan beside all that.
    The frames have times as those of `best_still_burst`. One exposure alone, which nothing
    registers, is among them where the scene's decoder is told the speed, or where there is no time
    for more. On a sensor of a known width the kind of path is the one that leaves least error
    there.
    """
    require_known("best_moving_burst", scene=scene)
    if scene.burst is None:
        return None
    times, whole = FrameTimes.of(scene, scene.burst), in_parts(scene)
    # Without a pan a burst leaves as much at opposite speeds. Where each is as likely as its
    # opposite, no more than three frames may gain by following one direction.
    one, other = (
        np.concatenate(distinct_speeds(x, folds=False))
        for x in (whole, whole.without_metadata(speeds=-whole.speeds))
    )
    is_mirrored = one.shape == other.shape and np.allclose(one, other)
    pans = not (is_mirrored and times.numbers_of_frames[-1] > 3)
    slowest, fastest = (float(x) for x in whole.speed_range)
    told = knowledge_of(scene).is_told
    search = _Search(
        _Room(scene.limits),
        times,
        pans,
        slowest,
        fastest,
        is_mirrored,
        least=2 if times.holds_several and not told else 1,
    )
    frames = OpenFrames.of(whole, times.longest, folds=not pans)
    found = _best_of(frames, search.tries, scene.registered_width, progress)
    return scene.limits.with_travel(found)


class _Place(NamedTuple):
    """The frames at a point of the unit box of a search."""

    way: _Way  # The way of those that move
    top_speed: float  # Its top speed; px/s
    rest: float  # Exposure of those before them, which are at rest; s
    pan: float  # Velocity of those that move; px/s
    num_rests: int = 0  # Number of those at rest

    def errors(self, frames: OpenFrames) -> Float[np.ndarray, "n"]:
        """Squared error that they leave at each speed; white = 1."""
        way, exposure = self.way, 2 * self.way.half
        places = way.in_frames(self.top_speed, self.pan)
        fastest = abs(self.pan) + self.top_speed + float(np.max(np.abs(frames.speeds)))
        passed = frames.on_paths(places, exposure, fastest)
        alike = 1 if way.differ else way.velocity.shape[0]
        gained = alike * frames.snr(passed, exposure)
        if self.num_rests:
            gained += self.num_rests * frames.snr(frames.at_rest(self.rest), self.rest)
        return frames.errors(gained)


class _Search(NamedTuple):
    """The part that is the same of all kinds and numbers of frames."""

    room: _Room  # The room that the limits leave
    times: FrameTimes  # When frames may be exposed
    pans: bool  # Whether those that move may pan
    slowest: float  # Least of the speeds; px/s, either sign
    fastest: float  # Greatest of the speeds; px/s
    is_mirrored: bool = False  # Whether every speed is as likely as its opposite
    least: int = 1  # Least number of frames

    def allows(self, kind: str, num_moving: int, num_rests: int) -> bool:
        """Whether there is such a burst."""
        least = 1 if kind == ALTERNATING else 2
        # A velocity of its own for each frame takes many transfer functions.
        most = 64 if kind in (SWEEP, FAN) else math.inf
        count = num_moving + num_rests
        is_one = least <= num_moving <= most and num_rests >= 0 and count >= self.least
        return is_one and count in self.times.numbers_of_frames

    @property
    def tries(self) -> "list[_Try]":
        """The kinds and the numbers of frames that a search begins with."""
        most = self.times.numbers_of_frames[-1]
        numbers = {
            (moving, rests)
            for moving in {*some_numbers(most, 5), max(most - 1, 1)}
            for rests in {0, most - moving}
        }
        return [
            _Try(self, kind, *each)
            for kind in _KINDS
            for each in sorted(numbers)
            if self.allows(kind, *each)
        ]


class _Try(NamedTuple):
    """A kind of path, for some frames that may be preceded by some at rest."""

    search: _Search  # What it is one of
    kind: str  # The path
    num_moving: int  # Number of frames that move
    num_rests: int = 0  # Number of frames at rest

    @property
    def num_frames(self) -> int:
        """Number of frames, those at rest included."""
        return self.num_moving + self.num_rests

    @property
    def family(self) -> tuple[str, bool]:
        """The path, and whether some frames are at rest."""
        return self.kind, self.num_rests > 0

    @property
    def simplicity(self) -> tuple[bool, bool, int]:
        """The simplest comes first: one exposure, frames that all move, those of simple paths."""
        return self.num_frames > 1, self.num_rests > 0, [*_KINDS].index(self.kind)

    def neighbours(self, step: int) -> "list[_Try]":
        """The same path for other numbers of frames, some more or fewer of either."""
        changes = ((1, 0), (-1, 0), (1, -1), (-1, 1), (0, 1), (0, -1))
        numbers = [(self.num_moving + a * step, self.num_rests + b * step) for a, b in changes]
        # A burst without frames at rest is of another family.
        return [
            self._replace(num_moving=moving, num_rests=rests)
            for moving, rests in numbers
            if self.search.allows(self.kind, moving, rests) and (rests > 0) == (self.num_rests > 0)
        ]

    @property
    def may_pan(self) -> bool:
        """Whether frames may pan: a camera that turns does not rest for one of them."""
        room = self.search.room
        is_held = self.num_rests > 0 and room.pans == "camera"
        return self.search.pans and room.max_pan > 0 and not is_held

    @property
    def slowest_pan(self) -> float:
        """Least velocity that is worth a pan; px/s."""
        return min(0.0, self.search.slowest)

    @property
    def pan_range(self) -> float:
        """Range of the velocities that are; px/s."""
        return max(0.0, self.search.fastest) - self.slowest_pan if self.may_pan else 0.0

    @property
    def _taken(self) -> float:
        """Time that the frames at rest take at least; s."""
        times, count = self.search.times, self.num_rests
        return times.shortest + (count - 1) * times.period_of(times.shortest) if count else 0.0

    @property
    def longest(self) -> float:
        """Longest exposure of the frames that move; s."""
        return self.search.times.longest_of(self.num_moving, self._taken)

    def at(self, point: Float[np.ndarray, "5"]) -> _Place:
        """The frames at a point: exposure, share of the top speed, exposure at rest, pan, period.

        There is no time for a frame at rest, which then lasts below the shortest exposure, where
        the stage takes all of it to run up.
        """
        room, times, count = self.search.room, self.search.times, self.num_moving
        exposure = times.shortest * (self.longest / times.shortest) ** float(point[0])
        period = times.period_of(exposure)
        if count > 1:
            first = times.period_of(exposure) if self.num_rests else exposure
            most = max((times.window - self._taken - first) / (count - 1), period)
            period *= (most / period) ** float(point[4])
        way = _KINDS[self.kind](count, exposure / 2, period)
        pan = 0.0
        if self.may_pan:
            wanted = self.slowest_pan + float(point[3]) * self.pan_range
            pan = room.nearest_pan(wanted, (count - 1) * period + exposure)
        top_speed = float(point[1]) * room.largest_top_speed(way, pan, self.num_rests)
        place = _Place(way, top_speed, exposure, pan, self.num_rests)
        if not self.num_rests:
            return place
        beside = self._gap(place) + exposure + (count - 1) * period
        left = max(times.longest_of(self.num_rests, beside), 1e-9 * times.shortest)
        return place._replace(rest=times.shortest * (left / times.shortest) ** float(point[2]))

    def _ups(self, place: _Place) -> Knots:
        """The run-up of a stage from a frame at rest."""
        room, way = self.search.room, place.way
        velocity = room.panned(place.pan) + place.top_speed * float(way.velocities[0])
        rate = place.top_speed * float(way.rates[0]) if room.jerk is not None else 0.0
        return Knots.of(0.0, run_up(velocity, rate, room.acceleration, room.jerk))

    def _gap(self, place: _Place) -> float:
        """Time from the last frame at rest to the first that moves; s."""
        times, exposure = self.search.times, 2 * place.way.half
        up = float(np.sum(self._ups(place).durations))
        return max(times.period - exposure, times.dead_time, up)

    @property
    def grids(self) -> "list[list[Float[np.ndarray, '5']]]":
        """Points that a search begins with, by pan."""
        slowest, fastest = self.search.slowest, self.search.fastest
        pans = {0.0}
        if self.may_pan:
            pans |= {*np.linspace(slowest, fastest, 2 + _STEPS)[1:-1].tolist()}
        # A pan is then as good as its opposite.
        pans = {abs(pan) for pan in pans} if self.search.is_mirrored else pans
        return [self._grid(pan) for pan in sorted(pans)]

    def _grid(self, pan: float) -> "list[Float[np.ndarray, '5']]":
        times, steps = self.search.times, np.arange(1, 1 + _STEPS) / _STEPS
        place = (pan - self.slowest_pan) / self.pan_range if self.may_pan else 0.0
        farthest = max(abs(self.search.fastest - pan), abs(self.search.slowest - pan))
        # One kind alone has to try frames that stand still.
        still = [0.0] if self.kind == ALTERNATING and not self.num_rests else []
        points = []
        alike = math.log(max(times.longest_of(self.num_frames) / times.shortest, 1.0))
        alike /= max(math.log(self.longest / times.shortest), 1e-9)
        exposures = min(alike, 1.0) * steps
        for exposure, rest in itertools.product(
            exposures, (0.5, 1.0) if self.num_rests else (1.0,)
        ):
            most = self.at(np.array([exposure, 1.0, rest, place, 0.0])).top_speed
            # Where the limits leave room for far more than pays, every step of it is too much.
            tops = [top * farthest / most for top in (0.7, 1.0, 1.2) if top * farthest < most]
            points += [np.array([exposure, x, rest, place, 0.0]) for x in (*still, *steps, *tops)]
        return points

    @property
    def counts(self) -> list[bool]:
        """Whether each coordinate of a point makes a difference."""
        times, most = self.search.times, (self.num_frames - 1) * self.search.times.period
        waits = self.num_moving > 1 and times.window - times.shortest > 1.02 * most
        return [True, True, self.num_rests > 0, self.may_pan, waits]

    def frames(self, place: _Place) -> tuple[TimedFrame, ...]:
        """The frames in their order."""
        way, count, exposure = place.way, self.num_moving, 2 * place.way.half
        motions = way.motions(place.top_speed, place.pan)
        within = Knots(
            way.durations, place.pan + place.top_speed * way.velocities, None, 0, 0
        ).positions
        begins = within[:: way.velocity.shape[1]]
        positions = np.array(
            [begin - place_at_begin(each) for begin, each in zip(begins, motions, strict=True)]
        )
        exposures = [place.rest] * self.num_rests + [exposure] * count
        rests = [self.search.times.period_of(place.rest)] * (self.num_rests - 1)
        starts = [self._gap(place) + exposure] if self.num_rests else []
        times = moments_of(exposures, [*rests, *starts, *[way.period] * (count - 1)])
        if self.num_rests:
            before = -float(self._ups(place).positions[-1])
            motions = [StillCamera(half_exposure=place.rest / 2)] * self.num_rests + motions
            positions = np.r_[np.full(self.num_rests, before), positions]
        positions = positions - positions[self.num_rests]
        frames = zip(motions, times.tolist(), positions.tolist(), strict=True)
        return tuple(TimedFrame(*each) for each in frames)

    def sequence(self, place: _Place, errors: Float[np.ndarray, "n"], mean: float) -> FrameSequence:
        """The frames with their levels."""
        return FrameSequence(
            self.kind if self.num_frames > 1 else ONE_PARABOLA,
            self.frames(place),
            0.0,
            psnr_of_error(mean),
            psnr_of_error(float(np.max(errors))),
            place.pan - self.search.room.panned(place.pan),
        )


class _Finder:
    """Finds points of low error, and judges them on the sensor."""

    def __init__(self, frames: OpenFrames, width: float | None) -> None:
        self._frames, self._few, self._width = frames, frames.coarser(), width

    def found(self, each: _Try, point: Float[np.ndarray, "5"]) -> "_Found":
        """A point with its error, which is infinite where there is no time for a frame at rest."""
        place, few = each.at(point), self._few
        is_possible = place.rest >= each.search.times.shortest * (1 - _ROUNDING)
        error = float(few.weights @ place.errors(few)) if is_possible else math.inf
        return _Found(error, each, point)

    def improved(self, first: "_Found", most: int, *, waits: bool = False) -> "_Found":
        """The end of a simplex from a point, of at most some steps for each number."""
        from scipy.optimize import minimize

        each = first.each
        free = np.flatnonzero([*each.counts[:-1], each.counts[-1] and waits])

        def whole(part: Float[np.ndarray, "d"]) -> Float[np.ndarray, "5"]:
            point = first.point.copy()
            point[free] = part
            return point

        inwards = np.diag(np.where(first.point > 0.5, -_STEP, _STEP))
        simplex = first.point + np.concatenate([np.zeros((1, 5)), inwards[free]])
        options = {
            "initial_simplex": simplex[:, free],
            "xatol": 1e-3,
            "fatol": 1e-7 * first.error,
            "maxfev": most * free.size,
        }
        end: Any = minimize(
            lambda part: self.found(each, whole(part)).error,
            first.point[free],
            method="Nelder-Mead",
            bounds=[(0, 1)] * free.size,
            options=options,
        )
        return _Found(float(end.fun), each, whole(end.x))

    def climbed(self, first: "_Found") -> "_Found":
        """The best numbers of frames near those of a point, by ever smaller steps."""
        step, tried = max(first.each.num_moving // 2, 1), {first.each}
        while step:
            near = [each for each in first.each.neighbours(step) if each not in tried]
            tried |= {*near}
            ends = [self.improved(self.found(each, first.point), _FIRST_STEPS) for each in near]
            best = min((first, *ends), key=_error)
            step, first = (step // 2 if best is first else step), best
        return first

    def at_best(self, first: "_Found") -> "_Found":
        """The end of a long simplex from a point, with the error that it leaves on the sensor."""
        # A simplex that has shrunk short of a minimum goes on from its end, while that gains.
        end, before = self.improved(first, _MOST_STEPS, waits=True), math.inf
        while end.error < before * (1 - 1e-4):
            end, before = self.improved(end, _MOST_STEPS, waits=True), end.error
        if self._width is None:
            return end
        frames = end.each.frames(end.each.at(end.point))
        loss = loss_of_width(self._frames.scene, frames, width=self._width)
        return end._replace(error=end.error * 10 ** (loss / 10))


def _best_of(
    frames: OpenFrames,
    tries: list[_Try],
    width: float | None,
    progress: Callable[[float], None],
) -> FrameSequence:
    """The best exposures, top speed and pan: grids, and simplexes from the best of all of these.

    Kinds of paths differ by what they lose on a sensor of a width, which then chooses the path. The
    exposures and the top speed of each are those of an endless sensor.
    """
    finder = _Finder(frames, width)
    # Most paths and pans are seen to be worse before they are at their best.
    starts = []
    for number, each in enumerate(tries):
        progress(_OF_STARTS * number / len(tries))
        by_pan = [min((finder.found(each, x) for x in grid), key=_error) for grid in each.grids]
        # The best two pans of each path are searched further.
        starts += sorted(by_pan, key=_error)[:2]
    firsts = []
    for number, start in enumerate(starts):
        progress(_OF_STARTS + (1 - _OF_STARTS) * number / len(starts))
        firsts.append(finder.improved(start, _FIRST_STEPS))
    firsts.sort(key=_error)
    # Other numbers of frames may be better than the best of all, where it is within 1 dB.
    near = [x for x in _families(firsts, 1) if x.is_as_good(firsts[0], 1.0)]
    others = [x for x in firsts if all(x is not each for each in near)]
    firsts = sorted((*map(finder.climbed, near), *others), key=_error)
    # A path may come to the best from 0.3 dB below; a narrow sensor may turn the order round.
    within = 0.3 if width is None else math.inf
    tops = [x for x in _families(firsts, 2) if x.is_as_good(firsts[0], within)]
    ends = [finder.at_best(first) for first in tops]
    best = min(ends, key=_error)
    as_good = [end for end in ends if end.is_as_good(best, 0.05)]
    _, each, point = min(as_good, key=lambda end: (end.each.simplicity, end.error))
    place = each.at(point)
    errors = place.errors(frames)
    return each.sequence(place, errors, float(frames.weights @ errors))


def _families(found: "list[_Found]", num_each: int) -> "list[_Found]":
    """Some of each family, the best of points in the order of their errors."""
    counts = Counter[tuple[str, bool]]()
    firsts = []
    for each in found:
        counts[each.each.family] += 1
        if counts[each.each.family] <= num_each:
            firsts.append(each)
    return firsts


class _Found(NamedTuple):
    """A point of a search, and its error."""

    error: float
    each: _Try
    point: Float[np.ndarray, "5"]

    def is_as_good(self, other: "_Found", within: float) -> bool:
        """Whether it is no more than some decibels below another."""
        return psnr_of_error(self.error) >= psnr_of_error(other.error) - within


def _error(found: _Found) -> float:
    return found.error
