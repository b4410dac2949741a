"""The level of several frames by the response of one exposure, which has derivatives.

The package computes it by NumPy (`mishutter.evaluation.levels`, where its formula stands).
"""

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter import StillCamera
from mishutter._core.checks import as_numpy
from mishutter._core.compiling import compiled
from mishutter.evaluation.errors import LinearErrors
from mishutter.evaluation.levels import in_parts
from mishutter.evaluation.needs import ONLY_SPECTRA, Plan, sizes
from mishutter.evaluation.response import Response, compute_response
from mishutter.evaluation.views import sampled_view
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene
from mishutter.model.shutters.windows import RectShutter


class FrameGroup(NamedTuple):
    """Frames on one path of the sensor, each with an open shutter and a velocity of its own."""

    # Motion of the sensor over one frame, from its mid-exposure, without velocity
    motion: AbstractMotion
    # Velocity of the sensor at the mid-exposure of each; px/s, shape `(k,)`
    velocities: Float[Array | np.ndarray, "k"] = np.zeros(1)
    num_each: int | Float[Array | np.ndarray, ""] = 1  # Frames at each velocity


def still_frames(num_frames: int, half_exposure: ArrayLike) -> FrameGroup:
    """Frames of a sensor at rest."""
    return FrameGroup(StillCamera(half_exposure=half_exposure), num_each=num_frames)


def burst_psnr(
    scene: Scene, frames: Sequence[FrameGroup], *, plan: Plan | None = None
) -> Float[Array, ""]:
    """PSNR of the best linear decoder that registers frames, in linear light; dB."""
    scene = in_parts(scene)
    errors = errors_by_speed(scene, frames, plan=plan)
    return -10 * jnp.log10(jnp.sum(scene.weights.astype(errors.dtype) * errors))


def errors_by_speed(
    scene: Scene, frames: Sequence[FrameGroup], *, plan: Plan | None = None
) -> Float[Array, "n"]:
    """Squared error of that decoder at each speed of a scene that moves as a whole; white = 1."""
    exposed, num_each = _exposed(scene, frames, plan)
    return _errors(exposed, num_each, scene.speeds.size)


class _Exposed(NamedTuple):
    """Frames of one path as their errors need them, all arrays."""

    scene: Scene
    motion: AbstractMotion
    response: Response


def _exposed(
    scene: Scene, frames: Sequence[FrameGroup], plan: Plan | None
) -> tuple[tuple[_Exposed, ...], Float[Array, "f"]]:
    """The response of each path, and its number of frames at each velocity."""
    scene = in_parts(scene)
    seen = [seen_by(scene, each) for each in frames]
    if plan is None:
        plan = plan_of_frames(scene, frames)
    views = [
        sampled_view(own, each.motion, RectShutter(), ONLY_SPECTRA, plan)
        for own, each in zip(seen, frames, strict=True)
    ]
    num_each = jnp.stack([jnp.asarray(each.num_each, scene.speeds.dtype) for each in frames])
    return tuple(
        _Exposed(view.scene, view.motion, compute_response(view)) for view in views
    ), num_each


def plan_of_frames(scene: Scene, frames: Sequence[FrameGroup]) -> Plan:
    """Sizes that hold the motions of some frames, and all within the scene's limits."""
    scene = in_parts(scene)
    return reduce(Plan.holding, (sizes(seen_by(scene, each), each.motion) for each in frames))


def seen_by(scene: Scene, frames: FrameGroup) -> Scene:
    """The scene at its speeds relative to each of the velocities, one after the other."""
    speeds, velocities = as_numpy(scene.speeds, frames.velocities)
    relative = speeds[None] - velocities.astype(speeds.dtype)[:, None]
    weights = jnp.tile(scene.weights, velocities.size)
    return scene.without_metadata(speeds=relative.ravel(), weights=weights)


@compiled
def _errors(
    exposed: tuple[_Exposed, ...], num_each: Float[Array, "f"], num_speeds: int
) -> Float[Array, "n"]:
    r"""Errors by $1/L = 1 + \sum_k (1/L_k - 1)$ of the shares $L_k$ that frames alone leave."""
    errors = [LinearErrors(*each) for each in exposed]
    power, gained = errors[0].power, jnp.zeros(())
    for each, count in zip(errors, num_each, strict=True):
        lost = each.lost_known_by_speed
        of_each = (1 / lost - 1).reshape(-1, num_speeds, lost.shape[-1])
        gained = gained + count * jnp.sum(of_each, axis=0)
    left = 1 / (1 + gained)
    # No frequency beyond those that are sampled passes.
    num_kept = left.shape[-1]
    return (
        jnp.sum(power[None, :num_kept] * left, axis=-1) + jnp.sum(power[num_kept:])
    ) / power.size
