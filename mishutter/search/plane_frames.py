"""The best frames of things that move in any direction, on stages of no axis, one or two."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import Unquoted, require, require_known
from mishutter._core.compiling import outside_trace
from mishutter._core.parallel import alone_in_blas
from mishutter.evaluation.bursts import FrameTimes, some_numbers
from mishutter.evaluation.ceilings import exposures_ceiling
from mishutter.evaluation.fans import MEASURED, Fan, Grid
from mishutter.evaluation.levels import Light, exposures_psnr, require_velocities
from mishutter.evaluation.sequences import loss_of_width
from mishutter.model.scene import Scene, require_scene
from mishutter.model.sensor import BurstMode
from mishutter.model.stages import Knots, transfer
from mishutter.model.velocities import AbstractVelocities
from mishutter.plane.bursts import PlaneBurst, of_stage, pan_of
from mishutter.plane.frames import PlaneFrames
from mishutter.search.frame_levels import Frames, Levels
from mishutter.search.frame_limits import Room
from mishutter.search.frame_search import (
    BRACKETED,
    CIRCLE,
    CROSSED,
    FREE,
    MOST_FREE,
    RING,
    STILLS,
    TWO_SINES,
    WAYS,
    Descent,
    End,
    Search,
    Tie,
)

_AS_GOOD = 0.05
"""Decibels below the best at which simpler frames are preferred, and that a free path must gain."""
_SEARCHED = Grid(24, 8, 16)
"""The grid of a search, other than that by which levels are told: it exploits no ripple."""
_ALL_PIECES = 12
"""Pieces of constant acceleration in all frames of a free path, at least."""
_BEYOND = 1.05


@dataclass(frozen=True)
class PlaneSearch:
    """The best frames of each kind, and the level that none exceed.

    Attributes:
        snapshot: One exposure at rest.
        bursts: The best frames of each kind of way, the simplest first.
        ceiling: Level that no path over any number of frames exceeds; dB.
    """

    snapshot: PlaneBurst
    bursts: tuple[PlaneBurst, ...]
    ceiling: float

    @property
    def simplest(self) -> tuple[PlaneBurst, ...]:
        """For each number of axes of a stage, the simplest frames within 0.05 dB of the best."""
        chosen = []
        for axes in sorted({burst.num_axes for burst in self.bursts}):
            group = [burst for burst in self.bursts if burst.num_axes == axes]
            most = max(burst.level for burst in group)
            chosen.append(next(burst for burst in group if burst.level >= most - _AS_GOOD))
        return tuple(chosen)


@outside_trace()
@alone_in_blas()
def best_in_plane(
    scene: Scene, *, progress: Callable[[float], None] = lambda share: None
) -> PlaneSearch:
    """The best frames of things that move in any direction, registered by their velocity.

    A stage of two axes follows a circle, two sines of different frequency, parabolas crossed at
    right angles, or one constant velocity a frame; one of a single axis sweeps, swings on a sine or
    on parabolas along the axis of the fastest things. Limits hold for each axis, or for both
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
    jerk = scene.limits.max_jerk
    requirement = "be left out in the plane, where ways are of pieces of constant acceleration"
    require(jerk is None, "Limits(max_jerk=...)", requirement, jerk)
    return _PlaneSearch.of(scene).found(progress)


