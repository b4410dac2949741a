r"""Several frames of one picture: their level.

A decoder that registers the frames of a burst knows the speed $s$, and restores one picture from
$g_k = h_k * r + \text{noise}$ with independent noise. It leaves

$$E(s) = 2\int_0^{1/2}\frac{S}{1 + S\,\mathrm{sinc}^2(f)\,\sum_k |H_k(f, s)|^2/N_k}\,df,\qquad
N_k = \frac{\bar f}{2RT_k} + \Bigl(\frac{\sigma}{2RT_k}\Bigr)^2 .$$

Frames of any path and length may be mixed. Only $|H_k|$ counts: the direction of a parabola, its
place and the gaps between frames do not matter. Of a picture before a background the decoder knows
the speed of both layers and which part is which, and each part is restored by the filter of its
speed: the error is the mean over the parts. Edges, where one hides the other, do not count.
"""

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import all_concrete, as_numpy
from mishutter._core.compiling import compiled
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.errors import LinearErrors, known_speed_errors_of_frames
from mishutter.evaluation.layers import background_of
from mishutter.evaluation.needs import ONLY_SPECTRA, Plan, larger, sizes
from mishutter.evaluation.response import Response, respond
from mishutter.evaluation.views import sampled_view
from mishutter.model.motion import AbstractMotion, StillCamera
from mishutter.model.scene import Scene, require_one_axis
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


def steps_of(num_frames: int) -> Float[np.ndarray, "{num_frames}"]:
    """Places of the frames from the middle of the burst, in periods."""
    return np.arange(num_frames) - (num_frames - 1) / 2


def in_parts(scene: Scene) -> Scene:
    """The scene as parts that move on their own, a background among them, without tolerances."""
    require_one_axis(scene)
    layers, scene = scene.occlusion, without_tolerances(scene)
    if layers is None:
        return scene
    space = np if all_concrete((scene.speeds, scene.weights, layers)) else jnp
    speeds, weights, share, *behind = (
        space.asarray(x)
        for x in (scene.speeds, scene.weights, layers.front_share, *background_of(scene))
    )
    return scene.with_occlusion(None).bare(
        speeds=space.concatenate([speeds, behind[0]]),
        weights=space.concatenate([share * weights, (1 - share) * behind[1]]),
    )


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
    return tuple(_Exposed(view.scene, view.motion, respond(view)) for view in views), num_each


def plan_of_frames(scene: Scene, frames: Sequence[FrameGroup]) -> Plan:
    """Sizes that hold the motions of some frames, and all within the scene's limits."""
    scene = in_parts(scene)
    return reduce(larger, (sizes(seen_by(scene, each), each.motion) for each in frames))


def seen_by(scene: Scene, frames: FrameGroup) -> Scene:
    """The scene at its speeds relative to each of the velocities, one after the other."""
    speeds, velocities = as_numpy(scene.speeds, frames.velocities)
    relative = speeds[None] - velocities.astype(speeds.dtype)[:, None]
    weights = jnp.tile(scene.weights, velocities.size)
    return scene.bare(speeds=relative.ravel(), weights=weights)


@compiled
def _errors(
    exposed: tuple[_Exposed, ...], num_each: Float[Array, "f"], num_speeds: int
) -> Float[Array, "n"]:
    frames = [LinearErrors(*each) for each in exposed]
    return known_speed_errors_of_frames(frames, num_each, num_speeds)
