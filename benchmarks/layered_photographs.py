"""Do layered photographs come back as well as the formula of layers expects?

A typical printout stands in `RESULTS.md`.
"""

import sys
from functools import lru_cache
from typing import NamedTuple

import jax
import numpy as np
from scipy import ndimage
from support import layered_rows
from support.layered_rows import Spectra

import mishutter as ms
from benchmarks import harness
from benchmarks.occlusion import CAMERAS, SPEEDS, pairs_of
from benchmarks.photographs import PHOTOGRAPHS
from mishutter.model.images import shipped_picture

NUM_ROWS, COLUMNS = 256, 512
PERIOD = 2 * COLUMNS
PHOTON_RATE, READ_NOISE = 1e5, 8.0
SHARE = 0.4
"""Of a picture that objects cover, about."""
CHOSEN = ("snapshot of 2.16 ms", "Hann, 45 px, 18 ms")
_FINE, _TRIES = 4, 300
"""Points a pixel at which the outline of a matte is decided."""


class Layered(NamedTuple):
    """One period of a layered scene.

    Attributes:
        background: Light; shape `(rows, period)`.
        object: Light, also where the matte is clear; `(rows, period)`.
        matte: Opacity; `(rows, period)`.
        share: Mean of the matte.
        width: Mean length of the runs along rows that objects cover, px.
    """

    background: np.ndarray
    object: np.ndarray
    matte: np.ndarray
    share: float
    width: float


def rows_of(name: str) -> np.ndarray:
    """Rows of a photograph's luminance, mirrored: one period; `(rows, period)`."""
    light = shipped_picture(name).luminance
    first = min(PHOTOGRAPHS[name], light.shape[0] - NUM_ROWS)
    rows = light[first : first + NUM_ROWS, :COLUMNS].astype(float)
    return np.concatenate([rows, rows[:, ::-1]], axis=1)


def ellipse(random: np.random.Generator, width: float) -> np.ndarray:
    """An ellipse whose mean chord is `width`; shape `(rows, columns * _FINE)`."""
    across = width * 4 / np.pi
    height = int(np.clip(across * random.uniform(0.6, 1.2), 8, NUM_ROWS))
    x = (np.arange(round(across * _FINE)) + 0.5) / (across * _FINE) * 2 - 1
    y = (np.arange(height) + 0.5) / height * 2 - 1
    return np.hypot(y[:, None], x[None]) < 1


def bar(random: np.random.Generator, width: float) -> np.ndarray:
    """A bar that leans by up to 45 degrees and is as high as the picture; as an `ellipse`."""
    left = np.arange(NUM_ROWS) * random.uniform(-1, 1)
    x = (np.arange(round((width + np.ptp(left)) * _FINE)) + 0.5) / _FINE + np.min(left)
    return (x >= left[:, None]) & (x < left[:, None] + width)


def horse(random: np.random.Generator, width: float) -> np.ndarray:
    """The silhouette of a horse whose mean run along rows is `width`; as an `ellipse`."""
    return _horse(width)[:, :: random.choice([-1, 1])]


