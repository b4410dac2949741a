"""Parts of a measurement against sums that are written out, and exchanges of rows and columns."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from mishutter.measurement.clip import Clip
from mishutter.measurement.estimates import Estimate, Refusal
from mishutter.measurement.motion import (
    Motion,
    MovingObject,
    _is_same,
    _lead,
    _leap,
    _object,
    _track,
    _unlike_rest,
    read_in_turn,
)
from mishutter.measurement.noise import _black_of, _gain_of, _of_one_dark, _others, _read_of
from mishutter.measurement.photon_transfer import (
    Blocks,
    Law,
    Transfer,
    _dead,
    _first_law,
    _Sums,
    blocks_of,
    pairs_of,
    rough_law,
    transfer_of,
)
from mishutter.measurement.scene import _narrowest, _quantile, _reason, along_axis
from mishutter.measurement.signs import _correlates, signs_of, too_narrow
from mishutter.measurement.signs import _leap as _leap_of_variance
from mishutter.measurement.steady import (
    Steady,
    _of_one_exposure,
    _robust_line,
    bands_of_light,
    moves_of,
)
from mishutter.measurement.texture import averaged, is_mosaic
from mishutter.pictures.registration.sweep import Region, Smoothed, Sweep
from mishutter.pictures.registration.windows import means

ENDS = -np.inf, np.inf


def an_object(down, right, area=4000, error=(9.0, 2.0), **others):
    given = {"centre": (50.0, 60.0), "lead": 9.0, "residual": 1.1, "frame": 2} | others
    return MovingObject(velocity=(float(down), float(right)), error=error, area=area, **given)


def test_blocks_are_sums_over_their_pixels():
    """Of pairs of frames of unlike exposures, of which a pixel is cut off and a row is stuck."""
    random = np.random.default_rng(3)
    levels = random.uniform(100, 900, (5, 45, 67)).astype(np.float32)
    levels[:, 17] = 400
    levels[1, 30, 9] = 950
    gains, offset = np.array([1.0, 0.6, 1.3, 0.8, 1.1]), 20.0
    same = ((levels - offset) / gains[:, None, None]).astype(np.float32)
    pairs = [(0, 1), (2, 4)]
    found = blocks_of(Steady(levels, same, gains), pairs, (-np.inf, 950.0))
    assert found.shape == (2, 5, 8)
    for number, (pair, row, column) in enumerate(np.ndindex(2, 5, 8)):
        i, j = pairs[pair]
        part = np.s_[8 * row : 8 * row + 8, 8 * column : 8 * column + 8]
        w, v = 1 / gains[i] ** 2, 1 / gains[j] ** 2
        middle = (w * levels[i][part] + v * levels[j][part]) / (w + v)
        change = (same[j][part] - same[i][part]) / np.sqrt((w + v) / 2)
        quarters = [change[a : a + 4, b : b + 4] for a in (0, 4) for b in (0, 4)]
        assert found.mean[number] == pytest.approx(middle.mean(), rel=1e-5)
        variance = np.mean([each.var(ddof=1) for each in quarters]) / 2
        assert found.variance[number] == pytest.approx(variance, rel=1e-4)
        squares = np.sum([each.mean() ** 2 for each in quarters])
        assert found.parts[number] == pytest.approx(squares, rel=1e-3)
        assert found.texture[number] == pytest.approx(middle.var(), rel=1e-3)
        is_cut = (pair, row, column) == (0, 3, 1)
        assert found.is_whole[number] == (row != 2 and not is_cut)
        assert found.cluster[number] == (row // 4) * 2 + column // 4
    both = found + found.where(found.is_whole)
    assert both.cluster.max() == 2 * 4 - 1
    assert both.cluster[: found.mean.size].max() == 3


def test_a_frame_of_another_exposure_lies_on_the_line_of_all():
    """One of half the light, divided by it, has the noise of the level that it was."""
    random, light = np.random.default_rng(3), np.linspace(60, 1900, 160) * np.ones((320, 1))
    gains = np.array([1.0, 0.5])
    levels = (
        64 + random.poisson(gains[:, None, None] * light) + 4 * random.normal(size=(2, 320, 160))
    )
    same = (levels - 64) / gains[:, None, None] + 64
    steady = Steady(levels.astype(np.float32), same.astype(np.float32), gains)
    found = blocks_of(steady, [(0, 1)], ENDS)
    law = 16 + found.mean - 64
    assert np.mean(found.variance / law) == pytest.approx(1, abs=0.015)
    slope = np.polyfit(found.mean, found.variance, 1, w=1 / law)[0]
    assert slope == pytest.approx(1, abs=0.03)


def test_what_is_stuck_is_left_out():
    """A row, a column and a block; of three frames no block, as noise may leave pixels alone."""
    frames = np.random.default_rng(3).normal(size=(4, 41, 52))
    frames[:, 5], frames[:, :, 33] = 1, 2
    frames[:, 16:24, 8:16] = 3
    wanted = np.zeros((41, 52), bool)
    wanted[5], wanted[:, 33] = True, True
    np.testing.assert_array_equal(_dead(frames[:3]), wanted)
    wanted[16:24, 8:16] = True
    np.testing.assert_array_equal(_dead(frames), wanted)


def some_blocks(count=900, seed=3, gain=0.7, dark=30.0):
    """Blocks on a line, of noise of its size, in clusters of ten."""
    random = np.random.default_rng(seed)
    mean = random.uniform(50, 2000, count)
    variance = (dark + gain * mean) * (1 + 0.1 * random.normal(size=count))
    zeros = np.zeros(count)
    cluster = np.arange(count) // 10
    return Blocks(mean, variance, zeros, zeros, np.ones(count, bool), cluster, (1, 1, count))


def test_lines_and_curvatures_are_those_of_least_squares():
    """Weighted by a law; resampled clusters count as often as they are drawn."""
    blocks, law = some_blocks(), Law(25.0, 0.6, 1e-9)
    sums, weight = _Sums.of(blocks, law), 1 / law(blocks.mean)
    gain, dark = np.polyfit(blocks.mean, blocks.variance, 1, w=weight)
    assert sums.lines()[0] == pytest.approx((dark, gain), rel=1e-8)
    low, high = blocks.mean.min(), blocks.mean.max()
    x = (2 * blocks.mean - low - high) / (high - low)
    square = np.polyfit(x, blocks.variance, 2, w=weight)[0]
    assert sums.curvatures()[0] == pytest.approx(square, rel=1e-8)
    times = np.random.default_rng(4).integers(0, 3, (2, 90))
    for row, line, curve in zip(times, sums.lines(times), sums.curvatures(times), strict=True):
        often = row[blocks.cluster]
        own = np.sqrt(often) * weight
        gain, dark = np.polyfit(blocks.mean, blocks.variance, 1, w=own)
        assert line == pytest.approx((dark, gain), rel=1e-8)
        square = np.polyfit(x, blocks.variance, 2, w=own)[0]
        assert curve == pytest.approx(square, rel=1e-8)


@pytest.mark.parametrize(
    "law", [Law(16.0, 1.4, 1e-9), Law(90.0, 0.0, 1e-9), Law(900.0, -0.3, 1e-9)]
)
def test_noise_that_is_made_even_is_one(law):
    """At every level, whether its variance rises, stays or falls."""
    random, light = np.random.default_rng(3), np.linspace(100, 2000, 50) * np.ones((8, 900, 1))
    frames = light + np.sqrt(law(light)) * random.normal(size=light.shape)
    even = law.of_unit_noise(frames)
    np.testing.assert_allclose(even.std(axis=(0, 1)), 1, rtol=0.05)


def test_noise_alone_seems_to_move_in_few_blocks():
    """One of a thousand; what moves in one strongly, or in nine a little, is seen."""
    random = np.random.default_rng(3)
    light = np.linspace(100, 2000, 320) * np.ones((480, 1))
    frames = random.poisson(np.stack([light] * 2)).astype(float)
    blocks = blocks_of(Steady.of(frames.astype(np.float32)), [(0, 1)], ENDS)
    law = Law(0.0, 1.0, 1e-9)
    assert 0.0005 < np.mean(blocks.moves(law)) < 0.008
    frames[1, 80:88, 160:168] += (
        25 * (-1.0) ** np.arange(8)[:, None] * np.sqrt(light[:8, 160:168] / 100)
    )
    frames[1, 200:204, 120:124] += 2 * np.sqrt(light[:4, 120:124])
    frames[1, 320:344, 40:64] += 0.8 * np.sqrt(light[:24, 40:64]) * random.normal(size=(24, 24))
    moved = blocks_of(Steady.of(frames.astype(np.float32)), [(0, 1)], ENDS)
    seen = moved.moves(law).reshape(60, 40)
    assert seen[9:12, 19:22].all()
    assert seen[24:27, 14:17].all()
    assert seen[41, 6]
    assert np.mean(seen) < 0.03


def test_the_error_of_the_read_noise_is_its_scatter():
    """At a known black, beside that of the gain and the 3 % of clips of known truth."""
    random, light = np.random.default_rng(3), np.linspace(5, 400, 96) * np.ones((80, 1))
    values, errors = [], []
    for _ in range(30):
        frames = 64 + random.poisson(light, (5, 80, 96)) + 4 * random.normal(size=(5, 80, 96))
        steady = Steady.of(frames.astype(np.float32))
        clip = Clip(steady.levels, 50.0, None, 4095.0, 0.0, ENDS)
        found = transfer_of(blocks_of(steady, pairs_of(5), ENDS), None, 0.0)
        read, ends, _, refusals = _read_of(clip, found, (64.0, 64.0), Estimate(64.0, 0.0), None)
        assert (ends, refusals) == (None, [])
        gain = _gain_of(found)
        assert gain.error == pytest.approx(np.hypot(found.lines[:, 1].std(), 0.012 * gain.value))
        values.append(read.value)
        share = np.hypot(gain.error / gain.value, 0.03)
        errors.append(np.sqrt(read.error**2 - (share * read.value) ** 2))
    assert np.mean(values) == pytest.approx(4, abs=0.1)
    assert np.mean(errors) == pytest.approx(np.std(values), rel=0.3)


def test_flat_fields_near_saturation_are_left_out():
    """Pairs of both frames below 0.7 of white, one after the other, beside pairs of dark frames."""
    random = np.random.default_rng(3)
    clip = Clip(np.zeros((2, 48, 56), np.float32), 50.0, None, 1000.0, 1.0, ENDS)
    levels = np.repeat([300, 650, 760], 2)[:, None, None]
    flats = (levels + random.normal(size=(6, 48, 56))).astype(np.float32)
    dark = (20 + random.normal(size=(3, 48, 56))).astype(np.float32)
    alone = _others(clip, None, flats)
    assert sorted({round(float(x), -1) for x in alone.mean}) == [300, 650]
    both = _others(clip, dark, flats)
    assert both.mean.size == 4 * 42  # two pairs of each
    assert len(set(both.cluster.tolist())) == 2 * 4
    assert _others(clip, dark[:1], None) is None


def test_a_weighted_quantile_is_that_of_things_as_often():
    """The least value that so great a share of all does not exceed."""
    random = np.random.default_rng(3)
    values, weights = random.normal(size=17), random.integers(1, 40, 17)
    alike = np.sort(np.repeat(values, weights))
    for share in (0.02, 0.31, 0.5, 0.98, 1.0):
        wanted = alike[int(np.ceil(share * alike.size)) - 1]
        assert _quantile(values, weights.astype(float), share) == wanted


@pytest.mark.parametrize("sign", [1, -1])
def test_the_axis_of_columns_is_that_of_rows_exchanged(sign):
    """Speeds, their error, the share across and the turn, of things of unlike areas and errors."""
    things = [
        an_object(-60, 310, 5000, (3.0, 1.5)),
        an_object(-20, 190, 900, (5.0, 0.7)),
        an_object(-45, 260, 2500, (8.0, 2.5)),
    ]
    things = [replace(x, velocity=(sign * x.velocity[0], sign * x.velocity[1])) for x in things]
    turned = [replace(x, velocity=x.velocity[::-1], error=x.error[::-1]) for x in things]
    rows, columns = along_axis(things), along_axis(turned)
    assert (rows.axis, columns.axis) == ("rows", "columns")
    assert rows.speeds == columns.speeds == ((190, 310) if sign < 0 else (-310, -190))
    assert rows.error == columns.error == 1.5
    assert rows.across == columns.across == pytest.approx(60 / 310)
    assert rows.fastest == columns.fastest == pytest.approx(np.hypot(60, 310))
    assert columns.across_turned == pytest.approx(rows.across_turned)
    assert columns.turn == pytest.approx(-rows.turn)
    area, velocities = (
        np.array([getattr(x, name) for x in things]) for name in ("area", "velocity")
    )
    angle = np.radians(rows.turn)
    spin = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    down, right = spin @ velocities.T
    assert np.sum(area * down * right) == pytest.approx(0, abs=1e-6 * np.sum(area * right**2))
    share = np.max(np.abs(down)) / np.max(np.abs(right))
    assert rows.across_turned == pytest.approx(share)
    assert "anticlockwise" in rows.sentences[1]
    assert " clockwise" in columns.sentences[1]


def test_the_rarer_way_counts_from_a_twentieth_of_the_area():
    """Below that it has its own speed, as long as it is no less than a fiftieth."""
    for area, speeds in ((600, (-300, 300)), (400, (-250, 300)), (150, (200, 300))):
        things = [an_object(0, -300, 5000), an_object(0, -200, 4600), an_object(0, 250, area)]
        assert along_axis(things).speeds == speeds


def test_heights_of_rows_in_turn_are_weighed_by_areas():
    """Of a large thing that goes down and a small one that goes up."""
    row, labels = 4e-5, np.zeros((4, 4))
    things = (an_object(900.0, 100.0, 6000), an_object(-700.0, 50.0, 1500))
    motion = Motion(things, labels.astype(int), labels, 3, 0.5, 0.0, (40.0, 60.0), 8)
    found = read_in_turn(motion, row)
    own = [each.velocity[0] / (1 + each.velocity[0] * row) for each in things]
    assert [each.velocity[0] for each in found.objects] == pytest.approx(own)
    shares = [1 - velocity * row for velocity in own]
    assert found.width == pytest.approx((40.0, 60 * (6000 * shares[0] + 1500 * shares[1]) / 7500))
    assert read_in_turn(replace(motion, objects=()), row).width == (40.0, 60.0)


def test_two_appearances_are_one_thing_where_its_way_joins_them():
    """Three frames later, a size aside at most, and along both axes."""
    one = an_object(3.0, -7.0, 900, centre=(50.0, 60.0), frame=2)
    for way, same in (((9.0, -21.0), True), ((9.0, 21.0), False), ((39.5, -21.0), False)):
        centre = one.centre[0] + way[0], one.centre[1] + way[1]
        assert _is_same(one, replace(one, centre=centre, frame=5)) == same
        back = one.centre[0] - way[0], one.centre[1] - way[1]
        assert _is_same(one, replace(one, centre=back, frame=-1)) == same
    assert not _is_same(one, one)
    later = replace(one, centre=(59.0, 39.0), frame=5)
    assert not _is_same(one, replace(later, velocity=(3.0, -7.6)))
    assert _is_same(one, replace(later, velocity=(3.0, -7.4)))


def test_a_leap_is_so_many_usual_steps():
    """Along the velocity; neither half a step, nor one that the others scatter by."""
    velocity = np.array([1.0, -3.0])
    for several, found in ((3.0, (13, 3)), (2.0, (13, 2)), (1.0, None), (2.5, None)):
        steps = np.ones(7)
        steps[2] = several
        places = np.cumsum(np.r_[0, steps])[:, None] * velocity
        assert _leap(np.arange(11, 19), places, velocity) == found
    uneven = np.cumsum([0, 0.4, 1.7, 2.0, 0.3, 1.5, 0.2])[:, None] * velocity
    assert _leap(np.arange(7), uneven, velocity) is None
    assert _leap(np.arange(3), np.array([0, 1, 3])[:, None] * velocity, velocity) is None


def test_a_thing_is_tracked_over_a_frame_that_was_lost():
    """Its way is so many px from the reference, before and after it, as far as it is seen."""
    random = np.random.default_rng(2)
    texture = 9 * ndimage.gaussian_filter(random.normal(size=(96, 128)), 1.2)
    numbers = [0, 1, 2, 3, 5, 6, 7]
    frames = np.stack([np.roll(texture, (2 * k, -3 * k), (0, 1)) for k in numbers])
    frames[6] = np.roll(frames[6], 40, 0)  # nothing of it is seen any more
    frames = (frames + random.normal(size=frames.shape)).astype(np.float32)
    mask = np.zeros((96, 128), bool)
    mask[40:62, 50:84] = True
    fine = Smoothed.of(frames, np.arange(7.0), 1.0)
    times, places = _track(fine, 2, np.array([2.0, -3.0]), mask)
    assert times.tolist() == [0, 1, 2, 3, 4, 5]
    wanted = (np.array(numbers[:6]) - 2)[:, None] * np.array([2, -3])
    np.testing.assert_allclose(places, wanted, atol=0.1)
    assert _leap(times, places, np.array([2.0, -3.0])) == (3, 2)


def test_two_errors_of_a_velocity_add_up_by_their_squares(monkeypatch):
    """That of the noise, and the floor over the frames that it was refined by."""
    velocity, spread = np.array([1.0, -2.0]), np.diag([0.03**2, 0.004**2])
    monkeypatch.setattr(Region, "polished", lambda _, velocity: (velocity, spread, 1.0))
    monkeypatch.setattr(Region, "descended", lambda _, velocity, *steps: velocity)
    fine = Smoothed.of(np.zeros((9, 60, 70), np.float32), np.arange(9.0), 1.0)
    mask = np.zeros((60, 70), bool)
    mask[20:50, 10:45] = True
    sweep = Sweep(np.zeros((1, 2)), np.ones((1, 3, 4)), 1.0, 16, 0.1)
    each, _ = _object(fine, 2, velocity, mask, [sweep])
    assert each.error == pytest.approx((np.hypot(0.03, 0.05 / 6), np.hypot(0.004, 0.05 / 6)))
    assert (each.centre, each.area, each.frame) == ((34.5, 27.0), 30 * 35, 2)


def test_a_lead_is_that_of_the_tiles_about_the_middle():
    """A tenth of the logarithm of the likelihood; the thing is farther to the right than down."""
    velocities = np.array([(0.0, 0.0), (4.0, 0.0), (8.0, 0.0)])
    residuals = np.full((3, 5, 9), 20.0)
    residuals[1, 1, 6] = 2.0
    sweep = Sweep(velocities, residuals, 1.0, 48, 0.1)
    mask = np.zeros((150, 250), bool)
    mask[36:60, 156:180] = True
    gap = np.log(20 / 2.0)
    assert _lead(sweep, np.array([4.0, 0.0]), mask) == pytest.approx(0.1 * gap * 144 * 3 / 2)
    assert _lead(sweep, np.array([4.0, 0.0]), np.roll(mask, 96, 0)) == 0
    assert _lead(sweep, np.array([2.0, 0.0]), mask) == 0
    few = Sweep(velocities[:2] / 4, residuals[:2], 1.0, 48, 0.1)
    assert _lead(few, np.array([0.5, 0.0]), mask) == 0  # no velocity is farther away


def test_a_line_is_that_of_most_points():
    """Be a fifth of them elsewhere; its slope has the error of least squares."""
    random = np.random.default_rng(3)
    found = []
    for _ in range(60):
        x = random.uniform(0, 500, 400)
        y = 12 + 0.8 * x + 2 * random.normal(size=400)
        _, slope, error = _robust_line(x, y)
        y[:80] += random.uniform(30, 300, 80)
        found.append((slope, error, *_robust_line(x, y)[:2]))
    slopes, errors, *lines = np.transpose(found)
    assert np.mean(lines, axis=1) == pytest.approx((12, 0.8), rel=0.02)
    assert np.mean(errors) == pytest.approx(np.std(slopes), rel=0.25)


def test_an_exposure_that_drifts_has_its_gains():
    """Each frame over the usual one, with black where it is, and the scatter of all."""
    random = np.random.default_rng(3)
    light = 900 + 500 * ndimage.gaussian_filter(random.normal(size=(96, 120)), 3) * 6
    gains = np.array([1.0, 0.9, 1.05, 0.97, 1.1])
    frames = 64 + random.poisson(gains[:, None, None] * light)
    found = _of_one_exposure(frames.astype(np.float32), 1.0)
    np.testing.assert_allclose(found.gains, gains, rtol=0.02)
    assert found.drift == pytest.approx(np.std(gains), rel=0.1)
    apart = found.same - found.same[0]
    assert np.max(np.abs(apart.mean(axis=(1, 2)))) < 3
    assert _of_one_exposure(np.float32(64 + random.poisson([light] * 5)), 1.0).drift == 0


def test_the_error_of_a_focus_is_what_noise_makes_of_one():
    """Six frames of one focus differ by 2.5 deviations; blur that grows is found by its square."""
    random = np.random.default_rng(3)
    light = 80 * ndimage.gaussian_filter(random.normal(size=(96, 110)), 1.5)
    values, errors = [], []
    for _ in range(20):
        _, _, (value, error) = moves_of(
            (light + random.normal(size=(6, 96, 110))).astype(np.float32)
        )
        values.append(value)
        errors.append(error / np.sqrt(2))
    assert np.mean(values) == pytest.approx(2.53 * np.mean(errors), rel=0.25)
    frames = np.array([light] * 6, np.float32)
    for axis in (0, 1):
        frames[5] = ndimage.convolve1d(frames[5], [0.045, 0.91, 0.045], axis)
    assert moves_of(frames)[2][0] == pytest.approx(0.09, rel=0.2)


@pytest.mark.parametrize(("first", "fewest"), [(30, 5), (2, 4)])
def test_a_thing_is_averaged_along_its_way(first, fewest):
    """Over two frames to either side, and what rests over all; each noise by the root of these."""
    random = np.random.default_rng(3)
    ground, detail = (300 * ndimage.gaussian_filter(random.normal(size=(70, 90)), 2) for _ in "ab")
    frames, truth, labels = [], None, np.zeros((70, 90), int)
    labels[20:44, first : first + 32] = 1
    for k in range(9):
        picture = ground.copy()
        way = 2 * (k - 4), -3 * (k - 4)
        moved = np.roll(labels == 1, way, (0, 1))
        picture[moved] = 200 + np.roll(detail, way, (0, 1))[moved]
        truth = picture if k == 4 else truth
        frames.append(picture + random.normal(size=picture.shape))
    frames = np.array(frames, np.float32)
    thing = an_object(100.0, -150.0)
    motion = Motion((thing,), labels, labels / 1.0, 4, 0.9, 0.0, (32.0, 24.0), 9)
    found = averaged(frames, frames, motion, 50.0)
    inner = ndimage.binary_erosion(labels == 1, iterations=4)
    assert found.num_frames[inner].min() == fewest  # it leaves the picture on the left
    assert found.num_frames[inner].max() == 5
    for part in (inner, ~ndimage.binary_dilation(labels == 1, iterations=8)):
        apart = (found.levels - truth)[part] * np.sqrt(found.num_frames[part])
        assert np.var(apart) == pytest.approx(1, rel=0.2)
        assert np.mean(apart) == pytest.approx(0, abs=0.1)
    far = np.s_[58:]
    assert np.mean(found.num_frames[far]) == pytest.approx(9, abs=0.8)
    assert np.var((found.levels - truth)[far]) == pytest.approx(1 / 9, rel=0.3)


def test_stripes_along_one_axis_are_no_mosaic():
    """Rows that differ one from the next are a sensor's; filters alternate both ways."""
    random = np.random.default_rng(3)
    light = 500 + 90 * ndimage.gaussian_filter(random.normal(size=(96, 130)), 1.5)
    stripes = 30 * (np.arange(96) % 2)[:, None] * np.ones(130)
    assert not is_mosaic(light)
    assert not is_mosaic(light + stripes)
    assert not is_mosaic((light + stripes).T)
    assert is_mosaic(light + stripes + 30 * (np.arange(130) % 2))


