"""A photograph through the camera and back, at every speed, and how good it came out."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter.decoders import AbstractDecoder, BlurModel, EnsembleDecoder, blur_model
from mishutter.motion import AbstractMotion
from mishutter.picture_plan import distinct_colours, every_colour, skips
from mishutter.pictures import Picture
from mishutter.plan import PLANNED, Automatic, Plan
from mishutter.quality import psnr
from mishutter.rows import channels_last, rows_last
from mishutter.scene import Scene
from mishutter.shutters.base import AbstractShutter
from mishutter.simulate import as_light, captured_columns, kernel_layout, noisy, simulate_capture
from mishutter.types import require, require_positive_int


class RestoredPhotograph(NamedTuple):
    """A photograph captured and restored at several speeds.

    Attributes:
        speeds: px/s; shape `(s,)`.
        psnr: PSNR with gamma put back, mean over noise seeds, inside the borders; dB,
            shape `(s,)`.
        linear_psnr: The same in linear light: of the mean squared error over seeds; dB.
        standard_error: Standard error of `psnr` over the seeds; dB.
        linear_standard_error: That of `linear_psnr`.
        mean_psnr: Weighted over speeds: PSNR of the mean squared error, linear light; dB.
        reference: What a perfect decoder would have found; `(rows, columns, channels)`.
        captured: Light as recorded, first seed; shape `(s, rows, columns, channels)`.
        restored: Light restored, first seed; the same shape.
    """

    speeds: np.ndarray
    psnr: np.ndarray
    linear_psnr: np.ndarray
    standard_error: np.ndarray
    linear_standard_error: np.ndarray
    mean_psnr: float
    reference: np.ndarray
    captured: np.ndarray
    restored: np.ndarray


def deconvolve(
    captured: ArrayLike,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    decoder: AbstractDecoder | None = None,
    model: BlurModel | None = None,
    plan: Plan | Automatic | None = PLANNED,
) -> Array:
    """Restore captured pictures, without knowing how fast anything in them moved.

    Args:
        captured: Light in units of a fully open exposure, as `simulate_capture` gives
            it; shape `(rows, columns)` or `(..., rows, columns, channels)`.
        scene: Speeds that may occur, light, noise, spectrum of pictures.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        decoder: How; the ensemble filter by default.
        model: What `blur_model` gives for these, if it is at hand.
        plan: What to compute: by default equal colours once; None for everything.

    Returns:
        Light of the picture, white = 1; the shape of `captured`. A moving object stays
        displaced by what its speed alone decides.

    Raises:
        ValueError: if `captured` is not finite or not a picture.
    """
    light = as_light(captured)
    chosen = EnsembleDecoder() if decoder is None else decoder
    known = blur_model(scene, motion, shutter, plan=plan) if model is None else model
    distinct = distinct_colours(light, plan)
    restored = channels_last(chosen.restore(rows_last(distinct), known), light)
    return every_colour(restored, light)


def restore_photograph(
    picture: Picture | ArrayLike,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    decoder: AbstractDecoder | None = None,
    speeds: Sequence[float] | None = None,
    num_seeds: int = 8,
    key: Array | None = None,
    plan: Plan | Automatic | None = PLANNED,
) -> RestoredPhotograph:
    """Capture a photograph at several speeds and restore it.

    The photograph is the scene: the sensor sees the part of it to which light can come
    from outside, so that its borders are real. Pixels nearer to a border than half a
    kernel are restored but not judged.

    Args:
        picture: The photograph.
        scene: Light and noise, and what the decoder may know.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        decoder: How to restore; the ensemble filter by default.
        speeds: px/s; the scene's by default.
        num_seeds: How many captures, each with its own noise.
        key: JAX key of the noise; a fixed one by default.
        plan: What to compute: by default a blur once for all its captures; None for
            everything.

    Raises:
        ValueError: if the picture is too narrow for its blur, or an argument is out of
            its range.
    """
    require_positive_int("restore_photograph(num_seeds=...)", num_seeds)
    light = as_light(picture)
    light = light[..., None] if light.ndim == 2 else light
    chosen_speeds = np.asarray(scene.speeds if speeds is None else speeds, np.float64)
    weights = np.asarray(scene.weights) if speeds is None else None
    key = jax.random.key(0) if key is None else key
    window, margin = _common_columns(light.shape[-2], motion, chosen_speeds, scene)
    reference = np.asarray(light[:, window])
    model = blur_model(scene, motion, shutter, plan=plan)
    results = []
    for index, speed in enumerate(chosen_speeds.tolist()):
        keys = jax.random.split(jax.random.fold_in(key, index), num_seeds)
        own = captured_columns(motion, shutter, speed, light.shape[-2])
        cut = slice(window.start - own.start, window.stop - own.start)
        squared, coded = [], []
        first = None
        capture = partial(
            simulate_capture, light, scene, motion, shutter, speed=speed, border="scene", plan=plan
        )
        blurred = capture() if skips(plan) else None
        for seed in keys:
            if blurred is None:
                g = capture(key=seed)[:, cut]
            else:
                g = noisy(blurred, scene, motion, seed)[:, cut]
            found = deconvolve(g, scene, motion, shutter, decoder=decoder, model=model, plan=plan)
            inner = slice(margin, reference.shape[1] - margin)
            error = np.asarray(found)[:, inner] - reference[:, inner]
            squared.append(float(np.mean(np.square(error, dtype=np.float64))))
            coded.append(psnr(reference[:, inner], found[:, inner]))
            first = (np.asarray(g), np.asarray(found)) if first is None else first
        results.append((squared, coded, first))
    return _summary(chosen_speeds, weights, reference, results)


def _common_columns(
    num_columns: int, motion: AbstractMotion, speeds: np.ndarray, scene: Scene
) -> tuple[slice, int]:
    """Columns that are recorded whole at every speed, and how many at each end to leave."""
    num_taps, origin = kernel_layout(motion, *speeds.tolist())
    left = num_columns - num_taps + 1
    enough = left >= num_taps // 2 + 16
    subject = "restore_photograph(picture=...)"
    require(enough, subject, f"have at least {num_taps + num_taps // 2 + 15} columns", num_columns)
    margin = min(num_taps // 2, left // 4)
    return slice(num_taps - 1 - origin, num_columns - origin), margin


def _summary(speeds, weights, reference, results) -> RestoredPhotograph:
    squared = np.array([r[0] for r in results])
    coded = np.array([r[1] for r in results])
    count = squared.shape[1]
    mean = np.mean(squared, axis=1)
    spread = np.std(squared, axis=1, ddof=1) if count > 1 else np.full(len(mean), np.nan)
    coded_spread = np.std(coded, axis=1, ddof=1) if count > 1 else np.full(len(mean), np.nan)
    share = np.full(len(mean), 1 / len(mean)) if weights is None else weights
    return RestoredPhotograph(
        speeds=speeds,
        psnr=np.mean(coded, axis=1),
        linear_psnr=-10 * np.log10(mean),
        standard_error=coded_spread / np.sqrt(count),
        linear_standard_error=10 / np.log(10) * spread / mean / np.sqrt(count),
        mean_psnr=float(-10 * np.log10(share @ mean)),
        reference=reference,
        captured=np.stack([r[2][0] for r in results]),
        restored=np.stack([r[2][1] for r in results]),
    )
