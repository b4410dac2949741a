"""Metrics, captures, decoders and files of a design on a free path."""

import jax
import numpy as np
import pytest
from support.designs import SCENE
from support.time_sampling import captured_row

from mishutter import (
    FreeMotion,
    HannShutter,
    ParabolicMotion,
    StillCamera,
    TukeyShutter,
    centred_kernel,
    evaluate,
)
from mishutter.camera.capture import captured_response
from mishutter.evaluation.needs import folds_speeds

SHUTTER = TukeyShutter(0.4)
PARABOLA = ParabolicMotion(acceleration=2.1e5, half_exposure=0.01, velocity=110.0)
BENT = FreeMotion(
    accelerations=[4.2e5, 1.5e5, 0.9e5, -0.4e5, 2.6e5], half_exposure=0.01, velocity=-170.0
)


@pytest.mark.slow
def test_a_fitted_path_measures_as_its_parabola():
    """Every metric, to rounding, and the sizes that they are taken at."""
    found = evaluate(SCENE, FreeMotion.fit(PARABOLA, num_pieces=5), SHUTTER)
    expected = evaluate(SCENE, PARABOLA, SHUTTER)
    for name, value in _figures(expected).items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=1e-10, err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("accelerations", "durations"),
    [([0.0, 5000.0, 0.0], (1.0, 0.0, 2.0)), ([1e-30, 1e-30], None)],
    ids=["a piece without length", "hardly any acceleration"],
)
def test_a_path_that_does_not_bend_measures_as_a_camera_at_rest(accelerations, durations):
    """Every metric, whether the accelerations are known or traced."""

    def measured(accelerations):
        motion = FreeMotion(accelerations=accelerations, durations=durations, half_exposure=1e-3)
        return _figures(evaluate(SCENE, motion, SHUTTER))

    row = np.array(accelerations)
    expected = _figures(evaluate(SCENE, StillCamera(half_exposure=1e-3), SHUTTER))
    for found in (measured(row), jax.jit(measured)(row)):
        for name, value in expected.items():
            np.testing.assert_allclose(found[name], value, rtol=1e-10, err_msg=name)


def _figures(metrics):
    return {name: value for name, value in vars(metrics).items() if value is not None}


def test_the_response_is_that_of_small_steps_in_time():
    """Rows captured on a path that bends both ways, against the scene at each instant."""
    rows = np.random.default_rng(3).uniform(size=(2, 96))
    breaks = np.linspace(-1, 1, 6)
    speeds = [0.0, 350.0, -900.0]
    responses = np.asarray(captured_response(BENT, SHUTTER, speeds, 96))
    for speed, response in zip(speeds, responses, strict=True):
        found = np.fft.irfft(np.fft.rfft(rows) * response, 96)
        exact = captured_row(rows, BENT, SHUTTER, speed=speed, breaks=breaks)
        np.testing.assert_allclose(found, exact, atol=1e-12)


@pytest.mark.slow
def test_a_traced_path_has_the_metrics_of_a_known_one():
    """Under `jit` the signs of the accelerations are unknown, and the metrics the same."""

    @jax.jit
    def traced(accelerations):
        motion = FreeMotion(accelerations=accelerations, half_exposure=0.01, velocity=-170.0)
        measured = evaluate(SCENE, motion, SHUTTER)
        return measured.expected_psnr, measured.condition_number

    known = evaluate(SCENE, BENT, SHUTTER)
    found = traced(BENT.accelerations)
    np.testing.assert_allclose(found, (known.expected_psnr, known.condition_number), rtol=1e-9)


def test_the_blur_of_a_path_keeps_its_light():
    """The kernel that decoders of other libraries take sums to the light let through."""
    kernel = centred_kernel(BENT, SHUTTER, speed=200.0)
    np.testing.assert_allclose(np.sum(kernel), SHUTTER.efficiency(), rtol=1e-3)


@pytest.mark.parametrize(("mirrors", "row"), [(True, [3.0, 1.0, 3.0]), (False, [3.0, 1.0, 2.0])])
def test_speeds_are_folded_on_a_path_that_mirrors_itself(mirrors, row):
    """One kernel serves both directions where shutter and path are the same backwards."""
    path = FreeMotion(accelerations=row, half_exposure=0.2)
    assert folds_speeds(SCENE, path, HannShutter()) is mirrors