def test_a_steep_ramp_hides_no_mosaic():
    """Ends of lines that do not meet have power at all frequencies, but for the window."""
    random = np.random.default_rng(5)
    down, across = np.mgrid[:97, :131]
    light = 4000.0 * across / 131 + 2500.0 * down / 97 + 4 * random.normal(size=(97, 131))
    assert not is_mosaic(light)
    assert is_mosaic(light + 8 * (across % 2) + 8 * (down % 2))


def test_one_dark_frame_is_taken_where_it_tells_more():
    """With a tenth of its noise for what may be fixed, less that of rounding, in electrons."""
    random = np.random.default_rng(3)
    dark = np.rint(64 + 6 * random.normal(size=(300, 320)))
    gain = Estimate(2.0, 0.06)
    found, source = _of_one_dark(dark, Estimate(3.4, 0.9), 1.0, gain)
    assert found.value == pytest.approx(3, abs=0.03)
    assert found.error == pytest.approx(found.value * np.hypot(0.1, 0.03))
    assert "one dark frame" in source
    clip = Estimate(3.1, 0.2)
    assert _of_one_dark(dark, clip, 1.0, gain) == (clip, "")


def test_levels_tell_a_slope_from_twice_the_darkest_on():
    """Above black; dark frames or flat fields tell it of any levels."""
    for low, high, black, is_narrow in (
        (100, 190, None, True),
        (100, 230, None, False),
        (150, 230, 100.0, False),
        (150, 190, 100.0, True),
    ):
        blocks = replace(some_blocks(), mean=np.linspace(low, high, 900))
        rest = np.ones((1, 1, 900), bool)
        transfer = Transfer(
            Law(1.0, 1.0, 0.1), blocks, blocks, 1.0, np.zeros((2, 2)), Estimate(0.0, 1.0), rest
        )
        assert (too_narrow(transfer, black, has_others=False) is not None) == is_narrow
        assert too_narrow(transfer, black, has_others=True) is None


