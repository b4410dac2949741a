r"""Crossings: when a point passes each pixel edge, on either branch of its trajectory.

The trajectory has one branch before its vertex and one after it. A crossing is timed from the
breakpoint of the shutter that is nearest to it, whichever branch that breakpoint lies on. This
prevents a short time from being the difference of two long ones, and the sign of the time tells
which piece of the shutter holds the crossing.
"""

from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, PyTree

from mishutter._core import DoubleWord
from mishutter.blur.trajectory import Motion, Path, PathChange, opaque_to_fusion, speed_at
from mishutter.model import FEW_PIECES

_LATE = 2.0
"""Bound on a moment, in units of tau: after the exposure, but too small to overflow a product."""

_FEW_VALUES = 4
"""Number of values up to which selection is quicker than a gather."""

_Values = TypeVar("_Values")

AFTER = np.array([[False], [True]])
"""Whether time runs outwards, away from the vertex, on each branch; branches lead the shape."""


class Crossings(NamedTuple):
    r"""Places and times at which each branch crosses each edge.

    `piece` is the piece of the shutter that holds the crossing, and `offset` the crossing's
    time, in units of tau, from the left end of that piece, or from its right end if not
    `from_left`. An edge that the branch does not reach within the exposure is held at the end
    of the exposure on its side. `nearest` is the breakpoint that the offset counts from;
    `moment` and `velocity` are the time and velocity of the crossing, to rounding. Moments are
    clipped to twice the half exposure.
    """

    piece: Int[Array, "2 edges"]
    from_left: Bool[Array, "2 edges"]
    offset: Float[Array, "2 edges"]
    nearest: Int[Array, "2 edges"]
    moment: Float[Array, "2 edges"]
    velocity: Float[Array, "2 edges"]

    def part(self, which: tuple[slice | Array | int, ...]) -> "Crossings":
        """Crossings of some branches and edges."""
        return Crossings(*(x[which] for x in self))

    def by_breakpoints(self, tau: Array) -> "Crossings":
        """The same crossings, whose offsets carry their derivative by the breakpoints."""
        move = jnp.where(self.is_held(tau.size - 1), 0.0, -at(tau, self.nearest))
        return self._replace(offset=with_tangent(self.offset, move))

    def halfway(self, is_after: ArrayLike, width: Array) -> Array:
        """Offset of the middle of cells that begin here and extend outwards over `width`."""
        return self.offset + jnp.where(is_after, width, -width) / 2

    def is_held(self, num_pieces: int) -> Array:
        """Whether each crossing is held at an end of the exposure."""
        last = jnp.where(self.from_left, *np.array([0, num_pieces - 1], np.int32))
        return (self.offset == 0) & (self.piece == last)

    def inner(self, is_after: ArrayLike, length: Array) -> Array:
        """Time from the end of the piece that is nearer to the vertex."""
        return self._from(self.from_left == is_after, length)

    def outer(self, is_after: ArrayLike, length: Array) -> Array:
        """Time from the end of the piece that is farther from the vertex."""
        return self._from(self.from_left != is_after, length)

    def _from(self, is_near: Array, length: Array) -> Array:
        time = jnp.where(self.from_left, self.offset, -self.offset)
        return jnp.where(is_near, time, length - time)


def crossings(
    equal_pieces: bool, track: Path, at_rest: Array, tau: DoubleWord, edges: DoubleWord
) -> tuple[Crossings, Array, DoubleWord]:
    """Crossings of `edges`, of shape `(n + 1,)`, on both branches.

    The function also returns the speeds at the crossings and the edges after `clip_to_reach`; both
    have shape `(1, n + 1)`, as the branches share them. Nothing carries a derivative:
    `moment_change` computes those.
    """
    # Prevents XLA from computing the index of each crossing again for each table it looks into.
    primals = jax.lax.stop_gradient((track, at_rest, tau, edges))
    x, clipped = opaque_to_fusion(partial(_located, equal_pieces), *primals)
    speed = x.velocity
    return x._replace(velocity=jnp.where(AFTER, speed, -speed)), speed, clipped


