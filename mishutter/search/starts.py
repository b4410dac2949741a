"""Starts of a search: baselines' profiles and random ones, or a grid of a few coordinates."""

import math
from functools import lru_cache

import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int
from numpy.lib.stride_tricks import sliding_window_view

from mishutter._core import compiled
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    FreeMotion,
    GaussianShutter,
    HannShutter,
    RectShutter,
    Scene,
    SplineShutter,
    TriangleShutter,
    TukeyShutter,
    coordinates,
    fitted_boxes,
    simplified,
)
from mishutter.search.space import DesignSpace

GRID_COORDINATES = 4
"""Number of coordinates up to which a search begins on a grid."""
_GRID_POINTS = {1: (17,), 2: (5, 9), 3: (4, 5, 7), 4: (4, 4, 3, 7)}
"""Points along each coordinate, ends included, as many a best design lies at one: most along
the last, the acceleration, over which a condition number rises and falls with every pixel."""

_TILTS = (0.1, -0.1, 0.3, -0.3)
"""Distances of the paths to start from at either end of the first path, in the unit box."""
_DIGITS_APART = 6
"""Decimal digits of the unit box to which the paths of two starts differ."""


def start_boxes(space: DesignSpace, num_starts: int, seed: int) -> Float[np.ndarray, "n size"]:
    """Points to descend from; `n = num_starts` above four coordinates.

    The design of the space comes first, then the baselines' profiles and random ones, at its
    motion and at random motions by turns.
    """
    first = point_at(space, space.shutter, space.motion)
    if first.size <= GRID_COORDINATES:
        return np.concatenate([first[None], _grid(first.size).astype(first.dtype)])
    count = space.num_profile_coordinates
    shutter, profiles = space.shutter, []
    if count and isinstance(shutter, SplineShutter):
        profiles = window_fits(shutter.num_coefficients, shutter.symmetric)
    random = np.random.default_rng(seed)
    boxes = np.tile(first, (num_starts, 1))
    for index in range(1, num_starts):
        if count:
            is_baseline = index <= len(profiles)
            boxes[index, :count] = (
                profiles[index - 1] if is_baseline else _random_profile(random, count)
            )
        if index % 2 or not count:
            boxes[index, count:] = random.uniform(size=first.size - count)
    return boxes


def point_at(
    space: DesignSpace, shutter: AbstractShutter, motion: AbstractMotion
) -> Float[np.ndarray, "size"]:
    """The point of a box that is nearest to a design."""
    own = space.shutter
    if isinstance(shutter, SplineShutter) and isinstance(own, SplineShutter):
        if shutter.symmetric and not own.symmetric:
            shutter = SplineShutter(shutter.coefficients)
    alone, motion = space.of_motion, simplified(motion)
    if alone is space:
        return np.asarray(_point_at(space, shutter, motion))
    of_motion = np.asarray(_point_at(alone, RectShutter(), motion))
    if "shutter" not in space.free:
        return of_motion
    profile = np.clip(np.asarray(_coordinates(shutter)), 0, 1).astype(of_motion.dtype)
    return np.concatenate([profile, of_motion])


@compiled
def _point_at(
    space: DesignSpace, shutter: AbstractShutter, motion: AbstractMotion
) -> Float[Array, "size"]:
    return space.point_of(shutter, motion)


_coordinates = compiled(coordinates)


