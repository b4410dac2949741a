"""A photograph through the camera and back, measured against the closed form.

Pinned on synthetic rows whose power spectrum is exactly the one assumed, because only
there do theory and measurement speak of the same thing.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.cameras import HALF_EXPOSURE, camera, scene
from support.programs import compiled_programs

import mishutter as ms
from mishutter.camera.capture import kernel_layout, noisy
from mishutter.decoding.decoders.base import blur_model
from mishutter.decoding.decoders.linear import decoder_or_ensemble

# Means over seeds and the columns that count are parts of a result that holds neither.
from mishutter.decoding.photographs import _common_columns, _Errors, levels_of, restore_by_each


def gaussian_rows(rows=96, columns=1200, seed=3):
    """Rows of the default spectrum: mean 0.5, deviation 0.1."""
    frequency = np.fft.rfftfreq(columns)
    power = 1 / (frequency**2 + 0.01**2)
    white = np.random.default_rng(seed).standard_normal((rows, columns))
    coloured = np.fft.irfft(np.fft.rfft(white) * np.sqrt(power), columns)
    grid = (np.arange(256) + 0.5) / 512
    coloured /= np.sqrt(np.mean(1 / (grid**2 + 0.01**2)))
    return np.maximum(0.5 + 0.1 * coloured, 0)[..., None]


@pytest.mark.slow
@pytest.mark.parametrize("shutter", [ms.RectShutter(), ms.HannShutter()], ids=["rect", "hann"])
@pytest.mark.parametrize("photon_rate", [3e4, 1e7])
def test_measured_error_is_the_expected_one(shutter, photon_rate):
    """The ensemble filter leaves the error of its closed form, which is that of `evaluate`."""
    known = scene(photon_rate=photon_rate)
    result = ms.restore_photograph(gaussian_rows(), known, camera(), shutter, num_seeds=2)
    spread = float(np.max(result.linear_standard_error))
    assert abs(result.mean_psnr - result.expected_psnr) < 0.1 + 2 * spread
    expected = float(ms.evaluate(known, camera(), shutter).expected_psnr)
    assert result.expected_psnr == pytest.approx(expected, abs=0.02)


CHIPPED = ms.ChippedShutter([0.9, 0.2, 1.0, 0.6, 0.4])
DECODERS = {"ensemble": ms.EnsembleDecoder(), "wiener": ms.WienerDecoder()}


@pytest.mark.slow
@pytest.mark.parametrize("slug", DECODERS)
@pytest.mark.parametrize("kind", ["parabola", "line"])
def test_a_sensor_that_pans_restores_as_one_at_rest_at_shifted_speeds(kind, slug):
    """The model, a decoded capture and a whole photograph; also under an asymmetric shutter."""
    still = camera() if kind == "parabola" else ms.StillCamera(half_exposure=HALF_EXPOSURE)
    panning = still.panned(-1024.0)
    shutter = CHIPPED
    known = [
        ms.Scene(
            speeds,
            [0.2, 0.5, 0.3],
            photon_rate=3e5,
            read_noise=4.0,
            picture=ms.Texture(mean_level=0.5),
        )
        for speeds in (np.array([-1500.0, -900.0, 375.0]), np.array([-476.0, 124.0, 1399.0]))
    ]
    pairs = list(zip(known, (panning, still), strict=True))
    models = [blur_model(x, motion, shutter) for x, motion in pairs]
    jax.tree.map(np.testing.assert_array_equal, *(vars(x) for x in models))
    picture = gaussian_rows(6, 400)
    found = [
        ms.restore_photograph(picture, x, motion, shutter, decoder=DECODERS[slug], num_seeds=1)
        for x, motion in pairs
    ]
    assert found[0].expected_psnr == found[1].expected_psnr
    for name in ("reference", "captured", "restored"):
        first, second = (getattr(result, name) for result in found)
        assert first.size > 0
        np.testing.assert_allclose(first, second, atol=1e-12)
    captures = [
        ms.simulate_capture(picture, x, motion, shutter, speed=float(x.speeds[2]))
        for x, motion in pairs
    ]
    restored = [
        ms.deconvolve(capture, x, motion, shutter, decoder=DECODERS[slug])
        for capture, (x, motion) in zip(captures, pairs, strict=True)
    ]
    np.testing.assert_allclose(*restored, atol=1e-12)


FINE = 8
"""Samples a pixel of a picture that stands for a continuous one."""


def continuous_rows(rows=64, columns=1024, seed=3):
    """Rows of the default spectrum up to 0.5 cycles/px and nothing above, finely sampled."""
    frequency = np.fft.rfftfreq(columns * FINE) * FINE
    power = np.where(frequency <= 0.5, 1 / (frequency**2 + 0.01**2), 0)
    white = np.random.default_rng(seed).standard_normal((rows, columns * FINE))
    coloured = np.fft.irfft(np.fft.rfft(white) * np.sqrt(power * FINE), columns * FINE)
    grid = (np.arange(256) + 0.5) / 512
    return 0.5 + 0.1 * coloured / np.sqrt(np.mean(1 / (grid**2 + 0.01**2)))


def continuous_captures(known, shutter):
    """What pixels collect of the continuous picture at each speed of the scene, with noise.

    A pixel's middle is that of eight fine ones, three and a half beyond the first.
    """
    fine = ms.ParabolicMotion(
        acceleration=FINE * float(camera().acceleration), half_exposure=HALF_EXPOSURE
    )
    picture = continuous_rows()
    for index, speed in enumerate(np.asarray(known.speeds)):
        light = ms.simulate_capture(
            picture,
            known,
            fine,
            shutter,
            speed=FINE * float(speed),
            displacement=(FINE - 1) / 2,
            border="wrap",
        )
        pixels = jnp.mean(light.reshape(len(picture), -1, FINE), axis=2)
        yield np.asarray(noisy(pixels, known, camera(), jax.random.key(index)))


def textbook_filter(known, shutter, columns):
    """The ensemble filter on the grid of a DFT, from transfer functions and nothing else."""
    f = np.fft.rfftfreq(columns)
    responses = []
    for speed in np.asarray(known.speeds):
        wave = ms.transfer_function(shutter, camera(), speed=speed, frequency=jnp.asarray(f))
        to_vertex = np.exp(-2j * np.pi * f * speed**2 / (4 * float(camera().acceleration)))
        responses.append(np.asarray(wave) * to_vertex * np.sinc(f))
    grid = (np.arange(256) + 0.5) / 512
    power = 0.1**2 / (f**2 + 0.01**2) / np.mean(1 / (grid**2 + 0.01**2))
    p = float(known.photon_rate) * float(camera().exposure)
    noise = (float(shutter.efficiency()) * float(known.picture.mean_level) * p + 4.0**2) / p**2
    shares = np.asarray(known.weights)[:, None]
    mean = np.sum(shares * np.conj(responses), axis=0)
    return power * mean / (power * np.sum(shares * np.abs(responses) ** 2, axis=0) + noise)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shutter", "photon_rate"),
    [
        (ms.RectShutter(), 3e4),
        (ms.RectShutter(), 1e8),
        (ms.HannShutter(), 1e6),
        (ms.HannShutter(), 1e8),
    ],
)
def test_a_continuous_picture_leaves_the_error_that_evaluate_expects(shutter, photon_rate):
    """Within 0.15 dB from 600 to 2,000,000 electrons; `deconvolve` within 0.3 dB."""
    known = scene(photon_rate=photon_rate)
    expected = float(ms.evaluate(known, camera(), shutter).expected_psnr)
    truth, judged = continuous_rows()[:, ::FINE], slice(150, -150)
    level, errors = 0.5 * float(shutter.efficiency()), {"textbook": [], "deconvolve": []}
    for captured in continuous_captures(known, shutter):
        gain = textbook_filter(known, shutter, captured.shape[1])
        by_hand = np.fft.irfft(np.fft.rfft(captured - level) * gain, captured.shape[1]) + 0.5
        ours = np.asarray(ms.deconvolve(captured, known, camera(), shutter))
        for name, found in (("textbook", by_hand), ("deconvolve", ours)):
            errors[name].append(np.mean((found - truth)[:, judged] ** 2))
    measured = {n: -10 * np.log10(known.weights @ np.array(e)) for n, e in errors.items()}
    assert abs(measured["textbook"] - expected) < 0.15
    assert abs(measured["deconvolve"] - expected) < 0.3


@pytest.mark.slow
def test_decoders_see_the_same_captures():
    """Restored by each of several decoders, a photograph comes out as by each alone."""
    decoders = {"ensemble": ms.EnsembleDecoder(), "Wiener": ms.WienerDecoder()}
    given = gaussian_rows(6, 400), scene(), camera(), ms.HannShutter()
    together = restore_by_each(*given, decoders, num_seeds=2)
    for name, decoder in decoders.items():
        alone = ms.restore_photograph(*given, decoder=decoder, num_seeds=2)
        assert np.allclose(together[name].psnr, alone.psnr, rtol=1e-12)
        assert np.array_equal(together[name].captured, together["Wiener"].captured)


@pytest.mark.slow
def test_photographs_by_shutters_of_all_kinds_share_their_programs(caplog):
    """Another kind is brought into the form of all others, and another acceleration is a number."""

    def photograph(shutter, acceleration):
        motion = ms.ParabolicMotion(acceleration=acceleration, half_exposure=HALF_EXPOSURE)
        ms.restore_photograph(gaussian_rows(4, 300), scene(), motion, shutter, num_seeds=1)

    most = float(camera().acceleration)
    jax.clear_caches()
    with compiled_programs(caplog) as programs:
        for share, shutter in enumerate((ms.TukeyShutter(0.4), ms.TriangleShutter(), CHIPPED)):
            photograph(shutter, most * (1 - 1e-3 * share))
    assert len({*programs}) == len(programs) <= 11


def test_each_capture_has_noise_of_its_own():
    """Also at a speed that is tried twice; and a key gives the same captures again."""
    given = gaussian_rows(4, 300), scene(), camera(), ms.HannShutter()
    speeds, key = [120.0, 120.0], jax.random.key(5)
    first, again, other = (
        ms.restore_photograph(*given, speeds=speeds, num_seeds=2, key=k).captured
        for k in (key, key, jax.random.key(6))
    )
    np.testing.assert_array_equal(first, again)
    assert np.all(first[0] != first[1])
    assert np.all(first != other)


def test_the_mean_over_speeds_is_by_how_often_they_occur():
    """Of the scene's own speeds; others count alike."""
    known = ms.Scene([0.0, 900.0], [0.85, 0.15], photon_rate=3e5, read_noise=4.0)
    given = gaussian_rows(4, 300), known, camera(), ms.RectShutter()
    for options, weights in (({}, [0.85, 0.15]), ({"speeds": [0.0, 900.0]}, [0.5, 0.5])):
        found = ms.restore_photograph(*given, num_seeds=1, **options)
        mean = np.dot(weights, 10 ** (-found.linear_psnr / 10))
        assert found.mean_psnr == pytest.approx(-10 * np.log10(mean), rel=1e-9)


