"""What a sweep leaves out changes nothing."""

from typing import Any

import numpy as np
import pytest
from support.plan_check import metrics_by

from mishutter import (
    RASKAR_CODE,
    ChippedShutter,
    GaussianShutter,
    HannShutter,
    Limits,
    Optics,
    Scene,
    SplineShutter,
    Texture,
    sweep,
)
from mishutter.evaluation.batch import scenes_for
from mishutter.model.motion import ParabolicMotion

RELATIVE = 1e-12
"""Difference that other nodes and another order of sums make, where nothing cancels."""
ROUNDING = 1e-13
"""The same of a response or tap, relative to the largest: what is next to zero is known to that."""

AXES: dict[str, Any] = {
    "accelerations": [0.0, 2.1e4, 1.3e5, 7e5],
    "half_exposures": [1.7e-3, 6.2e-3],
}
LIGHT: dict[str, Any] = {"photon_rate": 2e4, "read_noise": 3.0}
SPLINE = SplineShutter(0.5 + 0.45 * np.sin(1.7 * np.arange(9) + 0.3))
FAMILIES = {
    "symmetric": {"bell": GaussianShutter(0.3)},
    "any": {"flutter": ChippedShutter(RASKAR_CODE)},
}
"""Shutters for which mirrored speeds are one, and others; one more of each is below."""


def random_scenes():
    """Scenes of every kind that something can be left out of, and of none."""
    rng = np.random.default_rng(7)

    def scene(speeds, weights=None, **others: Any):
        light: dict[str, Any] = {
            "photon_rate": 10 ** rng.uniform(3, 6),
            "read_noise": rng.uniform(0, 9),
        }
        limits = Limits(max_stroke=rng.uniform(30, 40), max_half_exposure=0.03)
        return Scene(speeds, weights, limits=limits, **light | others)

    one_sided = np.sort(rng.uniform(30, 900, 4))
    return {
        "mirrored": scene(np.concatenate([-one_sided, one_sided])),
        "one-sided": scene(one_sided, rng.dirichlet(np.ones(4))),
        "repeated": scene(np.repeat(one_sided[:2], 3), rng.dirichlet(np.ones(6))),
        "absent": scene([-350.0, 0.0, 350.0, 810.0], [0.5, 0.0, 0.5, 0.0]),
        "still": scene([0.0]),
        "still-twice": scene([0.0, 0.0, 440.0], [0.3, 0.7, 0.0]),
        "unlike": scene(rng.uniform(-800, 800, 5), rng.dirichlet(np.ones(5))),
        "pictured": scene(
            rng.uniform(-300, 300, 3), picture=Texture(power_spectrum=rng.uniform(0.1, 2, 64))
        ),
        "blurred": scene(rng.uniform(-300, 300, 3), optics=Optics(cutoff_frequency=0.2)),
        "noiseless": scene([-120.0, 120.0, 240.0], read_noise=0.0),
    }


def compare_sweeps(scenes, axes, shutters):
    """Each metric at each point, against the design measured with everything computed."""
    grid = sweep(scenes, shutters=shutters, **axes)
    places = np.argwhere(grid.outside.values == 0)
    for scene_at, a_at, half_at in places:
        at = {"scene": scene_at, "acceleration": a_at, "half_exposure": half_at}
        scene = scenes[str(grid.scene.values[scene_at])]
        motion = ParabolicMotion(
            acceleration=axes["accelerations"][a_at],
            half_exposure=axes["half_exposures"][half_at],
            velocity=float(grid.velocity.values[scene_at]),
        )
        for name, shutter in shutters.items():
            point = grid.isel(at).sel(shutter=name)
            full = metrics_by(None, scene, motion, shutter)
            exact = "expected_psnr", "worst_speed_psnr", "efficiency"
            for each in (*exact, "kernel_difference", "relative_kernel_difference"):
                np.testing.assert_allclose(
                    point[each], full[each], rtol=RELATIVE, atol=ROUNDING * 1e-2, err_msg=each
                )
            least = 1 / point.condition_number.values, 1 / np.asarray(full["condition_number"])
            np.testing.assert_allclose(*least, rtol=RELATIVE, atol=ROUNDING)
            roots = np.sqrt(point.bound_share.values), np.sqrt(full["bound_share"])
            np.testing.assert_allclose(*roots, rtol=RELATIVE, atol=ROUNDING)
    return len(places)


@pytest.mark.slow
@pytest.mark.parametrize("family", ["symmetric", "any"])
def test_nothing_changes(family):
    """80 points of scenes of ten kinds, by a shutter for which speeds fold and by another."""
    assert compare_sweeps(random_scenes(), AXES, FAMILIES[family]) >= 50


def speeds_under(shutter, scene):
    """Speeds and weights that a sweep of one scene takes."""
    needed = scenes_for([scene], shutter)[0]
    return np.asarray(needed.speeds), np.asarray(needed.weights)


def test_what_is_folded():
    """Mirrored, repeated and absent speeds go."""
    scene = Scene([-350.0, 350.0, 350.0, 810.0], [0.2, 0.3, 0.5, 0.0], **LIGHT)
    symmetric, one_sided = HannShutter(), SPLINE
    for shutter, expected in (
        (symmetric, ([350.0], [1.0])),
        (one_sided, ([-350.0, 350.0], [0.2, 0.8])),
    ):
        for found, right in zip(speeds_under(shutter, scene), expected, strict=True):
            np.testing.assert_allclose(found, right)


def test_scenes_have_as_many_speeds():
    """Those of the scene with fewer are filled up by speeds without weight."""
    scenes = [Scene([0.0, 90.0, 310.0], **LIGHT), Scene([350.0], **LIGHT)]
    first, second = scenes_for(scenes, HannShutter())
    np.testing.assert_array_equal(first.speeds, [0.0, 90.0, 310.0])
    np.testing.assert_array_equal(second.speeds, [350.0] * 3)
    np.testing.assert_array_equal(second.weights, [1.0, 0.0, 0.0])


def test_speeds_that_mirror_but_for_rounding():
    """They are one size."""
    speeds = np.linspace(-0.3, 0.3, 7) * 1000
    assert np.unique(np.abs(speeds)).size > 4
    assert speeds_under(HannShutter(), Scene(speeds, **LIGHT))[0].size == 4
