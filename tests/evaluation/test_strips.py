"""Strips that objects hide in some frames: a closed form, slopes, and the order of stills."""

import itertools

import jax
import numpy as np
import pytest

from mishutter import BurstMode, Limits, Occlusion, Scene, StillCamera, TimedFrame, exposures_psnr
from mishutter.evaluation.bursts import FrameTimes, StillBursts, best_still_burst
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
    assert float(traced) == pytest.approx(float(level(numbers)), abs=1e-9)
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
