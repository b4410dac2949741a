"""Polynomials: values, and in Bernstein form means over part of a piece."""

import itertools
from collections.abc import Sequence
from fractions import Fraction
from math import comb

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

Numbers = Array | np.ndarray


def polynomial(coefficients: Sequence[ArrayLike], x: Array | np.ndarray) -> Array:
    """A polynomial by its coefficients, the highest first."""
    total = jnp.asarray(coefficients[0], x.dtype)
    for coefficient in coefficients[1:]:
        total = total * x + coefficient
    return total


def polynomial_means(
    powers: Float[Array, "degrees pieces"],
    piece: Int[Array, "*cells"],
    centre: Float[Array, "*cells"],
    width: Float[Array, "*cells"],
) -> Float[Array, "*cells"]:
    """Means of some polynomials over intervals, by the Gauss-Legendre rule that is exact.

    Args:
        powers: Coefficients of each polynomial, the highest first; shape `(n, degree + 1)`.
        piece: Which polynomial, from 0; integers of any shape, that of the others.
        centre: Middle of the interval.
        width: Its length.
    """
    nodes, weights = np.polynomial.legendre.leggauss((powers.shape[1] + 1) // 2)
    each = (-1,) + (1,) * centre.ndim
    n, w = (x.astype(centre.dtype).reshape(each) / 2 for x in (nodes, weights))
    coefficients = [looked_up(power, piece[None]) for power in powers.T]
    return jnp.sum(w * polynomial(coefficients, centre[None] + n * width[None]), axis=0)


def economised(taylor: Sequence[Fraction], reach: Fraction, degree: int) -> list[float]:
    """A Taylor polynomial with fewer terms on `[0, reach]`, the highest first.

    Its last term is made up for, as well as can be, by those before it: a multiple of
    Chebyshev's polynomial is taken off, again and again (Lanczos).

    Args:
        taylor: Coefficients, the lowest first.
        reach: Where the series is to be good up to.
        degree: Degree that is left.
    """
    series = list(taylor)
    chebyshev = [[Fraction(1)], [Fraction(-1), 2 / reach]]
    while len(chebyshev) < len(series):
        before, last = [*chebyshev[-2], 0, 0], chebyshev[-1]
        longer = zip([0, *last], [*last, 0], before, strict=True)
        chebyshev.append([4 / reach * c - 2 * d - e for c, d, e in longer])
    while len(series) - 1 > degree:
        highest = chebyshev[len(series) - 1]
        share = series[-1] / highest[-1]
        series = [x - share * y for x, y in zip(series, highest, strict=True)][:-1]
    return [float(x) for x in reversed(series)]


def bernstein_value(control: list[Numbers], u: Numbers) -> Numbers:
    """Value at `u`, the share of the piece passed, by de Casteljau's rule."""
    points = control
    while len(points) > 1:
        points = [a + u * (b - a) for a, b in itertools.pairwise(points)]
    return points[0]


def bernstein_mean(
    control: Float[Array, "..."],
    piece: Int[Array, "*cells"],
    from_left: Bool[Array, "*cells"],
    distance: Float[Array, "*cells"],
    width: Float[Array, "*cells"],
) -> Float[Array, "*cells"]:
    """Means of some pieces over intervals, in shares of the piece.

    By powers of the distance from the end of the piece that is nearer. Up to the middle they
    cancel by little where control points are of one sign: a profile that vanishes at an end
    keeps its relative accuracy.

    Args:
        control: Control points of each piece; shape `(n, degree + 1)`.
        piece: Which piece, from 0; integers of any shape, that of the others.
        from_left: Whether `distance` is from the left end, or from the right one.
        distance: Distance of the interval's centre from an end of its piece.
        width: Length of the interval.
    """
    degree = control.shape[1] - 1
    from_ends = jnp.concatenate([control, control[:, ::-1]]) @ power_matrix(degree).astype(
        control.dtype
    )
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
