"""Bounds of the motion that give way to one another: a search ends, and is certified, at a kink."""

from itertools import pairwise
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array
from support.designs import FREE_NAMES, LIMITS, MOTION

from mishutter import (
    ExpectedErrorLoss,
    HannShutter,
    Limits,
    ParabolicMotion,
    Scene,
    StillCamera,
    TukeyShutter,
    optimise,
)

# Steps of the search, checked one by one; its face returns only a finished design.
from mishutter.search.objective import AbstractObjective
from mishutter.search.solvers import Polished, certificate_at, finished, is_minimum, polish
from mishutter.search.space import Bends, design_space

FAST = Scene.uniform(
    max_speed=15000.0, num_speeds=9, photon_rate=1e5, read_noise=10.0, limits=LIMITS
)
NO_BENDS = Bends(0, np.zeros(0))
POLISHED = 1e-8
"""A polish ends where a step gains less than 1e-9 of the loss, and some steps of that remain."""


@final
class _Kinked(AbstractObjective):
    """A valley that crosses a kink at 0.4, with slopes of its own on either side."""

    left: float
    right: float

    def value(self, point: Array) -> Array:
        over = point[0] - 0.4
        slope = jnp.where(over < 0, self.left, self.right)
        return 1 + slope * over + 40 * (point[1] - 0.5 * point[0] - 0.1) ** 2

    @property
    def batches(self) -> bool:
        return False


KINK = Bends(0, np.array([0.1, 0.4]))
BOTTOM = np.array([0.4, 0.3])


@pytest.mark.parametrize(
    ("left", "right", "certificate"),
    [(-3.0, 0.7, 0.0), (0.0, 0.0, 0.0), (-3.0, -0.25, 0.25), (0.5, 2.0, 0.4), (0.1, -0.3, 0.3)],
)
def test_a_certificate_at_a_bend_is_of_both_sides(left, right, certificate):
    """None where the loss rises both ways; else how far the slope that leads down leads."""
    found = certificate_at(_Kinked(left, right), BOTTOM, KINK)
    assert found == pytest.approx(certificate, abs=1e-9)


def test_a_certificate_off_a_bend_is_of_the_side_at_hand():
    """A thousandth away from it, and where no bend is known of."""
    off = BOTTOM + np.array([-1e-3, -5e-4])
    assert certificate_at(_Kinked(-3.0, 0.7), off, KINK) == pytest.approx(0.6, abs=0.01)
    assert certificate_at(_Kinked(0.0, 0.2), BOTTOM, NO_BENDS) == pytest.approx(0.2)


@pytest.mark.parametrize(("left", "right"), [(-3.0, 0.7), (-0.2, 5.0), (-2.0, -0.001)])
@pytest.mark.parametrize("start", [(0.1, 0.9), (0.8, 0.1), (0.4 - 1e-10, 0.7)])
def test_a_polish_that_a_kink_holds_up_is_finished(left, right, start):
    """From either side, from next to the kink, and where the kink is no minimum."""
    objective = _Kinked(left, right)
    end = finished(objective, polish(objective, np.array(start), max_steps=50), KINK, max_steps=50)
    least = 1.0 if right > 0 else 1 + 0.6 * right
    assert end.loss == pytest.approx(least, rel=POLISHED)
    assert end.loss == pytest.approx(float(objective(jnp.asarray(end.point))), rel=1e-14)
    assert is_minimum(end.certificate, end.loss)


def test_a_polish_that_gave_up_is_begun_anew():
    """It goes on where it was, counts all of its steps, and keeps to the steps it may take."""
    objective, start = _Kinked(0.0, 0.0), np.array([0.2, 0.9])
    given_up = Polished(start, float(objective(jnp.asarray(start))), 1.0, np.full(7, 2.0))
    end = finished(objective, given_up, NO_BENDS, max_steps=50)
    assert is_minimum(end.certificate, end.loss)
    assert 7 < end.num_steps < 50
    assert finished(objective, given_up, NO_BENDS, max_steps=7).loss == given_up.loss


