"""Frames of a sensor whose rows are exposed one after another, against a reference of its own."""

from dataclasses import replace
from functools import partial

import jax
import numpy as np
import pytest
from support.plane import frames_of

from mishutter import (
    EnsembleDecoder,
    Exposures,
    FreeMotion,
    Limits,
    ParabolicMotion,
    PlaneFrames,
    RectShutter,
    Scene,
    Sensor,
    StillCamera,
    TimedFrame,
    example_picture,
    restore,
    restore_frames,
    simulate_capture,
    simulate_frames,
)
from mishutter.decoding import frame_restoration
from mishutter.decoding.decoders.linear import mean_over_dft
from mishutter.decoding.frame_doubts import doubt_of_rows
from mishutter.decoding.frame_likelihood import Own, Prior
from mishutter.decoding.likeliest import _together, complete, noises_of
from mishutter.decoding.restoration import capture_and_restore, photograph_by_frames
from mishutter.decoding.rolling import RowTimes, _on_grid
from mishutter.design.design import given_design
from mishutter.model.exposures import path_for_rows
from mishutter.model.frame_path import SINE, frames_in

EXPOSURE, STROKE, SPEED = 0.02, 54.6, 2000.0
SCENE = Scene.uniform(max_speed=4500.0, photon_rate=1e5, read_noise=8)
PLANE = Scene.any_direction(2800.0, photon_rate=3e4, read_noise=10.0)
VELOCITY = np.array([1500.0, -800.0])


def alternating():
    """Four parabolas of alternating direction, one after the other."""
    a = STROKE / 2 / (EXPOSURE / 2) ** 2
    return [
        TimedFrame(
            FreeMotion(accelerations=[(-1) ** k * a], half_exposure=EXPOSURE / 2),
            (k - 1.5) * EXPOSURE,
            STROKE * (k % 2),
        )
        for k in range(4)
    ]


def design_of(scene, motion):
    """A camera with an open shutter, as far as `restore` asks."""
    return given_design(scene, motion, RectShutter(), "Given.")


def gaussian_captures(readout, rows=32, columns=1024):
    """Periodic rows of a Gaussian spectrum, and four noisy frames of each at its own time."""
    rng, f = np.random.default_rng(0), np.fft.fftfreq(columns)
    rows_of_light = np.fft.ifft(np.fft.fft(rng.normal(size=(rows, columns))) / (abs(f) + 0.01)).real
    light = np.clip(0.25 + 0.2 * rows_of_light / 20, 0, 1)
    x, weight = np.polynomial.legendre.leggauss(160)
    captures, white = np.empty((4, rows, columns)), 1e5 * EXPOSURE
    for y, k in np.ndindex(rows, 4):
        time = (k - 1.5) * EXPOSURE + (y / (rows - 1) - 0.5) * readout + x * EXPOSURE / 2
        number = np.floor(time / EXPOSURE)
        place = (time - (number + 0.5) * EXPOSURE) / (EXPOSURE / 2)
        way = np.where(number % 2 == 0, 1, -1) * STROKE / 2 * (place**2 - 1) - SPEED * time
        response = np.exp(-2j * np.pi * f[:, None] * way) @ (weight / 2) * np.sinc(f)
        clean = np.clip(np.fft.ifft(response * np.fft.fft(light[y])).real, 0, None)
        captures[k, y] = (rng.poisson(clean * white) + rng.normal(size=columns) * 8) / white
    return captures, light


def test_rows_in_turn_are_restored_as_one_capture_of_their_mean_power(monkeypatch):
    """Of responses of each frame over what its stage does while each row is exposed."""
    given = []

    def told(found, density):
        given.append(density)
        return complete(found, density)

    monkeypatch.setattr(frame_restoration, "complete", told)
    monkeypatch.setattr(frame_restoration, "restored_light", lambda capture, *_: capture)
    scene, rng = replace(SCENE, sensor=Sensor(readout=EXPOSURE)), np.random.default_rng(2)
    captures = rng.uniform(0.2, 0.3, (1, 4, 3, 120))
    times = RowTimes.of(scene.sensor, captures.shape)
    frame_restoration.restored_on_axis(
        captures, scene, alternating(), EnsembleDecoder(), SPEED, times=times
    )
    (density,) = given
    f = np.arange(len(density)) / (2 * len(density) - 2)
    x, weight = np.polynomial.legendre.leggauss(120)
    powers = []
    for delay in np.linspace(-EXPOSURE / 2, EXPOSURE / 2, 41):
        time = delay + x * EXPOSURE / 2  # of every frame but for its sign and place
        number = np.floor(time / EXPOSURE + 0.5)
        place = (time - number * EXPOSURE) / (EXPOSURE / 2)
        for sign in (-1, 1):
            way = sign * (-1) ** number * STROKE / 2 * (place**2 - 1) - SPEED * time
            powers.append(abs(np.exp(-2j * np.pi * f[:, None] * way) @ (weight / 2)) ** 2)
    noise = noises_of(scene, np.full(1, EXPOSURE), float(scene.picture.mean_level))
    wanted = 4 * np.mean(powers, axis=0) * np.sinc(f) ** 2 / noise
    assert np.sum(np.abs(density - wanted)) < 0.13 * np.sum(wanted)


