"""The metrics of a shutter on a motion for a scene.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from dataclasses import replace
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from mishutter._core import compiled
from mishutter.blur import condition_number, safe_sqrt
from mishutter.evaluation.ensembles import (
    drive_variance,
    ensemble_weights,
    error_weights,
    without_tolerances,
)
from mishutter.evaluation.found_speed import found_psnr, found_share_of
from mishutter.evaluation.layers import layer_moments
from mishutter.evaluation.needs import (
    EVERY_PART,
    ONLY_SPECTRA,
    PLANNED,
    Automatic,
    Plan,
    sizes,
)
from mishutter.evaluation.power import lost_share, picture_power, share
from mishutter.evaluation.response import Records, Response, assembled, kernel_phase, records
from mishutter.evaluation.sensor_view import SampledView, sampled_view
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    DecoderSpeed,
    Scene,
    frequencies,
    frequency_grid,
    noise_power,
    pixel_response,
    require_scene,
    require_whole,
    white_electrons,
)

FILTERS: dict[DecoderSpeed, str] = {
    "unknown": "one filter for all speeds",
    "found": "a filter for the true speed",
    "told": "a filter that is told the speed",
}
"""The filter that each decoder restores with; one that finds the speed, where it is right."""


@final
class Metrics(eqx.Module):
    r"""The metrics of a design.

    Attributes:
        condition_number: $\max|H|/\min|H|$ of the still object's kernel, over a DFT of
            `dft_length` points of the kernel at `phase`; `inf` at a spectral zero.
        kernel_difference: RMS over taps and (weighted) speeds of $h_s - h_0$.
        relative_kernel_difference: The same over the RMS of $h_0$.
        efficiency: Throughput, the mean transmittance over the exposure.
        expected_psnr: PSNR of the best single linear decoder, in linear light; dB.
        known_speed_psnr: PSNR of the best linear decoder that is told the speed; dB. It is at
            least `expected_psnr`, and the difference is the price of not knowing the speed.
        found_speed_psnr: PSNR of a decoder that finds the speed in the picture: the `found_share`
            of the way from `expected_psnr` to `known_speed_psnr`; dB.
        worst_speed_psnr: PSNR at the worst of the scene's speeds, by the decoder of
            `expected_psnr`; at most `expected_psnr`; dB.
        worst_known_speed_psnr: PSNR at the worst of the scene's speeds, by the decoder of
            `known_speed_psnr`; at most `known_speed_psnr` and at least `worst_speed_psnr`; dB.
        bound_share: $|K_s(f)|^2$ over the wedge bound, worst case over speeds and
            frequencies.
        phase: Offset of the first tap's edge from the point of alignment; px.
        dft_length: Points of the DFT.
        num_taps: Taps of the kernels.
        toleranced_psnr: Expected PSNR within the scene's tolerances, by the best single linear
            decoder, which knows the distribution of the errors but not the errors; dB. None for a
            scene without tolerances. All other metrics are those of a camera without errors.
    """

    condition_number: Float[Array, ""]
    kernel_difference: Float[Array, ""]
    relative_kernel_difference: Float[Array, ""]
    efficiency: Float[Array, ""]
    expected_psnr: Float[Array, ""]
    known_speed_psnr: Float[Array, ""]
    found_speed_psnr: Float[Array, ""]
    worst_speed_psnr: Float[Array, ""]
    worst_known_speed_psnr: Float[Array, ""]
    bound_share: Float[Array, ""]
    phase: Float[Array, ""]
    dft_length: int = eqx.field(static=True)
    num_taps: int = eqx.field(static=True)
    toleranced_psnr: Float[Array, ""] | None = None

    def psnr_of(self, decoder_speed: DecoderSpeed) -> Float[Array, ""]:
        """PSNR expected of a decoder; dB.

        Args:
            decoder_speed: The speed, to the decoder: `"unknown"`, `"found"` or `"told"`.
        """
        levels = {
            "unknown": self.expected_psnr,
            "found": self.found_speed_psnr,
            "told": self.known_speed_psnr,
        }
        return levels[decoder_speed]

    def worst_psnr_of(self, decoder_speed: DecoderSpeed) -> Float[Array, ""] | None:
        """PSNR at the worst of the scene's speeds, expected of a decoder; dB.

        Args:
            decoder_speed: The speed, to the decoder. Of one that finds it, None: the share of the
                gain that it keeps is known in the mean over speeds, and not at each.
        """
        levels = {
            "unknown": self.worst_speed_psnr,
            "found": None,
            "told": self.worst_known_speed_psnr,
        }
        return levels[decoder_speed]

    def __repr__(self) -> str:
        """The values of the metrics; the `repr` of a module shows types alone."""
        values = {n: getattr(self, n) for n in self.__dataclass_fields__}
        lines = (f"  {name}={value}" for name, value in values.items() if value is not None)
        return "\n".join(["Metrics(", *lines, ")"])


def evaluate(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    plan: Plan | Automatic | None = PLANNED,
) -> Metrics:
    r"""Measure a design.

    The definitions and their sources are those of the functions below. Kernels of a traced motion
    may be as long as the scene's limits allow, and those of a traced scene 256 px; objects may pass
    at twice as many px per half exposure. More is an error when the program runs. In a loss that
    `optimise` traces, kernels may be as long as the search takes them.

    A sensor that pans is measured in its own frame, as one at rest among speeds less its velocity:
    the still object is the one that it keeps up with.

    A motion without acceleration, or with a sag below 1e-15 px, is a camera at rest, whose
    objects are aligned at mid-exposure. Derivatives there are those of that alignment.

    Args:
        scene: Speeds, light and noise.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        plan: The parts to compute; made for the scene by default, None for all. The share of the
            bound needs every frequency, so all are computed whatever the plan.

    Returns:
        The metrics; see `Metrics`.

    Raises:
        ValueError: if kernels are longer than 65,535 px, or the light of all speeds falls
            over more than 93,600 px.
        RuntimeError: if a traced motion or scene has longer kernels or faster objects; under
            `jax.jit` it becomes an error of JAX's own.

    Examples:
        >>> from mishutter import HannShutter, Limits, ParabolicMotion, Scene, evaluate
        >>> limits = Limits(max_stroke=20, max_half_exposure=0.02)
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=5, limits=limits)
        >>> motion = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
        >>> metrics = evaluate(scene, motion, HannShutter())
        >>> psnr, worst = metrics.expected_psnr, metrics.worst_speed_psnr
        >>> print(f"{psnr:.2f} dB, {worst:.2f} at the worst speed")
        28.77 dB, 27.07 at the worst speed
    """
    squared_error = None
    require_scene(scene)
    if scene.tolerances is not None:
        squared_error = squared_error_within(scene, motion, shutter, plan=plan)
        scene = without_tolerances(scene)
    view = _at_every_frequency(sampled_view(scene, motion, shutter, plan, EVERY_PART))
    metrics = measured(view.scene, view.motion, records(view), view.plan)
    if squared_error is None:
        return metrics
    return replace(metrics, toleranced_psnr=-10 * jnp.log10(squared_error))


def _at_every_frequency(view: SampledView) -> SampledView:
    """A view with every frequency in its plan, and the nodes in time for these."""
    plan = view.plan
    if plan.num_kept is None:
        return view
    num_nodes = max(plan.num_nodes, sizes(view.scene, view.motion).num_nodes)
    return view._replace(plan=replace(plan, num_kept=None, num_nodes=num_nodes))


def squared_error_within(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    plan: Plan | Automatic | None = PLANNED,
) -> Float[Array, ""]:
    """The `expected_squared_error` of a design within the scene's tolerances."""
    view = sampled_view(scene, motion, shutter, plan, ONLY_SPECTRA)
    return _error_of_records(view.scene, view.motion, records(view), view.plan)


