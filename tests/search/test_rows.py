"""Rows of a comparison: which of them are the same camera."""

from dataclasses import replace

import jax.numpy as jnp
import pytest
from support.rows import FREE, made_up, sequence

from mishutter import (
    ChippedShutter,
    FreeMotion,
    ParabolicMotion,
    RectShutter,
    SplineShutter,
    TukeyShutter,
)
from mishutter.search import cameras_of

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
    "several frames": lambda row: {"sequence": sequence(row.motion, 3)},
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
    other = replace(opened, name="other", **SAME[slug](opened))
    assert opened.is_same_camera_as(other)
    assert other.is_same_camera_as(opened)
    assert [[row.name for row in each] for each in cameras_of([opened, other])] == [
        ["rect", "other"]
    ]


@pytest.mark.parametrize("slug", OTHERS)
def test_rows_of_two_cameras(slug, opened):
    """What somebody would build differently, or read another level of, stays apart."""
    other = replace(opened, name="other", **OTHERS[slug](opened))
    assert not opened.is_same_camera_as(other)
    assert not other.is_same_camera_as(opened)
    names = [[row.name for row in each] for each in cameras_of([opened, other, opened])]
    assert names == [["rect", "rect"], ["other"]]


def test_a_profile_in_reverse_is_another_camera(opened):
    """Though all of its metrics are the same where speeds lie evenly about 0."""
    rising = replace(opened, shutter=OPENING)
    falling = replace(opened, shutter=ChippedShutter(OPENING.transmittances[::-1]))
    assert not rising.is_same_camera_as(falling)
