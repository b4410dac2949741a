"""`dataclasses.replace` of what a design is made of: the numbers that it is not told stay."""

from dataclasses import replace

import equinox as eqx
import pytest
from support.cases import DEVICES, MOTIONS, SHUTTERS

from mishutter import (
    BurstMode,
    Limits,
    LinearMotion,
    Occlusion,
    Optics,
    ParabolicMotion,
    Scene,
    SecondOrderStage,
    Sensor,
    Texture,
    Tolerances,
)
from mishutter.model.scene import in_sensor_frame

SCENE = Scene(
    [0.0, 1700.0, -900.0],
    [0.5, 0.2, 0.3],
    photon_rate=3.1e5,
    read_noise=4.3,
    picture=Texture(mean_level=0.31, deviation=0.17),
    optics=Optics(cutoff_frequency=0.41, lens_blur=0.73),
    sensor=Sensor(full_well=7100.0, axis="columns", width=1930.0),
    limits=Limits(max_stroke=37.0, max_travel=81.0, stage=SecondOrderStage(bandwidth=43.0)),
    device=DEVICES["first-order"](),
    burst=BurstMode(frames_per_s=240.0, max_frames=6),
    tolerances=Tolerances(acceleration=0.02),
    occlusion=Occlusion(front_share=0.4, object_width=83.0),
    decoder_speed="known",
    motion=ParabolicMotion(acceleration=2.9e5, half_exposure=0.0105, velocity=-210.0),
)
PANNED = in_sensor_frame(SCENE, LinearMotion(half_exposure=0.01, velocity=31.0))[0]
PARTS = {
    "scene": lambda: SCENE,
    "panned": lambda: PANNED,
    "limits": lambda: PANNED.limits,
    **{
        name: lambda name=name: getattr(SCENE, name)
        for name in ("picture", "optics", "sensor", "burst", "tolerances", "occlusion")
    },
    **MOTIONS,
    **DEVICES,
    **{name: case.shutter for name, case in SHUTTERS.items()},
}


@pytest.mark.parametrize("make", PARTS.values(), ids=PARTS)
def test_nothing_replaced_is_the_same(make):
    """Every constructor takes what its object holds."""
    part = make()
    assert eqx.tree_equal(replace(part), part)


def test_a_number_of_a_scene_and_of_limits_is_replaced():
    """All others stay, the motion and the velocity of the frame among them."""
    scene = replace(SCENE, read_noise=2.0)
    assert float(scene.read_noise) == 2
    assert eqx.tree_equal(scene.motion, SCENE.motion)
    other = LinearMotion(half_exposure=0.012)
    assert eqx.tree_equal(replace(scene, motion=other).motion, other)
    limits = replace(PANNED.limits, max_stroke=3.0)
    assert (float(limits.max_stroke), float(limits.frame_velocity)) == (3, 31)
