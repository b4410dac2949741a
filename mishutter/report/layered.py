"""An object before a background: one exposure by each of several cameras."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from mishutter._core.checks import as_float
from mishutter.camera.capture import simulate_capture
from mishutter.camera.layers import Layer, Layers
from mishutter.camera.noise import fixed_key
from mishutter.decoding.decoders.base import blur_model
from mishutter.decoding.decoders.linear import EnsembleDecoder, squared_error_in
from mishutter.decoding.restoration import restored_light
from mishutter.design.design import Design
from mishutter.model.occlusion import Occlusion
from mishutter.model.scene import Scene
from mishutter.pictures.images import Axis, Picture, row_power_spectrum, transposed
from mishutter.report.restored import longest_kernel
from mishutter.search.rows import Row

_ROWS, _COLUMNS, _HEIGHT = 128, 336, 104


class LayeredCapture(NamedTuple):
    """One exposure of a background and an object, captured and restored by one filter."""

    exposure: float  # Length of the exposure; s
    # The recorded irradiance over the shutter's efficiency
    captured: Float[np.ndarray, "rows columns channels"]
    # The estimate of the ensemble filter, which knows neither speed nor position
    restored: Float[np.ndarray, "rows columns channels"]
    # PSNR that this filter is expected to reach for layers with these speeds, this share, width and
    # spectrum, at random places; linear light, dB
    expected_psnr: float
    psnr: float  # PSNR inside the borders; linear light, dB
    background_psnr: float  # PSNR of the pixels that the object never covers; linear light, dB
    object_psnr: float  # PSNR of the pixels that the object alone covers; linear light, dB

    def transposed(self, axis: Axis) -> "LayeredCapture":
        """The same with pictures whose rows and columns are exchanged, unless `axis` is rows."""
        captured, restored = transposed(self.captured, axis), transposed(self.restored, axis)
        return self._replace(captured=captured, restored=restored)


class LayeredScene(NamedTuple):
    """A background and an object in front of it, and their speeds."""

    layers: Layers  # Background and object
    truth: Float[np.ndarray, "rows columns channels"]  # The scene at mid-exposure
    matte: Float[np.ndarray, "rows columns"]  # Opacity of the object at mid-exposure

    def transposed(self, axis: Axis) -> "LayeredScene":
        """The same with rows and columns exchanged, unless things move along its rows."""
        truth, matte = transposed(self.truth, axis), transposed(self.matte, axis)
        return LayeredScene(self.layers.transposed(axis), truth, matte)


def layered_scene(picture: Picture, background_speed: float, object_speed: float) -> LayeredScene:
    """A photograph, and an oval cut from its middle that moves upside down in front of it.

    Both layers have one spectrum, as the layers of a scene have.
    """
    whole = picture.light
    height, width = whole.shape[:2]
    first_row, first_column = max(0, (height - _ROWS) // 2), max(0, (width - _COLUMNS) // 2)
    back = whole[first_row : first_row + _ROWS, first_column : first_column + _COLUMNS]
    size = (
        min(_HEIGHT, max(1, 3 * back.shape[0] // 4)),
        min(4 * _HEIGHT // 3, max(1, back.shape[1] // 2)),
    )
    row, column = (back.shape[0] - size[0]) // 2, (back.shape[1] - size[1]) // 2
    front = back[::-1, ::-1][row : row + size[0], column : column + size[1]]
    y, x = ((np.arange(n) + 0.5) / n * 2 - 1 for n in size)
    matte = np.clip((1 - np.hypot(y[:, None], x[None])) * min(size) / 2, 0, 1).astype(np.float32)
    layers = Layers(
        (
            Layer(Picture(back), speed=background_speed),
            Layer(Picture(front, matte), speed=object_speed, left=column, top=row),
        )
    )
    return LayeredScene(layers, *_placed(layers, [0.0, 0.0]))


def layered_captures(
    subject: LayeredScene, scene: Scene, cameras: Mapping[str, Row | Design]
) -> dict[str, LayeredCapture]:
    """Captures a layered scene by each design, and restores it by the filter for a scene."""
    layers = subject.layers
    speeds = np.array([layer.speed for layer in layers.layers], float)
    # Kernels of one length let the cameras share compiled programs.
    least_taps = longest_kernel(scene, [each.motion for each in cameras.values()])
    columns = subject.truth.shape[1]
    border = min(least_taps // 4, columns // 8)
    judged = slice(border, columns - border)  # what the PSNR is of
    world = _world(subject, scene, judged)
    captures = {}
    for name, camera in cameras.items():
        motion, shutter = camera.motion, camera.shutter
        model = blur_model(scene, motion, shutter, least_taps=least_taps)
        recorded = np.asarray(
            simulate_capture(layers, scene, motion, shutter, key=fixed_key()), np.float64
        )
        restored = np.asarray(restored_light(recorded, EnsembleDecoder(), model))
        truth, matte = _placed(layers, np.asarray(motion.alignment(speeds)).tolist())
        time = np.linspace(-1, 1, 257) * float(motion.half_exposure)
        path = np.asarray(motion.position(time)) - speeds[1] * time
        swept = _swept(subject.matte, float(np.min(path)), float(np.max(path)))
        error = np.mean((restored - truth) ** 2, axis=2)
        expected = squared_error_in(model, blur_model(world, motion, shutter))
        captures[name] = LayeredCapture(
            exposure=float(motion.exposure),
            captured=recorded * (1 / max(model.efficiency, 1e-12)),
            restored=restored,
            expected_psnr=_psnr(np.array([expected])),
            psnr=_psnr(error[:, judged]),
            background_psnr=_psnr(error[:, judged][~swept[:, judged]]),
            object_psnr=_psnr(error[matte > 0.999]),  # opaque
        )
    return captures


def _world(subject: LayeredScene, scene: Scene, judged: slice) -> Scene:
    """A scene's photons and noise with the speeds, share, width, levels and spectrum of layers."""
    back, front = subject.layers.layers
    behind, before = (np.asarray(x.picture.light, np.float64) for x in (back, front))
    opacity = np.asarray(front.matte, np.float64)
    means = np.tensordot(opacity, before, 2) / np.sum(opacity)
    differences = means - np.mean(behind, axis=(0, 1))
    share = float(np.clip(np.mean(subject.matte[:, judged]), 0, 1))
    power = (1 - share) * _power(behind) + share * _power(before)
    occlusion = Occlusion(
        front_share=share,
        object_width=np.sum(opacity) / np.sum(np.any(opacity > 0, axis=1)),
        level_difference=float(np.sqrt(np.mean(differences**2))),
    ).in_sensor_frame(as_float(-back.speed))
    numbers = np.mean(subject.truth[:, judged]), np.sqrt(np.mean(power)), power

    def parts(s: Scene) -> tuple[object, ...]:
        return s.picture.mean_level, s.picture.deviation, s.picture.power_spectrum, s.occlusion

    return eqx.tree_at(
        parts,
        scene.without_metadata(np.array([front.speed], float), np.ones(1)),
        (*(as_float(x) for x in numbers), occlusion),
        is_leaf=lambda part: part is None or isinstance(part, Occlusion),
    )


