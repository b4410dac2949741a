"""Draw `objects.png`: frames before a background, and the picture that is restored from them.

Run it as `python docs/figures/objects.py`, in a folder in which the page's commands have run.
"""

from pathlib import Path

import matplotlib as mpl

mpl.use("agg")

import matplotlib.pyplot as plt
import numpy as np

from mishutter import read_picture

PANELS = {
    "frame 3, of 20 ms": "shot/frame_3.png",
    "frame 2, of 2.32 ms": "shot/frame_2.png",
    "restored from four frames": "found/restored.png",
    "labels": "found/labels.png",
    "trust": "found/trust.png",
}


def main():
    """Draw the figure and save it beside this script."""
    figure, axes = plt.subplots(1, len(PANELS), figsize=(15, 3.3), layout="constrained")
    for panel, (title, path) in zip(axes, PANELS.items(), strict=True):
        light = np.clip(read_picture(path).light, 0, 1) ** (1 / 2.2)
        panel.imshow(light.squeeze(), cmap="gray", vmin=0, vmax=1)
        panel.set_title(title, fontsize=10)
        panel.set_axis_off()
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=110)


if __name__ == "__main__":
    main()
