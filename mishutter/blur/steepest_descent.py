r"""Integrals of a shutter against a quadratic phase, at a cost independent of the frequency.

The number of nodes therefore need not be known when a call is traced.

With $\kappa = 2\pi f A$ and $\theta = 2\pi f u$ at a point $b$ of a panel, the phase near
it is $\varphi(b) + \theta h + \kappa h^2$. Where the phase turns by little over a panel, a
Gauss-Legendre rule in $h$ integrates it. Over any other panel the same rule integrates along
the rays $h = \pm s\,e^{-i\pi/4}$ from its ends, on which the oscillation becomes
$e^{-\kappa s^2 - |\theta| s\,e^{i\pi/4}}$ and decays at least as fast as it turns,
uniformly as $\theta \to 0$ (numerical steepest descent, after Huybrechs and Vandewalle,
SIAM J. Numer. Anal. 44, 2006). Where the two rays leave in opposite directions, a
Gauss-Hermite sum along the line through the stationary point joins them.
"""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from mishutter._core import DoubleWord, multiply, two_sum, word
from mishutter.blur.free_derivatives import differentiable_path
from mishutter.blur.free_path import RefinedShutter, free_path, path_parameters
from mishutter.blur.trajectory import path, valued
from mishutter.model import AbstractPiecewiseShutter, FreeMotion

_ROOT_HALF = float(np.sqrt(0.5))
_DIRECTION = complex(_ROOT_HALF, -_ROOT_HALF)


class _Rule(NamedTuple):
    """Quadrature rules and their range.

    The rule of `nodes` integrates over a panel whose phase turns by up to `max_turn` radians. A ray
    ends where the integrand has decayed by `exp(-decay)`.
    """

    nodes: Float[np.ndarray, "1 1 q"]
    weights: Float[np.ndarray, "1 1 q"]
    line_nodes: Float[np.ndarray, "1 1 q"]
    line_weights: Float[np.ndarray, "1 1 q"]
    max_turn: float
    decay: float


class Panels(NamedTuple):
    r"""Phase over each panel; arrays are pieces by panels of a piece.

    Attributes:
        offset: Time from the left end of the piece to that of the panel.
        length: Duration of the panel.
        curvature: $\kappa$, rad.
        slopes: $\theta$ at the left and at the right end, rad.
        cycles: Phase at both ends, in cycles, without whole ones.
        vertex_cycles: Phase at the vertex, of a shape that broadcasts with the panels.
    """

    offset: Float[Array, "n m"]
    length: Float[Array, "n m"]
    curvature: Float[Array, "n m"]
    slopes: tuple[Float[Array, "n m"], Float[Array, "n m"]]
    cycles: tuple[Float[Array, "n m"], Float[Array, "n m"]]
    vertex_cycles: Float[Array, "..."]


@lru_cache
def _rule(dtype: np.dtype) -> _Rule:
    # Decays by exp(-37) and exp(-17) are below the rounding of either precision.
    count, max_turn, decay = (28, 30.0, 37.0) if dtype == np.float64 else (16, 16.0, 17.0)
    x, weights = np.polynomial.legendre.leggauss(count)
    line, line_weights = np.polynomial.hermite.hermgauss(count)
    parts = ((1 + x) / 2, weights / 2, line, line_weights)
    shaped = [part.astype(dtype)[None, None] for part in parts]
    return _Rule(shaped[0], shaped[1], shaped[2], shaped[3], max_turn, decay)


def panels(
    profile: AbstractPiecewiseShutter, a: Array, T: Array, s: DoubleWord, frequency: Array
) -> Panels:
    """Panels of `profile` for a point of speed `s` at a `frequency` of at least 0."""
    offset, length, ends = _panel_ends(profile, np.dtype(frequency.dtype))
    flat = DoubleWord(*(x.reshape(-1) for x in ends))
    track = path(a, T, s, flat, from_vertex=False)
    turn = 2 * jnp.pi * frequency
    slope = (turn * track.velocity).reshape(offset.shape)
    cycles = _cycles(frequency, *track.position).reshape(offset.shape)
    return Panels(
        offset[:, :-1],
        length,
        jnp.broadcast_to(turn * track.sag, length.shape),
        (slope[:, :-1], slope[:, 1:]),
        (cycles[:, :-1], cycles[:, 1:]),
        _cycles(frequency, *track.vertex),
    )


