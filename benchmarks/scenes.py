"""What does an optimised shutter gain, on six scenes of different light and speed?

Expected PSNR (best single linear filter, each shutter at its own best motion, velocity and
exposure) of the optimised profile over windows, snapshots and the best coded still, in dB, with
as many digits as docs/scenes.md quotes, which names a camera for each scene.
"""

import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from benchmarks import harness
from benchmarks.gains import best_of
from mishutter import (
    IdealDevice,
    Limits,
    Occlusion,
    Scene,
    Texture,
    compare,
    example_picture,
    example_scene,
    optimise,
)

RIVALS = (
    "Hann",
    "rect",
    "best Tukey",
    "best snapshot",
    "best panned snapshot",
    "best coded still",
)

LAYERS = {
    "before a still half": Occlusion(front_share=0.5, object_width=100),
    "both layers move": Occlusion(front_share=0.3, object_width=100, background="moving"),
}
NOTE = (
    "Where the sag, $aT^2$, is 0 the design does not accelerate: it is the best coded still. The "
    "ceiling is that of speeds spread over the range, which no path, shutter or decoder exceeds. "
    "The last column is the gain over the best snapshot of a design for a shutter that passes "
    "40 % when open, as liquid crystal between polarisers does. Before it stand the gains of other "
    "pictures: of the best camera for objects of 100 px that cover half of a still background, or "
    "30 % of one that moves at the same speeds, over the best snapshot for the same picture."
)
_SLIDES = Path(__file__).parent.parent / "notebooks" / "slides.toml"
_POLARISED = IdealDevice(transmission=0.4)
_TENTH = 0.1
"""Of a stage's resonance, the frequency of the sine of all its travel that it is sent at most."""


def _on_stage(limits: Limits, *, travel_um: float, resonance_hz: float, pixel_um: float) -> Limits:
    """Limits of a sensor that a piezo stage moves, by its data sheet."""
    rate = 2 * np.pi * _TENTH * resonance_hz
    names = ("max_stroke", "max_top_speed", "min_half_exposure", "max_half_exposure")
    return Limits(
        **{name: getattr(limits, name) for name in names},
        max_travel=travel_um / pixel_um,
        max_acceleration=rate**2 * travel_um / 2 / pixel_um,
    )


def scenes() -> dict[str, Scene]:
    """The built-in scene, four others with the same photograph's spectrum, and the slides."""
    given = example_scene()
    picture = Texture.of_photograph(example_picture())
    both_ways = np.linspace(-1, 1, 9)
    wide = Limits(max_stroke=120, max_top_speed=3e4, min_half_exposure=5e-4, max_half_exposure=0.1)
    p622 = {"travel_um": 250.0, "resonance_hz": 400.0}
    p629 = {"travel_um": 1500.0, "resonance_hz": 125.0}

    def common(limits: Limits, pixel_um: float, stage: dict[str, float]) -> dict[str, Any]:
        return {"picture": picture, "limits": _on_stage(limits, pixel_um=pixel_um, **stage)}

    return {
        "built-in: dim, both ways to 4,500 px/s": given,
        "night: 1e4 e-/s, read noise 5 e-": Scene(
            4500 * both_ways, photon_rate=1e4, read_noise=5.0, **common(given.limits, 4.5, p622)
        ),
        "daylight: 2e7 e-/s, read noise 3 e-, no exposure under 1 ms": Scene(
            4500 * both_ways, photon_rate=2e7, read_noise=3.0, **common(given.limits, 3.76, p622)
        ),
        "street: one way, 500 to 3,000 px/s": Scene(
            np.linspace(500, 3000, 9),
            photon_rate=2e5,
            read_noise=4.0,
            **common(given.limits, 4.5, p622),
        ),
        "slow, long stroke: both ways to 900 px/s": Scene(
            900 * both_ways, photon_rate=5e4, read_noise=8.0, **common(wide, 6.45, p629)
        ),
        "slides: moved by hand, LED strobe": Scene.load(_SLIDES),
    }


def compared(scene: Scene) -> dict[str, str]:
    """Expected PSNR of the design and of the ceiling, its motion and its gains; dB."""
    design = optimise(scene)
    table = compare(scene, design)
    level = table.row("optimised").psnr
    lossy = eqx.tree_at(lambda s: s.device, scene, _POLARISED, is_leaf=_is_device)
    dim = float(optimise(lossy).metrics.expected_psnr)
    snapshot = max(table.row(r).psnr for r in RIVALS[3:5])
    over = {r: level - table.row(r).psnr for r in RIVALS}
    return {
        "optimised dB": f"{level:.2f}",
        "sag px": f"{float(design.motion.sag):.1f}",
        "pan px/s": f"{float(design.motion.velocity) + 0.0:.0f}",
        **{f"over {rival}": f"{round(gain, 2) + 0.0:+.2f}" for rival, gain in over.items()},
        "ceiling dB": f"{table.ceiling:.2f}",
        **{name: f"{gain_before(scene, layers):+.2f}" for name, layers in LAYERS.items()},
        "through 40 %": f"{dim - snapshot:+.2f}",
    }


def gain_before(scene: Scene, layers: Occlusion) -> float:
    """Gain of the best camera for layers over the best snapshot for them; dB."""
    return max(best_of(scene.with_occlusion(layers)).gain, 0.0)


def _is_device(part: object) -> bool:
    return part is None or isinstance(part, IdealDevice)


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows, start = [], time.perf_counter()
    for name, scene in scenes().items():
        rows.append({"scene": name, **compared(scene)})
        print(rows[-1], flush=True)
    harness.write("scenes", rows, seconds=time.perf_counter() - start)
    heading = "## Six scenes: what the optimised profile gains, in dB\n\n"
    harness.section("scenes", f"{heading}{harness.table(rows, list(rows[0]))}\n\n{NOTE}")


if __name__ == "__main__":
    main()
