"""Richardson-Lucy deconvolution along rows: plain, accelerated, and with a penalty on noise.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core.checks import require, require_finite, require_positive_int, shape_of
from mishutter._core.compiling import compiled
from mishutter.camera.capture import as_pixels
from mishutter.camera.rows import along_rows, blurred, fast_length
from mishutter.decoding.decoders.base import AbstractDecoder, BlurModel
from mishutter.decoding.decoders.borders import Continuation, continuation
from mishutter.decoding.decoders.linear import (
    LEAST_POWER,
    ensemble_filter,
    expected_squared_error,
    wiener_filter,
)
from mishutter.decoding.decoders.total_variation import EDGES, adjoint_differences, differences

_LEAST = 1e-6


@final
class RichardsonLucyDecoder(AbstractDecoder):
    r"""Richardson-Lucy: the likeliest picture of few edges, of none below black, for all speeds.

    $f \leftarrow f \cdot H^\top(g / Hf) / H^\top 1$ on rows continued by their likeliest course.
    The paper's, with the still object's kernel (its section 4.2), takes 30 plain steps from the
    capture on. By default they are accelerated, start from an estimate, and lead to
    $\max_f \sum_k [(g_k + d) \log((Hf)_k + d) - (Hf)_k] - \tfrac{0.3}{e p} \sum |\nabla f|$ with
    $|\nabla f|$ that of the `TotalVariationDecoder`. The mean response $H = \sum p_i H_i$ stands
    for all speeds; $d = \sigma^2/p + \bar g/10$ counts noise of reading as that of so much more
    light, and prevents steps that are too long to settle in the dark; $e$ is the root mean square
    error that the ensemble filter is expected to leave. The steps are
    $f \leftarrow f \cdot H^\top((g + d)/(Hf + d)) / (H^\top 1 - \tfrac{0.3}{e p} \nabla \cdot q)$,
    in turns with steps of $q$, $|q| \le 1$, along $\nabla f$ (Chambolle and Pock 2011).

    Args:
        num_iterations: Number of steps; 30 in the paper.
        accelerated: Whether each step starts from an extrapolation of the last two
            (Biggs and Andrews 1997, as MATLAB's `deconvlucy` does), for each row on its own.
        until_noise: Whether edges, noise of reading and all speeds count. Without, the kernel is
            the still object's and steps lead on into the noise.
        start: The estimate of the first step: `"capture"`, $g/\eta$, or `"wiener"`, that of
            the filter for the same speeds, Wiener's for one and the ensemble filter for all,
            which is nearer and shows more of fine detail.

    Raises:
        ValueError: if `num_iterations` is not a positive integer or `start` not one of the two.
    """

    num_iterations: int = eqx.field(static=True, default=15)
    accelerated: bool = eqx.field(static=True, default=True)
    until_noise: bool = eqx.field(static=True, default=True)
    start: str = eqx.field(static=True, default="wiener")

    def __check_init__(self) -> None:
        require_positive_int("RichardsonLucyDecoder(num_iterations=...)", self.num_iterations)
        is_start, subject = self.start in ("capture", "wiener"), "RichardsonLucyDecoder(start=...)"
        require(is_start, subject, "be 'capture' or 'wiener'", self.start)

    @property
    def rows_beyond(self) -> int:
        return self.num_iterations + 1 if self.until_noise else 0

    def restore(self, captured: Array, model: BlurModel) -> Array:
        efficiency = model.efficiency
        if efficiency <= 0:
            return jnp.zeros_like(captured)
        extension = continuation(model, captured.shape[-1])
        length, penalty = extension.length, None
        if self.until_noise:
            response, filtering = model.mean_and_spread(length)[0], ensemble_filter
            error = np.sqrt(max(expected_squared_error(model, length), LEAST_POWER))
            strength = EDGES / (error * model.electrons)
            dark = model.electrons * model.read_variance
            penalty = _Penalty(np.asarray(strength), np.asarray(dark))
        else:
            response, filtering = model.assumed_response(length), wiener_filter
        # Taps of a band-limited kernel are below 0 here and there, and so may be the blur of an
        # estimate that ends sharply in the dark: it is at least a tenth of the capture.
        method = _Method(self.num_iterations, self.accelerated, least_blurred=0.1)
        first = filtering(model, length) if self.start == "wiener" else None
        return _restored(
            captured,
            extension,
            np.asarray(response),
            np.asarray(efficiency),
            method,
            penalty=penalty,
            first_filter=first,
        )


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
        captured: Light, as floating-point numbers; shape `(..., rows, columns)`.
        kernel: Taps; shape `(n,)`.
        num_iterations: Number of steps.
        start: Value of the first estimate.

    Returns:
        Shape and dtype of `captured`.

    Raises:
        ValueError: if `num_iterations` is not a positive integer, `captured` not finite light in
            rows and columns, or `kernel` not a row of finite taps.
    """
    require_positive_int("richardson_lucy(num_iterations=...)", num_iterations)
    rows = jnp.asarray(as_pixels(captured, "richardson_lucy(captured=...)"))
    taps, subject = np.asarray(kernel), "richardson_lucy(kernel=...)"
    require(taps.ndim == 1 and taps.size >= 1, subject, "be one row of taps", shape_of(taps))
    require_finite(subject, taps)
    columns, middle = rows.shape[-1], (taps.size - 1) // 2
    length = fast_length(columns + taps.size)
    response = np.fft.rfft(taps, length)
    return _dark(rows, response, middle, length, np.asarray(start), num_iterations=num_iterations)


class _Method(NamedTuple):
    """Number of steps, whether they are accelerated, and the least blur, in the capture's unit."""

    num_iterations: int
    accelerated: bool
    least_blurred: float


class _Penalty(NamedTuple):
    """Weight of differences of neighbours, and the light whose noise is that of reading."""

    strength: ArrayLike
    dark: ArrayLike


class _State(NamedTuple):
    """The estimate; if accelerated, the last one and two changes; if penalised, the flow."""

    estimate: Array
    before: Array | None
    change: Array | None
    change_before: Array | None
    flow: Array | None

    @property
    def extrapolated(self) -> Array:
        """Prevents many small steps the same way, row by row."""
        estimate, before, change, change_before, _ = self
        if before is None or change is None or change_before is None:
            return estimate
        overlap = jnp.sum(change * change_before, axis=-1, keepdims=True)
        size = jnp.sum(change_before**2, axis=-1, keepdims=True)
        moves = size > jnp.finfo(size.dtype).tiny ** 0.5  # whose square is a number yet
        stride = jnp.clip(jnp.where(moves, overlap / jnp.where(moves, size, 1), 0), 0, 1)
        return jnp.maximum(estimate + stride * (estimate - before), 0)


@compiled
def _dark(
    rows: Array,
    response: ArrayLike,
    origin: int,
    length: int,
    start: ArrayLike,
    *,
    num_iterations: int,
) -> Array:
    """Plain steps on rows that are dark beyond their ends."""
    columns = rows.shape[-1]
    outside = [(0, 0)] * (rows.ndim - 1) + [(0, length - columns)]
    data = jnp.pad(rows, outside)
    inside = np.arange(length) < columns
    first = jnp.asarray(start, rows.dtype) * along_rows(inside, data) * jnp.ones_like(data)
    # Dividing by infinity keeps the picture dark beyond its ends.
    norm = jnp.asarray(np.where(inside, 1.0, np.inf)[None], rows.dtype)
    data = jnp.roll(data, origin, axis=-1)
    method = _Method(num_iterations, accelerated=False, least_blurred=0.0)
    return _iterated(data, first, response, norm, method)[..., :columns]


@compiled
def _restored(
    captured: Array,
    extension: Continuation,
    response: ArrayLike,
    efficiency: ArrayLike,
    method: _Method,
    *,
    penalty: _Penalty | None,
    first_filter: ArrayLike | None,
) -> Array:
    """Steps on continued rows, from the capture or from an estimate by the `first_filter`."""
    rows, mean = extension.deviations(captured)
    norm = jnp.asarray(efficiency, rows.dtype)
    data = jnp.maximum(rows + mean, _LEAST * norm)
    start = data / norm
    if first_filter is not None:
        spectrum = jnp.fft.rfft(rows)
        filtered = jnp.fft.irfft(spectrum * along_rows(first_filter, spectrum), extension.length)
        # No step leads away from 0.
        start = jnp.maximum(filtered + mean / norm, 0.02 * start)
    estimate = _iterated(data, start, response, norm, method, penalty=penalty)
    return estimate[..., : extension.columns]


def _step(
    state: _State,
    data: Array,
    response: ArrayLike,
    norm: Array,
    *,
    least_blurred: float,
    penalty: _Penalty | None,
) -> _State:
    begin = state.extrapolated
    dark, flow, weight = jnp.zeros((), data.dtype), state.flow, norm
    if penalty is not None and flow is not None:
        strength, dark = (jnp.asarray(v, data.dtype) for v in penalty)
        # The flow goes along the differences, as far as is stable beside steps of the estimate.
        rows = jnp.pad(begin, ((1, 1), (0, 0)), mode="edge")
        pairs = jnp.maximum(rows, jnp.roll(rows, -1, axis=1))
        largest = jnp.maximum(jnp.maximum(pairs[:-1], pairs[1:]), _LEAST)
        longer = flow + differences(begin) / (8 * (strength / norm) * largest)[None]
        size = jnp.sum(longer**2, axis=0, keepdims=True)
        flow = longer / jnp.sqrt(jnp.maximum(size, 1))
        # Edges push by no more than a few times.
        weight = jnp.maximum(norm + strength * adjoint_differences(flow), 0.2 * norm)
    total = data + dark
    blurred_again = jnp.maximum(
        blurred(begin, response) + dark, jnp.maximum(least_blurred * total, 1e-12)
    )
    # Taps of a band-limited kernel are below 0 here and there, which must not make light negative.
    back = blurred(total / blurred_again, jnp.conj(jnp.asarray(response)))
    after = begin * jnp.maximum(back, 0) / weight
    if state.before is None:
        return _State(after, None, None, None, flow)
    return _State(after, state.estimate, after - begin, state.change, flow)


def _iterated(
    data: Array,
    start: Array,
    response: ArrayLike,
    norm: Array,
    method: _Method,
    *,
    penalty: _Penalty | None = None,
) -> Array:
    """Steps, a few rows at a time: differences reach one row further with each of them."""
    rows, length = data.shape[-2:]
    count = -(-rows // 128)  # few enough rows that a loop's stay in the cache
    tile, beyond = -(-rows // count), 0 if penalty is None else method.num_iterations + 1
    if tile + 2 * beyond >= rows:
        count, tile, beyond = 1, rows, 0
    size = tile + 2 * beyond
    first = np.clip(np.arange(count) * tile - beyond, 0, rows - size)

    def tiles(planes: Array) -> Array:
        some = planes.reshape(-1, rows, length)[:, first[:, None] + np.arange(size)[None]]
        return some.reshape(-1, size, length)

    means = jnp.repeat(jnp.mean(data.reshape(-1, rows * length), axis=1), count)

    def iterated(item: tuple[Array, Array, Array]) -> Array:
        data, start, mean = item
        weights = penalty
        if weights is not None:
            # The noise of so much light counts in the dark.
            dark = jnp.asarray(weights.dark, data.dtype) + 0.1 * mean
            weights = weights._replace(dark=dark)

        def step(_: Array, state: _State) -> _State:
            return _step(
                state, data, response, norm, least_blurred=method.least_blurred, penalty=weights
            )

        # JAX differentiates a loop in reverse only if the number of its turns is known beforehand.
        nothing = jnp.zeros_like(start)
        before = (start, nothing, nothing) if method.accelerated else (None, None, None)
        begin = _State(start, *before, flow=None if penalty is None else differences(nothing))
        return jax.lax.fori_loop(0, method.num_iterations, step, begin).estimate

    estimates = jax.lax.map(iterated, (tiles(data), tiles(start), means))
    owner = np.arange(rows) // tile
    place = np.arange(rows) - first[owner]
    return estimates.reshape(-1, count, size, length)[:, owner, place].reshape(data.shape)