@pytest.mark.parametrize("readout", [0.0, 0.02])
@pytest.mark.parametrize("late", [0.0, 0.003])
def test_a_picture_stands_where_its_frames_say(readout, late):
    """Whichever way the stage takes between them, and whenever they say that the middle is."""
    motion = ParabolicMotion(acceleration=1e5, half_exposure=0.0075, velocity=800.0)
    frames = [TimedFrame(motion, time + late, 120.0 * time) for time in (-0.0125, 0.0125)]
    limits, sensor = Limits(max_acceleration=1e6), Sensor(readout=readout)
    scene = Scene([1500.0], photon_rate=1e7, read_noise=2, limits=limits, sensor=sensor)
    _, (straight,) = frames_in(frames).middle
    path = path_for_rows(scene, frames)
    time, first = np.array([0.0, -0.0125 + late]), frames[0].position
    driven, begin = path.place(time)[0]
    assert abs(driven - begin - (straight - first)) > 1
    light = example_picture().light[200:216]
    captures = simulate_frames(light, scene, frames, speed=1500.0, num_columns=400)
    found = np.asarray(restore_frames(captures, scene, frames, speed=1500.0).light)
    start = (light.shape[1] - 400) // 2
    truth, steps = light[:, start : start + 400], np.gradient(light, axis=1)[:, start : start + 400]
    inner = slice(100, -100)
    off = np.sum((truth - found)[:, inner] * steps[:, inner]) / np.sum(steps[:, inner] ** 2)
    assert abs(off) < 0.05
    assert np.sqrt(np.mean((found - truth)[:, inner] ** 2)) < 0.01


def on_a_sine():
    """Three frames about the turning points of a sine, and a scene whose rows are read slowly."""
    half, period, height = 0.006, 0.02, 25.0
    ends, turn = np.linspace(-half, half, 41), np.pi / period
    rates = height * turn**2 * np.cos(turn * (ends[1:] + ends[:-1]) / 2) / 2
    motions = [FreeMotion(accelerations=sign * rates, half_exposure=half) for sign in (1, -1, 1)]
    frames = [TimedFrame(x, (k - 1) * period, k % 2 * 2 * height) for k, x in enumerate(motions)]
    limits, sensor = Limits(max_acceleration=2e6), Sensor(readout=0.015)
    scene = Scene([1500.0], photon_rate=1e7, read_noise=2, limits=limits, sensor=sensor)
    return scene, frames, Exposures(SINE, tuple(frames), 0.0, 0.0, 0.0)


def test_a_stage_on_a_sine_is_simulated_as_it_is_restored():
    """Rows that are exposed early and late see it on the sine in the gaps too."""
    scene, _, sequence = on_a_sine()
    light = example_picture().light[200:216]
    found = capture_and_restore(light, scene, sequence, speed=1500.0).found
    assert found.misfit < 1


def test_frames_are_on_their_sine_wherever_they_are_handed_on():
    """Apart from the exposures they have their path between frames; any others have a transfer."""
    scene, frames, sequence = on_a_sine()
    times = np.linspace(-0.02, 0.02, 81)
    of_all, own, others = (
        path_for_rows(scene, each).place(times) for each in (sequence, sequence.frames, frames)
    )
    np.testing.assert_array_equal(own, of_all)
    assert np.max(np.abs(others - of_all)) > 0.1


def test_the_frame_beside_a_restored_picture_stands_where_that_does():
    """Wherever a stage has its places from: here it is 30 px off, and things move 10 px."""
    still, scene = StillCamera(half_exposure=1e-4), Scene([1000.0], photon_rate=1e8, read_noise=2)
    frames = tuple(TimedFrame(still, time, 30.0) for time in (-0.01, 0.01))
    sequence, light = Exposures("stills", frames, 0.0, 0.0, 0.0), example_picture().light[200:216]
    shown = photograph_by_frames(light, scene, sequence, speeds=[1000.0], key=jax.random.key(0))
    apart = [shown.captured[0, :, 100:-100] - light[:, 100 + k : k - 100] for k in (-1, 0, 1)]
    assert np.argmin(np.std(apart, axis=(1, 2, 3))) == 1


