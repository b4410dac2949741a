"""One list says what the limits of a motion are called, how much of them is used, and in words.

The largest number within a limit has the value and the derivatives of the closed form.
"""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter import Limits, ParabolicMotion
from mishutter.model import limits
from mishutter.model.limits import LIMITS, Limit, largest_within_one
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
        lambda limits, motion: (
            motion.greatest_acceleration**2 * motion.half_exposure,
            np.float64(3e8),
        ),
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


def _within(low, high, parameters):
    """The root of x^3 / (p q) - 1, between two ends."""
    return largest_within_one(
        low, high, parameters, function=lambda x, p: x**3 / (p["first"] * p["second"][0])
    )


def _from_numbers(numbers):
    low, high, first, second = numbers
    return _within(low, high, {"first": first, "second": (second, None), "name": "text"})


@pytest.mark.parametrize(
    ("numbers", "closed"),
    [
        ([0.1, 9.0, 4.0, 2.0], lambda n: jnp.cbrt(n[2] * n[3])),
        ([0.1, 1.5, 4.0, 2.0], lambda n: n[1]),
        ([3.0, 9.0, 4.0, 2.0], lambda n: n[0]),
        ([2.5, 2.5, 4.0, 2.0], lambda n: n[0]),
    ],
    ids=["between", "high", "low", "no interval"],
)
def test_value_and_derivatives_are_those_of_the_closed_form(numbers, closed):
    """Between the ends, at each of them, and of an interval without length."""
    numbers = jnp.array(numbers)
    for transform in (lambda f: f, jax.grad, jax.jacfwd, jax.hessian):
        np.testing.assert_allclose(
            transform(_from_numbers)(numbers), transform(closed)(numbers), rtol=1e-12, atol=1e-13
        )


def test_it_never_exceeds_the_limit():
    """Of the numbers beside a root it is the one on the side that keeps it, in both precisions."""
    for dtype in (jnp.float32, jnp.float64):
        p = jnp.linspace(0.3, 7.0, 40, dtype=dtype)
        ends = jnp.zeros((), dtype), jnp.full((), 5.0, dtype)
        root = jax.vmap(lambda q, ends=ends: largest_within_one(*ends, q, function=_quotient))(p)
        assert root.dtype == dtype
        assert np.all(np.asarray(_quotient(root, p)) <= 1)
        assert np.all(np.asarray(_quotient(jnp.nextafter(root, ends[1] + 0 * root), p)) > 1)


def _quotient(x, p):
    return x * x / p


def test_of_a_function_that_ignores_its_parameters():
    """A limit that nothing uses: the upper end, and its derivatives, whatever the parameters."""
    numbers = jnp.array([0.3, 1.7, 4.2])

    def largest(row):
        return largest_within_one(row[0], row[1], row[2], function=lambda x, _: 0 * x)

    np.testing.assert_array_equal(jax.grad(largest)(numbers), [0, 1, 0])
    np.testing.assert_array_equal(jax.jacfwd(largest)(numbers), [0, 1, 0])
