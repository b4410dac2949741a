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
from mishutter.camera import along_rows, blurred
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
_LEAST_BLURRED = 0.1
"""Least blur of an estimate, as a share of the capture: taps of a band-limited kernel are below 0
here and there, and so may be what they make of an estimate that ends sharply in the dark."""
_LEAST_GAIN = 0.02
"""Share of what is unexplained that a step must explain for another to follow."""


@final
class RichardsonLucyDecoder(AbstractDecoder):
    r"""Richardson-Lucy with the still object's kernel (the paper's section 4.2).

    $f \leftarrow f \cdot H^\top(g / Hf) / H^\top 1$ on rows continued by their likeliest course.
    The paper's takes 30 plain steps from the capture on. By default they are accelerated, start
    from Wiener's estimate and stop at what no kernel for all speeds explains: objects move at
    speeds that the one kernel fits only nearly, and further steps make ghosts of the difference.

    Args:
        num_iterations: How many steps at most; 30 in the paper.
        accelerated: Whether each step starts from an extrapolation of the last two
            (Biggs and Andrews 1997, as MATLAB's `deconvlucy` does), for each row on its own.
        until_noise: Whether a plane stops when what is left is noise and the difference of
            kernels (the discrepancy principle): with the step that begins where the mean of
            $(g - Hf)^2 / (Hf/p + (\sigma/p)^2)$, over a sample of its rows, is at most what
            Wiener's filter is expected to leave of an object at the speed that it fits worst,
            or that makes it less by under 2 %. Of one speed that is less than 1, the more so the
            better a blur can be inverted; at 1 the picture is still soft.
        start: The estimate of the first step: `"capture"`, $g/\eta$, or `"wiener"`, what
            Wiener's filter makes of it, which is nearer and shows more of fine detail.

    Raises:
        ValueError: if `num_iterations` is not a positive integer or `start` not one of the two.
    """

    num_iterations: int = eqx.field(static=True, default=30)
    accelerated: bool = eqx.field(static=True, default=True)
    until_noise: bool = eqx.field(static=True, default=True)
    start: str = eqx.field(static=True, default="wiener")

    def __check_init__(self) -> None:
        require_positive_int("RichardsonLucyDecoder(num_iterations=...)", self.num_iterations)
        known, subject = self.start in ("capture", "wiener"), "RichardsonLucyDecoder(start=...)"
        require(known, subject, "be 'capture' or 'wiener'", self.start)

    def restore(self, captured: Array, model: BlurModel) -> Array:
        extension = continuation(model, captured.shape[-1])
        operator = _Blur(model.assumed_response(extension.length))
        light = model.efficiency
        if light <= 0:
            return jnp.zeros_like(captured)
        noise = None
        if self.until_noise:
            left = share_left_unexplained(model, extension.length)
            numbers = (1 / model.electrons, model.read_variance, left)
            noise = _Noise(*(np.asarray(v) for v in numbers))
        method = _Method(self.num_iterations, self.accelerated, _LEAST_BLURRED)
        first = wiener_filter(model, extension.length) if self.start == "wiener" else None
        light = np.asarray(light)
        return _restored(captured, extension, operator, light, method, noise, first)


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


@final
class _Blur(eqx.Module):
    """Periodic blur by a response on the grid of the DFT, and its adjoint.

    Attributes:
        response: Shape `(length // 2 + 1,)`.
    """

    response: ArrayLike

    def __call__(self, rows: Array) -> Array:
        return blurred(rows, self.response)

    def back(self, rows: Array) -> Array:
        """The adjoint of `__call__`."""
        return blurred(rows, jnp.conj(jnp.asarray(self.response)))


class _Method(NamedTuple):
    """Steps at most, whether they are accelerated, and the least blur in units of the capture."""

    num_iterations: int
    accelerated: bool
    least_blurred: float


class _Noise(NamedTuple):
    """Variance per light and in the dark, and the share of it that is to be left."""

    per_light: ArrayLike
    constant: ArrayLike
    left: ArrayLike


Operator = BandedConvolution | _Blur


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
    method = _Method(num_iterations, accelerated=False, least_blurred=0.0)
    found = _iterated(data, first, operator, norm, method, None)
    return found[..., :columns]


