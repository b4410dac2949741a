"""Draw `bursts.png`: a detail by one snapshot, by stills, and by frames of a sensor that moves.

Frames that are alike and registered are restored as one exposure with the light and the read
noise of all of them. Run it as `python docs/figures/bursts.py`.
"""

from pathlib import Path

import equinox as eqx
import jax
import matplotlib.pyplot as plt
import numpy as np

jax.config.update("jax_enable_x64", True)

from opening import LETTERS, ROWS, recorded_from, show  # noqa: E402

from mishutter import (  # noqa: E402
    BurstMode,
    LinearMotion,
    RectShutter,
    TotalVariationDecoder,
    example_picture,
    example_scene,
)
from mishutter.decoding.restoration import restore_by_each  # noqa: E402
from mishutter.evaluation.bursts import StillBursts  # noqa: E402
from mishutter.search.moving_frames import best_moving_burst  # noqa: E402

SPEED, RATE, MOST = 3000.0, 60.0, 4
"""Of the picture, px/s; of the camera's frames, 1/s; of frames in a burst."""


def main():
    """Draw the figure and save it beside this script."""
    plt.rcParams.update({"font.size": LETTERS})
    light, scene = example_picture().light[ROWS], example_scene()
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
    for (above, below), (name, (count, motion)) in zip(
        axes.T[1:], bursts(scene).items(), strict=True
    ):
        camera = motion, RectShutter()
        decoders = {name: TotalVariationDecoder()}
        given = {"speeds": [SPEED], "num_seeds": 1}
        frame = restore_by_each(light, scene, *camera, decoders, **given)[name]
        together = added_up(scene, count)
        result = restore_by_each(light, together, *camera, decoders, decoder_speed="known", **given)
        first = recorded_from(light, np.asarray(frame.reference))
        show(above, frame.captured[0], name, first)
        level = result[name].linear_psnr[0]
        show(below, result[name].restored[0], f"restored: {level:.1f} dB", first)
        print(f"{name}: {level:.2f} dB, expected {result[name].expected_psnr:.2f}")
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=125)


def added_up(scene, num_frames):
    """The scene of one exposure that is as good as equal frames together: their |H|^2/N adds up."""
    levels = scene.photon_rate * num_frames, scene.read_noise * np.sqrt(num_frames)
    return eqx.tree_at(lambda s: (s.photon_rate, s.read_noise), scene.without_metadata(), levels)


def bursts(scene):
    """Number of frames and motion of each burst, by the text above the first of its frames."""
    at_rest = StillBursts(scene)
    snapshot, stills = (at_rest.best(RATE, max_frames=count) for count in (1, MOST))
    moving = best_moving_burst(with_frames(scene, MOST))
    return {
        f"snapshot,\n{1e3 * snapshot.exposure:.1f} ms": (
            1,
            LinearMotion(half_exposure=snapshot.exposure / 2),
        ),
        f"1 of {stills.num_frames} stills,\n{1e3 * stills.exposure:.1f} ms": (
            stills.num_frames,
            LinearMotion(half_exposure=stills.exposure / 2),
        ),
        f"1 of {moving.num_frames} moving,\n{1e3 * moving.frames[0].exposure:.0f} ms": (
            moving.num_frames,
            moving.frames[0].motion,
        ),
    }


def with_frames(scene, count):
    """The scene of a camera that takes so many frames."""
    burst = BurstMode(frames_per_s=RATE, max_frames=count)
    return eqx.tree_at(lambda s: s.burst, scene, burst, is_leaf=lambda x: x is None)


if __name__ == "__main__":
    main()
