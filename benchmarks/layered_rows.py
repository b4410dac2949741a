r"""Random rows of an object before a background, exposed instant by instant and restored.

The light of a row is $L(x, t) = b(x - s_0 t)(1 - m(x - s_1 t)) + f(x - s_1 t)\,m(x - s_1 t)$:
background and object are Gaussian textures of the default spectrum, and the matte $m$ is 0 or 1
with edges anywhere between the pixels. All three repeat after a period.

A composite of textures below 0.5 cycles/px is exact below 0.5 cycles/px if the matte is exact
below 1, which its edges give in closed form; two points a pixel then hold the product without
aliases. So the row is continuous, the lens passes 0.5 cycles/px and nothing is interpolated.
"""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from support.time_sampling import instants, position

MEAN, DEVIATION, CORNER = 0.25, 0.2, 0.01
"""Of both textures: mean level, standard deviation, and corner of the spectrum, cycles/px."""
PERIOD = 8192
"""Pixels after which rows repeat: many objects, and far more than any kernel."""
FREQUENCY = np.linspace(0, 0.5, 257)
"""Frequencies of the closed form, cycles/px."""
_STEP = 1.0
"""Way between two instants at top speed, px: half of it changes no expected error by 1e-6 dB."""


class Camera(NamedTuple):
    """One exposure as a sum over instants.

    Attributes:
        time: From mid-exposure, s; shape `(q,)`.
        light: Share of a fully open exposure that each instant stands for; shape `(q,)`.
        path: Position of the sensor, px; shape `(q,)`.
        bends: Whether the sensor accelerates, so that layers are placed at their vertices.
        exposure: s.
    """

    time: np.ndarray
    light: np.ndarray
    path: np.ndarray
    bends: bool
    exposure: float

    def place(self, speed):
        """Where a layer of some speed is wanted, px: the vertex of its path, 0 at rest."""
        if not self.bends:
            return 0.0
        half = self.exposure / 2
        a = (self.path @ self.time**2) / np.sum(self.time**4)  # of a parabola
        vertex = speed / (2 * a)
        end = np.copysign(half, vertex)
        return -(speed**2) / (4 * a) if abs(vertex) <= half else (a * end - speed) * end

    def noise(self, photon_rate, read_noise, mean_level=MEAN):
        """Variance of the noise of a pixel; a fully open exposure of white is 1."""
        electrons = photon_rate * self.exposure
        return np.sum(self.light) * mean_level / electrons + (read_noise / electrons) ** 2


def camera(motion, shutter, fastest):
    """The exposure of a motion and a shutter, fine enough for layers of up to `fastest` px/s."""
    half = float(motion.half_exposure)
    top = 2 * float(getattr(motion, "acceleration", 0.0)) * half + fastest
    time, light = instants(motion, shutter, max(32, int(2 * top * half / _STEP)))
    path = position(motion, time)
    return Camera(time, light, path, bool(np.any(path != 0)), 2 * half)


class Spectra(NamedTuple):
    r"""Power of a scene of two layers by what moves with what.

    Attributes:
        frequency: cycles/px; shape `(n,)`.
        object: $(\mu_f - \mu_b)^2 S_m + p^2 S_f + S_f * S_m$, which moves with the object; `(n,)`.
        background: $(1 - p)^2 S_b$, which moves with the background; `(n,)`.
        matte_frequency: Frequencies $g$ of the matte, cycles/px; shape `(m,)`.
        beat: $S_b(f - g) S_m(g)\,dg$, of which each moves at a speed of its own; `(n, m)`.
    """

    frequency: np.ndarray
    object: np.ndarray
    background: np.ndarray
    matte_frequency: np.ndarray
    beat: np.ndarray

    @property
    def wanted(self):
        """Power of the sharp picture; shape `(n,)`."""
        return self.object + self.background + self.beat.sum(1)


def texture(frequency):
    """Power spectrum of a texture, px; 0 above 0.5 cycles/px."""
    steps = (np.arange(8192) + 0.5) / 16384
    scale = DEVIATION**2 / np.mean(1 / (steps**2 + CORNER**2))
    return np.where(np.abs(frequency) <= 0.5, scale / (frequency**2 + CORNER**2), 0.0)


def matte_power(frequency, share, width):
    """Power spectrum of a matte of exponential widths of some mean, px."""
    length = width * (1 - share)
    return share * (1 - share) * 2 * length / (1 + (2 * np.pi * frequency * length) ** 2)


