r"""How the exposure of taps changes with the motion, the edges and the breakpoints.

On a branch a tap holds the integral of the transmittance $w$ from one crossing, at $\tau_1$,
to the next, at $\tau_2$. It changes by the transmittance at each crossing, times how far that
crossing moves: $w_2\,d\tau_2 - w_1\,d\tau_1$. In a narrow tap these two terms nearly cancel,
so the change is written as $w\,d\Delta\tau + (w_2 - w_1)\,d\tau$, where $w_2 - w_1$ is the sum
of the slopes of the tap's cells, times their widths, and of the steps between them. There $w$
is the transmittance at the darker crossing and $\tau$ the time of the other one, because a
crossing near the vertex moves without bound, which has no effect under a closed shutter. A tap
that holds an end of the exposure has one crossing that moves, and changes by that one.

All crossings of a slow object drift with its vertex, by the same time. Under a symmetric
profile the effects of the drift on the two branches nearly cancel. Their sum follows from the
rise of the profile between a crossing on one branch and the mirror image of that on the other,
$w(\nu + r) - w(\nu - r) = \int_{r - \nu}^{r + \nu} w'$, and is computed as that integral.

The rates of change by every parameter are computed together, in forward mode. The derivative is
their product with the changes, so that reverse mode is one sum a parameter and never goes back
through the formulae. `docs/derivation.md` derives them.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import DoubleWord
from mishutter.blur.crossings import (
    AFTER,
    Crossings,
    at,
    by_rule_alone,
    displaced,
    drift_change,
    moment_change,
    of_both_arms,
    passed,
    passing_change,
    time_between,
)
from mishutter.blur.trajectory import Motion, mirrored_velocity, once, speed_change
from mishutter.model import AbstractPiecewiseShutter, within_unit

_ASIDE = float(np.sqrt(1 / 12))
"""Distance of the two Gauss-Legendre nodes from an interval's middle, in units of its length."""


class Cells(NamedTuple):
    """Cells that start at breakpoints: branch and tap, whether they lie in any tap, and width."""

    place: tuple[Array, Array]
    exists: Array
    start: Crossings
    is_after: Array
    width: Array


class Taps(NamedTuple):
    """Values that the rates follow from, besides the motion.

    `tau` are the breakpoints, `x` the crossings and `edges` the edges, `(1, n + 1)`. `gap` is
    the distance between a tap's edges, `(1, n)`, and `width` the duration of the cell that
    begins at its inner edge, `(2, n)`; `cut` are all other cells. `is_held` tells whether a
    crossing is held at an end of the exposure, `(2, n + 1)`.
    """

    profile: AbstractPiecewiseShutter
    tau: DoubleWord
    x: Crossings
    edges: Array
    gap: Array
    width: Array
    is_held: Array
    cut: Cells | None

    @property
    def parts(self) -> tuple[tuple[slice, slice], ...]:
        """Slices of the crossings at which taps begin and end."""
        return parts(self.gap.size)


def parts(num_taps: int) -> tuple[tuple[slice, slice], ...]:
    """Slices at which taps begin and end, in arrays with a row a branch and a column an edge."""
    return (slice(None), slice(0, num_taps)), (slice(None), slice(1, num_taps + 1))


@eqx.filter_custom_jvp
def moving(
    light: Array,
    motion: Motion,
    edges: Array,
    shift: Array,
    profile: AbstractPiecewiseShutter,
    tau: DoubleWord,
    *,
    from_vertex: Array,
    taps: Taps,
) -> Array:
    """Exposure of taps, `(n,)`, with its derivatives by the motion and the edges attached.

    `shift` moves all edges as one and is part of `edges` already. The derivative of the `light`
    itself is that by the profile and its breakpoints, which come beside it for second derivatives.
    """
    return light


@moving.def_jvp
def _moving_jvp(primals, tangents, *, from_vertex, taps):
    light, motion, *_ = primals
    change, by_motion, by_edges, by_shift, *_ = tangents
    same = moving(*primals, from_vertex=from_vertex, taps=taps)
    changes = [] if change is None else [change]
    scalars = enumerate((*(by_motion or (None,) * 3), by_shift))
    steps = {i: step for i, step in scalars if step is not None}
    if not steps and by_edges is None:
        return same, sum(changes[1:], changes[0]) if changes else None
    units = np.eye(5)[[*steps, *(() if by_edges is None else (3, 4))]].astype(light.dtype)
    rates = _rates(from_vertex, jax.lax.stop_gradient(motion), taps, units)
    rates = _bent(rates, *primals[1:], from_vertex=from_vertex, taps=taps, units=units)
    if steps:
        step = jnp.stack([*steps.values()])
        changes.append(jnp.matmul(step, rates[: len(steps)], precision="highest"))
    if by_edges is not None:
        begin, end = by_edges[: light.size], by_edges[1 : light.size + 1]
        changes += [rates[-2] * ((begin + end) / 2), rates[-1] * (end - begin)]
    return same, sum(changes[1:], changes[0])


