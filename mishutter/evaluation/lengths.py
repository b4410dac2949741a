r"""How far light travels on a motion, and how many taps and frequencies that takes.

On a sensor that turns, light of an object at speed $s$ falls between
$aT^2\max(|\nu| - 1, 0)^2$ and $aT^2(1 + |\nu|)^2$ from the vertex of its path. Objects that
the sensor does not keep up with are displaced by $s^2/4a$ against one another, more than any
camera could record. A single filter gains nothing from two objects so far apart that no
detail reaches from one to the other; there the distance does not matter, and is cut.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import Unquoted, is_concrete, namespace_of, require
from mishutter.model import NUM_FREQUENCIES, AbstractMotion, FreeMotion, Scene, steady, turns

_MAX_LENGTH = 1 << 16
"""Length over which light may fall; px. Longer kernels and responses are refused."""
MAX_COUNT = 1 << 30
_UNKNOWN_REACH = 256.0
_FREQUENCIES_PER_PX = 1.4
"""Frequencies for each px over which light of all speeds falls. What the error is an average of
repeats itself within as many, and its overtones with little light."""
_OF_ONE_SPEED = 2560, 24, 1 << 17
"""Frequencies of a single speed: at least, for each px, and at most by the second. Its response
has zeros, about which the error rises within a fraction of a step. Several speeds have none in
common, as a rule: two need a quarter as many, three a ninth."""
FURTHEST_GAP = 1024.0
"""Distance between the light of two objects from which on pictures do not correlate; px."""
_SAME_SPEED = 4
"""Roundings of the fastest speed within which two speeds are one."""

Numbers = Array | np.ndarray


def distinct_speeds(
    scene: Scene, *, folds: bool, velocity: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Speeds that occur, each once, ascending, with their weights; shapes `(n,)`.

    They are those that a sensor sees that pans at a velocity, px/s.

    Speeds that differ in their last digits alone, as those of a range that is meant to
    mirror itself do, are one.
    """
    speeds, weights = np.asarray(scene.speeds), np.asarray(scene.weights)
    speeds, weights = speeds[weights > 0] - velocity, weights[weights > 0]
    values = np.abs(speeds) if folds else speeds
    order = np.argsort(values, kind="stable")
    values, weights = values[order], weights[order]
    same = _SAME_SPEED * np.finfo(values.dtype).eps * np.max(np.abs(values), initial=0)
    begins = np.diff(values, prepend=-np.inf) > same
    merged = np.bincount(np.cumsum(begins) - 1, weights)
    return values[begins], merged.astype(weights.dtype)


class Alignment(NamedTuple):
    """Light of objects of several speeds, beside that of the slowest.

    Attributes:
        displacement: Distance added to positions from mid-exposure; px, shape `(s, ...)`.
        extent: Length over which the light of all of them falls; px, shape `(1, ...)`.
    """

    displacement: Numbers
    extent: Numbers


def aligned(stroke: Numbers, smear: Numbers) -> Alignment:
    """Alignment of objects at the vertices of their paths, gaps cut to 1,024 px.

    A camera at rest is aligned at mid-exposure.

    Args:
        stroke: Travel of the sensor to either end, $aT^2$; px, shape `(1, ...)`.
        smear: Travel of each object in half the exposure, $sT$; px, shape `(s, ...)`.
    """
    space = namespace_of(smear, stroke)
    moves = turns(stroke)
    quarter = 4 * space.where(moves, stroke, 1.0)
    order = space.argsort(space.abs(smear), axis=0)
    fast = space.take_along_axis(space.abs(smear), order, axis=0)
    # Differences of squares as products: of long displacements the squares leave no digits.
    near, far = space.maximum(fast - 2 * stroke, 0), fast + 2 * stroke
    length = space.where(near > 0, 2 * fast, far * far / quarter)
    before = space.concatenate([space.zeros_like(far[:1]), far[:-1]])
    gap = space.minimum((near - before) * (near + before) / quarter, FURTHEST_GAP)
    begin = space.cumsum(gap + space.concatenate([space.zeros_like(gap[:1]), length[:-1]]), axis=0)
    at_end = begin + fast - stroke
    sorted_displacement = space.where(near > 0, at_end, fast * fast / quarter)
    back = space.argsort(order, axis=0)
    displacement = space.take_along_axis(sorted_displacement, back, axis=0)
    extent = begin[-1:] + length[-1:] - begin[:1]
    return Alignment(
        space.where(moves, displacement, 0.0), space.where(moves, extent, 2 * fast[-1:])
    )


class Extent(NamedTuple):
    """How far light travels on a motion.

    Attributes:
        reach: Length of the longest kernel; px.
        velocity: Its greatest velocity; px per half exposure.
        spread: Length over which light of all speeds falls beside one another; px.
    """

    reach: float
    velocity: float
    spread: float


def extent(scene: Scene, motion: AbstractMotion) -> Extent:
    """How far light of a scene that is known travels on a motion."""
    half = np.asarray(motion.half_exposure, np.float64)
    if isinstance(motion, FreeMotion):
        fastest = float(scene.max_speed)
        speeds = np.array([-fastest, 0.0, fastest])
        reach = float(np.max(motion.highest(speeds) - motion.lowest(speeds)))
        velocity = (float(motion.speed_gain) + fastest) * float(half)
        return Extent(max(reach, 2 * fastest * float(half)), velocity, reach)
    a = np.asarray(steady(motion).acceleration, np.float64)
    stroke = np.asarray(a * half * half)
    reach, velocity = extents(float(scene.max_speed), stroke, half)
    spread = spread_of(occurring_speeds(scene), stroke, half)
    return Extent(*(float(np.max(x)) for x in (reach, velocity, spread)))


