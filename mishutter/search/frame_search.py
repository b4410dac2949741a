"""One search for frames of a sensor that moves along one axis or two.

Each frame has a length, velocities at the ends of its pieces and a place, and the stage goes from
one to the next in any way that it can (`mishutter.search.frame_limits`). What the level gains by
each number is known in closed form (`mishutter.search.frame_levels`), and SciPy's SLSQP climbs from
a few starts. Frames of few numbers (`mishutter.search.frame_ties`) are the same frames tied. They
are searched first; they are the starts of the free search, and preferred where they are as good.
From the best the search goes on with frames that are shaken, follow another thing, come in
another order or make way for each other.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter.evaluation.levels import psnr_of_error
from mishutter.model.exposures import Exposures
from mishutter.model.frame_path import SINE
from mishutter.model.limits import Limits
from mishutter.search.frame_levels import Frames, Levels, Shape
from mishutter.search.frame_limits import LEAST_GAP, Room
from mishutter.search.frame_rows import RowLevels
from mishutter.search.frame_ties import BRACKETED, FOLLOW, FREE, MOST_FREE, PAN, Numbers, Tie

_BEYOND = 1.05
"""Share of a limit that frames are slowed down from, as a solver keeps limits to some digits."""
_STEP, _STEP_OF_TIE = 1e-7, 1e-6
"""Steps of the differences of limits, whose numbers are of the order of 1, and of ties."""
_PIECES_OF_SINE = 8
_STARTS = 4
_EXCHANGES, _ROUNDS = 4, 3
_SHARES = 0.02, 0.1, 0.4
"""Shares of velocities and exposures by which frames are shaken that have another order."""
_LIKELIEST = 2
"""Arrangements that are tried at a time."""
_GAPS = 96
"""Times in which a flight between two frames is tried."""
_AS_GOOD = 0.02
"""Decibels below the best at which still fewer frames are tried."""
_NEARLY_AS_GOOD = 0.1
"""Decibels below the best at which the best of another number of frames is bettered as well."""
_MOST_STEPS, _MOST_STEPS_OF_TIE = 60, 40
_STALLS, _LEAST_GAIN = 6, 1e-3
"""Steps without a gain of so many dB after which a descent ends."""
_KEPT = 1e-6
"""Excess of a limit that is one of rounding."""
_NEARLY = 3e-3
"""Excess of a limit at which a step counts: the nearest numbers within it are found in the end."""

Point = Float[np.ndarray, "v"]


class End(NamedTuple):
    """Frames that a descent ended at."""

    kind: str  # Their way
    frames: Frames
    level: float  # dB


class Descent(NamedTuple):
    """Descents of frames of one shape within a room."""

    levels: Levels
    room: Room
    shape: Shape
    rows: RowLevels | None = None  # Where the error is the mean over rows

    def free(self, start: Frames) -> End | None:
        """The end of a descent of all numbers; None where none is within the limits."""
        room, shape, bounds = self.room, self.shape, self.room.bounds(self.shape)
        eye = _STEP * np.eye(bounds.shape[0])

        def slack(x: Point) -> np.ndarray:
            return room.slack(x, shape)

        def steps(x: Point) -> np.ndarray:
            return ((slack(x + eye) - slack(x)) / _STEP).T

        limits = {"type": "ineq", "fun": slack, "jac": steps}
        first = np.clip(room.joined(start), *bounds.T)
        end = _climbed(self._error, first, bounds, limits, _MOST_STEPS)
        return self._end(FREE, _nearest(end, bounds, limits))

    def tied(self, tie: Tie, start: Numbers) -> End | None:
        """The end of a descent of the numbers of a tie; None where none is within the limits."""
        room, shape = self.room, self.shape

        def whole(z: Numbers) -> Point:
            return room.joined(tie.frames(z))

        def near(z: Numbers) -> tuple[Numbers, np.ndarray]:
            inwards = np.where(z > 0.5, -_STEP_OF_TIE, _STEP_OF_TIE)
            return inwards, np.stack([whole(z + step) for step in np.diag(inwards)])

        def error(z: Numbers) -> tuple[float, Numbers]:
            (value, slope), (inwards, every) = self._error(whole(z)), near(z)
            return value, (every - whole(z)) @ slope / inwards

        def slack(z: Numbers) -> np.ndarray:
            return room.slack(whole(z), shape)

        def steps(z: Numbers) -> np.ndarray:
            inwards, every = near(z)
            return ((room.slack(every, shape) - slack(z)) / inwards[:, None]).T

        limits = {"type": "ineq", "fun": slack, "jac": steps}
        bounds = np.tile([[0.0, 1.0]], (start.size, 1))
        end = _climbed(error, start, bounds, limits, _MOST_STEPS_OF_TIE)
        return self._end(tie.kind, whole(_nearest(end, bounds, limits)))

    def best(self, tie: Tie, starts: Sequence[Numbers]) -> End | None:
        """The best end of descents from some starts of a tie."""
        return best_of([self.tied(tie, start) for start in starts])

    def _end(self, kind: str, x: Point) -> End | None:
        """The frames of a point, if it is within the limits."""
        if float(np.min(self.room.slack(x, self.shape))) < -_KEPT:
            return None
        frames, _ = self.room.split(x, self.shape)
        return End(kind, frames, self.levels.level(frames))

    def _error(self, x: Point) -> tuple[float, Point]:
        """The error that is left, dB, and its derivatives by all numbers."""
        if self.rows is not None:
            return self.rows.slope(lambda z: self.room.split(z, self.shape)[0], x)
        frames, _ = self.room.split(x, self.shape)
        error, by_exposure, by_velocity = self.levels.slope(frames)
        slope, count = np.zeros_like(x), self.shape.number
        slope[:count] = by_exposure * self.room.times.period
        slope[count : count + by_velocity.size] = by_velocity.ravel() * self.room.speed
        return error, slope


def best_of(ends: Sequence["End | None"]) -> End | None:
    """The end of the highest level of those that are within their limits."""
    return max((end for end in ends if end is not None), key=lambda end: end.level, default=None)


def within(
    limits: Limits, frames: Frames, exposures_of: Callable[[Frames], Exposures]
) -> Exposures | None:
    """Frames slowed down until they are within limits; None where they are far from them."""
    for _ in range(3):
        exposures = exposures_of(frames)
        share = exposures.share_of(limits)
        if share <= 1 + 1e-7:
            return exposures
        if share > _BEYOND:
            return None
        slower = (1 - 1e-7) / share
        velocity = frames.pan + (frames.velocity - frames.pan) * slower
        frames = frames._replace(velocity=velocity, place=frames.place * slower)
    return None


def _climbed(
    error: Callable[[np.ndarray], tuple[float, np.ndarray]],
    start: np.ndarray,
    bounds: np.ndarray,
    limits: dict[str, Any],
    most: int,
) -> np.ndarray:
    """The best point of a descent within limits, but for what `_nearest` mends, or its last."""
    from scipy.optimize import minimize

    least, best, stalls, calls = math.inf, None, 0, 0
    latest: tuple[np.ndarray, float] = start, math.inf

    def counted(x: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal calls, latest
        value, slope = error(x)
        calls, latest = calls + 1, (x.copy(), value)
        return value, slope

    def watch(x: np.ndarray) -> None:
        nonlocal least, best, stalls
        # A step ends at the point that was asked for last.
        value = latest[1] if np.array_equal(x, latest[0]) else error(x)[0]
        if value < least and float(np.min(limits["fun"](x))) >= -_NEARLY:
            stalls = 0 if value < least - _LEAST_GAIN else stalls + 1
            least, best = value, x.copy()
        elif best is not None:
            stalls += 1
        # Line searches of limits with corners may go on for ever.
        if stalls >= _STALLS or calls > 4 * most:
            raise StopIteration

    options = {"maxiter": most, "ftol": 1e-6}
    with contextlib.suppress(StopIteration):
        minimize(
            counted,
            start,
            jac=True,
            bounds=bounds,
            method="SLSQP",
            options=options,
            constraints=limits,
            callback=watch,
        )
    return latest[0] if best is None else best


def _nearest(x: Point, bounds: np.ndarray, limits: dict[str, Any]) -> Point:
    """The nearest numbers within the limits, to all digits."""
    from scipy.optimize import minimize

    end: Any = minimize(
        lambda z: (np.sum((z - x) ** 2) / 2, z - x),
        x,
        jac=True,
        bounds=bounds,
        method="SLSQP",
        options={"maxiter": 30, "ftol": 1e-14},
        constraints=limits,
    )
    return end.x


class Search(NamedTuple):
    """A search for frames of things along one axis."""

    levels: Levels
    room: Room
    ties: Callable[[Shape], list[Tie]]  # Ways of few numbers, of some shape
    pieces: Callable[[int], int]  # Pieces of each of so many frames
    followed: Callable[[int], tuple[float, ...]]  # Velocities that each of some may follow; px/s
    is_free: bool  # Whether each frame may have numbers of its own

    def ends(self, counts: list[int], progress: Callable[[float], None]) -> list[End]:
        """Ends of descents of the most frames and of ever fewer, while fewer are as good.

        The most frames that have numbers of their own are tried in any case.
        """
        every: list[End] = []
        best, count = -math.inf, counts[-1]
        while True:
            progress(0.5 * (1 - count / (counts[-1] + 1)))
            here = [end for end in self._of_number(count) if end is not None]
            every += here
            top = max((end.level for end in here), default=-math.inf)
            fewer = [number for number in counts if number < count]
            is_tied, is_worse = self.is_free and count > MOST_FREE, top < best - _AS_GOOD
            if not fewer or (is_worse and not is_tied):
                break
            best, most = max(best, top), 0.8 * count
            if is_tied:  # fewer frames of numbers of their own may be better by far
                most = MOST_FREE if is_worse else max(most, MOST_FREE)
            count = max((number for number in fewer if number <= most), default=fewer[0])
        return every + (self._beside(every, progress) if self.is_free else [])

    def _beside(self, every: list[End], progress: Callable[[float], None]) -> list[End]:
        """Ends of descents from near the best, and from near as good ones of other numbers."""
        most, beside = best_of(every), []
        if most is None or most.frames.exposure.size > MOST_FREE:
            return []
        progress(0.5)
        beside += again(self.levels, self.room, most, near(self.room), times=_ROUNDS)
        most = best_of([most, *beside]) or most
        followed = self.followed(most.frames.exposure.size)
        if most.frames.exposure.size > 1 and followed:
            progress(0.6)
            changes = partial(changed, self.levels, self.room, followed)
            beside += again(self.levels, self.room, most, changes, times=_ROUNDS, least=_AS_GOOD)
        groups: dict[int, list[End]] = {}
        for end in [*every, *beside]:
            groups.setdefault(end.frames.exposure.size, []).append(end)
        progress(0.7)
        for count, ends in groups.items():
            top = max(ends, key=lambda end: end.level)
            # The order of two frames is all one; the more there are, the more orders they have.
            if count > 2 and top.level > most.level - _NEARLY_AS_GOOD:
                orders = reordered(self.room)
                beside += again(self.levels, self.room, top, orders, times=count // 2)
        progress(0.8)
        most = best_of([most, *beside]) or most
        ways, times = rearranged(self.levels, self.room), 1 + most.frames.exposure.size // 2
        arranged = again(self.levels, self.room, most, ways, times=times, least=_AS_GOOD / 4)
        # Frames that are as good stay as they are.
        return beside + [end for end in arranged if end.level > most.level + _AS_GOOD]

    def _of_number(self, count: int) -> list[End | None]:
        """Ends of descents of so many frames."""
        shape = Shape(count, self.pieces(count), 1)
        tied = []
        for tie in self.ties(shape):
            pieces = _PIECES_OF_SINE if tie.kind == SINE else shape.pieces
            own = tie._replace(shape=shape._replace(pieces=pieces))
            tied.append(Descent(self.levels, self.room, own.shape).best(own, own.starts))
        if count > MOST_FREE or not self.is_free:
            return tied
        found = {end.kind: end for end in tied if end is not None}
        # From a pan each frame may turn into anything, as it is far from all limits; others begin
        # with flights back, and with one long exposure.
        order = [*(kind for kind in (PAN, FOLLOW, BRACKETED) if kind in found)]
        order += sorted(found, key=lambda kind: -found[kind].level)
        draw, descent = np.random.default_rng(count), Descent(self.levels, self.room, shape)
        starts = [found[kind].frames for kind in [*dict.fromkeys(order)][:_STARTS]]
        if followed := self.followed(count):
            starts.append(one_by_one(self.levels, self.room, shape, followed))
        return [*tied, *(descent.free(shaken(x, draw, self.room, 0.01)) for x in starts)]


def one_by_one(levels: Levels, room: Room, shape: Shape, followed: tuple[float, ...]) -> Frames:
    """Frames that each follow the thing by which they gain most beside those before."""
    count, times = shape.number, room.times
    most = min(times.longest, max(times.window / count - times.dead_time, times.shortest))
    every = _following(room, shape.pieces, followed, most)
    gains, chosen = levels.gained(every), []
    gained = np.zeros_like(gains[0])
    for _ in range(count):
        left = [np.sum(levels.left(gained + gain)) for gain in gains]
        chosen.append(int(np.argmin(left)))
        gained = gained + gains[chosen[-1]]
    # Neighbours go the same way, so that the stage flies back least.
    chosen.sort(key=lambda k: followed[k])
    exposure = every.exposure[chosen]
    gap = times.least_pauses(exposure)
    return Frames(exposure, every.velocity[chosen], gap, every.place[chosen], every.pan)


def changed(levels: Levels, room: Room, followed: tuple[float, ...], best: Frames) -> list[Frames]:
    """Frames of which one follows another thing: those by which a level would gain most."""
    own, pieces = levels.gained(best), best.velocity.shape[1] - 1
    whole, tries, found = np.sum(own, axis=0), [], []
    for frame, length in enumerate(best.exposure):
        every = _following(room, pieces, followed, float(length))
        for thing, gain in enumerate(levels.gained(every)):
            near = np.ptp([*best.velocity[frame].ravel(), followed[thing]]) < 0.02 * room.speed
            left = np.inf if near else np.sum(levels.left(whole - own[frame] + gain))
            tries.append((float(left), frame, thing, every))
    for _, frame, thing, every in sorted(tries, key=lambda each: each[0])[:_EXCHANGES]:
        exposure, velocity = best.exposure.copy(), best.velocity.copy()
        exposure[frame], velocity[frame] = every.exposure[thing], every.velocity[thing]
        found.append(best._replace(exposure=exposure, velocity=velocity))
    return found


def _following(room: Room, pieces: int, followed: tuple[float, ...], longest: float) -> Frames:
    """A frame that follows each thing, as long as its way is within the stroke."""
    velocity = np.clip(followed, -room.top_speed, room.top_speed)
    with np.errstate(divide="ignore"):
        exposure = np.clip(room.length / np.abs(velocity), room.times.shortest, longest)
    each = np.repeat(velocity[:, None, None], pieces + 1, axis=1)
    place = np.where(each[:, 0] < 0, room.length, 0.0)
    return Frames(exposure, each, exposure[1:], place, np.zeros(1))


def again(
    levels: Levels,
    room: Room,
    best: End,
    starts: Callable[[Frames], list[Frames]],
    *,
    times: int,
    least: float = 0.0,
) -> list[End]:
    """Ends of free descents from starts near the best, while that gains so many dB each time."""
    found = [best]
    for _ in range(times):
        for start in starts(best.frames):
            end = Descent(levels, room, start.shape).free(start)
            found += [] if end is None else [end]
        last, best = best, max(found, key=lambda end: end.level)
        if best.level < last.level + least:
            break
    return found[1:]


def near(room: Room) -> Callable[[Frames], list[Frames]]:
    """Starts of other velocities and exposures than those of some frames, drawn at random."""
    draw = np.random.default_rng(1)
    return lambda frames: [shaken(frames, draw, room, 0.05, 0.1)]


def reordered(room: Room) -> Callable[[Frames], list[Frames]]:
    """Starts of which one has a frame earlier or later, and one is shaken by more or less.

    The level is the same in any order, but not the room and the time that flights between frames
    take, and no descent leads from one order to another.
    """
    draw = np.random.default_rng(1)

    def starts(frames: Frames) -> list[Frames]:
        order = list(range(frames.exposure.size))
        order.insert(int(draw.integers(len(order))), order.pop(int(draw.integers(len(order)))))
        exposure, velocity, place = (each[order] for each in frames[:2] + frames[3:4])
        gap = room.times.least_pauses(exposure)
        moved = Frames(exposure, velocity, gap, place, frames.pan)
        shares = draw.choice(_SHARES, 2)
        return [shaken(moved, draw, room, *_SHARES[:2]), shaken(frames, draw, room, *shares)]

    return starts


def rearranged(levels: Levels, room: Room) -> Callable[[Frames], list[Frames]]:
    """Starts of which one frame each goes and another one stands twice, elsewhere or turned round.

    No descent leads there. The likeliest come first, and then ever less likely ones of the same
    frames.
    """
    draw, last, likeliest = np.random.default_rng(1), None, iter(())

    def starts(frames: Frames) -> list[Frames]:
        nonlocal last, likeliest
        if frames is not last:
            last, likeliest = frames, arrangements(levels, room, frames)
        return [shaken(moved, draw, room, 0.01) for moved in islice(likeliest, _LIKELIEST)]

    return starts


def arrangements(levels: Levels, room: Room, frames: Frames) -> Iterator[Frames]:
    """Frames of which one goes and another one stands twice, or elsewhere; the likeliest first.

    The level is the same in any order, and of frames that run backwards, but not the time that
    flights between them take. Time that is spared is worth what a longer exposure gains at least.
    """
    count, times, both = frames.exposure.size, room.times, _both_ways(frames)
    gains, gaps = levels.gained(frames), _least_gaps(room, both)
    whole, (error, by_exposure, _) = np.sum(gains, axis=0), levels.slope(frames)
    worth = max(float(np.min(-by_exposure)), _LEAST_GAIN / times.period)
    # With no frame before the first and after the last.
    gaps = np.pad(gaps, ((0, 1), (0, 1)))
    every, nothing = np.arange(2 * count), [2 * count]
    now = np.sum(np.diagonal(gaps[:count, :count], 1)) + np.sum(frames.exposure)
    moves = []
    for out in range(count):
        left = np.delete(np.arange(count), out)
        before, after = np.concatenate([nothing, left]), np.concatenate([left, nothing])
        between = gaps[before, after]
        added = gaps[before][:, every] + gaps[every][:, after].T - between[:, None]
        spared = now - np.sum(between) - np.sum(frames.exposure[left])
        spared = spared - np.min(added, axis=0) - both.exposure
        errors = (np.sum(levels.left(whole - gains[out] + gain)) for gain in gains)
        gained = [psnr_of_error(float(each)) + error for each in errors]
        for other in every.tolist():
            if other % count != out or spared[other] > 1e-9 * times.period:
                order = np.insert(left, int(np.argmin(added[:, other])), other)
                moves.append((gained[other % count] + worth * spared[other], order))
    least = math.inf
    for gain, order in sorted(moves, key=lambda move: -move[0]):
        # Many are all one, as frames are alike.
        if gain < least - _LEAST_GAIN:
            exposure, velocity, place = (part[order] for part in both[:2] + both[3:4])
            gap = np.maximum(gaps[order[:-1], order[1:]], times.period - exposure[1:])
            yield Frames(exposure, velocity, gap, place, frames.pan)
            least = gain


def _both_ways(frames: Frames) -> Frames:
    """Frames, and then the same as they run backwards."""
    exposure, place = (np.concatenate([x, x]) for x in (frames.exposure, frames.place))
    velocity = np.concatenate([frames.velocity, frames.velocity[:, ::-1]])
    return Frames(exposure, velocity, 0 * exposure[1:], place, frames.pan)


def _least_gaps(room: Room, frames: Frames) -> Float[np.ndarray, "n n"]:
    """Least time from the end of each frame to the begin of each, wherever both have room; s."""
    stage, times, length = frames.stage[..., 0], room.times, room.length
    knots = (frames.knots - frames.place[:, None])[..., 0]
    first, last = stage[:, :-1], stage[:, 1:]
    gain = np.where(first * last < 0, last - first, np.inf)
    places = np.concatenate([knots, knots[:, :-1] - first**2 * frames.steps / (2 * gain)], axis=1)
    low, high, end = np.min(places, axis=1), np.max(places, axis=1), knots[:, -1:]
    shortest = max(times.dead_time, LEAST_GAP * times.period)
    tried = np.geomspace(shortest, max(times.window, shortest), _GAPS)[:, None, None]
    leave, meet, tried = np.broadcast_arrays(stage[:, -1:], stage[:, 0], tried)
    least, most = room.reach(leave, meet, tried)
    # Ways between them where the one is as far up as it can be and the other down, and in turn.
    possible = (least <= length - high + low[:, None] - end) & (
        most >= high[:, None] - length - low - end
    )
    possible &= np.abs(meet - leave) <= room.acceleration * tried
    gaps = np.where(np.any(possible, axis=0), tried[np.argmax(possible, axis=0), 0, 0], tried[-1])
    return np.maximum(gaps, times.period - frames.exposure)


def shaken(
    frames: Frames, draw: np.random.Generator, room: Room, share: float, of_exposure: float = 0.0
) -> Frames:
    """Frames of other velocities, by a share of the fastest thing's, and other exposures."""
    noise = draw.normal(size=frames.velocity.shape)
    longer = np.exp(of_exposure * draw.normal(size=frames.exposure.shape))
    velocity = frames.velocity + share * room.speed * noise
    return frames._replace(exposure=frames.exposure * longer, velocity=velocity)