def test_columns_that_are_judged():
    """The same of the scene for a camera that moves and one at rest, half a kernel inside.

    Those of the mirrored camera are mirrored.
    """
    speeds, still = np.array([0.0, -300.0]), ms.StillCamera(half_exposure=HALF_EXPOSURE)
    judged = []
    down = ms.FreeMotion(accelerations=-camera().acceleration[None], half_exposure=HALF_EXPOSURE)
    for motion in (camera(), still, down):
        assert kernel_layout(motion, *speeds, least_taps=96)[0] == 96
        window, inner = _common_columns(900, motion, speeds, 96, "rows")
        assert window.stop - window.start == 900 - 96 + 1
        assert inner.start >= 48
        assert inner.stop <= window.stop - window.start - 48
        judged.append((window.start + inner.start, window.start + inner.stop))
    assert judged[0] == judged[1] == (900 - judged[2][1], 900 - judged[2][0])


def test_no_noise_without_a_key():
    """A capture without a key is the same every time, and one with a key is not it."""
    rows = gaussian_rows(4, 300)
    plain = [ms.simulate_capture(rows, scene(), camera(), ms.HannShutter()) for _ in range(2)]
    noisy = ms.simulate_capture(rows, scene(), camera(), ms.HannShutter(), key=jax.random.key(5))
    assert jnp.array_equal(*plain)
    electrons = float(scene().photon_rate) * float(camera().exposure)
    variance = np.mean(plain[0]) / electrons + (float(scene().read_noise) / electrons) ** 2
    noise = np.asarray(noisy - plain[0])
    assert np.var(noise) == pytest.approx(variance, rel=5 * np.sqrt(2 / noise.size))


