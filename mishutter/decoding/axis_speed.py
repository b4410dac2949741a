"""The speed of a picture, found in frames along one axis.

The peaks of the likelihood of some rows are looked for at speeds all over the scene's, and then
climbed and judged by more.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import require
from mishutter.camera.rows import instants_within_reach
from mishutter.decoding.axis_frames import (
    TOLERANCE_OF_SPEED,
    Planes,
    Rows,
    rows_of,
    with_own_detail,
)
from mishutter.decoding.decoders.speed import BEYOND, SpeedEstimate, luminance_shares
from mishutter.decoding.frame_doubts import (
    BLACK,
    FLOOR,
    ROLLS_ABOVE,
    TRIED_BEYOND,
    WORTH,
    Evidence,
    Rival,
    Words,
    doubt_of_rows,
)
from mishutter.decoding.likeliest import noises_of
from mishutter.decoding.rolling import RowTimes, instants_of_rows
from mishutter.model.scene import Scene
from mishutter.model.sensor import Sensor
from mishutter.model.sequences import TimedFrame

_ROWS_OF_SPEED = 32
"""Rows that tell a picture's speed."""
_PX_A_STEP = 0.7
"""Displacement over the sequence between neighbouring speeds that are tried, in pixels of what is
looked at."""
_BINS, _LEAST_BINS, _LEAST_DETAIL = (4, 2), 64, 0.5
"""Pixels whose mean is looked at first, the least of these means in a row, and the least share of
the picture's variance that they have: a fine pattern is looked at pixel by pixel."""
_MOST_SPEEDS = 4096
"""Most speeds that are tried."""
_REASONS = (
    "their order, a lost or repeated frame, another design, two objects, a rolling "
    "shutter, motion across the axis"
)
_WORDS = Words(
    "speed",
    f"{_REASONS}, a speed beyond the scene's",
    "of the rows fit better",
    BEYOND,
)
_TOLD = _WORDS._replace(reasons=f"another speed, {_REASONS}")
_REACH = 3.0
"""Steps about the speed that is found within which no other is a rival."""


class _Peak(NamedTuple):
    """A speed at which the likelihood is highest nearby, its logarithm there, and its error."""

    speed: float
    value: float
    width: float


class _Tried(NamedTuple):
    """Speeds that are tried; px/s."""

    low: float
    high: float
    step: float  # For all frames

    def highest(self, rows: Rows, speed: float, steps: float = 0.1) -> _Peak:
        """The peak of the likelihood near a speed, among those that are tried, to some steps."""
        from scipy.optimize import minimize_scalar

        tolerance = TOLERANCE_OF_SPEED * steps / 0.1

        def loss(value: float) -> float:
            return -float(np.sum(rows.logarithms(np.array([value]), tolerance)))

        if self.low == self.high:
            return _Peak(speed, -loss(speed), 0.0)
        peak, least = speed, math.inf
        for _ in range(8):
            low, high = max(self.low, peak - self.step), min(self.high, peak + self.step)
            options = {"xatol": steps * self.step}
            end: Any = minimize_scalar(loss, bounds=(low, high), method="bounded", options=options)
            peak, least = float(end.x), float(end.fun)
            beyond_low = low > self.low and peak < low + 0.1 * self.step
            if not beyond_low and not (high < self.high and peak > high - 0.1 * self.step):
                break
        side = 0.2 * self.step
        near = rows.logarithms(peak + side * np.array([-1.0, 0.0, 1.0]), tolerance)
        curvature = max(-float(np.sum(np.diff(near, 2, axis=0))) / side**2, 1e-300)
        # Rows of photographs pull to either side by more than Gaussian ones of their spectrum.
        scores = (near[2] - near[0]) / (2 * side)
        disagreement = scores.size * float(np.var(scores))
        width = math.sqrt(max(curvature, disagreement)) / curvature
        return _Peak(peak, -least, min((self.high - self.low) / math.sqrt(12), width))


