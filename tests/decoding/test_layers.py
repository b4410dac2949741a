"""Filters of scenes with a background: the error that they leave in their own world and others."""

import numpy as np
import pytest
from support.cameras import camera, scene

import mishutter as ms
from mishutter.camera.capture import captured_response, captured_responses_below
from mishutter.decoding.decoders.base import blur_model
from mishutter.decoding.decoders.linear import (
    ensemble_filter,
    expected_squared_error,
    squared_error_in,
)

LAYERS = {
    "whole": None,
    "still": ms.Occlusion(front_share=0.3, object_width=80.0),
    "moving": ms.Occlusion(front_share=0.45, object_width=60.0, background="moving"),
}


def model_of(name, shutter):
    return blur_model(scene(occlusion=LAYERS[name]), camera(), shutter)


def decibels(error):
    return -10 * np.log10(error)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYERS)
def test_of_its_own_scene_it_is_the_expected_error(name):
    """The filter's error on pictures of its scene is what `evaluate` expects of them."""
    shutter = ms.HannShutter()
    model = model_of(name, shutter)
    own = squared_error_in(model, model)
    assert own == pytest.approx(expected_squared_error(model, 1024), rel=1e-9)
    expected = ms.evaluate(scene(occlusion=LAYERS[name]), camera(), shutter).expected_psnr
    assert decibels(own) == pytest.approx(float(expected), abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("world", ["still", "moving"])
def test_a_filter_is_best_in_its_own_world(world):
    """The filter of pictures that move as a whole leaves more of layers than theirs does."""
    shutter = ms.HannShutter()
    seen = model_of(world, shutter)
    own, other = squared_error_in(seen, seen), squared_error_in(model_of("whole", shutter), seen)
    assert decibels(other) < decibels(own) - 0.01


def test_the_noise_of_the_world_counts():
    """The filter of one scene leaves of another's pictures what a sum over all frequencies says."""
    shutter, length = ms.HannShutter(), 512
    filters = blur_model(scene(), camera(), shutter)
    world = blur_model(scene(photon_rate=7e4, read_noise=9.0), camera(), shutter)
    frequency = np.abs(np.fft.fftfreq(length) * length).round().astype(int)
    gain = ensemble_filter(filters, length)[frequency]
    power = world.picture_spectrum(length)[frequency]
    responses = world.responses(length)[:, frequency]
    each = power * np.abs(1 - gain * responses) ** 2 + world.noise * np.abs(gain) ** 2
    wanted = np.mean(world.weights @ each)
    assert squared_error_in(filters, world, length) == pytest.approx(wanted, rel=1e-6)


def test_fast_speeds_are_computed_at_low_frequencies_alone():
    """So many of the lowest frequencies at least are those of all, and the others are 0."""
    speeds, counts = np.array([0.0, 900.0, 4e4, 2e5]), np.array([65, 65, 9, 2])
    motion, shutter = camera(), ms.HannShutter()
    known = np.asarray(captured_response(motion, shutter, speeds.tolist(), 128))
    found = captured_responses_below(motion, shutter, speeds, 128, counts)
    for row, exact, count in zip(found, known, counts, strict=True):
        np.testing.assert_allclose(row[:count], exact[:count], atol=2e-6)
        assert np.all(row[2 * count :] == 0)


@pytest.mark.slow
def test_tolerances_change_no_filter():
    """A decoder knows the camera as it was designed, with a background as without."""
    tolerances = ms.Tolerances(acceleration=0.05)
    loose = scene(occlusion=LAYERS["still"], tolerances=tolerances)
    model = blur_model(loose, camera(), ms.HannShutter())
    for own, exact in zip(
        model.mean_and_spread(64),
        model_of("still", ms.HannShutter()).mean_and_spread(64),
        strict=True,
    ):
        np.testing.assert_allclose(own, exact, atol=1e-6)
