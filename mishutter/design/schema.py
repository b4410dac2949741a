"""The schema by which a design's file is written and checked."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, final

from pydantic import AllowInfNan, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from mishutter.model import Part, Scene, arguments_of, as_decoder_speed

FORMATS = (1, 2)
"""Versions of the file format that are read; the last is written."""

_UNWRITTEN: dict[str | None, float] = {"Infinity": math.inf, "-Infinity": -math.inf, None: math.nan}


def _read_back(value: object) -> object:
    """A number as it was before `strict_json`, which has no token for some."""
    return _UNWRITTEN.get(value, value) if isinstance(value, str | None) else value


Result = Annotated[float, AllowInfNan(), BeforeValidator(_read_back)]
"""A computed number, which may be infinite, or NaN of a camera that was not searched for."""


@final
class SavedShutter(BaseModel):
    """A kind of profile, as it is sent to the device, and its parameters, which it checks."""

    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False, frozen=True)

    kind: str


@final
class SavedMotion(Part):
    """A motion; earlier versions wrote parabolas without acceleration as two kinds of their own."""

    kind: Literal["ParabolicMotion", "FreeMotion", "LinearMotion", "StillCamera"]
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


SAVED_SCENE = arguments_of(Scene, "motion")
"""The arguments of `Scene`, but for the motion, which has a table of its own."""

_PLACES = {
    "mean_level": ("picture", "mean_level"),
    "deviation": ("picture", "deviation"),
    "power_spectrum": ("picture", "power_spectrum"),
    "picture": ("picture", "path"),
    "picture_white": ("picture", "white"),
    "picture_linear": ("picture", "linear"),
    "cutoff_frequency": ("optics", "cutoff_frequency"),
    "lens_blur": ("optics", "lens_blur"),
    "full_well": ("sensor", "full_well"),
    "axis": ("sensor", "axis"),
    "stage": ("limits", "stage"),
    "free_paths": ("limits", "free_paths"),
}
"""The part of a scene, and the argument of it, that each argument of earlier scenes is today."""


def scene_of_today(scene: Mapping[str, Any]) -> dict[str, Any]:
    """A saved scene, of this or of an earlier version, as this version saves it.

    Scenes of earlier versions had no parts, and may name decoders by older words.

    Args:
        scene: The arguments of the scene.
    """
    parts = {name: value for name, value in scene.items() if not _is_earlier(name, value)}
    for name, value in scene.items():
        if _is_earlier(name, value):
            part, argument = _PLACES[name]
            own = parts.get(part) or {}
            if isinstance(own, dict):
                parts[part] = own | {argument: value}
    if "decoder_speed" in parts:
        parts["decoder_speed"] = as_decoder_speed(parts["decoder_speed"])
    return parts


def _is_earlier(name: str, value: object) -> bool:
    """Whether an argument is one of earlier scenes, whose picture was a path."""
    return name in _PLACES and not (name == "picture" and isinstance(value, dict))


@final
class SavedDesign(Part):
    """A whole design; its level and metrics are for whoever reads the file, and evaluated anew.

    Files of earlier versions hold the plan of the search, which nothing reads.
    """

    level_db: object = None
    level_of: object = None
    format: int
    mishutter: str = "unknown"
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
    plan: Annotated[object, Field(exclude=True)] = None
    blind_psnr: Result | None = None

    @model_validator(mode="before")
    @classmethod
    def _of_today(cls, data: Any) -> Any:
        if isinstance(data, dict) and isinstance(data.get("scene"), dict):
            return data | {"scene": scene_of_today(data["scene"])}
        return data
