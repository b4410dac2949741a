r"""The path of a stage as an encoder recorded it, in place of the path that it was sent.

Each exposure has a number of equal pieces, in each of which at least two samples fall. A quadratic
spline whose knots are the ends of the pieces is fitted to the samples by least squares: its
velocity is linear in each piece, as that of the package's paths is, so that places and velocities
follow from it exactly, and the noise of the encoder is averaged.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import Unquoted, require, require_finite, require_number
from mishutter.design.design import Design
from mishutter.hardware.trace_files import METRES, TimedColumns, timed_columns
from mishutter.model.frame_path import FramePath, Lights, TimedFrame
from mishutter.model.motion import FreeMotion

_NAMES = ("x", "y"), ("sensor_position_x", "sensor_position_y"), ("stage_x", "stage_y")
"""Names of the places along two axes."""
_ROUNDING = 1e-9
"""Share of the burst below which a time is one of rounding."""
_POINTS = 65
"""Points of an exposure at which paths are compared."""


class RecordedPath(NamedTuple):
    """Places of a stage, along one axis or two."""

    time: Float[np.ndarray, "n"]  # Times, ascending, on any clock; s
    place: Float[np.ndarray, "axes n"]  # Places along rows, or rows and columns; px


class PathDifference(NamedTuple):
    """How far a recorded path is from the planned one while frames are exposed.

    Where the whole stands does not count: it displaces the picture alone.
    """

    rms: float  # Root of the mean square, both axes together; px
    greatest: float  # px
    doubt: str  # Why it may be no record of these frames, in a sentence; empty if it is near

    @property
    def text(self) -> str:
        """The difference in words."""
        return f"{self.rms:.2g} px r.m.s. and {self.greatest:.2g} px at most"


def read_path(
    path: str | Path,
    *,
    num_axes: int = 1,
    pixel_pitch: float | None = None,
    scale: float | None = None,
) -> RecordedPath:
    """Read the times and places that an encoder recorded, from text in columns under headings.

    Times are in s, ms, us or ns, and places in px, nm, um, mm or m, by the headings or the line
    below them: `time (ms),x (um),y (um)`. The `stage.csv` of `export` is such a file. Places in
    counts or volts have a `scale`.

    Args:
        path: A file, as `read_trace` takes it.
        num_axes: Axes of the stage, 1 or 2.
        pixel_pitch: Distance of the pixels, for places that are not in px; m.
        scale: Pixels that a place of 1 in the file is, whatever its unit, below 0 where places
            count backwards; px.

    Raises:
        ValueError: if columns or units are missing, times fall, a number is not finite, or the
            scale is 0.
        OSError: if the file cannot be read.
    """
    if scale is not None:
        require_number("read_path(scale=...)", scale)
        require(scale != 0, "read_path(scale=...)", "be above or below 0 px", scale)
    columns = timed_columns(path)
    names = _names_in(columns, num_axes, str(path))
    places = [
        columns.numbers(name) * scale
        if scale is not None
        else columns.numbers(name) / _unit(columns, name, pixel_pitch, str(path))
        for name in names
    ]
    time = columns.time
    steps = np.diff(time)
    got = Unquoted(f"{time[1 + int(np.argmax(steps <= 0))]:g} s" if time.size > 1 else "one time")
    require(time.size > 1 and bool(np.all(steps > 0)), str(path), "have times that ascend", got)
    return RecordedPath(time, np.array(places))


def _names_in(columns: TimedColumns, num_axes: int, name: str) -> tuple[str, ...]:
    """The names of the columns of places."""
    got = Unquoted(", ".join(columns.names) or "none")
    if num_axes == 2:
        both = [pair for pair in _NAMES if set(pair) <= set(columns.names)]
        requirement = (
            "have columns x and y, for a stage of two axes, under a line such as "
            "`time (ms),x (um),y (um)`"
        )
        require(bool(both), name, requirement, got)
        return both[0]
    usual = ("x", "sensor_position", "position", "place", "stage_x")
    alone = [each for each in usual if each in columns.names]
    one = alone or (columns.names if len(columns.names) == 1 else [])
    is_one = bool(one) and not any(set(pair) <= set(columns.names) for pair in _NAMES)
    requirement = (
        "have one column of places, for a stage of one axis, under a line such as "
        "`time (ms),x (um)`"
    )
    require(is_one, name, requirement, got)
    return (one[0],)


def _unit(columns: TimedColumns, column: str, pitch: float | None, name: str) -> float:
    """The unit of a column over a pixel, by which its numbers are divided."""
    unit = columns.unit(column).casefold()
    if unit == "px":
        return 1.0
    requirement = (
        f"have the unit of {column} by its heading, px, nm, um, mm or m, as `{column} (um)`, or a "
        "scale for counts and volts: `--stage-scale-px` or `scale`, px for each"
    )
    require(unit in METRES, name, requirement, Unquoted(unit or "no unit"))
    requirement = f"be in px, or the scene say pixel_pitch_um, for {column} in {unit}"
    require(pitch is not None, name, requirement, Unquoted("no pitch"))
    return float(pitch or 1.0) / METRES[unit]


def with_recorded_path(
    design: Design, path: RecordedPath, *, middle: float = 0.0, name: str = "path"
) -> tuple[Design, PathDifference]:
    """A design whose sensor was where an encoder recorded its stage, and how far that is off.

    Args:
        design: The design. If the camera turns, its pan is added to the path.
        path: The record, over all exposures.
        middle: Mid-exposure, or the middle of the burst, on the clock of the record; s.
        name: The record's name in an error.

    Returns:
        The design, and the difference of the paths.

    Raises:
        ValueError: if the record has another number of axes than the stage, does not reach over
            the exposures, or has few samples in one.
    """
    require(isinstance(design, Design), "design", "be a design", design)
    require_number("with_recorded_path(middle=...)", middle)
    for row in path:
        require_finite(name, row)
    taken = design.exposures
    got, axes = Unquoted(f"{len(path.place)}"), len(taken.axes)
    require(len(path.place) == axes, name, f"have places along {axes} axes", got)
    spline = _Spline.through(path, taken.lights, middle, name)
    planned = taken.place(_times(taken.lights))
    pan = np.atleast_1d(taken.pan)
    if not taken.in_plane:
        frames = tuple(spline.frame(frame, float(pan[0])) for frame in taken.along)
    else:
        times, exposures = (np.asarray(x, np.float64) for x in (taken.times, taken.exposures))
        velocities = spline.velocities + pan[:, None]
        frames = FramePath(times, exposures, np.diff(spline.knots), velocities)
    as_recorded = replace(taken, frames=frames)
    if design.sequence is None:
        recorded = design.with_one(motion=as_recorded.motion)
    else:
        recorded = replace(design, sequence=as_recorded)
    return recorded, spline.difference(taken.lights, planned, pan)


class _Spline(NamedTuple):
    """A quadratic spline along each axis, from the first light to the last."""

    knots: Float[np.ndarray, "k"]  # Ends of its pieces, on the clock of the frames; s
    place: Callable[[np.ndarray], np.ndarray]  # Places at some times, px; shape `(axes, *times)`
    velocities: Float[np.ndarray, "axes k"]  # Those at the knots; px/s

    @staticmethod
    def through(path: RecordedPath, lights: Lights, middle: float, name: str) -> "_Spline":
        """The spline through the samples of some exposures, and of the time between them."""
        from scipy.interpolate import make_lsq_spline

        time = path.time - middle
        begin, end = lights[0][0], lights[-1][1]
        span = f"times from {1e3 * path.time[0]:.4g} to {1e3 * path.time[-1]:.4g} ms"
        wanted = " to ".join(f"{1e3 * (each + middle):.4g}" for each in (begin, end))
        requirement = (
            f"reach over all exposures, {wanted} ms by its clock, or be read with that clock's "
            "reading at their middle: `middle` or `--mid-exposure-ms`"
        )
        reaches = bool(time[0] <= begin and time[-1] >= end)
        require(reaches, name, requirement, Unquoted(span))
        ends = [edge for lit in lights for edge in lit]
        knots = [np.array([begin])]
        for index, (first, last) in enumerate(pairwise(ends)):
            if last - first <= _ROUNDING * (end - begin):
                continue
            inner = time[(time >= first) & (time <= last)]
            count = inner.size
            is_many = index % 2 == 1 or count >= 8  # between exposures any number will do
            got = Unquoted(f"{count} in one")
            require(is_many, name, "have at least 8 samples in each exposure", got)
            longest = float(np.max(np.diff(np.r_[first, inner, last])))
            pieces = int(np.clip((last - first) / (2 * longest), 1, 128))
            knots.append(np.linspace(first, last, pieces + 1)[1:])
        edges = np.concatenate(knots)
        # One sample beyond either end holds the spline there.
        some = slice(np.searchsorted(time, begin, "right") - 1, np.searchsorted(time, end) + 1)
        low, high = min(begin, time[some][0]), max(end, time[some][-1])
        whole = np.r_[[low] * 3, edges[1:-1], [high] * 3]
        spline = make_lsq_spline(time[some], path.place[:, some].T, whole, 2)
        return _Spline(edges, lambda at: np.moveaxis(spline(at), -1, 0), spline(edges, 1).T)

    def frame(self, frame: TimedFrame, pan: float) -> TimedFrame:
        """A frame on the recorded path of its exposure."""
        half = frame.exposure / 2
        rounding = _ROUNDING * (self.knots[-1] - self.knots[0])
        lit = np.abs(self.knots - frame.time) <= half + rounding
        edges, velocities = self.knots[lit], self.velocities[0, lit]
        motion = FreeMotion(
            accelerations=np.diff(velocities) / np.diff(edges) / 2,
            half_exposure=half,
            velocity=float(np.interp(frame.time, edges, velocities)) + pan,
        )
        place = float(self.place(np.array([frame.time]))[0, 0])
        return TimedFrame(motion, frame.time, place + pan * frame.time)

    def difference(
        self,
        lights: Lights,
        planned: Float[np.ndarray, "axes n q"],  # px
        pan: Float[np.ndarray, "axes"],  # px/s
    ) -> PathDifference:
        """The difference of the recorded path from the planned one, and its doubt."""
        times = _times(lights)
        apart = self.place(times) + np.multiply.outer(pan, times) - planned
        weight = np.array([end - begin for begin, end in lights])
        weight = np.broadcast_to(weight[:, None] / weight.sum() / _POINTS, times.shape)
        apart = apart - np.sum(weight * apart, axis=(1, 2), keepdims=True)
        squares = np.sum(apart**2, axis=0)
        rms, greatest = float(np.sqrt(np.sum(weight * squares))), float(np.sqrt(np.max(squares)))
        travel = float(np.max(np.ptp(planned, axis=(1, 2))))
        doubt = ""
        if rms > max(1.0, 0.1 * travel):
            doubt = (
                f"The recorded path is {rms:.3g} px r.m.s. from the planned one, which travels "
                f"{travel:.3g} px: another design, or a clock, sign, axis or unit that is not its "
                "own."
            )
        return PathDifference(rms, greatest, doubt)


def _times(lights: Lights) -> Float[np.ndarray, "n q"]:
    """Times of each exposure at which paths are compared; s."""
    return np.array([np.linspace(begin, end, _POINTS + 2)[1:-1] for begin, end in lights])
