"""Richardson-Lucy deconvolution along rows."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter.decoders.base import AbstractDecoder, BlurModel
from mishutter.decoders.borders import Continuation, continuation
from mishutter.rows import along_rows
from mishutter.types import require_positive_int

_LEAST = 1e-6


@final
class RichardsonLucyDecoder(AbstractDecoder):
    r"""Richardson-Lucy with the still object's kernel (the paper's section 4.2).

    $f \leftarrow f \cdot H^\top(g / Hf) / H^\top 1$, from $g/\eta$ on, on rows continued
    by their likeliest course.

    Args:
        num_iterations: How many steps; 30 in the paper.

    Raises:
        ValueError: if `num_iterations` is not a positive integer.
    """

    num_iterations: int = eqx.field(static=True, default=30)

    def __check_init__(self) -> None:
        require_positive_int("RichardsonLucyDecoder(num_iterations=...)", self.num_iterations)

    def restore(self, captured: Array, model: BlurModel) -> Array:
        extension = continuation(model, captured.shape[-1])
        response = model.assumed_response(extension.length)
        return _iterated(captured, extension, response, model.efficiency, self.num_iterations)


@eqx.filter_jit
def _iterated(
    captured: Array,
    extension: Continuation,
    response: Array | np.ndarray,
    light: ArrayLike,
    steps: int,
):
    deviations, mean = extension.deviations(captured)
    data = jnp.maximum(deviations + mean, _LEAST * light)

    def through(rows: Array, transfer: Array) -> Array:
        spectrum = jnp.fft.rfft(rows)
        return jnp.fft.irfft(spectrum * along_rows(transfer, spectrum), extension.length)

    def step(_, estimate: Array) -> Array:
        ratio = data / jnp.maximum(through(estimate, response), _LEAST * light)
        return estimate * jnp.maximum(through(ratio, response.conj()) / light, 0)

    estimate = jax.lax.fori_loop(0, steps, step, data / light)
    return estimate[..., : captured.shape[-1]]
