"""What frames tell before a motion is looked for."""

import numpy as np
import pytest

from mishutter.decoding.likeliest import detail_of


@pytest.mark.parametrize("shape", [(1024,), (256, 1024)])
def test_detail_is_told_where_it_is(shape):
    """Pictures with 0.1/f of the expected power at the frequency f, in two frames with noise."""
    random = np.random.default_rng(5)
    down, across = np.fft.fftfreq(256)[:, None], np.fft.rfftfreq(1024)
    radius = np.hypot(down, across) if len(shape) == 2 else across[None]
    white = np.fft.rfft2(random.normal(size=(256, 1024)))
    picture = np.fft.irfft2(white * np.sqrt(0.1 / np.maximum(radius, 1e-3)), (256, 1024))
    noises = np.array([0.2, 0.5])
    frames = picture + np.sqrt(noises)[:, None, None] * random.normal(size=(2, 256, 1024))
    expected = np.full((*shape[:-1], 513), np.sum(1 / noises))
    told = detail_of(frames, noises, shape, expected, 0.04)
    assert told.radius.size >= 5
    np.testing.assert_allclose(told.scale, 0.1 / told.radius, rtol=0.15)
