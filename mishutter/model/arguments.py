"""Files of objects whose tables hold the arguments of the objects' classes.

A class says by its constructor what its table holds, so that no name or type stands in a schema of
its own: an array is a number, a row a list of numbers, and an object a table.
"""

import inspect
import types
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, ClassVar, TypeVar, Union, get_args, get_origin

from jaxtyping import ArrayLike
from pydantic import BeforeValidator, create_model, field_validator, model_validator

from mishutter._core.checks import RowLike
from mishutter._core.validation import Section

_Class = TypeVar("_Class")


class Part(Section):
    """A table of a file, made from a file's values or from the object that it saves."""

    @field_validator("*", mode="before")
    @classmethod
    def _as_in_a_file(cls, value: Any) -> object:
        """Converts arrays and tuples to numbers and lists."""
        if hasattr(value, "tolist"):
            return value.tolist()
        return list(value) if isinstance(value, tuple) else value


def made_of(kind: type[_Class], arguments: Mapping[str, Any]) -> _Class:
    """An object of the arguments that a file gives, by names that no type checker knows."""
    return kind(**arguments)


class Arguments(Part):
    """A table of the arguments of a class; `arguments_of` makes a schema of one."""

    made: ClassVar[Callable[..., object]]

    @model_validator(mode="before")
    @classmethod
    def _without_former(cls, table: object) -> object:
        """Leaves out the arguments that a class has no longer, which it names `former`."""
        former = getattr(cls.made, "former", ())
        if not isinstance(table, dict):
            return table
        return {name: value for name, value in table.items() if name not in former}

    def built(self, **others: object) -> Any:
        """The object of these arguments."""
        return self.made(**{name: _built(value) for name, value in self} | others)


@cache
def argument_names(kind: type) -> tuple[str, ...]:
    """Names of the arguments of a class."""
    return tuple(_parameters(kind))


@cache
def arguments_of(kind: type, *omitted: str) -> type[Arguments]:
    """The schema of the arguments of a class."""
    values: dict[str, Any] = {}
    for name, parameter in _parameters(kind).items():
        if name not in omitted:
            is_missing = parameter.default is inspect.Parameter.empty
            default = ... if is_missing else parameter.default
            values[name] = (_in_file(parameter.annotation), default)
    schema = create_model(f"Saved{kind.__name__}", __base__=Arguments, **values)
    schema.made = kind
    return schema


def _parameters(kind: type) -> Mapping[str, inspect.Parameter]:
    """Arguments that say what an object is, without those by which `dataclasses.replace` keeps it.

    These a class names `handed_on`: no file holds them.
    """
    _, *parameters = inspect.signature(kind.__init__).parameters.values()
    handed_on = getattr(kind, "handed_on", ())
    return {each.name: each for each in parameters if each.name not in handed_on}


def _in_file(annotation: Any) -> Any:
    """The type of an argument as a file holds it."""
    is_union = get_origin(annotation) in (Union, types.UnionType)
    options = set(get_args(annotation)) if is_union else {annotation}
    nothing = types.NoneType if types.NoneType in options else None
    options.discard(types.NoneType)
    if options == set(get_args(RowLike)):
        kind: Any = list[float]
    elif options == set(get_args(ArrayLike)):
        kind = float
    elif Sequence[Sequence[float]] in options:  # of rows
        kind = list[list[float]]
    elif str in options:  # a path
        kind = str
    else:
        (kind,) = options
    return table_of(kind) if nothing is None else Union[table_of(kind), None]  # noqa: UP007


def table_of(kind: Any) -> Any:
    """The schema of an object, or of a list of them; any other type itself.

    An abstract class stands for its final subclasses, whose arguments tell them apart.
    """
    if get_origin(kind) is tuple:
        return list[table_of(get_args(kind)[0])]  # type: ignore[misc]
    if not isinstance(kind, type) or kind.__module__ == "builtins":
        return kind
    if not inspect.isabstract(kind):
        return arguments_of(kind)
    schemas = tuple(arguments_of(final) for final in kind.__subclasses__())
    return Annotated[Union[schemas], BeforeValidator(_as_arguments)]  # noqa: UP007


def _as_arguments(value: object) -> object:
    """An object of one of several classes as its arguments, which tell its class."""
    if isinstance(value, Mapping | Section):
        return value
    return {name: getattr(value, name) for name in argument_names(type(value))}


def _built(value: object) -> object:
    if isinstance(value, list):
        return tuple(_built(each) for each in value)
    return value.built() if isinstance(value, Arguments) else value
