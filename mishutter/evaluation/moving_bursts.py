"""Searches for bursts of a sensor that moves: its path, exposures, top speed and pan.

One more frame never hurts, so that a burst has as many as there is time for. Fewer of them may
move, where the travel of a stage is short: those before them stand still. What can do more is never
worse: frames that move may stand still, and where the speed is told a burst may be one exposure. Of
bursts within 0.05 dB of the best the simplest is taken: one exposure, then frames that all move, on
one sweep rather than a sine, alternating parabolas or a fan, then those before which some are at
rest.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mishutter._core import alone_in_blas, outside_trace, require_known
from mishutter.evaluation.bursts import FrameTimes
from mishutter.evaluation.frames import (
    FrameGroup,
    alternating_frames,
    in_parts,
    panned_frames,
    sine_frames,
    steps_of,
    sweep_frames,
)
from mishutter.evaluation.needs import distinct_speeds
from mishutter.evaluation.open_frames import OpenFrames, Places, psnr_of_error
from mishutter.evaluation.sequences import loss_of_width
from mishutter.evaluation.speed_knowledge import knowledge_of
from mishutter.model import (
    AbstractMotion,
    FrameSequence,
    FreeMotion,
    Limits,
    ParabolicMotion,
    Scene,
    StillCamera,
    TimedFrame,
)

ONE_PARABOLA, SWEEP, SINE = "one parabola", "sweep", "sine"
ALTERNATING, FAN = "alternating parabolas", "fan of pans"
"""Paths of a sensor over a burst."""
_STEPS = 3
"""Steps of exposure and top speed that a search begins with."""
_STEP = 0.15
"""Step of a simplex."""
_FIRST_STEPS, _MOST_STEPS = 12, 60
"""Steps of a simplex on every path, for each of its numbers, and more of them on the best paths."""
_NUM_PANS, _NUM_PATHS = 2, 3
"""Pans of each path, and paths of all, that are searched further."""
_AS_GOOD, _MAY_BE_AS_GOOD = 0.05, 0.15
"""Decibels below the best at which a simpler burst is preferred, and at which one may come to
that."""
_FEW = 3
"""Most frames that may gain by following one direction where both are alike."""
_SAME_LOSS, _ROUNDING = 1e-7, 1e-9
"""Shares within which an error is found, and of a velocity that are rounding."""
_PIECES_OF_PERIOD = 32
"""Pieces of constant acceleration of the way of a sine from frame to frame."""
_OF_STARTS = 0.6
"""Share of a search's time until all starts are measured."""
_TOP_SPEEDS = (0.7, 1.0, 1.2)
"""Top speeds of a sensor, over that of the fastest thing, that a search begins with too."""
_MOST_VELOCITIES = 64
"""Most frames on paths that give each a velocity of its own, whose transfer functions are many."""