def extents(
    max_speed: float, stroke: np.ndarray, half_exposure: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of the longest kernels on some motions, px, and velocities, px per half exposure."""
    smear, moving = max_speed * half_exposure, stroke > 0
    velocity = np.asarray(2 * stroke + smear)
    with np.errstate(over="ignore"):  # a stroke that is hardly one: longer than any kernel
        length = velocity**2 / (4 * np.where(moving, stroke, 1.0))
    return np.asarray(np.maximum(np.where(moving, length, 0.0), 2 * smear)), velocity


def spread_of(speeds: np.ndarray, stroke: np.ndarray, half_exposure: np.ndarray) -> np.ndarray:
    """Length over which light of all speeds falls; px, the shape of `stroke`."""
    smear = speeds.reshape(-1, *(1,) * np.ndim(stroke)) * half_exposure
    with np.errstate(over="ignore"):
        return np.asarray(aligned(stroke[None], smear).extent[0])


def occurring_speeds(scene: Scene) -> np.ndarray:
    """Speeds of some weight, where the weights are known; px/s."""
    speeds = np.asarray(scene.speeds, np.float64)
    return speeds[np.asarray(scene.weights) > 0] if is_concrete(scene.weights) else speeds


def whole_px(length: np.ndarray | float) -> np.ndarray:
    """Whole pixels that hold a length, the same for two ways to compute it."""
    return np.asarray(np.ceil(np.asarray(length) * (1 - 1e-9)))


def num_frequencies(scene: Scene, spread: np.ndarray | float, velocity: float = 0.0) -> np.ndarray:
    """Frequencies over which the mean of the expected error is known to 0.01 dB.

    Args:
        scene: Speeds, and limits within which every motion that keeps up has as many.
        spread: Lengths over which light of all speeds falls on the motions at hand; px, any shape.
        velocity: Velocity of the frame in which it does; px/s.

    Returns:
        Whole numbers of the shape of `spread`.
    """
    num_speeds = scene.speeds.size
    if scene.speeds_known:
        num_speeds = distinct_speeds(scene, folds=True, velocity=velocity)[0].size
    least, per_px, most = (x / num_speeds**2 for x in _OF_ONE_SPEED)
    spread = whole_px(spread)
    fundamental = _FREQUENCIES_PER_PX * np.maximum(spread, longest_within_limits(scene))
    count = np.maximum(np.minimum(per_px * spread, most), fundamental)
    count = np.clip(np.ceil(np.maximum(count, max(NUM_FREQUENCIES, least))), None, MAX_COUNT)
    each, index = np.unique(count, return_inverse=True)
    classes = np.array([size_class(int(x)) for x in each], int)
    return np.asarray(classes[index]).reshape(count.shape)


def frequency_counts() -> list[int]:
    """Every number of frequencies that `num_frequencies` chooses and `require_sizes` passes."""
    counts = [NUM_FREQUENCIES]
    while counts[-1] < _OF_ONE_SPEED[2]:
        counts.append(size_class(counts[-1] + 1))
    return counts


def longest_within_limits(scene: Scene) -> float:
    """Longest kernel of an object that a motion within the limits keeps up with; px."""
    stroke = scene.limits.max_stroke
    return min(4 * float(stroke), _MAX_LENGTH - 1.0) if is_concrete(stroke) else _UNKNOWN_REACH


def too_long(
    num_taps: np.ndarray, num_frequencies: np.ndarray, *, kernels: bool, spectra: bool
) -> np.ndarray:
    """Whether `require_sizes` refuses designs of some sizes; the shape of these."""
    long_kernels = kernels & (num_taps > _MAX_LENGTH)
    return np.asarray(long_kernels | (spectra & (num_frequencies > _OF_ONE_SPEED[2])))


def require_sizes(
    num_taps: int,
    num_frequencies: int,
    *,
    kernels: bool,
    spectra: bool,
    subject: str = "motion",
) -> None:
    """Refuse what takes more than can be computed, as light does that travels too far.

    Args:
        num_taps: Taps of the longest kernel.
        num_frequencies: Frequencies of the expected error.
        kernels: Whether kernels are computed.
        spectra: Whether transfer functions are.
        subject: The argument to blame.

    Raises:
        ValueError: if there are more taps than 65,536, or frequencies than 131,072.
    """
    where = "at the scene's speeds, wherever a search may take it"
    requirement = f"blur over fewer than {_MAX_LENGTH} px {where}"
    require(not kernels or num_taps <= _MAX_LENGTH, subject, requirement, num_taps)
    most = _OF_ONE_SPEED[2]
    furthest = f"spread light over at most {most_spread(most):.0f} px {where}"
    got = Unquoted(f"what takes {num_frequencies} frequencies")
    require(not spectra or num_frequencies <= most, subject, furthest, got)


def spread_of_traced(scene: Scene, motion: AbstractMotion) -> Array:
    """Length over which light of all speeds falls, of which some or the motion are traced; px."""
    speeds, half = jnp.where(scene.weights > 0, scene.speeds, 0), motion.half_exposure
    if isinstance(motion, FreeMotion):
        return jnp.max(jnp.asarray(motion.highest(speeds) - motion.lowest(speeds)))
    stroke = jnp.asarray(steady(motion).acceleration * half * half)
    return aligned(stroke[None], speeds * half).extent[0]


def most_spread(num_frequencies: int) -> float:
    """Length over which light may fall where there are so many frequencies; px."""
    return num_frequencies / _FREQUENCIES_PER_PX


def size_class(count: int) -> int:
    """The least of 1, 2, 3, 4, 6, 8, 12, ... that is at least `count`."""
    octave = 1 << max(0, count - 1).bit_length()
    return octave * 3 // 4 if octave >= 4 and count <= octave * 3 // 4 else octave
