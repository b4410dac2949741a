"""Residuals of frames along velocities: of tiles at a coarse scale, and of regions at a fine one.

A point that moves by `u` px a frame is at `p + u (k - r)` in frame k, if it is at `p` in frame r.
Still frames of equal exposures blur it alike, so that along the right velocity frames differ by
noise alone, whatever the exposure: no picture has to be restored first. Frames here have noise of
unit variance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

TILE = 48
"""Side of a tile, of which one velocity is found; px."""
_COARSE, _HALF = 4, 2
"""Pixels that are averaged for the sweep, and steps in which averages are moved; px."""
_JUMP = TILE // 2
_MARGIN = 2
"""Pixels at the border that splines do not reach without invention."""
ROBUST = 9.0
"""Square of a residual, in variances of noise, from which on it counts as something hidden."""


class Box(NamedTuple):
    """Rows and columns of a part of a picture: first, and one beyond the last, of each."""

    top: int
    bottom: int
    left: int
    right: int

    @staticmethod
    def around(mask: Bool[np.ndarray, "rows columns"]) -> "Box":
        """The least box around a mask."""
        rows, columns = np.nonzero(mask)
        ends = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
        return Box(*map(int, ends))

    def of(self, picture: np.ndarray) -> np.ndarray:
        """The part of a picture."""
        return picture[..., self.top : self.bottom, self.left : self.right]


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Frames after a Gaussian, as the coefficients of cubic splines."""

    # Shape `(frames, rows, columns)`, float32
    coefficients: Float[np.ndarray, "frames rows columns"]
    sigma: float  # Standard deviation of the Gaussian; px

    @staticmethod
    def of(frames: np.ndarray, sigma: float) -> "Smoothed":
        """Frames of unit noise, smoothed so far that moving them changes no noise."""
        coefficients = np.empty(frames.shape, np.float32)
        for frame, out in zip(frames, coefficients, strict=True):
            smooth = ndimage.gaussian_filter(frame, sigma)
            out[:] = ndimage.spline_filter(smooth, 3, mode="nearest")
        return Smoothed(coefficients, sigma)

    @property
    def variance(self) -> float:
        """Variance of the noise that is left of one of unit variance."""
        return 1 / (4 * np.pi * self.sigma**2)

    def along(
        self, velocity: np.ndarray, reference: int, frames: Sequence[int], box: Box
    ) -> tuple[Float[np.ndarray, "frames y x"], Bool[np.ndarray, "frames y x"]]:
        """A box of the reference frame in other frames, moved with a velocity, and what is seen."""
        values, seen = [], []
        for k in frames:
            y, x = np.asarray(velocity) * (k - reference)
            down, right = (box.top, box.bottom, float(y)), (box.left, box.right, float(x))
            values.append(_moved(self.coefficients[k], down, right))
            inside = [
                (np.arange(first, end) + move >= _MARGIN)
                & (np.arange(first, end) + move <= size - 1 - _MARGIN)
                for (first, end, move), size in zip(
                    (down, right), self.coefficients.shape[1:], strict=True
                )
            ]
            seen.append(inside[0][:, None] & inside[1])
        return np.array(values), np.array(seen)


def _moved(
    coefficients: np.ndarray, down: tuple[int, int, float], right: tuple[int, int, float]
) -> Float[np.ndarray, "y x"]:
    """Values of a cubic spline at equal steps: first, end and a shift of each axis.

    All places have one fraction, so that the spline is a sum of four rows, and of four columns.
    """
    parts = coefficients
    for axis, (first, end, move) in enumerate((down, right)):
        whole = int(np.floor(move))
        rest = move - whole
        places = np.arange(first + whole - 1, end + whole + 2)
        parts = parts.take(np.clip(places, 0, parts.shape[axis] - 1), axis=axis)
        weights = (
            (1 - rest) ** 3 / 6,
            2 / 3 - rest**2 + rest**3 / 2,
            1 / 6 + (rest + rest**2 - rest**3) / 2,
            rest**3 / 6,
        )
        count = end - first
        slices = (parts[i : i + count] if axis == 0 else parts[:, i : i + count] for i in range(4))
        each = zip(weights, slices, strict=True)
        parts = np.sum([np.float32(w) * part for w, part in each], axis=0)
    return parts


@dataclass(frozen=True, eq=False)
class Sweep:
    """Residuals of tiles along each velocity of a grid."""

    # Rows and columns a frame, px; shape `(velocities, 2)`
    velocities: Float[np.ndarray, "velocities 2"]
    # Mean residual over its noise, 1 along the right velocity of frames without texture between
    # pixels; infinite where a tile is not seen; `(velocities, down, across)`
    residuals: Float[np.ndarray, "velocities down across"]
    step: float  # Step of the grid; px a frame

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
        for y, x in np.argwhere(tiles) * _JUMP:
            mask[y : y + TILE, x : x + TILE] = True
        return mask


