r"""The likeliest picture of frames in the plane at a velocity, and the likelihood of that.

The picture is the minimum of `decoding/sequences.py` in two dimensions,

$$\sum_k |g_k - M A_k f|^2 / N_k + \sum |\hat f|^2/S ,$$

where the sensor $M$ has four borders, and $A_k$ displaces along both axes. With
$d_i = M\,\partial A/\partial v_i\,f$ and the residual $r$ that it leaves, the slopes of the
logarithm of likelihood are $\sum_k r_k d_{ik}/N_k$, less those of the volume of the Gaussian about
it, and the information is $\sum_k d_{ik} r^{(j)}_k/N_k$, with the residual $r^{(j)}$ of the
likeliest picture of $d_j$ itself.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float

from mishutter._core.checks import require
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
from mishutter.decoding.decoders.linear import LEAST_POWER
from mishutter.decoding.frame_doubts import DARK, FLICKER, LARGEST_SHIFT
from mishutter.model.scene import Scene
from mishutter.model.sensor import noise_power, white_electrons
from mishutter.plane.frames import PlaneFrames
from mishutter.plane.levels import picture_power_on

rfft2: Callable[..., np.ndarray] = scipy.fft.rfft2  # type: ignore[assignment]
irfft2: Callable[..., np.ndarray] = scipy.fft.irfft2  # type: ignore[assignment]
ROUGHLY, _TOLERANCE, _MOST_STEPS = 3e-2, 1e-3, 200
"""Residuals at which conjugate gradients of a search and others end, as shares of the first one,
and most steps."""
_MARGIN, _LEAST_MARGIN = 32, 4
"""Pixels of the sensor, and of the canvas, beyond the furthest displacement, in which the waves of
the sensor's ends die away."""
GRID = 64
"""Frequencies along each axis by which volumes are computed."""
_FINE = (256, 256)
"""Frequencies along each axis by which detail is finer than a pixel."""
_SIDE, _FURTHEST = 0.1, 1.0
"""Displacements over the frames for slopes of volumes, and the furthest of one step; binned px."""
_BESIDE, _FLATTEST = 0.15, 0.01
"""Part of the furthest step over which a curvature changes a slope, and the least curvature, over
that of the model."""
_UNKNOWN = 64.0
"""Standard error of a velocity of which frames tell nothing, as a displacement over these."""
_TILES = 8
"""Parts along each axis whose likelihoods are compared."""


class Prior(NamedTuple):
    """Power of pictures: that of a scene, times a scale by radius."""

    scene: Scene
    radius: Float[np.ndarray, "b"] = np.array([0.1])  # cycles/px
    scale: Float[np.ndarray, "b"] = np.ones(1)

    def on(self, shape: tuple[int, int], size: int = 1) -> Float[np.ndarray, "m k"]:
        """On the grid of a DFT of pixels of some size."""
        down, across = (f / size for f in frequencies_on(shape))
        power = picture_power_on(self.scene, down, across) / size**2
        radius = np.log(np.maximum(np.hypot(down[:, None], across), 1e-6))
        scale = np.exp(np.interp(radius, np.log(self.radius), np.log(self.scale)))
        return power * scale

    def folded(self, size: int) -> float:
        """Variance of binned pixels by detail that is finer than they are."""
        if size == 1:
            return 0.0
        down, across = frequencies_on(_FINE)
        passed = (np.sinc(size * down)[:, None] * np.sinc(size * across)) ** 2
        fine = np.maximum(np.abs(down)[:, None], across) > 0.5 / size
        return float(mean_over_plane(self.on(_FINE) * passed * fine, _FINE))


