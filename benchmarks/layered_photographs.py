"""Do layered photographs come back as well as is expected of an object before a background?

Twelve photographs, each behind objects that another is seen through: ellipses, leaning bars and
horses of three sizes. An expected error is a mean over scenes, and one composite is one scene: so
each error is a mean over placements, at which both photographs and the objects lie at random
places. They are captured by `simulate_capture` as `Layers` and restored by the one filter that is
best for random objects of that share and width. Rows are mirrored and objects come round, so that
rows are periodic: all of the picture is judged, and nothing is lost at its borders.
"""

import sys
from functools import lru_cache
from itertools import cycle
from typing import NamedTuple

import jax
import numpy as np
from scipy import ndimage

import mishutter as ms
from benchmarks import harness, layered_rows
from benchmarks.layered_rows import Spectra
from benchmarks.occlusion import CAMERAS, SPEEDS, decibels, pairs_of
from benchmarks.photographs import PHOTOGRAPHS, in_steps
from mishutter.pictures.images import shipped_picture

NUM_ROWS, COLUMNS = 256, 512
PERIOD = 2 * COLUMNS
PHOTON_RATE, READ_NOISE = 1e5, 8.0
NUM_PLACEMENTS = 16
"""Composites of two photographs, each at one of the pairs of speeds in turn."""
SHARE = 0.4
"""Of a picture that objects cover, about."""
WITHIN_DB = 0.25
CHOSEN = ("snapshot of 2.16 ms", "Hann, 45 px, 18 ms")
_FINE, _TRIES, _APART = 4, 300, 5
"""Points a pixel at which the outline of a matte is decided."""

TEXT = """## Layered photographs beside what is expected of them

Whole-picture PSNR, linear light, of twelve photographs ({rows} rows of {columns} px, mirrored)
behind ellipses, leaning bars and horses, captured as `Layers` by `simulate_capture` at
{rate:.0e} e-/s and {noise:g} e- and restored by the one filter that is best for random objects of
that share and mean width along rows. Each error is the mean over {placements} placements, at which
both photographs and the objects lie at random places; the standard error is of what differs between
placements at one pair of speeds. `from both spectra` is the formula with the spectrum and the mean
of either photograph; `and the mattes' own` has the spectrum of these mattes in place of that of
objects of random widths.

*Objects that show another photograph.* Measured less expected from both spectra is {others}.
`expected_psnr` has one spectrum for both layers, here the mean of the two by their shares: {one}.
Two photographs that differ are two textures; where their contrasts are far apart, one spectrum for
both is off by as much as a dB.

{others_table}

*Objects that show the same photograph*, from another place, so that one spectrum is that of both.
Measured less `expected_psnr` is {same}. On these spectra `expected_psnr` is within {apart:.2f} dB
of the sums: what is left is no error of the arithmetic.

{same_table}

Bars and horses of one size are no objects of random widths: with the mattes' own spectrum all 48
are {matte}. What is left is what so many placements leave open, most of all where a
picture is dark but for a few bright spots (`hubble_deep_field`).
"""


class Placement(NamedTuple):
    """One period of a background, of what is in front and of its opacity; `(rows, period)` each."""

    background: np.ndarray
    object: np.ndarray
    matte: np.ndarray


class Layered(NamedTuple):
    """One period of a layered scene, at several placements.

    Attributes:
        background: Light; shape `(rows, period)`.
        object: Light, also where the matte is clear; `(rows, period)`.
        mattes: Opacity at each placement; `(n, rows, period)`.
        shifts: Rows and columns by which background and object are turned round; `(n, 2, 2)`.
        share: Mean of the mattes.
        width: Mean length of the runs along rows that objects cover, px.
    """

    background: np.ndarray
    object: np.ndarray
    mattes: np.ndarray
    shifts: np.ndarray
    share: float
    width: float

    def placement(self, index: int) -> Placement:
        """The layers as they lie at one of the placements."""
        behind, front = (
            np.roll(light, shift, axis=(0, 1))
            for light, shift in zip(
                (self.background, self.object), self.shifts[index].tolist(), strict=True
            )
        )
        return Placement(behind, front, self.mattes[index])


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
        zoomed = np.asarray(ndimage.zoom(outline, (scale, scale * _FINE), order=1)) > 0.5
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


