r"""The way of a stage: from rest to the velocity of an exposure, through it, and back to rest.

A path is cut at knots. Between two of them the jerk is constant: over the duration $d$ the velocity
goes from $u_0$ to $u_1$ by

$$u(\sigma) = u_0 + (u_1 - u_0 - \kappa)\,\sigma + \kappa\,\sigma^2, \qquad \kappa = jd^2/2,$$

with $\sigma$ from 0 to 1, and the stage travels $d\,(u_0 + u_1)/2 - jd^3/12$. `Knots.use` has
what such a path asks of a stage, of one exposure or many; whatever says it, searches within it or
writes it to a file asks there.

From rest at the greatest acceleration $A$ a velocity $u$ takes the time $|u|/A$. Where the jerk is
at most $J$ the acceleration must rise to that of the exposure, $2a$, before it begins, over the
time $2a/J$, in which the velocity changes by $2a^2/J$. The velocity $U$ before that is reached from
rest in the time $|U|/A + A/J$, or $2\sqrt{|U|/J}$ where $A$ is not reached ($|U| J < A^2$), without
any acceleration at either end. A run-out is such a run-up backwards.
"""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from mishutter._core.checks import (
    Numbers,
    require,
    require_finite,
    require_known,
    require_number,
    space_of,
)
from mishutter._core.slopes import largest_of, safe_sqrt
from mishutter.model.motion import AbstractMotion

_AT_ONCE = 1e9
"""Acceleration over the least that is needed, as which any counts where none is limited."""
SINGLE = 1e-5
"""Share of a number below which it is one of rounding, in single precision."""
Number = Numbers | np.floating | float
"""One number, or many of any shape."""


class StageUse(NamedTuple):
    """The demands of a path from rest to rest on a stage; of any shape."""

    # From the lowest to the highest position, run-up and run-out included; px
    travel: Float[Array | np.ndarray, "..."]
    stroke: Float[Array | np.ndarray, "..."]  # The same from the first light to the last; px
    # Greatest speed, of the run-up and the run-out too; px/s
    top_speed: Float[Array | np.ndarray, "..."]
    # Greatest acceleration; px/s^2. A velocity that is reached at once takes none
    acceleration: Float[Array | np.ndarray, "..."]
    jerk: Float[Array | np.ndarray, "..."]  # Greatest jerk, but for accelerations that jump; px/s^3


class Piece(NamedTuple):
    """A piece of constant jerk, of any shape."""

    duration: Number  # s
    end: Number  # Velocity at its end; px/s
    jerk: Number = 0.0  # px/s^3


