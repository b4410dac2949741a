r"""The transmittance of a first-order device, exactly, where its command is held over slots.

Over a slot of level $c$ the state $x$ of a device of time constant $\sigma$ (in units of $\tau$)
follows $\dot x = (c - x)/\sigma$, so that $x = c + (x_0 - c)\,e^{-o/\sigma}$ at an offset $o$. It
never reaches $c$: the sign of $c - x_0$ tells whether it rises or falls over the whole slot.
"""

from typing import ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.compiling import compiled
from mishutter.model.shutters.base import (
    AbstractPiecewiseShutter,
    Cells,
    Offsets,
    Pieces,
    Sides,
    Values,
    above_zero,
    polynomial,
    uniform_breakpoints,
    within_exposure,
)

# Of the mean of 1 - exp(-y) over [0, y] divided by y, the highest power first.
_SERIES = [(-1.0) ** (k + 1) / float(np.prod(np.arange(1.0, k + 2))) for k in range(16, 0, -1)]


@final
class LaggedShutter(AbstractPiecewiseShutter):
    r"""State of a first-order device over an exposure.

    Each slot is two pieces, the transient and then the rest at its level; either may have no
    length. The rest leaves out the 7e-13 of a step that remain after 28 time constants.
    """

    begins: Array
    levels: Array
    starts: Array
    constants: Array
    panels_per_piece: ClassVar[int] = 1
    equal_pieces: ClassVar[bool] = False
    symmetric: ClassVar[bool] = False

    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        tau = jnp.asarray(tau, self.levels.dtype)
        begins = self.begins
        slot = jnp.clip(jnp.searchsorted(begins, tau, side="right") - 1, 0, self.levels.size - 1)
        share = jnp.maximum(tau - begins[slot], 0) / self.constants[slot]
        decay, growth = jnp.exp(-share), -jnp.expm1(-share)
        state = self.starts[slot] * decay + self.levels[slot] * growth
        return within_exposure(tau, state)

    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        begins = self.begins.astype(dtype)
        # 7e-13 of the way is left after 28 time constants.
        settled = begins[:-1] + 28.0 * self.constants.astype(dtype)
        cut = jnp.where(settled < begins[1:], settled, begins[1:])
        return jnp.append(jnp.stack([begins[:-1], cut], axis=1).ravel(), begins[-1])

    def piece_transmittance(self, offset: Offsets) -> Values:
        shape = (-1,) + (1,) * (offset.ndim - 1)
        levels, starts, constants = (
            jnp.repeat(x, 2).reshape(shape).astype(offset.dtype)
            for x in (self.levels, self.starts, self.constants)
        )
        rests = (np.arange(offset.shape[0]) % 2 == 1).reshape(shape)
        share = jnp.where(rests, jnp.zeros_like(offset), offset) / constants
        state = starts * jnp.exp(-share) - levels * jnp.expm1(-share)
        return jnp.where(rests, levels, state)

    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        dtype = np.dtype(width.dtype)
        length = jnp.diff(self.breakpoints(dtype))[piece]
        levels, starts, constants = (
            x.astype(dtype)[piece // 2] for x in (self.levels, self.starts, self.constants)
        )
        begin = jnp.where(from_left, distance, length - distance) - width / 2
        # A clip would have no slope, or half of it, where an interval begins with its slot.
        begin = begin + jax.lax.stop_gradient(jnp.maximum(begin, 0) - begin)
        rests = piece % 2 == 1
        begin, width = (jnp.where(rests, 0.0, x) / constants for x in (begin, width))
        decay = jnp.exp(-begin)
        deficit, mean = _means(width)
        growth = decay * deficit - jnp.expm1(-begin)
        return jnp.where(rests, levels, starts * (decay * mean) + levels * growth)


def _means(width: Array) -> tuple[Array, Array]:
    r"""Means of $1 - e^{-y}$ and of $e^{-y}$ over `[0, width]`, neither by cancellation."""
    narrow = width < 0.5
    small, large = jnp.where(narrow, width, 0.0), jnp.where(narrow, 1.0, width)
    mean = -jnp.expm1(-large) / large
    series = small * polynomial(_SERIES, small)
    return jnp.where(narrow, series, 1 - mean), jnp.where(narrow, 1 - series, mean)


@compiled
def lagged(
    levels: Float[Array, "n"],  # shape `(n,)`
    rise: Float[Array, ""],
    fall: Float[Array, ""],
    delay: Float[Array, ""] | None = None,  # None for none
) -> LaggedShutter:
    r"""The state of a first-order device that is driven to a level in each of equal slots.

    The first level is held long before the exposure, so that the state at $\tau = -1$ is that.
    """
    dtype, count = np.dtype(levels.dtype), levels.size
    begins = uniform_breakpoints(count, dtype)
    if delay is not None:
        # All slots are late by whole slots and a part of one. The exposure then sees `count + 1`
        # slots, of which those before the first level that was sent hold that level too.
        slot = 2 / count
        late = jnp.floor(jax.lax.stop_gradient(delay) / slot)
        past = jnp.clip(delay - late * slot, 0, slot)
        begins = jnp.concatenate([begins[:1], begins[:-1] + past, begins[-1:]])
        sent = (
            jnp.arange(count + 1, dtype=jnp.int32) - 1 - jnp.minimum(late, count).astype(jnp.int32)
        )
        levels = levels[jnp.clip(sent, 0, count - 1)]
    lengths = jnp.diff(begins)
    rise, fall = above_zero(rise), above_zero(fall)

    def step(state: Array, slot: tuple[Array, Array]):
        level, length = slot
        constant = jnp.where(level > state, rise, fall)
        gone = -jnp.expm1(-length / constant)
        return state + (level - state) * gone, (state, constant)

    _, (starts, constants) = jax.lax.scan(step, levels[0], (levels, lengths))
    return LaggedShutter(begins, levels, starts, constants)
