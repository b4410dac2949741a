"""Objects in front of one another, each at its own speed, captured with exact occlusion."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mishutter._core import Bare, require, require_finite
from mishutter.blur import Cells, exposure_cells
from mishutter.camera.rows import PAD_MODES, fast_length, padded_columns
from mishutter.model import AbstractMotion, AbstractShutter, Picture

FARTHEST = 10**9
"""Columns or rows that a layer's corner may lie from the sensor's."""


@dataclass(frozen=True, eq=False)
class Layer:
    """A picture that moves along its rows; its matte says where it is.

    Attributes:
        picture: The picture; opaque where it has no matte.
        speed: px/s on the sensor, either sign.
        left: Column of the sensor over which its first column is at mid-exposure.
        top: Row of the sensor over which its first row is.
    """

    picture: Picture
    speed: float = 0.0
    left: int = 0
    top: int = 0

    def __post_init__(self) -> None:
        picture = self.picture
        require(isinstance(picture, Picture), "Layer(picture=...)", "be a `Picture`", picture)
        require_finite("Layer(speed=...)", self.speed)
        for name, place in (("left", self.left), ("top", self.top)):
            near = -FARTHEST <= place <= FARTHEST
            require(near, f"Layer({name}=...)", f"lie within {FARTHEST:g} px", place)

    @property
    def matte(self) -> np.ndarray:
        """Opacity; shape `(rows, columns)`."""
        given = self.picture.matte
        return np.ones(self.picture.light.shape[:2], np.float32) if given is None else given


@dataclass(frozen=True, eq=False)
class Layers:
    """Layers from back to front; the first is opaque and is as large as the sensor.

    Attributes:
        layers: At least one.
        border: How the first goes on beyond its ends: `"reflect"`, `"edge"`, `"wrap"`
            or `"zero"`. The others end where they end.
    """

    layers: tuple[Layer, ...]
    border: str = "reflect"

    def __post_init__(self) -> None:
        subject, given = "Layers(layers=...)", self.layers
        some = isinstance(given, Sequence) and len(given) >= 1
        right = some and all(isinstance(layer, Layer) for layer in given)
        require(right, subject, "hold at least one layer and nothing else", given)
        require(
            self.border in PAD_MODES, "Layers(border=...)", f"be one of {[*PAD_MODES]}", self.border
        )
        opaque = bool(np.all(self.layers[0].matte == 1))
        require(opaque, subject, "begin with an opaque layer", Bare("one with a matte"))

    @staticmethod
    def load(path: str | Path) -> "Layers":
        """Read a layered scene from a TOML file; see `mishutter.camera.layers_file` for its keys.

        Raises:
            ValueError: if the file is not a layered scene, or a matte does not fit.
            OSError: if a file cannot be read.
        """
        from mishutter.camera.layers_file import read_layers

        return read_layers(path)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, columns and channels of the sensor."""
        channels = max(layer.picture.light.shape[2] for layer in self.layers)
        return (*self.layers[0].picture.light.shape[:2], channels)


class Window(NamedTuple):
    """A layer cut to the sensor's rows and to columns `first` up to `first + width`."""

    light: np.ndarray
    matte: np.ndarray


def expose_layers(
    layers: Layers, motion: AbstractMotion, shutter: AbstractShutter, dtype: np.dtype | None = None
) -> np.ndarray:
    r"""Light on the sensor from layers that hide one another while they move.

    $g = \sum_c W_c \sum_l (\alpha_l C_l)_{k - c_l} \prod_{m > l} (1 - \alpha_m)_{k - c_m}$
    over the cells $c$ of the exposure in which no layer crosses an edge of a pixel: the
    time integral of the composite, not a composite of blurred layers. In a layer's own
    frame what hides it depends on relative displacements alone, of which there are few;
    the cells that share them are one convolution.

    Args:
        layers: The scene, in linear light.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        dtype: Precision to compute in; that of the first picture by default.

    Returns:
        Light in units of a fully open exposure, at mid-exposure alignment; shape
        `layers.shape`.
    """
    dtype = layers.layers[0].picture.light.dtype if dtype is None else dtype
    speeds = np.array([layer.speed for layer in layers.layers], np.float64)
    cells = exposure_cells(shutter, motion, speeds)
    rows, columns, channels = layers.shape
    total = np.zeros((channels, rows, columns), dtype)
    for index in range(len(layers.layers)):
        own = cells.shifts[:, index]
        first, width = -int(own.max()), columns + int(np.ptp(own))
        seen = window(layers, index, first, width, dtype)
        shown = seen.light * seen.matte
        kernel = histogram(own, cells.light, own)
        total += convolved_columns(shown, kernel, columns)
        if index + 1 < len(layers.layers):
            hide(total, layers, index, cells, shown, first, dtype, everywhere=True)
    return np.moveaxis(total, 0, -1)


