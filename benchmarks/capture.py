"""Layers that hide one another against composites at many instants: which time buys which error?

A typical printout stands in `RESULTS.md`.
"""

from time import perf_counter

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from support.time_sampling import captured_layers  # noqa: E402

import mishutter as ms  # noqa: E402
from benchmarks import harness  # noqa: E402

HALF_EXPOSURE, STROKE = 0.01, 30.0
NUM_INSTANTS = (64, 128, 256)
SHUTTERS = {"rect": ms.RectShutter(), "Hann": ms.HannShutter()}
TEXT = """## Captures of layered scenes: against composites at many instants

Colour, float64, {rows} x {columns} px, stroke {stroke:g} px. The reference composites the scene at
Gauss-Legendre nodes of the exposure, on finer columns. `crossing`: an object enters, another leaves
at twice its speed and crosses it, both before a moving street. `alone`: one moving picture, no
occlusion. Difference: the largest, white = 1.

{table}"""


def crossing() -> ms.Layers:
    """A street, a soft object that enters, and a faster one that crosses it and leaves."""
    light = ms.example_picture().light.astype(np.float64)
    back, ball, block = light[100:228, 100:420], light[200:280, 300:420], light[300:360, 400:460]
    y, x = np.mgrid[:80, :120]
    soft = np.clip(40.5 - np.hypot(y - 40, x - 60), 0, 1)
    top = float(camera().top_speed)
    return ms.Layers(
        (
            ms.Layer(ms.Picture(back), 0.1 * top),
            ms.Layer(ms.Picture(ball, soft), 0.3 * top, left=-40, top=10),
            ms.Layer(ms.Picture(block), -0.6 * top, left=10, top=40),
        )
    )


def camera() -> ms.ParabolicMotion:
    """The moving sensor."""
    return ms.ParabolicMotion(acceleration=STROKE / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)


def measure() -> list[dict]:
    """A row for each scene, shutter and number of instants."""
    motion, scene = camera(), ms.Scene([0.0], photon_rate=1e6, read_noise=1.0)
    layered = crossing()
    scenes = {"crossing": layered, "alone": ms.Layers(layered.layers[:1])}
    rows = []
    for name, layers in scenes.items():
        for window, shutter in SHUTTERS.items():
            found = harness.timed(ms.simulate_capture, layers, scene, motion, shutter)
            for num_instants in NUM_INSTANTS:
                begin = perf_counter()
                summed = captured_layers(layers, motion, shutter, count=num_instants)
                took = perf_counter() - begin
                rows.append(
                    {
                        "scene": name,
                        "shutter": window,
                        "instants": num_instants,
                        "difference": float(np.max(np.abs(summed - found["value"]))),
                        "composites s": took,
                        "capture s": found["best_s"],
                        "times as fast": took / found["best_s"],
                        "samples_s": found["samples_s"],
                    }
                )
    return rows


def main() -> None:
    """Measure, store and print."""
    rows = measure()
    harness.write("capture", rows)
    names = [
        "scene",
        "shutter",
        "instants",
        "difference",
        "composites s",
        "capture s",
        "times as fast",
    ]
    height, width, _ = crossing().shape
    table = harness.table(rows, names)
    harness.section("capture", TEXT.format(rows=height, columns=width, stroke=STROKE, table=table))


if __name__ == "__main__":
    main()
