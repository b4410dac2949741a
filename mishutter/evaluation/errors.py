"""Squared errors of the best linear decoders of a scene; levels by frequency and by speed.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from functools import cached_property
from typing import NamedTuple, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from mishutter._core.compiling import compiled
from mishutter.evaluation.ensembles import (
    drive_variance,
    ensemble_weights,
    error_weights,
    without_tolerances,
)
from mishutter.evaluation.layers import LayerMoments
from mishutter.evaluation.needs import ONLY_SPECTRA, Plan
from mishutter.evaluation.response import Records, Response
from mishutter.evaluation.views import sampled_view
from mishutter.model.motion import AbstractMotion
from mishutter.model.optics import frequencies, frequency_grid, pixel_response
from mishutter.model.scene import Scene, picture_power, require_whole
from mishutter.model.sensor import noise_power, white_electrons
from mishutter.model.shutters.base import AbstractShutter

Powers = TypeVar("Powers", Array, np.ndarray)


class _Moments(NamedTuple):
    """Powers of a capture's picture, spread and noise, in a common unit.

    They are those of all speeds together, shape `(k,)`, or of each, `(n, k)`.
    """

    mean: Complex[Array, "*n k"]  # Mean response over speeds, without the pixel aperture; complex
    coherent: Float[Array, "*n k"]  # Power of that, with the aperture
    spread: Float[Array, "*n k"]  # Variance of the response, with the aperture
    # Power of the picture
    signal: Float[Array, "*#n k"]
    noise: Float[Array, ""]  # Power of the noise; scalar

    @property
    def total(self) -> Float[Array, "*n k"]:
        """Power of a capture, noise included, over which the best filter divides."""
        return self.signal * (self.coherent + self.spread) + self.noise

    @property
    def lost(self) -> Float[Array, "*n k"]:
        """Share of the picture's power that `LinearErrors` count as lost."""
        return residual_fraction(self.signal, self.coherent, self.spread, self.noise)

    @property
    def filter(self) -> Complex[Array, "*n k"]:
        """The best filter over the picture's power and the aperture."""
        dark = self.total <= 0
        divisor = jnp.where(dark, 1.0, self.total).astype(self.mean.dtype)
        return jnp.where(dark, 0.0, jnp.conj(self.mean) / divisor)


