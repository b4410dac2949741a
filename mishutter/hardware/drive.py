r"""The drive table of a shutter: a level for each step of the exposure.

A liquid-crystal shutter is driven in equal steps of time, at one of a finite number of
levels between a floor above 0 and a ceiling below 1. The table lists the levels, and its
metrics tell the loss by them.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int

from mishutter._core.checks import common_dtype, require, require_positive_int
from mishutter._core.columns import table_text
from mishutter.design.design import Design, given_design, metrics_to_dict
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.metrics import Metrics, evaluate
from mishutter.evaluation.speed_knowledge import knowledge_of_saved
from mishutter.evaluation.views import transmittance
from mishutter.hardware.drive_files import STEPS, AbstractTable, read_drive, require_levels
from mishutter.hardware.stage_files import MAX_STEPS
from mishutter.model.motion import AbstractMotion, is_known_zero
from mishutter.model.scene import Scene, require_scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.chips import ChippedShutter
from mishutter.model.slots import diffused, slot_means


@final
@dataclass(frozen=True, eq=False, repr=False)
class DriveTable(AbstractTable):
    """Drive levels over an exposure, and the sensor's path beside them.

    Attributes:
        design: The design that is driven.
        begin: Beginning of each step, from mid-exposure; s.
        wanted: Mean over each step of the profile that the design sends.
        level: Drive level of each step.
        transmittance: Transmittance at that level, as it is sent; the scene's device turns it into
            `passed_transmittance`.
        num_levels: Number of levels.
    """

    design: Design
    begin: Float[np.ndarray, "n"]
    wanted: Float[np.ndarray, "n"]
    level: Int[np.ndarray, "n"]
    transmittance: Float[np.ndarray, "n"]
    num_levels: int

    @property
    def position(self) -> Float[np.ndarray, "n"]:
        """Position of the stage at the beginning of each step, without a pan of the camera; px."""
        return np.asarray(self._of_stage.position(self.begin))

    @property
    def velocity(self) -> Float[np.ndarray, "n"]:
        """Velocity of the stage there; px/s."""
        return np.asarray(self._of_stage.velocity_at(self.begin))

    @property
    def _of_stage(self) -> AbstractMotion:
        return self.design.scene.limits.of_stage(self.design.motion)

    def shutter(self) -> ChippedShutter:
        """The shutter that the levels send, before the scene's device."""
        return ChippedShutter(self.transmittance)

    def passed(self) -> AbstractShutter:
        """The transmittance behind the scene's device; that of the levels without a device."""
        return transmittance(self.design.scene, self.design.motion, self.shutter())

    @property
    def passed_transmittance(self) -> Float[np.ndarray, "n"]:
        """Mean over each step of the transmittance behind the scene's device."""
        dtype = common_dtype(self.design.command, self.design.motion)
        return np.asarray(slot_means(self.passed(), self.level.size, dtype), np.float64)

    @property
    def settling_time(self) -> float:
        """Time for which the shutter must stand at its first level before the exposure; s."""
        device = self.design.scene.device
        return 0.0 if device is None else float(device.settling_time)

    @property
    def gate(self) -> Bool[np.ndarray, "n"]:
        """Whether light is recorded in each step, which it is in all."""
        return np.ones(self.level.size, bool)

    @property
    def is_open(self) -> bool:
        """Whether every step has the highest level: a shutter that is open needs no drive."""
        return int(self.level.min()) == self.num_levels - 1

    def metrics(self) -> Metrics:
        """Metrics of the driven shutter on the design's motion and scene."""
        return evaluate(self.design.scene, self.design.motion, self.shutter())

    def blind_metrics(self) -> Metrics | None:
        """Metrics of the design where its stage is sent the path itself, not that of `stage_csv`.

        None where the scene does not say how its stage follows, or its limits no `stage_path`.
        """
        scene = self.design.scene
        path = scene.limits.stage_path(self.design.motion)
        if scene.limits.stage is None or path is None:
            return None
        actual = scene.limits.stage.made_of(path)
        if scene.limits.pans == "camera":
            actual = actual.panned(actual.velocity + self.design.motion.velocity)
        return evaluate(without_tolerances(scene), actual, self.design.shutter)

    def to_csv(self) -> str:
        """The table as text: a line of names, a line of units, then one a step."""
        return table_text(
            {
                ("begin", "ms"): self.begin * 1e3,
                ("wanted_transmittance", "1"): self.wanted,
                ("level", "1"): self.level,
                ("transmittance", "1"): self.transmittance,
                ("passed_transmittance", "1"): self.passed_transmittance,
                ("sensor_position", "px"): self.position,
                ("sensor_velocity", "px/s"): self.velocity,
            }
        )

    def to_dict(self) -> dict[str, object]:
        """The table and its metrics, as plain numbers."""
        blind = self.blind_metrics()
        decoder = knowledge_of_saved(self.design.loss_name, self.design.scene)
        metrics = {"metrics": self.metrics(), "metrics_of_design": self.design.metrics}
        metrics |= {} if blind is None else {"metrics_of_blind_stage": blind}
        return {
            **self.head,
            "num_levels": self.num_levels,
            "exposure_ms": float(self.design.motion.half_exposure) * 2e3,
            # Half of this, which programs may read.
            "half_exposure_ms": float(self.design.motion.half_exposure) * 1e3,
            "wanted_transmittance": self.wanted.tolist(),
            "level": self.level.tolist(),
            "transmittance": self.transmittance.tolist(),
            "passed_transmittance": self.passed_transmittance.tolist(),
            "settling_time_ms": self.settling_time * 1e3,
            "sensor_velocity_px_per_s": self.velocity.tolist(),
            "decoder_speed": decoder.name,
            **{
                name: metrics_to_dict(each) | {"psnr_of_decoder": float(decoder.psnr(each))}
                for name, each in metrics.items()
            },
        }


