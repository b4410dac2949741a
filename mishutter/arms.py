r"""The two arms of a path, and when each pixel edge is crossed on them.

The path falls into an arm before its vertex and one after it, on each of which, going
outwards from the vertex, position and speed rise. Each edge lies in one piece of the
shutter on each arm: which one follows from how many of the arm's breakpoints the edge
is past, and the times to the piece's ends from the nearer of them, so that no short
time is the difference of long ones.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter.doubleword import DoubleWord
from mishutter.path import Motion, Path

AFTER = np.array([[False], [True]])
"""Which arm, of the two on a leading axis, is that on which time runs outwards."""


class Crossings(NamedTuple):
    r"""Where and when each edge is crossed on each arm; shapes `(2, n + 1)`.

    `piece` holds the crossing, and `rank` counts the breakpoints between it and the
    vertex. `inner` and `outer` are the times, in units of tau, from the piece's two
    breakpoints, and `since` is that from where the arm enters the piece: its inner
    breakpoint, or the vertex. An arm does not reach down to an edge that `is_before` it,
    nor past one that `is_beyond`; such an edge takes the place of the arm's end.
    """

    piece: Array
    rank: Array
    since: Array
    inner: Array
    outer: Array
    is_before: Array
    is_beyond: Array


def passed_breakpoints(track: Path, edges: DoubleWord) -> Array:
    """Whether each edge is past each breakpoint; shape `(p + 1, n + 1)`."""
    position = DoubleWord(track.position.high[:, None], track.position.low[:, None])
    return _distance(_row(edges), position) > 0


def crossings(
    motion: Motion, track: Path, tau: DoubleWord, passed: Array, edges: DoubleWord, speed: Array
) -> Crossings:
    """Crossings of `edges`, at which the point has `speed`; shapes `(n + 1,)`."""
    num_pieces = tau.high.size - 1
    on_arm = (track.velocity >= 0)[None] == AFTER
    num_on_arm = jnp.sum(on_arm, axis=1, keepdims=True, dtype=jnp.int32)
    count = jnp.sum(passed[None] & on_arm[..., None], axis=1, dtype=jnp.int32)
    turns = jnp.all(num_on_arm > 0)
    rank = jnp.where(turns, count, jnp.maximum(count, 1))
    piece = num_on_arm[:1] - 1 + jnp.where(AFTER, rank, -rank)
    piece = jnp.clip(piece, 0, num_pieces - 1)
    is_beyond = count == num_on_arm
    past_vertex = _distance(_row(edges), _row(track.vertex)) > 0
    is_before = jnp.where(turns, ~past_vertex, count == 0)

    # An arm enters the piece that holds the vertex there, and the others at their inner end.
    holds_vertex = turns & (rank == 0)
    high, low = (_ends(x, piece) for x in track.position)
    speeds = _ends(jnp.abs(track.velocity), piece)
    length = _at(jnp.diff(tau.high) + jnp.diff(tau.low), piece)
    rate = jnp.where(turns, 2 * track.stroke, 1.0)
    lead = jnp.where(holds_vertex, jnp.minimum(speeds[0] / rate, length), 0.0)
    span = jnp.where(holds_vertex, jnp.minimum(speeds[1] / rate, length), length)
    entry_speed = jnp.where(holds_vertex, 0.0, speeds[0])
    entry = DoubleWord(
        *(jnp.where(holds_vertex, v, x[0]) for v, x in zip(track.vertex, (high, low), strict=True))
    )

    from_entry = _distance(_row(edges), entry)
    from_outer = _distance(DoubleWord(high[1], low[1]), _row(edges))
    entry_is_nearer = from_entry < from_outer
    nearest = jnp.where(entry_is_nearer, entry_speed, speeds[1])
    time = time_between(
        jnp.where(entry_is_nearer, from_entry, from_outer),
        jnp.minimum(nearest, speed[None]),
        jnp.maximum(nearest, speed[None]),
        track.stroke,
    )
    since = jnp.where(entry_is_nearer, time, span - time)
    since = jnp.where(is_before, 0.0, jnp.where(is_beyond, span, since))
    outer = jnp.where(entry_is_nearer, span - time, time)
    outer = jnp.where(is_beyond, 0.0, jnp.where(is_before, span, outer))
    inner = lead + since
    times = jax.lax.stop_gradient((since, inner, outer))
    at_vertex = is_before & turns
    moves = at_vertex | ~(is_before | is_beyond)
    ends = _ends(tau.high, piece)
    where = jax.lax.stop_gradient((speed, at_vertex, moves, turns))
    since, inner, outer = _timed(track.from_vertex, times, motion, edges.high, ends, where)
    return Crossings(piece, rank, since, inner, outer, is_before, is_beyond)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _timed(from_vertex, times, motion, edge, ends, where):
    """`times` as they are, with derivatives of the moments that they lie between."""
    return times


@_timed.defjvp
def _timed_jvp(from_vertex, primals, tangents):
    (since, inner, outer), (a, T, s), _, ends, (speed, at_vertex, moves, turns) = primals
    _, (da, dT, ds), dedge, dends, _ = tangents
    sign = jnp.where(AFTER, 1.0, -1.0).astype(speed.dtype)
    reaches = (a > 0) & (from_vertex | (4 * a * T >= jnp.abs(s)))
    rate = jnp.where(reaches, 2 * a, 1.0)
    bend, vertex = jnp.where(reaches, 1 / rate, 0.0), jnp.where(reaches, s / rate, 0.0)
    near = reaches & (from_vertex | (jnp.abs(vertex) < T / 16))

    def scaled(change, tau):
        return change / T - tau * (dT / T)

    # Near the vertex a moment moves with it, and as the edge does from it; elsewhere as the
    # edge does from where the point was. So the arms of a slow object cancel exactly.
    tau = jnp.where(inner < outer, ends[0] + sign * inner, ends[1] - sign * outer)
    t = T * tau
    pivot = jnp.zeros_like(t) if from_vertex else jnp.where(near, vertex, t)
    velocity = sign * jnp.where(speed > 0, speed / T, 1.0)[None]
    along = (dedge[None] + pivot * (ds - pivot * da)) / velocity
    change = jnp.where(near, bend * (ds - (t + vertex) * da), 0.0) + along
    change = scaled(change, tau)
    with_vertex = scaled(bend * (ds - 2 * vertex * da), vertex / T)
    change = jnp.where(moves, jnp.where(at_vertex, with_vertex, change), 0.0)
    entered = jnp.where(turns, with_vertex, 0.0)
    changes = change - entered, change - dends[0], dends[1] - change
    return (since, inner, outer), tuple(sign * x for x in changes)


def time_between(distance: Array, before: Array, after: Array, stroke: Array) -> Array:
    r"""Time between two points of an arm, from their distance and their speeds.

    $2\,\Delta x / (u_1 + u_2)$ where the speeds are close, $(u_2 - u_1)/2A$ where they
    differ by a factor of 2: there it is the speeds that are known to the last digit,
    and near the vertex their derivatives are too.
    """
    far_apart = after > 2 * before
    safe_rate = jnp.where(far_apart, 2 * stroke, 1.0)
    total = before + after
    close = ~far_apart & (total > 0)
    by_distance = 2 * distance / jnp.where(close, total, 1.0)
    return jnp.where(far_apart, (after - before) / safe_rate, jnp.where(close, by_distance, 0.0))


def _distance(x: DoubleWord, y: DoubleWord) -> Array:
    """`x - y` to single precision: the difference of the high parts loses nothing."""
    return (x.high - y.high) + (x.low - y.low)


def _row(x: DoubleWord) -> DoubleWord:
    return DoubleWord(x.high.reshape(1, -1), x.low.reshape(1, -1))


def _ends(value: Array, piece: Array) -> tuple[Array, Array]:
    """Values `(p + 1,)` of breakpoints at the inner and the outer end of pieces."""
    left, right = _at(value[:-1], piece), _at(value[1:], piece)
    return jnp.where(AFTER, left, right), jnp.where(AFTER, right, left)


def _at(value: Array, piece: Array) -> Array:
    """Values `(p,)` of pieces; that of the only one is left to spread by itself."""
    if value.size == 1:
        return value[None]
    return value.at[piece].get(mode="promise_in_bounds")
