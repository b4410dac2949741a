"""A decoder around any denoiser: half-quadratic splitting."""

from collections.abc import Callable
from typing import NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from mishutter._core.checks import Unquoted, require, require_known, require_positive_int
from mishutter.decoding.decoders.base import AbstractDecoder, BlurModel
from mishutter.decoding.decoders.borders import continuation
from mishutter.decoding.decoders.linear import ensemble_filter, misfit_of

Denoiser = Callable[[np.ndarray, float], np.ndarray]


class Misfit(NamedTuple):
    """Data of captures about a picture, on the grid of a DFT."""

    data: Complex[np.ndarray, "*k"]  # The adjoint of the capture over its noise
    density: Float[np.ndarray, "*k"]  # Signal by noise
    error: float  # Root mean square error that the ensemble filter is expected to leave
    mean: float  # Level from which the picture deviates


@final
class PlugAndPlayDecoder(AbstractDecoder):
    r"""Your own denoiser serves as the prior: half-quadratic splitting.

    From the picture $z$ that the ensemble filter restores, it alternates between the picture $x$
    of least misfit $\sum_k |g_k - m_k x_k|^2 / (N + S v)_k$ plus
    $\lambda \sum_k |x_k - z_k|^2 / \sigma^2$, with $k$ over the frequencies of rows, and
    $z = \mathtt{denoise}(x, \sigma)$, while $\sigma$ falls geometrically (Zhang et al.,
    "Plug-and-play image restoration with deep denoiser prior", 2022). The mean response $m$ and the
    spread $v$ over the speeds are those of `BlurModel.mean_and_spread`. The last $z$ is the
    picture.

    Args:
        denoise: Called with a picture of shape `(rows, columns)`, white = 1, longer than the
            capture by the continuation of its rows, and with the standard deviation of the noise
            to remove, white = 1. It returns the picture without noise, of the same shape.
        strength: $\lambda$, the weight of the denoised picture against the capture; above 0. The
            noise that a frequency of $x$ has from the capture is at most $\sigma/2\sqrt\lambda$, so
            that below 0.25 it exceeds the noise given to the denoiser. One that is too small leaves
            ghosts and noise, one that is too large leaves the blur.
        last_noise: The last $\sigma$ in units of the error that the ensemble filter is expected to
            leave; above 0. One that is too small leaves noise, one that is too large takes
            texture away.
        first_noise: The first $\sigma$ in the same unit; not below `last_noise`.
        num_iterations: Number of steps.

    Raises:
        ValueError: if a weight is not positive, if the noise does not fall, or where it restores,
            if a capture is traced, or the denoiser returns no real and finite numbers, another
            shape, or a picture of another brightness.
    """

    denoise: Denoiser = eqx.field(static=True)
    strength: float = eqx.field(static=True, default=0.25)
    last_noise: float = eqx.field(static=True, default=0.5)
    first_noise: float = eqx.field(static=True, default=2.0)
    num_iterations: int = eqx.field(static=True, default=8)

    def __check_init__(self) -> None:
        name = "PlugAndPlayDecoder"
        require(callable(self.denoise), f"{name}(denoise=...)", "be a function", self.denoise)
        for argument in ("strength", "last_noise", "first_noise"):
            value = getattr(self, argument)
            require(0 < value < np.inf, f"{name}({argument}=...)", "be above 0", value)
        falls = self.first_noise >= self.last_noise
        least = f"be at least `last_noise`, {self.last_noise:g}"
        require(falls, f"{name}(first_noise=...)", least, self.first_noise)
        require_positive_int(f"{name}(num_iterations=...)", self.num_iterations)

    @property
    def rows_beyond(self) -> int:
        return 16

    @property
    def falling(self) -> Float[np.ndarray, "{self.num_iterations}"]:
        r"""$\sigma$ of each step, in units of the error that the ensemble filter leaves."""
        return np.geomspace(self.first_noise, self.last_noise, self.num_iterations)

    def restore(self, captured: Array, model: BlurModel) -> Array:
        if model.efficiency <= 0:
            return jnp.zeros_like(captured)
        require_known("PlugAndPlayDecoder", capture=captured)
        rows, columns = captured.shape[-2:]
        extension = continuation(model, columns)
        length = extension.length
        mean, _, disturbance, error = misfit_of(model, length)
        start = ensemble_filter(model, length)
        density = np.abs(mean) ** 2 / disturbance

        restored = []
        for plane in np.asarray(captured, np.float64).reshape(-1, rows, columns):
            deviation, level = (np.asarray(x) for x in extension.deviations(jnp.asarray(plane)))
            centre = np.mean(level)
            spectrum = np.fft.rfft(deviation + level - centre)
            bright = float(centre / model.efficiency)
            data = np.conj(mean) / disturbance * spectrum
            misfit = Misfit(data, density, float(np.sqrt(error)), bright)
            first = np.fft.irfft(spectrum * start, length)
            picture = self.steps(first, misfit, np.fft.rfft, lambda x: np.fft.irfft(x, length))
            restored.append(picture[:, :columns] + bright)
        return jnp.asarray(np.reshape(restored, captured.shape), captured.dtype)

    def steps(
        self,
        picture: Float[np.ndarray, "rows length"],
        misfit: Misfit,
        spectrum: Callable[[np.ndarray], np.ndarray],
        inverse: Callable[[np.ndarray], np.ndarray],
    ) -> Float[np.ndarray, "rows length"]:
        """The last picture, from the first one.

        Args:
            picture: What the ensemble filter restores, about the mean; white = 1.
            misfit: What the captures tell.
            spectrum: The DFT of that grid.
            inverse: Its inverse.
        """
        for sigma in (self.falling * misfit.error).tolist():
            weight = self.strength / sigma**2
            target = misfit.data + weight * spectrum(picture)
            estimate = inverse(target / (misfit.density + weight))
            picture = self.denoised(estimate + misfit.mean, sigma) - misfit.mean
        return picture

    def denoised(self, picture: np.ndarray, sigma: float) -> np.ndarray:
        """The denoised picture, if it is one of the same shape and about the same brightness.

        Args:
            picture: The picture; white = 1.
            sigma: Standard deviation of its noise; white = 1.
        """
        subject, given = "PlugAndPlayDecoder(denoise=...)", f"shape {picture.shape}"
        try:
            returned = self.denoise(picture, sigma)
        except Exception as error:
            called = f"a NumPy array of {given}, {picture.dtype}, and a float"
            error.add_note(f"`{subject}` was called with {called}.")
            raise
        try:
            denoised = np.asarray(returned)
        except (RuntimeError, TypeError, ValueError) as error:  # a tensor with gradients; a tuple
            got = Unquoted(f"a {type(returned).__name__}: {error}")
            require(False, subject, f"return a NumPy array of {given}", got)
            raise  # not reached: `require` has raised
        require(denoised.dtype.kind in "fiub", subject, "return real numbers", returned)
        as_given = f"return a picture of {given}, as it was given"
        require(denoised.shape == picture.shape, subject, as_given, denoised.shape)
        is_finite = bool(np.all(np.isfinite(denoised)))
        require(is_finite, subject, "return finite numbers", Unquoted("some that are not"))
        # Networks in other units change the mean, and those that return the noise; none else does.
        before, mean = float(np.mean(picture)), float(np.mean(denoised))
        is_as_bright = abs(mean - before) <= max(abs(before) / 2, 2 * sigma)
        as_bright = f"return a picture as bright as it was given, of mean {before:.3g}, white = 1"
        require(is_as_bright, subject, as_bright, Unquoted(f"a mean of {mean:.3g}"))
        return denoised.astype(np.float64)
