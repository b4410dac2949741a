"""Do photographs that move in any direction gain what the formula says, and is the velocity right?

Photographs pass a sensor of 256 px, so that light enters and leaves at all four borders. Equal
frames at rest of the best exposure, and as many on two sines, one an axis, find the velocity and
restore one picture.
"""

import itertools
import math
import sys
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.optimize import minimize_scalar

import mishutter as ms
from benchmarks import harness
from benchmarks.bursts_photographs import decibels
from mishutter.decoding.plane_velocity import VelocityEstimate
from mishutter.pictures.images import shipped_picture

PHOTOGRAPHS = (
    "astronaut.png",
    "camera.png",
    "coffee.png",
    "gravel.png",
    "hubble_deep_field.jpg",
    "ihc.png",
    "moon.png",
    "rocket.jpg",
)
"""Photographs of at least 400 rows and columns."""
SIZE = 256
"""Rows and columns of the sensor."""
COUNTS = (2, 4, 8)
"""Numbers of frames."""
WRONG = 5.0
"""Displacement over the frames by which a wrong velocity is off, px."""
TURNS, SPEED, DRIFT, PIECES = 2.0, 0.72, 0.35, 512
"""Turns of two sines over the frames, their velocity over the greatest one, the turns by which
their phase runs, and pieces of their path."""
TEXT = """## Photographs in any direction

Gain, dB, of frames on two sines over as many frames at rest of the best exposure: that of
{count} photographs on a sensor of {size} x {size} px, each at a velocity of its own in the disc,
with its standard error, over the whole sensor and over its inner half; beside it the mean of the
formula's gains at the same velocities. "Told" is for a decoder that is told the velocity. "Off" is
the worst error of the velocity, as a displacement over the frames; it is wrong from {wrong:g} px
on.

{table}"""


class Camera(NamedTuple):
    """A scene by its numbers."""

    rate: float  # e-/s
    fastest: float  # px/s
    read: float  # e-
    window: float  # s

    @property
    def scene(self) -> ms.Scene:
        """The scene, whose velocities fill a disc."""
        return ms.Scene.any_direction(self.fastest, photon_rate=self.rate, read_noise=self.read)

    def moving(self, count: int) -> ms.PlaneFrames:
        """Frames one after the other without a gap on two sines."""
        time = np.linspace(-self.window / 2, self.window / 2, PIECES + 1)
        top = SPEED * self.fastest
        slow, fast = (np.pi * (2 * TURNS + sign * DRIFT) / self.window for sign in (-1, 1))
        velocities = top * np.stack([-np.sin(slow * time), np.cos(fast * time)])
        exposures = np.full(count, self.window / count)
        pieces = np.full(PIECES, self.window / PIECES)
        return ms.PlaneFrames(self.times(count), exposures, pieces, velocities)

    def at_rest(self, count: int) -> ms.PlaneFrames:
        """Frames at rest of the best exposure."""

        def frames(share: float) -> ms.PlaneFrames:
            exposures = np.full(count, self.window / count * share)
            return ms.PlaneFrames(
                self.times(count), exposures, np.full(1, self.window), np.zeros((2, 2))
            )

        def loss(power: float) -> float:
            return -float(ms.plane_psnr(self.scene, frames(math.exp(power))))

        best: Any = minimize_scalar(loss, bounds=(-5, 0), method="bounded", options={"xatol": 0.02})
        return frames(math.exp(best.x))

    def times(self, count: int) -> np.ndarray:
        """Mid-exposures; s."""
        return (np.arange(count) - (count - 1) / 2) * self.window / count


CAMERAS = {
    "3e4 e-/s, 10 e-, 2,800 px/s": Camera(3e4, 2800.0, 10.0, 0.08),
    "3e3 e-/s, 1.5 e-, 300 px/s": Camera(3e3, 300.0, 1.5, 0.5),
}
"""A bright scene of fast things, and a dim one of slow things."""


class Levels(NamedTuple):
    """Levels of one photograph by one burst, dB, and the estimate of its velocity."""

    formula: float
    whole: float
    inner: float
    told: float
    told_inner: float
    off: float  # Error of the velocity over the frames; px
    error: float  # Its standard error; px
    trusted: bool


