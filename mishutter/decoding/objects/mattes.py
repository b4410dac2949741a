r"""Outlines by the light of the layers, through the model of frames by which that is restored.

With the light $a$ of a thing, freed of its blur, and $h$ of what is behind it, a frame is linear in
the matte, $g = (1 - R\,m)\,h + R\,(a\,m)$, with the response $R$ of its way within the exposure and
of the pixel. Where light has detail beside an outline, $(R\,m)(R\,a)$ would be another frame.
"""

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.sparse.linalg import LinearOperator, cg

from mishutter.camera.rows import irfftn, rfftn
from mishutter.decoding.decoders.linear import EnsembleDecoder
from mishutter.decoding.objects.arrangement import Arrangement
from mishutter.decoding.objects.grids import Mask, from_outline, of_few_edges
from mishutter.decoding.objects.light import (
    WEAK,
    Knowledge,
    Layers,
    Misfit,
    Prior,
    Sheet,
    Sight,
    light_of,
)
from mishutter.decoding.objects.outlines import sharp
from mishutter.decoding.objects.stills import Stills
from mishutter.decoding.objects.velocities import refine_by_layers

_ROUNDS, _STEPS = 2, 40
_MOST_ROUNDS, _STANDS = 6, 0.1
"""Rounds in which velocities are refined, at most, and the way at the farthest frame by the last
step of one at which they end; px."""
_REACH = 3.0
"""Pixels about an outline whose cover is solved for."""
_EDGE, _BIAS = 1.0, 0.1
"""Logarithms of likelihoods that a pixel of outline has to bring, and one of a thing."""
_SHARED = 0.25
"""Share of the frames by which the expected error of a thing's light counts: all have it alike."""
_TOLD, _NEARLY, _MOST_STEPS = 4.0, 0.03, 200
"""One over the variance of a pixel's cover, of which nothing else is known; the share of a residual
at which conjugate gradients end, and their number at most."""
_SAFE = 1.5
"""Curvature that is counted with, beside the greatest one near a pixel."""


def settle(arrangement: Arrangement, known: Knowledge, *, are_told: bool = True) -> None:
    """Solves all outlines by the light of the layers, and both again.

    Args:
        arrangement: The things, in frames of a sensor at rest or on its path.
        known: The statistics of pictures.
        are_told: Whether velocities stay as they are, or are refined as well until they do.
    """
    are_off = not are_told
    for turn in range(_MOST_ROUNDS if arrangement.things else 0):
        misfit = Misfit.of(Sight.of(arrangement.stills, arrangement, known))
        layers = light_of(misfit, EnsembleDecoder())
        mixed = [Mixed.of(arrangement, misfit, layers, n) for n in range(len(arrangement.things))]
        mattes = [_solved(one) for one in mixed]
        if are_off:
            left = [partial(one.unexplained, misfit) for one in mixed]
            are_off = refine_by_layers(arrangement, known, misfit, layers, left) > _STANDS
        for thing, matte in zip(arrangement.things, mattes, strict=True):
            thing.matte = matte
        arrangement.place()
        if turn + 1 >= _ROUNDS and not are_off:
            break


