r"""Frequencies of pictures in the plane, as a fan of lines, and the power of pictures there.

At a frequency of direction $\hat{\mathbf f}$ the path of a sensor counts through
$\mathbf x\cdot\hat{\mathbf f}$ and the velocity of things through $\mathbf v\cdot\hat{\mathbf f}$:
each direction is a scene of one axis, and one axis is a fan of one line.

The isotropic picture of the power $(f^2 + 0.01^2)^{-3/2}$ has rows of the power
$2/(f^2 + 0.01^2)$, which stand for a picture on one axis.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float

from mishutter.model.optics import NYQUIST_FREQUENCY, frequencies
from mishutter.model.scene import Scene, power_of_contrast, require_velocities
from mishutter.model.texture import CORNER_FREQUENCY
from mishutter.pictures.images import Picture


class Grid(NamedTuple):
    """Sizes of a fan: radii, directions of each and components of the velocities along these."""

    num_radii: int  # Radii up to the highest frequency of an axis
    num_angles: int  # Directions, an even number; the more of a list of few velocities
    num_speeds: int  # Components of a law that is no list
    num_corner: int = 8  # Further radii, in the corners of the square of frequencies


SEARCHED, MEASURED = Grid(48, 4, 16, 4), Grid(384, 4, 32)
"""Grids of searches, whose optimum exploits what a coarser one leaves out, and of levels."""
_TURN, _FIRST = 4 ** (1 / 3) % 1, 2 ** (1 / 3) % 1
"""Shares of a step by which directions follow those of the last radius, and components those along
the last direction: with 1 they are a lattice that has points in no plane of few."""


class Fan(NamedTuple):
    """Frequencies along lines through 0, each of which is a scene of one axis.

    The response of an exposure turns too often over frequencies and velocities, and has too narrow
    zeros, for a mean over each in turn. Radii, directions and components are a lattice in place of
    a product: what lies between those of one radius is at those of others, so that errors even
    out for ways of any length.
    """

    radius: Float[Array | np.ndarray, "i"]  # cycles/px, shape `(i,)`
    direction: Float[Array | np.ndarray, "i j"]  # Angles from the rows at each radius; rad
    power: Float[Array | np.ndarray, "i j"]  # Power of a picture of the deviation 1; shape `(i, j)`
    weight: Float[Array | np.ndarray, "i j"]  # Share of the frequencies times `power`; sums to 1

    @staticmethod
    def of(scene: Scene, grid: Grid = MEASURED) -> "Fan":
        """Those of half of the plane, which stand for both halves, and a picture's power there.

        The power is that of the scene's photograph, or the isotropic one where it brings none.

        Args:
            scene: The scene, of velocities in the plane.
            grid: Sizes of the fan.
        """
        cutoff = min(float(scene.optics.cutoff_frequency), NYQUIST_FREQUENCY)
        num_speeds = require_velocities(scene).components(np.zeros(1), grid.num_speeds)[0].shape[-1]
        more = max(grid.num_speeds // num_speeds, 1)
        grid = grid._replace(num_angles=grid.num_angles * more)
        radius, angle, area = _polar(grid, cutoff)
        shape = _power_of_scene(scene)(radius[:, None], angle)
        total = np.sum(area * shape)
        return Fan(radius, angle, shape / total, area * shape / total)

    @staticmethod
    def of_axis(scene: Scene, count: int) -> "Fan":
        """The one line of a scene of one axis, in so many equal steps."""
        power = power_of_contrast(scene, count)[:, None]
        return Fan(frequencies(count), np.zeros((count, 1)), power, power / count)

    @property
    def first(self) -> Float[np.ndarray, "i j"]:
        """Place of the first component of velocities along each direction, as a share of a step."""
        return (np.arange(self.direction.size) * _FIRST + 0.5).reshape(self.direction.shape) % 1

    @property
    def share(self) -> Float[np.ndarray, "i j"]:
        """Share of all frequencies that each stands for, where a concrete picture has any power."""
        power, weight = np.asarray(self.power), np.asarray(self.weight)
        return np.divide(weight, power, where=power > 0, out=np.zeros_like(power))


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


def _power_of_scene(scene: Scene) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Power of a scene's pictures by radius and angle, on a scale of its own."""
    if scene.picture.path is None:
        return lambda radius, angle: ((radius + 0 * angle) ** 2 + CORNER_FREQUENCY**2) ** -1.5
    return power_of(scene.picture.photograph())


@lru_cache
def _polar(grid: Grid, cutoff: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Radii, angles and areas of half of the disc up to a cutoff, or of half of the square."""
    s = (np.arange(grid.num_radii) + 0.5) / grid.num_radii
    # Low frequencies, at which a picture has most of its power, are dense.
    radius, step = cutoff * s**2, 2 * cutoff * s / grid.num_radii
    count = grid.num_angles
    angle = (np.arange(count) + _turns(grid.num_radii)) * np.pi / count
    area = (2 * np.pi / count * radius * step)[:, None] * np.ones(count)
    if cutoff < NYQUIST_FREQUENCY:
        return radius, angle, area
    x, weight = np.polynomial.legendre.leggauss(grid.num_corner)
    width, count = np.sqrt(0.5) - 0.5, count // 2
    corner, step = 0.5 + width * (x + 1) / 2, width / 2 * weight
    first = np.arccos(0.5 / corner)[:, None]
    arc = first + (np.pi / 2 - 2 * first) * (np.arange(count) + _turns(grid.num_corner)) / count
    share = 2 * (corner * step)[:, None] * (np.pi / 2 - 2 * first) / count * np.ones(count)
    return (
        np.r_[radius, corner],
        np.vstack([angle, np.hstack([arc, arc + np.pi / 2])]),
        np.vstack([area, np.hstack([share, share])]),
    )


def _turns(count: int) -> Float[np.ndarray, "{count} 1"]:
    """Places of the first direction at each radius, as shares of a step."""
    return (np.arange(count) * _TURN + 0.5)[:, None] % 1


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
