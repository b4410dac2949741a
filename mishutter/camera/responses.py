r"""Responses of open frames on the grid of a DFT, along one axis or in the plane.

From the middle of the frames on a thing is displaced on the sensor by
$\mathbf x(t) - \mathbf v\,t$. A frame passes
$\operatorname{sinc} f_x\,\operatorname{sinc} f_y\,O(\mathbf f)$ times the mean of
$e^{-2\pi i\,\mathbf f\cdot(\mathbf x(t) - \mathbf v\,t)}$ over its exposure. One axis is a picture
whose power lies along one line.
"""

from functools import reduce

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import DTypeLike

from mishutter.blur.waves import waves_in_plane, waves_on_dft
from mishutter.evaluation.instants import Instants
from mishutter.model.optics import NYQUIST_FREQUENCY, Optics, lens_response


def frequencies_on(shape: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    """Frequencies of half of a DFT, cycles/px: down the columns, then along the rows.

    Of a DFT along rows there are those along them alone. They broadcast against one another.
    """
    *down, across = shape
    each = [*map(np.fft.fftfreq, down), np.fft.rfftfreq(across)]
    return tuple(np.meshgrid(*each, indexing="ij", sparse=True))


def aperture_on(optics: Optics, shape: tuple[int, ...], size: int = 1) -> Float[np.ndarray, "*k"]:
    """Response of a pixel of some size behind the lens, on the grid of a DFT of such pixels."""
    each = frequencies_on(shape)
    radius = reduce(np.hypot, each) / size
    cutoff = float(optics.cutoff_frequency)
    lens = lens_response(radius, float(optics.lens_blur))
    if cutoff < NYQUIST_FREQUENCY:
        lens = np.where(radius <= cutoff * (1 + 1e-12), lens, 0.0)
    return reduce(np.multiply, map(np.sinc, each)) * lens


def waves_of(
    instants: Instants,
    velocities: Float[np.ndarray, "s axes"],
    shape: tuple[int, ...],
    dtype: DTypeLike = np.float64,
) -> Complex[np.ndarray, "n s *k"]:
    """Responses of points at some velocities, displacements included; but for the `aperture_on`."""
    time, weight = instants.time[:, None], instants.weight[:, None]
    displaced = instants.place[:, :, None] - velocities.T[:, None, :, None] * time
    each = zip(np.moveaxis(displaced.astype(dtype), 1, 0), weight, strict=True)
    if len(shape) == 1:
        return np.stack([waves_on_dft(x[0], w, *shape, shape[0] // 2 + 1) for x, w in each])
    return np.stack([waves_in_plane(x, w, frequencies_on(shape)) for x, w in each])
