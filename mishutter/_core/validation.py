"""Validation of files by a schema, with errors of one line.

The line names the file, the key, the requirement and the value; for an unknown key it suggests the
nearest known one.
"""

import difflib
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from mishutter._core.checks import Unquoted, describe

Place = tuple[Any, ...]
"""Path to a key: the names of its tables, its own name, and indices of lists."""


class Section(BaseModel):
    """A table of a file: it has known keys alone, converts nothing and holds finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)

    renamed: ClassVar[Mapping[str, str]] = {}
    """Keys of earlier versions or of other words, each with the key that an error names instead."""


File = TypeVar("File", bound=Section)
_Parsed = TypeVar("_Parsed")


def parsed(parse: Callable[[str], _Parsed], content: bytes, name: str, form: str) -> _Parsed:
    """The parsed contents of a text file."""
    try:
        return parse(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ValueError(f"{name} must be UTF-8 text; got byte {error.start} of it.") from None
    except RecursionError:
        reason = "brackets nested too deeply to read"
    except ValueError as error:
        reason = str(error).partition("; use sys.")[0]
    raise ValueError(f"{name} must be a {form} file; got: {reason}.")


def dotted(place: Place) -> str:
    """A key as `section.key[index]`."""
    return "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in place).lstrip(".")


def in_section(place: Place) -> str:
    """A key as `[section] key[index]`."""
    return f"[{place[0]}] {dotted(place[1:])}".rstrip()


def validated(
    model: type[File], tables: object, name: str, key_name: Callable[[Place], str] = dotted
) -> File:
    """Tables of a file, validated by their schema.

    The message is of one error; an unknown key comes before missing ones, because it may be a
    misspelling of one.
    """
    try:
        return model.model_validate(tables)
    except ValidationError as error:
        problems = error.errors(include_url=False)
    first = min(problems, key=lambda p: p["type"] != "extra_forbidden")
    if first["type"] == "extra_forbidden":
        raise ValueError(f"{name}: {_unknown_key(model, first['loc'], key_name)}")
    got = Unquoted("nothing") if first["type"] == "missing" else first["input"]
    subject = f"`{key_name(first['loc'])}`" if first["loc"] else "the file"
    raise ValueError(f"{name}: {subject} must {requirement(first)}; got {describe(got)}.")


def requirement(problem: Mapping[str, Any]) -> str:
    """The requirement that an entry of `ValidationError.errors()` states."""
    sentences = {
        "missing": "be given",
        "greater_than": "be above {gt}",
        "greater_than_equal": "be at least {ge}",
        "less_than_equal": "be at most {le}",
        "finite_number": "be finite",
        "float_type": "be a number",
        "float_parsing": "be a number",
        "int_type": "be a whole number",
        "int_parsing": "be a whole number",
        "bool_type": "be true or false",
        "string_type": "be text",
        "list_type": "be a list",
        "model_type": "be a table",
        "literal_error": "be {expected}",
        "too_short": "hold at least {min_length} value",
        "too_long": "hold at most {max_length} values",
        "string_too_short": "not be empty",
        "value_error": "{error}",  # of a schema that has words of its own
    }
    if problem["type"] not in sentences:
        return f"hold: {problem['msg']}"
    context = problem.get("ctx", {})
    short = {key: f"{x:g}" if isinstance(x, float) else x for key, x in context.items()}
    return sentences[problem["type"]].format(**short)


def _unknown_key(model: type[Section], place: Place, key_name: Callable[[Place], str]) -> str:
    """An error about an unknown key, which suggests keys.

    It suggests almost the same key of the same table or of another, or else the nearest key of the
    same table, or else all keys of a small table.
    """
    *tables, key = place
    names = tuple(part for part in tables if isinstance(part, str))
    places = [p for p in _known_keys(model) if p != names]
    siblings = [p for p in places if p[:-1] == names]
    own = _section(model, names).renamed.get(key)
    nearest = (
        [p for p in [*siblings, *places] if p[-1] == own]
        or [p for p in siblings if key and p[-1].startswith(key)]
        or _close(key, siblings, cutoff=0.9)
        or _close(key, places, cutoff=0.9)
        # Words for a key are known in all tables, as people look for its table too.
        or [p for p in places if p[-1] == _section(model, p[:-1]).renamed.get(key)]
        or _close(key, siblings, cutoff=0.6)
    )
    of_table = ", ".join(p[-1] for p in siblings) if 1 < len(siblings) <= 10 or not tables else ""
    every = f" ({of_table})" if of_table else ""
    hint = f", perhaps `{key_name(nearest[0])}`" if nearest else every
    where = f"`{key_name(tuple(tables))}`" if tables else "the file"
    return f"{where} must hold known keys only{hint}; got {describe(key)}."


def _section(model: type[Section], names: Place) -> type[Section]:
    """The schema of a table within a file."""
    for name in names:
        annotation = model.model_fields[name].annotation
        options = [annotation, *getattr(annotation, "__args__", ())]
        model = next(o for o in options if isinstance(o, type) and issubclass(o, Section))
    return model


def _close(key: str, places: list[Place], cutoff: float) -> list[Place]:
    named = {place[-1]: place for place in reversed(places)}
    return [named[n] for n in difflib.get_close_matches(key, named, n=1, cutoff=cutoff)]


def _known_keys(model: type[BaseModel], *tables: str) -> list[Place]:
    places: list[Place] = []
    for name, field in model.model_fields.items():
        places.append((*tables, name))
        options = [field.annotation, *getattr(field.annotation, "__args__", ())]
        inner = [o for o in options if isinstance(o, type) and issubclass(o, BaseModel)]
        places += _known_keys(inner[0], *tables, name) if inner else []
    return places
