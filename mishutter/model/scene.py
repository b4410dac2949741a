"""A scene: the speeds that occur, the light, the sensor's noise and limits."""

import os
from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import (
    RowLike,
    all_concrete,
    as_float,
    common_dtype,
    compiled,
    is_concrete,
    require,
    require_finite,
    require_positive_int,
    require_scalar,
    shape_of,
)
from mishutter.model.devices import AbstractDevice
from mishutter.model.motion import (
    AbstractMotion,
    FreeMotion,
    ParabolicMotion,
    StillCamera,
    is_known_zero,
    is_straight,
    settled,
    steady,
    without_velocity,
)
from mishutter.model.optics import WIDEST_BLUR, Optics, frequencies, on_steps
from mishutter.model.servos import SecondOrderStage
from mishutter.model.shutters import AbstractShutter
from mishutter.model.stages import StagePath, StageUse, stage_path, stage_use, stage_use_of_path
from mishutter.model.tolerances import Tolerances

_BISECTIONS = 60
_OF_STAGE = ("max_travel", "max_acceleration", "max_jerk")
DEFAULT_MEAN = 0.25
DEFAULT_DEVIATION = 0.2
CORNER_FREQUENCY = 0.01
NYQUIST_FREQUENCY = 0.5
NUM_FREQUENCIES = 256
"""Mean, standard deviation (linear light, white = 1) and corner (cycles/px) of the
spectrum that stands for a photograph where a scene brings none, the highest frequency
that a sensor records (cycles/px), and how many equal steps up to it are looked at, at least."""


