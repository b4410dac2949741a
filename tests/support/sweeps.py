"""A small scene and grid that are swept in seconds, and how near its numbers must be."""

import numpy as np

from mishutter import HannShutter, Limits, ParabolicMotion, RectShutter, Scene, evaluate

# Tasks of a cluster are sent a grid, which `sweep` makes for itself.
from mishutter.sweeps.grid import Grid

LIMITS = Limits(max_stroke=9.0, max_top_speed=4e3, min_half_exposure=1e-3, max_half_exposure=0.02)
SCENE = Scene(
    [0.0, 310.0, -310.0, 700.0, -430.0],
    [0.3, 0.2, 0.2, 0.1, 0.2],
    photon_rate=2e5,
    read_noise=6.0,
    limits=LIMITS,
)
ACCELERATIONS = np.array([0.0, 3e4, 9e4, 2.6e5, 1.1e6])
HALF_EXPOSURES = np.array([0.5e-3, 1e-3, 3.1e-3, 7e-3, 0.02, 0.03])
SHUTTERS = {"rect": RectShutter(), "Hann": HannShutter()}
TALL = np.arange(1, 301) * 3e3
"""Accelerations that make several blocks."""

RELATIVE = 1e-9
"""Difference from `evaluate`: other quadrature, other order of sums."""
TAP_ROUNDING = 1e-15
"""Difference of anything at all: kernels that are equal differ by rounding of their taps."""
ROOT_OF_BOUND = 1e-11
"""Difference of the root of the bound's share: a response next to a spectral zero is
known to rounding of the largest, not of itself."""


def grid(**others):
    """Arguments of the small sweep."""
    given = {
        "accelerations": ACCELERATIONS,
        "half_exposures": HALF_EXPOSURES,
        "shutters": SHUTTERS,
    }
    return given | others


def asked_for(rows, columns):
    """A sweep of a grid of some size."""
    return Grid(
        np.arange(rows) + 1.0,
        np.arange(columns) + 1.0,
        None,
        {"0": SCENE},
        dict(SHUTTERS),
        ("expected_psnr",),
        np.array([1.0, 2.0]),
        None,
        None,
        None,
        True,
    )


def motion_at(dataset, row, column):
    """The motion of a point."""
    return ParabolicMotion(
        acceleration=float(dataset.acceleration[row]),
        half_exposure=float(dataset.half_exposure[column]),
        velocity=float(dataset.velocity),
    )


def inside_points(dataset):
    """Indices of the points within limits."""
    outside = dataset.outside.values
    return [tuple(index) for index in np.argwhere(outside == 0)]


def differences(dataset, scene, shutters, points):
    """What is too far from `evaluate`, as text; none if all is well."""
    wrong = []
    for row, column in points:
        motion = motion_at(dataset, row, column)
        for name, shutter in shutters.items():
            exact = evaluate(scene, motion, shutter)
            at = dataset.isel(acceleration=row, half_exposure=column).sel(shutter=name)
            if (int(at.dft_length), int(at.num_taps)) != (exact.dft_length, exact.num_taps):
                wrong.append(f"{name} {row} {column} sizes")
            for metric in set(dataset.data_vars) & set(vars(exact)) - {"dft_length", "num_taps"}:
                found, right = float(at[metric]), float(getattr(exact, metric))
                if metric == "bound_share":
                    near = abs(np.sqrt(found) - np.sqrt(right)) < ROOT_OF_BOUND
                else:
                    near = found == right or abs(found - right) < RELATIVE * right + TAP_ROUNDING
                if not near:
                    wrong.append(f"{name} {row} {column} {metric}: {found} {right}")
    return wrong


def many(**others):
    """A sweep of three blocks."""
    return grid(accelerations=TALL, half_exposures=[2e-3, 5e-3], **others)
