"""A camera with errors, and what it records of a point or an edge, by a sum over instants.

The pictures are made without the package's kernel: light at 20,000 instants, each blurred by the
lens and collected by the pixels in closed form.
"""

import numpy as np
from scipy.special import erf

from mishutter import ParabolicMotion, SplineShutter

HALF = 0.01
SENT = ParabolicMotion(acceleration=30 / HALF**2, half_exposure=HALF)
BUILT = ParabolicMotion(acceleration=31.1 / HALF**2, half_exposure=HALF, velocity=-180.0)
COMMAND = SplineShutter([0.1, 0.3, 0.6, 0.8, 0.85, 0.8, 0.6, 0.3, 0.1])
PROFILE = SplineShutter([0.06, 0.2, 0.51, 0.77, 0.88, 0.84, 0.66, 0.36, 0.17])
BLUR = 0.62
SPEEDS = (-2500.0, -900.0, 0.0, 1300.0, 2700.0)


def expected(speed, target, *, position, columns=112, blur=BLUR, motion=BUILT, shutter=PROFILE):
    """Light on each pixel of a target of unit light in a fully open exposure."""
    tau = (np.arange(20_000) + 0.5) / 10_000 - 1
    time = tau * float(motion.half_exposure)
    weight = np.asarray(shutter.transmittance(tau)) / tau.size
    a, v = float(motion.acceleration), float(motion.velocity)
    path = position + a * time**2 - (speed - v) * time
    edges = np.arange(columns + 1.0)
    total = np.zeros(columns)
    for part in np.array_split(np.arange(tau.size), 40):
        x = edges[:, None] - path[None, part]
        z = x / blur
        share = (1 + erf(z / np.sqrt(2))) / 2
        if target == "edge":
            share = x * share + blur * np.exp(-z * z / 2) / np.sqrt(2 * np.pi)
        total += np.diff(share, axis=0) @ weight[part]
    return total


def centred(speed, *, motion=BUILT, columns=112):
    """Position at which the path of a target lies in the middle of the columns; px."""
    time = np.linspace(-1, 1, 101) * float(motion.half_exposure)
    path = np.asarray(motion.position(time)) - speed * time
    return float(columns - np.min(path) - np.max(path)) / 2


def recorded(light, electrons, rng, *, background=40.0, read_noise=3.0, per_level=1.0):
    """Whole levels of one row of pixels with Poisson and read noise."""
    charge = rng.poisson(light * electrons + background) + read_noise * rng.standard_normal(
        light.size
    )
    return np.rint(charge / per_level)
