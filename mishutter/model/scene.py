"""A scene: the speeds that occur, the light, the noise and the limits of the sensor."""

import os
from dataclasses import fields
from typing import Any, Literal, final, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core import (
    RowLike,
    Unquoted,
    all_concrete,
    as_float,
    common_dtype,
    fields_text,
    is_concrete,
    require,
    require_at_least,
    require_finite,
    require_positive_int,
    require_scalar,
    shape_of,
    shown,
)
from mishutter.model.devices import AbstractDevice
from mishutter.model.limits import Limits
from mishutter.model.motion import (
    AbstractMotion,
    ParabolicMotion,
    is_known_zero,
)
from mishutter.model.occlusion import Occlusion
from mishutter.model.optics import WIDEST_BLUR, Optics, frequencies, on_steps
from mishutter.model.servos import SecondOrderStage
from mishutter.model.shutters import AbstractShutter
from mishutter.model.tolerances import Tolerances
from mishutter.pictures import Axis, checked_white

DEFAULT_MEAN = 0.25
DEFAULT_DEVIATION = 0.2
CORNER_FREQUENCY = 0.01
NYQUIST_FREQUENCY = 0.5
NUM_FREQUENCIES = 256
"""Mean, standard deviation (linear light, white = 1) and corner (cycles/px) of the
spectrum that stands for a photograph where a scene brings none, the highest frequency
that a sensor records (cycles/px), and how many equal steps up to it are looked at, at least."""


DecoderSpeed = Literal["unknown", "found", "known"]
"""The knowledge that a decoder has of the speed of a picture."""
DecoderWord = Literal[DecoderSpeed, "told"]
"""The same in files and scripts, which may hold the older word for the last."""
_OLDER_WORDS: dict[object, DecoderSpeed] = {"told": "known"}


def as_decoder_speed(word: Any) -> Any:
    """The word of today for a decoder's knowledge; files and stores may hold an older one."""
    return _OLDER_WORDS.get(word, word) if isinstance(word, str) else word


