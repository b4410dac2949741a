"""What the compiled programs of a sweep are given: a scene's numbers, tiles of points."""

from typing import NamedTuple, final

import equinox as eqx
from jaxtyping import Array

PARTS = 8
"""Equal parts of the frequencies in (0, 0.5) cycles/px: low ones need fewer nodes."""
FREQUENCIES_A_TURN = 32
"""Frequencies that are done in one turn: every number of them is a multiple."""


@final
class SceneNumbers(eqx.Module):
    """What a scene brings to every tile.

    Attributes:
        speeds: Distinct sizes of the speeds, px/s; shape `(s,)`.
        weights: How often each occurs, as it is and reversed; shape `(2, s)`. Where all
            shutters are symmetric the second row is empty and the first holds both.
        max_speed: Fastest object, one that never occurs included; px/s.
        power: Power spectrum of the picture on each of the frequency grids; `(g, m)`.
        mean_level: Mean of the picture.
        photon_rates: e-/s at white; shape `(p,)`.
        read_noises: e-; shape `(r,)`.
    """

    speeds: Array
    weights: Array
    max_speed: Array
    power: Array
    mean_level: Array
    photon_rates: Array
    read_noises: Array


class Tile(NamedTuple):
    """Points of one exposure, and how much computing they need; leading axis: tiles.

    Attributes:
        accelerations: px/s^2; shape `(j,)`.
        half_exposure: s.
        rules: Index of the quadrature rule of each part of the frequencies; `(PARTS,)`.
        num_node_chunks: Chunks of nodes of those rules; `(PARTS,)`.
        num_tap_chunks: Chunks of taps that the fastest object reaches.
        num_still_chunks: Chunks of taps that a still object reaches.
        length: Index of the DFT's length.
        grid: Index of the frequency grid.
    """

    accelerations: Array
    half_exposure: Array
    rules: Array
    num_node_chunks: Array
    num_tap_chunks: Array
    num_still_chunks: Array
    length: Array
    grid: Array


class TileSizes(NamedTuple):
    """What is the same for all tiles of a sweep; static.

    Attributes:
        lengths: DFT lengths that tiles may ask for.
        grids: Numbers of frequencies that tiles may ask for.
        still_taps: Taps of the longest kernel of a still object.
        kernels: Whether metrics of kernels are wanted.
        spectra: Whether metrics of transfer functions are wanted.
    """

    lengths: tuple[int, ...]
    grids: tuple[int, ...]
    still_taps: int
    kernels: bool
    spectra: bool
