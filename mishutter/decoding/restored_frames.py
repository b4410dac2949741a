"""One picture from the frames of a sequence: its speed, and its restoration from all of them."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int

from mishutter._core.checks import RowLike, as_float, require, require_known, shape_of
from mishutter._core.parallel import alone_in_blas
from mishutter.camera.capture import as_pixels, distinct_colours, every_colour
from mishutter.camera.captured_frames import require_speed
from mishutter.camera.layers import Layers
from mishutter.camera.rows import Planes, rows_last
from mishutter.decoding.decoders.base import AbstractDecoder
from mishutter.decoding.decoders.linear import decoder_or_ensemble
from mishutter.decoding.decoders.speed import SpeedEstimate
from mishutter.decoding.decoders.speed_finding import SpeedFindingDecoder
from mishutter.decoding.deconvolution import portions
from mishutter.decoding.frame_restoration import (
    method_in_plane,
    restored_in_plane,
    restored_on_axis,
)
from mishutter.decoding.frame_velocity import (
    VelocityEstimate,
    require_shared,
    speed_on_axis,
    velocity_of_frames,
)
from mishutter.decoding.objects.restored import FoundObject, Known, is_at_rest, restored_objects
from mishutter.decoding.rolling import RowTimes
from mishutter.model.exposures import Exposures, open_frames
from mishutter.model.frame_path import Frames, PlaneFrames, TimedFrame
from mishutter.model.scene import Scene, require_scene, require_whole
from mishutter.pictures.images import Axis, transposed

Progress = Callable[[str, float], None]
"""Function that is called with a sentence about the work and the share of it that is done."""


class _Pair(NamedTuple):
    light: Planes
    estimate: SpeedEstimate | VelocityEstimate | None


class RestoredFrames(_Pair):
    """A picture that was restored from the frames of a sequence, and an estimate: a pair.

    Attributes:
        light: Light of the picture where the sensor is at the middle of the sequence, white = 1;
            the shape of a frame. In a gap between frames along one axis that place is on a straight
            line from one to the next.
        estimate: The speed that was found or given, and its doubt; the error of a given one is 0.
            None where it was given for one frame, and of objects.
        objects: The objects that were found before the background, the largest first, each with
            `velocity` and `speed`, `error`, px/s, `area`, px, `place`, `trusted` and `doubt`.
        labels: Number of the object that each pixel shows, from 1, and 0 for the background; shape
            of a frame. None of a picture that moves as a whole, as the next two.
        trust: Whether the frames agree on each pixel, away from outlines.
        layers: The background and the objects as a layered scene, from back to front.
    """

    # No parts of the pair
    objects: tuple[FoundObject, ...] = ()
    labels: Int[np.ndarray, "rows columns"] | None = None
    trust: Bool[np.ndarray, "rows columns"] | None = None
    layers: Layers | None = None


@alone_in_blas()
def restore_frames(
    captures: ArrayLike | Sequence[ArrayLike],
    scene: Scene,
    frames: Frames | Exposures,
    *,
    decoder: AbstractDecoder | None = None,
    speed: float | RowLike | Sequence[RowLike] | None = None,
    outlines: Int[np.ndarray, "rows columns"] | None = None,
    by_object: bool | None = None,
    progress: Progress | None = None,
) -> RestoredFrames:
    """Restore the picture that the frames of a sequence show, each point from those that see it.

    Of several things before a background at rest each is found in the frames in which the sensor
    is at rest, two at least, and restored along its own velocity from all. Where they do not
    explain the frames, as of what turns or walks, the picture is that of the frame nearest to the
    middle, and not trusted.

    Args:
        captures: Light of each frame in units of its exposure of white, as `simulate_frames` gives
            it; shape `(frames, rows, columns)`, or channels last; concrete.
        scene: Speeds that may occur, light, noise, and spectrum of pictures.
        frames: The frames, with open shutters: `TimedFrame`s, `PlaneFrames`, or `Exposures`, as
            `best_sequence` finds them.
        decoder: The method; the ensemble filter by default, which is then the best linear one. In
            the plane total variation and a denoiser of your own are others.
        speed: The speed of the picture, px/s; by default it is found in the frames, and trusted
            where they fit one picture at that speed, and at no other as well. For frames in the
            plane its velocity along rows and columns, of which the estimate is a
            `VelocityEstimate`. One that is given is judged like one that is found: by whether the
            frames fit one picture at it. Of objects a row of theirs, if they are known.
        outlines: Number of the object that each pixel shows at the middle, from 1, and 0 for the
            background, if that is known; shape of a frame. Speeds beside it are in that order.
            Behind a rolling shutter they are as frames show them.
        by_object: Whether to restore object by object; by default where the scene has an occlusion,
            or objects, or the outlines are given.
        progress: Called with a sentence and the share done, object by object.

    Raises:
        ValueError: if the frames are no frames or have a shaped shutter; the sensor is at rest in
            less than two frames in which objects are to be found, or moves before a background
            behind a rolling shutter; the scene has no light, or more speeds than frames can tell
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
    require_scene(scene, in_plane=True)
    frames = open_frames("restore_frames(frames=...)", frames)
    require_scene(scene, in_plane=isinstance(frames, PlaneFrames))
    require_known("restore_frames", captures=captures, speed=speed)
    chosen = decoder_or_ensemble(decoder, "restore_frames")
    is_by_object = outlines is not None or shows_objects(scene, frames, by_object)
    if not is_by_object:
        require_whole(scene, "restore_frames")
        if speed is not None:
            speed = require_speed("restore_frames(speed=...)", cast(Any, speed), frames)
    return frames_restored(
        captures,
        scene,
        frames,
        chosen,
        Known(speed, outlines),  # type: ignore[arg-type]
        is_by_object=is_by_object,
        report=progress or (lambda text, share: None),
    )