@final
class Burst(eqx.Module):
    """Frames that a camera may take in place of one exposure, as a rival.

    Args:
        frames_per_s: Frames that the sensor reads out a second.
        max_frames: Most frames of a burst.
        window: Longest time from the first light to the last; s. By default twice the longest half
            exposure of the scene's limits, as long as one exposure may be.
        dead_time: Time between the end of one frame and the beginning of the next in which the
            sensor sees nothing, at least; s.

    Raises:
        ValueError: if `frames_per_s` or `window` is not above 0, `max_frames` is not a whole number
            above 0, or `dead_time` is below 0 or not shorter than the time from frame to frame.
    """

    frames_per_s: Array
    window: Array | None
    dead_time: Array
    max_frames: int = eqx.field(static=True)

    def __init__(
        self,
        *,
        frames_per_s: ArrayLike,
        max_frames: int,
        window: ArrayLike | None = None,
        dead_time: ArrayLike = 0.0,
    ):
        self.frames_per_s = as_float(frames_per_s, "Burst(frames_per_s=...)")
        self.window = None if window is None else as_float(window, "Burst(window=...)")
        self.dead_time = as_float(dead_time, "Burst(dead_time=...)")
        self.max_frames = require_positive_int("Burst(max_frames=...)", max_frames)

    def __repr__(self) -> str:
        """The numbers, of which a module shows no more than their type."""
        return fields_text(self)

    def __check_init__(self) -> None:
        for name in ("frames_per_s", "window"):
            value, subject = getattr(self, name), f"Burst({name}=...)"
            if value is not None:
                require_scalar(subject, value)
                require_at_least(subject, value, "above 0", strict=True)
        subject = "Burst(dead_time=...)"
        require_scalar(subject, self.dead_time)
        require_at_least(subject, self.dead_time, "at least 0")
        if is_concrete(self.dead_time) and is_concrete(self.frames_per_s):
            period = 1 / float(self.frames_per_s)
            requirement = f"be shorter than the {period:g} s from frame to frame"
            require(float(self.dead_time) < period, subject, requirement, self.dead_time)


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
        occlusion: Objects that hide part of a background; by default the picture moves as a whole.
        decoder_speed: What the decoder knows of a picture's speed: `"unknown"`, one filter for all
            speeds; `"found"`, which a `SpeedFindingDecoder` finds in the picture, where that moves
            as a whole; or `"known"`, as something measures it. The loss of searches and comparisons
            is by default the expected error of that decoder.
        axis: Axis of pictures along which things and the sensor move: `"rows"`, across, or
            `"columns"`, a positive speed down. Captures, decoders and photographs know it.
        motion: Motion to start from or to compare at; by default the `fullest_motion` of the
            limits about the middle of the speeds.
        picture: Path of the photograph to show results on; None for none.
        picture_white: The argument `white` of `read_picture`, which reads the photograph.
        picture_linear: The argument `linear` of `read_picture`.

    Raises:
        ValueError: if a value is not finite, out of its range or of another kind, no
            weight is above 0, or lengths differ.

    Examples:
        >>> from mishutter import Limits, Scene
        >>> limits = Limits(max_stroke=20, max_half_exposure=0.02)
        >>> Scene([-700.0, 0.0, 700.0], photon_rate=1e5, read_noise=5, limits=limits)
        Scene(speeds=3 from -700 to 700, photon_rate=100000, read_noise=5)
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
    occlusion: Occlusion | None
    given_motion: AbstractMotion | None
    decoder_speed: DecoderSpeed = eqx.field(static=True)
    axis: Axis = eqx.field(static=True)
    picture: str | None = eqx.field(static=True)
    picture_white: float | None = eqx.field(static=True)
    picture_linear: bool = eqx.field(static=True)

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
        occlusion: Occlusion | None = None,
        decoder_speed: DecoderWord = "unknown",
        axis: Axis = "rows",
        motion: AbstractMotion | None = None,
        picture: str | os.PathLike[str] | None = None,
        picture_white: ArrayLike | None = None,
        picture_linear: bool = False,
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
        self.occlusion = occlusion
        self.decoder_speed = as_decoder_speed(decoder_speed)
        self.axis = axis
        self.given_motion = motion
        self.picture = os.fspath(picture) if isinstance(picture, os.PathLike) else picture
        self.picture_white = checked_white("Scene(picture_white=...)", picture_white)
        self.picture_linear = picture_linear

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
        require_at_least("Scene(weights=...)", self.weights, "at least 0")
        if is_concrete(self.weights):
            some = bool(np.any(np.asarray(self.weights) > 0))
            require(some, "Scene(weights=...)", "hold one above 0", self.weights)
        for name in ("photon_rate", "read_noise", "mean_level", "deviation", "lens_blur"):
            value = getattr(self, name)
            require_scalar(f"Scene({name}=...)", value)
            require_at_least(f"Scene({name}=...)", value, "at least 0")
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
            ("occlusion", Occlusion | None, "be an `Occlusion`"),
            ("device", AbstractDevice | None, "be a device, as an `IdealShutter`"),
            ("picture", str | None, "be a path"),
        ):
            value = getattr(self, name)
            require(isinstance(value, kind), f"Scene({name}=...)", requirement, value)
        if self.full_well is not None:
            require_scalar("Scene(full_well=...)", self.full_well)
            require_at_least("Scene(full_well=...)", self.full_well, "above 0", strict=True)
        *words, last = map(repr, get_args(DecoderSpeed))
        requirement = f"be {', '.join(words)} or {last}"
        is_valid = self.decoder_speed in get_args(DecoderSpeed)
        require(is_valid, "Scene(decoder_speed=...)", requirement, self.decoder_speed)
        whole = self.occlusion is None or self.decoder_speed != "found"
        requirement = "be 'unknown' or 'known' before a background: one speed is no picture's there"
        require(whole, "Scene(decoder_speed=...)", requirement, self.decoder_speed)
        is_valid = self.axis in get_args(Axis)
        require(is_valid, "Scene(axis=...)", "be 'rows' or 'columns'", self.axis)
        is_valid = isinstance(self.given_motion, AbstractMotion | None)
        require(is_valid, "Scene(motion=...)", "be a motion", self.given_motion)

    def __repr__(self) -> str:
        """The speeds and the light in one line; `str` has everything."""
        few = ("speeds", "photon_rate", "read_noise")
        return f"Scene({', '.join(f'{name}={shown(getattr(self, name))}' for name in few)})"

    def __str__(self) -> str:
        """Everything that the scene has, one part a line."""
        parts = {field.name: getattr(self, field.name) for field in fields(self)}
        lines = (f"  {name:<17} {shown(x)}" for name, x in parts.items() if x is not None)
        return "\n".join(["Scene", *lines])

    def _check_spectrum(self) -> None:
        subject, power = "Scene(power_spectrum=...)", self.power_spectrum
        if power is None:
            return
        one_row = power.ndim == 1 and power.size >= 1
        require(one_row, subject, "be one row of at least one value", shape_of(power))
        require_at_least(subject, power, "at least 0")
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
        spectrum = np.ones(1) if power is None else np.asarray(power)
        has_power = on_steps(spectrum, NUM_FREQUENCIES) > 0
        first = float(np.min(frequencies(NUM_FREQUENCIES), where=has_power, initial=np.inf))
        requirement = f"pass some of the picture, whose power begins at {first:.3g} cycles/px"
        require(first <= cutoff, "Scene(cutoff_frequency=...)", requirement, cutoff)

    @staticmethod
    def uniform(
        *, max_speed: float, num_speeds: int = 9, min_speed: float | None = None, **others: object
    ) -> "Scene":
        """Equally likely speeds, evenly spaced from `min_speed` (`-max_speed`) to `max_speed`.

        Args:
            max_speed: Largest speed, px/s.
            num_speeds: How many; at least 2 where the range has two ends.
            min_speed: Smallest speed, px/s; `-max_speed` by default.
            others: The arguments of `Scene`.

        Raises:
            ValueError: as `Scene`, or if the range is reversed, or has two ends and one speed.
        """
        require_positive_int("Scene.uniform(num_speeds=...)", num_speeds)
        for name, value in (("max_speed", max_speed), ("min_speed", min_speed)):
            if value is not None:
                require_finite(f"Scene.uniform({name}=...)", value)
        low = -max_speed if min_speed is None else min_speed
        ordered = low <= max_speed
        require(ordered, "Scene.uniform(max_speed=...)", f"be at least {low:g} px/s", max_speed)
        has_both_ends = num_speeds > 1 or low == max_speed
        requirement = f"be at least 2, for speeds from {low:g} to {max_speed:g} px/s"
        require(has_both_ends, "Scene.uniform(num_speeds=...)", requirement, num_speeds)
        return Scene(np.linspace(low, max_speed, num_speeds), **others)  # type: ignore[arg-type]

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "Scene":
        """Read a scene from a TOML file; see `mishutter.model.scene_file` for its keys.

        Args:
            path: The file.

        Raises:
            ValueError: if the file is not a scene; the line says which key and why.
            OSError: if it cannot be read.
        """
        from mishutter.model.scene_file import read_scene

        return read_scene(os.fspath(path))

    def along_rows(self) -> "Scene":
        """The scene of pictures that are `turned` so that things move along their rows."""
        if self.axis == "rows":
            return self
        parts = {field.name: getattr(self, field.name) for field in fields(self)}
        motion = parts.pop("given_motion")
        return Scene(**parts | {"axis": "rows", "motion": motion})

    def bare(
        self,
        speeds: ArrayLike | None = None,
        weights: ArrayLike | None = None,
        power_spectrum: RowLike | None = None,
    ) -> "Scene":
        """The numbers without what no integral sees: those of pictures, motion, rivals and stage.

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
            occlusion=self.occlusion,
        )

    def light(
        self, shutter: AbstractShutter, motion: AbstractMotion | ArrayLike
    ) -> AbstractShutter:
        """The transmittance that light sees where a profile is sent to the scene's device.

        A shutter that stays open over the whole exposure needs no device and loses nothing,
        whatever its class; every other one is seen through the device. What a device has made of a
        profile stays as it is, so that profiles and designs may be measured alike.

        Args:
            shutter: The profile.
            motion: Motion of the sensor, or its half exposure, s: how much of a profile a device
                can follow depends on that.
        """
        if self.device is None:
            return shutter
        half = motion.half_exposure if isinstance(motion, AbstractMotion) else motion
        return self.device.light(shutter, half, np.dtype(self.speeds.dtype))

    def with_occlusion(self, occlusion: Occlusion | None) -> "Scene":
        """The scene with other layers, or as one that moves as a whole, by the objects' speeds.

        Args:
            occlusion: The layers; None without any.
        """
        return eqx.tree_at(lambda s: s.occlusion, self, occlusion, is_leaf=_is_occlusion)

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
        are_concrete = self.speeds_known
        slowest, fastest = (np.asarray(x) if are_concrete else x for x in (slowest, fastest))
        return self.limits.fullest_motion((slowest + fastest) / 2)

    @property
    def speeds_known(self) -> bool:
        """Whether the speeds and weights can be looked at now, rather than being traced."""
        return is_concrete(self.speeds) and is_concrete(self.weights)

    @property
    def nothing_moves(self) -> bool:
        """Whether every speed that occurs is known to be 0."""
        if not self.speeds_known:
            return False
        return not np.any(np.asarray(self.speeds)[np.asarray(self.weights) > 0])

    @property
    def max_speed(self) -> Float[Array, ""]:
        """Largest speed of either sign that occurs; px/s."""
        slowest, fastest = self.speed_range
        if self.speeds_known:
            return as_float(np.maximum(np.abs(slowest), np.abs(fastest)))
        return jnp.maximum(jnp.abs(slowest), jnp.abs(fastest))

    @property
    def speed_range(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Smallest and largest velocity that occurs; px/s."""
        if self.speeds_known:
            speeds = np.asarray(self.speeds)[np.asarray(self.weights) > 0]
            return as_float(np.min(speeds)), as_float(np.max(speeds))
        occurs = self.weights > 0
        slowest = jnp.min(jnp.where(occurs, self.speeds, jnp.inf))
        return slowest, jnp.max(jnp.where(occurs, self.speeds, -jnp.inf))


