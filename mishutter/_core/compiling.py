"""How programs are compiled: quickly, since a user waits for each, and to compute things once."""

import threading
from collections.abc import Callable, Hashable
from functools import lru_cache, wraps
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from mishutter._core.checks import all_concrete, is_concrete
from mishutter._core.programs import TRACING, KeptProgram, Options, kind_of, may_be_kept

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_QUICKLY = {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 1}
_AS_IT_COMES = _QUICKLY | {"xla_backend_optimization_level": 0}


def compiled(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """`eqx.filter_jit`, with the program kept on disk where programs are.

    What is known is computed at once, also from within another program.
    """
    return _compiled(function, None)


def quick_to_compile(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """`compiled` by XLA's older generator of CPU code, lightly optimised, where it may be.

    It compiles these programs in half of the time, and they run about as fast. XLA
    takes the choice for whole programs alone: a call of what another one traces is compiled
    as that is.
    """
    return _compiled(function, _QUICKLY)


def seldom_run(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """`quick_to_compile`, and not optimised at all: for what runs a few times in a process.

    It compiles in half of the time again, and takes twice as long to run, or more.
    """
    return _compiled(function, _AS_IT_COMES)


def _compiled(
    function: Callable[_Arguments, _Result], options: Options
) -> Callable[_Arguments, _Result]:
    compile_with: Any = eqx.filter_jit
    plain = compile_with(function)
    traced: set[Hashable] = set()

    @lru_cache
    def chosen() -> Any:
        return compile_with(function, compiler_options=_taken(options))

    @lru_cache
    def kept() -> KeptProgram:
        return KeptProgram(function, _taken(options))

    def trace_alone(kind: Hashable, *args: _Arguments.args, **kwargs: _Arguments.kwargs) -> None:
        if kind not in traced:
            with TRACING:
                chosen().lower(*args, **kwargs)
            traced.add(kind)

    @wraps(function)
    def call(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        leaves, tree = jax.tree.flatten((args, kwargs))
        if not all_concrete(leaves):
            return plain(*args, **kwargs)
        if may_be_kept(leaves):
            return kept()(*args, **kwargs)
        if not _in_a_trace():
            if threading.active_count() > 1:
                trace_alone(kind_of(leaves, tree), *args, **kwargs)
            return chosen()(*args, **kwargs)
        with jax.ensure_compile_time_eval():
            return chosen()(*args, **kwargs)

    return call


def _in_a_trace() -> bool:
    return not is_concrete(jnp.zeros(()))


def computed_once(function: Callable[[], _Result], true: Array) -> _Result:
    """What a function returns, as arrays in memory: a branch that is always taken.

    Without it XLA fuses what is costly into each of its uses and does it over again there.

    Args:
        function: What is computed; arrays out.
        true: True, but not known to be so when the program is compiled; scalar.
    """
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(function))
    return jax.lax.cond(true, function, lambda: nothing)


def _taken(options: Options) -> Options:
    """Those of some options that this XLA has, on a CPU; None if there is none."""
    if options is None or jax.default_backend() != "cpu":
        return None
    if _are_known(*options):
        return options
    return {name: value for name, value in options.items() if _are_known(name)} or None


@lru_cache
def _are_known(*names: str) -> bool:
    try:
        with jax.ensure_compile_time_eval():
            jax.jit(lambda: 0, compiler_options={name: _QUICKLY[name] for name in names})()
    except jax.errors.JaxRuntimeError:
        return False
    return True
