"""Quadrature nodes over the exposure of a shutter of any kind."""

import math
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import all_concrete, device_constant
from mishutter._core.compiling import compiled
from mishutter.model.shutters.base import (
    FEW_PIECES,
    AbstractPiecewiseShutter,
    AbstractShutter,
    integrated_transmittance,
    piecewise,
)
from mishutter.model.shutters.polynomials import PolynomialShutter, in_one_form

_SHARED_PANEL_NODES = 64
"""Nodes of a panel where unequal pieces share the panels. Short panels waste fewer nodes."""
_SPARE_NODES = 2
"""Nodes that a polynomial's panel has beyond its share. In panels of a dozen nodes these two lower
the error of the fastest waves from 5e-12 to 3e-15."""


class ExposureQuadrature(NamedTuple):
    """Quadrature nodes over the exposure, weighted by the transmittance."""

    tau: Float[Array, "q"]  # Normalised times
    weight: Float[Array, "q"]  # Quadrature weight times transmittance there
    efficiency: Float[Array, ""]  # Mean transmittance over the exposure


def exposure_quadrature(
    shutter: AbstractShutter,
    num_nodes: int,
    dtype: np.dtype,
    path_ends: tuple[Fraction, ...] = (),
) -> ExposureQuadrature:
    """About `num_nodes` quadrature nodes over the exposure of a shutter.

    Zero-weight nodes pad to a common length, so that all shutters share one compiled program.
    Panels end at the `path_ends` of a path of several pieces. NumPy computes the nodes of a
    concrete shutter, which compiles nothing.
    """
    form = in_one_form(shutter, dtype) if all_concrete(shutter) else None
    if not isinstance(form, PolynomialShutter):
        return _nodes_of_pieces(shutter, num_nodes, dtype, path_ends)
    ends = np.union1d(form.ends, np.array(path_ends[1:-1], np.float64))
    panels = []
    for begin, width in zip(ends[:-1], np.diff(ends), strict=True):
        nodes, weights = _panel_rule(1, math.ceil(num_nodes * width / 2) + _SPARE_NODES)
        panels.append((begin + width * nodes, width / 2 * weights))
    tau, shares = map(np.concatenate, zip(*panels, strict=True))
    weight, dtype = shares * form.within(tau), np.dtype(form.powers.dtype)
    padding = (0, _padded_length(num_nodes, tau.size) - tau.size)
    padded = (np.pad(part, padding).astype(dtype) for part in (tau, weight))
    efficiency = np.asarray(form.known_efficiency(), dtype)
    return ExposureQuadrature(*device_constant((*padded, efficiency)))


def _padded_length(num_nodes: int, actual: int) -> int:
    """The common length for `num_nodes`; more if the `actual` number of nodes exceeds it."""
    # Two blocks more than asked for leave room for the nodes that a few pieces add by rounding up.
    common, least = (math.ceil(count / _SHARED_PANEL_NODES) for count in (num_nodes, actual))
    return max(common + 2, least) * _SHARED_PANEL_NODES


@compiled
def _nodes_of_pieces(
    shutter: AbstractShutter, num_nodes: int, dtype: np.dtype, path_ends: tuple[Fraction, ...]
) -> ExposureQuadrature:
    profile = piecewise(shutter)
    ends = jnp.asarray(profile.breakpoints(dtype))
    if len(path_ends) > 2:
        tau, weight = _panels_of_path(profile, ends, num_nodes, path_ends)
    elif ends.size <= FEW_PIECES + 1 and not profile.equal_pieces:
        # A few unequal pieces may have any lengths, and panels of their own would be as many for
        # the shortest as for the longest.
        tau, weight = _shared_panels(profile, ends, num_nodes)
    else:
        # Of many unequal pieces none is longer than twice their mean, as their class promises.
        longest = (1 if profile.equal_pieces else 2) / (ends.size - 1)
        num_panels = profile.panels_per_piece
        offset, shares = _panels(ends, num_panels, math.ceil(num_nodes * longest / num_panels))
        tau = (ends[:-1, None] + offset).ravel()
        weight = (shares * profile.piece_transmittance(offset)).ravel()
    padding = (0, _padded_length(num_nodes, tau.size) - tau.size)
    efficiency = mean_transmittance(profile, dtype)
    return ExposureQuadrature(jnp.pad(tau, padding), jnp.pad(weight, padding), efficiency)


