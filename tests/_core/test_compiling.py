"""Programs that are quick to compile say the same as any other, and may be transformed."""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter._core import compiling
from mishutter._core.compiling import compiled, is_tracing, outside_trace
from mishutter._core.parallel import as_they_end


def _doubled_cube(x, *, factor=2.0):
    return factor * jnp.sin(x) ** 3


def test_a_program_is_the_function():
    """Called by itself, in a program, differentiated or mapped, it gives the same numbers."""
    program, x = compiled(_doubled_cube), jnp.linspace(0.3, 2.9, 7)
    expected = _doubled_cube(x, factor=1.7)
    assert np.allclose(program(x, factor=1.7), expected, rtol=1e-15)
    assert np.allclose(jax.jit(lambda y: program(y, factor=1.7))(x), expected, rtol=1e-15)
    assert np.allclose(jax.vmap(lambda y: program(y, factor=1.7))(x), expected, rtol=1e-15)
    slope = jax.grad(lambda y: jnp.sum(program(y)))(x)
    assert np.allclose(slope, 6 * np.sin(x) ** 2 * np.cos(x), rtol=1e-14)


def test_products_of_matrices_keep_their_precision():
    """In single precision a GPU rounds to three digits unless a program says otherwise."""
    program = compiled(lambda matrix, x: matrix @ x)
    matrix, x = jnp.ones((3, 3), jnp.float32), jnp.ones(3, jnp.float32)
    slope = jax.grad(lambda m, y: jnp.sum(program(m, y)))
    for function, operand in (
        (program, x),
        (jax.vmap(program, (None, 0)), jnp.ones((2, 3), jnp.float32)),
        (slope, x),
    ):
        assert "HIGHEST" in str(jax.make_jaxpr(function)(matrix, operand))
    assert "HIGHEST" not in str(jax.make_jaxpr(lambda m, y: m @ y)(matrix, x))


def test_what_is_known_in_a_trace_is_a_number():
    """A function of known numbers may decide what a program that is being traced looks like."""
    program, known = compiled(_doubled_cube), jnp.array(0.4)
    found = jax.jit(lambda: np.asarray(program(known)))()
    assert np.isclose(found, 2 * np.sin(0.4) ** 3)


def test_an_option_that_xla_does_not_know_is_done_without(monkeypatch):
    """Another XLA compiles by the options that it still has."""
    level = {"xla_backend_optimization_level": 1}
    # No installed XLA lacks one of the package's own options.
    monkeypatch.setattr(compiling, "_QUICKLY", {"xla_no_such_choice": True} | level)
    compiling._quick_options.cache_clear()
    try:
        assert np.isclose(compiled(_doubled_cube)(0.4), 2 * np.sin(0.4) ** 3)
        assert compiling._quick_options() == level
    finally:
        compiling._quick_options.cache_clear()


def test_a_function_that_fails_may_be_called_again():
    """An error while it is traced is its caller's, and leaves other functions as they were."""

    def refuses(x):
        if x.ndim == 0:
            raise ValueError("x must be a row; got a scalar.")
        return 2 * x

    program = compiled(refuses)
    with pytest.raises(ValueError, match="must be a row"):
        program(jnp.array(1.3))
    assert np.array_equal(program(jnp.array([1.3])), [2.6])
    assert not is_tracing()


@jax.custom_jvp
def _product(x, y):
    return x * y


@_product.defjvp
def _product_jvp(primals, tangents):
    """A rule that takes its time, so that two threads meet in it."""
    time.sleep(0.1)
    (x, y), (dx, dy) = primals, tangents
    return x * y, x * dy + y * dx


def test_threads_may_differentiate_one_function_at_a_time():
    """JAX shares the rule of a mapped function among threads, and cannot trace it in two."""
    shared = compiled(jax.vmap(_product))

    def slope(argument):
        def slopes(x, y):
            return jax.grad(lambda *xy: jnp.sum(shared(*xy)), argument)(x, y)

        return compiled(slopes)

    x, y = jnp.array([0.3, 0.7]), jnp.array([1.1, -2.3])
    calls = [lambda place=place: (place, slope(place)(x, y)) for place in (0, 1, (0, 1))]
    slopes = dict(as_they_end(calls, 3))
    by_both = slopes[0, 1]
    for found, expected in ((slopes[0], y), (slopes[1], x), (by_both[0], y), (by_both[1], x)):
        assert np.array_equal(found, expected)


def test_without_compiling_it_says_the_same():
    """`jax.disable_jit` runs it operation by operation, and what it calls."""
    inner = compiled(_doubled_cube)
    program, x = compiled(lambda y: inner(y) + inner(2 * y)), jnp.linspace(0.3, 2.9, 7)
    with jax.disable_jit():
        found = program(x)
    assert np.allclose(found, _doubled_cube(x) + _doubled_cube(2 * x), rtol=1e-15)
    assert not is_tracing()


def test_the_operation_that_made_a_nan_is_named():
    """`jax.debug_nans` runs a program again to find it, and leaves others alone."""
    logarithm = compiled(jnp.log)
    with jax.debug_nans(True):
        assert np.isclose(logarithm(1.7), np.log(1.7))
        with pytest.raises(FloatingPointError, match="encountered in log"):
            logarithm(-1.7)
        assert np.isclose(logarithm(2.3), np.log(2.3))


def test_a_function_of_known_numbers_may_be_called_in_a_trace():
    """Decorated so, it finds numbers there, as it does elsewhere."""

    @outside_trace()
    def whole(x):
        return float(jnp.sum(jnp.sin(x)))

    known = jnp.array([0.4, 1.3])
    expected = np.sin(0.4) + np.sin(1.3)
    assert np.isclose(jax.jit(lambda y: y * whole(known))(1.7), 1.7 * expected)
    assert np.isclose(jax.grad(lambda y: y * whole(known))(1.7), expected)
