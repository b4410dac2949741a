"""Captures of sensors whose rows are exposed one after another."""

import numpy as np
import pytest
from support.rolling import PERIOD, frames_on_parabolas

from mishutter import (
    HannShutter,
    Layer,
    Layers,
    Picture,
    PlaneFrames,
    RectShutter,
    Scene,
    Sensor,
    StillCamera,
    TimedFrame,
    example_picture,
    simulate_capture,
    simulate_frames,
)
from mishutter.camera.rows import bands_of
from mishutter.model.exposures import path_for_rows

LIGHT = {"photon_rate": 1e5, "read_noise": 8.0}
READOUT, SPEED = 0.018, 700.0
SHAPE = 24, 256
WITHIN = 1e-3
"""Error of bands of rows; white = 1."""


def picture(shape=SHAPE, axis=None):
    """Light of few frequencies, of one axis where the other would be blurred by the pixels."""
    down, across = np.meshgrid(*map(np.arange, shape), indexing="ij")
    down, across = (0 * x if axis not in (None, k) else x for k, x in enumerate((down, across)))
    waves = np.cos(0.21 * across + 0.13 * down) + np.cos(0.07 * across - 0.3 * down + 1)
    return 0.4 + 0.12 * waves


def scene_of(sensor, plane=False):
    """A scene of a sensor."""
    return (
        Scene.any_direction(900.0, **LIGHT, sensor=sensor)
        if plane
        else Scene([SPEED], **LIGHT, sensor=sensor)
    )


def in_plane(scene, axis):
    """The path of the frames on parabolas, along rows or columns of the plane."""
    path = path_for_rows(scene, frames_on_parabolas())
    knots = path.bends
    inner = (knots > -2 * PERIOD + 1e-6) & (knots < 2 * PERIOD - 1e-6)
    times = np.concatenate([[-2 * PERIOD], knots[inner], [2 * PERIOD]])
    velocities = np.zeros((2, times.size))
    velocities[axis] = np.interp(times, knots, path.velocities[0])
    return PlaneFrames(path.times, path.exposures, np.diff(times), velocities)


def test_each_row_is_that_of_a_global_shutter_later():
    """A row of a sensor at rest sees the picture where it has moved meanwhile."""
    frames = frames_on_parabolas()
    rolling = scene_of(Sensor(readout=READOUT))
    taken = np.asarray(simulate_frames(picture(), rolling, frames, speed=SPEED))
    path = path_for_rows(rolling, frames)
    delays, middle = rolling.sensor.row_delays(SHAPE[0]), float(path.place(np.zeros(1))[0, 0])
    x, weight = np.polynomial.legendre.leggauss(200)
    column = np.arange(120, 136)
    for row in (0, 7, 23):
        for k in range(4):
            time = (k - 1.5) * PERIOD + delays[row] + x * PERIOD / 2
            way = path.place(time)[0] - middle - SPEED * time
            at = column[:, None] - way
            waves = np.cos(0.21 * at + 0.13 * row) * np.sinc(0.21 / 2 / np.pi)
            waves = waves + np.cos(0.07 * at - 0.3 * row + 1) * np.sinc(0.07 / 2 / np.pi)
            wanted = 0.4 + 0.12 * waves @ (weight / 2)
            np.testing.assert_allclose(taken[k, row, column], wanted, atol=4e-3)


@pytest.mark.parametrize("rows_read", ["down", "up"])
def test_along_the_rows_and_in_the_plane_are_one(rows_read):
    """Rows by themselves agree with the bands of frames in the plane."""
    sensor = Sensor(readout=READOUT, rows_read=rows_read)
    along = scene_of(sensor)
    taken = simulate_frames(picture(axis=1), along, frames_on_parabolas(), speed=SPEED)
    frames = in_plane(along, axis=0)
    plane = simulate_frames(picture(axis=1), scene_of(sensor, True), frames, speed=(SPEED, 0.0))
    np.testing.assert_allclose(plane, taken, atol=WITHIN)


def test_along_the_columns_and_in_the_plane_are_one():
    """Along the readout each pixel of the motion has its own time."""
    sensor, shape = Sensor(readout=READOUT, axis="columns"), (160, 20)
    along = scene_of(sensor)
    taken = simulate_frames(picture(shape, axis=0), along, frames_on_parabolas(), speed=SPEED)
    frames = in_plane(along, axis=1)
    rolling = scene_of(Sensor(readout=READOUT), True)
    plane = simulate_frames(picture(shape, axis=0), rolling, frames, speed=(0.0, SPEED))
    np.testing.assert_allclose(plane, taken, atol=WITHIN)


