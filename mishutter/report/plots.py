"""Pictures of profiles, kernels, what they transfer, and restored photographs.

Every function returns a `matplotlib.figure.Figure`; nothing is shown and no global state
is touched. Lines differ in style as well as colour, so that they survive a grey printout.
"""

import io
import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import count, cycle
from pathlib import Path
from typing import Any, final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from mishutter._core import require, write_bytes
from mishutter.blur import support
from mishutter.evaluation import (
    kernel_phase,
    kernels_at_speeds,
    picture_power,
    spectral_levels,
)
from mishutter.hardware import DriveTable
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    Axis,
    DecoderSpeed,
    Picture,
    Scene,
    profile_of,
    to_display,
    turned,
)
from mishutter.report.layered import LayeredCapture, LayeredScene
from mishutter.restore import RestoredPhotograph

Named = Mapping[str, tuple[AbstractMotion, AbstractShutter]]
"""Designs by the name that a legend shows."""

_COLOURS = ("#0072b2", "#d55e00", "#000000", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)), (0, (1, 3)), (0, (8, 3)))
_MARKERS = ("o", "s", "^", "D", "v", "x", "P")
_NUM_POINTS = 1001
_LEAST_RATIO = -30.0
"""Signal over noise below which nothing is left to see; dB."""
_FIRST_ERROR = 0.01
"""Share of the error that lies below the frequency at which an axis begins."""
_DETAIL = (48, 64)
_RESTORED: Mapping[DecoderSpeed, str] = {
    "unknown": "restored",
    "found": "restored, speed found",
    "told": "restored, told speed",
}
"""Titles of restored details, by what the decoder knows of the speed."""
_LAYERED_WIDTH = 3.3
"""Of a panel of a layered scene, in inches."""
_ONE_FILTER = (
    "Each is restored by one filter, the best\nfor objects before a background, which\n"
    "is told no speed and no place.\n\n"
    "PSNR in linear light. Expected: of such\nlayers, whatever their places. Behind:\n"
    "where the object never was. In front:\nwhere it alone is."
)
_OTHER_WORLD = ": the verdict is of a picture that moves as a whole, and this one does not"
_CELL, _TITLE = 2.2, 0.4
"""Width of a magnified detail, and height of its title; inches."""
MAP_COLOURS = "cividis"
"""Of maps: from dark to light in print and to every eye."""
_BRIGHTEST_SHARE = 99
"""Of the errors in a map, the percentile that is drawn brightest."""
_DOTS_PER_INCH = 130
_PNG = {"compress_level": 4}
"""Half of the time of the usual level, for files that are a hundredth larger."""
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
    buffer, resolution = io.BytesIO(), figure.dpi
    figure.dpi = _DOTS_PER_INCH
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Glyph")  # a name in letters that the font lacks
            FigureCanvasAgg(figure).print_png(buffer, pil_kwargs=_PNG)  # `savefig` draws twice
    finally:
        figure.dpi = resolution
    return buffer.getvalue()


def plot_profiles(designs: Named) -> Figure:
    """Transmittance over the exposure, each design over its own time in ms."""
    figure, (axes,) = _new(1)
    tau = np.linspace(-1, 1, _NUM_POINTS)
    for (name, (motion, shutter)), style in zip(designs.items(), line_styles(), strict=False):
        half = float(motion.half_exposure) * 1e3
        dtype = np.dtype(motion.half_exposure.dtype)
        w, efficiency = profile_of(shutter, tau.astype(dtype))
        time, w = np.pad(tau * half, 1, "edge"), np.pad(w, 1)
        label = f"{shown_name(name)}, lets {efficiency:.0%} through"
        axes.plot(time, w, label=label, **style)
    axes.set(xlabel="time from mid-exposure / ms", ylabel="transmittance", ylim=(-0.02, 1.05))
    _legend(figure, axes)
    return figure


def plot_drive(table: DriveTable) -> Figure:
    """A drive table over the exposure: transmittance as designed and as driven; the sensor."""
    figure, (top, bottom) = _new(2, height=2.6)
    step = float(table.design.motion.exposure) * 1e3 / table.begin.size
    edges = np.append(table.begin * 1e3, table.begin[-1] * 1e3 + step)
    first, second, *_ = (style for style, _ in zip(line_styles(), range(2), strict=False))
    top.stairs(table.transmittance, edges, label=f"driven, {table.num_levels} levels", **first)
    top.plot(edges[:-1] + step / 2, table.wanted, label="designed", **second)
    top.set(ylabel="transmittance", ylim=(-0.02, 1.05))
    top.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    time, motion = np.linspace(edges[0], edges[-1], _NUM_POINTS), table.design.motion
    bottom.plot(time, np.asarray(motion.position(time * 1e-3)), **first)
    bottom.set(xlabel="time from mid-exposure / ms", ylabel="sensor position / px")
    return figure


