"""What does it save to compute only what a scene needs?

Every pair of times is of one run, planned and in full (for layers, a scene in which all moves), by
turns after a first call of each; then ten scenes are optimised one after the other
in one process.
"""

import time
from dataclasses import replace

import jax
import numpy as np
from support.plan_check import metrics_by, plan_error, plan_for

from benchmarks import harness
from mishutter import (
    DesignLoss,
    ExpectedErrorLoss,
    GaussianShutter,
    HannShutter,
    Layer,
    Layers,
    Limits,
    ParabolicMotion,
    Picture,
    Scene,
    Texture,
    example_picture,
    example_scene,
    optimise,
    simulate_capture,
    starting_shutter,
)
from mishutter.evaluation.losses import value_of
from mishutter.evaluation.needs import sizes
from mishutter.search.planning import plan

jax.config.update("jax_enable_x64", True)

HALF = 0.01
MOTION = ParabolicMotion(acceleration=45 / HALF**2, half_exposure=HALF)
PAIRS = Scene(
    [0.0, 1500.0, -1500.0, 3000.0, -3000.0],
    [0.3, 0.2, 0.2, 0.15, 0.15],
    photon_rate=1e8,
    read_noise=3.0,
)
"""Three speeds among symmetric pairs, in bright light."""

NUM_TURNS = 15


def row(name: str, full, planned, error: float | None = None, turns: int = NUM_TURNS) -> dict:
    """Times of one pair, run by turns, so that a load falls on both."""
    full()
    planned()
    times = np.array([[_seconds(full), _seconds(planned)] for _ in range(turns)])
    best = times.min(axis=0)
    return {
        "what": name,
        "full ms": 1e3 * best[0],
        "planned ms": 1e3 * best[1],
        "times faster": best[0] / best[1],
        "change": error,
        "samples_s": times,
    }


def _seconds(function) -> float:
    start = time.perf_counter()
    jax.block_until_ready(function())
    return time.perf_counter() - start


def skips() -> list[dict]:
    """Each skip alone, then all together, on a loss of both kinds."""
    shutter = GaussianShutter(0.25)
    loss = ExpectedErrorLoss() + 0.1 * DesignLoss()
    full = sizes(PAIRS, MOTION)
    of_loss = plan(PAIRS, MOTION, shutter, loss=loss)
    exact = of_loss.sizes
    alone = {
        "speeds": replace(full, skips=True, folds=True),
        "taps": replace(full, num_taps=exact.num_taps),
        "nodes in time": replace(full, num_nodes=exact.num_nodes),
        "all exact skips": exact,
    }
    print(*of_loss.skips, sep="\n")
    rows = []
    for name, chosen in alone.items():
        error = plan_error(chosen, PAIRS, MOTION, shutter, loss=loss)
        rows.append(row(name, *_pair(PAIRS, MOTION, shutter, loss, chosen), error))
    return rows


def _pair(scene, motion, shutter, loss, chosen):
    """The full and the planned measurement, compiled whole as a search would."""

    def measure(by):
        compiled = jax.jit(lambda half: value(at(half), by))
        return lambda: compiled(motion.half_exposure)

    def value(moves, by):
        if loss is None:
            return metrics_by(by, scene, moves, shutter)
        return value_of(loss, scene, moves, shutter, by)

    def at(half):
        return ParabolicMotion(acceleration=motion.acceleration, half_exposure=half)

    return measure(sizes(scene, motion)), measure(chosen)


def needy() -> dict:
    """A scene that needs everything: one-sided speeds, the longest stroke, dim light."""
    limits = Limits(max_stroke=45.0, max_top_speed=2e4)
    scene = Scene([0.0, 2000.0, 4500.0, 9000.0], photon_rate=1e5, read_noise=8.0, limits=limits)
    shutter = HannShutter()
    chosen = plan_for(scene, MOTION, shutter)
    error = plan_error(chosen, scene, MOTION, shutter)
    pair = _pair(scene, MOTION, shutter, None, chosen)
    return row("a scene that needs everything", *pair, error, 40)


def moving_object() -> dict:
    """A capture of a photograph before which an object of 5 % of its area moves, or of all."""
    light = np.asarray(example_picture().light)
    rows, columns = light.shape[:2]

    def scene_with(share: float) -> Layers:
        height, width = int(rows * share**0.5), int(columns * share**0.5)
        y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
        matte = np.clip(8 - 8 * np.maximum(abs(x), abs(y)), 0, 1).astype(np.float32)
        thing = Picture(light[:height, :width] * 0.5 + 0.3, matte=matte)
        left, top = (columns - width) // 2, (rows - height) // 2
        return Layers((Layer(Picture(light)), Layer(thing, speed=3000.0, left=left, top=top)))

    def capture(subject: Layers):
        return simulate_capture(subject, example_scene(), MOTION, HannShutter())

    some, all_of_it = scene_with(0.05), scene_with(1.0)
    pair = (lambda: capture(all_of_it)), (lambda: capture(some))
    return row("capture, an object of 5 % moves, not all", *pair, turns=3)


def ten_scenes() -> list[float]:
    """Seconds of ten searches of different light, speeds and picture, one after the other."""
    first = example_scene()
    random = np.random.default_rng(0)
    seconds = []
    for index in range(10):
        speeds = np.linspace(-1, 1, (9, 11, 12)[index % 3]) * random.uniform(2000, 4500)
        scene = Scene(
            speeds,
            photon_rate=10 ** random.uniform(4, 7),
            read_noise=random.uniform(2, 9),
            picture=Texture(
                power_spectrum=random.uniform(0.2, 1, 256) / np.linspace(0.01, 0.5, 256) ** 2
            ),
            limits=first.limits,
            motion=first.motion,
        )
        start = time.perf_counter()
        case = scene, scene.motion, starting_shutter(scene)
        optimise(*case, loss=ExpectedErrorLoss(), free="shutter", max_steps=60)
        seconds.append(time.perf_counter() - start)
    return seconds


def picture(rows: list[dict]) -> None:
    """How many times faster each row is, as bars on a logarithmic axis."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 3.6), layout="constrained")
    names, ratios = zip(*((row["what"], row["times faster"]) for row in rows), strict=True)
    bars = axes.barh(names, ratios, color="tab:blue")
    axes.bar_label(bars, [f"{ratio:.3g}" for ratio in ratios], padding=3)
    axes.axvline(1, color="black", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_xlim(0.7, 2.2 * max(ratios))
    axes.invert_yaxis()
    axes.set_xlabel("times faster than a computation of everything")
    harness.save_picture(figure, "plan")
    plt.close(figure)


def main() -> None:
    """Print the tables and store the rows."""
    rows = [*skips(), needy(), moving_object()]
    seconds = ten_scenes()
    columns = ["what", "full ms", "planned ms", "times faster", "change"]
    lines = [
        "## Only what the scene needs",
        "",
        harness.table(rows, columns),
        "",
        "Ten scenes of different light, speeds and picture, optimised one after the other in "
        f"one process: the first in {seconds[0]:.1f} s, the others in "
        f"{np.median(seconds[1:]):.2f} s (median; the slowest {max(seconds[1:]):.2f} s).",
    ]
    harness.section("plan", "\n".join(lines))
    picture(rows)
    harness.write("plan", rows, seconds_of_ten_scenes=seconds)


if __name__ == "__main__":
    main()
