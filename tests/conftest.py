"""Settings that every test runs under: 64-bit, no implicit promotion of types or ranks.

The annotations of the package are checked at run time (jaxtyping with beartype): a function's first
calls in each quick test, or its first traces, hold arguments and return values to their types and
shapes (`support/run_time_types.py`). Slow tests and subprocesses run the package as a user does,
unchecked.

Compiled programs are dropped after each module and kept on disk for all processes of the run.
Modules with most slow tests run first.
"""

import atexit
import gc
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

os.environ.setdefault("MPLBACKEND", "agg")
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:  # one for all workers and their subprocesses
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="mishutter-tests-")
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA writes pages for programs that it reads
# What tests compile themselves is compiled in a fifth of the time and run once or twice; programs
# of the package are compiled as everywhere. Workers find the controller's flags.
# `.ci/run` compiles tests of the kernel's digits as users' functions are.
if "XLA_FLAGS" not in os.environ:
    _ask = [sys.executable, str(Path(__file__).parent / "support" / "xla_flags.py")]
    _answer = subprocess.run(_ask, capture_output=True, text=True, check=True)
    os.environ["XLA_FLAGS"] = _answer.stdout

# A shell that runs this in the background has interrupts ignored, also in every subprocess.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

from support import run_time_types

run_time_types.check_types_of("mishutter")  # before anything imports the package

import jax  # noqa: E402
import pytest  # noqa: E402

from mishutter._core.compiling import mend_compilation_cache  # noqa: E402

gc.set_threshold(200_000)  # tracing makes many objects that live: looking at all takes a tenth
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture(scope="module", autouse=True)
def _programs_of_one_module():
    """Compiled programs go with the module that needed them: kept, they are gigabytes."""
    yield
    jax.clear_caches()


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """No module compiles a program when it is imported: an error there would lose all its tests."""
    jax.monitoring.register_event_listener(_refuse_programs)
    try:
        return (yield)
    finally:
        jax.monitoring.unregister_event_listener(_refuse_programs)


def _refuse_programs(event, **_):
    if event == "/jax/compilation_cache/compile_requests_use_cache":
        raise RuntimeError("a test module must compute in its tests and fixtures alone")


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Processes that share a cache may read an entry that another is still writing."""
    run_time_types.begin(is_checked=item.get_closest_marker("slow") is None)
    mend_compilation_cache()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Modules with most slow tests come first: workers end together."""
    slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])
