r"""The exposure integral: how much of a moving point's exposure falls on each pixel.

One formula serves both frames, every speed and every path. On a piece of constant acceleration the
point falls, then rises, or the other way round; on each of the two branches it is in a tap from the
time at which it crosses one edge to that at which it crosses the next, and exposes it by the
integral of the transmittance between them. A kernel is the sum over pieces and branches, and its
derivatives are those of the formulae. `docs/derivation.md` draws the geometry.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from mishutter._core.checks import (
    RowLike,
    common_dtype,
    is_concrete,
    require,
    require_finite,
    require_number,
    require_positive_int,
    shape_of,
)
from mishutter.blur.crossings import branch_times
from mishutter.model.motion import AbstractMotion
from mishutter.model.shutters.base import (
    AbstractPiecewiseShutter,
    AbstractShutter,
    integral_between,
    piecewise,
)

_MOST_TAPS = 1 << 22
"""Most taps of one kernel: the computation of as many takes some 2 GiB."""


def blur_kernel(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    *,
    speed: ArrayLike = 0.0,
    num_taps: int | np.integer,
    phase: ArrayLike = 0.0,
) -> Float[Array, "{num_taps}"]:
    r"""Blur kernel of a moving point, aligned at the vertex of its path.

    $h_k = \frac12\int_{r_k}^{r_{k+1}} [w(\nu + r) + w(\nu - r)]\,dr$ with
    $r_k = \sqrt{\max(e_k, 0)/aT^2}$, $e_k = k + \text{phase}$ and $\nu = (s - v)/(2aT)$: the
    paper's area integration (its section 3), with the inverse square root of (8)-(9)
    removed by the change of variable and the shutter integrated rather than sampled.

    On a sensor that pans, $s$ stands for $s - v$: a velocity shifts the speed. With no
    acceleration the vertex of an object that moves over the sensor is infinitely far away and the
    kernel is zero; that of an object at rest lies in the tap that holds position 0,
    $e_k \le 0 < e_{k+1}$. An object counts as at rest if $aT^2 + |s|T$ is below 1e-77 px
    (3e-10 px in float32), and its derivatives by all but the shutter are then 0: they are
    exact unless an edge lies exactly on position 0, where none exist.
    The derivative with respect to `phase` is infinite where an edge lies exactly on the
    vertex under an open shutter; that edge's share is then left out, which is the
    derivative from below. An acceleration below 0, which only a traced number may have, gives the
    kernel of the mirrored path.

    In float64 a tap is exact to 1e-12 of the largest where light travels up to 1,000 px, and to
    1e-11 up to 10,000 px; in float32 to 5e-6 up to 50 px, and beyond in proportion to the travel.
    First derivatives are exact to 1e-11 (1e-4) of the largest. There are derivatives of every
    order, by every argument and on every path.

    Args:
        shutter: Transmittance over the exposure.
        motion: Motion of the sensor.
        speed: Object speed $s$, px/s; scalar, either sign.
        num_taps: Number of taps $n$; static.
        phase: Offset of the first tap's edge from the vertex, px; scalar.

    Returns:
        Share of a fully open exposure that falls on each pixel; shape `(n,)`. The taps
        sum to the efficiency where they cover the support
        $[0, aT^2(1 + |\nu|)^2]$.

    Raises:
        ValueError: if `num_taps` is not a positive integer of at most 4,194,304, or `speed` or
            `phase` is not a finite scalar.

    Examples:
        >>> from mishutter import HannShutter, ParabolicMotion, blur_kernel
        >>> motion = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
        >>> taps = blur_kernel(HannShutter(), motion, speed=300.0, num_taps=32)
        >>> print(taps.shape, f"{taps.sum():.3f}")
        (32,) 0.500
    """
    subject = "blur_kernel(num_taps=...)"
    num_taps = require_positive_int(subject, num_taps)
    require(num_taps <= _MOST_TAPS, subject, f"be at most {_MOST_TAPS}", num_taps)
    for name, value in (("speed", speed), ("phase", phase)):
        require_number(f"blur_kernel({name}=...)", value)
    return aligned_kernel(
        shutter,
        motion,
        speed,
        num_taps,
        phase,
        from_lowest=True,
        any_vertex=motion.accelerates_constantly,
    )


def aligned_kernel(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speed: ArrayLike,
    num_taps: int,
    phase: ArrayLike,
    *,
    from_lowest: Bool[Array, ""] | bool,
    any_vertex: bool = False,
) -> Float[Array, "{num_taps}"]:
    """A kernel from the lowest position within the exposure on, or else from mid-exposure.

    With `any_vertex` it begins at the vertex of a parabola, which may lie beyond the exposure.
    """
    dtype = common_dtype(shutter, motion, speed, phase)
    edges = jnp.arange(num_taps + 1, dtype=dtype) + jnp.asarray(phase, dtype)
    numbers = jnp.asarray(speed, dtype), edges, jnp.asarray(from_lowest)
    return _exposure(piecewise(shutter), motion, *numbers, any_vertex=any_vertex)


def binned_exposure(
    shutter: AbstractShutter, motion: AbstractMotion, *, speed: ArrayLike, edges: RowLike
) -> Float[Array, "taps"]:
    r"""Exposure between given positions on the sensor, relative to mid-exposure.

    $h_k = \frac{1}{2T}\int w(t/T)\,[e_k \le a t^2 - (s - v) t < e_{k+1}]\,dt$. It exists for
    every $a \ge 0$ and is smooth there: at $a = 0$ a rect shutter gives a box. A point that does
    not move falls on one pixel, as in `blur_kernel`.

    The derivative with respect to an edge exactly at the vertex is infinite under an
    open shutter; the result is that from the side that the point never reaches. Where an edge
    meets a step of the shutter exactly, the exposure has a kink, and the derivative is
    that of either side. In reverse mode the derivative by a shift of all edges is the sum
    of the derivatives by each edge, which cancel for narrow taps; `blur_kernel` shifts all
    edges as one by its phase.

    Args:
        shutter: Transmittance over the exposure.
        motion: Motion of the sensor.
        speed: Object speed $s$, px/s; scalar, either sign.
        edges: Pixel edges, ascending, px; shape `(n + 1,)`.

    Returns:
        Share of a fully open exposure in each interval; shape `(n,)`.

    Raises:
        ValueError: if `edges` are not finite and ascending, or fewer than two, or
            `speed` is not a finite scalar.
    """
    require_number("binned_exposure(speed=...)", speed)
    subject = "binned_exposure(edges=...)"
    require(np.ndim(edges) == 1, subject, "be one row", shape_of(edges))
    require(np.size(edges) >= 2, subject, "hold at least two edges", np.size(edges))
    require_finite(subject, edges)
    if is_concrete(edges):
        ascending = bool(np.all(np.diff(np.asarray(edges)) >= 0))
        require(ascending, subject, "ascend", edges)
    dtype = common_dtype(shutter, motion, speed, edges)
    speed, row = jnp.asarray(speed, dtype), jnp.asarray(edges, dtype)
    return _exposure(piecewise(shutter), motion, speed, row, jnp.asarray(False))


@eqx.filter_jit
def _exposure(
    profile: AbstractPiecewiseShutter,
    motion: AbstractMotion,
    speed: Float[Array, ""],
    edges: Float[Array, "edges"],
    from_lowest: Bool[Array, ""],
    *,
    any_vertex: bool = False,
) -> Float[Array, "taps"]:
    """Share of a full exposure in each tap; `edges` count as in `aligned_kernel`."""
    pieces, exists = motion.pieces_of(speed), jnp.asarray(True)
    if any_vertex:
        # Edges count upwards from the vertex: a parabola that opens downwards is mirrored.
        sign = jnp.where(pieces.sag < 0, -1, 1).astype(pieces.sag.dtype)
        pieces = pieces._replace(sag=sign * pieces.sag, velocity=sign * pieces.velocity)
        far = abs(pieces.velocity) * jnp.finfo(pieces.sag.dtype).eps
        # Beyond that the vertex is further away than any pixel could be told from the next.
        is_own = ~pieces.is_at_rest & ~(far > pieces.sag)
        origin = jnp.where(is_own, pieces.vertex(is_own)[1], 0.0)[0]
        exists = (is_own | pieces.is_at_rest)[0]
    else:
        origin, is_own = pieces.lowest()
    origin, is_own = jnp.where(from_lowest, origin, 0.0), is_own & from_lowest
    # Rounding may put light below its lowest position, where an edge must not cut it off.
    edges = jnp.where(from_lowest & (edges <= 0), -jnp.inf, edges)
    time = branch_times(pieces, edges, origin, is_own)
    falls = np.array([[[True], [False]]])
    first, last = time[..., :-1], time[..., 1:]
    begin, end = jnp.where(falls, last, first), jnp.where(falls, first, last)
    exposure = jnp.sum(integral_between(profile, begin, end), axis=(0, 1)) / 2
    return jnp.where(exists, exposure, 0.0)
