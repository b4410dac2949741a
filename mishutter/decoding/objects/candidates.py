"""The first velocities of things, and their first outlines, by what explains the frames."""

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from mishutter.decoding.objects.arrangement import Arrangement, Thing
from mishutter.decoding.objects.stills import Stills
from mishutter.pictures.registration.search import around, explained, searched
from mishutter.pictures.registration.sweep import Limits, Smoothed
from mishutter.pictures.registration.windows import Window

_LEAST_AREA = 60
"""Pixels that no other velocity explains: of a thing without texture, strips along its outline."""
_UNCERTAIN = 0.8
"""Error of a first velocity, over the frames by which it was found; px."""
_GREATEST = 0.04
"""Greatest square of a difference that counts within a known outline; white = 1."""


def candidates(stills: Stills, velocities: Float[np.ndarray, "n 2"] | None = None) -> Arrangement:
    """Things at the velocities that explain the frames.

    Args:
        stills: The frames.
        velocities: The velocities of the things, where they are known; px/s.
    """
    middle, frames = stills.middle, _even(stills)
    fine, rough = (Smoothed.of(frames, stills.times, sigma) for sigma in (1.0, 2.0))
    if velocities is None:
        limits = Limits(stills.fastest, stills.moves)
        found = searched(frames, (fine, rough), middle, _LEAST_AREA, limits)
        each, labels = found.velocities[1:], found.labels
    else:
        each, labels = list(velocities), explained(fine, velocities, middle)
    uncertain = _UNCERTAIN / fine.reach(middle, around(stills.count, middle, 1))
    things = []
    for number, velocity in enumerate(each, 1):
        own = ndimage.binary_opening(labels == number, iterations=2).astype(np.float32)
        # Frames were compared where things are in the middle frame, and not at the time 0.
        matte = ndimage.shift(own, -stills.ways(velocity)[middle], order=0)
        things.append(Thing(velocity, matte, velocity.copy(), uncertain))
    return Arrangement(stills, things, list(range(len(things))))


def within(
    stills: Stills,
    labels: Int[np.ndarray, "rows columns"],
    velocities: Float[np.ndarray, "n 2"] | None = None,
) -> Arrangement:
    """Things of known outlines, at the velocities that explain most of them.

    Args:
        stills: The frames.
        labels: Number of the thing that a pixel shows at the time 0, from 1; 0 for the background.
        velocities: The velocities of the things in that order, where they are known; px/s.
    """
    step = 1 / float(np.max(np.abs(stills.times)))
    things = []
    grid = _velocities(stills, step)
    middle = stills.light[stills.middle]
    for number in range(1, int(labels.max()) + 1):
        mask = labels == number
        if not mask.any():
            continue
        if velocities is not None:
            own = velocities[number - 1].astype(np.float64)
            things.append(Thing(own, mask.astype(np.float32), own.copy(), 2 * step))
            continue
        window = Window.around(mask, 0)
        inside = window.of(mask)
        costs = []
        for velocity in grid:
            ways = np.rint(stills.ways(velocity))
            own = window.taken(middle, ways[stills.middle])
            each = []
            for one, way in zip(stills.light, ways, strict=True):
                squares = np.minimum((window.taken(one, way) - own) ** 2, _GREATEST)
                each.append(squares[inside & window.seen(way, mask.shape)])
            costs.append(float(np.mean(np.concatenate(each))) if sum(map(len, each)) else np.inf)
        velocity = grid[int(np.argmin(costs))].astype(np.float64)
        things.append(Thing(velocity, mask.astype(np.float32), velocity.copy(), 2 * step))
    return Arrangement(stills, things, list(range(len(things))))


def _even(stills: Stills) -> Float[np.ndarray, "frames rows columns"]:
    """Frames of one level, and of about unit variance, at every level."""
    # Frames that are exposed a little longer have a little less noise.
    electrons = stills.light * np.mean(stills.electrons) + 0.375 + stills.read_noise**2
    return (2 * np.sqrt(np.maximum(electrons, 0))).astype(np.float32)


def _velocities(stills: Stills, step: float) -> Float[np.ndarray, "n 2"]:
    """Velocities up to the fastest, a step apart."""
    count = int(stills.fastest / step) + 1
    grid = Limits(moves=stills.moves).grid(np.arange(-count, count + 1) * step)
    return grid[np.hypot(*grid.T) <= stills.fastest + step]
