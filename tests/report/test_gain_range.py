"""How far a gain moves within the errors of measured numbers."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import MOTION, SCENE
from support.rows import STILL

from mishutter import (
    HannShutter,
    MeasurementErrors,
    Occlusion,
    RectShutter,
    StillCamera,
    TimedFrame,
    evaluate,
)
from mishutter.evaluation.levels import exposures_psnr
from mishutter.evaluation.speed_knowledge import KNOWN_SPEED
from mishutter.model.exposures import Exposures
from mishutter.report.gain_range import gain_range
from mishutter.report.verdict import headline
from mishutter.search.rows import BEST_SNAPSHOT, FRAMES, OWN_BEST_MOTION, Row


def row(scene, name, motion, shutter):
    return Row(
        OWN_BEST_MOTION,
        name,
        Exposures.of_one(motion, shutter),
        None,
        evaluate(scene, motion, shutter),
    )


def gain(scene):
    """Expected PSNR of a coded exposure over a snapshot, by metrics alone; dB."""
    coded, still = evaluate(scene, MOTION, HannShutter()), evaluate(scene, STILL, RectShutter())
    return float(coded.expected_psnr - still.expected_psnr)


def found(scene, **errors):
    scene = replace(scene, errors=MeasurementErrors(**errors))
    rows = row(scene, "a", MOTION, HannShutter()), row(scene, BEST_SNAPSHOT, STILL, RectShutter())
    return gain_range(scene, *rows)


def with_speeds(scale):
    return replace(SCENE, speeds=np.asarray(SCENE.speeds) * scale)


FASTEST = float(SCENE.max_speed)
ENDS = {
    "light": (
        {"photon_rate": 0.1 * float(SCENE.photon_rate)},
        [replace(SCENE, photon_rate=np.asarray(SCENE.photon_rate) * k) for k in (0.8, 1.2)],
    ),
    "read noise": (
        {"read_noise": 1.3},
        [replace(SCENE, read_noise=np.asarray(SCENE.read_noise) + k) for k in (-2.6, 2.6)],
    ),
    "speed": ({"speed": 0.05 * FASTEST}, [with_speeds(0.9), with_speeds(1.1)]),
}


@pytest.mark.parametrize("slug", ENDS)
def test_the_ends_are_gains_within_two_errors(slug):
    """The same two cameras in the scenes at either end."""
    errors, scenes = ENDS[slug]
    wanted = sorted(gain(scene) for scene in scenes)
    np.testing.assert_allclose(found(SCENE, **errors), wanted, atol=1e-6)
    assert wanted[0] < gain(SCENE) < wanted[1]


def test_shifts_of_independent_errors_add_up_by_their_squares():
    """So that two errors move a gain by less than the sum of what each moves it by."""
    both = found(SCENE, **ENDS["light"][0], **ENDS["read noise"][0])
    each = np.array([found(SCENE, **ENDS[slug][0]) for slug in ("light", "read noise")])
    shifts = np.hypot(*(each - gain(SCENE)))
    np.testing.assert_allclose(np.abs(np.array(both) - gain(SCENE)), shifts, rtol=1e-6)


def test_the_share_of_objects_moves_a_gain_before_a_background():
    """And without a background nothing does: the gain is what it was."""
    layers = replace(SCENE, occlusion=Occlusion(front_share=0.4, object_width=90.0))
    low, high = found(layers, front_share=0.05)
    ends = [
        gain(replace(layers, occlusion=Occlusion(front_share=share, object_width=90.0)))
        for share in (0.3, 0.5)
    ]
    np.testing.assert_allclose([low, high], sorted(ends), atol=1e-6)
    np.testing.assert_allclose(found(SCENE, front_share=0.05), gain(SCENE), atol=1e-9)


def test_frames_are_levelled_in_the_other_scene():
    """A burst moves by the level of its frames; what the sensor's width costs stays."""
    scene = replace(SCENE, errors=MeasurementErrors(read_noise=1.3))
    frames = tuple(TimedFrame(StillCamera(half_exposure=2e-3), t) for t in (-0.011, 0.0, 0.013))
    still = row(scene, BEST_SNAPSHOT, STILL, RectShutter())
    level = float(still.level) + 2.2
    metrics = replace(still.metrics, known_speed_psnr=jnp.asarray(level))
    sequence = Exposures("stills", frames, 0.0, level, level - 1)
    burst = replace(
        still,
        name="burst",
        metrics=metrics,
        exposures=sequence,
        decoder=KNOWN_SPEED,
        hardware=frozenset({FRAMES}),
    )
    wanted = []
    for scenes in ENDS["read noise"][1]:
        moved = exposures_psnr(scenes, frames) - exposures_psnr(SCENE, frames)
        at_rest = evaluate(scenes, STILL, RectShutter()).expected_psnr - still.level
        wanted.append(2.2 + moved - float(at_rest))
    np.testing.assert_allclose(gain_range(scene, burst, still), sorted(wanted), atol=1e-6)


def test_without_errors_there_is_no_range():
    """Nor of a snapshot over itself."""
    rows = row(SCENE, "a", MOTION, HannShutter()), row(SCENE, BEST_SNAPSHOT, STILL, RectShutter())
    assert gain_range(SCENE, *rows) is None
    scene = replace(SCENE, errors=MeasurementErrors(read_noise=1.0))
    assert gain_range(scene, rows[1], rows[1]) is None


def test_a_first_line_names_the_range():
    """Once, where its ends are the same to a tenth."""
    rows = row(SCENE, "a", MOTION, HannShutter()), row(SCENE, BEST_SNAPSHOT, STILL, RectShutter())
    assert "2.6 to 3.3 dB better than a snapshot" in headline(*rows, SCENE.limits, (2.58, 3.31))
    assert ", 2.6 dB better than a snapshot" in headline(*rows, SCENE.limits, (2.58, 2.61))
    plain = f"{rows[0].margin_over(rows[1]):.1f} dB better than a snapshot"
    assert plain in headline(*rows, SCENE.limits)