def _located(
    equal_pieces: bool, track: Path, at_rest: Array, tau: DoubleWord, edges: DoubleWord
) -> tuple[Crossings, DoubleWord]:
    """Crossings whose `velocity` is the speed that both branches share, and the clipped edges."""
    edge = clip_to_reach(DoubleWord(edges.high[None], edges.low[None]), track, at_rest)
    speed = speed_at(track, edge)
    velocity = jnp.where(AFTER, speed, -speed)
    timed = partial(time_between, without_sag=float(jnp.finfo(speed.dtype).tiny))
    # From mid-exposure a moment is known to rounding, which is enough to choose the breakpoint that
    # the crossing is then timed from.
    moment = timed(distance(edge, track.middle), -track.smear, velocity, track.sag)
    moment = jnp.clip(moment, -_LATE, _LATE)
    nearest = _nearest(equal_pieces, track, tau.high, edge, moment)
    velocity_there, *position = (at(x, nearest) for x in (track.velocity, *track.position))
    offset = timed(distance(edge, DoubleWord(*position)), velocity_there, velocity, track.sag)

    # A crossing at a breakpoint is in the piece outwards of it, at the vertex in the one before.
    last = tau.high.size - 1
    is_past = (offset > 0) | ((offset == 0) & (velocity > 0))
    from_left = (nearest == 0) | (is_past & (nearest < last))
    piece = jnp.zeros_like(nearest) if last == 1 else nearest - 1 + from_left.astype(jnp.int32)
    length = at(lengths(equal_pieces, tau), piece)
    # Clipped, an edge beyond the exposure is held at its end, and taps out there have a width of 0
    # by the same formulae.
    inside = jnp.clip(offset, jnp.where(from_left, 0.0, -length), jnp.where(from_left, length, 0.0))
    return Crossings(piece, from_left, inside, nearest, moment, speed), edge


@jax.custom_jvp
def sum_over_branches(rows: Array) -> Array:
    """Sum over the branches: two slices added, which is quick, and in reverse a broadcast."""
    return rows[0] + rows[1]


@sum_over_branches.defjvp
def _sum_over_branches_jvp(primals, tangents):
    return sum_over_branches(*primals), jnp.sum(tangents[0], axis=0)


def clip_to_reach(edges: DoubleWord, track: Path, at_rest: Array) -> DoubleWord:
    """Edges, clipped to twice the reach of the path so that no product overflows.

    A point at rest passes, by convention, the whole of the pixel that it rests on, and a vertex at
    infinity lies beyond all edges.
    """
    reach = 2 * (track.sag + jnp.abs(track.smear)) + track.middle.high - track.vertex.high
    nowhere = track.from_vertex & (track.sag == 0)
    high = jnp.where(at_rest, jnp.where(edges.high > 0, reach, -reach), edges.high)
    high = jnp.clip(jnp.where(nowhere, -reach, high), -reach, reach)
    # The low word of an edge that was clipped belongs to another place.
    return DoubleWord(high, jnp.where(high == edges.high, edges.low, 0.0))


def _nearest(equal_pieces: bool, track: Path, tau: Array, edge: DoubleWord, moment: Array) -> Array:
    """Index of the breakpoint nearest to each moment; either one half way between two.

    Unequal pieces may be shorter than the rounding of a moment. Among a few of them the positions
    of the breakpoints decide which piece holds the crossing, and the function takes one of its
    ends.
    """
    last = tau.size - 1
    if not equal_pieces and last > FEW_PIECES:
        middles = (tau[1:] + tau[:-1]) / 2
        return jnp.searchsorted(middles, moment).astype(jnp.int32)
    if equal_pieces:
        return jnp.round(jnp.clip((moment + 1) * (last / 2), 0, last)).astype(jnp.int32)
    piece = jnp.zeros_like(moment, jnp.int32)
    for k in range(1, last):
        beyond = distance(edge, DoubleWord(*(x[k] for x in track.position)))
        is_after = track.velocity[k] >= 0
        is_past = jnp.where(AFTER, ~is_after | (beyond >= 0), ~is_after & (beyond < 0))
        piece += is_past.astype(jnp.int32)
    is_late = moment > at((tau[1:] + tau[:-1]) / 2, piece)
    return piece + is_late.astype(jnp.int32)


