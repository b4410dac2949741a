r"""The trajectory of a point on a free path: refined breakpoints, positions, runs and crossings.

The breakpoints of the shutter and those of the path together cut the exposure into pieces, on each
of which the trajectory is one parabola $x = X + U h + A h^2$. Consecutive pieces whose $A$ have one
sign are a run: over a run the velocity is a monotone function of time, so that the trajectory has
two branches there, as a parabola has over the whole exposure. A run of negative $A$ is mirrored
first. A path whose accelerations are all at least 0 is a single run.

On each branch a binary search among exact positions yields the piece in which an edge is crossed.
The formulae of `crossings.py` time the crossing from the nearer end of that piece. Its velocity
follows from that at the slower end: $u^2 = U^2 + 4A\,\Delta x$, or $4A\,\Delta x$ from the vertex,
are sums in which nothing cancels.
"""

import itertools
import math
from bisect import bisect_right
from fractions import Fraction
from typing import ClassVar, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from mishutter._core import (
    DoubleWord,
    add,
    fractions_as_words,
    multiply,
    negate,
    reciprocal,
    two_product,
    word,
)
from mishutter.blur.crossings import AFTER, Crossings, at, distance, time_between
from mishutter.blur.trajectory import opaque_to_fusion
from mishutter.model import (
    AbstractPiecewiseShutter,
    FreeMotion,
    uniform_fractions,
)


@final
class RefinedShutter(AbstractPiecewiseShutter):
    r"""A profile with additional breakpoints where the acceleration of a free path changes.

    Args:
        profile: The shutter.
        ends: Ends of the pieces, ascending from -1 to 1; shape `(m + 1,)`.
        owner: Piece of the shutter that contains each piece; shape `(m,)`.
        static_owner: `owner` for a shutter of equal pieces, where it is static; else None.
        lead: Time from the left end of the shutter's piece to that of the piece; shape `(m,)`.
        trail: Time from the right end of the piece to that of the shutter's; shape `(m,)`.
        longest: Upper bound on the length of a piece, in units of $\tau$.
        panels_per_piece: Equal parts of a piece on each of which `w` is a low polynomial.
        smooth_length: Time over which each piece's function is nearly a low polynomial.
    """

    profile: AbstractPiecewiseShutter
    ends: DoubleWord
    owner: Array
    lead: Array
    trail: Array
    static_owner: tuple[int, ...] | None = eqx.field(static=True)
    longest: float = eqx.field(static=True)
    panels_per_piece: int = eqx.field(static=True)
    smooth_length: float | Array
    equal_pieces: ClassVar[bool] = False
    symmetric: ClassVar[bool] = False

    def transmittance(self, tau: ArrayLike) -> Array:
        return self.profile.transmittance(tau)

    def dtype(self) -> np.dtype | None:
        return self.profile.dtype()

    def breakpoints(self, dtype: np.dtype) -> DoubleWord:
        return DoubleWord(*(end.astype(dtype) for end in self.ends))

    def piece_transmittance(self, offset: Array) -> Array:
        rest = (None,) * (offset.ndim - 1)
        from_left = offset + self.lead[(slice(None), *rest)].astype(offset.dtype)
        count = self.profile.breakpoints(np.dtype(self.lead.dtype)).high.size - 1
        if self.static_owner is None:
            offsets = jnp.broadcast_to(from_left[None], (count, *from_left.shape))
            values, owner = (
                self.profile.piece_transmittance(offsets),
                self.owner[(None, ..., *rest)],
            )
            return jnp.take_along_axis(values, owner, axis=0, mode="promise_in_bounds")[0]
        # Ordered by the shutter's pieces, each of these is evaluated at its own offsets alone; the
        # way above evaluates all of them at the offsets of all.
        owner = np.array(self.static_owner)
        first = np.searchsorted(owner, np.arange(count))
        place = np.arange(owner.size) - first[owner]
        row = np.minimum(first[:, None] + np.arange(np.max(place) + 1), owner.size - 1)
        return self.profile.piece_transmittance(from_left[row])[owner, place]

    def piece_mean(self, piece: Array, from_left: Array, distance: Array, width: Array) -> Array:
        length = looked_up(jnp.diff(self.ends.high) + jnp.diff(self.ends.low), piece)
        other = length - distance
        # Counted from the nearer end of the shutter's own piece, where a profile that vanishes at
        # that end keeps its relative accuracy.
        left = looked_up(self.lead, piece) + jnp.where(from_left, distance, other)
        right = looked_up(self.trail, piece) + jnp.where(from_left, other, distance)
        is_left = left <= right
        nearer = jnp.where(is_left, left, right)
        return self.profile.piece_mean(looked_up(self.owner, piece), is_left, nearer, width)


