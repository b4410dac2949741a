"""Fewer speeds in place of those of a scene: each once, or the nodes of a quadrature."""

import numpy as np

from mishutter.model import Scene

_SAME_SPEED = 4
"""Two speeds count as one if they differ by up to this many roundings of the fastest."""


def distinct_speeds(scene: Scene, *, folds: bool) -> tuple[np.ndarray, np.ndarray]:
    """Speeds that occur, each once, ascending, with their weights; shapes `(n,)`.

    Speeds that differ only in their last digits count as one, because rounding makes such
    pairs in ranges that are meant to mirror themselves.
    """
    speeds, weights = np.asarray(scene.speeds), np.asarray(scene.weights)
    speeds, weights = speeds[weights > 0], weights[weights > 0]
    values = np.abs(speeds) if folds else speeds
    order = np.argsort(values, kind="stable")
    values, weights = values[order], weights[order]
    begins = np.diff(values, prepend=-np.inf) > rounding(values, values.dtype)
    merged = np.bincount(np.cumsum(begins) - 1, weights)
    return values[begins], merged.astype(weights.dtype)


def rounding(speeds: np.ndarray, dtype: np.dtype) -> float:
    """Difference up to which two of these speeds count as one in a precision; px/s."""
    return float(_SAME_SPEED * np.finfo(dtype).eps * np.max(np.abs(speeds), initial=0))


def quadrature(
    speeds: np.ndarray, weights: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    r"""Gauss rule of a distribution of speeds: `count` speeds in place of all.

    $\sum_j p'_j g(s'_j) = \sum_i p_i g(s_i)$ for every polynomial of degree below twice
    `count`. Nodes and weights are those of the Jacobi matrix that Lanczos' recurrence
    builds (Golub and Welsch, Math. Comp. 23, 1969); vectors are orthogonalised twice.
    """
    if count >= speeds.size:
        return speeds, weights
    centre, scale = float(np.mean(speeds)), float(np.ptp(speeds)) / 2
    x = (speeds.astype(np.float64) - centre) / scale
    basis = [np.sqrt(weights.astype(np.float64))]
    diagonal, side = [], []
    for _ in range(count):
        vector = x * basis[-1]
        diagonal.append(basis[-1] @ vector)
        for _ in range(2):
            vector -= np.array(basis).T @ (np.array(basis) @ vector)
        side.append(np.linalg.norm(vector))
        basis.append(vector / side[-1])
    jacobi = np.diag(diagonal) + np.diag(side[:-1], 1) + np.diag(side[:-1], -1)
    nodes, vectors = np.linalg.eigh(jacobi)
    chosen_weights = vectors[0] ** 2
    nodes = np.clip(centre + scale * nodes, speeds.min(), speeds.max())
    return nodes.astype(speeds.dtype), (chosen_weights / chosen_weights.sum()).astype(weights.dtype)
