"""Profiles found over a grid are those that `optimise` finds, and do what is said of them."""

from typing import Any

import numpy as np
import pytest
from support.sweeps import RELATIVE, SCENE, SHUTTERS

from mishutter import (
    DesignLoss,
    ExpectedErrorLoss,
    Limits,
    ParabolicMotion,
    Scene,
    SplineShutter,
    evaluate,
    optimise,
    starting_shutter,
    sweep,
)
from mishutter.sweeps.search import later_profiles, start_boxes, starts_at

EXCESS = 1e-3
"""Loss above that of `optimise`: promised of every point."""
OWN_SIZES = 1e-3
"""Difference of a plain function: it takes no plan and picks its frequencies by what it knows of
the motion, in a search nothing but the limits. Either number of them is good to 0.01 dB."""

ASYMMETRIC = Scene([120.0, 480.0, 700.0], photon_rate=3e4, read_noise=8.0, limits=SCENE.limits)
ONE_WAY = Scene([500.0, 800.0, 1100.0], photon_rate=3e4, read_noise=8.0, limits=SCENE.limits)
SCENES = {"mixed": SCENE, "asymmetric": ASYMMETRIC, "one-way": ONE_WAY}
AXES: dict[str, Any] = {
    "accelerations": [4e4, 1.1e5, 2e5],
    "half_exposures": [3.1e-3, 5.2e-3],
    "shutters": SHUTTERS,
    "optimise": True,
    "num_coefficients": 12,
}


def test_what_a_point_starts_from():
    """Windows and a random profile of the seed, and what its neighbours found."""
    first = start_boxes(12, True, 5)
    assert not np.any(np.all(first == start_boxes(12, True, 6)[-1], axis=1))
    boxes, rows = np.full((4, 2, 6), np.nan), np.array([0, 2])
    alone = np.concatenate([first, first[1:]])
    np.testing.assert_array_equal(starts_at(first, boxes, rows, 0), [alone, alone])
    boxes[:3, 0] = np.arange(1, 4)[:, None] / 10
    later = starts_at(first, boxes, rows, 1)
    np.testing.assert_array_equal(later[:, :4], [first, first])
    np.testing.assert_array_equal(later[0, 4:, 0], [0.2, 0.1, 0.1])
    np.testing.assert_array_equal(later[1, 4:, 0], [first[1, 0], 0.2, 0.3])


def test_what_a_point_is_searched_from_again():
    """Neighbours at the next exposure and the next acceleration, as often as it takes."""
    boxes = np.full((3, 2, 4), np.nan)
    boxes[:, 1] = np.arange(1, 4)[:, None]
    boxes[2, 0] = 7
    near = later_profiles(boxes, 1, 0)
    np.testing.assert_array_equal(near[:, 0], [1, 2, 3, 7, 1, 2, 3])
    assert later_profiles(boxes, 2, 1).size == 0


@pytest.mark.slow
def test_a_profile_is_symmetric_where_all_frames_are():
    """Speeds mirror each other about the pan in their middle, and about no other."""
    few = {"accelerations": [2e5], "half_exposures": [3.1e-3], "metrics": ["expected_psnr"]}
    for velocities, symmetric in (
        (None, True),
        ([800.0], True),
        ([0.0], False),
        ([0.0, 800.0], False),
    ):
        found = sweep(ONE_WAY, **AXES | few, velocities=velocities, max_steps=2)
        kept = found.coefficients.values
        assert np.array_equal(kept, kept[..., ::-1]) == symmetric
        assert not np.any(np.isnan(kept))


