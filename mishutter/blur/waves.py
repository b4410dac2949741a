r"""Sums of waves $e^{-2\pi i f x}$ over many positions, on a grid of frequencies.

At the centres of equal steps in (0, 0.5) cycles/px they are a non-uniform DFT: a window of known
transform spreads each position over a few cells of a fine grid, and one FFT of the cells gives
every frequency (Dutt and Rokhlin, SIAM J. Sci. Comput.
14, 1993; the window is that of Barnett, Magland and af Klinteberg, ibid. 41, 2019).
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Complex, Float, Int

from mishutter._core.checks import Numbers, namespace_of
from mishutter._core.compiling import in_full_precision
from mishutter.model.optics import frequency_grid

BLOCK = 64
"""Positions spread at a time: the windows of more do not fit a processor's cache."""


class _Window(NamedTuple):
    """The window about a position, and the polynomials that stand for it."""

    width: int  # Cells that it covers
    degree: int  # Degree of the polynomials

    @staticmethod
    def of(dtype: np.dtype) -> "_Window":
        """The window whose error on a grid of twice the Nyquist rate is near a rounding's."""
        return _Window(16, 13) if np.finfo(dtype).bits == 64 else _Window(8, 7)

    def at(self, place: np.ndarray) -> np.ndarray:
        """Values at places from -1 to 1."""
        # Barnett et al. find 2.3 best for a grid of twice the Nyquist rate.
        return np.exp(2.3 * self.width * (np.sqrt(1 - place**2) - 1))


