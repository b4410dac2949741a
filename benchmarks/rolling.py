"""Are frames whose rows are exposed one after another restored as well as those of all at once?

Photographs pass a sensor whose stage swings on alternating parabolas along the rows or along the
columns, or circles in the plane. A decoder that knows the rows' times stands beside one that takes
all rows for exposed at once.

What `results/rolling.json` holds already is not done again: remove it to begin anew.
"""

import itertools
import json
import sys
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

import mishutter as ms
from benchmarks import harness
from benchmarks.bursts_photographs import decibels
from benchmarks.plane_photographs import PHOTOGRAPHS
from mishutter.evaluation.fans import SEARCHED
from mishutter.pictures.images import shipped_picture

PERIOD, STROKE, COUNT = 0.02, 54.6, 4
READOUTS = (0.0, 0.005, 0.01, 0.02)
"""From the first row to the last; s."""
WAYS = ("along rows", "along columns", "in the plane")
_CASES = tuple(itertools.product(WAYS, READOUTS))
RATE, READ, FASTEST = 1e5, 8.0, 2800.0
SWIFT = 1500.0
"""Greatest velocity of a photograph; px/s."""
SHAPE = 192, 320
"""Rows and columns of the sensor, or columns and rows where things move along the columns."""
MARGIN = 32
"""Pixels at the ends of what all frames see that are not judged."""
MUCH = 1.0
"""Loss of a picture from which on its estimate should not be trusted; dB."""
TEXT = """## Rows that are read one after another

Four frames of 20 ms of photographs, each at a velocity of its own up to {swift:,.0f} px/s, on
parabolas of 54.6 px along rows or columns, and on a circle in the plane. "dB" is the mean level of
the restored picture, away from its borders, and "short" what it has less than behind a global
shutter beside what the level of its velocity loses, in the mean and at worst; "within" is the
number of velocities that are within two of their errors. "Not told" is of a decoder that takes all
rows for exposed at once: its mean level, how many of its estimates are trusted, and how many of
these though their picture has more than {much:g} dB less than the other's.

{table}

In the plane each row's circle begins at another place: waves of a photograph that one begin hardly
records, others do. So photographs are better or worse by that, though their level is not."""


class Case(NamedTuple):
    """A way of the sensor, and the scene behind it."""

    way: str
    readout: float

    @property
    def scene(self) -> ms.Scene:
        """The scene, whose sensor is a rolling one."""
        axis = "columns" if self.way == "along columns" else "rows"
        light: Any = {"photon_rate": RATE, "read_noise": READ}
        sensor = ms.Sensor(readout=self.readout, axis=axis)
        if self.way == "in the plane":
            return ms.Scene.any_direction(FASTEST, **light, sensor=sensor)
        return ms.Scene(np.linspace(-FASTEST, FASTEST, 9), **light, sensor=sensor)

    @property
    def frames(self) -> Any:
        """The frames."""
        middles = (np.arange(COUNT) - (COUNT - 1) / 2) * PERIOD
        if self.way == "in the plane":
            angle = np.linspace(0, 2 * np.pi * COUNT, 96 * COUNT + 1)
            velocities = 0.75 * FASTEST * np.stack([-np.sin(angle), np.cos(angle)])
            lasting = np.full(angle.size - 1, COUNT * PERIOD / (angle.size - 1))
            return ms.PlaneFrames(middles, np.full(COUNT, PERIOD), lasting, velocities)
        rate, half, every = STROKE / 2 / (PERIOD / 2) ** 2, PERIOD / 2, []
        for k, time in enumerate(middles.tolist()):
            motion = ms.FreeMotion(accelerations=[-rate], half_exposure=half)
            if k % 2 == 0:
                motion = ms.ParabolicMotion(acceleration=rate, half_exposure=half)
            every.append(ms.TimedFrame(motion, time, (k % 2 - 0.5) * STROKE))
        return every


def velocity_of(number: int) -> np.ndarray:
    """The velocity of a photograph; px/s."""
    random = np.random.default_rng(number)
    size, angle = SWIFT * np.sqrt(random.uniform(0.1, 1)), random.uniform(0, 2 * np.pi)
    return size * np.array([np.cos(angle), np.sin(angle)])


def level_of(case: Case, velocity: np.ndarray) -> float:
    """The level of one velocity, dB, which a circle that rows turn may see better or worse.

    Levels of different readouts differ alike on a fine fan of directions.
    """
    light: Any = {"photon_rate": RATE, "read_noise": READ, "sensor": case.scene.sensor}
    if case.way == "in the plane":
        scene = ms.Scene.any_direction(ms.ListedVelocities(velocity[None]), **light)
    else:
        scene = ms.Scene(velocity[:1], **light)
    return float(ms.exposures_psnr(scene, case.frames, grid=SEARCHED))