@eqx.filter_custom_jvp
def _bent(
    rates: Array,
    motion: Motion,
    edges: Array,
    shift: Array,
    profile: AbstractPiecewiseShutter,
    tau: DoubleWord,
    *,
    from_vertex: Array,
    taps: Taps,
    units: ArrayLike,
) -> Array:
    """Rates of light, `(m, n)`, with derivatives of every order attached: those of `_plain_rates`.

    In reverse mode they are differentiated like any formula, which no first derivative asks for.
    """
    return by_rule_alone(rates, (motion, edges, shift))


@_bent.def_jvp
def _bent_jvp(primals, tangents, *, from_vertex, taps, units):
    plain = partial(_plain_rates, from_vertex=from_vertex, taps=taps, units=units)
    _, change = eqx.filter_jvp(plain, primals[1:], tangents[1:])
    return _bent(*primals, from_vertex=from_vertex, taps=taps, units=units), change


def _plain_rates(
    motion: Motion,
    edges: Array,
    shift: Array,
    profile: AbstractPiecewiseShutter,
    tau: DoubleWord,
    *,
    from_vertex: Array,
    taps: Taps,
    units: ArrayLike,
) -> Array:
    r"""What `_rates` computes, as the difference $w_2\,d\tau_2 - w_1\,d\tau_1$; shape `(m, n)`.

    Narrow taps cancel in it, and so in its derivative: of `n` taps one loses as many digits as `n`
    has, and those of an edge near the vertex lose none.
    """
    a, T, s = motion
    path = from_vertex, a * T * T, s * T
    moment, velocity = _passed(motion, edges, shift, from_vertex, taps.x)
    since = moment - at(tau.high, taps.x.nearest)
    offset = displaced(taps.x.offset, jnp.where(taps.is_held, 0.0, since))
    light = transmittance_at(profile, taps.x._replace(offset=offset))
    light = jnp.where(taps.is_held, 0.0, jnp.where(AFTER, light, -light))

    def rate(unit):
        da, dT, ds, shift, stretch = unit
        changes = T * (T * da + 2 * a * dT), T * ds + s * dT
        first, last = (
            passing_change(*path, moment, velocity, *changes, moved)
            for moved in (shift - stretch / 2, shift + stretch / 2)
        )
        begin, end = taps.parts
        return of_both_arms(light[end] * last[end] - light[begin] * first[begin])

    return jax.vmap(rate)(jnp.asarray(units))


def _rates(from_vertex: Array, motion: Motion, taps: Taps, units: np.ndarray) -> Array:
    """Rates of light, `(m, n)`, by what each of `m` rows of `units` changes.

    The columns of `units` are acceleration, half exposure, speed, position of a tap and
    distance between its edges.
    """
    a, T, _ = motion
    # Stores them in memory, because every row of `units` reads them.
    transmittance, rise = once(_transmittance_and_rise, taps)
    lit = jnp.where(taps.is_held, 0.0, transmittance)
    begin, end = (lit[k] for k in taps.parts)
    u, v = (taps.x.velocity[1:][k] for k in taps.parts)
    is_free = ~(taps.is_held[taps.parts[0]] | taps.is_held[taps.parts[1]])
    one_sided = jnp.where(AFTER, end - begin, begin - end)
    inner, outer = (of_both_arms(jnp.where(is_free, w, 0.0)) for w in (begin, end))
    height = jnp.minimum(inner, outer)
    drifting = of_both_arms(jnp.where(is_free, rise, one_sided))
    # Changes other than of speed make crossings drift in proportion to the speed, which is small.
    if taps.profile.symmetric and np.any(units[:, 2]):
        apart = _between_arms(motion)
        is_near = (apart != 0) & (jnp.abs(apart) < _near(taps.profile, apart))
        known, left_over = once(_rise_between_arms, apart, taps, when=is_near)
        drifting = jnp.where(known, left_over, jnp.where(apart == 0, 0.0, drifting))
    mirrored = at(mirrored_velocity(motion, taps.tau), taps.x.nearest)

    def rate(unit):
        by_motion, (shift, stretch) = tuple(unit[:3]), unit[3:]
        moved, faster = [], []
        for k, dedge in zip(taps.parts, (shift - stretch / 2, shift + stretch / 2), strict=True):
            x, change = taps.x.part(k), (by_motion, dedge)
            moved.append(moment_change(from_vertex, motion, x, mirrored[k], *change))
            speed = x.velocity[1:]
            faster.append(speed_change(from_vertex, motion, taps.edges[k], speed, *change))
        higher = T * (by_motion[0] * T + 2 * a * by_motion[1])
        changes = jnp.full_like(taps.gap, stretch), *faster, higher
        _, longer = jax.jvp(time_between, (taps.gap, u, v, a * T * T), changes)
        between = end * moved[1] - begin * moved[0]
        between = jnp.where(AFTER, between, -between)
        # Steps that mirror each other cancel, so the branches are summed first.
        lighter = jnp.where(inner > outer, moved[0], moved[1])
        turned = of_both_arms(jnp.where(is_free, rise * lighter, between))
        return turned + height * longer[0] + drifting * drift_change(motion, by_motion)

    return jax.vmap(rate)(units)


