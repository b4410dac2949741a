"""The table of units, and the checks that every public name shares.

| quantity | unit |
|---|---|
| position, tap edge, stroke, sag | px |
| time, exposure | s |
| speed | px/s |
| acceleration parameter `a` of `x(t) = a t^2 - (s - v) t` | px/s^2 |
| spatial frequency | cycles/px |
| photon rate | e-/s at a white pixel |
| read noise, full well | e- |
| normalised time, transmittance, efficiency | 1 |
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from types import ModuleType
from typing import Any, TypeVar

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

_Tree = TypeVar("_Tree")
_Kind = TypeVar("_Kind")
RowLike = ArrayLike | Sequence[float]
"""An array, or a plain list of numbers."""
Numbers = Array | np.ndarray
"""Arrays of NumPy where they are known, of JAX elsewhere."""
Alike = TypeVar("Alike", Array, np.ndarray)
"""Arrays of JAX of which arrays of JAX are made, and of NumPy those of NumPy."""


def all_concrete(tree: PyTree) -> bool:
    """Whether every leaf of a tree `is_concrete`."""
    return all(is_concrete(leaf) for leaf in jax.tree.leaves(tree))


def primal_values(tree: _Tree) -> _Tree:
    """Replaces `jax.grad` tracers by their primal values; `jit` tracers stay."""
    return jax.tree.map(lambda x: x if is_concrete(x) else jax.lax.stop_gradient(x), tree)


def is_concrete(value: object) -> bool:
    """Whether `value` has a number now, rather than being traced."""
    return not isinstance(value, jax.core.Tracer)


def as_numpy(*values: Any) -> tuple[Any, ...]:
    """Converts `values` to NumPy if all are concrete, so that a few numbers compile no program."""
    return tuple(map(np.asarray, values)) if all_concrete(values) else values


def namespace_of(*values: object) -> ModuleType:
    """NumPy if all of `values` are NumPy arrays, `jax.numpy` otherwise."""
    return np if all(isinstance(x, np.ndarray) for x in values) else jnp


def space_of(*values: object) -> ModuleType:
    """`jax.numpy` if any of `values` is an array of JAX, NumPy otherwise, as for plain numbers."""
    return jnp if any(isinstance(x, Array) for x in values) else np


def as_array_like(value: object, parameter: Any) -> Any:
    """Converts a concrete parameter to NumPy if `value` is a NumPy array."""
    is_numpy = isinstance(value, np.ndarray) and is_concrete(parameter)
    return np.asarray(parameter) if is_numpy else parameter


def common_dtype(*values: PyTree) -> np.dtype:
    """Floating dtype of JAX that the arrays in some trees share; its default without any.

    Python numbers adapt to the arrays beside them, and a mix of precisions widens, also under
    strict promotion. Half precision counts as single, because no integral of this package is
    accurate in it, and extended precision as double. The order of bytes, which differs in FITS
    files, does not matter.
    """
    kinds = np.ndarray | np.generic | Array
    dtypes = [np.dtype(x.dtype) for x in jax.tree.leaves(values) if isinstance(x, kinds)]
    floating = [d for d in dtypes if jnp.issubdtype(d, jnp.floating)]
    if not floating:
        return np.dtype(jnp.result_type(float))
    single = max(d.itemsize for d in floating) <= np.dtype(np.float32).itemsize
    return np.dtype(jax.dtypes.canonicalize_dtype(np.float32 if single else np.float64))


def as_float(value: RowLike, subject: str | None = None) -> Array:
    """`value` as a floating array: its own precision if it has one, JAX's default if not.

    A concrete value stays concrete, also while a function is traced. With a `subject`, the
    argument's name, anything but real numbers is refused.
    """
    if subject is not None:
        require(_is_real(value), subject, "be real numbers", value)
    dtype = common_dtype(value)
    if isinstance(value, Array) and value.dtype == dtype and not value.weak_type:
        return value
    if not all_concrete(value):
        return jnp.asarray(value, dtype=dtype)
    return device_constant(np.asarray(value, dtype))


def floating_light(value: Any, subject: str) -> Any:
    """A picture's light as a floating array: of NumPy if it is concrete, else of JAX.

    Whole numbers, which are the levels of a file, are refused.
    """
    array = np.asarray(value) if is_concrete(value) else value
    is_integer = jnp.issubdtype(array.dtype, jnp.integer)
    requirement = "hold light, white = 1, as floating-point numbers: `read_picture` reads files so"
    require(not is_integer, subject, requirement, Unquoted(array.dtype.name))
    require(_is_real(array), subject, "be real numbers", value)
    return array.astype(common_dtype(array), copy=False)


def device_constant(value: Any) -> Any:
    """Converts NumPy arrays to concrete JAX arrays, also while a function is traced.

    `jnp.asarray` would compile a program. A tree of arrays takes little longer than one array.
    """
    with jax.ensure_compile_time_eval():
        return jax.device_put(value)


def _is_real(value: object) -> bool:
    """Whether `value` is a real number, an array of them, or a list of rows of one length."""
    if isinstance(value, list | tuple):
        return all(map(_is_real, value)) and len(set(map(np.shape, value))) <= 1
    if not isinstance(value, np.ndarray | np.generic | Array) and hasattr(value, "__array__"):
        value = np.asarray(value)  # a tensor of another library has types of its own
    dtype = getattr(value, "dtype", None)
    if dtype is None:
        return isinstance(value, int | float)
    return any(jnp.issubdtype(dtype, kind) for kind in (jnp.floating, jnp.integer, jnp.bool_))


def require(holds: bool, subject: str, requirement: str, got: object) -> None:
    """Raises the one-line error of the house style unless `holds`."""
    if not holds:
        raise ValueError(f"`{subject}` must {requirement}; got {describe(got)}.")


def require_known(function: str, **arguments: object) -> None:
    """Refuses traced arguments, for functions whose computation depends on their numbers."""
    for name, value in arguments.items():
        concrete, subject = all_concrete(value), f"{function}({name}=...)"
        require(concrete, subject, "hold concrete numbers", Unquoted("ones that JAX traces"))


def require_finite(subject: str, value: RowLike) -> None:
    """Refuses a concrete value that holds a NaN, an infinity or something other than numbers."""
    if is_concrete(value):
        require(_is_real(value), subject, "be real numbers", value)
        array = np.asarray(value)
        finite, got = np.isfinite(array), value
        if not np.all(finite) and array.size > 8:  # fewer numbers are all shown
            first = tuple(np.argwhere(~finite)[0].tolist())
            got = Unquoted(f"{array[first]} at {list(first)}")
        require(bool(np.all(finite)), subject, "be finite", got)


def row_of(subject: str, value: RowLike, size: int) -> Float[Array, "{size}"]:
    """Numbers of an optimiser as a row of some size, finite where they are known."""
    row = as_float(value, subject)
    require(row.shape == (size,), subject, f"have shape {(size,)}", shape_of(row))
    require_finite(subject, row)
    return row


def require_at_least(
    subject: str,
    value: ArrayLike,
    bound: str,  # The requirement in words
    *,
    strict: bool = False,
    most: float = math.inf,
) -> None:
    """Refuses numbers below 0, 0 itself if `strict`, and numbers above the greatest."""
    require_finite(subject, value)
    if is_concrete(value):
        array = np.asarray(value)
        is_within = (array > 0 if strict else array >= 0) & (array <= most)
        require(bool(np.all(is_within)), subject, f"be {bound}", value)


def require_scalar(subject: str, value: ArrayLike) -> None:
    """Refuses anything but a scalar number."""
    if isinstance(value, str | bytes) or value is None:
        require(False, subject, "be a number", value)
    require(np.ndim(value) == 0, subject, "be a scalar", shape_of(value))


def require_number(
    subject: str,
    value: ArrayLike,
    bound: str | None = None,
    *,
    strict: bool = False,
    most: float = math.inf,
) -> None:
    """Refuses anything but a finite scalar, within the bounds of `require_at_least` if any."""
    require_scalar(subject, value)
    if bound is None:
        require_finite(subject, value)
    else:
        require_at_least(subject, value, bound, strict=strict, most=most)


def require_key(subject: str, value: object) -> None:
    """Refuses anything but None or one random key of JAX, typed or raw."""
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", np.dtype(object))
    is_typed = shape == () and jnp.issubdtype(dtype, jax.dtypes.prng_key)
    is_raw = shape is not None and len(shape) == 1 and dtype == np.uint32
    is_key = value is None or is_typed or is_raw
    got = value if shape is None else f"shape {shape} of {dtype}"
    require(is_key, subject, "be one key, as `jax.random.key(seed)` gives it", got)


def require_positive_int(subject: str, value: object) -> int:
    """A positive whole number as a Python integer; refuses anything else."""
    require(_is_whole(value, 1), subject, "be a positive integer", value)
    return int(value)  # type: ignore[arg-type]


def named(
    subject: str,
    items: object,
    kind: type[_Kind] | tuple[type[_Kind], ...],
    noun: str,
    label: str = "",
) -> dict[str, _Kind]:
    """Items of a kind by name, from a mapping, a list or a single item; at least one."""
    by_name: dict[str, Any]
    if isinstance(items, Mapping):
        by_name = {str(name): value for name, value in items.items()}
    elif isinstance(items, Sequence) and not isinstance(items, str):
        by_name = {f"{label}{index}": value for index, value in enumerate(items)}
    else:
        by_name = {f"{label}0": items}
    is_valid = bool(by_name) and all(isinstance(value, kind) for value in by_name.values())
    require(is_valid, subject, f"hold at least one {noun} and nothing else", items)
    return by_name


def require_seed(subject: str, value: object) -> None:
    """Refuses anything but a whole number of at least 0."""
    require(_is_whole(value, 0), subject, "be a whole number of at least 0", value)


def _is_whole(value: object, least: int) -> bool:
    is_integer = isinstance(value, int | np.integer) and not isinstance(value, bool)
    return is_integer and int(value) >= least  # type: ignore[call-overload]


class Unquoted(str):
    """Text that an error shows without quotes."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def shape_of(value: object) -> Unquoted:
    """The shape of a value, for an error message."""
    return Unquoted(f"shape {np.shape(value)}")  # type: ignore[arg-type]


