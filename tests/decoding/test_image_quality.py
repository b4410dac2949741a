"""Figures of quality, each on a case whose answer is known."""

import numpy as np
import pytest

import mishutter as ms
from mishutter.decoding.image_quality import ghost_energy

RNG = np.random.default_rng(6)
PICTURE = 0.2 + 0.6 * RNG.random((40, 220, 3))


def test_psnr_of_a_known_error():
    """An error of 0.01 everywhere is 40 dB, as light is; with gamma it is of the coded values."""
    for linear in ({}, {"gamma": False}):
        assert ms.psnr(PICTURE, PICTURE + 0.01, **linear) == pytest.approx(40)
    coded = np.mean(((PICTURE + 0.01) ** (1 / 2.2) - PICTURE ** (1 / 2.2)) ** 2)
    assert ms.psnr(PICTURE, PICTURE + 0.01, gamma=True) == pytest.approx(-10 * np.log10(coded))
    assert ms.psnr(PICTURE, PICTURE) == np.inf


def test_psnr_of_one_layer():
    """A matte restricts the mean to where the layer is."""
    matte = np.zeros((40, 220))
    matte[5:20, 30:70] = 1
    wrong = np.where(matte[..., None] > 0, PICTURE + 0.1, PICTURE + 0.3)
    assert ms.psnr(PICTURE, wrong, matte=matte) == pytest.approx(20)


def test_ghost_of_known_strength():
    """A copy of amplitude 0.1 at the distance named, to either side, has energy 0.01.

    It lacks the last 47 of the 1,799 differences of a row.
    """
    wide = RNG.random((600, 1800))
    ghosted = wide.copy()
    ghosted[:, 47:] += 0.1 * wide[:, :-47]
    for way in (np.s_[:, :], np.s_[:, ::-1]):
        energy = ghost_energy(wide[way], ghosted[way], distance=46.0)
        assert energy == pytest.approx(0.01 * (1752 / 1799) ** 2, rel=5e-3)
    assert ghost_energy(wide, ghosted, distance=120.0) < 1e-4
    assert ghost_energy(np.ones((9, 400)), np.ones((9, 400)), distance=20.0) == 0


def test_refusals():
    """What cannot be compared is refused in one line."""
    with pytest.raises(ValueError, match=r"must have shape \(40, 220, 3\)"):
        ms.psnr(PICTURE, PICTURE[1:])
    with pytest.raises(ValueError, match=r"`psnr\(estimate=...\)` must be finite"):
        ms.psnr(PICTURE, PICTURE * np.nan)
    with pytest.raises(ValueError, match=r"`psnr\(matte=...\)` must have shape"):
        ms.psnr(PICTURE, PICTURE, matte=np.zeros((40, 220)))
    with pytest.raises(ValueError, match="must be well below half of 220 px"):
        ghost_energy(PICTURE, PICTURE, distance=108.0)
    for distance, requirement in ((np.nan, "finite; got nan"), (-9.0, "at least 0 px; got -9.0")):
        with pytest.raises(ValueError, match=rf"distance=...\)` must be {requirement}"):
            ghost_energy(PICTURE, PICTURE, distance=distance)


@pytest.mark.parametrize("shape", [(220,), (2, 40, 220, 3)])
def test_ghosts_of_what_is_no_picture_are_refused(shape):
    """A single row has no second side, and a stack of pictures would be taken for its channels."""
    light = RNG.random(shape)
    named = r"`ghost_energy\(reference=...\)` must have rows and columns, or channels after"
    with pytest.raises(ValueError, match=named):
        ghost_energy(light, light, distance=46.0)


@pytest.mark.parametrize("width", [-2, -1])
def test_a_ghost_is_looked_for_somewhere(width):
    """A width below 0 leaves no displacement to look at, and is refused."""
    with pytest.raises(ValueError, match=r"width=...\)` must be at least 0 px; got"):
        ghost_energy(PICTURE, PICTURE, distance=46.0, width=width)