@compiled
def _restored(
    captured: Array,
    extension: Continuation,
    operator: _Blur,
    light: ArrayLike,
    method: _Method,
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
    counts = None
    if noise is not None:
        given = *jax.lax.stop_gradient((data, start)), operator, norm
        counts = _steps_until_noise(*given, method, slice(0, extension.columns), noise)
    return _iterated(data, start, operator, norm, method, counts)[..., : extension.columns]


def _first_state(start: Array, accelerated: bool) -> tuple[Array, ...]:
    """The estimate; accelerated also the one before, and the last two changes."""
    nothing = jnp.zeros_like(start)
    return (start, start, nothing, nothing) if accelerated else (start,)


def _step(state: tuple, data: Array, operator: Operator, norm: Array, least_blurred: float):
    """The next state, and the blur of the estimate that the step began from."""
    begin = state[0]
    if len(state) > 1:
        estimate, before, change, change_before = state
        overlap = jnp.sum(change * change_before, axis=-1, keepdims=True)
        size = jnp.sum(change_before**2, axis=-1, keepdims=True)
        stride = jnp.clip(jnp.where(size > 0, overlap / jnp.where(size > 0, size, 1), 0), 0, 1)
        begin = jnp.maximum(estimate + stride * (estimate - before), 0)
    again = jnp.maximum(operator(begin), jnp.maximum(least_blurred * data, 1e-12))
    after = begin * jnp.maximum(operator.back(data / again), 0) / norm
    return (after, state[0], after - begin, state[2]) if len(state) > 1 else (after,), again


def _iterated(
    data: Array,
    start: Array,
    operator: Operator,
    norm: Array,
    method: _Method,
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
            after = lambda: _step(state, data, operator, norm, method.least_blurred)[0]  # noqa: E731
            return jax.lax.cond(index < count[0], after, lambda: state) if count else after()

        # JAX differentiates a loop in reverse only if the number of its turns is known beforehand.
        first = _first_state(start, method.accelerated)
        return jax.lax.fori_loop(0, method.num_iterations, step, first)[0]

    counted = () if counts is None else (jnp.repeat(counts, per_plane),)
    items = (tiles(data), tiles(start), *counted)
    found = jax.lax.map(iterated, items).reshape(-1, per_plane * tile, length)
    return found[:, :rows].reshape(data.shape)


def _steps_until_noise(
    data: Array,
    start: Array,
    operator: Operator,
    norm: Array,
    method: _Method,
    recorded: slice,
    noise: _Noise,
) -> Array:
    """How many steps each plane takes, found on some of its rows; shape `(planes,)`."""
    rows, length = data.shape[-2:]
    some = np.unique(np.linspace(0, rows - 1, min(rows, _SAMPLE)).astype(int))
    planes = [x.reshape(-1, rows, length)[:, some] for x in (data, start)]
    per_light, constant, left = (jnp.asarray(v, data.dtype) for v in noise)

    def unexplained(data: Array, again: Array) -> Array:
        variance = jnp.maximum(again, _LEAST) * per_light + constant
        noisy = jnp.where(variance > 0, variance, 1)
        return jnp.mean(jnp.where(variance > 0, (data - again) ** 2 / noisy, jnp.inf))

    def counted(pair: tuple) -> Array:
        data, start = pair

        def advance(carry: tuple) -> tuple:
            index, _, before, state = carry
            state, again = _step(state, data, operator, norm, method.least_blurred)
            now = unexplained(data[:, recorded], again[:, recorded])
            return index + 1, (now > left) & (now < (1 - _LEAST_GAIN) * before), now, state

        beyond = jnp.full((), jnp.finfo(data.dtype).max, data.dtype)
        state = _first_state(start, method.accelerated)
        first = (jnp.zeros((), jnp.int32), jnp.ones((), bool), beyond, state)
        unfinished = lambda carry: (carry[0] < method.num_iterations) & carry[1]  # noqa: E731
        return jax.lax.while_loop(unfinished, advance, first)[0]

    return jax.lax.map(counted, tuple(planes))
