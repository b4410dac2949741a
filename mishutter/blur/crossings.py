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

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from mishutter._core.slopes import safe_sqrt
from mishutter.model.alignment import PathPieces

_NEAR = 2
"""Ratio of a piece's velocity to its gain of velocity up to which its vertex counts as near."""


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
    turn = base + to_vertex
    # Below the vertex both branches end there: what they lose and gain by its time is the same.
    near = jnp.where(
        height <= 0,
        jax.lax.stop_gradient(turn),
        turn + sign * jnp.sign(A) * safe_sqrt(height),
    )

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
