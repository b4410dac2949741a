"""Capture and restoration of one picture, however large, a few rows at a time."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core.checks import (
    RowLike,
    require,
    require_finite,
    require_key,
    require_positive_int,
    require_scalar,
    shape_of,
)
from mishutter.camera.capture import as_pixels, as_radiance, distinct_colours, simulate_capture
from mishutter.camera.footage import Footage
from mishutter.camera.layers import Layers
from mishutter.camera.rows import rows_last
from mishutter.camera.sequences import simulate_frames
from mishutter.decoding.decoders.base import AbstractDecoder, BlurModel, blur_model
from mishutter.decoding.decoders.linear import decoder_or_ensemble
from mishutter.decoding.decoders.speed import SpeedEstimate
from mishutter.decoding.decoders.speed_finding import SpeedFindingDecoder, decoder_of, informed
from mishutter.decoding.objects.restored import Known, is_at_rest
from mishutter.decoding.plane_velocity import VelocityEstimate
from mishutter.decoding.restoration import (
    RestoredPhotograph,
    behind_optics,
    errors_of,
    levels_of,
    restored_light,
)
from mishutter.decoding.sequences import (
    RestoredFrames,
    picture_at,
    restore_frames,
    shows_objects,
    speed_of_frames,
)
from mishutter.design.design import AbstractDesign, Design
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE, knowledge_of
from mishutter.evaluation.views import sensor_view
from mishutter.model.exposures import AbstractExposures
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_scene
from mishutter.model.sequences import FrameSequence, TimedFrame
from mishutter.model.shutters.base import AbstractShutter
from mishutter.pictures.images import Axis, Picture, transposed
from mishutter.plane.frames import PlaneFrames

Estimate = SpeedEstimate | VelocityEstimate
Progress = Callable[[str, float], None]
"""Function that is called with a sentence about the work and the share of it that is done."""

_ROWS_AT_ONCE = 128
"""Rows of a portion, which keep the memory of its work to some tens of megabytes."""


class _Pictures(NamedTuple):
    captured: np.ndarray
    restored: np.ndarray


class Simulation(_Pictures):
    """A capture and its restoration: a pair."""

    # The estimate of the `SpeedFindingDecoder`, which is no part of the pair; None by other
    # decoders
    found: Estimate | None = None
    # The frames restored object by object, which are no part of the pair either; None of others
    by_object: RestoredFrames | None = None

    @classmethod
    def of(
        cls, captured: np.ndarray, restored: np.ndarray, estimate: Estimate | None
    ) -> "Simulation":
        """A pair, and the estimate of the speed."""
        pair = cls(captured, restored)
        pair.found = estimate
        return pair


def capture_and_restore(
    subject: Picture | Layers | Footage | ArrayLike,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    speed: float = 0.0,
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
    each portion.

    Args:
        subject: A photograph, a layered scene, or footage.
        scene: Light and noise, and what the decoder may know.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        speed: Speed of a photograph, px/s; 0 for layers and frames.
        decoder: The method, whatever the scene says of decoders; the ensemble filter by default.
        key: JAX key of the noise; None for none.
        border: As in `simulate_capture`, for a photograph.
        full_well: Most electrons a pixel holds, e-; by default as many as the scene says.
        adc_bits: Bits of the converter; None for no rounding.
        rows_at_once: Most rows of a portion, or columns if the scene's objects move along these.
        progress: Called with a sentence and the share done.

    Raises:
        ValueError: as `simulate_capture`.
    """
    require_scene(scene)
    require_positive_int("capture_and_restore(rows_at_once=...)", rows_at_once)
    require_key("capture_and_restore(key=...)", key)
    axis, scene = scene.sensor.axis, scene.along_rows()
    chosen = decoder_or_ensemble(decoder, "capture_and_restore")
    report = progress if progress is not None else lambda text, share: None
    capture = partial(
        simulate_capture,
        scene=scene,
        motion=motion,
        shutter=shutter,
        speed=speed,
        border=border,
        full_well=full_well,
        adc_bits=adc_bits,
    )
    if isinstance(subject, Layers | Footage):
        report("exposing", 0.0)
        captured = np.array(capture(subject.transposed(axis), key=key))
    else:
        image = transposed(as_radiance(subject, "capture_and_restore(subject=...)"), axis)
        captured = np.concatenate(_taken(image, capture, key, rows_at_once, report))
    model = blur_model(scene, motion, shutter)
    restored, relative = _in_portions(
        captured, chosen, model, rows_at_once, lambda text, share: report(text, 0.5 + 0.5 * share)
    )
    estimate = None if relative is None else relative.of(scene, motion)
    report("done", 1.0)
    return Simulation.of(transposed(captured, axis), transposed(restored, axis), estimate)


