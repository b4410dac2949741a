"""Pictures of sweeps: maps over acceleration and exposure, and Pareto fronts.

Grey values carry the maps, so that they survive a grey printout.
"""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mishutter.design import shutter_from_dict
from mishutter.plots import save_figure
from mishutter.scene import Scene
from mishutter.shutters import SplineShutter
from mishutter.sweep_grid import METRICS, OPTIMISED
from mishutter.trade_offs import OBJECTIVES, gain_over_snapshot, pareto_front
from mishutter.types import require

if TYPE_CHECKING:
    import xarray

_MARKERS = "os^Dvp*XP<>h"
_OF_ALL = "the best shutter"


def write_pictures(dataset: "xarray.Dataset", scene: Scene, folder: Path) -> list[str]:
    """Every picture of a sweep, in a folder; their names.

    Raises:
        OSError: if one cannot be written.
    """
    gain = gain_over_snapshot(dataset, scene)
    widened = dataset.assign(gain_over_snapshot=gain)
    figures = {
        "map.png": plot_map(widened, "gain_over_snapshot"),
        "pareto.png": plot_front(dataset, ("condition_number", "expected_psnr")),
    }
    for name, figure in figures.items():
        save_figure(figure, folder / name)
    return list(figures)


def plot_map(
    dataset: "xarray.Dataset", metric: str = "expected_psnr", *, shutter: str | None = None
) -> Figure:
    """A metric over acceleration and exposure, with the optimum marked.

    Dashed lines join points of equal stroke in px, dotted ones points of equal top speed
    in px/s. Hatched is outside the limits.

    Args:
        dataset: What `sweep` returned, of one scene and light.
        metric: A variable of it.
        shutter: Of which shutter; of the best at each point by default.

    Raises:
        ValueError: if the grid is a single row or the metric is not in the dataset.
    """
    require(metric in dataset, "plot_map(metric=...)", "be in the sweep", metric)
    enough = dataset.acceleration.size > 1 and dataset.half_exposure.size > 1
    require(enough, "plot_map(dataset=...)", "have rows and columns", dict(dataset.sizes))
    smaller = not OBJECTIVES.get(metric, True)
    values = dataset[metric] if shutter is None else dataset[metric].sel(shutter=shutter)
    if shutter is None:
        values = values.min("shutter") if smaller else values.max("shutter")
    values = values.transpose("acceleration", "half_exposure").values
    a, half = dataset.acceleration.values, dataset.half_exposure.values * 1e3
    moving = a > 0
    a, values = a[moving], values[moving]
    figure = Figure(figsize=(7.0, 5.4), layout="constrained")
    axes = figure.subplots()
    shown = np.ma.masked_invalid(values)
    picture = axes.pcolormesh(half, a, shown, cmap="gray", shading="nearest", rasterized=True)
    axes.patch.set(hatch="///", edgecolor="0.6", facecolor="0.95")
    _scale(axes, half, a)
    _contours(axes, half, a)
    label, unit = METRICS.get(metric, (metric.replace("_", " "), "dB"))
    figure.colorbar(picture, ax=axes, label=label if unit == "1" else f"{label} / {unit}")
    if np.any(np.isfinite(values)):
        index = np.nanargmin(values) if smaller else np.nanargmax(values)
        row, column = np.unravel_index(index, values.shape)
        style = {"marker": "*", "markersize": 17, "color": "white", "markeredgecolor": "black"}
        best = f"best: {values[row, column]:.3g}"
        axes.plot(half[column], a[row], linestyle="none", label=best, **style)
        axes.legend(loc="lower left")
    axes.set_title(f"{label}, {shutter or _OF_ALL}", fontsize="medium")
    axes.set(xlabel="half exposure $T$ / ms", ylabel="acceleration $a$ / (px/s²)")
    return figure


def _scale(axes: Axes, half: np.ndarray, a: np.ndarray) -> None:
    """Logarithmic axes where the values spread over more than their mean."""
    if a[-1] > 8 * a[0]:
        axes.set_yscale("log")
    if half[-1] > 8 * half[0]:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.xaxis.set_minor_formatter(
            lambda value, _: f"{value:g}" if f"{value:e}"[0] in "235" else ""
        )


