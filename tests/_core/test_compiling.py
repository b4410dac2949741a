"""Programs that are quick to compile say the same as any other, and may be transformed."""

import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter._core import compiling, programs
from mishutter._core.compiling import quick_to_compile, seldom_run
from mishutter._core.parallel import in_threads


def _doubled_cube(x, *, factor=2.0):
    return factor * jnp.sin(x) ** 3


@pytest.mark.parametrize("compiled_by", [quick_to_compile, seldom_run])
def test_a_quick_program_is_the_function(compiled_by):
    """Called by itself, in a program, differentiated or mapped, it gives the same numbers."""
    quick, x = compiled_by(_doubled_cube), jnp.linspace(0.3, 2.9, 7)
    expected = _doubled_cube(x, factor=1.7)
    assert np.allclose(quick(x, factor=1.7), expected, rtol=1e-15)
    assert np.allclose(jax.jit(lambda y: quick(y, factor=1.7))(x), expected, rtol=1e-15)
    assert np.allclose(jax.vmap(lambda y: quick(y, factor=1.7))(x), expected, rtol=1e-15)
    slope = jax.grad(lambda y: jnp.sum(quick(y)))(x)
    assert np.allclose(slope, 6 * np.sin(x) ** 2 * np.cos(x), rtol=1e-14)


@pytest.mark.parametrize("name", ["xla_no_such_choice", "xla_backend_optimization_level"])
def test_a_choice_that_xla_does_not_know_is_done_without(monkeypatch, name):
    """The others are taken, and within a trace what is known is a number all the same."""
    options = {"xla_no_such_choice": True, name: 1}
    monkeypatch.setattr(compiling, "_QUICKLY", options)
    taken = compiling._taken(options)
    assert taken == (None if name == "xla_no_such_choice" else {name: 1})
    doubled, known = quick_to_compile(_doubled_cube), jnp.array(0.4)
    found = jax.jit(lambda: np.asarray(doubled(known)))()
    assert np.isclose(found, 2 * np.sin(0.4) ** 3)


@jax.custom_jvp
def _product(x, y):
    return x * y


@_product.defjvp
def _product_jvp(primals, tangents):
    """A rule that takes its time, so that two threads meet in it."""
    time.sleep(0.1)
    (x, y), (dx, dy) = primals, tangents
    return x * y, x * dy + y * dx


@pytest.mark.parametrize("keeps", [False, True])
def test_threads_may_differentiate_one_function_at_a_time(tmp_path, monkeypatch, keeps):
    """JAX shares the rule of a mapped function among threads, and cannot trace it in two."""
    if keeps:
        monkeypatch.setattr(programs.SHELF, "folder", tmp_path)
    shared = quick_to_compile(jax.vmap(_product))

    def slope(argument):
        def slopes(x, y):
            return jax.grad(lambda *xy: jnp.sum(shared(*xy)), argument)(x, y)

        return quick_to_compile(slopes)

    x, y = jnp.array([0.3, 0.7]), jnp.array([1.1, -2.3])
    by_x, by_y, by_both = in_threads(
        lambda slopes: slopes(x, y), map(slope, [0, 1, (0, 1)]), 3, first_alone=False
    )
    for found, expected in ((by_x, y), (by_y, x), (by_both[0], y), (by_both[1], x)):
        assert np.array_equal(found, expected)
