"""How much faster is a sweep than a Python loop, how good are its profiles, and is it small?

Fixed shutters against `evaluate` and optimised profiles against `optimise`, each looped over
a random sample of the same grid after a first call; 200 profiles of four sweeps against `optimise`,
by as many starts and by four times as many; the peak memory of a large sweep into a store.
`python -m benchmarks.sweep [fixed] [optimised] [profiles] [memory]` runs some of them.
"""

import sys

import jax

jax.config.update("jax_enable_x64", True)

import resource  # noqa: E402
import tempfile  # noqa: E402
import time  # noqa: E402

import numpy as np  # noqa: E402

from benchmarks import harness  # noqa: E402
from mishutter import (  # noqa: E402
    ExpectedErrorLoss,
    Limits,
    ParabolicMotion,
    Scene,
    TukeyShutter,
    baselines,
    evaluate,
    example_scene,
    optimise,
    starting_shutter,
    sweep,
)

SCENE = example_scene()
SHUTTERS = {**baselines(), "Tukey": TukeyShutter(0.5)}
NUM_FIXED, NUM_OPTIMISED, NUM_LARGE = 100, 64, 1000
NUM_SAMPLED, NUM_SEARCHED = 60, 12
MOST_MEMORY = 3.0
"""GiB that a million points may take."""


def ranges(count: int) -> dict:
    """Strokes of 1 to 45 px at their corner, exposures of 4 to 20 ms: nearly all in limits."""
    return {
        "accelerations": np.geomspace(5e4, 1.1e6, count),
        "half_exposures": np.geomspace(2e-3, 6.4e-3, count),
    }


def sampled(dataset, count: int) -> list:
    """Motions at random points within limits."""
    points = np.argwhere(dataset.outside.values == 0)
    chosen = np.random.default_rng(0).permutation(points)[:count]
    a, half, pan = (dataset[n].values for n in ("acceleration", "half_exposure", "velocity"))
    motions = [
        ParabolicMotion(acceleration=a[i], half_exposure=half[j], velocity=pan) for i, j in chosen
    ]
    return list(zip(map(tuple, chosen), motions, strict=True))


def fixed() -> dict:
    """A grid of five fixed shutters and nine speeds."""
    arguments = ranges(NUM_FIXED)
    dataset = sweep(SCENE, shutters=SHUTTERS, **arguments)
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        dataset = sweep(SCENE, shutters=SHUTTERS, **arguments)
        times.append(time.perf_counter() - begin)
    inside = int((dataset.outside == 0).sum())
    motions = sampled(dataset, NUM_SAMPLED)
    worst = 0.0
    for at, motion in motions:
        for name, shutter in SHUTTERS.items():
            found = float(evaluate(SCENE, motion, shutter).expected_psnr)
            psnr = float(dataset.expected_psnr[at].sel(shutter=name))
            worst = max(worst, abs(found / psnr - 1))
    begin = time.perf_counter()
    for _, motion in motions:
        for shutter in SHUTTERS.values():
            jax.block_until_ready(evaluate(SCENE, motion, shutter).expected_psnr)
    looped = (time.perf_counter() - begin) / len(motions)
    swept = min(times) / inside
    return {
        "what": f"{NUM_FIXED} x {NUM_FIXED}, five fixed shutters, nine speeds",
        "points": inside,
        "sweep ms/point": 1e3 * swept,
        "loop ms/point": 1e3 * looped,
        "ratio": looped / swept,
        "worst difference": worst,
    }


def optimised() -> dict:
    """A grid of optimised profiles."""
    arguments = {**ranges(NUM_OPTIMISED), "metrics": ["expected_psnr"], "shutters": SHUTTERS}
    few = {name: arguments[name][3::4] for name in ("accelerations", "half_exposures")}
    sweep(SCENE, optimise=True, **{**arguments, **few})
    begin = time.perf_counter()
    dataset = sweep(SCENE, optimise=True, **arguments)
    inside = int((dataset.outside == 0).sum())
    swept = (time.perf_counter() - begin) / inside
    start, loss = starting_shutter(SCENE), ExpectedErrorLoss()
    points = sampled(dataset, NUM_SEARCHED)
    excess = []
    for at, motion in points:
        design = optimise(SCENE, motion, start, loss=loss, free="shutter")
        excess.append(float(dataset.loss[at]) - design.loss)
    begin = time.perf_counter()
    for _, motion in points:
        optimise(SCENE, motion, start, loss=loss, free="shutter")
    looped = (time.perf_counter() - begin) / len(points)
    return {
        "what": f"{NUM_OPTIMISED} x {NUM_OPTIMISED} optimised profiles",
        "points": inside,
        "sweep ms/point": 1e3 * swept,
        "loop ms/point": 1e3 * looped,
        "ratio": looped / swept,
        "worst difference": max(excess),
    }


WIDE = Limits(max_stroke=45.0, max_top_speed=2e4, min_half_exposure=5e-4, max_half_exposure=0.04)
FOUR = {
    "nine of 2,800 px/s": Scene.uniform(
        max_speed=2800.0, num_speeds=9, photon_rate=1e5, read_noise=8.0, limits=WIDE
    ),
    "lopsided": Scene(
        [-300.0, 100.0, 1500.0], [0.1, 0.5, 0.4], photon_rate=3e4, read_noise=4.0, limits=WIDE
    ),
    "one way": Scene([500.0, 800.0, 1100.0], photon_rate=3e5, read_noise=8.0, limits=WIDE),
    "bimodal": Scene(
        [-1900.0, -1700.0, -1500.0, 2100.0, 2600.0], photon_rate=1e6, read_noise=3.0, limits=WIDE
    ),
}
"""Scenes whose losses have many minima."""
NUM_MORE = 48
"""Starts that have four times as many as there are by default."""


