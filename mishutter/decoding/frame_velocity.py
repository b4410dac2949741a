"""The velocity of a picture, found in its frames along one axis or in the plane.

The likelihood knows the borders of the sensor from the start: its peak is looked for at velocities
all over the scene's on pixels that are binned, and then climbed on ever smaller ones. Along one
axis velocities have one component, and some rows tell it.
"""

import itertools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from mishutter._core.checks import Unquoted, require
from mishutter.camera.rows import instants_within_reach
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
from mishutter.decoding.frame_likelihood import (
    ROUGHLY,
    Climb,
    Level,
    Own,
    Prior,
    climbed,
    exposures_of,
    peak_near,
)
from mishutter.decoding.likeliest import TOLERANCE, Fit, fit_of, noises_of
from mishutter.decoding.rolling import GLOBAL, ROUGH_SHARE, RowTimes
from mishutter.model.frame_path import Frames, PlaneFrames
from mishutter.model.scene import Scene, require_velocities
from mishutter.model.sensor import Sensor
from mishutter.model.velocities import AbstractVelocities
from mishutter.pictures.registration.windows import means

_REACH = 1.5
"""Steps about a peak of velocities that are tried within which there is no other."""
_MOST_ALONG = 64
"""Most steps from rest to the fastest velocity that is tried in the plane."""
_MOST_SPEEDS = 4096
"""Most speeds that are tried along an axis."""
_NEAR, _SAME = 0.1, 0.25
"""Parts of a step within which a peak is reached, and within which two are the same."""
_ROWS_OF_SPEED, _BANDS = 32, 4
"""Rows that tell a speed, and bands of them of each of which one is searched."""
_LEAST_DETAIL = 0.5
"""Least share of the picture's variance that means of pixels have which are looked at."""

_REASONS = "their order, a lost or repeated frame, another design{}, two objects, a rolling shutter"
_ON_AXIS = _REASONS.format("") + ", motion across the axis"
_IN_PLANE = _REASONS.format(" or path")
_FOUND = (
    Words("speed", f"{_ON_AXIS}, a speed beyond the scene's", "of the rows fit better", BEYOND),
    Words(
        "velocity",
        f"{_IN_PLANE}, a velocity beyond the scene's",
        "of the picture fits better",
        "The velocity may lie beyond those of the scene.",
    ),
)
"""Words for velocities of one component and of two."""
_TOLD = (
    _FOUND[0]._replace(reasons=f"another speed, {_ON_AXIS}"),
    _FOUND[1]._replace(reasons=f"another velocity, rows and columns exchanged, {_IN_PLANE}"),
)
_FINALLY = TOLERANCE / 10, TOLERANCE
"""Residuals at which conjugate gradients of the peak end, of rows and of pictures: the slopes of
rows, which cost little, are those of the likeliest ones."""
_PX_A_STEP = 0.7, 1.4
"""Displacement over the frames between neighbouring velocities that are tried, of one component and
of two; binned px."""
_APART = 3.0, 0.5
"""Such steps from the velocity that is found within which no other is a rival."""