@dataclass(frozen=True)
class _Way:
    """The way of a sensor over a burst, as its velocity, which is linear between knots.

    Attributes:
        knots: Times from the first light to the last; s, ascending.
        velocity: Velocity at each over the top speed.
        moments: Mid-exposures of the frames that see the picture differently; s.
        frames: Makes its frames of the top speed, px/s.
        half_of_parabola: Half the exposure of the parabola that it is, or its frames are; s. None
            where they are none.
        back: Makes the motion of every other frame, which goes the other way, of that of the first;
            None where none does.
    """

    knots: Float[np.ndarray, "k"]
    velocity: Float[np.ndarray, "k"]
    moments: Float[np.ndarray, "n"]
    frames: Callable[[float], FrameGroup]
    half_of_parabola: float | None = None
    back: Callable[[Any], AbstractMotion] | None = None

    @property
    def steepest(self) -> float:
        """Greatest acceleration at the top speed 1; 1/s."""
        steps, changes = np.diff(self.knots), np.abs(np.diff(self.velocity))
        with np.errstate(divide="ignore"):
            return float(np.max(changes[changes > 0] / steps[changes > 0]))

    @cached_property
    def _places(self) -> Float[np.ndarray, "k"]:
        """Place at each knot, from that at the first, at the top speed 1; s."""
        ways = np.diff(self.knots) * (self.velocity[1:] + self.velocity[:-1]) / 2
        return np.append(0.0, np.cumsum(ways))

    def places(self, top_speed: float, pan: float) -> Float[np.ndarray, "k"]:
        """Place at each knot; px."""
        return top_speed * self._places + pan * (self.knots - self.knots[0])

    def in_frames(self, top_speed: float, pan: float) -> Places:
        """Makes the places of the sensor in the frames that differ, at times within them; px."""
        velocity, places = pan + top_speed * self.velocity, self.places(top_speed, pan)

        def at(times: Float[np.ndarray, "q"]) -> Float[np.ndarray, "n q"]:
            moments = self.moments[:, None] + times
            piece = np.searchsorted(self.knots, moments, side="right") - 1
            piece = np.clip(piece, 0, self.knots.size - 2)
            length, start = self.knots[piece + 1] - self.knots[piece], velocity[piece]
            share = (moments - self.knots[piece]) / length
            gain = velocity[piece + 1] - start
            place = places[piece] + share * length * (start + share * gain / 2)
            return place - np.mean(place, axis=1)[:, None]

        return at

    def travels(self, top_speed: float, pan: float, acceleration: float) -> tuple[float, float]:
        """Distances from the lowest to the highest place in the light, and from rest to rest; px.

        Args:
            top_speed: The top speed; px/s.
            pan: Velocity beside it; px/s.
            acceleration: Acceleration of the run-up and the run-out; px/s^2.
        """
        velocity, places = pan + top_speed * self.velocity, self.places(top_speed, pan)
        first, last, steps = velocity[:-1], velocity[1:], np.diff(self.knots)
        # Where the velocity changes its sign between two knots, the stage turns back.
        turns = first * last < 0
        first, last, steps = first[turns], last[turns], steps[turns]
        turned = places[:-1][turns] + first**2 / (first - last) * steps / 2
        lit = np.concatenate([places, turned])
        low, high = float(np.min(lit)), float(np.max(lit))
        begin, end = (v * abs(v) / (2 * acceleration) for v in velocity[[0, -1]].tolist())
        rests = places[0] - begin, places[-1] + end
        return high - low, max(high, *rests) - min(low, *rests)


def _alternating(count: int, half: float, period: float) -> _Way:
    """Parabolas of alternating direction, between which the stage coasts at constant velocity."""
    velocity = np.outer((-1.0) ** np.arange(count), [-1, 0, 1]).ravel()

    def frames(top_speed: float) -> FrameGroup:
        return alternating_frames(count, half, top_speed / (2 * half))

    def back(motion: ParabolicMotion) -> FreeMotion:
        return FreeMotion(accelerations=-motion.acceleration[None], half_exposure=half)

    moments = steps_of(count)[:1] * period
    return _Way(_knots(count, half, period), velocity, moments, frames, half, back)


def _sine(count: int, half: float, period: float) -> _Way:
    """A sine of half the frame rate, whose turning points are at the middles of the frames."""
    moments = steps_of(count) * period
    ends = moments[0] - half, moments[-1] + half
    num_pieces = math.ceil(_PIECES_OF_PERIOD * (ends[1] - ends[0]) / period)
    knots, step = np.linspace(*ends, num_pieces + 1, retstep=True)
    turn = np.pi * step / period / 2
    # With this factor the trapezoids of the velocity add up to the way of the sine.
    velocity = np.sin(np.pi * (knots - moments[0]) / period) * np.tan(turn) / turn

    def frames(top_speed: float) -> FrameGroup:
        stroke = top_speed * period / np.pi * (1 - math.cos(np.pi * half / period))
        return sine_frames(count, half, stroke, period)

    def back(motion: FreeMotion) -> FreeMotion:
        return eqx.tree_at(lambda path: path.accelerations, motion, replace_fn=jnp.negative)

    return _Way(knots, velocity, moments[:1], frames, back=back)


def _sweep(count: int, half: float, period: float) -> _Way:
    """One slow parabola over the whole burst."""
    knots, whole = _knots(count, half, period), (count - 1) * period / 2 + half

    def frames(top_speed: float) -> FrameGroup:
        return sweep_frames(count, half, top_speed / (2 * whole), period)

    return _Way(knots, knots / whole, steps_of(count) * period, frames, whole)


