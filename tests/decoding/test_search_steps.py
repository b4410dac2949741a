"""Steps of the search for a velocity in frames, and each doubt of what it found, by hand."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from mishutter import PlaneFrames, Scene, Sensor, StillCamera, TimedFrame
from mishutter.camera.responses import frequencies_on
from mishutter.decoding import frame_velocity
from mishutter.decoding.frame_doubts import Evidence, Rival, Words, doubt_of_rows, odd_frame
from mishutter.decoding.frame_likelihood import ROUGHLY, Own, Prior, climbed
from mishutter.decoding.frame_velocity import (
    VelocityEstimate,
    _beside,
    _Burst,
    _peaks,
    _shows,
    _sizes_of,
    _Speeds,
    _top,
    _values,
    _velocities_to_try,
)
from mishutter.decoding.likeliest import Detail, Fit, _in_tiles
from mishutter.decoding.rolling import GLOBAL, _few_delays
from mishutter.pictures.registration.windows import means

WORDS = Words("velocity", "many reasons", "of the picture fits better", "Beyond.")


def fit_of(misfit=1.0, **others):
    """The fit of three frames, all of them as they should be."""
    numbers = {
        "misfits": np.full(3, misfit),
        "gains": np.zeros(3),
        "offsets": np.zeros(3),
        "shifts": np.zeros((3, 2)),
        "shift_errors": np.full((3, 2), 0.01),
        "parts": np.zeros(20),
        "logarithm": 0.0,
    }
    return Fit(misfit=misfit, **(numbers | others))


def evidence(**others):
    """That of three frames of noise, 5 px down and 4 px back from each to the next, of no doubt."""
    frames = 0.3 + 0.1 * np.random.default_rng(0).normal(size=(3, 20, 30))
    numbers = {
        "frames": frames,
        "noises": np.full(3, 1e-3),
        "places": np.array([[0.0, -4.0, -8.0], [0.0, 5.0, 10.0]]),
        "fit": fit_of(),
        "compared": fit_of(),
        "elsewhere": 9.0,
        "rivals": [],
        "lead": 1000.0,
        "middle": 500.0,
        "is_within": True,
    }
    return Evidence(**(numbers | others))


def repeated(places):
    """Frames of which the last is the first."""
    base = evidence()
    frames = base.frames.copy()
    frames[2] = frames[0]
    return {"frames": frames, "places": np.array(places)}


def rival(below=200.0, misfit=6.0, parts=0.0):
    return [Rival(np.array([-30.0, 1200.0]), below, fit_of(misfit, parts=np.full(20, parts)))]


def some(parts, count):
    """A rival that is better by so much in some of twenty parts."""
    better = np.where(np.arange(20) < count, parts, 0.0)
    return [Rival(np.array([-30.0, 1200.0]), 200.0, fit_of(6.0, parts=better))]


APART = {
    "nothing": ({}, ""),
    "shift": (
        {"fit": fit_of(shifts=np.array([[0, 0], [0, -0.4], [0.36, 0]]))},
        "Frame 2 of 3 is +0.0, -0.4 px off its place: many reasons.",
    ),
    "little shift": ({"fit": fit_of(shifts=np.array([[0, 0], [0, -0.34], [0, 0]]))}, ""),
    "unsure shift": (
        {
            "fit": fit_of(
                shifts=np.array([[0, 0], [0, -0.4], [0, 0]]), shift_errors=np.full((3, 2), 0.09)
            )
        },
        "",
    ),
    "surer shift": (
        {
            "fit": fit_of(
                shifts=np.array([[0, 0], [0, -0.4], [0, 0]]), shift_errors=np.full((3, 2), 0.085)
            )
        },
        "Frame 2 of 3 is +0.0, -0.4",
    ),
    "shift of poor fit": (
        {
            "fit": fit_of(
                1.2,
                shifts=np.array([[0, 0], [0, -0.4], [0, 0]]),
                shift_errors=np.full((3, 2), 0.085),
            )
        },
        "",
    ),
    "frame of another picture": (
        {"fit": fit_of(misfits=np.array([1.0, 1.1, 5.3]))},
        "Frame 3 of 3 does not fit the picture of the others (misfit 5.3)",
    ),
    "frame of nearly that": ({"fit": fit_of(misfits=np.array([1.0, 1.1, 5.0]))}, ""),
    "frame where little would differ": (
        {"fit": fit_of(misfits=np.array([1.0, 1.1, 1.55])), "elsewhere": 1.5},
        "Frame 3 of 3 does not",
    ),
    "frame within the spread": (
        {"fit": fit_of(misfits=np.array([1.0, 1.1, 1.49])), "elsewhere": 1.5},
        "",
    ),
    "misfit": ({"compared": fit_of(5.1)}, "The frames do not fit one picture at one velocity"),
    "little misfit": ({"compared": fit_of(2.9)}, ""),
    "large part": ({"compared": fit_of(3.1)}, "The frames do not fit"),
    "part": ({"compared": fit_of(1.5), "elsewhere": 2.2}, ""),
    "half": ({"compared": fit_of(1.5), "elsewhere": 2.0}, "The frames do not fit"),
    "third of a large one": ({"compared": fit_of(1.9), "elsewhere": 4.0}, "The frames do not fit"),
    "fifth of it": ({"compared": fit_of(1.9), "elsewhere": 6.0}, ""),
    "nearly none": ({"compared": fit_of(1.2), "elsewhere": 1.3}, ""),
    "same": (
        repeated([[0.0, 4.0, 0.9], [0.0, 5.0, 1.0]]),
        "Frames 1 and 3 are the same, though the picture moves between them.",
    ),
    "same where it stands": (repeated([[0.0, 4.0, 0.5], [0.0, 5.0, 0.7]]), ""),
    "little": ({"lead": 99.0}, "The picture has too little detail"),
    "enough": ({"lead": 101.0}, ""),
    "little for its spread": ({"lead": 101.0, "fit": fit_of(1.1)}, "The picture has too little"),
    "only": ({"lead": 99.0, "is_only": True, "is_within": False}, ""),
    "steps": (
        {"places": np.array([[0.0, -20.0, -40.0], [0.0, 9.0, 18.0]])},
        "The picture moves by 22 px from frame to frame, of which the sensor sees 30 x 20.",
    ),
    "shorter steps": ({"places": np.array([[0.0, -17.0, -34.0], [0.0, 9.0, 18.0]])}, ""),
    "beyond": ({"is_within": False}, "Beyond."),
    "rival": ({"rivals": rival(99.0)}, "The frames fit -30, 1,200 px/s as well"),
    "worse rival": ({"rivals": rival(101.0)}, ""),
    "rival that fits": ({"rivals": rival(misfit=2.9)}, "The frames fit -30, 1,200"),
    "rival that fits less": ({"rivals": rival(misfit=3.1)}, ""),
    "rivals everywhere": ({"rivals": rival(99.0), "middle": 99.0}, "The picture has too little"),
    "parts": ({"rivals": some(31.0, 3)}, "At -30, 1,200 px/s 15% of the picture fits better"),
    "few parts": ({"rivals": some(31.0, 2)}, ""),
    "parts a little": ({"rivals": some(29.0, 3)}, ""),
    "parts of a poor fit": ({"rivals": some(31.0, 3), "fit": fit_of(1.1)}, ""),
}


@pytest.mark.parametrize("name", APART)
def test_each_doubt_has_its_own_reason(name):
    """Just beyond each limit, and none just within it."""
    changes, doubt = APART[name]
    found = evidence(**changes).doubt(0.2, WORDS)
    assert found.startswith(doubt)
    assert bool(found) == bool(doubt)


def test_an_error_of_a_pixel_over_the_frames_is_little():
    """And so is one that is no number; less is no doubt."""
    assert evidence().doubt(0.99, WORDS) == ""
    for error in (1.01, np.nan):
        assert evidence().doubt(error, WORDS).startswith("The picture has too little")


@pytest.mark.parametrize(
    ("level", "noise", "doubt"), [(0.02, 1e-3, "black"), (0.04, 1e-3, ""), (0.02, 2e3, "")]
)
def test_a_frame_without_light_is_black(level, noise, doubt):
    """Where it is below a tenth of the brightest, beyond the errors of both means."""
    random = np.random.default_rng(2)
    frames = np.stack([np.full((20, 30), 0.3)] * 3)
    frames[1] = level
    frames = frames + 1e-3 * random.normal(size=frames.shape)
    found = odd_frame(frames, np.full(3, noise))
    assert found == (f"Frame 2 of 3 is {doubt}." if doubt else "")


@pytest.mark.parametrize(
    ("share", "level", "is_odd"), [(0.6, 1, True), (0.4, 1, False), (0.6, 0, False)]
)
def test_a_frame_of_which_most_is_at_the_top_is_saturated(share, level, is_odd):
    """More than half of it, and no darker than the others."""
    frames = np.random.default_rng(2).uniform(0.2, 0.4, size=(3, 20, 30))
    frames[2].flat[: int(share * 600)] = level
    if not level:
        frames[2] = np.where(frames[2] == 0, 0.15, frames[2] / 5)
    assert odd_frame(frames, np.full(3, 1e-3)) == ("Frame 3 of 3 is saturated." if is_odd else "")


@pytest.mark.parametrize(
    ("least", "count", "is_said"),
    [(1.69, 10_000, True), (1.71, 10_000, False), (1.36, 800, False), (1.34, 800, True)],
)
def test_a_readout_has_to_explain_an_eighth_and_lead(least, count, is_said):
    """Of 0.8 above 1 a ninth is too little; and of 800 pixels 200 x 1.8 / 800 is what tells."""

    def misfit_by(sensor, _):
        if not sensor.is_rolling:
            return 1.8
        return least if sensor.readout > 4e-3 and sensor.rows_read == "up" else least + 0.05

    doubt = doubt_of_rows(Sensor(), 0.01, {1: count}, misfit_by)
    assert doubt.startswith("A rolling shutter of about 5 ms") == is_said
    assert bool(doubt) == is_said


def test_a_long_readout_is_tried_where_a_short_one_does_not_help():
    """Rows read within the whole exposure, which a quarter of that does not explain."""

    def misfit_by(sensor, _):
        return {0.0: 1.6, 2.5e-3: 1.7, 5e-3: 1.65, 1e-2: 1.3}[round(sensor.readout_time, 6)]

    doubt = doubt_of_rows(Sensor(), 0.01, {1: 10_000}, misfit_by)
    assert doubt.startswith("A rolling shutter of about 10 ms")


def test_speeds_are_a_law():
    """The fastest is the greatest of both, or of their differences; ends belong to them."""
    assert _Speeds(-30.0, 20.0).fastest == 50
    assert _Speeds(-30.0, -20.0).fastest == 30
    assert _Speeds(10.0, 40.0).fastest == 40
    inside = _Speeds(-30.0, 20.0).within(np.array([[-33.0], [-31.9], [21.9], [23.0]]), 2.0)
    np.testing.assert_array_equal(inside, [False, True, True, False])


def test_speeds_are_tried_a_step_apart_at_most():
    """From 3 % of the fastest before the lowest to as much past the highest."""
    speeds = _velocities_to_try(_Speeds(-200.0, 100.0), 7.0)[:, 0]
    assert speeds[0] == pytest.approx(-209)
    assert speeds[-1] == pytest.approx(109)
    np.testing.assert_allclose(np.diff(speeds), 318 / (len(speeds) - 1))
    assert 318 / len(speeds) < 7 <= 318 / (len(speeds) - 3)
    with pytest.raises(ValueError, match="28,658 px/s of each other"):
        _velocities_to_try(_Speeds(-20000.0, 20000.0), 7.0)


def test_velocities_are_tried_on_a_square_grid():
    """On all of a disc and 3 % beyond, with rest among them."""
    law = Scene.any_direction(100.0, photon_rate=1e4, read_noise=2.0).velocities
    grid, step = _velocities_to_try(law, 9.0), 9.0
    np.testing.assert_allclose(grid / step, np.rint(grid / step), atol=1e-9)
    everywhere = step * np.stack(np.meshgrid(*[np.arange(-20, 21)] * 2), axis=-1).reshape(-1, 2)
    radius = np.hypot(*everywhere.T)
    assert len(grid) == np.sum(radius <= 103 + step / np.sqrt(2))
    with pytest.raises(ValueError, match="velocities below 64 px/s"):
        _velocities_to_try(law, 1.0)


def test_steps_beside_a_velocity_leave_no_gap():
    """Of steps twice as large one to either side, of three times one, and of 3.1 times two."""
    for ratio, reach in ((2.0, 1), (3.0, 1), (3.1, 2), (5.0, 2), (1.0, 0)):
        steps = np.arange(-reach, reach + 1)
        np.testing.assert_array_equal(_beside(ratio, 1)[:, 0], steps)
        assert len(_beside(ratio, 2)) == len(steps) ** 2


def test_peaks_are_the_highest_of_all_nearby():
    """In the order of their height, at most six, and none within reach of a higher one."""
    random = np.random.default_rng(4)
    places, values = random.uniform(-10, 10, size=(60, 2)), random.normal(size=60)
    wanted = [
        k
        for k in np.argsort(-values)
        if all(values[j] <= values[k] for j in range(60) if np.hypot(*(places[j] - places[k])) <= 3)
    ]
    assert len(wanted) > 6
    np.testing.assert_array_equal(_peaks(places, values, 3.0), places[wanted[:6]])


def own_of(frames, times, exposures, noises=None, axes=1):
    """Frames of a sensor at rest."""
    if axes == 2:
        taken = PlaneFrames(np.array(times), np.array(exposures), np.ones(1), np.zeros((2, 2)))
        scene = Scene.any_direction(150.0, photon_rate=3e4, read_noise=6.0)
    else:
        pairs = zip(times, exposures, strict=True)
        taken = [TimedFrame(StillCamera(half_exposure=e / 2), t) for t, e in pairs]
        scene = Scene(np.linspace(-150.0, 150.0, 5), photon_rate=3e4, read_noise=6.0)
    noises = np.full(len(times), 1e-3) if noises is None else np.array(noises)
    return Own(frames, noises, taken, Prior(scene), has_levels=axes == 2)


TIMES = (0.02, 0.06, 0.11)


@pytest.mark.parametrize(
    ("shape", "sizes", "judged"),
    [
        ((70, 200), [1, 2], 1),
        ((130, 300), [1, 2, 4], 2),
        ((63, 90), [1], 1),
        ((300, 129), [1, 2, 4], 2),
    ],
)
def test_pictures_are_sought_in_32_pixels_and_judged_in_64(shape, sizes, judged):
    """Of their shorter side, once they are binned."""
    own = own_of(np.zeros((3, *shape)), TIMES, [0.01] * 3, axes=2)
    assert _sizes_of(own) == (sizes, judged)


def test_rows_are_binned_where_means_show_most_of_them():
    """A wave of 40 px has 96 % of its variance in means of four, one of 5 px a fifth."""
    x = np.arange(280)
    wave = np.broadcast_to(0.1 * np.sin(2 * np.pi * x / 40), (3, 4, 280))
    assert _sizes_of(own_of(wave, TIMES, [0.01] * 3)) == ([1, 2, 4], 1)
    assert _sizes_of(own_of(wave[..., :240], TIMES, [0.01] * 3)) == ([1, 2], 1)
    fine = np.broadcast_to(0.1 * np.sin(2 * np.pi * x / 5), (3, 4, 280))
    assert not _shows(own_of(fine, TIMES, [0.01] * 3), 4)
    # Half as much as its noise: of 0.02 that is not noise, 0.0125 in means is more than half.
    random = np.random.default_rng(3)
    noisy = fine + 0.2 * random.normal(size=fine.shape)
    whole = np.mean(np.var(noisy, axis=-1)) - 0.04
    left = np.mean(np.var(means(noisy, 2, (-1,)), axis=-1)) - 0.02
    assert _shows(own_of(noisy, TIMES, [0.01] * 3, [0.04] * 3), 2) == (left >= 0.5 * whole)


def test_durations_are_those_of_neighbouring_frames():
    """The longest way between two of three neighbours, and no less than an exposure."""
    assert own_of(np.zeros((2, 4, 90)), TIMES[:2], [0.02, 0.11]).duration == pytest.approx(0.11)
    own = own_of(np.zeros((3, 4, 90)), TIMES, [0.02, 0.01, 0.01])
    assert own.duration == pytest.approx(0.09)
    assert own.duration_of(2) == pytest.approx(0.05)
    assert own.duration_of(1) == pytest.approx(0.02)


def test_neighbouring_frames_are_looked_at_in_overlapping_parts():
    """Of five frames three at a time: the first, one on, and the last three."""
    random = np.random.default_rng(5)
    times = (0.01, 0.03, 0.05, 0.08, 0.1)
    own = own_of(random.normal(size=(5, 2, 70)) / 30, times, [0.01] * 5, [1e-3, 2e-3] * 2 + [1e-3])
    velocities = np.array([[-90.0], [40.0]])
    wanted = sum(
        own.level(velocities, 1, slice(k, k + 3), share=0.5).logarithms(velocities)
        for k in range(3)
    )
    np.testing.assert_allclose(_values(own, velocities, 1, 3), wanted)
    whole = own.level(velocities, 1, share=0.5).logarithms(velocities)
    np.testing.assert_allclose(_values(own, velocities, 1, 5), whole)


def test_a_peak_is_reached_by_a_tenth_of_a_step():
    """Or after five climbs, each from the end of the one before with what the first one knows."""
    x = np.arange(90) + 60 * np.array(TIMES)[:, None, None]
    own = own_of(0.1 * np.sin(x / 5) + 0.05 * np.cos(x / 11), TIMES, [0.01] * 3)
    start = np.array([55.0])
    level = own.level(start[None])
    climbs = [climbed(level, start, ROUGHLY)]
    for _ in range(5):
        climbs.append(climbed(level, climbs[-1].best, ROUGHLY, climbs[0].information))
    sizes = [one.size for one in climbs]
    assert sizes[0] > 2 * sizes[1] > 0
    for step, last in ((20 * sizes[0], 0), (10 * (sizes[0] + sizes[1]) / 2, 1), (0.0, 4)):
        np.testing.assert_allclose(_top(level, start, step).best, climbs[last].best)


def test_a_velocity_is_sought_in_few_binned_frames_and_then_in_all(monkeypatch):
    """Each look tries what lies about the last one's peaks, as far apart as its frames tell."""
    truth, looks = 47.3, []

    def values(_, velocities, size, count):
        looks.append((size, count, velocities[:, 0]))
        return -np.square(velocities - truth)

    def top(level, velocity, step, other=None):
        height = lambda _: -abs(velocity[0] - truth)  # noqa: E731
        return SimpleNamespace(best=velocity, size=0.0, value=height)

    monkeypatch.setattr(frame_velocity, "_sizes_of", lambda own: ([1, 2, 4], 2))
    monkeypatch.setattr(frame_velocity, "_values", values)
    monkeypatch.setattr(frame_velocity, "_top", top)
    own = own_of(np.zeros((5, 2, 70)), (0.01, 0.03, 0.05, 0.08, 0.1), [0.01] * 5)
    found = frame_velocity._searched(own, _Speeds(-150.0, 150.0))
    assert [look[:2] for look in looks] == [(4, 2), (4, 3), (4, 5), (2, 5)]
    steps = [0.7 * size / own.duration_of(count) for size, count, _ in looks]
    for step, (*_, tried) in zip(steps[1:], looks[1:], strict=True):
        np.testing.assert_allclose(np.diff(tried)[0], step)
        assert np.min(np.abs(tried - truth)) <= step / 2
    assert (found.step, found.level.canvas.size) == (pytest.approx(steps[-1]), 2)
    assert abs(found.ends[0].best[0] - truth) <= found.step / 2
    first = looks[0][2]
    assert found.below_top == pytest.approx(
        np.median(np.square(first - truth)) - np.min(np.square(first - truth))
    )


