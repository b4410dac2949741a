"""Pictures of a measured clip: variance over mean, and what moves where."""

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from mishutter.measurement.scene import Measurement
from mishutter.pictures.images import to_display
from mishutter.report.plots import MAP_COLOURS, leave_room, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#f0e442")
_PALE = 0.45
"""Share of an object's colour in the picture of labels."""


def plot_noise(measurement: Measurement) -> "Figure":
    """The variance of levels over their mean, by blocks at rest, and the line through it."""
    noise = measurement.noise
    figure = new_figure(7.0, 4.4)
    leave_room(figure, top=0.35)
    axes = figure.add_subplot()
    axes.set(xlabel="mean level", ylabel="variance of a level, levels$^2$")
    if noise.transfer is None:
        axes.set_title("Photon transfer: too little stands still", fontsize=9)
        return figure
    level, variance, error, _ = noise.transfer.curve()
    style = {"markersize": 4, "capsize": 2, "color": "#000000"}
    bars = axes.errorbar(level, variance, 2 * error, fmt="o", label="blocks at rest", **style)
    bars[0].set_clip_on(False)
    line = np.linspace(noise.black_level, level.max() * 1.03, 101)
    rise = "line" if noise.gain is None else f"line, {noise.gain.value:.3g} levels an electron"
    axes.plot(line, noise.law(line), color=_COLOURS[1], label=rise)
    if noise.black is not None:
        label = f"black, {noise.black.value:.4g}"
        axes.axvline(noise.black.value, color=_COLOURS[0], linestyle="--", label=label)
    else:
        axes.axvspan(*noise.black_range, color="0.85", label="black lies here")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8)
    axes.set_title(f"Photon transfer: {_noise_text(measurement)}", fontsize=9)
    return figure


def _noise_text(measurement: Measurement) -> str:
    noise = measurement.noise
    if noise.electrons_at_white is None:
        return f"no number, because {noise.refusals[-1].reason}"
    value, error = noise.electrons_at_white
    text = f"{value:.4g} +- {error:.2g} e- at white"
    if noise.read_noise_range is not None:
        low, high = noise.read_noise_range
        return f"{text}, read noise {low:.2g} to {high:.2g} e-"
    if noise.read_noise is None:
        return f"{text}, read noise not known"
    return f"{text}, read noise {noise.read_noise.value:.3g} +- {noise.read_noise.error:.2g} e-"


def plot_motion(measurement: Measurement) -> "Figure":
    """The reference frame with its objects and their velocities, and the trust in that."""
    from matplotlib.colors import to_rgb

    clip, motion = measurement.clip, measurement.motion
    rows, columns = motion.labels.shape
    width = 4.6
    figure = new_figure(2 * width, (width - 0.45) * min(max(rows / columns, 0.3), 3) + 0.5)
    leave_room(figure, left=0.1, right=0.6, bottom=0.1, top=0.4, columns=0.2, num_columns=2)
    left, right = figure.subplots(1, 2)
    black = measurement.noise.black_level
    light = (clip.frames[motion.frame] - black) / (clip.white - black)
    top = max(float(np.quantile(light, 0.995)), 1e-6)
    shown = np.repeat(to_display(light / top)[..., None], 3, axis=2)
    for number in range(1, int(motion.labels.max()) + 1):
        mask = motion.labels == number
        colour = np.array(to_rgb(_COLOURS[(number - 1) % len(_COLOURS)]))
        edge = mask & (np.asarray(ndimage.binary_erosion(mask, iterations=2)) == 0)
        shown[mask] = (1 - _PALE) * shown[mask] + _PALE * colour
        shown[edge] = colour
    shown[motion.labels < 0] = 0.5 * shown[motion.labels < 0] + 0.25
    left.imshow(shown)
    _draw_arrows(left, measurement)
    unexplained = motion.share_unexplained
    text = f"{motion.share_at_rest:.0%} at rest"
    text += f", {unexplained:.1%} without a velocity (grey)" if unexplained > 0.005 else ""
    left.set_title(f"frame {motion.frame + 1}: {text}; arrows in px/s", fontsize=9)
    image = right.imshow(motion.trust, vmin=0, vmax=1, cmap=MAP_COLOURS)
    right.set_title("trust in the velocity of each pixel", fontsize=9)
    box = right.get_position()
    bar = figure.add_axes((box.x1 + 0.008, box.y0, 0.012, box.height))
    figure.colorbar(image, cax=bar)
    for axes in (left, right):
        axes.set_xticks([])
        axes.set_yticks([])
    return figure


def _draw_arrows(axes: "Axes", measurement: Measurement) -> None:
    """An arrow and the speed of each object in the frame that is shown."""
    motion = measurement.motion
    shown = [n for n in range(1, len(motion.objects) + 1) if np.any(motion.labels == n)]
    fastest = max((motion.objects[n - 1].speed.value for n in shown), default=1.0)
    side = min(motion.labels.shape)
    for number in shown:
        each = motion.objects[number - 1]
        row, column = np.argwhere(motion.labels == number).mean(axis=0)
        down, right = each.velocity
        size = max(each.speed.value, 1e-9)
        length = side * max(0.2 * size / fastest, 0.06)  # an arrow of a slow object is seen too
        end = column + right / size * length, row + down / size * length
        arrow = {"arrowstyle": "-|>", "color": "white", "linewidth": 2}
        axes.annotate("", end, (column, row), arrowprops=arrow)
        box = {"facecolor": "black", "alpha": 0.6, "linewidth": 0, "pad": 1.5}
        text = f"{number}: {size:.0f} +- {each.speed.error:.1g}"
        style = {"color": "white", "fontsize": 8, "ha": "center", "bbox": box}
        # On the side that the arrow does not point to.
        above = bool(down > 0)
        place = {"xytext": (0, 6 if above else -6), "textcoords": "offset points"}
        axes.annotate(text, (column, row), va="bottom" if above else "top", **place, **style)
