"""The keys of a scene file, their units and ranges, and one line for each wrong one."""

import difflib
from typing import Annotated, Any, final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mishutter.types import describe

Speed = Annotated[float, Field(ge=-1e7, le=1e7)]
PositiveSpeed = Annotated[float, Field(gt=0, le=1e7)]
Count = Annotated[int, Field(ge=1, le=1000)]
Milliseconds = Annotated[float, Field(ge=1e-3, le=1e5)]
Stroke = Annotated[float, Field(gt=0, le=1e4)]
Share = Annotated[float, Field(ge=0, le=1)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


@final
class Uniform(_Section):
    """Equally likely speeds at equal steps."""

    min_px_per_s: Speed
    max_px_per_s: Speed
    count: Count


@final
class Normal(_Section):
    """Normally distributed speeds: centres of equal steps over three deviations, by density."""

    mean_px_per_s: Speed
    deviation_px_per_s: PositiveSpeed
    count: Count


@final
class Speeds(_Section):
    """How fast things move, in one of three forms."""

    uniform: Uniform | None = None
    normal: Normal | None = None
    list_px_per_s: Annotated[list[Speed], Field(min_length=1, max_length=1000)] | None = None
    weights: list[Share] | None = None


@final
class Light(_Section):
    """Photo-electrons a second at a white pixel."""

    photon_rate_per_s: Annotated[float, Field(gt=0, le=1e12)]


@final
class Sensor(_Section):
    """Noise of the sensor."""

    read_noise_e: Annotated[float, Field(ge=0, le=1e6)]


@final
class OpticsSection(_Section):
    """What the lens passes."""

    cutoff_cycles_per_px: Annotated[float, Field(gt=0, le=0.5)] = 0.5


@final
class LimitsSection(_Section):
    """What the mechanism and the exposure may reach."""

    max_stroke_px: Stroke = 200.0
    max_top_speed_px_per_s: PositiveSpeed = 1e5
    min_half_exposure_ms: Milliseconds = 0.1
    max_half_exposure_ms: Milliseconds = 500.0


@final
class MotionSection(_Section):
    """A half exposure, and the stroke or the acceleration."""

    half_exposure_ms: Milliseconds
    stroke_px: Annotated[float, Field(ge=0, le=1e4)] | None = None
    acceleration_px_per_s2: Annotated[float, Field(ge=0, le=1e14)] | None = None


@final
class PictureSection(_Section):
    """The photograph, or what stands for one."""

    path: Annotated[str, Field(min_length=1)] | None = None
    mean_level: Share | None = None
    deviation: Annotated[float, Field(ge=0, le=0.5)] | None = None


@final
class SceneFile(_Section):
    """A whole scene file."""

    speeds: Speeds
    light: Light
    sensor: Sensor
    optics: OpticsSection = OpticsSection()
    limits: LimitsSection = LimitsSection()
    motion: MotionSection | None = None
    picture: PictureSection = PictureSection()


class Bare(str):
    """Text that an error shows without quotes."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def first_line(error: ValidationError) -> str:
    """The error to mend first, unknown keys before the missing ones they may stand for."""
    problems = error.errors(include_url=False)
    first = min(problems, key=lambda p: p["type"] != "extra_forbidden")
    place, got = list(first["loc"]), first["input"]
    if first["type"] == "extra_forbidden":
        return _unknown_key([str(part) for part in place])
    requirement = _requirement(first["type"], first.get("ctx", {}), first["msg"])
    if first["type"] == "missing":
        got = Bare("nothing")
    return f"`{_key_name(place)}` must {requirement}; got {describe(got)}."


def _requirement(kind: str, context: dict[str, Any], message: str) -> str:
    sentences = {
        "missing": "be given",
        "greater_than": "be above {gt:g}",
        "greater_than_equal": "be at least {ge:g}",
        "less_than_equal": "be at most {le:g}",
        "finite_number": "be finite",
        "float_type": "be a number",
        "int_type": "be a whole number",
        "string_type": "be text",
        "list_type": "be a list of numbers",
        "model_type": "be a table",
        "too_short": "hold at least {min_length} value",
        "too_long": "hold at most {max_length} values",
        "string_too_short": "not be empty",
    }
    return sentences[kind].format(**context) if kind in sentences else f"hold: {message}"


def _key_name(place: list[Any]) -> str:
    section, *keys = place
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)
    return f"[{section}] {text.removeprefix('.')}".rstrip()


def _unknown_key(place: list[str]) -> str:
    """An unknown key with the nearest known one: of its table if near, else of any."""
    *tables, key = place
    known = {name.rsplit(" ", 1)[-1]: name for name in reversed(_known_keys(SceneFile))}
    siblings = dict(_children(SceneFile, tables))
    near = difflib.get_close_matches(key, siblings, n=1, cutoff=0.5)
    elsewhere = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    if near:
        suggestion = _key_name([*tables, near[0]])
    else:
        suggestion = known[elsewhere[0]] if elsewhere else None
    hint = f", perhaps `{suggestion}`" if suggestion else ""
    where = f"`{_key_name(list(tables))}`" if tables else "the file"
    return f"{where} must hold known keys only{hint}; got {describe(key)}."


def _children(model: type[BaseModel], tables: list[str]) -> list[tuple[str, Any]]:
    for name in tables:
        model = _table_of(model.model_fields[name].annotation) or model
    return [(name, field.annotation) for name, field in model.model_fields.items()]


def _known_keys(model: type[BaseModel], *tables: str) -> list[str]:
    names = []
    for name, field in model.model_fields.items():
        table = _table_of(field.annotation)
        names.append(_key_name([*tables, name]))
        names.extend(_known_keys(table, *tables, name) if table else [])
    return names


def _table_of(annotation: Any) -> type[BaseModel] | None:
    options = [annotation, *getattr(annotation, "__args__", ())]
    tables = [o for o in options if isinstance(o, type) and issubclass(o, BaseModel)]
    return tables[0] if tables else None