def burst(axes=1, rows=6):
    """Frames of three colours."""
    random = np.random.default_rng(6)
    planes = random.uniform(0.2, 0.4, size=(3, 3, rows, 90))
    own = own_of(planes[0], TIMES, [0.02, 0.01, 0.03], axes=axes)
    return planes, own, _Burst.of(planes, own.prior.scene, own.taken, GLOBAL)


@pytest.mark.parametrize("axes", [1, 2])
def test_grey_frames_are_about_their_levels(axes):
    """Of each row where things move along rows; and the noise is that of their luminance."""
    planes, _, found = burst(axes)
    shares = np.array([0.2126, 0.7152, 0.0722])
    grey = np.tensordot(shares, planes, 1)
    np.testing.assert_allclose(found.grey, grey)
    level = np.mean(grey) if axes == 2 else np.mean(grey, axis=(0, 2))[:, None]
    np.testing.assert_allclose(found.own.frames, grey - level, atol=1e-6)
    white = 3e4 * np.array([0.02, 0.01, 0.03])
    noises = np.sum(shares**2) * (np.mean(grey) * white + 36) / white**2
    np.testing.assert_allclose(found.own.noises, noises, rtol=1e-5)
    assert found.mean == pytest.approx(np.mean(grey) if axes == 2 else 0)
    assert found.own.has_levels == (axes == 2)


