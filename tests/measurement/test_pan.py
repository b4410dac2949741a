"""Noise of pictures that move as a whole, against photographs whose noise is known."""

import numpy as np
import pytest
from scipy import ndimage
from support.clips import ClipOf, Thing, photograph

from mishutter.measurement.clip import clip_of
from mishutter.measurement.measurement import noise_from
from mishutter.measurement.pan import _ways, registered
from mishutter.measurement.steady import bands_of_light

SIZE = 120, 150
CLIP = ClipOf(size=SIZE, electrons=3000.0)
LIGHT = photograph("camera.png", 320, 340, seed=2)


def panned(step, count=8, light=LIGHT, rng=None):
    """Levels of a piece of a picture that goes by so much a frame, down and across."""
    rng = np.random.default_rng(4) if rng is None else rng
    frames = []
    for k in range(count):
        way = (k - (count - 1) / 2) * np.array(step)
        y, x = ((n - m) // 2 for n, m in zip(light.shape, SIZE, strict=True))
        moved = ndimage.shift(light, way, order=3)[y : y + SIZE[0], x : x + SIZE[1]]
        frames.append(CLIP.recorded(np.clip(moved, 0, 1), rng))
    return np.stack(frames)


@pytest.mark.parametrize(
    ("step", "size", "blur", "most"),
    [
        ((0, 1), "1", 0.0, 0.04),
        ((-3, 5), "5.8", 0.0, 0.04),
        ((12, -7), "14", 0.0, 0.04),
        ((1.6, 0.0), "1.6", 0.8, 0.06),  # parts of a pixel are a shake
    ],
)
def test_a_picture_that_pans_is_registered(step, size, blur, most):
    """Its noise is that of a clip at rest, which was up to half too high; the doubt has a name."""
    levels = panned(step, light=ndimage.gaussian_filter(LIGHT, blur) if blur else LIGHT)
    frames, noise = noise_from(clip_of(levels, 50.0, None, 4095.0), dark=CLIP.dark())
    assert not noise.refusals
    value, error = noise.electrons_at_white
    assert abs(value - 3000) < 2.5 * error
    assert error < most * 3000
    (word,) = (word for word in frames.words if "white" not in word)
    assert f"moves alike, by {size} px a frame" in word
    assert "fixed pattern" in word
    assert frames.frames.shape == (8, *SIZE)  # velocities are those of whole frames


def test_a_few_stuck_pixels_do_not_hold_dull_detail():
    """Of which a gradient of light that stands still is no part."""
    rng = np.random.default_rng(4)
    stuck, light = rng.random(SIZE) < 0.002, np.linspace(0.1, 0.9, SIZE[1])
    frames = []
    for k in range(-2, 3):
        moved = 0.1 * ndimage.shift(LIGHT - LIGHT.mean(), (4 * k, -3 * k), order=1)
        dull = CLIP.recorded(np.clip(light + moved[100:, 95:][: SIZE[0], : SIZE[1]], 0, 1), rng)
        frames.append(np.where(stuck, 4095, dull).astype(np.float32))
    np.testing.assert_array_equal(np.diff(_ways(np.stack(frames)), axis=0), [[4, -3]] * 4)


def test_ways_are_those_of_each_frame():
    """Counted from any place; frames are cut to what all show, which noise alone tells apart."""
    frames = panned((4, -3), 5).astype(np.float32)
    found = registered(frames)
    assert found is not None
    np.testing.assert_array_equal(np.diff(found.ways, axis=0), [[4, -3]] * 4)
    assert found.frames.shape == (5, SIZE[0] - 16, SIZE[1] - 12)
    np.testing.assert_array_equal(found.frames[0], frames[0][:-16, 12:])


@pytest.mark.parametrize("speed", [0.0, 150.0])
def test_objects_before_what_stands_still_are_no_pan(speed):
    """Be they over half of the picture."""
    things = (Thing((60, 75), (52, 66), (speed, 2 * speed)),) if speed else ()
    clip = ClipOf(things, SIZE, "camera.png", 6)
    assert registered(clip.levels().astype(np.float32)) is None


def test_an_object_before_a_dull_background_is_no_pan():
    """What is dull stands still, and tells noise without the pattern of the pixels."""
    clip = ClipOf((Thing((60, 75), (32, 38), (0.0, 150.0)),), SIZE, "camera.png", 6)
    object.__setattr__(clip, "_background", np.tile(np.linspace(0.1, 0.7, SIZE[1]), (SIZE[0], 1)))
    assert registered(clip.levels().astype(np.float32)) is None


def test_a_ramp_that_pans_is_no_flicker():
    """It brightens or darkens everywhere alike; lamps light each row by a share of its own."""
    ramp = np.repeat(np.linspace(0.02, 0.98, 320)[:, None], 340, axis=1)
    frames = panned((9, 0), light=ramp).astype(np.float32)
    assert bands_of_light(frames - 64) == 0
    bands = 1 + 0.03 * np.sin(np.arange(len(ramp)) / 16 + 2.0 * np.arange(8)[:, None])
    rng = np.random.default_rng(4)
    at_rest = np.stack([CLIP.recorded(ramp, rng) for _ in bands]).astype(np.float32)
    lit = (at_rest - 64) * bands[:, :, None]
    assert bands_of_light(lit) == pytest.approx(0.03 * np.sqrt(np.cos(8 / 16) / 2), rel=0.1)