def refined(
    profile: AbstractPiecewiseShutter, ends: tuple[Fraction, ...], dtype: np.dtype
) -> tuple[RefinedShutter, Array]:
    """A profile refined by `piece_ends`, and the piece of the path that each of its pieces lies in.

    Returns:
        The profile, and indices of the path's pieces; shape `(m,)`.
    """
    inner, own = ends[1:-1], profile.breakpoints(dtype)
    num_pieces, count = own.high.size - 1, profile.panels_per_piece
    longest = float(max(after - before for before, after in itertools.pairwise(ends)))
    static_owner = None
    if profile.equal_pieces:
        longest = min(longest, 2 / num_pieces)
        # Where the path cuts pieces short, fewer panels are as fine.
        count = math.ceil(count * longest * num_pieces / 2)
        equal = uniform_fractions(num_pieces)
        both = sorted({*equal, *inner})
        cuts = fractions_as_words(both, dtype)
        static_owner = tuple(bisect_right(equal, x) - 1 for x in both[:-1])
        place = np.array([bisect_right(ends, x) - 1 for x in both[:-1]], np.int32)
        owner = jnp.array(static_owner, jnp.int32)
    else:
        added = fractions_as_words(inner, dtype)
        high, low = (jnp.concatenate(pair) for pair in zip(own, added, strict=True))
        index = jnp.arange(high.size, dtype=jnp.int32)
        # By both words, because breakpoints may differ in the low one alone.
        index = jax.lax.sort((*jax.lax.stop_gradient((high, low)), index), num_keys=2)[2]
        cuts = DoubleWord(high[index], low[index])
        is_own = index[:-1] <= num_pieces
        owner = jnp.clip(jnp.cumsum(is_own, dtype=jnp.int32) - 1, 0, num_pieces - 1)
        place = jnp.cumsum(~is_own, dtype=jnp.int32)
    begin, end = (DoubleWord(*(x[part] for x in cuts)) for part in (slice(-1), slice(1, None)))
    left, right = (DoubleWord(*(x[owner + side] for x in own)) for side in (0, 1))
    lead, trail = distance(begin, left), distance(right, end)
    refined_profile = RefinedShutter(
        profile=profile,
        ends=cuts,
        owner=owner,
        lead=lead,
        trail=trail,
        static_owner=static_owner,
        longest=longest,
        panels_per_piece=count,
        smooth_length=profile.smooth_length,
    )
    return refined_profile, jnp.asarray(place, jnp.int32)


class PathParameters(NamedTuple):
    """Parameters of a point's path.

    Attributes:
        accelerations: Acceleration of each piece that has a length; px/s^2.
        half_exposure: Half the exposure; s.
        speed: Speed of the object over the sensor; px/s. The upper word carries the derivative.
    """

    accelerations: Float[Array, "pieces"]
    half_exposure: Float[Array, ""]
    speed: DoubleWord


def path_parameters(motion: FreeMotion, speed: DoubleWord) -> PathParameters:
    """Parameters of a path in the precision of the `speed` of the object over the sensor."""
    a, T = (x.astype(speed.high.dtype) for x in (motion.accelerations, motion.half_exposure))
    return PathParameters(a[motion.lasting], T, speed)


