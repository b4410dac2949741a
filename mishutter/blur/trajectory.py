r"""The trajectory of a point over the sensor: positions and velocities, in both frames.

In normalised time $\tau = t/T$ the point is at $x = A\tau^2 - B\tau$ with the sag
$A = aT^2$ and the smear $B = sT$, and moves at the velocity $u = 2A\tau - B$ (px per half
exposure). The velocity at a position follows from $u^2 = B^2 + 4Ax$, as for any constant
acceleration, and the time between two positions on one side of the vertex is
$2\,\Delta x / (u_1 + u_2)$. Neither formula subtracts two roots or divides by $A$, so both
hold at every acceleration, 0 included. `docs/derivation.md` draws the geometry.

Positions of breakpoints are double words: where the shutter jumps inside a tap, the
difference of two large numbers decides how much of the tap is exposed. Derivatives need
no such precision and follow from the plain formulae.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from mishutter._core import (
    DoubleWord,
    add,
    multiply,
    negate,
    reciprocal,
    two_product,
    two_sum,
    word,
)


class Motion(NamedTuple):
    """Motion of a point over the sensor; scalars.

    Attributes:
        acceleration: Acceleration parameter $a$; px/s^2.
        half_exposure: $T$; s.
        speed: Speed of the point over the sensor, $s$; px/s.
    """

    acceleration: Float[Array, ""]
    half_exposure: Float[Array, ""]
    speed: Float[Array, ""]


class PathChange(NamedTuple):
    """A change of a motion and of the edges that it passes.

    Attributes:
        motion: Change of each number of the motion.
        edge: Change of the edges; px, a shape that broadcasts with theirs.
    """

    motion: Motion
    edge: Float[Array, "..."]


_REST = {np.dtype(np.float64): 1e-130, np.dtype(np.float32): 1e-18}
"""Shortest path, px, whose square does not underflow; a point on a shorter one is at rest."""


def nonstationary_motion(motion: Motion) -> tuple[Motion, Array]:
    """Replaces rest by a motion of 1 px per half exposure, and tells whether it did.

    The substitute is constant, so that derivatives at rest are 0.
    """
    a, T, s = motion
    at_rest = jnp.abs(a * T * T) + jnp.abs(s * T) < _REST[np.dtype(s.dtype)]
    moving = (jnp.where(at_rest, *x) for x in ((0.0, a), (1.0, T), (1.0, s)))
    return Motion(*moving), at_rest


class Path(NamedTuple):
    """Position and velocity of a point at each breakpoint of the shutter; lengths in px.

    One loop computes all rows of `table`. The other numbers are computed at each use, which costs
    less than memory.
    """

    motion: Motion
    table: Float[Array, "5 breakpoints"]
    from_vertex: Bool[Array, ""] | bool

    @property
    def sag(self) -> Array:
        """Distance that the sensor moves from mid-exposure to either end, px."""
        a, T, _ = self.motion
        return a * T * T

    @property
    def smear(self) -> Array:
        """Distance that the object moves in half an exposure, px."""
        _, T, s = self.motion
        return s * T

    @property
    def velocity(self) -> Array:
        """Velocity at breakpoints, px per half exposure."""
        return self.table[0]

    @property
    def position(self) -> DoubleWord:
        """Position at breakpoints."""
        return DoubleWord(self.table[1], self.table[2])

    @property
    def middle(self) -> DoubleWord:
        """Position at mid-exposure."""
        return DoubleWord(*(jnp.where(self.from_vertex, x, 0.0) for x in self._rise))

    @property
    def vertex(self) -> DoubleWord:
        """Position of the vertex; 0 where it is too far away to count from."""
        return DoubleWord(*(jnp.where(self.from_vertex, 0.0, -x) for x in self._rise))

    @property
    def _rise(self) -> DoubleWord:
        return DoubleWord(self.table[3, 0], self.table[4, 0])


def speed_on_sensor(speed: Array, velocity: Array) -> DoubleWord:
    """Exact speed of an object over a sensor that pans, $s - v$; px/s.

    The upper word carries all of the derivative.
    """
    high, low = two_sum(speed, -velocity)
    return DoubleWord(high, jax.lax.stop_gradient(low))


def path(a: Array, T: Array, s: DoubleWord, tau: DoubleWord, *, from_vertex: bool) -> Path:
    """Path of a point of speed `s` at breakpoints `tau`.

    Positions count from the vertex if `from_vertex`, else from the position at
    mid-exposure.
    """
    motion = Motion(a, T, s.high)
    return Path(motion, _table(from_vertex, motion, s.low, tau), from_vertex)


def primal_path(motion: Motion, speed_low: Array, tau: DoubleWord, *, from_vertex: Array) -> Path:
    """Path of a `nonstationary_motion`, without derivatives; `from_vertex` may be traced.

    `speed_low` is the lower word of its speed.
    """
    table = partial(_exact_table, from_vertex)
    return Path(motion, opaque_to_fusion(table, motion, speed_low, tau), from_vertex)


def mirrored_velocity(motion: Motion, tau: DoubleWord) -> Array:
    r"""$2A\tau + B$, the velocity at breakpoints for the opposite speed; without derivatives."""
    a, T, s = motion

    def velocity(a, T, s, tau):
        return _velocity(*_sag_and_smear(a, T, -s, jnp.zeros_like(s)), tau)[0]

    return opaque_to_fusion(velocity, a, T, s, tau)


def speed_at(track: Path, edges: DoubleWord) -> Array:
    r"""$|u| = \sqrt{B^2 + 4Ax}$ at positions on the path, 0 at positions beyond the vertex.

    Where the vertex is near, $|u| = \sqrt{4A(x - x_v)}$ avoids the cancellation of $B^2$ and
    $4Ax$. The result carries no derivative: `speed_change` computes it.
    """
    near = track.from_vertex | (4 * track.sag >= jnp.abs(track.smear))
    # Near means at most twice as far in time as the ends of the exposure, where the table has the
    # vertex too.
    origin = [jnp.where(near, x, 0.0) for x in track.vertex]
    distance = (edges.high - origin[0]) + (edges.low - origin[1])
    square = jnp.where(near, 0.0, track.smear**2) + 4 * track.sag * distance
    return jax.lax.stop_gradient(jnp.sqrt(jnp.maximum(square, 0.0)))


def speed_change(
    from_vertex: Array, motion: Motion, edge: Array, speed: Array, change: PathChange
) -> Array:
    r"""Change of the `speed` at an edge, caused by changes of the motion and of the edge.

    It follows from $(u/T)^2 = s^2 + 4ax$, a form in which a change of $T$ cancels nothing. At
    the vertex the derivative of the root is infinite, and the change is set to 0.
    """
    (a, T, s), (da, dT, ds) = motion, change.motion
    square = 4 * (a * change.edge + edge * da) + jnp.where(from_vertex, 0.0, 2 * s * ds)
    is_moving = speed > 0
    gain = T * T * square / jnp.where(is_moving, 2 * speed, 1.0)
    return speed * (dT / T) + jnp.where(is_moving, gain, 0.0)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _table(from_vertex: bool, motion: Motion, speed_low: Array, tau: DoubleWord) -> Array:
    """Rows of a path's table: velocity, position, and height of mid-exposure above the vertex."""
    return opaque_to_fusion(partial(_exact_table, from_vertex), motion, speed_low, tau)