class Knots(NamedTuple):
    """A path of a stage, of any shape but for the last axis, which holds its pieces."""

    durations: Numbers  # Durations of the pieces; s, `(..., n)`
    # Velocities at their beginnings and at the end of the last; px/s, `(..., n + 1)`
    velocities: Any
    jerks: (
        Numbers | None
    )  # Jerks; px/s^3, `(..., n)`. None where the velocity is linear in each piece
    first: int  # Number of the knot at the first light
    last: int  # Number of the knot at the last light

    @staticmethod
    def of(start: Number, pieces: list[Piece]) -> "Knots":
        """The way of some pieces from a velocity, px/s, all of which are lit."""
        durations, ends, jerks = zip(*pieces, strict=True)
        is_linear = all(isinstance(jerk, float) and jerk == 0 for jerk in jerks)
        # Every number takes part, so that all arrays have the shape and the type of all.
        nothing = sum(0 * (duration + end + jerk) for duration, end, jerk in pieces)
        space = space_of(nothing)

        def joined(values: Iterable[Number]) -> Numbers:
            return space.stack([nothing + x for x in values], axis=-1)

        jerk = None if is_linear else joined(jerks)
        return Knots(joined(durations), joined((start, *ends)), jerk, 0, len(pieces))

    @staticmethod
    def of_exposure(motion: AbstractMotion) -> "Knots":
        """The way of the stage over an exposure, in double precision; concrete."""
        return Knots.of_motion(jax.tree.map(lambda number: np.asarray(number, np.float64), motion))

    @staticmethod
    def of_motion(motion: AbstractMotion) -> "Knots":
        """The way of the stage over an exposure; of the shape of stacked motions."""
        half, velocities = motion.half_exposure[..., None], motion.end_velocities
        lengths = np.diff(np.array(motion.piece_ends, float)).astype(half.dtype)
        across = lengths.reshape((1,) * (half.ndim - 1) + (-1,))
        return Knots(half * across, velocities, None, 0, lengths.size)

    @property
    def positions(self) -> Numbers:
        """Positions from that at the first knot; px."""
        space, d = space_of(self.durations, self.velocities), self.durations
        ways = d * (self.velocities[..., :-1] + self.velocities[..., 1:]) / 2
        if self.jerks is not None:
            ways = ways - self.jerks * d**3 / 12
        return space.concatenate([0 * ways[..., :1], space.cumsum(ways, -1)], -1)

    @property
    def accelerations(self) -> Float[np.ndarray, "n"]:
        """Accelerations with which its pieces begin, of a concrete way; px/s^2."""
        d = self.durations
        bends = 0.0 if self.jerks is None else self.jerks * d * d / 2
        return (np.diff(self.velocities) - bends) / np.where(_lasts(d), d, np.inf)

    @property
    def pieces(self) -> list[Piece]:
        """Its pieces, where the velocity is linear in each."""
        return [Piece(*each) for each in zip(self.durations, self.velocities[1:], strict=True)]

    @property
    def use(self) -> StageUse:
        """Its demands on a stage, turning points within its pieces included."""
        d, v, jerks, first, last = self
        space, begin, end = space_of(d, v), v[..., :-1], v[..., 1:]
        places, gain = self.positions, end - begin
        if jerks is None:
            bend = jerk = 0 * gain
            shares, fastest = [_share(begin, begin - end)], abs(v)
        else:
            bend = jerks * d * d / 2
            jerk = space.where(_lasts(d), abs(jerks), 0.0)
            shares = _roots(bend, gain - bend, begin)
            crest = _share(bend - gain, 2 * bend)
            turning = abs(begin + crest * (gain - bend + crest * bend))
            fastest = space.concatenate([abs(v), turning], axis=-1)
        extremes = [
            (places[..., :-1] + d * s * (begin + s * ((gain - bend) / 2 + s * bend / 3)))
            for s in shares
        ]

        def span(start: int, stop: int) -> Numbers:
            every = [places[..., start : stop + 1], *(x[..., start:stop] for x in extremes)]
            every = space.concatenate(every, axis=-1)
            return largest_of(every) + largest_of(-every)

        lasting = space.where(_lasts(d), d, np.inf)
        steepest = space.maximum(abs(gain - bend), abs(gain + bend)) / lasting
        return StageUse(
            span(0, d.shape[-1]),
            span(first, last),
            *map(largest_of, (fastest, steepest, jerk)),
        )

    def from_rest_to_rest(
        self,
        accelerations: tuple[Number, Number],  # px/s^2, of its shape
        max_acceleration: Number | None = None,  # px/s^2
        max_jerk: Number | None = None,  # px/s^3
    ) -> "Knots":
        """The way from rest through this one, lit from its first knot to its last, to rest."""
        begin, end = accelerations
        start, stop = self.velocities[..., 0], self.velocities[..., -1]
        before = run_up(start, begin, max_acceleration, max_jerk)
        # Backwards in time a run-out is a run-up to the opposite velocity.
        after = run_up(-stop, end, max_acceleration, max_jerk)[::-1]
        nothing, space = 0 * start, space_of(start)

        def joined(first: list[Number], middle: Numbers, last: list[Number]) -> Numbers:
            low, high = ([(nothing + x)[..., None] for x in each] for each in (first, last))
            return space.concatenate([*low, nothing[..., None] + middle, *high], axis=-1)

        is_linear = self.jerks is None and max_jerk is None
        first = len(before)
        lit = first + self.first, first + self.last
        rising, falling = ([x.duration for x in each] for each in (before, after))
        durations = joined(rising, self.durations, falling)
        starts, stops = [0.0, *(x.end for x in before[:-1])], [*(-x.end for x in after[1:]), 0.0]
        velocities, jerks = joined(starts, self.velocities, stops), None
        if not is_linear:
            own = 0 * self.durations if self.jerks is None else self.jerks
            jerks = joined([x.jerk for x in before], own, [-x.jerk for x in after])
        return Knots(durations, velocities, jerks, *lit)

    def led(self, lead: float) -> "Knots":
        """A known way along each axis that goes on for a time before and after it, as `led`."""
        velocities = np.atleast_2d(self.velocities)
        durations, velocities, first = led(np.asarray(self.durations), velocities, lead)
        last, jerks = first + self.durations.size, self.jerks
        if jerks is not None:
            jerks = np.pad(jerks, (first, durations.size - last))
        velocities = velocities if self.velocities.ndim > 1 else velocities[0]
        return Knots(durations, velocities, jerks, first, last)

    def path(self, time: float, place: float) -> "StagePath":
        """The path whose first light is at a time, s, and a place, px."""
        durations = np.asarray(self.durations)
        lasts = np.append(_lasts(durations), True)
        times = np.append(0.0, np.cumsum(durations))
        times, positions = (
            x - x[self.first] + start
            for x, start in ((times, time), (np.asarray(self.positions), place))
        )
        exposure = float(times[self.first]), float(times[self.last])
        kept = lasts[:-1]
        jerks = np.zeros(kept.size) if self.jerks is None else np.asarray(self.jerks)
        knots = times[lasts], positions[lasts], self.velocities[lasts]
        return StagePath(*knots, self.accelerations[kept], jerks[kept], exposure)