@final
class Limits(eqx.Module):
    """The furthest that the mechanism and the exposure may reach.

    Args:
        max_stroke: Largest $aT^2$; px.
        max_top_speed: Largest $2aT + |v|$; px/s.
        min_half_exposure: Shortest $T$; s.
        max_half_exposure: Longest $T$; s.
        max_pan: Largest $|v|$; px/s. 0 forbids panning; `max_top_speed` by default.
        max_travel: Largest travel from rest to rest, run-up and run-out at the greatest
            acceleration included (`mishutter.model.stages`); px. None for any.
        max_acceleration: Greatest acceleration of the sensor, $2a$ in the exposure; px/s^2. None
            for any, which runs up at once.
        max_jerk: Greatest jerk of the run-up and the run-out, which a higher top speed pays for;
            px/s^3. None for any.

    Attributes:
        frame_velocity: Velocity of the frame that motions are in, as `seen_from` sets it; px/s.
            None where no stage limits anything.

    Raises:
        ValueError: if one is not a positive scalar (`max_pan` at least 0), or the exposures
            are out of order.
    """

    max_stroke: Array
    max_top_speed: Array
    min_half_exposure: Array
    max_half_exposure: Array
    max_pan: Array
    max_travel: Array | None
    max_acceleration: Array | None
    max_jerk: Array | None
    frame_velocity: Array | None

    def __init__(
        self,
        *,
        max_stroke: ArrayLike = 200.0,
        max_top_speed: ArrayLike = 1e5,
        min_half_exposure: ArrayLike = 1e-4,
        max_half_exposure: ArrayLike = 0.5,
        max_pan: ArrayLike | None = None,
        max_travel: ArrayLike | None = None,
        max_acceleration: ArrayLike | None = None,
        max_jerk: ArrayLike | None = None,
    ):
        self.max_stroke = as_float(max_stroke, "Limits(max_stroke=...)")
        self.max_top_speed = as_float(max_top_speed, "Limits(max_top_speed=...)")
        self.min_half_exposure = as_float(min_half_exposure, "Limits(min_half_exposure=...)")
        self.max_half_exposure = as_float(max_half_exposure, "Limits(max_half_exposure=...)")
        max_pan = self.max_top_speed if max_pan is None else max_pan
        self.max_pan = as_float(max_pan, "Limits(max_pan=...)")
        self.max_travel = self.max_acceleration = self.max_jerk = self.frame_velocity = None
        if max_travel is not None:
            self.max_travel = as_float(max_travel, "Limits(max_travel=...)")
        if max_acceleration is not None:
            self.max_acceleration = as_float(max_acceleration, "Limits(max_acceleration=...)")
        if max_jerk is not None:
            self.max_jerk = as_float(max_jerk, "Limits(max_jerk=...)")
        if self.has_stage:
            self.frame_velocity = as_float(np.zeros((), self.max_top_speed.dtype))

    def __check_init__(self) -> None:
        stage = [name for name in _OF_STAGE if getattr(self, name) is not None]
        always = ("max_stroke", "max_top_speed", "min_half_exposure", "max_half_exposure")
        for name in (*always, *stage):
            require_scalar(f"Limits({name}=...)", getattr(self, name))
            _check_at_least(f"Limits({name}=...)", getattr(self, name), "above 0", strict=True)
        require_scalar("Limits(max_pan=...)", self.max_pan)
        _check_at_least("Limits(max_pan=...)", self.max_pan, "at least 0")
        if is_concrete(self.min_half_exposure) and is_concrete(self.max_half_exposure):
            require(
                float(self.min_half_exposure) <= float(self.max_half_exposure),
                "Limits(min_half_exposure=...)",
                f"be at most max_half_exposure = {float(self.max_half_exposure):g} s",
                self.min_half_exposure,
            )

    @property
    def has_stage(self) -> bool:
        """Whether travel, acceleration or jerk of the stage is limited."""
        return any(getattr(self, name) is not None for name in _OF_STAGE)

    def stage_share(
        self,
        acceleration: Array,
        half_exposure: Array,
        velocity: Array,
        pieces: Array | None = None,
    ) -> Array:
        """Share of the stage's travel, and of its top speed where its jerk is limited, in use.

        It never falls with the acceleration, px/s^2, the half exposure, s, or the size of the
        velocity, px/s, in the frame of the stage. Of any shape.

        With `pieces` it is that of a free path of so many equal ones, `(K,)`, whose accelerations
        are multiples of the one given; of scalars then, and where no jerk is limited.
        """
        if pieces is not None:
            return self.stage_share_of(
                FreeMotion(
                    accelerations=acceleration * pieces,
                    half_exposure=half_exposure,
                    velocity=velocity,
                )
            )
        frame = self._frame(velocity)
        limits = self.max_acceleration, self.max_jerk
        use = stage_use(acceleration, half_exposure, velocity + frame, *limits)
        return self._share_of(use, frame)

    def stage_share_of(self, motion: AbstractMotion) -> Array:
        """The `stage_share` of a motion; scalar."""
        velocity = jnp.asarray(motion.velocity)
        frame = self._frame(velocity)
        if isinstance(motion, FreeMotion):
            path = replace(motion, velocity=velocity + frame)
            return self._share_of(stage_use_of_path(path, self.max_acceleration), frame)
        acceleration, half = steady(motion).acceleration, motion.half_exposure
        return self.stage_share(jnp.asarray(acceleration), jnp.asarray(half), velocity)

    def stage_path(self, motion: AbstractMotion) -> StagePath | None:
        """The path of the stage from rest through an exposure to rest.

        Its run-up and run-out take the greatest acceleration and jerk, or the greatest
        acceleration of the exposure where neither is limited. None where the sensor stays at rest,
        or pans and neither is limited.

        Args:
            motion: Motion of the sensor over the exposure, within these limits.
        """
        motion = settled(motion)
        most, jerk = self.max_acceleration, self.max_jerk
        runs_up_at_once = most is None and jerk is None
        if isinstance(motion, StillCamera) or (runs_up_at_once and is_straight(motion)):
            return None
        most = motion.greatest_acceleration if runs_up_at_once else most
        return stage_path(motion, max_acceleration=most, max_jerk=jerk)

    def _frame(self, velocity: Array) -> Array:
        """Velocity of the frame that motions are in; px/s, the shape and precision given."""
        frame = jnp.zeros_like(velocity)
        if self.frame_velocity is not None:
            frame = frame + self.frame_velocity.astype(frame.dtype)
        return frame

    def _share_of(self, use: StageUse, frame: Array) -> Array:
        share = jnp.zeros_like(use.travel)
        if self.max_travel is not None:
            share = jnp.maximum(share, use.travel / self.max_travel)
        if self.max_jerk is not None:
            left = jnp.maximum(self.max_top_speed, np.finfo(share.dtype).tiny)
            share = jnp.maximum(share, (use.top_speed - jnp.abs(frame)) / left)
        return share

    def largest(
        self,
        name: str,
        low: Array,
        high: Array,
        numbers: Mapping[str, Array],
        pieces: Array | None = None,
    ) -> Array:
        """Largest value of a number of a motion that the stage reaches; scalar.

        It is bracketed by bisection, on the side that keeps the limits, and has the derivative of
        an implicit function. Where all of the interval exceeds them it is the lower end.

        Args:
            name: `"acceleration"`, `"half_exposure"` or `"velocity"`.
            low: Least value.
            high: Greatest value.
            numbers: The numbers of a motion in which it takes its place.
            pieces: Those of a free path, as `stage_share` takes them.
        """
        return _largest(self, name, low, high, {**numbers, "pieces": pieces})

    def fullest_motion(self, velocity: ArrayLike = 0.0) -> ParabolicMotion:
        """The longest stroke at the highest top speed that the limits allow.

        Args:
            velocity: Velocity at mid-exposure, px/s, which is brought within half of the top
                speed and the largest pan.
        """
        stroke, top, pan = self.max_stroke, self.max_top_speed, self.max_pan
        shortest, longest = self.min_half_exposure, self.max_half_exposure
        known = all_concrete((stroke, top, pan, shortest, longest, velocity))
        space, number = (np, np.asarray) if known else (jnp, jnp.asarray)
        numbers = map(number, (stroke, top, pan, shortest, longest, velocity))
        stroke, top, pan, shortest, longest, velocity = numbers
        furthest = space.minimum(pan, top / 2)
        velocity = space.clip(velocity, -furthest, furthest).astype(top.dtype)
        left = top - space.abs(velocity)
        T = space.clip(2 * stroke / left, shortest, longest)
        acceleration = space.minimum(stroke / T / T, left / (2 * T))
        if self.has_stage:
            numbers = acceleration, T, velocity, shortest
            with jax.ensure_compile_time_eval() if known else nullcontext():
                acceleration, T, velocity = self._within_stage(*map(jnp.asarray, numbers))
        return ParabolicMotion(acceleration=acceleration, half_exposure=T, velocity=velocity)

    def _within_stage(
        self, acceleration: Array, half_exposure: Array, velocity: Array, shortest: Array
    ) -> tuple[Array, Array, Array]:
        """A motion that the stage reaches: with a slower pan, then shorter, then weaker."""
        none = jnp.zeros_like(acceleration)
        if self.max_acceleration is not None:
            acceleration = jnp.minimum(acceleration, self.max_acceleration / 2)
        pan, sign = jnp.abs(velocity), jnp.sign(velocity)
        numbers = {"acceleration": none, "half_exposure": shortest, "velocity": none}
        numbers["velocity"] = sign * self.largest("velocity", none, pan, numbers)
        half = self.largest("half_exposure", shortest, half_exposure, numbers)
        numbers["half_exposure"] = half
        return self.largest("acceleration", none, acceleration, numbers), half, numbers["velocity"]


