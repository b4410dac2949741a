"""Fewer speeds that stand for those of a scene: each that occurs, once."""

import numpy as np

from mishutter.model import Scene

_SAME_SPEED = 4
"""Roundings of the fastest speed within which two speeds are one."""


def distinct_speeds(scene: Scene, *, folds: bool) -> tuple[np.ndarray, np.ndarray]:
    """Speeds that occur, each once, ascending, with their weights; shapes `(n,)`.

    Speeds that differ in their last digits alone, as those of a range that is meant to
    mirror itself do, are one.
    """
    speeds, weights = np.asarray(scene.speeds), np.asarray(scene.weights)
    speeds, weights = speeds[weights > 0], weights[weights > 0]
    values = np.abs(speeds) if folds else speeds
    order = np.argsort(values, kind="stable")
    values, weights = values[order], weights[order]
    same = _SAME_SPEED * np.finfo(values.dtype).eps * np.max(np.abs(values), initial=0)
    begins = np.diff(values, prepend=-np.inf) > same
    merged = np.bincount(np.cumsum(begins) - 1, weights)
    return values[begins], merged.astype(weights.dtype)
