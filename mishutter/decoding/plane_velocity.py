"""The velocity of a picture, found in frames of a sensor that moves in the plane.

The likelihood knows the borders of the sensor from the start: its peak is looked for at velocities
all over the law's on pixels that are binned, and then climbed on ever smaller ones.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import require
from mishutter.camera.plane_frames import aperture_on, responses_in_plane
from mishutter.decoding.decoders.speed import luminance_shares
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
from mishutter.decoding.likeliest import Fit, detail_of, follows, noises_of
from mishutter.decoding.plane_likelihood import (
    GRID,
    ROUGHLY,
    Climb,
    Level,
    Own,
    Peak,
    Prior,
    climbed,
    logarithm,
    peak_near,
)
from mishutter.evaluation.instants import Instants
from mishutter.model.scene import Scene, require_velocities
from mishutter.model.sensor import Sensor
from mishutter.model.sequences import PlaneFrames
from mishutter.model.velocities import AbstractVelocities

_PX_A_STEP, _REACH = 1.4, 1.5
"""Displacement over the frames between neighbouring velocities that are tried, binned px, and steps
about a peak of these within which there is no other."""
_MOST_ALONG = 64
"""Most steps from rest to the fastest velocity that is tried."""
_NEAR = 0.1
"""Part of a step within which a peak is reached."""
_REASONS = (
    "their order, a lost or repeated frame, another design or path, two objects, a rolling shutter"
)
_WORDS = Words(
    "velocity",
    f"{_REASONS}, a velocity beyond the scene's",
    "of the picture fits better",
    "The velocity may lie beyond those of the scene.",
)
_TOLD = _WORDS._replace(reasons=f"another velocity, rows and columns exchanged, {_REASONS}")


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


def velocity_in_plane(
    planes: Float[np.ndarray, "colours n rows columns"], scene: Scene, taken: PlaneFrames
) -> VelocityEstimate:
    """The velocity at which the frames show one picture, and whether they do."""
    law = require_velocities(scene)
    grey, own = _own_of(planes, scene, taken)
    mean = float(np.mean(grey))
    search = _searched(own, law)
    fit = search.level.fit(search.ends[0].velocity, search.ends[0].found, mean)
    own = _steady(own, fit, mean)
    climb, size = search.ends[0], search.level.canvas.size
    while True:
        level = own.level(climb.best[None], size)
        climb = climbed(level, climb.best)
        if size == 1:
            break
        size //= 2
    return _Found(own, law, search, peak_near(level, climb), level, grey, mean).estimate()


def told_in_plane(
    planes: Float[np.ndarray, "colours n rows columns"],
    scene: Scene,
    taken: PlaneFrames,
    velocity: Float[np.ndarray, "2"],
) -> VelocityEstimate:
    """The velocity that was told, and whether the frames show one picture at it."""
    grey, own = _own_of(planes, scene, taken)
    mean = float(np.mean(grey))
    velocities = np.array([velocity, *(velocity + _asides(own))])
    level = own.level(velocities, _sizes_of(own)[1])
    found = level.likeliest(velocity, ROUGHLY)
    own = _steady(own, level.fit(velocity, found, mean), mean)
    level = own.level(velocities, level.canvas.size)
    fits = [level.fit(each, level.likeliest(each, ROUGHLY), mean) for each in velocities]
    evidence = Evidence(
        frames=grey,
        noises=own.noises,
        places=level.instants.middles(velocity),
        fit=fits[0],
        compared=fits[0],
        elsewhere=float(np.mean([fit.misfit for fit in fits[1:]])),
        rivals=[],
        lead=math.inf,
        middle=0.0,
        is_within=True,
        is_only=True,
    )
    doubt = evidence.doubt(0.0, _TOLD)
    doubt = doubt or _doubt_of_rows(own, level.canvas.size, velocity, evidence, mean)
    ends = velocities[:1], np.ones(1)
    return VelocityEstimate(
        velocity, np.zeros((2, 2)), doubt == "", *ends, doubt, misfit=fits[0].misfit
    )


def _doubt_of_rows(
    own: Own, size: int, velocity: Float[np.ndarray, "2"], judged: Evidence, mean: float
) -> str:
    """The doubt of frames of a moving sensor that a rolling shutter explains better."""
    misfit, scene = judged.compared.misfit, own.prior.scene
    if own.delays is not None or own.taken.stays or len(own.frames) == 1 or misfit < ROLLS_ABOVE:
        return ""

    def misfit_by(sensor: Sensor) -> float:
        """The misfit of rows that are read one after another."""
        path = own.taken.for_rows(sensor.readout_time, scene.limits)
        rolling = own._replace(taken=path, delays=sensor.row_delays(own.frames.shape[1]))
        level = rolling.level(velocity[None], size)
        return level.fit(velocity, level.likeliest(velocity, ROUGHLY), mean).misfit

    longest = float(np.max(own.taken.exposures))
    return doubt_of_rows(scene.sensor, longest, misfit, misfit_by)


def _own_of(
    planes: Float[np.ndarray, "colours n rows columns"], scene: Scene, taken: PlaneFrames
) -> tuple[Float[np.ndarray, "n rows columns"], Own]:
    """The grey frames as they came, and about their mean with what is known of them."""
    shares = luminance_shares(len(planes))
    grey = np.tensordot(shares, planes, 1)
    mean = float(np.mean(grey))
    noises = noises_of(scene, taken.exposures, mean, float(shares @ shares))
    own = Own.of((grey - mean).astype(np.float32), noises, taken, scene)
    return grey, _with_own_detail(own)


def _steady(own: Own, fit: Fit, mean: float) -> Own:
    """The frames without changes of gain and black level, which tell no velocity."""
    changes = follows(len(own.frames)) * np.stack([fit.gains, fit.offsets])[..., None, None]
    gains = np.maximum(1 + changes[0] - np.mean(changes[0]), BLACK)
    steady = (own.frames + mean - changes[1]) / gains - mean
    noises = own.noises / gains.ravel() ** 2
    return own._replace(frames=steady.astype(np.float32), noises=noises)


def _asides(own: Own) -> Float[np.ndarray, "2 2"]:
    """Velocities aside at which frames that fit nowhere are off by so many px between them."""
    return np.array([[-8.0, 3.0], [4.0, 6.0]]) * max(len(own.frames) - 1, 1) / own.duration


def _sizes_of(own: Own) -> tuple[list[int], int]:
    """Sizes of binned pixels by which velocities are sought, and that by which they are judged."""
    # They are sought in binned frames of 32 px or more, and judged in those of 64.
    sizes = [2**k for k in range(6) if own.has(32, 2**k)] or [1]
    return sizes, max((each for each in sizes if own.has(64, each)), default=1)


def _with_own_detail(own: Own) -> Own:
    """The frames with the power of pictures that are as rich in detail, for some velocities."""
    scene, shape = own.prior.scene, own.frames.shape[1:]
    grid = (GRID, GRID)
    fastest = require_velocities(scene).fastest
    instants = Instants.of(own.taken, fastest)
    # These stand for all velocities in a mean.
    few = 0.7 * fastest * np.array([[1.0, 0.0], [0.0, 1.0], [0.7, 0.7], [0.7, -0.7]])
    passed = [np.abs(responses_in_plane(instants, each, grid)) ** 2 for each in few]
    density = np.sum(np.mean(passed, axis=0) / own.noises[:, None, None], axis=0)
    expected = density * aperture_on(scene.optics, grid) ** 2 * own.prior.on(grid)
    lowest = max(2 / min(shape), 1 / GRID)
    frames = own.frames - np.mean(own.frames, axis=(1, 2), keepdims=True)
    detail = detail_of(frames, own.noises, shape, expected, lowest)
    return own._replace(prior=Prior(scene, detail))


class _Search(NamedTuple):
    """Velocities at which the likelihood is high, of all that are tried."""

    level: Level  # Pixels by which they are judged
    ends: list[Climb]  # Peaks, the highest first
    values: list[float]  # Logarithms of likelihood there
    middle: float  # Median of the logarithm over all velocities, below its top
    step: float  # Step between neighbouring velocities there; px/s


def _searched(own: Own, law: AbstractVelocities) -> _Search:
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
    step = _PX_A_STEP * size / own.duration_of(counts[0])
    velocities = _velocities_to_try(law, step)
    values = _values(own, velocities, size, counts[0])
    middle = float(np.max(values) - np.median(values))
    peaks = _peaks(velocities, values, _REACH * step)
    for size, count in stages:
        finer = _PX_A_STEP * size / own.duration_of(count)
        near = [peak + finer * _beside(step / finer) for peak in peaks]
        step, values = finer, _values(own, np.concatenate(near), size, count)
        each = values.reshape(len(near), -1)
        tops = np.array([some[k] for some, k in zip(near, np.argmax(each, axis=1), strict=True)])
        peaks = _peaks(tops, np.max(each, axis=1), _REACH * step)
    beside = _beside(2.0)
    level = own.level(np.concatenate([peak + step * beside for peak in peaks]), size)
    ends = [_top(level, peak, step) for peak in peaks]
    best = max(ends, key=lambda end: _value(level, end))
    # Peaks may be narrower than a step.
    ends += [_top(level, best.best + step * each, step) for each in beside if np.any(each)]
    # What still climbs is on the way to another.
    still = [end for end in ends if end is best or _size(end) < _NEAR * step]
    still.sort(key=lambda end: -_value(level, end))
    return _Search(level, still, [_value(level, end) for end in still], middle, step)


def _beside(ratio: float) -> Float[np.ndarray, "b 2"]:
    """Steps about a velocity that leave no gap between coarser ones, which are so much larger."""
    reach = math.ceil((ratio - 1) / 2 - 1e-9)
    return np.array([*itertools.product(range(-reach, reach + 1), repeat=2)], np.float64)


def _values(
    own: Own, velocities: Float[np.ndarray, "s 2"], size: int, count: int
) -> Float[np.ndarray, "s"]:
    """Logarithms of the likelihood, summed over so many neighbouring frames at a time."""
    last, values = len(own.frames) - count, np.zeros(len(velocities))
    for first in sorted({*range(0, last, max(count // 2, 1)), last}):
        part = None if last == 0 else slice(first, first + count)
        level = own.level(velocities, size, part)
        values += [logarithm(level, each) for each in velocities]
    return values


def _top(level: Level, velocity: np.ndarray, step: float) -> Climb:
    """The last of some climbs from a velocity."""
    climb = climbed(level, velocity, ROUGHLY)
    for _ in range(4):
        if _size(climb) < _NEAR * step:
            break
        climb = climbed(level, climb.best, ROUGHLY)
    return climb


def _size(climb: Climb) -> float:
    """Length of a step; px/s."""
    return float(np.hypot(*(climb.best - climb.velocity)))


def _value(level: Level, climb: Climb) -> float:
    """Logarithm of the likelihood before a step."""
    return float(climb.found.gains) - float(level.volume(climb.velocity).logarithm)


def _velocities_to_try(law: AbstractVelocities, step: float) -> Float[np.ndarray, "s 2"]:
    """Velocities of a law and a little beyond, on a square grid."""
    fastest = law.fastest
    count = math.ceil((1 + TRIED_BEYOND) * fastest / step) + 1
    requirement = f"have velocities below {_MOST_ALONG * step:,.0f} px/s, so that frames tell them"
    require(count <= _MOST_ALONG, "restore_frames(scene=...)", requirement, fastest)
    along = step * np.arange(-count, count + 1)
    grid = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
    return grid[law.within(grid, TRIED_BEYOND * fastest + step / math.sqrt(2))]


def _peaks(
    velocities: Float[np.ndarray, "s 2"], values: Float[np.ndarray, "s"], apart: float
) -> list[np.ndarray]:
    """The velocities of the highest values of all nearby."""
    chosen: list[np.ndarray] = []
    for place in np.argsort(-values):
        here = velocities[place]
        near = np.hypot(*(velocities - here).T) <= apart
        if values[place] == np.max(values[near]):
            chosen.append(here)
        if len(chosen) == 6:
            break
    return chosen


class _Found(NamedTuple):
    """The velocity that was found, and what speaks for and against it."""

    own: Own  # The frames, without changes of gain and black level
    law: AbstractVelocities
    search: _Search
    peak: Peak  # On pixels of the sensor
    level: Level  # These pixels
    grey: Float[np.ndarray, "n rows columns"]  # The frames as they came
    mean: float  # Their mean level

    def estimate(self) -> VelocityEstimate:
        """The estimate of the velocity."""
        own, best, judged = self.own, self.peak.best, self.evidence()
        spread, least = judged.fit.spread, (FLOOR / own.duration) ** 2
        covariance = spread * self.peak.covariance + least * np.eye(2)
        error = math.sqrt(float(np.max(np.linalg.eigvalsh(covariance))))
        doubt = judged.doubt(error * own.duration, _WORDS)
        doubt = doubt or _doubt_of_rows(own, self.search.level.canvas.size, best, judged, self.mean)
        below = np.array([0.0, *(below for _, below, _ in judged.rivals)])
        weights = np.exp(WORTH / spread * (np.min(below) - below))
        return VelocityEstimate(
            best,
            covariance,
            doubt == "",
            np.array([best, *(velocity for velocity, _, _ in judged.rivals)]),
            weights / np.sum(weights),
            doubt,
            judged.fit.misfit if len(own.frames) > 1 else None,
        )

    def evidence(self) -> Evidence:
        """How the frames fit the velocity, and all others in question."""
        own, law, search, best = self.own, self.law, self.search, self.peak.best
        ends: list[tuple[np.ndarray, float]] = []
        for end, value in zip(search.ends, search.values, strict=True):
            known = [best, *(velocity for velocity, _ in ends)]
            if all(np.hypot(*(end.best - each)) > 0.5 * search.step for each in known):
                ends.append((end.best, search.values[0] - value))
        asides = _asides(own)
        velocities = np.array([best, *(best + asides), *(velocity for velocity, _ in ends)])
        level = own.level(velocities, search.level.canvas.size)
        fits = [level.fit(each, level.likeliest(each, ROUGHLY), self.mean) for each in velocities]
        others = fits[1 + len(asides) :]
        return Evidence(
            frames=self.grey,
            noises=own.noises,
            places=self.level.instants.middles(best),
            fit=self.level.fit(self.peak.near.velocity, self.peak.near.found, self.mean),
            compared=fits[0],
            elsewhere=float(np.mean([fit.misfit for fit in fits[1 : 1 + len(asides)]])),
            rivals=[Rival(*end, fit) for end, fit in zip(ends, others, strict=True)],
            lead=search.values[0],
            middle=search.middle,
            is_within=bool(law.within(best[None], TRIED_BEYOND * law.fastest)[0]),
        )