class VelocityEstimate(NamedTuple):
    """The velocity of a whole picture, found in the frames of a sensor that moves in the plane.

    Attributes:
        velocity: The velocity along rows and columns; px/s, shape `(2,)`.
        covariance: Covariance of its error; (px/s)^2, shape `(2, 2)`. The ellipse of one standard
            error holds 39 % of the velocities whose errors are Gaussian, that of two 86 %; along
            one axis two standard errors hold 95 %.
        trusted: Whether the frames fit one picture at that velocity, and at no other as well.
        velocities: Velocities at which the likelihood is highest nearby; px/s, shape `(s, 2)`.
        weights: Their probabilities.
        doubt: A sentence that says why the velocity is not trusted; empty if it is.
        misfit: Mean square of what the restored picture leaves of the frames over their noise:
            about 1 where they fit one picture at one velocity. None of one frame.
    """

    velocity: Float[np.ndarray, "2"]
    covariance: Float[np.ndarray, "2 2"]
    trusted: bool
    velocities: Float[np.ndarray, "s 2"]
    weights: Float[np.ndarray, "s"]
    doubt: str
    misfit: float | None

    @property
    def speed(self) -> float:
        """The speed in its direction; px/s."""
        return float(np.hypot(*self.velocity))

    @property
    def error(self) -> float:
        """Standard error in the direction in which it is greatest; px/s."""
        return float(self.ellipse[0])

    @property
    def ellipse(self) -> tuple[float, float, float]:
        """Half axes of the ellipse of one standard error, px/s, and the longer's angle; rad."""
        values, vectors = np.linalg.eigh(self.covariance)
        short, long = np.sqrt(np.maximum(values, 0)).tolist()
        return long, short, math.atan2(vectors[1, 1], vectors[0, 1])


class _Speeds(NamedTuple):
    """Speeds along an axis, as a law of velocities."""

    low: float
    high: float

    @property
    def fastest(self) -> float:
        """The greatest of them, or of their differences; px/s."""
        return max(abs(self.low), abs(self.high), self.high - self.low)

    def within(self, velocities: Float[np.ndarray, "k 1"], beyond: float) -> Bool[np.ndarray, "k"]:
        """Whether velocities occur, or are no further than `beyond`; px/s."""
        speeds = velocities[:, 0]
        return (speeds >= self.low - beyond) & (speeds <= self.high + beyond)


