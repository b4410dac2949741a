"""Transfer functions and their derivatives against 300-digit references over the whole domain.

The short sweep runs always; the full one of 110 points a precision is marked slow.
"""

import numpy as np
import pytest
from support.cases import QUICK, SHUTTERS
from support.helpers import (
    random_frequencies,
    random_point,
    transfer_derivative_error,
    transfer_error,
    turning_frequencies,
    turning_point,
)

FULL_SWEEP = 110
"""Points a precision, shared out among the shutters."""
DTYPES = {"float64": np.float64, "float32": np.float32}


@pytest.mark.slow
@pytest.mark.parametrize("slug", QUICK)
def test_transfer_function(slug):
    """The transfer function at any frequency, of either sign, zero included."""
    rng = np.random.default_rng(5)
    for _ in range(5):
        point = random_point(rng, np.float64, slug)
        assert transfer_error(point, random_frequencies(rng, point)) <= 1, point


@pytest.mark.slow
@pytest.mark.parametrize("slug", SHUTTERS)
def test_transfer_function_of_a_path_that_turns(slug):
    """Values and derivatives where a panel turns far and holds the stationary point, and at 0."""
    rng = np.random.default_rng(8)
    for dtype in [np.float64] * 3 + [np.float32] * (3 if slug in QUICK else 0):
        point = turning_point(rng, dtype, slug)
        frequencies = turning_frequencies(rng, point)
        assert transfer_error(point, frequencies) <= 1, (point, frequencies)
        assert transfer_derivative_error(point, frequencies) <= 1, (point, frequencies)


@pytest.mark.slow
@pytest.mark.parametrize("precision", DTYPES)
@pytest.mark.parametrize("slug", SHUTTERS)
def test_transfer_function_over_the_domain(slug, precision):
    """The full sweep: six frequencies a point, derivatives on each tenth."""
    rng, dtype = np.random.default_rng(7), DTYPES[precision]
    for index in range(FULL_SWEEP // len(SHUTTERS) + 1):
        point = random_point(rng, dtype, slug)
        frequencies = random_frequencies(rng, point)
        assert transfer_error(point, frequencies) <= 1, point
        if index % 10 == 0:
            assert transfer_derivative_error(point, frequencies) <= 1, (point, frequencies)
