"""Pictures of sweeps: maps over acceleration and exposure, and Pareto fronts.

Maps are in colours that rise from dark to light, and fronts differ in markers and dashes, so that
both survive a grey printout.
"""

import json
from collections.abc import Callable
from itertools import cycle, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

from mishutter._core import require, require_positive_int
from mishutter.hardware import shutter_from_dict
from mishutter.model import Scene, SplineShutter
from mishutter.report.plots import (
    MAP_COLOURS,
    Drawing,
    draw_grid,
    line_styles,
    save_figure,
    shown_name,
)
from mishutter.sweeps import OBJECTIVES, OPTIMISED, gain_over_snapshot, pareto_front

if TYPE_CHECKING:
    import xarray

_MARKERS = "os^Dvp*XP<>h"
_OF_ALL = "the best shutter"
_GAIN = "gain over "
"""What the name of a gain in a sweep begins with; its rival follows."""
_LEAST_LINE = 0.35
"""Length of a line that has room for its label, in widths of the axes."""
_DECADES = 3
"""Of strokes and of top speeds, below the largest."""
_EXPOSURE = "half exposure $T$ / ms"
_ACCELERATION = "acceleration $a$ / (px/s²)"
_LETTERS = 20
"""Of a name, at most."""
_APART = 0.07
"""Least distance of two labelled points of a front, in widths of the axes."""


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

    Dashed lines join points of equal stroke, dotted ones points where the sensor gains as much
    speed, $2aT$, within the decades below the largest that were reached. Of a gain the colour in
    the middle is 0 dB, and a line runs there. Of several velocities each point has the best.
    Hatched is outside the limits. A sensor that does not accelerate is left out, and so are rows
    and columns that are wholly outside. A single row or column is a line of points.

    Args:
        dataset: What `sweep` returned, of one scene and light.
        metric: A variable of it.
        shutter: Of which shutter; of the best at each point by default.

    Raises:
        ValueError: if the metric or the shutter is not in the dataset, it is of several
            scenes or lights, or no point is within the limits.
    """
    smaller = not OBJECTIVES.get(metric, True)
    values = _values(dataset, metric, shutter, smaller)
    within = ~np.isnan(values)
    reached = bool(np.any(within))
    require(reached, "plot_map(dataset=...)", "reach a point within the limits", "none")
    rows, columns = np.any(within, axis=1), np.any(within, axis=0)
    a, half = dataset.acceleration.values[rows], dataset.half_exposure.values[columns] * 1e3
    values = values[rows][:, columns]
    if min(values.shape) > 1:
        a, values = a[a > 0], values[a > 0]
    figure = Drawing(figsize=(7.0, 5.4), layout="constrained")
    axes = figure.subplots()
    draw = _draw_map if min(values.shape) > 1 else _draw_line
    rival = _text(dataset, metric).partition(_GAIN)[2]
    x, y = draw(axes, half, a, values, _label(dataset, metric), rival)
    best = np.nanargmin(values) if smaller else np.nanargmax(values)
    star = {"marker": "*", "markersize": 17, "color": "white", "markeredgecolor": "black"}
    axes.plot(x.flat[best], y.flat[best], clip_on=False, zorder=5, **star)
    unit = _unit(dataset, metric)
    title = f"{_text(dataset, metric)}, {shutter or _OF_ALL}"
    title += " at its best velocity" if "velocity" in dataset[metric].dims else ""
    title += f"\n☆ best: {values.flat[best]:.3g} {'' if unit == '1' else unit}"
    axes.set_title(title, fontsize="medium", pad=10)
    return figure


def _values(
    dataset: "xarray.Dataset", metric: str, shutter: str | None, smaller: bool
) -> np.ndarray:
    """A metric of one shutter, or of the best at each point and velocity; shape `(a, t)`."""
    require(metric in dataset, "plot_map(metric=...)", "be in the sweep", metric)
    values = dataset[metric]
    names = [str(name) for name in dataset.shutter.values]
    known = shutter is None or shutter in names
    require(known, "plot_map(shutter=...)", f"be one of {', '.join(names)}", shutter)
    if "shutter" in values.dims:
        values = values if shutter is None else values.sel(shutter=shutter)
    several = [name for name in ("velocity", "shutter") if name in values.dims]
    values = values.min(several) if smaller else values.max(several)
    one = set(values.dims) == {"acceleration", "half_exposure"}
    require(one, "plot_map(dataset=...)", "be of one scene and light", dict(values.sizes))
    return values.transpose("acceleration", "half_exposure").values


def _draw_map(
    axes: Axes, half: np.ndarray, a: np.ndarray, values: np.ndarray, label: str, rival: str
) -> tuple[np.ndarray, np.ndarray]:
    """Colours over acceleration and exposure; where on the axes each of them is."""
    _scale(axes.set_xscale, axes.xaxis, half)
    _scale(axes.set_yscale, axes.yaxis, a)
    x, y = _edges(half, axes.get_xscale()), _edges(a, axes.get_yscale())
    shown = np.ma.masked_invalid(values)
    norm = _about_zero(shown) if rival else None
    picture = axes.pcolormesh(x, y, shown, cmap=MAP_COLOURS, norm=norm, rasterized=True)
    axes.patch.set(hatch="///", edgecolor="0.6", facecolor="0.95")
    _contours(axes, half, a, ~np.isnan(values))
    if rival:
        _draw_level(axes, half, a, shown, rival)
    axes.figure.colorbar(picture, ax=axes, label=label, ticks=_ticks(norm))
    axes.set(xlabel=_EXPOSURE, ylabel=_ACCELERATION)
    x, y = np.meshgrid(half, a)
    return x, y


def _about_zero(values: np.ma.MaskedArray) -> Normalize:
    """Colours of which the middle is 0, each half as long as values on its side need."""
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 0.0)
    both = low < 0 < high
    return TwoSlopeNorm(0, low, high) if both else Normalize(low, high)


def _ticks(norm: Normalize | None) -> list[float] | None:
    """Round numbers on both sides of a scale about 0; None for those of any other."""
    if not isinstance(norm, TwoSlopeNorm) or norm.vmin is None or norm.vmax is None:
        return None
    ends = norm.vmin, 0.0, norm.vmax
    ticks = np.concatenate([MaxNLocator(5).tick_values(*half) for half in pairwise(ends)])
    return sorted({tick for tick in ticks.tolist() if ends[0] <= tick <= ends[2]})


def _draw_level(
    axes: Axes, half: np.ndarray, a: np.ndarray, gain: np.ma.MaskedArray, rival: str
) -> None:
    """A line where a gain is 0 dB, and its name below the map; none where it is 0 nowhere."""
    if not gain.min() < 0 < gain.max():
        return
    limits = axes.axis()
    for colour, width in (("white", 4.0), ("black", 2.2)):
        axes.contour(half, a, gain, [0.0], colors=colour, linewidths=width)
    axes.plot([], [], color="black", linewidth=2.2, label=_as_good(rival))
    axes.axis(limits)
    axes.figure.legend(loc="outside lower center", fontsize="small")


def _as_good(rival: str) -> str:
    article = "the " if rival.startswith("best ") else ""
    return f"0 dB: as good as {article}{rival}"


def _edges(values: np.ndarray, scale: str) -> np.ndarray:
    """Edges of cells around values, half-way between them on their axis: on it all of them."""
    along = np.log(values) if scale == "log" else values
    middles = along[:-1] + np.diff(along) / 2
    edges = np.concatenate([2 * along[:1] - middles[:1], middles, 2 * along[-1:] - middles[-1:]])
    return np.exp(edges) if scale == "log" else edges


def _draw_line(
    axes: Axes, half: np.ndarray, a: np.ndarray, values: np.ndarray, label: str, rival: str
) -> tuple[np.ndarray, np.ndarray]:
    """A single row or column as a line of points; where on the axes each of them is."""
    row = a.size == 1
    x, y = half if row else a, values.ravel()
    axes.plot(x, y, marker="o", markersize=4, color="black")
    if rival:
        axes.axhline(0, color="0.3", linestyle="dashed", label=_as_good(rival))
        axes.legend(fontsize="small")
    draw_grid(axes)
    _scale(axes.set_xscale, axes.xaxis, x)
    at = f"{_EXPOSURE}, at $a$ = {a[0]:.4g} px/s²"
    axes.set(xlabel=at if row else f"{_ACCELERATION}, at $T$ = {half[0]:.4g} ms", ylabel=label)
    return x, y


def _on_axes(axes: Axes, places: np.ndarray) -> np.ndarray:
    """Places of data as shares of the axes' width and height; shape `(n, 2)`."""
    axes.axis()
    return (axes.transData - axes.transAxes).transform(places)


