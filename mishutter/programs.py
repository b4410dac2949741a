"""Compiled programs kept on disk, so that another run loads them without tracing anything.

JAX's own cache spares the compiler but is asked after tracing and lowering, which for these
programs take longer than running them. Here a program is known by the function, the shapes
and dtypes of its arrays and all that is static in its arguments, within a folder that stands
for the package's source, the libraries and the machine.
"""

import dataclasses
import hashlib
import importlib.metadata
import os
import pickle
import platform
import shutil
import sys
import threading
import time
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache
from jax.experimental.serialize_executable import deserialize_and_load, serialize

from mishutter.files import write_bytes

Options = dict[str, bool | int] | None
_LIBRARIES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
_OWN = "mishutter"
_IN_PROGRAMS = ("jax_enable_x64", "jax_default_matmul_precision", "jax_threefry_partitionable")
_DAYS_UNUSED = 30
TRACING = threading.RLock()
"""Held while a program is traced: threads share what JAX knows of the functions in it, among
that a derivative rule which two of them may not trace at once (`StoreException`)."""


class _NotKept(Exception):
    """A program that can only live in this process."""


class _Shelf:
    """The folder that programs are kept in; None where none are."""

    folder: Path | None = None


def keep_programs(folder: Path) -> None:
    """Keep compiled programs in a folder, made when the first is.

    Programs of a package or libraries that have not been used for 30 days are removed. What
    lies in the folder is run, so nobody else should be able to write there.
    """
    _Shelf.folder = folder / _surroundings()
    with suppress(OSError):
        os.utime(_Shelf.folder)


def may_be_kept(leaves: Iterable[Any]) -> bool:
    """Whether programs are kept, and one of these arguments runs where those do."""
    if _Shelf.folder is None or _setting("jax_disable_jit") or _setting("jax_default_device"):
        return False
    here = {jax.devices()[0]}
    return all(leaf.devices() == here for leaf in leaves if isinstance(leaf, jax.Array))


class _Loaded(NamedTuple):
    """A compiled program of flat arrays, and the tree that its results are leaves of."""

    run: Callable[..., list[jax.Array]]
    result: Any

    def __call__(self, arrays: list[Any]) -> Any:
        found = iter(self.run(*arrays))
        leaves, tree = jax.tree.flatten(self.result)
        return tree.unflatten(next(found) if _is_shape(x) else x for x in leaves)


def kind_of(leaves: list[Any], tree: Any) -> Hashable:
    """All that tells one program of a function from another, in its arguments and in JAX."""
    arrays = (x for x in leaves if eqx.is_array(x))
    kinds = tuple((x.shape, x.dtype, _is_weak(x)) for x in arrays)
    statics = tuple((type(x), x) for x in leaves if not eqx.is_array(x))
    return tree, statics, kinds, _settings()


class KeptProgram:
    """`function` compiled for each kind of arguments, or loaded if it ever was on this machine.

    Arrays are traced and everything else is static, as by `eqx.filter_jit`; all of it must
    be concrete.
    """

    def __init__(self, function: Callable[..., Any], options: Options = None):
        self._function = function
        self._options = options
        self._loaded: dict[Any, _Loaded] = {}

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """The function of its arguments."""
        leaves, tree = jax.tree.flatten((args, kwargs))
        arrays = [leaf for leaf in leaves if eqx.is_array(leaf)]
        kind = kind_of(leaves, tree), _Shelf.folder
        if kind not in self._loaded:
            self._loaded[kind] = self._found(args, kwargs, arrays)
        return self._loaded[kind](arrays)

    def _found(self, args: Any, kwargs: Any, arrays: list[Any]) -> _Loaded:
        path = _place_of((self._function, self._options, args, kwargs))
        if path is None:
            return self._compiled(args, kwargs, arrays, None)
        try:
            return _read(path, len(arrays))
        except Exception:  # whatever is wrong with a file, compiling mends it
            return self._compiled(args, kwargs, arrays, path)

    def _compiled(self, args: Any, kwargs: Any, arrays: list[Any], path: Path | None) -> _Loaded:
        shapes: list[Any] = []

        def flat(*traced: Any) -> list[Any]:
            values = iter(traced)
            leaves, tree = jax.tree.flatten((args, kwargs))
            leaves = [next(values) if eqx.is_array(x) else x for x in leaves]
            given, named = tree.unflatten(leaves)
            result = self._function(*given, **named)
            shapes[:] = [jax.tree.map(_shape, result)]
            return [x for x in jax.tree.leaves(result) if eqx.is_array(x)]

        flat.__name__ = getattr(self._function, "__name__", "program")
        with TRACING:
            lowered = jax.jit(flat, compiler_options=self._options).lower(*arrays)
        if path is None or "callback" in lowered.as_text():
            return _Loaded(lowered.compile(), shapes[0])
        with _PAST_THE_CACHE:
            compiled = lowered.compile()
        _write(path, compiled, shapes[0])
        return _Loaded(compiled, shapes[0])


