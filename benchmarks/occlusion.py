"""Is the expected error of an object before a background what random rows leave?

A typical printout stands in `RESULTS.md`.
"""

import sys

import jax
import numpy as np
from scipy.stats import chi2
from support import layered_rows

import mishutter as ms
from benchmarks import harness

SPEEDS = (-3375.0, -1125.0, 1125.0, 3375.0)
"""px/s: of objects, and of backgrounds that move."""
SHARES, WIDTHS, PHOTON_RATES, READ_NOISE = (
    (0.3, 0.5, 0.7),
    (30.0, 100.0, 300.0),
    (1e4, 1e5, 1e6),
    8.0,
)
ROWS = {"snapshot of 2.16 ms": 144}
"""Rows of each configuration where more than 48 cost little."""


def parabola(stroke: float, half_exposure: float) -> ms.ParabolicMotion:
    """The motion of a stroke, px, over a half exposure, s."""
    return ms.ParabolicMotion(acceleration=stroke / half_exposure**2, half_exposure=half_exposure)


CAMERAS: dict[str, tuple[ms.AbstractMotion, ms.AbstractShutter]] = {
    "snapshot of 2.16 ms": (ms.StillCamera(half_exposure=1.08e-3), ms.RectShutter()),
    "Hann, 45 px, 18 ms": (parabola(45.0, 9e-3), ms.HannShutter()),
    "open, 30 px, 18 ms": (parabola(30.0, 9e-3), ms.RectShutter()),
    "triangle, 33 px, 10 ms": (parabola(33.0, 5e-3), ms.TriangleShutter()),
}


def pairs_of(background: str) -> list[tuple[float, float]]:
    """Equally likely speeds of background and object, px/s."""
    return [(b, f) for b in (SPEEDS if background == "moving" else (0.0,)) for f in SPEEDS]


def configurations() -> list[dict]:
    """Six for each camera: every share before either background, widths and lights in turn."""
    return [
        {
            "camera": name,
            "background": background,
            "share": SHARES[i],
            "width px": WIDTHS[(i + shift + moving) % 3],
            "e-/s": PHOTON_RATES[(i + 2 * shift) % 3],
        }
        for shift, name in enumerate(CAMERAS)
        for moving, background in enumerate(("still", "moving"))
        for i in range(3)
    ]


def measured(configuration: dict, seed: int) -> dict:
    """A configuration, and what is expected and left of its rows."""
    name, background = configuration["camera"], configuration["background"]
    camera = layered_rows.camera(*CAMERAS[name], max(SPEEDS))
    pairs = pairs_of(background)
    found = layered_rows.measure(
        np.random.default_rng(seed),
        camera,
        pairs,
        configuration["share"],
        configuration["width px"],
        camera.noise(configuration["e-/s"], READ_NOISE),
        ROWS.get(name, 48) // len(pairs),
    )
    more = found.psnr - found.expected
    return configuration | {
        "expected dB": found.expected,
        "measured dB": found.psnr,
        "difference": more,
        "standard error": found.standard_error,
        "in standard errors": more / found.standard_error,
    }


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows = []
    for seed, configuration in enumerate(configurations()):
        rows.append(measured(configuration, seed))
        print(rows[-1], file=sys.stderr, flush=True)
    squares = sum(row["in standard errors"] ** 2 for row in rows)
    print(squares, chi2.sf(squares, len(rows)))
    harness.write("occlusion", rows)


if __name__ == "__main__":
    main()