class Mixed(NamedTuple):
    """Frames as they mix the light of a thing with that of what is behind it."""

    stills: Stills
    sheet: Sheet
    light: np.ndarray  # Of the thing, on its canvas
    # On the canvas in each part of the frames: pixels that nothing before it hides, and the light
    # of what is behind it
    shares: list[np.ndarray]
    behind: list[np.ndarray]
    rest: Float[np.ndarray, "frames rows columns"]  # Frames less what they mix
    weights: Float[np.ndarray, "frames rows columns"]  # One over the noise and the light's errors
    near: Bool[np.ndarray, "m n"]  # Pixels of the canvas about the outline
    curvature: Mask  # The greatest one of half of the weighted squares near each pixel

    @staticmethod
    def of(arrangement: Arrangement, misfit: Misfit, layers: Layers, number: int) -> "Mixed":
        """That of one of the things, by the light of all layers."""
        sight, stills = misfit.sight, arrangement.stills
        sheet, shares = sight.sheets[number + 1], sight.shares[number + 1]
        light, velocity = layers[number + 1], arrangement.things[number].velocity
        doubts = misfit.errors[0], _SHARED * stills.count * misfit.errors[number + 1]
        variance, behind = 1 / sight.inverse, []
        for k, part in enumerate(stills.parts):
            for one, doubt in zip((sight.sheets[0], sheet), doubts, strict=True):
                here = one.window.aside(one.ways[k])
                here.add(variance[part.frame], np.float32(part.share) * doubt)
            whole = _behind(arrangement, sight, layers, number, k)
            behind.append(sheet.window.aside(sheet.ways[k]).cut(whole))
        left, weights = stills.light - sight.frames(layers), 1 / variance
        near = from_outline(sheet.matte > 0.5) <= _REACH
        contrasts = [seen * (light - dark) for seen, dark in zip(shares, behind, strict=True)]
        curvature = _curvature(stills, sheet, contrasts, weights, velocity)
        mixed = Mixed(stills, sheet, light, shares, behind, left, weights, near, curvature)
        return mixed._replace(rest=left + mixed.frames(sheet.matte))

    def frames(self, matte: Mask) -> Float[np.ndarray, "frames rows columns"]:
        """The frames' light of the thing and of what is behind it, on the canvas, by a matte."""
        light, opacity = rfftn(matte * self.light), rfftn(matte)
        total = np.zeros(self.stills.light.shape, np.float32)
        for k, part in enumerate(self.stills.parts):
            shown = self.sheet.shown(light, k)
            shown = shown + (1 - self.sheet.shown(opacity, k)) * self.behind[k]
            here = self.sheet.window.aside(self.sheet.ways[k])
            here.add(total[part.frame], np.float32(part.share) * self.shares[k] * shown)
        return total

    def slope(self, matte: Mask) -> Mask:
        """Slope of half of the weighted squares of what a matte leaves of the frames."""
        return -self.gathered(self.weights * (self.rest - self.frames(matte)))

    def gathered(self, frames: Float[np.ndarray, "frames rows columns"]) -> Mask:
        """The adjoint of `frames`, less what they are without a matte."""
        size = self.sheet.size
        light = cover = np.zeros(1, np.complex64)
        for k, part in enumerate(self.stills.parts):
            here = self.sheet.window.aside(self.sheet.ways[k])
            pull = np.float32(part.share) * self.shares[k] * here.cut(frames[part.frame])
            response = np.conj(self.sheet.responses[k % len(self.sheet.responses)])
            light = light + response * rfftn(pull)
            cover = cover + response * rfftn(pull * self.behind[k])
        return self.light * irfftn(light, size) - irfftn(cover, size)

    def unexplained(
        self, misfit: Misfit, change: Float[np.ndarray, "frames rows columns"]
    ) -> Float[np.ndarray, "frames rows columns"]:
        r"""A change of the frames less what the light of the layers and this outline explain.

        Both are solved at once: one after the other, light would explain anew what the outline
        leaves. With the frames $A a$ of light and $B m$ of a matte near its outline, and the noise
        $N$, they are the minimum of $|c - A a - B m|^2/N + \epsilon \sum |\hat a|^2/S + \kappa
        |m|^2$. The prior of pictures counts little: photographs depart from it, and what it would
        tell of a velocity is wrong.
        """
        size, near, sight = self.sheet.size, self.near, misfit.sight
        none = self.frames(np.zeros(size, np.float32))
        ends = np.cumsum([sheet.window.rows * sheet.window.columns for sheet in sight.sheets])
        prior = Prior([WEAK / sheet.power for sheet in sight.sheets], WEAK)
        inverses = misfit.preconditioner(prior)
        most = self.curvature[near] + _TOLD

        def apart(numbers: np.ndarray) -> tuple[Layers, np.ndarray]:
            *lights, matte = np.split(numbers.astype(np.float32), ends)
            pairs = zip(lights, sight.sheets, strict=True)
            return [light.reshape(sheet.size) for light, sheet in pairs], matte

        def together(layers: Layers, pixels: np.ndarray) -> np.ndarray:
            return np.concatenate([*(light.ravel() for light in layers), pixels])

        def shown(layers: Layers, pixels: np.ndarray) -> np.ndarray:
            matte = np.zeros(size, np.float32)
            matte[near] = pixels
            return sight.frames(layers) + self.frames(matte) - none

        def pulled(frames: np.ndarray) -> tuple[Layers, np.ndarray]:
            weighed = sight.inverse * frames
            return sight.layers(weighed), self.gathered(weighed)[near]

        def curved(numbers: np.ndarray) -> np.ndarray:
            layers, pixels = apart(numbers)
            pulls, own = pulled(shown(layers, pixels))
            pairs = zip(pulls, prior.of(sight.sheets, layers), strict=True)
            return together([a + b for a, b in pairs], own + _TOLD * pixels)

        def turned(numbers: np.ndarray) -> np.ndarray:
            layers, pixels = apart(numbers)
            each = zip(sight.sheets, layers, inverses, strict=True)
            return together([sheet.filtered(*one) for sheet, *one in each], pixels / most)

        target = together(*pulled(change))
        whole, scale = (
            LinearOperator((target.size, target.size), matvec=each, dtype=np.float32)  # type: ignore[call-arg]
            for each in (curved, turned)
        )
        found, _ = cg(whole, target, rtol=_NEARLY, maxiter=_MOST_STEPS, M=scale)
        return change - shown(*apart(found))


