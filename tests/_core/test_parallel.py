"""Threads give what a loop gives, in its order and precision, and stop when it is left."""

import operator
import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from threadpoolctl import threadpool_info

from mishutter._core.parallel import alone_in_blas, as_they_end, in_threads, num_threads


@pytest.mark.parametrize("count", [1, 3])
def test_results_are_in_order(count):
    """However many at a time, of no item too."""
    assert list(in_threads(operator.neg, range(23), count)) == [-x for x in range(23)]
    assert list(in_threads(operator.neg, [], count)) == []


def test_precision_is_the_callers():
    """In 32 bits where it asks for them, though other threads have 64."""
    with jax.enable_x64(False):
        found = list(in_threads(lambda x: jnp.ones(()).dtype, range(5), 2))
    assert found == [np.float32] * 5


def test_device_is_the_callers():
    """On the one it chose, though other threads have the default."""
    other = jax.devices()[-1]
    with jax.default_device(other):
        found = list(in_threads(lambda x: jnp.ones(()).devices(), range(5), 2))
    assert found == [{other}] * 5


def test_none_is_begun_far_ahead():
    """As many as are asked for and one, so that results do not pile up."""
    begun = []
    results = in_threads(lambda x: begun.append(x), range(50), 2)
    next(results)
    next(results)
    results.close()
    assert len(begun) <= 1 + 2 + 1 + 1


def test_a_long_one_holds_up_no_other():
    """Results come as they end, in the caller's precision; an error drops what has not begun."""
    others_ended = threading.Event()
    calls = [
        lambda: others_ended.wait(timeout=600),
        *(lambda: jnp.ones(()).dtype for _ in range(9)),
    ]
    with jax.enable_x64(False):
        results = as_they_end(calls, 2)
        assert [next(results) for _ in range(9)] == [np.float32] * 9
    others_ended.set()
    assert list(results) == [True]

    begun: list[int] = []

    def fails():
        begun.append(0)
        time.sleep(0.1)
        raise OSError("no more")

    with pytest.raises(OSError, match="no more"):
        next(as_they_end([fails] * 50, 1))
    assert len(begun) < 50


def test_the_first_is_alone_and_an_error_is_the_callers():
    """What the first compiles serves the others; the rest is dropped after an error."""
    callers = []

    def of(item):
        callers.append(threading.get_ident())
        if item == 4:
            raise OSError("no more")
        return item

    results = in_threads(of, range(50), 2)
    assert [next(results) for _ in range(4)] == [0, 1, 2, 3]
    with pytest.raises(OSError, match="no more"):
        next(results)
    assert callers[0] == threading.get_ident()
    assert threading.get_ident() not in callers[1:]
    assert len(callers) < 10


def test_processors_are_shared_out():
    """Among the devices of the host; an accelerator has one caller."""
    here = np.array(jax.devices())
    assert num_threads(here) >= 1
    assert num_threads(np.repeat(here, 1000)) == 1


def _blas_threads():
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_blas_is_alone_until_the_last_caller_leaves():
    """Inside one another and side by side, in SciPy's as in NumPy's; then as many as before."""

    @alone_in_blas()
    def found(_):
        return _blas_threads()

    with alone_in_blas():
        import scipy.optimize  # noqa: F401 - which brings a BLAS of its own
    before = _blas_threads()
    with alone_in_blas():
        inside = [found(0), *in_threads(found, range(6), 2), _blas_threads()]
    assert all(set(counts) == {1} for counts in inside)
    assert _blas_threads() == before
