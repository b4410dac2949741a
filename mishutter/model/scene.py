"""A scene: the speeds that occur, the light, the noise and the limits of the sensor."""

import inspect
import os
import tomllib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import ClassVar, final, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import (
    RowLike,
    Unquoted,
    all_concrete,
    as_float,
    as_numpy,
    common_dtype,
    device_constant,
    is_concrete,
    namespace_of,
    require,
    require_at_least,
    require_finite,
    require_number,
    require_positive_int,
    shape_of,
    shown,
)
from mishutter._core.files import contents, write_text
from mishutter._core.modules import AbstractModule, require_arguments
from mishutter._core.validation import in_section, parsed, validated
from mishutter.model.arguments import argument_names, made_of
from mishutter.model.decoder_speeds import DecoderSpeed
from mishutter.model.devices import AbstractDevice
from mishutter.model.limits import Limits
from mishutter.model.measurement_errors import MeasurementErrors
from mishutter.model.motion import AbstractMotion, ParabolicMotion, is_known_zero, steady
from mishutter.model.objects import Objects
from mishutter.model.occlusion import Occlusion
from mishutter.model.optics import NUM_FREQUENCIES, Optics, frequencies, on_steps
from mishutter.model.scene_file import (
    Textures,
    device_table,
    example_scene_text,
    file_text,
    in_file,
    scene_arguments,
    sensor_table,
    whole_numbers,
)
from mishutter.model.scene_schema import (
    BurstSection,
    ErrorsSection,
    LimitsSection,
    MotionSection,
    ObjectsSection,
    OcclusionSection,
    OpticsSection,
    SceneFile,
    StageSection,
    TolerancesSection,
)
from mishutter.model.scene_units import SceneWarning, table_of
from mishutter.model.sensor import BurstMode, Sensor
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.texture import LIKE, SHIPPED, Texture
from mishutter.model.tolerances import Tolerances
from mishutter.model.velocities import AbstractVelocities, EvenVelocities

_DOUBLE = np.dtype(np.float64)


