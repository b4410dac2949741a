"""A photograph captured and restored at every speed, and the quality of the result."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Shaped

from mishutter._core.checks import (
    require,
    require_finite,
    require_key,
    require_positive_int,
    shape_of,
)
from mishutter._core.compiling import compiled
from mishutter._core.parallel import alone_in_blas, in_threads, num_processors
from mishutter.camera.capture import (
    as_radiance,
    blurred_at_speeds,
    distinct_colours,
    kernel_layout,
    noisy,
    through_optics,
)
from mishutter.camera.noise import fixed_key
from mishutter.camera.rows import rows_last
from mishutter.decoding.decoders.base import AbstractDecoder, BlurModel, blur_model
from mishutter.decoding.decoders.linear import (
    decoder_or_ensemble,
    expected_squared_error,
    squared_error_of,
)
from mishutter.decoding.decoders.speed_finding import decoder_of, informed
from mishutter.decoding.deconvolution import restored_light
from mishutter.decoding.image_quality import psnr
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE, SpeedKnowledge
from mishutter.evaluation.views import sensor_view
from mishutter.model.decoder_speeds import DecoderSpeed
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.pictures.images import Axis, Picture, pixels_along, transposed


class RestoredPhotograph(NamedTuple):
    """A photograph captured and restored at several speeds."""

    speeds: Float[np.ndarray, "s"]  # Speeds of the picture; px/s
    # PSNR of gamma-coded values, mean over noise seeds, inside the borders; dB
    psnr: Float[np.ndarray, "s"]
    # The same in linear light: of the mean squared error over seeds; dB
    linear_psnr: Float[np.ndarray, "s"]
    standard_error: Float[np.ndarray, "s"]  # Standard error of `psnr` over the seeds; dB
    linear_standard_error: Float[np.ndarray, "s"]  # That of `linear_psnr`
    mean_psnr: float  # Weighted over speeds: PSNR of the mean squared error, linear light; dB
    # PSNR that the ensemble filter is expected to reach on captures of pictures with the scene's
    # spectrum, over the scene's speeds, if it knows of the speed as much as the scene's
    # `decoder_speed` says; linear light, dB
    expected_psnr: float
    # The same of pictures with the spectrum and the mean of this one, in the columns over which
    # errors are taken, at each speed; it differs from `expected_psnr` as one photograph does from
    # another; dB
    own_expected_psnr: Float[np.ndarray, "s"]
    # The picture as a perfect decoder would restore it
    reference: Float[np.ndarray, "rows columns channels"]
    captured: Float[np.ndarray, "s rows columns channels"]  # Light as recorded, first seed
    restored: Float[np.ndarray, "s rows columns channels"]  # Light restored, first seed
    # Why the speed that was found at each speed is not trusted, first seed; empty where it is, or
    # is not looked for
    doubts: Shaped[np.ndarray, "s"]

    def at(self, *indices: int) -> "RestoredPhotograph":
        """The figures and pictures of one or some of the speeds, alone."""
        names = set(self._fields) - {"mean_psnr", "expected_psnr", "reference"}
        return self._replace(**{name: getattr(self, name)[list(indices)] for name in names})

    def transposed(self, axis: Axis) -> "RestoredPhotograph":
        """The same with pictures that are `transposed` by an axis."""
        names = ("reference", "captured", "restored")
        return self._replace(**{name: transposed(getattr(self, name), axis) for name in names})

    def brightened(self, index: int) -> Float[np.ndarray, "rows columns channels"]:
        """The capture at a speed, as bright as the picture itself, however much light it cost."""
        captured = self.captured[index]
        return captured * (np.mean(self.reference) / max(float(np.mean(captured)), 1e-12))

    def without_pictures(self) -> "RestoredPhotograph":
        """The levels at all speeds, and pictures at none."""
        return self._replace(captured=self.captured[:0].copy(), restored=self.restored[:0].copy())


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
        decoder: The method; the ensemble filter by default. It knows of the speed as much as the
            scene's `decoder_speed` says: it knows it, or is the inner one of a
            `SpeedFindingDecoder`, or is for all speeds.
        speeds: Speeds of the photograph, px/s; the scene's by default.
        num_seeds: Number of captures at each speed, each with its own noise.
        key: JAX key of the noise; a fixed one by default.

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
    chosen = decoder_or_ensemble(decoder, "restore_photograph")
    results = restore_by_each(
        picture, scene, motion, shutter, {"": chosen}, speeds=speeds, num_seeds=num_seeds, key=key
    )
    return results[""]


@alone_in_blas()
def restore_by_each(
    picture: Picture | ArrayLike,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    decoders: Mapping[str, AbstractDecoder],
    *,
    speeds: Sequence[float] | None = None,  # the scene's by default
    num_seeds: int = 8,
    key: Array | None = None,  # a fixed one by default
    least_taps: int = 1,
    decoder_speed: DecoderSpeed | None = None,
) -> dict[str, RestoredPhotograph]:
    """`restore_photograph` by several decoders, from the same captures."""
    require_scene(scene)
    require_positive_int("restore_photograph(num_seeds=...)", num_seeds)
    require_key("restore_photograph(key=...)", key)
    radiance = as_radiance(picture, "restore_photograph(picture=...)")
    radiance = transposed(
        radiance[..., None] if radiance.ndim == 2 else radiance, scene.sensor.axis
    )
    axis, scene = scene.sensor.axis, scene.along_rows()
    chosen_speeds = np.asarray(scene.speeds if speeds is None else speeds, np.float64)
    require_finite("restore_photograph(speeds=...)", chosen_speeds)
    is_row = chosen_speeds.ndim == 1 and chosen_speeds.size > 0
    got = shape_of(chosen_speeds)
    require(is_row, "restore_photograph(speeds=...)", "be one row of at least one speed", got)
    weights = np.asarray(scene.weights) if speeds is None else None
    key = fixed_key() if key is None else key
    scene, motion, shutter, velocity = sensor_view(scene, motion, shutter)
    relative = chosen_speeds - float(velocity)
    window, inner = _common_columns(radiance.shape[-2], motion, relative, least_taps, axis)
    reference = behind_optics(np.asarray(radiance), scene)[:, window]
    model = blur_model(scene, motion, shutter, least_taps=least_taps)
    seeds = np.asarray(_seeds(key, len(chosen_speeds), num_seeds))
    knowledge = SPEED_KNOWLEDGE[scene.decoder_speed if decoder_speed is None else decoder_speed]
    models = [model.knowing(v) if knowledge.is_told else model for v in relative.tolist()]
    methods = [decoder_of(knowledge, decoder) for decoder in decoders.values()]

    captured, *restored = (
        np.empty((len(chosen_speeds), *reference.shape), reference.dtype)
        for _ in range(1 + len(decoders))
    )

    doubts = np.full((len(decoders), len(chosen_speeds)), "", object)

    def tried(place: tuple[int, Array | np.ndarray]) -> _Errors:
        index, blurred = place
        errors, codes = [], []
        for trial, words in enumerate(seeds[index]):
            seed = jax.random.wrap_key_data(words, impl=jax.random.key_impl(key))
            capture = noisy(blurred, scene, motion, seed)
            planes = rows_last(distinct_colours(capture))
            knowing = informed(methods, planes, models[index])
            estimates = [
                np.asarray(restored_light(capture, each, blur)) for each, blur, _ in knowing
            ]
            if trial == 0:
                of_speed = [each.estimate for each in knowing]
                doubts[:, index] = [
                    "" if each is None else each.of(scene, motion).doubt for each in of_speed
                ]
                results = zip((captured, *restored), (capture, *estimates), strict=True)
                for store, result in results:
                    store[index] = result
            judged = errors_of(reference[:, inner], [each[:, inner] for each in estimates])
            errors += [*judged.squared]
            codes += [*judged.coded]
        return _Errors(np.array(errors), np.array(codes))

    on_sensor = blurred_at_speeds(
        radiance, scene, motion, shutter, relative.tolist(), least_taps=least_taps
    )
    count = min(num_processors(), 4)  # each capture holds a picture and its restorations
    trials = list(in_threads(tried, enumerate(on_sensor), count))
    rows = np.moveaxis(reference[:, inner], 1, 2).astype(np.float64)
    expected, own_expected = _expected_levels(model, knowledge, rows, relative)
    return {
        name: RestoredPhotograph(
            *levels_of(chosen_speeds, weights, trials, index),
            expected_psnr=expected,
            own_expected_psnr=own_expected,
            reference=reference,
            captured=captured,
            restored=restored[index],
            doubts=doubts[index],
        ).transposed(axis)
        for index, name in enumerate(decoders)
    }


def _expected_levels(
    model: BlurModel, knowledge: SpeedKnowledge, rows: np.ndarray, speeds: np.ndarray
) -> tuple[float, Float[np.ndarray, "s"]]:
    """Levels that the ensemble filter is expected to reach, for its scene and for one picture; dB.

    A decoder that finds the speed keeps a share of the gain from knowing it, in decibels
    (`found_share`), and none of it where no speed is looked for, as in a snapshot.
    """
    share = float(knowledge.share(np.asarray(model.smear_difference)))
    unknown = np.append(squared_error_of(model, rows, speeds), expected_squared_error(model))
    known = unknown
    if share > 0:
        each = [squared_error_of(model.knowing(v), rows, np.array([v])) for v in speeds.tolist()]
        mean = [expected_squared_error(model.knowing(v)) for v in model.speeds.tolist()]
        known = np.append(np.concatenate(each), model.weights @ np.array(mean))
    with np.errstate(divide="ignore"):
        levels = -10 * np.log10(known**share * unknown ** (1 - share))
    return float(levels[-1]), levels[:-1]


def behind_optics(
    radiance: Float[np.ndarray, "rows columns channels"], scene: Scene
) -> Float[np.ndarray, "rows columns channels"]:
    """The picture behind the scene's optics, as a perfect decoder would restore it."""
    rows = np.moveaxis(radiance, 1, 2)
    return np.moveaxis(through_optics(rows, float(scene.optics.cutoff_frequency)), 2, 1)


