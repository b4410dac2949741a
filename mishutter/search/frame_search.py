"""The best frames of a sensor that moves along one axis or two, found by one search.

Each frame has a length, velocities at the ends of its pieces and a place, and the stage goes from one
to the next in any way that it can (`mishutter.search.frame_limits`). What the level gains by each
number is known in closed form (`mishutter.search.frame_levels`), and SciPy's SLSQP climbs from a few
starts. Cameras of few numbers, which pan, sweep, swing, follow things and fly back, or take another
velocity in each frame, are the same frames tied to a few numbers. They are searched first; they are the
starts of the free search, and are preferred where they are as good.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter.model.sequences import SINE
from mishutter.search.frame_levels import Frames, Levels
from mishutter.search.frame_limits import Room

PAN, SWEEP, ALTERNATING, FAN, FOLLOW, FREE = (
    "pan",
    "sweep",
    "alternating parabolas",
    "fan of pans",
    "pans with flights back",
    "free path",
)
"""Ways along an axis, the simplest first."""
STILLS, BRACKETED, CIRCLE, TWO_SINES, CROSSED, RING = (
    "stills",
    "stills of two exposures",
    "circle",
    "two sines",
    "crossed parabolas",
    "ring of velocities",
)
"""Frames at rest, and ways along two axes."""
WAYS = PAN, SWEEP, ALTERNATING, FAN, FOLLOW
"""Those of few numbers."""
MOST_FREE = 24
"""Frames up to which each has numbers of its own."""
_ON_TWO_AXES = CIRCLE, TWO_SINES, CROSSED, RING
_DUTY_OF_CROSS = 2 / 3
"""Duty at which the gaps between crossed parabolas take no more acceleration than these."""
_STEP = 1e-7
"""Step of the differences of limits, whose numbers are of the order of 1."""
_STEP_OF_TIE = 1e-6
_FASTEST = 1.5
"""Top speed of a way that may pay, over that of the fastest thing."""
_PIECES_OF_SINE = 8
_AS_GOOD = 0.02
"""Decibels below the best at which still fewer frames are tried."""
_RESTARTS = 3
_STALLS = 6, 1e-3
"""Steps without a gain of so many dB after which a descent ends."""


class End(NamedTuple):
    """Frames that a descent ended at."""

    level: float  # dB
    frames: Frames
    kind: str


class Descent:
    """Descents of frames of some number, pieces and axes within a room."""

    def __init__(self, levels: Levels, room: Room, shape: tuple[int, int, int]) -> None:
        self.levels, self.room, self.shape = levels, room, shape
        self.bounds = room.bounds(*shape)

    def _cost(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        frames, _ = self.room.split(x, *self.shape)
        error, by_exposure, by_velocity = self.levels.slope(frames)
        slope, count = np.zeros_like(x), self.shape[0]
        slope[:count] = by_exposure * self.room.times.period
        slope[count : count + by_velocity.size] = by_velocity.ravel() * self.room.speed
        return error, slope

    def _climb(self, cost, slack, steps, start, bounds, most: int) -> np.ndarray | None:
        """The best point within limits, but for what `_within` mends."""
        from scipy.optimize import minimize

        best: list[Any] = [-math.inf, None]
        stalls, evaluations = [0], [0]

        def counted(x: np.ndarray):
            evaluations[0] += 1
            return cost(x)

        def watch(x: np.ndarray) -> None:
            error, _ = cost(x)
            excess = -float(np.min(slack(x)))
            if excess < 3e-3 and -error > best[0] + _STALLS[1]:
                best[:], stalls[0] = [-error, x.copy()], 0
            else:
                if excess < 3e-3 and -error > best[0]:
                    best[:] = [-error, x.copy()]
                stalls[0] += best[1] is not None
            if stalls[0] >= _STALLS[0] or evaluations[0] > 4 * most:
                raise StopIteration

        constraints = {"type": "ineq", "fun": slack, "jac": steps}
        options = {"maxiter": most, "ftol": 1e-6}
        try:
            minimize(
                counted,
                start,
                jac=True,
                bounds=bounds,
                method="SLSQP",
                options=options,
                constraints=constraints,
                callback=watch,
            )
        except StopIteration:
            pass
        return best[1]

    def from_frames(self, start: Frames, kind: str, most: int = 60) -> End:
        """The end of a descent of all numbers."""
        room, shape = self.room, self.shape
        low, high = self.bounds.T
        x = np.clip(room.joined(start), low, high)
        eye = _STEP * np.eye(x.size)

        def slack(x: np.ndarray) -> np.ndarray:
            return room.slack(x, *shape)

        def steps(x: np.ndarray) -> np.ndarray:
            return ((slack(x + eye) - slack(x)) / _STEP).T

        end = self._climb(self._cost, slack, steps, x, self.bounds, most)
        return self._ended(None if end is None else self._nearest(end, slack, steps), kind)

    def _nearest(self, x: np.ndarray, slack: Any, steps: Any) -> np.ndarray:
        """The nearest numbers within the limits, to all digits."""
        from scipy.optimize import minimize

        end: Any = minimize(
            lambda z: (np.sum((z - x) ** 2) / 2, z - x),
            x,
            jac=True,
            bounds=self.bounds,
            method="SLSQP",
            options={"maxiter": 30, "ftol": 1e-14},
            constraints={"type": "ineq", "fun": slack, "jac": steps},
        )
        return end.x

    def _ended(self, x: np.ndarray | None, kind: str) -> End:
        if x is None:
            return End(-math.inf, None, kind)  # type: ignore[arg-type]
        frames, _ = self.room.split(x, *self.shape)
        return End(self.levels.level(frames), frames, kind)

    def tied(self, tie: "Tie", start: Float[np.ndarray, "z"], most: int = 40) -> End:
        """The end of a descent of the numbers of a tie, from 0 to 1."""
        room, shape = self.room, self.shape

        def whole(z: np.ndarray) -> np.ndarray:
            return room.joined(tie.frames(z))

        def moved(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            inwards = np.where(z > 0.5, -_STEP_OF_TIE, _STEP_OF_TIE)
            return inwards, np.stack([whole(z + x) for x in np.diag(inwards)])

        def cost(z: np.ndarray) -> tuple[float, np.ndarray]:
            error, slope = self._cost(whole(z))
            inwards, every = moved(z)
            return error, (every - whole(z)) @ slope / inwards

        def slack(z: np.ndarray) -> np.ndarray:
            return room.slack(whole(z), *shape)

        def steps(z: np.ndarray) -> np.ndarray:
            inwards, every = moved(z)
            return ((room.slack(every, *shape) - slack(z)) / inwards[:, None]).T

        bounds = [(0.0, 1.0)] * start.size
        end = self._climb(cost, slack, steps, start, bounds, most)
        return self._ended(None if end is None else whole(end), tie.kind)


class Tie(NamedTuple):
    """Equal frames at equal times, on a way of few numbers along one direction.

    The numbers are from 0 to 1: exposure, wait, velocity about which it is, and how much it changes.
    """

    kind: str
    room: Room
    shape: tuple[int, int, int]  # Numbers of frames, pieces and axes
    slowest: float  # Least component of things along the direction; px/s
    fastest: float  # Greatest; px/s
    unit: Float[np.ndarray, "axes"]  # The direction
    across: Float[np.ndarray, "axes"]  # Velocity of all frames across it; px/s
    max_jerk: float  # Greatest jerk of a sine; px/s^3
    widest: float = 0.0  # Greatest component of things across the direction; px/s

    @property
    def exists(self) -> bool:
        """Whether there are such frames of this number."""
        return self.shape[0] > 1 or self.kind in (STILLS, PAN, ALTERNATING, CIRCLE, TWO_SINES)

    @property
    def starts(self) -> list[Float[np.ndarray, "z"]]:
        """Numbers that a search begins with."""
        low, high = self._velocities
        at = (self._middle - low) / (high - low) if high > low else 0.5
        if self.kind in (STILLS, BRACKETED):
            return [np.array([x, 0.0, at, 0.5]) for x in (0.5, 0.75)]
        if self.kind in (CIRCLE, TWO_SINES):
            phases = [] if self.kind == CIRCLE else [0.15]
            return [np.array([1.0, 0.0, at, 0.48, turns, *phases]) for turns in (0.5, 0.25, 0.75)]
        if self.kind in (PAN, FOLLOW):
            return [np.array([x, 0.0, at, 0.0]) for x in (0.6, 0.9)]
        return [np.array([x, 0.0, at, y]) for x, y in ((0.98, 0.5), (0.9, 0.25))]

    @property
    def _middle(self) -> float:
        return (self.slowest + self.fastest) / 2

    @property
    def _velocities(self) -> tuple[float, float]:
        """Velocities about which a way may be; px/s."""
        low, high = min(self.slowest, 0.0), max(self.fastest, 0.0)
        return low - 0.05 * (high - low), high + 0.05 * (high - low)

    def frames(self, z: Float[np.ndarray, "z"]) -> Frames:
        """The frames of some numbers."""
        count, pieces, axes = self.shape
        times, room = self.room.times, self.room
        shortest, longest = times.shortest, max(times.longest_of(count), times.shortest)
        if self.kind == CROSSED:  # gaps as steep as the parabolas
            longest = max(min(longest, _DUTY_OF_CROSS * times.period_of(longest)), shortest)
        exposure = shortest * (longest / shortest) ** z[0]
        if self.kind in (STILLS, BRACKETED):
            return self._at_rest(exposure, z[3])
        period = times.period_of(exposure)
        if self.kind == CROSSED:
            period = max(period, exposure / _DUTY_OF_CROSS)
        if count > 1:
            most = max((times.window - exposure) / (count - 1), period)
            period = period * (most / period) ** z[1]
        low, high = self._velocities
        mean = low + (high - low) * z[2]
        top = _FASTEST * z[3] * max(abs(self.slowest), abs(self.fastest))
        if self.fastest * self.slowest > 0:  # they differ by less than they move
            top = _FASTEST * z[3] * (self.fastest - self.slowest)
        number = np.arange(count)[:, None]
        within = np.linspace(-0.5, 0.5, pieces + 1)
        clock = (number - (count - 1) / 2) * period + exposure * within
        if self.kind == SWEEP:
            shape = clock / np.max(np.abs(clock))
        elif self.kind == ALTERNATING:
            shape = (-1.0) ** number * 2 * within
        elif self.kind == SINE:
            turn = np.pi / period
            top = min(top, self.max_jerk / turn**2)
            shape = (-1.0) ** number * np.sin(turn * exposure * within)
        elif self.kind == FAN:
            shape = np.linspace(-1, 1, count)[:, None] + 0 * within
        else:
            shape = 0 * clock
        along = mean + top * shape
        velocity = along[..., None] * self.unit + self.across
        if self.kind in _ON_TWO_AXES:
            velocity = velocity + self._on_two_axes(z, clock, within)
        pan = mean * self.unit + self.across if room.turns else np.zeros(axes)
        gap = np.full(count - 1, period - exposure if period - exposure > 1e-9 * period else 0.0)
        stage = velocity - pan
        step = exposure / pieces
        ways = step * np.sum((stage[:, 1:] + stage[:, :-1]) / 2, axis=1)
        place = np.zeros((count, axes))
        if self.kind == FOLLOW:
            place = room.stroke / 2 - ways / 2
        else:
            between = (stage[:-1, -1] + stage[1:, 0]) / 2 * gap[:, None]
            place[1:] = np.cumsum(ways[:-1] + between, axis=0)
            knots = place[:, None] + np.cumsum(
                np.concatenate(
                    [np.zeros((count, 1, axes)), step * (stage[:, 1:] + stage[:, :-1]) / 2], 1
                ),
                axis=1,
            )
            place += room.stroke / 2 - (np.max(knots, (0, 1)) + np.min(knots, (0, 1))) / 2
        return Frames(np.full(count, exposure), velocity, gap, place, pan)

    def _at_rest(self, exposure: float, share: float) -> Frames:
        """Frames at rest, the first as long as the others leave time for where there are two lengths."""
        (count, pieces, axes), times = self.shape, self.room.times
        lengths = np.full(count, exposure)
        if self.kind == BRACKETED:
            left = times.window - (count - 1) * times.period_of(exposure) - times.dead_time
            longest = max(min(times.longest, left), exposure)
            lengths[0] = exposure * (longest / exposure) ** share
        gap = np.array([times.period_of(x) - x for x in lengths[1:]])
        rest, middle = (
            np.zeros((count, pieces + 1, axes)),
            np.full((count, axes), self.room.stroke / 2),
        )
        return Frames(lengths, rest, gap, middle, np.zeros(axes))

    def _on_two_axes(self, z: np.ndarray, clock: np.ndarray, within: np.ndarray) -> np.ndarray:
        """Velocities beside the mean, along the direction and across it; px/s."""
        count = self.shape[0]
        half = (self.fastest - self.slowest) / 2, self.widest
        speeds = _FASTEST * z[3] * np.array(half)
        if self.kind == RING:
            angle = 2 * np.pi * (np.arange(count) + 0.5) / count
            each = np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None] + 0 * within[:, None]
        elif self.kind == CROSSED:
            each = np.zeros((*clock.shape, 2))
            for k in range(count):
                each[k, :, k % 2] = 2 * within * (-1.0) ** (k // 2)
        else:
            fewest, most = 0.3, max(2.0, float(count))
            turns = fewest * (most / fewest) ** z[4]
            drift = 2.0 * z[5] if z.size > 5 else 0.0
            phase = 2 * np.pi * clock / np.ptp(clock)
            first, second = ((turns + sign * drift / 2) * phase for sign in (-1, 1))
            each = np.stack([-np.sin(first), np.cos(second)], axis=-1)
        across = np.array([-self.unit[1], self.unit[0]])
        return (speeds * each) @ np.stack([self.unit, across])


class Search(NamedTuple):
    """A search for frames of things along one axis, or in the plane."""

    levels: Levels
    room: Room
    axes: int  # Axes of the stage
    ties: Callable[[tuple[int, int, int]], list[Tie]]  # Ways of few numbers, of some shape
    pieces: Callable[[int], int]  # Pieces of each of so many frames
    is_free: bool = True  # Whether each frame may have numbers of its own

    def ends(self, counts: list[int], progress: Callable[[float], None]) -> list[End]:
        """Ends of descents of the most frames and of ever fewer, while fewer are as good."""
        every: list[End] = []
        best, count = -math.inf, counts[-1]
        while True:
            progress(1 - count / (counts[-1] + 1))
            here = self.of_number(count)
            every += here
            top = max(end.level for end in here)
            fewer = [n for n in counts if n < count]
            if not fewer or top < best - _AS_GOOD:
                break
            best = max(best, top)
            count = max((n for n in fewer if n <= 0.8 * count), default=fewer[0])
        most = max(every, key=_level)
        if self.is_free and most.frames is not None and most.frames.exposure.size <= MOST_FREE:
            every += self.again(most)
        return every

    def of_number(self, count: int) -> list[End]:
        """Ends of descents of so many frames."""
        descent = Descent(self.levels, self.room, (count, self.pieces(count), self.axes))
        tied = []
        for tie in self.ties(descent.shape):
            own = descent
            if tie.kind == SINE:
                tie = tie._replace(shape=(count, _PIECES_OF_SINE, self.axes))
                own = Descent(self.levels, self.room, tie.shape)
            tied.append(max((own.tied(tie, start) for start in tie.starts), key=_level))
        if count > MOST_FREE or not self.is_free:
            return tied
        draw = np.random.default_rng(count)
        # Of a camera that pans each frame may turn into anything, as it is at its limits of nothing.
        firsts = {end.kind: end for end in tied if end.frames is not None}
        best = [end.kind for end in sorted(firsts.values(), key=_level)[::-1]]
        kinds = dict.fromkeys([*(k for k in (PAN, FOLLOW) if k in firsts), *best])
        starts = [shaken(firsts[kind].frames, draw, self.room, 0.01, 0.0) for kind in [*kinds][:3]]
        return [*tied, *(descent.from_frames(start, FREE) for start in starts)]

    def again(self, best: End, times: int = _RESTARTS) -> list[End]:
        """Ends of descents from near the best."""
        count, pieces = best.frames.exposure.size, best.frames.velocity.shape[1] - 1
        descent, draw = (
            Descent(self.levels, self.room, (count, pieces, self.axes)),
            np.random.default_rng(1),
        )
        found = [best]
        for _ in range(times):
            start = shaken(max(found, key=_level).frames, draw, self.room, 0.05, 0.1)
            found.append(descent.from_frames(start, FREE))
        return found[1:]


def shaken(frames: Frames, draw: Any, room: Room, share: float, of_exposure: float) -> Frames:
    """Frames of other velocities, by a share of the fastest thing's, and other exposures."""
    noise = draw.normal(size=frames.velocity.shape)
    longer = np.exp(of_exposure * draw.normal(size=frames.exposure.shape))
    velocity = frames.velocity + share * room.speed * noise
    return frames._replace(exposure=frames.exposure * longer, velocity=velocity)


def _level(end: End) -> float:
    return end.level
