"""The velocities that explain windows of frames, and the first outlines.

Beginning with rest, the velocity is taken that explains most of what those before it do not, until
none explains more than a window's worth.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from mishutter.decoding.objects.arrangement import Arrangement, Thing
from mishutter.decoding.objects.grids import Window, smoothed, splines
from mishutter.decoding.objects.stills import Stills

_SMOOTHING = 0.6
"""Gaussian under which the frames are compared, on larger pixels."""
_MOST_VELOCITIES = 5000
"""Velocities that are tried, at most, on the smallest pixels: fast things are sought on larger."""
_GRAIN = 8
"""Distance of windows; px."""
_WINDOW, _STRIP = 26, 10
"""Sides of windows; px. A thing without texture is told by the strips along
its outline alone, where the background about them would hide that in wide windows."""
_MOST = 6.0
"""Greatest square of a difference that counts, in variances: more is something hidden."""
_MARGIN, _STRIP_MARGIN = 1.0, 1.5
"""Mean squares, in variances, by which a velocity has to be better than those before it."""
_LEAST = 2.0
"""Windows' worth of that gain below which no velocity is taken."""
_MOST_THINGS = 6
_GREATEST = 0.04
"""Greatest square of a difference that counts within a known outline; white = 1."""
_REST = 0.3
"""Lead that rest has where nothing tells."""


def candidates(stills: Stills, velocities: Float[np.ndarray, "n 2"] | None = None) -> Arrangement:
    """Things at the velocities that explain the frames, with outlines of eight pixels' grain.

    Args:
        stills: The frames.
        velocities: The velocities of the things, where they are known; px/s.
    """
    shape, middle = stills.shape, stills.middle
    order = np.argsort(np.abs(stills.times - stills.times[middle]))
    near = [int(k) for k in order if k != middle][:3]
    ways = stills.times - stills.times[middle]
    longest, size = float(np.max(np.abs(ways[near]))), 2
    grid = _velocities(stills, size / longest)
    while len(grid) > _MOST_VELOCITIES and size < _GRAIN:
        size *= 2
        grid = _velocities(stills, size / longest)
    step = size / longest
    if velocities is not None:
        grid = np.vstack([np.zeros((1, 2)), velocities])
    rows, columns = (n // size for n in shape)
    frames = _even(stills, (rows, columns), size)
    sides = [2 * round(side / size / 2) + 1 for side in (_WINDOW, _STRIP)]
    stride = _GRAIN // size
    most = int(np.ceil(np.max(np.abs(grid)) * longest / size)) + 2
    padded = np.pad(frames, ((0, 0), (most, most), (most, most)), constant_values=1e3)
    left = float(np.sum(smoothed(np.pad(np.ones((1, 1)), 8), _SMOOTHING) ** 2))

    def cost(velocity: np.ndarray) -> np.ndarray:
        total = np.zeros((rows, columns), np.float32)
        for k in near:
            down, across = np.rint(velocity * ways[k] / size).astype(int) + most
            other = padded[k, down : down + rows, across : across + columns]
            total += np.minimum((other - frames[middle]) ** 2 / (4 * left), _MOST)
        means = [ndimage.uniform_filter(total, side, mode="nearest") for side in sides]
        return np.stack(means)[:, stride // 2 :: stride, stride // 2 :: stride] * (3 / len(near))

    costs = np.stack([cost(velocity) for velocity in grid], axis=1)
    margins = np.array([_MARGIN, _STRIP_MARGIN])[:, None, None, None]
    found = [int(np.argmin(np.hypot(*grid.T)))]
    if velocities is not None:
        found = list(range(len(grid)))
    for _ in range(_MOST_THINGS if velocities is None else 0):
        best = np.min(costs[:, found], axis=1, keepdims=True)
        gains = np.maximum(best - costs - margins, 0)
        gain = np.max(np.sum(gains, axis=(2, 3)), axis=0) * (_GRAIN / _WINDOW) ** 2
        for one in found:
            gain[np.all(np.abs(grid - grid[one]) < 1.5 * step, axis=1)] = 0
        if np.max(gain) < _LEAST:
            break
        found.append(int(np.argmax(gain)))
    leads = np.where(np.arange(len(found)) > 0, _REST, 0.0)
    leading = costs[:, found] + leads[:, None, None]
    labels = np.argmin(leading[0], axis=0)
    # What wide windows take for rest may be a strip of something else.
    strips = np.argmin(leading[1] + _STRIP_MARGIN * leads[:, None, None] / _REST, axis=0)
    labels = np.where(labels > 0, labels, strips)
    # Windows were compared where things are in the middle frame, and not at the time 0.
    fine = np.kron(labels, np.ones((_GRAIN, _GRAIN), int))
    fine = np.pad(fine, ((0, _GRAIN), (0, _GRAIN)), mode="edge")[: shape[0], : shape[1]]
    things = []
    for number, one in enumerate(found[1:], 1):
        velocity = grid[one].astype(np.float64)
        back = -stills.ways(velocity)[middle]
        matte = ndimage.shift((fine == number).astype(np.float32), back, order=0)
        things.append(Thing(velocity, matte, velocity.copy(), 0.4 * step))
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
    coefficients, things = splines(stills.light), []
    grid = _velocities(stills, step)
    middle = coefficients[stills.middle]
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
            for one, way in zip(coefficients, ways, strict=True):
                squares = np.minimum((window.taken(one, way) - own) ** 2, _GREATEST)
                each.append(squares[inside & window.seen(way, mask.shape)])
            costs.append(float(np.mean(np.concatenate(each))) if sum(map(len, each)) else np.inf)
        velocity = grid[int(np.argmin(costs))].astype(np.float64)
        things.append(Thing(velocity, mask.astype(np.float32), velocity.copy(), 2 * step))
    return Arrangement(stills, things, list(range(len(things))))


def _even(
    stills: Stills, shape: tuple[int, int], size: int
) -> Float[np.ndarray, "frames rows columns"]:
    """Frames on so many pixels of a larger size, of about the same noise at every level."""
    rows, columns = shape
    electrons = stills.light * stills.electrons[:, None, None]
    offset = 0.375 + stills.read_noise**2
    # Counts of frames that are exposed a little longer are those of the mean exposure.
    scale = np.sqrt(np.mean(stills.electrons) / stills.electrons)[:, None, None]
    even = 2 * np.sqrt(np.maximum(electrons + offset, 0)) * scale
    even = even[:, : size * rows, : size * columns].reshape(-1, rows, size, columns, size)
    return smoothed(even.mean(axis=(2, 4)) * size, _SMOOTHING).astype(np.float32)


def _velocities(stills: Stills, step: float) -> Float[np.ndarray, "n 2"]:
    """Velocities up to the fastest, a step apart."""
    count = int(stills.fastest / step) + 1
    side = np.arange(-count, count + 1) * step
    down, across = (side if moves else np.zeros(1) for moves in stills.moves)
    grid = np.stack(np.meshgrid(down, across, indexing="ij"), axis=-1).reshape(-1, 2)
    return grid[np.hypot(*grid.T) <= stills.fastest + step]