def _contours(axes: Axes, half: np.ndarray, a: np.ndarray) -> None:
    """Lines of equal stroke and of equal top speed, labelled, over the whole map."""
    limits = axes.axis()
    x = np.geomspace(half[0], half[-1], 200)
    y = np.geomspace(a[0], a[-1], 200)
    stroke = y[:, None] * (x[None] * 1e-3) ** 2
    speed = 2 * y[:, None] * x[None] * 1e-3
    for values, style, unit in ((stroke, "dashed", "px"), (speed, "dotted", "px/s")):
        decades = np.arange(np.floor(np.log10(values.min())), np.ceil(np.log10(values.max())) + 1)
        levels = [10.0**d * m for d in decades for m in ((1, 3) if decades.size < 5 else (1,))]
        for colour, width in (("white", 2.4), ("black", 1.0)):
            lines = axes.contour(
                x, y, values, levels, colors=colour, linestyles=style, linewidths=width
            )
        marks = axes.clabel(lines, fmt=lambda v, unit=unit: f"{v:g} {unit}", fontsize=8)
        for mark in marks:
            mark.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8})
    axes.axis(limits)


def plot_front(
    dataset: "xarray.Dataset", objectives: tuple[str, str], *, num_profiles: int = 4
) -> Figure:
    """What cannot be had together: every point, the Pareto front, profiles along it.

    Args:
        dataset: What `sweep` returned, of one scene and light.
        objectives: Metrics on the axes.
        num_profiles: Points of the front whose profiles are drawn beneath.
    """
    first, second = objectives
    front = pareto_front(dataset, objectives)
    figure = Figure(figsize=(7.0, 7.0), layout="constrained")
    grid = figure.add_gridspec(2, num_profiles, height_ratios=(3, 1))
    axes = figure.add_subplot(grid[0, :])
    names = [str(name) for name in dataset.shutter.values]
    for index, name in enumerate(names):
        some = dataset.sel(shutter=name)
        axes.plot(
            some[first].values.ravel(),
            some[second].values.ravel(),
            linestyle="none",
            marker=_MARKERS[index % len(_MARKERS)],
            markersize=3,
            color=str(0.35 + 0.45 * index / max(1, len(names) - 1)),
            label=name,
        )
    axes.step(front[first], front[second], color="black", linewidth=1.6, label="Pareto front")
    ends = front[first].values
    if ends.size and ends.min() > 0 and ends.max() > 30 * ends.min():
        axes.set_xscale("log")
    axes.set(xlabel=_label(first), ylabel=_label(second))
    axes.grid(True, color="0.88", linewidth=0.6)
    axes.legend(fontsize="small", markerscale=2)
    shown = np.unique(np.linspace(0, front.sizes["point"] - 1, num_profiles).round().astype(int))
    tau = np.linspace(-1, 1, 401)
    for column, index in enumerate(shown):
        point = front.isel(point=int(index))
        name = str(point.shutter.values)
        letter = "ABCDEFGH"[column]
        place = (float(point[first]), float(point[second]))
        axes.plot(*place, marker="o", markersize=7, color="white", markeredgecolor="black")
        axes.annotate(letter, place, (5, 6), textcoords="offset points", weight="bold")
        panel = figure.add_subplot(grid[1, column])
        half = float(point.half_exposure) * 1e3
        transmittance = np.pad(_transmittance(dataset, point, tau), 1)
        panel.plot(np.pad(tau, 1, "edge") * half, transmittance, color="black")
        panel.set(ylim=(-0.05, 1.1), xlabel="time / ms")
        stroke = float(point.acceleration) * float(point.half_exposure) ** 2
        panel.set_title(f"{letter}: {name}\n{stroke:.3g} px stroke", fontsize="small")
        panel.tick_params(labelleft=column == 0, labelsize="small")
    return figure


def _transmittance(
    dataset: "xarray.Dataset", point: "xarray.Dataset", tau: np.ndarray
) -> np.ndarray:
    """Profile of a point of a sweep, from what the sweep says of its shutters."""
    name = str(point.shutter.values)
    if name == OPTIMISED:
        return np.asarray(SplineShutter(point.coefficients.values).transmittance(tau))
    described = json.loads(dataset.attrs["sweep"])["shutters"][name]
    if "transmittance" in described:
        samples = np.array(described["transmittance"])
        return np.interp(tau, np.linspace(-1, 1, samples.size), samples)
    return np.asarray(shutter_from_dict(described).transmittance(tau))


def _label(name: str) -> str:
    text, unit = METRICS[name]
    return text if unit == "1" else f"{text} / {unit}"
