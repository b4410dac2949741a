"""Scenes written down in TOML, with the unit in each key's name.

`example_scene.toml`, beside this file, is annotated and shows every section. Each error
is one line that names the key as `[section] key`.
"""

import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mishutter._core import (
    Section,
    Unquoted,
    contents,
    in_section,
    parsed,
    require,
    validated,
)
from mishutter.model.devices import (
    NUM_SLOTS,
    AbstractDevice,
    FirstOrderShutter,
    IdealShutter,
    SwitchedShutter,
    device_of,
)
from mishutter.model.limits import Demand, Limits
from mishutter.model.motion import ParabolicMotion
from mishutter.model.occlusion import Occlusion
from mishutter.model.scene import Burst, Scene
from mishutter.model.scene_schema import (
    BurstSection,
    Light,
    LimitsSection,
    MotionSection,
    Normal,
    OcclusionSection,
    OpticsSection,
    PictureSection,
    SceneFile,
    Sensor,
    ShutterSection,
    Speeds,
    StageSection,
    TolerancesSection,
    Uniform,
)
from mishutter.model.scene_units import (
    FASTEST,
    SPEED_UNITS,
    Scales,
    arguments_in,
    photon_rate,
    read_noise_in,
    speed_of,
    table_of,
    told_in,
)
from mishutter.model.servos import SecondOrderStage
from mishutter.model.tolerances import Tolerances
from mishutter.pictures import (
    Axis,
    Picture,
    example_picture,
    read_picture,
    row_power_spectrum,
)

_Kind = TypeVar("_Kind")
Photographs = Callable[[str, float | None, bool, Axis], Mapping[str, Any]]
"""The `picture_arguments` of a photograph, by `path`, `white`, `linear` and `axis` of a file."""
EXAMPLE_PICTURE = "example"
"""The `[picture] path` of the photograph that scikit-image ships."""

_NUM_FREQUENCIES = 256
_DEVIATIONS = 3.0
_MAX_TRAVEL = 1e4
_STROKES = 1e-3, 1e4
_MARGIN = 1e-9
"""Share of a limit by which rounding may exceed it."""


def read_scene(path: str | Path) -> Scene:
    """Read a scene from a TOML file.

    Args:
        path: The file; relative paths in it are taken from its folder.

    Raises:
        ValueError: if the file is not a scene; the line names the key, what must hold
            and what came.
        OSError: if the file or its picture cannot be read.
    """
    place = Path(path)
    return _scene(contents(place), str(path), place.parent)


def read_speed(text: str, path: str | Path | None, subject: str) -> float:
    """The speed of a thing in a scene, which a text gives in px/s or in a unit of its file; px/s.

    Args:
        text: As `2400`, `0.9 m/s`, `90 km/h`, `0.9 mm/s` or `3 deg/s`.
        path: The file; None for the built-in scene.
        subject: What the speed is of, in an error.

    Raises:
        ValueError: as `speed_of`, and if the file is not a scene.
        OSError: if the file cannot be read.
    """
    data = example_scene_text().encode() if path is None else contents(Path(path))
    name = str(path or "example_scene.toml")
    file = validated(SceneFile, parsed(tomllib.loads, data, name, "TOML"), name, in_section)
    return speed_of(text, _scales(file), subject)


def _scales(file: SceneFile) -> Scales:
    return Scales(file.sensor.pixel_pitch_um, file.view)


def example_scene() -> Scene:
    """The built-in scene: fast objects in both directions, in dim light, one photograph."""
    return _scene(example_scene_text().encode(), "example_scene.toml", Path())


def example_scene_text() -> str:
    """The annotated file of the built-in scene."""
    return (resources.files("mishutter") / "example_scene.toml").read_text("utf-8")


