"""Draw `detail.png`: the power of pictures' rows, and what stands for them in a scene.

Run it as `python docs/figures/detail.py`.
"""

from pathlib import Path

import numpy as np

from mishutter import Texture
from mishutter.model.optics import NUM_FREQUENCIES, frequencies
from mishutter.model.texture import LIKE
from mishutter.pictures.images import row_power_spectrum, shipped_picture
from mishutter.report.plots import draw_grid, new_figure

PHOTOGRAPHS = (
    "astronaut.png",
    "camera.png",
    "chelsea.png",
    "coffee.png",
    "motorcycle_left.png",
    "rocket.jpg",
)
"""Photographs of things, inside scikit-image's package."""


def power(name: str) -> np.ndarray:
    """Power of the rows of a picture, of which the mean is 1."""
    spectrum = row_power_spectrum(shipped_picture(name), NUM_FREQUENCIES).power_spectrum
    return spectrum / np.mean(spectrum)


def main() -> None:
    """Draw the figure and save it beside this script."""
    figure = new_figure(7.0, 4.4)
    axes = figure.add_subplot()
    draw_grid(axes)
    f = np.asarray(frequencies(NUM_FREQUENCIES))
    curve = np.asarray(Texture().spectrum_on_grid(NUM_FREQUENCIES, np.dtype(float)))
    for index, name in enumerate(PHOTOGRAPHS):
        label = None if index else "six photographs"
        axes.loglog(f, power(name), color="0.75", linewidth=0.8, label=label)
    axes.loglog(f, curve / np.mean(curve), color="k", label='"photograph"')
    colours = {"print": "#d55e00", "cells": "#0072b2"}
    for kind, name in LIKE.items():
        axes.loglog(f, power(name), color=colours[kind], label=f'"{kind}", {name}')
    one = {"color": "#0072b2", "linestyle": ":", "linewidth": 1.2}
    axes.loglog(f, power("cell.png"), label="a single cell, cell.png", **one)
    axes.set(
        xlabel="spatial frequency along the rows / (cycles/px)",
        ylabel="power, of a variance of 1",
        xlim=(f[0], 0.5),
        ylim=(1e-4, 200),
    )
    axes.legend(loc="lower left", fontsize="small")
    figure.subplots_adjust(left=0.11, right=0.98, bottom=0.12, top=0.97)
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=110)


if __name__ == "__main__":
    main()