class _PlaneSearch(NamedTuple):
    """The part that is the same of all stages and numbers of frames."""

    scene: Scene
    times: FrameTimes
    fan: Fan
    least: int  # Least number of frames that something registers
    offset: Float[np.ndarray, "2"]  # Velocity of a camera that turns; px/s

    @staticmethod
    def of(scene: Scene) -> "_PlaneSearch":
        """The search of a scene, of one exposure where it has no burst."""
        longest = 2 * float(scene.limits.max_half_exposure)
        none = BurstMode(frames_per_s=1 / longest, max_frames=1)
        times = FrameTimes.of(scene, none if scene.burst is None else scene.burst)
        times = times._replace(max_frames=min(times.max_frames or 64, 64))
        least = 1 if scene.decoder_speed == "known" else 2
        law, limits = require_velocities(scene), scene.limits
        offset = pan_of(law, limits) if limits.pans == "camera" else np.zeros(2)
        search = _PlaneSearch(scene, times, Fan.of(scene, _SEARCHED), least, offset)
        requirement = (
            'have a burst with time for two frames, or `decoder_speed="known"`: frames tell it'
        )
        has_counts = search.counts[-1] >= least
        require(has_counts, "scene", requirement, Unquoted("one exposure of unknown velocity"))
        return search

    @property
    def counts(self) -> list[int]:
        """Numbers of frames to try."""
        possible = self.times.numbers_of_frames
        return [count for count in some_numbers(possible[-1], 4) if count in possible]

    def levels(self, unit: Float[np.ndarray, "axes 2"]) -> Levels:
        """Errors by the velocities of a stage along some axes."""
        fan, law, scene = self.fan, require_velocities(self.scene), self.scene
        turn = np.stack([np.cos(fan.direction), np.sin(fan.direction)], axis=-1)
        frequency = (fan.radius[:, None, None] * turn).reshape(-1, 2)
        parts = law.components(np.ravel(fan.direction), _SEARCHED.num_speeds)
        speeds, shares = (np.asarray(x, np.float64) for x in parts)
        temporal = np.hypot(*frequency.T)[:, None] * speeds - (frequency @ self.offset)[:, None]
        variance = float(scene.picture.deviation) ** 2
        weight = variance * np.ravel(fan.weight)[:, None] * shares
        is_there = np.max(weight, axis=0) > 0
        weight = np.broadcast_to(weight, temporal.shape)[:, is_there]
        signal = np.ravel(np.asarray(Light.of(scene).signal(fan), np.float64))
        passes = np.max(weight, axis=1) > 0
        numbers = (frequency @ unit.T, temporal[:, is_there], weight, signal)
        return Levels.of_light(scene, *(x[passes] for x in numbers))

    def stage(self, num_axes: int) -> "_Stage":
        """A stage of one axis along the fastest things, or of two."""
        law, limits = require_velocities(self.scene), self.scene.limits
        angle = law.axis
        along = np.array([math.cos(angle), math.sin(angle)])
        unit = along[None] if num_axes == 1 else np.eye(2)
        top = float(limits.max_top_speed) - float(np.hypot(*self.offset))
        room = Room.of(limits, self.times, law.fastest)
        room = room._replace(top_speed=min(room.top_speed, top), turns=False)
        return _Stage(self, unit, along, self.levels(unit), room)

    def found(self, progress: Callable[[float], None]) -> PlaneSearch:
        """The best frames of each kind."""
        one, law = self.stage(1), require_velocities(self.scene)
        counts = [count for count in self.counts if count >= self.least]
        ends: list[tuple[End, int]] = []
        snapshot = one.stills(1)
        for number, count in enumerate(counts):
            progress(0.4 * number / len(counts))
            ends += [(one.stills(count), 0)]
            if count > 1:
                ends += [(one.stills(count, of_two=True), 0)]
            ends += [(end, 1) for end in one.ways(count, law)]
        bursts = self.best(ends, one)
        if self.scene.limits.axes != "one":
            two, along = self.stage(2), [end for end, axes in ends if axes]
            ends = []
            for number, count in enumerate(counts):
                progress(0.4 + 0.2 * number / len(counts))
                ends += [(end, 2) for end in two.ways(count, law, most=1)]
            good = [end for end, _ in ends if end.frames is not None]
            if good:
                count = max(good, key=lambda end: end.level).frames.exposure.size
                ends += [(end, 2) for end in two.ways(count, law)]
            of_two = self.best(ends, two)
            progress(0.7)
            flat = [x._replace(frames=_on_plane(x.frames, one.unit)) for x in along if x.frames]
            free = two.free(flat, [end for end, _ in ends])
            known = {burst.kind for burst in bursts}
            bursts += [burst for burst in of_two if burst.kind not in known]
            top = max(burst.level for burst in bursts)
            several = [self.burst(end, two, 2) for end in free]
            best = max((x for x in several if x), key=lambda x: x.level, default=None)
            if best is not None and best.level >= top + _AS_GOOD:
                bursts.append(best)
        longest = [self.times.longest_of(n) for n in counts]
        exposures = [np.full(n, x) for n, x in zip(counts, longest, strict=True)]
        ceiling = max(exposures_ceiling(self.scene, each) for each in exposures)
        first = self.burst(snapshot, one, 0)
        return PlaneSearch(first, tuple(bursts), ceiling)  # type: ignore[arg-type]

    def best(self, ends: list[tuple[End, int]], stage: "_Stage") -> list[PlaneBurst]:
        """The best frames of each kind, fewer where more gain too little."""
        kinds: dict[str, tuple[End, int]] = {}
        for end, axes in ends:
            before = kinds.get(end.kind)
            if end.frames is not None and (
                before is None or end.level > before[0].level + _AS_GOOD / 2
            ):
                kinds[end.kind] = end, axes
        made = [self.burst(end, stage, axes) for end, axes in kinds.values()]
        return [burst for burst in made if burst is not None]

    def burst(self, end: End, stage: "_Stage", num_axes: int) -> PlaneBurst | None:
        """Frames with their level, within the limits; None where they are far from them."""
        limits, law = self.scene.limits, require_velocities(self.scene)
        if end.frames is None:
            return None
        frames = end.frames
        for _ in range(3):
            made = stage.made(frames)
            use = of_stage(made, law, limits).use(limits)
            accelerated = of_stage(made, law, limits).acceleration(limits)
            pairs = (
                (use.stroke, limits.max_stroke),
                (use.travel, limits.max_travel),
                (use.top_speed, limits.max_top_speed),
                (accelerated, limits.max_acceleration),
            )
            share = max(float(a) / float(b) for a, b in pairs if b is not None)
            if share <= 1:
                break
            if share > _BEYOND:
                return None
            slower = (1 - 1e-9) / share
            velocity, place = frames.velocity * slower, frames.place * slower
            frames = frames._replace(velocity=velocity, place=place)
        psnr = float(exposures_psnr(self.scene, made))
        width, loss = self.scene.registered_width, None
        if width is not None and made.num_frames > 1:
            loss = loss_of_width(self.scene, made, width=width)
        num_axes = 0 if made.stays else num_axes
        return PlaneBurst(
            end.kind if num_axes or end.kind == BRACKETED else STILLS,
            num_axes,
            made,
            psnr,
            use,
            loss,
        )


