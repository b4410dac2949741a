r"""The level of frames of piecewise constant acceleration in closed form, with its gradient.

A decoder that registers the frames leaves the error

$$E = \sum_m w_m S_m\,\overline{\frac{1}{1 + S_m P_m\sum_k g_k|H_k|^2}},\qquad g_k = e_k^2/N_k,$$

at frequencies $\mathbf f_m$ of one axis or two, in the mean over velocities $\mathbf v$
(`mishutter.evaluation`). Over a piece of constant acceleration the phase is
$\varphi + bx + cx^2$ with $x$ from -1 to 1, and

$$\frac12\int_{-1}^1 e^{-i(bx + cx^2)}\,dx = \frac{e^{ib^2/4c}}{2r}\,
\bigl[C - iS\bigr]_{b/\pi r - r}^{b/\pi r + r},\qquad r = \sqrt{2c/\pi},$$

by Fresnel's integrals $C$ and $S$. A frame's numbers change that frame alone, and the derivatives
by $b$ and $c$ follow by parts, so that a gradient costs little more than a level. Nothing here
compiles.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from mishutter.evaluation.fans import Fan, Grid
from mishutter.evaluation.instants import Instants
from mishutter.evaluation.levels import Light, components_on, in_parts, psnr_of_error
from mishutter.evaluation.needs import distinct_speeds
from mishutter.model.optics import NYQUIST_FREQUENCY, frequencies, pixel_response
from mishutter.model.scene import Scene, power_on_grid

_NUM_FREQUENCIES, _NUM_LITERAL = 48, 256
"""Frequencies of a search, and of a level that is told."""
_NUM_POWERS = 8192
"""Frequencies of an axis at which its power is known."""
_GOLDEN = (5**0.5 - 1) / 2
"""Share of a step by which speeds of a lattice follow each other, frequency by frequency."""
_NUM_SPEEDS = 17
"""Speeds that stand for a range at each frequency."""
_LEAST_RANGE = 5
"""Speeds in equal steps that are a range and no list."""
_SHIFT = 1e-5
"""Share of an exposure over which the slope of its gain is taken."""
_nodes = lru_cache(np.polynomial.legendre.leggauss)
_STRAIGHT = 3e-3
"""Phase by acceleration below which a piece is expanded about constant velocity; rad."""
_NEARLY_STRAIGHT = 3e-2
"""The same for the moments, which lose twice as many digits to differences."""
_ASIDE = 20
"""Places to either side at which a picture is looked for; px."""
_NEAR_0 = 1e-2
"""Phase by velocity below which the responses are expanded about rest; rad."""


class Shape(NamedTuple):
    """Sizes of frames."""

    number: int  # Number of frames
    pieces: int  # Pieces of constant acceleration in each
    axes: int  # Axes of the stage


class Frames(NamedTuple):
    """Frames of a sensor on one axis or two, and the way of its stage between them."""

    exposure: Float[np.ndarray, "n"]  # s
    # Velocities of the sensor at the ends of equal pieces of each frame; px/s
    velocity: Float[np.ndarray, "n ends axes"]
    gap: Float[np.ndarray, "n-1"]  # Time from the end of each frame to the next; s
    place: Float[np.ndarray, "n axes"]  # Place of the stage at the begin of each frame; px
    pan: Float[np.ndarray, "axes"]  # Velocity at which the camera turns beside the stage; px/s

    @property
    def shape(self) -> Shape:
        """Their sizes."""
        count, ends, axes = self.velocity.shape
        return Shape(count, ends - 1, axes)

    @property
    def steps(self) -> Float[np.ndarray, "*b n 1"]:
        """Durations of the pieces of each frame; s."""
        return (self.exposure / (self.velocity.shape[-2] - 1))[..., None]

    @property
    def begins(self) -> Float[np.ndarray, "*b n"]:
        """Time from the first light to the begin of each; s."""
        ahead = np.cumsum(self.exposure[..., :-1] + self.gap, axis=-1)
        return np.concatenate([0 * self.exposure[..., :1], ahead], axis=-1)

    @property
    def middles(self) -> Float[np.ndarray, "n"]:
        """Mid-exposures, from the middle of all; s."""
        begins = self.begins
        return begins + self.exposure / 2 - (begins[-1] + self.exposure[-1]) / 2

    @property
    def stage(self) -> Float[np.ndarray, "*b n ends axes"]:
        """Velocities of the stage at the ends of pieces; px/s."""
        return self.velocity - self.pan[..., None, None, :]

    @property
    def knots(self) -> Float[np.ndarray, "*b n ends axes"]:
        """Places of the stage there; px."""
        stage = self.stage
        ways = np.cumsum(self.steps[..., None] * (stage[..., 1:, :] + stage[..., :-1, :]) / 2, -2)
        ways = np.concatenate([0 * stage[..., :1, :], ways], axis=-2)
        return self.place[..., None, :] + ways

    @property
    def between(self) -> Float[np.ndarray, "*b gaps axes"]:
        """Ways of the stage from the end of each to the next; px."""
        return self.place[..., 1:, :] - self.knots[..., :-1, -1, :]

    def in_line(self) -> "Frames":
        """The same from the place 0, with a stage that speeds up evenly between them."""
        stage, ways = self.stage, self.knots[:-1, -1] - self.place[:-1]
        between = self.gap[:, None] * (stage[:-1, -1] + stage[1:, 0]) / 2
        ahead = np.cumsum(ways + between, axis=0)
        return self._replace(place=np.concatenate([0 * stage[:1, 0], ahead]))


class Levels(NamedTuple):
    """Errors of frames of a scene, for a decoder that registers them."""

    frequency: Float[np.ndarray, "m axes"]  # cycles/px
    temporal: Float[np.ndarray, "m l"]  # Of things at each frequency, $fv$; Hz
    weight: Float[np.ndarray, "m l"]  # Power of the picture that each stands for
    signal: Float[np.ndarray, "m"]  # Power of the picture behind the pixels
    light: Light  # Light and noise

    @staticmethod
    def on_axis(scene: Scene, *, literal: bool = False) -> "Levels":
        """Those of a scene of one axis, in which each part moves on its own.

        Speeds in equal steps stand for a range, unless they are to be taken literally.
        """
        parts = in_parts(scene)
        speeds, weights = (np.asarray(x, np.float64) for x in distinct_speeds(parts, folds=False))
        x, step = _nodes(_NUM_LITERAL if literal else _NUM_FREQUENCIES)
        root, cutoff = (x + 1) / 2, min(float(scene.optics.cutoff_frequency), NYQUIST_FREQUENCY)
        # Low frequencies, at which a picture has most of its power, are dense.
        frequency, share = cutoff * root**2, 2 * cutoff * root * step
        power = np.interp(frequency, frequencies(_NUM_POWERS), power_on_grid(parts, _NUM_POWERS))
        power *= float(parts.picture.deviation) ** 2 / max(share @ power, np.finfo(float).tiny)
        weights = weights / weights.sum()
        if not literal:
            speeds, weights = _sampled(speeds, weights, frequency.size)
        aperture = np.asarray(pixel_response(frequency, float(scene.optics.lens_blur))) ** 2
        each, along = (share * power)[:, None] * weights, frequency[:, None]
        return Levels(along, along * speeds, each, power * aperture, Light.of(scene))

    @staticmethod
    def in_plane(
        scene: Scene,
        grid: Grid,
        unit: Float[np.ndarray, "axes 2"],
        offset: Float[np.ndarray, "2"],
    ) -> "Levels":
        """Those of a scene in the plane, by the velocities of a stage along some axes.

        Args:
            scene: Velocities in any direction, light and noise.
            grid: Sizes of the fan of frequencies.
            unit: Directions of the axes.
            offset: Velocity of all of the camera beside the stage; px/s.
        """
        fan, light = Fan.of(scene, grid), Light.of(scene)
        turn = np.stack([np.cos(fan.direction), np.sin(fan.direction)], axis=-1)
        frequency = np.asarray(fan.radius[:, None, None] * turn, np.float64).reshape(-1, 2)
        parts = components_on(scene, fan, grid.num_speeds)
        each = (np.broadcast_to(x, (*fan.direction.shape, x.shape[-1])) for x in parts)
        speeds, shares = (np.asarray(x, np.float64).reshape(len(frequency), -1) for x in each)
        temporal = np.hypot(*frequency.T)[:, None] * speeds - (frequency @ offset)[:, None]
        power = float(scene.picture.deviation) ** 2 * np.ravel(np.asarray(fan.weight))
        weight = power[:, None] * shares
        signal = np.ravel(np.asarray(light.signal(fan), np.float64))
        return Levels(frequency @ unit.T, temporal, weight, signal, light)

    def errors(self, frames: Frames) -> Float[np.ndarray, "m l"]:
        """Error that is left at each frequency by each velocity; white = 1."""
        return self.left(np.sum(self.gained(frames), axis=0))

    def left(self, gained: Float[np.ndarray, "m l"]) -> Float[np.ndarray, "m l"]:
        """The same by the ratio of signal to noise that all frames add."""
        return self.weight / (1 + gained)

    def gained(self, frames: Frames) -> Float[np.ndarray, "n m l"]:
        """Ratio of signal to noise that each frame adds at each frequency for each velocity."""
        gain = np.asarray(self.light.gains(frames.exposure))[:, None]
        power = np.abs(self._responses(frames)[0]) ** 2
        return (gain * self.signal)[..., None] * power

    def errors_at(self, instants: Instants) -> Float[np.ndarray, "m l"]:
        """Error that frames leave at each frequency, by their instants on any path; white = 1."""
        gain = np.asarray(self.light.gains(instants.exposure))
        gained = np.tensordot(gain, np.abs(self._waves_at(instants)) ** 2, 1)
        return self.left(self.signal[:, None] * gained)

    def lost_untold(self, told: Instants, seen: Instants) -> float:
        """Decibels that a decoder loses which takes frames for others, and finds their place.

        Args:
            told: Instants that its filters are for.
            seen: Those of the frames.
        """
        gain = np.asarray(self.light.gains(told.exposure))[:, None, None]
        mine, truth = (self._waves_at(each) for each in (told, seen))
        over = 1 + self.signal[:, None] * np.sum(gain * np.abs(mine) ** 2, axis=0)
        filters = self.signal[:, None] * gain * mine.conj() / over
        passed = np.sum(filters * truth, axis=0)
        # Noise of the power 1/g in each frame, in units of the picture behind the pixels.
        noise = np.sum(np.abs(filters) ** 2 / gain, axis=0) / self.signal[:, None]
        shifts = np.exp(2j * np.pi * self.frequency[:, :1] * np.arange(-_ASIDE, _ASIDE + 1))
        each = [np.abs(1 - passed * turn[:, None]) ** 2 + noise for turn in shifts.T]
        least = np.min([np.sum(self.weight * one, axis=0) for one in each], axis=0)
        return 10 * float(np.log10(np.sum(least) / np.sum(self.weight / over)))

    def _waves_at(self, instants: Instants) -> Complex[np.ndarray, "n m l"]:
        """Responses of frames by their instants."""
        every = []
        ways = -2j * np.pi * np.moveaxis(instants.place, 0, -1)
        for way, time, weight in zip(ways, instants.time, instants.weight, strict=True):
            on_sensor = weight * np.exp(self.frequency @ way.T)
            passing = np.exp(2j * np.pi * self.temporal[..., None] * time)
            every.append(np.einsum("mq,mlq->ml", on_sensor, passing))
        return np.array(every)

    def level(self, frames: Frames) -> float:
        """PSNR of the best linear decoder that registers the frames; dB."""
        return psnr_of_error(float(np.sum(self.errors(frames))))

    def slope(
        self, frames: Frames
    ) -> tuple[float, Float[np.ndarray, "n"], Float[np.ndarray, "n ends axes"]]:
        r"""$10\log_{10} E$ and its derivatives by the exposures and the velocities."""
        whole, phases, exposure = *self._responses(frames), frames.exposure
        power, signal = np.abs(whole) ** 2, self.signal[:, None]
        gain = np.asarray(self.light.gains(exposure))
        over = 1 + signal * np.tensordot(gain, power, 1)
        left = self.weight / over
        error = float(np.sum(left))
        # Derivatives by the summed gain, and by the power of each frame.
        by_gain = -left * signal / over
        by_power = gain[:, None, None] * by_gain
        by_exposure = self.gain_slope(exposure) * np.sum(by_gain * power, axis=(1, 2))
        turned = 2 * whole.conj() * by_power
        by_velocity = np.zeros(frames.velocity.shape)
        for phase in phases:
            # The derivative of the wave is $-i$ times its moment, of which the real part counts.
            pulled = np.imag(turned[:, None] * phase.moment)
            # All phases are proportional to the exposure.
            by_exposure = by_exposure + np.sum(pulled * phase.value, axis=(1, 2, 3))
            by_velocity += phase.matrix.T @ (np.sum(pulled, axis=3) @ self.frequency)
        scale = 10 / np.log(10) / max(error, np.finfo(float).tiny)
        by_velocity *= frames.steps[..., None]
        return -psnr_of_error(error), scale * by_exposure / exposure, scale * by_velocity

    def gain_slope(self, exposure: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Derivative of the gain of each frame by the logarithm of its exposure."""
        ends = (np.asarray(self.light.gains(exposure * x)) for x in (1 + _SHIFT, 1 - _SHIFT))
        return np.subtract(*ends) / (2 * _SHIFT)

    def _responses(self, frames: Frames) -> tuple[Complex[np.ndarray, "n m l"], list["_Phase"]]:
        """Responses of the frames, and the phases that they follow from."""
        count, steps = frames.velocity.shape[1] - 1, frames.steps[..., None]
        first, last = np.eye(count, count + 1), np.eye(count, count + 1, 1)
        mean = (first + last) / 2
        # Ways from the begin of a frame to the middles of its pieces.
        before = np.tril(np.ones((count, count)), -1) @ mean + (3 * first + last) / 8
        matrices = np.pi * mean, np.pi / 4 * (last - first), 2 * np.pi * before
        linear, square, middle = (
            (matrix @ frames.velocity @ self.frequency.T * steps)[..., None] for matrix in matrices
        )
        # What moves changes the linear part and the place.
        linear = linear - np.pi * steps[..., None] * self.temporal
        halves = (np.arange(count) + 0.5)[:, None, None]
        middle = middle - 2 * np.pi * steps[..., None] * halves * self.temporal
        square = np.broadcast_to(square, linear.shape)
        moments = chirps(linear, square)
        if count > 1:
            wave = np.exp(-1j * middle) / count
            moments = moments[0] * wave, moments[1] * wave, moments[2] * wave
        whole, first_moment, second = moments
        phases = [
            _Phase(first_moment, linear, matrices[0]),
            _Phase(second, square, matrices[1]),
            _Phase(whole, middle, matrices[2]),
        ]
        # The place of a frame that is one piece does not count.
        return np.sum(whole, axis=1), phases if count > 1 else phases[:2]