def scene_text(scene: Scene, notes: Mapping[str, Sequence[str]] | None = None) -> str:
    """A scene as the text of a file that `read_scene` reads.

    A photograph is told by its path, and read again with the scene. Without one a power spectrum,
    and a motion that is no parabola, have no keys, and are left out.

    Args:
        scene: The scene.
        notes: Comments by the name of the section that they begin; those of "" begin the file.

    Raises:
        ValueError: if a number is out of the range of its key.
    """
    tables: dict[str, dict[str, object]] = {
        "speeds": {"list_px_per_s": scene.speeds.tolist(), "weights": scene.weights.tolist()},
        "light": table_of(scene, Light),
        "sensor": table_of(scene, Sensor),
        "optics": table_of(scene, OpticsSection),
        "limits": table_of(scene.limits, LimitsSection),
        "picture": {
            "path": scene.picture,
            "white": scene.picture_white,
            "linear": scene.picture_linear or None,
        },
    }
    if scene.picture is None:
        tables["picture"] = table_of(scene, PictureSection)
    tables |= _optional_tables(scene)
    if scene.decoder_speed != "unknown":
        tables["decoder"] = {"speed": scene.decoder_speed}
    if isinstance(scene.given_motion, ParabolicMotion):
        tables["motion"] = table_of(scene.given_motion, MotionSection)
    file = validated(SceneFile, tables, "scene_text(scene=...)", in_section)
    said = notes or {}
    lines = [f"# {line}" for line in said.get("", ())]
    for name, section in file.model_dump(exclude_none=True).items():
        lines += ["", *(f"# {line}" for line in said.get(name, ())), f"[{name}]"]
        # Finite numbers and text of JSON are those of TOML.
        lines += [f"{key} = {json.dumps(value)}" for key, value in section.items()]
    return "\n".join(lines).lstrip("\n") + "\n"


def _optional_tables(scene: Scene) -> dict[str, dict[str, object]]:
    """Tables of what a scene may do without."""
    tables: dict[str, dict[str, object]] = {}
    if scene.occlusion is not None:
        tables["occlusion"] = table_of(scene.occlusion, OcclusionSection)
        if not scene.occlusion.has_edges:
            del tables["occlusion"]["level_difference"]
    if scene.device is not None:
        tables["shutter"] = _device_table(scene.device)
    if scene.stage is not None:
        tables["stage"] = table_of(scene.stage, StageSection)
    if scene.burst is not None:
        tables["burst"] = table_of(scene.burst, BurstSection)
    if scene.tolerances is not None:
        tables["tolerances"] = table_of(scene.tolerances, TolerancesSection)
        if float(scene.tolerances.drive_step) == 0:
            del tables["tolerances"]["drive_step_us"]
    return tables


def _device_table(device: AbstractDevice) -> dict[str, object]:
    table = table_of(device, ShutterSection)
    if isinstance(device, IdealShutter) and device.levels is None and device.num_slots is not None:
        # Slots without levels and times are of a device that is open or closed.
        table |= {"rise_ms": 0.0, "fall_ms": 0.0}
    return table


def _scene(data: bytes, name: str, folder: Path) -> Scene:
    return scene_of_tables(parsed(tomllib.loads, data, name, "TOML"), name, folder)


def scene_of_tables(
    tables: object, name: str, folder: Path, photographs: Photographs | None = None
) -> Scene:
    """The scene of a file's tables.

    Args:
        tables: The contents of the file.
        name: The file's name in an error.
        folder: Relative paths are taken from it.
        photographs: `picture_arguments` of photographs by what a file says of them, in place of
            their files.

    Raises:
        ValueError: as `read_scene`.
        OSError: as `read_scene`.
    """
    file = validated(SceneFile, tables, name, in_section)
    try:
        return _built(file, folder, photographs)
    except (ValueError, OSError) as error:
        kind = ValueError if isinstance(error, ValueError) else type(error)
        raise kind(f"{name}: {error}") from None


def _built(file: SceneFile, folder: Path, photographs: Photographs | None) -> Scene:
    scales = _scales(file)
    speeds, weights = _speeds(file.speeds, scales)
    limits = _limits(file.limits, scales)
    travel = float(np.max(np.abs(speeds))) * 2 * file.limits.max_half_exposure_ms / 1000
    requirement = f"let the fastest object travel at most {_MAX_TRAVEL:g} px"
    require(
        travel <= _MAX_TRAVEL,
        "[limits] max_half_exposure_ms",
        requirement,
        Unquoted(f"{travel:g} px in {2 * file.limits.max_half_exposure_ms:g} ms"),
    )
    occlusion = _occlusion(file.occlusion, scales)
    is_whole = occlusion is None or file.decoder.speed != "found"
    requirement = "be 'unknown' or 'known' beside [occlusion], where no one speed is the picture's"
    require(is_whole, "[decoder] speed", requirement, file.decoder.speed)
    return Scene(
        speeds,
        weights,
        photon_rate=photon_rate(file.light, scales),
        read_noise=read_noise_in(file.sensor),
        full_well=file.sensor.full_well_e,
        axis=file.sensor.axis,
        **arguments_in(file.optics, Scene, "[optics]", scales),
        limits=limits,
        device=None if file.shutter is None else _device(file.shutter, scales),
        stage=_of_kind(SecondOrderStage, file.stage, "[stage]", scales),
        burst=_burst(file.burst, scales),
        tolerances=_tolerances(file.tolerances, scales),
        occlusion=occlusion,
        decoder_speed=file.decoder.speed,
        motion=_motion(file.motion, file.limits, limits, scales),
        **_picture(file.picture, file.sensor.axis, folder, photographs),
    )