def test_levels_in_another_unit_are_of_the_same_law():
    """One step of the file is 16 of another's: the slope is 16 times as steep, all else 256."""
    blocks = some_blocks()
    coarse = replace(
        blocks, **{name: 256 * getattr(blocks, name) for name in ("variance", "parts", "texture")}
    )
    coarse = replace(coarse, mean=16 * blocks.mean)
    for found in (lambda clip, step: transfer_of(clip, None, step).law, rough_law):
        own, other = found(blocks, 0.5), found(coarse, 8.0)
        wanted = 256 * own.dark, 16 * own.gain, 256 * own.floor
        assert (other.dark, other.gain, other.floor) == pytest.approx(wanted, rel=1e-6)


def test_a_variance_leaps_where_it_does():
    """At the bin that both parts share, to a line that goes on as steeply above it."""
    level = np.linspace(100, 1600, 16)
    variance = 20 + 0.5 * level + 90 * (level > 720)
    misfit, place = _leap_of_variance(level, variance, np.full(16, 3.0))
    assert misfit == pytest.approx(0, abs=1e-9)
    assert place in (700.0, 800.0)
    falls = _leap_of_variance(level, variance - 200 * (level > 720), np.full(16, 3.0))
    assert falls[0] > 1000


def test_a_law_of_one_level_has_no_slope():
    """The mean of what the quietest blocks have; and a falling one is none of noise."""
    flat = replace(some_blocks(), mean=np.full(900, 500.0), variance=np.full(900, 31.0))
    assert _first_law(flat, 0.1) == Law(31.0, 0.0, 0.1)
    assert _first_law(flat.where(np.arange(900) < 59), 0.1) is None
    assert _first_law(flat.where(np.arange(900) < 60), 0.1) is not None
    own = some_blocks(count=3600)
    found = _first_law(own, 0.1)
    least = 1 - 0.6745 * 0.1
    assert found.gain == pytest.approx(0.7 * least, rel=0.1)
    assert found(1000.0) == pytest.approx(730 * least, rel=0.05)
    falling = replace(own, variance=900 - 0.4 * own.mean)
    law = rough_law(falling, 0.0)
    assert (law.dark, law.gain) == (pytest.approx(np.quantile(falling.variance, 0.25)), 0.0)


