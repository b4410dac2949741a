r"""Designs that cover the valleys of a loss, and the lowest of each valley.

The light of an object of speed $s$ adds up where the sensor keeps up with it, at
$t_s = (s - v)/(2a)$ (stationary phase). So a good profile is open about $t_s$ for some of the
speeds and shut elsewhere. Valleys differ by which speeds these are, by how wide it is open,
and by where the motion puts the openings among the spline's knots. A sensor that keeps up with few
of the speeds, as on a short stroke, sees the rest pass by: a good profile is a code then, and opens
several times over the exposure.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import compiled, in_threads, num_processors
from mishutter.model import Scene, SplineShutter, coefficient_times
from mishutter.search.objective import AbstractObjective
from mishutter.search.space import DesignSpace

_PER_COORDINATE = 3
"""Candidates that are open for speeds, for a start, and as many times more for each coordinate of
the motion."""
_MOST = 4096
"""Candidates that are open for speeds at most, where there are not more starts."""
_CODES_PER_START = 9
"""Candidates that are codes, for a start: they pay where a motion is held that is a poor one."""
_NUMBERS_OF_A_PROFILE = 4
"""Numbers that say which speeds a profile is open for, how wide and how softly; or of a code how
often it opens, when, for how long and how softly."""
_COEFFICIENTS_A_WAVE = 4
"""Coordinates of a profile for each opening of the quickest code."""
_SOFTEST = 0.5
"""Half the rise of the softest edge of a code, as a share of its wave's amplitude."""
_NUM_QUANTILES = 16
"""Speeds that stand for all: the arrays of a thousand speeds would not fit."""
_LEAST_BLUR = 0.5
"""Blur in the narrowest opening; px."""
_AT_ONCE = 64


def cover(space: DesignSpace, scene: Scene, num_starts: int, seed: int) -> np.ndarray:
    """Candidates for so many starts, spread evenly over motions and profiles; `(n, size)`.

    The last are codes, the others open for speeds.
    """
    count = space.num_profile_coordinates
    num_motion = space.size - count
    wanted = num_starts * _PER_COORDINATE ** (1 + num_motion)
    num_open, num_codes = max(num_starts, min(_MOST, wanted)), num_starts * _CODES_PER_START
    points = _sequence(num_open + num_codes, num_motion + _NUMBERS_OF_A_PROFILE, seed)
    numbers = points[:, num_motion:]
    boxes = np.full((len(points), space.size), 0.5)
    boxes[:, count:] = points[:, :num_motion]
    boxes[:num_open, :count] = _openings(space, scene, boxes[:num_open], numbers[:num_open])
    boxes[num_open:, :count] = _codes(space, numbers[num_open:])
    return boxes


