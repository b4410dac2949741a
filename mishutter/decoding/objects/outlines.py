r"""Outlines of things, by what explains each pixel of the frames.

A pixel belongs to a thing where each frame, given the others along the thing's velocity, is
likelier than given the others along all else that may be seen there: the background at rest, with
and without the thing before it, and other things. The logarithms of the likelihoods are of
differences under a Gaussian, so that half of the pixels at an outline say nothing; of the masks
that they allow the one of the shortest outline is taken. In the end its length counts less where
the light along the thing has an edge, at which things end rather than elsewhere.

Within some pixels of that, the light of a pixel says how much of it the thing covers:
$g = (b * m)\,a + (1 - b * m)\,h$ with the light $a$ of the thing, $h$ of what is behind it, and the
matte $m$ under the box $b$ of its way within the exposure.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.special import erfinv

from mishutter.camera.rows import irfftn, rfftn
from mishutter.decoding.objects.arrangement import Arrangement
from mishutter.decoding.objects.grids import Mask, from_outline, moved, of_few_edges
from mishutter.decoding.objects.stills import Stills
from mishutter.pictures.registration.windows import Window, filled, smoothed

PURE = 0.9
"""Share of a pixel above which one layer is all that it shows."""
_SMOOTHING = 1.0
"""Gaussian under which frames are compared; px."""
_INDEPENDENT = 1 / (4 * np.pi * _SMOOTHING**2)
"""Independent numbers a pixel under it, and the variance of a white noise that is left."""
_MISPLACED = 0.15
"""Error of a place that differences of frames may have without telling anything; px."""
_MOST = 8.0
"""Greatest logarithm of a likelihood ratio that one pixel of one frame brings."""
_BIAS = 0.04
"""The lead of all else, where nothing tells."""
_EDGE, _FINE_EDGE = 1.5, 1.0
"""Logarithms of likelihoods that a pixel of outline has to bring: at first, and from mixed ones."""
_SLOPE, _SLOPE_NOISE = 1.0, 1 / (4 * np.pi)
"""Gaussian under which an edge of light is looked for, px, and the square of a slope there by noise
of unit variance."""
_INNER = 8
"""Pixels within an outline that are hardly of another thing."""
_LIGHT = 0.5
"""Gaussian under which the light of a layer is taken for that near the outline; px."""
_OFF = 0.3
"""Error of the place at which light is taken, and of its sharpness; px."""
_NEAR, _SHARE = 3.0, 0.25
"""Gaussian under which the variance of a layer's light is taken, px, and the share of it by which
light is off that was filled in so far away."""
_GREATEST = 30.0
"""Most that one pixel tells of its own cover, in inverse variances."""
_SHARP = 1.0
"""Gaussian through which a step is taken for an outline's; px."""
_REACH = 6.0
"""Pixels about an outline whose cover is solved for."""
_MIXED = 0.85
"""Cover from which on a pixel tells of the light of what covers it."""


class _Given(NamedTuple):
    """Frames by the mean of the others."""

    logarithms: Float[np.ndarray, "frames rows columns"]  # Of the likelihood a pixel
    others: Float[np.ndarray, "rows columns"]  # Worth of all frames that see it, in typical frames


def given_others(stills: Stills, frames: np.ndarray, seen: np.ndarray) -> _Given:
    """How likely each frame is by those others that see the same, where `seen` is 1."""
    weights = (stills.weights[:, None, None] * seen).astype(np.float32)
    total, worth = np.sum(weights * frames, axis=0), np.sum(weights, axis=0)
    known = worth > 0.2
    mean = total / np.maximum(worth, 1e-9)
    near = smoothed(known.astype(np.float32), 5.0)
    wide = smoothed(np.where(known, mean, 0), 5.0) / np.maximum(near, 1e-6)
    level = smoothed(np.where(known, mean, wide), 1.2)
    slope = sum(each**2 for each in np.gradient(level))
    # What no other frame tells is as far from its neighbourhood as the layer is elsewhere.
    unknown = 0.5 * float(np.var(stills.light[stills.middle]))
    spread = smoothed(np.where(known, (mean - wide) ** 2, 0), 5.0) / np.maximum(near, 1e-6)
    unknown = np.where(near > 0.02, np.minimum(spread, unknown), unknown)
    logarithms = np.empty(frames.shape, np.float32)
    for k, frame in enumerate(frames):
        own = weights[k]
        rest = worth - own
        is_told = rest > 0.2
        told = (total - own * frame) / np.maximum(rest, 1e-9)
        left = smoothed(frame - np.where(is_told, told, wide), _SMOOTHING)
        alone, typical = stills.noise(level, k), stills.typical_noise(level)
        least = _INDEPENDENT * (alone + typical / np.maximum(rest, 0.5))
        is_near = smoothed(is_told.astype(np.float32), _SMOOTHING) > 0.5
        variance = least + np.where(is_near, 0, unknown) + _MISPLACED**2 * slope
        logarithms[k] = -0.5 * left**2 / variance - 0.5 * np.log(variance / least)
    return _Given(logarithms, worth)


