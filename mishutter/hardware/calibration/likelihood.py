r"""The likelihood of a camera given its measurements, and the least squares that maximise it.

The likelihood is Poisson-Gaussian: each pixel has the variance of its own expected level. A fit
takes several rounds, each with the variances of the levels that the round before expects
(iterated reweighting). Optimistix's Levenberg-Marquardt minimises.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from mishutter._core.checks import require
from mishutter._core.compiling import compiled
from mishutter.hardware.calibration.measurements import END, Measurements
from mishutter.hardware.calibration.response import FINE, MOVED, collected, kernels
from mishutter.hardware.traces import Trace, measured_profile
from mishutter.model.motion import AbstractMotion, ParabolicMotion
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.spline import (
    SplineShutter,
    coefficient_times,
    spline_basis,
    spline_knots,
)

RANGE = 12**-0.5
"""Standard deviation of a number anywhere from 0 to 1.

Rounds on the pictures themselves hold each coefficient this near the one that was sent; the last
round holds only the combinations that no picture shows.
"""
_WIDTH = 4.0
"""Standard deviation of the Gaussian that smooths pictures for a start; px."""
_NUM_SPEEDS = 3
"""Number of speeds with which every profile is tried, where one is unknown."""
_NUM_ENDS = 5
"""Number of cameras of smoothed pictures from which the pictures themselves are fitted."""
_PIN = 1e3
"""Weight of a pin, which holds a combination of parameters to a thousandth of its scale."""


class _Arrays(NamedTuple):
    """The data of the residuals, as arrays of NumPy.

    They are arguments of the compiled program, so that one program serves all data of a shape.
    """

    levels: Float[np.ndarray, "pictures columns"]  # Mean of the rows of each picture
    deviation: Float[np.ndarray, "pictures columns"]  # Standard deviation of each level
    speeds: Float[np.ndarray, "pictures"]  # Known speeds, and 0 where one is unknown; px/s
    is_unknown: Bool[np.ndarray, "pictures"]  # Whether the speed of each picture is unknown
    is_edge: Bool[np.ndarray, "pictures"]  # Whether each picture is of an edge
    half_exposure: Float[np.ndarray, ""]  # $T$; s
    scales: Float[np.ndarray, "parameters"]  # Scale of each parameter, in its unit
    ties: Float[np.ndarray, "k parameters"]  # Rows of all `Ties`
    aims: Float[np.ndarray, "k"]  # Their aims
    trace: Float[np.ndarray, "samples"]  # Levels of the trace
    trace_basis: Float[np.ndarray, "samples coefficients"]  # B-splines at its samples
    trace_deviation: Float[np.ndarray, ""]  # Standard deviation of its levels

    def residuals(self, values: Array, num_taps: int) -> Array:
        """Residuals of pictures, trace, bounds and ties, at parameters in their own scales.

        Coefficients stray below 0, where no transmittance is, by a standard deviation of 0.01.
        That prevents a fit of another stage with a profile that opens with a step down, which gives
        nearly the pictures of one that opens with a step up.
        """
        x = values * self.scales
        a, v, speed, blur = x[:4]
        num_pictures, num_columns = self.levels.shape
        count = self.trace_basis.shape[1]
        coefficients = x[4 : 4 + count]
        position, gain, background = x[4 + count : -2].reshape(num_pictures, 3).T
        relative = jnp.where(self.is_unknown, speed, self.speeds) - v
        taps = kernels(coefficients, a, self.half_exposure, relative, num_taps)
        begin = position - relative**2 / (4 * a) - MOVED / FINE
        irradiance = collected(taps, begin, blur, self.is_edge, num_columns)
        expected = background[:, None] + gain[:, None] * irradiance
        trace = x[-2] * (self.trace_basis @ coefficients) + x[-1]
        return jnp.concatenate(
            [
                jnp.ravel((expected - self.levels) / self.deviation),
                (trace - self.trace) / self.trace_deviation,
                jnp.minimum(coefficients, 0) / 0.01,
                self.ties @ values - self.aims,
            ]
        )


_residuals = compiled(_Arrays.residuals)


@eqx.filter_jit
def _linearised(values: Array, arrays: _Arrays, num_taps: int) -> tuple[Array, Array]:
    """Residuals and their Jacobian.

    Each picture has three parameters of its own, and the trace has two, each of which moves the
    rows of that picture or of the trace alone. Three directions therefore give the derivatives by
    all of them: the first parameters of all pictures and the trace, the second, and the third.
    """
    residual, derivative = jax.linearize(lambda x: arrays.residuals(x, num_taps), values)
    num_pictures, num_columns = arrays.levels.shape
    shared = values.size - 3 * num_pictures - 2
    direction = np.append(np.arange(shared), shared + np.arange(3 * num_pictures + 2) % 3)
    directions = np.arange(shared + 3)[:, None] == direction[None]
    slopes = jax.vmap(derivative, out_axes=1)(jnp.asarray(directions, values.dtype))
    column_owner = np.append(np.full(shared, -1), np.arange(3 * num_pictures + 2) // 3)
    row_owner = np.repeat(np.arange(num_pictures), num_columns)
    row_owner = np.append(row_owner, np.full(arrays.trace.size, num_pictures))
    row_owner = np.append(row_owner, np.full(arrays.trace_basis.shape[1], num_pictures + 1))
    is_moved = (column_owner[None] == -1) | (column_owner[None] == row_owner[:, None])
    data_rows = jnp.where(is_moved, slopes[: row_owner.size, direction], 0)
    return residual, jnp.concatenate([data_rows, arrays.ties])


@eqx.filter_custom_jvp
def _residuals_by_matrix(values: Array, *, arrays: _Arrays, num_taps: int) -> Array:
    """Residuals whose derivative is a product with their Jacobian.

    It prevents the minimiser from compiling the kernel's derivative in each of the three places
    that ask for one.
    """
    return arrays.residuals(values, num_taps)


@_residuals_by_matrix.def_jvp
def _by_matrix(
    primals: tuple[Array], tangents: tuple[Array], *, arrays: _Arrays, num_taps: int
) -> tuple[Array, Array]:
    residual, matrix = _linearised(*primals, arrays, num_taps)
    return residual, matrix @ tangents[0]


@compiled
def _least_squares(start: Array, arrays: _Arrays, num_taps: int) -> tuple[Array, Array, Array]:
    """Parameters, the residuals and their Jacobian where the minimiser ends."""
    import optimistix as optx

    def residuals(values: Array, arrays: _Arrays) -> Array:
        return _residuals_by_matrix(values, arrays=arrays, num_taps=num_taps)

    # At changes by the rounding of the sum of squares it would refuse step after step.
    solver = optx.LevenbergMarquardt(rtol=1e-3, atol=1e-3)
    solution = optx.least_squares(residuals, solver, start, arrays, max_steps=30, throw=False)
    end = solution.state.f_info
    return solution.value, end.residual, end.jac.as_matrix()


class Ties(NamedTuple):
    """Linear combinations of the parameters that are held near values."""

    # Coefficients of each combination, over its standard deviation
    rows: Float[np.ndarray, "k parameters"]
    aims: Float[np.ndarray, "k"]  # The values, over the same


class Solution(NamedTuple):
    """The end of a round."""

    loss: float  # Sum of squares, of the ties and bounds too
    values: Float[np.ndarray, "parameters"]  # Parameters, in their own scales
    residual: Float[np.ndarray, "residuals"]  # Residuals of the data and the pins
    matrix: Float[np.ndarray, "residuals parameters"]  # Their Jacobian
    expected: Float[np.ndarray, "pictures columns"]  # Expected levels
    noise: Float[np.ndarray, "pictures columns"]  # Standard deviations of the levels in this round


@dataclass(frozen=True, eq=False)
class Setting:
    """The problem of a fit: its data, the scales of its parameters, and their pins."""

    names: tuple[str, ...]  # Names of the parameters
    arrays: _Arrays  # The data of the residuals
    pins: Ties  # Combinations of the parameters that keep their value
    profiles: tuple[np.ndarray, ...]  # Mean of the rows of each picture
    measurements: Measurements  # The measurements themselves
    sent_motion: ParabolicMotion  # The motion as sent
    coefficients: np.ndarray  # B-spline coefficients of the transmittance as sent
    num_taps: int  # Number of taps of a kernel, of 1/8 px
    notes: tuple[str, ...]  # Sentences about parameters that no measurement of this kind determines

    @staticmethod
    def of(
        measurements: Measurements, motion: AbstractMotion, shutter: AbstractShutter, count: int
    ) -> "Setting":
        """The problem of measurements of a camera that was sent a motion and a shutter."""
        pictures, trace = measurements.pictures, measurements.trace
        profiles = tuple(picture.profile(measurements.sensor) for picture in pictures)
        a, T, v = (float(getattr(motion, n)) for n in ("acceleration", "half_exposure", "velocity"))
        num_columns = {profile.size for profile in profiles}
        requirement = "have pictures of equally many columns"
        require(len(num_columns) == 1, "fit(measurements=...)", requirement, sorted(num_columns))
        is_unknown = np.array([picture.speed is None for picture in pictures])
        speeds = np.array([picture.speed or 0.0 for picture in pictures])
        spline = SplineShutter.fit(shutter, count)
        coefficients = np.asarray(spline.coefficients, np.float64)
        spline_means = _spline_means(count)
        throughput = float(spline_means @ coefficients)
        names = ["acceleration", "velocity", "speed", "lens blur"]
        names += [f"transmittance {k}" for k in range(count)]
        for k in range(len(pictures)):
            names += [f"position {k}", f"gain {k}", f"background {k}"]
        names += ["swing of the trace", "dark of the trace"]
        notes, pins, values = [], [], []

        def pin(name: str, value: float) -> None:
            pins.append(np.array([float(name == each) for each in names]))
            values.append(value)

        if not is_unknown.any():
            pin("speed", 0.0)
        elif is_unknown.all():
            pin("velocity", v / (2 * a * T))
            notes.append(
                "velocity and speed apart: only the speed over the sensor is seen where none is "
                "known (the velocity is taken as sent)"
            )
            if trace is None:
                notes.append(
                    "sign of the speed: the mirrored profile at the opposite speed gives the same"
                )
        trace_levels, trace_basis, trace_noise = _trace_samples(trace, T, count)
        if trace is None:
            pin("swing of the trace", 0.0)
            pin("dark of the trace", 0.0)
        throughput_row = np.zeros(len(names))
        throughput_row[4 : 4 + count] = spline_means
        pins.append(throughput_row)
        values.append(throughput)
        notes.append(
            "gain and transmittance apart: only their product is seen (the profile has the light "
            "that was sent)"
        )
        notes.append(
            "velocity and delay apart: only v - 2 a d is seen (the delay is that of a stage whose "
            "velocity is as sent)"
        )
        top = 2 * a * T
        fastest = top + max(np.abs(speeds - v).max(), (0.7 * top) * is_unknown.any())
        sent_motion = ParabolicMotion(acceleration=a, half_exposure=T, velocity=v)
        # Kernels have room for a blur that is longer than that of the motion as sent.
        longest = 1.3 * float(sent_motion.kernel_length(fastest - top + abs(v)))
        num_taps = int(np.ceil(longest)) * FINE + 2 * FINE
        scales = np.array([a, top, top, 1.0, *[1.0] * count])
        for picture, profile in zip(pictures, profiles, strict=True):
            gain = _strength_and_place(profile, picture.target == "edge")[0] / throughput
            level_range = max(float(np.ptp(profile)), 1e-9)
            scales = np.append(scales, [a * T**2, gain, level_range])
        swing = float(np.ptp(trace_levels)) if trace_levels.size else 1.0
        scales = np.append(scales, [swing, swing])
        arrays = _Arrays(
            levels=np.array(profiles),
            deviation=np.ones((len(pictures), profiles[0].size)),
            speeds=speeds,
            is_unknown=is_unknown,
            is_edge=np.array([picture.target == "edge" for picture in pictures]),
            half_exposure=np.asarray(T),
            scales=scales,
            ties=np.zeros((0, scales.size)),
            aims=np.zeros(0),
            trace=trace_levels,
            trace_basis=trace_basis,
            trace_deviation=np.asarray(trace_noise),
        )
        return Setting(
            tuple(names),
            arrays,
            Ties(_PIN * np.array(pins), _PIN * np.array(values)),
            profiles,
            measurements,
            sent_motion,
            coefficients,
            num_taps,
            tuple(notes),
        )

    def noise(self, expected: np.ndarray) -> np.ndarray:
        """Standard deviation of rows' means about expected levels; shape `(pictures, columns)`."""
        pictures, sensor, _ = self.measurements
        variances = [
            sensor.variance(row, picture.is_rounded) / len(picture.levels)
            for row, picture in zip(expected, pictures, strict=True)
        ]
        return np.sqrt(variances)

    def residuals(self, values: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Residuals of the data and the pins at some parameters, each over its noise."""
        rows, aims = self.pins
        arrays = self.arrays._replace(deviation=noise, ties=rows, aims=aims)
        return self.without_bounds(_residuals(arrays, jnp.asarray(values), self.num_taps))

    def without_bounds(self, rows: Array | np.ndarray) -> np.ndarray:
        """Residuals, or rows of their Jacobian, without those that keep coefficients above 0."""
        first = self.arrays.levels.size + self.arrays.trace.size
        return np.delete(np.asarray(rows), first + np.arange(len(self.coefficients)), axis=0)

    @property
    def is_pinned(self) -> np.ndarray:
        """Whether each parameter is pinned by itself."""
        return np.any(np.abs(self.pins.rows) == _PIN, axis=0)

    def smoothed(self, width: float) -> "Setting":
        """The same problem with pictures behind a second Gaussian lens, of this width; px."""
        from scipy.ndimage import gaussian_filter1d

        levels = gaussian_filter1d(self.arrays.levels, width, axis=1, mode="nearest")
        return replace(self, arrays=self.arrays._replace(levels=levels))

    def near(self, coefficients: np.ndarray, deviation: float) -> Ties:
        """Ties that hold the profile's coefficients near these."""
        rows = np.eye(len(self.names))[4 : 4 + len(self.coefficients)]
        return Ties(rows / deviation, coefficients / deviation)

    def near_sent(self) -> Ties:
        """Ties that hold the profile's coefficients loosely near those that were sent."""
        return self.near(self.coefficients, RANGE)

    def likely_profiles(self) -> list[np.ndarray]:
        """Coefficients of profiles that may have been made, in the light of the one sent.

        They are the one sent, an open one, one that opens late and one that opens early, and that
        of the trace.
        """
        tau = coefficient_times(self.coefficients.size)
        shapes = [np.ones_like(tau), 1 + tau, 1 - tau]
        if self.arrays.trace.size:
            levels = self.arrays.trace - np.min(self.arrays.trace)
            made = np.linalg.lstsq(self.arrays.trace_basis, levels, rcond=None)[0]
            shapes.append(np.maximum(made, 0))
        means = _spline_means(tau.size)
        light = means @ self.coefficients
        return [self.coefficients, *(shape * light / (means @ shape) for shape in shapes)]

    def delay(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Delay of a stage whose velocity is as sent, and its derivatives; s."""
        scales = np.asarray(self.arrays.scales)
        a, v = (values * scales)[:2]
        delay = (float(self.sent_motion.velocity) - v) / (2 * a)
        slopes = np.zeros(values.size)
        slopes[:2] = np.array([-delay / a, -1 / (2 * a)]) * scales[:2]
        return float(delay), slopes

    def start(self, coefficients: np.ndarray, share: float) -> np.ndarray:
        """The camera that was sent, but for its profile, at the centroids of the pictures."""
        count, scales = len(coefficients), self.arrays.scales
        is_unknown, trace = self.arrays.is_unknown, self.arrays.trace
        velocity = float(self.sent_motion.velocity) / float(scales[1])
        start = np.concatenate([[1.0, velocity, share, 0.5], coefficients])
        for k, profile in enumerate(self.profiles):
            level_range = float(scales[4 + count + 3 * k + 2])
            start = np.append(start, [0.0, 1.0, float(np.mean(profile[:END])) / level_range])
        dark = float(np.min(trace)) / float(scales[-1]) if trace.size else 0.0
        start = np.append(start, [1.0, dark] if trace.size else [0.0, 0.0])
        if not is_unknown.any():
            start[2] = 0.0
        x = start * scales
        relative = np.where(is_unknown, x[2], self.arrays.speeds) - x[1]
        half = float(self.sent_motion.half_exposure)
        mean_time, mean_square = _moments(coefficients) * half ** np.arange(1, 3)
        for k, profile in enumerate(self.profiles):
            path = x[0] * mean_square - relative[k] * mean_time
            position = _strength_and_place(profile, bool(self.arrays.is_edge[k]))[1] - path
            start[4 + count + 3 * k] = position / float(scales[4 + count + 3 * k])
        return start

    def solved(
        self,
        values: np.ndarray,
        noise: np.ndarray,
        ties: Ties,
        pull: tuple[np.ndarray, float] | None = None,
    ) -> Solution:
        """The end of one round of a fit."""
        rows = np.zeros((values.size + 1, values.size))
        aims = np.zeros(values.size + 1)
        rows[: len(ties.rows)], aims[: len(ties.rows)] = ties
        if pull is not None:
            rows[-1], aims[-1] = pull
        arrays = self.arrays._replace(
            deviation=noise,
            ties=np.concatenate([self.pins.rows, rows]),
            aims=np.concatenate([self.pins.aims, aims]),
        )
        end = _least_squares(jnp.asarray(values), arrays, self.num_taps)
        values, residual, matrix = (np.asarray(each) for each in end)
        levels = np.asarray(arrays.levels)
        expected = levels + residual[: levels.size].reshape(levels.shape) * noise
        loss = float(np.sum(residual[:-1] ** 2))
        residual, matrix = (self.without_bounds(x)[: -len(rows)] for x in (residual, matrix))
        return Solution(loss, values, residual, matrix, expected, noise)

    def num_first_rounds(self, shares: Sequence[float]) -> int:
        """Number of fits that `likeliest_start` makes."""
        num_others = len(self.likely_profiles()) - 1
        num_rough = len(shares) + num_others * min(_NUM_SPEEDS, len(shares))
        return num_rough + min(_NUM_ENDS, num_rough)

    def likeliest_start(self, shares: Sequence[float], begin: Callable[[str], None]) -> Solution:
        """The end of the likeliest of several first rounds.

        A picture shows a jump of the profile as a step at a place of its own. A camera whose steps
        lie right in some of the pictures and wrong in the others is a local minimum, of which
        smoothed pictures have fewer. The stage and the shutter explain the same light, so that a
        profile held near one of another shape leads to another stage, and a free one to wherever it
        began. First rounds therefore fit smoothed pictures from several profiles, near which they
        stay, and the pictures themselves from the likeliest of these cameras.
        """
        noise, smooth = self.noise(np.asarray(self.arrays.levels)), self.smoothed(_WIDTH)

        def rough(profile: np.ndarray, share: float) -> Solution:
            begin("smoothed pictures")
            start = _with_blur(self.start(profile, share), _WIDTH**2)
            return smooth.solved(start, noise, self.near(profile, 0.1))

        sent, *others = self.likely_profiles()
        as_sent = {share: rough(sent, share) for share in shares}
        best_shares = sorted(shares, key=lambda share: as_sent[share].loss)[:_NUM_SPEEDS]
        roughs = [as_sent[share] for share in best_shares]
        roughs += [rough(profile, share) for profile in others for share in best_shares]
        roughs = sorted(roughs, key=lambda end: end.loss)[:_NUM_ENDS]
        ends = []
        for end in roughs:
            begin("the pictures themselves")
            start = _with_blur(end.values, -(_WIDTH**2))
            ends.append(self.solved(start, noise, self.near_sent()))
        return min(ends, key=lambda end: end.loss)


def _strength_and_place(profile: np.ndarray, is_edge: bool) -> tuple[float, float]:
    """Step of an edge or sum of a point, levels, and the place of a sharp edge or centroid, px."""
    left, right = float(np.mean(profile[:END])), float(np.mean(profile[-END:]))
    if is_edge:
        return right - left, float(np.sum((right - profile) / (right - left)))
    signal = profile - (left + right) / 2
    moment = np.sum(signal * (np.arange(signal.size) + 0.5))
    return float(np.sum(signal)), float(moment / np.sum(signal))


def _spline_means(count: int) -> np.ndarray:
    """Means of the B-splines over the exposure; shape `(count,)`."""
    knots = spline_knots(count)
    return (knots[4:] - knots[:-4]) / 8


def _moments(coefficients: np.ndarray) -> np.ndarray:
    r"""Means of $\tau$ and $\tau^2$, weighted by the transmittance; shape `(2,)`."""
    from scipy.interpolate import BSpline

    tau = (np.arange(2000) + 0.5) / 1000 - 1
    weight = BSpline(spline_knots(coefficients.size), coefficients, 3)(tau)
    return np.array([np.sum(weight * tau), np.sum(weight * tau**2)]) / np.sum(weight)


def _trace_samples(
    trace: Trace | None, half: float, count: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Levels of a trace, B-splines at their times, and the standard deviation of a level.

    Levels within the exposure come first, then those outside, where B-splines are 0.
    """
    if trace is None:
        return np.zeros(0), np.zeros((0, count)), 1.0
    profile = measured_profile(trace, half_exposure=half, closed=float(np.min(trace.level)))
    tau, levels = np.asarray(trace.time) / half, np.asarray(trace.level)
    is_inside = np.abs(tau) <= 1
    basis = spline_basis(tau[is_inside], count).toarray()
    dark = levels[~is_inside]
    rows = np.concatenate([basis, np.zeros((dark.size, count))])
    noise = profile.noise * (profile.opened - profile.closed)
    return np.concatenate([levels[is_inside], dark]), rows, noise


def _with_blur(values: np.ndarray, added: float) -> np.ndarray:
    """The same parameters with `added` variance of the lens, px^2, of which 0.3 px are left."""
    variance = max(float(values[3]) ** 2 + added, 0.3**2)
    return np.concatenate([values[:3], [np.sqrt(variance)], values[4:]])
