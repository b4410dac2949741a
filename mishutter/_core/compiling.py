"""Compilation of the package's functions: lightly optimised, and by one thread at a time."""

import glob
import logging
import os
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache
from platformdirs import user_cache_path

from mishutter._core.checks import all_concrete, is_concrete
from mishutter._core.files import is_own_folder
from mishutter._core.parallel import num_processors

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_QUICKLY: dict[str, bool | int] = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_backend_optimization_level": 1,
    # A part of a program for each processor: more parts cost time and save none.
    "xla_cpu_parallel_codegen_split_count": min(num_processors(), 32),
}
_UNREADABLE = "Error reading persistent compilation cache entry for '"
"""Beginning of JAX's warning of an entry that it could not read; the program's name follows."""

_COMPILATION = "/jax/core/compile/backend_compile_duration"
"""JAX's event of a program that is compiled or read."""


class _Tracing(threading.local):
    """The lock of all threads, and whether this thread holds it and may trace."""

    lock = threading.Lock()
    allowed = False


_TRACING = _Tracing()


def compiled(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """`eqx.filter_jit` by XLA's older generator of CPU code, lightly optimised.

    The package's programs compile in half the time with it and run as fast. XLA takes these options
    for whole programs alone: a call inside a function that JAX traces is compiled with that
    function's options. A call with concrete arguments there is evaluated eagerly, and its result
    stays concrete.

    One thread traces at a time: JAX fails where two threads trace the same derivative rule.
    """
    function = in_full_precision(function)

    @wraps(function)
    def alone(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        with _TRACING.lock:
            _TRACING.allowed = True
            try:
                return function(*args, **kwargs)
            finally:
                _TRACING.allowed = False

    @lru_cache
    def program() -> Callable[..., _Result]:
        compile_with: Any = eqx.filter_jit
        return compile_with(alone, compiler_options=_quick_options())

    within = eqx.filter_jit(function)

    @wraps(function)
    def call(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        if _TRACING.allowed or not all_concrete((args, kwargs)):
            return within(*args, **kwargs)
        with outside_trace():
            return program()(*args, **kwargs)

    return call


def in_full_precision(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """A function whose products of matrices have the precision of their operands.

    Accelerators round operands of single precision to some three digits by default.
    """

    @wraps(function)
    def call(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        with jax.default_matmul_precision("highest"):
            return function(*args, **kwargs)

    return call


def is_tracing() -> bool:
    """Whether this thread traces a program of the package; nothing is evaluated eagerly there."""
    return _TRACING.allowed


@contextmanager
def outside_trace() -> Iterator[None]:
    """Evaluates concrete operands eagerly inside an outer trace.

    It is also a decorator, for a function whose arguments must be concrete. Outside a trace it has
    no effect: inside `jax.ensure_compile_time_eval` JAX would compile a small program for each
    operation on constants.
    """
    in_a_trace = not is_concrete(jax.lax.stop_gradient(_zero()))
    with jax.ensure_compile_time_eval() if in_a_trace else nullcontext():
        yield


@lru_cache
def _zero() -> jax.Array:
    with jax.ensure_compile_time_eval():
        return jax.device_put(np.zeros(()))


def keep_compiled_programs() -> Path | None:
    """Keeps compiled programs in the user's cache folder, for later sessions, as the command does.

    A folder that the user chose for JAX, by `JAX_COMPILATION_CACHE_DIR` or its configuration, is
    used in its place. An entry that cannot be read is written anew.

    Returns:
        The folder; None where the user has none to which nobody else can write, since its programs
        are run: nothing is kept then.
    """
    # XLA takes the preferences of some processors for missing instructions, and writes an error
    # of 4,000 letters for each program that it reads. Messages of JAX itself stay, and so does
    # a level that the user set; JAX itself sets 1.
    has_level = os.environ.get("TF_CPP_MIN_LOG_LEVEL", "1") != "1"
    if not has_level and getattr(jax.config, "jax_logging_level", None) == "NOTSET":
        jax.config.update("jax_logging_level", "CRITICAL")
        for name in ("jax", "jaxlib"):
            logging.getLogger(name).setLevel(logging.NOTSET)
    mend_compilation_cache()
    chosen = getattr(jax.config, "jax_compilation_cache_dir", None)
    if chosen is not None:
        return Path(chosen)
    folder = user_cache_path("mishutter", appauthor=False)
    if not all(is_own_folder(path) for path in (folder, folder / "jax")):
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder / "jax"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    # JAX decides at its first program whether it keeps any.
    compilation_cache.reset_cache()
    return folder / "jax"


def num_programs() -> int:
    """Number of programs that JAX has compiled, or read from its cache, since the first call."""
    return len(_programs())


@lru_cache
def _programs() -> list[float]:
    """Times that programs take, s; one is added to the list for each."""
    times: list[float] = []

    def add(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event == _COMPILATION:
            times.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(add)
    return times


def mend_compilation_cache() -> None:
    """Deletes an entry of JAX's compilation cache that cannot be read, so that it is written anew.

    A process that was killed, a full disk, and another process that is still writing leave a part
    of an entry. JAX would warn of it at every run and never replace it. The function sets a filter
    and `warnings.showwarning`, and so holds as long as the caller's `warnings.catch_warnings`.
    """
    otherwise = warnings.showwarning

    def show(message: Warning | str, *others: Any) -> None:
        _, is_unreadable, rest = str(message).partition(_UNREADABLE)
        if not is_unreadable or not _forget(rest.partition("'")[0]):
            otherwise(message, *others)

    warnings.filterwarnings("always", _UNREADABLE)
    warnings.showwarning = show


def _forget(program: str) -> bool:
    """Deletes a program's entries from JAX's compilation cache; False if that fails.

    JAX's warning comes before it compiles, and it writes what it has compiled where there is no
    entry. The warning names the program alone, whose other entries, for other shapes, go as well.
    """
    folder = Path(str(jax.config.jax_compilation_cache_dir))  # type: ignore[attr-defined]
    try:
        for entry in folder.glob(f"{glob.escape(program)}-*-cache"):
            entry.unlink(missing_ok=True)
    except OSError:
        return False
    return True


def known_options(options: Mapping[str, bool | int]) -> dict[str, bool | int]:
    """The `options` that the installed version of XLA supports."""
    known = {}
    for name, value in options.items():
        with suppress(jax.errors.JaxRuntimeError):
            jax.jit(lambda: 0, compiler_options={name: value}).lower().compile()
            known[name] = value
    return known


@lru_cache
def _quick_options() -> dict[str, bool | int]:
    """Options of `compiled` programs on a CPU; none elsewhere."""
    return known_options(_QUICKLY) if jax.default_backend() == "cpu" else {}
