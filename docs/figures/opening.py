"""Draw `opening.png`: a detail at the built-in scene's fastest speed, by three cameras.

Run it as `python docs/figures/opening.py`.
"""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

jax.config.update("jax_enable_x64", True)

from mishutter import (  # noqa: E402
    RectShutter,
    StillCamera,
    compare,
    example_picture,
    example_scene,
    optimise,
    restore_photograph,
)

ROWS, COLUMNS = slice(180, 300), slice(305, 425)
"""Rows of the photograph that are captured, and columns of the detail."""
DETAIL = slice(46, 116)
"""Rows of the detail, within those that are captured."""


def cameras(scene):
    """Motion and shutter of each camera, by what is written above it."""
    design = optimise(scene)
    snapshot = compare(scene, design).row("best snapshot")
    open_shutter = StillCamera(half_exposure=design.motion.half_exposure)
    milliseconds = 1e3 * float(design.motion.exposure)
    return {
        f"shutter open for {milliseconds:.0f} ms": (open_shutter, RectShutter()),
        f"best snapshot, {1e3 * float(snapshot.motion.exposure):.1f} ms": (
            snapshot.motion,
            snapshot.shutter,
        ),
        f"designed, {milliseconds:.0f} ms": (design.motion, design.shutter),
    }


def main():
    """Draw the figure and save it beside this script."""
    plt.rcParams.update({"font.size": 10.5})
    scene = example_scene()
    fastest = float(scene.max_speed)
    light = example_picture().light[ROWS]
    figure, axes = plt.subplots(2, 4, figsize=(8.4, 3.1), layout="constrained")
    show(axes[0, 0], light, "the scene")
    axes[1, 0].text(
        0.5,
        0.5,
        f"A detail that moves at\n{fastest:,.0f} px/s in dim light.\nOne filter restores it,\n"
        "which is told no speed.",
        ha="center",
        va="center",
        transform=axes[1, 0].transAxes,
    )
    axes[1, 0].axis("off")
    for (above, below), (name, (motion, shutter)) in zip(
        axes.T[1:], cameras(scene).items(), strict=True
    ):
        result = restore_photograph(light, scene, motion, shutter, speeds=[fastest], num_seeds=1)
        efficiency = float(shutter.efficiency())
        first = recorded_from(light, np.asarray(result.reference))
        show(above, np.asarray(result.captured[0]) / efficiency, name, first)
        show(below, result.restored[0], f"restored: {result.linear_psnr[0]:.1f} dB", first)
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=125)


def recorded_from(light, part):
    """The column of the photograph that a camera records first."""
    width = part.shape[1]
    offsets = range(light.shape[1] - width + 1)
    return next(o for o in offsets if np.array_equal(light[:, o : o + width], part))


def show(axes, light, title, first=0):
    """The detail of a picture that begins at some column, as an eye sees it."""
    columns = slice(COLUMNS.start - first, COLUMNS.stop - first)
    seen = np.clip(np.asarray(light)[DETAIL, columns], 0, 1) ** (1 / 2.2)
    axes.imshow(seen, interpolation="nearest")
    axes.set_title(title, fontsize=10.5)
    axes.axis("off")


if __name__ == "__main__":
    main()
