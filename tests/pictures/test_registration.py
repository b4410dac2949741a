"""Pictures moved over one another, against loops over their pixels; rows are never columns."""

import numpy as np
import pytest
from scipy import ndimage

from mishutter.pictures.registration.refinement import (
    Prior,
    Told,
    no_less,
    push_of_light,
    refined,
)
from mishutter.pictures.registration.search import (
    Search,
    _costs,
    _gain,
    _window,
    around,
    explained,
)
from mishutter.pictures.registration.sweep import (
    Limits,
    Region,
    Smoothed,
    Sweep,
    _residuals,
    _tiles,
    swept,
)
from mishutter.pictures.registration.windows import Window, filled, smoothed, splines

PICTURE = np.random.default_rng(1).normal(size=(23, 31)).astype(np.float32)


@pytest.mark.parametrize("by", [(-2.3, 4.6), (3.0, -1.25), (9.5, 0.0)])
@pytest.mark.parametrize("window", [Window(4, 9, 7, 12), Window(14, 2, 9, 20)])
def test_a_window_takes_what_lies_beyond_it(window, by):
    """Bilinear, or by splines; a picture goes on as it ends, and what is seen lies within."""
    by = np.array(by)
    rows = np.arange(window.top, window.top + window.rows) + by[0]
    columns = np.arange(window.left, window.left + window.columns) + by[1]
    places = np.meshgrid(rows, columns, indexing="ij")
    wanted = ndimage.map_coordinates(PICTURE, places, order=1, mode="nearest")
    np.testing.assert_allclose(window.taken(PICTURE, by), wanted, atol=1e-5)
    for margin in (0, 2):
        seen = (places[0] >= margin) & (places[0] <= 22 - margin)
        seen &= (places[1] >= margin) & (places[1] <= 30 - margin)
        np.testing.assert_array_equal(window.seen(by, PICTURE.shape, margin), seen)
    (coefficients,) = splines(PICTURE[None])
    wanted = ndimage.map_coordinates(PICTURE.astype(float), places, order=3, mode="mirror")
    found = window.taken(coefficients, by, is_spline=True)
    np.testing.assert_allclose(found[seen], wanted[seen], atol=1e-4)


def test_windows_are_parts_of_pictures():
    """About a mask, over ways, displaced and with a margin, within the picture or beyond it."""
    mask = np.zeros((23, 31), bool)
    mask[3:9, 12:30] = True
    assert Window.around(mask, 0) == (3, 12, 6, 18)
    assert Window.around(mask, 4) == (0, 8, 13, 23)
    assert Window.whole((5, 23, 31)) == (0, 0, 23, 31)
    window = Window(3, 12, 6, 7)
    assert window.swept(np.array([[-1.5, 2.0], [6.2, -3.1]]), (23, 31)) == (1, 8, 15, 13)
    assert window.swept(np.array([[-9.0, 0.0], [19.0, 15.5]]), (23, 31)) == (0, 12, 23, 19)
    assert window.aside(np.array([-5, 9])) == (-2, 21, 6, 7)
    assert window.wider(4) == (-1, 8, 14, 15)
    np.testing.assert_array_equal(window.of(PICTURE), PICTURE[3:9, 12:19])
    beyond = Window(-2, 27, 6, 7)
    part = np.zeros((6, 7))
    part[2:, :4] = PICTURE[:4, 27:]
    np.testing.assert_array_equal(beyond.cut(PICTURE), part)
    sums = PICTURE.copy()
    beyond.add(sums, np.ones((6, 7), np.float32))
    added = np.zeros((23, 31))
    added[:4, 27:] = 1
    np.testing.assert_allclose(sums - PICTURE, added, atol=1e-6)
    np.testing.assert_array_equal(window.of(window.placed(np.ones((6, 7)), (23, 31))), 1)
    assert window.placed(np.ones((6, 7)), (23, 31)).sum() == 42


