"""The fixed windows of the field: rect, Hann, triangle, Gaussian, Tukey."""

import math
from fractions import Fraction
from functools import lru_cache
from typing import ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import (
    DoubleWord,
    as_float,
    common_dtype,
    is_concrete,
    require,
    require_scalar,
    two_sum,
)
from mishutter.model.shutters.base import (
    AbstractAdjustableShutter,
    AbstractPiecewiseShutter,
    uniform_breakpoints,
)
from mishutter.model.shutters.bernstein import economised, polynomial

_MIN_SIGMA, _MAX_SIGMA = 0.05, 5.0


@final
class RectShutter(AbstractPiecewiseShutter):
    r"""An ordinary shutter: $w(\tau) = 1$ on $[-1, 1]$."""

    panels_per_piece: ClassVar[int] = 1
    smooth_length: ClassVar[float] = 2.0
    equal_pieces: ClassVar[bool] = True
    symmetric: ClassVar[bool] = True

    def transmittance(self, tau: ArrayLike) -> Array:
        tau = as_float(tau)
        return _inside(tau, jnp.ones_like(tau))

    def dtype(self) -> np.dtype | None:
        return None

    def breakpoints(self, dtype: np.dtype) -> DoubleWord:
        return uniform_breakpoints(1, dtype)

    def piece_transmittance(self, offset: Array) -> Array:
        return jnp.ones_like(offset)

    def piece_mean(self, piece: Array, from_left: Array, distance: Array, width: Array) -> Array:
        return jnp.ones_like(width)


@final
class HannShutter(AbstractPiecewiseShutter):
    r"""$w(\tau) = \cos^2(\pi\tau/2)$."""

    panels_per_piece: ClassVar[int] = 2
    smooth_length: ClassVar[float] = 2.0
    equal_pieces: ClassVar[bool] = True
    symmetric: ClassVar[bool] = True

    def transmittance(self, tau: ArrayLike) -> Array:
        tau = as_float(tau)
        return _inside(tau, jnp.sin((jnp.pi / 2) * (1 - jnp.abs(tau))) ** 2)

    def dtype(self) -> np.dtype | None:
        return None

    def breakpoints(self, dtype: np.dtype) -> DoubleWord:
        return uniform_breakpoints(1, dtype)

    def piece_transmittance(self, offset: Array) -> Array:
        return jnp.sin((jnp.pi / 2) * offset) ** 2

    def piece_mean(self, piece: Array, from_left: Array, distance: Array, width: Array) -> Array:
        height = jnp.where(distance < 1, distance, 2 - distance)
        return _cosine_ramp_mean(height, 1 - height, width)


@final
class TriangleShutter(AbstractPiecewiseShutter):
    r"""$w(\tau) = 1 - |\tau|$."""

    panels_per_piece: ClassVar[int] = 1
    smooth_length: ClassVar[float] = 2.0
    equal_pieces: ClassVar[bool] = True
    symmetric: ClassVar[bool] = True

    def transmittance(self, tau: ArrayLike) -> Array:
        tau = as_float(tau)
        return _inside(tau, 1 - jnp.abs(tau))

    def dtype(self) -> np.dtype | None:
        return None

    def breakpoints(self, dtype: np.dtype) -> DoubleWord:
        return uniform_breakpoints(2, dtype)

    def piece_transmittance(self, offset: Array) -> Array:
        return jnp.stack([offset[0], 1 - offset[1]])

    def piece_mean(self, piece: Array, from_left: Array, distance: Array, width: Array) -> Array:
        return jnp.where((piece == 0) == from_left, distance, 1 - distance)


