"""Do photographs gain from a moving burst what the formula says?

Photographs pass a sensor of 512 px, so that light enters and leaves at real borders; one that is
narrower than its way goes on mirrored. The best still and the best moving burst of a camera take
their frames, the speed is found in them or known, and all of them restore one picture.
"""

import itertools
import math
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import ArrayLike

import mishutter as ms
from benchmarks import harness
from benchmarks.photographs import PHOTOGRAPHS
from mishutter.camera.responses import aperture_on, waves_of
from mishutter.decoding.decoders.base import blur_model, density_of
from mishutter.decoding.decoders.linear import mean_over_dft
from mishutter.evaluation.bursts import best_still_burst
from mishutter.evaluation.instants import Instants
from mishutter.model.sensor import noise_power, white_electrons
from mishutter.pictures.images import shipped_picture
from mishutter.search.moving_frames import best_moving_burst

TUNED_ON = "motorcycle_left.png"
"""The photograph that showed, while the decoder was written, that it works."""
NUM_ROWS, WIDTH = 32, 512
"""Rows of a photograph that are shown, and columns of the sensor."""
CASES = tuple(itertools.product((2, 4, 8), (60.0, 120.0)))
"""Numbers of frames and frame rates."""
FASTEST, NUM_SPEEDS = 4500.0, 33
"""Greatest speed, px/s, and speeds that the bursts are designed for. Fewer favour a burst that
suits them, and no speed between them."""
OFF = 0.5
"""Displacement from frame to frame by which a wrong speed is off, px."""
MARGIN = 64
"""Pixels beyond the furthest displacement in which a picture may still matter."""
DECODERS = {"linear": ms.EnsembleDecoder(), "total variation": ms.TotalVariationDecoder()}
TEXT = """## Bursts of photographs

Gain, dB, of the best moving burst over the best still burst of at most so many frames, at 1e5 e-/s
and 8 e-: that of {count} photographs, {rows} rows on a sensor of {width} px, each at a speed of its
own up to 4,500 px/s either way, with its standard error; beside it the mean of the formula's gains
at the same speeds, on an endless sensor and on one of {width} px. "Found" is for
the speed that is found in the frames, and "known" for a decoder that knows it. A speed is wrong
where frames are more than half a pixel off.

{table}"""


class Bursts(NamedTuple):
    """The bursts that are compared, and the kind of the moving one."""

    still: Sequence[ms.TimedFrame]
    moving: Sequence[ms.TimedFrame]
    kind: str


class Gains(NamedTuple):
    """Gains of one photograph, dB, and of which bursts the speed is wrong."""

    gains: dict[str, float]
    wrong: dict[str, bool]


def camera(count: int, rate: float) -> ms.Scene:
    """The camera of the map, which takes so many frames."""
    return ms.Scene.uniform(
        max_speed=FASTEST,
        num_speeds=NUM_SPEEDS,
        photon_rate=1e5,
        read_noise=8,
        limits=ms.Limits(max_stroke=110, max_half_exposure=0.08),
        burst=ms.BurstMode(frames_per_s=rate, max_frames=count, window=count / rate),
        decoder_speed="known",
    )


def bursts_of(count: int, rate: float) -> Bursts:
    """The best bursts of a camera."""
    jax.config.update("jax_enable_x64", True)
    still, moving = best_still_burst(camera(count, rate)), best_moving_burst(camera(count, rate))
    if still is None or moving is None:
        raise RuntimeError("the camera takes no burst")
    return Bursts(still.along, moving.along, moving.kind)


def speeds_of(seed: int = 7) -> dict[str, float]:
    """Photographs that had no part in choosing anything, and a speed of each over the range."""
    random = np.random.default_rng(seed)
    names = [name for name in PHOTOGRAPHS if name != TUNED_ON]
    shares = (random.permutation(len(names)) + random.uniform(size=len(names))) / len(names)
    return dict(zip(names, (FASTEST * (2 * shares - 1)).tolist(), strict=True))


def decibels(error: ArrayLike) -> float:
    """Level of a mean squared error, white = 1."""
    return -10 * math.log10(float(error))  # type: ignore[arg-type]


