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
    """It is demanded of every motion."""
    heat = Limit(
        "heat",
        9,
        lambda limits, motion: (
            motion.greatest_acceleration**2 * motion.half_exposure,
            np.float64(3e8),
        ),
        "heat the coil by at most {there:g}",
        "{taken:g}",
    )
    monkeypatch.setattr(limits, "LIMITS", (*LIMITS, heat))
    a, half = 3.1e5, 0.0043
    parabola = ParabolicMotion(acceleration=a, half_exposure=half)
    assert float(NARROW.demands(parabola)["heat"].taken) == pytest.approx((2 * a) ** 2 * half)


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


SEEN = {
    "stage": ({}, 0.0),
    "camera": ({"pans": "camera"}, 0.0),
    "moving frame": ({"frame_velocity": -340.0}, -340.0),
}


def _stage_stroke(limits, a, half, v):
    motion = ParabolicMotion(acceleration=a, half_exposure=half, velocity=v)
    return float(limits.of_stage(motion).stroke)


@pytest.mark.parametrize("slug", SEEN)
def test_each_number_that_the_stroke_leaves_takes_all_of_it(slug):
    """Of an acceleration, a velocity and an exposure: of paths that turn and of others."""
    given, frame = SEEN[slug]
    limits = Limits(max_stroke=31.0, max_top_speed=7e3, **given)
    for half, v in ((0.004, 900.0), (0.011, -1100.0), (0.011, 700.0), (0.009, 2500.0)):
        most = float(limits.acceleration_by_stroke(np.asarray(half), np.asarray(v)))
        by_pan = 0.0 if slug == "camera" else 2 * abs(v + frame) * half
        assert (most > 0) == (by_pan < 31)
        if most > 0:
            assert _stage_stroke(limits, most, half, v) == pytest.approx(31, rel=1e-9)
        by_speed = (7e3 - abs(v)) / (2 * half)
        of_path = float(limits.acceleration_of_path(np.asarray(half), np.asarray(v)))
        assert of_path == pytest.approx(min(most, by_speed), rel=1e-9)
        narrow = Limits(max_stroke=31.0, max_top_speed=7e3, max_acceleration=2e5, **given)
        largest = float(narrow.largest_acceleration(jnp.asarray(half), jnp.asarray(v)))
        assert largest == pytest.approx(min(of_path, 1e5), rel=1e-6)
    for a in (3e4, 2.3e5):
        half = float(limits.half_exposure_by_stroke(jnp.asarray(a)))
        assert _stage_stroke(limits, a, half, 0.0) == pytest.approx(31, rel=1e-9)
        greatest = limits.velocity_by_stroke(jnp.asarray(a), jnp.asarray(0.7 * half))
        assert (greatest is None) == (slug == "camera")
        if slug == "stage":
            assert _stage_stroke(limits, a, 0.7 * half, float(greatest)) == pytest.approx(31)
    if slug == "moving frame":  # which pans, so that without an acceleration it leaves the stroke
        straight = float(limits.half_exposure_by_stroke(jnp.asarray(0.0)))
        assert straight == pytest.approx(31 / (2 * 340))
    none = limits.half_exposure_by_stroke(jnp.asarray(0.0))
    assert np.isinf(float(none)) == (slug != "moving frame")


@pytest.mark.parametrize("pans", ["stage", "camera"])
@pytest.mark.parametrize("velocity", [0.0, 120.0, -4e3])
def test_the_fullest_motion_uses_all_that_it_may(velocity, pans):
    """It is within all limits, and at the top speed or at the end of the stroke or the exposure."""
    limits = Limits(
        max_stroke=31.0,
        max_top_speed=7e3,
        min_half_exposure=2e-3,
        max_half_exposure=0.013,
        max_pan=170.0,
        pans=pans,
    )
    motion = limits.fullest_motion(velocity)
    demands = limits.demands(motion)
    assert all(demand.is_met(1e-9) for demand in demands.values())
    shares = {name: float(each.taken / each.there) for name, each in demands.items()}
    assert float(motion.velocity) == pytest.approx(np.clip(velocity, -170, 170))
    assert shares["stroke"] == pytest.approx(1, rel=1e-6)
    if pans == "camera" or velocity == 0:
        assert shares["top_speed"] == pytest.approx(1, rel=1e-6)
    else:
        assert shares["top_speed"] > 0.95


def test_a_way_has_room_within_the_stroke_and_the_travel():
    """To single precision; what a camera turns by is the camera's."""
    assert NARROW.have_room_for(travel=47.0, stroke=31.0 * (1 + 5e-6))
    assert not NARROW.have_room_for(travel=47.0 * (1 + 5e-5), stroke=30.0)
    assert not NARROW.have_room_for(travel=30.0, stroke=31.01)
    assert Limits(max_stroke=31.0).have_room_for(travel=1e9, stroke=31.0)
    assert float(NARROW.beside(260.0).max_top_speed) == pytest.approx(6740)
    assert not Limits(max_stroke=0.0).moves
    assert Limits(max_stroke=0.0011).moves
