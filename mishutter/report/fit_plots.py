"""Pictures of a camera that was fitted to measurements: residuals and the fitted profile."""

import itertools
from typing import TYPE_CHECKING

import numpy as np

from mishutter.hardware.calibration.estimation import FittedCamera
from mishutter.model.shutters.base import AbstractShutter
from mishutter.report.plots import leave_room, line_styles, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plot_fit(camera: FittedCamera, sent: AbstractShutter) -> "Figure":
    """Levels and residuals of each picture, and the profile beside the one that was sent."""
    count = len(camera.levels)
    figure = new_figure(9.0, 1.8 * count + 3.0)
    leave_room(figure, top=0.3, rows=0.55, num_rows=count + 1, num_columns=2)
    grid = figure.add_gridspec(count + 1, 2, height_ratios=[1.0] * count + [2.0])
    first, second = itertools.islice(line_styles(), 2)
    each = zip(camera.levels, camera.expected, camera.noise, strict=True)
    for index, (levels, expected, noise) in enumerate(each):
        left, right = (figure.add_subplot(grid[index, column]) for column in (0, 1))
        left.plot(levels, ".", color="0.55", markersize=3, label="recorded")
        left.plot(expected, label="fitted", **first)
        left.set_ylabel(f"{index}: level")
        right.plot((levels - expected) / noise, ".", color="0.2", markersize=3)
        right.axhline(0, color="0.6", linewidth=0.8)
        right.set(ylabel="residual / noise", ylim=(-5, 5))
        if index == 0:
            left.legend(fontsize=8)
            left.set_title("rows of each picture", fontsize=9)
            doubt = " (implausible)" * bool(camera.doubt)
            chi = f"chi squared {camera.reduced_chi_squared:.3g} for each free level{doubt}"
            right.set_title(f"residuals: {chi}", fontsize=9)
        if index == count - 1:
            left.set_xlabel("column / px")
            right.set_xlabel("column / px")
    bottom = figure.add_subplot(grid[count, :])
    tau = np.linspace(-1, 1, 401)
    time = tau * float(camera.motion.half_exposure) * 1e3
    bottom.plot(time, np.asarray(camera.shutter.transmittance(tau)), label="as built", **first)
    bottom.plot(time, np.asarray(sent.transmittance(tau)), label="as sent", **second)
    low, high = camera.band(tau)
    bottom.fill_between(time, low, high, color="0.8", label="two error bars")
    bottom.set(xlabel="time from mid-exposure / ms", ylabel="transmittance", ylim=(-0.02, 1.05))
    bottom.legend(fontsize=8)
    return figure
