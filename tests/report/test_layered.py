"""A background and an object in front of it: where each is judged, what a filter makes of both."""

import numpy as np
import pytest

import mishutter as ms
from mishutter.design.design import given_design
from mishutter.report import plots

# Steps of one picture: a report that shows it compares cameras for minutes first.
from mishutter.report.backgrounds import BackgroundGain, before_still_background
from mishutter.report.comparison import Comparison
from mishutter.report.documents import Report, _layered
from mishutter.report.layered import _displaced, _placed, _swept, layered_captures, layered_scene
from mishutter.search.rows import BEST_SNAPSHOT, OWN_BEST_MOTION, Row

HALF = 0.009
MOTION = ms.ParabolicMotion(acceleration=24 / HALF**2, half_exposure=HALF)
SPEED = 1500.0


def scene(photon_rate):
    return ms.Scene.uniform(
        max_speed=SPEED,
        num_speeds=5,
        photon_rate=photon_rate,
        read_noise=2.0,
        picture=ms.Texture(mean_level=0.3),
    )


OPEN_SHUTTER = "open shutter"
CAMERAS = {
    "Hann": (MOTION, ms.HannShutter()),
    OPEN_SHUTTER: (ms.StillCamera(half_exposure=HALF), ms.RectShutter()),
    "snapshot": (ms.StillCamera(half_exposure=1.2e-3), ms.RectShutter()),
}


def seen(num_rows=40, background_speed=0.0):
    rows = ms.example_picture().light[100 : 100 + num_rows, 100:420]
    return layered_scene(ms.Picture(rows.astype(np.float64)), background_speed, SPEED)


def captures(photon_rate, *names, before=None):
    known = scene(photon_rate)
    layers = seen() if before is None else before
    if before is not None:
        known = before_still_background(known, 0.7)
    rows = {}
    for name in names:
        motion, shutter = CAMERAS[name]
        metrics = ms.evaluate(scene(photon_rate), motion, shutter)
        rows[name] = Row("own best motion", name, shutter, motion, None, metrics)
    return layered_captures(layers, known, rows)


@pytest.mark.slow
def test_one_filter_restores_what_stands_and_what_moves():
    """In plenty of light both come back; of an open shutter at rest only what stands does."""
    found = captures(3e8, "Hann", OPEN_SHUTTER)
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
@pytest.mark.parametrize("background_speed", [0.0, -700.0])
def test_layers_come_back_as_well_as_is_expected(background_speed):
    """By the same filter, of two layers with these speeds: a moving camera's, and a snapshot's."""
    layers = seen(128, background_speed)
    for each in captures(2e5, "Hann", "snapshot", before=layers).values():
        assert each.psnr == pytest.approx(each.expected_psnr, abs=0.4)


@pytest.mark.slow
def test_a_picture_without_detail_is_restored_to_its_noise():
    """Of layers without texture nothing but noise is left, as is expected."""
    flat = layered_scene(ms.Picture(np.full((40, 320, 1), 0.3)), 0.0, SPEED)
    found = captures(2e5, "snapshot", before=flat)["snapshot"]
    assert found.psnr == pytest.approx(found.expected_psnr, abs=0.2)


@pytest.mark.slow
def test_light_decides():
    """The same capture in a thousandth of the light comes back worse, behind and in front."""
    bright, dim = captures(3e8, "Hann")["Hann"], captures(3e5, "Hann")["Hann"]
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


@pytest.mark.slow
def test_the_picture_of_layers_names_speeds_and_levels():
    """Each camera has a column: captured, and restored with its PSNR beside that expected."""
    found = captures(3e8, "Hann", OPEN_SHUTTER)
    figure = plots.plot_layers(seen(), found, whole=True)
    world = "An object before a still background"
    verdict = "the verdict is about a picture that moves as a whole; this one does not"
    assert figure.get_suptitle() == f"{world}: {verdict}"
    assert plots.plot_layers(seen(), found).get_suptitle() == world
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[0] == "the scene: 0 px/s behind,\n1500 px/s in front, outlined"
    levels = [
        f"expected {each.expected_psnr:.1f} dB, restored {each.psnr:.1f} dB\n"
        f"behind {each.background_psnr:.1f} dB, in front {each.object_psnr:.1f} dB"
        for each in found.values()
    ]
    assert titles[-len(levels) :] == levels
    with pytest.raises(ValueError, match=r"plot_layers\(captures=...\)` must hold a capture"):
        plots.plot_layers(seen(), {})


@pytest.mark.slow
def test_a_report_shows_the_camera_for_the_background():
    """The design of the verdict and its snapshot stand beside the best camera for this world."""
    known = ms.Scene(
        [0.0, SPEED], photon_rate=2e5, read_noise=2.0, picture=ms.Texture(path="example")
    )
    cameras = {"optimised": CAMERAS["Hann"], BEST_SNAPSHOT: CAMERAS["snapshot"]}
    rows = {
        name: Row(OWN_BEST_MOTION, name, shutter, motion, None, ms.evaluate(known, motion, shutter))
        for name, (motion, shutter) in cameras.items()
    }
    snapshot = given_design(known, *CAMERAS["snapshot"], origin="the best snapshot")
    gains = (BackgroundGain(0.5, 0.3), BackgroundGain(0.7, 0.0, snapshot))
    table = Comparison(tuple(rows.values()), "A verdict.", 0.1, 31.0)
    figure = _layered(Report(known, table, ("optimised",), backgrounds=gains), rows)
    titles = [axes.get_title().split(",")[0] for axes in figure.axes]
    assert titles[1:4] == ["optimised", BEST_SNAPSHOT, "snapshot for this"]


def test_an_object_hides_what_is_behind_it_by_its_matte():
    """The background shows through a soft matte, and not at all where that is 1."""
    ground, front = np.full((6, 9, 1), 0.3), np.full((2, 3, 1), 0.8)
    matte = np.array([[1.0, 0.25, 0.5], [0.75, 0.0, 1.0]])
    layers = ms.Layers(
        (
            ms.Layer(ms.Picture(ground)),
            ms.Layer(ms.Picture(front, matte=matte), 300.0, left=4, top=1),
        )
    )
    picture, shown = _placed(layers, (0.0, 0.0))
    np.testing.assert_allclose(shown[1:3, 4:7], matte, atol=1e-6)
    wanted = ground.copy()
    wanted[1:3, 4:7, 0] = 0.3 + 0.5 * matte
    np.testing.assert_allclose(picture, wanted, atol=1e-6)