def test_what_is_unknown_is_that_about_it():
    """A hole in a slope is filled by the slope's level there, and an unknown picture by a grey."""
    known = np.ones((23, 31), bool)
    known[9:13, 10:16] = False
    slope = np.arange(31) * 0.1 + np.arange(23)[:, None] * 0.3
    found = filled(slope, known)
    np.testing.assert_allclose(found[~known].mean(), slope[~known].mean(), atol=0.05)
    np.testing.assert_allclose(found[~known], slope[~known], atol=0.6)
    np.testing.assert_array_equal(found[known], slope[known])
    np.testing.assert_array_equal(filled(slope, np.zeros((23, 31), bool)), 0.3)
    # By narrow Gaussians alone what is near stays, and what lies far off has the mean level.
    alone = np.zeros((90, 90), bool)
    alone[:20] = True
    light = np.arange(90) * 0.01 + np.zeros((90, 1))
    narrow, wide = filled(light, alone, 6.0), filled(light, alone)
    np.testing.assert_array_equal(narrow[:28], wide[:28])
    np.testing.assert_allclose(narrow[-40:], light[0].mean(), atol=1e-6)
    stack = np.stack([PICTURE, 2 * PICTURE])
    each = [ndimage.gaussian_filter(x, 1.3, mode="nearest") for x in stack]
    np.testing.assert_allclose(smoothed(stack, 1.3), each, atol=1e-6)


def moved(frames, velocity, times, seed=2, noise=0.0):
    """A texture that goes so many px a time, without an end."""
    random = np.random.default_rng(seed)
    light = ndimage.gaussian_filter(random.normal(size=(60, 74)), 2.0, mode="wrap")
    light /= light.std()
    down, across = np.fft.fftfreq(60)[:, None], np.fft.fftfreq(74)
    out = []
    for time in times[:frames]:
        phase = np.exp(-2j * np.pi * time * (down * velocity[0] + across * velocity[1]))
        out.append(np.fft.ifft2(np.fft.fft2(light) * phase).real)
    return np.array(out) + noise * random.normal(size=(frames, 60, 74))


def test_frames_that_are_off_push_by_the_curvature_times_the_way():
    """Of unequal times and weights, each pixel less its own mean and at its own mean time."""
    off, times = np.array([0.03, -0.05]), np.array([-1.0, 0.5, 2.0, 2.5])
    frames = moved(4, off, times)
    weights = np.random.default_rng(3).uniform(0.2, 1, frames.shape)
    mean = np.average(frames, axis=0, weights=weights)
    found = push_of_light(frames, weights, times, mean, noise=0.25, slope_noise=0.1)
    curvature = np.sum(found.curvatures, axis=(2, 3))
    np.testing.assert_allclose(np.sum(found.forces, axis=(1, 2)), curvature @ off, rtol=0.1)
    late = times[:, None, None] - np.sum(weights * times[:, None, None], axis=0) / weights.sum(0)
    square = np.sum(weights * late**2, axis=0)
    slopes = np.gradient(mean)
    for i, j in np.ndindex(2, 2):
        wanted = np.sum(slopes[i] * slopes[j] * square) / 0.25
        assert curvature[i, j] == pytest.approx(wanted, rel=1e-9)
    assert found.by_noise == pytest.approx(0.1 * np.sum(square / weights.sum(axis=0)))


def test_the_noise_of_slopes_tells_nothing():
    """A curvature H of which c is noise tells (H - c) H^-1 (H - c), and the push as much less."""
    frames = moved(3, (0.02, 0.01), np.array([-1.0, 0.0, 2.0]))
    weights = np.ones(frames.shape)
    mean = frames.mean(axis=0)
    push = push_of_light(frames, weights, np.array([-1.0, 0, 2]), mean, noise=1.0, slope_noise=0.02)
    curvature, force = np.sum(push.curvatures, axis=(2, 3)), np.sum(push.forces, axis=(1, 2))
    own = curvature - push.by_noise * np.eye(2)
    told, twice = Told.by([push]), Told.by([push, push])
    np.testing.assert_allclose(told.information, own @ np.linalg.inv(curvature) @ own, rtol=1e-9)
    np.testing.assert_allclose(told.push, own @ np.linalg.inv(curvature) @ force, rtol=1e-9)
    blocks = [
        np.sum(push.forces[:, a : a + 12, b : b + 12], axis=(1, 2))
        for a in range(0, 60, 12)
        for b in range(0, 74, 12)
    ]
    gain = own @ np.linalg.inv(curvature)
    wanted = gain @ np.maximum(np.transpose(blocks) @ blocks, 0) @ gain
    np.testing.assert_allclose(told.scatter, wanted, rtol=1e-9)
    for name in ("information", "push", "scatter"):
        np.testing.assert_allclose(getattr(twice, name), 2 * getattr(told, name))
    assert not Told.by([]).information.any()