def test_dark_frames_below_the_steps_tell_black_to_a_third_of_one():
    """Rounding alone decides their level; what is told beside them stands."""
    clip = Clip(np.zeros((2, 48, 56), np.float32), 50.0, None, 255.0, 4.0, ENDS)
    random = np.random.default_rng(3)
    fine = 4 * np.rint((66 + 0.4 * random.normal(size=(2, 48, 56))) / 4)
    known, _, dark, _ = _black_of(clip, fine.astype(np.float32), None)
    assert known.error == pytest.approx(4 / 3, rel=0.05)
    told, source, dark, _ = _black_of(clip, fine.astype(np.float32), 63.0)
    assert (told, source) == (Estimate(63.0, 0.0), "as given")
    assert dark is not None


def test_what_is_left_out_of_means_is_the_end():
    """Rows and columns that fill no square, of pictures of any sides."""
    picture = np.arange(35.0).reshape(5, 7)
    np.testing.assert_allclose(means(picture, 2), [[4, 6, 8], [18, 20, 22]])


def test_bands_need_four_frames_and_four_blocks_of_rows():
    """And are as deep as the root of what neighbours share, not as row noise is."""
    random, rows = np.random.default_rng(3), np.arange(240)
    phase = 2 * np.pi * (rows / 60 + np.arange(8)[:, None] * 0.37)
    light = 900 * (1 + 0.02 * np.sqrt(2) * np.cos(phase))[:, :, None] * np.ones(120)
    frames = light + 5 * random.normal(size=light.shape)
    wanted = 0.02 * np.sqrt(np.cos(2 * np.pi * 8 / 60))
    assert bands_of_light(frames) == pytest.approx(wanted, rel=0.15)
    assert bands_of_light(frames[:3]) == 0
    assert bands_of_light(frames[:, :24]) == 0


