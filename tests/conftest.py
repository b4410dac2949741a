"""Settings that every test runs under: 64-bit, no implicit promotion of types or ranks.

The package's annotations are checked at run time (jaxtyping with beartype), so a shape or
type that a docstring promises is enforced by every call a test makes.
"""

import os

os.environ.setdefault("MPLBACKEND", "agg")

from jaxtyping import install_import_hook

install_import_hook("mishutter", "beartype.beartype")

import jax  # noqa: E402 - the hook must stand before anything imports the package
import pytest  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_enable_compilation_cache", False)


@pytest.fixture(scope="module", autouse=True)
def _programs_of_one_module():
    """Compiled programs go with the module that needed them: kept, they are gigabytes."""
    yield
    jax.clear_caches()
