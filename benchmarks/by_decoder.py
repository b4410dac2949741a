"""Does a decoder with a prior on photographs judge cameras as the expected error does?

Twelve photographs are captured by each camera of a comparison and restored by the ensemble filter
and by total variation, with an exposure that is tuned for either: `compare(decoder=...)`.
"""

from typing import Any

import jax

from benchmarks import harness
from benchmarks.photographs import COLUMNS, NUM_ROWS, PHOTOGRAPHS
from mishutter import (
    EnsembleDecoder,
    Limits,
    Scene,
    TotalVariationDecoder,
    compare,
    example_scene,
    optimise,
)
from mishutter.pictures.images import shipped_picture
from mishutter.report.by_decoder import judged_by
from mishutter.search.rows import OWN_BEST_MOTION, cameras_of

DECODERS = {"ensemble": EnsembleDecoder(), "total variation": TotalVariationDecoder()}
NOTE = (
    "Gains over the best snapshot, dB: as expected of one linear filter, and on {count} "
    "photographs ({rows} rows of {columns} px) with standard errors, each exposure tuned for the "
    "decoder; beside them the share of its expected best exposure that is best for total variation."
)


def scenes() -> dict[str, Scene]:
    """The five lines of README, and the built-in scene."""
    limits = Limits(max_stroke=38, max_half_exposure=0.04)
    slides = Scene.uniform(max_speed=2800.0, photon_rate=3e4, read_noise=10, limits=limits)
    return {"3e4 e-/s, 10 e-": slides, "built-in, 1e5 e-/s, 8 e-": example_scene()}


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    pictures = [
        shipped_picture(name).luminance[first : first + NUM_ROWS, :COLUMNS]
        for name, first in PHOTOGRAPHS.items()
    ]
    rows: list[dict[str, Any]] = []
    for scene_name, scene in scenes().items():
        table = compare(scene, optimise(scene))
        own = [row for row in table.rows if row.reading == OWN_BEST_MOTION]
        cameras = [camera[0] for camera in cameras_of(own)]
        found = {
            name: judged_by(decoder, pictures, scene, cameras, table.snapshot).cameras
            for name, decoder in DECODERS.items()
        }
        for row in cameras:
            judged = {name: by_name[row.name] for name, by_name in found.items()}
            rows.append(
                {"scene": scene_name, "camera": row.name}
                | {"expected": f"{table.over_snapshot(row.level):+.2f}"}
                | {n: f"{x.gain:+.2f} ± {x.standard_error:.2f}" for n, x in judged.items()}
                | {"share": f"{judged['total variation'].exposure_share:.2f}"}
            )
            print(rows[-1], flush=True)
    harness.write("by_decoder", rows)
    note = NOTE.format(count=len(pictures), rows=NUM_ROWS, columns=COLUMNS)
    text = harness.table(rows, list(rows[0]))
    harness.section("by_decoder", f"## Cameras judged by a decoder\n\n{text}\n\n{note}")


if __name__ == "__main__":
    main()
