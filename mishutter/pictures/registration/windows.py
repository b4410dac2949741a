"""Parts of pictures between the pixels of others: moved by splines, or bilinearly."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import DTypeLike
from scipy import ndimage

Picture = Float[np.ndarray, "_ _"]
"""Pixels of any unit."""
_SPLINE = 3
"""Degree of the splines by which light is moved."""


def smoothed(picture: np.ndarray, sigma: float) -> np.ndarray:
    """A picture, or each of several, under a Gaussian; px."""
    axes = range(picture.ndim - 2, picture.ndim)
    return ndimage.gaussian_filter(picture, sigma, mode="nearest", axes=tuple(axes))


def means(
    pixels: np.ndarray,
    side: int,
    axes: tuple[int, ...] = (-2, -1),
    dtype: DTypeLike = np.float64,
) -> np.ndarray:
    """Means over squares, or over pixels along one axis; what remains at the ends is left out."""
    for axis in axes:
        last = np.moveaxis(pixels, axis, -1)
        count = last.shape[-1] // side
        parts = last[..., : count * side].reshape(*last.shape[:-1], count, side)
        pixels = np.moveaxis(parts.mean(axis=-1, dtype=dtype), -1, axis)
    return pixels


def splines(frames: Float[np.ndarray, "frames rows columns"]) -> np.ndarray:
    """Coefficients of the splines through the pixels of frames."""
    coefficients = np.empty(frames.shape, np.float32)
    for frame, out in zip(frames, coefficients, strict=True):
        out[:] = ndimage.spline_filter(frame, _SPLINE, mode="mirror")
    return coefficients


def filled(picture: Picture, known: np.ndarray, widest: float = np.inf) -> Picture:
    """A picture whose unknown pixels are means of ever wider neighbourhoods, then of all of it.

    Where only those near known ones count, the widest Gaussian, px, may be a narrow one.
    """
    out, weight = np.where(known, picture, np.nan), known.astype(np.float32)
    light = np.where(known, picture, 0).astype(np.float32)
    for sigma in (1.5, 3.0, 6.0, 12.0, 24.0, 60.0):
        missing = np.isnan(out)
        if sigma > widest or not missing.any():
            break
        total, near = smoothed(light, sigma), smoothed(weight, sigma)
        is_near = missing & (near > 0.02)
        out[is_near] = (total / np.maximum(near, 1e-9))[is_near]
    level = float(picture[known].mean()) if known.any() else 0.3
    return np.nan_to_num(out, nan=level)


class Window(NamedTuple):
    """Rows and columns of a part of a picture: the first ones, and how many."""

    top: int
    left: int
    rows: int
    columns: int

    @staticmethod
    def whole(shape: tuple[int, ...]) -> "Window":
        """All of a picture."""
        return Window(0, 0, int(shape[-2]), int(shape[-1]))

    @staticmethod
    def around(mask: np.ndarray, margin: int) -> "Window":
        """The least part that holds a mask and a margin about it, as far as the picture goes."""
        down, across = np.nonzero(mask > 0)
        if not down.size:
            return Window(0, 0, 1, 1)
        top, left = (max(int(x.min()) - margin, 0) for x in (down, across))
        ends = (
            min(int(x.max()) + margin + 1, n)
            for x, n in zip((down, across), mask.shape, strict=True)
        )
        bottom, right = ends
        return Window(top, left, bottom - top, right - left)

    def swept(self, ways: Float[np.ndarray, "n 2"], shape: tuple[int, ...]) -> "Window":
        """The part of a picture that this one lies over on some ways; px."""
        low, high = np.floor(ways.min(axis=0)), np.ceil(ways.max(axis=0))
        top, left = int(max(self.top + low[0], 0)), int(max(self.left + low[1], 0))
        bottom = int(min(self.top + self.rows + high[0], shape[-2]))
        right = int(min(self.left + self.columns + high[1], shape[-1]))
        return Window(top, left, max(bottom - top, 1), max(right - left, 1))

    def of(self, picture: np.ndarray) -> np.ndarray:
        """The part of a picture, or of each of several."""
        down = slice(self.top, self.top + self.rows)
        return picture[..., down, self.left : self.left + self.columns]

    def placed(self, part: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        """A picture of zeros but for this part."""
        whole = np.zeros((*part.shape[:-2], *shape[-2:]), part.dtype)
        self.of(whole)[...] = part
        return whole

    def aside(self, by: Int[np.ndarray, "2"]) -> "Window":
        """This part displaced by whole pixels, which may lie beyond the picture."""
        return self._replace(top=self.top + int(by[0]), left=self.left + int(by[1]))

    def wider(self, margin: int) -> "Window":
        """This part with a margin about it, which may lie beyond the picture."""
        rows, columns = self.rows + 2 * margin, self.columns + 2 * margin
        return Window(self.top - margin, self.left - margin, rows, columns)

    def _common(self, shape: tuple[int, ...]) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
        """Slices of a picture and of this part where they lie over one another."""
        ends = [
            (max(first, 0), max(min(first + count, size), max(first, 0)), first)
            for first, count, size in zip(self[:2], self[2:], shape[-2:], strict=True)
        ]
        whole = tuple(slice(a, b) for a, b, _ in ends)
        part = tuple(slice(a - first, b - first) for a, b, first in ends)
        return whole, part  # type: ignore[return-value]

    def cut(self, picture: np.ndarray) -> np.ndarray:
        """The part of a picture, 0 where it lies beyond."""
        whole, own = self._common(picture.shape)
        part = np.zeros((*picture.shape[:-2], self.rows, self.columns), picture.dtype)
        part[..., *own] = picture[..., *whole]
        return part

    def beyond(self, picture: Picture) -> Picture:
        """The part of a picture, which goes on beyond its ends as it ends."""
        (down, across), _ = self._common(picture.shape)
        part = picture[down, across]
        if part.shape == (self.rows, self.columns):
            return part
        rows, columns = (
            np.clip(first + np.arange(count), 0, n - 1)
            for first, count, n in zip(self[:2], self[2:], picture.shape, strict=True)
        )
        return picture[rows[:, None], columns]

    def add(self, picture: np.ndarray, part: np.ndarray) -> None:
        """Adds a part to a picture, as far as it lies over it."""
        whole, own = self._common(picture.shape)
        picture[whole] += part[own]

    def seen(
        self, by: Float[np.ndarray, "2"], shape: tuple[int, ...], margin: int = 0
    ) -> np.ndarray:
        """Whether each pixel of this part lies within a picture once it is displaced; px."""
        down, across = (
            (first + np.arange(count) + move >= margin)
            & (first + np.arange(count) + move <= size - 1 - margin)
            for first, count, move, size in zip(self[:2], self[2:], by, shape[-2:], strict=True)
        )
        return down[:, None] & across

    def taken(
        self,
        picture: Float[np.ndarray, "_ _"],
        by: Float[np.ndarray, "2"],
        *,
        is_spline: bool = False,
    ) -> Float[np.ndarray, "_ _"]:
        """A picture at the pixels of this part, displaced; px.

        It is bilinear, or the spline of which the picture holds the coefficients. Beyond its ends a
        picture goes on as it ends.
        """
        whole = np.floor(by).astype(int)
        down, across = (_taps(float(f), is_spline) for f in by - whole)
        before = 1 if is_spline else 0
        top, left = self.top + int(whole[0]) - before, self.left + int(whole[1]) - before
        source = Window(top, left, self.rows + down.size - 1, self.columns + across.size - 1)
        part = source.beyond(picture)
        part = sum(tap * part[i : i + self.rows] for i, tap in enumerate(down.tolist()))
        return sum(tap * part[:, i : i + self.columns] for i, tap in enumerate(across.tolist()))  # type: ignore[return-value]


def _taps(share: float, is_spline: bool) -> Float[np.ndarray, "n"]:
    """Weights of the pixels about a point that lies a share of a pixel beyond one."""
    f = share
    if not is_spline:
        return np.array([1 - f, f])
    return np.array([(1 - f) ** 3, 4 + 3 * f**2 * (f - 2), 1 + 3 * f * (1 + f * (1 - f)), f**3]) / 6
