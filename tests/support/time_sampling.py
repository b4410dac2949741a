"""Captures by brute force: the scene as it stands at each of many instants.

A row is the trigonometric polynomial through its pixels. At each instant it is shifted by where the
sensor then is, layers are laid over one another, and all is added up. The width of a pixel is
taken last. Nothing here knows a kernel or a transfer function.

Instants are Gauss-Legendre nodes of equal parts of the exposure: of smooth light some nodes a pixel
of the way leave nothing of note, where an equal step would take tens of thousands.
"""

import numpy as np

MODES = {"reflect": "symmetric", "edge": "edge", "wrap": "wrap", "zero": "constant"}
"""The names that numpy's padding has for the border rules."""
BEYOND = 128
"""Columns by which rows go on before they may come back to their first one, at least."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


def instants(motion, shutter, count, *, breaks=()):
    """Times, s, and the light at each; about `count`, and more beside normalised times `breaks`."""
    ends = np.unique([*np.linspace(-1, 1, -(-count // _NODES.size) + 1), *breaks])
    width = np.diff(ends)[:, None]
    tau = (ends[:-1, None] + width * (_NODES + 1) / 2).ravel()
    light = (width * _WEIGHTS / 4).ravel() * np.asarray(shutter.transmittance(tau), float)
    return tau * float(motion.half_exposure), light


def position(motion, time):
    """Where the sensor is, px from mid-exposure."""
    if not hasattr(motion, "acceleration"):
        return np.asarray(motion.position(time))
    a, v = float(motion.acceleration), float(motion.velocity)
    return (a * time + v) * time


def through_pixels(rows):
    """Periodic rows averaged over the width of a pixel."""
    spectrum = np.fft.rfft(rows)
    return np.fft.irfft(spectrum * np.sinc(np.fft.rfftfreq(rows.shape[-1])), rows.shape[-1])


def through_optics(rows, cutoff):
    """Periodic rows without what is finer than some cycles/px."""
    spectrum = np.fft.rfft(rows)
    passes = np.fft.rfftfreq(rows.shape[-1]) <= cutoff
    return np.fft.irfft(spectrum * passes, rows.shape[-1])


def through_lens(rows, deviation):
    """Periodic rows averaged over displacements of a Gaussian, by Gauss-Hermite quadrature."""
    places, weights = np.polynomial.hermite_e.hermegauss(40)
    turns = 2 * np.pi * np.fft.rfftfreq(rows.shape[-1])
    shifts = np.exp(1j * deviation * np.multiply.outer(turns, places)) @ (weights / weights.sum())
    return np.fft.irfft(np.fft.rfft(rows) * shifts, rows.shape[-1])


def captured_row(
    rows,
    motion,
    shutter,
    *,
    speed=0.0,
    displacement=0.0,
    cutoff=0.5,
    lens=0.0,
    count=2_000,
    breaks=(),
):
    """Light on the sensor from periodic rows `(..., period)`; from the lowest place on a bend."""
    time, light = instants(motion, shutter, count, breaks=breaks)
    place = position(motion, time) - speed * time + displacement
    if hasattr(motion, "acceleration"):
        a, half = float(motion.acceleration), float(motion.half_exposure)
        relative = speed - float(motion.velocity)
        turn = np.clip(relative / (2 * a), -half, half) if a > 0 else 0.0
        place -= (a * turn - relative) * turn
    else:
        steps = np.linspace(-1, 1, 200_001) * float(motion.half_exposure)
        place -= np.min(position(motion, steps) - speed * steps)
    period = rows.shape[-1]
    spectrum = np.fft.rfft(rows)
    # The sum over instants is done for each frequency: the same as adding the shifted rows.
    turns = np.fft.rfftfreq(period)
    response = np.array([np.sum(light * np.exp(-2j * np.pi * f * place)) for f in turns])
    seen = through_lens(np.fft.irfft(spectrum * response, period), lens)
    return through_pixels(through_optics(seen, cutoff))


def continued(rows, border):
    """One period of rows that go on by a rule, and the columns of it that are their own."""
    columns = rows.shape[-1]
    before, after = BEYOND, BEYOND + 1 - columns % 2
    if border in ("wrap", "reflect"):
        own = columns * (1 + (border == "reflect"))
        after = own * -(-(columns + 2 * BEYOND) // own) - columns - BEYOND
    aside = [(0, 0)] * (rows.ndim - 1)
    wide = np.pad(rows, [*aside, (before, after)], mode=MODES[border])
    if border == "edge":  # by a slope, for a step has waves that go far
        share = (np.arange(BEYOND) + 0.5) / BEYOND
        slope = rows[..., -1:] * (1 - share) + rows[..., :1] * share
        wide = np.concatenate([wide, slope], axis=-1)
    return wide, slice(before, before + columns)


def captured_picture(picture, motion, shutter, *, border="reflect", **options):
    """The capture of `(rows, columns, channels)` that goes on by a rule, far beyond its ends."""
    wide, own = continued(np.moveaxis(picture, 1, -1), border)
    return np.moveaxis(captured_row(wide, motion, shutter, **options)[..., own], -1, 1)


def captured_layers(layers, motion, shutter, *, count=400, cutoff=0.5, lens=0.0, breaks=()):
    """The capture of `Layers` by compositing at each instant.

    A composite of $n$ layers holds up to $n/2$ cycles/px. It is made on so many more columns that
    none of these looks like what a row of pixels holds.
    """
    rows, _, channels = layers.shape
    back, own = continued(_planes(layers.layers[0], channels), layers.border)
    period, finer = back.shape[-1], -(-(len(layers.layers) + 1) // 2)
    spectra = [(layers.layers[0].speed, np.fft.rfft(np.stack([*back, np.ones_like(back[0])])))]
    for layer in layers.layers[1:]:
        spectra.append((layer.speed, np.fft.rfft(_placed(layer, layers.shape, own.start, period))))
    spectrum = 0.0
    for time, light in zip(*instants(motion, shutter, count, breaks=breaks), strict=True):
        image = np.zeros((channels, rows, finer * period))
        for speed, spectrum_of_layer in spectra:
            place = float(position(motion, time)) - speed * time
            *colour, matte = _finer(spectrum_of_layer, place, period, finer)
            image = image * (1 - matte) + np.stack(colour)
        spectrum = spectrum + light * np.fft.rfft(image)[..., : period // 2 + 1] / finer
    seen = through_lens(np.fft.irfft(spectrum, period), lens)
    light = through_pixels(through_optics(seen, cutoff))
    return np.moveaxis(light[..., own], 0, -1)


def _planes(layer, channels):
    """Light of a layer, columns last."""
    light = np.broadcast_to(layer.picture.light, (*layer.matte.shape, channels))
    return np.moveaxis(light.astype(float), -1, 0)


def _placed(layer, shape, left, period):
    """Light times matte and matte on rows of the sensor, of which column 0 stands at `left`."""
    rows, _, channels = shape
    planes = np.zeros((channels + 1, rows, period))
    shown = np.concatenate([_planes(layer, channels) * layer.matte, layer.matte[None]])
    for r in range(layer.matte.shape[0]):
        for c in range(layer.matte.shape[1]):
            y, x = r + layer.top, c + layer.left + left
            if 0 <= y < rows and 0 <= x < period:
                planes[:, y, x] = shown[:, r, c]
    return planes


def _finer(spectrum, distance, period, finer):
    turns = np.arange(spectrum.shape[-1]) / period
    moved = spectrum * np.exp(-2j * np.pi * turns * distance)
    if finer > 1 and period % 2 == 0:  # half of it belongs to the negative frequency
        moved[..., -1] /= 2
    return finer * np.fft.irfft(moved, finer * period)


def captured_footage(frames, motion, shutter, *, border="reflect", count=800, breaks=()):
    """The capture of footage: at each instant the frame that shows, shifted."""
    shown, total = np.linspace(-1, 1, len(frames) + 1), 0.0
    time, light = instants(motion, shutter, count, breaks=[*shown, *breaks])
    number = np.searchsorted(shown, time / float(motion.half_exposure)) - 1
    for index, frame in enumerate(frames):
        wide, own = continued(np.moveaxis(frame, 1, -1), border)
        spectrum, period = np.fft.rfft(wide), wide.shape[-1]
        turns = np.fft.rfftfreq(period)
        for t, w in zip(time[number == index], light[number == index], strict=True):
            total = total + w * spectrum * np.exp(-2j * np.pi * turns * float(position(motion, t)))
    return np.moveaxis(through_pixels(np.fft.irfft(total, period))[..., own], -1, 1)
