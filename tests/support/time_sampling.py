"""Captures by brute force: the scene as it stands at each of thousands of instants.

A row is the trigonometric polynomial through its pixels. At each instant it is shifted by where the
sensor then is, layers are laid over one another, and all is added up. The width of a pixel is
taken last. Nothing here knows a kernel or a transfer function.
"""

import numpy as np


def instants(motion, shutter, count):
    """Times, s, and the light at each, of equal parts of an exposure."""
    half = float(motion.half_exposure)
    tau = (np.arange(count) + 0.5) / count * 2 - 1
    return tau * half, np.asarray(shutter.transmittance(tau), float) / count


def position(motion, time):
    """Where the sensor is, px from mid-exposure."""
    a, v = float(motion.acceleration), float(motion.velocity)
    return (a * time + v) * time


def through_pixels(rows):
    """Periodic rows averaged over the width of a pixel."""
    spectrum = np.fft.rfft(rows)
    return np.fft.irfft(spectrum * np.sinc(np.fft.rfftfreq(rows.shape[-1])), rows.shape[-1])


def shifted(spectrum, distance, period):
    """A periodic row, given by its DFT, displaced by a distance."""
    turns = np.arange(spectrum.shape[-1]) / period
    return np.fft.irfft(spectrum * np.exp(-2j * np.pi * turns * distance), period)


def captured_row(rows, motion, shutter, *, speed=0.0, displacement=0.0, count=40_000):
    """Light on the sensor from periodic rows `(..., period)`; aligned at the vertex if there is one."""
    time, light = instants(motion, shutter, count)
    a, relative = float(motion.acceleration), speed - float(motion.velocity)
    vertex = relative**2 / (4 * a) if a > 0 else 0.0
    place = position(motion, time) - speed * time + vertex + displacement
    period = rows.shape[-1]
    spectrum = np.fft.rfft(rows)
    # The sum over instants is done for each frequency: the same as adding the shifted rows.
    turns = np.fft.rfftfreq(period)
    response = np.array([np.sum(light * np.exp(-2j * np.pi * f * place)) for f in turns])
    return through_pixels(np.fft.irfft(spectrum * response, period))


def captured_layers(layers, motion, shutter, *, count=2_000, finer=4, beyond=256):
    """The capture of `Layers` by compositing at each instant, on `finer` times as many columns."""
    rows, columns, channels = layers.shape
    period = columns + 2 * beyond
    each = [_spectra(layers, i, beyond, period) for i in range(len(layers.layers))]
    total = np.zeros((channels, rows, finer * period))
    for time, light in zip(*instants(motion, shutter, count), strict=True):
        image = np.zeros_like(total)
        for layer, (colour, matte) in zip(layers.layers, each, strict=True):
            place = float(position(motion, time)) - layer.speed * time
            shown = [_finer(x, place, period, finer) for x in (colour, matte)]
            image = image * (1 - shown[1][None]) + shown[0]
        total += light * image
    spectrum = np.fft.rfft(total)[..., : period // 2 + 1] / finer
    found = np.fft.irfft(spectrum * np.sinc(np.fft.rfftfreq(period)), period)
    return np.moveaxis(found[..., beyond : beyond + columns], 0, -1)


def _spectra(layers, index, beyond, period):
    rows, columns, channels = layers.shape
    layer = layers.layers[index]
    light = np.broadcast_to(layer.picture.light, (*layer.matte.shape, channels)).astype(float)
    if index == 0:
        modes = {"reflect": "symmetric", "edge": "edge", "wrap": "wrap", "zero": "constant"}
        wide = np.pad(light, ((0, 0), (beyond, beyond), (0, 0)), mode=modes[layers.border])
        return np.fft.rfft(np.moveaxis(wide, -1, 0)), np.fft.rfft(np.ones((rows, period)))
    colour, matte = np.zeros((channels, rows, period)), np.zeros((rows, period))
    for r in range(layer.matte.shape[0]):
        for c in range(layer.matte.shape[1]):
            y, x = r + layer.top, c + layer.left + beyond
            if 0 <= y < rows and 0 <= x < period:
                matte[y, x] = layer.matte[r, c]
                colour[:, y, x] = layer.matte[r, c] * light[r, c]
    return np.fft.rfft(colour), np.fft.rfft(matte)


def _finer(spectrum, distance, period, finer):
    turns = np.arange(spectrum.shape[-1]) / period
    moved = spectrum * np.exp(-2j * np.pi * turns * distance)
    return finer * np.fft.irfft(moved, finer * period)


def captured_footage(frames, motion, shutter, *, border="reflect", count=4_000, beyond=256):
    """The capture of footage: at each instant the frame that shows, shifted."""
    modes = {"reflect": "symmetric", "edge": "edge", "wrap": "wrap", "zero": "constant"}
    columns = frames[0].shape[1]
    period, total, per_frame = columns + 2 * beyond, 0.0, count // len(frames)
    time, light = instants(motion, shutter, per_frame * len(frames))
    for index, frame in enumerate(frames):
        wide = np.pad(frame, ((0, 0), (beyond, beyond), (0, 0)), mode=modes[border])
        spectrum = np.fft.rfft(np.moveaxis(wide, -1, 0))
        for t, w in list(zip(time, light, strict=True))[index * per_frame : (index + 1) * per_frame]:
            total = total + w * shifted(spectrum, float(position(motion, t)), period)
    return np.moveaxis(through_pixels(total)[..., beyond : beyond + columns], 0, -1)
