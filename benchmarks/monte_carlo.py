"""How many simulated captures does it take to know what the closed form says at once?

Each seed draws its own rows of the assumed spectrum and its own noise, captures them at
every speed of the scene and restores them with the ensemble filter.
"""

import sys
from time import perf_counter

import jax

jax.config.update("jax_enable_x64", True)

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

import mishutter as ms  # noqa: E402
from benchmarks import harness  # noqa: E402

HALF_EXPOSURE, STROKE = 0.01, 34.0
MEAN, DEVIATION = 0.5, 0.1
ROWS, COLUMNS = 16, 700
COUNTS = (1, 3, 10, 30, 100, 300, 1000)
PHOTON_RATES = {"2,000 e-": 1e5, "200,000 e-": 1e7}


def rows_of(seed: int) -> np.ndarray:
    """Rows of the default spectrum; `(rows, columns, 1)`."""
    frequency = np.fft.rfftfreq(COLUMNS)
    white = np.random.default_rng(seed).standard_normal((ROWS, COLUMNS))
    coloured = np.fft.irfft(np.fft.rfft(white) / np.sqrt(frequency**2 + 0.01**2), COLUMNS)
    grid = (np.arange(256) + 0.5) / 512
    return (MEAN + DEVIATION * coloured / np.sqrt(np.mean(1 / (grid**2 + 0.01**2))))[..., None]


def measure() -> list[dict]:
    """A row a light and a number of seeds."""
    motion = ms.ParabolicMotion(acceleration=STROKE / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)
    shutter, rows = ms.HannShutter(), []
    for light, rate in PHOTON_RATES.items():
        scene = ms.Scene.uniform(
            max_speed=0.3 * float(motion.top_speed),
            num_speeds=5,
            photon_rate=rate,
            read_noise=4.0,
            picture=ms.Texture(mean_level=MEAN, deviation=DEVIATION),
        )
        expected = ms.restore_photograph(rows_of(0), scene, motion, shutter, num_seeds=1)
        closed = harness.timed(lambda: ms.evaluate(scene, motion, shutter).expected_psnr)  # noqa: B023
        errors, begin = [], perf_counter()
        for seed in range(COUNTS[-1]):
            found = ms.restore_photograph(
                rows_of(seed), scene, motion, shutter, num_seeds=1, key=jax.random.key(seed)
            )
            errors.append(10 ** (-found.mean_psnr / 10))
            if len(errors) in COUNTS:
                mean = float(np.mean(errors))
                spread = float(np.std(errors, ddof=1)) if len(errors) > 1 else float("nan")
                rows.append(
                    {
                        "light": light,
                        "seeds": len(errors),
                        "measured dB": -10 * np.log10(mean),
                        "less expected dB": -10 * np.log10(mean) - expected.expected_psnr,
                        "standard error dB": 10 / np.log(10) * spread / mean / np.sqrt(len(errors)),
                        "closed form dB": expected.expected_psnr,
                        "`evaluate` dB": float(closed["value"]),
                        "wall s": perf_counter() - begin,
                        "closed form s": closed["best_s"],
                        "samples": list(errors),
                    }
                )
        print(f"monte carlo: {light} done", file=sys.stderr)
    return rows


def picture(rows: list[dict]) -> None:
    """Difference from the closed form against seeds, with its standard error."""
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for light, marker in zip(PHOTON_RATES, "os", strict=True):
        chosen = [r for r in rows if r["light"] == light]
        axes.errorbar(
            [r["seeds"] for r in chosen],
            [r["measured dB"] - r["closed form dB"] for r in chosen],
            [r["standard error dB"] for r in chosen],
            fmt=f"k{marker}-" if marker == "o" else f"k{marker}--",
            markerfacecolor="white",
            capsize=3,
            label=f"{light} at white",
        )
    axes.axhline(0, color="0.6", linewidth=0.8)
    axes.set_xscale("log")
    axes.set(xlabel="simulated captures", ylabel="measured less expected PSNR / dB")
    axes.legend()
    axes.grid(alpha=0.3)
    harness.save_picture(figure, "monte_carlo")
    plt.close(figure)


def main() -> None:
    """Measure, store, print and draw."""
    rows = measure()
    harness.write("monte_carlo", rows, rows_per_capture=ROWS, columns=COLUMNS)
    picture(rows)
    columns = [key for key in rows[0] if key != "samples"]
    text = (
        "## Expected error against Monte Carlo\n\n![Monte Carlo](results/monte_carlo.png)\n\n"
        "The closed form beside is that of the discrete kernels, which these captures use; "
        "`evaluate`'s is that of a continuous picture, which has no aliases.\n\n"
    )
    harness.section("monte_carlo", text + harness.table(rows, columns))


if __name__ == "__main__":
    main()
