"""Filters of scenes with a background, and the error that they are expected to leave."""

import numpy as np
import pytest
from support.cameras import camera, scene

import mishutter as ms
from mishutter.camera.capture import captured_response, captured_responses_below
from mishutter.decoding.decoders.base import blur_model
from mishutter.decoding.decoders.linear import expected_squared_error

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
def test_the_filter_leaves_the_expected_error(name):
    """The error on pictures of its scene is what `evaluate` expects of them."""
    shutter = ms.HannShutter()
    model = model_of(name, shutter)
    expected = ms.evaluate(scene(occlusion=LAYERS[name]), camera(), shutter).expected_psnr
    assert decibels(expected_squared_error(model, 1024)) == pytest.approx(float(expected), abs=0.02)


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