def lengths(equal_pieces: bool, tau: DoubleWord) -> Array:
    """Lengths of the pieces, `(p,)`; one for all, `(1,)`, where they are equal."""
    if equal_pieces:
        return jnp.full(1, 2 / (tau.high.size - 1), tau.high.dtype)
    # A piece may be shorter than the rounding of its ends: the low words know its length.
    return jnp.diff(tau.high) + jnp.diff(tau.low)


def at(values: Array, index: Array) -> Array:
    """Gather without bounds checks; selects among a few values, which is quicker."""
    if values.size > _FEW_VALUES:
        return values.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)
    selection = values[0]
    for i in range(1, values.size):
        selection = jnp.where(index == i, values[i], selection)
    return selection


@jax.custom_jvp
def with_tangent(value: Array, move: Array) -> Array:
    """`value`, whose derivative is its own plus that of `move`."""
    return value


@with_tangent.defjvp
def _with_tangent_jvp(primals, tangents):
    return with_tangent(*primals), tangents[0] + tangents[1]


def drift_change(motion: Motion, by_motion: Motion) -> Array:
    """Delay of the vertex of a slow object's trajectory by a change of the motion.

    Every crossing moves with the vertex. The drift is separate from `moment_change` because under a
    symmetric profile its effects on the exposure of the two branches nearly cancel.
    """
    (a, T, s), (da, dT, ds) = motion, by_motion
    slow = _is_slow(motion)
    bend = jnp.where(slow, 1 / jnp.where(slow, 2 * a, 1.0), 0.0)
    vertex = bend * jnp.where(slow, s, 0.0)
    return (bend * (ds - 2 * vertex * da) - vertex * (dT / T)) / T


def moment_change(
    from_vertex: Array, motion: Motion, x: Crossings, mirrored: Array, change: PathChange
) -> Array:
    """Delay of a crossing by a change of the motion and of its edge.

    The change excludes the part that all crossings of a slow object share, `drift_change`.
    `mirrored` is the `mirrored_velocity` at the breakpoint nearest to the crossing.
    """
    (a, T, s), (da, dT, ds) = motion, change.motion
    velocity, tau = x.velocity, x.moment
    slow = _is_slow(motion)
    reaches = (a > 0) & (from_vertex | (4 * a * T >= jnp.abs(s)))
    rate = jnp.where(reaches, 2 * a, 1.0)
    bend, vertex = jnp.where(reaches, 1 / rate, 0.0), jnp.where(reaches, s / rate, 0.0)

    # Near the vertex a moment moves as the edge does from it, and with it, which for a slow
    # object is its drift; elsewhere as the edge does from where the point was.
    pivot = jnp.where(from_vertex, 0.0, jnp.where(slow, vertex, T * tau))
    moves = velocity != 0
    along = (change.edge + pivot * (ds - pivot * da)) * T / jnp.where(moves, velocity, 1.0)
    # The sum counts from the breakpoint, because the times of crossing and vertex may cancel.
    apart = bend * (velocity / T)
    beyond = jnp.where(slow, apart, bend * (mirrored / T) + T * x.offset)
    turn = bend * (jnp.where(slow, 0.0, ds) - beyond * da)
    delay = jnp.where(slow | from_vertex | ~moves, turn, 0.0) + jnp.where(moves, along, 0.0)
    return delay / T - jnp.where(slow, apart / T, tau) * (dT / T)


class Parabola(NamedTuple):
    r"""Coefficients of a trajectory $A\tau^2 - B\tau$; px, scalars."""

    sag: Float[Array, ""]
    smear: Float[Array, ""]


def parabola_of(motion: Motion) -> Parabola:
    """Sag and smear of a motion."""
    a, T, s = motion
    return Parabola(a * T * T, s * T)


class Passage(NamedTuple):
    r"""Time and velocity at which edges are passed.

    Attributes:
        moment: $\tau$, to rounding.
        velocity: $u$, to rounding; px per half exposure.
    """

    moment: Float[Array, "2 edges"]
    velocity: Float[Array, "2 edges"]


