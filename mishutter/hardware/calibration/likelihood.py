r"""How likely measurements are of a camera, and the least squares that find the likeliest.

The likelihood is Poisson-Gaussian: each pixel has the variance of its own expected level, and
is fitted anew with what the last fit expects (iterated reweighting). Optimistix's
Levenberg-Marquardt minimises.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import compiled, require
from mishutter.blur import support
from mishutter.hardware.calibration.measurements import (
    END,
    Measurements,
    SensorLevels,
    TargetPicture,
)
from mishutter.hardware.calibration.response import FINE, MOVED, collected, kernels
from mishutter.hardware.traces import Trace, measured_profile
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    ParabolicMotion,
    SplineShutter,
)

_HOLD = 0.1
"""Standard deviation of the coefficients about what was sent, until it is known what is seen."""
_BELOW = 0.01
"""Standard deviation by which coefficients stray below 0, where no transmittance is.

A profile that opens with a step down gives nearly the pictures of one that opens with a step up,
on another stage.
"""
_MAX_STEPS = 30
_CHANGE = 1e-3
"""Change of every residual, in its noise, at which the minimiser ends.

It ends well above the rounding of the sum of squares, which would have steps refused in vain.
"""
_WIDTHS = (4.0, 2.0, 1.0)
"""Standard deviations of the Gaussians that smooth pictures for a start; px."""
_NUM_STARTS = 3
_LIKELIER = 9.0
"""Fall of the sum of squares from which a start goes before the camera that was sent: noise, or a
number that nothing tells, makes smaller ones."""
_LEAST_BLUR = 0.3
"""Blur of the lens from which a fit starts at least; px."""
_PIN = 1e3
"""What is pinned stays to a thousandth of its scale."""
_MARGIN = 1.3


class _Arrays(NamedTuple):
    """What the residuals depend on beside the parameters; one program serves all of a shape.

    Arrays of NumPy, which become those of the program.
    """

    levels: Any
    deviation: Any
    speeds: Any
    is_unknown: Any
    is_edge: Any
    half_exposure: Any
    scales: Any
    ties: Any
    tied: Any
    trace: Any
    trace_basis: Any
    trace_deviation: Any


@dataclass(frozen=True, eq=False)
class Setting:
    """Everything of a fit but its start: data, natural units of the parameters, what is pinned."""

    names: tuple[str, ...]
    arrays: _Arrays
    pins: "Ties"
    profiles: tuple[np.ndarray, ...]
    rounded: tuple[bool, ...]
    rows: tuple[int, ...]
    picture_names: tuple[str, ...]
    sensor: SensorLevels
    sent: ParabolicMotion
    coefficients: np.ndarray
    efficiency: float
    num_taps: int
    notes: tuple[str, ...]

    @staticmethod
    def of(
        given: Measurements, motion: AbstractMotion, shutter: AbstractShutter, count: int
    ) -> "Setting":
        pictures = given.pictures
        profiles = tuple(picture.profile(given.sensor) for picture in pictures)
        a, T, v = (float(getattr(motion, n)) for n in ("acceleration", "half_exposure", "velocity"))
        columns = {profile.size for profile in profiles}
        requirement = "have pictures of equally many columns"
        require(len(columns) == 1, "fit(measurements=...)", requirement, sorted(columns))
        unknown = np.array([picture.speed is None for picture in pictures])
        speeds = np.array([picture.speed or 0.0 for picture in pictures])
        fitted = SplineShutter.fit(shutter, count)
        coefficients = np.asarray(fitted.coefficients, np.float64)
        knots = spline_knots(count)
        integrals = (knots[4:] - knots[:-4]) / 8  # means of the B-splines over the exposure
        names = ["acceleration", "velocity", "speed", "lens blur"]
        names += [f"transmittance {k}" for k in range(count)]
        for k in range(len(pictures)):
            names += [f"position {k}", f"gain {k}", f"background {k}"]
        names += ["swing of the trace", "dark of the trace"]
        notes, pins, values = [], [], []

        def pin(name: str, value: float) -> None:
            pins.append(np.array([float(name == each) for each in names]))
            values.append(value)

        if not unknown.any():
            pin("speed", 0.0)
        elif unknown.all():
            pin("velocity", v / (2 * a * T))
            notes.append(
                "velocity and speed apart: only the speed over the sensor is seen where none is "
                "known (the velocity is taken as sent)"
            )
            if given.trace is None:
                notes.append(
                    "sign of the speed: the mirrored profile at the opposite speed gives the same"
                )
        sample, basis, noise = _trace_samples(given.trace, T, count)
        if given.trace is None:
            pin("swing of the trace", 0.0)
            pin("dark of the trace", 0.0)
        light = np.zeros(len(names))
        light[4 : 4 + count] = integrals
        pins.append(light)
        values.append(float(integrals @ coefficients))
        notes.append(
            "gain and transmittance apart: only their product is seen (the profile has the light "
            "that was sent)"
        )
        notes.append(
            "velocity and delay apart: only v - 2 a d is seen (the delay is that of a stage whose "
            "velocity is as sent)"
        )
        fastest = 2 * a * T + max(np.abs(speeds - v).max(), (0.7 * 2 * a * T) * unknown.any())
        sent = ParabolicMotion(acceleration=a, half_exposure=T, velocity=v)
        longest = float(support(sent, fastest - 2 * a * T + abs(v)))
        num_taps = int(np.ceil(_MARGIN * longest)) * FINE + 2 * FINE
        top = 2 * a * T
        scales = np.array([a, top, top, 1.0, *[1.0] * count])
        for picture, profile in zip(pictures, profiles, strict=True):
            gain = _gain(picture, profile) / float(integrals @ coefficients)
            unit = max(float(np.ptp(profile)), 1e-9)
            scales = np.append(scales, [a * T**2, gain, unit])
        swing = float(np.ptp(sample)) if sample.size else 1.0
        scales = np.append(scales, [swing, swing])
        arrays = _Arrays(
            levels=np.array(profiles),
            deviation=np.ones((len(pictures), profiles[0].size)),
            speeds=speeds,
            is_unknown=unknown,
            is_edge=np.array([picture.target == "edge" for picture in pictures]),
            half_exposure=np.asarray(T),
            scales=scales,
            ties=np.zeros((0, scales.size)),
            tied=np.zeros(0),
            trace=sample,
            trace_basis=basis,
            trace_deviation=np.asarray(noise),
        )
        return Setting(
            tuple(names),
            arrays,
            Ties(_PIN * np.array(pins), _PIN * np.array(values)),
            profiles,
            tuple(picture.is_rounded for picture in pictures),
            tuple(len(picture.levels) for picture in pictures),
            tuple(picture.name for picture in pictures),
            given.sensor,
            sent,
            coefficients,
            float(integrals @ coefficients),
            num_taps,
            tuple(notes),
        )

    def noise(self, expected: np.ndarray) -> np.ndarray:
        """Standard deviation of rows' means about expected levels; shape `(pictures, columns)`."""
        each = zip(expected, self.rounded, self.rows, strict=True)
        variances = [self.sensor.variance(row, known) / count for row, known, count in each]
        return np.sqrt(variances)

    def residuals(self, values: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """What data and pins say of parameters, over its noise."""
        rows, aims = self.pins
        arrays = self.arrays._replace(deviation=noise, ties=rows, tied=aims)
        return self.without_bounds(_compiled_residuals(values, arrays, self.num_taps))

    def without_bounds(self, rows: Array | np.ndarray) -> np.ndarray:
        """Rows of residuals, or of their derivatives, but those of coefficients below 0."""
        first = self.arrays.levels.size + self.arrays.trace.size
        return np.delete(np.asarray(rows), first + np.arange(len(self.coefficients)), axis=0)

    @property
    def is_pinned(self) -> np.ndarray:
        """Whether each parameter is pinned by itself."""
        return np.any(np.abs(self.pins.rows) == _PIN, axis=0)

    def smoothed(self, width: float) -> "Setting":
        """The same of pictures behind one more Gaussian lens; px."""
        from scipy.ndimage import gaussian_filter1d

        levels = gaussian_filter1d(self.arrays.levels, width, axis=1, mode="nearest")
        return replace(self, arrays=self.arrays._replace(levels=levels))

    def near_sent(self) -> "Ties":
        """Coefficients tied to those that were sent."""
        rows = np.eye(len(self.names))[4 : 4 + len(self.coefficients)]
        return Ties(rows / _HOLD, self.coefficients / _HOLD)

    def delay(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        """Delay of a stage whose velocity is as sent, and its derivatives; s."""
        scales = np.asarray(self.arrays.scales)
        a, v = (values * scales)[:2]
        late = (float(self.sent.velocity) - v) / (2 * a)
        slopes = np.zeros(values.size)
        slopes[:2] = np.array([-late / a, -1 / (2 * a)]) * scales[:2]
        return float(late), slopes

    def start(self, share: float) -> np.ndarray:
        """Parameters as sent, with positions that bring the light where it was recorded."""
        count = len(self.coefficients)
        velocity = float(self.sent.velocity) / float(self.arrays.scales[1])
        start = np.concatenate([[1.0, velocity, share, 0.5], self.coefficients])
        for k, profile in enumerate(self.profiles):
            unit = float(self.arrays.scales[4 + count + 3 * k + 2])
            start = np.append(start, [0.0, 1.0, float(np.mean(profile[:END])) / unit])
        trace = np.asarray(self.arrays.trace)
        swing = float(self.arrays.scales[-1])
        low = float(np.min(trace)) / swing if trace.size else 0.0
        start = np.append(start, [1.0, low] if trace.size else [0.0, 0.0])
        if not np.asarray(self.arrays.is_unknown).any():
            start[2] = 0.0
        x = start * np.asarray(self.arrays.scales)
        unknown = np.asarray(self.arrays.is_unknown)
        relative = np.where(unknown, x[2], np.asarray(self.arrays.speeds)) - x[1]
        drift, stretch = _moments(self.coefficients) * float(self.sent.half_exposure) ** np.arange(
            1, 3
        )
        for k, profile in enumerate(self.profiles):
            path = x[0] * stretch - relative[k] * drift
            place = _middle(profile, bool(self.arrays.is_edge[k])) - path
            start[4 + count + 3 * k] = place / float(self.arrays.scales[4 + count + 3 * k])
        return start


def _middle(profile: np.ndarray, is_edge: bool) -> float:
    """Centroid of a point's light, or the position of an edge that has as much; px."""
    left, right = float(np.mean(profile[:END])), float(np.mean(profile[-END:]))
    if is_edge:
        return float(np.sum((right - profile) / (right - left)))
    light = profile - (left + right) / 2
    return float(np.sum(light * (np.arange(light.size) + 0.5)) / np.sum(light))


def _gain(picture: TargetPicture, profile: np.ndarray) -> float:
    """Light of a target in a picture: the sum of a point's, the step of an edge; levels."""
    left, right = float(np.mean(profile[:END])), float(np.mean(profile[-END:]))
    return right - left if picture.target == "edge" else float(np.sum(profile - (left + right) / 2))


def spline_knots(count: int) -> np.ndarray:
    """Knots of a cubic spline of so many coefficients on [-1, 1]; shape `(count + 4,)`."""
    return np.concatenate([[-1.0] * 3, np.linspace(-1, 1, count - 2), [1.0] * 3])


def _moments(coefficients: np.ndarray) -> np.ndarray:
    r"""Means of $\tau$ and $\tau^2$ over the light of a profile; shape `(2,)`."""
    from scipy.interpolate import BSpline

    tau = (np.arange(2000) + 0.5) / 1000 - 1
    weight = BSpline(spline_knots(coefficients.size), coefficients, 3)(tau)
    return np.array([np.sum(weight * tau), np.sum(weight * tau**2)]) / np.sum(weight)


def _trace_samples(
    trace: Trace | None, half: float, count: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Samples of a trace within the exposure, B-splines there, and their noise."""
    from scipy.interpolate import BSpline

    if trace is None:
        return np.zeros(0), np.zeros((0, count)), 1.0
    found = measured_profile(trace, half_exposure=half, closed=float(np.min(trace.level)))
    tau = np.asarray(trace.time) / half
    inside = np.abs(tau) <= 1
    basis = BSpline.design_matrix(tau[inside], spline_knots(count), 3).toarray()
    dark = np.asarray(trace.level)[~inside]
    rows = np.concatenate([basis, np.zeros((dark.size, count))])
    noise = found.noise * (found.opened - found.closed)
    return np.concatenate([np.asarray(trace.level)[inside], dark]), rows, noise


def _expected(values: Array, arrays: _Arrays, num_taps: int) -> Array:
    """Levels that parameters, in their natural units, give; shape `(pictures, columns)`."""
    x = values * arrays.scales
    a, v, speed, blur = x[:4]
    num_pictures, num_columns = arrays.levels.shape
    count = x.size - 6 - 3 * num_pictures
    coefficients = x[4 : 4 + count]
    position, gain, background = x[4 + count : -2].reshape(num_pictures, 3).T
    relative = jnp.where(arrays.is_unknown, speed, arrays.speeds) - v
    taps = kernels(coefficients, a, arrays.half_exposure, relative, num_taps)
    begin = position - relative**2 / (4 * a) - MOVED / FINE
    light = collected(taps, begin, blur, arrays.is_edge, num_columns)
    return background[:, None] + gain[:, None] * light


def _residuals(values: Array, arrays: _Arrays, num_taps: int) -> Array:
    expected = _expected(values, arrays, num_taps)
    x = values * arrays.scales
    count = arrays.trace_basis.shape[1]
    shown = x[-2] * (arrays.trace_basis @ x[4 : 4 + count]) + x[-1]
    return jnp.concatenate(
        [
            jnp.ravel((expected - arrays.levels) / arrays.deviation),
            (shown - arrays.trace) / arrays.trace_deviation,
            jnp.minimum(x[4 : 4 + count], 0) / _BELOW,
            arrays.ties @ values - arrays.tied,
        ]
    )


@compiled
def _compiled_residuals(values: Any, arrays: _Arrays, num_taps: int) -> Array:
    return _residuals(values, arrays, num_taps)


@eqx.filter_jit
def _linearised(values: Array, arrays: _Arrays, num_taps: int) -> tuple[Array, Array]:
    """Residuals and their Jacobian.

    Each picture has three numbers of its own, and the trace has two: they move together, in three
    directions, as each moves its own rows alone.
    """
    own = partial(_residuals, arrays=arrays, num_taps=num_taps)
    residual, derivative = jax.linearize(own, values)
    num_pictures, num_columns = arrays.levels.shape
    shared = values.size - 3 * num_pictures - 2
    direction = np.append(np.arange(shared), shared + np.arange(3 * num_pictures + 2) % 3)
    directions = np.arange(shared + 3)[:, None] == direction[None]
    moved = jax.vmap(derivative, out_axes=1)(jnp.asarray(directions, values.dtype))
    of_number = np.append(np.full(shared, -1), np.arange(3 * num_pictures + 2) // 3)
    of_row = np.repeat(np.arange(num_pictures), num_columns)
    of_row = np.append(of_row, np.full(arrays.trace.size, num_pictures))
    of_row = np.append(of_row, np.full(arrays.trace_basis.shape[1], num_pictures + 1))
    is_moved = (of_number[None] == -1) | (of_number[None] == of_row[:, None])
    of_data = jnp.where(is_moved, moved[: of_row.size, direction], 0)
    return residual, jnp.concatenate([of_data, arrays.ties])


@eqx.filter_custom_jvp
def _known_by_matrix(values: Array, *, arrays: _Arrays, num_taps: int) -> Array:
    """Residuals whose derivative is a product with their Jacobian.

    The minimiser asks for it in three places, and would compile the kernel's derivative in each.
    """
    return _residuals(values, arrays, num_taps)


@_known_by_matrix.def_jvp
def _by_matrix(
    primals: tuple[Array], tangents: tuple[Array], *, arrays: _Arrays, num_taps: int
) -> tuple[Array, Array]:
    residual, matrix = _linearised(*primals, arrays, num_taps)
    return residual, matrix @ tangents[0]


@compiled
def _least_squares(start: Any, arrays: _Arrays, num_taps: int) -> tuple[Array, Array, Array]:
    """Parameters, the residuals and their Jacobian where the minimiser ends."""
    import optimistix as optx

    def residuals(values: Array, arrays: _Arrays) -> Array:
        return _known_by_matrix(values, arrays=arrays, num_taps=num_taps)

    solver = optx.LevenbergMarquardt(rtol=_CHANGE, atol=_CHANGE)
    solution = optx.least_squares(
        residuals, solver, start, arrays, max_steps=_MAX_STEPS, throw=False
    )
    known = solution.state.f_info
    return solution.value, known.residual, known.jac.as_matrix()


class Ties(NamedTuple):
    """Combinations of parameters and what they are tied to, both over how far they may stray.

    Attributes:
        rows: Shape `(k, parameters)`.
        aims: Shape `(k,)`.
    """

    rows: np.ndarray
    aims: np.ndarray


class Solution(NamedTuple):
    """Where a round ends.

    Attributes:
        loss: Sum of squares, of the ties and bounds too.
        values: Parameters.
        residual: Of what data and pins say.
        matrix: Its derivatives.
        expected: Levels.
        noise: Their standard deviations.
    """

    loss: float
    values: np.ndarray
    residual: np.ndarray
    matrix: np.ndarray
    expected: np.ndarray
    noise: np.ndarray


def solved(
    setting: Setting,
    values: np.ndarray,
    noise: np.ndarray,
    ties: Ties,
    pull: tuple[np.ndarray, float] | None = None,
) -> Solution:
    """One round of a fit.

    Args:
        setting: What is fitted.
        values: Where the round starts.
        noise: Standard deviations of the levels.
        ties: At most as many as there are parameters.
        pull: One more tie, whose square is no part of the loss.
    """
    rows = np.zeros((values.size + 1, values.size))
    aims = np.zeros(values.size + 1)
    rows[: len(ties.rows)], aims[: len(ties.rows)] = ties
    if pull is not None:
        rows[-1], aims[-1] = pull
    arrays = setting.arrays._replace(
        deviation=noise,
        ties=np.concatenate([setting.pins.rows, rows]),
        tied=np.concatenate([setting.pins.aims, aims]),
    )
    ended = _least_squares(values, arrays, setting.num_taps)
    values, residual, matrix = (np.asarray(each) for each in ended)
    levels = np.asarray(arrays.levels)
    expected = levels + residual[: levels.size].reshape(levels.shape) * noise
    loss = float(np.sum(residual[:-1] ** 2))
    residual, matrix = (setting.without_bounds(x)[: -len(rows)] for x in (residual, matrix))
    return Solution(loss, values, residual, matrix, expected, noise)


def likeliest_start(setting: Setting, shares: Sequence[float]) -> Solution:
    """The best of several first rounds, in which the profile is held near the one that was sent.

    A picture shows a jump of the profile as a step at a place of its own, and a camera whose
    steps lie where some pictures have them, but not all, is a minimum. Smoothed pictures have
    fewer of these; but the more they are smoothed, the farther their camera is from the right
    one. First rounds therefore start at fits of pictures smoothed by several widths, and one at
    the camera that was sent.

    Args:
        setting: What is fitted.
        shares: Normalised speeds from which a fit of an unknown one starts. The best three of the
            first width go on to the others.
    """
    noise, near = setting.noise(np.asarray(setting.arrays.levels)), setting.near_sent()
    first_round = partial(solved, noise=noise, ties=near)
    starts, ends = [setting.start(share) for share in shares], []
    for width in _WIDTHS:
        smooth = setting.smoothed(width)
        tried = [first_round(smooth, _with_blur(start, width**2)) for start in starts]
        order = np.argsort([each.loss for each in tried])
        ends.append(first_round(setting, _with_blur(tried[order[0]].values, -(width**2))))
        starts = [starts[k] for k in order[:_NUM_STARTS]]
    sent = first_round(setting, starts[0])
    best = min(ends, key=lambda each: each.loss)
    return best if best.loss < sent.loss - _LIKELIER else sent


def _with_blur(values: np.ndarray, added: float) -> np.ndarray:
    """Parameters whose lens has a variance that is greater by so much; px^2."""
    variance = max(float(values[3]) ** 2 + added, _LEAST_BLUR**2)
    return np.concatenate([values[:3], [np.sqrt(variance)], values[4:]])
