"""Frames and levels of a small reference of bursts in the plane, which a page derives.

The levels are those of a NumPy program of its own, on 40 radii, 16 directions and 48 velocities.
"""

import numpy as np

from mishutter import PlaneFrames, Scene

WINDOW = 0.08
SCENES = {"A": (3e4, 2800.0, 10.0), "B": (1e5, 4500.0, 8.0), "C": (3e4, 2800.0, 2.0)}
"""Photo-electrons a second, greatest speed in px/s, and read noise."""
_STILLS = {
    "A": (3.7e-3, 3.2e-3, 2.8e-3, 2.45e-3),
    "B": (1.6e-3, 1.37e-3, 1.2e-3, 1.05e-3),
    "C": (2.27e-3, 1.94e-3, 1.66e-3, 1.41e-3),
}
_PIECES = 1024


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
    if kind in ("crossed", "diagonal"):
        stroke, exposure = min(40.0, 0.3 * top * period), min(period, 0.04)
        first = 0.0 if kind == "crossed" else np.pi / 4
        ends = np.zeros((2, count, 2))
        for k in range(count):
            turn = first + k % 2 * np.pi / 2
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
