"""The schema by which a design's file is written and checked."""

import math
from typing import Annotated, ClassVar, Literal, final

from pydantic import (
    AllowInfNan,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    model_validator,
)

from mishutter.model.arguments import Part, arguments_of, table_of
from mishutter.model.scene import Scene
from mishutter.model.velocities import AbstractVelocities

FORMAT = 2
"""Version of the file format."""


def _read_back(value: object) -> object:
    """A number as it was before `strict_json`, which has no token for some."""
    if not isinstance(value, str | None):
        return value
    return {"Infinity": math.inf, "-Infinity": -math.inf, None: math.nan}.get(value, value)


Result = Annotated[float, AllowInfNan(), BeforeValidator(_read_back)]
"""A computed number, which may be infinite, or NaN of a camera that was not searched for."""


@final
class SavedShutter(BaseModel):
    """A kind of profile, as it is sent to the device, and its parameters, which it checks."""

    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False, frozen=True)

    kind: str


@final
class SavedMotion(Part):
    """A motion and its numbers."""

    kind: Literal["ParabolicMotion", "FreeMotion"]
    acceleration: float | None = None
    accelerations: list[float] | None = None
    durations: list[float] | None = None
    half_exposure: float
    velocity: float = 0.0

    @model_validator(mode="after")
    def _is_whole(self) -> "SavedMotion":
        name = "accelerations" if self.kind == "FreeMotion" else "acceleration"
        if getattr(self, name) is None:
            raise ValueError(f"a {self.kind} has a number for {name}")
        return self


@final
class SavedFrame(Part):
    """A frame of a sequence: its mid-exposure, and place and motion of the sensor."""

    time_s: float
    position_px: float
    motion: SavedMotion


@final
class SavedSequence(Part):
    """Frames of a burst, and their level."""

    kind: str
    travel_px: float
    pan_px_per_s: float = 0.0
    psnr_db: Result
    worst_speed_psnr_db: Result
    registration_loss_db: float | None = None
    width_loss_db: float | None = None
    frames: Annotated[list[SavedFrame], Field(min_length=1)]


@final
class SavedPlaneBurst(Part):
    """Frames in the plane with the path through them, and their level."""

    kind: str
    num_axes: Annotated[int, Field(ge=0, le=2)]
    psnr_db: Result
    registration_loss_db: float | None = None
    width_loss_db: float | None = None
    times_s: Annotated[list[float], Field(min_length=1)]
    exposures_s: Annotated[list[float], Field(min_length=1)]
    piece_durations_s: Annotated[list[float], Field(min_length=1)]
    velocities_px_per_s: Annotated[list[list[float]], Field(min_length=2, max_length=2)]
    lead_s: float = 0.0

    @model_validator(mode="after")
    def _is_whole(self) -> "SavedPlaneBurst":
        count, ends = len(self.times_s), len(self.piece_durations_s) + 1
        if len(self.exposures_s) != count:
            raise ValueError(f"{count} frames have as many exposures")
        if any(len(row) != ends for row in self.velocities_px_per_s):
            raise ValueError(f"{ends - 1} pieces have {ends} velocities along each axis")
        return self


SAVED_SCENE = arguments_of(Scene, "motion")
"""The arguments of `Scene`, but for the motion, which has a table of its own."""


@final
class SavedPlaneScene(arguments_of(Scene, "motion", "speeds", "weights")):  # type: ignore[misc]
    """The arguments of a scene of any direction, whose law of velocities has a table of its own."""

    made: ClassVar = staticmethod(Scene.any_direction)


class SavedExposures(Part):
    """The part that files of all designs share; the level stands first, for whoever reads it."""

    level_db: object = None
    level_of: object = None
    format: int
    mishutter: str = "unknown"


@final
class SavedPlaneDesign(SavedExposures):
    """Frames in the plane, and their scene."""

    plane: SavedPlaneBurst
    scene: SavedPlaneScene
    velocities: table_of(AbstractVelocities)  # type: ignore[valid-type]


@final
class SavedDesign(SavedExposures):
    """A whole design; its level and metrics are for whoever reads the file, and evaluated anew."""

    shutter: SavedShutter
    motion: SavedMotion
    sequence: SavedSequence | None = None
    scene: SAVED_SCENE  # type: ignore[valid-type]
    loss: Result
    loss_name: str
    best_start_loss: Result
    metrics: object = None
    history: list[Result]
    converged: bool
    outcome: str
    notes: list[str] = Field(default_factory=list)
    certificate: Result
    psnr_ignoring_lag: Result | None = None
