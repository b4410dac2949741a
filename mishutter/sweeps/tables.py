r"""What is known of a few shutters before any point of a grid is: nodes, light, integrals.

In normalised time a shutter does not depend on acceleration or exposure. So its light at
quadrature nodes is tabulated once, for rules of rising bandwidth, and so is its running
integral $W(\tau) = \int_{-1}^\tau w$, as polynomials between the shutter's breakpoints:
a tap is a difference of two of its values.
"""

from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.polynomial import chebyshev

from mishutter._core import compiled
from mishutter.model import AbstractPiecewiseShutter, AbstractShutter, piecewise

CHUNK = 32
"""Nodes that are summed in one turn; rules are padded to whole chunks."""

_PER_PANEL = 128
_NODES_PER_PHASE = 0.53
_SPARE_NODES = (6, 8, 10, 12, 14, 16, 18, 20, 24, 32, 48)
_LEVEL_RATIO = 1.2
_QUADRATURE_ERROR = 1e-13
_DEGREE = 23
_CUTS = (1, 2, 4, 8, 16)
_POLYNOMIAL_ERROR = 4e-15


class Antiderivative(NamedTuple):
    r"""$W(\tau)$ piece by piece, in powers of $u = (\tau - c)/h \in [-1, 1]$.

    Attributes:
        centres: Middles $c$ of the pieces; shape `(p,)`.
        halves: Half lengths $h$; shape `(p,)`.
        powers: Coefficients, ascending, each piece's zero at its left end; `(p, d)`, or
            `(j, p, d)` for as many shutters as times have on their leading axis.
    """

    centres: Array
    halves: Array
    powers: Array


class _Profile(NamedTuple):
    """A shutter in smooth pieces, and where they end."""

    pieces: AbstractPiecewiseShutter
    ends: np.ndarray


@final
class Tables(eqx.Module):
    """Tables of `k` shutters.

    Attributes:
        nodes: Normalised times in `[0, 1]` of each rule; shape `(r, q)`.
        even: Weight times half the sum of the transmittances there and at the mirrored
            time; shape `(r, k, q)`.
        odd: The same of half their difference; empty where all shutters are symmetric.
        integrals: Running integral of each shutter.
        efficiency: Light let through; shape `(k,)`.
    """

    nodes: Array
    even: Array
    odd: Array
    integrals: tuple[Antiderivative, ...]
    efficiency: Array


class Rules(NamedTuple):
    """How many chunks of nodes a bandwidth needs.

    Attributes:
        bandwidths: Largest velocity that each rule holds, `2A + B`, px; ascending.
        num_chunks: Chunks of nodes of each.
    """

    bandwidths: np.ndarray
    num_chunks: np.ndarray

    def levels(self, bandwidths: np.ndarray) -> np.ndarray:
        """The cheapest rule that holds each bandwidth."""
        return np.minimum(np.searchsorted(self.bandwidths, bandwidths), self.bandwidths.size - 1)


