"""The paper's statements, held against what the reproduction finds.

Pinned are the numbers that need no photograph, and the whole page.
"""

import json

import pytest

import mishutter as ms
from mishutter import cli

# Single figures of the reproduction, which itself computes every one of them for minutes.
from mishutter.paper.reproduction import kernel_numbers, spectrum_numbers

WINDOWS = {"rect": ms.RectShutter(), "hann": ms.HannShutter()}


def test_condition_numbers_of_figure_4():
    """4.44, 9.27 and 19.57, each to 0.01, at a stroke of 45 px and phase 0."""
    found = spectrum_numbers(WINDOWS)["condition"]
    assert found["motion invariant, Hann"] == pytest.approx(4.44, abs=0.01)
    assert found["motion invariant, rect"] == pytest.approx(9.27, abs=0.01)
    assert found["flutter shutter"] == pytest.approx(19.57, abs=0.01)


def test_kernel_difference_of_figure_3():
    """Hann stays under rect over the whole axis by one reading, and crosses it by the other."""
    rms = kernel_numbers(WINDOWS)["rms"]
    below = {
        reading: all(h < r for h, r in zip(v["hann"][1:], v["rect"][1:], strict=True))
        for reading, v in rms.items()
    }
    assert below == {"s/(aT)": True, "s/(2aT)": False}


def test_the_page(tmp_path):
    """Figures, numbers and page are written; by the likelier reading Hann gains 3 dB and more."""
    assert cli.main(["reproduce", "--quick", "--out", str(tmp_path)]) == 0
    names = {p.name for p in tmp_path.iterdir()}
    assert names == {*(f"figure_{n}.png" for n in (3, 4, 5, 6)), "figures.json", "REPRODUCTION.md"}
    numbers = json.loads((tmp_path / "figures.json").read_text("utf-8"))
    met = {s["claim"]: s["met"] for s in numbers["statements"]}
    assert met["Smooth windows within 1 dB (camera, s/(aT))"]
    levels = numbers["figure_5"]["s/(aT)"]["camera"]["psnr"]
    assert levels["hann"][-1] > levels["rect"][-1] + 3
    page = (tmp_path / "REPRODUCTION.md").read_text("utf-8")
    assert all(s["claim"] in page and s["found"] in page for s in numbers["statements"])
