r"""The likeliest continuation of a captured row beyond its ends.

A filter that takes a row for periodic, dark or mirrored outside rings at the borders.
Here the row is continued by the conditional mean of a Gaussian process with the
autocovariance of a capture, $r = \mathcal F^{-1}[S \sum p_i |H_i|^2 + N]$, given the
pixels at both ends, over a gap that makes the row periodic without a jump. By the tower
rule the best linear filter of the continued row is the best linear estimate from the row
as it is: the continuation loses nothing that was recorded.
"""

from functools import lru_cache
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter.camera.rows import fast_length
from mishutter.decoding.decoders.base import BlurModel


@final
class Continuation(eqx.Module):
    """Continuation of rows of one length, for one blur model."""

    # Linear map from the deviations of the last and the first pixels, in the order in which they
    # meet across the gap, to those in the gap
    prediction: Float[np.ndarray, "gap ends"]
    columns: int = eqx.field(static=True)  # Length of a row
    length: int = eqx.field(static=True)  # Length of the continued row
    # Pixels at either end from which the continuation is predicted
    context: int = eqx.field(static=True)

    def deviations(
        self, rows: Float[Array, "*planes columns"]
    ) -> tuple[Float[Array, "*planes length"], Float[Array, "*planes 1"]]:
        """Deviations of continued rows from each row's mean, and these means."""
        mean = jnp.mean(rows, axis=-1, keepdims=True)
        deviation = rows - mean
        first, last = deviation[..., : self.context], deviation[..., self.columns - self.context :]
        ends = jnp.concatenate([last, first], axis=-1)
        gap = ends @ jnp.asarray(self.prediction.T, rows.dtype)
        return jnp.concatenate([deviation, gap], axis=-1), mean


def continuation(model: BlurModel, columns: int) -> Continuation:
    """The likeliest continuation of rows of `columns` pixels of captures with the blur `model`."""
    reach = model.num_taps
    # Over three kernels the covariance of either end dies away, so that the ends do not meet in a
    # jump.
    length = fast_length(columns + max(3 * reach, 128))
    # Pixels further from the gap than a kernel hardly predict it, and equations cost their cube.
    context = min(columns // 2, max(reach, 64), 320)
    covariance = np.fft.irfft(captured_spectrum(model, length), length)
    prediction = _prediction(covariance.tobytes(), length - columns, context)
    return Continuation(prediction, columns, length, context)


def captured_spectrum(model: BlurModel, length: int) -> Float[np.ndarray, "{length}//2+1"]:
    """Power spectrum of a capture, noise included."""
    mean, spread = model.mean_and_spread(length)
    return model.picture_spectrum(length) * (np.abs(mean) ** 2 + spread) + model.noise


@lru_cache(maxsize=16)
def _prediction(periodic_covariance: bytes, gap: int, context: int) -> np.ndarray:
    """Cached, because a picture is restored a few rows at a time."""
    from scipy.linalg import cho_factor, cho_solve

    covariance = np.frombuffer(periodic_covariance)
    ends = np.concatenate([np.arange(-context, 0), gap + np.arange(context)])
    among = covariance[np.abs(ends[:, None] - ends) % covariance.size]
    # Without noise neighbouring pixels are so alike that the matrix is singular to rounding.
    among[np.diag_indices_from(among)] += 1e-10 * covariance[0]
    across = covariance[np.abs(np.arange(gap)[:, None] - ends) % covariance.size]
    return cho_solve(cho_factor(among), across.T).T if context else np.zeros((gap, 0))