@pytest.mark.parametrize("axis", [1, 2])
@pytest.mark.parametrize(("share", "wanted"), [(1.0, 0.25), (-0.5, -0.2), (0.0, None)])
def test_neighbours_correlate_along_either_axis(axis, share, wanted):
    """Down or across alone, as after smoothing or sharpening; the mean of both is said."""
    noise = np.random.default_rng(3).normal(size=(3, 96, 130))
    frames = noise + share * np.roll(noise, 1, axis)
    refusal = _correlates(frames, np.ones((2, 12, 16), bool))
    assert (refusal is None) == (wanted is None)
    if wanted is not None:
        assert float(refusal.reason.split()[-1]) == pytest.approx(wanted, abs=0.02)
    assert _correlates(frames, np.zeros((2, 12, 16), bool)) is None


def test_a_shake_is_found_by_some_pixels_of_a_large_picture(monkeypatch):
    """Every third along both axes, with slopes of neighbours, tells the same within its error."""
    random = np.random.default_rng(3)
    light = 80 * ndimage.gaussian_filter(random.normal(size=(210, 260)), 1.5)
    frames = np.array([light] * 5, np.float32)
    frames[3] = ndimage.shift(light, (0.2, -0.1), order=3, mode="nearest")
    frames += random.normal(size=frames.shape).astype(np.float32)
    of_all, error, _ = moves_of(frames)
    monkeypatch.setattr("mishutter.measurement.steady.MOST_PIXELS", 10_000)
    of_some, larger, _ = moves_of(frames)
    np.testing.assert_allclose(of_some, of_all, atol=4 * larger)
    np.testing.assert_allclose(of_some[3] - of_some[0], [0.2, -0.1], atol=0.02)
    assert error < larger < 2 * error


