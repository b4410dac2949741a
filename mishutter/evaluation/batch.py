"""Metrics of many designs, by the formulas of `evaluate`, each at the sizes that it needs.

One compiled loop goes from design to design. The numbers of taps and nodes of a design are inputs
of the program, so that one program serves all designs, each at its own cost.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from mishutter._core.compiling import compiled
from mishutter._core.parallel import in_threads, num_threads
from mishutter.blur.quadrature import ExposureQuadrature, exposure_quadrature
from mishutter.blur.spectrum import condition_number
from mishutter.blur.waves import BLOCK
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.metrics import Evaluation, KernelSums, named_metrics
from mishutter.evaluation.needs import (
    Extent,
    Plan,
    effective_speeds,
    folds_speeds,
    longest_within_limits,
    num_frequencies,
    reduced,
)
from mishutter.evaluation.response import Records, Response, kernels_and_efficiency, spectra_of
from mishutter.evaluation.views import transmittance
from mishutter.model.devices import least_efficiency
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractShutter, piecewise

_TAPS = 64
"""Taps of a block."""
_DESIGNS_A_CALL = 64
"""Fixed batch size: one compiled program for any number of devices."""


class Sizes(NamedTuple):
    """Sizes that `evaluate` would use for each design, and the smallest sufficient ones."""

    num_taps: Int[np.ndarray, "n"]  # Taps of the kernels
    dft_length: Int[np.ndarray, "n"]  # Points of the DFT of the condition number
    num_frequencies: Int[np.ndarray, "n"]  # Frequencies of the expected error
    num_reached_taps: Int[np.ndarray, "n"]  # Taps that light of the fastest object may fall on
    num_still_taps: Int[np.ndarray, "n"]  # Taps that light of an object at rest may fall on
    num_nodes: Int[np.ndarray, "n"]  # Nodes over the exposure
    aside: Int[np.ndarray, "n"]  # Whole taps before that of an object at rest; 0 if moving
    # Effective speeds of two layers; 0 for a picture that moves as a whole
    num_effective_speeds: Int[np.ndarray, "n"]
    num_frequencies_within: Int[np.ndarray, "n"]  # Frequencies within the tolerances
    num_nodes_within: Int[np.ndarray, "n"]  # Nodes over the exposure for these

    @property
    def within_tolerances(self) -> "Sizes":
        """The sizes of transfer functions within the scene's tolerances."""
        return self._replace(
            num_frequencies=self.num_frequencies_within, num_nodes=self.num_nodes_within
        )

    @staticmethod
    def of(scene: Scene, motions: AbstractMotion) -> "Sizes":
        """Sizes of a scene on many motions."""
        longest, turns = longest_within_limits(scene), np.asarray(motions.has_vertex)
        half = np.asarray(motions.half_exposure, np.float64)
        a = np.asarray(motions.mean_acceleration, np.float64)
        sag = np.where(turns, a * half * half, 0.0)
        smear = np.asarray(scene.max_speed, np.float64) * half
        travel, within = Extent.of(scene, motions), Extent.within_tolerances(scene, motions)
        # Every kernel beyond this length is refused.
        reach_of_plan = np.minimum(np.maximum(travel.reach, longest), 1 << 17)
        num_taps = _of_whole(reach_of_plan, lambda x: Plan.of_travel(x, 0.0).num_taps)
        aside = np.minimum(np.ceil(smear), num_taps // 2)
        aside = np.where(turns, 0, aside).astype(int)
        num_reached = np.where(turns, np.ceil(travel.reach) + 1, 2 * aside + 1)
        halves, index = np.unique(half, return_inverse=True)
        return Sizes(
            num_taps=num_taps,
            dft_length=_of_whole(reach_of_plan, lambda x: Plan.of_travel(x, 0.0).dft_length),
            num_frequencies=num_frequencies(scene, travel.spread),
            num_reached_taps=np.minimum(num_reached, num_taps).astype(int),
            num_still_taps=np.minimum(np.ceil(sag) + 1, num_taps).astype(int),
            num_nodes=_of_whole(travel.velocity, lambda x: Plan.of_travel(0.0, x).num_nodes),
            aside=aside,
            num_effective_speeds=np.array([effective_speeds(scene, x) for x in halves], int)[index],
            num_frequencies_within=num_frequencies(scene, within.spread),
            num_nodes_within=_of_whole(within.velocity, lambda x: Plan.of_travel(0.0, x).num_nodes),
        )


def _of_whole(values: Float[np.ndarray, "n"], size: Callable[[float], int]) -> Int[np.ndarray, "n"]:
    """The size for each of some values, rounded up to whole numbers."""
    whole, index = np.unique(np.ceil(values), return_inverse=True)
    return np.array([size(float(x)) for x in whole], int)[index]


class Shapes(NamedTuple):
    """Sizes that all designs of a batch share; static."""

    dft_lengths: tuple[int, ...]  # Lengths that the condition number may be taken over
    still_taps: int  # Taps of the longest kernel of an object at rest
    node_counts: tuple[int, ...]  # Numbers of nodes of the quadrature rules, about, ascending

    @staticmethod
    def of(each: Sequence[Sizes]) -> "Shapes":
        """Shapes that hold designs of some sizes; the smallest shapes without any design."""
        lengths = {1024, *(int(x) for sizes in each for x in np.unique(sizes.dft_length))}
        still = max((int(x) for sizes in each for x in sizes.num_still_taps), default=1)
        counts = [np.append(sizes.num_nodes, sizes.num_nodes_within) for sizes in each]
        nodes = [_whole_blocks(np.unique(count)) for count in counts]
        node_counts = {BLOCK, *(int(x) for count in nodes for x in count)}
        return Shapes(tuple(sorted(lengths)), still, tuple(sorted(node_counts)))


class Rules(NamedTuple):
    """Quadrature rules of rising numbers of nodes, for the shutters that designs are mixed of."""

    tau: Float[Array, "r q"]  # Normalised times; shape `(r, q)`
    weight: Float[Array, "r k q"]  # Weights with the transmittance of each of `k` shutters
    num_blocks: Int[Array, "r"]  # Blocks of nodes with weight; shape `(r,)`
    efficiency: Float[Array, "k"]  # Mean transmittance of each shutter; shape `(k,)`

    @staticmethod
    def of(shutters: Sequence[AbstractShutter], shapes: Shapes, dtype: np.dtype) -> "Rules":
        """Rules of shutters that differ in their parameters alone, not in their breakpoints."""
        profiles = jax.tree.map(
            lambda *x: np.stack([np.asarray(each) for each in x]), *map(piecewise, shutters)
        )
        rules = _rules(profiles, len(shutters), shapes.node_counts, dtype)
        nonzero = [np.flatnonzero(np.any(np.asarray(rule.weight) != 0, axis=0)) for rule in rules]
        blocks = np.array([-(-(x[-1] + 1) // BLOCK) if x.size else 0 for x in nonzero], np.int32)
        length = max(1, int(blocks.max())) * BLOCK

        def whole(part: Float[Array, "k q"]) -> Float[np.ndarray, "k n"]:
            rows = np.asarray(part)[:, :length]
            return np.pad(rows, ((0, 0), (0, length - rows.shape[1])))

        tau = np.stack([whole(rule.tau)[0] for rule in rules])
        weight = np.stack([whole(rule.weight) for rule in rules])
        return Rules(
            jnp.asarray(tau), jnp.asarray(weight), jnp.asarray(blocks), rules[0].efficiency
        )


class _Need(NamedTuple):
    """Numbers of a design that the loops need; of many designs on a leading axis."""

    num_blocks: Int[Array | np.ndarray, "*n"]  # Number of blocks of taps
    first: Float[Array | np.ndarray, "*n"]  # Offset of the first tap's edge from alignment, px
    still_block: Int[Array | np.ndarray, "*n"]  # Block in which light of an object at rest begins
    dft: Int[Array | np.ndarray, "*n"]  # Index of its length among `Shapes.dft_lengths`
    rule: Int[Array | np.ndarray, "*n"]  # Index of its quadrature rule

    @staticmethod
    def of(
        sizes: Sizes, shapes: Shapes, motions: AbstractMotion, dtype: np.dtype, *, moving: bool
    ) -> "_Need":
        """Those for kernels of moving objects or of one at rest alone."""
        turns = np.asarray(motions.has_vertex)
        num_taps = sizes.num_reached_taps if moving else sizes.aside + sizes.num_still_taps
        dft = np.searchsorted(shapes.dft_lengths, sizes.dft_length)
        rule = np.searchsorted(shapes.node_counts, _whole_blocks(sizes.num_nodes))
        return _Need(
            num_blocks=(-(-num_taps // _TAPS)).astype(np.int32),
            first=np.where(turns, 0.0, -0.5 - sizes.aside).astype(dtype),
            still_block=(sizes.aside // _TAPS).astype(np.int32),
            dft=dft.astype(np.int32),
            rule=rule.astype(np.int32),
        )


class _Designs(NamedTuple):
    """One design, or many on a leading axis."""

    motion: AbstractMotion  # Motion of the sensor
    need: _Need  # Numbers that the loops need
    shares: Float[Array | np.ndarray, "*n k"]  # Shares of the shutters of the `Rules` in its own
    efficiency: Float[Array | np.ndarray, "*n"]  # Throughput of the design

    def by_parts(
        self, function: Callable[["_Designs"], dict[str, Array]], index: Int[np.ndarray, "n"]
    ) -> dict[str, np.ndarray]:
        """A function of some designs, by calls of equal size that are dealt to all devices."""
        devices = jax.devices()
        starts = range(0, index.size, _DESIGNS_A_CALL)

        def part(number: int) -> dict[str, np.ndarray]:
            some = index[starts[number] : starts[number] + _DESIGNS_A_CALL]
            filled = np.resize(some, _DESIGNS_A_CALL)
            own = jax.tree.map(lambda x: np.asarray(x)[filled], self)
            with jax.default_device(devices[number % len(devices)]):
                return {name: np.asarray(x)[: some.size] for name, x in function(own).items()}

        count = len(devices) * num_threads(np.array(devices))
        parts = list(in_threads(part, range(len(starts)), count))
        return {name: np.concatenate([each[name] for each in parts]) for name in parts[0]}


def _whole_blocks(count: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    return -(-count // BLOCK) * BLOCK


def scenes_for(scenes: Sequence[Scene], shutter: AbstractShutter) -> list[Scene]:
    """Scenes with backgrounds and only the speeds that a shutter asks for, as many in each."""
    folds = [folds_speeds(scene, scene.fullest_motion, shutter) for scene in scenes]
    plans = [Plan(1, 1, 16, 1, skips=True, folds=each) for each in folds]
    needed = [reduced(scene, plan) for scene, plan in zip(scenes, plans, strict=True)]
    most = max(scene.speeds.size for scene in needed)
    spare = [(0, most - scene.speeds.size) for scene in needed]
    return [
        scene.without_metadata(
            np.pad(after.speeds, pad, "edge"), np.pad(after.weights, pad)
        ).with_occlusion(after.occlusion)
        for scene, after, pad in zip(scenes, needed, spare, strict=True)
    ]


@compiled
def _rules(
    profiles: AbstractShutter, num_profiles: int, node_counts: tuple[int, ...], dtype: np.dtype
) -> list[ExposureQuadrature]:
    """Rules of stacked profiles, one for each number of nodes."""
    rules = [partial(exposure_quadrature, num_nodes=count, dtype=dtype) for count in node_counts]
    return [jax.vmap(rule, axis_size=num_profiles)(profiles) for rule in rules]


def measure(
    scene: Scene,
    motions: AbstractMotion,
    shutter: AbstractShutter,
    rules: Rules,
    *,
    shapes: Shapes,
    sizes: Sizes,
    metrics: Sequence[str],
    levels: Sequence[Float[Array | np.ndarray, "_"]],  # Photon rates, e-/s, and read noises, e-
    boxes: Float[np.ndarray, "n k"] | None = None,
) -> dict[str, np.ndarray]:
    """Some of the `Metrics` of a shutter, or of one for each design, on `n` motions; by name."""
    dtype, count = np.dtype(rules.tau.dtype), sizes.num_taps.size
    chosen = named_metrics(metrics)
    shares = np.ones((count, 1), dtype)
    if boxes is not None:  # a device may leak light through a closed shutter
        shares = np.column_stack([1 - boxes.sum(axis=1), boxes]).astype(dtype)
    efficiency, brightness = shares.astype(float) @ np.asarray(rules.efficiency, float), np.ones(1)
    if boxes is not None and scene.device is not None:  # a profile that stays open needs none
        most = float(scene.device.transmission)
        is_open = efficiency >= most * least_efficiency(dtype)
        brightness = np.where(is_open, 1 / most, 1.0)
    efficiency = efficiency * brightness
    values = {"efficiency": efficiency}
    moving = any(metric.parts.differences for metric in chosen)
    need = _Need.of(sizes, shapes, motions, dtype, moving=moving)
    designs = _Designs(motions, need, shares, efficiency.astype(dtype))
    pictured = designs._replace(shares=shares * brightness[:, None].astype(dtype))
    designed = without_tolerances(scene)
    of_kernels = tuple(metric.name for metric in chosen if metric.parts.kernels)
    if of_kernels:
        kernels = partial(
            _kernel_numbers,
            shutter=shutter,
            is_own=boxes is not None,
            scene=designed.with_occlusion(None),
            shapes=shapes,
            metrics=of_kernels,
        )
        values |= designs.by_parts(kernels, np.arange(count))
    levels = [jnp.asarray(x, dtype) for x in levels]
    in_groups = partial(_of_picture, designs=pictured, rules=rules, shapes=shapes, levels=levels)
    of_picture = [metric for metric in chosen if metric.parts.spectra or metric.sees_light]
    names = tuple(metric.name for metric in of_picture if not metric.within_tolerances)
    if names:
        values |= in_groups(designed, sizes, metrics=names)
    names = tuple(metric.name for metric in of_picture if metric.within_tolerances)
    if names and scene.tolerances is None:
        shape = count, *(x.size for x in levels)
        values |= {name: np.full(shape, np.nan, dtype) for name in names}
    elif names:
        values |= in_groups(scene, sizes.within_tolerances, metrics=names)
    return values


def _of_picture(
    scene: Scene,
    sizes: Sizes,
    *,
    designs: _Designs,
    rules: Rules,
    shapes: Shapes,
    levels: Sequence[Float[Array | np.ndarray, "_"]],
    metrics: tuple[str, ...],
) -> dict[str, np.ndarray]:
    """Metrics of transfer functions of designs, by groups of equal sizes."""
    dtype = np.dtype(rules.tau.dtype)
    designs = designs._replace(need=_Need.of(sizes, shapes, designs.motion, dtype, moving=False))
    shares = None if scene.occlusion is None else scene.occlusion.shares
    folds = shares is not None and shares.folds
    counts = np.stack([sizes.num_frequencies, sizes.num_effective_speeds], axis=1)
    values: dict[str, np.ndarray] = {}
    for count_of_each in np.unique(counts, axis=0):
        number, effective = map(int, count_of_each)
        grid = Plan(1, 1, number, 1, num_effective_speeds=effective, folds=folds)
        picture = partial(
            _picture_numbers,
            rules=rules,
            scene=reduced(scene, grid),
            levels=levels,
            num_frequencies=number,
            metrics=metrics,
        )
        index = np.flatnonzero(np.all(counts == count_of_each, axis=1))
        for name, part in designs.by_parts(picture, index).items():
            whole = values.setdefault(name, np.zeros((len(counts), *part.shape[1:]), part.dtype))
            whole[index] = part
    return values


@compiled
def _kernel_numbers(
    designs: _Designs,
    *,
    shutter: AbstractShutter,
    is_own: bool,
    scene: Scene,
    shapes: Shapes,
    metrics: tuple[str, ...],
) -> dict[str, Array]:
    """Metrics of kernels by the sums of their blocks: two of squares, and the kernel at rest."""
    chosen = named_metrics(metrics)
    moving = any(metric.parts.differences for metric in chosen)

    def of_design(design: _Designs) -> dict[str, Array]:
        motion, need, box = design.motion, design.need, jnp.asarray(design.shares)
        own = shutter.at(box[1:]) if is_own else shutter  # type: ignore[attr-defined]
        profile = transmittance(scene, motion, own)
        speeds = scene.speeds if moving else scene.speeds[:0]
        speeds = jnp.append(jnp.zeros(1, box.dtype), speeds.astype(box.dtype))
        plan = Plan(_TAPS, _TAPS, 1, 1)

        def add(block: Int[Array, ""], sums: tuple[Array, ...]) -> tuple[Array, ...]:
            difference, still, taps = sums
            first = need.first + (block * _TAPS).astype(box.dtype)
            kernels, efficiency = kernels_and_efficiency(
                profile, motion, speeds, first, num_taps=_TAPS
            )
            some = Records(kernels, jnp.zeros(0), efficiency).response(scene, plan)
            # A block without light of an object at rest goes to the room behind its kernel.
            start = ((block - need.still_block) * _TAPS,)
            taps = jax.lax.dynamic_update_slice(taps, some.still_kernel, start)
            return difference + some.squares[0], still + some.squares[1], taps

        room = (-(-shapes.still_taps // _TAPS) + 1) * _TAPS
        zero = jnp.zeros((), box.dtype)
        nothing = zero, zero, jnp.zeros(room, box.dtype)
        difference, still, taps = jax.lax.fori_loop(0, need.num_blocks, add, nothing)
        # No kernel has more taps before its zeros than its DFT has points.
        branches = [
            lambda taps, length=length: condition_number(taps[:length], num_frequencies=length)
            for length in shapes.dft_lengths
        ]
        kernels = KernelSums(difference, still, jax.lax.switch(need.dft, branches, taps))
        empty = jnp.zeros(0, box.dtype)
        response = Response(empty, empty, empty, empty, jnp.asarray(design.efficiency))
        evaluation = Evaluation(scene, motion, response, kernels)
        return {metric.name: metric.formula(evaluation) for metric in chosen}

    return jax.lax.map(of_design, designs)


@compiled
def _picture_numbers(
    designs: _Designs,
    *,
    rules: Rules,
    scene: Scene,
    levels: Sequence[Float[Array | np.ndarray, "_"]],
    num_frequencies: int,
    metrics: tuple[str, ...],
) -> dict[str, Array]:
    """Metrics of transfer functions."""
    chosen = named_metrics(metrics)
    each_pair = jnp.meshgrid(*levels, indexing="ij")
    rates, noises = (x.ravel() for x in each_pair)

    def of_design(design: _Designs) -> dict[str, Array]:
        motion, at, box = design.motion, design.need.rule, jnp.asarray(design.shares)
        efficiency = box @ rules.efficiency
        nodes = ExposureQuadrature(rules.tau[at], box @ rules.weight[at], efficiency)
        spectra = spectra_of(scene, nodes, motion, num_frequencies, num_blocks=rules.num_blocks[at])
        nothing = jnp.zeros(0, box.dtype)
        response = Response(nothing, nothing, nothing, spectra, efficiency)

        def of_light(pair: tuple[Float[Array, ""], Float[Array, ""]]) -> dict[str, Array]:
            own = eqx.tree_at(lambda s: (s.photon_rate, s.read_noise), scene, pair)
            evaluation = Evaluation(own, motion, response)
            return {m.name: m.formula(evaluation) for m in chosen if m.sees_light}

        by_level = jax.lax.map(of_light, (rates, noises))
        shape = each_pair[0].shape
        values = {name: level.reshape(shape) for name, level in by_level.items()}
        evaluation = Evaluation(scene, motion, response)
        return values | {m.name: m.formula(evaluation) for m in chosen if not m.sees_light}

    return jax.lax.map(of_design, designs)
