"""A finished design, and the file that it is written to and read back from exactly."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Generic, TypeVar, final

import numpy as np

from mishutter._core.checks import Unquoted, require, shown
from mishutter._core.columns import table_text
from mishutter._core.files import contents, strict_json, write_text
from mishutter._core.validation import parsed, validated
from mishutter.design.schema import (
    FORMAT,
    SavedDesign,
    SavedMotion,
    SavedOneExposure,
    SavedScene,
)
from mishutter.evaluation.metrics import Metrics, SequenceMetrics, evaluate
from mishutter.evaluation.speed_knowledge import (
    KNOWN_SPEED,
    UNKNOWN_SPEED,
    is_of_worst_speed,
    knowledge_of_saved,
)
from mishutter.evaluation.views import transmittance
from mishutter.model.devices import command_of
from mishutter.model.exposures import Exposures, exposures_in_plane
from mishutter.model.frame_path import FramePath, TimedFrame
from mishutter.model.motion import AbstractMotion, FreeMotion, ParabolicMotion
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.kinds import module_of, shutter_from_dict, shutter_to_dict
from mishutter.model.shutters.polynomials import profile_of

Value = TypeVar("Value")

GIVEN = "none: the camera is given"
"""The name of the loss of a design that no search has found."""


BY_REGISTRATION = "by a decoder that registers the frames"
"""The decoder by which the level of a burst is, in words."""


class Outcome(StrEnum):
    """The end of a search: each is a sentence, and can be compared."""

    CONVERGED = "The search converged: the projected gradient is below its tolerance."
    STEPS_USED = "The search used up its steps before the projected gradient fell below tolerance."
    STALLED = "The search stopped where no step lowered the loss, short of its tolerance."
    GIVEN = "The camera is given, and was not searched for."


@final
@dataclass(frozen=True)
class OneExposure:
    """One exposure along an axis, and the search that led to it.

    Attributes:
        shutter: The transmittance behind the device.
        motion: The sensor's motion.
        loss: Final loss, at the frequencies and nodes that hold every design of the search; its
            level and that of `Design.metrics`, at those that this design needs, are both exact to
            0.01 dB. NaN of a camera that is given, as are the other numbers of a search.
        history: Smallest loss after each start, each minimisation, and each step of a polish.
        outcome: The end of the search.
        certificate: Projected-gradient norm in the unit box of designs; where limits of the
            motion meet, by the slopes that lead down on either side.
        loss_name: The loss that was minimised.
        best_start_loss: Smallest loss among the starts.
        notes: Sentences on the search or on the origin of the camera.
        straight: The best design without acceleration, where the search has set one beside
            this; it is not written to a file.
        psnr_ignoring_lag: Expected PSNR where the best design of a device that follows every
            command is sent to the scene's; dB. None where these are the same.
    """

    shutter: AbstractShutter
    motion: AbstractMotion
    loss: float = math.nan
    history: np.ndarray = field(default_factory=lambda: np.zeros(0))
    outcome: Outcome = Outcome.GIVEN
    certificate: float = math.nan
    loss_name: str = GIVEN
    best_start_loss: float = math.nan
    notes: tuple[str, ...] = ()
    straight: "Design | None" = None
    psnr_ignoring_lag: float | None = None


class _OfOne(Generic[Value]):
    """A part of the one exposure of a design, which frames alone do not have."""

    def __init__(self, part: Callable[[OneExposure], Value]):
        self._part = part

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, design: "Design", owner: type) -> Value:
        requirement = "be asked of one exposure along an axis (frames are in `.sequence`)"
        got = Unquoted("a design of frames alone")
        require(design.one is not None, f"Design.{self._name}", requirement, got)
        return self._part(design.one)  # type: ignore[arg-type]


@final
@dataclass(frozen=True)
class Design:
    """Exposures for a scene: one with its shutter, frames to take in its place, or frames alone.

    The attributes of `OneExposure` are those of the design too, which raises a `ValueError` where
    it has frames alone, as of things that move in any direction.

    Attributes:
        scene: The scene.
        sequence: The frames of a burst to take; None where one exposure is as good, or the camera
            takes none. Without them, by `dataclasses.replace`, the design is of one exposure.
        one: One exposure along an axis; None of frames alone.
        bursts: The best bursts of a sensor at rest and of one that moves, where the search has
            found them; they are not written to a file.
    """

    scene: Scene
    sequence: Exposures | None = None
    one: OneExposure | None = None
    bursts: tuple[Exposures, ...] = ()

    shutter = _OfOne(lambda one: one.shutter)
    motion = _OfOne(lambda one: one.motion)
    loss = _OfOne(lambda one: one.loss)
    history = _OfOne(lambda one: one.history)
    outcome = _OfOne(lambda one: one.outcome)
    certificate = _OfOne(lambda one: one.certificate)
    loss_name = _OfOne(lambda one: one.loss_name)
    best_start_loss = _OfOne(lambda one: one.best_start_loss)
    notes = _OfOne(lambda one: one.notes)
    straight = _OfOne(lambda one: one.straight)
    psnr_ignoring_lag = _OfOne(lambda one: one.psnr_ignoring_lag)

    def __post_init__(self) -> None:
        has_some = self.sequence is not None or self.one is not None
        require(has_some, "Design(...)", "have a `sequence` or `one` exposure", Unquoted("neither"))

    def with_one(self, **changes: object) -> "Design":
        """The design with other parts of its one exposure.

        Args:
            changes: Attributes of `OneExposure`.
        """
        return replace(self, one=replace(self.one, **changes))  # type: ignore[type-var]

    @property
    def exposures(self) -> Exposures:
        """The frames of its burst, or its one exposure."""
        return self.sequence or Exposures.of_one(self.motion, self.shutter, self.scene.limits)

    @property
    def converged(self) -> bool:
        """Whether the search met its tolerance."""
        return self.outcome is Outcome.CONVERGED

    @property
    def ending(self) -> str:
        """The end of the search and what else is to be known of it, in sentences."""
        return " ".join((self.outcome, *self.notes))

    @property
    def command(self) -> AbstractShutter:
        """The profile that is sent to the scene's device: the shutter itself without one."""
        return command_of(self.shutter)

    @cached_property
    def metrics(self) -> Metrics:
        """Its metrics on its scene, computed at the first use."""
        return evaluate(self.scene, self.motion, self.shutter)

    @property
    def levels(self) -> dict[str, float]:
        """Expected PSNR of the one exposure by each decoder that may restore it, in words; dB.

        The first is the level that the search maximised, or that of the scene's decoder.
        """
        decoder = knowledge_of_saved(self.loss_name, self.scene)
        at_worst = decoder.worst_level if is_of_worst_speed(self.loss_name) else None
        first = at_worst or decoder.judge(self.scene)
        words = decoder.words | UNKNOWN_SPEED.words | KNOWN_SPEED.words
        order = dict.fromkeys((first, *UNKNOWN_SPEED.words, KNOWN_SPEED.level))
        levels = {words[name]: getattr(self.metrics, name) for name in order}
        return {each: float(level) for each, level in levels.items() if level is not None}

    def __repr__(self) -> str:
        """The camera and its loss, or its frames; nothing has to be computed for it."""
        if self.one is None:
            return f"Design({self.sequence!r})"
        return (
            f"Design({self.shutter!r}, {self.motion!r}, loss={shown(self.loss)}, "
            f"converged={self.converged})"
        )

    def __str__(self) -> str:
        """The camera, how good it is, and how it was found; or its frames."""
        if self.one is None:
            return f"Design\n  frames    {self.exposures.text}\n  scene     {self.scene!r}"
        m, motion = self.metrics, self.motion
        stroke = self.scene.limits.of_stage(motion).stroke
        levels = "; ".join(f"{level:.2f} dB {words}" for words, level in self.levels.items())
        lines = {
            "expected": levels,
            "shutter": f"{self.shutter!r}, light {float(m.efficiency):.3f}",
            "motion": f"{motion!r}, stroke {float(stroke):.4g} px",
            **({} if self.sequence is None else {"frames": f"better: {self.sequence.text}"}),
            "kernel": f"condition {float(m.condition_number):.3g} at phase {float(m.phase):.3g} px "
            f"over {m.dft_length} points, difference {float(m.kernel_difference):.3g}, "
            f"relative {float(m.relative_kernel_difference):.3g}",
            "loss": f"{self.loss:.6g} of {self.loss_name}; {self.best_start_loss:.6g} at the best "
            f"start, gradient {self.certificate:.1e}",
            "search": self.ending,
            "scene": repr(self.scene),
        }
        return "\n".join(["Design", *(f"  {name:<9} {text}" for name, text in lines.items())])

    @property
    def frames_document(self) -> dict[str, object]:
        """The frames of its burst as plain numbers, by their name in its file."""
        if self.sequence is None:
            return {}
        name = "plane" if self.sequence.in_plane else "sequence"
        return {name: frames_to_dict(self.sequence)}

    def to_dict(self) -> dict[str, object]:
        """Everything in the design as plain numbers, lists and text."""
        if self.sequence is None:
            level_of, level = next(iter(self.levels.items()))
        else:
            level_of, level = BY_REGISTRATION, self.sequence.psnr
        law, absent = self.scene.velocities, {"plane": True, "velocities": True}
        if law is not None:
            absent = {"sequence": True, "scene": {"speeds", "weights"}}
        whole = {
            "level_db": level,
            "level_of": level_of,
            "format": FORMAT,
            "mishutter": package_version(),
            **self.frames_document,
            "scene": self.scene,
            "velocities": law,
        }
        schema = SavedDesign
        if self.one is not None:
            schema = SavedOneExposure
            whole |= vars(self.one) | {
                "shutter": shutter_to_dict(self.command) | module_of(self.command),
                "motion": motion_to_dict(self.motion),
                "metrics": metrics_to_dict(self.metrics),
                "outcome": str(self.outcome),
                "converged": self.converged,
            }
            del whole["straight"]  # it spares a comparison a search
        saved = schema.model_validate(whole, from_attributes=True).model_dump(exclude=absent)
        # Without the numbers of other kinds of motion.
        return saved | {name: whole[name] for name in ("motion", "sequence") if name in whole}

    def save(self, path: str | Path) -> None:
        """Write the design to one JSON file, whole or not at all.

        Args:
            path: The file.

        Raises:
            ValueError: if the shutter is of a kind that the file format does not know.
            OSError: if the file cannot be written.
        """
        write_text(path, strict_json(self.to_dict()) + "\n")

    @staticmethod
    def load(path: str | Path) -> "Design":
        """Read a design; its metrics are evaluated anew.

        Args:
            path: The file.

        Raises:
            ValueError: if the file is not a design of this format.
            OSError: if it cannot be read.
        """
        name = str(path)
        data = parsed(json.loads, contents(path), name, "JSON")
        is_design = isinstance(data, dict) and "format" in data
        require(is_design, name, "be a design saved by mishutter", type(data).__name__)
        require(data["format"] == FORMAT, name, f"be of design format {FORMAT}", data["format"])
        file = validated(SavedOneExposure if "shutter" in data else SavedDesign, data, name)
        try:
            return _of_file(file)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None

    @staticmethod
    def load_one(path: str | Path) -> "Design":
        """Read a design of one exposure along an axis, as `load` does.

        Args:
            path: The file.

        Raises:
            ValueError: as `load`, or if the design is of frames alone.
            OSError: if it cannot be read.
        """
        design = Design.load(path)
        got = Unquoted("a design of frames alone")
        require(
            design.one is not None, str(path), "be a design of one exposure along one axis", got
        )
        return design

    def write_profile(self, path: str | Path) -> None:
        """Write the profile as CSV with a line of units: time, normalised time, transmittance.

        Args:
            path: The file.

        Raises:
            OSError: if the file cannot be written.
        """
        tau = np.linspace(-1, 1, 1001)
        dtype = self.motion.half_exposure.dtype
        transmittance, _ = profile_of(self.shutter, tau.astype(dtype))
        time = tau * float(self.motion.half_exposure) * 1e3
        columns = {("time", "ms"): time, ("tau", "1"): tau, ("transmittance", "1"): transmittance}
        write_text(path, table_text(columns))


