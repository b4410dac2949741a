"""Do frames of a sensor that moves gain before a background, restored object by object?

Two ellipses of photographs move along the rows before a third photograph, as in
`benchmarks/strips.py`. Stills of the best orders stand beside two stills and two frames on one
sweep. Told, the decoder knows velocities and outlines; blind it finds both; between the two it is
told the velocities.

What `results/moving_objects.json` holds already is not done again.
"""

import itertools
import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

import mishutter as ms
from benchmarks import harness
from benchmarks.bursts_photographs import decibels
from benchmarks.strips import FASTEST, PERIOD, SIZE, Layered, layered, stills
from mishutter.decoding.decoders.linear import EnsembleDecoder
from mishutter.decoding.objects.arrangement import Arrangement, Thing
from mishutter.decoding.objects.composite import Alone, composite
from mishutter.decoding.objects.light import Misfit, Sight, light_of
from mishutter.decoding.objects.readout import Readout
from mishutter.decoding.objects.restored import knowledge_of, stills_of
from mishutter.decoding.rolling import GLOBAL

LIGHTS = ((1e5, 8.0), (3e4, 2.0))
"""Photo-electrons of white a second, and read noise, e-."""
ORDERS = ((20, 3, 20, 3), (20, 20, 20, 6))
"""Exposures of stills, ms."""
SWEEP = "two of 20 ms at rest, two on one sweep"
WAYS = ("level", "told", "velocities told", "blind")
NUM_SCENES, BORDER, REACH = 8, 24, 1.25
"""Scenes; columns at either end that are not judged; top speed of the sweep over the fastest."""
TEXT = """## Frames that move before a background

Four frames at 50/s of {count} scenes of {size} x {size} px: two ellipses of 44 to 80 px, of
photographs, at 315 to 855 px/s before another photograph. Level of the formula, and PSNR of what
the linear decoder restores, dB; less that of the best stills, with its standard error:

{table}"""


def sweep() -> list[ms.TimedFrame]:
    """Two frames at rest, and two on one parabola that begins where they are."""
    half, rate = PERIOD / 2, REACH * FASTEST / PERIOD
    motions = [ms.StillCamera(half_exposure=half)] * 2
    motions += [
        ms.FreeMotion(accelerations=[rate], half_exposure=half, velocity=side * rate * half)
        for side in (-1.0, 1.0)
    ]
    times, place = PERIOD * (np.arange(4) - 1.5), -1.5 * rate * half**2
    places = (0.0, 0.0, place, place)
    return [ms.TimedFrame(*each) for each in zip(motions, times.tolist(), places, strict=True)]


def kinds() -> dict[str, list[ms.TimedFrame]]:
    """The bursts by their names."""
    named = {f"stills of {', '.join(map(str, order))} ms": stills(order) for order in ORDERS}
    return named | {SWEEP: sweep()}


def told(each: Layered, scene: ms.Scene, taken: np.ndarray, frames: list) -> np.ndarray:
    """The picture by known velocities and outlines."""
    frames_of, _ = stills_of(taken[None], scene, frames, Readout.of(GLOBAL, "rows"))
    known, decoder, things = knowledge_of(scene, frames_of, in_plane=False), EnsembleDecoder(), []
    for layer in each.layers.layers[1:]:
        matte, velocity = np.zeros(taken.shape[1:], np.float32), -layer.velocity[::-1]
        rows, columns = layer.matte.shape
        matte[layer.top : layer.top + rows, layer.left : layer.left + columns] = layer.matte
        things.append(Thing(velocity, matte, velocity, 1.0))
    found = Arrangement(frames_of, things, list(range(len(things)))[::-1])
    misfit = Misfit.of(Sight.of(frames_of, found, known))
    alone = Alone.of(frames_of, known, decoder)
    return composite(found, misfit, light_of(misfit, decoder), alone).light


def measured(seed: int, light: tuple[float, float]) -> list[dict]:
    """Levels told and reached of one scene."""
    (rate, read_noise), rows, inner = light, [], np.s_[:, BORDER:-BORDER]
    each = layered(seed)

    def level(light: np.ndarray) -> float:
        return decibels(np.mean((np.clip(light, 0, 1) - each.truth)[inner] ** 2))

    scene = each.wide(FASTEST, rate, read_noise)
    with tempfile.TemporaryDirectory() as folder:
        own = each.scene(Path(folder))
    own = replace(own, photon_rate=scene.photon_rate, read_noise=scene.read_noise)
    for kind, frames in kinds().items():
        key = jax.random.key(seed)
        taken = np.asarray(ms.simulate_frames(each.layers, scene, frames, key=key))[..., 0]
        row = {"seed": seed, "rate": rate, "read_noise": read_noise, "frames": kind}
        row["level"] = float(ms.exposures_psnr(own, frames))
        row["told"] = level(told(each, scene, taken, frames))
        for way, speed in (("velocities told", each.speeds), ("blind", None)):
            found = ms.restore_frames(taken, scene, frames, speed=speed)
            row[way] = level(np.asarray(found.light))
        row["speeds"] = [one.speed for one in found.objects]
        rows.append(row)
    return rows


def table_of(rows: list[dict]) -> list[dict]:
    """Mean levels of each burst, and what it gains over the stills that are best told."""
    table = []
    for light in LIGHTS:
        mine = [row for row in rows if (row["rate"], row["read_noise"]) == light]
        if not mine:
            continue
        of = {kind: [row for row in mine if row["frames"] == kind] for kind in kinds()}
        for kind, own in of.items():
            head = {"light": f"{light[0]:.0e} e-/s, {light[1]:g} e-", "four frames": kind}
            for way in WAYS:
                every = {k: np.array([row[way] for row in each]) for k, each in of.items()}
                best = max((k for k in every if k != SWEEP), key=lambda k: every[k].mean())
                gain, text = every[kind] - every[best], f"{np.mean(every[kind]):.2f}"
                if kind == SWEEP:
                    error = np.std(gain, ddof=1) / len(own) ** 0.5
                    text += f" ({np.mean(gain):+.2f} +- {error:.2f})"
                head[way] = text
            table.append(head)
    return table


def main(count: int = NUM_SCENES) -> None:
    """Measure, store and print, of as many scenes as are asked for."""
    jax.config.update("jax_enable_x64", True)
    path = harness.RESULTS / "moving_objects.json"
    rows = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.is_file() else []
    done = {(row["seed"], row["rate"], row["read_noise"]) for row in rows}
    for light, seed in itertools.product(LIGHTS, range(count)):
        if (seed, *light) not in done:
            rows += measured(seed, light)
            harness.write("moving_objects", rows)
    table = harness.table(table_of(rows), ["light", "four frames", *WAYS])
    harness.section("moving_objects", TEXT.format(count=count, size=SIZE, table=table))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
