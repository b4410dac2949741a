"""What does the kernel of a free path cost, by taps and pieces, and how exact is it?

Kernels of a Hann window and their gradients by every acceleration, on a parabola, on paths that
bend one way, and on paths that bend to and fro, each piece against the last; the worst error over
random paths with pieces of every sign and of no length; and time against error beside what a
reader would write in NumPy. `python -m benchmarks.free_path`.
"""

import itertools
import sys
from functools import partial

import jax

jax.config.update("jax_enable_x64", True)

import mpmath as mp  # noqa: E402
import numpy as np  # noqa: E402

from benchmarks import harness  # noqa: E402
from mishutter import (  # noqa: E402
    FreeMotion,
    HannShutter,
    ParabolicMotion,
    binned_exposure,
    blur_kernel,
)

TAPS, PIECES = (64, 512, 4096), (6, 24, 96)
POINTS = 100
KINDS = {
    "parabola": None,
    "bent one way": lambda index: 1.0 + 0.3 * np.cos(1.7 * index),
    "bent to and fro": lambda index: (1.0 + 0.3 * np.cos(1.7 * index)) * (-1.0) ** index,
}


def timings(kind: str, num_pieces: int, num_taps: int) -> dict:
    """Time of a kernel that covers its support, and of its gradient."""
    shape, half = KINDS[kind], 0.02
    weights = np.cos(1.3 * np.arange(num_taps) + 0.2)
    scale = 0.6 * num_taps / half**2
    row = np.full(1, scale) if shape is None else scale * shape(np.arange(num_pieces))
    motion = FreeMotion(accelerations=row, half_exposure=half)

    def taps(shares):
        moved = motion.accelerations * shares
        if shape is None:
            path = ParabolicMotion(acceleration=moved[0], half_exposure=half)
        else:
            path = FreeMotion(accelerations=moved, half_exposure=half)
        return blur_kernel(HannShutter(), path, speed=0.1 * scale * half, num_taps=num_taps)

    def known(speed):
        path = motion
        if shape is None:
            path = ParabolicMotion(acceleration=scale, half_exposure=half)
        return blur_kernel(HannShutter(), path, speed=speed, num_taps=num_taps)

    value = harness.timed(jax.jit(known), 0.1 * scale * half)
    slope = harness.timed(jax.jit(jax.grad(lambda x: taps(x) @ weights)), np.ones(row.size))
    return {
        "path": kind,
        "pieces": row.size,
        "taps": num_taps,
        "first call s": value["first_s"],
        "kernel us": value["best_s"] * 1e6,
        "gradient, signs unknown, us": slope["best_s"] * 1e6,
    }


def accuracy(slug: str, dtype: type, count: int) -> dict:
    """Worst error over random paths, in units of what is promised."""
    from support import free_paths

    rng = np.random.default_rng(2024)
    largest = 8.0 if dtype is np.float64 else 6.0
    points = [free_paths.random_path(rng, dtype, slug, largest=largest) for _ in range(count)]
    errors = np.array([free_paths.errors(point) for point in points])
    row = {"shutter": slug, "precision": np.dtype(dtype).name, "points": count}
    return row | {"taps": np.max(errors[:, 0]), "derivatives": np.max(errors[:, 1])}


NUM_TAPS = 64
INSTANTS = tuple(10**power for power in range(2, 8))
BEND = 450.0 * np.array([1.0, 0.2, -0.4, 0.0, 0.6, 1.3, 1.1, 0.5, 0.0, -0.3, 0.4, 0.9])
HALF, SPEED = 0.25, 61.0
EDGES = np.linspace(-45.0, 41.0, NUM_TAPS + 1) + 0.013


def _open_until(tau, exact=False):
    """Antiderivative of a Hann window, from mid-exposure."""
    pi, sine = (mp.pi, mp.sin) if exact else (np.pi, np.sin)
    return (tau + sine(pi * tau) / pi) / 2


