"""Frames of a sequence, against single captures of a displaced picture."""

import inspect
import re

import jax
import numpy as np
import pytest

from mishutter import (
    ChippedShutter,
    Exposures,
    FreeMotion,
    HannShutter,
    Layer,
    Layers,
    ParabolicMotion,
    Picture,
    RectShutter,
    Scene,
    Sensor,
    StillCamera,
    TimedFrame,
    exposures_psnr,
    restore_frames,
    simulate_capture,
    simulate_frames,
)
from mishutter.evaluation.instants import Instants
from mishutter.model.exposures import open_frames

SCENE = Scene.uniform(max_speed=2600.0, photon_rate=7e4, read_noise=6)
RNG = np.random.default_rng(5)
PICTURE = np.clip(0.3 + 0.2 * RNG.standard_normal((6, 300)).cumsum(axis=1) / 8, 0, 1)
SPEED, A, HALF = -1730.0, 9e4, 7e-3
RESTING = StillCamera(half_exposure=2e-3)


def test_a_positive_speed_is_to_the_left():
    """In the frames of a sequence, and within one exposure of a shutter that opens late."""
    spot = np.exp(-((np.arange(200) - 100) ** 2) / 18)[None]
    still = StillCamera(half_exposure=2e-3)
    frames = [TimedFrame(still, time) for time in (-0.03, 0.03)]
    early, late = (int(np.argmax(one)) for one in simulate_frames(spot, SCENE, frames, speed=700.0))
    assert (early, late) == (121, 79)
    slow, late_light = StillCamera(half_exposure=0.03), ChippedShutter(np.r_[np.zeros(9), 1.0])
    capture = simulate_capture(spot, SCENE, slow, late_light, speed=700.0)
    assert int(np.argmax(capture)) == 81


@pytest.mark.parametrize("time", [-0.021, 0.0, 0.034])
def test_a_frame_at_rest_is_a_capture_of_the_displaced_picture(time):
    """By the way of the picture since the middle of the sequence."""
    still = StillCamera(half_exposure=2e-3)
    (found,) = simulate_frames(PICTURE, SCENE, [TimedFrame(still, time)], speed=SPEED)
    alone = simulate_capture(
        PICTURE, SCENE, still, RectShutter(), speed=SPEED, displacement=-SPEED * time
    )
    np.testing.assert_allclose(found, alone, atol=1e-10)


def test_a_parabola_is_seen_from_the_middle_of_the_sequence():
    """A single capture is aligned at the vertex, a frame where the sensor is at the middle."""
    motion = ParabolicMotion(acceleration=A, half_exposure=HALF)
    (found,) = simulate_frames(PICTURE, SCENE, [TimedFrame(motion, 0.0043, 8.3)], speed=SPEED)
    # So fast a thing is aligned where it is lowest, at an end of the exposure.
    displacement = -A * 0.0043**2 - SPEED * 0.0043 + A * HALF**2 - abs(SPEED) * HALF
    alone = simulate_capture(
        PICTURE, SCENE, motion, RectShutter(), speed=SPEED, displacement=displacement
    )
    np.testing.assert_allclose(found, alone, atol=1e-9)


def test_a_parabola_of_the_other_direction_is_the_mirrored_one():
    """Of the mirrored picture at the opposite speed, from the mirrored place."""
    up = ParabolicMotion(acceleration=A, half_exposure=HALF)
    down = FreeMotion(accelerations=[-A], half_exposure=HALF)
    there = simulate_frames(PICTURE, SCENE, [TimedFrame(up, 0.01, 3.7)], speed=SPEED)
    back = simulate_frames(PICTURE[:, ::-1], SCENE, [TimedFrame(down, 0.01, -3.7)], speed=-SPEED)
    np.testing.assert_allclose(back[..., ::-1], there, atol=1e-9)