def psnr(found, light):
    return -10 * np.log10(np.mean((np.asarray(found) - light)[:, 128:-128] ** 2))


@pytest.mark.parametrize(
    ("readout", "rows", "known", "untold"), [(0.005, 32, 31.9, 30.7), (0.02, 96, 31.29, 26.4)]
)
def test_rows_are_restored_by_kernels_of_their_own(readout, rows, known, untold):
    """The levels are those of a NumPy program with the same filter, of 96 rows.

    Few rows have a response each, and more are sums over a few delays.
    """
    captures, light = gaussian_captures(readout, rows)
    rolling = replace(SCENE, sensor=Sensor(readout=readout))
    told = restore_frames(captures, rolling, alternating(), speed=SPEED)
    assert psnr(told.light, light) == pytest.approx(known, abs=0.15)
    assert told.estimate.misfit == pytest.approx(1, abs=0.03)
    assert told.estimate.trusted
    taken_as_global = restore_frames(captures, SCENE, alternating(), speed=SPEED)
    assert psnr(taken_as_global.light, light) == pytest.approx(untold, abs=0.25)
    assert not taken_as_global.estimate.trusted
    assert "rolling shutter" in taken_as_global.estimate.doubt


def test_a_doubt_says_which_readout_fits():
    """And in which way rows are read."""
    captures, _ = gaussian_captures(0.005, rows=24)
    flipped = captures[:, ::-1]
    for frames, way in ((captures, "down"), (flipped, "up")):
        doubt = restore_frames(frames, SCENE, alternating(), speed=SPEED).estimate.doubt
        assert (
            f"A rolling shutter of about 5 ms from the first row to the last, read {way}" in doubt
        )


@pytest.mark.parametrize(
    ("readout", "said", "rows_read", "fits"),
    [
        (0.005, 0.01, "down", "about 5 ms from the first row to the last, read down"),
        (0.01, 0.005, "down", "about 10 ms from the first row to the last, read down"),
        (0.005, 0.005, "up", "about 5 ms from the first row to the last, read down"),
        (0.0, 0.005, "down", "A global shutter fits the frames better"),
    ],
)
def test_a_wrong_readout_is_in_doubt(readout, said, rows_read, fits):
    """Twice or half as long, of rows that are read the other way, or of a global shutter."""
    captures, _ = gaussian_captures(readout, rows=24)
    scene = replace(SCENE, sensor=Sensor(readout=said, rows_read=rows_read))
    estimate = restore_frames(captures, scene, alternating(), speed=SPEED).estimate
    assert not estimate.trusted
    assert fits in estimate.doubt


def test_a_long_readout_is_not_missed_by_a_short_one():
    """Which explains too little by itself; and none is named that explains little in the end."""
    misfits = {5: 2.6, 10: 2.1, 20: 1.0}

    def misfit_by(sensor, _, gain=1.0):
        if not sensor.is_rolling:
            return 2.9
        apart = misfits[round(sensor.readout_time * 1e3)] if sensor.rows_read == "up" else 3.0
        return 2.9 - gain * (2.9 - apart)

    doubt = doubt_of_rows(Sensor(), EXPOSURE, {1: 40_000}, misfit_by)
    assert doubt.startswith("A rolling shutter of about 20 ms")
    assert "read up" in doubt
    little = partial(misfit_by, gain=0.1)
    assert doubt_of_rows(Sensor(), EXPOSURE, {1: 40_000}, little) == ""


@pytest.mark.parametrize(("global_", "by_rows", "is_said"), [(1.3, 1.0, True), (1.3, 1.27, False)])
def test_a_readout_is_told_where_fine_detail_hides_it_in_binned_pixels(global_, by_rows, is_said):
    """These choose the readout, and are no evidence themselves: their noise is largely detail."""

    def misfit_by(sensor, size):
        if not sensor.is_rolling:
            return 0.5 if size == 2 else global_
        is_best = sensor.rows_read == "up" and sensor.readout_time == EXPOSURE / 4
        return (0.3 if is_best else 0.6) if size == 2 else by_rows

    doubt = doubt_of_rows(Sensor(), EXPOSURE, {2: 60_000, 1: 240_000}, misfit_by)
    assert ("about 5 ms" in doubt and "read up" in doubt and "not 1.3)" in doubt) == is_said
    assert bool(doubt) == is_said


