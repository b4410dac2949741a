r"""The exposure integral: how much light of a moving point falls on each pixel.

One evaluation serves both frames, every speed and every acceleration. The path falls
into two arms, before and after its vertex, on each of which position is a monotone
function of time. On an arm, a tap $[e_k, e_{k+1}]$ and a piece of the shutter overlap in
an interval of positions; the time spent there is $2\,\Delta x/(u_k + u_{k+1})$ and the
light is that time, times the piece's mean transmittance over it.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter.doubleword import DoubleWord, two_sum
from mishutter.motion import AbstractMotion
from mishutter.path import Path, path, speed_at
from mishutter.shutters.base import AbstractPiecewiseShutter, AbstractShutter, within_unit
from mishutter.shutters.sampled import piecewise
from mishutter.types import (
    RowLike,
    common_dtype,
    is_concrete,
    require,
    require_finite,
    require_positive_int,
    require_scalar,
)

_BLOCK_SIZE = 1 << 16
"""Taps times pieces above which taps are done block by block, to bound memory."""

_REST = {np.dtype(np.float64): 1e-130, np.dtype(np.float32): 1e-18}
"""Length of a path, in px, below which its squares underflow and it counts as a point."""


def blur_kernel(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    *,
    speed: ArrayLike = 0.0,
    num_taps: int,
    phase: ArrayLike = 0.0,
) -> Array:
    r"""Blur kernel of a moving point, aligned at the vertex of its path.

    $h_k = \frac12\int_{r_k}^{r_{k+1}} [w(\nu + r) + w(\nu - r)]\,dr$ with
    $r_k = \sqrt{\max(e_k, 0)/aT^2}$, $e_k = k + \text{phase}$ and $\nu = s/(2aT)$: the
    paper's area integration (its section 3), with the inverse square root of (8)-(9)
    removed by the change of variable and the shutter integrated rather than sampled.

    With no acceleration the vertex of a moving object is infinitely far away and the
    kernel is zero; that of an object at rest is all in the tap that holds position 0.
    The derivative with respect to `phase` is infinite where an edge lies exactly on the
    vertex under an open shutter; that edge's share is then left out, which is the
    derivative from below.

    Args:
        shutter: Transmittance over the exposure.
        motion: Motion of the sensor.
        speed: Object speed $s$, px/s; scalar, either sign.
        num_taps: Number of taps $n$; static.
        phase: Offset of the first tap's edge from the vertex, px; scalar.

    Returns:
        Share of a fully open exposure that falls on each pixel; shape `(n,)`. The taps
        sum to the efficiency once they cover the support
        $[0, aT^2(1 + |\nu|)^2]$.

    Raises:
        ValueError: if `num_taps` is not a positive integer, or `speed` or `phase` is
            not a finite scalar.
    """
    require_positive_int("blur_kernel(num_taps=...)", num_taps)
    for name, value in (("speed", speed), ("phase", phase)):
        require_scalar(f"blur_kernel({name}=...)", value)
        require_finite(f"blur_kernel({name}=...)", value)
    dtype = _dtype(shutter, motion, speed, phase)
    first = jnp.asarray(phase, dtype)
    edges = two_sum(jnp.arange(num_taps + 1, dtype=dtype), jnp.broadcast_to(first, num_taps + 1))
    return _exposure(shutter, motion, jnp.asarray(speed, dtype), edges, from_vertex=True)


def binned_exposure(
    shutter: AbstractShutter, motion: AbstractMotion, *, speed: ArrayLike, edges: RowLike
) -> Array:
    r"""Exposure between given positions on the sensor, relative to mid-exposure.

    $h_k = \frac{1}{2T}\int w(t/T)\,[e_k \le a t^2 - s t < e_{k+1}]\,dt$. It exists for
    every $a \ge 0$, zero included, where a rect shutter gives a box, and tends to that
    smoothly. A point that does not move at all falls on one pixel.

    The derivative with respect to an edge exactly at the vertex is infinite under an
    open shutter, and is given from the side on which no light falls.

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
    require_scalar("binned_exposure(speed=...)", speed)
    require_finite("binned_exposure(speed=...)", speed)
    _check_edges(edges)
    dtype = _dtype(shutter, motion, speed, edges)
    edge_array = jnp.asarray(edges, dtype)
    ends = DoubleWord(edge_array, jnp.zeros_like(edge_array))
    return _exposure(shutter, motion, jnp.asarray(speed, dtype), ends, from_vertex=False)


