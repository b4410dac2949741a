r"""The likelihood of a velocity of frames in the plane, and the way up to its peak.

With $d_i = M\,\partial A/\partial v_i\,f$ and the residual $r$ that the likeliest picture leaves,
the slopes of the logarithm of likelihood are $\sum_k r_k d_{ik}/N_k$, less those of the volume of
the Gaussian about it, and the information is $\sum_k d_{ik} r^{(j)}_k/N_k$, with the residual
$r^{(j)}$ of the likeliest picture of $d_j$ itself.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter.blur.waves import waves_in_plane
from mishutter.camera.plane_frames import (
    Instants,
    aperture_on,
    frequencies_on,
    instants_of,
    reach_in_plane,
    responses_in_plane,
)
from mishutter.camera.rows import fast_length
from mishutter.decoding.decoders.linear import LEAST_POWER, mean_over_dft
from mishutter.decoding.likeliest import (
    TOLERANCE,
    Canvas,
    Detail,
    Fit,
    Likeliest,
    Volume,
    fit_of,
    frequencies_along,
    likeliest,
    volume_of,
)
from mishutter.model.scene import Scene
from mishutter.plane.frames import PlaneFrames
from mishutter.plane.levels import picture_power_on

ROUGHLY = 3e-2
"""Residual at which conjugate gradients of a search end, as a share of the first one."""
_MARGIN, _LEAST_MARGIN = 32, 4
"""Pixels of the sensor, and of the canvas, beyond the furthest displacement, in which the waves of
the sensor's ends die away."""
GRID = 64
"""Frequencies along each axis by which volumes are computed."""
_FINE = (256, 256)
"""Frequencies along each axis by which detail is finer than a pixel."""
_SIDE, _FURTHEST = 0.1, 1.0
"""Displacements over the frames for slopes of volumes, and the furthest of one step; binned px."""
_UNKNOWN = 64.0
"""Standard error of a velocity of which frames tell nothing, as a displacement over these."""


class Prior(NamedTuple):
    """Power of pictures: that of a scene, times their own detail."""

    scene: Scene
    detail: Detail = Detail()

    def on(self, shape: tuple[int, int], size: int = 1) -> Float[np.ndarray, "m k"]:
        """On the grid of a DFT of pixels of some size."""
        down, across = (f / size for f in frequencies_on(shape))
        power = picture_power_on(self.scene, down, across) / size**2
        return power * self.detail.at(np.hypot(down[:, None], across))

    def folded(self, size: int) -> float:
        """Variance of binned pixels by detail that is finer than they are."""
        if size == 1:
            return 0.0
        down, across = frequencies_on(_FINE)
        passed = (np.sinc(size * down)[:, None] * np.sinc(size * across)) ** 2
        fine = np.maximum(np.abs(down)[:, None], across) > 0.5 / size
        return float(mean_over_dft(self.on(_FINE) * passed * fine, *_FINE))


class Level(NamedTuple):
    """Frames of pixels of one size on a canvas, and their instants."""

    canvas: Canvas
    instants: Instants
    aperture: Float[np.ndarray, "m k"]
    coarse: tuple[np.ndarray, np.ndarray]  # Power and aperture on the grid of volumes

    def likeliest(
        self, velocity: Float[np.ndarray, "2"], tolerance: float = TOLERANCE
    ) -> Likeliest:
        """The likeliest picture at a velocity."""
        frames, shape = self.canvas.frames, self.canvas.shape
        each = responses_in_plane(self.instants, velocity / self.canvas.size, shape)
        responses = (each * self.aperture).astype(np.result_type(frames, np.complex64))
        return likeliest(self.canvas, responses, tolerance)

    def volume(self, velocity: Float[np.ndarray, "2"]) -> Volume:
        """The volume of the likelihood of a velocity, on a coarse grid."""
        power, aperture = self.coarse
        shape = power.shape[0], 2 * (power.shape[1] - 1)
        velocity = velocity / self.canvas.size
        responses = responses_in_plane(self.instants, velocity, shape) * aperture
        density = np.abs(responses) ** 2 * power / self.canvas.noises[:, None, None]
        return volume_of(density, self.instants.middles(velocity)[::-1], self.canvas.sensor)

    def fit(self, velocity: Float[np.ndarray, "2"], found: Likeliest, mean: float) -> Fit:
        """How the frames fit the likeliest picture at a velocity, about a mean level."""
        return fit_of(found, self.volume(velocity), mean)