def plot_kernels(designs: Named, speeds: Sequence[float]) -> Figure:
    """Blur kernels aligned at the vertex, and how each differs from that at the sensor's velocity.

    One row a design, on axes of its own, and one line a speed in px/s. Differences are given as
    shares of the kernel that they are from, in the root mean square.
    """
    figure = Drawing(figsize=(9.0, 1.9 * len(designs) + 0.7), layout="constrained")
    panels = figure.subplots(len(designs), 2, squeeze=False, sharex="row")
    for (left, right), (name, (motion, shutter)) in zip(panels, designs.items(), strict=True):
        velocity = float(motion.velocity)
        num_taps = int(max(_kernel_reach(motion, [*speeds, velocity]), 1)) + 2
        edges = np.arange(num_taps + 1) + float(kernel_phase(motion, num_taps))
        row = np.asarray([velocity, *speeds], motion.half_exposure.dtype)
        same, *kernels = np.asarray(kernels_at_speeds(shutter, motion, row, num_taps))
        for speed, taps, style in zip(speeds, kernels, line_styles(), strict=False):
            left.stairs(taps, edges, label=f"{speed:g} px/s", **style)
            share = np.linalg.norm(taps - same) / np.linalg.norm(same)
            if share > 0:
                right.stairs(taps - same, edges, label=f"{speed:g} px/s: {share:.0%}", **style)
        left.set_title(f"{shown_name(name, 26)}, {motion_text(motion)}", fontsize="medium")
        right.set_title(f"difference from the kernel at {velocity:.4g} px/s", fontsize="medium")
        right.axhline(0, color="0.4", linewidth=0.6)
        for axes, corner in ((left, "upper right"), (right, "lower right")):
            draw_grid(axes)
            axes.legend(fontsize="small", loc=corner)
            axes.set_ylabel("light per px")
    place = "position from the point of alignment / px"
    panels[-1, 0].set_xlabel(place)
    panels[-1, 1].set_xlabel(place)
    return figure


def _kernel_reach(motion: AbstractMotion, speeds: Sequence[float]) -> float:
    fastest = max(abs(speed - float(motion.velocity)) for speed in speeds)
    dtype = motion.half_exposure.dtype
    lengths = (float(support(motion, np.asarray(speed, dtype))) for speed in speeds)
    return max(*lengths, 2 * fastest * float(motion.half_exposure) + 1)


def motion_text(motion: AbstractMotion) -> str:
    """Exposure, stroke and pan of a motion, in words."""
    parts = [f"{float(motion.exposure) * 1e3:.3g} ms"]
    if float(motion.stroke) > 0:
        parts.append(f"stroke {float(motion.stroke):.3g} px")
    if float(motion.velocity) != 0:
        parts.append(f"pan {float(motion.velocity):.4g} px/s")
    return ", ".join(parts)


def plot_transfer(scene: Scene, designs: Named) -> Figure:
    """Signal over noise of each design at its own exposure, and the error that this leaves.

    Above, the picture's power over that of what disturbs it, noise and the spread between the
    scene's speeds. Beneath, the squared error that the best linear decoder leaves up to each
    frequency: at the last it is that of the expected PSNR. The axis begins where the first
    design has a hundredth of its error behind it.
    """
    figure, (ratios, errors) = _new(2, height=2.9, share=True)
    begin = 0.5
    for (name, (motion, shutter)), style in zip(designs.items(), line_styles(), strict=False):
        frequency, known, *_ = spectral_levels(scene, motion, shutter)
        ratio = np.asarray(known, np.float64)
        power = np.asarray(picture_power(scene, ratio.size, known.dtype), np.float64)
        error = np.cumsum(power / (1 + ratio)) / ratio.size
        begin = min(begin, frequency[np.argmax(error >= _FIRST_ERROR * error[-1])])
        with np.errstate(divide="ignore"):
            level, psnr = 10 * np.log10(ratio), -10 * np.log10(error[-1])
        shown = level >= _LEAST_RATIO
        ratios.semilogx(frequency, np.where(shown, level, np.nan), **style)
        label = f"{shown_name(name)}: {psnr:.2f} dB"
        errors.semilogx(frequency, error * 1e3, label=label, **style)
    ratios.set_ylabel("signal over noise / dB")
    errors.set(ylabel="squared error up to there / 10⁻³", ylim=(0, None))
    errors.set(xlabel="spatial frequency / (cycles/px)", xlim=(begin, 0.5))
    errors.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    _legend(figure, errors, "expected PSNR, linear light")
    return figure


