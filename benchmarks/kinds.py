"""Is what the answer tells reached, of each kind of scene, by the commands that it names?

Each scene has a photograph. Its recommended option is found, exported, simulated on that
photograph, or on details of it that move before it, and restored.

What `results/kinds.json` holds already is not done again: remove it to begin anew.
"""

import contextlib
import io
import itertools
import json
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

import mishutter as ms
from benchmarks import harness
from benchmarks.bursts_photographs import decibels
from mishutter import cli
from mishutter.pictures.images import read_picture, shipped_picture, write_picture

PHOTOGRAPHS = ("camera.png", "coffee.png", "gravel.png")
ROWS, COLUMNS, FIRST_ROW = 192, 320, 100
"""The part of a photograph that is taken."""
SPEEDS = (-900, -450, 0, 450, 900)
"""Speeds of the scenes, px/s, at all of which the photograph passes."""
ONE_WAY = tuple(range(200, 1101, 225))
DISC, DIRECTIONS = 700.0, 2
"""Greatest velocity in any direction, px/s, and how many are taken, evenly over the disc."""
WIDTH = 60
"""Width of the details that move; px."""
BURST = "[burst]\nframes_per_s = 60\nmax_frames = 4\nwindow_ms = 60\n"
ALONE = "[burst]\nframes_per_s = 30\nmax_frames = 1\n"
"""Of a camera whose frames cannot be registered, so that one exposure is the answer."""
SCENE = """[speeds]
{speeds}
[light]
photon_rate_per_s = 3e4
[sensor]
read_noise_e = 6
axis = "{axis}"
[limits]
max_stroke_px = 60
max_exposure_ms = 40
[picture]
path = "photograph.png"
{sections}"""
TEXT = """## The answer of each kind of scene, and what comes of it

PSNR of the recommended option of a scene of each kind, dB, in the mean over some photographs of
{rows} x {columns} px: as told, and as found in the picture that was exported, simulated and
restored by the commands, over the scene's speeds; the difference with its standard deviation over
the photographs. Before a background and of several objects, two details of {width} px move before
the photograph; of objects alone, only their pixels count.

{table}"""


class Kind(NamedTuple):
    """A kind of scene: its speeds, px/s, and the further sections of its file."""

    speeds: tuple[int, ...] | None  # None for velocities in any direction
    sections: str
    axis: str = "rows"
    has_layers: bool = False

    @property
    def text(self) -> str:
        """The scene's file."""
        speeds = f"any_direction = {{ max_px_per_s = {DISC:g} }}"
        if self.speeds is not None:
            low, high, count = self.speeds[0], self.speeds[-1], len(self.speeds)
            ends = f"min_px_per_s = {low}, max_px_per_s = {high}"
            speeds = f"uniform = {{ {ends}, count = {count} }}"
        return SCENE.format(speeds=speeds, axis=self.axis, sections=self.sections)

    @property
    def velocities(self) -> list[tuple[float, ...]]:
        """Speeds or velocities of photographs; px/s."""
        if self.speeds is not None:
            return [(float(speed),) for speed in self.speeds]
        share = np.arange(0.5, DIRECTIONS) / DIRECTIONS
        size, angle = DISC * np.sqrt(share), 2.4 * np.arange(DIRECTIONS)  # as seeds of a sunflower
        return [*zip(*(size * [np.cos(angle), np.sin(angle)]).tolist(), strict=True)]


KINDS = {
    "along rows": Kind(SPEEDS, ALONE),
    "along columns": Kind(SPEEDS, BURST, axis="columns"),
    "one-way speeds": Kind(ONE_WAY, BURST),
    "known speeds": Kind(SPEEDS, BURST + '[decoder]\nspeed = "known"\n'),
    "background": Kind(
        SPEEDS,
        BURST + f"[occlusion]\nfront_share = 0.1\nobject_width_px = {WIDTH}\n",
        has_layers=True,
    ),
    "objects": Kind(SPEEDS, BURST + f"[objects]\nwidth_px = {WIDTH}\n", has_layers=True),
    "any direction": Kind(None, BURST),
    "objects in any direction": Kind(
        None, BURST + f"[objects]\nwidth_px = {WIDTH}\n", has_layers=True
    ),
    "background in any direction": Kind(
        None,
        BURST + f"[occlusion]\nfront_share = 0.1\nobject_width_px = {WIDTH}\n",
        has_layers=True,
    ),
    "servo": Kind(SPEEDS, ALONE + "[stage]\nbandwidth_hz = 300\n"),
    "device": Kind(SPEEDS, ALONE + "[shutter]\ntransmission = 0.8\nrise_ms = 1\nlevels = 16\n"),
    "tolerances": Kind(
        SPEEDS, ALONE + "[tolerances]\nobject_speed_px_per_s = 10\nacceleration_share = 0.02\n"
    ),
}


def typed(*words: str) -> dict:
    """The document of a command."""
    written = io.StringIO()
    with contextlib.redirect_stdout(written):
        code = cli.main([*words, "--json"])
    if code:
        raise SystemExit(f"mishutter {' '.join(words)}: ended with {code}")
    return json.loads(written.getvalue())


