r"""One tile of a sweep: some accelerations at one exposure, every shutter, every speed.

In normalised time the transfer function of a point is
$H_s(f) = \int_0^1 e^{-2\pi i f A\tau^2}\,[w_e(\tau)\cos 2\pi f B\tau +
i\,w_o(\tau)\sin 2\pi f B\tau]\,d\tau$ with the stroke $A = aT^2$, the smear $B = sT$ and
the even and odd parts of the shutter. At one exposure the bracket is the same for every
acceleration, so the nodes' sum is a matrix product: shutters and speeds by nodes, times
nodes by accelerations. Loops over nodes and taps turn as often as the tile needs, so that
one compiled program serves every tile at its own cost.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from mishutter.sweep_kernels import kernel_metrics
from mishutter.sweep_points import SceneNumbers, Tile, TileSizes
from mishutter.sweep_tables import CHUNK, Tables

_FREQUENCIES = 32


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
        picture = _picture_metrics(tables, scene, tile, mixture)
    return TileMetrics(*kernels, *picture)


def _picture_metrics(
    tables: Tables, scene: SceneNumbers, tile: Tile, mixture: Array
) -> tuple[Array, Array]:
    """Expected squared error and share of the bound."""
    num_frequencies = scene.power.size
    stroke = tile.accelerations
    efficiency = jnp.broadcast_to(tables.efficiency, (stroke.size, tables.efficiency.size))
    if mixture.size:
        efficiency = (mixture @ tables.efficiency)[:, None]
    noise = _noise(efficiency, scene, tile)
    first = _Sums(jnp.zeros_like(noise), jnp.full(efficiency.shape, jnp.inf, noise.dtype))

    def turn(index: Array, sums: _Sums) -> _Sums:
        start = index * _FREQUENCIES
        whole = start + jnp.arange(_FREQUENCIES, dtype=start.dtype)
        frequency = (whole.astype(noise.dtype) + 0.5) * (0.5 / num_frequencies)
        spectra = aligned_spectra(tables, scene, tile, frequency)
        if mixture.size:
            mixed = (jnp.einsum("mskj,jk->msj", part, mixture)[:, :, None] for part in spectra)
            spectra = Spectra(*mixed)
        power = jax.lax.dynamic_slice(scene.power, (start,), (_FREQUENCIES,))
        error, least = _picture_terms(scene, tile, spectra, frequency, power, noise)
        return _Sums(sums.error + error, jnp.minimum(sums.least, least))

    num_turns = jnp.where(tile.num_node_chunks > 0, num_frequencies // _FREQUENCIES, 0)
    sums = jax.lax.fori_loop(0, num_turns, turn, first)
    return sums.error / num_frequencies, sums.least


class Spectra(NamedTuple):
    """Transfer functions; shape `(m, sides * s, k, j)` each part."""

    real: Array
    imag: Array


def aligned_spectra(tables: Tables, scene: SceneNumbers, tile: Tile, frequency: Array) -> Spectra:
    """Transfer functions in the vertex frame at equal steps of frequency."""
    half = tile.half_exposure
    stroke = tile.accelerations * half * half
    smear = scene.speeds * half
    two_sided = scene.weights.shape[0] == 2
    shape = (frequency.size, scene.speeds.size * tables.efficiency.size, stroke.size)
    zero = Spectra(*[jnp.zeros(shape, stroke.dtype)] * 2)

    def turn(index: Array, sums: tuple[Spectra, ...]) -> tuple[Spectra, ...]:
        at = (tile.rule, index * CHUNK)
        tau = jax.lax.dynamic_slice(tables.nodes, at, (1, CHUNK))[0]
        chirp = _waves(frequency, -(tau**2)[:, None] * stroke[None])
        beat = _waves(frequency, smear[:, None] * tau[None])
        light = [(tables.even, beat.real)] + ([(tables.odd, beat.imag)] if two_sided else [])
        return tuple(
            _added(total, _lit(part, at, wave), chirp)
            for total, (part, wave) in zip(sums, light, strict=True)
        )

    start = (zero, zero) if two_sided else (zero,)
    sums = jax.lax.fori_loop(0, tile.num_node_chunks, turn, start)
    shape = (frequency.size, scene.speeds.size, tables.efficiency.size, stroke.size)
    both = even = Spectra(*(x.reshape(shape) for x in sums[0]))
    if two_sided:
        odd = Spectra(*(x.reshape(shape) for x in sums[1]))
        forward = (even.real - odd.imag, even.imag + odd.real)
        back = (even.real + odd.imag, even.imag - odd.real)
        both = Spectra(*(jnp.concatenate(x, axis=1) for x in zip(forward, back, strict=True)))
    return _at_vertex(both, frequency, stroke, jnp.tile(smear, scene.weights.shape[0]))


def _added(total: Spectra, left: Array, right: Spectra) -> Spectra:
    """Sums with the light of some more nodes."""
    parts = zip(total, right, strict=True)
    return Spectra(*(x + jnp.einsum("mnq,mqj->mnj", left, wave) for x, wave in parts))


def _lit(part: Array, at: tuple[Array, Array], wave: Array) -> Array:
    """Light times wave: shutters and speeds by nodes; shape `(m, s * k, q)`."""
    start = (at[0], jnp.zeros_like(at[0]), at[1])
    light = jax.lax.dynamic_slice(part, start, (1, part.shape[1], CHUNK))
    lit = wave[:, :, None, :] * light[:, None]
    return lit.reshape(wave.shape[0], -1, CHUNK)


def _at_vertex(spectra: Spectra, frequency: Array, stroke: Array, smear: Array) -> Spectra:
    """Spectra with the displacement to the vertex taken out, where there is one."""
    moving = stroke > 0
    vertex = smear[:, None] ** 2 / jnp.where(moving, 4 * stroke, 1.0)[None]
    cycles = frequency[:, None, None] * jnp.where(moving[None], vertex, 0.0)[None]
    angle = (2 * jnp.pi) * (cycles - jnp.round(cycles))[:, :, None]
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    return Spectra(
        spectra.real * cosine + spectra.imag * sine, spectra.imag * cosine - spectra.real * sine
    )


def _waves(frequency: Array, position: Array) -> Spectra:
    """Cosine and sine of `2 pi f x` at equal steps of frequency, each from the last; `(m, ...)`."""
    turn = (2 * jnp.pi) * position
    step = (frequency[1] - frequency[0]) * turn
    cosine, sine = jnp.cos(step), jnp.sin(step)

    def rotate(wave: Spectra, _: None) -> tuple[Spectra, Spectra]:
        real = wave.real * cosine - wave.imag * sine
        return Spectra(real, wave.imag * cosine + wave.real * sine), wave

    first = Spectra(jnp.cos(frequency[0] * turn), jnp.sin(frequency[0] * turn))
    return jax.lax.scan(rotate, first, length=frequency.size)[1]


def _noise(efficiency: Array, scene: SceneNumbers, tile: Tile) -> Array:
    """Variance of the noise in electrons; shape `(j, k, p, r)`."""
    electrons = scene.photon_rates * (2 * tile.half_exposure)
    shot = efficiency[:, :, None, None] * scene.mean_level * electrons[None, None, :, None]
    return shot + scene.read_noises[None, None, None] ** 2


def _picture_terms(
    scene: SceneNumbers,
    tile: Tile,
    spectra: Spectra,
    frequency: Array,
    power: Array,
    noise: Array,
) -> tuple[Array, Array]:
    """Sum of the expected error over some frequencies, and the least share of the bound."""
    weights = scene.weights.reshape(-1)
    square = spectra.real**2 + spectra.imag**2
    smear = 4 * scene.max_speed * tile.half_exposure * frequency
    occurs = (weights > 0)[None, :, None, None]
    share = jnp.where(occurs, square, jnp.inf) * jnp.maximum(smear, 1.0)[:, None, None, None]
    least = jnp.min(share, axis=(0, 1)).T
    each = weights[None, :, None, None]
    mean = [jnp.sum(each * part, axis=1) for part in spectra]
    away = [part - middle[:, None] for part, middle in zip(spectra, mean, strict=True)]
    aperture = jnp.sinc(frequency)[:, None, None] ** 2
    spread = aperture * jnp.sum(each * (away[0] ** 2 + away[1] ** 2), axis=1)
    coherent = aperture * (mean[0] ** 2 + mean[1] ** 2)
    electrons = scene.photon_rates * (2 * tile.half_exposure)
    light = (electrons**2)[:, None]

    def add(index: Array, total: Array) -> Array:
        signal = power[index] * light
        v = spread[index].T[:, :, None, None]
        c = coherent[index].T[:, :, None, None]
        remaining = signal[None, None] * v + noise
        whole = signal[None, None] * (c + v) + noise
        dark = whole <= 0
        return total + power[index] * jnp.where(dark, 1.0, remaining / jnp.where(dark, 1.0, whole))

    return jax.lax.fori_loop(0, frequency.size, add, jnp.zeros_like(noise)), least
