"""Which camera should move while it takes a burst, and by how much does that pay?

The best burst of a sensor that moves while its frames are exposed over the best burst of one that
stands still, for cameras of every frame rate, light and read noise, both registered: a map. Then
what paths ask of a stage, how many stills a moving frame is worth, what registration costs, how
wide a sensor must be, and what a background at rest changes. A typical printout stands in
`RESULTS.md`.
"""

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from itertools import pairwise
from typing import Any

import jax
import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize, minimize_scalar, root_scalar

from benchmarks import harness
from benchmarks.burst_levels import (
    FrameGroup,
    burst_psnr,
    seen_by,
    still_frames,
)
from benchmarks.frames import alternating_frames, panned_frames, sine_frames, sweep_frames
from mishutter import BurstMode, FreeMotion, Limits, Scene, TimedFrame
from mishutter.evaluation.bursts import FrameTimes, StillBursts
from mishutter.evaluation.needs import Plan, sizes
from mishutter.evaluation.registration import loss_of_width, registration

TOP_SPEED, TRAVEL = 4500.0, 110.0
"""Of the objects, px/s; of the stage over the burst, px."""
WINDOW = 0.08
"""From first to last light, s."""
WINDOWS = (WINDOW, WINDOW / 4)
"""Those of the map."""
COUNTS = (2, 4, 8, 16, 32)
"""Frames that fill the window at the rates of the map."""
LIGHTS = (1e3, 1e4, 1e5, 1e6, 1e7)
"""Photo-electrons a second at white."""
NOISES = (2.0, 8.0)
WORTH_IT = 0.1
"""Gain below which a verdict does not count it; dB."""
LINES = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
CAMERAS = (30, 60, 120, 240, 480, 960)
"""Frame rates that cameras have, 1/s."""
CASES = ((1e4, 2.0), (1e4, 8.0), (1e5, 2.0), (1e5, 8.0), (1e6, 2.0), (1e6, 8.0))
"""Light and read noise of the tables."""
SHARES = (1.0, 0.7, 0.5, 0.3)
"""Of a picture that move before a background at rest."""
MOST_SHARE = 1.6
"""Greatest top speed of a sensor that is tried, over that of the objects."""
SPEED, WIDTHS = 3000.0, (512.0, 1024.0, 2048.0)
"""Of an object that is registered, px/s; of sensors, px."""
TEXT = """## One exposure or many

Gain, dB, of the best frames on parabolas, of alternating direction or one slow one, over the best
frames of a camera at rest, both registered without error: nine speeds to 4,500 px/s either way, a
stage that travels 110 px over the burst. A camera may run slower than it can. `0` is less than
0.005 dB.

![Gain of a moving burst by light and frame rate](results/bursts.png)

{maps}

A rule of thumb: how long the best stills would be exposed if nothing limited them, as a share of
the time from frame to frame, tells the gain. Over the {cells} cells of the maps, each at its own
rate:

{rule}

Frames a second at which stills in the same 80 ms are as good as the moving burst, and how many
times as fast that is:

{equals}

Frames without gaps at 1e5 e-/s and 8 e-, each path at its own best top speed, here as a multiple of
that of the objects; acceleration in px/s^2, travel over the burst:

{paths}

Four frames, parabolas of 20 ms and the best stills: the standard deviation of an object's speed
from 4,096 independent samples, at {speed:,.0f} px/s, and what it costs.

{registered}

Gain, dB, of four parabolas of 20 ms over four stills, both the best for nine speeds, over these and
over 65 speeds of the same range:

{speeds}

The level, dB, on a sensor that objects enter and leave, by its width, at 1e5 e-/s and 8 e-:

{widths}

Before a background at rest, without edges, for a decoder that knows both speeds: four frames of
20 ms or less at 1e5 e-/s and 8 e-, by the share of the picture that moves; dB over the best equal
stills:

{backgrounds}
"""


def scene_of(
    light: float, noise: float, burst: BurstMode | None = None, num_speeds: int = 9
) -> Scene:
    """The scene of a camera that may take a burst."""
    limits = Limits(
        max_stroke=TRAVEL,
        max_top_speed=1e5,
        min_half_exposure=5e-5,
        max_half_exposure=WINDOW / 2,
    )
    given = {"photon_rate": light, "read_noise": noise, "limits": limits, "burst": burst}
    return Scene.uniform(max_speed=TOP_SPEED, num_speeds=num_speeds, **given)


