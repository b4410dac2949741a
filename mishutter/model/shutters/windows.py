"""The fixed windows of the field: rect, Hann, triangle, Gaussian, Tukey."""

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from typing import ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import (
    Alike,
    as_array_like,
    as_float,
    as_numpy,
    common_dtype,
    is_concrete,
    namespace_of,
    require,
    require_number,
    require_scalar,
)
from mishutter.model.shutters.base import (
    AbstractAdjustableShutter,
    AbstractPiecewiseShutter,
    Cells,
    Length,
    Offsets,
    Pieces,
    Sides,
    Values,
    above_zero,
    polynomial,
    uniform_breakpoints,
    within_exposure,
)

_MIN_SIGMA, _MAX_SIGMA = 0.05, 5.0


@final
class RectShutter(AbstractPiecewiseShutter):
    r"""An ordinary shutter: $w(\tau) = 1$ on $[-1, 1]$."""

    panels_per_piece: ClassVar[int] = 1
    equal_pieces: ClassVar[bool] = True
    symmetric: ClassVar[bool] = True
    evaluates_by_numpy: ClassVar[bool] = True

    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        tau = as_float(tau)
        return within_exposure(tau, jnp.ones_like(tau))

    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        return uniform_breakpoints(1, dtype)

    def piece_transmittance(self, offset: Offsets) -> Values:
        return namespace_of(offset).ones_like(offset)

    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        return jnp.ones_like(width)


@final
class HannShutter(AbstractPiecewiseShutter):
    r"""$w(\tau) = \cos^2(\pi\tau/2)$."""

    panels_per_piece: ClassVar[int] = 2
    equal_pieces: ClassVar[bool] = True
    symmetric: ClassVar[bool] = True
    evaluates_by_numpy: ClassVar[bool] = True

    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        tau = as_float(tau)
        return within_exposure(tau, jnp.sin((jnp.pi / 2) * (1 - jnp.abs(tau))) ** 2)

    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        return uniform_breakpoints(1, dtype)

    def piece_transmittance(self, offset: Offsets) -> Values:
        return namespace_of(offset).sin((np.pi / 2) * offset) ** 2

    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        height = jnp.where(distance < 1, distance, 2 - distance)
        return _cosine_ramp_mean(height, 1 - height, width)


@final
class TriangleShutter(AbstractPiecewiseShutter):
    r"""$w(\tau) = 1 - |\tau|$."""

    panels_per_piece: ClassVar[int] = 1
    equal_pieces: ClassVar[bool] = True
    symmetric: ClassVar[bool] = True
    evaluates_by_numpy: ClassVar[bool] = True

    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        tau = as_float(tau)
        return within_exposure(tau, 1 - jnp.abs(tau))

    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        return uniform_breakpoints(2, dtype)

    def piece_transmittance(self, offset: Offsets) -> Values:
        return namespace_of(offset).stack([offset[0], 1 - offset[1]])

    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        return jnp.where((piece == 0) == from_left, distance, 1 - distance)


