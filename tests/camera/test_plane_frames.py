"""Frames of a sensor that moves in the plane, by closed forms and by the frames of one axis."""

import jax
import numpy as np
import pytest
from scipy.special import erf
from support.plane import frames_of as known_frames
from support.plane import scene_of

from mishutter import (
    Layer,
    Layers,
    ParabolicMotion,
    Picture,
    PlaneFrames,
    Scene,
    StillCamera,
    TimedFrame,
    example_picture,
    simulate_frames,
)
from mishutter.camera.plane_frames import exposed_in_plane
from mishutter.evaluation.instants import Instants

SCENE = scene_of("A")
LAYERS = Layers((Layer(Picture(np.ones((40, 50, 1)))),))


def test_one_axis_is_a_line_of_the_plane():
    """Rows that are all alike, on a parabola that pans, at a speed along them."""
    row = np.asarray(example_picture().light)[200, :400, 1]
    picture = np.tile(row, (9, 1))
    motion = ParabolicMotion(acceleration=9e4, half_exposure=9e-3, velocity=170.0)
    frames = [TimedFrame(motion, -0.011, -1.87), TimedFrame(motion, 0.011, 1.87)]
    scene = Scene([310.0], photon_rate=2e4, read_noise=3.0)
    wanted = simulate_frames(picture, scene, frames, speed=310.0, num_columns=200)
    # Between two parabolas the stage takes its mean velocity at once.
    ends = (170 + 2 * 9e4 * np.array([-9e-3, 9e-3])).tolist()
    along = np.array([*ends, 170.0, 170.0, *ends])
    plane = PlaneFrames(
        np.array([-0.011, 0.011]),
        np.full(2, 18e-3),
        np.array([18e-3, 0.0, 4e-3, 0.0, 18e-3]),
        np.stack([along, 0 * along]),
    )
    got = simulate_frames(picture, SCENE, plane, speed=(310.0, 0.0), num_columns=200, num_rows=5)
    assert got.shape == (2, 5, 200)
    np.testing.assert_allclose(got, np.asarray(wanted)[:, 2:7], atol=2e-5)
    # A frame at rest sees a picture that moves down the columns as one that is turned.
    still = [TimedFrame(StillCamera(half_exposure=9e-3), 0.0)]
    at_rest = PlaneFrames(np.zeros(1), np.full(1, 18e-3), np.full(1, 18e-3), np.zeros((2, 2)))
    down = simulate_frames(picture.T, SCENE, at_rest, speed=(0.0, 310.0), num_rows=200)
    across = simulate_frames(picture, scene, still, speed=310.0, num_columns=200)
    np.testing.assert_allclose(np.asarray(down)[0].T, np.asarray(across)[0], atol=2e-5)


def test_a_spot_is_where_the_path_and_its_velocity_put_it():
    """A Gaussian spot, by sums over instants of its exact integral over each pixel."""
    velocity, deviation = np.array([430.0, -290.0]), 2.4
    frames = known_frames("A", 4, "sines")
    rows, columns = np.arange(90) - 41.0, np.arange(110) - 57.0
    spot = np.exp(-(rows[:, None] ** 2 + columns**2) / (2 * deviation**2))
    got = np.asarray(simulate_frames(spot, SCENE, frames, speed=velocity))
    origin = np.asarray(frames.place(np.zeros(())))
    for frame, middle in zip(got, np.asarray(frames.times), strict=True):
        time = middle + 0.02 * ((np.arange(800) + 0.5) / 800 - 0.5)
        x, y = np.asarray(frames.place(time)) - origin[:, None] - velocity[:, None] * time
        ends = [
            erf((np.subtract.outer(np.append(at - 0.5, at[-1] + 0.5), place)) / deviation / 2**0.5)
            for at, place in ((rows, y), (columns, x))
        ]
        down, across = (np.diff(each, axis=0) * deviation * (np.pi / 2) ** 0.5 for each in ends)
        np.testing.assert_allclose(frame, down @ across.T / 800, atol=3e-5)