def support(motion: AbstractMotion, speed: ArrayLike) -> Array:
    r"""Far end of the vertex-frame kernel, $aT^2 (1 + |\nu|)^2$; px, shape of `speed`."""
    reach = motion.top_speed + jnp.abs(jnp.asarray(speed))
    moving = motion.acceleration > 0
    return jnp.where(moving, reach**2 / (4 * jnp.where(moving, motion.acceleration, 1.0)), 0.0)


def _check_edges(edges: RowLike) -> None:
    subject = "binned_exposure(edges=...)"
    require(np.ndim(edges) == 1, subject, "be one row", f"shape {np.shape(edges)}")
    require(np.size(edges) >= 2, subject, "hold at least two edges", np.size(edges))
    require_finite(subject, edges)
    if is_concrete(edges):
        ascending = bool(np.all(np.diff(np.asarray(edges)) >= 0))
        require(ascending, subject, "ascend", edges)


def _dtype(shutter: AbstractShutter, motion: AbstractMotion, *values: RowLike) -> np.dtype:
    return common_dtype(*jax.tree.leaves((shutter, motion)), *values)


@eqx.filter_jit
def _exposure(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speed: Array,
    edges: DoubleWord,
    *,
    from_vertex: bool,
) -> Array:
    profile = piecewise(shutter)
    a = motion.acceleration.astype(speed.dtype)
    T = motion.half_exposure.astype(speed.dtype)
    at_rest = jnp.abs(a * T * T) + jnp.abs(speed * T) < _REST[np.dtype(speed.dtype)]
    a, speed = (jnp.where(at_rest, 0.0, x) for x in (a, speed))
    tau = profile.breakpoints(np.dtype(speed.dtype))
    track = path(a, T, speed, tau, from_vertex=from_vertex)
    length = jnp.diff(tau.high) + jnp.diff(tau.low)
    pieces = _pieces(track, length)

    def block(ends: DoubleWord) -> Array:
        inside = DoubleWord(*(_bring_inside(e, track) for e in ends))
        velocity = speed_at(a, T, speed, inside, from_vertex=from_vertex)
        return _light(profile, pieces, ends, velocity, track.stroke) / 2

    taps = _by_blocks(block, edges, num_values=2 * length.size)
    return _with_points_at_rest(taps, edges, track, profile, from_vertex)


def _with_points_at_rest(taps, edges, track, profile, from_vertex):
    """The limits at zero stroke: a point at rest, or a vertex at infinity."""
    no_stroke, no_smear = track.stroke == 0, track.smear == 0
    holds_origin = (edges.high[:-1] <= 0) & (edges.high[1:] > 0)
    light = profile.efficiency().astype(taps.dtype)
    point = jnp.where(holds_origin, light, jnp.zeros_like(light))
    taps = jnp.where(no_stroke & no_smear, point, taps)
    return jnp.where(no_stroke & ~no_smear, jnp.zeros_like(taps), taps) if from_vertex else taps


class _Pieces(NamedTuple):
    """Ends of each piece on each arm, before the vertex and after; shapes `(n, 2, 1)`.

    A piece reaches from its inner end, nearer the vertex, to its outer end. Where the
    vertex lies inside or beyond it, the vertex takes the inner end's place, and
    `to_vertex` is the time from one to the other.
    """

    inner: DoubleWord
    outer: DoubleWord
    inner_speed: Array
    outer_speed: Array
    to_vertex: Array


def _pieces(track: Path, length: Array) -> _Pieces:
    outwards = jnp.stack([-track.velocity, track.velocity])
    on_arm = outwards >= 0
    high = jnp.where(on_arm, track.position.high, track.vertex.high)
    low = jnp.where(on_arm, track.position.low, track.vertex.low)
    speed = jnp.where(on_arm, outwards, 0.0)

    def inner(x: Array) -> Array:
        return jnp.stack([x[0, 1:], x[1, :-1]], axis=1)[..., None]

    def outer(x: Array) -> Array:
        return jnp.stack([x[0, :-1], x[1, 1:]], axis=1)[..., None]

    return _Pieces(
        DoubleWord(inner(high), inner(low)),
        DoubleWord(outer(high), outer(low)),
        inner(speed),
        outer(speed),
        _vertex_offset(track.stroke, inner(outwards), length[:, None, None]),
    )


