r"""One picture from frames along one axis, by any decoder of single captures.

Frames that go on beyond their borders are as good as one capture of the response
$\sqrt{\sum_k |A_k|^2/N_k}$ with white noise, $\sum_k \bar A_k \hat g_k / N_k$ over that response.
The ensemble filter restores it to the likeliest picture.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from mishutter._core.checks import RowLike, as_float
from mishutter.camera.capture import kernel_layout
from mishutter.camera.rows import MARGIN, fast_length, instants_within_reach
from mishutter.camera.sequences import furthest, responses_of_frames
from mishutter.decoding.decoders.base import (
    AbstractDecoder,
    BlurModel,
    CompleteFrames,
    blur_model,
    density_of,
)
from mishutter.decoding.decoders.linear import LEAST_POWER
from mishutter.decoding.likeliest import (
    TOLERANCE,
    Canvas,
    Fit,
    Likeliest,
    Volume,
    complete,
    detail_of,
    electrons_of,
    fit_of,
    likeliest,
    noises_of,
    volume_of,
)
from mishutter.decoding.restoration import restored_light
from mishutter.evaluation.instants import Instants
from mishutter.model.optics import frequencies
from mishutter.model.scene import Scene
from mishutter.model.sequences import TimedFrame
from mishutter.model.shutters.windows import RectShutter

Planes = Float[np.ndarray, "colours frames rows columns"]
"""Frames of pictures that move along their rows."""
TOLERANCE_OF_SPEED = 1e-2
"""Residual at which conjugate gradients of a likelihood end: likelihoods of speeds differ by less
than by the picture's own statistics."""


