"""Levels of several frames, against an error that is written out anew in NumPy."""

import numpy as np
import pytest

from mishutter import (
    FreeMotion,
    Limits,
    LinearMotion,
    Occlusion,
    ParabolicMotion,
    Scene,
    StillCamera,
    TimedFrame,
    exposures_psnr,
)

WINDOW, TOP = 0.08, 4500.0
"""From first to last light, s; the fastest object, px/s."""
SAME_LEVEL = 2e-3
"""dB; the sums here and there are over different frequencies, and a path of pieces is no sine."""

U = (np.arange(512) + 0.5) / 512
F, DF = 0.5 * U**2, 2 * U / 512
"""Frequencies and their shares: dense where the power is."""
_BAND = (np.arange(8192) + 0.5) / 16384
POWER = 0.04 / np.mean(1 / (_BAND**2 + 1e-4)) / (F**2 + 1e-4)


def _scene(rate=1e5, read_noise=8.0, **others):
    limits = Limits(max_stroke=200.0, max_half_exposure=0.04)
    light = {"photon_rate": rate, "read_noise": read_noise}
    return Scene(np.linspace(-TOP, TOP, 9), **light, limits=limits, **others)


def _response(half, path, speed):
    """H of an open frame about its middle; `path` is the sensor's place over time."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    time = half * nodes
    return np.exp(-2j * np.pi * F[:, None] * (path(time) - speed * time)) @ (weights / 2)


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


def _still(half):
    return StillCamera(half_exposure=half), (half, lambda time: 0 * time)


def _parabola(half, acceleration, velocity=0.0):
    rates = np.array([acceleration])
    motion = FreeMotion(accelerations=rates, half_exposure=half, velocity=velocity)
    return motion, (half, lambda time: acceleration * time**2 + velocity * time)


def _sine(half, stroke, period, sign):
    """About a turning point of a stage: 64 pieces of the mean acceleration of each."""
    amplitude = sign * stroke / (1 - np.cos(np.pi * half / period))
    ends = np.linspace(-half, half, 65)
    velocity = -amplitude * np.pi / period * np.sin(np.pi * ends / period)
    rates = np.diff(velocity) / np.diff(ends) / 2
    path = (half, lambda time: amplitude * np.cos(np.pi * time / period))
    return FreeMotion(accelerations=rates, half_exposure=half), path


SWEPT = 1.17 * TOP / WINDOW
CASES = {
    "stills": ([_still(0.75e-3)] * 4, 28.2547),
    "alternating": ([_parabola(1e-2, (-1) ** k * 27e4) for k in range(4)], 31.0447),
    "sine": ([_sine(5e-3, 14.0, 0.01, (-1) ** k) for k in range(8)], 32.1895),
    "sweep": ([_parabola(5e-3, SWEPT, 2 * SWEPT * t) for t in 0.01 * np.arange(-3.5, 4)], 32.3952),
    "fan of pans": (
        [
            (LinearMotion(half_exposure=6e-3, velocity=v), (6e-3, lambda time, v=v: v * time))
            for v in np.linspace(-3300, 3300, 4)
        ],
        None,
    ),
    "a long still and three parabolas": (
        [_still(14e-3), *[_parabola(8.5e-3, 25 / 8.5e-3**2)] * 3],
        30.8113,
    ),
}


def _frames(motions):
    """Frames that are registered: their level does not depend on their times and places."""
    return [TimedFrame(motion, 0.05 * k) for k, motion in enumerate(motions)]


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize(("rate", "read_noise"), [(1e5, 8.0), (1e4, 8.0), (1e6, 2.0)])
def test_levels_are_those_of_the_formula(name, rate, read_noise):
    """For frames at rest, on every path, and of unequal lengths, in dim and in bright light."""
    pairs, published = CASES[name]
    motions, by_hand = zip(*pairs, strict=True)
    scene = _scene(rate, read_noise)
    level = float(exposures_psnr(scene, _frames(motions)))
    assert level == pytest.approx(_level(scene, *by_hand), abs=SAME_LEVEL)
    if published is not None and rate == 1e5:
        assert level == pytest.approx(published, abs=SAME_LEVEL)


def test_frames_never_hurt():
    """One more frame, however poor, lowers the error at every weighting of the speeds."""
    scene = _scene(weights=np.array([3, 1, 0.5, 1, 2, 1, 0, 1, 4]))
    good, poor = [_parabola(9e-3, 26e4)[0]] * 3, _still(2e-5)[0]
    without, within = (
        float(exposures_psnr(scene, _frames(each))) for each in (good, [*good, poor])
    )
    assert 0 < within - without < 1e-2


def _swings(num_frames, half, acceleration):
    motion = ParabolicMotion(acceleration=acceleration, half_exposure=half)
    return [motion] * num_frames


@pytest.mark.parametrize(
    ("motions", "level"),
    [
        ([_still(1.25e-3)[0]] * 4, 30.8298),
        (_swings(4, 1e-2, 27e4), 31.0784),
        ([_still(33.6e-3)[0], *[_still(0.7e-3)[0]] * 3], 33.1085),
        ([_still(20e-3)[0], *_swings(3, 6.5e-3, 19 / 6.5e-3**2)], 35.0692),
    ],
    ids=["stills", "parabolas", "bracketed stills", "a still and three parabolas"],
)
def test_parts_before_a_background_are_restored_each_by_its_speed(motions, level):
    """Published levels where 30 % of the picture moves; a moving background has the same speeds."""
    frames = _frames(motions)
    layered = _scene(occlusion=Occlusion(front_share=0.3))
    assert float(exposures_psnr(layered, frames)) == pytest.approx(level, abs=SAME_LEVEL)
    moving = _scene(occlusion=Occlusion(front_share=0.3, background="moving"))
    whole = float(exposures_psnr(_scene(), frames))
    assert float(exposures_psnr(moving, frames)) == pytest.approx(whole, abs=1e-6)
