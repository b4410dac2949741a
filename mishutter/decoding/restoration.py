"""A picture restored from what a camera has taken, however large, a few rows at a time."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core.checks import (
    RowLike,
    require,
    require_key,
    require_positive_int,
    shape_of,
)
from mishutter.camera.capture import (
    as_pixels,
    as_radiance,
    distinct_colours,
    require_alike_rows,
    simulate_capture,
)
from mishutter.camera.captured_frames import require_speed, simulate_frames
from mishutter.camera.footage import Footage
from mishutter.camera.layers import Layers
from mishutter.camera.rows import rows_last
from mishutter.decoding.decoders.base import AbstractDecoder, BlurModel, blur_model
from mishutter.decoding.decoders.linear import decoder_or_ensemble
from mishutter.decoding.decoders.speed import SpeedEstimate
from mishutter.decoding.decoders.speed_finding import SpeedFindingDecoder, decoder_of, informed
from mishutter.decoding.deconvolution import portions, restored_light
from mishutter.decoding.frame_velocity import VelocityEstimate
from mishutter.decoding.objects.restored import Known
from mishutter.decoding.photographs import RestoredPhotograph, behind_optics, errors_of, levels_of
from mishutter.decoding.restored_frames import (
    Progress,
    RestoredFrames,
    frames_restored,
    shows_objects,
)
from mishutter.design.design import Design
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE, knowledge_of
from mishutter.evaluation.views import sensor_view
from mishutter.model.exposures import Exposures
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.windows import RectShutter
from mishutter.pictures.images import Axis, Picture, transposed

Estimate = SpeedEstimate | VelocityEstimate
_ROWS_AT_ONCE = 128
"""Rows of a portion, which keep the memory of its work to some tens of megabytes."""


class _Pictures(NamedTuple):
    captured: np.ndarray
    restored: np.ndarray


class Simulation(_Pictures):
    """A capture and its restoration: a pair."""

    # The estimate of the speed that a decoder has found, which is no part of the pair; None of none
    found: Estimate | None = None
    # The frames restored object by object, which are no part of the pair either; None of others
    by_object: RestoredFrames | None = None


class Restoration(NamedTuple):
    """A restored capture."""

    light: np.ndarray  # Light of the picture, white = 1; the shape of the capture
    # The speed that was found in it, or told for frames; None where neither was judged
    found: Estimate | None
    by_object: RestoredFrames | None = None  # The frames restored object by object; None of others


def capture_and_restore(
    subject: Picture | Layers | Footage | ArrayLike,
    scene: Scene,
    motion: AbstractMotion | Exposures,
    shutter: AbstractShutter | None = None,
    *,
    speed: float | RowLike = 0.0,
    decoder: AbstractDecoder | None = None,
    key: Array | None = None,
    border: str = "reflect",
    full_well: float | None = None,
    adc_bits: int | None = None,
    rows_at_once: int = _ROWS_AT_ONCE,
    progress: Progress | None = None,
) -> Simulation:
    """Capture a subject and restore it, within memory of a few times its own size.

    Blur and noise are along rows, so that rows can be done in any portions; a decoder that knows
    how rows go together is given a few more above and below (`rows_beyond`), and one that finds the
    speed finds it in all of them. One that sets its strength by the residual of a plane does so for
    each portion. Frames in the plane, and those that are restored object by object, are done at
    once.

    Args:
        subject: A photograph, a layered scene, or footage, of which no burst is taken.
        scene: Light and noise, and what the decoder may know.
        motion: Motion of the sensor; or the exposures of a design, as `Design.exposures` has them,
            of which a burst is restored by the speed that the decoder finds in it.
        shutter: Transmittance over the exposure of a motion; open by default.
        speed: Speed of a photograph, px/s; its velocity in the plane; 0 for layers and footage.
        decoder: The method, whatever the scene says of decoders; the ensemble filter by default.
        key: JAX key of the noise; None for none.
        border: As in `simulate_capture`, for a photograph; that of a burst is "reflect".
        full_well: Most electrons a pixel holds, e-; by default as many as the scene says.
        adc_bits: Bits of the converter; None for no rounding.
        rows_at_once: Most rows of a portion, or columns if the scene's objects move along these.
        progress: Called with a sentence and the share done.

    Returns:
        What was captured, of a burst all frames, and the picture restored from it.

    Raises:
        ValueError: as `simulate_capture` and `simulate_frames`.
    """
    function = "capture_and_restore"
    if isinstance(motion, Exposures):
        exposures = motion
        require(shutter is None, f"{function}(shutter=...)", "be left to the exposures", shutter)
    else:
        exposures = Exposures.of_one(motion, RectShutter() if shutter is None else shutter)
    is_one = exposures.shutter is not None
    require_scene(scene, in_plane=exposures.in_plane)
    require_positive_int(f"{function}(rows_at_once=...)", rows_at_once)
    require_key(f"{function}(key=...)", key)
    chosen = decoder_or_ensemble(decoder, function)
    report = progress if progress is not None else lambda text, share: None
    if exposures.shutter is not None:
        camera = exposures.motion, exposures.shutter
        capture = partial(simulate_capture, motion=camera[0], shutter=camera[1], border=border)
    else:
        words = "be of one exposure for footage, or another border than 'reflect'"
        is_taken = border == "reflect" and not isinstance(subject, Footage)
        require(is_taken, f"{function}(motion=...)", words, exposures)
        capture = partial(simulate_frames, frames=exposures.path)
    options = {"speed": speed, "full_well": full_well, "adc_bits": adc_bits}
    take = partial(capture, scene=scene, **options)
    is_whole = exposures.in_plane or (not is_one and shows_objects(scene, exposures.frames))
    if isinstance(subject, Layers | Footage) or scene.sensor.is_rolling or is_whole:
        report("capturing", 0.0)
        captured = np.asarray(take(subject, key=key))
    else:
        image = np.asarray(as_radiance(subject, f"{function}(subject=...)"))
        axis = scene.sensor.axis
        captured = _taken(image, take, key, axis=axis, rows_at_once=rows_at_once, report=report)
    # Layers that a sensor at rest sees move on their own.
    is_several = isinstance(subject, Layers) and len(subject.layers) > 1
    several = is_several and not is_one and sum(exposures.rests) > 1
    result = _restored(
        captured,
        scene,
        exposures,
        chosen,
        known=Known(),
        by_object=several or None,
        rows_at_once=rows_at_once,
        report=lambda text, share: report(text, 0.5 + 0.5 * share),
    )
    report("done", 1.0)
    simulation = Simulation(captured, result.light)
    simulation.found, simulation.by_object = result.found, result.by_object
    return simulation


def _taken(
    image: np.ndarray,
    capture: Callable,
    key: Array | None,
    *,
    axis: Axis,
    rows_at_once: int,
    report: Progress,
) -> np.ndarray:
    """Captures of a few rows at a time, or columns, each with noise of its own."""
    across, taken = 0 if axis == "rows" else 1, []
    firsts = range(0, image.shape[across], rows_at_once)
    for first, part in zip(firsts, np.split(image, firsts[1:], axis=across), strict=True):
        report("capturing", 0.5 * first / image.shape[across])
        own_key = None if key is None else jax.random.fold_in(key, first)
        taken.append(np.asarray(capture(part, key=own_key)))
    return np.concatenate(taken, axis=across + taken[0].ndim - image.ndim)


def _restored(
    captured: np.ndarray,
    scene: Scene,
    exposures: Exposures,
    decoder: AbstractDecoder,
    *,
    known: Known,
    by_object: bool | None = None,
    rows_at_once: int = _ROWS_AT_ONCE,
    report: Progress,
) -> Restoration:
    """The picture by the speed or the objects that are known or found in a capture."""
    shutter, frames, told = exposures.shutter, exposures.path, known.speeds
    shows = known.outlines is not None or shows_objects(scene, frames, by_object)
    is_by_object, is_rolling = shows and shutter is None, scene.sensor.is_rolling
    if told is not None and not is_by_object:
        told = require_speed("restore(speed=...)", told, frames)  # type: ignore[arg-type]
    if shutter is not None and is_rolling:
        require_alike_rows("restore(design=...)", exposures.motion, shutter)
    # Rows that are exposed in turn see the same but further on, by a way that a speed tells.
    if shutter is None or (is_rolling and told is not None):
        result = frames_restored(
            captured if shutter is None else captured[None],
            scene,
            frames,
            decoder,
            known._replace(speeds=told),
            is_by_object=is_by_object,
            rows_at_once=rows_at_once,
            report=report,
        )
        light = np.asarray(result.light, captured.dtype)
        return Restoration(light, result.estimate, result if is_by_object else None)
    axis, along, motion = scene.sensor.axis, scene.along_rows(), exposures.motion
    model = blur_model(along, motion, shutter)
    if told is not None:
        pan = float(sensor_view(along, motion, shutter).velocity)
        model = model.knowing(float(np.asarray(told)) - pan)
    turned = transposed(captured, axis)
    light, relative = _in_portions(turned, decoder, model, rows_at_once, report)
    found = None if relative is None else relative.of(along, motion)
    return Restoration(transposed(light, axis), found)


def photograph_by_frames(
    picture: Picture | ArrayLike,
    scene: Scene,
    sequence: Exposures,
    *,
    speeds: Sequence[float],  # px/s
    key: Array,
    progress: Callable[[float], None] = lambda share: None,
) -> RestoredPhotograph:
    """`restore_photograph` by the frames of a burst, whose speed the decoder finds in them.

    It holds the middle frame as the capture, moved to where the picture stands, and no level that
    is expected of one photograph.
    """
    axis, radiance = scene.sensor.axis, as_radiance(picture, "photograph_by_frames(picture=...)")
    radiance = transposed(radiance[..., None] if radiance.ndim == 2 else radiance, axis)
    reference = behind_optics(np.asarray(radiance), scene)
    captured, restored, doubts, trials = [], [], [], []
    middle, (_, (place,)) = sequence.num_frames // 2, sequence.along.middle

    def report(index: int, text: str, share: float) -> None:
        progress((index + share) / len(speeds))

    for index, speed in enumerate(speeds):
        own_key, own_report = jax.random.fold_in(key, index), partial(report, index)
        result = capture_and_restore(
            picture, scene, sequence, speed=speed, key=own_key, progress=own_report
        )
        taken = sequence.along[middle]
        frame, light = (transposed(x, axis) for x in (result.captured[middle], result.restored))
        moved = round(float(speed * taken.time - (taken.position - place)))
        captured.append(np.roll(frame, moved, axis=1))
        restored.append(light)
        doubts.append("" if result.found is None else result.found.doubt)
        trials.append(errors_of(reference, [light]))
    return RestoredPhotograph(
        *levels_of(np.asarray(speeds, np.float64), None, trials, 0),
        expected_psnr=sequence.psnr,
        own_expected_psnr=np.full(len(speeds), np.nan),
        reference=reference,
        captured=np.stack(captured),
        restored=np.stack(restored),
        doubts=np.array(doubts, object),
    ).transposed(axis)


def restore(
    capture: Picture | ArrayLike,
    design: Design,
    *,
    decoder: AbstractDecoder | None = None,
    speed: float | RowLike | Sequence[RowLike] | None = None,
) -> np.ndarray:
    """Restore what a camera has taken, within memory of a few times its own size.

    It is one capture, or the frames of a burst, which all together become one picture. The decoder
    knows of the speed what the design's scene says: it is for all speeds, finds the speed in the
    capture, or knows it. One that knows it finds it where no `speed` is given.

    Args:
        capture: Light in units of a fully open exposure: 1 where white is recorded by a shutter
            that is open throughout; a `Picture`, or an array of shape `(rows, columns)` or
            `(rows, columns, channels)`. Of a design that has a `sequence`, all its frames, each in
            units of its own exposure; shape `(frames, rows, columns)`, or channels last.
        design: The camera and its scene.
        decoder: The method; the ensemble filter by default.
        speed: The speed of all that is seen, where it is known; px/s. In the plane its velocity
            along rows and columns. Of objects before a background a row of theirs.

    Returns:
        Light of the picture, white = 1; the shape of `capture`, or of one of its frames, whose
        place is that of the picture at the middle of the burst.

    Raises:
        ValueError: if `capture` is not finite or no picture, or not the frames of the design, or
            the scene has no light.

    Examples:
        >>> from mishutter import ParabolicMotion, Scene, TukeyShutter, example_picture, optimise
        >>> from mishutter import psnr, restore, simulate_capture
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e6, read_noise=5)
        >>> motion = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
        >>> design = optimise(scene, motion, TukeyShutter(0.5), free=["shutter"])
        >>> picture = example_picture().light[200:264]
        >>> capture = simulate_capture(picture, scene, motion, design.shutter, speed=700.0)
        >>> print(f"{psnr(picture, restore(capture, design)):.0f} dB")
        38 dB
    """
    return restored_capture(capture, design, decoder=decoder, speed=speed).light


def restored_capture(
    capture: Picture | ArrayLike,
    design: Design,
    *,
    decoder: AbstractDecoder | None = None,
    speed: float | RowLike | Sequence[RowLike] | None = None,
    outlines: np.ndarray | None = None,
    by_object: bool | None = None,
    progress: Progress | None = None,
) -> Restoration:
    """`restore`, with the speed or the objects that were found."""
    scene, exposures = design.scene, design.exposures
    chosen = decoder_or_ensemble(decoder, "restore")
    pixels = np.asarray(as_pixels(capture, "restore(capture=...)"))
    if exposures.shutter is not None:
        words = "be left out for one exposure, of which no objects can be told"
        require(not by_object and outlines is None, "restore(by_object=...)", words, by_object)
        if speed is None and knowledge_of(scene).knows_speed:  # nobody tells it
            chosen = decoder_of(SPEED_KNOWLEDGE["found"], chosen)
    else:
        count = exposures.num_frames
        is_stack = pixels.ndim in (3, 4) and pixels.shape[0] == count
        requirement = f"be the {count} frames of the design's burst, of rows and columns"
        require(is_stack, "restore(capture=...)", requirement, shape_of(pixels))
    return _restored(
        pixels,
        scene,
        exposures,
        chosen,
        known=Known(speed, outlines),  # type: ignore[arg-type]
        by_object=by_object,
        report=progress or (lambda text, share: None),
    )


def _in_portions(
    captured: np.ndarray,
    decoder: AbstractDecoder,
    model: BlurModel,
    rows_at_once: int,
    report: Progress,
) -> tuple[np.ndarray, SpeedEstimate | None]:
    """A capture restored a few rows at a time, by the speed that is found in all of them first.

    That speed is relative to the sensor.
    """
    estimate = None
    if isinstance(decoder, SpeedFindingDecoder):
        report("finding the speed", 0.0)
        planes = rows_last(distinct_colours(captured))
        decoder, model, estimate = informed([decoder], planes, model)[0]
    restored, beyond, num_rows = np.empty_like(captured), decoder.rows_beyond, len(captured)
    for here, around, inner in portions(num_rows, rows_at_once, beyond, report):
        restored[here] = restored_light(captured[around], decoder, model)[inner]
    return restored, estimate
