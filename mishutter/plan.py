"""What a scene needs computed: sizes now, chosen once and shared by every consumer."""

from dataclasses import astuple, dataclass

import jax
import numpy as np

from mishutter.kernel import support
from mishutter.motion import AbstractMotion
from mishutter.scene import Scene
from mishutter.shutters import (
    AbstractShutter,
    GaussianShutter,
    HannShutter,
    RectShutter,
    SplineShutter,
    TriangleShutter,
    TukeyShutter,
)
from mishutter.types import is_concrete

NUM_FREQUENCIES = 256
_PHASE_PER_NODE = 1.8
_SPARE_NODES = 12
_MAX_TAPS = 1 << 14
_UNKNOWN_REACH = 256.0
_SYMMETRIC_WINDOWS = (RectShutter, HannShutter, TriangleShutter, GaussianShutter, TukeyShutter)


@dataclass(frozen=True)
class Plan:
    """Sizes of a computation; static, hashable.

    Attributes:
        num_taps: Taps of a blur kernel.
        dft_length: Length of the DFT that the condition number is taken over.
        num_frequencies: Frequencies in (0, 0.5) cycles/px of the expected error.
        num_nodes: Nodes over the whole exposure for the transfer functions there.
    """

    num_taps: int
    dft_length: int
    num_frequencies: int
    num_nodes: int


def sizes(scene: Scene, motion: AbstractMotion) -> Plan:
    """Sizes that hold the scene on this motion and on every motion within its limits.

    One size for all of them makes designs comparable (the condition number depends on
    the DFT length) and lets them share one compiled program. Where the numbers are being
    traced they are not known, and a kernel of up to 256 px is provided for.
    """
    leaves = jax.tree.leaves((scene.speeds, scene.limits.max_stroke, motion))
    if not all(is_concrete(leaf) for leaf in leaves):
        return sized_for(_UNKNOWN_REACH, _UNKNOWN_REACH)
    longest = 4 * float(scene.limits.max_stroke)
    reach = float(np.max(support(motion, scene.max_speed)))
    smear = float(np.max(scene.max_speed * motion.half_exposure))
    velocity = 2 * float(np.max(motion.stroke)) + smear
    return sized_for(max(reach, 2 * smear, longest), max(velocity, longest))


def larger(first: Plan, second: Plan) -> Plan:
    """Sizes that hold what either holds."""
    return Plan(*(max(pair) for pair in zip(astuple(first), astuple(second), strict=True)))


def sized_for(reach: float, velocity: float) -> Plan:
    """Sizes for kernels of `reach` px on paths of at most `velocity` px per half exposure."""
    num_taps = min(_rounded_up(reach + 1), _MAX_TAPS)
    phase = 2 * np.pi * 0.5 * 2 * velocity
    num_nodes = _rounded_up(phase / _PHASE_PER_NODE + 4 * _SPARE_NODES)
    return Plan(num_taps, dft_length(num_taps), NUM_FREQUENCIES, min(num_nodes, 1 << 16))


def needed_speeds(scene: Scene, shutter: AbstractShutter) -> Scene:
    """The scene with every speed once, none that never occurs, and no picture or motion.

    A symmetric shutter has one kernel for `+s` and `-s`, and these are folded. Nothing
    that is computed of the scene changes but by rounding.
    """
    if not (is_concrete(scene.speeds) and is_concrete(scene.weights)):
        return scene.bare()
    speeds, weights = np.asarray(scene.speeds), np.asarray(scene.weights)
    speeds, weights = speeds[weights > 0], weights[weights > 0]
    if is_symmetric(shutter):
        speeds = np.abs(speeds)
    distinct, index = np.unique(speeds, return_inverse=True)
    merged = np.bincount(index, weights).astype(weights.dtype)
    return scene.bare(speeds=distinct, weights=merged)


def is_symmetric(shutter: AbstractShutter) -> bool:
    """Whether `w(-tau) = w(tau)` is known of a shutter."""
    if isinstance(shutter, SplineShutter):
        return shutter.symmetric
    return isinstance(shutter, _SYMMETRIC_WINDOWS)


def dft_length(num_taps: int) -> int:
    """Smallest power of two of at least four times the taps, and at least 256."""
    return max(256, 1 << (4 * num_taps - 1).bit_length())


def _rounded_up(count: float) -> int:
    """Round up to one of four sizes an octave, so that near scenes share a program."""
    count = max(16, int(np.ceil(count)))
    step = max(4, 1 << (count.bit_length() - 3))
    return -(-count // step) * step