def _speeds(section: Speeds, scales: Scales) -> tuple[np.ndarray, np.ndarray]:
    unit, listed = told_in(section, "list", SPEED_UNITS, "[speeds]")
    forms = {"uniform": section.uniform, "normal": section.normal, "list": listed}
    forms_in_file = [name for name, value in forms.items() if value is not None]
    requirement = "hold one of uniform, normal and list_px_per_s"
    require(
        len(forms_in_file) == 1,
        "[speeds]",
        requirement,
        Unquoted(" and ".join(forms_in_file) or "no speeds"),
    )
    if section.uniform is not None:
        unit, speeds, weights = _uniform(section.uniform)
    elif section.normal is not None:
        unit, speeds, weights = _normal(section.normal)
    else:
        speeds, weights = _listed(listed, section.weights)  # type: ignore[arg-type]
    goes = section.weights is None or listed is not None
    require(goes, "[speeds] weights", "go with list_px_per_s", Unquoted(forms_in_file[0]))
    speeds = speeds * scales.of_things(unit, f"[speeds] in {unit}")
    fastest = float(np.max(np.abs(speeds)))
    require(fastest <= FASTEST, "[speeds]", f"be at most {FASTEST:g} px/s", fastest)
    return speeds, weights


def _pair(form: Uniform | Normal, place: str, names: tuple[str, str]) -> tuple[str, float, float]:
    """The unit of a form of speeds, and its two numbers in that unit."""
    (unit, first), (other, second) = (told_in(form, name, SPEED_UNITS, place) for name in names)
    unit, other = (other if first is None else unit), (unit if second is None else other)
    for name, value, own in ((names[0], first, unit), (names[1], second, other)):
        require(value is not None, f"{place}.{name}_{own}", "be given", Unquoted("nothing"))
    got = Unquoted(f"{names[0]}_{unit} and {names[1]}_{other}")
    require(unit == other, place, "be in one unit", got)
    return unit, first, second  # type: ignore[return-value]


def _uniform(form: Uniform) -> tuple[str, np.ndarray, np.ndarray]:
    place = "[speeds] uniform"
    unit, low, high = _pair(form, place, ("min", "max"))
    require(low <= high, f"{place}.max_{unit}", f"be at least min_{unit} = {low:g}", high)
    requirement = f"be at least 2, for speeds from {low:g} to {high:g}"
    require(form.count > 1 or low == high, f"{place}.count", requirement, form.count)
    return unit, np.linspace(low, high, form.count), np.full(form.count, 1 / form.count)


def _normal(form: Normal) -> tuple[str, np.ndarray, np.ndarray]:
    place = "[speeds] normal"
    unit, mean, deviation = _pair(form, place, ("mean", "deviation"))
    require(form.count > 1, f"{place}.count", "be at least 2, for speeds that deviate", form.count)
    steps = ((2 * np.arange(form.count) + 1) / form.count - 1) * _DEVIATIONS
    density = np.exp(-(steps**2) / 2)
    return unit, mean + deviation * steps, density / density.sum()


def _listed(speeds: list[float], weights: list[float] | None) -> tuple[np.ndarray, np.ndarray]:
    count = len(speeds)
    if weights is None:
        return np.array(speeds), np.full(count, 1 / count)
    subject = "[speeds] weights"
    require(len(weights) == count, subject, f"be {count}, one a speed", len(weights))
    require(sum(weights) > 0, subject, "hold one above 0", weights)
    return np.array(speeds), np.array(weights)


def _of_kind(
    kind: type[_Kind], section: Section | None, place: str, scales: Scales
) -> _Kind | None:
    """The object whose arguments a section holds; None without the section."""
    return None if section is None else kind(**arguments_in(section, kind, place, scales))


def _burst(section: BurstSection | None, scales: Scales) -> Burst | None:
    if section is None:
        return None
    period, place = 1e3 / section.frames_per_s, "[burst] dead_time_ms"
    requirement = f"be shorter than the {period:g} ms from frame to frame"
    require(section.dead_time_ms < period, place, requirement, section.dead_time_ms)
    return _of_kind(Burst, section, "[burst]", scales)