def burst_and_restore(
    subject: Picture | Layers | ArrayLike,
    scene: Scene,
    exposures: AbstractExposures,
    *,
    speed: float | RowLike = 0.0,  # 0 for layers; a velocity in the plane
    decoder: AbstractDecoder | None = None,
    key: Array | None = None,
    full_well: float | None = None,
    adc_bits: int | None = None,
    rows_at_once: int = _ROWS_AT_ONCE,
    progress: Progress | None = None,
) -> Simulation:
    """`capture_and_restore` of the frames of a burst, whose speed the decoder finds in them.

    In the plane they are restored at once, and not a few rows at a time.
    """
    in_plane, frames = len(exposures.axes) == 2, exposures.frames
    require_scene(scene, in_plane=in_plane)
    require_positive_int("burst_and_restore(rows_at_once=...)", rows_at_once)
    require_key("burst_and_restore(key=...)", key)
    chosen = decoder_or_ensemble(decoder, "burst_and_restore")
    report = progress if progress is not None else lambda text, share: None
    take = partial(
        simulate_frames, frames=frames, speed=speed, full_well=full_well, adc_bits=adc_bits
    )
    several = isinstance(subject, Layers) and len(subject.layers) > 1 and is_at_rest(frames)
    if shows_objects(scene, frames, by_object=several or None):
        report("capturing", 0.0)
        taken = np.asarray(take(subject, scene, key=key))
        result = _by_object(taken, scene, frames, chosen, report=_after(report, 0.2))
        simulation = Simulation.of(taken, np.asarray(result.light), None)
        simulation.by_object = result
        return simulation
    if in_plane:
        report("capturing", 0.0)
        taken = take(subject, scene, key=key)
        report("restoring", 0.2)
        result = restore_frames(taken, scene, frames, decoder=chosen)
        report("done", 1.0)
        return Simulation.of(np.asarray(taken), np.asarray(result.light), result.estimate)
    axis, along = scene.sensor.axis, scene.along_rows()
    take = partial(take, scene=along)
    if isinstance(subject, Layers):
        report("exposing", 0.0)
        captured = np.asarray(take(subject.transposed(axis), key=key))
    else:
        image = transposed(as_radiance(subject, "burst_and_restore(subject=...)"), axis)
        captured = np.concatenate(_taken(image, take, key, rows_at_once, report), axis=1)
    restored, estimate, _ = _frames_in_portions(
        captured,
        along,
        frames,
        chosen,
        speed=None,
        rows_at_once=rows_at_once,
        report=lambda text, share: report(text, 0.5 + 0.5 * share),
    )
    report("done", 1.0)
    return Simulation.of(transposed(captured, axis), transposed(restored, axis), estimate)


def _after(report: Progress, share: float) -> Progress:
    """A report of the work that is left when a share of it is done."""
    return lambda text, done: report(text, share + (1 - share) * done)


def _by_object(
    captures: np.ndarray,
    scene: Scene,
    frames: Sequence[TimedFrame] | PlaneFrames,
    decoder: AbstractDecoder,
    *,
    known: Known | None = None,
    report: Progress,
) -> RestoredFrames:
    """Frames restored object by object, whole."""
    known = Known() if known is None else known
    return restore_frames(
        captures,
        scene,
        frames,
        decoder=decoder,
        speed=known.speeds,  # type: ignore[arg-type]
        outlines=known.outlines,
        by_object=True,
        progress=report,
    )


def _taken(
    image: ArrayLike, capture: Callable, key: Array | None, rows_at_once: int, report: Progress
) -> list[np.ndarray]:
    """Captures of a few rows at a time, each with noise of its own."""
    rows, taken = np.asarray(image), []
    for first in range(0, len(rows), rows_at_once):
        report("capturing", 0.5 * first / len(rows))
        own_key = None if key is None else jax.random.fold_in(key, first)
        taken.append(np.asarray(capture(rows[first : first + rows_at_once], key=own_key)))
    return taken


def photograph_by_frames(
    picture: Picture | ArrayLike,
    scene: Scene,
    sequence: FrameSequence,
    *,
    speeds: Sequence[float],  # px/s
    key: Array,
) -> RestoredPhotograph:
    """`restore_photograph` by the frames of a burst, whose speed the decoder finds in them.

    It holds the middle frame as the capture, moved to where the picture stands, and no level that
    is expected of one photograph.
    """
    axis, radiance = scene.sensor.axis, as_radiance(picture, "photograph_by_frames(picture=...)")
    radiance = transposed(radiance[..., None] if radiance.ndim == 2 else radiance, axis)
    reference = behind_optics(np.asarray(radiance), scene)
    captured, restored, doubts, trials = [], [], [], []
    middle = sequence.num_frames // 2
    for index, speed in enumerate(speeds):
        own_key = jax.random.fold_in(key, index)
        result = burst_and_restore(picture, scene, sequence, speed=speed, key=own_key)
        taken = sequence.frames[middle]
        frame, light = (transposed(x, axis) for x in (result.captured[middle], result.restored))
        moved = round(speed * taken.time - taken.position)
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


class Restoration(NamedTuple):
    """A restored capture."""

    light: np.ndarray  # Light of the picture, white = 1; the shape of the capture
    # The speed that was found in it, or told for frames; None where neither was judged
    found: Estimate | None
    by_object: RestoredFrames | None = None  # The frames restored object by object; None of others


