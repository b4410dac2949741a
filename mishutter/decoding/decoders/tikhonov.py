"""Least squares with a penalty on roughness, as strong as the expected residual demands."""

from collections.abc import Callable
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, ArrayLike, DTypeLike

from mishutter._core.compiling import compiled
from mishutter.camera.rows import along_rows
from mishutter.decoding.decoders.base import AbstractDecoder, BlurModel
from mishutter.decoding.decoders.borders import Continuation, continuation
from mishutter.decoding.decoders.linear import expected_residual


@final
class TikhonovDecoder(AbstractDecoder):
    r"""Regularised deconvolution as MATLAB's `deconvreg`, for all speeds of a scene.

    $F = \bar m G / (|m|^2 + \gamma |L|^2)$ with the mean response $m = \sum p_i H_i$ and $L$ the
    second difference along the row. $\gamma$ in $[10^{-9}, 10^9]$ is such that the estimate
    leaves as much of a plane unexplained as the ensemble filter is expected to,
    $\overline{(g - mf)^2} = \overline{(N + S v)^2 / (S \sum p_i |H_i|^2 + N)}$ with
    $v = \sum p_i |H_i - m|^2$. That is less than the noise $N$ where the noise hides detail,
    and more where the speeds differ; at $N$ the picture is still soft.
    """

    def restore(self, captured: Array, model: BlurModel) -> Array:
        extension = continuation(model, captured.shape[-1])
        response, _ = model.mean_and_spread(extension.length)
        residual = np.asarray(expected_residual(model, extension.length))
        efficiency = model.efficiency
        gain = 1 / efficiency if efficiency > 0 else 0.0
        return _regularised(captured, extension, response, residual, np.asarray(gain))


@compiled
def _regularised(
    captured: Array,
    extension: Continuation,
    response: ArrayLike,
    expected_power: ArrayLike,
    gain: ArrayLike,
) -> Array:
    """Planes whose residual has the expected power."""

    def restored(plane: Array) -> Array:
        rows, mean = extension.deviations(plane)
        spectrum = jnp.fft.rfft(rows)
        transfer = along_rows(response, spectrum)
        power = transfer.real**2 + transfer.imag**2
        turns = np.fft.rfftfreq(extension.length)
        # This is the squared response of the second difference.
        rough = along_rows(16 * np.sin(np.pi * turns) ** 4, rows)
        expected, scale = (jnp.asarray(v, rows.dtype) for v in (expected_power, gain))
        columns = extension.columns

        def excess(logarithm: Array) -> Array:
            """Power of the residual above the expected one."""
            penalty = jnp.exp(logarithm) * rough
            total = power + penalty
            share = jnp.where(total > 0, penalty / jnp.where(total > 0, total, 1), 1)
            residual = jnp.fft.irfft(spectrum * share.astype(spectrum.dtype), extension.length)
            # Continued pixels have no noise of their own, so that only recorded ones count.
            return jnp.mean(residual[:, :columns] ** 2) - expected

        total = power + jnp.exp(_root(excess, rows.dtype)) * rough
        share = jnp.where(total > 0, 1 / jnp.where(total > 0, total, 1), 0)
        inverse = jnp.conj(transfer) * share.astype(spectrum.dtype)
        return jnp.fft.irfft(spectrum * inverse, extension.length)[:, :columns] + mean * scale

    planes = captured.reshape(-1, *captured.shape[-2:])
    return jax.vmap(restored)(planes).reshape(captured.shape)


def _root(rising: Callable[[Array], Array], dtype: DTypeLike) -> Array:
    """Logarithm at which a function is zero, or the end of the range that is nearest to it."""
    low, high = jnp.log(jnp.asarray((1e-9, 1e9), dtype))
    is_below, is_above = rising(low) >= 0, rising(high) <= 0
    is_outside = is_below | is_above

    def line_outside(logarithm: Array, _: None) -> Array:
        """Prevents a derivative that is not finite where the function has no root."""
        return jnp.where(is_outside, logarithm, rising(logarithm))

    bisection = optimistix.Bisection(rtol=0, atol=0, flip=False)
    ends = {"lower": low, "upper": high}
    middle = (low + high) / 2
    solution = optimistix.root_find(
        line_outside, bisection, middle, options=ends, max_steps=40, throw=False
    )
    return jnp.where(is_below, low, jnp.where(is_above, high, solution.value))