@pytest.mark.parametrize(
    "decoder", [ms.EnsembleDecoder(), ms.WienerDecoder(), ms.RichardsonLucyDecoder()]
)
@pytest.mark.parametrize(
    "motion", [camera(), ms.StillCamera(half_exposure=3e-4)], ids=["moving", "still"]
)
def test_every_decoder_finds_the_photograph(decoder, motion):
    """In good light every decoder brings a still photograph back, on either kind of motion."""
    bright = scene(photon_rate=1e8, picture=ms.Texture(mean_level=0.21, deviation=0.1))
    picture = ms.example_picture().light[100:140]
    found = ms.restore_photograph(
        picture, bright, motion, ms.HannShutter(), decoder=decoder, speeds=[0.0], num_seeds=1
    )
    assert found.psnr[0] > 28
    assert found.restored.shape == found.captured.shape == (1, *found.reference.shape)


@pytest.mark.parametrize(
    ("speeds", "message"),
    [
        ([], "must be one row of at least one speed; got"),
        ([0.0, np.nan], r"`restore_photograph\(speeds=...\)` must be finite; got"),
    ],
)
def test_speeds_that_are_none(speeds, message):
    """They are refused by their name."""
    with pytest.raises(ValueError, match=message):
        ms.restore_photograph(np.ones((4, 300)), scene(), camera(), ms.HannShutter(), speeds=speeds)


