"""The same exposure of layers, done only where it is needed.

Each layer is blurred over the rows and columns that it covers, what a layer hides is taken
away only where it passes, layers that nobody sees are left out, and equal colours are done
once. `expose_layers` computes everything instead.
"""

from dataclasses import replace

import numpy as np

from mishutter.blur import Cells, exposure_cells
from mishutter.camera.layers import Layer, Layers, convolved_columns, hide, histogram, window
from mishutter.camera.rows import fast_length
from mishutter.model import AbstractMotion, AbstractShutter

_PER_TRANSFORM = 60
"""Products in the time that a pixel of one more transformed copy takes."""


def expose_tiles(
    layers: Layers, motion: AbstractMotion, shutter: AbstractShutter, dtype: np.dtype | None = None
) -> np.ndarray:
    """Light on the sensor from layers, as `expose_layers` gives it up to rounding.

    Args:
        layers: The scene, in linear light.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        dtype: Precision to compute in; that of the first picture by default.

    Returns:
        Light in units of a fully open exposure; shape `layers.shape`.
    """
    shape = layers.shape
    dtype = layers.layers[0].picture.light.dtype if dtype is None else dtype
    seen = _in_one_colour(layers) if _is_grey(layers) else layers
    seen, cells = seen_layers(seen, motion, shutter)
    cells = _merged(cells)
    rows, columns, channels = seen.shape
    total = np.zeros((channels, rows, columns), dtype)
    for index in range(len(seen.layers)):
        _add(total, seen, index, cells)
        if index + 1 < len(seen.layers):
            _take_away(total, seen, index, cells)
    return np.ascontiguousarray(np.broadcast_to(np.moveaxis(total, 0, -1), shape))


def _is_grey(layers: Layers) -> bool:
    return all(
        np.array_equal(light[..., :1], light[..., channel : channel + 1])
        for light in (layer.picture.light for layer in layers.layers)
        for channel in range(1, light.shape[2])
    )


def _in_one_colour(layers: Layers) -> Layers:
    one = [
        replace(layer, picture=replace(layer.picture, light=layer.picture.light[..., :1]))
        for layer in layers.layers
    ]
    return replace(layers, layers=tuple(one))


def seen_layers(
    layers: Layers, motion: AbstractMotion, shutter: AbstractShutter
) -> tuple[Layers, Cells]:
    """Layers without those that are empty, off the sensor or behind one that moves along."""
    cells = _cells(layers, motion, shutter)
    kept = [
        index == 0 or not (_is_off(layers, index, cells) or _is_covered(layers, index))
        for index in range(len(layers.layers))
    ]
    if all(kept):
        return layers, cells
    left = tuple(layer for layer, stays in zip(layers.layers, kept, strict=True) if stays)
    layers = replace(layers, layers=left)
    return layers, _cells(layers, motion, shutter)


def _cells(layers: Layers, motion: AbstractMotion, shutter: AbstractShutter) -> Cells:
    speeds = np.array([layer.speed for layer in layers.layers], np.float64)
    return exposure_cells(shutter, motion, speeds)


def _is_off(layers: Layers, index: int, cells: Cells) -> bool:
    layer, (rows, columns, _) = layers.layers[index], layers.shape
    height, width = layer.matte.shape
    shifts = cells.shifts[:, index]
    below, above = layer.top >= rows, layer.top + height <= 0
    right = layer.left + shifts.min(initial=0) >= columns
    left = layer.left + width + shifts.max(initial=0) <= 0
    return below or above or bool(right or left) or not layer.matte.any()


def _is_covered(layers: Layers, index: int) -> bool:
    layer = layers.layers[index]
    return any(
        front.speed == layer.speed and _covers(front, layer) for front in layers.layers[index + 1 :]
    )


def _covers(front: Layer, layer: Layer) -> bool:
    """Whether one layer is opaque wherever another, at the same speed, is not clear."""
    top, left = layer.top - front.top, layer.left - front.left
    height, width = layer.matte.shape
    if top < 0 or left < 0:
        return False
    over = front.matte[top : top + height, left : left + width]
    return over.shape == layer.matte.shape and bool(np.all(over[layer.matte > 0] == 1))


def _merged(cells: Cells) -> Cells:
    """Cells in which everything lies alike, as one."""
    shifts, group = np.unique(cells.shifts, axis=0, return_inverse=True)
    light = np.bincount(group.reshape(-1), cells.light, minlength=len(shifts))
    return Cells(shifts, light, np.zeros(len(shifts)))


