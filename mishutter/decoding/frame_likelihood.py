r"""The likelihood of a velocity of frames, along one axis or in the plane, and the way to its peak.

With $d_i = M\,\partial A/\partial v_i\,f$ and the residual $r$ that the likeliest picture leaves,
the slopes of the logarithm of likelihood are $\sum_k r_k d_{ik}/N_k$, less those of the volume of
the Gaussian about it, and the information is $\sum_k d_{ik} r^{(j)}_k/N_k$, with the residual
$r^{(j)}$ of the likeliest picture of $d_j$ itself.

Along one axis velocities have one component, and each row is a picture of its own.
"""

import math
from functools import reduce
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from mishutter.camera.responses import aperture_on, frequencies_on, waves_of
from mishutter.camera.rows import fast_length
from mishutter.decoding.decoders.base import density_of, power_at
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
    detail_of,
    fit_of,
    likeliest,
    volume_of,
)
from mishutter.decoding.rolling import (
    GLOBAL,
    SHARE,
    RowPaths,
    RowsInTurn,
    RowTimes,
)
from mishutter.evaluation.fans import picture_power_on
from mishutter.evaluation.instants import Instants
from mishutter.model.exposures import path_for_rows
from mishutter.model.frame_path import Frames, frames_in
from mishutter.model.optics import NUM_FREQUENCIES
from mishutter.model.scene import Scene, power_on_grid
from mishutter.pictures.registration.windows import means

ROUGHLY = 3e-2
"""Residual at which conjugate gradients of a search end, as a share of the first one."""
GRID = 64
"""Frequencies along each axis of the plane by which volumes are computed."""
_FINE = 256
"""Frequencies along each axis by which detail is finer than a pixel."""
_TOGETHER = 2**16
"""Pixels of all frames on canvases of velocities that are looked at together."""


class Prior(NamedTuple):
    """Power of pictures: that of a scene, times their own detail."""

    scene: Scene
    detail: Detail = Detail()

    def on(self, shape: tuple[int, ...], size: int = 1) -> Float[np.ndarray, "*k"]:
        """On the grid of a DFT of pixels of some size, of rows or of pictures."""
        *down, across = (f / size for f in frequencies_on(shape))
        if down:
            power = picture_power_on(self.scene, down[0][:, 0], across[0])
        else:
            power = power_at(across, power_on_grid(self.scene, NUM_FREQUENCIES))
        return power / size ** len(shape) * self.detail.at(reduce(np.hypot, down, across))

    def folded(self, size: int, num_axes: int) -> float:
        """Variance of binned pixels by detail that is finer than they are."""
        if size == 1:
            return 0.0
        shape = (_FINE,) * num_axes
        each = frequencies_on(shape)
        passed = reduce(np.multiply, (np.sinc(size * f) for f in each)) ** 2
        fine = reduce(np.maximum, map(np.abs, each)) > 0.5 / size
        return float(mean_over_dft(self.on(shape) * passed * fine, *shape))


def exposures_of(taken: Frames) -> Float[np.ndarray, "n"]:
    """Exposures; s."""
    return np.asarray(frames_in(taken).exposures, np.float64)


