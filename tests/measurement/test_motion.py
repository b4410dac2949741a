"""Objects of clips of photographs: their velocities, their places, and what has none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from support.clips import ClipOf, Thing

from mishutter.measurement.clip import clip_of
from mishutter.measurement.measurement import noise_from
from mishutter.measurement.motion import MovingObject, _owners, _unlike_rest, _view, motion_of
from mishutter.pictures.registration.sweep import Smoothed, swept
from mishutter.pictures.registration.windows import Window

CLIP = ClipOf(
    (
        Thing((70, 80), (38, 46), (190.0, 310.0)),
        Thing((125, 160), (40, 36), (-120.0, -265.0), "chelsea.png"),
    ),
    size=(192, 240),
    background="astronaut.png",
    num_frames=5,
)


def found(clip, levels=None):
    levels = clip.levels() if levels is None else levels
    black = float(clip.black_level)
    frames, noise = noise_from(clip_of(levels, 50.0, None, float(clip.full)), black=black)
    return motion_of(noise.law.of_unit_noise(frames.frames), 50.0)


@pytest.fixture(scope="module")
def motion():
    return found(CLIP)


def test_objects_are_found_with_their_velocities(motion):
    """Within a pixel over the clip, and four of their errors; nothing else moves."""
    span = 4 / 50
    assert len(motion.objects) == 2
    for thing in CLIP.things:
        away = [np.array(o.velocity) - thing.velocity for o in motion.objects]
        best = int(np.argmin(np.hypot(*np.transpose(away))))
        assert np.hypot(*away[best]) * span < 1
        assert np.all(np.abs(away[best]) < 4 * np.array(motion.objects[best].error))
        assert motion.objects[best].lead > 2


def test_labels_are_where_objects_are(motion):
    """By the numbers of the list; the share at rest and the lengths of runs are those of these."""
    truth = CLIP.labels(CLIP.times[motion.frame])
    for number, each in enumerate(motion.objects, 1):
        mine = motion.labels == number
        own = np.bincount(truth[mine], minlength=3)
        assert own.max() > 0.85 * own.sum()
        speeds = [np.hypot(*(np.array(t.velocity) - each.velocity)) for t in CLIP.things]
        assert own.argmax() == 1 + int(np.argmin(speeds))
    assert abs(motion.share_at_rest - np.mean(truth == 0)) < 0.06
    assert motion.share_at_rest == pytest.approx(np.mean(motion.labels == 0))
    assert motion.share_unexplained == pytest.approx(np.mean(motion.labels < 0))
    areas = [each.area for each in motion.objects]
    assert areas == sorted(areas, reverse=True)
    begins = np.sum((truth[:, 1:] > 0) & (truth[:, :-1] == 0))
    assert motion.width[0] == pytest.approx(np.sum(truth > 0) / begins, rel=0.25)


def test_trust_is_low_at_edges_alone(motion):
    """Where an object hides another, no velocity explains all frames."""
    truth = CLIP.labels(CLIP.times[motion.frame])
    edge = ndimage.maximum_filter(truth, 5) != ndimage.minimum_filter(truth, 5)
    far = ~ndimage.binary_dilation(edge, iterations=12)
    assert np.mean(motion.trust[far] > 0.5) > 0.97
    assert np.mean(motion.trust[edge]) < 0.6


def test_nothing_moves_in_a_clip_at_rest():
    """No object is made up, and all is at rest."""
    still = found(replace(CLIP, things=()))
    assert still.objects == ()
    assert still.share_at_rest == 1


def test_two_frames_are_enough():
    """For the velocity of a large object, whose error is that of two frames."""
    clip = replace(CLIP, num_frames=2, things=CLIP.things[1:])
    (each,) = found(clip).objects
    away = np.array(each.velocity) - clip.things[0].velocity
    assert np.hypot(*away) / 50 < 0.5


def test_a_picture_that_moves_as_a_whole_has_one_velocity():
    """It leaves nothing at rest but what enters, and is one object."""
    clip = replace(CLIP, things=(Thing((96, 120), (300, 400), (90.0, -210.0), "gravel.png"),))
    motion = found(clip)
    assert motion.objects[0].velocity == pytest.approx((90.0, -210.0), abs=5)
    assert motion.share_at_rest < 0.15


def test_a_patch_that_changes_has_no_velocity():
    """Texture that is another one in each frame moves in no direction, which is said."""
    levels = replace(CLIP, things=()).levels()
    rng = np.random.default_rng(9)
    for frame in levels:
        patch = ndimage.gaussian_filter(rng.normal(size=(90, 100)), 2.5)
        frame[40:130, 60:160] = 900 + 400 * patch / patch.std() * 0.7
    motion = found(replace(CLIP, things=()), levels)
    patch = motion.labels[48:122, 68:152]
    assert np.mean(patch < 0) > 0.8
    assert motion.share_unexplained > 0.1
    assert sum(each.area for each in motion.objects) < 900


def test_splines_shift_as_scipys_do():
    """Rows and columns, in and out of the picture."""
    frames = np.random.default_rng(1).normal(size=(2, 61, 57)).astype(np.float32)
    smoothed = Smoothed.of(frames, np.arange(2.0), 1.2)
    window, move = Window(17, 30, 23, 27), np.array([-3.3, 4.7])
    values, seen = smoothed.along(move, 0, [1], window)
    places = np.meshgrid(np.arange(17, 40) - 3.3, np.arange(30, 57) + 4.7, indexing="ij")
    plain = ndimage.gaussian_filter(frames[1], 1.2, mode="nearest").astype(float)
    expected = ndimage.map_coordinates(plain, places, order=3, mode="mirror")
    np.testing.assert_allclose(values[0][:, :18], expected[:, :18], atol=1e-4)
    assert not seen[0][:, -5:].any()
    assert seen[0][:, :18].all()


def test_the_right_velocity_leaves_noise_alone():
    """A picture that is rolled by whole pixels has the residual 1 along its velocity."""
    rng = np.random.default_rng(2)
    texture = 9 * ndimage.gaussian_filter(rng.normal(size=(96, 128)), 1.5)
    frames = np.stack([np.roll(texture, (4 * k, -8 * k), (0, 1)) for k in range(3)])
    frames = (frames + rng.normal(size=frames.shape)).astype(np.float32)
    sweep, _ = swept(frames, np.arange(3.0), 1)
    near = sweep.near(np.array([4.0, -8.0]), 0.9)
    assert np.nanmedian(sweep.residuals[near].min(axis=0)) < 1.5
    assert np.nanmedian(sweep.residuals[sweep.near(np.array([-6.0, 6.0]), 0.9)]) > 3


@pytest.mark.parametrize("reference", [0, 2])
def test_a_sweep_over_every_other_frame_has_velocities_of_a_frame(reference):
    """Of four that are two apart, each tile has its least residual there, about any of them."""
    rng = np.random.default_rng(2)
    texture = 9 * ndimage.gaussian_filter(rng.normal(size=(96, 144)), 1.5)
    frames = np.stack([np.roll(texture, (4 * k, -8 * k), (0, 1)) for k in range(4)])
    frames = (frames + rng.normal(size=frames.shape)).astype(np.float32)
    sweep, _ = swept(frames, 2 * np.arange(4.0), reference)
    assert sweep.step == pytest.approx(4.8 / 6)
    best = sweep.velocities[np.argmin(sweep.residuals, axis=0)]
    np.testing.assert_allclose(np.median(best, axis=(0, 1)), [2, -4], atol=0.6)


def moving(right, down, count, lost=()):
    """A clip of one object that goes so many px a frame, of which frames were lost."""
    speed = 50.0 * down, 50.0 * right
    clip = ClipOf(
        (Thing((75, 78), (34, 32), speed, "coffee.png"),), (150, 156), "camera.png", count, seed=3
    )
    return found(clip, np.delete(clip.levels(), lost, axis=0))


@pytest.mark.parametrize(("speed", "count"), [(0.4, 8), (0.8, 8), (0.8, 10), (1.3, 9), (0.15, 16)])
def test_slow_objects_are_found(speed, count):
    """Below 1.4 px a frame, in clips of 8 to 10 frames; what goes 2 px in all by far frames."""
    (each,) = moving(-speed, 0.3 * speed, count).objects
    assert each.velocity == pytest.approx((15 * speed, -50 * speed), abs=2.5)


@pytest.mark.parametrize(
    ("one", "other"), [((0.0, 50.0), (0.0, -50.0)), ((25.0, 25.0), (0.0, 60.0))]
)
def test_slow_objects_that_touch_are_two(one, other):
    """Six frames in which two halves of what changes go 1 px a frame each, or half as far."""
    things = (
        Thing((75, 56), (34, 32), one, "coins.png"),
        Thing((75, 116), (34, 32), other, "motorcycle_left.png"),
    )
    objects = found(ClipOf(things, (150, 172), "camera.png", 6, seed=22)).objects
    assert len(objects) == 2
    for velocity in (one, other):
        away = [np.hypot(*(np.array(each.velocity) - velocity)) for each in objects]
        assert min(away) < 3


def test_a_part_that_the_velocity_of_a_larger_one_explains_better_is_of_that():
    """A strip whose own is off by 0.7 px a frame is; one that both explain as well is not."""
    rng = np.random.default_rng(2)
    texture = 9 * ndimage.gaussian_filter(rng.normal(size=(96, 128)), 1.5)
    frames = np.stack([np.roll(texture, (2 * k, -3 * k), (0, 1)) for k in range(5)])
    frames = (frames + rng.normal(size=frames.shape)).astype(np.float32)
    seen = []
    for right, columns in ((-2.3, np.s_[20:34]), (-3.0, np.s_[40:100]), (-3.01, np.s_[104:118])):
        mask = np.zeros((96, 128), bool)
        mask[20:70, columns] = True
        each = MovingObject((2.0, right), (0.05, 0.05), (45.0, 64.0), int(mask.sum()), 5.0, 1.0, 2)
        seen.append((each, mask))
    assert _owners(Smoothed.of(frames, np.arange(5.0), 1.0), 2, seen) == [1, 1, 2]


@pytest.mark.slow
def test_an_object_ends_half_way_up_its_edge():
    """Of a mask that is 42 % too large a tenth too much is left, and nothing of it is lost."""
    random, velocity = np.random.default_rng(3), np.array([1.0, 5.0])
    down, across = np.mgrid[:96, :128]

    def away(time):
        return np.hypot(down - 44 - velocity[0] * time, across - 56 - velocity[1] * time)

    light = np.stack([2 * np.clip(20.5 - away(time), 0, 1) for time in range(-3, 4)])
    fine = Smoothed.of(light + random.normal(size=light.shape), np.arange(7.0), 1.0)
    own = _unlike_rest(fine, 3, velocity, away(0) < 24, range(7))
    assert own.sum() == pytest.approx(np.pi * 20**2, rel=0.1)
    assert np.mean(own[away(0) < 19]) > 0.98


def test_a_background_in_dim_light_is_no_object():
    """The velocity of one part ends within two errors of rest, and rest explains another better."""
    things = (
        Thing((85, 85), (36.4, 55.4), (63.37, 154.92), "moon.png"),
        Thing((170, 165), (45.6, 39.5), (-191.39, -159.33), "camera.png"),
    )
    clip = ClipOf(things, background="coins.png", num_frames=16, electrons=300, seed=35)
    frames, noise = noise_from(
        clip_of(clip.levels(), 50.0, None, float(clip.full)), black=float(clip.black_level)
    )
    unit = noise.law.of_unit_noise(frames.frames)
    smooth = tuple(Smoothed.of(unit, np.arange(16.0), sigma) for sigma in (1.0, 2.0))
    objects = _view(unit, smooth, 2).objects
    assert len(objects) == 2
    assert min(np.hypot(*each.velocity) for each in objects) > 3


@pytest.mark.parametrize("lost", [(4,), pytest.param((2, 3), marks=pytest.mark.slow)])
def test_a_lost_frame_is_seen_and_counted(lost):
    """An object goes two or three times as far there; its velocity is that of other frames."""
    motion = moving(1.2, -0.3, 9 + len(lost), lost)
    (each,) = motion.objects
    assert each.velocity == pytest.approx((-15, 60), abs=2)
    (word,) = motion.words
    assert f"{1 + len(lost)} times as far as usual from frame {lost[0]} to the next" in word
    assert moving(1.2, -0.3, 8).words == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 9])
def test_noise_of_rows_makes_no_object(seed):
    """Among dim points that stand still, of a lead that is too small, or where nothing is told."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:256, :256]
    light = 3 * np.exp(-rows / 40)
    for y, x in rng.uniform(5, 250, (15, 2)):
        light = light + 50 * np.exp(-((rows - y) ** 2 + (columns - x) ** 2) / 2)
    noise = [1.2 * rng.normal(size=(256, 1)) + 4.8 * rng.normal(size=(256, 256)) for _ in range(5)]
    levels = np.rint(500 + light + np.array(noise)).astype(np.uint16)
    frames, noise = noise_from(clip_of(levels, 10.0, None, None))
    assert motion_of(noise.law.of_unit_noise(frames.frames), 10.0).objects == ()
