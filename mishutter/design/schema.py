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

from mishutter._core.checks import RowLike, Unquoted, require
from mishutter.model.arguments import Part, arguments_of, made_of, table_of
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


def _scene(
    *,
    speeds: RowLike | None,
    weights: RowLike | None,
    velocities: AbstractVelocities | None = None,
    **others: object,
) -> Scene:
    """The scene of a file, of its speeds along one axis or of its law in any direction."""
    if velocities is not None:
        return Scene.any_direction(velocities, **others)  # type: ignore[arg-type]
    words = "be given, or `velocities` in any direction"
    require(speeds is not None, "scene.speeds", words, Unquoted("nothing"))
    return made_of(Scene, {"speeds": speeds, "weights": weights} | others)


@final
class SavedScene(arguments_of(Scene, "motion", "speeds", "weights")):  # type: ignore[misc]
    """The arguments of `Scene`, but for a motion and a law of velocities, which are tables."""

    made: ClassVar = staticmethod(_scene)
    speeds: list[float] | None = None
    weights: list[float] | None = None


class SavedDesign(Part):
    """Frames for a scene; the level stands first, for whoever reads the file."""

    level_db: object = None
    level_of: object = None
    format: int
    mishutter: str = "unknown"
    sequence: SavedSequence | None = None
    plane: SavedPlaneBurst | None = None
    scene: SavedScene
    velocities: table_of(AbstractVelocities) | None = None  # type: ignore[valid-type]


@final
class SavedOneExposure(SavedDesign):
    """One exposure, beside frames or without; level and metrics are evaluated anew."""

    shutter: SavedShutter
    motion: SavedMotion
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
