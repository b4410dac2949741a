"""Reading a sweep: the best points, the Pareto front, and the gain of coding."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core import RowLike, as_float, outside_trace, require
from mishutter.evaluation import (
    SEARCHED_EFFECTIVE_SPEEDS,
    LightLevels,
    RowsAtRest,
    distinct_speeds,
    effective_speeds,
    lost_share,
    num_frequencies,
    rows_at_rest,
)
from mishutter.model import (
    Scene,
    filling_half_exposure,
    frequencies,
    noise_power,
    pixel_response,
    require_scene,
)

if TYPE_CHECKING:
    import xarray

OBJECTIVES = {
    "expected_psnr": True,
    "worst_speed_psnr": True,
    "bound_share": True,
    "efficiency": True,
    "condition_number": False,
    "kernel_difference": False,
    "relative_kernel_difference": False,
}
"""Metrics, and whether more of them is better."""

_PLACE = ("velocity", "acceleration", "half_exposure", "shutter")
_NUM_EXPOSURES = 129
_NUM_VELOCITIES = 9
_NUM_SPEEDS = 32
"""Exposures, velocities, and speeds of the largest weight, at which a search for the best snapshot
starts: long exposures have a valley about each speed."""
_NUM_NEAR = 5
_NUM_REFINEMENTS = 12
_NUM_AT_A_TIME = 1 << 17
"""Most numbers of an intermediate array; it bounds the memory."""


def best_points(
    dataset: "xarray.Dataset", objectives: str | Sequence[str] | None = None
) -> dict[str, "xarray.Dataset"]:
    """The best point of a sweep under each objective, of all shutters; by objective.

    Args:
        dataset: The result of `sweep` for one scene and light.
        objectives: One metric or several; all that the sweep holds by default.

    Raises:
        ValueError: if an objective is not a metric of the sweep.
    """
    objectives = [objectives] if isinstance(objectives, str) else objectives
    names = [n for n in OBJECTIVES if n in dataset] if objectives is None else list(objectives)
    points = {}
    for name in names:
        values = _oriented(dataset, name)
        if np.all(np.isnan(values)):
            continue
        index = np.unravel_index(np.nanargmax(values), values.shape)
        points[name] = dataset.isel(dict(zip(dataset[name].dims, index, strict=True)))
    return points


def pareto_front(
    dataset: "xarray.Dataset", objectives: str | Sequence[str] | Mapping[str, str]
) -> "xarray.Dataset":
    """Points of a sweep that nothing betters under every objective at once.

    Args:
        dataset: The result of `sweep` for one scene and light.
        objectives: Metrics, of which more or less is better as `OBJECTIVES` says; or a mapping
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
    front = inside[_undominated(values[:, inside])]
    front = front[np.argsort(values[0, front], kind="stable")]
    stacked = dataset.stack(point=dimensions).isel(point=front)
    return stacked.reset_index("point")


def gain_over(dataset: "xarray.Dataset", name: str) -> "xarray.DataArray":
    """Expected PSNR of every shutter over another's at the same point; dB.

    Args:
        dataset: What `sweep` gave.
        name: The shutter that gains are over.

    Raises:
        ValueError: if there is no such shutter, or no expected PSNR, in the sweep.
    """
    names = [str(x) for x in dataset.shutter.values]
    require(name in names, "gain_over(name=...)", f"be one of {', '.join(names)}", name)
    psnr = _psnr("gain_over(dataset=...)", dataset)
    gain = _gain(psnr, psnr.sel(shutter=name, drop=True))
    return gain.assign_attrs(long_name=f"gain over {name}", units="dB")


def gain_over_snapshot(dataset: "xarray.Dataset", scene: Scene) -> "xarray.DataArray":
    """Expected PSNR of every point over the best snapshot's; dB.

    The snapshot is that of `best_snapshots`: an open shutter on a sensor that may pan, its
    exposure and velocity tuned within the scene's limits for each light and each read noise.

    Args:
        dataset: The result of `sweep`.
        scene: The scene, or the one of the sweep's that the dataset was reduced to.

    Raises:
        ValueError: if the sweep holds no expected PSNR.
    """
    require_scene(scene)
    psnr = _psnr("gain_over_snapshot(dataset=...)", dataset)
    present = [n for n in ("photon_rate", "read_noise") if n in psnr.dims]
    light = {name: np.asarray(dataset[name]) for name in present}
    best = best_snapshots(scene, light.get("photon_rate"), light.get("read_noise"))
    level = best.expected_psnr
    for name in ("photon_rate", "read_noise"):
        if name not in light:
            level = level.isel({name: 0}, drop=True)
    gain = _gain(psnr, level)
    return gain.assign_attrs(long_name="gain over best snapshot", units="dB")