def describe(value: object) -> str:
    """A short text of a value, for an error message."""
    is_key = isinstance(value, Array) and jnp.issubdtype(value.dtype, jax.dtypes.prng_key)
    if isinstance(value, Array) and (is_key or not is_concrete(value)):
        return f"{value.dtype} of shape {value.shape}"  # without numbers that NumPy could show
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if getattr(value, "size", 0) == 1:
        return str(np.asarray(value).item())
    try:
        text = repr(value) if not hasattr(value, "shape") else str(np.asarray(value).tolist())
    except (RecursionError, ValueError):  # nested too deeply, or an integer of 5,000 digits
        return f"{type(value).__name__} too long to show"
    text = " ".join(text.split()) if "\n" in text else text
    return text if len(text) <= 80 else text[:77] + "..."


def shown(value: object) -> str:
    """A short text of a value inside a longer text."""
    if isinstance(value, float):
        return f"{value:.6g}"
    shape = getattr(value, "shape", None)
    if shape is None or not is_concrete(value):
        return repr(value)
    array = np.asarray(value)
    if array.dtype.kind not in "fiu" or array.ndim > 1 or array.size == 0:
        return f"{array.dtype} of shape {shape}"
    if array.ndim == 0:
        return f"{array.item():.6g}"
    low, high = f"{np.min(array):.6g}", f"{np.max(array):.6g}"
    return f"{array.size} of {low}" if low == high else f"{array.size} from {low} to {high}"


def three_digits(value: float) -> str:
    """A number in words, without an exponent: 1,330."""
    return in_digits(value, 3)


def in_digits(value: float, count: int) -> str:
    """A number of so many digits in words, without an exponent."""
    return f"{float(f'{value:.{count}g}'):,.15g}"


def own_message(error: BaseException) -> str:
    """The message of an error; that of an `eqx.error_if` stands amid a stack and advice."""
    return str(error).rsplit("EquinoxRuntimeError: ", 1)[-1].split("\n\n---", 1)[0]


def fields_text(instance: Any) -> str:
    """The name of a dataclass and its fields that are not None, in one line.

    The `repr` of an Equinox module holds types in place of numbers, and that of another dataclass
    every number of an array.
    """
    values = {field.name: getattr(instance, field.name) for field in fields(instance)}
    parts = (f"{name}={shown(x)}" for name, x in values.items() if x is not None)
    return f"{type(instance).__name__}({', '.join(parts)})"
