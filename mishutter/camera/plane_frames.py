r"""Frames of a sensor that moves in the plane: what a moving picture leaves in each.

From the middle of the frames on a thing is displaced on the sensor by
$\mathbf x(t) - \mathbf v\,t$. A frame passes
$\operatorname{sinc} f_x\,\operatorname{sinc} f_y\,O(\mathbf f)$ times the mean of
$e^{-2\pi i\,\mathbf f\cdot(\mathbf x(t) - \mathbf v\,t)}$ over its exposure. One axis is a picture
whose power lies along one line.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Complex, Float

from mishutter._core.checks import require, require_positive_int
from mishutter.blur.waves import waves_in_plane
from mishutter.camera.capture import distinct_colours, every_colour
from mishutter.camera.rows import MARGIN, MAX_REACH, Planes
from mishutter.model.optics import NYQUIST_FREQUENCY, Optics, lens_response
from mishutter.plane.frames import PlaneFrames


class Instants(NamedTuple):
    """Instants of frames, and where the sensor is then."""

    time: Float[np.ndarray, "n q"]  # Times from the middle of the frames; s
    place: Float[np.ndarray, "2 n q"]  # Places along rows and columns from that in the middle; px
    weight: Float[np.ndarray, "q"]  # Share of the exposure

    @staticmethod
    def of(frames: PlaneFrames, fastest: float, size: int = 1) -> "Instants":
        """Quadrature nodes of concrete frames, for things up to a speed, on pixels of some size."""
        small = eqx.tree_at(lambda x: x.velocities, frames, np.asarray(frames.velocities) / size)
        first, last = (
            float(frames.times[k]) + sign * float(frames.exposures[k]) / 2
            for k, sign in ((0, -1), (-1, 1))
        )
        middle = np.array((first + last) / 2)
        time, _, weight = small.nodes(small.num_panels(fastest / size))
        time = np.asarray(frames.times, np.float64)[:, None] + np.asarray(time, np.float64)
        place = np.asarray(small.place(time) - small.place(middle)[:, None, None], np.float64)
        return Instants(time - middle, place, np.asarray(weight, np.float64))

    def displacement(self, velocity: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2 n q"]:
        """Way of a thing on the sensor since the middle of the frames; px."""
        return self.place - velocity[:, None, None] * self.time

    def middles(self, velocity: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2 n"]:
        """The mean way of a thing in each frame; px."""
        return self.displacement(velocity) @ self.weight

    def part(self, frames: slice) -> "Instants":
        """Those of some frames, from the mean of their own times and places on."""
        time, place = self.time[frames], self.place[:, frames]
        middle = np.mean(place, axis=(1, 2), keepdims=True)
        return Instants(time - np.mean(time), place - middle, self.weight)

    def reach(self, velocities: Float[np.ndarray, "s 2"]) -> tuple[int, int]:
        """Furthest displacement down the columns and along the rows at some velocities; px."""
        each = [np.max(np.abs(self.displacement(v)), axis=(1, 2)) for v in velocities]
        across, down = np.max(each, axis=0).tolist()
        return math.ceil(down), math.ceil(across)

    def responses(
        self, velocity: Float[np.ndarray, "2"], shape: tuple[int, ...]
    ) -> Complex[np.ndarray, "n m k"]:
        """Responses at a velocity, displacements included, but for the `aperture_on`."""
        displaced = self.displacement(velocity)
        return waves_in_plane(displaced, self.weight[None], frequencies_on(shape))


def require_reach_in_plane(
    subject: str, frames: PlaneFrames, velocity: Float[np.ndarray, "2"]
) -> Instants:
    """Instants of frames at a velocity that displaces light by no more than `MAX_REACH`."""
    speed = float(np.hypot(*velocity))
    requirement = f"displace light by at most {MAX_REACH} px"
    # Before there are as many nodes as such a displacement would need.
    require(speed * frames.duration <= 2 * MAX_REACH, subject, requirement, speed * frames.duration)
    instants = Instants.of(frames, speed)
    reach = max(instants.reach(velocity[None]))
    require(reach <= MAX_REACH, subject, requirement, reach)
    return instants


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
    optics: Optics,
    frames: PlaneFrames,
    velocity: Float[np.ndarray, "2"],
    size: tuple[int | None, int | None],
) -> Iterator[Planes]:
    """Irradiance of the sensor of so many rows and columns in each frame of a moving picture.

    Beyond its borders the picture goes on mirrored.
    """
    instants = require_reach_in_plane("simulate_frames(speed=..., frames=...)", frames, velocity)
    reach = [each + MARGIN for each in instants.reach(velocity[None])]
    picture = radiance if radiance.ndim == 3 else radiance[..., None]
    light = np.asarray(distinct_colours(picture))
    around, window = zip(*map(_around, light.shape, size, reach, ("rows", "columns")), strict=True)
    light = np.moveaxis(light[around], -1, 0)
    dtype, (rows, columns) = light.dtype, light.shape[1:]
    period = (2 * rows, 2 * columns)
    mirrored = np.pad(light, ((0, 0), (0, rows), (0, columns)), mode="symmetric")
    spectrum = np.fft.rfft2(mirrored) * aperture_on(optics, period)
    for k in range(frames.num_frames):
        one = Instants(instants.time[k : k + 1], instants.place[:, k : k + 1], instants.weight)
        response = one.responses(velocity, period)[0]
        irradiance = np.fft.irfft2(spectrum * response, period)[:, *window].astype(dtype)
        exposed = every_colour(np.moveaxis(irradiance, 0, -1), picture)
        yield exposed if radiance.ndim == 3 else exposed[..., 0]


def _around(count: int, size: int | None, reach: int, word: str) -> tuple[slice, slice]:
    """The part of a picture that frames see along one axis, and the sensor's in that part."""
    size = count if size is None else size
    subject = f"simulate_frames(num_{word}=...)"
    require_positive_int(subject, size)
    require(size <= count, subject, f"be at most the picture's {count} {word}", size)
    start = (count - size) // 2
    first, last = max(start - reach, 0), min(start + size + reach, count)
    return slice(first, last), slice(start - first, start - first + size)
