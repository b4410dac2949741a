"""Pictures of sweeps: maps over acceleration and exposure, and Pareto fronts.

Colours of maps rise from dark to light, and fronts differ in markers and dashes, so that both
survive a grey printout.
"""

import json
from collections.abc import Callable
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import require, require_positive_int
from mishutter.model.shutters.kinds import shutter_from_dict
from mishutter.model.shutters.spline import SplineShutter
from mishutter.report.plots import (
    LINE,
    MAP_COLOURS,
    draw_grid,
    leave_room,
    legend_above,
    line_styles,
    new_figure,
    save_figure,
    shown_name,
)
from mishutter.sweeps.grid import OPTIMISED
from mishutter.sweeps.trade_offs import is_higher_better, level_of, pareto_front

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.contour import QuadContourSet
    from matplotlib.figure import Figure

Place = tuple[float, float]

_DECADES = 3
"""Number of decades of sags and of gains in speed that have lines."""
_EXPOSURE = "exposure / ms"
_ACCELERATION = "acceleration of the stage / (px/s²)"
_LETTERS = 20
"""Most letters of a name."""


class _Map(NamedTuple):
    """Values over exposure and acceleration, and their names."""

    exposure: Float[np.ndarray, "t"]  # Exposures, from first to last light; ms
    acceleration: Float[np.ndarray, "a"]  # Those of the stage, twice the `a`; px/s^2
    values: Float[np.ndarray, "a t"]  # The metric; NaN outside the limits
    label: str  # Name and unit of the metric
    rival: str  # The rival that a gain is over; empty for a metric that is no gain
    pans: bool  # Whether any design pans: its stroke is then more than its sag

    def in_colours(self, axes: "Axes") -> tuple[np.ndarray, np.ndarray]:
        """Draws it in colours; returns the places of its values on the axes."""
        from matplotlib.colors import Normalize

        exposure, acceleration, values, label, rival, pans = self
        _scale(axes.set_xscale, axes.xaxis, exposure)
        _scale(axes.set_yscale, axes.yaxis, acceleration)
        x = _edges(exposure, axes.get_xscale())
        y = _edges(acceleration, axes.get_yscale())
        shown = np.ma.masked_invalid(values)
        low, high = float(shown.min()), float(shown.max())
        # Colours of gains go from the highest down to its opposite, or to the lowest.
        darkest = max(low, -high) if rival and high > 0 else low
        norm = Normalize(darkest, high)
        picture = axes.pcolormesh(x, y, shown, cmap=MAP_COLOURS, norm=norm, rasterized=True)
        axes.patch.set(hatch="///", edgecolor="0.6", facecolor="0.95")
        _contours(axes, exposure, acceleration, ~np.isnan(values), pans)
        if rival and low < 0 < high:
            limits = axes.axis()
            for colour, width in (("white", 4.0), ("black", 2.2)):
                axes.contour(exposure, acceleration, shown, [0.0], colors=colour, linewidths=width)
            axes.plot([], [], color="black", linewidth=2.2, label=_as_good(rival))
            axes.axis(limits)
            axes.figure.legend(loc="lower center", fontsize="small")
        extend = "min" if low < darkest else "neither"
        axes.figure.colorbar(picture, ax=axes, label=label, extend=extend)
        axes.set(xlabel=_EXPOSURE, ylabel=_ACCELERATION)
        x, y = np.meshgrid(exposure, acceleration)
        return x, y

    def as_line(self, axes: "Axes") -> tuple[np.ndarray, np.ndarray]:
        """Draws a single row or column as a line; returns the places of its points on the axes."""
        exposure, acceleration, values, label, rival, _ = self
        row = acceleration.size == 1
        x, y = exposure if row else acceleration, values.ravel()
        axes.plot(x, y, marker="o", markersize=4, color="black")
        if rival:
            axes.axhline(0, color="black", linestyle="dashed", label=_as_good(rival))
            axes.legend(fontsize="small")
        draw_grid(axes)
        _scale(axes.set_xscale, axes.xaxis, x)
        along = f"{_EXPOSURE}, at {acceleration[0]:.4g} px/s²"
        across = f"{_ACCELERATION}, at {exposure[0]:.4g} ms"
        axes.set(xlabel=along if row else across, ylabel=label)
        return x, y


def write_pictures(dataset: "xarray.Dataset", level: str, folder: Path) -> list[str]:
    """Writes every picture of a sweep and its `over_snapshot` to a folder; returns their names."""
    figures = {
        "map.png": plot_map(dataset, "over_snapshot"),
        "pareto.png": plot_front(dataset, ("condition_number", level)),
    }
    for name, figure in figures.items():
        save_figure(figure, folder / name)
    return list(figures)


