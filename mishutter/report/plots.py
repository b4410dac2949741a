"""Pictures of profiles, kernels, transfer functions, searches and restored photographs.

Every function returns a `matplotlib.figure.Figure`; nothing is shown and no global state
is touched. Lines differ in style as well as colour, so that they survive a grey printout.
"""

import io
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import count, cycle
from pathlib import Path
from typing import Any, final

import numpy as np
from jaxtyping import ArrayLike
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mishutter._core import require, write_bytes
from mishutter.blur import LitNodes, lit_nodes, support
from mishutter.design import DriveTable
from mishutter.evaluation import kernel_phase, kernels_at_speeds, size_class
from mishutter.model import AbstractMotion, AbstractShutter, Picture, profile_of, to_display
from mishutter.restore import RestoredPhotograph

Named = Mapping[str, tuple[AbstractMotion, AbstractShutter]]
"""Designs by the name that a legend shows."""

_COLOURS = ("#0072b2", "#d55e00", "#000000", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)), (0, (8, 3)))
_MARKERS = ("o", "s", "^", "D", "v", "x", "P")
_NUM_POINTS = 1001
_LEAST_RESPONSE = 1e-4
_NODES_PER_PX, _LEAST_NODES = 2.0, 64
"""Quadrature nodes over the exposure, by the path's greatest velocity in px per half exposure."""
_CROP = (160, 240)
_DOTS_PER_INCH = 130
_LETTERS_OF_A_COLUMN = 34
"""Of a legend in two columns."""
_MOST_COLUMNS = 1000
"""More columns of a picture than a panel has dots for are averaged."""
_LEAST_HEIGHT, _MOST_HEIGHT = 1 / 16, 3.0
"""Of a panel, in widths."""
_MOST_ELONGATED = 16
"""A picture of a longer shape, lying or standing, is stretched to its panel, to be seen."""


