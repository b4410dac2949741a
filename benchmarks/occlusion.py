"""Is the expected error of objects before a background what random rows leave, and how is it had?

Random rows are exposed instant by instant and restored (`benchmarks/layered_rows.py`), 24 times
in other worlds by other cameras; beside them stands what each way of computing the expectation
says, and how long it takes. A typical printout stands in `RESULTS.md`.
"""

import sys
from time import perf_counter

import jax
import numpy as np
from scipy.stats import chi2

import mishutter as ms
from benchmarks import harness, layered_rows
from mishutter.model.motion import AbstractMotion

SPEEDS = (-3375.0, -1125.0, 1125.0, 3375.0)
"""px/s: of objects, and of backgrounds that move."""
SHARES, WIDTHS = (0.3, 0.5, 0.7), (30.0, 100.0, 300.0)
PHOTON_RATES, READ_NOISE = (1e4, 1e5, 1e6), 8.0
ROWS = {"snapshot of 2.16 ms": 144}
"""Rows of each configuration where more than 48 cost little."""
MIDDLES = (np.arange(256) + 0.5) / 512
DOUBTFUL, AGAIN, AGAIN_SEED = 3.0, 5, 1000
"""Standard errors beyond which so many times as many other rows are looked at, from a seed."""
HATS = {"17 effective speeds to twice the fastest": (17, 2), "65 to four times": (65, 4)}
"""How many effective speeds, evenly spaced up to so many times the fastest."""
TEXT = """## Where one thing hides another

Objects before a background, as `Occlusion` has them, against {count} configurations of random rows:
{per_configuration} rows or more of {period:,} px each, textures of the default spectrum, objects
of exponential widths with edges anywhere, composited exactly at each of up to {instants} instants
of the exposure and restored by the one best filter. Speeds are {speeds} px/s, of the objects and of
a background that moves; read noise is {noise:g} e-. `expected` is `evaluate`'s.

Measured less expected is {mean:+.3f} dB on average and {largest:.2f} at most; the squares of the
differences in standard errors add up to {squares:.1f} of {count}, which chance exceeds {chance:.0%}
of the time: {verdict}.{again}

{table}

Ways to compute it, on the same configurations; the error is that against sums over everything
(instants, frequencies of the picture, frequencies of the matte), whose own is below 0.0001 dB. The
rows of effective speeds, and the sums, are NumPy's on one processor; the weights of the speeds
belong to a scene and are not in their time. `evaluate` gives all its figures in that time, and
computes the weights anew. It takes 129 to 513 effective speeds, the more the further objects travel
in the exposure. They lie densely between the speeds of the layers and ever more sparsely up to 512
half ranges of these, where the beats at the lowest frequency are. Evenly spaced effective speeds
are cheap and wrong in bright light: they reach neither the fastest beats, of narrow objects, nor
lie densely enough for long exposures.

{forms}
"""


def parabola(stroke: float, half_exposure: float) -> ms.ParabolicMotion:
    """The motion of a stroke, px, over a half exposure, s."""
    return ms.ParabolicMotion(acceleration=stroke / half_exposure**2, half_exposure=half_exposure)


CAMERAS: dict[str, tuple[AbstractMotion, ms.AbstractShutter]] = {
    "snapshot of 2.16 ms": (ms.StillCamera(half_exposure=1.08e-3), ms.RectShutter()),
    "Hann, 45 px, 18 ms": (parabola(45.0, 9e-3), ms.HannShutter()),
    "open, 30 px, 18 ms": (parabola(30.0, 9e-3), ms.RectShutter()),
    "triangle, 33 px, 10 ms": (parabola(33.0, 5e-3), ms.TriangleShutter()),
}


def pairs_of(background: str) -> list[tuple[float, float]]:
    """Equally likely speeds of background and object, px/s."""
    return [(b, f) for b in (SPEEDS if background == "moving" else (0.0,)) for f in SPEEDS]


def configurations() -> list[dict]:
    """Six for each camera: every share before either background, widths and lights in turn."""
    return [
        {
            "camera": name,
            "background": background,
            "share": SHARES[i],
            "width px": WIDTHS[(i + shift + moving) % 3],
            "e-/s": PHOTON_RATES[(i + 2 * shift) % 3],
        }
        for shift, name in enumerate(CAMERAS)
        for moving, background in enumerate(("still", "moving"))
        for i in range(3)
    ]


