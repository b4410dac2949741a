"""Does an independent search find better cameras for a decoder that is told the speed?

The search is that of `benchmarks.independent`, which shares no code with the package, for the
expected error of Wiener filters, one for each speed: first of open shutters, by exposure,
acceleration and pan, then from the best of these and from random points with a profile too.
"""

import time
from functools import partial
from typing import Any

import jax

from benchmarks import harness
from benchmarks.independent import (
    ALLOWED,
    NUM_PIECES,
    OPEN_TOLD,
    SHAPED_TOLD,
    measured_anew,
    search,
)
from benchmarks.scenes import scenes
from mishutter import KnownSpeedLoss, Scene, optimise

FREE = ("shutter", "half_exposure", "velocity", "acceleration")
NUM_SCREENED, NUM_DESCENTS = 300, 1
COLUMNS = ("scene", "package", "by the other measure", "open", "shaped", "lead")


def measured(scene: Scene) -> dict[str, float]:
    """Levels of the best camera by either search, dB."""
    design = optimise(scene, loss=KnownSpeedLoss(), free=FREE)
    best_of = partial(search, scene, num_screened=NUM_SCREENED, num_descents=NUM_DESCENTS)
    opened = best_of(OPEN_TOLD)
    start = opened.point.copy()
    start[3 + NUM_PIECES :] = 1.0
    shaped = best_of(SHAPED_TOLD, first=(start,))
    return {
        "package": float(design.metrics.known_speed_psnr),
        "by the other measure": measured_anew(scene, design.shutter, design.motion, is_told=True),
        "open": opened.psnr,
        "shaped": shaped.psnr,
    }


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows: list[dict[str, Any]] = []
    start = time.perf_counter()
    for name, scene in scenes().items():
        levels = measured(scene)
        lead = max(levels["open"], levels["shaped"]) - levels["by the other measure"]
        rows.append({"scene": name, **levels, "lead": lead})
        print(rows[-1], f"{time.perf_counter() - start:.0f} s", flush=True)
    harness.write("told", rows, seconds=time.perf_counter() - start)
    shown = [
        {key: f"{round(x, 3) + 0.0:.3f}" if isinstance(x, float) else x for key, x in row.items()}
        for row in rows
    ]
    largest = max(row["lead"] for row in rows)
    note = (
        "Expected PSNR, dB, of a decoder that is told the speed: of the package's design, of the "
        "same by the other measure, and of what a search that shares no code with it finds with "
        f"an open shutter and with a profile. That is at most {largest:+.4f} dB over the "
        f"package's by the same measure ({ALLOWED} is allowed)."
    )
    heading = "## An independent search for a decoder that is told the speed\n\n"
    harness.section("told", f"{heading}{harness.table(shown, list(COLUMNS))}\n\n{note}")


if __name__ == "__main__":
    main()
