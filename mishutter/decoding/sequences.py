"""One picture from the frames of a sequence: its speed, and its restoration from all of them."""

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import ArrayLike, Float

from mishutter._core.checks import RowLike, as_float, require, require_known, shape_of
from mishutter._core.parallel import alone_in_blas
from mishutter.camera.capture import as_pixels, distinct_colours, every_colour
from mishutter.camera.rows import Planes, rows_last
from mishutter.camera.sequences import require_speed
from mishutter.decoding.axis_frames import restored_on_axis
from mishutter.decoding.axis_speed import speed_on_axis
from mishutter.decoding.decoders.base import AbstractDecoder
from mishutter.decoding.decoders.linear import decoder_or_ensemble
from mishutter.decoding.decoders.speed import SpeedEstimate
from mishutter.decoding.plane_frames import method_in_plane, restored_in_plane
from mishutter.decoding.plane_velocity import (
    VelocityEstimate,
    told_in_plane,
    velocity_in_plane,
)
from mishutter.model.scene import Scene, require_scene, require_whole
from mishutter.model.sequences import TimedFrame
from mishutter.pictures.images import Axis, transposed
from mishutter.plane.frames import PlaneFrames


class RestoredFrames(NamedTuple):
    """A picture that was restored from the frames of a sequence.

    Attributes:
        light: Light of the picture where the sensor is at the middle of the sequence, white = 1;
            the shape of a frame.
        estimate: The speed that was found or given, and its doubt; the error of a given one is 0.
            None where it was given for one frame.
    """

    light: Planes
    estimate: SpeedEstimate | VelocityEstimate | None


@alone_in_blas()
def restore_frames(
    captures: ArrayLike | Sequence[ArrayLike],
    scene: Scene,
    frames: Sequence[TimedFrame] | PlaneFrames,
    *,
    decoder: AbstractDecoder | None = None,
    speed: float | RowLike | None = None,
) -> RestoredFrames:
    """Restore the picture that the frames of a sequence show, each point from those that see it.

    Args:
        captures: Light of each frame in units of its exposure of white, as `simulate_frames` gives
            it; shape `(frames, rows, columns)`, or channels last; concrete.
        scene: Speeds that may occur, light, noise, and spectrum of pictures.
        frames: The frames, with open shutters; or frames in the plane.
        decoder: The method; the ensemble filter by default, which is then the best linear one. In
            the plane total variation and a denoiser of your own are others.
        speed: The speed of the picture, px/s; by default it is found in the frames, and trusted
            where they fit one picture at that speed, and at no other as well. For frames in the
            plane its velocity along rows and columns, of which the estimate is a
            `VelocityEstimate`. One that is given is judged like one that is found: by whether the
            frames fit one picture at it.

    Raises:
        ValueError: if the scene has a background, no light, or more speeds than frames can tell
            apart; the captures are traced, not finite, or not of so many frames; or `speed` is not
            a finite scalar, or displaces light by more than 8,192 px.

    Examples:
        >>> import jax
        >>> from mishutter import Scene, StillCamera, TimedFrame, example_picture
        >>> from mishutter import restore_frames, simulate_frames
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=8)
        >>> still = StillCamera(half_exposure=1e-3)
        >>> frames = [TimedFrame(still, time) for time in (-0.02, 0.0, 0.02)]
        >>> picture = example_picture().light[200:232]
        >>> key = jax.random.key(0)
        >>> captures = simulate_frames(picture, scene, frames, speed=700.0, key=key)
        >>> found = restore_frames(captures, scene, frames)
        >>> print(f"{found.estimate.speed:.1e} px/s, {found.estimate.trusted}")
        7.0e+02 px/s, True
    """
    in_plane = isinstance(frames, PlaneFrames)
    require_scene(scene, in_plane=in_plane)
    require_whole(scene, "restore_frames")
    require_known("restore_frames", captures=captures, speed=speed)
    if speed is not None:
        speed = require_speed("restore_frames(speed=...)", speed, frames)
    chosen = decoder_or_ensemble(decoder, "restore_frames")
    if isinstance(frames, PlaneFrames):
        decode = method_in_plane(chosen)
        light, planes = _planes_of(captures, frames.num_frames, "rows")
        if speed is None:
            estimate = velocity_in_plane(planes, scene, frames)
            velocity = estimate.velocity
        else:
            estimate, velocity = None, np.asarray(speed, np.float64)
            if frames.num_frames > 1:
                estimate = told_in_plane(planes, scene, frames, velocity)
        picture = restored_in_plane(planes, scene, frames, decode, velocity)
        return RestoredFrames(_as_frame(picture, light, "rows"), estimate)
    told = None if speed is None else float(speed)
    if told is not None and len(frames) == 1:
        return RestoredFrames(picture_at(captures, scene, frames, chosen, told), None)
    found = speed_of_frames(captures, scene, frames, told)
    return RestoredFrames(picture_at(captures, scene, frames, chosen, found.speed), found)


@alone_in_blas()
def speed_of_frames(
    captures: ArrayLike | Sequence[ArrayLike],
    scene: Scene,
    frames: Sequence[TimedFrame],
    told: float | None = None,
) -> SpeedEstimate:
    """The speed that `restore_frames` finds, or is told, without the picture."""
    _, planes = _planes_of(captures, len(frames), scene.sensor.axis)
    return speed_on_axis(planes, scene, frames, told)


@alone_in_blas()
def picture_at(
    captures: ArrayLike | Sequence[ArrayLike],
    scene: Scene,
    frames: Sequence[TimedFrame],
    decoder: AbstractDecoder,
    speed: float,
) -> Planes:
    """The picture that `restore_frames` restores at a speed, which nothing judges."""
    light, planes = _planes_of(captures, len(frames), scene.sensor.axis)
    picture = restored_on_axis(planes, scene, frames, decoder, speed)
    return _as_frame(picture, light, scene.sensor.axis)


def _as_frame(picture: Float[np.ndarray, "rows columns colours"], light: Any, axis: Axis) -> Planes:
    """A picture of distinct colours in the form of a frame."""
    whole: Any = every_colour(picture, light[0]) if light.ndim == 4 else picture[..., 0]
    return as_float(transposed(whole, axis))


def _planes_of(
    captures: ArrayLike | Sequence[ArrayLike], num_frames: int, axis: Axis
) -> tuple[Planes, Float[np.ndarray, "colours frames rows columns"]]:
    """Frames as arrays, turned so that things move along their rows, and their distinct colours."""
    subject, stack = "restore_frames(captures=...)", cast(Any, captures)
    if isinstance(captures, list | tuple):
        shapes = [np.shape(one) for one in captures]
        require(len(set(shapes)) <= 1, subject, "be frames of one size and as many colours", shapes)
        stack = np.stack([np.asarray(one) for one in captures]) if captures else np.zeros(0)
    light = as_pixels(stack, subject)
    is_stack = light.ndim in (3, 4) and light.shape[0] == num_frames > 0
    requirement = f"be {num_frames} frames, of rows and columns"
    require(is_stack, subject, requirement, shape_of(light))
    light = transposed(light[..., None] if light.ndim == 3 else light, axis)
    planes = np.moveaxis(np.asarray(rows_last(distinct_colours(light))), 0, 1)
    return light if np.ndim(stack) == 4 else light[..., 0], planes
