"""Is a speed trusted where the frames fit one picture at one speed, and nowhere else?

Photographs pass a sensor, whose frames are taken as they should be, or with what a camera does
besides, or in one of the ways in which a burst is spoilt. Each draw has its own light, number of
frames, speed and seed. The same table shows whether error bars hold the error.
"""

import io
import itertools
import json
import math
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, NamedTuple

import jax
import numpy as np
from PIL import Image

import mishutter as ms
from benchmarks import harness
from benchmarks.photographs import PHOTOGRAPHS
from mishutter.pictures.images import shipped_picture

NUM_ROWS, WIDTH, PERIOD = 16, 256, 1 / 60
FASTEST = 3000.0
LIGHTS = {"1e5 e-/s, 8 e-": (1e5, 8.0), "1e6 e-/s, 2 e-": (1e6, 2.0), "1e4 e-/s, 2 e-": (1e4, 2.0)}
FRAMES = (2, 4, 8)
OTHERS = (
    *("chelsea.png", "coins.png", "motorcycle_right.png", "page.png", "cell.png", "text.png"),
    *PHOTOGRAPHS,
)
"""Photographs for error bars, any rows of each: first those on which no threshold was chosen."""
NUM_OTHERS, OTHER = 144, "other photographs"
WRONG = 0.5
"""Displacement from frame to frame by which a wrong speed is off; px."""
TEXT = """## Which speeds of bursts are trusted

{rows} rows of twelve photographs on a sensor of {width} px, at speeds up to 3,000 px/s either way,
60 frames a second, three lights ({lights}), bursts of 2, 4 and 8 stills and of as many parabolas.
"Misfit" is the median of `estimate.misfit`; a speed is wrong where frames are more than half a
pixel off. Speeds of a photograph without detail, such as a sky in dim light, are rightly in doubt.

{table}

Error bars are measured on other rows and photographs, and 2 to 8 frames that are as they should be:
of {count} trusted speeds of {draws} bursts, {within} % are within one error bar of the truth and
{within_two} % within two. The middle of all errors is {median} px from frame to frame."""


class Draw(NamedTuple):
    """One burst of one photograph."""

    light: np.ndarray
    scene: ms.Scene
    num_frames: int
    moves: bool
    speed: float
    seed: int

    def frames(self, count: int, stroke: float = 1.0) -> list[ms.TimedFrame]:
        """So many frames, on a path that is so many times the one that is told."""
        return swings(count, stroke) if self.moves else stills(count)

    def taken(
        self, frames: Sequence[ms.TimedFrame], speed: float, start: int = 0, seed: int = 0
    ) -> np.ndarray:
        """Frames of the photograph from some row on."""
        key = jax.random.key(self.seed + seed)
        rows = self.light[start : start + NUM_ROWS]
        kept = {"speed": speed, "num_columns": WIDTH, "key": key}
        return np.array(ms.simulate_frames(rows, self.scene, frames, **kept), np.float64)

    @property
    def noise(self) -> float:
        """Standard deviation of the noise in a frame of the photograph's level; white = 1."""
        electrons = float(self.scene.photon_rate) * self.frames(1)[0].exposure
        read = float(self.scene.read_noise)
        return math.sqrt(float(np.mean(self.light)) / electrons + (read / electrons) ** 2)


def stills(count: int, exposure: float = 1.5e-3) -> list[ms.TimedFrame]:
    """Frames of a sensor at rest."""
    still = ms.StillCamera(half_exposure=exposure / 2)
    return [ms.TimedFrame(still, (k - (count - 1) / 2) * PERIOD) for k in range(count)]


def swings(
    count: int, stroke: float = 1.0, exposure: float = 0.0164, sag: float = 24.0
) -> list[ms.TimedFrame]:
    """Parabolas of alternating direction."""
    half = exposure / 2
    a = stroke * sag / half**2
    far = 2 * stroke * sag + (PERIOD - exposure) * 2 * a * half
    paths = [
        ms.FreeMotion(accelerations=[side * a], half_exposure=half)
        for side in itertools.islice(itertools.cycle((1, -1)), count)
    ]
    times = [(k - (count - 1) / 2) * PERIOD for k in range(count)]
    return [
        ms.TimedFrame(*each, far * (k % 2)) for k, each in enumerate(zip(paths, times, strict=True))
    ]


