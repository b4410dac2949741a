r"""Places of objects on the sensor: along pieces of a path, and in closed form on a parabola.

On a piece of constant acceleration a point is at $x = X + Uh + Ah^2$, in normalised time
$\tau = t/T$: $A = aT^2$ is the sag, $U$ the velocity (px per half exposure) and $X$ the position
at a base from which $h$ counts. Where $U$ changes its sign within the piece the path turns there,
at its vertex $X - U^2/4A$. Bases are the times nearest to mid-exposure, so that nothing cancels: a
parabola counts from mid-exposure itself, with $X = 0$ and $U = -m$ beside the pan for an object
that smears by $m = sT$ in half the exposure.

A decoder that knows no speed places every object where the sensor is nearest to keeping pace with
it: at the vertex, or at the end of the exposure that is nearest to one beyond. Kernels of objects
that the sensor does not keep up with then begin where those of all others do. Of one place for each
speed this is the best that follows from the path alone: `benchmarks/alignment.py` weighs others.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core.checks import Numbers, namespace_of
from mishutter._core.slopes import magnitude

_LEAST_SAG = 1e-15
"""Sag down to which a sensor is said to turn, px: powers of less leave the range of 32 bits, and
64 do not tell it from none beside a pixel. It is one number, so that no precision decides."""

Lengths = Array | np.ndarray | np.floating
"""Lengths, of one path or of many; of any shape."""


class PathPieces(NamedTuple):
    """Pieces of constant acceleration of the path of points over the sensor; `(..., pieces)`."""

    sag: Numbers  # A, px
    velocity: Numbers  # U, px per half exposure, at the base
    position: Numbers  # X, px from mid-exposure, at the base
    base: np.ndarray  # the time nearest to mid-exposure, in units of T
    begin: np.ndarray
    end: np.ndarray
    travel: Numbers  # from mid-exposure to the base, px, at most

    @property
    def is_at_rest(self) -> Any:
        """Whether the point moves less than positions are rounded by, or powers of it underflow."""
        length, precision = self.end - self.begin, jnp.finfo(self.sag.dtype)
        least = precision.tiny**0.25 + 4 * precision.eps * self.travel
        return (abs(self.sag) * length + abs(self.velocity)) * length < least

    def vertex(self, turns: Numbers) -> tuple[Numbers, Numbers]:
        """Time from the base to the vertex and its position, of the pieces that turn."""
        space = namespace_of(self.velocity)
        time = -self.velocity / (2 * space.where(turns, self.sag, 1.0))
        return time, self.position + time * (self.velocity / 2)

    def lowest(self) -> tuple[Any, Any]:
        """The lowest position on the path, px, and whether it is the vertex of each piece."""
        space = namespace_of(self.velocity)
        (at_begin, falls), (at_end, rises) = (
            (self.position + h * (self.velocity + h * self.sag), self.velocity + 2 * h * self.sag)
            for h in (self.begin - self.base, self.end - self.base)
        )
        turned = turns(self.sag) & (falls < 0) & (rises > 0)
        _, vertex = self.vertex(turned)
        places = space.concatenate([space.where(turned, vertex, at_begin), at_end], axis=-1)
        # By its index: the derivative of a minimum divides by the number of equal ones.
        index = space.argmin(places, axis=-1)[..., None]
        is_lowest = np.arange(turned.shape[-1]).reshape(self.base.shape) == index
        return space.take_along_axis(places, index, axis=-1)[..., 0], turned & is_lowest

    def mirrored(self) -> "PathPieces":
        """The pieces of the mirror image of the path."""
        return self._replace(sag=-self.sag, velocity=-self.velocity, position=-self.position)


def turns(sag: Lengths) -> Array | np.ndarray | np.bool_:
    """Whether the sensor's path has a vertex to speak of."""
    return sag > _LEAST_SAG


def above_alignment(sag: Lengths, smear: Lengths, tau: Lengths) -> Lengths:
    r"""Place of objects on a parabola, from its lowest, or its highest if mirrored; px.

    $B(\tau - m/2B)^2$ from a vertex within the exposure, and
    $(1 \mp \tau)(|m| - |B|(1 \pm \tau))$, of the sign of $B$, from an end: no difference cancels.
    """
    space, size, depth = namespace_of(sag, smear, tau), abs(smear), abs(sag)
    turned = turns(depth) & (size < 2 * depth)
    safe = space.where(turned, sag, 1.0)
    side = space.where((smear < 0) == (sag < 0), tau, -tau)
    beyond = (1 - side) * (size - depth * (1 + side))
    beyond = space.where(sag < 0, -beyond, beyond)
    return space.where(turned, safe * (tau - smear / (2 * safe)) ** 2, beyond)


def length_on_parabola(sag: Lengths, smear: Lengths) -> Lengths:
    r"""Distance from the lowest to the highest place of objects on a parabola; px.

    $(|m| + 2B)^2/4B$ where it turns within the exposure, and $2|m|$ where it does not.
    """
    space, size, depth = namespace_of(sag, smear), abs(smear), magnitude(sag)
    is_beyond = size > 2 * depth
    safe = space.where(is_beyond | (depth <= _LEAST_SAG), 1.0, depth)
    return space.where(is_beyond, 2 * size, depth + size + size * (size / (4 * safe)))
