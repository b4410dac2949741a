"""Reading a sweep: the best points, the Pareto front, and the gain of coding."""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np

from mishutter._core.checks import RowLike, Unquoted, as_float, require
from mishutter._core.compiling import outside_trace
from mishutter._core.parallel import in_threads, num_processors
from mishutter._core.progress import counts
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.metrics import METRICS
from mishutter.evaluation.speed_knowledge import knowledge_of, loss_of_level
from mishutter.model.scene import Scene, require_scene
from mishutter.search.rivals import RivalSearch, snapshots
from mishutter.search.rows import best_row

if TYPE_CHECKING:
    import xarray

_RANGES = ("velocity", "acceleration", "half_exposure")
_PLACE = (*_RANGES, "shutter")
_LIGHT = ("photon_rate", "read_noise")


def best_points(
    dataset: "xarray.Dataset", objectives: str | Sequence[str] | None = None
) -> dict[str, "xarray.Dataset"]:
    """The best point of a sweep under each objective, of all shutters; by objective.

    Args:
        dataset: The result of `sweep` for one scene and light.
        objectives: One metric or several; all that the sweep holds by default, levels first and
            those of which less is better last.

    Returns:
        The data set at each point. Its coordinate `at_end_of` names the ranges (velocity,
        acceleration or half exposure) whose best points all lie at one end: a wider range may
        hold a better one, where the limits allow it.

    Raises:
        ValueError: if an objective is not a metric of the sweep.
    """
    objectives = [objectives] if isinstance(objectives, str) else objectives
    names = _objectives(dataset) if objectives is None else list(objectives)
    points = {}
    for name in names:
        values = _oriented(dataset, name)
        if np.all(np.isnan(values)):
            continue
        index = np.unravel_index(np.nanargmax(values), values.shape)
        point = dataset.isel(dict(zip(dataset[name].dims, index, strict=True)))
        points[name] = point.assign_coords(at_end_of=", ".join(_ends(dataset, name, values)))
    return points


def pareto_front(
    dataset: "xarray.Dataset", objectives: str | Sequence[str] | Mapping[str, str]
) -> "xarray.Dataset":
    """Points of a sweep that nothing betters under every objective at once.

    Args:
        dataset: The result of `sweep` for one scene and light.
        objectives: Metrics, of which more or less is better as their table says; or a mapping
            from a variable to `"max"` or `"min"`.

    Returns:
        The points along the dimension `point`, in rising order of the first objective.

    Raises:
        ValueError: if there are no two objectives, one is not a metric of the sweep, or
            they are not over the same dimensions.
    """
    objectives = [objectives] if isinstance(objectives, str) else objectives
    senses = dict(objectives) if isinstance(objectives, Mapping) else dict.fromkeys(objectives, "")
    subject = "pareto_front(objectives=...)"
    require(len(senses) >= 2, subject, "name at least two metrics", objectives)
    for name, sense in senses.items():
        require(sense in ("", "max", "min"), subject, "say max or min", sense)
        _oriented(dataset, name, sense)
    dimensions = dataset[next(iter(senses))].dims
    are_alike = all(dataset[name].dims == dimensions for name in senses)
    require(are_alike, subject, "be over the same dimensions", objectives)
    values = np.stack([_oriented(dataset, name, sense).ravel() for name, sense in senses.items()])
    inside = np.flatnonzero(np.all(~np.isnan(values), axis=0))
    front: list[int] = []
    # From the greatest down a point comes after those that better it; of equal points one stays.
    for index in inside[np.lexsort(values[::-1, inside])[::-1]]:
        at_least = np.all(values[:, front] >= values[:, index, None], axis=0)
        if not np.any(at_least):
            front.append(int(index))
    ascending = np.argsort(values[0, front], kind="stable")
    stacked = dataset.stack(point=dimensions).isel(point=np.array(front, int)[ascending])
    return stacked.reset_index("point")


