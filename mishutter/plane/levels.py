r"""The level of frames of things that move in any direction: a sum over scenes of one axis.

A decoder that finds the velocity $\mathbf v$ in the frames leaves

$$E = \int S(\mathbf f)\,\overline{\frac{1}{1 + S P\sum_k e_k^2|H_k|^2/N_k}}\,d\mathbf f,
\qquad
H_k = \frac1{D_k}\int e^{-2\pi i\,\mathbf f\cdot(\mathbf x_k(t) - \mathbf v\,t)}\,dt,$$

with $e_k$ electrons of white, $N_k = \bar f e_k + \sigma^2$ and
$P = \operatorname{sinc}^2 f_x\operatorname{sinc}^2 f_y$ behind the lens. At a frequency of
direction $\hat{\mathbf f}$ the path counts through $\mathbf x_k\cdot\hat{\mathbf f}$ and the
velocity through $\mathbf v\cdot\hat{\mathbf f}$: each direction is a scene of one axis, and one
axis is a fan of one line.

The isotropic picture of the power $(f^2 + 0.01^2)^{-3/2}$ has rows of the power
$2/(f^2 + 0.01^2)$, which stand for a picture on one axis.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import all_concrete, require
from mishutter._core.compiling import compiled
from mishutter.evaluation.open_frames import power_of_waves
from mishutter.evaluation.sequences import psnr_of_frames
from mishutter.model.exposures import AbstractExposures, Lights
from mishutter.model.optics import NYQUIST_FREQUENCY, pixel_response
from mishutter.model.scene import Scene, require_scene
from mishutter.model.sensor import DARK, noise_power, white_electrons
from mishutter.model.texture import CORNER_FREQUENCY
from mishutter.model.velocities import AbstractVelocities, Components, EvenVelocities
from mishutter.pictures.images import Picture
from mishutter.plane.frames import PlaneFrames


class Grid(NamedTuple):
    """Sizes of a fan: radii, directions and components of the velocities along each."""

    num_radii: int  # Radii up to the highest frequency of an axis
    num_angles: int  # Directions, an even number
    num_speeds: int  # Components of a law that is no list
    num_corner: int = 4  # Further radii, in the corners of the square of frequencies


SEARCHED, MEASURED = Grid(24, 8, 16), Grid(32, 16, 32)
"""Grids of searches, whose optimum exploits what a coarser one leaves out, and of levels."""


class Fan(NamedTuple):
    """Frequencies along lines through 0, each of which is a scene of one axis."""

    radius: Float[Array | np.ndarray, "i"]  # cycles/px, shape `(i,)`
    direction: Float[Array | np.ndarray, "i j"]  # Angles from the rows at each radius; rad
    power: Float[Array | np.ndarray, "i j"]  # Power of a picture of the deviation 1; shape `(i, j)`
    weight: Float[Array | np.ndarray, "i j"]  # Share of the frequencies times `power`; sums to 1

    @staticmethod
    def of(scene: Scene, grid: Grid = MEASURED) -> "Fan":
        """Those of half of the plane, which stand for both halves, and a picture's power there.

        The power is that of the scene's photograph, or the isotropic one where it brings none.
        """
        cutoff = min(float(scene.optics.cutoff_frequency), NYQUIST_FREQUENCY)
        radius, angle, area = _polar(grid, cutoff)
        shape = _power_of_scene(scene)(radius[:, None], angle)
        total = np.sum(area * shape)
        return Fan(radius, angle, shape / total, area * shape / total)


def picture_power_on(
    scene: Scene,
    down: Float[np.ndarray, "m"],  # cycles/px
    across: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "m n"]:
    """Power of the scene's pictures at pairs of frequencies, of which the mean is the variance."""
    cutoff = float(scene.optics.cutoff_frequency)
    radius, angle, area = _polar(MEASURED, min(cutoff, NYQUIST_FREQUENCY))
    shape = _power_of_scene(scene)
    scale = float(scene.picture.deviation) ** 2 / np.sum(area * shape(radius[:, None], angle))
    here = np.hypot(down[:, None], across)
    power = scale * shape(here, np.arctan2(down[:, None], across + 0 * here))
    return power if cutoff >= NYQUIST_FREQUENCY else np.where(here <= cutoff, power, 0.0)


def _power_of_scene(scene: Scene) -> "Callable[[np.ndarray, np.ndarray], np.ndarray]":
    """Power of a scene's pictures by radius and angle, on a scale of its own."""
    if scene.picture.path is None:
        return lambda radius, angle: ((radius + 0 * angle) ** 2 + CORNER_FREQUENCY**2) ** -1.5
    return power_of(scene.picture.photograph())