def test_light_enters_from_the_picture_beyond_the_sensor():
    """A sensor over the middle records what one over all of the picture has there.

    Of a large picture no more is looked at than reaches it, be it further down than along rows.
    """
    light = np.asarray(example_picture().light)[:300, :420]
    frames = known_frames("A", 2, "sines")
    velocity = (100.0, 4000.0)
    whole = np.asarray(simulate_frames(light, SCENE, frames, speed=velocity))
    part = simulate_frames(light, SCENE, frames, speed=velocity, num_rows=61, num_columns=80)
    assert part.shape == (2, 61, 80, 3)
    np.testing.assert_allclose(part, whole[:, 119:180, 170:250], atol=2e-3)
    drawn = simulate_frames(light, SCENE, frames, speed=velocity, key=jax.random.key(4))
    squares = np.mean((np.asarray(drawn) - whole) ** 2, axis=(1, 2, 3))
    electrons = 3e4 * 0.04
    wanted = whole.mean(axis=(1, 2, 3)) / electrons + (10 / electrons) ** 2
    np.testing.assert_allclose(squares, wanted, rtol=0.02)


def test_places_are_from_the_middle_of_the_frames_on_any_clock():
    """The same frames on a clock that began earlier; in single precision too."""
    frames = known_frames("A", 4, "sines")
    later = PlaneFrames(
        frames.times + 7.0, *(frames.exposures, frames.durations, frames.velocities)
    )
    for first, second in zip(Instants.of(frames, 900.0), Instants.of(later, 900.0), strict=True):
        np.testing.assert_allclose(first, second, atol=1e-9)
    arrays = frames.times, frames.exposures, frames.durations, frames.velocities
    single = PlaneFrames(*(np.asarray(x, np.float32) for x in arrays))
    picture = np.asarray(example_picture().light)[:80, :90, 1].astype(np.float32)
    pair = [
        next(exposed_in_plane(picture, SCENE, each, np.array([9.0, 40.0]), (None, None)))
        for each in (frames, single)
    ]
    assert pair[0].dtype == np.float32
    np.testing.assert_allclose(*pair, atol=1e-4)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"speed": 1500.0}, r"velocity along rows and columns, as \(1500, -800\).+got 1500"),
        ({"speed": (1.0, 2.0, 3.0)}, "velocity along rows and columns"),
        ({"speed": (np.nan, 0.0)}, "be finite"),
        ({"speed": (9e6, 0.0)}, "displace light by at most 8192 px"),
        ({"num_rows": 41}, r"num_rows=\.\.\.\)` must be at most the picture's 40 rows; got 41"),
        ({"num_columns": 0}, "num_columns"),
        ({"picture": LAYERS}, "be left to layers"),
        ({"picture": LAYERS, "speed": 0.0, "num_rows": 41}, "at most the picture's 40 rows"),
    ],
)
def test_frames_in_the_plane_are_refused(changed, message):
    """A velocity without a direction or beside layers, a sensor beyond the picture: a line each."""
    arguments = {"picture": np.full((40, 50), 0.3), "speed": (1.0, 0.0)} | changed
    with pytest.raises(ValueError, match=message):
        simulate_frames(arguments.pop("picture"), SCENE, known_frames("A", 2, "sines"), **arguments)


def test_frames_of_one_axis_take_no_velocity():
    """Nor a number of rows."""
    frames, scene = (
        [TimedFrame(StillCamera(half_exposure=1e-3), 0.0)],
        Scene([3.0], photon_rate=9, read_noise=1),
    )
    with pytest.raises(ValueError, match="be a scalar"):
        simulate_frames(np.ones((4, 9)), scene, frames, speed=(3.0, 4.0))
    with pytest.raises(ValueError, match="be left out along one axis"):
        simulate_frames(np.ones((4, 9)), scene, frames, num_rows=3)
