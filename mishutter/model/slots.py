r"""Commands as drive electronics send them: one level held over each of equal slots.

A slot holds the mean of the profile over it. Where a device has few levels, each slot takes the
level nearest to its mean plus the error that the slots before it left (error diffusion, after Floyd
and Steinberg, 1976): over a few slots the mean transmittance is that of the profile.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from mishutter._core.compiling import compiled
from mishutter.model.shutters.base import (
    AbstractPiecewiseShutter,
    AbstractShutter,
    integral_between,
    piecewise,
    uniform_breakpoints,
    within_unit,
)


def slot_means(
    shutter: AbstractShutter, num_slots: int, dtype: np.dtype
) -> Float[Array, "{num_slots}"]:
    """Mean transmittance over equal slots of the exposure; shape `(num_slots,)`."""
    return _slot_means(piecewise(shutter), num_slots, dtype)


@compiled
def _slot_means(
    profile: AbstractPiecewiseShutter, num_slots: int, dtype: np.dtype
) -> Float[Array, "{num_slots}"]:
    ends = uniform_breakpoints(num_slots, dtype)
    return within_unit(integral_between(profile, ends[:-1], ends[1:]) / jnp.diff(ends))


@compiled
def diffused(
    means: Float[Array | np.ndarray, "n"], levels: int, min_open: int = 1, min_closed: int = 1
) -> Float[Array, "n"]:
    """The levels that slots take, as transmittances; shape `(n,)`, without a derivative."""
    steps = levels - 1
    long = 1 << 30  # slots of a run that begins as long before the exposure as any device takes

    def step(carry: tuple[Array, Array, Array], mean: Array):
        left_over, last, run = carry
        target = mean + left_over
        # The upper of two equally near levels is preferred, so that no rounding decides.
        level = jnp.clip(jnp.floor(target * steps + (0.5 + 1e-5)) / steps, 0, 1)
        shortest = jnp.where(last > 0.5, min_open, min_closed)
        level = jnp.where((level != last) & (run < shortest), last, level)
        run = jnp.where(last < 0, long, jnp.where(level == last, run + 1, 1))
        return (target - level, level, run), level

    means = jax.lax.stop_gradient(jnp.asarray(means))
    first = jnp.zeros_like(means[0]), jnp.full_like(means[0], -1.0), jnp.asarray(long, jnp.int32)
    return jax.lax.scan(step, first, means)[1]


def runs_are_long_enough(
    slots: Shaped[np.ndarray, "k n"], min_open: int, min_closed: int
) -> Bool[np.ndarray, "k"]:
    """Whether each row of 0 and 1 has no run too short, but at its ends; `(k, n)` to `(k,)`."""
    holds = np.ones(len(slots), bool)
    for level, shortest in ((1, min_open), (0, min_closed)):
        for length in range(1, shortest):
            run = np.concatenate([[1 - level], np.full(length, level), [1 - level]])
            if run.size <= slots.shape[1]:
                windows = np.lib.stride_tricks.sliding_window_view(slots, run.size, axis=1)
                holds &= ~np.any(np.all(windows == run, axis=2), axis=1)
    return holds
