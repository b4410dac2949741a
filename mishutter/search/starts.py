r"""Starts of a search: baselines' profiles and random ones, a grid of few coordinates, or a cover.

A cover holds designs in all valleys of a loss. The light of an object of speed $s$ adds up where
the sensor keeps up with it, at $t_s = (s - v)/(2a)$ (stationary phase). So a good profile is open
about $t_s$ for some of the speeds and shut elsewhere. Valleys differ by these speeds, by the width
of the openings, and by the places of the openings among the spline's knots, which depend on the
motion. A sensor that keeps up with few of the speeds, as on a short stroke, lets the others pass
by: a good profile is then a code, and opens several times over the exposure.
"""

import math
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.lib.stride_tricks import sliding_window_view

from mishutter._core.compiling import compiled
from mishutter._core.parallel import in_threads, num_processors
from mishutter.model.motion import AbstractMotion, simplified
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractShutter, coordinates
from mishutter.model.shutters.spline import SplineShutter, coefficient_times, fitted_boxes
from mishutter.model.shutters.windows import (
    GaussianShutter,
    HannShutter,
    RectShutter,
    TriangleShutter,
    TukeyShutter,
)
from mishutter.search.objective import AbstractObjective
from mishutter.search.space import DesignSpace

GRID_COORDINATES = 4
"""Number of coordinates up to which a search begins on a grid."""
_GRID_POINTS = {1: (17,), 2: (5, 9), 3: (4, 5, 7), 4: (4, 4, 3, 7)}
"""Points along each coordinate, ends included, as many a best design lies at one: most along
the last, the acceleration, over which a condition number rises and falls with every pixel."""
_NUM_QUANTILES = 16
"""Speeds that stand for all: arrays for a thousand speeds would not fit into memory."""
POINTS_AT_ONCE = 64
"""Points that one call measures."""


def start_boxes(space: DesignSpace, num_starts: int, seed: int) -> Float[np.ndarray, "n size"]:
    """Points to descend from; `n = num_starts` above four coordinates.

    The design of the space comes first, then the baselines' profiles and random ones, at its
    motion and at random motions by turns.
    """
    first = point_at(space, space.shutter, space.motion)
    if first.size <= GRID_COORDINATES:
        axes = [np.linspace(0, 1, points) for points in _GRID_POINTS[first.size]]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, first.size)
        return np.concatenate([first[None], grid.astype(first.dtype)])
    count = space.num_profile_coordinates
    shutter, profiles = space.shutter, []
    if count and isinstance(shutter, SplineShutter):
        profiles = window_fits(shutter.num_coefficients, shutter.symmetric)
    random = np.random.default_rng(seed)
    boxes = np.tile(first, (num_starts, 1))
    for index in range(1, num_starts):
        if count and index <= len(profiles):
            boxes[index, :count] = profiles[index - 1]
        elif count:
            # White noise and a random walk about one half, mixed: profiles of every roughness.
            roughness = random.uniform()
            noise = random.standard_normal(count)
            walk = np.cumsum(noise) / np.sqrt(count)
            profile = 0.5 + roughness * noise / 2 + (1 - roughness) * walk
            boxes[index, :count] = np.clip(profile, 0, 1)
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


_point_at, _coordinates = compiled(DesignSpace.point_of), compiled(coordinates)


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


def cover(
    space: DesignSpace, scene: Scene, num_starts: int, seed: int
) -> Float[np.ndarray, "n size"]:
    """Candidates for a number of starts, spread evenly over motions and profiles.

    The last are codes, the others open for speeds.
    """
    count = space.num_profile_coordinates
    num_motion = space.size - count
    num_open = max(num_starts, min(4096, num_starts * 3 ** (1 + num_motion)))
    num_codes = num_starts * 9  # they pay where a poor motion is fixed
    points = _sequence(num_open + num_codes, num_motion + 4, seed)
    numbers = points[:, num_motion:]
    boxes = np.full((len(points), space.size), 0.5)
    boxes[:, count:] = points[:, :num_motion]
    boxes[:num_open, :count] = _openings(space, scene, boxes[:num_open], numbers[:num_open])
    boxes[num_open:, :count] = _codes(space, numbers[num_open:])
    return boxes


def _sequence(
    num_points: int, num_coordinates: int, seed: int
) -> Float[np.ndarray, "{num_points} {num_coordinates}"]:
    r"""Additive recurrence in the unit box, shifted at random.

    Its steps are powers of the root of $x^{d+1} = x + 1$, which spread any number of points
    evenly over $d$ coordinates (M. Roberts, 2018).
    """
    root = 2.0
    for _ in range(64):
        root = (1 + root) ** (1 / (num_coordinates + 1))
    steps = root ** -np.arange(1.0, num_coordinates + 1)
    shift = np.random.default_rng(seed).uniform(size=num_coordinates)
    return (shift + np.arange(1, num_points + 1)[:, None] * steps) % 1


