"""One picture from several frames: its level against the formula, and the speed that they tell."""

import re

import jax
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from mishutter import (
    EnsembleDecoder,
    FreeMotion,
    Occlusion,
    RectShutter,
    Scene,
    Sensor,
    StillCamera,
    TimedFrame,
    TotalVariationDecoder,
    deconvolve,
    example_picture,
    exposures_psnr,
    restore_frames,
    simulate_capture,
    simulate_frames,
)
from mishutter.decoding.frame_doubts import odd_frame
from mishutter.decoding.frame_likelihood import Own, Prior, climbed
from mishutter.decoding.likeliest import noises_of
from mishutter.decoding.restoration import capture_and_restore
from mishutter.model.exposures import Exposures

PERIOD, EXPOSURE, SWING = 1 / 60, 0.0164, 24.0
SCENE = Scene.uniform(max_speed=4500.0, photon_rate=1e5, read_noise=8)


def stills(count, exposure=1.5e-3):
    """Frames of a sensor at rest."""
    still = StillCamera(half_exposure=exposure / 2)
    return [TimedFrame(still, (k - (count - 1) / 2) * PERIOD) for k in range(count)]


def swings(count):
    """Parabolas of alternating direction, between which the sensor goes on at its velocity."""
    half = EXPOSURE / 2
    a = SWING / half**2
    far = 2 * SWING + (PERIOD - EXPOSURE) * 2 * a * half
    return [
        TimedFrame(
            FreeMotion(accelerations=[(-1) ** k * a], half_exposure=half),
            (k - (count - 1) / 2) * PERIOD,
            far * (k % 2),
        )
        for k in range(count)
    ]


def gaussian_rows(count, columns, seed):
    """Rows of the spectrum that the scene stands for, about its mean; not clipped."""
    frequency = np.fft.rfftfreq(columns)
    power = 1 / (frequency**2 + 0.01**2)
    grid = (np.arange(256) + 0.5) / 512
    power *= 0.2**2 / np.mean(1 / (grid**2 + 0.01**2))
    noise = np.random.default_rng(seed).standard_normal((count, columns))
    return 0.25 + np.fft.irfft(np.fft.rfft(noise) * np.sqrt(power), columns)


def squared_error(found, truth, beside=0):
    """Of the columns that all frames see."""
    inner = slice(beside, truth.shape[-1] - beside)
    return float(np.mean((np.asarray(found) - truth)[:, inner] ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1900.0, -4300.0])
@pytest.mark.parametrize("moves", [False, True], ids=["still", "moving"])
def test_rows_are_restored_as_well_as_the_formula_says(moves, speed):
    """Of the scene's spectrum, from four frames, in the columns that all of them see."""
    frames = swings(4) if moves else stills(4)
    told = Scene([speed], photon_rate=1e5, read_noise=8)
    rows = gaussian_rows(96, 1440, seed=int(speed) % 97)
    start = rows.min()  # a capture takes no light below 0
    lifted = np.clip(rows - start, 0, None)
    bright = simulate_frames(lifted, told, frames, speed=speed, num_columns=960)
    rng = np.random.default_rng(4)
    captures = np.asarray(bright) + start
    for capture, frame in zip(captures, frames, strict=True):
        p = 1e5 * frame.exposure
        capture += rng.standard_normal(capture.shape) * np.sqrt(0.25 / p + (8 / p) ** 2)
    found = restore_frames(captures, told, frames, speed=speed)
    error = squared_error(found.light, rows[:, 240:1200], beside=200)
    assert -10 * np.log10(error) == pytest.approx(float(exposures_psnr(told, frames)), abs=0.15)
    # A level that sees no borders is not below the mean over the whole sensor.
    assert squared_error(found.light, rows[:, 240:1200]) >= error


def shown(speed, frames, rows=slice(120, 168), seed=3, **others):
    """Frames of a photograph that is wider than the sensor, and the part that the sensor shows."""
    picture = np.asarray(example_picture().light)[rows, :, 1]
    options = {"num_columns": 480, "key": jax.random.key(seed)} | others
    return simulate_frames(picture, SCENE, frames, speed=speed, **options), picture[:, 130:610]


