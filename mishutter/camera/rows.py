"""Convolution along the rows of a picture, and what lies beyond a row's ends.

Arrays hold rows on their last axis. A row of `W` pixels is first extended by the reach
of the kernel, then convolved where the kernel lies wholly inside.
"""

from typing import Any, Literal, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import compiled, require

Border = Literal["scene", "reflect", "edge", "wrap", "zero"]
PAD_MODES = {"reflect": "symmetric", "edge": "edge", "wrap": "wrap", "zero": "constant"}


def require_border(subject: str, border: object) -> None:
    """Refuse the name of a border rule that is not known."""
    names = get_args(Border)
    require(border in names, subject, f"be one of {', '.join(names)}", border)


def extended(rows: Array, before: int, after: int, border: str) -> Array:
    """Rows with `before` and `after` pixels added at their ends by a border rule."""
    if border == "scene":
        return rows
    widths = [(0, 0)] * (rows.ndim - 1) + [(before, after)]
    return jnp.pad(rows, widths, mode=PAD_MODES[border])


def padded_columns(rows: np.ndarray, before: int, after: int, border: str) -> np.ndarray:
    """`extended` for numpy arrays; columns on the last axis."""
    widths = [(0, 0)] * (rows.ndim - 1) + [(before, after)]
    mode: Any = PAD_MODES[border]
    return np.pad(rows, widths, mode=mode)


def convolved(rows: Array, kernel: Array) -> Array:
    """Convolution where the kernel lies inside the row, by the fast Fourier transform.

    Args:
        rows: Shape `(..., W + n - 1)`.
        kernel: Taps; shape `(n,)`.

    Returns:
        Shape `(..., W)`; pixel `k` is the sum of `kernel[i] * rows[k + n - 1 - i]`.
    """
    length = fast_length(rows.shape[-1])
    response = jnp.fft.rfft(kernel.astype(rows.dtype), length)
    spectrum = jnp.fft.rfft(rows, length)
    spectrum = spectrum * along_rows(response, spectrum)
    return jnp.fft.irfft(spectrum, length)[..., kernel.size - 1 : rows.shape[-1]]


def along_rows(vector: ArrayLike, like: Array) -> Array:
    """A vector with as many axes, and the precision, of the rows that it is to meet."""
    return jnp.asarray(vector, like.dtype).reshape((1,) * (like.ndim - 1) + (-1,))


def fast_length(least: int) -> int:
    """Smallest length of at least `least` whose only factors are 2, 3 and 5, and even."""
    length = least + least % 2
    while not _is_smooth(length):
        length += 2
    return length


def _is_smooth(number: int) -> bool:
    for factor in (2, 3, 5):
        while number % factor == 0:
            number //= factor
    return number == 1


def rows_last(light: ArrayLike) -> Array:
    """A picture `(..., rows, columns, channels)` or `(rows, columns)`, columns last.

    The result has the shape `(..., channels, rows, columns)`.
    """
    return _rows_last(jnp.asarray(light))


@compiled
def _rows_last(light: Array) -> Array:
    light = light[..., None] if light.ndim == 2 else light
    return jnp.moveaxis(light, -1, -3)


def channels_last(planes: Array, like: ArrayLike) -> Array:
    """Undo `rows_last`, for a picture that had as many axes as `like`."""
    return _channels_last(planes, jnp.ndim(like) == 2)


@compiled
def _channels_last(planes: Array, only_one: bool) -> Array:
    light = jnp.moveaxis(planes, -3, -1)
    return light[..., 0] if only_one else light
