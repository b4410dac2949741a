"""The paper's Figures 3 to 6, drawn so that they survive a grey printout.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mishutter.decoding.photographs import RestoredPhotograph
from mishutter.paper.numbers import KernelNumbers, SpectrumNumbers, SpeedNumbers
from mishutter.report.plots import show_picture

_STYLE = {
    "rect": {"color": "#000000", "linestyle": "-", "marker": "s"},
    "triangle": {"color": "#e69f00", "linestyle": ":", "marker": "^"},
    "hann": {"color": "#0072b2", "linestyle": "--", "marker": "o"},
    "gaussian": {"color": "#cc79a7", "linestyle": (0, (1, 1)), "marker": "D"},
    "optimised": {"color": "#d55e00", "linestyle": "-.", "marker": "*"},
}
_TITLE_SIZE = 10
_LEVEL = "PSNR, gamma 2.2 / dB"


def figure_3(numbers: KernelNumbers) -> Figure:
    """Draws the kernel difference at speed 0.5 and its RMS against speed, one row a reading."""
    figure = Figure(figsize=(10, 7), layout="constrained")
    axes = figure.subplots(2, 2)
    for row, (reading, kernels) in zip(axes, numbers["kernels"].items(), strict=True):
        for name, pair in kernels.items():
            difference = np.array(pair["moving"]) - np.array(pair["still"])
            row[0].plot(np.arange(difference.size), difference, **_line(name) | {"marker": ""})
            row[1].plot(numbers["speed"], numbers["rms"][reading][name], **_line(name))
        row[0].set(xlabel="position from the vertex / px", ylabel="difference of taps")
        row[0].set_title(f"(a) moving at 0.5 = {reading}, less still", fontsize=_TITLE_SIZE)
        row[1].set(xlabel=f"speed {reading}", ylabel="RMS difference of taps")
        row[1].set_title("(b) RMS difference from the still kernel", fontsize=_TITLE_SIZE)
    _finish(axes)
    return figure


def figure_4(numbers: SpectrumNumbers) -> Figure:
    """Draws Fourier magnitudes, with the condition numbers in the legend."""
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axes = figure.subplots()
    styles = (("#0072b2", "-"), ("#000000", "--"), ("#d55e00", ":"))
    for (name, values), (colour, dash) in zip(numbers["magnitude"].items(), styles, strict=True):
        computed, published = numbers["condition"][name], numbers["published"][name]
        label = f"{name}: condition {computed:.2f} (published {published:g})"
        axes.plot(numbers["frequency"], values, label=label, color=colour, linestyle=dash)
    axes.set(xlabel="frequency / (cycles/px)", ylabel="magnitude (open exposure = 1)")
    axes.set(yscale="log", xlim=(0, 0.5))
    title = (
        f"Blur kernels at a stroke of {numbers['stroke_px']:g} px, phase 0; "
        f"condition over a DFT of {numbers['dft_length']}"
    )
    axes.set_title(title, fontsize=_TITLE_SIZE)
    _finish(np.array([axes]))
    return figure


def figure_5(results: dict[str, dict[str, RestoredPhotograph]]) -> Figure:
    """Draws a photograph, captures and restorations at 0.1 and 0.3, a block for each reading."""
    figure = Figure(figsize=(12, 7.2), layout="constrained")
    axes = figure.subplots(2 * len(results), 4)
    for block, (reading, by_shutter) in enumerate(results.items()):
        for row, (name, result) in enumerate(by_shutter.items()):
            line = axes[2 * block + row]
            if row == 0:
                _show(line[0], result.reference, f"photograph ({reading})")
            else:
                line[0].axis("off")
            _show(line[1], result.captured[1], f"captured, {_label(name)}, 0.3")
            for column, speed in enumerate((0.1, 0.3)):
                title = f"{_label(name)}, {speed:g}: {result.psnr[column]:.1f} dB"
                _show(line[2 + column], result.restored[column], title)
    return figure


def figure_6(numbers: SpeedNumbers, readings: Iterable[str]) -> Figure:
    """Draws PSNR against speed, by both readings, and against noise, a row for each photograph."""
    names = list(numbers["psnr_over_noise"])
    figure = Figure(figsize=(13, 3.6 * len(names)), layout="constrained")
    axes = figure.subplots(len(names), 3, squeeze=False)
    for line, name in zip(axes, names, strict=True):
        for cell, reading in zip(line, readings, strict=False):
            for window, values in numbers["psnr_over_speed"][reading][name].items():
                cell.plot(numbers["speed"], values, **_line(window))
            cell.set(xlabel=f"speed {reading}", ylabel=_LEVEL)
            cell.set_title(f"{name}, against speed", fontsize=_TITLE_SIZE)
        for window, values in numbers["psnr_over_noise"][name].items():
            line[2].plot(numbers["electrons"], values, **_line(window))
        line[2].set(xlabel="photo-electrons at white / e-", ylabel=_LEVEL, xscale="log")
        title = f"{name}, against light, s/(2aT) = {numbers['noise_nu']:g}"
        line[2].set_title(title, fontsize=_TITLE_SIZE)
    _finish(axes)
    return figure


def _line(name: str) -> dict[str, object]:
    return {"label": _label(name), "markersize": 5, "linewidth": 1.3, **_STYLE[name]}


def _label(name: str) -> str:
    return name.capitalize() if name in ("hann", "gaussian") else name


def _show(axes: Axes, picture: np.ndarray, title: str) -> None:
    """Shows the middle of a picture, at most twice as wide as high."""
    columns = min(picture.shape[1], 2 * picture.shape[0])
    first = (picture.shape[1] - columns) // 2
    show_picture(axes, picture[:, first : first + columns], title)


def _finish(axes: np.ndarray) -> None:
    for cell in axes.ravel():
        cell.grid(alpha=0.3)
        cell.legend(fontsize=8)
