"""Do the error bars of a fitted camera hold, and how long does a fit take?

A typical printout stands in `RESULTS.md`. It was made with `OPENBLAS_NUM_THREADS=1`,
without which threads of small factorisations wait for one another on a busy machine.
"""

import sys
import time

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from support import laboratory as lab  # noqa: E402

import mishutter as ms  # noqa: E402
from benchmarks import harness  # noqa: E402

TRIALS = 200
COUNT = 9
CAMERAS = {
    "whole electrons": (1e5, ms.SensorLevels(read_noise=3.0)),
    "12 bits": (6e4, ms.SensorLevels(electrons_per_level=2.0, read_noise=6.0, full_level=4095.0)),
}
"""Electrons of a target in a fully open exposure, and how a sensor counts them."""
TEXT = """## A camera fitted to what it recorded

{trials} trials each of five rows of pixels: a point light at -2,500 to 2,700 px/s past a sensor
of 31 px stroke, through a lens of 0.62 px, in Poisson and read noise and whole levels. The stage
pans at -180 px/s and accelerates 3.7 % more than was sent, and the shutter lags. Pictures are
sums over 20,000 instants, made without the package's kernel. Share of trials in which the truth
lies within two error bars, which should be 95 %; `bias` and `spread` are of the distance in
error bars, and should be 0 and 1.

{each}

{times}"""


def truth() -> dict[str, float]:
    """The numbers of the camera as built, the profile in the light that was sent."""
    a, v = float(lab.BUILT.acceleration), float(lab.BUILT.velocity)
    named = {"acceleration_px_per_s2": a, "velocity_px_per_s": v, "lens_blur_px": lab.BLUR}
    named["delay_ms"] = -v / (2 * a) * 1e3
    scale = float(lab.COMMAND.efficiency()) / float(lab.PROFILE.efficiency())
    profile = np.asarray(lab.PROFILE.coefficients) * scale
    return named | {f"transmittance {k}": c for k, c in enumerate(profile)}


def trial(lights: list[np.ndarray], camera: str, seed: int) -> dict[str, float]:
    """Distances from the truth in error bars, and seconds on the clock and of the processor."""
    electrons, sensor = CAMERAS[camera]
    rng = np.random.default_rng([seed, len(camera)])
    options = {"read_noise": sensor.read_noise, "per_level": sensor.electrons_per_level}
    pictures = [
        ms.TargetPicture(lab.recorded(light, electrons, rng, **options), "point", speed)
        for light, speed in zip(lights, lab.SPEEDS, strict=True)
    ]
    start = time.perf_counter(), time.process_time()
    found = ms.fit(pictures, lab.SENT, lab.COMMAND, sensor=sensor, num_coefficients=COUNT)
    seconds = time.perf_counter() - start[0], time.process_time() - start[1]
    named = dict(found.estimates)
    profile = zip(found.coefficients, found.coefficient_errors, strict=True)
    named |= {f"transmittance {k}": each for k, each in enumerate(profile)}
    scores = {}
    for name, value in truth().items():
        estimate, error = named[name]
        scores[name] = float((estimate - value) / error)
    times = dict(zip(("seconds", "processor"), seconds, strict=True))
    return scores | times | {"chi": found.reduced_chi_squared}


def measure(trials: int) -> list[dict]:
    """A row for each trial."""
    lights = [
        lab.expected(speed, "point", position=35.2 + 3 * k) for k, speed in enumerate(lab.SPEEDS)
    ]
    rows = []
    for camera in CAMERAS:
        for seed in range(trials):
            rows.append({"camera": camera, "seed": seed, **trial(lights, camera, seed)})
            print(camera, seed, f"{rows[-1]['seconds']:.1f} s", flush=True, file=sys.stderr)
    return rows


def coverage(rows: list[dict]) -> list[dict]:
    """Coverage, bias and spread of each number and camera."""
    result = []
    for camera in CAMERAS:
        mine = [row for row in rows if row["camera"] == camera]
        each = {name: np.array([row[name] for row in mine]) for name in truth()}
        profile = np.concatenate([each.pop(n) for n in list(each) if n.startswith("trans")])
        for name, scores in (each | {"transmittance": profile}).items():
            result.append(
                {
                    "camera": camera,
                    "number": name,
                    "within two": f"{np.mean(np.abs(scores) < 2):.1%}",
                    "bias": f"{np.mean(scores):+.2f}",
                    "spread": f"{np.std(scores):.2f}",
                }
            )
    return result


def main(trials: int = TRIALS) -> None:
    """Measure, store and print."""
    rows = measure(trials)
    harness.write("fit", rows)
    chi = np.mean([row["chi"] for row in rows])
    first, later = rows[0], np.median([row["seconds"] for row in rows])
    times = (
        f"First fit, its programs compiled: {first['seconds']:.1f} s, of which the processor "
        f"worked {first['processor']:.1f} s; later ones: {later:.2f} s in the median. Mean of chi "
        f"squared for each free level: {chi:.3f}."
    )
    each = coverage(rows)
    table = harness.table(each, list(each[0]))
    harness.section("fit", TEXT.format(trials=trials, each=table, times=times))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
