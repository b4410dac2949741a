r"""The path of a point over the sensor, in the two frames, exact where it must be.

In normalised time $\tau = t/T$ the point is at $x = A\tau^2 - B\tau$ with the stroke
$A = aT^2$ and the smear $B = sT$, and moves at the velocity $u = 2A\tau - B$ (px per half
exposure). At a position $x$ its velocity follows from $u^2 = B^2 + 4Ax$, as for any
constant acceleration, and the time between two positions on one side of the vertex is
$2\,\Delta x / (u_1 + u_2)$: no root is subtracted, and nothing is divided by $A$.

Positions of breakpoints are double words: a jump of the shutter that falls inside a
tap decides that tap by the difference of two large numbers. Derivatives need no such
care and are those of the plain formulae.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter.doubleword import (
    DoubleWord,
    add,
    multiply,
    negate,
    reciprocal,
    scale,
    two_product,
    word,
)

Motion = tuple[Array, Array, Array]
"""Acceleration parameter, px/s^2, half exposure, s, and object speed, px/s; scalars."""


class Path(NamedTuple):
    """Where a point is, and how fast, at each breakpoint of the shutter.

    `velocity` and `position` have the shape of the breakpoints; `vertex` is the position
    of the turning point, where the exposure reaches it. Lengths are in px.
    """

    stroke: Array
    smear: Array
    velocity: Array
    position: DoubleWord
    vertex: DoubleWord
    from_vertex: bool


def path(a: Array, T: Array, s: Array, tau: DoubleWord, *, from_vertex: bool) -> Path:
    """Path of a point of speed `s` at breakpoints `tau`.

    Positions count from the vertex if `from_vertex`, else from where the point is at
    mid-exposure.
    """
    velocity, position, vertex = _path(from_vertex, a, T, s, *tau)
    return Path(a * T * T, s * T, velocity, DoubleWord(*position), DoubleWord(*vertex), from_vertex)


def speed_at(motion: Motion, track: Path, edges: DoubleWord) -> Array:
    r"""$|u| = \sqrt{B^2 + 4Ax}$ at positions on the path, 0 beyond the vertex.

    Counted from a vertex that is near, $|u| = \sqrt{4A(x - x_v)}$ loses nothing. The
    derivative at the vertex itself, where it is infinite, is given as 0.
    """
    near = track.from_vertex | (4 * track.stroke >= jnp.abs(track.smear))
    origin = [jnp.where(near, x, 0.0) for x in track.vertex]
    distance = (edges.high - origin[0]) + (edges.low - origin[1])
    square = jnp.where(near, 0.0, track.smear**2) + 4 * track.stroke * distance
    speed = jnp.sqrt(jnp.maximum(square, 0.0))
    return _speed(track.from_vertex, jax.lax.stop_gradient(speed), motion, edges.high)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _speed(from_vertex, speed, motion, edge):
    return speed


@_speed.defjvp
def _speed_jvp(from_vertex, primals, tangents):
    r"""From $(u/T)^2 = s^2 + 4ax$: written so, change of $T$ meets no cancellation."""
    speed, (a, T, s), edge = primals
    _, (da, dT, ds), dedge = tangents
    square = 4 * (a * dedge + edge * da) + (0.0 if from_vertex else 2 * s * ds)
    moving = speed > 0
    change = T * T * square / jnp.where(moving, 2 * speed, 1.0)
    return speed, speed * (dT / T) + jnp.where(moving, change, 0.0)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _path(from_vertex, a, T, s, tau_high, tau_low):
    rows = _once(partial(_path_exact, from_vertex), a, T, s, tau_high, tau_low)
    if from_vertex:
        return rows[0], (rows[1], rows[2]), (jnp.zeros_like(a), jnp.zeros_like(a))
    return rows[0], (rows[1], rows[2]), (rows[3, 0], rows[4, 0])


def _once(function, *arguments):
    """`function` of `arguments`, as a loop of one turn: a compiler may not unroll it.

    Left open, hundreds of operations on double words would be folded into each of
    their uses and compiled, and run, dozens of times.
    """
    start = jnp.zeros_like(jax.eval_shape(function, *arguments))
    never = arguments[0] < arguments[0]

    def turn(_):
        return never, function(*arguments)

    return jax.lax.while_loop(lambda state: state[0], turn, (jnp.array(True), start))[1]


def _path_exact(from_vertex, a, T, s, tau_high, tau_low):
    """Rows of velocity, position (high, low) and vertex (high, low) at breakpoints.

    They are of one shape, and in one array, because a compiler makes one loop of that.
    """
    stroke = multiply(two_product(a, T), word(T))
    smear = two_product(s, T)
    exists = (a > 0) if from_vertex else _turns(a * T * T, s * T)
    high = jnp.where(exists, 4 * stroke.high, 1.0)
    rate = reciprocal(DoubleWord(high, jnp.where(exists, 4 * stroke.low, 0.0)))
    rate = DoubleWord(*(jnp.where(exists, x, 0.0) for x in rate))
    tau = DoubleWord(tau_high, tau_low)
    stroke, smear, rate = (
        DoubleWord(*(jnp.broadcast_to(part, tau_high.shape) for part in x))
        for x in (stroke, smear, rate)
    )
    linear = multiply(stroke, tau)
    velocity = add(scale(linear, 2.0), negate(smear))
    if from_vertex:
        return _rows(velocity.high, *multiply(multiply(velocity, velocity), rate))
    position = multiply(tau, add(linear, negate(smear)))
    vertex = negate(multiply(multiply(smear, smear), rate))
    return _rows(velocity.high, *position, *vertex)


def _rows(*rows):
    """Rows of an array; chosen, where to join them would make loops of their own."""
    index, result = np.arange(len(rows))[:, None], rows[-1][None]
    for i, row in enumerate(rows[:-1]):
        result = jnp.where(index == i, row[None], result)
    return result


@_path.defjvp
def _path_jvp(from_vertex, primals, tangents):
    exact = _path(from_vertex, *primals)

    def plain(a, T, s, tau, _):
        stroke, smear = a * T * T, s * T
        velocity = _valued(2 * stroke * tau - smear, exact[0])
        if from_vertex:
            position = _plain_vertex_distance(velocity, stroke, stroke > 0)
            vertex = jnp.zeros_like(stroke)
        else:
            position = tau * (stroke * tau - smear)
            vertex = -_plain_vertex_distance(smear, stroke, _turns(stroke, smear))
        return velocity, (position, jnp.zeros_like(position)), (vertex, jnp.zeros_like(vertex))

    return exact, jax.jvp(plain, primals, tangents)[1]


def _valued(formula: Array, value: Array) -> Array:
    """The derivative of `formula` with a better `value`: near the vertex it cancels."""
    return value + (formula - jax.lax.stop_gradient(formula))


def safe_sqrt(square: Array) -> Array:
    """Square root whose derivative at 0 is 0, and which is 0 below."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def _turns(stroke: Array, smear: Array) -> Array:
    """Whether the vertex of the path is no farther from mid-exposure than twice its ends."""
    return (stroke > 0) & (4 * stroke >= jnp.abs(smear))


def _plain_vertex_distance(velocity: Array, stroke: Array, exists: Array) -> Array:
    divisor = jnp.where(exists, 4 * stroke, 1.0)
    return jnp.where(exists, velocity * (velocity / divisor), 0.0)
