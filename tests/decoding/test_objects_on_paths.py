"""Things before a background, from frames of a sensor that moves, and of one that rolls."""

import jax
import numpy as np
import pytest
from support.moving_things import Thing, decibels, frames_of, shown, texture

import mishutter as ms
from mishutter.decoding.objects.readout import Readout
from mishutter.decoding.rolling import RowTimes
from mishutter.pictures.images import Picture

RATE, READ_NOISE, FASTEST, PERIOD = 1e5, 8.0, 900.0, 0.02
TIMES = PERIOD * (np.arange(4) - 1.5)
ROWS, COLUMNS = 60, 112
SPEED, PLACE, RADIUS = 640.0, (29.0, 50.0), 15.0


def sweep(half=PERIOD / 2):
    """Two frames at rest, and two on one sweep, which begins at their place."""
    rate = 65e3
    middle = float(TIMES[2:].mean())
    still = ms.StillCamera(half_exposure=half)
    frames = [ms.TimedFrame(still, float(time)) for time in TIMES[:2]]
    for time in TIMES[2:].tolist():
        late = time - middle
        motion = ms.FreeMotion(accelerations=[rate], half_exposure=half, velocity=rate * late)
        frames.append(ms.TimedFrame(motion, time, rate * (late**2 / 2 - 2 * half**2)))
    return frames


def layers():
    """A disc before a background, at its place in the middle of the frames."""
    ground = texture(np.random.default_rng(5), COLUMNS)[:ROWS]
    size = 2 * int(RADIUS) + 3
    down, across = np.mgrid[:size, :size] - (size - 1) / 2
    matte = np.clip(0.5 + RADIUS - np.hypot(down, across), 0, 1)
    light = texture(np.random.default_rng(7), 96, 0.45)[:size, :size]
    top, left = (round(at - (size - 1) / 2) for at in PLACE)
    thing = ms.Layer(Picture(light[..., None], matte), SPEED, left=left, top=top)
    truth, labels = ground.copy(), np.zeros(ground.shape, int)
    part = np.s_[top : top + size, left : left + size]
    truth[part] += matte * (light - truth[part])
    labels[part] = matte > 0.5
    return ms.Layers((ms.Layer(Picture(ground[..., None])), thing)), truth, labels


SCENE = ms.Scene.uniform(
    max_speed=FASTEST,
    photon_rate=RATE,
    read_noise=READ_NOISE,
    occlusion=ms.Occlusion(front_share=0.2, object_width=30.0),
)


def test_frames_of_a_sensor_that_moves_restore_what_they_hide_and_blur():
    """Told all, each layer is restored through its own blur: far better than from the stills.

    The stills are as long as the frames that move, and blur the disc over 13 px.
    """
    scenes, truth, labels = layers()
    frames = sweep()
    taken = np.asarray(ms.simulate_frames(scenes, SCENE, frames, key=jax.random.key(1)))[..., 0]
    known = {"speed": [SPEED], "outlines": labels}
    found = ms.restore_frames(taken, SCENE, frames, **known)
    stills = ms.restore_frames(taken[:2], SCENE, frames[:2], **known)
    inner, disc = np.s_[:, 16:-16], labels > 0
    levels = [decibels(np.asarray(one.light)[inner], truth[inner]) for one in (found, stills)]
    own = [decibels(np.asarray(one.light)[disc], truth[disc]) for one in (found, stills)]
    assert levels[0] > 35
    assert levels[0] > levels[1] + 1
    assert own[0] > own[1] + 2
    assert found.objects[0].speed == SPEED
    assert found.objects[0].place == pytest.approx(PLACE, abs=0.1)


def test_things_are_found_in_the_frames_at_rest_among_others():
    """And if there is one alone, a line says what is to be given."""
    scenes, truth, _ = layers()
    frames = sweep()
    taken = np.asarray(ms.simulate_frames(scenes, SCENE, frames, key=jax.random.key(2)))[..., 0]
    found = ms.restore_frames(taken, SCENE, frames)
    (own,) = found.objects
    assert own.speed == pytest.approx(SPEED, abs=40)
    assert own.place == pytest.approx(PLACE, abs=1.5)
    assert decibels(found.light, truth) > decibels(taken[1], truth) + 8
    text = "must be of a sensor at rest twice, or `speed` and `outlines` be given"
    with pytest.raises(ValueError, match=text):
        ms.restore_frames(taken[1:], SCENE, frames[1:])