class _Phase(NamedTuple):
    """A number of the phase over a piece, and what it follows from."""

    moment: Complex[np.ndarray, "n j m l"]  # Derivative of the response by it, times $i$
    value: Float[np.ndarray, "n j m l"]  # rad
    matrix: Float[np.ndarray, "j j+1"]  # From the velocities at the ends of pieces, over a duration


def chirps(
    b: Float[np.ndarray, "*shape"], c: Float[np.ndarray, "*shape"]
) -> tuple[
    Complex[np.ndarray, "*shape"], Complex[np.ndarray, "*shape"], Complex[np.ndarray, "*shape"]
]:
    r"""$\frac12\int x^k e^{-i(bx + cx^2)}\,dx$ over (-1, 1) for $k = 0, 1, 2$."""
    from scipy.special import fresnel

    flips = c < 0
    b, c = np.where(flips, -b, b), np.abs(c)
    curved, most = c > _STRAIGHT, c > _NEARLY_STRAIGHT
    every = [np.empty(b.shape, np.complex128) for _ in range(3)]
    # Each is computed where it is taken: this is most of a search.
    for moment, values in zip(every, _straight(b[~most], c[~most]), strict=True):
        moment[~most] = values
    x, z, steep = b[curved], c[curved], most[curved]
    r = np.sqrt(2 / np.pi * z)
    middle = x / (np.pi * r)
    (s1, c1), (s2, c2) = fresnel(middle - r), fresnel(middle + r)
    whole = np.exp(1j * x * x / (4 * z)) * ((c2 - c1) - 1j * (s2 - s1)) / (2 * r)
    every[0][curved] = whole
    x, z, whole = x[steep], z[steep], whole[steep]
    up, down = np.exp(-1j * (x + z)), np.exp(1j * (x - z))
    first = (0.5j * (up - down) - x * whole) / (2 * z)
    every[1][most] = first
    every[2][most] = (0.5j * (up + down) - 1j * whole - x * first) / (2 * z)
    return tuple(np.where(flips, x.conj(), x) for x in every)  # type: ignore[return-value]


