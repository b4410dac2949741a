"""One block of a sweep: the best profile at each point if asked for, then all metrics."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from operator import itemgetter
from typing import NamedTuple, cast, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from mishutter._core.parallel import in_threads, num_threads
from mishutter.evaluation.batch import Rules, Shapes, Sizes, measure, scenes_for
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.metrics import METRICS, named_metrics
from mishutter.evaluation.needs import ONLY_SPECTRA, Parts, automatic
from mishutter.evaluation.views import transmittance
from mishutter.model.motion import ParabolicMotion
from mishutter.model.scene import Scene
from mishutter.model.sensor import white_electrons
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.spline import SplineShutter
from mishutter.search.search import SearchSettings, Start, best_design
from mishutter.sweeps.grid import MARKS, OPTIMISED, REASONS, Block, Grid, Search, outside_limits

Arrays = dict[str, np.ndarray]
Found = Callable[[Block, int, str], None]
"""A function that is called with a block, the points of it that are done, and what comes next."""


class PreparedShutter(NamedTuple):
    """A shutter ready to be measured."""

    shutter: AbstractShutter  # The shutter, or one of the kind of which each point has its own
    coordinates: Sequence[AbstractShutter]  # The shutter, or those whose sums are the points' own
    # Rules of quadrature behind the device; None where they depend on the exposure
    rules: Rules | None
    scenes: list[Scene]  # Scenes of each frame with the speeds that the shutter needs


@final
class Engine:
    """Arrays and sizes that the blocks of a grid share."""

    def __init__(self, grid: Grid):
        self.grid = grid
        self.metrics = named_metrics(grid.metrics)
        self.scenes = [frame.sensor_scene for frame in grid.frames]
        within = any(metric.within_tolerances for metric in self.metrics)
        self.measured = self.scenes if within else [*map(without_tolerances, self.scenes)]
        self.outside = [
            outside_limits(frame, grid.accelerations, grid.half_exposures) for frame in grid.frames
        ]
        self.sizes = [*map(self._sizes, self.measured, self.outside)]
        self.shapes = Shapes.of(self.sizes)
        self.shutters = [self._prepared(shutter, [shutter]) for shutter in grid.shutters.values()]
        profiles = () if grid.search is None else grid.search.profiles
        kinds = {profile.symmetric: profile for profile in profiles}
        self.bases = {}
        for kind, profile in kinds.items():
            # The basis of a kind of profile: a closed one, then each coordinate alone open.
            size = profile.parameters.size
            corners = np.eye(size + 1, size, -1, dtype=profile.parameters.dtype)
            basis = [profile.at(jax.device_put(corner)) for corner in corners]
            self.bases[kind] = self._prepared(profile, basis)

    def _sizes(self, scene: Scene, outside: np.ndarray) -> Sizes:
        """Sizes of the points within limits; marks in `outside` those that are too large."""
        grid = self.grid
        rows, columns = np.nonzero(outside == 0)
        sizes = Sizes.of(scene, self._motions(rows, columns))
        searched = [] if grid.search is None else [ONLY_SPECTRA]
        parts = Parts.of_all([*searched, *(metric.parts for metric in self.metrics)])
        num_frequencies = np.maximum(sizes.num_frequencies, sizes.num_frequencies_within)
        is_too_long = parts.refuse(sizes.num_taps, num_frequencies)
        outside[rows[is_too_long], columns[is_too_long]] = _mark("blur_too_long")
        return Sizes(*(size[~is_too_long] for size in sizes))

    def _motions(self, rows: np.ndarray, columns: np.ndarray) -> ParabolicMotion:
        """The motions of some points, without velocity; their numbers have a leading axis."""
        accelerations = self.grid.accelerations[rows].astype(self.grid.dtype)
        half_exposures = self.grid.half_exposures[columns].astype(self.grid.dtype)
        one = ParabolicMotion(acceleration=0.0, half_exposure=1.0)
        numbers = accelerations, half_exposures, np.zeros_like(half_exposures)
        return eqx.tree_at(lambda m: (m.acceleration, m.half_exposure, m.velocity), one, numbers)

    def _prepared(
        self, shutter: AbstractShutter, coordinates: Sequence[AbstractShutter]
    ) -> PreparedShutter:
        scenes = scenes_for(self.measured, shutter)
        device = self.scenes[0].device
        lags = device is not None and device.lags
        rules = None if lags else self._rules(coordinates, self.grid.half_exposures[-1])
        return PreparedShutter(shutter, coordinates, rules, scenes)

    def _rules(self, coordinates: Sequence[AbstractShutter], half_exposure: np.floating) -> Rules:
        """Rules of quadrature of some profiles behind the device."""
        scene = self.scenes[0]
        shutters = [transmittance(scene, half_exposure, each) for each in coordinates]
        return Rules.of(shutters, self.shapes, self.grid.dtype)

    def _rules_at(
        self, prepared: PreparedShutter, half_exposures: np.ndarray
    ) -> Iterator[tuple[np.ndarray | slice, Rules]]:
        """Points that share rules of quadrature, and these."""
        if prepared.rules is not None:
            yield slice(None), prepared.rules
            return
        for half in np.unique(half_exposures):
            yield np.flatnonzero(half_exposures == half), self._rules(prepared.coordinates, half)

    def computed(
        self, blocks: Iterable[Block], found: Found = lambda block, points, name: None
    ) -> Iterator[Arrays]:
        """The variables of blocks, in order; with a search some blocks at a time.

        Args:
            blocks: The blocks.
            found: Called before each shutter that is measured and at each point of a search, with
                the block, its points that are done, and the name of the shutter.
        """
        count = num_threads(np.array(jax.devices())) if self.bases else 1
        return in_threads(partial(self.compute, found=found), blocks, count)

    def compute(self, block: Block, found: Found = lambda block, points, name: None) -> Arrays:
        """Every variable of a block, NaN outside the limits; axes of frames left out."""
        grid, at = self.grid, self.grid.place(block)
        everywhere = self.outside[block.frame]
        inside = everywhere[at] == 0
        rows, columns = np.nonzero(inside)
        motions = self._motions(rows + at[0].start, columns + at[1].start)
        chosen = np.zeros(everywhere.shape, bool)
        chosen[at] = inside
        sizes = Sizes(*(x[chosen[everywhere == 0]] for x in self.sizes[block.frame]))
        arrays = {
            name: _placed(getattr(sizes, name), inside) for name in ("num_taps", "dft_length")
        }
        arrays["outside"] = everywhere[at]
        metrics, num_points = [], grid.num_points([block])
        for name, prepared in zip(grid.shutters, self.shutters, strict=True):
            # A point that is searched takes most of its time then.
            share = len(metrics) / len(self.shutters) if grid.search is None else 0.0
            found(block, int(num_points * share), name)
            metrics.append(self._measured(prepared, block.frame, motions, sizes))
        if grid.search is not None:
            scene, profile = self.scenes[block.frame], grid.search.profiles[block.frame]
            boxes, best = _best_profiles(
                grid.search, scene, motions, profile, lambda points: found(block, points, OPTIMISED)
            )
            arrays |= {name: _placed(values, inside) for name, values in best.items()}
            basis = self.bases[profile.symmetric]
            metrics.append(self._measured(basis, block.frame, motions, sizes, boxes))
        for name in grid.metrics:
            arrays[name] = _placed(np.stack([x[name] for x in metrics], axis=1), inside)
        if grid.full_well is not None:
            efficiency = np.stack([x["efficiency"] for x in metrics], axis=1)
            self._overflow(arrays, _placed(efficiency, inside), block, grid.full_well)
        return {key: arrays[key].astype(dtype) for key, dtype in grid.variables.items()}

    def _measured(
        self,
        prepared: PreparedShutter,
        frame: int,
        motions: ParabolicMotion,
        sizes: Sizes,
        boxes: np.ndarray | None = None,
    ) -> Arrays:
        """Metrics of a prepared shutter at some points, by name."""
        grid, scene = self.grid, prepared.scenes[frame]
        rates = scene.photon_rate if grid.photon_rates is None else grid.photon_rates
        noises = scene.read_noise if grid.read_noises is None else grid.read_noises
        levels = [np.atleast_1d(np.asarray(level)) for level in (rates, noises)]
        metrics = dict.fromkeys(("efficiency", *grid.metrics), np.zeros(0))
        halves = np.asarray(motions.half_exposure)
        for index, rules in self._rules_at(prepared, halves) if halves.size else ():
            some, own_sizes, own_boxes = jax.tree.map(itemgetter(index), (motions, sizes, boxes))
            part = measure(
                scene,
                some,
                prepared.shutter,
                rules,
                shapes=self.shapes,
                sizes=own_sizes,
                metrics=grid.metrics,
                levels=levels,
                boxes=own_boxes,
            )
            for name, values in part.items():
                if not metrics[name].size:
                    metrics[name] = np.zeros((halves.size, *values.shape[1:]), values.dtype)
                metrics[name][index] = values
        axes = (grid.photon_rates, grid.read_noises)
        tail = [axis.size for axis in axes if axis is not None]
        by_light = (metric.name for metric in self.metrics if metric.sees_light)
        return metrics | {name: metrics[name].reshape(-1, *tail) for name in by_light}

    def _overflow(
        self, arrays: Arrays, efficiency: np.ndarray, block: Block, full_well: float
    ) -> None:
        """Leave out points at which white fills a pixel."""
        grid, scene = self.grid, self.scenes[block.frame]
        half = grid.half_exposures[grid.place(block)[1]]
        by_light = grid.photon_rates is not None
        own = np.array([float(scene.photon_rate)])
        rates = own if grid.photon_rates is None else grid.photon_rates
        electrons = white_electrons(rates, 2 * half[:, None, None], efficiency[..., None])
        full = electrons > full_well
        bits = np.where(full, _mark("full_well"), MARKS.type(0))
        bits = bits | arrays["outside"][:, :, None, None]
        arrays["outside"] = bits if by_light else bits[..., 0]
        for name in grid.metrics:
            if by_light and METRICS[name].sees_light:
                arrays[name][full] = np.nan
            else:
                arrays[name][np.all(full, axis=3)] = np.nan


def _best_profiles(
    settings: Search,
    scene: Scene,
    motions: ParabolicMotion,
    profile: SplineShutter,
    found: Callable[[int], None],
) -> tuple[Float[np.ndarray, "n c"], Arrays]:
    """Coordinates of the best profiles of a kind on some motions of a scene, and variables."""
    accelerations = np.asarray(motions.acceleration)
    half_exposures = np.asarray(motions.half_exposure)
    boxes = np.zeros((accelerations.size, profile.parameters.size))
    losses, converged = np.zeros(len(boxes)), np.zeros(len(boxes), bool)
    for index in range(len(boxes)):
        found(index)
        motion = ParabolicMotion(
            acceleration=accelerations[index], half_exposure=half_exposures[index]
        )
        # A plan for every motion within the limits lets points share programs.
        shared = SearchSettings(
            settings.loss,
            automatic(scene, motion, profile).coarser(),
            seed=settings.seed,
            max_steps=settings.max_steps,
        )
        design = best_design(Start(scene, motion, profile, ("shutter",)), shared)
        boxes[index] = cast(SplineShutter, design.command).parameters
        losses[index], converged[index] = design.loss, design.converged
    found(len(boxes))
    coefficients = boxes
    if profile.symmetric:
        mirrored = boxes[:, : profile.num_coefficients // 2]
        coefficients = np.concatenate([boxes, mirrored[:, ::-1]], axis=1)
    return boxes, {"coefficients": coefficients, "loss": losses, "converged": converged}


def _mark(reason: str) -> np.unsignedinteger:
    """The bit of a reason in `outside`."""
    return MARKS.type(1 << REASONS.index(reason))


def _placed(values: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Values at the points inside; elsewhere NaN, or 0 for whole numbers."""
    nothing = np.nan if values.dtype.kind == "f" else 0
    whole = np.full((*inside.shape, *values.shape[1:]), nothing, values.dtype)
    whole[inside] = values
    return whole