def plot_map(
    dataset: "xarray.Dataset", metric: str | None = None, *, shutter: str | None = None
) -> "Figure":
    """Draws a metric over acceleration and exposure, with the optimum marked.

    The title says where the best is. Dashed lines join points of equal sag, $aT^2$, and dotted
    lines points of equal gain in speed, $2aT$, within some decades below the largest: stroke and
    top speed of a sensor that does not pan. On a map of a gain a line marks 0 dB, and losses
    greater than the greatest gain have the darkest colour. Each point has the best of all
    velocities. Hatched points are outside the limits. The map omits a sensor that does not
    accelerate, and rows and columns wholly outside the limits. A single row or column becomes a
    line of points.

    Args:
        dataset: The result of `sweep`, of one scene and light.
        metric: A variable of it; the level of its decoder by default.
        shutter: The shutter to draw; the best at each point by default.

    Raises:
        ValueError: if the metric or the shutter is not in the dataset, it is of several
            scenes or lights, or no point is within the limits.
    """
    metric = level_of("plot_map(dataset=...)", dataset) if metric is None else metric
    smaller = not is_higher_better(metric)
    values = _values(dataset, metric, shutter, smaller)
    within = ~np.isnan(values)
    reached = bool(np.any(within))
    require(reached, "plot_map(dataset=...)", "reach a point within the limits", "none")
    rows, columns = np.any(within, axis=1), np.any(within, axis=0)
    a, half = dataset.acceleration.values[rows], dataset.half_exposure.values[columns]
    values = values[rows][:, columns]
    if min(values.shape) > 1:
        a, values = a[a > 0], values[a > 0]
    figure = new_figure(7.0, 5.4)
    room = {"left": 0.95, "right": 0.75, "top": 0.65}  # the bar of colours stands within it
    leave_room(figure, num_rows=1, num_columns=1, **room)
    axes = figure.subplots()
    rival = _text(dataset, metric).partition("gain over ")[2]
    drawn = _Map(2e3 * half, 2 * a, values, _label(dataset, metric), rival, _pans(dataset))
    x, y = drawn.in_colours(axes) if min(values.shape) > 1 else drawn.as_line(axes)
    if figure.legends:  # below the map
        leave_room(figure, num_rows=1, num_columns=1, bottom=0.85, **room)
    best = int(np.nanargmin(values) if smaller else np.nanargmax(values))
    axes.plot(
        x.flat[best],
        y.flat[best],
        clip_on=False,
        zorder=5,
        marker="*",
        markersize=17,
        color="white",
        markeredgecolor="black",
    )
    unit = _unit(dataset, metric)
    title = f"{_text(dataset, metric)}, {shutter or 'by the best shutter'}"
    title += " at its best velocity" if "velocity" in dataset[metric].dims else ""
    of_best = dataset[metric].sel(
        acceleration=a[best // half.size], half_exposure=half[best % half.size]
    )
    title += f"\n☆ best: {values.flat[best]:.3g}{'' if unit == '1' else f' {unit}'}"
    title += f", {_place(of_best, shutter, smaller)}"
    axes.set_title(title, fontsize="medium", pad=10)
    return figure


def _place(values: "xarray.DataArray", shutter: str | None, smaller: bool) -> str:
    """The shutter, pan, exposure, acceleration and sag of the best of some values, in words."""
    if shutter is not None and "shutter" in values.dims:
        values = values.sel(shutter=shutter)
    best = values[values.argmin(...) if smaller else values.argmax(...)]
    a, half = float(best.acceleration), float(best.half_exposure)
    velocity = float(best.velocity) if "velocity" in best.coords else 0.0
    words = [f"{2e3 * half:.3g} ms", f"{2 * a:.3g} px/s²"]
    words += [f"pan {velocity:.4g} px/s"] if velocity else []
    words += [f"{'sag' if velocity else 'stroke'} {a * half**2:.3g} px"]
    is_one = shutter is not None or "shutter" not in best.coords
    name = [] if is_one else [shown_name(str(best.shutter.values), _LETTERS)]
    return ", ".join([*name, *words])


def _values(
    dataset: "xarray.Dataset", metric: str, shutter: str | None, smaller: bool
) -> Float[np.ndarray, "a t"]:
    """A metric of one shutter, or of the best at each point and velocity."""
    require(metric in dataset, "plot_map(metric=...)", "be in the sweep", metric)
    values = dataset[metric]
    names = [str(name) for name in dataset.shutter.values]
    is_there = shutter is None or shutter in names
    require(is_there, "plot_map(shutter=...)", f"be one of {', '.join(names)}", shutter)
    if "shutter" in values.dims:
        values = values if shutter is None else values.sel(shutter=shutter)
    several = [name for name in ("velocity", "shutter") if name in values.dims]
    values = values.min(several) if smaller else values.max(several)
    one = set(values.dims) == {"acceleration", "half_exposure"}
    require(one, "plot_map(dataset=...)", "be of one scene and light", dict(values.sizes))
    return values.transpose("acceleration", "half_exposure").values


def _as_good(rival: str) -> str:
    article = "the " if rival.startswith("best ") else ""
    return f"0 dB: as good as {article}{rival}"


def _edges(values: np.ndarray, scale: str) -> np.ndarray:
    """Edges of cells around values, half-way between them on a linear or logarithmic axis."""
    along = np.log(values) if scale == "log" else values
    middles = along[:-1] + np.diff(along) / 2
    edges = np.concatenate([2 * along[:1] - middles[:1], middles, 2 * along[-1:] - middles[-1:]])
    return np.exp(edges) if scale == "log" else edges


def _on_axes(axes: "Axes", places: np.ndarray) -> np.ndarray:
    """Converts places of data to shares of the axes' width and height; shape `(n, 2)`."""
    axes.axis()
    return (axes.transData - axes.transAxes).transform(places)


def _scale(set_scale: Callable[[str], None], axis: "Axis", values: np.ndarray) -> None:
    """Makes an axis logarithmic if its values are positive and differ more than eightfold."""
    finite = values[np.isfinite(values)]
    if not finite.size or finite.min() <= 0 or finite.max() <= 8 * finite.min():
        return
    set_scale("log")
    if finite.min() >= 1e-3 and finite.max() < 1e5:
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        shown = "235" if finite.max() < 100 * finite.min() else ""
        axis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in shown else "")


