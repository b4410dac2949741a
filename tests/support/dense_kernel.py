"""The exposure integral with every piece of the shutter taken at every tap, on both branches.

Slow and plain: nothing is sorted, counted or gathered, speeds are double words, and
derivatives are those of the formulae themselves. The package's own way is held to it.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from mishutter._core import DoubleWord, add, multiply, two_product, two_sum, word

# A second form of the kernel from the package's own double words and path.
from mishutter._core.double_double import scale
from mishutter.blur import safe_sqrt
from mishutter.blur.trajectory import path
from mishutter.model import piecewise, within_unit


def exposure(shutter, a, T, s, edges, *, from_vertex):
    """Share of a fully open exposure between edges, or from a first edge on, one px each.

    The speed `s` is that over the sensor, a double word.
    """
    profile, dtype = piecewise(shutter), np.dtype(edges.high.dtype)
    tau = profile.breakpoints(dtype)
    track = path(a, T, s, tau, from_vertex=from_vertex)
    length = jnp.diff(tau.high) + jnp.diff(tau.low)
    reach = 2 * jnp.max(jnp.abs(track.position.high)) + jnp.abs(track.vertex.high) + 1
    inside = DoubleWord(*(jnp.clip(e, -reach, reach) for e in edges))
    speed = safe_sqrt(_speed_squared(from_vertex, a, T, *s, *inside))
    return _light(profile, _pieces(track, length), edges, speed, track.sag) / 2


def unit_edges(first, num_taps):
    """Edges one px apart, exactly."""
    index = jnp.arange(num_taps + 1, dtype=first.dtype)
    return two_sum(index, jnp.broadcast_to(first, num_taps + 1))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _speed_squared(from_vertex, a, T, s, s_low, edge, edge_low):
    stroke = multiply(two_product(a, T), word(T))
    square = scale(multiply(stroke, DoubleWord(edge, edge_low)), 4.0)
    if not from_vertex:
        smear = multiply(DoubleWord(s, s_low), word(T))
        square = add(multiply(smear, smear), square)
    return square.high


@_speed_squared.defjvp
def _speed_squared_jvp(from_vertex, primals, tangents):
    def plain(a, T, s, _, edge, __):
        square = 4 * (a * T * T) * edge
        return square if from_vertex else (s * T) ** 2 + square

    return _speed_squared(from_vertex, *primals), jax.jvp(plain, primals, tangents)[1]


def _pieces(track, length):
    """Ends of each piece on each branch, and the time from its inner one to the vertex."""
    outwards = jnp.stack([-track.velocity, track.velocity])
    on_arm = outwards >= 0
    high = jnp.where(on_arm, track.position.high, track.vertex.high)
    low = jnp.where(on_arm, track.position.low, track.vertex.low)
    speed = jnp.where(on_arm, outwards, 0.0)

    def inner(x):
        return jnp.stack([x[0, 1:], x[1, :-1]], axis=1)[..., None]

    def outer(x):
        return jnp.stack([x[0, :-1], x[1, 1:]], axis=1)[..., None]

    turns = (inner(outwards) < 0) & (track.sag > 0)
    offset = jnp.where(turns, -inner(outwards) / jnp.where(turns, 2 * track.sag, 1.0), 0.0)
    return (
        DoubleWord(inner(high), inner(low)),
        DoubleWord(outer(high), outer(low)),
        inner(speed),
        outer(speed),
        jnp.minimum(offset, length[:, None, None]),
    )


def _light(profile, pieces, edges, velocity, stroke):
    inner, outer, inner_speed, outer_speed, to_vertex = pieces
    edges = DoubleWord(edges.high[None, None], edges.low[None, None])
    below = _distance(edges, inner) <= 0
    above = _distance(edges, outer) >= 0

    def clipped(edge, at_inner, at_outer):
        return jnp.where(below, at_inner, jnp.where(above, at_outer, edge))

    u = clipped(velocity[None, None], inner_speed, outer_speed)
    x = DoubleWord(
        clipped(edges.high, inner.high, outer.high), clipped(edges.low, inner.low, outer.low)
    )
    step = jnp.diff(x.high) + jnp.diff(x.low)
    width = time_between(step, u[..., :-1], u[..., 1:], stroke)
    near = to_vertex + time_between(_distance(x, inner), inner_speed, u, stroke)[..., :-1]
    far = time_between(_distance(outer, x), u, outer_speed, stroke)[..., 1:]
    start = jnp.stack([far[:, 0], near[:, 1]], axis=1)
    remaining = jnp.stack([near[:, 0], far[:, 1]], axis=1)
    index = jnp.arange(width.shape[0], dtype=jnp.int32)[:, None, None]
    piece = jnp.broadcast_to(index, width.shape)
    distance = jnp.minimum(start, remaining) + width / 2
    mean = profile.piece_mean(piece, start <= remaining, distance, width)
    return jnp.sum(width * within_unit(mean), axis=(0, 1))


def time_between(distance, before, after, stroke):
    """Time between two points of a branch, by the better known of their distance and speeds."""
    far_apart = after > 2 * before
    safe_rate = jnp.where(far_apart, 2 * stroke, 1.0)
    total = before + after
    close = ~far_apart & (total > 0)
    by_distance = 2 * distance / jnp.where(close, total, 1.0)
    return jnp.where(far_apart, (after - before) / safe_rate, jnp.where(close, by_distance, 0.0))


def _distance(x, y):
    return (x.high - y.high) + (x.low - y.low)
