"""One picture from frames in the plane: its level by the formula, and the velocity they tell."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from skimage.restoration import denoise_tv_chambolle
from support.plane import frames_of, scene_of

from mishutter import (
    EnsembleDecoder,
    ListedVelocities,
    PlaneFrames,
    PlugAndPlayDecoder,
    RingOfVelocities,
    Scene,
    SpeedFindingDecoder,
    TotalVariationDecoder,
    WienerDecoder,
    example_picture,
    exposures_psnr,
    psnr,
    restore_frames,
    simulate_frames,
)
from mishutter.camera.responses import aperture_on, waves_of
from mishutter.decoding.frame_likelihood import Own, Prior
from mishutter.decoding.frame_velocity import VelocityEstimate, _Burst, velocity_of_frames
from mishutter.decoding.likeliest import fit_of, noises_of
from mishutter.decoding.rolling import RowTimes
from mishutter.evaluation.instants import Instants
from mishutter.model.velocities import EvenVelocities

SCENE = scene_of("A")
VELOCITY = np.array([610.0, -470.0])


def estimate_of(captures, scene, frames) -> VelocityEstimate:
    return velocity_of_frames(np.asarray(captures)[None], scene, frames)


def a_field(frames: PlaneFrames, velocity: np.ndarray, size: int, seed: int, scene=SCENE):
    """A Gaussian field of the scene's spectrum on a ring, and the middle of its noisy frames."""
    rng, whole = np.random.default_rng(seed), 2 * size
    shape = (whole, whole)
    power = Prior(SCENE).on(shape)
    field = np.fft.irfft2(np.fft.rfft2(rng.normal(size=shape)) * np.sqrt(power), shape)
    instants = Instants.of(frames, float(np.hypot(*velocity)))
    responses = waves_of(instants, velocity[None], shape)[:, 0] * aperture_on(SCENE.optics, shape)
    seen = np.fft.irfft2(np.fft.rfft2(field) * responses, shape)
    noises = noises_of(scene, frames.exposures, 0.25)[:, None, None]
    middle = slice(size // 2, size // 2 + size)
    taken = (seen + np.sqrt(noises) * rng.normal(size=seen.shape))[:, middle, middle]
    return taken + 0.25, field[middle, middle] + 0.25


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["still", "sines"])
def test_fields_are_restored_as_well_as_the_formula_says(kind):
    """Of the scene's spectrum, from four frames, where all of them see."""
    frames, errors = frames_of("A", 4, kind), []
    for seed in range(6):
        velocity = 350 * np.array([np.cos(2.4 * seed), np.sin(2.4 * seed)])
        told = Scene.any_direction(
            ListedVelocities(velocity[None]), photon_rate=3e4, read_noise=10.0
        )
        captures, truth = a_field(frames, velocity, 128, seed)
        light = np.asarray(restore_frames(captures, SCENE, frames, speed=velocity).light)
        inner = slice(32, -32)
        errors.append(np.mean((light - truth)[inner, inner] ** 2))
        formula = 10 ** (-float(exposures_psnr(told, frames)) / 10)
        errors[-1] /= formula
    assert 10 * np.log10(np.mean(errors)) == pytest.approx(0, abs=0.25)


@pytest.mark.slow
def test_a_circle_is_restored_to_its_limit(monkeypatch):
    """Exposures of one turn each hardly record some waves of a picture, which settle last."""
    angle, period = np.linspace(0, 8 * np.pi, 385), 0.02
    paths = 2100.0 * np.stack([-np.sin(angle), np.cos(angle)])
    times = (np.arange(4) - 1.5) * period
    frames = PlaneFrames(times, np.full(4, period), np.full(384, period / 96), paths)
    scene = Scene.any_direction(2800.0, photon_rate=1e5, read_noise=8.0)
    velocity = np.array([-150.0, 600.0])
    captures, truth = a_field(frames, velocity, 32, 0, scene)
    found = restore_frames(captures, scene, frames, speed=velocity)
    monkeypatch.setattr("mishutter.decoding.likeliest._MOST_STEPS", 5000)
    own = Own(
        captures - np.mean(captures), noises_of(scene, frames.exposures, 0.25), frames, Prior(scene)
    )
    limit = own.level(velocity[None]).likeliest(velocity[None], 1e-5)
    picture = limit.picture[0][limit.canvas.window] + np.mean(captures)
    assert psnr(found.light, truth) == pytest.approx(psnr(picture, truth), abs=0.05)
    burst = _Burst.of(captures[None], scene, frames, RowTimes(np.zeros(1)))
    level = burst.own.level(velocity[None])
    fit = fit_of(level.likeliest(velocity[None], 1e-5), level.volume(velocity), burst.mean)
    assert found.estimate.misfit == pytest.approx(fit.misfit, rel=0.02)


