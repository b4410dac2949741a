"""The interface of a shutter, the one that the integrals take, and how any shutter gets there.

A shutter of one's own is interpolated by polynomials, in Bernstein form, as splines are too.
"""

import itertools
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import lru_cache
from math import comb
from typing import Any, ClassVar, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Inexact, Int, Num

from mishutter._core.checks import (
    Numbers,
    Unquoted,
    all_concrete,
    as_float,
    common_dtype,
    device_constant,
    namespace_of,
    require,
    require_finite,
    shape_of,
)
from mishutter._core.compiling import outside_trace
from mishutter._core.modules import AbstractModule

Length = TypeVar("Length", Array, np.ndarray)
Offsets = Inexact[Array | np.ndarray, "pieces *offsets"]
Values = Num[Array | np.ndarray, "pieces *offsets"]
"""Values of the pieces' functions at offsets in each of them."""
Pieces = Int[Array, "*cells"]
Sides = Bool[Array, "*cells"]
Cells = Float[Array, "*cells"]
"""Intervals within pieces: the piece of each, its side, and lengths or means."""

_NUM_PIECES, _DEGREE = 64, 5
_UNIFORM = np.linspace(-1, 1, _NUM_PIECES + 1)

_MOST_CORNERS = 16
"""Most corners of the ranges of a shutter's parameters at which it is looked at."""
_PROBES = np.linspace(0, 1, 25)
"""Shares of a piece at which an interpolant is held against its shutter."""
_SHORT = 1e-7
"""Length of a piece that holds too little light for its misfit to matter."""


class AbstractShutter(AbstractModule):
    r"""A transmittance $w(\tau)$ in $[0, 1]$ on $\tau = t/T \in [-1, 1]$, 0 outside.

    Your own shutter needs `transmittance`, `discontinuities` if it jumps or bends
    anywhere, and `bounds` if a search may move its parameters, which are its fields. It is
    integrated by interpolation between its discontinuities (see `SampledShutter`). One whose
    means over an interval are known in closed form derives from `AbstractPiecewiseShutter`
    instead.
    """

    @abstractmethod
    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        r"""$w(\tau)$ at normalised times of any shape; same shape, in $[0, 1]$.

        Args:
            tau: Normalised times, from -1 to 1.
        """

    def discontinuities(self) -> Sequence[ArrayLike]:
        r"""Times $\tau$ at which $w$ jumps or bends, in any order; none by default.

        They may depend on parameters, and derivatives follow them.
        """
        return ()

    def bounds(self) -> Mapping[str, tuple[float, float]]:
        """Least and greatest value of each parameter that a search may move, by its name.

        A parameter is a field that holds a number or an array. None may move by default.
        """
        return {}

    def efficiency(self) -> Float[Array, ""]:
        r"""Light let through, $\eta = \frac12 \int_{-1}^1 w(\tau)\,d\tau$; scalar."""
        return integrated_transmittance(piecewise(self)) / 2


FEW_PIECES = 16
"""Unequal pieces that are looked at one by one; see `AbstractPiecewiseShutter.equal_pieces`."""