@pytest.mark.parametrize(("speed", "moves"), [(2710.0, True), (-3900.0, False)])
def test_frames_tell_the_speed_and_its_sign(speed, moves):
    """To within its error, and without a doubt; light enters and leaves at the ends of the rows."""
    frames = swings(4) if moves else stills(4)
    captures, _ = shown(speed, frames)
    estimate = restore_frames(captures, SCENE, frames).estimate
    assert estimate is not None
    assert estimate.trusted
    assert not estimate.doubt
    assert 0 < estimate.error < 10
    assert abs(estimate.speed - speed) < 5 * estimate.error
    assert np.sum(estimate.weights) == pytest.approx(1)
    assert np.all(np.diff(estimate.speeds) > 0)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [-4400.0, 0.0, 560.0])
@pytest.mark.parametrize("count", [2, 8])
def test_few_and_many_frames_tell_the_speed(speed, count):
    """Two are enough, and eight are no trap."""
    for frames in (stills(count), swings(count)):
        captures, _ = shown(speed, frames, rows=slice(120, 132), seed=count, num_columns=300)
        estimate = restore_frames(captures, SCENE, frames).estimate
        assert estimate is not None
        assert abs(estimate.speed - speed) < max(5 * estimate.error, 3.0)


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "speed"), [(slice(120, 132), 1000.0), (slice(30, 42), 900.0)])
def test_a_moving_sensor_shows_all_that_it_restores(rows, speed):
    """It is then half a swing away from either turning point."""
    frames = swings(2)
    captures, truth = shown(speed, frames, rows=rows)
    light = restore_frames(captures, SCENE, frames, speed=speed).light
    error = np.mean((np.asarray(light) - truth) ** 2, axis=0)
    assert max(np.mean(error[:20]), np.mean(error[-20:])) < np.mean(error[60:-60])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("blur", "speed", "rows", "columns"),
    [
        (12.0, -3700.0, slice(120, 124), 256),
        (8.0, -3900.0, slice(120, 124), 200),
        (16.0, 3900.0, slice(120, 136), 320),
    ],
)
def test_smooth_pictures_on_narrow_sensors_tell_the_speed(blur, speed, rows, columns):
    """Their windows show mostly how these fade, so that the search begins far from the speed."""
    picture = np.asarray(example_picture().light)[rows, :, 1]
    picture = gaussian_filter1d(picture, blur, axis=1, mode="nearest")
    options = {"num_columns": columns, "key": jax.random.key(3)}
    captures = simulate_frames(picture, SCENE, swings(4), speed=speed, **options)
    estimate = restore_frames(captures, SCENE, swings(4)).estimate
    assert estimate is not None
    assert abs(estimate.speed - speed) < 2 * estimate.error


def rows_about(planes, scene, frames):
    """Rows of frames about their levels, which tell nothing."""
    planes = np.asarray(planes, np.float64)
    noises = noises_of(scene, [one.exposure for one in frames], 0.25)
    rows = planes - np.mean(planes, axis=(0, 2), keepdims=True)
    return Own(rows, noises, frames, Prior(scene), has_levels=False)


@pytest.mark.parametrize(("kind", "size"), [(swings, 1), (swings, 2)])
def test_a_likelihood_is_climbed_to_its_top(kind, size):
    """By its slope, which is that of differences, from a pixel beside; pixels of either size."""
    frames, speed = kind(4), np.array([913.0])
    captures = simulate_frames(
        np.maximum(gaussian_rows(6, 700, 1), 0),
        SCENE,
        frames,
        speed=913.0,
        num_columns=260,
        key=jax.random.key(3),
    )
    beside = speed + 6.0
    level = rows_about(captures, SCENE, frames).level(beside[None], size)
    step = climbed(level, beside, 1e-6)
    ends = np.sum(level.logarithms(beside + np.array([[0.5], [-0.5]]), 1e-6), axis=1)
    assert step.slope[0] == pytest.approx(ends[0] - ends[1], rel=0.02, abs=0.02)
    again = climbed(level, step.best, 1e-6)
    assert np.sum(level.logarithms(again.best[None])) > np.sum(level.logarithms(beside[None]))
    assert abs(again.best - speed) < 4 / np.sqrt(again.information[0, 0])


