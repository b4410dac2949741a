"""Figures of quality, each on a case whose answer is known."""

import numpy as np
import pytest

import mishutter as ms

RNG = np.random.default_rng(6)
PICTURE = 0.2 + 0.6 * RNG.random((40, 220, 3))


def test_psnr_of_a_known_error():
    """An error of 0.01 everywhere is 40 dB; with gamma it is that of the coded values."""
    assert ms.psnr(PICTURE, PICTURE + 0.01, gamma=False) == pytest.approx(40)
    coded = np.mean(((PICTURE + 0.01) ** (1 / 2.2) - PICTURE ** (1 / 2.2)) ** 2)
    assert ms.psnr(PICTURE, PICTURE + 0.01) == pytest.approx(-10 * np.log10(coded))
    assert ms.psnr(PICTURE, PICTURE) == np.inf


def test_psnr_of_one_layer():
    """A matte restricts the mean to where the layer is."""
    matte = np.zeros((40, 220))
    matte[5:20, 30:70] = 1
    wrong = np.where(matte[..., None] > 0, PICTURE + 0.1, PICTURE + 0.3)
    assert ms.psnr(PICTURE, wrong, gamma=False, matte=matte) == pytest.approx(20)


def test_border_and_inside():
    """An error at the border alone is in the border's figure and not in the inner one."""
    wrong = PICTURE.copy()
    wrong[:, :9] += 0.1
    figures = ms.measure_quality(PICTURE, wrong, border=9)
    assert figures.inner_psnr == np.inf
    assert figures.inner_ssim == pytest.approx(1)
    assert figures.border_psnr < figures.psnr


def test_ghost_of_known_strength():
    """A copy of amplitude 0.1 at the distance named has energy 0.01, and elsewhere next to none."""
    wide = RNG.random((60, 900))
    ghosted = wide.copy()
    ghosted[:, 47:] += 0.1 * wide[:, :-47]
    assert ms.ghost_energy(wide, ghosted, distance=46.0) == pytest.approx(0.01, rel=0.1)
    assert ms.ghost_energy(wide, ghosted, distance=120.0) < 1e-4
    assert ms.ghost_energy(np.ones((9, 400)), np.ones((9, 400)), distance=20.0) == 0


def test_refusals():
    """What cannot be compared is refused in one line."""
    with pytest.raises(ValueError, match=r"must have shape \(40, 220, 3\)"):
        ms.psnr(PICTURE, PICTURE[1:])
    with pytest.raises(ValueError, match=r"`psnr\(estimate=...\)` must be finite"):
        ms.psnr(PICTURE, PICTURE * np.nan)
    with pytest.raises(ValueError, match="must leave 7 of the 220 columns"):
        ms.measure_quality(PICTURE, PICTURE, border=109)
    with pytest.raises(ValueError, match="must be at least 7 x 7 px"):
        ms.ssim(PICTURE[:3], PICTURE[:3])
    with pytest.raises(ValueError, match=r"matte=...\)` must have shape"):
        ms.psnr(PICTURE, PICTURE, matte=np.zeros((40, 220)))
    with pytest.raises(ValueError, match="must be well below half of 220 px"):
        ms.ghost_energy(PICTURE, PICTURE, distance=108.0)
