"""Stills of two exposures, where neighbouring readings would differ."""

import numpy as np
import pytest

from mishutter import BurstMode, Limits, Scene
from mishutter.evaluation.bursts import FrameTimes, StillBursts, best_still_burst

LIMITS = Limits(max_stroke=45.0, min_half_exposure=2e-4, max_half_exposure=0.02)
SPEEDS, WEIGHTS, RATE, NOISE = np.array([100.0, 3000.0]), np.array([0.8, 0.2]), 1e4, 0.4


def _scene(**burst):
    given = {"weights": WEIGHTS, "photon_rate": RATE, "read_noise": NOISE, "limits": LIMITS}
    return Scene(SPEEDS, burst=BurstMode(**burst), **given)


def test_fewer_frames_of_two_exposures_may_be_best():
    """Nine leave each less time beside the dead time than seven do."""
    scene = _scene(frames_per_s=240.0, max_frames=9, dead_time=3.5e-3)
    times = FrameTimes.of(scene, scene.burst)
    assert times.numbers_of_frames[-1] == 9
    equal = StillBursts(scene).best_within(times)
    found = best_still_burst(scene)
    assert (equal.num_frames, found.num_frames) == (7, 7)
    assert found.psnr > equal.psnr + 0.2


def test_two_exposures_are_those_of_the_worst_speed_where_it_counts():
    """Their level is the worst of the speeds, no worse than that of the exposures of the mean."""
    scene = _scene(frames_per_s=240.0, max_frames=6)
    times = FrameTimes.of(scene, scene.burst)
    (of_mean, mean), (of_worst, worst) = (
        StillBursts(scene, at_worst=each).best_bracketed(times) for each in (False, True)
    )
    bursts = StillBursts(scene)
    worst_of_mean = bursts.sequence(of_mean, times).worst_psnr
    assert worst == pytest.approx(bursts.sequence(of_worst, times).worst_psnr, abs=1e-6)
    assert mean > worst > worst_of_mean + 0.1