def test_stills_that_are_read_along_the_motion_tell_the_speed():
    """Taken as those of a global shutter, they tell that divided by what a row's delay makes."""
    still = StillCamera(half_exposure=7e-4)
    frames = [TimedFrame(still, (k - 1.5) * EXPOSURE) for k in range(4)]
    scene = replace(SCENE, sensor=Sensor(axis="columns", readout=0.01))
    picture = np.asarray(example_picture().light)[:320, 100:116, 1]
    taken = {"num_columns": 192, "key": jax.random.key(2)}
    captures = simulate_frames(picture, scene, frames, speed=SPEED, **taken)
    found = restore_frames(captures, scene, frames).estimate
    assert abs(found.speed - SPEED) < 4 * found.error < 20
    as_global = replace(SCENE, sensor=Sensor(axis="columns"))
    untold = restore_frames(captures, as_global, frames).estimate.speed
    assert untold == pytest.approx(SPEED / (1 + SPEED * 0.01 / 191), rel=0.01)


@pytest.mark.parametrize("kind", ["still", "circle"])
def test_rows_of_the_plane_are_those_of_their_own_instants(kind):
    """To a share of the noise; and what a frame tells is the adjoint of what a picture leaves.

    All rows of frames at rest tell as much as the middle one, each frame over its own noise.
    """
    rng, frames = np.random.default_rng(0), frames_of("A", 4, kind)
    rolling = replace(PLANE, sensor=Sensor(readout=0.01, rows_read="up"))
    noises = noises_of(rolling, frames.exposures, 0.25) * np.array([1.0, 1.5, 0.7, 2.0])
    times = RowTimes.of(rolling.sensor, (60, 70), in_plane=True)
    own = Own(rng.normal(size=(4, 60, 70)), noises, frames, Prior(rolling), times)
    for size in (1, 2):
        level = own.level(VELOCITY[None], size)
        canvas, shape = level.canvas, level.canvas.shape
        response = level.responses(VELOCITY[None])[1]
        light = canvas.spectrum(rng.normal(size=shape)) * np.sqrt(canvas.power) * level.aperture
        seen, frame = response.seen(light[None])[0], rng.normal(size=canvas.sensor)
        told = mean_over_dft(np.real(response.told(frame)[0].conj() * light), *shape)
        assert float(told) == pytest.approx(np.sum(frame * seen), rel=1e-9)
        for row in (0, 11, len(seen) - 1):
            there = level.rows.paths.at(float(level.rows.paths.delays[row]))
            exact = level._replace(rows=None, instants=there).responses(VELOCITY[None])[1, 0]
            error = np.mean((canvas.seen(light * exact)[row] - seen[row]) ** 2)
            assert error < 0.03 * canvas.noises[1]
        # Waves of most power are found at once.
        responses = level.responses(VELOCITY[None])
        light = light[None] * (canvas.power >= np.sort(canvas.power, axis=None)[-20])
        told = canvas.gathered(responses, canvas.through(responses, light))
        again = _together(canvas, responses, 60)(told + light / canvas.power)
        np.testing.assert_allclose(again[light != 0], light[light != 0], rtol=0.02)
        if kind == "still":
            middle = level._replace(rows=None).responses(VELOCITY[None])[:, 0]
            told = np.tensordot(1 / canvas.noises, np.abs(middle) ** 2, 1)
            density = canvas.density(level.responses(VELOCITY[None]))[0]
            np.testing.assert_allclose(density, told, rtol=1e-6)


@pytest.mark.parametrize("size", [1, 2])
def test_three_rows_stand_for_all(size):
    """They lie within the rows, and the way to each is that of the path in pixels of the frames."""
    frames = frames_of("A", 4, "circle")
    rolling = replace(PLANE, sensor=Sensor(readout=0.01))
    times = RowTimes.of(rolling.sensor, (60, 70), in_plane=True)
    own = Own(np.zeros((4, 60, 70)), np.full(4, 0.1), frames, Prior(rolling), times)
    rows = own.level(VELOCITY[None], size).rows.paths
    middle, ends = rows.instants, (rows.delays[-1] - rows.delays[0]) / 2
    shares = [np.mean(each.time - middle.time) / ends for each in rows.some]
    np.testing.assert_allclose(shares, [-np.sqrt(0.6), 0, np.sqrt(0.6)], atol=1e-6)
    for each in rows.some:
        way = rows.path.place(each.time + rows.clock) - rows.path.place(middle.time + rows.clock)
        np.testing.assert_allclose(each.place - middle.place, way / size, atol=1e-4)