class AbstractPiecewiseShutter(AbstractShutter):
    """A shutter that is one analytic function between each two of its breakpoints.

    Offsets are distances from a piece's left end. Arrays carry the pieces, `n` of
    them, on their leading axis.
    """

    panels_per_piece: eqx.AbstractVar[int]
    """Equal parts of a piece on each of which `w` is all but a low polynomial."""

    equal_pieces: eqx.AbstractVar[bool]
    """Whether the pieces are equally long. One of a few that are not may be all of the exposure;
    of more than `FEW_PIECES` none is longer than twice their mean."""

    symmetric: eqx.AbstractVar[bool]
    r"""Whether $w(-\tau) = w(\tau)$, whatever the parameters."""

    evaluates_by_numpy: ClassVar[bool] = False
    """Whether `breakpoints` of known parameters compiles nothing, and `piece_transmittance` takes
    and gives NumPy's arrays where its offsets are such. The default is False."""

    def dtype(self) -> np.dtype | None:
        """Precision of the parameters; None for a shutter without any."""
        arrays = [x for x in jax.tree.leaves(self) if hasattr(x, "dtype")]
        return np.dtype(arrays[0].dtype) if arrays else None

    @abstractmethod
    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        """Ends of the pieces, ascending from -1 to 1; shape `(n + 1,)`.

        Args:
            dtype: Precision of the numbers.
        """

    @abstractmethod
    def piece_transmittance(self, offset: Offsets) -> Values:
        """Each piece's function at offsets, an array, complex ones included; shape `(n, ...)`.

        Args:
            offset: Distance from the left end of each piece; shape `(n,)`.
        """

    @abstractmethod
    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        """Mean of some pieces' functions over an interval.

        Args:
            piece: Which piece, from 0; integers of any shape.
            from_left: Which end of the piece the interval is counted from, the left one or
                the right one: one that is not much farther than the other, so that a profile
                that vanishes there keeps its relative accuracy; same shape.
            distance: Distance of the interval's centre from that end; same shape.
            width: Length of the interval; same shape.
        """


class AbstractAdjustableShutter(AbstractPiecewiseShutter):
    """A shutter whose profile a solver may move, by coordinates in a unit box."""

    linear: eqx.AbstractClassVar[bool]
    """Whether the transmittance is linear in the box coordinates."""

    @abstractmethod
    def box(self) -> Float[Array, "p"]:
        """Coordinates in `[0, 1]` of this profile; shape `(p,)`."""

    @abstractmethod
    def at(self, box: Float[Array, "p"]) -> "AbstractAdjustableShutter":
        """The shutter of the same kind at other coordinates in the unit box."""


def is_adjustable(shutter: AbstractShutter) -> bool:
    """Whether a shutter has parameters that a search may move."""
    return isinstance(shutter, AbstractAdjustableShutter) or bool(shutter.bounds())


def coordinates(shutter: AbstractShutter) -> Float[Array, "p"]:
    """Coordinates of an adjustable profile in the unit box; shape `(p,)`."""
    if isinstance(shutter, AbstractAdjustableShutter):
        return shutter.box()
    bounded = _bounded(shutter).values()
    shares = ((value - low) / (high - low) for value, low, high in bounded)
    return jnp.concatenate([jnp.ravel(share) for share in shares])


def num_coordinates(shutter: AbstractShutter) -> int:
    """Number of the `coordinates` of a profile, with their errors."""
    if isinstance(shutter, AbstractAdjustableShutter):
        return eqx.filter_eval_shape(type(shutter).box, shutter).size
    return sum(value.size for value, _, _ in _bounded(shutter).values())


def at_coordinates(shutter: AbstractShutter, box: Float[Array, "p"]) -> AbstractShutter:
    """The shutter of the same kind at other coordinates of the unit box."""
    if isinstance(shutter, AbstractAdjustableShutter):
        return shutter.at(box)
    bounded, values, start = _bounded(shutter), [], 0
    for value, low, high in bounded.values():
        share = box[start : start + value.size].reshape(value.shape).astype(value.dtype)
        values.append(low + share * (high - low))
        start += value.size
    return eqx.tree_at(lambda x: [getattr(x, name) for name in bounded], shutter, values)


def _bounded(shutter: AbstractShutter) -> dict[str, tuple[Array, float, float]]:
    """Parameters that a search may move, with their bounds."""
    kind, members = type(shutter).__name__, {}
    for name, (low, high) in shutter.bounds().items():
        subject = f"{kind}.bounds()[{name!r}]"
        require(hasattr(shutter, name), subject, "be of a field of the shutter", name)
        ascend = -np.inf < low < high < np.inf
        require(ascend, subject, "be two finite numbers that ascend", (low, high))
        value = as_float(getattr(shutter, name), f"{kind}({name}=...)")
        require_finite(f"{kind}({name}=...)", value)
        members[name] = (value, low, high)
    return members


