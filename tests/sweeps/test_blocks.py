"""Profiles found over a grid are those that `optimise` finds, and do what is said of them."""

import itertools
from contextlib import contextmanager
from types import SimpleNamespace
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

SAME_SEARCH = 1e-9
"""Difference from the loss of `optimise`, as a share of it: each point is its search."""
OWN_SIZES = 1e-4
"""Difference of a plain function: it takes no plan, and in a search its frequencies are more than
those that it picks by a motion that it knows."""
FROM_LOWEST = 2e-3
"""How far above the lowest minimum known a search may end, as a share of it."""

ASYMMETRIC = Scene([120.0, 480.0, 700.0], photon_rate=3e4, read_noise=8.0, limits=SCENE.limits)
PANNED = Limits(
    max_stroke=9.0,
    max_top_speed=4e3,
    min_half_exposure=1e-3,
    max_half_exposure=0.02,
    pans="camera",
)
ONE_WAY = Scene([500.0, 800.0, 1100.0], photon_rate=3e4, read_noise=8.0, limits=PANNED)
SCENES = {
    "mixed": (SCENE, [(0, 0), (2, 1)]),
    "asymmetric": (ASYMMETRIC, [(2, 1)]),
    "one-way": (ONE_WAY, [(0, 0)]),
}
"""Scenes, and points of the grid that are searched alone too."""
AXES: dict[str, Any] = {
    "accelerations": [4e4, 1.1e5, 2e5],
    "half_exposures": [3.1e-3, 5.2e-3],
    "shutters": SHUTTERS,
    "optimise": True,
    "num_coefficients": 12,
}


@pytest.mark.slow
def test_a_profile_is_symmetric_where_the_speeds_of_its_frame_are():
    """Speeds mirror each other about the pan in their middle, and about no other."""
    few = {"accelerations": [2e5], "half_exposures": [3.1e-3], "metrics": ["expected_psnr"]}
    for velocities, symmetric in ((None, [True]), ([0.0, 800.0], [False, True])):
        found = sweep(ONE_WAY, **AXES | few, velocities=velocities, max_steps=2)
        coefficients = found.coefficients.values.reshape(len(symmetric), -1)
        assert not np.any(np.isnan(coefficients))
        mirrors = [np.array_equal(row, row[::-1]) for row in coefficients]
        assert mirrors == symmetric


@pytest.mark.slow
@pytest.mark.parametrize("slug", SCENES)
def test_losses_are_those_of_optimise(slug):
    """At points with and without neighbours; metrics and loss are of the coefficients kept."""
    (scene, points), loss = SCENES[slug], ExpectedErrorLoss()
    found = sweep(scene, **AXES)
    start = starting_shutter(scene, 12)
    for row, column in points:
        at = found.isel(acceleration=row, half_exposure=column)
        motion = ParabolicMotion(
            acceleration=float(at.acceleration),
            half_exposure=float(at.half_exposure),
            velocity=float(at.velocity),
        )
        design = optimise(scene, motion, start, loss=loss, free="shutter")
        np.testing.assert_allclose(at.loss, design.loss, rtol=SAME_SEARCH)
        assert bool(at.converged) == design.converged
        profile = SplineShutter(np.asarray(at.coefficients))
        np.testing.assert_allclose(loss(scene, motion, profile), at.loss, rtol=RELATIVE)
        psnr = float(at.expected_psnr.sel(shutter="optimised"))
        exact = evaluate(scene, motion, profile).expected_psnr
        np.testing.assert_allclose(exact, psnr, rtol=RELATIVE)


WIDE = Limits(max_stroke=45.0, max_top_speed=2e4, min_half_exposure=5e-4, max_half_exposure=0.04)
LOPSIDED = Scene(
    [-300.0, 100.0, 1500.0], [0.1, 0.5, 0.4], photon_rate=3e4, read_noise=4.0, limits=WIDE
)
FAST = Scene.uniform(max_speed=2800.0, photon_rate=1e5, read_noise=8.0, limits=WIDE)
SHIVER = Scene.uniform(max_speed=4500.0, photon_rate=1e5, read_noise=8.0, limits=WIDE)
VALLEYS = {
    "lopsided": (LOPSIDED, 1e4, 8e-3, 0.4793449),
    "fast": (FAST, 4.1e4, 3.3e-3, 0.7427853),
    "shiver": (SHIVER, 99_377.0, 2.5425e-3, 0.7467881),
}
"""Scenes, accelerations and half exposures whose losses have many minima, and the lowest known."""


