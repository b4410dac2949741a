"""The largest number within a limit: its value and derivatives are those of the closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter._core import largest_within_one


def _within(low, high, parameters):
    """The root of x^3 / (p q) - 1, between two ends."""
    return largest_within_one(
        low, high, parameters, function=lambda x, p: x**3 / (p["first"] * p["second"][0])
    )


def _from_numbers(numbers):
    low, high, first, second = numbers
    return _within(low, high, {"first": first, "second": (second, None), "name": "text"})


@pytest.mark.parametrize(
    ("numbers", "closed"),
    [
        ([0.1, 9.0, 4.0, 2.0], lambda n: jnp.cbrt(n[2] * n[3])),
        ([0.1, 1.5, 4.0, 2.0], lambda n: n[1]),
        ([3.0, 9.0, 4.0, 2.0], lambda n: n[0]),
        ([2.5, 2.5, 4.0, 2.0], lambda n: n[0]),
    ],
    ids=["between", "high", "low", "no interval"],
)
def test_value_and_derivatives_are_those_of_the_closed_form(numbers, closed):
    """Between the ends, at each of them, and of an interval without length."""
    numbers = jnp.array(numbers)
    for transform in (lambda f: f, jax.grad, jax.jacfwd, jax.hessian):
        np.testing.assert_allclose(
            transform(_from_numbers)(numbers), transform(closed)(numbers), rtol=1e-12, atol=1e-13
        )


def test_it_never_exceeds_the_limit():
    """Of the numbers beside a root it is the one on the side that keeps it, in both precisions."""
    for dtype in (jnp.float32, jnp.float64):
        p = jnp.linspace(0.3, 7.0, 40, dtype=dtype)
        ends = jnp.zeros((), dtype), jnp.full((), 5.0, dtype)
        root = jax.vmap(lambda q, ends=ends: largest_within_one(*ends, q, function=_quotient))(p)
        assert root.dtype == dtype
        assert np.all(np.asarray(_quotient(root, p)) <= 1)
        assert np.all(np.asarray(_quotient(jnp.nextafter(root, ends[1] + 0 * root), p)) > 1)


def _quotient(x, p):
    return x * x / p


def test_of_a_function_that_ignores_its_parameters():
    """A limit that nothing uses: the upper end, and its derivatives, whatever the parameters."""
    numbers = jnp.array([0.3, 1.7, 4.2])

    def largest(row):
        return largest_within_one(row[0], row[1], row[2], function=lambda x, _: 0 * x)

    np.testing.assert_array_equal(jax.grad(largest)(numbers), [0, 1, 0])
    np.testing.assert_array_equal(jax.jacfwd(largest)(numbers), [0, 1, 0])