@pytest.mark.parametrize(
    ("excess", "other", "signs", "reason"),
    [
        ((0.1, 0.01), True, {}, "what has detail has 10% more of it"),
        ((0.2, 0.01), False, {}, "what has detail has 20% more of it"),
        ((0.1, 0.01), False, {}, None),
        ((0.1, 0.03), True, {}, "another"),
        ((0.03, 0.001), True, {}, "another"),
        ((0.03, 0.001), True, {"focus": 0.1}, "the focus drifts"),
        ((0.03, 0.001), False, {"focus": 0.1}, None),
        (
            (0.03, 0.001),
            True,
            {"focus": 0.1, "bands": 0.195},
            "lamps that flicker light rows unlike, by 19.5%",
        ),
        ((0.03, 0.001), False, {"bands": 0.195}, None),
    ],
)
def test_what_moves_explains_other_signs(excess, other, signs, reason, monkeypatch):
    """Where edges have more noise than chance gives them, or the focus drifts."""
    another = Refusal("the noise", "another", "remedy") if other else None
    for name in ("_repeats", "_steps_of_eight", "_correlates", "_bends"):
        monkeypatch.setattr(f"mishutter.measurement.signs.{name}", lambda *_: None)
    monkeypatch.setattr("mishutter.measurement.signs._is_filtered", lambda *_: another)
    monkeypatch.setattr("mishutter.measurement.signs.detail_excess", lambda *_: Estimate(*excess))
    blocks, frames = some_blocks(), np.zeros((2, 48, 56), np.float32)
    clip = Clip(frames, 50.0, None, 1000.0, 1.0, ENDS)
    transfer = Transfer(
        *(Law(1.0, 1.0, 0.1), blocks, blocks, 1.0, np.zeros((2, 2)), Estimate(0.0, 1.0)),
        np.ones((1, 1, 900), bool),
    )
    steady = Steady.of(frames)._replace(**signs)
    found = signs_of(clip, steady, transfer, None)
    assert [each.reason[: len(reason or "")] for each in found] == [reason] * (reason is not None)