def _pans(dataset: "xarray.Dataset") -> bool:
    """Whether any design of a sweep pans."""
    return bool(np.any(dataset.velocity.values))


def _contours(
    axes: "Axes", exposure: np.ndarray, acceleration: np.ndarray, within: np.ndarray, pans: bool
) -> None:
    """Draws labelled lines of equal sag and of equal gain in speed in the largest decades."""
    limits = axes.axis()
    x, y = (np.geomspace(values[0], values[-1], 200) for values in (exposure, acceleration))
    half, halves, a = exposure * 5e-4, x * 5e-4, acceleration / 2
    for name, style, unit, along, powers in (
        ("sag" if pans else "stroke", "dashed", "px", 0.25, lambda t, a: a + 2 * t),
        (
            "speed gain" if pans else "top speed",
            "dotted",
            "px/s",
            0.75,
            lambda t, a: np.log10(2) + a + t,
        ),
    ):
        reached = powers(np.log10(half), np.log10(a)[:, None])[within]
        last = int(np.floor(reached.max()))
        first = max(last - _DECADES + 1, int(np.floor(reached.min())))
        texts = {
            decade + np.log10(share): f"{name} {float(f'{share}e{decade}'):g} {unit}"
            for decade in range(first, last + 1)
            for share in ((1, 2, 5) if last - first < _DECADES - 1 else (1,))
        }
        values = powers(np.log10(halves), np.log10(y / 2)[:, None])
        levels = [level for level in texts if values.min() < level < values.max()]
        if not levels:
            continue
        drawn = axes.contour(x, y, values, levels)
        places = _label_places(axes, drawn, along)
        drawn.remove()
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


def _label_places(axes: "Axes", drawn: "QuadContourSet", along: float) -> dict[float, Place]:
    """Places of labels by level, a share of the way along each line that is long enough for one."""
    places: dict[float, Place] = {}
    for level, parts in zip(drawn.levels, drawn.allsegs, strict=True):
        line = max(parts, key=len)
        ends = _on_axes(axes, line[[0, -1]])
        if np.hypot(*(ends[1] - ends[0])) > 0.35:  # widths of the axes
            x, y = line[int(along * (len(line) - 1))]
            places[level] = x, y
    return places


