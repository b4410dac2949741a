"""Least squares with a penalty on total variation in two dimensions."""

import math
from collections.abc import Callable
from typing import NamedTuple, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.fft import dct, idct
from jaxtyping import Array, Complex, Float

from mishutter._core.checks import Numbers, namespace_of, require, require_positive_int
from mishutter._core.compiling import compiled
from mishutter.camera.rows import along_rows
from mishutter.decoding.decoders.base import AbstractDecoder, BlurModel
from mishutter.decoding.decoders.borders import Continuation, continuation
from mishutter.decoding.decoders.linear import ensemble_filter, misfit_of
from mishutter.model.motion import Positions

EDGES, SMOOTH = 0.3, 0.1
"""Weights of the two laws: the best in the mean over photographs and scenes from dim to bright."""
THRESHOLD = 0.7
"""Shrinkage of a step in units of the error; it changes the speed of convergence, not the limit."""


@final
class TotalVariationDecoder(AbstractDecoder):
    r"""The likeliest picture of few edges, in both directions, for all speeds of a scene.

    $\min_f \tfrac12 \sum_k |g_k - m_k f_k|^2 / (N + S v)_k + \tfrac{1}{20} \sum_k |f_k|^2 / S_k
    + 0.3\,\tfrac{c}{e} \sum |\nabla f|$ with $k$ over the frequencies of rows, by the alternating
    direction method of multipliers. The mean response $m = \sum p_i H_i$ stands for all speeds
    and $v = \sum p_i |H_i - m|^2$ for their spread, whose effect on a picture of power $S$
    counts as noise. $e$ is the root mean square error that the ensemble filter is
    expected to leave, the estimate that the steps begin from. $|\nabla f|^2$ is taken where four
    pixels meet: the mean of the squares of the two differences within rows, and that of the two
    between rows, so that no direction is preferred. Where two pixels meet at the upper or lower
    border, it is half the square of their difference.

    Args:
        num_iterations: Number of steps.
        strength: $c$; above 0.

    Raises:
        ValueError: if `num_iterations` is not a positive integer or `strength` not positive.
    """

    num_iterations: int = eqx.field(static=True, default=20)
    strength: float = eqx.field(static=True, default=1.0)

    def __check_init__(self) -> None:
        require_positive_int("TotalVariationDecoder(num_iterations=...)", self.num_iterations)
        subject = "TotalVariationDecoder(strength=...)"
        require(0 < self.strength < np.inf, subject, "be above 0", self.strength)

    @property
    def rows_beyond(self) -> int:
        return 16

    def restore(self, captured: Array, model: BlurModel) -> Array:
        if model.efficiency <= 0:
            return jnp.zeros_like(captured)
        extension = continuation(model, captured.shape[-1])
        length = extension.length
        mean, power, disturbance, error = misfit_of(model, length)
        scales = self.scales(error)
        data, smooth = scales.data / disturbance, scales.smooth / power
        smooth[0] = 0.0  # a row's level is free
        problem = _Problem(
            data_filter=np.conj(mean) * data,
            curvature=np.abs(mean) ** 2 * data + smooth,
            start=ensemble_filter(model, length),
            threshold=np.asarray(scales.threshold),
            gain=np.asarray(1 / model.efficiency),
        )
        return _split(captured, extension, problem, self.num_iterations)

    def scales(self, error: Positions | float) -> "Scales":
        """Weights against the edges' own, where the ensemble filter leaves a squared error.

        Args:
            error: That error; white = 1.
        """
        scale = error / (EDGES * self.strength / THRESHOLD)
        return Scales(scale, SMOOTH * scale, THRESHOLD * np.sqrt(error))


_Numbers = TypeVar("_Numbers", bound=Numbers)


class Scales(NamedTuple):
    """Weights of a minimisation by steps."""

    data: Positions | float  # Of the misfit
    smooth: Positions | float  # Of the smooth prior
    threshold: Positions | float  # Length by which differences shrink


class _Problem(NamedTuple):
    """Filters on the grid of a DFT, and scalars of the minimisation."""

    data_filter: Complex[np.ndarray, "k"]  # The filter of the capture where no edges count
    curvature: Float[np.ndarray, "k"]  # Curvature of the misfit and of the smooth prior
    start: Complex[np.ndarray, "k"]  # The filter that gives the first estimate
    threshold: Float[np.ndarray, ""]  # Length by which differences shrink
    gain: Float[np.ndarray, ""]  # 1 over the efficiency