def _lasts(durations: Numbers) -> Numbers:
    """Whether each piece is longer than one that rounding makes, whose velocities say nothing."""
    least = 64 * np.finfo(durations.dtype).eps
    return durations > least * space_of(durations).sum(durations, axis=-1, keepdims=True)


def _share(part: Number, whole: Number) -> Numbers:
    """A quotient where it is between 0 and 1; 0 elsewhere."""
    space = space_of(part, whole)
    is_within = ((part > 0) == (whole > 0)) & (part != 0) & (abs(part) < abs(whole))
    return space.where(is_within, part / space.where(is_within, whole, 1.0), 0.0)


def _roots(square: Numbers, linear: Numbers, constant: Numbers) -> list[Numbers]:
    """The shares of a piece at which a velocity is 0, without a difference of like numbers."""
    space = space_of(square, linear, constant)
    left = linear * linear - 4 * square * constant
    root = safe_sqrt(left)
    half = -(linear + space.where(linear < 0, -root, root)) / 2
    exists = left >= 0
    return [
        space.where(exists, _share(half, square), 0.0),
        space.where(exists, _share(constant, half), 0.0),
    ]


def run_up(
    velocity: Number,
    acceleration: Number,
    max_acceleration: Number | None = None,
    max_jerk: Number | None = None,
) -> list[Piece]:
    """The quickest pieces from rest to a velocity and, if jerk is limited, an acceleration."""
    if max_jerk is None:
        most = np.inf if max_acceleration is None else max_acceleration
        return [Piece(abs(velocity) / most, velocity)]
    space = space_of(velocity, acceleration)
    ramp = abs(acceleration) / max_jerk
    before = velocity - acceleration * ramp / 2
    speed, sign = abs(before), space.sign(before)
    reached = safe_sqrt(speed * max_jerk)
    if max_acceleration is not None:
        reached = space.minimum(reached, max_acceleration)
    rise = reached / max_jerk
    hold = space.maximum(speed / space.where(reached > 0, reached, 1.0) - rise, 0.0)
    gain = sign * reached * rise / 2
    return [
        Piece(rise, gain, sign * max_jerk),
        Piece(hold, before - gain),
        Piece(rise, before, -sign * max_jerk),
        Piece(ramp, velocity, space.sign(acceleration) * max_jerk),
    ]


