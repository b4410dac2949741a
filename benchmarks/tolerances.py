"""What do tolerances cost a design, and how much of that does a design made for them win back?

Each scene is designed for twice, without tolerances and with those of a loosely built camera. The
plain design is decoded by a filter that is as unaware of them as itself; the robust one by a filter
that knows how its errors are distributed.
"""

import time
from dataclasses import replace

import equinox as eqx
import jax

from benchmarks import harness
from benchmarks.scenes import scenes
from mishutter import (
    Limits,
    Scene,
    Texture,
    Tolerances,
    example_picture,
    optimise,
    tolerance_costs,
)

SLOW = "slow, long stroke: both ways to 900 px/s"
VELOCITIES = (75.0, 150.0, 300.0, 600.0)
"""Errors of the velocity on the scene where they matter most; px/s."""

FEW = {
    "belts at 0, 1,000, 2,500 px/s": ([0.0, 1000.0, 2500.0], 7.7e5, 300.0),
    "belts at -300, 900, 1,000 px/s": ([-300.0, 900.0, 1000.0], 2.6e7, 50.0),
    "belts at -1,500, 1,500 px/s": ([-1500.0, 1500.0], 1e5, 100.0),
}
"""Scenes of a few speeds that are known: speeds, px/s, photon rate, e-/s, and by how much these
speeds may be off, px/s."""

NOTE = (
    "Standard deviations: acceleration 5 %, velocity 10 % and speeds 5 % of the fastest object, "
    "delay 0.5 ms, transmittance 2 % in steps of 0.1 ms; below, the velocity alone, and on the "
    "belts the speeds alone (300, 50 and 100 px/s; read noise 6 e-). `plain` is "
    "designed and decoded without tolerances, `its filter` is told of them, `robust` is "
    "designed for them; all three are losses within the tolerances, `nominal` that of the "
    "robust design without any, each from the plain design's own level. `share` is robust over "
    "plain, `own` the same from the robust design's own level without tolerances. A design "
    "loses little to small errors wherever it is, and a robust one wins back little: to second "
    "order, halving the own loss costs a quarter of it without tolerances. Tolerances matter most "
    "where objects have a few speeds that are known: a design lets light through while the sensor "
    "pans with one of them, and loses where that is wrong. There the best design is sometimes one "
    "of two that are worth nearly the same, of which one forgives, and a robust search takes that "
    "one: less than half of the loss for less than 0.05 dB, as on the first two belts. On the "
    "third it is dearer. Errors of the transmittance count for as much in every profile of an "
    "exposure. `finer` is the robust loss on 15 and 9 nodes for 5 and 3."
)


def with_tolerances(scene: Scene, tolerances: Tolerances) -> Scene:
    """The scene within tolerances."""
    return eqx.tree_at(lambda s: s.tolerances, scene, tolerances, is_leaf=lambda x: x is None)


def few_speeds(speeds: list[float], photon_rate: float) -> Scene:
    """A scene of a few speeds, before a stage and a camera of usual limits."""
    limits = Limits(
        max_stroke=60, max_top_speed=2e4, min_half_exposure=1e-4, max_half_exposure=0.03
    )
    picture = Texture.of_photograph(example_picture())
    return Scene(speeds, photon_rate=photon_rate, read_noise=6.0, limits=limits, picture=picture)


def loose(scene: Scene) -> Tolerances:
    """A loosely built camera."""
    fastest = float(scene.max_speed)
    return Tolerances(
        acceleration=0.05,
        velocity=0.1 * fastest,
        delay=5e-4,
        speed=0.05 * fastest,
        transmittance=0.02,
        drive_step=1e-4,
    )


def measured(scene: Scene, plain, tolerances: Tolerances) -> dict:
    """Losses of a plain and of a robust design; dB."""
    within = with_tolerances(scene, tolerances)
    costs = tolerance_costs(within, plain.motion, plain.shutter)
    begin = time.perf_counter()
    robust = optimise(within)
    seconds = time.perf_counter() - begin
    level = costs.expected_psnr
    own = tolerance_costs(within, robust.motion, robust.shutter)
    nominal = level - own.expected_psnr
    lost = nominal + own.rows[-1].cost
    finer = replace(tolerances, num_speeds=15, num_accelerations=9)
    many = tolerance_costs(with_tolerances(scene, finer), robust.motion, robust.shutter)
    together = costs.rows[-1]
    return {
        "plain dB": f"{level:.2f}",
        "largest": max(costs.rows[:-1], key=lambda row: row.cost).name,
        "plain": f"{together.unaware_cost:.3f}",
        "its filter": f"{together.cost:.3f}",
        "robust": f"{lost:.3f}",
        "finer": f"{nominal + many.rows[-1].cost:.3f}",
        "nominal": f"{nominal + 0.0:.3f}",
        "share": f"{lost / together.unaware_cost:.2f}",
        "own": f"{(lost - nominal) / together.unaware_cost:.2f}",
        "s": f"{seconds:.0f}",
    }


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows, start = [], time.perf_counter()
    for name, scene in scenes().items():
        plain = optimise(scene)
        rows.append({"scene": name.partition(":")[0], **measured(scene, plain, loose(scene))})
        print(rows[-1], flush=True)
        for velocity in VELOCITIES if name == SLOW else ():
            case = f"slow, velocity {velocity:g} px/s"
            found = measured(scene, plain, Tolerances(velocity=velocity))
            rows.append({"scene": case, **found})
            print(rows[-1], flush=True)
    for name, (speeds, rate, off) in FEW.items():
        scene = few_speeds(speeds, rate)
        rows.append({"scene": name, **measured(scene, optimise(scene), Tolerances(speed=off))})
        print(rows[-1], flush=True)
    harness.write("tolerances", rows, seconds=time.perf_counter() - start)
    heading = "## Tolerances: what a robust design wins back, in dB\n\n"
    harness.section("tolerances", f"{heading}{harness.table(rows, list(rows[0]))}\n\n{NOTE}")


if __name__ == "__main__":
    main()