@final
class GaussianShutter(AbstractAdjustableShutter):
    r"""$w(\tau) = \exp(-\tau^2 / 2\sigma^2)$, cut off at $\pm 1$.

    Far out on a narrow profile a tap is as exact as time is: a rounding of time is worth
    $(\tau/\sigma)^2$ of them, and its relative error up to $3 (\tau/\sigma)^2$ units of the
    last place. That is of no matter in float64.

    Args:
        sigma: $\sigma$, in units of $\tau$; from 0.05 to 5.

    Raises:
        ValueError: if `sigma` is not a scalar in its range.
    """

    sigma: Array
    panels_per_piece: ClassVar[int] = 8
    equal_pieces: ClassVar[bool] = True
    symmetric: ClassVar[bool] = True
    linear: ClassVar[bool] = False

    def __init__(self, sigma: ArrayLike = 0.4):
        self.sigma = as_float(sigma, "GaussianShutter(sigma=...)")

    def __check_init__(self) -> None:
        subject = "GaussianShutter(sigma=...)"
        require_scalar(subject, self.sigma)
        if is_concrete(self.sigma):
            inside = _MIN_SIGMA * 0.999 <= float(self.sigma) <= _MAX_SIGMA * 1.0002
            require(inside, subject, f"lie in [{_MIN_SIGMA}, {_MAX_SIGMA}]", self.sigma)

    def transmittance(self, tau: ArrayLike) -> Array:
        tau = jnp.asarray(tau, common_dtype(self.sigma, tau))
        return _inside(tau, self._profile(tau))

    def _profile(self, tau: Array) -> Array:
        return jnp.exp(-((tau / self.sigma.astype(tau.dtype)) ** 2) / 2)

    @property
    def smooth_length(self) -> Array:
        return 3 * self.sigma

    def dtype(self) -> np.dtype | None:
        return np.dtype(self.sigma.dtype)

    def breakpoints(self, dtype: np.dtype) -> DoubleWord:
        return uniform_breakpoints(2, dtype)

    def piece_transmittance(self, offset: Array) -> Array:
        return self._profile(jnp.stack([1 - offset[0], offset[1]]))

    def piece_mean(self, piece: Array, from_left: Array, distance: Array, width: Array) -> Array:
        past_middle = jnp.where((piece == 0) == from_left, distance - 1, distance)
        from_middle = jnp.where(past_middle < 0, -past_middle, past_middle)
        return _gaussian_mean(from_middle, width / 2, self.sigma.astype(width.dtype))

    def box(self) -> Array:
        span = np.log(_MAX_SIGMA / _MIN_SIGMA)
        return jnp.clip(jnp.log(self.sigma / _MIN_SIGMA) / span, 0, 1)[None]

    def at(self, box: Array) -> "GaussianShutter":
        return GaussianShutter(_MIN_SIGMA * (_MAX_SIGMA / _MIN_SIGMA) ** box[0])


@final
class TukeyShutter(AbstractAdjustableShutter):
    r"""Flat with cosine ramps: 1 for $|\tau| \le 1 - \alpha$, then $\sin^2$ down to 0.

    Args:
        taper: $\alpha$, the share of the exposure spent in the two ramps: 0 is rect,
            1 is Hann.

    Raises:
        ValueError: if `taper` is not a scalar in [0, 1].
    """

    taper: Array
    panels_per_piece: ClassVar[int] = 1
    equal_pieces: ClassVar[bool] = False
    symmetric: ClassVar[bool] = True
    linear: ClassVar[bool] = False

    def __init__(self, taper: ArrayLike = 0.5):
        self.taper = as_float(taper, "TukeyShutter(taper=...)")

    def __check_init__(self) -> None:
        require_scalar("TukeyShutter(taper=...)", self.taper)
        if is_concrete(self.taper):
            inside = 0 <= float(self.taper) <= 1
            require(inside, "TukeyShutter(taper=...)", "lie in [0, 1]", self.taper)

    def transmittance(self, tau: ArrayLike) -> Array:
        tau = jnp.asarray(tau, common_dtype(self.taper, tau))
        depth = jnp.maximum(1 - jnp.abs(tau), 0)
        taper = self.taper.astype(tau.dtype)
        ramp = jnp.sin((jnp.pi / 2) * jnp.minimum(depth / _some(taper), 1)) ** 2
        return _inside(tau, jnp.where(depth >= taper, 1.0, ramp))

    @property
    def smooth_length(self) -> Array:
        return self.taper

    def dtype(self) -> np.dtype | None:
        return np.dtype(self.taper.dtype)

    def breakpoints(self, dtype: np.dtype) -> DoubleWord:
        taper = _some(self.taper.astype(dtype))
        # Not a constant: XLA would take (1 - taper) - 1 for -taper, rounding and all.
        one, zero = jnp.where(taper >= 0, 1.0, taper), jnp.zeros_like(taper)
        high, low = two_sum(one, -taper)
        return DoubleWord(jnp.stack([-one, -high, high, one]), jnp.stack([zero, -low, low, zero]))

    def piece_transmittance(self, offset: Array) -> Array:
        taper = _some(self.taper.astype(np.finfo(offset.dtype).dtype)).astype(offset.dtype)
        quarter_turn = jnp.pi / (2 * taper)
        return jnp.stack(
            [
                jnp.sin(quarter_turn * offset[0]) ** 2,
                jnp.ones_like(offset[1]),
                jnp.cos(quarter_turn * offset[2]) ** 2,
            ]
        )

    def piece_mean(self, piece: Array, from_left: Array, distance: Array, width: Array) -> Array:
        taper = _some(self.taper.astype(width.dtype))
        flat = piece == 1
        rising, rest = (piece == 0) == from_left, taper - distance
        height, depth = jnp.where(rising, distance, rest), jnp.where(rising, rest, distance)
        shares = (jnp.where(flat, 0.0, x / taper) for x in (height, depth, width))
        ramp = _cosine_ramp_mean(*shares)
        return jnp.where(flat, 1.0, ramp)

    def box(self) -> Array:
        return self.taper[None]

    def at(self, box: Array) -> "TukeyShutter":
        return TukeyShutter(box[0])


