r"""Outlines by the light of the layers, through the exact model of frames.

With the light $a$ of a thing, freed of its blur, and $h$ of what is behind it, frames are linear in
its matte: $g = (1 - R\,m)\,h + R\,(a\,m)$ with the response $R$ of its way within the exposure.
"""

import numpy as np
from scipy import ndimage

from mishutter.camera.rows import irfftn, rfftn
from mishutter.decoding.decoders.linear import EnsembleDecoder
from mishutter.decoding.objects.arrangement import Arrangement
from mishutter.decoding.objects.grids import Mask, from_outline, of_few_edges
from mishutter.decoding.objects.light import Knowledge, Layers, Misfit, Sight, light_of
from mishutter.decoding.objects.outlines import sharp, Along, pure, _costs
from mishutter.pictures.registration.windows import splines

_ROUNDS, _STEPS = 2, 40
COST, DOUBT = 0, 1.0
_REACH = 3.0
"""Pixels about an outline whose cover is solved for."""
_EDGE, _BIAS = 1.0, 0.04


def settle(arrangement: Arrangement, known: Knowledge) -> None:
    """Solves all outlines by the light of the layers, and that again."""
    for _ in range(_ROUNDS):
        misfit = Misfit.of(Sight.of(arrangement.stills, arrangement, known))
        layers = light_of(misfit, EnsembleDecoder())
        mattes = [_matte(arrangement, misfit, layers, n) for n in range(len(arrangement.things))]
        for thing, matte in zip(arrangement.things, mattes, strict=True):
            thing.matte = matte
        arrangement.place()


def _matte(arrangement: Arrangement, misfit: Misfit, layers: Layers, number: int) -> Mask:
    """The matte of a thing of least misfit and few edges, near the one that it has."""
    sight, stills, thing = misfit.sight, arrangement.stills, arrangement.things[number]
    sheet, own = sight.sheets[number + 1], layers[number + 1]
    shares, doubt = sight.shares[number + 1], DOUBT * stills.count * misfit.errors[number + 1]
    model, opacity = sight.frames(layers), rfftn(sheet.matte)
    spectrum = sheet.spectrum(own)
    behind, left, weights, square = [], [], [], np.zeros(sheet.size, np.float32)
    for k in range(stills.count):
        here = sheet.window.aside(sheet.ways[k])
        hidden = here.cut(_behind(arrangement, sight, layers, number, k))
        base = shares[k] * (sheet.shown(spectrum, k) + (1 - sheet.shown(opacity, k)) * hidden)
        # What is left by all layers, and the part of the thing and what is behind it.
        left.append(here.cut(stills.light[k] - model[k]) + base)
        noise = 1 / np.maximum(here.cut(sight.inverse[k]), 1e-12)
        ground = np.zeros(stills.shape, np.float32)
        sight.sheets[0].window.aside(sight.sheets[0].ways[k]).add(ground, misfit.errors[0])
        ground = here.cut(ground)
        weights.append((here.cut(np.ones(stills.shape, np.float32)) / (noise + doubt + ground)).astype(np.float32))
        behind.append(hidden)
        square += weights[-1] * (shares[k] * (own - hidden)) ** 2
    part = sheet.matte
    near = (from_outline(part > 0.5) <= _REACH).astype(np.float32)
    blur = int(np.ceil(np.max(np.abs(thing.velocity)) * stills.exposure))
    most = ndimage.maximum_filter(square, 2 * (blur // 2 + 1) + 1)
    step = (1 / (1.5 * most + 4)).astype(np.float32)

    def slope(matte: Mask) -> Mask:
        light, cover = rfftn(matte * own), rfftn(matte)
        one = two = 0.0
        for k in range(stills.count):
            response = sheet.responses[k % len(sheet.responses)]
            shown = irfftn(light * response, sheet.size)
            hides = irfftn(cover * response, sheet.size)
            pull = shares[k] * weights[k] * (shares[k] * (shown + (1 - hides) * behind[k]) - left[k])
            one = one + np.conj(response) * rfftn(pull)
            two = two + np.conj(response) * rfftn(pull * behind[k])
        return near * (own * irfftn(one, sheet.size) - irfftn(two, sheet.size) + _BIAS)

    costs = np.full(sheet.size, np.float32(_EDGE))
    if COST:
        along = Along.of(stills, splines(stills.light), sheet.window, thing.velocity)
        front = along.shares(arrangement.front[number], stills.ways(thing.velocity))
        costs = _EDGE * _costs(stills, along._replace(seen=along.seen * pure(front)))
    solved = of_few_edges(part, slope, costs, step, _STEPS)
    matte = sharp(np.where(near > 0, solved, part))
    whole = np.zeros(stills.shape, np.float32)
    sheet.window.add(whole, matte)
    return whole


def _behind(arrangement: Arrangement, sight: Sight, layers: Layers, number: int, frame: int) -> np.ndarray:
    """A frame without a thing and those before it."""
    light = np.zeros(sight.stills.shape, np.float32)
    for other in (-1, *arrangement.behind(number)):
        sheet, own = sight.sheets[other + 1], layers[other + 1]
        here = sheet.window.aside(sheet.ways[frame])
        if other >= 0:
            less = np.ones_like(light)
            here.add(less, -np.clip(sheet.shown(rfftn(sheet.matte), frame), 0, 1))
            light *= less
        here.add(light, sheet.shown(sheet.spectrum(own), frame))
    return light
