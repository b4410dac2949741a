r"""The exposure of layers that hide one another while they move in the plane.

As `mishutter.camera.occlusion` does along rows: each layer is added blurred as if nothing hid it,
and its hidden parts are taken away, which are images in the layer's own frame of reference.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from mishutter._core.parallel import in_threads, num_processors
from mishutter.blur.waves import waves_in_plane
from mishutter.camera.layers import Layers
from mishutter.camera.occlusion import images_between, in_fewest_colours
from mishutter.camera.plane_frames import seen_along
from mishutter.camera.responses import aperture_on, frequencies_on
from mishutter.camera.rows import (
    MARGIN,
    continued,
    fast_length,
    instants_within_reach,
    irfftn,
    nodes_of,
    period_of,
    rfftn,
)
from mishutter.evaluation.instants import Instants
from mishutter.model.frame_path import PlaneFrames
from mishutter.model.optics import Optics
from mishutter.model.scene import Scene

_BOTH = (-2, -1)
_APART = 4
"""Pixels between mattes within which they are taken together."""
Corner = tuple[int, int]
"""A row and a column."""


class _Sheet(NamedTuple):
    """A layer in one frame, with nothing in front of it; rows come before columns."""

    radiance: Float[np.ndarray, "channels m n"]  # Radiance times matte, continued to a period
    matte: Float[np.ndarray, "rows columns"]
    corner: Corner  # Of the sensor, under its first pixel in the middle of the burst
    moved: Corner  # Whole pixels that it is displaced by in the frame
    displacement: Float[np.ndarray, "2 1 q"]  # Along rows and columns, beyond these; px
    velocity: Float[np.ndarray, "2"]  # Down the columns and along rows; px/s

    @staticmethod
    def of(layers: Layers, index: int, frame: Instants) -> "_Sheet":
        """A layer by its number."""
        layer, channels = layers.layers[index], layers.shape[2]
        displacement = frame.displacement(layer.velocity)
        moved = np.round(np.mean(displacement, axis=(1, 2))).astype(int) * (index > 0)
        displacement = displacement - moved[:, None, None]
        light = np.moveaxis(layer.picture.light, -1, 0).astype(np.float64)
        radiance = np.broadcast_to(light, (channels, *light.shape[1:])) * layer.matte
        border, reach = "zero" if index else layers.border, _reach(displacement)
        for size in reach:  # columns first, then the rows, which are columns of the turned picture
            turned = np.swapaxes(radiance, 1, 2)
            radiance = continued(turned, period_of(turned.shape[-1], size, border), border)
        corner = (layer.top, layer.left) if index else (0, 0)
        place = int(moved[1]), int(moved[0])
        return _Sheet(radiance, layer.matte, corner, place, displacement, layer.velocity[::-1])

    @property
    def aside(self) -> Corner:
        """Rows and columns beyond its own that it reaches while it is displaced; px."""
        down, across = _reach(self.displacement)
        return down + MARGIN, across + MARGIN

    def add(self, total: np.ndarray, irradiance: np.ndarray, origin: Corner | None = None) -> None:
        """Add its periodic irradiance to the sensor, or once that of a part, from `origin` on."""
        places, windows = [], []
        for k, size in enumerate(total.shape[1:]):
            corner = self.corner[k] + self.moved[k]
            first = max(corner - self.aside[k], 0)
            last = min(corner + self.matte.shape[k] + self.aside[k], size)
            begin = corner
            if origin is not None:  # the margins of a part lie within it
                begin += origin[k]
                first, last = max(first, begin), min(last, begin + irradiance.shape[k + 1])
            places.append(np.arange(first - begin, last - begin) % irradiance.shape[k + 1])
            windows.append(slice(first, max(first, last)))
        if all(place.size for place in places):
            total[:, windows[0], windows[1]] += irradiance[:, places[0][:, None], places[1]]

    def seen(self, frame: Instants, behind: "_Sheet") -> tuple[slice, slice]:
        """Rows and columns of the layer `behind` that it passes over in a frame."""
        ends = np.array([np.min(frame.time), np.max(frame.time)])
        parts = []
        for k in range(2):
            way = (behind.velocity[k] - self.velocity[k]) * ends
            first = self.corner[k] - behind.corner[k]
            low = first + math.floor(np.min(way)) - _APART
            parts.append(slice(low, first + self.matte.shape[k] + math.ceil(np.max(way)) + _APART))
        return parts[0], parts[1]


def layers_in_plane(
    layers: Layers, scene: Scene, frames: PlaneFrames, size: tuple[int | None, int | None]
) -> Iterator[Float[np.ndarray | Array, "rows columns channels"]]:
    """Irradiance of the sensor of so many rows and columns in each frame of layers."""
    velocities = [layer.velocity for layer in layers.layers]
    for velocity in velocities:
        instants_within_reach("Layer(speed=...)", frames, velocity)
    # Images that change while they are displaced ask for nodes for both.
    fastest = max(float(np.hypot(*each)) for each in velocities)
    few = in_fewest_colours(layers)
    counts = layers.shape[:2]
    _, windows = zip(*map(seen_along, counts, size, counts, ("rows", "columns")), strict=True)
    both = fastest + frames.top_speed
    delays, shares = nodes_of(scene.sensor, windows[0].stop - windows[0].start, both)
    nodes = [Instants.of(frames, both + fastest, delay=each) for each in delays.tolist()]
    for k in range(frames.num_frames):
        light: Any = sum(
            _exposed(few, instants.some([k]), scene.optics)[*windows] * share[:, None, None]
            for instants, share in zip(nodes, shares, strict=True)
        )
        shape = (*light.shape[:2], layers.shape[2])
        dtype = layers.layers[0].picture.light.dtype
        yield np.ascontiguousarray(np.broadcast_to(light.astype(dtype), shape))


def _exposed(
    layers: Layers, frame: Instants, optics: Optics
) -> Float[np.ndarray, "rows columns channels"]:
    """Irradiance of all pixels in one frame."""
    total = np.zeros((layers.shape[2], *layers.shape[:2]))
    sheets = [_Sheet.of(layers, index, frame) for index in range(len(layers.layers))]
    for index, sheet in enumerate(sheets):
        period = sheet.radiance.shape[1:]
        passes = waves_in_plane(sheet.displacement, frame.weight, frequencies_on(period))[0]
        spectrum = rfftn(sheet.radiance, axes=_BOTH) * (passes * aperture_on(optics, period))
        sheet.add(total, irfftn(spectrum, period, axes=_BOTH))
        for group in _groups(sheet, sheets[index + 1 :], frame, layers.shape[:2]):
            _hide(total, sheet, group, frame, optics)
    return np.moveaxis(total, 0, -1)


def _reach(displacement: np.ndarray) -> Corner:
    """Furthest displacement, down the columns and along rows; px."""
    across, down = (math.ceil(np.max(np.abs(each))) for each in displacement)
    return down, across


class _Group(NamedTuple):
    """Layers in front of another that pass over one part of it."""

    sheets: list[_Sheet]
    part: tuple[slice, slice]


def _groups(
    behind: _Sheet, front: list[_Sheet], frame: Instants, sensor: tuple[int, ...]
) -> list[_Group]:
    """Layers in front of another, those together whose ways in a frame meet."""
    groups: list[_Group] = []
    for sheet in front:
        group = _Group([sheet], sheet.seen(frame, behind))
        for other in [each for each in groups if _meet(each.part, group.part)]:
            parts = zip(other.part, group.part, strict=True)
            down, across = (slice(min(a.start, b.start), max(a.stop, b.stop)) for a, b in parts)
            group = _Group(other.sheets + group.sheets, (down, across))
            groups.remove(other)
        groups.append(group)
    within = []
    for k, size in enumerate(sensor):
        begin, aside = -behind.corner[k] - behind.moved[k], behind.aside[k]
        first, last = max(begin, 0) - aside, min(begin + size, behind.matte.shape[k]) + aside
        within.append(slice(first, last))
    visible = (within[0], within[1])
    cut = [
        (group.sheets, [slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in pairs])
        for group in groups
        if _meet(group.part, visible)
        for pairs in [zip(group.part, visible, strict=True)]
    ]
    return [_Group(sheets, (down, across)) for sheets, (down, across) in cut]


def _meet(one: tuple[slice, slice], other: tuple[slice, slice]) -> bool:
    """Whether two parts of a picture have a pixel in common."""
    return all(a.start < b.stop and b.start < a.stop for a, b in zip(one, other, strict=True))


def _hide(total: np.ndarray, sheet: _Sheet, group: _Group, frame: Instants, optics: Optics) -> None:
    """Take away the irradiance of a layer that a group in front of it stops."""
    (down, across), (rows, columns) = group.part, sheet.aside
    origin = down.start - rows, across.start - columns
    # So much further that no light and no matte comes round to the part.
    period = (
        fast_length(down.stop - down.start + 2 * rows),
        fast_length(across.stop - across.start + 2 * columns),
    )
    # A product of a layer and n mattes reaches n + 1 times as far in frequency. Sampled so finely,
    # what folds back stays above the frequencies that are kept.
    finer = 1 + -(-len(group.sheets) // 2)
    radiance = _finer(rfftn(sheet.radiance, axes=_BOTH), sheet.radiance.shape[1:], finer)
    for k, count in enumerate(period):
        place = origin[k] + np.arange(finer * count) / finer
        own = np.arange(finer * count) + finer * origin[k]
        radiance = np.take(radiance, own % radiance.shape[k + 1], axis=k + 1)
        is_inside = (place >= -sheet.aside[k]) & (place < sheet.matte.shape[k] + sheet.aside[k])
        radiance = radiance * (is_inside[:, None] if k == 0 else is_inside)
    rates = np.array([sheet.velocity - front.velocity for front in group.sheets])
    # Waves of a matte that moves aslant pass as fast as along both axes together.
    times, weights = images_between(frame, float(np.max(np.sum(np.abs(rates), axis=1))))
    middle, down_and_across = float(np.mean(frame.time)), frequencies_on(period)
    mattes, places = [], []
    for front, rate in zip(group.sheets, rates, strict=True):
        base = np.array(front.corner) - sheet.corner - origin
        moved = np.round(rate * middle)
        mattes.append(rfftn(_placed(front.matte, (base + moved).astype(int), period), axes=_BOTH))
        places.append(rate * times[:, None] - moved)
    aperture = aperture_on(optics, period) / finer**2

    def stopped(index: int) -> np.ndarray:
        weight = weights[index]
        lit = weight != 0
        passes = waves_in_plane(sheet.displacement[..., lit], weight[None, lit], down_and_across)[0]
        clearness = 1.0
        for matte, place in zip(mattes, places, strict=True):
            ways = zip(down_and_across, place[index], strict=True)
            down, across = (np.exp(-2j * np.pi * f * way) for f, way in ways)
            shifted = matte * down * across
            clearness = clearness * (1 - _finer(shifted, period, finer))
        spectrum = rfftn(radiance * (1 - clearness), axes=_BOTH)
        return _coarser(spectrum, period) * (passes * aperture)

    loss = np.zeros((total.shape[0], period[0], period[1] // 2 + 1), complex)
    for part in in_threads(stopped, range(times.size), num_processors()):
        loss -= part
    sheet.add(total, irfftn(loss, period, axes=_BOTH), origin)


def _placed(
    matte: Float[np.ndarray, "m n"], corner: Int[np.ndarray, "2"], shape: tuple[int, ...]
) -> Float[np.ndarray, "rows columns"]:
    """A matte on some rows and columns, clear where it is not."""
    placed, to, of = np.zeros(shape), [], []
    for first, size, count in zip(corner.tolist(), matte.shape, shape, strict=True):
        begin, end = max(first, 0), max(min(first + size, count), max(first, 0))
        to.append(slice(begin, end))
        of.append(slice(begin - first, end - first))
    placed[to[0], to[1]] = matte[of[0], of[1]]
    return placed


def _finer(spectrum: np.ndarray, shape: tuple[int, ...], finer: int) -> np.ndarray:
    """Periodic pictures, from their DFT, at a multiple of their rows and columns."""
    rows, columns = shape
    wide = np.zeros((*spectrum.shape[:-2], finer * rows, finer * columns // 2 + 1), complex)
    own = np.arange(rows) - (rows - 1) // 2
    wide[..., own, : columns // 2 + 1] = spectrum[..., own, :]
    # Half of the highest frequency belongs to the negative one.
    if rows % 2 == 0:
        wide[..., rows // 2, :] /= 2
        wide[..., -(rows // 2), :] = wide[..., rows // 2, :]
    if columns % 2 == 0:
        wide[..., columns // 2] /= 2
    return finer**2 * irfftn(wide, (finer * rows, finer * columns), axes=_BOTH)


def _coarser(spectrum: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The DFT of so many rows and columns, in that of more."""
    own = np.fft.fftfreq(shape[0], 1 / shape[0]).astype(int)
    return spectrum[..., own, : shape[1] // 2 + 1]
