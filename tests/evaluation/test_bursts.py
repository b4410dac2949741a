"""Bursts: frames that are aligned and added up, against an error written out anew."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from mishutter import Burst, Limits, Scene, Sensor
from mishutter.evaluation import StillBursts, best_moving_burst, best_still_burst
from mishutter.evaluation.frames import burst_psnr, still_frames

LIMITS = Limits(max_stroke=45.0, max_top_speed=2e4, min_half_exposure=2e-4, max_half_exposure=0.02)
RATE, NOISE, SPEEDS = 1e5, 8.0, np.linspace(-3000.0, 3000.0, 7)


def _scene(**others):
    burst = others.pop("burst", Burst(frames_per_s=240.0, max_frames=6))
    given = {"photon_rate": RATE, "read_noise": NOISE, "limits": LIMITS, "burst": burst}
    return Scene(SPEEDS, **(given | others))


def _error(num_frames, exposure, num_frequencies=2048):
    """Mean over speeds and frequencies of what one Wiener filter a speed leaves."""
    frequency = (np.arange(num_frequencies) + 0.5) / (2 * num_frequencies)
    power = 1 / (frequency**2 + 0.01**2)
    power *= 0.2**2 / np.mean(power)
    electrons = num_frames * RATE * exposure
    noise = 0.25 * electrons + num_frames * NOISE**2
    passed = np.sinc(frequency * exposure * SPEEDS[:, None]) * np.sinc(frequency)
    signal = power * electrons**2
    return np.mean(power * noise / (signal * passed**2 + noise))


@pytest.mark.parametrize("max_frames", [1, 2, 6])
def test_the_best_still_burst_is_the_best(max_frames):
    """Its frames, its exposure and its level, within those that its rate leaves."""
    burst = best_still_burst(_scene(burst=Burst(frames_per_s=240.0, max_frames=max_frames)))
    ends = 2 * 2e-4, 1 / 240
    found = [
        minimize_scalar(lambda x, n=n: _error(n, x), bounds=ends, method="bounded")
        for n in range(1, max_frames + 1)
    ]
    best = int(np.argmin([f.fun for f in found]))
    assert burst.num_frames == best + 1
    assert burst.psnr == pytest.approx(-10 * np.log10(found[best].fun), abs=0.01)
    assert burst.exposure == pytest.approx(found[best].x, rel=0.02)


def test_a_burst_ends_with_the_longest_exposure():
    """At 60 frames a second only three of them begin within 40 ms."""
    burst = best_still_burst(_scene(burst=Burst(frames_per_s=60.0, max_frames=50)))
    assert burst.num_frames == 3


def test_a_window_of_its_own_bounds_the_burst_and_not_the_longest_exposure():
    """Frames of 60 Hz go on to the end of it, and each is no longer than one exposure may be."""
    for window, frames in ((0.0345, 3), (0.051, 4), (0.31, 19)):
        given = Burst(frames_per_s=60.0, max_frames=50, window=window)
        burst = best_still_burst(_scene(burst=given, read_noise=0.4))
        assert burst.num_frames == frames
        assert (frames - 1) / 60 + burst.exposure <= window * (1 + 1e-9)
    shorter = Limits(max_stroke=45.0, min_half_exposure=1e-4, max_half_exposure=3e-4)
    given = Burst(frames_per_s=60.0, max_frames=7, window=0.2)
    burst = best_still_burst(_scene(limits=shorter, burst=given))
    assert burst.num_frames == 7
    assert burst.exposure == pytest.approx(6e-4)


def test_frames_end_before_the_dead_time():
    """Frames in a dim light would last from one to the next; they lose what they do not see."""
    light = {"photon_rate": 3e3, "read_noise": 0.4}
    dead = 0.0019
    given = Burst(frames_per_s=240.0, max_frames=3, dead_time=dead)
    burst, whole = (
        best_still_burst(_scene(burst=each, **light))
        for each in (given, Burst(frames_per_s=240.0, max_frames=3))
    )
    assert burst.exposure == pytest.approx(1 / 240 - dead, rel=1e-3)
    assert whole.exposure > 1.2 * burst.exposure
    assert whole.psnr > burst.psnr


@pytest.mark.slow
def test_moving_frames_have_the_times_of_still_ones():
    """Window and dead time are of the camera, whatever its sensor does in a frame."""
    given = Burst(frames_per_s=110.0, max_frames=9, window=0.022, dead_time=0.0031)
    burst = best_moving_burst(_scene(burst=given))
    exposure = float(burst.frames.motion.exposure)
    assert burst.num_frames <= 3
    assert exposure <= (1 / 110 - 0.0031) * (1 + 1e-9)
    assert (burst.num_frames - 1) / 110 + exposure <= 0.022 * (1 + 1e-9)


def test_no_frame_fills_a_pixel():
    """Of 60 electrons, half of what the best frame would take."""
    burst = best_still_burst(_scene(sensor=Sensor(full_well=60.0)))
    assert RATE * burst.exposure <= 60.0 * (1 + 1e-6)
    moving = best_moving_burst(
        _scene(sensor=Sensor(full_well=60.0), burst=Burst(frames_per_s=90, max_frames=2))
    )
    assert RATE * float(moving.frames.motion.exposure) <= 60.0 * (1 + 1e-6)


def test_a_camera_without_bursts():
    """Has none, and of one frame only none that moves from frame to frame."""
    assert best_still_burst(_scene(burst=None)) is best_moving_burst(_scene(burst=None)) is None
    assert best_moving_burst(_scene(burst=Burst(frames_per_s=90.0, max_frames=1))) is None


def _of_window(rate, read_noise, num_frames, *, stroke=45.0, **others):
    """The camera of a window of 80 ms that takes some frames without a gap."""
    limits = Limits(max_stroke=stroke, min_half_exposure=1e-4, max_half_exposure=0.04, **others)
    return Scene(
        np.linspace(-4500.0, 4500.0, 9),
        photon_rate=rate,
        read_noise=read_noise,
        limits=limits,
        burst=Burst(frames_per_s=num_frames / 0.08, max_frames=num_frames),
    )


@pytest.mark.slow
def test_the_best_moving_burst_is_that_of_an_independent_search():
    """A search in NumPy found 33.3268 dB and 25.6958 dB of alternating parabolas, 16 frames."""
    for rate, level in ((1e5, 33.3268), (1e4, 25.6958)):
        burst = best_moving_burst(_of_window(rate, 8.0, 16))
        assert burst.psnr >= level - 0.005
        assert burst.num_frames == 16
    assert float(burst_psnr(_of_window(rate, 8.0, 16), [burst.frames])) == pytest.approx(
        burst.psnr, abs=1e-4
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "limits", [{"max_top_speed": 3000.0}, {"max_acceleration": 1.5e5}, {"max_travel": 31.0}, {}]
)
def test_limits_hold_over_the_whole_burst(limits):
    """The way of the stage from frame to frame, and what it does in each; one of them binds."""
    scene = _of_window(1e5, 8.0, 4, stroke=37.0, **limits)
    burst = best_moving_burst(scene)
    motion = burst.frames.motion
    speeds = np.abs(np.asarray(burst.frames.velocities)) + float(motion.top_speed)
    used = {
        "max_stroke": burst.travel,
        "max_top_speed": float(np.max(speeds)),
        "max_acceleration": 2 * float(motion.acceleration),
        "max_travel": burst.travel,
    }
    shares = [used[name] / bound for name, bound in ({"max_stroke": 37.0} | limits).items()]
    assert max(shares) == pytest.approx(1, abs=0.02)
    assert max(shares) <= 1 + 1e-6


@pytest.mark.slow
def test_a_moving_burst_is_never_worse_than_stills():
    """It may hardly move: of objects at rest, in a light in which moving loses."""
    scene = _of_window(3e3, 20.0, 4)
    slow = Scene(
        [0.0, 40.0],
        photon_rate=1e5,
        read_noise=8.0,
        limits=scene.limits,
        burst=scene.burst,
    )
    for each in (scene, slow):
        assert best_moving_burst(each).psnr >= best_still_burst(each).psnr - 1e-3


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
    with pytest.raises(ValueError, match=rf"`Burst\({name}=...\)` must {requirement}"):
        Burst(**given)


@pytest.mark.parametrize("rate", [30.0, 85.0])
def test_stills_have_the_level_of_the_formula_of_all_frames(rate):
    """The closed form of a camera at rest is the response that every other frame has."""
    scene = _scene(burst=None, sensor=Sensor(full_well=90.0))
    best = StillBursts(scene).best(rate)
    level = burst_psnr(scene, [still_frames(best.num_frames, best.exposure / 2)])
    assert best.psnr == pytest.approx(float(level), abs=1e-4)
    assert best.num_frames == 1 + int(rate * 0.04)
    assert RATE * best.exposure <= 90.0 * (1 + 1e-6)


def test_the_rate_that_equals_a_level_is_the_least():
    """At it a burst has the level, and just below it none has."""
    bursts = StillBursts(_scene(burst=None))
    for level in (28.6, 30.3):
        rate = bursts.rate_that_equals(level, most=1000.0)
        assert bursts.best(1.001 * rate).psnr >= level > bursts.best(0.995 * rate).psnr
    assert bursts.rate_that_equals(30.3, most=40.0) is None
    assert bursts.rate_that_equals(60.0, most=1000.0) is None


def test_the_worst_speed_may_judge_stills():
    """Its error is the largest of all, and an object at rest has the least."""
    scene = _scene(burst=None)
    mean, worst = (StillBursts(scene, at_worst=each) for each in (False, True))
    still = StillBursts(Scene([0.0], photon_rate=RATE, read_noise=NOISE, limits=LIMITS))
    errors = [each.error(3, 1.7e-3) for each in (still, mean, worst)]
    assert errors == sorted(errors)
    assert errors[2] > 1.1 * errors[1] > 1.1 * errors[0]


@pytest.mark.parametrize("pans", ["stage", "camera"])
def test_a_burst_follows_either_way(pans):
    """Of objects that all move one way, and of their mirror image, it is the same but for signs."""
    limits = Limits(
        max_stroke=45.0, max_top_speed=2e4, max_half_exposure=0.02, max_pan=900.0, pans=pans
    )
    given = {"photon_rate": RATE, "read_noise": NOISE, "limits": limits}
    given["burst"] = Burst(frames_per_s=240.0, max_frames=2)
    there, back = (
        best_moving_burst(Scene(sign * np.array([610.0, 790.0]), **given)) for sign in (1, -1)
    )
    assert np.mean(there.frames.velocities) == pytest.approx(700.0)
    np.testing.assert_allclose(np.sort(-back.frames.velocities), np.sort(there.frames.velocities))
    assert back.psnr == pytest.approx(there.psnr, abs=1e-4)
    assert there.travel <= 45.0