@pytest.mark.slow
@pytest.mark.parametrize("slug", VALLEYS)
def test_the_lowest_of_many_minima_is_found_in_a_sweep_too(slug):
    """To 0.2 % of the loss, whether or not neighbours are swept with a point."""
    scene, acceleration, half_exposure, lowest = VALLEYS[slug]
    axes: dict[str, Any] = {
        "accelerations": [acceleration / 2, acceleration],
        "half_exposures": [half_exposure],
        "metrics": ["expected_psnr"],
    }
    found = sweep(scene, optimise=True, **axes)
    assert bool(found.converged.all())
    assert float(found.loss[1, 0]) < lowest * (1 + FROM_LOWEST)


@pytest.mark.slow
def test_a_point_that_did_not_converge_is_marked():
    """Where the steps are used up, and nowhere outside the limits."""
    axes: dict[str, Any] = {
        "accelerations": [1e4, 2e6],
        "half_exposures": [8e-3],
        "metrics": ["expected_psnr"],
    }
    for max_steps, converged in ((1, False), (300, True)):
        found = sweep(LOPSIDED, optimise=True, **axes, max_steps=max_steps)
        assert found.converged.values.tolist() == [[converged], [False]]
        assert np.isfinite(found.loss.values[:, 0]).tolist() == [True, False]


NUM_RANDOM = 4


@pytest.mark.slow
@pytest.mark.parametrize("number", range(NUM_RANDOM))
def test_random_points_are_as_low_as_a_search_from_many_more_starts(number):
    """Both ways within 0.2 % of the loss: of random speeds, light, strokes and exposures."""
    random = np.random.default_rng([37, number])
    speeds = np.sort(random.uniform(-4e3, 4e3, 3 + number % 4))
    if number % 2:
        speeds = np.linspace(-abs(speeds[0]), abs(speeds[0]), 2 * speeds.size - 1)
    rate, noise = 10 ** random.uniform(3.5, 6), random.uniform(1, 12)
    scene = Scene(speeds, photon_rate=rate, read_noise=noise, limits=WIDE)
    half = 10 ** random.uniform(0.7, 1.7) / np.ptp(speeds) * 2
    acceleration = 10 ** random.uniform(-0.5, 1.4) / half**2
    found = sweep(
        scene,
        accelerations=[acceleration],
        half_exposures=[half],
        optimise=True,
        metrics=["expected_psnr"],
    )
    motion = ParabolicMotion(
        acceleration=acceleration, half_exposure=half, velocity=float(found.velocity)
    )
    design = optimise(scene, motion, starting_shutter(scene), free="shutter", num_starts=48)
    np.testing.assert_allclose(float(found.loss[0, 0]), design.loss, rtol=FROM_LOWEST)


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
    """Losses of kernels, sums and plain functions too; of what is no sum at rest as well.

    The loss that the sweep tells of a profile that moves is that profile's.
    """
    loss: Any = LOSSES[slug]
    accelerations = [2e5] if slug == "sum" else [0.0, 2e5]
    few: dict[str, Any] = {"accelerations": accelerations, "half_exposures": [3.1e-3]}
    found = sweep(SCENE, loss=loss, **AXES | few | {"metrics": ["expected_psnr"]})
    for row in range(len(accelerations)):
        at = found.isel(acceleration=row, half_exposure=0)
        motion = ParabolicMotion(
            acceleration=float(at.acceleration),
            half_exposure=3.1e-3,
            velocity=float(at.velocity),
        )
        start = starting_shutter(SCENE, 12)
        design = optimise(SCENE, motion, start, loss=loss, free="shutter")
        np.testing.assert_allclose(at.loss, design.loss, rtol=SAME_SEARCH)
    profile = SplineShutter(np.asarray(at.coefficients))
    near = OWN_SIZES if slug == "function" else RELATIVE
    np.testing.assert_allclose(loss(SCENE, motion, profile), at.loss, rtol=near)


def test_each_point_is_searched_from_the_seed_of_the_sweep(monkeypatch):
    """With the steps and the coefficients that were asked for, too."""
    asked = []

    def searched(start, settings):
        size = start.shutter.num_coefficients
        asked.append((settings.seed, settings.max_steps, size))
        return SimpleNamespace(command=start.shutter, loss=0.3, converged=True)

    # The profiles of a search hardly depend on its seed, and take seconds.
    monkeypatch.setattr("mishutter.sweeps.blocks.best_design", searched)
    few = {"metrics": ["efficiency"], "shutters": {"rect": SHUTTERS["rect"]}}
    for seed in (5, 11):
        sweep(SCENE, **AXES | few, seed=seed, max_steps=seed + 2)
    assert asked == [(5, 7, 12)] * 6 + [(11, 13, 12)] * 6