@pytest.mark.parametrize("axis", ["rows", "columns"])
def test_layers_are_taken_row_by_row(axis):
    """A background alone is the picture of the same rows."""
    shape = SHAPE if axis == "rows" else SHAPE[::-1]
    light = picture(shape).astype(np.float32)
    scene = scene_of(Sensor(readout=0.004, axis=axis))
    one = Layers((Layer(Picture(light[..., None]), SPEED),))
    taken = simulate_frames(one, scene, frames_on_parabolas())
    wanted = simulate_frames(light[..., None], scene, frames_on_parabolas(), speed=SPEED)
    np.testing.assert_allclose(taken, wanted, atol=WITHIN)


def test_a_band_is_exposed_when_its_rows_are_in_the_mean():
    """Seven rows of 1 ms in three bands of a twentieth of a pixel; rows may be read upwards."""
    for way, sign in (("down", 1), ("up", -1)):
        bands = bands_of(Sensor(readout=6e-3, rows_read=way), 7, 24.0)
        assert [(band.rows.start, band.rows.stop) for band in bands] == [(0, 2), (2, 5), (5, 7)]
        delays = [sign * 1e3 * band.delay for band in bands]
        np.testing.assert_allclose(delays, [-2.5, 0, 2.5], atol=1e-6)


@pytest.mark.parametrize("kind", ["picture", pytest.param("layers", marks=pytest.mark.slow)])
def test_rows_between_delays_are_those_by_themselves(kind, monkeypatch):
    """Of a photograph with a sharp edge, in exposures that blur it by 2 px; of layers too."""
    light = np.asarray(example_picture().light)[200:320, 300:380, 1:2].astype(np.float32)
    light[:, 40:] *= 0.2
    scene, velocity = scene_of(Sensor(readout=READOUT, rows_read="up"), True), (700.0, 500.0)
    still = PlaneFrames(np.zeros(1), np.full(1, 2e-3), np.full(1, 2e-3), np.zeros((2, 2)))
    subject, way = light, {"speed": velocity}
    if kind == "layers":
        thing = Layer(Picture(1 - light[30:90, 20:60]), velocity, left=10, top=30)
        subject, way = Layers((Layer(Picture(light), (0.0, 0.0)), thing)), {}
    few = simulate_frames(subject, scene, still, **way)
    monkeypatch.setattr("mishutter.camera.rows.PX_A_NODE", 1e-3)
    every = simulate_frames(subject, scene, still, **way)
    np.testing.assert_allclose(few, every, atol=WITHIN)
    assert np.max(np.abs(few - every)) > 0


def test_a_thing_in_front_is_on_its_own_rows():
    """Far from its ends they show its light, and the others that of the background."""
    light = picture().astype(np.float32)[..., None]
    thing = Layer(Picture((1 - light)[5:19, 40:216]), SPEED, left=40, top=5)
    scene, frames = scene_of(Sensor(readout=0.004)), frames_on_parabolas()[:1]
    taken = simulate_frames(Layers((Layer(Picture(light), SPEED), thing)), scene, frames)
    behind, own = (simulate_frames(x, scene, frames, speed=SPEED) for x in (light, 1 - light))
    middle = slice(110, 146)
    np.testing.assert_allclose(taken[:, 5:19, middle], own[:, 5:19, middle], atol=WITHIN)
    for rows in (slice(5), slice(19, None)):
        np.testing.assert_allclose(taken[:, rows], behind[:, rows], atol=WITHIN)


@pytest.mark.parametrize("axis", ["rows", "columns"])
def test_a_snapshot_is_sheared_or_stretched(axis):
    """One exposure at rest is the only still of a burst."""
    shape = SHAPE if axis == "rows" else SHAPE[::-1]
    scene, still = scene_of(Sensor(readout=0.01, axis=axis)), StillCamera(half_exposure=0.004)
    taken = simulate_capture(picture(shape), scene, still, RectShutter(), speed=SPEED)
    wanted = simulate_frames(picture(shape), scene, [TimedFrame(still, 0.0)], speed=SPEED)[0]
    np.testing.assert_allclose(taken, wanted, atol=1e-5)


def test_a_shaped_shutter_before_rows_that_are_read_in_turn_is_refused():
    """With its reason."""
    scene, still = scene_of(Sensor(readout=0.01)), StillCamera(half_exposure=0.004)
    with pytest.raises(ValueError, match=r"`simulate_capture\(shutter=...\)` must have an open"):
        simulate_capture(picture(), scene, still, HannShutter())
