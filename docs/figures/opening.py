"""Draw `opening.png`: a detail at the built-in scene's fastest speed, by three ways of taking it.

Run it as `python docs/figures/opening.py`.
"""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

jax.config.update("jax_enable_x64", True)

from mishutter import (  # noqa: E402
    TotalVariationDecoder,
    compare,
    example_picture,
    example_scene,
    optimise,
    restore_photograph,
)
from mishutter.decoding.image_quality import psnr  # noqa: E402
from mishutter.decoding.photographs import behind_optics  # noqa: E402
from mishutter.decoding.restoration import capture_and_restore  # noqa: E402
from mishutter.search.bursts import best_bursts  # noqa: E402

ROWS, COLUMNS = slice(80, 400), slice(305, 425)
"""Rows of the photograph that are captured, and columns of the detail."""
DETAIL = slice(146, 216)
"""Rows of the detail, within those that are captured."""
LETTERS = 14
"""Size of letters, which a telephone shows at a quarter of it; points."""


def main():
    """Draw the figure and save it beside this script."""
    plt.rcParams.update({"font.size": LETTERS})
    scene = example_scene()
    fastest = float(scene.max_speed)
    light = example_picture().light[ROWS]
    figure, axes = plt.subplots(2, 4, figsize=(8.4, 3.6), layout="constrained")
    show(axes[0, 0], light, "the scene")
    axes[1, 0].axis("off")
    table = compare(scene, optimise(scene))
    snapshot = table.row("best snapshot")
    result = restore_photograph(
        light,
        scene,
        snapshot.motion,
        snapshot.shutter,
        decoder=TotalVariationDecoder(),
        speeds=[fastest],
        num_seeds=1,
    )
    first = recorded_from(light, np.asarray(result.reference))
    name = f"a snapshot,\n{1e3 * float(snapshot.motion.exposure):.1f} ms"
    show(axes[0, 1], result.captured[0], name, first)
    show(axes[1, 1], result.restored[0], f"restored: {result.linear_psnr[0]:.1f} dB", first)
    still, moving = best_bursts(scene)
    names = f"{still.num_frames} frames at rest,", f"{moving.num_frames} frames,"
    ways = "the second:", "the sensor moving:"
    for column, frames, above, way in zip(axes.T[2:], (still, moving), names, ways, strict=True):
        result = capture_and_restore(
            light,
            scene,
            frames,
            speed=fastest,
            decoder=TotalVariationDecoder(),
            key=jax.random.key(0),
        )
        last = frames.frames[-1]
        moved = round(fastest * last.time - last.position)
        show(column[0], np.roll(result.captured[-1], moved, axis=1), f"{above}\n{way}")
        level = psnr(behind_optics(light, scene), result.restored)
        show(column[1], result.restored, f"restored: {level:.1f} dB")
    estimate = result.found
    axes[1, 0].text(
        0.5,
        0.5,
        f"{fastest:,.0f} px/s, dim;\nspeed not known.\nThe last finds\n"
        f"{estimate.speed:,.1f} $\\pm$ {estimate.error:.1f} px/s.",
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
