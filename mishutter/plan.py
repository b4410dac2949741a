"""What a scene needs computed: sizes now, chosen once and shared by every consumer."""

from dataclasses import dataclass

import jax
import numpy as np

from mishutter.kernel import support
from mishutter.motion import AbstractMotion
from mishutter.scene import Scene
from mishutter.types import is_concrete

NUM_FREQUENCIES = 256
_PHASE_PER_NODE = 1.8
_SPARE_NODES = 12
_MAX_TAPS = 1 << 14
_UNKNOWN_REACH = 256.0


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
    """Sizes that hold every speed of the scene on this motion.

    Where the numbers are being traced they are not known, and a kernel of up to 256 px
    is provided for.
    """
    leaves = jax.tree.leaves((scene.speeds, motion))
    if not all(is_concrete(leaf) for leaf in leaves):
        return sized_for(_UNKNOWN_REACH, _UNKNOWN_REACH)
    reach = float(np.max(support(motion, scene.max_speed)))
    smear = 2 * float(np.max(scene.max_speed * motion.half_exposure))
    return sized_for(max(reach, smear), float(np.max(motion.stroke)) + smear / 2)


def sized_for(reach: float, travel: float) -> Plan:
    """Sizes for kernels that reach `reach` px along paths of `travel` px from mid-exposure."""
    num_taps = min(_rounded_up(reach + 1), _MAX_TAPS)
    top_rate = 2 * np.pi * 0.5 * 2 * travel
    num_nodes = _rounded_up(2 * top_rate / _PHASE_PER_NODE + 4 * _SPARE_NODES)
    return Plan(num_taps, dft_length(num_taps), NUM_FREQUENCIES, min(num_nodes, 1 << 16))


def dft_length(num_taps: int) -> int:
    """Smallest power of two of at least four times the taps, and at least 256."""
    return max(256, 1 << (4 * num_taps - 1).bit_length())


def _rounded_up(count: float) -> int:
    """Round up to one of four sizes an octave, so that near scenes share a program."""
    count = max(16, int(np.ceil(count)))
    step = max(4, 1 << (count.bit_length() - 3))
    return -(-count // step) * step
