"""Draw `opening.png`: a detail at the built-in scene's fastest speed, by three cameras.

Run it as `python docs/figures/opening.py`.
"""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

jax.config.update("jax_enable_x64", True)

from mishutter import (  # noqa: E402
    ParabolicMotion,
    RectShutter,
    SpeedFindingDecoder,
    TotalVariationDecoder,
    compare,
    estimate_speed,
    example_picture,
    example_scene,
    optimise,
    restore_photograph,
)

ROWS, COLUMNS = slice(80, 400), slice(305, 425)
"""Rows of the photograph that are captured, and columns of the detail."""
DETAIL = slice(146, 216)
"""Rows of the detail, within those that are captured."""
LETTERS = 14
"""Size of letters, which a telephone shows at a quarter of it; points."""
HALF_EXPOSURE = 0.015
"""Of the open shutter, s."""


def cameras(scene):
    """Motion, shutter and decoder of each camera, by the text above its capture."""
    design = optimise(scene)
    snapshot = compare(scene, design).row("best snapshot")
    parabola = ParabolicMotion(
        acceleration=float(scene.limits.max_stroke) / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE
    )
    untold, finding = TotalVariationDecoder(), SpeedFindingDecoder()
    return {
        f"best snapshot,\n{1e3 * float(snapshot.motion.exposure):.1f} ms": (
            (snapshot.motion, snapshot.shutter),
            untold,
        ),
        f"designed shutter,\n{1e3 * float(design.motion.exposure):.0f} ms": (
            (design.motion, design.shutter),
            untold,
        ),
        f"open shutter,\n{2e3 * HALF_EXPOSURE:.0f} ms": ((parabola, RectShutter()), finding),
    }


def main():
    """Draw the figure and save it beside this script."""
    plt.rcParams.update({"font.size": LETTERS})
    scene = example_scene()
    fastest = float(scene.max_speed)
    light = example_picture().light[ROWS]
    figure, axes = plt.subplots(2, 4, figsize=(8.4, 3.6), layout="constrained")
    show(axes[0, 0], light, "the scene")
    axes[1, 0].axis("off")
    for (above, below), (name, (camera, decoder)) in zip(
        axes.T[1:], cameras(scene).items(), strict=True
    ):
        result = restore_photograph(
            light, scene, *camera, decoder=decoder, speeds=[fastest], num_seeds=1
        )
        captured, (_, shutter) = np.asarray(result.captured[0]), camera
        first = recorded_from(light, np.asarray(result.reference))
        show(above, captured / float(shutter.efficiency()), name, first)
        way = "speed found" if isinstance(decoder, SpeedFindingDecoder) else "restored"
        show(below, result.restored[0], f"{way}: {result.linear_psnr[0]:.1f} dB", first)
    estimate = estimate_speed(captured, scene, *camera)
    axes[1, 0].text(
        0.5,
        0.5,
        f"{fastest:,.0f} px/s, dim;\nspeed not known.\nThe last finds\n"
        f"{estimate.speed:,.0f} $\\pm$ {estimate.error:.0f} px/s.",
        ha="center",
        va="center",
        transform=axes[1, 0].transAxes,
    )
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
    axes.set_title(title, fontsize=LETTERS)
    axes.axis("off")


if __name__ == "__main__":
    main()
