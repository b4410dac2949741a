r"""Places of objects on the sensor of a parabola, and the reach of their light.

Beside the pan an object that smears by $m = sT$ in half the exposure lies at $B\tau^2 - m\tau$,
$B = aT^2$. Where $|m| < 2|B|$ the path turns within the exposure, at its vertex; elsewhere it is
lowest and highest at the ends.

A decoder that knows no speed places every object where the sensor is nearest to keeping pace with
it: at the vertex, or at the end of the exposure that is nearest to one beyond. Kernels of objects
that the sensor does not keep up with then begin where those of all others do. Of one place for each
speed this is the best that follows from the path alone: `benchmarks/alignment.py` weighs others.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array

from mishutter._core.checks import namespace_of

_LEAST_SAG = 1e-15
"""Sag down to which a sensor is said to turn, px: powers of less leave the range of 32 bits, and
64 do not tell it from none beside a pixel. It is one number, so that no precision decides."""

Lengths = Array | np.ndarray | np.floating


class Reach(NamedTuple):
    """The travel of light on one motion or on several; of any shape."""

    length: Lengths  # Length of the longest kernel; px
    velocity: Lengths  # Its greatest velocity; px per half exposure


def turns(sag: Lengths) -> Array | np.ndarray | np.bool_:
    """Whether the sensor's path has a vertex to speak of."""
    return sag > _LEAST_SAG


def _turned(sag: Lengths, size: Lengths) -> Array | np.ndarray | np.bool_:
    """Whether a path turns within the exposure, by a sag whose square, in slopes, is no 0."""
    return turns(sag) & (size < 2 * sag)


def lowest_on_parabola(sag: Lengths, smear: Lengths) -> Lengths:
    """Lowest place of objects during the exposure, from that at mid-exposure; px."""
    space, size = namespace_of(sag, smear), abs(smear)
    turned = _turned(sag, size)
    safe = space.where(turned, sag, 1.0)
    return space.where(turned, -size * (size / (4 * safe)), sag - size)


def above_alignment(sag: Lengths, smear: Lengths, tau: Lengths) -> Lengths:
    r"""Place of objects on a parabola, from its lowest, or its highest if mirrored; px.

    $B(\tau - m/2B)^2$ from a vertex within the exposure, and
    $(1 \mp \tau)(|m| - |B|(1 \pm \tau))$, of the sign of $B$, from an end: no difference cancels.
    """
    space, size, depth = namespace_of(sag, smear, tau), abs(smear), abs(sag)
    turned = _turned(depth, size)
    safe = space.where(turned, sag, 1.0)
    side = space.where((smear < 0) == (sag < 0), tau, -tau)
    beyond = (1 - side) * (size - depth * (1 + side))
    beyond = space.where(sag < 0, -beyond, beyond)
    return space.where(turned, safe * (tau - smear / (2 * safe)) ** 2, beyond)


def length_on_parabola(sag: Lengths, smear: Lengths) -> Lengths:
    """Distance from the lowest to the highest place of objects; px."""
    space, size, depth = namespace_of(sag, smear), abs(smear), abs(sag)
    turned = _turned(depth, size)
    safe = space.where(turned, depth, 1.0)
    far = size + 2 * safe
    return space.where(turned, far * (far / (4 * safe)), 2 * size)


def reach_of_parabola(sag: Lengths, smear: Lengths) -> Reach:
    """The travel of light from objects up to a speed, on parabolas."""
    return Reach(length_on_parabola(sag, smear), 2 * abs(sag) + smear)
