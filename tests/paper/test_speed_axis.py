"""The paper's speed axis by its two readings, and the speeds that a photograph is restored at."""

import numpy as np

import mishutter as ms
from mishutter.paper import capture, reproduction
from mishutter.pictures.images import Picture

SMALL = Picture(ms.example_picture().light[200:206, :190])


class Restored:
    """A restoration whose levels are the speeds s/(2aT)."""

    def __init__(self, *camera, **_):
        self.psnr = np.array(camera[2])


def test_a_reading_scales_the_axis(monkeypatch):
    """A speed s/(aT) of 1 is half of the top speed 2aT; one of s/(2aT) is the top speed."""
    monkeypatch.setattr(capture, "restored", Restored)
    numbers = capture.plain_numbers({"a": SMALL}, {"rect": ms.RectShutter()}, (0.2, 0.3))
    assert numbers["speed"] == [0.2, 0.3]
    levels = {reading: of["a"]["rect"] for reading, of in numbers["psnr"].items()}
    assert levels == {"s/(aT)": [0.1, 0.15], "s/(2aT)": [0.2, 0.3]}


def test_so_it_does_in_the_figure_over_speed(monkeypatch):
    """Each reading takes its own of the speeds that were restored, in the axis's order."""
    monkeypatch.setattr(reproduction, "restored", Restored)
    shutters = {"rect": ms.RectShutter()}
    numbers = reproduction._figure_6_numbers(shutters, {"a": SMALL}, lambda *_: None, quick=True)
    axis = np.array(numbers["speed"])
    assert axis.size > 1
    for reading, scale in (("s/(aT)", 0.5), ("s/(2aT)", 1.0)):
        found = numbers["psnr_over_speed"][reading]["a"]["rect"]
        np.testing.assert_allclose(found, axis * scale, rtol=1e-12)


def test_a_photograph_is_restored_at_shares_of_the_top_speed():
    """By the photograph's own statistics and the electrons that are told, in the middle's order."""
    motion = capture.camera(17.0)
    assert float(motion.top_speed) == 2 * 17.0 / capture.HALF_EXPOSURE
    found = capture.restored(SMALL, ms.HannShutter(), [0.05, 0.3], decoder=ms.EnsembleDecoder())
    np.testing.assert_allclose(found.speeds, np.array([0.05, 0.3]) * 2 * 34 / 0.01, rtol=1e-12)
    scene = ms.Scene(
        [0.0], photon_rate=1e4 / 0.02, read_noise=10.0, picture=ms.Texture.of_photograph(SMALL)
    )
    camera = capture.camera(), ms.HannShutter()
    (wanted,) = ms.restore_photograph(
        SMALL, scene, *camera, decoder=ms.EnsembleDecoder(), speeds=[2040.0], num_seeds=1
    ).linear_psnr
    assert abs(found.linear_psnr[1] - wanted) < 0.5
