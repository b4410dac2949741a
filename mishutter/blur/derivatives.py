r"""Derivatives of the exposure of taps by the motion, the edges and the breakpoints.

On a branch a tap holds the integral of the transmittance $w$ from one crossing, at $\tau_1$,
to the next, at $\tau_2$. It changes by the transmittance at each crossing, times the motion of that
crossing: $w_2\,d\tau_2 - w_1\,d\tau_1$. In a narrow tap these two terms nearly cancel,
so the change is written as $w\,d\Delta\tau + (w_2 - w_1)\,d\tau$, where $w_2 - w_1$ is the sum
of the slopes of the tap's cells, times their widths, and of the steps between them. There $w$
is the transmittance at the darker crossing and $\tau$ the time of the other one, because a
crossing near the vertex moves without bound, which has no effect under a closed shutter. In a tap
that holds an end of the exposure only one crossing moves.

All crossings of a slow object drift with its vertex, by the same time. Under a symmetric
profile the effects of the drift on the two branches nearly cancel. Their sum is the rise of the
profile between a crossing on one branch and the mirror image of that on the other,
$w(\nu + r) - w(\nu - r) = \int_{r - \nu}^{r + \nu} w'$, and is computed as that integral.

Forward mode computes the rates of change by every parameter together. The derivative is their
product with the changes, so that reverse mode is one sum a parameter and does not go back through
the formulae. `docs/derivation.md` derives them.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from mishutter._core import DoubleWord
from mishutter.blur.crossings import (
    AFTER,
    Crossings,
    Parabola,
    Passage,
    at,
    crossing_time,
    crossing_time_change,
    drift_change,
    moment_change,
    parabola_of,
    sum_over_branches,
    time_between,
    with_nan_tangent,
    with_tangent,
)
from mishutter.blur.trajectory import (
    Motion,
    PathChange,
    mirrored_velocity,
    opaque_to_fusion,
    speed_change,
)
from mishutter.model import AbstractPiecewiseShutter, within_unit

_ASIDE = float(np.sqrt(1 / 12))
"""Distance of the two Gauss-Legendre nodes from an interval's middle, in units of its length."""


class BreakpointCells(NamedTuple):
    """Cells that start at breakpoints.

    `place` holds the branch and the tap of each, `exists` whether it lies in any tap, `start` its
    beginning, `is_after` its branch as in `AFTER`, and `width` its duration.
    """

    place: tuple[Int[Array, "cells"], Int[Array, "cells"]]
    exists: Bool[Array, "cells"]
    start: Crossings
    is_after: Bool[Array, "cells"]
    width: Float[Array, "cells"]


class KernelPrimal(NamedTuple):
    """Intermediate values of a kernel from which its derivatives are computed.

    `tau` are the breakpoints, `x` the crossings and `edges` the edges. `gap` is the distance
    between a tap's edges, and `width` the duration of the cell that begins at its inner edge;
    `cut` are all other cells. `is_held` tells whether a crossing is held at an end of the exposure.
    """

    profile: AbstractPiecewiseShutter
    tau: DoubleWord
    x: Crossings
    edges: Float[Array, "1 edges"]
    gap: Float[Array, "1 taps"]
    width: Float[Array, "2 taps"]
    is_held: Bool[Array, "2 edges"]
    cut: BreakpointCells | None

    @property
    def parts(self) -> tuple[tuple[slice, slice], ...]:
        """Slices of the crossings at which taps begin and end."""
        return parts(self.gap.size)


def parts(num_taps: int) -> tuple[tuple[slice, slice], ...]:
    """Slices of the edges at which taps begin and end, in arrays of branches by edges."""
    return (slice(None), slice(0, num_taps)), (slice(None), slice(1, num_taps + 1))


class KernelInputs(NamedTuple):
    """The numbers on which a kernel depends.

    Attributes:
        motion: Motion of the point.
        edges: Edges of the taps, which include the shift; px.
        shift: Change of position of all edges together; px.
        profile: The shutter.
        tau: Its breakpoints.
    """

    motion: Motion
    edges: Float[Array, "edges"]
    shift: Float[Array, "..."]
    profile: AbstractPiecewiseShutter
    tau: DoubleWord


