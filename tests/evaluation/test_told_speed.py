"""Losses of decoders that are told a speed or find it, against sums written out with NumPy.

The sums share no code with the package and take complex numbers, so that a step along the
imaginary axis gives their derivatives to rounding (Squire and Trapp 1998). Second derivatives are
extrapolated central differences of these, right to 1e-9.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline

from mishutter import (
    AbstractLoss,
    ExpectedErrorLoss,
    FoundSpeedLoss,
    KnownSpeedLoss,
    ParabolicMotion,
    RectShutter,
    Scene,
    SplineShutter,
    StillCamera,
    Texture,
    ceiling,
    evaluate,
    example_scene,
    optimise,
)
from mishutter.evaluation.found_speed import found_share
from mishutter.evaluation.losses import value_of
from mishutter.evaluation.needs import Plan

LOSSES = {
    "told": (KnownSpeedLoss(), 1.0),
    "found": (FoundSpeedLoss(0.7), 0.7),
    "untold": (ExpectedErrorLoss(), 0.0),
}
"""Each with the share of what being told brings, in decibels."""
SPEEDS, WEIGHTS = np.array([-700.0, 250.0, 3100.0]), np.array([0.2, 0.5, 0.3])
RATE, READ_NOISE, DEVIATION, MEAN_LEVEL = 2e5, 4.0, 0.17, 0.23
SCENE = Scene(
    SPEEDS,
    WEIGHTS,
    photon_rate=RATE,
    read_noise=READ_NOISE,
    picture=Texture(deviation=DEVIATION, mean_level=MEAN_LEVEL),
)
ACCELERATION, HALF_EXPOSURE = 2.3e5, 9e-3
POINT = np.array([1.03, 0.97, 0.1, 0.55, 0.95, 0.9, 0.35])
"""Acceleration and half exposure over those above, and coefficients of a spline."""
PLAN = Plan(num_taps=120, dft_length=512, num_frequencies=64, num_nodes=256)
_GAUSS_NODES = 64


def by_loss(loss: AbstractLoss):
    """The package's loss as a function of a point."""

    def value(x):
        motion = ParabolicMotion(
            acceleration=ACCELERATION * x[0], half_exposure=HALF_EXPOSURE * x[1]
        )
        return value_of(loss, SCENE, motion, SplineShutter(x[2:]), PLAN)

    return value


def by_sums(x: np.ndarray, share: float) -> complex:
    """The same by sums over Gauss nodes, frequencies and speeds, none of which takes a modulus.

    The exposure is one at which a decoder that looks for the speed keeps a part of the share.
    """
    acceleration, half, coefficients = ACCELERATION * x[0], HALF_EXPOSURE * x[1], x[2:]
    edges = np.linspace(-1, 1, coefficients.size - 2)
    place, weight = np.polynomial.legendre.leggauss(_GAUSS_NODES)
    width = (edges[1] - edges[0]) / 2
    tau = (edges[:-1, None] + width * (1 + place)).ravel()
    knots = np.concatenate([[-1.0] * 3, edges, [1.0] * 3])
    basis = BSpline(knots, np.eye(coefficients.size), 3)(tau)
    light = (basis @ coefficients) * np.tile(weight * width / 2, edges.size - 1)
    if 0 < share < 1:
        place = (2 * half * np.sum(light) * (3100.0 - 250.0) - 29.0) / 7.0
        assert 0.1 < place.real < 0.9
        share = share * (3 - 2 * place) * place**2
    frequency = (np.arange(PLAN.num_frequencies) + 0.5) / (2 * PLAN.num_frequencies)
    power = 1 / (frequency**2 + 0.01**2)
    power *= DEVIATION**2 / np.mean(power)
    passed = power * np.sinc(frequency) ** 2
    electrons = 2 * half * RATE
    noise = np.sum(light) * MEAN_LEVEL / electrons + (READ_NOISE / electrons) ** 2
    told, mean, square = 0.0, np.zeros((2, frequency.size)), 0.0
    for speed, weight in zip(SPEEDS, WEIGHTS, strict=True):
        from_vertex = acceleration * (half * tau - speed / (2 * acceleration)) ** 2
        phase = 2 * np.pi * np.outer(frequency, from_vertex)
        response = np.stack([np.cos(phase) @ light, np.sin(phase) @ light])
        squared = np.sum(response**2, axis=0)
        told = told + weight * np.mean(power * noise / (passed * squared + noise))
        mean, square = mean + weight * response, square + weight * squared
    spread = square - np.sum(mean**2, axis=0)
    untold = np.mean(power * (passed * spread + noise) / (passed * square + noise))
    return np.exp((share * np.log(told) + (1 - share) * np.log(untold)) / 2) / DEVIATION


