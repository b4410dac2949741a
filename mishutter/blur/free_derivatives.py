r"""How the exposure of taps changes with a free path.

Where the trajectory changes by $\delta x$ at a fixed time, the crossing of an edge moves by
$d\tau = (de - \delta x)/u$. On a piece $\delta x$ is a parabola, as the trajectory is, whose
coefficients are the changes of position, velocity and acceleration at a breakpoint. A tap
changes by $w_2\,d\tau_2 - w_1\,d\tau_1$ on each branch, which in a narrow tap nearly cancels.
It is written, as in `derivatives`, as $w\,d\Delta\tau + (w_2 - w_1)\,d\tau$ with

$$d\Delta\tau = \frac{dy_2 - dy_1}{u_2} - dy_1 \frac{u_2 - u_1}{u_1 u_2},
\qquad dy = de - \delta x,$$

where $\delta x_2 - \delta x_1$ and $u_2 - u_1$ follow from the time between the crossings. The
change is linear in the coefficients, of which each tap looks up a few: in reverse mode the cost
stays that of taps plus pieces.
"""

from bisect import bisect_right
from fractions import Fraction
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import DoubleWord
from mishutter.blur.crossings import AFTER, lengths, of_both_arms
from mishutter.blur.derivatives import Taps, rise_over, steps, transmittance_at
from mishutter.blur.free_path import FreePath, Numbers, looked_up, path_bases
from mishutter.blur.trajectory import once


class Course(NamedTuple):
    """A trajectory by plain formulae, of which only derivatives are taken.

    Attributes:
        stroke: Of each piece; px, shape `(m,)`.
        velocity: At breakpoints; px per half exposure, shape `(m + 1,)`.
        position: At breakpoints; px, shape `(m + 1,)`.
        vertex: Turning point of each piece, or where it begins; px, shape `(m,)`.
        origin: Position that edges count from; px, scalar.
    """

    stroke: Array
    velocity: Array
    position: Array
    vertex: Array
    origin: Array


def course_of(
    given: Numbers,
    ends: tuple[Fraction, ...],
    track: FreePath,
    tau: DoubleWord,
    place: Array,
    from_vertex: Array | bool,
) -> Course:
    """The trajectory at fixed breakpoints `tau`, from a path whose pieces have these `ends`."""
    a, T, speed = given
    stroke, smear = a * T * T, speed * T
    # Outwards from mid-exposure, so that no piece but those on the way changes a place.
    places = sorted({*ends, Fraction(0)})
    middle, time = places.index(Fraction(0)), np.array(places, float).astype(speed.dtype)
    owner = np.array([bisect_right(ends, x) - 1 for x in places[:-1]])
    later = _outwards(stroke[owner[middle:]], np.diff(time[middle:]))
    before = _outwards(stroke[owner[:middle]][::-1], np.diff(time[: middle + 1])[::-1])
    kept = np.array([places.index(x) for x in ends[:-1]])
    velocity = jnp.concatenate([-before[0][:0:-1], later[0]])[kept] - smear
    begins = np.array(ends[:-1], float).astype(speed.dtype)
    position = jnp.concatenate([before[1][:0:-1], later[1]])[kept] - smear * begins

    base = path_bases(place)
    offset = jax.lax.stop_gradient(tau.high) - jnp.asarray(begins)[base]
    rate, pace = stroke[base], velocity[base]
    position = position[base] + offset * (pace + offset * rate)
    velocity, rate = pace + 2 * offset * rate, rate[:-1]
    # Where it turns, a trajectory has an extreme, which changes as the path does at a fixed time.
    ahead = time_to_vertex(track)
    vertex = position[:-1] + ahead * (velocity[:-1] + ahead * rate)
    origin = jnp.append(vertex, position[-1])[track.lowest_index]
    return Course(rate, velocity, position, vertex, jnp.where(from_vertex, origin, 0.0))


def _outwards(stroke: Array, length: np.ndarray) -> tuple[Array, Array]:
    """Gains of speed and position over pieces from rest, at the start and after each."""
    start = jnp.zeros(1, stroke.dtype)
    velocity = jnp.append(start, jnp.cumsum(2 * stroke * length))
    return velocity, jnp.append(start, jnp.cumsum(length * (velocity[:-1] + stroke * length)))


def time_to_vertex(track: FreePath) -> Array:
    """Time from where each piece begins to its turning point, 0 without one; shape `(m,)`."""
    turns = track.turns
    rate = jnp.where(turns, 2 * track.stroke, 1.0)
    return jnp.where(turns, -track.velocity[:-1] / rate, 0.0)


@eqx.filter_custom_jvp
def moving_freely(
    light: Array, course: Course, edges: Array, shift: Array, *, track: FreePath, taps: Taps
) -> Array:
    """Exposure of taps, `(n,)`, with its first derivatives by the path and the edges attached.

    `shift` moves all edges as one and is part of `edges` already.
    """
    return light


