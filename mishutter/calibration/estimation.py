r"""A camera as it was built, by weighted least squares through the exact kernel.

The likelihood is Poisson-Gaussian: each pixel has the variance of its own expected level, and
is fitted anew with what the last fit expects (iterated reweighting). Optimistix's
Levenberg-Marquardt minimises. The information matrix of the last step gives the error bars, and
its directions of almost no information say what the measurements do not see. Where it does not
hold as far as two error bars, they are those of the profile likelihood.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import Bare, compiled, require, require_positive_int
from mishutter.blur import support
from mishutter.calibration.measurements import END, Measurements, SensorLevels, TargetPicture
from mishutter.calibration.response import FINE, collected, kernels
from mishutter.design import Design, Trace, given_design, measured_profile
from mishutter.model import (
    CORNER_FREQUENCY,
    NUM_FREQUENCIES,
    AbstractMotion,
    AbstractShutter,
    Limits,
    ParabolicMotion,
    Scene,
    SplineShutter,
    frequencies,
    scene_text,
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
_PIN = 1e3
"""What is pinned stays to a thousandth of its scale."""
_RANGE = 12**-0.5
"""Standard deviation of a number anywhere from 0 to 1: how far what is not seen may stray."""
_MAX_ENDS = 3
"""How often a fit goes on from a lower end that a pull has found."""
_STRAIGHT = 0.5
"""Departure of the residuals from what derivatives say, two error bars off, that is none.

