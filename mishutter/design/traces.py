"""A photodiode's trace of a shutter, in place of the shutter as it was designed.

A trace is a table of times and levels, noise and unequal steps included. The level of the closed
shutter counts as 0 and that of the open one as 1, so that a profile from a trace stands where a
profile that is sent stands: what a scene's device loses of the light is not in it.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from mishutter._core import (
    Bare,
    contents,
    require,
    require_finite,
    text_lines,
    unit_columns,
)
from mishutter.model import SplineShutter, fitted_coefficients

_COLUMNS = {"time": {"ms": 1e-3, "s": 1.0, "us": 1e-6}, "level": None}
_COUNTS = (8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
"""Coefficients of the splines that are tried."""
_SAMPLES_PER_COEFFICIENT = 3
_LEAST = 32
"""Fewest samples of an exposure."""
_LEAST_CLOSED = 8
"""Fewest samples outside the exposure that give the level of the closed shutter."""
_LONGEST_GAP = 1 / 16
"""Longest step of a trace inside the exposure, in units of the exposure."""


class Trace(NamedTuple):
    """Levels of a photodiode behind the shutter.

    Attributes:
        time: Ascending, on the camera's clock or any other; s, shape `(n,)`.
        level: In any unit, proportional to the light but for an offset; shape `(n,)`.
    """

    time: np.ndarray
    level: np.ndarray


class MeasuredProfile(NamedTuple):
    """A profile that a trace shows.

    Attributes:
        shutter: The profile.
        noise: Standard deviation of one sample about it, transmittance.
        closed: Level of the closed shutter, in the unit of the trace.
        opened: Level of the open one.
    """

    shutter: SplineShutter
    noise: float
    closed: float
    opened: float


def read_trace(path: str | Path) -> Trace:
    """Read a trace: columns `time` and `level`, a line of names and one of units.

    Times are in ms, s or us, levels in any unit.

    Raises:
        ValueError: if the file is no such trace, or its times do not ascend.
        OSError: if it cannot be read.
    """
    name = str(path)
    columns = unit_columns(text_lines(contents(path), name), name, _COLUMNS, tuple(_COLUMNS))
    trace = Trace(columns["time"], columns["level"])
    require_ascending(trace, name)
    return trace


def require_ascending(trace: Trace, name: str) -> None:
    """Refuse a trace whose times do not ascend."""
    time = np.asarray(trace.time)
    rises = np.diff(time) > 0
    fall = Bare(f"{time[1 + int(np.argmin(rises))]:g} s" if time.size > 1 else "one time")
    require(bool(rises.size) and bool(rises.all()), name, "have times that ascend", fall)


def within_exposure(trace: Trace, half_exposure: float, middle: float, name: str) -> np.ndarray:
    """Normalised time of each sample; the exposure is covered without a gap.

    Args:
        trace: The trace.
        half_exposure: $T$; s.
        middle: Mid-exposure on the clock of the trace; s.
        name: The trace's name in an error.

    Returns:
        Shape `(n,)`.

    Raises:
        ValueError: if the trace begins late, ends early, has a gap or too few samples.
    """
    tau = (np.asarray(trace.time) - middle) / half_exposure
    inside = np.abs(tau) <= 1
    count = int(inside.sum())
    requirement = (
        f"have at least {_LEAST} samples within the exposure of {half_exposure * 2e3:g} ms"
    )
    require(count >= _LEAST, name, requirement, count)
    ends = np.concatenate([[-1.0], tau[inside], [1.0]])
    gap = float(np.max(np.diff(ends))) / 2
    requirement = "cover the exposure in steps of at most 1/16 of it"
    require(gap <= _LONGEST_GAP, name, requirement, Bare(f"{gap * half_exposure * 2e3:.3g} ms"))
    return tau


def measured_profile(
    trace: Trace,
    *,
    half_exposure: float,
    middle: float = 0.0,
    closed: float | None = None,
    opened: float | None = None,
    name: str = "measured_profile(trace=...)",
) -> MeasuredProfile:
    r"""The profile that a noisy trace of unequal steps shows.

    Cubic splines of 8 to 256 coefficients are fitted by least squares, each sample at its own
    time, and the one of the smallest generalised cross-validation
    $\frac{1}{m}\lVert r\rVert^2 / (1 - n/m)^2$ (Craven and Wahba 1979) is taken: it needs no
    level of noise, and gives one, $\lVert r\rVert^2/(m - n)$. Its coefficients are then
    fitted within [0, 1]. A step of the shutter is as steep as the spline, 1/125 of the
    exposure at the most coefficients.

    Args:
        trace: Times and levels.
        half_exposure: $T$; s.
        middle: Mid-exposure on the clock of the trace; s.
        closed: Level of the closed shutter; by default the mean of the samples outside the
            exposure.
        opened: Level of the open shutter; by default the greatest of the spline, so that the
            fullest moment of the exposure counts as fully open.
        name: The trace's name in an error.

    Raises:
        ValueError: if times do not ascend or leave a gap in the exposure, a number is not
            finite, or the levels do not tell open from closed.
    """
    for value in (trace.time, trace.level, middle):
        require_finite(name, value)
    require_ascending(trace, name)
    tau = within_exposure(trace, half_exposure, middle, name)
    inside = np.abs(tau) <= 1
    dark = trace.level[~inside]
    requirement = (
        f"have {_LEAST_CLOSED} samples outside the exposure, or a level of the closed shutter"
    )
    require(closed is not None or dark.size >= _LEAST_CLOSED, name, requirement, int(dark.size))
    black = float(np.mean(dark)) if closed is None else closed
    at, level = tau[inside], trace.level[inside] - black
    white, residual = _smoothed(at, level)
    white = white if opened is None else opened - black
    noise = float(np.sqrt(residual[0]))
    requirement = "tell the open shutter from the closed one by more than its noise"
    got = Bare(f"levels {black:g} and {black + white:g}, noise {noise:.3g}")
    require(white > 2 * noise, name, requirement, got)
    count = int(residual[1])
    coefficients = fitted_coefficients(at, level / white, count, symmetric=False)
    shutter = SplineShutter(coefficients)
    return MeasuredProfile(shutter, noise / white, black, black + white)


def _smoothed(tau: np.ndarray, level: np.ndarray) -> tuple[float, tuple[float, int]]:
    """Greatest value of the best spline, its residual variance and number of coefficients."""
    from scipy.interpolate import BSpline

    longest = float(np.max(np.diff(tau)))
    best = None
    for count in _COUNTS:
        if count * _SAMPLES_PER_COEFFICIENT > tau.size or longest > 2 / (count - 3):
            continue
        knots = np.concatenate([[-1.0] * 3, np.linspace(-1, 1, count - 2), [1.0] * 3])
        basis = BSpline.design_matrix(tau, knots, 3).toarray()
        fitted, *_ = np.linalg.lstsq(basis, level, rcond=None)
        squares = float(np.sum((level - basis @ fitted) ** 2))
        score = squares / (1 - count / tau.size) ** 2
        if best is None or score < best[0]:
            greatest = float(np.max(BSpline(knots, fitted, 3)(np.linspace(-1, 1, 1001))))
            best = score, greatest, (squares / (tau.size - count), count)
    return best[1:]  # type: ignore[index]