def cell(window: float, count: int, light: float, noise: float) -> dict[str, Any]:
    """The best bursts of a camera that takes so many frames within a window."""
    rate = count / window
    burst = BurstMode(frames_per_s=rate, max_frames=count, window=window)
    scene = scene_of(light, noise, burst)
    still = StillBursts(scene).best_within(FrameTimes.of(scene, burst))
    kinds = {
        "alternating parabolas": partial(alternating, count, window / count),
        "one slow parabola": partial(one_parabola, count, window / count),
    }
    found = {name: best_moving(scene, frames, 1 / rate) for name, frames in kinds.items()}
    kind = max(found, key=lambda name: found[name]["moving dB"])
    return {
        "window ms": 1e3 * window,
        "most frames": count,
        "e-/s": light,
        "e-": noise,
        "still frames": still.num_frames,
        "still ms": 1e3 * still.exposure,
        "still dB": still.psnr,
        "path": kind,
        **found[kind],
        "duty": unlimited_exposure(scene, count) * rate,
        # Of a camera that takes as many frames as it likes.
        "equal frames/s": rate_that_equals(
            scene_of(light, noise), window, found[kind]["moving dB"]
        ),
    }


def rate_that_equals(scene: Scene, window: float, psnr: float) -> float | None:
    """The least frame rate at which stills have a level within a window, or None below 10,000 1/s.

    There is none either where one long exposure has the level.
    """
    stills = StillBursts(scene)

    def above(rate: float) -> float:
        times = FrameTimes.of(scene, BurstMode(frames_per_s=rate))._replace(window=window)
        return stills.best_within(times).psnr - psnr

    least, most = 1.0, 1e4
    if above(least) >= 0 or above(most) < 0:
        return None
    return float(root_scalar(above, bracket=(least, most), rtol=1e-9).root)


def alternating(count: int, period: float, half: float, speed: float) -> FrameGroup:
    """Parabolas of some top speed, as far as the stage travels while it coasts between them."""
    speed = min(speed, TRAVEL / (period - half))
    return alternating_frames(count, half, speed / (2 * half))


def one_parabola(count: int, period: float, half: float, speed: float) -> FrameGroup:
    """Frames of one parabola of some top speed, as far as the stage travels."""
    whole = (count - 1) * period / 2 + half
    return sweep_frames(count, half, min(speed, 2 * TRAVEL / whole) / (2 * whole), period)


def best_moving(
    scene: Scene, frames: Callable[[float, float], FrameGroup], period: float
) -> dict[str, Any]:
    """The best frames of a kind, by half exposure and top speed."""

    def frames_at(place: Float[np.ndarray, "2"]) -> FrameGroup:
        return frames(period / 2 * math.exp(-float(place[0])), float(place[1]) * TOP_SPEED)

    bounds = [(0.0, 4.0), (0.3, MOST_SHARE)]
    ends = [frames_at(np.array([x, MOST_SHARE])) for x in bounds[0]]
    plan = reduce(Plan.holding, (sizes(seen_by(scene, each), each.motion) for each in ends))

    def loss(place: Float[np.ndarray, "2"]) -> float:
        return -float(burst_psnr(scene, [frames_at(place)], plan=plan))

    start = min((np.array([x, 1.2]) for x in (0.02, 0.5, 1.2)), key=loss)
    options = {"xatol": 3e-3, "fatol": 1e-4}
    end: Any = minimize(loss, start, method="Nelder-Mead", bounds=bounds, options=options)
    best = frames_at(end.x)
    exposure = float(best.motion.exposure)
    return {"moving ms": 1e3 * exposure, "top speed": float(end.x[1]), "moving dB": -float(end.fun)}


def unlimited_exposure(scene: Scene, num_frames: int) -> float:
    """The best exposure of frames at rest that may be as long as they like; s."""
    stills = StillBursts(scene)
    end: Any = minimize_scalar(
        lambda place: stills.error(num_frames, math.exp(place)),
        bounds=(math.log(1e-5), math.log(2 * WINDOW)),
        method="bounded",
    )
    return math.exp(end.x)


def gains(
    rows: Sequence[dict[str, Any]], window: float, noise: float
) -> Float[np.ndarray, "counts lights"]:
    """Of cameras that take no more frames than each number, dB."""
    chosen = [row for row in rows if row["window ms"] == 1e3 * window and row["e-"] == noise]
    return gains_on_grid({(row["most frames"], row["e-/s"]): row for row in chosen}, COUNTS, LIGHTS)


