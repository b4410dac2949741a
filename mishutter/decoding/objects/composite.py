"""The picture of all layers at one instant, and where to trust it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from mishutter.decoding.objects.arrangement import Arrangement
from mishutter.decoding.objects.grids import Mask, Window, smoothed, splines
from mishutter.decoding.objects.light import Layers, Misfit, explaining
from mishutter.decoding.objects.stills import Stills

_UNEXPLAINED = 2.5
"""Mean square of a residual over its noise from which on a pixel is another frame's own."""
_MOST_MISFIT = 1.5
"""Mean square of the residuals along a layer, over its expectation, of pixels that are trusted."""
_AWAY = 2.0
"""Pixels from an outline within which none is trusted."""


class Composite(NamedTuple):
    """A picture of layers."""

    light: Float[np.ndarray, "rows columns"]
    # Mean square, over their noise, of the residuals of the frames that see a pixel's layer there
    misfit: Float[np.ndarray, "rows columns"]
    num_seen: Float[np.ndarray, "rows columns"]  # Frames that do
    single: Mask  # Share of the frame nearest to the instant, restored alone


def labels_of(arrangement: Arrangement) -> Int[np.ndarray, "rows columns"]:
    """Number of the thing that a pixel shows at the time 0, from 1; 0 for the background."""
    return np.argmax(arrangement.alphas(), axis=0)


def trusted(arrangement: Arrangement, found: Composite) -> Bool[np.ndarray, "rows columns"]:
    """Pixels that the frames agree on, away from outlines."""
    alphas, labels = arrangement.alphas(), labels_of(arrangement)
    edge = np.max(alphas, axis=0) < 0.9
    edge[:-1] |= labels[1:] != labels[:-1]
    edge[:, :-1] |= labels[:, 1:] != labels[:, :-1]
    is_away = np.ones(edge.shape, bool)
    if edge.any():
        is_away = np.asarray(ndimage.distance_transform_edt(~edge)) > _AWAY
    agree = (found.misfit < _MOST_MISFIT) & (found.single < 0.5)
    return agree & (found.num_seen > 1.5) & is_away


def composite(
    arrangement: Arrangement, misfit: Misfit, layers: Layers, one: np.ndarray
) -> Composite:
    """The picture of layers at the time 0.

    Where they do not explain the frame nearest to it, that frame restored alone stands instead.

    Args:
        arrangement: The things.
        misfit: Misfit of the layers.
        layers: Light of each on its canvas.
        one: That frame restored alone.
    """
    sight, shape = misfit.sight, arrangement.stills.shape
    stills = sight.stills  # of one colour
    # A prior bends edges, which would count as unexplained.
    model = sight.frames(explaining(misfit))
    noise = [stills.noise(smoothed(np.maximum(one, 0), 0.7), k) for k, one in enumerate(model)]
    squares = (stills.light - model) ** 2 / np.stack(noise)
    middle = stills.middle
    doubt = np.clip((smoothed(squares[middle], 1.0) - _UNEXPLAINED) / 2, 0, 1)
    spline = splines(one[None])[0]
    light, single = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    mean_square, num_seen = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    labels = labels_of(arrangement)
    seen = [arrangement.ground, *(arrangement.seen(n) for n in range(len(arrangement.things)))]
    velocities = [np.zeros(2), *(thing.velocity for thing in arrangement.things)]
    whole = Window.whole(shape)
    for number, (alpha, velocity) in enumerate(zip(arrangement.alphas(), velocities, strict=True)):
        sheet = sight.sheets[number]
        own = whole_of(sheet.window, layers[number], shape)
        window = whole if number == 0 else Window.around(alpha, 4)
        share, here = window.of(alpha), window.of(own).copy()
        way = velocity * stills.times[middle]
        weight = window.taken(doubt, way) * window.seen(way, shape)
        here += weight * (window.taken(spline, way, is_spline=True) - here)
        window.of(single)[...] += share * weight
        window.of(light)[...] += share * here
        total, count = _along(stills, (squares, seen[number]), velocity, window)
        known = count > 1.5
        left = smoothed(np.where(known, total, 0), 2.0)
        least = smoothed(np.where(known, count - 1, 0), 2.0)
        is_own = window.of(labels) == number
        window.of(mean_square)[is_own] = (left / np.maximum(least, 1e-3))[is_own]
        window.of(num_seen)[is_own] = count[is_own]
    return Composite(light, mean_square, num_seen, single)


def whole_of(window: Window, part: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """A picture of zeros but for a part, which may lie beyond it."""
    whole = np.zeros(shape, np.float32)
    window.add(whole, part)
    return whole


def _along(
    stills: Stills,
    stack: tuple[np.ndarray, np.ndarray],
    velocity: np.ndarray,
    window: Window,
) -> tuple[np.ndarray, np.ndarray]:
    """Sum of squares over the frames that see a layer, and their number, where it is at 0."""
    squares, shares = stack
    total = np.zeros((window.rows, window.columns), np.float32)
    count = np.zeros_like(total)
    for way, square, share in zip(stills.ways(velocity), squares, shares, strict=True):
        sees = window.seen(way, stills.shape) & (window.taken(share, way) > 0.95)
        total += np.where(sees, window.taken(square, np.rint(way)), 0)
        count += sees
    return total, count