@pytest.mark.parametrize("rows", [slice(120, 126), slice(300, 306)])
def test_pictures_are_near_enough_their_likeliest_to_tell_the_speed(rows):
    """Of bright frames, where the error is least: conjugate gradients that go on move it little."""
    bright, frames = Scene.uniform(max_speed=4500.0, photon_rate=1e6, read_noise=2), swings(6)
    picture = np.asarray(example_picture().light)[rows, :, 1]
    captures = simulate_frames(
        picture, bright, frames, speed=3700.0, num_columns=200, key=jax.random.key(3)
    )
    level = rows_about(captures, bright, frames).level(np.array([[3700.0]]))
    near, limit = (climbed(level, np.array([3700.0]), each) for each in (1e-4, 1e-6))
    assert abs(near.best - limit.best) < 0.3 / np.sqrt(limit.information[0, 0])


def dense_covariance(found):
    """Of all pixels of one row of the frames, frame by frame."""
    (length,), canvas = found.canvas.shape, found.canvas
    place = (np.arange(length)[:, None] - np.arange(length)) % length
    power = np.fft.irfft(canvas.power, length)[place]
    inside = canvas.window[-1]
    seen = np.concatenate(
        [np.fft.irfft(one, length)[place][inside] for one in found.responses[:, 0, 0]]
    )
    return seen @ power @ seen.T + np.diag(np.repeat(canvas.noises, *canvas.sensor))


def test_unknown_levels_are_a_term_of_rank_one_for_each_row_of_a_frame():
    """The likelihood is that of a dense covariance with a level of any size in each frame."""
    frames, columns, speed = stills(3), 120, 900.0
    planes = np.random.default_rng(8).standard_normal((3, 2, columns)).cumsum(axis=-1) / 20
    rows, at = rows_about(planes, SCENE, frames), np.array([[speed]])
    found = rows.level(at).likeliest(at, 1e-6)
    levels = 1e4 * np.kron(np.eye(3), np.ones((columns, columns)))
    noise, whole = np.diag(np.repeat(rows.noises, columns)), dense_covariance(found)
    flat = np.moveaxis(rows.frames, 1, 0).reshape(2, -1)
    squares = [
        np.sum(flat * np.linalg.solve(one + levels, flat.T).T, axis=1) for one in (noise, whole)
    ]
    np.testing.assert_allclose(found.gains[0], (squares[0] - squares[1]) / 2, rtol=1e-4)
    lifted = rows._replace(frames=rows.frames + np.array([0.3, -0.1, 0.05])[:, None, None])
    again = lifted.level(at).likeliest(at, 1e-6).gains
    np.testing.assert_allclose(again, found.gains, rtol=1e-5)


@pytest.mark.parametrize("gains", [[1.25, 0.8], [0.85, 1.2, 0.75, 1.1, 1.05]])
def test_gains_of_frames_are_told_by_their_detail(gains):
    """Over their mean, whatever the black levels are; frames that differ by them fit."""
    frames, gains = stills(len(gains)), np.array(gains)
    captures, _ = shown(1300.0, frames, rows=slice(120, 132), num_columns=240)
    changed = np.asarray(captures) * gains[:, None, None] + 0.03 * gains[::-1, None, None]
    at = np.array([1300.0])
    found = 1 + rows_about(changed, SCENE, frames).level(at[None]).fit(at).gains
    np.testing.assert_allclose(found / np.mean(found), gains / np.mean(gains), rtol=0.03)
    estimate = restore_frames(changed, SCENE, frames).estimate
    assert estimate.trusted
    assert estimate.misfit == pytest.approx(1, abs=0.15)


def test_what_shows_nothing_is_doubted():
    """A flat picture, whose frames are noise, and one that is faster than anything expected."""
    frames = stills(3)
    flat = simulate_frames(np.full((12, 300), 0.3), SCENE, frames, speed=0.0, key=jax.random.key(5))
    estimate = restore_frames(flat, SCENE, frames).estimate
    assert estimate is not None
    assert not estimate.trusted
    assert estimate.doubt
    slow = Scene.uniform(max_speed=300.0, photon_rate=1e5, read_noise=8)
    captures, _ = shown(900.0, frames)
    estimate = restore_frames(captures, slow, frames).estimate
    assert estimate is not None
    assert not estimate.trusted
    assert estimate.doubt


