"""Frames of unequal exposures, sides and steps; errors that end at a floor; binned noise."""

import jax
import numpy as np
import pytest

from mishutter import (
    EnsembleDecoder,
    PlaneFrames,
    Scene,
    StillCamera,
    TimedFrame,
    TotalVariationDecoder,
    example_picture,
    psnr,
    restore_frames,
    simulate_frames,
)
from mishutter.decoding.frame_likelihood import Own, Prior, slope_at
from mishutter.decoding.likeliest import noises_of

PICTURE = np.asarray(example_picture().light)[100:220, 200:330, 1].astype(np.float64)


def in_plane(times, exposures) -> PlaneFrames:
    """Frames at rest, for things that move in any direction."""
    return PlaneFrames(np.array(times), np.array(exposures), np.ones(1), np.zeros((2, 2)))


def on_axis(times, exposures) -> list[TimedFrame]:
    """Frames at rest, for things that move along rows."""
    pairs = zip(times, exposures, strict=True)
    return [TimedFrame(StillCamera(half_exposure=each / 2), time) for time, each in pairs]


def scene_of(axes: int, photon_rate: float) -> Scene:
    light = {"photon_rate": photon_rate, "read_noise": 2.0}
    if axes == 2:
        return Scene.any_direction(150.0, **light)
    return Scene(np.linspace(-150.0, 150.0, 5), decoder_speed="found", **light)


KINDS = {
    1: (on_axis, 60.0, {"num_columns": 100}),
    2: (in_plane, np.array([60.0, -45.0]), {"num_rows": 80, "num_columns": 90}),
}


@pytest.mark.parametrize("axes", KINDS)
def test_short_before_long_is_long_before_short_backwards(axes):
    """The same captures in the other order, of things that move the other way, are one picture."""
    make, velocity, size = KINDS[axes]
    scene, times, exposures = scene_of(axes, 3e5), (-0.12, 0.07), (0.02, 0.11)
    frames = make(times, exposures)
    captures = simulate_frames(
        PICTURE[:90], scene, frames, speed=velocity, key=jax.random.key(1), **size
    )
    back = make(tuple(-t for t in times[::-1]), exposures[::-1])
    one, other = (
        np.asarray(restore_frames(taken, scene, each, speed=speed).light)
        for taken, each, speed in (
            (captures, frames, velocity),
            (captures[::-1], back, -velocity),
        )
    )
    # In the plane the picture is of single precision, and ends within a share of its error.
    np.testing.assert_allclose(one, other, atol=1e-10 if axes == 1 else 2e-3)
    wrong = restore_frames(captures[::-1], scene, frames, speed=-velocity).light
    assert np.max(np.abs(np.asarray(wrong) - one)) > 0.1


@pytest.mark.parametrize(
    ("axes", "size"),
    [
        (1, {"num_columns": 70}),
        pytest.param(2, KINDS[2][2], marks=pytest.mark.slow),
    ],
)
def test_in_bright_light_a_velocity_errs_by_the_floor(axes, size):
    """By 0.005 px over the 59.5 ms between two frames, 0.084 px/s, and by no more than that."""
    make, velocity, _ = KINDS[axes]
    scene, frames = scene_of(axes, {1: 1e11, 2: 1e8}[axes]), make((-0.0297, 0.0298), (2e-3, 2e-3))
    picture = PICTURE[:16, :100] if axes == 1 else PICTURE
    captures = simulate_frames(
        picture, scene, frames, speed=velocity, key=jax.random.key(1), **size
    )
    estimate = restore_frames(captures, scene, frames).estimate
    assert estimate.error == pytest.approx(0.005 / 0.0595, rel=0.02)
    assert estimate.trusted


def test_total_variation_is_best_where_a_picture_is_flat():
    """Of a picture of three levels, with sides of unlike length and frames of unlike exposure."""
    scene, velocity = scene_of(2, 1e4), np.array([60.0, -45.0])
    frames = in_plane((-0.0297, 0.0298), (0.02, 0.01))
    picture = np.full((60, 70), 0.2)
    picture[20:38, 14:50], picture[30:44, 40:58] = 0.6, 0.35
    captures = simulate_frames(
        picture, scene, frames, speed=velocity, num_rows=36, num_columns=44, key=jax.random.key(2)
    )
    levels = [
        psnr(
            picture[12:48, 13:57],
            restore_frames(captures, scene, frames, speed=velocity, decoder=decoder).light,
        )
        for decoder in (EnsembleDecoder(), TotalVariationDecoder())
    ]
    assert levels[1] - levels[0] == pytest.approx(3.7, abs=0.4)


@pytest.mark.parametrize(("size", "misfit"), [(1, 0.90), (4, 0.73)])
def test_binned_noise_is_as_strong_as_its_pixels_say(size, misfit):
    """And detail that is finer than binned pixels counts as noise: without it they fit better."""
    scene, frames = scene_of(2, 1e4), in_plane((-0.0297, 0.0298), (2e-3, 2e-3))
    noises = noises_of(scene, frames.exposures, 0.25)
    noise = np.random.default_rng(4).normal(size=(2, 256, 240))
    own = Own(np.sqrt(noises)[:, None, None] * noise, noises, frames, Prior(scene))
    level, rest = own.level(np.zeros((1, 2)), size), np.zeros(2)
    fit = level.fit(rest, 0.25)
    assert fit.misfit == pytest.approx(misfit, abs=0.03)


def test_a_place_of_the_picture_pulls_in_one_tile_of_all_frames():
    """Of a spot that moves by 36 px along rows and by 24 px down them from frame to frame."""
    frames, velocity = in_plane((-0.03, 0.03), (1e-3, 1e-3)), np.array([600.0, -400.0])
    own = Own(np.zeros((2, 64, 96)), np.ones(2), frames, Prior(scene_of(2, 1e4)))
    level = own.level(velocity[None])
    canvas = level.canvas
    light = np.zeros(canvas.shape)
    light[canvas.margin[0] + 33, canvas.margin[1] + 46] = 1
    responses = level.responses(velocity[None])[:, 0]
    shown = canvas.through(responses, canvas.spectrum(light))
    brightest = [np.unravel_index(np.argmax(one), one.shape) for one in shown]
    assert np.abs(np.subtract(*brightest)) == pytest.approx([24, 36])
    slope = slope_at(level, velocity)
    tiles = []
    for number in range(2):
        scores = np.zeros((2, *shown.shape))
        scores[:, number] = shown[number]
        pulls, pixels = slope._replace(scores=scores).by_place(level)
        assert np.sum(pixels) == 2 * 64 * 96
        tiles.append(np.argmax(pulls, axis=1))
    np.testing.assert_array_equal(*tiles)