def _passed(
    motion: Motion, edges: Array, shift: Array, from_vertex: Array | bool, x: Crossings
) -> tuple[Array, Array]:
    """Moment and velocity of crossings, with derivatives of every order."""
    a, T, s = motion
    edge = edges[None, : x.moment.shape[1]] + shift
    return passed(from_vertex, a * T * T, s * T, edge, x.moment, x.velocity)


def _transmittance_and_rise(taps: Taps) -> tuple[Array, Array]:
    return transmittance_at(taps.profile, taps.x), rise_over(taps)


def transmittance_at(profile: AbstractPiecewiseShutter, x: Crossings) -> Array:
    """Transmittance at crossings."""
    return mean_about(profile, x, x.offset, jnp.zeros_like(x.offset))


def rise_over(taps: Taps) -> Array:
    """Rise of the transmittance over each tap in the direction of time; shape `(2, n)`."""
    begin = taps.x.part(taps.parts[0])
    rise = _rise(taps.profile, begin, AFTER, taps.width)
    if taps.cut is not None:
        place, exists, start, is_after, width = taps.cut
        more = _rise(taps.profile, start, is_after, width) + steps(taps.profile, width)
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


def _between_arms(motion: Motion) -> Array:
    r"""Time between a crossing and the mirror image of its like on the other branch: $2\nu$."""
    a, T, s = motion
    return jnp.where(a > 0, s / jnp.where(a > 0, a * T, 1.0), jnp.inf)


def _near(profile: AbstractPiecewiseShutter, like: Array) -> Array:
    """Time over which two nodes are enough, and a difference of two slopes is not; scalar."""
    share = float(jnp.finfo(like.dtype).eps) ** 0.2
    return share * jnp.asarray(profile.smooth_length, like.dtype)


def _rise_between_arms(apart: Array, taps: Taps) -> tuple[Array, Array]:
    """Whether a tap's crossings nearly mirror each other, and if so both branches' rise over it."""
    profile, num_pieces = taps.profile, taps.tau.high.size - 1
    before, after = (taps.x.part((arm, slice(None))) for arm in (0, 1))
    mirrored = before.piece + after.piece == num_pieces - 1
    is_held, at_vertex = jnp.any(taps.is_held, axis=0), after.velocity == 0
    known = jnp.where(is_held, jnp.all(taps.is_held, axis=0), mirrored | at_vertex)
    middle = after.offset - apart / 2
    rise = apart * _slope(profile, after, middle, jnp.broadcast_to(jnp.abs(apart), middle.shape))
    rise = jnp.where(is_held | at_vertex, 0.0, rise)

    # The rises at the two edges of a narrow tap nearly cancel: a tap that lies in one piece takes
    # the integral of the curvature between them instead of their difference.
    (_, begin), (_, end) = taps.parts
    inside = mirrored & ~is_held
    whole = inside[begin] & inside[end] & (after.piece[begin] == after.piece[end])
    start, width = after.part((begin,)), taps.width[1]
    slope, centre = partial(_slope, profile, start, width=width), middle[begin] + width / 2
    bends = [_derivative(slope, centre + place * apart) for place in (-_ASIDE, _ASIDE)]
    both = jnp.where(whole, apart * width * (sum(bends) / 2), rise[end] - rise[begin])
    return known[begin] & known[end], both


