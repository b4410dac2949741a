"""Temporal integration by brute force: many images of the whole sensor, each weighted.

A frame is what a high-speed camera shows that is open for the whole frame: a layer
that crosses an edge of a pixel within a frame is split between its two places.
"""

import numpy as np

from mishutter.blur.intervals import exposure_cells, pixel_phase


def integrate_cells(layers, motion, shutter):
    """The capture of `layers` as a sum of one image for each cell of the exposure; float64."""
    cells = exposure_cells(shutter, motion, np.array([float(x.speed) for x in layers.layers]))
    reach = int(np.max(np.abs(cells.shifts)))
    padded = [_padded(layers, i, reach) for i in range(len(layers.layers))]
    total = np.zeros(layers.shape)
    for shifts, light in zip(cells.shifts.tolist(), cells.light, strict=True):
        image = np.zeros(layers.shape)
        for (colour, matte), shift in zip(padded, shifts, strict=True):
            image *= 1 - _moved(matte, shift, reach, layers.shape[1])
            image += _moved(colour, shift, reach, layers.shape[1])
        total += light * image
    return total


def integrate_frames(layers, motion, shutter, num_frames, *, sharp=False):
    """The capture of `layers` as a sum of `num_frames` composited frames; float64."""
    half, a, v = (float(getattr(motion, x)) for x in ("half_exposure", "acceleration", "velocity"))
    ends = np.linspace(-half, half, num_frames + 1)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    times = ends[:-1, None] + np.diff(ends)[:, None] * (nodes + 1) / 2
    light = np.asarray(shutter.transmittance(times / half)) @ weights / (2 * num_frames)
    rows, columns, channels = layers.shape
    total = np.zeros((rows, columns, channels))
    reach = 2 + max(int(np.ceil(a * half**2 + abs(x.speed - v) * half)) for x in layers.layers)
    padded = [_padded(layers, i, reach) for i in range(len(layers.layers))]
    for begin, end, share in zip(ends[:-1], ends[1:], light, strict=True):
        frame = np.zeros((rows, columns, channels))
        for (colour, matte), layer in zip(padded, layers.layers, strict=True):
            x, y = (a * t * t + v * t - layer.speed * t - pixel_phase(motion) for t in (begin, end))
            x, y = ((x + y) / 2,) * 2 if sharp else (x, y)
            low, high = int(np.floor(min(x, y))), int(np.floor(max(x, y)))
            part = (max(x, y) - high) / abs(y - x) if high > low else 0.0
            shown = [_moved(c, low, reach, columns) for c in (colour, matte)]
            if part:
                later = [_moved(c, high, reach, columns) for c in (colour, matte)]
                shown = [(1 - part) * u + part * v for u, v in zip(shown, later, strict=True)]
            frame = frame * (1 - shown[1]) + shown[0]
        total += share * frame
    return total


def _padded(layers, index, reach):
    rows, columns, channels = layers.shape
    layer = layers.layers[index]
    light = np.broadcast_to(layer.picture.light, (*layer.matte.shape, channels))
    if index == 0:
        modes = {"reflect": "symmetric", "edge": "edge", "wrap": "wrap", "zero": "constant"}
        light = np.pad(light, ((0, 0), (reach, reach), (0, 0)), mode=modes[layers.border])
        return light.astype(float), np.ones((*light.shape[:2], 1))
    colour = np.zeros((rows, columns + 2 * reach, channels))
    matte = np.zeros((rows, columns + 2 * reach, 1))
    for r in range(layer.matte.shape[0]):
        for c in range(layer.matte.shape[1]):
            y, x = r + layer.top, c + layer.left + reach
            if 0 <= y < rows and 0 <= x < matte.shape[1]:
                matte[y, x, 0] = layer.matte[r, c]
                colour[y, x] = layer.matte[r, c] * light[r, c]
    return colour, matte


def _moved(picture, shift, reach, columns):
    return picture[:, reach - shift : reach - shift + columns]