def _device(section: ShutterSection, scales: Scales) -> AbstractDevice:
    """The device that the keys stand for; times of either edge are that of the other if missing."""
    rise, fall = section.rise_ms, section.fall_ms
    lags = rise is not None or fall is not None
    runs = {"min_open_slots": section.min_open_slots, "min_closed_slots": section.min_closed_slots}
    for key, value in ({"delay_ms": section.delay_ms} if not lags else {}).items():
        requirement = "stand beside rise_ms or fall_ms"
        require(value is None, f"[shutter] {key}", requirement, value)
    for key, value in runs.items():
        requirement = "be left to shutters that are open or closed, without times and levels"
        is_switched = not lags and section.levels is None
        require(value is None or is_switched, f"[shutter] {key}", requirement, value)
        most = section.num_slots or NUM_SLOTS
        fits = value is None or value <= most
        require(fits, f"[shutter] {key}", f"be at most num_slots = {most}", value)
    arguments = {
        name: value
        for kind in (FirstOrderShutter, SwitchedShutter)
        for name, value in arguments_in(section, kind, "[shutter]", scales).items()
    }
    times = [arguments[name] for name in ("rise_time", "fall_time") if name in arguments]
    if times:
        arguments |= {"rise_time": times[0], "fall_time": times[-1]}
    return device_of(**arguments)


def _limits(section: LimitsSection, scales: Scales) -> Limits:
    shortest, longest = section.min_half_exposure_ms, section.max_half_exposure_ms
    requirement = f"be at least min_half_exposure_ms = {shortest:g}"
    require(longest >= shortest, "[limits] max_half_exposure_ms", requirement, longest)
    turns = section.max_pan_deg_per_s is None or section.pans == "camera"
    requirement = 'stand beside pans = "camera": a stage does not turn'
    require(turns, "[limits] max_pan_deg_per_s", requirement, section.max_pan_deg_per_s)
    arguments = arguments_in(section, Limits, "[limits]", scales)
    stroke = arguments["max_stroke"]
    subject, requirement = "[limits] max_stroke_mm", f"lie in {_STROKES[0]:g} to {_STROKES[1]:g} px"
    require(_STROKES[0] <= stroke <= _STROKES[1], subject, requirement, stroke)
    return Limits(**arguments)


def _occlusion(section: OcclusionSection | None, scales: Scales) -> Occlusion | None:
    if section is None:
        return None
    arguments = arguments_in(section, Occlusion, "[occlusion]", scales)
    is_shown = section.level_difference == 0 or "object_width" in arguments
    requirement = "stand beside object_width_px: it shows at the edges of objects alone"
    require(is_shown, "[occlusion] level_difference", requirement, section.level_difference)
    return Occlusion(**arguments)


def _tolerances(section: TolerancesSection | None, scales: Scales) -> Tolerances | None:
    if section is None:
        return None
    place, step = "[tolerances]", section.drive_step_us
    requirement = "be given where transmittance has an error"
    lasts = section.transmittance == 0 or step is not None
    require(lasts, f"{place} drive_step_us", requirement, Unquoted("nothing"))
    return Tolerances(**arguments_in(section, Tolerances, place, scales))


def _motion(
    section: MotionSection | None, limits: LimitsSection, reach: Limits, scales: Scales
) -> ParabolicMotion | None:
    if section is None:
        return None
    place, half = "[motion]", section.half_exposure_ms
    low, high = limits.min_half_exposure_ms, limits.max_half_exposure_ms
    requirement = f"lie in the limits {low:g} to {high:g}"
    require(low <= half <= high, f"{place} half_exposure_ms", requirement, half)
    lengths = {f"{name}_{unit}": unit for name in ("sag", "stroke") for unit in ("px", "mm")}
    forms = [*lengths, "acceleration_px_per_s2"]
    forms_in_file = [name for name in forms if getattr(section, name) is not None]
    requirement = f"hold one of {', '.join(forms[:-1])} and {forms[-1]}"
    got = Unquoted(" and ".join(forms_in_file) or "neither")
    require(len(forms_in_file) == 1, place, requirement, got)
    T, v, form = half / 1000, _velocity(section, limits, scales), forms_in_file[0]
    number, subject = getattr(section, form), f"{place} {form}"
    # The stroke of a stage that pans is more than a T^2, as which earlier versions read it.
    is_sag = not form.startswith("stroke") or v == 0 or limits.pans == "camera"
    sag = form.replace("stroke", "sag")
    requirement = f"be {sag} where the stage pans, whose stroke is more than a T^2"
    require(is_sag, subject, requirement, number)
    if form in lengths:
        depth = number * scales.of_stage(lengths[form], subject)
        motion = ParabolicMotion.from_sag(depth, half_exposure=T, velocity=v)
    else:
        motion = ParabolicMotion(acceleration=number, half_exposure=T, velocity=v)
    for name, demand in reach.demands(motion).items():
        _require_met(name, demand, subject, v)
    return motion


