"""Designs near an earlier one, and the numbers that a page draws of a design."""

from dataclasses import replace

import numpy as np
import pytest
from support.drive import a_design

from mishutter import HannShutter, Limits, ParabolicMotion, Scene
from mishutter.evaluation.errors import spectral_levels
from mishutter.evaluation.response import kernel_phase, kernels_at_speeds
from mishutter.explore.answers import _near, _octave, _short, curves

LIMITS = Limits(
    max_stroke=60.0,
    max_top_speed=4e3,
    min_half_exposure=0.002,
    max_half_exposure=0.02,
    max_pan=500.0,
)
SCENE = Scene([-900.0, 0.0, 2300.0], photon_rate=2e5, read_noise=6.0, limits=LIMITS)


def before(half, velocity, share=0.6, scene=SCENE):
    most = scene.limits.largest_acceleration(np.asarray(half), np.asarray(velocity))
    motion = ParabolicMotion(
        acceleration=share * float(most), half_exposure=half, velocity=velocity
    )
    return a_design(HannShutter(), scene=scene, motion=motion)


@pytest.mark.parametrize(
    ("half", "change", "halves"),
    [
        (0.01, 0.8, [0.01, 0.008]),
        (0.01, 1.25, [0.01, 0.0125]),
        (0.018, 1.25, [0.018, 0.02]),
        (0.0022, 0.8, [0.0022, 0.002]),
        (0.001, 0.8, [0.002]),
        (0.03, 1.25, [0.02]),
    ],
)
def test_motions_near_an_earlier_one_take_as_much_of_the_stage(half, change, halves):
    """At its exposure and a changed one within the limits; its pan is within its own limit."""
    found = _near(SCENE, before(half, 700.0), change)
    np.testing.assert_allclose([float(each.half_exposure) for each in found], halves)
    for each in found:
        assert float(each.velocity) == 500
        most = SCENE.limits.largest_acceleration(each.half_exposure, each.velocity)
        assert float(each.acceleration) == pytest.approx(0.6 * float(most))
    still = _near(SCENE, before(half, -300.0, 0.0), change)
    assert [float(each.acceleration) for each in still] == [0.0] * len(halves)
    assert float(still[0].velocity) == -300


def test_an_exposure_that_fills_a_pixel_is_shortened():
    """By fifths, as far as the least."""
    sensor = replace(SCENE.sensor, full_well=1500.0)
    # Half of 2e5 e-/s for 2 T: 1,500 e- at 7.5 ms.
    (found,) = _near(replace(SCENE, sensor=sensor), before(0.01, 0.0), 1.0)
    assert float(found.half_exposure) == pytest.approx(0.01 * 0.8**2)
    deep = replace(SCENE, sensor=replace(SCENE.sensor, full_well=50.0))
    (found,) = _near(deep, before(0.01, 0.0), 1.0)
    assert float(found.half_exposure) == pytest.approx(0.002)


def test_lengths_are_rounded_up_to_powers_and_numbers_to_digits():
    """Infinity and NaN are none."""
    assert [_octave(x) for x in (0.0, -3.0, 0.3, 8.0, 8.1)] == [0.0, 0.0, 0.5, 8.0, 16.0]
    assert _short(np.array([1.23456789, np.inf, np.nan, -2e-9]), 3) == [1.23, None, None, -2e-9]


def test_curves_are_of_the_design():
    """Times in ms, a kernel of the slowest, a middle and the fastest, and levels by speed."""
    motion, shutter = ParabolicMotion(acceleration=2e5, half_exposure=0.006), HannShutter()
    found = curves(SCENE, motion, shutter, at_once=True)
    time = np.array(found["time"])
    np.testing.assert_allclose(time[[0, -1]], [-6.0, 6.0])
    np.testing.assert_allclose(found["profile"], shutter.transmittance(time / 6), atol=1e-4)
    along = np.array(found["path_time"]) * 1e-3
    np.testing.assert_allclose(found["path"], motion.position(along), rtol=1e-4, atol=1e-4)
    assert found["kernel_speeds"] == [0, 900, 2300]
    for speed, taps in zip((0.0, 900.0, 2300.0), found["kernels"], strict=True):
        places = found["offset"] + np.arange(len(taps)) + 0.5
        whole = np.asarray(kernels_at_speeds(shutter, motion, np.array([speed]), 128))[0]
        every = float(kernel_phase(motion, 128)) + np.arange(128) + 0.5
        assert np.sum(taps) == pytest.approx(float(shutter.efficiency()), abs=2e-3)
        assert np.sum(taps * places) == pytest.approx(np.sum(whole * every), abs=0.05)
    levels = spectral_levels(SCENE, motion, shutter)
    np.testing.assert_allclose(found["speeds"], levels.speeds, rtol=1e-5)
    np.testing.assert_allclose(found["psnr"], levels.unknown.psnr, rtol=1e-3)
    signal = np.interp(found["frequency"], levels.frequencies, levels.unknown.signal_over_noise)
    np.testing.assert_allclose(found["signal"], 10 * np.log10(signal), atol=0.02)
    assert found["frequency"][-1] == pytest.approx(levels.frequencies[-1], rel=1e-5)
