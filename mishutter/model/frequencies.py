"""Spatial frequencies that a picture is looked at on: equal steps of (0, 0.5) cycles/px."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


def frequency_grid(num_frequencies: int, dtype: np.dtype) -> Array:
    """Centres of equal steps in (0, 0.5); cycles/px, shape `(m,)`."""
    return (jnp.arange(num_frequencies, dtype=dtype) + 0.5) * (0.5 / num_frequencies)


def frequencies(count: int) -> np.ndarray:
    """Centres of equal steps in (0, 0.5); cycles/px, shape `(count,)`."""
    return (np.arange(count) + 0.5) * (0.5 / count)


def on_steps(power: Array | np.ndarray, count: int) -> Array | np.ndarray:
    """Power of a spectrum known on other equal steps of (0, 0.5); shape `(count,)`.

    Between fewer it is interpolated, of more it is the mean, so that none is lost.
    """
    space = np if isinstance(power, np.ndarray) else jnp
    if power.size <= count:
        known, wanted = (frequencies(x).astype(power.dtype) for x in (power.size, count))
        return space.interp(wanted, known, power)
    edges = np.union1d(np.linspace(0, 1, power.size + 1), np.linspace(0, 1, count + 1))
    middle, share = (edges[1:] + edges[:-1]) / 2, np.diff(edges) * count
    pieces = power[(middle * power.size).astype(int)] * share.astype(power.dtype)
    step = (middle * count).astype(int)
    if space is jnp:
        return jax.ops.segment_sum(pieces, step, count)
    return np.bincount(step, pieces, count).astype(power.dtype)
