"""The exposure of layers that hide one another while they move, where it can be seen."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mishutter.blur import exposure_cells
from mishutter.camera.layers import Layer, Layers
from mishutter.camera.rows import fast_length, padded_columns
from mishutter.model import AbstractMotion, AbstractShutter

_FEW_TAPS = 24
"""Taps of a kernel that are summed one by one in the time of two Fourier transforms."""


def expose_layers(layers: Layers, motion: AbstractMotion, shutter: AbstractShutter) -> np.ndarray:
    r"""Light on the sensor from layers that hide one another while they move.

    $g = \sum_c W_c \sum_l (\alpha_l C_l)_{k - c_l} \prod_{m > l} (1 - \alpha_m)_{k - c_m}$
    over the cells $c$ of the exposure in which no layer crosses an edge of a pixel: the
    time integral of the composite, not a composite of blurred layers. Each layer is added
    blurred as if nothing hid it, and its hidden parts are taken away. In a layer's own frame
    these depend on the displacements of the layers in front relative to it alone: the cells
    that share them are one convolution, over the columns that are covered then. Layers that
    nobody sees are left out, and equal colours are computed once.

    Args:
        layers: The scene, in linear light.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.

    Returns:
        Light in units of a fully open exposure, at mid-exposure alignment; shape
        `layers.shape`.
    """
    shape, dtype = layers.shape, layers.layers[0].picture.light.dtype
    layers = seen_layers(_in_one_colour(layers) if _is_grey(layers) else layers, motion)
    speeds = np.array([layer.speed for layer in layers.layers], np.float64)
    cells = exposure_cells(shutter, motion, speeds)
    rows, columns, channels = layers.shape
    total = np.zeros((channels, rows, columns), dtype)
    for index in range(len(layers.layers)):
        own = cells.shifts[:, index]
        light, left, inside = _light_and_place(layers, index, own, dtype)
        _add_blurred(total[:, inside], light, left + own, cells.light)
        front = layers.layers[index + 1 :]
        top = max(inside.start, min((layer.top for layer in front), default=rows))
        bottom = min(inside.stop, max((layer.top + _height(layer) for layer in front), default=0))
        if top >= bottom:
            continue
        light = light[:, top - inside.start : bottom - inside.start]
        mattes = [_matte_rows(layer, top, bottom, dtype) for layer in front]
        relative = cells.shifts[:, index + 1 :] - own[:, None]
        combinations, group = np.unique(relative, axis=0, return_inverse=True)
        for number, shifts in enumerate(combinations):
            together = group.reshape(-1) == number
            places = [layer.left + int(x) - left for layer, x in zip(front, shifts, strict=True)]
            ends = [place + matte.shape[1] for place, matte in zip(places, mattes, strict=True)]
            seen_from = left + own[together]
            low = max(0, min(places), -int(seen_from.max()))
            high = min(light.shape[-1], max(ends), columns - int(seen_from.min()))
            if low < high:
                hidden = light[..., low:high] * -_opacity(mattes, places, low, high)
                _add_blurred(total[:, top:bottom], hidden, seen_from + low, cells.light[together])
    return np.ascontiguousarray(np.broadcast_to(np.moveaxis(total, 0, -1), shape))


def _light_and_place(
    layers: Layers, index: int, shifts: np.ndarray, dtype: np.dtype
) -> tuple[np.ndarray, int, slice]:
    """Light that a layer sends where nothing hides it, and where it is at no displacement.

    Returns:
        Light times matte, shape `(channels, rows, columns)`; the sensor's column of its
        first column; the sensor's rows of its rows.
    """
    layer, (rows, _, channels) = layers.layers[index], layers.shape
    top = layer.top if index else 0
    inside = slice(max(top, 0), min(top + _height(layer), rows))
    own_rows = slice(inside.start - top, inside.stop - top)
    light = np.moveaxis(layer.picture.light[own_rows], -1, 0).astype(dtype)
    light = np.broadcast_to(light, (channels, *light.shape[1:]))
    if index == 0:
        before, after = max(0, int(shifts.max())), max(0, -int(shifts.min()))
        return padded_columns(light, before, after, layers.border), -before, inside
    return light * layer.matte[own_rows].astype(dtype), layer.left, inside


def _add_blurred(
    total: np.ndarray, light: np.ndarray, places: np.ndarray, weights: np.ndarray
) -> None:
    """Add light to `total` with its first column at each of several places, weighted."""
    first = int(places.min())
    kernel = np.bincount(places - first, weights).astype(total.dtype)
    if np.count_nonzero(kernel) > _FEW_TAPS:
        reach = light.shape[-1] + kernel.size - 1
        length = fast_length(reach)
        spectrum = np.fft.rfft(light, length) * np.fft.rfft(kernel, length)
        light, kernel = np.fft.irfft(spectrum, length)[..., :reach], np.ones(1, total.dtype)
    for tap in np.flatnonzero(kernel):
        begin = first + int(tap)
        low, high = max(begin, 0), min(begin + light.shape[-1], total.shape[-1])
        if low < high:
            total[..., low:high] += kernel[tap] * light[..., low - begin : high - begin]


def _height(layer: Layer) -> int:
    return layer.picture.light.shape[0]


def _matte_rows(layer: Layer, top: int, bottom: int, dtype: np.dtype) -> np.ndarray:
    """A matte over rows of the sensor, clear where the layer is not; `(rows, columns)`."""
    matte = np.zeros((bottom - top, layer.matte.shape[1]), dtype)
    low, high = max(layer.top, top), min(layer.top + _height(layer), bottom)
    if low < high:
        matte[low - top : high - top] = layer.matte[low - layer.top : high - layer.top]
    return matte


def _opacity(
    mattes: Sequence[np.ndarray], places: Sequence[int], low: int, high: int
) -> np.ndarray:
    """Share of the light that mattes at some places stop together, in columns `low:high`."""
    clear = np.ones((mattes[0].shape[0], high - low), mattes[0].dtype)
    for matte, place in zip(mattes, places, strict=True):
        begin, end = max(low, place), min(high, place + matte.shape[1])
        if begin < end:
            clear[:, begin - low : end - low] *= 1 - matte[:, begin - place : end - place]
    return 1 - clear


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


def seen_layers(layers: Layers, motion: AbstractMotion) -> Layers:
    """Layers without those that are clear, off the sensor or behind one that moves along."""
    first, *others = layers.layers
    seen = [
        layer
        for index, layer in enumerate(others)
        if not (_is_off(layers, layer, motion) or _is_covered(layer, others[index + 1 :]))
    ]
    return replace(layers, layers=(first, *seen))


def _is_off(layers: Layers, layer: Layer, motion: AbstractMotion) -> bool:
    """Whether a layer is clear, or no displacement of the exposure brings it onto the sensor."""
    (rows, columns, _), (height, width) = layers.shape, layer.matte.shape
    travel = 1 + abs(layer.speed - float(motion.velocity)) * float(motion.half_exposure)
    below, above = layer.top >= rows, layer.top + height <= 0
    right = layer.left - travel >= columns
    left = layer.left + width + travel + float(motion.stroke) <= 0
    return below or above or bool(right or left) or not layer.matte.any()


def _is_covered(layer: Layer, front: Sequence[Layer]) -> bool:
    return any(other.speed == layer.speed and _covers(other, layer) for other in front)


def _covers(front: Layer, layer: Layer) -> bool:
    """Whether one layer is opaque wherever another, at the same speed, is not clear."""
    top, left = layer.top - front.top, layer.left - front.left
    height, width = layer.matte.shape
    if top < 0 or left < 0:
        return False
    over = front.matte[top : top + height, left : left + width]
    return over.shape == layer.matte.shape and bool(np.all(over[layer.matte > 0] == 1))
