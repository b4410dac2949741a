"""What does the kernel of a free path cost, by taps and pieces, and how exact is it?

Kernels of a Hann window and their gradients by every acceleration, on a parabola, on paths that
bend one way, and on paths that bend to and fro, each piece against the last; then the worst error
over random paths with pieces of every sign and of no length. `python -m benchmarks.free_path`.
"""

import sys

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

from benchmarks import harness  # noqa: E402
from mishutter import FreeMotion, HannShutter, ParabolicMotion, blur_kernel  # noqa: E402

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


def main() -> None:
    """Measure, store and print."""
    count = int(sys.argv[1]) if sys.argv[1:] and sys.argv[1].isdigit() else POINTS
    cases = [("parabola", 1), *((kind, n) for kind in list(KINDS)[1:] for n in PIECES)]
    rows = [timings(kind, n, num_taps) for kind, n in cases for num_taps in TAPS]
    precisions = np.float64, np.float32
    exact = [accuracy(slug, p, count) for slug in ("tukey", "flutter") for p in precisions]
    harness.write("free_path", rows, accuracy=exact)
    text = "## Free paths: time by taps and pieces\n\n" + harness.table(rows, list(rows[0]))
    text += "\n\nWorst error of random paths, in units of what is promised:\n\n"
    harness.section("free_path", text + harness.table(exact, list(exact[0])))


if __name__ == "__main__":
    main()