def plot_psnr(results: Mapping[str, RestoredPhotograph], *, linear: bool = False) -> Figure:
    """PSNR of the restored photograph against object speed, with its standard error."""
    figure, (axes,) = _new(1)
    drawn = zip(results.items(), line_styles(), cycle(_MARKERS), strict=False)
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


def plot_layers(
    seen: LayeredScene,
    captures: Mapping[str, LayeredCapture],
    *,
    whole: bool = False,
    axis: Axis = "rows",
) -> Figure:
    """A background and an object in front of it, captured and restored by each of several cameras.

    Args:
        seen: The scene, which moves along its rows.
        captures: The results of `layered_captures`.
        whole: Whether the table beside it is of a picture that moves as a whole.
        axis: The axis along which the picture shows it moving.

    Raises:
        ValueError: if there is nothing to show.
    """
    require(len(captures) > 0, "plot_layers(captures=...)", "hold a capture", 0)
    truth = turned(seen.truth, axis)
    rows, columns = truth.shape[:2]
    height = _LAYERED_WIDTH * rows / columns + 1.4 * _TITLE
    across = 1 + len(captures)
    size = across * _LAYERED_WIDTH, 2 * height + _TITLE
    figure = Drawing(figsize=size, layout="constrained")
    panels = figure.subplots(2, across, squeeze=False)
    back, front = (layer.speed for layer in seen.layers.layers)
    kind = "still" if back == 0 else "moving"
    title = f"An object before a {kind} background{_OTHER_WORLD if whole else ''}"
    figure.suptitle(title, fontsize="medium")
    title = f"the scene: {back:g} px/s behind,\n{front:g} px/s in front, outlined"
    _show(panels[0, 0], truth, title)
    for colour, style in (("black", "-"), ("white", "--")):
        lines = {"colors": colour, "linestyles": style, "linewidths": 1.2}
        panels[0, 0].contour(turned(seen.matte, axis), [0.5], **lines)
    panels[1, 0].axis("off")
    panels[1, 0].text(0.5, 0.5, _ONE_FILTER, ha="center", va="center", fontsize="small")
    for (name, found), (top, bottom) in zip(captures.items(), panels.T[1:], strict=True):
        title = f"{shown_name(name, 30)}, {found.exposure * 1e3:.3g} ms,\ncaptured"
        _show(top, turned(found.captured, axis), title)
        levels = (
            f"expected {found.expected_psnr:.1f} dB, restored {found.psnr:.1f} dB\n"
            f"behind {found.background_psnr:.1f} dB, in front {found.object_psnr:.1f} dB"
        )
        _show(bottom, turned(found.restored, axis), levels)
    return figure


