"""Are frames whose rows are exposed one after another restored as well as those of all at once?

Photographs pass a sensor whose stage swings on alternating parabolas along the rows or along the
columns, or circles in the plane. A decoder that knows the rows' times stands beside one that takes
all rows for exposed at once.
"""

import sys
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

import mishutter as ms
from benchmarks import harness
from benchmarks.bursts_photographs import decibels
from benchmarks.plane_photographs import PHOTOGRAPHS
from mishutter.pictures.images import shipped_picture

PERIOD, STROKE, COUNT = 0.02, 54.6, 4
READOUTS = (0.0, 0.005, 0.01, 0.02)
"""From the first row to the last; s."""
WAYS = ("along rows", "along columns", "in the plane")
RATE, READ, FASTEST = 1e5, 8.0, 2800.0
SHAPE = 192, 320
"""Rows and columns of the sensor, or columns and rows where things move along the columns."""
MARGIN = 32
"""Pixels at the ends of the sensor that are not judged."""
TEXT = """## Rows that are read one after another

Four frames of 20 ms of {count} photographs, each at a speed of its own up to 2,800 px/s, on
parabolas of 54.6 px along rows or columns, and on a circle in the plane. "dB" is the mean level of
the restored picture, away from its borders; "not told" is of a decoder that takes all rows for
exposed at once. "Within" is the share of velocities that are within two of their errors, and
"trusted" that of the estimates of the decoder that is not told.

{table}"""


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


def measured(case: Case, name: str, number: int) -> dict[str, float]:
    """Levels and velocities of one photograph."""
    light = np.asarray(shipped_picture(name).luminance, np.float64)[:440, :600]
    random = np.random.default_rng(number)
    size, angle = FASTEST * np.sqrt(random.uniform(0.1, 1)), random.uniform(0, 2 * np.pi)
    velocity = size * np.array([np.cos(angle), np.sin(angle)])
    rows, columns = SHAPE
    sensor = {"num_columns": columns}
    if case.way == "in the plane":
        sensor["num_rows"] = rows
        speed: Any = velocity
    else:
        speed, light = float(velocity[0]), light[:rows]
    if case.way == "along columns":
        light = light.T
    scene, frames = case.scene, case.frames
    key = jax.random.key(number)
    taken = np.asarray(ms.simulate_frames(light, scene, frames, speed=speed, **sensor, key=key))
    first = [(whole - own) // 2 for whole, own in zip(light.shape, taken.shape[1:], strict=True)]
    truth = light[first[0] :, first[1] :][: taken.shape[1], : taken.shape[2]]
    inner = tuple(slice(MARGIN, -MARGIN) for _ in range(2))
    row = {}
    untold = replace(scene, sensor=replace(scene.sensor, readout=None))
    for word, own in (("told", scene), ("untold", untold)):
        found = ms.restore_frames(taken, own, frames)
        estimate: Any = found.estimate
        row[word] = decibels(np.mean((np.asarray(found.light) - truth)[inner] ** 2))
        row[f"trusted_{word}"] = float(estimate.trusted)
        own_speed = estimate.velocity if case.way == "in the plane" else estimate.speed
        off = float(np.linalg.norm(np.atleast_1d(own_speed - speed)))
        row[f"within_{word}"] = float(off <= 2 * estimate.error)
    return row


def main() -> None:
    """Print the table, of as many photographs as are asked for."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else len(PHOTOGRAPHS)
    jax.config.update("jax_enable_x64", True)
    rows = []
    for way in WAYS:
        for readout in READOUTS:
            case = Case(way, readout)
            every = [measured(case, name, k) for k, name in enumerate(PHOTOGRAPHS[:count])]
            mean = {key: float(np.mean([each[key] for each in every])) for key in every[0]}
            row = {
                "way": way,
                "readout, ms": f"{readout * 1e3:.0f}",
                "dB": f"{mean['told']:.2f}",
                "within": f"{mean['within_told']:.0%}",
                "not told, dB": f"{mean['untold']:.2f}",
                "trusted": f"{mean['trusted_untold']:.0%}",
            }
            print(row, flush=True)
            rows.append(row)
    harness.write("rolling", rows)
    text = TEXT.format(count=count, table=harness.table(rows, [*rows[0]]))
    harness.section("rolling", text)


if __name__ == "__main__":
    main()