def mean_about(
    profile: AbstractPiecewiseShutter, x: Crossings, middle: Array, width: Array
) -> Array:
    """Mean transmittance over a `width` centred at `middle`, which counts as offsets of `x` do."""
    distance = jnp.where(x.from_left, middle, -middle)
    return profile.piece_mean(x.piece, x.from_left, distance, width)


def steps(profile: AbstractPiecewiseShutter, like: Array) -> Array:
    """Steps of the transmittance at the inner breakpoints; steps of a few roundings count as 0."""
    piece = jnp.arange(like.size + 1, dtype=jnp.int32)
    nothing = jnp.zeros(like.size + 1, like.dtype)
    above, below = (
        profile.piece_mean(piece, side, nothing, nothing) for side in (piece >= 0, piece < 0)
    )
    above, below = above[1:], below[:-1]
    rounding = 16 * jnp.finfo(above.dtype).eps * jnp.maximum(above, below)
    return jnp.where(jnp.abs(above - below) > rounding, above - below, 0.0)


@eqx.filter_custom_jvp
def moving_breakpoints(
    light: Array, tau: Array, profile: AbstractPiecewiseShutter, *, moves: Array
) -> Array:
    """Exposure of cells that start at breakpoints, with its derivative by the breakpoints.

    A tap between two crossings changes by each step inside it, times how far the step moves. The
    widths of its cells carry no derivative, as the contributions of neighbours would cancel. The
    profile comes beside them for second derivatives.
    """
    return light


@moving_breakpoints.def_jvp
def _moving_breakpoints_jvp(primals, tangents, *, moves):
    light, _, profile = primals
    change, by_tau, _ = tangents
    changes = [] if change is None else [change]
    if by_tau is not None:
        changes.append(-jnp.where(moves, steps(profile, light) * by_tau, 0.0))
    same = moving_breakpoints(*primals, moves=moves)
    return same, sum(changes[1:], changes[0]) if changes else None


class Clock(NamedTuple):
    """Moments at which cells begin and end, of which only derivatives are taken.

    These are the crossings, which move with the motion, the edges and their shift, or stay where
    there are none; then the breakpoints; and last a moment that stays.
    """

    tau: Array
    passing: tuple[Motion, Array, Array] | None = None

    def moments(self, from_vertex: Array | bool, x: Crossings, is_held: Array) -> Array:
        """All moments in a row."""
        moment = jnp.zeros_like(x.moment)
        if self.passing is not None:
            moment = jnp.where(is_held, 0.0, _passed(*self.passing, from_vertex, x)[0])
        return jnp.concatenate([jnp.ravel(moment), self.tau, jnp.zeros(1, moment.dtype)])


class Times(NamedTuple):
    """Which moments of a clock cells begin and end at, and the crossings that it counts."""

    begin: Array | np.ndarray
    end: Array
    from_vertex: Array | bool
    x: Crossings
    is_held: Array


@eqx.filter_custom_jvp
def cell_light(
    profile: AbstractPiecewiseShutter,
    offset: Array,
    width: Array,
    clock: Clock,
    *,
    start: Crossings,
    is_after: ArrayLike,
    times: Times,
) -> Array:
    """Exposure of cells that begin at an `offset` of `start` and extend outwards over `width`.

    The clock has no effect on first derivatives, to which `moving` adds those by what it shows.
    It is how those by the profile change when cells do.
    """
    return _cell_light(profile, offset, width, start, is_after)


@cell_light.def_jvp
def _cell_light_jvp(primals, tangents, *, start, is_after, times):
    same = cell_light(*primals, start=start, is_after=is_after, times=times)
    if not jax.tree.leaves(tangents[:3]):
        return same, None
    profile, offset, width, clock = primals
    moments = clock.moments(times.from_vertex, times.x, times.is_held)
    begin, end = moments[times.begin], moments[times.end]
    longer = jnp.where(is_after, end - begin, begin - end)
    cells = profile, displaced(offset, begin), displaced(width, longer)
    light = partial(_cell_light, start=start, is_after=is_after)
    return same, eqx.filter_jvp(light, cells, tangents[:3])[1]


def _cell_light(
    profile: AbstractPiecewiseShutter,
    offset: Array,
    width: Array,
    start: Crossings,
    is_after: ArrayLike,
) -> Array:
    start = start._replace(offset=offset)
    mean = mean_about(profile, start, start.halfway(is_after, width), width)
    return width * within_unit(mean)
