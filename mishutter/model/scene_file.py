"""Scenes written down in TOML, with the unit in each key's name.

`example_scene.toml`, beside this file, is annotated and shows every section. Each error
is one line that names the key as `[section] key`.
"""

import json
import tomllib
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

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
from mishutter.model.images import (
    Axis,
    Picture,
    example_picture,
    read_picture,
    row_power_spectrum,
)
from mishutter.model.limits import Demand, Limits
from mishutter.model.motion import ParabolicMotion
from mishutter.model.occlusion import Occlusion
from mishutter.model.scene import Burst, Scene
from mishutter.model.scene_schema import (
    LimitsSection,
    MotionSection,
    Normal,
    OcclusionSection,
    PictureSection,
    SceneFile,
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
    photon_rate,
    read_noise,
    speed_of,
    told_in,
)
from mishutter.model.servos import SecondOrderStage
from mishutter.model.tolerances import Tolerances

Photographs = Callable[[str, float | None, bool, Axis], Mapping[str, Any]]
"""The `picture_arguments` of a photograph, by `path`, `white`, `linear` and `axis` of a file."""
EXAMPLE_PICTURE = "example"
"""What `[picture] path` says for the photograph that scikit-image ships."""

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
        text: As `2400`, `0.9 m/s`, `0.9 mm/s` or `3 deg/s`.
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
    tables: dict[str, Any] = {
        "speeds": {"list_px_per_s": scene.speeds.tolist(), "weights": scene.weights.tolist()},
        "light": {"photon_rate_per_s": float(scene.photon_rate)},
        "sensor": {"read_noise_e": float(scene.read_noise), "axis": scene.axis},
        "optics": {
            "cutoff_cycles_per_px": float(scene.cutoff_frequency),
            "lens_blur_px": float(scene.lens_blur),
        },
        "limits": _limits_table(scene.limits),
        "picture": {
            "path": scene.picture,
            "white": scene.picture_white,
            "linear": scene.picture_linear or None,
        },
    }
    if scene.full_well is not None:
        tables["sensor"]["full_well_e"] = float(scene.full_well)
    if scene.picture is None:
        levels = {"mean_level": scene.mean_level, "deviation": scene.deviation}
        tables["picture"] = {name: float(value) for name, value in levels.items()}
    tables |= _optional_tables(scene)
    if scene.decoder_speed != "unknown":
        tables["decoder"] = {"speed": scene.decoder_speed}
    if isinstance(scene.given_motion, ParabolicMotion):
        tables["motion"] = {
            "half_exposure_ms": float(scene.given_motion.half_exposure) * 1e3,
            "acceleration_px_per_s2": float(scene.given_motion.acceleration),
            "velocity_px_per_s": float(scene.given_motion.velocity),
        }
    file = validated(SceneFile, tables, "scene_text(scene=...)", in_section)
    said = notes or {}
    lines = [f"# {line}" for line in said.get("", ())]
    for name, section in file.model_dump(exclude_none=True).items():
        lines += ["", *(f"# {line}" for line in said.get(name, ())), f"[{name}]"]
        # Finite numbers and text of JSON are those of TOML.
        lines += [f"{key} = {json.dumps(value)}" for key, value in section.items()]
    return "\n".join(lines).lstrip("\n") + "\n"


def _optional_tables(scene: Scene) -> dict[str, Any]:
    """Tables of what a scene may do without."""
    tables: dict[str, Any] = {}
    if scene.occlusion is not None:
        tables["occlusion"] = _occlusion_table(scene.occlusion)
    if scene.device is not None:
        tables["shutter"] = _device_table(scene.device)
    if scene.stage is not None:
        bandwidth, damping = float(scene.stage.bandwidth), float(scene.stage.damping)
        tables["stage"] = {"bandwidth_hz": bandwidth, "damping": damping}
    if scene.burst is not None:
        frames = float(scene.burst.frames_per_s)
        tables["rivals"] = {"frames_per_s": frames, "max_frames": scene.burst.max_frames}
    if scene.tolerances is not None:
        tables["tolerances"] = _tolerances_table(scene.tolerances)
    return tables


