"""Do the error bars of a fitted camera hold, is a wrong fit flagged, and how long does one take?

A typical printout stands in `RESULTS.md`. It was made with `OPENBLAS_NUM_THREADS=1`,
without which threads of small factorisations wait for one another on a busy machine.
"""

import os
import sys
import time
import warnings
from typing import NamedTuple

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from support import laboratory as lab  # noqa: E402

import mishutter as ms  # noqa: E402
from benchmarks import harness  # noqa: E402

TRIALS = 30
COLUMNS = 128
FASTEST = max(lab.SPEEDS)
WHOLE = ms.SensorLevels(read_noise=3.0)
TWELVE = ms.SensorLevels(electrons_per_level=2.0, read_noise=6.0, full_level=4095.0)
HANN = ms.HannShutter()
KNOWN = "all of known speeds"


class Case(NamedTuple):
    """What is shown, by how many electrons in a fully open exposure, and to which sensor.

    An edge of 12 bits has eight rows, each of which it nearly fills. Of a Hann profile, speeds and
    electrons are drawn too, and what is made of it may be steep.
    """

    target: str
    electrons: tuple[float, float]
    sensor: ms.SensorLevels
    rows: int = 1
    told: bool = True
    sent: ms.AbstractShutter = lab.COMMAND
    num_coefficients: int = 9
    is_steep: bool = False

    @property
    def kind(self) -> str:
        """The case's row in the table of coverage."""
        return f"{self.target}s" if self.told else f"{self.target}s, one unknown speed"


CASES = {
    "points": Case("point", (1e5, 1e5), WHOLE),
    "points, 12 bits": Case("point", (6e4, 6e4), TWELVE),
    "points, Hann": Case("point", (2e4, 5e5), WHOLE, sent=HANN, num_coefficients=12),
    "edges": Case("edge", (1e5, 1e5), WHOLE),
    "edges, 12 bits": Case("edge", (1.2e4, 1.2e4), TWELVE, rows=8),
    "edges, Hann": Case("edge", (2e4, 5e5), WHOLE, sent=HANN, num_coefficients=12),
    "points, Hann, steep": Case(
        "point", (2e4, 5e5), WHOLE, sent=HANN, num_coefficients=12, is_steep=True
    ),
    "edges, Hann, steep": Case(
        "edge", (2e4, 5e5), WHOLE, sent=HANN, num_coefficients=12, is_steep=True
    ),
    "points, one unknown speed": Case("point", (6e4, 6e4), TWELVE, told=False),
}
TEXT = """## A camera fitted to what it recorded

{fits} fits, {trials} of each case, each of a camera and noise of its own: the acceleration is up to
7 % off what was sent, the stage pans at up to 8 % of its top speed, the lens has 0.4 to 1 px, and
the profile is up to 1.3 times as far from what was sent as that of a lagging shutter, or, where a
Hann profile was sent, between 0.02 and 0.08 at its ends and as much below 1 in the middle. A steep
one is far from the Hann profile that was sent: it rises fast and decays, ramps, opens half-way,
leaks beside its window, lags by a third to four fifths of the half exposure, or is held at random,
or is one of these mirrored; the acceleration is then up to 12 % off, and the pan is up to 5 %.
Shown are rows of pixels: five at -2,500 to 2,700 px/s, four of drawn speeds where a Hann profile
was sent or three at 1,300 px/s that is not told, past a sensor of 30 px stroke as sent. Noise is
Poisson's, of reading, and of whole levels; 60,000 or 100,000 electrons fill an open exposure, 2e4
to 5e5 where a Hann profile was sent, 12,000 in each of eight rows of edges of 12 bits. Pictures are
sums over 20,000 instants, made without the package's kernel.

Share of fits in which the truth lies within two error bars, which should be 95 % or more; `bias`
and `spread` are of the distance in error bars, and should be 0 and 1, or less than 1 where an error
bar is that of the farther side; `told` is the share of fits in which the number has an error bar,
and is not named as not identifiable. At an unknown speed the speed over the sensor takes the place
of the velocity, and the truth is the camera or its mirrored one at the opposite speed, which gives
the same pictures.

{each}

{beyond} of the fits have a number beyond five error bars, {unflagged} of which are not flagged as
implausible; {flagged} of the others are flagged.

{times}

First fit, its programs compiled: {first:.1f} s. Seconds are of the clock, {load}."""


class Camera(NamedTuple):
    """A camera as built."""

    motion: ms.ParabolicMotion
    profile: ms.SplineShutter
    lens_blur: float
    electrons: float
    speeds: tuple[float, ...]


def drawn(case: Case, rng: np.random.Generator) -> Camera:
    """A camera, and what it is shown."""
    a, T = float(lab.SENT.acceleration), float(lab.SENT.half_exposure)
    farthest, fastest = (0.12, 0.05) if case.is_steep else (0.07, 0.08)
    motion = ms.ParabolicMotion(
        acceleration=a * rng.uniform(1 - farthest, 1 + farthest),
        half_exposure=T,
        velocity=2 * a * T * rng.uniform(-fastest, fastest),
    )
    sent = np.asarray(ms.SplineShutter.fit(case.sent, case.num_coefficients).coefficients)
    if case.sent is HANN:
        leak = rng.uniform(0.02, 0.08)
        profile = leak + (1 - 2 * leak) * sent
        if case.is_steep:
            profile = rng.choice([s.coefficients for s in lab.steep_profiles(rng).values()])
        speeds = FASTEST, *rng.uniform(-FASTEST, FASTEST, 3)
    else:
        profile = sent + rng.uniform(0, 1.3) * (np.asarray(lab.PROFILE.coefficients) - sent)
        speeds = lab.SPEEDS if case.told else (1300.0,) * 3
    low, high = np.log(case.electrons)
    electrons = float(np.exp(rng.uniform(low, high)))
    return Camera(motion, ms.SplineShutter(profile), rng.uniform(0.4, 1.0), electrons, speeds)


