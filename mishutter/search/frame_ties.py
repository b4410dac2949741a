r"""Frames tied to a few numbers: ways of a sensor that have a name.

Along an axis a sensor pans at one velocity, sweeps once over the burst, swings on alternating
parabolas or on a sine, takes another constant velocity in each frame, or follows things and flies
back between frames. The power that passes at a frequency follows the time that the sensor spends at
each velocity: in the plane the best ways fill the law of velocities evenly. Two sines of different
frequency, one an axis,

$$\dot{\mathbf x} = \bigl(-V_x\sin(\omega - \delta)t,\; V_y\cos(\omega + \delta)t\bigr),$$

fill an ellipse as their phase runs; without the difference $\delta$ they are a circle. Parabolas
that alternate between two axes fill a cross, and constant velocities, one a frame, a ring.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter.model.frame_path import SINE
from mishutter.search.frame_levels import Frames, Shape
from mishutter.search.frame_limits import Room

PAN, SWEEP, ALTERNATING, FAN, FOLLOW, SWINGS, FREE = (
    "pan",
    "sweep",
    "alternating parabolas",
    "fan of pans",
    "pans with flights back",
    "swings in each frame",
    "free path",
)
"""Ways along an axis, the simplest first, and two of each frame's own."""
STILLS, BRACKETED, CIRCLE, TWO_SINES, CROSSED, RING = (
    "stills",
    "stills of two exposures",
    "circle",
    "two sines",
    "crossed parabolas",
    "ring of velocities",
)
"""Frames at rest, and ways along two axes."""
WAYS, WAYS_ON_TWO_AXES = (PAN, SWEEP, ALTERNATING, FAN, FOLLOW), (CIRCLE, TWO_SINES, CROSSED, RING)
SIMPLEST_FIRST = (
    *(STILLS, BRACKETED, PAN, SWEEP, SINE, ALTERNATING, FAN, FOLLOW, SWINGS),
    *(*WAYS_ON_TWO_AXES, FREE),
)
"""All ways of frames, the simplest first."""
_OF_ONE_FRAME = STILLS, PAN, ALTERNATING, CIRCLE, TWO_SINES
AS_GOOD = 0.05
"""Decibels below the best at which a simpler way is preferred, and that a free path must gain."""
MOST = 64
"""Most frames of a search: each has a transfer function of its own."""
MOST_FREE = 24
"""Frames up to which each has numbers of its own."""
_FASTEST = 1.5
"""Top speed of a way that may pay, over that of the fastest thing."""
_DUTY_OF_CROSS = 2 / 3
"""Duty at which the gaps between crossed parabolas take no more acceleration than these."""

Numbers = Float[np.ndarray, "z"]


