"""Least squares with a penalty on roughness, its strength set by the noise."""

from collections.abc import Callable
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import compiled
from mishutter.camera import along_rows
from mishutter.restore.decoders.base import AbstractDecoder, BlurModel
from mishutter.restore.decoders.borders import Continuation, continuation

_LEAST, _MOST = 1e-9, 1e9
_NUM_HALVINGS = 40
_AT_END = 1e-3
"""How near to an end of its range a logarithm is held there, and does not move."""


@final
class TikhonovDecoder(AbstractDecoder):
    r"""Regularised deconvolution by the criterion of MATLAB's `deconvreg`.

    $F = \bar H G / (|H|^2 + \gamma |L|^2)$ with the still object's kernel and $L$ the second
    difference along the row. $\gamma$ in $[10^{-9}, 10^9]$ is such that what the estimate
    leaves unexplained has the power of the noise, $\overline{(g - Hf)^2} = N$, in each
    plane.
    """

    def restore(self, captured: Array, model: BlurModel) -> Array:
        extension = continuation(model, captured.shape[-1])
        response = model.assumed_response(extension.length)
        light = model.efficiency
        gain = 1 / light if light > 0 else 0.0
        return _regularised(
            captured, extension, response, np.asarray(model.noise), np.asarray(gain)
        )


@compiled
def _regularised(
    captured: Array,
    extension: Continuation,
    response: ArrayLike,
    noise: ArrayLike,
    gain: ArrayLike,
):
    rows, mean = extension.deviations(captured)
    spectrum = jnp.fft.rfft(rows)
    transfer = along_rows(response, spectrum)
    passed = transfer.real**2 + transfer.imag**2
    turns = np.fft.rfftfreq(extension.length)
    rough = along_rows(16 * np.sin(np.pi * turns) ** 4, rows)
    noise, gain = (jnp.asarray(v, rows.dtype) for v in (noise, gain))
    columns = extension.columns

    def weight(logarithm: Array) -> Array:
        penalty = jnp.exp(logarithm) * rough
        total = passed + penalty
        return jnp.where(total > 0, penalty / jnp.where(total > 0, total, 1), 1)

    def unexplained(logarithm: Array) -> Array:
        left = spectrum * weight(logarithm).astype(spectrum.dtype)
        recorded = jnp.fft.irfft(left, extension.length)[..., :columns]
        return jnp.mean(recorded**2, axis=(-2, -1), keepdims=True)

    one = jnp.ones((*captured.shape[:-2], 1, 1), captured.dtype)
    strength = _root(lambda logarithm: unexplained(logarithm) - noise, one)
    total = passed + jnp.exp(strength) * rough
    scale = jnp.where(total > 0, 1 / jnp.where(total > 0, total, 1), 0)
    inverse = jnp.conj(transfer) * scale.astype(spectrum.dtype)
    return jnp.fft.irfft(spectrum * inverse, extension.length)[..., :columns] + mean * gain


def _root(rising: Callable[[Array], Array], one: Array) -> Array:
    r"""Logarithm at which a function is zero, or an end of the range; shape of `one`.

    Its derivative is that of the root, $-\partial f/f'$: bisection itself has none.
    """
    low, high = float(np.log(_LEAST)), float(np.log(_MOST))

    def halved(_, bounds: tuple) -> tuple:
        low, high = bounds
        middle = (low + high) / 2
        above = jax.lax.stop_gradient(rising(middle)) > 0
        return jnp.where(above, low, middle), jnp.where(above, middle, high)

    bounds = jax.lax.fori_loop(0, _NUM_HALVINGS, halved, (one * low, one * high))
    found = (bounds[0] + bounds[1]) / 2
    value, slope = jax.jvp(rising, (found,), (one,))
    inside = (slope > 0) & (found - low > _AT_END) & (high - found > _AT_END)
    slope = jax.lax.stop_gradient(jnp.where(inside, slope, 1))
    moved = (value - jax.lax.stop_gradient(value)) / slope
    return found - jnp.where(inside, moved, 0)