def pure(share: np.ndarray) -> np.ndarray:
    """1 where a pixel shows one layer alone, and 0 elsewhere."""
    return (share > PURE).astype(np.float32)


class Along(NamedTuple):
    """Frames in a window about a thing that goes with it."""

    frames: Float[np.ndarray, "frames rows columns"]
    seen: Float[np.ndarray, "frames rows columns"]  # 1 where the frame reaches
    window: Window

    @staticmethod
    def of(stills: Stills, window: Window, velocity: np.ndarray) -> "Along":
        """Those about a velocity."""
        ways = stills.ways(velocity)
        pairs = zip(stills.coefficients, ways, strict=True)
        frames = [window.taken(one, way, is_spline=True) for one, way in pairs]
        seen = [window.seen(way, stills.shape) for way in ways]
        return Along(np.stack(frames), np.stack(seen).astype(np.float32), window)

    def taken(self, stack: np.ndarray, ways: np.ndarray) -> np.ndarray:
        """Pictures of the frames' pixels, which go on beyond their borders."""
        return np.stack([self.window.taken(*each) for each in zip(stack, ways, strict=True)])

    def shares(self, stack: np.ndarray, ways: np.ndarray) -> np.ndarray:
        """Shares of the frames' pixels, 0 beyond their borders."""
        return self.taken(stack, ways) * self.seen


def cut_out(arrangement: Arrangement, *, at_edges: bool = False) -> None:
    """Draws the outline of each thing anew, all by the same light.

    Args:
        arrangement: The things.
        at_edges: Whether outlines are likelier at edges of the light along things than elsewhere.
    """
    stills, things = arrangement.stills, arrangement.things
    rest = given_others(stills, stills.light, pure(arrangement.ground))
    own: list[tuple[Along, _Given]] = []
    for number, thing in enumerate(things):
        along = Along.of(stills, thing.window, thing.velocity)
        front = along.shares(arrangement.front[number], stills.ways(thing.velocity))
        along = along._replace(seen=along.seen * pure(front))
        own.append((along, given_others(stills, along.frames, along.seen)))
    outlines = []
    for number, thing in enumerate(things):
        along, given = own[number]
        ways = stills.ways(thing.velocity)
        other = _otherwise(arrangement, number, rest.logarithms)
        for behind in reversed(arrangement.order):
            if behind == number:
                continue
            its, likely = own[behind]
            for k, way in enumerate(stills.ways(things[behind].velocity)):
                there = moved(likely.logarithms[k] + 20.0, its.window, way, stills.shape) - 20.0
                hidden = arrangement.cover[behind][k] > 0.5
                other[k] = np.where(hidden, there, other[k])
        against = np.stack(
            [along.window.taken(one, way) for one, way in zip(other, ways, strict=True)]
        )
        lead = np.clip(given.logarithms - against, -_MOST, _MOST) * along.seen
        lead = np.sum(lead, axis=0) * _INDEPENDENT
        least = float(np.min(stills.weights))
        lead = np.where(given.others > 0.2 * least, lead, 0) - _BIAS
        costs = _costs(stills, along) if at_edges else np.ones_like(lead)
        outlines.append((along.window, lead, given.others > 1.2 * least, _EDGE * costs))
    for thing, (window, lead, is_told, costs) in zip(things, outlines, strict=True):
        start = window.of(thing.matte)
        mask = of_few_edges(start, lambda _, lead=lead: -lead, costs, 0.35, 150) > 0.5
        # What one frame alone shows goes on from what several do, or is none of the thing.
        parts = np.empty(mask.shape, np.int32)
        ndimage.label(mask, output=parts)
        shares = ndimage.mean(is_told, parts, np.arange(1, int(parts.max()) + 1))
        mask = np.isin(parts, 1 + np.flatnonzero(np.asarray(shares) > 0.5))
        thing.matte = window.placed(mask.astype(np.float32), stills.shape)
        thing.evidence = float(np.sum(lead * mask))


def _costs(stills: Stills, along: Along) -> Mask:
    """Cost of a pixel of outline: less where light along a thing is steeper than in the mean."""
    weights = stills.weights[:, None, None].astype(np.float32) * along.seen
    worth = np.sum(weights, axis=0)
    mean = np.sum(weights * along.frames, axis=0) / np.maximum(worth, 1e-9)
    light = smoothed(filled(mean, worth > 0), _SLOPE)
    noise = (
        _SLOPE_NOISE
        * stills.typical_noise(light)
        / np.maximum(worth, float(np.min(stills.weights)))
    )
    square = np.maximum(_square_slope(light) - noise, 0)
    return (1 / (1 + square / (np.mean(square) + noise))).astype(np.float32)


