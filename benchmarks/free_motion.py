"""What do a free path and a shaped shutter bring, alone and together, on five scenes and stages?

Expected PSNR of the best design of each, in dB: a parabola or a free path of 12 pieces, under an
open or a shaped shutter. Each is measured once more on speeds four times as fine as those it was
designed on.
"""

import time
from typing import Any

import equinox as eqx
import jax
import numpy as np

from benchmarks import harness
from benchmarks.scenes import scenes
from mishutter import Design, Limits, RectShutter, Scene, evaluate, optimise

PIXEL = 1.1e-6
"""Pitch of the pixels, m."""
_GRAVITY = 9.81
STAGES = {
    "own": None,
    "phone": {"max_travel": 100e-6 / PIXEL, "max_acceleration": 0.1 * _GRAVITY / PIXEL},
    "piezo": {"max_travel": 100e-6 / PIXEL, "max_acceleration": 1.0 * _GRAVITY / PIXEL},
}
_FINER = 4
NOTE = (
    "*Own*: the stage that the scene states. *Phone*: an optical stabiliser, 100 µm of travel "
    "from rest to rest, 0.1 g. *Piezo*: a flexure stage, 100 µm, 1 g. Pixels of 1.1 µm; run- "
    "up and run-out are included. The second table has the same designs on a grid of speeds "
    "four times as fine. The shaped designs of daylight stand still, and those of the street "
    "pan at constant velocity, but for the one on a free path."
)


def with_stage(scene: Scene, stage: dict[str, float] | None) -> Scene:
    """The scene where the sensor is moved by such a stage."""
    if stage is None:
        return scene
    exposures = ("min_half_exposure", "max_half_exposure")
    names = ("max_stroke", "max_top_speed", *exposures, "max_pan", "pans", "free_paths")
    numbers: dict[str, Any] = {name: getattr(scene.limits, name) for name in names} | stage
    limits = Limits(**numbers)
    return eqx.tree_at(
        lambda s: (s.limits, s.given_motion), scene, (limits, None), is_leaf=_is_none
    )


def _is_none(part: object) -> bool:
    return part is None


def finer(scene: Scene) -> Scene:
    """The scene with more speeds between those it has, which are in equal steps."""
    speeds, weights = np.asarray(scene.speeds), np.asarray(scene.weights)
    order = np.argsort(speeds)
    places = np.linspace(0, speeds.size - 1, _FINER * (speeds.size - 1) + 1)
    weights = np.interp(places, np.arange(speeds.size), weights[order])
    speeds = np.interp(places, np.arange(speeds.size), speeds[order])
    return eqx.tree_at(lambda s: (s.speeds, s.weights), scene, (speeds, weights / weights.sum()))


def designs(scene: Scene) -> dict[str, Design]:
    """The best design of each kind."""
    shaped = optimise(scene)
    moves = {"half_exposure"} | ({"velocity"} if float(shaped.motion.velocity) else set())
    return {
        "parabola, open": optimise(scene, shutter=RectShutter()),
        "parabola, shaped": shaped,
        "free, open": optimise(scene, shutter=RectShutter(), free={"path", *moves}),
        "free, shaped": optimise(scene, free={"path", "shutter", *moves}),
    }


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows, again = [], []
    for name, scene in list(scenes().items())[:5]:
        for stage, limits in STAGES.items():
            start = time.perf_counter()
            limited = with_stage(scene, limits)
            found = designs(limited)
            fine = finer(limited)
            head = {"scene": name.split(":")[0], "stage": stage}
            levels = {k: float(d.metrics.expected_psnr) for k, d in found.items()}
            rows.append(head | {k: f"{level:.3f}" for k, level in levels.items()})
            on_fine = {k: evaluate(fine, d.motion, d.shutter) for k, d in found.items()}
            again.append(head | {k: f"{float(m.expected_psnr):.3f}" for k, m in on_fine.items()})
            print(rows[-1], again[-1], f"{time.perf_counter() - start:.0f} s", flush=True)
    harness.write("free_motion", rows, finer=again)
    text = "## Free paths: what a path and a shutter bring, expected PSNR in dB"
    tables = [harness.table(some, list(some[0])) for some in (rows, again)]
    harness.section("free_motion", "\n\n".join([text, *tables, NOTE]))


if __name__ == "__main__":
    main()