@eqx.filter_custom_jvp
def attach_motion_jvp(
    exposure: Array, inputs: KernelInputs, *, from_vertex: Array, primal: KernelPrimal
) -> Array:
    """Exposure of taps, `(n,)`, with its derivatives by the motion and the edges attached.

    The tangent of the `exposure` itself is that by the profile and its breakpoints; these are
    among the inputs for second derivatives alone.
    """
    return exposure


@attach_motion_jvp.def_jvp
def _attach_motion_jvp_rule(primals, tangents, *, from_vertex, primal):
    exposure, inputs = primals
    change, by_inputs = tangents
    by_motion, by_edges, by_shift, *_ = by_inputs
    same = attach_motion_jvp(*primals, from_vertex=from_vertex, primal=primal)
    changes = [] if change is None else [change]
    scalars = enumerate((*by_motion, by_shift))
    steps = {i: step for i, step in scalars if step is not None}
    if not steps and by_edges is None:
        return same, sum(changes[1:], changes[0]) if changes else None
    # Rates are computed only by those inputs that have a tangent.
    units = np.eye(5)[[*steps, *(() if by_edges is None else (3, 4))]].astype(exposure.dtype)
    rates = _rates(from_vertex, jax.lax.stop_gradient(inputs.motion), primal, units)
    rates = _second_order_rates(rates, inputs, from_vertex=from_vertex, primal=primal, units=units)
    if steps:
        step = jnp.stack([*steps.values()])
        # An accelerator would by default multiply with fewer digits.
        changes.append(jnp.matmul(step, rates[: len(steps)], precision="highest"))
    if by_edges is not None:
        # A tap takes the changes of its place and width, because those by its two edges nearly
        # cancel where it is narrow.
        begin, end = by_edges[: exposure.size], by_edges[1 : exposure.size + 1]
        changes += [rates[-2] * ((begin + end) / 2), rates[-1] * (end - begin)]
    return same, sum(changes[1:], changes[0])


@eqx.filter_custom_jvp
def _second_order_rates(
    rates: Array,
    inputs: KernelInputs,
    *,
    from_vertex: Array,
    primal: KernelPrimal,
    units: ArrayLike,
) -> Array:
    """`_rates`, `(m, n)`, with derivatives of every order attached: those of `_plain_rates`.

    Only second derivatives go back through them in reverse mode.
    """
    return with_nan_tangent(rates, (inputs.motion, inputs.edges, inputs.shift))


@_second_order_rates.def_jvp
def _second_order_rates_jvp(primals, tangents, *, from_vertex, primal, units):
    plain = partial(_plain_rates, from_vertex=from_vertex, primal=primal, units=units)
    _, change = eqx.filter_jvp(plain, primals[1:], tangents[1:])
    return _second_order_rates(
        *primals, from_vertex=from_vertex, primal=primal, units=units
    ), change


def _plain_rates(
    inputs: KernelInputs, *, from_vertex: Array, primal: KernelPrimal, units: ArrayLike
) -> Array:
    r"""The `_rates` as the difference $w_2\,d\tau_2 - w_1\,d\tau_1$; shape `(m, n)`.

    The two terms nearly cancel in a narrow tap, and so do their derivatives: among `n` taps one
    loses as many digits as `n` has. Taps near the vertex lose none.
    """
    a, T, s = inputs.motion
    passage = _crossing_time(inputs.motion, inputs.edges, inputs.shift, from_vertex, primal.x)
    since = passage.moment - at(inputs.tau.high, primal.x.nearest)
    offset = with_tangent(primal.x.offset, jnp.where(primal.is_held, 0.0, since))
    w = transmittance_at(inputs.profile, primal.x._replace(offset=offset))
    # A crossing that is held at an end of the exposure does not move.
    w = jnp.where(primal.is_held, 0.0, jnp.where(AFTER, w, -w))

    def rate(unit):
        da, dT, ds, shift, stretch = unit
        d_parabola = Parabola(T * (T * da + 2 * a * dT), T * ds + s * dT)
        change = partial(
            crossing_time_change, from_vertex, parabola_of(inputs.motion), passage, d_parabola
        )
        first, last = change(shift - stretch / 2), change(shift + stretch / 2)
        begin, end = primal.parts
        return sum_over_branches(w[end] * last[end] - w[begin] * first[begin])

    return jax.vmap(rate)(jnp.asarray(units))