class Own(NamedTuple):
    """Frames of one colour, and what is known of them."""

    frames: Float[np.ndarray, "n rows columns"]  # Deviations from the mean level
    noises: Float[np.ndarray, "n"]  # Variance of the noise in each; white = 1
    taken: PlaneFrames
    prior: Prior

    def level(
        self, velocities: Float[np.ndarray, "s 2"], size: int = 1, part: slice | None = None
    ) -> Level:
        """The frames or some of them, binned, on a canvas for some velocities."""
        fastest = float(np.max(np.hypot(*velocities.T)))
        instants = instants_of(self.taken, fastest, size)
        instants = instants if part is None else instants.part(part)
        part = slice(None) if part is None else part
        binned = _binned(self.frames[part], size)
        beyond = max(_MARGIN // size, _LEAST_MARGIN)
        down, across = (reach + beyond for reach in reach_in_plane(instants, velocities / size))
        shape = fast_length(binned.shape[1] + 2 * down), fast_length(binned.shape[2] + 2 * across)
        grid = min(GRID, shape[0]), min(GRID, shape[1])
        optics = self.prior.scene.optics
        noises = self.noises[part] / size**2 + self.prior.folded(size)
        power = np.maximum(self.prior.on(shape, size), LEAST_POWER)
        aperture = aperture_on(optics, shape, size)
        # A wave of the highest frequency has no place.
        aperture[shape[0] // 2] = aperture[:, -1] = 0.0
        dtype = binned.dtype
        return Level(
            Canvas(binned, noises, power.astype(dtype), (down, across), shape, size=size),
            instants,
            aperture.astype(dtype),
            (self.prior.on(grid, size), aperture_on(optics, grid, size)),
        )

    def has(self, least: int, size: int) -> bool:
        """Whether they have so many pixels along their shorter side if they are binned."""
        return min(self.frames.shape[1:]) // size >= least

    @property
    def duration(self) -> float:
        """Time from the first mid-exposure to the last, or that of one frame; s."""
        return self.duration_of(len(self.frames))

    def duration_of(self, count: int) -> float:
        """The longest of so many neighbouring frames; s."""
        times = np.asarray(self.taken.times, np.float64)
        lasts = times[count - 1 :] - times[: len(times) - count + 1]
        return max(float(np.max(lasts)), float(np.max(self.taken.exposures)))


def _binned(frames: Float[np.ndarray, "n rows columns"], size: int) -> np.ndarray:
    if size == 1:
        return frames
    rows, columns = (count // size for count in frames.shape[1:])
    whole = frames[:, : rows * size, : columns * size]
    return whole.reshape(-1, rows, size, columns, size).mean(axis=(2, 4))


def logarithm(level: Level, velocity: np.ndarray, tolerance: float = ROUGHLY) -> float:
    """Logarithm of the likelihood of a velocity, over that of no picture."""
    gain = float(level.likeliest(velocity, tolerance).gains)
    return gain - level.volume(velocity).logarithm


class Climb(NamedTuple):
    """A step towards the peak of the likelihood."""

    velocity: Float[np.ndarray, "2"]  # Where it begins; px/s
    found: Likeliest
    slope: Float[np.ndarray, "2"]  # Slope of the logarithm
    information: Float[np.ndarray, "2 2"]
    scores: Float[np.ndarray, "2 rows columns"]  # The slope, by pixel of the frames
    furthest: float  # Greatest step; px/s

    @property
    def best(self) -> Float[np.ndarray, "2"]:
        """The velocity at the end of the step."""
        step = np.linalg.solve(self.information, self.slope)
        return self.velocity + step * min(1.0, self.furthest / float(np.hypot(*step)))


def climbed(level: Level, velocity: np.ndarray, tolerance: float = TOLERANCE) -> Climb:
    """A step from a velocity towards the peak of the likelihood, by Gauss and Newton."""
    canvas, instants, size = level.canvas, level.instants, level.canvas.size
    found = level.likeliest(velocity, tolerance)
    residual = canvas.frames - found.seen
    displaced = instants.displacement(velocity / size)
    weight = instants.weight * instants.time
    moved = waves_in_plane(displaced, weight, frequencies_on(canvas.shape)) * level.aperture
    moved = moved.astype(found.responses.dtype)
    changes, beside = [], []
    for frequency in frequencies_along(canvas.shape):
        turned = (2j * np.pi / size * frequency).astype(moved.dtype) * found.spectrum
        change = np.stack([canvas.seen(turned * one) for one in moved])
        own = likeliest(canvas._replace(frames=change), found.responses, tolerance)
        changes.append(change)
        beside.append(change - own.seen)
    noises = canvas.noises[:, None, None]
    information = np.array([[np.sum(d * r / noises) for r in beside] for d in changes])
    side = _SIDE * size / max(float(np.ptp(instants.time)), 1e-300)
    volumes = np.array(
        [
            level.volume(velocity + side * e).logarithm
            - level.volume(velocity - side * e).logarithm
            for e in np.eye(2)
        ]
    ) / (2 * side)
    scores = np.stack([np.sum(d * residual / noises, axis=0) for d in changes])
    slope = np.sum(scores, axis=(1, 2), dtype=np.float64) - volumes
    furthest = _FURTHEST / _SIDE * side
    # Pictures without detail tell nothing of their velocity.
    information = (information + information.T) / 2 + np.eye(2) / (_UNKNOWN * furthest) ** 2
    return Climb(velocity, found, slope, information, scores, furthest)
