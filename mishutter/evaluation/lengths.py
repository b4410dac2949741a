"""Travel of a scene's light on a motion, and the numbers of taps and frequencies for it."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from mishutter._core import Unquoted, is_concrete, require
from mishutter.model import NUM_FREQUENCIES, AbstractMotion, Scene

_MAX_LENGTH = 1 << 16
"""Longest kernel, px."""
MAX_COUNT = 1 << 30
_UNKNOWN_REACH = 256.0
_FREQUENCIES_PER_PX = 1.4
"""Frequencies for each px over which light of all speeds falls. The error is periodic in frequency
with about the inverse of this length as its period; its overtones are weak."""
_OF_ONE_SPEED = 2560, 24, 1 << 17
"""Frequencies of a single speed: at least, for each px, and at most. Its response has zeros, about
which the error rises within a fraction of a step. Several speeds have no zeros in common, as a
rule: two need a quarter as many, three a ninth."""
_SAME_SPEED = 4
"""Difference, in roundings of the fastest speed, within which two speeds are one."""


def distinct_speeds(
    scene: Scene, *, folds: bool, velocity: float = 0.0
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Speeds that occur, each once, ascending, px/s, with their weights.

    Speeds that differ in their last digits alone are one: a range that is meant to mirror itself
    has such speeds.

    Args:
        scene: The scene, concrete.
        folds: Whether `+s` and `-s` are one speed.
        velocity: Velocity of the frame that the speeds are seen from; px/s.
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


class Extent(NamedTuple):
    """Travel of light on a motion.

    Attributes:
        reach: Length of the longest kernel; px.
        velocity: Its greatest velocity; px per half exposure.
        spread: Length over which light of all speeds falls beside one another; px.
    """

    reach: float
    velocity: float
    spread: float


def extent(scene: Scene, motion: AbstractMotion) -> Extent:
    """Travel of the light of a concrete scene on a motion."""
    reach = motion.reach(float(scene.max_speed))
    spread = np.asarray(motion.side_by_side(occurring_speeds(scene)).extent)
    return Extent(float(reach.length), float(reach.velocity), float(spread[0]))


def occurring_speeds(scene: Scene) -> Float[np.ndarray, "n"]:
    """Speeds of some weight, or all where the weights are traced; px/s."""
    speeds = np.asarray(scene.speeds, np.float64)
    return speeds[np.asarray(scene.weights) > 0] if is_concrete(scene.weights) else speeds


def whole_px(length: Float[np.ndarray, "*shape"] | float) -> Float[np.ndarray, "*shape"]:
    """Whole pixels that hold a length, whatever its rounding."""
    return np.asarray(np.ceil(np.asarray(length) * (1 - 1e-9)))


def num_frequencies(
    scene: Scene, spread: Float[np.ndarray, "*shape"] | float, velocity: float = 0.0
) -> Int[np.ndarray, "*shape"]:
    """Number of frequencies whose mean is the expected error to 0.01 dB.

    Args:
        scene: Speeds, and limits: every motion within them that keeps up has this number at least.
        spread: Lengths over which light of all speeds falls; px, any shape.
        velocity: Velocity of the frame of these lengths; px/s.
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
    num_taps: Int[np.ndarray, "*shape"],
    num_frequencies: Int[np.ndarray, "*shape"],
    *,
    kernels: bool,
    spectra: bool,
) -> Bool[np.ndarray, "*shape"]:
    """Whether `require_sizes` refuses designs of some sizes."""
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
    """Refuses designs whose light travels too far for a computation.

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


def spread_of_traced(scene: Scene, motion: AbstractMotion) -> Float[Array, ""]:
    """Length over which light of all speeds falls, for traced speeds or a traced motion; px."""
    speeds = jnp.where(scene.weights > 0, scene.speeds, 0)
    return jnp.asarray(motion.side_by_side(speeds).extent)[0]


def most_spread(num_frequencies: int) -> float:
    """Length over which light may fall for a number of frequencies; px."""
    return num_frequencies / _FREQUENCIES_PER_PX


def size_class(count: int) -> int:
    """The least of 1, 2, 3, 4, 6, 8, 12, ... that is at least `count`."""
    octave = 1 << max(0, count - 1).bit_length()
    return octave * 3 // 4 if octave >= 4 and count <= octave * 3 // 4 else octave