def stage_use(
    motion: AbstractMotion,
    max_acceleration: Number | None = None,
    max_jerk: Number | None = None,
) -> StageUse:
    """The demands of a motion on a stage, from rest to rest; of the shape of stacked motions."""
    rates = 2 * motion.piece_accelerations
    ends = rates[..., 0], rates[..., -1]
    return Knots.of_motion(motion).from_rest_to_rest(ends, max_acceleration, max_jerk).use


def led(
    durations: Float[np.ndarray, "p"], velocities: Float[np.ndarray, "axes p+1"], lead: float
) -> tuple[Float[np.ndarray, "q"], Float[np.ndarray, "axes q+1"], int]:
    """Pieces of a path that goes on for a time before its begin and after its end.

    It goes on as its own mirror image: along its velocity there at the same speeds, and across it
    at opposite ones. Alternating parabolas and sines alternate, a circle turns on, a pan pans, and
    no speed or acceleration grows. Its own first piece has the number that is the third result.

    Args:
        durations: Durations of its pieces; s.
        velocities: Velocities at their ends; px/s.
        lead: That time; s.
    """
    before, first = _mirrored(durations, velocities, lead)
    after, last = _mirrored(durations[::-1], velocities[:, ::-1], lead)
    whole = [first[:, :0:-1], velocities, last[:, 1:]]
    every = np.concatenate([before[::-1], durations, after])
    return every, np.concatenate(whole, axis=1), before.size


def _mirrored(
    durations: Float[np.ndarray, "p"], velocities: Float[np.ndarray, "axes p+1"], lead: float
) -> tuple[Float[np.ndarray, "q"], Float[np.ndarray, "axes q+1"]]:
    """Pieces from the begin of a path backwards for a time; the last goes on for what is left."""
    ends = np.append(0.0, np.cumsum(durations))
    inner = ends[(ends > 0) & (ends < lead)]
    times = np.unique([0.0, *inner, lead])
    _, firsts = np.unique(ends, return_index=True)
    each = np.array([np.interp(times, ends[firsts], v[firsts]) for v in velocities])
    size = float(np.linalg.norm(velocities[:, 0]))
    unit = velocities[:, 0] / size if size > 0 else 0 * velocities[:, 0]
    return np.diff(times), 2 * unit[:, None] * (unit @ each) - each


class StagePath(NamedTuple):
    """A stage from rest through one exposure or more to rest: pieces of constant jerk."""

    # Beginnings of the pieces and the end of the last, from mid-exposure, or the middle of a
    # sequence of frames; s, `(n + 1,)`
    times: Float[np.ndarray, "n+1"]
    positions: Float[np.ndarray, "n+1"]  # Positions there; px, `(n + 1,)`
    velocities: Float[np.ndarray, "n+1"]  # Velocities there; px/s, `(n + 1,)`
    # Accelerations at the beginnings of the pieces; px/s^2, `(n,)`
    accelerations: Float[np.ndarray, "n"]
    jerks: Float[np.ndarray, "n"]  # Jerks; px/s^3, `(n,)`
    exposure: tuple[float, float]  # Beginning and end of the exposure, or of all; s

    @property
    def use(self) -> StageUse:
        """Its demands on a stage."""
        first, last = (int(np.argmin(abs(self.times - time))) for time in self.exposure)
        jerks = self.jerks if np.any(self.jerks) else None
        return Knots(np.diff(self.times), self.velocities, jerks, first, last).use

    @property
    def travel(self) -> float:
        """Distance from the lowest to the highest position, turning points included; px."""
        return float(self.use.travel)

    def at(
        self, times: Float[np.ndarray, "*times"]
    ) -> tuple[Float[np.ndarray, "*times"], Float[np.ndarray, "*times"]]:
        """Positions, px, and velocities, px/s, at some times, s, of any shape; at rest outside."""
        piece = self._piece_at(times)
        elapsed = np.clip(times, self.times[0], self.times[-1]) - self.times[piece]
        start = self.positions[piece], self.velocities[piece], self.accelerations[piece]
        jerk = self.jerks[piece]
        position = start[0] + elapsed * (start[1] + elapsed * (start[2] / 2 + elapsed * (jerk / 6)))
        velocity = start[1] + elapsed * (start[2] + elapsed * (jerk / 2))
        rests = (times <= self.times[0]) | (times >= self.times[-1])
        return position, np.where(rests, 0.0, velocity)

    def _piece_at(self, times: Float[np.ndarray, "*times"]) -> Int[np.ndarray, "*times"]:
        """The piece that each time falls in: the first before the path, the last after it."""
        piece = np.searchsorted(self.times, times, side="right") - 1
        return np.clip(piece, 0, self.jerks.size - 1)

    def acceleration_at(self, times: Float[np.ndarray, "*times"]) -> Float[np.ndarray, "*times"]:
        """Accelerations, px/s^2, at some times, s, of any shape: where they jump, those after."""
        piece = self._piece_at(times)
        acceleration = self.accelerations[piece] + self.jerks[piece] * (times - self.times[piece])
        rests = (times < self.times[0]) | (times >= self.times[-1])
        return np.where(rests, 0.0, acceleration)


