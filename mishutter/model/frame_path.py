"""Frames that a camera takes one after the other, and the path of its sensor through them.

They are said in two ways, of which all else asks the same: of `TimedFrames` each is an exposure
along one axis, and the limits of a stage say how it goes from one to the next; a `FramePath` is the
whole path along one axis or two.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import NamedTuple, final, overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import (
    Numbers,
    all_concrete,
    as_numpy,
    common_dtype,
    namespace_of,
    require,
)
from mishutter._core.modules import AbstractModule
from mishutter._core.slopes import largest_of, length_of
from mishutter.model.limits import Limits
from mishutter.model.motion import AbstractMotion
from mishutter.model.stages import (
    SINGLE,
    Knots,
    Piece,
    StagePath,
    StageUse,
    extent,
    led,
    place_at_begin,
    run_up,
    transfer,
)

AT_REST = 0.05
"""Travel below which a sensor counts as standing still; px."""
Lights = list[tuple[float, float]]
"""First and last light of exposures; s."""
SINE = "sine"
"""Kind of a sequence whose stage follows a sine between its frames too."""
_PIECES_OF_SINE = 16
"""Pieces of constant jerk from one turning point of a sine to the next."""
_DIRECTIONS = np.arange(16) * np.pi / 16
"""Directions along which two axes keep a limit together."""


@partial(
    jax.tree_util.register_dataclass, data_fields=("motion", "time", "position"), meta_fields=()
)
@dataclass(frozen=True)
class TimedFrame:
    """An exposure of an open shutter, one of a sequence; all its numbers may be differentiated.

    Attributes:
        motion: Motion of the sensor, from its mid-exposure.
        time: Mid-exposure, from the middle of the sequence; s.
        position: Position of the sensor at mid-exposure, in a camera that pans; px.
    """

    motion: AbstractMotion
    time: float | Numbers
    position: float | Numbers = 0.0

    @property
    def exposure(self) -> float:
        """Time from its first to its last light; s."""
        return float(self.motion.exposure)

    @property
    def is_still(self) -> bool:
        """Whether its sensor stands still."""
        return float(self.motion.stroke) < AT_REST


@final
class FramePath(AbstractModule):
    """Frames of an open shutter, one after the other, and the path of the sensor through them.

    It has pieces of constant acceleration from the first light of any row to the last, along one
    axis or along rows and columns. All numbers may be differentiated.

    Attributes:
        times: Mid-exposures, ascending; s, shape `(n,)`.
        exposures: Exposures, of which 0 is no frame; s, shape `(n,)`.
        durations: Durations of the pieces, of which some may be 0; s, shape `(p,)`.
        velocities: Velocities along each axis at their ends; px/s, shape `(axes, p + 1)`.
        lead: Time by which the path begins before the first light, and ends after the last, for
            rows that are exposed earlier and later; s.
        jerks: Jerks of the pieces of a path along one axis; px/s^3, shape `(p,)`. None where the
            acceleration is constant in each.
        aside: Way from the place at the time 0 to that of the `middle` of the timed frames that the
            path is of; px, shape `(axes,)`. None of other paths.
    """

    times: Float[Array | np.ndarray, "n"]
    exposures: Float[Array | np.ndarray, "n"]
    durations: Float[Array | np.ndarray, "p"]
    velocities: Float[Array | np.ndarray, "axes p+1"]
    lead: float = eqx.field(static=True, default=0.0)
    jerks: Float[np.ndarray, "p"] | None = None
    aside: Float[np.ndarray, "axes"] | None = None

    @property
    def duration(self) -> float:
        """Time from the first light to the last; s, of concrete frames."""
        ends = np.asarray(self.times) + np.asarray(self.exposures) / 2
        return float(ends[-1] - self._begin)

    @property
    def _begin(self) -> Array | np.ndarray | np.floating:
        return self.times[0] - self.exposures[0] / 2

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return self.times.shape[0]

    @property
    def num_axes(self) -> int:
        """Axes of its places."""
        return len(self.velocities)

    @property
    def num_moved(self) -> int:
        """Axes of the stage that known frames need; 0 at rest."""
        if self.stays:
            return 0
        sizes = np.linalg.svd(self.velocities, compute_uv=False)
        return int(np.sum(sizes > SINGLE * sizes[0]))

    @property
    def rests(self) -> list[bool]:
        """Whether the sensor stands still; it counts as moving in all known frames or in none."""
        return [self.stays] * self.num_frames

    @property
    def middle(self) -> tuple[Numbers | float, Numbers]:
        """The time between the first light and the last, s, and the place then, px.

        Of timed frames both are theirs.
        """
        if self.aside is not None:
            return 0.0, self.place(np.zeros(1))[:, 0] + self.aside
        ends = self.times - self.exposures / 2, self.times + self.exposures / 2
        middle = (ends[0][:1] + ends[1][-1:]) / 2
        return middle[0], self.place(middle)[:, 0]

    def cuts(self, begin: Numbers, end: Numbers, delay: float) -> Numbers:
        """Bends of a path for rows within each exposure; beyond the last that it has, its end.

        Args:
            begin: Time at which each exposure begins; s, shape (n,).
            end: Time at which each ends.
            delay: Time by which a row is later than the middle one; s.
        """
        if not (self.lead or delay):
            return begin[:, None][:, :0]
        bends, ends = self.bends, zip(begin, end, strict=True)
        inner = [bends[(bends > low) & (bends < high)] for low, high in ends]
        cuts = np.tile(end[:, None], max(each.size for each in inner))
        for row, each in zip(cuts, inner, strict=True):
            row[: each.size] = each
        return cuts

    def beside(self, pan: Float[np.ndarray, "axes"]) -> "FramePath":
        """The frames as the stage makes them, beside a camera that turns.

        Args:
            pan: Velocity at which the camera turns along each axis; px/s.
        """
        if not np.any(pan):
            return self
        return eqx.tree_at(lambda x: x.velocities, self, self.velocities - pan[:, None])

    def for_rows(
        self, readout: float, limits: Limits, pan: Float[np.ndarray, "axes"] | None = None
    ) -> "FramePath":
        """Known frames, on a path that goes on while rows are exposed earlier and later.

        Args:
            readout: Time from the first row to the last; s.
            limits: Limits of the stage.
            pan: Velocity at which the camera turns along each axis, px/s; by default it does not.
        """
        if self.lead or self.stays or not readout:
            return self
        if pan is not None and np.any(pan):
            return self.beside(pan).for_rows(readout, limits).beside(-pan)
        durations, velocities, _ = led(*self._known, readout / 2)
        going_on = replace(self, durations=durations, velocities=velocities, lead=readout / 2)
        use = going_on.use(limits)
        if limits.have_room_for(travel=float(use.travel), stroke=float(use.stroke)):
            return going_on
        knots = self.knots(limits)
        rest = max(readout / 2 - float(min(knots.durations[0], knots.durations[-1])), 0.0)
        ends = np.zeros((len(knots.velocities), 1))
        return replace(
            self,
            durations=np.r_[rest, knots.durations, rest],
            velocities=np.hstack([ends, knots.velocities, ends]),
            lead=rest + float(knots.durations[0]),
        )

    path_for_rows = for_rows

    def place(self, time: Float[Numbers, "*shape"]) -> Float[Numbers, "axes *shape"]:
        """Place of the sensor, from that at the begin of the path; px.

        Args:
            time: Time on the clock of `times`; s.
        """
        d, v, time, begin = as_numpy(self.durations, self.velocities, time, self._begin - self.lead)
        space = namespace_of(d, v, time, begin)
        ends = space.concatenate([space.zeros_like(d[:1]), space.cumsum(d)])
        places = Knots(d[None], v, self.jerks, 0, d.size).positions
        since = space.asarray(time, d.dtype) - begin
        piece = space.searchsorted(ends, since.ravel(), side="right").reshape(since.shape) - 1
        piece = space.clip(piece, 0, d.size - 1)
        lasts = d[piece]
        # Pieces without a length meet no time but one at their end.
        elapsed = since - ends[piece]
        share = elapsed / space.where(lasts > 0, lasts, 1.0)
        start, end = v[:, piece], v[:, piece + 1]
        share, elapsed = share[None], elapsed[None]
        way = start + share * (end - start) / 2
        if self.jerks is not None:
            way = way + (self.jerks * d * d / 2)[piece] * share * (share / 3 - 0.5)
        return places[:, piece] + elapsed * way

    @property
    def _known(self) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "axes p+1"]]:
        """Its pieces, of a concrete path."""
        return np.asarray(self.durations, np.float64), np.asarray(self.velocities, np.float64)

    @property
    def top_speed(self) -> float:
        """Greatest speed of the sensor; px/s, of concrete frames."""
        return float(np.max(np.linalg.norm(self._known[1], axis=0)))

    @property
    def bends(self) -> Float[np.ndarray, "k"]:
        """Times at which its velocity or its acceleration jumps; s, of a concrete path."""
        begin = float(self._begin) - self.lead
        return begin + np.append(0.0, np.cumsum(self._known[0]))

    @property
    def stays(self) -> bool:
        """Whether the sensor stands still in all frames; of concrete frames."""
        return self.top_speed * float(np.max(np.asarray(self.exposures))) < AT_REST

    def knots(self, limits: Limits) -> Knots:
        """The way from rest to rest, along each axis.

        The stage runs up straight to the velocity of the first light, at the greatest acceleration
        of the limits; at once where they have none.

        Args:
            limits: Those of the stage.
        """
        durations, velocities = self.durations, self.velocities
        if all_concrete((durations, velocities)):
            durations, velocities = self._known
        most = math.inf if limits.max_acceleration is None else float(limits.max_acceleration)
        space = namespace_of(durations, velocities)
        first, last = (_sizes(v, limits) / most for v in (velocities[:, :1], velocities[:, -1:]))
        rest, durations = 0 * velocities[:, :1], space.concatenate([first, durations, last])
        velocities = space.concatenate([rest, velocities, rest], axis=1)
        return Knots(durations, velocities, None, 1, durations.size - 1)

    @property
    def gentle_stroke(self) -> float:
        """Travel of an axis of a stage of any acceleration from first to last light; px."""
        return float(self.use(Limits()).stroke)

    def use(self, limits: Limits) -> StageUse:
        """The demands on each axis of a stage, or on both together where limits are of a disc.

        Args:
            limits: Those of the stage.
        """
        knots = self.knots(limits)
        space = namespace_of(knots.durations, knots.velocities)
        if len(knots.velocities) == 1:
            return knots._replace(velocities=knots.velocities[0]).use
        units = np.eye(2)
        if limits.axes == "disc":  # between two directions there may be that much more
            units = np.stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)], axis=-1)
            units = units / np.cos(_DIRECTIONS[1] / 2)
        elif limits.axes == "one":
            speeds = length_of(knots.velocities)
            fastest = space.argmax(speeds)
            speed = speeds[fastest]
            units = (knots.velocities[:, fastest] / space.where(speed > 0, speed, 1.0))[None]
        along = space.asarray(units, knots.velocities.dtype) @ knots.velocities
        use = knots._replace(durations=knots.durations[None], velocities=along).use
        return StageUse(*map(largest_of, use))

    def acceleration(self, limits: Limits) -> Numbers | np.floating:
        """Greatest acceleration of an axis or of both, infinite where a velocity jumps; px/s^2.

        Args:
            limits: Those of the stage.
        """
        d, velocities = as_numpy(self.durations, self.velocities)
        space = namespace_of(d, velocities)
        size = _sizes(space.diff(velocities), limits)
        at_once = space.where(size > 0, math.inf, 0.0)
        return largest_of(space.where(d > 0, size / space.where(d > 0, d, 1.0), at_once))

    def stage_paths(self, limits: Limits) -> list[StagePath]:
        """The paths of the stage along each axis, each about the middle of its travel.

        Args:
            limits: Those of the stage.
        """
        most = limits.max_acceleration
        most = float(self.acceleration(limits) if most is None else most)
        if self.stays or not 0 < most < math.inf:
            return []
        knots, paths = self.knots(replace(limits, max_acceleration=most)), []
        for velocities, places in zip(knots.velocities, knots.positions, strict=True):
            begin = float(places[knots.first] - (np.min(places) + np.max(places)) / 2)
            along = knots._replace(velocities=velocities)
            paths.append(along.path(float(self._begin) - self.lead, begin))
        return paths


@final
class TimedFrames(AbstractModule, Sequence[TimedFrame]):
    """Frames along one axis, between which a stage goes as its limits allow.

    Attributes:
        frames: The frames.
        is_sine: Whether the stage follows a sine through them, and all move: they are at equal
            times, about its turning points.
        lead: Time for which the way goes on before the first light and after the last, for rows
            that are exposed earlier and later; s.
    """

    frames: tuple[TimedFrame, ...]
    is_sine: bool = eqx.field(static=True, default=False)
    lead: float = eqx.field(static=True, default=0.0)

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[TimedFrame]:
        return iter(self.frames)

    @overload
    def __getitem__(self, index: int) -> TimedFrame: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[TimedFrame, ...]: ...
    def __getitem__(self, index: int | slice) -> TimedFrame | tuple[TimedFrame, ...]:
        return self.frames[index]

    @cached_property
    def _numbers(self) -> Numbers:
        """Times, places and half exposures: of NumPy in double precision where all are known."""
        rows = [(x.time, x.position, x.motion.half_exposure) for x in self.frames]
        if all_concrete(rows):
            return np.array(rows, np.float64).reshape(-1, 3).T
        dtype = common_dtype(rows)
        return jnp.array([[jnp.asarray(x, dtype) for x in row] for row in rows]).T

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.frames)

    @property
    def times(self) -> Numbers:
        """Mid-exposures, from the middle of all; s."""
        return self._numbers[0]

    @property
    def exposures(self) -> Numbers:
        """Exposures; s."""
        return 2 * self._numbers[2]

    @property
    def num_axes(self) -> int:
        """Axes of its places."""
        return 1

    @property
    def num_moved(self) -> int:
        """Axes of the stage that known frames need; 0 at rest."""
        return 0 if all(self.rests) else 1

    @property
    def rests(self) -> list[bool]:
        """Whether the sensor stands still in each known frame."""
        return [frame.is_still for frame in self.frames]

    @property
    def middle(self) -> tuple[Numbers | float, Numbers]:
        """The begin of their clock, and the place then; px.

        Between frames it is on a straight line, whichever way a stage takes there.
        """
        times, places, halves = self._numbers
        space = namespace_of(times, places, halves)
        near = space.clip(0 * times, times - halves, times + halves)
        order, at = space.argsort(near), self.place(near[:, None])[0, :, 0]
        return 0.0, space.interp(0 * near[:1], near[order], at[order])

    def cuts(self, begin: Numbers, end: Numbers, delay: float) -> Numbers:
        """Times at which the acceleration of each jumps; beyond the last that it has, its end."""
        requirement = "be 0 for frames without the path between them"
        require(delay == 0, "Instants.of(delay=...)", requirement, delay)
        times, _, halves = self._numbers
        inner = [[*map(float, x.motion.piece_ends[1:-1])] for x in self.frames]
        ends = np.ones((len(self), max(map(len, inner))), times.dtype)
        for row, each in zip(ends, inner, strict=True):
            row[: len(each)] = each
        return times[:, None] + halves[:, None] * ends

    def place(self, time: Float[Numbers, "n q"]) -> Float[Numbers, "1 n q"]:
        """Places of the sensor at some times of each frame; px.

        Args:
            time: Times on the clock of `times`, a row for each; s.
        """
        times, places, _ = self._numbers
        each = zip(self.frames, time, times, strict=True)
        rows = [frame.motion.position(own - middle) for frame, own, middle in each]
        space = namespace_of(times, *rows)
        return (places[:, None] + space.stack(rows).astype(times.dtype))[None]

    def beside(self, pan: Float[np.ndarray, "axes"]) -> "TimedFrames":
        """The frames as the stage makes them, beside a camera that turns at a velocity, px/s."""
        if not np.any(pan):
            return self
        turned = float(pan[0])
        motions = (x.motion.panned(x.motion.velocity - turned) for x in self.frames)
        each = zip(motions, self.frames, strict=True)
        frames = (TimedFrame(m, x.time, x.position - turned * x.time) for m, x in each)
        return replace(self, frames=tuple(frames))

    @property
    def _at_once(self) -> Knots:
        """The way of a stage of any acceleration from rest to rest."""
        return self._knots(None, None)

    @property
    def gentle_stroke(self) -> float:
        """Travel of a stage of any acceleration, from the first light to the last; px."""
        return float(self._at_once.use.travel)

    def use(self, limits: Limits) -> StageUse:
        """The demands on a stage that runs up to known frames from rest.

        Where no path can be written, since no limit says how the stage reaches a velocity, it does
        so at once.

        Args:
            limits: Those of the stage.
        """
        paths = self.stage_paths(limits)
        return paths[0].use if paths else self._at_once.use

    def stage_paths(self, limits: Limits) -> list[StagePath]:
        r"""The whole path of the stage: rest, run-up, frames, run-out, rest.

        Between frames the stage follows the gentlest `transfer` of a ramp, a coast and a ramp that
        takes no more travel than those at the greatest acceleration. To one that moves it runs up
        from one at rest as late as it can. On a sine it follows that from the first light to the
        last, by a cubic spline.

        Args:
            limits: Those of the stage. Without one of its acceleration or its jerk the acceleration
                is the greatest of the rest of the path.

        Returns:
            The path; none where the stage stays at rest. None also where both limits are missing
            and one is needed: the frames do not say how fast a stage reaches a velocity that it
            keeps, or from one to the next.
        """
        knots, first = self._knots_within(limits), self.frames[0]
        if knots is None:
            return []
        return [knots.path(float(first.time) - first.exposure / 2, _ends(first)[0])]

    def for_rows(
        self, readout: float, limits: Limits, pan: Float[np.ndarray, "axes"] | None = None
    ) -> "TimedFrames":
        """Known frames, on a way that goes on while rows are exposed earlier and later."""
        at_rest = replace(self, lead=0.0)
        if all(self.rests) or not readout:
            return at_rest
        going_on = replace(self, lead=readout / 2)
        stage = going_on if pan is None else going_on.beside(pan)
        travel = float(stage.use(limits).travel)
        fits = limits.have_room_for(travel=travel, stroke=stage.gentle_stroke)
        return going_on if fits else at_rest

    def path_for_rows(
        self, readout: float, limits: Limits, pan: Float[np.ndarray, "axes"] | None = None
    ) -> FramePath:
        """The whole path that rows see which are exposed earlier and later.

        A stage reaches a velocity at once where no limit says how.
        """
        pan = np.zeros(1) if pan is None else pan
        stage = self.for_rows(readout, limits, pan).beside(pan)
        way = stage._knots_within(limits) or stage._at_once
        # Before and after it the stage is at rest, and may reach a velocity at once.
        path = FramePath(
            np.asarray(self.times),
            np.asarray(self.exposures),
            np.r_[readout, 0.0, way.durations, 0.0, readout],
            (np.pad(way.velocities, 2) + pan[0])[None],
            float(np.sum(way.durations[: way.first])) + readout,
            None if way.jerks is None else np.pad(way.jerks, 2),
        )
        light, zero = path.place(np.array([path._begin, 0.0])).T
        since = self.middle[1] - _ends(self.frames[0])[0]
        return replace(path, aside=light + since - zero)

    def _knots_within(self, limits: Limits) -> Knots | None:
        """The way of the stage from rest to rest within some limits, where they say one."""
        most, jerk, top_speed = (
            None if x is None else float(x)
            for x in (limits.max_acceleration, limits.max_jerk, limits.max_top_speed)
        )
        if most is None and jerk is None:
            at_once = self._at_once
            within = slice(at_once.first, at_once.last)
            gains = np.abs(np.diff(at_once.velocities)[within])[at_once.durations[within] == 0]
            jumps = np.any(gains > SINGLE * np.max(np.abs(at_once.velocities)))
            if jumps or (not all(self.rests) and self.rests[0]):
                return None
            most = float(at_once.use.acceleration)
        knots = None if most == 0 else self._knots(most, jerk, top_speed)
        return None if knots is None or not np.any(knots.velocities) else knots

    def _knots(
        self, most: float | None, jerk: float | None, top_speed: float | None = None
    ) -> Knots:
        """The way of the stage from rest to rest at a greatest acceleration, jerk and speed."""
        ends = [_ends(frame) for frame in self.frames]

        def whole(span: tuple[float, float] | None) -> Knots:
            lit = [Knots.of_exposure(frame.motion) for frame in self.frames]
            pieces = lit[0].pieces
            each = zip(self.frames, lit, ends, strict=True)
            for (frame, own, places), (after, other, others) in pairwise(each):
                gap = float(after.time - frame.time) - (after.exposure + frame.exposure) / 2
                way, start, end = others[0] - places[1], own.velocities[-1], other.velocities[0]
                ends_of_gap = float(way), gap, float(start), float(end)
                if gap <= 1e-9 * (after.time - frame.time):  # but for rounding
                    pieces.append(Piece(0.0, end))
                elif not np.any(own.velocities) and (
                    late := from_rest(
                        way, gap, end, run_up(end, float(other.accelerations[0]), most, jerk)
                    )
                ):
                    pieces += late
                else:
                    near = None if span is None else (span[0] - places[1], span[1] - places[1])
                    scale = sum(float(np.ptp(each.positions)) for each in (own, other))
                    pieces += transfer(
                        *ends_of_gap, acceleration=most, top_speed=top_speed, span=near, scale=scale
                    )
                pieces += other.pieces
            rates = float(lit[0].accelerations[0]), float(lit[-1].accelerations[-1])
            way = Knots.of(lit[0].velocities[0], pieces)
            if self.lead:
                way = way.led(self.lead)
                rates = float(way.accelerations[0]), float(way.accelerations[-1])
            return way.from_rest_to_rest(rates, most, jerk)

        if (sine := self._sine) is not None:
            return self._along(sine, most, jerk)
        if len(self) == 1:
            return whole(None)
        if most is None:
            # A stage of any acceleration stays where it is in some frame.
            lit = [extent(Knots.of_exposure(frame.motion)) for frame in self.frames]
            low = min(begin + way[0] for (begin, _), way in zip(ends, lit, strict=True))
            high = max(begin + way[1] for (begin, _), way in zip(ends, lit, strict=True))
            margin = 1e-3 * (high - low)
            return whole((low - margin, high + margin))
        # No wider than by the greatest acceleration, at which the stage turns round soonest.
        steepest = whole((math.inf, -math.inf))
        low, high = extent(steepest)
        begin = ends[0][0] - float(steepest.positions[steepest.first])
        margin = 1e-9 * (high - low)
        return whole((low + begin - margin, high + begin + margin))

    @cached_property
    def _sine(self) -> "_Sine | None":
        """The sine of the first frame, where others are no farther off than stills may move."""
        if not self.is_sine or any(self.rests) or len(self) == 1:
            return None
        times, places, halves = self._numbers
        motion, period = self.frames[0].motion, float(times[-1] - times[0]) / (len(self) - 1)
        sine = _Sine(float(motion.velocity), height_of_sine(motion, period), math.pi / period)
        lit = times[:, None] + halves[:, None] * np.array([-1.0, 0.0, 1.0])
        off = self.place(lit)[0] - places[0] - sine.place(lit - times[0])
        return sine if np.max(abs(off)) < AT_REST else None

    def _along(self, sine: "_Sine", most: float | None, jerk: float | None) -> Knots:
        """The way on a sine through all frames, a cubic spline, from rest to rest."""
        from scipy.interpolate import CubicSpline

        begin, end = -self.frames[0].exposure / 2, self.frames[-1].exposure / 2
        end += float(self.frames[-1].time - self.frames[0].time)
        num_lit = _PIECES_OF_SINE * len(self)
        num_led = math.ceil(self.lead / (end - begin) * num_lit)
        ends = pairwise([begin - self.lead, begin, end, end + self.lead])
        each = zip(ends, (num_led, num_lit, num_led), strict=True)
        times = [np.linspace(*span, count, endpoint=False) for span, count in each]
        times = np.append(np.concatenate(times), end + self.lead)
        clamped = [(1, sine.velocity(time)) for time in (times[0], times[-1])]
        spline = CubicSpline(times, sine.place(times), bc_type=clamped)  # type: ignore[arg-type]
        lit = num_led, num_led + num_lit
        knots = Knots(np.diff(times), spline(times, 1), 6 * spline.c[0], *lit)
        start, stop = spline(times[[0, -1]], 2).tolist()
        return knots.from_rest_to_rest((start, stop), most, jerk)


class _Sine(NamedTuple):
    """The way from a turning point on a sine, beside a constant velocity."""

    pan: float  # That velocity; px/s
    height: float  # Half of the way between its turning points; px
    turn: float  # Its phase in a second

    def place(self, time: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Places, px, some times after the turning point, s."""
        return self.pan * time + self.height * (1 - np.cos(self.turn * time))

    def velocity(self, time: float) -> float:
        """The velocity, px/s, a time after the turning point, s."""
        return self.pan + self.height * self.turn * math.sin(self.turn * time)


