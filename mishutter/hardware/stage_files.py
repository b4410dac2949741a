"""The path of a stage as text."""

import numpy as np
from jaxtyping import Float, Int

from mishutter._core import require
from mishutter.hardware.drive_files import MAX_STEPS
from mishutter.model import SecondOrderStage, StagePath


def path_steps(path: StagePath, first: float, step: float, count: int) -> Int[np.ndarray, "n"]:
    """Numbers of the equal steps from the rest before a path to the rest after it.

    Args:
        path: From rest to rest.
        first: Time of step 0, the first of an exposure or a burst; s.
        step: Length of a step; s.
        count: Steps of the exposure or the burst.

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
    path: StagePath,
    times: Float[np.ndarray, "n"],
    parts: np.ndarray,
    stage: SecondOrderStage | None,
) -> str:
    """A line of names, a line of units, then a time, its part of the path, place and velocity.

    Args:
        path: From rest to rest.
        times: Times on its clock; s.
        parts: The part of the path that begins at each, in words.
        stage: How the stage follows; where it is known, the last column is the command for it.
    """
    position, velocity = path.at(times)
    columns = {"sensor_position,px": position, "sensor_velocity,px/s": velocity}
    if stage is not None:
        columns["sent_position,px"] = stage.sent_for(path, times)
    names, units = zip(*(name.split(",") for name in columns), strict=True)
    lines = [",".join(["time", "part", *names]), ",".join(["ms", "", *units])]
    for time, part, *numbers in zip(times * 1e3, parts, *columns.values(), strict=True):
        lines.append(",".join([f"{time:.9g}", part, *(f"{x:.9g}" for x in numbers)]))
    return "\n".join(lines) + "\n"
