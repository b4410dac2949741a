"""Errors of open frames by NumPy, against the formula of all motions and shutters."""

import numpy as np
import pytest
from mishutter.evaluation.moving_bursts import _Room, _Search, _Try
from support.burst_levels import FrameGroup, burst_psnr

from mishutter import Limits, Occlusion, Scene, Sensor
from mishutter.evaluation.bursts import FrameTimes
from mishutter.evaluation.open_frames import OpenFrames, psnr_of_error

SPEEDS = np.linspace(-3100.0, 3700.0, 6)
PERIOD = 0.017


def _scene(**others):
    limits = Limits(max_stroke=80.0, min_half_exposure=1e-4, max_half_exposure=0.03)
    given = {"photon_rate": 7e4, "read_noise": 5.0, "limits": limits}
    weights = [0.1, 0.3, 0.15, 0.2, 0.05, 0.2]
    return Scene(SPEEDS, weights, **(given | others))


def _place(kind, num_moving, num_rests, scene):
    """Frames of a path beside a pan."""
    times = FrameTimes(PERIOD, 0.2, 2e-4, PERIOD)
    search = _Search(_Room(scene.limits), times, True, -3100.0, 3700.0)
    each = _Try(search, kind, num_moving, num_rests)
    return each, each.at(np.array([0.97, 0.83, 0.6, 0.52, 0.1]))


@pytest.mark.slow
@pytest.mark.parametrize("num_rests", [0, 2])
@pytest.mark.parametrize("kind", ["alternating parabolas", "sine", "sweep", "fan of pans"])
def test_paths_have_the_errors_of_the_formula(kind, num_rests):
    """Frame by frame, with the pieces of the motions that a sequence holds."""
    scene = _scene(occlusion=Occlusion(front_share=0.7), sensor=Sensor(full_well=9e3))
    each, place = _place(kind, 3, num_rests, scene)
    frames = OpenFrames.of(scene, PERIOD, folds=False)
    error = float(frames.weights @ place.errors(frames))
    groups = [
        FrameGroup(x.motion.without_velocity(), np.array([float(x.motion.velocity)]))
        for x in each.sequence(place, np.ones(1), 1.0).frames
    ]
    assert psnr_of_error(error) == pytest.approx(float(burst_psnr(scene, groups)), abs=1e-4)


@pytest.mark.parametrize("kind", ["alternating parabolas", "sine", "sweep", "fan of pans"])
@pytest.mark.parametrize("num_rests", [0, 1])
def test_few_frequencies_tell_bursts_apart(kind, num_rests):
    """In single precision too: within 0.005 dB of all frequencies."""
    scene = _scene()
    _, place = _place(kind, 4, num_rests, scene)
    frames = OpenFrames.of(scene, PERIOD, folds=False)
    levels = [psnr_of_error(float(x.weights @ place.errors(x))) for x in (frames, frames.coarser())]
    assert levels[1] == pytest.approx(levels[0], abs=0.005)


def test_a_path_that_stands_still_is_a_frame_at_rest():
    """The mean of waves over the exposure is then a sinc."""
    frames = OpenFrames.of(_scene(), PERIOD, folds=False)

    def places(times):
        return np.full((1, times.size), 3.7)

    for each, precision in ((frames, 1e-9), (frames.coarser(), 1e-4)):
        passed = each.on_paths(places, 0.0131, 3700.0)
        np.testing.assert_allclose(passed, each.at_rest(0.0131), atol=precision)


def test_speeds_of_either_sign_are_one_without_a_pan():
    """Weights are added up, and the error of frames at rest stays the same."""
    scene = _scene()
    both, folded = (OpenFrames.of(scene, PERIOD, folds=folds) for folds in (False, True))
    errors = [x.error(x.snr(x.at_rest(0.0023), 0.0023)) for x in (both, folded)]
    assert folded.speeds.size <= both.speeds.size
    assert np.all(folded.speeds >= 0)
    assert errors[1] == pytest.approx(errors[0], rel=1e-12)
