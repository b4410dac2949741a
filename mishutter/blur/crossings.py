r"""The two arms of a path, and when each pixel edge is crossed on them.

The path falls into an arm before its vertex and one after it. A crossing is timed from the
breakpoint of the shutter that is nearest to it, on whichever arm that lies: so no short time
is the difference of long ones, and the sign of that time says which piece of the shutter
holds the crossing.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import DoubleWord
from mishutter.blur.trajectory import Motion, Path, once, speed_at

_LATE = 2.0
"""In units of tau: after all exposure, but near enough to be multiplied by anything."""

_FEW_VALUES = 4

AFTER = np.array([[False], [True]])
"""Which arm, of the two on a leading axis, is that on which time runs outwards."""


class Crossings(NamedTuple):
    r"""Where and when each edge is crossed on each arm; shapes `(2, n + 1)`.

    `piece` holds the crossing, which is at `offset`, in units of tau, from the left end of
    that piece, or from its right end if not `from_left`. An edge that an arm does not reach
    while the shutter moves is held at the end of the exposure on its side. `nearest` is the
    breakpoint that the offset is from, and `moment` and `velocity` are those of the crossing,
    to rounding; no moment is later than twice the exposure's end.
    """

    piece: Array
    from_left: Array
    offset: Array
    nearest: Array
    moment: Array
    velocity: Array

    def part(self, which: tuple[slice | Array | int, ...]) -> "Crossings":
        """Those of some arms and edges."""
        return Crossings(*(x[which] for x in self))

    def by_breakpoints(self, tau: Array) -> "Crossings":
        """The same, with the derivative of the offset by the breakpoints."""
        held = self.is_held(tau.size - 1)
        return self._replace(offset=counted_from(at(tau, self.nearest), self.offset, held))

    def halfway(self, is_after: ArrayLike, width: Array) -> Array:
        """Middle of cells of a `width` that lead outwards from here, counted as the offset is."""
        return self.offset + jnp.where(is_after, width, -width) / 2

    def is_held(self, num_pieces: int) -> Array:
        """Whether a crossing is at an end of the exposure."""
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
    """Crossings of `edges`, of shape `(n + 1,)`, with those far away `brought_near`.

    Beside them the speeds there and the edges, `(1, n + 1)`, which both arms share.
    They are values alone: see `moment_change` for derivatives.
    """
    # What a crossing is looked up by is worked out once, not for each thing looked up.
    known = jax.lax.stop_gradient((track, at_rest, tau, edges))
    x, near = once(partial(_located, equal_pieces), *known)
    speed = x.velocity
    return x._replace(velocity=jnp.where(AFTER, speed, -speed)), speed, near


def _located(
    equal_pieces: bool, track: Path, at_rest: Array, tau: DoubleWord, edges: DoubleWord
) -> tuple[Crossings, DoubleWord]:
    """Crossings with their speed, that of both arms, in place of the velocity; and the edges."""
    edge = brought_near(DoubleWord(edges.high[None], edges.low[None]), track, at_rest)
    speed = speed_at(track, edge)
    velocity = jnp.where(AFTER, speed, -speed)
    timed = partial(time_between, without_stroke=float(jnp.finfo(speed.dtype).tiny))
    moment = timed(distance(edge, track.middle), -track.smear, velocity, track.stroke)
    moment = jnp.clip(moment, -_LATE, _LATE)
    nearest = _nearest(equal_pieces, track, tau.high, edge, moment)
    passed, *position = (at(x, nearest) for x in (track.velocity, *track.position))
    offset = timed(distance(edge, DoubleWord(*position)), passed, velocity, track.stroke)

    # A crossing at a breakpoint is in the piece outwards of it, one at the vertex before it.
    last = tau.high.size - 1
    is_past = (offset > 0) | ((offset == 0) & (velocity > 0))
    from_left = (nearest == 0) | (is_past & (nearest < last))
    piece = jnp.zeros_like(nearest) if last == 1 else nearest - 1 + from_left.astype(jnp.int32)
    length = at(lengths(equal_pieces, tau), piece)
    inside = jnp.clip(offset, jnp.where(from_left, 0.0, -length), jnp.where(from_left, length, 0.0))
    return Crossings(piece, from_left, inside, nearest, moment, speed), edge


@jax.custom_jvp
def of_both_arms(rows: Array) -> Array:
    """Sum over the arms: of two slices, which is quick, and in reverse of what spreads."""
    return rows[0] + rows[1]


@of_both_arms.defjvp
def _of_both_arms_jvp(primals, tangents):
    return of_both_arms(*primals), jnp.sum(tangents[0], axis=0)


def brought_near(edges: DoubleWord, track: Path, at_rest: Array) -> DoubleWord:
    """Edges, with those beyond all light brought near enough not to overflow.

    A point at rest, which counts from where it is, is taken to pass the whole of the pixel
    that it rests on, and a vertex at infinity lies beyond all edges.
    """
    reach = 2 * (track.stroke + jnp.abs(track.smear)) + track.middle.high - track.vertex.high
    nowhere = track.from_vertex & (track.stroke == 0)
    high = jnp.where(at_rest, jnp.where(edges.high > 0, reach, -reach), edges.high)
    high = jnp.clip(jnp.where(nowhere, -reach, high), -reach, reach)
    return DoubleWord(high, jnp.where(high == edges.high, edges.low, 0.0))


def _nearest(equal_pieces: bool, track: Path, tau: Array, edge: DoubleWord, moment: Array) -> Array:
    """Which breakpoint is nearest to moments, to rounding: half way, either will do.

    Pieces that are not equal may be shorter than a moment's rounding: it is an end of the one
    that holds the crossing, known by the positions of breakpoints.
    """
    last = tau.size - 1
    if equal_pieces:
        return jnp.round(jnp.clip((moment + 1) * (last / 2), 0, last)).astype(jnp.int32)
    piece = jnp.zeros_like(moment, jnp.int32)
    for k in range(1, last):
        beyond = distance(edge, DoubleWord(*(x[k] for x in track.position)))
        turned = track.velocity[k] >= 0
        is_past = jnp.where(AFTER, ~turned | (beyond >= 0), ~turned & (beyond < 0))
        piece += is_past.astype(jnp.int32)
    is_late = moment > at((tau[1:] + tau[:-1]) / 2, piece)
    return piece + is_late.astype(jnp.int32)


def lengths(equal_pieces: bool, tau: DoubleWord) -> Array:
    """Lengths of the pieces, `(p,)`; one for all, `(1,)`, where they are equal."""
    if equal_pieces:
        return jnp.full(1, 2 / (tau.high.size - 1), tau.high.dtype)
    return jnp.diff(tau.high) + jnp.diff(tau.low)


def at(values: Array, index: Array) -> Array:
    """Values at indices that are known to be inside; a few are chosen from, which is quicker."""
    if values.size > _FEW_VALUES:
        return values.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)
    found = values[0]
    for i in range(1, values.size):
        found = jnp.where(index == i, values[i], found)
    return found


@jax.custom_jvp
def counted_from(origin: Array, offset: Array, held: Array) -> Array:
    """An `offset` with its derivative by the `origin` that it is from."""
    return offset


@counted_from.defjvp
def _counted_from_jvp(primals, tangents):
    _, offset, held = primals
    return offset, jnp.where(held, 0.0, -tangents[0])


def drift_change(motion: Motion, by_motion: Motion) -> Array:
    """By how much changes of the motion move the vertex of a slow object's path in time.

    All crossings move by it. It is kept apart because the arms see it from opposite sides,
    and what it does to their light all but cancels.
    """
    (a, T, s), (da, dT, ds) = motion, by_motion
    slow = _is_slow(motion)
    bend = jnp.where(slow, 1 / jnp.where(slow, 2 * a, 1.0), 0.0)
    vertex = bend * jnp.where(slow, s, 0.0)
    return (bend * (ds - 2 * vertex * da) - vertex * (dT / T)) / T


def moment_change(
    from_vertex: Array,
    motion: Motion,
    x: Crossings,
    mirrored: Array,
    by_motion: Motion,
    dedge: Array,
) -> Array:
    """By how much changes of the motion, and of its edge, move a crossing in time.

    What is common to all crossings of a slow object, the `drift_change`, is left out.
    `mirrored` is the `mirrored_velocity` at the breakpoint which the crossing is nearest to.
    """
    (a, T, s), (da, dT, ds) = motion, by_motion
    velocity, tau = x.velocity, x.moment
    slow = _is_slow(motion)
    reaches = (a > 0) & (from_vertex | (4 * a * T >= jnp.abs(s)))
    rate = jnp.where(reaches, 2 * a, 1.0)
    bend, vertex = jnp.where(reaches, 1 / rate, 0.0), jnp.where(reaches, s / rate, 0.0)

    # Near the vertex a moment moves as the edge does from it, and with it, which for a slow
    # object is its drift; elsewhere as the edge does from where the point was.
    pivot = jnp.where(from_vertex, 0.0, jnp.where(slow, vertex, T * tau))
    moves = velocity != 0
    along = (dedge + pivot * (ds - pivot * da)) * T / jnp.where(moves, velocity, 1.0)
    # The moment and that of the vertex may cancel: their sum is counted from the breakpoint.
    apart = bend * (velocity / T)
    beyond = jnp.where(slow, apart, bend * (mirrored / T) + T * x.offset)
    turn = bend * (jnp.where(slow, 0.0, ds) - beyond * da)
    change = jnp.where(slow | from_vertex | ~moves, turn, 0.0) + jnp.where(moves, along, 0.0)
    return change / T - jnp.where(slow, apart / T, tau) * (dT / T)


def _is_slow(motion: Motion) -> Array:
    """Whether the vertex is so near mid-exposure that crossings are timed from it."""
    a, T, s = motion
    return (a > 0) & (jnp.abs(s) < a * T / 8)


def time_between(
    distance: Array, before: Array, after: Array, stroke: Array, *, without_stroke: float = 1.0
) -> Array:
    r"""Time between two points of a path, from their distance and their velocities.

    $2\,\Delta x / (u_1 + u_2)$ on one side of the vertex, $(u_2 - u_1)/2A$ from one side to
    the other, or from the vertex itself: no difference of what is nearly equal in either.
    A path without a stroke has no other side; what is divided by there instead of $2A$ may
    be so small as to put it beyond all time, but not where derivatives are taken.
    """
    same_way = ((before > 0) & (after > 0)) | ((before < 0) & (after < 0))
    rate = jnp.where(stroke > 0, 2 * stroke, without_stroke)
    return jnp.where(same_way, 2 * distance, after - before) / jnp.where(
        same_way, before + after, rate
    )


def distance(x: DoubleWord, y: DoubleWord) -> Array:
    """`x - y` to single precision: the difference of the high parts loses nothing."""
    return (x.high - y.high) + (x.low - y.low)
