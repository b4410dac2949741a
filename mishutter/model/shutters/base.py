"""The interface of a shutter, and the one that the integrals take."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import (
    DoubleWord,
    as_float,
    common_dtype,
    compiled,
    fractions_as_words,
    require,
    require_finite,
)


class AbstractShutter(eqx.Module):
    r"""A transmittance $w(\tau)$ in $[0, 1]$ on $\tau = t/T \in [-1, 1]$, 0 outside.

    A shutter of one's own needs `transmittance`, `discontinuities` if it jumps or bends
    anywhere, and `bounds` if a search may move its parameters, which are its fields. It is
    integrated by interpolation between its discontinuities (see `SampledShutter`). One whose
    means over an interval are known in closed form derives from `AbstractPiecewiseShutter`
    instead.
    """

    @abstractmethod
    def transmittance(self, tau: ArrayLike) -> Array:
        r"""$w(\tau)$ at normalised times of any shape; same shape, in $[0, 1]$."""

    def discontinuities(self) -> Sequence[ArrayLike]:
        r"""Times $\tau$ at which $w$ jumps or bends, in any order; none by default.

        They may depend on parameters, and derivatives follow them.
        """
        return ()

    def bounds(self) -> Mapping[str, tuple[float, float]]:
        """Least and greatest value of each parameter that a search may move, by its name.

        A parameter is a field that holds a number or an array. None may move by default.
        """
        return {}

    def efficiency(self) -> Array:
        r"""Light let through, $\eta = \frac12 \int_{-1}^1 w(\tau)\,d\tau$; scalar."""
        from mishutter.model.shutters.interpolated import piecewise

        return integrated_transmittance(piecewise(self)) / 2


FEW_PIECES = 16
"""Unequal pieces that are looked at one by one; see `AbstractPiecewiseShutter.equal_pieces`."""


class AbstractPiecewiseShutter(AbstractShutter):
    """A shutter that is one analytic function between each two of its breakpoints.

    Offsets are distances from a piece's left end. Arrays carry the pieces, `n` of
    them, on their leading axis.
    """

    panels_per_piece: eqx.AbstractVar[int]
    """Equal parts of a piece on each of which `w` is all but a low polynomial."""

    smooth_length: eqx.AbstractVar[float | Array]
    r"""Time, in units of $\tau$, over which each piece's function is all but a low polynomial."""

    equal_pieces: eqx.AbstractVar[bool]
    """Whether the pieces are equally long. One of a few that are not may be all of the exposure;
    of more than `FEW_PIECES` none is longer than twice their mean."""

    symmetric: eqx.AbstractVar[bool]
    r"""Whether $w(-\tau) = w(\tau)$, whatever the parameters."""

    @abstractmethod
    def dtype(self) -> np.dtype | None:
        """Precision of the parameters; None for a shutter without any."""

    @abstractmethod
    def breakpoints(self, dtype: np.dtype) -> DoubleWord:
        """Ends of the pieces, ascending from -1 to 1; shape `(n + 1,)`."""

    @abstractmethod
    def piece_transmittance(self, offset: Array) -> Array:
        """Each piece's function at offsets, complex ones included; shape `(n, ...)`."""

    @abstractmethod
    def piece_mean(self, piece: Array, from_left: Array, distance: Array, width: Array) -> Array:
        """Mean of some pieces' functions over an interval.

        Args:
            piece: Which piece, from 0; integers of any shape.
            from_left: Which end of the piece the interval is counted from, the left one or
                the right one: one that is not much farther than the other, so that a profile
                that vanishes there keeps its relative accuracy; same shape.
            distance: Distance of the interval's centre from that end; same shape.
            width: Length of the interval; same shape.
        """


