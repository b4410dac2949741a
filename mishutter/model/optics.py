"""What lens and pixel leave of the waves of a picture."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

WIDEST_BLUR = 16.0
"""Of a lens, px: four of it are within the margin that captures leave beyond a picture."""


class Optics(NamedTuple):
    r"""A lens that blurs by a Gaussian and passes nothing above a cutoff.

    The cutoff belongs to the picture: nothing above it is there to be restored. The blur belongs
    to the camera: a decoder restores the picture without it.

    Attributes:
        cutoff_frequency: Highest frequency that passes; cycles/px.
        lens_blur: Standard deviation $\sigma$ of the Gaussian along the rows; px.
    """

    cutoff_frequency: float
    lens_blur: float = 0.0

    def response(self, period: int) -> np.ndarray:
        """Response on the grid of the DFT of so many pixels; shape `(period // 2 + 1,)`."""
        number = np.arange(period // 2 + 1)
        passes = number <= self.cutoff_frequency * period * (1 + 1e-12)
        return np.where(passes, lens_response(number / period, self.lens_blur), 0.0)


def lens_response(frequency: Array | np.ndarray, lens_blur: ArrayLike) -> Array | np.ndarray:
    r"""Response $e^{-2\pi^2\sigma^2 f^2}$ of a Gaussian of deviation $\sigma$, px.

    Args:
        frequency: $f$, cycles/px; any shape.
        lens_blur: $\sigma$; scalar.
    """
    space = jnp if isinstance(frequency, jax.Array) else np
    return space.exp(-2 * (np.pi * lens_blur * frequency) ** 2)


def pixel_response(frequency: Array | np.ndarray, lens_blur: ArrayLike) -> Array | np.ndarray:
    r"""Response $\operatorname{sinc}(f)\,e^{-2\pi^2\sigma^2 f^2}$ of a pixel behind the lens."""
    space = jnp if isinstance(frequency, jax.Array) else np
    return space.sinc(frequency) * lens_response(frequency, lens_blur)
