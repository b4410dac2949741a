r"""Derivatives of the exposure of taps by a free path.

Where the trajectory changes by $\delta x$ at a fixed time, the crossing of an edge moves by
$d\tau = (de - \delta x)/u$. On a piece $\delta x$ is a parabola, as the trajectory is, whose
coefficients are the changes of position, velocity and acceleration at a breakpoint. A tap
changes by $w_2\,d\tau_2 - w_1\,d\tau_1$ on each branch, which in a narrow tap nearly cancels.
It is written, as in `derivatives.py`, as $w\,d\Delta\tau + (w_2 - w_1)\,d\tau$ with

$$d\Delta\tau = \frac{dy_2 - dy_1}{u_2} - dy_1 \frac{u_2 - u_1}{u_1 u_2},
\qquad dy = de - \delta x,$$

where $\delta x_2 - \delta x_1$ and $u_2 - u_1$ follow from the time between the crossings. The
change is linear in the coefficients, and each tap looks up a few of them: in reverse mode the cost
is that of taps plus pieces.
"""

from bisect import bisect_right
from fractions import Fraction
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

from mishutter._core import DoubleWord
from mishutter.blur.crossings import AFTER, lengths, sum_over_branches
from mishutter.blur.derivatives import KernelPrimal, rise_over, steps, transmittance_at
from mishutter.blur.free_path import FreePath, PathParameters, looked_up, path_bases
from mishutter.blur.trajectory import opaque_to_fusion


class DifferentiablePath(NamedTuple):
    """A trajectory by differentiable formulae, whose tangents are used and whose values are not.

    Attributes:
        sag: Sag $A$ of each piece; px.
        velocity: Velocity at breakpoints; px per half exposure.
        position: Position of breakpoints; px.
        vertex: Turning point of each piece, or its beginning where it has none; px.
        origin: Position that edges count from; px.
    """

    sag: Float[Array, "m"]
    velocity: Float[Array, "m+1"]
    position: Float[Array, "m+1"]
    vertex: Float[Array, "m"]
    origin: Float[Array, ""]


def differentiable_path(
    parameters: PathParameters,
    ends: tuple[Fraction, ...],
    track: FreePath,
    tau: DoubleWord,
    place: Int[Array, "m"],
    *,
    from_vertex: Bool[Array, ""] | bool,
) -> DifferentiablePath:
    """The trajectory at fixed breakpoints `tau`, on a path whose pieces have these `ends`."""
    a, T, (speed, _) = parameters
    sag, smear = a * T * T, speed * T
    # Sums outwards from mid-exposure, so that only the pieces between change a position.
    times = sorted({*ends, Fraction(0)})
    middle, time = times.index(Fraction(0)), np.array(times, float).astype(speed.dtype)
    owner = np.array([bisect_right(ends, x) - 1 for x in times[:-1]])
    later = _outwards(sag[owner[middle:]], np.diff(time[middle:]))
    before = _outwards(sag[owner[:middle]][::-1], np.diff(time[: middle + 1])[::-1])
    index = np.array([times.index(x) for x in ends[:-1]])
    velocity = jnp.concatenate([-before[0][:0:-1], later[0]])[index] - smear
    begins = np.array(ends[:-1], float).astype(speed.dtype)
    position = jnp.concatenate([before[1][:0:-1], later[1]])[index] - smear * begins

    base = path_bases(place)
    offset = jax.lax.stop_gradient(tau.high) - jnp.asarray(begins)[base]
    rate, pace = sag[base], velocity[base]
    position = position[base] + offset * (pace + offset * rate)
    velocity, rate = pace + 2 * offset * rate, rate[:-1]
    # The vertex is an extreme, so that it changes as the position does at a fixed time.
    ahead = time_to_vertex(track)
    vertex = position[:-1] + ahead * (velocity[:-1] + ahead * rate)
    origin = jnp.append(vertex, position[-1])[track.lowest_index]
    return DifferentiablePath(rate, velocity, position, vertex, jnp.where(from_vertex, origin, 0.0))


def _outwards(sag: Array, length: np.ndarray) -> tuple[Array, Array]:
    """Velocity and position from rest at the start of the first piece and at the end of each."""
    start = jnp.zeros(1, sag.dtype)
    velocity = jnp.append(start, jnp.cumsum(2 * sag * length))
    return velocity, jnp.append(start, jnp.cumsum(length * (velocity[:-1] + sag * length)))


def time_to_vertex(track: FreePath) -> Array:
    """Time from the beginning of each piece to its turning point, 0 without one; shape `(m,)`."""
    turns = track.turns
    rate = jnp.where(turns, 2 * track.sag, 1.0)
    return jnp.where(turns, -track.velocity[:-1] / rate, 0.0)


@eqx.filter_custom_jvp
def attach_path_jvp(
    exposure: Array,
    smooth_path: DifferentiablePath,
    edges: Array,
    shift: Array,
    *,
    track: FreePath,
    primal: KernelPrimal,
) -> Array:
    """Exposure of taps, `(n,)`, with its first derivatives by the path and the edges attached.

    `shift` moves all edges together, and `edges` include it.
    """
    return exposure


@attach_path_jvp.def_jvp
def _attach_path_jvp_rule(primals, tangents, *, track, primal):
    exposure = primals[0]
    change, by_path, by_edges, by_shift = tangents
    same = attach_path_jvp(*primals, track=track, primal=primal)
    changes = [] if change is None else [first_derivative(change, primals[1:])]
    if jax.tree.leaves(tangents[1:]):
        still = jnp.zeros((1, exposure.size + 1), exposure.dtype)
        d_edges = still if by_edges is None else by_edges[None]
        zeros = jax.tree.map(jnp.zeros_like, primals[1])
        rows = (None,) * len(zeros) if by_path is None else by_path
        pairs = zip(rows, zeros, strict=True)
        by = DifferentiablePath(*(zero if row is None else row for row, zero in pairs))
        path_change = _change(track, primal, by, d_edges, 0.0 if by_shift is None else by_shift)
        changes.append(first_derivative(path_change, primals))
    return same, sum(changes[1:], changes[0]) if changes else None


