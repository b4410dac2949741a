"""A small scene that searches run on in seconds."""

from mishutter import Limits, ParabolicMotion, Scene
from mishutter.evaluation.needs import Plan

FREE_NAMES = ("shutter", "half_exposure", "velocity", "acceleration")
"""All that moves on a sensor of constant acceleration."""
MOTION = ParabolicMotion(acceleration=22.0 / 1e-4, half_exposure=1e-2)
_BOUNDS = {
    "max_stroke": 30.0,
    "max_top_speed": 2e4,
    "min_half_exposure": 5e-4,
    "max_half_exposure": 0.03,
}
LIMITS = Limits(**_BOUNDS)
SCENE = Scene.uniform(
    max_speed=2000.0, num_speeds=5, photon_rate=1e5, read_noise=10.0, limits=LIMITS
)
SMALL = Plan(num_taps=64, dft_length=256, num_frequencies=64, num_nodes=192, skips=True)

OUTLIER = Scene(
    [-300.0, 0.0, 310.0, 8000.0],
    [0.333, 0.333, 0.333, 0.001],
    photon_rate=2e5,
    read_noise=4.0,
    limits=LIMITS,
)
"""Rare objects that are left behind at less loss than keeping up with them costs."""
SLOW = ParabolicMotion(acceleration=15.0 / 9e-4, half_exposure=3e-2)
"""A motion that leaves them behind."""
