"""Calls in as many threads as there are idle processors, with their results in order."""

import itertools
import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache
from threading import Lock
from typing import Any, TypeVar

import jax
import numpy as np

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def num_threads(devices: np.ndarray) -> int:
    """Calls at a time: the processors that each device of these may have for itself."""
    if devices.flat[0].platform != "cpu":
        return 1
    return max(1, num_processors() // devices.size)


def num_processors() -> int:
    """Processors that this process may use."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def in_threads(
    function: Callable[[_Item], _Result],
    items: Iterable[_Item],
    count: int,
    *,
    first_alone: bool = True,
) -> Generator[_Result, None, None]:
    """A function of each item, at most `count` at a time, where and as precise as the caller is.

    The first is done alone by default: what it compiles serves all others. None is begun
    that is far ahead of what was taken, nor any more once the caller has stopped.
    """
    wide = bool(jax.config.jax_enable_x64)  # type: ignore[attr-defined]
    device = jax.config.jax_default_device  # type: ignore[attr-defined]

    def call(item: _Item) -> _Result:
        with jax.enable_x64(wide), jax.default_device(device):
            return function(item)

    left = iter(items)
    for item in itertools.islice(left, 1 if first_alone else 0):
        yield function(item)
    if count == 1:
        yield from map(function, left)
        return
    waiting: deque[Future[_Result]] = deque()
    pool = ThreadPoolExecutor(count)
    try:
        for item in left:
            waiting.append(pool.submit(call, item))
            if len(waiting) > count:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


class _Alone:
    """Who asked for BLAS in one thread, and what takes that back."""

    lock = Lock()
    num_callers = 0
    limits: Any = None


@contextmanager
def alone_in_blas() -> Iterator[None]:
    """BLAS in the calling thread alone, for all of the process, until the last caller leaves.

    On matrices of a few rows its threads take a hundred times as long to meet as to work
    where the processors are busy.
    """
    with _Alone.lock:
        _Alone.num_callers += 1
        if _Alone.num_callers == 1:
            _Alone.limits = _thread_pools().limit(limits=1, user_api="blas")
    try:
        yield
    finally:
        with _Alone.lock:
            _Alone.num_callers -= 1
            if _Alone.num_callers == 0:
                _Alone.limits.restore_original_limits()


@lru_cache
def _thread_pools() -> Any:
    """The libraries of BLAS, which are known once they are loaded: SciPy has one of its own."""
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