def gains_on_grid(
    cells: Mapping[tuple[int, float], dict[str, Any]],
    counts: Sequence[int],
    lights: Sequence[float],
) -> Float[np.ndarray, "counts lights"]:
    """Gains of cells by most frames and light: who may take more frames may also take fewer; dB."""

    def best(kind: str) -> Float[np.ndarray, "counts lights"]:
        grid = [[cells[count, light][kind] for light in lights] for count in counts]
        return np.maximum.accumulate(np.array(grid), axis=0)

    return np.maximum(best("moving dB") - best("still dB"), 0.0)


def picture(rows: Sequence[dict[str, Any]]) -> None:
    """The map: light by frame rate, a column for each read noise, in shades of grey."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, 2, figsize=(10, 7.6), sharex=True, layout="constrained")
    drawn: Any = None
    for line, window in zip(panels, WINDOWS, strict=True):
        rates = np.array(COUNTS) / window
        for axes, noise in zip(line, NOISES, strict=True):
            drawn = draw_map(axes, rates, gains(rows, window, noise))
            axes.set_title(
                f"read noise {noise:g} e-, bursts of {1e3 * window:g} ms: "
                f"{TOP_SPEED * window:g} px of way",
                fontsize=10,
            )
        line[0].set_ylabel("frames a second that the camera can take")
    for axes in panels[-1]:
        axes.set_xlabel("photo-electrons a second at a white pixel")
    explain_map(figure, panels, drawn)
    harness.save_picture(figure, "bursts")
    plt.close(figure)


def draw_map(
    axes: Any, rates: Float[np.ndarray, "counts"], gain: Float[np.ndarray, "counts lights"]
) -> Any:
    """One panel of a map: gains by light and frame rate, in dB, on the scale of all maps."""
    import matplotlib.pyplot as plt

    shades = plt.get_cmap("Greys")(np.linspace(0.0, 0.55, len(LINES) + 2))
    levels: list[float] = [-1e-9, WORTH_IT, *LINES]
    lights, between, gain = finer(rates, gain)
    drawn = axes.contourf(lights, between, gain, levels, colors=shades, extend="max")
    axes.contourf(lights, between, gain, levels[:2], colors="none", hatches=["///"])
    axes.contour(lights, between, gain, [WORTH_IT], colors="black", linewidths=2.6)
    lines = axes.contour(lights, between, gain, LINES, colors="black", linewidths=0.8)
    axes.clabel(lines, fmt="%g dB", fontsize=9)
    axes.plot(*(x.ravel() for x in np.meshgrid(LIGHTS, rates)), "k.", markersize=3)
    axes.set(xscale="log", yscale="log")
    inside = [rate for rate in CAMERAS if rates[0] <= rate <= rates[-1]]
    axes.set_yticks(inside, [str(rate) for rate in inside])
    axes.set_yticks([], minor=True)
    return drawn


def explain_map(figure: Any, panels: Any, drawn: Any) -> None:
    """The scale of a map, and its hatched part."""
    from matplotlib.patches import Patch

    bar = figure.colorbar(drawn, ax=panels, ticks=[WORTH_IT, *LINES], shrink=0.7)
    bar.set_label("gain of a sensor that moves over one that stands still, dB")
    enough = Patch(facecolor="white", edgecolor="black", hatch="///", linewidth=2.6)
    words = f"a still burst is enough: less than {WORTH_IT:g} dB"
    figure.legend([enough], [words], loc="outside upper center", frameon=False)


def finer(
    rates: Float[np.ndarray, "counts"], gain: Float[np.ndarray, "counts lights"]
) -> tuple[Float[np.ndarray, "x"], Float[np.ndarray, "y"], Float[np.ndarray, "y x"]]:
    """Lights, rates and gains between the cells, by cubics that do not overshoot them."""
    places = np.log(rates), np.log(LIGHTS)
    between, lights = (np.linspace(x[0], x[-1], 97) for x in places)
    smooth = PchipInterpolator(places[0], gain)(between)
    smooth = PchipInterpolator(places[1], smooth, axis=1)(lights)
    return np.exp(lights), np.exp(between), smooth


def table_of_map(rows: Sequence[dict[str, Any]], window: float) -> str:
    """Gains by light and read noise, over frame rates."""
    of_each = {noise: gains(rows, window, noise) for noise in NOISES}
    shown = [
        {f"{1e3 * window:g} ms": case(light, noise)}
        | {
            f"{count / window:g} frames/s": f"{gain:.2f}" if gain >= 0.005 else "0"
            for count, gain in zip(COUNTS, of_each[noise][:, number], strict=True)
        }
        for number, light in enumerate(LIGHTS)
        for noise in NOISES
    ]
    return harness.table(shown, list(shown[0]))


def case(light: float, noise: float) -> str:
    """Light and read noise, as tables show them."""
    return f"{light:.3g} e-/s, {noise:g} e-".replace("e+0", "e")


def table_of_rule(rows: Sequence[dict[str, Any]]) -> str:
    """The gains over what the duty of the unlimited still exposure is."""
    shown, ends = [], (0.0, 0.1, 0.45, 0.9, 1.2, math.inf)
    gain_of = {
        (1e3 * window, noise, count, light): gain
        for window in WINDOWS
        for noise in NOISES
        for count, each in zip(COUNTS, gains(rows, window, noise), strict=True)
        for light, gain in zip(LIGHTS, each, strict=True)
    }
    for low, high in pairwise(ends):
        gained = [
            gain_of[row["window ms"], row["e-"], row["most frames"], row["e-/s"]]
            for row in rows
            if low <= row["duty"] < high
        ]
        names = {0.0: f"below {high:g}"} | ({low: f"above {low:g}"} if high == math.inf else {})
        few, middle, many = np.round(np.percentile(gained, (10, 50, 90)), 2) + 0.0
        shown.append(
            {
                "share of the period": names.get(low, f"{low:g} to {high:g}"),
                "cells": len(gained),
                "median gain, dB": f"{middle:.2f}",
                "90 % gain at least": f"{few:.2f}",
                "90 % gain at most": f"{many:.2f}",
            }
        )
    return harness.table(shown, list(shown[0]))


def table_of_equals(rows: Sequence[dict[str, Any]]) -> str:
    """Frame rates at which stills do as well, and their ratio to the rate of the moving burst."""
    chosen = [row for row in rows if row["window ms"] == 1e3 * WINDOW]
    levels = {(row["e-/s"], row["e-"], row["most frames"]): row for row in chosen}
    shown = []
    for light, noise in CASES:
        entry = {"light, read noise": case(light, noise)}
        for count in COUNTS:
            rate, equal = count / WINDOW, levels[light, noise, count]["equal frames/s"]
            words = "none" if equal is None else f"{equal:.0f}, {equal / rate:.1f} times"
            entry[f"moving at {rate:g}/s"] = words
        shown.append(entry)
    return harness.table(shown, list(shown[0]))


def paths(light: float, noise: float) -> list[dict[str, Any]]:
    """Each path at its own best amplitude, with what it asks of a stage."""
    scene, rows = scene_of(light, noise), []
    for count in (4, 8, 16):
        period = WINDOW / count
        half = period / 2
        # The frames by their top speed, with acceleration and travel as multiples of it.
        kinds: dict[str, tuple[Callable[[float], FrameGroup], float, float]] = {
            "alternating parabolas": (
                lambda v, n=count, t=half: alternating_frames(n, t, v / (2 * t)),
                1 / half,
                half,
            ),
            "sine at half the frame rate": (
                lambda v, n=count, t=half, p=period: sine_frames(n, t, v * p / np.pi, p),
                np.pi / period,
                2 * period / np.pi,
            ),
            "one slow parabola": (
                lambda v, n=count, t=half, p=period: sweep_frames(n, t, v / WINDOW, p),
                2 / WINDOW,
                WINDOW / 4,
            ),
            "a fan of pans": (
                lambda v, n=count, t=half: panned_frames(n, t, v),
                math.nan,
                fan_travel(count) * period,
            ),
        }
        for name, (frames, acceleration, travel) in kinds.items():
            share, level = best_share(scene, frames)
            speed = share * TOP_SPEED
            rows.append(
                {
                    "frames": count,
                    "path": name,
                    "PSNR dB": level,
                    "top speed": round(share, 2),
                    "acceleration": speed * acceleration,
                    "travel px": speed * travel,
                }
            )
    return rows


def best_share(scene: Scene, frames: Callable[[float], FrameGroup]) -> tuple[float, float]:
    """The best top speed of the frames, as a share of the objects', and its level, dB."""
    most = frames(MOST_SHARE * TOP_SPEED)
    plan = sizes(seen_by(scene, most), most.motion)
    end: Any = minimize_scalar(
        lambda share: -float(burst_psnr(scene, [frames(share * TOP_SPEED)], plan=plan)),
        bounds=(0.5, MOST_SHARE),
        method="bounded",
        options={"xatol": 3e-3},
    )
    return float(end.x), -float(end.fun)


