"""Is the level of stills before a background what `restore` reaches on layered photographs?

Two ellipses of photographs move along the rows, or in any direction, before a third photograph, and
four stills of several lengths and orders are taken of them. The outlines' share of the level was
fitted to the first 12 scenes along the rows, and to no other. The level is that of the picture's
own spectrum; the restored picture is that of the middle of the burst, with the speeds told, and on
some scenes found.
"""

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import mishutter as ms
from benchmarks import harness
from benchmarks.bursts_photographs import decibels
from benchmarks.photographs import PHOTOGRAPHS
from mishutter.evaluation.bursts import moments_of
from mishutter.pictures.images import Picture, shipped_picture, write_picture

SIZE, RATE, READ_NOISE, PERIOD = 160, 1e5, 8.0, 0.02
SIZE_IN_PLANE = 200
"""Of scenes in which things move in any direction; px."""
SPEEDS = (0.35, 0.6, 0.95)
"""Of objects, over the fastest thing of the camera."""
FASTEST = 900.0
ORDERS = (
    (20, 3, 20, 3),
    (20, 6, 20, 6),
    (20, 9, 20, 9),
    (6, 6, 6, 6),
    (4, 4, 4, 4),
    (3, 20, 20, 3),
    (20, 20, 3, 3),
    (13, 20, 20, 13),
    (20, 20, 20, 6),
)
"""Exposures, ms."""
GROUPS = {
    "fitted": ("along the rows, to which outlines were fitted", range(12), False),
    "fresh": ("along the rows, fresh", range(12, 20), False),
    "plane": ("in any direction, fresh", range(6), True),
}
"""Scenes: their name in the table, their seeds, and whether things move in any direction."""
NUM_FOUND = 4
"""Scenes of each group in which speeds are found too."""
STILLS = "four stills, ms, at 50/s, 1e5 e-/s, 8 e-"
MEAN, DEVIATION = "restored less level, mean of all", "the same, deviation of a scene"
TEXT = """## Levels before a background, told and reached

Four stills at 50/s, 1e5 e-/s and 8 e-, of {size} x {size} px, or {wide} x {wide} in any direction:
two ellipses of 44 to 80 px, of photographs, at 315 to 855 px/s before another photograph. Means,
dB, of the level and of the picture that `restore` gives with the speeds told; with the standard
error over the scenes, and the deviation of one scene.

{table}

{found}
"""


class Layered(NamedTuple):
    """Things before a photograph, and their picture at the middle of the frames."""

    layers: ms.Layers
    truth: np.ndarray
    share: float
    width: float
    in_plane: bool = False

    @property
    def speeds(self) -> list[Any]:
        """Speeds of the things, or their velocities along rows and columns; px/s."""
        each = [np.asarray(layer.velocity).tolist() for layer in self.layers.layers[1:]]
        return each if self.in_plane else [along for along, _ in each]

    def scene(self, folder: Path) -> ms.Scene:
        """The scene as a user would say it, with the picture's own spectrum."""
        law = f"list_px_per_s = {self.speeds}"
        text = (
            f"[speeds]\n{f'any_direction = {{ {law} }}' if self.in_plane else law}\n"
            f"[light]\nphoton_rate_per_s = {RATE}\n[sensor]\nread_noise_e = {READ_NOISE}\n"
            f'[picture]\npath = "truth.png"\n'
            f"[occlusion]\nfront_share = {self.share}\nobject_width_px = {self.width}\n"
        )
        picture = Picture(np.clip(self.truth, 0, 1)[..., None])
        write_picture(str(folder / "truth.png"), picture)
        (folder / "scene.toml").write_text(text, encoding="utf-8")
        return ms.Scene.load(folder / "scene.toml")

    def wide(
        self, fastest: float = 1140.0, rate: float = RATE, read_noise: float = READ_NOISE
    ) -> ms.Scene:
        """The scene of a camera that knows the greatest speed alone."""
        covered = ms.Occlusion(front_share=self.share, object_width=self.width)
        numbers = {"photon_rate": rate, "read_noise": read_noise, "occlusion": covered}
        if self.in_plane:
            return ms.Scene.any_direction(fastest, **numbers)
        return ms.Scene.uniform(max_speed=fastest, decoder_speed="known", **numbers)

    def stills(self, order: tuple[int, ...]) -> Any:
        """Stills of some exposures, ms, one a period or as they end."""
        frames = stills(order)
        if not self.in_plane:
            return frames
        times, exposures = (np.array([getattr(x, n) for x in frames]) for n in ("time", "exposure"))
        ends = np.concatenate([times - exposures / 2, times + exposures / 2])
        return ms.PlaneFrames(times, exposures, np.array([np.ptp(ends)]), np.zeros((2, 2)))


