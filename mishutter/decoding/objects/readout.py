r"""Things behind a rolling shutter, whose rows are exposed one after another.

Row $y$ is exposed $d(y) = \theta(y - \bar y)$ later than the middle one. A thing of the velocity
$\mathbf v$ is then at $\mathbf q = \mathbf p + \mathbf v\,d(q_y)$ in a frame of the time 0 where
it is at $\mathbf p$ at that time, and at $\mathbf q + \mathbf u\,t$ in one of the time $t$, with

$$\mathbf u = \frac{\mathbf v}{1 - v_y\theta}, \qquad
\mathbf q = \mathbf p + \mathbf u\,\theta\,(p_y - \bar y).$$

So stills show things as a global shutter would that are sheared and stretched, and move at
$\mathbf u$: they are found and restored as such, and set right at the end. What is at rest stays.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from mishutter.decoding.rolling import RowTimes
from mishutter.pictures.images import Axis

Velocity = Float[np.ndarray, "... 2"]
"""Velocities down and across; px/s."""


class Readout(NamedTuple):
    """The rows of a sensor, or its columns where pictures are turned, one after another."""

    line: float  # Time from one to the next; s. 0 for a global shutter
    axis: int  # 0 where they are rows
    middle: float  # The one whose times are those of the frames

    @staticmethod
    def of(times: RowTimes, axis: Axis) -> "Readout":
        """That of rows of some times, in pictures that are turned as for an axis of motion."""
        count = times.delays.size
        line = float(times.delays[-1] - times.delays[0]) / max(count - 1, 1)
        return Readout(line, int(axis == "columns"), (count - 1) / 2)

    def seen(self, velocity: Velocity) -> Velocity:
        """The velocities at which frames show things."""
        return velocity / (1 - self.line * velocity[..., self.axis, None])

    def true(self, seen: Velocity) -> Velocity:
        """The velocities of things, by those at which frames show them."""
        return seen / (1 + self.line * seen[..., self.axis, None])

    def covariance(
        self, seen: Float[np.ndarray, "2"], covariance: Float[np.ndarray, "2 2"]
    ) -> Float[np.ndarray, "2 2"]:
        """The covariance of a velocity, by that of the one at which frames show it."""
        over = 1 + self.line * float(seen[self.axis])
        slope = np.eye(2) * over
        slope[:, self.axis] -= seen * self.line
        slope = slope / over**2
        return slope @ covariance @ slope.T

    def set_right(
        self, picture: Float[np.ndarray, "rows columns"], seen: Float[np.ndarray, "2"], order: int
    ) -> Float[np.ndarray, "rows columns"]:
        """A picture of a thing as it is at the time 0, by how frames show it.

        Args:
            picture: The picture as the frames show it.
            seen: The velocity at which they do.
            order: Degree of the spline between pixels.
        """
        if not self.line or not np.any(seen):
            return picture
        matrix, aside = np.eye(2), seen * self.line
        matrix[:, self.axis] += aside
        offset = -aside * self.middle
        mode = "nearest" if order else "constant"
        return ndimage.affine_transform(picture, matrix, offset, order=order, mode=mode)  # type: ignore[arg-type]