def _velocity(section: MotionSection, limits: LimitsSection, scales: Scales) -> float:
    """The velocity of the sensor; px/s. Degrees a second are of a camera that turns."""
    subject, turned = "[motion] velocity_deg_per_s", section.velocity_deg_per_s
    turns = turned is None or limits.pans == "camera"
    requirement = 'stand beside [limits] pans = "camera": a stage does not turn'
    require(turns, subject, requirement, turned)
    units = ("px_per_s", "mm_per_s", "deg_per_s")
    unit, velocity = told_in(section, "velocity", units, "[motion]")
    if unit == "deg_per_s":
        return velocity * scales.of_things(unit, subject)
    return velocity * scales.of_stage(unit, f"[motion] velocity_{unit}")


def _require_met(name: str, demand: Demand, key: str, velocity: float) -> None:
    """Refuse a motion that takes more of a limit than there is."""
    taken, there = float(demand.taken), float(demand.there)
    requirement, got = {
        "stroke": (
            f"keep the stroke within max_stroke_px = {there:g}",
            f"{taken:g} px{', the pan included' if velocity else ''}",
        ),
        "top_speed": (
            f"keep the top speed within max_top_speed_px_per_s = {there:g}",
            f"{taken:g} px/s",
        ),
        "pan": (f"keep within max_pan_px_per_s = {there:g}", repr(velocity)),
        "travel": (
            "leave the stage room to run up and out within its travel and top speed",
            f"{taken:.3g} times as much",
        ),
        "acceleration": (f"keep within max_acceleration, {there:g} px/s^2", f"{taken:g} px/s^2"),
        "exposure_too_short": (
            f"leave an exposure of at least {2e3 * taken:g} ms",
            f"{2e3 * there:g} ms",
        ),
        "exposure_too_long": (
            f"leave an exposure of at most {2e3 * there:g} ms",
            f"{2e3 * taken:g} ms",
        ),
    }[name]
    subject = "[motion] velocity_px_per_s" if name == "pan" else key
    require(bool(demand.is_met(_MARGIN)), subject, requirement, Unquoted(got))


def _picture(
    section: PictureSection, axis: Axis, folder: Path, photographs: Photographs | None
) -> Mapping[str, Any]:
    """Arguments of `Scene` that a photograph, or what stands for one, gives."""
    levels = {"mean_level": section.mean_level, "deviation": section.deviation}
    levels_in_file = {name: value for name, value in levels.items() if value is not None}
    own = section.path not in (None, EXAMPLE_PICTURE)
    for key in ("white", "linear"):
        requirement = "stand beside the path of a photograph of one's own"
        got = Unquoted("no path" if section.path is None else section.path)
        require(own or getattr(section, key) is None, f"[picture] {key}", requirement, got)
    if section.path is None:
        return levels_in_file
    require(
        not levels_in_file,
        f"[picture] {next(iter(levels_in_file), '')}",
        "not stand beside path",
        section.path,
    )
    white, linear = section.white, bool(section.linear)
    if photographs is not None:
        return photographs(section.path, white, linear, axis)
    place = str((folder / section.path).absolute()) if own else EXAMPLE_PICTURE
    return picture_arguments(place, _picture_at(place, white, linear), white, linear, axis)


def scene_picture(scene: Scene) -> Picture:
    """The photograph that a scene names.

    Raises:
        OSError: if it cannot be read.
        ValueError: if there is none, or it is no picture.
    """
    require(scene.picture is not None, "Scene(picture=...)", "name a photograph", scene.picture)
    return _picture_at(str(scene.picture), scene.picture_white, scene.picture_linear)


def _picture_at(place: str, white: float | None, linear: bool) -> Picture:
    if place == EXAMPLE_PICTURE:
        return example_picture()
    return read_picture(place, white=white, linear=linear)


def picture_arguments(
    place: str,
    picture: Picture,
    white: float | None = None,
    linear: bool = False,
    axis: Axis = "rows",
) -> dict[str, Any]:
    """Arguments of `Scene` that a photograph gives.

    Args:
        place: The place that it came from.
        picture: The photograph.
        white: The argument of `read_picture` that it was read with.
        linear: The argument of `read_picture` that it was read with.
        axis: The axis of the scene, along which its spectrum is.
    """
    along = picture.turned() if axis == "columns" else picture
    spectrum = row_power_spectrum(along, _NUM_FREQUENCIES)._asdict()
    return {"picture": place, "picture_white": white, "picture_linear": linear, **spectrum}
