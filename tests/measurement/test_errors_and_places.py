"""Errors by their size, and places by the frame and the axis that they are in."""

import numpy as np
import pytest
from scipy import ndimage
from support.clips import ClipOf, Thing

from mishutter.measurement import motion as motion_module
from mishutter.measurement.clip import Clip, clip_of
from mishutter.measurement.estimates import Estimate
from mishutter.measurement.measurement import _level_difference
from mishutter.measurement.motion import Motion, MovingObject, motion_of
from mishutter.measurement.noise import _root
from mishutter.measurement.photon_transfer import Law, Transfer, blocks_of, pairs_of, transfer_of
from mishutter.measurement.scene import along_axis
from mishutter.measurement.signs import detail_excess, shot_gamma
from mishutter.measurement.steady import Steady, moves_of
from mishutter.measurement.texture import averaged
from mishutter.pictures.registration.sweep import Region, Smoothed, swept


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


def test_noise_leaves_a_residual_of_one_however_many_frames_see_it():
    """Along every velocity, also those that leave the sensor within five frames."""
    frames = np.random.default_rng(8).normal(size=(5, 112, 144)).astype(np.float32)
    residuals = swept(frames, np.arange(5.0), 1)[0].residuals
    assert np.mean(residuals) == pytest.approx(1, abs=0.02)
    np.testing.assert_allclose(np.mean(residuals, axis=(1, 2)), 1, atol=0.1)


@pytest.mark.parametrize("step", [1.0, 16.0])
def test_a_gamma_is_told_without_the_noise_of_steps(step):
    """Of light whose noise is 0.2 steps^2 where it is bright, be levels 1 or 16 apart."""
    light = np.linspace(0.02, 1, 72) * np.ones((16, 64, 1))
    electrons = np.random.default_rng(3).poisson(60_000 * light)
    frames = (step * np.rint(255 * (electrons / 60_000) ** (1 / 1.5))).astype(np.float32)
    blocks = blocks_of(Steady.of(frames), pairs_of(16), (-np.inf, np.inf))
    gain, dark = np.polyfit(blocks.mean, blocks.variance, 1)
    transfer = Transfer(
        Law(float(dark), float(gain), 1e-3),
        blocks,
        blocks,
        1.0,
        np.zeros((2, 2)),
        Estimate(0.0, 1.0),
        np.ones(blocks.shape, bool),
    )
    assert shot_gamma(transfer, step) == pytest.approx(1.5, abs=0.03)


@pytest.mark.parametrize(("squares", "is_told"), [(15.8, True), (16.2, False)])
def test_a_gamma_may_fit_worse_than_a_line_by_four_errors(monkeypatch, squares, is_told):
    """Of six levels whose variance is on a line: by the sum of the squares of its deviations."""
    level = np.linspace(150.0, 1000.0, 6)
    variance = 40 + 0.1 * level
    gammas, sums = np.arange(0.3, 3.51, 0.05), []
    for gamma in gammas:
        sums += [*np.linalg.lstsq(level[:, None] ** (2 - gamma), variance, rcond=None)[1]]
    error = np.full(6, np.sqrt(min(sums) / squares))
    curve = np.stack([level, variance, error, np.full(6, 9.0)])
    monkeypatch.setattr(Transfer, "curve", lambda _: curve)
    transfer = object.__new__(Transfer)
    object.__setattr__(transfer, "law", Law(40.0, 0.1, 1e-3))
    told = shot_gamma(transfer, 0.0)
    assert told == (pytest.approx(gammas[np.argmin(sums)]) if is_told else None)


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
    assert motion.width[0] / motion.width[1] == pytest.approx(52 / 44, abs=0.12)


def test_errors_of_the_curve_and_the_gain_are_their_scatter():
    """Of 30 clips of a ramp, 64 levels of black, one a photo-electron and a read noise of 4."""
    random, light = np.random.default_rng(3), np.linspace(100, 2000, 96) * np.ones((80, 1))
    gains, errors, apart = [], [], []
    for _ in range(30):
        frames = 64 + random.poisson(light, (5, 80, 96)) + 4 * random.normal(size=(5, 80, 96))
        steady = Steady.of(frames.astype(np.float32))
        found = transfer_of(blocks_of(steady, pairs_of(5), (-np.inf, np.inf)), None, 0.0)
        level, variance, error, _ = found.curve()
        apart.append((variance - (16 + level - 64)) / error)
        gains.append(found.law.gain)
        errors.append(found.lines[:, 1].std())
    assert np.std(apart) == pytest.approx(1, abs=0.1)
    assert np.mean(gains) == pytest.approx(1, abs=0.01)
    assert np.mean(errors) == pytest.approx(np.std(gains), rel=0.2)


