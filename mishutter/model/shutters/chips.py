"""Piecewise constant shutters, among them Raskar's flutter code."""

from typing import ClassVar, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import (
    RowLike,
    as_array_like,
    as_float,
    common_dtype,
    namespace_of,
    require,
    require_at_least,
    shape_of,
)
from mishutter.model.shutters.base import (
    AbstractAdjustableShutter,
    Cells,
    Offsets,
    Pieces,
    Sides,
    Values,
    uniform_breakpoints,
    within_exposure,
)

RASKAR_CODE = tuple(map(float, "1010000111000001010000110011110111010111001001100111"))
"""The 52 chips of Raskar, Agrawal and Tumblin's coded exposure (2006), 26 of them open."""


@final
class ChippedShutter(AbstractAdjustableShutter):
    """Equal chips over the exposure, each of constant transmittance.

    Args:
        transmittances: One value in [0, 1] a chip, in time order; shape `(n,)`.

    Raises:
        ValueError: if there is no chip or a value is out of its range.
    """

    transmittances: Array
    panels_per_piece: ClassVar[int] = 1
    equal_pieces: ClassVar[bool] = True
    symmetric: ClassVar[bool] = False
    evaluates_by_numpy: ClassVar[bool] = True
    linear: ClassVar[bool] = True

    def __init__(self, transmittances: RowLike):
        self.transmittances = as_float(transmittances, "ChippedShutter(transmittances=...)")

    def __check_init__(self) -> None:
        subject, chips = "ChippedShutter(transmittances=...)", self.transmittances
        one_row = chips.ndim == 1 and chips.size >= 1
        require(one_row, subject, "be one row of at least one chip", shape_of(chips))
        require_at_least(subject, chips, "from 0 to 1", most=1.0)

    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        tau = jnp.asarray(tau, common_dtype(self.transmittances, tau))
        count = self.transmittances.size
        ends = uniform_breakpoints(count, np.dtype(tau.dtype))
        chip = jnp.clip(jnp.searchsorted(ends, tau, side="right") - 1, 0, count - 1)
        value = self.transmittances.astype(tau.dtype)[chip]
        return within_exposure(tau, value)

    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        return uniform_breakpoints(self.transmittances.size, dtype)

    def piece_transmittance(self, offset: Offsets) -> Values:
        chips = as_array_like(offset, self.transmittances).reshape((-1,) + (1,) * (offset.ndim - 1))
        return namespace_of(chips).broadcast_to(chips, offset.shape).astype(offset.dtype)

    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        return self.transmittances.astype(width.dtype)[piece]

    def box(self) -> Float[Array, "p"]:
        return self.transmittances

    def at(self, box: Float[Array, "p"]) -> "ChippedShutter":
        return ChippedShutter(box)
