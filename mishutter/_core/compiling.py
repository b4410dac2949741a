"""How the package's functions are compiled: in half of XLA's time, one thread tracing at a time."""

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from functools import lru_cache, wraps
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import numpy as np

from mishutter._core.checks import all_concrete, is_concrete
from mishutter._core.parallel import num_processors

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_QUICKLY: dict[str, bool | int] = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_backend_optimization_level": 1,
    # Each part of a program has a cost of its own: more than there are processors do not pay.
    "xla_cpu_parallel_codegen_split_count": min(num_processors(), 32),
}


class _Tracing(threading.local):
    """Whether this thread is the one that may trace, under the lock that all threads share."""

    lock = threading.Lock()
    allowed = False


_TRACING = _Tracing()


def compiled(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """`eqx.filter_jit` by XLA's older generator of CPU code, lightly optimised.

    These programs compile in half of the time so, and run as fast. XLA takes the choice for
    whole programs alone: a call within a function that JAX traces is compiled as that one is.
    Values that are known there are computed at once, and stay known.

    One thread traces at a time. Threads share what JAX knows of the functions in a program,
    among that derivative rules, and JAX fails where two of them trace one rule at once.
    """

    @wraps(function)
    def alone(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        with _TRACING.lock:
            _TRACING.allowed = True
            try:
                return function(*args, **kwargs)
            finally:
                _TRACING.allowed = False

    @lru_cache
    def program() -> Any:
        compile_with: Any = eqx.filter_jit
        return compile_with(alone, compiler_options=_quick_options())

    within = eqx.filter_jit(function)

    @wraps(function)
    def call(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        if _TRACING.allowed or not all_concrete((args, kwargs)):
            return within(*args, **kwargs)
        with at_once():
            return program()(*args, **kwargs)

    return call


def in_a_program() -> bool:
    """Whether this thread traces a program of the package, where nothing is computed at once."""
    return _TRACING.allowed


@contextmanager
def at_once() -> Iterator[None]:
    """Computes what is known while a function is traced that calls for it, and so still known.

    It also decorates a function whose arguments must be known. Nothing where none is traced: in
    `jax.ensure_compile_time_eval` a program that is traced there runs each operation on constants
    by a small program of that operation alone.
    """
    in_a_trace = not is_concrete(jax.lax.stop_gradient(_zero()))
    with jax.ensure_compile_time_eval() if in_a_trace else nullcontext():
        yield


@lru_cache
def _zero() -> jax.Array:
    with jax.ensure_compile_time_eval():
        return jax.device_put(np.zeros(()))


def known_options(options: Mapping[str, bool | int]) -> dict[str, bool | int]:
    """Those of XLA's `options` that the installed XLA knows: they come and go with its versions."""
    return {name: value for name, value in options.items() if _is_known(name, value)}


def _is_known(name: str, value: bool | int) -> bool:
    try:
        jax.jit(lambda: 0, compiler_options={name: value}).lower().compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


@lru_cache
def _quick_options() -> dict[str, bool | int]:
    """The choice, on a CPU."""
    return known_options(_QUICKLY) if jax.default_backend() == "cpu" else {}