class FreePath(NamedTuple):
    """Position and velocity of a point at breakpoints, and each piece's parabola; in px.

    Attributes:
        sag: Sag $A$ of each piece.
        velocity: Velocity at breakpoints, px per half exposure.
        position: Position of breakpoints; shape `(m + 1,)`.
        vertex: Turning point of each piece, or its beginning where it has none; shape `(m,)`.
        turns: Whether each piece has a turning point.
        lowest: The lowest position if edges count from it, else 0; shape `(1,)`.
        lowest_index: Index of the lowest position among the vertices followed by the path's end.
        from_lowest: Whether edges count from the lowest position.
    """

    sag: Float[Array, "m"]
    velocity: Float[Array, "m+1"]
    position: DoubleWord
    vertex: DoubleWord
    turns: Bool[Array, "m"]
    lowest: DoubleWord
    lowest_index: Int[Array, ""]
    from_lowest: Bool[Array, ""]

    def mirrored(self, sign: Array) -> "FreePath":
        """The path, upside down if `sign` is -1."""
        names = "sag", "velocity", "position", "vertex"
        parts = {name: jax.tree.map(lambda x: sign * x, getattr(self, name)) for name in names}
        return self._replace(**parts)


def free_path(
    parameters: PathParameters,
    ends: tuple[Fraction, ...],
    tau: DoubleWord,
    place: Int[Array, "m"],
    *,
    from_lowest: Bool[Array, ""] | bool,
) -> FreePath:
    """The path at breakpoints `tau`, without derivatives.

    `place` is the piece of the path between each two breakpoints.
    """
    primals = jax.lax.stop_gradient((parameters, tau, jnp.asarray(from_lowest)))
    return opaque_to_fusion(lambda *x: _exact_path(ends, place, *x), *primals)


def _exact_path(
    ends: tuple[Fraction, ...],
    place: Array,
    parameters: PathParameters,
    tau: DoubleWord,
    from_lowest: Array,
) -> FreePath:
    a, T, speed = parameters
    dtype, half = np.dtype(T.dtype), word(T)
    spread = DoubleWord(*(jnp.broadcast_to(x, a.shape) for x in half))
    sag = multiply(two_product(a, spread.high), spread)
    smear = multiply(speed, half)
    cuts = fractions_as_words(ends, dtype)
    length = fractions_as_words([y - x for x, y in itertools.pairwise(ends)], dtype)

    def step(state: tuple[DoubleWord, DoubleWord], piece: tuple[DoubleWord, DoubleWord]):
        velocity, position = state
        sag, length = piece
        half_gain = multiply(sag, length)
        end = add(position, multiply(length, add(velocity, half_gain)))
        return (add(velocity, _twice(half_gain)), end), state

    zero = DoubleWord(jnp.zeros_like(T), jnp.zeros_like(T))
    _, (velocity, position) = jax.lax.scan(step, (zero, zero), (sag, length))

    # Counts from mid-exposure, where acceleration has added no velocity.
    middle = max(j for j, end in enumerate(ends[:-1]) if end <= 0)
    before = fractions_as_words([-ends[middle]], dtype)
    start, pace, rate = (
        DoubleWord(*(x[middle : middle + 1] for x in row)) for row in (position, velocity, sag)
    )
    half_gain = multiply(rate, before)
    origin = add(start, multiply(before, add(pace, half_gain)))
    drift = add(add(pace, _twice(half_gain)), DoubleWord(*(x[None] for x in smear)))
    origin, drift = (
        DoubleWord(*(jnp.broadcast_to(x, a.shape) for x in row)) for row in (origin, drift)
    )
    begins = DoubleWord(cuts.high[:-1], cuts.low[:-1])
    velocity = add(velocity, negate(drift))
    position = add(position, negate(add(origin, multiply(drift, begins))))

    base = path_bases(place)
    offset = add(tau, negate(_gather(begins, base)))
    half_gain = multiply(_gather(sag, base), offset)
    pace = _gather(velocity, base)
    at_tau = add(_gather(position, base), multiply(offset, add(pace, half_gain)))
    paces = add(pace, _twice(half_gain))

    # A turning point lies $U^2/4A$ below the beginning of its piece; above, where $A$ is negative.
    left, right = (DoubleWord(*(x[part] for x in paces)) for part in (slice(-1), slice(1, None)))
    rates = _gather(sag, base[:-1])
    sign = jnp.sign(rates.high)
    # One of the ends counts, so that a turning point at a breakpoint belongs to one piece alone.
    turns = (sign * left.high < 0) & (sign * right.high >= 0)
    # A piece without a turning point divides by 1.
    quarter = (4 * jnp.where(turns, *pair) for pair in zip(rates, (0.25, 0.0), strict=True))
    rise = multiply(multiply(left, left), reciprocal(DoubleWord(*quarter)))
    begin = DoubleWord(at_tau.high[:-1], at_tau.low[:-1])
    turning = add(begin, negate(rise))
    vertex = DoubleWord(*(jnp.where(turns, *pair) for pair in zip(turning, begin, strict=True)))
    high, low = (jnp.append(x, y[-1:]) for x, y in zip(vertex, at_tau, strict=True))
    # Among equal high words the low words decide.
    index = jnp.argmin(jnp.where(high == jnp.min(high), low, jnp.inf))
    lowest = DoubleWord(*(jnp.where(from_lowest, x[index][None], 0.0) for x in (high, low)))
    return FreePath(rates.high, paces.high, at_tau, vertex, turns, lowest, index, from_lowest)


