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
from mishutter.decoding.frame_doubts import Evidence, Words
from mishutter.decoding.frame_likelihood import Own, Prior, slope_at
from mishutter.decoding.likeliest import Fit, noises_of

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


@pytest.mark.slow
@pytest.mark.parametrize("axes", KINDS)
def test_in_bright_light_a_velocity_errs_by_the_floor(axes):
    """By 0.005 px over the 59.5 ms between two frames, 0.084 px/s, and by no more than that."""
    make, velocity, size = KINDS[axes]
    scene, frames = scene_of(axes, 1e8), make((-0.0297, 0.0298), (2e-3, 2e-3))
    captures = simulate_frames(
        PICTURE, scene, frames, speed=velocity, key=jax.random.key(1), **size
    )
    estimate = restore_frames(captures, scene, frames).estimate
    assert estimate.error == pytest.approx(0.005 / 0.0595, rel=0.02)
    assert estimate.trusted


@pytest.mark.parametrize(
    ("exposures", "duration"), [((0.02, 0.11), 0.11), ((0.02, 0.03), 0.065), ((0.11, 0.02), 0.11)]
)
def test_things_move_for_the_longest_exposure_where_that_outlasts_the_way_between(
    exposures, duration
):
    """Two frames of 0.11 and 0.02 s are 0.065 s apart, and the longer one alone shows more."""
    frames = in_plane((-0.0297, 0.0353), exposures)
    own = Own(np.zeros((2, 9, 8)), np.ones(2), frames, Prior(scene_of(2, 1e4)))
    assert own.duration == pytest.approx(duration)


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
    shown = np.stack([canvas.through(one, canvas.spectrum(light)) for one in responses])
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


WORDS = Words("velocity", "reasons", "parts", "beyond")


def evidence(step: tuple[float, float], misfit: float = 1.0, elsewhere: float = 9.0) -> Evidence:
    """Two frames of 60 x 200 px, a step apart, that fit one picture with some misfit."""
    one, some = np.ones(2), np.zeros((2, 2))
    fit = Fit(misfit, one, 0 * one, 0 * one, some, some + 0.01, np.zeros(4))
    return Evidence(
        frames=np.random.default_rng(2).normal(0.3, 0.1, (2, 60, 200)),
        noises=0.01 * one,
        places=np.array([[0.0, step[0]], [0.0, step[1]]]),
        fit=fit,
        compared=fit,
        elsewhere=elsewhere,
        rivals=[],
        lead=1e6,
        middle=1e6,
        is_within=True,
    )


@pytest.mark.parametrize(
    ("step", "doubt"), [((120.0, 0.0), ""), ((0.0, 120.0), "moves by 120 px"), ((0.0, 30.0), "")]
)
def test_steps_are_measured_by_the_side_along_them(step, doubt):
    """Of 60 x 200 px, 120 along rows leave 40 % of a frame in the next, and down none of it."""
    said = evidence(step).doubt(0.1, WORDS)
    assert doubt in said if doubt else said == ""


@pytest.mark.parametrize(
    ("misfit", "elsewhere", "is_doubted"),
    [(1.5, 2.0, True), (1.5, 2.6, False), (1.9, 4.0, True), (1.9, 6.0, False), (1.2, 1.3, False)],
)
def test_a_misfit_is_judged_by_what_detail_would_leave_elsewhere(misfit, elsewhere, is_doubted):
    """Both above the 1 of noise: 0.5 of 1.0 is much, and 0.5 of 1.6 little; 0.9 of 3 and of 5."""
    said = evidence((10.0, 0.0), misfit, elsewhere).doubt(0.1, WORDS)
    assert ("do not fit one picture" in said) == is_doubted