It moves an error bar by a quarter at most, and by far less where it is spread over the levels.
"""
_SAME = 0.01
"""Rise of chi squared by which an end of the minimiser is no better than another."""
_SPEEDS = tuple(0.1 * k for k in range(-6, 7))
"""Normalised speeds from which a fit of an unknown one starts."""
_LEAST_STROKE = 1.0
_MARGIN = 1.3


class Estimate(NamedTuple):
    """A number with its error bar.

    Attributes:
        value: The number.
        error: Standard deviation by the Fisher information; infinite of what is not seen.
    """

    value: float
    error: float


@dataclass(frozen=True, eq=False)
class FittedCamera:
    """A camera as built.

    Attributes:
        motion: The stage's motion, on the camera's clock.
        shutter: The transmittance.
        coefficients: Its B-spline coefficients before they are held to [0, 1]; shape `(n,)`.
        coefficient_errors: Their error bars; shape `(n,)`.
        estimates: The other numbers by name, with their units in the name.
        not_identifiable: What the measurements do not see, in sentences.
        levels: Rows' means of each picture.
        expected: The levels that the fitted camera gives.
        noise: Standard deviations of the levels.
        chi_squared: Sum of squares over noise, of `num_levels` levels.
        num_free: How many parameters the measurements determine.
    """

    motion: ParabolicMotion
    shutter: SplineShutter
    coefficients: np.ndarray
    coefficient_errors: np.ndarray
    estimates: dict[str, Estimate]
    not_identifiable: tuple[str, ...]
    names: tuple[str, ...]
    levels: tuple[np.ndarray, ...]
    expected: tuple[np.ndarray, ...]
    noise: tuple[np.ndarray, ...]
    chi_squared: float
    num_free: int

    @property
    def lens_blur(self) -> float:
        """Standard deviation of the lens's Gaussian; px."""
        return self.estimates["lens_blur_px"].value

    @property
    def reduced_chi_squared(self) -> float:
        """Sum of squares over noise for each level that is free; near 1 of a model that holds."""
        count = sum(row.size for row in self.levels)
        return self.chi_squared / max(count - self.num_free, 1)

    def band(self, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The profile less and plus two error bars, which are at most 1; shapes of `tau`."""
        from scipy.interpolate import BSpline

        count = self.coefficients.size
        basis = BSpline.design_matrix(np.asarray(tau), _knots(count), 3).toarray()
        errors = np.minimum(self.coefficient_errors, 1.0)
        middle, reach = basis @ self.coefficients, 2 * (basis @ errors)
        return middle - reach, middle + reach

    def seen_through_lens(self, scene: Scene) -> Scene:
        r"""The scene as the lens passes it: its spectrum times $e^{-4\pi^2\sigma^2 f^2}$."""
        return through_lens(scene, self.lens_blur)

    def design(self, scene: Scene) -> Design:
        """The camera as built, as a design like any other, on a scene through its lens."""
        seen = self.seen_through_lens(scene)
        outcome = "Fitted to measurements."
        return given_design(seen, self.motion, self.shutter, outcome, is_measured=True)

    def scene_text(self, scene: Scene) -> str:
        """The text of a scene file with the motion that was found, ready for `optimise`.

        Limits are widened to hold it. Comments say each error bar, and what no key says: the
        lens, of which a scene with a photograph knows nothing, and the profile.
        """
        limits, wider = _limits_with(scene.limits, self.motion)
        built = eqx.tree_at(lambda s: s.limits, scene, limits)
        nothing = {"is_leaf": lambda leaf: leaf is None}
        built = eqx.tree_at(lambda s: s.given_motion, built, self.motion, **nothing)
        said = {
            name: f"{name} = {each.value:.6g} +- {each.error:.2g}"
            for name, each in self.estimates.items()
            if not name.rpartition("_")[2].isdigit()  # numbers of a single picture
        }
        notes = {
            "": [
                "A camera as it was built: [motion], from measurements; numbers with error bars.",
                *(f"Not identifiable: {line}." for line in self.not_identifiable),
            ],
            "optics": [
                said.pop("lens_blur_px"),
                "That Gaussian blur has no key; pictures lack it.",
            ],
            "shutter": [
                "As in the scene: what was built of it is a profile, in the design's file."
            ],
            "limits": [f"Wider than the scene's, as the camera was: {', '.join(wider)}."]
            * any(wider),
            "motion": list(said.values()),
        }
        return scene_text(built, notes)

    def to_dict(self) -> dict[str, Any]:
        """What was found, as plain numbers and text."""
        return {
            "estimates": {name: each._asdict() for name, each in self.estimates.items()},
            "transmittance": self.coefficients.tolist(),
            "transmittance_errors": self.coefficient_errors.tolist(),
            "not_identifiable": list(self.not_identifiable),
            "reduced_chi_squared": self.reduced_chi_squared,
        }


def _limits_with(limits: Limits, motion: ParabolicMotion) -> tuple[Limits, list[str]]:
    """Limits that hold a motion, and the names of those that are wider for it."""
    a, half, v = motion.acceleration, motion.half_exposure, motion.velocity
    margin = 1 + 8 * float(np.finfo(a.dtype).eps)
    own = {field.name: getattr(limits, field.name) for field in fields(limits)}
    own.pop("frame_velocity")

    def widened(own: dict[str, Any], **least: Any) -> dict[str, Any]:
        known = {name: each for name, each in least.items() if own[name] is not None}
        return own | {n: each * margin for n, each in known.items() if float(each) > float(own[n])}

    pan, top = jnp.abs(v), motion.top_speed
    wide = widened(
        own, max_stroke=motion.stroke, max_top_speed=top, max_pan=pan, max_acceleration=2 * a
    )
    if limits.has_stage:
        share = float(Limits(**wide).stage_share(a, half, v))
        grown = {"max_travel": limits.max_travel}
        if limits.max_jerk is not None:
            grown["max_top_speed"] = wide["max_top_speed"]
        known = {name: each * share for name, each in grown.items() if each is not None}
        wide = widened(wide, **known)
    return Limits(**wide), [name for name in own if wide[name] is not own[name]]


def through_lens(scene: Scene, blur: float) -> Scene:
    r"""A scene as a Gaussian lens passes it: its spectrum times $e^{-4\pi^2\sigma^2 f^2}$.

    The scene's photograph, which is sharp, is left out.
    """
    known = scene.power_spectrum
    f = frequencies(NUM_FREQUENCIES if known is None else known.size)
    power = 1 / (f**2 + CORNER_FREQUENCY**2) if known is None else np.asarray(known, np.float64)
    passed = power * np.exp(-4 * np.pi**2 * blur**2 * f**2)
    seen = scene.bare(power_spectrum=passed)
    deviation = scene.deviation * float(np.sqrt(np.sum(passed) / np.sum(power)))
    seen = eqx.tree_at(lambda s: s.deviation, seen, deviation)
    others = (scene.burst, scene.stage, scene.given_motion)
    nothing = {"is_leaf": lambda leaf: leaf is None}
    return eqx.tree_at(lambda s: (s.burst, s.stage, s.given_motion), seen, others, **nothing)


def fit(
    measurements: Measurements | Sequence[TargetPicture],
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    sensor: SensorLevels | None = None,
    trace: Trace | None = None,
    num_coefficients: int = 12,
) -> FittedCamera:
    r"""The camera as built, from pictures of points or edges and a trace of its shutter.

    Found are $a$ and $v$ of the stage on the camera's clock, the transmittance as a spline on the
    exposure, the Gaussian blur of the lens, and the position, gain and background of each
    picture. A stage that follows late by $d$ has $v - 2 a d$ for its velocity: a delay is that
    of a stage whose velocity is as sent. Gains and the profile's scale are seen as a product, and
    the profile is given the light of `shutter`, unless the trace is of known levels.

    Args:
        measurements: Pictures, or what `read_measurements` gives.
        motion: The motion as sent, from which the fit starts, of a stroke of 1 px at least.
        shutter: The profile as sent, as light would see it.
        sensor: How levels come from electrons; electrons without noise of reading by default.
        trace: A photodiode's levels, on the camera's clock.
        num_coefficients: Coefficients of the profile.

    Returns:
        The camera, error bars, what is not identifiable, and residuals.

    Raises:
        ValueError: if a picture is saturated or shows no target, the acceleration comes out at
            less than half or more than twice that sent, or an argument is out of its range.
    """
    given = _measurements(measurements, sensor, trace)
    require_positive_int("fit(num_coefficients=...)", num_coefficients)
    require(num_coefficients >= 4, "fit(num_coefficients=...)", "be at least 4", num_coefficients)
    stroke = float(motion.stroke)
    requirement = f"have a stroke of at least {_LEAST_STROKE:g} px"
    require(stroke >= _LEAST_STROKE, "fit(motion=...)", requirement, Bare(f"{stroke:g} px"))
    setting = _Setting.of(given, motion, shutter, num_coefficients)
    unknown = any(picture.speed is None for picture in given.pictures)
    levels = np.asarray(setting.arrays.levels)
    starts = map(setting.start, _SPEEDS if unknown else (0.0,))
    near = setting.near_sent()
    ends = [_solved(setting, start, setting.noise(levels), near) for start in starts]
    best = min(ends, key=lambda each: each.loss)
    best = _solved(setting, best.values, setting.noise(best.expected), near)
    best, bars = _error_bars(setting, best)
    share = float(best.values[0])
    requirement = "show a camera like the one that was sent"
    got = Bare(f"{share:.3g} times its acceleration")
    require(0.5 < share < 2, "fit(measurements=...)", requirement, got)
    return _camera(setting, best, bars)


def _measurements(
    given: Measurements | Sequence[TargetPicture], sensor: SensorLevels | None, trace: Trace | None
) -> Measurements:
    if isinstance(given, Measurements):
        return given
    pictures = tuple(given)
    right = bool(pictures) and all(isinstance(p, TargetPicture) for p in pictures)
    require(right, "fit(measurements=...)", "hold at least one `TargetPicture`", given)
    return Measurements(pictures, sensor or SensorLevels(), trace)


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
class _Setting:
    """Everything of a fit but its start: data, natural units of the parameters, what is pinned."""

    names: tuple[str, ...]
    arrays: _Arrays
    pins: "_Ties"
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
    ) -> "_Setting":
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
        knots = _knots(count)
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
        return _Setting(
            tuple(names),
            arrays,
            _Ties(_PIN * np.array(pins), _PIN * np.array(values)),
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

    def near_sent(self) -> "_Ties":
        """Coefficients tied to those that were sent."""
        rows = np.eye(len(self.names))[4 : 4 + len(self.coefficients)]
        return _Ties(rows / _HOLD, self.coefficients / _HOLD)

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


def _knots(count: int) -> np.ndarray:
    return np.concatenate([[-1.0] * 3, np.linspace(-1, 1, count - 2), [1.0] * 3])


def _moments(coefficients: np.ndarray) -> np.ndarray:
    r"""Means of $\tau$ and $\tau^2$ over the light of a profile; shape `(2,)`."""
    from scipy.interpolate import BSpline

    tau = (np.arange(2000) + 0.5) / 1000 - 1
    weight = BSpline(_knots(coefficients.size), coefficients, 3)(tau)
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
    basis = BSpline.design_matrix(tau[inside], _knots(count), 3).toarray()
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
    begin = position - relative**2 / (4 * a) - 1 / FINE
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


class _Ties(NamedTuple):
    """Combinations of parameters and what they are tied to, both over how far they may stray.

    Attributes:
        rows: Shape `(k, parameters)`.
        aims: Shape `(k,)`.
    """

    rows: np.ndarray
    aims: np.ndarray


class _Solution(NamedTuple):
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


def _solved(
    setting: _Setting,
    values: np.ndarray,
    noise: np.ndarray,
    ties: _Ties,
    pull: tuple[np.ndarray, float] | None = None,
) -> _Solution:
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
    return _Solution(loss, values, residual, matrix, expected, noise)


@dataclass(frozen=True, eq=False)
class _Bars:
    """Error bars of the parameters, in their own scales, and of the delay.

    Attributes:
        errors: Of each parameter, infinite where it is blind; shape `(n,)`.
        delay: Of the delay; s.
        blind: Directions of almost no information; shape `(k, n)`.
    """

    errors: np.ndarray
    delay: float
    blind: np.ndarray


def _error_bars(setting: _Setting, solution: _Solution) -> tuple[_Solution, _Bars]:
    r"""The last round of a fit, in which nothing that is seen is tied, and error bars at its end.

    The information matrix tells how $\chi^2$ rises nearby. Farther off it rises otherwise where
    information depends on what was found: a jump of the profile at an end of the exposure tells
    the stage from the shutter the better the higher it is. Each number of the camera is therefore
    pulled either way, everything else following, until $\chi^2$ is about 4 higher. With $\theta$
    there, an error bar is at least $|\theta - \hat\theta|/\sqrt{\Delta\chi^2}$ (the profile
    likelihood's, of the farther side), and no end of less than 1 more lies outside it.
    """
    noise = setting.noise(solution.expected)
    _, unseen = _information(solution.matrix)
    ties = _Ties(unseen / _RANGE, unseen @ solution.values / _RANGE)
    values, best, ends = solution.values, solution, []
    for _ in range(_MAX_ENDS):
        best = _solved(setting, values, noise, ties)
        ends = _pulled(setting, best, ties)
        lowest = min(ends, key=lambda each: each.loss, default=best)
        if lowest.loss >= best.loss - _SAME:
            break
        values = lowest.values
    everything, blind = _information(best.matrix)
    seen, _ = _information(np.concatenate([best.matrix, ties.rows]))
    late, slopes = setting.delay(best.values)
    numbers = np.concatenate([np.eye(best.values.size), slopes[None]])
    linear, total = (
        np.einsum("ij,jk,ik->i", numbers, each, numbers) for each in (seen, everything)
    )
    bars = np.sqrt(linear)
    for end in ends:
        away = np.append(end.values - best.values, setting.delay(end.values)[0] - late)
        bars = np.maximum(bars, np.abs(away) / np.sqrt(max(end.loss - best.loss, 1.0)))
    *errors, delay = np.sqrt(bars**2 + np.maximum(total - linear, 0))
    return best, _Bars(np.array(errors), float(delay), blind)


def _pulled(setting: _Setting, best: _Solution, ties: _Ties) -> list[_Solution]:
    """Ends of pulls by 4 error bars on each number of the camera, against its own bar.

    Where information does not change, a pull ends half-way. If residuals there are what
    derivatives say, Fisher's error bar stands, and there is no pull. It starts there, or at the
    best fit where that is nearer to its end.
    """
    everything, _ = _information(best.matrix)
    covariance, _ = _information(np.concatenate([best.matrix, ties.rows]))
    is_pinned = np.any(np.abs(setting.pins.rows) == _PIN, axis=0)
    is_own = np.arange(best.values.size) < 4 + len(setting.coefficients)
    is_told = np.diag(everything) <= _WIDEST**2
    ends = []
    for k in np.flatnonzero(is_own & is_told & ~is_pinned):
        row = np.eye(best.values.size)[k] / np.sqrt(covariance[k, k])
        for side in (-2, 2):
            away = side * covariance @ row
            there = setting.residuals(best.values + away, best.noise)
            if np.linalg.norm(there - best.residual - best.matrix @ away) > _STRAIGHT:
                pull = row, float(row @ best.values) + 2 * side
                is_nearer = np.sum(there**2) + 2**2 < np.sum(best.residual**2) + 4**2
                start = best.values + away * is_nearer
                ends.append(_solved(setting, start, best.noise, ties, pull))
    return ends


def _camera(setting: _Setting, solution: _Solution, bars: _Bars) -> FittedCamera:
    values, expected, noise = solution.values, solution.expected, solution.noise
    count = len(setting.coefficients)
    scales = np.asarray(setting.arrays.scales)
    is_blind = bars.errors > _WIDEST
    errors = np.where(is_blind, np.inf, bars.errors * scales)
    if np.all(setting.arrays.is_unknown):
        errors[1] = np.inf  # the velocity is taken as sent
    found = values * scales
    a, v = found[0], found[1]
    estimates = {
        "acceleration_px_per_s2": Estimate(a, errors[0]),
        "velocity_px_per_s": Estimate(v, errors[1]),
        "lens_blur_px": Estimate(abs(found[3]), errors[3]),
    }
    late, _ = setting.delay(values)
    own = bars.delay if np.isfinite(errors[:2]).all() else np.inf
    estimates["delay_ms"] = Estimate(late * 1e3, own * 1e3)
    if np.asarray(setting.arrays.is_unknown).any():
        estimates["speed_px_per_s"] = Estimate(found[2], errors[2])
    for k in range(len(setting.profiles)):
        for j, what in enumerate(("position_px", "gain", "background")):
            place = 4 + count + 3 * k + j
            estimates[f"{what}_{k}"] = Estimate(found[place], errors[place])
    levels = tuple(setting.profiles)
    chi = float(np.sum(((expected - np.array(levels)) / noise) ** 2))
    num_pins = len(setting.pins.rows)
    coefficients = found[4 : 4 + count]
    half = setting.sent.half_exposure
    return FittedCamera(
        motion=ParabolicMotion(acceleration=a, half_exposure=half, velocity=v),
        shutter=SplineShutter(np.clip(coefficients, 0, 1)),
        coefficients=coefficients,
        coefficient_errors=errors[4 : 4 + count],
        estimates={name: Estimate(float(e.value), float(e.error)) for name, e in estimates.items()},
        not_identifiable=(*setting.notes, *_said(is_blind, bars.blind, setting.names, count)),
        names=setting.picture_names,
        levels=levels,
        expected=tuple(expected),
        noise=tuple(noise),
        chi_squared=chi,
        num_free=values.size - num_pins,
    )


def _information(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance by the Fisher information, in the parameters' own scales, and blind directions.

    A direction in which the error bar exceeds a third of that scale is blind. What is not seen at
    all is given three of it, ten of its range, so that it does not spread to what is seen.
    """
    _, singular, directions = np.linalg.svd(matrix, full_matrices=False)
    bars = directions / np.maximum(singular, _LEAST_SEEN)[:, None]
    return bars.T @ bars, directions[singular <= 1 / _WIDEST]


_LEAST_SEEN = 1 / 3
_WIDEST = 1 / 3
"""Error bar of a parameter that is told, at most, in its own scale."""
_TAKES_PART = 0.05
"""Share of a blind direction above which the profile takes part in it."""


def _said(is_blind: np.ndarray, blind: np.ndarray, names: tuple[str, ...], count: int) -> list[str]:
    """Sentences for the parameters that no error bar tells from nothing."""
    profile = is_blind[4 : 4 + count]
    said = [name for k, name in enumerate(names) if is_blind[k] and not 4 <= k < 4 + count]
    sentences = [f"{name}: not told by what was recorded" for name in said]
    if profile.any():
        which = ", ".join(str(k) for k in np.flatnonzero(profile))
        parts = blind[:, 4 : 4 + count]
        parts = parts[np.any(np.abs(parts) > _TAKES_PART, axis=1)]
        even = np.linalg.norm(parts + parts[:, ::-1])
        sentences.append(
            f"transmittance: {f'{len(parts)} combinations of ' * bool(len(parts))}the coefficients "
            f"{which}" + ", only w(t) + w(-t) is seen" * bool(even < 0.2 * np.linalg.norm(parts))
        )
    return sentences