PlaneDesign = Design
"""The former name of a design of frames in the plane."""


def given_design(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    origin: str,
    *,
    is_measured: bool = False,
) -> Design:
    """A design of an existing camera, from hardware or measurements, without a search."""
    if is_measured and scene.device is not None:
        dtype = np.dtype(scene.speeds.dtype)
        profile = scene.device.without_lag.light(shutter, motion.half_exposure, dtype)
    else:
        profile = transmittance(scene, motion, shutter)
    return Design(scene, one=OneExposure(profile, motion, notes=(origin,)))


def package_version() -> str:
    """Version of the installed package."""
    try:
        return version("mishutter")
    except PackageNotFoundError:
        return "unknown"


def metrics_to_dict(metrics: Metrics | SequenceMetrics) -> dict[str, float | int]:
    """Metrics as plain numbers."""
    return {
        name: value if isinstance(value, int) else float(value)
        for name, value in vars(metrics).items()
        if value is not None
    }


def motion_to_dict(motion: AbstractMotion) -> dict[str, object]:
    """Kind and numbers of a motion."""
    return {
        "kind": type(motion).__name__,
        **{field.name: np.array(getattr(motion, field.name)).tolist() for field in fields(motion)},
    }


def frames_to_dict(burst: Exposures) -> dict[str, object]:
    """Kind, level and frames of a burst; on an axis the places are of the stage."""
    frames = burst.frames
    each = {"registration_loss_db": burst.registration_loss, "width_loss_db": burst.width_loss}
    losses = {name: loss for name, loss in each.items() if loss is not None}
    if isinstance(frames, FramePath):
        return {
            "kind": burst.kind,
            "num_axes": burst.num_axes,
            "psnr_db": burst.psnr,
            **losses,
            "times_s": np.asarray(frames.times).tolist(),
            "exposures_s": np.asarray(frames.exposures).tolist(),
            "piece_durations_s": np.asarray(frames.durations).tolist(),
            "velocities_px_per_s": np.asarray(frames.velocities).tolist(),
            **({"lead_s": frames.lead} if frames.lead else {}),
        }
    along = [
        {
            "time_s": frame.time,
            "position_px": frame.position,
            "motion": motion_to_dict(frame.motion),
        }
        for frame in frames
    ]
    levels = {"psnr_db": burst.psnr, "worst_speed_psnr_db": burst.worst_psnr}
    ways = {"travel_px": burst.travel, "pan_px_per_s": burst.pan}
    return {"kind": burst.kind, **ways, **levels, **losses, "frames": along}


