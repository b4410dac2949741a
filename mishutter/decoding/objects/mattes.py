r"""Outlines by the light of the layers, through the model of frames by which that is restored.

With the light $a$ of a thing, freed of its blur, and $h$ of what is behind it, a frame is linear in
the matte, $g = (1 - R\,m)\,h + R\,(a\,m)$, with the response $R$ of its way within the exposure and
of the pixel. Where light has detail beside an outline, $(R\,m)(R\,a)$ would be another frame.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from mishutter.camera.rows import irfftn, rfftn
from mishutter.decoding.decoders.linear import EnsembleDecoder
from mishutter.decoding.objects.arrangement import Arrangement
from mishutter.decoding.objects.grids import Mask, from_outline, of_few_edges
from mishutter.decoding.objects.light import Knowledge, Layers, Misfit, Sheet, Sight, light_of
from mishutter.decoding.objects.outlines import sharp

_ROUNDS, _STEPS = 2, 40
_REACH = 3.0
"""Pixels about an outline whose cover is solved for."""
_EDGE, _BIAS = 1.0, 0.1
"""Logarithms of likelihoods that a pixel of outline has to bring, and one of a thing."""
_SHARED = 0.25
"""Share of the frames by which the expected error of a thing's light counts: all have it alike."""
_SAFE = 1.5
"""Curvature that is counted with, beside the greatest one near a pixel."""


def settle(arrangement: Arrangement, known: Knowledge) -> None:
    """Solves all outlines by the light of the layers, and both again.

    Args:
        arrangement: The things, in frames of a sensor at rest.
        known: The statistics of pictures.
    """
    stills = arrangement.stills
    for _ in range(_ROUNDS):
        misfit = Misfit.of(Sight.of(stills, arrangement, known))
        layers = light_of(misfit, EnsembleDecoder())
        longest, mattes = float(np.max(stills.exposures)), []
        for number, thing in enumerate(arrangement.things):
            blur = float(np.hypot(*thing.velocity)) * longest
            mixed = Mixed.of(arrangement, misfit, layers, number)
            mattes.append(_solved(mixed, blur, stills.shape))
        for thing, matte in zip(arrangement.things, mattes, strict=True):
            thing.matte = matte
        arrangement.place()


class Mixed(NamedTuple):
    """Frames about a thing, on its canvas, as they mix its light with that of what is behind it."""

    sheet: Sheet
    light: np.ndarray  # Of the thing
    shares: list[np.ndarray]  # Of pixels that nothing before it hides, frame by frame
    behind: list[np.ndarray]  # Light of what is behind it
    frames: list[np.ndarray]  # Less the light of what is before it
    weights: list[np.ndarray]  # One over the noise, and the errors that the light may have

    @staticmethod
    def of(arrangement: Arrangement, misfit: Misfit, layers: Layers, number: int) -> "Mixed":
        """Those about one of the things, by the light of all layers."""
        sight, stills = misfit.sight, arrangement.stills
        sheet, light = sight.sheets[number + 1], layers[number + 1]
        shares = sight.shares[number + 1]
        left, rest = stills.light - sight.frames(layers), sight.sheets[0]
        doubt = _SHARED * stills.count * misfit.errors[number + 1]
        opacity, spectrum = rfftn(sheet.matte), sheet.spectrum(light)
        behind, frames, weights = [], [], []
        for k, way in enumerate(sheet.ways):
            here = sheet.window.aside(way)
            behind.append(here.cut(_behind(arrangement, sight, layers, number, k)))
            own = sheet.shown(spectrum, k) + (1 - sheet.shown(opacity, k)) * behind[k]
            frames.append(here.cut(left[k]) + shares[k] * own)
            variance = 1 / sight.inverse[k]
            rest.window.aside(rest.ways[k]).add(variance, misfit.errors[0])
            reached = here.cut(np.ones_like(variance))
            weights.append(reached / np.where(reached > 0, here.cut(variance) + doubt, 1))
        return Mixed(sheet, light, shares, behind, frames, weights)

    def left(self, matte: Mask) -> list[np.ndarray]:
        """The light of frames less that which a matte gives."""
        light, opacity = rfftn(matte * self.light), rfftn(matte)
        each = zip(self.shares, self.behind, self.frames, strict=True)
        return [
            frame
            - share * (self.sheet.shown(light, k) + (1 - self.sheet.shown(opacity, k)) * behind)
            for k, (share, behind, frame) in enumerate(each)
        ]

    def slope(self, matte: Mask) -> Mask:
        """Slope of half of the weighted squares of these."""
        light = cover = np.zeros(1, np.complex64)
        each = zip(self.left(matte), self.shares, self.behind, self.weights, strict=True)
        for k, (left, share, behind, weight) in enumerate(each):
            response = np.conj(self.sheet.responses[k % len(self.sheet.responses)])
            pull = share * weight * left
            light, cover = light + response * rfftn(pull), cover + response * rfftn(pull * behind)
        size = self.sheet.size
        return irfftn(cover, size) - self.light * irfftn(light, size)


def _solved(mixed: Mixed, blur: float, shape: tuple[int, int]) -> Mask:
    """The matte of least misfit and few edges, near the one that a thing has.

    Args:
        mixed: The frames about it.
        blur: Its way within an exposure; px.
        shape: Rows and columns of a frame.
    """
    sheet = mixed.sheet
    near = (from_outline(sheet.matte > 0.5) <= _REACH).astype(np.float32)
    each = zip(mixed.shares, mixed.behind, mixed.weights, strict=True)
    curved = [weight * (share * (mixed.light - behind)) ** 2 for share, behind, weight in each]
    most = ndimage.maximum_filter(np.sum(curved, axis=0), 2 * math.ceil(blur / 2) + 3)
    step = (1 / (_SAFE * most + 4)).astype(np.float32)
    costs = np.full(sheet.size, np.float32(_EDGE))
    slope = lambda matte: near * (mixed.slope(matte) + _BIAS)  # noqa: E731
    solved = of_few_edges(sheet.matte, slope, costs, step, _STEPS)
    whole = np.zeros(shape, np.float32)
    sheet.window.add(whole, sharp(np.where(near > 0, solved, sheet.matte)))
    return whole


def _behind(
    arrangement: Arrangement, sight: Sight, layers: Layers, number: int, frame: int
) -> np.ndarray:
    """A frame without a thing and those before it."""
    rest = sight.sheets[0]
    light = np.zeros(sight.stills.shape, np.float32)
    rest.window.aside(rest.ways[frame]).add(light, rest.shown(rest.spectrum(layers[0]), frame))
    for other in arrangement.behind(number):
        sheet, own = sight.sheets[other + 1], layers[other + 1]
        here, clear = sheet.window.aside(sheet.ways[frame]), np.ones_like(light)
        here.add(clear, -np.clip(sheet.shown(rfftn(sheet.matte), frame), 0, 1))
        light *= clear
        here.add(light, sheet.shown(sheet.spectrum(own), frame))
    return light