class Cropping(ms.AbstractDecoder):
    """One that loses columns."""

    def restore(self, captured, model):
        return captured[..., :-3]


def test_a_decoder_of_ones_own_returns_what_it_was_given():
    """Planes of another shape are refused by the decoder's name."""
    message = r"`Cropping.restore` must return planes of shape \(1, 5, 70\); got \(1, 5, 67\)"
    given = scene(), camera(), ms.HannShutter()
    with pytest.raises(ValueError, match=message):
        ms.deconvolve(np.full((5, 70), 0.2), *given, decoder=Cropping())


@pytest.mark.parametrize("wrong", [Cropping, lambda captured, model: captured, "ensemble"])
def test_what_is_no_decoder(wrong):
    """A class, a function and a name are refused; without any it is the ensemble filter."""
    with pytest.raises(ValueError, match=r"`restore\(decoder=...\)` must be an instance of a dec"):
        decoder_or_ensemble(wrong, "restore")
    assert isinstance(decoder_or_ensemble(None, "restore"), ms.EnsembleDecoder)


def test_no_picture_is_restored_without_light():
    """Nothing can be known of noise on no electrons, and the scene is what says so."""
    message = r"`deconvolve\(scene=...\)` must have a photon rate above 0 e-/s; got 0.0"
    with pytest.raises(ValueError, match=message):
        ms.deconvolve(np.ones((3, 90)), scene(photon_rate=0.0), camera(), ms.HannShutter())


@pytest.mark.slow
def test_of_a_picture_without_detail_nothing_is_expected_to_be_wrong():
    """As in the table of a comparison, not what the smallest of numbers would leave."""
    white, known = np.ones((8, 300, 1)), scene(picture=ms.Texture(mean_level=1.0, deviation=0.0))
    result = ms.restore_photograph(white, known, camera(), ms.HannShutter(), num_seeds=1)
    assert np.isposinf(result.expected_psnr)
    assert np.isposinf(ms.evaluate(known, camera(), ms.HannShutter()).expected_psnr)
    assert np.all(np.isfinite(result.psnr))


@pytest.mark.parametrize("num_seeds", [1, 3])
def test_a_picture_without_an_error_has_an_infinite_level(num_seeds):
    """A black picture without noise is restored exactly: no warning, and an error bar of none."""
    exact = _Errors(np.zeros((num_seeds, 1)), np.full((num_seeds, 1), np.inf))
    wrong = _Errors(np.full((num_seeds, 1), 2e-3), np.full((num_seeds, 1), 27.0))
    levels = levels_of(np.array([0.0, 300.0]), np.array([0.3, 0.7]), [exact, wrong], 0)
    assert levels.psnr.tolist() == [np.inf, 27.0]
    assert levels.linear_psnr[0] == np.inf
    assert np.isnan(levels.linear_standard_error[0])
    assert levels.mean_psnr == pytest.approx(-10 * np.log10(0.7 * 2e-3))