def tabulate(
    shutters: Sequence[AbstractShutter], max_bandwidth: float, dtype: np.dtype, *, symmetric: bool
) -> tuple[Tables, Rules]:
    """Tables and rules that hold velocities of up to `max_bandwidth` px per half exposure."""
    profiles = [_profile(shutter) for shutter in shutters]
    ends = _common_ends(profiles)
    count = max(1, int(np.ceil(np.log(max(max_bandwidth, 2.0) / 2) / np.log(_LEVEL_RATIO))) + 1)
    bandwidths = 2.0 * _LEVEL_RATIO ** np.arange(count)
    rules = _rules(profiles, ends, bandwidths)
    num_chunks = np.array([-(-nodes.size // CHUNK) for nodes, _ in rules])
    length = int(num_chunks.max()) * CHUNK
    nodes = np.stack([np.pad(x, (0, length - x.size)) for x, _ in rules])
    weights = np.stack([np.pad(w, (0, length - w.size)) for _, w in rules])
    before, after = (_light(profiles, side * nodes.ravel()) for side in (-1, 1))
    shape = (len(profiles), *nodes.shape)
    even, odd = (
        np.swapaxes((after + sign * before).reshape(shape), 0, 1) / 2 * weights[:, None]
        for sign in (1, -1)
    )
    integrals = tuple(_antiderivative(profile, dtype) for profile in profiles)
    efficiency = np.array([float(shutter.efficiency()) for shutter in shutters])
    tables = Tables(
        jnp.asarray(nodes, dtype),
        jnp.asarray(even, dtype),
        jnp.asarray(np.zeros(0) if symmetric else odd, dtype),
        integrals,
        jnp.asarray(efficiency, dtype),
    )
    return tables, Rules(bandwidths, num_chunks)


def integral_to(table: Antiderivative, tau: Array) -> Array:
    r"""$W(\tau)$ at times of any shape; no branch, so that a processor's lanes stay full."""

    def coefficient(index: Array | int, power: int) -> Array:
        value = table.powers[..., index, power]
        return value.reshape(value.shape + (1,) * (tau.ndim - value.ndim))

    def piece(index: Array | int) -> Array:
        centre, half = table.centres[index], table.halves[index]
        u = jnp.clip((tau - centre) / half, -1, 1)
        degree = table.powers.shape[-1] - 1
        value = jnp.broadcast_to(coefficient(index, degree), u.shape)
        for power in range(degree - 1, -1, -1):
            value = value * u + coefficient(index, power)
        return value

    count = table.centres.size
    if count <= 4:
        return sum((piece(index) for index in range(1, count)), start=piece(0))
    start = jnp.zeros_like(tau)
    return jax.lax.fori_loop(0, count, lambda index, total: total + piece(index), start)


def mixed(integrals: tuple[Antiderivative, ...], mixture: Array) -> Antiderivative:
    """Running integrals of mixtures `(j, k)` of shutters that share their pieces."""
    powers = jnp.stack([table.powers for table in integrals])
    return integrals[0]._replace(powers=jnp.einsum("jk,kpd->jpd", mixture, powers))


def _common_ends(profiles: Sequence[_Profile]) -> np.ndarray:
    """Ends in [0, 1] between which every shutter is smooth on both sides of mid-exposure."""
    ends = [np.abs(profile.ends) for profile in profiles]
    panels = [np.linspace(0, 1, _panels(profile) + 1) for profile in profiles]
    joined = np.unique(np.concatenate([[0.0, 1.0], *ends, *panels]))
    apart = np.concatenate([[True], np.diff(joined) > 1e-12])
    joined = joined[apart]
    joined[-1] = 1.0
    return joined


def _panels(profile: _Profile) -> int:
    """Equal parts of half the exposure that a profile's own sharpness asks for."""
    num_pieces = profile.ends.size - 1
    return -(-num_pieces * profile.pieces.panels_per_piece // 8) if num_pieces <= 2 else 1


def _profile(shutter: AbstractShutter) -> _Profile:
    pieces = piecewise(shutter)
    ends = pieces.breakpoints(np.dtype(pieces.dtype() or float)).high
    return _Profile(pieces, np.asarray(ends, np.float64))


def _rule(ends: np.ndarray, bandwidth: float, spare: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes and weights between the ends, dense enough for a bandwidth."""
    nodes, weights = [], []
    for left, right in pairwise(ends):
        half_phase = np.pi / 2 * (right - left) * bandwidth
        num_panels = max(1, int(np.ceil(_NODES_PER_PHASE * half_phase / (_PER_PANEL - spare))))
        count = int(np.ceil(_NODES_PER_PHASE * half_phase / num_panels)) + spare
        x, w = _legendre(count)
        edges = np.linspace(left, right, num_panels + 1)
        half = np.diff(edges)[:, None] / 2
        nodes.append((edges[:-1, None] + half * (1 + x)).ravel())
        weights.append((half * w).ravel())
    return np.concatenate(nodes), np.concatenate(weights)


_legendre = lru_cache(np.polynomial.legendre.leggauss)


def _rules(
    profiles: Sequence[_Profile], ends: np.ndarray, bandwidths: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rules with the fewest spare nodes a panel with which many more change nothing."""
    allowed = max(_QUADRATURE_ERROR, 50 * float(jnp.finfo(jnp.result_type(float)).eps))
    rules, index = [], 0
    for bandwidth in bandwidths.tolist():
        exact = _probed(profiles, bandwidth, _rule(ends, bandwidth, _SPARE_NODES[-1]))
        rule = _rule(ends, bandwidth, _SPARE_NODES[index])
        while np.max(np.abs(_probed(profiles, bandwidth, rule) - exact)) >= allowed:
            index += 1
            rule = _rule(ends, bandwidth, _SPARE_NODES[index])
        rules.append(rule)
    return rules


def _probed(profiles, bandwidth: float, rule: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Transfer functions at 0.5 cycles/px, parts of the bandwidth being acceleration."""
    nodes, weights = rule
    part = np.array([[0.0], [0.5], [0.9]])
    phase = np.pi * bandwidth * (part / 2 * nodes**2 + (1 - part) * nodes)
    return (_light(profiles, nodes) * weights) @ np.exp(1j * phase).T


def _light(profiles: Sequence[_Profile], tau: np.ndarray) -> np.ndarray:
    """Transmittances at times away from breakpoints; shape `(k, q)`."""
    length = 1 << max(tau.size - 1, 1).bit_length()
    padded = jnp.asarray(np.pad(tau, (0, length - tau.size)))
    return np.stack([_at(profile, padded) for profile in profiles])[:, : tau.size]


def _at(profile: _Profile, tau: Array) -> np.ndarray:
    ends = profile.ends
    piece = np.clip(np.searchsorted(ends, np.asarray(tau)) - 1, 0, ends.size - 2)
    values = np.asarray(_all_pieces(profile.pieces, tau), np.float64)
    return np.clip(values[piece, np.arange(tau.size)], 0, 1)


@compiled
def _all_pieces(profile: AbstractPiecewiseShutter, tau: Array) -> Array:
    ends = profile.breakpoints(np.dtype(tau.dtype)).high
    inside = jnp.clip(tau[None], ends[:-1, None], ends[1:, None])
    return profile.piece_transmittance(inside - ends[:-1, None])


@compiled
def _at_offsets(profile: AbstractPiecewiseShutter, offset: Array) -> Array:
    return profile.piece_transmittance(offset)


def _antiderivative(profile: _Profile, dtype: np.dtype) -> Antiderivative:
    """Running integral, from interpolation at Chebyshev points of as few parts as will do."""
    ends = profile.ends
    points = np.cos(np.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))
    projection = chebyshev.chebvander(points, _DEGREE) * (2 / (_DEGREE + 1))
    projection[:, 0] /= 2
    shares = [((np.arange(cut)[:, None] + (points + 1) / 2) / cut).ravel() for cut in _CUTS]
    offset = np.diff(ends)[:, None] * np.concatenate(shares)
    values = np.asarray(_at_offsets(profile.pieces, jnp.asarray(offset)), np.float64)
    places = np.cumsum([0, *(share.size for share in shares)])
    cut, series = _CUTS[0], values
    for index, number in enumerate(_CUTS):
        at_cut = values[:, places[index] : places[index + 1]].reshape(-1, _DEGREE + 1)
        cut, series = number, at_cut @ projection
        if np.max(np.abs(series[:, -2:])) < _POLYNOMIAL_ERROR:
            break
    edges = np.concatenate([np.linspace(a, b, cut + 1)[:-1] for a, b in pairwise(ends)])
    edges = np.append(edges, ends[-1])
    keep = edges[1:] > edges[:-1]
    halves = np.diff(edges)[keep] / 2
    centres = (edges[1:] + edges[:-1])[keep] / 2
    needed = np.max(np.abs(series), axis=0) > _POLYNOMIAL_ERROR / 2
    degree = int(np.max(np.flatnonzero(needed), initial=0))
    powers = np.stack([_integrated(row[: degree + 1]) for row in series[keep]])
    return Antiderivative(
        *(jnp.asarray(x, dtype) for x in (centres, halves, powers * halves[:, None]))
    )


def _integrated(series: np.ndarray) -> np.ndarray:
    integral = chebyshev.chebint(series, lbnd=-1)
    powers = chebyshev.cheb2poly(integral)
    return np.pad(powers, (0, series.size + 1 - powers.size))
