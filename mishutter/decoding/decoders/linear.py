"""Decoders that are one filter: the ensemble filter and Wiener's.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import math
from typing import final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float

from mishutter._core.checks import require
from mishutter._core.compiling import compiled
from mishutter.camera.rows import along_rows
from mishutter.decoding.decoders.base import AbstractDecoder, BlurModel
from mishutter.decoding.decoders.borders import Continuation, continuation
from mishutter.evaluation.errors import residual_fraction

LEAST_POWER = 1e-14
"""Prevents a division by zero where there is neither detail nor noise."""


@final
class EnsembleDecoder(AbstractDecoder):
    r"""The best single linear filter for all speeds of a scene.

    $G = S \sum p_i \bar H_i / (S \sum p_i |H_i|^2 + N)$, where the speed $s_i$ has the weight
    $p_i$ and the response $H_i$, on rows that are continued by their likeliest course.
    """

    def restore(self, captured: Array, model: BlurModel) -> Array:
        extension = continuation(model, captured.shape[-1])
        return filtered(captured, model, extension, ensemble_filter(model, extension.length))


def decoder_or_ensemble(decoder: object, function: str) -> AbstractDecoder:
    """The decoder of a function's argument, which is the ensemble filter where there is none."""
    chosen = EnsembleDecoder() if decoder is None else decoder
    is_decoder = isinstance(chosen, AbstractDecoder)
    require(is_decoder, f"{function}(decoder=...)", "be an instance of a decoder", decoder)
    return chosen  # type: ignore[return-value]


@final
class WienerDecoder(AbstractDecoder):
    r"""Wiener's filter with the picture's power spectrum and the still object's kernel.

    $G = S \bar H_0 / (S |H_0|^2 + N)$, the filter of the paper's section 4.2.
    """

    def restore(self, captured: Array, model: BlurModel) -> Array:
        extension = continuation(model, captured.shape[-1])
        return filtered(captured, model, extension, wiener_filter(model, extension.length))


def ensemble_filter(model: BlurModel, length: int) -> Complex[np.ndarray, "{length}//2+1"]:
    """The ensemble filter on the grid of a DFT."""
    power, (mean, spread) = model.picture_spectrum(length), model.mean_and_spread(length)
    return power * np.conj(mean) / (power * (np.abs(mean) ** 2 + spread) + model.noise)


def misfit_of(
    model: BlurModel, length: int
) -> tuple[Complex[np.ndarray, "k"], Float[np.ndarray, "k"], Float[np.ndarray, "k"], float]:
    r"""Parts of the misfit that decoders weigh with a prior, $|g - m f|^2 / (N + S v)$; nowhere 0.

    They are the mean response over the speeds, $m$, the power of the picture, $S$, and the noise
    with the power that the spread of the speeds leaves, $N + S v$, on the grid of a DFT; and the
    squared error that the ensemble filter is expected to leave.
    """
    mean, spread = model.mean_and_spread(length)
    power = np.maximum(model.picture_spectrum(length), LEAST_POWER)
    disturbance = np.maximum(model.noise, LEAST_POWER) + power * spread
    error = max(expected_squared_error(model, length), LEAST_POWER)
    return mean, power, disturbance, error


def wiener_filter(model: BlurModel, length: int) -> Complex[np.ndarray, "{length}//2+1"]:
    """Wiener's filter on the grid of a DFT."""
    power, response = model.picture_spectrum(length), model.assumed_response(length)
    return power * np.conj(response) / (power * np.abs(response) ** 2 + model.noise)


def expected_squared_error(model: BlurModel, length: int = 4096) -> float:
    r"""Mean squared error of the ensemble filter on pictures with the scene's spectrum; white = 1.

    $2\int_0^{1/2} S\,(Sv + N)/(S(|m|^2 + v) + N)\,df$, the `residual_fraction` of the picture's
    power. Of a picture without detail it is 0.
    """
    if not np.any(model.power > 0):
        return 0.0
    power, (mean, spread) = model.picture_spectrum(length), model.mean_and_spread(length)
    share = residual_fraction(power, np.abs(mean) ** 2, spread, model.noise)
    return float(mean_over_dft(power * share, length))


def squared_error_of(
    model: BlurModel, rows: Float[np.ndarray, "*planes columns"], speeds: Float[np.ndarray, "s"]
) -> Float[np.ndarray, "s"]:
    r"""Expected squared error of the ensemble filter on one picture at some speeds.

    $2\int_0^{1/2} [P |1 - G H_s|^2 + N_P |G|^2]\,df$ with the spectrum $P$ of the picture's rows,
    mirrored, about their means, and the noise $N_P$ of its mean level.
    """
    length = 2 * rows.shape[-1]
    deviation = rows - np.mean(rows, axis=-1, keepdims=True)
    # A row that is repeated as it is would jump at its ends, and the jump would count as detail.
    spectrum = np.fft.rfft(np.concatenate([deviation, deviation[..., ::-1]], axis=-1))
    power = np.mean(np.abs(spectrum.reshape(-1, spectrum.shape[-1])) ** 2, axis=0) / length
    noise, response = model.noise_at(float(np.mean(rows))), ensemble_filter(model, length)
    lost = power * np.abs(1 - response * model.responses_at(speeds, length)) ** 2
    return mean_over_dft(lost + noise * np.abs(response) ** 2, length)


def mean_over_dft(spectrum: np.ndarray, *shape: int) -> np.ndarray:
    """Mean over the last axes, all frequencies of a DFT of even rows, by those from 0 up."""
    if len(shape) > 1:
        axes = tuple(range(-len(shape), -1))
        spectrum = np.asarray(np.sum(spectrum, axis=axes, dtype=np.float64))
    ends = spectrum[..., 0] + spectrum[..., -1]
    return np.asarray((ends + 2 * np.sum(spectrum[..., 1:-1], axis=-1)) / math.prod(shape))


def filtered(
    captured: Float[Array, "*planes columns"],
    model: BlurModel,
    extension: Continuation,
    response: Complex[np.ndarray, "k"],
) -> Float[Array, "*planes columns"]:
    """Rows through a filter on the grid of a DFT, each row's mean divided by the efficiency."""
    efficiency = model.efficiency
    gain = 1 / efficiency if efficiency > 0 else 0.0
    return _filtered(captured, extension, response, np.asarray(gain))


@compiled
def _filtered(captured: Array, extension: Continuation, response: ArrayLike, gain: ArrayLike):
    rows, mean = extension.deviations(captured)
    spectrum = jnp.fft.rfft(rows, extension.length)
    spectrum = spectrum * along_rows(response, spectrum)
    estimate = jnp.fft.irfft(spectrum, extension.length)[..., : captured.shape[-1]]
    # A filter would take the level of a row for detail in noise, and shrink it.
    return estimate + mean * jnp.asarray(gain, mean.dtype)
