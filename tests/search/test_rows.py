"""Rows of a comparison: which of them are the same camera, and which is the best."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import pytest
from support.designs import MOTION, SCENE
from support.rows import FREE, STILL, changed, made_up, sequence

from mishutter import (
    ChippedShutter,
    FreeMotion,
    IdealDevice,
    ParabolicMotion,
    RectShutter,
    SplineShutter,
    TimedFrame,
    TukeyShutter,
)
from mishutter.evaluation.metrics import SequenceMetrics, evaluate
from mishutter.evaluation.views import transmittance
from mishutter.report.comparison import with_verdict
from mishutter.search.rivals import _row_of_burst
from mishutter.search.rows import (
    BEST_PANNED_SNAPSHOT,
    BEST_SNAPSHOT,
    SHUTTER,
    best_row,
    cameras_of,
    choice_of,
)

OPENING = ChippedShutter([0.25, 0.75, 1.0])
"""A shutter that opens in three steps."""

SAME = {
    "a taper that ends at none": lambda row: {"shutter": TukeyShutter(1e-5)},
    "a free profile that stays open": lambda row: {"shutter": SplineShutter.fit(RectShutter())},
    "a free path that is the parabola": lambda row: {
        "motion": FreeMotion.fit(row.motion, num_pieces=5)
    },
    "one that another search found": lambda row: {"motion": like(row.motion, longer=1.00002)},
}
OTHERS = {
    "a taper": lambda row: {"shutter": TukeyShutter(0.05)},
    "a free path": lambda row: {"motion": FREE},
    "a longer exposure": lambda row: {"motion": like(row.motion, longer=1.02)},
    "the other direction": lambda row: {"motion": like(row.motion, faster=-1)},
    "another level": lambda row: {
        "metrics": replace(row.metrics, expected_psnr=jnp.asarray(26.375))
    },
    "several frames": lambda row: {"exposures": sequence(row.motion, 3)},
}


def like(motion, *, longer=1.0, faster=1.0):
    """A parabola of another exposure or pan."""
    return ParabolicMotion(
        acceleration=motion.acceleration,
        half_exposure=motion.half_exposure * longer,
        velocity=motion.velocity * faster,
    )


@pytest.fixture(scope="module")
def opened():
    """An open shutter on a parabola that pans."""
    return made_up({"rect": 26.25})[0]


@pytest.mark.parametrize("slug", SAME)
def test_rows_of_one_camera(slug, opened):
    """Whatever led to it, a camera that does the same is the same, from either side."""
    other = changed(opened, name="other", **SAME[slug](opened))
    assert opened.is_same_camera_as(other)
    assert other.is_same_camera_as(opened)
    assert [[row.name for row in each] for each in cameras_of([opened, other])] == [
        ["rect", "other"]
    ]


@pytest.mark.parametrize("slug", OTHERS)
def test_rows_of_two_cameras(slug, opened):
    """What somebody would build differently, or read another level of, stays apart."""
    other = changed(opened, name="other", **OTHERS[slug](opened))
    assert not opened.is_same_camera_as(other)
    assert not other.is_same_camera_as(opened)
    names = [[row.name for row in each] for each in cameras_of([opened, other, opened])]
    assert names == [["rect", "rect"], ["other"]]


def test_bursts_are_one_camera_by_all_their_frames(opened):
    """Neither the first nor the last stands for the others; a burst has no motion of its own."""
    frames = sequence(MOTION, 3)
    burst = changed(opened, exposures=frames)
    first, *_, last = frames.frames
    for other in (replace(first, time=-0.001), replace(last, position=0.1), TimedFrame(FREE, 0.06)):
        parts = frames.frames[1:] if other.time < 0 else frames.frames[:-1]
        each = (other, *parts) if other.time < 0 else (*parts, other)
        assert not burst.is_same_camera_as(changed(burst, exposures=replace(frames, frames=each)))
    near = replace(last, position=0.01)
    same = replace(frames, frames=(*frames.frames[:-1], near))
    assert burst.is_same_camera_as(changed(burst, exposures=same))
    assert not burst.is_free
    assert changed(burst, exposures=sequence(FREE, 2)).is_free
    with pytest.raises(ValueError, match=r"must be of one exposure along an axis; got"):
        _ = burst.motion


def test_a_profile_in_reverse_is_another_camera(opened):
    """Though all of its metrics are the same where speeds lie evenly about 0."""
    rising = changed(opened, shutter=OPENING)
    falling = changed(opened, shutter=ChippedShutter(OPENING.transmittances[::-1]))
    assert not rising.is_same_camera_as(falling)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_a_shutter_that_stays_open_is_not_required(dtype, opened):
    """A few roundings below 1 are open in either precision; a taper that closes is a shutter."""
    for shortfall, is_required in ((5 * jnp.finfo(dtype).eps, False), (1e-3, True)):
        efficiency = jnp.asarray(1 - shortfall, dtype)
        row = replace(opened, metrics=replace(opened.metrics, efficiency=efficiency))
        assert (SHUTTER in row.required_hardware) == is_required


@pytest.mark.parametrize("order", [1, -1])
def test_the_best_of_equals_is_the_simplest(opened, order):
    """A rounding prefers no window that stays open, and no pan that stands still; 0.2 mdB do."""
    window = changed(opened, name="best Tukey", shutter=TukeyShutter(0.0))
    hann = made_up({"Hann": 26.25})[0]
    still, panned = made_up({BEST_SNAPSHOT: 26.25, BEST_PANNED_SNAPSHOT: 26.25})
    at_rest = changed(panned, motion=still.motion)
    for simple, other in ((opened, window), (opened, hann), (still, panned), (still, opened)):
        for above, best in ((4e-15, simple), (2e-4, other)):
            level = jnp.asarray(26.25 + above)
            better = replace(other, metrics=replace(other.metrics, expected_psnr=level))
            found = best_row([simple, better][::order])
            assert found.name == best.name
    better = replace(
        at_rest, metrics=replace(panned.metrics, expected_psnr=jnp.asarray(26.25 + 4e-15))
    )
    assert best_row([still, better]) is still


def test_an_option_is_the_simplest_of_equals():
    """What needs a stage alone is the open shutter, and not the window that ends in it."""
    rows = made_up({BEST_SNAPSHOT: 23.0, "rect": 24.5, "optimised": 25.0})
    window = changed(rows[1], name="best Tukey", shutter=TukeyShutter(0.0))
    metrics = replace(window.metrics, expected_psnr=jnp.asarray(24.5 + 4e-15))
    case = with_verdict(
        [*rows, replace(window, metrics=metrics)], {"optimised": RectShutter()}, SCENE
    )
    assert [row.name for row in case.options] == [BEST_SNAPSHOT, "rect", "optimised"]


def test_a_device_that_loses_light_is_required():
    """What passes 0.4 of the light when open is no ordinary shutter, but for one never closed."""
    scene = eqx.tree_at(
        lambda scene: scene.device,
        SCENE,
        IdealDevice(transmission=0.4),
        is_leaf=lambda part: part is None,
    )
    for command, is_required in (
        (TukeyShutter(0.25), True),
        (TukeyShutter(0.0), False),
    ):
        shutter = transmittance(scene, MOTION, command)
        row = changed(
            made_up({"a": 24.0})[0], shutter=shutter, metrics=evaluate(scene, MOTION, shutter)
        )
        assert (SHUTTER in row.required_hardware) == is_required


def test_a_burst_has_the_metrics_of_its_decoder():
    """Its levels and its light: no kernel of one frame is the blur of all."""
    frames = sequence(MOTION, 3)
    row = _row_of_burst("best moving burst", frames)
    assert row.metrics == SequenceMetrics(1.0, frames.psnr, frames.worst_psnr)
    assert (row.psnr, row.worst_psnr, row.within) == (frames.psnr, frames.worst_psnr, None)
    assert SHUTTER not in row.required_hardware
    assert not row.hides_speed


def test_a_pan_that_has_nowhere_to_go_is_no_other_snapshot():
    """Without a stage it is better by a rounding than the same one at rest, which is taken."""
    rest, pan = made_up({BEST_SNAPSHOT: 28.74, BEST_PANNED_SNAPSHOT: 28.7401})
    assert choice_of([rest, changed(pan, motion=STILL)]) is rest
    assert choice_of([rest, pan]) is rest
    (better,) = made_up({BEST_PANNED_SNAPSHOT: 31.0})
    assert choice_of([rest, better]) is better
