"""Frames of a picture that moves as a whole, cut to what all of them show.

A camera that pans, or a belt that fills the picture, moves all detail alike. Frames are registered
by whole pixels, which changes no noise.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from mishutter.measurement.clip import LEAST_SIDE
from mishutter.measurement.steady import MOST_PIXELS, moves_of
from mishutter.pictures.registration.windows import means

_COARSE = 8.0
"""Gaussian whose light is no detail; px."""
_FARTHEST = 0.125
"""Way from the frame that others are compared with, as a share of the sides, at the next."""
_SIDE = 16
"""Side of blocks that tell whether detail moves; px."""
_CERTAIN = 1.6
"""Ratio of two variances of a block that noise has in one of ten thousand."""
_WHOLE = 0.9
"""Share of the blocks that tell, which must move for all detail to do so."""
_LEAST_TOLD = 2 / 3
"""Share of all blocks that must move: dull ones may stand still, and hold no pattern then."""


class Registered(NamedTuple):
    """Successive frames of a clip, cut to what all of them show."""

    frames: Float[np.ndarray, "frames rows columns"]  # Levels, as files hold them
    ways: Int[np.ndarray, "frames 2"]  # How far each picture has moved, down and across; px


def registered(frames: Float[np.ndarray, "frames rows columns"]) -> Registered | None:
    """The frames of a picture of which all detail moves alike; None of any other."""
    ways = _ways(frames)
    if not ways.any():
        return None
    run = _longest(ways, frames.shape[1:])
    if run is None:
        return None
    frames, ways = frames[run], ways[run]
    for _ in range(4):
        left = np.rint(moves_of(_cut(frames, ways))[0]).astype(int)
        if not left.any():
            break
        ways = ways + left
        if min(np.array(frames.shape[1:]) - np.ptp(ways, axis=0)) < LEAST_SIDE:
            return None
    if not _is_whole(frames, ways):
        return None
    return Registered(_cut(frames, ways), ways)


def _ways(frames: np.ndarray) -> Int[np.ndarray, "frames 2"]:
    """Ways of the picture since the middle frame, by peaks of the correlation of detail."""
    scale = 1 + int(np.sqrt(frames[0].size / MOST_PIXELS))
    shape = np.array(frames.shape[1:]) // scale
    window = np.outer(*map(np.hanning, shape))
    spectra = []
    for frame in frames:
        small = means(frame, scale)
        detail = small - ndimage.gaussian_filter(small, _COARSE)
        most = 3 * detail.std()  # A few pixels that are stuck, or shine, do not count alone.
        spectra.append(np.fft.rfft2(np.clip(detail, -most, most) * window))
    ways, middle = np.zeros((len(frames), 2), int), len(frames) // 2
    for numbers in (range(middle + 1, len(frames)), range(middle - 1, -1, -1)):
        origin = middle
        for k in numbers:
            product = spectra[k] * np.conj(spectra[origin])
            # Half as white as noise would have it, the peak is narrow and yet above the noise.
            power = np.abs(product)
            white = product / np.sqrt(np.maximum(power, 1e-9 * power.max() + 1e-30))
            peak = np.argmax(np.fft.irfft2(white, tuple(shape)))
            step = np.array(np.unravel_index(peak, tuple(shape)))
            step = (step + shape // 2) % shape - shape // 2
            ways[k] = ways[origin] + step
            if np.max(np.abs(step) / shape) > _FARTHEST:
                origin = k
    return scale * ways


def _longest(ways: np.ndarray, shape: tuple[int, ...]) -> slice | None:
    """The successive frames whose pairs have most pixels in common with all; None for too few."""
    best, most = None, 0.0
    for first in range(len(ways)):
        for last in range(first + 1, len(ways)):
            sides = np.array(shape) - np.ptp(ways[first : last + 1], axis=0)
            pixels = float(np.prod(sides)) * (last - first)
            if min(sides) >= LEAST_SIDE and pixels > most:
                best, most = slice(first, last + 1), pixels
    return best


def _cut(frames: np.ndarray, ways: np.ndarray) -> np.ndarray:
    """Frames, cut to what all of them show."""
    rows, columns = np.array(frames.shape[1:]) - np.ptp(ways, axis=0)
    begins = ways - ways.min(axis=0)
    pairs = zip(frames, begins, strict=True)
    return np.stack([frame[y : y + rows, x : x + columns] for frame, (y, x) in pairs])


def _is_whole(frames: np.ndarray, ways: np.ndarray) -> bool:
    """Whether, where anything tells, the picture moves: of the two frames that are farthest apart.

    Blocks differ by noise alone along the way that they go.
    """
    apart = np.sum((ways - ways[0]) ** 2, axis=1)
    pair = [0, int(np.argmax(apart))]
    first, second = _cut(frames[pair], ways[pair])
    y, x = ways[0] - np.min(ways[pair], axis=0)
    rows, columns = first.shape
    there = frames[pair[1]][y : y + rows, x : x + columns]
    along, rest = (
        means(change**2, _SIDE) - means(change, _SIDE) ** 2
        for change in (first - second, first - there)
    )
    moving, still = np.sum(rest > _CERTAIN * along), np.sum(along > _CERTAIN * rest)
    return bool(moving > _WHOLE * (moving + still) and moving > _LEAST_TOLD * along.size)
