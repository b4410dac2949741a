"""Richardson-Lucy deconvolution along rows: plain, accelerated, stopped at the noise.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import compiled, require, require_positive_int, shape_of
from mishutter.camera import along_rows
from mishutter.restore.decoders.banded import BandedConvolution, banded
from mishutter.restore.decoders.base import AbstractDecoder, BlurModel
from mishutter.restore.decoders.borders import Continuation, continuation
from mishutter.restore.decoders.linear import share_left_unexplained, wiener_filter

_LEAST = 1e-6
_DARKEST = 0.02
"""Least share of its light that a pixel starts with: no step leads away from 0."""
_TILE = 128
"""Rows that one loop iterates on: few enough that they stay in the cache."""
_SAMPLE = 64
"""Rows of a plane that decide when it stops."""


@final
class RichardsonLucyDecoder(AbstractDecoder):
    r"""Richardson-Lucy with the still object's kernel (the paper's section 4.2).

    $f \leftarrow f \cdot H^\top(g / Hf) / H^\top 1$, from $g/\eta$ on, on rows continued
    by their likeliest course.

    Args:
        num_iterations: How many steps at most; 30 in the paper.
        accelerated: Whether each step starts from an extrapolation of the last two
            (Biggs and Andrews 1997, as MATLAB's `deconvlucy` does), for each row on its own.
        until_noise: Whether a plane stops when what is left is noise (the discrepancy
            principle): with the step that begins where the mean of
            $(g - Hf)^2 / (Hf/p + (\sigma/p)^2)$, over a sample of its rows, is at most
            what Wiener's filter is expected to leave. That is less than 1, the more so
            the better a blur can be inverted; at 1 the picture is still soft.
        start: The estimate of the first step: `"capture"`, $g/\eta$, or `"wiener"`, what
            Wiener's filter makes of it, which is nearer and shows more of fine detail.

    Raises:
        ValueError: if `num_iterations` is not a positive integer or `start` not one of the two.
    """

    num_iterations: int = eqx.field(static=True, default=30)
    accelerated: bool = eqx.field(static=True, default=False)
    until_noise: bool = eqx.field(static=True, default=False)
    start: str = eqx.field(static=True, default="capture")

    def __check_init__(self) -> None:
        require_positive_int("RichardsonLucyDecoder(num_iterations=...)", self.num_iterations)
        known, subject = self.start in ("capture", "wiener"), "RichardsonLucyDecoder(start=...)"
        require(known, subject, "be 'capture' or 'wiener'", self.start)

    def restore(self, captured: Array, model: BlurModel) -> Array:
        first_tap, taps = model.assumed_taps()
        operator = banded(taps)
        columns = captured.shape[-1]
        extension = continuation(model, columns, multiple=operator.block)
        light = model.efficiency
        if light <= 0:
            return jnp.zeros_like(captured)
        noise = None
        if self.until_noise:
            left = share_left_unexplained(model, extension.length)
            numbers = (1 / model.electrons, model.read_variance, left)
            noise = _Noise(*(np.asarray(v) for v in numbers))
        method = (self.num_iterations, self.accelerated)
        first = wiener_filter(model, extension.length) if self.start == "wiener" else None
        light = np.asarray(light)
        return _restored(captured, extension, operator, -first_tap, light, method, noise, first)


def richardson_lucy(
    captured: ArrayLike, kernel: ArrayLike, *, num_iterations: int = 30, start: float = 0.5
) -> Array:
    r"""Plain Richardson-Lucy along rows in the dark, as scikit-image's on one row of taps.

    $f \leftarrow f \cdot H^\top(g / Hf)$ from a flat start, the picture being dark beyond
    its borders and the kernel's middle tap displacing nothing: of an odd number of
    taps the result is that of
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
    require(one_row, "richardson_lucy(kernel=...)", "be one row of taps", shape_of(taps))
    columns, middle = rows.shape[-1], (taps.size - 1) // 2
    operator = banded(taps)
    length = -(-(columns + taps.size) // operator.block) * operator.block
    return _dark(rows, operator, middle, length, np.asarray(start), num_iterations)


class _Noise(NamedTuple):
    """Variance per light and in the dark, and the share of it that is to be left."""

    per_light: ArrayLike
    constant: ArrayLike
    left: ArrayLike


@compiled
def _dark(
    rows: Array,
    operator: BandedConvolution,
    origin: int,
    length: int,
    start: ArrayLike,
    num_iterations: int,
) -> Array:
    columns = rows.shape[-1]
    outside = [(0, 0)] * (rows.ndim - 1) + [(0, length - columns)]
    data = jnp.pad(rows, outside)
    inside = np.arange(length) < columns
    first = jnp.asarray(start, rows.dtype) * along_rows(inside, data) * jnp.ones_like(data)
    norm = jnp.asarray(np.where(inside, 1.0, np.inf)[None], rows.dtype)
    data = jnp.roll(data, origin, axis=-1)
    found = _iterated(data, first, operator, norm, (num_iterations, False), None)
    return found[..., :columns]


@compiled
def _restored(
    captured: Array,
    extension: Continuation,
    operator: BandedConvolution,
    origin: int,
    light: ArrayLike,
    method: tuple[int, bool],
    noise: _Noise | None,
    first_filter: ArrayLike | None,
) -> Array:
    rows, mean = extension.deviations(captured)
    norm = jnp.asarray(light, rows.dtype)
    data = jnp.maximum(rows + mean, _LEAST * norm)
    start = data / norm
    if first_filter is not None:
        spectrum = jnp.fft.rfft(rows)
        filtered = jnp.fft.irfft(spectrum * along_rows(first_filter, spectrum), extension.length)
        start = jnp.maximum(filtered + mean / norm, _DARKEST * start)
    data = jnp.roll(data, origin, axis=-1)
    recorded = slice(origin, origin + extension.columns)
    counts = None
    if noise is not None:
        given = *jax.lax.stop_gradient((data, start)), operator, norm
        counts = _steps_until_noise(*given, method, recorded, noise)
    return _iterated(data, start, operator, norm, method, counts)[..., : extension.columns]


def _first_state(start: Array, accelerated: bool) -> tuple[Array, ...]:
    """The estimate; accelerated also the one before, and the last two changes."""
    nothing = jnp.zeros_like(start)
    return (start, start, nothing, nothing) if accelerated else (start,)


def _step(state: tuple, data: Array, operator: BandedConvolution, norm: Array):
    """The next state, and the blur of the estimate that the step began from.

    Blur and data are displaced by the origin of the kernel, which so costs nothing.
    """
    begin = state[0]
    if len(state) > 1:
        estimate, before, change, change_before = state
        overlap = jnp.sum(change * change_before, axis=-1, keepdims=True)
        size = jnp.sum(change_before**2, axis=-1, keepdims=True)
        stride = jnp.clip(jnp.where(size > 0, overlap / jnp.where(size > 0, size, 1), 0), 0, 1)
        begin = jnp.maximum(estimate + stride * (estimate - before), 0)
    blurred = jnp.maximum(operator(begin), 1e-12)
    after = begin * jnp.maximum(operator.back(data / blurred), 0) / norm
    return (after, state[0], after - begin, state[2]) if len(state) > 1 else (after,), blurred


def _iterated(
    data: Array,
    start: Array,
    operator: BandedConvolution,
    norm: Array,
    method: tuple[int, bool],
    counts: Array | None,
) -> Array:
    """Steps, as many as are asked for or as `counts` says of each plane, a few rows at a time."""
    rows, length = data.shape[-2:]
    per_plane = -(-rows // _TILE)
    tile = -(-rows // per_plane)
    spare = ((0, 0), (0, per_plane * tile - rows), (0, 0))

    def tiles(planes: Array) -> Array:
        padded = jnp.pad(planes.reshape(-1, rows, length), spare, mode="edge")
        return padded.reshape(-1, tile, length)

    def iterated(item: tuple) -> Array:
        data, start, *count = item

        def step(index: Array, state: tuple) -> tuple:
            after = lambda: _step(state, data, operator, norm)[0]  # noqa: E731
            return jax.lax.cond(index < count[0], after, lambda: state) if count else after()

        # JAX differentiates a loop in reverse only if the number of its turns is known beforehand.
        return jax.lax.fori_loop(0, method[0], step, _first_state(start, method[1]))[0]

    counted = () if counts is None else (jnp.repeat(counts, per_plane),)
    items = (tiles(data), tiles(start), *counted)
    found = jax.lax.map(iterated, items).reshape(-1, per_plane * tile, length)
    return found[:, :rows].reshape(data.shape)


def _steps_until_noise(
    data: Array,
    start: Array,
    operator: BandedConvolution,
    norm: Array,
    method: tuple[int, bool],
    recorded: slice,
    noise: _Noise,
) -> Array:
    """How many steps each plane takes, found on some of its rows; shape `(planes,)`."""
    rows, length = data.shape[-2:]
    some = np.unique(np.linspace(0, rows - 1, min(rows, _SAMPLE)).astype(int))
    planes = [x.reshape(-1, rows, length)[:, some] for x in (data, start)]
    per_light, constant, left = (jnp.asarray(v, data.dtype) for v in noise)

    def unexplained(data: Array, blurred: Array) -> Array:
        variance = jnp.maximum(blurred, _LEAST) * per_light + constant
        noisy = jnp.where(variance > 0, variance, 1)
        return jnp.mean(jnp.where(variance > 0, (data - blurred) ** 2 / noisy, jnp.inf))

    def counted(pair: tuple) -> Array:
        data, start = pair

        def advance(carry: tuple) -> tuple:
            index, _, state = carry
            state, blurred = _step(state, data, operator, norm)
            going = unexplained(data[:, recorded], blurred[:, recorded]) > left
            return index + 1, going, state

        first = (jnp.zeros((), jnp.int32), jnp.ones((), bool), _first_state(start, method[1]))
        unfinished = lambda carry: (carry[0] < method[0]) & carry[1]  # noqa: E731
        return jax.lax.while_loop(unfinished, advance, first)[0]

    return jax.lax.map(counted, tuple(planes))
