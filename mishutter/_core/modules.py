"""Modules that print their numbers and answer an unknown argument with the nearest one."""

import difflib
import inspect
from collections.abc import Collection, Sequence
from functools import cache
from typing import TypeVar

import equinox as eqx

from mishutter._core.checks import fields_text

_Kind = TypeVar("_Kind", bound=eqx.Module)


class AbstractModule(eqx.Module):
    """A module that refuses an unknown argument in a line which names the class and the nearest."""

    def __new__(cls: type[_Kind], *_: object, **named: object) -> _Kind:
        known = _arguments(cls)
        if known is not None:
            require_arguments(cls.__name__, named, known)
        return eqx.Module.__new__(cls)

    def __repr__(self) -> str:
        return fields_text(self)


def require_arguments(function: str, named: Collection[str], known: Sequence[str]) -> None:
    """Refuses names that are no arguments of a function, as Python does, with the nearest one."""
    unknown = next((name for name in named if name not in known), None)
    if unknown is not None:
        near = difflib.get_close_matches(unknown, known, n=1)
        hint = f"did you mean `{near[0]}`?" if near else f"it takes {', '.join(known) or 'none'}."
        raise TypeError(f"`{function}` has no argument `{unknown}`; {hint}")


@cache
def _arguments(kind: type) -> tuple[str, ...] | None:
    """Names of the arguments of a class; None where its constructor takes any."""
    _, *parameters = inspect.signature(kind.__init__).parameters.values()
    takes_any = any(each.kind is each.VAR_KEYWORD for each in parameters)
    return None if takes_any else tuple(each.name for each in parameters)
