"""Strips that objects hide in some frames: a closed form, slopes, and the order of stills."""

import itertools

import jax
import numpy as np
import pytest

from mishutter import (
    BurstMode,
    EvenVelocities,
    Limits,
    ListedVelocities,
    Occlusion,
    Scene,
    StillCamera,
    TimedFrame,
    exposures_psnr,
)
from mishutter.evaluation.bursts import FrameTimes, StillBursts, best_still_burst
from mishutter.evaluation.fans import Fan
from mishutter.evaluation.levels import instants_of, left
from mishutter.evaluation.strips import Strips

LAYERS = Occlusion(front_share=0.23, object_width=74.0)


def scene(occlusion=LAYERS, speeds=(-640.0, 0.0, 310.0, 980.0), **others):
    light = {"photon_rate": 1e5, "read_noise": 8.0} | others
    return Scene(speeds, occlusion=occlusion, **light)


def stills(exposures, times):
    halves = [exposure / 2 for exposure in exposures]
    return [TimedFrame(StillCamera(half_exposure=h), t) for h, t in zip(halves, times, strict=True)]


def error(*arguments):
    return 10 ** (-float(exposures_psnr(*arguments)) / 10)


def test_what_one_of_two_short_frames_hides_is_known_from_the_other_alone():
    """On either side of the objects, by the share of the background that they cover until then."""
    bright = {"photon_rate": 3e8}
    frames = stills((1e-6, 1e-6), (-0.011, 0.011))
    ground = scene(None, (0.0,), **bright)
    alone, both = error(ground, frames[:1]), error(ground, frames)
    length, speeds = 74 * 0.77, np.abs([-640.0, 0.0, 310.0, 980.0])
    share = 2 * 0.23 * 0.77 * np.mean(1 - np.exp(-speeds * 0.011 / length))
    without = error(scene(Occlusion(front_share=0.23), **bright), frames)
    # The blur of a microsecond is none: two edges of each object, known by two frames.
    outlines = 2 * 0.23 / 74 * 2 * 0.2**2 * 0.17 / 2
    wanted = without + share * (alone - both) + outlines
    assert error(scene(**bright), frames) == pytest.approx(wanted, rel=2e-4)
    assert wanted > 1.01 * without


def test_a_frame_in_which_a_strip_is_hidden_half_tells_a_quarter_of_it():
    """At the time of its middle, and more the later it is; none hides what it is exposed after."""
    strips = Strips.of(scene())
    shares, told = strips.beside(np.array([-0.02, 0.02]), np.array([0.01, 0.0001]))
    assert shares.sum() == pytest.approx(
        2 * float(strips.share) * (1 - np.exp(-strips.rates * 0.025) @ strips.weights)
    )
    half = len(told) // 2
    times = 0.025 * (np.arange(half) + 0.5) / half
    before = told[:half]
    np.testing.assert_allclose(before[:, 0], np.clip((times - 0.015) / 0.01, 0, 1) ** 2, atol=1e-12)
    assert np.all(before[:, 1] == 1)


def test_the_level_has_slopes_by_times_and_exposures():
    """Those of differences, and the same level where it is traced."""
    own = scene()

    def level(numbers):
        return exposures_psnr(own, stills(numbers[:3], numbers[3:]), num_panels=2)

    numbers = np.array([0.017, 0.004, 0.009, -0.021, 0.003, 0.024])
    traced, slopes = jax.value_and_grad(level)(numbers)
    assert float(traced) == pytest.approx(float(level(numbers)), abs=1e-7)
    level = jax.jit(level)  # waves of NumPy are of single precision
    for place, step in enumerate(1e-6 * np.eye(6)):
        difference = (level(numbers + step) - level(numbers - step)) / 2e-6
        assert float(slopes[place]) == pytest.approx(float(difference), rel=1e-3, abs=1e-2)


