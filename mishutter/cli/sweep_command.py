"""The command that maps acceleration and exposure: `sweep`."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from mishutter._core.checks import require
from mishutter._core.files import writable_folder
from mishutter._core.progress import note
from mishutter.cli.console import (
    AGAIN,
    interruptible,
    print_table,
    print_text,
    start_jax,
    write_json,
)
from mishutter.cli.help import DESIGN, MAP, OUTPUT, SEARCH
from mishutter.cli.options import (
    CoefficientsOption,
    JsonOption,
    LossOption,
    OutOption,
    SceneArgument,
    ShuttersOption,
    loss_of,
    option,
    path_option,
    scene_of,
)

if TYPE_CHECKING:
    import numpy as np
    import xarray

    from mishutter.model.scene import Scene

_RANGES = "`--stage-acceleration`, `--exposure` and `--velocity`"
_NUM_VALUES = 40
_MOST_POINTS = 10_000_000
"""More points do not fit into memory, and their Pareto front takes too long."""


def sweep(
    scene_file: SceneArgument = None,
    *,
    stage_acceleration: Annotated[
        str | None,
        option(
            MAP,
            "--stage-acceleration A:B:N",
            "N accelerations of the stage from A to B, px/s^2 [default: up to the limits].",
        ),
    ] = None,
    acceleration: Annotated[
        str | None,
        option(MAP, "--acceleration A:B:N", "Halves of these, of version 0.2.", hidden=True),
    ] = None,
    exposure: Annotated[
        str | None,
        option(
            MAP, "--exposure A:B:N", "N exposures from A to B, ms [default: within the limits]."
        ),
    ] = None,
    half_exposure: Annotated[
        str | None,
        option(MAP, "--half-exposure A:B:N", "Halves of these, of version 0.2.", hidden=True),
    ] = None,
    velocity: Annotated[
        str | None,
        option(
            MAP,
            "--velocity A:B:N",
            "N velocities of the sensor from A to B, px/s, of either sign [default: the "
            "middle of the speeds].",
        ),
    ] = None,
    log: Annotated[
        bool, option(MAP, "--log", "Space accelerations and exposures geometrically, not evenly.")
    ] = False,
    optimise: Annotated[
        bool, option(DESIGN, "--optimise", "Also search for the best profile at each point.")
    ] = False,
    loss: LossOption = None,
    shutters: ShuttersOption = None,
    num_coefficients: CoefficientsOption = 24,
    store: Annotated[
        Path | None, path_option(OUTPUT, "--store PATH", "Zarr store to write to or to resume.")
    ] = None,
    scheduler: Annotated[
        str | None,
        option(
            SEARCH, "--scheduler ADDRESS", "Dask scheduler to compute on [default: this machine]."
        ),
    ] = None,
    out: OutOption = None,
    json: JsonOption = False,
) -> None:
    """Map acceleration and exposure: the best points, and trade-offs between metrics."""
    if loss is not None and not optimise:
        raise ValueError(f"`--loss` must stand beside --optimise; got '{loss.value}' alone.")
    wholes, halves = ("--stage-acceleration", stage_acceleration), ("--acceleration", acceleration)
    accelerations = _halves(wholes, halves, log, "at least 0")
    wholes, halves = ("--exposure", exposure), ("--half-exposure", half_exposure)
    half_exposures = _halves(wholes, halves, log, "above 0", 1e-3)
    velocities = _values("--velocity", velocity, log=False)
    start_jax()
    import numpy as np

    from mishutter.model.shutters.kinds import baselines, named_shutter
    from mishutter.sweeps.grid import frames_of, require_some_inside, require_within
    from mishutter.sweeps.run import sweep as run

    scene = scene_of(scene_file)
    named = {name: named_shutter(name) for name in shutters or []}
    if half_exposures is None:
        shortest = float(scene.limits.min_half_exposure)
        longest = float(scene.limits.max_half_exposure)
        half_exposures = np.array([shortest])
        if longest > shortest:
            half_exposures = np.geomspace(shortest, longest, _NUM_VALUES)
    frames = frames_of([scene], velocities)
    if accelerations is None:
        slowest = min(abs(frame.velocity) for frame in frames)
        accelerations = _accelerations_of(scene, half_exposures, slowest)
    total = accelerations.size * half_exposures.size * len(frames)
    _require_few(f"{_RANGES} together", total)
    require_within(_RANGES, frames, accelerations, half_exposures)
    folder = None if out is None else writable_folder(out)
    with interruptible(lambda: _how_to_go_on(store)), _notes():
        dataset = run(
            scene,
            accelerations=accelerations,
            half_exposures=half_exposures,
            velocities=velocities,
            shutters={**baselines(), **named} if named else None,
            optimise=optimise,
            loss=None if loss is None else loss_of(loss, scene),
            num_coefficients=num_coefficients,
            store=store,
            scheduler=scheduler,
            progress=True,
        )
    require_some_inside(_RANGES, dataset.outside.values)
    _deliver(dataset, scene, folder, json)


def _how_to_go_on(store: Path | None) -> str:
    """The message of an interrupted sweep."""
    if store is None:
        return f"{AGAIN}; with --store PATH a sweep goes on where it was interrupted"
    from mishutter.sweeps.store import saved_points

    saved, every = saved_points(store) if store.exists() else (0, 0)
    if not saved:
        return AGAIN
    return f"{saved} of {every} points are saved in {store}; the same command goes on"


def _halves(
    wholes: tuple[str, str | None],
    halves: tuple[str, str | None],
    log: bool,
    bound: str,
    unit: float = 1.0,
) -> "np.ndarray | None":
    """Half of the numbers of one option, or those of another, which version 0.2 had."""
    of_whole, of_half = (_values(*each, log, bound=bound) for each in (wholes, halves))
    requirement = f"not stand beside {wholes[0]}"
    require(of_whole is None or of_half is None, halves[0], requirement, halves[1])
    if of_whole is not None:
        return of_whole * (unit / 2)
    return None if of_half is None else of_half * unit


def _values(
    option: str, text: str | None, log: bool, bound: str | None = None
) -> "np.ndarray | None":
    """The values of a range `A:B:N`, checked against a bound if there is one."""
    import numpy as np

    if text is None:
        return None
    parts = text.split(":")
    try:
        (low, high), count = map(float, parts[:-1]), int(parts[-1])
    except ValueError:
        raise ValueError(
            f"`{option}` must be A:B:N, two numbers and a count; got '{text}'."
        ) from None
    if not (np.isfinite(low) and np.isfinite(high)):
        raise ValueError(f"`{option}` must run between finite numbers; got '{text}'.")
    if count < 1:
        raise ValueError(f"`{option}` must hold at least one value; got '{text}'.")
    _require_few(f"`{option}`", count)
    if bound is not None and (low < 0 or (low == 0 and bound == "above 0")):
        raise ValueError(f"`{option}` must be {bound}; got '{text}'.")
    if high < low or (high == low and count > 1):
        raise ValueError(f"`{option}` must ascend from A to B; got '{text}'.")
    if high > low and count == 1:
        raise ValueError(f"`{option}` must hold two values or more from A to B; got '{text}'.")
    if log and low == 0 and count > 1:
        raise ValueError(f"`{option}` must begin above 0 with --log; got '{text}'.")
    return np.geomspace(low, high, count) if log and low > 0 else np.linspace(low, high, count)


def _require_few(subject: str, count: int) -> None:
    """Raises `ValueError` if a sweep has too many points."""
    if count > _MOST_POINTS:
        raise ValueError(f"{subject} must make at most {_MOST_POINTS:,} points; got {count:,}.")


def _accelerations_of(scene: "Scene", half_exposures: "np.ndarray", pan: float) -> "np.ndarray":
    """Accelerations in the decade below the least limit of an exposure, up to the greatest.

    Where a pan leaves no speed or no stroke, the limits without a pan stand in: those points are
    outside the limits too.
    """
    import numpy as np

    limits = scene.limits
    shortest, longest = float(limits.min_half_exposure), float(limits.max_half_exposure)
    half_exposures = np.clip(half_exposures, shortest, longest)
    beside_pan, alone = (
        np.asarray(limits.acceleration_of_path(half_exposures, velocity)) for velocity in (pan, 0.0)
    )
    largest = np.where(beside_pan > 0, beside_pan, alone)
    return np.geomspace(largest.min() / 10, largest.max(), _NUM_VALUES)


@contextmanager
def _notes() -> Iterator[None]:
    """Writes log records of the sweep to standard error as notes."""
    handler = logging.Handler(logging.INFO)
    handler.emit = lambda record: note(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("mishutter.sweep")
    level = logger.level
    logger.setLevel(logging.INFO)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)


_COLUMNS = (
    "best",
    "shutter",
    "v px/s",
    "stage px/s²",
    "open ms",
    "stroke px",
    "PSNR dB",
    "- snap.",
    "- Hann",
)
_OTHER_METRICS = ("condition_number", "relative_kernel_difference", "efficiency")
"""Metrics that follow the level and its gains."""


def _deliver(dataset: "xarray.Dataset", scene: "Scene", folder: Path | None, as_json: bool) -> None:
    from mishutter.evaluation.metrics import METRICS
    from mishutter.sweeps.trade_offs import (
        best_points,
        best_snapshots,
        gain_over,
        level_of,
        over_snapshots,
    )

    values = dataset.load()
    level = level_of(_RANGES, values)
    snapshot = best_snapshots(scene, level=level, progress=True)
    gain = over_snapshots(values[level], snapshot[level])
    gains = values.assign(over_snapshot=gain, over_hann=gain_over(values, "Hann"))
    best = {name: _point_of(point, scene, level) for name, point in best_points(gains).items()}
    files = []
    if folder is not None:
        from mishutter.report.sweep_plots import write_pictures

        files = write_pictures(gains, level, folder)
    if as_json:
        document = {
            "best": best,
            "best_snapshot": {
                level: float(snapshot[level][0, 0]),
                "exposure_ms": float(snapshot.half_exposure[0, 0]) * 2e3,
                "half_exposure_ms": float(snapshot.half_exposure[0, 0]) * 1e3,
                "velocity_px_per_s": float(snapshot.velocity[0, 0]),
            },
            "num_points": int(values.outside.size),
            "num_within_limits": int((values.outside == 0).sum()),
            "files": files,
        }
        write_json(document)
    else:
        others = [METRICS[name] for name in _OTHER_METRICS]
        rows = _rows(best, [metric.form for metric in others])
        columns = [*_COLUMNS, *(metric.heading for metric in others)]
        is_ended = any(point["at_end_of"] for point in best.values())
        aside = " (* at an end of its range)" if is_ended else ""
        print_table(f"Best points of the sweep{aside}", columns, rows)
        print_text(f"PSNR dB: {METRICS[level].meaning}.")
    if files:
        note(f"{folder}: {', '.join(files)}")


def _point_of(point: "xarray.Dataset", scene: "Scene", level: str) -> dict[str, str | float]:
    """A point of a sweep as plain text and numbers."""
    from mishutter.model.motion import ParabolicMotion

    a, half, velocity = (float(point[n]) for n in ("acceleration", "half_exposure", "velocity"))
    motion = ParabolicMotion(acceleration=a, half_exposure=half, velocity=velocity)
    names = (level, "over_snapshot", "over_hann", *_OTHER_METRICS)
    numbers: dict[str, str | float] = {
        "shutter": str(point.shutter.values),
        "velocity_px_per_s": velocity + 0.0,
        "stage_acceleration_px_per_s2": 2 * a,
        "exposure_ms": half * 2e3,
        # Halves of these, which programs may read.
        "acceleration_px_per_s2": a,
        "half_exposure_ms": half * 1e3,
        "stroke_px": float(scene.limits.of_stage(motion).stroke),
        "top_speed_px_per_s": float(motion.top_speed),
        "at_end_of": str(point.at_end_of.values),
    }
    return numbers | {name: float(point[name]) for name in names}


def _rows(best: dict[str, dict[str, str | float]], others: list[str]) -> list[list[str]]:
    """The rows of a table of best points; one that is the best by several metrics is one row."""
    places: dict[tuple[str, ...], list[str]] = {}
    for name, point in best.items():
        places.setdefault(tuple(_cells(point, others)), []).append(name)
    return [["\n".join(names), *cells] for cells, names in places.items()]


def _cells(point: dict[str, str | float], others: list[str]) -> list[str]:
    """The cells of a point under the names of `_COLUMNS`, then others in their formats."""
    formats = (".1f", ".3g", ".4g", ".3f", ".2f", "+.2f", "+.2f", *others)
    # Names of axes of the results, which are of halves.
    ends = tuple(filter(None, str(point["at_end_of"]).replace("half_", "").split(", ")))
    halves = ("acceleration_px_per_s2", "half_exposure_ms")
    left_out = ("shutter", "top_speed_px_per_s", "at_end_of", *halves)
    numbers = {name: value for name, value in point.items() if name not in left_out}
    cells = [
        format(value, form) + "*" * name.removeprefix("stage_").startswith(ends)
        for (name, value), form in zip(numbers.items(), formats, strict=True)
    ]
    return [str(point["shutter"]), *cells]
