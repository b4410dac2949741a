r"""Frames of a rolling shutter, whose rows are exposed one after another.

Row $y$ sees everything $d_y$ later than the middle row: at a velocity it has the response
$A_k(\mathbf f; d_y)$ of its own. Where rows are read across the motion of an axis, each is a
picture of its own, and nothing else changes. Where things may move along the readout, a frame at
$y$ is $\sum_{\mathbf f} A_k(\mathbf f; d_y)\,\hat f\,e^{2\pi i\,\mathbf f\cdot\mathbf u}$ at each
of its pixels $\mathbf u$.

Along one axis that is a product with a matrix. In the plane the mean way of a thing up to each row
comes first, at any place between pixels, by a non-uniform DFT down the columns; what is left of
$A_k$ changes slowly with $d$, and is a sum of its values at few delays, whose weights are those of
least squares over pictures of the power $S$.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float
from scipy import sparse

from mishutter.camera.rows import fast_length
from mishutter.evaluation.instants import Instants
from mishutter.model.scene import Scene
from mishutter.model.sensor import Sensor
from mishutter.model.sequences import AxisPath, TimedFrame
from mishutter.plane.frames import PlaneFrames

_WIDTH, _FINER = 8, 1.5
"""Points of the fine grid that a place between pixels is interpolated from, and how fine it is."""


class RowTimes(NamedTuple):
    """When the rows of pictures are exposed that are turned so that things move along rows."""

    delays: Float[np.ndarray, "d"]  # Of each later than the middle; s. A global shutter has one, 0
    is_along: bool = False  # Whether they were rows across the motion, and are columns here

    @staticmethod
    def of(sensor: Sensor, shape: tuple[int, ...]) -> "RowTimes":
        """Those of pictures of so many rows and columns, once they are turned."""
        if not sensor.is_rolling:
            return GLOBAL
        is_along = sensor.axis == "columns"
        return RowTimes(sensor.row_delays(shape[-1 if is_along else -2]), is_along)

    @property
    def is_rolling(self) -> bool:
        """Whether rows differ in their times."""
        return self.delays.size > 1

    @property
    def across(self) -> Float[np.ndarray, "d"]:
        """Delays of rows that are pictures of their own, or the one of all."""
        return np.zeros(1) if self.is_along else self.delays

    def of_rows(self, some: slice | np.ndarray) -> "RowTimes":
        """Those of some rows."""
        is_same = self.is_along or not self.is_rolling
        return self if is_same else RowTimes(self.delays[some])

    @property
    def turned(self) -> "RowTimes":
        """Those of pictures whose rows and columns are exchanged."""
        return RowTimes(self.delays, not self.is_along) if self.is_rolling else self


GLOBAL = RowTimes(np.zeros(1))
"""All rows at once."""


def instants_of_rows(
    taken: Sequence[TimedFrame], scene: Scene, fastest: float, delays: Float[np.ndarray, "d"]
) -> Instants:
    """Instants of frames along an axis, at some delays of each of them in turn."""
    if delays.size == 1 and delays[0] == 0:
        return Instants.of(taken, fastest)
    path = AxisPath.of(taken, scene.sensor.readout_time, scene.limits)
    each = [Instants.of(path, fastest, delay=delay) for delay in delays.tolist()]
    count = max(one.time.shape[1] for one in each)

    def together(parts: list[np.ndarray], mode: str) -> np.ndarray:
        """Nodes of the frames, with all delays of one beside each other."""
        wide = [(*[(0, 0)] * (each.ndim - 1), (0, count - each.shape[-1])) for each in parts]
        padded = [np.pad(one, by, mode) for one, by in zip(parts, wide, strict=True)]  # type: ignore[call-overload]
        whole = np.stack(padded, axis=-2)
        return whole.reshape(*whole.shape[:-3], -1, count)

    return Instants(
        together([one.time for one in each], "edge"),
        together([one.place for one in each], "edge"),
        together([one.weight for one in each], "constant"),
        np.repeat(each[0].exposure, delays.size),
    )
