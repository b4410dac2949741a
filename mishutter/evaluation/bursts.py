"""Searches for bursts: several frames of a picture in place of one exposure, registered.

Registration is taken to be perfect, and to cost nothing. A decoder that registers frames knows the
speed, so that their level is that of `burst_psnr`. Objects that are hidden in some frames, or
outside of the picture, do not count.
"""

import math
from functools import reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mishutter._core import outside_trace, require_known
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.frames import (
    Frames,
    alternating_frames,
    burst_psnr,
    seen_by,
    sweep_frames,
)
from mishutter.evaluation.lengths import distinct_speeds
from mishutter.evaluation.needs import larger, sizes
from mishutter.evaluation.power import lost_share, power_on_grid
from mishutter.model import (
    Burst,
    LinearMotion,
    Scene,
    filling_half_exposure,
    frequencies,
    noise_power,
    pixel_response,
    require_whole,
    white_electrons,
)

_STEPS, _NUMBERS_TRIED = 5, 2
"""Steps of exposure and acceleration that a search begins with, and numbers of frames tried."""
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


class StillBursts:
    """The bursts of a camera at rest within the window of a scene's burst, by NumPy alone.

    Without a burst the window is as long as the longest exposure.

    The verdict on every scene names one of them, so that they must not cost a compiled program:
    the response of a frame at rest has a closed form.

    Args:
        scene: Speeds, light, noise and limits; concrete, and without a background.
        at_worst: Whether the level is that at the worst of the speeds, and not of the mean error.
    """

    def __init__(self, scene: Scene, *, at_worst: bool = False) -> None:
        require_whole(scene, "a burst of frames")
        self._scene, self._at_worst = scene, at_worst
        self._window = _window(scene)
        self._shortest, longest = _exposures(scene)
        self._longest = max(longest, self._shortest)
        self._speeds, weights = (x.astype(np.float64) for x in distinct_speeds(scene, folds=True))
        self._weights = weights / weights.sum()
        motion = LinearMotion(half_exposure=self._longest / 2)
        count = sizes(without_tolerances(scene), motion).num_frequencies
        self._frequency, self._power = frequencies(count), power_on_grid(scene, count)
        blur = float(scene.optics.lens_blur)
        self._aperture = np.asarray(pixel_response(self._frequency, blur)) ** 2

    def error(self, num_frames: int, exposure: float) -> float:
        """Squared error that is left by some frames of an exposure, s; white = 1."""
        scene = self._scene
        rate, mean, read = (
            float(x) for x in (scene.photon_rate, scene.picture.mean_level, scene.read_noise)
        )
        electrons = white_electrons(rate, exposure)
        noise = noise_power(1.0, mean, electrons, read) / num_frames
        passed = np.sinc(self._frequency * exposure * self._speeds[:, None]) ** 2 * self._aperture
        lost = lost_share(self._power * electrons**2, passed, 0.0 * passed, noise)
        errors = np.mean(self._power * lost, axis=1)
        return float(np.max(errors) if self._at_worst else self._weights @ errors)

    def best(
        self, frames_per_s: float, *, max_frames: int | None = None, dead_time: float = 0.0
    ) -> StillBurst:
        """The burst of the least error at a frame rate, of any number of frames or at most some.

        Args:
            frames_per_s: The rate.
            max_frames: Most frames; None for any number.
            dead_time: Least time from the end of a frame to the next; s.
        """
        period, bursts = 1 / frames_per_s, []
        most = 1 + int(self._window / period)
        for count in range(1, 1 + min(most, max_frames or most)):
            longest = min(period - dead_time, self._window - (count - 1) * period)
            if count > 1 and longest < self._shortest:
                break
            bursts.append(self._of(count, longest))
        return max(bursts, key=lambda burst: burst.psnr)

    def rate_that_equals(self, psnr: float, *, most: float) -> float | None:
        """The least frame rate at which a burst has a level; 1/s.

        None where no rate up to some has it: frames that follow each other without a gap come to a
        level at which more of them, as short as that, are of no use.

        Args:
            psnr: The level; dB.
            most: The greatest rate; 1/s.
        """
        from scipy.optimize import brentq

        before = -math.inf
        for count in range(2, 2 + int(most * self._window)):
            burst = self._of(count, self._window / count)
            if burst.psnr >= psnr:
                break
            if burst.psnr < before + _SATURATED:
                return None
            before = burst.psnr
        else:
            return None

        def above(exposure: float) -> float:
            return _psnr(self.error(count, exposure)) - psnr

        # The shortest frames that are enough leave the longest time for the gaps between them.
        exposure = self._shortest
        if above(exposure) < 0:
            root: Any = brentq(above, exposure, burst.exposure)
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
        return StillBurst(num_frames, math.exp(place), _psnr(error))