def drive_table(
    design: Design,
    *,
    num_steps: int | None = None,
    num_levels: int | None = None,
    floor: float = 0.0,
    ceiling: float = 1.0,
    carries_error: bool = False,
) -> DriveTable:
    r"""Levels that come nearest to a design's profile.

    Step $k$ takes the level nearest to the mean of $c\,w(\tau)$ over it, with $c$ the
    ceiling: a profile that the hardware cannot open fully keeps its shape. Level $j$ of $n$
    lets $\text{floor} + (\text{ceiling} - \text{floor})\,j/(n - 1)$ through. Where errors are
    carried, the sums of levels from the first step on are nearest instead, as one-dimensional
    error diffusion makes them: two levels then make a profile of the right light.

    Args:
        design: The design to be driven, of its one exposure: `frame_table` is of a burst.
        num_steps: Steps of the exposure, at most 100,000; by default the slots of the scene's
            device, or 256.
        num_levels: Drive levels, at least 2; by default those of the device, or 256.
        floor: Transmittance of the lowest level.
        ceiling: Transmittance of the highest level, above `floor` and at most 1.
        carries_error: Whether each step makes up for the errors of those before it.

    Raises:
        ValueError: if there is no design, or a count or a transmittance is out of its range.

    Examples:
        >>> from mishutter import Design, HannShutter, drive_table, example_scene
        >>> from mishutter.design.design import given_design
        >>> scene = example_scene()
        >>> design = given_design(scene, scene.motion, HannShutter(), "Given.")
        >>> table = drive_table(design, num_steps=100)
        >>> print(table.level.size, table.num_levels, table.level.max())
        100 256 255
    """
    require(isinstance(design, Design), "drive_table(design=...)", "be a `Design`", design)
    device = design.scene.device
    if num_steps is None:
        num_steps = (device and device.num_slots) or STEPS
    if num_levels is None:
        num_levels = (device and device.levels) or 256
    require_positive_int("drive_table(num_steps=...)", num_steps)
    is_short = num_steps <= MAX_STEPS
    require(is_short, "drive_table(num_steps=...)", f"be at most {MAX_STEPS}", num_steps)
    require_positive_int("drive_table(num_levels=...)", num_levels)
    require(num_levels >= 2, "drive_table(num_levels=...)", "be at least 2", num_levels)
    require_levels("drive_table", floor, ceiling)
    if design.sequence is not None:
        design = replace(design, sequence=None)
    half = float(design.motion.half_exposure)
    dtype = common_dtype(design.command, design.motion)
    means = np.asarray(slot_means(design.command, num_steps, dtype), np.float64)
    steps = (np.clip(ceiling * means, floor, ceiling) - floor) / (ceiling - floor)
    if carries_error:
        steps = np.asarray(diffused(steps, num_levels))
    level = np.rint(steps * (num_levels - 1)).astype(int)
    return DriveTable(
        design=design,
        begin=(np.arange(num_steps) * (2 / num_steps) - 1) * half,
        wanted=means,
        level=level,
        transmittance=floor + (ceiling - floor) * level / (num_levels - 1),
        num_levels=num_levels,
    )


def design_from_drive(
    path: str | Path,
    scene: Scene,
    motion: AbstractMotion | None = None,
    *,
    half_exposure: float | None = None,
    position_scale: float | None = None,
    floor: float = 0.0,
    ceiling: float = 1.0,
) -> Design:
    """The design of a scene's camera with a drive table; nothing is searched for.

    Args:
        path: A file that `read_drive` reads.
        scene: The scene that it is measured on.
        motion: The motion that the table was made for; the scene's by default.
        half_exposure: As in `read_drive`.
        position_scale: As in `read_drive`.
        floor: As in `read_drive`.
        ceiling: As in `read_drive`.

    Raises:
        ValueError: as `read_drive`.
        OSError: if the file cannot be read.
    """
    require_scene(scene)
    intended = scene.motion if motion is None else motion
    drive = read_drive(
        path,
        scene.limits.of_stage(intended),
        half_exposure=half_exposure,
        position_scale=position_scale,
        floor=floor,
        ceiling=ceiling,
    )
    actual = drive.motion
    if scene.limits.pans == "camera" and not is_known_zero(intended.velocity):
        actual = actual.panned(actual.velocity + intended.velocity)
    return given_design(scene, actual, drive.shutter, f"Read from {Path(path).name}.")