def stage_path(
    motion: AbstractMotion,
    *,
    max_acceleration: ArrayLike | None = None,
    max_jerk: ArrayLike | None = None,
) -> StagePath:
    """The whole path of a stage: rest, run-up, exposure, run-out, rest.

    The run-up and the run-out reach the velocity, and with a `max_jerk` the acceleration, of the
    exposure's ends at the greatest acceleration; `mishutter.model.stages` derives them.

    Args:
        motion: Motion of the sensor over the exposure.
        max_acceleration: Greatest acceleration, at least the exposure's own $2a$; px/s^2. None for
            any, where the jerk is limited.
        max_jerk: Greatest jerk; px/s^3. None for any, as a free path needs.

    Raises:
        ValueError: if a limit is not a finite scalar above 0, is exceeded within the exposure, or
            both are None, or there is no motion, or JAX traces anything.
    """
    is_motion = isinstance(motion, AbstractMotion)
    require(is_motion, "stage_path(motion=...)", "be a motion", motion)
    require_known("stage_path", motion=motion, limits=(max_acceleration, max_jerk))
    for number in jax.tree.leaves(motion):
        require_finite("stage_path(motion=...)", number)
    subject = "stage_path(max_acceleration=...)"
    limited = max_acceleration is not None or max_jerk is not None
    require(limited, subject, "be given where the jerk is not limited", max_acceleration)
    most = np.inf if max_acceleration is None else _above_zero(subject, max_acceleration)
    jerk = None if max_jerk is None else _above_zero("stage_path(max_jerk=...)", max_jerk)
    half, own = float(motion.half_exposure), float(motion.greatest_acceleration)
    requirement = f"be at least the {own:g} px/s^2 of the exposure"
    require(most >= own * (1 - 1e-9), subject, requirement, most)
    is_smooth = jerk is None or motion.accelerates_constantly
    requirement = "be left out for a free path, whose acceleration jumps between pieces"
    require(is_smooth, "stage_path(max_jerk=...)", requirement, max_jerk)
    within = Knots.of_exposure(motion)
    ends = within.accelerations[[0, -1]]
    knots = within.from_rest_to_rest((ends[0], ends[1]), most, jerk)
    return knots.path(-half, place_at_begin(motion))


def place_at_begin(motion: AbstractMotion) -> float:
    """Place at the beginning of an exposure, from that at mid-exposure; px."""
    begin = np.array([-float(motion.half_exposure)])
    return float(np.asarray(motion.position(begin))[0])


def _above_zero(subject: str, value: ArrayLike) -> float:
    require_number(subject, value, "above 0", strict=True)
    return float(np.asarray(value))