def test_more_frames_and_moving_ones_are_better():
    """On a photograph with real borders, by the speed that is found."""
    errors = {}
    for name, frames in (("2", stills(2)), ("4", stills(4)), ("4 moving", swings(4))):
        captures, truth = shown(3300.0, frames)
        errors[name] = squared_error(restore_frames(captures, SCENE, frames).light, truth)
    assert errors["4 moving"] < 10**-0.1 * errors["4"]
    assert errors["4"] < 10**-0.05 * errors["2"]


@pytest.mark.parametrize("speeds", [[0.0], [640.0], [639.9, 640.1]])
def test_a_scene_of_one_speed_or_nearly_one(speeds):
    """Has no other to choose from, and the speed is in its range."""
    frames = stills(2)
    captures, _ = shown(speeds[0], frames, rows=slice(120, 124))
    one = Scene(speeds, photon_rate=1e5, read_noise=8)
    estimate = restore_frames(captures, one, frames).estimate
    assert estimate is not None
    assert estimate.speed == pytest.approx(speeds[0], abs=30)
    assert np.isfinite(estimate.weights).all()


@pytest.mark.parametrize("count", [2, 4])
def test_any_number_of_colours_tells_the_speed(count):
    """Those of a picture that is not red, green and blue count equally."""
    captures, _ = shown(1450.0, stills(2), rows=slice(120, 136))
    colours = np.stack([np.asarray(captures) * (1 - 0.1 * k) for k in range(count)], axis=-1)
    found = restore_frames(colours, SCENE, stills(2))
    assert found.light.shape == colours.shape[1:]
    assert found.estimate is not None
    assert found.estimate.speed == pytest.approx(1450.0, abs=20)


@pytest.mark.parametrize("light", [0.0, 0.4])
def test_pictures_without_noise_or_light(light):
    """Black ones, and flat ones of a sensor that reads without noise, are restored as they are."""
    quiet = Scene.uniform(max_speed=900.0, photon_rate=1e5, read_noise=0)
    found = restore_frames(np.full((2, 3, 90), light), quiet, stills(2))
    np.testing.assert_allclose(found.light, light, atol=1e-6)
    assert found.estimate is not None
    assert not found.estimate.trusted


@pytest.mark.slow
def test_a_decoder_with_a_prior_restores_frames_better():
    """Any decoder takes complete frames for one capture."""
    captures, truth = shown(3300.0, swings(4))
    linear, edges = (
        restore_frames(captures, SCENE, swings(4), decoder=decoder, speed=3300.0).light
        for decoder in (EnsembleDecoder(), TotalVariationDecoder())
    )
    assert squared_error(edges, truth) < 10**-0.1 * squared_error(linear, truth)


def test_one_frame_is_a_single_capture():
    """Restored as by the road of single captures, to the continuation of its ends."""
    still = StillCamera(half_exposure=1e-3)
    told = Scene([1700.0], photon_rate=1e5, read_noise=8)
    picture = np.asarray(example_picture().light)[120:140, :400, 1]
    capture = simulate_capture(
        picture, told, still, RectShutter(), speed=1700.0, key=jax.random.key(1)
    )
    alone = deconvolve(capture, told, still, RectShutter())
    found = restore_frames(capture[None], told, [TimedFrame(still, 0.0)], speed=1700.0)
    assert found.estimate is None
    assert np.sqrt(squared_error(found.light, np.asarray(alone))) < 2e-3


def test_a_picture_that_moves_along_its_columns():
    """Is restored as that of exchanged rows and columns, and keeps its channels."""
    captures, _ = shown(-1200.0, stills(3), rows=slice(120, 136))
    down = Scene.uniform(
        max_speed=4500.0, photon_rate=1e5, read_noise=8, sensor=Sensor(axis="columns")
    )
    along = restore_frames(captures, SCENE, stills(3), speed=-1200.0).light
    turned = np.swapaxes(np.asarray(captures), 1, 2)[..., None]
    found = restore_frames(turned, down, stills(3), speed=-1200.0).light
    np.testing.assert_allclose(np.asarray(found)[..., 0].T, along, atol=1e-12)


