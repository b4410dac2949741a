"""Any other shutter, interpolated piece by piece so that the integrals can use it."""

from functools import lru_cache
from typing import ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import Bare, DoubleWord, all_concrete, common_dtype, require, shape_of
from mishutter.model.shutters.base import (
    AbstractPiecewiseShutter,
    AbstractShutter,
    uniform_breakpoints,
)
from mishutter.model.shutters.bernstein import (
    bernstein_from_values,
    bernstein_mean,
    bernstein_value,
    expand,
    power_matrix,
    split_control,
)

_NUM_PIECES, _DEGREE = 64, 5
_UNIFORM = np.linspace(-1, 1, _NUM_PIECES + 1)
_interpolation = lru_cache(bernstein_from_values)

_PROBES = np.linspace(0, 1, 25)
"""Shares of a piece at which an interpolant is held against its shutter."""
_MISFIT = 1e-6
"""Misfit of a smooth profile; a bend by a slope of 1 half way through a piece leaves 3e-3."""
_SHORT = 1e-7
"""Length of a piece that holds too little light for its misfit to matter."""


@final
class SampledShutter(AbstractPiecewiseShutter):
    r"""Another shutter by its degree-5 interpolants between 65 equal times and its discontinuities.

    Its transmittance differs from the original's by at most
    $\max|w^{(6)}| / (64^6 \cdot 2^5 \cdot 6!)$ where that is smooth: 3e-13 for a Hann
    profile. No interpolant looks across a discontinuity that the shutter declares.

    Args:
        shutter: The shutter to interpolate.
    """

    shutter: AbstractShutter
    panels_per_piece: ClassVar[int] = 1
    smooth_length: ClassVar[float] = 2.0
    equal_pieces: ClassVar[bool] = False
    symmetric: ClassVar[bool] = False

    def transmittance(self, tau: ArrayLike) -> Array:
        return self.shutter.transmittance(tau)

    def dtype(self) -> np.dtype | None:
        arrays = [x for x in jax.tree.leaves(self.shutter) if hasattr(x, "dtype")]
        return np.dtype(arrays[0].dtype) if arrays else None

    def breakpoints(self, dtype: np.dtype) -> DoubleWord:
        uniform, places = uniform_breakpoints(_NUM_PIECES, dtype), self.shutter.discontinuities()
        if not len(places):
            return uniform
        declared = jnp.stack([jnp.asarray(x, dtype) for x in places])
        # A selection in place of a clip, which halves the derivative at its ends.
        declared = jnp.where(declared < -1, -1.0, jnp.where(declared > 1, 1.0, declared))
        # A time that all but coincides with a declared one moves with it: no rounding decides
        # at which of the two the jump counts.
        apart = jnp.abs(uniform.high[:, None] - declared[None])
        same = apart <= 64 * jnp.finfo(dtype).eps
        own = jnp.where(same.any(axis=1), declared[jnp.argmax(same, axis=1)], uniform.high)
        high = jnp.concatenate([own, declared])
        order = jnp.argsort(jax.lax.stop_gradient(high))
        low = jnp.concatenate([uniform.low, jnp.zeros_like(declared)])
        return DoubleWord(high[order], low[order])

    def piece_transmittance(self, offset: Array) -> Array:
        dtype = np.finfo(offset.dtype).dtype
        scale = self._scale(dtype).reshape(-1, *(1,) * (offset.ndim - 1))
        share = offset * scale.astype(offset.dtype)
        return bernstein_value(expand(split_control(self._control(dtype)), share), share)

    def piece_mean(self, piece: Array, from_left: Array, distance: Array, width: Array) -> Array:
        scale = self._scale(width.dtype)[piece]
        control = self._control(width.dtype)
        return bernstein_mean(control, piece, from_left, distance * scale, width * scale)

    def _scale(self, dtype: np.dtype) -> Array:
        """Shares of a piece that a unit of time is; 0 of a piece of no length."""
        length = jnp.diff(self.breakpoints(dtype).high)
        some = length > 0
        return jnp.where(some, 1 / jnp.where(some, length, 1.0), 0.0)

    def _control(self, dtype: np.dtype) -> Array:
        nodes, to_control = _interpolation(_DEGREE)
        ends = self.breakpoints(dtype).high
        tau = ends[:-1, None] + jnp.diff(ends)[:, None] * jnp.asarray(nodes, dtype)[None]
        values = self.shutter.transmittance(tau)
        if not jnp.issubdtype(values.dtype, jnp.floating):  # open and closed as 1 and 0
            values = values.astype(dtype)
        return (values @ jnp.asarray(to_control.T, values.dtype)).astype(dtype)