def layered(seed: int, *, in_plane: bool = False) -> Layered:
    """A scene at random."""
    random = np.random.default_rng([seed, 83])
    size, first, step = (SIZE_IN_PLANE, 24, 92) if in_plane else (SIZE, 8, 80)
    names = random.permutation([*PHOTOGRAPHS])

    def cut(name: str, rows: int, columns: int) -> np.ndarray:
        light = np.asarray(shipped_picture(name).luminance, float)
        top, left = (
            int(random.integers(0, n - own + 1))
            for n, own in zip(light.shape, (rows, columns), strict=True)
        )
        return light[top : top + rows, left : left + columns]

    truth = cut(str(names[0]), size, size)
    layers, share, widths = [ms.Layer(Picture(truth[..., None]))], 0.0, []
    for k, speed in enumerate(random.permutation(SPEEDS)[:2]):
        rows, columns = int(random.integers(44, 60)), int(random.integers(56, 80))
        down, across = np.mgrid[:rows, :columns]
        radius = np.hypot((down + 0.5) / rows * 2 - 1, (across + 0.5) / columns * 2 - 1)
        matte = np.clip((0.95 - radius) * min(rows, columns) / 2 + 0.5, 0, 1)
        light = cut(str(names[1 + k]), rows, columns)
        top, left = first + step * k, int((size - columns) / 2 + random.uniform(-20, 20))
        velocity: Any = float(speed * FASTEST * random.choice([-1, 1]))
        if in_plane:
            turn = random.uniform(0, 2 * np.pi)
            velocity = tuple((velocity * np.array([np.cos(turn), np.sin(turn)])).tolist())
        layers.append(ms.Layer(Picture(light[..., None], matte), velocity, left=left, top=top))
        place = slice(top, top + rows), slice(left, left + columns)
        truth = truth.copy()
        truth[place] += matte * (light - truth[place])
        share += float(np.sum(matte)) / size**2
        widths.append(float(np.sum(matte)) / rows)
    return Layered(ms.Layers(tuple(layers)), truth, share, float(np.mean(widths)), in_plane)


def stills(order: tuple[int, ...]) -> list[ms.TimedFrame]:
    """Stills of some exposures, ms, one a period or as they end."""
    exposures = [each * 1e-3 for each in order]
    times = moments_of(exposures, [max(PERIOD, each) for each in exposures[1:]])
    return [
        ms.TimedFrame(ms.StillCamera(half_exposure=each / 2), float(at))
        for each, at in zip(exposures, times, strict=True)
    ]


def measured(group: str, seed: int, *, finds: bool) -> list[dict[str, Any]]:
    """Levels told and reached of one scene."""
    each, rows = layered(seed, in_plane=GROUPS[group][2]), []
    ways = ("told", "found") if finds else ("told",)
    with tempfile.TemporaryDirectory() as folder:
        scene = each.scene(Path(folder))
        for order in ORDERS:
            frames, key = each.stills(order), jax.random.key(seed)
            taken = np.asarray(ms.simulate_frames(each.layers, each.wide(), frames, key=key))
            row = {"group": group, "seed": seed, "order": ", ".join(map(str, order))}
            row["level"] = float(ms.exposures_psnr(scene, frames))
            for way in ways:
                speed: Any = each.speeds if way == "told" else None
                light = np.asarray(ms.restore_frames(taken, each.wide(), frames, speed=speed).light)
                row[way] = decibels(np.mean((np.clip(light[..., 0], 0, 1) - each.truth) ** 2))
            rows.append(row)
    return rows


def main(*names: str) -> None:
    """Measure some groups or all, store and print all."""
    jax.config.update("jax_enable_x64", True)
    kept = harness.RESULTS / "strips.json"
    every = json.loads(kept.read_text("utf-8"))["rows"] if kept.exists() else []
    for name in names or GROUPS:
        every = [row for row in every if row.get("group") != name]
        for count, seed in enumerate(GROUPS[name][1]):
            every += measured(name, seed, finds=count < NUM_FOUND)
            print(f"{name} {seed}: {time.process_time():.0f} processor seconds", flush=True)
        harness.write("strips", every)
    shown(every)


def shown(every: list[dict]) -> None:
    """Print a row of each order, and what is restored beside the level in the mean of all."""
    orders = [", ".join(map(str, each)) for each in ORDERS]
    table = [{STILLS: order} for order in (*orders, MEAN, DEVIATION)]
    found = []
    for name, (words, _, _) in GROUPS.items():
        group = [row for row in every if row.get("group") == name]
        if not group:
            continue
        scenes = len({row["seed"] for row in group})
        above = np.array([row["told"] - row["level"] for row in group])
        error = above.reshape(scenes, -1).mean(axis=1).std(ddof=1) / np.sqrt(scenes)
        column = f"{scenes} {words}: level, restored"
        for order, row in zip(orders, table, strict=False):
            own = [each for each in group if each["order"] == order]
            level, told = (np.mean([each[key] for each in own]) for key in ("level", "told"))
            row[column] = f"{level:.1f}, {told:.1f}"
        table[-2][column] = f"{above.mean():+.1f} ± {error:.1f}"
        table[-1][column] = f"{above.std():.1f}"
        lost = [row["told"] - row["found"] for row in group if "found" in row]
        if lost:
            count = len({row["seed"] for row in group if "found" in row})
            off = f"{np.mean(lost):.2f} dB in the mean and {np.max(lost):.2f} dB at most"
            found.append(f"{off} on {count} {words}")
    text = f"Where `restore` found the speeds it lost: {'; '.join(found)}."
    sizes = {"size": SIZE, "wide": SIZE_IN_PLANE}
    cells = harness.table(table, list(table[0]))
    harness.section("strips", TEXT.format(table=cells, found=text, **sizes))


if __name__ == "__main__":
    main(*sys.argv[1:])