def as_it_should_be(draw: Draw) -> dict[str, np.ndarray]:
    """Frames that fit, and with what cameras do besides."""
    frames = draw.frames(draw.num_frames)
    clean, random = draw.taken(frames, draw.speed), np.random.default_rng(draw.seed)
    signs = np.resize([1.0, -1.0], draw.num_frames)[:, None, None]
    drift = np.linspace(-0.02, 0.02, draw.num_frames)
    pattern = random.standard_normal(clean.shape[1:])
    columns = random.standard_normal(clean.shape[-1])
    return {
        "nothing": clean,
        "gain flickers by 20 %": clean * (1 + 0.2 * signs),
        "black level drifts by 4 %": clean + drift[:, None, None],
        "fixed pattern, 0.7 of the noise": clean + 0.7 * draw.noise * pattern,
        "fixed columns, 1 %": clean + 0.01 * columns,
        "JPEG of quality 15": np.stack([through_jpeg(one) for one in clean]),
    }


def through_jpeg(light: np.ndarray, quality: int = 15) -> np.ndarray:
    """Light that was written with gamma to a file that loses some of it."""
    numbers = np.rint(255 * np.clip(light, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(numbers).save(file, "JPEG", quality=quality)
    return (np.asarray(Image.open(file)) / 255.0) ** 2.2


def spoilt(draw: Draw) -> dict[str, np.ndarray]:
    """Frames that are no burst of one picture at one speed, of three at least."""
    count, speed = draw.num_frames, draw.speed
    frames, one_more = draw.frames(count), draw.frames(count + 1)
    clean, random = draw.taken(frames, speed), np.random.default_rng(draw.seed)
    first = frames[:1]
    cases = {
        "first frame twice, last lost": clean[[0, *range(count - 1)]],
        "last but one twice, last lost": clean[[*range(count - 1), count - 2]],
        "two frames exchanged": clean[[1, 0, *range(2, count)]],
        "a middle frame lost": np.delete(draw.taken(one_more, speed), count // 2, axis=0),
        "half of the rows at rest": np.concatenate(
            [
                clean[:, : NUM_ROWS // 2],
                draw.taken(frames, 0.0, seed=1)[:, NUM_ROWS // 2 :],
            ],
            axis=1,
        ),
        "moves down by 4 px a frame": np.concatenate(
            [draw.taken([one], 0.0, 4 * k, k) for k, one in enumerate(frames)]
        ),
        "frames of other rows": np.concatenate(
            [draw.taken(first, 0.0, 20 * k, k) for k in range(count)]
        ),
        "noise alone": random.uniform(0, 0.6, clean.shape),
        "flat, 4 times the noise": 0.3 + 4 * draw.noise * random.standard_normal(clean.shape),
        "one frame black": clean * (np.arange(count) != count // 2)[:, None, None],
        "one frame saturated": np.where(
            (np.arange(count) == count // 2)[:, None, None], 1.0, clean
        ),
    }
    if draw.moves:
        still = ms.StillCamera(half_exposure=frames[0].exposure / 2)
        at_rest = [ms.TimedFrame(still, one.time) for one in frames]
        cases["the stage stood still"] = draw.taken(at_rest, speed)
        cases["the stroke was 10 % longer"] = draw.taken(draw.frames(count, 1.1), speed)
    return cases


def draws(seed: int = 5) -> list[Draw]:
    """Two for each photograph: stills, and a sensor that moves."""
    random, result = np.random.default_rng(seed), []
    names, lights = list(PHOTOGRAPHS), list(LIGHTS.values())
    for k, (name, moves) in enumerate(itertools.product(names, (False, True))):
        rate, read_noise = lights[(k + k // 6) % len(lights)]
        scene = ms.Scene.uniform(max_speed=FASTEST, photon_rate=rate, read_noise=read_noise)
        light = shipped_picture(name).luminance[PHOTOGRAPHS[name] :]
        # As fast either way, and never so slow that a lost frame moves nothing.
        speed = float(random.uniform(300, 2600) * random.choice([-1, 1]))
        count = FRAMES[(k + k // 3) % len(FRAMES)]
        result.append(Draw(light, scene, count, moves, speed, int(random.integers(10**6))))
    return result


def others(seed: int = 11) -> list[Draw]:
    """Any rows of any photograph, by any light, number of frames and speed of the scene."""
    random, lights, result = np.random.default_rng(seed), list(LIGHTS.values()), []
    for name in itertools.islice(itertools.cycle(OTHERS), NUM_OTHERS):
        rate, read_noise = lights[random.integers(len(lights))]
        scene = ms.Scene.uniform(max_speed=FASTEST, photon_rate=rate, read_noise=read_noise)
        light = shipped_picture(name).luminance
        light = light[random.integers(len(light) - NUM_ROWS) :]
        speed = float(random.uniform(0, 0.95 * FASTEST) * random.choice([-1, 1]))
        count, moves = int(random.choice([2, 3, 4, 6, 8])), bool(random.integers(2))
        result.append(Draw(light, scene, count, moves, speed, int(random.integers(10**6))))
    return result


def judged(kind: str, draw: Draw, captures: np.ndarray) -> dict[str, Any]:
    """What is found in one burst."""
    frames = draw.frames(draw.num_frames)
    estimate = ms.restore_frames(captures, draw.scene, frames).estimate
    if estimate is None or estimate.misfit is None:
        raise RuntimeError("the speed was told")
    off = estimate.speed - draw.speed
    row = {
        "kind": kind,
        "frames": draw.num_frames,
        "moves": draw.moves,
        "trusted": bool(estimate.trusted),
        "misfit": float(estimate.misfit),
        "off": off,
        "bars": off / estimate.error,
        "wrong": bool(abs(off) * PERIOD > WRONG),
        "doubt": estimate.doubt,
    }
    print(json.dumps(row | {"rate": float(draw.scene.photon_rate)}), flush=True)
    return row


def all_of(place: int, draw: Draw) -> list[dict[str, Any]]:
    """What is found in each burst of one photograph."""
    jax.config.update("jax_enable_x64", True)
    cases = as_it_should_be(draw)
    # Of each photograph either the stills or the frames that move.
    if draw.num_frames > 2 and (place + 1) // 2 % 2 == 0:
        cases |= spoilt(draw)
    return [judged(kind, draw, seen) for kind, seen in cases.items()]


def one_of(draw: Draw) -> list[dict[str, Any]]:
    """What is found in a burst of another photograph."""
    jax.config.update("jax_enable_x64", True)
    return [judged(OTHER, draw, draw.taken(draw.frames(draw.num_frames), draw.speed))]


def measure() -> list[dict[str, Any]]:
    """What is found in each burst of all photographs."""
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        tuned = pool.map(all_of, *zip(*enumerate(draws()), strict=True))
        return [*itertools.chain(*tuned, *pool.map(one_of, others()))]


def table_of(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each kind of burst."""
    table = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        those = [row for row in rows if row["kind"] == kind]
        trusted = [row for row in those if row["trusted"]]
        table.append(
            {
                "frames are": kind,
                "bursts": len(those),
                "trusted": len(trusted),
                "trusted, wrong": sum(row["wrong"] for row in trusted),
                "right, in doubt": sum(not (row["wrong"] or row["trusted"]) for row in those),
                "misfit": f"{np.median([row['misfit'] for row in those]):.2f}",
            }
        )
    return table


def main() -> None:
    """Measure, store and print."""
    rows = measure()
    harness.write("trust", rows)
    table = table_of([row for row in rows if row["kind"] != OTHER])
    trusted = [row for row in rows if row["kind"] == OTHER and row["trusted"]]
    bars = np.abs([row["bars"] for row in trusted])
    text = TEXT.format(
        rows=NUM_ROWS,
        width=WIDTH,
        lights="; ".join(LIGHTS),
        table=harness.table(table, list(table[0])),
        draws=NUM_OTHERS,
        count=bars.size,
        median=f"{PERIOD * np.median(np.abs([row['off'] for row in trusted])):.3f}",
        within=f"{100 * np.mean(bars < 1):.0f}",
        within_two=f"{100 * np.mean(bars < 2):.0f}",
    )
    harness.section("trust", text)


if __name__ == "__main__":
    sys.exit(main())