def layered(shape: str, width: float, names: tuple[str, str], count: int, seed: int) -> Layered:
    """Two photographs, the second seen through objects, at so many random placements."""
    random = np.random.default_rng(seed)
    inside = np.stack([objects(random, shape, width) for _ in range(count)])
    mattes = inside.reshape(count, NUM_ROWS, PERIOD, _FINE).mean(3)
    run = mean_run(inside.reshape(-1, inside.shape[2])) / _FINE
    shifts = random.integers((NUM_ROWS, PERIOD), size=(count, 2, 2))
    behind, front = map(rows_of, names)
    return Layered(behind, front, mattes, shifts, float(np.mean(mattes)), run)


def objects(random: np.random.Generator, shape: str, width: float) -> np.ndarray:
    """Objects of a shape at random places apart; shape `(rows, period * _FINE)`."""
    gap = 2 * _FINE
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
        near = np.asarray(ndimage.binary_dilation(one, np.ones((1, 3)), gap), bool)
        if not np.any(turned[:, : one.shape[1]] & near):
            turned[:, : one.shape[1]] |= one
            inside[top : top + one.shape[0]] = np.roll(turned, left, axis=1)
    return inside


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
        own = power_of(scene.mattes.reshape(-1, PERIOD))
        matte = np.where(np.abs(turns) <= 0.5, np.concatenate([own, own, own[:1]]), 0.0)
    k = np.arange(half + 1)
    difference = k[:, None] - np.arange(-PERIOD, PERIOD + 1)
    within = np.abs(difference) < half
    beats = [
        np.where(within, s[difference % PERIOD], 0.0) * matte / PERIOD for s in (behind, front)
    ]
    p, step = scene.share, scene.object.mean() - scene.background.mean()
    own = matte[k + PERIOD] * step**2 + p**2 * front[k] + beats[1].sum(1)
    return Spectra(k / PERIOD, own, (1 - p) ** 2 * behind[k], turns, beats[0])


