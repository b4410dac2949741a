"""A design beside its baselines: two readings, one verdict, and names that stay apart."""

import numpy as np
import pytest
from helpers_design import LIMITS

from mishutter import HannShutter, ParabolicMotion, Scene, compare
from mishutter.compare import OWN_BEST_MOTION, SAME_MOTION

ROUNDING_DB = 1e-9
OUTLIER = Scene(
    [-300.0, 0.0, 310.0, 8000.0],
    [0.333, 0.333, 0.333, 0.001],
    photon_rate=2e5,
    read_noise=4.0,
    limits=LIMITS,
)
"""Rare objects that are left behind at less loss than keeping up with them costs."""
SLOW = ParabolicMotion(acceleration=15.0 / 9e-4, half_exposure=3e-2)


@pytest.fixture(scope="module")
def table():
    return compare(OUTLIER, SLOW, {"mine": HannShutter()})


def test_its_own_best_motion_is_never_below_the_same_motion(table):
    """Also where the motion at hand gives up what the fastest object would ask for."""
    for row in table.rows:
        if row.reading == SAME_MOTION:
            own = table.row(row.name, OWN_BEST_MOTION)
            same = float(row.metrics.expected_psnr)
            assert float(own.metrics.expected_psnr) >= same - ROUNDING_DB
            assert np.isfinite(same)
