"""How fast is Richardson-Lucy beside scikit-image's, and how soon is it as good?

A typical printout stands in `RESULTS.md`.
"""

from importlib.metadata import version
from time import perf_counter

import jax
import jax.numpy as jnp
import numpy as np
from skimage.restoration import richardson_lucy

import mishutter as ms
from benchmarks import harness
from mishutter.camera.capture import captured_columns
from mishutter.decoding.decoders.base import blur_model

SIDE, ITERATIONS, REPEATS = 1536, 30, 7
HALF_EXPOSURE, STROKE, READ_NOISE = 0.01, 45.0, 4.0
PHOTON_RATES = (3e4, 1e5, 5e5, 3e6)
MARGIN = 100
"""Columns at either end that are not judged: scikit-image takes what lies beyond for dark."""
DECODERS = {
    "30 plain steps": ms.RichardsonLucyDecoder(
        ITERATIONS, accelerated=False, until_noise=False, start="capture"
    ),
    "3 steps to the likeliest picture of few edges": ms.RichardsonLucyDecoder(3),
    "all 15 of these steps": ms.RichardsonLucyDecoder(),
}
TEXT = """## Richardson-Lucy beside scikit-image

A picture of {side} x {side} px, float32, a kernel of {taps} taps (Hann window, stroke
{stroke:g} px), scikit-image {version}; the least of {repeats} runs in turns, in one process.

{iterations} iterations to the same border rule and start: {ours:.3f} s, scikit-image
{theirs:.3f} s, {ratio:.1f} times as long; the results differ by at most {difference:.1e}.

On a photograph with noise, {margin} columns at either end left out (scikit-image takes what
lies beyond them for dark); scikit-image's 30 iterations are what the times and the PSNR are
held against:

{table}"""


def alternately(functions: dict) -> tuple[dict, dict]:
    """Least wall time of some calls in turns after a first, s, and the last results."""
    values = {name: jax.block_until_ready(f()) for name, f in functions.items()}
    times: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(REPEATS):
        for name, function in functions.items():
            begin = perf_counter()
            values[name] = jax.block_until_ready(function())
            times[name].append(perf_counter() - begin)
    return times, {name: np.asarray(value) for name, value in values.items()}


def camera() -> ms.ParabolicMotion:
    """The moving sensor."""
    return ms.ParabolicMotion(acceleration=STROKE / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)


def picture(columns: int) -> np.ndarray:
    """The example photograph, as often as it takes to fill the sensor."""
    return np.tile(ms.example_picture().luminance, (4, 3))[:SIDE, :columns]


def same_rules() -> dict:
    """Thirty iterations by both, to scikit-image's border rule and start."""
    taps = np.asarray(ms.blur_kernel(ms.HannShutter(), camera(), num_taps=51), np.float32)
    taps = taps / taps.sum()
    blurred = np.stack([np.convolve(row, taps, "same") for row in picture(SIDE)])
    noise = 0.01 * np.random.default_rng(1).random(blurred.shape)
    captured = (blurred + 0.01 + noise).astype(np.float32)
    times, found = alternately(
        {
            "ours": lambda: ms.richardson_lucy(captured, taps),
            "theirs": lambda: richardson_lucy(
                captured, taps[None], num_iter=ITERATIONS, clip=False
            ),
        }
    )
    difference = float(np.max(np.abs(found["ours"] - found["theirs"])))
    return {"what": "same rules", "samples_s": times, "difference": difference, "taps": taps.size}


def same_quality(photon_rate: float) -> list[dict]:
    """A row for scikit-image and for each of ours: time and PSNR at one light."""
    motion, shutter = camera(), ms.HannShutter()
    whole = picture(SIDE + 46)
    texture = ms.Texture.of_photograph(ms.Picture(whole[..., None]))
    scene = ms.Scene([0.0], photon_rate=photon_rate, read_noise=READ_NOISE, picture=texture)
    key = jax.random.key(1)
    captured = ms.simulate_capture(whole, scene, motion, shutter, border="scene", key=key)
    truth = whole[:, captured_columns(motion, 0.0, whole.shape[1])]
    model = blur_model(scene, motion, shutter)
    taps = np.maximum(ms.centred_kernel(motion, shutter), 0)
    taps = (taps / taps.sum()).astype(np.float32)
    light = np.asarray(captured) / np.float32(model.efficiency)
    functions = {
        "scikit-image": lambda: richardson_lucy(light, taps, num_iter=ITERATIONS, clip=False)
    }
    for name, decoder in DECODERS.items():
        functions[name] = lambda decoder=decoder: decoder.restore(jnp.asarray(captured), model)
    times, found = alternately(functions)
    inner = np.s_[:, MARGIN:-MARGIN]
    theirs = min(times["scikit-image"])
    return [
        {
            "what": "same quality",
            "light": f"{photon_rate:.0e} e-/s",
            "method": name,
            "PSNR dB, gamma-coded": ms.psnr(truth[inner], light[inner], gamma=True),
            "PSNR dB, linear light": ms.psnr(truth[inner], light[inner]),
            "best ms": 1e3 * min(times[name]),
            "times as fast": theirs / min(times[name]),
            "samples_s": times[name],
        }
        for name, light in found.items()
    ]


def main() -> None:
    """Measure, store and print."""
    first = same_rules()
    rows = [row for rate in PHOTON_RATES for row in same_quality(rate)]
    harness.write("restoration", [first, *rows], side=SIDE, scikit_image=version("scikit-image"))
    ours, theirs = (min(first["samples_s"][name]) for name in ("ours", "theirs"))
    shown = [
        {
            **row,
            **{k: f"{row[k]:.2f}" for k in ("PSNR dB", "PSNR dB, linear light")},
            "best ms": f"{row['best ms']:.0f}",
            "times as fast": f"{row['times as fast']:.1f}",
        }
        for row in rows
    ]
    columns = ["light", "method", "PSNR dB", "PSNR dB, linear light", "best ms", "times as fast"]
    text = TEXT.format(
        side=SIDE,
        taps=first["taps"],
        stroke=STROKE,
        version=version("scikit-image"),
        repeats=REPEATS,
        iterations=ITERATIONS,
        ours=ours,
        theirs=theirs,
        ratio=theirs / ours,
        difference=first["difference"],
        margin=MARGIN,
        table=harness.table(shown, columns),
    )
    harness.section("restoration", text)


if __name__ == "__main__":
    main()