def scene_of(configuration: dict, *, layered: bool = True) -> ms.Scene:
    """The scene of a configuration, or of pictures that move as a whole at the same speeds."""
    occlusion = ms.Occlusion(
        front_share=configuration["share"],
        object_width=configuration["width px"],
        background=configuration["background"],
    )
    return ms.Scene(
        SPEEDS,
        photon_rate=configuration["e-/s"],
        read_noise=READ_NOISE,
        occlusion=occlusion if layered else None,
    )


def decibels(error: float) -> float:
    """PSNR of a squared error; dB."""
    return float(-10 * np.log10(error))


def by_effective_speeds(
    spectra: layered_rows.Spectra,
    camera: layered_rows.Camera,
    pairs: list[tuple[float, float]],
    noise: float,
    rule: tuple[int, int],
) -> tuple[float, float]:
    """Expected error by transfer functions between which the beat's speeds lie, and its seconds.

    At 0 cycles/px no speed is that of a beat, so frequencies are the middles of equal steps.
    """
    count, times = rule
    nodes = np.linspace(-1, 1, count) * times * max(SPEEDS)
    f, g = spectra.frequency, spectra.matte_frequency
    shift = np.array([camera.place(speed) for speed in nodes])
    layers = sorted({speed for pair in pairs for speed in pair})
    ends = {speed: camera.place(speed) for speed in layers}
    weights, phased = np.zeros((2, f.size, count), complex)
    rows = np.arange(f.size)[:, None]
    own = {speed: np.zeros(f.size) for speed in layers}
    for behind, front in pairs:
        speed = behind + g / f[:, None] * (front - behind)
        place = np.clip((speed - nodes[0]) / (nodes[1] - nodes[0]), 0, count - 1)
        first = np.minimum(place.astype(int), count - 2)
        upper = place - first
        wanted = (f[:, None] - g) * ends[behind] + g * ends[front]
        for index, share in ((first, 1 - upper), (first + 1, upper)):
            mass = spectra.beat * share / len(pairs)
            turned = mass * np.exp(2j * np.pi * (wanted - f[:, None] * shift[index]))
            np.add.at(weights, (rows, index), mass)
            np.add.at(phased, (rows, index), turned)
        own[behind] += spectra.background / len(pairs)
        own[front] += spectra.object / len(pairs)
    start = perf_counter()
    aligned = np.stack([camera.path - s * camera.time for s in [*nodes, *layers]])
    aligned -= np.array([*shift, *ends.values()])[:, None]
    responses = np.exp(-2j * np.pi * np.multiply.outer(f, aligned)) @ camera.light
    every = np.concatenate([np.real(weights), np.stack(list(own.values()), axis=1)], axis=1)
    turned = np.concatenate([phased, np.stack(list(own.values()), axis=1)], axis=1)
    power = np.sum(every * np.abs(responses) ** 2, axis=1) * np.sinc(f) ** 2
    cross = np.sum(turned * responses, axis=1) * np.sinc(f)
    left = spectra.wanted - np.abs(cross) ** 2 / (power + noise)
    return float(np.mean(left)), perf_counter() - start


def measure(configuration: dict, seed: int) -> dict:
    """A configuration: what is expected, what its rows leave, and the figures of each form."""
    name, background = configuration["camera"], configuration["background"]
    motion, shutter = CAMERAS[name]
    camera, pairs = layered_rows.camera(motion, shutter, max(SPEEDS)), pairs_of(background)
    noise = camera.noise(configuration["e-/s"], READ_NOISE)
    share, width = configuration["share"], configuration["width px"]
    spectra = layered_rows.random_spectra(share, width)
    start = perf_counter()
    known = layered_rows.best_filter(spectra, camera, pairs, noise)
    forms = {"sums over everything": (decibels(known.error), perf_counter() - start)}
    middles = layered_rows.random_spectra(share, width, MIDDLES)
    for form, rule in HATS.items():
        error, seconds = by_effective_speeds(middles, camera, pairs, noise, rule)
        forms[form] = decibels(error), seconds
    for form, layered in {"`evaluate`": True, "`evaluate`, no layers": False}.items():
        scene = scene_of(configuration, layered=layered)
        done = harness.timed(lambda: ms.evaluate(scene, motion, shutter).expected_psnr)  # noqa: B023
        forms[form] = float(done["value"]), done["best_s"]
    expected, count = forms["`evaluate`"][0], ROWS.get(name, 48) // len(pairs)

    def compared(rows: int, seed: int) -> dict:
        random = np.random.default_rng(seed)
        found = layered_rows.measure(random, camera, pairs, share, width, noise, rows, known=known)
        more, error = found.psnr - expected, found.standard_error
        figures = {"measured dB": found.psnr, "difference": more, "standard error": error}
        return figures | {"in standard errors": more / error}

    first = compared(count, seed)
    far = abs(first["in standard errors"]) > DOUBTFUL
    again = compared(AGAIN * count, seed + AGAIN_SEED) if far else None
    return configuration | {"expected dB": expected} | first | {"again": again, "forms": forms}