def measured(case: Case, name: str, number: int) -> dict[str, float]:
    """Levels and velocities of one photograph."""
    light = np.asarray(shipped_picture(name).luminance, np.float64)[:440, :600]
    velocity = velocity_of(number)
    rows, columns = SHAPE
    sensor, speed = {"num_columns": columns}, velocity
    if case.way == "in the plane":
        sensor["num_rows"] = rows
    else:
        speed, light = velocity[0], light[:rows]
    if case.way == "along columns":
        light = light.T
    scene, frames = case.scene, case.frames
    key = jax.random.key(number)
    taken = np.asarray(ms.simulate_frames(light, scene, frames, speed=speed, **sensor, key=key))
    first = [(whole - own) // 2 for whole, own in zip(light.shape, taken.shape[1:], strict=True)]
    truth = light[first[0] :, first[1] :][: taken.shape[1], : taken.shape[2]]
    # What enters or leaves is seen by some of the frames alone.
    ways = np.abs(velocity) * (COUNT - 1) * PERIOD / 2
    across, down = {"in the plane": ways, "along rows": (ways[0], 0)}.get(case.way, (0, ways[0]))
    inner = tuple(slice(edge, -edge) for edge in (MARGIN + int(way) for way in (down, across)))
    row = {"level": level_of(case, velocity)}
    untold = replace(scene, sensor=replace(scene.sensor, readout=None))
    for word, own in (("told", scene), ("untold", untold))[: 2 if case.readout else 1]:
        found = ms.restore_frames(taken, own, frames)
        estimate: Any = found.estimate
        row[word] = decibels(np.mean((np.asarray(found.light) - truth)[inner] ** 2))
        row[f"trusted_{word}"] = float(estimate.trusted)
        own_speed = estimate.velocity if case.way == "in the plane" else estimate.speed
        off = float(np.linalg.norm(np.atleast_1d(own_speed - speed)))
        row[f"within_{word}"] = float(off <= 2 * estimate.error)
    return row


def summary(case: Case, every: list[dict], still: list[dict]) -> dict[str, str]:
    """The row of a table, from those of photographs, and of the same behind a global shutter."""
    told, level = (np.array([each[key] for each in every]) for key in ("told", "level"))
    told_still, level_still = (np.array([x[key] for x in still]) for key in ("told", "level"))
    short = told_still - told - (level_still - level)
    within = sum(each["within_told"] for each in every)
    row = {
        "way": case.way,
        "readout, ms": f"{case.readout * 1e3:.0f}",
        "photographs": f"{len(every)}",
        "dB": f"{told.mean():.2f}",
        "short, dB": f"{short.mean():.2f}, {short.max():.2f}" if case.readout else "-",
        "within": f"{within:.0f}",
        "not told, dB": "-",
        "trusted": "-",
        "though wrong": "-",
    }
    if case.readout:
        untold = np.array([each["untold"] for each in every])
        trusted = np.array([each["trusted_untold"] for each in every]) > 0
        row["not told, dB"] = f"{untold.mean():.2f}"
        row["trusted"] = f"{trusted.sum()}"
        row["though wrong"] = f"{(trusted & (told - untold > MUCH)).sum()}"
    return row


def main(count: str = f"{len(PHOTOGRAPHS)}", *ways: str) -> None:
    """Print the table, once so many photographs are restored of some ways, or of all."""
    jax.config.update("jax_enable_x64", True)
    kept = harness.RESULTS / "rolling.json"
    rows = json.loads(kept.read_text("utf-8"))["rows"] if kept.exists() else []
    done = {(row["way"], row["readout"], row["photograph"]): row for row in rows}
    for case, name in itertools.product(itertools.starmap(Case, _CASES), PHOTOGRAPHS[: int(count)]):
        at = case.way, case.readout, name
        if case.way in (ways or WAYS) and at not in done:
            numbers = measured(case, name, PHOTOGRAPHS.index(name))
            done[at] = dict(zip(("way", "readout", "photograph"), at, strict=True)) | numbers
            print(done[at], flush=True)
            harness.write("rolling", [*done.values()])
    rows = []
    for case in itertools.starmap(Case, _CASES):
        names = [name for name in PHOTOGRAPHS if (*case, name) in done]
        every, still = ([done[case.way, x, n] for n in names] for x in (case.readout, 0.0))
        rows += [summary(case, every, still)] if names else []
    table = harness.table(rows, [*rows[0]])
    harness.section("rolling", TEXT.format(swift=SWIFT, much=MUCH, table=table))


if __name__ == "__main__":
    main(*sys.argv[1:])