def placed(scene: Placement, places: tuple[float, float]) -> np.ndarray:
    """The sharp picture, background and objects each displaced; `(rows, period)`."""
    turns = np.arange(PERIOD // 2 + 1) / PERIOD

    def finer(rows, place):
        moved = np.fft.rfft(rows) * np.exp(-2j * np.pi * turns * place)
        moved[:, -1] /= 2  # the other half belongs to the negative frequency
        return 2 * np.fft.irfft(moved, 2 * PERIOD)

    behind = finer(scene.background, places[0])
    matte, front = (finer(x, places[1]) for x in (scene.matte, scene.object * scene.matte))
    whole = np.fft.rfft(behind * (1 - matte) + front)[:, : PERIOD // 2 + 1] / 2
    return np.fft.irfft(whole, PERIOD)


def captured(scene: Placement, speeds: tuple[float, float], camera: str, seed: int) -> np.ndarray:
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


def scene_of(layers: Layered, background: str) -> ms.Scene:
    """The scene that the package knows: both layers have the mean of their spectra."""
    p = layers.share
    behind, front = (power_of(x)[: PERIOD // 2 + 1] for x in (layers.background, layers.object))
    power = (1 - p) * behind + p * front
    levels = layers.background.mean(), layers.object.mean()
    variance = (2 * power.sum() - power[0] - power[-1]) / PERIOD
    return ms.Scene(
        SPEEDS,
        photon_rate=PHOTON_RATE,
        read_noise=READ_NOISE,
        picture=ms.Texture(
            mean_level=(1 - p) * levels[0] + p * levels[1],
            deviation=np.sqrt(variance),
            power_spectrum=in_steps(power),
        ),
        occlusion=ms.Occlusion(
            front_share=p,
            object_width=layers.width,
            level_difference=levels[1] - levels[0],
            background=background,  # type: ignore[arg-type]
        ),
    )


def error_of(
    layers: Layered,
    exposure: layered_rows.Camera,
    known: layered_rows.Filter,
    pair: tuple[float, float],
    noise: float,
) -> float:
    """Squared error that a filter is expected to leave at one pair of speeds."""
    spectra = spectra_of(layers)
    power, cross = layered_rows.recorded_spectra(spectra, exposure, [pair])
    left = spectra.wanted - 2 * np.real(known.response * cross)
    left = left + np.abs(known.response) ** 2 * (power + noise)
    return 2 * float(np.trapezoid(left, known.frequency))


def levels(layers: Layered, background: str, camera: str) -> dict:
    """PSNR of whole pictures that is expected and that is measured; dB."""
    motion, shutter = CAMERAS[camera]
    exposure = layered_rows.camera(motion, shutter, max(SPEEDS))
    scene, pairs = scene_of(layers, background), pairs_of(background)
    noise = exposure.noise(PHOTON_RATE, READ_NOISE, float(scene.picture.mean_level))
    known = layered_rows.best_filter(spectra_of(layers), exposure, pairs, noise)
    own = layered_rows.best_filter(spectra_of(layers, own_matte=True), exposure, pairs, noise)
    errors_of_pairs = [error_of(layers, exposure, known, pair, noise) for pair in pairs]
    errors = []
    for seed, speeds in zip(range(len(layers.mattes)), cycle(pairs), strict=False):
        placement = layers.placement(seed)
        light = captured(placement, speeds, camera, seed)
        level = light.mean()
        spectrum = np.fft.rfft(light - level) * known.response
        restored = np.fft.irfft(spectrum, PERIOD) + level / exposure.light.sum()
        truth = placed(placement, (exposure.place(speeds[0]), exposure.place(speeds[1])))
        errors.append(np.mean((restored - truth) ** 2))
    left = [errors_of_pairs[i % len(pairs)] for i in range(len(errors))]
    spread = np.std(np.subtract(errors, left), ddof=1) / np.mean(errors) / np.sqrt(len(errors))
    return {
        "measured dB": f"{decibels(float(np.mean(errors))):.2f}",
        "standard error": f"{10 / np.log(10) * spread:.2f}",
        "`expected_psnr`": f"{float(ms.evaluate(scene, motion, shutter).expected_psnr):.2f}",
        "from both spectra": f"{decibels(known.error):.2f}",
        "and the mattes' own": f"{decibels(own.error):.2f}",
    }


def scenes() -> list[tuple[str, int, str]]:
    """Shape, width and background: three widths before one at rest, the middle before another."""
    still = [(shape, width, "still") for shape in SHAPES for width in WIDTHS[shape]]
    return still + [(shape, WIDTHS[shape][1], "moving") for shape in SHAPES]


def measure(apart: int) -> list[dict]:
    """A row for each photograph and camera; objects show the photograph so far on in the list."""
    names, rows = list(PHOTOGRAPHS), []
    for index, (shape, width, background) in enumerate(scenes()):
        pair = names[index], names[(index + apart) % len(names)]
        layers = layered(shape, width, pair, NUM_PLACEMENTS, index)
        for camera in CHOSEN:
            row = {
                "background": pair[0].partition(".")[0],
                "objects": f"{shape} of {pair[1].partition('.')[0]}" if apart else shape,
                "width px": f"{layers.width:.0f}",
                "share": f"{layers.share:.2f}",
                "behind": background,
                "camera": camera,
            }
            rows.append(row | levels(layers, background, camera))
            print(*rows[-1].values(), sep=" | ", file=sys.stderr, flush=True)
    return rows


def summary(rows: list[dict], expected: str) -> str:
    """One sentence on how far measured levels are from those expected."""
    found = np.array([float(row["measured dB"]) - float(row[expected]) for row in rows])
    within = np.sum(np.abs(found) < WITHIN_DB + 0.005)
    return (
        f"{found.mean():+.2f} dB on average, {np.abs(found).max():.2f} at most, within "
        f"{WITHIN_DB} dB in {within} of {found.size}"
    )


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    same, others = measure(0), measure(_APART)
    harness.write("layered_photographs", same + others)
    harness.section("layered_photographs", text_of(same, others))


def text_of(same: list[dict], others: list[dict]) -> str:
    """The section of the results, by photographs before themselves and before others."""
    return TEXT.format(
        rows=NUM_ROWS,
        columns=COLUMNS,
        placements=NUM_PLACEMENTS,
        rate=PHOTON_RATE,
        noise=READ_NOISE,
        same=summary(same, "`expected_psnr`"),
        apart=max(abs(float(r["`expected_psnr`"]) - float(r["from both spectra"])) for r in same),
        others=summary(others, "from both spectra"),
        one=summary(others, "`expected_psnr`"),
        matte=summary(same + others, "and the mattes' own"),
        same_table=harness.table(same, list(same[0])),
        others_table=harness.table(others, list(others[0])),
    )


if __name__ == "__main__":
    main()