def _straight(
    b: Float[np.ndarray, "*shape"], c: Float[np.ndarray, "*shape"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same about constant velocity, to the first order in `c`."""
    near = np.abs(b) < _NEAR_0
    z = np.where(near, 1.0, b)
    sine, cosine, square = np.sin(z), np.cos(z), b * b
    even = np.where(near, 1 - square / 6, sine / z)
    odd = np.where(near, -b / 3 * (1 - square / 10), (cosine - even) / z)  # derivative of `even`
    second = np.where(near, -1 / 3 + square / 10, -even - 2 * odd / z)
    third = np.where(near, b / 5, -odd - 2 * second / z + 2 * odd / z**2)
    fourth = np.where(near, 1 / 5, -second - 2 * third / z + 4 * second / z**2 - 4 * odd / z**3)
    # The k-th derivative of the whole is $(-i)^k$ times the k-th moment.
    return even + 1j * c * second, 1j * odd - c * third, -second - 1j * c * fourth


def is_range(speeds: Float[np.ndarray, "n"]) -> bool:
    """Whether ascending speeds are so many in equal steps that they stand for a range."""
    steps = np.diff(speeds)
    return speeds.size >= _LEAST_RANGE and bool(np.ptp(steps) <= 1e-3 * np.mean(steps))


def _sampled(
    speeds: Float[np.ndarray, "n"], weights: Float[np.ndarray, "n"], count: int
) -> tuple[Float[np.ndarray, "{count} l"], Float[np.ndarray, "l"]]:
    """Speeds at each of some frequencies, and their weights.

    Speeds in equal steps stand for a range: each for all up to the middles between it and its
    neighbours. Few of them, which would be exploited by frames that follow each, are other ones at
    each frequency: those of a lattice, whose mean over speeds and frequencies is exact to far
    finer details.
    """
    if not is_range(speeds):
        return np.tile(speeds, (count, 1)), weights
    ends = np.concatenate([speeds[:1], (speeds[1:] + speeds[:-1]) / 2, speeds[-1:]])
    each = -(-_NUM_SPEEDS // speeds.size)
    turns = np.arange(count) * _GOLDEN % 1
    share = (np.arange(each) + turns[:, None]) / each
    places = ends[:-1, None] + np.diff(ends)[:, None] * share[:, None]
    return places.reshape(count, -1), np.repeat(weights / each, each)
