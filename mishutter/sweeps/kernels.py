"""Metrics of the blur kernels of a tile, from the running integrals of its shutters."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array

from mishutter._core import computed_once
from mishutter.blur import condition_number
from mishutter.sweeps.points import SceneNumbers, Tile, TileSizes
from mishutter.sweeps.tables import Antiderivative, Tables, integral_to, mixed

TAPS = 32
"""Taps that are done in one turn."""


def kernel_metrics(
    tables: Tables, scene: SceneNumbers, sizes: TileSizes, tile: Tile, mixture: Array
) -> tuple[Array, Array, Array]:
    """Condition number, squares of kernel differences and of the still kernel; `(j, k)`."""
    half, rest = tile.half_exposure, tile.accelerations == 0
    stroke = tile.accelerations * half * half
    sides = [scene.speeds, -scene.speeds][: scene.weights.shape[0]]
    smear = jnp.concatenate(sides) * half
    weights = scene.weights.reshape(-1)
    shape = (tile.accelerations.size, 1 if mixture.size else tables.efficiency.size)
    with_rest = jnp.concatenate([jnp.zeros_like(smear[:1]), smear])
    integrals = (mixed(tables.integrals, mixture),) if mixture.size else tables.integrals
    kernels = partial(_kernels, integrals, stroke, rest)

    def add(index: Array, sums: tuple[Array, Array]) -> tuple[Array, Array]:
        taps = kernels(scene.max_speed * half, with_rest, index)
        still, moving = taps[:, :, 0], taps[:, :, 1:]
        difference = jnp.sum((moving - still[:, :, None]) ** 2, axis=3)
        total = jnp.sum(weights[None, None] * difference, axis=2)
        return sums[0] + total, sums[1] + jnp.sum(still**2, axis=2)

    zero = jnp.zeros(shape[::-1], stroke.dtype)
    moved, still = jax.lax.fori_loop(0, tile.num_tap_chunks, add, (zero, zero))

    def fill(index: Array, taps: Array) -> Array:
        part = kernels(jnp.zeros_like(half), with_rest[:1], index)
        start = (jnp.zeros_like(index),) * 2 + (index * TAPS,)
        return jax.lax.dynamic_update_slice(taps, part[:, :, 0], start)

    empty = jnp.zeros((*shape[::-1], sizes.still_taps), stroke.dtype)
    still_kernel = jax.lax.fori_loop(0, tile.num_still_chunks, fill, empty)
    rows = still_kernel.reshape(-1, sizes.still_taps)
    branches = [jax.vmap(partial(_condition, num_frequencies=length)) for length in sizes.lengths]
    condition = jax.lax.switch(tile.length, branches, rows)
    return condition.reshape(shape[::-1]).T, moved.T, still.T


def _condition(kernel: Array, num_frequencies: int) -> Array:
    """Condition number of a kernel that has light on as many taps at most."""
    return condition_number(kernel[:num_frequencies], num_frequencies=num_frequencies)


def _kernels(
    integrals: tuple[Antiderivative, ...],
    stroke: Array,
    rest: Array,
    reach: Array,
    smear: Array,
    index: Array,
) -> Array:
    """Some taps of every kernel; shape `(k, j, s, TAPS)`.

    A tap is the time its edges enclose on each arm of the path, weighed by the shutter:
    a difference of the running integral. A camera at rest has one arm, and its kernels
    start as far before mid-exposure as the fastest object reaches.
    """
    whole = index * TAPS + jnp.arange(TAPS + 1, dtype=index.dtype)
    edge = whole.astype(stroke.dtype)[None, None]
    safe = jnp.maximum(stroke, 1e-30)[:, None, None]
    root = jnp.sqrt(edge / safe)
    vertex = smear[None, :, None] / (2 * safe)
    from_middle = edge - 0.5 - jnp.ceil(reach)
    slow = jnp.where(jnp.abs(smear) < 0.25, 0.25, smear)[None, :, None]
    still = rest[:, None, None]
    later = jnp.where(still, 0.0, vertex + root)
    earlier = jnp.where(still, -from_middle / slow, vertex - root)
    sign = jnp.where(still & (slow < 0), -1.0, 1.0)

    def light() -> Array:
        return jnp.stack(
            [integral_to(w, later) - sign * integral_to(w, earlier) for w in integrals]
        )

    return jnp.diff(computed_once(light, index >= 0)) / 2
