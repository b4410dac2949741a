"""Do photographs gain from a moving burst what the formula says?

Parts of photographs pass a sensor that is narrower than they are, so that light enters and leaves
at real borders. The best still and the best moving burst of a camera take their frames; the speed
is found in them, and all of them restore one picture.
"""

import sys
from typing import Any

import jax
import numpy as np

import mishutter as ms
from benchmarks import harness
from benchmarks.photographs import PHOTOGRAPHS
from mishutter.evaluation import best_moving_burst, best_still_burst
from mishutter.pictures.images import shipped_picture

TUNED_ON = "motorcycle_left.png"
"""The photograph that showed, while the decoder was written, that it works."""
NUM_ROWS, WIDTH = 32, 256
"""Rows of a photograph that are shown, and columns of the sensor."""
CASES = ((4, 60.0), (2, 60.0), (8, 60.0), (4, 120.0))
"""Numbers of frames and frame rates."""
OFF = 0.5
"""Displacement from frame to frame by which a wrong speed is off, px."""
DECODERS = {"linear": ms.EnsembleDecoder(), "total variation": ms.TotalVariationDecoder()}
TEXT = """## Bursts of photographs

Gain, dB, of the best moving burst over the best still burst of at most so many frames, at 1e5 e-/s
and 8 e-: the formula's mean over nine speeds to 4,500 px/s either way, and that of {count}
photographs, {rows} rows on a sensor of {width} px, each at a speed of its own that is found in the
frames, with its standard error. A speed is wrong where frames are more than half a pixel off.

{table}"""


def camera(count: int, rate: float) -> ms.Scene:
    """The camera of the map, which takes so many frames."""
    return ms.Scene.uniform(
        max_speed=4500.0,
        photon_rate=1e5,
        read_noise=8,
        limits=ms.Limits(max_stroke=110, max_half_exposure=0.08),
        burst=ms.Burst(frames_per_s=rate, max_frames=count, window=count / rate),
        decoder_speed="known",
    )


def shown(seed: int) -> list[tuple[str, np.ndarray, float]]:
    """Photographs that had no part in choosing anything, and the speed of each."""
    random = np.random.default_rng(seed)
    return [
        (name, shipped_picture(name).luminance[first:][:NUM_ROWS], random.uniform(-4500, 4500))
        for name, first in PHOTOGRAPHS.items()
        if name != TUNED_ON
    ]


def restored(
    light: np.ndarray, speed: float, scene: ms.Scene, frames: tuple, key: jax.Array
) -> tuple[dict[str, float], float]:
    """Levels of one burst by each decoder, and the speed that was found."""
    captures = ms.simulate_frames(light, scene, frames, speed=speed, num_columns=WIDTH, key=key)
    start = (light.shape[1] - WIDTH) // 2
    truth = light[:, start : start + WIDTH]
    levels, found = {}, None
    for name, decoder in DECODERS.items():
        result = ms.restore_frames(captures, scene, frames, decoder=decoder, speed=found)
        found = result.estimate.speed if result.estimate else found
        levels[name] = -10 * np.log10(np.mean((np.asarray(result.light) - truth) ** 2))
    return levels, found  # type: ignore[return-value]


def measure(seed: int = 7) -> list[dict[str, Any]]:
    """A row for each number of frames and frame rate."""
    rows = []
    for count, rate in CASES:
        scene = camera(count, rate)
        still, moving = best_still_burst(scene), best_moving_burst(scene)
        if still is None or moving is None:
            raise RuntimeError("the camera takes no burst")
        gains: dict[str, list[float]] = {name: [] for name in DECODERS}
        wrong = {"still": 0, "moving": 0}
        for index, (name, light, speed) in enumerate(shown(seed)):
            key = jax.random.key(100 * index + count)
            levels = {}
            for kind, burst in (("still", still), ("moving", moving)):
                levels[kind], found = restored(light, speed, scene, burst.frames, key)
                wrong[kind] += int(abs(found - speed) > OFF * rate)
                print(count, rate, name, kind, round(speed), round(found, 1), levels[kind])
            for decoder, list_of in gains.items():
                list_of.append(levels["moving"][decoder] - levels["still"][decoder])
        number = len(gains["linear"])
        rows.append(
            {"frames": count, "frames/s": f"{rate:g}", "moving": moving.kind}
            | {"formula": f"{moving.psnr - still.psnr:+.2f}"}
            | {
                name: f"{np.mean(x):+.2f} ± {np.std(x, ddof=1) / number**0.5:.2f}"
                for name, x in gains.items()
            }
            | {f"wrong, {kind}": f"{n} of {number}" for kind, n in wrong.items()}
        )
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows = measure()
    harness.write("bursts_photographs", rows)
    text = TEXT.format(
        count=len(PHOTOGRAPHS) - 1,
        rows=NUM_ROWS,
        width=WIDTH,
        table=harness.table(rows, list(rows[0])),
    )
    harness.section("bursts_photographs", text)


if __name__ == "__main__":
    sys.exit(main())