def _otherwise(arrangement: Arrangement, number: int, rest: np.ndarray) -> np.ndarray:
    """The likelihoods by the background at rest, whether or not a thing is before it."""
    stills, thing = arrangement.stills, arrangement.things[number]
    ways = stills.ways(thing.velocity)
    part = thing.window.swept(np.vstack([ways - 8.0, ways + 8.0]), stills.shape)
    clear = np.ones(stills.light.shape, np.float32)
    for other in arrangement.order:
        if other != number:
            clear = clear * (1 - arrangement.cover[other])
    inner = ndimage.binary_erosion(thing.matte > 0.5, iterations=_INNER).astype(np.float32)
    less = clear * (1 - arrangement.covered(thing, inner))
    here = replace(stills, light=part.of(stills.light))
    likely = rest.copy()
    for share in (clear, less):
        seen = pure(part.of(share))
        given = given_others(here, here.light, seen)
        np.maximum(part.of(likely), given.logarithms, out=part.of(likely))
    return likely


class Lights(NamedTuple):
    """Light of the layers, as blurred within the exposures."""

    ground: Float[np.ndarray, "rows columns"]
    known: Mask  # 1 where a frame shows the background
    things: list[Float[np.ndarray, "rows columns"]]  # Each where it is at the time 0
    told: list[Bool[np.ndarray, "rows columns"]]  # Where frames show that


def mean_lights(arrangement: Arrangement) -> Lights:
    """Light of each layer, by the mean of the frames in which its pixels are its own.

    Pixels that are nearly so tell as well, less the light of what is behind.
    """
    stills = arrangement.stills
    weights = stills.weights[:, None, None].astype(np.float32)
    seen = (arrangement.ground > 0.95) * weights
    worth = np.sum(seen, axis=0)
    ground = np.sum(seen * stills.light, axis=0) / np.maximum(worth, 1e-9)
    known = worth > 0
    none = [np.zeros(0)] * len(arrangement.things)
    lights = Lights(filled(ground, known), known.astype(np.float32), none, [*none])
    for number in reversed(arrangement.order):
        thing = arrangement.things[number]
        ways = stills.ways(thing.velocity)
        along = Along.of(stills, thing.window, thing.velocity)
        front = along.shares(arrangement.front[number], ways)
        cover = along.shares(arrangement.cover[number], ways)
        hidden = behind_in_frames(arrangement, lights, number)
        behind = along.taken(hidden, ways)
        tells = (along.seen > 0) & (front > 0.95) & (cover > _MIXED)
        share = cover * tells
        weighed = share * weights
        total = np.sum(weighed * (along.frames - (1 - cover) * behind), axis=0)
        one = np.sum(weighed * share, axis=0)
        known = one > 0.9 * _MIXED**2 * float(np.min(stills.weights))
        lights.things[number] = filled(total / np.maximum(one, 1e-9), known)
        lights.told[number] = known
    return lights


def behind_in_frames(arrangement: Arrangement, lights: Lights, number: int) -> np.ndarray:
    """Light of the frames without a thing and those before it."""
    stills = arrangement.stills
    light = np.broadcast_to(lights.ground.astype(np.float32), stills.light.shape).copy()
    for other in arrangement.behind(number):
        thing, own = arrangement.things[other], lights.things[other]
        window = thing.window
        for k, way in enumerate(stills.ways(thing.velocity)):
            cover = arrangement.cover[other][k]
            shown = moved(own, window, way, stills.shape)
            light[k] += cover * (shown - light[k])
    return light


def sharpen(arrangement: Arrangement, drawn: list[Mask]) -> None:
    """Solves the outlines again, from the light of pixels that show two layers.

    Args:
        arrangement: The things.
        drawn: The mask of each, near whose outline the solved one lies.
    """
    stills = arrangement.stills
    lights = mean_lights(arrangement)
    smooth = lights._replace(
        ground=smoothed(lights.ground, _LIGHT), things=[smoothed(a, _LIGHT) for a in lights.things]
    )
    pairs = zip(lights.things, lights.told, strict=True)
    doubt = lights._replace(
        ground=_doubt(lights.ground, lights.known > 0), things=[_doubt(*pair) for pair in pairs]
    )
    mattes = []  # of all things by the same light
    for number, thing in enumerate(arrangement.things):
        ways = stills.ways(thing.velocity)
        along = Along.of(stills, thing.window, thing.velocity)
        front = along.shares(arrangement.front[number], ways)
        along = along._replace(seen=along.seen * pure(front))
        own = _Layer(smooth.things[number], doubt.things[number])
        hidden = (behind_in_frames(arrangement, each, number) for each in (smooth, doubt))
        behind = _Layer(*(along.taken(each, ways) for each in hidden))
        square, cross = _cover(stills, along, own, behind)
        blur = thing.velocity * stills.exposure
        near = along.window.of(from_outline(drawn[number] > 0.5) <= _REACH).astype(np.float32)
        mattes.append(
            _solved(
                (along.window, near),
                thing.matte,
                blur,
                (square, cross - _BIAS),
                _FINE_EDGE * _costs(stills, along),
            )
        )
    for thing, matte in zip(arrangement.things, mattes, strict=True):
        thing.matte = matte