class AbstractAdjustableShutter(AbstractPiecewiseShutter):
    """A shutter whose profile a solver may move, by coordinates in a unit box."""

    linear: eqx.AbstractClassVar[bool]
    """Whether the transmittance is linear in the box coordinates."""

    @abstractmethod
    def box(self) -> Array:
        """Coordinates in `[0, 1]` of this profile; shape `(p,)`."""

    @abstractmethod
    def at(self, box: Array) -> "AbstractAdjustableShutter":
        """The shutter of the same kind at other coordinates."""


def is_adjustable(shutter: AbstractShutter) -> bool:
    """Whether a shutter has parameters that a search may move."""
    return isinstance(shutter, AbstractAdjustableShutter) or bool(shutter.bounds())


def coordinates(shutter: AbstractShutter) -> Array:
    """Coordinates of an adjustable profile in the unit box; shape `(p,)`.

    Raises:
        ValueError: if a bounded parameter is no number, or its bounds are not two that ascend.
    """
    if isinstance(shutter, AbstractAdjustableShutter):
        return shutter.box()
    shares = []
    for name, (value, low, high) in _bounded(shutter).items():
        require_finite(f"{type(shutter).__name__}({name}=...)", value)
        shares.append(jnp.ravel((value - low) / (high - low)))
    return jnp.concatenate(shares)


def at_coordinates(shutter: AbstractShutter, box: Array) -> AbstractShutter:
    """The shutter of the same kind at other coordinates of the unit box."""
    if isinstance(shutter, AbstractAdjustableShutter):
        return shutter.at(box)
    bounded, values, start = _bounded(shutter), [], 0
    for value, low, high in bounded.values():
        share = box[start : start + value.size].reshape(value.shape).astype(value.dtype)
        values.append(low + share * (high - low))
        start += value.size
    return eqx.tree_at(lambda x: [getattr(x, name) for name in bounded], shutter, values)


def _bounded(shutter: AbstractShutter) -> dict[str, tuple[Array, float, float]]:
    """Parameters that a search may move, with their bounds."""
    kind, found = type(shutter).__name__, {}
    for name, (low, high) in shutter.bounds().items():
        subject = f"{kind}.bounds()[{name!r}]"
        require(hasattr(shutter, name), subject, "be of a field of the shutter", name)
        require(
            -np.inf < low < high < np.inf, subject, "be two finite numbers that ascend", (low, high)
        )
        found[name] = (as_float(getattr(shutter, name), f"{kind}({name}=...)"), low, high)
    return found


@compiled
def profile_of(shutter: AbstractShutter, tau: ArrayLike) -> tuple[Array, Array]:
    """Transmittance at normalised times, and the efficiency; shape of `tau`, and scalar."""
    return shutter.transmittance(tau), shutter.efficiency()


def integrated_transmittance(shutter: AbstractPiecewiseShutter) -> Array:
    """Integral of the transmittance over its whole domain; scalar."""
    dtype = shutter.dtype() or common_dtype()
    ends = shutter.breakpoints(np.dtype(dtype))
    width = jnp.diff(ends.high) + jnp.diff(ends.low)
    piece = jnp.arange(width.size)
    return jnp.sum(width * shutter.piece_mean(piece, piece >= 0, width / 2, width))


@lru_cache
def uniform_fractions(num_pieces: int) -> tuple[Fraction, ...]:
    """Ends of equal pieces, from -1 to 1."""
    return tuple(Fraction(2 * j - num_pieces, num_pieces) for j in range(num_pieces + 1))


def uniform_breakpoints(num_pieces: int, dtype: np.dtype) -> DoubleWord:
    """Ends of equal pieces, exact to twice the precision: an edge of a chip is a jump."""
    return fractions_as_words(uniform_fractions(num_pieces), dtype)


@jax.custom_jvp
def within_unit(value: Array) -> Array:
    """Undo a last-digit excursion from [0, 1] and leave the derivative alone."""
    return jnp.clip(value, 0, 1)


@within_unit.defjvp
def _within_unit_jvp(primals, tangents):
    return within_unit(*primals), tangents[0]