def _gain(psnr: "xarray.DataArray", level: "xarray.DataArray") -> "xarray.DataArray":
    """Difference of two levels; none where both are infinite, with nothing to restore."""
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
        ValueError: if it is not a sweep of the expected PSNR over both.
    """
    require_scene(scene)
    subject = "light_map(dataset=...)"
    psnr = _psnr(subject, dataset)
    is_map = all(name in psnr.dims for name in ("photon_rate", "read_noise"))
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
    scene: Scene, photon_rates: RowLike | None = None, read_noises: RowLike | None = None
) -> "xarray.Dataset":
    """The best exposure of an open shutter, and pan, under each light and read noise.

    Args:
        scene: Speeds, picture and the limits of the exposure, which ends where white fills a
            pixel that holds so many electrons and no more, and of the pan.
        photon_rates: Photon rates at white, e-/s; the scene's by default.
        read_noises: Read noises, e-; the scene's by default.

    Returns:
        `expected_psnr` in dB, `half_exposure` in s and `velocity` in px/s over both.

    Raises:
        ValueError: if a rate or a noise is not finite or below 0.
    """
    import xarray

    require_scene(scene)
    rates = _light("photon_rates", scene.photon_rate if photon_rates is None else photon_rates)
    noises = _light("read_noises", scene.read_noise if read_noises is None else read_noises)
    light = LightLevels(rates[:, None], noises[None])
    low, high = float(scene.limits.min_half_exposure), float(scene.limits.max_half_exposure)
    longest = np.full((1, 1), high)
    if scene.full_well is not None:
        filling = filling_half_exposure(scene.full_well, rates)[:, None]
        longest = np.clip(filling, low, high)
    half = np.geomspace(np.full_like(longest, low), longest, _NUM_EXPOSURES)[:, None]
    ratio = (longest / low) ** (1 / (_NUM_EXPOSURES - 1))
    velocity = _pans(scene)[:, None, None]
    slowest, fastest = velocity.min(), velocity.max()
    step = (fastest - slowest) / (_NUM_VELOCITIES - 1)
    rough = _rows_of(scene, SEARCHED_EFFECTIVE_SPEEDS)
    for _ in range(_NUM_REFINEMENTS):
        best = _best_snapshot(scene, half, velocity, light, rough)
        near = np.linspace(-1, 1, _NUM_NEAR)[:, None, None]
        half = np.clip(best.half_exposure * ratio**near, low, longest)[:, None]
        velocity = best.velocity[None]
        if step > 0:
            velocity = np.clip(best.velocity + step * near, slowest, fastest)
        ratio, step = np.sqrt(ratio), step / 2
    best = _best_snapshot(scene, half, velocity, light, rough)
    exact = _rows_of(scene, effective_speeds(scene, best.half_exposure.max()))
    best = _best_snapshot(scene, best.half_exposure[None, None], best.velocity[None], light, exact)
    dimensions = ("photon_rate", "read_noise")
    with np.errstate(divide="ignore"):  # a picture without detail is restored without error
        level = -10 * np.log10(best.error)
    return xarray.Dataset(
        {
            "expected_psnr": (dimensions, level, {"units": "dB"}),
            "half_exposure": (dimensions, best.half_exposure, {"units": "s"}),
            "velocity": (dimensions, best.velocity, {"units": "px/s"}),
        },
        {"photon_rate": rates, "read_noise": noises},
    )


_Rows = Callable[[int], RowsAtRest]
"""Speeds and weights on a grid of so many frequencies."""


def _rows_of(scene: Scene, count: int) -> _Rows:
    """Rows by so many effective speeds, each grid of them once."""
    return cache(lambda num_frequencies: rows_at_rest(scene, count, num_frequencies))


def _pans(scene: Scene) -> np.ndarray:
    """Velocities at which the search for the best snapshot starts, rest among them; px/s."""
    speeds, weights = distinct_speeds(scene, folds=False)
    most = min(float(scene.limits.max_pan), float(scene.limits.max_top_speed))
    slowest, *_, fastest = np.clip(speeds[[0, -1]].astype(np.float64), -most, most)
    frequent = np.clip(speeds[np.argsort(weights)[-_NUM_SPEEDS:]], -most, most)
    return np.unique([0.0, *np.linspace(slowest, fastest, _NUM_VELOCITIES), *frequent])


class _Snapshots(NamedTuple):
    """Snapshots, one under each photon rate and read noise.

    Attributes:
        half_exposure: $T$; s.
        velocity: $v$; px/s.
        error: Expected squared error, white = 1.
    """

    half_exposure: Float[np.ndarray, "p r"]
    velocity: Float[np.ndarray, "p r"]
    error: Float[np.ndarray, "p r"]


def _best_snapshot(
    scene: Scene, half: np.ndarray, velocity: np.ndarray, light: LightLevels, rows: _Rows
) -> _Snapshots:
    """The best of some snapshots under each light.

    Args:
        scene: The scene.
        half: Half exposures, s; shape `(e, 1, p, r)`, or 1 for either light.
        velocity: Velocities, px/s; shape `(v, p, r)`, or 1 for either.
        light: Photon rates of shape `(p, 1)`, read noises of shape `(1, r)`.
        rows: Speeds and weights of the scene.
    """
    if scene.limits.pans == "stage":
        furthest = float(scene.limits.max_stroke) / (2 * half)
        velocity = np.clip(velocity, -furthest, furthest)
    error = _snapshot_error(scene, half, velocity, light, rows)
    flat = error.reshape(-1, *error.shape[2:])
    index = np.argmin(flat, axis=0)[None]

    def at_best(values: np.ndarray) -> np.ndarray:
        every = np.broadcast_to(values, error.shape).reshape(flat.shape)
        return np.take_along_axis(every, index, 0)[0]

    return _Snapshots(at_best(half), at_best(velocity), at_best(error))


def _light(name: str, values: RowLike) -> np.ndarray:
    subject = f"best_snapshots({name}=...)"
    row = np.atleast_1d(np.asarray(as_float(values, subject)))
    right = row.ndim == 1 and bool(np.all((row >= 0) & np.isfinite(row)))
    require(right, subject, "be finite, at least 0 and one row", row)
    return row


def _psnr(subject: str, dataset: "xarray.Dataset") -> "xarray.DataArray":
    """The expected PSNR of a sweep, which must have been asked for."""
    held = "expected_psnr" in dataset
    require(held, subject, "hold expected_psnr among its metrics", list(dataset))
    return dataset.expected_psnr


def _snapshot_error(
    scene: Scene, half: np.ndarray, velocity: np.ndarray, light: LightLevels, rows: _Rows
) -> np.ndarray:
    r"""Expected squared error of an open shutter on a sensor that pans; `(e, v, p, r)`.

    That of `expected_squared_error` with $H_s(f) = \operatorname{sinc}(2 f (s - v) T)$.
    """
    half, velocity = np.broadcast_arrays(half, velocity)
    slowest, fastest = (float(speed) for speed in scene.speed_range)
    spread = 2 * np.maximum(fastest - velocity, velocity - slowest) * half
    counts = np.zeros(half.shape, int)
    for pan in np.unique(velocity):
        here = velocity == pan
        counts[here] = num_frequencies(scene, spread[here], float(pan))
    counts = counts.max(axis=(2, 3))
    shape = light.photon_rates.shape[0], light.read_noises.shape[1]
    total = np.zeros(half.shape[:2] + shape)
    for count in np.unique(counts):
        at = counts == count
        total[at] = _error_of_pans(scene, half[at], velocity[at], light, rows(int(count)))
    return total


def _error_of_pans(
    scene: Scene, half: np.ndarray, velocity: np.ndarray, light: LightLevels, rows: RowsAtRest
) -> np.ndarray:
    """The same over a number of frequencies; `(n, p, r)`."""
    count = rows.power.size
    travel = 2 * (rows.speeds - velocity[..., None]) * half[..., None]
    electrons = np.asarray(light.photon_rates) * 2 * half
    noise = noise_power(1.0, float(scene.mean_level), electrons, np.asarray(light.read_noises))
    total = np.zeros(np.broadcast_shapes(electrons.shape, noise.shape))
    blur = float(scene.lens_blur)
    num_parts = -(-count * max(travel.size, total.size) // _NUM_AT_A_TIME)
    for part in np.array_split(np.arange(count), min(num_parts, count)):
        f, level = (x[part].reshape(-1, 1, 1, 1) for x in (frequencies(count), rows.power))
        weights = np.broadcast_to(rows.weights, (count, rows.speeds.size))[part]
        weights = weights[:, None, None, :, None]
        responses = np.sinc(f[..., None] * travel) * pixel_response(f[..., None], blur)
        mean = (responses @ weights)[..., 0]
        spread = (((responses - mean[..., None]) ** 2) @ weights)[..., 0]
        signal = level * electrons**2
        total += np.sum(level * lost_share(signal, mean**2, spread, noise), axis=0)
    return total / count


def _oriented(dataset: "xarray.Dataset", name: str, sense: str = "") -> np.ndarray:
    """Values of a metric, turned so that more is better."""
    is_metric = name in dataset and (name in OBJECTIVES or sense != "")
    names = ", ".join(n for n in OBJECTIVES if n in dataset)
    require(is_metric, "objectives", f"be metrics of the sweep, {names}", name)
    up = OBJECTIVES.get(name, True) if sense == "" else sense == "max"
    values = dataset[name].values.astype(np.float64)
    return values if up else -values


def _undominated(values: np.ndarray) -> np.ndarray:
    """Columns that no other column equals or betters everywhere and betters somewhere."""
    order = np.lexsort(values[::-1])[::-1]
    front: list[int] = []
    for index in order:
        rivals = values[:, front]
        at_least = np.all(rivals >= values[:, index, None], axis=0)
        if not np.any(at_least):
            front.append(int(index))
    return np.array(front, int)
