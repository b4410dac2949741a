"""Pages that are generated from the package: scene keys, commands, functions and classes."""

import ast
import re
import types
import typing
from collections.abc import Iterator
from pathlib import Path

import annotated_types
import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from docs.builder.pages import ROOT
from mishutter.cli.app import app
from mishutter.model.scene_file import example_scene_text
from mishutter.model.scene_schema import SceneFile

UNITS = {
    "_px_per_s3": "px/s³",
    "_px_per_s2": "px/s²",
    "_px_per_s": "px/s",
    "_um_per_s": "µm/s",
    "_mm_per_s": "mm/s",
    "_m_per_s": "m/s",
    "_km_per_h": "km/h",
    "_deg_per_s": "°/s",
    "px_per_mm": "px/mm",
    "_g_per_s": "g/s",
    "_per_s": "1/s",
    "_cycles_per_px": "cycles/px",
    "_px": "px",
    "_ms": "ms",
    "_us": "µs",
    "_s": "s",
    "_mm": "mm",
    "_m": "m",
    "_um": "µm",
    "_g": "g",
    "_hz": "Hz",
    "_e": "e-",
    "_db": "dB",
    "_lux": "lx",
}
"""What the end of a key says of its unit."""
_FOLDERS = {
    "pictures": "Pictures and their files",
    "model": "Scenes, shutters and motions",
    "blur": "Kernels and transfer functions",
    "evaluation": "Metrics, losses and ceilings",
    "search": "Search",
    "plane": "Any direction",
    "camera": "Captures",
    "decoding": "Restoration",
    "design": "Designs and their files",
    "hardware": "Drive tables, traces and cameras as built",
    "measurement": "Scenes from clips",
    "sweeps": "Maps",
    "report": "Comparison and pictures",
    "_core": "Compiled programs",
}
_PICTURES = ("plot_", "save_figure")
_OF_TORCH = ("Blur", "blurred", "differentiable", "physics")
"""What `mishutter.torch` is imported for."""


def write_reference(folder: Path) -> None:
    """Write every generated page of the reference into a folder of the site's pages."""
    place = folder / "reference"
    place.mkdir(parents=True, exist_ok=True)
    (place / "scene.md").write_text(scene_page())
    (place / "commands.md").write_text(commands_page())
    names = public_names()
    for module, title in _FOLDERS.items():
        text = "".join(f"::: {path}\n\n" for path in names[module].values())
        (place / f"{module}.md").write_text(f"# {title}\n\n{text}")
    text = "".join(f"::: mishutter.torch.{name}\n\n" for name in _OF_TORCH)
    (place / "torch.md").write_text(f"# PyTorch and deepinv\n\n{text}")
    head = (
        "# Functions and classes\n\nEverything is imported from `mishutter`, and the pictures "
        "from `mishutter.report`. Functions take and return JAX arrays, work under `jax.jit`, "
        "`jax.vmap` and `jax.grad`, and follow the precision of their inputs.\n\n"
    )
    (place / "index.md").write_text(head + "\n".join(_index(names)))


def _index(names: dict[str, dict[str, str]]) -> Iterator[str]:
    """A line for each name, by what it is for, as `help(mishutter)` has them, then the pictures."""
    links = {
        name: f"[`{name}`]({module}.md#{path})"
        for module, paths in names.items()
        for name, path in paths.items()
    }
    for title, lines in grouped_names().items():
        yield f"## {title}\n"
        yield from (f"- {links[name]}: {words}" for name, words in lines.items())
        yield ""
    drawn = (links[name] for name in names["report"] if name.startswith(_PICTURES))
    yield f"## Pictures of results\n\n{', '.join(drawn)}\n"
    of_torch = (f"[`{name}`](torch.md#mishutter.torch.{name})" for name in _OF_TORCH)
    yield f"## `mishutter.torch`\n\n{', '.join(of_torch)}\n"


def grouped_names() -> dict[str, dict[str, str]]:
    """What each public name is, in words, by its group in the docstring of the package."""
    tree = ast.parse((ROOT / "mishutter" / "__init__.py").read_text("utf-8"))
    paragraphs = (ast.get_docstring(tree) or "").split("\n\n")
    groups = {}
    for title, *lines in map(str.splitlines, paragraphs):
        if lines and all(line.startswith("    ") for line in lines):
            pairs = (re.split(r"\s{2,}", line.strip(), maxsplit=1) for line in lines)
            groups[title] = {pair[0]: pair[-1] for pair in pairs}
    return {title: each for title, each in groups.items() if not title.startswith("Folders")}


def public_names() -> dict[str, dict[str, str]]:
    """Names that a user may import, each with its dotted path, by the folder they are from."""
    names: dict[str, dict[str, str]] = {module: {} for module in _FOLDERS}
    for module, name in _exported(ROOT / "mishutter" / "__init__.pyi"):
        names[module.split(".")[0]][name] = f"mishutter.{name}"
    for _, name in _exported(ROOT / "mishutter" / "report" / "__init__.py"):
        if name.startswith(_PICTURES):
            names["report"][name] = f"mishutter.report.{name}"
    return names


def _exported(path: Path) -> Iterator[tuple[str, str]]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module, node.names[0].name


