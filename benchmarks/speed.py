"""How well is the speed of a whole picture found, and what does finding it bring?

`python -m benchmarks.speed fit` makes the constants of `estimate_speed` from half of the
photographs and says what each part of the estimator is worth on the other half.
`python -m benchmarks speed` restores the photographs of both halves: the other one had no part in
choosing anything. `python -m benchmarks.speed table SEED CAMERA ...` measures some cameras again
with the noise of one seed, and `python -m benchmarks.speed text` writes the tables again.
Photographs are those that packages bring: `pip install matplotlib pywavelets scikit-learn sporco`.
"""

import importlib.util
import itertools
import json
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from scipy.special import polygamma

import mishutter as ms
from benchmarks import harness
from mishutter.decoding.decoders import speed as estimator
from mishutter.decoding.decoders.base import blur_model
from mishutter.decoding.decoders.speed import Energies, Prior
from mishutter.decoding.decoders.speed_finding import at_speed
from mishutter.model.motion import AbstractMotion
from mishutter.sweeps.trade_offs import best_snapshots

SHIPPED = {
    "skimage/data": (
        "astronaut.png brick.png camera.png cell.png chelsea.png clock_motion.png coffee.png "
        "coins.png grass.png gravel.png hubble_deep_field.jpg ihc.png moon.png "
        "motorcycle_left.png page.png retina.jpg rocket.jpg text.png"
    ),
    "matplotlib/mpl-data/sample_data": "grace_hopper.jpg",
    "sklearn/datasets/images": "china.jpg flower.jpg",
    "pywt/data": "aero.npz ascent.npz",
    "sporco/data": "barbara.png kodim23.png monarch.png sail.png tulips.png",
}
"""Photographs by the folder inside a package."""
ROWS, COLUMNS, MARGIN = 256, 512, 300
"""Frame of a capture, and columns of scene beyond either border."""
UNJUDGED = 64
"""Columns at either border of a restored picture that are not judged."""
SPEEDS = (430.0, -1320.0, 2210.0, -3080.0, 3910.0)
NUM_SEEDS = 2
CROPS = 4
"""Parts of a photograph that the prior is fitted to, at most."""
MISFIT = 0.05
"""Variance that a smooth spectrum is assumed to miss, where it is fitted."""
SHRINKAGE = 0.1
"""Of the correlations of the prior towards none: there are few photographs."""
FITTED_TO = ("open, 25 ms", "open, 30 ms")
PRIOR = Path(estimator.__file__).with_name("speed_prior.json")
WEIGHTS = np.geomspace(0.2, 1.6, 10), np.geomspace(20.0, 320.0, 13)
TRUSTS = (0.9, 0.95, 0.98, 0.99)
FAR = 150.0
"""Distance from the true speed at which an estimate is wrong; px/s."""


def folder_of(package: str) -> Path | None:
    """Where a package is installed, without importing it."""
    found = importlib.util.find_spec(package)
    places = found.submodule_search_locations if found else None
    return Path(places[0]) if places else None


def photographs() -> dict[str, np.ndarray]:
    """Luminance of every photograph by its name, in order of the names."""
    found = {}
    for place, names in SHIPPED.items():
        package, _, inside = place.partition("/")
        folder = folder_of(package)
        if folder is None:
            raise SystemExit(f"benchmarks.speed must find the photographs of {package}.")
        for name in names.split():
            path = folder / inside / name
            if path.suffix == ".npz":
                found[path.stem] = (np.load(path)["data"] / 255.0) ** 2.2
            else:
                found[path.stem] = ms.read_picture(path).luminance.astype(np.float64)
    return dict(sorted(found.items()))


def half(which: str) -> dict[str, np.ndarray]:
    """Every other photograph: those that constants are fitted to, or those of the report."""
    every = list(photographs().items())
    return dict(every[0 if which == "fit" else 1 :: 2])


