"""Compiled programs kept on disk, so that another run loads them without tracing anything.

JAX's own cache spares the compiler but is asked after tracing and lowering, which for these
programs take longer than running them. Here a program is known by the function, the shapes
and dtypes of its arrays and all that is static in its arguments, within a folder that stands
for the package's source, the libraries and the machine.
"""

import pickle
import threading
from collections.abc import Callable, Hashable, Iterable
from pathlib import Path
from typing import Any, NamedTuple
from uuid import uuid4

import equinox as eqx
import jax
from jax.experimental.compilation_cache import compilation_cache
from jax.experimental.serialize_executable import deserialize_and_load, serialize

from mishutter._core.shelf import Shelf, description, is_weak, setting, settings

Options = dict[str, bool | int] | None
SHELF = Shelf(by_value=False, most_bytes=1 << 30)
TRACING = threading.RLock()
"""Held while a program is traced: threads share what JAX knows of the functions in it, among
that a derivative rule which two of them may not trace at once (`StoreException`)."""


def may_be_kept(leaves: Iterable[Any]) -> bool:
    """Whether programs are kept, and one of these arguments runs where those do."""
    if SHELF.folder is None or setting("jax_disable_jit") or setting("jax_default_device"):
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
    kinds = tuple((x.shape, x.dtype, is_weak(x)) for x in arrays)
    statics = tuple((type(x), x) for x in leaves if not eqx.is_array(x))
    return tree, statics, kinds, settings()


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
        kind = kind_of(leaves, tree), SHELF.folder
        if kind not in self._loaded:
            self._loaded[kind] = self._found(args, kwargs, arrays)
        return self._loaded[kind](arrays)

    def _found(self, args: Any, kwargs: Any, arrays: list[Any]) -> _Loaded:
        path = SHELF.place_of((self._function, self._options, args, kwargs))
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

        # No two share a name: what JAX's cache holds is never taken for it, though another thread
        # has JAX begin to use its cache again while this one is past it.
        name = getattr(self._function, "__name__", "program")
        flat.__name__ = name if path is None else f"{name}_{uuid4().hex}"
        with TRACING:
            lowered = jax.jit(flat, compiler_options=self._options).lower(*arrays)
        if path is None or "callback" in lowered.as_text():
            return _Loaded(lowered.compile(), shapes[0])
        with _PAST_THE_CACHE:
            compiled = lowered.compile()
        _write(path, compiled, shapes[0])
        return _Loaded(compiled, shapes[0])


class _PastTheCache:
    """JAX's cache is off while any thread is inside: it would hold every kept program again."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._num_inside = 0
        self._folder: str | None = None

    def __enter__(self) -> None:
        with self._lock:
            if self._num_inside == 0:
                self._folder = setting("jax_compilation_cache_dir")
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
        list(description(jax.tree.map(lambda x: None if _is_shape(x) else x, result)))
        SHELF.keep(path, pickle.dumps((serialize(compiled)[0], result)))
    except Exception:
        return


def _read(path: Path, num_arrays: int) -> _Loaded:
    program, result = pickle.loads(SHELF.read(path))
    arguments = jax.tree.structure(((0,) * num_arrays, {}))
    num_results = sum(_is_shape(x) for x in jax.tree.leaves(result))
    results = jax.tree.structure([0] * num_results)
    here = jax.devices()[:1]
    return _Loaded(
        deserialize_and_load(program, arguments, results, execution_devices=here), result
    )


def _shape(x: Any) -> Any:
    return jax.ShapeDtypeStruct(x.shape, x.dtype) if eqx.is_array(x) else x


def _is_shape(x: Any) -> bool:
    return isinstance(x, jax.ShapeDtypeStruct)
