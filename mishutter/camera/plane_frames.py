r"""Frames of a sensor that moves in the plane: what a moving picture leaves in each.

From the middle of the frames on a thing is displaced on the sensor by
$\mathbf x(t) - \mathbf v\,t$. A frame passes
$\operatorname{sinc} f_x\,\operatorname{sinc} f_y\,O(\mathbf f)$ times the mean of
$e^{-2\pi i\,\mathbf f\cdot(\mathbf x(t) - \mathbf v\,t)}$ over its exposure. One axis is a picture
whose power lies along one line.
"""

import math
from collections.abc import Iterator

import numpy as np
from jaxtyping import Complex, Float

from mishutter._core.checks import require, require_positive_int
from mishutter.blur.waves import waves_in_plane
from mishutter.camera.capture import distinct_colours, every_colour
from mishutter.camera.rows import MARGIN, Planes, instants_within_reach, nodes_of
from mishutter.evaluation.instants import Instants
from mishutter.model.optics import NYQUIST_FREQUENCY, Optics, lens_response
from mishutter.model.scene import Scene
from mishutter.model.sequences import PlaneFrames


def responses_in_plane(
    instants: Instants, velocity: Float[np.ndarray, "2"], shape: tuple[int, ...]
) -> Complex[np.ndarray, "n m k"]:
    """Responses at a velocity, displacements included, but for the `aperture_on`."""
    displaced = instants.displacement(velocity)
    return waves_in_plane(displaced, instants.weight, frequencies_on(shape))


def frequencies_on(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies down the columns and along the rows of half of a DFT; cycles/px."""
    return np.fft.fftfreq(shape[0]), np.fft.rfftfreq(shape[1])


def aperture_on(optics: Optics, shape: tuple[int, int], size: int = 1) -> Float[np.ndarray, "m n"]:
    """Response of a pixel of some size behind the lens, on the grid of a DFT of such pixels."""
    down, across = frequencies_on(shape)
    radius = np.hypot(down[:, None], across) / size
    cutoff = float(optics.cutoff_frequency)
    lens = lens_response(radius, float(optics.lens_blur))
    if cutoff < NYQUIST_FREQUENCY:
        lens = np.where(radius <= cutoff * (1 + 1e-12), lens, 0.0)
    return np.sinc(down)[:, None] * np.sinc(across) * lens


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
    turns = 2j * np.pi * frequencies_on(period)[0]
    own = np.arange(period[0])[window[0]]
    for k in range(frames.num_frames):
        irradiance = np.zeros((light.shape[0], num_rows, window[1].stop - window[1].start))
        for instants, share in zip(nodes, shares, strict=True):
            response = responses_in_plane(instants.some([k]), velocity, period)[0]
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
    size = count if size is None else size
    subject = f"simulate_frames(num_{word}=...)"
    require_positive_int(subject, size)
    require(size <= count, subject, f"be at most the picture's {count} {word}", size)
    start = (count - size) // 2
    first, last = max(start - reach, 0), min(start + size + reach, count)
    return slice(first, last), slice(start - first, start - first + size)
