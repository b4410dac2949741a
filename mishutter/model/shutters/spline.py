"""The free-form shutter that is optimised."""

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.lib.stride_tricks import sliding_window_view

from mishutter._core.checks import (
    RowLike,
    as_array_like,
    as_float,
    common_dtype,
    namespace_of,
    require,
    require_finite,
    require_positive_int,
    shape_of,
)
from mishutter.model.shutters.base import (
    AbstractAdjustableShutter,
    AbstractShutter,
    Cells,
    Length,
    Offsets,
    Pieces,
    Sides,
    Values,
    bernstein_mean,
    bernstein_value,
    expand,
    piecewise,
    split_control,
    uniform_breakpoints,
    within_exposure,
    within_unit,
)
from mishutter.model.shutters.polynomials import profile_of

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_DEGREE = 3


@final
class SplineShutter(AbstractAdjustableShutter):
    r"""Clamped uniform cubic B-spline, $w(\tau) = \sum_j c_j B_j(\tau)$, $c_j \in [0, 1]$.

    The basis is non-negative and sums to one, so a profile with coefficients in
    $[0, 1]$ stays there; all ones are a rect shutter, edges included. A parameter
    outside $[0, 1]$ is folded back by reflection at 0 and 1, so that every parameter
    is a shutter and no bound flattens the derivative.

    Args:
        parameters: $c_j$ before folding; shape `(n,)` with `n >= 4`, or, for a
            symmetric shutter, the first half (middle one included) of them.
        symmetric: Whether $w(-\tau) = w(\tau)$ is imposed by mirroring the parameters.
        num_coefficients: $n$, where `symmetric` leaves it open; twice the number of
            parameters by default.

    Raises:
        ValueError: if there are too few parameters or one is not finite.
    """

    parameters: Array
    symmetric: bool = eqx.field(static=True)
    num_coefficients: int = eqx.field(static=True)
    panels_per_piece: ClassVar[int] = 1
    equal_pieces: ClassVar[bool] = True
    evaluates_by_numpy: ClassVar[bool] = True
    linear: ClassVar[bool] = True

    def __init__(
        self,
        parameters: RowLike,
        *,
        symmetric: bool = False,
        num_coefficients: int | np.integer | None = None,
    ):
        self.parameters = as_float(parameters, "SplineShutter(parameters=...)")
        self.symmetric = symmetric
        count = self.parameters.size * (2 if symmetric else 1)
        if num_coefficients is not None:
            count = require_positive_int("SplineShutter(num_coefficients=...)", num_coefficients)
        self.num_coefficients = count

    def __check_init__(self) -> None:
        subject, count = "SplineShutter(parameters=...)", self.num_coefficients
        expected = (count + 1) // 2 if self.symmetric else count
        is_row = self.parameters.shape == (expected,) and count > _DEGREE
        requirement = f"be one row for at least {_DEGREE + 1} coefficients"
        require(is_row, subject, requirement, shape_of(self.parameters))
        require_finite(subject, self.parameters)

    @property
    def coefficients(self) -> Float[Array, "coefficients"]:
        """B-spline coefficients in `[0, 1]`; shape `(n,)`."""
        return self._coefficients(self.parameters)

    def _coefficients(self, parameters: Length) -> Length:
        folded = _fold(parameters)
        if not self.symmetric:
            return folded
        mirrored = folded[: self.num_coefficients // 2][::-1]
        return namespace_of(folded).concatenate([folded, mirrored])

    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        tau = jnp.asarray(tau, common_dtype(self.parameters, tau))
        control = self._control_points(self.parameters).astype(tau.dtype)
        count = control.shape[0]
        position = (jnp.clip(tau, -1, 1) + 1) * (count / 2)
        piece = jnp.clip(position.astype(jnp.int32), 0, count - 1)
        value = bernstein_value(split_control(control[piece]), position - piece.astype(tau.dtype))
        return within_exposure(tau, within_unit(value))

    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        return uniform_breakpoints(self.num_coefficients - _DEGREE, dtype)

    def piece_transmittance(self, offset: Offsets) -> Values:
        share = offset * ((self.num_coefficients - _DEGREE) / 2)
        control = self._control_points(as_array_like(offset, self.parameters))
        return bernstein_value(expand(split_control(control), share), share)

    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        scale = (self.num_coefficients - _DEGREE) / 2
        control = self._control_points(self.parameters).astype(width.dtype)
        return bernstein_mean(control, piece, from_left, distance * scale, width * scale)

    def _control_points(self, parameters: Any) -> Any:
        """Bernstein control points of each piece; shape `(n - 3, 4)`."""
        extraction = bezier_extraction(self.num_coefficients).astype(parameters.dtype)
        return extraction @ self._coefficients(parameters)

    def box(self) -> Float[Array, "p"]:
        return _fold(self.parameters)

    def at(self, box: Float[Array, "p"]) -> "SplineShutter":
        return SplineShutter(box, symmetric=self.symmetric, num_coefficients=self.num_coefficients)

    @staticmethod
    def fit(
        shutter: AbstractShutter, num_coefficients: int = 24, *, symmetric: bool = False
    ) -> "SplineShutter":
        r"""Least-squares spline of another shutter, subject to $c_j \in [0, 1]$.

        Args:
            shutter: The profile to start from.
            num_coefficients: $n$, at least 4.
            symmetric: Whether to return the symmetric variant.

        Raises:
            ValueError: if there is no shutter, or one that is somewhere no transmittance, or
                `num_coefficients` is not a whole number of at least 4.
        """
        is_shutter = isinstance(shutter, AbstractShutter)
        require(is_shutter, "SplineShutter.fit(shutter=...)", "be a shutter", shutter)
        piecewise(shutter)  # refuses what is no transmittance
        subject = "SplineShutter.fit(num_coefficients=...)"
        require_positive_int(subject, num_coefficients)
        require(num_coefficients > _DEGREE, subject, "be at least 4", num_coefficients)
        (parameters,) = fitted_boxes([shutter], num_coefficients, symmetric=symmetric)
        return SplineShutter(
            jnp.asarray(parameters, common_dtype(shutter)),
            symmetric=symmetric,
            num_coefficients=num_coefficients,
        )


def fitted_boxes(
    shutters: Sequence[AbstractShutter], num_coefficients: int, *, symmetric: bool
) -> list[np.ndarray]:
    """Parameters of the splines that `SplineShutter.fit` gives; shape `(p,)` each."""
    num_samples = 16 * (num_coefficients - _DEGREE)  # a piece
    tau = (2 * np.arange(num_samples) + 1) / num_samples - 1
    basis, boxes = spline_basis(tau, num_coefficients).toarray(), []
    for shutter in shutters:
        target = profile_of(shutter, tau.astype(common_dtype()))[0].astype(np.float64)
        if symmetric:
            target = (target + target[::-1]) / 2
        coefficients = bounded_coefficients(basis, target)
        boxes.append(coefficients[: (num_coefficients + 1) // 2] if symmetric else coefficients)
    return boxes


def _fold(parameters: Length) -> Length:
    space, inside = namespace_of(parameters), (parameters >= 0) & (parameters <= 1)
    return space.where(inside, parameters, abs(space.mod(parameters + 1, 2.0) - 1))


def bounded_coefficients(basis: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Coefficients in [0, 1] of the least squares, those at a bound exactly; shape `(count,)`."""
    from scipy.optimize import lsq_linear

    solution = np.clip(lsq_linear(basis, target, bounds=(0, 1), tol=1e-14).x, 0, 1)
    return np.where(np.abs(solution - np.round(solution)) < 1e-9, np.round(solution), solution)


def spline_basis(tau: Float[np.ndarray, "times"], count: int) -> "csr_array":
    """B-splines at normalised times in [-1, 1], four a row; sparse, shape `(times, count)`."""
    from scipy.interpolate import BSpline

    return BSpline.design_matrix(tau, spline_knots(count), _DEGREE)


def spline_knots(count: int) -> Float[np.ndarray, "knots"]:
    """Knots of a spline of so many coefficients on [-1, 1]; shape `(count + 4,)`."""
    inner = np.linspace(-1, 1, count - _DEGREE + 1)
    return np.concatenate([np.full(_DEGREE, -1.0), inner, np.full(_DEGREE, 1.0)])


def coefficient_times(count: int) -> Float[np.ndarray, "{count}"]:
    r"""Normalised times about which coefficients act, their Greville abscissae; shape `(n,)`.

    Coefficients that are the values of a straight line there make the spline that line.
    """
    return sliding_window_view(spline_knots(count)[1:-1], _DEGREE).mean(axis=1)


@lru_cache
def bezier_extraction(count: int) -> Float[np.ndarray, "pieces 4 {count}"]:
    """Matrix from B-spline coefficients to control points; shape `(n - 3, 4, n)`.

    Knots are inserted until each has full multiplicity (Boehm's algorithm); the
    coefficients are then the control points of the pieces.
    """
    knots, rows = spline_knots(count), np.eye(count)
    for knot in np.linspace(-1, 1, count - _DEGREE + 1)[1:-1]:
        for _ in range(_DEGREE - 1):
            knots, rows = _insert_knot(knots, rows, knot)
    return np.stack([rows[_DEGREE * j : _DEGREE * j + 4] for j in range(count - _DEGREE)])


def _insert_knot(knots: np.ndarray, rows: np.ndarray, knot: float) -> tuple[np.ndarray, np.ndarray]:
    span = int(np.searchsorted(knots, knot, side="right")) - 1
    inserted = [rows[i] if i <= span - _DEGREE else rows[i - 1] for i in range(rows.shape[0] + 1)]
    for i in range(span - _DEGREE + 1, span + 1):
        share = (knot - knots[i]) / (knots[i + _DEGREE] - knots[i])
        inserted[i] = share * rows[i] + (1 - share) * rows[i - 1] if i < len(rows) else rows[i - 1]
    return np.insert(knots, span + 1, knot), np.stack(inserted)
