"""Draw `rolling.png`: when rows are exposed, where the sensor is then, and what moves in them.

Run it as `python docs/figures/rolling.py`.
"""

from pathlib import Path

import matplotlib as mpl

mpl.use("agg")

import matplotlib.pyplot as plt
import numpy as np
from skimage import data

from mishutter import (
    FreeMotion,
    Limits,
    ParabolicMotion,
    Scene,
    Sensor,
    StillCamera,
    TimedFrame,
    simulate_frames,
)
from mishutter.model.exposures import Exposures

PERIOD, READOUT, STROKE = 0.02, 0.015, 54.6
LIGHT = {"photon_rate": 1e5, "read_noise": 8.0}


def frames():
    """Four frames on parabolas of alternating direction."""
    every, rate = [], STROKE / 2 / (PERIOD / 2) ** 2
    for k in range(4):
        motion = ParabolicMotion(acceleration=rate, half_exposure=PERIOD / 2)
        if k % 2:
            motion = FreeMotion(accelerations=[-rate], half_exposure=PERIOD / 2)
        every.append(TimedFrame(motion, (k - 1.5) * PERIOD, (k % 2 - 0.5) * STROKE))
    return every


def main():
    """Draw the figure and save it beside this script."""
    figure = plt.figure(figsize=(13, 4.2), layout="constrained")
    left, middle, *right = figure.subplot_mosaic(
        "aabcd;aabcd", width_ratios=[1, 1, 1.4, 1, 1]
    ).values()
    colours = plt.get_cmap("viridis")(np.linspace(0.05, 0.8, 4))
    half = 1e3 * READOUT / 2
    for k, colour in enumerate(colours):
        begin, end = (1e3 * (k - 1.5 + side) * PERIOD for side in (-0.5, 0.5))
        corners = [(begin - half, 0), (end - half, 0), (end + half, 1), (begin + half, 1)]
        left.add_patch(plt.Polygon(corners, color=colour, alpha=0.75, lw=0))
        left.text((begin + end) / 2, 0.5, f"frame {k + 1}", ha="center", va="center")
    left.set(xlim=(-50, 50), ylim=(1, 0), xlabel="time / ms", yticks=[0, 0.5, 1])
    left.set_yticklabels(["first\nrow", "middle", "last\nrow"])
    left.set_title("rows are exposed one after another, within 15 ms", fontsize=10)
    path = Exposures("", tuple(frames())).path_for_rows(READOUT, Limits())
    share = np.linspace(-0.5, 0.5, 201)
    for delay, name in ((-READOUT / 2, "first"), (0.0, "middle"), (READOUT / 2, "last")):
        time = -PERIOD / 2 + share * PERIOD + delay
        middle.plot(1e3 * share * PERIOD, path.place(time)[0], label=f"{name} row")
    middle.set(xlabel="time from the row's mid-exposure / ms", ylabel="place of the sensor / px")
    middle.set_title("the path that rows see in frame 2", fontsize=10)
    middle.legend(fontsize=8)
    light = np.tile((data.coffee()[:, :400].mean(axis=-1) / 255) ** 2.2, (1, 2))
    still = [TimedFrame(StillCamera(half_exposure=5e-4), 0.0)]
    for panel, readout, name in zip(
        right, (0.0, READOUT), ("all rows at once", "rows within 15 ms"), strict=True
    ):
        scene = Scene([4500.0], **LIGHT, sensor=Sensor(readout=readout))
        taken = simulate_frames(light, scene, still, speed=4500.0, num_columns=400)
        panel.imshow(np.clip(taken[0], 0, 1) ** (1 / 2.2), cmap="gray", vmin=0, vmax=1)
        panel.set(xticks=[], yticks=[])
        panel.set_title(f"a still at 4,500 px/s,\n{name}", fontsize=9)
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=110)


if __name__ == "__main__":
    main()
