"""However far light spreads, the expected error is sampled finely enough, or refused by name."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support import closed_form

from benchmarks import long_kernels
from mishutter import (
    DesignLoss,
    ExpectedErrorLoss,
    HannShutter,
    Limits,
    ParabolicMotion,
    RectShutter,
    Scene,
    StillCamera,
    TukeyShutter,
    evaluate,
    optimise,
    sweep,
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


@pytest.mark.slow
def test_what_travels_too_far_is_refused():
    """By a call and a search, and left out of a sweep: no tap is cut, no wave repeats."""
    scene = Scene([0.0, 70000.0], **LIGHT, limits=Limits(max_stroke=45.0, max_top_speed=4500.0))
    slow = ParabolicMotion(acceleration=180.0, half_exposure=0.5)
    line = r"^`motion` must blur over fewer than 65536 px at the scene's speeds, wherever .*; got"
    with pytest.raises(ValueError, match=line):
        DesignLoss()(scene, slow, HannShutter())
    with pytest.raises(ValueError, match=line):
        evaluate(scene, slow, HannShutter())
    with pytest.raises(ValueError, match=line):
        optimise(scene, slow, TukeyShutter(0.5), loss=DesignLoss(), num_starts=1)
    grid = {"accelerations": [180.0], "half_exposures": [0.5], "shutters": {"rect": RectShutter()}}
    swept = sweep(scene, **grid, velocities=[0.0], metrics=["condition_number"])
    meanings = swept.outside.attrs["flag_meanings"].split()
    assert swept.outside.values.item() == 1 << meanings.index("blur_too_long")
    assert np.isfinite(psnr(scene, slow, HannShutter()))
    far = Scene([0.0, 4e5], **LIGHT)
    line = r"^`motion` must spread light over at most 93623 px .*; got what takes \d+ frequencies"
    for motion in (slow, StillCamera(half_exposure=0.5)):
        with pytest.raises(ValueError, match=line):
            psnr(far, motion, HannShutter())


def test_a_traced_motion_is_refused_when_it_runs():
    """One that spreads light further than the limits let one that keeps up."""
    scene = Scene([0.0, 900.0, -400.0, 700.0], **LIGHT, limits=Limits(max_stroke=20.0))
    loss = jax.jit(
        lambda half: ExpectedErrorLoss()(
            scene, ParabolicMotion(acceleration=40.0, half_exposure=half), HannShutter()
        )
    )
    assert np.isfinite(loss(jnp.asarray(0.02)))
    with pytest.raises(Exception, match=r"must (spread light|blur) over at most"):
        loss(jnp.asarray(0.11)).block_until_ready()