@pytest.mark.parametrize("free", [(True, True), (True, False), (False, True)])
def test_a_velocity_is_refined_to_where_all_that_is_known_agrees(free):
    """Of a push that is linear: the mean of what frames tell and of what is known before."""
    information = np.array([[5.0, 1.2], [1.2, 3.0]])
    scatter = np.array([[7.0, -0.4], [-0.4, 2.0]])
    truth, before = np.array([0.21, -0.13]), np.array([0.05, 0.03])
    first = np.where(free, before, 0.0)

    def told_at(velocity):
        return Told(information, information @ (truth - velocity), scatter)

    prior = Prior(before, 0.6, free)
    velocity, covariance = refined(first, told_at, prior, 1.5, 30)
    certain = np.eye(2) / 0.36
    among = np.ix_(*2 * (np.flatnonzero(free),))
    fixed = np.where(free, 0.0, first)
    pull = information @ (truth - fixed) + certain @ (before - fixed)
    inverse = np.linalg.inv((information + certain)[among])
    wanted = fixed.copy()
    wanted[list(free)] = inverse @ pull[list(free)]
    np.testing.assert_allclose(velocity, wanted, atol=0.004)
    np.testing.assert_allclose(covariance[among], inverse @ (scatter + certain)[among] @ inverse)
    assert np.count_nonzero(covariance) == sum(free) ** 2


def test_a_step_is_no_longer_than_a_pixel_over_the_frames():
    """And half as long once it turns back."""
    seen = []

    def told_at(velocity):
        seen.append(velocity[0])
        push = np.array([9.0, 0.0]) if velocity[0] < 0.6 else np.array([-9.0, 0.0])
        return Told(np.eye(2), push, np.eye(2))

    refined(np.zeros(2), told_at, Prior(np.zeros(2), 1e6), 4.0, 5)
    np.testing.assert_allclose(np.diff(seen), [0.25, 0.25, 0.25, -0.125, -0.125], rtol=1e-6)


def test_tiles_overlap_by_half():
    """Sums over squares of a side, of pictures of any two sides."""
    found = _tiles(PICTURE, 6)
    assert found.shape == (6, 9)
    for i, j in np.ndindex(*found.shape):
        part = PICTURE[3 * i : 3 * i + 6, 3 * j : 3 * j + 6]
        assert found[i, j] == pytest.approx(float(part.sum()), abs=1e-4)
    sweep = Sweep(np.zeros((1, 2)), np.zeros((1, 3, 5)), 1.0, 16, 0.1)
    tiles = np.zeros((3, 5), bool)
    tiles[1, 3] = True
    mask = np.zeros((40, 50), bool)
    mask[8:24, 24:40] = True
    np.testing.assert_array_equal(sweep.mask(tiles, (40, 50)), mask)


def test_residuals_of_tiles_are_variances_of_what_is_seen():
    """Of averages over 4 x 4 px from half-pixel places, moved down and across, in two frames."""
    frames = np.random.default_rng(5).normal(size=(3, 128, 144)).astype(np.float32)
    parts = np.empty((2, 2, 3, 31, 35), np.float32)
    for i, j in np.ndindex(2, 2):
        for y, x in np.ndindex(31, 35):
            square = frames[:, 2 * i + 4 * y : 2 * i + 4 * y + 4, 2 * j + 4 * x : 2 * j + 4 * x + 4]
            parts[i, j, :, y, x] = 4 * square.mean(axis=(1, 2))
    ways = np.array([[0.0, 0.0], [6.0, -4.0], [10.0, 8.0]])
    wide, narrow = _residuals(parts, ways)
    residual, seen = np.zeros((31, 35)), np.zeros((31, 35))
    for y, x in np.ndindex(31, 35):
        values = []
        for k, (down, across) in enumerate(ways / 2):
            (i, j), (a, b) = np.array([down, across]).astype(int) % 2, np.array([down, across]) // 2
            row, column = y + int(a), x + int(b)
            if 0 <= row < 31 and 0 <= column < 35:
                values.append(parts[i, j, k, row, column])
        if len(values) > 1:
            residual[y, x], seen[y, x] = np.var(values, ddof=1), 1
    for side, found in ((12, wide), (4, narrow)):
        total, count = _tiles(residual, side), _tiles(seen, side)
        wanted = np.where(count > 0.6 * side**2, total / np.maximum(count, 1), np.inf)
        np.testing.assert_allclose(found, wanted, rtol=1e-4)


