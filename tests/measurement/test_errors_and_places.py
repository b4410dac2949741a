"""Errors by their size, and places by the frame and the axis that they are in."""

import numpy as np
import pytest
from scipy import ndimage
from support.clips import ClipOf, Thing

from mishutter.measurement import motion as motion_module
from mishutter.measurement.clip import Clip, clip_of
from mishutter.measurement.estimates import Estimate
from mishutter.measurement.motion import Motion, MovingObject, motion_of
from mishutter.measurement.noise import _root
from mishutter.measurement.photon_transfer import Law, Transfer, blocks_of, pairs_of
from mishutter.measurement.scene import along_axis
from mishutter.measurement.signs import detail_excess
from mishutter.measurement.steady import Steady
from mishutter.measurement.texture import averaged


def an_object(velocity, error) -> MovingObject:
    return MovingObject(velocity, error, (50.0, 60.0), 4000, 9.0, 1.0, 2)


@pytest.mark.parametrize(
    ("velocity", "axis", "error"), [((20.0, 300.0), "rows", 2.0), ((300.0, 20.0), "columns", 9.0)]
)
def test_the_error_of_a_speed_is_that_along_its_axis(velocity, axis, error):
    """Of an object known to 9 px/s down and 2 px/s across; its size errs by what lies along it."""
    each = an_object(velocity, (9.0, 2.0))
    along = along_axis([each])
    assert (along.axis, along.error) == (axis, error)
    down, across = np.array(velocity) / np.hypot(*velocity)
    assert each.speed.error == pytest.approx(np.hypot(9 * down, 2 * across))


@pytest.mark.parametrize(
    ("square", "error", "wanted"),
    [
        (4.0, 0.4, (4.0, 0.2)),  # the root of 4 +- 0.4 is 2 +- 0.1
        (0.09, 0.16, (0.6, 0.8)),  # that of 0.09 +- 0.16 is as uncertain as the root of 0.16
    ],
)
def test_two_errors_of_a_root_add_up_by_their_squares(square, error, wanted):
    """That of the square, and that of the gain beside the 3 % of clips of known truth."""
    value, of_square = wanted
    found = _root(square, error, Estimate(0.5, 0.02))
    assert found.value == pytest.approx(value)
    assert found.error == pytest.approx(np.hypot(of_square, value * np.hypot(0.04, 0.03)))


def test_frames_of_noise_alone_are_averaged_as_a_whole():
    """A frame shows the same as another unless it is unlike it: 8 are worth 7.7 or more."""
    frames = np.random.default_rng(3).normal(size=(8, 192, 240)).astype(np.float32)
    shape = frames.shape[1:]
    still = Motion((), np.zeros(shape, int), np.ones(shape), 3, 1.0, 0.0, (0.0, 0.0), 8)
    mean = averaged(frames, frames, still, 50.0)
    assert 7.7 < np.mean(mean.num_frames) < 7.85
    assert np.var(mean.levels) * 7.75 == pytest.approx(1, abs=0.06)


def test_files_are_read_up_to_the_most_frames_of_all(tmp_path):
    """Two of 40 frames give 64: all of the first, and the first 24 of the second."""
    frames = np.random.default_rng(4).integers(70, 900, (80, 48, 49)).astype(np.uint16)
    files = [tmp_path / "a.npy", tmp_path / "b.npy"]
    for file, part in zip(files, (frames[:40], frames[40:]), strict=True):
        np.save(file, part)
    clip = clip_of(files, 50.0, None, None)
    np.testing.assert_array_equal(clip.frames, frames[:64])


@pytest.mark.parametrize(
    ("name", "behind", "velocity", "error"),
    [
        ("chelsea.png", "astronaut.png", (100.0, -150.0), 3),
        ("camera.png", "brick.png", (-100.0, 150.0), 1.5),
    ],
)
def test_an_object_of_a_long_clip_is_at_its_centre_in_its_frame(name, behind, velocity, error):
    """Of 22 frames the middle 16 are looked at, and frames are counted from the clip's first."""
    thing = Thing((70, 94), (28, 34), velocity, name)
    clip = ClipOf((thing,), (144, 192), behind, num_frames=22, num_instants=1)
    frames = np.stack([clip.light(time) for time in clip.times])
    frames = 50 * frames + np.random.default_rng(5).normal(size=frames.shape)
    motion = motion_of(frames.astype(np.float32), clip.frames_per_s)
    each = motion.objects[0]
    assert each.velocity == pytest.approx(thing.velocity, abs=1)
    time = clip.times[each.frame]
    place = np.array(thing.centre) + np.array(thing.velocity) * time
    assert each.centre == pytest.approx(tuple(place), abs=error)
    assert motion.frame == 3 + 8


def test_the_error_of_a_velocity_in_bright_light_is_the_floor_over_the_duration():
    """Noise leaves nothing of it: 0.05 px over 13 frames of 20 ms."""
    thing = Thing((70, 94), (28, 34), (100.0, -150.0), "chelsea.png")
    clip = ClipOf((thing,), size=(144, 192), num_frames=22, num_instants=1)
    frames = 2000 * np.stack([clip.light(time) for time in clip.times])
    frames = frames + np.random.default_rng(5).normal(size=frames.shape)
    each = motion_of(frames.astype(np.float32), clip.frames_per_s).objects[0]
    assert each.error == pytest.approx((0.05 / 13 * 50,) * 2, rel=1e-3)


def test_the_error_of_what_detail_adds_is_its_scatter():
    """Of a picture at rest, in pairs that share their frames, over 150 clips of noise."""
    random, law = np.random.default_rng(3), Law(25.0, 0.0, 1e-12)
    light = 100 + 300 * ndimage.gaussian_filter(random.normal(size=(80, 72)), 2)
    found = []
    for _ in range(150):
        frames = (light + 5 * random.normal(size=(6, 80, 72))).astype(np.float32)
        clip = Clip(frames, 50.0, None, 4095.0, 0.0, (-np.inf, np.inf))
        blocks, rest = blocks_of(Steady.of(frames), pairs_of(6), clip.ends), Estimate(0.0, 1.0)
        transfer = Transfer(
            law, blocks, blocks, 1.0, np.zeros((2, 2)), rest, np.ones(blocks.shape, bool)
        )
        found.append(detail_excess(clip, Steady.of(frames), transfer))
    values, errors = np.transpose(found)
    assert np.std(values) == pytest.approx(np.sqrt(np.mean(errors**2)), rel=0.1)
    assert abs(np.mean(values)) < np.mean(errors) / 2


def test_a_large_frame_is_measured_on_larger_pixels(monkeypatch):
    """Velocity, place and area are those of the frame's own pixels."""
    monkeypatch.setattr(motion_module, "MOST_PIXELS", 10_000)
    thing = Thing((70, 94), (44, 52), (200.0, -300.0), "chelsea.png")
    clip = ClipOf((thing,), (144, 192), "astronaut.png", num_frames=5, num_instants=1)
    frames = 50 * np.stack([clip.light(time) for time in clip.times])
    frames = frames + np.random.default_rng(5).normal(size=frames.shape)
    motion = motion_of(frames.astype(np.float32), clip.frames_per_s)
    each = motion.objects[0]
    assert each.velocity == pytest.approx(thing.velocity, abs=4)
    assert each.centre == pytest.approx(thing.centre, abs=4)
    assert each.area == pytest.approx(np.pi * 44 * 52, rel=0.15)
    assert motion.labels.shape == clip.size
    assert np.sum(motion.labels == 1) == pytest.approx(each.area, rel=0.02)
    assert motion.width[0] == pytest.approx(np.pi / 2 * 52, rel=0.15)
