r"""Sums of waves $e^{-2\pi i f x}$ over many positions, on a grid of frequencies.

This is a non-uniform discrete Fourier transform. At the centres of $M$ equal steps in
(0, 0.5) cycles/px a wave is the product of a coarse and a fine power of one exponential, so
that a position needs $2\sqrt{M}$ powers instead of $M$ waves, and a matrix product does the
rest.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter.model import frequency_grid


@partial(jax.custom_jvp, nondiff_argnums=(2, 3))
def sum_of_waves(position: Array, light: Array, num_frequencies: int, num_kept: int) -> Array:
    r"""$\sum_q l_q e^{-2\pi i f_m x_q}$ on the lowest of the grid; `(s, num_kept)`, complex."""
    return jax.lax.complex(*_summed(_factors(position, num_frequencies, num_kept), light, num_kept))


@sum_of_waves.defjvp
def sum_of_waves_jvp(num_frequencies, num_kept, primals, tangents):
    r"""The same waves weighted by $dl_q - 2\pi i f_m l_q\,dx_q$, so that none is computed again."""
    (position, light), (moved, lit) = primals, tangents
    factors = _factors(position, num_frequencies, num_kept)
    turn = (2 * jnp.pi) * frequency_grid(num_frequencies, np.dtype(position.dtype))[:num_kept]
    displaced, brighter = (_summed(factors, x, num_kept) for x in (light * moved, lit))
    real = brighter.real + turn[None] * displaced.imag
    imag = brighter.imag - turn[None] * displaced.real
    value = jax.lax.complex(*_summed(factors, light, num_kept))
    return value, jax.lax.complex(real, imag)


class _Wave(NamedTuple):
    """Complex numbers as two real arrays: on a CPU their products vectorise, sines do not."""

    real: Array
    imag: Array


class _Factors(NamedTuple):
    """Waves whose products are the waves of all frequencies; `(p, s, q)` and `(r, s, q)`."""

    coarse: _Wave
    fine: _Wave


def _factors(position: Array, num_frequencies: int, num_kept: int) -> _Factors:
    num_fine = 1 << (max(num_kept - 1, 1).bit_length() + 1) // 2
    num_coarse = -(-num_kept // num_fine)
    step = (np.pi / num_frequencies) * position
    half = _wave(step / 2)
    ones = _Wave(jnp.ones_like(step), jnp.zeros_like(step))
    coarse = _powers(ones, _wave(num_fine * step), num_coarse)
    return _Factors(coarse, _powers(half, _squared(half), num_fine))


def _summed(factors: _Factors, light: Array, num_kept: int) -> _Wave:
    """Sum over nodes of weights times waves, linear in the weights; `(s, num_kept)`."""
    coarse, fine = factors
    left = jnp.concatenate(coarse)
    right = jnp.concatenate(fine) * light[None]
    product = jnp.einsum("psq,rsq->spr", left, right)
    (cc, cs), (sc, ss) = (jnp.split(part, 2, axis=2) for part in jnp.split(product, 2, axis=1))
    shape = (left.shape[1], -1)
    return _Wave(*(part.reshape(shape)[:, :num_kept] for part in (cc - ss, -(cs + sc))))


def _wave(angle: Array) -> _Wave:
    return _Wave(jnp.cos(angle), jnp.sin(angle))


def _squared(wave: _Wave) -> _Wave:
    real, imag = wave
    return _Wave((real - imag) * (real + imag), 2 * real * imag)


def _powers(first: _Wave, turn: _Wave, count: int) -> _Wave:
    """The first wave times powers 0, 1, ... of `turn`; the powers lead the shape."""

    def rotate(wave: _Wave, _: None) -> tuple[_Wave, _Wave]:
        real = wave.real * turn.real - wave.imag * turn.imag
        return _Wave(real, wave.real * turn.imag + wave.imag * turn.real), wave

    return jax.lax.scan(rotate, first, length=count)[1]
