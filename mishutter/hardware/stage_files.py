"""The path of a stage as text."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, Int

from mishutter._core.checks import require
from mishutter.hardware.drive_files import MAX_STEPS
from mishutter.model.scene import Scene
from mishutter.model.servos import SecondOrderStage
from mishutter.model.stages import StagePath


def pitch_of(scene: Scene) -> float | None:
    """Distance of the pixels of a scene's sensor; m. None where it does not say it."""
    return None if scene.sensor.pixel_pitch is None else float(scene.sensor.pixel_pitch)


def path_steps(path: StagePath, first: float, step: float, count: int) -> Int[np.ndarray, "n"]:
    """Numbers of the equal steps from the rest before a path to the rest after it.

    Raises:
        ValueError: if the run-up or the run-out takes more steps than a table may have.
    """
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
    times: Float[np.ndarray, "n"],  # s
    parts: np.ndarray,
    stage: SecondOrderStage | None,
    pixel_pitch: float | None,  # m
) -> str:
    """A line of names, a line of units, then a time, its part of the path, places and velocities.

    Places are in px, and in um, as piezo stages take them, where the pitch of the pixels is known.
    """
    columns = {}
    for end, path in paths.items():
        position, velocity = path.at(times)
        columns |= {(f"sensor_position{end}", "px"): position}
        columns |= {(f"sensor_velocity{end}", "px/s"): velocity}
        if stage is not None:
            columns[(f"sent_position{end}", "px")] = stage.sent_for(path, times)
    if pixel_pitch is not None:
        per_px = {"px": ("um", pixel_pitch * 1e6), "px/s": ("mm/s", pixel_pitch * 1e3)}
        for (name, unit), column in [*columns.items()]:
            other, scale = per_px[unit]
            columns[(f"{name}_{other.replace('/', '_per_')}", other)] = column * scale
    names, units = zip(*columns, strict=True)
    lines = [",".join(["time", "part", *names]), ",".join(["ms", "", *units])]
    for time, part, *numbers in zip(times * 1e3, parts, *columns.values(), strict=True):
        lines.append(",".join([f"{time:.9g}", part, *(f"{x:.9g}" for x in numbers)]))
    return "\n".join(lines) + "\n"