def path_boxes(
    space: DesignSpace, boxes: Float[np.ndarray, "n size"]
) -> Float[np.ndarray, "more size"]:
    """Designs, and others beside each whose paths turn faster or slower towards their ends.

    Where the pan is free, all of them occur also at its least and at its greatest: paths that turn
    sharply before mid-exposure and paths that do so after it lie in different valleys.

    Args:
        space: The space, with a free path.
        boxes: Points of it.
    """
    first = space.num_profile_coordinates
    outwards = np.linspace(-1, 1, space.num_path_coordinates, dtype=boxes.dtype)
    # A path that mirrors itself has coordinates for one half alone.
    if not space.path_mirrors:
        outwards = 2 * np.abs(outwards) - 1
    path = slice(first, first + outwards.size)
    _, places = np.unique(np.round(boxes, _DIGITS_APART), axis=0, return_index=True)
    boxes = boxes[np.sort(places)]
    others = [boxes]
    for tilt in _TILTS:
        others.append(boxes.copy())
        others[-1][:, path] = np.clip(boxes[:, path] + boxes.dtype.type(tilt) * outwards, 0, 1)
    if "velocity" in space.free:
        pan = space.num_shape_coordinates + space.free_of_motion.index("velocity")
        everywhere = np.concatenate(others)
        for end in (0, 1):
            others.append(everywhere.copy())
            others[-1][:, pan] = end
    return np.concatenate(others)


def path_of_speeds(scene: Scene, half_exposure: ArrayLike, num_pieces: int) -> FreeMotion:
    r"""A path that keeps up with every object for a time in proportion to its weight.

    Its velocity is the quantile function of the speeds, $s$ at the time $t$ up to which objects no
    faster than $s$ weigh $(t + T) / 2T$ of all, joined by straight lines. The last and the first
    object have half of their time beyond the ends.

    Args:
        scene: Speeds and weights.
        half_exposure: $T$; s, scalar.
        num_pieces: Equal pieces of the path.
    """
    order = np.argsort(np.asarray(scene.speeds))
    speeds, weights = np.asarray(scene.speeds)[order], np.asarray(scene.weights)[order]
    middles = (np.cumsum(weights) - weights / 2) / np.sum(weights)
    half = np.asarray(half_exposure)
    velocity = np.interp(np.linspace(0, 1, num_pieces + 1), middles, speeds).astype(half.dtype)
    return FreeMotion(
        accelerations=np.diff(velocity) * num_pieces / (4 * half),
        half_exposure=half,
        velocity=velocity[num_pieces // 2],
    )


def _grid(num_coordinates: int) -> Float[np.ndarray, "n {num_coordinates}"]:
    """A coarse grid of the unit box, the last coordinate running fastest."""
    axes = [np.linspace(0, 1, points) for points in _GRID_POINTS[num_coordinates]]
    grid = np.meshgrid(*axes, indexing="ij")
    return np.stack(grid, axis=-1).reshape(-1, num_coordinates)


def _random_profile(random: np.random.Generator, count: int) -> Float[np.ndarray, "{count}"]:
    """White noise and a random walk about one half, mixed: profiles of every roughness."""
    roughness = random.uniform()
    noise = random.standard_normal(count)
    walk = np.cumsum(noise) / np.sqrt(count)
    return np.clip(0.5 + roughness * noise / 2 + (1 - roughness) * walk, 0, 1)


@lru_cache
def window_fits(num_coefficients: int, symmetric: bool) -> list[Float[np.ndarray, "p"]]:
    """Windows as splines that a search starts from, the likeliest first."""
    windows = (
        HannShutter(),
        TukeyShutter(0.5),
        RectShutter(),
        TriangleShutter(),
        GaussianShutter(),
        TukeyShutter(0.25),
        TukeyShutter(0.75),
    )
    return fitted_boxes(windows, num_coefficients, symmetric=symmetric)


def lowest_places(losses: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """Places on a grid in order of loss, those first that have no lower neighbour.

    The design before the grid, which has no neighbours, is one of these.
    """
    shape = next(n for n in _GRID_POINTS.values() if math.prod(n) == losses.size - 1)
    on_grid, window = losses[1:].reshape(shape), (3,) * len(shape)
    around = sliding_window_view(np.pad(on_grid, 1, constant_values=np.inf), window)
    over_window = tuple(range(on_grid.ndim, around.ndim))
    # Neighbours of a lowest point lie in its valley, and a polish of them would end where its does.
    in_valley = np.append(True, on_grid <= np.min(around, axis=over_window))
    return np.lexsort((losses, ~in_valley))
