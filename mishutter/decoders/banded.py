r"""Periodic convolution of rows as a banded matrix product.

A row is cut into blocks of `B` pixels. A block of the result depends on the same block
and the `J` before it, `J B \ge n - 1`, by one dense matrix that is the same for every block
and every row: one large matrix product, which needs fewer passes over memory than a
Fourier transform of short kernels does.
"""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

BLOCK = 64
"""Pixels in a block; measured on two cores with kernels of 50 to 150 taps."""


@final
class BandedConvolution(eqx.Module):
    """Convolution with a kernel and its adjoint, on rows whose length is a multiple of `BLOCK`.

    Attributes:
        forward: Matrix from blocks `k - J, ..., k` to block `k`; shape `((J + 1) B, B)`.
        adjoint: Matrix from blocks `k, ..., k + J` to block `k`; the same shape.
        origin: Index of the tap that displaces nothing.
    """

    forward: np.ndarray
    adjoint: np.ndarray
    origin: int = eqx.field(static=True)

    @property
    def span(self) -> int:
        """Blocks that a block depends on, less one: $J$."""
        return self.forward.shape[0] // BLOCK - 1

    def __call__(self, rows: Array) -> Array:
        r"""$y_k = \sum_i h_i x_{k + o - i}$, periodic; shape `(..., length)` to the same."""
        return jnp.roll(self._product(rows, self.forward, self.span), -self.origin, axis=-1)

    def back(self, rows: Array) -> Array:
        """The adjoint of `__call__`; shape `(..., length)` to the same."""
        return self._product(jnp.roll(rows, self.origin, axis=-1), self.adjoint, 0)

    def _product(self, rows: Array, matrix: ArrayLike, first: int) -> Array:
        blocks = rows.reshape(-1, rows.shape[-1] // BLOCK, BLOCK)
        shifts = [jnp.roll(blocks, first - j, axis=1) for j in range(self.span + 1)]
        window = jnp.concatenate(shifts, axis=2).reshape(-1, (self.span + 1) * BLOCK)
        return (window @ jnp.asarray(matrix, rows.dtype)).reshape(rows.shape)


def banded(kernel: np.ndarray, origin: int) -> BandedConvolution:
    """The convolution with a kernel whose tap `origin` displaces nothing."""
    taps = np.trim_zeros(np.asarray(kernel), "b")
    taps = taps if taps.size else np.zeros(1)
    blocks = 1 + -(-(taps.size - 1) // BLOCK)
    forward = np.zeros((blocks * BLOCK, BLOCK))
    for column in range(BLOCK):
        last = (blocks - 1) * BLOCK + column
        forward[last - taps.size + 1 : last + 1, column] = taps[::-1]
    return BandedConvolution(forward, np.ascontiguousarray(forward[::-1, ::-1]), origin)