def hide(
    total,
    layers: Layers,
    index: int,
    cells: Cells,
    shown,
    first: int,
    dtype,
    *,
    everywhere: bool = False,
) -> None:
    """Take away the light of one layer that the layers in front of it stop."""
    own = cells.shifts[:, index]
    relative = cells.shifts[:, index + 1 :] - own[:, None]
    front = range(index + 1, len(layers.layers))
    low, high, rows = first, first + shown.shape[-1], slice(0, total.shape[1])
    if not everywhere:
        low, high, rows = _reach(layers, front, relative, first, shown.shape[-1])
    if low >= high or rows.start >= rows.stop:
        return
    span, columns = high - low, total.shape[-1]
    least, spread = int(own.min()), int(np.ptp(own))
    length = fast_length(span + spread)
    hidden = np.zeros((total.shape[0], rows.stop - rows.start, length // 2 + 1), complex)
    combinations, group = np.unique(relative, axis=0, return_inverse=True)
    part = shown[:, rows, low - first : high - first]
    mattes = []
    for column, layer in enumerate(front):
        shifts = relative[:, column]
        begin, width = low - int(shifts.max()), span + int(np.ptp(shifts))
        mattes.append((begin, window(layers, layer, begin, width, dtype).matte[rows]))
    for number, shifts in enumerate(combinations):
        clear = np.ones(part.shape[1:], dtype)
        for (begin, matte), shift in zip(mattes, shifts, strict=True):
            clear *= 1 - matte[:, low - shift - begin : high - shift - begin]
        stopped = part * (1 - clear)
        if not stopped.any():
            continue
        chosen = group.reshape(-1) == number
        kernel = histogram(own[chosen], cells.light[chosen], own)
        hidden += np.fft.rfft(stopped, length) * np.fft.rfft(kernel, length)
    dark = np.fft.irfft(hidden, length)[..., : span + spread].astype(dtype)
    begin = low + least
    inside = slice(max(begin, 0), min(begin + span + spread, columns))
    total[:, rows, inside] -= dark[..., inside.start - begin : inside.stop - begin]


def _reach(layers: Layers, front: range, relative, first: int, width: int):
    """Columns of a layer's own frame, and rows, that anything in front of it may cover."""
    low, high, top, bottom = first + width, first, layers.shape[0], 0
    for column, index in enumerate(front):
        layer = layers.layers[index]
        shifts = relative[:, column]
        height, length = layer.matte.shape
        low = min(low, layer.left + int(shifts.min()))
        high = max(high, layer.left + length + int(shifts.max()))
        top, bottom = min(top, layer.top), max(bottom, layer.top + height)
    return (
        max(low, first),
        min(high, first + width),
        slice(max(top, 0), min(bottom, layers.shape[0])),
    )


def window(
    layers: Layers, index: int, first: int, width: int, dtype, inside: slice | None = None
) -> Window:
    """A layer over columns from `first` on; light `(channels, rows, width)` and its matte.

    Over the rows `inside`, or all of the sensor.
    """
    rows, columns, channels = layers.shape
    inside = slice(0, rows) if inside is None else inside
    layer = layers.layers[index]
    if index == 0:
        cut = replace(layer.picture, light=layer.picture.light[inside], matte=None)
        layer, rows = replace(layer, picture=cut), inside.stop - inside.start
    else:
        layer, rows = replace(layer, top=layer.top - inside.start), inside.stop - inside.start
    picture = np.moveaxis(layer.picture.light, -1, 0).astype(dtype)
    picture = np.broadcast_to(picture, (channels, *picture.shape[1:]))
    if index == 0:
        before, after = max(0, -first), max(0, first + width - columns)
        padded = padded_columns(picture, before, after, layers.border)
        light = padded[..., first + before : first + before + width]
        return Window(light, np.ones((rows, width), dtype))
    light = np.zeros((channels, rows, width), dtype)
    matte = np.zeros((rows, width), dtype)
    height, length = layer.matte.shape
    r = slice(max(layer.top, 0), max(min(layer.top + height, rows), 0))
    c = slice(max(layer.left, first), max(min(layer.left + length, first + width), first))
    if r.start < r.stop and c.start < c.stop:
        inner = (
            slice(r.start - layer.top, r.stop - layer.top),
            slice(c.start - layer.left, c.stop - layer.left),
        )
        there = (r, slice(c.start - first, c.stop - first))
        light[(slice(None), *there)] = picture[(slice(None), *inner)]
        matte[there] = layer.matte[inner]
    return Window(light, matte)


def histogram(shifts: np.ndarray, light: np.ndarray, every: np.ndarray) -> np.ndarray:
    """Light by shift, from the least shift of all on."""
    return np.bincount(shifts - every.min(), light, minlength=int(np.ptp(every)) + 1)


def convolved_columns(rows: np.ndarray, kernel: np.ndarray, columns: int) -> np.ndarray:
    """Rows through a kernel where it lies inside them; `columns` of each."""
    length = fast_length(rows.shape[-1])
    spectrum = np.fft.rfft(rows, length) * np.fft.rfft(kernel.astype(rows.dtype), length)
    blurred = np.fft.irfft(spectrum, length)
    begin = kernel.size - 1
    return blurred[..., begin : begin + columns]