def require_scene(scene: object) -> None:
    """Refuse an object that is not a scene, such as the path of a scene's file."""
    requirement = "be a `Scene`, as `Scene.load(path)` reads one from a file"
    require(isinstance(scene, Scene), "scene", requirement, scene)


def require_whole(scene: Scene | None, user: str) -> None:
    """Refuse a scene with a background, for a user that needs pictures that move as a whole."""
    whole = scene is None or scene.occlusion is None
    requirement = f"move as a whole for {user}, without an occlusion"
    require(whole, "scene", requirement, Unquoted("objects in front of a background"))


def _is_occlusion(part: object) -> bool:
    return part is None or isinstance(part, Occlusion)


def seen_from(scene: Scene, motion: AbstractMotion) -> tuple[Scene, AbstractMotion]:
    """A scene and a motion in the frame that pans with the sensor, where the exposure is the same.

    The velocity of the sensor is taken from all speeds. The motion has none left, and may gain
    as much less of the top speed.

    Raises:
        ValueError: if the scene is none.
    """
    require_scene(scene)
    if is_known_zero(motion.velocity):
        return scene, motion.without_velocity()
    top, pan = scene.limits.max_top_speed, scene.limits.max_pan
    dtype = common_dtype(scene.speeds, motion.velocity)
    are_concrete = all_concrete((scene.speeds, scene.limits, motion.velocity))
    space = np if are_concrete else jnp
    velocity = space.asarray(motion.velocity, dtype)
    room = space.maximum(space.asarray(top) - space.abs(velocity.astype(top.dtype)), 0)
    numbers = space.asarray(scene.speeds, dtype) - velocity, room, space.zeros_like(pan)
    if are_concrete:
        numbers = tuple(as_float(number) for number in numbers)
    places = lambda s: (s.speeds, s.limits.max_top_speed, s.limits.max_pan)  # noqa: E731
    scene = eqx.tree_at(places, scene, numbers)
    if scene.limits.pans == "stage":
        before = scene.limits.frame_velocity
        frame = velocity.astype(top.dtype)
        frame = as_float(frame if before is None else before + frame)
        scene = eqx.tree_at(
            lambda s: s.limits.frame_velocity, scene, frame, is_leaf=lambda leaf: leaf is None
        )
    if scene.tolerances is not None:
        tolerances = scene.tolerances.seen_from(velocity)
        scene = eqx.tree_at(lambda s: s.tolerances, scene, tolerances)
    if scene.occlusion is not None:
        scene = scene.with_occlusion(scene.occlusion.seen_from(velocity))
    return scene, motion.without_velocity()


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