class MovingBurst(NamedTuple):
    """The best burst of a sensor that moves while its frames are exposed.

    Attributes:
        num_frames: Number of frames.
        frames: Their paths.
        travel: Way of the stage, from the lowest to the highest position over the burst; px.
        is_sweep: Whether one slow parabola is read out several times, and not one a frame.
        psnr: PSNR of the best linear decoder, which knows the speed, in linear light; dB.
    """

    num_frames: int
    frames: Frames
    travel: float
    is_sweep: bool
    psnr: float


def best_still_burst(scene: Scene) -> StillBurst | None:
    """The burst of least error of a camera at rest; None without `scene.burst`.

    The frames follow each other at the rate of the burst, with its dead time between them, and all
    of them within its window; no frame fills a pixel.
    """
    require_known("best_still_burst", scene=scene)
    burst = scene.burst
    if burst is None:
        return None
    return StillBursts(scene).best(
        float(burst.frames_per_s),
        max_frames=burst.max_frames,
        dead_time=float(burst.dead_time),
    )


@outside_trace()
def best_moving_burst(scene: Scene) -> MovingBurst | None:
    """The burst of least error of a sensor that moves; None where the camera takes no two frames.

    The stage follows parabolas of alternating direction, between which it goes on at constant
    velocity, or one slow parabola over the whole burst. Its limits hold over the burst. The
    sensor pans at the middle of the speeds, as far as it may. The frames have the
    times of those of `best_still_burst`.
    """
    require_known("best_moving_burst", scene=scene)
    if scene.burst is None:
        return None
    burst, space = scene.burst, _FramesInTime.of(scene, scene.burst)
    scene = without_tolerances(scene)
    bursts = [
        _best_of_kind(scene, space, count, pan, is_sweep=is_sweep)
        for count in space.numbers_of_frames(burst.max_frames)
        for pan in _pans(scene, space, count)
        for is_sweep in (False, True)
    ]
    return max(bursts, key=lambda burst: burst.psnr, default=None)


class _FramesInTime(NamedTuple):
    """When frames may be exposed.

    Attributes:
        period: Time from one frame to the next; s.
        window: Longest time from first to last light; s.
        shortest: Shortest exposure of a frame; s.
        longest: Longest exposure of a frame; s.
    """

    period: float
    window: float
    shortest: float
    longest: float

    @staticmethod
    def of(scene: Scene, burst: Burst) -> "_FramesInTime":
        """The times of a scene for the frames that its camera takes."""
        period, window = 1 / float(burst.frames_per_s), _window(scene)
        shortest, longest = _exposures(scene)
        longest = min(longest, period - float(burst.dead_time), window)
        return _FramesInTime(period, window, shortest, longest)

    def longest_of(self, num_frames: int) -> float:
        """Longest exposure of each of some frames; s."""
        return min(self.longest, self.window - (num_frames - 1) * self.period)

    def duration(self, num_frames: int) -> float:
        """Longest time from the first to the last light of some frames; s."""
        return (num_frames - 1) * self.period + self.longest_of(num_frames)

    def numbers_of_frames(self, most: int) -> list[int]:
        """The greatest numbers of frames: one more never hurts, but may have to be short."""
        fits = [n for n in range(2, most + 1) if self.longest_of(n) >= self.shortest]
        return fits[-_NUMBERS_TRIED:]


