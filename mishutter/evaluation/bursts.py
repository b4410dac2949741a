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
from mishutter.evaluation.needs import ONLY_SPECTRA, Plan, sizes
from mishutter.evaluation.response import Response, respond
from mishutter.evaluation.views import sampled_view
from mishutter.model import (
    AbstractMotion,
    LinearMotion,
    RectShutter,
    Scene,
    filling_half_exposure,
)

_TOLERANCE = 1e-4
"""Tolerance on the logarithm of the exposure."""


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