class Level(NamedTuple):
    """Frames of pixels of one size on a canvas, and their instants."""

    canvas: Canvas
    instants: Instants
    aperture: Float[np.ndarray, "*k"]
    coarse: tuple[np.ndarray, np.ndarray]  # Power and aperture on the grid of volumes
    rows: RowsInTurn | None  # Where they are exposed one after another

    def likeliest(
        self,
        velocities: Float[np.ndarray, "s axes"],
        tolerance: float = TOLERANCE,
        settled: float = math.inf,
    ) -> Likeliest:
        """The likeliest pictures at some velocities."""
        return likeliest(self.canvas, self.responses(velocities), tolerance, settled)

    def responses(
        self, velocities: Float[np.ndarray, "s axes"], *, by_time: bool = False
    ) -> Responses:
        r"""Responses at velocities, or derivatives by them but for $2\pi i\,\mathbf f$."""
        canvas, velocities, instants = self.canvas, velocities / self.canvas.size, self.instants

        def waves(
            of: Instants, velocities: Float[np.ndarray, "s axes"]
        ) -> Complex[np.ndarray, "n s *k"]:
            return waves_of(of, velocities, canvas.shape, canvas.frames.dtype) * self.aperture

        if self.rows is not None:
            return self.rows.responses(velocities, waves, by_time=by_time)
        if by_time:
            instants = instants._replace(weight=instants.weight * instants.time)
        each = waves(instants, velocities)
        return each if len(canvas.shape) > 1 else each[:, :, None]

    def volume(self, velocity: Float[np.ndarray, "axes"]) -> Volume:
        """The volume of the likelihood of a velocity, of each of its pictures."""
        return self.volumes(velocity[None])[0]

    def volumes(self, velocities: Float[np.ndarray, "s axes"]) -> list[Volume]:
        """Those of some velocities."""
        power, aperture = self.coarse
        *down, across = power.shape
        grid, dtype = (*down, 2 * (across - 1)), self.canvas.frames.dtype
        velocities, rows = velocities / self.canvas.size, []
        each = power * aperture**2 / self.canvas.noises.reshape(-1, *[1] * power.ndim)
        for one in [self.instants] if self.rows is None else self.rows.paths.some:
            waves = waves_of(one, velocities, grid, dtype)
            densities = np.moveaxis(np.real(waves) ** 2 + np.imag(waves) ** 2, 1, 0) * each
            rows.append(
                [
                    volume_of(density, one.middles(velocity)[::-1], self.canvas.sensor)
                    for density, velocity in zip(densities, velocities, strict=True)
                ]
            )
        return [
            Volume(*(np.mean(part, axis=0) for part in zip(*some, strict=True)))
            for some in zip(*rows, strict=True)
        ]

    def logarithms(
        self, velocities: Float[np.ndarray, "s axes"], tolerance: float = ROUGHLY
    ) -> Float[np.ndarray, "s *rows"]:
        """Logarithms of the likelihood of velocities, by row along one axis, over no picture's."""
        count = self.canvas.frames[..., 0].size * fast_length(self.canvas.sensor[-1])
        values, at_once = [], max(1, _TOGETHER // count)
        for some in np.split(velocities, range(at_once, len(velocities), at_once)):
            gains = self.likeliest(some, tolerance).gains
            volumes = np.array([volume.logarithm for volume in self.volumes(some)])
            values.append(gains - volumes.reshape(-1, *[1] * (gains.ndim - 1)))
        return np.concatenate(values)

    def fit(
        self,
        velocity: Float[np.ndarray, "axes"],
        mean: float = 0.0,
        tolerance: float = TOLERANCE,
    ) -> Fit:
        """How the frames fit the likeliest picture at a velocity, about a mean level."""
        return fit_of(self.likeliest(velocity[None], tolerance), self.volume(velocity), mean)


class Own(NamedTuple):
    """Frames of one colour, and what is known of them."""

    frames: Float[np.ndarray, "n rows columns"]  # Deviations from the mean level
    noises: Float[np.ndarray, "n"]  # Variance of the noise in each; white = 1
    taken: Frames
    prior: Prior
    times: RowTimes = GLOBAL
    has_levels: bool = True  # Whether the mean of each row in each frame is that of the picture

    @property
    def num_axes(self) -> int:
        """Axes of the plane, or one of an axis."""
        return frames_in(self.taken).num_axes

    def level(
        self,
        velocities: Float[np.ndarray, "s axes"],
        size: int = 1,
        part: slice = slice(None),
        *,
        share: float = SHARE,
    ) -> Level:
        """The frames or some of them, binned, on a canvas for some velocities."""
        fastest = float(np.max(np.linalg.norm(velocities, axis=1)))
        num_axes, paths = self.num_axes, None
        instants = Instants.of(self.taken, fastest, size=size)
        instants = instants if part == slice(None) else instants.part(part)
        ends = [instants]
        if self.times.is_rolling:
            path = path_for_rows(self.prior.scene, self.taken)
            paths = RowPaths(path, instants, part.start or 0, self.times, size)
            ends += [paths.at(delay) for delay in paths.delays[[0, -1]].tolist()]
        axes, dtype = tuple(range(-num_axes, 0)), self.frames.dtype
        binned = self.frames[part] if size == 1 else means(self.frames[part], size, axes, dtype)
        # Waves of the sensor's ends die away in so many of its pixels, and of the canvas.
        reach = np.max([one.reach(velocities / size) for one in ends], axis=0)
        margin = tuple(math.ceil(x) + max(32 // size, 4) for x in reach[::-1])
        sensor = binned.shape[-num_axes:]
        shape = tuple(fast_length(n + 2 * m) for n, m in zip(sensor, margin, strict=True))
        noises = self.noises[part] / size**num_axes + self.prior.folded(size, num_axes)
        power = np.maximum(self.prior.on(shape, size), LEAST_POWER).astype(binned.dtype)
        canvas = Canvas(binned, noises, power, margin, shape, self.has_levels, size)
        rows = None if paths is None else RowsInTurn(paths, canvas, velocities, share)
        # Rows are looked at at all frequencies, pictures at few.
        grid = shape if num_axes == 1 else (min(GRID, shape[0]), min(GRID, shape[1]))
        optics = self.prior.scene.optics
        coarse = self.prior.on(grid, size), aperture_on(optics, grid, size)
        aperture = aperture_on(optics, shape, size)
        # A wave of the highest frequency has no place.
        for axis, count in enumerate(shape):
            np.moveaxis(aperture, axis, 0)[count // 2] = 0.0
        return Level(canvas, instants, aperture.astype(binned.dtype), coarse, rows)

    def of_rows(self, some: Int[np.ndarray, "r"]) -> "Own":
        """The same of some of the rows."""
        return self._replace(frames=self.frames[:, some], times=self.times.of_rows(some))

    def with_own_detail(self, velocities: Float[np.ndarray, "s axes"]) -> "Own":
        """The frames with the power of pictures that are as rich in detail, for some velocities."""
        num_axes = self.num_axes
        shape = self.frames.shape[-num_axes:]
        grid = (GRID, GRID) if num_axes == 2 else (fast_length(shape[0]),)
        instants = Instants.of(self.taken, float(np.max(np.linalg.norm(velocities, axis=1))))
        each = waves_of(instants, velocities, grid) * aperture_on(self.prior.scene.optics, grid)
        expected = np.mean(density_of(each, self.noises), axis=0) * self.prior.on(grid)
        lowest = max(2 / min(shape), 1 / GRID if num_axes == 2 else 0.0)
        frames = self.frames - np.mean(self.frames, axis=(1, 2), keepdims=True)
        detail = detail_of(frames, self.noises, shape, expected, lowest)
        return self._replace(prior=self.prior._replace(detail=detail))

    def has(self, least: int, size: int) -> bool:
        """Whether they have so many pixels along their shorter side if they are binned."""
        return min(self.frames.shape[-self.num_axes :]) // size >= least

    @property
    def duration(self) -> float:
        """Time from the first mid-exposure to the last, or that of one frame; s."""
        return self.duration_of(len(self.frames))

    def duration_of(self, count: int) -> float:
        """The longest of so many neighbouring frames; s."""
        times = np.sort(np.asarray(frames_in(self.taken).times, np.float64))
        lasts = times[count - 1 :] - times[: len(times) - count + 1]
        return max(float(np.max(lasts)), float(np.max(exposures_of(self.taken))))


class Slope(NamedTuple):
    """The slope of the logarithm of the likelihood at a velocity."""

    velocity: Float[np.ndarray, "axes"]  # px/s
    found: Likeliest
    value: Float[np.ndarray, "axes"]
    changes: list[Float[np.ndarray, "n rows columns"]]  # Of the frames, by each component
    scores: Float[np.ndarray, "axes n rows columns"]  # The slope but for volumes, by pixel

    def by_place(self, level: Level) -> tuple[Float[np.ndarray, "axes t"], Float[np.ndarray, "t"]]:
        """Sums of scores over tiles of the picture, and the pixels of the frames in each.

        A place of the picture pulls in all frames at once: tiles move as it does.
        """
        shape = self.scores.shape[2:]
        side = max(min(shape) / TILES, 1.0)
        across, *down = level.instants.middles(self.velocity / level.canvas.size)
        middles = down[0] if down else 0 * across, across
        rows, columns = (
            np.floor((np.arange(count) - places[:, None]) / side).astype(int)
            for count, places in zip(shape, middles, strict=True)
        )
        rows, columns = rows - np.min(rows), columns - np.min(columns)
        places = (rows[:, :, None] * (np.max(columns) + 1) + columns[:, None]).ravel()
        pixels = np.bincount(places)
        pulls = np.stack([np.bincount(places, score.ravel()) for score in self.scores])
        return pulls[:, pixels > 0], pixels[pixels > 0].astype(np.float64)


def slope_at(
    level: Level, velocity: Float[np.ndarray, "axes"], tolerance: float = TOLERANCE
) -> Slope:
    """The slope at a velocity."""
    canvas, size = level.canvas, level.canvas.size
    found = level.likeliest(velocity[None], tolerance)
    residual = canvas.known(canvas.frames - found.seen[:, 0])
    moved, changes = level.responses(velocity[None], by_time=True), []
    for frequency in frequencies_on(canvas.shape)[::-1]:  # along the rows first
        turned = (2j * np.pi / size * frequency).astype(found.spectrum.dtype) * found.spectrum
        changes.append(canvas.through(moved, turned)[:, 0])
    side = 0.1 * _furthest(level)
    beside = side * np.stack([np.eye(velocity.size), -np.eye(velocity.size)])
    beside = level.volumes((velocity + beside).reshape(-1, velocity.size))
    after, before = np.split(np.array([volume.logarithm for volume in beside]), 2)
    volumes = found.gains.size * (after - before) / (2 * side)
    noises = canvas.noises[:, None, None]
    scores = np.stack([d * residual / noises for d in changes])
    value = np.sum(scores, axis=(1, 2, 3), dtype=np.float64) - volumes
    return Slope(velocity, found, value, changes, scores)


def _furthest(level: Level) -> float:
    """The greatest step, a binned pixel over the frames; px/s."""
    return level.canvas.size / max(float(np.ptp(level.instants.time)), 1e-300)


def _stepped(
    velocity: Float[np.ndarray, "axes"],
    curvature: Float[np.ndarray, "axes axes"],
    slope: Float[np.ndarray, "axes"],
    furthest: float,
) -> Float[np.ndarray, "axes"]:
    """The end of a step by Newton."""
    step = np.linalg.solve(curvature, slope)
    return velocity + step * min(1.0, furthest / max(float(np.linalg.norm(step)), 1e-300))


class Climb(NamedTuple):
    """A step towards the peak of the likelihood."""

    velocity: Float[np.ndarray, "axes"]  # Where it begins; px/s
    found: Likeliest
    slope: Float[np.ndarray, "axes"]  # Slope of the logarithm
    information: Float[np.ndarray, "axes axes"]
    furthest: float  # Greatest step; px/s

    @property
    def size(self) -> float:
        """Length of the step; px/s."""
        return float(np.linalg.norm(self.best - self.velocity))

    def value(self, level: Level) -> float:
        """Logarithm of the likelihood before the step."""
        gains = self.found.gains
        return float(np.sum(gains) - gains.size * level.volume(self.velocity).logarithm)

    @property
    def best(self) -> Float[np.ndarray, "axes"]:
        """The velocity at the end of the step."""
        return _stepped(self.velocity, self.information, self.slope, self.furthest)


def climbed(
    level: Level,
    velocity: Float[np.ndarray, "axes"],
    tolerance: float = TOLERANCE,
    information: Float[np.ndarray, "axes axes"] | None = None,
) -> Climb:
    """A step from a velocity towards the peak of the likelihood, by Gauss and Newton.

    The information may be that of a velocity nearby: climbs with it end at the same peak.
    """
    here, furthest, canvas = slope_at(level, velocity, tolerance), _furthest(level), level.canvas
    if information is not None:
        return Climb(velocity, here.found, here.value, information, furthest)
    # Information errs by the square of what such pictures lack.
    beside = []
    for change in here.changes:
        own = here.found.of(change, min(10 * tolerance, ROUGHLY))
        beside.append(canvas.known(change - own.seen[:, 0]))
    noises = canvas.noises[:, None, None]
    information = np.array([[np.sum(d * r / noises) for r in beside] for d in here.changes])
    # Pictures without detail tell nothing of their velocity, whose error is then 64 such steps.
    information = (information + information.T) / 2 + np.eye(len(beside)) / (64 * furthest) ** 2
    return Climb(velocity, here.found, here.value, information, furthest)


class Peak(NamedTuple):
    """The peak of the likelihood, with the curvature that it has."""

    near: Slope  # The slope a step away
    curvature: Float[np.ndarray, "axes axes"]
    covariance: Float[np.ndarray, "axes axes"]  # That of the velocity's error
    furthest: float  # Greatest step; px/s

    @property
    def best(self) -> Float[np.ndarray, "axes"]:
        """The velocity of the peak."""
        return _stepped(self.near.velocity, self.curvature, self.near.value, self.furthest)


def peak_near(level: Level, climb: Climb, tolerance: float = TOLERANCE) -> Peak:
    """The peak by a step of Newton from the end of a climb.

    The error is that of a likelihood whose model is not the pictures': slopes scatter by what
    places of the picture pull, and the peak follows by the curvature that it has. The model's own
    curvature, of a picture with as much detail everywhere, is its bound.
    """
    near, side = slope_at(level, climb.best, tolerance), 0.15 * climb.furthest
    curvature = np.stack(
        [
            (near.value - slope_at(level, climb.best + side * e, tolerance).value) / side
            for e in np.eye(near.value.size)
        ]
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
    unit: Float[np.ndarray, "axes axes"],
    matrix: Float[np.ndarray, "axes axes"],
    ends: tuple[float, float],
) -> Float[np.ndarray, "axes axes"]:
    """A matrix whose eigenvalues in units of another lie between two ends."""
    root = np.linalg.cholesky(unit)
    values, vectors = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, matrix).T))
    back = root @ vectors
    return (back * np.clip(values, *ends)) @ back.T
