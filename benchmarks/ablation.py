"""What does each part of the search buy, in loss and in processor seconds?

Searches of every kind are done once with the whole search and once without each of its parts: the
six scenes of the pages, bright and dim light, random speeds, short strokes, the design loss,
devices that lag or have levels, tolerances and stages. The first of a search compiles;
the others of it share its programs. Run `python -m benchmarks.ablation`: 15 minutes of one core.
"""

import time
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from importlib import import_module
from typing import Any
from unittest.mock import patch

import jax
import numpy as np

from benchmarks import harness
from benchmarks.scenes import scenes
from mishutter import (
    DesignLoss,
    FirstOrderDevice,
    HannShutter,
    IdealDevice,
    Limits,
    LinearMotion,
    ParabolicMotion,
    Scene,
    SplineShutter,
    StillCamera,
    SwitchedDevice,
    Tolerances,
    TukeyShutter,
    example_scene,
    optimise,
)
from mishutter.search.starts import cover

LIMITS = Limits(max_stroke=50.0, max_top_speed=1e5, max_half_exposure=1 / 30)
SMALL = Limits(max_stroke=30.0, max_top_speed=2e4, min_half_exposure=5e-4, max_half_exposure=0.03)
WORSE = 1e-3
"""Rise of a loss that counts as worse: 0.004 dB where the loss is the expected error."""
_EQUAL = 1e-5
WHOLE = "whole"
Search = Callable[..., Any]
NOTE = (
    "`first` compiles, the others share its programs. Two parts that were there at commit "
    "546a79c were measured on the searches of this list. Descents from all starts at once took "
    "Optimistix's steps by hand, gave up the worse half every ten steps, and saw half the "
    "frequencies and fewer nodes of tolerances. Losses and gradients took two programs, of "
    "which every kind of shutter and motion shared the longer. Without both, with tries of 20 "
    "steps from half of the starts and 300 steps at most, 44 of 48 losses were equal to 1e-5, "
    "one was 0.02 % higher, and those of three scenes of two speeds in bright light were 5.8, "
    "0.4 and 0.6 % higher; the processor took 395 s for all 48 the first time, with the parts "
    "362 s. So tries take 60 steps, from a third of the starts, and a search 400: that 0.02 % "
    "is gone, and the three are 0.4, 1.4 and 0.7 % lower than with the parts. Scenes of two "
    "speeds tell methods apart: L-BFGS-B alone, 60 steps from the 6 lowest starts, ended 15 and "
    "19 % higher on the first two, and up to 300 steps from 8, 16 or all 64 ended 16 and 3 % "
    "higher, where BFGS by `optx.minimise`, 300 steps from the 6 lowest, ended 5.8 and 0.3 % "
    "higher. Another seed changes these losses by up to 12 %, with the parts and without."
)


def _small(**options: Any) -> Scene:
    """A scene that is searched in a second."""
    common = {"max_speed": 2000.0, "num_speeds": 5, "photon_rate": 1e5, "read_noise": 10.0}
    return Scene.uniform(**{**common, "limits": SMALL, **options})


def _random(seed: int) -> Scene:
    """Two to nine speeds of unequal weight, in dim or in bright light."""
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 10))
    speeds = random.uniform(-1, 1, count) * 10 ** random.uniform(2.5, 4)
    return Scene(
        speeds,
        random.uniform(0.2, 1, count),
        photon_rate=10 ** random.uniform(4, 9),
        read_noise=random.uniform(1, 10),
        limits=LIMITS,
    )


def _of_scenes() -> dict[str, Search]:
    return {name.split(":")[0]: partial(optimise, scene) for name, scene in scenes().items()}