def _limits_table(limits: Limits) -> dict[str, float | str]:
    table = {
        "max_stroke_px": limits.max_stroke,
        "max_top_speed_px_per_s": limits.max_top_speed,
        "min_half_exposure_ms": limits.min_half_exposure * 1e3,
        "max_half_exposure_ms": limits.max_half_exposure * 1e3,
        "max_pan_px_per_s": limits.max_pan,
        "max_travel_px": limits.max_travel,
        "max_acceleration_px_per_s2": limits.max_acceleration,
        "max_jerk_px_per_s3": limits.max_jerk,
    }
    numbers = {key: float(value) for key, value in table.items() if value is not None}
    return numbers | {"pans": limits.pans}


def _device_table(device: AbstractDevice) -> dict[str, float | int]:
    table: dict[str, Any] = {
        "transmission": float(device.transmission),
        "leakage": float(device.leakage),
        "levels": device.levels,
        "num_slots": device.num_slots,
    }
    if isinstance(device, FirstOrderShutter):
        times = {"rise_ms": device.rise_time, "fall_ms": device.fall_time, "delay_ms": device.delay}
        table |= {key: float(time) * 1e3 for key, time in times.items() if time is not None}
    if isinstance(device, IdealShutter) and device.levels is None and device.num_slots is not None:
        # Slots without levels and times are of a device that is open or closed.
        table |= {"rise_ms": 0.0, "fall_ms": 0.0}
    if isinstance(device, SwitchedShutter):
        table |= {"min_open_slots": device.min_open, "min_closed_slots": device.min_closed}
        # Two levels are what a file without `levels` says of such a device.
        table["levels"] = None
    return table


def _tolerances_table(tolerances: Tolerances) -> dict[str, float]:
    table = {
        "acceleration_share": float(tolerances.acceleration),
        "velocity_px_per_s": float(tolerances.velocity),
        "delay_us": float(tolerances.delay) * 1e6,
        "object_speed_px_per_s": float(tolerances.speed),
        "transmittance": float(tolerances.transmittance),
    }
    step = float(tolerances.drive_step) * 1e6
    return table | ({"drive_step_us": step} if step > 0 else {})


def _occlusion_table(occlusion: Occlusion) -> dict[str, float | str]:
    table: dict[str, float | str] = {
        "front_share": float(occlusion.front_share),
        "background": occlusion.background,
    }
    if occlusion.object_width is not None:
        table["object_width_px"] = float(occlusion.object_width)
        table["level_difference"] = float(occlusion.level_difference)
    return table


def _scene(data: bytes, name: str, folder: Path) -> Scene:
    return scene_of_tables(parsed(tomllib.loads, data, name, "TOML"), name, folder)


