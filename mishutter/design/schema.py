"""The schema by which a design's file is written and checked."""

import math
from typing import Annotated, Any, Literal, final

from pydantic import AllowInfNan, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from mishutter.model import Part, Scene, arguments_of

FORMAT = 1
"""Version of the file format."""

_UNWRITTEN: dict[str | None, float] = {"Infinity": math.inf, "-Infinity": -math.inf, None: math.nan}


def _read_back(value: object) -> object:
    """A number as it was before `strict_json`, which has no token for some."""
    return _UNWRITTEN.get(value, value) if isinstance(value, str | None) else value


Result = Annotated[float, AllowInfNan(), BeforeValidator(_read_back)]


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


SAVED_SCENE = arguments_of(Scene, "motion")
"""The arguments of `Scene`, but for the motion, which has a table of its own."""


@final
class SavedDesign(Part):
    """A whole design; its level and metrics are for whoever reads the file, and evaluated anew.

    Files of earlier versions hold the plan of the search, which nothing reads, and ask for free
    paths beside the limits of the stage.
    """

    level_db: object = None
    level_of: object = None
    format: int
    mishutter: str = "unknown"
    shutter: SavedShutter
    motion: SavedMotion
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
    def _with_free_paths_among_limits(cls, data: Any) -> Any:
        scene = data.get("scene") if isinstance(data, dict) else None
        if isinstance(scene, dict) and "free_paths" in scene:
            others = {name: value for name, value in scene.items() if name != "free_paths"}
            limits = scene.get("limits", {})
            if isinstance(limits, dict):
                limits = limits | {"free_paths": scene["free_paths"]}
            return data | {"scene": others | {"limits": limits}}
        return data
