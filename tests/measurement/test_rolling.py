"""Clips of sensors whose rows are read one after another."""

import itertools

import numpy as np
import pytest
from scipy import ndimage

from mishutter import Sensor, measure
from mishutter.measurement.motion import Motion, MovingObject, read_in_turn, upright
from mishutter.measurement.scene import _narrowest
from mishutter.measurement.steady import bands_of_light, steady


@pytest.mark.parametrize(("row", "seen"), [(5e-5, 1 / 0.96), (-5e-5, 1 / 1.04), (0.0, 1.0)])
def test_velocities_and_heights_are_those_of_all_rows_at_once(row, seen):
    """What goes down at 800 px/s is met later by rows that are read downwards."""
    velocity, error = (800 * seen, 1500 * seen), (3.0, 2.0)
    one = MovingObject(velocity, error, (9.0, 9.0), 700, 1.0, 1.0, 3)
    labels = np.zeros((4, 4))
    motion = Motion((one,), labels.astype(int), labels, 3, 0.5, 0.0, (40.0, 60.0 * seen), 8)
    found = read_in_turn(motion, row)
    assert found.objects[0].velocity == pytest.approx((800, 1500), rel=1e-12)
    assert found.objects[0].error[0] == pytest.approx(3.0 / seen**2, rel=1e-12)
    across = np.hypot(2.0, 1500 * row * 3.0)  # an error downwards changes the share
    assert found.objects[0].error[1] == pytest.approx(across / seen, rel=1e-12)
    assert found.width == pytest.approx((40.0, 60.0), rel=1e-12)


def test_labels_of_rows_in_turn_are_put_upright():
    """Of things that go either way, each about its own middle row."""
    labels = np.zeros((40, 90), int)
    labels[4:24, 10:30], labels[10:31, 50:70] = 1, 2
    labels[35:] = -1
    slanted = np.minimum(labels, 0)
    for number, way in ((1, 0.4), (2, -0.3)):
        down, right = np.nonzero(labels == number)
        slanted[down, right + np.rint(way * (down - down.mean())).astype(int)] = number
    assert np.sum(np.any(slanted == 1, axis=0)) > 25
    np.testing.assert_array_equal(upright(slanted, [0.4, -0.3]), labels)
    np.testing.assert_array_equal(upright(labels, [0.0, 0.0]), labels)


def light_of(draw: np.random.Generator, mean: float, *shape: int) -> np.ndarray:
    """Light with detail about a mean; e-."""
    noise = ndimage.gaussian_filter(draw.normal(size=shape), 1.5)
    return np.clip(mean + 300 * noise / noise.std(), 0, None)


@pytest.mark.parametrize(
    ("readout", "right", "rows_read"), [(0.03, 600.0, "down"), (0.03, -600.0, "up")]
)
def test_a_thing_is_measured_as_all_rows_at_once_show_it(readout, right, rows_read):
    """A slant divides the columns of what moves, and frames are averaged as they show it."""
    draw, down, rows = np.random.default_rng(9), 250.0, np.arange(180)
    thing, behind, frames = light_of(draw, 2500, 60, 60), light_of(draw, 1200, 180, 220), []
    delays = Sensor(readout=readout, rows_read=rows_read).row_delays(180)
    for k in range(6):
        time = (k - 2.5) / 30 + delays
        y, x = rows - 60 - down * time, np.arange(220) - 80 - right * time[:, None]
        y = np.broadcast_to(y[:, None], x.shape)
        own = ndimage.map_coordinates(thing, [y, x], order=1, mode="nearest")
        is_own = (y >= 0) & (y <= 59) & (x >= 0) & (x <= 59)
        frames.append(np.where(is_own, own, behind))
    levels = draw.poisson(frames).astype(np.uint16)
    found = measure(levels, frames_per_s=30, black=0, readout=readout, rows_read=rows_read)
    assert found.motion.objects[0].velocity == pytest.approx((down, right), abs=2)
    narrowest = _narrowest(found.motion, "columns", float(np.mean(np.diff(delays))))
    for width in (found.motion.width[1], narrowest):
        assert width == pytest.approx(58, abs=1.5)
    moves = found.motion.labels > 0
    light, seen = np.asarray(found.light[..., 0])[moves], frames[found.motion.frame][moves]
    assert np.corrcoef(light, seen)[0, 1] > 0.785


def picture():
    """Light of a picture; e-."""
    noise = np.random.default_rng(5).normal(size=(160, 240))
    return np.clip(1200 + 1500 * ndimage.gaussian_filter(noise, 2), 200, 4000)


@pytest.mark.parametrize(("swing", "least", "most"), [(0.0, 0.0, 0.0), (0.03, 0.018, 0.023)])
def test_the_mains_light_rows_in_bands(swing, least, most):
    """At 100 Hz the rows of 20 ms see two periods; row noise is none."""
    draw, rows, frames = np.random.default_rng(2), np.arange(160) / 159, np.arange(8)
    phase = 2 * np.pi * 100 * (frames[:, None] / 30.3 + 0.02 * rows)
    light = picture() * (1 + swing * np.cos(phase))[:, :, None]
    clip = draw.poisson(light) + draw.normal(size=(8, 160, 1)) * 5
    assert least <= bands_of_light(clip) <= most


def test_a_clip_with_bands_says_so_and_the_file_has_the_readout():
    """The scene file holds the readout, and the sentence is at its head."""
    draw, rows = np.random.default_rng(3), np.arange(160) / 159
    phase = 2 * np.pi * 100 * (np.arange(8)[:, None] / 30.3 + 0.02 * rows)
    light = picture() * (1 + 0.05 * np.cos(phase))[:, :, None]
    clip = np.rint(draw.poisson(light) + 64).astype(np.uint16)
    found = measure(clip, frames_per_s=30.3, black=64, readout=0.02, rows_read="up")
    assert "in bands of rows that change from frame to frame" in found.scene_text
    assert "readout_ms = 20  # as given" in found.scene_text
    assert 'rows_read = "up"' in found.scene_text
    with pytest.raises(ValueError, match=r"readout=...\)` must be at least 0, within the 33"):
        measure(clip, frames_per_s=30.3, black=64, readout=0.04)


def test_bands_are_divided_out_about_black():
    """Noise, the focus and what stands still are as in light that is even."""
    draw, rows = np.random.default_rng(4), np.arange(160) / 159
    phase = 2 * np.pi * 100 * (np.arange(10)[:, None] / 50.3 + 0.015 * rows)
    light = picture() * (1 + 0.2 * np.cos(phase))[:, :, None]
    frames = 0.5 * draw.poisson(light) + 64 + draw.normal(size=light.shape)
    even = steady(frames.astype(np.float32), 1.0)
    assert even.bands > 0.02
    assert even.focus == 0
    assert even.moves is None
    noise = np.diff(even.same, axis=0)
    # Half a level an electron, and the noise of one level: in quarters of the levels as well.
    level = np.median(even.same, axis=0)
    for low, high in itertools.pairwise(np.quantile(level, (0, 0.25, 0.5, 0.75, 1))):
        some = (level >= low) & (level < high)
        wanted = 2 * (0.5 * (level[some].mean() - 64) + 1)
        assert np.var(noise[:, some]) == pytest.approx(wanted, rel=0.06)