def _scale(set_scale: Callable[[str], None], axis: Axis, values: np.ndarray) -> None:
    """A logarithmic axis where positive values spread over more than their mean."""
    known = values[np.isfinite(values)]
    if not known.size or known.min() <= 0 or known.max() <= 8 * known.min():
        return
    set_scale("log")
    if known.min() >= 1e-3 and known.max() < 1e5:
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        shown = "235" if known.max() < 100 * known.min() else ""
        axis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in shown else "")


def _contours(axes: Axes, half: np.ndarray, a: np.ndarray, within: np.ndarray) -> None:
    """Lines of equal stroke and of equal top speed, labelled, some decades below the largest."""
    limits = axes.axis()
    x, y = (np.geomspace(values[0], values[-1], 200) for values in (half, a))
    for name, style, unit, along, powers in (
        ("stroke", "dashed", "px", 0.25, lambda t, a: a + 2 * t),
        ("top speed", "dotted", "px/s", 0.75, lambda t, a: np.log10(2) + a + t),
    ):
        reached = powers(np.log10(half * 1e-3), np.log10(a)[:, None])[within]
        last = int(np.floor(reached.max()))
        first = max(last - _DECADES + 1, int(np.floor(reached.min())))
        texts = {
            decade + np.log10(share): f"{name} {float(f'{share}e{decade}'):g} {unit}"
            for decade in range(first, last + 1)
            for share in ((1, 2, 5) if last - first < _DECADES - 1 else (1,))
        }
        values = powers(np.log10(x * 1e-3), np.log10(y)[:, None])
        places = _middles(axes, x, y, values, list(texts), along)
        if not places:
            continue
        for colour, width in (("white", 2.4), ("black", 1.0)):
            lines = axes.contour(
                x, y, values, list(places), colors=colour, linestyles=style, linewidths=width
            )
        marks = axes.clabel(lines, fmt=texts, fontsize=8, manual=list(places.values()))
        for mark in marks:
            mark.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8})
    axes.axis(limits)