@alone_in_blas()
def frames_restored(
    captures: ArrayLike | Sequence[ArrayLike],
    scene: Scene,
    frames: Sequence[TimedFrame] | PlaneFrames,
    decoder: AbstractDecoder,
    known: Known,
    *,
    is_by_object: bool,
    rows_at_once: int | None = None,  # all by default
    report: Progress,
) -> RestoredFrames:
    """Restores frames by what is known of them, along an axis a few rows at a time."""
    in_plane = isinstance(frames, PlaneFrames)
    axis: Axis = "rows" if in_plane else scene.sensor.axis
    count = frames.num_frames if isinstance(frames, PlaneFrames) else len(frames)
    light, planes = _planes_of(captures, count, axis)
    decoder = decoder.inner if isinstance(decoder, SpeedFindingDecoder) else decoder
    if is_by_object:
        found = restored_objects(planes, scene, frames, decoder, known, report=report)
        picture = transposed(found.light, axis)
        result = RestoredFrames(_as_frame(picture, light, axis), None)
        result.objects, result.layers = found.objects, found.layers
        result.labels, result.trust = found.labels, found.trust
        return result
    if in_plane:
        method_in_plane(decoder)  # refuses others before it searches
    times = RowTimes.of(scene.sensor, planes.shape, in_plane=in_plane)
    told = None if known.speeds is None else np.atleast_1d(np.asarray(known.speeds, np.float64))
    if told is not None and count == 1:
        estimate, velocity = None, told
    else:
        if told is not None:
            require_shared(planes, frames, told)
        report("finding the speed" if told is None else "judging the speed", 0.0)
        find = velocity_of_frames if in_plane else speed_on_axis
        estimate = find(planes, scene, frames, times, told)
        if isinstance(estimate, VelocityEstimate):
            velocity = estimate.velocity
        else:
            velocity = np.array([estimate.speed])
    if isinstance(frames, PlaneFrames):
        report("restoring", 0.0)
        decode = method_in_plane(decoder)
        picture = restored_in_plane(planes, scene, frames, decode, velocity, times=times)
        return RestoredFrames(_as_frame(picture, light, axis), estimate)
    parts = []
    num_rows, beyond = planes.shape[2], decoder.rows_beyond
    for _, around, inner in portions(num_rows, rows_at_once, beyond, report):
        own = planes[:, :, around], scene, frames, decoder, float(velocity[0])
        parts.append(restored_on_axis(*own, times=times.of_rows(around))[inner])
    picture = np.concatenate(parts)
    return RestoredFrames(_as_frame(picture, light, axis), estimate)


def shows_objects(
    scene: Scene, frames: Sequence[TimedFrame] | PlaneFrames, by_object: bool | None = None
) -> bool:
    """Whether frames are restored object by object: as asked, or as a scene says."""
    if by_object is not None:
        return by_object
    if scene.occlusion is not None:
        return scene.occlusion.background == "still"
    # Objects that are registered one by one may be before a sensor that moves.
    return scene.objects is not None and is_at_rest(frames)


def _as_frame(
    picture: Float[np.ndarray, "rows columns colours"], light: Planes, axis: Axis
) -> Planes:
    """A picture of distinct colours in the form of a frame."""
    whole = every_colour(picture, light[0]) if light.ndim == 4 else picture[..., 0]
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
