"""A photograph through the camera and back, at every speed, and how good it came out."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import (
    alone_in_blas,
    as_float,
    compiled,
    in_threads,
    num_processors,
    require,
    require_finite,
    require_key,
    require_positive_int,
    shape_of,
)
from mishutter.camera import (
    as_light,
    as_pixels,
    blurred_at_speeds,
    channels_last,
    distinct_colours,
    every_colour,
    fixed_key,
    kernel_layout,
    noisy,
    rows_last,
    through_optics,
)
from mishutter.evaluation import PLANNED, Automatic, Plan, sensor_view
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    Axis,
    Picture,
    Scene,
    pixels_along,
    require_scene,
    turned,
)
from mishutter.restore.decoders import AbstractDecoder, BlurModel, EnsembleDecoder, blur_model
from mishutter.restore.decoders.linear import expected_squared_error, squared_error_of
from mishutter.restore.image_quality import psnr

_CAPTURES_AT_ONCE = 4
"""At most: each holds a picture and what every decoder made of it."""


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
        expected_psnr: PSNR that the ensemble filter is expected to reach on captures of pictures
            with the scene's spectrum, over the scene's speeds; linear light, dB.
        own_expected_psnr: The same of pictures with the spectrum and the mean of this one, where it
            is judged, at each speed: what is left between it and `expected_psnr` is that one
            photograph is not another; dB, shape `(s,)`.
        reference: The picture that a perfect decoder would find; `(rows, columns, channels)`.
        captured: Light as recorded, first seed; shape `(s, rows, columns, channels)`.
        restored: Light restored, first seed; the same shape.
    """

    speeds: np.ndarray
    psnr: np.ndarray
    linear_psnr: np.ndarray
    standard_error: np.ndarray
    linear_standard_error: np.ndarray
    mean_psnr: float
    expected_psnr: float
    own_expected_psnr: np.ndarray
    reference: np.ndarray
    captured: np.ndarray
    restored: np.ndarray

    def at(self, *indices: int) -> "RestoredPhotograph":
        """The figures and pictures of one or some of the speeds, alone.

        Args:
            indices: Places of the speeds.
        """
        each = {name: getattr(self, name)[list(indices)] for name in _AT_EACH_SPEED}
        return self._replace(**each)

    def turned(self, axis: Axis) -> "RestoredPhotograph":
        """The same with pictures that are `turned` by an axis.

        Args:
            axis: The axis along which things move.
        """
        names = ("reference", "captured", "restored")
        return self._replace(**{name: turned(getattr(self, name), axis) for name in names})

    def without_pictures(self) -> "RestoredPhotograph":
        """The levels at all speeds, and pictures at none."""
        return self._replace(captured=self.captured[:0].copy(), restored=self.restored[:0].copy())


_AT_EACH_SPEED = (
    "speeds",
    "psnr",
    "linear_psnr",
    "standard_error",
    "linear_standard_error",
    "own_expected_psnr",
    "captured",
    "restored",
)


