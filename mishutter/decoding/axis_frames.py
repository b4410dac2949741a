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
from jaxtyping import Complex, Float, Int

from mishutter._core.checks import RowLike, as_float
from mishutter.camera.capture import kernel_layout
from mishutter.camera.rows import MARGIN, fast_length, instants_within_reach, waves_at
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
from mishutter.decoding.rolling import FrameAlong, RowTimes, instants_of_rows
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
    nodes: Instants  # Of each frame, or of each row of it where these are exposed in turn
    model: BlurModel  # The picture's statistics and the lens
    has_levels: bool = True  # Whether the mean of each row in each frame is that of the picture
    bin: int = 1  # Pixels of the sensor that are one of these
    is_along: bool = False  # Whether each column has an exposure of its own, and not each row

    def binned(self, bin: int) -> "Rows":
        """The means of so many neighbouring pixels, the last few left out."""
        count = self.frames.shape[-1] // bin
        pixels = self.frames[..., : count * bin].reshape(*self.frames.shape[:-1], count, bin)
        frames, nodes = pixels.mean(axis=-1), self.nodes
        if self.is_along:
            nodes = nodes.some(self._exposures[:, bin // 2 :: bin][:, :count].ravel())
        noises = self.noises / bin
        return self._replace(frames=frames, noises=noises, nodes=nodes, bin=self.bin * bin)

    def of(self, some: Int[np.ndarray, "f"]) -> "Rows":
        """The same of some of the frames."""
        nodes = self.nodes.some(self._exposures[some].ravel())
        return self._replace(frames=self.frames[some], noises=self.noises[some], nodes=nodes)

    def of_rows(self, some: Int[np.ndarray, "r"]) -> "Rows":
        """The same of some of the rows."""
        own = self._exposures
        is_same = self.is_along or own.shape[1] == 1
        nodes = self.nodes if is_same else self.nodes.some(own[:, some].ravel())
        return self._replace(frames=self.frames[..., some, :], nodes=nodes)

    @property
    def nodes_of_some(self) -> Instants:
        """Those of a few delays, which stand for all in a mean."""
        own = self._exposures
        some = np.unique(np.linspace(0, own.shape[1] - 1, 7).astype(int))
        return self.nodes.some(own[:, some].ravel())

    @property
    def _exposures(self) -> Int[np.ndarray, "frames delays"]:
        """Number of the exposure of each row, or of all rows, in each frame."""
        return np.arange(self.nodes.exposure.size).reshape(len(self.noises), -1)

    def middles(self, speed: float) -> Float[np.ndarray, "1 frames delays"]:
        """The mean way of a thing in each frame and row; px."""
        return self.nodes.middles(np.array([speed]))[:, self._exposures] / self.bin

    def responses(self, speeds: RowLike, period: int) -> Complex[np.ndarray, "frames s delays k"]:
        """Responses of the frames at all delays, on the grid of a DFT of the sensor's px."""
        each = responses_of_frames(self.nodes, speeds, self.model.optics, period, self.bin)
        return np.moveaxis(each[:, self._exposures], 1, 0)

    def likeliest(self, speeds: RowLike, tolerance: float = TOLERANCE) -> Likeliest:
        """The likeliest pictures at some speeds."""
        margin = math.ceil((furthest(self.nodes, speeds) + MARGIN) / self.bin)
        length = fast_length(self.frames.shape[-1] + 2 * margin)
        period = length * self.bin
        power = self.model.picture_spectrum(period)[: length // 2 + 1]
        power = np.maximum(power, LEAST_POWER) / self.bin
        levels = self.has_levels
        canvas = Canvas(self.frames, self.noises, power, (margin,), (length,), has_levels=levels)
        responses = self.responses(speeds, period)
        if not self.is_along:
            return likeliest(canvas, responses, tolerance)
        waves = waves_at(margin, self.frames.shape[-1], length)
        return likeliest(canvas, [FrameAlong(one * waves) for one in responses], tolerance)

    def volume(self, found: Likeliest, place: int, speed: float) -> Volume:
        """The volume of each row at a speed, whose pictures have a place among the likeliest."""
        if self.is_along:
            some = self._replace(nodes=self.nodes_of_some, is_along=False)
            responses = some.responses([speed], found.canvas.shape[0] * self.bin)[:, 0]
        else:
            some, responses = self, np.asarray(found.responses)[:, place]
        density = np.abs(responses) ** 2 * found.canvas.power / self.noises[:, None, None]
        each = zip(np.moveaxis(density, 1, 0), np.moveaxis(some.middles(speed), 2, 0), strict=True)
        volumes = [volume_of(*one, found.canvas.sensor) for one in each]
        freedoms = np.mean([one.freedoms for one in volumes], axis=0)
        logarithms = np.array([one.logarithm for one in volumes])
        return Volume(np.mean(logarithms, keepdims=True) if self.is_along else logarithms, freedoms)

    def logarithms(
        self, speeds: Float[np.ndarray, "s"], tolerance: float = TOLERANCE_OF_SPEED
    ) -> Float[np.ndarray, "s rows"]:
        """Logarithms of the likelihood of each row of the frames, over that of no picture."""
        count, columns = self.frames[..., 0].size, self.frames.shape[-1]
        at_once = max(1, 2**16 // (count * fast_length(columns)))  # px of canvas together
        if self.is_along:  # each pixel has a response
            at_once = max(1, 2**21 // (len(self.noises) * columns**2))
        values = []
        for some in np.split(speeds, range(at_once, speeds.size, at_once)):
            found = self.likeliest(some, tolerance)
            volumes = [self.volume(found, k, speed).logarithm for k, speed in enumerate(some)]
            values.append(found.gains - np.array(volumes))
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
    *,
    is_along: bool = False,
) -> tuple[Rows, Float[np.ndarray, "*colours rows"]]:
    """Deviations of the rows of frames from the level of each row, and that level."""
    model = blur_model(scene, taken[0].motion, RectShutter())
    noises = noises_of(scene, [one.exposure for one in taken], model.mean_level)
    level = np.mean(planes, axis=(-3, -1))
    frames = np.moveaxis(planes - level[..., None, :, None], -3, 0)
    return Rows(frames, noises, nodes, model, is_along=is_along), level


def with_own_detail(rows: Rows, tried: Float[np.ndarray, "s"]) -> Rows:
    """The rows with the power of pictures that are as rich in detail, for some speeds."""
    model, columns = rows.model, rows.frames.shape[-1]
    length = fast_length(columns)
    some = rows._replace(nodes=rows.nodes_of_some)
    density = np.mean(density_of(some.responses(tried, length), rows.noises), axis=(0, 1))
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
    *,
    times: RowTimes,
) -> Float[np.ndarray, "rows columns colours"]:
    """The picture at a speed."""
    instants_within_reach("restore_frames(speed=...)", taken, np.array([speed]))
    nodes = instants_of_rows(taken, scene, abs(speed), times.delays)
    planes = planes.astype(np.float64)
    rows, level = rows_of(planes, scene, taken, nodes, is_along=times.is_along)
    found = rows.likeliest([speed])
    whole = CompleteFrames(rows.nodes_of_some, speed, rows.noises)
    density = whole.density(rows.model.optics, found.canvas.shape[0])
    canvas, data = found.canvas, complete(found, density if times.is_rolling else None)
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
        complete=whole,
    )
    return np.asarray(restored_light(as_float(capture), decoder, as_one))[:, canvas.window[-1]]