@lru_cache
def _horse(width: float) -> np.ndarray:
    outline = np.pad(shipped_picture("horse.png").luminance < 0.5, 1).astype(float)
    scale = width / mean_run(outline > 0)
    while True:
        zoomed = ndimage.zoom(outline, (scale, scale * _FINE), order=1) > 0.5
        first = max(0, (zoomed.shape[0] - NUM_ROWS) // 2)
        zoomed = zoomed[first : first + NUM_ROWS]
        run = mean_run(zoomed) / _FINE
        if abs(run / width - 1) < 0.02:
            return zoomed
        scale *= (width / run) ** 0.7


SHAPES = {"ellipses": ellipse, "leaning bars": bar, "horses": horse}
WIDTHS = {"ellipses": (30, 100, 300), "leaning bars": (30, 100, 300), "horses": (15, 30, 60)}
"""Mean lengths along rows, px: the largest whole horse has 60."""


def mean_run(inside: np.ndarray) -> float:
    """Mean length of the runs of True along periodic rows."""
    begins = np.sum(inside & ~np.roll(inside, 1, axis=1))
    return float(np.sum(inside) / begins)


def layered(shape: str, width: float, names: tuple[str, str], seed: int) -> Layered:
    """Two photographs, the second seen through objects of a shape at random places apart."""
    random, gap = np.random.default_rng(seed), 2 * _FINE
    inside = np.zeros((NUM_ROWS, PERIOD * _FINE), bool)
    for _ in range(_TRIES):
        one = SHAPES[shape](random, width)
        if (
            one.shape[1] + gap > inside.shape[1]
            or np.mean(inside) + np.sum(one) / 2 / inside.size > SHARE
        ):
            continue
        top = int(random.integers(NUM_ROWS - one.shape[0] + 1))
        left = int(random.integers(inside.shape[1]))
        turned = np.roll(inside[top : top + one.shape[0]], -left, axis=1)
        if not np.any(
            turned[:, : one.shape[1]][ndimage.binary_dilation(one, np.ones((1, 3)), gap)]
        ):
            turned[:, : one.shape[1]] |= one
            inside[top : top + one.shape[0]] = np.roll(turned, left, axis=1)
    matte = inside.reshape(NUM_ROWS, PERIOD, _FINE).mean(2)
    behind, front = map(rows_of, names)
    return Layered(behind, front, matte, float(matte.mean()), mean_run(inside) / _FINE)


def power_of(rows: np.ndarray) -> np.ndarray:
    """Mean power of periodic rows about their mean; shape `(period,)`."""
    return np.mean(np.abs(np.fft.fft(rows - rows.mean())) ** 2, axis=0) / rows.shape[1]


def spectra_of(scene: Layered, *, own_matte: bool = False) -> Spectra:
    """The spectra of two photographs and of a matte of exponential widths, or of the matte itself.

    Every integral over frequencies is a sum over the waves of a period.
    """
    half = PERIOD // 2
    behind, front = power_of(scene.background), power_of(scene.object)
    behind[half] = front[half] = 0.0  # the composite of waves at 0.5 cycles/px is ambiguous
    turns = np.arange(-PERIOD, PERIOD + 1) / PERIOD
    matte = layered_rows.matte_power(turns, scene.share, scene.width)
    if own_matte:
        matte = np.where(
            np.abs(turns) <= 0.5,
            power_of(scene.matte)[np.arange(-PERIOD, PERIOD + 1) % PERIOD],
            0.0,
        )
    k = np.arange(half + 1)
    difference = k[:, None] - np.arange(-PERIOD, PERIOD + 1)
    within = np.abs(difference) < half
    beats = [
        np.where(within, s[difference % PERIOD], 0.0) * matte / PERIOD for s in (behind, front)
    ]
    p, step = scene.share, scene.object.mean() - scene.background.mean()
    own = matte[k + PERIOD] * step**2 + p**2 * front[k] + beats[1].sum(1)
    return Spectra(k / PERIOD, own, (1 - p) ** 2 * behind[k], turns, beats[0])


def placed(scene: Layered, places: tuple[float, float]) -> np.ndarray:
    """The sharp picture, background and object each displaced; `(rows, period)`."""
    turns = np.arange(PERIOD // 2 + 1) / PERIOD

    def finer(rows, place):
        moved = np.fft.rfft(rows) * np.exp(-2j * np.pi * turns * place)
        moved[:, -1] = moved[:, -1].real / 2
        return 2 * np.fft.irfft(moved, 2 * PERIOD)

    behind = finer(scene.background, places[0])
    matte, front = (finer(x, places[1]) for x in (scene.matte, scene.object * scene.matte))
    whole = np.fft.rfft(behind * (1 - matte) + front)[:, : PERIOD // 2 + 1] / 2
    return np.fft.irfft(whole, PERIOD)


def captured(scene: Layered, speeds: tuple[float, float], camera: str, seed: int) -> np.ndarray:
    """The package's capture of the layers, noise and all; `(rows, period)`."""
    tiles = [np.tile(x, 3)[..., None].astype(np.float32) for x in (scene.object, scene.matte)]
    layers = ms.Layers(
        (
            ms.Layer(ms.Picture(scene.background[..., None]), speed=speeds[0]),
            ms.Layer(ms.Picture(tiles[0], tiles[1][..., 0]), speed=speeds[1], left=-PERIOD),
        ),
        border="wrap",
    )
    light = ms.Scene(SPEEDS, photon_rate=PHOTON_RATE, read_noise=READ_NOISE)
    motion, shutter = CAMERAS[camera]
    seen = ms.simulate_capture(layers, light, motion, shutter, key=jax.random.key(seed))
    return np.asarray(seen, float)[..., 0]


def levels(scene: Layered, background: str, camera: str) -> dict:
    """PSNR expected and measured of whole pictures; dB."""
    exposure = layered_rows.camera(*CAMERAS[camera], max(SPEEDS))
    pairs = pairs_of(background)
    mean = (1 - scene.share) * scene.background.mean() + scene.share * scene.object.mean()
    electrons = PHOTON_RATE * exposure.exposure
    noise = exposure.light.sum() * mean / electrons + (READ_NOISE / electrons) ** 2
    known = layered_rows.best_filter(spectra_of(scene), exposure, pairs, noise)
    own = layered_rows.best_filter(spectra_of(scene, own_matte=True), exposure, pairs, noise)
    errors = []
    for seed, speeds in enumerate(pairs):
        light = captured(scene, speeds, camera, seed)
        level = light.mean()
        spectrum = np.fft.rfft(light - level) * known.response
        restored = np.fft.irfft(spectrum, PERIOD) + level / exposure.light.sum()
        truth = placed(scene, tuple(map(exposure.place, speeds)))
        errors.append(np.mean((restored - truth) ** 2))
    dB = lambda x: float(-10 * np.log10(x))
    return {
        "expected": dB(known.error),
        "own matte": dB(own.error),
        "measured": dB(np.mean(errors)),
        "each": np.array(errors),
    }


def scenes() -> list[tuple[str, float, str]]:
    """Shape, width and background: three widths before one at rest, the middle before another."""
    still = [(shape, width, "still") for shape in SHAPES for width in WIDTHS[shape]]
    return still + [(shape, WIDTHS[shape][1], "moving") for shape in SHAPES]


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    names, rows = list(PHOTOGRAPHS), []
    for index, (shape, width, background) in enumerate(scenes()):
        pair = names[index], names[(index + 5) % len(names)]
        scene = layered(shape, width, pair, index)
        for camera in CHOSEN:
            found = levels(scene, background, camera)
            rows.append(
                {
                    "background": pair[0].partition(".")[0],
                    "objects": f"{shape} of {pair[1].partition('.')[0]}",
                    "width px": f"{scene.width:.0f}",
                    "share": f"{scene.share:.2f}",
                    "behind": background,
                    "camera": camera,
                    "expected dB": f"{found['expected']:.2f}",
                    "measured dB": f"{found['measured']:.2f}",
                    "difference": f"{found['measured'] - found['expected']:+.2f}",
                    "with its matte's spectrum": f"{found['own matte']:.2f}",
                }
            )
            print(*rows[-1].values(), file=sys.stderr, flush=True)
    harness.write("layered_photographs", rows)


if __name__ == "__main__":
    main()
