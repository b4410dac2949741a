r"""The exposure integral: how much of a moving point's exposure falls on each pixel.

One evaluation serves both frames, every speed and every acceleration. The trajectory has
two branches, before and after its vertex, and on each position is a monotone function of
time. On a branch, a tap $[e_k, e_{k+1}]$ and a piece of the shutter overlap in an interval
of positions, a cell. The point spends $2\,\Delta x/(u_1 + u_2)$ in a cell whose ends it
passes at $u_1$ and $u_2$, and exposes it for that time, times the mean transmittance of
the piece over it. `docs/derivation.md` draws the geometry.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from mishutter._core import (
    DoubleWord,
    RowLike,
    add,
    common_dtype,
    is_concrete,
    require,
    require_finite,
    require_positive_int,
    require_scalar,
    shape_of,
    two_sum,
)
from mishutter.blur.crossings import (
    AFTER,
    Crossings,
    at,
    crossings,
    distance,
    lengths,
    sum_over_branches,
    time_between,
    with_tangent,
)
from mishutter.blur.derivatives import (
    BoundaryTimes,
    BreakpointCells,
    CellBoundaries,
    KernelInputs,
    KernelPrimal,
    attach_breakpoint_jvp,
    attach_motion_jvp,
    cell_exposure,
    parts,
)
from mishutter.blur.free_derivatives import attach_path_jvp, differentiable_path
from mishutter.blur.free_path import (
    MonotoneRun,
    free_crossings,
    free_path,
    looked_up,
    path_parameters,
    refined,
    runs,
)
from mishutter.blur.trajectory import (
    Motion,
    materialised,
    nonstationary_motion,
    primal_path,
    speed_on_sensor,
)
from mishutter.model import (
    AbstractMotion,
    AbstractPiecewiseShutter,
    AbstractShutter,
    FreeMotion,
    piecewise,
    steady,
)

_MOST_TAPS = 1 << 22
"""Most taps of one kernel: the computation of as many takes some 2 GiB."""
_FEW_TAPS = 512
"""Number of taps up to which comparing with every edge is as quick as a binary search."""


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
    $e_k \le 0 < e_{k+1}$. An object counts as at rest if $aT^2 + |s|T$ is below 1e-130 px
    (1e-18 px in float32), and its derivatives by all but the shutter are then 0: they are
    exact unless an edge lies exactly on position 0, where none exist.
    The derivative with respect to `phase` is infinite where an edge lies exactly on the
    vertex under an open shutter; that edge's share is then left out, which is the
    derivative from below.

    In float64 a tap is exact to 1e-12 of itself or 1e-15 of the largest, of sags up to
    1e8 px, in float32 to 2e-6 or 1e-7, up to 1e6 px; `GaussianShutter` states the accuracy in its
    tails. First derivatives are exact to 1e-9 (1e-4) of the largest, second ones
    in float64 to 1e-9 of sags up to 1e6 px. A free path has second derivatives by the shutter
    alone.

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
        NotImplementedError: if differentiated twice on a free path, by more than the shutter.

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
        require_scalar(f"blur_kernel({name}=...)", value)
        require_finite(f"blur_kernel({name}=...)", value)
    return aligned_kernel(shutter, motion, speed, num_taps, phase, from_vertex=True)


def aligned_kernel(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speed: ArrayLike,
    num_taps: int,
    phase: ArrayLike,
    *,
    from_vertex: Bool[Array, ""] | bool,
    count: int | None = None,
) -> Float[Array, "{num_taps}"]:
    """The `blur_kernel`, or one aligned at mid-exposure where not `from_vertex`.

    `count` is the number of runs of a free path; a caller that traces the path must give it.
    """
    dtype = _dtype(shutter, motion, speed, phase)
    first = jnp.asarray(phase, dtype)
    # An even number of edges, which XLA can share out among threads.
    index = jnp.arange(num_taps + 1 + (num_taps + 1) % 2, dtype=dtype)
    # One float would round away the low digits of the phase, which decide how much of a tap is
    # exposed where a step of the shutter falls into it. The derivative by the phase goes by the
    # common shift instead: summed over edges it would cancel.
    edges = two_sum(index, jnp.broadcast_to(jax.lax.stop_gradient(first), index.shape))
    profile = piecewise(shutter)
    taps = _Taps(num_taps, edges, first, from_vertex)
    return _exposure(profile, motion, jnp.asarray(speed, dtype), taps, count or motion.num_runs)


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
        NotImplementedError: if differentiated twice on a free path, by more than the shutter.
    """
    require_scalar("binned_exposure(speed=...)", speed)
    require_finite("binned_exposure(speed=...)", speed)
    _check_edges(edges)
    dtype = _dtype(shutter, motion, speed, edges)
    row = jnp.asarray(edges, dtype)
    num_taps = row.size - 1
    row = jnp.pad(row, (0, row.size % 2), mode="edge")
    ends, shift = DoubleWord(row, jnp.zeros(1, dtype)), jnp.zeros((), dtype)
    taps, s = _Taps(num_taps, ends, shift, False), jnp.asarray(speed, dtype)
    return _exposure(piecewise(shutter), motion, s, taps, motion.num_runs)