class _PastTheCache:
    """JAX's cache is off while any thread is inside: what comes from it cannot be written again."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._num_inside = 0
        self._folder: str | None = None

    def __enter__(self) -> None:
        with self._lock:
            if self._num_inside == 0:
                self._folder = _setting("jax_compilation_cache_dir")
                self._use(None)
            self._num_inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._num_inside -= 1
            if self._num_inside == 0:
                self._use(self._folder)

    def _use(self, folder: str | None) -> None:
        jax.config.update("jax_compilation_cache_dir", folder)
        compilation_cache.reset_cache()


_PAST_THE_CACHE = _PastTheCache()


def _write(path: Path, compiled: jax.stages.Compiled, result: Any) -> None:
    """A program and the tree of its results on disk; nothing where either cannot be."""
    try:
        list(_description(jax.tree.map(lambda x: None if _is_shape(x) else x, result)))
        content = pickle.dumps((serialize(compiled)[0], result))
        if not path.parent.exists():
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            _remove_unused(path.parent)
        write_bytes(path, content)
    except Exception:
        return


def _read(path: Path, num_arrays: int) -> _Loaded:
    program, result = pickle.loads(path.read_bytes())
    arguments = jax.tree.structure(((0,) * num_arrays, {}))
    num_results = sum(_is_shape(x) for x in jax.tree.leaves(result))
    results = jax.tree.structure([0] * num_results)
    here = jax.devices()[:1]
    return _Loaded(
        deserialize_and_load(program, arguments, results, execution_devices=here), result
    )


def _remove_unused(current: Path) -> None:
    oldest = time.time() - _DAYS_UNUSED * 24 * 3600
    for other in current.parent.iterdir():
        if other != current and other.is_dir() and other.stat().st_mtime < oldest:
            shutil.rmtree(other, ignore_errors=True)


def _setting(name: str) -> Any:
    return getattr(jax.config, name)


def _settings() -> tuple[str, ...]:
    """What JAX was told that shows in a program."""
    return tuple(f"{name}={_setting(name)}" for name in _IN_PROGRAMS)


def _shape(x: Any) -> Any:
    return jax.ShapeDtypeStruct(x.shape, x.dtype) if eqx.is_array(x) else x


def _is_weak(x: Any) -> bool:
    return getattr(x, "weak_type", False)


def _is_shape(x: Any) -> bool:
    return isinstance(x, jax.ShapeDtypeStruct)


def _place_of(call: Any) -> Path | None:
    """The file that holds the program of a call; None if it cannot be told from others."""
    try:
        name = "\n".join(_description((_settings(), call)))
    except (_NotKept, TypeError):
        return None
    folder = _Shelf.folder
    return None if folder is None else folder / hashlib.sha256(name.encode()).hexdigest()


def _description(value: Any) -> Iterator[str]:
    """Lines that say all that a program can depend on in a value: of arrays, their kind."""
    kind = type(value)
    if eqx.is_array(value):
        yield f"{value.dtype}{value.shape}{' weak' if _is_weak(value) else ''}"
    elif value is None or kind in (bool, int, float, complex, str, bytes):
        yield f"{kind.__name__} {value!r}"
    elif isinstance(value, Enum | np.dtype):
        yield f"{_place(kind)} {value!s}"
    elif isinstance(value, type) or (callable(value) and hasattr(value, "__qualname__")):
        yield _place(value)
    elif isinstance(value, tuple | list | frozenset | Mapping):
        yield f"{_place(kind)} of {len(value)}"
        items = sorted(value.items()) if isinstance(value, Mapping) else value
        for item in sorted(items, key=repr) if isinstance(value, frozenset) else items:
            yield from _description(item)
    elif dataclasses.is_dataclass(value):
        yield _place(kind)
        for field in dataclasses.fields(value):
            content: Any = getattr(value, field.name, None)
            if field.compare:
                yield field.name
                fixed = field.metadata.get("static", False) and eqx.is_array(content)
                yield from [repr(content.tobytes())] if fixed else _description(content)
    else:
        raise _NotKept(kind)


def _place(thing: Any) -> str:
    """Where a type or function is defined, if its source is one that the folder stands for."""
    known = thing.__module__.partition(".")[0] in (_OWN, "builtins", *_LIBRARIES)
    if not known or "<" in thing.__qualname__ or getattr(thing, "__closure__", None):
        raise _NotKept(thing)
    return f"{thing.__module__}.{thing.__qualname__}"


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
