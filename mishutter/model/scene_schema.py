"""The keys of a scene file, their units and ranges."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, final

from pydantic import BeforeValidator, Field, create_model

from mishutter._core.validation import Section
from mishutter.model.decoder_speeds import DecoderSpeed
from mishutter.model.occlusion import Background
from mishutter.model.optics import WIDEST_BLUR
from mishutter.model.sensor import RowsRead
from mishutter.pictures.images import Axis

Speed = Annotated[float, Field(ge=-1e7, le=1e7)]
ListOfSpeeds = Annotated[list[Speed], Field(min_length=1, max_length=1000)]
Velocity = Annotated[list[Speed], Field(min_length=2, max_length=2)]
ListOfVelocities = Annotated[list[Velocity], Field(min_length=1, max_length=1000)]
PositiveSpeed = Annotated[float, Field(gt=0, le=1e7)]
SizeOfSpeed = Annotated[float, Field(ge=0, le=1e7)]
PhotonRate = Annotated[float, Field(gt=0, le=1e12)]
Count = Annotated[int, Field(ge=1, le=1000)]
Milliseconds = Annotated[float, Field(ge=1e-3, le=1e5)]
Exposure = Annotated[float, Field(ge=2e-3, le=2e5)]
"""A whole exposure, of which `Milliseconds` are half."""
LongestStroke = Annotated[float, Field(ge=0, le=1e4)]
TopSpeed = Annotated[float, Field(ge=1e-3, le=1e7)]
Share = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(ge=0, le=1e9)]
"""How often a speed occurs, on any scale."""


def _without_stage(value: object) -> object:
    """Tells whoever writes that there is no stage how a file says so."""
    if isinstance(value, int | float) and value == 0:  # as False is
        raise ValueError(
            "be left out where there is no stage, as `[limits] max_stroke_px = 0` says"
        )
    return value


WithStage = BeforeValidator(_without_stage)
White = Annotated[float, Field(gt=0, le=1e9)]
"""Value of a picture's file that is white."""


SPEED_UNITS = ("px_per_s", "um_per_s", "mm_per_s", "m_per_s", "km_per_h", "deg_per_s")
"""Units of the speeds of things, as the names of keys end in them."""


def _in_each_unit(**kinds: Any) -> type[Section]:
    """A table of optional keys for some speeds, one in each unit, as `max_px_per_s` and so on."""
    fields: dict[str, Any] = {
        f"{name}_{unit}": (kind | None, None)
        for name, kind in kinds.items()
        for unit in SPEED_UNITS
    }
    return create_model("InEachUnit", __base__=Section, **fields)


@final
class Uniform(_in_each_unit(min=Speed, max=Speed)):
    """Equally likely speeds at equal steps, from one to another, both in one unit."""

    count: Count


@final
class Normal(_in_each_unit(mean=Speed, deviation=PositiveSpeed)):
    """Normally distributed speeds: centres of equal steps over three deviations, by density."""

    count: Count


@final
class AnyDirection(
    _in_each_unit(
        max=PositiveSpeed,
        along=PositiveSpeed,
        across=SizeOfSpeed,
        speed=PositiveSpeed,
        list=ListOfVelocities,
        mean=Velocity,
    )
):
    """Velocities in any direction: a disc or an ellipse that they fill, a ring, or a list."""

    angle_deg: Annotated[float, Field(ge=-360, le=360)] | None = None
    weights: list[Weight] | None = None


@final
class Speeds(Section):
    """Speeds of things, in one of four forms: on the sensor, or as `[view]` shows them."""

    uniform: Uniform | None = None
    normal: Normal | None = None
    any_direction: AnyDirection | None = None
    list_px_per_s: ListOfSpeeds | None = None
    list_um_per_s: ListOfSpeeds | None = None
    list_mm_per_s: ListOfSpeeds | None = None
    list_m_per_s: ListOfSpeeds | None = None
    list_km_per_h: ListOfSpeeds | None = None
    list_deg_per_s: ListOfSpeeds | None = None
    weights: list[Weight] | None = None


@final
class Light(Section):
    """Photo-electrons a second at a white pixel; those that fill it, and in which time; or lux."""

    photon_rate_per_s: PhotonRate | None = None
    white_e: Annotated[float, Field(gt=0, le=1e9)] | None = None
    white_ms: Annotated[float, Field(gt=0, le=1e6)] | None = None
    illuminance_lux: Annotated[float, Field(gt=0, le=1e6)] | None = None
    f_number: Annotated[float, Field(ge=0.5, le=1000)] | None = None
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)] | None = None
    lens_transmission: Annotated[float, Field(gt=0, le=1)] | None = None