def _check_edges(edges: RowLike) -> None:
    subject = "binned_exposure(edges=...)"
    require(np.ndim(edges) == 1, subject, "be one row", shape_of(edges))
    require(np.size(edges) >= 2, subject, "hold at least two edges", np.size(edges))
    require_finite(subject, edges)
    if is_concrete(edges):
        ascending = bool(np.all(np.diff(np.asarray(edges)) >= 0))
        require(ascending, subject, "ascend", edges)


def _dtype(shutter: AbstractShutter, motion: AbstractMotion, *values: RowLike) -> np.dtype:
    return common_dtype(*jax.tree.leaves((shutter, motion)), *values)


class _Taps(NamedTuple):
    """The taps of a kernel.

    Attributes:
        num_taps: Number of taps $n$; static.
        edges: Edges of the taps, and perhaps one more; px.
        shift: Number by which all edges move together, and which they include; px.
        from_vertex: Whether edges count from the vertex; else from mid-exposure.
    """

    num_taps: int
    edges: DoubleWord
    shift: Float[Array, "..."]
    from_vertex: Bool[Array, ""] | bool


@eqx.filter_jit
def _exposure(
    profile: AbstractPiecewiseShutter,
    motion: AbstractMotion,
    speed: Float[Array, ""],
    taps: _Taps,
    num_runs: int,
) -> Float[Array, "n"]:
    """Share of a full exposure in each tap.

    `num_runs` is the number of runs of a free path, and 1 for any other.
    """
    if isinstance(motion, FreeMotion):
        return _free_exposure(profile, motion, speed, taps, num_runs) / 2
    a = steady(motion).acceleration.astype(speed.dtype)
    T = motion.half_exposure.astype(speed.dtype)
    s, low = speed_on_sensor(speed, motion.velocity.astype(speed.dtype))
    return _parabolic_exposure(profile, Motion(a, T, s), low, taps) / 2


def _parabolic_exposure(
    profile: AbstractPiecewiseShutter, motion: Motion, speed_low: Float[Array, ""], taps: _Taps
) -> Float[Array, "n"]:
    """Exposure of both branches of each tap, in units of tau.

    Edges and breakpoints cut a branch into cells, each in one tap and in one piece. One
    cell starts at each edge, and one at each breakpoint inside the exposure.
    """
    num_taps, edges, shift, from_vertex = taps
    tau = profile.breakpoints(np.dtype(speed_low.dtype))
    # Carries no derivative by the motion and the edges up to `attach_motion_jvp`.
    motion, at_rest = nonstationary_motion(motion)
    # The motion that stands for rest does not accelerate, so that it has no vertex.
    from_vertex = from_vertex & ~at_rest
    primal_motion, primal_tau = jax.lax.stop_gradient((motion, tau))
    track = primal_path(primal_motion, speed_low, primal_tau, from_vertex=from_vertex)
    x, speed, clipped = crossings(profile.equal_pieces, track, at_rest, primal_tau, edges)
    gap, (u, v) = _gaps(num_taps, clipped), (speed[k] for k in parts(num_taps))
    is_held = x.is_held(tau.high.size - 1)
    exposure, width, cut = _branch_exposures(
        num_taps,
        profile,
        tau,
        track.velocity,
        x,
        within=time_between(gap, u, v, track.sag),
        is_held=is_held,
        times=BoundaryTimes(tau.high, (motion, edges.high, shift)),
        from_vertex=from_vertex,
    )
    primal = KernelPrimal(profile, tau, x, clipped.high, gap, width, is_held, cut)
    inputs = KernelInputs(motion, edges.high, shift, profile, tau)
    exposure, primal = sum_over_branches(exposure), jax.lax.stop_gradient(primal)
    return attach_motion_jvp(exposure, inputs, from_vertex=from_vertex, primal=primal)


def _gaps(num_taps: int, edges: DoubleWord) -> Array:
    """Distances between the edges of each tap, which are `(1, n + 1)`; shape `(1, n)`."""
    begin, end = (DoubleWord(edges.high[k], edges.low[k]) for k in parts(num_taps))
    return distance(end, begin)