def fan_travel(num_frames: int) -> float:
    """Way of a stage over a fan of pans from the slowest on; periods times the top speed."""
    steps = 2 * (np.arange(num_frames) - (num_frames - 1) / 2) / (num_frames - 1)
    return float(np.ptp(np.cumsum([0.0, *steps])))


def backgrounds(light: float, noise: float) -> list[dict[str, Any]]:
    """Bursts before a background at rest: equal frames, and one long still frame among them."""
    kinds: dict[str, Callable[[float, float, float], list[FrameGroup]]] = {
        "equal stills": lambda long, half, speed: [still_frames(4, half)],
        "one long still, short stills": lambda long, half, speed: [
            still_frames(1, long),
            still_frames(3, half),
        ],
        "equal moving": lambda long, half, speed: [alternating_frames(4, half, speed / half / 2)],
        "one still, the others moving": lambda long, half, speed: [
            still_frames(1, long),
            alternating_frames(3, half, speed / half / 2),
        ],
    }
    rows = []
    for share in SHARES:
        scene = mixed(light, noise, share)
        levels = {name: best_level(scene, frames) for name, frames in kinds.items()}
        rows.append({"share that moves": share} | levels)
    return rows


def mixed(light: float, noise: float, share: float) -> Scene:
    """A picture of which a share moves, at the speeds of the map, and the rest stands still."""
    scene = scene_of(light, noise)
    speeds = np.append(np.asarray(scene.speeds), 0.0)
    weights = np.append(np.asarray(scene.weights) * share, 1 - share)
    return Scene(speeds, weights, photon_rate=light, read_noise=noise, limits=scene.limits)