def shown(kind="sines", count=4, velocity=VELOCITY, size=(96, 112), scene=SCENE, seed=3):
    """Frames of a photograph that is wider than the sensor, and the part that the sensor shows."""
    picture = np.asarray(example_picture().light)[100:340, 200:460, 1].astype(np.float64)
    frames = frames_of("A", count, kind)
    captures = simulate_frames(
        picture,
        scene,
        frames,
        speed=velocity,
        num_rows=size[0],
        num_columns=size[1],
        key=jax.random.key(seed),
    )
    top, left = (240 - size[0]) // 2, (260 - size[1]) // 2
    return np.array(captures), picture[top : top + size[0], left : left + size[1]], frames


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "count", "velocity", "size"),
    [
        ("sines", 4, (305.0, -235.0), (64, 72)),
        ("still", 4, (-175.0, 450.0), (64, 72)),
        ("sines", 8, (20.0, 550.0), (64, 72)),
    ],
)
def test_frames_tell_the_velocity(kind, count, velocity, size):
    """To within its error and without a doubt; light enters and leaves at all four borders."""
    scene = Scene.any_direction(600.0, photon_rate=1e5, read_noise=10.0)
    captures, truth, frames = shown(kind, count, np.array(velocity), size=size, scene=scene)
    light, estimate = restore_frames(captures, scene, frames)
    assert isinstance(estimate, VelocityEstimate)
    assert estimate.trusted, estimate.doubt
    off = estimate.velocity - np.array(velocity)
    assert off @ np.linalg.inv(estimate.covariance) @ off < 20
    assert 0 < estimate.error < 10
    assert estimate.misfit == pytest.approx(1, abs=0.2)
    assert np.sum(estimate.weights) == pytest.approx(1)
    told = restore_frames(captures, scene, frames, speed=velocity).light
    assert float(psnr(truth, light)) == pytest.approx(float(psnr(truth, told)), abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sines", "still"])
def test_errors_of_a_picture_with_little_detail_hold(kind):
    """A bar tells its velocity across it, and along it by one end: it errs by more there."""
    rows, columns = np.mgrid[:200, :200]
    away = np.abs(columns - 100 - 0.02 * rows)
    light = 0.15 + 0.6 * ((away < 7) & (rows > 92 - 0.8 * away)) + 0.02 * np.sin(rows / 9)
    light, frames = gaussian_filter(light, 0.7), frames_of("A", 2, kind)
    velocity, scores = np.array([310.0, -240.0]), []
    size = {"num_rows": 96, "num_columns": 96}
    scene = Scene.any_direction(450.0, photon_rate=3e4, read_noise=10.0)
    for seed in (0, 1):
        key = jax.random.key(seed)
        captures = simulate_frames(light, scene, frames, speed=velocity, key=key, **size)
        estimate = estimate_of(captures, scene, frames)
        off = estimate.velocity - velocity
        scores.append(off @ np.linalg.inv(estimate.covariance) @ off)
        across, along = np.sqrt(np.diag(estimate.covariance))
        assert along > 2 * across
    assert np.mean(scores) < 6


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoilt", "doubt"),
    [
        ("order", "do not fit|off its place"),
        ("repeated", "the same"),
        ("black", "Frame 3 of 4 is black"),
        ("noise", "more noise than the scene says"),
        ("shifted", "Frame 2 of 4"),
        ("flat", "too little detail"),
        ("design", "do not fit|off its place"),
    ],
)
def test_frames_that_fit_no_picture_are_not_trusted(spoilt, doubt):
    """Each with its reason."""
    velocity, scene = VELOCITY / 2, Scene.any_direction(450.0, photon_rate=3e5, read_noise=10.0)
    captures, _, frames = shown(velocity=velocity, size=(56, 64), scene=scene)
    if spoilt == "order":
        captures = captures[[0, 2, 1, 3]]
    elif spoilt == "repeated":
        captures = captures[[0, 1, 1, 3]]
    elif spoilt == "black":
        captures[2] = 0.01 * np.random.default_rng(0).normal(size=captures[2].shape)
    elif spoilt == "noise":
        captures = captures + 0.1 * np.random.default_rng(0).normal(size=captures.shape)
    elif spoilt == "shifted":
        captures[1] = np.roll(captures[1], (0, 2), axis=(0, 1))
    elif spoilt == "flat":
        captures = 0.25 + 0.006 * np.random.default_rng(0).normal(size=captures.shape)
    elif spoilt == "design":
        frames = frames_of("A", 4, "circle")
    estimate = estimate_of(captures, scene, frames)
    assert not estimate.trusted
    assert any(word in estimate.doubt for word in doubt.split("|")), estimate.doubt


