"""Do the error bars of a fitted camera hold, and how long does a fit take?

A typical printout stands in `RESULTS.md`. It was made with `OPENBLAS_NUM_THREADS=1`,
without which threads of small factorisations wait for one another on a busy machine.
"""

import os
import sys
import time
from typing import NamedTuple

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from support import laboratory as lab  # noqa: E402

import mishutter as ms  # noqa: E402
from benchmarks import harness  # noqa: E402

TRIALS = 200
COUNT = 9
WHOLE = ms.SensorLevels(read_noise=3.0)
TWELVE = ms.SensorLevels(electrons_per_level=2.0, read_noise=6.0, full_level=4095.0)


class Case(NamedTuple):
    """What is shown, by how many electrons in a fully open exposure, and to which sensor.

    Speeds are told or not. An edge of 12 bits has eight rows, each of which it nearly fills.
    """

    target: str
    electrons: float
    sensor: ms.SensorLevels
    rows: int = 1
    told: bool = True

    @property
    def speeds(self) -> tuple[float, ...]:
        """px/s."""
        return lab.SPEEDS if self.told else (1300.0,) * 3


CASES = {
    "points": Case("point", 1e5, WHOLE),
    "points, 12 bits": Case("point", 6e4, TWELVE),
    "edges": Case("edge", 1e5, WHOLE),
    "edges, 12 bits": Case("edge", 1.2e4, TWELVE, rows=8),
    "points, 12 bits, one unknown speed": Case("point", 6e4, TWELVE, told=False),
}
TEXT = """## A camera fitted to what it recorded

{trials} trials each of rows of pixels: five at -2,500 to 2,700 px/s, or three at 1,300 px/s that is
not told, past a sensor of 31 px stroke, through a lens of 0.62 px, in Poisson and read noise and
whole levels, of one row or of eight for edges of 12 bits. The stage pans at -180 px/s and
accelerates 3.7 % more than was sent, and the shutter lags. Pictures are sums over 20,000 instants,
made without the package's kernel. Share of trials in which the truth lies within two error bars,
which should be 95 % or more; `bias` and `spread` are of the distance in error bars, and should be 0
and 1, or less than 1 where an error bar is that of the farther side; `told` is the share of trials
in which the number has an error bar, and is not named as not identifiable. At an unknown speed the
speed over the sensor takes the place of the velocity, and the truth is the camera or its mirrored
one at the opposite speed, which gives the same pictures.

{each}

{times}

First fit, its programs compiled: {first:.1f} s. Seconds are of the clock, {load}."""


def truth(case: Case) -> dict[str, float]:
    """The numbers of the camera as built, the profile in the light that was sent."""
    a, v = float(lab.BUILT.acceleration), float(lab.BUILT.velocity)
    named = {"acceleration": a, "lens blur": lab.BLUR}
    named |= {"velocity": v, "delay": -v / (2 * a) * 1e3} if case.told else {}
    named |= {} if case.told else {"speed over the sensor": case.speeds[0] - v}
    scale = float(lab.COMMAND.efficiency()) / float(lab.PROFILE.efficiency())
    profile = np.asarray(lab.PROFILE.coefficients) * scale
    return named | {f"transmittance {k}": c for k, c in enumerate(profile)}


def found(camera: ms.FittedCamera) -> dict[str, tuple[float, float]]:
    """The same of a fit, mirrored where the speed that was not told came out below 0."""
    known = camera.estimates
    names = {
        "acceleration": "acceleration_px_per_s2",
        "lens blur": "lens_blur_px",
        "velocity": "velocity_px_per_s",
        "delay": "delay_ms",
    }
    named = {name: (known[key].value, known[key].error) for name, key in names.items()}
    profile = list(zip(camera.coefficients, camera.coefficient_errors, strict=True))
    if "speed_px_per_s" in known:
        speed, error = known["speed_px_per_s"]
        over = speed - float(lab.SENT.velocity)
        named["speed over the sensor"] = abs(over), error
        profile = profile[::-1] if over < 0 else profile
    return named | {f"transmittance {k}": each for k, each in enumerate(profile)}


