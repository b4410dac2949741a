"""The schema by which a design's file is written and checked."""

import math
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, Literal, final

from pydantic import (
    AllowInfNan,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    field_validator,
    model_validator,
)

from mishutter._core import Section
from mishutter.model import Axis, Background, DecoderSpeed

FORMAT = 1
"""Version of the file format."""

_UNWRITTEN: dict[Any, float] = {"Infinity": math.inf, "-Infinity": -math.inf, None: math.nan}


def _read_back(value: Any) -> Any:
    """A number as it was before `strict_json`, which has no token for some."""
    return _UNWRITTEN.get(value, value) if isinstance(value, str | None) else value


Result = Annotated[float, AllowInfNan(), BeforeValidator(_read_back)]


class Part(Section):
    """A table of a design's file, made from a file's values or from the object that it saves."""

    @field_validator("*", mode="before")
    @classmethod
    def _as_in_a_file(cls, value: Any) -> Any:
        """Arrays and tuples as numbers and lists."""
        if hasattr(value, "tolist"):
            return value.tolist()
        return list(value) if isinstance(value, tuple) else value


@final
class SavedShutter(BaseModel):
    """A kind of profile, as it is sent to the device, and its parameters, which it checks."""

    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False, frozen=True)

    kind: str


@final
class SavedMotion(Part):
    """A motion, of which a kind may have no acceleration, or no velocity."""

    kind: Literal["ParabolicMotion", "LinearMotion", "StillCamera", "FreeMotion"]
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
class SavedLimits(Part):
    """The arguments of `Limits`."""

    max_stroke: float
    max_top_speed: float
    min_half_exposure: float
    max_half_exposure: float
    max_pan: float | None = None
    max_travel: float | None = None
    max_acceleration: float | None = None
    max_jerk: float | None = None
    pans: Literal["stage", "camera"] = "stage"


@final
class SavedIdealShutter(Part):
    """The arguments of `IdealShutter`."""

    transmission: float
    leakage: float
    levels: int | None = None
    num_slots: int | None = None


@final
class SavedFirstOrderShutter(Part):
    """The arguments of `FirstOrderShutter`."""

    rise_time: float
    fall_time: float
    transmission: float
    leakage: float
    levels: int | None = None
    num_slots: int
    delay: float | None = None


@final
class SavedSwitchedShutter(Part):
    """The arguments of `SwitchedShutter`."""

    num_slots: int
    min_open: int
    min_closed: int
    transmission: float
    leakage: float


def _as_arguments(value: Any) -> Any:
    """A device as its arguments, which tell its kind."""
    if not is_dataclass(value):
        return value
    return {field.name: getattr(value, field.name) for field in fields(value)}


SavedDevice = Annotated[
    SavedFirstOrderShutter | SavedIdealShutter | SavedSwitchedShutter,
    BeforeValidator(_as_arguments),
]


@final
class SavedBurst(Part):
    """The arguments of `Burst`."""

    frames_per_s: float
    max_frames: int


@final
class SavedStage(Part):
    """The arguments of `SecondOrderStage`."""

    bandwidth: float
    damping: float


@final
class SavedTolerances(Part):
    """The arguments of `Tolerances`."""

    acceleration: float
    velocity: float
    delay: float
    speed: float
    transmittance: float
    drive_step: float
    num_accelerations: int | None = None
    num_speeds: int | None = None


@final
class SavedOcclusion(Part):
    """The arguments of `Occlusion`."""

    front_share: float
    object_width: float | None = None
    level_difference: float = 0.0
    background: Background = "still"


@final
class SavedScene(Part):
    """The arguments of `Scene`, but for the motion."""

    speeds: list[float]
    weights: list[float]
    photon_rate: float
    read_noise: float
    mean_level: float
    deviation: float
    power_spectrum: list[float] | None = None
    cutoff_frequency: float = 0.5
    lens_blur: float = 0.0
    limits: SavedLimits
    device: SavedDevice | None = None
    full_well: float | None = None
    burst: SavedBurst | None = None
    stage: SavedStage | None = None
    tolerances: SavedTolerances | None = None
    occlusion: SavedOcclusion | None = None
    decoder_speed: DecoderSpeed = "unknown"
    axis: Axis = "rows"
    picture: str | None = None
    picture_white: float | None = None
    picture_linear: bool = False


@final
class SavedItem(Part):
    """A decision of a plan."""

    name: str
    full: str
    kept: str
    why: str


@final
class SavedPlan(Part):
    """The plan of a search."""

    num_taps: int
    dft_length: int
    num_frequencies: int
    num_nodes: int
    num_kept: int | None
    skips: bool
    folds: bool
    still: bool
    loss_dft_length: int | None = None
    num_effective_speeds: int = 0
    items: list[SavedItem]


@final
class SavedDesign(Part):
    """A whole design; its metrics are for whoever reads the file, and evaluated anew."""

    format: int
    mishutter: str = "unknown"
    shutter: SavedShutter
    motion: SavedMotion
    scene: SavedScene
    loss: Result
    loss_name: str
    best_start_loss: Result
    metrics: Any = None
    history: list[Result]
    converged: bool
    outcome: str
    certificate: Result
    plan: SavedPlan | None = None
    blind_psnr: Result | None = None
