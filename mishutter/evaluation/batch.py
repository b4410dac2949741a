"""Metrics of many designs, by the formulas of `evaluate`, each at the sizes that it needs.

One compiled loop goes from design to design. How many taps and nodes one of them asks for is
known when it is run, so that a program serves all of them, each at its own cost.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import compiled, in_threads, num_threads
from mishutter.blur import BLOCK, ExposureQuadrature, condition_number, exposure_quadrature
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.layers import computed_speeds
from mishutter.evaluation.lengths import (
    longest_within_limits,
    num_frequencies,
    occurring_speeds,
)
from mishutter.evaluation.metrics import (
    bound_share,
    differences_from,
    expected_squared_error,
    worst_squared_error,
)
from mishutter.evaluation.needs import Plan, effective_speeds, folds_speeds, reduced, sized_for
from mishutter.evaluation.response import (
    Records,
    Response,
    aligned_spectra,
    assembled,
    kernels_and_light,
)
from mishutter.evaluation.sensor_view import transmittance
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    ParabolicMotion,
    Scene,
    aligned,
    has_vertex,
    piecewise,
    reach_of_parabola,
    steady,
    with_occlusion,
)

KERNEL_METRICS = ("condition_number", "kernel_difference", "relative_kernel_difference")
ERRORS_BY_LIGHT = {
    "expected_psnr": expected_squared_error,
    "worst_speed_psnr": worst_squared_error,
}
"""Squared errors that a PSNR is of, by its name: they depend on light and noise."""
SPECTRUM_METRICS = (*ERRORS_BY_LIGHT, "bound_share")
_TAPS = 64
"""Taps that are done at a time."""
_DESIGNS_A_CALL = 64
"""The same however many devices share the work, and so one program."""
_FURTHEST = float(1 << 17)
"""Length from which on all kernels are refused alike; px."""


class Sizes(NamedTuple):
    """What `evaluate` takes for each design, and what is enough; shape `(n,)` each.

    Attributes:
        num_taps: Taps of the kernels.
        dft_length: Points of the DFT of the condition number.
        num_frequencies: Frequencies of the expected error.
        num_lit_taps: Taps that light of the fastest object may fall on.
        num_still_taps: The same of an object at rest.
        num_nodes: Nodes over the exposure.
        aside: Whole taps from the first one to that of an object at rest: 0 where the sensor
            moves.
        num_effective_speeds: Effective speeds of two layers; 0 of a picture that moves as a whole.
    """

    num_taps: np.ndarray
    dft_length: np.ndarray
    num_frequencies: np.ndarray
    num_lit_taps: np.ndarray
    num_still_taps: np.ndarray
    num_nodes: np.ndarray
    aside: np.ndarray
    num_effective_speeds: np.ndarray


class Shapes(NamedTuple):
    """Sizes that all designs of a batch share; static.

    Attributes:
        dft_lengths: Lengths that the condition number may be taken over.
        still_taps: Taps of the longest kernel of an object at rest.
        node_counts: About how many nodes the rules of quadrature have, ascending.
    """

    dft_lengths: tuple[int, ...]
    still_taps: int
    node_counts: tuple[int, ...]


class Rules(NamedTuple):
    """Nodes over the exposure and the light at them, for rules of rising number.

    Attributes:
        tau: Normalised times; shape `(r, q)`.
        light: Light of each of `k` shutters, a mixture of which each design has; `(r, k, q)`.
        num_blocks: Blocks of nodes that hold light; shape `(r,)`.
        efficiency: Mean transmittance of each shutter; shape `(k,)`.
    """

    tau: Array
    light: Array
    num_blocks: Array
    efficiency: Array


class LightLevels(NamedTuple):
    """Light and noise that designs are measured in, each with each.

    Attributes:
        photon_rates: Photo-electrons a second at a white pixel; e-/s, shape `(p,)`.
        read_noises: e-; shape `(r,)`.
    """

    photon_rates: Array | np.ndarray
    read_noises: Array | np.ndarray


class _Need(NamedTuple):
    """Numbers that the loops need of a design; its attributes are scalars.

    Attributes:
        num_blocks: Blocks of taps.
        first: Offset of the first tap's edge from the point of alignment, px.
        still_block: Block in which the light of an object at rest begins.
        dft: Which of the lengths.
        rule: Which of the rules.
    """

    num_blocks: Any
    first: Any
    still_block: Any
    dft: Any
    rule: Any


def motions_at(accelerations: np.ndarray, half_exposures: np.ndarray) -> ParabolicMotion:
    """Motions without velocity whose numbers have a leading axis; shape `(n,)` each."""
    one = ParabolicMotion(acceleration=0.0, half_exposure=1.0)
    numbers = accelerations, half_exposures, np.zeros_like(half_exposures)
    return eqx.tree_at(lambda m: (m.acceleration, m.half_exposure, m.velocity), one, numbers)


def sizes_of(scene: Scene, motions: AbstractMotion, *, skips: bool) -> Sizes:
    """Sizes of a scene on many motions; where everything is computed, enough is all."""
    longest, turns = longest_within_limits(scene), np.asarray(has_vertex(motions))
    half = np.asarray(motions.half_exposure, np.float64)
    a = np.asarray(steady(motions).acceleration, np.float64)
    stroke = np.where(turns, a * half * half, 0.0)
    smear = float(scene.max_speed) * half
    reach, velocity = map(np.asarray, reach_of_parabola(stroke, smear))
    held = _by_whole(np.minimum(np.maximum(reach, longest), _FURTHEST), lambda x: sized_for(x, 0.0))
    num_taps, dft_length = (_each(held, name) for name in ("num_taps", "dft_length"))
    speeds = occurring_speeds(scene).reshape(-1, *(1,) * np.ndim(stroke))
    spread = np.asarray(aligned(stroke[None], speeds * half).extent)[0]
    counts = num_frequencies(scene, spread)
    aside = np.minimum(np.ceil(float(scene.max_speed) * half), num_taps // 2)
    aside = np.where(turns, 0, aside).astype(int)
    lit = np.where(turns, np.ceil(reach) + 1, 2 * aside + 1)
    if not skips:
        velocity, lit = np.maximum(velocity, longest), num_taps
    nodes = _each(_by_whole(velocity, lambda x: sized_for(0.0, x)), "num_nodes")
    lit = np.minimum(lit, num_taps).astype(int)
    still = np.minimum(np.ceil(stroke) + 1, num_taps).astype(int)
    halves, index = np.unique(half, return_inverse=True)
    effective = np.array([effective_speeds(scene, x) for x in halves], int)[index]
    return Sizes(num_taps, dft_length, counts, lit, still, nodes, aside, effective)


def _by_whole(values: np.ndarray, plan: Callable[[float], Plan]) -> tuple[list[Plan], np.ndarray]:
    """Plans of the whole numbers above some, and which of them belongs to each."""
    whole, index = np.unique(np.ceil(values), return_inverse=True)
    return [plan(float(x)) for x in whole], index


def _each(plans: tuple[list[Plan], np.ndarray], name: str) -> np.ndarray:
    return np.array([getattr(plan, name) for plan in plans[0]], int)[plans[1]]


def shapes_of(each: Sequence[Sizes]) -> Shapes:
    """Shapes that hold designs of some sizes; of none at all, the smallest."""
    lengths = {1024, *(int(x) for sizes in each for x in np.unique(sizes.dft_length))}
    still = max((int(x) for sizes in each for x in sizes.num_still_taps), default=1)
    nodes = {BLOCK, *(int(x) for sizes in each for x in _whole_blocks(np.unique(sizes.num_nodes)))}
    return Shapes(tuple(sorted(lengths)), still, tuple(sorted(nodes)))


def _whole_blocks(count: np.ndarray) -> np.ndarray:
    return -(-count // BLOCK) * BLOCK


def scenes_for(scenes: Sequence[Scene], shutter: AbstractShutter, *, skips: bool) -> list[Scene]:
    """Scenes with only the speeds that a shutter asks for, as many in each, and no tolerances.

    Each keeps the background that it was seen before, and whether its speeds are folded.
    """
    scenes = [without_tolerances(scene) for scene in scenes]
    folds = [folds_speeds(scene, scene.fullest_motion, shutter) for scene in scenes]
    plans = [Plan(1, 1, 16, 1, skips=skips, folds=each) for each in folds]
    needed = [reduced(scene, plan) for scene, plan in zip(scenes, plans, strict=True)]
    most = max(scene.speeds.size for scene in needed)
    spare = [(0, most - scene.speeds.size) for scene in needed]
    return [
        with_occlusion(
            scene.bare(np.pad(after.speeds, pad, "edge"), np.pad(after.weights, pad)),
            after.occlusion,
        )
        for scene, after, pad in zip(scenes, needed, spare, strict=True)
    ]


def _on_grid(scene: Scene, num_frequencies: int, num_effective_speeds: int) -> Scene:
    """What `scenes_for` makes of a scene, with its power and layers on a grid of frequencies."""
    shares = None if scene.occlusion is None else scene.occlusion.shares
    folds = shares is not None and shares.folds
    plan = Plan(1, 1, num_frequencies, 1, num_effective_speeds=num_effective_speeds, folds=folds)
    return reduced(scene, plan)


def rules_of(shutters: Sequence[AbstractShutter], shapes: Shapes, dtype: np.dtype) -> Rules:
    """Rules of shutters that differ in their parameters alone, not in their breakpoints."""
    profiles = jax.tree.map(
        lambda *x: np.stack([np.asarray(each) for each in x]), *map(piecewise, shutters)
    )
    found = _rules(profiles, len(shutters), shapes.node_counts, dtype)
    lit = [np.flatnonzero(np.any(np.asarray(rule.weight) != 0, axis=0)) for rule in found]
    blocks = np.array([-(-(x[-1] + 1) // BLOCK) if x.size else 0 for x in lit], np.int32)
    length = max(1, int(blocks.max())) * BLOCK

    def whole(part: Array) -> np.ndarray:
        rows = np.asarray(part)[:, :length]
        return np.pad(rows, ((0, 0), (0, length - rows.shape[1])))

    tau, light = (np.stack([whole(rule[part]) for rule in found]) for part in (0, 1))
    return Rules(
        jnp.asarray(tau[:, 0]), jnp.asarray(light), jnp.asarray(blocks), found[0].efficiency
    )


@compiled
def _rules(
    profiles: Any, num_profiles: int, node_counts: tuple[int, ...], dtype: np.dtype
) -> list[ExposureQuadrature]:
    rules = [partial(exposure_quadrature, num_nodes=count, dtype=dtype) for count in node_counts]
    return [jax.vmap(rule, axis_size=num_profiles)(profiles) for rule in rules]


def measure(
    scene: Scene,
    motions: AbstractMotion,
    shutter: AbstractShutter,
    rules: Rules,
    shapes: Shapes,
    sizes: Sizes,
    *,
    metrics: Sequence[str],
    light: LightLevels,
    boxes: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Some of the `Metrics` of a shutter, or of one a design, on `n` motions; by name.

    Args:
        scene: What `scenes_for` makes of one.
        motions: What `motions_at` makes of theirs.
        shutter: The shutter.
        rules: Its rules; of its coordinates where each design has its own.
        shapes: Sizes that hold all designs.
        sizes: Sizes that each design asks for.
        metrics: Which are wanted. PSNRs have the shape `(n, p, r)`, others `(n,)`.
        light: Light and noise that each design is measured in.
        boxes: Coordinates of each design's own shutter, shape `(n, k)`, where the rules are of
            `k + 1`: of a closed one and of each coordinate open; None for one shutter.
    """
    dtype, count = np.dtype(rules.tau.dtype), sizes.num_taps.size
    shares = np.ones((count, 1), dtype)
    if boxes is not None:  # a device may leak light through what is closed
        shares = np.column_stack([1 - boxes.sum(axis=1), boxes]).astype(dtype)
    found = {"efficiency": shares.astype(float) @ np.asarray(rules.efficiency, float)}
    need = _need_of(sizes, shapes, motions, dtype, bool(set(metrics) & set(KERNEL_METRICS[1:])))
    each = motions, need, shares
    of_kernels = tuple(name for name in metrics if name in KERNEL_METRICS)
    of_picture = tuple(name for name in metrics if name in SPECTRUM_METRICS)
    if of_kernels:
        whole = with_occlusion(scene, None)
        kernels = partial(_kernel_numbers, shutter, boxes is not None, whole, shapes, of_kernels)
        found |= _by_parts(kernels, each, np.arange(count))
    if of_picture:
        levels = LightLevels(*(jnp.asarray(x, dtype) for x in light))
        counts = np.stack([sizes.num_frequencies, sizes.num_effective_speeds], axis=1)
        for count_of_each in np.unique(counts, axis=0):
            number, effective = map(int, count_of_each)
            seen = _on_grid(scene, number, effective)
            picture = partial(_picture_numbers, rules, seen, levels, number, of_picture)
            index = np.flatnonzero(np.all(counts == count_of_each, axis=1))
            for name, values in _by_parts(picture, each, index).items():
                whole = found.setdefault(name, np.zeros((count, *values.shape[1:]), dtype))
                whole[index] = values
    return found


