"""Annotations of the package are checked at run time, at the first calls of each test.

jaxtyping's import hook decorates every function, and an inner loop over NumPy would take ten times
as long: a check costs some 30 us, and a function within a function is decorated anew, by compiling
source, at each call of the outer one. Here it is the outer functions and the classes that are
checked, each at its first `MOST_CALLS` calls of a quick test; a traced function runs but once a
trace.
"""

import dataclasses
import functools

import jaxtyping

MOST_CALLS = 5
"""A loop passes what it passed before: a wrong type or shape shows in its first rounds."""
_calls: dict = {}
"""Calls of each function that were checked since the test began."""
_most = MOST_CALLS
"""Those of a function that are checked in this test."""

_jaxtyped = jaxtyping.jaxtyped


def _jaxtyped_at_first(function=None, *, typechecker):
    """Stands for `jaxtyping.jaxtyped`, which the import hook writes above functions and classes."""
    if function is None:
        return functools.partial(_jaxtyped_at_first, typechecker=typechecker)
    if isinstance(function, type):
        if dataclasses.is_dataclass(function) and "__init__" in vars(function):
            function.__init__ = _jaxtyped_at_first(function.__init__, typechecker=typechecker)
        return function
    if "<locals>" in function.__qualname__:
        return function

    # A process decorates only what it calls, once all modules are there to read annotations by.
    @functools.cache
    def checked():
        return _jaxtyped(function, typechecker=typechecker)

    @functools.wraps(function)
    def wrapper(*args, **kwargs):
        count = _calls.get(function, 0)
        if count >= _most:
            return function(*args, **kwargs)
        _calls[function] = count + 1
        return checked()(*args, **kwargs)

    return wrapper


def begin(*, is_checked):
    """Begins a test, in which types are checked or are not."""
    global _most
    _calls.clear()
    _most = MOST_CALLS if is_checked else 0


def check_types_of(package):
    """Checks what is imported of a package from now on."""
    jaxtyping.jaxtyped = _jaxtyped_at_first
    jaxtyping.install_import_hook(package, "beartype.beartype")
