"""Numbers held as an unevaluated sum of two floats, about twice the working precision.

The position at which a shutter's edge meets the sensor is a small difference of
large products: at a sag of 1e8 px its error is 1e-8 px in float64 and 6 px
in float32. As a pair `(high, low)` its error is 1e-24 px and 1e-7 px.

Products are formed from halves of the significand, so every partial product is exact
and a compiler that contracts `a * b + c` into one operation changes nothing.
The sums are Knuth's (The Art of Computer Programming 2, 4.2.2, theorem B).
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core.checks import device_constant


class DoubleWord(NamedTuple):
    """The number `high + low`, with `low` at most half an ulp of `high`."""

    high: Array
    low: Array


def two_sum(a: Any, b: Any) -> DoubleWord:
    """`a + b` exactly."""
    high = a + b
    b_part = high - a
    return DoubleWord(high, (a - (high - b_part)) + (b - b_part))


def _renormalise(high: Array, low: Array) -> DoubleWord:
    """`high + low` exactly, for a `low` that is smaller than `high` (Dekker)."""
    total = high + low
    return DoubleWord(total, low - (total - high))


def _upper_half(a: Array) -> Array:
    """`a` with the lower half of its significand cleared."""
    if a.dtype == jnp.float64:
        bits, mask = jnp.uint64, 0xFFFFFFFFF8000000
    else:
        bits, mask = jnp.uint32, 0xFFFFF000
    upper = jax.lax.bitcast_convert_type(a, bits) & jnp.asarray(mask, bits)
    return jax.lax.bitcast_convert_type(upper, a.dtype)


@jax.jit
def two_product(a: Array, b: Array) -> DoubleWord:
    """`a * b` to twice the working precision."""
    a_high, b_high = _upper_half(a), _upper_half(b)
    a_low, b_low = a - a_high, b - b_high
    partial, error_1 = _renormalise(a_high * b_high, a_high * b_low)
    total, error_2 = _renormalise(partial, a_low * b_high)
    return _renormalise(total, (error_1 + error_2) + a_low * b_low)


@jax.jit
def add(x: DoubleWord, y: DoubleWord) -> DoubleWord:
    """`x + y`, also accurate where the two nearly cancel."""
    high, error = two_sum(x.high, y.high)
    low, low_error = two_sum(x.low, y.low)
    high, error = _renormalise(high, error + low)
    return _renormalise(high, error + low_error)


def negate(x: DoubleWord) -> DoubleWord:
    """`-x`."""
    return DoubleWord(-x.high, -x.low)


@jax.jit
def multiply(x: DoubleWord, y: DoubleWord) -> DoubleWord:
    """`x y`."""
    product = two_product(x.high, y.high)
    return _renormalise(product.high, product.low + (x.high * y.low + x.low * y.high))


@jax.jit
def reciprocal(x: DoubleWord) -> DoubleWord:
    """`1 / x`, for a nonzero `x`, by one step of Newton's method."""
    guess = 1 / x.high
    product = two_product(guess, x.high)
    residual = (1 - product.high) - (product.low + guess * x.low)
    return _renormalise(guess, guess * residual)


def word(a: Array) -> DoubleWord:
    """A single float as a double word."""
    return DoubleWord(a, jnp.zeros_like(a))


def scale(x: DoubleWord, factor: float) -> DoubleWord:
    """`x` times a power of two, exactly."""
    return DoubleWord(x.high * factor, x.low * factor)


def fractions_as_words(exact: Sequence[Fraction], dtype: np.dtype) -> DoubleWord:
    """Fractions as double words; shape `(n,)`."""
    high = np.array([float(x) for x in exact]).astype(dtype)
    low = [float(x - Fraction(float(h))) for x, h in zip(exact, high, strict=True)]
    return DoubleWord(*device_constant((high, np.array(low, dtype))))