class _Layer(NamedTuple):
    """Light of a layer along a thing."""

    light: np.ndarray
    doubt: np.ndarray  # Squared error of it, that all frames share


def _cover(stills: Stills, along: Along, own: _Layer, behind: _Layer) -> tuple[Mask, Mask]:
    r"""The cover $c$ of each pixel, as $\tfrac12 q c^2 - r c$ less the logarithm of a likelihood.

    Where the light of both layers is known, $q$ is the sum of the squares of their contrast. Where
    it was filled in, that of the thing is as far off in all frames: the curvature is less, and the
    ends $c = 0, 1$ lie as far apart as the likelihoods of a pixel without and with the thing.

    Args:
        stills: The frames.
        along: The frames along the thing.
        own: The thing.
        behind: What is behind it, in each frame.

    Returns:
        $q$ and $r$.
    """
    contrast, level = own.light - behind.light, np.maximum(own.light, behind.light)
    noise = np.stack([stills.noise(each, k) for k, each in enumerate(level)])
    # Light of a slope is off by where it is taken.
    slope = _square_slope(own.light) + np.stack([_square_slope(one) for one in behind.light])
    noise = noise * (1 + 1.5 / stills.count) + _OFF**2 * slope
    doubtful = noise + behind.doubt
    weight, doubted = along.seen / noise, along.seen / doubtful

    def left(worth: np.ndarray, one: np.ndarray) -> Mask:
        """Sum of squares, less what light that is off alike in all would explain."""
        common = own.doubt / (1 + own.doubt * np.sum(worth, axis=0))
        return np.sum(worth * one**2, axis=0) - common * np.sum(worth * one, axis=0) ** 2

    bare = doubted * (along.frames - behind.light) ** 2 + along.seen * np.log(doubtful / noise)
    covered = left(weight, along.frames - own.light)
    covered = covered + np.log1p(own.doubt * np.sum(weight, axis=0))
    lead, square = np.sum(bare, axis=0) - covered, left(doubted, contrast)
    scale = np.minimum(1, _GREATEST / np.maximum(np.maximum(square, np.abs(lead)), 1e-9))
    return scale * square, scale * (square + lead) / 2


def _square_slope(light: np.ndarray) -> np.ndarray:
    return sum(each**2 for each in np.gradient(light))  # type: ignore[return-value]


def _doubt(light: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Squared error of light that was filled in, by how much it varies where it is known."""
    near = np.maximum(smoothed(known.astype(np.float32), _NEAR), 1e-6)
    mean, square = (smoothed(np.where(known, x, 0), _NEAR) / near for x in (light, light**2))
    away = np.asarray(ndimage.distance_transform_edt(~known)) if known.any() else np.inf
    return _SHARE * np.maximum(square - mean**2, 0) * np.minimum(away / _NEAR, 1)


def _solved(
    where: tuple[Window, Mask],
    matte: Mask,
    blur: Float[np.ndarray, "2"],
    cover: tuple[Mask, Mask],
    costs: Mask,
) -> Mask:
    """The matte of least misfit and few edges, with edges as sharp as a pixel's."""
    window, near = where
    part = window.of(matte)
    shape = part.shape
    size = tuple(n + 32 for n in shape)
    down, across = np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])
    box = np.sinc(down * blur[0] + across * blur[1]).astype(np.float32)

    def blurred(mask: Mask) -> Mask:
        return irfftn(rfftn(np.pad(mask, 16)) * box, size)[16:-16, 16:-16]

    square, cross = (each.astype(np.float32) for each in cover)
    step = 1 / (float(square.max()) / 2 + 4)
    slope = lambda u: near * blurred(blurred(u) * square - cross)  # noqa: E731
    solved = of_few_edges(part, slope, costs, step, 60)
    return window.placed(sharp(np.where(near > 0, solved, part)), matte.shape)


def sharp(mask: Mask) -> Mask:
    """A matte whose edges are those of a mask, as sharp as a pixel's."""
    # A step that is seen through a Gaussian says where it is.
    through = np.clip(smoothed(mask, _SHARP), 1e-4, 1 - 1e-4)
    distance = erfinv(2 * through - 1) * np.sqrt(2 * (_SHARP**2 + 1 / 12))
    return np.clip(0.5 + distance, 0, 1).astype(np.float32)