@pytest.mark.parametrize("grid", [(8, 10), (9, 6)])
def test_a_coarser_grid_has_the_mean_power(grid):
    """Of a density that falls along both axes, on a DFT of unequal sides."""
    down, across = np.fft.fftfreq(72)[:, None], np.fft.rfftfreq(60)
    wave, other = np.cos(2 * np.pi * down), np.cos(2 * np.pi * across)
    found = _on_grid(2 + wave + 0.5 * wave * other, grid)
    assert found.shape == (grid[0], grid[1] // 2 + 1)
    assert np.sum(found) == pytest.approx(2)
    assert np.sum(_on_grid(1 + other + 0 * wave, grid)) == pytest.approx(1)


def test_rows_are_timed_down_the_columns():
    """Of a picture of 48 rows of 80 pixels, be it turned or not."""
    along, across = (Sensor(readout=0.01, axis=axis) for axis in ("columns", "rows"))
    assert RowTimes.of(across, (4, 48, 80)).delays.size == 48
    assert RowTimes.of(along, (4, 80, 48)).delays.size == 48


def test_one_exposure_that_is_told_its_speed_is_restored_by_its_rows():
    """Its shear is taken out; without a speed it stays, and of a parabola nothing is restored."""
    scene = Scene.uniform(
        max_speed=900.0, photon_rate=1e6, read_noise=2, sensor=Sensor(readout=0.02)
    )
    picture = np.asarray(example_picture().light)[200:240, :, 1]
    still = StillCamera(half_exposure=5e-4)
    capture = simulate_capture(
        picture, scene, still, RectShutter(), speed=900.0, key=jax.random.key(1)
    )
    told, sheared = (
        np.asarray(restore(capture, design_of(each, still), speed=900.0))
        for each in (scene, replace(scene, sensor=Sensor()))
    )
    inner = slice(64, -64)
    error, other = (np.mean((each - picture)[:, inner] ** 2) for each in (told, sheared))
    assert error < 0.1 * other
    moving = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
    with pytest.raises(ValueError, match=r"restore\(design=...\).+no acceleration before rows"):
        restore(capture, design_of(scene, moving))


@pytest.mark.slow
def test_a_velocity_along_the_readout_is_found():
    """That of stills whose rows are read 50 us after one another."""
    times = (np.arange(3) - 1) * 0.012
    frames = PlaneFrames(times, np.full(3, 2.7e-3), np.array([0.0267]), np.zeros((2, 2)))
    plane = Scene.any_direction(1900.0, photon_rate=3e5, read_noise=10.0)
    scene = replace(plane, sensor=Sensor(readout=50e-6 * 63))
    picture = np.asarray(example_picture().light)[100:340, 200:460, 1].astype(np.float64)
    taken = {"num_rows": 64, "num_columns": 64, "key": jax.random.key(3)}
    captures = simulate_frames(picture, scene, frames, speed=VELOCITY, **taken)
    found = restore_frames(captures, scene, frames).estimate
    assert np.all(np.abs(found.velocity - VELOCITY) < 4 * found.error)
    untold = restore_frames(captures, plane, frames).estimate.velocity
    assert untold == pytest.approx(VELOCITY / (1 - 800 * 50e-6), rel=0.02)


def test_rows_of_moving_frames_tell_as_much_as_theirs_in_the_mean():
    """Of frames on a circle, whose responses change from row to row: the mean square of all."""
    frames = frames_of("A", 4, "circle")
    rolling = replace(PLANE, sensor=Sensor(readout=0.01))
    times = RowTimes.of(rolling.sensor, (60, 70), in_plane=True)
    noises = np.array([0.1, 0.15, 0.07, 0.2])
    own = Own(np.zeros((4, 60, 70)), noises, frames, Prior(rolling), times)
    level = own.level(VELOCITY[None])
    paths = level.rows.paths
    every = []
    for delay in paths.delays.tolist():
        one = level._replace(rows=None, instants=paths.at(delay))
        every.append(np.abs(one.responses(VELOCITY[None])[:, 0]) ** 2)
    wanted = np.tensordot(1 / noises, np.mean(every, axis=0), 1)
    found = level.canvas.density(level.responses(VELOCITY[None]))[0]
    worth = level.canvas.power
    assert np.sum(found * worth) == pytest.approx(np.sum(wanted * worth), rel=0.05)
    assert np.sum(found) == pytest.approx(np.sum(wanted), rel=0.15)