def opaque_to_fusion(function, *arguments, when: Array | bool = True):
    """Evaluates `function` once, in a loop of one turn that XLA may not unroll.

    Prevents XLA from fusing the function into each use of its results, which would compile
    and run hundreds of operations dozens of times. The result is zeros unless `when` holds.
    """
    start = jax.tree.map(jnp.zeros_like, jax.eval_shape(function, *arguments))
    never = jnp.array(False)

    def turn(_):
        return never, function(*arguments)

    return jax.lax.while_loop(lambda state: state[0], turn, (jnp.asarray(when), start))[1]


@jax.custom_jvp
def materialised(value: Array) -> Array:
    """Writes a value to memory before its use.

    Prevents XLA from fusing the arithmetic behind it with a lookup, which would run that
    arithmetic one number at a time instead of vectorising it.
    """
    return opaque_to_fusion(lambda x: x, value)


@materialised.defjvp
def _materialised_jvp(primals, tangents):
    return materialised(*primals), tangents[0]


def _exact_table(
    from_vertex: Array | bool, motion: Motion, speed_low: Array, tau: DoubleWord
) -> Array:
    a, T, s = motion
    sag, smear = _sag_and_smear(a, T, s, speed_low)
    # From mid-exposure, positions count from the vertex only where it is near. A far one is left
    # out, as its distance grows without bound where the acceleration vanishes.
    exists = jnp.where(from_vertex, a > 0, _turns(a * T * T, s * T))
    high = jnp.where(exists, 4 * sag.high, 1.0)
    rate = reciprocal(DoubleWord(high, jnp.where(exists, 4 * sag.low, 0.0)))
    rise = multiply(multiply(smear, smear), rate)
    rise = DoubleWord(*(jnp.where(exists, x, 0.0) for x in rise))

    velocity, linear = _velocity(sag, smear, tau)
    position = multiply(tau, add(linear, negate(smear)))
    risen = add(position, rise)
    position = (jnp.where(from_vertex, *x) for x in zip(risen, position, strict=True))
    return _rows(velocity, *position, *rise)