def _power(
    picture: Float[np.ndarray, "rows columns channels"],
) -> Float[np.ndarray, "frequencies"]:
    """Mean power spectrum of the rows of all channels."""
    channels = np.moveaxis(picture, 2, 0)[..., None]
    return np.mean([row_power_spectrum(Picture(each)).power_spectrum for each in channels], axis=0)


def _psnr(squared_errors: Float[np.ndarray, "..."]) -> float:
    """PSNR of some pixels, NaN without any; dB."""
    return float(-10 * np.log10(np.mean(squared_errors))) if squared_errors.size else np.nan


def _placed(
    layers: Layers, displacements: Sequence[float]
) -> tuple[Float[np.ndarray, "rows columns channels"], Float[np.ndarray, "rows columns"]]:
    """The picture of background and object, each displaced, and the object's matte; px."""
    back, front = layers.layers
    ground = np.asarray(back.picture.light, np.float64)
    rows = slice(front.top, front.top + front.matte.shape[0])
    columns = slice(front.left, front.left + front.matte.shape[1])
    matte, colour = np.zeros((*ground.shape[:2], 1)), np.zeros_like(ground)
    matte[rows, columns] = front.matte[..., None]
    colour[rows, columns] = front.picture.light * front.matte[..., None]
    mirrored = np.concatenate([ground, ground[:, ::-1]], axis=1)
    behind = _displaced(mirrored, displacements[0])[:, : ground.shape[1]]
    matte, colour = (_displaced(x, displacements[1]) for x in (matte, colour))
    return behind * (1 - matte) + colour, matte[..., 0]


def _displaced(
    picture: Float[np.ndarray, "rows columns channels"], distance: float
) -> Float[np.ndarray, "rows columns channels"]:
    """Displaces a picture that is periodic along its rows; px."""
    columns = picture.shape[1]
    phase = np.exp(-2j * np.pi * np.fft.rfftfreq(columns) * distance)[None, :, None]
    return np.fft.irfft(np.fft.rfft(picture, axis=1) * phase, columns, axis=1)


def _swept(
    matte: Float[np.ndarray, "rows columns"], low: float, high: float
) -> Bool[np.ndarray, "rows columns"]:
    """Mask of the pixels that a matte covers at some displacement between two; px."""
    swept = np.zeros(matte.shape, bool)
    columns = matte.shape[1]
    for shift in range(int(np.floor(low)) - 1, int(np.ceil(high)) + 2):
        first, last = max(0, shift), min(columns, columns + shift)
        swept[:, first:last] |= matte[:, first - shift : last - shift] > 0
    return swept