def integrated_transmittance(shutter: AbstractPiecewiseShutter) -> Float[Array, ""]:
    """Integral of the transmittance over its whole domain; scalar."""
    dtype = shutter.dtype() or common_dtype()
    width = jnp.diff(shutter.breakpoints(np.dtype(dtype)))
    piece = jnp.arange(width.size)
    return jnp.sum(width * shutter.piece_mean(piece, piece >= 0, width / 2, width))


def integral_between(
    profile: AbstractPiecewiseShutter, begin: Float[Array, "*shape"], end: Float[Array, "*shape"]
) -> Float[Array, "*shape"]:
    r"""Integrals of the transmittance between times $-1 \le$ `begin` $\le$ `end` $\le 1$.

    Each is made of the parts of the first and of the last piece that it meets, and of the whole
    pieces between, whatever their number: the cost is that of two means an interval.
    """
    ends = jnp.asarray(profile.breakpoints(np.dtype(begin.dtype)))
    length = jnp.diff(ends)
    # What reaches an end of the exposure moves with it: a shutter may jump there.
    begin, end = (
        jnp.where(x <= ends[0], ends[0], jnp.where(x >= ends[-1], ends[-1], x))
        for x in (begin, end)
    )

    def of_one_piece(piece: Array, begin: Array, end: Array) -> Array:
        middle, width = (begin + end) / 2, end - begin
        before = middle - looked_up(ends, piece)
        after = looked_up(length, piece) - before
        # Prevents XLA from computing the lookups again in each loop that reads them, which would
        # take twice as long to compile.
        piece, before, after, width = jax.lax.optimization_barrier((piece, before, after, width))
        from_left = before <= after
        nearer = jnp.where(from_left, before, after)
        return width * profile.piece_mean(piece, from_left, nearer, width)

    if length.size == 1:
        return of_one_piece(jnp.zeros(begin.shape, jnp.int32), begin, end)
    first, last = (_piece_at(time, ends) for time in (begin, end))
    leaves = last > first
    stop = jnp.where(leaves, looked_up(ends, first + 1), end)
    start = jnp.where(leaves, looked_up(ends, last), end)
    whole = jnp.arange(length.size, dtype=jnp.int32)
    # One evaluation for all compiles once.
    rows = (first, last, whole), (begin, start, ends[:-1]), (stop, end, ends[1:])
    every = of_one_piece(*(jnp.concatenate([x.ravel() for x in row]) for row in rows))
    parts = jnp.sum(every[: 2 * begin.size].reshape(2, *begin.shape), axis=0)
    passed = jnp.append(jnp.zeros_like(ends[:1]), jnp.cumsum(every[2 * begin.size :]))
    between = looked_up(passed, last) - looked_up(passed, jnp.where(leaves, first + 1, last))
    return parts + between


def _piece_at(time: Float[Array, "*shape"], ends: Float[Array, "ends"]) -> Int[Array, "*shape"]:
    """Index of the piece that holds each time, the later one where two meet."""
    inner = ends[1:-1]
    if inner.size > 64:
        return jnp.searchsorted(inner, time, side="right").astype(jnp.int32)
    # Comparing with each of a few is as quick as a binary search.
    row = inner.reshape((1,) * time.ndim + (-1,))
    return jnp.sum(time[..., None] >= row, axis=-1, dtype=jnp.int32)


def within_exposure(tau: Array, value: Array) -> Array:
    """The value at normalised times of an exposure, 0 at others and NaN at none."""
    outside = jnp.where(jnp.isnan(tau), tau, 0.0).astype(value.dtype)
    return jnp.where(jnp.abs(tau) <= 1, value, outside)


def uniform_breakpoints(num_pieces: int, dtype: np.dtype) -> Float[Array, "{num_pieces}+1"]:
    """Ends of equal pieces, from -1 to 1."""
    ends = np.arange(-num_pieces, num_pieces + 1, 2) / num_pieces
    return device_constant(ends.astype(dtype))