def transfer(
    way: float,  # px
    gap: float,  # s
    start: float,  # px/s
    end: float,  # px/s
    *,
    acceleration: float | None = None,  # px/s^2
    top_speed: float | None = None,  # px/s
    span: tuple[float, float] | None = None,  # px
    scale: float = 0.0,  # px
) -> list[Piece]:
    r"""The gentlest way from one velocity to another: a ramp to a third, a coast and a ramp.

    A ramp at the acceleration $A$ from $w$ to $q$ and one to $u$ leave the way
    $qg - [(q - w)|q - w| + (q - u)|q - u|]/2A$ in the time $g$, which grows with $q$. The least $A$
    is that of two ramps without a coast, $A^2g^2 - 4dA - (u - w)^2 = 0$ with
    $d = |\mathrm{way} - g(u + w)/2|$, and where they would exceed the top speed $V$ that of a coast
    at it.

    Args:
        way: Way from the one to the other.
        gap: Time from the one to the other, above 0.
        start: Velocity at the beginning, $w$.
        end: Velocity at the end, $u$.
        acceleration: Greatest acceleration, which is used where a gentler way would leave `span`;
            a way that needs more takes that.
        top_speed: Greatest speed.
        span: Lowest and highest place to keep to, from that at the beginning.
        scale: Size of the places that the way is a difference of, for its rounding.
    """
    aside = 2 * (way - gap * (end + start) / 2)
    if abs(aside) <= SINGLE * max(scale, abs(way) + gap * max(abs(start), abs(end))):
        return [Piece(gap, end)]
    least = float(gentlest(way, gap, start, end, top_speed)[0])

    def pieces(most: float) -> list[Piece]:
        q = _coasting(way, gap, start, end, most)
        rise, fall = abs(q - start) / most, abs(end - q) / most
        return [Piece(rise, q), Piece(max(gap - rise - fall, 0.0), q), Piece(fall, end)]

    def leaves(most: float) -> bool:
        places = Knots.of(start, pieces(most))
        low, high = extent(places)
        return low < span[0] or high > span[1]  # type: ignore[index]

    most = _AT_ONCE * least if acceleration is None else acceleration
    if most <= least or span is None or not leaves(least):
        return pieces(least)
    low, high = least, most
    for _ in range(20):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if leaves(middle) else (low, middle)
    return pieces(high)


def gentlest(
    way: Number,  # px
    gap: Number,  # s
    start: Number,  # px/s
    end: Number,  # px/s
    top_speed: float | None = None,  # px/s
) -> tuple[np.ndarray, np.ndarray]:
    """The least acceleration of a `transfer`, and the velocity between its ramps; of any shape."""
    aside, most = 2 * (way - gap * (end + start) / 2), math.inf if top_speed is None else top_speed
    sign = np.copysign(1.0, aside)
    least = (abs(aside) + np.hypot(aside, gap * (end - start))) / gap**2
    peak = (start + end + sign * least * gap) / 2
    spare = most * gap - sign * way
    coasts = (abs(peak) > most) & (spare > 0)
    top = np.where(coasts, most, 0.0)
    squares = (top - sign * start) ** 2 + (top - sign * end) ** 2
    steeper = np.maximum(least, squares / (2 * np.where(coasts, spare, 1.0)))
    return np.where(coasts, steeper, least), np.where(coasts, sign * top, peak)


def _coasting(way: float, gap: float, start: float, end: float, most: float) -> float:
    """The velocity between two ramps that leads over a way."""

    def way_at(q: float) -> float:
        lost = (q - start) * abs(q - start) + (q - end) * abs(q - end)
        return q * gap - lost / (2 * most)

    low, high = sorted((start, end))
    ways = way_at(low), way_at(high)
    if ways[0] <= way <= ways[1]:
        share = (way - ways[0]) / (ways[1] - ways[0]) if ways[1] > ways[0] else 0.0
        return low + share * (high - low)
    # Above both velocities two ramps lose by squares, and below both they gain by them.
    sign = 1.0 if way > ways[1] else -1.0
    half = (sign * (start + end) + most * gap) / 2
    rest = (start**2 + end**2) / 2 + sign * most * way
    return sign * rest / (half + math.sqrt(max(half**2 - rest, 0.0)))


def extent(knots: Knots) -> tuple[float, float]:
    """Lowest and highest place of a way, from its beginning; px."""
    begin, end = knots.velocities[:-1], knots.velocities[1:]
    turns = knots.positions[:-1] + knots.durations * begin * _share(begin, begin - end) / 2
    places = np.concatenate([knots.positions, turns])
    return float(np.min(places)), float(np.max(places))
