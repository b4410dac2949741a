r"""The exposure integral: how much light of a moving point falls on each pixel.

One evaluation serves both frames, every speed and every acceleration. The path falls
into two arms, before and after its vertex, on each of which position is a monotone
function of time. On an arm, a tap $[e_k, e_{k+1}]$ and a piece of the shutter overlap in
an interval of positions; the time spent there is $2\,\Delta x/(u_k + u_{k+1})$ and the
light is that time, times the piece's mean transmittance over it.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter.arms import AFTER, crossings, passed_breakpoints, time_between
from mishutter.compiling import quick_to_compile
from mishutter.doubleword import DoubleWord, two_sum
from mishutter.motion import AbstractMotion
from mishutter.path import Motion, Path, path, speed_at
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


@quick_to_compile
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
    track = path(*jax.lax.stop_gradient((a, T, speed, tau)), from_vertex=from_vertex)
    light = _light(profile, (a, T, speed), track, tau, _bring_inside(edges, track))
    return _with_points_at_rest(light / 2, edges, track, profile, from_vertex)


def _with_points_at_rest(taps, edges, track, profile, from_vertex):
    """The limits at zero stroke: a point at rest, or a vertex at infinity."""
    no_stroke, no_smear = track.stroke == 0, track.smear == 0
    holds_origin = (edges.high[:-1] <= 0) & (edges.high[1:] > 0)
    light = profile.efficiency().astype(taps.dtype)
    point = jnp.where(holds_origin, light, jnp.zeros_like(light))
    taps = jnp.where(no_stroke & no_smear, point, taps)
    return jnp.where(no_stroke & ~no_smear, jnp.zeros_like(taps), taps) if from_vertex else taps


def _light(
    profile: AbstractPiecewiseShutter,
    motion: Motion,
    track: Path,
    tau: DoubleWord,
    edges: DoubleWord,
) -> Array:
    """Light of both arms of the path between edges, in units of tau; shape `(n,)`.

    Edges and breakpoints cut an arm into cells, each in one tap and in one piece. One
    cell starts at each edge, and one at each breakpoint inside the exposure.
    """
    a, T, _ = motion
    speed = speed_at(motion, track, edges)
    passed = passed_breakpoints(track, edges)
    x = crossings(motion, track, tau, passed, edges, speed)

    step = jnp.diff(edges.high) + jnp.diff(edges.low)
    within = time_between(step, speed[:-1], speed[1:], a * T * T)[None]
    whole = (x.rank[:, 1:] == x.rank[:, :-1]) & ~x.is_beyond[:, :-1]
    width = jnp.where(x.is_before[:, :-1], x.since[:, 1:], within)
    width = jnp.where(whole, width, x.outer[:, :-1])
    outer = jnp.where(whole, x.outer[:, 1:], 0.0)
    light = _cell_light(profile, x.piece[:, :-1], AFTER, x.inner[:, :-1], width, outer)
    light = jnp.sum(light, axis=0)
    if tau.high.size == 2:
        return light

    # The cells that start at a breakpoint.
    is_after = track.velocity[1:-1] >= 0
    piece = jnp.arange(tau.high.size - 2, dtype=jnp.int32) + is_after.astype(jnp.int32)
    length = (jnp.diff(tau.high) + jnp.diff(tau.low))[piece]
    edge = jnp.sum(~passed[1:-1], axis=1, dtype=jnp.int32)
    ends_here = (edge > 0) & (edge < edges.high.size)
    arm, edge = is_after.astype(jnp.int32), jnp.clip(edge, 1, edges.high.size - 1)
    cut = x.piece[arm, edge] == piece
    width = jnp.where(cut, x.inner[arm, edge], length)
    outer = jnp.where(cut, x.outer[arm, edge], 0.0)
    more = _cell_light(profile, piece, is_after, jnp.zeros_like(width), width, outer)
    return light.at[edge - 1].add(jnp.where(ends_here, more, 0.0))


def _cell_light(profile, piece, is_after, inner, width, outer):
    """Light of cells `inner` and `outer` from the two ends of a piece on an arm."""
    start, remaining = jnp.where(is_after, inner, outer), jnp.where(is_after, outer, inner)
    return width * within_unit(profile.piece_mean(piece, start, width, remaining))


def _bring_inside(edges: DoubleWord, track: Path) -> DoubleWord:
    """Edges, with those beyond all light brought near enough not to overflow."""
    reach = 2 * jnp.max(jnp.abs(track.position.high)) + jnp.abs(track.vertex.high) + 1
    return DoubleWord(*(jnp.clip(x, -reach, reach) for x in edges))