def test_the_error_of_a_velocity_in_dim_light_is_its_scatter():
    """Down and to the left over three frames, beside the noise of each."""
    random = np.random.default_rng(3)
    light = ndimage.gaussian_filter(random.normal(size=(120, 130)), 1.5)
    mask, velocity = np.zeros((64, 72), bool), np.array([1.0, -2.0])
    mask[16:48, 16:56] = True
    velocities, squares = [], []
    for _ in range(40):
        moved = [light[20 - k : 84 - k, 20 + 2 * k : 92 + 2 * k] for k in (-1, 0, 1)]
        frames = 2 * np.stack(moved) / light.std() + random.normal(size=(3, 64, 72))
        region = Region(
            Smoothed.of(frames, np.arange(len(frames), dtype=float), 1.0), 1, range(3), mask
        )
        found, covariance, _ = region.polished(velocity + np.array([0.02, -0.03]))
        velocities.append(found)
        squares.append(np.diag(covariance))
    np.testing.assert_allclose(np.mean(velocities, axis=0), velocity, atol=0.015)
    scatter = np.std(velocities, axis=0)
    np.testing.assert_allclose(np.sqrt(np.mean(squares, axis=0)), scatter, rtol=0.25)


def test_runs_begin_at_the_border_too():
    """Four along rows and seven down the columns, of nine pixels in two pictures."""
    of_both = [[1, 1, 0, 1], [0, 1, 1, 1]], [[1, 1, 1, 0], [0, 0, 0, 0]]
    masks = [np.array(pixels, bool) for pixels in of_both]
    assert motion_module._run(masks, 1) == pytest.approx(9 / 4)
    assert motion_module._run(masks, 0) == pytest.approx(9 / 7)
    assert motion_module._run([np.zeros((2, 3), bool)], 1) == 0


def test_the_error_of_a_shake_is_what_noise_makes_of_one():
    """And a frame that is displaced stands beside the mean of all, down before across."""
    random = np.random.default_rng(3)
    light = 80 * ndimage.gaussian_filter(random.normal(size=(96, 110)), 1.5)
    sizes, errors = [], []
    for _ in range(20):
        moves, error, _ = moves_of((light + random.normal(size=(6, 96, 110))).astype(np.float32))
        sizes.append(np.mean(np.sum(moves**2, axis=1)))
        errors.append(error)
    assert np.mean(errors) == pytest.approx(np.sqrt(np.mean(sizes)), rel=0.2)
    frames = np.array([light] * 6, np.float32)
    frames[4] = ndimage.shift(light, (0.2, -0.1), order=3, mode="nearest")
    apart = moves_of(frames)[0]
    np.testing.assert_allclose(apart[4] - apart[0], [0.2, -0.1], atol=0.02)


def test_the_noise_of_a_shake_that_was_taken_out_has_an_error():
    """Frames that are apart along both axes keep so much of their noise as a sinc of each lets."""
    frames = np.zeros((5, 8, 8))
    moves = np.array([[0.0, 0.0], [0.25, 0.5], [0.0, 0.0], [0.25, 0.5], [0.0, 0.0]])
    assert Steady.of(frames).error == 0
    steady = Steady.of(frames)._replace(moves=moves)
    assert steady.error == pytest.approx((1 - np.sinc(0.25) * np.sinc(0.5)) / 5)


def test_the_error_of_a_level_difference_is_its_scatter():
    """Of light that differs from square to square of 32 px, and is a tenth brighter to the left."""
    random, labels = np.random.default_rng(3), np.zeros((256, 320), int)
    labels[:, :96] = 1
    motion = Motion((), labels, labels / 1.0, 0, 0.5, 0.0, (1.0, 1.0), 2)
    found = []
    for _ in range(60):
        squares = 0.3 + 0.1 * random.normal(size=(8, 10)).repeat(32, axis=0).repeat(32, axis=1)
        found.append(_level_difference(squares + 0.1 * labels, motion))
    values, errors = np.transpose(found)
    assert np.mean(values) == pytest.approx(0.1, abs=0.01)
    assert np.mean(errors) == pytest.approx(np.std(values), rel=0.2)
