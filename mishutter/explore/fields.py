"""The fields of the page, from the schema of the scene file, and a scene file from what they hold.

Units, ranges and defaults stand in the schema alone, and first values of what a scene may leave
out in the annotated example: a key that is added there is a field here.
"""

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

from mishutter.model import SceneFile, example_scene_text

_UNITS = {"e": "e⁻", "s2": "s²", "s3": "s³", "us": "µs", "um": "µm", "db": "dB", "hz": "Hz"}
"""Units that are written otherwise in the name of a key."""
_OWN_UNITS = {*_UNITS, "px", "s", "ms", "m", "mm", "cycles", "deg", "g", "lux"}
_SECTION = re.compile(r"^(?:# )?\[(\w+)\]", re.MULTILINE)
_KEY = re.compile(r"^(?:#\s*)?(\w+) = (\{.*?\}|\[.*?\]|\S+)", re.MULTILINE)


def page_fields() -> list[dict[str, Any]]:
    """Sections of a scene file in its order, each with its keys.

    Returns:
        For each section its `key`, `label` and `description`, whether it is `optional`, and
        `fields`: of each the `key`, a `label`, the `unit`, a `kind` (`number`, `integer`,
        `boolean`, `text`, `list`, `choice`, or `table`, which has `fields` again), `minimum` and
        `maximum`, whether these are excluded (`above`, `below`), whether it is `optional`, its
        `default`, and a value to `begin` with; a table begins with the keys that the example has.
    """
    schema = SceneFile.model_json_schema()
    return [_table(schema, name, entry, (name,)) for name, entry in schema["properties"].items()]


def _table(
    schema: Mapping[str, Any], key: str, entry: Mapping[str, Any], place: tuple[str, ...]
) -> dict[str, Any]:
    table = _resolved(schema, entry)
    parts = table["properties"].items()
    fields = [_field(schema, name, part, (*place, name)) for name, part in parts]
    return {
        "key": key,
        "label": key.replace("_", " "),
        "kind": "table",
        "description": table.get("description", ""),
        "optional": _may_be_left_out(entry),
        "begin": {
            field["key"]: field["begin"]
            for field in fields
            if (*place, field["key"]) in _examples() or _must_be_given(field)
        },
        "fields": fields,
    }


def _field(
    schema: Mapping[str, Any], key: str, entry: Mapping[str, Any], place: tuple[str, ...]
) -> dict[str, Any]:
    found = _resolved(schema, entry)
    if "properties" in found:
        return _table(schema, key, entry, place)
    label, unit = label_and_unit(key)
    kinds = {"array": "list", "string": "text"}
    kind = "choice" if "enum" in found else str(kinds.get(found["type"], found["type"]))
    bounds = found.get("items", found)
    low, high = (bounds.get(name) for name in ("exclusiveMinimum", "exclusiveMaximum"))
    default = entry.get("default")
    return {
        "key": key,
        "label": label,
        "unit": unit,
        "kind": kind,
        "choices": found.get("enum", []),
        "minimum": bounds.get("minimum", low),
        "maximum": bounds.get("maximum", high),
        "above": low is not None,
        "below": high is not None,
        "optional": _may_be_left_out(entry),
        "default": default,
        "begin": _begin(place, kind, default, bounds),
    }


def _resolved(schema: Mapping[str, Any], entry: Mapping[str, Any]) -> Mapping[str, Any]:
    """The entry that a reference or a choice between it and nothing leads to."""
    options = [o for o in entry.get("anyOf", [entry]) if o.get("type") != "null"]
    found = options[0]
    return schema["$defs"][found["$ref"].split("/")[-1]] if "$ref" in found else found


def _must_be_given(field: Mapping[str, Any]) -> bool:
    return not field["optional"] and field.get("default") is None


def _may_be_left_out(entry: Mapping[str, Any]) -> bool:
    return any(option.get("type") == "null" for option in entry.get("anyOf", ()))


def label_and_unit(key: str) -> tuple[str, str]:
    """A key's name in words, and the unit that it ends in; `""` for none."""
    words = key.split("_")
    first = len(words)
    while first > 1 and (words[first - 1] in _OWN_UNITS or words[first - 1] == "per"):
        first -= 1
    tail = [_UNITS.get(word, word) for word in words[first:]]
    unit = "".join("/" if word == "per" else word for word in tail)
    return " ".join(words[:first]), f"1{unit}" if unit.startswith("/") else unit


def _begin(place: tuple[str, ...], kind: str, default: Any, bounds: Mapping[str, Any]) -> Any:
    """The value of a key that is put into a scene: the example's, the default, or one in range."""
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
def _examples() -> dict[tuple[str, ...], Any]:
    """Values in the annotated example, those that are commented out among them."""
    text = example_scene_text()
    headings = [(match.start(), match[1]) for match in _SECTION.finditer(text)]
    found: dict[tuple[str, ...], Any] = {}
    for match in _KEY.finditer(text):
        before = [name for start, name in headings if start < match.start()]
        section = before[-1] if before else headings[0][1]  # its keys may be explained before it
        try:
            value = tomllib.loads(f"value = {match[2]}")["value"]
        except tomllib.TOMLDecodeError:
            continue
        parts = value if isinstance(value, dict) else {}
        found.setdefault((section, match[1]), value)
        for key, number in parts.items():
            found.setdefault((section, match[1], key), number)
    return found


def scene_text(tables: Mapping[str, Any]) -> str:
    """A scene file with the given tables, which their schema allows."""
    return "\n".join(_lines(tables)) + "\n"


def _lines(tables: Mapping[str, Any]) -> Iterator[str]:
    for section, table in tables.items():
        yield f"[{section}]"
        yield from (f"{key} = {_value(value)}" for key, value in table.items())
        yield ""


def _value(value: Any) -> str:
    """A value as TOML, in which strings and truth are written as in JSON, but for one letter."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_value(x)}" for key, x in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
