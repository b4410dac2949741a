"""The metrics of a shutter on a motion for a scene, and the table of them all.

One more metric is a field of `Metrics`, which `evaluate` fills in, and a row of `METRICS`: sweeps,
their stores, documents and tables read the table.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.compiling import compiled
from mishutter._core.slopes import safe_sqrt
from mishutter.blur.spectrum import condition_number
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.errors import LinearErrors
from mishutter.evaluation.found_speed import found_psnr, found_share_of
from mishutter.evaluation.needs import EVERY_PART, ONLY_SPECTRA, Parts, Plan
from mishutter.evaluation.response import Records, Response, kernel_phase
from mishutter.evaluation.views import nan_unless_defined, sampled_view
from mishutter.model.motion import AbstractMotion
from mishutter.model.optics import frequency_grid
from mishutter.model.scene import Scene, require_scene
from mishutter.model.shutters.base import AbstractShutter


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
        known_speed_psnr: PSNR of the best linear decoder that knows the speed; dB. It is at
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

    def __repr__(self) -> str:
        """The values of the metrics; the `repr` of a module shows types alone."""
        values = {n: getattr(self, n) for n in self.__dataclass_fields__}
        lines = (f"  {name}={value}" for name, value in values.items() if value is not None)
        return "\n".join(["Metrics(", *lines, ")"])


@dataclass(frozen=True)
class SequenceMetrics:
    """The metrics of frames that a decoder registers, of which no single kernel is the blur."""

    efficiency: float  # Throughput of each exposure
    known_speed_psnr: float  # PSNR of the best linear decoder, which knows the speed; dB
    # The same at the worst of the scene's speeds; dB. None in the plane
    worst_known_speed_psnr: float | None


class KernelSums(NamedTuple):
    """Numbers of a design's kernels."""

    difference: Float[Array, ""]  # Sum of the squares of `Response.differences`
    still: Float[Array, ""]  # Sum of the squares of the kernel of an object at rest
    condition_number: Float[Array, ""]  # Condition number of that kernel


