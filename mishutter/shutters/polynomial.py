"""Polynomials: values, and in Bernstein form means over part of a piece."""

import itertools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


def polynomial(coefficients: list[float], x: Array) -> Array:
    """A polynomial by its coefficients, the highest first."""
    total = jnp.full_like(x, coefficients[0])
    for coefficient in coefficients[1:]:
        total = total * x + coefficient
    return total


def bernstein_value(control: list[Array], u: Array) -> Array:
    """Value at `u`, the share of the piece passed, by de Casteljau's rule."""
    points = control
    while len(points) > 1:
        points = [a + u * (b - a) for a, b in itertools.pairwise(points)]
    return points[0]


def bernstein_mean(control: list[Array], start: Array, width: Array, remaining: Array) -> Array:
    """Mean over `[start, 1 - remaining]`, in shares of the piece.

    By the Gauss-Legendre rule that is exact for the degree. Each node is known by its
    distances from both ends of the piece, so the values at it are weighted averages of
    the control points: nothing cancels.
    """
    nodes, weights = np.polynomial.legendre.leggauss((len(control) + 1) // 2)
    total = jnp.zeros_like(width)
    for share, weight in zip(((1 + nodes) / 2).tolist(), (weights / 2).tolist(), strict=True):
        before, after = remaining + (1 - share) * width, start + share * width
        points = control
        while len(points) > 1:
            points = [before * a + after * b for a, b in itertools.pairwise(points)]
        total = total + weight * points[0]
    return total


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