@pytest.mark.slow
def test_a_seed_draws_the_starts_of_a_search():
    """After one step the best design and profile are those of other starts; equal seeds agree."""
    motion = ParabolicMotion(acceleration=4e4, half_exposure=3.1e-3)
    few = {"max_steps": 1, "num_coefficients": 8}
    point = {"accelerations": [4e4], "half_exposures": [3.1e-3], "metrics": ["efficiency"]}
    searches = {
        "optimise": lambda seed: optimise(SCENE, motion, seed=seed, num_starts=3, **few).loss,
        "sweep": lambda seed: float(sweep(SCENE, **AXES | point | few, seed=seed).loss.item()),
    }
    for name, loss in searches.items():
        one, same, other = (loss(seed) for seed in (1, 1, 2))
        assert one == same, name
        assert abs(one - other) > 1e-4 * one, name


@pytest.mark.slow
def test_blocks_at_a_time_change_nothing(monkeypatch):
    """Bit for bit what they are one after the other."""
    few: dict[str, Any] = AXES | {"metrics": ["expected_psnr"], "max_steps": 5}
    # Blocks of the package's own size would take several hundred searches, and the number of
    # threads is that of the machine.
    monkeypatch.setattr("mishutter.sweeps.grid._SEARCH_BLOCK", 1)
    found = []
    for count in (1, 3):
        monkeypatch.setattr("mishutter.sweeps.blocks.num_threads", lambda devices, n=count: n)
        found.append(sweep(SCENE, **few))
    assert found[0].identical(found[1])


@pytest.mark.slow
def test_a_search_tells_its_points_before_their_block_is_whole():
    """One after the other, and the block at its end, outside the limits too."""
    told: list[int] = []
    axes: dict[str, Any] = {
        "accelerations": [1e4, 2e4, 2e6],
        "half_exposures": [8e-3],
        "metrics": ["expected_psnr"],
    }
    news = lambda done, total: told.append(done)  # noqa: E731
    sweep(LOPSIDED, optimise=True, **axes, max_steps=1, progress=news)
    assert told == [0, 1, 2, 3]


@pytest.mark.parametrize("optimise", [False, True])
def test_a_bar_names_the_points_and_the_shutter_that_it_is_at(monkeypatch, optimise):
    """Of four points in two blocks, of which each is measured behind two shutters, then searched.

    A new name is a sign of life: no reason for a silence follows it.
    """
    told: list[tuple[int, str]] = []

    @contextmanager
    def counts(*_):
        yield lambda done, name: told.append((done, name))

    monkeypatch.setattr("mishutter.sweeps.run.counts", counts)
    monkeypatch.setattr("mishutter.sweeps.blocks.num_threads", lambda _: 1)
    monkeypatch.setattr("mishutter.sweeps.grid.Grid.block_shape", (2, 1))
    axes: dict[str, Any] = {"accelerations": [1e4, 2e4], "half_exposures": [3.1e-3, 7e-3]}
    search: dict[str, Any] = {"optimise": True, "max_steps": 1} if optimise else {}
    sweep(LOPSIDED, **axes, **search, shutters=SHUTTERS, metrics="efficiency", progress=True)
    first, second = SHUTTERS
    steps = [(0, ""), (0, f", {first}"), (0 if optimise else 1, f", {second}")]
    steps += [(done, ", optimised") for done in (0, 1, 2) if optimise]
    expected = [(done, f"points 1 to 2{name}") for done, name in steps]
    expected += [(2 + done, f"points 3 to 4{name}") for done, name in steps]
    assert told == [*expected, (4, "")]


def test_a_profile_is_searched_at_the_motion_of_its_point(monkeypatch):
    """Each acceleration at each exposure."""
    searched = []

    def best_design(start, settings):
        motion = start.motion
        searched.append((float(motion.acceleration), float(motion.half_exposure)))
        return SimpleNamespace(command=start.shutter, loss=0.25, converged=True)

    monkeypatch.setattr("mishutter.sweeps.blocks.best_design", best_design)
    axes: dict[str, Any] = {"accelerations": [1e4, 2e4], "half_exposures": [3.1e-3, 7e-3]}
    sweep(LOPSIDED, **axes, optimise=True, shutters=SHUTTERS, metrics="efficiency")
    assert searched == [*itertools.product([1e4, 2e4], [3.1e-3, 7e-3])]
