"""Least squares with a penalty on roughness, its strength set by the noise."""

from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter.compiling import compiled
from mishutter.decoders.base import AbstractDecoder, BlurModel
from mishutter.decoders.borders import Continuation, continuation
from mishutter.rows import along_rows

_LEAST, _MOST = 1e-9, 1e9
_NUM_HALVINGS = 40


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

    def halved(_, bounds: tuple) -> tuple:
        low, high = bounds
        middle = (low + high) / 2
        left = jnp.fft.irfft(spectrum * weight(middle).astype(spectrum.dtype), extension.length)[
            ..., :columns
        ]
        power = jnp.mean(left**2, axis=(-2, -1), keepdims=True)
        too_rough = power > noise
        return jnp.where(too_rough, low, middle), jnp.where(too_rough, middle, high)

    one = jnp.ones((*captured.shape[:-2], 1, 1), captured.dtype)
    start = (one * float(np.log(_LEAST)), one * float(np.log(_MOST)))
    low, high = jax.lax.fori_loop(0, _NUM_HALVINGS, halved, start)
    total = passed + jnp.exp((low + high) / 2) * rough
    scale = jnp.where(total > 0, 1 / jnp.where(total > 0, total, 1), 0)
    inverse = jnp.conj(transfer) * scale.astype(spectrum.dtype)
    return jnp.fft.irfft(spectrum * inverse, extension.length)[..., :columns] + mean * gain
