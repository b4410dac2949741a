r"""How the light of taps changes as the motion and the edges do.

On an arm a tap holds the shutter's integral from one crossing to the next. It changes by the
transmittance at each, times how much that crossing moves. Where both lie in one piece that
would be a difference of what is nearly equal, and is written about their middle instead:
$\frac12 (w_1 + w_2)\,d\Delta\tau + \Delta\tau\,\overline{w'}\,d\bar\tau$.

Rates by all that changes are worked out together, forwards. The derivative is their product
with the changes: in reverse one sum for each of them, and no way back through the formulae.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter.arms import AFTER, Crossings, moment_change, time_between
from mishutter.path import Motion, once, speed_change
from mishutter.shutters.base import AbstractPiecewiseShutter


class Taps(NamedTuple):
    """What rates follow from, besides the motion: crossings `x`, and `edges`, `(1, n + 1)`.

    `gap` and `within` are the distance of a tap's edges and the time between their crossings,
    `(1, n)`. `is_held` is that of the crossings, `(2, n + 1)`; `is_inside` tells where both
    crossings of a tap are in one piece and neither is held, `(2, n)`.
    """

    profile: AbstractPiecewiseShutter
    x: Crossings
    edges: Array
    gap: Array
    within: Array
    is_held: Array
    is_inside: Array

    @property
    def parts(self) -> tuple[tuple[slice, slice], ...]:
        """Where among crossings the taps begin and end."""
        return parts(self.gap.size)


def parts(num_taps: int) -> tuple[tuple[slice, slice], ...]:
    """Where, in arrays of two rows and a column an edge, taps begin and end."""
    return (slice(None), slice(0, num_taps)), (slice(None), slice(1, num_taps + 1))


@eqx.filter_custom_jvp
def moving(light: Array, motion: Motion, edges: Array, *, from_vertex: bool, taps: Taps) -> Array:
    """Light of taps, `(n,)`, with its first derivatives by the motion and the edges as well."""
    return light


@moving.def_jvp
def _moving_jvp(primals, tangents, *, from_vertex, taps):
    light, motion, _ = primals
    change, by_motion, by_edges = tangents
    steps = {i: step for i, step in enumerate(by_motion or ()) if step is not None}
    if not steps and by_edges is None:
        return light, change
    units = np.eye(5)[[*steps, *(() if by_edges is None else (3, 4))]].astype(light.dtype)
    rates = _rates(from_vertex, motion, taps, units)
    changes = [] if change is None else [change]
    if steps:
        step = jnp.stack([*steps.values()])
        changes.append(jnp.matmul(step, rates[: len(steps)], precision="highest"))
    if by_edges is not None:
        begin, end = by_edges[: light.size], by_edges[1 : light.size + 1]
        changes += [rates[-2] * ((begin + end) / 2), rates[-1] * (end - begin)]
    return light, sum(changes[1:], changes[0])


def _rates(from_vertex: bool, motion: Motion, taps: Taps, units: np.ndarray) -> Array:
    """Rates of light, `(m, n)`, by what each of `m` rows of `units` changes.

    Columns: acceleration, half exposure, speed, position of a tap and distance of its edges.
    """
    a, T, _ = motion
    # In memory, as each row needs them.
    transmittance, slope = once(_transmittance_and_slope, taps)
    begin, end = (transmittance[k] for k in taps.parts)
    u, v = (taps.x.velocity[1:][k] for k in taps.parts)

    def rate(unit):
        by_motion, (shift, stretch) = tuple(unit[:3]), unit[3:]
        moved, faster = [], []
        for k, dedge in zip(taps.parts, (shift - stretch / 2, shift + stretch / 2), strict=True):
            x, change = taps.x.part(k), (by_motion, dedge)
            moved.append(moment_change(from_vertex, motion, x, taps.is_held[k], *change))
            speed = x.velocity[1:]
            faster.append(speed_change(from_vertex, motion, taps.edges[k], speed, *change))
        rise = T * (by_motion[0] * T + 2 * a * by_motion[1])
        changes = jnp.broadcast_to(stretch, taps.gap.shape), *faster, rise
        _, longer = jax.jvp(time_between, (taps.gap, u, v, a * T * T), changes)
        inside = (begin + end) / 2 * longer + slope * (moved[0] + moved[1]) / 2
        between = end * moved[1] - begin * moved[0]
        light = jnp.where(taps.is_inside, inside, jnp.where(AFTER, between, -between))
        return light[0] + light[1]

    return jax.vmap(rate)(units)


def _transmittance_and_slope(taps: Taps) -> tuple[Array, Array]:
    """Transmittance at crossings, and light of taps inside of a piece by their middle."""

    def mean(x, offset, width):
        distance = jnp.where(x.from_left, offset, -offset)
        return taps.profile.piece_mean(x.piece, x.from_left, distance, width)

    begin = taps.x.part(taps.parts[0])
    middle = begin.offset + jnp.where(AFTER, taps.within, -taps.within) / 2
    width = jnp.broadcast_to(taps.within, middle.shape)
    slope = jax.jvp(lambda y: mean(begin, y, width), (middle,), (jnp.ones_like(middle),))[1]
    return mean(taps.x, taps.x.offset, jnp.zeros_like(taps.x.offset)), width * slope
