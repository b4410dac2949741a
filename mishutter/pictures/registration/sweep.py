"""Residuals of frames along velocities: of tiles at a coarse scale, and of regions at a fine one.

A point of velocity `u` is at `p + u (t_k - t_r)` in frame k, if it is at `p` in frame r. Still
frames of equal exposures blur it alike, so that along the right velocity frames differ by noise
alone, whatever the exposure: no picture has to be restored first. Frames here have noise of unit
variance, and velocities the unit of their times: px a second, or px a frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from mishutter.pictures.registration.refinement import Prior, Told, push_of_light, refined
from mishutter.pictures.registration.windows import (
    Window,
    filled,
    means,
    smoothed,
    splines,
)

_SIDES = (48, 16)
"""Sides of tiles, of which one velocity is found; px. In wide ones less is noise, and in narrow
ones a small thing is not outweighed by what is about it."""
_MARGINS = (0.1, 0.9)
"""Lead, in logarithms of residuals, that is noise in each of them."""
_COARSE, _HALF = 4, 2
"""Pixels that are averaged for the sweep, and steps in which averages are moved; px."""
_MARGIN = 2
"""Pixels at the border that splines do not reach without invention."""
UNCERTAIN = 1.0
"""Error of a velocity that is refined, over the frames; px."""
ROBUST = 9.0
"""Square of a residual, in variances of noise, from which on it counts as something hidden."""


class Limits(NamedTuple):
    """Velocities that are looked for."""

    fastest: float = np.inf  # Greatest speed
    moves: tuple[bool, bool] = (True, True)  # Whether things move down the columns, and across them

    def grid(self, side: Float[np.ndarray, "n"]) -> Float[np.ndarray, "m 2"]:
        """Velocities with some components, along the axes on which things move."""
        down, across = (side if moves else np.zeros(1) for moves in self.moves)
        return np.stack(np.meshgrid(down, across, indexing="ij"), axis=-1).reshape(-1, 2)


ANY = Limits()


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Frames after a Gaussian, as the coefficients of cubic splines."""

    # Shape `(frames, rows, columns)`, float32
    coefficients: Float[np.ndarray, "frames rows columns"]
    times: Float[np.ndarray, "frames"]
    sigma: float  # Standard deviation of the Gaussian; px

    @staticmethod
    def of(frames: np.ndarray, times: Float[np.ndarray, "frames"], sigma: float) -> "Smoothed":
        """Frames of unit noise, smoothed so far that moving them changes no noise."""
        return Smoothed(splines(smoothed(frames, sigma)), times, sigma)

    def reach(self, reference: int, frames: Sequence[int]) -> float:
        """Time from the reference frame to the farthest of some."""
        return float(np.max(np.abs(self.times[list(frames)] - self.times[reference])))

    @property
    def variance(self) -> float:
        """Variance of the noise that is left of one of unit variance."""
        return 1 / (4 * np.pi * self.sigma**2)

    def along(
        self, velocity: np.ndarray, reference: int, frames: Sequence[int], window: Window
    ) -> tuple[Float[np.ndarray, "frames y x"], Bool[np.ndarray, "frames y x"]]:
        """A part of the reference frame in others, moved with a velocity, and what is seen."""
        ways = [velocity * (self.times[k] - self.times[reference]) for k in frames]
        pairs = list(zip(frames, ways, strict=True))
        values = [window.taken(self.coefficients[k], way, is_spline=True) for k, way in pairs]
        shape = self.coefficients.shape
        return np.array(values), np.array([window.seen(way, shape, _MARGIN) for way in ways])


