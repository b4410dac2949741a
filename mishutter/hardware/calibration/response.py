r"""Irradiance that a point or an edge leaves on each pixel of a camera, by the exact blur kernel.

The kernel is aligned at the vertex of the path, where it is a smooth function of the motion, and
has taps of 1/8 px. Its irradiance is uniform over a tap, blurred by the lens, a Gaussian, and
integrated over pixels, all in closed form. Points and edges are not band-limited, so that the
responses of a capture, which stand on the grid of a DFT, do not serve here. With $q'' = $ the
Gaussian, a point's tap of width $\delta$ gives a pixel
$[q(x + 1) - q(x) - q(x + 1 - \delta) + q(x - \delta)]/\delta$ at distance $x$ from the tap's
beginning to the pixel's; an edge gives the same of $r$, $r' = q$.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from mishutter.blur.kernel import blur_kernel
from mishutter.model.motion import ParabolicMotion
from mishutter.model.shutters.spline import SplineShutter

FINE = 8
"""Taps of a pixel."""
MOVED = 2
"""Taps to either side over which a kernel's tap is spread."""
_REACH = 15.5
"""Distance by which coefficients may leave [0, 1] while kernels stay linear in them."""


def kernels(
    coefficients: Float[Array, "n"],
    acceleration: Float[Array, ""],
    half_exposure: ArrayLike,
    relative: Float[Array, "speeds"],  # px/s
    num_taps: int,
) -> Float[Array, "speeds {num_taps}+4"]:
    r"""Kernels of a spline of any coefficients, in taps of 1/8 px.

    The first tap lies two before the vertex. Noise, or a step of the minimiser, may take a
    profile $w$ out of [0, 1]. It then is $(1 + 2r) w' - r$ with a profile $w'$ inside, and its
    kernel is the same combination of the kernels of $w'$ and of an open shutter.
    """
    span = 1 + 2 * _REACH
    profiles = jnp.stack([(coefficients + _REACH) / span, jnp.ones_like(coefficients)])
    motion = ParabolicMotion(acceleration=acceleration * FINE, half_exposure=half_exposure)

    def one(parameters: Array, speed: Array) -> Array:
        return blur_kernel(SplineShutter(parameters), motion, speed=speed * FINE, num_taps=num_taps)

    by_profile = jax.vmap(one, in_axes=(0, None))
    taps = jax.vmap(by_profile, in_axes=(None, 0))(profiles, relative)
    inside, opened = jnp.moveaxis(taps, 1, 0)
    return _with_moments(span * inside - _REACH * opened)


def _with_moments(taps: Array) -> Array:
    r"""Taps of uniform irradiance with the moments of the kernel within each tap, up to the fourth.

    The irradiance is $g(x)/2\sqrt{x}$ at a distance $x$ from the vertex, and far from uniform over
    the first taps. With $c_k$ the centroid of $1/2\sqrt{x}$ in a tap, and $g$ linear about
    $c_k$, its moments about the tap's middle are
    $g_k\int x^p/2\sqrt{x}\,dx + g'_k\int (x - c_k)x^p/2\sqrt{x}\,dx$. Each tap is divided
    among itself and two neighbours to either side, so that the five have these moments. The
    result begins two taps before the vertex, and ends two later than `taps`.
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
    neighbours = np.arange(-MOVED, MOVED + 1)[None, :]
    power = powers[:, None] + 1
    uniform = ((neighbours + 0.5) ** power - (neighbours - 0.5) ** power) / power
    of_value, of_slope = (
        jnp.asarray(np.linalg.solve(uniform, each.T), taps.dtype)[:, None]
        for each in (moments, slopes)
    )
    slope = jnp.asarray(jnp.gradient(taps / jnp.asarray(area, taps.dtype)[None], axis=1))
    shares = of_value * taps[None] + of_slope * slope[None]
    shifted = [
        jnp.pad(share, ((0, 0), (place, 2 * MOVED - place))) for place, share in enumerate(shares)
    ]
    return jnp.sum(jnp.stack(shifted), axis=0)


def collected(
    taps: Float[Array, "s taps"],
    begin: Float[Array, "s"],  # px
    blur: Float[Array, ""],  # px
    is_edge: Bool[Array | np.ndarray, "s"],
    num_columns: int,
) -> Float[Array, "s {num_columns}"]:
    """Irradiance that each pixel integrates, of points or edges."""
    num_taps = taps.shape[1]
    # Distances, in steps of a tap, from the last tap's beginning to the last pixel's end.
    index = np.arange(-num_taps - 1, (num_columns + 1) * FINE)
    x = jnp.asarray(index / FINE, begin.dtype)[None] - begin[:, None]
    width = jnp.sqrt(blur**2 + 1e-3**2)  # above 0, also of a lens without blur
    z = x / width
    distribution = (1 + jax.scipy.special.erf(z / np.sqrt(2))) / 2
    density = jnp.exp(-z * z / 2) / np.sqrt(2 * np.pi)
    point = x * distribution + width * density  # q of the module's docstring
    edge = ((x * x + width**2) * distribution + x * width * density) / 2  # r, its integral
    integral = jnp.where(is_edge[:, None], edge, point)
    over_tap = (integral[:, 1:] - integral[:, :-1]) * FINE
    response = over_tap[:, FINE:] - over_tap[:, :-FINE]
    # The DFT wraps round onto the first `num_taps` places, which belong to no pixel.
    length = 1 << (response.shape[1] - 1).bit_length()
    spectrum = jnp.fft.rfft(response, length) * jnp.fft.rfft(taps, length)
    irradiance = jnp.fft.irfft(spectrum, length)
    return irradiance[:, num_taps : num_taps + num_columns * FINE : FINE]
