"""Draw `bursts.png`: a detail by one snapshot, by stills, and by frames of a sensor that moves.

Run it as `python docs/figures/bursts.py`.
"""

from dataclasses import replace
from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

jax.config.update("jax_enable_x64", True)

from opening import LETTERS, ROWS, show  # noqa: E402

from mishutter import BurstMode, TotalVariationDecoder, example_picture, example_scene  # noqa: E402
from mishutter.decoding.image_quality import psnr  # noqa: E402
from mishutter.decoding.photographs import behind_optics  # noqa: E402
from mishutter.decoding.restoration import capture_and_restore  # noqa: E402
from mishutter.search.bursts import best_bursts  # noqa: E402

SPEED, RATE, MOST = 3000.0, 60.0, 4
"""Of the picture, px/s; of the camera's frames, 1/s; of frames in a burst."""


def main():
    """Draw the figure and save it beside this script."""
    plt.rcParams.update({"font.size": LETTERS})
    light = example_picture().light[ROWS]
    figure, axes = plt.subplots(2, 4, figsize=(8.4, 3.6), layout="constrained")
    show(axes[0, 0], light, "the scene")
    axes[1, 0].axis("off")
    axes[1, 0].text(
        0.5,
        0.5,
        f"{SPEED:,.0f} px/s, dim;\ndecoders register\nthe frames, and\nknow the speed.",
        ha="center",
        va="center",
        transform=axes[1, 0].transAxes,
    )
    snapshot, (stills, moving) = best_bursts(camera(1))[0], best_bursts(camera(MOST))
    every = {"snapshot": snapshot, "stills": stills, "moving": moving}
    for (above, below), (name, taken) in zip(axes.T[1:], every.items(), strict=True):
        result = capture_and_restore(
            light,
            camera(MOST),
            taken,
            speed=SPEED,
            decoder=TotalVariationDecoder(),
            key=jax.random.key(0),
        )
        last = taken.frames[-1]
        size = f"{1e3 * last.exposure:.1f} ms"
        words = f"{name},\n{size}" if taken.num_frames == 1 else f"1 of {MOST} {name},\n{size}"
        moved = round(SPEED * last.time - last.position)
        show(above, np.roll(result.captured[-1], moved, axis=1), words)
        level = psnr(behind_optics(light, camera(MOST)), result.restored)
        show(below, result.restored, f"restored: {level:.1f} dB")
        print(f"{name}: {taken.text}, {level:.2f} dB")
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=125)


def camera(count):
    """The built-in scene of a camera that takes up to so many frames and knows the speed."""
    burst = BurstMode(frames_per_s=RATE, max_frames=count)
    return replace(example_scene(), burst=burst, decoder_speed="known")


if __name__ == "__main__":
    main()