@final
class ViewSection(Section):
    """Size of things in the picture, for speeds in um/s, mm/s, m/s, km/h or degrees a second."""

    magnification: Annotated[float, Field(ge=1e-9, le=1e4)] | None = None
    distance_m: Annotated[float, Field(gt=0, le=1e9)] | None = None
    focal_length_mm: Annotated[float, Field(ge=0.01, le=1e6)] | None = None
    px_per_mm: Annotated[float, Field(ge=1e-9, le=1e6)] | None = None


@final
class OcclusionSection(Section):
    """Objects in front of a background: their share of the picture, and how wide they are."""

    front_share: Share
    object_width_px: Annotated[float, Field(gt=0, le=1e7)] | None = None
    object_width_um: Annotated[float, Field(gt=0, le=1e12)] | None = None
    object_width_mm: Annotated[float, Field(gt=0, le=1e9)] | None = None
    object_width_m: Annotated[float, Field(gt=0, le=1e6)] | None = None
    level_difference: Annotated[float, Field(ge=-1, le=1)] = 0.0
    background: Background = "still"


@final
class ObjectsSection(Section):
    """Objects that are registered one by one: the width of the narrowest, along the motion."""

    width_px: Annotated[float, Field(gt=0, le=1e7)] | None = None
    width_um: Annotated[float, Field(gt=0, le=1e12)] | None = None
    width_mm: Annotated[float, Field(gt=0, le=1e9)] | None = None
    width_m: Annotated[float, Field(gt=0, le=1e6)] | None = None


@final
class ErrorsSection(Section):
    """Standard deviations of numbers that were measured, as `mishutter measure` states them."""

    photon_rate_per_s: Annotated[float, Field(ge=0, le=1e12)] = 0.0
    read_noise_e: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    object_speed_px_per_s: SizeOfSpeed = 0.0
    front_share: Share = 0.0


@final
class SensorSection(Section):
    """Noise of the sensor, what a pixel holds, which way things move, and how far it reaches."""

    renamed: ClassVar[Mapping[str, str]] = {
        "readout": "readout_ms",
        "rolling": "readout_ms",
        "rolling_shutter": "readout_ms",
        "row_time_us": "line_time_us",
        "num_rows": "rows",
    }

    read_noise_e: Annotated[float, Field(ge=0, le=1e6)] | None = None
    dynamic_range_db: Annotated[float, Field(ge=1, le=200)] | None = None
    full_well_e: Annotated[float, Field(gt=0, le=1e9)] | None = None
    pixel_pitch_um: Annotated[float, Field(ge=0.1, le=1000)] | None = None
    axis: Axis = "rows"
    width_px: Annotated[float, Field(gt=0, le=1e6)] | None = None
    readout_ms: Annotated[float, Field(ge=0, le=1e4)] | None = None
    line_time_us: Annotated[float, Field(ge=0, le=1e5)] | None = None
    rows: Annotated[int, Field(ge=2, le=10**6)] | None = None
    rows_read: RowsRead | None = None


@final
class ShutterSection(Section):
    """The device of the shutter: its transmission, its speed and its levels."""

    transmission: Annotated[float, Field(gt=0, le=1)] = 1.0
    leakage: Annotated[float, Field(ge=0, lt=1)] = 0.0
    rise_ms: Annotated[float, Field(ge=0, le=1e5)] | None = None
    fall_ms: Annotated[float, Field(ge=0, le=1e5)] | None = None
    delay_ms: Annotated[float, Field(ge=0, le=1e5)] | None = None
    levels: Annotated[int, Field(ge=2, le=65536)] | None = None
    num_slots: Annotated[int, Field(ge=2, le=4096)] | None = None
    min_open_slots: Annotated[int, Field(ge=1, le=4096)] | None = None
    min_closed_slots: Annotated[int, Field(ge=1, le=4096)] | None = None


@final
class OpticsSection(Section):
    """The lens: the highest frequency that it passes, and its Gaussian blur."""

    cutoff_cycles_per_px: Annotated[float, Field(gt=0, le=0.5)] = 0.5
    lens_blur_px: Annotated[float, Field(ge=0, le=WIDEST_BLUR)] = 0.0


@final
class StageSection(Section):
    """Response of the stage's servo, from which the path to send follows."""

    bandwidth_hz: Annotated[float, Field(gt=0, le=1e6)]
    damping: Annotated[float, Field(ge=0.01, le=100)] = 0.7


@final
class BurstSection(Section):
    """Frames that the camera may take in place of one exposure."""

    renamed: ClassVar[Mapping[str, str]] = {
        "frames": "max_frames",
        "count": "max_frames",
        "fps": "frames_per_s",
        "frame_rate": "frames_per_s",
        "window": "window_ms",
    }

    frames_per_s: Annotated[float, Field(gt=0, le=1e6)]
    max_frames: Annotated[int, Field(ge=1, le=1000)] | None = None
    window_ms: Annotated[float, Field(ge=1e-3, le=1e6)] | None = None
    dead_time_ms: Annotated[float, Field(ge=0, le=1e5)] = 0.0


