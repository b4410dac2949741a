r"""The picture of all layers at one instant, and where to trust it.

Layers are as wrong as things are that turn or change their shape; one frame restored alone is not.
Of the two, $x_l$ and $x_1$, the mean $x_l + w (x_1 - x_l)$ of the least expected error in the
neighbourhood of a pixel has

$$w = \frac{\langle (y - x_l)(x_1 - x_l) \rangle - (c_1 - c_l)}
           {\langle (x_1 - x_l)^2 + q^2 \rangle}$$

with the frame $y$; with $q$, by which the frame differs from one without its exposure's blur, which
layers are freed of; and with $c_1$ and $c_l$, how much of the frame's noise each has taken over
(Stein's lemma). That of a decoder of any kind is told by what it makes of a little more noise.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from mishutter.decoding.decoders.base import AbstractDecoder
from mishutter.decoding.objects.arrangement import Arrangement
from mishutter.decoding.objects.grids import Mask, moved
from mishutter.decoding.objects.light import (
    Knowledge,
    Layers,
    Misfit,
    Sight,
    explaining,
    light_of,
)
from mishutter.decoding.objects.stills import Stills
from mishutter.pictures.registration.windows import Window, smoothed, splines

_NEIGHBOURHOODS = (2.0, 6.0)
"""Gaussians under which layers and frame are weighed: what is left is strong, or wide; px."""
_CERTAIN = 2.0
"""Standard deviations by which the share of the frame is taken to be less than it seems."""
_MORE_NOISE = 0.3
"""Noise by which a decoder is tried, in standard deviations of a frame's."""
_TAKEN_OVER = 6.0
"""Gaussian under which the noise that a decoder takes over is averaged; px."""
_MOST_ALONE = 0.25
"""Share of the frame from which on a pixel is not trusted."""
_MOST_MISFIT = 1.5
"""Mean square of the residuals along a layer, over its expectation, of pixels that are trusted."""
_AWAY = 2.0
"""Pixels from an outline within which none is trusted."""


class Alone(NamedTuple):
    """The frame nearest to the instant, restored as a still."""

    light: Float[np.ndarray, "rows columns"]
    shown: Float[np.ndarray, "rows columns"]  # The frame of that light
    taken_over: Float[np.ndarray, "rows columns"]  # Covariance of that with the frame's noise

    @staticmethod
    def of(stills: Stills, known: Knowledge, decoder: AbstractDecoder) -> "Alone":
        """That of the frames."""
        frame = stills.only(np.arange(stills.count) == stills.middle)
        sight = Sight.of(frame, None, known)
        misfit, window = Misfit.of(sight), sight.sheets[0].window
        light = light_of(misfit, decoder)
        shown = sight.frames(light)[0]
        signs = np.random.default_rng(0).choice([-1.0, 1.0], frame.light.shape).astype(np.float32)
        noise = np.sqrt(1 / sight.inverse)
        noisier = replace(frame, light=frame.light + _MORE_NOISE * noise * signs)
        other = light_of(Misfit.of(replace(sight, stills=noisier)), decoder)
        changes = (sight.frames(other)[0] - shown) / _MORE_NOISE
        taken_over = smoothed((noise * signs)[0] * changes, _TAKEN_OVER)
        return Alone(whole_of(window, light[0], stills.shape), shown, np.maximum(taken_over, 0))

    def share(self, misfit: Misfit, layers: Layers, blur: np.ndarray) -> Mask:
        """Share of this frame in the mean of it and of layers that errs least.

        Args:
            misfit: Misfit of the layers.
            layers: Light of each on its canvas.
            blur: Change of the frame by the ways of things within its exposure.
        """
        sight = misfit.sight
        number = sight.stills.middle
        frame, noise = sight.stills.light[number], 1 / sight.inverse[number]
        shown = sight.frames(layers)[number]
        left, apart = frame - shown, self.shown - shown
        less = self.taken_over * (1 - _told(misfit, number))
        share = np.zeros_like(frame)
        for sigma in _NEIGHBOURHOODS:
            square = np.maximum(smoothed(apart**2, sigma), 1e-9)
            error = np.sqrt(smoothed(noise, sigma) * square / (4 * np.pi * sigma**2))
            excess = smoothed(left * apart, sigma) - less - _CERTAIN * error
            risk = square + smoothed(blur**2, sigma)
            share = np.maximum(share, np.clip(excess / risk, 0, 1))
        return share