@pytest.mark.parametrize(
    ("captures", "scene", "line"),
    [
        (np.ones((2, 4, 30)), SCENE, "captures=...)` must be 3 frames, of rows and columns"),
        (np.ones((3, 30)), SCENE, "captures=...)` must be 3 frames, of rows and columns"),
        (np.full((3, 4, 30), np.inf), SCENE, "captures=...)` must be finite"),
        (
            np.ones((3, 4, 30)),
            SCENE.with_occlusion(Occlusion(front_share=0.4, background="moving")),
            "must move as a whole for restore_frames",
        ),
        (
            np.ones((3, 4, 30)),
            Scene([5.0], photon_rate=0.0, read_noise=8),
            "must have a photon rate above 0 e-/s",
        ),
    ],
)
def test_what_cannot_be_restored(captures, scene, line):
    """Is refused in one line."""
    with pytest.raises(ValueError, match=re.escape(line)):
        restore_frames(captures, scene, stills(3))


def spoilt(name, speed=1234.0):
    """Frames of rows of a photograph that are no burst of one picture at one speed."""
    picture = np.asarray(example_picture().light)[204:, :, 1]
    frames = swings(4) if name in SPOILT_PATHS else stills(4)

    def take(some, speed=speed, start=0, seed=2):
        return np.array(
            simulate_frames(
                picture[start : start + 12],
                SCENE,
                some,
                speed=speed,
                num_columns=240,
                key=jax.random.key(seed),
            )
        )

    if name in SPOILT_ORDERS:
        taken = stills(5) if name == "lost" else frames
        captures = take(taken)[SPOILT_ORDERS[name]]
    elif name == "two objects":
        captures = np.concatenate([take(frames, 0.0)[:, :6], take(frames, seed=3)[:, 6:]], axis=1)
    elif name == "down":
        captures = np.concatenate(
            [take([one], 0.0, 4 * k, k) for k, one in enumerate(frames)], axis=0
        )
    elif name == "stage stood still":
        captures = take(
            [TimedFrame(StillCamera(half_exposure=EXPOSURE / 2), f.time) for f in frames]
        )
    elif name == "stroke":
        longer = [
            TimedFrame(
                FreeMotion(
                    accelerations=[1.1 * float(one.motion.accelerations[0])],
                    half_exposure=EXPOSURE / 2,
                ),
                one.time,
                1.1 * one.position,
            )
            for one in frames
        ]
        captures = take(longer)
    elif name == "narrow":
        captures = take(frames)[..., :17]
    else:
        captures = take(frames)
        captures[2] = {"black": 0.0, "saturated": 1.0}[name]
    return captures, frames


SPOILT_PATHS = ("repeated while moving", "two objects", "down", "stage stood still", "stroke")
SPOILT_ORDERS = {
    "repeated": [0, 0, 1, 2],
    "repeated while moving": [0, 1, 2, 2],
    "lost": [0, 1, 3, 4],
    "exchanged": [1, 0, 2, 3],
}


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("repeated", "rames 1 and 2 are the same"),
        ("repeated while moving", "rames 3 and 4 are the same"),
        ("lost", "a lost or repeated frame"),
        ("exchanged", "their order"),
        ("two objects", "two objects"),
        ("down", "motion across the axis"),
        ("stage stood still", "another design"),
        ("stroke", "another design"),
        ("narrow", "The picture has too little detail to show its speed."),
        ("black", "Frame 3 of 4 is black."),
        ("saturated", "Frame 3 of 4 is saturated."),
    ],
)
def test_frames_that_do_not_fit_are_doubted(name, reason):
    """With a word on why: one speed may lead all others and explain none of what is seen."""
    captures, frames = spoilt(name)
    estimate = restore_frames(captures, SCENE, frames).estimate
    assert estimate is not None
    assert not estimate.trusted
    assert reason in estimate.doubt
    assert estimate.misfit > 0


