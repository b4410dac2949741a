"""Labelled grids of designs over acceleration and exposure: run, store, resume."""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import Float

from mishutter._core.checks import (
    RowLike,
    named,
    require,
    require_known,
    require_positive_int,
    require_seed,
)
from mishutter._core.compiling import outside_trace
from mishutter._core.progress import counts
from mishutter.evaluation.losses import AbstractLoss, as_loss
from mishutter.evaluation.metrics import METRICS
from mishutter.evaluation.speed_knowledge import SpeedKnowledge, metrics_of
from mishutter.model.scene import Scene, require_one_axis
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.kinds import baselines
from mishutter.model.shutters.windows import TukeyShutter
from mishutter.search.search import MAX_STEPS, NUM_COEFFICIENTS, starting_shutter
from mishutter.sweeps.blocks import Engine, Found
from mishutter.sweeps.cluster import compute_remotely, connection
from mishutter.sweeps.grid import OPTIMISED, Block, Grid, Search, checked_axis, decoders_of
from mishutter.sweeps.store import Blocks, MemoryBlocks, StoredBlocks

if TYPE_CHECKING:
    import xarray

Progress = Callable[[int, int], None]
_LOG = logging.getLogger("mishutter.sweep")


@outside_trace()
def sweep(
    scenes: Scene | Sequence[object] | Mapping[str, object],
    *,
    accelerations: RowLike,
    half_exposures: RowLike,
    velocities: RowLike | None = None,
    shutters: Mapping[str, object] | None = None,
    optimise: bool = False,
    loss: AbstractLoss | Callable[..., object] | None = None,
    num_coefficients: int = NUM_COEFFICIENTS,
    max_steps: int = MAX_STEPS,
    seed: int = 0,
    metrics: str | Sequence[str] | None = None,
    photon_rates: RowLike | None = None,
    read_noises: RowLike | None = None,
    store: str | Path | None = None,
    scheduler: object = None,
    progress: Progress | bool | None = None,
) -> "xarray.Dataset":
    r"""Measure shutters at every acceleration and exposure of a grid.

    The numbers are those of `evaluate` at each point; the light follows the exposure,
    $p = \text{rate}\cdot 2T$. An acceleration of 0 is a panning camera, or one at rest,
    aligned at mid-exposure. A point outside a scene's limits is NaN, and `outside` says why.

    Args:
        scenes: One scene, or several, then a dimension of the result. They share a device and
            a full well.
        accelerations: $a$, px/s^2, at least 0, ascending; shape `(a,)`.
        half_exposures: $T$, s, above 0, ascending; shape `(t,)`.
        velocities: $v$ at mid-exposure, px/s, either sign, ascending; shape `(v,)`. By default
            each scene has one, in the middle of its speeds as far as its limits let the sensor
            pan.
        shutters: Fixed shutters by name; the baselines and a Tukey window by default.
        optimise: Whether the best profile at each point is found as well; it is the
            shutter `"optimised"`, and the result has its B-spline `coefficients`.
        loss: The loss that the profile minimises, a loss or a function of scene, motion and
            shutter; the expected error by default, of the decoder that the scenes name.
        num_coefficients: Coefficients of the profile.
        max_steps: Steps of the search at each point, at most.
        seed: Seed of the random starts.
        metrics: Field or fields of `Metrics` to compute. By default those of the decoder that the
            loss of a search or else each scene names, and those that are of no decoder.
        photon_rates: Light to measure under in place of the scene's, e-/s at white,
            ascending; a dimension of the expected PSNR.
        read_noises: Read noises to measure under in place of the scene's, e-; likewise.
        store: Folder of a Zarr store, written block by block. The same sweep run again
            computes the missing blocks.
        scheduler: A `dask.distributed` client, or the address of a scheduler, whose
            workers compute the blocks.
        progress: Whether a bar is shown, in a terminal or a notebook; or a function that is called
            with the points that are done and that there are.

    Returns:
        One variable for each metric over `acceleration`, `half_exposure` and `shutter`, with
        `scene` and `velocity` before and `photon_rate` and `read_noise` after where they
        were given. A velocity that was not given is a coordinate of each scene.
        With a store, values are read from it as they are used.

    Raises:
        ValueError: if an argument is out of its range, `store` holds something else, or
            no scheduler answers.
        OSError: if the store cannot be written.

    Examples:
        >>> from mishutter import HannShutter, Limits, RectShutter, Scene, sweep
        >>> limits = Limits(max_stroke=20, max_half_exposure=0.02)
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=5, limits=limits)
        >>> shutters = {"rect": RectShutter(), "Hann": HannShutter()}
        >>> ranges = {"accelerations": [1e5, 2e5], "half_exposures": [5e-3, 1e-2]}
        >>> found = sweep(scene, **ranges, shutters=shutters)
        >>> best = found.expected_psnr.max(["acceleration", "half_exposure"])
        >>> print(dict(zip(best.shutter.values.tolist(), best.values.round(2).tolist())))
        {'rect': 28.09, 'Hann': 28.77}
    """
    subject, noun = "sweep(scenes=...)", "scene, as `Scene.load(path)` reads one from a file,"
    named_scenes = named(subject, scenes, Scene, noun)
    require_known("sweep", scenes=named_scenes)
    for scene in named_scenes.values():
        require_one_axis(scene)
    first, *others = named_scenes.values()
    shared = first.device, first.sensor.full_well
    is_shared = all(bool(eqx.tree_equal(shared, (s.device, s.sensor.full_well))) for s in others)
    require(is_shared, subject, "share one device and full well", list(named_scenes))
    chosen = None if loss is None or not optimise else as_loss(loss, "sweep(loss=...)")
    decoders = decoders_of(named_scenes.values(), chosen)
    if shutters is None:
        shutters = {**baselines(), "Tukey": TukeyShutter(0.5)}
    grid = Grid(
        accelerations=checked_axis("accelerations", accelerations, bound="at least 0"),
        half_exposures=checked_axis("half_exposures", half_exposures, bound="above 0", strict=True),
        velocities=_axis_if_given("velocities", velocities),
        scenes=named_scenes,
        shutters=named("sweep(shutters=...)", shutters, AbstractShutter, "shutter"),
        metrics=_metrics(metrics, named_scenes.values(), decoders),
        photon_rates=_axis_if_given("photon_rates", photon_rates, "at least 0"),
        read_noises=_axis_if_given("read_noises", read_noises, "at least 0"),
        full_well=None if first.sensor.full_well is None else float(first.sensor.full_well),
        search=None,
        named_scenes=not isinstance(scenes, Scene),
    )
    if optimise:
        _check_searchable(grid, decoders)
        require_positive_int("sweep(max_steps=...)", max_steps)
        require_seed("sweep(seed=...)", seed)
        frames = [frame.sensor_scene for frame in grid.frames]
        profiles = tuple(starting_shutter(scene, num_coefficients) for scene in frames)
        search = Search(chosen or decoders[0].loss(), profiles, max_steps, seed)
        grid = replace(grid, search=search)
    return _filled(grid, store, scheduler, progress)