def _by_parts(function: Callable[..., Any], each: Any, index: np.ndarray) -> Any:
    """A function of some designs, by calls of equal size that are dealt to all devices."""
    devices = jax.devices()
    starts = range(0, index.size, _DESIGNS_A_CALL)

    def part(number: int) -> Any:
        some = index[starts[number] : starts[number] + _DESIGNS_A_CALL]
        filled = np.resize(some, _DESIGNS_A_CALL)
        chosen = jax.tree.map(lambda x: np.asarray(x)[filled], each)
        with jax.default_device(devices[number % len(devices)]):
            return jax.tree.map(lambda x: np.asarray(x)[: some.size], function(chosen))

    count = len(devices) * num_threads(np.array(devices))
    parts = list(in_threads(part, range(len(starts)), count))
    return jax.tree.map(lambda *x: np.concatenate(x), *parts)


def _need_of(
    sizes: Sizes, shapes: Shapes, motions: AbstractMotion, dtype: np.dtype, moving: bool
) -> _Need:
    turns = np.asarray(has_vertex(motions))
    lit = sizes.num_lit_taps if moving else sizes.aside + sizes.num_still_taps
    numbers = (
        -(-lit // _TAPS),
        np.where(turns, 0.0, -0.5 - sizes.aside),
        sizes.aside // _TAPS,
        np.searchsorted(shapes.dft_lengths, sizes.dft_length),
        np.searchsorted(shapes.node_counts, _whole_blocks(sizes.num_nodes)),
    )
    kinds = (np.int32, dtype, np.int32, np.int32, np.int32)
    return _Need(*(x.astype(kind) for x, kind in zip(numbers, kinds, strict=True)))


@compiled
def _kernel_numbers(
    shutter: AbstractShutter,
    is_own: bool,
    scene: Scene,
    shapes: Shapes,
    metrics: tuple[str, ...],
    each: Any,
) -> dict[str, Array]:
    """Metrics of kernels."""

    def of_design(design: tuple[AbstractMotion, _Need, Array]) -> dict[str, Array]:
        motion, need, box = design
        own = shutter.at(box[1:]) if is_own else shutter  # type: ignore[attr-defined]
        profile = transmittance(scene, motion, own)
        speeds = scene.speeds if set(metrics) & set(KERNEL_METRICS[1:]) else scene.speeds[:0]
        speeds = jnp.append(jnp.zeros(1, box.dtype), speeds.astype(box.dtype))
        plan = Plan(_TAPS, _TAPS, 1, 1)

        def add(block: Array, sums: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            first = need.first + (block * _TAPS).astype(box.dtype)
            kernels, light = kernels_and_light(profile, motion, speeds, first, _TAPS, 1)
            some = assembled(scene, Records(kernels, jnp.zeros(0), light), plan)
            # A block without light of an object at rest goes to the room that is left for it.
            start = ((block - need.still_block) * _TAPS,)
            taps = jax.lax.dynamic_update_slice(sums[2], some.still_kernel, start)
            squares = (jnp.sum(x**2) for x in (some.differences, some.still_kernel))
            return *map(jnp.add, sums[:2], squares), taps  # type: ignore[return-value]

        room = (-(-shapes.still_taps // _TAPS) + 1) * _TAPS
        nothing = jnp.zeros((), box.dtype), jnp.zeros((), box.dtype), jnp.zeros(room, box.dtype)
        difference, still, taps = jax.lax.fori_loop(0, need.num_blocks, add, nothing)
        branches = [partial(_condition, length=length) for length in shapes.dft_lengths]
        raw, relative = differences_from(scene, motion, difference, still)
        numbers = jax.lax.switch(need.dft, branches, taps), raw, relative
        known: dict[str, Array] = dict(zip(KERNEL_METRICS, numbers, strict=True))
        return {name: known[name] for name in metrics}

    return jax.lax.map(of_design, each)


def _condition(kernel: Array, length: int) -> Array:
    """Condition number of a kernel that has light on as many taps at most."""
    return condition_number(kernel[:length], num_frequencies=length)


@compiled
def _picture_numbers(
    rules: Rules,
    scene: Scene,
    light: LightLevels,
    num_frequencies: int,
    metrics: tuple[str, ...],
    each: Any,
) -> dict[str, Array]:
    """Metrics of transfer functions."""
    each_pair = jnp.meshgrid(light.photon_rates, light.read_noises, indexing="ij")
    rates, noises = (x.ravel() for x in each_pair)

    def of_design(design: tuple[AbstractMotion, _Need, Array]) -> dict[str, Array]:
        motion, need, box = design
        efficiency, at = box @ rules.efficiency, need.rule
        nodes = ExposureQuadrature(rules.tau[at], box @ rules.light[at], efficiency)
        spectra = aligned_spectra(
            nodes,
            motion,
            computed_speeds(scene),
            num_frequencies,
            num_blocks=rules.num_blocks[at],
        )
        nothing = jnp.zeros(0, box.dtype)
        response = Response(nothing, nothing, nothing, spectra, efficiency)

        def psnr(pair: tuple[Array, Array]) -> dict[str, Array]:
            lit = eqx.tree_at(lambda s: (s.photon_rate, s.read_noise), scene, pair)
            wanted = {name: ERRORS_BY_LIGHT[name] for name in metrics if name in ERRORS_BY_LIGHT}
            errors = {name: error(lit, motion, response) for name, error in wanted.items()}
            return {name: -10 * jnp.log10(error) for name, error in errors.items()}

        shape = light.photon_rates.size, light.read_noises.size
        levels = jax.lax.map(psnr, (rates, noises))
        found = {name: level.reshape(shape) for name, level in levels.items()}
        if "bound_share" in metrics:
            found["bound_share"] = bound_share(scene, motion, response)
        return found

    return jax.lax.map(of_design, each)