@pytest.mark.parametrize(("read", "told"), [(32.0, 8.0), (32.0, 2.0), (80.0, 8.0)])
def test_noise_tells_no_speed(read, told):
    """Neither unrelated frames of it, nor a flat picture with more of it than is told."""
    random, frames = np.random.default_rng(3), stills(3, exposure=4e-3)
    scene = Scene.uniform(max_speed=2000.0, photon_rate=1e5, read_noise=told)
    flat = random.poisson(120, (3, 12, 160)) / 400 + random.normal(size=(3, 12, 160)) * read / 400
    for captures in (flat, random.uniform(0, 0.6, (3, 12, 160))):
        estimate = restore_frames(captures, scene, frames).estimate
        assert not estimate.trusted
        assert "more noise than the scene says" in estimate.doubt


@pytest.mark.parametrize(("detail", "words"), [(0.0, "Frame 2 of 3 is black."), (0.004, "")])
def test_a_frame_of_a_dark_part_is_not_black(detail, words):
    """Its pixels follow one another, where those of a frame without light are noise."""
    random, place = np.random.default_rng(6), np.arange(220)
    frames = random.normal(0.3, 0.02, (3, 5, 220))
    frames[1] = random.normal(0.006, 0.001, (5, 220)) + detail * np.sin(place / 9)
    assert odd_frame(frames, np.full(3, 1e-4)) == words


def test_pictures_one_period_on_are_rivals():
    """Frames of a regular pattern fit several speeds, of which none is trusted."""
    place = np.arange(560)
    square = np.broadcast_to(0.5 + 0.4 * np.sign(np.sin(2 * np.pi * (place + 0.5) / 16)), (8, 560))
    captures = simulate_frames(
        square, SCENE, stills(4), speed=2500.0, num_columns=240, key=jax.random.key(1)
    )
    estimate = restore_frames(captures, SCENE, stills(4)).estimate
    assert not estimate.trusted
    assert re.search(r"fit -?[\d,]+ px/s as well, as those of a regular pattern", estimate.doubt)
    other = estimate.speeds[np.argsort(-estimate.weights)[1]]
    periods = (other - estimate.speed) * PERIOD / 16
    assert periods == pytest.approx(round(periods), abs=0.03)


@pytest.mark.parametrize("moves", [False, True], ids=["still", "moving"])
@pytest.mark.parametrize("besides", ["gain", "black level", "fixed pattern", "eight bits"])
def test_what_cameras_do_besides_is_no_misfit(besides, moves):
    """Frames whose gain or black level changes, with a pattern that stays, or of few levels."""
    frames = swings(4) if moves else stills(4)
    captures, _ = shown(1870.0, frames, rows=slice(120, 132), num_columns=240)
    captures, signs = np.array(captures), np.array([1.0, -1, 1, -1])[:, None, None]
    if besides == "gain":
        captures *= 1 + 0.2 * signs
    elif besides == "black level":
        captures += 0.02 * signs
    elif besides == "fixed pattern":
        captures += 0.01 * np.random.default_rng(5).standard_normal(captures.shape[1:])
    else:
        captures = (np.rint(40 * np.clip(captures, 0, 1) ** (1 / 2.2)) / 40) ** 2.2
    estimate = restore_frames(captures, SCENE, frames).estimate
    assert estimate.trusted
    assert estimate.doubt == ""
    assert abs(estimate.speed - 1870.0) * PERIOD < 0.25


def test_frames_that_are_turned_are_said_to_be():
    """Their picture moves along the other axis, which the doubt names with its speed."""
    captures, _ = shown(1234.0, stills(4), rows=slice(120, 160), num_columns=240)
    turned = np.swapaxes(np.asarray(captures), 1, 2)
    estimate = restore_frames(turned, SCENE, stills(4)).estimate
    assert not estimate.trusted
    assert re.search(r"moves along its columns, at 1,23\d px/s", estimate.doubt)


def test_the_misfit_is_one_where_frames_fit():
    """With the picture's own freedom counted, from two frames as from five."""
    for count in (2, 5):
        captures, _ = shown(1750.0, stills(count), rows=slice(120, 136), num_columns=300)
        estimate = restore_frames(captures, SCENE, stills(count)).estimate
        assert estimate.misfit == pytest.approx(1, abs=0.1)


