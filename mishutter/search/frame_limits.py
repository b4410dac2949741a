r"""A stage allows frames, and ways between them, within smooth inequalities.

From the velocity $w$ at the end of a frame to $u$ at the begin of the next, after the gap $g$, a
stage of the acceleration $A$ and the top speed $V$ reaches every way between a least and a
greatest. The greatest is a ramp up to the velocity $q$ and one down,

$$D_+ = \frac{2q^2 - w^2 - u^2}{2A},\qquad q = \frac{Ag + w + u}2,$$

and where $q > V$ a ramp, a coast at $V$ and a ramp; the least is that of $-w, -u$, mirrored. All
ways between are a ramp to some velocity, a coast and a ramp (`mishutter.model.stages.transfer`).
Such a way turns round only where it stops: past the end of a frame by $w^2/2A$ if it then goes
back, and before the begin of the next by $u^2/2A$ if it comes from beyond.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter.evaluation.bursts import FrameTimes
from mishutter.model.limits import Limits
from mishutter.search.frame_levels import Frames, Shape

_MARGIN, _MARGIN_AT_ONCE = 1e-5, 2e-3
"""Shares by which limits are kept, as a solver keeps constraints to some digits only: and by which
a stage of any acceleration keeps its stroke, as it turns round beyond frames."""
_AT_ONCE = 1e4
"""Acceleration, in top speeds over the least time between frames, that stands for any."""
LEAST_GAP = 1e-3
"""Time between frames of numbers of their own, in periods: no way is to be driven in less."""
_DIRECTIONS = 8
"""Directions along which two axes keep a limit together."""
_TINY = 1e-9
"""Change of a velocity, over that of the fastest thing, by which nothing turns round."""

Slack = list[np.ndarray]


class Room(NamedTuple):
    """The room that a stage and a camera leave for frames, along each axis of the stage."""

    times: FrameTimes  # When frames may be exposed
    acceleration: float  # px/s^2
    runs_up: bool  # Whether the acceleration is limited, or a stage has any velocity at once
    top_speed: float  # px/s
    stroke: float  # From the first light to the last; px
    travel: float  # From rest to rest; px, infinite for any
    max_pan: float  # Mean velocity of a stage over the frames, or of the camera; px/s
    turns: bool  # Whether the camera turns to pan
    together: bool  # Whether two axes keep limits together
    speed: float  # Scale of velocities; px/s

    @staticmethod
    def of(limits: Limits, times: FrameTimes, fastest: float) -> "Room":
        """The room that limits leave; `fastest` is the speed of the fastest thing, px/s."""
        keep = 1 - _MARGIN
        top = keep * float(limits.max_top_speed)
        most, travel = limits.max_acceleration, limits.max_travel
        at_once = _AT_ONCE * top / min(times.period, times.window)
        return Room(
            times,
            at_once if most is None else keep * float(most),
            most is not None,
            top,
            (keep if most is not None else 1 - _MARGIN_AT_ONCE) * float(limits.max_stroke),
            np.inf if travel is None else keep * float(travel),
            min(float(limits.max_pan), top),
            limits.pans == "camera",
            limits.axes == "disc",
            max(fastest, 1e-3 * min(top, 1.0)),
        )

    @property
    def length(self) -> float:
        """Scale of places; px."""
        return min(self.stroke, self.travel)

    def split(
        self, x: Float[np.ndarray, "*b v"], shape: Shape
    ) -> tuple[Frames, Float[np.ndarray, "*b axes"]]:
        """Frames, and the lower end of the travel, px, from numbers of the order of 1."""
        count, pieces, axes = shape
        sizes = np.cumsum([count, count * (pieces + 1) * axes, count - 1, count * axes, axes])
        exposure, velocity, gap, place, pan, low = np.split(x, sizes, axis=-1)
        lead, period = x.shape[:-1], self.times.period
        frames = Frames(
            exposure * period,
            velocity.reshape(*lead, count, pieces + 1, axes) * self.speed,
            gap * period,
            place.reshape(*lead, count, axes) * self.length,
            pan * self.speed,
        )
        return frames, low * self.length

    def joined(self, frames: Frames) -> Float[np.ndarray, "v"]:
        """The numbers of frames, whose travel is about the middle of the stroke."""
        period = self.times.period
        low = (self.stroke - self.travel) / 2 if np.isfinite(self.travel) else 0.0
        parts = (
            frames.exposure / period,
            frames.velocity.ravel() / self.speed,
            frames.gap / period,
            frames.place.ravel() / self.length,
            frames.pan / self.speed,
            np.full(frames.pan.size, low / self.length),
        )
        return np.concatenate(parts)

    def bounds(self, shape: Shape) -> Float[np.ndarray, "v 2"]:
        """Least and greatest value of each number."""
        (count, pieces, axes), times, period = shape, self.times, self.times.period
        top, pan = self.top_speed / self.speed, self.max_pan / self.speed if self.turns else 0.0
        longest = min(times.longest, times.window) if count > 1 else times.longest
        most = self.stroke / self.length
        far = (-self.travel / self.length, most) if np.isfinite(self.travel) else (0.0, 0.0)
        rows = [
            (count, times.shortest / period, max(longest, times.shortest) / period),
            (count * (pieces + 1) * axes, -top, top),
            (count - 1, max(times.dead_time / period, LEAST_GAP), max(times.window / period, 1.0)),
            (count * axes, 0.0, most),
            (axes, -pan, pan),
            (axes, *far),
        ]
        return np.concatenate([np.tile([[low, high]], (n, 1)) for n, low, high in rows])

    def reach(
        self,
        leave: Float[np.ndarray, "*b"],
        meet: Float[np.ndarray, "*b"],
        gap: Float[np.ndarray, "*#b"],
        share: float = 1.0,
    ) -> tuple[Float[np.ndarray, "*b"], Float[np.ndarray, "*b"]]:
        """Least and greatest way, px, from one velocity to another, px/s, in a time, s.

        They are those at a share of the greatest acceleration and of the top speed.
        """
        rate, top = share * self.acceleration, share * self.top_speed

        def most(w: np.ndarray, u: np.ndarray) -> np.ndarray:
            peak, squares = (rate * gap + u + w) / 2, u * u + w * w
            coasting = 2 * top * top - squares + 2 * top * (rate * gap - (2 * top - u - w))
            return np.where(peak <= top, 2 * peak * peak - squares, coasting) / (2 * rate)

        return -most(-leave, -meet), most(leave, meet)

    def slack(self, x: Float[np.ndarray, "*b v"], shape: Shape) -> Float[np.ndarray, "*b c"]:
        """Numbers of the order of 1 that are at least 0 within the limits."""
        frames, low = self.split(x, shape)
        stage, knots = frames.stage, frames.knots
        every = [*self._speeds(frames, stage), *self._places(frames, stage, knots, low)]
        if shape.number > 1:
            every += [*self._times(frames), *self._between(frames, stage, knots, low)]
        return np.concatenate([each.reshape(*x.shape[:-1], -1) for each in every], axis=-1)

    def _directions(self, axes: int) -> tuple[Float[np.ndarray, "axes d"], float]:
        """Directions along which limits are kept, and the share of a limit along each."""
        if not (self.together and axes == 2):
            return np.eye(axes), 1.0
        angle = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
        return np.stack([np.cos(angle), np.sin(angle)]), float(np.cos(angle[1] / 2))

    def _speeds(self, frames: Frames, stage: np.ndarray) -> Slack:
        """Accelerations and velocities within frames."""
        axes, rate, steps = stage.shape[-1], self.acceleration, frames.steps[..., None]
        unit, share = self._directions(axes)
        gain, every = np.diff(stage, axis=-2) @ unit, []
        for sign in (1, -1):
            every.append((share * rate * steps + sign * gain) / self.speed)
            if unit.shape[1] > axes:
                every.append((share * self.top_speed + sign * frames.velocity @ unit) / self.speed)
            if self.turns:  # the stage moves beside the camera
                turning = np.linalg.norm(frames.pan, axis=-1)[..., None, None, None]
                every.append((self.top_speed - turning + sign * stage) / self.speed)
            elif self.max_pan < self.top_speed:
                mean = np.mean(stage[..., 1:, :] + stage[..., :-1, :], axis=(-3, -2)) / 2
                every.append((self.max_pan + sign * mean) / self.speed)
        return every

    def _boxes(self, low: np.ndarray) -> list[tuple[np.ndarray, float, bool]]:
        """Lower end and length of the stroke and of the travel, and whether it is at rest at last.

        A travel within the stroke holds that too.
        """
        boxes = [(0 * low, self.stroke, False)] if self.stroke < self.travel else []
        return boxes + ([(low, self.travel, True)] if np.isfinite(self.travel) else [])

    def _inside(self, place: np.ndarray, low: np.ndarray, span: float) -> Slack:
        """Places from `low` to `low + span`, or in the disc of that diameter."""
        unit, share = self._directions(place.shape[-1])
        about = (place - low - span / 2) @ unit
        return [(share * span / 2 + sign * about) / self.length for sign in (1, -1)]

    def _places(
        self, frames: Frames, stage: np.ndarray, knots: np.ndarray, low: np.ndarray
    ) -> Slack:
        """Places of the stage within frames, and where it begins and ends at rest."""
        first, last = stage[..., :-1, :], stage[..., 1:, :]
        gain, least = last - first, _TINY * self.speed
        steep = np.where(np.abs(gain) > least, gain, least)
        past = first * first * frames.steps[..., None] / (2 * steep)
        # Where it turns round in a piece.
        turns = knots[..., :-1, :] - np.where(first * last < 0, past, 0.0)
        every: Slack = []
        for begin, span, rests in self._boxes(low):
            for place in (knots, turns):
                every += self._inside(place, begin[..., None, None, :], span)
            if rests and self.runs_up:
                # Both axes run up for as long as the faster one needs.
                size = np.linalg.norm if self.together else np.max
                for place, velocity, sign in (
                    (knots[..., 0, 0, :], stage[..., 0, 0, :], -1),
                    (knots[..., -1, -1, :], stage[..., -1, -1, :], 1),
                ):
                    half = size(np.abs(velocity), axis=-1, keepdims=True) / (2 * self.acceleration)
                    every += self._inside(place + sign * velocity * half, begin, span)
        return every

    def _times(self, frames: Frames) -> Slack:
        """Times between frames, and of all of them."""
        period = self.times.period
        whole = np.sum(frames.exposure, axis=-1) + np.sum(frames.gap, axis=-1)
        steps = frames.gap + frames.exposure[..., 1:]
        return [steps / period - 1, (self.times.window - whole)[..., None] / period]

    def _between(
        self, frames: Frames, stage: np.ndarray, knots: np.ndarray, low: np.ndarray
    ) -> Slack:
        """Ways from frame to frame, and where the stage turns round in between."""
        # Each axis follows a way of its own: two share limits that they keep together.
        share = float(np.sqrt(0.5)) if self.together and stage.shape[-1] == 2 else 1.0
        rate, gap = share * self.acceleration, frames.gap[..., None]
        leave, meet = stage[..., :-1, -1, :], stage[..., 1:, 0, :]
        end, begin = knots[..., :-1, -1, :], knots[..., 1:, 0, :]
        way, (least, most) = begin - end, self.reach(leave, meet, gap, share)
        every = [
            (rate * gap - meet + leave) / self.speed,
            (rate * gap + meet - leave) / self.speed,
            (most - way) / self.length,
            (way - least) / self.length,
        ]
        # Between frames it coasts at no less than 0, or no more, and turns round at one end only.
        rest = way - (leave * np.abs(leave) + meet * np.abs(meet)) / (2 * rate)
        ahead = np.maximum((leave + meet - rate * gap) * gap, rest) / self.length
        back = np.maximum(-(leave + meet + rate * gap) * gap, -rest) / self.length
        for base, span, rests in self._boxes(low):
            floor, roof = base[..., None, :], base[..., None, :] + span
            for place, speed, above, below in (
                (end, leave, ahead, back),
                (begin, -meet, back, ahead),
            ):
                up, down = (np.maximum(x, 0.0) ** 2 / (2 * rate) for x in (speed, -speed))
                for left, spared in (
                    ((roof - place - up) / self.length, above),
                    ((place - down - floor) / self.length, below),
                ):
                    # A stage that comes to rest in the end has room to stop wherever it moves.
                    every.append(left if rests else np.maximum(left, spared))
        return every