def _rates(from_vertex: Array, motion: Motion, primal: KernelPrimal, units: np.ndarray) -> Array:
    """Rates of change of each tap's exposure along each row of `units`; shape `(m, n)`.

    The columns of `units` are acceleration, half exposure, speed, position of a tap and
    distance between its edges.
    """
    a, T, _ = motion
    # Stores both in memory, because every row of `units` reads them.
    transmittance, rise = opaque_to_fusion(
        lambda p: (transmittance_at(p.profile, p.x), rise_over(p)), primal
    )
    transmittance = jnp.where(primal.is_held, 0.0, transmittance)
    begin, end = (transmittance[k] for k in primal.parts)
    u, v = (primal.x.velocity[1:][k] for k in primal.parts)
    is_free = ~(primal.is_held[primal.parts[0]] | primal.is_held[primal.parts[1]])
    one_sided = jnp.where(AFTER, end - begin, begin - end)
    inner, outer = (sum_over_branches(jnp.where(is_free, w, 0.0)) for w in (begin, end))
    # The darker end counts: the time in which a tap is passed may change without bound next to the
    # vertex, which has no effect where the shutter is closed.
    height = jnp.minimum(inner, outer)
    drifting = sum_over_branches(jnp.where(is_free, rise, one_sided))
    # The drift by anything but the speed is proportional to the speed, and the speed is small here.
    if primal.profile.symmetric and np.any(units[:, 2]):
        apart = _between_branches(motion)
        is_near = (apart != 0) & (jnp.abs(apart) < _near(primal.profile, apart))
        is_mirrored, difference = opaque_to_fusion(
            _rise_between_branches, apart, primal, when=is_near
        )
        drifting = jnp.where(is_mirrored, difference, jnp.where(apart == 0, 0.0, drifting))
    mirrored = at(mirrored_velocity(motion, primal.tau), primal.x.nearest)

    def rate(unit):
        by_motion, (shift, stretch) = Motion(*unit[:3]), unit[3:]
        delays, gains = [], []
        for k, dedge in zip(primal.parts, (shift - stretch / 2, shift + stretch / 2), strict=True):
            x, change = primal.x.part(k), PathChange(by_motion, dedge)
            delays.append(moment_change(from_vertex, motion, x, mirrored[k], change))
            speed = x.velocity[1:]
            gains.append(speed_change(from_vertex, motion, primal.edges[k], speed, change))
        d_sag = T * (by_motion.acceleration * T + 2 * a * by_motion.half_exposure)
        changes = jnp.full_like(primal.gap, stretch), *gains, d_sag
        _, d_duration = jax.jvp(time_between, (primal.gap, u, v, a * T * T), changes)
        between = end * delays[1] - begin * delays[0]
        between = jnp.where(AFTER, between, -between)
        # Steps that mirror each other cancel, so the branches are summed first.
        brighter = jnp.where(inner > outer, delays[0], delays[1])
        d_place = sum_over_branches(jnp.where(is_free, rise * brighter, between))
        return d_place + height * d_duration[0] + drifting * drift_change(motion, by_motion)

    return jax.vmap(rate)(units)


def _crossing_time(
    motion: Motion, edges: Array, shift: Array, from_vertex: Array | bool, x: Crossings
) -> Passage:
    """Moment and velocity of crossings, with derivatives of every order."""
    edge = edges[None, : x.moment.shape[1]] + shift
    return crossing_time(from_vertex, parabola_of(motion), edge, Passage(x.moment, x.velocity))


def transmittance_at(profile: AbstractPiecewiseShutter, x: Crossings) -> Array:
    """Transmittance at crossings."""
    return mean_about(profile, x, x.offset, jnp.zeros_like(x.offset))