def random_spectra(share, width, frequency=FREQUENCY):
    """The `Spectra` of textures behind and in a matte of exponential widths."""
    corner = 1 / (2 * np.pi * width * (1 - share))
    fine = np.linspace(0, 1, 100_001)
    density = 6 / corner / (1 + (fine / corner) ** 2) + 1000.0
    count = np.concatenate([[0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(fine))])
    number = int(np.ceil(count[-1]))
    g = np.interp((np.arange(number) + 0.5) / number * count[-1], count, fine)
    step = count[-1] / number / np.interp(g, fine, density)
    g, step = np.concatenate([-g[::-1], g]), np.concatenate([step[::-1], step])
    beat = texture(frequency[:, None] - g) * matte_power(g, share, width) * step
    power = texture(frequency)
    return Spectra(frequency, share**2 * power + beat.sum(1), (1 - share) ** 2 * power, g, beat)


def recorded_spectra(spectra, camera, pairs):
    r"""Power of the captured row without noise, and its cross spectrum with the wanted picture.

    $C_{gg}$ and $C_{rg} = E[\bar r g]$, averaged over pairs of speeds of background and object;
    shape `(n,)` each. Every integral is a plain sum.
    """
    f, g, time = spectra.frequency, spectra.matte_frequency, camera.time
    pixel, power, cross = np.sinc(f), 0.0, 0.0
    for behind, front in pairs:
        places = camera.place(behind), camera.place(front)
        under = _waves(f, camera, behind)
        h0, h1 = under.sum(1), _waves(f, camera, front).sum(1)
        gain = under @ np.exp(2j * np.pi * np.outer(time * (front - behind), g))
        put = np.exp(2j * np.pi * ((f[:, None] - g) * places[0] + g * places[1]))
        power = power + spectra.object * np.abs(h1) ** 2 + spectra.background * np.abs(h0) ** 2
        power = power + np.sum(spectra.beat * np.abs(gain) ** 2, axis=1)
        cross = cross + spectra.object * h1 * np.exp(2j * np.pi * f * places[1])
        cross = cross + spectra.background * h0 * np.exp(2j * np.pi * f * places[0])
        cross = cross + np.sum(spectra.beat * gain * put, axis=1)
    return power / len(pairs) * pixel**2, cross / len(pairs) * pixel


def _waves(frequency, camera, speed):
    displacement = camera.path - speed * camera.time
    return camera.light * np.exp(-2j * np.pi * np.multiply.outer(frequency, displacement))


class Filter(NamedTuple):
    """The best single filter of a scene of layers, and the error that it is expected to leave.

    Attributes:
        frequency: cycles/px; shape `(n,)`.
        response: shape `(n,)`, complex.
        error: Expected squared error; white = 1.
    """

    frequency: np.ndarray
    response: np.ndarray
    error: float

    def on_dft(self, period):
        """The response on the grid of a DFT; shape `(period // 2 + 1,)`."""
        return CubicSpline(self.frequency, self.response)(np.fft.rfftfreq(period))


def best_filter(spectra, camera, pairs, noise):
    """The `Filter` of a camera for equally likely pairs of speeds, at frequencies evenly spaced."""
    power, cross = recorded_spectra(spectra, camera, pairs)
    response = np.conj(cross) / (power + noise)
    left = spectra.wanted - np.abs(cross) ** 2 / (power + noise)
    return Filter(spectra.frequency, response, 2 * np.trapezoid(left, spectra.frequency))


def matte_edges(random, share, width, period=PERIOD):
    """Left and right edges of objects along a row that repeats, px; the right end may lie beyond.

    Widths are exponential, `width` on average inside and `width (1 - share) / share` outside. A row
    that does not come round to the state that it began in is drawn anew, which makes the row
    stationary on its circle.
    """
    means = width * (1 - share) / share, width
    while True:
        state = first = int(random.integers(2))
        edges, x = [], random.exponential(means[state])
        while x < period:
            edges.append(x)
            state, x = 1 - state, x + random.exponential(means[1 - state])
        if state == first:
            break
    edges = np.array(edges)
    if first:  # the object over the origin begins at the last edge
        edges = np.concatenate([edges[1:], edges[:1] + period])
        edges = np.array([0.0, period]) if edges.size == 0 else edges
    return edges[0::2], edges[1::2]


def matte_spectrum(left, right, period=PERIOD):
    """Fourier coefficients of a matte by its edges, up to 1 cycle/px; shape `(period + 1,)`."""
    turns = np.arange(period + 1) / period
    ends = np.zeros(turns.size, complex)
    for begin, end in zip(left, right, strict=True):
        ends += np.exp(-2j * np.pi * turns * begin) - np.exp(-2j * np.pi * turns * end)
    ends[1:] /= 2j * np.pi * turns[1:]
    ends[0] = np.sum(right - left)
    return ends


