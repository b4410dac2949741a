"""Bursts of a camera at rest: several frames of a picture in place of one exposure, registered.

Levels take registration to be perfect, and to cost nothing. A decoder that registers frames knows
the speed, so that their level is that of `burst_psnr`. Objects that are hidden in some frames do
not count. `with_losses` adds the cost of registration, and of objects that leave the sensor.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core import require, require_known
from mishutter.evaluation.frames import steps_of
from mishutter.evaluation.open_frames import OpenFrames, psnr_of_error
from mishutter.model import (
    Burst,
    FrameSequence,
    Scene,
    StillCamera,
    TimedFrame,
    filling_half_exposure,
)

STILLS = "stills"
_MOST_FRAMES = 1000
"""Most frames of a camera that does not say how many it takes."""
_LEAST_GAIN = 0.005
"""Gain of a second exposure below which frames at rest have one; dB."""
_SATURATED = 1e-3
"""Gain of one more frame below which more frames are of no use; dB."""


class StillBurst(NamedTuple):
    """Registered frames of a camera at rest with an ordinary shutter.

    Attributes:
        num_frames: Number of frames.
        exposure: Exposure of each; s.
        psnr: PSNR of the best linear decoder, which knows the speed, in linear light; dB.
    """

    num_frames: int
    exposure: float
    psnr: float


class FrameTimes(NamedTuple):
    """When a camera may expose frames; all in s.

    Attributes:
        period: From one frame to the next.
        window: Longest time from the first light to the last of several frames.
        shortest: Shortest exposure.
        longest: Longest exposure that limits and a full pixel leave.
        dead_time: Least time from the end of a frame to the next.
        max_frames: Most frames; None for up to 1000.
    """

    period: float
    window: float
    shortest: float
    longest: float
    dead_time: float = 0.0
    max_frames: int | None = None

    @staticmethod
    def of(scene: Scene, burst: Burst) -> "FrameTimes":
        """The times of a camera that takes a burst."""
        period, others = 1 / float(burst.frames_per_s), (float(burst.dead_time), burst.max_frames)
        return FrameTimes(period, _window(scene), *_exposures(scene), *others)

    def longest_of(self, num_frames: int) -> float:
        """Longest exposure of each of some frames: one alone waits for no other."""
        if num_frames == 1:
            return self.longest
        rest = self.window - (num_frames - 1) * self.period
        return min(self.longest, self.period - self.dead_time, rest)

    @property
    def numbers_of_frames(self) -> list[int]:
        """The numbers of frames that there is time for, ascending."""
        most = 1 + int(self.window / self.period)
        several = range(2, 1 + min(most, self.max_frames or _MOST_FRAMES))
        return [1, *(n for n in several if self.longest_of(n) >= self.shortest)]

    @property
    def holds_several(self) -> bool:
        """Whether there is time for more than one frame, which alone nothing registers."""
        return self.numbers_of_frames[-1] > 1

    @property
    def best_numbers(self) -> list[int]:
        """The numbers that may be best: the greatest, and the next if that leaves more time."""
        *fewer, most = self.numbers_of_frames
        return [most, *(n for n in fewer[-1:] if self.longest_of(n) > 1.01 * self.longest_of(most))]


class StillBursts:
    """The bursts of a camera at rest within the window of a scene's burst, by NumPy alone.

    Without a burst the window is as long as the longest exposure.

    Args:
        scene: Speeds, light, noise and limits; concrete.
        at_worst: Whether the level is that at the worst of the speeds, and not of the mean error.
        window: Another window; s.
    """

    def __init__(
        self, scene: Scene, *, at_worst: bool = False, window: float | None = None
    ) -> None:
        self._window = _window(scene) if window is None else window
        self._at_worst = at_worst
        self._shortest, self._longest = _exposures(scene)
        self._frames = OpenFrames.of(scene, self._longest, folds=True)

    def error(self, num_frames: int, exposure: float) -> float:
        """Squared error that is left by some frames of an exposure, s; white = 1."""
        return self._error([(num_frames, exposure)], at_worst=self._at_worst)

    def _error(self, kinds: Sequence[tuple[int, float]], *, at_worst: bool) -> float:
        """The error of numbers of frames of some exposures together."""
        frames = self._frames
        gained: Any = sum(n * frames.gained(frames.at_rest(x), x) for n, x in kinds)
        return frames.error(gained, at_worst=at_worst)

    def sequence(self, kinds: Sequence[StillBurst], times: "FrameTimes") -> FrameSequence:
        """Frames of one exposure or two, one after the other.

        Args:
            kinds: The frames of each exposure.
            times: When they may be exposed.
        """
        every = [
            StillCamera(half_exposure=kind.exposure / 2)
            for kind in kinds
            for _ in range(kind.num_frames)
        ]
        moments = steps_of(len(every)) * times.period
        frames = tuple(TimedFrame(*each) for each in zip(every, moments.tolist(), strict=True))
        worst = psnr_of_error(self._error([kind[:2] for kind in kinds], at_worst=True))
        return FrameSequence(STILLS, frames, 0.0, kinds[0].psnr, worst)

    def best(
        self, frames_per_s: float, *, max_frames: int | None = None, dead_time: float = 0.0
    ) -> StillBurst:
        """The burst of the least error at a frame rate, of any number of frames or at most some.

        Args:
            frames_per_s: The rate.
            max_frames: Most frames; None for any number.
            dead_time: Least time from the end of a frame to the next; s.
        """
        ends = self._window, self._shortest, self._longest
        return self.best_within(FrameTimes(1 / frames_per_s, *ends, dead_time, max_frames))

    def best_within(self, times: FrameTimes) -> StillBurst:
        """The burst of the least error of frames at these times."""
        # One more frame that lasts as long never hurts, but one alone may last longer.
        numbers = sorted({1, *times.best_numbers})
        bursts = [self._of(count, times.longest_of(count)) for count in numbers]
        return max(bursts, key=lambda burst: burst.psnr)

    def best_bracketed(self, times: FrameTimes) -> tuple[list[StillBurst], float]:
        """Frames of two exposures, the longer first, and their level together; dB."""
        from scipy.optimize import minimize

        found, at_worst = [], self._at_worst
        for count in times.best_numbers:
            longest = times.longest_of(count)
            equal = self._of(count, longest)
            ends = math.log(self._shortest), math.log(longest)
            found.append((10 ** (-equal.psnr / 10), (count,), (equal.exposure,)))
            for num_long in _some_numbers(count - 1):
                numbers = num_long, count - num_long

                def left(places: Float[np.ndarray, "2"], first: int, second: int) -> float:
                    pairs = zip((first, second), np.exp(places).tolist(), strict=True)
                    return self._error([*pairs], at_worst=at_worst)

                start = np.clip([ends[1], math.log(equal.exposure)], *ends)
                end: Any = minimize(left, start, numbers, method="Nelder-Mead", bounds=[ends] * 2)
                found.append((float(end.fun), numbers, tuple(np.exp(end.x))))
        error, numbers, exposures = min(found)
        level = psnr_of_error(error)
        pairs = sorted(zip(exposures, numbers, strict=True), reverse=True)
        return [StillBurst(n, float(x), level) for x, n in pairs], level

    def number_that_equals(self, psnr: float, *, most: int) -> int | None:
        """The least number of frames, without a gap between them, that has a level.

        None where none up to some has it: frames that follow each other without a gap come to a
        level at which more of them, as short as that, are of no use.

        Args:
            psnr: The level; dB.
            most: The greatest number.
        """
        before = -math.inf
        for count in range(1, 1 + most):
            level = self._of(count, self._window / count).psnr
            if level >= psnr:
                return count
            if count > 1 and level < before + _SATURATED:
                return None
            before = level
        return None

    def rate_that_equals(self, psnr: float, *, most: float) -> float | None:
        """The least frame rate at which a burst has a level; 1/s.

        None where no rate up to some has it.

        Args:
            psnr: The level; dB.
            most: The greatest rate; 1/s.
        """
        from scipy.optimize import brentq

        count = self.number_that_equals(psnr, most=1 + int(most * self._window))
        if count is None:
            return None
        count = max(count, 2)

        def above(exposure: float) -> float:
            return psnr_of_error(self.error(count, exposure)) - psnr

        # The shortest frames that are enough leave the longest time for the gaps between them.
        exposure, best = self._shortest, self._of(count, self._window / count)
        if best.psnr < psnr:
            return None  # one long exposure has the level, and read noise takes it from two
        if above(exposure) < 0:
            root: Any = brentq(above, exposure, best.exposure)
            exposure = float(root)
        rate = (count - 1) / (self._window - exposure)
        return rate if rate <= most else None

    def _of(self, num_frames: int, longest: float) -> StillBurst:
        """Some frames of the best exposure up to the longest, s."""
        from scipy.optimize import minimize_scalar

        longest = max(min(longest, self._longest), self._shortest)
        ends = math.log(self._shortest), math.log(longest)
        places = [*ends]
        if ends[0] < ends[1]:
            end: Any = minimize_scalar(
                lambda place: self.error(num_frames, math.exp(place)),
                bounds=ends,
                method="bounded",
                options={"xatol": 1e-3},
            )
            places.append(float(end.x))
        error, place = min((self.error(num_frames, math.exp(x)), x) for x in places)
        return StillBurst(num_frames, math.exp(place), psnr_of_error(error))


def _some_numbers(most: int) -> list[int]:
    """Numbers from 1 to a greatest: all of few, and ever fewer of many."""
    return np.unique(np.geomspace(1, most, 12).round().astype(int)).tolist() if most else []


def best_still_burst(scene: Scene) -> FrameSequence | None:
    """The burst of least error of a camera at rest; None without `scene.burst`.

    The frames follow each other at the rate of the burst, with its dead time between them, and all
    of them within its window; no frame fills a pixel. They have one exposure, or two where that
    gains more than two decimals hide.
    """
    require_known("best_still_burst", scene=scene)
    if scene.burst is None:
        return None
    bursts, times = StillBursts(scene), FrameTimes.of(scene, scene.burst)
    equal = bursts.best_within(times)
    kinds, level = bursts.best_bracketed(times)
    if level < equal.psnr + _LEAST_GAIN:
        kinds = [equal]
    return bursts.sequence(kinds, times)


def _window(scene: Scene) -> float:
    """Longest time from the first light of a burst to its last; s."""
    if scene.burst is None or scene.burst.window is None:
        return 2 * float(scene.limits.max_half_exposure)
    return float(scene.burst.window)


def _exposures(scene: Scene) -> tuple[float, float]:
    """Shortest and longest exposure that limits and a full pixel leave one frame; s.

    Raises:
        ValueError: if the shortest fills a pixel.
    """
    limits = scene.limits
    shortest, longest = 2 * float(limits.min_half_exposure), 2 * float(limits.max_half_exposure)
    full_well = scene.sensor.full_well
    if full_well is None:
        return shortest, longest
    filling = 2 * float(filling_half_exposure(full_well, scene.photon_rate))
    requirement = f"not be full within the shortest exposure, {shortest:g} s"
    require(shortest <= filling, "Sensor(full_well=...)", requirement, full_well)
    return shortest, min(longest, filling)