@final
class LimitsSection(Section):
    """The furthest that the mechanism and the exposure may reach."""

    renamed: ClassVar[Mapping[str, str]] = {"stage": "max_stroke_px"}

    max_stroke_px: LongestStroke = 200.0
    max_stroke_mm: Annotated[float, Field(ge=0, le=1e3)] | None = None
    max_top_speed_px_per_s: TopSpeed = 1e5
    max_top_speed_mm_per_s: Annotated[float, Field(gt=0, le=1e6)] | None = None
    min_half_exposure_ms: Milliseconds | None = None
    min_exposure_ms: Exposure | None = None
    max_half_exposure_ms: Milliseconds | None = None
    max_exposure_ms: Exposure | None = None
    max_pan_px_per_s: Annotated[float, Field(ge=0, le=1e7)] | None = None
    max_pan_deg_per_s: Annotated[float, Field(ge=0, le=1e6)] | None = None
    max_travel_px: Annotated[float, Field(ge=1e-3, le=1e6), WithStage] | None = None
    max_travel_mm: Annotated[float, Field(ge=1e-6, le=1e3), WithStage] | None = None
    max_acceleration_px_per_s2: Annotated[float, Field(gt=0, le=1e14)] | None = None
    max_acceleration_g: Annotated[float, Field(gt=0, le=1e6)] | None = None
    max_jerk_px_per_s3: Annotated[float, Field(gt=0, le=1e18)] | None = None
    max_jerk_g_per_s: Annotated[float, Field(gt=0, le=1e9)] | None = None
    pans: Literal["stage", "camera"] = "stage"
    axes: Literal["one", "each", "disc"] = "each"


@final
class TolerancesSection(Section):
    """Standard deviations of what a camera as it is built, or an object, is off by."""

    acceleration_share: Annotated[float, Field(ge=0, le=0.3)] = 0.0
    velocity_px_per_s: SizeOfSpeed = 0.0
    velocity_mm_per_s: SizeOfSpeed | None = None
    delay_us: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    object_speed_px_per_s: SizeOfSpeed = 0.0
    object_speed_um_per_s: SizeOfSpeed | None = None
    object_speed_mm_per_s: SizeOfSpeed | None = None
    object_speed_m_per_s: SizeOfSpeed | None = None
    object_speed_km_per_h: SizeOfSpeed | None = None
    object_speed_deg_per_s: SizeOfSpeed | None = None
    transmittance: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    drive_step_us: Annotated[float, Field(gt=0, le=1e6)] | None = None


@final
class DecoderSection(Section):
    """The decoder that restores the pictures, and its knowledge of the speed."""

    speed: DecoderSpeed = "unknown"


@final
class MotionSection(Section):
    """An exposure, the sag or the acceleration, and a velocity, all of the sensor.

    The stroke is the sag of a stage that does not pan. The acceleration is half of that of the
    stage.
    """

    half_exposure_ms: Milliseconds | None = None
    exposure_ms: Exposure | None = None
    sag_px: Annotated[float, Field(ge=0, le=1e4)] | None = None
    sag_mm: Annotated[float, Field(ge=0, le=1e3)] | None = None
    stroke_px: Annotated[float, Field(ge=0, le=1e4)] | None = None
    stroke_mm: Annotated[float, Field(ge=0, le=1e3)] | None = None
    stage_acceleration_px_per_s2: Annotated[float, Field(ge=0, le=1e14)] | None = None
    acceleration_px_per_s2: Annotated[float, Field(ge=0, le=1e14)] | None = None
    velocity_px_per_s: Speed = 0.0
    velocity_mm_per_s: Speed | None = None
    velocity_deg_per_s: Speed | None = None


@final
class PictureSection(Section):
    """The photograph, or what stands for one."""

    like: Literal["photograph", "print", "cells"] | None = None
    path: Annotated[str, Field(min_length=1)] | None = None
    white: White | None = None
    linear: bool | None = None
    mean_level: Share | None = None
    deviation: Annotated[float, Field(ge=0, le=0.5)] | None = None


@final
class SceneFile(Section):
    """A whole scene file."""

    renamed: ClassVar[Mapping[str, str]] = {"rivals": "burst", "frames": "max_frames"}

    speeds: Speeds
    light: Light
    sensor: SensorSection
    view: ViewSection = ViewSection()
    occlusion: OcclusionSection | None = None
    objects: ObjectsSection | None = None
    errors: ErrorsSection | None = None
    shutter: ShutterSection | None = None
    optics: OpticsSection = OpticsSection()
    limits: LimitsSection = LimitsSection()
    stage: Annotated[StageSection | None, WithStage] = None
    burst: BurstSection | None = None
    tolerances: TolerancesSection | None = None
    decoder: DecoderSection = DecoderSection()
    motion: MotionSection | None = None
    picture: PictureSection = PictureSection()