def trial(lights: list[np.ndarray], case: Case, seed: list[int]) -> dict[str, float]:
    """Distances from the truth in error bars, and seconds on the clock and of the processor."""
    rng = np.random.default_rng(seed)
    options = {"read_noise": case.sensor.read_noise, "per_level": case.sensor.electrons_per_level}
    pictures = [
        ms.TargetPicture(
            np.array(
                [lab.recorded(light, case.electrons, rng, **options) for _ in range(case.rows)]
            ),
            case.target,
            speed if case.told else None,
        )
        for light, speed in zip(lights, case.speeds, strict=True)
    ]
    start = time.perf_counter(), time.process_time()
    camera = ms.fit(pictures, lab.SENT, lab.COMMAND, sensor=case.sensor, num_coefficients=COUNT)
    seconds = time.perf_counter() - start[0], time.process_time() - start[1]
    numbers = found(camera)
    scores = {}
    for name, value in truth(case).items():
        estimate, error = numbers[name]
        scores[name] = float((estimate - value) / error) if np.isfinite(error) else None
    times = dict(zip(("seconds", "processor"), seconds, strict=True))
    return scores | times | {"chi": camera.reduced_chi_squared}


def measure(trials: int) -> list[dict]:
    """A row for each trial."""
    rows = []
    for index, (name, case) in enumerate(CASES.items()):
        lights = [
            lab.expected(speed, case.target, position=35.2 + 3 * k)
            for k, speed in enumerate(case.speeds)
        ]
        for seed in range(trials):
            row = {"case": name, "seed": seed}
            try:
                row |= trial(lights, case, [seed, index])
            except ValueError as error:
                row |= {"refused": str(error)}
            rows.append(row)
            print(name, seed, f"{row.get('seconds', 0):.1f} s", flush=True, file=sys.stderr)
    return rows


def coverage(rows: list[dict]) -> list[dict]:
    """Coverage, bias and spread of each number and case."""
    result = []
    for name, case in CASES.items():
        mine = [row for row in rows if row["case"] == name]
        each = {n: [row.get(n) for row in mine] for n in truth(case)}
        profile = [n for n in each if n.startswith("trans")]
        each["transmittance"] = [score for n in profile for score in each.pop(n)]
        for number, scores in each.items():
            told = np.array([score for score in scores if score is not None])
            result.append(
                {
                    "case": name,
                    "number": number,
                    "within two": f"{np.mean(np.abs(told) < 2):.1%}",
                    "told": f"{told.size / len(scores):.0%}",
                    "bias": f"{np.mean(told):+.2f}",
                    "spread": f"{np.std(told):.2f}",
                }
            )
    return result


def times(rows: list[dict]) -> list[dict]:
    """What a fit of each case takes, and how well its model holds."""
    result = []
    for name in CASES:
        mine = [row for row in rows if row["case"] == name]
        known = [row for row in mine if "seconds" in row]
        seconds = [row["seconds"] for row in known]
        result.append(
            {
                "case": name,
                "median s": float(np.median(seconds)),
                "95 % s": float(np.percentile(seconds, 95)),
                "processor s": float(np.median([row["processor"] for row in known])),
                "chi squared": f"{np.mean([row['chi'] for row in known]):.3f}",
                "refused": str(len(mine) - len(known)),
            }
        )
    return result


def report(rows: list[dict]) -> None:
    """Store and print."""
    harness.write("fit", rows)
    each, clock = coverage(rows), times(rows)
    text = TEXT.format(
        trials=1 + max(row["seed"] for row in rows),
        each=harness.table(each, list(each[0])),
        times=harness.table(clock, list(clock[0])),
        first=rows[0]["seconds"],
        load=f"at a load of {harness.environment()['load']:.1f} on {os.cpu_count()} cores",
    )
    harness.section("fit", text)


def main(trials: int = TRIALS) -> None:
    """Measure, store and print."""
    report(measure(trials))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
