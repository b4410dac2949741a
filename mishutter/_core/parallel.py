"""Calls in as many threads as there are idle processors."""

import itertools
import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from functools import cache, lru_cache
from threading import Lock
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import jax
import numpy as np

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

_Arguments = ParamSpec("_Arguments")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def num_threads(devices: np.ndarray) -> int:
    """Number of concurrent calls: the processors that each of the `devices` may have for itself."""
    if devices.flat[0].platform != "cpu":
        return 1
    return max(1, num_processors() // devices.size)


def num_processors() -> int:
    """Processors that this process may use."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def in_threads(
    function: Callable[[_Item], _Result], items: Iterable[_Item], count: int
) -> Generator[_Result, None, None]:
    """Results of a function for each item, in order, computed by `count` threads.

    The threads take over the caller's default device and precision. The first item is computed
    alone, because all others use the programs that it compiles. At most `count` results run ahead
    of the consumer; closing the generator stops submission.
    """
    queue, call = iter(items), _as_caller(function)
    for item in itertools.islice(queue, 1):
        yield function(item)
    if count == 1:
        yield from map(function, queue)
        return
    futures: deque[Future[_Result]] = deque()
    pool = ThreadPoolExecutor(count)
    try:
        for item in queue:
            futures.append(pool.submit(call, item))
            if len(futures) > count:
                yield futures.popleft().result()
        while futures:
            yield futures.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def as_they_end(
    functions: Sequence[Callable[[], _Result]], count: int
) -> Generator[_Result, None, None]:
    """Results of functions in the order in which they end, computed by `count` threads.

    They begin in the order given. The threads take over the caller's default device and precision;
    closing the generator drops the functions that have not begun.
    """
    pool = ThreadPoolExecutor(count)
    try:
        for future in as_completed([pool.submit(_as_caller(each)) for each in functions]):
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def once(function: Callable[[], _Result]) -> Callable[[], _Result]:
    """A function that is computed by the first thread that calls it; others wait for its result."""
    lock, remembered = Lock(), cache(function)

    def call() -> _Result:
        with lock:
            return remembered()

    return call


def _as_caller(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """The function, called with the default device and precision of this thread."""
    wide = bool(jax.config.jax_enable_x64)  # type: ignore[attr-defined]
    device = jax.config.jax_default_device  # type: ignore[attr-defined]

    def call(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        with jax.enable_x64(wide), jax.default_device(device):
            return function(*args, **kwargs)

    return call


class _SingleThreadedBlas:
    """Number of callers inside `alone_in_blas`, and the limits to restore after the last."""

    lock = Lock()
    num_callers = 0
    limits: Any = None


@contextmanager
def alone_in_blas() -> Iterator[None]:
    """Restricts BLAS to the calling thread, in the whole process, until the last caller leaves.

    On a busy machine the threads of BLAS take a hundred times as long to meet as to multiply
    matrices of a few rows.
    """
    with _SingleThreadedBlas.lock:
        _SingleThreadedBlas.num_callers += 1
        if _SingleThreadedBlas.num_callers == 1:
            _SingleThreadedBlas.limits = _thread_pools().limit(limits=1, user_api="blas")
    try:
        yield
    finally:
        with _SingleThreadedBlas.lock:
            _SingleThreadedBlas.num_callers -= 1
            if _SingleThreadedBlas.num_callers == 0:
                _SingleThreadedBlas.limits.restore_original_limits()


@lru_cache
def _thread_pools() -> "ThreadpoolController":
    """The BLAS libraries of the process, SciPy's own included, which an import must load first."""
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