def test_a_velocity_that_is_told_is_judged():
    """As one that is found: another velocity, exchanged axes and exchanged frames do not fit."""
    captures, _, frames = shown(size=(80, 80))
    told = restore_frames(captures, SCENE, frames, speed=VELOCITY).estimate
    assert (told.trusted, told.doubt, told.error) == (True, "", 0.0)
    np.testing.assert_array_equal(told.velocity, VELOCITY)
    assert told.misfit == pytest.approx(1.1, abs=0.15)
    beside = VELOCITY + np.array([90.0, 0.0])
    for light, velocity, reason in (
        (captures, beside, "px off its place: another velocity, rows and columns exchanged"),
        (np.swapaxes(captures, 1, 2), VELOCITY, "do not fit one picture at one velocity"),
        (captures[[0, 2, 1, 3]], VELOCITY, "do not fit one picture at one velocity"),
    ):
        estimate = restore_frames(light, SCENE, frames, speed=velocity).estimate
        assert not estimate.trusted
        assert reason in estimate.doubt


@pytest.mark.slow
def test_frames_whose_gain_changes_tell_the_velocity():
    """By some per cent from frame to frame, and a black level that does."""
    velocity, scene = VELOCITY / 2, Scene.any_direction(450.0, photon_rate=3e4, read_noise=10.0)
    captures, _, frames = shown(velocity=velocity, size=(64, 72), scene=scene)
    gains = np.array([1.0, 1.06, 0.97, 1.02])[:, None, None]
    estimate = estimate_of(
        gains * captures + [[[0.0]], [[0.01]], [[0.0]], [[0.004]]], scene, frames
    )
    assert np.hypot(*(estimate.velocity - velocity)) * 0.06 < 0.3


def test_a_gain_that_was_taken_out_is_not_found_again():
    """Of two frames, of which the second is a tenth brighter."""
    velocity, bright = np.array([4.0, -3.0]), replace(SCENE, photon_rate=3e6)
    captures, _, frames = shown("still", 2, velocity, scene=bright)
    captures[1] *= 1.1
    times = RowTimes.of(bright.sensor, (1, 96, 112), in_plane=True)
    burst, apart = _Burst.of(captures[None], bright, frames, times), []
    for _ in range(2):
        level = burst.own.level(velocity[None], 1)
        fit = level.fit(velocity, burst.mean)
        burst, apart = burst.steady(fit), [*apart, fit.gains[1] - fit.gains[0]]
    np.testing.assert_allclose(apart, [0.1, 0.0], atol=0.01)


@pytest.mark.slow
def test_a_velocity_beyond_the_scene_is_not_trusted():
    """It lies outside of the disc that is searched."""
    captures, _, frames = shown(velocity=np.array([240.0, -220.0]), size=(56, 64))
    scene = Scene.any_direction(300.0, photon_rate=3e4, read_noise=10.0)
    assert "beyond those of the scene" in estimate_of(captures, scene, frames).doubt


@pytest.mark.parametrize(
    ("law", "inside", "outside"),
    [
        (EvenVelocities(900.0, 300.0, angle=0.5), (750.0, 400.0), (-200.0, 380.0)),
        (RingOfVelocities(700.0), (-420.0, 565.0), (100.0, 50.0)),
        (ListedVelocities([[300.0, -80.0], [0.0, 55.0]]), (302.0, -76.0), (150.0, -10.0)),
    ],
)
def test_a_law_says_which_velocities_occur(law, inside, outside):
    """To within some px/s; half of a unit beyond which is outside."""
    assert law.within(np.array([inside, outside]), 8.0).tolist() == [True, False]
    along = law.fastest * np.array([[np.cos(law.axis), np.sin(law.axis)]])
    assert law.within(along * (1 + 7.9 / law.fastest), 8.0).all()
    assert not law.within(along * (1 + 8.1 / law.fastest), 8.0).any()


