"""The path of a stage as text."""

import numpy as np
from jaxtyping import Float

from mishutter.model import SecondOrderStage, StagePath


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