@dataclass(frozen=True, eq=False)
class Sweep:
    """Residuals of tiles along each velocity of a grid."""

    velocities: Float[np.ndarray, "velocities 2"]  # Down and across
    # Mean residual over its noise, 1 along the right velocity of frames without texture between
    # pixels; infinite where a tile is not seen; `(velocities, down, across)`
    residuals: Float[np.ndarray, "velocities down across"]
    step: float  # Step of the grid
    side: int  # Of a tile, of which neighbours overlap by half; px
    margin: float  # Lead, in logarithms of residuals, that is noise

    @cached_property
    def logarithms(self) -> Float[np.ndarray, "velocities down across"]:
        """Logarithms of the residuals, of which halves are likelihoods of unknown noise."""
        return np.log(np.maximum(self.residuals, 0.8))

    def near(self, velocity: np.ndarray, steps: float) -> Bool[np.ndarray, "velocities"]:
        """Whether velocities of the grid lie within some steps of another."""
        return np.hypot(*(self.velocities - velocity).T) < steps * self.step

    def mask(self, tiles: np.ndarray, shape: tuple[int, int]) -> Bool[np.ndarray, "rows columns"]:
        """The pixels of some tiles, in a picture of a shape."""
        mask = np.zeros(shape, bool)
        for y, x in np.argwhere(tiles) * (self.side // 2):
            mask[y : y + self.side, x : x + self.side] = True
        return mask


def swept(
    frames: Float[np.ndarray, "frames rows columns"],
    times: Float[np.ndarray, "frames"],
    reference: int,
    limits: Limits = ANY,
) -> list[Sweep]:
    """The residuals of some frames of unit noise, over wide tiles and over narrow ones."""
    count, rows, columns = frames.shape
    span = float(np.ptp(times))
    # Over the frames, a step is 4.8 px, and nothing moves by more than a part of the shorter side.
    step, most = 4.8 / span, min(0.375 * min(rows, columns) / span, limits.fastest)
    side = np.arange(-int(most / step) - 1, int(most / step) + 2) * step
    grid = limits.grid(side)
    grid = grid[np.hypot(*grid.T) <= most + step]
    # Squares are averaged to unit noise four times, from places half a square apart.
    down, across = rows // _COARSE - 1, columns // _COARSE - 1
    parts = np.empty((2, 2, count, down, across), np.float32)
    for i, j in np.ndindex(2, 2):
        squares = means(frames[:, i * _HALF :, j * _HALF :], _COARSE, dtype=frames.dtype)
        parts[i, j] = _COARSE * squares[:, :down, :across]
    late = times - times[reference]
    each = [_residuals(parts, late[:, None] * velocity) for velocity in grid]
    return [
        Sweep(grid, np.array(residuals), step, side, margin)
        for residuals, side, margin in zip(zip(*each, strict=True), _SIDES, _MARGINS, strict=True)
    ]


def _residuals(parts: np.ndarray, ways: np.ndarray) -> list[np.ndarray]:
    """Residual of each tile of each side along a way to each of the frames; px."""
    shape = parts.shape[-2:]
    total, squares, count = (np.zeros(shape, np.float32) for _ in range(3))
    for k, way in enumerate(ways):
        halves = np.rint(way / _HALF).astype(int)
        (i, j), (y, x) = halves % 2, halves // 2
        down = slice(max(0, -y), min(shape[0], shape[0] - y))
        across = slice(max(0, -x), min(shape[1], shape[1] - x))
        if down.start >= down.stop or across.start >= across.stop:
            continue
        moved = parts[i, j, k][down.start + y : down.stop + y, across.start + x : across.stop + x]
        total[down, across] += moved
        squares[down, across] += moved * moved
        count[down, across] += 1
    is_seen = count > 1
    residual = (squares - total * total / np.maximum(count, 1)) / np.maximum(count - 1, 1)
    residual = np.where(is_seen, np.minimum(residual, 5000.0), 0)
    # So much of a tile must be seen in two frames.
    sizes = [side // _COARSE for side in _SIDES]
    pairs = [[_tiles(pixels, size) for pixels in (is_seen, residual)] for size in sizes]
    return [
        np.where(seen > 0.6 * size**2, total / np.maximum(seen, 1), np.inf)
        for size, (seen, total) in zip(sizes, pairs, strict=True)
    ]


def _tiles(pixels: np.ndarray, size: int) -> np.ndarray:
    """Sums over tiles of a side that overlap by half."""
    sums = np.zeros((pixels.shape[0] + 1, pixels.shape[1] + 1))
    sums[1:, 1:] = pixels.cumsum(axis=0, dtype=np.float64).cumsum(axis=1)
    over = sums[size:] - sums[:-size]
    return (over[:, size:] - over[:, :-size])[:: size // 2, :: size // 2]


class Region(NamedTuple):
    """A part of the reference frame, seen in several frames."""

    frames: Smoothed  # The smoothed frames
    reference: int  # Number of the frame in which the part lies
    numbers: Sequence[int]  # Numbers of the frames
    mask: Bool[np.ndarray, "rows columns"]  # The part; shape of a frame
    limits: Limits = ANY  # Velocities that it may have

    def cost(self, velocity: np.ndarray) -> float:
        """Robust cost of a velocity: residuals beyond noise count by their logarithm."""
        box = Window.around(self.mask, 0)
        values, seen = self.frames.along(velocity, self.reference, self.numbers, box)
        seen &= box.of(self.mask)
        count = seen.sum(axis=0)
        mean = np.where(seen, values, 0).sum(axis=0) / np.maximum(count, 1)
        counted = seen & (count > 1)
        if not counted.any():
            return np.inf
        squares = (values - mean)[counted] ** 2 / (ROBUST * self.frames.variance)
        return float(np.log1p(squares).sum() / (count - 1)[count > 1].sum())

    def best_of_grid(self, velocity: np.ndarray, width: float) -> np.ndarray:
        """The best of some velocities about one, 5 along each axis."""
        tried = velocity + self.limits.grid(np.linspace(-0.5, 0.5, 5) * width)
        return tried[int(np.argmin([self.cost(v) for v in tried]))]

    def descended(self, velocity: np.ndarray, first: float, last: float) -> np.ndarray:
        """The end of a search along the axes in steps that are halved where none is better."""
        best, step = self.cost(velocity), first
        axes = np.eye(2)[list(self.limits.moves)]
        for _ in range(24):
            if step < last:
                break
            for move in np.repeat(axes, 2, axis=0) * np.resize([1, -1], (2 * len(axes), 1)):
                other = velocity + step * move
                cost = self.cost(other)
                if cost < best:
                    velocity, best = other, cost
                    break
            else:
                step /= 2
        return velocity

    def polished(self, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """A velocity where the frames differ least, its covariance, and the residual over noise.

        What hides a pixel in some frames counts for little.
        """
        window = Window.around(self.mask, 0)
        numbers, noise = list(self.numbers), self.frames.variance
        times = self.frames.times[numbers] - self.frames.times[self.reference]
        residual = np.inf

        def told_at(velocity: np.ndarray) -> Told:
            nonlocal residual
            values, seen = self.frames.along(velocity, self.reference, numbers, window)
            seen &= window.of(self.mask)
            seen &= seen.sum(axis=0) > 1
            if not seen.any():
                return Told.by([])
            weights = seen.astype(float)
            for _ in range(2):
                squares = (values - _weighted(values, weights)) ** 2
                scale = max(ROBUST * noise, 3 * float(np.median(squares[seen])))
                weights = np.where(seen, 1 / (1 + (squares / scale) ** 2), 0)
            mean = _weighted(values, weights)
            squares = weights * (values - mean) ** 2
            residual = float(squares.sum() / weights.sum() / noise)
            # An end of what is seen has no slope.
            smooth = filled(mean, seen.any(axis=0))
            slope_noise = 1 / (2 * self.frames.sigma**2)
            return Told.by(
                [
                    push_of_light(
                        values, weights, times, smooth, noise=noise, slope_noise=slope_noise
                    )
                ]
            )

        reach = max(float(np.max(np.abs(times))), 1e-12)
        prior = Prior(velocity, UNCERTAIN / reach)
        found, covariance = refined(velocity, told_at, prior, reach)
        return found, covariance, residual


def _weighted(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return (weights * values).sum(axis=0) / np.maximum(weights.sum(axis=0), 1e-3)