def _of_light() -> dict[str, Search]:
    few = {
        "bright, mostly one way": ([-500.0, 3000.0], 1e8, 1.0),
        "bright, both ways": ([-193.333, 214.190], 8.45206e8, 1.0),
        "bright, near rest": ([19.4076, 226.391], 8.25270e8, 8.0),
    }
    searches: dict[str, Search] = {}
    for name, (speeds, rate, noise) in few.items():
        scene = Scene(speeds, photon_rate=rate, read_noise=noise, limits=LIMITS)
        searches[name] = partial(optimise, scene, seed=1)
    for rate in (1e3, 1e4, 1e6, 1e8):
        scene = _small(photon_rate=rate)
        searches[f"small, {rate:g} e-/s"] = partial(optimise, scene, num_coefficients=12)
    return searches


def _of_random_speeds() -> dict[str, Search]:
    return {f"random speeds {seed}": partial(optimise, _random(seed)) for seed in range(8)}


def _of_short_strokes() -> dict[str, Search]:
    motions = (
        (1.70481562592037e5, 4.942246735828411e-3),
        (1.151359755736192e5, 4.590409278672298e-3),
        (9.461888922082026e4, 2.361534411099987e-3),
    )
    searches: dict[str, Search] = {}
    for acceleration, half in motions:
        motion = ParabolicMotion(acceleration=acceleration, half_exposure=half)
        searches[f"code, stroke {acceleration * half**2:.2f} px"] = partial(
            optimise, example_scene(), motion, free="shutter"
        )
    for stroke in (2.0, 5.0):
        limits = Limits(max_stroke=stroke, max_top_speed=2e4, max_half_exposure=0.03)
        scene = _small(limits=limits)
        searches[f"stroke {stroke:g} px"] = partial(optimise, scene, num_coefficients=16)
    return searches


def _of_design_loss() -> dict[str, Search]:
    loss = DesignLoss()
    motion = ParabolicMotion(acceleration=22.0 / 1e-4, half_exposure=1e-2)
    every = ("shutter", "half_exposure", "acceleration")
    design = partial(optimise, loss=loss)
    return {
        "design loss, built-in": partial(design, example_scene()),
        "design loss, small": partial(design, _small(), motion, num_coefficients=12),
        "design loss, random speeds": partial(design, _random(3), free="shutter"),
        "design loss, all free": partial(design, _small(), num_coefficients=10, free=every),
    }


def _of_devices() -> dict[str, Search]:
    devices = {
        "lags, 3.5 ms": FirstOrderDevice(rise_time=3.5e-3, fall_time=3.5e-3, num_slots=32),
        "lags, 1 and 5 ms": FirstOrderDevice(rise_time=1e-3, fall_time=5e-3, num_slots=32),
        "lags, 4 levels": FirstOrderDevice(rise_time=2e-3, fall_time=2e-3, levels=4, num_slots=32),
        "3 levels": IdealDevice(levels=3, num_slots=32),
        "switched": SwitchedDevice(num_slots=32),
        "switched, long runs": SwitchedDevice(num_slots=48, min_open=4, min_closed=3),
    }
    searches: dict[str, Search] = {}
    for name, device in devices.items():
        searches[name] = partial(optimise, _small(device=device), num_coefficients=12)
    return searches


def _of_tolerances() -> dict[str, Search]:
    belts = Scene(
        [0.0, 1000.0, 2500.0],
        photon_rate=7.7e5,
        read_noise=6.0,
        limits=SMALL,
        tolerances=Tolerances(speed=300.0),
    )
    loose = Tolerances(acceleration=0.05, velocity=200.0, delay=5e-4, speed=100.0)
    return {
        "tolerances, belts": partial(optimise, belts, num_coefficients=12),
        "tolerances, loose": partial(optimise, _small(tolerances=loose), num_coefficients=10),
    }


def _of_stages() -> dict[str, Search]:
    common: dict[str, Any] = {"max_stroke": 30.0, "max_top_speed": 2e4, "max_half_exposure": 0.03}
    travel = Limits(**common, max_travel=40.0, max_acceleration=2e6)
    jerk = Limits(**common, max_travel=60.0, max_jerk=1e9)
    return {
        "stage, travel": partial(optimise, _small(limits=travel), num_coefficients=12),
        "stage, jerk": partial(optimise, _small(limits=jerk), num_coefficients=12),
    }