def layers_of(light: np.ndarray, velocities: list[tuple[float, ...]]) -> ms.Layers:
    """Two details of a photograph before it, of the first velocity and of the last."""
    down, across = np.mgrid[:WIDTH, :WIDTH] - (WIDTH - 1) / 2
    matte = np.clip(WIDTH / 2 - 1 - np.hypot(down, across), 0, 1)
    every = [ms.Layer(ms.Picture(light[..., None]))]
    for velocity, left, top in zip(
        (velocities[0], velocities[-1]), (60, 200), (50, 90), strict=True
    ):
        detail = np.flip(light)[top : top + WIDTH, left : left + WIDTH]
        speed = velocity[0] if len(velocity) == 1 else velocity
        every.append(ms.Layer(ms.Picture(detail[..., None], matte), speed, left=left, top=top))
    return ms.Layers(tuple(every))


def error_before(kind: Kind, light: np.ndarray, own: Path) -> float:
    """Squared error of details before a photograph, restored at the middle of the frames."""
    layers = layers_of(light, kind.velocities)
    ms.write_layers(own, layers)
    typed("simulate", "--design", "own", "--subject", str(own / "layers.toml"), "--out", str(own))
    restored = np.asarray(read_picture(own / "restored.png").luminance, np.float64)
    truth, outlines = light.copy(), np.zeros_like(light)
    for each in layers.layers[1:]:
        place = slice(each.top, each.top + WIDTH), slice(each.left, each.left + WIDTH)
        truth[place] += each.matte * (each.picture.luminance - truth[place])
        outlines[place] += each.matte
    is_judged = outlines > 0.5 if "[objects]" in kind.sections else outlines >= 0
    return float(np.mean((restored - truth) ** 2, where=is_judged))


def error_alone(kind: Kind, own: Path) -> float:
    """Mean squared error of a photograph that passes as a whole, restored, over the velocities."""
    errors = []
    for number, velocity in enumerate(kind.velocities):
        speed = ",".join(f"{each:.6g}" for each in velocity)
        shot = ["simulate", "--design", "own", "--subject", "photograph.png"]
        seed = ["--seed", str(number), "--out", str(own), f"--speed={speed}"]
        quality = typed(*shot, *seed)["quality"]
        errors.append(10 ** (-quality["PSNR / dB, linear light"] / 10))
    return float(np.mean(errors))


def measured(kind: Kind, light: np.ndarray) -> dict:
    """The option, the level that is told and the one that is found, in the current folder."""
    write_picture("photograph.png", ms.Picture(light[..., None]))
    Path("scene.toml").write_text(kind.text, "utf-8")
    own = Path("own")
    answer = typed(
        "optimise", "scene.toml", "--noise-seeds", "0", "--starts", "4", "--out", str(own)
    )
    # A shutter stands there at the motion of the design too, which is not its best.
    told = max(row["psnr_db"] for row in answer["rows"] if row["name"] == answer["choice"])
    typed("export", str(own), "--out", str(own / "lab"))
    light = np.asarray(read_picture("photograph.png").luminance, np.float64)
    error = error_before(kind, light, own) if kind.has_layers else error_alone(kind, own)
    return {
        "option": answer["verdict"].splitlines()[0],
        "told": told,
        "found": decibels(error),
    }


def main(count: str = f"{len(PHOTOGRAPHS)}", *names: str) -> None:
    """Print the table, once so many photographs are restored of some kinds, or of all."""
    kept = harness.RESULTS / "kinds.json"
    every = json.loads(kept.read_text("utf-8"))["rows"] if kept.exists() else []
    chosen = PHOTOGRAPHS[: int(count)], names or KINDS
    for photograph, name in itertools.product(*chosen):
        at, kind = {"kind": name, "photograph": photograph}, KINDS[name]
        if all(at.items() - row.items() for row in every):
            whole = np.asarray(shipped_picture(photograph).luminance, np.float64)
            light = whole[FIRST_ROW : FIRST_ROW + ROWS, :COLUMNS]
            with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
                every.append(at | measured(kind, light))
            print(every[-1], flush=True)
            harness.write("kinds", every)
    rows = []
    for name in dict.fromkeys(row["kind"] for row in every):
        own = [row for row in every if row["kind"] == name]
        told, found = (np.array([each[key] for each in own]) for key in ("told", "found"))
        off = found - told
        spread = f" ± {off.std(ddof=1):.1f}" if len(own) > 1 else ""
        rows.append(
            {
                "kind of scene": name,
                "photographs": f"{len(own)}",
                "told": f"{told.mean():.1f}",
                "found": f"{found.mean():.1f}",
                "found less told": f"{off.mean():+.1f}{spread}",
            }
        )
    table = harness.table(rows, [*rows[0]])
    numbers = {"rows": ROWS, "columns": COLUMNS, "width": WIDTH}
    harness.section("kinds", TEXT.format(table=table, **numbers))


if __name__ == "__main__":
    main(*sys.argv[1:])