class _Stage(NamedTuple):
    """A stage of one axis or two, and what it may do over frames."""

    search: _PlaneSearch
    unit: Float[np.ndarray, "axes 2"]  # Directions of its axes
    along: Float[np.ndarray, "2"]  # Direction of the fastest things
    levels: Levels
    room: Room

    def tie(self, kind: str, shape: tuple[int, int, int], law: AbstractVelocities) -> Tie:
        """Frames of few numbers, about the mean of the things."""
        parts = law.components(np.array([law.axis]), _SEARCHED.num_speeds)
        speeds = np.asarray(parts.speeds)[np.asarray(parts.weights) > 0] - float(
            self.along @ self.search.offset
        )
        centre = law.centre - self.search.offset
        aside = centre - (centre @ self.along) * self.along
        across = float(law.greatest(np.array([law.axis + np.pi / 2]))[0])
        unit, mean = self.unit @ self.along, self.unit @ aside
        ends = float(np.min(speeds)), float(np.max(speeds))
        return Tie(kind, self.room, shape, *ends, unit, mean, math.inf, across)

    def stills(self, count: int, *, of_two: bool = False) -> End:
        """Frames at rest of one exposure or two."""
        axes = self.unit.shape[0]
        descent = Descent(self.levels, self.room, (count, 1, axes))
        law = require_velocities(self.search.scene)
        tie = self.tie(BRACKETED if of_two else STILLS, descent.shape, law)
        return max((descent.tied(tie, x) for x in tie.starts), key=lambda end: end.level)

    def ways(self, count: int, law: AbstractVelocities, most: int | None = None) -> list[End]:
        """The best frames of each way of few numbers, from all starts or some."""
        axes = self.unit.shape[0]
        pieces = {1: WAYS, 2: (CIRCLE, TWO_SINES, CROSSED, RING)}[axes]
        ends = []
        for kind in pieces:
            number = max(-(-_PIECES // count), 1) if kind in (CIRCLE, TWO_SINES) else 1
            tie = self.tie(kind, (count, number, axes), law)
            if tie.exists:
                descent = Descent(self.levels, self.room, tie.shape)
                starts = tie.starts[: most or len(tie.starts)]
                ends.append(max((descent.tied(tie, x) for x in starts), key=lambda e: e.level))
        return ends

    def free(self, *ends: list[End]) -> list[End]:
        """Ends of descents in which each frame has numbers of its own, from the best of each kind."""
        found = []
        for some in ends:
            few = [x for x in some if x.frames is not None and x.frames.exposure.size <= MOST_FREE]
            if not few:
                continue
            best = max(few, key=lambda end: end.level).frames
            count = best.exposure.size
            pieces = max(-(-_ALL_PIECES // count), 1)
            descent = Descent(self.levels, self.room, (count, pieces, 2))
            start = _shaken(_resampled(best, pieces), np.random.default_rng(count), self.room)
            found.append(descent.from_frames(start, FREE))
        found = [end for end in found if end.frames is not None]
        if found:
            best = max(found, key=lambda end: end.level)
            pieces = best.frames.velocity.shape[1] - 1
            search = Search(self.levels, self.room, 2, lambda shape: [], lambda count: pieces)
            found += search.again(best, times=1)
        return found

    def made(self, frames: Frames) -> PlaneFrames:
        """The frames and the path of the sensor through them, in the plane."""
        count, ends, axes = frames.velocity.shape
        durations: list[float] = []
        velocities = [frames.velocity[0, 0]]
        step = frames.exposure / (ends - 1)
        whole = frames.place + step[:, None] * np.sum(
            (frames.velocity[:, 1:] + frames.velocity[:, :-1]) / 2, axis=1
        )
        for k in range(count):
            durations += [float(step[k])] * (ends - 1)
            velocities += [*frames.velocity[k, 1:]]
            if k + 1 == count:
                break
            gap = float(frames.gap[k])
            if gap <= 1e-9 * frames.exposure[k]:
                continue
            ways = frames.place[k + 1] - whole[k]
            own = []
            for axis in range(axes):
                start, end = (
                    float(x[axis]) for x in (frames.velocity[k, -1], frames.velocity[k + 1, 0])
                )
                share = math.sqrt(0.5) if self.room.together and axes == 2 else 1.0
                limits = {"top_speed": share * self.room.top_speed}
                own.append(
                    Knots.of(
                        start,
                        transfer(
                            float(ways[axis]),
                            gap,
                            start,
                            end,
                            acceleration=share * self.room.acceleration,
                            span=(0.0, 0.0),
                            **limits,
                        ),
                    )
                )
            times = np.unique(
                np.concatenate(
                    [np.minimum(np.cumsum(x.durations), gap) for x in own] + [[0.0, gap]]
                )
            )
            times = times[np.r_[True, np.diff(times) > 1e-12 * gap]]
            values = np.stack(
                [np.interp(times, np.r_[0, np.cumsum(x.durations)], x.velocities) for x in own], -1
            )
            durations += np.diff(times).tolist()
            velocities += [*values[1:]]
        path = np.array(velocities) @ self.unit + self.search.offset
        begins = np.concatenate([[0.0], np.cumsum(frames.exposure[:-1] + frames.gap)])
        middles = begins + frames.exposure / 2 - (begins[-1] + frames.exposure[-1]) / 2
        return PlaneFrames(middles, frames.exposure, np.array(durations), path.T)


_PIECES = 16
"""Pieces in all frames of two sines, at least."""


def _resampled(frames: Frames, pieces: int) -> Frames:
    """The frames by the velocities at the ends of other pieces."""
    old = np.linspace(0, 1, frames.velocity.shape[1])
    new = np.linspace(0, 1, pieces + 1)
    rows = [[np.interp(new, old, x) for x in each.T] for each in frames.velocity]
    return frames._replace(velocity=np.moveaxis(np.array(rows), 1, 2))


def _on_plane(frames: Frames, unit: Float[np.ndarray, "1 2"]) -> Frames:
    """Frames along one axis by their components along rows and columns."""
    middle = np.mean(frames.place)
    place = middle + (frames.place - middle) @ unit
    return frames._replace(velocity=frames.velocity @ unit, place=place, pan=frames.pan @ unit)


def _shaken(frames: Frames, draw: np.random.Generator, room: Room) -> Frames:
    noise = 0.01 * room.speed * draw.normal(size=frames.velocity.shape)
    return frames._replace(velocity=frames.velocity + noise)


def grid_words() -> str:
    """The computations of a search in the plane, in words."""
    radii, angles, speeds, corner = _SEARCHED
    finer = f"{MEASURED.num_radii} x {MEASURED.num_angles} x {MEASURED.num_speeds}"
    ways = ", ".join((STILLS, BRACKETED, *WAYS, CIRCLE, TWO_SINES, CROSSED, RING))
    return (
        f"The search tries {ways}, and from the best of them a velocity and a place of its own for "
        f"each frame, over {radii} radii x {angles} directions x {speeds} velocities and {corner} "
        f"radii of the corners; levels are over {finer}. One filter for all velocities is not "
        "searched: it gains nothing there."
    )
