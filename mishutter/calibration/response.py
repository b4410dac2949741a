r"""Levels that a camera gives of a point or an edge, by the exact blur kernel.

The kernel is taken aligned at the vertex of the path, in taps of 1/8 px: there it is a smooth
function of the motion, and light is placed to 0.1 % of the brightest pixel. Light is spread
evenly over a tap, blurred by the lens, a Gaussian, and collected by pixels, all in closed form:
with $q'' = $ the Gaussian, a point's tap of width $\delta$ gives a pixel
$[q(x + 1) - q(x) - q(x + 1 - \delta) + q(x - \delta)]/\delta$ at distance $x$ from the tap's
beginning to the pixel's; an edge gives the same of $r$, $r' = q$.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter.blur import blur_kernel
from mishutter.model import ParabolicMotion, SplineShutter

FINE = 8
"""Taps of a pixel."""
_SHARPEST = 0.02
"""Standard deviation of the lens's Gaussian that stands for none; px."""


def kernels(
    coefficients: Array, acceleration: Array, half_exposure: Array, relative: Array, num_taps: int
) -> Array:
    r"""Kernels of a spline of any coefficients, in taps of 1/8 px; shape `(speeds, taps + 1)`.

    The first is one before the vertex.

    A profile $w$ that noise takes out of [0, 1] is $2 w' - 1/2$ of one, $w'$, inside.

    Args:
        coefficients: B-spline coefficients; shape `(n,)`.
        acceleration: $a$, px/s^2.
        half_exposure: $T$, s.
        relative: Speeds relative to the sensor at mid-exposure, $s - v$; px/s.
        num_taps: How many taps.
    """
    both = jnp.stack([(coefficients + 0.5) / 2, jnp.ones_like(coefficients)])
    motion = ParabolicMotion(acceleration=acceleration * FINE, half_exposure=half_exposure)

    def one(parameters: Array, speed: Array) -> Array:
        return blur_kernel(SplineShutter(parameters), motion, speed=speed * FINE, num_taps=num_taps)

    of_shutters = jax.vmap(one, in_axes=(0, None))
    inside, opened = jnp.moveaxis(jax.vmap(of_shutters, in_axes=(None, 0))(both, relative), 1, 0)
    return _about_their_centroids(2 * inside - opened / 2)


def _about_their_centroids(taps: Array) -> Array:
    r"""Taps of which each gives a share to the one before, which moves its light to its centroid.

    Light is as dense as $1/\sqrt{x}$ about the vertex, and by far not spread evenly over the first
    tap. The row begins one tap before the vertex.
    """
    k = np.arange(taps.shape[1], dtype=np.float64)
    centroid = ((k + 1) ** 1.5 - k**1.5) / (3 * (np.sqrt(k + 1) - np.sqrt(k)))
    given = taps * jnp.asarray(k + 0.5 - centroid, taps.dtype)[None]
    nothing = jnp.zeros_like(taps[:, :1])
    return jnp.concatenate([nothing, taps - given], 1) + jnp.concatenate([given, nothing], 1)


def collected(taps: Array, begin: Array, blur: Array, is_edge: Array, num_columns: int) -> Array:
    """Light that each pixel collects of a point's or an edge's kernels; shape `(s, columns)`.

    Args:
        taps: Shape `(s, taps)`.
        begin: Position of the first tap's beginning; px, shape `(s,)`.
        blur: Standard deviation of the lens's Gaussian; px.
        is_edge: Whether the target is an edge; shape `(s,)`.
        num_columns: Pixels, the first from 0 to 1 px.
    """
    num_taps = taps.shape[1]
    index = np.arange(-num_taps, num_columns * FINE)
    x = jnp.asarray(index / FINE, begin.dtype)[None] - begin[:, None]
    width = jnp.sqrt(blur**2 + _SHARPEST**2)

    def spread(x: Array) -> Array:
        z = x / width
        share = (1 + jax.scipy.special.erf(z / np.sqrt(2))) / 2
        density = jnp.exp(-z * z / 2) / np.sqrt(2 * np.pi)
        point = x * share + width * density
        edge = ((x * x + width**2) * share + x * width * density) / 2
        return jnp.where(is_edge[:, None], edge, point)

    step = 1 / FINE
    response = (spread(x + 1) - spread(x) - spread(x + 1 - step) + spread(x - step)) * FINE
    length = 1 << (2 * num_taps + num_columns * FINE).bit_length()
    spectrum = jnp.fft.rfft(response, length) * jnp.fft.rfft(taps, length)
    light = jnp.fft.irfft(spectrum, length)
    return light[:, num_taps : num_taps + num_columns * FINE : FINE]
