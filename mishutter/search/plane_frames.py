"""The best frames of things that move in any direction, on stages of no axis, one or two."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import Unquoted, require, require_known
from mishutter._core.compiling import outside_trace
from mishutter._core.parallel import alone_in_blas
from mishutter.evaluation.bursts import (
    FrameTimes,
    StillBursts,
    some_numbers,
)
from mishutter.evaluation.ceilings import exposures_ceiling
from mishutter.evaluation.fans import MEASURED, SEARCHED
from mishutter.evaluation.levels import exposures_psnr
from mishutter.evaluation.registration import loss_of_width, with_losses
from mishutter.model.exposures import Exposures, exposures_in_plane, turned_by
from mishutter.model.frame_path import FramePath
from mishutter.model.scene import Scene, require_scene, require_velocities
from mishutter.model.sensor import BurstMode
from mishutter.model.stages import Knots, transfer
from mishutter.model.velocities import AbstractVelocities
from mishutter.search.frame_levels import Frames, Levels, Shape
from mishutter.search.frame_limits import Room
from mishutter.search.frame_search import (
    Descent,
    End,
    again,
    best_of,
    near,
    shaken,
    within,
)
from mishutter.search.frame_ties import (
    AS_GOOD,
    BRACKETED,
    CIRCLE,
    MOST,
    MOST_FREE,
    SIMPLEST_FIRST,
    STILLS,
    TWO_SINES,
    WAYS,
    WAYS_ON_TWO_AXES,
    Tie,
)
from mishutter.search.frame_words import kind_of

_PIECES_OF_SINES, _PIECES_OF_FREE = 16, 16
"""Pieces of constant acceleration in all frames of two sines and of a free path, at least."""
_PIECES_OF_ONE = 8
"""Those of a free path over one exposure, which with more exploits what a grid leaves out."""
_FINER = 2
"""How many times the radii a search for one exposure has."""


@dataclass(frozen=True)
class PlaneSearch:
    """The best frames of each kind, and the level that none exceed.

    Attributes:
        snapshot: One exposure at rest.
        bursts: The best frames of each kind of way, the simplest first.
        ceiling: Level that no path over any number of frames exceeds; dB.
    """

    snapshot: Exposures
    bursts: tuple[Exposures, ...]
    ceiling: float


@outside_trace()
@alone_in_blas()
def best_in_plane(
    scene: Scene, *, progress: Callable[[float], None] = lambda share: None
) -> PlaneSearch:
    """The best frames of things that move in any direction, registered by their velocity.

    A stage of two axes follows a circle, two sines of different frequency, parabolas crossed at
    right angles, or one constant velocity a frame; one of a single axis sweeps, swings on a sine or
    on parabolas along the axis of the fastest things. Where things are found one by one there are
    only frames at rest. Limits hold for each axis, or for both
    together where they are those of a disc, from rest to rest. From the best way a free path
    descends by its gradient, and is among the bursts where it gains 0.05 dB.

    Args:
        scene: Velocities in any direction, light, noise, limits and burst; without a burst, which
            is possible where the decoder is told the velocity, it is one exposure.
        progress: Called with the share of the search that is done.

    Raises:
        ValueError: if the scene is of one axis, limits the jerk of its stage, or has no frames
            that tell the velocity.
    """
    require_scene(scene, in_plane=True)
    require_known("best_in_plane", scene=scene)
    require_velocities(scene)
    _require_no_jerk(scene)
    return _PlaneSearch.of(scene).found(progress)


def _require_no_jerk(scene: Scene) -> None:
    """Refuses a limit on the jerk, which ways in the plane do not keep."""
    jerk = scene.limits.max_jerk
    requirement = "be left out in the plane, where ways are of pieces of constant acceleration"
    got = Unquoted("" if jerk is None else f"{float(jerk):.6g}")
    require(jerk is None, "Limits(max_jerk=...)", requirement, got)


def stills_on_pan(scene: Scene) -> Exposures:
    """The best exposures of a camera that turned along with the mean of the things."""
    speed = float(np.hypot(*require_velocities(scene).centre))
    room = replace(scene.limits, pans="camera", max_pan=speed, max_top_speed=2 * speed)
    search = _PlaneSearch.of(replace(scene, limits=room))
    several, alone = search.times, search.times._replace(max_frames=1)
    bursts = (search.stills(times, search.offset) for times in (several, alone))
    return max(bursts, key=lambda burst: burst.level)


class _PlaneSearch(NamedTuple):
    """The part that is the same of all stages and numbers of frames."""

    scene: Scene
    law: AbstractVelocities
    times: FrameTimes
    counts: list[int]  # Numbers of frames to try
    offset: Float[np.ndarray, "2"]  # Velocity of a camera that turns; px/s

    @staticmethod
    def of(scene: Scene) -> "_PlaneSearch":
        """The search of a scene, of one exposure where it has no burst."""
        longest = 2 * float(scene.limits.max_half_exposure)
        none = BurstMode(frames_per_s=1 / longest, max_frames=1)
        times = FrameTimes.of(scene, none if scene.burst is None else scene.burst)
        least = 1 if scene.decoder_speed == "known" else 2
        possible = [n for n in times.numbers_of_frames if n <= MOST]
        counts = [n for n in some_numbers(possible[-1], 4) if n in possible and n >= least]
        requirement = (
            'have a burst with time for two frames, or `decoder_speed="known"`: frames tell it'
        )
        got = Unquoted("one exposure of unknown velocity")
        require(bool(counts), "scene", requirement, got)
        law = require_velocities(scene)
        return _PlaneSearch(scene, law, times, counts, turned_by(law, scene.limits))

    def found(self, progress: Callable[[float], None]) -> PlaneSearch:
        """The best frames of each kind, of which those before a background are at rest alone."""
        alone = self.times._replace(max_frames=1)
        snapshot = StillBursts(self.scene).best_sequence(alone)
        bursts = [self.stills(self.times)]
        # Before a background things are found by what stands still.
        if np.any(self.offset) and self.scene.occlusion is None:
            bursts.append(self.stills(self.times, self.offset))
        if self.scene.limits.moves and not self.scene.is_found_by_object:
            one, along = self.stage(1), []
            for index, count in enumerate(self.counts):
                progress(0.4 * index / len(self.counts))
                along += [one.best(kind, count) for kind in WAYS]
            bursts += self._bursts(one, along)
            if self.scene.limits.axes != "one":
                bursts += self._on_two_axes(one, along, bursts, progress)
        return PlaneSearch(
            snapshot,
            _best_of_each(bursts),
            self._ceiling({*self.counts, *(burst.num_frames for burst in bursts[:2])}),
        )

    def stills(self, times: FrameTimes, pan: Float[np.ndarray, "2"] | None = None) -> Exposures:
        """The best frames at rest, or on a camera that turns at a velocity, px/s."""
        return with_losses(self.scene, StillBursts(self.scene, pan=pan).best_sequence(times))

    def _ceiling(self, counts: set[int]) -> float:
        """Level that no path over any of some numbers of frames exceeds; dB."""
        exposures = [np.full(n, self.times.longest_of(n)) for n in sorted(counts)]
        return max(exposures_ceiling(self.scene, each) for each in exposures)

    def _on_two_axes(
        self,
        one: "_Stage",
        along: "Sequence[End | None]",
        bursts: Sequence[Exposures],
        progress: Callable[[float], None],
    ) -> list[Exposures]:
        """The best frames of each way on two axes, and free ones where they are better."""
        stage, ends = self.stage(2), []
        for index, count in enumerate(self.counts):
            progress(0.4 + 0.2 * index / len(self.counts))
            ends += [stage.best(kind, count, most=1) for kind in WAYS_ON_TWO_AXES]
        progress(0.6)
        if best := best_of(ends):  # at its number of frames from the other starts too
            count = best.frames.exposure.size
            ends += [stage.best(kind, count, first=1) for kind in WAYS_ON_TWO_AXES]
        flat = [
            None if end is None else end._replace(frames=_on_plane(end.frames, one.unit))
            for end in along
        ]
        made = self._bursts(stage, ends)
        free = self._bursts(stage, stage.free(flat, ends, progress=progress))
        top = max(burst.level for burst in (*bursts, *made))
        return made + [burst for burst in free if burst.level >= top + AS_GOOD]

    def _bursts(self, stage: "_Stage", ends: "Sequence[End | None]") -> list[Exposures]:
        """The best frames of each kind, fewer where more gain too little."""
        kinds: dict[str, End] = {}
        for end in ends:
            if end is not None:
                before = kinds.get(end.kind)
                if before is None or end.level > before.level + AS_GOOD / 2:
                    kinds[end.kind] = end
        every = (self._burst(stage, end) for end in kinds.values())
        return [burst for burst in every if burst is not None]

    def _burst(self, stage: "_Stage", end: End) -> Exposures | None:
        """Frames with their level, within the limits; None where they are far from them."""
        limits = self.scene.limits

        def exposures_of(frames: Frames) -> Exposures:
            return exposures_in_plane(self.scene, end.kind, stage.made(frames), math.nan)

        burst = within(limits, end.frames, exposures_of)
        if burst is None:
            return None
        made: FramePath = burst.for_rows(self.scene.sensor.readout_time, limits).path  # type: ignore[assignment]
        width, loss = self.scene.registered_width, None
        if width is not None and made.num_frames > 1:
            loss = loss_of_width(self.scene, made, width=width)
        psnr = float(exposures_psnr(self.scene, made))
        found = exposures_in_plane(self.scene, end.kind, made, psnr, width_loss=loss)
        return replace(found, kind=kind_of(found) if found.num_axes else STILLS)

    def stage(self, num_axes: int) -> "_Stage":
        """A stage of one axis along the fastest things, or of two."""
        along = np.array([math.cos(self.law.axis), math.sin(self.law.axis)])
        unit = along[None] if num_axes == 1 else np.eye(2)
        room = Room.of(self.scene.limits, self.times, self.law.fastest)
        top = float(self.scene.limits.max_top_speed) - float(np.hypot(*self.offset))
        room = room._replace(top_speed=min(room.top_speed, top), turns=False)
        # A single exposure exploits more of what a grid leaves out than several do together.
        more = _FINER if self.counts == [1] else 1
        grid = SEARCHED._replace(num_radii=more * SEARCHED.num_radii)
        levels = Levels.in_plane(self.scene, grid, unit, self.offset)
        return _Stage(self, unit, along, levels, room)


class _Stage(NamedTuple):
    """A stage of one axis or two, and what it may do over frames."""

    search: _PlaneSearch
    unit: Float[np.ndarray, "axes 2"]  # Directions of its axes
    along: Float[np.ndarray, "2"]  # Direction of the fastest things
    levels: Levels
    room: Room

    def best(self, kind: str, count: int, *, first: int = 0, most: int | None = None) -> End | None:
        """The best frames of a way of few numbers, from all starts or some."""
        sines = kind in (CIRCLE, TWO_SINES)
        pieces = max(-(-_PIECES_OF_SINES // count), 1) if sines else 1
        tie = self._tie(kind, Shape(count, pieces, self.unit.shape[0]))
        if not tie.exists:
            return None
        return Descent(self.levels, self.room, tie.shape).best(tie, tie.starts[first:most])

    def _tie(self, kind: str, shape: Shape) -> Tie:
        """Frames of few numbers, about the mean of the things."""
        law, offset = self.search.law, self.search.offset
        speeds, weights = law.components(np.array([law.axis]), SEARCHED.num_speeds)
        occurring = np.asarray(speeds)[np.asarray(weights) > 0] - self.along @ offset
        centre = law.centre - offset
        aside = centre - (centre @ self.along) * self.along
        widest = float(law.greatest(np.array([law.axis + np.pi / 2]))[0])
        ends = float(np.min(occurring)), float(np.max(occurring))
        unit, across = self.unit @ self.along, self.unit @ aside
        return Tie(kind, self.room, shape, *ends, unit, across, widest=widest)

    def free(self, *ends: "Sequence[End | None]", progress: Callable[[float], None]) -> list[End]:
        """Ends of descents in which each frame has numbers of its own, from the best of each."""
        found, alone = [], self.search.counts == [1]
        for index, some in enumerate(ends):
            progress(0.7 + 0.2 * index / len(ends))
            best = best_of([x for x in some if x and x.frames.exposure.size <= MOST_FREE])
            if best is not None:
                count = best.frames.exposure.size
                pieces = _PIECES_OF_ONE if alone else max(-(-_PIECES_OF_FREE // count), 1)
                start = _resampled(best.frames, pieces)
                start = shaken(start, np.random.default_rng(count), self.room, 0.01)
                found.append(Descent(self.levels, self.room, start.shape).free(start))
        best = best_of(found)
        if best is None:
            return []
        progress(0.9)
        if alone:  # as levels are told
            told = Levels.in_plane(self.search.scene, MEASURED, self.unit, self.search.offset)
            last = Descent(told, self.room, best.frames.shape).free(best.frames)
            return [last or best]
        return [best, *again(self.levels, self.room, best, near(self.room), times=1)]

    def made(self, frames: Frames) -> FramePath:
        """The frames and the path of the sensor through them, in the plane."""
        count, ends, _ = frames.velocity.shape
        step, between = frames.steps, frames.between
        durations, velocities = [], [frames.velocity[:1, 0]]
        for k in range(count):
            durations.append(np.full(ends - 1, step[k, 0]))
            velocities.append(frames.velocity[k, 1:])
            if k + 1 < count and frames.gap[k] > 1e-9 * frames.exposure[k]:
                pair = frames.velocity[k, -1], frames.velocity[k + 1, 0]
                times, values = self._between(between[k], float(frames.gap[k]), *pair)
                durations.append(times)
                velocities.append(values)
        path = np.concatenate(velocities) @ self.unit + self.search.offset
        return FramePath(frames.middles, frames.exposure, np.concatenate(durations), path.T)

    def _between(
        self, way: np.ndarray, gap: float, leave: np.ndarray, meet: np.ndarray
    ) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "p axes"]]:
        """Durations of the pieces between two frames, and the velocities at their ends."""
        share = math.sqrt(0.5) if self.room.together and way.size == 2 else 1.0
        most, top = share * self.room.acceleration, share * self.room.top_speed
        own = []
        for each, start, end in zip(way.tolist(), leave.tolist(), meet.tolist(), strict=True):
            pieces = transfer(
                each, gap, start, end, acceleration=most, top_speed=top, span=(0.0, 0.0)
            )
            knots = Knots.of(start, pieces)
            own.append((np.append(0.0, np.cumsum(knots.durations)), knots.velocities))
        times = np.unique(np.clip(np.concatenate([times for times, _ in own]), 0.0, gap))
        times = times[np.append(True, np.diff(times) > 1e-9 * gap)]
        times[-1] = gap
        values = [np.interp(times, *each) for each in own]
        return np.diff(times), np.stack(values, axis=-1)[1:]


def _best_of_each(bursts: Sequence[Exposures]) -> tuple[Exposures, ...]:
    """The best of those that go the same way on as many axes, the simplest first."""
    kept: dict[tuple[int, str, bool], Exposures] = {}
    for burst in sorted(bursts, key=lambda x: (x.num_axes, SIMPLEST_FIRST.index(x.kind))):
        before = kept.get(key := (burst.num_axes, burst.kind, bool(np.any(burst.pan))))
        if before is None or burst.level > before.level + AS_GOOD / 2:
            kept[key] = burst
    return tuple(kept.values())


def _resampled(frames: Frames, pieces: int) -> Frames:
    """The frames by the velocities at the ends of other pieces."""
    old, new = (np.linspace(0, 1, n + 1) for n in (frames.velocity.shape[1] - 1, pieces))
    rows = [[np.interp(new, old, axis) for axis in frame.T] for frame in frames.velocity]
    return frames._replace(velocity=np.moveaxis(np.array(rows), 1, 2))


def _on_plane(frames: Frames, unit: Float[np.ndarray, "1 2"]) -> Frames:
    """Frames along one axis by their components along rows and columns."""
    middle = np.mean(frames.place)
    place = middle + (frames.place - middle) @ unit
    return frames._replace(velocity=frames.velocity @ unit, place=place, pan=frames.pan @ unit)


def search_words(scene: Scene) -> str:
    """The computations of a search in the plane, in words."""
    _require_no_jerk(scene)
    radii, angles, speeds, corner = SEARCHED
    finer = f"{MEASURED.num_radii} x {MEASURED.num_angles} x {MEASURED.num_speeds}"
    tried, free = [STILLS, BRACKETED], ""
    if not scene.limits.moves or scene.is_found_by_object:
        over = f"with levels over {finer} radii, directions and velocities"
        said = f"{' and '.join(tried)}, {over}"
    else:
        tried += WAYS
        if scene.limits.axes != "one":
            tried += WAYS_ON_TWO_AXES
            free = ", and from the best of them a velocity and a place of its own for each frame"
        said = (
            f"{', '.join(tried)}{free}, over {radii} radii x {angles} directions x {speeds} "
            f"velocities and {corner} radii of the corners, and {_FINER} times the radii for one "
            f"exposure alone; levels are over {finer}, as is the last descent of one exposure"
        )
    return (
        f"The search tries {said}. A list of few velocities has the more directions. One filter "
        "for all velocities is not searched: it gains nothing there."
    )
