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
    split_control,
)

_NUM_PIECES, _DEGREE = 64, 5
_interpolation = lru_cache(bernstein_from_values)


@final
class SampledShutter(AbstractPiecewiseShutter):
    r"""Another shutter by its degree-5 interpolant on 64 equal pieces.

    Its transmittance differs from the original's by at most
    $\max|w^{(6)}| / (64^6 \cdot 2^5 \cdot 6!)$ where that is smooth: 3e-13 for a Hann
    profile. At a kink or jump inside a piece it is a fit, no more.

    Args:
        shutter: The shutter to interpolate.
    """

    shutter: AbstractShutter
    panels_per_piece: ClassVar[int] = 1
    smooth_length: ClassVar[float] = 2.0
    equal_pieces: ClassVar[bool] = True
    symmetric: ClassVar[bool] = False

    def transmittance(self, tau: ArrayLike) -> Array:
        return self.shutter.transmittance(tau)

    def dtype(self) -> np.dtype | None:
        arrays = [x for x in jax.tree.leaves(self.shutter) if hasattr(x, "dtype")]
        return np.dtype(arrays[0].dtype) if arrays else None

    def breakpoints(self, dtype: np.dtype) -> DoubleWord:
        return uniform_breakpoints(_NUM_PIECES, dtype)

    def piece_transmittance(self, offset: Array) -> Array:
        share = offset * (_NUM_PIECES / 2)
        return bernstein_value(
            expand(split_control(self._control(offset.real.dtype)), share), share
        )

    def piece_mean(self, piece: Array, from_left: Array, distance: Array, width: Array) -> Array:
        scale = _NUM_PIECES / 2
        control = self._control(width.dtype)
        return bernstein_mean(control, piece, from_left, distance * scale, width * scale)

    def _control(self, dtype: np.dtype) -> Array:
        nodes, to_control = _interpolation(_DEGREE)
        left = np.linspace(-1, 1, _NUM_PIECES + 1)[:-1, None]
        tau = jnp.asarray(left + nodes * (2 / _NUM_PIECES), dtype)
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
    tau, subject = np.linspace(-1, 1, _NUM_PIECES + 1), f"{type(shutter).__name__}.transmittance"
    try:
        jax.eval_shape(shutter.transmittance, tau)
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError) as error:
        requirement = "be made of functions that JAX can trace, as those of `jax.numpy`"
        require(False, subject, requirement, Bare(type(error).__name__))
    with jax.ensure_compile_time_eval():
        found = np.asarray(shutter.transmittance(jnp.asarray(tau)))
    alike = found.shape == tau.shape
    require(alike, subject, "have the shape of its argument", shape_of(found))
    require(np.isrealobj(found), subject, "be real", Bare(found.dtype))
    light = found[np.argmax(np.abs(np.where(np.isnan(found), np.inf, found - 0.5)))]
    rounding = 16 * float(np.finfo(common_dtype(found)).eps)
    require(bool(-rounding <= light <= 1 + rounding), subject, "lie in [0, 1]", light)
