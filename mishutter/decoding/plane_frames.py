"""One picture from frames of a sensor that moves in the plane, by any decoder of the plane."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Complex, Float

from mishutter._core.checks import as_float, require
from mishutter.camera.capture import every_colour
from mishutter.camera.plane_frames import frequencies_on, require_reach_in_plane
from mishutter.decoding.decoders.base import AbstractDecoder
from mishutter.decoding.decoders.linear import EnsembleDecoder
from mishutter.decoding.decoders.plug_and_play import PlugAndPlayDecoder
from mishutter.decoding.decoders.speed_finding import SpeedFindingDecoder
from mishutter.decoding.decoders.total_variation import (
    EDGES,
    SMOOTH,
    THRESHOLD,
    TotalVariationDecoder,
)
from mishutter.decoding.plane_likelihood import (
    Level,
    Likeliest,
    Own,
    Prior,
    irfft2,
    likeliest,
    mean_over_plane,
    noises_in_plane,
    rfft2,
)
from mishutter.decoding.plane_velocity import velocity_in_plane
from mishutter.decoding.sequences import RestoredFrames, planes_of
from mishutter.model.scene import Scene
from mishutter.plane.frames import PlaneFrames


def restored_in_plane(
    captures: ArrayLike | Sequence[ArrayLike],
    scene: Scene,
    taken: PlaneFrames,
    decoder: AbstractDecoder,
    velocity: Float[np.ndarray, "2"] | None,
) -> RestoredFrames:
    """`restore_frames` in the plane."""
    decoder = decoder.inner if isinstance(decoder, SpeedFindingDecoder) else decoder
    decode = _DECODERS.get(type(decoder))
    words = (
        "be EnsembleDecoder, TotalVariationDecoder or PlugAndPlayDecoder for frames in the plane"
    )
    require(decode is not None, "restore_frames(decoder=...)", words, type(decoder).__name__)
    light, planes = planes_of(captures, taken.num_frames, "rows")
    planes = np.moveaxis(planes, 0, 1)
    estimate = None
    if velocity is None:
        estimate = velocity_in_plane(planes, scene, taken)
        velocity = estimate.velocity
    require_reach_in_plane("restore_frames(speed=...)", taken, velocity)
    noises = noises_in_plane(scene, taken, float(scene.picture.mean_level))
    restored = []
    for plane in planes:
        mean = plane.dtype.type(np.mean(plane))
        level = Own(plane - mean, noises, taken, Prior(scene)).level(velocity[None])
        found = likeliest(level, velocity)
        picture = decode(decoder, _complete(level, found), float(mean))  # type: ignore[misc]
        restored.append(picture[level.window] + mean)
    result = np.stack(restored, axis=-1)
    result = every_colour(result, light[0]) if light.ndim == 4 else result[..., 0]
    return RestoredFrames(as_float(result), estimate)


class _Complete(NamedTuple):
    r"""Frames that go on beyond their borders, as the misfit of a picture's spectrum has them.

    It is $\tfrac12\sum(\rho|\hat f|^2 - 2\,\Re\,\bar{\hat f}\hat d)$.
    """

    data: Complex[np.ndarray, "m k"]  # $\hat d = \sum_k \bar A_k\hat g_k/N_k$
    density: Float[np.ndarray, "m k"]  # $\rho = \sum_k |A_k|^2/N_k$
    power: Float[np.ndarray, "m k"]
    likeliest: Complex[np.ndarray, "m k"]  # Spectrum of the likeliest picture
    shape: tuple[int, int]

    @property
    def error(self) -> float:
        """Squared error that the likeliest picture is expected to leave."""
        return float(mean_over_plane(self.power / (1 + self.power * self.density), self.shape))


def _complete(level: Level, found: Likeliest) -> _Complete:
    data = np.zeros_like(found.spectrum)
    density = np.zeros(data.shape, level.frames.dtype)
    noises = level.noises.astype(level.frames.dtype)
    for frame, response, noise in zip(level.frames, found.responses, noises, strict=True):
        whole = irfft2(found.spectrum * response, level.shape)
        whole[level.window] = frame
        data += response.conj() * (rfft2(whole) / noise)
        density += np.abs(response) ** 2 / noise
    return _Complete(data, density, level.power, found.spectrum, level.shape)


def _by_ensemble(decoder: AbstractDecoder, frames: _Complete, mean: float) -> np.ndarray:
    """The likeliest picture itself."""
    return irfft2(frames.likeliest, frames.shape)


def _by_total_variation(
    decoder: TotalVariationDecoder, frames: _Complete, mean: float
) -> np.ndarray:
    """The minimum of `TotalVariationDecoder`, with the responses of the plane."""
    error, shape = frames.error, frames.shape
    coupling = EDGES * decoder.strength / THRESHOLD
    scale, threshold = error / coupling, THRESHOLD * math.sqrt(error)
    turns = [2 - 2 * np.cos(2 * np.pi * f) for f in frequencies_on(shape)]
    smooth = SMOOTH * scale / frames.power
    smooth[0, 0] = 0.0  # the level is free
    inverse = 1 / (scale * frames.density + smooth + turns[0][:, None] + turns[1])
    data = scale * frames.data
    picture = irfft2(frames.likeliest, shape)
    split = _differences(picture)
    dual = np.zeros_like(split)
    for _ in range(decoder.num_iterations):
        back = split - dual
        pulled = sum(np.roll(one, 1, axis) - one for axis, one in enumerate(back))
        picture = irfft2(inverse * (data + rfft2(pulled)), shape)
        gap = _differences(picture) + dual
        size = np.sqrt(np.sum(gap**2, axis=0))
        split = gap * np.maximum(1 - threshold / np.maximum(size, 1e-30), 0)
        dual = gap - split
    return picture


def _differences(picture: np.ndarray) -> Float[np.ndarray, "2 m n"]:
    return np.stack([np.roll(picture, -1, axis) - picture for axis in (0, 1)])


def _by_denoiser(decoder: PlugAndPlayDecoder, frames: _Complete, mean: float) -> np.ndarray:
    """The steps of `PlugAndPlayDecoder`, with the responses of the plane."""
    picture = irfft2(frames.likeliest, frames.shape)
    for sigma in (decoder.falling * math.sqrt(frames.error)).tolist():
        weight = decoder.strength / sigma**2
        target = frames.data + weight * rfft2(picture)
        estimate = irfft2(target / (frames.density + weight), frames.shape)
        picture = decoder.denoised(estimate + mean, sigma) - mean
    return picture


_DECODERS: dict[type[AbstractDecoder], Callable[..., np.ndarray]] = {
    EnsembleDecoder: _by_ensemble,
    TotalVariationDecoder: _by_total_variation,
    PlugAndPlayDecoder: _by_denoiser,
}
"""Decoders whose prior is one of the plane, and what each makes of complete frames."""