def free_panels(
    profile: RefinedShutter,
    place: Array,
    motion: FreeMotion,
    s: DoubleWord,
    frequency: Array,
) -> tuple[Panels, Array]:
    """Panels on a free path, and whether each is mirrored to have a curvature of at least 0.

    The integral over a mirrored panel is the conjugate of that over the panel.
    """
    offset, length, ends = _panel_ends(profile, np.dtype(frequency.dtype))
    tau = DoubleWord(*(jnp.append(x[:, :-1], x[-1:, -1]) for x in ends))
    piece = jnp.repeat(place, length.shape[1])
    parameters, cuts = path_parameters(motion, s), motion.piece_ends
    exact = free_path(parameters, cuts, tau, piece, from_lowest=False)
    smooth_path = differentiable_path(parameters, cuts, exact, tau, piece, from_vertex=False)
    sign = jnp.where(exact.sag < 0, -1.0, 1.0).astype(length.dtype)
    turn = 2 * jnp.pi * frequency

    def cycles(plain: Array, place: DoubleWord) -> Array:
        return _cycles(frequency, valued(plain, place.high), place.low)

    def shaped(row: Array) -> Array:
        return (sign * row).reshape(length.shape)

    slope = turn * valued(smooth_path.velocity, exact.velocity)
    phase = cycles(smooth_path.position, exact.position)
    panel = Panels(
        offset[:, :-1],
        length,
        shaped(turn * smooth_path.sag),
        (shaped(slope[:-1]), shaped(slope[1:])),
        (shaped(phase[:-1]), shaped(phase[1:])),
        shaped(cycles(smooth_path.vertex, exact.vertex)),
    )
    return panel, (sign < 0).reshape(length.shape)


def _panel_ends(
    profile: AbstractPiecewiseShutter, dtype: np.dtype
) -> tuple[Array, Array, DoubleWord]:
    """Ends of panels counted from the left end of their piece, their lengths, and their ends."""
    ends = profile.breakpoints(dtype)
    length = jnp.diff(ends.high) + jnp.diff(ends.low)
    count = profile.panels_per_piece
    offset = length[:, None] * jnp.asarray(np.arange(count + 1)[None] / count, length.dtype)
    summed = two_sum(jnp.broadcast_to(ends.high[:-1, None], offset.shape), offset)
    # The last panel ends exactly where the next piece begins: a sum would round beside it.
    high = summed.high.at[:, -1].set(ends.high[1:])
    low = (summed.low + ends.low[:-1, None]).at[:, -1].set(ends.low[1:])
    lengths = jnp.broadcast_to(length[:, None] / count, offset[:, 1:].shape)
    return offset, lengths, DoubleWord(high, low)


def turns_far(panel: Panels) -> Bool[Array, "..."]:
    """Whether the phase turns over a panel by more than the rule along the panel integrates."""
    steepest = jnp.maximum(*(jnp.abs(slope) for slope in panel.slopes))
    return steepest * panel.length > _rule(np.dtype(steepest.dtype)).max_turn


def along_panel(profile: AbstractPiecewiseShutter, panel: Panels) -> Complex[Array, "n m"]:
    """Integral over each panel by the rule along it."""
    rule = _rule(np.dtype(panel.length.dtype))
    h = panel.length[..., None] * rule.nodes
    phase = h * (panel.slopes[0][..., None] + panel.curvature[..., None] * h)
    weights = rule.weights * profile.piece_transmittance(panel.offset[..., None] + h)
    integral = jax.lax.complex(
        jnp.sum(weights * jnp.cos(phase), -1), -jnp.sum(weights * jnp.sin(phase), -1)
    )
    return _times(panel.length, _unit(panel.cycles[0]) * integral)


