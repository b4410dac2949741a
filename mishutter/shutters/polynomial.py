"""Polynomials in Bernstein form: values, and means over part of a piece."""

import itertools

import numpy as np
from jaxtyping import Array


def bernstein_value(control: list[Array], u: Array) -> Array:
    """Value at `u`, the share of the piece passed, by de Casteljau's rule."""
    points = control
    while len(points) > 1:
        points = [a + u * (b - a) for a, b in itertools.pairwise(points)]
    return points[0]


def bernstein_mean(control: list[Array], start: Array, width: Array, remaining: Array) -> Array:
    """Mean over `[start, 1 - remaining]`, in shares of the piece.

    The mean of a polynomial is the average of its control points on the interval,
    which are its blossom at the interval's ends: weighted averages throughout, so the
    result lies between the control points and nothing cancels.
    """
    left = (width + remaining, start)
    right = (remaining, start + width)
    rows = [control]
    for _ in range(len(control) - 1):
        rows = [_blend(rows[0], left)] + [_blend(row, right) for row in rows]
    return sum(row[0] for row in rows) / len(rows)  # type: ignore[return-value]


def _blend(points: list[Array], weights: tuple[Array, Array]) -> list[Array]:
    before, after = weights
    return [before * a + after * b for a, b in itertools.pairwise(points)]


def bernstein_from_values(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev nodes in [0, 1] and the matrix from values there to control points."""
    k = np.arange(degree + 1)
    nodes = (1 - np.cos((2 * k + 1) * np.pi / (2 * degree + 2))) / 2
    from math import comb

    basis = np.array([[comb(degree, j) * x**j * (1 - x) ** (degree - j) for j in k] for x in nodes])
    return nodes, np.linalg.inv(basis)


def split_control(control: Array) -> list[Array]:
    """Control points on the last axis of an array, as a list."""
    return [control[..., i] for i in range(control.shape[-1])]


def expand(points: list[Array], like: Array) -> list[Array]:
    """Control points of shape `(n,)` made to broadcast against `(n, ...)`."""
    return [p.reshape(p.shape + (1,) * (like.ndim - 1)).astype(like.dtype) for p in points]
