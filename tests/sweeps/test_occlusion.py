"""Sweeps of scenes with a background: every point is what `evaluate` measures there."""

import equinox as eqx
import numpy as np
import pytest

from mishutter import (
    ExpectedErrorLoss,
    HannShutter,
    Limits,
    LinearMotion,
    Occlusion,
    ParabolicMotion,
    RectShutter,
    Scene,
    SplineShutter,
    TukeyShutter,
    evaluate,
    gain_over_snapshot,
    sweep,
)
from mishutter.sweeps.trade_offs import best_snapshots

AGREEMENT = 1e-4
"""dB: to which a sweep and `evaluate` agree, which take the same sizes."""
LIMITS = Limits(
    max_stroke=37.0, max_top_speed=1.3e4, min_half_exposure=4e-4, max_half_exposure=0.011
)
ACCELERATIONS, HALVES = [0.0, 3.1e5], [7e-4, 8.9e-3]
LAYERS = {
    "still": Occlusion(front_share=0.43, object_width=61.0),
    "moving": Occlusion(front_share=0.37, object_width=83.0, background="moving"),
    "without-edges": Occlusion(front_share=0.57),
}


def scene_before(name, speeds=(-3100.0, -1300.0, 1300.0, 3100.0), **others):
    layers = LAYERS[name]
    numbers = {"photon_rate": 1.3e5, "read_noise": 7.1, "limits": LIMITS}
    return Scene(list(speeds), **numbers | others, occlusion=layers)


def swept_over(scenes, accelerations, half_exposures, shutters, velocities=(0.0,), **others):
    """A sweep of what a background changes, and of the bound, which it does not."""
    return sweep(
        scenes,
        accelerations=accelerations,
        half_exposures=half_exposures,
        velocities=list(velocities),
        shutters=shutters,
        metrics=["expected_psnr", "bound_share"],
        **others,
    )


def points(dataset, scene, shutters):
    """Differences of a sweep from `evaluate` at every other point, as on a chessboard; dB."""
    found = []
    for name, shutter in shutters.items():
        for row, a in enumerate(dataset.acceleration.values):
            for half in dataset.half_exposure.values[row % 2 :: 2]:
                at = dataset.sel(acceleration=a, half_exposure=half, shutter=name)
                level = float(at.expected_psnr)
                if np.isnan(level):
                    continue
                motion = ParabolicMotion(
                    acceleration=a, half_exposure=half, velocity=float(at.velocity)
                )
                own = evaluate(scene, motion, shutter)
                assert float(at.bound_share) == pytest.approx(float(own.bound_share), rel=1e-6)
                found.append(level - float(own.expected_psnr))
    return np.array(found)


SWEPT = {
    "still": (HannShutter(), ACCELERATIONS, HALVES),
    "moving": (RectShutter(), ACCELERATIONS[1:], HALVES[1:]),
    "without-edges": (SplineShutter([0.2, 0.9, 1.0, 0.4, 0.7]), ACCELERATIONS[1:], HALVES[1:]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SWEPT)
def test_a_sweep_is_what_evaluate_measures(name):
    """Whether or not speeds fold, with edges or without, of symmetric shutters and of others."""
    shutter, accelerations, halves = SWEPT[name]
    scene, shutters = scene_before(name), {"own": shutter}
    swept = swept_over(scene, accelerations, halves, shutters)
    differences = points(swept.isel(velocity=0), scene, shutters)
    assert differences.size == len(accelerations)
    np.testing.assert_allclose(differences, 0, atol=AGREEMENT)


@pytest.mark.slow
def test_a_sweep_that_pans_is_what_evaluate_measures():
    """A still background moves for a sensor that pans, and folds no speeds there."""
    scene = scene_before("still", speeds=(-700.0, 1100.0, 2900.0))
    shutters, velocities = {"tukey": TukeyShutter(0.41)}, [0.0, 1100.0]
    swept = swept_over(scene, ACCELERATIONS[:1], HALVES[:1], shutters, velocities=velocities)
    for index in range(2):
        differences = points(swept.isel(velocity=index), scene, shutters)
        assert differences.size == 1
        np.testing.assert_allclose(differences, 0, atol=AGREEMENT)


@pytest.mark.slow
def test_scenes_of_one_sweep_may_differ_in_their_layers():
    """Scenes with a background, and one that moves as a whole, keep their own levels."""
    scenes = {name: scene_before(name) for name in ("still", "moving")}
    scenes["whole"] = eqx.tree_at(lambda s: s.occlusion, scenes["still"], None)
    shutters = {"hann": HannShutter()}
    swept = swept_over(scenes, ACCELERATIONS[1:2], HALVES[:1], shutters)
    for name, scene in scenes.items():
        differences = points(swept.sel(scene=name).isel(velocity=0), scene, shutters)
        np.testing.assert_allclose(differences, 0, atol=AGREEMENT)


@pytest.mark.parametrize(("name", "rate"), [("still", 1.3e5), ("moving", 1.1e6)])
@pytest.mark.slow
def test_the_best_snapshot_before_a_background_is_what_evaluate_measures(name, rate):
    """Its level is that of its exposure and pan, and no exposure near it is better."""
    scene = scene_before(name, speeds=(-900.0, 700.0, 2300.0))
    best = best_snapshots(scene, [1.3e5, 1.1e6]).sel(photon_rate=rate).isel(read_noise=0)
    half, velocity = float(best.half_exposure), float(best.velocity)
    lit = eqx.tree_at(lambda s: s.photon_rate, scene, np.asarray(rate))

    def level(half, velocity):
        motion = LinearMotion(half_exposure=half, velocity=velocity)
        return float(evaluate(lit, motion, RectShutter()).expected_psnr)

    own = level(half, velocity)
    assert float(best.expected_psnr) == pytest.approx(own, abs=AGREEMENT)
    for factor, step in ((1.07, 0.0), (0.93, 0.0), (1.0, 60.0), (1.0, -60.0)):
        assert level(half * factor, velocity + step) < own + AGREEMENT


@pytest.mark.slow
def test_the_best_profiles_of_a_sweep_are_measured_before_the_background():
    """The search of a sweep knows of it: losses and levels are those of the profiles."""
    scene, loss = scene_before("moving", speeds=(-2300.0, 2300.0)), ExpectedErrorLoss()
    swept = swept_over(scene, [2.9e5], [6.1e-3], {"rect": RectShutter()}, optimise=True)
    at = swept.isel(velocity=0, acceleration=0, half_exposure=0)
    motion = ParabolicMotion(acceleration=2.9e5, half_exposure=6.1e-3)
    profile = SplineShutter(np.asarray(at.coefficients))
    best, rect = (float(at.expected_psnr.sel(shutter=n)) for n in ("optimised", "rect"))
    assert best > rect
    own = float(evaluate(scene, motion, profile).expected_psnr)
    assert best == pytest.approx(own, abs=AGREEMENT)
    assert float(at.loss) == pytest.approx(float(loss(scene, motion, profile)), rel=1e-5)


@pytest.mark.slow
def test_gains_of_a_sweep_are_over_the_best_snapshot_before_the_background():
    """Both levels are of the same scene."""
    scene = scene_before("still")
    swept = swept_over(scene, [1.7e5], [4.3e-3], {"hann": HannShutter()})
    level = float(best_snapshots(scene).expected_psnr[0, 0])
    gain = gain_over_snapshot(swept, scene)
    wanted = float(swept.expected_psnr.squeeze()) - level
    assert float(gain.squeeze()) == pytest.approx(wanted, abs=1e-9)