def speed_on_axis(
    planes: Planes,
    scene: Scene,
    taken: Sequence[TimedFrame],
    times: RowTimes,
    told: float | None = None,
) -> SpeedEstimate:
    """The speed at which the frames show one picture, and whether they do; of a told one that."""
    planes = planes.astype(np.float64)
    if told is not None:  # no other is in question
        instants_within_reach("restore_frames(speed=...)", taken, np.array([told]))
        scene = replace(scene, speeds=np.array([told]), weights=None)
    estimate = _speed_along_rows(planes, scene, taken, times)
    if estimate.trusted or min(planes.shape[2:]) <= _ROWS_OF_SPEED:
        return estimate
    # The frames may be turned, or their motion be along the other axis.
    across = _speed_along_rows(np.swapaxes(planes, 2, 3), scene, taken, times.turned)
    if not across.trusted:
        return estimate
    axis = "rows" if scene.sensor.axis == "columns" else "columns"
    return estimate._replace(
        doubt=f"The frames fit a picture that moves along its {axis}, at {across.speed:,.0f} px/s."
    )


def _speed_along_rows(
    planes: Planes, scene: Scene, taken: Sequence[TimedFrame], times: RowTimes
) -> SpeedEstimate:
    """The same, of pictures that move along their rows."""
    shares = luminance_shares(len(planes))
    grey, num_rows = np.tensordot(shares, planes, 1), planes.shape[2]
    some = np.unique(np.linspace(0, num_rows - 1, min(_ROWS_OF_SPEED, num_rows)).astype(int))
    grey, (low, high) = grey[:, some], _range_to_try(scene)
    rows = _rows_of_speed(grey, scene, taken, times.of_rows(some), float(shares @ shares))
    tried, peaks, middle = _searched(rows, taken, low, high)
    values = np.sum(rows.logarithms(np.array(peaks)), axis=1)
    ends = [_Peak(*each, 0.0) for each in zip(peaks, values.tolist(), strict=True)]
    ends.sort(key=lambda end: -end.value)
    gains = np.maximum(1 + rows.fit(ends[0].speed).gains, BLACK)[:, None, None]
    # What all gains share is a picture that its prior holds back.
    rows = rows._replace(frames=rows.frames / (gains / np.mean(gains)))
    best = tried.highest(rows, ends[0].speed, 0.01)
    fit, duration, top = rows.fit(best.speed), _duration(taken), ends[0].value
    # Frames that fit nowhere are off by so many px from frame to frame.
    asides = best.speed + np.array([-8.0, 5.0]) * max(len(taken) - 1, 1) / duration
    error = math.hypot(math.sqrt(fit.spread) * best.width, FLOOR / duration)
    error = min(error, (high - low) / math.sqrt(12))
    beside = [end for end in ends if abs(end.speed - best.speed) > _REACH * tried.step]
    evidence = Evidence(
        frames=grey,
        noises=rows.noises,
        places=np.mean(rows.middles(best.speed), axis=-1),
        fit=fit,
        compared=fit,
        elsewhere=float(np.mean([rows.fit(each).misfit for each in asides])),
        rivals=[Rival(end.speed, top - end.value, rows.fit(end.speed)) for end in beside],
        lead=top,
        middle=middle,
        is_within=low + 0.1 * tried.step < best.speed < high - 0.1 * tried.step,
        is_only=low == high,
    )
    doubt = evidence.doubt(error * duration, _WORDS if low < high else _TOLD)
    if not doubt and not times.is_rolling and len(taken) > 1 and fit.misfit > ROLLS_ABOVE:

        def misfit_by(sensor: Sensor) -> float:
            """The misfit of rows that are read one after another."""
            rolling = replace(scene, sensor=sensor)
            delays = sensor.row_delays(num_rows)[some]
            nodes = instants_of_rows(taken, rolling, abs(best.speed), delays)
            return rows._replace(nodes=nodes).fit(best.speed).misfit

        longest = max(frame.exposure for frame in taken)
        doubt = doubt_of_rows(scene.sensor, longest, fit.misfit, misfit_by)
    known = sorted([best, *beside], key=lambda end: end.speed)
    values = np.array([end.value for end in known])
    weights = np.exp(WORTH / fit.spread * (values - np.max(values)))
    return SpeedEstimate(
        best.speed,
        error,
        doubt == "",
        np.array([end.speed for end in known]),
        weights / np.sum(weights),
        doubt,
        misfit=fit.misfit if len(taken) > 1 else None,
    )


