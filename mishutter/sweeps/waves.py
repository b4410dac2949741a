"""Waves at equal steps of frequency, from polynomials that fill a processor's lanes."""

import math

import jax.numpy as jnp
from jaxtyping import Array

from mishutter._core import computed_once
from mishutter.model import polynomial

_FINE = 8
_SINE = [
    (-1) ** n * (2 * math.pi) ** (2 * n + 1) / math.factorial(2 * n + 1) for n in range(11, -1, -1)
]


def cosine(turns: Array) -> Array:
    r"""$\cos 2\pi x$, to rounding of $x$.

    As $\sin 2\pi(\frac14 - |x|)$, by Taylor's series over half a turn: XLA calls a library
    for the cosine of one number at a time, but does polynomials for a vector of them.
    """
    part = 0.25 - jnp.abs(turns - jnp.round(turns))
    return polynomial(_SINE, part * part) * part


def waves(frequency: Array, position: Array) -> tuple[Array, Array]:
    r"""Cosine and sine of $2\pi fx$ at equal steps of frequency.

    A wave at $f_{8a} + b\delta$ is a product of one of few coarse and one of 8 fine ones.

    Args:
        frequency: $f$, cycles/px, a multiple of 8 of them; shape `(m,)`.
        position: $x$, px; any shape `(...)`.

    Returns:
        Two arrays of shape `(m, ...)`.
    """
    real, imag, fine_real, fine_imag = _factors(
        frequency, position, jnp.zeros_like(position)[None, None]
    )
    shape = (frequency.size, *position.shape)
    cosines, sines = real * fine_real - imag * fine_imag, imag * fine_real + real * fine_imag
    return cosines.reshape(shape), sines.reshape(shape)


def paired_waves(frequency: Array, position: Array) -> Array:
    r"""Cosines of $2\pi fx$ and, beside them, sines: from `(..., j)` to `(m, ..., 2j)`."""
    behind = jnp.array([0.0, 0.25], position.dtype)
    behind = behind.reshape(*(1,) * (position.ndim + 1), 2, 1)
    real, imag, fine_real, fine_imag = _factors(frequency, position[..., None, :], behind)
    shape = (frequency.size, *position.shape[:-1], 2 * position.shape[-1])
    return (real * fine_real - imag * fine_imag).reshape(shape)


def _factors(frequency: Array, position: Array, behind: Array) -> list[Array]:
    """Real and imaginary parts of coarse waves, some turns behind, and of fine ones."""
    tail = (1,) * position.ndim
    step = (frequency[1] - frequency[0]) * jnp.arange(_FINE, dtype=frequency.dtype)

    def factors() -> list[Array]:
        coarse = frequency[::_FINE].reshape(-1, 1, *tail) * position[None, None] - behind
        fine = step.reshape(1, -1, *tail) * position[None, None]
        return [cosine(coarse), cosine(coarse - 0.25), cosine(fine), cosine(fine - 0.25)]

    return computed_once(factors, frequency[0] > 0)