def swept(frames: Float[np.ndarray, "frames rows columns"], reference: int, stride: int) -> Sweep:
    """The residuals of successive frames of unit noise."""
    count, rows, columns = frames.shape
    span = (count - 1) * stride
    # Over the frames, a step is 4.8 px, and nothing moves by more than a part of the shorter side.
    step, most = 4.8 / span, 0.375 * min(rows, columns) / span
    side = np.arange(-int(most / step) - 1, int(most / step) + 2) * step
    grid = np.array([(y, x) for y in side for x in side if np.hypot(y, x) <= most + step])
    # Squares are averaged to unit noise four times, from places half a square apart.
    down, across = rows // _COARSE - 1, columns // _COARSE - 1
    parts = np.empty((2, 2, count, down, across), np.float32)
    for i, j in np.ndindex(2, 2):
        cut = frames[:, i * _HALF :, j * _HALF :][:, : down * _COARSE, : across * _COARSE]
        squares = cut.reshape(count, down, _COARSE, across, _COARSE)
        parts[i, j] = squares.mean(axis=(2, 4)) * _COARSE
    residuals = np.array([_residual(parts, v * stride, reference) for v in grid])
    return Sweep(grid, residuals, step)


def _residual(parts: np.ndarray, move: np.ndarray, reference: int) -> np.ndarray:
    """Residual of each tile along a velocity, in px from one of the frames to the next."""
    shape = parts.shape[-2:]
    total, squares, count = (np.zeros(shape, np.float32) for _ in range(3))
    for k in range(parts.shape[2]):
        halves = np.rint(move * (k - reference) / _HALF).astype(int)
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
    seen, least = _tiles(is_seen), 0.6 * (TILE // _COARSE) ** 2
    return np.where(seen > least, _tiles(residual) / np.maximum(seen, 1), np.inf)


def _tiles(pixels: np.ndarray) -> np.ndarray:
    """Sums over tiles that overlap by half."""
    size, jump = TILE // _COARSE, _JUMP // _COARSE
    sums = np.zeros((pixels.shape[0] + 1, pixels.shape[1] + 1))
    sums[1:, 1:] = pixels.cumsum(axis=0, dtype=np.float64).cumsum(axis=1)
    over = sums[size:] - sums[:-size]
    return (over[:, size:] - over[:, :-size])[::jump, ::jump]


class Region(NamedTuple):
    """A part of the reference frame, seen in several frames."""

    frames: Smoothed  # The smoothed frames
    reference: int  # Number of the frame in which the part lies
    numbers: Sequence[int]  # Numbers of the frames
    mask: Bool[np.ndarray, "rows columns"]  # The part; shape of a frame

    def cost(self, velocity: np.ndarray) -> float:
        """Robust cost of a velocity: residuals beyond noise count by their logarithm."""
        box = Box.around(self.mask)
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
        """The best of 5 x 5 velocities about one."""
        places = np.linspace(-0.5, 0.5, 5) * width
        tried = [velocity + np.array([y, x]) for y in places for x in places]
        return tried[int(np.argmin([self.cost(v) for v in tried]))]

    def descended(self, velocity: np.ndarray, first: float, last: float) -> np.ndarray:
        """The end of a search along both axes in steps that are halved where none is better."""
        best, step = self.cost(velocity), first
        for _ in range(24):
            if step < last:
                break
            for move in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                other = velocity + step * np.array(move)
                cost = self.cost(other)
                if cost < best:
                    velocity, best = other, cost
                    break
            else:
                step /= 2
        return velocity

    def polished(self, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """A velocity after steps of weighted least squares, its covariance, and the residual.

        The covariance is that of the gradients of blocks, which hold noise that the smoothing
        correlates and what the model leaves out.
        """
        box = Box.around(self.mask)
        times = (np.array(self.numbers) - self.reference)[:, None, None]
        reach = max(np.abs(times).max(), 1)
        noise = self.frames.variance
        covariance, residual = np.eye(2), np.inf
        for _ in range(4):
            values, seen = self.frames.along(velocity, self.reference, self.numbers, box)
            seen &= box.of(self.mask)
            seen &= seen.sum(axis=0) > 1
            if not seen.any():
                break
            mean = _weighted(values, seen.astype(float))
            weights = seen.astype(float)
            for _ in range(2):
                squares = (values - mean) ** 2
                scale = max(ROBUST * noise, 3 * float(np.median(squares[seen])))
                weights = np.where(seen, 1 / (1 + (squares / scale) ** 2), 0)
                mean = _weighted(values, weights)
            away = times - _weighted(np.broadcast_to(times, values.shape), weights)
            slopes = np.stack([np.gradient(mean, axis=axis) for axis in (0, 1)])
            pull = (weights * away * (values - mean)).sum(axis=0)
            normal = np.einsum("iyx,jyx,yx->ij", slopes, slopes, (weights * away**2).sum(axis=0))
            normal += 1e-6 * np.trace(normal) * np.eye(2)
            if np.trace(normal) <= 0:  # nothing to hold on to
                break
            inverse = np.linalg.inv(normal)
            move = -inverse @ np.einsum("iyx,yx->i", slopes, pull)
            length = float(np.hypot(*move)) * reach
            velocity = velocity + move * min(1.0, 0.5 / max(length, 1e-9))
            gradients = np.stack([_block_sums(slope * pull) for slope in slopes])
            covariance = inverse @ (gradients @ gradients.T) @ inverse
            residual = float((weights * (values - mean) ** 2).sum() / weights.sum() / noise)
            if length < 0.005:
                break
        return velocity, covariance, residual


def _weighted(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return (weights * values).sum(axis=0) / np.maximum(weights.sum(axis=0), 1e-3)


def _block_sums(pixels: np.ndarray) -> Float[np.ndarray, "blocks"]:
    """Sums over squares of 8 px, those at the edges of what is there."""
    down, across = (np.arange(0, n, 8) for n in pixels.shape)
    return np.add.reduceat(np.add.reduceat(pixels, down, axis=0), across, axis=1).ravel()
