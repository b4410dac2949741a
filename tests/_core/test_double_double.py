"""Double words hold what they promise: sums exactly, products and quotients to twice the bits."""

import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mishutter._core import DoubleWord, add, multiply, reciprocal, two_product, two_sum, word

UNITS = {np.float64: 2.0**-100, np.float32: 2.0**-44}
"""Relative error of one operation: the last few of twice 53, or 24, bits."""
NUMBER = st.floats(1e-30, 1e30) | st.floats(-1e30, -1e-30)
SINGLE = st.floats(2.0**-30, 2.0**30, width=32) | st.floats(-(2.0**30), -(2.0**-30), width=32)


def exact(x):
    return mp.mpf(float(x.high)) + mp.mpf(float(x.low))


def check(found, expected, dtype):
    assert abs(exact(found) - expected) <= UNITS[dtype] * abs(expected)
    assert abs(float(found.low)) <= abs(float(np.spacing(np.asarray(found.high))))


@given(NUMBER, NUMBER)
@settings(max_examples=40, deadline=None)
def test_float64(a, b):
    """Sum, product and quotient of two floats, as double words."""
    x, y = jnp.asarray(a), jnp.asarray(b)
    p, q = mp.mpf(a), mp.mpf(b)
    assert exact(two_sum(x, y)) == p + q
    check(two_product(x, y), p * q, np.float64)
    check(multiply(word(x), reciprocal(word(y))), p / q, np.float64)


@given(SINGLE, SINGLE)
@settings(max_examples=40, deadline=None)
def test_float32(a, b):
    """The same in single precision."""
    x, y = jnp.asarray(a, jnp.float32), jnp.asarray(b, jnp.float32)
    p, q = mp.mpf(float(x)), mp.mpf(float(y))
    check(two_product(x, y), p * q, np.float32)
    check(multiply(word(x), reciprocal(word(y))), p / q, np.float32)


@pytest.mark.parametrize("dtype", UNITS)
def test_cancelling_sums_keep_their_digits(dtype):
    """What is left of two nearly equal numbers is as good as they were."""
    third = reciprocal(word(jnp.asarray(3, dtype)))
    nearly = add(third, DoubleWord(-third.high, jnp.zeros_like(third.low)))
    assert exact(nearly) == mp.mpf(float(third.low))
    whole = multiply(third, word(jnp.asarray(3, dtype)))
    assert abs(exact(whole) - 1) <= UNITS[dtype]


@pytest.mark.parametrize(("dtype", "bits"), [(np.float64, 55), (np.float32, 26)])
def test_a_sum_whose_upper_words_cancel_has_both_lower_words(dtype, bits):
    """Down to the last bit, though the lower words are as unlike as upper and lower are."""
    of = [(1.0, 2.0**-bits), (-1.0, 3 * 2.0 ** (-2 * bits))]
    x, y = (DoubleWord(*(jnp.asarray(part, dtype) for part in parts)) for parts in of)
    assert exact(add(x, y)) == exact(x) + exact(y)
