"""A finished design, and the file that it is written to and read back from exactly."""

import json
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import ClassVar, TypeVar, final

import numpy as np

from mishutter._core.checks import Unquoted, require, shown
from mishutter._core.columns import table_text
from mishutter._core.files import contents, strict_json, write_text
from mishutter._core.validation import parsed, validated
from mishutter.design.schema import (
    FORMAT,
    SAVED_SCENE,
    SavedDesign,
    SavedMotion,
    SavedPlaneDesign,
    SavedSequence,
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
from mishutter.model.motion import AbstractMotion, FreeMotion, ParabolicMotion
from mishutter.model.scene import Scene
from mishutter.model.sequences import FramePath, TimedFrame
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.kinds import module_of, shutter_from_dict, shutter_to_dict
from mishutter.model.shutters.polynomials import profile_of
from mishutter.model.stages import StagePath

Kind = TypeVar("Kind", bound="AbstractDesign")

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


class AbstractDesign(ABC):
    """Exposures, and the scene that they are for.

    Attributes:
        scene: The scene.
        sequence: The frames of a burst; None of one exposure.
    """

    scene: Scene
    sequence: Exposures | None
    ways: ClassVar[str]
    """The ways of its sensor, in words."""

    @property
    @abstractmethod
    def exposures(self) -> Exposures:
        """The frames of its burst, or its one exposure."""

    @abstractmethod
    def to_dict(self) -> dict[str, object]:
        """Everything in the design as plain numbers, lists and text."""

    @property
    def frames_document(self) -> dict[str, object]:
        """The frames of its burst as plain numbers, by their name in its file."""
        if self.sequence is None:
            return {}
        name = "plane" if self.sequence.in_plane else "sequence"
        return {name: frames_to_dict(self.sequence)}

    @classmethod
    def load(cls: type[Kind], path: str | Path) -> Kind:
        """Read a design; its metrics are evaluated anew.

        Args:
            path: The file.

        Raises:
            ValueError: if the file is not a design of this format, or is one of the other class.
            OSError: if it cannot be read.
        """
        name = str(path)
        data = parsed(json.loads, contents(path), name, "JSON")
        is_design = isinstance(data, dict) and "format" in data
        require(is_design, name, "be a design saved by mishutter", type(data).__name__)
        kind = PlaneDesign if "plane" in data else Design
        if not issubclass(kind, cls):
            require(False, name, f"be a design {cls.ways}", Unquoted(f"a design {kind.ways}"))
        require(data["format"] == FORMAT, name, f"be of design format {FORMAT}", data["format"])
        file = validated(kind.schema, data, name)
        try:
            return kind.of_file(file)  # type: ignore[return-value]
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None

    def save(self, path: str | Path) -> None:
        """Write the design to one JSON file, whole or not at all.

        Args:
            path: The file.

        Raises:
            ValueError: if the shutter is of a kind that the file format does not know.
            OSError: if the file cannot be written.
        """
        write_text(path, strict_json(self.to_dict()) + "\n")


@final
@dataclass(frozen=True)
class Design(AbstractDesign):
    """A shutter and a motion, their quality, and the search that led to them.

    Attributes:
        shutter: The transmittance behind the device.
        motion: The sensor's motion.
        scene: The scene it was designed for.
        loss: Final loss, at the frequencies and nodes that hold every design of the search; its
            level and that of `metrics`, at those that this design needs, are both exact to 0.01 dB.
        history: Smallest loss after each start, each minimisation, and each step of a polish.
        outcome: The end of the search.
        notes: Sentences on the search or on the origin of the camera.
        certificate: Projected-gradient norm in the unit box of designs; where limits of the
            motion meet, by the slopes that lead down on either side.
        loss_name: The loss that was minimised.
        best_start_loss: Smallest loss among the starts.
        straight: The best design without acceleration, where the search has set one beside
            this; it is not written to a file.
        sequence: The frames of a burst to take in place of the one exposure; None where that is as
            good, or the camera takes none. Without them, by `dataclasses.replace`, the design is of
            the exposure.
        bursts: The best bursts of a sensor at rest and of one that moves, where the search has
            found them; they are not written to a file.
        psnr_ignoring_lag: Expected PSNR where the best design of a device that follows every
            command is sent to the scene's; dB. None where these are the same.
    """

    shutter: AbstractShutter
    motion: AbstractMotion
    scene: Scene
    loss: float
    history: np.ndarray
    outcome: Outcome
    certificate: float
    loss_name: str
    best_start_loss: float
    notes: tuple[str, ...] = ()
    straight: "Design | None" = None
    sequence: Exposures | None = None
    bursts: tuple[Exposures, ...] = ()
    psnr_ignoring_lag: float | None = None
    ways: ClassVar = "along one axis"
    schema: ClassVar = SavedDesign

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
        """The camera and its loss in one line, of which nothing has to be computed."""
        return (
            f"Design({self.shutter!r}, {self.motion!r}, loss={shown(self.loss)}, "
            f"converged={self.converged})"
        )

    def __str__(self) -> str:
        """The camera, how good it is, and how it was found."""
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

    def to_dict(self) -> dict[str, object]:
        """Everything in the design as plain numbers, lists and text."""
        level_of, level = next(iter(self.levels.items()))
        if self.sequence is not None:
            level_of, level = BY_REGISTRATION, self.sequence.psnr
        parts = {
            "level_db": level,
            "level_of": level_of,
            "format": FORMAT,
            "mishutter": package_version(),
            "shutter": shutter_to_dict(self.command) | module_of(self.command),
            "motion": motion_to_dict(self.motion),
            "metrics": metrics_to_dict(self.metrics),
            "outcome": str(self.outcome),
            "notes": list(self.notes),
            "converged": self.converged,
        }
        parts |= self.frames_document
        unsaved = ("straight", "bursts")  # they spare a comparison a search
        own = {name: value for name, value in vars(self).items() if name not in unsaved}
        saved = SavedDesign.model_validate(own | parts, from_attributes=True).model_dump()
        # Without the numbers of other kinds of motion.
        whole = {name: parts[name] for name in ("motion", "sequence") if name in parts}
        return saved | whole

    @staticmethod
    def of_file(file: SavedDesign) -> "Design":
        """The design of a file.

        Args:
            file: What the file says.
        """
        motion = _motion(file.motion)
        scene = file.scene.built(motion=motion)
        is_end, ends = file.outcome in set(Outcome), "be the end of a search in a sentence"
        require(is_end, "outcome", ends, file.outcome)
        return Design(
            shutter=transmittance(scene, motion, shutter_from_dict(file.shutter.model_dump())),
            motion=motion,
            scene=scene,
            loss=file.loss,
            history=np.array(file.history),
            outcome=Outcome(file.outcome),
            certificate=file.certificate,
            loss_name=file.loss_name,
            best_start_loss=file.best_start_loss,
            notes=tuple(file.notes),
            sequence=None if file.sequence is None else _sequence(file.sequence, scene),
            psnr_ignoring_lag=file.psnr_ignoring_lag,
        )

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


@final
@dataclass(frozen=True)
class PlaneDesign(AbstractDesign):
    """Frames of a sensor that moves in the plane, and the scene that they are for.

    Attributes:
        scene: The scene, of velocities in any direction.
        sequence: The frames, the path through them, and their level.
    """

    scene: Scene
    sequence: Exposures
    ways: ClassVar = "in the plane"
    schema: ClassVar = SavedPlaneDesign

    @property
    def exposures(self) -> Exposures:
        """The frames, as those of any design."""
        return self.sequence

    @property
    def frames(self) -> FramePath:
        """The frames, and the path of the sensor through them."""
        return self.sequence.frames  # type: ignore[return-value]

    @property
    def stage_paths(self) -> tuple[StagePath, ...] | None:
        """The paths of the stage along rows and columns, as `Exposures.stage_paths` has them."""
        return (*self.sequence.stage_paths(self.scene).values(),) or None

    def to_dict(self) -> dict[str, object]:
        """Everything in the design as plain numbers, lists and text."""
        whole = {
            "level_db": self.sequence.psnr,
            "level_of": BY_REGISTRATION,
            "format": FORMAT,
            "mishutter": package_version(),
            **self.frames_document,
            "scene": self.scene,
            "velocities": self.scene.velocities,
        }
        return SavedPlaneDesign.model_validate(whole, from_attributes=True).model_dump()

    @staticmethod
    def of_file(file: SavedPlaneDesign) -> "PlaneDesign":
        """The design of a file.

        Args:
            file: What the file says.
        """
        scene, saved = file.scene.built(velocities=file.velocities.built()), file.plane
        frames = FramePath(
            np.array(saved.times_s),
            np.array(saved.exposures_s),
            np.array(saved.piece_durations_s),
            np.array(saved.velocities_px_per_s),
            saved.lead_s,
        )
        taken = scene, saved.kind, frames, saved.psnr_db
        sequence = exposures_in_plane(*taken, width_loss=saved.width_loss_db)
        of_stills = saved.registration_loss_db
        return PlaneDesign(scene, replace(sequence, registration_loss=of_stills))


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
    return Design(
        shutter=profile,
        motion=motion,
        scene=scene,
        loss=np.nan,
        history=np.zeros(0),
        outcome=Outcome.GIVEN,
        notes=(origin,),
        certificate=np.nan,
        loss_name=GIVEN,
        best_start_loss=np.nan,
    )


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
    return SAVED_SCENE.model_validate(scene, from_attributes=True).model_dump()


def _sequence(saved: SavedSequence, scene: Scene) -> Exposures:
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
