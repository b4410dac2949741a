"""Captured pictures become pictures again: all at once, or a few rows at a time."""

import itertools
from collections.abc import Callable, Iterator

import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import as_float, require
from mishutter._core.parallel import alone_in_blas
from mishutter.camera.capture import as_pixels, distinct_colours, every_colour
from mishutter.camera.rows import Planes, channels_last, rows_last
from mishutter.decoding.decoders.base import AbstractDecoder, BlurModel, blur_model
from mishutter.decoding.decoders.linear import decoder_or_ensemble
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.pictures.images import Picture, transposed


@alone_in_blas()
def deconvolve(
    captured: Picture | ArrayLike,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    decoder: AbstractDecoder | None = None,
) -> Float[Array, "..."]:
    """Restore captured pictures by the speeds that may occur in them.

    Args:
        captured: Light in units of a fully open exposure, as `simulate_capture` gives
            it; a `Picture`, or an array of shape `(rows, columns)` or
            `(..., rows, columns, channels)`.
        scene: Speeds that may occur, light, noise, spectrum of pictures.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        decoder: The method, whatever the scene says of decoders; the ensemble filter by default.

    Returns:
        Light of the picture, white = 1; the shape of `captured`. A moving object stays
        displaced by a distance that its speed alone decides.

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
        15.7 dB, 30.0 dB
    """
    require_scene(scene)
    irradiance = transposed(as_pixels(captured, "deconvolve(captured=...)"), scene.sensor.axis)
    chosen = decoder_or_ensemble(decoder, "deconvolve")
    model = blur_model(scene, motion, shutter)
    return as_float(transposed(restored_light(irradiance, chosen, model), scene.sensor.axis))


def restored_light(irradiance: Planes, decoder: AbstractDecoder, model: BlurModel) -> Planes:
    """Light of a picture from its capture: the one road, by which every restoration goes."""
    has_light, subject = model.electrons > 0, "deconvolve(scene=...)"
    require(has_light, subject, "have a photon rate above 0 e-/s", model.electrons)
    planes = as_float(rows_last(distinct_colours(irradiance)))
    restored = decoder.restore(planes, model)
    shape, method = np.shape(restored), f"{type(decoder).__name__}.restore"
    require(shape == planes.shape, method, f"return planes of shape {planes.shape}", shape)
    return every_colour(channels_last(restored, irradiance), irradiance)


def portions(
    num_rows: int,
    at_once: int | None,  # all by default
    beyond: int,
    report: Callable[[str, float], None],
) -> Iterator[tuple[slice, slice, slice]]:
    """Rows of each portion, those with more around them, and where those begin in these."""
    count = 1 if at_once is None else -(-num_rows // at_once)
    if num_rows % 2 and count % 2 == 0:
        count += 1  # the middle row has a portion to be in
    # Portions are of about equal size; a picture that is turned over has the same.
    upper = -(-np.arange(count // 2 + 1) * num_rows // count)
    for first, past in itertools.pairwise(np.union1d(upper, num_rows - upper).tolist()):
        report("restoring", first / num_rows)
        above = min(first, beyond)
        around = slice(first - above, past + beyond)
        yield slice(first, past), around, slice(above, above + past - first)