@pytest.mark.parametrize("axes", [1, 2])
def test_gains_and_black_levels_are_taken_out(axes):
    """Over the mean gain; what is divided by a gain has less noise by its square."""
    _, _, found = burst(axes)
    gains, offsets = np.array([0.1, -0.2, 0.16]), np.array([0.01, 0.0, -0.02])
    fit = fit_of(gains=gains, offsets=offsets)
    steady = found.steady(fit).own
    over = (1 + gains - 0.02)[:, None, None]
    light = (found.own.frames + found.mean - offsets[:, None, None]) / over - found.mean
    np.testing.assert_allclose(steady.frames, light, atol=1e-6)
    np.testing.assert_allclose(steady.noises, found.own.noises / over.ravel() ** 2)
    dark = found.steady(fit_of(gains=np.array([-1.0, 0.5, 0.5]))).own
    assert dark.noises[0] == pytest.approx(found.own.noises[0] / 0.1**2)


def test_frames_that_fit_nowhere_are_some_pixels_off():
    """By 8 px along the rows and 3 down from frame to frame, or by 4 back and 6."""
    _, own, found = burst(2)
    ways = found.asides * own.duration / 2
    np.testing.assert_allclose(ways, [[-8, 3], [4, 6]])
    _, own, found = burst(1)
    np.testing.assert_allclose(found.asides * own.duration / 2, [[-8], [4]])


