"""An object before a background, in one exposure of each of several cameras."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from mishutter._core import as_float
from mishutter.camera import Layer, Layers, fixed_key, simulate_capture
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    Axis,
    Occlusion,
    Picture,
    Scene,
    row_power_spectrum,
    turned,
)
from mishutter.report.photographs import longest_kernel
from mishutter.restore import blur_model, deconvolve, squared_error_in
from mishutter.search import Row

_ROWS, _COLUMNS, _HEIGHT = 128, 336, 104
_OPAQUE = 0.999
"""Opacity from which on a pixel belongs to the object alone."""
_NUM_TIMES = 257
_LEAST_EFFICIENCY = 1e-12
_MOST_OF_BORDERS = 8
"""The columns at either border that are not judged are one in so many at most."""


class LayeredCapture(NamedTuple):
    """One exposure of a background and an object, captured and restored by one filter.

    Attributes:
        exposure: s.
        captured: Light as recorded, over the shutter's efficiency; `(rows, columns, channels)`.
        restored: The estimate of the ensemble filter, which is told no speed and no place.
        expected_psnr: PSNR that this filter is expected to reach of layers with these speeds, this
            share, width and spectrum, whatever their places; linear light, dB.
        psnr: Inside the borders; linear light, dB.
        background_psnr: Where the object never is during the exposure; linear light, dB.
        object_psnr: Where the object alone is, as the decoder places it; linear light, dB.
    """

    exposure: float
    captured: np.ndarray
    restored: np.ndarray
    expected_psnr: float
    psnr: float
    background_psnr: float
    object_psnr: float


class LayeredScene(NamedTuple):
    """A background and an object in front of it, and their speeds.

    Attributes:
        layers: Background and object.
        truth: The scene at mid-exposure; `(rows, columns, channels)`.
        matte: Opacity of the object at mid-exposure; `(rows, columns)`.
    """

    layers: Layers
    truth: np.ndarray
    matte: np.ndarray


def layered_scene(
    picture: Picture, background_speed: float, object_speed: float, axis: Axis = "rows"
) -> LayeredScene:
    """A photograph, and an oval cut from its middle that moves upside down in front of it.

    Both layers have one spectrum, as the layers of a scene have.

    Args:
        picture: The background; its middle is taken.
        background_speed: px/s.
        object_speed: px/s.
        axis: The axis along which it moves; the layers are `turned` to move along their rows.
    """
    whole = turned(picture.light, axis)
    height, width = whole.shape[:2]
    top, left = max(0, (height - _ROWS) // 2), max(0, (width - _COLUMNS) // 2)
    back = whole[top : top + _ROWS, left : left + _COLUMNS]
    size = (
        min(_HEIGHT, max(1, 3 * back.shape[0] // 4)),
        min(4 * _HEIGHT // 3, max(1, back.shape[1] // 2)),
    )
    place = {"left": (back.shape[1] - size[1]) // 2, "top": (back.shape[0] - size[0]) // 2}
    light = back[::-1, ::-1]
    light = light[place["top"] :][: size[0], place["left"] :][:, : size[1]]
    y, x = ((np.arange(n) + 0.5) / n * 2 - 1 for n in size)
    matte = np.clip((1 - np.hypot(y[:, None], x[None])) * min(size) / 2, 0, 1).astype(np.float32)
    layers = Layers(
        (
            Layer(Picture(back), speed=background_speed),
            Layer(Picture(light, matte), speed=object_speed, **place),
        )
    )
    return LayeredScene(layers, *_placed(layers, [0.0, 0.0]))


def layered_captures(
    seen: LayeredScene, scene: Scene, rows: Mapping[str, Row]
) -> dict[str, LayeredCapture]:
    """A layered scene by each design, restored by the filter for a scene.

    Args:
        seen: Background and object.
        scene: The scene that the filters are made for, whose light it is.
        rows: The designs, by name.
    """
    motions = [row.motion for row in rows.values()]
    least_taps = longest_kernel(scene, motions)
    columns = seen.truth.shape[1]
    border = min(least_taps // 4, columns // _MOST_OF_BORDERS)
    judged = slice(border, columns - border)
    world = _world(seen, scene, judged)
    return {
        name: _captured(seen.layers, (scene, world), row.motion, row.shutter, least_taps, judged)
        for name, row in rows.items()
    }


def _world(seen: LayeredScene, scene: Scene, judged: slice) -> Scene:
    """The scene's light on layers with these speeds, share and width, levels and spectrum."""
    back, front = seen.layers.layers
    behind, before = (np.asarray(x.picture.light, np.float64) for x in (back, front))
    opacity = np.asarray(front.matte, np.float64)
    means = np.tensordot(opacity, before, 2) / np.sum(opacity)
    differences = means - np.mean(behind, axis=(0, 1))
    share = float(np.clip(np.mean(seen.matte[:, judged]), 0, 1))
    power = (1 - share) * _power(behind) + share * _power(before)
    occlusion = Occlusion(
        front_share=share,
        object_width=np.sum(opacity) / np.sum(np.any(opacity > 0, axis=1)),
        level_difference=float(np.sqrt(np.mean(differences**2))),
    ).seen_from(as_float(-back.speed))
    numbers = np.mean(seen.truth[:, judged]), np.sqrt(np.mean(power)), power
    return eqx.tree_at(
        lambda s: (s.mean_level, s.deviation, s.power_spectrum, s.occlusion),
        scene.bare(np.array([front.speed], float), np.ones(1)),
        (*(as_float(x) for x in numbers), occlusion),
        is_leaf=lambda part: part is None or isinstance(part, Occlusion),
    )


