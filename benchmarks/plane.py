"""Where does a sensor that moves in the plane pay, for things that move in any direction?

The best burst on two sines, one an axis, over the best burst at rest, both registered, by light,
frame rate and read noise: a map. Then a rule of thumb from two numbers of the best stills, checked
on its cells. A typical printout stands in `RESULTS.md`.
"""

import math
import sys
import time
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from benchmarks import harness
from benchmarks.bursts import (
    COUNTS,
    LIGHTS,
    NOISES,
    TRAVEL,
    WINDOW,
    case,
    draw_map,
    explain_map,
    gains_on_grid,
)
from mishutter import BurstMode, Limits, PlaneFrames, Scene, exposures_psnr
from mishutter.evaluation.fans import SEARCHED
from mishutter.search.frame_ties import BRACKETED, STILLS, TWO_SINES
from mishutter.search.plane_frames import _PlaneSearch

TOP_SPEED = 4500.0
"""Of the things in any direction, as of those of the other map along one axis; px/s."""
ANY = (0.0, math.inf)
CLASSES = (
    ("4 or more", (0.0, 0.5), (0.0, 0.7)),
    ("4 or more", (0.0, 0.5), (0.7, 3.0)),
    ("4 or more", (0.0, 0.5), (3.0, 30.0)),
    ("4 or more", (0.0, 0.5), (30.0, math.inf)),
    ("4 or more", (0.5, 1.0), ANY),
    ("4 or more", (1.0, math.inf), ANY),
    ("2", ANY, (0.0, 0.7)),
    ("2", ANY, (0.7, 3.0)),
    ("2", ANY, (3.0, math.inf)),
)
"""Frames, and the ends of the duty of stills and of their signal, of the classes of the rule."""
TEXT = """## In any direction

Gain, dB, of the best frames on two sines of different frequency, one an axis, over the best frames
of a camera at rest, both registered without error: things of up to 4,500 px/s in any direction,
bursts of 80 ms, a stage of two axes that travels 110 px. `0` is less than 0.005 dB.

![Gain of two sines by light and frame rate](results/plane.png)

{map}

A rule of thumb: the exposure that the best stills would have if nothing limited them, as a share of
the time from frame to frame, and then the signal of the best still frame, its electrons at the mean
level over the square of the read noise. Over the {cells} cells, each at its own rate:

{rule}
"""


def scene_of(light: float, noise: float, burst: BurstMode | None = None) -> Scene:
    """The scene of a camera that takes a burst."""
    limits = Limits(
        max_stroke=TRAVEL,
        max_travel=TRAVEL,
        max_top_speed=1e5,
        min_half_exposure=5e-5,
        max_half_exposure=WINDOW / 2,
    )
    given = {"photon_rate": light, "read_noise": noise, "limits": limits, "burst": burst}
    return Scene.any_direction(TOP_SPEED, **given)


def cell(count: int, light: float, noise: float) -> dict[str, Any]:
    """The best bursts of a camera that takes so many frames within the window."""
    rate = count / WINDOW
    scene = scene_of(light, noise, BurstMode(frames_per_s=rate, max_frames=count, window=WINDOW))
    search = _PlaneSearch.of(scene)
    one, two = search.stage(1), search.stage(2)
    found = {}
    for stage, kind in ((one, STILLS), (one, BRACKETED), (two, TWO_SINES)):
        (found[kind],) = search._bursts(stage, [stage.best(kind, count)])
    still = found[STILLS]
    exposure = float(still.frames.exposures[0])
    mean = float(scene.picture.mean_level)
    return {
        "frames": count,
        "e-/s": light,
        "e-": noise,
        "still dB": max(found[STILLS].psnr, found[BRACKETED].psnr),
        "still ms": 1e3 * exposure,
        "moving dB": found[TWO_SINES].psnr,
        "travel px": found[TWO_SINES].travel,
        "top speed": float(found[TWO_SINES].use_within(scene.limits).top_speed) / TOP_SPEED,
        "duty": unlimited_exposure(scene, count) * rate,
        "signal": mean * light * exposure / noise**2,
    }