class Level(NamedTuple):
    """Frames of pixels of one size on a canvas, and what is known of them."""

    frames: Float[np.ndarray, "n rows columns"]  # Deviations from the mean level
    noises: Float[np.ndarray, "n"]  # Variance of the noise in each
    instants: Instants
    size: int  # Pixels of the sensor along a side of these
    margin: tuple[int, int]  # Pixels of the canvas before the sensor
    shape: tuple[int, int]  # Pixels of the canvas
    power: Float[np.ndarray, "m k"]
    aperture: Float[np.ndarray, "m k"]
    coarse: tuple[np.ndarray, np.ndarray]  # Power and aperture on the grid of volumes

    @property
    def window(self) -> tuple[slice, slice]:
        rows, columns = (
            slice(m, m + count) for m, count in zip(self.margin, self.frames.shape[1:], strict=True)
        )
        return rows, columns

    def responses(self, velocity: np.ndarray) -> Complex[np.ndarray, "n m k"]:
        each = responses_in_plane(self.instants, velocity / self.size, self.shape)
        return (each * self.aperture).astype(np.result_type(self.frames, np.complex64))


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
            binned,
            noises,
            instants,
            size,
            (down, across),
            shape,
            power.astype(dtype),
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


class Likeliest(NamedTuple):
    """The likeliest picture at a velocity."""

    velocity: Float[np.ndarray, "2"]
    spectrum: Complex[np.ndarray, "m k"]
    responses: Complex[np.ndarray, "n m k"]
    gain: float  # How much better than no picture it explains the frames
    seen: Float[np.ndarray, "n rows columns"]  # What it gives of the frames


def likeliest(
    level: Level,
    velocity: Float[np.ndarray, "2"],
    tolerance: float = _TOLERANCE,
    *,
    frames: Float[np.ndarray, "n rows columns"] | None = None,
    responses: Complex[np.ndarray, "n m k"] | None = None,
) -> Likeliest:
    """The likeliest picture, by conjugate gradients."""
    frames = level.frames if frames is None else frames
    responses = level.responses(velocity) if responses is None else responses
    noises = level.noises.astype(frames.dtype)
    density = sum(np.abs(one) ** 2 / noise for one, noise in zip(responses, noises, strict=True))
    # The sensor sees a share of the canvas; elsewhere the prior alone holds the picture.
    share = frames[0].size / math.prod(level.shape)
    inverse = 1 / (frames.dtype.type(share) * density + 1 / level.power)
    whole = np.zeros(level.shape, frames.dtype)

    def gathered(every: Iterator[np.ndarray]) -> np.ndarray:
        """Spectrum of the picture that frames on the sensor would be made of."""
        total = np.zeros_like(responses[0])
        for response, noise, one in zip(responses, noises, every, strict=True):
            whole[level.window] = one
            total += response.conj() * (rfft2(whole) / noise)
        return total

    def recorded(spectrum: np.ndarray) -> Iterator[np.ndarray]:
        """Frames of a picture."""
        for response in responses:
            yield irfft2(spectrum * response, level.shape)[level.window]

    target = gathered(iter(frames))
    picture = np.zeros_like(target)
    residual, step = target, target * inverse
    size = _product(residual, step, level.shape)
    least = tolerance**2 * size
    for _ in range(_MOST_STEPS):
        if not size > least:
            break
        image = gathered(recorded(step)) + step / level.power
        stride = size / max(_product(step, image, level.shape), 1e-300)
        picture = picture + frames.dtype.type(stride) * step
        residual = residual - frames.dtype.type(stride) * image
        turned = residual * inverse
        following = _product(residual, turned, level.shape)
        step = turned + frames.dtype.type(following / size) * step
        size = following
    gain = _product(target, picture, level.shape) / 2
    seen = np.stack([*recorded(picture)])
    return Likeliest(velocity, picture, responses, gain, seen)


def _product(first: np.ndarray, second: np.ndarray, shape: tuple[int, int]) -> float:
    """Inner product of pictures, from half of their spectra."""
    return float(mean_over_plane(np.real(first.conj() * second), shape))