class Rows(NamedTuple):
    """Rows of frames about their mean, and what is known of them."""

    frames: Float[np.ndarray, "frames *rows columns"]  # Deviations from the level of each row
    noises: Float[np.ndarray, "frames"]  # Variance of the noise in each; white = 1
    nodes: Instants
    model: BlurModel  # The picture's statistics and the lens
    has_levels: bool = True  # Whether the mean of each row in each frame is that of the picture
    bin: int = 1  # Pixels of the sensor that are one of these

    def binned(self, bin: int) -> "Rows":
        """The means of so many neighbouring pixels, the last few left out."""
        count = self.frames.shape[-1] // bin
        pixels = self.frames[..., : count * bin].reshape(*self.frames.shape[:-1], count, bin)
        frames = pixels.mean(axis=-1)
        return self._replace(frames=frames, noises=self.noises / bin, bin=self.bin * bin)

    def of(self, some: Int[np.ndarray, "f"]) -> "Rows":
        """The same of some of the frames."""
        frames, noises, nodes = self.frames[some], self.noises[some], self.nodes.some(some)
        return self._replace(frames=frames, noises=noises, nodes=nodes)

    def middles(self, speed: float) -> Float[np.ndarray, "1 frames"]:
        """The mean way of a thing in each frame; px."""
        return self.nodes.middles(np.array([speed])) / self.bin

    def likeliest(self, speeds: RowLike, tolerance: float = TOLERANCE) -> Likeliest:
        """The likeliest pictures at some speeds."""
        margin = math.ceil((furthest(self.nodes, speeds) + MARGIN) / self.bin)
        length = fast_length(self.frames.shape[-1] + 2 * margin)
        period, count = length * self.bin, length // 2 + 1
        power = np.maximum(self.model.picture_spectrum(period)[:count], LEAST_POWER) / self.bin
        levels = self.has_levels
        canvas = Canvas(self.frames, self.noises, power, (margin,), (length,), has_levels=levels)
        responses = responses_of_frames(self.nodes, speeds, self.model.optics, period, self.bin)
        return likeliest(canvas, np.moveaxis(responses, 1, 0)[:, :, None], tolerance)

    def volume(self, found: Likeliest, place: int, speed: float) -> Volume:
        """The volume of one row at a speed, whose pictures have a place among the likeliest."""
        power = found.canvas.power / self.noises[:, None]
        density = np.abs(found.responses[:, place, 0]) ** 2 * power
        return volume_of(density, self.middles(speed), found.canvas.sensor)

    def logarithms(
        self, speeds: Float[np.ndarray, "s"], tolerance: float = TOLERANCE_OF_SPEED
    ) -> Float[np.ndarray, "s rows"]:
        """Logarithms of the likelihood of each row of the frames, over that of no picture."""
        count, columns = self.frames[..., 0].size, self.frames.shape[-1]
        at_once = max(1, 2**16 // (count * fast_length(columns)))  # px of canvas together
        values = []
        for some in np.split(speeds, range(at_once, speeds.size, at_once)):
            found = self.likeliest(some, tolerance)
            volumes = [self.volume(found, k, speed).logarithm for k, speed in enumerate(some)]
            values.append(found.gains - np.array(volumes)[:, None])
        return np.concatenate(values)

    def fit(self, speed: float) -> Fit:
        """How the frames fit the likeliest pictures at a speed."""
        found = self.likeliest([speed])
        return fit_of(found, self.volume(found, 0, speed))


def rows_of(
    planes: Float[np.ndarray, "*colours frames rows columns"],
    scene: Scene,
    taken: Sequence[TimedFrame],
    nodes: Instants,
) -> tuple[Rows, Float[np.ndarray, "*colours rows"]]:
    """Deviations of the rows of frames from the level of each row, and that level."""
    model = blur_model(scene, taken[0].motion, RectShutter())
    noises = noises_of(scene, [one.exposure for one in taken], model.mean_level)
    level = np.mean(planes, axis=(-3, -1))
    frames = np.moveaxis(planes - level[..., None, :, None], -3, 0)
    return Rows(frames, noises, nodes, model), level


def with_own_detail(rows: Rows, tried: Float[np.ndarray, "s"]) -> Rows:
    """The rows with the power of pictures that are as rich in detail, for some speeds."""
    model, columns = rows.model, rows.frames.shape[-1]
    length = fast_length(columns)
    responses = responses_of_frames(rows.nodes, tried, model.optics, length)
    density = np.mean(density_of(np.moveaxis(responses, 1, 0), rows.noises), axis=0)
    expected = density * model.picture_spectrum(length)
    detail = detail_of(rows.frames, rows.noises, (length,), expected, 2 / columns)
    power = detail.at(frequencies(model.power.size)) * model.power
    return rows._replace(model=replace(model, power=power))


def restored_on_axis(
    planes: Planes,
    scene: Scene,
    taken: Sequence[TimedFrame],
    decoder: AbstractDecoder,
    speed: float,
) -> Float[np.ndarray, "rows columns colours"]:
    """The picture at a speed."""
    nodes = instants_within_reach("restore_frames(speed=...)", taken, np.array([speed]))
    rows, level = rows_of(planes.astype(np.float64), scene, taken, nodes)
    found = rows.likeliest([speed])
    canvas, (data, density) = found.canvas, complete(found)
    spectrum = data / np.sqrt(np.maximum(density, LEAST_POWER) * density[..., :1])
    capture = np.moveaxis(canvas.picture(spectrum) + level[..., None], 0, -1)
    # The complete frames are as good as one capture of this blur and noise.
    electrons = float(np.sum(electrons_of(scene, [one.exposure for one in taken])))
    noise = 1 / float(np.sum(1 / rows.noises))
    read_variance = max(noise - rows.model.mean_level / electrons, 0.0)
    as_one = replace(
        rows.model,
        speeds=np.array([speed]),
        weights=np.ones(1),
        num_taps=max(kernel_layout(one.motion, speed)[0] for one in taken),
        efficiency=1.0,
        electrons=electrons,
        read_noise=electrons * math.sqrt(read_variance),
        complete=CompleteFrames(tuple(taken), speed, tuple(rows.noises.tolist())),
    )
    return np.asarray(restored_light(as_float(capture), decoder, as_one))[:, canvas.window[-1]]
