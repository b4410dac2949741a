"""The path of a stage as text."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Int

from mishutter._core.checks import require
from mishutter._core.columns import table_text
from mishutter.hardware.drive_files import MAX_STEPS
from mishutter.model.scene import Scene
from mishutter.model.stages import StagePath


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


def path_csv(
    paths: Mapping[str, StagePath],  # By the ending of the names of their columns
    lights: Mapping[str, tuple[float, float]],  # First and last light, by the name of the part; s
    count: int,  # Number of equal steps from the first light to the last
    scene: Scene,
) -> str | None:
    """A line of names, a line of units, then a time, its part of the path, places and velocities.

    Places are in px, and in um, as piezo stages take them, where the pitch of the pixels is known.
    Where the scene says how its stage follows, a column has the command for each axis. None without
    a path.
    """
    if not paths:
        return None
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