@alone_in_blas()
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
        model: The result of `blur_model` for these, if it is at hand.
        plan: The parts to compute: by default equal colours once; None for all.

    Returns:
        Light of the picture, white = 1; the shape of `captured`. A moving object stays
        displaced by what its speed alone decides.

    Raises:
        ValueError: if `captured` is not finite or not a picture, or the scene has no light.

    Examples:
        >>> import jax
        >>> from mishutter import HannShutter, ParabolicMotion, Scene, deconvolve, example_picture
        >>> from mishutter import psnr, simulate_capture
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=5)
        >>> motion = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
        >>> picture = example_picture()
        >>> captured = simulate_capture(
        ...     picture, scene, motion, HannShutter(), speed=700.0, key=jax.random.key(0)
        ... )
        >>> restored = deconvolve(captured, scene, motion, HannShutter())
        >>> print(f"{psnr(picture.light, captured):.1f} dB, {psnr(picture.light, restored):.1f} dB")
        16.7 dB, 26.9 dB
    """
    require_scene(scene)
    light = turned(as_pixels(captured, "deconvolve(captured=...)"), scene.axis)
    chosen = EnsembleDecoder() if decoder is None else decoder
    right = isinstance(chosen, AbstractDecoder)
    require(right, "deconvolve(decoder=...)", "be a decoder", decoder)
    known = blur_model(scene, motion, shutter, plan=plan) if model is None else model
    lit, subject = known.electrons > 0, "deconvolve(scene=...)"
    require(lit, subject, "have a photon rate above 0 e-/s", known.electrons)
    distinct = distinct_colours(light, plan)
    restored = channels_last(chosen.restore(as_float(rows_last(distinct)), known), light)
    return as_float(turned(every_colour(restored, light), scene.axis))


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
    kernel are restored but not judged, nor are those that a camera at rest and a moving one
    would not both record.

    Args:
        picture: The photograph.
        scene: Light and noise, and what the decoder may know.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        decoder: How to restore; the ensemble filter by default.
        speeds: px/s; the scene's by default.
        num_seeds: How many captures, each with its own noise.
        key: JAX key of the noise; a fixed one by default.
        plan: The parts to compute: by default equal colours once; None for all.

    Raises:
        ValueError: if the picture is too narrow for its blur, or an argument is out of
            its range.

    Examples:
        >>> from mishutter import HannShutter, ParabolicMotion, Scene, example_picture
        >>> from mishutter import restore_photograph
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=5)
        >>> motion = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
        >>> camera, speeds = (scene, motion, HannShutter()), [0.0, 1500.0]
        >>> found = restore_photograph(example_picture(), *camera, speeds=speeds, num_seeds=1)
        >>> print([f"{level:.0f} dB" for level in found.linear_psnr])
        ['29 dB', '27 dB']
    """
    chosen = EnsembleDecoder() if decoder is None else decoder
    options = {"speeds": speeds, "num_seeds": num_seeds, "key": key, "plan": plan}
    return restore_by_each(picture, scene, motion, shutter, {"": chosen}, **options)[""]


@alone_in_blas()
def restore_by_each(
    picture: Picture | ArrayLike,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    decoders: Mapping[str, AbstractDecoder],
    *,
    speeds: Sequence[float] | None = None,
    num_seeds: int = 8,
    key: Array | None = None,
    plan: Plan | Automatic | None = PLANNED,
    least_taps: int = 1,
) -> dict[str, RestoredPhotograph]:
    """`restore_photograph` by several decoders, from the same captures.

    Args:
        picture: The photograph.
        scene: Light and noise, and what the decoders may know.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        decoders: How to restore, by name.
        speeds: px/s; the scene's by default.
        num_seeds: How many captures, each with its own noise.
        key: JAX key of the noise; a fixed one by default.
        plan: The parts to compute, as for `restore_photograph`.
        least_taps: Length of the kernels, where they do not need more: with one for several
            designs they see, and are judged on, equally many columns.

    Raises:
        ValueError: as `restore_photograph`.
    """
    require_scene(scene)
    require_positive_int("restore_photograph(num_seeds=...)", num_seeds)
    require_key("restore_photograph(key=...)", key)
    light = as_light(picture, "restore_photograph(picture=...)")
    light = turned(light[..., None] if light.ndim == 2 else light, scene.axis)
    axis, scene = scene.axis, scene.along_rows()
    chosen_speeds = np.asarray(scene.speeds if speeds is None else speeds, np.float64)
    require_finite("restore_photograph(speeds=...)", chosen_speeds)
    row = chosen_speeds.ndim == 1 and chosen_speeds.size > 0
    got = shape_of(chosen_speeds)
    require(row, "restore_photograph(speeds=...)", "be one row of at least one speed", got)
    weights = np.asarray(scene.weights) if speeds is None else None
    key = fixed_key() if key is None else key
    scene, motion, shutter, velocity = sensor_view(scene, motion, shutter)
    relative = chosen_speeds - float(velocity)
    window, inner = _common_columns(light.shape[-2], motion, relative, least_taps, axis)
    reference = _seen_by_optics(np.asarray(light), scene)[:, window]
    model = blur_model(scene, motion, shutter, plan=plan, least_taps=least_taps)
    seeds = np.asarray(_seeds(key, len(chosen_speeds), num_seeds))

    captured, *restored = (
        np.empty((len(chosen_speeds), *reference.shape), reference.dtype)
        for _ in range(1 + len(decoders))
    )

    def tried(place: tuple[int, Array | np.ndarray]) -> _Errors:
        index, blurred = place
        errors, codes = [], []
        for trial, words in enumerate(seeds[index]):
            seed = jax.random.wrap_key_data(words, impl=jax.random.key_impl(key))
            capture = noisy(blurred, scene, motion, seed)
            found = [
                np.asarray(
                    deconvolve(
                        capture, scene, motion, shutter, decoder=decoder, model=model, plan=plan
                    )
                )
                for decoder in decoders.values()
            ]
            if trial == 0:
                for kept, light in zip((captured, *restored), (capture, *found), strict=True):
                    kept[index] = light
            pairs = [(reference[:, inner], estimate[:, inner]) for estimate in found]
            errors.append([np.mean(np.square(b - a, dtype=np.float64)) for a, b in pairs])
            codes.append([psnr(truth, estimate) for truth, estimate in pairs])
        return _Errors(np.array(errors), np.array(codes))

    on_sensor = blurred_at_speeds(
        light, scene, motion, shutter, relative.tolist(), plan, least_taps
    )
    count = min(num_processors(), _CAPTURES_AT_ONCE)
    trials = list(in_threads(tried, enumerate(on_sensor), count))
    with np.errstate(divide="ignore"):
        expected = float(-10 * np.log10(expected_squared_error(model)))
        rows = np.moveaxis(reference[:, inner], 1, 2).astype(np.float64)
        own_expected = -10 * np.log10(squared_error_of(model, rows, relative))
    return {
        name: RestoredPhotograph(
            **_levels(chosen_speeds, weights, trials, index),
            expected_psnr=expected,
            own_expected_psnr=own_expected,
            reference=reference,
            captured=captured,
            restored=restored[index],
        ).turned(axis)
        for index, name in enumerate(decoders)
    }