def scene_to_dict(scene: Scene) -> dict[str, object]:
    """Numbers of a scene."""
    return SavedScene.model_validate(scene, from_attributes=True).model_dump()


def _of_file(file: SavedDesign) -> Design:
    """The design of a file."""
    if not isinstance(file, SavedOneExposure):
        law = None if file.velocities is None else file.velocities.built()
        scene = file.scene.built(velocities=law)
        return Design(scene, _frames(file, scene))
    motion = _motion(file.motion)
    scene = file.scene.built(motion=motion)
    is_end, ends = file.outcome in set(Outcome), "be the end of a search in a sentence"
    require(is_end, "outcome", ends, file.outcome)
    one = OneExposure(
        shutter=transmittance(scene, motion, shutter_from_dict(file.shutter.model_dump())),
        motion=motion,
        loss=file.loss,
        history=np.array(file.history),
        outcome=Outcome(file.outcome),
        certificate=file.certificate,
        loss_name=file.loss_name,
        best_start_loss=file.best_start_loss,
        notes=tuple(file.notes),
        psnr_ignoring_lag=file.psnr_ignoring_lag,
    )
    return Design(scene, _frames(file, scene), one)


def _frames(file: SavedDesign, scene: Scene) -> Exposures | None:
    """The frames of a file, along an axis or in the plane."""
    if (plane := file.plane) is not None:
        durations, velocities = plane.piece_durations_s, plane.velocities_px_per_s
        numbers = map(np.array, (plane.times_s, plane.exposures_s, durations, velocities))
        taken = scene, plane.kind, FramePath(*numbers, lead=plane.lead_s), plane.psnr_db
        found = exposures_in_plane(*taken, width_loss=plane.width_loss_db)
        return replace(found, registration_loss=plane.registration_loss_db)
    if (saved := file.sequence) is None:
        return None
    frames = Exposures(
        saved.kind,
        tuple(TimedFrame(_motion(one.motion), one.time_s, one.position_px) for one in saved.frames),
        saved.travel_px,
        saved.psnr_db,
        saved.worst_speed_psnr_db,
        saved.pan_px_per_s,
        saved.registration_loss_db,
        saved.width_loss_db,
    )
    return frames.for_rows(scene.sensor.readout_time, scene.limits)


def _motion(saved: SavedMotion) -> AbstractMotion:
    half, velocity = saved.half_exposure, saved.velocity
    if saved.kind == "ParabolicMotion":
        return ParabolicMotion(
            acceleration=saved.acceleration or 0.0, half_exposure=half, velocity=velocity
        )
    return FreeMotion(
        accelerations=saved.accelerations or [],
        half_exposure=half,
        velocity=velocity,
        durations=saved.durations,
    )