def mean_transmittance(profile: AbstractPiecewiseShutter, dtype: np.dtype) -> Float[Array, ""]:
    """Efficiency of a profile, its mean transmittance, in the precision `dtype`."""
    return integrated_transmittance(profile).astype(dtype) / 2


def _panels_of_path(
    profile: AbstractPiecewiseShutter,
    ends: Float[Array, "ends"],
    num_nodes: int,
    path_ends: tuple[Fraction, ...],
) -> tuple[Float[Array, "q"], Float[Array, "q"]]:
    """Nodes of panels that end where pieces of the shutter or of a path do."""
    cuts = np.array(path_ends, np.float64)
    longest, num_panels = float(np.max(np.diff(cuts))), profile.panels_per_piece
    if profile.equal_pieces:
        count = ends.size - 1
        equal = 2 / count
        longest = min(longest, equal)
        # Where the path cuts pieces short, fewer panels are as fine.
        num_panels = math.ceil(num_panels * longest / equal)
        ends = jnp.asarray(np.union1d(np.arange(-count, count + 1, 2) / count, cuts), ends.dtype)
    else:
        ends = jnp.sort(jnp.concatenate([ends, jnp.asarray(cuts[1:-1], ends.dtype)]))
    offset, shares = _panels(ends, num_panels, math.ceil(num_nodes * longest / 2 / num_panels))
    tau = (ends[:-1, None] + offset).ravel()
    return tau, shares.ravel() * profile.transmittance(tau)


def _panels(
    ends: Float[Array, "ends"], num_panels: int, per_panel: int
) -> tuple[Float[Array, "n q"], Float[Array, "n q"]]:
    """Offsets of nodes from the beginnings of intervals, and weights, of half their integrals."""
    rule = _panel_rule(num_panels, per_panel)
    nodes, weights = (jnp.asarray(x, ends.dtype)[None] for x in rule)
    length = jnp.diff(ends)[:, None]
    return length * nodes, length / 2 * weights


def _shared_panels(
    profile: AbstractPiecewiseShutter, ends: Float[Array, "ends"], num_nodes: int
) -> tuple[Float[Array, "q"], Float[Array, "q"]]:
    """Nodes of panels that are distributed over the pieces by length, which parameters may change.

    No panel is longer than one of `num_equal` equal panels, and unused panels have no weight.
    """
    num_equal = math.ceil(num_nodes / _SHARED_PANEL_NODES)
    rule = _panel_rule(1, math.ceil(num_nodes / num_equal))
    nodes, weights = (x.astype(ends.dtype)[None] for x in rule)
    length, least = jnp.diff(ends), profile.panels_per_piece
    panel = np.arange(num_equal + length.size * least - 1, dtype=ends.dtype)[:, None]
    # Prevents the sum of the counts, which are rounded up, from exceeding the number of panels.
    count = jnp.ceil(jax.lax.stop_gradient(length) * (num_equal / 2 * (1 - 1e-6)))
    count = jnp.maximum(count, least)
    past = jnp.cumsum(count)
    piece = jnp.sum(panel >= past[None, :-1], axis=1)
    columns = (ends[:-1], length, count, past - count)
    begin, piece_length, num_panels, first = (x[piece][:, None] for x in columns)
    # Unused panels sit inside a piece, where no derivative is infinite, and weigh nothing.
    is_used = panel < past[-1]
    share = jnp.where(is_used, panel - first + nodes, 0.5) / num_panels
    # Nodes move with the lengths of pieces, and are differentiated with them: a `stop_gradient` on
    # the lengths would give right values and wrong slopes.
    values = profile.piece_transmittance(length[:, None, None] * share[None])
    transmittance = jnp.take_along_axis(values, piece[None, :, None], axis=0)[0]
    weight = jnp.where(is_used, piece_length / num_panels * (weights / 2), 0.0) * transmittance
    return (begin + piece_length * share).ravel(), weight.ravel()


@lru_cache
def _panel_rule(num_panels: int, num_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Composite Gauss-Legendre rule on [0, 1]; a panel has 12 to 128 nodes.

    NumPy takes a second to compute a single rule of a thousand nodes.
    """
    parts = -(-num_nodes // 128)
    num_panels, per_panel = num_panels * parts, max(-(-num_nodes // parts), 12)
    nodes, weights = np.polynomial.legendre.leggauss(per_panel)
    panels = np.arange(num_panels)[:, None]
    spread = (panels + (nodes + 1) / 2) / num_panels
    return spread.ravel(), np.tile(weights / (2 * num_panels), num_panels)
