"""Programs that are quick to compile say the same as any other, and may be transformed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter.compiling import quick_to_compile, seldom_run


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


def test_a_generator_that_xla_does_not_know_is_done_without(monkeypatch):
    """Where XLA has no such choice, the program is compiled as any other."""
    from mishutter import compiling

    compiling._takes_options.cache_clear()
    monkeypatch.setitem(compiling._QUICKLY, "xla_no_such_choice", True)
    try:
        assert not compiling._takes_options()
        assert np.isclose(quick_to_compile(_doubled_cube)(jnp.array(0.4)), 2 * np.sin(0.4) ** 3)
    finally:
        compiling._takes_options.cache_clear()