@compiled
def _seeds(key: Array, num_speeds: int, num_seeds: int) -> Array:
    """Words of a key for the noise of each capture; `(speeds, seeds, words)`."""
    each = jax.vmap(partial(jax.random.fold_in, key))(jnp.arange(num_speeds))
    return jax.random.key_data(jax.vmap(lambda k: jax.random.split(k, num_seeds))(each))


class _Errors(NamedTuple):
    """Errors at one speed, squared in linear light, and as a PSNR of gamma-coded values."""

    squared: Float[np.ndarray, "seeds decoders"]
    coded: Float[np.ndarray, "seeds decoders"]


def errors_of(truth: np.ndarray, estimates: Sequence[np.ndarray]) -> _Errors:
    """The errors of a capture by several decoders."""
    squared = [np.mean(np.square(each - truth, dtype=np.float64)) for each in estimates]
    coded = [float(psnr(truth, each, gamma=True)) for each in estimates]
    return _Errors(np.array([squared]), np.array([coded]))


def least_columns(num_taps: int) -> int:
    """Least width of a photograph for kernels of a length; px."""
    return num_taps + num_taps // 2 + 15


def _common_columns(
    num_columns: int, motion: AbstractMotion, speeds: np.ndarray, least_taps: int, axis: Axis
) -> tuple[slice, slice]:
    """Columns that are recorded whole at every speed, and those over which errors are taken.

    A camera at rest and a moving one record different columns of the scene by kernels of one
    length. Errors are taken over the columns that both record, and on a path that bends the other
    way over their mirror image.
    """
    num_taps, origin = kernel_layout(motion, *speeds.tolist(), least_taps=least_taps)
    num_recorded = num_columns - num_taps + 1
    enough, subject = least_columns(num_taps), "restore_photograph(picture=...)"
    require(
        num_columns >= enough, subject, f"have at least {enough} {pixels_along(axis)}", num_columns
    )
    half = num_taps // 2
    margin = min(half, (num_recorded - half) // 4)
    first = num_taps - 1 - origin
    begin, end = min(origin, half), min(num_columns - half - first, num_recorded)
    return slice(first, num_columns - origin), slice(begin + margin, end - margin)


class _Levels(NamedTuple):
    """The first fields of a `RestoredPhotograph`."""

    speeds: Float[np.ndarray, "s"]
    psnr: Float[np.ndarray, "s"]
    linear_psnr: Float[np.ndarray, "s"]
    standard_error: Float[np.ndarray, "s"]
    linear_standard_error: Float[np.ndarray, "s"]
    mean_psnr: float


def levels_of(
    speeds: np.ndarray, weights: np.ndarray | None, trials: Sequence[_Errors], decoder: int
) -> _Levels:
    """The levels of a `RestoredPhotograph` by one of the decoders."""
    squared = np.stack([trial.squared[:, decoder] for trial in trials])
    coded = np.stack([trial.coded[:, decoder] for trial in trials])
    count = squared.shape[1]
    mean = np.mean(squared, axis=1)
    share = np.full(len(mean), 1 / len(mean)) if weights is None else weights
    # A picture without an error, as a black one without noise, has an infinite level, whose
    # standard error is no number.
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.std(squared, axis=1, ddof=1) if count > 1 else np.full(len(mean), np.nan)
        coded_spread = np.std(coded, axis=1, ddof=1) if count > 1 else np.full(len(mean), np.nan)
        return _Levels(
            speeds=speeds,
            psnr=np.mean(coded, axis=1),
            linear_psnr=-10 * np.log10(mean),
            standard_error=coded_spread / np.sqrt(count),
            linear_standard_error=10 / np.log(10) * spread / mean / np.sqrt(count),
            mean_psnr=float(-10 * np.log10(share @ mean)),
        )
