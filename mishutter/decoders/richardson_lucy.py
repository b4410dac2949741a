"""Richardson-Lucy deconvolution along rows: plain, accelerated, stopped at the noise."""

from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter.decoders.banded import BLOCK, BandedConvolution, banded
from mishutter.decoders.base import AbstractDecoder, BlurModel
from mishutter.decoders.borders import continuation
from mishutter.rows import along_rows
from mishutter.types import require, require_positive_int

_LEAST = 1e-6
_TILE = 32
"""Rows that are iterated on together: few enough that they stay in a core's cache."""


@final
class RichardsonLucyDecoder(AbstractDecoder):
    r"""Richardson-Lucy with the still object's kernel (the paper's section 4.2).

    $f \leftarrow f \cdot H^\top(g / Hf) / H^\top 1$, from $g/\eta$ on, on rows continued
    by their likeliest course.

    Args:
        num_iterations: How many steps at most; 30 in the paper.
        accelerated: Whether each step starts from an extrapolation of the last two
            (Biggs and Andrews 1997, as MATLAB's `deconvlucy` does), for each row on its own.
        until_noise: Whether a plane stops when what is left is the noise: when the mean
            of $(g - Hf)^2 / (Hf/p + (\sigma/p)^2)$ falls to 1 (the discrepancy principle).

    Raises:
        ValueError: if `num_iterations` is not a positive integer.
    """

    num_iterations: int = eqx.field(static=True, default=30)
    accelerated: bool = eqx.field(static=True, default=False)
    until_noise: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        require_positive_int("RichardsonLucyDecoder(num_iterations=...)", self.num_iterations)

    def restore(self, captured: Array, model: BlurModel) -> Array:
        extension = continuation(model, captured.shape[-1], multiple=BLOCK)
        operator = banded(model.assumed, model.origin)
        light = model.efficiency
        if light <= 0:
            return jnp.zeros_like(captured)
        rows, mean = extension.deviations(captured)
        data = jnp.maximum(rows + mean, _LEAST * light)
        floor = np.full(extension.length, light)
        steps, fast = self.num_iterations, self.accelerated
        if self.until_noise:
            variances = tuple(np.asarray(v) for v in (1 / model.electrons, model.read_variance))
            estimate = _until_noise(
                data, operator, floor, captured.shape[-1], variances, steps, fast
            )
        else:
            estimate = _tiled(data, data / light, operator, floor, steps, fast)
        return estimate[..., : captured.shape[-1]]


