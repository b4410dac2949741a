"""Is the expected PSNR right however far light spreads?

Random scenes with strokes to 2,000 px, bright and dim, of one speed to nine, by `evaluate`'s own
number of frequencies and by 65,536 from Fresnel integrals (`tests/support/closed_form.py`).
`python -m benchmarks.long_kernels [count]`.
"""

import sys

import jax

jax.config.update("jax_enable_x64", True)

import numpy as np  # noqa: E402

import mishutter as ms  # noqa: E402
from benchmarks import harness  # noqa: E402
from mishutter.evaluation.needs import sizes  # noqa: E402

COUNT = 300


def case(seed: int) -> dict:
    """A random scene, its PSNR and that of the reference; dB."""
    from support import closed_form

    random = np.random.default_rng(seed)
    values = random.uniform(0, 1, 13)
    windows = (
        (closed_form.RECT, ms.RectShutter()),
        (closed_form.HANN, ms.HannShutter()),
        (closed_form.tukey(0.3), ms.TukeyShutter(0.3)),
        (closed_form.chips(values), ms.ChippedShutter(values)),
    )
    window, shutter = windows[random.integers(4)]
    stroke, half = 10 ** random.uniform(0, np.log10(2000)), 10 ** random.uniform(-3, -1.5)
    num_speeds, fastest = random.integers(1, 10), 10 ** random.uniform(-1, 0.7) * 2 * stroke / half
    speeds = fastest * random.uniform(-1, 1, num_speeds)
    if seed % 2:
        speeds = fastest * np.linspace(-1, 1, num_speeds)
    rate, noise = 10 ** random.uniform(4, 8), random.uniform(0, 9)
    limits = ms.Limits(max_stroke=stroke)
    scene = ms.Scene(speeds, photon_rate=rate, read_noise=noise, limits=limits)
    motion = ms.ParabolicMotion(acceleration=stroke / half**2, half_exposure=half)
    relative = float(ms.ExpectedErrorLoss()(scene, motion, shutter))
    found = -20 * np.log10(relative * float(scene.picture.deviation))
    exact = closed_form.expected_psnr(window, stroke, half, speeds, rate, noise)
    return {
        "seed": seed,
        "stroke px": stroke,
        "speeds": int(num_speeds),
        "frequencies": sizes(scene, motion).num_frequencies,
        "PSNR dB": found,
        "less exact dB": found - exact,
    }


def main() -> None:
    """Measure, store and print."""
    count = int(sys.argv[1]) if sys.argv[1:] and sys.argv[1].isdigit() else COUNT
    rows = [case(seed) for seed in range(count)]
    worst = sorted(rows, key=lambda row: -abs(row["less exact dB"]))[:5]
    largest = abs(worst[0]["less exact dB"])
    sentence = f"Of {count} scenes the worst is {largest:.2g} dB off 65,536 frequencies."
    harness.write("long_kernels", rows, sentence=sentence)
    text = "## Expected PSNR on long strokes\n\nThe five worst:\n\n"
    table = harness.table(worst, list(worst[0]))
    harness.section("long_kernels", f"{text}{table}\n\n{sentence}")


if __name__ == "__main__":
    main()