def test_a_number_is_not_known_for_a_reason_of_its_own():
    """That black is not known stands there where nothing else does."""
    black, noise, other = (
        Refusal(number, f"{number} is hidden", "remedy")
        for number in ("the level of black", "the noise", "the read noise")
    )
    for refusals, first in (
        ((black,), black),
        ((black, noise, other), noise),
        ((other, black, noise), other),
    ):
        assert _reason(refusals) == f"not known: {first.reason}"


@pytest.mark.parametrize(("deviation", "exceeds"), [(0.39, False), (0.41, True)])
def test_noise_of_two_fifths_of_a_step_exceeds_it(deviation, exceeds):
    """Beside that of rounding, at the level whose noise it is."""
    law = Law(9 * (deviation**2 + 1 / 12) - 70.0, 0.7, 1e-9)
    np.testing.assert_array_equal(
        law.exceeds_steps(np.array([90.0, 100.0, 200.0]), 3.0)[1:], [exceeds, True]
    )
    assert not law.exceeds_steps(np.array([90.0]), 3.0)[0]


@pytest.mark.parametrize(("second", "along"), [(None, (50, 30)), (3, (25, 30)), (0, (61, 47))])
def test_the_narrowest_object_is_that_along_the_axis(second, along):
    """Of 30 by 50 px and of 44 by 25; without any the mean of what moves."""
    labels = np.full((100, 90), -1)
    if second != 0:
        labels[10:40, 20:70] = 1
    if second:
        labels[50:94, 10:35] = second
    things = tuple(an_object(40.0, 90.0, 1500) for _ in range(3))
    motion = Motion(things, labels, np.ones(labels.shape), 0, 0.5, 0.0, (61.0, 47.0), 8)
    assert (_narrowest(motion, "rows"), _narrowest(motion, "columns")) == along


def test_what_is_like_the_rest_that_it_covers_is_no_object():
    """Five pixels about one of 12 x 14 px, which hides what is behind it in half of the frames."""
    frames = np.full((5, 48, 90), 20.0, np.float32)
    for k in range(5):
        frames[k, 18:30, 20 + 9 * k : 34 + 9 * k] += 10
    seen = np.zeros((48, 90), bool)
    seen[13:35, 33:57] = True
    fine = Smoothed.of(frames, np.arange(5.0), 1.0)
    own = _unlike_rest(fine, 2, np.array([0.0, 9.0]), seen, range(5))
    assert own[18:30, 38:52].all()
    assert own.sum() == pytest.approx(15 * 17, rel=0.15)