@final
class Evaluation:
    """One design as the formulas of metrics read it; each part is computed at most once."""

    def __init__(
        self,
        scene: Scene,
        motion: AbstractMotion,
        response: Response,
        kernels: KernelSums | None = None,
        num_frequencies: int | None = None,
    ):
        self.scene, self.motion, self.response = scene, motion, response
        self._kernels, self._num_frequencies = kernels, num_frequencies

    @property
    def kernels(self) -> KernelSums:
        """Numbers of the kernels, which the parts of a metric ask for."""
        if self._kernels is None:
            raise RuntimeError("a metric that reads kernels must ask for them in its parts")
        return self._kernels

    @cached_property
    def kernel_differences(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """The `kernel_differences`, raw and relative."""
        squares = self.kernels.difference, self.kernels.still
        return kernel_differences(self.scene, self.motion, squares)

    @cached_property
    def errors(self) -> LinearErrors:
        """Squared errors of linear decoders, which share the moments of one response."""
        return LinearErrors(self.scene, self.motion, self.response, self._num_frequencies)

    @property
    def found_psnr(self) -> Float[Array, ""]:
        """PSNR of a decoder that finds the speed; dB."""
        share = found_share_of(self.scene, self.motion, self.response.efficiency)
        return found_psnr(_psnr(self.errors.unknown), _psnr(self.errors.known), share)


def _psnr(squared_error: Float[Array, ""]) -> Float[Array, ""]:
    return -10 * jnp.log10(squared_error)


@dataclass(frozen=True)
class Metric:
    """One metric: a row of the table `METRICS`."""

    name: str  # The field of `Metrics`
    meaning: str  # The metric in words, as data sets label it
    heading: str  # Head of its column in tables
    form: str  # Format of its numbers in tables
    parts: Parts  # Parts of the response that the formula reads
    formula: Callable[[Evaluation], Float[Array, ""]]  # The metric of an `Evaluation`
    unit: str = "1"  # Its unit; "1" for a ratio
    is_higher_better: bool = True  # Whether more of it is better
    sees_light: bool = False  # Whether it depends on light and noise
    # Whether it is of a camera as it is built, within the scene's tolerances: a scene without
    # tolerances has none. All others are of the camera as it is designed
    within_tolerances: bool = False


_EVERY_KERNEL = Parts(kernels=True, spectra=False, differences=True)


def _level(
    name: str,
    meaning: str,
    heading: str,
    formula: Callable[[Evaluation], Float[Array, ""]],
    *,
    within_tolerances: bool = False,
) -> Metric:
    """A PSNR in linear light."""
    return Metric(
        name,
        f"{meaning}, linear light",
        heading,
        ".2f",
        ONLY_SPECTRA,
        formula,
        unit="dB",
        sees_light=True,
        within_tolerances=within_tolerances,
    )


_ROWS = (
    Metric(
        "condition_number",
        "condition number of a still object's kernel",
        "condition",
        ".2f",
        Parts(kernels=True, spectra=False, differences=False),
        lambda e: e.kernels.condition_number,
        is_higher_better=False,
    ),
    Metric(
        "kernel_difference",
        "RMS difference of kernels across speeds",
        "kernel diff",
        ".4f",
        _EVERY_KERNEL,
        lambda e: e.kernel_differences[0],
        is_higher_better=False,
    ),
    Metric(
        "relative_kernel_difference",
        "RMS difference over RMS of a still object's kernel",
        "relative",
        ".3f",
        _EVERY_KERNEL,
        lambda e: e.kernel_differences[1],
        is_higher_better=False,
    ),
    Metric(
        "efficiency",
        "share of light let through",
        "light",
        ".3f",
        Parts(kernels=False, spectra=False, differences=False),
        lambda e: e.response.efficiency,
    ),
    _level(
        "expected_psnr",
        "PSNR of the best single linear decoder",
        "PSNR dB",
        lambda e: _psnr(e.errors.unknown),
    ),
    _level(
        "known_speed_psnr",
        "PSNR of the best linear decoder that knows the speed",
        "speed known dB",
        lambda e: _psnr(e.errors.known),
    ),
    _level(
        "found_speed_psnr",
        "PSNR of a decoder that finds the speed",
        "speed found dB",
        lambda e: e.found_psnr,
    ),
    _level(
        "worst_speed_psnr",
        "PSNR of that decoder at the worst of the speeds",
        "worst speed dB",
        lambda e: _psnr(e.errors.worst(e.errors.unknown_by_speed)),
    ),
    _level(
        "worst_known_speed_psnr",
        "PSNR of a decoder that knows the speed at the worst of the speeds",
        "worst known dB",
        lambda e: _psnr(e.errors.worst(e.errors.known_by_speed)),
    ),
    Metric(
        "bound_share",
        "share of the wedge bound, worst speed and frequency",
        "bound",
        ".3f",
        ONLY_SPECTRA,
        lambda e: bound_share(e.scene, e.motion, e.response),
    ),
    _level(
        "toleranced_psnr",
        "PSNR of the best single linear decoder within the tolerances",
        "within dB",
        lambda e: _psnr(e.errors.unknown),
        within_tolerances=True,
    ),
)
METRICS = {metric.name: metric for metric in _ROWS}
"""Every metric by its name: the one table that all read who compute, store, sweep or print them."""


def named_metrics(names: Iterable[str]) -> tuple[Metric, ...]:
    """The metrics of some names, in order."""
    return tuple(METRICS[name] for name in names)


def evaluate(scene: Scene, motion: AbstractMotion, shutter: AbstractShutter) -> Metrics:
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

    Returns:
        The metrics; see `Metrics`.

    Raises:
        ValueError: if kernels are longer than 65,535 px, or the light of all speeds falls
            over more than 93,600 px, or a number of motion or shutter is not finite.
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
    require_scene(scene)
    within = {}
    if scene.tolerances is not None:
        seen = sampled_view(scene, motion, shutter, ONLY_SPECTRA)
        within = _within_tolerances(seen.scene, seen.motion, Records.of(seen), seen.plan)
        scene = without_tolerances(scene)
    view = sampled_view(scene, motion, shutter, EVERY_PART)
    values, phase = _as_designed(view.scene, view.motion, Records.of(view), view.plan)
    measured = values, within, phase
    values, within, phase = nan_unless_defined(measured, motion, shutter, scene)
    return Metrics(
        condition_number=values["condition_number"],
        kernel_difference=values["kernel_difference"],
        relative_kernel_difference=values["relative_kernel_difference"],
        efficiency=values["efficiency"],
        expected_psnr=values["expected_psnr"],
        known_speed_psnr=values["known_speed_psnr"],
        found_speed_psnr=values["found_speed_psnr"],
        worst_speed_psnr=values["worst_speed_psnr"],
        worst_known_speed_psnr=values["worst_known_speed_psnr"],
        bound_share=values["bound_share"],
        phase=phase,
        dft_length=view.plan.dft_length,
        num_taps=view.plan.num_taps,
        toleranced_psnr=within.get("toleranced_psnr"),
    )


@compiled
def _as_designed(
    scene: Scene, motion: AbstractMotion, recorded: Records, plan: Plan
) -> tuple[dict[str, Float[Array, ""]], Float[Array, ""]]:
    """The metrics of a camera without errors by name, and the phase of its kernels."""
    response = recorded.response(scene, plan)
    condition = condition_number(response.still_kernel, num_frequencies=plan.dft_length)
    kernels = KernelSums(*response.squares, condition)
    evaluation = Evaluation(scene, motion, response, kernels)
    values = {m.name: m.formula(evaluation) for m in METRICS.values() if not m.within_tolerances}
    phase = jnp.asarray(kernel_phase(motion, plan.num_taps), response.efficiency.dtype)
    return values, phase


@compiled
def _within_tolerances(
    scene: Scene, motion: AbstractMotion, recorded: Records, plan: Plan
) -> dict[str, Float[Array, ""]]:
    """The metrics of a camera within the scene's tolerances, by name."""
    response = recorded.response(scene, plan)
    evaluation = Evaluation(scene, motion, response, num_frequencies=plan.num_frequencies)
    return {m.name: m.formula(evaluation) for m in METRICS.values() if m.within_tolerances}


def kernel_differences(
    scene: Scene, motion: AbstractMotion, squares: tuple[Float[Array, ""], Float[Array, ""]]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    r"""Cross-speed kernel difference, raw and relative to the still object's kernel.

    $\sqrt{\sum_i p_i\,\overline{(h_{s_i} - h_0)^2}}$ (the paper's Figure 3b, over the
    scene's speeds), and the same over $\sqrt{\overline{h_0^2}}$. The means are over the
    taps that the fastest object reaches. The derivative where all kernels agree is 0. The sums
    are the `squares` of a response.
    """
    difference, still = squares
    is_open = still > 0
    relative = safe_sqrt(jnp.where(is_open, difference / jnp.where(is_open, still, 1.0), 0.0))
    # Light of the fastest object falls on so many taps, an odd number for a camera at rest.
    far = jnp.ceil(motion.kernel_length(scene.max_speed))
    aside = jnp.ceil(scene.max_speed * motion.half_exposure - 0.5)
    count = jnp.where(motion.has_vertex, far, 2 * aside + 1)
    count = jax.lax.stop_gradient(jnp.maximum(count, 1)).astype(still.dtype)
    return safe_sqrt(difference / count), relative


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
