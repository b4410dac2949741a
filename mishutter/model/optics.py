"""Frequencies at which pictures are looked at, and the response of lens and pixel to them.

The frequencies are the centres of equal steps of (0, 0.5) cycles/px.
"""

from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import (
    Alike,
    as_float,
    namespace_of,
    require_number,
    space_of,
)
from mishutter._core.modules import AbstractModule

NYQUIST_FREQUENCY = 0.5
"""The highest frequency that a sensor records; cycles/px."""
NUM_FREQUENCIES = 256
"""Least number of equal steps up to it in which a spectrum is looked at."""
WIDEST_BLUR = 16.0
"""Widest blur of a lens, px: four of it fit into the margin that captures leave."""


def frequency_grid(num_frequencies: int, dtype: np.dtype) -> Float[Array, "{num_frequencies}"]:
    """The `frequencies` as a compiled program counts them; cycles/px, shape `(m,)`."""
    return _centres(jnp.arange(num_frequencies, dtype=dtype))


def frequencies(count: int) -> Float[np.ndarray, "{count}"]:
    """Centres of equal steps in (0, 0.5); cycles/px, shape `(count,)`."""
    return _centres(np.arange(count, dtype=np.float64))


def _centres(index: Alike) -> Alike:
    return (index + 0.5) * (0.5 / index.size)


def on_steps(
    power: Float[Array | np.ndarray, "m"], count: int
) -> Float[Array | np.ndarray, "{count}"]:
    """Power of a spectrum known on other equal steps of (0, 0.5); shape `(count,)`.

    Within a step the power follows the parabola that holds the step's power and passes through the
    harmonic mean of two steps where these meet: no power is lost, and none is below 0.
    """
    if power.size == count:
        return power
    space = namespace_of(power)
    mirrored = space.concatenate([power[:1], power, power[-1:]])
    total = mirrored[:-1] + mirrored[1:]
    divisor = space.where(total > 0, total, 1.0)
    between = 2 * (mirrored[:-1] / divisor) * mirrored[1:]
    edges = np.union1d(np.linspace(0, 1, power.size + 1), np.linspace(0, 1, count + 1))
    middle = (edges[1:] + edges[:-1]) / 2
    source, target = (middle * power.size).astype(int), (middle * count).astype(int)
    start, end = edges[:-1] * power.size - source, edges[1:] * power.size - source
    first, second, third = ((end**n - start**n) / n for n in (1, 2, 3))
    shares = (6 * (second - third), first - 4 * second + 3 * third, 3 * third - 2 * second)
    parts = (power, between[:-1], between[1:])
    pieces = sum(
        (x * (count / power.size)).astype(power.dtype) * part[source]
        for x, part in zip(shares, parts, strict=True)
    )
    if space is jnp:
        return jax.ops.segment_sum(pieces, target, count)
    return np.maximum(np.bincount(target, pieces, count), 0).astype(power.dtype)


@final
class Optics(AbstractModule):
    r"""A lens that blurs by a Gaussian and passes nothing above a cutoff.

    The cutoff belongs to the picture: nothing above it is there to be restored. The blur belongs
    to the camera: a decoder restores the picture without it.

    Args:
        cutoff_frequency: Highest frequency that passes: the picture on the sensor holds none above
            it, and below it some; cycles/px, at most 0.5.
        lens_blur: Standard deviation $\sigma$ of the Gaussian that the lens spreads a point over,
            along the rows; px, at most 16.

    Raises:
        ValueError: if a number is out of its range.
    """

    cutoff_frequency: Array
    lens_blur: Array

    def __init__(
        self, *, cutoff_frequency: ArrayLike = NYQUIST_FREQUENCY, lens_blur: ArrayLike = 0.0
    ):
        self.cutoff_frequency = as_float(cutoff_frequency, "Optics(cutoff_frequency=...)")
        self.lens_blur = as_float(lens_blur, "Optics(lens_blur=...)")

    def __check_init__(self) -> None:
        subject, bound = "Optics(cutoff_frequency=...)", "above 0 and at most 0.5 cycles/px"
        most = NYQUIST_FREQUENCY
        require_number(subject, self.cutoff_frequency, bound, strict=True, most=most)
        bound = f"from 0 to {WIDEST_BLUR:g} px"
        require_number("Optics(lens_blur=...)", self.lens_blur, bound, most=WIDEST_BLUR)

    def response(self, period: int) -> Float[np.ndarray, "{period}//2+1"]:
        """Response on the grid of the DFT of so many pixels; shape `(period // 2 + 1,)`.

        Args:
            period: Number of pixels; the lens is concrete.
        """
        number = np.arange(period // 2 + 1)
        cutoff, blur = float(self.cutoff_frequency), float(self.lens_blur)
        passes = number <= cutoff * period * (1 + 1e-12)
        return np.where(passes, lens_response(number / period, blur), 0.0)


def lens_response(
    frequency: Float[Array | np.ndarray, "*shape"], lens_blur: ArrayLike
) -> Float[Array | np.ndarray, "*shape"]:
    r"""Response $e^{-2\pi^2\sigma^2 f^2}$ of a Gaussian of deviation $\sigma$, px."""
    space = space_of(frequency)
    return space.exp(-2 * (np.pi * lens_blur * frequency) ** 2)


def pixel_response(
    frequency: Float[Array | np.ndarray, "*shape"], lens_blur: ArrayLike
) -> Float[Array | np.ndarray, "*shape"]:
    r"""Response $\operatorname{sinc}(f)\,e^{-2\pi^2\sigma^2 f^2}$ of a pixel behind the lens."""
    space = space_of(frequency)
    return space.sinc(frequency) * lens_response(frequency, lens_blur)