def gain_over(dataset: "xarray.Dataset", name: str) -> "xarray.DataArray":
    """Level of every shutter over another's at the same point, by the sweep's decoder; dB.

    Args:
        dataset: What `sweep` gave.
        name: The shutter that gains are over.

    Raises:
        ValueError: if there is no such shutter, or no level, in the sweep.
    """
    names = [str(x) for x in dataset.shutter.values]
    require(name in names, "gain_over(name=...)", f"be one of {', '.join(names)}", name)
    psnr = dataset[level_of("gain_over(dataset=...)", dataset)]
    gain = _gain(psnr, psnr.sel(shutter=name, drop=True))
    return gain.assign_attrs(long_name=f"gain over {name}", units="dB")


def gain_over_snapshot(dataset: "xarray.Dataset", scene: Scene) -> "xarray.DataArray":
    """Level of every point over the best snapshot's, by the sweep's decoder; dB.

    The snapshot is that of `best_snapshots`: an open shutter on a sensor that may pan, its
    exposure and velocity tuned within the scene's limits for each light and each read noise.

    Args:
        dataset: The result of `sweep` for one scene, of which single lights may be selected.
        scene: The scene. Its own light counts where the dataset has no coordinate of the light.

    Raises:
        ValueError: if the sweep holds no level, or is of several scenes.
    """
    require_scene(scene)
    subject = "gain_over_snapshot(dataset=...)"
    name = level_of(subject, dataset)
    num_scenes = dataset.sizes.get("scene", 1)
    require(num_scenes == 1, subject, "be of one scene", Unquoted(f"{num_scenes} scenes"))
    psnr = dataset[name]
    # A light that was selected is a coordinate without a dimension.
    lights = {axis: np.asarray(psnr[axis]) for axis in _LIGHT if axis in psnr.coords}
    best = best_snapshots(scene, lights.get("photon_rate"), lights.get("read_noise"), level=name)
    return over_snapshots(psnr, best[name])


def over_snapshots(psnr: "xarray.DataArray", best: "xarray.DataArray") -> "xarray.DataArray":
    """Level of every point over that of `best_snapshots` under its light; dB."""
    level = best.isel({axis: 0 for axis in _LIGHT if axis not in psnr.dims}, drop=True)
    gain = _gain(psnr, level)
    return gain.assign_attrs(long_name="gain over best snapshot", units="dB")


def _gain(psnr: "xarray.DataArray", level: "xarray.DataArray") -> "xarray.DataArray":
    """Difference of two levels; 0 where both are infinite, as there is nothing to restore."""
    with np.errstate(invalid="ignore"):
        return (psnr - level).where(psnr != level, 0.0)


def light_map(dataset: "xarray.Dataset", scene: Scene) -> "xarray.Dataset":
    """Whether the method is worth it: the best of a sweep over the best snapshot.

    Args:
        dataset: A sweep over `photon_rate` and `read_noise`.
        scene: Its scene.

    Returns:
        `gain` in dB over light and read noise, and the velocity, acceleration, half exposure
        and shutter that reach it.

    Raises:
        ValueError: if it is not a sweep of the decoder's level over both.
    """
    require_scene(scene)
    subject = "light_map(dataset=...)"
    psnr = dataset[level_of(subject, dataset)]
    is_map = all(name in psnr.dims for name in _LIGHT)
    require(is_map, subject, "have photon rates and read noises", dict(dataset.sizes))
    stacked = gain_over_snapshot(dataset, scene)
    stacked = stacked.stack(point=[name for name in _PLACE if name in stacked.dims])
    index = stacked.fillna(-np.inf).argmax("point")
    best = stacked.isel(point=index)
    gain = best.reset_coords(drop=True)
    places = {name: best[name].reset_coords(drop=True).broadcast_like(gain) for name in _PLACE}
    return gain.to_dataset(name="gain").assign(places)