@jax.custom_jvp
def within_unit(value: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Undo a last-digit excursion from [0, 1] and leave the derivative alone."""
    return jnp.clip(value, 0, 1)


@within_unit.defjvp
def _within_unit_jvp(primals, tangents):
    return within_unit(*primals), tangents[0]


@final
class SampledShutter(AbstractPiecewiseShutter):
    r"""Another shutter by its degree-5 interpolants between 65 equal times and its discontinuities.

    Its transmittance differs from the original's by at most
    $\max|w^{(6)}| / (64^6 \cdot 2^5 \cdot 6!)$ where that is smooth: 3e-13 for a Hann
    profile. No interpolant looks across a discontinuity that the shutter declares.
    """

    shutter: AbstractShutter
    panels_per_piece: ClassVar[int] = 1
    equal_pieces: ClassVar[bool] = False
    symmetric: ClassVar[bool] = False

    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        return self.shutter.transmittance(tau)

    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        uniform, places = uniform_breakpoints(_NUM_PIECES, dtype), self.shutter.discontinuities()
        if not len(places):
            return uniform
        declared = jnp.stack([jnp.asarray(x, dtype) for x in places])
        # A selection in place of a clip, which halves the derivative at its ends.
        declared = jnp.where(declared < -1, -1.0, jnp.where(declared > 1, 1.0, declared))
        # A time that all but coincides with a declared one moves with it: no rounding decides
        # at which of the two the jump counts.
        apart = jnp.abs(uniform[:, None] - declared[None])
        same = apart <= 64 * jnp.finfo(dtype).eps
        own = jnp.where(same.any(axis=1), declared[jnp.argmax(same, axis=1)], uniform)
        return jnp.sort(jnp.concatenate([own, declared]))

    def piece_transmittance(self, offset: Offsets) -> Values:
        dtype = np.finfo(offset.dtype).dtype
        scale = self._scale(dtype).reshape(-1, *(1,) * (offset.ndim - 1))
        share = offset * scale.astype(offset.dtype)
        return bernstein_value(expand(split_control(self._control(dtype)), share), share)

    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        scale = self._scale(width.dtype)[piece]
        control = self._control(width.dtype)
        return bernstein_mean(control, piece, from_left, distance * scale, width * scale)

    def _scale(self, dtype: np.dtype) -> Array:
        """Shares of a piece that a unit of time is; 0 of a piece of no length."""
        length = jnp.diff(self.breakpoints(dtype))
        some = length > 0
        return jnp.where(some, 1 / jnp.where(some, length, 1.0), 0.0)

    def _control(self, dtype: np.dtype) -> Array:
        nodes, to_control = bernstein_from_values(_DEGREE)
        ends = self.breakpoints(dtype)
        tau = ends[:-1, None] + jnp.diff(ends)[:, None] * jnp.asarray(nodes, dtype)[None]
        values = self.shutter.transmittance(tau)
        if not jnp.issubdtype(values.dtype, jnp.floating):  # open and closed as 1 and 0
            values = values.astype(dtype)
        return (values @ jnp.asarray(to_control.T, values.dtype)).astype(dtype)


def piecewise(shutter: AbstractShutter) -> AbstractPiecewiseShutter:
    """`shutter` itself if it is known piece by piece, its interpolant if not."""
    require(isinstance(shutter, AbstractShutter), "shutter", "be a shutter", shutter)
    if isinstance(shutter, AbstractPiecewiseShutter):
        return shutter
    if all_concrete(shutter):
        _check_transmittance(shutter)
    return SampledShutter(shutter)


@outside_trace()
def _check_transmittance(shutter: AbstractShutter) -> None:
    subject = f"{type(shutter).__name__}.transmittance"
    try:
        jax.eval_shape(shutter.transmittance, _UNIFORM)
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError) as error:
        requirement = "be made of functions that JAX can trace, as those of `jax.numpy`"
        require(False, subject, requirement, Unquoted(type(error).__name__))
    values = np.asarray(shutter.transmittance(jnp.asarray(_UNIFORM)))
    alike = values.shape == _UNIFORM.shape
    require(alike, subject, "have the shape of its argument", shape_of(values))
    require(np.isrealobj(values), subject, "be real", Unquoted(values.dtype))
    worst = values[np.argmax(np.abs(np.where(np.isnan(values), np.inf, values - 0.5)))]
    rounding = 16 * float(np.finfo(common_dtype(values)).eps)
    require(bool(-rounding <= worst <= 1 + rounding), subject, "lie in [0, 1]", worst)
    _check_discontinuities(shutter, subject)


def check_bounds(shutter: AbstractShutter) -> None:
    """Refuse a shutter that a search may move to where it is none.

    It is looked at with its parameters in the middle of their ranges, each of them at its ends
    beside the others in the middle, and all of them at the ends.
    """
    if isinstance(shutter, AbstractPiecewiseShutter):
        return
    bounded = _bounded(shutter)
    if not bounded:
        return
    ends, middle = (0.0, 1.0), (0.5,) * len(bounded)
    faces = [(*middle[:k], end, *middle[k + 1 :]) for k in range(len(bounded)) for end in ends]
    corners = itertools.product(ends, repeat=len(bounded))
    # With one parameter faces and corners are the same.
    places = dict.fromkeys([middle, *faces, *itertools.islice(corners, _MOST_CORNERS)])
    for place in places:
        shares = dict(zip(bounded, place, strict=True))
        values = {
            name: low + shares[name] * (high - low) for name, (_, low, high) in bounded.items()
        }
        box = [np.full(value.size, shares[name]) for name, (value, *_) in bounded.items()]
        moved = at_coordinates(shutter, as_float(np.concatenate(box)))
        try:
            _check_transmittance(moved)
        except ValueError as error:
            words = ", ".join(f"{name} = {x:.4g}" for name, x in values.items())
            raise ValueError(f"{str(error).removesuffix('.')} with {words}.") from None


def _check_discontinuities(shutter: AbstractShutter, subject: str) -> None:
    """Refuse a jump or bend that is not declared: interpolants would smooth it.

    They are held against the shutter near both ends of each piece and in between. A shutter
    without parameters may jump where pieces meet anyway, as it does not move there.
    """
    places = [np.asarray(x) for x in shutter.discontinuities()]
    for place in places:
        finite = place.shape == () and np.isrealobj(place) and bool(np.isfinite(place))
        require(finite, f"{type(shutter).__name__}.discontinuities()", "be finite numbers", place)
    dtype = np.dtype(SampledShutter(shutter).dtype() or common_dtype())
    declared = np.clip(np.array(places, dtype), -1, 1)
    ends = np.sort(np.concatenate([_UNIFORM.astype(dtype), declared]))
    length = np.diff(ends)[:, None]
    nodes, to_control = bernstein_from_values(_DEGREE)
    share = np.concatenate([nodes, _PROBES]).astype(dtype)[None]
    beside = 64 * np.finfo(dtype).eps  # of a jump, where its own rounding does not reach
    begin, end = ends[:-1, None], ends[1:, None]
    tau = np.clip(begin + length * share, begin + beside, end - beside)
    values = np.asarray(shutter.transmittance(jnp.asarray(tau)), np.float64)
    control = values[:, : nodes.size] @ to_control.T
    powers = np.vander(_PROBES, _DEGREE + 1, increasing=True)
    fitted = control @ power_matrix(_DEGREE) @ powers.T
    error = np.where(length > _SHORT, np.abs(fitted - values[:, nodes.size :]), 0.0)
    worst = np.unravel_index(np.argmax(error), error.shape)
    requirement = "be smooth but for where its `discontinuities()` say that it jumps or bends"
    # A bend by a slope of 1 half way through a piece leaves 3e-3.
    allowed = max(1e-6, 64 * float(np.finfo(dtype).eps))
    at = float(tau[:, nodes.size :][worst])
    got = Unquoted(f"a jump, a bend or a curve too steep to follow near tau = {at:.4g}")
    require(bool(error[worst] <= allowed), subject, requirement, got)
    if jax.tree.leaves(shutter):
        gap = np.abs(ends[1:-1, None] - np.append(declared, np.inf)[None]).min(axis=1)
        step = np.where(gap < _SHORT, 0.0, np.abs(fitted[1:, 0] - fitted[:-1, -1]))
        got = Unquoted(f"a jump at tau = {float(ends[1:-1][np.argmax(step)]):.4g}")
        require(float(step.max()) <= allowed, subject, requirement, got)


def above_zero(length: Length) -> Length:
    """A length of time held above 0, so that offsets over it are finite; no sum feels the bound.

    The derivative is that of the length itself: at a taper of 0, of the ramp that begins there.
    """
    least = float(np.finfo(np.dtype(length.dtype)).tiny) ** 0.25
    if isinstance(length, np.ndarray):
        return np.asarray(np.maximum(length, np.asarray(least, length.dtype)))
    return length + jax.lax.stop_gradient(jnp.maximum(length, least) - length)


def polynomial(coefficients: Sequence[ArrayLike] | Numbers, x: Any) -> Any:
    """A polynomial by its coefficients, the highest first."""
    total = namespace_of(x).asarray(coefficients[0], x.dtype)
    for coefficient in coefficients[1:]:
        total = total * x + coefficient
    return total


def polynomial_means(
    powers: Float[Array, "pieces degrees"], piece: Pieces, centre: Cells, width: Cells
) -> Cells:
    """Means of some polynomials over intervals, by the Gauss-Legendre rule that is exact."""
    nodes, weights = np.polynomial.legendre.leggauss((powers.shape[1] + 1) // 2)
    each = (-1,) + (1,) * centre.ndim
    n, w = (x.astype(centre.dtype).reshape(each) / 2 for x in (nodes, weights))
    # One lookup of whole rows, which has one scatter as its transpose.
    coefficients = jnp.moveaxis(looked_up(powers, piece), -1, 0)[:, None]
    return jnp.sum(w * polynomial(coefficients, centre[None] + n * width[None]), axis=0)


def bernstein_value(control: list[Numbers], u: Numbers) -> Numbers:
    """Value at `u`, the share of the piece passed, by de Casteljau's rule."""
    points = control
    while len(points) > 1:
        points = [a + u * (b - a) for a, b in itertools.pairwise(points)]
    return points[0]


def bernstein_mean(
    control: Float[Array, "..."],  # shape `(n, degree + 1)`
    piece: Pieces,
    from_left: Sides,
    distance: Cells,
    width: Cells,
) -> Cells:
    """Means of some pieces over intervals, in shares of the piece.

    By powers of the distance from the end of the piece that is nearer. Up to the middle they
    cancel by little where control points are of one sign: a profile that vanishes at an end
    keeps its relative accuracy.
    """
    matrix = power_matrix(control.shape[1] - 1).astype(control.dtype)
    from_ends = jnp.concatenate([control, control[:, ::-1]]) @ matrix
    row = jnp.where(from_left, piece, piece + control.shape[0])
    return polynomial_means(from_ends[:, ::-1], row, distance, width)


def looked_up(values: Array, index: Array) -> Array:
    """Values at indices that are known to be in range."""
    return values.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)


def power_matrix(degree: int) -> Float[np.ndarray, "{degree}+1 {degree}+1"]:
    """Matrix from control points, a row, to coefficients of powers of the share passed."""
    k = range(degree + 1)
    rows = [[comb(degree, j) * comb(j, i) * (-1) ** (j - i) for j in k] for i in k]
    return np.array(rows, float)


@lru_cache
def bernstein_from_values(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev nodes in [0, 1] and the matrix from values there to control points."""
    k = np.arange(degree + 1)
    nodes = (1 - np.cos((2 * k + 1) * np.pi / (2 * degree + 2))) / 2
    basis = np.array([[comb(degree, j) * x**j * (1 - x) ** (degree - j) for j in k] for x in nodes])
    return nodes, np.linalg.inv(basis)


def split_control(control: Numbers) -> list[Numbers]:
    """Control points on the last axis of an array, as a list."""
    return [control[..., i] for i in range(control.shape[-1])]


def expand(points: list[Numbers], like: Numbers) -> list[Numbers]:
    """Control points of shape `(n,)` made to broadcast against `(n, ...)`."""
    return [p.reshape(p.shape + (1,) * (like.ndim - 1)).astype(like.dtype) for p in points]