class Tie(NamedTuple):
    """Frames at equal times on a way of few numbers, along one direction or about it.

    The numbers are from 0 to 1: exposure, wait, velocity about which the way is, how much it
    changes, and of two sines the turns and the difference of their phases.
    """

    kind: str
    room: Room
    shape: Shape
    slowest: float  # Least component of things along the direction; px/s
    fastest: float  # Greatest; px/s
    unit: Float[np.ndarray, "axes"]  # The direction
    across: Float[np.ndarray, "axes"]  # Velocity of all frames across it; px/s
    max_jerk: float = math.inf  # Greatest jerk of a sine; px/s^3
    widest: float = 0.0  # Greatest component of things across the direction; px/s

    @property
    def exists(self) -> bool:
        """Whether there are such frames of this number."""
        return self.shape.number > 1 or self.kind in _OF_ONE_FRAME

    @property
    def starts(self) -> list[Numbers]:
        """Numbers that a search begins with, the likeliest first."""
        low, high = self._means
        at = ((self.slowest + self.fastest) / 2 - low) / (high - low) if high > low else 0.5
        if self.kind in (STILLS, BRACKETED):
            return [np.array([x, 0.0, at, 0.5]) for x in (0.5, 0.75)]
        if self.kind in (PAN, FOLLOW):
            spread = 0.1 if self.kind == FOLLOW and self.shape.number > MOST_FREE else 0.0
            return [np.array([x, 0.0, at, spread]) for x in (0.6, 0.9)]
        if self.kind in (CIRCLE, TWO_SINES):
            drift = [0.15] if self.kind == TWO_SINES else []
            return [np.array([1.0, 0.0, at, 0.48, turns, *drift]) for turns in (0.5, 0.25, 0.75)]
        return [np.array([x, 0.0, at, y]) for x, y in ((0.98, 0.5), (0.9, 0.25))]

    @property
    def _means(self) -> tuple[float, float]:
        """Velocities about which a way may be; px/s."""
        low, high = min(self.slowest, 0.0), max(self.fastest, 0.0)
        return low - 0.05 * (high - low), high + 0.05 * (high - low)

    @property
    def _most(self) -> float:
        """Greatest change of the velocity that may pay, to either side; px/s."""
        # Things that all move one way differ by less than they move.
        one_way = self.slowest * self.fastest > 0
        spread = self.fastest - self.slowest
        return _FASTEST * (spread if one_way else max(abs(self.slowest), abs(self.fastest)))

    def frames(self, z: Numbers) -> Frames:
        """The frames of some numbers."""
        count, pieces, axes = self.shape
        exposure, period = self._times(z)
        if self.kind in (STILLS, BRACKETED):
            return self._at_rest(exposure, float(z[3]))
        share = np.linspace(-0.5, 0.5, pieces + 1)
        clock = (np.arange(count)[:, None] - (count - 1) / 2) * period + exposure * share
        low, high = self._means
        mean = (low + (high - low) * z[2]) * self.unit + self.across
        if self.kind in WAYS_ON_TWO_AXES:
            beside = self._on_two_axes(z, clock, share)
        else:
            beside = self._on_axis(z, clock, share, period)[..., None] * self.unit
        velocity = mean + beside
        pan = mean if self.room.turns else np.zeros(axes)
        gap = period - exposure if period - exposure > 1e-9 * period else 0.0
        frames = Frames(
            np.full(count, exposure), velocity, np.full(count - 1, gap), 0 * velocity[:, 0], pan
        )
        return frames._replace(place=self._places(frames))

    def _times(self, z: Numbers) -> tuple[float, float]:
        """The exposure of each frame and the time from one to the next; s."""
        times, count = self.room.times, self.shape.number
        shortest, longest = times.shortest, times.longest_of(count)
        if self.kind == CROSSED:
            longest = min(longest, _DUTY_OF_CROSS * times.period_of(longest))
        exposure = float(shortest * (max(longest, shortest) / shortest) ** z[0])
        period = times.period_of(exposure)
        if self.kind == CROSSED:
            period = max(period, exposure / _DUTY_OF_CROSS)
        if count > 1:
            most = max((times.window - exposure) / (count - 1), period)
            period = float(period * (most / period) ** z[1])
        return exposure, period

    def _on_axis(
        self, z: Numbers, clock: np.ndarray, share: np.ndarray, period: float
    ) -> Float[np.ndarray, "n ends"]:
        """Velocities beside the mean along the direction; px/s."""
        number, top = np.arange(self.shape.number)[:, None], self._most * z[3]
        if self.kind == SWEEP:
            return top * clock / np.max(np.abs(clock))
        if self.kind == ALTERNATING:
            return top * (-1.0) ** number * 2 * share
        # Up to so many frames follow things alike, and the free search spreads them.
        if self.kind == FAN or (self.kind == FOLLOW and number.size > MOST_FREE):
            return top * np.linspace(-1, 1, number.size)[:, None] + 0 * share
        if self.kind == SINE:
            turn, within = np.pi / period, np.ptp(clock[0]) * share
            top = min(top, self.max_jerk / turn**2)
            return top * (-1.0) ** number * np.sin(turn * within)
        return 0 * clock

    def _on_two_axes(
        self, z: Numbers, clock: np.ndarray, share: np.ndarray
    ) -> Float[np.ndarray, "n ends 2"]:
        """Velocities beside the mean, along the direction and across it; px/s."""
        count = self.shape.number
        each = np.zeros((*clock.shape, 2))
        if self.kind == RING:
            angle = 2 * np.pi * (np.arange(count) + 0.5) / count
            each += np.stack([np.cos(angle), np.sin(angle)], axis=-1)[:, None]
        elif self.kind == CROSSED:
            for k in range(count):
                each[k, :, k % 2] = 2 * share * (-1.0) ** (k // 2)
        else:
            fewest, most = 0.3, max(2.0, float(count))
            turns = fewest * (most / fewest) ** z[4]
            drift = 2.0 * z[5] if self.kind == TWO_SINES else 0.0  # turns by which the phase runs
            phase = 2 * np.pi * clock / np.ptp(clock)
            first, second = ((turns + sign * drift / 2) * phase for sign in (-1, 1))
            each = np.stack([-np.sin(first), np.cos(second)], axis=-1)
        half = np.array([(self.fastest - self.slowest) / 2, self.widest])
        along = np.stack([self.unit, [-self.unit[1], self.unit[0]]])
        return (_FASTEST * z[3] * half * each) @ along

    def _places(self, frames: Frames) -> Float[np.ndarray, "n axes"]:
        """Places of the stage at the begin of each frame, about the middle of the stroke; px."""
        knots = (frames if self.kind == FOLLOW else frames.in_line()).knots
        ends = np.max(knots, axis=(0, 1)) + np.min(knots, axis=(0, 1))
        return knots[:, 0] + (self.room.stroke - ends) / 2

    def _at_rest(self, exposure: float, share: float) -> Frames:
        """Frames at rest; of two exposures the first is up to as long as there is time for."""
        (count, pieces, axes), times = self.shape, self.room.times
        lengths = np.full(count, exposure)
        if self.kind == BRACKETED:
            left = times.window - (count - 1) * times.period_of(exposure) - times.dead_time
            longest = max(min(times.longest, left), exposure)
            lengths[0] = exposure * (longest / exposure) ** share
        gap = np.array([times.period_of(length) - length for length in lengths[1:]])
        rest = np.zeros((count, pieces + 1, axes))
        middle = np.full((count, axes), self.room.stroke / 2)
        return Frames(lengths, rest, gap, middle, np.zeros(axes))
