"""Pictures of profiles, kernels, transfer functions and restored photographs.

Every function returns a `matplotlib.figure.Figure`; nothing is shown and no global state
is touched. Lines differ in style as well as colour, so that they survive a grey printout.
"""

import io
import itertools
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import count, cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import in_digits, require, three_digits
from mishutter._core.files import write_bytes
from mishutter.decoding.photographs import RestoredPhotograph
from mishutter.design.design import Design
from mishutter.evaluation.errors import spectral_levels
from mishutter.evaluation.response import kernel_phase, kernels_at_speeds
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE
from mishutter.hardware.drive import DriveTable
from mishutter.hardware.triggers import FrameTable, frame_table
from mishutter.model.decoder_speeds import DecoderSpeed
from mishutter.model.devices import command_of
from mishutter.model.exposures import Exposures
from mishutter.model.frame_path import AT_REST, FramePath, Lights
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, picture_power
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.polynomials import profile_of
from mishutter.model.shutters.spline import SplineShutter
from mishutter.model.stages import StagePath
from mishutter.model.velocities import AbstractVelocities
from mishutter.pictures.images import Axis, Picture, to_display, transposed
from mishutter.search.rows import SHUTTER, Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Named = Mapping[str, tuple[AbstractMotion, AbstractShutter]]
"""Designs by the name that a legend shows."""

_COLOURS = ("#0072b2", "#d55e00", "#000000", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)), (0, (8, 3)))
_NUM_POINTS = 1001
_CELL, _TITLE = 1.6, 0.4
"""Width of a magnified detail, and height of its title; inches."""
_EAR = 0.02
"""Least rise of transmittance towards an end of the exposure that is an ear."""
LINE = 0.21
"""Height of a line of a legend; inches."""
MAP_COLOURS = "viridis"
"""Colours of maps, which rise from dark to light in a grey printout and to every eye.

None is grey, as the place of what is not computed is.
"""
_LETTERS_OF_A_LINE = 92
"""Most letters of a line above a picture, in small letters."""
_LETTERS_OF_A_PANEL = 48
"""Letters that fit above a picture."""


def new_figure(width: float, height: float) -> "Figure":
    """A figure that a notebook shows without `pyplot`."""
    from matplotlib.figure import Figure

    class Drawing(Figure):
        def _repr_png_(self) -> bytes:
            return _png(self)

    return Drawing(figsize=(width, height))


def leave_room(
    figure: "Figure",
    *,
    left: float = 0.8,
    right: float = 0.15,
    bottom: float = 0.55,
    top: float = 0.15,
    columns: float = 0.9,
    rows: float = 0.4,
    num_rows: int = 1,
    num_columns: int = 1,
) -> None:
    """Leaves room for labels around the panels of a figure, which are a grid, and between them.

    It is told, in inches, and not searched for: matplotlib's solvers of layouts take longer than
    the drawing.
    """
    width, height = figure.get_size_inches()
    across = width - left - right - (num_columns - 1) * columns
    down = height - bottom - top - (num_rows - 1) * rows
    figure.subplots_adjust(
        left=left / width,
        right=1 - right / width,
        bottom=bottom / height,
        top=1 - top / height,
        wspace=columns * num_columns / across,
        hspace=rows * num_rows / down,
    )


def save_figure(figure: "Figure", path: str | Path) -> None:
    """Writes a figure as a PNG, whole or not at all.

    Raises:
        OSError: if the file cannot be written.
    """
    write_bytes(path, _png(figure))


def _png(figure: "Figure") -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    buffer, resolution = io.BytesIO(), figure.dpi
    figure.dpi = 130
    # The usual level of compression takes twice the time for files that are 1 % smaller.
    faster = {"compress_level": 4}
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph")  # the font lacks a letter of some name
            FigureCanvasAgg(figure).print_png(buffer, pil_kwargs=faster)  # `savefig` draws twice
    finally:
        figure.dpi = resolution
    return buffer.getvalue()


def plot_profiles(designs: Named, *, explains_ears: bool = True) -> "Figure":
    """Draws transmittance over the exposure, each design over its own time in ms."""
    figure, (axes,) = _new(1)
    ears: list[tuple[float, float]] = []
    for (name, (motion, shutter)), style in zip(designs.items(), line_styles(), strict=False):
        time, w, efficiency = _over_exposure(motion, shutter)
        label = f"{shown_name(name)}, passes {efficiency:.0%}"
        axes.plot(time, w, label=label, **style)
        if isinstance(command_of(shutter), SplineShutter):
            ears += [(time[1 + end], w[1 + end]) for end in _ears(w[1:-1])]
    axes.set(xlabel="time from mid-exposure / ms", ylabel="transmittance", ylim=(-0.02, 1.05))
    _legend(figure, axes)
    if ears and explains_ears:
        axes.plot(*zip(*ears, strict=True), "o", markersize=13, fillstyle="none", color="0.4")
        height = _grow(figure, below=2 * LINE)
        # The legend keeps its distance from the upper edge.
        figure.legends[0].set_bbox_to_anchor((0.5, 1 - 0.05 / height))
        figure.text(
            0.5,
            0.06 / height,
            "Ears: light at the ends makes the blur of fast objects more like that of slow ones,\n"
            "for a decoder that does not know the speed. The worst speed gains most by them.",
            ha="center",
            va="bottom",
            fontsize="small",
        )
    return figure