@compiled
def _largest(limits: Limits, name: str, low: Array, high: Array, numbers: Any) -> Array:
    def use(value: Array, limits: Limits, numbers: Any) -> Array:
        return limits.stage_share(**(numbers | {name: value}))

    fixed = jax.lax.stop_gradient((limits, numbers))
    ends = jax.lax.stop_gradient((jnp.asarray(low), jnp.asarray(high)))

    def halved(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = (ends[0] + ends[1]) / 2
        keeps = use(middle, *fixed) <= 1
        return jnp.where(keeps, middle, ends[0]), jnp.where(keeps, ends[1], middle)

    found, _ = jax.lax.fori_loop(0, _BISECTIONS, halved, ends)
    slope = jax.grad(use)(found, *fixed)
    share, rises = use(found, limits, numbers), slope > 0
    moved = jnp.where(rises, share - jax.lax.stop_gradient(share), 0.0)
    inside = found - moved / jnp.where(rises, slope, 1.0)
    return jnp.where(use(ends[1], *fixed) <= 1, high, jnp.where(found > ends[0], inside, low))


@final
class Burst(eqx.Module):
    """Frames that a camera may take in place of one exposure, as a rival.

    Args:
        frames_per_s: Frames that the sensor reads out a second.
        max_frames: Most frames of a burst.

    Raises:
        ValueError: if `frames_per_s` is not above 0, or `max_frames` not a whole number above 0.
    """

    frames_per_s: Array
    max_frames: int = eqx.field(static=True)

    def __init__(self, *, frames_per_s: ArrayLike, max_frames: int):
        self.frames_per_s = as_float(frames_per_s, "Burst(frames_per_s=...)")
        self.max_frames = require_positive_int("Burst(max_frames=...)", max_frames)

    def __check_init__(self) -> None:
        require_scalar("Burst(frames_per_s=...)", self.frames_per_s)
        _check_at_least("Burst(frames_per_s=...)", self.frames_per_s, "above 0", strict=True)


@final
class Scene(eqx.Module):
    r"""Speeds with their weights, light, noise, and the power spectrum of what is seen.

    Args:
        speeds: Speeds $s_i$ that occur, px/s, either sign; shape `(n,)`.
        weights: How often each occurs, on any scale; equal by default. They are divided
            by their sum.
        photon_rate: Photo-electrons a second at a white pixel; e-/s.
        read_noise: Standard deviation of the read noise $\sigma$; e-.
        mean_level: Mean of the picture in linear light, white = 1.
        deviation: Standard deviation of the picture in linear light.
        power_spectrum: Power of the picture's rows at the centres of $m$ equal steps of
            (0, 0.5) cycles/px, on any scale, none only without deviation; the spectrum
            $1/(f^2 + 0.01^2)$ by default. It is looked at in 256 steps, or more
            where light spreads further, which share its power. Shape `(m,)`.
        cutoff_frequency: Highest frequency that the optics pass: the picture on the
            sensor holds none above it, and below it some; cycles/px, at most 0.5.
        lens_blur: Standard deviation of the Gaussian that the lens spreads a point over, along the
            rows, which a decoder restores with the rest of the blur; px, at most 16.
        limits: The furthest that the mechanism and the exposure may reach.
        device: What shutters other than an open one are made with: it makes of a command the light
            that is seen; by default one that follows every command and loses no light.
        full_well: Electrons at which a pixel is full: searches expose white to no more; no limit
            by default; e-.
        burst: Frames that a rival takes in place of one exposure; no such rival by default.
        stage: How the stage follows what it is sent, which says what to send; by default it is
            where it is sent at once.
        tolerances: How far a camera as it is built may be from its design; the expected error,
            and a search by it, are over these. None by default.
        motion: Motion to start from or to compare at; by default the `fullest_motion` of the
            limits about the middle of the speeds.
        picture: Path of the photograph to show results on; None for none.

    Raises:
        ValueError: if a value is not finite, out of its range or of another kind, no
            weight is above 0, or lengths differ.
    """

    speeds: Array
    weights: Array
    photon_rate: Array
    read_noise: Array
    mean_level: Array
    deviation: Array
    power_spectrum: Array | None
    cutoff_frequency: Array
    lens_blur: Array
    limits: Limits
    device: AbstractDevice | None
    full_well: Array | None
    burst: Burst | None
    stage: SecondOrderStage | None
    tolerances: Tolerances | None
    given_motion: AbstractMotion | None
    picture: str | None = eqx.field(static=True)

    def __init__(
        self,
        speeds: RowLike,
        weights: RowLike | None = None,
        *,
        photon_rate: ArrayLike,
        read_noise: ArrayLike,
        mean_level: ArrayLike = DEFAULT_MEAN,
        deviation: ArrayLike = DEFAULT_DEVIATION,
        power_spectrum: RowLike | None = None,
        cutoff_frequency: ArrayLike = NYQUIST_FREQUENCY,
        lens_blur: ArrayLike = 0.0,
        limits: Limits | None = None,
        device: AbstractDevice | None = None,
        full_well: ArrayLike | None = None,
        burst: Burst | None = None,
        stage: SecondOrderStage | None = None,
        tolerances: Tolerances | None = None,
        motion: AbstractMotion | None = None,
        picture: str | os.PathLike[str] | None = None,
    ):
        self.speeds = as_float(speeds, "Scene(speeds=...)")
        count = max(self.speeds.size, 1)
        equal = np.full(self.speeds.shape, 1 / count, self.speeds.dtype)
        self.weights = _normalised(equal if weights is None else weights)
        self.photon_rate = as_float(photon_rate, "Scene(photon_rate=...)")
        self.read_noise = as_float(read_noise, "Scene(read_noise=...)")
        self.mean_level = as_float(mean_level, "Scene(mean_level=...)")
        self.deviation = as_float(deviation, "Scene(deviation=...)")
        self.power_spectrum = None
        if power_spectrum is not None:
            self.power_spectrum = as_float(power_spectrum, "Scene(power_spectrum=...)")
        self.cutoff_frequency = as_float(cutoff_frequency, "Scene(cutoff_frequency=...)")
        self.lens_blur = as_float(lens_blur, "Scene(lens_blur=...)")
        self.limits = Limits() if limits is None else limits
        self.device = device
        self.full_well = None
        if full_well is not None:
            self.full_well = as_float(full_well, "Scene(full_well=...)")
        self.burst = burst
        self.stage = stage
        self.tolerances = tolerances
        self.given_motion = motion
        self.picture = os.fspath(picture) if isinstance(picture, os.PathLike) else picture

    def __check_init__(self) -> None:
        shape = self.speeds.shape
        require(
            self.speeds.ndim == 1 and self.speeds.size >= 1,
            "Scene(speeds=...)",
            "be one row of at least one speed",
            shape_of(self.speeds),
        )
        require_finite("Scene(speeds=...)", self.speeds)
        matches = self.weights.shape == shape
        require(matches, "Scene(weights=...)", f"have shape {shape}", self.weights.shape)
        _check_at_least("Scene(weights=...)", self.weights, "at least 0")
        if is_concrete(self.weights):
            some = bool(np.any(np.asarray(self.weights) > 0))
            require(some, "Scene(weights=...)", "hold one above 0", self.weights)
        for name in ("photon_rate", "read_noise", "mean_level", "deviation", "lens_blur"):
            value = getattr(self, name)
            require_scalar(f"Scene({name}=...)", value)
            _check_at_least(f"Scene({name}=...)", value, "at least 0")
        self._check_spectrum()
        self._check_cutoff()
        if is_concrete(self.lens_blur):
            requirement = f"be at most {WIDEST_BLUR:g} px"
            within = float(self.lens_blur) <= WIDEST_BLUR
            require(within, "Scene(lens_blur=...)", requirement, self.lens_blur)
        for name, kind, requirement in (
            ("limits", Limits, "be `Limits`"),
            ("burst", Burst | None, "be a `Burst`"),
            ("stage", SecondOrderStage | None, "be a `SecondOrderStage`"),
            ("tolerances", Tolerances | None, "be `Tolerances`"),
            ("device", AbstractDevice | None, "be a device, as an `IdealShutter`"),
            ("picture", str | None, "be a path"),
        ):
            value = getattr(self, name)
            require(isinstance(value, kind), f"Scene({name}=...)", requirement, value)
        if self.full_well is not None:
            require_scalar("Scene(full_well=...)", self.full_well)
            _check_at_least("Scene(full_well=...)", self.full_well, "above 0", strict=True)
        known = isinstance(self.given_motion, AbstractMotion | None)
        require(known, "Scene(motion=...)", "be a motion", self.given_motion)

    def _check_spectrum(self) -> None:
        subject, power = "Scene(power_spectrum=...)", self.power_spectrum
        if power is None:
            return
        one_row = power.ndim == 1 and power.size >= 1
        require(one_row, subject, "be one row of at least one value", shape_of(power))
        _check_at_least(subject, power, "at least 0")
        if is_concrete(power) and is_concrete(self.deviation):
            some = bool(np.any(np.asarray(power) > 0)) or float(self.deviation) == 0
            require(some, subject, "hold some power where the deviation is not 0", 0.0)

    def _check_cutoff(self) -> None:
        subject, cutoff = "Scene(cutoff_frequency=...)", self.cutoff_frequency
        require_scalar(subject, cutoff)
        require_finite(subject, cutoff)
        if is_concrete(cutoff):
            passes = 0 < float(np.asarray(cutoff)) <= NYQUIST_FREQUENCY
            require(passes, subject, "be above 0 and at most 0.5 cycles/px", cutoff)
            self._check_power_below(float(np.asarray(cutoff)))

    def _check_power_below(self, cutoff: float) -> None:
        power, deviation = self.power_spectrum, self.deviation
        if not (is_concrete(power) and is_concrete(deviation)) or float(deviation) == 0:
            return
        known = np.ones(1) if power is None else np.asarray(power)
        lit = on_steps(known, NUM_FREQUENCIES) > 0
        first = float(np.min(frequencies(NUM_FREQUENCIES), where=lit, initial=np.inf))
        requirement = f"pass some of the picture, whose power begins at {first:.3g} cycles/px"
        require(first <= cutoff, "Scene(cutoff_frequency=...)", requirement, cutoff)

    @staticmethod
    def uniform(
        *, max_speed: float, num_speeds: int = 9, min_speed: float | None = None, **others: object
    ) -> "Scene":
        """Equally likely speeds, evenly spaced from `min_speed` (`-max_speed`) to `max_speed`.

        Args:
            max_speed: Largest speed, px/s.
            num_speeds: How many; a single one is the middle of the range.
            min_speed: Smallest speed, px/s; `-max_speed` by default.
            others: The arguments of `Scene`.

        Raises:
            ValueError: as `Scene`, or if the range is reversed.
        """
        require_positive_int("Scene.uniform(num_speeds=...)", num_speeds)
        for name, value in (("max_speed", max_speed), ("min_speed", min_speed)):
            if value is not None:
                require_finite(f"Scene.uniform({name}=...)", value)
        low = -max_speed if min_speed is None else min_speed
        ordered = low <= max_speed
        require(ordered, "Scene.uniform(max_speed=...)", f"be at least {low:g} px/s", max_speed)
        if num_speeds == 1:
            speeds = np.array([(low + max_speed) / 2])
        else:
            speeds = np.linspace(low, max_speed, num_speeds)
        return Scene(speeds, **others)  # type: ignore[arg-type]

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "Scene":
        """Read a scene from a TOML file; see `mishutter.model.scene_file` for its keys.

        Raises:
            ValueError: if the file is not a scene; the line says which key and why.
            OSError: if it cannot be read.
        """
        from mishutter.model.scene_file import read_scene

        return read_scene(os.fspath(path))

    def bare(
        self,
        speeds: ArrayLike | None = None,
        weights: ArrayLike | None = None,
        power_spectrum: RowLike | None = None,
    ) -> "Scene":
        """The numbers without what no integral sees: those of pictures, motion, burst and stage.

        Args:
            speeds: Speeds in place of the scene's own, with their `weights`.
            weights: How often each occurs.
            power_spectrum: Power in place of the scene's own.
        """
        return Scene(
            self.speeds if speeds is None else speeds,
            self.weights if weights is None else weights,
            photon_rate=self.photon_rate,
            read_noise=self.read_noise,
            mean_level=self.mean_level,
            deviation=self.deviation,
            power_spectrum=self.power_spectrum if power_spectrum is None else power_spectrum,
            cutoff_frequency=self.cutoff_frequency,
            lens_blur=self.lens_blur,
            limits=self.limits,
            device=self.device,
            full_well=self.full_well,
            tolerances=self.tolerances,
        )

    def light(
        self, shutter: AbstractShutter, motion: AbstractMotion | ArrayLike
    ) -> AbstractShutter:
        """The transmittance that light sees where a profile is sent to the scene's device.

        An open shutter needs none. What a device has made of a profile stays as it is, so that
        profiles and designs may be measured alike.

        Args:
            shutter: The profile.
            motion: Motion of the sensor, or its half exposure, s: how much of a profile a device
                can follow depends on that.
        """
        if self.device is None:
            return shutter
        half = motion.half_exposure if isinstance(motion, AbstractMotion) else motion
        return self.device.light(shutter, half, np.dtype(self.speeds.dtype))

    @property
    def optics(self) -> Optics:
        """The lens, of a scene that is concrete."""
        return Optics(float(self.cutoff_frequency), float(self.lens_blur))

    @property
    def motion(self) -> AbstractMotion:
        """The motion to start from or to compare at: that given, or the fullest within limits."""
        return self.fullest_motion if self.given_motion is None else self.given_motion

    @property
    def fullest_motion(self) -> ParabolicMotion:
        """The `fullest_motion` of the limits about the middle of the speeds."""
        slowest, fastest = self.speed_range
        known = self.speeds_known
        slowest, fastest = (np.asarray(x) if known else x for x in (slowest, fastest))
        return self.limits.fullest_motion((slowest + fastest) / 2)

    @property
    def speeds_known(self) -> bool:
        """Whether the speeds and weights can be looked at now, rather than being traced."""
        return is_concrete(self.speeds) and is_concrete(self.weights)

    @property
    def max_speed(self) -> Array:
        """Largest speed of either sign that occurs; px/s."""
        slowest, fastest = self.speed_range
        if self.speeds_known:
            return as_float(np.maximum(np.abs(slowest), np.abs(fastest)))
        return jnp.maximum(jnp.abs(slowest), jnp.abs(fastest))

    @property
    def speed_range(self) -> tuple[Array, Array]:
        """Smallest and largest velocity that occurs; px/s."""
        if self.speeds_known:
            speeds = np.asarray(self.speeds)[np.asarray(self.weights) > 0]
            return as_float(np.min(speeds)), as_float(np.max(speeds))
        occurs = self.weights > 0
        slowest = jnp.min(jnp.where(occurs, self.speeds, jnp.inf))
        return slowest, jnp.max(jnp.where(occurs, self.speeds, -jnp.inf))


def seen_from(scene: Scene, motion: AbstractMotion) -> tuple[Scene, AbstractMotion]:
    """A scene and a motion in the frame that pans with the sensor, where the exposure is the same.

    The velocity of the sensor is taken from all speeds. The motion has none left, and may gain
    as much less of the top speed.
    """
    if is_known_zero(motion.velocity):
        return scene, without_velocity(motion)
    top, pan = scene.limits.max_top_speed, scene.limits.max_pan
    dtype = common_dtype(scene.speeds, motion.velocity)
    known = all_concrete((scene.speeds, scene.limits, motion.velocity))
    space = np if known else jnp
    velocity = space.asarray(motion.velocity, dtype)
    left = space.maximum(space.asarray(top) - space.abs(velocity.astype(top.dtype)), 0)
    numbers = space.asarray(scene.speeds, dtype) - velocity, left, space.zeros_like(pan)
    if known:
        numbers = tuple(as_float(number) for number in numbers)
    places = lambda s: (s.speeds, s.limits.max_top_speed, s.limits.max_pan)  # noqa: E731
    scene = eqx.tree_at(places, scene, numbers)
    if scene.limits.frame_velocity is not None:
        frame = as_float(scene.limits.frame_velocity + velocity.astype(top.dtype))
        scene = eqx.tree_at(lambda s: s.limits.frame_velocity, scene, frame)
    if scene.tolerances is not None:
        tolerances = scene.tolerances.seen_from(velocity)
        scene = eqx.tree_at(lambda s: s.tolerances, scene, tolerances)
    return scene, without_velocity(motion)


def _normalised(weights: RowLike) -> Array:
    """Weights over their sum; those that sum to 1 to rounding keep their bits."""
    row = as_float(weights, "Scene(weights=...)")
    if not is_concrete(row):
        return row / jnp.sum(row)
    total = float(np.sum(np.asarray(row, np.float64)))
    rounding = row.size * float(np.finfo(row.dtype).eps)
    if not total > 0 or not np.isfinite(total) or abs(total - 1) <= rounding:
        return row
    return as_float(np.asarray(row) / np.asarray(total, row.dtype), "Scene(weights=...)")


def _check_at_least(subject: str, value: Array, bound: str, *, strict: bool = False) -> None:
    require_finite(subject, value)
    if is_concrete(value):
        array = np.asarray(value)
        require(bool(np.all(array > 0 if strict else array >= 0)), subject, f"be {bound}", value)
