"""The picture of a scene: parts of a clip, averaged, with the spectrum of their light."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from mishutter.measurement.motion import Motion
from mishutter.measurement.photon_transfer import Law
from mishutter.pictures.images import Axis, transposed
from mishutter.pictures.registration.search import around
from mishutter.pictures.registration.sweep import Smoothed
from mishutter.pictures.registration.windows import Window

_LINE = 5.0
"""Power of a line in the spectrum over that beside it, from which on pixels are a mosaic's."""
_EMPTY = 0.1
"""Light and contrast of a background over those of what moves, below which it is empty."""
_SMOOTHING = 1.5
"""Gaussian under which frames are compared with the reference; px."""


class Averaged(NamedTuple):
    """A picture in levels, and how many frames it is worth at each pixel."""

    levels: Float[np.ndarray, "rows columns"]
    num_frames: Float[np.ndarray, "rows columns"]


def averaged(frames: np.ndarray, unit: np.ndarray, motion: Motion, frames_per_s: float) -> Averaged:
    """The reference frame, averaged with others where they show the same, and along objects."""
    reference = motion.frame
    total = np.zeros(frames.shape[1:])
    count = np.zeros(frames.shape[1:])
    own = ndimage.gaussian_filter(unit[reference], _SMOOTHING)
    # Of two frames of unit noise, under the Gaussian.
    usual = 2 / (4 * np.pi * _SMOOTHING**2)
    for k in range(len(frames)):
        if k == reference:
            is_alike = np.ones(total.shape, bool)
        else:
            residual = (ndimage.gaussian_filter(unit[k], _SMOOTHING) - own) ** 2 / usual
            is_alike = ndimage.gaussian_filter(residual, _SMOOTHING) < 3
        total += np.where(is_alike, frames[k], 0)
        count += is_alike
    mean = total / count
    near = around(len(frames), reference, 1)
    own_number = near.index(reference)
    splines = Smoothed.of(frames[near], np.array(near, np.float64), 0.0)
    for number, each in enumerate(motion.objects, 1):
        mask = motion.labels == number
        if not mask.any():
            continue
        box = Window.around(mask, 0)
        velocity = np.array(each.velocity) / frames_per_s
        values, seen = splines.along(velocity, own_number, range(len(near)), box)
        seen[own_number] = True
        inside = box.of(mask)
        along = np.where(seen, values, 0).sum(axis=0) / seen.sum(axis=0)
        box.of(mean)[inside] = along[inside]
        box.of(count)[inside] = seen.sum(axis=0)[inside]
    return Averaged(mean, count)


def is_empty(
    picture: Averaged,
    at_rest: Bool[np.ndarray, "rows columns"],
    law: Law,
    black: float,
) -> bool:
    """Whether what stands still is dark and shows nothing beside what moves.

    Its mean light and its contrast, less the noise, are a tenth of those of what moves, at most.
    """
    # Blurred outlines are of both.
    away = ndimage.gaussian_filter(at_rest.astype(float), 8.0)
    still, moving = away > 0.9, ~at_rest
    if not still.any() or not moving.any():
        return False
    noise = law(picture.levels) / picture.num_frames

    def light_and_contrast(mask: np.ndarray) -> tuple[float, float]:
        values = picture.levels[mask]
        return float(values.mean() - black), float(values.var() - noise[mask].mean())

    (rest, flat), (bright, varied) = map(light_and_contrast, (still, moving))
    return rest < _EMPTY * bright and flat < _EMPTY**2 * varied


def light_of_texture(
    picture: Averaged,
    shown: Bool[np.ndarray, "rows columns"],
    law: Law,
    ends: tuple[float, float],
    axis: Axis,
    *,
    mean: float | None = None,  # Mean light, white = 1; by default that of the whole picture
) -> Float[np.ndarray, "rows columns 1"]:
    r"""Light whose spectrum along an axis is that of some parts, less the noise, and its mean.

    The amplitude at $f$ is multiplied by $\sqrt{(P - N)/Q}/\operatorname{sinc} f$, of the power $Q$
    of all lines, that of these parts $P$, under a window that falls to 0 at their outlines, and
    their noise $N$: a scene is seen through its pixels again. Lines go on mirrored.
    """
    black, white = ends
    inside = 2 * ndimage.gaussian_filter(shown.astype(float), 4.0) - 1
    window = transposed(np.maximum(inside, 0), axis)
    if window.mean() < 0.05:  # so little shows no spectrum
        window = np.ones_like(window)
    light = transposed((picture.levels - black) / (white - black), axis)
    variance = transposed(law(picture.levels) / picture.num_frames, axis) / (white - black) ** 2
    noise = float(np.average(variance, weights=window**2))
    still = light - np.average(light, weights=window)
    power = _power(window * still) / np.mean(window**2)
    # A little is kept, however little is signal.
    signal = np.maximum(power - noise, 0.02 * power)
    mirrored = _mirrored(light - light.mean())
    gain = np.sqrt(signal / np.maximum(_power(light - light.mean()), 1e-30))
    gain /= np.sinc(np.fft.rfftfreq(mirrored.shape[1]))
    filtered = np.fft.irfft(np.fft.rfft(mirrored) * gain, mirrored.shape[1])[:, : light.shape[1]]
    lit = np.clip(filtered + (light.mean() if mean is None else mean), 0, 1)
    return transposed(lit[..., None], axis).astype(np.float32)


def _mirrored(lines: np.ndarray) -> np.ndarray:
    return np.concatenate([lines, lines[:, ::-1]], axis=1)


def _power(lines: np.ndarray) -> Float[np.ndarray, "frequencies"]:
    """Power of lines that go on mirrored, averaged over neighbouring frequencies."""
    power = np.mean(np.abs(np.fft.rfft(_mirrored(lines))) ** 2, axis=0) / (2 * lines.shape[1])
    width = max(3, power.size // 32)
    return np.maximum(ndimage.uniform_filter1d(power, width, mode="nearest"), 1e-30)


def is_mosaic(picture: Float[np.ndarray, "rows columns"]) -> bool:
    """Whether pixels repeat with a period of 2 or 4 along both axes, as under filters of colours.

    Light has no such lines in its spectrum: its power falls towards high frequencies.
    """
    return any(all(_has_line(lines, period) for lines in (picture, picture.T)) for period in (2, 4))


def _has_line(lines: np.ndarray, period: int) -> bool:
    """Whether the power about a period is several times that to either side of it."""
    window = np.hanning(lines.shape[1])
    power = np.mean(np.abs(np.fft.rfft((lines - lines.mean()) * window)) ** 2, axis=0)
    away = np.abs(np.fft.rfftfreq(lines.shape[1]) - 1 / period)
    sides = power[(away > 0.04) & (away < 0.1)]
    return bool(power[away <= 1 / lines.shape[1]].mean() > _LINE * np.median(sides))
