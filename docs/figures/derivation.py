"""Draw `derivation.png`: a trajectory, the cells of one tap, and the taps that it produces.

Run it as `python docs/figures/derivation.py`.
"""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

jax.config.update("jax_enable_x64", True)

from mishutter import ParabolicMotion, TukeyShutter, blur_kernel  # noqa: E402

STROKE, HALF_EXPOSURE, NU, TAP, NUM_TAPS = 6.0, 0.01, 0.15, 2, 8
SHUTTER = TukeyShutter(0.5)
BREAKPOINTS = (-1.0, -0.5, 0.5, 1.0)
FILLS = (("0.55", ""), ("0.8", "...."), ("white", "/////"))
"""Colour and hatching of each cell, told apart in grey."""
ARROW = {"arrowstyle": "->", "lw": 0.9}
PLAIN = {"fc": "white", "ec": "none", "pad": 1.5}
"""Ground of a text that hides the lines behind it."""


def transmittance(tau):
    """Transmittance at normalised times, as a NumPy array."""
    return np.asarray(SHUTTER.transmittance(np.asarray(tau, float)))


def kernel():
    """The taps, from the package."""
    acceleration = STROKE / HALF_EXPOSURE**2
    motion = ParabolicMotion(acceleration=acceleration, half_exposure=HALF_EXPOSURE)
    speed = NU * motion.top_speed
    return np.asarray(blur_kernel(SHUTTER, motion, speed=speed, num_taps=NUM_TAPS))


def cells():
    """Begin and end of the cells of the tap, in time; shape `(3, 2)`."""
    inner, outer = np.sqrt(np.array([TAP, TAP + 1]) / STROKE)
    breakpoint = BREAKPOINTS[1]
    before = (NU - outer, breakpoint), (breakpoint, NU - inner)
    return np.array([*before, (NU + inner, NU + outer)])


def position(tau):
    """Position from the vertex, px."""
    return STROKE * (tau - NU) ** 2


def draw_trajectory(axes: Axes):
    """Position against time, with pixel edges, breakpoints and the cells of one tap."""
    for edge in range(NUM_TAPS + 1):
        axes.axhline(edge, color="0.6", lw=0.7, zorder=0)
    for number, ((begin, end), (colour, hatch)) in enumerate(zip(cells(), FILLS, strict=True), 1):
        axes.fill_between([begin, end], TAP, TAP + 1, fc=colour, hatch=hatch, ec="black", lw=0.8)
        axes.text((begin + end) / 2, TAP - 0.12, str(number), ha="center", va="top", bbox=PLAIN)
    for tau, style in ((np.linspace(-1, NU), "-"), (np.linspace(NU, 1), (0, (5, 1.5)))):
        axes.plot(tau, position(tau), color="black", ls=style, lw=2)
    axes.plot(NU, 0, "o", color="black", ms=6, clip_on=False)
    axes.text(NU, 0.5, r"vertex, $\tau = \nu$", ha="center")
    axes.text(-0.66, 4.5, "branch before\nthe vertex", ha="left", va="center", bbox=PLAIN)
    axes.text(0.82, 4.5, "branch after\nthe vertex", ha="right", va="center", bbox=PLAIN)
    axes.text(0.0, 6.5, "breakpoints of\nthe shutter", ha="center", va="center", bbox=PLAIN)
    for breakpoint in BREAKPOINTS[1:3]:
        axes.annotate("", (breakpoint, 6.5), (0.27 * np.sign(breakpoint), 6.5), arrowprops=ARROW)
    axes.text(NU, TAP + 0.5, f"tap {TAP}: three cells", ha="center", va="center")
    for edge in (TAP, TAP + 1):
        text = f"pixel edge $e_{edge}$ = {edge} px"
        axes.text(NU, edge, text, ha="center", va="center", bbox=PLAIN)
    axes.set_ylabel("position from the vertex (px)")
    axes.set_ylim(-0.4, NUM_TAPS + 0.2)


def draw_shutter(axes: Axes):
    """Transmittance against time, with the area of each cell."""
    tau = np.linspace(-1, 1, 401)
    axes.plot(tau, transmittance(tau), color="black", lw=2)
    for number, ((begin, end), (colour, hatch)) in enumerate(zip(cells(), FILLS, strict=True), 1):
        inside = np.linspace(begin, end)
        values = transmittance(inside)
        axes.fill_between(inside, values, fc=colour, hatch=hatch, ec="black", lw=0.8)
        axes.text((begin + end) / 2, np.max(values) + 0.06, str(number), ha="center")
    axes.set_ylabel("transmittance $w$")
    axes.set_ylim(0, 1.3)
    axes.set_xlabel(r"normalised time $\tau = t/T$, from mid-exposure")


def draw_taps(axes: Axes):
    """The taps beside their pixels; that of the cells is the sum of their areas."""
    taps = kernel()
    axes.barh(np.arange(NUM_TAPS) + 0.5, taps, height=1, fc="0.93", ec="black", lw=0.8)
    left = 0.0
    for (begin, end), (colour, hatch) in zip(cells(), FILLS, strict=True):
        share = np.trapezoid(transmittance(np.linspace(begin, end, 2001)), dx=(end - begin) / 2000)
        axes.barh(TAP + 0.5, share / 2, 1, left, fc=colour, hatch=hatch, ec="black", lw=0.8)
        left += share / 2
    np.testing.assert_allclose(left, taps[TAP], rtol=1e-6)
    for index, text in enumerate(("", "", ": cells 1, 2, 3")):
        axes.text(taps[index] + 0.008, index + 0.5, f"$h_{index}${text}", va="center")
    axes.set_xlabel("taps $h_k$: share of a\nfully open exposure")
    axes.set_xlim(0, 1.15 * taps[0])


def main():
    """Draw the figure and save it beside this script."""
    plt.rcParams.update({"font.size": 11, "hatch.linewidth": 0.7})
    figure = plt.figure(figsize=(8, 6.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(2.6, 1), height_ratios=(2.5, 1))
    trajectory = figure.add_subplot(grid[0, 0])
    shutter = figure.add_subplot(grid[1, 0], sharex=trajectory)
    taps = figure.add_subplot(grid[0, 1], sharey=trajectory)
    draw_trajectory(trajectory)
    draw_shutter(shutter)
    draw_taps(taps)
    for axes in (trajectory, shutter):
        for breakpoint in BREAKPOINTS:
            axes.axvline(breakpoint, color="black", ls=":", lw=1.2, zorder=0)
    trajectory.set_xlim(-1.06, 1.06)
    trajectory.tick_params(labelbottom=False)
    key = figure.add_subplot(grid[1, 1])
    key.axis("off")
    text = f"$h_{TAP}$ = half the sum\nof the areas 1, 2, 3\nunder $w(\\tau)$"
    key.text(0.5, 0.5, text, ha="center", va="center", transform=key.transAxes)
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=125)


if __name__ == "__main__":
    main()