def _middles(
    axes: Axes, x: np.ndarray, y: np.ndarray, values: np.ndarray, levels: list[float], along: float
) -> dict[float, tuple[float, float]]:
    """Places on the lines that are long enough for a label, a share of them along; by level."""
    within = [level for level in levels if values.min() < level < values.max()]
    if not within:
        return {}
    drawn = axes.contour(x, y, values, within)
    found = {}
    for level, parts in zip(within, drawn.allsegs, strict=True):
        line = max(parts, key=len)
        ends = _on_axes(axes, line[[0, -1]])
        if np.hypot(*(ends[1] - ends[0])) > _LEAST_LINE:
            found[level] = tuple(line[int(along * (len(line) - 1))])
    drawn.remove()
    return found


def plot_front(
    dataset: "xarray.Dataset", objectives: tuple[str, str], *, num_profiles: int = 4
) -> Figure:
    """Metrics that exclude one another: the Pareto front of each shutter, and of all.

    Grey dots are the other points, as far as they lie between the fronts. Beneath are profiles
    along the front of all.

    Args:
        dataset: What `sweep` returned, of one scene and light.
        objectives: Metrics on the axes.
        num_profiles: Points of the front whose profiles are drawn beneath, at most.

    Raises:
        ValueError: if an objective is not a metric of the sweep, or no profile is asked for.
    """
    require_positive_int("plot_front(num_profiles=...)", num_profiles)
    front = pareto_front(dataset, objectives)
    places = np.stack([front[name].values for name in objectives], axis=1)
    finite = np.all(np.isfinite(places), axis=1)
    front, places = front.isel(point=finite), places[finite]
    figure = Drawing(figsize=(7.0, 7.0), layout="constrained")
    rows = figure.add_gridspec(2, 1, height_ratios=(3, 1))
    axes = figure.add_subplot(rows[0])
    _draw_points(axes, dataset, objectives)
    band = {"color": "0.87", "linewidth": 7, "zorder": 1.5, "solid_capstyle": "butt"}
    axes.step(*places.T, label="front of all", **band)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    shown = _spread(_on_axes(axes, places), num_profiles)
    columns = rows[1].subgridspec(1, max(1, len(shown)))
    for column, index in enumerate(shown):
        letter = chr(ord("A") + column)
        axes.plot(*places[index], marker="o", markersize=7, color="white", markeredgecolor="black")
        around = {"path_effects": [withStroke(linewidth=3, foreground="white")], "weight": "bold"}
        axes.annotate(letter, places[index], (5, 6), textcoords="offset points", **around)
        panel = figure.add_subplot(columns[column])
        _draw_profile(panel, dataset, front.isel(point=index), letter)
        panel.set_ylabel("transmittance" if column == 0 else "", fontsize="small")
        panel.tick_params(labelleft=column == 0, labelsize="small")
    return figure