def test_long_and_short_stills_come_in_the_best_order():
    """Of all orders of two exposures in which two are sharp; one after the other loses."""
    burst = BurstMode(frames_per_s=50.0, max_frames=4, window=0.08)
    own = Scene.uniform(
        max_speed=1140.0,
        photon_rate=1e5,
        read_noise=8.0,
        limits=Limits(max_half_exposure=0.01),
        burst=burst,
        occlusion=Occlusion(front_share=0.2, object_width=85.0),
    )
    found, times = best_still_burst(own), FrameTimes.of(own, burst)
    assert found.psnr == pytest.approx(float(exposures_psnr(own, found.frames)), abs=1e-6)
    exposures = sorted(frame.exposure for frame in found.frames)
    levels = {}
    for order in set(itertools.permutations(exposures)):
        levels[order] = float(exposures_psnr(own, stills(order, times.moments(order))))
    assert found.psnr == pytest.approx(max(levels.values()), abs=0.02)
    assert found.psnr > levels[tuple(exposures[::-1])] + 0.08
    # Two valleys: that of one exposure for all is not the deeper one.
    assert found.psnr > StillBursts(own).best_within(times).psnr + 0.6
    assert found.lengths.startswith("20, 2.4")


AXIS = -640.0, 0.0, 310.0, 980.0
TIMES = {
    "limits": Limits(max_half_exposure=0.01),
    "burst": BurstMode(frames_per_s=50.0, max_frames=4, window=0.08),
}


def in_plane(velocities, **others):
    light = {"photon_rate": 1e5, "read_noise": 8.0, "occlusion": LAYERS} | others
    return Scene.any_direction(velocities, **light)


def test_velocities_along_the_rows_have_the_level_of_the_axis():
    """On the one line of the axis, with the background, the strips and the outlines."""
    line, plane = scene(), in_plane(ListedVelocities([(speed, 0.0) for speed in AXIS]))
    frames, fan = stills((0.02, 0.003, 0.011), (-0.02, 0.004, 0.021)), Fan.of_axis(line, 512)
    errors = [
        float(left(each, instants_of(each, frames, "exposures_psnr"), fan, 8))
        for each in (line, plane)
    ]
    assert errors[1] == pytest.approx(errors[0], rel=1e-12)
    bare = plane.with_occlusion(None)
    whole = float(left(bare, instants_of(bare, frames, "exposures_psnr"), fan, 8))
    assert whole > 1.1 * errors[0]


def test_strips_lie_along_each_velocity_of_a_disc():
    """Few velocities stand for all: the share that a time uncovers is that of the whole disc."""
    strips = Strips.of(in_plane(EvenVelocities(980.0)))
    speeds = 980 * np.sqrt((np.arange(4000) + 0.5) / 4000)
    for time in (0.003, 0.02, 0.07):
        covered = np.exp(-time * strips.rates) @ strips.weights
        wanted = np.mean(np.exp(-time * speeds / (74 * 0.77)))
        assert 1 - covered == pytest.approx(1 - wanted, rel=0.02)


def test_a_level_before_a_background_has_slopes_by_the_velocities():
    """Those of differences, by the greatest speed of a disc, strips and outlines included."""
    frames = stills((0.02, 0.003, 0.02, 0.003), (-0.03, -0.01, 0.01, 0.03))

    def level(speed):
        return exposures_psnr(in_plane(EvenVelocities(speed)), frames, num_panels=3)

    slope = float(jax.grad(level)(700.0))
    difference = (float(level(710.0)) - float(level(690.0))) / 20
    assert slope == pytest.approx(difference, rel=1e-2)


def test_stills_before_a_background_are_searched_in_the_plane_as_along_the_axis():
    """The same order, lengths and outlines; the level is that of the exposures in the plane."""
    speeds = np.linspace(-900.0, 900.0, 7)
    line = best_still_burst(scene(speeds=speeds, **TIMES))
    own = in_plane(ListedVelocities([(speed, 0.0) for speed in speeds]), **TIMES)
    found = best_still_burst(own)
    assert found.psnr == pytest.approx(float(exposures_psnr(own, found)), abs=1e-4)
    exposures = [np.array([1e3 * each for each in burst.exposures]) for burst in (line, found)]
    np.testing.assert_allclose(exposures[1], exposures[0], rtol=0.15)
