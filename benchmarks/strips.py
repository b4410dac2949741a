"""Is the level of stills before a background what `restore` reaches on layered photographs?

Two ellipses of photographs move along the rows before a third photograph, and four stills of
several lengths and orders are taken of them. The level is that of the picture's own spectrum; the
restored picture is that of the middle of the burst, with the speeds told, and on some scenes found.
"""

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
NUM_SCENES, NUM_FOUND = 12, 4
COLUMNS = ("four stills, ms, at 50/s, 1e5 e-/s, 8 e-", "level", "restored", "deviation of a scene")
TEXT = """## Levels before a background, told and reached

Four stills of {count} scenes of {size} x {size} px: two ellipses of 44 to 80 px, of photographs, at
315 to 855 px/s before another photograph. Means, dB, of the level and of the picture that `restore`
gives with the speeds told; on {found} of the scenes it found them too, and lost {loss:.2f} dB in
the mean and {most:.2f} dB at most. {seconds:.0f} processor seconds.

{table}
"""


class Layered(NamedTuple):
    """Things before a photograph, and their picture at the middle of the frames."""

    layers: ms.Layers
    truth: np.ndarray
    share: float
    width: float

    @property
    def speeds(self) -> list[float]:
        """Speeds of the things; px/s."""
        return [float(np.asarray(layer.velocity)[0]) for layer in self.layers.layers[1:]]

    def scene(self) -> ms.Scene:
        """The scene as a user would say it, with the picture's own spectrum."""
        text = (
            f"[speeds]\nlist_px_per_s = {self.speeds}\n"
            f"[light]\nphoton_rate_per_s = {RATE}\n[sensor]\nread_noise_e = {READ_NOISE}\n"
            f'[picture]\npath = "truth.png"\n'
            f"[occlusion]\nfront_share = {self.share}\nobject_width_px = {self.width}\n"
        )
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            picture = Picture(np.clip(self.truth, 0, 1)[..., None])
            write_picture(str(folder / "truth.png"), picture)
            (folder / "scene.toml").write_text(text, encoding="utf-8")
            return ms.Scene.load(folder / "scene.toml")


def layered(seed: int) -> Layered:
    """A scene at random."""
    random = np.random.default_rng([seed, 83])
    names = random.permutation([*PHOTOGRAPHS])

    def cut(name: str, rows: int, columns: int) -> np.ndarray:
        light = np.asarray(shipped_picture(name).luminance, float)
        top, left = (
            int(random.integers(0, n - own + 1))
            for n, own in zip(light.shape, (rows, columns), strict=True)
        )
        return light[top : top + rows, left : left + columns]

    truth = cut(str(names[0]), SIZE, SIZE)
    layers, share, widths = [ms.Layer(Picture(truth[..., None]))], 0.0, []
    for k, speed in enumerate(random.permutation(SPEEDS)[:2]):
        rows, columns = int(random.integers(44, 60)), int(random.integers(56, 80))
        down, across = np.mgrid[:rows, :columns]
        radius = np.hypot((down + 0.5) / rows * 2 - 1, (across + 0.5) / columns * 2 - 1)
        matte = np.clip((0.95 - radius) * min(rows, columns) / 2 + 0.5, 0, 1)
        light = cut(str(names[1 + k]), rows, columns)
        top, left = 8 + 80 * k, int((SIZE - columns) / 2 + random.uniform(-20, 20))
        velocity = float(speed * FASTEST * random.choice([-1, 1]))
        layers.append(ms.Layer(Picture(light[..., None], matte), velocity, left=left, top=top))
        place = slice(top, top + rows), slice(left, left + columns)
        truth = truth.copy()
        truth[place] += matte * (light - truth[place])
        share += float(np.sum(matte)) / SIZE**2
        widths.append(float(np.sum(matte)) / rows)
    return Layered(ms.Layers(tuple(layers)), truth, share, float(np.mean(widths)))


def stills(order: tuple[int, ...]) -> list[ms.TimedFrame]:
    """Stills of some exposures, ms, one a period or as they end."""
    exposures = [each * 1e-3 for each in order]
    times = moments_of(exposures, [max(PERIOD, each) for each in exposures[1:]])
    return [
        ms.TimedFrame(ms.StillCamera(half_exposure=each / 2), float(at))
        for each, at in zip(exposures, times, strict=True)
    ]


def measured(seed: int) -> list[dict[str, Any]]:
    """Levels told and reached of one scene."""
    each, rows = layered(seed), []
    scene, wide = (
        each.scene(),
        ms.Scene.uniform(
            max_speed=1140.0,
            photon_rate=RATE,
            read_noise=READ_NOISE,
            occlusion=ms.Occlusion(front_share=each.share, object_width=each.width),
            decoder_speed="known",
        ),
    )
    for order in ORDERS:
        frames = stills(order)
        taken = np.asarray(ms.simulate_frames(each.layers, wide, frames, key=jax.random.key(seed)))
        row = {"seed": seed, "order": ", ".join(map(str, order))}
        row["level"] = float(ms.exposures_psnr(scene, frames))
        for way in ("told", "found")[: 2 if seed < NUM_FOUND else 1]:
            speed: Any = each.speeds if way == "told" else None
            light = np.asarray(ms.restore_frames(taken, wide, frames, speed=speed).light)
            row[way] = decibels(np.mean((np.clip(light[..., 0], 0, 1) - each.truth) ** 2))
        rows.append(row)
    return rows


def main(*arguments: str) -> None:
    """Measure, store and print, of as many scenes as are asked for."""
    jax.config.update("jax_enable_x64", True)
    count, begun = int(arguments[0]) if arguments else NUM_SCENES, time.process_time()
    rows = [row for seed in range(count) for row in measured(seed)]
    table = []
    for order in (", ".join(map(str, each)) for each in ORDERS):
        own = [row for row in rows if row["order"] == order]
        off = [row["told"] - row["level"] for row in own]
        means = (np.mean([row[name] for row in own]) for name in ("level", "told"))
        cells = (order, *(f"{mean:.1f}" for mean in means), f"{np.std(off):.1f}")
        table.append(dict(zip(COLUMNS, cells, strict=True)))
    lost = [row["told"] - row["found"] for row in rows if "found" in row]
    harness.write("strips", rows)
    text = TEXT.format(
        count=count,
        size=SIZE,
        found=min(count, NUM_FOUND),
        loss=np.mean(lost),
        most=np.max(lost),
        seconds=time.process_time() - begun,
        table=harness.table(table, list(COLUMNS)),
    )
    harness.section("strips", text)


if __name__ == "__main__":
    main(*sys.argv[1:])
