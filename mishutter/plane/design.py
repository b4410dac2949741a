"""A design of frames in the plane, and the file that it is written to and read back from."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, final

import numpy as np
from pydantic import Field, model_validator

from mishutter._core.checks import Unquoted, require
from mishutter._core.files import contents
from mishutter._core.validation import parsed, validated
from mishutter.design.design import AbstractDesign, Design, package_version
from mishutter.design.schema import FORMAT, Result
from mishutter.model.arguments import Part, arguments_of, table_of
from mishutter.model.scene import Scene
from mishutter.model.stages import StagePath
from mishutter.model.velocities import AbstractVelocities
from mishutter.plane.bursts import PlaneBurst, burst_of
from mishutter.plane.frames import PlaneFrames

Row = list[float]


@final
@dataclass(frozen=True)
class PlaneDesign(AbstractDesign):
    """Frames of a sensor that moves in the plane, and the scene that they are for.

    Attributes:
        scene: The scene, of velocities in any direction.
        burst: The frames, the path through them, and their level.
    """

    scene: Scene
    burst: PlaneBurst

    @property
    def exposures(self) -> PlaneBurst:
        """The frames, as those of any design."""
        return self.burst

    @property
    def sequence(self) -> PlaneBurst:
        """The same: it has no exposure in their place."""
        return self.burst

    @property
    def frames(self) -> PlaneFrames:
        """The frames, and the path of the sensor through them."""
        return self.burst.frames

    @property
    def stage_paths(self) -> tuple[StagePath, ...] | None:
        """The paths of the stage along rows and columns, as `PlaneBurst.stage_paths` has them."""
        return (*self.burst.stage_paths(self.scene).values(),) or None

    @property
    def frames_document(self) -> dict[str, Any]:
        """The frames as plain numbers, by their name in its file."""
        return {"plane": burst_to_dict(self.burst)}

    def to_dict(self) -> dict[str, Any]:
        """Everything in the design as plain numbers, lists and text."""
        whole = {
            "level_db": self.burst.psnr,
            "format": FORMAT,
            "mishutter": package_version(),
            **self.frames_document,
            "scene": self.scene,
            "velocities": self.scene.velocities,
        }
        return _SavedDesign.model_validate(whole, from_attributes=True).model_dump()

    @staticmethod
    def load(path: str | Path) -> "PlaneDesign":
        """Read a design, as `mishutter optimise` writes it for things that move in any direction.

        Args:
            path: The file.

        Raises:
            ValueError: if the file is not a design in the plane of this format.
            OSError: if it cannot be read.
        """
        design = design_of(path)
        requirement = "be of things that move in any direction; `Design.load` reads this one"
        is_in_plane = isinstance(design, PlaneDesign)
        require(is_in_plane, str(path), requirement, Unquoted("a design along one axis"))
        return design  # type: ignore[return-value]


def design_of(path: str | Path) -> "Design | PlaneDesign":
    """Read a saved design, of one axis or of the plane, as the file has it.

    Raises:
        ValueError: if the file is not a design of this format.
        OSError: if it cannot be read.
    """
    name = str(path)
    data = parsed(json.loads, contents(path), name, "JSON")
    if not isinstance(data, dict) or "plane" not in data:
        return Design.load(path)
    file = validated(_SavedDesign, data, name)
    require(file.format == FORMAT, name, f"be of design format {FORMAT}", file.format)
    try:
        scene = file.scene.built(velocities=file.velocities.built())
        return PlaneDesign(scene, _burst(file.plane, scene))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def burst_to_dict(burst: PlaneBurst) -> dict[str, Any]:
    """Kind, level, frames and path of a burst."""
    frames = burst.frames
    return {
        "kind": burst.kind,
        "num_axes": burst.num_axes,
        "psnr_db": burst.psnr,
        "width_loss_db": burst.width_loss,
        "times_s": np.asarray(frames.times).tolist(),
        "exposures_s": np.asarray(frames.exposures).tolist(),
        "piece_durations_s": np.asarray(frames.durations).tolist(),
        "velocities_px_per_s": np.asarray(frames.velocities).tolist(),
        **({"lead_s": frames.lead} if frames.lead else {}),
    }


def _burst(saved: "_SavedFrames", scene: Scene) -> PlaneBurst:
    frames = PlaneFrames(
        np.array(saved.times_s),
        np.array(saved.exposures_s),
        np.array(saved.piece_durations_s),
        np.array(saved.velocities_px_per_s),
        saved.lead_s,
    )
    return burst_of(
        scene, saved.kind, saved.num_axes, frames, saved.psnr_db, width_loss=saved.width_loss_db
    )


@final
class _SavedScene(arguments_of(Scene, "motion", "speeds", "weights")):  # type: ignore[misc]
    """The arguments of a scene of any direction."""

    made: ClassVar = staticmethod(Scene.any_direction)


@final
class _SavedFrames(Part):
    """Frames in the plane, and their level."""

    kind: str
    num_axes: Annotated[int, Field(ge=0, le=2)]
    psnr_db: Result
    width_loss_db: float | None = None
    times_s: Annotated[Row, Field(min_length=1)]
    exposures_s: Annotated[Row, Field(min_length=1)]
    piece_durations_s: Annotated[Row, Field(min_length=1)]
    velocities_px_per_s: Annotated[list[Row], Field(min_length=2, max_length=2)]
    lead_s: float = 0.0

    @model_validator(mode="after")
    def _is_whole(self) -> "_SavedFrames":
        count, ends = len(self.times_s), len(self.piece_durations_s) + 1
        if len(self.exposures_s) != count:
            raise ValueError(f"{count} frames have as many exposures")
        if any(len(row) != ends for row in self.velocities_px_per_s):
            raise ValueError(f"{ends - 1} pieces have {ends} velocities along each axis")
        return self


@final
class _SavedDesign(Part):
    """A whole design; its level stands first for whoever reads the file."""

    level_db: object = None
    format: int
    mishutter: str = "unknown"
    plane: _SavedFrames
    scene: _SavedScene
    velocities: table_of(AbstractVelocities)  # type: ignore[valid-type]
