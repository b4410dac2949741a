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
from jaxtyping import Array

from mishutter._core import (
    all_concrete,
    common_dtype,
    compiled,
    device_constant,
    is_concrete,
    namespace_of,
)
from mishutter.blur import (
    ExposureQuadrature,
    aligned_kernel,
    exposure_quadrature,
    mean_transmittance,
    num_runs,
    path_ends,
    sum_of_waves,
    waves_of_blocks,
    waves_on_dft,
)
from mishutter.evaluation.ensembles import at_each_error
from mishutter.evaluation.layers import ComputedSpeeds, computed_speeds
from mishutter.evaluation.lengths import require_sizes, size_class
from mishutter.evaluation.needs import Plan
from mishutter.evaluation.sensor_view import SampledView
from mishutter.model import (
    AbstractMotion,
    AbstractPiecewiseShutter,
    AbstractShutter,
    Scene,
    Tolerances,
    canonical_motion,
    has_vertex,
    in_one_form,
    piecewise,
)

_SPEEDS_AT_ONCE, _LEAST_TAPS = 8, 512


@final
class Response(eqx.Module):
    r"""Kernels and transfer functions of a design at the speeds of a scene.

    A part that was not asked for is empty.

    Attributes:
        still_kernel: Blur kernel of a still object, $h_0$; shape `(n,)`.
        still_spectrum: Its DFT of `dft_length` points; complex, `(dft_length // 2 + 1,)`.
        differences: $\sqrt{p_i}\,(h_{s_i} - h_0)$ at the scene's speeds; shape `(s, n)`.
        spectra: Transfer functions at these speeds, in the vertex frame, without the pixel
            aperture; complex, shape `(s, m)`.
        efficiency: Mean transmittance over the exposure; scalar.
    """

    still_kernel: Array
    still_spectrum: Array
    differences: Array
    spectra: Array
    efficiency: Array


class Records(NamedTuple):
    """Kernels and transfer functions of a design at some speeds, before they are combined.

    Attributes:
        kernels: Kernel of an object at rest, then that of each speed; shape `(s + 1, n)`.
        spectra: Transfer functions; complex, shape `(s, m)`.
        efficiency: Mean transmittance over the exposure; scalar.
    """

    kernels: Array
    spectra: Array
    efficiency: Array


def respond(view: SampledView) -> Response:
    """Response of a design to a scene, with the parts that its view asks for."""
    return assembled(view.scene, records(view), view.plan)


def records(view: SampledView) -> Records:
    """Kernels and transfer functions, each by one compiled program for all its callers.

    Without differences among the parts, or where nothing in the scene moves, only the kernel at
    rest is computed.
    """
    scene, motion, profile, plan, parts = view
    kernels, spectra = parts.kernels, parts.spectra
    require_sizes(plan.num_taps, plan.num_frequencies, kernels=kernels, spectra=spectra)
    dtype = common_dtype(*jax.tree.leaves((scene.speeds, motion, profile)))
    if all_concrete((profile, motion, scene.speeds)):
        profile = in_one_form(profile, dtype)
    taps = response = light = None
    if kernels:
        moving = scene.speeds if parts.differences and not plan.still else scene.speeds[:0]
        taps, light = _known_kernels(profile, motion, _with_rest(moving), plan.num_taps)
    if spectra:
        nodes = exposure_quadrature(profile, plan.num_nodes, dtype, path_ends(motion))
        response = spectra_of(scene, nodes, motion, plan.num_frequencies, plan.num_kept)
        light = nodes.efficiency
    light = _only_light(profile, motion, scene.speeds) if light is None else light
    nothing = np.zeros(0, dtype)
    parts_or_nothing = (nothing if part is None else part for part in (taps, response, light))
    return Records(
        *(device_constant(x) if isinstance(x, np.ndarray) else x for x in parts_or_nothing)
    )


def assembled(scene: Scene, recorded: Records, plan: Plan) -> Response:
    """The response, from which losses and metrics follow."""
    still = differences = spectrum = jnp.zeros(0, recorded.efficiency.dtype)
    if recorded.kernels.size:
        still = recorded.kernels[0]
        spectrum = jnp.fft.rfft(*folded(still, plan))
        num_moving = recorded.kernels.shape[0] - 1
        shares = jnp.sqrt(scene.weights[:num_moving].astype(still.dtype))[:, None]
        differences = shares * (recorded.kernels[1:] - still[None])
    return Response(still, spectrum, differences, recorded.spectra, recorded.efficiency)