def best_level(scene: Scene, frames: Callable[[float, float, float], list[FrameGroup]]) -> float:
    """The best level of four frames, dB.

    It is over the half exposure of the long one, that of the others, and the sensor's top speed.
    """
    longest = WINDOW / 8

    def frames_at(place: Float[np.ndarray, "3"]) -> list[FrameGroup]:
        x, y, z = (float(p) for p in place)
        return frames(longest * 0.01**x, longest * 0.01**y, z * TOP_SPEED)

    ends = [each for y in (0, 1) for each in frames_at(np.array([0.0, y, MOST_SHARE]))]
    plan = reduce(Plan.holding, (sizes(seen_by(scene, each), each.motion) for each in ends))
    found = [
        minimize(
            lambda place: -float(burst_psnr(scene, frames_at(place), plan=plan)),
            np.array([0.02, y, 1.2]),
            method="Nelder-Mead",
            bounds=[(0.0, 1.0), (0.0, 1.0), (0.3, MOST_SHARE)],
            options={"xatol": 3e-3, "fatol": 1e-4},
        )
        for y in (0.1, 0.6)
    ]
    return max(-float(end.fun) for end in found)


def pair(light: float, noise: float) -> dict[str, FrameGroup]:
    """Four frames at rest and four that fill the window, at their best."""
    scene, half = scene_of(light, noise), WINDOW / 8
    share, _ = best_share(scene, lambda v: alternating_frames(4, half, v / (2 * half)))
    return {
        "stills": still_frames(4, unlimited_exposure(scene, 4) / 2),
        "parabolas": alternating_frames(4, half, share * TOP_SPEED / (2 * half)),
    }


def in_time(frames: FrameGroup) -> list[TimedFrame]:
    """Four frames over the whole window, of which every other one goes the other way."""
    half, acceleration = (float(x) for x in (frames.motion.half_exposure, frames.motion.bend))
    period = WINDOW / 3 - 2 * half / 3
    back = FreeMotion(accelerations=np.array([-acceleration]), half_exposure=half)
    swing = 2 * acceleration * half * (period - half)
    ways = ((frames.motion, 0.0), (back if acceleration else frames.motion, swing)) * 2
    return [TimedFrame(motion, (k - 1.5) * period, place) for k, (motion, place) in enumerate(ways)]


