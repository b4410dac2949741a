"""When does a moving camera pay: how much is in front of what, how wide, and in how much light?

The best design that `optimise` finds for each scene, which is read from a file, over the best
snapshot for the same scene; and what the design for a picture that moves as a whole would have
there. A typical printout stands in `RESULTS.md`.
"""

import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import jax
import numpy as np

from benchmarks import harness
from mishutter import (
    Design,
    Scene,
    evaluate,
    example_scene,
    optimise,
)
from mishutter.evaluation.speed_knowledge import ExpectedErrorLoss
from mishutter.search.rivals import RivalSearch, snapshots
from mishutter.search.rows import Row, best_row


class Light(NamedTuple):
    """Photo-electrons a second at white, and read noise, e-."""

    rate: float
    noise: float

    @property
    def name(self) -> str:
        """The column of the table."""
        return f"{self.rate:.0e}, {self.noise:g} e-".replace("e+0", "e")


LIGHTS = tuple(
    Light(*each)
    for each in ((1e5, 8), (1e4, 8), (1e6, 8), (1e5, 16), (1e4, 16), (1e5, 4), (1e6, 16))
)
SHARES = (0.7, 0.5, 0.3)
"""Of a picture that move before a still background."""
WIDTHS = (100, 300, 30, None)
"""Of the objects, px; None is no edges."""
NUM_STARTS = 4
"""Of a search; 16, the usual number, end in the same designs where both were tried."""
TEXT = """## When a moving camera pays

Gain, dB, of the best design that `optimise` finds over the best snapshot for the same scene, both
of a scene file: nine speeds to 4,500 px/s either way, the default spectrum, a stroke up to 45 px,
exposures up to 40 ms. A column is of a light, photo-electrons a second at white, and a read noise.
`0` is less than 0.005 dB: nothing beats a snapshot. Searches have {starts} starts; the
usual 16 ended in the same designs in the six cells where both were tried.

{gains}

How the best camera changes with what hides what, at {light}, and what the design for a picture that
moves as a whole would gain there:

{designs}

A picture that moves as a whole leaves its best design loosely determined, and layers do not:
designs that are equal to {whole:.2f} dB there are {narrow:.2f} dB apart where both layers move and
objects are of 30 px. Each of these is the best for a picture that moves as a whole at the speeds in
its row, or for the built-in scene. Their gains at the nine speeds of the table, dB:

{kept}
"""
FILE = """
[speeds]
uniform = {{ min_px_per_s = -{speed:g}, max_px_per_s = {speed:g}, count = {count} }}
[light]
photon_rate_per_s = {rate:g}
[sensor]
read_noise_e = {noise:g}
[limits]
max_stroke_px = 45
max_half_exposure_ms = 20
"""


class World(NamedTuple):
    """What hides what: `front_share`, `object_width` and `background` of `Occlusion`."""

    share: float = 1.0
    width: int | None = None
    background: str = "still"

    @property
    def name(self) -> str:
        """The row of the table."""
        if self.share == 1:
            return "as a whole"
        width = "no edges" if self.width is None else f"{self.width} px"
        if self.background == "moving":
            return f"both layers move, {self.share:.0%} in front, {width}"
        return f"before a still background, {self.share:.0%} moves, {width}"

    @property
    def section(self) -> str:
        """Its section of a scene file."""
        if self.share == 1:
            return ""
        lines = ["[occlusion]", f"front_share = {self.share:g}"]
        if self.width is not None:
            lines.append(f"object_width_px = {self.width}")
        return "\n".join([*lines, f'background = "{self.background}"', ""])


WHOLE = World()
MOVING = tuple(World(0.3, width, "moving") for width in WIDTHS if width)
STILL = tuple(World(share, width) for width in WIDTHS for share in SHARES)
WORLDS = (WHOLE, *MOVING, *STILL)
_NAMES = tuple(world.name for world in WORLDS)
TABLE = (
    WHOLE,
    *sorted(STILL, key=lambda world: (-world.share, -(world.width or 1000))),
    *sorted(MOVING, key=lambda world: -(world.width or 0)),
)
"""In the order of rows of the table."""
FIRST = (WHOLE, MOVING[0], *STILL[: len(SHARES)])
"""Worlds of objects of 100 px, which are measured in every light before the others."""


class Speeds(NamedTuple):
    """So many speeds, evenly spaced up to the greatest either way, px/s."""

    greatest: float = 4500
    number: int = 9

    @property
    def name(self) -> str:
        """The row of the table of designs that are kept."""
        return f"{self.number} speeds to {self.greatest:,g} px/s"


SPEEDS = Speeds()
OTHER_SPEEDS = (SPEEDS, Speeds(4500, 37), Speeds(4250, 18))
"""Speeds for which designs are made that are kept where both layers move."""


def scene_of(world: World, light: Light, speeds: Speeds) -> Scene:
    """The scene as its file has it."""
    numbers = {"rate": light.rate, "noise": light.noise}
    text = FILE.format(speed=speeds.greatest, count=speeds.number, **numbers)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(text + world.section)
        return Scene.load(path)


class Best(NamedTuple):
    """The best snapshot of a scene and the best design."""

    snapshot: Row
    design: Design

    @property
    def gain(self) -> float:
        """Of the design over the snapshot; dB."""
        return float(self.design.metrics.expected_psnr) - self.snapshot.level


def best_of(scene: Scene, num_starts: int | None = NUM_STARTS) -> Best:
    """The best snapshot, which may pan, and the best design of constant acceleration."""
    snapshot = best_row(snapshots(RivalSearch(scene, ExpectedErrorLoss())))
    return Best(snapshot, optimise(scene, num_starts=num_starts))