def _best_of_kind(
    scene: Scene, space: _FramesInTime, num_frames: int, pan: float, *, is_sweep: bool
) -> MovingBurst:
    """The best exposure and acceleration of some frames."""
    from scipy.optimize import minimize

    limits, period = scene.limits, space.period
    longest = space.longest_of(num_frames)
    panned = abs(pan) * space.duration(num_frames) if limits.pans == "stage" else 0.0

    def frames_at(place: Float[np.ndarray, "2"]) -> tuple[Frames, float]:
        """The frames of a point of the unit square, and the travel of the stage."""
        half = space.shortest * (longest / space.shortest) ** float(place[0]) / 2
        if is_sweep:
            whole = ((num_frames - 1) * period + 2 * half) / 2
            most = float(limits.largest_acceleration(jnp.asarray(whole), jnp.asarray(pan)))
            room = max(float(limits.max_stroke) - panned, 0.0)
            a = float(place[1]) * min(most, room / whole**2)
            frames = sweep_frames(num_frames, half, a, period)
            travel = a * whole**2 + panned
        else:
            swing = 2 * half * (period - half)  # of the acceleration 1
            most = float(limits.largest_acceleration(jnp.asarray(half), jnp.asarray(pan)))
            room = float(limits.max_stroke)
            if limits.max_travel is not None:
                room = min(room, float(limits.max_travel))
            a = float(place[1]) * min(most, max(room - panned, 0.0) / swing)
            frames, travel = alternating_frames(num_frames, half, a), a * swing + panned
        return frames._replace(velocities=np.asarray(frames.velocities) + pan), travel

    ends = [frames_at(np.array([x, 1.0]))[0] for x in (0.0, 1.0)]
    plan = reduce(larger, (sizes(seen_by(scene, each), each.motion) for each in ends))

    def loss(place: Float[np.ndarray, "2"]) -> float:
        return -float(burst_psnr(scene, [frames_at(place)[0]], plan=plan))

    steps = np.linspace(0, 1, _STEPS)
    places = [np.array([x, y]) for x in steps for y in steps]
    start = min(places, key=loss)
    options = {"xatol": 1e-3, "fatol": 1e-5}
    end: Any = minimize(loss, start, method="Nelder-Mead", bounds=[(0, 1), (0, 1)], options=options)
    frames, travel = frames_at(end.x)
    return MovingBurst(num_frames, frames, travel, is_sweep, -float(end.fun))


def _window(scene: Scene) -> float:
    """Longest time from the first light of a burst to its last; s."""
    if scene.burst is None or scene.burst.window is None:
        return 2 * float(scene.limits.max_half_exposure)
    return float(scene.burst.window)


def _exposures(scene: Scene) -> tuple[float, float]:
    """Shortest and longest exposure that limits and a full pixel leave one frame; s."""
    limits = scene.limits
    shortest, longest = 2 * float(limits.min_half_exposure), 2 * float(limits.max_half_exposure)
    if scene.sensor.full_well is not None:
        filling = 2 * float(filling_half_exposure(scene.sensor.full_well, scene.photon_rate))
        longest = min(longest, filling)
    return shortest, longest


def _psnr(error: float) -> float:
    """The level of a squared error; dB. Without any error it is infinite."""
    return -10 * math.log10(error) if error > 0 else math.inf


def _pans(scene: Scene, space: _FramesInTime, num_frames: int) -> list[float]:
    """Velocities to pan at: the middle of the speeds, as near as a sensor may; of a stage none too.

    The pan of a stage takes its stroke from the parabolas.
    """
    limits, on_stage = scene.limits, scene.limits.pans == "stage"
    most = min(float(limits.max_pan), float(limits.max_top_speed))
    if on_stage:
        most = min(most, float(limits.max_stroke) / space.duration(num_frames))
    middle = sum(float(speed) for speed in scene.speed_range) / 2
    pan = min(max(middle, -most), most)
    return [0.0, pan] if on_stage and pan else [pan]
