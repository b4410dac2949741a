"""Draw `hodographs.png`: the velocities of five kinds of path, inside the disc of those of things.

Run it as `python docs/figures/hodographs.py`.
"""

from pathlib import Path

import jax
import matplotlib.pyplot as plt
import numpy as np

jax.config.update("jax_enable_x64", True)

from mishutter import BurstMode, Limits, Scene, best_in_plane  # noqa: E402

FASTEST = 2800.0
"""Of the things, in any direction; px/s."""
KINDS = {
    "alternating parabolas": "along one axis",
    "ring of velocities": "one velocity a frame",
    "crossed parabolas": "two axes in turn",
    "circle": "circle",
    "two sines": "two sines",
}


def main():
    """Draw the figure and save it beside this script."""
    limits = Limits(max_half_exposure=0.02, max_travel=60.0)
    burst = BurstMode(frames_per_s=50.0, window=0.08)
    scene = Scene.any_direction(
        FASTEST, photon_rate=3e4, read_noise=10.0, limits=limits, burst=burst
    )
    found = {each.kind: each for each in best_in_plane(scene).bursts}
    figure, panels = plt.subplots(1, len(KINDS), figsize=(9.0, 2.5), layout="constrained")
    turn = np.linspace(0, 2 * np.pi, 200)
    for axes, (kind, name) in zip(panels, KINDS.items(), strict=True):
        frames = found[kind].frames
        axes.fill(np.cos(turn), np.sin(turn), color="0.9")
        for time, exposure in zip(frames.times, frames.exposures, strict=True):
            axes.plot(*velocities(frames, time, exposure) / FASTEST, "k.", markersize=2.5)
        axes.set(xlim=(-1.6, 1.6), ylim=(-1.6, 1.6), aspect="equal")
        axes.set_title(f"{name}\n{found[kind].psnr:.1f} dB", fontsize=9)
        axes.set_xticks([-1, 0, 1])
        axes.set_yticks([-1, 0, 1], ["", "", ""] if axes is not panels[0] else None)
        print(f"{kind}: {found[kind].num_frames} frames, {found[kind].psnr:.2f} dB")
    panels[0].set_ylabel("velocity along columns", fontsize=9)
    panels[len(KINDS) // 2].set_xlabel("velocity along rows, over the greatest of the things")
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=110)


def velocities(frames, time, exposure):
    """Velocities of the sensor at equal steps of an exposure; px/s, shape `(2, n)`."""
    begin = frames.times[0] - frames.exposures[0] / 2
    ends = begin + np.append(0.0, np.cumsum(frames.durations))
    inner = time + exposure * (np.arange(96) + 0.5 - 48) / 96
    # Knots between which a velocity jumps are at one time: the later one counts there.
    return np.stack([np.interp(inner, ends, row) for row in frames.velocities])


if __name__ == "__main__":
    main()
