"""One picture from frames of a sensor that moves in the plane, by any decoder of the plane."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import require
from mishutter.camera.rows import instants_within_reach
from mishutter.decoding.decoders.base import AbstractDecoder
from mishutter.decoding.decoders.linear import EnsembleDecoder, mean_over_dft
from mishutter.decoding.decoders.plug_and_play import PlugAndPlayDecoder
from mishutter.decoding.decoders.speed_finding import SpeedFindingDecoder
from mishutter.decoding.decoders.total_variation import (
    EDGES,
    SMOOTH,
    THRESHOLD,
    TotalVariationDecoder,
)
from mishutter.decoding.likeliest import Canvas, Likeliest, complete, frequencies_along, noises_of
from mishutter.decoding.plane_likelihood import Own
from mishutter.model.scene import Scene
from mishutter.model.sequences import PlaneFrames

Decode = Callable[[Likeliest, float], np.ndarray]
"""A method that makes a picture of the likeliest one about a mean level."""


def restored_in_plane(
    planes: Float[np.ndarray, "colours frames rows columns"],
    scene: Scene,
    taken: PlaneFrames,
    decode: Decode,
    velocity: Float[np.ndarray, "2"],
) -> Float[np.ndarray, "rows columns colours"]:
    """The picture at a velocity."""
    instants_within_reach("restore_frames(speed=...)", taken, velocity)
    noises = noises_of(scene, taken.exposures, float(scene.picture.mean_level))
    restored = []
    for plane in planes:
        mean = plane.dtype.type(np.mean(plane))
        level = Own.of(plane - mean, noises, taken, scene).level(velocity[None])
        picture = decode(level.likeliest(velocity), float(mean))
        restored.append(picture[level.canvas.window] + mean)
    return np.stack(restored, axis=-1)


def method_in_plane(decoder: AbstractDecoder) -> Decode:
    """The method of a decoder, with the responses of the plane."""
    decoder = decoder.inner if isinstance(decoder, SpeedFindingDecoder) else decoder
    decode = _DECODERS.get(type(decoder))
    words = (
        "be EnsembleDecoder, TotalVariationDecoder or PlugAndPlayDecoder for frames in the plane"
    )
    require(decode is not None, "restore_frames(decoder=...)", words, type(decoder).__name__)
    return partial(decode, decoder)  # type: ignore[arg-type]


def _by_total_variation(
    decoder: TotalVariationDecoder, found: Likeliest, mean: float
) -> np.ndarray:
    """The minimum of `TotalVariationDecoder`, with the responses of the plane."""
    canvas, data, density = found.canvas, complete(found), found.density
    error = _error(canvas, density)
    coupling = EDGES * decoder.strength / THRESHOLD
    scale, threshold = error / coupling, THRESHOLD * math.sqrt(error)
    turns = sum(2 - 2 * np.cos(2 * np.pi * f) for f in frequencies_along(canvas.shape))
    smooth = SMOOTH * scale / canvas.power
    smooth[0, 0] = 0.0  # the level is free
    inverse = 1 / (scale * density + smooth + turns)
    data, picture = scale * data, found.picture
    split = _differences(picture)
    dual = np.zeros_like(split)
    for _ in range(decoder.num_iterations):
        back = split - dual
        pulled = np.sum([np.roll(one, 1, axis) - one for axis, one in enumerate(back)], axis=0)
        picture = canvas.picture(inverse * (data + canvas.spectrum(pulled)))
        gap = _differences(picture) + dual
        size = np.sqrt(np.sum(gap**2, axis=0))
        split = gap * np.maximum(1 - threshold / np.maximum(size, 1e-30), 0)
        dual = gap - split
    return picture


def _error(canvas: Canvas, density: Float[np.ndarray, "m k"]) -> float:
    """Squared error that the likeliest picture is expected to leave."""
    return float(mean_over_dft(canvas.power / (1 + canvas.power * density), *canvas.shape))


def _differences(picture: np.ndarray) -> Float[np.ndarray, "2 m n"]:
    return np.stack([np.roll(picture, -1, axis) - picture for axis in (0, 1)])


def _by_denoiser(decoder: PlugAndPlayDecoder, found: Likeliest, mean: float) -> np.ndarray:
    """The steps of `PlugAndPlayDecoder`, with the responses of the plane."""
    canvas, picture, data, density = found.canvas, found.picture, complete(found), found.density
    error = _error(canvas, density)
    for sigma in (decoder.falling * math.sqrt(error)).tolist():
        weight = decoder.strength / sigma**2
        target = data + weight * canvas.spectrum(picture)
        estimate = canvas.picture(target / (density + weight))
        picture = decoder.denoised(estimate + mean, sigma) - mean
    return picture


_DECODERS: dict[type[AbstractDecoder], Callable[..., np.ndarray]] = {
    EnsembleDecoder: lambda decoder, found, mean: found.picture,
    TotalVariationDecoder: _by_total_variation,
    PlugAndPlayDecoder: _by_denoiser,
}
"""Decoders whose prior is one of the plane, and what each makes of frames."""