def _told(misfit: Misfit, frame: int) -> Mask:
    """Share of what the frames tell of the layers that a frame does, where it shows them."""
    sight = misfit.sight
    total = np.zeros(sight.stills.shape, np.float32)
    for sheet, shares, density in zip(sight.sheets, sight.shares, misfit.densities, strict=True):
        opacity = sheet.spectrum(np.ones_like(density))
        for k, part in enumerate(sight.stills.parts):
            if part.frame == frame:
                here = sheet.window.aside(sheet.ways[k])
                own = (shares[k] * sheet.matte) ** 2 * here.cut(sight.inverse[frame])
                cover = part.share * shares[k] * np.clip(sheet.shown(opacity, k), 0, 1)
                here.add(total, (cover * own / np.maximum(density, 1e-9)).astype(np.float32))
    return np.clip(total, 0, 1)


class Composite(NamedTuple):
    """A picture of layers."""

    light: Float[np.ndarray, "rows columns"]
    lights: list[Float[np.ndarray, "rows columns"]]  # Of each layer, as it is in it
    # Mean square, over their noise, of the residuals of the frames that see a pixel's layer there
    misfit: Float[np.ndarray, "rows columns"]
    num_seen: Float[np.ndarray, "rows columns"]  # Frames that do
    alone: Mask  # Share of the frame nearest to the instant, restored alone


def labels_of(arrangement: Arrangement) -> Int[np.ndarray, "rows columns"]:
    """Number of the thing that a pixel shows at the time 0, from 1; 0 for the background."""
    return np.argmax(arrangement.alphas(), axis=0)


def trusted(arrangement: Arrangement, found: Composite) -> Bool[np.ndarray, "rows columns"]:
    """Pixels that the frames agree on, away from outlines."""
    alphas, labels = arrangement.alphas(), labels_of(arrangement)
    edge = np.max(alphas, axis=0) < 0.9
    edge[:-1] |= labels[1:] != labels[:-1]
    edge[:, :-1] |= labels[:, 1:] != labels[:, :-1]
    is_away = np.ones(edge.shape, bool)
    if edge.any():
        is_away = np.asarray(ndimage.distance_transform_edt(~edge)) > _AWAY
    agree = (found.misfit < _MOST_MISFIT) & (found.alone < _MOST_ALONE)
    return agree & (found.num_seen > 1.5) & is_away