def mean_over_plane(spectrum: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Mean over all frequencies of a DFT of even length by half of them, on the last axes."""
    rows = np.asarray(np.sum(spectrum, axis=-2, dtype=np.float64))
    total = rows[..., 0] + rows[..., -1] + 2 * np.sum(rows[..., 1:-1], axis=-1)
    return np.asarray(total / math.prod(shape))


class Volume(NamedTuple):
    """Half the logarithm of the determinant of the frames' covariance, over that of their noise.

    And how many numbers of each frame the likeliest picture leaves to the noise.
    """

    logarithm: float
    freedoms: Float[np.ndarray, "n"]


def volume(level: Level, velocity: Float[np.ndarray, "2"]) -> Volume:
    """That of pictures without ends, in each part of the plane for the frames that see it."""
    power, aperture = level.coarse
    shape = power.shape[0], 2 * (power.shape[1] - 1)
    responses = responses_in_plane(level.instants, velocity / level.size, shape) * aperture
    density = np.abs(responses) ** 2 * power / level.noises[:, None, None]
    counted = np.full(power.shape[1], 2.0)
    counted[[0, -1]] = 1.0
    weight = np.broadcast_to(counted / math.prod(shape), power.shape).ravel()
    density = density.reshape(len(density), -1)
    sees, area = _parts(level.instants.middles(velocity / level.size)[::-1], level.frames.shape[1:])
    each = sees @ density
    logarithm = float(area @ (np.log1p(each) @ weight)) / 2
    held = (weight / (1 + each)) @ density.T
    return Volume(logarithm, np.sum(area[:, None] * sees * (1 - held), axis=0))


def _parts(
    middles: Float[np.ndarray, "2 n"], size: tuple[int, ...]
) -> tuple[Float[np.ndarray, "p n"], Float[np.ndarray, "p"]]:
    """Which frames see each part of the plane that some see, and its area; px^2.

    Places are down the columns and along the rows.
    """
    along = []
    for places, count in zip(middles, size, strict=True):
        ends = np.unique(np.concatenate([places, places + count]))
        inner = (ends[1:] + ends[:-1]) / 2
        sees = (places <= inner[:, None]) & (inner[:, None] <= places + count)
        along.append((sees, np.diff(ends)))
    (rows, heights), (columns, widths) = along
    sees = (rows[:, None] & columns).reshape(-1, middles.shape[1])
    area = np.outer(heights, widths).ravel()
    kinds, place = np.unique(sees, axis=0, return_inverse=True)
    total = np.bincount(place.ravel(), area)
    some = np.any(kinds, axis=1)
    return kinds[some].astype(np.float64), total[some]


def logarithm(level: Level, velocity: np.ndarray, tolerance: float = ROUGHLY) -> float:
    """Logarithm of the likelihood of a velocity, over that of no picture."""
    return likeliest(level, velocity, tolerance).gain - volume(level, velocity).logarithm


class Slope(NamedTuple):
    """The slope of the logarithm of the likelihood at a velocity."""

    found: Likeliest
    value: Float[np.ndarray, "2"]
    changes: list[Float[np.ndarray, "n rows columns"]]  # Of the frames, by each component
    scores: Float[np.ndarray, "2 n rows columns"]  # The slope but for volumes, by pixel


def slope_at(
    level: Level, velocity: Float[np.ndarray, "2"], tolerance: float = _TOLERANCE
) -> Slope:
    """The slope at a velocity."""
    found = likeliest(level, velocity, tolerance)
    residual = level.frames - found.seen
    displaced = level.instants.displacement(velocity / level.size)
    weight = level.instants.weight * level.instants.time
    moved = waves_in_plane(displaced, weight, frequencies_on(level.shape)) * level.aperture
    moved = moved.astype(found.responses.dtype)
    down, across = frequencies_on(level.shape)
    changes = []
    for turn in (across[None] + 0 * down[:, None], down[:, None] + 0 * across):
        turned = (2j * np.pi / level.size * turn).astype(moved.dtype) * found.spectrum
        changes.append(np.stack([irfft2(turned * one, level.shape)[level.window] for one in moved]))
    side = _SIDE * _furthest(level)
    volumes = np.array(
        [
            volume(level, velocity + side * e).logarithm
            - volume(level, velocity - side * e).logarithm
            for e in np.eye(2)
        ]
    ) / (2 * side)
    noises = level.noises[:, None, None]
    scores = np.stack([d * residual / noises for d in changes])
    value = np.sum(scores, axis=(1, 2, 3), dtype=np.float64) - volumes
    return Slope(found, value, changes, scores)


def _furthest(level: Level) -> float:
    """The greatest step; px/s."""
    return _FURTHEST * level.size / max(float(np.ptp(level.instants.time)), 1e-300)


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

    found: Likeliest
    slope: Float[np.ndarray, "2"]  # Slope of the logarithm
    information: Float[np.ndarray, "2 2"]
    furthest: float  # Greatest step; px/s

    @property
    def best(self) -> Float[np.ndarray, "2"]:
        """The velocity at the end of the step."""
        return _stepped(self.found.velocity, self.information, self.slope, self.furthest)


def climbed(level: Level, velocity: Float[np.ndarray, "2"], tolerance: float = _TOLERANCE) -> Climb:
    """A step from a velocity towards the peak of the likelihood, by Gauss and Newton."""
    here, furthest = slope_at(level, velocity, tolerance), _furthest(level)
    beside = []
    for change in here.changes:
        own = likeliest(level, velocity, tolerance, frames=change, responses=here.found.responses)
        beside.append(change - own.seen)
    noises = level.noises[:, None, None]
    information = np.array([[np.sum(d * r / noises) for r in beside] for d in here.changes])
    # Pictures without detail tell nothing of their velocity.
    information = (information + information.T) / 2 + np.eye(2) / (_UNKNOWN * furthest) ** 2
    return Climb(here.found, here.value, information, furthest)


class Peak(NamedTuple):
    """The peak of the likelihood, with the curvature that it has."""

    near: Slope  # The slope a step away
    curvature: Float[np.ndarray, "2 2"]
    covariance: Float[np.ndarray, "2 2"]  # That of the velocity's error
    furthest: float  # Greatest step; px/s

    @property
    def best(self) -> Float[np.ndarray, "2"]:
        """The velocity of the peak."""
        return _stepped(self.near.found.velocity, self.curvature, self.near.value, self.furthest)


def peak_near(level: Level, climb: Climb) -> Peak:
    """The peak by a step of Newton from the end of a climb.

    The error is that of a likelihood whose model is not the pictures': slopes scatter by what
    places of the picture pull, and the peak follows by the curvature that it has. The model's own
    curvature, of a picture with as much detail everywhere, is its bound.
    """
    near, side = slope_at(level, climb.best), _BESIDE * climb.furthest
    curvature = np.stack(
        [(near.value - slope_at(level, climb.best + side * e).value) / side for e in np.eye(2)]
    )
    curvature = _bounded(climb.information, (curvature + curvature.T) / 2, (_FLATTEST, 1.0))
    pulls, pixels = _by_place(level, near)
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


def _by_place(
    level: Level, slope: Slope
) -> tuple[Float[np.ndarray, "2 t"], Float[np.ndarray, "t"]]:
    """Sums of scores over tiles of the picture, and the pixels of the frames in each.

    A place of the picture pulls in all frames at once: tiles move as it does.
    """
    shape = level.frames.shape[1:]
    side = max(min(shape) / _TILES, 1.0)
    middles = level.instants.middles(slope.found.velocity / level.size)
    rows, columns = (
        np.floor((np.arange(count) - places[:, None]) / side).astype(int)
        for count, places in zip(shape, middles[::-1], strict=True)
    )
    rows, columns = rows - np.min(rows), columns - np.min(columns)
    places = (rows[:, :, None] * (np.max(columns) + 1) + columns[:, None]).ravel()
    pixels = np.bincount(places)
    pulls = np.stack([np.bincount(places, score.ravel()) for score in slope.scores])
    return pulls[:, pixels > 0], pixels[pixels > 0].astype(np.float64)


class Fit(NamedTuple):
    """How the frames fit the likeliest picture at a velocity."""

    # Mean square of what the picture leaves of the frames, over their noise, with the picture's own
    # freedom counted, and without gains and black levels that change
    misfit: float
    misfits: Float[np.ndarray, "n"]  # The same of each frame
    gains: Float[np.ndarray, "n"]  # Gain of each frame, less 1
    offsets: Float[np.ndarray, "n"]  # Its black level; white = 1
    shifts: Float[np.ndarray, "n 2"]  # Its displacement from its place; px
    shift_errors: Float[np.ndarray, "n 2"]  # Standard errors of these; px
    tiles: Float[np.ndarray, "t"]  # Logarithm of the likelihood that the residual has in each tile


def fit_of(level: Level, found: Likeliest, mean: float) -> Fit:
    """How the frames fit the likeliest picture."""
    num_frames = len(level.frames)
    residual = level.frames - found.seen
    down, across = frequencies_on(level.shape)
    turns = (across[None] + 0 * down[:, None], down[:, None] + 0 * across)
    # The picture follows each frame by about one part in as many as there are.
    follows = num_frames / max(num_frames - 1, 1)
    gains, offsets = np.zeros((2, num_frames))
    shifts, errors = np.zeros((2, num_frames, 2))
    expected = np.array([FLICKER, FLICKER, *[LARGEST_SHIFT / level.size] * 2])
    for k, noise in enumerate(level.noises if num_frames > 1 else []):
        spectrum = found.spectrum * found.responses[k]
        changes = [found.seen[k] + mean, np.ones_like(found.seen[k])]
        for turn in turns:
            slope = (-2j * np.pi * turn).astype(spectrum.dtype) * spectrum
            changes.append(irfft2(slope, level.shape)[level.window])
        design = np.stack([one.ravel() for one in changes], axis=1).astype(np.float64)
        inverse = np.linalg.inv(design.T @ design / noise + np.diag(expected**-2.0))
        change = inverse @ (design.T @ residual[k].ravel()) / noise
        residual[k] -= (design[:, :2] @ change[:2]).reshape(residual[k].shape)
        gains[k], offsets[k] = follows * change[:2]
        shifts[k] = follows * change[2:] * level.size
        errors[k] = follows * np.sqrt(np.diag(inverse)[2:]) * level.size
    squares = residual.astype(np.float64) ** 2 / level.noises[:, None, None]
    freedoms = volume(level, found.velocity).freedoms - (2 if num_frames > 1 else 0)
    sums = np.sum(squares, axis=(1, 2))
    return Fit(
        float(np.sum(sums) / max(np.sum(freedoms), 1.0)),
        sums / np.maximum(freedoms, 1.0),
        gains,
        offsets,
        shifts,
        errors,
        -in_tiles(np.sum(squares, axis=0)) / 2,
    )


def in_tiles(values: Float[np.ndarray, "*planes rows columns"]) -> Float[np.ndarray, "*planes t"]:
    """Sums over tiles."""
    for axis in (-2, -1):
        count = values.shape[axis]
        starts = np.linspace(0, count, min(_TILES, count), endpoint=False).astype(int)
        values = np.add.reduceat(values, starts, axis=axis)
    return values.reshape(*values.shape[:-2], -1)


def noises_in_plane(scene: Scene, taken: PlaneFrames, mean_level: float) -> Float[np.ndarray, "n"]:
    """Variance of the noise in each frame of a picture of some mean level; white = 1.

    Raises:
        ValueError: if the scene has no light.
    """
    exposures = np.asarray(taken.exposures, np.float64)
    electrons = np.asarray(white_electrons(float(scene.photon_rate), exposures))
    has_light, requirement = float(np.min(electrons)) > 0, "have a photon rate above 0 e-/s"
    require(has_light, "restore_frames(scene=...)", requirement, 0.0)
    read, level = float(scene.read_noise), max(mean_level, 0.0)
    return np.maximum(noise_power(1.0, level, electrons, read, unit=electrons), DARK)
