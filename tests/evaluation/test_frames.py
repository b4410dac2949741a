"""Levels of several frames, against an error that is written out anew in NumPy."""

import jax
import numpy as np
import pytest
from support.burst_levels import (
    FrameGroup,
    burst_psnr,
    still_frames,
)
from support.frames import alternating_frames, panned_frames, sine_frames, sweep_frames

from mishutter import (
    Limits,
    Occlusion,
    ParabolicMotion,
    RectShutter,
    Scene,
    evaluate,
)

WINDOW, TOP = 0.08, 4500.0
"""From first to last light, s; the fastest object, px/s."""
LIMITS = Limits(max_stroke=200.0, max_half_exposure=0.04)
SAME_LEVEL = 1e-4
"""dB; the sums here and there are over different frequencies."""
SAME_DERIVATIVE = 1e-9
"""Relative, against differences of the sixth order."""

U = (np.arange(512) + 0.5) / 512
F, DF = 0.5 * U**2, 2 * U / 512
"""Frequencies and their shares: dense where the power is."""
_BAND = (np.arange(8192) + 0.5) / 16384
POWER = 0.04 / np.mean(1 / (_BAND**2 + 1e-4)) / (F**2 + 1e-4)


def _scene(rate=1e5, read_noise=8.0, speeds=None, **others):
    speeds = np.linspace(-TOP, TOP, 9) if speeds is None else speeds
    return Scene(speeds, photon_rate=rate, read_noise=read_noise, limits=LIMITS, **others)