def first_derivative(change: Array, moved_by: PyTree) -> Array:
    """A change of exposure whose derivative by `moved_by` is an error; JAX would return 0."""
    point = _differentiated(moved_by)
    # Adds 0, because JAX drops values that nothing uses, and the error with them.
    return change * (1 + 0 * sum(jnp.sum(jnp.sign(x)) for x in jax.tree.leaves(point)))


@jax.custom_jvp
def _differentiated(moved_by: PyTree) -> PyTree:
    """The point of a derivative; differentiating it raises an error."""
    return moved_by


@_differentiated.defjvp
def _differentiated_again(primals, tangents):
    raise NotImplementedError(
        "Light on a free path must be differentiated once by the motion, the edges and the phase, "
        "and not by the shutter as well; got a second derivative."
    )


def _change(
    track: FreePath,
    primal: KernelPrimal,
    by: DifferentiablePath,
    by_edge: Array,
    by_shift: Array | float,
) -> Array:
    """Change of the exposure of each tap, `(n,)`, linear in the changes of path and edges."""
    x, (first, second) = primal.x, primal.parts
    # A tap may extend over the join of two runs: each takes the join to move with the tap's edges.
    last = primal.tau.high.size - 1
    jumps = jnp.pad(steps(primal.profile, primal.tau.high[1:-1]) != 0, 1, constant_values=True)
    joins = primal.is_held & ~looked_up(jumps, x.nearest)
    is_held, at_vertex = primal.is_held & ~joins, x.velocity == 0
    is_fixed = is_held | at_vertex
    pace = jnp.where(is_fixed, 1.0, x.velocity)
    # Both runs read the transmittance at a join in one piece: read from either side, it might
    # differ by rounding, and so would what the runs share.
    after = x._replace(
        piece=jnp.where(joins, jnp.minimum(x.nearest, last - 1), x.piece),
        from_left=joins | x.from_left,
    )
    transmittance = opaque_to_fusion(transmittance_at, primal.profile, after)

    # Next to the vertex that edges count from, a crossing changes only with the path between.
    turns = looked_up(track.turns, x.piece) & ~joins
    sag = looked_up(track.sag, x.piece)
    since = jnp.where(turns, x.velocity / jnp.where(turns, 2 * sag, 1.0), x.offset)
    ahead = looked_up(time_to_vertex(track), x.piece)
    d_begin, d_sag = looked_up(by.velocity, x.piece), looked_up(by.sag, x.piece)
    d_pace = jnp.where(turns, d_begin + 2 * ahead * d_sag, looked_up(by.velocity, x.nearest))
    own = jnp.arange(track.turns.size) == track.lowest_index
    low = jnp.where(own & track.from_lowest, 0.0, by.vertex - by.origin)
    base = jnp.where(turns, looked_up(low, x.piece), looked_up(by.position - by.origin, x.nearest))
    displacement = by_shift - (base + since * (d_pace + since * d_sag))
    d_velocity = d_pace + 2 * since * d_sag
    middle = (by_edge[first] + by_edge[second]) / 2
    edges = [jnp.where(joins[k], middle, by_edge[k]) for k in (first, second)]
    moments = [
        jnp.where(is_fixed[k], 0.0, (displacement[k] + edge) / pace[k])
        for k, edge in zip((first, second), edges, strict=True)
    ]

    # Adds up changes from one crossing to the next, over the breakpoints between them.
    sign = jnp.where(AFTER, 1, -1).astype(primal.gap.dtype)
    begin, end = x.part(first), x.part(second)
    length = looked_up(lengths(False, primal.tau), x.piece)
    to_end = sign * x.outer(AFTER, length)[first]
    from_start = sign * x.inner(AFTER, length)[second]
    leaving = begin.piece + np.array([[0], [1]], np.int32)
    entering = end.piece + np.array([[1], [0]], np.int32)
    d_distance = looked_up(by.position, entering) - looked_up(by.position, leaving)
    d_distance += from_start * (looked_up(by.velocity, entering) + from_start * d_sag[second])
    d_distance += to_end * (looked_up(by.velocity, leaving) - to_end * d_sag[first])
    gain = looked_up(track.velocity, entering) - looked_up(track.velocity, leaving)
    gain += 2 * (from_start * sag[second] + to_end * sag[first])
    in_one_piece, duration = begin.piece == end.piece, sign * primal.width
    mean_velocity = (d_velocity[first] + d_velocity[second]) / 2
    # In one piece both differences are in proportion to the time between, with nothing left to
    # cancel.
    d_distance = jnp.where(in_one_piece, duration * mean_velocity, d_distance)
    gain = jnp.where(in_one_piece, 2 * sag[first] * duration, gain)
    d_duration = ((edges[1] - edges[0]) - d_distance) / pace[second] - moments[0] * (
        gain / pace[second]
    )

    inner, outer = (jnp.where(is_held, 0.0, transmittance)[k] for k in (first, second))
    is_free = ~(is_fixed[first] | is_fixed[second])
    one_sided = sign * (outer * moments[1] - inner * moments[0])
    brighter = jnp.where(inner > outer, *moments)
    rise = opaque_to_fusion(rise_over, primal)
    both = sign * jnp.minimum(inner, outer) * d_duration + rise * brighter
    return sum_over_branches(jnp.where(is_free, both, one_sided))