def plot_front(
    dataset: "xarray.Dataset", objectives: tuple[str, str], *, num_profiles: int = 4
) -> "Figure":
    """Draws two metrics that exclude one another: the Pareto front of each shutter and of all.

    Grey dots are the other points between the fronts. The lower panels have profiles of points
    along the front of all.

    Args:
        dataset: The result of `sweep`, of one scene and light.
        objectives: Metrics on the axes.
        num_profiles: Most points of the front whose profiles are drawn.

    Raises:
        ValueError: if an objective is not a metric of the sweep, or no profile is asked for.
    """
    from matplotlib.patheffects import withStroke

    require_positive_int("plot_front(num_profiles=...)", num_profiles)
    front = pareto_front(dataset, objectives)
    places = np.stack([front[name].values for name in objectives], axis=1)
    finite = np.all(np.isfinite(places), axis=1)
    front, places = front.isel(point=finite), places[finite]
    figure = new_figure(7.0, 7.0)
    rows = figure.add_gridspec(2, 1, height_ratios=(3, 1))
    axes = figure.add_subplot(rows[0])
    _draw_points(axes, dataset, objectives)
    axes.step(
        *places.T,
        label="front of all",
        color="0.87",
        linewidth=7,
        zorder=1.5,
        solid_capstyle="butt",
    )
    legend_above(axes)
    num_lines = -(-len(axes.get_legend_handles_labels()[1]) // 3)
    leave_room(figure, left=0.9, top=0.2 + LINE * num_lines, rows=1.0, num_rows=2)
    shown = _spread(_on_axes(axes, places), num_profiles)
    columns = rows[1].subgridspec(1, max(1, len(shown)))
    for column, index in enumerate(shown):
        letter = chr(ord("A") + column)
        axes.plot(*places[index], marker="o", markersize=7, color="white", markeredgecolor="black")
        axes.annotate(
            letter,
            places[index],
            (5, 6),
            textcoords="offset points",
            path_effects=[withStroke(linewidth=3, foreground="white")],
            weight="bold",
        )
        panel = figure.add_subplot(columns[column])
        _draw_profile(panel, dataset, front.isel(point=index), letter)
        panel.set_ylabel("transmittance" if column == 0 else "", fontsize="small")
        panel.tick_params(labelleft=column == 0, labelsize="small")
    return figure


def _draw_points(axes: "Axes", dataset: "xarray.Dataset", objectives: tuple[str, str]) -> None:
    """Draws the Pareto front of each shutter in a marker of its own, over the points of all."""
    names = [str(name) for name in dataset.shutter.values]
    fronts = [pareto_front(dataset.sel(shutter=[name]), objectives) for name in names]
    scales = (axes.set_xscale, axes.xaxis), (axes.set_yscale, axes.yaxis)
    for objective, scale in zip(objectives, scales, strict=True):
        if _unit(dataset, objective) != "dB":
            _scale(*scale, np.concatenate([front[objective].values for front in fronts]))
    for name, front, marker, style in zip(names, fronts, cycle("os^Dvp*XP<>h"), line_styles(1.2)):
        x, y = (front[objective].values for objective in objectives)
        axes.plot(
            x,
            y,
            marker=marker,
            markersize=6,
            fillstyle="none",
            markevery=0.04,
            drawstyle="steps",
            label=shown_name(name, _LETTERS),
            **style,
        )
    limits = axes.axis()
    x, y = (dataset[objective].values.ravel() for objective in objectives)
    axes.plot(x, y, ".", markersize=2, color="0.6", zorder=1, label="other points")
    axes.axis(limits)
    xlabel, ylabel = (_label(dataset, objective) for objective in objectives)
    axes.set(xlabel=xlabel, ylabel=ylabel)
    draw_grid(axes)


def _spread(places: np.ndarray, count: int) -> list[int]:
    """Indices of some points of a line, evenly along it and at least 0.07 widths apart."""
    steps = np.hypot(*np.diff(places, axis=0).T)
    along = np.cumsum(np.append(0, steps))[: len(places)]
    indices: list[int] = []
    for length in np.linspace(0, along[-1:].sum(), count) if len(places) else ():
        index = int(np.argmin(np.abs(along - length)))
        if not indices or along[index] - along[indices[-1]] >= 0.07:
            indices.append(index)
    return indices


def _draw_profile(
    axes: "Axes", dataset: "xarray.Dataset", point: "xarray.Dataset", letter: str
) -> None:
    """Draws the profile of a point of a sweep over its exposure."""
    tau = np.linspace(-1, 1, 401)
    half = float(point.half_exposure) * 1e3
    transmittance = np.pad(_transmittance(dataset, point, tau), 1)
    axes.plot(np.pad(tau, 1, "edge") * half, transmittance, color="black")
    axes.set(ylim=(-0.05, 1.1))
    axes.set_xlabel("time / ms", fontsize="small")
    axes.locator_params(axis="x", nbins=4)
    sag = float(point.acceleration) * float(point.half_exposure) ** 2
    length = "sag" if _pans(point) else "stroke"
    name = shown_name(str(point.shutter.values), _LETTERS)
    axes.set_title(f"{letter}: {name}\n{sag:.3g} px {length}", fontsize="small")


def _transmittance(
    dataset: "xarray.Dataset", point: "xarray.Dataset", tau: np.ndarray
) -> np.ndarray:
    """Profile of a point of a sweep, from the description of its shutters in the sweep."""
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