def _check_searchable(grid: Grid, decoders: Sequence[SpeedKnowledge]) -> None:
    """Refuses a grid at whose points no best profile can be searched for."""
    device = next(iter(grid.scenes.values())).device
    requirement = "be False where a device has levels, or falls otherwise than it rises"
    is_linear = device is None or device.is_linear
    require(is_linear, "sweep(optimise=...)", requirement, True)
    is_one_light = grid.photon_rates is None and grid.read_noises is None
    requirement = "be False where photon_rates or read_noises are given; use scenes for them"
    require(is_one_light, "sweep(optimise=...)", requirement, True)
    require(OPTIMISED not in grid.shutters, "sweep(shutters=...)", "have other names", OPTIMISED)
    requirement = "name one decoder_speed, where no loss is given"
    names = [each.name for each in decoders]
    require(len(decoders) == 1, "sweep(scenes=...)", requirement, names)


def _filled(
    grid: Grid, store: str | Path | None, scheduler: object, progress: Progress | bool | None
) -> "xarray.Dataset":
    """The results of a grid, of which a store may hold some."""
    with nullcontext() if scheduler is None else connection(scheduler) as client:
        blocks: Blocks = MemoryBlocks(grid) if store is None else StoredBlocks(grid, store)
        missing, num_points = blocks.missing(), grid.num_points(grid.blocks())
        done = num_points - grid.num_points(missing)
        if done:
            _LOG.info("%d of %d points are in '%s' already", done, num_points, store)
        told = progress if callable(progress) else lambda done, total: None
        with counts(progress is True, "sweeping", num_points, _WHY_NO_POINT) as counter:
            # Points of blocks that are under way; threads share no block.
            names = _names_of(grid)
            within = {block: (0, names[block]) for block in missing}

            def tell() -> int:
                count = done + sum(points for points, _ in within.values())
                counter(count, next((words for _, words in within.values()), ""))
                return count

            def found(block: Block, points: int, name: str) -> None:
                within[block] = points, f"{names[block]}, {name}"
                count = tell()
                if grid.search is not None and points:
                    told(count, num_points)

            told(tell(), num_points)
            if client is None:
                computed = _computed_here(grid, missing, blocks, found)
            else:
                place = None if store is None else str(Path(store).absolute())
                computed = compute_remotely(grid, missing, blocks, client, place)
            for block in computed:
                done += grid.num_points([block])
                del within[block]
                told(tell(), num_points)
    return blocks.dataset()


def _names_of(grid: Grid) -> dict[Block, str]:
    """The points of each block, as "points 33 to 64"."""
    names, last = {}, 0
    for block in grid.blocks():
        first, last = last + 1, last + grid.num_points([block])
        names[block] = f"point {last}" if first == last else f"points {first} to {last}"
    return names


_WHY_NO_POINT = "compiling, or measuring all points by a shutter at once"
"""Why a sweep moves no further for a while."""


def _computed_here(
    grid: Grid, missing: list[Block], blocks: Blocks, found: Found
) -> Iterator[Block]:
    if missing:
        for block, arrays in zip(missing, Engine(grid).computed(missing, found), strict=True):
            blocks.write(block, arrays)
            yield block


def _metrics(
    names: str | Sequence[str] | None,
    scenes: Iterable[Scene],
    decoders: Iterable[SpeedKnowledge],
) -> tuple[str, ...]:
    """The metrics of some names; by default those of the decoders."""
    with_tolerances = any(scene.tolerances is not None for scene in scenes)
    if names is None:
        return metrics_of(decoders, with_tolerances=with_tolerances)
    chosen = (names,) if isinstance(names, str) else tuple(names)
    known = [m.name for m in METRICS.values() if with_tolerances or not m.within_tolerances]
    are_metrics = bool(chosen) and all(name in known for name in chosen)
    require(are_metrics, "sweep(metrics=...)", f"name some of {', '.join(known)}", names)
    return chosen


def _axis_if_given(
    name: str, values: RowLike | None, bound: str = ""
) -> Float[np.ndarray, "n"] | None:
    return None if values is None else checked_axis(name, values, bound=bound)