def _rows_of_speed(
    grey: Float[np.ndarray, "frames rows columns"],
    scene: Scene,
    taken: Sequence[TimedFrame],
    times: RowTimes,
    noise_share: float,
) -> Rows:
    """Rows as bright and as rich in detail as they are, with levels that tell no speed."""
    few = np.linspace(*_range_to_try(scene), 17)
    nodes = instants_of_rows(taken, scene, float(np.max(np.abs(few))), times.delays)
    rows, _ = rows_of(grey, scene, taken, nodes, is_along=times.is_along)
    exposures = [one.exposure for one in taken]
    noises = noises_of(scene, exposures, float(np.mean(grey)), noise_share)
    # Gains and black levels that change from frame to frame tell no speed.
    rows = rows._replace(noises=noises, has_levels=False)
    return with_own_detail(rows, few)


def _range_to_try(scene: Scene) -> tuple[float, float]:
    """Least and greatest speed that are tried; px/s."""
    slowest, fastest = (float(speed) for speed in scene.speed_range)
    is_one = slowest == fastest
    beyond = 0.0 if is_one else TRIED_BEYOND * max(fastest - slowest, abs(fastest), abs(slowest))
    return slowest - beyond, fastest + beyond


def _duration(taken: Sequence[TimedFrame]) -> float:
    """Time from the first mid-exposure to the last, or that of one frame; s."""
    times = [float(frame.time) for frame in taken]
    return max(max(times) - min(times), max(frame.exposure for frame in taken))


def _searched(
    rows: Rows, taken: Sequence[TimedFrame], low: float, high: float
) -> tuple[_Tried, list[float], float]:
    """Speeds at which the likelihood of some rows is highest nearby, the highest first.

    Means of some pixels tell where to look, and of many frames those in the middle, at speeds
    between which the picture moves by less than such a mean; and then all pixels of all frames. The
    peaks come with the median of the likelihood's logarithm over all of these speeds, below its
    top.
    """
    order = np.argsort([float(frame.time) for frame in taken])
    size, bin = len(taken), _largest_bin(rows)
    while True:
        start = (len(taken) - size) // 2
        few = order[start : start + size]
        coarse = bin * _PX_A_STEP / _duration([taken[k] for k in few])
        count = 2 + int((high - low) / coarse)
        # Above so many speeds times frames, fewer frames tell where to look.
        if size <= 2 or size * count <= 3000:
            break
        size -= 1
    step, most = _PX_A_STEP / _duration(taken), coarse * (_MOST_SPEEDS - 2)
    requirement = (
        f"have speeds within {most:,.0f} px/s of each other, so that frames tell them apart"
    )
    require(count <= _MOST_SPEEDS, "restore_frames(scene=...)", requirement, high - low)
    # The row of most detail in each of some bands is looked at.
    detail = np.sum(np.diff(rows.frames, axis=-1) ** 2, axis=(0, 2))
    bands = np.array_split(np.arange(detail.size), min(4, detail.size))
    some = [band[np.argmax(detail[band])] for band in bands]
    all_frames = rows.of_rows(np.array(some))
    speeds = np.linspace(low, high, count) if low < high else np.array([low])
    of_rows = all_frames.of(few).binned(bin).logarithms(speeds)
    values = np.sum(of_rows, axis=1)
    beside = np.concatenate([[-np.inf], values, [-np.inf]])
    places = np.flatnonzero((values >= beside[:-2]) & (values > beside[2:]))
    places = places[np.argsort(-values[places])][:4].tolist()
    # Rows of a second object may be too dim to show among all.
    for place in np.argmax(of_rows, axis=0).tolist():
        if min(abs(place - other) for other in places) > _REACH:
            places.append(place)
    peaks, middle = speeds[places], float(np.max(values) - np.median(values))
    if coarse > step:
        fine = step * np.arange(-math.ceil(coarse / step), math.ceil(coarse / step) + 1)
        near = np.clip(peaks[:, None] + fine, low, high)
        tops = [np.argmax(np.sum(all_frames.logarithms(some), axis=1)) for some in near]
        peaks = near[np.arange(len(near)), tops]
    tried = _Tried(low, high, step)
    return tried, [tried.highest(all_frames, each).speed for each in peaks.tolist()], middle


def _largest_bin(rows: Rows) -> int:
    """Pixels whose means have most of what frames show."""

    def variance(of: Rows) -> float:
        return float(np.mean(np.var(of.frames, axis=-1)) - np.mean(of.noises))

    least = _LEAST_DETAIL * max(variance(rows), 0.0)
    some = [n for n in _BINS if rows.frames.shape[-1] >= n * _LEAST_BINS]
    return next((n for n in some if variance(rows.binned(n)) >= least), 1)
