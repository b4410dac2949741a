"""The best profile at each point of a block, from its neighbours' profiles.

The loss at a point is the design search's own, and so are the descent and the polish. The
exposures of a block are done one after the other: each point starts from what its neighbours
at the last exposure ended with. Then they are done backwards: a point at which a profile of its
neighbours there is better than its own is searched from there once more. Without that, a valley
that is left behind as exposures grow would be kept wherever the better one begins later.
"""

from functools import lru_cache

import jax
import numpy as np

from mishutter._core import alone_in_blas
from mishutter.design import best_profile, window_fits
from mishutter.evaluation import automatic
from mishutter.model import AbstractMotion, ParabolicMotion, Scene, SplineShutter, steady
from mishutter.sweeps.grid import Search

_NUM_WINDOWS = 3
"""Windows that a point starts from, beside a random profile and what its neighbours found."""
_NUM_NEAR = 3
"""Neighbours at the last exposure."""


@lru_cache
def start_boxes(num_coefficients: int, symmetric: bool, seed: int) -> np.ndarray:
    """Profiles that every search starts from: windows and a random one."""
    boxes = np.stack(window_fits(num_coefficients, symmetric)[:_NUM_WINDOWS])
    random = np.random.default_rng(seed).uniform(size=boxes.shape[1])
    return np.concatenate([boxes, random[None]])


def basis_of(search: Search) -> tuple[SplineShutter, list[SplineShutter]]:
    """A profile of the kind that is searched, and its basis: closed, then each coordinate open."""
    count, symmetric = search.num_coefficients, search.symmetric
    (box, *_) = window_fits(count, symmetric)
    first = SplineShutter(box, symmetric=symmetric, num_coefficients=count)
    corners = np.eye(box.size + 1, box.size, -1, dtype=first.parameters.dtype)
    return first, [first.at(jax.device_put(corner)) for corner in corners]


@alone_in_blas()
def search(
    settings: Search,
    scene: Scene,
    motions: AbstractMotion,
    rows: np.ndarray,
    columns: np.ndarray,
    skips: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Best boxes `(n, c)` and losses `(n,)` of points in some rows and columns of a block."""
    first = start_boxes(settings.num_coefficients, settings.symmetric, settings.seed)
    shape = rows.max(initial=0) + 1, columns.max(initial=0) + 1
    boxes, losses = np.full((*shape, first.shape[1]), np.nan), np.full(shape, np.nan)
    profile = basis_of(settings)[0]

    def best(index: int, starts: np.ndarray, known: tuple[np.ndarray, float] | None = None):
        motion = ParabolicMotion(
            acceleration=steady(motions).acceleration[index],
            half_exposure=motions.half_exposure[index],
        )
        return best_profile(
            scene,
            motion,
            profile,
            starts,
            loss=settings.loss,
            max_steps=settings.max_steps,
            plan=automatic(scene, motion, profile) if skips else None,
            known=known,
        )

    order = np.lexsort((rows, columns)).tolist()
    for index in order:
        at = int(rows[index]), int(columns[index])
        starts = starts_at(first, boxes, rows[index : index + 1], at[1])[0]
        boxes[at], losses[at] = best(index, starts)
    for index in order[::-1]:
        at = int(rows[index]), int(columns[index])
        starts = later_profiles(boxes, *at)
        if starts.size:
            boxes[at], losses[at] = best(index, starts, (boxes[at], float(losses[at])))
    return boxes[rows, columns], losses[rows, columns]


def later_profiles(boxes: np.ndarray, row: int, column: int) -> np.ndarray:
    """Profiles of neighbours at the next exposure and at the next acceleration; `(n, c)`.

    As many as a search has starts, some twice, or none.

    Args:
        boxes: Profiles found so far, NaN elsewhere; shape `(a, t, c)`.
        row: The acceleration of a point.
        column: Its exposure.
    """
    around = boxes[max(row - 1, 0) : row + 2, column + 1 : column + 2]
    near = np.concatenate([around.reshape(-1, boxes.shape[2]), boxes[row + 1 : row + 2, column]])
    near = near[~np.isnan(near[:, 0])]
    return np.resize(near, (_NUM_WINDOWS + 1 + _NUM_NEAR, boxes.shape[2])) if len(near) else near


def starts_at(first: np.ndarray, boxes: np.ndarray, rows: np.ndarray, column: int) -> np.ndarray:
    """Profiles of no point, and what the neighbours at the last exposure ended with; `(j, n, c)`.

    Args:
        first: Profiles of no point, some again in place of neighbours that are not there;
            shape `(m, c)`.
        boxes: Profiles found so far, NaN elsewhere; shape `(a, t, c)`.
        rows: Accelerations; shape `(j,)`.
        column: The exposure.
    """
    starts = np.tile(np.concatenate([first, first[-_NUM_NEAR:]])[None], (rows.size, 1, 1))
    if column == 0:
        return starts
    for number, step in enumerate((0, -1, 1), start=1):
        near = np.clip(rows + step, 0, boxes.shape[0] - 1)
        known = boxes[near, column - 1]
        there = ~np.isnan(known[:, 0])
        starts[there, -number] = known[there]
    return starts


def coefficients_of(boxes: np.ndarray, settings: Search) -> np.ndarray:
    """B-spline coefficients of profiles; shape `(..., n)`."""
    if not settings.symmetric:
        return boxes
    return np.concatenate([boxes, boxes[..., : settings.num_coefficients // 2][..., ::-1]], -1)
