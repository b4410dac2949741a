"""Frames and levels of a small reference of bursts in the plane, which a page derives.

The levels are those of a NumPy program of its own, on 40 radii, 16 directions and 48 velocities.
Where that is too coarse, by 0.01 to 0.2 dB and mostly of circles, they are on a lattice of 2000
radii, 6 directions and 64 velocities.
"""

import numpy as np

from mishutter import (
    BurstMode,
    Design,
    EvenVelocities,
    Limits,
    PlaneFrames,
    Scene,
)
from mishutter.model.exposures import exposures_in_plane
from mishutter.model.stages import StagePath
from mishutter.model.velocities import AbstractVelocities

WINDOW = 0.08
SCENES = {"A": (3e4, 2800.0, 10.0), "B": (1e5, 4500.0, 8.0), "C": (3e4, 2800.0, 2.0)}
"""Photo-electrons a second, greatest speed in px/s, and read noise."""
_STILLS = {
    "A": (3.7e-3, 3.2e-3, 2.8e-3, 2.45e-3),
    "B": (1.6e-3, 1.37e-3, 1.2e-3, 1.05e-3),
    "C": (2.27e-3, 1.94e-3, 1.66e-3, 1.41e-3),
}
_PIECES = 1024
LEVELS = {
    "A": {
        (1, "still"): 25.18,
        (1, "crossed"): 26.359,
        (1, "circle"): 26.353,
        (1, "sines"): 26.321,
        (2, "still"): 25.951,
        (2, "crossed"): 28.067,
        (2, "circle"): 27.583,
        (2, "sines"): 27.942,
        (4, "still"): 26.746,
        (4, "crossed"): 28.793,
        (4, "circle"): 28.768,
        (4, "sines"): 28.911,
        (8, "still"): 27.571,
        (8, "crossed"): 29.346,
        (8, "circle"): 29.426,
        (8, "sines"): 29.55,
    },
    "B": {
        (1, "still"): 26.988,
        (1, "crossed"): 26.991,
        (1, "circle"): 26.563,
        (1, "sines"): 27.681,
        (2, "still"): 27.86,
        (2, "crossed"): 29.190,
        (2, "circle"): 28.007,
        (2, "sines"): 29.019,
        (4, "still"): 28.769,
        (4, "crossed"): 30.625,
        (4, "circle"): 30.045,
        (4, "sines"): 30.688,
        (8, "still"): 29.727,
        (8, "crossed"): 31.718,
        (8, "circle"): 31.75,
        (8, "sines"): 31.895,
    },
    "C": {
        (1, "still"): 27.089,
        (1, "crossed"): 26.719,
        (1, "circle"): 26.547,
        (1, "sines"): 26.508,
        (2, "still"): 28.054,
        (2, "crossed"): 28.481,
        (2, "circle"): 27.974,
        (2, "sines"): 28.338,
        (4, "still"): 29.069,
        (4, "crossed"): 29.568,
        (4, "circle"): 29.523,
        (4, "sines"): 29.677,
        (8, "still"): 30.148,
        (8, "crossed"): 30.696,
        (8, "circle"): 30.758,
        (8, "sines"): 30.904,
    },
}
"""Levels by the number and the kind of frames; dB."""
CEILINGS = {
    "A": {1: 27.614, 2: 28.452, 4: 29.188, 8: 29.769},
    "B": {1: 28.906, 2: 29.985, 4: 31.097, 8: 32.211},
    "C": {1: 27.831, 2: 28.878, 4: 29.984, 8: 31.156},
}
"""Ceilings by the number of frames; dB."""


def scene_of(slug: str) -> Scene:
    rate, fastest, read = SCENES[slug]
    return Scene.any_direction(fastest, photon_rate=rate, read_noise=read)


def frames_of(slug: str, count: int, kind: str) -> PlaneFrames:
    """Frames of a kind: still, crossed, circle or sines."""
    _, top, _ = SCENES[slug]
    period = WINDOW / count
    times = (np.arange(count) - (count - 1) / 2) * period
    if kind == "still":
        exposure = _STILLS[slug][(1, 2, 4, 8).index(count)]
        return PlaneFrames(times, np.full(count, exposure), np.ones(1), np.zeros((2, 2)))
    if kind == "crossed":
        stroke, exposure = min(40.0, 0.3 * top * period), min(period, 0.04)
        ends = np.zeros((2, count, 2))
        for k in range(count):
            turn = k % 2 * np.pi / 2
            speed = 4 * stroke / exposure * np.array([-1, 1])
            ends[:, k] = np.outer([np.cos(turn), np.sin(turn)], speed)
        gaps = np.tile([exposure, period - exposure], count)[:-1]
        return PlaneFrames(times, np.full(count, exposure), gaps, ends.reshape(2, -1))
    speed, drift = (0.76, 0.0) if kind == "circle" else (0.72, 0.35)
    radius = 10.0 if count > 1 else 20.0
    time = np.linspace(-WINDOW / 2, WINDOW / 2, _PIECES + 1)
    a, b = (speed * top / radius + e * np.pi * drift / WINDOW for e in (-1, 1))
    velocity = speed * top * np.stack([-np.sin(a * time), np.cos(b * time)])
    return PlaneFrames(times, np.full(count, period), np.full(_PIECES, WINDOW / _PIECES), velocity)


def stage_paths(design: Design) -> list[StagePath]:
    """The paths of its stage, along rows and columns."""
    return [*design.exposures.stage_paths(design.scene).values()]


def a_plane_design(
    law: AbstractVelocities | None = None, limits: Limits | None = None, **others: object
) -> Design:
    """Three frames on two sines, whose stage has limits; its level is none of a search."""
    if limits is None:
        limits = Limits(max_half_exposure=0.01, max_travel=60.0, max_acceleration=9e5)
    law = EvenVelocities(1700.0, 1100.0, angle=0.3) if law is None else law
    burst = BurstMode(frames_per_s=90.0, window=0.05, max_frames=3)
    parts = {"photon_rate": 3e4, "read_noise": 9.0, "limits": limits, "burst": burst}
    scene = Scene.any_direction(law, **(parts | others))
    times, exposures = np.array([-0.012, 0.0, 0.011]), np.array([0.009, 0.0103, 0.011])
    whole = times[-1] - times[0] + (exposures[0] + exposures[-1]) / 2
    phase = np.linspace(-np.pi, np.pi, 65)
    velocities = np.stack([-800.0 * np.sin(1.5 * phase), 700.0 * np.cos(1.8 * phase)])
    frames = PlaneFrames(times, exposures, np.full(64, whole / 64), velocities)
    return Design(scene, exposures_in_plane(scene, "two sines", frames, 27.25))
