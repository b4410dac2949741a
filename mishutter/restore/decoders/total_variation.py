"""Least squares with a penalty on total variation along rows."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import compiled, require, require_positive_int
from mishutter.camera import along_rows
from mishutter.restore.decoders.base import AbstractDecoder, BlurModel
from mishutter.restore.decoders.borders import Continuation, continuation


@final
class TotalVariationDecoder(AbstractDecoder):
    r"""The likeliest picture where neighbours differ by a Laplace law.

    $\min_f \tfrac12 \lVert Hf - g\rVert^2 + \lambda \sum_k |f_{k+1} - f_k|$ with the still
    object's kernel, by the alternating direction method of multipliers. $\lambda = c N/b$,
    where $2b^2$ is the mean squared difference of neighbours that the picture's spectrum
    gives, is the maximum a posteriori at $c = 1$.

    Args:
        num_iterations: How many steps.
        strength: $c$; above 0.

    Raises:
        ValueError: if `num_iterations` is not a positive integer or `strength` not positive.
    """

    num_iterations: int = eqx.field(static=True, default=60)
    strength: float = eqx.field(static=True, default=1.0)

    def __check_init__(self) -> None:
        require_positive_int("TotalVariationDecoder(num_iterations=...)", self.num_iterations)
        subject = "TotalVariationDecoder(strength=...)"
        require(0 < self.strength < np.inf, subject, "be above 0", self.strength)

    def restore(self, captured: Array, model: BlurModel) -> Array:
        extension = continuation(model, captured.shape[-1])
        length = extension.length
        light = model.efficiency
        if light <= 0:
            return jnp.zeros_like(captured)
        scale = _typical_difference(model, length)
        penalty = max(self.strength * model.noise / scale, 1e-12)
        response = model.assumed_response(length)
        coupling = penalty / scale
        numbers = tuple(np.asarray(v) for v in (scale, coupling, 1 / light))
        return _split(captured, extension, response, numbers, self.num_iterations)


def _typical_difference(model: BlurModel, length: int) -> float:
    """Scale `b` of the Laplace law of neighbouring pixels' differences."""
    turns = np.fft.rfftfreq(length)
    power = model.picture_spectrum(length) * 4 * np.sin(np.pi * turns) ** 2
    return float(np.sqrt(np.mean(power) / 2)) or 1.0


@compiled
def _split(
    captured: Array,
    extension: Continuation,
    response: ArrayLike,
    numbers: tuple,
    num_iterations: int,
):
    """Alternate between the picture and its differences, with a penalty on their gap."""
    rows, mean = extension.deviations(captured)
    scale, coupling, gain = (jnp.asarray(v, rows.dtype) for v in numbers)
    length = extension.length
    spectrum = jnp.fft.rfft(rows)
    transfer = along_rows(response, spectrum)
    turns = np.fft.rfftfreq(length)
    step = along_rows(np.exp(2j * np.pi * turns) - 1, spectrum)
    total = transfer.real**2 + transfer.imag**2 + coupling * (step.real**2 + step.imag**2)
    known = jnp.conj(transfer) * spectrum
    pull = coupling.astype(spectrum.dtype) * jnp.conj(step)
    inverse = (1 / total).astype(spectrum.dtype)

    def advance(_, state: tuple) -> tuple:
        _, split, dual = state
        wanted = known + pull * jnp.fft.rfft(split - dual)
        estimate = jnp.fft.irfft(wanted * inverse, length)
        difference = jnp.roll(estimate, -1, axis=-1) - estimate
        gap = difference + dual
        split = jnp.sign(gap) * jnp.maximum(jnp.abs(gap) - scale, 0)
        return estimate, split, gap - split

    nothing = jnp.zeros_like(rows)
    estimate = jax.lax.fori_loop(0, num_iterations, advance, (rows, nothing, nothing))[0]
    return estimate[..., : extension.columns] + mean * gain
