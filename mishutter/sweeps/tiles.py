"""One tile of a sweep: some accelerations at one exposure, every shutter, every speed.

Loops over frequencies, nodes and taps turn as often as the tile needs, so that one compiled
program serves every tile at its own cost.
"""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from mishutter.sweeps.kernels import kernel_metrics
from mishutter.sweeps.points import FREQUENCIES_A_TURN, PARTS, SceneNumbers, Tile, TileSizes
from mishutter.sweeps.spectra import Spectra, aligned_spectra
from mishutter.sweeps.tables import Tables


class TileMetrics(NamedTuple):
    """Metrics of a tile; shape `(j, k)`, the error's with light and read noise after.

    Those that were not asked for are empty. Of the kernels it is sums of squares over
    taps, of the differences also over speeds.
    """

    condition_number: Array
    squared_difference: Array
    squared_kernel: Array
    squared_error: Array
    bound_share: Array


class _Sums(NamedTuple):
    error: Array
    least: Array


def measure_tile(
    tables: Tables, scene: SceneNumbers, sizes: TileSizes, tile: Tile, mixture: Array
) -> TileMetrics:
    """The metrics of a tile.

    Args:
        tables: Tables of `k` shutters.
        scene: What the scene brings.
        sizes: What is static.
        tile: The points.
        mixture: Shares of the tables' shutters in the one that each point has instead of
            them, shape `(j, k)`; empty where all of them are measured.
    """
    empty = jnp.zeros((tile.accelerations.size, 0), tile.accelerations.dtype)
    kernels = (empty,) * 3
    if sizes.kernels:
        kernels = kernel_metrics(tables, scene, sizes, tile, mixture)
    picture = (empty,) * 2
    if sizes.spectra:
        picture = _picture_metrics(tables, scene, sizes, tile, mixture)
    return TileMetrics(*kernels, *picture)


def _picture_metrics(
    tables: Tables, scene: SceneNumbers, sizes: TileSizes, tile: Tile, mixture: Array
) -> tuple[Array, Array]:
    """Expected squared error and share of the bound."""
    num_frequencies = jnp.asarray(sizes.grids, tile.grid.dtype)[tile.grid]
    size, whole_turns = FREQUENCIES_A_TURN, num_frequencies // FREQUENCIES_A_TURN
    efficiency = jnp.tile(tables.efficiency[:, None], (1, tile.accelerations.size))
    if mixture.size:
        efficiency = (mixture @ tables.efficiency)[None]
    electrons = scene.photon_rates * (2 * tile.half_exposure)
    signal, noise = _signal_and_noise(electrons, efficiency, scene)
    first = _Sums(jnp.zeros_like(noise), jnp.full_like(efficiency, jnp.inf))

    def turn(index: Array, sums: _Sums) -> _Sums:
        whole = index * size + jnp.arange(size, dtype=index.dtype)
        frequency = (whole.astype(noise.dtype) + 0.5) * (0.5 / num_frequencies.astype(noise.dtype))
        part = ((index + 1) * PARTS - 1) // whole_turns
        spectra = aligned_spectra(tables, scene, tile, frequency, part)
        if mixture.size:
            mixed = (jnp.einsum("mskj,jk->msj", x, mixture)[:, :, None] for x in spectra)
            spectra = Spectra(*mixed)
        power = jax.lax.dynamic_slice(scene.power, (tile.grid, index * size), (1, size))[0]
        spread, coherent, least = _picture_terms(scene, tile, spectra, frequency)
        error = _summed_error(power[:, None, None], spread, coherent, signal, noise)
        return _Sums(sums.error + error, jnp.minimum(sums.least, least))

    num_turns = jnp.where(tile.num_node_chunks[0] > 0, whole_turns, 0)
    sums = jax.lax.fori_loop(0, num_turns, turn, first)
    shape = (scene.photon_rates.size, scene.read_noises.size, *efficiency.shape)
    error = sums.error.reshape(shape) / num_frequencies.astype(noise.dtype)
    return jnp.transpose(error, (3, 2, 0, 1)), sums.least.T


def _signal_and_noise(
    electrons: Array, efficiency: Array, scene: SceneNumbers
) -> tuple[Array, Array]:
    """Squares of light `(p * r,)`, and variances of the noise, electrons, `(p * r, k, j)`."""
    shot = electrons[:, None, None, None] * scene.mean_level * efficiency[None, None]
    noise = shot + scene.read_noises[None, :, None, None] ** 2
    signal = jnp.repeat(electrons**2, scene.read_noises.size)
    return signal, noise.reshape(-1, *efficiency.shape)


def _picture_terms(
    scene: SceneNumbers, tile: Tile, spectra: Spectra, frequency: Array
) -> tuple[Array, Array, Array]:
    """Spread and coherent part of the response, `(m, k, j)`, and least share of the bound.

    Sums over speeds are written out, which XLA fuses; it does not fuse its own.
    """
    weights = scene.weights.reshape(-1)
    smear = jnp.maximum(4 * scene.max_speed * tile.half_exposure * frequency, 1.0)
    each = [Spectra(*(x[:, index] for x in spectra)) for index in range(weights.size)]
    weighted = list(zip(weights, each, strict=True))
    square = [jnp.where(w > 0, x.real**2 + x.imag**2, jnp.inf) for w, x in weighted]
    least = reduce(jnp.minimum, square) * smear[:, None, None]
    real, imag = (sum(w * x[part] for w, x in weighted) for part in (0, 1))
    spread = sum(w * ((x.real - real) ** 2 + (x.imag - imag) ** 2) for w, x in weighted)
    aperture = jnp.sinc(frequency)[:, None, None] ** 2
    return aperture * spread, aperture * (real**2 + imag**2), jnp.min(least, axis=0)


def _summed_error(
    power: Array, spread: Array, coherent: Array, signal: Array, noise: Array
) -> Array:
    """Expected error summed over frequencies, one light after the other; `(p * r, k, j)`."""

    def of_light(light: tuple[Array, Array]) -> Array:
        strength = power * light[0]
        remaining = strength * spread + light[1][None]
        whole = strength * coherent + remaining
        dark = whole <= 0
        return jnp.sum(power * jnp.where(dark, 1.0, remaining / jnp.where(dark, 1.0, whole)), 0)

    return jax.lax.map(of_light, (signal, noise))
