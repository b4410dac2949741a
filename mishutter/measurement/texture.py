"""The picture of a scene: the still parts of a clip, averaged, with the spectrum of their light."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from mishutter.measurement.motion import Motion
from mishutter.measurement.photon_transfer import Law
from mishutter.measurement.sweep import Box, Smoothed
from mishutter.pictures import Axis, turned

_AROUND = 2
"""Frames to either side along which an object is averaged."""
_ALIKE, _SMOOTHING = 3.0, 1.5
"""Residual over noise up to which a frame shows the same as the reference, under a Gaussian; px."""
_LEAST_SIGNAL = 0.02
"""Share of the power at a frequency that is kept however little of it is signal."""
_SMOOTH_SHARE = 32


class Averaged(NamedTuple):
    """A picture in levels, and how many frames it is worth at each pixel."""

    levels: Float[np.ndarray, "rows columns"]
    num_frames: Float[np.ndarray, "rows columns"]


def averaged(frames: np.ndarray, unit: np.ndarray, motion: Motion, frames_per_s: float) -> Averaged:
    """The reference frame, averaged with others where they show the same, and along objects.

    Args:
        frames: Levels; `(frames, rows, columns)`.
        unit: The same in units of their noise.
        motion: Objects, and where they are in the reference frame.
        frames_per_s: Frames a second.
    """
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
            is_alike = ndimage.gaussian_filter(residual, _SMOOTHING) < _ALIKE
        total += np.where(is_alike, frames[k], 0)
        count += is_alike
    mean = total / count
    near = range(max(0, reference - _AROUND), min(len(frames), reference + _AROUND + 1))
    splines = Smoothed.of(frames[near.start : near.stop], 0.0)
    for number, each in enumerate(motion.objects, 1):
        mask = motion.labels == number
        if not mask.any():
            continue
        box = Box.around(mask)
        velocity = np.array(each.velocity) / frames_per_s
        numbers = range(len(near))
        values, seen = splines.along(velocity, reference - near.start, numbers, box)
        seen[reference - near.start] = True
        inside = box.of(mask)
        along = np.where(seen, values, 0).sum(axis=0) / seen.sum(axis=0)
        box.of(mean)[inside] = along[inside]
        box.of(count)[inside] = seen.sum(axis=0)[inside]
    return Averaged(mean, count)


def light_of_texture(
    picture: Averaged, law: Law, black: float, white: float, axis: Axis
) -> Float[np.ndarray, "rows columns 1"]:
    r"""Light whose spectrum along an axis is the picture's, less the noise, without the pixels.

    The amplitude at $f$ is multiplied by $\sqrt{(P - N)/P}/\operatorname{sinc} f$, of the power $P$
    of the lines, mirrored at their ends, and that of the noise $N$: a scene is seen through its
    pixels again.

    Args:
        picture: Levels, and the frames that they are worth.
        law: Variance of a level in one frame.
        black: Level of black.
        white: Level of white.
        axis: Axis of the motion.
    """
    noise = float(np.mean(law(picture.levels) / picture.num_frames)) / (white - black) ** 2
    light = turned((picture.levels - black) / (white - black), axis)
    mirrored = np.concatenate([light, light[:, ::-1]], axis=1)
    spectrum = np.fft.rfft(mirrored - light.mean(), axis=1)
    power = np.mean(np.abs(spectrum) ** 2, axis=0) / mirrored.shape[1]
    width = max(3, power.size // _SMOOTH_SHARE)
    smooth = np.maximum(ndimage.uniform_filter1d(power, width, mode="nearest"), 1e-30)
    share = np.clip((smooth - noise) / smooth, _LEAST_SIGNAL, 1)
    gain = np.sqrt(share) / np.sinc(np.arange(power.size) / mirrored.shape[1])
    filtered = np.fft.irfft(spectrum * gain, mirrored.shape[1], axis=1)[:, : light.shape[1]]
    shown = np.clip(filtered + light.mean(), 0, 1)
    return turned(shown[..., None], axis).astype(np.float32)
