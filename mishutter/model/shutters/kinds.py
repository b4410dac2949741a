"""The one table of shutter kinds, which files, the command line, comparisons and tests read.

A new kind of shutter is one file and one line here; one of a user's own is one call of
`register_shutter`.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, final

import numpy as np

from mishutter._core.checks import Unquoted, as_float, require
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.chips import RASKAR_CODE, ChippedShutter
from mishutter.model.shutters.spline import SplineShutter
from mishutter.model.shutters.windows import (
    GaussianShutter,
    HannShutter,
    RectShutter,
    TriangleShutter,
    TukeyShutter,
)


@final
@dataclass(frozen=True)
class ShutterKind:
    """A kind of shutter."""

    shutter: type[AbstractShutter]  # Its class, whose fields a file holds
    name: str  # Its name in a comparison and, in lower case, on the command line
    # Gives the one that the bare name stands for; None where a name is not enough
    make: Callable[[], AbstractShutter] | None = None
    parameter: str | None = None  # The field that `NAME:VALUE` sets; None for none
    is_baseline: bool = False  # Whether every comparison shows it

    @property
    def fields(self) -> dict[str, object]:
        """Arguments that make one, with their types."""
        return {field.name: field.type for field in fields(self.shutter)}


KINDS = [
    ShutterKind(RectShutter, "rect", RectShutter, is_baseline=True),
    ShutterKind(HannShutter, "Hann", HannShutter, is_baseline=True),
    ShutterKind(TriangleShutter, "triangle", TriangleShutter, is_baseline=True),
    ShutterKind(GaussianShutter, "Gaussian", GaussianShutter, "sigma", is_baseline=True),
    ShutterKind(TukeyShutter, "Tukey", TukeyShutter, "taper"),
    ShutterKind(ChippedShutter, "raskar", lambda: ChippedShutter(RASKAR_CODE)),
    ShutterKind(SplineShutter, "spline"),
]


def register_shutter(shutter: type[AbstractShutter]) -> type[AbstractShutter]:
    """Let designs with your own shutter be saved and loaded; a class decorator.

    Args:
        shutter: The class. Its fields are the arguments that make one, and are numbers,
            arrays, truth values or text.

    Returns:
        The class. It takes the place of one of the same module and name, as a cell of a
        notebook that runs again defines.

    Raises:
        ValueError: if another class of its name is known.
    """
    subject = "register_shutter(shutter=...)"
    name = shutter.__name__
    place = next((i for i, kind in enumerate(KINDS) if kind.shutter.__name__ == name), None)
    if place is None:
        KINDS.append(ShutterKind(shutter, name))
    else:
        was = KINDS[place].shutter
        same = (was.__module__, was.__qualname__) == (shutter.__module__, shutter.__qualname__)
        require(same, subject, "have a name of its own", name)
        KINDS[place] = replace(KINDS[place], shutter=shutter)
    return shutter


def baselines() -> dict[str, AbstractShutter]:
    """The fixed windows with which every design is compared, by name."""
    return {kind.name: kind.make() for kind in KINDS if kind.is_baseline and kind.make}


def named_shutter(text: str) -> AbstractShutter:
    """The window that `NAME` or `NAME:VALUE` stands for."""
    name, colon, value = text.partition(":")
    kinds = {kind.name.lower(): kind for kind in KINDS if kind.make}
    key, subject = name.strip().lower(), "--shutter"
    require(key in kinds, subject, f"be one of {', '.join(kinds)}", text)
    kind = kinds[key]
    if not colon:
        return kind.make()  # type: ignore[misc]
    require(kind.parameter is not None, subject, f"give {key} no parameter", text)
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    require(bool(np.isfinite(number)), subject, "have a finite number after the colon", text)
    return kind.shutter(**{str(kind.parameter): number})


def shutter_to_dict(shutter: AbstractShutter) -> dict[str, object]:
    """Kind and parameters of a shutter."""
    kind = next((kind for kind in KINDS if kind.shutter is type(shutter)), None)
    requirement = "be of a kind of mishutter's own or a registered one"
    name = type(shutter).__name__
    require(kind is not None, "Design.save(shutter=...)", requirement, name)
    return {"kind": name} | {field: _plain(getattr(shutter, field)) for field in kind.fields}  # type: ignore[union-attr]


def module_of(shutter: AbstractShutter) -> dict[str, str]:
    """The module to import before a design of a shutter can be read; nothing of our own kinds."""
    module = type(shutter).__module__
    return {} if module.startswith("mishutter.") else {"module": module}


def _plain(value: object) -> object:
    return np.asarray(value, np.float64).tolist() if hasattr(value, "shape") else value


def shutter_from_dict(data: dict[str, Any]) -> AbstractShutter:
    """The shutter that `shutter_to_dict` wrote."""
    kinds = {kind.shutter.__name__: kind for kind in KINDS}
    name, module = data["kind"], data.get("module")
    others = {"kind", "module"}
    arguments = {k: value for k, value in data.items() if k not in others and value is not None}
    of_module = f", or of a module that is imported, as by `--import {module}`"
    requirement = f"be one of {', '.join(kinds)}{of_module if module else ''}"
    require(name in kinds, "shutter.kind", requirement, name)
    fields = kinds[name].fields
    for key in fields:
        require(key in arguments, f"shutter.{key}", f"be given for a {name}", Unquoted("nothing"))
    for key, value in arguments.items():
        require(key in fields, f"shutter.{key}", f"be left out of a {name}", value)
    return kinds[name].shutter(**{key: _read(key, arguments[key], fields[key]) for key in fields})


def _read(key: str, value: object, kind: object) -> object:
    """A parameter of a file as its kind of field has it: arrays are numbers or lists of them."""
    words = {bool: "true or false", int: "a whole number", str: "text"}
    if kind in words:
        require(type(value) is kind, f"shutter.{key}", f"be {words[kind]}", value)
        return value
    numbers = value if isinstance(value, list) else [value]
    real = all(isinstance(x, int | float) and not isinstance(x, bool) for x in numbers)
    require(real, f"shutter.{key}", "be a number or a list of numbers", value)
    return as_float(np.asarray(value, np.float64))
