r"""The exposure cut into cells of time in which nothing crosses an edge of a pixel.

A point that passes over the sensor along $x(t) = a t^2 - (s - v) t$ lies in pixel
$\lfloor x(t) - \varphi \rfloor$. Between two crossings, of any of several objects, the
image on the sensor stands still, so a capture of them is a finite sum of images, weighted
by the exposure of each cell.
"""

from typing import NamedTuple

import numpy as np

from mishutter._core import common_dtype
from mishutter.model import AbstractMotion, AbstractShutter, is_straight, piecewise

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_NUM_PANELS = 16
"""Panels of the exposure, short enough for these nodes to integrate the narrowest profile."""


class Cells(NamedTuple):
    """Cells of time in which the shutter transmits; the first cell alone where it never does.

    Attributes:
        shifts: Displacement of each object, whole px; shape `(cells, objects)`.
        light: Share of a fully open exposure; shape `(cells,)`.
        begin: Time at which each cell begins; s, shape `(cells,)`.
    """

    shifts: np.ndarray
    light: np.ndarray
    begin: np.ndarray


def pixel_phase(motion: AbstractMotion) -> float:
    """Where pixel 0 begins: 0 px if the sensor accelerates, -0.5 px if not."""
    return -0.5 if is_straight(motion) else 0.0


def exposure_cells(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    speeds: np.ndarray,
    times: np.ndarray | None = None,
) -> Cells:
    """Cells of an exposure of objects at several speeds.

    Args:
        shutter: Transmittance over the exposure.
        motion: Motion of the sensor.
        speeds: Speed of each object, px/s; shape `(objects,)`.
        times: Further times at which a cell ends, s.
    """
    a, half = float(motion.acceleration), float(motion.half_exposure)
    phase, relative = pixel_phase(motion), np.asarray(speeds, np.float64) - float(motion.velocity)
    profile = piecewise(shutter)
    dtype = profile.dtype() or common_dtype()
    breaks = np.asarray(profile.breakpoints(np.dtype(dtype)).high, np.float64) * half
    crossings = [_crossings(a, half, float(s), phase) for s in relative]
    fixed = [np.array([-half, half]), breaks, np.empty(0) if times is None else times]
    ends = np.unique(np.clip(np.concatenate(fixed + crossings), -half, half))
    begin, middle = ends[:-1], ends[:-1] + np.diff(ends) / 2
    panels = np.union1d(ends, np.linspace(-half, half, _NUM_PANELS + 1))
    width = np.diff(panels)
    nodes = panels[:-1, None] + width[:, None] * (_NODES + 1) / 2
    open_share = np.asarray(shutter.transmittance((nodes / half).astype(dtype)), np.float64)
    exposed = width / (4 * half) * (open_share @ _WEIGHTS)
    light = np.add.reduceat(exposed, np.searchsorted(panels, begin))
    position = (a * middle[:, None] - relative) * middle[:, None]
    lit = light > 0 if np.any(light > 0) else begin == begin[0]
    return Cells(np.floor(position - phase).astype(int)[lit], light[lit], begin[lit])


def _crossings(a: float, half: float, speed: float, phase: float) -> np.ndarray:
    """Times at which `a t^2 - speed t` passes an edge of a pixel."""
    turn = speed / (2 * a) if a > 0 else np.inf
    places = [t * (a * t - speed) for t in (-half, half)]
    places += [turn * (a * turn - speed)] if abs(turn) < half else []
    edges = np.arange(np.ceil(min(places) - phase), np.floor(max(places) - phase) + 1) + phase
    if a == 0:
        return -edges / speed if speed else np.empty(0)
    root = np.sqrt(np.maximum(speed**2 + 4 * a * edges, 0))
    far = (speed + np.copysign(root, speed)) / 2
    near = np.where(far != 0, -edges / np.where(far != 0, far, 1), 0)
    both = np.concatenate([far / a, near])
    return both[np.abs(both) <= half]