def middle(light: np.ndarray, count: int, axis: int) -> np.ndarray:
    """So many rows or columns from the middle, mirrored beyond the ends."""
    size = light.shape[axis]
    place = (np.arange(count) - (count - size) // 2) % (2 * size)
    return np.take(light, np.where(place < size, place, 2 * size - 1 - place), axis)


def framed(light: np.ndarray, margin: int = MARGIN) -> np.ndarray:
    """The middle of a photograph with scene beyond the frame; `(ROWS, COLUMNS + 2 margin)`."""
    return middle(middle(light, ROWS, 0), COLUMNS + 2 * margin, 1)


def crops(light: np.ndarray) -> Iterator[np.ndarray]:
    """Frames from the corners of a photograph, as many as it has room for."""
    rows = sorted({0, max(light.shape[0] - ROWS, 0)})[: 1 + (light.shape[0] > 3 * ROWS // 2)]
    columns = sorted({0, max(light.shape[1] - COLUMNS, 0)})
    columns = columns[: 1 + (light.shape[1] > 5 * COLUMNS // 4)]
    for row in rows:
        for column in columns:
            yield framed(light[row : row + ROWS, column : column + COLUMNS], 0)


class Camera(NamedTuple):
    """A motion and a shutter for the built-in scene."""

    motion: AbstractMotion
    shutter: ms.AbstractShutter


def camera(name: str) -> Camera:
    """One of those that are compared."""
    if name.startswith("open"):
        time = float(name.split()[1]) / 2000
        stroke = float(ms.example_scene().limits.max_stroke)
        return Camera(
            ms.ParabolicMotion(acceleration=stroke / time**2, half_exposure=time), ms.RectShutter()
        )
    scene = ms.example_scene()
    if name == "best snapshot":
        best = best_snapshots(scene)
        still = ms.StillCamera(half_exposure=float(best.half_exposure.item()))
        return Camera(still, ms.RectShutter())
    with jax.enable_x64(True):
        design = ms.optimise(ms.example_scene())
    in_single = (jax.tree.map(np.float32, x) for x in (design.motion, design.shutter))
    return Camera(*(jax.tree.map(jax.numpy.asarray, x) for x in in_single))


CAMERAS = ("today's design", "open, 25 ms", "open, 30 ms", "open, 38 ms", "best snapshot")


def captures(
    chosen: dict[str, np.ndarray], seen: Camera, seed: int = 0
) -> Iterator[tuple[str, float, np.ndarray, np.ndarray]]:
    """Name, speed, picture in the frame, and capture, of each photograph at each speed."""
    scene, inside = ms.example_scene(), slice(MARGIN, MARGIN + COLUMNS)
    for name, light in chosen.items():
        picture = framed(light).astype(np.float32)
        for speed in SPEEDS:
            key = jax.random.key(zlib.crc32(f"{name} {speed} {seed}".encode()))
            whole = ms.simulate_capture(picture, scene, *seen, speed=speed, key=key)
            yield name, speed, picture[:, inside], np.asarray(whole)[:, inside]


def fitted_prior(chosen: dict[str, np.ndarray]) -> Prior:
    """Smooth spectra of sharp photographs: mean, covariance, and what they miss."""
    coefficients, misfits = [], []
    for light in chosen.values():
        for frame in crops(light):
            observed, layout = estimator.log_power(frame), estimator.bands(*frame.shape)
            terms, target = layout.terms.astype(np.float64), observed.ravel()
            scatter = np.repeat(polygamma(1, layout.counts), observed.shape[1], axis=1).ravel()
            found, robust, missed = np.zeros(terms.shape[1]), np.ones_like(target), target
            for _ in range(20):
                weight = robust / (scatter + MISFIT)
                normal = (terms.T * weight) @ terms + 1e-2 * np.eye(len(found))
                found = np.linalg.solve(normal, (terms.T * weight) @ target)
                missed = target - terms @ found
                robust = 5 / (4 + missed**2 / (scatter + MISFIT))
            coefficients.append(found)
            misfits.append(np.median(missed**2 / 0.455 - scatter))
    covariance = np.cov(np.array(coefficients).T)
    covariance = (1 - SHRINKAGE) * covariance + SHRINKAGE * np.diag(np.diag(covariance))
    mean, misfit = np.mean(coefficients, axis=0), float(np.median(misfits))
    return Prior(mean, np.linalg.inv(covariance), misfit, 0.4, 100.0, TRUSTS[1], 1.0)


class Trial(NamedTuple):
    """The evidence of one capture, and the truth."""

    photograph: str
    speed: float
    tried: np.ndarray
    reach: float
    parts: list[list[Energies]]


def evidence(chosen: dict[str, np.ndarray], seen: Camera, known: Prior) -> list[Trial]:
    """The evidence of captures of some photographs at all speeds."""
    model = blur_model(ms.example_scene(), *seen)
    tried, reach = estimator.speeds_to_try(model)
    found = []
    for name, speed, _, capture in captures(chosen, seen):
        light, noise = estimator.luminance(capture, model)
        parts = estimator.parts_of(light, model, tried, noise, known)
        found.append(Trial(name, abs(speed), tried, reach, parts))
    return found


class Score(NamedTuple):
    """How good posteriors are: the figures of one row of the table of ablations."""

    log_score: float
    wrong: float
    trusted: float
    wrong_of_trusted: int
    within_one: float
    within_two: float
    denied: float


def score(trials: list[Trial], known: Prior) -> Score:
    """Mean log density of the truth, shares of estimates, and coverage of error bars."""
    found = [estimator.judged(t.parts, t.tried, t.reach, known) for t in trials]
    truth = np.array([t.speed for t in trials])
    steps = np.array([t.tried[1] - t.tried[0] for t in trials])
    density = [
        np.interp(t.speed, t.tried, p.weights) for t, (_, p) in zip(trials, found, strict=True)
    ]
    logs = np.log(np.maximum(density, 1e-9) / steps)
    off = np.abs([e.speed for e, _ in found] - truth)
    errors, sure = np.array([e.error for e, _ in found]), np.array([e.trusted for e, _ in found])
    one, two = (np.mean(off[sure] < n * errors[sure]) if np.any(sure) else np.nan for n in (1, 2))
    denied = np.mean([e.doubt.startswith("Some rows") for e, _ in found])
    wrong = off > FAR
    many = int(np.sum(wrong & sure))
    means = float(logs.mean()), float(wrong.mean()), float(sure.mean())
    return Score(means[0], means[1], means[2], many, float(one), float(two), float(denied))


def width(trials: list[Trial], known: Prior) -> float:
    """Of error bars that hold 68 % of the errors of estimates that are trusted."""
    ratios, known = [], known._replace(width=1.0)
    for trial in trials:
        found, _ = estimator.judged(trial.parts, trial.tried, trial.reach, known)
        if found.trusted:
            ratios.append(abs(found.speed - trial.speed) / found.error)
    return float(np.quantile(ratios, 0.683))


def weighted(trials: list[Trial], known: Prior, phase: bool = True, spectrum: bool = True) -> Prior:
    """The weights at which the truth is likeliest, and the least trust that is never wrong."""
    pairs = [(a, b) for a in WEIGHTS[0] * spectrum for b in WEIGHTS[1] * phase]
    each = [known._replace(spectrum_weight=a, phase_weight=b) for a, b in dict.fromkeys(pairs)]
    best = max(each, key=lambda one: score(trials, one).log_score)
    tried = [best._replace(trust=trust) for trust in TRUSTS]
    best = next((one for one in tried if score(trials, one).wrong_of_trusted == 0), tried[-1])
    return best._replace(width=width(trials, best))


def fit() -> None:
    """Fit the prior and the weights, and store them where the package reads them."""
    chosen = half("fit")
    known = fitted_prior(chosen)
    trials = [t for name in FITTED_TO for t in evidence(chosen, camera(name), known)]
    known = weighted(trials, known)
    numbers = {
        "made_by": "python -m benchmarks.speed fit",
        "photographs": list(chosen),
        "mean": np.round(known.mean, 4).tolist(),
        "covariance": np.round(np.linalg.inv(known.precision), 5).tolist(),
        "misfit": round(known.misfit, 4),
        "spectrum_weight": round(known.spectrum_weight, 4),
        "phase_weight": round(known.phase_weight, 2),
        "trust": known.trust,
        "width": round(known.width, 3),
    }
    PRIOR.write_text(json.dumps(numbers, indent=1) + "\n")
    print("fit", score(trials, known))


PARTS = {
    "all": {},
    "no sparsity": {"phase": False},
    "no spectrum": {"spectrum": False},
    "normal errors for Student's t": {"_FREEDOM": 1e6},
    "no prior of spectra": {"precision": 1e-4},
    "no misfit": {"misfit": 1e-6},
    "no leak of the window": {"_power_through_window": lambda responses, _: np.abs(responses) ** 2},
    "two octaves": {"_OCTAVES": ((0.018, 0.04), (0.04, 0.09))},
    "Hann windows along rows": {"_TAPER": 1.0},
    "bands of rows at all": {"_MOST_BANDS": 1},
    "bands of 64 rows, not of 128": {"_LEAST_ROWS": 128},
}
"""Changes that leave out a part of the estimator, one at a time."""


def ablation(*names: str) -> None:
    """Leave out each part, fit the weights anew, and score the other half of the photographs."""
    before = measured_before()
    parts = {row["left out"]: row for row in before["parts"]}
    for name in names or PARTS:
        parts[name] = {"left out": name, **without(PARTS[name])._asdict()}
    store(before["rows"], [parts[name] for name in PARTS if name in parts])


def without(change: dict) -> "Score":
    """The score of an estimator that is changed."""
    known, kept, seen = estimator.prior(), {}, camera(FITTED_TO[-1])
    for key in change.keys() & set(Prior._fields):
        known = known._replace(**{key: getattr(known, key) * change[key]})
    for key in change.keys() & set(vars(estimator)):
        kept[key] = getattr(estimator, key)
        setattr(estimator, key, change[key])
    both = [evidence(half(which), seen, known) for which in ("fit", "report")]
    for key, value in kept.items():
        setattr(estimator, key, value)
    uses = {key: change[key] for key in ("phase", "spectrum") if key in change}
    return score(both[1], weighted(both[0], known, **uses))


def knowledge(
    model: ms.BlurModel, speed: float, found: ms.SpeedEstimate
) -> dict[str, ms.BlurModel]:
    """What a decoder knows of all speeds, of the one that was found, and of the true one."""
    told = found._replace(speed=speed, trusted=True)
    return {"all speeds": model, "found": at_speed(model, found), "told": at_speed(model, told)}


INNER = {"total variation": ms.TotalVariationDecoder(), "ensemble": ms.EnsembleDecoder()}


HALVES = ("report", "fit")


def restored(name: str, seed: int, which: str) -> list[dict]:
    """Levels of each photograph of a half by one camera and every decoder; dB, linear light."""
    seen, scene, chosen = camera(name), ms.example_scene(), half(which)
    model = blur_model(scene, *seen)
    expected = float(ms.evaluate(scene, *seen).found_speed_psnr)
    errors: dict[tuple[str, str, str], list[float]] = {}
    estimates = []
    inside = np.s_[:, UNJUDGED:-UNJUDGED]
    for photograph, speed, picture, capture in captures(chosen, seen, seed):
        planes = jax.numpy.asarray(capture[None])  # in single precision, as cameras give it
        found = estimator.speed_in(planes, model)
        estimates.append([abs(speed), found.speed, found.error, float(found.trusted)])
        models = knowledge(model, abs(speed), found)
        for inner, knows in itertools.product(INNER, models):
            light = INNER[inner].restore(planes, models[knows])
            light = np.asarray(light, np.float64)[0]
            error = np.mean((light - picture)[inside] ** 2)
            errors.setdefault((inner, knows, photograph), []).append(float(error))
    rows = []
    for inner in INNER:
        for knows in ("all speeds", "found", "told"):
            levels = {
                photograph: float(-10 * np.log10(np.mean(errors[inner, knows, photograph])))
                for photograph in chosen
            }
            row = {"camera": name, "seed": seed, "half": which, "decoder": inner, "speed": knows}
            row |= {"expected": expected, "levels": levels}
            rows.append(row | {"estimates": estimates if knows == "found" else []})
    return rows


TEXT = """## The speed of a whole picture, found in it

PSNR in dB, linear light, mean over {count} photographs that had no part in choosing anything
({rows} x {columns} px, scene beyond the borders, {speeds} speeds, noise of {seeds} seeds), by a
decoder for all speeds of the built-in scene, one that finds the speed, and one that is told it.
"kept" is the share of what telling brings; "worst" is the gain, by finding, on the photograph that
it helps least, in the mean over speeds and noises, and "of one seed" the least with one noise.
"expected" is the level of `FoundSpeedLoss`, for pictures with the spectrum of the built-in scene.
It puts the open shutter of 30 ms first, as total variation does. The ensemble filter keeps more
than the loss assumes, and likes 38 ms better still. Shutters that taper and snapshots keep less,
so that the loss is too kind to them.

{report_levels}

The same of the {count} photographs that the constants were fitted to:

{fit_levels}

The estimates in the first {count}: "wrong" is more than {far:g} px/s off; the error bars are those
of trusted ones, of which {one:.0%} and {two:.0%} would lie within one and two if errors were
normal.

{estimates}"""
PARTS_TEXT = """

Parts of the estimator, each left out with the weights fitted anew to the other half of the
photographs; captures by {camera}. The log score is the mean logarithm of the posterior's density at
the true speed, and "denied" are captures in which a band of rows seems to have another speed, which
none has. The spectrum, its prior, the sparsity, the bands of rows and the window tell; that
Student's t, the misfit or the leak of the window help does not show in so few captures.

{parts}"""


def level_rows(rows: list[dict]) -> list[dict]:
    """The table of levels: a camera and an inner decoder a row."""
    errors: dict[tuple[str, str, str], list[np.ndarray]] = {}
    for row in rows:
        each = 10 ** (-np.array(list(row["levels"].values())) / 10)
        errors.setdefault((row["camera"], row["decoder"], row["speed"]), []).append(each)
    levels = {key: -10 * np.log10(np.mean(each, axis=0)) for key, each in errors.items()}
    expected = {row["camera"]: row["expected"] for row in rows}
    shown = []
    for seen, inner in dict.fromkeys((r["camera"], r["decoder"]) for r in rows):
        untold, found, told = (levels[seen, inner, k] for k in ("all speeds", "found", "told"))
        of_seeds = (np.array(errors[seen, inner, k]) for k in ("all speeds", "found"))
        before, after = (-10 * np.log10(each) for each in of_seeds)
        gain, names = found - untold, list(rows[0]["levels"])
        share = np.mean(gain) / np.mean(told - untold)
        row = {"camera": seen, "decoder": inner, "seeds": len(before)}
        row |= {"all speeds": f"{np.mean(untold):.2f}"}
        row |= {"found": f"{np.mean(found):.2f}", "told": f"{np.mean(told):.2f}"}
        row |= {"kept": f"{share:.0%}", "worst": f"{np.min(gain):+.2f}"}
        row |= {"of": names[int(np.argmin(gain))] if np.ptp(gain) else "-"}
        row |= {"of one seed": f"{np.min(after - before):+.2f}"}
        row |= {"least of all": f"{np.min(found):.2f}"}
        shown.append(row | {"expected": f"{expected[seen]:.2f}"})
    return shown


def estimate_rows(rows: list[dict]) -> list[dict]:
    """The table of estimates: a camera a row."""
    shown = []
    estimates: dict[str, list] = {}
    for row in rows:
        if row["speed"] == "found" and row["decoder"] == next(iter(INNER)):
            estimates.setdefault(row["camera"], []).extend(row["estimates"])
    for name, each in estimates.items():
        truth, found, error, trusted = np.array(each).T
        sure, off = trusted > 0, np.abs(found - truth)
        inside = [
            f"{np.mean(off[sure] < n * error[sure]):.0%}" if np.any(sure) else "-" for n in (1, 2)
        ]
        shown.append(
            {
                "camera": name,
                "captures": len(truth),
                "wrong": f"{np.mean(off > FAR):.0%}",
                "trusted": f"{np.mean(sure):.0%}",
                "wrong of trusted": int(np.sum(sure & (off > FAR))),
                "within one error": inside[0],
                "within two": inside[1],
            }
        )
    return shown


def table(seed: int, names: list[str]) -> None:
    """Measure some cameras with one noise, keep what is known of the others, and print all."""
    before = measured_before()
    rows = before["rows"]
    for name, which in itertools.product(names, HALVES):
        now = name, seed, which
        rows = [r for r in rows if (r["camera"], r["seed"], r["half"]) != now]
        rows += restored(name, seed, which)
        rows.sort(key=lambda r: (HALVES.index(r["half"]), CAMERAS.index(r["camera"]), r["seed"]))
        store(rows, before["parts"])


def measured_before() -> dict:
    """The rows and the parts that are stored."""
    path = harness.RESULTS / "speed.json"
    return json.loads(path.read_text("utf-8")) if path.exists() else {"rows": [], "parts": []}


def store(rows: list[dict], parts: list[dict]) -> None:
    """Write what was measured, and print it."""
    harness.write("speed", rows, parts=parts)
    write_text(rows, parts)


def write_text(rows: list[dict], parts: list[dict]) -> None:
    """Print the tables of what was measured, and keep them."""
    of_half = {which: [row for row in rows if row["half"] == which] for which in HALVES}
    tables = {f"{which}_levels": as_table(level_rows(some)) for which, some in of_half.items()}
    tables |= {"estimates": as_table(estimate_rows(of_half["report"]))}
    numbers = {"count": len(half("report")), "rows": ROWS, "columns": COLUMNS, "far": FAR}
    numbers |= {"speeds": len(SPEEDS), "seeds": NUM_SEEDS, "one": 0.683, "two": 0.954}
    text = TEXT.format(**numbers, **tables)
    if parts:
        named = [{key.replace("_", " "): value for key, value in row.items()} for row in parts]
        text += PARTS_TEXT.format(camera=FITTED_TO[-1], parts=as_table(named))
    harness.section("speed", text)


def as_table(rows: list[dict]) -> str:
    """Rows as Markdown, with all of their columns."""
    return harness.table(rows, list(rows[0])) if rows else ""


def main() -> None:
    """Measure, store and print."""
    for seed in range(NUM_SEEDS):
        table(seed, list(CAMERAS))
    ablation()


if __name__ == "__main__":
    part, given = (sys.argv[1:2] or [""])[0], sys.argv[2:]
    before = measured_before()
    commands = {
        "fit": fit,
        "ablation": lambda: ablation(*given),
        "table": lambda: table(int(given[0]), given[1:]),
        "text": lambda: write_text(before["rows"], before["parts"]),
    }
    commands.get(part, main)()