def along_rays(profile: AbstractPiecewiseShutter, panel: Panels) -> Complex[Array, "n m"]:
    """Integral over each panel by steepest descent, where `turns_far`."""
    far = turns_far(panel)
    from_left = _ray(profile, panel, 0, far)
    from_right = _ray(profile, panel, 1, far)
    return from_left - from_right + _line(profile, panel, far)


def _ray(profile: AbstractPiecewiseShutter, panel: Panels, end: int, far: Array) -> Array:
    """Integral from one end of each panel into the valley on its side of the vertex."""
    rule = _rule(np.dtype(panel.length.dtype))
    slope = panel.slopes[end]
    sign = jnp.where(slope >= 0, 1.0, -1.0).astype(slope.dtype)
    steepness, curvature = sign * slope, panel.curvature
    quarter = steepness * _ROOT_HALF
    # This form of the root of a quadratic holds without curvature too.
    rate = quarter + jnp.hypot(quarter, jnp.sqrt(4 * rule.decay * curvature))
    reach = jnp.where(far, 2 * rule.decay / jnp.where(far, rate, 1.0), panel.length)
    # The integral does not depend on the reach: the integrand beyond it is below rounding.
    reach = jax.lax.stop_gradient(reach)
    step = reach[..., None] * rule.nodes
    turn = quarter[..., None] * step
    decay = turn + curvature[..., None] * step * step
    size = jnp.exp(-decay)
    fall = jax.lax.complex(size * jnp.cos(turn), -size * jnp.sin(turn))
    start = panel.offset if end == 0 else panel.offset + panel.length
    w = profile.piece_transmittance(_into_valley(start, sign[..., None] * step))
    total = jnp.sum(_times(rule.weights, w * fall), -1) * _DIRECTION
    return _times(sign * reach, _unit(panel.cycles[end]) * total)


def _line(profile: AbstractPiecewiseShutter, panel: Panels, far: Array) -> Array:
    """Integral from valley to valley, for the panel that holds the stationary point."""
    rule = _rule(np.dtype(panel.length.dtype))
    before, after = panel.slopes
    holds = far & (before < 0) & (after >= 0) & (panel.curvature > 0)
    curvature = jnp.where(holds, panel.curvature, 1.0)
    to_vertex = jnp.where(holds, -before / (2 * curvature), 0.0)
    # The Gaussian weight belongs to the rule, so the nodes move with its width.
    width = jnp.where(holds, jax.lax.rsqrt(curvature), 0.0)
    step = width[..., None] * rule.line_nodes
    w = profile.piece_transmittance(_into_valley(panel.offset + to_vertex, step))
    total = jnp.sum(_times(rule.line_weights, w), -1) * _DIRECTION
    return _times(width, _unit(panel.vertex_cycles) * total)


def _into_valley(start: Array, step: Array) -> Array:
    r"""$b + s\,e^{-i\pi/4}$."""
    return jax.lax.complex(start[..., None] + _ROOT_HALF * step, -_ROOT_HALF * step)


def _times(real: Array | np.ndarray, factor: Array) -> Array:
    return jax.lax.complex(real * factor.real, real * factor.imag)


def _unit(cycles: Array) -> Array:
    r"""$e^{-2\pi i c}$."""
    angle = 2 * jnp.pi * cycles
    return jax.lax.complex(jnp.cos(angle), -jnp.sin(angle))


@jax.custom_jvp
def _cycles(frequency: Array, position: Array, position_low: Array) -> Array:
    """Phase at a position, in cycles, without whole ones."""
    # A phase of many cycles has few digits left for the part that counts, so that whole cycles
    # leave it while it is a double word.
    exact = multiply(DoubleWord(position, position_low), word(frequency))
    return (exact.high - jnp.round(exact.high)) + exact.low


@_cycles.defjvp
def _cycles_jvp(primals, tangents):
    frequency, position, _ = primals
    d_frequency, d_position, _ = tangents
    return _cycles(*primals), frequency * d_position + d_frequency * position