def scene_of_tables(
    tables: Any, name: str, folder: Path, photographs: Photographs | None = None
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
    requirement = "be 'unknown' or 'told' beside [occlusion], where no one speed is the picture's"
    require(is_whole, "[decoder] speed", requirement, file.decoder.speed)
    return Scene(
        speeds,
        weights,
        photon_rate=photon_rate(file.light, scales),
        read_noise=read_noise(file.sensor),
        cutoff_frequency=file.optics.cutoff_cycles_per_px,
        lens_blur=file.optics.lens_blur_px,
        limits=limits,
        device=None if file.shutter is None else _device(file.shutter),
        full_well=file.sensor.full_well_e,
        stage=None if file.stage is None else _stage(file.stage),
        burst=None if file.rivals is None else Burst(**file.rivals.model_dump()),
        tolerances=_tolerances(file.tolerances, scales),
        occlusion=occlusion,
        decoder_speed=file.decoder.speed,
        axis=file.sensor.axis,
        motion=_motion(file.motion, file.limits, limits, scales),
        **_picture(file.picture, file.sensor.axis, folder, photographs),
    )


def _speeds(section: Speeds, scales: Scales) -> tuple[np.ndarray, np.ndarray]:
    unit, listed = told_in(section, "list", SPEED_UNITS, "[speeds]")
    forms = {"uniform": section.uniform, "normal": section.normal, "list": listed}
    given = [name for name, value in forms.items() if value is not None]
    requirement = "hold one of uniform, normal and list_px_per_s"
    require(len(given) == 1, "[speeds]", requirement, Unquoted(" and ".join(given) or "no speeds"))
    if section.uniform is not None:
        unit, speeds, weights = _uniform(section.uniform)
    elif section.normal is not None:
        unit, speeds, weights = _normal(section.normal)
    else:
        speeds, weights = _listed(listed, section.weights)  # type: ignore[arg-type]
    goes = section.weights is None or listed is not None
    require(goes, "[speeds] weights", "go with list_px_per_s", Unquoted(given[0]))
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
    middle = np.array([(low + high) / 2])
    speeds = middle if form.count == 1 else np.linspace(low, high, form.count)
    return unit, speeds, np.full(form.count, 1 / form.count)


def _normal(form: Normal) -> tuple[str, np.ndarray, np.ndarray]:
    unit, mean, deviation = _pair(form, "[speeds] normal", ("mean", "deviation"))
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


def _device(section: ShutterSection) -> AbstractDevice:
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
    times = {
        "rise_time": fall if rise is None else rise,
        "fall_time": rise if fall is None else fall,
    }
    times["delay"] = section.delay_ms
    return device_of(
        transmission=section.transmission,
        leakage=section.leakage,
        levels=section.levels,
        num_slots=section.num_slots,
        min_open=section.min_open_slots,
        min_closed=section.min_closed_slots,
        **{name: None if ms is None else ms / 1000 for name, ms in times.items()},
    )


def _stage(section: StageSection) -> SecondOrderStage:
    return SecondOrderStage(bandwidth=section.bandwidth_hz, damping=section.damping)


def _limits(section: LimitsSection, scales: Scales) -> Limits:
    shortest, longest = section.min_half_exposure_ms, section.max_half_exposure_ms
    requirement = f"be at least min_half_exposure_ms = {shortest:g}"
    require(longest >= shortest, "[limits] max_half_exposure_ms", requirement, longest)
    turns = section.max_pan_deg_per_s is None or section.pans == "camera"
    requirement = 'stand beside pans = "camera": a stage does not turn'
    require(turns, "[limits] max_pan_deg_per_s", requirement, section.max_pan_deg_per_s)
    stroke = _of_stage(section, "max_stroke", ("px", "mm"), scales)
    top_speed = _of_stage(section, "max_top_speed", ("px_per_s", "mm_per_s"), scales)
    subject, requirement = "[limits] max_stroke_mm", f"lie in {_STROKES[0]:g} to {_STROKES[1]:g} px"
    require(_STROKES[0] <= stroke <= _STROKES[1], subject, requirement, stroke)
    pan = _of_things(section, "max_pan", ("px_per_s", "deg_per_s"), scales, "[limits]")
    return Limits(
        max_stroke=stroke,
        max_top_speed=top_speed,
        min_half_exposure=shortest / 1000,
        max_half_exposure=longest / 1000,
        max_pan=pan,
        max_travel=_of_stage(section, "max_travel", ("px", "mm"), scales),
        max_acceleration=_of_stage(section, "max_acceleration", ("px_per_s2", "g"), scales),
        max_jerk=_of_stage(section, "max_jerk", ("px_per_s3", "g_per_s"), scales),
        pans=section.pans,
    )


def _of_stage(
    section: Section, name: str, units: tuple[str, str], scales: Scales, place: str = "[limits]"
) -> Any:
    """A number of the stage in px, given in one of its units; None where it is not."""
    unit, value = told_in(section, name, units, place)
    return None if value is None else value * scales.of_stage(unit, f"{place} {name}_{unit}")


def _of_things(
    section: Section, name: str, units: tuple[str, ...], scales: Scales, place: str
) -> Any:
    """A speed of things in px/s, given in one of its units; None where it is not."""
    unit, value = told_in(section, name, units, place)
    return None if value is None else value * scales.of_things(unit, f"{place} {name}_{unit}")


def _occlusion(section: OcclusionSection | None, scales: Scales) -> Occlusion | None:
    if section is None:
        return None
    unit, width = told_in(section, "object_width", ("px", "mm", "m"), "[occlusion]")
    if width is not None:
        width *= scales.of_things(unit, f"[occlusion] object_width_{unit}")
    difference = section.level_difference
    seen = difference == 0 or width is not None
    requirement = "stand beside object_width_px: it shows at the edges of objects alone"
    require(seen, "[occlusion] level_difference", requirement, difference)
    return Occlusion(
        front_share=section.front_share,
        object_width=width,
        level_difference=difference,
        background=section.background,
    )


def _tolerances(section: TolerancesSection | None, scales: Scales) -> Tolerances | None:
    if section is None:
        return None
    place, step = "[tolerances]", section.drive_step_us
    requirement = "be given where transmittance has an error"
    lasts = section.transmittance == 0 or step is not None
    require(lasts, f"{place} drive_step_us", requirement, Unquoted("nothing"))
    return Tolerances(
        acceleration=section.acceleration_share,
        velocity=_of_stage(section, "velocity", ("px_per_s", "mm_per_s"), scales, place),
        delay=section.delay_us * 1e-6,
        speed=_of_things(section, "object_speed", SPEED_UNITS, scales, place),
        transmittance=section.transmittance,
        drive_step=0.0 if step is None else step * 1e-6,
    )


def _motion(
    section: MotionSection | None, limits: LimitsSection, reach: Limits, scales: Scales
) -> ParabolicMotion | None:
    if section is None:
        return None
    place, half = "[motion]", section.half_exposure_ms
    low, high = limits.min_half_exposure_ms, limits.max_half_exposure_ms
    requirement = f"lie in the limits {low:g} to {high:g}"
    require(low <= half <= high, f"{place} half_exposure_ms", requirement, half)
    forms = ("stroke_px", "stroke_mm", "acceleration_px_per_s2")
    given = [name for name in forms if getattr(section, name) is not None]
    requirement = "hold one of stroke_px, stroke_mm and acceleration_px_per_s2"
    require(len(given) == 1, place, requirement, Unquoted(" and ".join(given) or "neither"))
    T = half / 1000
    a = section.acceleration_px_per_s2
    a = _of_stage(section, "stroke", ("px", "mm"), scales, place) / T**2 if a is None else a
    v = _velocity(section, limits, scales)
    motion = ParabolicMotion(acceleration=a, half_exposure=T, velocity=v)
    for name, demand in reach.demands(motion).items():
        _require_met(name, demand, f"{place} {given[0]}", v)
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
    given = {name: value for name, value in levels.items() if value is not None}
    own = section.path not in (None, EXAMPLE_PICTURE)
    for key in ("white", "linear"):
        requirement = "stand beside the path of a photograph of one's own"
        got = Unquoted("no path" if section.path is None else section.path)
        require(own or getattr(section, key) is None, f"[picture] {key}", requirement, got)
    if section.path is None:
        return given
    require(not given, f"[picture] {next(iter(given), '')}", "not stand beside path", section.path)
    coding = section.white, bool(section.linear)
    if photographs is not None:
        return photographs(section.path, *coding, axis)
    place = str((folder / section.path).absolute()) if own else EXAMPLE_PICTURE
    return picture_arguments(place, _picture_at(place, *coding), *coding, axis)


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