def slope(x: np.ndarray, share: float) -> np.ndarray:
    """Derivatives of the sums, by steps along the imaginary axis."""
    step = 1e-30
    return np.array([by_sums(x + 1j * step * e, share).imag / step for e in np.eye(x.size)])


@pytest.mark.slow
@pytest.mark.parametrize("slug", LOSSES)
def test_gradients_are_right_to_rounding(slug):
    """By acceleration, half exposure and profile, to 1e-9 of each."""
    loss, share = LOSSES[slug]
    value, gradient = jax.jit(jax.value_and_grad(by_loss(loss)))(jnp.asarray(POINT))
    np.testing.assert_allclose(value, by_sums(POINT, share), rtol=1e-12)
    np.testing.assert_allclose(gradient, slope(POINT, share), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("slug", LOSSES)
def test_hessians_are_right(slug):
    """By the same, to 1e-6 of the largest."""
    loss, share = LOSSES[slug]
    wide, narrow = (
        np.stack([slope(POINT + h * e, share) - slope(POINT - h * e, share) for e in np.eye(7)])
        / (2 * h)
        for h in (2e-4, 1e-4)
    )
    expected = (4 * narrow - wide) / 3
    hessian = jax.jit(jax.hessian(by_loss(loss)))(jnp.asarray(POINT))
    np.testing.assert_allclose(hessian, expected, atol=1e-6 * np.max(np.abs(expected)))


@pytest.mark.slow
def test_levels_of_the_built_in_scene():
    """Told, an open parabola of 38 ms is 1 dB above the design for one filter, 0.3 below all.

    Levels told are of 65 speeds, evenly over the range of the scene's nine.
    """
    scene = example_scene()
    speeds = np.linspace(np.min(scene.speeds), np.max(scene.speeds), 65)
    even = scene.without_metadata(speeds=speeds, weights=np.full(65, 1 / 65))
    design = optimise(scene)
    cameras = {
        "open": (ParabolicMotion(acceleration=44.6 / 0.019**2, half_exposure=0.019), RectShutter()),
        "design": (design.motion, design.shutter),
        "snapshot": (StillCamera(half_exposure=0.00105), RectShutter()),
    }
    told = {name: evaluate(even, *each).known_speed_psnr for name, each in cameras.items()}
    expected = {"open": 28.42, "design": 27.39, "snapshot": 25.89}
    assert {name: float(level) for name, level in told.items()} == pytest.approx(expected, abs=0.01)
    assert float(design.metrics.expected_psnr) == pytest.approx(26.87, abs=0.01)
    assert float(ceiling(scene)) == pytest.approx(28.755, abs=0.01)


def test_the_share_that_a_found_speed_keeps():
    """None up to 29 px, all of it from 36 px, between them a cubic whose slopes end in 0."""
    places = {0.0: 0.0, 29.0: 0.0, 30.75: 0.15625, 32.5: 0.5, 34.25: 0.84375, 36.0: 1.0, 90.0: 1.0}
    for difference, wanted in places.items():
        found = found_share(np.asarray(difference), 0.6)
        assert float(found) == pytest.approx(0.6 * wanted, abs=1e-12)
