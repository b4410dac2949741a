"""The cover of a search: evenly spread, open where objects are kept up with, one a valley."""

from functools import partial

import jax
import numpy as np
import pytest

from mishutter import (
    Limits,
    ParabolicMotion,
    Scene,
    SplineShutter,
    StillCamera,
    example_scene,
    optimise,
    starting_shutter,
)
from mishutter.model.shutters.spline import coefficient_times

# Steps of the search, checked one by one; its face returns only a finished design.
from mishutter.search.search import free_by_default
from mishutter.search.space import design_space
from mishutter.search.starts import cover, lowest_of_valleys, quantiles, start_boxes

LIMITS = Limits(max_stroke=50.0, max_top_speed=1e5, max_half_exposure=1 / 30)
MOTION = ParabolicMotion(acceleration=3e5, half_exposure=5e-3)


def _scene(speeds, photon_rate=1e8, read_noise=1.0, limits=LIMITS):
    return Scene(speeds, photon_rate=photon_rate, read_noise=read_noise, limits=limits)


def _space(scene, motion=MOTION):
    shutter = starting_shutter(scene)
    return design_space(scene, motion, shutter, free_by_default(scene, motion, shutter))


def test_quantiles_are_as_many_as_objects_that_occur():
    """In order of speed and by their weights; a speed without weight is none of them."""
    weights = {-900.0: 0.11, -40.0: 0.6, 300.0: 0.0, 2500.0: 0.29}
    order = [2500.0, -40.0, 300.0, -900.0]
    scene = Scene(order, [weights[speed] for speed in order], photon_rate=1e5, read_noise=4.0)
    found = quantiles(scene)
    assert np.all(np.diff(found) >= 0)
    for speed, weight in weights.items():
        assert np.mean(found == speed) == pytest.approx(weight, abs=1 / found.size)


@pytest.mark.parametrize("motion", [MOTION, StillCamera(half_exposure=2e-3)])
def test_a_cover_is_spread_over_the_motions(motion):
    """Each sixteenth of every coordinate has its share of the candidates, to a tenth."""
    scene = _scene([-310.0, 2700.0])
    space = _space(scene, motion)
    boxes = cover(space, scene, 64, seed=5)
    assert np.all((boxes >= 0) & (boxes <= 1))
    for coordinate in boxes[:, space.num_profile_coordinates :].T:
        counts, _ = np.histogram(coordinate, bins=16, range=(0, 1))
        assert np.ptp(counts) <= 0.1 * len(boxes)


def test_a_seed_draws_the_candidates():
    """Equal seeds draw equal candidates and starts, others others, in every coordinate."""
    scene = _scene([-310.0, 2700.0])
    space = _space(scene)
    # The first starts are the design of the space and the baselines.
    draws = {
        "cover": lambda seed: cover(space, scene, 6, seed=seed),
        "starts": lambda seed: start_boxes(space, 18, seed=seed)[12:],
    }
    for name, draw in draws.items():
        one, same, other = (draw(seed) for seed in (3, 3, 4))
        assert np.array_equal(one, same), name
        assert np.all(np.any(one != other, axis=0)), name


@pytest.mark.slow
@pytest.mark.parametrize("speeds", [[-310.0, 2700.0], [-1900.0, 1900.0], [420.0, 800.0, 3100.0]])
def test_profiles_are_open_where_the_sensor_keeps_up(speeds):
    """Every other candidate is open at s/(2a) for each of the speeds, the rest for one at least.

    The last are codes, most with an opening and a time at which they are hardly open.
    """
    scene = _scene(speeds)
    space = _space(scene)
    boxes, num_codes = cover(space, scene, 4, seed=3), 36
    codes = boxes[-num_codes:, : space.num_profile_coordinates]
    assert np.mean(codes.max(axis=1) > 0.5) > 0.75
    assert np.mean(codes.min(axis=1) < 0.5) > 0.75
    for index, point in enumerate(boxes[:-num_codes]):
        shutter, motion = space.at(jax.device_put(point))
        times = (np.asarray(speeds) - float(motion.velocity)) / float(motion.speed_gain)
        inside = np.abs(times) <= 0.9
        lit = np.asarray(shutter.transmittance(np.clip(times, -1, 1))) > 0.2
        assert np.any(lit[inside]) or not np.all(inside)
        assert np.all(lit[inside]) or index % 2


def test_one_start_a_valley():
    """The lowest of each of three valleys come first, though one holds the six best points."""
    middles = np.array([[0.1, 0.2], [0.8, 0.3], [0.4, 0.9]])
    offsets = 0.02 * np.random.default_rng(7).standard_normal((6, 2))
    boxes = np.concatenate([middle + offsets for middle in middles])
    losses = np.concatenate([np.arange(6) + 10.0 * valley for valley in range(3)])
    worse = np.full_like(boxes, 0.6)
    losses = np.append(losses, np.full(len(worse), 99.0))
    places = lowest_of_valleys(np.concatenate([boxes, worse]), losses, 0, 3)
    assert sorted(places) == [0, 6, 12]


BRIGHT = {
    "mostly one way": ([-500.0, 3000.0], 1e8, 1.0, 7.70395e-3),
    "both ways": ([-193.333, 214.190], 8.45206e8, 1.0, 1.13742e-3),
    "near rest": ([19.4076, 226.391], 8.25270e8, 8.0, 1.10553e-3),
}
"""Speeds, irradiance and read noise of scenes, and the best expected error known."""


@pytest.mark.slow
def test_few_speeds_in_bright_light_are_not_ended_short():
    """Searches end within 0.05 dB of the best known on average, and within 0.1 dB each.

    The best known is the lowest loss that any of a hundred searches ended at, of up to 256
    starts.
    """
    shortfalls = []
    for speeds, photon_rate, read_noise, best in BRIGHT.values():
        scene = _scene(speeds, photon_rate, read_noise)
        shortfalls.append(10 * np.log10(optimise(scene, seed=1).loss / best))
    assert np.mean(shortfalls) <= 0.05
    assert max(shortfalls) <= 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("acceleration", "half_exposure", "code"),
    [
        (1.70481562592037e5, 4.942246735828411e-3, [1, 1, 1, 0, 0, 0, 0, 0.4, 1, 0.3, 0, 0]),
        (1.151359755736192e5, 4.590409278672298e-3, [1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1]),
        (9.461888922082026e4, 2.361534411099987e-3, [1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0]),
    ],
)
def test_a_short_stroke_gets_a_code(acceleration, half_exposure, code):
    """Where few objects are kept up with, the search is not beaten from a code that is known."""
    scene = example_scene()
    motion = ParabolicMotion(acceleration=acceleration, half_exposure=half_exposure)
    known = SplineShutter(np.asarray(code, float), symmetric=True, num_coefficients=24)
    searched = partial(optimise, scene, motion, free="shutter")
    assert searched().loss <= searched(known).loss * (1 + 1e-3)


def test_coefficients_act_about_their_times():
    """Coefficients on a straight line make the spline that line."""
    for count in (4, 7, 24):
        line = 0.5 + 0.3 * coefficient_times(count)
        tau = np.linspace(-0.97, 0.93, 41)
        found = SplineShutter(line).transmittance(tau)
        np.testing.assert_allclose(found, 0.5 + 0.3 * tau, rtol=1e-13)
