r"""Levels that a camera gives of a point or an edge, by the exact blur kernel.

The kernel is taken aligned at the vertex of the path, in taps of 1/8 px: there it is a smooth
function of the motion, and light is placed to 0.02 % of the brightest pixel. Light is spread
evenly over a tap, blurred by the lens, a Gaussian, and collected by pixels, all in closed form:
with $q'' = $ the Gaussian, a point's tap of width $\delta$ gives a pixel
$[q(x + 1) - q(x) - q(x + 1 - \delta) + q(x - \delta)]/\delta$ at distance $x$ from the tap's
beginning to the pixel's; an edge gives the same of $r$, $r' = q$.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter.blur import blur_kernel
from mishutter.model import ParabolicMotion, SplineShutter

FINE = 8
"""Taps of a pixel."""
MOVED = 2
"""Taps by which light is moved within a kernel at most."""
_SHARPEST = 1e-3
"""Standard deviation of the lens's Gaussian that stands for none; px."""
_REACH = 15.5
"""How far coefficients may leave [0, 1] and light is still linear in them."""


def kernels(
    coefficients: Array, acceleration: Array, half_exposure: Array, relative: Array, num_taps: int
) -> Array:
    r"""Kernels of a spline of any coefficients, in taps of 1/8 px; shape `(speeds, taps + 4)`.

    The first is two before the vertex.

    A profile $w$ that noise, or a step of the minimiser, takes out of [0, 1] is
    $(1 + 2r) w' - r$ of one, $w'$, inside.

    Args:
        coefficients: B-spline coefficients; shape `(n,)`.
        acceleration: $a$, px/s^2.
        half_exposure: $T$, s.
        relative: Speeds relative to the sensor at mid-exposure, $s - v$; px/s.
        num_taps: How many taps.
    """
    span = 1 + 2 * _REACH
    both = jnp.stack([(coefficients + _REACH) / span, jnp.ones_like(coefficients)])
    motion = ParabolicMotion(acceleration=acceleration * FINE, half_exposure=half_exposure)

    def one(parameters: Array, speed: Array) -> Array:
        return blur_kernel(SplineShutter(parameters), motion, speed=speed * FINE, num_taps=num_taps)

    of_shutters = jax.vmap(one, in_axes=(0, None))
    inside, opened = jnp.moveaxis(jax.vmap(of_shutters, in_axes=(None, 0))(both, relative), 1, 0)
    return _as_light_lies(span * inside - _REACH * opened)


def _as_light_lies(taps: Array) -> Array:
    r"""Taps of even light that have the moments of the light of the kernel, up to the fourth.

    Light is as dense as $g(x)/2\sqrt{x}$ about the vertex, and by far not spread evenly over the
    first taps. With $A_k$ and $c_k$ the integral and the centroid of $1/2\sqrt{x}$ in a tap, and
    $g$ linear about $c_k$, its moments about the tap's middle are
    $g_k\int x^p/2\sqrt{x}\,dx + g'_k\int (x - c_k)x^p/2\sqrt{x}\,dx$. Five neighbouring taps
    share its light so that they have these moments. The row begins so many taps before the
    vertex, and ends as many later, as light is moved.
    """
    k = np.arange(taps.shape[1], dtype=np.float64)[:, None]
    nodes, weights = np.polynomial.legendre.leggauss(6)  # exact of polynomials in sqrt(x)
    low, high = np.sqrt(k), np.sqrt(k + 1)
    weight = (high - low) / 2 * weights
    x = ((high + low) / 2 + (high - low) / 2 * nodes) ** 2 - (k + 0.5)
    area = np.sum(weight, axis=1)
    from_centroid = x - (np.sum(weight * x, axis=1) / area)[:, None]
    powers = np.arange(2 * MOVED + 1)
    moments, slopes = (
        np.einsum("kn,knp->kp", each, x[..., None] ** powers)
        for each in (weight / area[:, None], weight * from_centroid)
    )
    taken = np.arange(-MOVED, MOVED + 1)[None, :]
    power = powers[:, None] + 1
    even = ((taken + 0.5) ** power - (taken - 0.5) ** power) / power
    shares, moved = (
        jnp.asarray(np.linalg.solve(even, each.T), taps.dtype)[:, None]
        for each in (moments, slopes)
    )
    slope: Any = jnp.gradient(taps / jnp.asarray(area, taps.dtype)[None], axis=1)
    light = shares * taps[None] + moved * slope[None]
    moved_light = [
        jnp.pad(each, ((0, 0), (place, 2 * MOVED - place))) for place, each in enumerate(light)
    ]
    return jnp.sum(jnp.stack(moved_light), axis=0)


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
    # From the tap that begins last to the last pixel's end, in steps of a tap.
    index = np.arange(-num_taps - 1, (num_columns + 1) * FINE)
    x = jnp.asarray(index / FINE, begin.dtype)[None] - begin[:, None]
    width = jnp.sqrt(blur**2 + _SHARPEST**2)
    z = x / width
    share = (1 + jax.scipy.special.erf(z / np.sqrt(2))) / 2
    density = jnp.exp(-z * z / 2) / np.sqrt(2 * np.pi)
    point = x * share + width * density
    edge = ((x * x + width**2) * share + x * width * density) / 2
    spread = jnp.where(is_edge[:, None], edge, point)
    of_tap = (spread[:, 1:] - spread[:, :-1]) * FINE
    response = of_tap[:, FINE:] - of_tap[:, :-FINE]
    # Light that the DFT carries round falls on the first `num_taps` places, which no pixel takes.
    length = 1 << (response.shape[1] - 1).bit_length()
    spectrum = jnp.fft.rfft(response, length) * jnp.fft.rfft(taps, length)
    light = jnp.fft.irfft(spectrum, length)
    return light[:, num_taps : num_taps + num_columns * FINE : FINE]