@in_full_precision
def waves_on_dft(
    position: Float[Array | np.ndarray, "#s q"],
    weight: Float[Array | np.ndarray, "#s q"],
    length: int,
    num_frequencies: int,
) -> Complex[Array | np.ndarray, "s {num_frequencies}"]:
    r"""$\sum_q w_q e^{-2\pi i k x_q / L}$ for $k = 0, 1, \dots$.

    The wave of $k$ is the product of the waves of its higher and of its lower digits, which makes
    the sum over $q$ a product of two matrices. NumPy arrays give a NumPy array.
    """
    space = namespace_of(position, weight)
    num_low = math.isqrt(num_frequencies - 1) + 1
    num_high = -(-num_frequencies // num_low)
    if space is np:  # its cosines of double precision cost as much as 20 products
        high, low = (
            _powers(position, n / length, k) for n, k in ((num_low, num_high), (1, num_low))
        )
    else:
        low, high = np.arange(num_low) / length, num_low * np.arange(num_high) / length
        high, low = (_waves_at(position, f, space) for f in (high, low))
    waves = _sums_of_products(high, low, weight, space)
    return waves.reshape(waves.shape[0], -1)[:, :num_frequencies]


def waves_in_plane(
    place: Float[np.ndarray, "2 s q"],
    weight: Float[np.ndarray, "#s q"],
    frequencies: tuple[Float[np.ndarray, "#m #n"], ...],
) -> Complex[np.ndarray, "s m n"]:
    r"""$\sum_q w_q e^{-2\pi i (f_y y_q + f_x x_q)}$ at all pairs of frequencies $f_y$ and $f_x$.

    Places $x$ along the rows come first, and frequencies $f_y$ down the columns.
    """
    ways = zip(place[::-1], frequencies, strict=True)
    down, across = (_waves_at(x, f.ravel(), np) for x, f in ways)
    return _sums_of_products(down, across, weight, np)


def _powers(position: Numbers, step: float, count: int) -> Complex[np.ndarray, "s {count} q"]:
    """Waves of the first multiples of a frequency, each the product of two lower ones."""
    first = _waves_at(position, np.array([step]), np)
    waves = np.empty((position.shape[0], count, position.shape[1]), first.dtype)
    waves[:, :1], done = 1.0, 1
    while done < count:
        more = min(done, count - done)
        np.multiply(waves[:, :more], first, out=waves[:, done : done + more])
        first, done = first * first, done + more
    return waves


def _waves_at(position: Numbers, frequencies: np.ndarray, space: ModuleType) -> Any:
    """Waves of some frequencies at each position."""
    dtype = np.result_type(position.dtype, np.complex64)
    turn = position[:, None, :] * (-2 * np.pi * frequencies).astype(position.dtype)[None, :, None]
    # NumPy vectorises these for single precision, and not complex exponentials.
    return space.cos(turn).astype(dtype) + dtype.type(1j) * space.sin(turn).astype(dtype)


def _sums_of_products(first: Any, second: Any, weight: Numbers, space: ModuleType) -> Any:
    """Sums over $q$ of the first waves times the second ones, for all pairs."""
    weight = weight[:, None, :].astype(first.dtype)
    return space.matmul(first * weight, space.swapaxes(second, 1, 2))


@partial(jax.custom_jvp, nondiff_argnums=(2, 3))
def sum_of_waves(
    position: Float[Array, "#s q"],
    weight: Float[Array, "#s q"],
    num_frequencies: int,
    num_kept: int,
) -> Complex[Array, "s {num_kept}"]:
    r"""$\sum_q w_q e^{-2\pi i f_m x_q}$ at the lowest `num_kept` frequencies of the grid."""

    def waves(position: Array, weight: Array) -> Array:
        return _waves(position, [weight], num_frequencies, num_kept)[0]

    return _one_at_a_time(waves)(position, weight)


@sum_of_waves.defjvp
def sum_of_waves_jvp(num_frequencies, num_kept, primals, tangents):
    r"""The same sums with the weights $dw_q - 2\pi i f_m w_q\,dx_q$, from the same windows."""
    (position, weight), (d_position, d_weight) = primals, tangents
    turn = (2 * jnp.pi) * frequency_grid(num_frequencies, np.dtype(position.dtype))[:num_kept]
    weights = [weight, weight * d_position, d_weight]
    value, by_position, by_weight = _waves(position, weights, num_frequencies, num_kept)
    real = by_weight.real + turn[None] * by_position.imag
    imag = by_weight.imag - turn[None] * by_position.real
    return value, jax.lax.complex(real, imag)


def waves_of_blocks(
    position: Float[Array, "#s q"],
    weight: Float[Array, "#s q"],
    num_frequencies: int,
    num_kept: int,
    num_blocks: Int[Array, ""],
) -> Complex[Array, "s {num_kept}"]:
    """`sum_of_waves` over the first `num_blocks` blocks of positions; it has no derivative."""

    def add(block: Array, cells: list[Array]) -> list[Array]:
        x, w = (
            jax.lax.dynamic_slice_in_dim(x, block * BLOCK, BLOCK, 1) for x in (position, weight)
        )
        return _with_block(cells, num_frequencies, x, [w])

    empty = _empty(position, [weight], num_kept)
    cells = jax.lax.fori_loop(0, num_blocks, add, empty)
    return _transformed(cells[0])[:, :num_kept]


def _waves(
    position: Array, weights: list[Array], num_frequencies: int, num_kept: int
) -> list[Array]:
    """Sums of waves at the same positions for each of several weights; `(s, num_kept)`, complex."""

    def add(cells: list[Array], block: list[Array]) -> tuple[list[Array], None]:
        return _with_block(cells, num_frequencies, block[0], block[1:]), None

    blocks = [_in_blocks(x) for x in (position, *weights)]
    cells, _ = jax.lax.scan(add, _empty(position, weights, num_kept), blocks)
    return [_transformed(x)[:, :num_kept] for x in cells]


def _one_at_a_time(function: Callable[..., Array]) -> Callable[..., Array]:
    """A function that `jax.vmap` evaluates one row after the other on a CPU.

    Prevents the cells of all rows from taking gigabytes and leaving a processor's cache.
    """
    bounded = custom_vmap(function)

    @bounded.def_vmap
    def in_turn(_: int, is_batched: Sequence[bool], *arguments: Array) -> tuple[Array, bool]:
        if jax.default_backend() != "cpu":
            return jax.vmap(function, [0 if own else None for own in is_batched])(*arguments), True

        def one(each: list[Array]) -> Array:
            pairs = zip(arguments, is_batched, strict=True)
            return function(*(each.pop(0) if own else shared for shared, own in pairs))

        return jax.lax.map(
            one, [x for x, own in zip(arguments, is_batched, strict=True) if own]
        ), True

    return bounded


def _in_blocks(rows: Array) -> Array:
    """Rows `(s, q)` in blocks, padded with zeros; shape `(b, s, BLOCK)`."""
    num_blocks = -(-rows.shape[1] // BLOCK)
    padded = jnp.pad(rows, ((0, 0), (0, num_blocks * BLOCK - rows.shape[1])))
    return jnp.swapaxes(padded.reshape(rows.shape[0], num_blocks, BLOCK), 0, 1)


def _empty(position: Array, weights: list[Array], num_kept: int) -> list[Array]:
    """A fine grid of zeros for each of several weights, with a margin for windows at its end."""
    width = _Window.of(position.dtype).width
    # Cells have twice the Nyquist rate of the highest frequency to compute, not of all.
    num_cells = max(4 * num_kept, width)
    # The zeros derive from the values added to them, so that `jax.shard_map` sees both vary.
    columns = [jnp.zeros_like(position[:, :1] * weight[:, :1]) for weight in weights]
    return [jnp.tile(column, (1, num_cells + width)) for column in columns]


def _with_block(
    cells: list[Array], num_frequencies: int, position: Array, weights: list[Array]
) -> list[Array]:
    """Cells after the windows of a block of positions are added; linear in the weights."""
    width = _Window.of(position.dtype).width
    num_cells = cells[0].shape[1] - width
    first, windows = _placed(position, num_frequencies, num_cells)
    index = jnp.arange(first.shape[0], dtype=jnp.int32)[:, None] * cells[0].shape[1] + first
    return [
        # This adds whole windows at once, where `.at[].add` would add them cell by cell.
        jax.lax.scatter_add(
            rows.reshape(-1),
            index.reshape(-1, 1),
            (windows * weight[..., None]).reshape(-1, width),
            jax.lax.ScatterDimensionNumbers((1,), (), (0,)),
            mode="clip",
        ).reshape(rows.shape)
        for rows, weight in zip(cells, weights, strict=True)
    ]


def _placed(position: Array, num_frequencies: int, num_cells: int) -> tuple[Array, Array]:
    """First cell of the window about each position, `(s, q)`, and the windows, `(s, q, width)`.

    The grid repeats itself with the opposite sign: the frequencies are odd multiples of half a
    step, so that a wave is its own negative after a period of `2 * num_frequencies` px.
    """
    window = _Window.of(position.dtype)
    cell = position * (num_cells / (2 * num_frequencies))
    begin = jnp.ceil(cell - window.width / 2)
    period = jnp.floor(begin / num_cells)
    sign = 1 - 2 * (period - 2 * jnp.floor(period / 2))
    first = (begin - period * num_cells).astype(jnp.int32)
    shift = (begin - cell + (window.width / 2 - 0.5))[..., None]
    # Powers by doubling, then one product of matrices: half the operations of Horner's rule to
    # compile, and a sixth less time.
    powers, factor = sign[..., None], shift
    while powers.shape[-1] <= window.degree:
        powers, factor = jnp.concatenate([powers, powers * factor], axis=-1), factor * factor
    polynomials = _powers_of_window(window).astype(position.dtype)
    return jnp.clip(first, 0, num_cells - 1), powers[..., : window.degree + 1] @ polynomials


@lru_cache
def _powers_of_window(window: _Window) -> np.ndarray:
    """Polynomials that interpolate a window in each of its cells; shape `(d, width)`.

    Coefficients are of ascending powers of the place in the cell, from -1/2 to 1/2. They are as
    exact as the window, and their evaluation is many times quicker than an exponential of a root.
    """
    width, count = window.width, window.degree + 1
    places = np.cos(np.pi * (np.arange(count) + 0.5) / count) / 2
    distance = places[:, None] + np.arange(width) + 0.5 - width / 2
    powers = np.vander(places, count, increasing=True)
    return np.linalg.solve(powers, window.at(distance * (2 / width)))


def _transformed(cells: Array) -> Array:
    """Fourier sums of the cells over the window's transform; `(s, num_kept)` or more, complex.

    The cells are real: their odd waves are conjugates of even ones, and the even ones are an FFT of
    half as many complex numbers.
    """
    window = _Window.of(cells.dtype)
    num_cells = cells.shape[1] - window.width
    cells = cells[:, :num_cells].at[:, : window.width].add(-cells[:, num_cells:])
    half, num_kept = num_cells // 2, num_cells // 4
    angle = (-np.pi / (2 * half)) * np.arange(half)
    dtype = np.result_type(cells.dtype, np.complex64)
    twiddle = np.exp(1j * angle).astype(dtype)[None]
    even = jnp.fft.fft(jax.lax.complex(cells[:, :half], -cells[:, half:]) * twiddle)
    pairs = jnp.stack([even, jnp.conj(even[:, ::-1])], axis=2)[:, : -(-num_kept // 2)]
    share = (1 / _transform_of_window(window, num_kept)).astype(dtype)[None]
    return pairs.reshape(cells.shape[0], -1)[:, :num_kept] * share


@lru_cache
def _transform_of_window(window: _Window, num_kept: int) -> np.ndarray:
    """A window's own Fourier transform at the frequencies; shape `(num_kept,)`."""
    nodes, weights = np.polynomial.legendre.leggauss(4 * window.width)
    values = window.at(nodes) * weights * (window.width / 2)
    turns = np.arange(num_kept) + 0.5
    return np.cos(np.outer(turns * (np.pi * window.width / (4 * num_kept)), nodes)) @ values
