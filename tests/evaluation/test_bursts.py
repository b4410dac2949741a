"""Bursts: frames that are aligned and added up, against an error written out anew."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from mishutter import (
    BurstMode,
    Limits,
    Occlusion,
    RectShutter,
    Scene,
    Sensor,
    StillCamera,
    TimedFrame,
    evaluate,
    exposures_psnr,
)
from mishutter.evaluation.bursts import FrameTimes, StillBursts, best_still_burst
from mishutter.search.moving_frames import ONE_PARABOLA, best_moving_burst

LIMITS = Limits(max_stroke=45.0, max_top_speed=2e4, min_half_exposure=2e-4, max_half_exposure=0.02)
RATE, NOISE, SPEEDS = 1e5, 8.0, np.linspace(-3000.0, 3000.0, 7)


def _scene(**others):
    burst = others.pop("burst", BurstMode(frames_per_s=240.0, max_frames=6))
    given = {"photon_rate": RATE, "read_noise": NOISE, "limits": LIMITS, "burst": burst}
    return Scene(SPEEDS, **(given | others))


def errors_of_stills(num_frames, exposure, scene, num_frequencies=2048):
    """Mean over frequencies of what one Wiener filter a speed leaves, at each speed; white = 1."""
    rate, noise_of_reading = float(scene.photon_rate), float(scene.read_noise)
    frequency = (np.arange(num_frequencies) + 0.5) / (2 * num_frequencies)
    power = 1 / (frequency**2 + 0.01**2)
    power *= 0.2**2 / np.mean(power)
    electrons = num_frames * rate * exposure
    noise = 0.25 * electrons + num_frames * noise_of_reading**2
    passed = np.sinc(frequency * exposure * np.asarray(scene.speeds)[:, None]) * np.sinc(frequency)
    return np.mean(power * noise / (power * electrons**2 * passed**2 + noise), axis=1)


@pytest.mark.parametrize("max_frames", [1, 2, 6])
def test_the_best_still_burst_is_the_best(max_frames):
    """Its frames, its exposure and its level; one frame alone need not wait for the next."""
    scene = _scene(burst=BurstMode(frames_per_s=240.0, max_frames=max_frames))
    burst = StillBursts(scene).best_within(FrameTimes.of(scene, scene.burst))
    found = [
        minimize_scalar(
            lambda x, n=n: np.mean(errors_of_stills(n, x, scene)),
            bounds=(4e-4, 1 / 240 if n > 1 else 0.04),
            method="bounded",
        )
        for n in range(1, max_frames + 1)
    ]
    best = int(np.argmin([f.fun for f in found]))
    assert burst.num_frames == best + 1
    assert burst.psnr == pytest.approx(-10 * np.log10(found[best].fun), abs=0.01)
    assert burst.exposure == pytest.approx(found[best].x, rel=0.02)


def test_a_burst_ends_with_the_longest_exposure():
    """At 60 frames a second only three of them begin within 40 ms."""
    burst = best_still_burst(_scene(burst=BurstMode(frames_per_s=60.0, max_frames=50)))
    assert burst.num_frames == 3


def test_a_window_of_its_own_bounds_the_burst_and_not_the_longest_exposure():
    """Frames of 60 Hz go on to the end of it, and each is no longer than one exposure may be."""
    for window, frames in ((0.0345, 3), (0.051, 4), (0.31, 19)):
        given = BurstMode(frames_per_s=60.0, max_frames=50, window=window)
        burst = best_still_burst(_scene(burst=given, read_noise=0.4))
        assert burst.num_frames == frames
        assert burst.duration <= window * (1 + 1e-6)
    shorter = Limits(max_stroke=45.0, min_half_exposure=1e-4, max_half_exposure=3e-4)
    given = BurstMode(frames_per_s=60.0, max_frames=7, window=0.2)
    burst = best_still_burst(_scene(limits=shorter, burst=given))
    assert burst.num_frames == 7
    assert max(frame.exposure for frame in burst.frames) == pytest.approx(6e-4)


def test_frames_end_before_the_dead_time():
    """Frames in a dim light would last from one to the next; they lose what they do not see."""
    light = {"photon_rate": 3e3, "read_noise": 0.4}
    dead = 0.0019
    # Windows that leave three frames no time to wait.
    given = BurstMode(frames_per_s=240.0, max_frames=3, dead_time=dead, window=3 / 240 - dead)
    burst, whole = (
        best_still_burst(_scene(burst=each, **light))
        for each in (given, BurstMode(frames_per_s=240.0, max_frames=3, window=3 / 240))
    )
    longest, other = (max(frame.exposure for frame in x.frames) for x in (burst, whole))
    assert longest == pytest.approx(1 / 240 - dead, rel=1e-3)
    assert other > 1.2 * longest
    assert whole.psnr > burst.psnr


def test_no_frame_fills_a_pixel():
    """Of 60 electrons, half of what the best frame would take."""
    scene = _scene(sensor=Sensor(full_well=60.0), burst=BurstMode(frames_per_s=90, max_frames=2))
    for burst in (best_still_burst(scene), best_moving_burst(scene)):
        assert RATE * max(frame.exposure for frame in burst.frames) <= 60.0 * (1 + 1e-6)
    full = _scene(sensor=Sensor(full_well=30.0))
    for search in (best_still_burst, best_moving_burst):
        with pytest.raises(ValueError, match=r"must not be full within the shortest exposure"):
            search(full)


def test_a_camera_without_bursts():
    """Has none, and of one frame the single exposure."""
    assert best_still_burst(_scene(burst=None)) is best_moving_burst(_scene(burst=None)) is None
    one = best_moving_burst(_scene(burst=BurstMode(frames_per_s=90.0, max_frames=1)))
    level = evaluate(_scene(), one.frames[0].motion, RectShutter()).known_speed_psnr
    assert (one.num_frames, one.kind) == (1, ONE_PARABOLA)
    assert one.psnr == pytest.approx(float(level), abs=1e-4)


@pytest.mark.parametrize(
    ("name", "value", "requirement"),
    [
        ("frames_per_s", 0.0, "be above 0"),
        ("max_frames", 0, "be a positive integer"),
        ("window", 0.0, "be above 0"),
        ("dead_time", -1e-4, "be at least 0"),
        ("dead_time", 0.017, "be shorter than the 0.0166667 s from frame to frame"),
    ],
)
def test_a_burst_that_is_none(name, value, requirement):
    """One line says which number is out of its range."""
    given = {"frames_per_s": 60.0, "max_frames": 3} | {name: value}
    with pytest.raises(ValueError, match=rf"`BurstMode\({name}=...\)` must {requirement}"):
        BurstMode(**given)


@pytest.mark.parametrize("rate", [30.0, 85.0])
def test_stills_have_the_level_of_the_formula_of_all_frames(rate):
    """The closed form of a camera at rest is the response that every other frame has."""
    scene = _scene(burst=None, sensor=Sensor(full_well=90.0))
    best = StillBursts(scene).best_within(FrameTimes.of(scene, BurstMode(frames_per_s=rate)))
    still = StillCamera(half_exposure=best.exposure / 2)
    level = exposures_psnr(scene, [TimedFrame(still, 0.0)] * best.num_frames)
    assert best.psnr == pytest.approx(float(level), abs=1e-4)
    assert best.num_frames == 1 + int(rate * 0.04)
    assert RATE * best.exposure <= 90.0 * (1 + 1e-6)


def test_the_worst_speed_may_judge_stills():
    """Its error is the largest of all, and an object at rest has the least."""
    scene = _scene(burst=None)
    mean, worst = (StillBursts(scene, at_worst=each) for each in (False, True))
    still = StillBursts(Scene([0.0], photon_rate=RATE, read_noise=NOISE, limits=LIMITS))
    errors = [each.error(3, 1.7e-3) for each in (still, mean, worst)]
    assert errors == sorted(errors)
    assert errors[2] > 1.1 * errors[1] > 1.1 * errors[0]


def test_a_second_exposure_never_hurts():
    """Of frames at rest: a bracketed burst is at least as good, and better before a background."""
    gains = []
    for layers in (None, Occlusion(front_share=0.37)):
        scene = _scene(burst=BurstMode(frames_per_s=110.0, max_frames=4), occlusion=layers)
        equal = StillBursts(scene).best_within(FrameTimes.of(scene, scene.burst))
        burst = best_still_burst(scene)
        gains.append(burst.psnr - equal.psnr)
        assert burst.psnr == pytest.approx(float(exposures_psnr(scene, burst.frames)), abs=1e-3)
    assert gains[0] >= 0
    assert gains[1] > 0.3


@pytest.mark.parametrize("share", [1.0, 0.37])
def test_stills_of_a_faster_camera_are_no_worse(share):
    """Four of them in dim light wait for each other; the best number is no greater than pays."""
    levels, dim = [], {"photon_rate": 4e3, "read_noise": 5.0}
    for rate in (52.0, 107.0, 230.0, 451.0):
        layers = None if share == 1 else Occlusion(front_share=share)
        burst = BurstMode(frames_per_s=rate, max_frames=4)
        found = best_still_burst(_scene(burst=burst, occlusion=layers, **dim))
        levels.append(found.psnr)
        assert found.duration <= 0.04 * (1 + 1e-9)
        ends = [frame.time + frame.exposure / 2 for frame in found.frames]
        starts = [frame.time - frame.exposure / 2 for frame in found.frames]
        assert np.min(np.diff(ends)) >= (1 - 1e-9) / rate
        assert np.min(np.array(starts[1:]) - ends[:-1]) >= -1e-12
    assert np.all(np.diff(levels) > -1e-3)
    assert levels[-1] > levels[0] - 1e-3


def test_frames_of_two_lengths_end_no_sooner_than_the_rate_allows():
    """A short one that follows a long one ends a whole period after it."""
    burst = BurstMode(frames_per_s=110.0, max_frames=4)
    found = best_still_burst(_scene(burst=burst, occlusion=Occlusion(front_share=0.37)))
    exposures = [frame.exposure for frame in found.frames]
    assert max(exposures) > 1.5 * min(exposures)
    ends = [frame.time + frame.exposure / 2 for frame in found.frames]
    assert np.min(np.diff(ends)) >= (1 - 1e-9) / 110.0


def test_fewer_and_longer_stills_are_best_in_the_dark():
    """As many as the camera takes would be too short to see anything beside their noise."""
    light = {"photon_rate": 2e3, "read_noise": 6.0}
    scene = _scene(burst=BurstMode(frames_per_s=900.0), **light)
    bursts = StillBursts(scene)

    def best(rate, most=None):
        given = BurstMode(frames_per_s=rate, max_frames=most)
        return bursts.best_within(FrameTimes.of(scene, given))

    found = best(900.0)
    levels = {n: best(n / 0.04 * (1 - 1e-9), n).psnr for n in range(1, 37)}
    assert found.num_frames < 36
    assert found.psnr == pytest.approx(max(levels.values()), abs=1e-4)
