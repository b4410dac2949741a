"""The path of a stage as text."""

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Int

from mishutter._core.checks import require
from mishutter._core.columns import table_text
from mishutter.model.limits import Limits
from mishutter.model.scene import Scene
from mishutter.model.stages import StagePath

MAX_STEPS = 100_000
_NEAR = 1e-3
"""Way below which a stage is where it began; px."""


def pitch_of(scene: Scene) -> float | None:
    """Distance of the pixels of a scene's sensor; m. None where it does not say it."""
    return None if scene.sensor.pixel_pitch is None else float(scene.sensor.pixel_pitch)


def path_steps(path: StagePath, first: float, step: float, count: int) -> Int[np.ndarray, "n"]:
    """Numbers of the equal steps from the rest before a path to the rest after it."""
    before, after = (
        # Rounding must not add a step to a path that ends at one.
        int(np.ceil(length / step * (1 - 1e-9)))
        for length in (first - path.times[0], path.times[-1] - (first + count * step))
    )
    requirement = f"have a run-up and a run-out of at most {MAX_STEPS} steps"
    require(max(before, after) <= MAX_STEPS, "design", requirement, max(before, after))
    return np.arange(-before, count + after + 1)


def ways_of(paths: Mapping[str, StagePath]) -> dict[str, float]:
    """Places at which axes come to rest, from where they begin; px."""
    return {end: float(path.positions[-1] - path.positions[0]) for end, path in paths.items()}


def with_way_back(paths: Mapping[str, StagePath], limits: Limits) -> dict[str, StagePath]:
    r"""Paths that go on from rest to where they began, at rest again.

    All axes take the same time $4h$, each in four pieces of the jerk $j, -j, -j, j$: their way is
    $2jh^3$ long, with an acceleration of up to $jh$ and a velocity of up to $jh^2$. Where the
    acceleration has no limit it is at most that of the path.
    """
    ways = np.array([*ways_of(paths).values()])
    length = float(np.hypot(*ways) if limits.axes == "disc" and ways.size == 2 else max(abs(ways)))
    if length < _NEAR:
        return {**paths}
    most, jerk = limits.max_acceleration, limits.max_jerk
    greatest = max(float(np.max(np.abs(path.accelerations))) for path in paths.values())
    greatest = greatest if most is None else float(most)
    h = max(
        math.sqrt(length / (2 * greatest)),
        length / (2 * float(limits.max_top_speed)),
        0.0 if jerk is None else math.cbrt(length / (2 * float(jerk))),
    )
    back = {}
    for (end, path), way in zip(paths.items(), -ways, strict=True):
        j = way / (2 * h**3)
        back[end] = path._replace(
            times=np.append(path.times, path.times[-1] + h * np.arange(1, 5)),
            positions=np.append(
                path.positions, path.positions[-1] + way * np.array([1 / 12, 1 / 2, 11 / 12, 1])
            ),
            velocities=np.append(path.velocities, j * h**2 * np.array([0.5, 1.0, 0.5, 0.0])),
            accelerations=np.append(path.accelerations, j * h * np.array([0.0, 1.0, 0.0, -1.0])),
            jerks=np.append(path.jerks, j * np.array([1.0, -1.0, -1.0, 1.0])),
        )
    return back


def path_csv(
    paths: Mapping[str, StagePath],  # By the ending of the names of their columns
    lights: Mapping[str, tuple[float, float]],  # First and last light, by the name of the part; s
    count: int,  # Number of equal steps from the first light to the last
    scene: Scene,
    *,
    returns: bool = False,  # Whether the stage goes back to where it began
) -> str | None:
    """A line of names, a line of units, then a time, its part of the path, places and velocities.

    Places are in px, and in um, as piezo stages take them, where the pitch of the pixels is known.
    Where the scene says how its stage follows, a column has the command for each axis. None without
    a path.
    """
    if not paths:
        return None
    arrives = next(iter(paths.values())).times[-1]
    paths = with_way_back(paths, scene.limits) if returns else paths
    whole = next(iter(paths.values()))  # Axes begin and end at the same times.
    ends = [*lights.values()]
    first, last = ends[0][0], ends[-1][1]
    step = (last - first) / count
    times = first + step * path_steps(whole, first, step, count)
    parts = np.full(times.size, "between frames", object)
    parts[times < first - step / 2] = "run-up"
    parts[times > last - step / 2] = "run-out"
    for name, (begin, end) in lights.items():
        parts[(times > begin - step / 2) & (times < end - step / 2)] = name
    near = 1e-6 * step
    parts[times > arrives + near] = "return"
    parts[(times <= whole.times[0] + near) | (times >= whole.times[-1] - near)] = "rest"
    columns = {("time", "ms"): times * 1e3, ("part", ""): parts}
    stage, pitch = scene.limits.stage, pitch_of(scene)
    for end, path in paths.items():
        position, velocity = path.at(times)
        columns |= {(f"sensor_position{end}", "px"): position}
        columns |= {(f"sensor_velocity{end}", "px/s"): velocity}
        if stage is not None:
            columns[(f"sent_position{end}", "px")] = stage.sent_for(path, times)
    if pitch is not None:
        per_px = {"px": ("um", pitch * 1e6), "px/s": ("mm/s", pitch * 1e3)}
        for (name, unit), column in [*columns.items()][2:]:
            other, scale = per_px[unit]
            columns[(f"{name}_{other.replace('/', '_per_')}", other)] = column * scale
    return table_text(columns)