@outside_trace()
def best_snapshots(
    scene: Scene,
    photon_rates: RowLike | None = None,  # the scene's by default
    read_noises: RowLike | None = None,  # the scene's by default
    *,
    level: str | None = None,
    progress: bool = False,
) -> "xarray.Dataset":
    """The best exposure of an open shutter, and pan, under each light and read noise.

    Each is the better of the snapshots that a comparison searches for, at rest and panned.
    """
    import xarray

    require_scene(scene)
    rates = _levels("photon_rates", scene.photon_rate if photon_rates is None else photon_rates)
    noises = _levels("read_noises", scene.read_noise if read_noises is None else read_noises)
    name = knowledge_of(scene).judge(scene) if level is None else level
    loss = loss_of_level(name)
    if not METRICS[name].within_tolerances:
        scene = without_tolerances(scene)

    def best(light: tuple[np.floating, np.floating]) -> tuple[float, float, float]:
        counter.began(name_of(light))
        in_light = eqx.tree_at(lambda s: (s.photon_rate, s.read_noise), scene, light)
        rows = [row.judged_by(loss, scene) for row in snapshots(RivalSearch(in_light, loss))]
        row = best_row(rows)
        counter.ended(name_of(light))
        return row.level, float(row.motion.half_exposure), float(row.motion.velocity)

    def name_of(light: tuple[np.floating, np.floating]) -> str:
        return "{:.3g} e-/s with {:.3g} e-".format(*light)

    lights = list(product(rates, noises))
    why = "compiling, or snapshots at rest and panned are searched for"
    with counts(progress, "best snapshots", len(lights), why) as counter:
        rows = np.array(list(in_threads(best, lights, num_processors())))
    psnr, half_exposure, velocity = rows.reshape(rates.size, noises.size, 3).transpose(2, 0, 1)
    return xarray.Dataset(
        {
            name: (_LIGHT, psnr, {"units": "dB"}),
            "half_exposure": (_LIGHT, half_exposure, {"units": "s"}),
            "velocity": (_LIGHT, velocity, {"units": "px/s"}),
        },
        {"photon_rate": rates, "read_noise": noises},
    )


def _levels(name: str, values: RowLike) -> np.ndarray:
    subject = f"best_snapshots({name}=...)"
    row = np.atleast_1d(np.asarray(as_float(values, subject)))
    is_row = row.ndim == 1 and bool(np.all((row >= 0) & np.isfinite(row)))
    require(is_row, subject, "be finite, at least 0 and one row", row)
    return row


def _ends(dataset: "xarray.Dataset", name: str, values: np.ndarray) -> list[str]:
    """Ranges at one end of which alone a metric is best; a range of a single value has no end."""
    places = np.nonzero(values == np.nanmax(values))
    ends = []
    for dimension, indices in zip(dataset[name].dims, places, strict=True):
        last = dataset.sizes[dimension] - 1
        if dimension not in _RANGES or last == 0:
            continue
        # Nothing lies beyond an acceleration of 0.
        is_open = dimension != "acceleration" or float(dataset[dimension][0]) > 0
        if np.all(indices == last) or (is_open and np.all(indices == 0)):
            ends.append(str(dimension))
    return ends


def level_of(subject: str, dataset: "xarray.Dataset") -> str:
    """Name of the metric that judges the points of a sweep, the level of its decoder."""
    name = str(dataset.attrs.get("level", "expected_psnr"))
    require(name in dataset, subject, f"hold {name} among its metrics", list(dataset))
    return name


def is_higher_better(name: str) -> bool:
    """Whether more of a variable of a sweep is better; of a gain too, which is no metric."""
    return name not in METRICS or METRICS[name].is_higher_better


def _objectives(dataset: "xarray.Dataset") -> list[str]:
    """Metrics of a sweep: levels first, then others, and those of which less is better last."""
    held = [metric for metric in METRICS.values() if metric.name in dataset]
    order = sorted(held, key=lambda metric: (not metric.is_higher_better, metric.unit != "dB"))
    return [metric.name for metric in order]


def _oriented(dataset: "xarray.Dataset", name: str, sense: str = "") -> np.ndarray:
    """Values of a metric, turned so that more is better."""
    is_metric = name in dataset and (name in METRICS or sense != "")
    names = ", ".join(_objectives(dataset))
    require(is_metric, "objectives", f"be metrics of the sweep, {names}", name)
    up = is_higher_better(name) if sense == "" else sense == "max"
    values = dataset[name].values.astype(np.float64)
    return values if up else -values
