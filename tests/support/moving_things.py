"""Frames of things that move in any direction before a background, and their middle picture."""

from typing import NamedTuple

import numpy as np
from scipy import ndimage


class Thing(NamedTuple):
    """A thing with a texture, round or of two lobes, that may turn as it moves."""

    light: np.ndarray  # Larger than it
    centre: tuple[float, float]  # Row and column at the time 0
    radius: float  # px
    velocity: tuple[float, float]  # Down and across; px/s
    lobes: float = 0.0  # By which share its radius rises and falls, twice about it
    turn: float = 0.0  # rad/s


def texture(random, size, mean=0.35, spread=0.12):
    """Noise of a photograph's spectrum."""
    down, across = np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)
    noise = np.fft.rfft2(random.normal(size=(size, size))) / (down**2 + across**2 + 4e-4) ** 0.75
    field = np.fft.irfft2(noise, (size, size))
    return np.clip(mean + spread * (field - field.mean()) / field.std(), 0.02, 1)


def shown(ground, things, time):
    """The picture at a time, or each row at one of its own, and the matte of each thing."""
    rows, columns = np.mgrid[: ground.shape[0], : ground.shape[1]].astype(float)
    picture, mattes = ground, []
    for light, centre, radius, velocity, lobes, turn in things:
        y, x = (
            at - middle - v * time
            for at, middle, v in zip((rows, columns), centre, velocity, strict=True)
        )
        cos, sin = np.cos(turn * time), np.sin(turn * time)
        y, x = cos * y - sin * x, sin * y + cos * x
        reach = radius * (1 + lobes * np.cos(2 * np.arctan2(y, x)))
        matte = np.clip(0.5 + reach - np.hypot(y, x), 0, 1)
        middle = light.shape[0] // 2
        own = ndimage.map_coordinates(light, [y + middle, x + middle], order=3, mode="mirror")
        picture = picture * (1 - matte) + matte * own
        mattes = [each * (1 - matte) for each in mattes] + [matte]
    return picture, mattes


def frames_of(ground, things, times, exposures, random, rate=1e5, read_noise=8.0, delays=(0.0,)):
    """Frames with noise, each the mean of eight instants of its exposure, of rows with delays."""
    frames, late = [], np.reshape(delays, (-1, 1))
    for time, exposure in zip(times, exposures, strict=True):
        instants = time + exposure * ((np.arange(8) + 0.5) / 8 - 0.5)
        light = np.mean([shown(ground, things, each + late)[0] for each in instants], axis=0)
        electrons = rate * exposure
        counts = random.poisson(light * electrons) + random.normal(0, read_noise, light.shape)
        frames.append(counts / electrons)
    return np.array(frames)


def decibels(one, other):
    """PSNR of one picture by another."""
    return float(-10 * np.log10(np.mean((np.asarray(one) - other) ** 2)))