def _openings(
    space: DesignSpace,
    scene: Scene,
    boxes: Float[np.ndarray, "n size"],
    numbers: Float[np.ndarray, "n 4"],
) -> Float[np.ndarray, "n p"]:
    """Profiles that open for a range of speeds: its two ends as shares, width and softness."""
    spline: SplineShutter = space.shutter  # type: ignore[assignment]
    sag, gain, velocity = (np.asarray(x)[:, None] for x in _numbers_of_motion(space, boxes))
    speeds, share = quantiles(scene), (np.arange(_NUM_QUANTILES) + 0.5) / _NUM_QUANTILES
    first, last, width, softness = numbers.T[..., None]
    low, high = np.minimum(first, last), np.maximum(first, last)
    nearest = np.abs(share - low) <= np.min(np.abs(share - low), axis=1, keepdims=True)
    has_opening = ((share >= low) & (share <= high)) | nearest
    # Every other profile opens for all speeds, which two numbers of the sequence hardly ever span.
    has_opening[::2] = True
    # A sensor at rest keeps up with no object, so its one opening may lie anywhere.
    moves = gain > 0
    times = np.where(moves, (speeds - velocity) / np.where(moves, gain, 1.0), 2 * first - 1)
    spacing = 2 / spline.num_coefficients
    # For so long the sensor keeps up within a blur of half a pixel: a shorter opening would only
    # lose light.
    narrowest = np.clip(np.sqrt(0.5 / np.maximum(sag, 0.5)), spacing / 2, 1)
    # The scale is logarithmic up to the whole exposure, and has more of narrow openings.
    half_width = narrowest * (2 / narrowest) ** (width**1.5)
    # A spline does not rise within less than the distance of its knots.
    ramp = np.maximum(spacing, softness * half_width)
    middles = coefficient_times(spline.num_coefficients)[: space.num_profile_coordinates]
    profiles = np.zeros((len(boxes), middles.size))
    # A symmetric profile that opens for a speed opens for the opposite one.
    for sign in (1, -1)[: 1 + spline.symmetric]:
        away = np.abs(sign * middles[None, :, None] - times[:, None, :])
        distance = np.min(np.where(has_opening[:, None, :], away, np.inf), axis=2)
        profiles = np.maximum(profiles, np.clip(0.5 + (half_width - distance) / ramp, 0, 1))
    return profiles


def _codes(space: DesignSpace, numbers: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n p"]:
    """Profiles that are open wherever a wave is above a level.

    Their numbers are those of openings, their place, the open share and the softness.
    """
    spline: SplineShutter = space.shutter  # type: ignore[assignment]
    count = space.num_profile_coordinates
    middles = coefficient_times(spline.num_coefficients)[:count]
    share = np.abs(middles) if spline.symmetric else (middles + 1) / 2
    waves, place, open_share, softness = numbers.T[..., None]
    # The quickest code has four coordinates to an opening. The wave is above $\cos(\pi p)$ for a
    # share $p$ of the time, and the softest edge rises over its amplitude.
    wave = np.cos(2 * np.pi * (waves * (count / 4) * share + place))
    ramp = np.maximum(0.5 * softness, np.finfo(float).tiny)
    return np.clip(0.5 + (wave - np.cos(np.pi * open_share)) / (2 * ramp), 0, 1)


@compiled
def _numbers_of_motion(
    space: DesignSpace, boxes: Float[Array | np.ndarray, "n size"]
) -> tuple[Float[Array, "n"], ...]:
    """Sag, px, gain of speed and velocity, px/s, of motions."""

    def one(point: Float[Array, "size"]) -> tuple[Array, ...]:
        _, motion = space.at(point)
        return motion.sag, motion.speed_gain, motion.velocity

    return jax.vmap(one)(jnp.asarray(boxes, space.dtype))


def quantiles(scene: Scene) -> Float[np.ndarray, "q"]:
    """Speeds that stand for equal shares of all that occur; px/s."""
    order = np.argsort(np.asarray(scene.speeds))
    speeds, weights = np.asarray(scene.speeds)[order], np.asarray(scene.weights)[order]
    share = (np.arange(_NUM_QUANTILES) + 0.5) / _NUM_QUANTILES
    place = np.searchsorted(np.cumsum(weights) / np.sum(weights), share)
    return speeds[np.minimum(place, speeds.size - 1)]


def screened(
    objective: AbstractObjective, boxes: Float[np.ndarray, "n size"]
) -> Float[np.ndarray, "n"]:
    """Losses at many points, infinite where they are not finite."""
    num_parts = -(-len(boxes) // POINTS_AT_ONCE)
    # The last part repeats points, so that one compiled program serves any number of them.
    parts = np.resize(boxes, (num_parts, POINTS_AT_ONCE, boxes.shape[1]))
    calls = in_threads(lambda part: np.asarray(_losses(objective, part)), parts, num_processors())
    losses = np.concatenate(list(calls))[: len(boxes)]
    return np.where(np.isfinite(losses), losses, np.inf)


@compiled
def _losses(
    objective: AbstractObjective, boxes: Float[Array | np.ndarray, "n size"]
) -> Float[Array, "n"]:
    points = jnp.asarray(boxes)
    return jax.vmap(objective)(points) if objective.batches else jax.lax.map(objective, points)


def lowest_of_valleys(
    boxes: Float[np.ndarray, "n size"],
    losses: Float[np.ndarray, "n"],
    num_profile_coordinates: int,
    num_valleys: int,
) -> Int[np.ndarray, "k"]:
    """Indices of the points, among the better half, that lie farthest from every better one.

    The lowest points alone would all lie in one valley (density peaks: Rodriguez and Laio, 2014). A
    profile counts as much as one coordinate of the motion.
    """
    order = np.argsort(losses, kind="stable")[: max(num_valleys, (len(boxes) + 1) // 2)]
    points = boxes[order]
    points[:, :num_profile_coordinates] /= np.sqrt(max(num_profile_coordinates, 1))
    away = np.full(len(order), np.inf)
    for place in range(1, len(order)):
        away[place] = np.min(np.sum((points[:place] - points[place]) ** 2, axis=1))
    return order[np.argsort(-away, kind="stable")[:num_valleys]]
