"""Photo-electrons of a pixel: when they fill it, and the noise that they come with."""

from typing import Any

import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core import as_numpy

Numbers = Array | np.ndarray | np.floating | float


def noise_power(
    throughput: Numbers,
    mean_level: Numbers,
    electrons: Numbers,
    read_noise: Numbers,
    *,
    unit: Numbers = 1.0,
) -> Any:
    r"""Variance of a pixel, $\eta \bar f p + \sigma^2$, in squares of a unit; of any shape.

    The noise of equation (4) of "Improved motion invariant imaging with time varying shutter
    functions": Poisson numbers of electrons, and those of reading. In units of $p$ it is
    $\eta \bar f/p + (\sigma/p)^2$.

    Args:
        throughput: Mean transmittance over the exposure, $\eta$.
        mean_level: Mean of the picture, white = 1, $\bar f$.
        electrons: Photo-electrons of a white pixel in a fully open exposure, $p$.
        read_noise: Standard deviation of the read noise, $\sigma$; e-.
        unit: The unit, e-. Divided by one of about their size, squares of electrons stay within
            the range of 32 bits.
    """
    shot = throughput * mean_level * (electrons / unit) / unit
    return shot + (read_noise / unit) ** 2


def white_electrons(photon_rate: Numbers, exposure: Numbers, throughput: Numbers = 1.0) -> Any:
    r"""Photo-electrons of a white pixel, $p = R\cdot\eta\cdot 2T$; e-, of any shape.

    They are NumPy's if all of the numbers are concrete.

    Args:
        photon_rate: Photo-electrons a second at a white pixel, $R$; e-/s.
        exposure: Time from first to last light, $2T$; s.
        throughput: Mean transmittance over the exposure, $\eta$; 1 if it is fully open.
    """
    rate, exposure = as_numpy(photon_rate, exposure)
    return rate * (throughput * exposure)


def filling_half_exposure(
    full_well: ArrayLike, photon_rate: ArrayLike, throughput: ArrayLike = 1.0
) -> Float[np.ndarray, "..."]:
    """Half exposure after which white fills a pixel, infinite without light; s, of any shape.

    Args:
        full_well: Electrons at which a pixel is full; e-.
        photon_rate: Photo-electrons a second at a white pixel; e-/s.
        throughput: Mean transmittance over the exposure.
    """
    rate = np.asarray(photon_rate, np.float64) * np.asarray(throughput, np.float64)
    with np.errstate(divide="ignore"):
        return np.asarray(np.asarray(full_well, np.float64) / (2 * rate))