def rise_over(primal: KernelPrimal) -> Array:
    """Rise of the transmittance over each tap, in the direction of time; shape `(2, n)`."""
    begin = primal.x.part(primal.parts[0])
    rise = _rise(primal.profile, begin, AFTER, primal.width)
    if primal.cut is not None:
        place, exists, start, is_after, width = primal.cut
        more = _rise(primal.profile, start, is_after, width) + steps(primal.profile, width)
        rise = rise.at[place].add(
            jnp.where(exists, more, 0.0), mode="promise_in_bounds", wrap_negative_indices=False
        )
    return rise


def _rise(
    profile: AbstractPiecewiseShutter, start: Crossings, is_after: ArrayLike, width: Array
) -> Array:
    """Rise of the transmittance over cells that extend outwards: their width times the slope."""
    return width * _slope(profile, start, start.halfway(is_after, width), width)


def _slope(profile: AbstractPiecewiseShutter, x: Crossings, middle: Array, width: Array) -> Array:
    """Mean slope of the transmittance over the interval that `mean_about` takes."""
    return _derivative(partial(mean_about, profile, x, width=width), middle)


def _derivative(function: Callable[[Array], Array], at: Array) -> Array:
    return jax.jvp(function, (at,), (jnp.ones_like(at),))[1]


def _between_branches(motion: Motion) -> Array:
    r"""Time between a crossing and the mirror image of that on the other branch, $2\nu$; scalar."""
    a, T, s = motion
    return jnp.where(a > 0, s / jnp.where(a > 0, a * T, 1.0), jnp.inf)


def _near(profile: AbstractPiecewiseShutter, like: Array) -> Array:
    """Longest time that a rule of two nodes integrates, and over which slopes cancel; scalar."""
    # The error of two Gauss-Legendre nodes is in proportion to the fifth power of the length.
    share = float(jnp.finfo(like.dtype).eps) ** 0.2
    return share * jnp.asarray(profile.smooth_length, like.dtype)


def _rise_between_branches(apart: Array, primal: KernelPrimal) -> tuple[Array, Array]:
    """Whether a tap's crossings nearly mirror each other, and both branches' rise over it if so."""
    profile, num_pieces = primal.profile, primal.tau.high.size - 1
    before, after = (primal.x.part((branch, slice(None))) for branch in (0, 1))
    mirrored = before.piece + after.piece == num_pieces - 1
    is_held, at_vertex = jnp.any(primal.is_held, axis=0), after.velocity == 0
    is_mirrored = jnp.where(is_held, jnp.all(primal.is_held, axis=0), mirrored | at_vertex)
    middle = after.offset - apart / 2
    rise = apart * _slope(profile, after, middle, jnp.broadcast_to(jnp.abs(apart), middle.shape))
    # At the vertex the branches meet, and the light there is the same on both.
    rise = jnp.where(is_held | at_vertex, 0.0, rise)

    # The rises at the two edges of a narrow tap nearly cancel, so a tap in one piece takes the
    # integral of the curvature between them instead of their difference.
    (_, begin), (_, end) = primal.parts
    inside = mirrored & ~is_held
    in_one_piece = inside[begin] & inside[end] & (after.piece[begin] == after.piece[end])
    start, width = after.part((begin,)), primal.width[1]
    slope, centre = partial(_slope, profile, start, width=width), middle[begin] + width / 2
    curvatures = [_derivative(slope, centre + place * apart) for place in (-_ASIDE, _ASIDE)]
    both = jnp.where(in_one_piece, apart * width * (sum(curvatures) / 2), rise[end] - rise[begin])
    return is_mirrored[begin] & is_mirrored[end], both


def mean_about(
    profile: AbstractPiecewiseShutter, x: Crossings, middle: Array, width: Array
) -> Array:
    """Mean transmittance over a `width` centred at `middle`, counted as the offsets of `x` are."""
    distance = jnp.where(x.from_left, middle, -middle)
    return profile.piece_mean(x.piece, x.from_left, distance, width)