@pytest.mark.parametrize(
    ("times", "places", "middle"),
    [
        ((-0.013, 0.029), (-4.2, 31.5), 6.85),
        ((0.029, -0.017), (8.1, 8.1), 8.1),
        ((-0.02, 0.0, 0.02), (3.0, 17.4, 9.0), 17.4),
    ],
    ids=["on its way", "at rest", "exposed"],
)
def test_all_is_seen_from_where_the_sensor_is_at_the_middle(times, places, middle):
    """Be it exposed then or between frames, as which it goes on evenly."""
    still = StillCamera(half_exposure=1e-9)
    frames = [TimedFrame(still, *each) for each in zip(times, places, strict=True)]
    found = simulate_frames(PICTURE, SCENE, frames, speed=SPEED)
    for capture, time, place in zip(found, times, places, strict=True):
        way = place - middle - SPEED * time
        alone = simulate_capture(
            PICTURE, SCENE, still, RectShutter(), speed=SPEED, displacement=way
        )
        np.testing.assert_allclose(capture, alone, atol=1e-4)


FRAMES = [TimedFrame(StillCamera(half_exposure=1e-3), time) for time in (-0.01, 0.02)]
PUBLIC = {
    "simulate_frames(frames=...)": lambda frames: simulate_frames(PICTURE, SCENE, frames),
    "restore_frames(frames=...)": lambda frames: (
        restore_frames(np.tile(PICTURE, (2, 1, 1)), SCENE, frames, speed=0.0).light
    ),
    "exposures_psnr(exposures=...)": lambda frames: exposures_psnr(SCENE, frames),
}
"""The public functions that take frames, by their argument."""


@pytest.mark.parametrize("subject", PUBLIC)
def test_frames_are_taken_alone_and_as_exposures(subject):
    """As `best_sequence` returns them; a shaped shutter is refused in one line."""
    take = PUBLIC[subject]
    alike = [take(each) for each in (FRAMES, Exposures("stills", tuple(FRAMES)))]
    np.testing.assert_array_equal(*alike)
    shaped = Exposures.of_one(StillCamera(half_exposure=1e-3), HannShutter())
    with pytest.raises(ValueError, match=re.escape(f"`{subject}` must be of an open shutter")):
        take(shaped)


@pytest.mark.parametrize("wrong", [None, FRAMES[0], [1.0], "a"])
def test_what_is_no_frame_is_refused(wrong):
    """In one line, where types are not checked, as they are in tests."""
    with pytest.raises(
        ValueError, match="`f` must be `TimedFrame`s, `PlaneFrames`, or `Exposures`"
    ):
        inspect.unwrap(open_frames)("f", wrong)


def test_a_sensor_sees_the_middle_of_a_wider_picture():
    """Light enters from the picture beside it."""
    frames = [TimedFrame(StillCamera(half_exposure=1e-3), time) for time in (-0.01, 0.02)]
    whole = simulate_frames(PICTURE, SCENE, frames, speed=900.0)
    found = simulate_frames(PICTURE, SCENE, frames, speed=900.0, num_columns=180)
    assert found.shape == (2, 6, 180)
    np.testing.assert_array_equal(found, whole[..., 60:240])


def test_each_frame_has_noise_of_its_own_exposure():
    """Of its light and of reading, and no two frames alike."""
    flat = np.full((40, 400), 0.37)
    frames = [TimedFrame(StillCamera(half_exposure=half), 0.0) for half in (4e-4, 4e-4, 3e-3)]
    found = simulate_frames(flat, SCENE, frames, speed=0.0, key=jax.random.key(2))
    for capture, half in zip(found, (4e-4, 4e-4, 3e-3), strict=True):
        p = 7e4 * 2 * half
        assert np.var(np.asarray(capture)) == pytest.approx(0.37 / p + (6 / p) ** 2, rel=0.05)
    assert not np.array_equal(found[0], found[1])


def test_a_pixel_holds_what_the_scene_says():
    """A frame of more electrons than the full well is cut off, unless another well is given."""
    scene = Scene.uniform(
        max_speed=2600.0, photon_rate=7e4, read_noise=6, sensor=Sensor(full_well=90.0)
    )
    frames, flat = [TimedFrame(StillCamera(half_exposure=3e-3), 0.0)], np.full((20, 90), 0.8)
    white = 7e4 * 6e-3
    for given, most in ({}, 90.0), ({"full_well": 150.0}, 150.0), ({"full_well": 1e4}, 0.8 * white):
        found = simulate_frames(flat, scene, frames, key=jax.random.key(4), **given)
        assert float(np.mean(found)) == pytest.approx(most / white, rel=0.01)