@compiled
def _split(
    captured: Array, extension: Continuation, problem: _Problem, num_iterations: int
) -> Array:
    """Alternate between the picture and its differences, with a penalty on their gap."""
    rows, length = captured.shape[-2], extension.length
    turns = 2 - 2 * np.cos(2 * np.pi * np.fft.rfftfreq(length))
    down = 2 - 2 * np.cos(np.pi * np.arange(rows) / rows)

    def restored(plane: Array) -> Array:
        deviation, level = extension.deviations(plane)
        threshold, gain = (jnp.asarray(v, plane.dtype) for v in (problem.threshold, problem.gain))
        centre = jnp.mean(level)
        spectrum = _transformed(deviation + level - centre)
        filters = problem.data_filter, problem.curvature, problem.start
        data_filter, curvature, start = (along_rows(v, spectrum) for v in filters)
        # Blur and differences are both diagonal in these transforms, which makes this half of a
        # step exact.
        inverse = 1 / (curvature.real + jnp.asarray(turns + down[:, None], plane.dtype))
        data = spectrum * data_filter

        def fitted(edges: Array) -> Array:
            target = data + _transformed(adjoint_differences(edges))
            return _restored(target * inverse.astype(target.dtype), length)

        first = _restored(spectrum * start, length)
        advance = advanced(fitted, differences, threshold)
        edges = differences(first)
        state = (first, edges, jnp.zeros_like(edges))
        estimate = jax.lax.fori_loop(0, num_iterations, lambda _, last: advance(last), state)[0]
        return estimate[:, : extension.columns] + centre * gain

    planes = captured.reshape(-1, *captured.shape[-2:])
    return jax.lax.map(restored, planes).reshape(captured.shape)


def _transformed(picture: Array) -> Array:
    """Cosine transform of columns, Fourier transform of rows: mirrored and periodic."""
    return jnp.fft.rfft(dct(picture, axis=0, norm="ortho"))


def _restored(spectrum: Array, length: int) -> Array:
    """The inverse of `_transformed`."""
    return idct(jnp.fft.irfft(spectrum, length), axis=0, norm="ortho")


def differences(picture: Float[Array, "rows length"]) -> Float[Array, "4 rows+1 length"]:
    r"""Differences between neighbours among four pixels that meet, over $\sqrt 2$.

    They are those of the upper two, the lower two, the left two and the right two; rows beyond the
    picture have none. Turning the picture over does not change sums of squares over the four.
    """
    across = jnp.roll(picture, -1, axis=1) - picture
    down = jnp.diff(picture, axis=0, prepend=picture[:1], append=picture[-1:])
    upper, lower = (jnp.pad(across, (rows, (0, 0))) for rows in ((1, 0), (0, 1)))
    return jnp.stack([upper, lower, down, jnp.roll(down, -1, axis=1)]) / math.sqrt(2)


def adjoint_differences(
    differences: Float[Array, "4 corners length"],
) -> Float[Array, "corners-1 length"]:
    """The adjoint of `differences`."""
    upper, lower, left, right = differences / math.sqrt(2)
    across = upper[1:] + lower[:-1]
    down = jnp.pad((left + jnp.roll(right, 1, axis=1))[1:-1], ((1, 1), (0, 0)))
    return jnp.roll(across, 1, axis=1) - across + down[:-1] - down[1:]


def advanced(
    fitted: Callable[[_Numbers], _Numbers],
    differences: Callable[[_Numbers], _Numbers],
    threshold: Positions | float,
) -> Callable[[tuple], tuple]:
    """A step of a picture, its differences and what these lack, by the picture of given ones."""

    def advance(state: tuple) -> tuple:
        _, edges, dual = state
        estimate = fitted(edges - dual)
        gap = differences(estimate) + dual
        edges = _shrunk(gap, threshold)
        return estimate, edges, gap - edges

    return advance


def _shrunk(differences: Numbers, threshold: Positions | float) -> Numbers:
    """Vectors shorter by the threshold, or 0; their slope is finite also where they are 0."""
    space = namespace_of(differences)
    square = space.sum(differences**2, axis=0, keepdims=True)
    is_longer = square > threshold**2
    size = space.sqrt(space.where(is_longer, square, 1))
    return differences * space.where(is_longer, 1 - threshold / size, 0)
