r"""The response of a design to a scene: kernels, transfer functions and efficiency.

All of it is linear in the transmittance. The transfer functions are sampled at the
centres of equal steps in (0, 0.5) cycles/px, by quadrature over the exposure.
"""

from functools import partial
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Inexact, Int

from mishutter._core.checks import all_concrete, common_dtype, device_constant, is_concrete
from mishutter._core.compiling import compiled
from mishutter.blur.kernel import aligned_kernel
from mishutter.blur.quadrature import ExposureQuadrature, exposure_quadrature, mean_transmittance
from mishutter.blur.waves import sum_of_waves, waves_of_blocks, waves_on_dft
from mishutter.evaluation.ensembles import at_each_error
from mishutter.evaluation.layers import computed_speeds
from mishutter.evaluation.needs import Plan, size_class
from mishutter.evaluation.views import SampledView, require_numbers
from mishutter.model.motion import AbstractMotion, simplified
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractShutter, piecewise
from mishutter.model.shutters.polynomials import in_one_form
from mishutter.model.tolerances import Tolerances

_SPEEDS_AT_ONCE = 8


@final
class Response(eqx.Module):
    r"""Kernels and transfer functions of a design at the speeds of a scene.

    A part that was not asked for is empty.
    """

    still_kernel: Float[Array, "n"]  # Blur kernel of a still object, $h_0$; shape `(n,)`
    still_spectrum: Inexact[Array, "f"]  # Its DFT of `dft_length` points; complex
    differences: Float[Array, "..."]  # $\sqrt{p_i}\,(h_{s_i} - h_0)$ at the scene's speeds
    # Transfer functions at these speeds, from where objects are aligned, without the pixel
    # aperture; complex, shape `(s, m)`
    spectra: Inexact[Array, "..."]
    efficiency: Float[Array, ""]  # Mean transmittance over the exposure; scalar

    @property
    def squares(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Sums of squares of the differences, and of the kernel of a still object."""
        return jnp.sum(self.differences**2), jnp.sum(self.still_kernel**2)


class Records(NamedTuple):
    """Kernels and transfer functions of a design at some speeds, before they are combined."""

    kernels: Float[Array, "s+1 n"]  # Kernel of an object at rest, then that of each speed
    spectra: Inexact[Array, "s m"]  # Transfer functions; complex, shape `(s, m)`
    efficiency: Float[Array, ""]  # Mean transmittance over the exposure; scalar

    @staticmethod
    def of(view: SampledView) -> "Records":
        """Kernels and transfer functions, each by one compiled program for all callers.

        Without differences among the parts, or where nothing in the scene moves, the kernel at rest
        is the only one.
        """
        scene, motion, profile, plan, parts, nodes = view
        dtype = common_dtype(scene.speeds, motion, profile)
        if all_concrete((profile, motion, scene.speeds)):
            profile = in_one_form(profile, dtype)
        nothing = device_constant(np.zeros(0, dtype))
        kernels, spectra, efficiency = nothing, nothing, None
        if parts.kernels:
            speeds = scene.speeds if parts.differences and not plan.still else scene.speeds[:0]
            rest = np.zeros(1, speeds.dtype)
            speeds = np.append(rest, speeds) if is_concrete(speeds) else jnp.append(rest, speeds)
            kernels, efficiency = _kernels_and_efficiency(profile, motion, speeds, plan.num_taps)
        if parts.spectra:
            if nodes is None:
                nodes = exposure_quadrature(profile, plan.num_nodes, dtype, motion.piece_ends)
            spectra = spectra_of(scene, nodes, motion, plan.num_frequencies, plan.num_kept)
            efficiency = nodes.efficiency
        if efficiency is None:
            efficiency = _efficiency(profile, dtype)
        return Records(kernels, spectra, efficiency)

    def response(self, scene: Scene, plan: Plan) -> Response:
        """The response, from which losses and metrics follow."""
        still = differences = spectrum = jnp.zeros(0, self.efficiency.dtype)
        if self.kernels.size:
            still = self.kernels[0]
            spectrum = jnp.fft.rfft(*folded(still, plan))
            num_moving = self.kernels.shape[0] - 1
            shares = jnp.sqrt(scene.weights[:num_moving].astype(still.dtype))[:, None]
            differences = shares * (self.kernels[1:] - still[None])
        return Response(still, spectrum, differences, self.spectra, self.efficiency)


def compute_response(view: SampledView) -> Response:
    """The parts of a design's response to a scene that a view asks for."""
    return Records.of(view).response(view.scene, view.plan)


def folded(kernel: Float[Array, "n"], plan: Plan) -> tuple[Float[Array, "k"], int]:
    """A kernel as the DFT of a loss takes it, and the length of this DFT.

    The part of a kernel beyond that length is laid over its beginning, which leaves every sample
    of the DFT as it is.
    """
    length = plan.loss_dft_length or plan.dft_length
    if kernel.size <= length:
        return kernel, length
    rows = jnp.pad(kernel, (0, -kernel.size % length)).reshape(-1, length)
    return jnp.sum(rows, axis=0), length


_efficiency = eqx.filter_jit(mean_transmittance)


def kernel_phase(motion: AbstractMotion, num_taps: int) -> float | Float[Array, ""]:
    """Offset of the first tap's edge from the point of alignment; px, scalar.

    Kernels of a moving sensor rise from where objects are aligned. A camera at rest is aligned at
    mid-exposure, in the middle of its middle tap.
    """
    turns, middle = motion.has_vertex, -0.5 - num_taps // 2
    if is_concrete(turns):
        return 0.0 if turns else middle
    return jnp.where(turns, 0.0, middle)


def kernels_at_speeds(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speeds: Float[Array | np.ndarray, "s"],
    num_taps: int,
) -> Float[Array, "s {num_taps}"]:
    """Aligned kernels of one length at several speeds, px/s.

    Kernels at concrete speeds are computed eight at a time, of shutters `in_one_form`, and cut
    from longer ones: one compiled program serves every kind and any number of speeds and taps.
    """
    motion = simplified(motion)
    return _kernels_and_efficiency(shutter, motion, speeds, num_taps)[0]


def _kernels_and_efficiency(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speeds: Float[Array | np.ndarray, "s"],
    num_taps: int,
) -> tuple[Float[Array, "s {num_taps}"], Float[Array, ""]]:
    dtype = common_dtype(speeds, motion, shutter)
    first = kernel_phase(motion, num_taps)
    if not all_concrete((shutter, motion, speeds)):
        speeds, first = (jnp.asarray(x, dtype) for x in (speeds, first))
        return kernels_and_efficiency(shutter, motion, speeds, first, num_taps=num_taps)
    shutter = in_one_form(shutter, dtype)
    count, length = len(speeds), max(512, size_class(num_taps))
    padded = np.pad(np.asarray(speeds, dtype), (0, -count % _SPEEDS_AT_ONCE))
    of_part = partial(
        kernels_and_efficiency,
        num_taps=length,
        in_turn=jax.default_backend() == "cpu",
    )
    first = np.asarray(first, dtype)
    parts = [of_part(shutter, motion, part, first) for part in padded.reshape(-1, _SPEEDS_AT_ONCE)]
    kernels = np.concatenate([np.asarray(kernels) for kernels, _ in parts])
    return device_constant(kernels[:count, :num_taps]), parts[0][1]


@compiled
def kernels_and_efficiency(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speeds: Float[Array | np.ndarray, "s"],
    first: Float[Array | np.ndarray, ""],
    *,
    num_taps: int,
    in_turn: bool = False,
) -> tuple[Float[Array, "s {num_taps}"], Float[Array, ""]]:
    """Kernels whose first tap begins at `first`, px from the point of alignment; efficiency.

    They are computed one after the other if `in_turn`: the taps of one kernel fill the vectors of a
    CPU, and a program for many speeds takes twice as long to trace.
    """
    # A path that loses velocity is aligned at its highest, from which its mirror image rises.
    sign = jnp.asarray(motion.turn, speeds.dtype)
    rising, bends = motion.mirrored(sign), jnp.asarray(motion.has_vertex)

    def one(speed: Float[Array, ""]) -> Float[Array, "n"]:
        relative = sign * speed
        return aligned_kernel(shutter, rising, relative, num_taps, first, from_lowest=bends)

    efficiency = mean_transmittance(piecewise(shutter), np.dtype(speeds.dtype))
    of_each = partial(jax.lax.map, one) if in_turn else jax.vmap(one)
    return of_each(jnp.asarray(speeds)), efficiency


def pixel_responses(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speeds: Float[Array | np.ndarray, "every"],
    length: int,
    *,
    num_nodes: int,
    num_frequencies: int | None = None,
    some: Int[np.ndarray, "s"] | Bool[np.ndarray, "every"] | slice = slice(None),
) -> Complex[Array | np.ndarray, "s k"]:
    r"""Responses of the pixels to a continuous picture on the grid of a DFT; complex, `(s, k)`.

    $H_s(f)\operatorname{sinc}(f)$ at $f = k/L \le 1/2$, in units of a fully open exposure. An
    accelerated sensor is aligned by its path, any other at mid-exposure (`alignment`). The response
    of a concrete shutter is a NumPy array.
    """
    for part in (motion, shutter):
        require_numbers(part)
    tau, weight = nodes_in_time(shutter, motion, num_nodes)
    count = length // 2 + 1 if num_frequencies is None else num_frequencies
    aperture = np.sinc(np.arange(count) / length)[None]
    each = speeds[:, None].astype(tau.dtype)
    waves = waves_on_dft(motion.aligned_position(tau, each)[some], weight, length, count)
    return waves * aperture.astype(waves.dtype)


def nodes_in_time(
    shutter: AbstractShutter, motion: AbstractMotion, num_nodes: int
) -> tuple[Float[Array | np.ndarray, "1 q"], Float[Array | np.ndarray, "1 q"]]:
    """Quadrature nodes in normalised time and their weights, the transmittance included.

    They are NumPy arrays of double precision if the shutter is concrete.
    """
    dtype = common_dtype(motion, shutter)
    nodes = exposure_quadrature(shutter, num_nodes, dtype, motion.piece_ends)
    tau, weight = nodes.tau, nodes.weight
    if all_concrete((tau, weight)):
        tau, weight = np.asarray(tau, np.float64), np.asarray(weight, np.float64)
    return tau[None], weight[None]


def spectra_of(
    scene: Scene,
    nodes: ExposureQuadrature,
    motion: AbstractMotion,
    num_frequencies: int,
    num_kept: int | None = None,  # None for all
    *,
    num_blocks: Int[Array, ""] | None = None,
) -> Complex[Array, "s m"]:
    """Transfer functions of a scene on the frequency grid, aligned as the kernels are.

    Within its tolerances they are in the order of `ensemble_weights`.
    """
    return _spectra(
        nodes,
        motion,
        computed_speeds(scene),
        scene.tolerances,
        num_frequencies=num_frequencies,
        num_kept=num_kept or num_frequencies,
        num_blocks=num_blocks,
    )


@compiled
def _spectra(
    nodes: ExposureQuadrature,
    motion: AbstractMotion,
    speeds: Float[Array, "s"],
    tolerances: Tolerances | None,
    *,
    num_frequencies: int,
    num_kept: int,
    num_blocks: Int[Array, ""] | None,
) -> Complex[Array, "n m"]:
    def positions(motion: AbstractMotion, speeds: Float[Array, "n"]) -> Float[Array, "n q"]:
        """Positions of objects at the nodes, from where they are aligned; px."""
        return jnp.asarray(motion.aligned_position(nodes.tau[None], speeds[:, None]))

    speeds, weight = speeds.astype(nodes.tau.dtype), nodes.weight[None]
    if tolerances is None:
        position = positions(motion, speeds)
    else:
        position = at_each_error(positions, speeds, tolerances, motion)
        position = position.reshape(-1, position.shape[-1])
    if num_blocks is None:
        return sum_of_waves(position, weight, num_frequencies, num_kept)
    return waves_of_blocks(position, weight, num_frequencies, num_kept, num_blocks)