@final
class LinearErrors:
    """Squared errors of the best linear decoders of a response, each part computed at most once."""

    def __init__(
        self,
        scene: Scene,
        motion: AbstractMotion,
        response: Response,
        num_frequencies: int | None = None,
    ):
        count = response.spectra.shape[1] if num_frequencies is None else num_frequencies
        self.scene, self.motion, self.response = scene, motion, response
        self.power = picture_power(scene, count, np.dtype(response.efficiency.dtype))

    @cached_property
    def every(self) -> _Moments:
        """The moments of all speeds together."""
        return self._moments(of_each=False)

    @cached_property
    def each(self) -> _Moments:
        """The moments of each speed."""
        return self._moments(of_each=True)

    def _moments(self, *, of_each: bool) -> _Moments:
        scene, motion, response = self.scene, self.motion, self.response
        dtype, num_frequencies = response.efficiency.dtype, self.power.size
        spectra, num_kept = response.spectra, response.spectra.shape[1]
        weights = ensemble_weights(scene).astype(dtype)[:, None]
        if of_each:
            weights = jnp.asarray(error_weights(scene), dtype)[:, None, None]
            spectra = spectra.reshape(weights.size, -1, num_kept)

        def along(row: Float[Array, "m"]) -> Float[Array, "*one k"]:
            """The lowest frequencies of a row, along the last axis of the moments."""
            return row[:num_kept].reshape((1, -1) if of_each else (-1,))

        aperture = along(_aperture(scene, num_frequencies, np.dtype(dtype)))
        if scene.occlusion is not None:
            mean, spread = LayerMoments.of(scene, motion, response.spectra, of_each=of_each)
            if not of_each:
                mean, spread = mean[0], spread[0]
        else:
            mean = jnp.sum(weights.astype(spectra.dtype) * spectra, axis=0)
            deviation = spectra - mean[None]
            spread = jnp.sum(weights * (deviation.real**2 + deviation.imag**2), axis=0)
        spread = spread * aperture
        if scene.tolerances is not None:
            variance = drive_variance(scene, motion, response.efficiency, num_frequencies)
            spread = spread + along(variance) * aperture
        coherent = (mean.real**2 + mean.imag**2) * aperture
        signal, noise = _signal_and_noise(scene, motion, response.efficiency, along(self.power))
        return _Moments(mean, coherent, spread, signal, noise)

    @property
    def lost_known_by_speed(self) -> Float[Array, "n k"]:
        """Share of the power that the filter of each speed loses at each frequency."""
        return self.each.lost

    @property
    def lost_known(self) -> Float[Array, "k"]:
        """Share of the power that is lost at each frequency by filters that know the speed."""
        each = self.lost_known_by_speed
        return jnp.sum(self.scene.weights.astype(each.dtype)[:, None] * each, axis=0)

    @cached_property
    def unknown(self) -> Float[Array, ""]:
        r"""Expected squared error of the best single linear decoder, white = 1.

        With $m = \sum p_i H_i$ and $v = \sum p_i |H_i - m|^2$ (aperture included) the filter
        $G = S\bar m/(S(|m|^2 + v) + N)$ leaves $2\int_0^{1/2} S\,(Sv + N)/(S(|m|^2+v) + N)\,df$,
        where $N = \eta\,\bar f/p + (\sigma/p)^2$ is the noise of the paper's equation (4) at
        $p = \text{rate}\cdot 2T$. No term of this form cancels another. Without any light the
        error is the picture's own variance. Where the response holds only the lowest of
        `num_frequencies`, the picture's power at the others counts as lost.
        """
        return self._squared_error(self.every.lost)

    @cached_property
    def known(self) -> Float[Array, ""]:
        r"""Expected squared error of the best linear decoder that knows the speed.

        Each speed has a filter of its own, and the picture, aperture, noise and units are those of
        `unknown`: without tolerances $\sum_i p_i\,2\int_0^{1/2} S\,N/(S|H_i|^2 + N)\,df$. Within
        tolerances $m$ and $v$ of that formula are over the errors about each speed. One filter for
        all speeds is never better than this.
        """
        return self._squared_error(self.lost_known)

    @cached_property
    def unknown_by_speed(self) -> Float[Array, "n"]:
        r"""Squared error of the best single linear decoder at each speed.

        With the filter $G$ of `unknown` it is
        $2\int_0^{1/2} [S(|1 - G m_i|^2 + |G|^2 v_i) + N|G|^2]\,df$ at speed $i$, where $m_i$ and
        $v_i$ are the mean and the variance of the response within the tolerances about that speed:
        $H_i$ and 0 without tolerances. The mean over the speeds, weighted, is `unknown`.
        """
        every, each, power = self.every, self.each, self.power
        num_kept = every.mean.shape[0]
        aperture = _aperture(self.scene, power.size, np.dtype(power.dtype))[:num_kept]
        gain = share(every.signal, every.total, of_nothing=0.0)  # the filter is 0 in the dark
        filter_ = (gain * aperture).astype(every.mean.dtype) * jnp.conj(every.mean)
        missing = 1 - filter_[None] * each.mean
        # The noise over the signal, |G|^2 of it, without a quotient by a signal that may be 0.
        noise = gain * every.coherent * share(every.noise, every.total)
        spread = (gain**2 * every.coherent)[None] * each.spread
        lost = missing.real**2 + missing.imag**2 + spread + noise[None]
        return self._squared_error(lost)

    @cached_property
    def known_by_speed(self) -> Float[Array, "n"]:
        """The squared error at each speed of the filter that knows it."""
        return self._squared_error(self.lost_known_by_speed)

    def unaware(self, nominal: "LinearErrors") -> Float[Array, ""]:
        r"""Expected squared error of the best filter of a nominal camera, without tolerances.

        The error of a filter $G'$ exceeds that of the best one $G$ of `unknown` by
        $2\int_0^{1/2}|G' - G|^2\,(S(|m|^2 + v) + N)\,df$: the error is quadratic in the filter.
        """
        moments, power = self.every, self.power
        difference = moments.filter - nominal.every.filter
        excess = difference.real**2 + difference.imag**2
        aperture = _aperture(self.scene, power.size, np.dtype(power.dtype))
        excess = excess * aperture * moments.signal * moments.total
        return jnp.mean(power * (moments.lost + jnp.where(moments.signal > 0, excess, 0.0)))

    def _squared_error(self, lost: Float[Array, "*n k"]) -> Float[Array, "*n"]:
        """Squared error by the share of the power that is lost; all of it at higher frequencies."""
        num_kept = lost.shape[-1]
        lowest = self.power[:num_kept].reshape((1,) * (lost.ndim - 1) + (num_kept,))
        lost_power = jnp.sum(lowest * lost, axis=-1) + jnp.sum(self.power[num_kept:])
        return lost_power / self.power.size

    def worst(self, errors: Float[Array, "n"]) -> Float[Array, ""]:
        """The largest of the errors at the speeds that occur."""
        return jnp.max(jnp.where(self.scene.weights > 0, errors, 0.0))