@pytest.mark.parametrize("moves", [(True, False), (False, True)])
def test_a_sweep_keeps_to_its_limits(moves):
    """Things that go along one axis have velocities along it alone, and none beyond the fastest."""
    frames = np.zeros((3, 112, 240), np.float32)
    wide = swept(frames, np.array([0.0, 0.1, 0.3]), 1)[0]
    assert np.max(np.hypot(*wide.velocities.T)) == pytest.approx(0.375 * 112 / 0.3, abs=16)
    assert wide.step == pytest.approx(16)
    found = swept(frames, np.array([0.0, 0.1, 0.3]), 1, Limits(50.0, moves))[0].velocities
    along, across = found.T if moves[0] else found.T[::-1]
    assert not across.any()
    np.testing.assert_allclose(np.sort(along), np.arange(-4, 5) * 16.0)


def test_frames_that_are_swept_hold_the_reference():
    """Four that are so many apart, as far as there are, with more before than after it."""
    assert _window(9, 4, 1).tolist() == [2, 3, 4, 5]
    assert _window(9, 0, 2).tolist() == [0, 2, 4, 6]
    assert _window(9, 8, 2).tolist() == [2, 4, 6, 8]
    assert _window(9, 4, 3).tolist() == [1, 4, 7]
    assert around(9, 4, 1) == [2, 3, 4, 5, 6]
    assert around(9, 1, 3) == [1, 4, 7]


@pytest.fixture(scope="module")
def smooth():
    """Five frames at unequal times, whose texture goes down and to the left in their lower half."""
    times = np.array([-2.0, -1.0, 0.0, 1.5, 2.0])
    frames = 6 * moved(5, (0.0, 0.0), times)
    frames[:, 30:] = 6 * moved(5, (1.0, -1.5), times, seed=4)[:, 30:]
    frames += np.random.default_rng(6).normal(size=frames.shape)
    return Smoothed.of(frames.astype(np.float32), times, 1.0)


def test_the_residual_of_a_pixel_is_that_of_the_better_side(smooth):
    """Of all frames, those before and those after; averaged under a Gaussian, where it is seen."""
    velocity, near = np.array([1.0, -1.5]), [0, 1, 2, 3, 4]
    found = _costs(smooth, velocity, 2, near)
    values, seen = smooth.along(velocity, 2, near, Window.whole((60, 74)))
    least = np.full((60, 74), 50.0)
    for side in ([0, 1, 2, 3, 4], [0, 1, 2], [2, 3, 4]):
        residual, known = np.zeros((60, 74)), np.zeros((60, 74))
        for y, x in np.ndindex(60, 74):
            own = [values[k, y, x] for k in side if seen[k, y, x]]
            if len(own) > 1:
                known[y, x] = 1
                residual[y, x] = min(np.var(own, ddof=1) * 4 * np.pi, 50)
        total, weight = (ndimage.gaussian_filter(x, 2.5) for x in (residual, known))
        each = np.where(weight > 0.3, total / np.maximum(weight, 1e-3), 50)
        least = np.minimum(least, each)
    np.testing.assert_allclose(found, least, rtol=1e-4)
    window = Window(33, 20, 20, 31)
    inner = np.s_[8:-8, 8:-8]
    part = _costs(smooth, velocity, 2, near, window)
    np.testing.assert_allclose(part[inner], window.of(found)[inner], rtol=0.2)


def test_each_pixel_has_the_velocity_that_explains_it(smooth):
    """Rest above, and below the second of two."""
    labels = explained(smooth, np.array([[-1.0, 1.5], [1.0, -1.5]]), 2)
    assert np.mean(labels[5:25, 5:-5] == 0) > 0.95
    assert np.mean(labels[37:-8, 8:-8] == 2) > 0.95


def test_what_is_explained_is_not_looked_for_again(smooth, monkeypatch):
    """By the better of rest and a velocity; without that, the part that moves is looked at."""
    search = Search.of((smooth, smooth), 2, 1, 300)
    where = np.zeros((60, 74), bool)
    where[5:25, 8:-8], where[37:-8, 8:-8] = True, True
    parts = []

    def best_of_part(_, part, width):
        parts.append(part)
        return np.zeros(2)

    monkeypatch.setattr(Search, "best_of_part", best_of_part)
    search.about_found(0.5, where)
    (part,) = parts
    assert np.mean(part[40:48, 12:-12]) > 0.9
    assert not part[:30].any()
    velocity = np.array([1.0, -1.5])
    cost, won = search.won(velocity)
    assert np.mean(won[40:48, 12:-12]) > 0.9
    assert np.mean(won[5:25, 8:-8]) < 0.05
    search.add(velocity, cost)
    search.about_found(0.5, where)
    assert len(parts) == 1
    assert not search.is_new(velocity + 0.05)
    assert search.reach == 2.0


