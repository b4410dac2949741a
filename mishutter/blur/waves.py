r"""Sums of waves $e^{-2\pi i f x}$ over many positions, on a grid of frequencies.

At the centres of equal steps in (0, 0.5) cycles/px they are a nonuniform Fourier transform:
each position is spread over a few cells of a fine grid by a window whose own transform is
known, and one FFT of the cells gives every frequency (Dutt and Rokhlin, SIAM J. Sci. Comput.
14, 1993; the window is that of Barnett, Magland and af Klinteberg, ibid. 41, 2019).
"""

from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter.model import frequency_grid

_WIDTH = 16
"""Cells that a position is spread over; twice as many cells as waves need leave 1e-15."""
_SHARPNESS = 2.3 * _WIDTH


@partial(jax.custom_jvp, nondiff_argnums=(2, 3))
def sum_of_waves(position: Array, light: Array, num_frequencies: int, num_kept: int) -> Array:
    r"""$\sum_q l_q e^{-2\pi i f_m x_q}$ on the lowest of the grid; `(s, num_kept)`, complex."""
    windows = _placed(position, num_frequencies, num_kept)
    return _transformed(_spread(windows, light))[:, :num_kept]


@sum_of_waves.defjvp
def sum_of_waves_jvp(num_frequencies, num_kept, primals, tangents):
    r"""The same waves with light $dl_q - 2\pi i f_m l_q\,dx_q$: no window is computed again."""
    (position, light), (moved, lit) = primals, tangents
    windows = _placed(position, num_frequencies, num_kept)
    turn = (2 * jnp.pi) * frequency_grid(num_frequencies, np.dtype(position.dtype))[:num_kept]
    value, displaced, brighter = (
        _transformed(_spread(windows, x))[:, :num_kept] for x in (light, light * moved, lit)
    )
    real = brighter.real + turn[None] * displaced.imag
    imag = brighter.imag - turn[None] * displaced.real
    return value, jax.lax.complex(real, imag)


class _Windows(NamedTuple):
    """Where positions lie on the fine grid.

    Attributes:
        first: Cell at which the window of each begins; shape `(s, q)`.
        values: The windows; shape `(s, q, _WIDTH)`.
        num_cells: Cells of the grid.
    """

    first: Array
    values: Array
    num_cells: int


def _placed(position: Array, num_frequencies: int, num_kept: int) -> _Windows:
    """Windows about positions, on a grid that repeats itself with the other sign.

    The frequencies are odd multiples of half a step, so that a wave is its own negative one
    period, `2 * num_frequencies` px, further on.
    """
    num_cells = max(4 * num_kept, _WIDTH)
    cell = position * (num_cells / (2 * num_frequencies))
    begin = jnp.ceil(cell - _WIDTH / 2)
    offset = (begin - cell)[..., None] + jnp.arange(_WIDTH, dtype=position.dtype)[None, None]
    root = jnp.sqrt(jnp.maximum(1 - (offset * (2 / _WIDTH)) ** 2, 0))
    period = jnp.floor(begin / num_cells)
    sign = 1 - 2 * (period - 2 * jnp.floor(period / 2))
    first = (begin - period * num_cells).astype(jnp.int32)
    values = sign[..., None] * jnp.exp(_SHARPNESS * (root - 1))
    return _Windows(jnp.clip(first, 0, num_cells - 1), values, num_cells)


def _spread(windows: _Windows, light: Array) -> Array:
    """Light in the cells of the fine grid, linear in the light; `(s, num_cells)`."""
    first, values, num_cells = windows
    row = num_cells + _WIDTH
    index = jnp.arange(first.shape[0], dtype=jnp.int32)[:, None] * row + first
    cells = jax.lax.scatter_add(
        jnp.zeros(first.shape[0] * row, values.dtype),
        index.reshape(-1, 1),
        (values * light[..., None]).reshape(-1, _WIDTH),
        jax.lax.ScatterDimensionNumbers((1,), (), (0,)),
        mode="clip",
    ).reshape(-1, row)
    return cells[:, :num_cells].at[:, :_WIDTH].add(-cells[:, num_cells:])


def _transformed(cells: Array) -> Array:
    """Waves of the light in the cells, less the window's share; `(s, num_cells // 4)`, complex.

    Of real numbers the odd waves are conjugates of even ones, and the even ones are an FFT of
    half as many complex numbers.
    """
    half, num_kept = cells.shape[1] // 2, cells.shape[1] // 4
    angle = (-np.pi / (2 * half)) * np.arange(half)
    dtype = np.result_type(cells.dtype, np.complex64)
    twiddle = np.exp(1j * angle).astype(dtype)[None]
    even = jnp.fft.fft(jax.lax.complex(cells[:, :half], -cells[:, half:]) * twiddle)
    pairs = jnp.stack([even, jnp.conj(even[:, ::-1])], axis=2)[:, : -(-num_kept // 2)]
    share = (1 / _transform_of_window(num_kept)).astype(dtype)[None]
    return pairs.reshape(cells.shape[0], -1)[:, :num_kept] * share


@lru_cache
def _transform_of_window(num_kept: int) -> np.ndarray:
    """The window's own Fourier transform at the frequencies; shape `(num_kept,)`."""
    nodes, weights = np.polynomial.legendre.leggauss(4 * _WIDTH)
    window = weights * np.exp(_SHARPNESS * (np.sqrt(1 - nodes**2) - 1)) * (_WIDTH / 2)
    turns = np.arange(num_kept) + 0.5
    return np.cos(np.outer(turns * (np.pi * _WIDTH / (4 * num_kept)), nodes)) @ window