class DecoderLevels(NamedTuple):
    """Ratio of signal to noise by frequency, and PSNR by speed, of one decoder."""

    signal_over_noise: Float[np.ndarray, "m"]  # Power of the picture over that of its disturbances
    psnr: Float[np.ndarray, "n"]  # PSNR at each speed that occurs, in linear light; dB


class SpectralLevels(NamedTuple):
    """Levels by frequency and by speed."""

    frequencies: Float[np.ndarray, "m"]  # cycles/px; shape `(m,)`
    speeds: Float[np.ndarray, "n"]  # Speeds that occur, ascending; px/s, shape `(n,)`
    unknown: DecoderLevels  # Levels of one filter for all speeds
    known: DecoderLevels  # Levels of a filter that knows the speed


def spectral_levels(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter
) -> SpectralLevels:
    r"""Ratio of signal to noise by frequency, and PSNR by speed, of the best linear decoders.

    In the terms of `LinearErrors.unknown` the ratio of one filter for all speeds is
    $q = S|m|^2/(Sv + N)$, at the exposure of the motion and with the spread between the scene's
    speeds as noise: the decoder's error is $S/(1 + q)$. The PSNR is that of
    $2\int_0^{1/2} [S|1 - G H_i|^2 + N|G|^2]\,df$, whose weighted mean over the speeds is the
    expected error. A filter that knows the speed leaves $S/(1 + q_i)$ with $q_i = S|H_i|^2/N$,
    and $1/(1 + q)$ is the weighted mean of $1/(1 + q_i)$. Tolerances of the scene do not count:
    this is the camera as designed.

    Raises:
        ValueError: as `evaluate`.
    """
    scene = without_tolerances(scene)
    weights = np.asarray(scene.weights)
    speeds = np.unique(np.asarray(scene.speeds)[weights > 0])
    view = sampled_view(scene, motion, shutter, ONLY_SPECTRA)
    plan = view.plan
    relative, computed = speeds - float(motion.velocity), np.asarray(view.scene.speeds)
    if plan.folds:
        relative, computed = np.abs(relative), np.abs(computed)
    places = np.argmin(np.abs(relative[:, None] - computed[None]), axis=1)

    def levels(lost: Float[Array, "m"], errors: Float[Array, "s"]) -> DecoderLevels:
        with np.errstate(divide="ignore"):
            return DecoderLevels(1 / np.asarray(lost) - 1, -10 * np.log10(errors)[places])

    both = _levels_of_records(view.scene, view.motion, Records.of(view), plan)
    return SpectralLevels(
        frequencies(plan.num_frequencies), speeds, *(levels(*each) for each in both)
    )


@compiled
def _levels_of_records(
    scene: Scene, motion: AbstractMotion, recorded: Records, plan: Plan
) -> tuple[tuple[Float[Array, "m"], Float[Array, "n"]], ...]:
    """Share of the power lost at each frequency, squared error at each speed: unknown, known."""
    errors = LinearErrors(scene, motion, recorded.response(scene, plan), plan.num_frequencies)
    unknown = errors.every.lost, errors.unknown_by_speed
    return unknown, (errors.lost_known, errors.known_by_speed)