def _fan(count: int, half: float, period: float) -> _Way:
    """Frames at constant velocities in equal steps, between which the stage accelerates evenly."""
    velocity = np.repeat(np.linspace(-1, 1, count), 3)

    def frames(top_speed: float) -> FrameGroup:
        return panned_frames(count, half, top_speed)

    return _Way(_knots(count, half, period), velocity, steps_of(count) * period, frames)


def _knots(count: int, half: float, period: float) -> Float[np.ndarray, "k"]:
    """Beginning, middle and end of each frame; s."""
    return (steps_of(count)[:, None] * period + half * np.array([-1, 0, 1])).ravel()


_KINDS: dict[str, Callable[[int, float, float], _Way]] = {
    SWEEP: _sweep,
    SINE: _sine,
    ALTERNATING: _alternating,
    FAN: _fan,
}
"""Ways of a sensor over a burst, by their names, from the simplest for a stage on: one motion, a
motion of one frequency, and motions of ever more turns."""


@dataclass(frozen=True)
class _Room:
    """The room that limits leave for the motion of some frames.

    Attributes:
        limits: The scene's limits.
        times: When frames may be exposed.
        num_frames: Number of frames that move.
    """

    limits: Limits
    times: FrameTimes
    num_frames: int

    @cached_property
    def acceleration(self) -> float:
        """Greatest mechanical acceleration; px/s^2."""
        most = self.limits.max_acceleration
        return math.inf if most is None else float(most)

    def panned(self, pan: float) -> float:
        """Velocity of a stage for a pan, px/s: 0 where the camera turns."""
        return 0.0 if self.limits.pans == "camera" else pan

    @cached_property
    def _speeds(self) -> tuple[float, float]:
        """Greatest velocity of a pan, and of the sensor; px/s."""
        most = float(self.limits.max_top_speed)
        return min(float(self.limits.max_pan), most), most

    @cached_property
    def _lengths(self) -> tuple[float, float]:
        """Longest travel in the light, and from rest to rest; px."""
        travel = self.limits.max_travel
        return float(self.limits.max_stroke), math.inf if travel is None else float(travel)

    @property
    def stroke(self) -> float:
        """Travel from the lowest to the highest position, without a run-up; px."""
        return min(self._lengths)

    def nearest_pan(self, pan: float, half: float) -> float:
        """The velocity nearest to one, at which all frames of a half exposure may pan; px/s."""
        most, _ = self._speeds
        if self.limits.pans == "stage":
            duration = (self.num_frames - 1) * self.times.period + 2 * half
            lit, whole = self._lengths
            most = min(most, lit / duration)
            if whole < math.inf:
                # From rest to rest a pan v takes v times the duration, and v^2/A to run up and out.
                root = math.sqrt(duration**2 + 4 * whole / self.acceleration)
                most = min(most, 2 * whole / (duration + root))
        return min(max(pan, -most), most)

    def largest_top_speed(self, way: _Way, pan: float) -> float:
        """The largest top speed of a way beside a pan, px/s."""
        most = max(self._speeds[1] - abs(pan), 0.0)
        if self.limits.max_jerk is not None and way.half_of_parabola is not None:
            numbers = jnp.asarray(way.half_of_parabola), jnp.asarray(pan)
            largest = float(self.limits.largest_acceleration(*numbers))
            most = min(most, 2 * largest * way.half_of_parabola)
        if self.acceleration < math.inf:
            most = min(most, self.acceleration / way.steepest)
        pan = self.panned(pan)
        if self._share(way, most, pan) <= 1:
            return most
        if self._share(way, 0.0, pan) >= 1 - _ROUNDING:
            return 0.0
        from scipy.optimize import brentq

        # Travels are convex in the top speed.
        root: Any = brentq(
            lambda top: self._share(way, top, pan) - 1, 0.0, most, xtol=_ROUNDING * most
        )
        return float(root)

    def _share(self, way: _Way, top_speed: float, pan: float) -> float:
        """Share of the travel that a way takes."""
        travels = way.travels(top_speed, pan, self.acceleration)
        return max(x / most for x, most in zip(travels, self._lengths, strict=True))