def _branch_exposures(
    num_taps: int,
    profile: AbstractPiecewiseShutter,
    tau: DoubleWord,
    velocity: Float[Array, "breakpoints"],
    x: Crossings,
    *,
    within: Float[Array, "#2 taps"],
    is_held: Bool[Array, "2 edges"],
    times: BoundaryTimes,
    from_vertex: Bool[Array, ""] | bool,
    run: MonotoneRun | None = None,
) -> tuple[Float[Array, "2 taps"], Float[Array, "2 taps"], BreakpointCells | None]:
    """Exposure of each branch, `(2, n)`; duration of cells at inner edges; and all other cells.

    Args:
        num_taps: Number of taps $n$.
        profile: The shutter.
        tau: Its breakpoints.
        velocity: Velocity at breakpoints.
        x: Crossings of the edges.
        within: Time between the crossings of a tap's edges, which branches of a parabola share.
        is_held: Whether crossings are held at an end of the exposure.
        times: Moments that second derivatives by the profile follow.
        from_vertex: Whether edges count from the vertex.
        run: The pieces to integrate over; all by default.
    """
    held_here, held_there = (is_held[k] for k in parts(num_taps))
    is_free = ~(held_here | held_there)

    here, there = (x.part(k).by_breakpoints(tau.high) for k in parts(num_taps))
    length = at(lengths(profile.equal_pieces, tau), here.piece)
    in_one_piece = here.piece == there.piece
    # Only a part of a tap with a held inner edge lies in the exposure: the distance of its edges
    # does not tell how long that lasts, but the offsets of its ends do.
    entered = there.inner(AFTER, length) - here.inner(AFTER, length)
    width = jnp.where(held_here & in_one_piece, entered, here.outer(AFTER, length))
    # A breakpoint that moves between crossings lengthens one cell as it shortens the next, so
    # these widths carry no derivative: `attach_breakpoint_jvp` attaches it.
    width = jnp.where(is_free, jax.lax.stop_gradient(jnp.where(in_one_piece, within, width)), width)
    in_pieces = tau.high.size > 2
    width = materialised(width) if in_pieces else width
    crossing, breakpoint, constant = _places(x, tau)
    entering, leaving = (crossing[k] for k in parts(num_taps))
    next_piece = jnp.where(is_free, breakpoint[0] + here.piece + AFTER.astype(np.int32), constant)
    end = jnp.where(in_one_piece, leaving, next_piece)
    boundaries = CellBoundaries(entering, end, from_vertex, x, is_held)
    cells = jax.lax.stop_gradient({"start": here, "is_after": AFTER, "boundaries": boundaries})
    exposure, cut = cell_exposure(profile, here.offset, width, times, **cells), None
    if in_pieces:
        cut, more = _from_breakpoints(
            num_taps,
            profile,
            tau,
            velocity,
            x,
            is_free=is_free,
            times=times,
            boundaries=boundaries,
            run=run,
        )
        exposure = exposure.at[cut.place].add(
            more, mode="promise_in_bounds", wrap_negative_indices=False
        )
    return exposure, width, cut


def _free_exposure(
    profile: AbstractPiecewiseShutter,
    motion: FreeMotion,
    speed: Float[Array, ""],
    taps: _Taps,
    num_runs: int,
) -> Float[Array, "n"]:
    """Exposure of each tap, in units of tau, on a free path of `num_runs` runs."""
    num_taps, edges, shift, from_vertex = taps
    ends = motion.piece_ends
    refined_profile, place = refined(profile, ends, np.dtype(speed.dtype))
    parameters = path_parameters(
        motion, speed_on_sensor(speed, motion.velocity.astype(speed.dtype))
    )
    tau = jax.lax.stop_gradient(refined_profile.ends)
    track = free_path(parameters, ends, tau, place, from_lowest=from_vertex)
    smooth_path = differentiable_path(parameters, ends, track, tau, place, from_vertex=from_vertex)
    rows = DoubleWord(*(jnp.broadcast_to(x, edges.high.shape)[: num_taps + 1] for x in edges))
    primal_edges = add(jax.lax.stop_gradient(rows), track.lowest)

    def run_exposure(run: MonotoneRun) -> Array:
        """Exposure of one run; a run of negative acceleration is mirrored first."""
        is_mirrored = run.sign < 0

        def mirrored(x: Array) -> Array:
            return jnp.where(is_mirrored, -x[::-1], x)

        own_track = track.mirrored(run.sign)
        own_edges = DoubleWord(*(mirrored(x)[None] for x in primal_edges))
        x, speed, is_held = free_crossings(own_track, run, tau, own_edges)
        gap, (u, v) = _gaps(num_taps, own_edges), (speed[k] for k in parts(num_taps))
        sag = looked_up(own_track.sag, x.piece)[parts(num_taps)[1]]
        exposure, width, cut = _branch_exposures(
            num_taps,
            refined_profile,
            refined_profile.ends,
            own_track.velocity,
            x,
            within=time_between(gap, u, v, sag),
            is_held=is_held,
            times=BoundaryTimes(refined_profile.ends.high),
            from_vertex=from_vertex,
            run=run,
        )
        primal = KernelPrimal(refined_profile, tau, x, own_edges.high, gap, width, is_held, cut)
        exposure = attach_path_jvp(
            sum_over_branches(exposure),
            jax.tree.map(lambda x: run.sign * x, smooth_path),
            mirrored(rows.high),
            run.sign * shift,
            track=own_track,
            primal=jax.lax.stop_gradient(primal),
        )
        exposure = jnp.where(is_mirrored, exposure[::-1], exposure)
        # The number of runs is static, so that a path that changes may leave some of them empty.
        return jnp.where(run.past > run.first, exposure, 0.0)

    all_runs = runs(parameters.accelerations, place, num_runs)
    if num_runs == 1:
        return run_exposure(jax.tree.map(lambda x: x[0], all_runs))
    return jnp.sum(jax.vmap(run_exposure)(all_runs), axis=0)


