r"""The loss of frames in the plane by things that enter and leave the sensor.

As along one axis (`evaluation/sequences.py`), a point that the sensor sees in a part of the
exposures, which alone have the responses $H_k^u$, is restored with the error of
$\sum_k \Re(\bar H_k H_k^u)/N_k$ in place of $\sum_k |H_k|^2/N_k$. When a point is on the sensor
depends on both components of its velocity: the mean is over velocities that stand for the law's,
and over points of the sensor in the middle of the frames, but for those that no frame sees, which
a decoder knows from their neighbours alone.

The response at a point is that of a sensor on which this changes slowly. Of Gaussian fields on
256 px the best linear decoder loses 0.1 to 0.3 dB more by four frames. By two within which things
move by a third to a half of the sensor it loses 0.4 dB more at rest, and 0.7 to 1.5 on two sines:
`LONG` is where that begins.
"""

import numpy as np

from mishutter.evaluation.sequences import decibels_over
from mishutter.model.scene import Scene
from mishutter.plane.frames import PlaneFrames
from mishutter.plane.levels import SEARCHED, Fan, Light, require_velocities

LONG = 0.25
"""Way of a thing within one frame, over the sensor's width, above which moving frames lose more."""
_POINTS = 10
"""Points along each side that stand for the sensor."""


def loss_of_borders(scene: Scene, frames: PlaneFrames, *, width: float) -> float:
    """Decibels that concrete frames lose on a square sensor that things enter and leave.

    Args:
        scene: Velocities in any direction, light and noise.
        frames: The frames.
        width: Length of the sensor's sides, or of an object's by which it is registered; px.
    """
    law = require_velocities(scene)
    fan, light = Fan.of(scene, SEARCHED), Light.of(scene)
    signal = np.asarray(light.signal(fan)).ravel()
    gains = np.asarray(light.gains(frames.exposures), np.float64)
    time, _, weights = map(np.asarray, frames.nodes(frames.num_panels(law.fastest)))
    time = np.asarray(frames.times)[:, None] + time
    middle = np.array((time[0, 0] + time[-1, -1]) / 2)
    time, place = time - middle, frames.place(time) - frames.place(middle)[:, None, None]
    shares = fan.weight.ravel()
    points = (np.arange(_POINTS) + 0.5) / _POINTS * width
    velocities, masses = law.stand_ins()
    errors = np.zeros(2)
    for velocity, mass in zip(velocities, masses, strict=True):
        ways = np.asarray(place) - velocity[:, None, None] * time
        there, every = np.zeros((_POINTS**2, shares.size)), np.zeros(shares.size)
        is_seen = np.zeros(_POINTS**2, bool)
        for way, gain in zip(np.moveaxis(ways, 1, 0), gains, strict=True):
            waves = weights[:, None] * _waves(fan, way)
            whole = np.sum(waves, axis=0)
            most = np.abs(whole) ** 2
            # The sensor sees a point as long as this lies on it both along rows and columns.
            across, down = (np.abs(points[:, None] + x - width / 2) <= width / 2 for x in way)
            seen = (down[:, None] & across).reshape(-1, way.shape[1]).astype(np.float64)
            is_seen |= np.any(seen > 0, axis=1)
            part = (whole.conj() * (seen @ waves)).real
            there += gain * np.clip(part, 0.0, most)
            every += gain * most
        lost = [1 / (1 + signal * each) @ shares for each in (there, every)]
        ends = np.mean(lost[0][is_seen]) if np.any(is_seen) else 1.0
        errors += mass * np.array([ends, lost[1]])
    return decibels_over(*errors)


def _waves(fan: Fan, way: np.ndarray) -> np.ndarray:
    """Waves of the fan's frequencies at places along rows and columns, one after another."""
    radius = fan.radius[:, None]
    across, down = ((radius * turn(fan.direction)).ravel() for turn in (np.cos, np.sin))
    return np.exp(-2j * np.pi * (way[0][:, None] * across + way[1][:, None] * down))