@outside_trace()
@alone_in_blas()
def best_moving_burst(
    scene: Scene, *, progress: Callable[[float], None] = lambda share: None
) -> FrameSequence | None:
    """The burst of least error of a sensor that moves; None without `scene.burst`.

    The stage follows parabolas of alternating direction, a sine of half the frame rate, one slow
    parabola over the whole burst or a fan of pans, of at most 64 frames. Before the frames that
    move there may be one at rest, or as many as leave the others the travel that they want. The
    limits hold over the burst, and the sensor may pan beside all that. The frames have the times of
    those of `best_still_burst`. One exposure alone, which nothing registers, is among them where
    the scene's decoder is told the speed, or where there is no time for more. On a sensor of a
    known width the kind of path is the one that leaves least error there.

    Args:
        scene: Speeds, light, noise, limits and burst.
        progress: Called with the share of the search that is done.
    """
    require_known("best_moving_burst", scene=scene)
    if scene.burst is None:
        return None
    times, whole = FrameTimes.of(scene, scene.burst), in_parts(scene)
    # Without a pan a burst leaves as much at opposite speeds.
    is_mirrored = _is_mirrored(whole)
    pans = not (is_mirrored and max(times.best_numbers) > _FEW)
    slowest, fastest = (float(x) for x in whole.speed_range)
    farthest = max(abs(slowest), abs(fastest))
    numbers = {*times.best_numbers, 1}
    if times.holds_several and not knowledge_of(scene).is_told:
        numbers.discard(1)
    tries = [
        _Try(kind, room, rests, pans, slowest, fastest, is_mirrored)
        for count in sorted(numbers)
        for kind in _KINDS
        for moving in _moving_numbers(kind, count, _Room(scene.limits, times, count), farthest)
        for room in [_Room(scene.limits, times, moving)]
        # A stage that has to run up may have no time for frames at rest.
        for rests in sorted({count - moving, 0 if room.acceleration < math.inf else count - moving})
        # Nothing registers what is then a single frame.
        if moving + rests > 1 or 1 in numbers
    ]
    frames, width = OpenFrames.of(whole, times.longest, folds=not pans), scene.sensor.width
    return _best_of(frames, tries, None if width is None else float(width), progress)


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
        num_moving: Number of frames that move.
        num_rests: Number of those at rest.
    """

    way: _Way
    top_speed: float
    half: float
    rest: float
    pan: float
    num_moving: int
    num_rests: int = 0

    def errors(self, frames: OpenFrames) -> Float[np.ndarray, "n"]:
        """Squared error that they leave at each speed; white = 1."""
        way, exposure = self.way, 2 * self.half
        places = way.in_frames(self.top_speed, self.pan)
        fastest = abs(self.pan) + self.top_speed + float(np.max(np.abs(frames.speeds)))
        passed = frames.on_paths(places, exposure, fastest)
        gained = self.num_moving // way.moments.size * frames.gained(passed, exposure)
        if self.num_rests:
            gained += self.num_rests * frames.gained(frames.at_rest(self.rest), self.rest)
        return frames.errors(gained)


class _Try(NamedTuple):
    """A search: a kind of path, for frames that may be preceded by some at rest.

    Attributes:
        kind: The path.
        room: The room of the frames that move.
        num_rests: Number of frames at rest.
        pans: Whether those that move may pan.
        slowest: Least of the speeds; px/s, either sign.
        fastest: Greatest of the speeds; px/s.
        is_mirrored: Whether every speed is as likely as its opposite.
    """

    kind: str
    room: _Room
    num_rests: int
    pans: bool
    slowest: float
    fastest: float
    is_mirrored: bool = False

    @property
    def num_frames(self) -> int:
        """Number of frames, those at rest included."""
        return self.room.num_frames + self.num_rests

    @property
    def simplicity(self) -> tuple[bool, bool, int]:
        """The simplest comes first: one exposure, frames that all move, those of simple paths."""
        return self.num_frames > 1, self.num_rests > 0, [*_KINDS].index(self.kind)

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
        top_speed = float(point[1]) * room.largest_top_speed(way, pan)
        place = _Place(way, top_speed, half, 2 * half, pan, room.num_frames)
        if not self.num_rests:
            return place
        start = pan + place.top_speed * float(way.velocity[0])
        left = 2 * (times.period - half - times.dead_time - abs(start) / room.acceleration)
        rest = shortest * max(min(left, longest) / shortest, 1e-9) ** float(point[2])
        return place._replace(rest=rest, num_rests=self.num_rests)

    @property
    def grids(self) -> list[list[Float[np.ndarray, "4"]]]:
        """Points that a search begins with, by pan."""
        pans = {0.0}
        if self.may_pan:
            pans |= {*np.linspace(self.slowest, self.fastest, 2 + _STEPS)[1:-1].tolist()}
        # A pan is then as good as its opposite.
        pans = {abs(pan) for pan in pans} if self.is_mirrored else pans
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

    def frames(self, place: _Place) -> tuple[TimedFrame, ...]:
        """The frames in their order."""
        room, way, count = self.room, place.way, self.room.num_frames
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
            start = pan + place.top_speed * float(way.velocity[0])
            before = places[0] - start * abs(start) / 2 / room.acceleration
            motions = [StillCamera(half_exposure=place.rest / 2)] * self.num_rests + motions
            positions = np.r_[np.full(self.num_rests, before), positions]
        times = steps_of(self.num_frames) * room.times.period
        positions = positions - positions[self.num_rests]
        frames = zip(motions, times.tolist(), positions.tolist(), strict=True)
        return tuple(TimedFrame(*each) for each in frames)

    def sequence(self, place: _Place, errors: Float[np.ndarray, "n"], mean: float) -> FrameSequence:
        """The frames with the stage's way and their levels."""
        room, pan = self.room, self.room.panned(place.pan)
        return FrameSequence(
            self.kind if self.num_frames > 1 else ONE_PARABOLA,
            self.frames(place),
            place.way.travels(place.top_speed, pan, room.acceleration)[0],
            psnr_of_error(mean),
            psnr_of_error(float(np.max(errors))),
            place.pan - pan,
        )


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
    from scipy.optimize import minimize

    few = frames.coarser()

    def found(each: _Try, point: Float[np.ndarray, "4"]) -> _Found:
        place = each.at(point)
        is_possible = place.rest >= each.room.times.shortest
        error = float(few.weights @ place.errors(few)) if is_possible else math.inf
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

    def on_sensor(end: _Found) -> _Found:
        if width is None:
            return end
        loss = loss_of_width(frames.scene, end.each.frames(end.each.at(end.point)), width=width)
        return end._replace(error=end.error * 10 ** (loss / 10))

    # Most paths and pans are seen to be worse before they are at their best.
    starts = []
    for number, each in enumerate(tries):
        progress(_OF_STARTS * number / len(tries))
        by_pan = [min((found(each, x) for x in points), key=_error) for points in each.grids]
        starts += sorted(by_pan, key=_error)[:_NUM_PANS]
    firsts = []
    for number, start in enumerate(starts):
        progress(_OF_STARTS + (1 - _OF_STARTS) * number / len(starts))
        firsts.append(improved(start, _FIRST_STEPS))
    firsts.sort(key=_error)
    tops, others = firsts[:_NUM_PATHS], firsts[_NUM_PATHS:]
    if width is not None:
        best_of_kinds = {first.each.kind: first for first in reversed(firsts)}
        tops = [*best_of_kinds.values()]
        others = [first for first in firsts if all(first is not top for top in tops)]
    ends = [on_sensor(improved(first, _MOST_STEPS)) for first in tops]
    best = min(ends, key=_error)
    simpler = [
        on_sensor(improved(first, _MOST_STEPS))
        for first in others
        if first.each.simplicity < best.each.simplicity and first.is_as_good(best, _MAY_BE_AS_GOOD)
    ]
    as_good = [end for end in (*ends, *simpler) if end.is_as_good(best, _AS_GOOD)]
    _, each, point = min(as_good, key=lambda end: (end.each.simplicity, end.error))
    place = each.at(point)
    errors = place.errors(frames)
    return each.sequence(place, errors, float(frames.weights @ errors))


class _Found(NamedTuple):
    """A point of a search, and its error."""

    error: float
    each: _Try
    point: Float[np.ndarray, "4"]

    def is_as_good(self, other: "_Found", within: float) -> bool:
        """Whether it is no more than some decibels below another."""
        return psnr_of_error(self.error) >= psnr_of_error(other.error) - within


def _error(found: _Found) -> float:
    return found.error