def test_colours_have_less_noise_together():
    """The misfit is over the noise of the luminance, of which each colour has a share."""
    picture = np.asarray(example_picture().light)[120:132, :500]
    captures = simulate_frames(
        picture, SCENE, stills(4), speed=1450.0, num_columns=240, key=jax.random.key(4)
    )
    estimate = restore_frames(captures, SCENE, stills(4)).estimate
    assert estimate.misfit == pytest.approx(1, abs=0.15)


def test_speeds_that_are_tried_are_bounded():
    """A speed beyond any sensor, and a range of speeds that no frames can tell apart."""
    captures = np.full((2, 4, 90), 0.4)
    line = r"`restore_frames\(speed=...\)` must displace light by at most 8192 px; got"
    with pytest.raises(ValueError, match=line):
        restore_frames(captures, SCENE, stills(2), speed=1e9)
    fast = Scene.uniform(max_speed=2e5, photon_rate=1e5, read_noise=8)
    with pytest.raises(ValueError, match=r"`restore_frames\(scene=...\)` must have speeds within"):
        restore_frames(captures, fast, stills(2))


def test_what_is_wrong_with_captures_is_said():
    """The first NaN and its place, a tracer, and frames of unlike colours."""
    captures = np.full((3, 4, 90), 0.4)
    captures[1, 2, 7] = np.nan
    with pytest.raises(ValueError, match=r"must be finite; got nan at \[1, 2, 7\]"):
        restore_frames(captures, SCENE, stills(3))
    with pytest.raises(ValueError, match=r"captures=...\)` must hold concrete numbers"):
        jax.jit(lambda x: restore_frames(x, SCENE, stills(3)).light)(np.full((3, 4, 90), 0.4))
    frames = [np.ones((4, 90)), np.ones((4, 90, 3)), np.ones((4, 90))]
    with pytest.raises(ValueError, match="must be frames of one size and as many colours"):
        restore_frames(frames, SCENE, stills(3))


def test_a_speed_that_is_told_is_judged():
    """As one that is found: another speed, exchanged axes and exchanged frames do not fit."""
    frames = stills(4)
    picture = example_picture().luminance[150:190, 100:280]
    key = jax.random.key(0)
    captures = np.asarray(simulate_frames(picture, SCENE, frames, speed=1234.0, key=key))
    told = restore_frames(captures, SCENE, frames, speed=1234.0).estimate
    assert (told.speed, told.error, told.trusted, told.doubt) == (1234.0, 0.0, True, "")
    assert told.misfit == pytest.approx(1, abs=0.15)
    off = 1.5 / (frames[-1].time - frames[0].time)
    reasons = {
        "px off its place: another speed, their order": (captures, 1234.0 + off),
        "moves along its columns, at 1,234 px/s": (np.swapaxes(captures, 1, 2), 1234.0),
        "The frames do not fit one picture at one speed": (captures[[0, 2, 1, 3]], 1234.0),
    }
    for reason, (light, speed) in reasons.items():
        estimate = restore_frames(light, SCENE, frames, speed=speed).estimate
        assert not estimate.trusted
        assert reason in estimate.doubt


@pytest.mark.parametrize("speed", [np.nan, np.inf])
def test_a_speed_that_is_told_is_finite(speed):
    """No canvas holds a picture that is displaced without bound."""
    captures = np.full((3, 4, 90), 0.4)
    with pytest.raises(ValueError, match=r"`restore_frames\(speed=...\)` must be finite; got"):
        restore_frames(captures, SCENE, stills(3), speed=speed)


@pytest.mark.parametrize("shape", [(3,), (2, 2)])
def test_a_burst_is_refused_before_it_is_captured(shape):
    """Numbers that are no key are named at once, as of one exposure."""
    sequence, news = Exposures("stills", tuple(stills(3)), 0.0, 30.0, 29.0), []
    with pytest.raises(ValueError, match=r"`capture_and_restore\(key=...\)` must be one key"):
        capture_and_restore(
            np.full((3, 90), 0.4),
            SCENE,
            sequence,
            key=jax.numpy.full(shape, 0.4),
            progress=lambda text, share: news.append(text),
        )
    assert not news