def pictures(case: Case, camera: Camera, rng: np.random.Generator) -> list[ms.TargetPicture]:
    """What the camera records, at places of its own."""
    sensor, motion = case.sensor, camera.motion
    options = {"read_noise": sensor.read_noise, "per_level": sensor.electrons_per_level}
    shown = []
    for speed in map(float, camera.speeds):
        place = lab.centred(speed, motion=motion, columns=COLUMNS) + rng.uniform(-0.5, 0.5)
        light = lab.expected(
            speed,
            case.target,
            position=place,
            columns=COLUMNS,
            blur=camera.lens_blur,
            motion=motion,
            shutter=camera.profile,
        )
        rows = [lab.recorded(light, camera.electrons, rng, **options) for _ in range(case.rows)]
        told = speed if case.told else None
        shown.append(ms.TargetPicture(np.array(rows), case.target, told))
    return shown


def truth(case: Case, camera: Camera) -> dict[str, float]:
    """The numbers of the camera as built, the profile in the light that was sent."""
    a, v = float(camera.motion.acceleration), float(camera.motion.velocity)
    named = {"acceleration": a, "lens blur": camera.lens_blur}
    named |= {"velocity": v, "delay": -v / (2 * a) * 1e3} if case.told else {}
    named |= {} if case.told else {"speed over the sensor": abs(camera.speeds[0] - v)}
    sent = ms.SplineShutter.fit(case.sent, case.num_coefficients)
    scale = float(sent.efficiency()) / float(camera.profile.efficiency())
    profile = np.asarray(camera.profile.coefficients) * scale
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


def trial(case: Case, seed: list[int]) -> dict:
    """Distances from the truth in error bars, and seconds on the clock and of the processor."""
    rng = np.random.default_rng(seed)
    camera = drawn(case, rng)
    shown = pictures(case, camera, rng)
    start = time.perf_counter(), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fitted = ms.fit(
            shown, lab.SENT, case.sent, sensor=case.sensor, num_coefficients=case.num_coefficients
        )
    seconds = time.perf_counter() - start[0], time.process_time() - start[1]
    numbers = found(fitted)
    scores = {}
    for name, value in truth(case, camera).items():
        estimate, error = numbers[name]
        scores[name] = float((estimate - value) / error) if np.isfinite(error) else None
    times = dict(zip(("seconds", "processor"), seconds, strict=True))
    doubt = {"chi": fitted.reduced_chi_squared, "flagged": fitted.doubt is not None}
    return {"scores": scores} | times | doubt


def measure(trials: int) -> list[dict]:
    """A row for each fit."""
    rows = []
    for index, (name, case) in enumerate(CASES.items()):
        for seed in range(trials):
            row = {"case": name, "seed": seed}
            try:
                row |= trial(case, [seed, index])
            except ValueError as error:
                row |= {"refused": str(error)}
            rows.append(row)
            said = {n: value for n, value in row.items() if n != "scores"}
            print(said | {"farthest": _farthest(row)}, flush=True, file=sys.stderr)
    return rows


def _farthest(row: dict) -> float:
    """The greatest distance of a number from the truth in error bars."""
    told = (abs(score) for score in row.get("scores", {}).values() if score is not None)
    return max(told, default=0.0)


def coverage(rows: list[dict]) -> list[dict]:
    """Coverage, bias and spread of each number: of points, of edges, and of both together."""
    gathered: dict[tuple[str, str], list] = {}
    known = [row for row in rows if CASES[row["case"]].told]
    kinds = [*((CASES[row["case"]].kind, row) for row in rows), *((KNOWN, row) for row in known)]
    for kind, row in kinds:
        for number, score in row.get("scores", {}).items():
            name = "transmittance" if number.startswith("trans") else number
            gathered.setdefault((kind, name), []).append(score)
    result = []
    for (kind, number), scores in gathered.items():
        told = np.array([score for score in scores if score is not None])
        result.append(
            {
                "shown": kind,
                "number": number,
                "within two": f"{np.mean(np.abs(told) < 2):.1%}",
                "beyond five": str(int(np.sum(np.abs(told) > 5))),
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
                "flagged": str(sum(row["flagged"] for row in known)),
                "refused": str(len(mine) - len(known)),
            }
        )
    return result


def report(rows: list[dict]) -> None:
    """Store and print."""
    harness.write("fit", rows)
    each, clock = coverage(rows), times(rows)
    known = [row for row in rows if "scores" in row]
    far = [row for row in known if _farthest(row) > 5]
    text = TEXT.format(
        fits=len(rows),
        trials=1 + max(row["seed"] for row in rows),
        each=harness.table(each, list(each[0])),
        beyond=len(far),
        unflagged=sum(not row["flagged"] for row in far),
        flagged=sum(row["flagged"] for row in known if row not in far),
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