@lru_cache
def _polar(grid: Grid, cutoff: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radii, angles and areas of half of the disc up to a cutoff, or of half of the square."""
    s, weight = np.polynomial.legendre.leggauss(grid.num_radii)
    s, weight = (s + 1) / 2, weight / 2
    # Low frequencies, at which a picture has most of its power, are dense.
    radius, step = cutoff * s**2, 2 * cutoff * s * weight
    count = grid.num_angles
    angle = np.tile((np.arange(count) + 0.5) * np.pi / count, (radius.size, 1))
    area = (2 * np.pi / count * radius * step)[:, None] * np.ones(count)
    if cutoff < NYQUIST_FREQUENCY:
        return radius, angle, area
    x, weight = np.polynomial.legendre.leggauss(grid.num_corner)
    width = np.sqrt(0.5) - 0.5
    corner, step = 0.5 + width * (x + 1) / 2, width / 2 * weight
    x, weight = np.polynomial.legendre.leggauss(count // 2)
    first = np.arccos(0.5 / corner)
    middle, half = np.pi / 4, np.pi / 4 - first
    arc = middle + half[:, None] * x
    share = 2 * (corner * step * half)[:, None] * weight
    return (
        np.r_[radius, corner],
        np.vstack([angle, np.hstack([arc, arc + np.pi / 2])]),
        np.vstack([area, np.hstack([share, share])]),
    )


def power_of(picture: Picture) -> "_Power":
    r"""The power of a photograph by frequency: a smooth one, fitted to its periodogram.

    $\log S$ is $(1, \log f, \log^2 f)$ times $(1, \cos 2\theta, \sin 2\theta, \cos 4\theta)$, by
    least squares over the plane in equal parts of $\log f$. Photographs hold more detail along
    their axes than along diagonals.
    """
    light = np.asarray(picture.light, np.float64)
    light = light.mean(axis=tuple(range(2, light.ndim)))
    windows = [np.hanning(count + 2)[1:-1] for count in light.shape]
    window = np.outer(*windows)
    field = (light - np.sum(light * window) / np.sum(window)) * window
    power = np.abs(np.fft.rfft2(field)) ** 2
    down, across = np.fft.fftfreq(light.shape[0])[:, None], np.fft.rfftfreq(light.shape[1])[None]
    radius, angle = np.hypot(down, across), np.arctan2(down, across + 0 * down)
    # Within two steps of 0 the window has smeared the mean.
    occurs = (radius > 2.5 / min(light.shape)) & (radius < NYQUIST_FREQUENCY) & (power > 0)
    radius, angle, power = radius[occurs], angle[occurs], power[occurs]
    terms, root = _terms(radius, angle), 1 / radius[:, None]
    fitted = np.linalg.lstsq(root * terms, root[:, 0] * np.log(power), rcond=None)[0]
    return _Power(fitted, float(np.min(radius)))


class _Power(NamedTuple):
    """A fitted power: its coefficients, and the least frequency of the fit."""

    coefficients: Float[np.ndarray, "c"]
    least: float

    def __call__(
        self, radius: Float[np.ndarray, "*#shape"], angle: Float[np.ndarray, "*#shape"]
    ) -> Float[np.ndarray, "..."]:
        radius = np.maximum(radius + 0 * angle, self.least)
        return np.exp(_terms(radius, angle) @ self.coefficients)


def _terms(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    log, turn = np.log(radius), 2 * angle
    over = [np.ones_like(log), log, log * log]
    about = [np.ones_like(turn), np.cos(turn), np.sin(turn), np.cos(2 * turn)]
    return np.stack([x * y for x in over for y in about], axis=-1)


def plane_psnr(
    scene: Scene,
    frames: PlaneFrames,
    *,
    grid: Grid = MEASURED,
    num_panels: int | None = None,
) -> Float[Array, ""]:
    """PSNR of the best linear decoder that finds the velocity in frames, in linear light; dB.

    It has derivatives by all numbers of the frames, of the light and of the law of velocities.

    Args:
        scene: Velocities in any direction, light and noise; its picture and cutoff are concrete.
        frames: The frames.
        grid: Sizes of the fan of directions.
        num_panels: Panels of 16 nodes in each frame; by default those that concrete frames need.

    Raises:
        ValueError: if the scene is of one axis, or the frames are traced without `num_panels`.
    """
    require_scene(scene, in_plane=True)
    error = plane_error(scene, frames, Fan.of(scene, grid), grid.num_speeds, num_panels)
    return -10 * jnp.log10(error)


def psnr_by_lights(scene: Scene, exposures: AbstractExposures, lights: Lights) -> float:
    """PSNR of frames, registered, as long as they are lit; dB."""
    frames = exposures.frames
    if len(exposures.axes) == 1:
        return psnr_of_frames(scene, frames, lights=lights)
    begin, end = np.transpose(lights)
    where = lambda x: (x.times, x.exposures)  # noqa: E731
    return float(plane_psnr(scene, eqx.tree_at(where, frames, ((begin + end) / 2, end - begin))))


def require_velocities(scene: Scene) -> AbstractVelocities:
    """The law of a scene's velocities; an error where it is of one axis."""
    law = scene.velocities
    requirement = "have velocities in any direction, as `Scene.any_direction` makes it"
    require(law is not None, "scene", requirement, scene)
    return law  # type: ignore[return-value]


def plane_error(
    scene: Scene,
    frames: PlaneFrames,
    fan: Fan,  # concrete
    num_speeds: int = MEASURED.num_speeds,
    num_panels: int | None = None,
) -> Float[Array, ""]:
    """Squared error that is left, white = 1, on a fan of directions; see `plane_psnr`."""
    law = require_velocities(scene)
    if num_panels is None:
        subject, requirement = "plane_psnr(num_panels=...)", "be given where JAX traces frames"
        require(all_concrete((frames, law)), subject, requirement, num_panels)
        num_panels = frames.num_panels(law.fastest)
    parts = law.components(fan.direction.ravel(), num_speeds)
    rows = fan.direction.shape if parts.speeds.shape[0] > 1 else (1, 1)
    parts = Components(*(x.reshape(*rows, -1) for x in parts))
    light = Light.of(scene)
    dtype = np.dtype(jnp.asarray(frames.times).dtype)
    fan, parts, light = jax.tree.map(lambda x: jnp.asarray(x, dtype), (fan, parts, light))
    return _error(fan, parts, light, frames, num_panels)


class Light(NamedTuple):
    """Light, noise and picture of a scene."""

    rate: Float[Array, ""]
    read: Float[Array, ""]
    mean: Float[Array, ""]
    deviation: Float[Array, ""]
    blur: Float[Array, ""]

    @staticmethod
    def of(scene: Scene) -> "Light":
        """That of a scene."""
        picture = scene.picture
        numbers = scene.photon_rate, scene.read_noise, picture.mean_level, picture.deviation
        return Light(*numbers, scene.optics.lens_blur)

    def signal(self, fan: Fan) -> Float[Array, "i j"]:
        r"""$SP$ of a picture behind the pixels and the lens."""
        aperture = pixel_response(fan.radius[:, None] * jnp.cos(fan.direction), self.blur)
        down = fan.radius[:, None] * jnp.sin(fan.direction)
        aperture = aperture * pixel_response(down, self.blur)
        return self.deviation**2 * fan.power * aperture**2

    def gains(self, exposures: Float[Array | np.ndarray, "n"]) -> Float[Array, "n"]:
        r"""$e_k^2/N_k$ of frames."""
        electrons = white_electrons(self.rate, jnp.asarray(exposures))
        noise = noise_power(1.0, self.mean, electrons, self.read)
        noise = jnp.maximum(noise, DARK * jnp.maximum(electrons, 1.0) ** 2)
        return electrons * (electrons / noise)


@compiled
def _error(
    fan: Fan, parts: Components, light: Light, frames: PlaneFrames, num_panels: int
) -> Float[Array, ""]:
    times, places, weight = frames.nodes(num_panels)
    turns = 2 * jnp.pi * jnp.asarray(fan.radius)
    across = turns[:, None] * jnp.cos(fan.direction)
    down = turns[:, None] * jnp.sin(fan.direction)
    passing = turns[:, None, None] * jnp.asarray(parts.speeds)
    shape = (*fan.direction.shape, parts.speeds.shape[-1])
    # Directions with the same components of the velocities share the waves of these.
    groups = (*passing.shape[:2], shape[1] // passing.shape[1], -1)

    # A descent holds the waves of one frame at a time.
    @jax.checkpoint
    def add(gained: Array, frame: tuple[Array, ...]) -> tuple[Array, None]:
        time, x, y, share = frame
        phase = across[..., None] * x[None, None] + down[..., None] * y[None, None]
        ways = passing[..., None] * time[None, None, None]
        power = power_of_waves(phase.reshape(groups), ways, weight[None, None, None])
        return gained + share * power.reshape(shape), None

    each: Any = (times, *places, light.gains(frames.exposures))
    # $\sum_k e_k^2|H_k|^2/N_k$ at each frequency and component of the velocities.
    gained = jax.lax.scan(add, jnp.zeros(shape, times.dtype), each)[0]
    signal = light.signal(fan)[..., None]
    lost = jnp.sum(parts.weights / (1 + signal * gained), axis=-1)
    return light.deviation**2 * jnp.sum(fan.weight * lost)


def cross_motion_loss(scene: Scene, frames: PlaneFrames, *, across: float = 0.1) -> float:
    """Decibels that frames lose where things that move along one axis move across it too.

    Velocities fill an ellipse whose longer half axis is the greatest speed of the scene; the loss
    is that against an ellipse of nothing across. `frames_of` makes such frames of those of a
    `FrameSequence`.
    """
    fastest = float(scene.max_speed)
    levels = [
        plane_psnr(replace(scene, velocities=EvenVelocities(fastest, share * fastest)), frames)
        for share in (0.0, across)
    ]
    return float(levels[0] - levels[1])
