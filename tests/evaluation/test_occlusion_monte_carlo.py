"""The expected error of objects before a background, against random rows that know no formula.

Rows of textures and mattes are composited, exposed instant by instant and restored. The filter
leaves of them what plain sums over all frequencies of the matte expect, within the standard error;
and `evaluate` agrees with these sums far more closely.
"""

from functools import lru_cache

import numpy as np
import pytest
from support import layered_rows

from mishutter import (
    HannShutter,
    Occlusion,
    ParabolicMotion,
    RectShutter,
    Scene,
    StillCamera,
    evaluate,
)

FREQUENCY = np.linspace(0, 0.5, 129)
SPEEDS = (-2900.0, 700.0, 3700.0)
READ_NOISE = 7.0
ERRORS = 3.0
"""Standard errors within which a measured error is that expected."""
CLOSE = 4e-4
"""dB: `evaluate` takes its integrals over the matte by finitely many speeds."""


def parabola(stroke, half):
    return ParabolicMotion(acceleration=stroke / half**2, half_exposure=half)


CASES = {
    "snapshot": (StillCamera(half_exposure=1.3e-3), RectShutter(), 0.6, 70.0, 3e5, "moving"),
    "hann": (parabola(41.0, 8e-3), HannShutter(), 0.35, 110.0, 1e5, "still"),
    "open": (parabola(27.0, 9e-3), RectShutter(), 0.55, 35.0, 2e5, "moving"),
}
every_case = pytest.mark.parametrize("name", CASES)


def pairs_of(background):
    return [(b, f) for b in (SPEEDS if background == "moving" else (0.0,)) for f in SPEEDS]


def seen(name):
    """Camera, pairs of speeds and variance of the noise of a case."""
    motion, shutter, _, _, rate, background = CASES[name]
    camera = layered_rows.camera(motion, shutter, max(map(abs, SPEEDS)))
    return camera, pairs_of(background), camera.noise(rate, READ_NOISE)


@lru_cache
def best_filter(name):
    """The filter of a case by plain sums."""
    _, _, share, width, _, _ = CASES[name]
    return layered_rows.best_filter(
        layered_rows.random_spectra(share, width, FREQUENCY), *seen(name)
    )


@pytest.mark.slow
@every_case
def test_rows_are_restored_as_well_as_expected(name):
    """The error that the best filter leaves of random rows is the expected one."""
    _, _, share, width, _, _ = CASES[name]
    camera, pairs, noise = seen(name)
    random, count = np.random.default_rng(5), 18 // len(pairs)
    found = layered_rows.measure(
        random, camera, pairs, share, width, noise, count, known=best_filter(name)
    )
    assert abs(found.psnr - found.expected) < ERRORS * found.standard_error
    assert found.standard_error < 0.2


@pytest.mark.slow
@every_case
def test_the_expected_error_is_that_of_the_sums(name):
    """`evaluate` says of the scene what the filter for random rows is expected to leave."""
    motion, shutter, share, width, rate, background = CASES[name]
    occlusion = Occlusion(front_share=share, object_width=width, background=background)
    scene = Scene(SPEEDS, photon_rate=rate, read_noise=READ_NOISE, occlusion=occlusion)
    expected = float(evaluate(scene, motion, shutter).expected_psnr)
    assert abs(expected + 10 * np.log10(best_filter(name).error)) < CLOSE


def test_a_matte_has_the_share_and_the_width_that_it_is_drawn_for():
    """Objects of exponential widths cover their share, and their runs have their mean length."""
    random, share, width, period = np.random.default_rng(3), 0.35, 40.0, 4096
    runs, covered = [], []
    for _ in range(200):
        left, right = layered_rows.matte_edges(random, share, width, period)
        assert np.all(right > left)
        assert np.all(left[1:] > right[:-1])
        assert left.size == 0 or right[-1] - period < left[0] or right[-1] - left[0] == period
        runs.extend(right - left)
        covered.append(np.sum(right - left) / period)
    assert abs(np.mean(covered) - share) < ERRORS * np.std(covered) / np.sqrt(len(covered))
    assert abs(np.mean(runs) - width) < ERRORS * width / np.sqrt(len(runs))


def test_a_composite_is_that_of_its_edges():
    """The spectrum of the wanted picture is that of a composite on a far finer grid."""
    random, period, finer = np.random.default_rng(11), 256, 64
    rows = layered_rows.random_rows(random, 0.4, 30.0, 1, period)
    still = layered_rows.camera(StillCamera(half_exposure=1e-3), RectShutter(), 0.0)
    found = layered_rows.wanted(rows, still, (0.0, 0.0))[0]

    random = np.random.default_rng(11)
    back, front = (layered_rows.random_textures(random, 1, period)[0] for _ in range(2))
    left, right = layered_rows.matte_edges(random, 0.4, 30.0, period)
    x = (np.arange(period * finer) + 0.5) / finer
    inside = sum(
        (((x - a) % period) < b - a).astype(float) for a, b in zip(left, right, strict=True)
    )
    waves = np.exp(2j * np.pi * np.multiply.outer(x, np.arange(period // 2) / period))
    light = [
        2 * (waves @ y[: period // 2]).real / period - y[0].real / period for y in (back, front)
    ]
    whole = np.where(inside, light[1], light[0])
    wanted = np.conj(waves.T) @ whole / finer
    assert np.max(np.abs(found[:-1] - wanted)) < 0.02 * np.max(np.abs(wanted))
