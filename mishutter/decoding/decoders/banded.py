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
from jaxtyping import Array, ArrayLike, Float


@final
class BandedConvolution(eqx.Module):
    """Convolution with a kernel and its adjoint, on rows whose length is a multiple of `block`."""

    # Matrix from blocks `k - J, ..., k` to block `k`; $(J + 1) B$ rows, $B$ columns
    forward: Float[np.ndarray, "window block"]
    adjoint: Float[np.ndarray, "window block"]  # Matrix from blocks `k, ..., k + J` to block `k`

    @property
    def block(self) -> int:
        """Pixels in a block: $B$."""
        return self.forward.shape[1]

    @property
    def span(self) -> int:
        """Blocks that a block depends on, less one: $J$."""
        return self.forward.shape[0] // self.block - 1

    def __call__(self, rows: Float[Array, "*planes length"]) -> Float[Array, "*planes length"]:
        r"""$y_k = \sum_i h_i x_{k - i}$, periodic."""
        blocks = self._blocks(rows)
        before = blocks[:, blocks.shape[1] - self.span :]
        return self._product(jnp.concatenate([before, blocks], axis=1), self.forward, rows)

    def back(self, rows: Float[Array, "*planes length"]) -> Float[Array, "*planes length"]:
        """The adjoint of `__call__`."""
        blocks = self._blocks(rows)
        wrapped = jnp.concatenate([blocks, blocks[:, : self.span]], axis=1)
        return self._product(wrapped, self.adjoint, rows)

    def _blocks(self, rows: Array) -> Array:
        return rows.reshape(-1, rows.shape[-1] // self.block, self.block)

    def _product(self, blocks: Array, matrix: ArrayLike, like: Array) -> Array:
        count = blocks.shape[1] - self.span
        parts = [blocks[:, j : j + count] for j in range(self.span + 1)]
        window = jnp.concatenate(parts, axis=2).reshape(-1, (self.span + 1) * self.block)
        return (window @ jnp.asarray(matrix, like.dtype)).reshape(like.shape)


def banded(kernel: Float[np.ndarray, "taps"]) -> BandedConvolution:
    """The convolution with a kernel, in blocks of a size that suits its length."""
    taps = np.trim_zeros(np.asarray(kernel), "b")
    taps = taps if taps.size else np.zeros(1)
    # Blocks on which a block of the result depends, itself included: $J + 1$.
    counts = {size: 1 + -(-(taps.size - 1) // size) for size in range(32, 129, 16)}
    # Copying a block into a window costs as much as 16 rows of its product, measured on two cores.
    block = min(counts, key=lambda size: (counts[size] * (size + 16), -size))
    blocks = counts[block]
    forward = np.zeros((blocks * block, block))
    for column in range(block):
        last = (blocks - 1) * block + column
        forward[last - taps.size + 1 : last + 1, column] = taps[::-1]
    # All blocks share one matrix, so that its adjoint is the same one turned by half a turn.
    return BandedConvolution(forward, np.ascontiguousarray(forward[::-1, ::-1]))