def _inside(tau: Array, value: Array) -> Array:
    return jnp.where(jnp.abs(tau) <= 1, value, jnp.zeros_like(value))


def _some(taper: Array) -> Array:
    """A taper of which there is some: no sum sees it, but places on its ramp are known.

    The derivative is that of the taper, so that at 0 it is that of the ramp that begins there.
    """
    least = float(np.finfo(np.dtype(taper.dtype)).tiny) ** 0.25
    return taper + jax.lax.stop_gradient(jnp.maximum(taper, least) - taper)


def _alternating(first: int) -> list[Fraction]:
    """Coefficients of sin(x)/x as a series in its square, from one of them on, to 50 digits."""
    return [Fraction((-1) ** k, math.factorial(2 * k + 1)) for k in range(first, first + 24)]


@lru_cache
def _sine_and_deficit() -> tuple[list[float], list[float]]:
    """Coefficients of sin(x)/x and of 1 - sin(x)/x by its square, for angles on a ramp.

    To a rounding, up to an eighth and a half of a turn. Their sums of fractions take a tenth of a
    second, which an import need not wait for.
    """
    sine = economised(_alternating(0), Fraction(5, 8), 6)
    return sine, economised([-c for c in _alternating(1)], Fraction(10), 9)


def _cosine_ramp_mean(centre: Array, from_top: Array, width: Array) -> Array:
    r"""Mean of $\sin^2(\pi v/2)$ over $c \pm d$, without cancellation; `from_top` is $1 - c$.

    $\frac12(1 - \operatorname{sinc} d\,\cos \pi c)
    = \frac12(1 - \operatorname{sinc} d) + \operatorname{sinc} d\,\sin^2(\pi c/2)$ for
    $c$ and $d$ in [0, 1], and the sine counted from the nearer end of the ramp, so that at
    either the slope keeps its digits as well. Both functions are polynomials: terms
    enough for the whole range compile to less than a library's sine.
    """
    sine, sinc_deficit = _sine_and_deficit()
    half = width / 2
    square = (jnp.pi * half) ** 2
    deficit = square * polynomial(sinc_deficit, square)
    high = centre > 0.5
    angle = (jnp.pi / 2) * jnp.where(high, from_top, centre)
    sine_square = (angle * polynomial(sine, angle**2)) ** 2
    return deficit / 2 + (1 - deficit) * jnp.where(high, 1 - sine_square, sine_square)


_NARROW = 0.4
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(7)


def _gaussian_mean(centre: Array, half: Array, sigma: Array) -> Array:
    """Mean of a Gaussian over `centre +- half`, `centre >= 0`, by width.

    Narrow intervals by Gauss-Legendre (all terms positive), wide ones by the error
    function, on the side where its complement does not cancel.
    """
    c, d = centre / sigma, half / sigma
    narrow = d * (1 + c) < _NARROW
    d_narrow = jnp.where(narrow, d, jnp.zeros_like(d))
    by_nodes = sum(
        (0.5 * weight) * jnp.exp(-((c + node * d_narrow) ** 2) / 2)
        for node, weight in zip(_NODES.tolist(), _WEIGHTS.tolist(), strict=True)
    )
    d_wide = jnp.where(narrow, jnp.full_like(d, _NARROW), d)
    root_two = math.sqrt(2)
    near, far = (c - d_wide) / root_two, (c + d_wide) / root_two
    one_sided = near > 0.5
    erf, erfc = jax.scipy.special.erf, jax.scipy.special.erfc
    difference = jnp.where(one_sided, erfc(near) - erfc(far), erf(far) - erf(near))
    by_error_function = difference * float(np.sqrt(np.pi / 8)) / d_wide
    return jnp.where(narrow, by_nodes, by_error_function)
