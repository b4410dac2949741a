r"""The likelihood of a velocity of frames in the plane, and the way up to its peak.

With $d_i = M\,\partial A/\partial v_i\,f$ and the residual $r$ that the likeliest picture leaves,
the slopes of the logarithm of likelihood are $\sum_k r_k d_{ik}/N_k$, less those of the volume of
the Gaussian about it, and the information is $\sum_k d_{ik} r^{(j)}_k/N_k$, with the residual
$r^{(j)}$ of the likeliest picture of $d_j$ itself.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter.blur.waves import waves_in_plane
from mishutter.camera.plane_frames import aperture_on, frequencies_on, responses_in_plane
from mishutter.camera.rows import fast_length
from mishutter.decoding.decoders.linear import LEAST_POWER, mean_over_dft
from mishutter.decoding.likeliest import (
    TILES,
    TOLERANCE,
    Canvas,
    Detail,
    Fit,
    Likeliest,
    Responses,
    Volume,
    fit_of,
    frequencies_along,
    likeliest,
    volume_of,
)
from mishutter.decoding.rolling import RowsInPlane
from mishutter.evaluation.fans import picture_power_on
from mishutter.evaluation.instants import Instants
from mishutter.model.scene import Scene
from mishutter.model.sequences import PlaneFrames

ROUGHLY = 3e-2
"""Residual at which conjugate gradients of a search end, as a share of the first one."""
GRID = 64
"""Frequencies along each axis by which volumes are computed."""
_FINE = (256, 256)
"""Frequencies along each axis by which detail is finer than a pixel."""


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
    rows: RowsInPlane | None  # Where they are exposed one after another

    def likeliest(
        self, velocity: Float[np.ndarray, "2"], tolerance: float = TOLERANCE
    ) -> Likeliest:
        """The likeliest picture at a velocity."""
        return likeliest(self.canvas, self.responses(velocity, tolerance), tolerance)

    def responses(
        self, velocity: Float[np.ndarray, "2"], tolerance: float, *, by_time: bool = False
    ) -> Responses:
        r"""Responses at a velocity, or derivatives by it but for $2\pi i\,\mathbf f$."""
        canvas, velocity = self.canvas, velocity / self.canvas.size
        if self.rows is not None:
            share = 0.5 if tolerance == ROUGHLY else 0.03  # of the noise
            return self.rows.frames(velocity, canvas, self.aperture, share, by_time=by_time)
        instants = self.instants
        weight = instants.weight * instants.time if by_time else instants.weight
        waves = waves_in_plane(
            instants.displacement(velocity), weight, frequencies_on(canvas.shape)
        )
        return (waves * self.aperture).astype(np.result_type(canvas.frames, np.complex64))

    def volume(self, velocity: Float[np.ndarray, "2"]) -> Volume:
        """The volume of the likelihood of a velocity, on a coarse grid."""
        power, aperture = self.coarse
        shape = power.shape[0], 2 * (power.shape[1] - 1)
        velocity, volumes = velocity / self.canvas.size, []
        for one in [self.instants] if self.rows is None else self.rows.some:
            responses = responses_in_plane(one, velocity, shape) * aperture
            density = np.abs(responses) ** 2 * power / self.canvas.noises[:, None, None]
            volumes.append(volume_of(density, one.middles(velocity)[::-1], self.canvas.sensor))
        return Volume(*(np.mean(part, axis=0) for part in zip(*volumes, strict=True)))

    def fit(self, velocity: Float[np.ndarray, "2"], found: Likeliest, mean: float) -> Fit:
        """How the frames fit the likeliest picture at a velocity, about a mean level."""
        return fit_of(found, self.volume(velocity), mean)


class Own(NamedTuple):
    """Frames of one colour, and what is known of them."""

    frames: Float[np.ndarray, "n rows columns"]  # Deviations from the mean level
    noises: Float[np.ndarray, "n"]  # Variance of the noise in each; white = 1
    taken: PlaneFrames
    prior: Prior
    delays: Float[np.ndarray, "rows"] | None = None  # Of rows that are exposed in turn; s

    @staticmethod
    def of(
        frames: Float[np.ndarray, "n rows columns"],
        noises: Float[np.ndarray, "n"],
        taken: PlaneFrames,
        scene: Scene,
    ) -> "Own":
        """Those of the sensor of a scene."""
        sensor, delays = scene.sensor, None
        if sensor.is_rolling:
            taken = taken.for_rows(sensor.readout_time, scene.limits)
            delays = sensor.row_delays(frames.shape[1])
        return Own(frames, noises, taken, Prior(scene), delays)

    def level(
        self, velocities: Float[np.ndarray, "s 2"], size: int = 1, part: slice | None = None
    ) -> Level:
        """The frames or some of them, binned, on a canvas for some velocities."""
        fastest = float(np.max(np.hypot(*velocities.T)))
        instants = Instants.of(self.taken, fastest, size=size)
        instants = instants if part is None else instants.part(part)
        part, rows = slice(None) if part is None else part, None
        if self.delays is not None:
            first = part.start or 0
            rows = RowsInPlane.of(self.taken, instants, first, self.delays, size)
        binned = self.frames[part]
        if size > 1:
            down, across = (count // size for count in binned.shape[1:])
            squares = binned[:, : down * size, : across * size]
            binned = squares.reshape(-1, down, size, across, size).mean(axis=(2, 4))
        # Waves of the sensor's ends die away in so many of its pixels, and of the canvas.
        beyond = max(32 // size, 4)
        ends = [instants] if rows is None else [rows.at(d) for d in rows.delays[[0, -1]].tolist()]
        reach = np.max([one.reach(velocities / size) for one in [instants, *ends]], axis=0)
        across, down = (math.ceil(x) + beyond for x in reach)
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
            rows,
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


def logarithm(level: Level, velocity: np.ndarray, tolerance: float = ROUGHLY) -> float:
    """Logarithm of the likelihood of a velocity, over that of no picture."""
    gain = float(level.likeliest(velocity, tolerance).gains)
    return gain - float(level.volume(velocity).logarithm)


class Slope(NamedTuple):
    """The slope of the logarithm of the likelihood at a velocity."""

    velocity: Float[np.ndarray, "2"]  # px/s
    found: Likeliest
    value: Float[np.ndarray, "2"]
    changes: list[Float[np.ndarray, "n rows columns"]]  # Of the frames, by each component
    scores: Float[np.ndarray, "2 n rows columns"]  # The slope but for volumes, by pixel

    def by_place(self, level: Level) -> tuple[Float[np.ndarray, "2 t"], Float[np.ndarray, "t"]]:
        """Sums of scores over tiles of the picture, and the pixels of the frames in each.

        A place of the picture pulls in all frames at once: tiles move as it does.
        """
        shape = level.canvas.sensor
        side = max(min(shape) / TILES, 1.0)
        middles = level.instants.middles(self.velocity / level.canvas.size)
        rows, columns = (
            np.floor((np.arange(count) - places[:, None]) / side).astype(int)
            for count, places in zip(shape, middles[::-1], strict=True)
        )
        rows, columns = rows - np.min(rows), columns - np.min(columns)
        places = (rows[:, :, None] * (np.max(columns) + 1) + columns[:, None]).ravel()
        pixels = np.bincount(places)
        pulls = np.stack([np.bincount(places, score.ravel()) for score in self.scores])
        return pulls[:, pixels > 0], pixels[pixels > 0].astype(np.float64)


def slope_at(level: Level, velocity: Float[np.ndarray, "2"], tolerance: float = TOLERANCE) -> Slope:
    """The slope at a velocity."""
    canvas, size = level.canvas, level.canvas.size
    found = level.likeliest(velocity, tolerance)
    residual = canvas.frames - found.seen
    moved, changes = level.responses(velocity, tolerance, by_time=True), []
    for frequency in frequencies_along(canvas.shape):
        turned = (2j * np.pi / size * frequency).astype(found.spectrum.dtype) * found.spectrum
        changes.append(np.stack([canvas.through(one, turned) for one in moved]))
    side = 0.1 * _furthest(level)
    volumes = np.array(
        [
            level.volume(velocity + side * e).logarithm
            - level.volume(velocity - side * e).logarithm
            for e in np.eye(2)
        ]
    ) / (2 * side)
    noises = canvas.noises[:, None, None]
    scores = np.stack([d * residual / noises for d in changes])
    value = np.sum(scores, axis=(1, 2, 3), dtype=np.float64) - volumes
    return Slope(velocity, found, value, changes, scores)


def _furthest(level: Level) -> float:
    """The greatest step, a binned pixel over the frames; px/s."""
    return level.canvas.size / max(float(np.ptp(level.instants.time)), 1e-300)


def _stepped(
    velocity: Float[np.ndarray, "2"],
    curvature: Float[np.ndarray, "2 2"],
    slope: Float[np.ndarray, "2"],
    furthest: float,
) -> Float[np.ndarray, "2"]:
    """The end of a step by Newton."""
    step = np.linalg.solve(curvature, slope)
    return velocity + step * min(1.0, furthest / max(float(np.hypot(*step)), 1e-300))


class Climb(NamedTuple):
    """A step towards the peak of the likelihood."""

    velocity: Float[np.ndarray, "2"]  # Where it begins; px/s
    found: Likeliest
    slope: Float[np.ndarray, "2"]  # Slope of the logarithm
    information: Float[np.ndarray, "2 2"]
    furthest: float  # Greatest step; px/s

    @property
    def best(self) -> Float[np.ndarray, "2"]:
        """The velocity at the end of the step."""
        return _stepped(self.velocity, self.information, self.slope, self.furthest)


def climbed(level: Level, velocity: Float[np.ndarray, "2"], tolerance: float = TOLERANCE) -> Climb:
    """A step from a velocity towards the peak of the likelihood, by Gauss and Newton."""
    here, furthest, canvas = slope_at(level, velocity, tolerance), _furthest(level), level.canvas
    beside = []
    for change in here.changes:
        own = likeliest(canvas._replace(frames=change), here.found.responses, tolerance)
        beside.append(change - own.seen)
    noises = canvas.noises[:, None, None]
    information = np.array([[np.sum(d * r / noises) for r in beside] for d in here.changes])
    # Pictures without detail tell nothing of their velocity, whose error is then 64 such steps.
    information = (information + information.T) / 2 + np.eye(2) / (64 * furthest) ** 2
    return Climb(velocity, here.found, here.value, information, furthest)


class Peak(NamedTuple):
    """The peak of the likelihood, with the curvature that it has."""

    near: Slope  # The slope a step away
    curvature: Float[np.ndarray, "2 2"]
    covariance: Float[np.ndarray, "2 2"]  # That of the velocity's error
    furthest: float  # Greatest step; px/s

    @property
    def best(self) -> Float[np.ndarray, "2"]:
        """The velocity of the peak."""
        return _stepped(self.near.velocity, self.curvature, self.near.value, self.furthest)


def peak_near(level: Level, climb: Climb) -> Peak:
    """The peak by a step of Newton from the end of a climb.

    The error is that of a likelihood whose model is not the pictures': slopes scatter by what
    places of the picture pull, and the peak follows by the curvature that it has. The model's own
    curvature, of a picture with as much detail everywhere, is its bound.
    """
    near, side = slope_at(level, climb.best), 0.15 * climb.furthest
    curvature = np.stack(
        [(near.value - slope_at(level, climb.best + side * e).value) / side for e in np.eye(2)]
    )
    curvature = _bounded(climb.information, (curvature + curvature.T) / 2, (0.01, 1.0))
    pulls, pixels = near.by_place(level)
    total = np.sum(pulls, axis=1, keepdims=True)
    own = pulls - total * pixels / np.sum(pixels)
    # Volumes, whose slope the frames' balances, are of that model too: photographs may have none.
    scatter = own @ own.T * pixels.size / max(pixels.size - 1, 1) + total @ total.T
    scatter = _bounded(climb.information, scatter, (1.0, math.inf))
    inverse = np.linalg.inv(curvature)
    return Peak(near, curvature, inverse @ scatter @ inverse, climb.furthest)


def _bounded(
    unit: Float[np.ndarray, "2 2"], matrix: Float[np.ndarray, "2 2"], ends: tuple[float, float]
) -> Float[np.ndarray, "2 2"]:
    """A matrix whose eigenvalues in units of another lie between two ends."""
    root = np.linalg.cholesky(unit)
    values, vectors = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, matrix).T))
    back = root @ vectors
    return (back * np.clip(values, *ends)) @ back.T
