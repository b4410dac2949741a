"""Frames of a sensor that moves in the plane: what a moving picture leaves in each."""

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from mishutter.camera.capture import distinct_colours, every_colour
from mishutter.camera.responses import aperture_on, frequencies_on, waves_of
from mishutter.camera.rows import MARGIN, Planes, instants_within_reach, nodes_of, window_of
from mishutter.model.frame_path import PlaneFrames
from mishutter.model.scene import Scene


def exposed_in_plane(
    radiance: Planes,
    scene: Scene,
    frames: PlaneFrames,
    velocity: Float[np.ndarray, "2"],
    size: tuple[int | None, int | None],
) -> Iterator[Planes]:
    """Irradiance of the sensor of so many rows and columns in each frame of a moving picture.

    Beyond its borders the picture goes on mirrored.
    """
    num_rows = radiance.shape[0] if size[0] is None else size[0]
    fastest = frames.top_speed + float(np.hypot(*velocity))
    delays, shares = nodes_of(scene.sensor, num_rows, fastest)
    subject = "simulate_frames(speed=..., frames=...)"
    nodes = [instants_within_reach(subject, frames, velocity, each) for each in delays.tolist()]
    furthest = np.max([each.reach(velocity[None]) for each in nodes], axis=0)
    reach = [math.ceil(each) + MARGIN for each in furthest[::-1]]
    picture = radiance if radiance.ndim == 3 else radiance[..., None]
    light = np.asarray(distinct_colours(picture))
    sides = map(seen_along, light.shape, size, reach, ("rows", "columns"))
    around, window = zip(*sides, strict=True)
    light = np.moveaxis(light[around], -1, 0)
    dtype, (rows, columns) = light.dtype, light.shape[1:]
    period = (2 * rows, 2 * columns)
    mirrored = np.pad(light, ((0, 0), (0, rows), (0, columns)), mode="symmetric")
    spectrum = np.fft.rfft2(mirrored) * aperture_on(scene.optics, period)
    turns = 2j * np.pi * frequencies_on(period)[0].ravel()
    own = np.arange(period[0])[window[0]]
    for k in range(frames.num_frames):
        irradiance = np.zeros((light.shape[0], num_rows, window[1].stop - window[1].start))
        for instants, share in zip(nodes, shares, strict=True):
            response = waves_of(instants.some([k]), velocity[None], period)[0, 0]
            if len(nodes) == 1:
                irradiance = np.fft.irfft2(spectrum * response, period)[:, *window]
                continue
            # Only rows that have a share are transformed back.
            rows = np.flatnonzero(share)
            waves = np.exp(np.multiply.outer(own[rows], turns)) / period[0]
            seen = np.fft.irfft(waves @ (spectrum * response), period[1])[..., window[1]]
            irradiance[:, rows] += share[rows, None] * seen
        irradiance = irradiance.astype(dtype)
        exposed = every_colour(np.moveaxis(irradiance, 0, -1), picture)
        yield exposed if radiance.ndim == 3 else exposed[..., 0]


def seen_along(count: int, size: int | None, reach: int, word: str) -> tuple[slice, slice]:
    """The part of a picture that frames see along one axis, and the sensor's in that part."""
    window = window_of(count, size, f"num_{word}", word)
    first, last = max(window.start - reach, 0), min(window.stop + reach, count)
    return slice(first, last), slice(window.start - first, window.stop - first)
