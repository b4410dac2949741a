"""Scenes written down in TOML, with the unit in each key's name.

`example_scene.toml`, beside this file, is annotated and shows every section. Each error
is one line that names the key as `[section] key`.
"""

import json
import math
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mishutter._core.checks import Unquoted, require
from mishutter._core.files import contents
from mishutter._core.validation import Section, in_section, parsed, validated
from mishutter.model.arguments import made_of
from mishutter.model.devices import DEVICES, NUM_SLOTS, AbstractDevice, IdealDevice
from mishutter.model.limits import LEAST_STROKE, LIMITS, Limits
from mishutter.model.measurement_errors import MeasurementErrors
from mishutter.model.motion import ParabolicMotion
from mishutter.model.objects import Objects
from mishutter.model.occlusion import Occlusion
from mishutter.model.optics import Optics
from mishutter.model.scene_schema import (
    AnyDirection,
    BurstSection,
    ErrorsSection,
    LimitsSection,
    MotionSection,
    Normal,
    ObjectsSection,
    OcclusionSection,
    OpticsSection,
    PictureSection,
    SceneFile,
    SensorSection,
    ShutterSection,
    StageSection,
    TolerancesSection,
    Uniform,
)
from mishutter.model.scene_units import (
    FASTEST,
    SPEED_UNITS,
    View,
    arguments_in,
    keys_of,
    photon_rate,
    read_noise_in,
    speed_of,
    table_of,
    told_in,
    view_of,
)
from mishutter.model.sensor import BurstMode, Sensor
from mishutter.model.servos import SecondOrderStage
from mishutter.model.texture import PHOTOGRAPH, SHIPPED, Texture, photograph_at
from mishutter.model.tolerances import Tolerances
from mishutter.model.velocities import (
    AbstractVelocities,
    EvenVelocities,
    ListedVelocities,
    RingOfVelocities,
)
from mishutter.pictures.images import Axis

_Kind = TypeVar("_Kind")
Textures = Callable[[str, float | None, bool, Axis], Texture]
"""The texture of a photograph, by `path`, `white`, `linear` and `axis` of a file."""


def read_speed(text: str, path: str | Path | None, subject: str) -> float:
    """The speed of a thing in a scene, px/s, which a text gives in that or a unit of its file."""
    data = example_scene_text().encode() if path is None else contents(Path(path))
    name = str(path or "example_scene.toml")
    file = validated(SceneFile, parsed(tomllib.loads, data, name, "TOML"), name, in_section)
    return speed_of(text, _view(file), subject)


def read_velocity(text: str, path: str | Path | None, subject: str) -> tuple[float, float]:
    """The velocity of a thing along rows and columns, in two speeds of `read_speed`, or 0; px/s."""
    parts = ["0", "0"] if text == "0" else text.split(",")
    requirement = "be a velocity along rows and columns, as 1500,-800 or 0.9m/s,0.2m/s"
    require(len(parts) == 2, subject, requirement, text)
    along, across = (read_speed(part.strip(), path, subject) for part in parts)
    return along, across


def _view(file: SceneFile) -> View:
    return view_of(file.view, file.sensor.pixel_pitch_um)


def example_scene_text() -> str:
    """The annotated file of the built-in scene."""
    return (resources.files("mishutter") / "example_scene.toml").read_text("utf-8")


def file_text(
    tables: Mapping[str, Mapping[str, object]], subject: str, notes: Mapping[str, Sequence[str]]
) -> str:
    """The text of a scene file."""
    file = validated(SceneFile, tables, subject, in_section)
    lines = [f"# {line}" for line in notes.get("", ())]
    for name, section in file.model_dump(exclude_none=True).items():
        lines += ["", *(f"# {line}" for line in notes.get(name, ())), f"[{name}]"]
        lines += [f"{key} = {_toml(value)}" for key, value in section.items()]
    return "\n".join(lines).lstrip("\n") + "\n"