@pytest.mark.slow
@pytest.mark.parametrize("slug", SCENES)
def test_losses_are_those_of_optimise(slug):
    """At points with and without neighbours; metrics and loss are of the coefficients kept."""
    scene, loss = SCENES[slug], ExpectedErrorLoss()
    found = sweep(scene, **AXES)
    start = starting_shutter(scene, 12)
    for row, column in ((0, 0), (2, 1)):
        at = found.isel(acceleration=row, half_exposure=column)
        motion = ParabolicMotion(
            acceleration=float(at.acceleration),
            half_exposure=float(at.half_exposure),
            velocity=float(at.velocity),
        )
        design = optimise(scene, motion, start, loss=loss, free="shutter")
        assert float(at.loss) - design.loss < EXCESS
        profile = SplineShutter(np.asarray(at.coefficients))
        np.testing.assert_allclose(loss(scene, motion, profile), at.loss, rtol=RELATIVE)
        psnr = float(at.expected_psnr.sel(shutter="optimised"))
        exact = evaluate(scene, motion, profile).expected_psnr
        np.testing.assert_allclose(exact, psnr, rtol=RELATIVE)


SHIVER = Limits(max_stroke=45.0, max_top_speed=2e4, min_half_exposure=5e-4, max_half_exposure=0.04)


@pytest.mark.slow
@pytest.mark.parametrize("first", [2e-3, 2.5425e-3])
def test_a_valley_that_begins_at_a_later_exposure_is_followed_back(first):
    """Where a stroke is less than a pixel, and windows and neighbours lead into others."""
    scene = Scene.uniform(
        max_speed=4500.0, num_speeds=9, photon_rate=1e5, read_noise=8.0, limits=SHIVER
    )
    axes: dict[str, Any] = {
        "accelerations": [99_377.0],
        "half_exposures": np.linspace(first, 2.74e-3, 4),
        "metrics": ["expected_psnr"],
    }
    found = sweep(scene, optimise=True, **axes)
    for at in (found.isel(acceleration=0, half_exposure=index) for index in range(4)):
        motion = ParabolicMotion(
            acceleration=float(at.acceleration), half_exposure=float(at.half_exposure)
        )
        design = optimise(scene, motion, starting_shutter(scene), free="shutter")
        assert float(at.loss) - design.loss < EXCESS


def squared(scene, motion, shutter):
    """A loss that is a plain function."""
    return ExpectedErrorLoss()(scene, motion, shutter) ** 2


LOSSES = {
    "kernels": DesignLoss(),
    "sum": ExpectedErrorLoss() + 0.3 * DesignLoss(invariance=0.0),
    "function": squared,
}


@pytest.mark.slow
@pytest.mark.parametrize("slug", LOSSES)
def test_every_loss_is_searched(slug):
    """Losses of kernels, sums and plain functions too; at rest as well."""
    loss: Any = LOSSES[slug]
    few: dict[str, Any] = {"accelerations": [0.0, 2e5], "half_exposures": [3.1e-3]}
    found = sweep(SCENE, loss=loss, **AXES | few | {"metrics": ["expected_psnr"]})
    for row in range(2):
        at = found.isel(acceleration=row, half_exposure=0)
        motion = ParabolicMotion(
            acceleration=float(at.acceleration),
            half_exposure=3.1e-3,
            velocity=float(at.velocity),
        )
        start = starting_shutter(SCENE, 12)
        design = optimise(SCENE, motion, start, loss=loss, free="shutter", num_starts=4)
        assert float(at.loss) - design.loss < EXCESS
        profile = SplineShutter(np.asarray(at.coefficients))
        near = OWN_SIZES if slug == "function" else RELATIVE
        np.testing.assert_allclose(loss(SCENE, motion, profile), at.loss, rtol=near)


@pytest.mark.slow
def test_blocks_at_a_time_change_nothing(monkeypatch):
    """Bit for bit what they are one after the other."""
    few: dict[str, Any] = AXES | {"metrics": ["expected_psnr"], "max_steps": 5}
    monkeypatch.setattr("mishutter.sweeps.grid._SEARCH_BLOCK", 1)
    found = []
    for count in (1, 3):
        monkeypatch.setattr("mishutter.sweeps.blocks.num_threads", lambda devices, n=count: n)
        found.append(sweep(SCENE, **few))
    assert found[0].identical(found[1])