def _sequence(num_points: int, num_coordinates: int, seed: int) -> np.ndarray:
    r"""Additive recurrence in the unit box, shifted at random; `(num_points, num_coordinates)`.

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
    space: DesignSpace, scene: Scene, boxes: np.ndarray, numbers: np.ndarray
) -> np.ndarray:
    """Profiles that are open about the times of some speeds; shape `(n, p)`.

    Args:
        space: The design space.
        scene: Its speeds.
        boxes: The motions, with any profile; shape `(n, size)`.
        numbers: Of each profile the slowest and the fastest share of the speeds, the width
            and the softness, in the unit box; shape `(n, 4)`.
    """
    spline: SplineShutter = space.shutter  # type: ignore[assignment]
    stroke, gain, velocity = (np.asarray(x)[:, None] for x in _strokes(space, boxes))
    speeds, share = _quantiles(scene), (np.arange(_NUM_QUANTILES) + 0.5) / _NUM_QUANTILES
    first, last, width, softness = numbers.T[..., None]
    low, high = np.minimum(first, last), np.maximum(first, last)
    nearest = np.abs(share - low) <= np.min(np.abs(share - low), axis=1, keepdims=True)
    chosen = ((share >= low) & (share <= high)) | nearest
    chosen[::2] = True
    # A sensor at rest keeps up with nothing, so one opening lies anywhere.
    moves = gain > 0
    times = np.where(moves, (speeds - velocity) / np.where(moves, gain, 1.0), 2 * first - 1)
    spacing = 2 / spline.num_coefficients
    narrowest = np.clip(np.sqrt(_LEAST_BLUR / np.maximum(stroke, _LEAST_BLUR)), spacing / 2, 1)
    half_width = narrowest * (2 / narrowest) ** (width**1.5)
    ramp = np.maximum(spacing, softness * half_width)
    middles = coefficient_times(spline.num_coefficients)[: space.num_profile_coordinates]
    profiles = np.zeros((len(boxes), middles.size))
    for sign in (1, -1)[: 1 + spline.symmetric]:
        away = np.abs(sign * middles[None, :, None] - times[:, None, :])
        distance = np.min(np.where(chosen[:, None, :], away, np.inf), axis=2)
        profiles = np.maximum(profiles, np.clip(0.5 + (half_width - distance) / ramp, 0, 1))
    return profiles


def _codes(space: DesignSpace, numbers: np.ndarray) -> np.ndarray:
    """Profiles that are open wherever a wave is above a level; shape `(n, p)`.

    Args:
        space: The design space.
        numbers: Of each profile the share of the most waves that fit in the exposure, or in half
            of it where it is symmetric; their place, the share that is open and the softness, in
            the unit box; shape `(n, 4)`.
    """
    spline: SplineShutter = space.shutter  # type: ignore[assignment]
    count = space.num_profile_coordinates
    middles = coefficient_times(spline.num_coefficients)[:count]
    share = np.abs(middles) if spline.symmetric else (middles + 1) / 2
    waves, place, lit, softness = numbers.T[..., None]
    wave = np.cos(2 * np.pi * (waves * (count / _COEFFICIENTS_A_WAVE) * share + place))
    ramp = np.maximum(_SOFTEST * softness, np.finfo(float).tiny)
    return np.clip(0.5 + (wave - np.cos(np.pi * lit)) / (2 * ramp), 0, 1)


@compiled
def _strokes(space: DesignSpace, boxes: Array | np.ndarray) -> tuple[Array, Array, Array]:
    """Stroke, px, gain of speed and velocity, px/s, of motions; shape `(n,)` each."""

    def one(box: Array) -> tuple[Array, Array, Array]:
        _, motion = space.at(box)
        return motion.stroke, motion.speed_gain, motion.velocity

    return jax.vmap(one)(jnp.asarray(boxes, space.dtype))


def _quantiles(scene: Scene) -> np.ndarray:
    """Speeds that stand for equal shares of all that occur; px/s."""
    order = np.argsort(np.asarray(scene.speeds))
    speeds, weights = np.asarray(scene.speeds)[order], np.asarray(scene.weights)[order]
    share = (np.arange(_NUM_QUANTILES) + 0.5) / _NUM_QUANTILES
    place = np.searchsorted(np.cumsum(weights) / np.sum(weights), share)
    return speeds[np.minimum(place, speeds.size - 1)]


def screened(objective: AbstractObjective, boxes: np.ndarray) -> np.ndarray:
    """Losses of many points, infinite where they are not finite; shape `(n,)`."""
    num_parts = -(-len(boxes) // _AT_ONCE)
    parts = np.resize(boxes, (num_parts, _AT_ONCE, boxes.shape[1]))
    calls = in_threads(lambda part: np.asarray(_losses(objective, part)), parts, num_processors())
    losses = np.concatenate(list(calls))[: len(boxes)]
    return np.where(np.isfinite(losses), losses, np.inf)


@compiled
def _losses(objective: AbstractObjective, boxes: Array | np.ndarray) -> Array:
    points = jnp.asarray(boxes)
    return jax.vmap(objective)(points) if objective.batches else jax.lax.map(objective, points)


def lowest_of_valleys(
    boxes: np.ndarray, losses: np.ndarray, num_profile_coordinates: int, num_wanted: int
) -> np.ndarray:
    """Places, among the better half, of those farthest from any that is better.

    The best alone would all lie in one valley (density peaks: Rodriguez and Laio, 2014). A
    profile counts as much as one coordinate of the motion.
    """
    order = np.argsort(losses, kind="stable")[: max(num_wanted, (len(boxes) + 1) // 2)]
    points = boxes[order]
    points[:, :num_profile_coordinates] /= np.sqrt(max(num_profile_coordinates, 1))
    away = np.full(len(order), np.inf)
    for place in range(1, len(order)):
        away[place] = np.min(np.sum((points[:place] - points[place]) ** 2, axis=1))
    return order[np.argsort(-away, kind="stable")[:num_wanted]]
