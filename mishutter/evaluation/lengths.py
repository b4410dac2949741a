"""How far light travels on a motion, and how many taps and frequencies that takes."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import Bare, is_concrete, require
from mishutter.evaluation.alignment import aligned
from mishutter.evaluation.speeds import distinct_speeds
from mishutter.model import NUM_FREQUENCIES, AbstractMotion, Scene

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
    a, half = (np.asarray(x, np.float64) for x in (motion.acceleration, motion.half_exposure))
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


def num_frequencies(scene: Scene, spread: float) -> int:
    """Frequencies over which the mean of the expected error is known to 0.01 dB.

    Args:
        scene: Speeds, and limits within which every motion that keeps up has as many.
        spread: Length over which light of all speeds falls on the motion at hand; px.
    """
    num_speeds = scene.speeds.size
    if scene.speeds_known:
        num_speeds = distinct_speeds(scene, folds=True)[0].size
    least, per_px, most = (x / num_speeds**2 for x in _OF_ONE_SPEED)
    spread = float(whole_px(spread))
    fundamental = _FREQUENCIES_PER_PX * max(spread, longest_within_limits(scene))
    count = max(NUM_FREQUENCIES, least, min(per_px * spread, most), fundamental)
    return size_class(int(np.ceil(min(count, MAX_COUNT))))


def longest_within_limits(scene: Scene) -> float:
    """Longest kernel of an object that a motion within the limits keeps up with; px."""
    stroke = scene.limits.max_stroke
    return min(4 * float(stroke), _MAX_LENGTH - 1.0) if is_concrete(stroke) else _UNKNOWN_REACH


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
    got = Bare(f"what takes {num_frequencies} frequencies")
    require(not spectra or num_frequencies <= most, subject, furthest, got)


def spread_of_traced(scene: Scene, motion: AbstractMotion) -> Array:
    """Length over which light of all speeds falls, of which some or the motion are traced; px."""
    half = motion.half_exposure
    smear = jnp.where(scene.weights > 0, scene.speeds, 0) * half
    return aligned(jnp.asarray(motion.acceleration * half * half)[None], smear).extent[0]


def most_spread(num_frequencies: int) -> float:
    """Length over which light may fall where there are so many frequencies; px."""
    return num_frequencies / _FREQUENCIES_PER_PX


def size_class(count: int) -> int:
    """The least of 1, 2, 3, 4, 6, 8, 12, ... that is at least `count`."""
    octave = 1 << max(0, count - 1).bit_length()
    return octave * 3 // 4 if octave >= 4 and count <= octave * 3 // 4 else octave