def _curvature(
    stills: Stills,
    sheet: Sheet,
    contrasts: list[np.ndarray],  # Of a thing with what is behind it, in each part of the frames
    weights: np.ndarray,
    velocity: Float[np.ndarray, "2"],
) -> Mask:
    """The greatest curvature of half of the weighted squares near each pixel of a thing's matte."""
    total, longest = np.zeros(sheet.size, np.float32), 0.0
    for k, (part, contrast) in enumerate(zip(stills.parts, contrasts, strict=True)):
        weight = sheet.window.aside(sheet.ways[k]).cut(weights[part.frame])
        total += np.float32(part.share) * weight * contrast**2
        longest = max(longest, float(np.hypot(*part.blur(velocity))))
    return ndimage.maximum_filter(total, 2 * math.ceil(longest / 2) + 3)


def _solved(mixed: Mixed) -> Mask:
    """The matte of least misfit and few edges, near the one that a thing has."""
    sheet, near = mixed.sheet, mixed.near.astype(np.float32)
    step = (1 / (_SAFE * mixed.curvature + 4)).astype(np.float32)
    costs = np.full(sheet.size, np.float32(_EDGE))
    slope = lambda matte: near * (mixed.slope(matte) + _BIAS)  # noqa: E731
    solved = of_few_edges(sheet.matte, slope, costs, step, _STEPS)
    whole = np.zeros(mixed.stills.shape, np.float32)
    sheet.window.add(whole, sharp(np.where(near > 0, solved, sheet.matte)))
    return whole


def _behind(
    arrangement: Arrangement, sight: Sight, layers: Layers, number: int, part: int
) -> np.ndarray:
    """A part of a frame without a thing and those before it."""
    rest = sight.sheets[0]
    light = np.zeros(sight.stills.shape, np.float32)
    rest.window.aside(rest.ways[part]).add(light, rest.shown(rest.spectrum(layers[0]), part))
    for other in arrangement.behind(number):
        sheet, own = sight.sheets[other + 1], layers[other + 1]
        here, clear = sheet.window.aside(sheet.ways[part]), np.ones_like(light)
        here.add(clear, -np.clip(sheet.shown(rfftn(sheet.matte), part), 0, 1))
        light *= clear
        here.add(light, sheet.shown(sheet.spectrum(own), part))
    return light