def _seen_by_optics(light: np.ndarray, scene: Scene) -> np.ndarray:
    """What a perfect decoder would find of a picture `(rows, columns, channels)`."""
    rows = np.moveaxis(light, 1, 2)
    return np.moveaxis(through_optics(rows, float(scene.cutoff_frequency)), 2, 1)


@compiled
def _seeds(key: Array, num_speeds: int, num_seeds: int) -> Array:
    """Words of a key for the noise of each capture; `(speeds, seeds, words)`."""
    each = jax.vmap(partial(jax.random.fold_in, key))(jnp.arange(num_speeds))
    return jax.random.key_data(jax.vmap(lambda k: jax.random.split(k, num_seeds))(each))


class _Errors(NamedTuple):
    """Errors at one speed, squared in linear light, and as a PSNR with gamma put back.

    Of shape `(seeds, decoders)`.
    """

    squared: np.ndarray
    coded: np.ndarray


def least_columns(num_taps: int) -> int:
    """How wide a photograph must be for kernels of a length."""
    return num_taps + num_taps // 2 + 15


def _common_columns(
    num_columns: int, motion: AbstractMotion, speeds: np.ndarray, least_taps: int, axis: Axis
) -> tuple[slice, slice]:
    """Columns that are recorded whole at every speed, and which of those to judge.

    A camera at rest and a moving one record different columns of the scene by kernels of one
    length. Judged are those that both do.
    """
    num_taps, origin = kernel_layout(motion, *speeds.tolist(), least_taps=least_taps)
    left = num_columns - num_taps + 1
    enough, subject = least_columns(num_taps), "restore_photograph(picture=...)"
    require(
        num_columns >= enough, subject, f"have at least {enough} {pixels_along(axis)}", num_columns
    )
    margin = min(num_taps // 2, (left - num_taps // 2) // 4)
    first = num_taps - 1 - origin
    judged = slice(origin + margin, num_columns - num_taps // 2 - margin - first)
    return slice(first, num_columns - origin), judged


def _levels(
    speeds: np.ndarray, weights: np.ndarray | None, trials: Sequence[_Errors], decoder: int
) -> dict[str, Any]:
    """The figures of a `RestoredPhotograph` by one of the decoders."""
    squared = np.stack([trial.squared[:, decoder] for trial in trials])
    coded = np.stack([trial.coded[:, decoder] for trial in trials])
    count = squared.shape[1]
    mean = np.mean(squared, axis=1)
    spread = np.std(squared, axis=1, ddof=1) if count > 1 else np.full(len(mean), np.nan)
    coded_spread = np.std(coded, axis=1, ddof=1) if count > 1 else np.full(len(mean), np.nan)
    share = np.full(len(mean), 1 / len(mean)) if weights is None else weights
    return {
        "speeds": speeds,
        "psnr": np.mean(coded, axis=1),
        "linear_psnr": -10 * np.log10(mean),
        "standard_error": coded_spread / np.sqrt(count),
        "linear_standard_error": 10 / np.log(10) * spread / mean / np.sqrt(count),
        "mean_psnr": float(-10 * np.log10(share @ mean)),
    }