def _vertex_offset(stroke: Array, inner_velocity: Array, length: Array) -> Array:
    """Time from a piece's inner end to the vertex, where the vertex cuts the piece."""
    turns = (inner_velocity < 0) & (stroke > 0)
    offset = jnp.where(turns, -inner_velocity / jnp.where(turns, 2 * stroke, 1.0), 0.0)
    return jnp.minimum(offset, length)


def _light(
    profile: AbstractPiecewiseShutter,
    pieces: _Pieces,
    edges: DoubleWord,
    velocity: Array,
    stroke: Array,
) -> Array:
    """Light of both arms of the path between edges, in units of tau; shape `(n,)`."""
    inner, outer, inner_speed, outer_speed, to_vertex = pieces
    edges = DoubleWord(edges.high[None, None], edges.low[None, None])
    below = _distance(edges, inner) <= 0
    above = _distance(edges, outer) >= 0

    def clipped(edge, at_inner, at_outer):
        return jnp.where(below, at_inner, jnp.where(above, at_outer, edge))

    u = clipped(velocity[None, None], inner_speed, outer_speed)
    x = DoubleWord(
        clipped(edges.high, inner.high, outer.high), clipped(edges.low, inner.low, outer.low)
    )
    step = jnp.diff(x.high) + jnp.diff(x.low)
    width = _time(step, u[..., :-1], u[..., 1:], stroke)
    near = to_vertex + _time(_distance(x, inner), inner_speed, u, stroke)[..., :-1]
    far = _time(_distance(outer, x), u, outer_speed, stroke)[..., 1:]
    start = jnp.stack([far[:, 0], near[:, 1]], axis=1)
    remaining = jnp.stack([near[:, 0], far[:, 1]], axis=1)
    mean = profile.piece_mean(start, width, remaining)
    return jnp.sum(width * within_unit(mean), axis=(0, 1))


def _time(distance: Array, before: Array, after: Array, stroke: Array) -> Array:
    r"""Time between two points of an arm, from their distance and their speeds.

    $2\,\Delta x / (u_1 + u_2)$ where the speeds are close, $(u_2 - u_1)/2A$ where they
    differ by a factor of 2: there it is the speeds that are known to the last digit,
    and near the vertex their derivatives are too.
    """
    far_apart = after > 2 * before
    safe_rate = jnp.where(far_apart, 2 * stroke, 1.0)
    total = before + after
    close = ~far_apart & (total > 0)
    by_distance = 2 * distance / jnp.where(close, total, 1.0)
    return jnp.where(far_apart, (after - before) / safe_rate, jnp.where(close, by_distance, 0.0))


def _distance(x: DoubleWord, y: DoubleWord) -> Array:
    """`x - y` to single precision: the difference of the high parts loses nothing."""
    return (x.high - y.high) + (x.low - y.low)


def _bring_inside(edge: Array, track: Path) -> Array:
    """Edges, with those beyond all light brought near enough not to overflow."""
    reach = 2 * jnp.max(jnp.abs(track.position.high)) + jnp.abs(track.vertex.high) + 1
    return jnp.clip(edge, -reach, reach)


def _by_blocks(function, edges: DoubleWord, *, num_values: int) -> Array:
    """`function` over runs of taps short enough that memory does not grow with pieces."""
    num_taps = edges.high.size - 1
    length = max(1, _BLOCK_SIZE // num_values)
    if num_taps <= length:
        return function(edges)
    num_blocks = -(-num_taps // length)
    index = np.minimum(np.arange(num_blocks)[:, None] * length + np.arange(length + 1), num_taps)
    blocks = DoubleWord(edges.high[index], edges.low[index])
    return jax.lax.map(jax.checkpoint(function), blocks).reshape(-1)[:num_taps]