def composite(arrangement: Arrangement, misfit: Misfit, layers: Layers, alone: Alone) -> Composite:
    """The picture of layers at the time 0.

    Where they do not explain the frame nearest to it, that frame restored alone takes their place.

    Args:
        arrangement: The things.
        misfit: Misfit of the layers.
        layers: Light of each on its canvas.
        alone: That frame restored alone.
    """
    sight, shape = misfit.sight, arrangement.stills.shape
    stills = sight.stills  # of one colour
    # A prior bends edges, which would count as unexplained.
    model = sight.frames(explaining(misfit))
    noise = [stills.noise(smoothed(np.maximum(one, 0), 0.7), k) for k, one in enumerate(model)]
    squares = (stills.light - model) ** 2 / np.stack(noise)
    pairs = zip(sight.sheets, layers, strict=True)
    lights = [whole_of(sheet.window, own, shape) for sheet, own in pairs]
    doubt = alone.share(misfit, layers, _blur(arrangement, lights))
    spline = splines(alone.light[None])[0]
    light, single = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    final = [one.copy() for one in lights]
    mean_square, num_seen = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    labels = labels_of(arrangement)
    seen = [arrangement.ground, *(arrangement.seen(n) for n in range(len(arrangement.things)))]
    velocities = [np.zeros(2), *(thing.velocity for thing in arrangement.things)]
    whole = Window.whole(shape)
    for number, (alpha, velocity) in enumerate(zip(arrangement.alphas(), velocities, strict=True)):
        window = whole if number == 0 else Window.around(alpha, 4)
        share, here = window.of(alpha), window.of(final[number])
        way = stills.ways(velocity)[stills.middle]
        # The frame shows something else where it hides what is seen at the time 0.
        shown = window.taken(seen[number][stills.middle], way) / np.maximum(share, 0.01)
        weight = window.taken(doubt, way) * window.seen(way, shape) * np.minimum(2 * shown, 1)
        # Restored alone it stands where the sensor is at the time 0.
        own = window.taken(spline, velocity * stills.times[stills.middle], is_spline=True)
        here += weight * (own - here)
        window.of(single)[...] += share * weight
        window.of(light)[...] += share * here
        total, count = _along(stills, (squares, seen[number]), velocity, window)
        known = count > 1.5
        left = smoothed(np.where(known, total, 0), 2.0)
        least = smoothed(np.where(known, count - 1, 0), 2.0)
        is_own = window.of(labels) == number
        window.of(mean_square)[is_own] = (left / np.maximum(least, 1e-3))[is_own]
        window.of(num_seen)[is_own] = count[is_own]
    return Composite(light, final, mean_square, num_seen, single)


def whole_of(window: Window, part: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """A picture of zeros but for a part, which may lie beyond it."""
    whole = np.zeros(shape, np.float32)
    window.add(whole, part)
    return whole


def _blur(arrangement: Arrangement, lights: list[np.ndarray]) -> np.ndarray:
    """Light at the middle of the middle exposure, less its mean over that exposure."""
    stills, things = arrangement.stills, arrangement.things
    number, whole = stills.middle, Window.whole(stills.shape)

    def at(place: np.ndarray, time: float) -> np.ndarray:
        light = whole.taken(lights[0], -place) if place.any() else lights[0].copy()
        for other in reversed(arrangement.order):
            thing, own = things[other], lights[other + 1]
            window, way = thing.window, place + thing.velocity * time
            matte = moved(window.of(thing.matte), window, way, stills.shape)
            light += matte * (moved(window.of(own), window, way, stills.shape) - light)
        return light

    blurred = np.zeros(stills.shape, np.float32)
    for part in stills.parts:
        if part.frame == number:
            ways = [part.blur(thing.velocity) for thing in things]
            longest = max((float(np.hypot(*way)) for way in ways), default=0.0)
            steps = max(1, math.ceil(longest / 1.5))
            late = part.duration * ((np.arange(steps) + 0.5) / steps - 0.5)
            each = [at(part.place + part.velocity * x, part.time + x) for x in late.tolist()]
            blurred += np.float32(part.share) * np.mean(each, axis=0)
    return at(stills.ways(np.zeros(2))[number], float(stills.times[number])) - blurred


def _along(
    stills: Stills,
    stack: tuple[np.ndarray, np.ndarray],
    velocity: np.ndarray,
    window: Window,
) -> tuple[np.ndarray, np.ndarray]:
    """Sum of squares over the frames that see a layer, and their number, where it is at 0."""
    squares, shares = stack
    total = np.zeros((window.rows, window.columns), np.float32)
    count = np.zeros_like(total)
    for way, square, share in zip(stills.ways(velocity), squares, shares, strict=True):
        sees = window.seen(way, stills.shape) & (window.taken(share, way) > 0.95)
        total += np.where(sees, window.taken(square, np.rint(way)), 0)
        count += sees
    return total, count
