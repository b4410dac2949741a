r"""Positions of objects of several speeds beside one another on the sensor, and their reach.

On a sensor that turns, light of an object at speed $s$ falls between
$aT^2\max(|\nu| - 1, 0)^2$ and $aT^2(1 + |\nu|)^2$ from the vertex of its path. Objects that
the sensor does not keep up with are displaced by $s^2/4a$ against one another, more than any
camera could record. A single filter gains nothing from two objects so far apart that no
detail reaches from one to the other; there the distance does not matter, and is cut.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array

from mishutter._core import namespace_of

FURTHEST_GAP = 1024.0
"""Distance between the light of two objects from which on pictures do not correlate; px."""
_LEAST_SAG = 1e-15
"""Sag down to which a sensor is said to turn, px: powers of less leave the range of 32 bits, and
64 do not tell it from none beside a pixel. It is one number, so that no precision decides."""

Lengths = Array | np.ndarray | np.floating


class Alignment(NamedTuple):
    """Light of objects of several speeds, beside that of the slowest.

    Attributes:
        displacement: Distance added to positions from mid-exposure; px, shape `(s, ...)`.
        extent: Length over which the light of all of them falls; px, shape `(1, ...)`.
    """

    displacement: Lengths
    extent: Lengths


class Reach(NamedTuple):
    """The travel of light on one motion or on several; of any shape.

    Attributes:
        length: Length of the longest kernel; px.
        velocity: Its greatest velocity; px per half exposure.
    """

    length: Lengths
    velocity: Lengths


def turns(sag: Lengths) -> Array | np.ndarray | np.bool_:
    """Whether the sensor's path has a vertex to speak of."""
    return sag > _LEAST_SAG


def aligned(sag: Lengths, smear: Lengths) -> Alignment:
    """Alignment of objects at the vertices of their paths, gaps cut to 1,024 px.

    A camera at rest is aligned at mid-exposure.

    Args:
        sag: Travel of the sensor to either end, $aT^2$; px, shape `(1, ...)`.
        smear: Travel of each object in half the exposure, $sT$; px, shape `(s, ...)`.
    """
    space = namespace_of(smear, sag)
    moves = turns(sag)
    quarter = 4 * space.where(moves, sag, 1.0)
    order = space.argsort(space.abs(smear), axis=0)
    fast = space.take_along_axis(space.abs(smear), order, axis=0)
    # Differences of squares as products: of long displacements the squares leave no digits.
    near, far = space.maximum(fast - 2 * sag, 0), fast + 2 * sag
    length = space.where(near > 0, 2 * fast, far * far / quarter)
    before = space.concatenate([space.zeros_like(far[:1]), far[:-1]])
    gap = space.minimum((near - before) * (near + before) / quarter, FURTHEST_GAP)
    begin = space.cumsum(gap + space.concatenate([space.zeros_like(gap[:1]), length[:-1]]), axis=0)
    at_end = begin + fast - sag
    sorted_displacement = space.where(near > 0, at_end, fast * fast / quarter)
    back = space.argsort(order, axis=0)
    displacement = space.take_along_axis(sorted_displacement, back, axis=0)
    extent = begin[-1:] + length[-1:] - begin[:1]
    return Alignment(
        space.where(moves, displacement, 0.0), space.where(moves, extent, 2 * fast[-1:])
    )


def reach_of_parabola(sag: Lengths, smear: Lengths) -> Reach:
    """The travel of light from objects up to a speed, on parabolas.

    Args:
        sag: Travel of the sensor to either end, $aT^2$; px, any shape.
        smear: Travel of the fastest object in half the exposure, $sT$; px, any shape.
    """
    moving, velocity = sag > 0, np.asarray(2 * sag + smear)
    with np.errstate(over="ignore"):  # a sag that is hardly one: longer than any kernel
        length = velocity**2 / (4 * np.where(moving, sag, 1.0))
    return Reach(np.maximum(np.where(moving, length, 0.0), 2 * smear), velocity)
