"""A background and an object in front of it: where each is judged, what a filter makes of both."""

import numpy as np
import pytest

import mishutter as ms
from mishutter.report import plots
from mishutter.report.layered import (
    OPEN_SHUTTER,
    _displaced,
    _swept,
    layered_captures,
    layered_scene,
)
from mishutter.search import Row

HALF = 0.009
MOTION = ms.ParabolicMotion(acceleration=24 / HALF**2, half_exposure=HALF)
SPEED = 1500.0


def scene(photon_rate):
    return ms.Scene.uniform(
        max_speed=SPEED, num_speeds=5, photon_rate=photon_rate, read_noise=2.0, mean_level=0.3
    )


def seen():
    picture = ms.Picture(ms.example_picture().light[100:140, 100:420].astype(np.float64))
    return layered_scene(picture, 0.0, SPEED)


def captures(photon_rate):
    known = scene(photon_rate)
    metrics = ms.evaluate(known, MOTION, ms.HannShutter())
    row = Row("own best motion", "Hann", ms.HannShutter(), MOTION, None, metrics)
    return layered_captures(seen(), known, {"Hann": row})


@pytest.mark.slow
def test_one_filter_restores_what_stands_and_what_moves():
    """In plenty of light both come back; of an open shutter at rest only what stands does."""
    found = captures(3e8)
    assert set(found) == {"Hann", OPEN_SHUTTER}
    assert found[OPEN_SHUTTER].exposure == pytest.approx(2 * HALF)
    assert found["Hann"].background_psnr > 28
    assert found["Hann"].object_psnr > 28
    assert found[OPEN_SHUTTER].object_psnr < found["Hann"].object_psnr - 4


@pytest.mark.parametrize("shape", [(1, 40, 1), (9, 150, 1), (3, 7, 3)])
def test_small_and_grey_pictures_make_a_scene(shape):
    """The object is as grey as what is behind it, and no larger."""
    made = layered_scene(ms.Picture(np.full(shape, 0.3)), 0.0, SPEED)
    assert made.truth.shape == shape
    assert made.layers.shape == shape
    assert np.all(np.isfinite(made.truth))


@pytest.mark.slow
def test_light_decides():
    """The same capture in a thousandth of the light comes back worse, behind and in front."""
    bright, dim = captures(3e8)["Hann"], captures(3e5)["Hann"]
    assert dim.background_psnr < bright.background_psnr - 1
    assert dim.object_psnr < bright.object_psnr - 1


def test_a_displaced_picture_is_that_of_its_waves():
    """By whole pixels it is a roll, by halves the wave between the pixels."""
    columns = 40
    wave = np.cos(2 * np.pi * 3 * np.arange(columns) / columns)[None, :, None]
    np.testing.assert_allclose(_displaced(wave, 7.0), np.roll(wave, 7, axis=1), atol=1e-12)
    between = np.cos(2 * np.pi * 3 * (np.arange(columns) - 0.5) / columns)[None, :, None]
    np.testing.assert_allclose(_displaced(wave, 0.5), between, atol=1e-12)


def test_the_background_is_judged_where_the_object_never_is():
    """A column that goes from -2.5 to 3.2 px covers these and one more at either end."""
    matte = np.zeros((1, 21))
    matte[0, 10] = 0.4
    covered = np.flatnonzero(_swept(matte, -2.5, 3.2)[0])
    np.testing.assert_array_equal(covered, np.arange(10 - 4, 10 + 6))


def test_the_picture_of_layers_names_speeds_and_levels():
    """Each camera has a column, captured above restored, with the PSNR of both layers."""
    found = captures(3e8)
    figure = plots.plot_layers(seen(), found)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[0] == "the scene: 0 px/s behind,\n1500 px/s in front"
    levels = [
        f"behind {each.background_psnr:.1f} dB, in front {each.object_psnr:.1f} dB"
        for each in found.values()
    ]
    assert [t.splitlines()[1] for t in titles if t.startswith("restored")] == levels
    with pytest.raises(ValueError, match=r"plot_layers\(captures=...\)` must hold a capture"):
        plots.plot_layers(seen(), {})