@compiled
def _error_of_records(
    scene: Scene, motion: AbstractMotion, recorded: Records, plan: Plan
) -> Float[Array, ""]:
    response = assembled(scene, recorded, plan)
    return expected_squared_error(scene, motion, response, plan.num_frequencies)


@compiled
def measured(scene: Scene, motion: AbstractMotion, recorded: Records, plan: Plan) -> Metrics:
    """Metrics from the records of a design."""
    response = assembled(scene, recorded, plan)
    raw, relative = kernel_differences(scene, motion, response)
    power = picture_power(scene, response.spectra.shape[1], np.dtype(response.efficiency.dtype))
    every = _moments(scene, motion, response, power)
    each = _moments(scene, motion, response, power, told=True)
    by_speed = _errors_by_speed(scene, every, each, power)
    untold = -10 * jnp.log10(_squared_error(every.lost, power))
    told = -10 * jnp.log10(_told_squared_error(scene, each, power))
    return Metrics(
        condition_number=condition_number(response.still_kernel, num_frequencies=plan.dft_length),
        kernel_difference=raw,
        relative_kernel_difference=relative,
        efficiency=response.efficiency,
        expected_psnr=untold,
        known_speed_psnr=told,
        found_speed_psnr=found_psnr(
            untold, told, found_share_of(scene, motion, response.efficiency)
        ),
        worst_speed_psnr=-10 * jnp.log10(_worst(scene, by_speed)),
        worst_known_speed_psnr=-10 * jnp.log10(_worst(scene, _squared_error(each.lost, power))),
        bound_share=bound_share(scene, motion, response),
        phase=jnp.asarray(kernel_phase(motion, plan.num_taps), response.efficiency.dtype),
        dft_length=plan.dft_length,
        num_taps=plan.num_taps,
    )


