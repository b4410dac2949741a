"""Scenes drawn at random."""

import numpy as np

from mishutter import (
    ChippedShutter,
    GaussianShutter,
    Limits,
    Optics,
    ParabolicMotion,
    Scene,
    SplineShutter,
    StillCamera,
    Texture,
    TukeyShutter,
)

LIMITS = Limits(max_stroke=30.0, max_top_speed=2e4, min_half_exposure=5e-4, max_half_exposure=0.03)
PROFILE = SplineShutter.fit(TukeyShutter(0.45), 10, symmetric=True)
SHUTTERS = (GaussianShutter(0.3), PROFILE, ChippedShutter([0.2, 0.9, 1.0, 0.4]))


def random_scene(seed):
    """A scene, a motion and a shutter; speeds that repeat, mirror, never occur or stand still.

    Twelve kinds, so that two hundred scenes share some dozens of compiled programs.
    """
    random = np.random.default_rng(seed)
    moving = random.uniform(-1500, 1500, 2)
    kind = seed % 4
    speeds = {
        0: [*moving, *-moving, 0.0],
        1: [moving[0], moving[0], moving[1], 0.0, 700.0],
        2: [0.0, 0.0, 900.0, -900.0, 0.0],
        3: [*moving, 400.0, -400.0, 300.0],
    }[kind]
    weights = random.uniform(0.2, 1, 5)
    if kind == 2:
        weights[2:4] = 0
    if kind == 3:
        weights[1] = 0
    cutoff = (0.5, 0.27, 0.11)[seed % 3]
    scene = Scene(
        speeds,
        weights / weights.sum(),
        photon_rate=10 ** random.uniform(3, 7),
        read_noise=random.uniform(0, 12) * random.integers(2),
        optics=Optics(cutoff_frequency=cutoff, lens_blur=0.4 * (seed % 5)),
        picture=Texture(power_spectrum=random.uniform(0, 1, 256) if seed % 2 else None),
        limits=LIMITS,
    )
    half = 0.01 * random.uniform(0.8, 1.1)
    motion = ParabolicMotion(acceleration=random.uniform(9, 14) / half**2, half_exposure=half)
    still = StillCamera(half_exposure=half)
    return scene, still if seed % 12 in (3, 4) else motion, SHUTTERS[seed % 3]
