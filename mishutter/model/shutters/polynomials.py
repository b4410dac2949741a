"""One form for shutters of few pieces, so that programs which take it serve every kind."""

import math
from functools import lru_cache
from typing import Any, ClassVar, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.polynomial import chebyshev

from mishutter._core.checks import (
    all_concrete,
    as_array_like,
    device_constant,
    is_concrete,
    namespace_of,
)
from mishutter._core.compiling import compiled, is_tracing, outside_trace
from mishutter.model.shutters.base import (
    AbstractPiecewiseShutter,
    AbstractShutter,
    Cells,
    Offsets,
    Pieces,
    Sides,
    Values,
    looked_up,
    piecewise,
    polynomial,
    polynomial_means,
    within_exposure,
)

_NUM_PIECES, _DEGREE = 24, 9


@final
class PolynomialShutter(AbstractPiecewiseShutter):
    """A polynomial on each of 24 pieces."""

    ends: Array
    powers: Array
    panels_per_piece: ClassVar[int] = 1
    equal_pieces: ClassVar[bool] = False
    symmetric: ClassVar[bool] = False

    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        tau = jnp.asarray(tau, self.powers.dtype)
        return within_exposure(tau, self.within(tau))

    def within(self, tau: Any) -> Any:
        """Transmittance at times within the exposure; by NumPy of a known one at known times."""
        ends, powers = (as_array_like(tau, x) for x in (self.ends, self.powers))
        space = namespace_of(tau, ends, powers)
        piece = space.clip(space.searchsorted(ends, tau, side="right") - 1, 0, ends.size - 2)
        share = (tau - ends[piece]) / space.diff(ends)[piece] - 0.5
        value = polynomial([power[piece] for power in powers.T], share)
        return space.clip(value, 0, 1)

    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        return self.ends.astype(dtype)

    def piece_transmittance(self, offset: Offsets) -> Values:
        pieces = (slice(None),) + (None,) * (offset.ndim - 1)
        share = offset / self._lengths()[pieces] - 0.5
        return polynomial([power[pieces] for power in self.powers.T], share)

    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        length = looked_up(self._lengths(), piece)
        from_middle = distance / length - 0.5
        centre = jnp.where(from_left, from_middle, -from_middle)
        return polynomial_means(self.powers, piece, centre, width / length)

    def _lengths(self) -> Array:
        return jnp.diff(self.ends)

    def known_efficiency(self) -> float:
        """The efficiency, where it is known: exactly 1 of a shutter that is open throughout."""
        order = np.arange(self.powers.shape[1])[::-1]
        means = np.asarray(self.powers) @ np.where(order % 2, 0.0, 0.5**order / (order + 1))
        return math.fsum((np.diff(self.ends) * means).tolist()) / 2


def in_one_form(shutter: AbstractShutter, dtype: np.dtype) -> AbstractPiecewiseShutter:
    """The profile of a known shutter as polynomials, to rounding in a given precision.

    It returns the profile itself where 24 polynomials do not hold it, as of a flutter code or a
    narrow Gaussian, and while JAX traces a program of the package, where no number is known yet.
    """
    if isinstance(shutter, PolynomialShutter):
        return shutter
    profile = piecewise(shutter)
    if profile.evaluates_by_numpy and all_concrete(profile) and not is_tracing():
        with outside_trace():
            ends = np.asarray(profile.breakpoints(dtype))
        form = _interpolated(profile, ends)
    else:
        form = _interpolated_by_program(profile, dtype)
    if form is None or not (is_concrete(form[1]) and form[1]):
        return profile
    return form[0]


def profile_of(
    shutter: AbstractShutter, tau: Float[np.ndarray, "*times"]
) -> tuple[Float[np.ndarray, "*times"], float]:
    """Transmittance of a known shutter at times within the exposure, and its efficiency."""
    form = in_one_form(shutter, tau.dtype)
    if not isinstance(form, PolynomialShutter):
        transmittance, efficiency = _profile_of(shutter, tau)
        return np.asarray(transmittance), float(efficiency)
    return form.within(tau), form.known_efficiency()


@compiled
def _profile_of(shutter: AbstractShutter, tau: ArrayLike) -> tuple[Array, Array]:
    return shutter.transmittance(tau), shutter.efficiency()


@compiled
def _interpolated_by_program(
    profile: AbstractPiecewiseShutter, dtype: np.dtype
) -> tuple[PolynomialShutter, Array | np.bool_] | None:
    return _interpolated(profile, jnp.asarray(profile.breakpoints(dtype)))


def _interpolated(
    profile: AbstractPiecewiseShutter, ends: Float[Array | np.ndarray, "ends"]
) -> tuple[PolynomialShutter, Array | np.bool_] | None:
    """Interpolants between equal parts of the pieces, and whether they are exact to rounding."""
    space, num_pieces, dtype = namespace_of(ends), ends.size - 1, np.dtype(ends.dtype)
    if num_pieces > _NUM_PIECES:
        return None
    counts = _NUM_PIECES // num_pieces + (np.arange(num_pieces) < _NUM_PIECES % num_pieces)
    piece = np.repeat(np.arange(num_pieces), counts)
    part = np.concatenate([np.arange(count) for count in counts])
    begins = space.diff(ends)[piece] * (part / counts[piece]).astype(dtype)
    cuts = space.append(ends[piece] + begins, ends[-1])
    # From the start of the piece, as an exact difference: a cut is rounded.
    offset = cuts[:-1] - ends[piece]
    nodes, to_series, to_powers = (x.astype(dtype) for x in _interpolation())
    width = space.diff(cuts)
    offsets = offset[:, None] + width[:, None] * (nodes + 0.5)[None]
    every = profile.piece_transmittance(space.broadcast_to(offsets, (num_pieces, *offsets.shape)))
    values = every[piece, np.arange(_NUM_PIECES)].astype(dtype)
    middle = values[:, _DEGREE // 2, None]  # off which roundings of the sums are smaller
    series = (values - middle) @ to_series.T
    whole = space.concatenate([series[:, :1] + middle, series[:, 1:]], axis=1)
    powers = (whole @ to_powers.T)[:, ::-1]
    # The next term would be fifty times smaller than the last.
    converges = space.max(abs(series[:, -1])) <= 100 * float(np.finfo(dtype).eps)
    # Moments do not tell the crossings of a shorter piece apart.
    is_long = space.min(width) >= 1e-3
    if space is np:
        cuts, powers = device_constant((cuts, powers))
    return PolynomialShutter(cuts, powers), converges & is_long


@lru_cache
def _interpolation() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes about the middle of a piece; matrices from values to Chebyshev's series, to powers."""
    index = np.arange(_DEGREE + 1)
    nodes = np.cos(np.pi * (index + 0.5) / (_DEGREE + 1))
    to_series = chebyshev.chebvander(nodes, _DEGREE).T * (2 / (_DEGREE + 1))
    to_series[0] /= 2
    terms = [
        np.pad(chebyshev.cheb2poly(row[: k + 1]), (0, _DEGREE - k))
        for k, row in enumerate(np.eye(_DEGREE + 1))
    ]
    return nodes / 2, to_series, np.transpose(terms) * 2.0 ** index[:, None]