def _sag_and_smear(a, T, s, s_low):
    return multiply(two_product(a, T), word(T)), multiply(DoubleWord(s, s_low), word(T))


def _velocity(sag, smear, tau):
    linear = multiply(sag, tau)
    return (2 * linear.high - smear.high) + (2 * linear.low - smear.low), linear


def _rows(*rows):
    """Stacks rows by `where`: XLA does not fuse a concatenation, and would loop over each row."""
    index, result = np.arange(len(rows))[:, None], rows[-1]
    for i, row in enumerate(rows[:-1]):
        result = jnp.where(index == i, row, result)
    return result


@_table.defjvp
def _table_jvp(from_vertex, primals, tangents):
    exact = _table(from_vertex, *primals)

    def plain(motion: Motion, _: Array, exact_tau: DoubleWord) -> Array:
        a, T, s = motion
        tau, sag, smear = exact_tau.high, a * T * T, s * T
        # The slope of a position from the vertex is in proportion to the velocity, and the plain
        # formula of that cancels there.
        velocity = valued(2 * sag * tau - smear, exact[0])
        exists = (sag > 0) if from_vertex else _turns(sag, smear)
        rise = jnp.broadcast_to(_plain_vertex_distance(smear, sag, exists), tau.shape)
        if from_vertex:
            position = _plain_vertex_distance(velocity, sag, exists)
        else:
            position = tau * (sag * tau - smear)
        low = jnp.zeros_like(tau)
        return jnp.stack([velocity, position, low, rise, low])

    return exact, jax.jvp(plain, primals, tangents)[1]


def valued(formula: Array, value: Array) -> Array:
    """`value` with the derivative of `formula`, which itself cancels near the vertex."""
    return value + (formula - jax.lax.stop_gradient(formula))


def safe_sqrt(square: Array) -> Array:
    """Square root; 0 for negative numbers, and with a derivative of 0 at 0."""
    positive = square > 0
    # Without the inner `where` the infinite slope at 0, times the 0 of the outer one, would be NaN.
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def _turns(sag: Array, smear: Array) -> Array:
    """Whether the vertex is at most twice as far from mid-exposure, in time, as the ends are."""
    return (sag > 0) & (4 * sag >= jnp.abs(smear))


def _plain_vertex_distance(velocity: Array, sag: Array, exists: Array) -> Array:
    divisor = jnp.where(exists, 4 * sag, 1.0)
    return jnp.where(exists, velocity * (velocity / divisor), 0.0)
