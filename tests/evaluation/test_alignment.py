"""The expected error with each speed displaced to where a decoder does best."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize
from support.designs import LIMITS

from mishutter import (
    ExpectedErrorLoss,
    HannShutter,
    ParabolicMotion,
    RectShutter,
    Scene,
    StillCamera,
    TukeyShutter,
    optimise,
)
from mishutter.evaluation.losses import value_of
from mishutter.evaluation.needs import sizes

VERTEX, FREE = ExpectedErrorLoss(), ExpectedErrorLoss(alignment="free")
LEFT_BEHIND = ParabolicMotion(acceleration=6e4, half_exposure=1.2e-2)
"""It gains 1,440 px/s: objects at 2,000 px/s have no vertex, and are placed otherwise."""
SPEEDS = np.array([-2000.0, -1100.0, 300.0, 900.0, 1900.0])
WEIGHTS = np.array([0.1, 0.3, 0.2, 0.15, 0.25])
SCENE = Scene(SPEEDS, WEIGHTS, photon_rate=3e5, read_noise=9.0, limits=LIMITS)


def _error_by_displacements(light, num_nodes=400, num_frequencies=256):
    """Mean squared error of the best filter, by sums over the exposure; white = 1."""
    nodes, weights = np.polynomial.legendre.leggauss(num_nodes)
    a, half = float(LEFT_BEHIND.acceleration), float(LEFT_BEHIND.half_exposure)
    frequency = (np.arange(num_frequencies) + 0.5) / (2 * num_frequencies)
    power = 1 / (frequency**2 + 0.01**2)
    power *= 0.2**2 / np.mean(power)
    time = half * nodes
    places = a * time**2 - SPEEDS[:, None] * time
    waves = np.exp(-2j * np.pi * frequency[:, None, None] * places)
    spectra = (waves @ (weights / 2 * light(nodes))).T * np.sinc(frequency)
    electrons = 3e5 * 2 * half
    noise = weights @ light(nodes) / 2 * 0.25 / electrons + (9.0 / electrons) ** 2
    total = WEIGHTS @ np.abs(spectra) ** 2

    def error(displacements):
        mean = WEIGHTS @ (spectra * np.exp(-2j * np.pi * np.outer(displacements, frequency)))
        left = power * (total - np.abs(mean) ** 2) + noise
        return np.mean(power * left / (power * total + noise))

    return error


def test_no_displacement_leaves_less():
    """A search by SciPy, of an error written out anew, finds the same least one."""

    def light(tau):
        return 0.5 + 0.5 * np.cos(np.pi * tau)

    a = float(LEFT_BEHIND.acceleration)
    starts = [SPEEDS**2 / (4 * a), np.zeros(5), np.array([3.0, -2.0, 1.0, 0.0, 4.0])]
    error = _error_by_displacements(light)
    found = min(minimize(error, start, tol=1e-9).fun for start in starts)
    loss = float(FREE(SCENE, LEFT_BEHIND, HannShutter()))
    assert (0.2 * loss) ** 2 == pytest.approx(found, rel=2e-4)
    assert loss < 0.98 * float(VERTEX(SCENE, LEFT_BEHIND, HannShutter()))


@pytest.mark.parametrize("motion", [LEFT_BEHIND, StillCamera(half_exposure=2e-3)])
@pytest.mark.parametrize("shutter", [RectShutter(), HannShutter(), TukeyShutter(0.3)])
def test_it_is_never_worse(motion, shutter):
    """Nor better by a plan's skips."""
    free = float(FREE(SCENE, motion, shutter))
    assert free <= float(VERTEX(SCENE, motion, shutter)) * (1 + 1e-5)
    assert free == pytest.approx(
        float(value_of(FREE, SCENE, motion, shutter, sizes(SCENE, motion))), rel=1e-6
    )


@pytest.mark.slow
def test_derivatives_follow_the_least_error():
    """By acceleration, exposure and taper, against central differences."""

    def loss(numbers):
        motion = ParabolicMotion(acceleration=6e4 * numbers[0], half_exposure=1.2e-2 * numbers[1])
        return FREE(SCENE, motion, TukeyShutter(0.6 * numbers[2]))

    with jax.enable_x64(True):
        at, step = jnp.ones(3), 1e-4
        slopes = jax.grad(loss)(at)
        for index, unit in enumerate(np.eye(3)):
            difference = (loss(at + step * unit) - loss(at - step * unit)) / (2 * step)
            assert float(slopes[index]) == pytest.approx(float(difference), rel=2e-3, abs=1e-5)


@pytest.mark.slow
def test_a_search_may_use_it():
    """Its design is at least as good by that loss as that of the vertex."""
    search = {"num_starts": 4, "max_steps": 40}
    first = optimise(SCENE, LEFT_BEHIND, TukeyShutter(0.4), **search)
    second = optimise(SCENE, LEFT_BEHIND, TukeyShutter(0.4), loss=FREE, **search)
    assert second.loss <= float(FREE(SCENE, first.motion, first.shutter)) * (1 + 1e-5)


def test_an_alignment_that_is_none():
    """Is refused by name."""
    with pytest.raises(ValueError, match=r"`ExpectedErrorLoss\(alignment=...\)` must be one of"):
        ExpectedErrorLoss(alignment="middle")