PlaneFrames = FramePath
"""The public name of a path in the plane."""
Frames = Sequence[TimedFrame] | FramePath
"""Exposures of an open shutter, along one axis or in the plane."""


def frames_in(frames: Frames, *, is_sine: bool = False) -> TimedFrames | FramePath:
    """Exposures as a whole, of which all else is asked."""
    is_whole = isinstance(frames, TimedFrames | FramePath)
    return frames if is_whole else TimedFrames(tuple(frames), is_sine)


def _sizes(vectors: Numbers, limits: Limits) -> Numbers:
    """Sizes of vectors by which they keep limits; components lie along the first axis."""
    return largest_of(abs(vectors).T) if limits.axes == "each" else length_of(vectors)


def _ends(frame: TimedFrame) -> tuple[float, float]:
    """Places of the stage at the ends of a frame; px."""
    motion, place = frame.motion, float(frame.position)
    end = np.asarray(motion.position(np.array([float(motion.half_exposure)])))
    return place + place_at_begin(motion), place + float(end[0])


def from_rest(way: float, gap: float, end: float, ups: list[Piece]) -> list[Piece] | None:
    """From a frame at rest, as late as a run-up or a constant acceleration lets the stage start."""
    if not way and not end:
        return [Piece(gap, 0.0)]
    knots = Knots.of(0.0, ups)
    duration, place = float(np.sum(knots.durations)), float(knots.positions[-1])
    # Numbers of frames may be those of single precision.
    if abs(place - way) <= SINGLE * abs(way) and duration <= gap * (1 + SINGLE):
        return [Piece(max(gap - duration, 0.0), 0.0), *ups]
    rise = 2 * way / end if end else 0.0
    if rise > 0 and duration <= rise <= gap:
        return [Piece(gap - rise, 0.0), Piece(rise, end)]
    return None


def height_of_sine(motion: AbstractMotion, period: float) -> float:
    r"""The number $A$ of the sine on which a frame is, about a turning point at mid-exposure; px.

    The way from there is $vt + A\,(1 - \cos(\pi t/P))$. The pieces of the frame meet on it.

    Args:
        motion: Motion of the frame, whose velocity at mid-exposure is $v$.
        period: Time to the next frame, which turns the other way, $P$; s.
    """
    half = float(motion.half_exposure)
    bend = place_at_begin(motion) + float(motion.velocity) * half
    return bend / (1 - math.cos(math.pi * half / period))