def _pieces(exact=False):
    """Beginning and end, position, velocity and acceleration of the pieces, from either side."""
    number = mp.mpf if exact else float
    T, K = number(HALF), BEND.size
    ends = [T * (2 * number(j) / K - 1) for j in range(K + 1)]
    position, velocity = {K // 2: number(0)}, {K // 2: -number(SPEED)}
    for j in (*range(K // 2, K), *range(K // 2 - 1, -1, -1)):
        a, h = number(BEND[j]), ends[j + 1] - ends[j]
        if j >= K // 2:
            velocity[j + 1] = velocity[j] + 2 * a * h
            position[j + 1] = position[j] + h * (velocity[j] + a * h)
        else:
            velocity[j] = velocity[j + 1] - 2 * a * h
            position[j] = position[j + 1] - h * (velocity[j] + a * h)
    return [(*ends[j : j + 2], position[j], velocity[j], number(BEND[j])) for j in range(K)]


def _by_reference():
    """Taps by the roots of each piece at 40 digits."""
    with mp.workdps(40):
        taps = [mp.mpf(0)] * NUM_TAPS
        edges, T = [mp.mpf(float(edge)) for edge in EDGES], mp.mpf(HALF)
        for begin, end, x, u, a in _pieces(exact=True):
            times = {begin, end}
            for edge in edges:
                roots = mp.polyroots([a, u, x - edge]) if a else [(edge - x) / u]
                times |= {begin + mp.re(h) for h in roots if not mp.im(h)}
            times = sorted(t for t in times if begin <= t <= end)
            for first, last in itertools.pairwise(times):
                h = (first + last) / 2 - begin
                index = sum(edge <= x + h * (u + a * h) for edge in edges) - 1
                if 0 <= index < NUM_TAPS:
                    taps[index] += (_open_until(last / T, True) - _open_until(first / T, True)) / 2
        return np.array([float(tap) for tap in taps])


def _by_roots():
    """Taps by the roots of each piece, in NumPy."""
    taps = np.zeros(NUM_TAPS)
    for begin, end, x, u, a in _pieces():
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(u * u - 4 * a * (x - EDGES))
            roots = [(-u - root) / (2 * a), (-u + root) / (2 * a)] if a else [(EDGES - x) / u]
        inside = np.concatenate(roots)
        inside = np.sort(inside[(inside > 0) & (inside < end - begin)])
        times = np.concatenate([[0.0], inside, [end - begin]])
        middle = (times[1:] + times[:-1]) / 2
        light = np.diff(_open_until((times + begin) / HALF)) / 2
        taps += np.histogram(x + middle * (u + a * middle), EDGES, weights=light)[0]
    return taps


def _by_instants(count):
    """Taps by so many instants at the middles of equal steps, in NumPy."""
    tau = (np.arange(count) + 0.5) * (2 / count) - 1
    time, position = tau * HALF, np.zeros(count)
    for begin, end, x, u, a in _pieces():
        here = (time >= begin) & (time <= end)
        h = time[here] - begin
        position[here] = x + h * (u + a * h)
    return np.histogram(position, EDGES, weights=(1 + np.cos(np.pi * tau)) / (2 * count))[0]


def precision() -> list[dict]:
    """Time and error of a kernel of a path of 12 pieces, beside other ways."""
    path = FreeMotion(accelerations=BEND, half_exposure=HALF)
    jitted = jax.jit(lambda s: binned_exposure(HannShutter(), path, speed=s, edges=EDGES))
    ways = {("ours, compiled", 0): lambda: jitted(SPEED), ("roots in NumPy", 0): _by_roots}
    ways |= {("instants in NumPy", n): partial(_by_instants, n) for n in INSTANTS}
    truth, rows = _by_reference(), []
    for (name, count), way in ways.items():
        told = harness.timed(way)
        error = float(np.max(np.abs(np.asarray(told["value"]) - truth)) / np.max(truth))
        row = {"way": name, "instants": count or "", "error of the largest tap": f"{error:.1e}"}
        rows.append(row | {"us": told["best_s"] * 1e6, "first call s": told["first_s"]})
    return rows


def picture(rows: list[dict]) -> None:
    """Error along x, time along y; ours is filled."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    marks = dict(zip(dict.fromkeys(row["way"] for row in rows), "osv", strict=True))
    for name, mark in marks.items():
        chosen = [row for row in rows if row["way"] == name]
        x = [max(float(row["error of the largest tap"]), 1e-17) for row in chosen]
        mine = name.startswith("ours")
        style = {"color": "black" if mine else "0.45", "fillstyle": "full" if mine else "none"}
        axes.loglog(x, [row["us"] for row in chosen], mark + "-", label=name, **style)
    axes.set(
        xlabel="largest error / largest tap",
        ylabel="time / µs",
        title=f"{NUM_TAPS} taps on a free path of {BEND.size} pieces",
    )
    axes.legend(frameon=False)
    axes.grid(alpha=0.3)
    figure.savefig(harness.RESULTS / "free_path.png", dpi=150)
    plt.close(figure)


def main() -> None:
    """Measure, store and print."""
    count = int(sys.argv[1]) if sys.argv[1:] and sys.argv[1].isdigit() else POINTS
    cases = [("parabola", 1), *((kind, n) for kind in list(KINDS)[1:] for n in PIECES)]
    rows = [timings(kind, n, num_taps) for kind, n in cases for num_taps in TAPS]
    precisions = np.float64, np.float32
    exact = [accuracy(slug, p, count) for slug in ("tukey", "flutter") for p in precisions]
    ways = precision()
    picture(ways)
    harness.write("free_path", rows, accuracy=exact, precision=ways)
    text = "## Free paths: time by taps and pieces\n\n" + harness.table(rows, list(rows[0]))
    text += "\n\nTime against error on a path of 12 pieces, ![](results/free_path.png)\n\n"
    text += harness.table(ways, list(ways[0]))
    text += "\n\nWorst error of random paths, in units of what is promised:\n\n"
    harness.section("free_path", text + harness.table(exact, list(exact[0])))


if __name__ == "__main__":
    main()
