"""The exposure of layers that hide one another while they move."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from mishutter._core.parallel import in_threads, num_processors
from mishutter.blur.waves import waves_on_dft
from mishutter.camera.layers import Layer, Layers
from mishutter.camera.rows import MARGIN, blur_length, continued, fast_length, period_of
from mishutter.evaluation.instants import Instants
from mishutter.evaluation.needs import Plan
from mishutter.evaluation.response import nodes_in_time
from mishutter.model.motion import AbstractMotion
from mishutter.model.optics import Optics
from mishutter.model.shutters.base import AbstractShutter


class _Image(NamedTuple):
    """The image of a layer with nothing in front of it."""

    radiance: Float[np.ndarray, "channels rows period"]  # Radiance times matte at no displacement
    displacement: Float[np.ndarray, "q"]  # Its displacement at each time of the exposure; px
    speed: float  # Its speed; px/s
    left: int  # Column of the sensor of its first column
    num_columns: int  # Columns before it is continued
    rows: slice  # Rows of the sensor that it covers

    @staticmethod
    def of(layers: Layers, index: int, nodes: Instants) -> "_Image":
        """That of a layer over an exposure, by its number."""
        layer, (num_rows, _, channels) = layers.layers[index], layers.shape
        top, left = (layer.top, layer.left) if index else (0, 0)
        rows = slice(max(top, 0), min(top + _height(layer), num_rows))
        own_rows = slice(rows.start - top, rows.stop - top)
        radiance = np.moveaxis(layer.picture.light[own_rows], -1, 0).astype(np.float64)
        radiance = np.broadcast_to(radiance, (channels, *radiance.shape[1:]))
        radiance = radiance * layer.matte[own_rows]
        border = "zero" if index else layers.border
        speed = layer.along_rows
        displacement = nodes.displacement(np.array([speed]))[0, 0]
        num_columns = radiance.shape[-1]
        period = period_of(num_columns, _reach(displacement), border)
        radiance = continued(radiance, period, border)
        return _Image(radiance, displacement, speed, left, num_columns, rows)

    @property
    def aside(self) -> int:
        """Columns to either side that it reaches while it is displaced; px."""
        return _reach(self.displacement) + MARGIN

    def responses(
        self, weights: Float[np.ndarray, "n q"], optics: Optics, period: int
    ) -> Complex[np.ndarray, "n k"]:
        """Responses of the pixels to it, on the grid of a DFT, for some weights of the nodes."""
        count = period // 2 + 1
        aperture = np.sinc(np.arange(count) / period) * optics.response(period)
        return np.asarray(waves_on_dft(self.displacement[None], weights, period, count)) * aperture

    def add(self, total: np.ndarray, irradiance: np.ndarray, origin: int | None = None) -> None:
        """Add its periodic irradiance to some rows, or once that of a part from `origin` on."""
        first, left = max(self.left - self.aside, 0), self.left
        last = min(self.left + self.num_columns + self.aside, total.shape[-1])
        if origin is not None:  # the margins of a part lie within it
            left += origin
            first, last = max(first, left), min(last, left + irradiance.shape[-1])
        if first < last:
            columns = np.arange(first - left, last - left) % irradiance.shape[-1]
            total[..., first:last] += irradiance[..., columns]


def expose_layers(
    layers: Layers, motion: AbstractMotion, shutter: AbstractShutter, optics: Optics
) -> np.ndarray:
    r"""Irradiance of the sensor from layers that hide one another while they move.

    $g = \int w(t) \sum_l (\alpha_l C_l)(x - d_l) \prod_{m > l} (1 - \alpha_m(x - d_m))\,dt$ with
    displacements $d_l(t)$: the time integral of the composite, not a composite of blurred
    layers. Radiance and mattes are continuous, band-limited functions through their pixels, so that
    an edge is as sharp as the pixels are; the optics cut off finer detail of the composite.

    Each layer is added blurred as if nothing hid it, and its hidden parts are taken away. In the
    layer's own frame these are images $u(t)$, which change as the layers in front move relative
    to it. Images at instants $t_j$, between which the fastest of these moves half a pixel, give
    all others by an interpolating window $\varphi$:

    $\hat g(f) = \sum_j \hat u(t_j, f) \int w(t)\,\varphi(t - t_j)\,e^{-2\pi i f d_l(t)}\,dt$.

    Layers that are not `visible_layers` are left out, and equal colours are computed once.
    """
    visible = visible_layers(in_fewest_colours(layers), motion)
    speeds = [layer.along_rows for layer in visible.layers]
    blur_length(motion, *speeds, subject="Layer(speed=...)")
    half, v = float(motion.half_exposure), float(motion.velocity)
    fastest = max(abs(speed - v) for speed in speeds)
    # Images that change while they are displaced ask for as many nodes once more.
    num_nodes = nodes_for(2 * (float(motion.speed_gain) + fastest) * half)
    tau, weight = map(np.asarray, nodes_in_time(shutter, motion, num_nodes))
    place = np.asarray(motion.position(tau * half))[None]
    nodes = Instants(tau * half, place, weight, np.full(1, 2 * half))
    return _exposed(visible, nodes, optics, layers)


def expose_layers_in_frame(layers: Layers, frame: Instants, optics: Optics) -> np.ndarray:
    """Irradiance of the sensor in a frame of a sequence, by where layers are in its middle."""
    visible = _visible(in_fewest_colours(layers), frame.time[0], frame.place[0, 0])
    return _exposed(visible, frame, optics, layers)


def _exposed(visible: Layers, nodes: Instants, optics: Optics, layers: Layers) -> np.ndarray:
    """The light of visible layers, in the colours of all."""
    rows, columns, channels = visible.shape
    total = np.zeros((channels, rows, columns))
    for index in range(len(visible.layers)):
        image = _Image.of(visible, index, nodes)
        period = image.radiance.shape[-1]
        response = image.responses(nodes.weight, optics, period)
        irradiance = np.fft.irfft(np.fft.rfft(image.radiance) * response, period)
        image.add(total[:, image.rows], irradiance)
        first, last = image.rows.start, image.rows.stop
        others = visible.layers[index + 1 :]
        front = [m for m in others if m.top < last and m.top + _height(m) > first]
        # The sum of all light is exact without instants; only columns near hidden parts take them.
        if front:
            _hide(total, image, front, nodes, optics)
    picture = np.moveaxis(total, 0, -1).astype(layers.layers[0].picture.light.dtype)
    return np.ascontiguousarray(np.broadcast_to(picture, layers.shape))


def nodes_for(velocity: float) -> int:
    """Quadrature nodes for light displaced by at most `velocity` px per half exposure."""
    # Never fewer than 512, so that cameras of most exposures share one compiled program.
    return max(512, Plan.of_travel(0.0, velocity).num_nodes)


def _reach(displacement: np.ndarray) -> int:
    return int(np.ceil(np.max(np.abs(displacement))))


def _hide(
    total: np.ndarray, image: _Image, front: Sequence[Layer], nodes: Instants, optics: Optics
) -> None:
    """Take away the irradiance of a layer that layers in front of it stop."""
    first = max(image.rows.start, min(m.top for m in front))
    last = min(image.rows.stop, max(m.top + _height(m) for m in front))
    rates = [image.speed - m.along_rows for m in front]
    longest, fastest = np.max(np.abs(nodes.time)), max(map(abs, rates))
    way = int(np.ceil(fastest * longest))
    low = max(
        min(m.left for m in front) - way - image.left, -image.aside, -image.left - 2 * image.aside
    )
    high = min(
        max(m.left + m.matte.shape[1] for m in front) + way - image.left,
        image.num_columns + image.aside,
        total.shape[-1] - image.left + 2 * image.aside,
    )
    if low >= high:
        return
    # So much further that no light and no matte comes round to the columns from `low` to `high`.
    origin = low - way - image.aside
    period = fast_length(high - low + 2 * (way + image.aside))
    # A product of a layer and n mattes reaches n + 1 times as far in frequency. Sampled so finely,
    # what folds back stays above the frequencies that are kept.
    finer = 1 + -(-len(front) // 2)
    column = origin + np.arange(finer * period) / finer
    is_inside = (column >= -image.aside) & (column < image.num_columns + image.aside)
    times, weights = images_between(nodes, fastest)
    turns = -2j * np.pi / period * np.arange(period // 2 + 1)
    shifts = [np.exp(np.multiply.outer(times * rate, turns)) for rate in rates]
    responses = image.responses(weights, optics, period)
    rows_at_once = 8  # whose images stay in a processor's cache from one instant to the next

    def hide(begin: int) -> None:
        end = min(begin + rows_at_once, last)
        own = image.radiance[:, begin - image.rows.start : end - image.rows.start]
        radiance = _finer(np.fft.rfft(own), own.shape[-1], finer)
        radiance = radiance[..., (finer * origin + np.arange(finer * period)) % radiance.shape[-1]]
        radiance = radiance * is_inside
        place = image.left + origin
        mattes = [np.fft.rfft(_placed(m, begin, end, place, period)) for m in front]
        loss = np.zeros((*radiance.shape[:2], period // 2 + 1), complex)
        for index, response in enumerate(responses):
            shifted = [m * shift[index] for m, shift in zip(mattes, shifts, strict=True)]
            clearness = np.prod([1 - _finer(m, period, finer) for m in shifted], axis=0)
            spectrum = np.fft.rfft(radiance * (1 - clearness))[..., : period // 2 + 1]
            loss -= spectrum * (response / finer)
        image.add(total[:, begin:end], np.fft.irfft(loss, period), origin)

    for _ in in_threads(hide, range(first, last, rows_at_once), num_processors()):
        pass


def images_between(
    nodes: Instants, fastest: float
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n q"]]:
    """Times of images that give those between, and the weight of each image at each node."""
    step = 0.5 / fastest if fastest > 0 else np.inf  # the fastest layer moves by half a pixel
    longest, around = np.max(np.abs(nodes.time)), 8  # images to either side of a time
    if longest < step / around / 1e3:  # nothing moves
        return np.zeros(1), nodes.weight
    first = int(np.floor(np.min(nodes.time) / step)) - around
    last = int(np.ceil(np.max(nodes.time) / step)) + around
    times = step * np.arange(first, last + 1)
    apart = (nodes.time - times[:, None]) / step
    # A Kaiser-Bessel window makes the interpolation by a sinc short.
    inside = np.sqrt(np.maximum(1 - (apart / around) ** 2, 0))
    window = np.where(np.abs(apart) < around, np.i0(12.5 * inside), 0.0)
    return times, nodes.weight * np.sinc(apart) * window / np.i0(12.5)


def _finer(spectrum: np.ndarray, period: int, finer: int) -> np.ndarray:
    """Periodic rows, from their DFT, at a multiple of their columns."""
    one_sided = spectrum.copy()
    if period % 2 == 0:  # half of it belongs to the negative frequency
        one_sided[..., -1] /= 2
    return finer * np.fft.irfft(one_sided, finer * period)


def _placed(
    layer: Layer, first: int, last: int, left: int, period: int
) -> Float[np.ndarray, "rows {period}"]:
    """A matte on some rows and columns of the sensor, clear where it is not."""
    matte = np.zeros((last - first, period))
    top, aside = layer.top - first, layer.left - left
    rows = slice(max(top, 0), min(top + _height(layer), last - first))
    columns = slice(max(aside, 0), min(aside + layer.matte.shape[1], period))
    if rows.start < rows.stop and columns.start < columns.stop:
        own = layer.matte[rows.start - top : rows.stop - top]
        matte[rows, columns] = own[:, columns.start - aside : columns.stop - aside]
    return matte


def _height(layer: Layer) -> int:
    return layer.picture.light.shape[0]


def in_fewest_colours(layers: Layers) -> Layers:
    """The layers in one colour, where all of their colours are equal."""
    pictures = [layer.picture for layer in layers.layers]
    if not all(np.all(picture.light == picture.light[..., :1]) for picture in pictures):
        return layers
    one = [
        replace(layer, picture=replace(layer.picture, light=layer.picture.light[..., :1]))
        for layer in layers.layers
    ]
    return replace(layers, layers=tuple(one))


def visible_layers(layers: Layers, motion: AbstractMotion) -> Layers:
    """Layers without those that are clear, or too far off the sensor."""
    half = float(motion.half_exposure)
    time = np.linspace(-half, half, 257)  # instants that tell how far the path reaches
    return _visible(layers, time, np.asarray(motion.position(time)))


def _visible(layers: Layers, time: Float[np.ndarray, "q"], path: Float[np.ndarray, "q"]) -> Layers:
    """Layers that the sensor sees at some instants on its path, but for those that are clear."""
    first, *others = layers.layers
    (rows, columns, _), seen = layers.shape, [first]
    for layer in others:
        displacement, (height, width) = path - layer.along_rows * time, layer.matte.shape
        meets_rows = layer.top < rows and layer.top + height > 0
        # The margin is wide beside what the path does between instants.
        begin = layer.left + np.min(displacement) - MARGIN
        end = layer.left + width + np.max(displacement) + MARGIN
        if meets_rows and begin < columns and end > 0 and layer.matte.any():
            seen.append(layer)
    return replace(layers, layers=tuple(seen))