def random_textures(random, count, period=PERIOD):
    """Gaussian rows of the `texture`; Fourier coefficients to 1 cycle/px, `(count, period + 1)`."""
    waves = np.zeros((count, period + 1), complex)
    turns = np.arange(period // 2) / period
    real, imaginary = random.normal(size=(2, count, turns.size))
    waves[:, : turns.size] = np.sqrt(texture(turns) * period / 2) * (real + 1j * imaginary)
    waves[:, 0] = np.sqrt(2) * np.real(waves[:, 0])
    return waves


class Rows(NamedTuple):
    """Rows as two layers; Fourier coefficients up to 1 cycle/px, shape `(rows, period + 1)` each.

    Attributes:
        background: Its texture.
        matte: Where the object is.
        object: Texture times matte.
    """

    background: np.ndarray
    matte: np.ndarray
    object: np.ndarray


def random_rows(random, share, width, count, period=PERIOD):
    """Independent rows of the scene."""
    back, front = (random_textures(random, count, period) for _ in range(2))
    edges = [matte_edges(random, share, width, period) for _ in range(count)]
    matte = np.stack([matte_spectrum(*ends, period) for ends in edges])
    return Rows(back, matte, _spectrum(_values(front) * _values(matte)))


def _values(spectrum):
    """Values at two points a pixel."""
    return 2 * np.fft.irfft(spectrum)


def _spectrum(values):
    return np.fft.rfft(values) / 2


def expose(rows, camera, speeds):
    """Fourier coefficients of the captured rows without noise, up to 0.5 cycles/px; `(rows, k)`."""
    period = rows.background.shape[1] - 1
    turns, seen = np.arange(period + 1) / period, slice(0, period // 2 + 1)
    behind, front = speeds
    back = _values(rows.background)
    total = rows.object[:, seen] * _waves(turns[seen], camera, front).sum(1)
    total = total + rows.background[:, seen] * _waves(turns[seen], camera, behind).sum(1)
    for time, light, path in zip(camera.time, camera.light, camera.path, strict=True):
        moved = rows.matte * np.exp(2j * np.pi * turns * ((front - behind) * time))
        hidden = _spectrum(back * _values(moved))[:, seen]
        total -= hidden * (light * np.exp(-2j * np.pi * turns[seen] * (path - behind * time)))
    return total * np.sinc(turns[seen])


def wanted(rows, camera, speeds):
    """Fourier coefficients of the sharp picture, each layer where it is wanted; `(rows, k)`."""
    period = rows.background.shape[1] - 1
    turns, seen = np.arange(period + 1) / period, slice(0, period // 2 + 1)
    behind, front = (np.exp(-2j * np.pi * turns * camera.place(speed)) for speed in speeds)
    back = rows.background * behind
    hidden = _spectrum(_values(back) * _values(rows.matte * front))
    return (back + rows.object * front - hidden)[:, seen]


def squared_errors(rows, camera, speeds, response, noise):
    """Mean squared error of each restored row, that of the noise by its variance; shape `(rows,)`.

    Args:
        rows: The rows.
        camera: The exposure.
        speeds: Speeds of background and object, px/s.
        response: The filter on the grid of the rows' DFT.
        noise: Variance of the noise of a pixel.
    """
    missed = wanted(rows, camera, speeds) - response * expose(rows, camera, speeds)
    period = rows.background.shape[1] - 1
    both = np.full(response.size, 2.0)
    both[[0, -1]] = 1.0
    left = np.abs(missed) ** 2 @ both / period**2
    return left + noise * (np.abs(response) ** 2 @ both) / period


class Measured(NamedTuple):
    """An error of restored rows, dB below white, its standard error, and what was expected."""

    psnr: float
    standard_error: float
    expected: float


def measure(random, camera, pairs, share, width, noise, count, *, known):
    """Capture and restore random rows, `count` for each pair of speeds, by a filter.

    Args:
        random: NumPy's generator.
        camera: The exposure.
        pairs: Equally likely speeds of background and object, px/s.
        share: Share of the rows that objects cover.
        width: Mean width of an object, px.
        noise: Variance of the noise of a pixel.
        count: Rows for each pair.
        known: The `Filter`.
    """
    response = known.on_dft(PERIOD)
    errors = np.stack(
        [
            squared_errors(
                random_rows(random, share, width, count), camera, speeds, response, noise
            )
            for speeds in pairs
        ]
    )
    mean = np.mean(errors)
    # Pairs are strata: each has its own mean.
    variance = np.mean(np.var(errors, axis=1, ddof=1)) / errors.size
    decibels = -10 * np.log10([mean, known.error])
    return Measured(decibels[0], 10 / np.log(10) * np.sqrt(variance) / mean, decibels[1])