def scene_page() -> str:
    """Every key of a scene file: unit, default and range, and each section of the example."""
    parts = [
        "# Keys of a scene file\n\nA scene file is TOML. Each key ends in its unit; a key that is "
        "not listed here is refused, with the nearest right one named. Files are read by "
        "`Scene.load(path)` and by every command. This page is made from the schema that they are "
        "checked by; the examples are from the built-in scene, which `mishutter example > "
        "mine.toml` writes whole.\n"
    ]
    for key, field in SceneFile.model_fields.items():
        section = section_of(field)
        needed = "must be given" if field.is_required() else "may be left out"
        text = f"{_summary(section)} This section {needed}."
        parts.append(f"## `[{key}]`\n\n{text}\n\n{_table(section)}\n{_example_of(key)}")
    return "\n".join(parts)


def _example_of(key: str) -> str:
    """The section as the built-in scene has it, with its comments."""
    header = re.compile(rf"^(# )?\[{key}\]$", re.MULTILINE)
    paragraphs = example_scene_text().split("\n\n")
    found = [text.rstrip() for text in paragraphs if header.search(text)]
    return f"In the built-in scene:\n\n```toml\n{found[0]}\n```\n" if found else ""


def _table(section: type[BaseModel]) -> str:
    rows = ["| key | unit | default | allowed |", "|---|---|---|---|"]
    inner = []
    for key, field in section.model_fields.items():
        nested = section_of(field)
        if nested is None:
            cells = (f"`{key}`", unit(key), _default(field), allowed(field))
        else:
            cells = (f"`{key}`", "", _default(field), "the keys below")
            inner.append(f"\n`{key} = {{ ... }}`: {_summary(nested)}\n\n{_table(nested)}")
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join([*rows, *inner, ""])


def _summary(section: type[BaseModel] | None) -> str:
    return " ".join((getattr(section, "__doc__", None) or "").split())


def section_of(field: FieldInfo) -> type[BaseModel] | None:
    """The section that a field holds, or each of its items, or may hold."""
    kinds = [field.annotation]
    while kinds:
        kind = kinds.pop()
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
        kinds += typing.get_args(kind)
    return None


def unit(key: str) -> str:
    """The unit that the end of a key names; nothing for a plain number or other things."""
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), "")


def _default(field: FieldInfo) -> str:
    if field.is_required() or field.default is PydanticUndefined:
        return "must be given"
    if field.default is None:
        return "none"
    return "" if isinstance(field.default, BaseModel) else f"`{_number(field.default)}`"


def allowed(field: FieldInfo) -> str:
    """The kind of value that a field takes, and its range."""
    kind, metadata = _unwrapped(field.annotation, list(field.metadata))
    limits = {type(m): m for m in metadata}
    low = _limit(limits, annotated_types.Ge, "ge", "≥ ") or _limit(
        limits, annotated_types.Gt, "gt", "> "
    )
    high = _limit(limits, annotated_types.Le, "le", "≤ ") or _limit(
        limits, annotated_types.Lt, "lt", "< "
    )
    text = ", ".join(part for part in (kind, low, high) if part)
    least, most = limits.get(annotated_types.MinLen), limits.get(annotated_types.MaxLen)
    if kind.startswith("list") and least and most:
        text += f", {least.min_length} to {most.max_length:,} of them"
    return text


def _limit(limits: dict[type, typing.Any], kind: type, name: str, sign: str) -> str:
    return f"{sign}{_number(getattr(limits[kind], name))}" if kind in limits else ""


def _number(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.0e}".replace("e+0", "e") if abs(value) >= 1e5 else f"{value:g}"
    return str(value)


def _unwrapped(kind: typing.Any, metadata: list[typing.Any]) -> tuple[str, list[typing.Any]]:
    """The word for a type, and all metadata on the way to it."""
    metadata = [m for item in metadata for m in getattr(item, "metadata", [item])]
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        kind = next(arg for arg in typing.get_args(kind) if arg is not type(None))
        return _unwrapped(kind, metadata)
    if typing.get_origin(kind) is typing.Annotated:
        inner, *more = typing.get_args(kind)
        return _unwrapped(inner, metadata + more)
    if typing.get_origin(kind) is list:
        word, more = _unwrapped(typing.get_args(kind)[0], [])
        return f"list of: {word}", metadata + more
    if typing.get_origin(kind) is typing.Literal:
        return " or ".join(f"`{value}`" for value in typing.get_args(kind)), metadata
    words = {float: "number", int: "whole number", str: "text", bool: "`true` or `false`"}
    return words.get(kind, str(kind)), metadata


def commands_page() -> str:
    """What `--help` says of every command."""
    group = typer.main.get_command(app)
    names = getattr(group, "commands", {})
    head = (
        "# Commands\n\nEvery command runs on the built-in scene where no file is given. Results go "
        "to standard output and all else to standard error; `--json` prints one strict JSON "
        "document. Files appear whole or not at all.\n\n"
        "| exit code | meaning |\n|---|---|\n| 0 | done, or the reader of a pipe left, as `head` "
        "does |\n| 2 | bad input: one line "
        "`mishutter: error: <what must hold>; got <what came>` |\n| 130 | interrupted |\n"
        "| 143 | terminated |\n"
    )
    context = typer.Context(group, info_name="mishutter", **group.context_settings)
    parts = [head]
    for name, command in names.items():
        inner = typer.Context(command, info_name=name, parent=context)
        text = re.sub(r"\x1b\[[\d;]*m", "", command.get_help(inner)).strip()
        parts.append(f"## `mishutter {name}`\n\n```text\n{text}\n```\n")
    return "\n".join(parts)