def _over_exposure(
    motion: AbstractMotion, shutter: AbstractShutter
) -> tuple[Float[np.ndarray, "times"], Float[np.ndarray, "times"], float]:
    """Times of an exposure, ms, the transmittance, which is 0 before and after, and its mean."""
    tau, half = np.linspace(-1, 1, _NUM_POINTS), motion.half_exposure
    transmittance, mean = profile_of(shutter, tau.astype(np.dtype(half.dtype)))
    return np.pad(tau * float(half) * 1e3, 1, "edge"), np.pad(transmittance, 1), mean


def _ears(transmittance: Float[np.ndarray, "times"]) -> list[int]:
    """Indices of the ends of an exposure towards which a profile rises again."""
    ends = {0: transmittance, len(transmittance) - 1: transmittance[::-1]}
    rising = []
    for index, inwards in ends.items():
        falls = np.diff(inwards[: len(inwards) // 2]) <= 0
        dip = len(falls) if np.all(falls) else int(np.argmin(falls))
        rises_behind = np.max(inwards[dip:]) - inwards[dip] > _EAR
        if rises_behind and inwards[0] - inwards[dip] > _EAR:
            rising.append(index)
    return rising


def plot_design(design: Design) -> "Figure":
    """Draws a design in time: the transmittance of its shutter and the path of its sensor.

    Where frames of a burst are better, or are in the plane, these are drawn, with the path of the
    stage through them.

    Args:
        design: A design along an axis or in the plane.
    """
    burst = design.exposures
    if burst.in_plane and burst.moves:
        return _plot_plane(design.scene, burst)
    if design.sequence is not None:
        return plot_frames(frame_table(design))
    motion = design.motion
    figure, (top, bottom) = _new(2, height=2.4, share=True)
    leave_room(figure, top=0.4, num_rows=2)
    drawn = {"sent to the device": design.command} if design.scene.device is not None else {}
    for (name, shutter), style in zip(
        ({"transmittance": design.shutter} | drawn).items(), line_styles(), strict=False
    ):
        time, values, _ = _over_exposure(motion, shutter)
        top.plot(time, values, label=name, **style)
    level = next(iter(design.levels.values()))
    top.set_title(f"{motion_text(motion)}, {level:.2f} dB", fontsize="medium")
    top.set(ylabel="transmittance", ylim=(-0.02, 1.05))
    if drawn:
        top.legend(loc="lower center", fontsize="small")
    half, dtype = float(motion.half_exposure), np.dtype(motion.half_exposure.dtype)
    time = np.linspace(-half, half, _NUM_POINTS, dtype=dtype)
    bottom.plot(time * 1e3, np.asarray(motion.position(time)), **next(line_styles()))
    bottom.set(xlabel="time from mid-exposure / ms", ylabel="sensor position / px")
    return figure


def plot_levels(levels: Mapping[str, float], most: float, chosen: str | None = None) -> "Figure":
    """Draws the levels of cameras, the best at the top, and the ceiling of one exposure."""
    order = sorted(levels, key=lambda name: levels[name])
    figure = new_figure(7.0, max(0.27 * len(order) + 1.1, 2.6))
    leave_room(figure, left=2.6, top=0.4)
    axes = figure.subplots()
    for place, name in enumerate(order):
        face = _COLOURS[0] if name == chosen else "white"
        axes.plot(levels[name], place, "o", color=_COLOURS[0], markerfacecolor=face)
        axes.annotate(
            f"{levels[name]:.2f}",
            (levels[name], place),
            (7, 0),
            textcoords="offset points",
            va="center",
            fontsize="small",
        )
    axes.axvline(
        most, color="black", linestyle="--", label=f"ceiling of one exposure: {most:.2f} dB"
    )
    axes.set_yticks(range(len(order)), [shown_name(name, 30) for name in order], fontsize="small")
    axes.set(xlabel="expected PSNR / dB", ylabel="camera at its best motion")
    axes.margins(x=0.1)
    legend_above(axes, fontsize="small")
    draw_grid(axes)
    return figure


def plot_drive(table: DriveTable) -> "Figure":
    """Draws a drive table: the transmittance that is sent, and the sensor's path.

    The upper picture shows the levels, the command that they stand for, and, if the scene has a
    device, the transmittance behind it.
    """
    figure, (top, bottom) = _new(2, height=2.6)
    step = float(table.design.motion.exposure) * 1e3 / table.begin.size
    edges = np.append(table.begin * 1e3, table.begin[-1] * 1e3 + step)
    first, second, third = itertools.islice(line_styles(), 3)
    top.stairs(table.transmittance, edges, label=f"sent, {table.num_levels} levels", **first)
    top.plot(edges[:-1] + step / 2, table.wanted, label="sent as designed", **second)
    time, motion = np.linspace(edges[0], edges[-1], _NUM_POINTS), table.design.motion
    if table.design.scene.device is not None:
        passed = _over_exposure(motion, table.passed())[1][1:-1]
        top.plot(time, passed, label="behind the device", **third)
    top.set(ylabel="transmittance", ylim=(-0.02, 1.05))
    legend_above(top)
    leave_room(figure, top=0.4, num_rows=2)
    bottom.plot(time, np.asarray(motion.position(time * 1e-3)), **first)
    bottom.set(xlabel="time from mid-exposure / ms", ylabel="sensor position / px")
    return figure


def plot_frames(table: FrameTable) -> "Figure":
    """Draws a burst: when its frames are exposed, and the path of the stage through them."""
    figure, (axes,) = _new(1, height=3.0)
    names = {"": "", "_x": " along rows", "_y": " along columns"}
    paths = {names[end]: path for end, path in table.paths.items()}
    stage = table.design.scene.limits.stage
    _draw_exposures(axes, table.lights, paths)
    if not paths:
        part = "stage" if table.design.scene.limits.moves else "sensor"
        axes.lines[0].set_label(f"{part}, at rest")
        axes.set(ylabel=f"{part} position / px", ylim=(-1, 1))
    styles = itertools.islice(line_styles(), max(len(paths), 1), None)
    if stage is not None:
        for name, path in paths.items():
            time = np.linspace(path.times[0], path.times[-1], _NUM_POINTS)
            sent = stage.sent_for(path, time)
            axes.plot(time * 1e3, sent, label=f"sent to it{name}", **next(styles))
    # Of two axes with a servo there are five names.
    legend_above(axes)
    leave_room(figure, top=0.4 if len(axes.lines) < 3 else 0.7)
    return figure


def _shade(axes: "Axes", lights: Lights) -> None:
    """Draws exposures as shades."""
    for index, lit in enumerate(lights):
        label = None if index else "exposed"
        axes.axvspan(*(x * 1e3 for x in lit), color="0.82" if index % 2 else "0.9", label=label)


def _draw_exposures(axes: "Axes", lights: Lights, paths: Mapping[str, StagePath]) -> None:
    """Draws exposures as shades, and paths of a stage by their names, or one at rest, as lines."""
    _shade(axes, lights)
    ends = lights[0][0], lights[-1][1]
    for path in paths.values():
        ends = path.times[0], path.times[-1]
    time = np.linspace(*ends, _NUM_POINTS)
    places = {name: path.at(time)[0] for name, path in paths.items()} or {"": np.zeros_like(time)}
    for (name, place), style in zip(places.items(), line_styles(), strict=False):
        axes.plot(time * 1e3, place, label=f"stage{name}", **style)
    axes.set(xlabel="time from the middle / ms", ylabel="stage position / px")


def plot_option(scene: Scene, row: Row, title: str = "") -> "Figure":
    """Draws an option of an answer: its exposures in time, and the path of the stage.

    Behind a shaped shutter a second panel has the transmittance. In the plane the path and its
    velocities have panels of their own, if the stage moves.
    """
    exposures, is_still = row.exposures, row.stroke < AT_REST
    if exposures.in_plane and not is_still:
        return _plot_plane(scene, exposures, title)
    paths = {} if is_still else exposures.stage_paths(scene)
    is_shaped = SHUTTER in row.required_hardware
    figure, (axes, *others) = _new(1 + is_shaped, height=2.6, share=True)
    _draw_exposures(axes, exposures.lights, paths)
    if not (paths or is_still):
        axes.lines[0].remove()  # no limit says how the stage gets there
        times = np.array([np.linspace(*lit, _NUM_POINTS) for lit in exposures.lights])
        for time, place in zip(times, exposures.place(times)[0], strict=True):
            label = None if len(axes.lines) else "stage"
            axes.plot(time * 1e3, place, label=label, **next(line_styles()))
    for below in others:
        axes.set_xlabel("")
        below.plot(*_over_exposure(row.motion, row.shutter)[:2], **next(line_styles()))
        below.set(xlabel="time from the middle / ms", ylabel="transmittance", ylim=(-0.02, 1.05))
    travel = (
        ", at rest" if is_still else f", {three_digits(row.stroke)} px from first to last light"
    )
    part = "stage" if scene.limits.moves else "sensor"
    axes.lines[0].set_label(f"{part}{travel}")
    axes.set_ylabel(f"{part} position / px")
    if np.ptp(np.concatenate([line.get_ydata() for line in axes.lines])) < AT_REST:
        axes.set_ylim(-1, 1)
    legend_above(axes)
    return _titled(figure, title, num_rows=1 + is_shaped)


def _titled(figure: "Figure", title: str, num_rows: int = 1) -> "Figure":
    """A figure of panels under the first line of an answer."""
    num_lines = _write_title(figure, title)
    leave_room(figure, top=0.45 + LINE * num_lines, num_rows=num_rows)
    return figure


def _write_title(figure: "Figure", title: str) -> int:
    """Writes a line above a figure, in as many lines as it needs, which are returned."""
    lines = textwrap.wrap(shown_name(title, len(title)), _LETTERS_OF_A_LINE)
    figure.suptitle("\n".join(lines), fontsize="small", y=1 - 0.06 / figure.get_size_inches()[1])
    return len(lines)


def plot_kernels(designs: Named, speeds: Sequence[float]) -> "Figure":
    """Draws blur kernels aligned at the vertex, less the kernel at the sensor's velocity.

    Each design has a row with its own axes, and each speed a line, unless it lies on another, which
    has both names then. The legend gives the root mean square of a difference as a share of that of
    the kernel at the sensor's velocity.
    """
    figure = new_figure(12.4, 2.1 * len(designs) + 0.7)
    # Names stand beside the panels, where they cover no curve.
    margins = {"top": 0.5, "right": 2.3, "columns": 2.7, "rows": 0.85}
    leave_room(figure, num_rows=len(designs), num_columns=2, **margins)
    panels = figure.subplots(len(designs), 2, squeeze=False, sharex="row")
    for (left, right), (name, (motion, shutter)) in zip(panels, designs.items(), strict=True):
        velocity = float(motion.velocity)
        row = np.asarray([velocity, *speeds], motion.half_exposure.dtype)
        fastest = max(abs(speed - velocity) for speed in (velocity, *speeds))
        lengths = [float(motion.kernel_length(speed)) for speed in row]
        longest = max(*lengths, 2 * fastest * float(motion.half_exposure) + 1)
        num_taps = int(longest) + 2
        edges = np.arange(num_taps + 1) + float(kernel_phase(motion, num_taps))
        same, *kernels = np.asarray(kernels_at_speeds(shutter, motion, row, num_taps))
        taps = {f"{speed:.4g} px/s": each for speed, each in zip(speeds, kernels, strict=True)}
        style_of = dict(zip(taps, line_styles(), strict=False))
        for first, label in _uncovered(taps).items():
            left.stairs(taps[first], edges, label=label, **style_of[first])
        shares = {n: np.linalg.norm(each - same) / np.linalg.norm(same) for n, each in taps.items()}
        differences = {
            f"{n}: {shares[n]:.0%}": each - same for n, each in taps.items() if shares[n] > 0
        }
        for first, label in _uncovered(differences).items():
            style = style_of[first.partition(":")[0]]
            right.stairs(differences[first], edges, label=label, **style)
        left.set_title(f"{shown_name(name)},\n{motion_text(motion)}", fontsize="medium")
        right.set_title(f"difference from the kernel at {velocity:.4g} px/s", fontsize="medium")
        right.axhline(0, color="0.4", linewidth=0.6)
        for axes, title in ((left, None), (right, "RMS, relative")):
            draw_grid(axes)
            if axes.patches:
                beside = {"loc": "upper left", "bbox_to_anchor": (1.02, 1.0), "borderaxespad": 0.0}
                axes.legend(fontsize="small", title=title, title_fontsize="small", **beside)
            axes.set_ylabel("light per px")
    place = "position from the point of alignment / px"
    panels[-1, 0].set_xlabel(place)
    panels[-1, 1].set_xlabel(place)
    return figure


def _uncovered(curves: Mapping[str, Float[np.ndarray, "n"]]) -> dict[str, str]:
    """The names of curves that lie on no earlier one, each with all names of what lies on it."""
    extent = float(np.ptp([*curves.values()])) if curves else 0.0
    labels: dict[str, str] = {}
    for name, curve in curves.items():
        gaps = {first: np.abs(curve - curves[first]).max() for first in labels}
        # A hundredth of an axis is about the width of a line.
        first = next((each for each, gap in gaps.items() if gap <= 0.01 * extent), None)
        labels[first or name] = name if first is None else f"{labels[first]} = {name}"
    return labels


def motion_text(motion: AbstractMotion) -> str:
    """Exposure of a motion with its stroke, or with its sag and its pan, in words."""
    exposure = f"{three_digits(float(motion.exposure) * 1e3)} ms"
    sag, pan = float(motion.sag), float(motion.velocity)
    if sag <= 0:
        return exposure if pan == 0 else f"{exposure}, pan {pan:.4g} px/s"
    if pan == 0:
        return f"{exposure}, stroke {sag:.3g} px"
    return f"{exposure}, sag {sag:.3g} px beside a pan of {pan:.4g} px/s"


def camera_text(design: Design) -> str:
    """The exposure of a design with its motion, or the frames of its burst, in words."""
    if design.sequence is None:
        return motion_text(design.motion)
    return f"{design.exposures.setting}, {design.exposures.kind}"


def plot_transfer(
    scene: Scene,
    designs: Named,
    decoder_speed: DecoderSpeed = "unknown",
    answer: Mapping[str, float] | None = None,
) -> "Figure":
    """Draws the signal-to-noise ratio of each design at its own exposure, and its error.

    The upper panel has the power of the picture over the power of its disturbances: noise, and, for
    one filter for all speeds, the spread between them. The lower panel has the squared error of
    that filter, summed up to each frequency; its last value is that of the expected PSNR. A decoder
    that finds the speed is drawn with the filter that knows it, as it restores where the speed
    that it finds is right. The axis begins where the sum of the first design reaches a hundredth
    of its end. Names have that PSNR, or the level that an answer gives them, in dB.
    """
    knowledge = SPEED_KNOWLEDGE[decoder_speed]
    figure, (ratios, errors) = _new(2, height=2.9, share=True)
    begin = 0.5
    for (name, (motion, shutter)), style in zip(designs.items(), line_styles(), strict=False):
        levels = spectral_levels(scene, motion, shutter)
        frequency = levels.frequencies
        single = knowledge.of(levels).signal_over_noise
        ratio, dtype = np.asarray(single, np.float64), single.dtype
        power = np.asarray(picture_power(scene, ratio.size, dtype), np.float64)
        error = np.cumsum(power / (1 + ratio)) / ratio.size
        begin = min(begin, frequency[np.argmax(error >= 0.01 * error[-1])])
        with np.errstate(divide="ignore"):
            level, psnr = 10 * np.log10(ratio), -10 * np.log10(error[-1])
        ratios.semilogx(frequency, np.where(level >= -30.0, level, np.nan), **style)
        label = f"{shown_name(name)}: {psnr if answer is None else answer[name]:.2f} dB"
        errors.semilogx(frequency, error * 1e3, label=label, **style)
    ratios.set_ylabel("signal-to-noise ratio / dB")
    errors.set(ylabel="cumulative squared error / 10⁻³", ylim=(0, None))
    errors.set(xlabel="spatial frequency / (cycles/px)", xlim=(begin, 0.5))
    errors.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    of = f" of {knowledge.filter_words}"
    if answer is not None:
        # An answer takes off what a decoder loses that finds the speed.
        drawn = f", curves of {knowledge.filter_words}" if knowledge.finds_speed else ""
        of = f" as in the answer{drawn}"
    _legend(figure, errors, f"expected PSNR{of}, linear light")
    return figure


def plot_psnr(results: Mapping[str, RestoredPhotograph]) -> "Figure":
    """Draws PSNR of the restored photograph against object speed, with its standard error.

    A curve that lies on another is left out, and that one has both names.
    """
    figure, (axes,) = _new(1)
    levels = {name: each.linear_psnr for name, each in results.items()}
    drawn = zip(_uncovered(levels).items(), line_styles(), cycle("os^DvxP"), strict=False)
    for (name, label), style, marker in drawn:
        result, level = results[name], levels[name]
        error, order = result.linear_standard_error, np.argsort(result.speeds)
        error = None if np.any(np.isnan(error)) else error[order]
        axes.errorbar(
            result.speeds[order],
            level[order],
            error,
            marker=marker,
            markersize=6,
            fillstyle="none",
            capsize=2,
            label=shown_name(label),
            **style,
        )
    label = "PSNR of one photograph, restored / dB (linear light)"
    axes.set(xlabel="object speed / (px/s)", ylabel=label)
    _legend(figure, axes)
    return figure


def plot_photograph(
    results: Mapping[str, RestoredPhotograph],
    speeds: Sequence[float],  # px/s
    *,
    detail: tuple[int, int] = (48, 64),  # across and along the axis of motion; px
    axis: Axis = "rows",
    decoder_speed: DecoderSpeed = "unknown",
    asides: Mapping[str, str] | None = None,
) -> "Figure":
    """Draws a magnified detail of a photograph, captured and restored, and its error.

    Each design has a row. The detail is where the photograph varies most along the axis of motion,
    in the middle half of the columns that all designs recorded. Errors of all panels have one
    scale. The PSNR is that of the whole photograph.

    Raises:
        ValueError: if there is nothing to show, or the photographs are not parts of one.
    """
    from matplotlib.patches import Rectangle

    require(len(results) > 0, "plot_photograph(results=...)", "hold a result", 0)
    require(len(speeds) > 0, "plot_photograph(speeds=...)", "hold a speed", 0)
    aside = SPEED_KNOWLEDGE[decoder_speed].aside
    titles = {
        name: textwrap.wrap(shown_name(name, 69).replace(" ms", "\u00a0ms"), width=23)
        for name in results
    }
    lines = 1 + max(map(len, titles.values()))
    above = _TITLE + 0.17 * (lines - 2)
    scene = next(iter(results.values())).reference
    places = _details([result.reference for result in results.values()], detail, axis)
    down, right = places[0]
    size = right.stop - right.start, down.stop - down.start
    height = _CELL * min(1.0, size[1] / size[0])
    across = 3 * len(speeds)
    top = min(2 * height, _CELL * (across - 2) * scene.shape[0] / scene.shape[1])
    heights = [top, *(height for _ in results)]
    size_down = sum(heights) + len(results) * (above + 0.1) + _TITLE + 0.1
    figure = new_figure(across * _CELL, size_down)
    margins = {"left": 0.05, "right": 0.05, "bottom": 0.05, "top": _TITLE + 0.05, "columns": 0.1}
    leave_room(figure, num_rows=len(heights), num_columns=across, rows=above + 0.1, **margins)
    grid = figure.add_gridspec(len(heights), across, height_ratios=heights)
    whole = figure.add_subplot(grid[0, : across - 2])
    show_picture(whole, scene, "the scene, at rest; the box is magnified")
    corner = right.start - 0.5, down.start - 0.5
    for colour, line in (("black", 3.0), ("white", 1.2)):
        box = Rectangle(corner, size[0], size[1], fill=False, edgecolor=colour, linewidth=line)
        whole.add_patch(box)
    show_picture(figure.add_subplot(grid[0, -2]), scene[down, right], "the detail, at rest")
    maps = []
    for row, ((name, result), own) in enumerate(zip(results.items(), places, strict=True), 1):
        for number, speed in enumerate(speeds):
            index = int(np.argmin(np.abs(result.speeds - speed)))
            restored = result.restored[index][own]
            panels = [figure.add_subplot(grid[row, 3 * number + i]) for i in range(3)]
            title = "\n".join(titles[name])
            title += f",\ncaptured at {in_digits(float(result.speeds[index]), 4)} px/s"
            show_picture(panels[0], result.brightened(index)[own], title)
            # A speed that is not trusted is not used: all likely ones are restored for.
            of = ", speed in doubt" if result.doubts[index] else (asides or {}).get(name, aside)
            show_picture(panels[1], restored, f"restored{of},\n{result.linear_psnr[index]:.2f} dB")
            panels[2].set_title("error", fontsize="small", y=1.0)
            maps.append((panels[2], _error(result.reference[own], restored)))
    brightest = float(np.percentile([error for _, error in maps], 99)) or 1.0
    for axes, error in maps:
        axes.imshow(error, cmap=MAP_COLOURS, vmin=0, vmax=brightest)
        axes.axis("off")
    _draw_key(figure.add_subplot(grid[0, -1]), brightest)
    return figure


def _details(
    references: Sequence[np.ndarray], size: tuple[int, int], axis: Axis
) -> list[tuple[slice, slice]]:
    """Rows and columns of one detail in each part of a photograph: where all vary most."""
    along = [transposed(reference, axis) for reference in references]
    offsets = [_offset(along[0], part) for part in along]
    ends = (offset + part.shape[1] for offset, part in zip(offsets, along, strict=True))
    first, last = max(offsets), min(ends)
    aside = min((last - first) // 4, max(0, (last - first - size[1]) // 2))
    grey = to_display(along[0])[:, first + aside : last - aside].mean(axis=2)
    rows, columns = (min(pair) for pair in zip(size, grey.shape, strict=True))
    steps = np.diff(grey, axis=1, append=grey[:, -1:]) ** 2
    above = np.pad(steps, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    within = above[rows:] - above[:-rows]
    sums = within[:, columns:] - within[:, :-columns]
    row, column = (int(i) for i in np.unravel_index(np.argmax(sums), sums.shape))
    begins = [column + first + aside - offset for offset in offsets]
    places = [(slice(row, row + rows), slice(begin, begin + columns)) for begin in begins]
    return places if axis == "rows" else [(right, down) for down, right in places]


def _offset(reference: np.ndarray, other: np.ndarray) -> int:
    """Number of columns by which one part of a photograph begins to the right of another."""
    width, own = reference.shape[1], other.shape[1]
    for offset in sorted(range(1 - own, width), key=abs):
        first, last = max(0, offset), min(width, offset + own)
        if np.array_equal(reference[:, first:last], other[:, first - offset : last - offset]):
            return offset
    raise ValueError("`plot_photograph(results=...)` must be of one photograph; got several.")


def _error(truth: np.ndarray, restored: np.ndarray) -> np.ndarray:
    """Root mean square error over the colours of each pixel, white = 1."""
    return np.sqrt(np.mean((restored - truth) ** 2, axis=2))


def _draw_key(axes: "Axes", brightest: float) -> None:
    """Draws the scale of the maps of errors."""
    extent = (0, brightest * 100, 0, 1)
    axes.imshow(np.linspace(0, 1, 256)[None], cmap=MAP_COLOURS, extent=extent, aspect="auto")
    axes.set_box_aspect(0.12)
    axes.set_yticks([])
    axes.tick_params(labelsize="small")
    axes.set_xlabel("error / % of white", fontsize="small")
    axes.set_title("errors and PSNR:\nlinear light", fontsize="small")


def plot_capture(
    subject: object,
    captured: Float[np.ndarray, "rows columns channels"] | Mapping[str, np.ndarray],
    restored: Float[np.ndarray, "rows columns channels"],
    *,
    camera: str = "",
    decoder: str = "",
) -> "Figure":
    """Draws a capture beside its restoration, and beside the subject if that is a photograph.

    Of several frames each is shown as bright as the restoration: a short one is nearly black.
    """
    frames = dict(captured) if isinstance(captured, Mapping) else {"captured": captured}
    if len(frames) > 1:
        frames = dict(_as_bright(name, frame, restored) for name, frame in frames.items())
    names, last = list(frames), len(frames) - 1
    lines = textwrap.wrap(camera, _LETTERS_OF_A_PANEL) or [""]
    # Names of panels stand in one line.
    below = "\n" * len(lines)
    shown = {
        f"{names[k].replace('_', ' ')}" + (below if k else "\n".join(["", *lines])): frames[
            names[k]
        ]
        for k in sorted({0, (last + 1) // 2, last})
    }
    if isinstance(subject, Picture):
        shown = {f"the scene, at rest{below}": subject.light} | shown
    shown[f"restored\n{decoder}{below[1:]}"] = restored
    rows, columns = restored.shape[:2]
    width = 4.0
    height = float(np.clip(rows / columns, 1 / 16, 3.0))  # widths
    # A very long picture is stretched to its panel, so that it is visible.
    aspect = "auto" if max(rows / columns, columns / rows) > 16 else "equal"
    top = 0.45 + 0.14 * (len(lines) - 1)
    figure = new_figure(len(shown) * width + 0.2, width * height + 0.05 + top)
    margins = {"left": 0.1, "right": 0.1, "bottom": 0.05, "top": top, "columns": 0.1}
    leave_room(figure, num_rows=1, num_columns=len(shown), **margins)
    panels = figure.subplots(1, len(shown), squeeze=False)
    for axes, (title, picture) in zip(panels[0], shown.items(), strict=True):
        # Columns for which a panel has no dots are averaged.
        show_picture(axes, _shrunk(picture, max(1, columns // 1000)), title)
        axes.set_aspect(aspect, anchor="S")  # the title is above
    return figure


def _as_bright(name: str, frame: np.ndarray, restored: np.ndarray) -> tuple[str, np.ndarray]:
    """A frame of the mean light of its restoration, and a name that says how much that changes."""
    own, level = float(np.mean(frame)), float(np.mean(restored))
    times = level / own if own > 0 and level > 0 else 1.0
    if 0.8 < times < 1.25:
        return name, frame
    return f"{name}, shown {times:.2g} times as bright", times * frame


def _shrunk(picture: np.ndarray, times: int) -> np.ndarray:
    """A picture of means over squares of `times` px; incomplete squares at its ends are cut off."""
    if times == 1 or min(picture.shape[:2]) < times:
        return picture
    rows, columns = (size // times for size in picture.shape[:2])
    whole = picture[: rows * times, : columns * times]
    return whole.reshape(rows, times, columns, times, -1).mean(axis=(1, 3))


def show_picture(axes: "Axes", picture: np.ndarray, title: str) -> None:
    """Shows a picture in linear light on axes without ticks."""
    shown = to_display(picture)
    grey = shown.ndim == 2 or shown.shape[2] == 1
    axes.imshow(shown[..., 0] if grey and shown.ndim == 3 else shown, cmap="gray", vmin=0, vmax=1)
    axes.set_title(title, fontsize="small", y=1.0)  # otherwise matplotlib searches a place
    axes.axis("off")


def shown_name(name: str, most: int = 40) -> str:
    """A name as a picture shows it: shortened, and protected from matplotlib's markup.

    A dollar would begin a formula, a legend omits a name that begins with an underscore, and
    bytes of a file's name that are not text cannot be drawn.
    """
    name = name.encode("utf-8", "backslashreplace").decode()
    cut = name if len(name) <= most else f"{name[: most // 2 - 1]}…{name[-(most // 2) :]}"
    return f"{' ' if cut.startswith('_') else ''}{cut}".replace("$", r"\$")


def legend_above(axes: "Axes", **style: Any) -> None:
    """Writes the names of some lines above their panel, in at most three columns."""
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, **style)


def _legend(figure: "Figure", axes: "Axes", title: str | None = None) -> None:
    """Writes the names of the lines above all panels; the figure grows by their height."""
    handles, labels = axes.get_legend_handles_labels()
    columns = 2 if max(map(len, labels), default=0) <= 34 else 1
    num_lines = -(-len(labels) // columns) + (title is not None)
    place = 0.5, 1 - 0.05 / _grow(figure, above=LINE * (num_lines + 1))
    figure.legend(
        handles, labels, loc="upper center", bbox_to_anchor=place, ncols=columns, title=title
    )


def _grow(figure: "Figure", *, above: float = 0.0, below: float = 0.0) -> float:
    """Adds room above and below all panels, in inches; returns the new height."""
    width, before = figure.get_size_inches()
    height, room = before + above + below, figure.subplotpars
    figure.set_size_inches(width, height)
    figure.subplots_adjust(
        bottom=(room.bottom * before + below) / height,
        top=1 - ((1 - room.top) * before + above) / height,
    )
    return height


def line_styles(width: float = 1.6) -> Iterator[dict[str, Any]]:
    """Styles of lines, the first 49 of which differ: dashes move on by one in each round."""
    for index in count():
        turn, place = divmod(index, len(_COLOURS))
        dash = _DASHES[(place + turn) % len(_DASHES)]
        yield {"color": _COLOURS[place], "linestyle": dash, "linewidth": width}


def _new(
    num_panels: int, *, height: float = 4.2, share: bool = False
) -> "tuple[Figure, list[Axes]]":
    figure = new_figure(7.0, height * num_panels + 0.4)
    leave_room(figure, num_rows=num_panels)
    panels = figure.subplots(num_panels, 1, squeeze=False, sharex=share)
    for axes in panels[:, 0]:
        draw_grid(axes)
    return figure, list(panels[:, 0])


def draw_grid(axes: "Axes") -> None:
    """Draws pale grid lines behind the data."""
    axes.set_axisbelow(True)
    axes.grid(True, color="0.88", linewidth=0.6)


def _plot_plane(scene: Scene, burst: Exposures, title: str = "") -> "Figure":
    """Draws frames in the plane: their path, their places in time, and their velocities.

    Exposures are coloured one by one; the way between them is thin. The outline beside the
    velocities is that of the things.
    """
    from matplotlib.lines import Line2D

    figure = new_figure(7.4, 6.2)
    plane, hodograph = (figure.add_subplot(2, 2, place) for place in (1, 2))
    below = figure.add_subplot(2, 1, 2)
    for axes in (plane, hodograph, below):
        draw_grid(axes)
    path: FramePath = burst.frames  # type: ignore[assignment]
    begin = burst.lights[0][0]
    time = begin + np.linspace(0, burst.duration * (1 - 1e-9), 8 * _NUM_POINTS)
    place = np.asarray(path.place(time)) - np.outer(burst.pan, time)
    place = place - np.mean(place, axis=1)[:, None]
    ends = begin + np.append(0.0, np.cumsum(path.durations))
    velocity = np.stack([np.interp(time, ends, v) for v in np.asarray(path.velocities)])
    plane.plot(*place, color="0.7", linewidth=0.7)
    # Beside flights between frames the panel has no room for the velocities that count.
    hodograph.add_artist(Line2D(*velocity, color="0.7", linewidth=0.7, zorder=1))
    _shade(below, burst.lights)
    for (first, last), colour in zip(burst.lights, itertools.cycle(_COLOURS), strict=False):
        lit = (time >= first) & (time <= last)
        for axes, (x, y) in ((plane, place), (hodograph, velocity)):
            axes.plot(x[lit], y[lit], color=colour, linewidth=1.8)
    if scene.velocities is not None:
        angles = np.linspace(0, 2 * np.pi, _NUM_POINTS)
        hodograph.plot(
            *_outline(scene.velocities, angles), color="0.4", linestyle=":", label="things"
        )
        hodograph.legend(loc="upper right", fontsize="small")
    for axis, row, style in zip(("rows", "columns"), place, line_styles(), strict=False):
        below.plot(time * 1e3, row, label=f"along {axis}", **style)
    plane.set(xlabel="along rows / px", ylabel="along columns / px", title="path of the stage")
    hodograph.set(xlabel="along rows / px/s", ylabel="along columns / px/s", title="velocities")
    hodograph.locator_params(axis="x", nbins=5)
    for axes in (plane, hodograph):
        axes.set_aspect("equal", "datalim")
    below.set(xlabel="time from the middle / ms", ylabel="stage position / px")
    legend_above(below)
    _write_title(figure, title)
    figure.subplots_adjust(left=0.1, right=0.97, bottom=0.09, top=0.88, wspace=0.38, hspace=0.45)
    return figure


def _outline(law: AbstractVelocities, angles: Float[np.ndarray, "n"]) -> Float[np.ndarray, "2 n"]:
    """The outline of the least convex area that holds all velocities, by its tangents; px/s."""
    speeds, weights = (np.asarray(x) for x in law.components(angles, 2))
    ends = [np.where(weights > 0, speeds, sign * np.inf) for sign in (1, -1)]
    middle = (np.min(ends[0], axis=1) + np.max(ends[1], axis=1)) / 2
    reach = middle + law.half_range(angles)
    slope = np.gradient(reach, angles)
    cosine, sine = np.cos(angles), np.sin(angles)
    return np.stack([reach * cosine - slope * sine, reach * sine + slope * cosine])
