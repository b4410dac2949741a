"""A camera with errors, and what it records of a point or an edge, by a sum over instants.

The pictures are made without the package's kernel: light at 20,000 instants, each blurred by the
lens and collected by the pixels in closed form.
"""

import numpy as np
from scipy.special import erf

from mishutter import ParabolicMotion, SplineShutter
from mishutter.model.shutters.spline import coefficient_times

HALF = 0.01
SENT = ParabolicMotion(acceleration=30 / HALF**2, half_exposure=HALF)
BUILT = ParabolicMotion(acceleration=31.1 / HALF**2, half_exposure=HALF, velocity=-180.0)
COMMAND = SplineShutter([0.1, 0.3, 0.6, 0.8, 0.85, 0.8, 0.6, 0.3, 0.1])
PROFILE = SplineShutter([0.06, 0.2, 0.51, 0.77, 0.88, 0.84, 0.66, 0.36, 0.17])
BLUR = 0.62
SPEEDS = (-2500.0, -900.0, 0.0, 1300.0, 2700.0)


def steep_profiles(rng, count=12):
    """Steep profiles of devices that were sent a symmetric one, by name; each may be mirrored.

    One rises fast and decays, one ramps, one opens about the middle, one leaks beside its window,
    one follows a Hann window by a lag of the order of the exposure, and one is held at random.
    """
    tau = coefficient_times(count)
    u = (1 + tau) / 2
    drawn = rng.uniform
    time = np.linspace(0, 1, 2001)
    lag, window = drawn(0.15, 0.4), np.sin(np.pi * time) ** 2
    behind = np.exp(-time / lag) * np.cumsum(np.exp(time / lag) * window) * (time[1] / lag)
    profiles = {
        "decays": (1 - np.exp(-u / drawn(0.02, 0.12))) * np.exp(-u / drawn(0.2, 0.5)),
        "ramps": u ** drawn(0.7, 1.6),
        "opens half-way": 1 / (1 + np.exp((drawn(-0.2, 0.3) - tau) / drawn(0.05, 0.15))),
        "leaks": 0.2 + 0.8 * np.exp(-(((tau - drawn(0.4, 0.7)) / drawn(0.25, 0.5)) ** 2)),
        "lags": np.interp(u, time, behind),
        "is held": np.convolve(drawn(0, 1, count + 2), [0.25, 0.5, 0.25], "valid"),
    }
    return {
        name: SplineShutter(drawn(0.7, 1) * (profile / profile.max())[:: rng.choice([-1, 1])])
        for name, profile in profiles.items()
    }


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