def profiles() -> dict:
    """Fifty profiles of each of four sweeps against `optimise`, both ways."""
    excess, missed, unconverged = [], [], 0
    grid = {
        "accelerations": np.geomspace(3e3, 3e5, 10),
        "half_exposures": np.geomspace(1e-3, 9e-3, 5),
    }
    few = {"metrics": ["expected_psnr"], "shutters": {"Hann": SHUTTERS["Hann"]}}
    for name, scene in FOUR.items():
        dataset = sweep(scene, optimise=True, **grid, **few)
        inside = dataset.outside.values == 0
        unconverged += int(np.sum(~dataset.converged.values[inside]))
        start, found = starting_shutter(scene), []
        for at, motion in sampled(dataset, int(np.sum(inside))):
            designs = [
                optimise(scene, motion, start, free="shutter", num_starts=count)
                for count in (None, NUM_MORE)
            ]
            found.append([float(dataset.loss[at]) / design.loss - 1 for design in designs])
        of_scene, of_more = np.transpose(found)
        print(name, len(found), np.min(of_scene), np.max(of_scene), np.max(of_more))
        excess += list(of_scene)
        missed += list(of_more)
    return {
        "what": f"{len(excess)} profiles of four sweeps",
        "points": len(excess),
        "not converged": unconverged,
        "above optimise": max(excess),
        "below optimise": -min(excess),
        "above four times the starts": max(missed),
        "of these above by 0.2 %": int(np.sum(np.array(missed) > 2e-3)),
    }


def memory() -> dict:
    """A large grid into a store; the peak of the whole process as the grid is filled."""
    points, peaks = [], []

    def watch(done: int, total: int) -> None:
        points.append(done)
        peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20)

    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        shutters = {"rect": SHUTTERS["rect"], "Hann": SHUTTERS["Hann"]}
        store = f"{folder}/a.zarr"
        sweep(SCENE, shutters=shutters, store=store, progress=watch, **ranges(NUM_LARGE))
        seconds = time.perf_counter() - begin
    return {
        "what": f"{NUM_LARGE} x {NUM_LARGE}, two fixed shutters, stored",
        "points": NUM_LARGE**2,
        "sweep ms/point": 1e3 * seconds / NUM_LARGE**2,
        "peak GiB": peaks[-1],
        "points done": points,
        "peaks GiB": peaks,
    }


def picture(rows: list[dict]) -> None:
    """Times a point beside those of loops, and the peak of memory as a grid is filled."""
    import matplotlib.pyplot as plt

    compared, large = [row for row in rows if "ratio" in row], rows[-1]
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    place = np.arange(len(compared))
    styles = (("loop", "white", "//"), ("sweep", "dimgrey", ""))
    for number, (kind, colour, hatch) in enumerate(styles):
        times = [row[f"{kind} ms/point"] for row in compared]
        bars = left.bar(
            place + 0.4 * number - 0.2,
            times,
            0.38,
            color=colour,
            edgecolor="black",
            hatch=hatch,
            label={"loop": "Python loop", "sweep": "sweep"}[kind],
        )
        left.bar_label(bars, [f"{value:.3g}" for value in times], padding=2)
    names = [row["what"].removesuffix(", nine speeds") for row in compared]
    faster = [f"{row['ratio']:.0f} times faster" for row in compared]
    left.set_xticks(place, [f"{x}\n{y}" for x, y in zip(names, faster, strict=True)])
    left.set_yscale("log")
    least, most = compared[0]["sweep ms/point"], compared[-1]["loop ms/point"]
    left.set_ylim(least / 4, 8 * most)
    left.set_ylabel("time a point, ms")
    left.legend(loc="upper left", ncols=2)
    right.plot(np.array(large["points done"]) / 1e6, large["peaks GiB"], "k-", label="peak so far")
    right.axhline(MOST_MEMORY, color="black", linestyle="--", label="most allowed")
    right.set_ylim(0, 1.25 * MOST_MEMORY)
    right.set_xlabel("points done, millions")
    right.set_ylabel("memory of the process, GiB")
    right.legend(loc="upper left", ncols=2)
    harness.save_picture(figure, "sweep")
    plt.close(figure)


def main() -> None:
    """Measure, print; store and draw what was measured when all was."""
    known = {"fixed": fixed, "optimised": optimised, "profiles": profiles, "memory": memory}
    chosen = [name for name in sys.argv[1:] if name in known] or list(known)
    rows = [known[name]() for name in chosen]
    columns = ["what", "points", "sweep ms/point", "loop ms/point", "ratio", "worst difference"]
    timed = [row for row in rows if "sweep ms/point" in row]
    tables = [harness.table(timed, [*columns, "peak GiB"])] if timed else []
    tables += [harness.table([row], list(row)) for row in rows if row not in timed]
    text = "\n\n".join(tables)
    if chosen != list(known):
        print(text)
        return
    harness.write("sweep", rows)
    picture(rows)
    machine = harness.environment()
    notes = (
        "Loops call `evaluate` for each shutter, or `optimise`, at random points of the same grid. "
        "Both sides are compiled before they are timed. The difference is of the expected PSNR, "
        "relative, and of the loss. Profiles are compared by their loss, as a share of it. "
        f"The load was {machine['load']:.1f} on {machine['cores']} cores, of which a sweep uses "
        "all and a loop one."
    )
    drawn = "![time a point, and memory](results/sweep.png)"
    harness.section("sweep", "\n\n".join(["## Sweep against loops", drawn, text, notes]))


if __name__ == "__main__":
    main()