def registered(light: float, noise: float) -> list[dict[str, Any]]:
    """The least error of the speed of an object in four frames."""
    scene = Scene([SPEED], photon_rate=light, read_noise=noise)
    rows = []
    for name, frames in pair(light, noise).items():
        bound = registration(scene, in_time(frames))
        rows.append(
            {
                "frames": f"{case(light, noise)}, {name}",
                "standard deviation px/s": float(bound.deviation[0]),
                "loss dB": float(bound.loss[0]),
            }
        )
    return rows


def over_speeds(light: float, noise: float) -> dict[str, Any]:
    """The gain of a sensor that moves where speeds are few and where they are many."""
    bursts = pair(light, noise).values()
    scenes = [scene_of(light, noise, num_speeds=number) for number in (9, 65)]
    stills, moving = np.array(
        [[float(burst_psnr(scene, [frames])) for scene in scenes] for frames in bursts]
    )
    few, many = moving - stills
    return {"light, read noise": case(light, noise), "9 speeds": few, "65 speeds": many}


def over_widths(light: float, noise: float) -> list[dict[str, Any]]:
    """Levels on sensors that objects enter and leave."""
    scene, rows = scene_of(light, noise), []
    for name, frames in pair(light, noise).items():
        endless, timed = float(burst_psnr(scene, [frames])), in_time(frames)
        levels = {
            f"{width:g} px": endless - loss_of_width(scene, timed, width=width) for width in WIDTHS
        }
        rows.append({"frames": name} | levels)
    rows.append({"frames": "gain"} | {k: rows[1][k] - rows[0][k] for k in rows[0] if "px" in k})
    return rows


def with_digits(rows: Sequence[dict[str, Any]], digits: int = 2, sign: str = "") -> str:
    """Rows as a table, with so many decimals."""
    texts = [
        {k: f"{x:{sign},.{digits}f}" if isinstance(x, float) else x for k, x in row.items()}
        for row in rows
    ]
    return harness.table(texts, list(texts[0]))


def table_of_backgrounds(rows: Sequence[dict[str, Any]]) -> str:
    """Levels over those of the best equal stills."""
    over = [
        {"share that moves": f"{row['share that moves']:.0%}"}
        | {k: x - row["equal stills"] for k, x in row.items() if k.endswith(("stills", "moving"))}
        for row in rows
    ]
    return with_digits(over, sign="+")


def table_of_paths(rows: Sequence[dict[str, Any]]) -> str:
    """What a stage has to do for each path."""
    texts = [
        row
        | {
            "PSNR dB": f"{row['PSNR dB']:.2f}",
            "acceleration": f"{row['acceleration']:.2e}".replace("e+0", "e").replace("nan", "-"),
            "travel px": f"{row['travel px']:.0f}",
        }
        for row in rows
    ]
    return harness.table(texts, list(texts[0]))


def text_of(rows: Sequence[dict[str, Any]], others: dict[str, list[dict[str, Any]]]) -> str:
    """The section of the results."""
    return TEXT.format(
        maps="\n\n".join(table_of_map(rows, window) for window in WINDOWS),
        cells=len(rows),
        rule=table_of_rule(rows),
        equals=table_of_equals(rows),
        paths=table_of_paths(others["paths"]),
        speed=SPEED,
        registered=with_digits(others["registered"], 4),
        speeds=with_digits(others["speeds"]),
        widths=with_digits(others["widths"]),
        backgrounds=table_of_backgrounds(others["backgrounds"]),
    )


def main() -> None:
    """Measure, store, draw and print."""
    jax.config.update("jax_enable_x64", True)
    start = time.process_time()
    rows = []
    for window in WINDOWS:
        for count in COUNTS:
            rows += [cell(window, count, light, noise) for light in LIGHTS for noise in NOISES]
            print(f"{count} frames: {time.process_time() - start:.0f} s", file=sys.stderr)
    picture(rows)
    others = {
        "paths": paths(1e5, 8.0),
        "registered": [*registered(1e5, 8.0), *registered(1e4, 8.0)],
        "speeds": [over_speeds(*each) for each in CASES],
        "widths": over_widths(1e5, 8.0),
        "backgrounds": backgrounds(1e5, 8.0),
    }
    harness.write("bursts", rows, processor_s=time.process_time() - start, **others)
    harness.section("bursts", text_of(rows, others))


if __name__ == "__main__":
    main()