def shown(row: dict) -> dict:
    """A row of the table."""
    return {
        "camera": row["camera"],
        "background": row["background"],
        "share": f"{row['share']:g}",
        "width px": f"{row['width px']:g}",
        "e-/s": f"{row['e-/s']:.0e}",
        "expected dB": f"{row['expected dB']:.3f}",
        "measured dB": f"{row['measured dB']:.3f}",
        "difference": f"{row['difference']:+.3f}",
        "standard error": f"{row['standard error']:.3f}",
        "in standard errors": f"{row['in standard errors']:+.1f}",
    }


def forms_of(rows: list[dict]) -> list[dict]:
    """A row for each way to compute the expected error."""
    result = []
    for form in rows[0]["forms"]:
        levels = np.array([row["forms"][form][0] for row in rows])
        exact = np.array([row["forms"]["sums over everything"][0] for row in rows])
        seconds = np.array([row["forms"][form][1] for row in rows])
        still = np.array([row["background"] == "still" for row in rows])
        errors = np.abs(levels - exact)
        layered = form != "`evaluate`, no layers"
        result.append(
            {
                "form": form,
                "error at most, dB": f"{np.max(errors):.4f}" if layered else "-",
                "on average, dB": f"{np.mean(errors):.4f}" if layered else "-",
                "still background, ms": f"{1e3 * np.median(seconds[still]):.3g}",
                "moving background, ms": f"{1e3 * np.median(seconds[~still]):.3g}",
            }
        )
    return result


def again_of(rows: list[dict]) -> str:
    """What other rows say where the first were far off."""
    return "".join(
        f" Row {number} is over {DOUBTFUL:g} standard errors off; {AGAIN} times as many other rows "
        f"of it differ by {row['again']['difference']:+.3f} dB, with a standard error of "
        f"{row['again']['standard error']:.3f}."
        for number, row in enumerate(rows, 1)
        if row["again"]
    )


def text_of(rows: list[dict]) -> str:
    """The section of the results."""
    differences = np.array([row["difference"] for row in rows])
    squares = float(np.sum([row["in standard errors"] ** 2 for row in rows]))
    chance = float(chi2.sf(squares, len(rows)))
    fastest = [layered_rows.camera(*pair, max(SPEEDS)).time.size for pair in CAMERAS.values()]
    table, forms = [shown(row) for row in rows], forms_of(rows)
    return TEXT.format(
        count=len(rows),
        per_configuration=48,
        period=layered_rows.PERIOD,
        instants=max(fastest),
        speeds=", ".join(f"{s:g}" for s in SPEEDS),
        noise=READ_NOISE,
        mean=np.mean(differences),
        largest=np.max(np.abs(differences)),
        squares=squares,
        chance=chance,
        verdict="they agree" if chance > 0.01 else "they do not agree",
        again=again_of(rows),
        table=harness.table(table, list(table[0])),
        forms=harness.table(forms, list(forms[0])),
    )


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows = []
    for seed, configuration in enumerate(configurations()):
        rows.append(measure(configuration, seed))
        print(*shown(rows[-1]).values(), sep=" | ", file=sys.stderr, flush=True)
    harness.write("occlusion", rows)
    harness.section("occlusion", text_of(rows))


if __name__ == "__main__":
    main()