def restore(
    capture: Picture | ArrayLike,
    design: AbstractDesign,
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
    design: AbstractDesign,
    *,
    decoder: AbstractDecoder | None = None,
    speed: float | RowLike | Sequence[RowLike] | None = None,
    outlines: np.ndarray | None = None,
    by_object: bool | None = None,
    progress: Progress | None = None,
) -> Restoration:
    """`restore`, with the speed or the objects that were found."""
    exposures = design.exposures
    if design.sequence is not None and (
        outlines is not None or shows_objects(design.scene, exposures.frames, by_object)
    ):
        stack = _stack_of(capture, exposures.num_frames, "rows")
        chosen = decoder_or_ensemble(decoder, "restore")
        result = _by_object(
            stack,
            design.scene,
            exposures.frames,
            chosen,
            known=Known(speed, outlines),  # type: ignore[arg-type]
            report=progress or (lambda text, share: None),
        )
        return Restoration(np.asarray(result.light), None, result)
    words = "be left out for one exposure, of which no objects can be told"
    require(not by_object, "restore(by_object=...)", words, by_object)
    if not isinstance(design, Design):
        stack = _stack_of(capture, exposures.num_frames, "rows")
        result = restore_frames(stack, design.scene, exposures.frames, decoder=decoder, speed=speed)
        return Restoration(np.asarray(result.light), result.estimate)
    scene, motion, shutter = design.scene.along_rows(), design.motion, design.shutter
    axis, chosen = design.scene.sensor.axis, decoder_or_ensemble(decoder, "restore")
    report = progress or (lambda text, share: None)
    if speed is not None:
        require_finite("restore(speed=...)", np.asarray(speed))
        require_scalar("restore(speed=...)", np.asarray(speed))
        speed = float(speed)  # type: ignore[arg-type]
    if design.sequence is not None:
        frames = exposures.frames
        stack = _stack_of(capture, len(frames), axis)
        found = _frames_in_portions(
            stack, scene, frames, chosen, speed=speed, rows_at_once=_ROWS_AT_ONCE, report=report
        )
        return found._replace(light=transposed(found.light, axis))
    pixels = transposed(np.asarray(as_pixels(capture, "restore(capture=...)")), axis)
    model = blur_model(scene, motion, shutter)
    if speed is not None:
        model = model.knowing(speed - float(sensor_view(scene, motion, shutter).velocity))
    elif knowledge_of(scene).knows_speed:  # nobody tells it
        chosen = decoder_of(SPEED_KNOWLEDGE["found"], chosen)
    light, relative = _in_portions(pixels, chosen, model, _ROWS_AT_ONCE, report)
    estimate = None if relative is None else relative.of(scene, motion)
    return Restoration(transposed(light, axis), estimate)


def _stack_of(captures: Picture | ArrayLike, num_frames: int, axis: Axis) -> np.ndarray:
    """The frames of a burst, whose things move along their rows once they are turned."""
    subject = "restore(capture=...)"
    light = np.asarray(as_pixels(captures, subject))
    is_stack = light.ndim in (3, 4) and light.shape[0] == num_frames
    requirement = f"be the {num_frames} frames of the design's burst, of rows and columns"
    require(is_stack, subject, requirement, shape_of(light))
    return np.stack([np.asarray(transposed(one, axis)) for one in light])


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
    for here, around, inner in _portions(num_rows, rows_at_once, beyond, report):
        restored[here] = restored_light(captured[around], decoder, model)[inner]
    return restored, estimate


def _frames_in_portions(
    captured: np.ndarray,
    scene: Scene,
    frames: Sequence[TimedFrame],
    decoder: AbstractDecoder,
    *,
    speed: float | None,
    rows_at_once: int,
    report: Progress,
) -> Restoration:
    """The same of the frames of a burst, whose decoder knows the speed that is found in them."""
    estimate, num_rows = None, captured.shape[1]
    chosen = decoder.inner if isinstance(decoder, SpeedFindingDecoder) else decoder
    if speed is None or len(frames) > 1:
        report("finding the speed" if speed is None else "judging the speed", 0.0)
        estimate = speed_of_frames(captured, scene, frames, speed)
        speed = estimate.speed
    restored = np.empty_like(captured[0])
    for here, around, inner in _portions(num_rows, rows_at_once, chosen.rows_beyond, report):
        restored[here] = picture_at(captured[:, around], scene, frames, chosen, speed)[inner]
    return Restoration(restored, estimate)


def _portions(
    num_rows: int, at_once: int, beyond: int, report: Progress
) -> Iterator[tuple[slice, slice, slice]]:
    """Rows of each portion, those with more around them, and where those begin in these."""
    count = -(-num_rows // at_once)
    if num_rows % 2 and count % 2 == 0:
        count += 1  # the middle row has a portion to be in
    # Portions are of about equal size; a picture that is turned over has the same.
    upper = -(-np.arange(count // 2 + 1) * num_rows // count)
    for first, past in itertools.pairwise(np.union1d(upper, num_rows - upper).tolist()):
        report("restoring", first / num_rows)
        above = min(first, beyond)
        around = slice(first - above, past + beyond)
        yield slice(first, past), around, slice(above, above + past - first)