def test_the_furthest_displacement_is_that_of_the_speed():
    """Where the sensor goes with a thing, one of the other direction is displaced further."""
    time = np.array([-0.01, 0.03])
    nodes = Instants(time[None], 700.0 * time[None, None], np.full((1, 2), 0.5), np.array([0.05]))
    assert nodes.reach(np.array([[700.0]]))[0] == pytest.approx(0.0, abs=1e-12)
    assert nodes.reach(np.array([[-400.0], [100.0]]))[0] == pytest.approx(1100 * 0.03)


def test_a_picture_that_moves_along_its_columns():
    """Is that of exchanged rows and columns."""
    frames = [TimedFrame(StillCamera(half_exposure=1e-3), time) for time in (-0.01, 0.02)]
    along = simulate_frames(PICTURE, SCENE, frames, speed=900.0, num_columns=180)
    down = Scene.uniform(
        max_speed=2600.0, photon_rate=7e4, read_noise=6, sensor=Sensor(axis="columns")
    )
    found = simulate_frames(PICTURE.T, down, frames, speed=900.0, num_columns=180)
    np.testing.assert_array_equal(found, np.swapaxes(along, 1, 2))


def layers_at(columns, *, roll=0):
    """A textured background and an object whose edges are soft, displaced by whole pixels."""
    place = np.arange(160) * 2 * np.pi / 160
    ground = (
        0.4
        + 0.2 * np.sin([3 * place + k for k in range(7)])[..., None] * np.cos(11 * place)[:, None]
    )
    own = np.linspace(-3, 3, 61)
    light = 0.5 + 0.3 * np.sin([5 * own - k for k in range(4)])[..., None]
    front = Layer(Picture(light, matte=np.exp(-(own**2)) * np.ones((4, 1))), 700.0, columns, 2)
    return Layers((Layer(Picture(np.roll(ground, roll, axis=1))), front), border="wrap")


def test_layers_in_a_frame_are_a_capture_of_displaced_layers():
    """Each by its own way since the middle of the sequence, behind a sensor that moves or not."""
    still = RESTING
    bend = ParabolicMotion(acceleration=A, half_exposure=HALF)
    frames = [TimedFrame(still, 0.0), TimedFrame(still, -0.03), TimedFrame(bend, 0.02, 5.0)]
    found = simulate_frames(layers_at(60), SCENE, frames)
    for one, motion, shifted in (
        (found[0], still, layers_at(60)),
        (found[1], still, layers_at(60 + 21)),
        (found[2], bend, layers_at(60 - 14 + 5, roll=5)),
    ):
        alone = simulate_capture(shifted, SCENE, motion, RectShutter())
        np.testing.assert_allclose(one, alone, atol=2e-6)


def test_a_background_alone_is_a_picture_that_moves_as_a_whole():
    """On part of it that a narrower sensor sees, in every frame."""
    frames = [TimedFrame(StillCamera(half_exposure=3e-3), time) for time in (-0.04, 0.01)]
    layers = Layers((Layer(Picture(PICTURE[..., None]), SPEED),))
    found = simulate_frames(layers, SCENE, frames, num_columns=130)
    whole = simulate_frames(PICTURE[..., None], SCENE, frames, speed=SPEED, num_columns=130)
    np.testing.assert_allclose(found, whole, atol=1e-10)


def test_layers_bring_their_own_speeds():
    """A speed beside them is refused."""
    with pytest.raises(ValueError, match=re.escape("speed=...)` must be left to layers; got 30.0")):
        simulate_frames(layers_at(60), SCENE, [TimedFrame(RESTING, 0.0)], speed=30.0)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"frames": []}, "frames=...)` must hold one frame at least; got 0"),
        ({"num_columns": 301}, "num_columns=...)` must be at most the picture's 300 columns"),
        ({"num_columns": 0}, "num_columns=...)` must be a positive integer"),
        ({"speed": np.nan}, "speed=...)` must be finite"),
        ({"speed": 9e5}, "frames=...)` must displace light by at most 8192 px"),
    ],
)
def test_what_cannot_be_simulated(change, line):
    """Is refused in one line."""
    frames = [TimedFrame(StillCamera(half_exposure=1e-3), 0.02)]
    given = {"scene": SCENE, "frames": frames, "speed": 40.0} | change
    with pytest.raises(ValueError, match=re.escape(line)):
        simulate_frames(PICTURE, given.pop("scene"), given.pop("frames"), **given)