def _places(x: Crossings, tau: DoubleWord) -> tuple[np.ndarray, np.ndarray, int]:
    """Indices of crossings, of breakpoints and of the constant among `BoundaryTimes.moments`."""
    constant = x.moment.size + tau.high.size
    index = np.arange(constant, dtype=np.int32)
    return index[: x.moment.size].reshape(x.moment.shape), index[x.moment.size :], constant


def _from_breakpoints(
    num_taps: int,
    profile: AbstractPiecewiseShutter,
    tau: DoubleWord,
    velocity: Array,
    x: Crossings,
    *,
    is_free: Array,
    times: BoundaryTimes,
    boundaries: CellBoundaries,
    run: MonotoneRun | None,
) -> tuple[BreakpointCells, Array]:
    """Cells that start at breakpoints, and their exposure."""
    breakpoint = jnp.arange(1, tau.high.size - 1, dtype=jnp.int32)
    is_after = velocity[1:-1] >= 0
    branch = is_after.astype(jnp.int32)
    outwards = jnp.where(AFTER, x.piece, -x.piece)
    # The pieces of the crossings tell which tap holds a breakpoint. Positions would tell it too,
    # but by rounding might contradict the pieces where the two nearly meet.
    edge = _num_below(outwards, is_after, jnp.where(is_after, breakpoint, 1 - breakpoint))
    exists = (edge > 0) & (edge <= num_taps)
    if run is not None:
        exists &= (breakpoint > run.first) & (breakpoint < run.past)
    end = branch, jnp.clip(edge, 1, num_taps)
    place = branch, end[1] - 1
    there, moves = x.part(end).by_breakpoints(tau.high), is_free[place]
    piece = breakpoint - 1 + branch
    length = at(lengths(profile.equal_pieces, tau), piece)
    width = jnp.where(there.piece == piece, there.inner(is_after, length), length)
    width = materialised(jnp.where(moves, jax.lax.stop_gradient(width), width))
    # Under `vmap` a value must be batched wherever its derivative is.
    zero = jnp.where(moves, jnp.zeros_like(width), 0.0)
    offset = with_tangent(zero, jnp.where(moves, -tau.high[1:-1], 0.0))
    start = there._replace(piece=piece, from_left=is_after, offset=offset)
    _, places, constant = _places(x, tau)
    next_breakpoint = jnp.where(moves, jnp.where(is_after, places[2:], places[:-2]), constant)
    crossing = x.moment.shape[1] * branch + end[1]
    boundaries = boundaries._replace(
        begin=jnp.where(moves, places[1:-1], constant),
        end=jnp.where(there.piece == piece, crossing, next_breakpoint),
    )
    cells = jax.lax.stop_gradient({"start": start, "is_after": is_after, "boundaries": boundaries})
    exposure = cell_exposure(profile, offset, width, times, **cells)
    exposure = attach_breakpoint_jvp(exposure, tau.high[1:-1], profile, moves=moves)
    cut = BreakpointCells(place, exists, start, is_after, width)
    return cut, jnp.where(exists, exposure, 0.0)


def _num_below(rows: Array, is_second: Array, value: Array) -> Array:
    """Number of entries below each value in one of two ascending rows; shape of `value`."""
    if rows.shape[1] <= _FEW_TAPS:
        row = jnp.where(is_second[:, None], rows[1:], rows[:1])
        return jnp.sum(row < value[:, None], axis=1, dtype=jnp.int16).astype(jnp.int32)
    search = partial(jnp.searchsorted, v=value, method="scan")
    first, second = jax.vmap(search)(rows)
    return jnp.where(is_second, second, first)