@final
class Drawing(Figure):
    """A figure that a notebook shows, which it does by itself only with `pyplot` imported."""

    def _repr_png_(self) -> bytes:
        return _png(self)


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as a PNG, whole or not at all.

    Raises:
        OSError: if the file cannot be written.
    """
    write_bytes(path, _png(figure))


def _png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    FigureCanvasAgg(figure)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a name in letters that the font lacks
        figure.savefig(buffer, format="png", dpi=_DOTS_PER_INCH)
    return buffer.getvalue()


def plot_profiles(designs: Named) -> Figure:
    """Transmittance over the exposure, each design over its own time in ms."""
    figure, (axes,) = _new(1)
    tau = np.linspace(-1, 1, _NUM_POINTS)
    for (name, (motion, shutter)), style in zip(designs.items(), _styles(), strict=False):
        half = float(motion.half_exposure) * 1e3
        w, efficiency = profile_of(shutter, tau.astype(motion.half_exposure.dtype))
        time, w = np.pad(tau * half, 1, "edge"), np.pad(w, 1)
        label = f"{shown_name(name)}, lets {float(efficiency):.0%} through"
        axes.plot(time, w, label=label, **style)
    axes.set(xlabel="time from mid-exposure / ms", ylabel="transmittance", ylim=(-0.02, 1.05))
    _legend(figure, axes)
    return figure


def plot_drive(table: DriveTable) -> Figure:
    """A drive table over the exposure: transmittance as designed and as driven; the sensor."""
    figure, (top, bottom) = _new(2, height=2.6)
    step = float(table.design.motion.exposure) * 1e3 / table.begin.size
    edges = np.append(table.begin * 1e3, table.begin[-1] * 1e3 + step)
    first, second, *_ = (style for style, _ in zip(_styles(), range(2), strict=False))
    top.stairs(table.transmittance, edges, label=f"driven, {table.num_levels} levels", **first)
    top.plot(edges[:-1] + step / 2, table.wanted, label="designed", **second)
    top.set(ylabel="transmittance", ylim=(-0.02, 1.05))
    top.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    time, motion = np.linspace(edges[0], edges[-1], _NUM_POINTS), table.design.motion
    path = (float(motion.velocity) + float(motion.acceleration) * time * 1e-3) * time * 1e-3
    bottom.plot(time, path, **first)
    bottom.set(xlabel="time from mid-exposure / ms", ylabel="sensor position / px")
    return figure


def plot_kernels(designs: Named, speeds: Sequence[float]) -> Figure:
    """Blur kernels aligned at the vertex: one panel a design, one line a speed in px/s."""
    reaches = [_kernel_reach(motion, speeds) for motion, _ in designs.values()]
    num_taps = int(max(reaches)) + 2
    figure, panels = _new(len(designs), height=2.0, share=True)
    for axes, (name, (motion, shutter)) in zip(panels, designs.items(), strict=True):
        edges = np.arange(num_taps + 1) + float(kernel_phase(motion, num_taps))
        row = np.asarray(speeds, motion.half_exposure.dtype)
        kernels = np.asarray(kernels_at_speeds(shutter, motion, row, num_taps))
        for speed, taps, style in zip(speeds, kernels, _styles(), strict=False):
            axes.stairs(taps, edges, label=f"{speed:g} px/s", **style)
        title = f"{shown_name(name)}, stroke {float(motion.stroke):.3g} px"
        axes.set_title(title, fontsize="medium")
        axes.set_ylabel("light / px")
    panels[0].legend()
    panels[-1].set_xlabel("position from the vertex of the path / px")
    panels[0].set_xlim(-2, num_taps)
    return figure


def _kernel_reach(motion: AbstractMotion, speeds: Sequence[float]) -> float:
    fastest = max(abs(s) for s in speeds)
    smear = 2 * fastest * float(motion.half_exposure)
    return max(float(support(motion, fastest)), smear + 1)


def plot_transfer(designs: Named, speeds: Sequence[float]) -> Figure:
    """Modulation transfer, pixel aperture included: one panel a speed, one line a design."""
    figure, panels = _new(len(speeds), height=2.4, share=True)
    frequency = np.linspace(0, 0.5, _NUM_POINTS)
    nodes = _nodes(designs, max(abs(speed) for speed in speeds))
    for axes, speed in zip(panels, speeds, strict=True):
        for (name, (motion, _)), style in zip(designs.items(), _styles(), strict=False):
            response = _transfer(nodes[name], motion, speed, frequency)
            shown = np.maximum(response * np.sinc(frequency), _LEAST_RESPONSE)
            axes.semilogy(frequency, shown, label=shown_name(name), **style)
        axes.set_title(f"object at {speed:g} px/s", fontsize="medium")
        axes.set_ylabel("modulation transfer")
    _legend(figure, panels[0])
    panels[-1].set(xlabel="spatial frequency / (cycles/px)", ylim=(1e-3, 1.2), xlim=(0, 0.5))
    return figure


def _nodes(designs: Named, fastest: float) -> dict[str, LitNodes]:
    """Quadrature nodes of each design, as many as the highest of frequencies needs."""
    motions = [motion for motion, _ in designs.values()]
    velocity = max(float(m.stroke) * 2 + fastest * float(m.half_exposure) for m in motions)
    num_nodes = size_class(math.ceil(_NODES_PER_PX * velocity) + _LEAST_NODES)
    return {
        name: lit_nodes(shutter, num_nodes, np.dtype(motion.half_exposure.dtype))
        for name, (motion, shutter) in designs.items()
    }


def _transfer(
    nodes: LitNodes, motion: AbstractMotion, speed: float, frequency: np.ndarray
) -> np.ndarray:
    """Modulus of the transfer function; a program of `transfer_function` would compile longer."""
    a, half = float(motion.acceleration), float(motion.half_exposure)
    stroke, smear = a * half * half, (speed - float(motion.velocity)) * half
    tau, light = (np.asarray(x, np.float64) for x in nodes[:2])
    position = tau * (stroke * tau - smear)
    return np.abs(np.exp(-2j * np.pi * frequency[:, None] * position) @ light)


def plot_psnr(results: Mapping[str, RestoredPhotograph], *, linear: bool = False) -> Figure:
    """PSNR of the restored photograph against object speed, with its standard error."""
    figure, (axes,) = _new(1)
    drawn = zip(results.items(), _styles(), cycle(_MARKERS), strict=False)
    for (name, result), style, marker in drawn:
        level = result.linear_psnr if linear else result.psnr
        error = result.linear_standard_error if linear else result.standard_error
        order = np.argsort(result.speeds)
        error = None if np.any(np.isnan(error)) else error[order]
        marks = {"marker": marker, "markersize": 6, "fillstyle": "none", "capsize": 2}
        marks |= {"label": shown_name(name)}
        axes.errorbar(result.speeds[order], level[order], error, **marks, **style)
    label = f"PSNR of restored picture / dB ({_kind(linear)})"
    axes.set(xlabel="object speed / (px/s)", ylabel=label)
    _legend(figure, axes)
    return figure


def _kind(linear: bool) -> str:
    return "linear light" if linear else "gamma put back"


def plot_photograph(
    results: Mapping[str, RestoredPhotograph],
    speed: float,
    *,
    crop: tuple[int, int] = _CROP,
    linear: bool = False,
) -> Figure:
    """A photograph captured above and restored below, one column a design.

    Args:
        results: What `restore_photograph` gave for each design, at the same speeds.
        speed: The speed to show, the nearest that was tried; px/s.
        crop: Rows and columns to show, from the middle of the picture; px.
        linear: Whether the PSNR is of linear light, not with gamma put back.

    Raises:
        ValueError: if there is nothing to show.
    """
    require(len(results) > 0, "plot_photograph(results=...)", "hold a result", 0)
    rows, columns = crop
    scale = 2.6 / columns
    across = len(results) + 1
    size = (across * columns * scale + 0.1, 2 * rows * scale + 1.0)
    figure = Drawing(figsize=size, layout="constrained")
    panels = figure.subplots(2, across, squeeze=False)
    reference = next(iter(results.values())).reference
    _show(panels[0, 0], reference, crop, "the scene, at rest")
    panels[1, 0].axis("off")
    for column, (name, result) in enumerate(results.items(), start=1):
        index = int(np.argmin(np.abs(result.speeds - speed)))
        nearest = result.speeds[index]
        level = (result.linear_psnr if linear else result.psnr)[index]
        captured = result.captured[index]
        gain = np.mean(result.reference) / max(float(np.mean(captured)), 1e-12)
        title = f"{shown_name(name, 26)}, captured\nat {nearest:g} px/s"
        _show(panels[0, column], captured * gain, crop, title)
        title = f"restored, {level:.1f} dB\n({_kind(linear)})"
        _show(panels[1, column], result.restored[index], crop, title)
    return figure


def plot_capture(seen: object, captured: np.ndarray, restored: np.ndarray) -> Figure:
    """A capture beside what a decoder made of it, and the photograph if it was one."""
    shown = {"captured": captured, "restored": restored}
    if isinstance(seen, Picture):
        shown = {"the scene, at rest": seen.light} | shown
    rows, columns = captured.shape[:2]
    width = 4.0
    height = float(np.clip(rows / columns, _LEAST_HEIGHT, _MOST_HEIGHT))
    stretched = max(rows / columns, columns / rows) > _MOST_ELONGATED
    size = (len(shown) * width + 0.2, width * height + 0.6)
    figure = Drawing(figsize=size, layout="constrained")
    panels = figure.subplots(1, len(shown), squeeze=False)
    for axes, (title, light) in zip(panels[0], shown.items(), strict=True):
        small = _shrunk(light, max(1, columns // _MOST_COLUMNS))
        _show(axes, small, small.shape[:2], title)
        axes.set_aspect("auto" if stretched else "equal")
    return figure


def _shrunk(light: np.ndarray, times: int) -> np.ndarray:
    """A picture of means over squares of `times` px; what does not fill one is left out."""
    if times == 1 or min(light.shape[:2]) < times:
        return light
    rows, columns = (size // times for size in light.shape[:2])
    kept = light[: rows * times, : columns * times]
    return kept.reshape(rows, times, columns, times, -1).mean(axis=(1, 3))


def _show(axes: Axes, light: np.ndarray, crop: tuple[int, int], title: str) -> None:
    starts = [max(0, (size - wanted) // 2) for size, wanted in zip(light.shape, crop, strict=False)]
    rows, columns = (slice(a, a + wanted) for a, wanted in zip(starts, crop, strict=True))
    shown = to_display(light[rows, columns])
    grey = shown.ndim == 2 or shown.shape[2] == 1
    axes.imshow(shown[..., 0] if grey and shown.ndim == 3 else shown, cmap="gray", vmin=0, vmax=1)
    axes.set_title(title, fontsize="small")
    axes.axis("off")


def plot_history(history: ArrayLike, *, loss_name: str = "loss") -> Figure:
    """Smallest loss so far as the search went on, as `Design.history` holds it."""
    figure, (axes,) = _new(1)
    losses = np.asarray(history)
    axes.plot(np.arange(losses.size), losses, color=_COLOURS[0], linewidth=1.6)
    axes.set(xlabel="step or start, and last the polish", ylabel=f"smallest {loss_name} so far")
    return figure


def shown_name(name: str, most: int = 40) -> str:
    """A name as a picture shows it: of `most` letters at most, and as text, whatever it holds.

    A dollar would begin a formula, and a legend leaves out what begins with an underscore.
    Bytes of a file's name that are no text have no letters.
    """
    name = name.encode("utf-8", "backslashreplace").decode()
    cut = name if len(name) <= most else f"{name[: most // 2 - 1]}…{name[-(most // 2) :]}"
    return f"{' ' if cut.startswith('_') else ''}{cut}".replace("$", r"\$")


def _legend(figure: Figure, axes: Axes) -> None:
    """Names of the lines above all panels, where they hide none; the figure grows by them."""
    handles, labels = axes.get_legend_handles_labels()
    columns = 2 if max(map(len, labels), default=0) <= _LETTERS_OF_A_COLUMN else 1
    figure.legend(handles, labels, loc="outside upper center", ncols=columns)
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + 0.2 * -(-len(labels) // columns))


def _styles() -> Iterator[dict[str, Any]]:
    """Lines of which no two of the first 49 are alike: dashes move on by one each round."""
    for index in count():
        turn, place = divmod(index, len(_COLOURS))
        dash = _DASHES[(place + turn) % len(_DASHES)]
        yield {"color": _COLOURS[place], "linestyle": dash, "linewidth": 1.6}


def _new(num_panels: int, *, height: float = 4.2, share: bool = False) -> tuple[Figure, list[Axes]]:
    figure = Drawing(figsize=(7.0, height * num_panels + 0.4), layout="constrained")
    panels = figure.subplots(num_panels, 1, squeeze=False, sharex=share, sharey=share)
    for axes in panels[:, 0]:
        axes.grid(True, color="0.88", linewidth=0.6)
    return figure, list(panels[:, 0])