def _response(half, path, speed, at=0.0):
    """H of an open frame about the middle of a burst; `path` is the sensor's place over time."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    time = half * nodes
    return np.exp(-2j * np.pi * F[:, None] * (path(time) - speed * (at + time))) @ (weights / 2)


def _noise(scene, half):
    electrons = 2 * half * float(scene.photon_rate)
    return 0.25 / electrons + (float(scene.read_noise) / electrons) ** 2


def _level(scene, *frames):
    """The formula of a decoder that knows the speed, by brute force: frames are (half, path)."""
    errors = []
    for speed in np.asarray(scene.speeds):
        gained = sum(
            np.abs(_response(half, path, speed)) ** 2 / _noise(scene, half) for half, path in frames
        )
        errors.append(DF @ (POWER / (1 + POWER * np.sinc(F) ** 2 * gained)))
    return -10 * np.log10(np.mean(errors))


def _still(time):
    return 0 * time


def _parabola(acceleration, velocity=0.0, direction=1):
    return lambda time: direction * acceleration * time**2 + velocity * time


def _cosine(half, stroke, period):
    amplitude = stroke / (1 - np.cos(np.pi * half / period))
    return lambda time: amplitude * np.cos(np.pi * time / period)


def _sweep(num_frames, acceleration, period):
    times = (np.arange(num_frames) - (num_frames - 1) / 2) * period
    return [_parabola(acceleration, 2 * acceleration * time) for time in times]


CASES = {
    "stills": (lambda: [still_frames(4, 0.75e-3)], [(0.75e-3, _still)] * 4, 28.2547),
    "alternating": (
        lambda: [alternating_frames(4, 1e-2, 27e4)],
        [(1e-2, _parabola(27e4, direction=(-1) ** k)) for k in range(4)],
        31.0447,
    ),
    "sine": (
        lambda: [sine_frames(8, 5e-3, 14.0, 0.01)],
        [(5e-3, _cosine(5e-3, 14.0, 0.01))] * 8,
        32.1895,
    ),
    "sweep": (
        lambda: [sweep_frames(8, 5e-3, 1.17 * TOP / WINDOW, 0.01)],
        [(5e-3, path) for path in _sweep(8, 1.17 * TOP / WINDOW, 0.01)],
        32.3952,
    ),
    "fan of pans": (
        lambda: [panned_frames(4, 6e-3, 3300.0)],
        [(6e-3, _parabola(0.0, v)) for v in np.linspace(-3300, 3300, 4)],
        None,
    ),
    "a long still and three parabolas": (
        lambda: [still_frames(1, 14e-3), alternating_frames(3, 8.5e-3, 25 / 8.5e-3**2)],
        [(14e-3, _still), *[(8.5e-3, _parabola(25 / 8.5e-3**2))] * 3],
        30.8113,
    ),
}


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize(
    ("rate", "read_noise"),
    [(1e5, 8.0), pytest.param(1e4, 8.0, marks=pytest.mark.slow), (1e6, 2.0)],
)
def test_levels_are_those_of_the_formula(name, rate, read_noise):
    """For frames at rest, on every path, and of unequal lengths, in dim and in bright light."""
    frames, by_hand, published = CASES[name]
    frames = frames()
    scene = _scene(rate, read_noise)
    level = float(burst_psnr(scene, frames))
    assert level == pytest.approx(_level(scene, *by_hand), abs=SAME_LEVEL)
    if published is not None and rate == 1e5:
        assert level == pytest.approx(published, abs=1e-3)


def test_a_burst_of_one_frame_is_the_single_exposure():
    """What a decoder that knows the speed has of it, also on a sensor that pans."""
    scene = _scene()
    motion = ParabolicMotion(acceleration=1.5e5, half_exposure=0.017, velocity=700.0)
    one = FrameGroup(motion.without_velocity(), np.array([700.0]))
    single = evaluate(scene, motion, RectShutter()).known_speed_psnr
    assert float(burst_psnr(scene, [one])) == pytest.approx(float(single), abs=1e-6)


def test_frames_never_hurt():
    """One more frame, however poor, lowers the error at every weighting of the speeds."""
    scene = _scene(weights=np.array([3, 1, 0.5, 1, 2, 1, 0, 1, 4]))
    good, poor = alternating_frames(3, 9e-3, 26e4), still_frames(1, 2e-5)
    without, within = (float(burst_psnr(scene, each)) for each in ([good], [good, poor]))
    assert 0 < within - without < 1e-2


def _of_sweep(number):
    return burst_psnr(_scene(), [sweep_frames(4, 9e-3, number * 6e4, 0.02)])


def _of_exposure(number):
    half = number * 8e-3
    frames = [alternating_frames(3, half, 25e4), still_frames(1, 0.3 * half)]
    return burst_psnr(_scene(), frames)


@pytest.mark.slow
@pytest.mark.parametrize("level", [_of_sweep, _of_exposure])
def test_derivatives_are_those_of_differences(level):
    """By the acceleration, which moves all velocities of a sweep, and by the exposure."""
    steps = 5e-4 * 2.0 ** np.arange(3)
    difference = [float(level(1 + h) - level(1 - h)) / (2 * h) for h in steps]
    fourth = [(4 * difference[k] - difference[k + 1]) / 3 for k in range(2)]
    sixth = (16 * fourth[0] - fourth[1]) / 15
    assert float(jax.grad(level)(1.0)) == pytest.approx(sixth, rel=SAME_DERIVATIVE)


@pytest.mark.parametrize(
    ("frames", "level"),
    [
        (lambda: [still_frames(4, 1.25e-3)], 30.8298),
        (lambda: [alternating_frames(4, 1e-2, 27e4)], 31.0784),
        (lambda: [still_frames(1, 33.6e-3), still_frames(3, 0.7e-3)], 33.1085),
        (lambda: [still_frames(1, 20e-3), alternating_frames(3, 6.5e-3, 19 / 6.5e-3**2)], 35.0692),
    ],
    ids=["stills", "parabolas", "bracketed stills", "a still and three parabolas"],
)
def test_parts_before_a_background_are_restored_each_by_its_speed(frames, level):
    """Published levels where 30 % of the picture moves; a moving background has the same speeds."""
    layered = _scene(occlusion=Occlusion(front_share=0.3))
    assert float(burst_psnr(layered, frames())) == pytest.approx(level, abs=1e-3)
    moving = _scene(occlusion=Occlusion(front_share=0.3, background="moving"))
    whole = float(burst_psnr(_scene(), frames()))
    assert float(burst_psnr(moving, frames())) == pytest.approx(whole, abs=1e-6)