def _of_other_kinds() -> dict[str, Search]:
    still, half = StillCamera(half_exposure=2e-3), 4e-3
    spline = SplineShutter.fit(TukeyShutter(0.4), 11)
    single = Scene(
        np.array([-700.0, 200.0, 1900.0], np.float32),
        photon_rate=3e5,
        read_noise=5.0,
        limits=SMALL,
    )
    pan = LinearMotion(half_exposure=half, velocity=300.0)
    return {
        "coded still": partial(optimise, example_scene(), still),
        "coded pan": partial(optimise, _random(5), pan, num_coefficients=12),
        "Tukey": partial(optimise, example_scene(), shutter=TukeyShutter(0.5)),
        "Hann": partial(optimise, _random(2), shutter=HannShutter()),
        "an own spline, not symmetric": partial(optimise, _small(), shutter=spline),
        "single precision": partial(optimise, single, num_coefficients=12),
    }


def searches() -> dict[str, Search]:
    """Every search, by its name."""
    kinds = (
        _of_scenes,
        _of_light,
        _of_random_speeds,
        _of_short_strokes,
        _of_design_loss,
        _of_devices,
        _of_tolerances,
        _of_stages,
        _of_other_kinds,
    )
    return {name: search for kind in kinds for name, search in kind().items()}


def _random_cover(space: Any, scene: Scene, num_starts: int, seed: int) -> np.ndarray:
    """As many candidates as the cover has, anywhere in the box."""
    count = len(cover(space, scene, num_starts, seed))
    return np.random.default_rng(seed).uniform(size=(count, space.size))


PARTS: dict[str, dict[str, Any]] = {
    WHOLE: {},
    "random points for the cover": {"cover": _random_cover},
    "one start": {"_TRIED_SHARE": 1e9, "_NUM_LASTING": 1, "_LASTING_SHARE": 1e9},
    "no BFGS": {"minimise": lambda objective, box, max_steps: (box, 0)},
}
"""What stands for a part of the search in its module."""


def measured(search: Search) -> dict[str, tuple[float, float]]:
    """Loss and processor seconds of a search: the first time, and without each part then."""
    module, results = import_module("mishutter.search.search"), {}
    for name, stands_in in {"first": {}, **PARTS}.items():
        with patch.multiple(module, **stands_in) if stands_in else nullcontext():
            begin = time.process_time()
            loss = float(search().loss)
            results[name] = loss, time.process_time() - begin
    return results


def summary(name: str, results: dict[str, dict[str, tuple[float, float]]]) -> dict:
    """A row: how many losses are equal, worse and better without a part, and seconds."""
    rises = {search: each[name][0] / each[WHOLE][0] - 1 for search, each in results.items()}
    worst = max(rises, key=lambda search: rises[search])
    return {
        "search": name,
        "equal": sum(abs(rise) <= _EQUAL for rise in rises.values()),
        "worse by 0.1 %": sum(rise > WORSE for rise in rises.values()),
        "better by 0.1 %": sum(rise < -WORSE for rise in rises.values()),
        "mean": f"{np.mean(list(rises.values())):+.2%}",
        "worst": f"{rises[worst]:+.2%} ({worst})" if rises[worst] > WORSE else "-",
        "processor s": f"{sum(each[name][1] for each in results.values()):.0f}",
    }


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    results = {}
    for name, search in searches().items():
        results[name] = measured(search)
        print(name, results[name], flush=True)
    rows = [summary(name, results) for name in ("first", *PARTS)]
    harness.write("ablation", rows, losses_and_seconds=results)
    heading = f"## What each part of the search buys, over {len(results)} searches\n\n"
    harness.section("ablation", f"{heading}{harness.table(rows, list(rows[0]))}\n\n{NOTE}")


if __name__ == "__main__":
    main()
