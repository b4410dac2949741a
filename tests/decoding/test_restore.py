"""A plain array restored by a saved design: by the decoder of its scene."""

import dataclasses

import jax
import numpy as np
import pytest
from support.bursts import a_burst_design

import mishutter as ms
from mishutter.decoding.restoration import restored_capture
from mishutter.design.design import given_design

MOTION = ms.ParabolicMotion(acceleration=6e4, half_exposure=9.7e-3, velocity=70.0)
SPEEDS = [0.0, 310.0, -190.0]


def design(**others):
    scene = ms.Scene(SPEEDS, photon_rate=2.3e6, read_noise=4.7, **others)
    return given_design(scene, MOTION, ms.HannShutter(), "Given.")


def capture(of, speed=310.0, rows=slice(20, 170)):
    picture = ms.example_picture().light[rows, :200]
    scene = of.scene
    return picture, ms.simulate_capture(
        picture, scene, MOTION, of.shutter, speed=speed, key=jax.random.key(4)
    )


@pytest.mark.parametrize("axis", ["rows", "columns"])
def test_it_is_what_deconvolve_makes_of_it(axis):
    """In portions of rows, along either axis, of grey pictures and of coloured ones."""
    camera = design(sensor=ms.Sensor(axis=axis))
    _, seen = capture(camera)
    whole = ms.deconvolve(seen, camera.scene, MOTION, camera.shutter)
    np.testing.assert_allclose(ms.restore(seen, camera), whole, atol=1e-6)
    grey = np.asarray(seen)[..., 0]
    np.testing.assert_allclose(ms.restore(grey, camera), np.asarray(whole)[..., 0], atol=1e-6)


def test_a_capture_that_was_read_from_a_file_is_an_array():
    """`read_picture` returns a `Picture`: it is restored as its light is."""
    camera = design()
    _, seen = capture(camera, rows=slice(20, 27))
    light = np.maximum(np.asarray(seen), 0)
    np.testing.assert_array_equal(ms.restore(ms.Picture(light), camera), ms.restore(light, camera))
    given = camera.scene, MOTION, camera.shutter
    np.testing.assert_array_equal(
        ms.deconvolve(ms.Picture(light), *given), ms.deconvolve(light, *given)
    )


def test_a_told_speed_is_that_of_the_pan_too():
    """The filter of one speed, relative to the sensor, leaves less than that of another."""
    camera = design()
    picture, seen = capture(camera)
    levels = {
        speed: float(ms.psnr(picture, ms.restore(seen, camera, speed=speed)))
        for speed in (310.0, 240.0, 380.0)
    }
    assert max(levels, key=levels.get) == 310.0


@pytest.mark.slow
@pytest.mark.parametrize("knowledge", ["found", "known"])
def test_the_scenes_decoder_finds_the_speed(knowledge):
    """Where the scene's decoder finds or knows the speed, it is found; otherwise none is."""
    camera = design(decoder_speed=knowledge)
    _, seen = capture(camera)
    assert restored_capture(seen, camera).found is not None
    assert restored_capture(seen, design()).found is None


def test_refusals():
    """What is no picture, or no finite speed, is refused in one line."""
    camera = design()
    with pytest.raises(ValueError, match=r"restore\(capture=...\)` must have rows and columns"):
        ms.restore(np.ones(5), camera)
    with pytest.raises(ValueError, match=r"restore\(capture=...\)` must be finite"):
        ms.restore(np.full((5, 40), np.nan), camera)
    with pytest.raises(ValueError, match=r"restore\(speed=...\)` must be finite"):
        ms.restore(np.ones((5, 40)), camera, speed=np.inf)


def burst_frames(camera, speed=640.0, rows=slice(20, 170)):
    picture = ms.example_picture().light[rows, :240]
    frames = camera.sequence.frames
    return picture, np.asarray(
        ms.simulate_frames(picture, camera.scene, frames, speed=speed, key=jax.random.key(3))
    )


@pytest.mark.parametrize("axis", ["rows", "columns"])
def test_frames_of_a_burst_become_one_picture(axis):
    """By the speed that all rows tell, a few rows at a time, along either axis."""
    camera = a_burst_design(sensor=ms.Sensor(axis=axis))
    picture, seen = burst_frames(camera)
    found = restored_capture(seen, camera)
    assert found.found.trusted
    assert found.found.speed == pytest.approx(640.0, abs=5.0)
    told = ms.restore_frames(seen, camera.scene, camera.sequence.frames, speed=found.found.speed)
    np.testing.assert_allclose(found.light, told.light, atol=2e-3)
    of_told = ms.restore(seen, camera, speed=640.0)
    assert found.light.shape == picture.shape
    levels = [float(ms.psnr(picture, light)) for light in (of_told, found.light, seen[0])]
    assert levels[0] == pytest.approx(levels[1], abs=0.1)
    assert levels[1] > levels[2] + 2


def test_a_burst_is_whole():
    """One picture too few, or one alone, is refused in a line that says how many there are."""
    camera = a_burst_design()
    _, seen = burst_frames(camera, rows=slice(0, 20))
    for some in (seen[:1], seen[0], np.concatenate([seen, seen])):
        with pytest.raises(ValueError, match="be the 2 frames of the design's burst"):
            ms.restore(some, camera)
    alone = dataclasses.replace(camera, sequence=None)
    assert ms.restore(seen[0], alone).shape == seen[0].shape
