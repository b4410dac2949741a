"""Functions whose derivatives are finite where those of JAX are not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter._core.slopes import largest_of, length_of


@pytest.mark.parametrize("scale", [1e-200, 1.0, 1e200])
def test_a_length_and_its_slope_are_those_of_the_vector(scale):
    """Squares of its components may be 0 or infinite."""
    vectors = scale * np.array([[3.0, 0.0], [-4.0, 5.0]])
    np.testing.assert_allclose(length_of(vectors), [5 * scale, 5 * scale], rtol=1e-15)
    slope = jax.grad(lambda x: jnp.sum(length_of(x)))(jnp.asarray(vectors))
    np.testing.assert_allclose(slope, [[0.6, 0.0], [-0.8, 1.0]], rtol=1e-14)


def test_nothing_has_no_length_and_no_slope():
    """That of a square root is infinite there."""
    value, slope = jax.value_and_grad(lambda x: jnp.sum(length_of(x)))(jnp.zeros((2, 3)))
    assert value == 0
    assert not np.any(slope)


def test_of_equal_values_the_last_is_the_largest():
    """And has the slope."""
    value, slope = jax.value_and_grad(largest_of)(jnp.array([1.0, 2.0, 2.0, 0.0]))
    assert value == largest_of(np.array([1.0, 2.0, 2.0, 0.0])) == 2
    np.testing.assert_array_equal(slope, [0, 0, 1, 0])
