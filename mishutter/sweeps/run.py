"""Labelled grids of designs over acceleration and exposure: run, store, resume."""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

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
from mishutter._core.progress import reports
from mishutter.evaluation.losses import AbstractLoss, as_loss
from mishutter.evaluation.metrics import METRICS
from mishutter.evaluation.speed_knowledge import SpeedKnowledge, metrics_of
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.kinds import baselines
from mishutter.model.shutters.windows import TukeyShutter
from mishutter.search.search import MAX_STEPS, NUM_COEFFICIENTS, starting_shutter
from mishutter.sweeps.blocks import Engine
from mishutter.sweeps.cluster import compute_remotely, connection
from mishutter.sweeps.grid import OPTIMISED, Frame, Grid, Search, checked_axis, decoders_of
from mishutter.sweeps.store import AbstractBlocks, MemoryBlocks, StoredBlocks

if TYPE_CHECKING:
    import xarray

Progress = Callable[[int, int], None]
_LOSS = "sweep(loss=...)"
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
    scheduler: Any = None,
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
    axes = _Axes(
        checked_axis("sweep(accelerations=...)", accelerations, bound="at least 0", strict=False),
        checked_axis("sweep(half_exposures=...)", half_exposures, bound="above 0", strict=True),
        None if velocities is None else checked_axis("sweep(velocities=...)", velocities),
        _light("sweep(photon_rates=...)", photon_rates),
        _light("sweep(read_noises=...)", read_noises),
    )
    search = _SearchOptions(loss, num_coefficients, max_steps, seed) if optimise else None
    grid = _grid(
        scenes,
        axes,
        _shutters(shutters),
        metrics=metrics,
        search=search,
    )
    with nullcontext() if scheduler is None else connection(scheduler) as client:
        blocks: AbstractBlocks = MemoryBlocks(grid) if store is None else StoredBlocks(grid, store)
        missing, total = blocks.missing(), len(grid.blocks())
        _LOG.info("%d of %d blocks found, %d to compute", total - len(missing), total, len(missing))
        num_points = grid.num_points(grid.blocks())
        done = num_points - grid.num_points(missing)
        with reports(progress, "sweeping", num_points, _in_words, WHY_NO_POINT) as news:
            tell = news or (lambda done, total: None)
            tell(done, num_points)
            if client is None:
                computed = _computed_here(grid, missing, blocks)
            else:
                place = None if store is None else str(Path(store).absolute())
                computed = compute_remotely(grid, missing, blocks, client, place)
            for block in computed:
                done += grid.num_points([block])
                tell(done, num_points)
    _LOG.info("%d block%s computed", len(missing), "" if len(missing) == 1 else "s")
    return blocks.dataset()


WHY_NO_POINT = "compiling (first run only), or a block is computed, whose points end together"
"""Why a sweep tells no point for a while."""


def _in_words(done: int, total: int) -> tuple[int, str]:
    """The news of a sweep as a bar shows them."""
    del total
    return done, ""


def _computed_here(grid: Grid, missing: list, blocks: AbstractBlocks):
    if missing:
        for block, arrays in zip(missing, Engine(grid).computed(missing), strict=True):
            blocks.write(block, arrays)
            yield block


class _Axes(NamedTuple):
    """Axes of the grid, ascending; None for the scenes' own values."""

    accelerations: Float[np.ndarray, "a"]
    half_exposures: Float[np.ndarray, "t"]
    velocities: Float[np.ndarray, "v"] | None
    photon_rates: Float[np.ndarray, "p"] | None
    read_noises: Float[np.ndarray, "r"] | None


class _SearchOptions(NamedTuple):
    """Arguments of `sweep` for the search of the best profiles, as they are given."""

    loss: AbstractLoss | Callable[..., object] | None
    num_coefficients: int
    max_steps: int
    seed: int


def _grid(
    scenes: Scene | Sequence[object] | Mapping[str, object],
    axes: _Axes,
    shutters: dict[str, AbstractShutter],
    *,
    metrics: str | Sequence[str] | None,
    search: _SearchOptions | None,
) -> Grid:
    """The grid of a sweep, with a search for the best profiles if there are options for one."""
    noun = "scene, as `Scene.load(path)` reads one from a file,"
    named_scenes = named("sweep(scenes=...)", scenes, Scene, noun)
    require_known("sweep", scenes=named_scenes)
    loss = None if search is None or search.loss is None else as_loss(search.loss, _LOSS)
    decoders = decoders_of(named_scenes.values(), loss)
    first, *others = named_scenes.values()
    shared = first.device, first.sensor.full_well
    is_shared = all(bool(eqx.tree_equal(shared, (s.device, s.sensor.full_well))) for s in others)
    require(is_shared, "sweep(scenes=...)", "share one device and full well", list(named_scenes))
    device = first.device
    if search is not None and device is not None:
        requirement = "be False where a device has levels, or falls otherwise than it rises"
        require(device.is_linear, "sweep(optimise=...)", requirement, True)
    grid = Grid(
        accelerations=axes.accelerations,
        half_exposures=axes.half_exposures,
        velocities=axes.velocities,
        scenes=named_scenes,
        shutters=shutters,
        metrics=_metrics(metrics, named_scenes.values(), decoders),
        photon_rates=axes.photon_rates,
        read_noises=axes.read_noises,
        full_well=None if first.sensor.full_well is None else float(first.sensor.full_well),
        search=None,
        named_scenes=not isinstance(scenes, Scene),
    )
    if search is not None:
        is_one_light = axes.photon_rates is None and axes.read_noises is None
        requirement = "be False where photon_rates or read_noises are given; use scenes for them"
        require(is_one_light, "sweep(optimise=...)", requirement, True)
        require(OPTIMISED not in shutters, "sweep(shutters=...)", "have other names", OPTIMISED)
        requirement = "name one decoder_speed, where no loss is given"
        names = [each.name for each in decoders]
        require(len(decoders) == 1, "sweep(scenes=...)", requirement, names)
        return replace(grid, search=_search(grid.frames, search, loss or decoders[0].loss()))
    return grid


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


def _search(frames: Sequence[Frame], options: _SearchOptions, loss: AbstractLoss) -> Search:
    require_positive_int("sweep(max_steps=...)", options.max_steps)
    require_seed("sweep(seed=...)", options.seed)
    profiles = tuple(
        starting_shutter(frame.sensor_scene, options.num_coefficients) for frame in frames
    )
    return Search(loss, profiles, options.max_steps, options.seed)


def _shutters(shutters: Mapping[str, object] | None) -> dict[str, AbstractShutter]:
    if shutters is None:
        return {**baselines(), "Tukey": TukeyShutter(0.5)}
    return named("sweep(shutters=...)", shutters, AbstractShutter, "shutter")


def _light(subject: str, values: RowLike | None) -> Float[np.ndarray, "n"] | None:
    if values is None:
        return None
    return checked_axis(subject, values, bound="at least 0", strict=False)