def piecewise(shutter: AbstractShutter) -> AbstractPiecewiseShutter:
    """`shutter` itself if it is known piece by piece, its interpolant if not.

    Raises:
        ValueError: if it is no shutter, or one that is interpolated, and not traced, is not a
            transmittance.
    """
    require(isinstance(shutter, AbstractShutter), "shutter", "be a shutter", shutter)
    if isinstance(shutter, AbstractPiecewiseShutter):
        return shutter
    if all_concrete(shutter):
        _check_transmittance(shutter)
    return SampledShutter(shutter)


def _check_transmittance(shutter: AbstractShutter) -> None:
    subject = f"{type(shutter).__name__}.transmittance"
    try:
        jax.eval_shape(shutter.transmittance, _UNIFORM)
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError) as error:
        requirement = "be made of functions that JAX can trace, as those of `jax.numpy`"
        require(False, subject, requirement, Bare(type(error).__name__))
    with jax.ensure_compile_time_eval():
        found = np.asarray(shutter.transmittance(jnp.asarray(_UNIFORM)))
    alike = found.shape == _UNIFORM.shape
    require(alike, subject, "have the shape of its argument", shape_of(found))
    require(np.isrealobj(found), subject, "be real", Bare(found.dtype))
    light = found[np.argmax(np.abs(np.where(np.isnan(found), np.inf, found - 0.5)))]
    rounding = 16 * float(np.finfo(common_dtype(found)).eps)
    require(bool(-rounding <= light <= 1 + rounding), subject, "lie in [0, 1]", light)
    _check_discontinuities(shutter, subject)


def _check_discontinuities(shutter: AbstractShutter, subject: str) -> None:
    """Refuse a jump or bend that is not declared: interpolants would smooth it.

    They are held against the shutter near both ends of each piece and in between. A shutter
    without parameters may jump where pieces meet anyway, as it does not move there.
    """
    places = [np.asarray(x) for x in shutter.discontinuities()]
    for place in places:
        finite = place.shape == () and np.isrealobj(place) and bool(np.isfinite(place))
        require(finite, f"{type(shutter).__name__}.discontinuities()", "be finite numbers", place)
    dtype = np.dtype(SampledShutter(shutter).dtype() or common_dtype())
    declared = np.clip(np.array(places, dtype), -1, 1)
    ends = np.sort(np.concatenate([_UNIFORM.astype(dtype), declared]))
    length = np.diff(ends)[:, None]
    nodes, to_control = _interpolation(_DEGREE)
    share = np.concatenate([nodes, _PROBES]).astype(dtype)[None]
    beside = 64 * np.finfo(dtype).eps  # of a jump, where its own rounding does not reach
    tau = np.clip(
        ends[:-1, None] + length * share, ends[:-1, None] + beside, ends[1:, None] - beside
    )
    with jax.ensure_compile_time_eval():
        values = np.asarray(shutter.transmittance(jnp.asarray(tau)), np.float64)
    control = values[:, : nodes.size] @ to_control.T
    powers = np.vander(_PROBES, _DEGREE + 1, increasing=True)
    fitted = control @ power_matrix(_DEGREE) @ powers.T
    error = np.where(length > _SHORT, np.abs(fitted - values[:, nodes.size :]), 0.0)
    worst = np.unravel_index(np.argmax(error), error.shape)
    requirement = "be smooth but for where its `discontinuities()` say that it jumps or bends"
    allowed = max(_MISFIT, 64 * float(np.finfo(dtype).eps))
    at = float(tau[:, nodes.size :][worst])
    got = Bare(f"a jump, a bend or a curve too steep to follow near tau = {at:.4g}")
    require(bool(error[worst] <= allowed), subject, requirement, got)
    if jax.tree.leaves(shutter):
        gap = np.abs(ends[1:-1, None] - np.append(declared, np.inf)[None]).min(axis=1)
        step = np.where(gap < _SHORT, 0.0, np.abs(fitted[1:, 0] - fitted[:-1, -1]))
        at = float(ends[1:-1][np.argmax(step)])
        require(
            float(step.max()) <= allowed, subject, requirement, Bare(f"a jump at tau = {at:.4g}")
        )
