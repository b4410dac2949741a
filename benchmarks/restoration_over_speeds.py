"""How good is each decoder at each speed, beside scikit-image at its best number of steps?

Photographs of scikit-image captured by the designs of two scenes, with the picture's own
spectrum. scikit-image's Richardson-Lucy gets the still object's kernel and as many steps as
are best for each capture, which only the truth can tell: no decoder of the package is told.
"""

import jax
import numpy as np
from skimage.restoration import richardson_lucy

import mishutter as ms
from benchmarks import harness
from benchmarks.photographs import PHOTOGRAPHS
from benchmarks.scenes import scenes
from mishutter.decoding.decoders.base import BlurModel, blur_model
from mishutter.pictures.images import shipped_picture

SCENES = {"built-in": 0, "night": 1, "daylight": 2, "slow": 4}
SHOWN = ("built-in", "daylight")
PORTRAIT = "astronaut.png"
ROWS, COLUMNS, MARGIN = 256, 700, 90
STEPS = (1, 2, 3, 5, 7, 10, 14, 20, 30, 45, 70)
MIRRORED = 100
"""Columns that scikit-image's rows are continued by at either end."""
DECODERS = {
    "ensemble": ms.EnsembleDecoder(),
    "Wiener": ms.WienerDecoder(),
    "total variation": ms.TotalVariationDecoder(),
    "Richardson-Lucy": ms.RichardsonLucyDecoder(),
}
TEXT = """## Decoders at each speed

PSNR in linear light, dB, {margin} columns at either end left out, of {rows} rows of a photograph
captured by the scene's design and restored without knowing the speed. scikit-image's
Richardson-Lucy gets the kernel of the still object, mirrored borders and the number of steps that
is best for each capture, which only the truth can tell.

{table}

Over twelve photographs and all of these speeds, in the mean; in the last columns the worst
photograph, and at how many of the captures a decoder is more than 0.1 dB below scikit-image:

{gains}

The same at each speed that all photographs have: PSNR above scikit-image's, dB, in the mean over
them, and of the worst in brackets:

{means}"""


def level(truth: np.ndarray, found: np.ndarray) -> float:
    """PSNR between the borders, linear light, not a number where the picture is none; dB."""
    error = (found - truth)[:, MARGIN:-MARGIN]
    return float(-10 * np.log10(np.mean(error**2)))


def by_scikit_image(captured: np.ndarray, truth: np.ndarray, model: BlurModel) -> float:
    """PSNR of scikit-image's Richardson-Lucy after as many steps as are best; dB."""
    kernel = np.maximum(ms.centred_kernel(model.motion, model.shutter), 0)
    beyond = ((0, 0), (MIRRORED, MIRRORED))
    light = np.maximum(np.pad(captured / model.efficiency, beyond, mode="reflect"), 1e-6)
    light, kernel = light.astype(np.float32), (kernel / kernel.sum()).astype(np.float32)
    found = (richardson_lucy(light, kernel, num_iter=n, clip=False) for n in STEPS)
    return max(level(truth, picture[:, MIRRORED:-MIRRORED]) for picture in found)


def measured(scene: ms.Scene, design: ms.Design, name: str) -> list[dict]:
    """A row for each speed: PSNR of each decoder."""
    first = PHOTOGRAPHS[name]
    light = shipped_picture(name).luminance[first : first + ROWS, :COLUMNS].astype(np.float64)
    known = ms.Scene(
        scene.speeds,
        scene.weights,
        photon_rate=scene.photon_rate,
        read_noise=scene.read_noise,
        limits=scene.limits,
        device=scene.device,
        picture=ms.Texture.of_photograph(ms.Picture(light[..., None])),
    )
    camera = design.motion, design.command
    model, rows = blur_model(known, *camera), []
    speeds = [float(speed) for speed in scene.speeds if speed >= 0]
    for speed in speeds if name == PORTRAIT else (speeds[0], speeds[-1]):
        captured = ms.simulate_capture(light, known, *camera, speed=speed, key=jax.random.key(3))
        row: dict = {"photograph": name, "speed": f"{speed:.0f}"}
        for decoder, method in DECODERS.items():
            row[decoder] = level(light, np.asarray(method.restore(captured, model)))
        row["scikit-image"] = by_scikit_image(np.asarray(captured), light, model)
        rows.append(row)
    return rows


def gain(scene: str, decoder: str, rows: list[dict]) -> dict:
    """How a decoder stands to the ensemble filter and to scikit-image over captures of a scene."""
    over = np.array([row[decoder] - row["ensemble"] for row in rows])
    above = np.array([row[decoder] - row["scikit-image"] for row in rows])
    names = np.array([row["photograph"] for row in rows])
    each, each_above = (
        [np.mean(values[names == name]) for name in PHOTOGRAPHS] for values in (over, above)
    )
    return {
        "scene": scene,
        "decoder": decoder,
        "over ensemble": f"{np.mean(each):+.2f}",
        "worst": f"{min(each):+.2f}",
        "over scikit-image": f"{np.mean(each_above):+.2f}",
        "worst ": f"{min(each_above):+.2f}",
        "below": f"{np.sum(above < -0.1)} of {above.size}",
    }


def means(scene: str, rows: list[dict]) -> list[dict]:
    """How decoders stand to scikit-image over photographs, at each speed that all of them have."""
    speeds = [row["speed"] for row in rows if row["photograph"] != PORTRAIT]
    found = []
    for speed in dict.fromkeys(speeds):
        row = {"scene": scene, "speed": speed}
        for decoder in DECODERS:
            above = [r[decoder] - r["scikit-image"] for r in rows if r["speed"] == speed]
            row[decoder] = f"{np.mean(above):+.2f} ({min(above):+.2f})"
        found.append(row)
    return found


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    given, rows, gains, at_speeds = list(scenes().values()), [], [], []
    for scene, index in SCENES.items():
        design = ms.optimise(given[index])
        found = [row for name in PHOTOGRAPHS for row in measured(given[index], design, name)]
        rows += [{"scene": scene, **row} for row in found]
        gains += [gain(scene, decoder, found) for decoder in DECODERS]
        at_speeds += means(scene, found)
        print(harness.table(gains[-len(DECODERS) :], list(gains[0])), flush=True)
    harness.write("restoration_over_speeds", rows)
    columns = ["scene", "speed", *DECODERS, "scikit-image"]
    shown = [
        {k: f"{v:.2f}" if isinstance(v, float) else v for k, v in row.items()}
        for row in rows
        if row["photograph"] == PORTRAIT and row["scene"] in SHOWN
    ]
    table, summary = harness.table(shown, columns), harness.table(gains, list(gains[0]))
    each = harness.table(at_speeds, list(at_speeds[0]))
    text = TEXT.format(margin=MARGIN, rows=ROWS, table=table, gains=summary, means=each)
    harness.section("restoration_over_speeds", text)


if __name__ == "__main__":
    main()