def _draw_points(axes: Axes, dataset: "xarray.Dataset", objectives: tuple[str, str]) -> None:
    """The Pareto front of each shutter in a marker of its own, over the points of all."""
    names = [str(name) for name in dataset.shutter.values]
    fronts = [pareto_front(dataset.sel(shutter=[name]), objectives) for name in names]
    scales = (axes.set_xscale, axes.xaxis), (axes.set_yscale, axes.yaxis)
    for objective, scale in zip(objectives, scales, strict=True):
        if _unit(dataset, objective) != "dB":
            _scale(*scale, np.concatenate([front[objective].values for front in fronts]))
    for name, front, marker, style in zip(names, fronts, cycle(_MARKERS), line_styles()):
        x, y = (front[objective].values for objective in objectives)
        marks: dict[str, Any] = {"marker": marker, "markersize": 6, "fillstyle": "none"}
        marks |= {"markevery": 0.04, "drawstyle": "steps", "label": shown_name(name, _LETTERS)}
        marks |= style | {"linewidth": 1.2}
        axes.plot(x, y, **marks)
    limits = axes.axis()
    x, y = (dataset[objective].values.ravel() for objective in objectives)
    axes.plot(x, y, ".", markersize=2, color="0.6", zorder=1, label="other points")
    axes.axis(limits)
    xlabel, ylabel = (_label(dataset, objective) for objective in objectives)
    axes.set(xlabel=xlabel, ylabel=ylabel)
    draw_grid(axes)


def _spread(places: np.ndarray, count: int) -> list[int]:
    """Some of the points of a line, evenly along it and none beside another."""
    steps = np.hypot(*np.diff(places, axis=0).T)
    along = np.cumsum(np.append(0, steps))[: len(places)]
    kept: list[int] = []
    for length in np.linspace(0, along[-1:].sum(), count) if len(places) else ():
        index = int(np.argmin(np.abs(along - length)))
        if not kept or along[index] - along[kept[-1]] >= _APART:
            kept.append(index)
    return kept


def _draw_profile(
    axes: Axes, dataset: "xarray.Dataset", point: "xarray.Dataset", letter: str
) -> None:
    """The profile of a point of a sweep over its exposure."""
    tau = np.linspace(-1, 1, 401)
    half = float(point.half_exposure) * 1e3
    transmittance = np.pad(_transmittance(dataset, point, tau), 1)
    axes.plot(np.pad(tau, 1, "edge") * half, transmittance, color="black")
    axes.set(ylim=(-0.05, 1.1))
    axes.set_xlabel("time / ms", fontsize="small")
    axes.locator_params(axis="x", nbins=4)
    stroke = float(point.acceleration) * float(point.half_exposure) ** 2
    name = shown_name(str(point.shutter.values), _LETTERS)
    axes.set_title(f"{letter}: {name}\n{stroke:.3g} px stroke", fontsize="small")


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


def _text(dataset: "xarray.Dataset", name: str) -> str:
    return str(dataset[name].attrs.get("long_name", name.replace("_", " ")))


def _unit(dataset: "xarray.Dataset", name: str) -> str:
    return str(dataset[name].attrs.get("units", "1"))


def _label(dataset: "xarray.Dataset", name: str) -> str:
    text, unit = _text(dataset, name), _unit(dataset, name)
    return text if unit == "1" else f"{text} / {unit}"