def path_bases(place: Array) -> Array:
    """The piece of the path that each breakpoint's position counts from; shape `(m + 1,)`."""
    return jnp.append(place, place[-1:])


def _twice(x: DoubleWord) -> DoubleWord:
    return DoubleWord(2 * x.high, 2 * x.low)


def _gather(x: DoubleWord, index: Array) -> DoubleWord:
    return DoubleWord(x.high[index], x.low[index])


def looked_up(values: Array, index: Array) -> Array:
    """Gather without bounds checks, broadcast to the shape of the indices."""
    return jnp.broadcast_to(at(values, index), index.shape)


class MonotoneRun(NamedTuple):
    """Pieces whose accelerations have one sign, from `first` to before `past`."""

    first: Int[Array, "*runs"]
    past: Int[Array, "*runs"]
    sign: Float[Array, "*runs"]


def runs(accelerations: Array, place: Array, count: int) -> MonotoneRun:
    """The runs of a path, each field of shape `(count,)`; `place` is that of `refined`."""
    signs = jnp.sign(accelerations)
    index = jnp.arange(signs.size, dtype=jnp.int32)
    # A piece without acceleration goes on with the run before it: it has no sign of its own.
    last = jax.lax.cummax(jnp.where(signs != 0, index, -1))
    sign = jnp.where(last >= 0, signs[last], 0.0)
    turns = (sign[1:] != sign[:-1]) & (sign[:-1] != 0)
    number = jnp.append(jnp.zeros(1, jnp.int32), jnp.cumsum(turns, dtype=jnp.int32))
    which = np.arange(count, dtype=np.int32)[:, None]
    first = jnp.sum(number[place][None] < which, axis=1, dtype=jnp.int32)
    past = jnp.sum(number[place][None] <= which, axis=1, dtype=jnp.int32)
    total = jnp.sum(jnp.where(number[None] == which, sign[None], 0.0), axis=1)
    return MonotoneRun(first, past, jnp.where(total < 0, -1.0, 1.0).astype(signs.dtype))


def free_crossings(
    track: FreePath, run: MonotoneRun, tau: DoubleWord, edges: DoubleWord
) -> tuple[Crossings, Array, Array]:
    """Crossings of ascending `edges`, `(1, n + 1)`, on both branches of a run of the path.

    The function also returns their speeds, and whether each is held: an edge that a branch does not
    reach is held at the end of the run on its side.
    """
    x, is_held = opaque_to_fusion(_located, *jax.lax.stop_gradient((track, run, tau, edges)))
    speed = x.velocity
    return x._replace(velocity=jnp.where(AFTER, speed, -speed)), speed, is_held