def promised(scene: ms.Scene, frames: tuple, speed: float) -> tuple[float, float]:
    r"""Levels of the formula at one speed, on an endless sensor and on the sensor; dB.

    On the sensor a Gaussian picture has the covariance $(S^{-1} + \sum_k A_k^* M A_k/N_k)^{-1}$,
    of which the pixels on the sensor have the mean variance.
    """
    nodes = Instants.of(frames, abs(speed))
    velocity = np.array([[speed]])
    margin = int(np.ceil(nodes.reach(velocity)[0])) + MARGIN
    length = 2 * (WIDTH // 2 + margin)
    responses = waves_of(nodes, velocity, (length,))[:, 0] * aperture_on(scene.optics, (length,))
    model = blur_model(scene, frames[0].motion, ms.RectShutter())
    power = model.picture_spectrum(length)
    electrons = np.array([float(white_electrons(scene.photon_rate, f.exposure)) for f in frames])
    noises = noise_power(1.0, model.mean_level, electrons, model.read_noise, unit=electrons)
    endless = mean_over_dft(power / (1 + power * density_of(responses, noises)), length)
    place = np.arange(length)
    beside = (place[:, None] - place) % length
    precision = np.fft.irfft(1 / power, length)[beside]
    window = slice(margin, margin + WIDTH)
    for response, noise in zip(responses, noises, strict=True):
        rows = np.fft.irfft(response, length)[beside[window]]
        precision += rows.T @ rows / noise
    seen = np.diag(np.linalg.inv(precision))[window]
    return decibels(endless), decibels(np.mean(seen))


def levels_of(
    light: np.ndarray, speed: float, scene: ms.Scene, frames: tuple, key: jax.Array
) -> tuple[dict[str, float], float]:
    """Levels of one burst, dB, and the speed that was found."""
    captures = ms.simulate_frames(light, scene, frames, speed=speed, num_columns=WIDTH, key=key)
    start = (light.shape[1] - WIDTH) // 2
    truth = light[:, start : start + WIDTH]
    estimate = ms.restore_frames(captures, scene, frames).estimate
    if estimate is None:
        raise RuntimeError("the speed was given")
    endless, on_sensor = promised(scene, frames, speed)
    levels = {"formula": endless, f"on {WIDTH} px": on_sensor}
    for (name, decoder), (word, value) in itertools.product(
        DECODERS.items(), (("known", speed), ("found", estimate.speed))
    ):
        result = ms.restore_frames(captures, scene, frames, decoder=decoder, speed=value)
        error = np.mean((np.asarray(result.light) - truth) ** 2)
        levels[f"{name}, {word}"] = decibels(error)
    return levels, estimate.speed


def gains_of(count: int, rate: float, bursts: Bursts, name: str, speed: float) -> Gains:
    """Gains of one photograph."""
    jax.config.update("jax_enable_x64", True)
    scene = camera(count, rate)
    light = shipped_picture(name).luminance[PHOTOGRAPHS[name] :][:NUM_ROWS]
    key = jax.random.key(100 * list(PHOTOGRAPHS).index(name) + count)
    levels, wrong = {}, {}
    for kind in ("still", "moving"):
        levels[kind], found = levels_of(light, speed, scene, getattr(bursts, kind), key)
        wrong[kind] = abs(found - speed) > OFF * rate
        rounded = {word: round(level, 2) for word, level in levels[kind].items()}
        print(count, rate, name, kind, round(speed, 1), round(found, 1), rounded, flush=True)
    gains = {word: levels["moving"][word] - levels["still"][word] for word in levels["moving"]}
    return Gains(gains, wrong)


def row_of(count: int, rate: float, kind: str, each: list[Gains]) -> dict[str, Any]:
    """A row of the table: the means over photographs, with their standard errors."""
    row: dict[str, Any] = {"frames": count, "frames/s": f"{rate:g}", "moving": kind}
    for word in each[0].gains:
        gains = [one.gains[word] for one in each]
        row[word] = f"{np.mean(gains):+.2f}"
        if "," in word:
            row[word] += f" ± {np.std(gains, ddof=1) / len(gains) ** 0.5:.2f}"
    for burst in ("still", "moving"):
        row[f"wrong, {burst}"] = f"{sum(one.wrong[burst] for one in each)} of {len(each)}"
    return row | {"each": [one.gains for one in each]}


def measure() -> list[dict[str, Any]]:
    """A row for each number of frames and frame rate."""
    shown = speeds_of().items()
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        bursts = list(pool.map(bursts_of, *zip(*CASES, strict=True)))
        each = [
            [pool.submit(gains_of, *case, some, *photograph) for photograph in shown]
            for case, some in zip(CASES, bursts, strict=True)
        ]
        return [
            row_of(*case, some.kind, [one.result() for one in gains])
            for case, some, gains in zip(CASES, bursts, each, strict=True)
        ]


def main() -> None:
    """Measure, store and print."""
    rows = measure()
    harness.write("bursts_photographs", rows)
    text = TEXT.format(
        count=len(PHOTOGRAPHS) - 1,
        rows=NUM_ROWS,
        width=WIDTH,
        table=harness.table(rows, [column for column in rows[0] if column != "each"]),
    )
    harness.section("bursts_photographs", text)


if __name__ == "__main__":
    sys.exit(main())
