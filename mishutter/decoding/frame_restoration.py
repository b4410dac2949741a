r"""One picture from frames at a velocity, by a decoder.

Frames that go on beyond their borders as the likeliest picture does are as good as one capture: of
the density $\rho = \sum_k |A_k|^2/N_k$ they tell $\sum_k \bar A_k\hat g_k/N_k$. Along one axis that
is a capture of the response $\sqrt\rho$ with white noise, of which any decoder of single captures
makes a picture. In the plane decoders with a prior of the plane do.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import as_float, require
from mishutter.camera.capture import kernel_layout
from mishutter.camera.responses import frequencies_on
from mishutter.camera.rows import instants_within_reach
from mishutter.decoding.decoders.base import AbstractDecoder, CompleteFrames, blur_model
from mishutter.decoding.decoders.linear import LEAST_POWER, EnsembleDecoder
from mishutter.decoding.decoders.plug_and_play import Misfit, PlugAndPlayDecoder
from mishutter.decoding.decoders.total_variation import TotalVariationDecoder, advanced
from mishutter.decoding.deconvolution import restored_light
from mishutter.decoding.frame_likelihood import Level, Own, Prior, exposures_of
from mishutter.decoding.likeliest import (
    SETTLED,
    TOLERANCE,
    Likeliest,
    complete,
    electrons_of,
    noises_of,
)
from mishutter.decoding.rolling import RowTimes
from mishutter.model.frame_path import Frames, PlaneFrames, TimedFrame
from mishutter.model.scene import Scene
from mishutter.model.shutters.windows import RectShutter

Decode = Callable[[Likeliest, float], np.ndarray]
"""A method that makes a picture of the likeliest one about a mean level."""


def restored_in_plane(
    planes: Float[np.ndarray, "colours n rows columns"],
    scene: Scene,
    taken: PlaneFrames,
    decode: Decode,
    velocity: Float[np.ndarray, "2"],
    *,
    times: RowTimes,
) -> Float[np.ndarray, "rows columns colours"]:
    """The picture at a velocity."""
    means = np.stack([np.mean(plane) for plane in planes])
    deviations = (planes - means[:, None, None, None]).astype(np.float32)
    every = _likeliest(deviations, scene, taken, velocity, times)[1]
    restored = [
        decode(found, mean)[found.canvas.window] + mean
        for found, mean in zip(every, means.tolist(), strict=True)
    ]
    return np.stack(restored, axis=-1)


def restored_on_axis(
    planes: Float[np.ndarray, "colours n rows columns"],
    scene: Scene,
    taken: Sequence[TimedFrame],
    decoder: AbstractDecoder,
    speed: float,
    *,
    times: RowTimes,
) -> Float[np.ndarray, "rows columns colours"]:
    """The picture at a speed, of frames that are turned so that things move along rows."""
    planes = planes.astype(np.float64)
    rows = np.mean(planes, axis=(1, 3), keepdims=True)
    level, every = _likeliest(planes - rows, scene, taken, np.array([speed]), times)
    canvas, noises = level.canvas, level.canvas.noises
    nodes = [level.instants] if level.rows is None else level.rows.paths.some
    whole = CompleteFrames(nodes, speed, noises)
    density = whole.density(scene.optics, canvas.shape[0])
    told = density if times.is_rolling else None
    data = np.concatenate([complete(found, told) for found in every])
    spectrum = data / np.sqrt(np.maximum(density, LEAST_POWER) * density[0])
    capture = np.moveaxis(canvas.picture(spectrum) + rows[:, 0], 0, -1)
    # The complete frames are as good as one capture of this blur and noise.
    model = blur_model(scene, taken[0].motion, RectShutter())
    electrons = float(np.sum(electrons_of(scene, exposures_of(taken))))
    noise = 1 / float(np.sum(1 / noises))
    read_variance = max(noise - model.mean_level / electrons, 0.0)
    as_one = replace(
        model,
        speeds=np.array([speed]),
        weights=np.ones(1),
        num_taps=max(kernel_layout(one.motion, speed)[0] for one in taken),
        efficiency=1.0,
        electrons=electrons,
        read_noise=electrons * math.sqrt(read_variance),
        complete=whole,
    )
    return np.asarray(restored_light(as_float(capture), decoder, as_one))[:, canvas.window[-1]]


def _likeliest(
    deviations: Float[np.ndarray, "colours n rows columns"],
    scene: Scene,
    taken: Frames,
    velocity: Float[np.ndarray, "axes"],
    times: RowTimes,
) -> tuple[Level, list[Likeliest]]:
    """The likeliest picture of each colour about its level."""
    instants_within_reach("restore_frames(speed=...)", taken, velocity)
    noises = noises_of(scene, exposures_of(taken), float(scene.picture.mean_level))
    own = Own(deviations[0], noises, taken, Prior(scene), times)
    level = own.level(velocity[None])
    first = level.likeliest(velocity[None], TOLERANCE, SETTLED)
    return level, [first, *(first.of(frames) for frames in deviations[1:])]


def method_in_plane(decoder: AbstractDecoder) -> Decode:
    """The method of a decoder, with the responses of the plane."""
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
    canvas, density = found.canvas, found.density[0]
    turns = sum(2 - 2 * np.cos(2 * np.pi * f) for f in frequencies_on(canvas.shape))
    scales = decoder.scales(float(canvas.error(density)))
    smooth = scales.smooth / canvas.power
    smooth[0, 0] = 0.0  # the level is free
    inverse = 1 / (scales.data * density + smooth + turns)
    data = scales.data * complete(found)[0]

    def fitted(edges: Float[np.ndarray, "2 m n"]) -> Float[np.ndarray, "m n"]:
        """The picture of given differences."""
        back = np.sum([np.roll(one, 1, axis) - one for axis, one in enumerate(edges)], axis=0)
        return canvas.picture(inverse * (data + canvas.spectrum(back)))

    picture = found.picture[0]
    state = (picture, _differences(picture), np.zeros((2, *picture.shape), picture.dtype))
    advance = advanced(fitted, _differences, scales.threshold)
    for _ in range(decoder.num_iterations):
        state = advance(state)
    return state[0]


def _differences(picture: np.ndarray) -> Float[np.ndarray, "2 m n"]:
    return np.stack([np.roll(picture, -1, axis) - picture for axis in (0, 1)])


def _by_denoiser(decoder: PlugAndPlayDecoder, found: Likeliest, mean: float) -> np.ndarray:
    """The steps of `PlugAndPlayDecoder`, with the responses of the plane."""
    canvas, density = found.canvas, found.density[0]
    return decoder.steps(
        found.picture[0],
        Misfit(complete(found)[0], density, math.sqrt(canvas.error(density)), mean),
        canvas.spectrum,
        canvas.picture,
    )


_DECODERS: dict[type[AbstractDecoder], Callable[..., np.ndarray]] = {
    EnsembleDecoder: lambda decoder, found, mean: found.picture[0],
    TotalVariationDecoder: _by_total_variation,
    PlugAndPlayDecoder: _by_denoiser,
}
"""Decoders whose prior is one of the plane, and what each makes of frames."""