def _add(total: np.ndarray, layers: Layers, index: int, cells: Cells) -> None:
    """Add the blur of one layer, over its own rows and columns."""
    own = cells.shifts[:, index]
    _, rows, columns = total.shape
    kernel = histogram(own, cells.light, own)
    if index == 0:
        first, width = -int(own.max()), columns + kernel.size - 1
        light = window(layers, 0, first, width, total.dtype).light
        total += convolved_columns(light, kernel, columns)
        return
    layer = layers.layers[index]
    inside = slice(max(layer.top, 0), min(layer.top + layer.matte.shape[0], rows))
    width = layer.matte.shape[1]
    seen = window(layers, index, layer.left, width, total.dtype, inside)
    shown = seen.light * seen.matte
    reach = width + kernel.size - 1
    length = fast_length(reach)
    spectrum = np.fft.rfft(shown, length) * np.fft.rfft(kernel.astype(total.dtype), length)
    blurred = np.fft.irfft(spectrum, length)
    begin = layer.left + int(own.min())
    low, high = max(begin, 0), min(begin + reach, columns)
    if low < high:
        total[:, inside, low:high] += blurred[..., low - begin : high - begin]


def _take_away(total: np.ndarray, layers: Layers, index: int, cells: Cells) -> None:
    """Take away what the layers in front stop of one layer's light, where they pass.

    Cell by cell over the box that they cover in it, or by one transform for each relative
    displacement, whichever takes fewer operations.
    """
    channels, rows, columns = total.shape
    front = layers.layers[index + 1 :]
    top = max(min(layer.top for layer in front), 0)
    bottom = min(max(layer.top + layer.matte.shape[0] for layer in front), rows)
    if top >= bottom:
        return
    shifts = cells.shifts[:, index + 1 :]
    left = np.array([layer.left for layer in front])
    width = np.array([layer.matte.shape[1] for layer in front])
    low = np.clip(np.min(left + shifts, axis=1), 0, columns)
    high = np.clip(np.max(left + width + shifts, axis=1), 0, columns)
    own = cells.shifts[:, index]
    first, needed = -int(own.max()), columns + int(np.ptp(own))
    relative = np.unique(shifts - own[:, None], axis=0)
    span = min(needed, int(np.ptp(relative)) + int(np.max(left + width) - np.min(left)))
    if np.sum(high - low) > _PER_TRANSFORM * len(relative) * span:
        shown = window(layers, index, first, needed, total.dtype)
        hide(total, layers, index, cells, shown.light * shown.matte, first, total.dtype)
        return
    inside = slice(top, bottom)
    seen = window(layers, index, first, needed, total.dtype, inside)
    shown = seen.light * seen.matte
    mattes = [_matte_rows(layer, inside, total.dtype) for layer in front]
    dark = np.zeros((channels, bottom - top, columns), total.dtype)
    for cell in range(len(own)):
        begin, end = int(low[cell]), int(high[cell])
        if begin >= end:
            continue
        stopped = _opacity(mattes, left + shifts[cell], begin, end)
        offset = -int(own[cell]) - first
        part = shown[..., begin + offset : end + offset]
        dark[..., begin:end] += part * (total.dtype.type(cells.light[cell]) * stopped)
    total[:, inside] -= dark


def _matte_rows(layer: Layer, inside: slice, dtype: np.dtype) -> np.ndarray:
    """A matte over rows of the sensor, clear where the layer is not; `(rows, columns)`."""
    height, width = layer.matte.shape
    matte = np.zeros((inside.stop - inside.start, width), dtype)
    low, high = max(layer.top, inside.start), min(layer.top + height, inside.stop)
    if low < high:
        there = slice(low - inside.start, high - inside.start)
        matte[there] = layer.matte[low - layer.top : high - layer.top]
    return matte


def _opacity(mattes: list[np.ndarray], left: np.ndarray, begin: int, end: int) -> np.ndarray:
    """How much several mattes stop together over columns of the sensor."""
    clear = np.ones((mattes[0].shape[0], end - begin), mattes[0].dtype)
    for matte, place in zip(mattes, left, strict=True):
        low, high = max(begin, int(place)), min(end, int(place) + matte.shape[1])
        if low < high:
            clear[:, low - begin : high - begin] *= 1 - matte[:, low - place : high - place]
    return 1 - clear