def test_the_row_of_most_detail_of_each_band_is_searched():
    """Of 8 rows in 4 bands; a picture of the plane is looked at as a whole."""
    _, _, found = burst(1, rows=8)
    wanted = found.own.frames * np.array([1, 3, 2, 1, 1, 1.9, 4, 2])[:, None]
    some = found._replace(own=found.own._replace(frames=wanted)).searched
    np.testing.assert_array_equal(some.frames, wanted[:, [1, 2, 5, 6]])
    plane = burst(2)[2]
    assert plane.searched is plane.own


def test_an_ellipse_has_the_greatest_error_first():
    """Of standard errors of 3 at an angle of 0.4 and 1 across that."""
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    covariance = turn @ np.diag([9.0, 1.0]) @ turn.T
    found = VelocityEstimate(
        np.array([3.0, -4.0]), covariance, True, np.zeros((1, 2)), np.ones(1), "", None
    )
    assert found.speed == 5
    assert found.error == pytest.approx(3)
    assert found.ellipse[:2] == pytest.approx((3, 1))
    assert np.tan(found.ellipse[2]) == pytest.approx(np.tan(0.4))


def test_detail_goes_on_by_equal_ratios():
    """Between two radii by the logarithm, and beyond both as at the nearer one."""
    detail = Detail(np.array([0.1, 0.4]), np.array([2.0, 8.0]))
    np.testing.assert_allclose(detail.at(np.array([0.0, 0.1, 0.2, 0.4, 0.7])), [2, 2, 4, 8, 8])