def cell(world: World, light: Light, whole: Design | None) -> tuple[dict[str, Any], Design]:
    """A row of what is best in a world, and its design; `whole` is that for the whole picture."""
    scene, start = scene_of(world, light, SPEEDS), process_time()
    snapshot, design = best = best_of(scene)
    seconds = process_time() - start
    other = design if whole is None else whole
    level = float(evaluate(scene, other.motion, other.shutter).expected_psnr)
    row = {
        "world": world.name,
        "light": light.name,
        "snapshot dB": snapshot.level,
        "snapshot ms": 1e3 * float(snapshot.motion.exposure),
        "gain dB": best.gain,
        "exposure ms": 1e3 * float(design.motion.exposure),
        "stroke px": float(design.motion.stroke),
        "efficiency": float(design.shutter.efficiency()),
        "gain of the design for the whole picture, dB": level - snapshot.level,
        "processor s": seconds,
    }
    return row, design


def cells(lights: Sequence[Light], worlds: Sequence[World]) -> Iterator[dict[str, Any]]:
    """Rows of worlds in lights, column by column."""
    for light in lights:
        whole = None
        for world in (WHOLE, *(each for each in worlds if each != WHOLE)):
            row, design = cell(world, light, whole)
            whole = design if whole is None else whole
            yield row


def kept() -> list[dict[str, Any]]:
    """Gains of designs for a picture that moves as a whole, there and where both layers move."""
    light = LIGHTS[0]
    scenes = {each.name: scene_of(WHOLE, light, each) for each in OTHER_SPEEDS}
    scenes["the built-in scene, a photograph's spectrum"] = example_scene()
    designs = {name: optimise(scene, num_starts=NUM_STARTS) for name, scene in scenes.items()}
    rows = [
        {
            "design for": name,
            "exposure ms": 1e3 * float(design.motion.exposure),
            "throughput": float(design.shutter.efficiency()),
        }
        for name, design in designs.items()
    ]
    for world in (WHOLE, *sorted(MOVING, key=lambda world: -(world.width or 0))):
        scene = scene_of(world, light, SPEEDS)
        snapshot = best_row(snapshots(RivalSearch(scene, ExpectedErrorLoss()))).level
        for row, design in zip(rows, designs.values(), strict=True):
            level = float(evaluate(scene, design.motion, design.shutter).expected_psnr)
            row[world.name] = level - snapshot
    return rows


def stored(name: str, new: Iterator[dict[str, Any]], rows: list[dict[str, Any]]) -> None:
    """Keep rows one by one, which each take long, in place of older ones of the same cell."""
    for row in new:
        rows[:] = [r for r in rows if (r["world"], r["light"]) != (row["world"], row["light"])]
        rows.append(row)
        harness.write(name, rows)
        print(
            *(f"{x:.4g}" if isinstance(x, float) else x for x in row.values()),
            sep=" | ",
            file=sys.stderr,
            flush=True,
        )


def shown_gain(gain: float) -> str:
    """A gain of the table."""
    return f"{gain:+.2f}" if abs(gain) >= 0.005 else "0"


def table_of_gains(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Worlds by lights."""
    gains = {(row["world"], row["light"]): shown_gain(row["gain dB"]) for row in rows}
    return [
        {"picture": world.name}
        | {light.name: gains.get((world.name, light.name)) for light in sorted(LIGHTS)}
        for world in TABLE
    ]


def table_of_designs(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The best camera of each world in the first of the lights."""
    cells = {row["world"]: row for row in rows if row["light"] == LIGHTS[0].name}
    of_whole = "gain of the design for the whole picture, dB"
    return [
        {
            "picture": world.name,
            "snapshot ms": f"{row['snapshot ms']:.2f}",
            "exposure ms": f"{row['exposure ms']:.1f}",
            "stroke px": f"{row['stroke px']:.1f}",
            "throughput": f"{row['efficiency']:.2f}",
            "gain dB": shown_gain(row["gain dB"]),
            of_whole: shown_gain(row[of_whole]),
        }
        for world in TABLE
        if (row := cells.get(world.name))
    ]


def table_of_kept(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Designs for the whole picture by worlds."""
    return [
        row
        | {"exposure ms": f"{row['exposure ms']:.1f}", "throughput": f"{row['throughput']:.2f}"}
        | {name: shown_gain(gain) for name, gain in row.items() if name in _NAMES}
        for row in rows
    ]


def text_of(
    rows: Sequence[dict[str, Any]],
    designs: Sequence[dict[str, Any]],
) -> str:
    """The section of the results: every cell, and designs that are kept."""
    gains, best, others = table_of_gains(rows), table_of_designs(rows), table_of_kept(designs)

    def apart(world: World) -> float:
        return float(np.ptp([row[world.name] for row in designs]))

    return TEXT.format(
        gains=harness.table(gains, list(gains[0])),
        starts=NUM_STARTS,
        light=LIGHTS[0].name,
        designs=harness.table(best, list(best[0])),
        whole=apart(WHOLE),
        narrow=apart(MOVING[-1]),
        kept=harness.table(others, list(others[0])),
    )


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows: list[dict[str, Any]] = []
    stored("gains", cells(LIGHTS, FIRST), rows)
    stored("gains", cells(LIGHTS, [world for world in WORLDS if world not in FIRST]), rows)
    designs = kept()
    harness.write("gains_of_kept", designs)
    harness.section("gains", text_of(rows, designs))


if __name__ == "__main__":
    main()
