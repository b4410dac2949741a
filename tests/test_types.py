"""The checks that every public name shares: what passes, and the one line of what does not."""

import jax
import numpy as np
import pytest

from mishutter.types import describe, require_key, require_positive_int


def test_a_count_is_a_plain_integer():
    """A whole number of NumPy comes back as Python's, which JAX takes for static."""
    assert type(require_positive_int("f(n=...)", np.int64(50))) is int


@pytest.mark.parametrize("count", [0, -3, 2.0, True, "4", np.array([3])])
def test_what_is_no_count(count):
    """Anything but a whole number of at least one is refused by name."""
    with pytest.raises(ValueError, match=r"`f\(n=...\)` must be a positive integer; got"):
        require_positive_int("f(n=...)", count)


@pytest.mark.parametrize("key", [None, jax.random.key(3), jax.random.PRNGKey(3)])
def test_keys(key):
    """No key, and a key of either kind, pass."""
    require_key("f(key=...)", key)


@pytest.mark.parametrize("key", [3, "x", np.zeros(2), jax.random.split(jax.random.key(1), 3)])
def test_what_is_no_key(key):
    """A seed in place of a key, and several keys, are refused by name."""
    with pytest.raises(ValueError, match=r"`f\(key=...\)` must be one key, .*; got"):
        require_key("f(key=...)", key)


def test_what_is_too_long_is_not_shown():
    """Brackets without end and digits without end are described all the same."""
    deep = []
    for _ in range(100_000):
        deep = [deep]
    assert describe(deep) == "list too long to show"
    assert describe(10**5000) == "int too long to show"
