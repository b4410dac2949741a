"""Errors of open frames by NumPy, against the formula of all motions and shutters."""

import numpy as np
import pytest

from mishutter import Limits, Scene
from mishutter.evaluation.open_frames import OpenFrames

SPEEDS = np.linspace(-3100.0, 3700.0, 6)
PERIOD = 0.017


def _scene(**others):
    limits = Limits(max_stroke=80.0, min_half_exposure=1e-4, max_half_exposure=0.03)
    given = {"photon_rate": 7e4, "read_noise": 5.0, "limits": limits}
    weights = [0.1, 0.3, 0.15, 0.2, 0.05, 0.2]
    return Scene(SPEEDS, weights, **(given | others))


def test_speeds_of_either_sign_are_one_without_a_pan():
    """Weights are added up, and the error of frames at rest stays the same."""
    scene = _scene()
    both, folded = (OpenFrames.of(scene, PERIOD, folds=folds) for folds in (False, True))
    errors = [x.error(x.snr(x.at_rest(0.0023), 0.0023)) for x in (both, folded)]
    assert folded.speeds.size <= both.speeds.size
    assert np.all(folded.speeds >= 0)
    assert errors[1] == pytest.approx(errors[0], rel=1e-12)
