"""The door: what a sensor sees is the same however a scene, a motion and a shutter are given."""

import tracemalloc
from functools import partial

import numpy as np
import pytest
from support.helpers import ROUNDING

from mishutter import (
    DesignLoss,
    ExpectedErrorLoss,
    FirstOrderDevice,
    FreeMotion,
    HannShutter,
    KnownSpeedLoss,
    Limits,
    LinearMotion,
    ParabolicMotion,
    Scene,
    SplineShutter,
    StillCamera,
    TukeyShutter,
    WorstSpeedLoss,
    compare,
    evaluate,
    optimise,
)
from mishutter.evaluation.errors import spectral_levels

# Metrics ask for all parts at once; no other folder does.
from mishutter.evaluation.needs import EVERY_PART, ONLY_SPECTRA, Plan
from mishutter.evaluation.response import Records
from mishutter.evaluation.views import sampled_view, sensor_view
from mishutter.search.planning import plan

HALF = 0.017
DEVICE = FirstOrderDevice(rise_time=1.3e-3, fall_time=2.9e-3, transmission=0.83)
SCENE = Scene([-410.0, 0.0, 650.0, 1730.0], photon_rate=4e4, read_noise=5.0, device=DEVICE)
PANNING = ParabolicMotion(acceleration=52_000.0, half_exposure=HALF, velocity=613.0)
SMALL = Plan(128, 512, 64, 256)


def test_speeds_are_relative_to_the_sensor():
    """The velocity is taken from all speeds, the motion keeps none, and the device has acted."""
    view = sensor_view(SCENE, PANNING, TukeyShutter(0.41))
    np.testing.assert_allclose(view.scene.speeds, np.asarray(SCENE.speeds) - 613.0, rtol=ROUNDING)
    assert float(view.velocity) == 613.0
    assert float(view.motion.velocity) == 0
    np.testing.assert_allclose(view.motion.acceleration, PANNING.acceleration, rtol=ROUNDING)
    sent = DEVICE.light(TukeyShutter(0.41), HALF, np.dtype(float))
    assert view.shutter.efficiency() == sent.efficiency()


@pytest.mark.parametrize(
    "motion",
    [
        StillCamera(half_exposure=HALF),
        LinearMotion(half_exposure=HALF, velocity=-77.0),
        FreeMotion(accelerations=np.zeros(3), half_exposure=HALF, velocity=31.0),
        ParabolicMotion(acceleration=0.0, half_exposure=HALF, velocity=5.0),
    ],
    ids=["still", "line", "path", "parabola"],
)
def test_every_straight_path_is_one_motion(motion):
    """Programs meet a parabola without acceleration, whatever kind a straight path was given as."""
    view = sensor_view(SCENE, motion, HannShutter())
    assert type(view.motion) is ParabolicMotion
    assert float(view.motion.acceleration) == 0
    assert float(view.motion.half_exposure) == HALF


FAR = 1e8
"""Way of light, px, whose kernels or frequencies would take gigabytes."""
FAR_MOTIONS = {
    "stroke": ParabolicMotion(acceleration=FAR / HALF**2, half_exposure=HALF),
    "pan": LinearMotion(half_exposure=HALF, velocity=FAR / HALF),
    "path": FreeMotion(accelerations=np.array([1.0, 3.0]) * FAR / HALF**2, half_exposure=HALF),
    "speed": StillCamera(half_exposure=HALF),
}


@pytest.mark.parametrize("name", FAR_MOTIONS)
def test_light_that_travels_too_far_is_refused_before_anything_is_made(name):
    """By metrics, levels, plans and losses, in one line that names the motion."""
    speeds = [FAR / HALF, 90.0] if name == "speed" else [-700.0, 90.0]
    scene = Scene(speeds, photon_rate=4e4, read_noise=5.0, limits=Limits(max_stroke=20))
    motion, shutter, design = FAR_MOTIONS[name], HannShutter(), SplineShutter.fit(HannShutter(), 8)
    losses = (ExpectedErrorLoss(), KnownSpeedLoss(), WorstSpeedLoss(), DesignLoss())
    calls = [
        lambda: evaluate(scene, motion, shutter),
        lambda: spectral_levels(scene, motion, shutter),
        lambda: plan(scene, motion, shutter, loss=ExpectedErrorLoss()),
        lambda: compare(scene, motion, [shutter]),
        lambda: optimise(scene, motion, design, free="shutter"),
        lambda: optimise(scene, motion, design, free="shutter", loss=DesignLoss()),
        *(partial(loss, scene, motion, shutter) for loss in losses),
        lambda: (ExpectedErrorLoss() + DesignLoss())(scene, motion, shutter),
    ]
    tracemalloc.start()
    try:
        for call in calls:
            with pytest.raises(
                ValueError, match=r"^`motion` must (blur|spread light) over"
            ) as raised:
                call()
            assert "\n" not in str(raised.value)
        assert tracemalloc.get_traced_memory()[1] < 64 * 2**20
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_what_the_sensor_sees_is_seen_so_again():
    """What came through the door passes it unchanged: the response is the same to the last bit."""
    first = sensor_view(SCENE, PANNING, TukeyShutter(0.41))
    once = sampled_view(SCENE, PANNING, TukeyShutter(0.41), EVERY_PART, SMALL)
    twice = sampled_view(first.scene, first.motion, first.shutter, EVERY_PART, SMALL)
    for one, other in zip(Records.of(once), Records.of(twice), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_plan_keeps_each_speed_once():
    """On a device that follows at once a symmetric shutter folds `+s` and `-s`; a plan is kept."""
    scene = Scene([-410.0, 410.0, 90.0], [0.2, 0.3, 0.5], photon_rate=4e4, read_noise=5.0)
    motion = ParabolicMotion(acceleration=52_000.0, half_exposure=HALF)
    view = sampled_view(scene, motion, HannShutter(), ONLY_SPECTRA)
    np.testing.assert_allclose(view.scene.speeds, [90.0, 410.0])
    np.testing.assert_allclose(view.scene.weights, [0.5, 0.5])
    assert view.parts == ONLY_SPECTRA
    assert sampled_view(scene, motion, HannShutter(), ONLY_SPECTRA, SMALL).plan is SMALL
