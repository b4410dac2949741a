r"""Bursts: many short frames in place of one exposure, aligned and added up.

$n$ frames of the exposure $\tau$ make one picture of $n R\tau$ electrons of white, whose blur is
that of one frame and whose read noise $\sqrt n\,\sigma$ is paid $n$ times. The alignment is taken
to be perfect, at every speed and at no cost; a decoder that can align knows the speed, so that the
error is that of `Metrics.known_speed_psnr`. The losses of a real burst to misalignment, to the time
between frames and to objects that are hidden in some frames do not count.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from mishutter._core import compiled, outside_trace, require_known
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.errors import known_speed_squared_error
from mishutter.evaluation.frames import added_up
from mishutter.evaluation.lengths import distinct_speeds
from mishutter.evaluation.needs import ONLY_SPECTRA, Plan, sizes
from mishutter.evaluation.power import lost_share, power_on_grid
from mishutter.evaluation.response import Response, respond
from mishutter.evaluation.views import sampled_view
from mishutter.model import (
    AbstractMotion,
    LinearMotion,
    RectShutter,
    Scene,
    filling_half_exposure,
    frequencies,
    noise_power,
    pixel_response,
    require_whole,
    white_electrons,
)

_TOLERANCE = 1e-4
"""Tolerance on the logarithm of the exposure."""
_SATURATED = 1e-3
"""Gain of one more frame below which more frames are of no use; dB."""


class BurstOfFrames(NamedTuple):
    """The best burst for a scene.

    Attributes:
        num_frames: Number of frames.
        motion: Motion of the sensor over one of them.
        scene: The scene with the light and the read noise of all of them together, in which one
            exposure of that motion is the burst.
    """

    num_frames: int
    motion: AbstractMotion
    scene: Scene


@outside_trace()
def best_burst(scene: Scene) -> BurstOfFrames | None:
    """The burst of least error by a decoder that is told the speed; None without `scene.burst`.

    The frames follow each other at the rate of the burst, all of it within the longest exposure of
    the scene's limits; no frame fills a pixel. The sensor pans at the middle of the speeds as far
    as it may, and where the stage pans as far as its stroke reaches over the whole burst. More
    frames are tried as long as they lower the error.
    """
    require_known("best_burst", scene=scene)
    scene = without_tolerances(scene)
    if scene.burst is None:
        return None
    from scipy.optimize import minimize_scalar

    shortest, longest = (
        2 * float(x) for x in (scene.limits.min_half_exposure, scene.limits.max_half_exposure)
    )
    most = min(1 / float(scene.burst.frames_per_s), longest)
    if scene.full_well is not None:
        most = min(most, 2 * float(filling_half_exposure(scene.full_well, scene.photon_rate)))
    best, least = None, math.inf
    for count in range(1, scene.burst.max_frames + 1):
        before_last = (count - 1) / float(scene.burst.frames_per_s)
        longest_frame = min(most, longest - before_last)
        if longest_frame < shortest:
            break
        added, velocity = added_up(scene, count), _pan(scene, before_last + longest_frame)
        plan = sizes(scene, LinearMotion(half_exposure=longest_frame / 2, velocity=velocity))

        def error(
            log_exposure: float,
            added: Scene = added,
            velocity: Float[np.ndarray, ""] = velocity,
            plan: Plan = plan,
        ) -> float:
            half = np.exp(log_exposure) / 2
            return _error(added, LinearMotion(half_exposure=half, velocity=velocity), plan)

        ends = math.log(shortest), math.log(longest_frame)
        places = [*ends]
        if longest_frame > shortest:
            options = {"xatol": _TOLERANCE}
            end: Any = minimize_scalar(error, bounds=ends, method="bounded", options=options)
            places.append(float(end.x))
        value, place = min((error(x), x) for x in places)
        if value >= least:
            break
        pan = LinearMotion(half_exposure=np.exp(place) / 2, velocity=velocity)
        motion = pan if velocity else pan.without_velocity()
        best, least = BurstOfFrames(count, motion, added), value
    return best


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
    """The bursts of a camera at rest within the longest exposure of a scene, by NumPy alone.

    The verdict on every scene names one of them, so that they must not cost a compiled program:
    the response of a frame at rest has a closed form.

    Args:
        scene: Speeds, light, noise and limits; concrete, and without a background.
        at_worst: Whether the level is that at the worst of the speeds, and not of the mean error.
    """

    def __init__(self, scene: Scene, *, at_worst: bool = False) -> None:
        require_whole(scene, "a burst of frames")
        self._scene, self._at_worst = scene, at_worst
        limits = scene.limits
        self._window = 2 * float(limits.max_half_exposure)
        self._shortest, self._longest = 2 * float(limits.min_half_exposure), self._window
        if scene.full_well is not None:
            filling = 2 * float(filling_half_exposure(scene.full_well, scene.photon_rate))
            self._longest = max(min(self._longest, filling), self._shortest)
        self._speeds, weights = (x.astype(np.float64) for x in distinct_speeds(scene, folds=True))
        self._weights = weights / weights.sum()
        motion = LinearMotion(half_exposure=self._longest / 2)
        count = sizes(without_tolerances(scene), motion).num_frequencies
        self._frequency, self._power = frequencies(count), power_on_grid(scene, count)
        self._aperture = np.asarray(pixel_response(self._frequency, float(scene.lens_blur))) ** 2

    def error(self, num_frames: int, exposure: float) -> float:
        """Squared error that is left by some frames of an exposure, s; white = 1."""
        scene = self._scene
        rate, mean, read = (
            float(x) for x in (scene.photon_rate, scene.mean_level, scene.read_noise)
        )
        electrons = white_electrons(rate, exposure)
        noise = noise_power(1.0, mean, electrons, read) / num_frames
        passed = np.sinc(self._frequency * exposure * self._speeds[:, None]) ** 2 * self._aperture
        lost = lost_share(self._power * electrons**2, passed, 0.0 * passed, noise)
        errors = np.mean(self._power * lost, axis=1)
        return float(np.max(errors) if self._at_worst else self._weights @ errors)

    def best(self, frames_per_s: float) -> StillBurst:
        """The burst of the least error at a frame rate."""
        period, bursts = 1 / frames_per_s, []
        for count in range(1, 2 + int(self._window / period)):
            longest = min(period, self._window - (count - 1) * period)
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


def _psnr(error: float) -> float:
    """The level of a squared error; dB. Without any error it is infinite."""
    return -10 * math.log10(error) if error > 0 else math.inf


def _pan(scene: Scene, duration: float) -> Float[np.ndarray, ""]:
    """The velocity in the middle of the speeds, or as near to it as the limits let a sensor pan.

    Args:
        scene: Speeds and limits.
        duration: From the beginning of the first frame to the end of the last; s.
    """
    limits = scene.limits
    most = min(float(limits.max_pan), float(limits.max_top_speed))
    if limits.pans == "stage":
        most = min(most, float(limits.max_stroke) / duration)
    middle = sum(float(speed) for speed in scene.speed_range) / 2
    return np.asarray(np.clip(middle, -most, most), scene.speeds.dtype)


def _error(scene: Scene, motion: AbstractMotion, plan: Plan) -> float:
    view = sampled_view(scene, motion, RectShutter(), ONLY_SPECTRA, plan)
    return float(_known_speed_error(view.scene, view.motion, respond(view)))


@compiled
def _known_speed_error(
    scene: Scene, motion: AbstractMotion, response: Response
) -> Float[Array, ""]:
    return known_speed_squared_error(scene, motion, response)
