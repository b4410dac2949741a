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
from mishutter.decoding.frame_velocity import VelocityEstimate, velocity_of_frames
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
FURTHER = 1
"""Further draws of each photograph, of which the velocity alone is looked at."""
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
on. Of velocities, {draws} are drawn for each row, for both kinds of frames; "within one, two" is
the share of those trusted whose error is within one and two standard errors, by the ellipse of
each: 39 and 86 % where errors are Gaussian.

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
            return -float(ms.exposures_psnr(self.scene, frames(math.exp(power))))

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


class Judged(NamedTuple):
    """A velocity that was found."""

    off: float  # Its error over the frames; px
    error: float  # Its standard error; px
    score: float  # The error in standard errors of its own ellipse
    trusted: bool

    @staticmethod
    def of(found: object, velocity: np.ndarray, camera: Camera) -> "Judged":
        """That of an estimate."""
        if not isinstance(found, VelocityEstimate):
            raise TypeError("the velocity was told")
        error = found.velocity - velocity
        score = math.sqrt(error @ np.linalg.solve(found.covariance, error))
        off = float(np.hypot(*error)) * camera.window
        return Judged(off, found.error * camera.window, score, found.trusted)


class Levels(NamedTuple):
    """Levels of one photograph by one burst, dB."""

    formula: float
    whole: float
    inner: float
    told: float
    told_inner: float


def taken(
    name: str, camera: Camera, frames: ms.PlaneFrames, velocity: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """A photograph and its frames."""
    light = np.asarray(shipped_picture(name).luminance, np.float64)
    key, size = jax.random.key(seed), {"num_rows": SIZE, "num_columns": SIZE}
    captures = ms.simulate_frames(light, camera.scene, frames, speed=velocity, **size, key=key)
    return light, np.asarray(captures)


def levels_of(
    name: str, camera: Camera, frames: ms.PlaneFrames, velocity: np.ndarray, seed: int
) -> tuple[Levels, Judged]:
    """Levels of a photograph, and its velocity."""
    light, captures = taken(name, camera, frames, velocity, seed)
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
    formula = float(ms.exposures_psnr(one, frames))
    levels = Levels(formula, whole, middle, told_whole, told_middle)
    return levels, Judged.of(found.estimate, velocity, camera)


def rows_of(words: str, count: int) -> dict[str, Any]:
    """A row of the table: the means over photographs, with their standard errors."""
    jax.config.update("jax_enable_x64", True)
    camera, random = CAMERAS[words], np.random.default_rng(11 + count)
    bursts = camera.at_rest(count), camera.moving(count)
    pairs, judged = [], []
    for number in range((1 + FURTHER) * len(PHOTOGRAPHS)):
        name, place = PHOTOGRAPHS[number % len(PHOTOGRAPHS)], number % len(PHOTOGRAPHS)
        speed = camera.fastest * math.sqrt((place + random.uniform()) / len(PHOTOGRAPHS))
        angle = random.uniform(0, 2 * np.pi)
        velocity = speed * np.array([math.cos(angle), math.sin(angle)])
        case = camera, velocity, 100 * count + number
        if number < len(PHOTOGRAPHS):
            each = [levels_of(name, camera, burst, *case[1:]) for burst in bursts]
            pairs.append([levels for levels, _ in each])
            own = [one for _, one in each]
        else:
            own = [_judged(name, burst, *case) for burst in bursts]
        print(words, count, name, velocity.round(), *own, sep="\n  ", flush=True)
        judged += own
    still, moving = (np.array([pair[k] for pair in pairs], float) for k in (0, 1))
    gains = dict(zip(Levels._fields, (moving - still).T, strict=True))
    wrong = [one for one in judged if one.off > WRONG]
    scores = np.array([one.score for one in judged if one.trusted])
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
        "off / px": f"{max(one.off for one in judged):.1f}",
        "wrong": f"{len(wrong)} of {len(judged)}",
        "trusted": f"{scores.size} of {len(judged)}",
        "wrong and trusted": str(sum(one.trusted for one in wrong)),
        "within one, two": f"{np.mean(scores < 1):.0%}, {np.mean(scores < 2):.0%}",
        "each": [[one._asdict() for one in pair] for pair in pairs],
        "velocities": [one._asdict() for one in judged],
    }


def _judged(
    name: str, frames: ms.PlaneFrames, camera: Camera, velocity: np.ndarray, seed: int
) -> Judged:
    """The velocity of a photograph."""
    _, captures = taken(name, camera, frames, velocity, seed)
    return Judged.of(velocity_of_frames(captures[None], camera.scene, frames), velocity, camera)


def report(rows: list[dict[str, Any]]) -> None:
    """Store and print."""
    harness.write("plane_photographs", rows)
    columns = [column for column in rows[0] if column not in ("each", "velocities")]
    table = harness.table(rows, columns)
    count, draws = len(PHOTOGRAPHS), (1 + FURTHER) * len(PHOTOGRAPHS)
    text = TEXT.format(count=count, size=SIZE, wrong=WRONG, draws=draws, table=table)
    harness.section("plane_photographs", text)


def main() -> None:
    """Measure, store and print."""
    report([rows_of(*each) for each in itertools.product(CAMERAS, COUNTS)])


if __name__ == "__main__":
    sys.exit(main())