@final
class Scene(AbstractModule):
    r"""Speeds with their weights, light, noise, and the power spectrum of what is seen.

    It assumes that all motion is along one axis of the picture, unless `any_direction` made it;
    that the picture moves as a whole, or its objects are much wider than they move while it is
    taken, unless `occlusion` describes them; that one filter restores all speeds, unless
    `decoder_speed` or registered frames provide it; and a global shutter, unless the `sensor` has a
    readout.

    Args:
        speeds: Speeds $s_i$ that occur, px/s, either sign; shape `(n,)`.
        weights: How often each occurs, on any scale; equal by default. They are divided
            by their sum.
        photon_rate: Photo-electrons a second at a white pixel; e-/s.
        read_noise: Standard deviation of the read noise $\sigma$; e-.
        picture: Statistics of pictures, and the photograph to show results on.
        optics: What the lens passes, and how it blurs.
        sensor: Full well, width and axis of the sensor, and the readout of its rows.
        limits: Limits of the stage and of the exposure.
        device: The device that makes the transmittance of every shutter but an open one from its
            command; by default one that follows every command and loses no light.
        burst: Frames that the camera may take instead of one exposure; none by default.
        tolerances: Errors of the camera as built; the expected error,
            and a search by it, are over these. None by default.
        occlusion: Objects that hide part of a background; by default the picture moves as a whole.
        objects: Objects that a decoder of several frames registers one by one, as it finds them
            in frames at rest; by default it registers the whole picture.
        errors: Errors of measured numbers, within which the gain of an answer is stated; none by
            default.
        decoder_speed: What the decoder knows of a picture's speed: `"unknown"`, one filter for all
            speeds; `"found"`, which a `SpeedFindingDecoder` finds in the picture, where that moves
            as a whole; or `"known"`, as something measures it. The loss of searches and comparisons
            is by default the expected error of that decoder.
        motion: Motion to start from or to compare at; by default the `fullest_motion` of the
            limits about the middle of the speeds.
        velocities: The law of velocities in any direction that `any_direction` has, of which
            `speeds` then are the components along the axis of the fastest; None along one axis.
        given_motion: The `motion` of another scene, as `dataclasses.replace` hands it on.

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
    picture: Texture
    optics: Optics
    sensor: Sensor
    limits: Limits
    device: AbstractDevice | None
    burst: BurstMode | None
    tolerances: Tolerances | None
    occlusion: Occlusion | None
    objects: Objects | None
    errors: MeasurementErrors | None
    velocities: AbstractVelocities | None
    given_motion: AbstractMotion | None
    decoder_speed: DecoderSpeed = eqx.field(static=True)
    handed_on: ClassVar = ("given_motion", "velocities")

    def __init__(
        self,
        speeds: RowLike,
        weights: RowLike | None = None,
        *,
        photon_rate: ArrayLike,
        read_noise: ArrayLike,
        picture: Texture | None = None,
        optics: Optics | None = None,
        sensor: Sensor | None = None,
        limits: Limits | None = None,
        device: AbstractDevice | None = None,
        burst: BurstMode | None = None,
        tolerances: Tolerances | None = None,
        occlusion: Occlusion | None = None,
        objects: Objects | None = None,
        errors: MeasurementErrors | None = None,
        decoder_speed: DecoderSpeed = "unknown",
        motion: AbstractMotion | None = None,
        velocities: AbstractVelocities | None = None,
        given_motion: AbstractMotion | None = None,
    ):
        self.speeds = as_float(speeds, "Scene(speeds=...)")
        count = max(self.speeds.size, 1)
        equal = np.full(self.speeds.shape, 1 / count, self.speeds.dtype)
        self.weights = _normalised(equal if weights is None else weights)
        self.photon_rate = as_float(photon_rate, "Scene(photon_rate=...)")
        self.read_noise = as_float(read_noise, "Scene(read_noise=...)")
        self.picture = Texture() if picture is None else picture
        self.optics = Optics() if optics is None else optics
        self.sensor = Sensor() if sensor is None else sensor
        self.limits = Limits() if limits is None else limits
        self.device = device
        self.burst = burst
        self.tolerances = tolerances
        self.occlusion = occlusion
        self.objects = objects
        self.errors = errors
        self.decoder_speed = decoder_speed
        self.velocities = velocities
        self.given_motion = given_motion if motion is None else motion

    def __check_init__(self) -> None:
        shape = self.speeds.shape
        one_row, requirement = len(shape) == 1 and shape[0] >= 1, "be one row of at least one speed"
        require(one_row, "Scene(speeds=...)", requirement, shape_of(self.speeds))
        require_finite("Scene(speeds=...)", self.speeds)
        matches = self.weights.shape == shape
        require(matches, "Scene(weights=...)", f"have shape {shape}", self.weights.shape)
        require_at_least("Scene(weights=...)", self.weights, "at least 0")
        if is_concrete(self.weights):
            some = bool(np.any(np.asarray(self.weights) > 0))
            require(some, "Scene(weights=...)", "hold one above 0", self.weights)
        for name in ("photon_rate", "read_noise"):
            value = getattr(self, name)
            require_number(f"Scene({name}=...)", value, "at least 0")
        for name, kind, requirement in (
            ("picture", Texture, "be a `Texture`"),
            ("optics", Optics, "be `Optics`"),
            ("sensor", Sensor, "be a `Sensor`"),
            ("limits", Limits, "be `Limits`"),
            ("burst", BurstMode | None, "be a `BurstMode`"),
            ("tolerances", Tolerances | None, "be `Tolerances`"),
            ("occlusion", Occlusion | None, "be an `Occlusion`"),
            ("objects", Objects | None, "be `Objects`"),
            ("errors", MeasurementErrors | None, "be `MeasurementErrors`"),
            ("velocities", AbstractVelocities | None, "be velocities, as `EvenVelocities`"),
            ("device", AbstractDevice | None, "be a device, as an `IdealDevice`"),
        ):
            value = getattr(self, name)
            require(isinstance(value, kind), f"Scene({name}=...)", requirement, value)
        self._check_power_below()
        *others, last = map(repr, get_args(DecoderSpeed))
        requirement = f"be {', '.join(others)} or {last}"
        is_valid = self.decoder_speed in get_args(DecoderSpeed)
        require(is_valid, "Scene(decoder_speed=...)", requirement, self.decoder_speed)
        whole = self.occlusion is None or self.decoder_speed != "found"
        words = "be 'unknown' or 'known': no single speed describes a picture with a background"
        require(whole, "Scene(decoder_speed=...)", words, self.decoder_speed)
        is_valid = isinstance(self.given_motion, AbstractMotion | None)
        require(is_valid, "Scene(motion=...)", "be a motion", self.given_motion)
        if self.burst is not None:
            self.sensor.require_read_within("Sensor(readout=...)", self.burst)
        for doubt in self._doubts():
            warnings.warn(doubt, SceneWarning, stacklevel=3)

    def __repr__(self) -> str:
        """The speeds and the light in one line; `str` has everything."""
        few = ("speeds", "photon_rate", "read_noise")
        return f"Scene({', '.join(f'{name}={shown(getattr(self, name))}' for name in few)})"

    def __str__(self) -> str:
        """Everything that the scene has, one part a line."""
        parts = {field.name: getattr(self, field.name) for field in fields(self)}
        lines = (f"  {name:<17} {shown(x)}" for name, x in parts.items() if x is not None)
        return "\n".join(["Scene", *lines])

    def _doubts(self) -> Iterator[str]:
        """Numbers that no camera has."""
        well, width, noise = self.sensor.full_well, self.sensor.width, self.read_noise
        if well is not None and all_concrete((well, noise)) and float(well) < float(noise):
            yield f"a pixel is full at {float(well):g} e-, below {float(noise):g} e- of read noise"
        if width is not None and is_concrete(width) and float(width) < 16:
            yield f"the sensor is {float(width):g} px wide"

    def _check_power_below(self) -> None:
        """Refuses a lens that passes nothing of the picture."""
        power, cutoff, deviation = _numbers_of_power(self)
        if not all_concrete((power, cutoff, deviation)) or float(deviation) == 0:
            return
        spectrum = np.ones(1) if power is None else np.asarray(power)
        has_power = on_steps(spectrum, NUM_FREQUENCIES) > 0
        first = float(np.min(frequencies(NUM_FREQUENCIES), where=has_power, initial=np.inf))
        requirement = f"pass some of the picture, whose power begins at {first:.3g} cycles/px"
        got = Unquoted(f"a cutoff of {float(cutoff):g}")
        require(first <= float(cutoff), "Scene(optics=...)", requirement, got)

    @staticmethod
    def uniform(
        *, max_speed: float, num_speeds: int = 9, min_speed: float | None = None, **others: object
    ) -> "Scene":
        """Equally likely speeds, evenly spaced from `min_speed` (`-max_speed`) to `max_speed`.

        Args:
            max_speed: Largest speed, px/s.
            num_speeds: How many; at least 2 where the range has two ends.
            min_speed: Smallest speed, px/s; `-max_speed` by default.
            others: The other arguments of `Scene`.

        Raises:
            ValueError: as `Scene`, or if the range is reversed, or has two ends and one speed.
        """
        own = tuple(inspect.signature(Scene.uniform).parameters)[:-1]
        known = (*own, *argument_names(Scene)[1:])
        require_arguments("Scene.uniform", others, known)
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
        return made_of(Scene, {"speeds": np.linspace(low, max_speed, num_speeds)} | others)

    @staticmethod
    def any_direction(
        velocities: AbstractVelocities | ArrayLike | None = None,
        *,
        max_speed: ArrayLike | None = None,
        **others: object,
    ) -> "Scene":
        """A scene whose things move in any direction of the picture.

        Args:
            velocities: Their law: `EvenVelocities`, `RingOfVelocities` or `ListedVelocities`; or a
                number, px/s, of a disc that is filled evenly up to that speed.
            max_speed: That number by its name, in place of the law.
            others: The other arguments of `Scene`, but for speeds and weights.

        Raises:
            ValueError: as `Scene`, or if it has parts that are known along one axis alone:
                tolerances, a motion, or a background that moves.
        """
        known = [name for name in argument_names(Scene)[2:] if name != "velocities"]
        require_arguments("Scene.any_direction", others, known)
        for name in ("tolerances", "motion"):
            subject, part = f"Scene.any_direction({name}=...)", others.get(name)
            require(part is None, subject, "be left to one axis", part)
        layers = others.get("occlusion")
        if isinstance(layers, Occlusion):
            requirement = "be 'still'; without an occlusion every part of a picture moves"
            subject = "Occlusion(background=...)"
            require(layers.background != "moving", subject, requirement, layers.background)
        name, law = "velocities", velocities
        if max_speed is not None:
            require(law is None, "Scene.any_direction(velocities=...)", "be left to max_speed", law)
            name, law = "max_speed", max_speed
        if not isinstance(law, AbstractVelocities):
            subject = f"Scene.any_direction({name}=...)"
            require(law is not None, subject, "be given, or `max_speed`", law)
            law = EvenVelocities(as_float(law, subject))  # type: ignore[arg-type]
        along = np.array([law.axis if all_concrete(law) else 0.0])
        parts = law.components(along, 16)  # speeds that stand for the law along its axis
        own = {"speeds": parts.speeds[0], "weights": parts.weights[0], "velocities": law}
        # No single velocity describes a picture with a background.
        knows: dict[str, object] = {} if layers is not None else {"decoder_speed": "found"}
        return made_of(Scene, knows | others | own)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "Scene":
        """Read a scene from a TOML file; see `mishutter.model.scene_file` for its keys.

        Args:
            path: The file.

        Raises:
            ValueError: if the file is not a scene; the line says which key and why.
            OSError: if it cannot be read.
        """
        return read_scene(os.fspath(path))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the scene to a TOML file, whole or not at all; `Scene.load` reads it.

        A photograph is told by its path, and read again with the scene.

        Args:
            path: The file.

        Raises:
            ValueError: if a file cannot hold a part, as a motion that is no parabola, or a power
                spectrum that is no photograph's, or a number is out of the range of its key.
            OSError: if the file cannot be written.
        """
        text, name = scene_text(self), os.fspath(path)
        read = scene_of_tables(tomllib.loads(text), name, Path(), lambda *_: self.picture)
        double = lambda x: np.asarray(x, np.float64) if eqx.is_array(x) else x  # noqa: E731
        for field in fields(Scene):
            part = "motion" if field.name == "given_motion" else field.name
            own = getattr(self, field.name)
            pair = (jax.tree.map(double, each) for each in (own, getattr(read, field.name)))
            # Every device has keys, though some are of another class that shows the same light.
            is_held = part == "device" or bool(eqx.tree_equal(*pair, rtol=1e-6))
            require(is_held, f"Scene({part}=...)", "be one that a scene file holds", own)
        write_text(name, text)

    def along_rows(self) -> "Scene":
        """The scene of pictures that are `transposed` so that things move along their rows."""
        return replace(self, sensor=replace(self.sensor, axis="rows"))

    def without_metadata(
        self,
        speeds: ArrayLike | None = None,
        weights: ArrayLike | None = None,
        power_spectrum: RowLike | None = None,
    ) -> "Scene":
        """The scene without the parts that no integral along its axis sees.

        They are the photograph, the width, axis and readout of the sensor, the answer of the stage,
        the burst, objects, errors, the speed that the decoder knows, and a motion that is given.

        Args:
            speeds: Speeds in place of the scene's own, with their `weights`.
            weights: How often each occurs.
            power_spectrum: Power in place of the scene's own.
        """
        return replace(
            self,
            speeds=self.speeds if speeds is None else speeds,
            weights=self.weights if weights is None else weights,
            picture=self.picture.without_metadata(power_spectrum),
            sensor=Sensor(full_well=self.sensor.full_well),
            # No integral sees the answer of the stage; what a pan leaves of the top speed may be 0.
            limits=eqx.tree_at(lambda x: x.stage, self.limits, None, is_leaf=lambda x: x is None),
            burst=None,
            objects=None,
            errors=None,
            decoder_speed="unknown",
            velocities=None,
            given_motion=None,
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
        return eqx.tree_at(lambda s: s.occlusion, self, occlusion, is_leaf=lambda x: x is None)

    def without_pan(self) -> "Scene":
        """The scene with a sensor that may not pan."""
        return eqx.tree_at(lambda s: s.limits.max_pan, self, jnp.zeros_like(self.limits.max_pan))

    @property
    def motion(self) -> AbstractMotion:
        """The motion to start from or to compare at: that given, or the fullest within limits."""
        return self.fullest_motion if self.given_motion is None else self.given_motion

    @property
    def fullest_motion(self) -> ParabolicMotion:
        """The `fullest_motion` of the limits about the middle of the speeds."""
        slowest, fastest = as_numpy(*self.speed_range)
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
    def is_found_by_object(self) -> bool:
        """Whether a picture holds things of several velocities, found in frames at rest alone."""
        if self.occlusion is not None:
            return True
        several = self.velocities is not None or float(np.ptp(self.speeds)) > 0
        return self.objects is not None and several

    @property
    def registered_width(self) -> float | None:
        """Width within which frames are registered, of the sensor or an object; px. None: any."""
        widths = [part.width for part in (self.sensor, self.objects) if part is not None]
        return min((float(width) for width in widths if width is not None), default=None)

    @property
    def max_speed(self) -> Float[Array, ""]:
        """Largest speed of either sign that occurs; px/s."""
        if self.velocities is not None and all_concrete(self.velocities):
            return as_float(self.velocities.fastest)
        slowest, fastest = as_numpy(*self.speed_range)
        return as_float(namespace_of(slowest, fastest).maximum(abs(slowest), abs(fastest)))

    @property
    def speed_range(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Smallest and largest velocity that occurs; px/s."""
        speeds, weights = as_numpy(self.speeds, self.weights)
        space, occurs = namespace_of(speeds, weights), weights > 0
        slowest, fastest = (space.where(occurs, speeds, x) for x in (np.inf, -np.inf))
        return as_float(space.min(slowest)), as_float(space.max(fastest))


def require_velocities(scene: Scene) -> AbstractVelocities:
    """The law of a scene's velocities; an error where it is of one axis."""
    law = scene.velocities
    requirement = "have velocities in any direction, as `Scene.any_direction` makes it"
    require(law is not None, "scene", requirement, scene)
    return law  # type: ignore[return-value]


def require_scene(scene: object, *, in_plane: bool = False) -> None:
    """Refuse an object that is not a scene, such as the path of a scene's file."""
    requirement = "be a `Scene`, as `Scene.load(path)` reads one from a file"
    require(isinstance(scene, Scene), "scene", requirement, scene)
    require_known_numbers(scene)  # type: ignore[arg-type]
    if not in_plane:
        require_one_axis(scene)  # type: ignore[arg-type]


def require_known_numbers(scene: Scene) -> None:
    """Refuse NaN that a function as `eqx.tree_at` has put into a scene; limits may be infinite."""
    for path, value in jax.tree_util.tree_leaves_with_path(scene):
        if is_concrete(value) and np.asarray(value).dtype.kind == "f":
            subject, is_defined = jax.tree_util.keystr(path), not np.isnan(value).any()
            require(is_defined, f"scene{subject}", "be a number", value)


def require_one_axis(scene: Scene) -> None:
    """Refuse a scene of any direction, for what computes along one axis alone."""
    law = scene.velocities
    requirement = (
        "move along one axis here; `optimise` searches for others, `best_in_plane` in Python"
    )
    require(law is None, "scene", requirement, Unquoted("" if law is None else law.words))


def require_whole(scene: Scene | None, user: str) -> None:
    """Refuse a scene with a background, for a user that needs pictures that move as a whole."""
    whole = scene is None or scene.occlusion is None
    requirement = f"move as a whole for {user}, without an occlusion"
    require(whole, "scene", requirement, Unquoted("objects in front of a background"))


def in_sensor_frame(scene: Scene, motion: AbstractMotion) -> tuple[Scene, AbstractMotion]:
    """A scene and a motion in the frame that pans with the sensor, where the exposure is the same.

    The velocity of the sensor is subtracted from all speeds. The motion has none left, and the
    limit on its top speed falls by as much.
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
        place = lambda s: s.limits.frame_velocity  # noqa: E731
        scene = eqx.tree_at(place, scene, frame, is_leaf=lambda x: x is None)
    if scene.tolerances is not None:
        tolerances = scene.tolerances.in_sensor_frame(velocity)
        scene = eqx.tree_at(lambda s: s.tolerances, scene, tolerances)
    if scene.occlusion is not None:
        scene = scene.with_occlusion(scene.occlusion.in_sensor_frame(velocity))
    return scene, motion.without_velocity()


def picture_power(
    scene: Scene, num_frequencies: int, dtype: np.dtype
) -> Float[Array, "{num_frequencies}"]:
    """The `power_on_grid` of a scene that may be traced."""
    if all_concrete((_numbers_of_power(scene), scene.occlusion)):
        return device_constant(power_on_grid(scene, num_frequencies, dtype))
    return jnp.asarray(_power(scene, num_frequencies, dtype))


def power_on_grid(
    scene: Scene, num_frequencies: int, dtype: np.dtype = _DOUBLE
) -> Float[np.ndarray, "{num_frequencies}"]:
    r"""Power spectrum of the picture's rows at `frequencies`, none above the cutoff of the optics.

    It is scaled so that $2\int_0^{1/2} S\,df$, its mean over the frequencies, is the variance.
    """
    return np.asarray(_power(scene, num_frequencies, dtype))


def _power(
    scene: Scene, num_frequencies: int, dtype: np.dtype
) -> Float[Array | np.ndarray, "{num_frequencies}"]:
    if scene.occlusion is not None and scene.occlusion.shares is not None:
        return scene.occlusion.shares.power.astype(dtype)
    space = np if all_concrete(_numbers_of_power(scene)) else jnp
    deviation = space.asarray(scene.picture.deviation, dtype)
    return power_of_contrast(scene, num_frequencies, dtype) * deviation**2


def power_of_contrast(
    scene: Scene, num_frequencies: int, dtype: np.dtype = _DOUBLE
) -> Float[Array | np.ndarray, "{num_frequencies}"]:
    """The `power_on_grid` of pictures of the deviation 1; by NumPy where they are concrete."""
    numbers = _numbers_of_power(scene)
    space = np if all_concrete(numbers) else jnp
    spectrum = scene.picture.spectrum_on_grid(num_frequencies, dtype)
    frequency = frequencies(num_frequencies).astype(dtype)
    power = space.where(frequency <= space.asarray(numbers[1], dtype), spectrum, 0)
    total = space.mean(power)
    return power / space.where(total > 0, total, 1.0)


def _numbers_of_power(scene: Scene) -> tuple[Array | None, Array, Array]:
    """The numbers that the power follows from."""
    picture = scene.picture
    return picture.power_spectrum, scene.optics.cutoff_frequency, picture.deviation


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


def read_scene(path: str | Path) -> Scene:
    """Read a scene from a TOML file.

    Args:
        path: The file; relative paths in it are taken from its folder.

    Raises:
        ValueError: if the file is not a scene; the line names the key, what must hold
            and what came.
        OSError: if the file or its picture cannot be read.
    """
    place = Path(path)
    return _scene(contents(place), str(path), place.parent)


def example_scene() -> Scene:
    """The built-in scene: fast objects in both directions, in dim light, one photograph."""
    return _scene(example_scene_text().encode(), "example_scene.toml", Path())


def _scene(data: bytes, name: str, folder: Path) -> Scene:
    return scene_of_tables(parsed(tomllib.loads, data, name, "TOML"), name, folder)


def scene_of_tables(
    tables: object, name: str, folder: Path, textures: Textures | None = None
) -> Scene:
    """The scene of a file's tables."""
    file = validated(SceneFile, tables, name, in_section)
    with in_file(name):
        arguments = scene_arguments(file, folder, textures)
        if "velocities" in arguments:
            return Scene.any_direction(**arguments)
        return made_of(Scene, arguments)


def scene_text(scene: Scene, notes: Mapping[str, Sequence[str]] | None = None) -> str:
    """A scene as the text of a file that `read_scene` reads.

    A photograph is told by its whole path, and read again with the scene. Without one a power
    spectrum, and a motion that is no parabola, have no keys, and are left out.
    """
    return file_text(scene_tables(scene), "scene_text(scene=...)", notes or {})


def scene_tables(scene: Scene) -> dict[str, dict[str, object]]:
    """The tables of the file of a scene, in pixels, electrons and parts of a second."""
    parts = {
        "optics": (scene.optics, OpticsSection),
        "limits": (scene.limits, LimitsSection),
        "occlusion": (scene.occlusion, OcclusionSection),
        "objects": (scene.objects, ObjectsSection),
        "errors": (scene.errors, ErrorsSection),
        "stage": (scene.limits.stage, StageSection),
        "burst": (scene.burst, BurstSection),
        "tolerances": (scene.tolerances, TolerancesSection),
    }
    tables: dict[str, dict[str, object]] = {
        name: table_of(part, section) for name, (part, section) in parts.items() if part is not None
    }
    tables["limits"] = whole_numbers(tables["limits"])
    if scene.velocities is None:
        tables["speeds"] = {
            "list_px_per_s": scene.speeds.tolist(),
            "weights": scene.weights.tolist(),
        }
    else:
        tables["speeds"] = {"any_direction": scene.velocities.table}
    tables["light"] = {"photon_rate_per_s": float(scene.photon_rate)}
    tables["sensor"] = {"read_noise_e": float(scene.read_noise)}
    tables["sensor"] |= sensor_table(scene.sensor)
    tables["decoder"] = {"speed": scene.decoder_speed}
    if scene.device is not None:
        tables["shutter"] = device_table(scene.device)
    if scene.given_motion is not None and scene.given_motion.accelerates_constantly:
        tables["motion"] = whole_numbers(table_of(steady(scene.given_motion), MotionSection))
    picture = scene.picture
    if picture.path is None:
        tables["picture"] = {
            "mean_level": float(picture.mean_level),
            "deviation": float(picture.deviation),
        }
    elif picture.path in LIKE:
        tables["picture"] = {"like": picture.path}
    else:
        # A file in any folder may hold the path from the root.
        is_shipped = picture.path in SHIPPED
        tables["picture"] = {
            "path": picture.path if is_shipped else str(Path(picture.path).absolute()),
            "white": picture.white,
            "linear": picture.linear or None,
        }
    if not scene.limits.moves:
        tables["limits"]["max_stroke_px"] = 0.0
    if scene.velocities is None and scene.limits.axes == "each":
        del tables["limits"]["axes"]
    # A section refuses each of these numbers without the one that it goes with.
    if scene.occlusion is not None and not scene.occlusion.has_edges:
        del tables["occlusion"]["level_difference"]
    if scene.tolerances is not None and float(scene.tolerances.drive_step) == 0:
        del tables["tolerances"]["drive_step_us"]
    return tables