class _Burst(NamedTuple):
    """Grey frames, and the rows of them that tell a velocity."""

    grey: Float[np.ndarray, "n rows columns"]  # As they came
    own: Own  # About their levels
    law: _Speeds | AbstractVelocities
    some: Int[np.ndarray, "r"]  # Numbers of these rows
    shape: tuple[int, int]  # Rows and columns of the frames

    @staticmethod
    def of(
        planes: Float[np.ndarray, "colours n rows columns"],
        scene: Scene,
        taken: Frames,
        times: RowTimes,
    ) -> "_Burst":
        """That of the frames of a scene."""
        shares = luminance_shares(len(planes))
        grey, num_rows = np.tensordot(shares, planes, 1), planes.shape[2]
        some, prior, exposures = np.arange(num_rows), Prior(scene), exposures_of(taken)
        in_plane = isinstance(taken, PlaneFrames)
        if in_plane:
            law = require_velocities(scene)
            own = grey - np.mean(grey)
            # These stand for all velocities in a mean.
            few = 0.7 * law.fastest * np.array([[1.0, 0.0], [0.0, 1.0], [0.7, 0.7], [0.7, -0.7]])
        else:
            count = min(_ROWS_OF_SPEED, num_rows)
            some = np.unique(np.linspace(0, num_rows - 1, count).astype(int))
            grey, law = grey[:, some], _Speeds(*map(float, scene.speed_range))
            own = grey - np.mean(grey, axis=(0, 2), keepdims=True)
            few = np.linspace(law.low, law.high, 17)[:, None]
        noises = noises_of(scene, exposures, float(np.mean(grey)), float(shares @ shares))
        dtype = np.float32 if in_plane else np.float64
        # Gains and black levels that change from frame to frame tell no speed.
        frames = Own(own.astype(dtype), noises, taken, prior, times.of_rows(some), in_plane)
        return _Burst(grey, frames.with_own_detail(few), law, some, planes.shape[2:])

    @property
    def mean(self) -> float:
        """The mean level."""
        return float(np.mean(self.grey)) if self.own.num_axes > 1 else 0.0

    @property
    def searched(self) -> Own:
        """Frames that are looked at first: of rows the one of most detail in each of some bands."""
        if self.own.num_axes > 1:
            return self.own
        detail = np.sum(np.diff(self.own.frames, axis=-1) ** 2, axis=(0, 2))
        bands = np.array_split(np.arange(detail.size), min(_BANDS, detail.size))
        return self.own.of_rows(np.array([band[np.argmax(detail[band])] for band in bands]))

    def steady(self, fit: Fit) -> "_Burst":
        """The frames without changes of gain and black level, which tell no velocity."""
        own, mean = self.own, self.mean
        gains, offsets = np.stack([fit.gains, fit.offsets])[..., None, None]
        gains = np.maximum(1 + gains - np.mean(gains), BLACK)
        steady = ((own.frames + mean - offsets) / gains - mean).astype(own.frames.dtype)
        noises = own.noises / gains.ravel() ** 2
        return self._replace(own=own._replace(frames=steady, noises=noises))

    @property
    def asides(self) -> Float[np.ndarray, "2 axes"]:
        """Velocities aside at which frames that fit nowhere are off by so many px between them."""
        off = np.array([[-8.0, 3.0], [4.0, 6.0]])[:, : self.own.num_axes]
        return off * max(len(self.own.frames) - 1, 1) / self.own.duration

    def doubt(
        self, evidence: Evidence, velocity: Float[np.ndarray, "axes"], size: int, error: float
    ) -> str:
        """Why a velocity with an error, px/s, is not trusted."""
        own = self.own
        words = (_TOLD if evidence.is_only else _FOUND)[own.num_axes - 1]
        doubt = evidence.doubt(error * own.duration, words)
        stays = isinstance(own.taken, PlaneFrames) and own.taken.stays
        if doubt or stays or len(own.frames) == 1:
            return doubt
        if max(evidence.compared.misfit, evidence.fit.misfit) < ROLLS_ABOVE:
            return ""

        def misfit_by(sensor: Sensor, size: int) -> float:
            """The misfit of a picture at its end, by rows that are read as a sensor does."""
            times = RowTimes.of(sensor, self.shape, in_plane=own.num_axes > 1).of_rows(self.some)
            scene = replace(own.prior.scene, sensor=sensor)
            rows = own._replace(times=times, prior=own.prior._replace(scene=scene))
            return rows.level(velocity[None], size).fit(velocity, self.mean).misfit

        longest = float(np.max(exposures_of(own.taken)))
        counts = {each: own.frames.size // each**own.num_axes for each in (size, 1)}
        return doubt_of_rows(own.prior.scene.sensor, longest, counts, misfit_by)


def velocity_of_frames(
    planes: Float[np.ndarray, "colours n rows columns"],
    scene: Scene,
    taken: Frames,
    times: RowTimes = GLOBAL,
    told: Float[np.ndarray, "axes"] | None = None,
) -> VelocityEstimate:
    """The velocity at which the frames show one picture, and whether they do; of a told one that.

    Pictures are turned so that things which move along one axis move along rows.
    """
    burst = _Burst.of(planes, scene, taken, times)
    if told is not None:
        return _told(burst, told)
    if isinstance(burst.law, _Speeds) and burst.law.low == burst.law.high:
        return _told(burst, np.array([burst.law.low]))
    return _found(burst)


def require_shared(
    planes: Float[np.ndarray, "colours n rows columns"],
    taken: Frames,
    told: Float[np.ndarray, "axes"],
) -> None:
    """Refuses a velocity that is told at which no two frames in turn show a part in common.

    They would tell nothing, on a canvas that grows with the way between them.
    """
    subject = "restore_frames(speed=...)"
    places = instants_within_reach(subject, taken, told).middles(told)
    ways = np.abs(np.diff(places, axis=1))
    sides = np.array(planes.shape[:1:-1])[: len(ways), None]
    requirement = "leave two frames in turn a part of the picture that both show"
    got = Unquoted(f"{float(np.min(np.max(ways, axis=0))):.3g} px between them")
    require(bool(np.any(np.all(ways < sides, axis=0))), subject, requirement, got)


def _told(burst: _Burst, velocity: Float[np.ndarray, "axes"]) -> VelocityEstimate:
    """The velocity that was told, and whether the frames show one picture at it."""
    instants_within_reach("restore_frames(speed=...)", burst.own.taken, velocity)
    velocities = np.array([velocity, *(velocity + burst.asides)])
    size = _sizes_of(burst.own)[1]
    burst = burst.steady(burst.own.level(velocities, size).fit(velocity, burst.mean))
    level = burst.own.level(velocities, size)
    fits = [level.fit(each, burst.mean) for each in velocities]
    fit = fits[0] if size == 1 else burst.own.level(velocity[None]).fit(velocity, burst.mean)
    evidence = Evidence(
        frames=burst.grey,
        noises=burst.own.noises,
        places=level.instants.middles(velocity),
        fit=fit,
        compared=fits[0],
        elsewhere=float(np.mean([each.misfit for each in fits[1:]])),
        rivals=[],
        lead=math.inf,
        middle=0.0,
        is_within=True,
        is_only=True,
    )
    doubt = burst.doubt(evidence, velocity, size, 0.0)
    misfit = fit.misfit if len(burst.grey) > 1 else None
    still = np.zeros((velocity.size, velocity.size))
    return VelocityEstimate(velocity, still, doubt == "", velocities[:1], np.ones(1), doubt, misfit)


def _found(burst: _Burst) -> VelocityEstimate:
    """The velocity of highest likelihood."""
    law, search = burst.law, _searched(burst.searched, burst.law)
    climb, size = search.ends[0], search.level.canvas.size
    velocities = np.array([climb.best, *(end.best for end in search.ends[1:])])
    judged = burst.own.level(velocities, size)
    burst = burst.steady(judged.fit(climb.velocity, burst.mean))
    own, finally_ = burst.own, _FINALLY[burst.own.num_axes - 1]
    while True:
        level = own.level(climb.best[None], size)
        climb = climbed(level, climb.best, finally_)
        if size == 1:
            break
        size //= 2
    peak, size = peak_near(level, climb, finally_), search.level.canvas.size
    best = peak.best
    apart: list[np.ndarray] = [best]
    least = _APART[own.num_axes - 1] * search.step
    for end in search.ends:
        if all(np.linalg.norm(end.best - each) > least for each in apart):
            apart.append(end.best)
    velocities = np.array([*apart, *(best + burst.asides)])
    judged = own.level(velocities, size)
    fits = [judged.fit(each, burst.mean) for each in velocities]
    count = len(apart)
    values = np.array([fit.logarithm for fit in fits[:count]])
    top = float(np.max(values))
    evidence = Evidence(
        frames=burst.grey,
        noises=own.noises,
        places=level.instants.middles(best),
        fit=fit_of(peak.near.found, level.volume(peak.near.velocity), burst.mean),
        compared=fits[0],
        elsewhere=float(np.mean([fit.misfit for fit in fits[count:]])),
        rivals=[
            Rival(velocity, float(top - value), fit)
            for velocity, value, fit in zip(apart[1:], values[1:], fits[1:count], strict=True)
        ],
        lead=top,
        middle=search.below_top,
        is_within=bool(law.within(best[None], TRIED_BEYOND * law.fastest)[0]),
    )
    spread, floor = evidence.fit.spread, (FLOOR / own.duration) ** 2
    covariance = spread * peak.covariance + floor * np.eye(best.size)
    if isinstance(law, _Speeds):  # any of them, if the frames tell none
        covariance = np.minimum(
            covariance, (law.high - law.low + 2 * TRIED_BEYOND * law.fastest) ** 2 / 12
        )
    error = math.sqrt(float(np.max(np.linalg.eigvalsh(covariance))))
    doubt = burst.doubt(evidence, best, size, error)
    weights = np.exp(WORTH / spread * (values - top))
    return VelocityEstimate(
        best,
        covariance,
        doubt == "",
        np.array(apart),
        weights / np.sum(weights),
        doubt,
        evidence.fit.misfit if len(own.frames) > 1 else None,
    )


def speed_on_axis(
    planes: Float[np.ndarray, "colours n rows columns"],
    scene: Scene,
    taken: Frames,
    times: RowTimes,
    told: Float[np.ndarray, "1"] | None = None,
) -> SpeedEstimate:
    """The velocity along an axis, as a speed."""
    found = velocity_of_frames(planes, scene, taken, times, told)
    doubt, order = found.doubt, np.argsort(found.velocities[:, 0])
    if doubt and min(planes.shape[2:]) > _ROWS_OF_SPEED:
        # The frames may be turned, or their motion be along the other axis.
        turned = np.swapaxes(planes, 2, 3)
        across = velocity_of_frames(turned, scene, taken, times.turned, told)
        if across.trusted:
            axis = "rows" if scene.sensor.axis == "columns" else "columns"
            doubt = (
                f"The frames fit a picture that moves along its {axis}, at "
                f"{across.velocity[0]:,.0f} px/s."
            )
    return SpeedEstimate(
        float(found.velocity[0]),
        math.sqrt(float(found.covariance[0, 0])),
        found.trusted,
        found.velocities[order, 0],
        found.weights[order],
        doubt,
        misfit=found.misfit,
    )


def _sizes_of(own: Own) -> tuple[list[int], int]:
    """Sizes of binned pixels by which velocities are sought, and that by which they are judged."""
    if own.num_axes == 1:
        return [n for n in (1, 2, 4) if n == 1 or (own.has(64, n) and _shows(own, n))], 1
    # They are sought in binned frames of 32 px or more, and judged in those of 64.
    sizes = [2**k for k in range(6) if own.has(32, 2**k)] or [1]
    return sizes, max((each for each in sizes if own.has(64, each)), default=1)


def _shows(own: Own, size: int) -> bool:
    """Whether means of so many pixels have most of what frames show: a fine pattern has none."""
    every = [
        np.mean(np.var(means(own.frames, n, (-1,)), axis=-1)) - np.mean(own.noises) / n
        for n in (1, size)
    ]
    return bool(every[1] >= _LEAST_DETAIL * max(every[0], 0.0))


class _Search(NamedTuple):
    """Velocities at which the likelihood is high, of all that are tried."""

    level: Level  # Pixels by which they are judged
    ends: list[Climb]  # Peaks, the highest first
    below_top: float  # Top of the logarithm over all velocities, less its median
    step: float  # Step between neighbouring velocities there; px/s


def _searched(own: Own, law: _Speeds | AbstractVelocities) -> _Search:
    """The likelihood at velocities all over the law's, then about its peaks.

    Neighbouring frames, whose likelihood has wide peaks, come first, then twice as many at once, up
    to all of them, which are looked at on ever smaller pixels.
    """
    sizes, judged = _sizes_of(own)
    # Each of these numbers of frames, from two on, is about half of the next.
    counts = [len(own.frames)]
    while counts[0] > 2:
        counts.insert(0, (counts[0] + 1) // 2)
    size, stages = sizes[-1], [(sizes[-1], count) for count in counts[1:]]
    stages += [(each, counts[-1]) for each in reversed(sizes[:-1]) if each >= judged]
    px = _PX_A_STEP[own.num_axes - 1]
    step = px * size / own.duration_of(counts[0])
    velocities = _velocities_to_try(law, step)
    values = _values(own, velocities, size, counts[0])
    whole = np.sum(values, axis=1)
    below_top = float(np.max(whole) - np.median(whole))
    peaks = _peaks(velocities, whole, _REACH * step)
    # Rows of a second object may be too dim to show among all.
    for one in velocities[np.argmax(values, axis=0)]:
        if min(np.linalg.norm(one - other) for other in peaks) > _REACH * step:
            peaks.append(one)
    for size, count in stages:
        finer = px * size / own.duration_of(count)
        near = [peak + finer * _beside(step / finer, own.num_axes) for peak in peaks]
        step, whole = finer, np.sum(_values(own, np.concatenate(near), size, count), axis=1)
        each = whole.reshape(len(near), -1)
        tops = np.array([some[k] for some, k in zip(near, np.argmax(each, axis=1), strict=True)])
        peaks = _peaks(tops, np.max(each, axis=1), _REACH * step)
    beside = _beside(2.0, own.num_axes)
    near = np.concatenate([peak + step * beside for peak in peaks])
    level = own.level(near, size, share=ROUGH_SHARE)
    ends = [_top(level, peak, step) for peak in peaks]
    best = max(ends, key=lambda end: end.value(level))
    # Peaks may be narrower than a step.
    ends += [_top(level, best.best + step * each, step, best) for each in beside if np.any(each)]
    # What still climbs is on the way to another.
    still = [end for end in ends if end is best or end.size < _NEAR * step]
    still.sort(key=lambda end: -end.value(level))
    return _Search(level, still, below_top, step)


def _beside(ratio: float, num_axes: int) -> Float[np.ndarray, "b axes"]:
    """Steps about a velocity that leave no gap between coarser ones, which are so much larger."""
    reach = math.ceil((ratio - 1) / 2 - 1e-9)
    return np.array([*itertools.product(range(-reach, reach + 1), repeat=num_axes)], np.float64)


def _values(
    own: Own, velocities: Float[np.ndarray, "s axes"], size: int, count: int
) -> Float[np.ndarray, "s rows"]:
    """Logarithms of the likelihood, summed over so many neighbouring frames at a time."""
    last, values = len(own.frames) - count, np.zeros((len(velocities), 1))
    for first in sorted({*range(0, last, max(count // 2, 1)), last}):
        part = slice(None) if last == 0 else slice(first, first + count)
        each = own.level(velocities, size, part, share=ROUGH_SHARE).logarithms(velocities)
        values = values + each.reshape(len(velocities), -1)
    return values


def _top(level: Level, velocity: np.ndarray, step: float, other: Climb | None = None) -> Climb:
    """The last of some climbs from a velocity, which may lead to another's end."""
    climb = climbed(level, velocity, ROUGHLY, None if other is None else other.information)
    for _ in range(4):
        is_same = other and np.linalg.norm(climb.best - other.best) < _SAME * step
        if is_same or climb.size < _NEAR * step:
            break
        climb = climbed(level, climb.best, ROUGHLY, climb.information)
    return climb


def _velocities_to_try(
    law: _Speeds | AbstractVelocities, step: float
) -> Float[np.ndarray, "s axes"]:
    """Velocities of a law and a little beyond, on a square grid."""
    subject, beyond = "restore_frames(scene=...)", TRIED_BEYOND * law.fastest
    if isinstance(law, _Speeds):
        low, high, most = law.low - beyond, law.high + beyond, step * (_MOST_SPEEDS - 2)
        words = f"have speeds within {most:,.0f} px/s of each other, so that frames tell them apart"
        require(high - low <= most, subject, words, high - low)
        return np.linspace(low, high, 2 + int((high - low) / step))[:, None]
    count = math.ceil((law.fastest + beyond) / step) + 1
    requirement = f"have velocities below {_MOST_ALONG * step:,.0f} px/s, so that frames tell them"
    require(count <= _MOST_ALONG, subject, requirement, law.fastest)
    along = step * np.arange(-count, count + 1)
    grid = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    return grid[law.within(grid, beyond + step / math.sqrt(2))]


def _peaks(
    velocities: Float[np.ndarray, "s axes"], values: Float[np.ndarray, "s"], apart: float
) -> list[np.ndarray]:
    """The velocities of the highest values of all nearby."""
    chosen: list[np.ndarray] = []
    for place in np.argsort(-values):
        here = velocities[place]
        near = np.linalg.norm(velocities - here, axis=1) <= apart
        if values[place] == np.max(values[near]):
            chosen.append(here)
        if len(chosen) == 6:
            break
    return chosen
