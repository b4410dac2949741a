"""However far light spreads, the expected error is sampled finely enough, or refused by name."""

import numpy as np
import pytest
from support import closed_form

from benchmarks import long_kernels
from mishutter import (
    ExpectedErrorLoss,
    Limits,
    ParabolicMotion,
    RectShutter,
    Scene,
)

PSNR_ERROR = 0.02
"""Difference from 65,536 frequencies, dB: promised of any scene."""
LIGHT = {"photon_rate": 3e4, "read_noise": 8.0}


def psnr(scene, motion, shutter):
    loss = float(ExpectedErrorLoss()(scene, motion, shutter))
    return -20 * np.log10(loss * float(scene.picture.deviation))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_random_scenes(seed):
    """Strokes to 2,000 px, by a reference that has neither nodes nor waves."""
    assert abs(long_kernels.case(seed)["less exact dB"]) < PSNR_ERROR


@pytest.mark.slow
@pytest.mark.parametrize("further", [0.0, 512.0, 1024.0, 4096.0])
def test_objects_that_the_sensor_falls_far_behind(further):
    """Kernels of hundreds of px, which 256 frequencies repeat within the light of one object."""
    stroke, half = 20.0, 0.02
    smear = np.sqrt(4 * stroke * (200.0 + further))
    scene = Scene([0.0, smear / half], **LIGHT, limits=Limits(max_stroke=stroke))
    motion = ParabolicMotion(acceleration=stroke / half**2, half_exposure=half)
    exact = closed_form.expected_psnr(
        closed_form.RECT, stroke, half, np.asarray(scene.speeds), 3e4, 8.0
    )
    assert abs(psnr(scene, motion, RectShutter()) - exact) < PSNR_ERROR