def _toml(value: object) -> str:
    """A value as TOML, in which finite numbers, text and lists are those of JSON."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {_toml(x)}' for key, x in value.items())} }}"
    return json.dumps(value)


def whole_numbers(table: Mapping[str, object]) -> dict[str, object]:
    """A table with whole exposures and accelerations of the stage, in place of their halves."""
    wholes = {f"{end}half_exposure_ms": f"{end}exposure_ms" for end in ("", "min_", "max_")}
    wholes["acceleration_px_per_s2"] = "stage_acceleration_px_per_s2"
    return {
        wholes.get(name, name): 2 * value if name in wholes else value  # type: ignore[operator]
        for name, value in table.items()
    }


def device_table(device: AbstractDevice) -> dict[str, object]:
    """The keys of `[shutter]` that stand for a device."""
    table = table_of(device, ShutterSection)
    if isinstance(device, IdealDevice) and device.levels is None and device.num_slots is not None:
        # Slots without levels and times are of a device that is open or closed.
        table |= {"rise_ms": 0.0, "fall_ms": 0.0}
    return table


def sensor_table(sensor: Sensor) -> dict[str, object]:
    """The keys of `[sensor]` that stand for it; rows that are not read in turn have no order."""
    table = table_of(sensor, SensorSection)
    if not sensor.is_rolling:
        del table["rows_read"]
    return table


@contextmanager
def in_file(name: str) -> Iterator[None]:
    """Names the file in the errors of what is built from it."""
    try:
        yield
    except (ValueError, OSError) as error:
        kind = ValueError if isinstance(error, ValueError) else type(error)
        raise kind(f"{name}: {error}") from None


def scene_arguments(file: SceneFile, folder: Path, textures: Textures | None) -> dict[str, Any]:
    """Arguments of `Scene` that a file gives."""
    view = _view(file)
    moving = _speeds(file, view)
    limits = _limits(file.limits, file.stage, view)
    law = moving.get("velocities")
    fastest = float(np.max(np.abs(moving["speeds"]))) if law is None else law.fastest
    longest = _exposures(file.limits)[1]
    travel = fastest * longest / 1000
    got = Unquoted(f"{travel:g} px in {longest:g} ms")
    requirement = "let the fastest object travel at most 10000 px"
    require(travel <= 1e4, "[limits] max_exposure_ms", requirement, got)
    occlusion = _occlusion(file.occlusion, view)
    is_whole = occlusion is None or file.decoder.speed != "found"
    why = "no single speed describes a picture with a background"
    requirement = f"be 'unknown' or 'known' beside [occlusion]: {why}"
    require(is_whole, "[decoder] speed", requirement, file.decoder.speed)
    sensor = _of_kind(Sensor, _with_readout(file.sensor), "[sensor]", view)
    burst = _burst(file.burst, view)
    if burst is not None and sensor is not None:
        sensor.require_read_within("[sensor] readout_ms", burst)
    return moving | {
        "photon_rate": photon_rate(file.light, view),
        "read_noise": read_noise_in(file.sensor),
        "picture": _picture(file.picture, file.sensor.axis, folder, textures),
        "optics": _of_kind(Optics, file.optics, "[optics]", view),
        "sensor": sensor,
        "limits": limits,
        "device": None if file.shutter is None else _device(file.shutter, view),
        "burst": burst,
        "tolerances": _tolerances(file.tolerances, view),
        "occlusion": occlusion,
        "objects": _objects(file.objects, view),
        "errors": _of_kind(MeasurementErrors, file.errors, "[errors]", view),
        "decoder_speed": file.decoder.speed,
        "motion": _motion(file.motion, file.limits, limits, view),
    }


def key_of_arguments() -> dict[tuple[str, str], str]:
    """Keys as `[section] key` by the class and argument for which they stand, in the same unit."""
    kinds: dict[str, tuple[type[Section], type]] = {
        "limits": (LimitsSection, Limits),
        "sensor": (SensorSection, Sensor),
        "burst": (BurstSection, BurstMode),
        "optics": (OpticsSection, Optics),
        "occlusion": (OcclusionSection, Occlusion),
        "objects": (ObjectsSection, Objects),
        "tolerances": (TolerancesSection, Tolerances),
        "errors": (ErrorsSection, MeasurementErrors),
    }
    return {
        (kind.__name__, name): f"[{place}] {key}"
        for place, (section, kind) in kinds.items()
        for name, key in keys_of(section, kind).items()
    }


def _speeds(file: SceneFile, view: View) -> dict[str, Any]:
    """The speeds and weights of a file, or the law of its velocities."""
    section = file.speeds
    unit, listed = told_in(section, "list", SPEED_UNITS, "[speeds]")
    forms = {
        "uniform": section.uniform,
        "normal": section.normal,
        "list": listed,
        "any_direction": section.any_direction,
    }
    forms_in_file = [name for name, value in forms.items() if value is not None]
    requirement = "hold one of uniform, normal, list_px_per_s and any_direction"
    got = Unquoted(" and ".join(forms_in_file) or "no speeds")
    require(len(forms_in_file) == 1, "[speeds]", requirement, got)
    if section.any_direction is not None:
        require(section.weights is None, "[speeds] weights", "stand in any_direction", "[speeds]")
        law = _any_direction(section.any_direction, view)
        beside = "stand beside speeds along one axis, as uniform, and not beside any_direction"
        for name in ("tolerances", "motion"):
            require(getattr(file, name) is None, f"[{name}]", beside, Unquoted("both"))
        requirement = "be 'still' beside any_direction (leave [occlusion] out where all moves)"
        moves = file.occlusion is not None and file.occlusion.background == "moving"
        require(not moves, "[occlusion] background", requirement, "moving")
        return {"velocities": law}
    if section.uniform is not None:
        unit, speeds, weights = _uniform(section.uniform)
    elif section.normal is not None:
        unit, speeds, weights = _normal(section.normal)
    else:
        speeds, weights = _listed(listed, section.weights)  # type: ignore[arg-type]
    goes = section.weights is None or listed is not None
    require(goes, "[speeds] weights", "go with list_px_per_s", Unquoted(forms_in_file[0]))
    speeds = speeds * view.px_of_things(unit, f"[speeds] in {unit}")
    fastest = float(np.max(np.abs(speeds)))
    require(fastest <= FASTEST, "[speeds]", f"be at most {FASTEST:g} px/s", fastest)
    return {"speeds": speeds, "weights": weights}


def _any_direction(form: AnyDirection, view: View) -> AbstractVelocities:
    """The law of velocities: a disc, an ellipse, a ring, or a list."""
    place, names = "[speeds] any_direction", ("max", "along", "speed", "list")
    told = {name: told_in(form, name, SPEED_UNITS, place) for name in (*names, "across", "mean")}
    laws = [name for name in names if told[name][1] is not None]
    requirement = "hold one of max_px_per_s, along_px_per_s, speed_px_per_s and list_px_per_s"
    require(len(laws) == 1, place, requirement, Unquoted(" and ".join(laws) or "none of them"))
    law = laws[0]
    beside = {
        "across": told["across"][1],
        "angle_deg": form.angle_deg,
        "weights": form.weights,
        "mean": told["mean"][1],
    }
    every = {"along": ("across", "angle_deg", "mean"), "list": ("weights",), "max": ("mean",)}
    own = every.get(law, ())
    goes_with = {"weights": "list", "mean": "max_px_per_s or along"}
    for name, value in beside.items():
        requirement = f"go with {goes_with.get(name, 'along')}_px_per_s"
        require(value is None or name in own, f"{place}.{name}", requirement, Unquoted(law))
    unit, value = told[law]
    scale = view.px_of_things(unit, f"{place} in {unit}")
    numbers = np.array(value) * scale
    fastest = float(np.max(np.abs(numbers)))
    require(fastest <= FASTEST, place, f"be at most {FASTEST:g} px/s", fastest)
    if law == "list":
        count = len(value)
        matches = form.weights is None or len(form.weights) == count
        requirement = f"be {count}, one a velocity"
        require(matches, f"{place}.weights", requirement, len(form.weights or ()))
        return ListedVelocities(numbers, form.weights)
    if law == "speed":
        return RingOfVelocities(numbers)
    of_mean, mean = told["mean"]
    middle = np.zeros(2)
    if mean is not None:
        middle = np.array(mean) * view.px_of_things(of_mean, f"{place} in {of_mean}")
        furthest = float(np.hypot(*middle)) + fastest
        require(furthest <= FASTEST, place, f"be at most {FASTEST:g} px/s", furthest)
    if law == "max":
        return EvenVelocities(numbers, mean=middle)
    other, across = told["across"]
    require(across is not None, f"{place}.across_{unit}", "be given", Unquoted("nothing"))
    require(other == unit, place, "be in one unit", Unquoted(f"along_{unit} and across_{other}"))
    requirement = f"be at most along_{unit} = {value:g}"
    require(across <= value, f"{place}.across_{unit}", requirement, across)
    angle = math.radians(form.angle_deg or 0.0)
    return EvenVelocities(numbers, across * scale, angle=angle, mean=middle)


def _pair(form: Uniform | Normal, place: str, names: tuple[str, str]) -> tuple[str, float, float]:
    """The unit of a form of speeds, and its two numbers in that unit."""
    (unit, first), (other, second) = (told_in(form, name, SPEED_UNITS, place) for name in names)
    # A number that is missing is asked for in the unit of the one that is there.
    unit, other = (other if first is None else unit), (unit if second is None else other)
    for name, value, own in ((names[0], first, unit), (names[1], second, other)):
        require(value is not None, f"{place}.{name}_{own}", "be given", Unquoted("nothing"))
    got = Unquoted(f"{names[0]}_{unit} and {names[1]}_{other}")
    require(unit == other, place, "be in one unit", got)
    return unit, first, second  # type: ignore[return-value]


def _uniform(form: Uniform) -> tuple[str, np.ndarray, None]:
    place = "[speeds] uniform"
    unit, low, high = _pair(form, place, ("min", "max"))
    require(low <= high, f"{place}.max_{unit}", f"be at least min_{unit} = {low:g}", high)
    requirement = f"be at least 2, for speeds from {low:g} to {high:g}"
    require(form.count > 1 or low == high, f"{place}.count", requirement, form.count)
    return unit, np.linspace(low, high, form.count), None


def _normal(form: Normal) -> tuple[str, np.ndarray, np.ndarray]:
    place = "[speeds] normal"
    unit, mean, deviation = _pair(form, place, ("mean", "deviation"))
    require(form.count > 1, f"{place}.count", "be at least 2, for speeds that deviate", form.count)
    # Over three standard deviations on either side of the mean.
    steps = ((2 * np.arange(form.count) + 1) / form.count - 1) * 3.0
    density = np.exp(-(steps**2) / 2)
    return unit, mean + deviation * steps, density / density.sum()


def _listed(
    speeds: list[float], weights: list[float] | None
) -> tuple[np.ndarray, np.ndarray | None]:
    count = len(speeds)
    if weights is None:
        return np.array(speeds), None
    subject = "[speeds] weights"
    require(len(weights) == count, subject, f"be {count}, one a speed", len(weights))
    require(sum(weights) > 0, subject, "hold one above 0", weights)
    return np.array(speeds), np.array(weights)


def _of_kind(kind: type[_Kind], section: Section | None, place: str, view: View) -> _Kind | None:
    """The object whose arguments a section holds; None without the section."""
    return None if section is None else made_of(kind, arguments_in(section, kind, place, view))


def _with_readout(section: SensorSection) -> SensorSection:
    """The sensor by the time of all its rows, where the file gives it or that of each row."""
    line, rows = section.line_time_us, section.rows
    if line is None:
        requirement = "stand beside line_time_us, the time from one row to the next"
        require(rows is None, "[sensor] rows", requirement, rows)
        return section
    is_alone = section.readout_ms is None
    require(is_alone, "[sensor] line_time_us", "not stand beside readout_ms", line)
    requirement = "be given where line_time_us is: the number of rows that are read"
    require(rows is not None, "[sensor] rows", requirement, Unquoted("nothing"))
    return section.model_copy(update={"readout_ms": line * (rows - 1) / 1e3})  # type: ignore[operator]


def _burst(section: BurstSection | None, view: View) -> BurstMode | None:
    if section is None:
        return None
    period, place = 1e3 / section.frames_per_s, "[burst] dead_time_ms"
    requirement = f"be shorter than the {period:g} ms from frame to frame"
    require(section.dead_time_ms < period, place, requirement, section.dead_time_ms)
    return _of_kind(BurstMode, section, "[burst]", view)


def _device(section: ShutterSection, view: View) -> AbstractDevice:
    """The device that the keys stand for; times of either edge are that of the other if missing."""
    rise, fall = section.rise_ms, section.fall_ms
    lags = rise is not None or fall is not None
    runs = {"min_open_slots": section.min_open_slots, "min_closed_slots": section.min_closed_slots}
    delay, requirement = section.delay_ms, "stand beside rise_ms or fall_ms"
    require(lags or delay is None, "[shutter] delay_ms", requirement, delay)
    for key, value in runs.items():
        requirement = "be left to shutters that are open or closed, without times and levels"
        is_switched = not lags and section.levels is None
        require(value is None or is_switched, f"[shutter] {key}", requirement, value)
        most = section.num_slots or NUM_SLOTS
        fits = value is None or value <= most
        require(fits, f"[shutter] {key}", f"be at most num_slots = {most}", value)
    arguments = {
        name: value
        for kind in DEVICES
        for name, value in arguments_in(section, kind, "[shutter]", view).items()
    }
    times = [arguments[name] for name in ("rise_time", "fall_time") if name in arguments]
    if times:
        arguments |= {"rise_time": times[0], "fall_time": times[-1]}
    return made_of(next(kind for kind in DEVICES if kind.has(arguments)), arguments)


def _exposures(section: LimitsSection) -> list[float]:
    """The least and the greatest whole exposure, ms, where the file gives them or their halves."""
    wholes = []
    for end, default in (("min", 0.2), ("max", 1000.0)):
        name, whole = f"{end}_half_exposure_ms", getattr(section, f"{end}_exposure_ms")
        half = getattr(section, name)
        is_alone = half is None or whole is None
        require(is_alone, f"[limits] {end}_exposure_ms", f"not stand beside {name}", whole)
        wholes.append(whole if whole is not None else default if half is None else 2 * half)
    return wholes


def _limits(section: LimitsSection, stage: StageSection | None, view: View) -> Limits:
    shortest, longest = _exposures(section)
    requirement = f"be at least min_exposure_ms = {shortest:g}"
    require(longest >= shortest, "[limits] max_exposure_ms", requirement, longest)
    halves = {"min_half_exposure_ms": shortest / 2, "max_half_exposure_ms": longest / 2}
    section = section.model_copy(update=halves)
    turns = section.max_pan_deg_per_s is None or section.pans == "camera"
    requirement = 'stand beside pans = "camera": a stage does not turn'
    require(turns, "[limits] max_pan_deg_per_s", requirement, section.max_pan_deg_per_s)
    arguments = arguments_in(section, Limits, "[limits]", view)
    stroke = arguments["max_stroke"]
    subject = f"[limits] max_stroke_{'px' if section.max_stroke_mm is None else 'mm'}"
    requirement = f"be 0, without a stage, or lie in {LEAST_STROKE:g} to 10000 px"
    require(stroke == 0 or LEAST_STROKE <= stroke <= 1e4, subject, requirement, stroke)
    servo = _of_kind(SecondOrderStage, stage, "[stage]", view)
    return made_of(Limits, arguments | {"stage": servo})


def _occlusion(section: OcclusionSection | None, view: View) -> Occlusion | None:
    if section is None:
        return None
    arguments = arguments_in(section, Occlusion, "[occlusion]", view)
    is_shown = section.level_difference == 0 or "object_width" in arguments
    requirement = "stand beside object_width_px: it shows at the edges of objects alone"
    require(is_shown, "[occlusion] level_difference", requirement, section.level_difference)
    return made_of(Occlusion, arguments)


def _objects(section: ObjectsSection | None, view: View) -> Objects | None:
    if section is None:
        return None
    arguments = arguments_in(section, Objects, "[objects]", view)
    require("width" in arguments, "[objects] width_px", "be given", Unquoted("nothing"))
    return made_of(Objects, arguments)


def _tolerances(section: TolerancesSection | None, view: View) -> Tolerances | None:
    if section is None:
        return None
    place, step = "[tolerances]", section.drive_step_us
    requirement = "be given where transmittance has an error"
    lasts = section.transmittance == 0 or step is not None
    require(lasts, f"{place} drive_step_us", requirement, Unquoted("nothing"))
    return _of_kind(Tolerances, section, place, view)


def _motion(
    section: MotionSection | None, limits: LimitsSection, reach: Limits, view: View
) -> ParabolicMotion | None:
    if section is None:
        return None
    place, half, whole = "[motion]", section.half_exposure_ms, section.exposure_ms
    is_alone = half is None or whole is None
    require(is_alone, f"{place} exposure_ms", "not stand beside half_exposure_ms", whole)
    whole = whole if half is None else 2 * half
    if whole is None:
        raise ValueError(f"`{place} exposure_ms` must be given; got nothing.")
    low, high = _exposures(limits)
    requirement = f"lie in the limits {low:g} to {high:g}"
    require(low <= whole <= high, f"{place} exposure_ms", requirement, whole)
    lengths = {f"{name}_{unit}": unit for name in ("sag", "stroke") for unit in ("px", "mm")}
    # The second is that of x = a t^2, of earlier versions.
    accelerations = {"stage_acceleration_px_per_s2": 0.5, "acceleration_px_per_s2": 1.0}
    forms = [*lengths, *accelerations]
    forms_in_file = [name for name in forms if getattr(section, name) is not None]
    requirement = f"hold one of {', '.join(forms[:-2])} and {forms[-2]}"
    got = Unquoted(" and ".join(forms_in_file) or "neither")
    require(len(forms_in_file) == 1, place, requirement, got)
    T, form = whole / 2000, forms_in_file[0]
    requirement = "be left out where max_stroke_px = 0 says that there is no stage"
    has_stage = float(reach.max_stroke) > LEAST_STROKE or not getattr(section, form)
    require(has_stage, place, requirement, Unquoted(f"{form} = {getattr(section, form):g}"))
    v, velocity_key = _velocity(section, limits, view)
    number, subject = getattr(section, form), f"{place} {form}"
    # The stroke of a stage that pans is more than a T^2, as which earlier versions read it.
    is_sag = not form.startswith("stroke") or v == 0 or limits.pans == "camera"
    sag = form.replace("stroke", "sag")
    requirement = f"be {sag} where the stage pans, whose stroke is more than a T^2"
    require(is_sag, subject, requirement, number)
    if form in lengths:
        depth = number * view.px_of_stage(lengths[form], subject)
        motion = ParabolicMotion.from_sag(depth, half_exposure=T, velocity=v)
    else:
        a = number * accelerations[form]
        motion = ParabolicMotion(acceleration=a, half_exposure=T, velocity=v)
    demands = reach.demands(motion)
    for limit in LIMITS:
        if limit.name in demands:
            place = velocity_key if limit.name == "pan" else subject
            requirement, got = limit.words(demands[limit.name])
            is_met = bool(demands[limit.name].is_met(1e-9))  # rounding may exceed it
            require(is_met, place, requirement, Unquoted(got))
    return motion


def _velocity(section: MotionSection, limits: LimitsSection, view: View) -> tuple[float, str]:
    """The velocity of the sensor, px/s, and its key. Only a camera turns, by degrees a second."""
    turned = section.velocity_deg_per_s
    turns = turned is None or limits.pans == "camera"
    requirement = 'stand beside [limits] pans = "camera": a stage does not turn'
    require(turns, "[motion] velocity_deg_per_s", requirement, turned)
    units = ("px_per_s", "mm_per_s", "deg_per_s")
    unit, velocity = told_in(section, "velocity", units, "[motion]")
    of_unit = view.px_of_things if unit == "deg_per_s" else view.px_of_stage
    key = f"[motion] velocity_{unit}"
    return velocity * of_unit(unit, key), key


def _picture(
    section: PictureSection, axis: Axis, folder: Path, textures: Textures | None
) -> Texture:
    """The texture of a photograph, or of what stands for one."""
    levels: dict[str, float | None] = {
        "mean_level": section.mean_level,
        "deviation": section.deviation,
    }
    levels_in_file = {name: value for name, value in levels.items() if value is not None}
    path, kind = section.path, section.like
    require(kind is None or path is None, "[picture] like", "not stand beside path", kind)
    path = path if kind in (None, PHOTOGRAPH) else kind
    own = path is not None and path not in SHIPPED
    for key in ("white", "linear"):
        requirement = "stand beside the path of a photograph of one's own"
        got = Unquoted("no path" if path is None else path)
        require(own or getattr(section, key) is None, f"[picture] {key}", requirement, got)
    if path is None:
        return made_of(Texture, levels_in_file)
    subject = f"[picture] {next(iter(levels_in_file), '')}"
    beside = "path" if kind is None else "like"
    require(not levels_in_file, subject, f"not stand beside {beside}", path)
    white, linear = section.white, bool(section.linear)
    if textures is not None:
        return textures(path, white, linear, axis)
    place = str((folder / path).absolute()) if own else path
    picture = photograph_at(place, white, linear)
    return Texture.of_photograph(picture, place, white=white, linear=linear, axis=axis)