def test_tiles_are_eight_along_each_axis():
    """Of 20 x 5 pixels, along whose shorter side each is one; of two planes."""
    values = np.random.default_rng(3).normal(size=(2, 20, 5))
    cuts = [0, 2, 5, 7, 10, 12, 15, 17, 20]
    rows = [np.sum(values[:, a:b], axis=1) for a, b in itertools.pairwise(cuts)]
    np.testing.assert_allclose(_in_tiles(values), np.stack(rows, axis=1).reshape(2, -1))


def test_frequencies_are_those_down_the_columns_first():
    """Of half of a DFT of unlike sides."""
    down, across = frequencies_on((6, 10))
    np.testing.assert_allclose(across[0], np.fft.rfftfreq(10))
    np.testing.assert_allclose(down[:, 0], np.fft.fftfreq(6))


def test_few_delays_are_as_few_as_an_error_allows():
    """By least squares for each of two frames, at delays of a cosine: one fewer leaves too much."""
    random, count = np.random.default_rng(9), 9
    place = np.linspace(-1, 1, count)
    waves = np.exp(1j * np.outer(place, random.normal(size=40)) * 2)[None] * np.array(
        [1.0, 0.3]
    ).reshape(2, 1, 1)
    products = np.real(waves.conj() @ np.swapaxes(waves, 1, 2))

    def left(few):
        index = np.unique(
            np.round((count - 1) / 2 * (1 - np.cos(np.pi * (np.arange(few) + 0.5) / few))).astype(
                int
            )
        )
        squares, weights = [], []
        for one in waves:
            both = np.concatenate([one.real, one.imag], axis=1)
            fit = np.linalg.lstsq(both[index].T, both.T, rcond=None)[0]
            weights.append(fit)
            squares.append(np.sum((both.T - both[index].T @ fit) ** 2))
        return index, np.array(squares), np.array(weights)

    for few in (2, 3, 4):
        index, squares, weights = left(few)
        before = left(few - 1)[1]
        most = np.where(squares < before, np.sqrt(squares * before), squares * 2) / count
        found, own = _few_delays(products, most)
        assert found == index.tolist()
        np.testing.assert_allclose(own, weights, atol=1e-4)
