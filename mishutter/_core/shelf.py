"""Folders in the user's cache whose files are each known by all that made them.

A file's name stands for a call: the function and what it was given. The folder that it lies in
stands for the rest: the package's source, the libraries and the machine.
"""

import dataclasses
import hashlib
import importlib.metadata
import inspect
import os
import platform
import shutil
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from mishutter._core.files import write_bytes

_LIBRARIES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "jaxopt", "numpy", "scipy")
_OWN = "mishutter"
_IN_PROGRAMS = ("jax_enable_x64", "jax_default_matmul_precision", "jax_threefry_partitionable")
_DAYS_UNUSED = 30
_CHECK_BYTES = 32
"""What each file begins with: the SHA-256 of the rest."""


class Shelf:
    """Such a folder; none until one is opened.

    What lies in it is run, so nobody else should be able to write there.

    Args:
        by_value: Whether arrays are told apart by their numbers, or by their kind alone.
        most_bytes: Of all its files together; large ones that were read long ago go first.
    """

    def __init__(self, *, by_value: bool, most_bytes: int) -> None:
        self.folder: Path | None = None
        self._by_value = by_value
        self._most_bytes = most_bytes

    def open(self, folder: Path) -> None:
        """Use a folder, made when the first file is.

        Files of a package or libraries that have not been used for 30 days are removed.
        """
        self.folder = folder / _surroundings()
        with suppress(OSError):
            os.utime(self.folder)

    def place_of(self, call: Any) -> Path | None:
        """The file of a call; None if there is no folder, or it cannot be told from others."""
        if self.folder is None:
            return None
        try:
            name = "\n".join(description((settings(), call), by_value=self._by_value))
        except (NotTold, TypeError):
            return None
        return self.folder / hashlib.sha256(name.encode()).hexdigest()

    def read(self, path: Path) -> bytes:
        """What was kept in a file.

        Raises:
            OSError: if it cannot be read.
            ValueError: if it is not as it was written.
        """
        found = path.read_bytes()
        check, content = found[:_CHECK_BYTES], found[_CHECK_BYTES:]
        # A program with one wrong bit may end the process.
        if check != _check(content):
            raise ValueError(f"{path} must be as it was written; got something else.")
        with suppress(OSError):
            os.utime(path, (time.time(), path.stat().st_mtime))
        return content

    def keep(self, path: Path, content: bytes) -> None:
        """Write a file, unless it alone is more than all may be.

        Raises:
            OSError: if it cannot be written.
        """
        if len(content) + _CHECK_BYTES > self._most_bytes:
            return
        if not path.parent.exists():
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            _remove_unused(path.parent)
        write_bytes(path, _check(content) + content)
        _forget_beyond(self._most_bytes, path.parent)


class NotTold(Exception):
    """Something that cannot be told from another thing in any other process."""


def settings() -> tuple[str, ...]:
    """What JAX was told that shows in a program."""
    return tuple(f"{name}={setting(name)}" for name in _IN_PROGRAMS)


def setting(name: str) -> Any:
    """One thing that JAX was told."""
    return getattr(jax.config, name)


def is_weak(x: Any) -> bool:
    """Whether an array's type gives way to another's."""
    return getattr(x, "weak_type", False)


def description(value: Any, *, by_value: bool = False) -> Iterator[str]:
    """Lines that tell a value from every other: of arrays their kind, and `by_value` numbers.

    Raises:
        NotTold: if the value is of a kind whose source the folder does not stand for.
    """
    kind = type(value)
    if eqx.is_array(value):
        yield from _of_array(value, by_value)
    elif value is None or kind in (bool, int, float, complex, str, bytes):
        yield f"{kind.__name__} {value!r}"
    elif isinstance(value, Enum | np.dtype):
        yield f"{_place(kind)} {value!s}"
    elif isinstance(value, type) or (callable(value) and hasattr(value, "__qualname__")):
        yield _place(inspect.unwrap(value))
    elif isinstance(value, tuple | list | frozenset | Mapping):
        yield f"{_place(kind)} of {len(value)}"
        items = value.items() if isinstance(value, Mapping) else value
        for item in sorted(items, key=repr) if isinstance(value, frozenset) else items:
            yield from description(item, by_value=by_value)
    elif dataclasses.is_dataclass(value):
        yield _place(kind)
        for field in dataclasses.fields(value):
            if field.compare or by_value:
                content = getattr(value, field.name, None)
                fixed = field.metadata.get("static", False)
                yield field.name
                yield from description(content, by_value=by_value or fixed)
    else:
        raise NotTold(kind)


def _of_array(array: Any, by_value: bool) -> Iterator[str]:
    yield f"{array.dtype}{array.shape}{' weak' if is_weak(array) else ''}"
    if by_value:
        yield hashlib.sha256(np.asarray(array).tobytes()).hexdigest()


def _place(thing: Any) -> str:
    """Where a type or function is defined, if its source is one that the folder stands for."""
    known = (thing.__module__ or "").partition(".")[0] in (_OWN, "builtins", *_LIBRARIES)
    holds_more = getattr(thing, "__closure__", None) or hasattr(thing, "__self__")
    if not known or "<" in thing.__qualname__ or holds_more:
        raise NotTold(thing)
    return f"{thing.__module__}.{thing.__qualname__}"


@lru_cache
def _surroundings() -> str:
    """A name for all outside its arguments that a program depends on."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    facts = [sys.version, platform.machine(), _processor(), str(os.cpu_count())]
    facts += [importlib.metadata.version(name) for name in _LIBRARIES]
    facts += [f"{k}={v}" for k, v in sorted(os.environ.items()) if k.startswith(("JAX_", "XLA_"))]
    facts += [device.client.platform_version + device.device_kind for device in jax.devices()]
    digest.update("\n".join(facts).encode())
    return digest.hexdigest()[:32]


def _processor() -> str:
    """What the processor can do, in its own words where the system repeats them."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")


def _check(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()


def _forget_beyond(most: int, folder: Path) -> None:
    """Remove each file that there is no room for, of so many bytes, beside those read since."""
    files = {path: path.stat() for path in folder.iterdir() if path.is_file()}
    room = most
    for path in sorted(files, key=lambda path: files[path].st_atime, reverse=True):
        if files[path].st_size > room:
            path.unlink(missing_ok=True)
        else:
            room -= files[path].st_size


def _remove_unused(current: Path) -> None:
    oldest = time.time() - _DAYS_UNUSED * 24 * 3600
    for other in current.parent.iterdir():
        if other != current and other.is_dir() and other.stat().st_mtime < oldest:
            shutil.rmtree(other, ignore_errors=True)
