"""The fields of the page, from the schema of the scene file, and a scene file from their values.

Units, ranges and defaults come from the schema alone, and first values of optional keys from the
annotated example: a new key there becomes a field here.
"""

import json
import re
import tomllib
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from mishutter.model.scene_file import example_scene_text
from mishutter.model.scene_schema import SceneFile

_UNITS = {"e": "e⁻", "s2": "s²", "s3": "s³", "us": "µs", "um": "µm", "db": "dB", "hz": "Hz"}
"""Units by their spelling in the name of a key."""
Schema = Mapping[str, Any]
"""A JSON schema, or a part of one."""
Field = dict[str, Any]
"""A key or a table of a scene file as the page shows it; see `page_fields`."""
Tables = dict[str, Any]
"""The tables of a scene file as a TOML parser reads them."""
Place = tuple[str, ...]
"""The names that lead to a key of a scene file, section first."""


def page_fields() -> list[Field]:
    """Sections of a scene file in its order, each with its keys."""
    schema = SceneFile.model_json_schema()
    return [_table(schema, name, entry, (name,)) for name, entry in schema["properties"].items()]


def _table(schema: Schema, key: str, entry: Schema, place: Place) -> Field:
    """The field of a table, with the fields of its keys."""
    table = _resolved(schema, entry)
    parts = table["properties"].items()
    fields = [_field(schema, name, part, (*place, name)) for name, part in parts]
    return {
        "key": key,
        "label": key.replace("_", " "),
        "kind": "table",
        "description": table.get("description", ""),
        "optional": _is_optional(entry),
        "begin": {
            field["key"]: field["begin"]
            for field in fields
            if (*place, field["key"]) in _examples()
            or (not field["optional"] and field.get("default") is None)
        },
        "fields": fields,
    }


def _field(schema: Schema, key: str, entry: Schema, place: Place) -> Field:
    """The field of a key."""
    value = _resolved(schema, entry)
    if "properties" in value:
        return _table(schema, key, entry, place)
    label, unit = label_and_unit(key)
    kinds = {"array": "list", "string": "text"}
    kind = "choice" if "enum" in value else str(kinds.get(value["type"], value["type"]))
    bounds = value.get("items", value)
    low, high = (bounds.get(name) for name in ("exclusiveMinimum", "exclusiveMaximum"))
    default = entry.get("default")
    return {
        "key": key,
        "label": label,
        "unit": unit,
        "kind": kind,
        "choices": value.get("enum", []),
        "minimum": bounds.get("minimum", low),
        "maximum": bounds.get("maximum", high),
        "above": low is not None,
        "below": high is not None,
        "optional": _is_optional(entry),
        "default": default,
        "begin": _begin(place, kind, default, bounds),
    }


def _resolved(schema: Schema, entry: Schema) -> Schema:
    """The schema that an entry refers to, without its alternative `null`."""
    options = [o for o in entry.get("anyOf", [entry]) if o.get("type") != "null"]
    option = options[0]
    return schema["$defs"][option["$ref"].split("/")[-1]] if "$ref" in option else option


def _is_optional(entry: Schema) -> bool:
    return any(option.get("type") == "null" for option in entry.get("anyOf", ()))


def label_and_unit(key: str) -> tuple[str, str]:
    """Splits the name of a key into words and its unit, `""` for none."""
    plain = {"px", "s", "ms", "h", "m", "mm", "km", "cycles", "deg", "g", "lux", "per"}
    words = key.split("_")
    first = len(words)
    while first > 1 and words[first - 1] in plain | _UNITS.keys():
        first -= 1
    tail = [_UNITS.get(word, word) for word in words[first:]]
    unit = "".join("/" if word == "per" else word for word in tail)
    return " ".join(words[:first]), f"1{unit}" if unit.startswith("/") else unit


def _begin(place: Place, kind: str, default: object, bounds: Schema) -> object:
    """First value of a key: that of the example, else the default, else a value in range."""
    if place in _examples():
        return _examples()[place]
    if default is not None:
        return default
    low = bounds.get("minimum", bounds.get("exclusiveMinimum", 0))
    high = bounds.get("maximum", bounds.get("exclusiveMaximum", 1))
    numbers = {"number": (low + high) / 2 if high <= 1 else max(low, 1.0), "integer": max(low, 2)}
    others = {"boolean": True, "list": [], "choice": next(iter(bounds.get("enum", [])), None)}
    return {**numbers, **others}.get(kind, "")


@lru_cache
def _examples() -> dict[Place, object]:
    """Values in the annotated example, also those that are commented out."""
    text = example_scene_text()
    sections = re.finditer(r"^(?:# )?\[(\w+)\]", text, re.MULTILINE)
    headings = [(match.start(), match[1]) for match in sections]
    values: dict[Place, object] = {}
    keys = re.finditer(r"^(?:#\s*)?(\w+) = (\{.*?\}|\[.*?\]|\S+)", text, re.MULTILINE)
    for match in keys:
        before = [name for start, name in headings if start < match.start()]
        section = before[-1] if before else headings[0][1]  # a comment may name its keys before it
        try:
            value = tomllib.loads(f"value = {match[2]}")["value"]
        except tomllib.TOMLDecodeError:
            continue
        values.setdefault((section, match[1]), value)
        for key, number in value.items() if isinstance(value, dict) else ():
            values.setdefault((section, match[1], key), number)
    return values


def scene_text(tables: Tables) -> str:
    """Text of a scene file."""
    lines = []
    for section, table in tables.items():
        keys = (f"{key} = {_value(value)}" for key, value in table.items())
        lines += [f"[{section}]", *keys, ""]
    return "\n".join(lines) + "\n"


def _value(value: object) -> str:
    """A value as TOML, whose strings and booleans differ from JSON in one letter."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_value(x)}" for key, x in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