def test_velocities_beside_those_that_were_tried_are_not_tried_again(smooth, monkeypatch):
    """Rest among them, beside which one explains more than the last does."""
    velocities = np.array([[0.0, 0.0], [0.5, 0.0], [5.0, 0.0], [9.0, 0.0]])
    residuals = np.array([[[100.0, 100.0]], [[30.0, 30.0]], [[1.0, 100.0]], [[100.0, 40.0]]])
    search, tried = Search.of((smooth, smooth), 2, 1, 300), []

    def refined(search, velocity, width, mask):
        tried.append((*velocity, width, int(np.argmax(mask.any(axis=0)))))
        return velocity

    monkeypatch.setattr(Search, "refined", refined)
    monkeypatch.setattr(Search, "is_new", lambda search, v: not search.velocities.append(v))
    search.over(Sweep(velocities, residuals, 1.0, 16, 0.0))
    assert tried == [(5, 0, 1, 0), (9, 0, 1, 8)]


def test_a_region_costs_least_along_its_velocity(smooth):
    """Of all pixels of its mask that two frames see; a grid and a descent end there."""
    mask = np.zeros((60, 74), bool)
    mask[36:54, 10:64] = True
    region = Region(smooth, 2, range(5), mask)
    velocity = np.array([1.0, -1.5])
    values, seen = smooth.along(velocity, 2, range(5), Window.whole((60, 74)))
    total, freedom = 0.0, 0
    for y, x in np.argwhere(mask):
        own = values[seen[:, y, x], y, x]
        if own.size > 1:
            total += np.sum(np.log1p((own - own.mean()) ** 2 * 4 * np.pi / 9))
            freedom += own.size - 1
    assert region.cost(velocity) == pytest.approx(total / freedom, rel=1e-4)
    grid = region.best_of_grid(velocity + np.array([0.5, -0.25]), 1.0)
    np.testing.assert_allclose(grid, velocity)
    end = region.descended(velocity + np.array([0.3, 0.2]), 0.4, 0.02)
    np.testing.assert_allclose(end, velocity, atol=0.05)
    # Of things that move across the columns alone, whatever would explain more.
    alone = region._replace(limits=Limits(moves=(False, True)))
    np.testing.assert_allclose(alone.best_of_grid(np.array([0.5, -1.25]), 1.0), [0.5, -1.5])
    end = alone.descended(np.array([0.8, -1.3]), 0.4, 0.02)
    assert end[0] == 0.8
    assert alone.cost(end) <= min(alone.cost(end + np.array([0, by])) for by in (-0.04, 0.04))
    assert smooth.reach(2, [1, 3]) == 1.5
    assert smooth.variance == pytest.approx(1 / (4 * np.pi))


def test_a_velocity_gains_on_the_tiles_that_it_explains_better():
    """By more than the margin of noise, in logarithms; tiles that are not seen count nothing."""
    residuals = np.array([[[8.0, 1.0], [0.2, np.inf]], [[2.0, 4.0], [0.9, 1.0]]])
    sweep = Sweep(np.array([[0.0, 0.0], [1.0, 2.0]]), residuals, 1.0, 16, 0.3)
    current = np.log(np.array([[8.0, 8.0], [4.0, 2.0]]))
    wanted = [
        np.log(8) - 0.3 + np.log(5) - 0.3,
        np.log(4) + np.log(2) + np.log(4 / 0.9) + np.log(2),
    ]
    np.testing.assert_allclose(_gain(sweep, current), np.array(wanted) - [0, 4 * 0.3])
    np.testing.assert_array_equal(sweep.near(np.array([0.9, 1.0]), 1.1), [False, True])


def test_a_covariance_is_no_less_than_another_in_any_direction():
    """Where it is greater it stays, and where it is less it is the other."""
    least = np.array([[2.0, 0.6], [0.6, 1.0]])
    direction = np.linalg.cholesky(least) @ np.array([0.6, 0.8])
    wide = 0.1 * least + 4 * np.outer(direction, direction)
    np.testing.assert_allclose(no_less(0.1 * least, least), least, rtol=1e-12)
    np.testing.assert_allclose(no_less(3 * least, least), 3 * least, rtol=1e-12)
    found = no_less(wide, least)
    np.testing.assert_allclose(found, least + 3.1 * np.outer(direction, direction), rtol=1e-12)