@moving_freely.def_jvp
def _moving_freely_jvp(primals, tangents, *, track, taps):
    light = primals[0]
    change, by_course, by_edges, by_shift = tangents
    same = moving_freely(*primals, track=track, taps=taps)
    changes = [] if change is None else [first_derivative(change, primals[1:])]
    if jax.tree.leaves(tangents[1:]):
        apart = jnp.zeros((1, light.size + 1), light.dtype) if by_edges is None else by_edges[None]
        still = jax.tree.map(jnp.zeros_like, primals[1])
        given = (None,) * len(still) if by_course is None else by_course
        pairs = zip(given, still, strict=True)
        by = Course(*(zero if row is None else row for row, zero in pairs))
        by_path = _change(track, taps, by, apart, 0.0 if by_shift is None else by_shift)
        changes.append(first_derivative(by_path, primals))
    return same, sum(changes[1:], changes[0]) if changes else None


def first_derivative(change: Array, moved_by: Any) -> Array:
    """A change of exposure whose own derivative by `moved_by` raises, where it would be 0."""
    known = _differentiated(moved_by)
    # Adds 0. JAX drops values that nothing uses, and would drop the error with them.
    return change * (1 + 0 * sum(jnp.sum(jnp.sign(x)) for x in jax.tree.leaves(known)))


@jax.custom_jvp
def _differentiated(moved_by: Any) -> Any:
    """The point at which a derivative was taken; its own derivative raises an error."""
    return moved_by


@_differentiated.defjvp
def _differentiated_again(primals, tangents):
    raise NotImplementedError(
        "Light on a free path must be differentiated once by the motion, the edges and the phase, "
        "and not by the shutter as well; got a second derivative."
    )


def _change(
    track: FreePath, taps: Taps, by: Course, by_edge: Array, by_shift: Array | float
) -> Array:
    """Change of the light of each tap, `(n,)`, linear in the changes of course and edges."""
    x, (first, second) = taps.x, taps.parts
    # Where one run follows another, a tap goes on: its light there moves as it does beyond.
    last = taps.tau.high.size - 1
    jumps = jnp.pad(steps(taps.profile, taps.tau.high[1:-1]) != 0, 1, constant_values=True)
    joins = taps.is_held & ~looked_up(jumps, x.nearest)
    is_held, at_vertex = taps.is_held & ~joins, x.velocity == 0
    fixed = is_held | at_vertex
    pace = jnp.where(fixed, 1.0, x.velocity)
    after = x._replace(
        piece=jnp.where(joins, jnp.minimum(x.nearest, last - 1), x.piece),
        from_left=joins | x.from_left,
    )
    light = once(transmittance_at, taps.profile, after)

    # Of a crossing next to a vertex from which edges count, only the way from there changes it.
    turns = looked_up(track.turns, x.piece) & ~joins
    rate = looked_up(track.stroke, x.piece)
    since = jnp.where(turns, x.velocity / jnp.where(turns, 2 * rate, 1.0), x.offset)
    ahead = looked_up(time_to_vertex(track), x.piece)
    begin_pace, bend = looked_up(by.velocity, x.piece), looked_up(by.stroke, x.piece)
    there = jnp.where(turns, begin_pace + 2 * ahead * bend, looked_up(by.velocity, x.nearest))
    own = jnp.arange(track.turns.size) == track.lowest_index
    low = jnp.where(own & track.from_lowest, 0.0, by.vertex - by.origin)
    base = jnp.where(turns, looked_up(low, x.piece), looked_up(by.position - by.origin, x.nearest))
    moved = by_shift - (base + since * (there + since * bend))
    faster = there + 2 * since * bend
    middle = (by_edge[first] + by_edge[second]) / 2
    edges = [jnp.where(joins[k], middle, by_edge[k]) for k in (first, second)]
    moments = [
        jnp.where(fixed[k], 0.0, (moved[k] + edge) / pace[k])
        for k, edge in zip((first, second), edges, strict=True)
    ]

    # From one crossing to the next, over the breakpoints between them.
    sign = jnp.where(AFTER, 1, -1).astype(taps.gap.dtype)
    begin, end = x.part(first), x.part(second)
    length = looked_up(lengths(False, taps.tau), x.piece)
    left, entered = x.outer(AFTER, length)[first], x.inner(AFTER, length)[second]
    leaving = begin.piece + np.array([[0], [1]], np.int32)
    entering = end.piece + np.array([[1], [0]], np.int32)
    out_bend, in_bend = bend[first], bend[second]
    way = looked_up(by.position, entering) - looked_up(by.position, leaving)
    way += sign * entered * (looked_up(by.velocity, entering) + sign * entered * in_bend)
    way += sign * left * (looked_up(by.velocity, leaving) - sign * left * out_bend)
    quicker = looked_up(track.velocity, entering) - looked_up(track.velocity, leaving)
    quicker += 2 * sign * (entered * rate[second] + left * rate[first])
    whole, lasting = begin.piece == end.piece, sign * taps.width
    way = jnp.where(whole, lasting * (faster[first] + faster[second]) / 2, way)
    quicker = jnp.where(whole, 2 * rate[first] * lasting, quicker)
    apart = (edges[1] - edges[0]) - way
    longer = apart / pace[second] - moments[0] * (quicker / pace[second])

    inner, outer = (jnp.where(is_held, 0.0, light)[k] for k in (first, second))
    is_free = ~(fixed[first] | fixed[second])
    one_sided = sign * (outer * moments[1] - inner * moments[0])
    lighter = jnp.where(inner > outer, *moments)
    both = sign * jnp.minimum(inner, outer) * longer + once(rise_over, taps) * lighter
    return of_both_arms(jnp.where(is_free, both, one_sided))