def kernel_differences(
    scene: Scene, motion: AbstractMotion, response: Response
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    r"""Cross-speed kernel difference, raw and relative to the still object's kernel.

    $\sqrt{\sum_i p_i\,\overline{(h_{s_i} - h_0)^2}}$ (the paper's Figure 3b, over the
    scene's speeds), and the same over $\sqrt{\overline{h_0^2}}$. The means are over the
    taps that the fastest object reaches. The derivative where all kernels agree is 0.
    """
    difference, still = (jnp.sum(x**2) for x in (response.differences, response.still_kernel))
    return differences_from(scene, motion, difference, still)


def differences_from(
    scene: Scene, motion: AbstractMotion, difference: Float[Array, ""], still: Float[Array, ""]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The `kernel_differences` by their sum of squares and that of the still kernel."""
    is_open = still > 0
    relative = safe_sqrt(jnp.where(is_open, difference / jnp.where(is_open, still, 1.0), 0.0))
    return safe_sqrt(difference / _num_supported(scene, motion, still)), relative


def _num_supported(
    scene: Scene, motion: AbstractMotion, like: Float[Array, ""]
) -> Float[Array, ""]:
    """Number of taps that light of the fastest object falls on, odd for a camera at rest."""
    far = jnp.ceil(motion.kernel_length(scene.max_speed))
    aside = jnp.ceil(scene.max_speed * motion.half_exposure - 0.5)
    count = jnp.where(motion.has_vertex, far, 2 * aside + 1)
    return jax.lax.stop_gradient(jnp.maximum(count, 1)).astype(like.dtype)


def expected_squared_error(
    scene: Scene,
    motion: AbstractMotion,
    response: Response,
    num_frequencies: int | None = None,
) -> Float[Array, ""]:
    r"""Expected squared error of the best single linear decoder, white = 1.

    With $m = \sum p_i H_i$ and $v = \sum p_i |H_i - m|^2$ (aperture included) the filter
    $G = S\bar m/(S(|m|^2 + v) + N)$ leaves $2\int_0^{1/2} S\,(Sv + N)/(S(|m|^2+v) + N)\,df$,
    where $N = \eta\,\bar f/p + (\sigma/p)^2$ is the noise of the paper's equation (4) at
    $p = \text{rate}\cdot 2T$. No term of this form cancels another. Without any light the
    error is the picture's own variance. Where the response holds only the lowest of
    `num_frequencies`, the picture's power at the others counts as lost.
    """
    num_kept = response.spectra.shape[1]
    num_frequencies = num_kept if num_frequencies is None else num_frequencies
    power = picture_power(scene, num_frequencies, np.dtype(response.efficiency.dtype))
    return _squared_error(_moments(scene, motion, response, power).lost, power)


def _squared_error(lost: Float[Array, "*n k"], power: Float[Array, "m"]) -> Float[Array, "*n"]:
    """Squared error by the share of the power that is lost; all of it at higher frequencies."""
    num_kept = lost.shape[-1]
    lowest = power[:num_kept].reshape((1,) * (lost.ndim - 1) + (num_kept,))
    return (jnp.sum(lowest * lost, axis=-1) + jnp.sum(power[num_kept:])) / power.size


class _Moments(NamedTuple):
    """Powers of a capture's picture, spread and noise, in a common unit.

    They are those of all speeds together, shape `(k,)`, or of each, `(n, k)`.

    Attributes:
        mean: Mean response over speeds, without the pixel aperture; complex.
        coherent: Power of that, with the aperture.
        spread: Variance of the response, with the aperture.
        signal: Power of the picture.
        noise: Power of the noise; scalar.
    """

    mean: Complex[Array, "*n k"]
    coherent: Float[Array, "*n k"]
    spread: Float[Array, "*n k"]
    signal: Float[Array, "*#n k"]
    noise: Float[Array, ""]

    @property
    def total(self) -> Float[Array, "*n k"]:
        """Power of a capture."""
        return self.signal * (self.coherent + self.spread) + self.noise

    @property
    def lost(self) -> Float[Array, "*n k"]:
        """Share of the picture's power that `expected_squared_error` counts as lost."""
        return lost_share(self.signal, self.coherent, self.spread, self.noise)


def _moments(
    scene: Scene,
    motion: AbstractMotion,
    response: Response,
    every_power: Float[Array, "m"],
    *,
    told: bool = False,
) -> _Moments:
    """The moments of all speeds together, or of each for a decoder that is told the speed."""
    dtype = response.efficiency.dtype
    spectra, num_kept = response.spectra, response.spectra.shape[1]
    weights = ensemble_weights(scene).astype(dtype)[:, None]
    if told:
        weights = jnp.asarray(error_weights(scene), dtype)[:, None, None]
        spectra = spectra.reshape(weights.size, -1, num_kept)

    def along(row: Float[Array, "m"]) -> Float[Array, "*one k"]:
        """The lowest frequencies of a row, along the last axis of the moments."""
        return row[:num_kept].reshape((1, -1) if told else (-1,))

    aperture = along(_aperture(scene, every_power.size, np.dtype(dtype)))
    if scene.occlusion is not None:
        mean, spread = layer_moments(scene, motion, response.spectra, told=told)
        if not told:
            mean, spread = mean[0], spread[0]
    else:
        mean = jnp.sum(weights.astype(spectra.dtype) * spectra, axis=0)
        deviation = spectra - mean[None]
        spread = jnp.sum(weights * (deviation.real**2 + deviation.imag**2), axis=0)
    spread = spread * aperture
    if scene.tolerances is not None:
        variance = drive_variance(scene, motion, response.efficiency, every_power.size)
        spread = spread + along(variance) * aperture
    coherent = (mean.real**2 + mean.imag**2) * aperture
    signal, noise = _signal_and_noise(scene, motion, response.efficiency, along(every_power))
    return _Moments(mean, coherent, spread, signal, noise)


def unaware_squared_error(
    scene: Scene, motion: AbstractMotion, response: Response, nominal: Response
) -> Float[Array, ""]:
    r"""Expected squared error of the best filter of a camera without tolerances.

    The error of a filter $G'$ exceeds that of the best one $G$ of `expected_squared_error` by
    $2\int_0^{1/2}|G' - G|^2\,(S(|m|^2 + v) + N)\,df$: the error is quadratic in the filter.

    Args:
        scene: Speeds, light, noise and tolerances.
        motion: Motion of the sensor, without velocity.
        response: Response at the errors within the tolerances, at every frequency.
        nominal: Response of the same design without errors.
    """
    power = picture_power(scene, response.spectra.shape[1], np.dtype(response.efficiency.dtype))
    moments = _moments(scene, motion, response, power)
    without = _moments(without_tolerances(scene), motion, nominal, power)
    difference = _filter(moments) - _filter(without)
    excess = difference.real**2 + difference.imag**2
    aperture = _aperture(scene, power.size, np.dtype(power.dtype))
    excess = excess * aperture * moments.signal * moments.total
    return jnp.mean(power * (moments.lost + jnp.where(moments.signal > 0, excess, 0.0)))


def _filter(moments: _Moments) -> Complex[Array, "k"]:
    """The best filter over the picture's power and the aperture."""
    dark = moments.total <= 0
    divisor = jnp.where(dark, 1.0, moments.total).astype(moments.mean.dtype)
    return jnp.where(dark, 0.0, jnp.conj(moments.mean) / divisor)


class DecoderLevels(NamedTuple):
    """Ratio of signal to noise by frequency, and PSNR by speed, of one decoder.

    Attributes:
        signal_over_noise: Power of the picture over that of its disturbances; shape `(m,)`.
        psnr: PSNR at each speed that occurs, in linear light; dB, shape `(n,)`.
    """

    signal_over_noise: Float[np.ndarray, "m"]
    psnr: Float[np.ndarray, "n"]


class SpectralLevels(NamedTuple):
    """Levels by frequency and by speed.

    Attributes:
        frequencies: cycles/px; shape `(m,)`.
        speeds: Speeds that occur, ascending; px/s, shape `(n,)`.
        untold: Levels of one filter for all speeds.
        told: Levels of a filter that is told the speed.
    """

    frequencies: Float[np.ndarray, "m"]
    speeds: Float[np.ndarray, "n"]
    untold: DecoderLevels
    told: DecoderLevels

    def of(self, decoder_speed: DecoderSpeed) -> DecoderLevels:
        """Levels of the filter that a decoder restores with.

        Args:
            decoder_speed: The speed, to the decoder. One that finds it restores as one that is
                told it, wherever the speed that it finds is right.
        """
        return self.untold if decoder_speed == "unknown" else self.told


def spectral_levels(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter
) -> SpectralLevels:
    r"""Ratio of signal to noise by frequency, and PSNR by speed, of the best linear decoders.

    In the terms of `expected_squared_error` the ratio of one filter for all speeds is
    $q = S|m|^2/(Sv + N)$, at the exposure of the motion and with the spread between the scene's
    speeds as noise: the decoder's error is $S/(1 + q)$. The PSNR is that of
    $2\int_0^{1/2} [S|1 - G H_i|^2 + N|G|^2]\,df$, whose weighted mean over the speeds is the
    expected error. A filter that is told the speed leaves $S/(1 + q_i)$ with $q_i = S|H_i|^2/N$,
    and $1/(1 + q)$ is the weighted mean of $1/(1 + q_i)$. Tolerances of the scene do not count:
    this is the camera as designed.

    Args:
        scene: Speeds, light and noise; concrete.
        motion: Motion of the sensor; concrete.
        shutter: Transmittance over the exposure.

    Raises:
        ValueError: as `evaluate`.
    """
    scene = without_tolerances(scene)
    weights = np.asarray(scene.weights)
    speeds = np.unique(np.asarray(scene.speeds)[weights > 0])
    view = sampled_view(scene, motion, shutter, PLANNED, ONLY_SPECTRA)
    plan = view.plan
    relative, computed = speeds - float(motion.velocity), np.asarray(view.scene.speeds)
    if plan.folds:
        relative, computed = np.abs(relative), np.abs(computed)
    places = np.argmin(np.abs(relative[:, None] - computed[None]), axis=1)

    def levels(lost: Float[Array, "m"], errors: Float[Array, "s"]) -> DecoderLevels:
        with np.errstate(divide="ignore"):
            return DecoderLevels(1 / np.asarray(lost) - 1, -10 * np.log10(errors)[places])

    both = _levels_of_records(view.scene, view.motion, records(view), plan)
    return SpectralLevels(
        frequencies(plan.num_frequencies), speeds, *(levels(*each) for each in both)
    )


@compiled
def _levels_of_records(
    scene: Scene, motion: AbstractMotion, recorded: Records, plan: Plan
) -> tuple[tuple[Float[Array, "m"], Float[Array, "n"]], ...]:
    """Share of the power lost at each frequency, and squared error at each speed: untold, told."""
    response = assembled(scene, recorded, plan)
    dtype = np.dtype(response.efficiency.dtype)
    power = picture_power(scene, plan.num_frequencies, dtype)
    every = _moments(scene, motion, response, power)
    each = _moments(scene, motion, response, power, told=True)
    untold = every.lost, _errors_by_speed(scene, every, each, power)
    return untold, (_told_share(scene, each), _squared_error(each.lost, power))


_ALIGNING_STEPS = 20
_LEAST_CURVATURE = 0.25
"""Least curvature of a step, as a share of its bound; the bound itself would be safe but slower."""


def freely_aligned(
    scene: Scene, motion: AbstractMotion, response: Response, num_frequencies: int | None = None
) -> Response:
    r"""The response with each speed displaced so that the expected error is least.

    A displacement $d_i$ takes $H_i$ to $H_i e^{2\pi i f d_i}$ and does not change
    $\sum p_i|H_i|^2$, so that of `expected_squared_error` only $-\int W |m|^2\,df$ changes, with
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
    turns = 2 * np.pi * frequency_grid(num_frequencies, np.dtype(dtype))[None, :num_kept]

    def displaced(
        spectra: Complex[Array, "n k"], displacement: Float[Array, "n"]
    ) -> Complex[Array, "n k"]:
        angle = turns * displacement[:, None]
        return spectra * jax.lax.complex(jnp.cos(angle), jnp.sin(angle))

    def step(_: object, displacement: Float[Array, "n"]) -> Float[Array, "n"]:
        each = displaced(spectra, displacement)
        mean = jnp.sum(weights.astype(each.dtype) * each, axis=0)
        overlap = weight.astype(each.dtype) * jnp.conj(mean)[None] * each
        slope = -jnp.sum(turns * overlap.imag, axis=1)
        bound = jnp.sum(turns**2 * jnp.abs(overlap), axis=1)
        curvature = jnp.maximum(jnp.sum(turns**2 * overlap.real, axis=1), _LEAST_CURVATURE * bound)
        curves = curvature > 0
        return displacement + jnp.where(curves, slope / jnp.where(curves, curvature, 1.0), 0.0)

    start = jnp.zeros(spectra.shape[0], dtype)
    displacement = jax.lax.stop_gradient(jax.lax.fori_loop(0, _ALIGNING_STEPS, step, start))
    return eqx.tree_at(lambda r: r.spectra, response, displaced(response.spectra, displacement))


def known_speed_squared_error(
    scene: Scene,
    motion: AbstractMotion,
    response: Response,
    num_frequencies: int | None = None,
) -> Float[Array, ""]:
    r"""Expected squared error of the best linear decoder that is told the speed.

    Each speed has a filter of its own, and the picture, aperture, noise and units are those of
    `expected_squared_error`: without tolerances
    $\sum_i p_i\,2\int_0^{1/2} S\,N/(S|H_i|^2 + N)\,df$. Within tolerances $m$ and $v$ of that
    formula are over the errors about each speed. One filter for all speeds is never better than
    this.
    """
    num_kept = response.spectra.shape[1]
    num_frequencies = num_kept if num_frequencies is None else num_frequencies
    dtype = response.efficiency.dtype
    power = picture_power(scene, num_frequencies, np.dtype(dtype))
    each = _moments(scene, motion, response, power, told=True)
    return _told_squared_error(scene, each, power)


def _told_squared_error(scene: Scene, each: _Moments, power: Float[Array, "m"]) -> Float[Array, ""]:
    """The `known_speed_squared_error` by the moments of each speed."""
    return _squared_error(_told_share(scene, each), power)


def _told_share(scene: Scene, each: _Moments) -> Float[Array, "k"]:
    """Share of the power that is lost at each frequency by filters that are told the speed."""
    return jnp.sum(scene.weights.astype(each.lost.dtype)[:, None] * each.lost, axis=0)


def squared_errors_by_speed(
    scene: Scene,
    motion: AbstractMotion,
    response: Response,
    num_frequencies: int | None = None,
) -> Float[Array, "n"]:
    r"""Squared error of the best single linear decoder at each speed.

    With the filter $G$ of `expected_squared_error` it is
    $2\int_0^{1/2} [S(|1 - G m_i|^2 + |G|^2 v_i) + N|G|^2]\,df$ at speed $i$, where $m_i$ and $v_i$
    are the mean and the variance of the response within the tolerances about that speed: $H_i$ and
    0 without tolerances. The mean over the speeds, weighted, is the `expected_squared_error`.
    """
    num_kept = response.spectra.shape[1]
    num_frequencies = num_kept if num_frequencies is None else num_frequencies
    dtype = np.dtype(response.efficiency.dtype)
    power = picture_power(scene, num_frequencies, dtype)
    every = _moments(scene, motion, response, power)
    each = _moments(scene, motion, response, power, told=True)
    return _errors_by_speed(scene, every, each, power)


def _errors_by_speed(
    scene: Scene, every: _Moments, each: _Moments, power: Float[Array, "m"]
) -> Float[Array, "n"]:
    """The `squared_errors_by_speed` by the moments of all speeds and of each."""
    num_kept = every.mean.shape[0]
    aperture = _aperture(scene, power.size, np.dtype(power.dtype))[:num_kept]
    gain = share(every.signal, every.total, of_nothing=0.0)  # the filter is 0 in the dark
    filter_ = (gain * aperture).astype(every.mean.dtype) * jnp.conj(every.mean)
    missing = 1 - filter_[None] * each.mean
    # The noise over the signal, |G|^2 of it, without a quotient by a signal that may be 0.
    noise = gain * every.coherent * share(every.noise, every.total)
    spread = (gain**2 * every.coherent)[None] * each.spread
    lost = missing.real**2 + missing.imag**2 + spread + noise[None]
    return _squared_error(lost, power)


def worst_squared_error(
    scene: Scene, motion: AbstractMotion, response: Response
) -> Float[Array, ""]:
    """The `expected_squared_error` at the worst of the speeds that occur."""
    return _worst(scene, squared_errors_by_speed(scene, motion, response))


def _worst(scene: Scene, errors: Float[Array, "n"]) -> Float[Array, ""]:
    return jnp.max(jnp.where(scene.weights > 0, errors, 0.0))


def _aperture(
    scene: Scene, num_frequencies: int, dtype: np.dtype
) -> Float[Array, "{num_frequencies}"]:
    """Share of the power that lens and pixel pass, on the frequency grid."""
    frequency = frequency_grid(num_frequencies, dtype)
    return jnp.asarray(pixel_response(frequency, scene.lens_blur.astype(dtype))) ** 2


def _signal_and_noise(
    scene: Scene,
    motion: AbstractMotion,
    efficiency: Float[Array, ""],
    power: Float[Array, "*one k"],
) -> tuple[Float[Array, "*one k"], Float[Array, ""]]:
    """Power of the picture and of the noise, as recorded in a common unit.

    The unit is the larger of signal and noise, because squares of electrons overflow float32.
    """
    dtype = efficiency.dtype
    electrons = white_electrons(scene.photon_rate.astype(dtype), motion.exposure.astype(dtype))
    read_noise = scene.read_noise.astype(dtype)
    largest = jnp.maximum(jnp.maximum(electrons, jnp.sqrt(electrons)), read_noise)
    unit = jax.lax.stop_gradient(jnp.where(largest > 0, largest, 1.0))
    mean_level = scene.mean_level.astype(dtype)
    noise = noise_power(efficiency, mean_level, electrons, read_noise, unit=unit)
    return power * (electrons / unit) ** 2, noise


def bound_share(scene: Scene, motion: AbstractMotion, response: Response) -> Float[Array, ""]:
    r"""Share of the wedge bound that the design reaches at its worst speed and frequency.

    $|K_s(f)|^2 = (2T)^2 |H_s(f)|^2$ over $\min((2T)^2, T/(Sf))$ with $S = \max|s|$ (after
    Levin et al. 2008), up to 0.5 cycles/px. No path and no shutter exceeds 1 at every
    speed in $[-S, S]$.
    """
    spectra = response.spectra[: scene.speeds.size]
    frequency = frequency_grid(spectra.shape[1], np.dtype(response.efficiency.dtype))
    exposure = motion.exposure.astype(frequency.dtype)
    smear = 2 * scene.max_speed.astype(frequency.dtype) * exposure * frequency
    power = spectra.real**2 + spectra.imag**2
    occurs = (scene.weights > 0)[:, None]
    return jnp.min(jnp.where(occurs, power * jnp.maximum(1.0, smear)[None], jnp.inf))