@jax.custom_jvp
def crossing_time(from_vertex: Array, parabola: Parabola, edge: Array, passage: Passage) -> Passage:
    r"""Time and velocity at which edges are crossed, with derivatives of every order.

    From $A\tau^2 - B\tau = e$ and $u = 2A\tau - B$ follow $d\tau = (de + \tau dB - \tau^2 dA)/u$
    and $du = 2A\,d\tau + 2\tau\,dA - dB$. Where edges count from the vertex, at $\nu = B/2A$, the
    first is $d\tau = de/u + (dB - (\nu + \tau)\,dA)/2A$, in which nothing cancels. Their own
    derivatives are those of these formulae, as both hold for the values on their right.

    The derivative of a crossing at the vertex is 0; edges that the path never reaches have theirs
    there.

    Args:
        from_vertex: Whether edges count from the vertex; else from mid-exposure.
        parabola: $A$ and $B$.
        edge: $e$, of which only the derivative is taken, px; shape `(1, n + 1)`.
        passage: The values that the result has.
    """
    return with_nan_tangent(passage, (*parabola, edge))


def with_nan_tangent(values: _Values, moved_by: PyTree) -> _Values:
    """`values`, whose derivative by `moved_by` is NaN unless a rule replaces it.

    In reverse mode through `jax.lax.scan` JAX drops nested derivative rules and would return 0
    without a warning.
    """
    zero = jnp.sqrt(sum(jnp.sum(0 * x) for x in jax.tree.leaves(moved_by)))
    return jax.tree.map(lambda x: x + zero.astype(x.dtype), values)


@crossing_time.defjvp
def _crossing_time_jvp(primals, tangents):
    from_vertex, parabola, _, _ = primals
    _, d_parabola, d_edge, _ = tangents
    passage = crossing_time(*primals)
    delay = crossing_time_change(from_vertex, parabola, passage, d_parabola, d_edge)
    gain = 2 * (parabola.sag * delay + passage.moment * d_parabola.sag) - d_parabola.smear
    return passage, Passage(delay, gain)


def crossing_time_change(
    from_vertex: Array, parabola: Parabola, passage: Passage, d_parabola: Parabola, d_edge: Array
) -> Array:
    """Delay of a crossing by changes of sag, smear and edge.

    The formulae are those of `crossing_time`. `moment_change` computes the same where crossings
    of narrow taps would cancel.
    """
    (sag, smear), (d_sag, d_smear) = parabola, d_parabola
    moment, velocity = passage
    moves = velocity != 0
    pace, rate = jnp.where(moves, velocity, 1.0), jnp.where(from_vertex, 2 * sag, 1.0)
    drift = (d_smear - (smear / rate + moment) * d_sag) / rate
    along = (d_edge + moment * (d_smear - moment * d_sag)) / pace
    return jnp.where(moves, jnp.where(from_vertex, d_edge / pace + drift, along), 0.0)


def _is_slow(motion: Motion) -> Array:
    """Whether the vertex is so near mid-exposure that changes of crossings count from it."""
    a, T, s = motion
    return (a > 0) & (jnp.abs(s) < a * T / 8)


def time_between(
    distance: Array, before: Array, after: Array, sag: Array, *, without_sag: float = 1.0
) -> Array:
    r"""Time between two points of a path, from their distance and their velocities.

    $2\,\Delta x / (u_1 + u_2)$ on one side of the vertex, $(u_2 - u_1)/2A$ from one side to
    the other, or from the vertex itself: neither subtracts two numbers that are nearly equal.
    A path without a sag has one side only, and `without_sag` replaces its $2A$: a tiny
    number puts the other side after the exposure, 1 prevents infinite derivatives.
    """
    same_way = ((before > 0) & (after > 0)) | ((before < 0) & (after < 0))
    rate = jnp.where(sag > 0, 2 * sag, without_sag)
    return jnp.where(same_way, 2 * distance, after - before) / jnp.where(
        same_way, before + after, rate
    )


def distance(x: DoubleWord, y: DoubleWord) -> Array:
    """`x - y` as one float: high parts that are nearly equal subtract exactly."""
    return (x.high - y.high) + (x.low - y.low)