def folded(kernels: Array | np.ndarray, plan: Plan) -> tuple[Array | np.ndarray, int]:
    """Kernels `(..., n)` as the DFT of a loss takes them, and its length.

    The part of a kernel beyond that length is laid over its beginning, which leaves every sample
    of the DFT as it is.
    """
    length = plan.loss_dft_length or plan.dft_length
    if kernels.shape[-1] <= length:
        return kernels, length
    space = namespace_of(kernels)
    spare = -kernels.shape[-1] % length
    rows = space.pad(kernels, [(0, 0)] * (kernels.ndim - 1) + [(0, spare)])
    return space.sum(rows.reshape(*kernels.shape[:-1], -1, length), axis=-2), length


def _with_rest(speeds: Array) -> Array | np.ndarray:
    """The speed 0, then the given speeds; a NumPy array where they are known."""
    rest = np.zeros(1, speeds.dtype)
    return np.append(rest, speeds) if is_concrete(speeds) else jnp.append(rest, speeds)


@eqx.filter_jit
def _only_light(profile: AbstractPiecewiseShutter, motion: AbstractMotion, speeds: Array) -> Array:
    return mean_transmittance(profile, common_dtype(*jax.tree.leaves((speeds, motion, profile))))


def kernel_phase(motion: AbstractMotion, num_taps: int) -> float | Array:
    """Offset of the first tap's edge from the point of alignment; px, scalar.

    A moving sensor is aligned at the vertex, a camera at rest at mid-exposure, in the
    middle of its middle tap.
    """
    turns, middle = has_vertex(motion), -0.5 - num_taps // 2
    if is_concrete(turns):
        return 0.0 if turns else middle
    return jnp.where(turns, 0.0, middle)


def kernels_at_speeds(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speeds: Array | np.ndarray,
    num_taps: int,
) -> Array:
    """Aligned kernels of one length at several speeds, px/s; shape `(s, num_taps)`.

    Kernels at known speeds are computed eight at a time, of shutters `in_one_form`, and cut
    from longer ones: one compiled program serves every kind and any number of speeds and taps.
    """
    kernels = _known_kernels(shutter, canonical_motion(motion), speeds, num_taps)[0]
    if not isinstance(kernels, np.ndarray):
        return kernels
    return device_constant(kernels)


def _known_kernels(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speeds: Array | np.ndarray,
    num_taps: int,
) -> tuple[Array | np.ndarray, Array]:
    dtype = common_dtype(*jax.tree.leaves((speeds, motion, shutter)))
    first = kernel_phase(motion, num_taps)
    if not all_concrete((shutter, motion, speeds)):
        speeds, first = (jnp.asarray(x, dtype) for x in (speeds, first))
        return kernels_and_light(shutter, motion, speeds, first, num_taps, num_runs(motion))
    shutter = in_one_form(shutter, dtype)
    count, length = len(speeds), max(_LEAST_TAPS, size_class(num_taps))
    padded = np.pad(np.asarray(speeds, dtype), (0, -count % _SPEEDS_AT_ONCE))
    of_some = partial(kernels_and_light, in_turn=jax.default_backend() == "cpu")
    some = [
        of_some(shutter, motion, part, np.asarray(first, dtype), length, num_runs(motion))
        for part in padded.reshape(-1, _SPEEDS_AT_ONCE)
    ]
    kernels = np.concatenate([np.asarray(kernels) for kernels, _ in some])
    return kernels[:count, :num_taps], some[0][1]


@compiled
def kernels_and_light(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speeds: Array | np.ndarray,
    first: Array | np.ndarray,
    num_taps: int,
    runs: int,
    *,
    in_turn: bool = False,
) -> tuple[Array, Array]:
    """Kernels whose first tap begins at `first`, px from the point of alignment; efficiency.

    One speed after the other where they are taken `in_turn`: the taps of one fill the vectors of a
    CPU, and a program for many at once is traced in twice the time.
    """

    def one(speed: Array) -> Array:
        turns = jnp.asarray(has_vertex(motion))
        rule = {"from_vertex": turns, "count": runs}
        return aligned_kernel(shutter, motion, speed, num_taps, first, **rule)

    light = mean_transmittance(piecewise(shutter), np.dtype(speeds.dtype))
    of_each = partial(jax.lax.map, one) if in_turn else jax.vmap(one)
    return of_each(jnp.asarray(speeds)), light