def steps(profile: AbstractPiecewiseShutter, like: Array) -> Array:
    """Steps of the transmittance at the inner breakpoints; 0 for steps of a few roundings."""
    piece = jnp.arange(like.size + 1, dtype=jnp.int32)
    zero = jnp.zeros(like.size + 1, like.dtype)
    above, below = (profile.piece_mean(piece, side, zero, zero) for side in (piece >= 0, piece < 0))
    above, below = above[1:], below[:-1]
    # Pieces that meet smoothly differ by rounding, which is no step.
    rounding = 16 * jnp.finfo(above.dtype).eps * jnp.maximum(above, below)
    return jnp.where(jnp.abs(above - below) > rounding, above - below, 0.0)


@eqx.filter_custom_jvp
def attach_breakpoint_jvp(
    exposure: Array, tau: Array, profile: AbstractPiecewiseShutter, *, moves: Array
) -> Array:
    """Exposure of cells that start at breakpoints, with its derivative by the breakpoints attached.

    A tap between two crossings changes by each step inside it, times the motion of the step. The
    widths of its cells carry no derivative, because those of neighbours would cancel. The profile
    is an argument for second derivatives alone.
    """
    return exposure


@attach_breakpoint_jvp.def_jvp
def _attach_breakpoint_jvp_rule(primals, tangents, *, moves):
    exposure, _, profile = primals
    change, by_tau, _ = tangents
    changes = [] if change is None else [change]
    if by_tau is not None:
        changes.append(-jnp.where(moves, steps(profile, exposure) * by_tau, 0.0))
    same = attach_breakpoint_jvp(*primals, moves=moves)
    return same, sum(changes[1:], changes[0]) if changes else None


class BoundaryTimes(NamedTuple):
    """Moments at which cells may begin and end, of which only derivatives are taken.

    These are the crossings, then the breakpoints `tau`, and last a constant, whose tangent is 0.
    Crossings move with `path`, which holds the motion, the edges and their shift; without one they
    are constant too.
    """

    tau: Array
    path: tuple[Motion, Array, Array] | None = None

    def moments(self, from_vertex: Array | bool, x: Crossings, is_held: Array) -> Array:
        """All moments in one row, whose places `CellBoundaries` names."""
        moment = jnp.zeros_like(x.moment)
        if self.path is not None:
            moment = jnp.where(is_held, 0.0, _crossing_time(*self.path, from_vertex, x).moment)
        return jnp.concatenate([jnp.ravel(moment), self.tau, jnp.zeros(1, moment.dtype)])


class CellBoundaries(NamedTuple):
    """Indices of the `BoundaryTimes.moments` at which cells begin and end, and the crossings."""

    begin: Array | np.ndarray
    end: Array
    from_vertex: Array | bool
    x: Crossings
    is_held: Array


@eqx.filter_custom_jvp
def cell_exposure(
    profile: AbstractPiecewiseShutter,
    offset: Array,
    width: Array,
    times: BoundaryTimes,
    *,
    start: Crossings,
    is_after: ArrayLike,
    boundaries: CellBoundaries,
) -> Array:
    """Exposure of cells that begin at an `offset` of `start` and extend outwards over `width`.

    The `times` serve second derivatives, by the profile and a boundary of the cells: first ones by
    the boundaries are added by `attach_motion_jvp`.
    """
    return _cell_exposure(profile, offset, width, start, is_after)


@cell_exposure.def_jvp
def _cell_exposure_jvp(primals, tangents, *, start, is_after, boundaries):
    same = cell_exposure(*primals, start=start, is_after=is_after, boundaries=boundaries)
    if not jax.tree.leaves(tangents[:3]):
        return same, None
    profile, offset, width, times = primals
    moments = times.moments(boundaries.from_vertex, boundaries.x, boundaries.is_held)
    begin, end = moments[boundaries.begin], moments[boundaries.end]
    duration = jnp.where(is_after, end - begin, begin - end)
    cells = profile, with_tangent(offset, begin), with_tangent(width, duration)
    exposure = partial(_cell_exposure, start=start, is_after=is_after)
    return same, eqx.filter_jvp(exposure, cells, tangents[:3])[1]


def _cell_exposure(
    profile: AbstractPiecewiseShutter,
    offset: Array,
    width: Array,
    start: Crossings,
    is_after: ArrayLike,
) -> Array:
    start = start._replace(offset=offset)
    mean = mean_about(profile, start, start.halfway(is_after, width), width)
    return width * within_unit(mean)