def unlimited_exposure(scene: Scene, count: int) -> float:
    """The best exposure of equal frames at rest that may be as long as they like; s."""

    def loss(place: float) -> float:
        exposure = math.exp(place)
        frames = PlaneFrames(
            exposure * np.arange(count), np.full(count, exposure), np.ones(1), np.zeros((2, 2))
        )
        return -float(exposures_psnr(scene, frames, grid=SEARCHED))

    ends = (math.log(1e-5), math.log(2 * WINDOW))
    end: Any = minimize_scalar(loss, bounds=ends, method="bounded", options={"xatol": 0.02})
    return math.exp(end.x)


def gains(rows: Sequence[dict[str, Any]], noise: float) -> Float[np.ndarray, "counts lights"]:
    """Of cameras that take no more frames than each number, dB."""
    cells = {(row["frames"], row["e-/s"]): row for row in rows if row["e-"] == noise}
    return gains_on_grid(cells, COUNTS, LIGHTS)


def picture(rows: Sequence[dict[str, Any]]) -> None:
    """The map, on the scale of that along one axis."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(10, 4.6), sharey=True, layout="constrained")
    drawn: Any = None
    for axes, noise in zip(panels, NOISES, strict=True):
        drawn = draw_map(axes, np.array(COUNTS) / WINDOW, gains(rows, noise))
        axes.set_title(f"read noise {noise:g} e-", fontsize=10)
        axes.set_xlabel("photo-electrons a second at a white pixel")
    panels[0].set_ylabel("frames a second that the camera can take")
    explain_map(figure, panels, drawn)
    harness.save_picture(figure, "plane")
    plt.close(figure)


def table_of_map(rows: Sequence[dict[str, Any]]) -> str:
    """Gains by light and read noise, over frame rates."""
    of_each = {noise: gains(rows, noise) for noise in NOISES}
    shown = [
        {"80 ms": case(light, noise)}
        | {
            f"{count / WINDOW:g} frames/s": f"{gain:.2f}" if gain >= 0.005 else "0"
            for count, gain in zip(COUNTS, of_each[noise][:, number], strict=True)
        }
        for number, light in enumerate(LIGHTS)
        for noise in NOISES
    ]
    return harness.table(shown, list(shown[0]))


def table_of_rule(rows: Sequence[dict[str, Any]]) -> str:
    """The gains by frames, by the unlimited duty of stills, and by their signal."""
    shown = []
    for frames, duty, signal in CLASSES:
        own = [
            row["moving dB"] - row["still dB"]
            for row in rows
            if (row["frames"] == 2) == (frames == "2")
            and duty[0] <= row["duty"] < duty[1]
            and signal[0] <= row["signal"] < signal[1]
        ]
        least, middle, most = np.round(np.percentile(own, (0, 50, 100)), 2) + 0.0
        shown.append(
            {
                "frames": frames,
                "share of the period": between(*duty),
                "signal": between(*signal),
                "cells": len(own),
                "least gain, dB": f"{least:.2f}",
                "median": f"{middle:.2f}",
                "greatest": f"{most:.2f}",
            }
        )
    return harness.table(shown, list(shown[0]))


def between(low: float, high: float) -> str:
    """A class in words."""
    if (low, high) == ANY:
        return "any"
    if low == 0:
        return f"below {high:g}"
    return f"above {low:g}" if high == math.inf else f"{low:g} to {high:g}"


def main() -> None:
    """Measure, store, draw and print."""
    jax.config.update("jax_enable_x64", True)
    start, rows = time.process_time(), []
    for count in COUNTS:
        rows += [cell(count, light, noise) for light in LIGHTS for noise in NOISES]
        print(f"{count} frames: {time.process_time() - start:.0f} s", file=sys.stderr)
    picture(rows)
    harness.write("plane", rows, processor_s=time.process_time() - start)
    text = TEXT.format(map=table_of_map(rows), cells=len(rows), rule=table_of_rule(rows))
    harness.section("plane", text)


if __name__ == "__main__":
    main()