def pixel_responses(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speeds: np.ndarray,
    length: int,
    *,
    num_nodes: int,
    num_frequencies: int | None = None,
    some: np.ndarray | slice = slice(None),
) -> Array | np.ndarray:
    r"""Responses of the pixels to a continuous picture on the grid of a DFT; complex, `(s, k)`.

    $H_s(f)\operatorname{sinc}(f)$ at $f = k/L \le 1/2$, in units of a fully open exposure. An
    accelerated sensor is aligned at the vertices of the paths, any other at mid-exposure. Of a
    shutter that is known it is a NumPy array.

    Args:
        shutter: Transmittance over the exposure.
        motion: Motion of the sensor, without velocity; known.
        speeds: px/s; known, shape `(s,)`.
        length: Pixels of the DFT, $L$.
        num_nodes: Quadrature nodes over the exposure, about.
        num_frequencies: Lowest of the frequencies that are computed; all `length // 2 + 1`.
        some: Indices of the speeds whose responses are computed; all are aligned together.
    """
    tau, light = light_in_time(shutter, motion, num_nodes)
    count = length // 2 + 1 if num_frequencies is None else num_frequencies
    aperture = np.sinc(np.arange(count) / length)[None]
    each = np.asarray(speeds)[:, None].astype(tau.dtype)
    waves = waves_on_dft(motion.aligned_position(tau, each)[some], light, length, count)
    return waves * aperture.astype(waves.dtype)


def light_in_time(
    shutter: AbstractShutter, motion: AbstractMotion, num_nodes: int
) -> tuple[Array | np.ndarray, Array | np.ndarray]:
    """Normalised times and the light at them, of shape `(1, q)`; NumPy arrays where known."""
    dtype = common_dtype(*jax.tree.leaves((motion, shutter)))
    nodes = exposure_quadrature(shutter, num_nodes, dtype, path_ends(motion))
    tau, light = nodes.tau, nodes.weight
    if all_concrete((tau, light)):
        tau, light = np.asarray(tau, np.float64), np.asarray(light, np.float64)
    return tau[None], light[None]


@compiled
def aligned_spectra(
    nodes: ExposureQuadrature,
    motion: AbstractMotion,
    computed: ComputedSpeeds,
    num_frequencies: int,
    num_kept: int | None = None,
    num_blocks: Array | None = None,
) -> Array:
    """Transfer functions on the frequency grid, aligned as the kernels are; `(s, m)`, complex.

    Speeds that occur are `aligned`. With `num_kept` only at the lowest of the frequencies; with
    `num_blocks` from so many first blocks of nodes, and without a derivative.
    """
    position = _positions(nodes.tau, motion, *computed)
    light, num_kept = nodes.weight[None], num_kept or num_frequencies
    if num_blocks is None:
        return sum_of_waves(position, light, num_frequencies, num_kept)
    return waves_of_blocks(position, light, num_frequencies, num_kept, num_blocks)


def _positions(tau: Array, motion: AbstractMotion, speeds: Array, occurs: Array) -> Array:
    """Positions of objects at some times, those that occur aligned; px, shape `(s, q)`."""
    speeds = speeds.astype(tau.dtype)
    displacement = motion.side_by_side(jnp.where(occurs, speeds, 0)).displacement
    position = motion.position_of(tau[None], speeds[:, None])
    return jnp.asarray(position) + jnp.asarray(displacement)[:, None]


def spectra_of(
    scene: Scene,
    nodes: ExposureQuadrature,
    motion: AbstractMotion,
    num_frequencies: int,
    num_kept: int | None = None,
) -> Array:
    """The `aligned_spectra` of a scene; within its tolerances, in order of `ensemble_weights`."""
    computed, tolerances = computed_speeds(scene), scene.tolerances
    if tolerances is None:
        return aligned_spectra(nodes, motion, computed, num_frequencies, num_kept)
    return _scattered_spectra(nodes, motion, computed, tolerances, num_frequencies, num_kept)


@compiled
def _scattered_spectra(
    nodes: ExposureQuadrature,
    motion: AbstractMotion,
    computed: ComputedSpeeds,
    tolerances: Tolerances,
    num_frequencies: int,
    num_kept: int | None,
) -> Array:
    """Transfer functions of an ensemble, each acceleration aligned by itself; `(k * n, m)`."""
    occurs = jnp.tile(computed.occurs, tolerances.num_speeds)

    def positions(motion: AbstractMotion, speeds: Array) -> Array:
        return _positions(nodes.tau, motion, speeds, occurs)

    speeds = computed.speeds.astype(nodes.tau.dtype)
    position = at_each_error(positions, speeds, tolerances, motion)
    rows = position.reshape(-1, position.shape[-1])
    return sum_of_waves(rows, nodes.weight[None], num_frequencies, num_kept or num_frequencies)