@pytest.mark.slow
def test_a_motion_that_uses_up_stroke_and_top_speed_is_a_minimum():
    """Objects that ask for all of the mechanism: both limits hold at once, and the search ends."""
    loss = ExpectedErrorLoss()
    design = optimise(FAST, MOTION, TukeyShutter(0.5), loss=loss)
    assert float(design.motion.stroke) == pytest.approx(30, rel=1e-9)
    assert float(design.motion.top_speed) == pytest.approx(2e4, rel=1e-9)
    assert design.converged, design.outcome


@pytest.mark.parametrize("seed", range(12))
def test_bends_are_where_bounds_change_their_course(seed):
    """Logarithms of both bounds are straight between neighbouring bends, and only there."""
    random = np.random.default_rng(seed)
    shortest, half_exposure = 10 ** random.uniform(-4, -2), 10 ** random.uniform(-4, -1)
    limits = Limits(
        max_stroke=10 ** random.uniform(0, 2.5),
        max_top_speed=10 ** random.uniform(3, 5),
        min_half_exposure=shortest,
        max_half_exposure=shortest * 10 ** random.uniform(0.5, 3),
    )
    scene = Scene([10 ** random.uniform(1, 5)], photon_rate=1e5, read_noise=1.0, limits=limits)
    motion = ParabolicMotion(acceleration=10 ** random.uniform(3, 6), half_exposure=half_exposure)
    pans = bool(seed % 2)
    names = FREE_NAMES[1:] if pans else FREE_NAMES[1::2]
    space = design_space(scene, motion, HannShutter(), names)
    assert space.bends.coordinate == 0

    @jax.jit
    @jax.vmap
    def bounds(share):
        boxes = [jnp.stack([share, *[0.5] * pans, end]) for end in (0.0, 1.0)]
        ends = [space.at(point)[1].acceleration for point in boxes]
        return jnp.log(jnp.stack(ends))

    edges = np.concatenate([[0.0], np.unique(space.bends.places), [1.0]])
    for begin, end in pairwise(edges):
        found = np.asarray(bounds(np.linspace(begin, end, 7)))
        np.testing.assert_allclose(np.diff(found, 2, axis=0), 0, atol=1e-9)


def test_bends_of_a_stage_are_where_its_bounds_have_a_kink():
    """Travel, acceleration and top speed limit the strongest motion in turn as exposures grow."""
    limits = Limits(
        max_stroke=40.0,
        max_travel=55.0,
        max_acceleration=9e5,
        max_top_speed=6e3,
        min_half_exposure=5e-4,
        max_half_exposure=0.1,
    )
    scene = Scene([900.0, -900.0], photon_rate=1e5, read_noise=1.0, limits=limits)
    motion = ParabolicMotion(acceleration=9e4, half_exposure=0.012)
    space = design_space(scene, motion, HannShutter(), FREE_NAMES[1::2])
    shares = np.linspace(0, 1, 801)

    @jax.jit
    @jax.vmap
    def strongest(share):
        return jnp.log(space.at(jnp.stack([share, jnp.ones(())]))[1].acceleration)

    curved = np.abs(np.diff(np.asarray(strongest(shares)), 2))
    beside = np.maximum(np.roll(curved, 3), np.roll(curved, -3))
    kinks = shares[1:-1][(curved > 10 * beside) & (curved > 1e-4)]
    away = np.abs(kinks[:, None] - space.bends.places).min(axis=1)
    assert kinks.size > 0
    assert away.max() < 2 / 800


def test_only_a_motion_that_is_free_bends():
    """With one of exposure and acceleration, or a camera at rest, bounds are plain numbers."""
    still = StillCamera(half_exposure=1e-3)
    spaces = (
        design_space(FAST, MOTION, TukeyShutter(0.3), ("shutter", "acceleration")),
        design_space(FAST, MOTION, HannShutter(), "half_exposure"),
        design_space(FAST, still, HannShutter(), "half_exposure"),
    )
    assert not any(space.bends.places.size for space in spaces)
    joint = design_space(FAST, MOTION, TukeyShutter(0.3), FREE_NAMES)
    assert joint.bends.coordinate == 1
    assert joint.bends.places.size