@final
class GaussianShutter(AbstractAdjustableShutter):
    r"""$w(\tau) = \exp(-\tau^2 / 2\sigma^2)$, cut off at $\pm 1$.

    Args:
        sigma: $\sigma$, in units of $\tau$; from 0.05 to 5.

    Raises:
        ValueError: if `sigma` is not a scalar in its range.
    """

    sigma: Array
    panels_per_piece: ClassVar[int] = 8
    equal_pieces: ClassVar[bool] = True
    symmetric: ClassVar[bool] = True
    evaluates_by_numpy: ClassVar[bool] = True
    linear: ClassVar[bool] = False

    def __init__(self, sigma: ArrayLike = 0.4):
        self.sigma = as_float(sigma, "GaussianShutter(sigma=...)")

    def __check_init__(self) -> None:
        subject = "GaussianShutter(sigma=...)"
        require_scalar(subject, self.sigma)
        if is_concrete(self.sigma):
            inside = _MIN_SIGMA * 0.999 <= float(self.sigma) <= _MAX_SIGMA * 1.0002
            require(inside, subject, f"lie in [{_MIN_SIGMA}, {_MAX_SIGMA}]", self.sigma)

    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        tau = jnp.asarray(tau, common_dtype(self.sigma, tau))
        return within_exposure(tau, self._profile(tau))

    def _profile(self, tau: Alike) -> Alike:
        sigma = as_array_like(tau, self.sigma)
        return namespace_of(tau, sigma).exp(-((tau / sigma.astype(tau.dtype)) ** 2) / 2)

    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        return uniform_breakpoints(2, dtype)

    def piece_transmittance(self, offset: Offsets) -> Values:
        return self._profile(namespace_of(offset).stack([1 - offset[0], offset[1]]))

    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        past_middle = jnp.where((piece == 0) == from_left, distance - 1, distance)
        from_middle = jnp.where(past_middle < 0, -past_middle, past_middle)
        return _gaussian_mean(from_middle, width / 2, self.sigma.astype(width.dtype))

    def box(self) -> Float[Array, "p"]:
        span = np.log(_MAX_SIGMA / _MIN_SIGMA)
        return jnp.clip(jnp.log(self.sigma / _MIN_SIGMA) / span, 0, 1)[None]

    def at(self, box: Float[Array, "p"]) -> "GaussianShutter":
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
    evaluates_by_numpy: ClassVar[bool] = True
    linear: ClassVar[bool] = False

    def __init__(self, taper: ArrayLike = 0.5):
        self.taper = as_float(taper, "TukeyShutter(taper=...)")

    def __check_init__(self) -> None:
        require_number("TukeyShutter(taper=...)", self.taper, "from 0 to 1", most=1.0)

    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        tau = jnp.asarray(tau, common_dtype(self.taper, tau))
        depth = jnp.maximum(1 - jnp.abs(tau), 0)
        taper = self.taper.astype(tau.dtype)
        ramp = jnp.sin((jnp.pi / 2) * jnp.minimum(depth / above_zero(taper), 1)) ** 2
        return within_exposure(tau, jnp.where(depth >= taper, 1.0, ramp))

    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        (taper,) = as_numpy(self.taper)
        space, taper = namespace_of(taper), _whole_roundings(taper.astype(dtype))
        one = space.ones_like(taper)
        return as_float(space.stack([-one, taper - one, one - taper, one]))

    def piece_transmittance(self, offset: Offsets) -> Values:
        taper = as_array_like(offset, self.taper).astype(np.finfo(offset.dtype).dtype)
        space, taper = namespace_of(offset, taper), _whole_roundings(taper).astype(offset.dtype)
        quarter_turn = np.pi / (2 * taper)
        rising, falling = (quarter_turn * offset[piece] for piece in (0, 2))
        flat = space.ones_like(offset[1])
        return space.stack([space.sin(rising) ** 2, flat, space.cos(falling) ** 2])

    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        taper = _whole_roundings(self.taper.astype(width.dtype))
        flat = piece == 1
        rising, rest = (piece == 0) == from_left, taper - distance
        height, depth = jnp.where(rising, distance, rest), jnp.where(rising, rest, distance)
        shares = (jnp.where(flat, 0.0, x / taper) for x in (height, depth, width))
        ramp = _cosine_ramp_mean(*shares)
        return jnp.where(flat, 1.0, ramp)

    def box(self) -> Float[Array, "p"]:
        return self.taper[None]

    def at(self, box: Float[Array, "p"]) -> "TukeyShutter":
        return TukeyShutter(box[0])


def _whole_roundings(length: Length) -> Length:
    """A length of time of whole roundings of 1, one at least, with the derivative of the length.

    Its distance from an end of the exposure is exact: a ramp is as long as its breakpoints say.
    """
    rounding = np.finfo(np.dtype(length.dtype)).eps
    if isinstance(length, np.ndarray):
        return np.asarray(np.maximum(np.round(length / rounding), 1) * rounding)
    whole = jnp.maximum(jnp.round(length / rounding), 1) * rounding
    return length + jax.lax.stop_gradient(whole - length)


