r"""Transfer functions of a tile: every shutter, every speed, some frequencies.

In normalised time the transfer function of a point is
$H_s(f) = \int_0^1 e^{-2\pi i f A\tau^2}\,[w_e(\tau)\cos 2\pi f B\tau +
i\,w_o(\tau)\sin 2\pi f B\tau]\,d\tau$ with the stroke $A = aT^2$, the smear $B = sT$ and
the even and odd parts of the shutter. At one exposure the bracket is the same for every
acceleration, so the nodes' sum is a matrix product: shutters and speeds by nodes, times
nodes by accelerations. The loop over nodes turns as often as tile and frequencies need.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from mishutter._core import computed_once
from mishutter.evaluation import aligned
from mishutter.sweeps.points import SceneNumbers, Tile
from mishutter.sweeps.tables import CHUNK, Tables
from mishutter.sweeps.waves import paired_waves, waves


class Spectra(NamedTuple):
    """Transfer functions; shape `(m, sides * s, k, j)` each part."""

    real: Array
    imag: Array


def aligned_spectra(
    tables: Tables, scene: SceneNumbers, tile: Tile, frequency: Array, part: Array | int
) -> Spectra:
    """Transfer functions in the vertex frame.

    Args:
        tables: Tables of `k` shutters.
        scene: What the scene brings.
        tile: The points.
        frequency: Equal steps, cycles/px; shape `(m,)`.
        part: The part of (0, 0.5) cycles/px, of those that have rules of their own, that
            holds the highest of them.
    """
    half = tile.half_exposure
    stroke = tile.accelerations * half * half
    smear = scene.speeds * half
    two_sided = scene.weights.shape[0] == 2
    rule = tile.rules[part]

    def turn(index: Array, sums: tuple[Array, ...]) -> tuple[Array, ...]:
        at = (rule, index * CHUNK)
        tau = jax.lax.dynamic_slice(tables.nodes, at, (1, CHUNK))[0]
        chirp = paired_waves(frequency, -(tau**2)[:, None] * stroke[None])
        beat = waves(frequency, smear[:, None] * tau[None])
        light = [tables.even, tables.odd][: len(sums)]
        return tuple(
            total + jnp.einsum("mnq,mqj->mnj", _lit(table, at, wave), chirp)
            for total, table, wave in zip(sums, light, beat, strict=False)
        )

    shape = (frequency.size, smear.size * tables.efficiency.size, 2 * stroke.size)
    start = (jnp.zeros(shape, stroke.dtype),) * (1 + two_sided)
    sums = jax.lax.fori_loop(0, tile.num_node_chunks[part], turn, start)
    shape = (frequency.size, smear.size, tables.efficiency.size, 2, stroke.size)
    both = even = Spectra(*jnp.moveaxis(sums[0].reshape(shape), 3, 0))
    if two_sided:
        odd = Spectra(*jnp.moveaxis(sums[1].reshape(shape), 3, 0))
        forward = (even.real - odd.imag, even.imag + odd.real)
        back = (even.real + odd.imag, even.imag - odd.real)
        both = Spectra(*(jnp.concatenate(x, axis=1) for x in zip(forward, back, strict=True)))
    occurs = jnp.any(scene.weights > 0, axis=0)
    displacement = aligned(stroke[None], jnp.where(occurs, smear, 0)[:, None]).displacement
    return _displaced(both, frequency, jnp.tile(displacement, (scene.weights.shape[0], 1)))


def _lit(table: Array, at: tuple[Array, Array], wave: Array) -> Array:
    """Light times wave: shutters and speeds by nodes; shape `(m, s * k, q)`."""
    start = (at[0], jnp.zeros_like(at[0]), at[1])
    light = jax.lax.dynamic_slice(table, start, (1, table.shape[1], CHUNK))
    lit = wave[:, :, None, :] * light[:, None]
    return lit.reshape(wave.shape[0], -1, CHUNK)


def _displaced(spectra: Spectra, frequency: Array, displacement: Array) -> Spectra:
    """Spectra of objects that are moved from mid-exposure; px, shape `(sides * s, j)`."""
    cosine, sine = (x[:, :, None] for x in waves(frequency, displacement))

    def moved() -> Spectra:
        real, imag = spectra
        return Spectra(real * cosine + imag * sine, imag * cosine - real * sine)

    return computed_once(moved, frequency[0] > 0)