@pytest.mark.parametrize("is_along", [False, True])
def test_velocities_and_places_behind_a_rolling_shutter(is_along):
    """A point is where rows see it when they are exposed, and back at the time 0."""
    delays, velocity = np.linspace(-0.01, 0.01, 41), np.array([310.0, -420.0])
    readout = Readout.of(RowTimes(delays, is_along), "columns" if is_along else "rows")
    axis, line = int(is_along), 0.02 / 40
    start = np.array([13.7, 26.2])
    moments = np.array([-0.03, 0.005, 0.02])
    places = []
    for moment in moments:
        place = start
        for _ in range(60):  # to where it is when the row of its place is exposed
            place = start + velocity * (moment + line * (place[axis] - 20))
        places.append(place)
    seen = readout.seen(velocity)
    steps = np.diff(np.array(places), axis=0) / np.diff(moments)[:, None]
    np.testing.assert_allclose(steps, np.broadcast_to(seen, steps.shape), rtol=1e-9)
    np.testing.assert_allclose(readout.true(seen), velocity, rtol=1e-12)
    # The covariance goes with the derivative of the velocity.
    steps = np.stack([readout.true(seen + x) - readout.true(seen - x) for x in 0.1 * np.eye(2)])
    slope, spread = steps.T / 0.2, np.array([[2.0, 0.3], [0.3, 1.0]])
    wanted = slope @ spread @ slope.T
    np.testing.assert_allclose(readout.covariance(seen, spread), wanted, rtol=1e-6)
    # A smooth picture as frames show it, at the places of a middle frame.
    down, across = np.mgrid[:41, :44].astype(float)

    def light(y, x):
        return np.cos(0.11 * y + 0.2) * np.sin(0.09 * x)

    late = line * ((across if is_along else down) - 20)
    shown = light(down - velocity[0] * late, across - velocity[1] * late)
    right = readout.set_right(shown, seen, 3)
    inner = np.s_[10:-10, 10:-10]
    np.testing.assert_allclose(right[inner], light(down, across)[inner], atol=2e-4)


@pytest.mark.parametrize(("rows_read", "axis"), [("down", "rows"), ("up", "columns")])
def test_a_rolling_shutter_shears_no_restored_thing(rows_read, axis):
    """The velocity and the picture are those of one time, whatever the axis in the plane."""
    sensor = ms.Sensor(readout=0.016, rows_read=rows_read, axis=axis)
    objects, others = ms.Objects(width=40.0), {"photon_rate": RATE, "read_noise": READ_NOISE}
    scene = ms.Scene.any_direction(FASTEST, **others, sensor=sensor, objects=objects)
    ground = texture(np.random.default_rng(5), 88)
    thing = Thing(texture(np.random.default_rng(7), 96, 0.45), (42.3, 45.1), 19.0, (420.0, -300.0))
    exposures, random = np.full(4, 0.004), np.random.default_rng(3)
    delays = sensor.row_delays(88)
    frames = frames_of(ground, [thing], TIMES, exposures, random, delays=tuple(delays))
    path = ms.PlaneFrames(
        times=TIMES - TIMES[0] + 0.002,
        exposures=exposures,
        durations=np.array([TIMES[-1] - TIMES[0] + 0.004]),
        velocities=np.zeros((2, 2)),
    )
    truth, (matte,) = shown(ground, [thing], 0.0)
    found = ms.restore_frames(frames, scene, path)
    (own,) = found.objects
    # To the left and up, as speeds of the package are.
    apart = own.velocity - np.array([300.0, -420.0])
    assert apart @ np.linalg.solve(own.covariance, apart) < 3**2 * 2
    assert decibels(found.light, truth) > 33
    assert np.mean((found.labels == 1) != (matte > 0.5)) < 0.01
    error = np.abs(np.asarray(found.light) - truth)[found.trust]
    noise = np.sqrt(0.35 / (RATE * 0.004) + (READ_NOISE / (RATE * 0.004)) ** 2)
    assert np.mean(error > 3 * noise) < 0.01