def _power(light: np.ndarray) -> np.ndarray:
    """Mean power spectrum of the rows of all channels."""
    channels = np.moveaxis(light, 2, 0)[..., None]
    return np.mean([row_power_spectrum(Picture(each)).power_spectrum for each in channels], axis=0)


def _captured(
    layers: Layers,
    scenes: tuple[Scene, Scene],
    motion: AbstractMotion,
    shutter: AbstractShutter,
    least_taps: int,
    judged: slice,
) -> LayeredCapture:
    """A capture by one camera, by the filter for the first scene, expected of the second."""
    scene, world = scenes
    model = blur_model(scene, motion, shutter, least_taps=least_taps)
    light = np.asarray(
        simulate_capture(layers, scene, motion, shutter, key=fixed_key()), np.float64
    )
    restored = np.asarray(deconvolve(light, scene, motion, shutter, model=model))
    speeds = np.array([layer.speed for layer in layers.layers], float)
    truth, matte = _placed(layers, np.asarray(motion.alignment(speeds)).tolist())
    time = np.linspace(-1, 1, _NUM_TIMES) * float(motion.half_exposure)
    way = np.asarray(motion.position(time)) - speeds[1] * time
    swept = _swept(_placed(layers, [0.0, 0.0])[1], float(np.min(way)), float(np.max(way)))
    gain = 1 / max(model.efficiency, _LEAST_EFFICIENCY)
    error = np.mean((restored - truth) ** 2, axis=2)
    expected = squared_error_in(model, blur_model(world, motion, shutter))
    return LayeredCapture(
        exposure=float(motion.exposure),
        captured=light * gain,
        restored=restored,
        expected_psnr=_psnr(np.array([expected])),
        psnr=_psnr(error[:, judged]),
        background_psnr=_psnr(error[:, judged][~swept[:, judged]]),
        object_psnr=_psnr(error[matte > _OPAQUE]),
    )


def _psnr(squared_errors: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean(squared_errors))) if squared_errors.size else np.nan


def _placed(layers: Layers, displacements: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Background and object, each displaced; and the object's matte, `(rows, columns)`."""
    back, front = layers.layers
    light = np.asarray(back.picture.light, np.float64)
    rows = slice(front.top, front.top + front.matte.shape[0])
    columns = slice(front.left, front.left + front.matte.shape[1])
    matte, colour = np.zeros((*light.shape[:2], 1)), np.zeros_like(light)
    matte[rows, columns] = front.matte[..., None]
    colour[rows, columns] = front.picture.light * front.matte[..., None]
    mirrored = np.concatenate([light, light[:, ::-1]], axis=1)
    behind = _displaced(mirrored, displacements[0])[:, : light.shape[1]]
    matte, colour = (_displaced(x, displacements[1]) for x in (matte, colour))
    return behind * (1 - matte) + colour, matte[..., 0]


def _displaced(picture: np.ndarray, distance: float) -> np.ndarray:
    """A picture that repeats itself along its rows, displaced; `(rows, columns, channels)`."""
    columns = picture.shape[1]
    phase = np.exp(-2j * np.pi * np.fft.rfftfreq(columns) * distance)[None, :, None]
    return np.fft.irfft(np.fft.rfft(picture, axis=1) * phase, columns, axis=1)


def _swept(matte: np.ndarray, low: float, high: float) -> np.ndarray:
    """Where a matte is, wherever it is displaced to between two distances."""
    swept = np.zeros(matte.shape, bool)
    columns = matte.shape[1]
    for shift in range(int(np.floor(low)) - 1, int(np.ceil(high)) + 2):
        first, last = max(0, shift), min(columns, columns + shift)
        swept[:, first:last] |= matte[:, first - shift : last - shift] > 0
    return swept
