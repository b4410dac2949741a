"""A photograph through the camera and back, measured against the closed form.

Pinned on synthetic rows whose power spectrum is exactly the one assumed, because only
there do theory and measurement speak of the same thing.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mishutter as ms
from mishutter.restoration import restore_by_each

HALF_EXPOSURE = 0.01
STROKE = 34.0


def camera(stroke=STROKE):
    return ms.ParabolicMotion(acceleration=stroke / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)


def scene(**others):
    top = 2 * STROKE / HALF_EXPOSURE
    values = {"photon_rate": 3e5, "read_noise": 4.0, "mean_level": 0.5, "deviation": 0.1}
    return ms.Scene.uniform(max_speed=0.3 * top, num_speeds=5, **{**values, **others})


def gaussian_rows(rows=96, columns=1200, seed=3):
    """Rows of the default spectrum: mean 0.5, deviation 0.1."""
    frequency = np.fft.rfftfreq(columns)
    power = 1 / (frequency**2 + 0.01**2)
    white = np.random.default_rng(seed).standard_normal((rows, columns))
    coloured = np.fft.irfft(np.fft.rfft(white) * np.sqrt(power), columns)
    grid = (np.arange(256) + 0.5) / 512
    coloured /= np.sqrt(np.mean(1 / (grid**2 + 0.01**2)))
    return np.maximum(0.5 + 0.1 * coloured, 0)[..., None]


@pytest.mark.parametrize("shutter", [ms.RectShutter(), ms.HannShutter()], ids=["rect", "hann"])
@pytest.mark.parametrize("photon_rate", [3e4, 3e5, 1e7])
def test_measured_error_is_the_expected_one(shutter, photon_rate):
    """The ensemble filter leaves the error of its closed form, within 0.1 dB and the noise."""
    known = scene(photon_rate=photon_rate)
    result = ms.restore_photograph(gaussian_rows(), known, camera(), shutter, num_seeds=2)
    spread = float(np.max(result.linear_standard_error))
    assert abs(result.mean_psnr - result.expected_psnr) < 0.1 + 2 * spread


@pytest.mark.parametrize("photon_rate", [3e4, 1e5])
def test_a_continuous_picture_is_expected_to_come_out_alike(photon_rate):
    """In moderate light `evaluate`'s expectation, without the samples' aliases, is as near."""
    known = scene(photon_rate=photon_rate)
    result = ms.restore_photograph(gaussian_rows(), known, camera(), ms.HannShutter(), num_seeds=2)
    expected = float(ms.evaluate(known, camera(), ms.HannShutter()).expected_psnr)
    assert abs(result.mean_psnr - expected) < 0.3


def test_decoders_see_the_same_captures():
    """Restored by each of several decoders, a photograph comes out as by each alone."""
    decoders = {"ensemble": ms.EnsembleDecoder(), "Wiener": ms.WienerDecoder()}
    given = gaussian_rows(6, 400), scene(), camera(), ms.HannShutter()
    together = restore_by_each(*given, decoders, num_seeds=2)
    for name, decoder in decoders.items():
        alone = ms.restore_photograph(*given, decoder=decoder, num_seeds=2)
        assert np.allclose(together[name].psnr, alone.psnr, rtol=1e-12)
        assert np.array_equal(together[name].captured, together["Wiener"].captured)


def test_no_noise_without_a_key():
    """A capture without a key is the same every time, and one with a key is not it."""
    rows = gaussian_rows(4, 300)
    plain = [ms.simulate_capture(rows, scene(), camera(), ms.HannShutter()) for _ in range(2)]
    noisy = ms.simulate_capture(rows, scene(), camera(), ms.HannShutter(), key=jax.random.key(5))
    assert jnp.array_equal(*plain)
    assert 1e-3 < float(jnp.std(noisy - plain[0])) < 0.1


@pytest.mark.parametrize(
    "decoder", [ms.EnsembleDecoder(), ms.WienerDecoder(), ms.RichardsonLucyDecoder()]
)
@pytest.mark.parametrize(
    "motion", [camera(), ms.StillCamera(half_exposure=3e-4)], ids=["moving", "still"]
)
def test_every_decoder_finds_the_photograph(decoder, motion):
    """In good light every decoder brings a still photograph back, on either kind of motion."""
    bright = scene(photon_rate=1e8, mean_level=0.21)
    picture = ms.example_picture().light[100:140]
    found = ms.restore_photograph(
        picture, bright, motion, ms.HannShutter(), decoder=decoder, speeds=[0.0], num_seeds=1
    )
    assert found.psnr[0] > 28
    assert found.restored.shape == found.captured.shape == (1, *found.reference.shape)
