r"""What a stage allows between frames and in them, as smooth inequalities.

From the velocity $w$ at the end of a frame to $u$ at the begin of the next, after the gap $g$, a
stage of the acceleration $A$ and the top speed $V$ reaches every way between a least and a
greatest. The greatest is a ramp up to the velocity $q$ and one down,

$$D_+ = \frac{2q^2 - w^2 - u^2}{2A},\qquad q = \frac{Ag + w + u}2,$$

and where $q > V$ a ramp, a coast at $V$ and a ramp; the least is that of $-w, -u$, mirrored. All ways
between are a ramp to some velocity, a coast and a ramp (`mishutter.model.stages.transfer`). Such a
way turns round only where it stops: past the end of a frame by $w^2/2A$ if it then goes back, and
before the begin of the next by $u^2/2A$ if it comes from beyond.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter.evaluation.bursts import FrameTimes
from mishutter.model.limits import Limits
from mishutter.search.frame_levels import Frames

_MARGIN = 1e-5
"""Share by which limits are kept, as a solver keeps constraints to some digits only."""
_AT_ONCE = 1e4
"""Acceleration, in top speeds over the least time between frames, that stands for any."""
_LEAST_GAP = 1e-3
"""Time between frames of numbers of their own, in periods: no way is to be driven in less."""
_DIRECTIONS = 8
"""Directions along which two axes keep a limit together."""


class Room(NamedTuple):
    """The room that a stage and a camera leave for frames, along each axis of the stage."""

    times: FrameTimes  # When frames may be exposed
    acceleration: float  # px/s^2
    is_limited: bool  # Whether the acceleration is, or stands for any
    top_speed: float  # px/s
    stroke: float  # From the first light to the last; px
    travel: float  # From rest to rest; px, infinite for any
    max_pan: float  # Mean velocity of a stage over the frames, or of the camera; px/s
    turns: bool  # Whether the camera turns to pan
    together: bool  # Whether two axes keep limits together
    speed: float  # Scale of velocities; px/s
    least_exposure: float  # s

    @staticmethod
    def of(limits: Limits, times: FrameTimes, fastest: float) -> "Room":
        """The room that limits leave; `fastest` is the speed of the fastest thing, px/s."""
        keep = 1 - _MARGIN
        top = keep * float(limits.max_top_speed)
        most, travel = limits.max_acceleration, limits.max_travel
        any_rate = _AT_ONCE * top / min(times.period, times.window)
        return Room(
            times,
            any_rate if most is None else keep * float(most),
            most is not None,
            top,
            keep * float(limits.max_stroke),
            np.inf if travel is None else keep * float(travel),
            min(float(limits.max_pan), top),
            limits.pans == "camera",
            limits.axes == "disc",
            max(fastest, 1e-3 * min(top, 1.0)),
            times.shortest,
        )

    def split(
        self, x: Float[np.ndarray, "*b v"], count: int, pieces: int, axes: int
    ) -> tuple[Frames, np.ndarray]:
        """Frames, and the lower end of the travel, from numbers of the order of 1."""
        sizes = np.cumsum([count, count * (pieces + 1) * axes, count - 1, count * axes, axes])
        exposure, velocity, gap, place, pan, low = np.split(x, sizes, axis=-1)
        lead, period = x.shape[:-1], self.times.period
        frames = Frames(
            exposure * period,
            velocity.reshape(*lead, count, pieces + 1, axes) * self.speed,
            gap * period,
            place.reshape(*lead, count, axes) * self.stroke,
            pan * self.speed,
        )
        return frames, low * self.stroke

    def joined(self, frames: Frames) -> Float[np.ndarray, "v"]:
        """The numbers of frames, whose travel is about its middle."""
        period, axes = self.times.period, frames.pan.size
        low = (
            (self.stroke - min(self.travel, 1e9 * self.stroke)) / 2
            if np.isfinite(self.travel)
            else 0.0
        )
        parts = (
            frames.exposure / period,
            frames.velocity.ravel() / self.speed,
            frames.gap / period,
            frames.place.ravel() / self.stroke,
            frames.pan / self.speed,
            np.full(axes, low / self.stroke),
        )
        return np.concatenate(parts)

    def bounds(self, count: int, pieces: int, axes: int) -> Float[np.ndarray, "v 2"]:
        """Least and greatest value of each number."""
        period, times = self.times.period, self.times
        top = self.top_speed / self.speed
        pan = self.max_pan / self.speed if self.turns else 0.0
        far = self.travel / self.stroke if np.isfinite(self.travel) else 0.0
        longest = min(times.longest, times.window) if count > 1 else times.longest
        rows = [
            (count, times.shortest / period, max(longest, times.shortest) / period),
            (count * (pieces + 1) * axes, -top, top),
            (count - 1, max(times.dead_time / period, _LEAST_GAP), max(times.window / period, 1.0)),
            (count * axes, 0.0, 1.0),
            (axes, -pan, pan),
            (axes, min(1 - far, 0.0) if far else 0.0, max(1 - far, 0.0) if far else 0.0),
        ]
        if far:
            rows[-1] = (axes, -far, 1.0)
        return np.concatenate([np.tile([[low, high]], (n, 1)) for n, low, high in rows])

    def reach(self, w, u, gap, share: float = 1.0):
        """Least and greatest way from one velocity to another in a time."""
        A, V = share * self.acceleration, share * self.top_speed

        def most(w, u):
            q = (A * gap + u + w) / 2
            squares = u * u + w * w
            coasting = 2 * V * V - squares + 2 * V * (A * gap - (2 * V - u - w))
            return np.where(q <= V, 2 * q * q - squares, coasting) / (2 * A)

        return -most(-w, -u), most(w, u)

    def slack(
        self, x: Float[np.ndarray, "*b v"], count: int, pieces: int, axes: int
    ) -> Float[np.ndarray, "*b c"]:
        """Numbers of the order of 1 that are at least 0 within the limits."""
        frames, low = self.split(x, count, pieces, axes)
        T, v, g, y, pan = frames
        A, V, S, s0, P = (
            self.acceleration,
            self.top_speed,
            self.stroke,
            self.speed,
            self.times.period,
        )
        stage = v - pan[..., None, None, :]
        step = (T / pieces)[..., None, None]
        first, last = stage[..., :-1, :], stage[..., 1:, :]
        gain = last - first
        ways = np.cumsum(step * (first + last) / 2, axis=-2)
        knots = y[..., None, :] + np.concatenate([0 * ways[..., :1, :], ways], axis=-2)
        steep = np.where(np.abs(gain) > 1e-9 * s0, gain, 1e-9 * s0)
        turns = knots[..., :-1, :] - np.where(
            first * last < 0, first * first * step / (2 * steep), 0.0
        )
        end, lead = knots[..., -1, :], x.shape[:-1]
        # Along each axis, or along several directions where two axes keep limits together.
        unit, share = np.eye(axes), 1.0
        if self.together and axes == 2:
            angle = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
            unit, share = np.stack([np.cos(angle), np.sin(angle)]), np.cos(angle[1] / 2)
        every: list = []

        def add(z, size: int) -> None:
            every.append(z.reshape(*lead, -1) if size else z)

        def inside(place, low, span) -> None:
            """Places lie from `low` to `low + span`, or in the disc of that diameter."""
            about = (place - low - span / 2) @ unit
            for sign in (1, -1):
                add((share * span / 2 + sign * about) / S, 1)

        for sign in (1, -1):
            add((share * A * step + sign * gain @ unit) / s0, 1)
        if self.together and axes == 2:
            for sign in (1, -1):
                add((share * V + sign * v @ unit) / s0, 1)
        if self.turns:
            size = np.linalg.norm(pan, axis=-1) if axes > 1 else np.abs(pan[..., 0])
            for sign in (1, -1):
                add((V - size[..., None, None, None] + sign * stage) / s0, 1)
        elif self.max_pan < V:
            mean = np.mean((first + last) / 2, axis=(-3, -2))
            for sign in (1, -1):
                add((self.max_pan + sign * mean) / s0, 1)
        boxes = []
        if self.stroke < self.travel:
            boxes.append((0.0 * low, S, False))
        if np.isfinite(self.travel):
            boxes.append((low, self.travel, True))
        for begin, span, _ in boxes:
            shown = begin[..., None, None, :]
            inside(knots, shown, span)
            inside(turns, shown, span)
        if np.isfinite(self.travel) and self.is_limited:
            u, w = stage[..., 0, 0, :], stage[..., -1, -1, :]
            # Both axes run up for as long as the faster one needs.
            size = np.linalg.norm if self.together else np.max
            before, after = (size(np.abs(z), axis=-1, keepdims=True) / (2 * A) for z in (u, w))
            inside(y[..., 0, :] - u * before, low, self.travel)
            inside(end[..., -1, :] + w * after, low, self.travel)
        if count > 1:
            part = np.sqrt(0.5) if self.together and axes == 2 else 1.0
            a, w, u, gap = part * A, stage[..., :-1, -1, :], stage[..., 1:, 0, :], g[..., None]
            way, leave, meet = y[..., 1:, :] - end[..., :-1, :], end[..., :-1, :], y[..., 1:, :]
            least, most = self.reach(w, u, gap, part)
            for z in (
                (a * gap - u + w) / s0,
                (a * gap + u - w) / s0,
                (most - way) / S,
                (way - least) / S,
            ):
                add(z, 1)
            # The stage goes on ahead where it may coast at no less than 0, and back likewise.
            rest = way - (w * np.abs(w) + u * np.abs(u)) / (2 * a)
            ahead = np.maximum((w + u - a * gap) * gap, rest) / S
            back = np.maximum(-(w + u + a * gap) * gap, -rest) / S
            for begin, span, rests in boxes:
                base = begin[..., None, :]
                for place, speed, spared in (
                    (leave, w, (ahead, back)),
                    (meet, -u, (back, ahead)),
                ):
                    stop = np.maximum(speed, 0.0) ** 2 / (2 * a)
                    room = (base + span - place - stop) / S
                    add(room if rests else np.maximum(room, spared[0]), 1)
                    stop = np.minimum(speed, 0.0) ** 2 / (2 * a)
                    room = (place - base - stop) / S
                    add(room if rests else np.maximum(room, spared[1]), 1)
            add((g + T[..., 1:]) / P - 1, 1)
            whole = np.sum(T, axis=-1) + np.sum(g, axis=-1)
            add((self.times.window - whole)[..., None] / P, 1)
        return np.concatenate(every, axis=-1)
