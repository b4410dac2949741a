r"""Times at which a point crosses positions on the sensor, in closed form.

On a piece of constant acceleration the point is at $x = X + Uh + Ah^2$, in normalised time
$\tau = t/T$: $A = aT^2$ is the sag, $U$ the velocity (px per half exposure) and $X$ the position
at a base from which $h$ counts. With the velocity $u = \pm\sqrt{U^2 + 4A(e - X)}$ at an edge $e$,

$$h = -\frac{U}{2A} \pm \sqrt{\frac{e - x_v}{A}}, \quad x_v = X - \frac{U^2}{4A},
\qquad\text{or}\qquad h = \frac{2(e - X)}{U + u}.$$

The first counts from the vertex and holds where that is near the piece; the second is the root that
does not cancel where it is far, and holds without acceleration. One sign of $u$ is one branch: on
it the point rises or falls throughout. `docs/derivation.md` draws the geometry.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from mishutter.model.motion import AbstractMotion

_NEAR = 2
"""Ratio of a piece's velocity to its gain of velocity up to which its vertex counts as near."""


class PathPieces(NamedTuple):
    """Pieces of constant acceleration of the path of a point over the sensor."""

    sag: Float[Array, "pieces"]  # A, px
    velocity: Float[Array, "pieces"]  # U, px per half exposure, at the base
    position: Float[Array, "pieces"]  # X, px from mid-exposure, at the base
    base: Float[np.ndarray, "pieces"]  # the time nearest to mid-exposure, in units of T
    begin: Float[np.ndarray, "pieces"]
    end: Float[np.ndarray, "pieces"]
    travel: Float[Array, "pieces"]  # from mid-exposure to the base, px, at most

    @property
    def is_at_rest(self) -> Bool[Array, "pieces"]:
        """Whether the point moves less than positions are rounded by, or powers of it underflow."""
        length, precision = self.end - self.begin, jnp.finfo(self.sag.dtype)
        least = precision.tiny**0.25 + 4 * precision.eps * self.travel
        return (abs(self.sag) * length + abs(self.velocity)) * length < least

    def vertex(self, turns: Bool[Array, "pieces"]) -> tuple[Array, Array]:
        """Time from the base to the vertex and its position, of the pieces that turn."""
        time = -self.velocity / (2 * jnp.where(turns, self.sag, 1.0))
        return time, self.position + time * (self.velocity / 2)


def path_pieces(motion: AbstractMotion, speed: Float[Array, ""]) -> PathPieces:
    """The path of a point of a speed, px/s, over the sensor."""
    dtype = np.dtype(speed.dtype)
    T, v = (x.astype(dtype) for x in (motion.half_exposure, motion.velocity))
    ends = np.array(motion.piece_ends or (-1, 1), np.float64)
    begin, end = ends[:-1], ends[1:]
    # Mid-exposure lies in the piece that straddles it; the others count from the end nearer to it.
    base = np.clip(0, begin, end)
    # Time for which each piece accelerates between mid-exposure and each base.
    between = np.minimum(base, 0)[:, None], np.maximum(base, 0)[:, None]
    first, last = np.clip(begin, *between), np.clip(end, *between)
    gain = 2 * np.sign(base)[:, None] * (last - first)
    rise = (last - first) * abs(2 * base[:, None] - first - last)
    sag, smear = motion.piece_accelerations.astype(dtype) * T * T, (speed - v) * T
    # By sums, not products of matrices, which an accelerator would compute with fewer digits.
    velocity, position = (
        jnp.sum(matrix.astype(dtype) * sag[None], axis=1) - smear * share.astype(dtype)
        for matrix, share in ((gain, np.ones_like(base)), (rise, base))
    )
    base, begin, end = (x.astype(dtype) for x in (base, begin, end))
    travel = jnp.sum(rise.astype(dtype) * abs(sag)[None], axis=1) + abs(smear) * abs(base)
    return PathPieces(sag, velocity, position, base, begin, end, travel)


def lowest_position(pieces: PathPieces) -> tuple[Float[Array, ""], Bool[Array, "pieces"]]:
    """The lowest position of a point on its path, px, and the piece whose vertex it is, if any."""
    from_base = [time - pieces.base for time in (pieces.begin, pieces.end)]
    at_begin, at_end = (pieces.position + h * (pieces.velocity + h * pieces.sag) for h in from_base)
    rises = pieces.sag > 0
    time, vertex = pieces.vertex(rises)
    turns = rises & (from_base[0] < time) & (time < from_base[1])
    # By its index: the derivative of a minimum divides by the number of equal ones.
    places = jnp.concatenate([jnp.where(turns, vertex, at_begin), at_end])
    lowest = jnp.argmin(places)
    return places[lowest], turns & (jnp.arange(turns.size) == lowest)


def branch_times(
    pieces: PathPieces,
    edges: Float[Array, "edges"],
    origin: Float[Array, ""],
    is_own: Bool[Array, "pieces"],
) -> Float[Array, "pieces 2 edges"]:
    """Times at which a point that falls, and one that rises, crosses edges on each piece.

    Edges count from the origin, which is the vertex of the pieces whose own it is. An edge that a
    branch does not reach is held at an end of the piece or at the vertex.
    """
    A, U, X, base, begin, end = (jnp.asarray(x)[:, None, None] for x in pieces[:6])
    edges = edges[None, None]
    is_at_rest = pieces.is_at_rest[:, None, None]
    is_near = ~is_at_rest & (abs(U) <= _NEAR * (end - begin) * abs(A))
    sign = jnp.array([[[-1], [1]]], A.dtype)

    # Edges out of reach are moved nearer, so that no quotient overflows, nor its derivatives.
    length = end - begin
    to_vertex, vertex = (x[:, None, None] for x in pieces.vertex(is_near[:, 0, 0]))
    # A vertex that is the origin is exactly there: the root of a rounding would be much larger.
    aside = jnp.where(is_own[:, None, None], 0.0, origin - vertex)
    reach = (_NEAR * length) ** 2 * abs(A)
    height = _held(aside + edges, -reach, reach) / jnp.where(is_near, A, 1.0)
    height = jnp.where(is_near, height, 1.0)  # away from 0, where a root has no derivatives
    near = base + to_vertex + sign * jnp.sign(A) * safe_sqrt(height)

    reach, is_far = 4 * length * (abs(U) + length * abs(A)), ~(is_near | is_at_rest)
    distance = (origin - X) + edges
    shift = _held(distance, -reach, reach) / jnp.where(is_far, U, 1.0)
    bend = 4 * jnp.where(is_far, A, 0.0) / jnp.where(is_far, U, 1.0)
    far = base + 2 * shift / (1 + safe_sqrt(1 + bend * shift))
    far = jnp.where(sign * U < 0, begin, far)  # its other branch lies outside the exposure

    at_rest = jnp.where((sign > 0) & (distance > 0), end, begin)
    time = jnp.where(is_at_rest, at_rest, jnp.where(is_near, near, far))
    return _held(time, begin, end)


def _held(value: Array, low: Array, high: Array) -> Array:
    """A value held between two others, which carries NaN and has no derivative where it is held."""
    return jnp.where(value < low, low, jnp.where(value > high, high, value))


def safe_sqrt(square: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Square root; 0 for negative numbers, and with a derivative of 0 at 0."""
    is_zero = square <= 0
    # Without the inner `where` the infinite slope at 0, times the 0 of the outer one, would be NaN.
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, square)))
