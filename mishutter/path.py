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
from jaxtyping import Array

from mishutter.doubleword import (
    DoubleWord,
    add,
    divide,
    multiply,
    negate,
    scale,
    two_product,
    word,
)


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


def path(a: Array, T: Array, s: Array, tau: DoubleWord, *, from_vertex: bool) -> Path:
    """Path of a point of speed `s` at breakpoints `tau`.

    Positions count from the vertex if `from_vertex`, else from where the point is at
    mid-exposure.
    """
    stroke, smear, velocity, position, vertex = _path(from_vertex, a, T, s, *tau)
    return Path(stroke, smear, velocity, DoubleWord(*position), DoubleWord(*vertex))


def speed_at(a: Array, T: Array, s: Array, edges: DoubleWord, *, from_vertex: bool) -> Array:
    r"""$|u| = \sqrt{B^2 + 4Ax}$ at positions on the path, 0 beyond the vertex.

    Its derivative at the vertex itself, where it is infinite, is given as 0.
    """
    return safe_sqrt(_speed_squared(from_vertex, a, T, s, *edges))


def _once(function, like, *arguments):
    """`function` of `arguments`, as a loop of one turn: a compiler may not unroll it.

    `like` has the shapes of the result.

    Left open, hundreds of operations on double words would be folded into each of
    their uses and compiled, and run, dozens of times.
    """
    start = jax.tree.map(jnp.zeros_like, like)

    def turn(state):
        result = function(*arguments)
        first = jax.tree.leaves(result)[0]
        again = jnp.any(first < first)
        return again, result

    return jax.lax.while_loop(lambda state: state[0], turn, (jnp.array(True), start))[1]


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _path(from_vertex, a, T, s, tau_high, tau_low):
    like = a, a, tau_high, (tau_high, tau_high), (a, a)
    return _once(partial(_path_exact, from_vertex), like, a, T, s, tau_high, tau_low)


def _path_exact(from_vertex, a, T, s, tau_high, tau_low):
    stroke = multiply(two_product(a, T), word(T))
    smear = two_product(s, T)
    tau = DoubleWord(tau_high, tau_low)
    velocity = add(scale(multiply(stroke, tau), 2.0), negate(smear))
    if from_vertex:
        position = _vertex_distance(velocity, stroke, stroke.high > 0)
        vertex = word(jnp.zeros_like(stroke.high))
    else:
        position = multiply(tau, add(multiply(stroke, tau), negate(smear)))
        vertex = negate(_vertex_distance(smear, stroke, _turns(stroke.high, smear.high)))
    return stroke.high, smear.high, velocity.high, tuple(position), tuple(vertex)


@_path.defjvp
def _path_jvp(from_vertex, primals, tangents):
    exact = _path(from_vertex, *primals)

    def plain(a, T, s, tau, _):
        stroke, smear = a * T * T, s * T
        velocity = _valued(2 * stroke * tau - smear, exact[2])
        if from_vertex:
            position = _plain_vertex_distance(velocity, stroke, stroke > 0)
            vertex = jnp.zeros_like(stroke)
        else:
            position = tau * (stroke * tau - smear)
            vertex = -_plain_vertex_distance(smear, stroke, _turns(stroke, smear))
        low = (jnp.zeros_like(position), jnp.zeros_like(vertex))
        return stroke, smear, velocity, (position, low[0]), (vertex, low[1])

    return exact, jax.jvp(plain, primals, tangents)[1]


def _valued(formula: Array, value: Array) -> Array:
    """The derivative of `formula` with a better `value`: near the vertex it cancels."""
    return value + (formula - jax.lax.stop_gradient(formula))


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _speed_squared(from_vertex, a, T, s, edge, edge_low):
    return _once(partial(_speed_squared_exact, from_vertex), edge, a, T, s, edge, edge_low)


def _speed_squared_exact(from_vertex, a, T, s, edge, edge_low):
    stroke = multiply(two_product(a, T), word(T))
    square = scale(multiply(stroke, DoubleWord(edge, edge_low)), 4.0)
    if not from_vertex:
        smear = two_product(s, T)
        square = add(multiply(smear, smear), square)
    return square.high


@_speed_squared.defjvp
def _speed_squared_jvp(from_vertex, primals, tangents):
    def plain(a, T, s, edge, edge_low):
        square = 4 * (a * T * T) * edge
        return square if from_vertex else (s * T) ** 2 + square

    return _speed_squared(from_vertex, *primals), jax.jvp(plain, primals, tangents)[1]


def safe_sqrt(square: Array) -> Array:
    """Square root whose derivative at 0 is 0, and which is 0 below."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def _turns(stroke: Array, smear: Array) -> Array:
    """Whether the exposure reaches the vertex of the path."""
    return (stroke > 0) & (2 * stroke >= jnp.abs(smear))


def _vertex_distance(velocity: DoubleWord, stroke: DoubleWord, exists: Array) -> DoubleWord:
    """Distance from the vertex at a given velocity, `u^2 / 4A`; 0 where there is none."""
    square = multiply(velocity, velocity)
    divisor = DoubleWord(
        jnp.where(exists, 4 * stroke.high, 1.0), jnp.where(exists, 4 * stroke.low, 0.0)
    )
    distance = divide(square, divisor)
    return DoubleWord(jnp.where(exists, distance.high, 0.0), jnp.where(exists, distance.low, 0.0))


def _plain_vertex_distance(velocity: Array, stroke: Array, exists: Array) -> Array:
    divisor = jnp.where(exists, 4 * stroke, 1.0)
    return jnp.where(exists, velocity * (velocity / divisor), 0.0)
