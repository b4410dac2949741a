"""Every integral against 120-digit references over the whole domain.

The short sweep runs always; the full one of 2,000 points a precision is marked slow. Seeds
are fixed, so a failure names its point and can be repeated.
"""

import numpy as np
import pytest
from cases import SHUTTERS
from helpers import (
    ARGUMENTS,
    computed,
    derivative_error,
    edge_at_vertex,
    exact_taps,
    random_frequencies,
    random_point,
    tap_error,
    transfer_error,
)

FULL_SWEEP = 2000
"""Points a precision, shared out among the shutters."""
QUICK = ["hann", "flutter", "spline"]
DTYPES = {"float64": np.float64, "float32": np.float32}


def check(point, arguments=ARGUMENTS):
    dtype = point.taps.dtype.type
    taps, derivatives = computed(point)
    exact = exact_taps(point)
    assert taps.dtype == dtype
    assert np.all(taps >= 0), point
    assert tap_error(taps, exact, dtype) <= 1, point
    for argument in arguments:
        if argument == "position" and edge_at_vertex(point):
            continue
        column = derivatives[:, ARGUMENTS.index(argument)]
        assert derivative_error(column, point, argument, max(exact)) <= 1, (argument, point)


@pytest.mark.parametrize("slug", QUICK)
def test_taps_and_derivatives(slug):
    """Taps and their derivatives by every argument, at 20 points of each kind of shutter."""
    rng = np.random.default_rng(11)
    for _ in range(20):
        check(random_point(rng, np.float64, slug))


@pytest.mark.slow
@pytest.mark.parametrize("precision", DTYPES)
@pytest.mark.parametrize("slug", SHUTTERS)
def test_taps_and_derivatives_over_the_domain(slug, precision):
    """The full sweep: every tap, and on each tenth point every derivative."""
    if precision == "float32" and slug == "gaussian-narrow":
        pytest.skip("its tails multiply the rounding of time by 360: see GaussianShutter")
    rng = np.random.default_rng(2)
    for index in range(FULL_SWEEP // len(SHUTTERS) + 1):
        point = random_point(rng, DTYPES[precision], slug)
        check(point, ARGUMENTS if index % 10 == 0 else ())


@pytest.mark.parametrize("slug", QUICK)
def test_transfer_function(slug):
    """The transfer function at any frequency, of either sign, zero included."""
    rng = np.random.default_rng(5)
    for _ in range(5):
        point = transferable(rng, np.float64, slug)
        assert transfer_error(point, random_frequencies(rng)) <= 1, point


@pytest.mark.slow
@pytest.mark.parametrize("precision", DTYPES)
@pytest.mark.parametrize("slug", SHUTTERS)
def test_transfer_function_over_the_domain(slug, precision):
    """The full sweep: six frequencies at every point, strokes to 1e4 px."""
    rng, dtype = np.random.default_rng(7), DTYPES[precision]
    for _ in range(FULL_SWEEP // len(SHUTTERS) + 1):
        point = transferable(rng, dtype, slug)
        assert transfer_error(point, random_frequencies(rng, dtype)) <= 1, point


def transferable(rng, dtype, slug):
    """A random point whose stroke is one that the transfer function is promised for."""
    while (point := random_point(rng, dtype, slug)).stroke > 1e4:
        pass
    return point