def levels_of(
    name: str, camera: Camera, frames: ms.PlaneFrames, velocity: np.ndarray, seed: int
) -> Levels:
    """Levels of a photograph."""
    light = np.asarray(shipped_picture(name).luminance, np.float64)
    key = jax.random.key(seed)
    captures = ms.simulate_frames(
        light, camera.scene, frames, speed=velocity, num_rows=SIZE, num_columns=SIZE, key=key
    )
    top, left = ((count - SIZE) // 2 for count in light.shape)
    truth = light[top : top + SIZE, left : left + SIZE]
    inner = slice(SIZE // 4, -SIZE // 4)
    law = ms.ListedVelocities([velocity.tolist()])
    one = ms.Scene.any_direction(law, photon_rate=camera.rate, read_noise=camera.read)
    found = ms.restore_frames(captures, camera.scene, frames)
    told = ms.restore_frames(captures, camera.scene, frames, speed=velocity)
    squares = [(np.asarray(each.light) - truth) ** 2 for each in (found, told)]
    whole, told_whole = (decibels(np.mean(each)) for each in squares)
    middle, told_middle = (decibels(np.mean(each[inner, inner])) for each in squares)
    estimate = found.estimate
    if not isinstance(estimate, VelocityEstimate):
        raise TypeError("the velocity was told")
    off = float(np.hypot(*(estimate.velocity - velocity))) * camera.window
    return Levels(
        float(ms.plane_psnr(one, frames)),
        whole,
        middle,
        told_whole,
        told_middle,
        off,
        estimate.error * camera.window,
        estimate.trusted,
    )


def rows_of(words: str, count: int) -> dict[str, Any]:
    """A row of the table: the means over photographs, with their standard errors."""
    jax.config.update("jax_enable_x64", True)
    camera, random = CAMERAS[words], np.random.default_rng(11 + count)
    bursts = camera.at_rest(count), camera.moving(count)
    pairs = []
    for number, name in enumerate(PHOTOGRAPHS):
        speed = camera.fastest * math.sqrt((number + random.uniform()) / len(PHOTOGRAPHS))
        angle = random.uniform(0, 2 * np.pi)
        velocity = speed * np.array([math.cos(angle), math.sin(angle)])
        pair = [levels_of(name, camera, each, velocity, 100 * count + number) for each in bursts]
        print(words, count, name, velocity.round(), *pair, sep="\n  ", flush=True)
        pairs.append(pair)
    still, moving = (np.array([pair[k] for pair in pairs], float) for k in (0, 1))
    gains = dict(zip(Levels._fields[:5], (moving - still).T, strict=False))
    estimates = [one for pair in pairs for one in pair]
    wrong = [one for one in estimates if one.off > WRONG]
    row: dict[str, Any] = {
        "scene": words,
        "frames": count,
        "formula": f"{np.mean(gains['formula']):+.2f}",
    }
    for title, field in (
        ("whole", "whole"),
        ("inner", "inner"),
        ("whole, told", "told"),
        ("inner, told", "told_inner"),
    ):
        each = gains[field]
        row[title] = f"{np.mean(each):+.2f} ± {np.std(each, ddof=1) / math.sqrt(each.size):.2f}"
    return row | {
        "off / px": f"{max(one.off for one in estimates):.1f}",
        "wrong": f"{len(wrong)} of {len(estimates)}",
        "trusted": f"{sum(one.trusted for one in estimates)} of {len(estimates)}",
        "wrong and trusted": str(sum(one.trusted for one in wrong)),
        "each": [[one._asdict() for one in pair] for pair in pairs],
    }


def report(rows: list[dict[str, Any]]) -> None:
    """Store and print."""
    harness.write("plane_photographs", rows)
    columns = [column for column in rows[0] if column != "each"]
    table = harness.table(rows, columns)
    text = TEXT.format(count=len(PHOTOGRAPHS), size=SIZE, wrong=WRONG, table=table)
    harness.section("plane_photographs", text)


def main() -> None:
    """Measure, store and print."""
    report([rows_of(*each) for each in itertools.product(CAMERAS, COUNTS)])


if __name__ == "__main__":
    sys.exit(main())
