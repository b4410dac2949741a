"""Frames on alternating parabolas, as rows see them that are exposed one after another."""

import numpy as np

from mishutter import TimedFrame
from mishutter.model.motion import FreeMotion, ParabolicMotion

PERIOD, STROKE, COUNT = 0.02, 54.6, 4


def alternating(time):
    """Parabolas of alternating direction, one a frame, without a step of the velocity; px."""
    frame = np.floor(time / PERIOD)
    share = (time / PERIOD - frame - 0.5) * 2
    return np.where(frame % 2 == 0, 1, -1) * STROKE / 2 * (share**2 - 1)


def frames_on_parabolas():
    """Frames on them, without gaps."""
    every, rate = [], STROKE / 2 / (PERIOD / 2) ** 2
    for k in range(COUNT):
        time = (k - (COUNT - 1) / 2) * PERIOD
        motion = FreeMotion(accelerations=[-rate], half_exposure=PERIOD / 2)
        if k % 2 == 0:
            motion = ParabolicMotion(acceleration=rate, half_exposure=PERIOD / 2)
        every.append(TimedFrame(motion, time, float(alternating(time))))
    return every