def _located(
    track: FreePath, run: MonotoneRun, tau: DoubleWord, edge: DoubleWord
) -> tuple[Crossings, Array]:
    """Crossings whose `velocity` is the speed, and whether they are held."""
    index = jnp.arange(track.velocity.size, dtype=jnp.int32)
    falls = (track.velocity < 0) & (index >= run.first) & (index <= run.past)
    turn = run.first + jnp.sum(falls, dtype=jnp.int32)
    piece = _crossed_piece(track, run, turn, edge)
    is_early, is_late = piece < run.first, piece >= run.past
    holds_vertex = (piece == turn - 1) & ~is_early & ~is_late
    piece = jnp.clip(piece, run.first, run.past - 1)
    inner = jnp.where(AFTER, piece, piece + 1)
    rate, inner_speed = looked_up(track.sag, piece), jnp.abs(looked_up(track.velocity, inner))
    pairs = zip(track.vertex, track.position, strict=True)
    origin = [jnp.where(holds_vertex, looked_up(v, piece), looked_up(x, inner)) for v, x in pairs]
    slowest = jnp.where(holds_vertex, 0.0, inner_speed)
    beyond = jnp.maximum(distance(edge, DoubleWord(*origin)), 0)
    # Outwards a point only gets faster, which rounding must not undo.
    speed = jnp.maximum(jnp.sqrt(slowest * slowest + 4 * rate * beyond), slowest)
    velocity = jnp.where(AFTER, speed, -speed)

    def since(end: Array) -> Array:
        there = DoubleWord(*(looked_up(x, end) for x in track.position))
        velocity_there, least = looked_up(track.velocity, end), float(jnp.finfo(speed.dtype).tiny)
        return time_between(
            distance(edge, there), velocity_there, velocity, rate, without_sag=least
        )

    length = looked_up(jnp.diff(tau.high) + jnp.diff(tau.low), piece)
    # Timed from both ends, for the relative accuracy of the shorter time.
    from_start = jnp.clip(since(piece), 0, length)
    to_end = jnp.clip(-since(piece + 1), 0, length)
    is_held = is_early | is_late
    from_left = is_early | (~is_late & (from_start <= to_end))
    offset = jnp.where(is_held, 0.0, jnp.where(from_left, from_start, -to_end))
    nearest = piece + (~from_left).astype(jnp.int32)
    moment = looked_up(tau.high, nearest) + offset
    speed = jnp.where(is_held, jnp.abs(looked_up(track.velocity, nearest)), speed)
    return Crossings(piece, from_left, offset, nearest, moment, speed), is_held


def _crossed_piece(track: FreePath, run: MonotoneRun, turn: Array, edge: DoubleWord) -> Array:
    """Index of the piece in which each branch passes an edge, or the one outside; `(2, n + 1)`.

    Breakpoints from `turn` on lie on the branch after the vertex. A binary search yields the first
    one beyond the edge there, and on the other branch the first one that is not beyond it.
    """
    first = jnp.where(AFTER, turn, run.first)
    past = jnp.where(AFTER, run.past + 1, turn)
    count = jnp.broadcast_to(first, (2, edge.high.size)).astype(jnp.int32)
    bits = track.velocity.size.bit_length()

    def halve(step: Array, count: Array) -> Array:
        probe = count + jnp.left_shift(jnp.int32(1), bits - 1 - step)
        index = jnp.clip(probe - 1, 0, track.velocity.size - 1)
        beyond = distance(edge, DoubleWord(*(looked_up(x, index) for x in track.position)))
        passes = jnp.where(AFTER, beyond > 0, beyond < 0)
        return jnp.where((probe <= past) & passes, probe, count)

    return jax.lax.fori_loop(0, bits, halve, count) - 1
