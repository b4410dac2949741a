"""Do photographs come back as well as the table promises?

Twelve photographs before the camera in five scenes, captured by brute force and restored by
`deconvolve`, beside `expected_psnr` of pictures with their spectrum. The captures know nothing of
the package: the exposure is cut into 40,000 instants, at each of which the rows stand where the
sensor sees them, at a phase to the pixels that is drawn at random. Rows are mirrored and repeat
themselves, so that their spectrum is known exactly and scene lies beyond both ends of what is
judged.
"""

import equinox as eqx
import jax
import numpy as np

import mishutter as ms
from benchmarks import harness
from benchmarks.scenes import scenes
from mishutter.decoding.decoders.base import blur_model
from mishutter.decoding.deconvolution import restored_light
from mishutter.model.motion import AbstractMotion, steady
from mishutter.pictures.images import shipped_picture

PHOTOGRAPHS = {
    "astronaut.png": 100,
    "brick.png": 100,
    "camera.png": 60,
    "coffee.png": 120,
    "grass.png": 100,
    "gravel.png": 100,
    "hubble_deep_field.jpg": 300,
    "ihc.png": 100,
    "moon.png": 100,
    "motorcycle_left.png": 180,
    "retina.jpg": 600,
    "rocket.jpg": 100,
}
"""Every photograph of at least 512 columns inside scikit-image's package, and the first of
the rows that are used."""
COLUMNS, NUM_ROWS, NUM_INSTANTS = 384, 96, 40_000
_STEPS = 512
TEXT = """## Photographs beside the table

PSNR in dB, linear light, of {count} photographs ({rows} rows of {columns} px) that move at every
speed of a scene, captured by time sampling ({instants:,} instants, noise, random phases to the
pixels) and restored by `deconvolve`, less `expected_psnr` of pictures with the spectrum of each.

{table}"""


def rows_of(name: str) -> np.ndarray:
    """Some rows of a photograph's luminance, mirrored: one period; `(rows, 2 * COLUMNS)`."""
    light = shipped_picture(name).luminance[PHOTOGRAPHS[name] :][:NUM_ROWS, :COLUMNS]
    return np.concatenate([light, light[:, ::-1]], axis=1).astype(np.float64)


def scene_of(rows: np.ndarray, scene: ms.Scene) -> ms.Scene:
    """The scene with pictures of the spectrum, the mean and the deviation of periodic rows."""
    spectrum = np.fft.rfft(rows - np.mean(rows))
    numbers = np.mean(rows), np.std(rows), in_steps(np.mean(np.abs(spectrum) ** 2, axis=0))
    leaves = lambda s: (s.picture.mean_level, s.picture.deviation, s.picture.power_spectrum)  # noqa: E731
    values = tuple(jax.device_put(np.asarray(x, scene.speeds.dtype)) for x in numbers)
    return eqx.tree_at(leaves, scene, values, is_leaf=lambda x: x is None)


def in_steps(power: np.ndarray) -> np.ndarray:
    """Power on the grid of a DFT in the equal steps that a scene has, on any scale."""
    period = 2 * (power.size - 1)
    edges = np.concatenate([[0.0], (np.arange(period // 2) + 0.5) / period, [0.5]])
    below = np.concatenate([[0.0], np.cumsum(power * np.diff(edges))])
    return np.diff(np.interp(np.linspace(0, 0.5, _STEPS + 1), edges, below))


def sampled_responses(
    scene: ms.Scene, motion: AbstractMotion, shutter: ms.AbstractShutter, num_instants: int
) -> np.ndarray:
    """Mean of the waves of one period at each instant, through a pixel; `(speeds, k)`, complex."""
    tau = (np.arange(num_instants) + 0.5) / num_instants * 2 - 1
    half, light = float(motion.half_exposure), np.asarray(shutter.transmittance(tau))
    time = tau * half
    a, v = float(steady(motion).acceleration), float(motion.velocity)
    turns = np.arange(COLUMNS + 1) / (2 * COLUMNS)
    found = []
    for speed in np.asarray(scene.speeds, float):
        place = (a * time + v - speed) * time
        if a > 0:
            turn = np.clip((speed - v) / (2 * a), -half, half)
            place -= (a * turn + v - speed) * turn
        waves = [np.mean(light * np.exp(-2j * np.pi * f * place)) for f in turns]
        found.append(np.array(waves) * np.sinc(turns))
    return np.array(found)


def levels(
    rows: np.ndarray,
    scene: ms.Scene,
    motion: AbstractMotion,
    shutter: ms.AbstractShutter,
    responses: np.ndarray,
) -> tuple[float, float]:
    """PSNR that is promised for pictures like this one, and that of `deconvolve`; dB."""
    seen, period = scene_of(rows, scene), rows.shape[1]
    model = blur_model(seen, motion, shutter)
    random, errors = np.random.default_rng(0), []
    electrons = float(scene.photon_rate) * float(motion.exposure)
    turns = np.arange(period // 2 + 1) / period
    for response in responses:
        phase = np.exp(-2j * np.pi * turns * random.uniform(-0.5, 0.5))
        truth = np.fft.irfft(np.fft.rfft(rows) * phase, period)
        light = np.maximum(np.fft.irfft(np.fft.rfft(truth) * response, period), 0)
        three = np.tile(light, 3)
        noise = random.normal(0, float(scene.read_noise), three.shape)
        captured = (random.poisson(three * electrons) + noise) / electrons
        restored = np.asarray(restored_light(captured, ms.EnsembleDecoder(), model))
        errors.append(np.mean((restored[:, period : 2 * period] - truth) ** 2))
    promised = float(ms.evaluate(seen, motion, shutter).expected_psnr)
    return promised, float(-10 * np.log10(np.asarray(scene.weights) @ np.array(errors)))


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows = []
    for name, scene in list(scenes().items())[:5]:
        design = ms.optimise(scene)
        table = ms.compare(scene, design)
        for row in map(table.row, ("optimised", "Hann", "best snapshot")):
            responses = sampled_responses(scene, row.motion, row.shutter, NUM_INSTANTS)
            arguments = scene, row.motion, row.shutter, responses
            found = np.array([levels(rows_of(p), *arguments) for p in PHOTOGRAPHS])
            more = found[:, 1] - found[:, 0]
            rows.append(
                {
                    "scene": name.partition(":")[0],
                    "row": row.name,
                    "electrons at white": f"{float(scene.photon_rate * row.motion.exposure):.0f}",
                    "expected": f"{np.mean(found[:, 0]):.2f}",
                    "restored": f"{np.mean(found[:, 1]):.2f}",
                    "least difference": f"{np.min(more):+.2f}",
                    "largest": f"{np.max(more):+.2f}",
                    "each": found,
                }
            )
            print({k: v for k, v in rows[-1].items() if k != "each"}, flush=True)
    harness.write("photographs", rows)
    shown = harness.table(rows, [column for column in rows[0] if column != "each"])
    numbers = {"count": len(PHOTOGRAPHS), "rows": NUM_ROWS, "columns": COLUMNS}
    harness.section("photographs", TEXT.format(instants=NUM_INSTANTS, table=shown, **numbers))


if __name__ == "__main__":
    main()
