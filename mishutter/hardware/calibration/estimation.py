"""A camera as it was built, fitted to its measurements."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import Unquoted, as_float, fields_text, require, require_positive_int
from mishutter._core.progress import counts
from mishutter.design.design import Design, given_design
from mishutter.hardware.calibration.likelihood import Setting, Solution
from mishutter.hardware.calibration.measurements import Measurements, SensorLevels, TargetPicture
from mishutter.hardware.calibration.uncertainty import WIDEST, error_bars
from mishutter.hardware.traces import Trace, TraceLike
from mishutter.measurement.estimates import Estimate
from mishutter.model.limits import Limits
from mishutter.model.motion import AbstractMotion, ParabolicMotion
from mishutter.model.scene import Scene, require_scene, scene_text
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.spline import SplineShutter, spline_basis

_IMPLAUSIBLE = 0.003
"""Probability of residuals as great, or as small, of a right fit, below which a fit is doubted."""


@dataclass(frozen=True, eq=False)
class FittedCamera:
    """A camera as built.

    Attributes:
        motion: The stage's motion, on the camera's clock.
        shutter: The transmittance.
        coefficients: Its B-spline coefficients before they are clipped to [0, 1].
        coefficient_errors: Their error bars.
        estimates: The other numbers by name, with their units in the name; an error is infinite
            where the number is not identifiable.
        not_identifiable: Sentences about numbers that the measurements do not determine.
        names: Names of the pictures.
        levels: Mean of the rows of each picture.
        expected: Levels that the fitted camera gives.
        noise: Standard deviations of the levels.
        chi_squared: Sum of the squares of all residuals, each over its noise.
        num_free: Number of parameters that the measurements determine.
    """

    motion: ParabolicMotion
    shutter: SplineShutter
    coefficients: Float[np.ndarray, "n"]
    coefficient_errors: Float[np.ndarray, "n"]
    estimates: dict[str, Estimate]
    not_identifiable: tuple[str, ...]
    names: tuple[str, ...]
    levels: tuple[Float[np.ndarray, "columns"], ...]
    expected: tuple[Float[np.ndarray, "columns"], ...]
    noise: tuple[Float[np.ndarray, "columns"], ...]
    chi_squared: float
    num_free: int

    def __repr__(self) -> str:
        return fields_text(self)

    @property
    def _num_degrees(self) -> int:
        return max(sum(row.size for row in self.levels) - self.num_free, 1)

    @property
    def lens_blur(self) -> float:
        """Standard deviation of the lens's Gaussian; px."""
        return self.estimates["lens_blur_px"].value

    @property
    def estimates_of_stage(self) -> dict[str, Estimate]:
        """The estimates as tables and scenes have them: of the stage's acceleration, not half."""
        words = {"acceleration_px_per_s2": ("stage_acceleration_px_per_s2", 2.0)}
        named = ((*words.get(name, (name, 1.0)), each) for name, each in self.estimates.items())
        return {name: Estimate(x * each.value, x * each.error) for name, x, each in named}

    @property
    def reduced_chi_squared(self) -> float:
        """Chi squared for each degree of freedom; near 1 if the model explains the pictures."""
        return self.chi_squared / self._num_degrees

    @property
    def chance(self) -> float:
        """Probability that noise alone leaves a greater chi squared."""
        from scipy.stats import chi2

        return float(chi2.sf(self.chi_squared, self._num_degrees))

    @property
    def doubt(self) -> str | None:
        """The reason to doubt the fit, and remedies; None if its residuals may be noise."""
        reduced = self.reduced_chi_squared
        if self.chance < _IMPLAUSIBLE:
            pictures = zip(self.levels, self.expected, self.noise, strict=True)
            squares = [float(np.mean(((row - mean) / noise) ** 2)) for row, mean, noise in pictures]
            worst = int(np.argmax(squares))
            return (
                f"residuals are implausibly large: chi squared for each free level is "
                f"{reduced:.3g}, which noise alone exceeds in {self.chance:.1g} of fits, and "
                f"{squares[worst]:.3g} in {self.names[worst]}. The numbers may be wrong by many "
                "error bars. Check the speeds and their signs, the exposure and the sensor's "
                "electrons per level, read noise and black level; then try more coefficients, a "
                "trace, a design nearer to the camera, or one picture fewer"
            )
        if 1 - self.chance < _IMPLAUSIBLE:
            return (
                f"residuals are implausibly small: chi squared for each free level is "
                f"{reduced:.3g}. Error bars are too long if the sensor has more electrons per "
                "level or less read noise than stated, and too short if pictures were smoothed "
                "or resampled. Check both"
            )
        return None

    def band(
        self, tau: Float[np.ndarray, "n"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """The profile less two error bars and plus two; an error bar counts as at most 1.

        Args:
            tau: Normalised times, from -1 to 1.
        """
        count = self.coefficients.size
        basis = spline_basis(np.asarray(tau), count).toarray()
        errors = np.minimum(self.coefficient_errors, 1.0)
        profile, margin = basis @ self.coefficients, 2 * (basis @ errors)
        return profile - margin, profile + margin

    def seen_through_lens(self, scene: Scene) -> Scene:
        """The scene behind the fitted lens.

        Args:
            scene: A scene without the lens.
        """
        require_scene(scene)
        blur = as_float(np.asarray(self.lens_blur, scene.speeds.dtype))
        return eqx.tree_at(lambda s: s.optics.lens_blur, scene, blur)

    def design(self, scene: Scene) -> Design:
        """The camera as built, as a design like any other, on a scene behind its lens.

        Args:
            scene: The scene that the design is for.
        """
        scene = self.seen_through_lens(scene)
        origin = "Fitted to measurements" + ", which it does not explain" * bool(self.doubt) + "."
        return given_design(scene, self.motion, self.shutter, origin, is_measured=True)

    def scene_text(self, scene: Scene) -> str:
        """The text of a scene file with the fitted motion and lens, ready for `optimise`.

        Limits are widened to hold the motion. Comments give the error bars, and say where the
        profile is, for which there is no key.

        Args:
            scene: The scene whose numbers the file has.
        """
        require_scene(scene)
        limits, widened = _limits_with(scene.limits, self.motion)
        built, parts = self.seen_through_lens(scene), (limits, self.motion)
        places = lambda s: (s.limits, s.given_motion)  # noqa: E731
        built = eqx.tree_at(places, built, parts, is_leaf=lambda leaf: leaf is None)
        lines = {
            name: f"{name} = {each.value:.6g} +- {each.error:.2g}"
            for name, each in self.estimates_of_stage.items()
            if not name.rpartition("_")[2].isdigit()  # numbers of a single picture
        }
        notes = {
            "": [
                "A camera as it was built: [motion], from measurements; numbers with error bars.",
                *(f"Not identifiable: {line}." for line in self.not_identifiable),
                *([f"Implausible: {self.doubt}."] if self.doubt else []),
            ],
            "optics": [lines.pop("lens_blur_px")],
            "shutter": [
                "As in the scene: what was built of it is a profile, in the design's file."
            ],
            "limits": [f"Wider than the scene's, as the camera was: {', '.join(widened)}."]
            * any(widened),
            "motion": list(lines.values()),
        }
        return scene_text(built, notes)

    def to_dict(self) -> dict[str, object]:
        """The numbers and sentences of the fit, for JSON."""
        # Half of the stage's acceleration stays too, which programs may read.
        estimates = self.estimates_of_stage | self.estimates
        return {
            "estimates": {name: each._asdict() for name, each in estimates.items()},
            "transmittance": self.coefficients.tolist(),
            "transmittance_errors": self.coefficient_errors.tolist(),
            "not_identifiable": list(self.not_identifiable),
            "reduced_chi_squared": self.reduced_chi_squared,
            "chance": self.chance,
            "doubt": self.doubt,
        }


def _limits_with(limits: Limits, motion: ParabolicMotion) -> tuple[Limits, list[str]]:
    """Limits that hold a motion, and the names of those that are widened for it."""
    a, half, v = motion.acceleration, motion.half_exposure, motion.velocity
    margin = 1 + 8 * float(np.finfo(a.dtype).eps)
    names: list[str] = []

    def replaced(limits: Limits, name: str, value: Array | np.ndarray) -> Limits:
        names.append(name)
        return eqx.tree_at(lambda each: getattr(each, name), limits, value)

    def widened(limits: Limits, **least: Array | np.ndarray) -> Limits:
        for name, bound in least.items():
            own = getattr(limits, name)
            if own is not None and float(bound) > float(own):
                limits = replaced(limits, name, bound * margin)
        return limits

    pan, top = jnp.abs(v), motion.top_speed
    stroke = limits.demands(motion)["stroke"].taken
    wide = widened(
        limits,
        max_stroke=stroke,
        max_top_speed=top,
        max_pan=pan,
        max_acceleration=2 * a,
        max_half_exposure=half,
    )
    if float(half) < float(limits.min_half_exposure):
        wide = replaced(wide, "min_half_exposure", half / margin)
    if limits.has_stage:
        share = float(wide.stage_share_of(motion))
        bounds = {"max_travel": limits.max_travel}
        if limits.max_jerk is not None:
            bounds["max_top_speed"] = wide.max_top_speed
        least = {name: value * share for name, value in bounds.items() if value is not None}
        wide = widened(wide, **least)
    return wide, [field.name for field in fields(limits) if field.name in names]


def fit(
    measurements: Measurements | Sequence[TargetPicture],
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    sensor: SensorLevels | None = None,
    trace: TraceLike | None = None,
    num_coefficients: int = 12,
    progress: bool = False,
) -> FittedCamera:
    r"""The camera as built, from pictures of points or edges and a trace of its shutter.

    The fit determines $a$ and $v$ of the stage on the camera's clock, the transmittance as a
    spline on the exposure, the Gaussian blur of the lens, and the position, gain and background
    of each picture. A stage that is late by $d$ has the velocity $v - 2 a d$ at mid-exposure; the
    delay that is given is that of a stage whose velocity is as sent. Pictures show the product of
    gain and transmittance alone, so that the profile is given the throughput of `shutter`.

    Args:
        measurements: Pictures, or the result of `read_measurements`, which has a sensor and a
            trace of its own: neither is then given beside it.
        motion: The motion as sent, a parabola of a sag of 1 px at least, from which the fit starts.
        shutter: The transmittance as sent, one of several from which the fit starts.
        sensor: The conversion of electrons to levels; by default a level is an electron, without
            read noise.
        trace: A photodiode's levels, on the camera's clock.
        num_coefficients: Number of B-spline coefficients of the profile; at least 4.
        progress: Whether a bar is shown, in a terminal or a notebook.

    Returns:
        The camera, its error bars and residuals, and sentences about parameters that are not
        identifiable. Where noise alone leaves residuals as great or as small in fewer than 3 fits
        of 1,000, `doubt` says so, and so does a warning.

    Raises:
        ValueError: if a picture is saturated or shows no target, the fitted acceleration is less
            than half or more than twice that sent, or an argument is out of its range.
    """
    is_parabola = isinstance(motion, AbstractMotion) and motion.accelerates_constantly
    require(is_parabola, "fit(motion=...)", "be a parabola", motion)
    data = _measurements(measurements, sensor, trace)
    require_positive_int("fit(num_coefficients=...)", num_coefficients)
    require(num_coefficients >= 4, "fit(num_coefficients=...)", "be at least 4", num_coefficients)
    sag = float(motion.sag)
    got = Unquoted(f"{sag:g} px")
    require(sag >= 1, "fit(motion=...)", "have a sag of at least 1 px", got)
    setting = Setting.of(data, motion, shutter, num_coefficients)
    is_unknown = any(picture.speed is None for picture in data.pictures)
    # Normalised speeds from which a fit of an unknown one starts.
    shares = [0.1 * k for k in range(-6, 7)] if is_unknown else [0.0]
    num_rounds = setting.num_first_rounds(shares) + 2
    wait = "compiling, or pictures are fitted, which takes a while"
    with counts(progress, "fitting", num_rounds, wait) as counter:
        best = setting.likeliest_start(shares, counter.next)
        counter.next("the likeliest camera")
        best = setting.solved(best.values, setting.noise(best.expected), setting.near_sent())
        counter.next("error bars")
        best, own_errors, delay_error, blind = error_bars(setting, best)
    share = float(best.values[0])
    requirement = "show a camera like the one that was sent"
    got = Unquoted(f"{share:.3g} times its acceleration")
    require(0.5 < share < 2, "fit(measurements=...)", requirement, got)
    camera = _camera(setting, best, own_errors, delay_error, blind)
    if camera.doubt:
        warnings.warn(f"fit: {camera.doubt}.", stacklevel=2)
    return camera


def _measurements(
    measurements: Measurements | Sequence[TargetPicture],
    sensor: SensorLevels | None,
    trace: TraceLike | None,
) -> Measurements:
    if isinstance(measurements, Measurements):
        for argument, value in {"sensor": sensor, "trace": trace}.items():
            requirement = "be left out beside `Measurements`, which have their own"
            require(value is None, f"fit({argument}=...)", requirement, value)
        trace = measurements.trace
    else:
        pictures = tuple(measurements)
        are_pictures = bool(pictures) and all(isinstance(p, TargetPicture) for p in pictures)
        requirement = "hold at least one `TargetPicture`"
        require(are_pictures, "fit(measurements=...)", requirement, measurements)
        measurements = Measurements(pictures, sensor or SensorLevels())
    if trace is None:
        return measurements
    return measurements._replace(trace=Trace.of(trace, "fit(trace=...)"))


def _camera(
    setting: Setting,
    solution: Solution,
    own_errors: Float[np.ndarray, "n"],
    delay_error: float,
    blind: Float[np.ndarray, "k n"],
) -> FittedCamera:
    """The camera at the end of a fit, with the error bars that `error_bars` gives."""
    values, expected, noise = solution.values, solution.expected, solution.noise
    count = len(setting.coefficients)
    scales = np.asarray(setting.arrays.scales)
    is_blind = own_errors > WIDEST
    errors = np.where(is_blind, np.inf, own_errors * scales)
    if np.all(setting.arrays.is_unknown):
        errors[1] = np.inf  # the velocity is taken as sent
    numbers = values * scales
    a, v = numbers[0], numbers[1]
    estimates = {
        "acceleration_px_per_s2": Estimate(a, errors[0]),
        "velocity_px_per_s": Estimate(v, errors[1]),
        "lens_blur_px": Estimate(abs(numbers[3]), errors[3]),
    }
    delay, _ = setting.delay(values)
    delay_error = delay_error if np.isfinite(errors[:2]).all() else np.inf
    estimates["delay_ms"] = Estimate(delay * 1e3, delay_error * 1e3)
    if np.asarray(setting.arrays.is_unknown).any():
        estimates["speed_px_per_s"] = Estimate(numbers[2], errors[2])
    for k in range(len(setting.profiles)):
        for j, name in enumerate(("position_px", "gain", "background")):
            index = 4 + count + 3 * k + j
            estimates[f"{name}_{k}"] = Estimate(numbers[index], errors[index])
    levels = tuple(setting.profiles)
    chi_squared = float(np.sum(((expected - np.array(levels)) / noise) ** 2))
    num_pins = len(setting.pins.rows)
    coefficients = numbers[4 : 4 + count]
    half = setting.sent_motion.half_exposure
    return FittedCamera(
        motion=ParabolicMotion(acceleration=a, half_exposure=half, velocity=v),
        shutter=SplineShutter(np.clip(coefficients, 0, 1)),
        coefficients=coefficients,
        coefficient_errors=errors[4 : 4 + count],
        estimates={name: Estimate(float(e.value), float(e.error)) for name, e in estimates.items()},
        not_identifiable=(*setting.notes, *_sentences(is_blind, blind, setting.names, count)),
        names=tuple(picture.name for picture in setting.measurements.pictures),
        levels=levels,
        expected=tuple(expected),
        noise=tuple(noise),
        chi_squared=chi_squared,
        num_free=values.size - num_pins,
    )


_NEARLY_NONE = 0.2
"""Part of a blind direction below which it does without what it is a part of."""


def _sentences(
    is_blind: np.ndarray, blind: np.ndarray, names: tuple[str, ...], count: int
) -> list[str]:
    """Sentences about the parameters that are not identifiable."""
    is_coefficient_blind = is_blind[4 : 4 + count]
    others = [name for k, name in enumerate(names) if is_blind[k] and not 4 <= k < 4 + count]
    sentences = [f"{name}: not determined by the measurements" for name in others]
    if is_coefficient_blind.any():
        which = ", ".join(str(k) for k in np.flatnonzero(is_coefficient_blind))
        # Blind directions of the profile alone: a longer stroke and a profile that it stretches, of
        # which only both together are seen, are none.
        turn, size, _ = np.linalg.svd(np.delete(blind, np.s_[4 : 4 + count], axis=1))
        is_alone = np.pad(size, (0, len(blind) - size.size)) < _NEARLY_NONE
        parts = (turn[:, is_alone].T @ blind)[:, 4 : 4 + count]
        even_part = np.linalg.norm(parts + parts[:, ::-1])
        sentences.append(
            f"transmittance: {f'{len(parts)} combinations of ' * bool(len(parts))}the coefficients "
            f"{which}"
            + ", only w(t) + w(-t) is seen"
            * bool(even_part < _NEARLY_NONE * np.linalg.norm(parts))
        )
    return sentences
