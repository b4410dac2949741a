"""What does an optimised shutter gain, on scenes of different light and speed?

Expected PSNR (best single linear filter, each shutter at its own best motion and exposure) of
the optimised profile over Hann, rect, the best Tukey window and the best snapshot, in dB.
"""

import time

import jax
import numpy as np

from benchmarks import harness
from mishutter import (
    ExpectedErrorLoss,
    Limits,
    Scene,
    compare,
    example_picture,
    example_scene,
    optimise,
    row_power_spectrum,
    starting_shutter,
)

WITHDRAWN = ("daylight", "street")
"""Scenes whose gains a rival outside the comparison reaches too."""

WHY = (
    "No gain is shown in daylight, where a camera at rest with a shaped shutter does better, nor "
    "in the street, where a camera that pans does as well: neither rival is in the comparison yet."
)

RIVALS = ("Hann", "rect", "best Tukey", "best snapshot")


def scenes() -> dict[str, Scene]:
    """The built-in scene and four others, with the same photograph's spectrum."""
    given = example_scene()
    picture = row_power_spectrum(example_picture(), 256)._asdict()
    common = {**picture, "limits": given.limits, "motion": given.motion}
    both_ways = np.linspace(-1, 1, 9)
    wide = Limits(max_stroke=120, max_top_speed=3e4, min_half_exposure=5e-4, max_half_exposure=0.1)
    wide_common = {**common, "limits": wide}
    return {
        "built-in: dim, both ways to 4,500 px/s": given,
        "night: 1e4 e-/s, read noise 5 e-": Scene(
            4500 * both_ways, photon_rate=1e4, read_noise=5.0, **common
        ),
        "daylight: 2e7 e-/s, read noise 3 e-, no exposure under 1 ms": Scene(
            4500 * both_ways, photon_rate=2e7, read_noise=3.0, **common
        ),
        "street: one way, 500 to 3,000 px/s": Scene(
            np.linspace(500, 3000, 9), photon_rate=2e5, read_noise=4.0, **common
        ),
        "slow, long stroke: both ways to 900 px/s": Scene(
            900 * both_ways, photon_rate=5e4, read_noise=8.0, **wide_common
        ),
    }


def gains(scene: Scene) -> list[float]:
    """Expected PSNR of the optimised design, and its gain over each rival; dB."""
    design = optimise(
        scene,
        scene.motion,
        starting_shutter(scene),
        loss=ExpectedErrorLoss(),
        num_starts=8,
        max_steps=150,
    )
    table = compare(scene, design.motion, {"optimised": design.shutter})
    level = float(table.row("optimised").metrics.expected_psnr)
    return [level, *(level - float(table.row(r).metrics.expected_psnr) for r in RIVALS)]


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows, start = [], time.perf_counter()
    for name, scene in scenes().items():
        level, *over = gains(scene)
        row = {"scene": name, "optimised dB": f"{level:.3f}"}
        if not name.startswith(WITHDRAWN):
            row |= {f"over {rival}": f"{x:+.3f}" for rival, x in zip(RIVALS, over, strict=True)}
        rows.append(row)
    harness.write("five_scenes", rows, seconds=time.perf_counter() - start)
    columns = ["scene", "optimised dB", *(f"over {rival}" for rival in RIVALS)]
    heading = "## Five scenes: what the optimised profile gains, in dB\n\n"
    harness.section("five_scenes", f"{heading}{harness.table(rows, columns)}\n\n{WHY}")


if __name__ == "__main__":
    main()
