"""A camera as it was built, fitted to what it recorded."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from mishutter._core import Bare, as_float, fields_text, require, require_positive_int
from mishutter.hardware.calibration.likelihood import (
    Setting,
    Solution,
    likeliest_start,
    solved,
    spline_knots,
)
from mishutter.hardware.calibration.measurements import Measurements, SensorLevels, TargetPicture
from mishutter.hardware.calibration.uncertainty import WIDEST, ErrorBars, error_bars
from mishutter.hardware.design import Design, given_design
from mishutter.hardware.traces import Trace
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    Limits,
    ParabolicMotion,
    Scene,
    SplineShutter,
    require_scene,
    scene_text,
)

_SPEEDS = tuple(0.1 * k for k in range(-6, 7))
"""Normalised speeds from which a fit of an unknown one starts."""
_LEAST_STROKE = 1.0
_IMPLAUSIBLE = 0.003
"""Share of right fits whose residuals are that great, or that small, below which one is doubted."""


class Estimate(NamedTuple):
    """A number with its error bar.

    Attributes:
        value: The number.
        error: Standard deviation, as `mishutter.hardware.calibration.uncertainty` derives it;
            infinite where the measurements do not show the number.
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

    def __repr__(self) -> str:
        """One line, without the levels of each picture."""
        return fields_text(self)

    @property
    def _num_degrees(self) -> int:
        return max(sum(row.size for row in self.levels) - self.num_free, 1)

    @property
    def lens_blur(self) -> float:
        """Standard deviation of the lens's Gaussian; px."""
        return self.estimates["lens_blur_px"].value

    @property
    def reduced_chi_squared(self) -> float:
        """Sum of squares over noise for each level that is free; near 1 of a model that holds."""
        return self.chi_squared / self._num_degrees

    @property
    def chance(self) -> float:
        """Share of right fits in which noise alone leaves a greater sum of squares."""
        from scipy.stats import chi2

        return float(chi2.sf(self.chi_squared, self._num_degrees))

    @property
    def doubt(self) -> str | None:
        """Why residuals are implausible, and what to try; None where they may be noise."""
        reduced = self.reduced_chi_squared
        if self.chance < _IMPLAUSIBLE:
            each = zip(self.levels, self.expected, self.noise, strict=True)
            squares = [float(np.mean(((row - mean) / noise) ** 2)) for row, mean, noise in each]
            worst = int(np.argmax(squares))
            return (
                f"residuals are implausibly large: chi squared for each free level is "
                f"{reduced:.3g}, which noise alone exceeds in {self.chance:.1g} of fits, and "
                f"{squares[worst]:.3g} in {self.names[worst]}. The numbers may be wrong by many "
                "error bars. Check the speeds and their signs, the half exposure and the sensor's "
                "electrons per level, read noise and black level; then try more coefficients, a "
                "trace, a design nearer to the camera, or one picture fewer"
            )
        if 1 - self.chance < _IMPLAUSIBLE:
            return (
                f"residuals are implausibly small: chi squared for each free level is "
                f"{reduced:.3g}. Error bars are too long if the sensor has more electrons per "
                "level or less read noise than was told, and too short if pictures were smoothed "
                "or resampled. Check both"
            )
        return None

    def band(self, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The profile less and plus two error bars, which are at most 1; shapes of `tau`."""
        from scipy.interpolate import BSpline

        count = self.coefficients.size
        basis = BSpline.design_matrix(np.asarray(tau), spline_knots(count), 3).toarray()
        errors = np.minimum(self.coefficient_errors, 1.0)
        middle, reach = basis @ self.coefficients, 2 * (basis @ errors)
        return middle - reach, middle + reach

    def seen_through_lens(self, scene: Scene) -> Scene:
        """The scene behind the lens that was found."""
        require_scene(scene)
        blur = as_float(np.asarray(self.lens_blur, scene.speeds.dtype))
        return eqx.tree_at(lambda s: s.lens_blur, scene, blur)

    def design(self, scene: Scene) -> Design:
        """The camera as built, as a design like any other, on a scene behind its lens."""
        seen = self.seen_through_lens(scene)
        outcome = "Fitted to measurements" + ", which it does not explain" * bool(self.doubt) + "."
        return given_design(seen, self.motion, self.shutter, outcome, is_measured=True)

    def scene_text(self, scene: Scene) -> str:
        """The text of a scene file with the motion that was found, ready for `optimise`.

        Limits are widened to hold it. Comments say each error bar, and what no key says: the
        profile.
        """
        require_scene(scene)
        limits, wider = _limits_with(scene.limits, self.motion)
        built = eqx.tree_at(lambda s: s.limits, self.seen_through_lens(scene), limits)
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
                *([f"Implausible: {self.doubt}."] if self.doubt else []),
            ],
            "optics": [said.pop("lens_blur_px")],
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
            "chance": self.chance,
            "doubt": self.doubt,
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
    extent = limits.demands(motion)["stroke"].taken
    wide = widened(own, max_stroke=extent, max_top_speed=top, max_pan=pan, max_acceleration=2 * a)
    if limits.has_stage:
        share = float(Limits(**wide).stage_share(a, half, v))
        grown = {"max_travel": limits.max_travel}
        if limits.max_jerk is not None:
            grown["max_top_speed"] = wide["max_top_speed"]
        known = {name: each * share for name, each in grown.items() if each is not None}
        wide = widened(wide, **known)
    return Limits(**wide), [name for name in own if wide[name] is not own[name]]


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
        The camera, error bars, what is not identifiable, and residuals. Where noise alone leaves
        residuals that great or that small in fewer than 3 fits of 1,000, `doubt` says so, and a
        warning does.

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
    setting = Setting.of(given, motion, shutter, num_coefficients)
    unknown = any(picture.speed is None for picture in given.pictures)
    best = likeliest_start(setting, _SPEEDS if unknown else (0.0,))
    best = solved(setting, best.values, setting.noise(best.expected), setting.near_sent())
    best, bars = error_bars(setting, best)
    share = float(best.values[0])
    requirement = "show a camera like the one that was sent"
    got = Bare(f"{share:.3g} times its acceleration")
    require(0.5 < share < 2, "fit(measurements=...)", requirement, got)
    camera = _camera(setting, best, bars)
    if camera.doubt:
        warnings.warn(f"fit: {camera.doubt}.", stacklevel=2)
    return camera


def _measurements(
    given: Measurements | Sequence[TargetPicture], sensor: SensorLevels | None, trace: Trace | None
) -> Measurements:
    if isinstance(given, Measurements):
        return given
    pictures = tuple(given)
    right = bool(pictures) and all(isinstance(p, TargetPicture) for p in pictures)
    require(right, "fit(measurements=...)", "hold at least one `TargetPicture`", given)
    return Measurements(pictures, sensor or SensorLevels(), trace)


def _camera(setting: Setting, solution: Solution, bars: ErrorBars) -> FittedCamera:
    values, expected, noise = solution.values, solution.expected, solution.noise
    count = len(setting.coefficients)
    scales = np.asarray(setting.arrays.scales)
    is_blind = bars.errors > WIDEST
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
