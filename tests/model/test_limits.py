"""One list says what the limits of a motion are called, how much of them is used, and in words."""

import re

import jax.numpy as jnp
import numpy as np
import pytest

from mishutter import FreeMotion, Limits, ParabolicMotion
from mishutter.model import LIMITS, limits
from mishutter.model.limits import Limit, PathShape
from mishutter.sweeps.grid import REASONS

NARROW = Limits(
    max_stroke=31.0,
    max_top_speed=7e3,
    min_half_exposure=2e-3,
    max_half_exposure=0.013,
    max_pan=170.0,
    max_travel=47.0,
    max_acceleration=9e5,
)
BEYOND = {
    "exposure_too_short": (3e5, 1.7e-3, 0.0),
    "exposure_too_long": (1e4, 0.0131, 0.0),
    "pan": (1e5, 0.005, -173.0),
    "top_speed": (4.4e5, 0.008, 60.0),
    "stroke": (3.2e5, 0.0102, 0.0),
    "acceleration": (4.6e5, 0.0021, 0.0),
    "travel": (2.4e5, 0.0121, 0.0),
}
"""Limit to the acceleration, the half exposure and the velocity of a parabola that exceeds it."""


@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: limit.name)
def test_a_limit_is_named_measured_and_said(limit):
    """A parabola beyond it uses more than there is, and the words hold both numbers."""
    a, half, v = BEYOND[limit.name]
    motion = ParabolicMotion(acceleration=a, half_exposure=half, velocity=v)
    demand = NARROW.demands(motion)[limit.name]
    assert not demand.is_met(1e-9)
    requirement, got = limit.words(demand)
    assert "{" not in requirement + got
    assert re.search(r"\d", got)
    of_many = NARROW.demands_of_parabolas(*(np.array([x]) for x in BEYOND[limit.name]))
    taken = np.ravel(of_many[limit.name].taken)
    np.testing.assert_allclose(taken, float(demand.taken), rtol=1e-6)


def test_reasons_keep_their_bits():
    """Stores of sweeps hold the bits of these names; a new limit takes one that none had."""
    assert REASONS[:9] == (
        "stroke",
        "top_speed",
        "exposure_too_short",
        "exposure_too_long",
        "full_well",
        "pan",
        "travel",
        "acceleration",
        "blur_too_long",
    )
    assert len(set(REASONS)) == len(REASONS)


def test_a_new_limit_is_one_entry_of_the_list(monkeypatch):
    """It is demanded of every motion, and bounds the share that a search stays within."""
    heat = Limit(
        "heat",
        9,
        lambda limits, use: (use.acceleration**2 * use.half_exposure, np.float64(3e8)),
        "heat the coil by at most {there:g}",
        "{taken:g}",
        is_solved=False,
    )
    monkeypatch.setattr(limits, "LIMITS", (*LIMITS, heat))
    a, half = 3.1e5, 0.0043
    wanted = (2 * a) ** 2 * half / 3e8
    parabola = ParabolicMotion(acceleration=a, half_exposure=half)
    numbers = (jnp.asarray(x) for x in (a, half, 0.0))
    assert float(NARROW.demands(parabola)["heat"].taken) == pytest.approx(wanted * 3e8)
    assert float(NARROW.stage_share(*numbers)) == pytest.approx(wanted)
    path = FreeMotion(accelerations=[2e5, 5e5, 2e5], half_exposure=half)
    shape = PathShape(jnp.array([2.0, 5.0, 2.0]) / 3, jnp.asarray(0.0))
    share = NARROW.stage_share(jnp.asarray(3e5), jnp.asarray(half), jnp.asarray(0.0), shape)
    steepest = float(path.greatest_acceleration)
    assert float(share) == pytest.approx(steepest**2 * half / 3e8)
