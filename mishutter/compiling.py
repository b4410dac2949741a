"""How the programs of a search are compiled: quickly, since a user waits for each once."""

from collections.abc import Callable
from functools import lru_cache, wraps
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax

from mishutter.types import is_concrete

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_OLDER_GENERATOR = {"xla_cpu_use_fusion_emitters": False}


def quick_to_compile(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """`eqx.filter_jit` by XLA's older generator of CPU code, where it may be chosen.

    It compiles these programs in two thirds of the time, and they run about as fast. XLA
    takes the choice for whole programs alone: a call of what another one traces is compiled
    as that is. What is known is computed at once, also from within another one.
    """
    plain = eqx.filter_jit(function)
    compile_with: Any = eqx.filter_jit
    quick = compile_with(function, compiler_options=_OLDER_GENERATOR)

    @wraps(function)
    def call(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        if not all(is_concrete(leaf) for leaf in jax.tree.leaves((args, kwargs))):
            return plain(*args, **kwargs)
        with jax.ensure_compile_time_eval():
            return (quick if _may_be_chosen() else plain)(*args, **kwargs)

    return call


@lru_cache
def _may_be_chosen() -> bool:
    if jax.default_backend() != "cpu":
        return False
    try:
        jax.jit(lambda: 0, compiler_options=_OLDER_GENERATOR)()
    except jax.errors.JaxRuntimeError:
        return False
    return True