def plot_photograph(
    results: Mapping[str, RestoredPhotograph],
    speeds: Sequence[float],
    *,
    detail: tuple[int, int] = _DETAIL,
    linear: bool = False,
    axis: Axis = "rows",
    decoder_speed: DecoderSpeed = "unknown",
) -> Figure:
    """A detail of a photograph, magnified: captured, restored, and its error; one row a design.

    The detail is where the photograph varies most along the axis of motion, in the middle half of
    what all designs recorded of it. Errors of all panels have one scale. A PSNR is that of the
    whole photograph.

    Args:
        results: What `restore_photograph` gave for each design, of one photograph.
        speeds: The speeds to show, of each the nearest that was tried; px/s.
        detail: Extent of the detail across and along the axis; px.
        linear: Whether the PSNR and the errors are of linear light, not with gamma put back.
        axis: The axis along which the photograph moves.
        decoder_speed: What the decoder knew of the speed, as the scene says.

    Raises:
        ValueError: if there is nothing to show, or the photographs are not parts of one.
    """
    require(len(results) > 0, "plot_photograph(results=...)", "hold a result", 0)
    require(len(speeds) > 0, "plot_photograph(speeds=...)", "hold a speed", 0)
    results = {name: result.turned(axis) for name, result in results.items()}
    restoration = _RESTORED[decoder_speed]
    scene = next(iter(results.values())).reference
    offsets = [_offset(scene, result.reference) for result in results.values()]
    place = _busiest(scene, list(results.values()), offsets, detail)
    down, right = place if axis == "rows" else place[::-1]
    size = right.stop - right.start, down.stop - down.start
    height = _CELL * min(1.0, size[1] / size[0])
    across = 3 * len(speeds)
    shown = turned(scene, axis)
    top = min(2 * height, _CELL * (across - 2) * shown.shape[0] / shown.shape[1])
    heights = [top + _TITLE, *(height + _TITLE for _ in results)]
    figure = Drawing(figsize=(across * _CELL, sum(heights)), layout="constrained")
    grid = figure.add_gridspec(len(heights), across, height_ratios=heights)
    whole = figure.add_subplot(grid[0, : across - 2])
    _show(whole, shown, "the scene, at rest; the box is magnified")
    corner = right.start - 0.5, down.start - 0.5
    for colour, width in (("black", 3.0), ("white", 1.2)):
        whole.add_patch(Rectangle(corner, *size, fill=False, edgecolor=colour, linewidth=width))
    _show(figure.add_subplot(grid[0, -2]), shown[down, right], "the detail, at rest")
    maps = []
    for row, ((name, result), offset) in enumerate(zip(results.items(), offsets, strict=True), 1):
        own = place[0], slice(place[1].start - offset, place[1].stop - offset)
        levels = result.linear_psnr if linear else result.psnr
        for number, speed in enumerate(speeds):
            index = int(np.argmin(np.abs(result.speeds - speed)))
            captured, restored = result.captured[index], result.restored[index][own]
            gain = np.mean(result.reference) / max(float(np.mean(captured)), 1e-12)
            panels = [figure.add_subplot(grid[row, 3 * number + i]) for i in range(3)]
            title = f"{shown_name(name, 26)}, captured\nat {result.speeds[index]:g} px/s"
            _show(panels[0], turned(captured[own], axis) * gain, title)
            _show(panels[1], turned(restored, axis), f"{restoration},\n{levels[index]:.2f} dB")
            panels[2].set_title("error", fontsize="small", y=1.0)
            error = _error(result.reference[own], restored, linear)
            maps.append((panels[2], turned(error, axis)))
    brightest = float(np.percentile([error for _, error in maps], _BRIGHTEST_SHARE)) or 1.0
    for axes, error in maps:
        axes.imshow(error, cmap=MAP_COLOURS, vmin=0, vmax=brightest)
        axes.axis("off")
    _draw_key(figure.add_subplot(grid[0, -1]), brightest, linear)
    return figure


def _offset(reference: np.ndarray, other: np.ndarray) -> int:
    """Columns by which one part of a photograph begins to the right of another."""
    width, own = reference.shape[1], other.shape[1]
    for offset in sorted(range(1 - own, width), key=abs):
        first, last = max(0, offset), min(width, offset + own)
        if np.array_equal(reference[:, first:last], other[:, first - offset : last - offset]):
            return offset
    raise ValueError("`plot_photograph(results=...)` must be of one photograph; got several.")