@pytest.mark.slow
def test_frames_with_next_to_no_noise_are_restored():
    """What rounding leaves of steps that lead nowhere is no overflow, which would be an error."""
    scene, frames = replace(SCENE, photon_rate=1e11), frames_of("A", 4, "still")
    picture, velocity = example_picture().light[100:164, 100:164], np.array([300.0, -200.0])
    captures = simulate_frames(picture, scene, frames, speed=velocity)
    assert psnr(picture, restore_frames(captures, scene, frames, speed=velocity).light) > 30


def test_a_velocity_at_which_frames_share_nothing_is_refused():
    """At once: the canvas that holds both would grow with the way between them."""
    captures = np.full((4, 64, 64), 0.3)
    with pytest.raises(
        ValueError, match=r"speed=...\)` must leave two frames in turn .* px between"
    ):
        restore_frames(captures, SCENE, frames_of("A", 4, "still"), speed=np.array([9e4, 300.0]))


def test_decoders_of_the_plane_restore_with_their_prior():
    """Total variation beats the linear one, as a penalty and as a denoiser of one's own."""
    captures, truth, frames = shown(size=(72, 72))
    levels = {}
    for name, decoder in {
        "ensemble": EnsembleDecoder(),
        "total variation": TotalVariationDecoder(),
        "finding": SpeedFindingDecoder(TotalVariationDecoder()),
        "denoiser": PlugAndPlayDecoder(lambda x, sigma: denoise_tv_chambolle(x, sigma)),
    }.items():
        light = restore_frames(captures, SCENE, frames, speed=VELOCITY, decoder=decoder).light
        levels[name] = float(psnr(truth, light))
    assert levels["total variation"] > levels["ensemble"] + 0.3
    assert levels["finding"] == levels["total variation"]
    assert levels["denoiser"] > levels["ensemble"] + 0.1
    with pytest.raises(ValueError, match=r"TotalVariationDecoder.+got 'WienerDecoder'"):
        restore_frames(captures, SCENE, frames, speed=VELOCITY, decoder=WienerDecoder())


@pytest.mark.slow
def test_colours_and_precision_are_those_of_the_frames():
    """Colours that are alike are restored once; single precision errs by little."""
    captures, _, frames = shown(size=(40, 44))
    grey = np.asarray(restore_frames(captures, SCENE, frames, speed=VELOCITY).light)
    single = captures.astype(np.float32)
    light = restore_frames(single, SCENE, frames, speed=VELOCITY).light
    assert light.dtype == np.float32
    np.testing.assert_allclose(light, grey, atol=2e-3)
    colours = np.stack([captures, 0.5 * captures, captures], axis=-1)
    restored = np.asarray(restore_frames(colours, SCENE, frames, speed=VELOCITY).light)
    np.testing.assert_allclose(restored[..., 0], grey, atol=1e-12)
    np.testing.assert_allclose(restored[..., 1], 0.5 * grey, atol=1e-10)
    same = np.repeat(captures[..., None], 3, axis=-1)
    assert np.asarray(restore_frames(same, SCENE, frames, speed=VELOCITY).light).shape[-1] == 3


@pytest.mark.slow
@pytest.mark.parametrize("level", [0.0, 0.31])
def test_pictures_without_detail_are_no_error(level):
    """Black frames, and grey ones: a velocity that nothing tells, and a finite picture."""
    frames = frames_of("A", 2, "sines")
    scene = Scene.any_direction(150.0, photon_rate=3e4, read_noise=10.0)
    light, estimate = restore_frames(np.full((2, 33, 35), level), scene, frames)
    np.testing.assert_allclose(light, level, atol=1e-9)
    assert not estimate.trusted
    assert np.all(np.isfinite(estimate.covariance))
    assert estimate.error > 50


@pytest.mark.parametrize(
    ("captures", "changed", "message"),
    [
        (np.ones((3, 20, 20)), {}, "be 4 frames, of rows and columns"),
        (np.ones((4, 20, 20)), {"speed": 1500.0}, "velocity along rows and columns"),
        (np.full((4, 20, 20), np.nan), {}, "finite"),
        (np.ones((4, 20, 20)), {"scene": replace(SCENE, photon_rate=0.0)}, "photon rate above 0"),
    ],
)
def test_frames_in_the_plane_are_refused(captures, changed, message):
    """Too few of them, a velocity without a direction, no light: in a line each."""
    arguments = {"scene": SCENE, "speed": VELOCITY} | changed
    with pytest.raises(ValueError, match=message):
        restore_frames(captures, arguments.pop("scene"), frames_of("A", 4, "sines"), **arguments)
