"""Frames that a camera has time for, and the best that it takes at rest and registers.

Levels take registration to be perfect, and to cost nothing: a decoder that registers frames knows
the speed. What registration costs, and what objects that leave the sensor do, is added by
`mishutter.evaluation.registration.with_losses`.
"""

import math
from collections.abc import Callable, Sequence
from itertools import groupby, product
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import Alike, namespace_of, require, require_known
from mishutter.evaluation.levels import psnr_of_error
from mishutter.evaluation.open_frames import OpenFrames
from mishutter.model.exposures import Exposures, exposures_in_plane
from mishutter.model.frame_path import FramePath, TimedFrame
from mishutter.model.motion import StillCamera
from mishutter.model.scene import Scene
from mishutter.model.sensor import BurstMode, filling_half_exposure

STILLS = "stills"
_MOST_FRAMES = 1000
"""Most frames of a camera that does not say how many it takes."""
_MOST_IN_ALL_ORDERS = 6
"""Most frames that are tried in every order; long ones of more are outside or apart."""


class StillBurst(NamedTuple):
    """Registered frames of a camera at rest with an ordinary shutter."""

    num_frames: int  # Number of frames
    exposure: float  # Exposure of each; s
    psnr: float  # PSNR of the best linear decoder, which knows the speed, in linear light; dB


class FrameTimes(NamedTuple):
    """When a camera may expose frames; all in s.

    A frame ends no sooner than the frame rate allows after the one before, and begins no sooner
    than the dead time after that has ended.
    """

    period: float  # Least time from the end of one frame to that of the next, of the frame rate
    window: float  # Longest time from the first light to the last of several frames
    shortest: float  # Shortest exposure
    longest: float  # Longest exposure that limits and a full pixel leave
    dead_time: float = 0.0  # Least time from the end of a frame to the next
    max_frames: int | None = None  # Most frames; None for up to 1000

    @staticmethod
    def of(scene: Scene, burst: BurstMode) -> "FrameTimes":
        """The times of a camera that takes a burst."""
        shortest, longest = _exposures(scene)
        return FrameTimes(
            period=1 / float(burst.frames_per_s),
            window=window_of(scene),
            shortest=shortest,
            longest=longest,
            dead_time=float(burst.dead_time),
            max_frames=burst.max_frames,
        )

    def period_of(self, exposure: float) -> float:
        """Least time from the end of a frame to that of one of some exposure."""
        return max(self.period, exposure + self.dead_time)

    def least_pauses(self, exposures: Alike) -> Alike:
        """Least time from the end of each of some frames to the begin of the next."""
        return namespace_of(exposures).maximum(self.dead_time, self.period - exposures[1:])

    def longest_of(self, num_frames: int, beside: float = 0.0) -> float:
        """Longest exposure of each of some frames, where others beside them take their time."""
        if num_frames == 1 and not beside:
            return self.longest
        each = (self.window - beside + self.dead_time) / num_frames
        if each < self.period:
            rest = self.window - beside - (num_frames - 1) * self.period
            return min(self.longest, self.period - self.dead_time, rest)
        return min(self.longest, each - self.dead_time)

    def moments(self, exposures: Sequence[float]) -> Float[np.ndarray, "n"]:
        """Mid-exposures of frames that follow each other at once, from the middle of them all."""
        steps = [self.period_of(exposure) for exposure in exposures[1:]]
        return moments_of(exposures, steps)

    @property
    def numbers_of_frames(self) -> list[int]:
        """The numbers of frames that there is time for, ascending."""
        most = 1 + int(self.window / self.period * (1 + 1e-9))  # whatever its rounding
        several = range(2, 1 + min(most, self.max_frames or _MOST_FRAMES))
        return [1, *(n for n in several if self.longest_of(n) >= self.shortest)]

    @property
    def holds_several(self) -> bool:
        """Whether there is time for more than one frame, which alone nothing registers."""
        return self.numbers_of_frames[-1] > 1


def moments_of(exposures: Sequence[float], steps: Sequence[float]) -> Float[np.ndarray, "n"]:
    """Mid-exposures of frames by the times from end to end, from the middle of them all; s."""
    lasting = np.asarray(exposures, np.float64)
    ends = lasting[0] + np.append(0.0, np.cumsum(steps))
    return ends - lasting / 2 - ends[-1] / 2