def _busiest(
    scene: np.ndarray,
    results: Sequence[RestoredPhotograph],
    offsets: Sequence[int],
    size: tuple[int, int],
) -> tuple[slice, slice]:
    """Rows and columns where a photograph varies most along its rows, of those all recorded."""
    ends = (offset + each.reference.shape[1] for offset, each in zip(offsets, results, strict=True))
    first, last = max(offsets), min(ends)
    aside = min((last - first) // 4, max(0, (last - first - size[1]) // 2))
    seen = to_display(scene)[:, first + aside : last - aside].mean(axis=2)
    rows, columns = (min(pair) for pair in zip(size, seen.shape, strict=True))
    steps = np.diff(seen, axis=1, append=seen[:, -1:]) ** 2
    above = np.pad(steps, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    within = above[rows:] - above[:-rows]
    sums = within[:, columns:] - within[:, :-columns]
    row, column = (int(i) for i in np.unravel_index(np.argmax(sums), sums.shape))
    column += first + aside
    return slice(row, row + rows), slice(column, column + columns)


def _error(truth: np.ndarray, restored: np.ndarray, linear: bool) -> np.ndarray:
    """Root of the mean squared error over the colours of each pixel, white = 1."""
    pair = (truth, restored) if linear else (to_display(truth), to_display(restored))
    return np.sqrt(np.mean((pair[1] - pair[0]) ** 2, axis=2))


def _draw_key(axes: Axes, brightest: float, linear: bool) -> None:
    """The scale of maps of errors."""
    extent = (0, brightest * 100, 0, 1)
    axes.imshow(np.linspace(0, 1, 256)[None], cmap=MAP_COLOURS, extent=extent, aspect="auto")
    axes.set_box_aspect(0.12)
    axes.set_yticks([])
    axes.tick_params(labelsize="small")
    axes.set_xlabel("error / % of white", fontsize="small")
    axes.set_title(f"errors and PSNR:\n{_kind(linear)}", fontsize="small")


def plot_capture(
    seen: object,
    captured: np.ndarray,
    restored: np.ndarray,
    *,
    camera: str = "",
    decoder: str = "",
) -> Figure:
    """A capture beside what a decoder made of it, and the photograph if it was one.

    Args:
        seen: The subject.
        captured: Light in units of a fully open exposure.
        restored: Light of the picture, white = 1.
        camera: The shutter, its motion, and how fast the subject was, in words.
        decoder: The decoder, and how well it restored, in words.
    """
    shown = {f"captured\n{camera}": captured, f"restored\n{decoder}": restored}
    if isinstance(seen, Picture):
        shown = {"the scene, at rest\n": seen.light} | shown
    rows, columns = captured.shape[:2]
    width = 4.0
    height = float(np.clip(rows / columns, _LEAST_HEIGHT, _MOST_HEIGHT))
    stretched = max(rows / columns, columns / rows) > _MOST_ELONGATED
    size = (len(shown) * width + 0.2, width * height + 0.5)
    figure = Drawing(figsize=size, layout="constrained")
    panels = figure.subplots(1, len(shown), squeeze=False)
    for axes, (title, light) in zip(panels[0], shown.items(), strict=True):
        _show(axes, _shrunk(light, max(1, columns // _MOST_COLUMNS)), title)
        axes.set_aspect("auto" if stretched else "equal", anchor="S")  # the title is above
    return figure


def _shrunk(light: np.ndarray, times: int) -> np.ndarray:
    """A picture of means over squares of `times` px; what does not fill one is left out."""
    if times == 1 or min(light.shape[:2]) < times:
        return light
    rows, columns = (size // times for size in light.shape[:2])
    kept = light[: rows * times, : columns * times]
    return kept.reshape(rows, times, columns, times, -1).mean(axis=(1, 3))


def _show(axes: Axes, light: np.ndarray, title: str) -> None:
    shown = to_display(light)
    grey = shown.ndim == 2 or shown.shape[2] == 1
    axes.imshow(shown[..., 0] if grey and shown.ndim == 3 else shown, cmap="gray", vmin=0, vmax=1)
    axes.set_title(title, fontsize="small", y=1.0)  # without a place it is sought by the ticks
    axes.axis("off")


def shown_name(name: str, most: int = 40) -> str:
    """A name as a picture shows it: of `most` letters at most, and as text, whatever it holds.

    A dollar would begin a formula, and a legend leaves out what begins with an underscore.
    Bytes of a file's name that are no text have no letters.
    """
    name = name.encode("utf-8", "backslashreplace").decode()
    cut = name if len(name) <= most else f"{name[: most // 2 - 1]}…{name[-(most // 2) :]}"
    return f"{' ' if cut.startswith('_') else ''}{cut}".replace("$", r"\$")


def _legend(figure: Figure, axes: Axes, title: str | None = None) -> None:
    """Names of the lines above all panels, where they hide none; the figure grows by them."""
    handles, labels = axes.get_legend_handles_labels()
    columns = 2 if max(map(len, labels), default=0) <= _LETTERS_OF_A_COLUMN else 1
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, title=title)
    width, height = figure.get_size_inches()
    lines = -(-len(labels) // columns) + (title is not None)
    figure.set_size_inches(width, height + 0.2 * lines)


def line_styles() -> Iterator[dict[str, Any]]:
    """Lines of which no two of the first 49 are alike: dashes move on by one each round."""
    for index in count():
        turn, place = divmod(index, len(_COLOURS))
        dash = _DASHES[(place + turn) % len(_DASHES)]
        yield {"color": _COLOURS[place], "linestyle": dash, "linewidth": 1.6}


def _new(num_panels: int, *, height: float = 4.2, share: bool = False) -> tuple[Figure, list[Axes]]:
    figure = Drawing(figsize=(7.0, height * num_panels + 0.4), layout="constrained")
    panels = figure.subplots(num_panels, 1, squeeze=False, sharex=share)
    for axes in panels[:, 0]:
        draw_grid(axes)
    return figure, list(panels[:, 0])


def draw_grid(axes: Axes) -> None:
    """Pale lines behind all that is drawn."""
    axes.set_axisbelow(True)
    axes.grid(True, color="0.88", linewidth=0.6)