def richardson_lucy(
    captured: ArrayLike, kernel: ArrayLike, *, num_iterations: int = 30, start: float = 0.5
) -> Array:
    r"""Plain Richardson-Lucy along rows in the dark, as scikit-image's on one row of taps.

    $f \leftarrow f \cdot H^\top(g / Hf)$ from a flat start, the picture being dark beyond
    its borders and the kernel's middle tap displacing nothing: the result agrees with
    `skimage.restoration.richardson_lucy(captured, kernel[None], clip=False)`. For
    photographs use `RichardsonLucyDecoder`, which knows better about borders.

    Args:
        captured: Shape `(..., rows, columns)`.
        kernel: Taps; shape `(n,)`.
        num_iterations: How many steps.
        start: Value of the first estimate.

    Returns:
        Shape and dtype of `captured`.

    Raises:
        ValueError: if `num_iterations` is not a positive integer or `kernel` not a row.
    """
    require_positive_int("richardson_lucy(num_iterations=...)", num_iterations)
    taps, rows = np.asarray(kernel), jnp.asarray(captured)
    one_row = taps.ndim == 1 and taps.size >= 1
    require(one_row, "richardson_lucy(kernel=...)", "be one row of taps", f"shape {taps.shape}")
    columns = rows.shape[-1]
    length = -(-(columns + taps.size) // BLOCK) * BLOCK
    padding = [(0, 0)] * (rows.ndim - 1) + [(0, length - columns)]
    data = jnp.pad(rows, padding)
    inside = np.pad(np.ones(columns), padding[-1])
    first = start * along_rows(inside, data) * jnp.ones_like(data)
    operator = banded(taps, (taps.size - 1) // 2)
    floor = np.where(inside > 0, 1.0, np.inf)
    return _tiled(data, first, operator, floor, num_iterations, False)[..., :columns]


def _step(estimate: Array, data: Array, operator: BandedConvolution, norm: Array) -> Array:
    blurred = jnp.maximum(operator(estimate), 1e-12)
    return estimate * jnp.maximum(operator.back(data / blurred), 0) / norm


def _steps(data: Array, start: Array, operator: BandedConvolution, norm: Array, fast: bool):
    """State before the first step, and the step; each row is accelerated on its own."""

    def step(state: tuple) -> tuple:
        if not fast:
            return (_step(state[0], data, operator, norm),)
        estimate, before, change, change_before = state
        overlap = jnp.sum(change * change_before, axis=-1, keepdims=True)
        size = jnp.sum(change_before**2, axis=-1, keepdims=True)
        stride = jnp.clip(jnp.where(size > 0, overlap / jnp.where(size > 0, size, 1), 0), 0, 1)
        ahead = jnp.maximum(estimate + stride * (estimate - before), 0)
        after = _step(ahead, data, operator, norm)
        return after, estimate, after - ahead, change

    nothing = jnp.zeros_like(start)
    return ((start, start, nothing, nothing) if fast else (start,)), step


@eqx.filter_jit
def _tiled(
    data: Array, start: Array, operator: BandedConvolution, norm: ArrayLike, steps: int, fast: bool
):
    """A fixed number of steps, on a few rows at a time."""
    length = data.shape[-1]
    rows = data.reshape(-1, length)
    tile = min(_TILE, rows.shape[0])
    spare = -rows.shape[0] % tile
    shape = (-1, tile, length)
    tiles = [
        jnp.pad(x.reshape(-1, length), ((0, spare), (0, 0)), mode="edge").reshape(shape)
        for x in (data, start)
    ]

    def iterated(pair: tuple) -> Array:
        state, step = _steps(pair[0], pair[1], operator, along_rows(norm, pair[0]), fast)
        return jax.lax.fori_loop(0, steps, lambda _, s: step(s), state)[0]

    result = jax.lax.map(iterated, tuple(tiles)).reshape(-1, length)
    return result[: rows.shape[0]].reshape(data.shape)


@eqx.filter_jit
def _until_noise(
    data: Array,
    operator: BandedConvolution,
    norm: ArrayLike,
    columns: int,
    variances: tuple,
    steps: int,
    fast: bool,
):
    """Steps until what each plane leaves unexplained is the noise."""
    norm = along_rows(norm, data)
    state, step = _steps(data, data / norm, operator, norm, fast)
    recorded = data[..., :columns]
    per_light, constant = (jnp.asarray(v, data.dtype) for v in variances)

    def unexplained(estimate: Array) -> Array:
        blurred = operator(estimate)[..., :columns]
        variance = jnp.maximum(blurred, _LEAST) * per_light + constant
        excess = jnp.where(variance > 0, (recorded - blurred) ** 2 / variance, jnp.inf)
        return jnp.mean(excess, axis=(-2, -1), keepdims=True) > 1

    def advance(carry: tuple) -> tuple:
        index, going, state = carry
        ahead = step(state)
        kept = tuple(jnp.where(going, new, old) for new, old in zip(ahead, state, strict=True))
        return index + 1, going & unexplained(kept[0]), kept

    start = (jnp.zeros((), jnp.int32), unexplained(state[0]), state)
    going_on = lambda carry: (carry[0] < steps) & jnp.any(carry[1])  # noqa: E731
    return jax.lax.while_loop(going_on, advance, start)[2][0]