class StillBursts:
    """The bursts of a camera at rest, by NumPy alone.

    Before a background a frame hides strips beside objects, the wider the further it is from the
    middle, so that the order of long and short frames counts. In the plane the camera may turn at a
    constant velocity, px/s.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        at_worst: bool = False,
        pan: Float[np.ndarray, "2"] | None = None,
    ) -> None:
        self._at_worst = at_worst
        self._shortest, self._longest = _exposures(scene)
        self._pan = np.zeros(2) if pan is None else pan
        self._frames = OpenFrames.of(scene, self._longest, folds=True, pan=self._pan)

    def error(self, num_frames: int, exposure: float, times: "FrameTimes | None" = None) -> float:
        """Squared error that is left by some frames of an exposure, s; white = 1.

        Of frames at no times nothing is hidden.
        """
        if num_frames == 1 and self._frames.one_is_untold:
            return self._frames.error_untold(exposure)
        return self._error([(num_frames, exposure)], times, at_worst=self._at_worst)

    def _error(
        self, kinds: Sequence[tuple[int, float]], times: "FrameTimes | None", *, at_worst: bool
    ) -> float:
        """The error of numbers of frames of some exposures, one after the other."""
        frames, numbers = self._frames, dict.fromkeys((x for _, x in kinds), 0)
        for number, exposure in kinds:
            numbers[exposure] += number
        gained: Any = sum(n * frames.snr(frames.at_rest(x), x) for x, n in numbers.items())
        hidden = 0.0
        if self.hides and times is not None:
            exposures = np.repeat([x for _, x in kinds], [n for n, _ in kinds])
            hidden = frames.error_of_edges(exposures, times.moments(exposures.tolist()))
        return frames.error(gained, at_worst=at_worst, hidden=hidden)

    @property
    def hides(self) -> bool:
        """Whether the order of frames counts, as objects hide other strips in each."""
        return self._frames.strips is not None

    def sequence(self, kinds: Sequence[StillBurst], times: "FrameTimes") -> Exposures:
        """Frames of one exposure or two, one after the other."""
        exposures = [kind.exposure for kind in kinds for _ in range(kind.num_frames)]
        moments = times.moments(exposures)
        if self._frames.in_plane:
            lasting, turning = np.array(exposures), np.tile(self._pan[:, None], 2)
            whole = np.ptp(np.concatenate([moments - lasting / 2, moments + lasting / 2]))
            path = FramePath(moments, lasting, np.array([whole]), turning)
            return exposures_in_plane(self._frames.scene, STILLS, path, kinds[0].psnr)
        frames = tuple(
            TimedFrame(StillCamera(half_exposure=exposure / 2), moment)
            for exposure, moment in zip(exposures, moments.tolist(), strict=True)
        )
        worst = psnr_of_error(self._error([kind[:2] for kind in kinds], times, at_worst=True))
        return Exposures(STILLS, frames, 0.0, kinds[0].psnr, worst)

    def best_within(self, times: FrameTimes, *, of_several: bool = False) -> StillBurst:
        """The burst of the least error of frames at these times."""
        # One more frame that lasts as long never hurts, but fewer may last longer.
        every = times.numbers_of_frames[1 if of_several else 0 :]
        tried: dict[int, StillBurst] = {}

        def level(number: int) -> float:
            count = every[-number]
            if count not in tried:
                tried[count] = self._of(count, times.longest_of(count), times)
            return tried[count].psnr

        _first_best(level, len(every))
        level(len(every))  # one alone waits for no other
        return max(tried.values(), key=lambda burst: burst.psnr)

    def best_sequence(self, times: FrameTimes) -> Exposures:
        """The best frames of one exposure, or of two where that gains more than decimals hide."""
        equal = self.best_within(times, of_several=times.holds_several)
        kinds, level = self.best_bracketed(times)
        return self.sequence([equal] if level < equal.psnr + 0.005 else kinds, times)

    def best_bracketed(self, times: FrameTimes) -> tuple[list[StillBurst], float]:
        """Frames of two exposures in their order, and their level together; dB.

        The longer come first where the order does not count.
        """
        from scipy.optimize import minimize

        found, at_worst = [], self._at_worst
        equal = self.best_within(times, of_several=times.holds_several)
        for count in sorted({times.numbers_of_frames[-1], equal.num_frames}):
            alike = self._of(count, times.longest_of(count), times)
            found.append((10 ** (-alike.psnr / 10), [(count, alike.exposure)]))
            for order in self._orders(count):
                pair = _Pair(times, order)

                def left(place: Float[np.ndarray, "2"], pair: _Pair) -> float:
                    return self._error(pair.at(place), times, at_worst=at_worst)

                # Not all valleys are seen from one place.
                start, bounds = min(pair.starts, key=lambda x: left(x, pair)), [(0, 1)] * 2
                end = minimize(left, start, (pair,), method="Nelder-Mead", bounds=bounds)
                found.append((float(end.fun), pair.at(end.x)))
        error, kinds = min(found)
        level = psnr_of_error(error)
        return [StillBurst(n, float(x), level) for n, x in kinds], level

    def _orders(self, count: int) -> list[tuple[bool, ...]]:
        """Orders of longer and shorter frames: the longer first where the order does not count."""
        first = [(True,) * n + (False,) * (count - n) for n in some_numbers(count - 1)]
        if not self.hides:
            return first
        # One sharp frame does not tell outlines from blur: `restore` lost up to 6 dB by three of 20
        # ms and one of 6 ms, and nothing by two and two; and 0.2 dB where neither is in the middle.
        least = min(2, count - 1)
        near = slice((count - 1) // 2, count // 2 + 1)
        if count <= _MOST_IN_ALL_ORDERS:
            every = [
                order
                for order in product((True, False), repeat=count)
                if 1 <= sum(order) <= count - least and not all(order[near])
            ]
            # Backwards the same strips are hidden.
            return [order for order in every if order >= order[::-1]]
        orders = []
        for long in {min(sum(order), count - least): None for order in first}:
            places = np.arange(count)
            inwards = np.argsort(np.argsort(-np.abs(places - (count - 1) / 2), kind="stable"))
            orders += [inwards < long, places * long % count < long]
        return [tuple(order.tolist()) for order in orders]

    def _of(self, num_frames: int, longest: float, times: "FrameTimes | None" = None) -> StillBurst:
        """Some frames of the best exposure up to the longest, s."""
        from scipy.optimize import minimize_scalar

        longest = max(min(longest, self._longest), self._shortest)
        ends = math.log(self._shortest), math.log(longest)
        places = [*ends]
        if ends[0] < ends[1]:
            end: Any = minimize_scalar(
                lambda place: self.error(num_frames, math.exp(place), times),
                bounds=ends,
                method="bounded",
                options={"xatol": 1e-3},
            )
            places.append(float(end.x))
        error, place = min((self.error(num_frames, math.exp(x), times), x) for x in places)
        return StillBurst(num_frames, math.exp(place), psnr_of_error(error))


class _Pair(NamedTuple):
    """Frames of two exposures."""

    times: FrameTimes  # When frames may be exposed
    order: tuple[bool, ...]  # Which may be longer than all alike could be

    def _longest(self, exposure: float) -> float:
        """Longest exposure of the long ones beside others of some exposure; s."""
        num_long = sum(self.order)
        beside = (len(self.order) - num_long) * self.times.period_of(exposure)
        return max(self.times.longest_of(num_long, beside), exposure)

    def at(self, place: Float[np.ndarray, "2"]) -> list[tuple[int, float]]:
        """Numbers and exposures, s, in order, at shares of those of the others and of the long."""
        most = self.times.longest_of(len(self.order))
        short = _between(self.times.shortest, most, place[0])
        long = _between(short, self._longest(short), place[1])
        exposures = {True: long, False: short}
        return [(len([*run]), exposures[is_long]) for is_long, run in groupby(self.order)]

    @property
    def starts(self) -> list[Float[np.ndarray, "2"]]:
        """Shares to start from, where the long last half as long as they can, and nearly so."""
        return [np.array(x) for x in product(np.linspace(0.0, 1.0, 9), (0.5, 0.98))]


def _between(low: float, high: float, share: float) -> float:
    """A number between two, on a scale of ratios."""
    return low * (high / low) ** float(share)


def _first_best(level: Callable[[int], float], most: int) -> int:
    """A number from 1 to some at which a level is highest, where it then falls."""
    best, step = 1, 1
    top = level(best)
    while best + step <= most and (after := level(best + step)) > top:
        best, step, top = best + step, 2 * step, after
    while step >= 1:
        near = [n for n in (best - step, best + step) if 1 <= n <= most]
        after, number = max(((level(n), n) for n in near), default=(-math.inf, best))
        if after > top:
            top, best = after, number
        else:
            step //= 2
    return best


def some_numbers(most: int, num: int = 12) -> list[int]:
    """Numbers from 1 to a greatest: all of few, and ever fewer of many."""
    return np.unique(np.geomspace(1, most, num).round().astype(int)).tolist() if most else []


def best_still_burst(scene: Scene) -> Exposures | None:
    """The burst of least error of a camera at rest; None without `scene.burst`.

    The frames follow each other at the rate of the burst at most, with its dead time between them,
    and all of them within its window; no frame fills a pixel. They have one exposure, or two where
    that gains more than two decimals hide.
    """
    require_known("best_still_burst", scene=scene)
    if scene.burst is None:
        return None
    return StillBursts(scene).best_sequence(FrameTimes.of(scene, scene.burst))


def window_of(scene: Scene) -> float:
    """Longest time from the first light of a burst to its last; s."""
    if scene.burst is None or scene.burst.window is None:
        return 2 * float(scene.limits.max_half_exposure)
    return float(scene.burst.window)


def _exposures(scene: Scene) -> tuple[float, float]:
    """Shortest and longest exposure that limits and a full pixel leave one frame; s."""
    limits = scene.limits
    shortest, longest = 2 * float(limits.min_half_exposure), 2 * float(limits.max_half_exposure)
    full_well = scene.sensor.full_well
    if full_well is None:
        return shortest, longest
    filling = 2 * float(filling_half_exposure(full_well, scene.photon_rate))
    requirement = f"not be full within the shortest exposure, {shortest:g} s"
    require(shortest <= filling, "Sensor(full_well=...)", requirement, full_well)
    return shortest, min(longest, filling)