def _sinc_series(first: int) -> list[Fraction]:
    """Coefficients of sin(x)/x by powers of x squared, from the power `first` on, to 50 digits."""
    return [Fraction((-1) ** k, math.factorial(2 * k + 1)) for k in range(first, first + 24)]


@lru_cache
def _sine_and_deficit() -> tuple[list[float], list[float]]:
    """Coefficients of sin(x)/x and of 1 - sin(x)/x by its square, for angles on a ramp.

    To a rounding, up to an eighth and a half of a turn. Their sums of fractions take a tenth of a
    second, which an import need not wait for.
    """
    sine = _economised(_sinc_series(0), Fraction(5, 8), 6)
    return sine, _economised([-c for c in _sinc_series(1)], Fraction(10), 9)


def _economised(taylor: Sequence[Fraction], reach: Fraction, degree: int) -> list[float]:
    """A Taylor polynomial with fewer terms on `[0, reach]`, the highest first.

    Each step removes the last term by a multiple of Chebyshev's polynomial, so that the terms
    before it make up for it as well as they can (Lanczos).
    """
    series = list(taylor)
    chebyshev = [[Fraction(1)], [Fraction(-1), 2 / reach]]
    while len(chebyshev) < len(series):
        before, last = [*chebyshev[-2], 0, 0], chebyshev[-1]
        longer = zip([0, *last], [*last, 0], before, strict=True)
        chebyshev.append([4 / reach * c - 2 * d - e for c, d, e in longer])
    while len(series) - 1 > degree:
        highest = chebyshev[len(series) - 1]
        share = series[-1] / highest[-1]
        series = [x - share * y for x, y in zip(series, highest, strict=True)][:-1]
    return [float(x) for x in reversed(series)]


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
"""Half width below which a Gaussian's mean is a series: $d(1 + c)$, in standard deviations."""


@lru_cache
def _narrow_terms() -> list[list[float]]:
    r"""Coefficients of a Gaussian's narrow mean, over its value in the middle.

    $\frac12\int_{-1}^1 e^{-cdn - d^2n^2/2}\,dn$ by powers of $d^2$, of each by powers of $(cd)^2$,
    the highest first. Terms below a rounding wherever $d(1 + c)$ is below `_NARROW` are left out.
    """

    def term(k: int, j: int) -> float:
        return (-0.5) ** k / (math.factorial(k) * math.factorial(2 * j) * (2 * (j + k) + 1))

    def largest(k: int, j: int) -> float:
        both = max(j + k, 1)
        return abs(term(k, j)) * (_NARROW * j / both) ** (2 * j) * (_NARROW * k / both) ** (2 * k)

    powers, least = range(8, -1, -1), 2e-17  # a tenth of a rounding in float64
    return [[term(k, j) for j in powers if largest(k, j) > least] for k in powers]


def _gaussian_mean(centre: Array, half: Array, sigma: Array) -> Array:
    r"""Mean of a Gaussian over `centre +- half`, `centre >= 0`, by width.

    Narrow intervals by a series about their middle, whose terms hardly cancel; wide ones by the
    complement of the error function, whose values at their ends differ enough not to.
    """
    c, d = centre / sigma, half / sigma
    narrow = d * (1 + c) < _NARROW
    d_narrow = jnp.where(narrow, d, jnp.zeros_like(d))
    square = (jnp.where(narrow, c, jnp.zeros_like(c)) * d_narrow) ** 2
    powers = [polynomial(row, square) for row in _narrow_terms()]
    by_series = jnp.exp(-(c**2) / 2) * polynomial(powers, d_narrow**2)
    d_wide = jnp.where(narrow, jnp.full_like(d, _NARROW), d)
    near, far = ((c + side) / math.sqrt(2) for side in (-d_wide, d_wide))
    fall = jax.scipy.special.erfc(near) - jax.scipy.special.erfc(far)
    return jnp.where(narrow, by_series, fall * math.sqrt(math.pi / 8) / d_wide)