def freely_aligned(
    scene: Scene, motion: AbstractMotion, response: Response, num_frequencies: int | None = None
) -> Response:
    r"""The response with each speed displaced so that the expected error is least.

    A displacement $d_i$ takes $H_i$ to $H_i e^{2\pi i f d_i}$ and does not change
    $\sum p_i|H_i|^2$, so that of `LinearErrors.unknown` only $-\int W |m|^2\,df$ changes, with
    $W = S^2/(S \sum p_i|H_i|^2 + N)$ (aperture included). Each step moves every speed towards
    the largest overlap with the mean of all, $\operatorname{Re}\int W \bar m H_i\,df$; 20 of
    them come to within 1e-4 dB of the least error near the alignment of the kernels. The
    displacements are where the error is stationary: derivatives of the error do not pass through
    them.

    Raises:
        ValueError: if the scene has a background: its layers have no places by speed alone.
    """
    require_whole(scene, "ExpectedErrorLoss(alignment='free')")
    dtype = response.efficiency.dtype
    spectra = jax.lax.stop_gradient(response.spectra)
    num_kept = spectra.shape[1]
    num_frequencies = num_kept if num_frequencies is None else num_frequencies
    power = picture_power(scene, num_frequencies, np.dtype(dtype))[:num_kept]
    aperture = _aperture(scene, num_frequencies, np.dtype(dtype))[:num_kept]
    weights = ensemble_weights(scene).astype(dtype)[:, None]
    signal, noise = _signal_and_noise(scene, motion, response.efficiency, power)
    gain = jnp.sum(weights * (spectra.real**2 + spectra.imag**2), axis=0) * aperture
    weight = jax.lax.stop_gradient(power * aperture * share(signal, signal * gain + noise))
    weight = weight[None]
    omega = 2 * np.pi * frequency_grid(num_frequencies, np.dtype(dtype))[None, :num_kept]

    def displaced(
        spectra: Complex[Array, "n k"], displacement: Float[Array, "n"]
    ) -> Complex[Array, "n k"]:
        angle = omega * displacement[:, None]
        return spectra * jax.lax.complex(jnp.cos(angle), jnp.sin(angle))

    def step(_: object, displacement: Float[Array, "n"]) -> Float[Array, "n"]:
        each = displaced(spectra, displacement)
        mean = jnp.sum(weights.astype(each.dtype) * each, axis=0)
        overlap = weight.astype(each.dtype) * jnp.conj(mean)[None] * each
        slope = -jnp.sum(omega * overlap.imag, axis=1)
        bound = jnp.sum(omega**2 * jnp.abs(overlap), axis=1)
        # The bound itself would be safe but slower.
        curvature = jnp.maximum(jnp.sum(omega**2 * overlap.real, axis=1), 0.25 * bound)
        curves = curvature > 0
        return displacement + jnp.where(curves, slope / jnp.where(curves, curvature, 1.0), 0.0)

    start = jnp.zeros(spectra.shape[0], dtype)
    # The error is stationary in the displacements, so that its slope is that with these held fixed.
    displacement = jax.lax.stop_gradient(jax.lax.fori_loop(0, 20, step, start))
    return eqx.tree_at(lambda r: r.spectra, response, displaced(response.spectra, displacement))


def _aperture(
    scene: Scene, num_frequencies: int, dtype: np.dtype
) -> Float[Array, "{num_frequencies}"]:
    """Share of the power that lens and pixel pass, on the frequency grid."""
    frequency = frequency_grid(num_frequencies, dtype)
    return jnp.asarray(pixel_response(frequency, scene.optics.lens_blur.astype(dtype))) ** 2


def _signal_and_noise(
    scene: Scene,
    motion: AbstractMotion,
    efficiency: Float[Array, ""],
    power: Float[Array, "*one k"],
) -> tuple[Float[Array, "*one k"], Float[Array, ""]]:
    """Power of the picture and of the noise, as recorded in a common unit."""
    dtype = efficiency.dtype
    electrons = white_electrons(scene.photon_rate.astype(dtype), motion.exposure.astype(dtype))
    read_noise = scene.read_noise.astype(dtype)
    # The unit is the larger of signal and noise: squares of electrons overflow float32.
    largest = jnp.maximum(jnp.maximum(electrons, jnp.sqrt(electrons)), read_noise)
    unit = jax.lax.stop_gradient(jnp.where(largest > 0, largest, 1.0))
    mean_level = scene.picture.mean_level.astype(dtype)
    noise = noise_power(efficiency, mean_level, electrons, read_noise, unit=unit)
    return power * (electrons / unit) ** 2, noise


def residual_fraction(
    signal: Float[Powers, "*#shape"],
    coherent: Float[Powers, "*#shape"],
    spread: Float[Powers, "*#shape"],
    noise: Float[Powers, "*#shape"] | float,
) -> Float[Powers, "*#shape"]:
    r"""Share of the picture's power that the best single linear filter loses; of any shape.

    $(Sv + N)/(S(|m|^2 + v) + N)$, which the filter $G = S\bar m/(S(|m|^2 + v) + N)$ leaves. No
    term of this form cancels another. All is lost where there is neither signal nor noise.
    """
    return share(signal * spread + noise, signal * (coherent + spread) + noise)


def share(
    part: Float[Powers, "*#shape"], total: Float[Powers, "*#shape"], *, of_nothing: float = 1.0
) -> Float[Powers, "*#shape"]:
    """`part / total`, and the share `of_nothing` where both are 0."""
    dark = total <= 0
    if isinstance(total, np.ndarray):
        return np.divide(part, total, where=~dark, out=np.full_like(total, of_nothing))
    # The derivative of a quotient squares its divisor, so the divisor is scaled to nearly 1.
    scale = jax.lax.stop_gradient(1 / jnp.where(dark, 1.0, total))
    return jnp.where(dark, of_nothing, (part * scale) / jnp.where(dark, 1.0, total * scale))
