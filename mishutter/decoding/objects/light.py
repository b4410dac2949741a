r"""The light of all layers at once, by what every frame sees of them.

Frame $k$ is $g_k = \gamma_k\,(P b) + \sum_l \phi_{lk}\,R_{lk}(m_l a_l) + \text{noise}$: the
background's light $b$ behind the pixel's aperture $P$, where the share $\gamma_k$ of a pixel is
clear, and the light $a_l$ of each thing within its matte $m_l$, through the response $R_{lk}$ of
its way up to the frame, and within its exposure, as far as those in front leave a share
$\phi_{lk}$. Where the sensor moves the background has a response as well, and a frame is the mean
over parts of its exposure, so short that what is hidden hardly changes in each.
Of pictures of the power $S$ the likeliest are the minimum of

$$\sum_k |g_k - A_k(b, a)|^2/N_k + \sum_l \sum |\hat a_l|^2/S ,$$

which conjugate gradients find. Total variation and denoisers have the same misfit. What they take
for the noise of a pixel is the error that the frames leave there which see it,
$E(\rho) = \operatorname{mean}\,S/(1 + \rho S)$ of the density $\rho = \sum_k 1/N_k$.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Int

from mishutter.camera.responses import frequencies_on
from mishutter.camera.rows import irfftn, rfftn
from mishutter.decoding.decoders.base import AbstractDecoder
from mishutter.decoding.decoders.linear import mean_over_dft
from mishutter.decoding.decoders.plug_and_play import PlugAndPlayDecoder
from mishutter.decoding.decoders.total_variation import (
    EDGES,
    SMOOTH,
    THRESHOLD,
    TotalVariationDecoder,
)
from mishutter.decoding.objects.arrangement import Arrangement
from mishutter.decoding.objects.grids import Mask
from mishutter.decoding.objects.stills import Stills
from mishutter.pictures.registration.windows import Window, smoothed

OnCanvas = Callable[[tuple[int, int]], np.ndarray]
"""Numbers on half of the DFT of a canvas of so many rows and columns."""
Layers = list[np.ndarray]
"""Light of the background and of each thing, each on its own canvas."""

_BORDER = 16
"""Pixels of a canvas about a layer, which keep its ends apart."""
_TOLERANCE = 1e-3
"""Residual at which conjugate gradients end, as a share of the first one: larger ones show as
ripples in bright light."""
_LEVELS = 3
"""Levels of noise, at most, at which a denoiser is called for a layer."""
WEAK = 0.02
"""Share of the prior where layers are to explain frames."""
_TAPER = 4.0
"""Gaussian under which the outline of a layer is no edge of its light; px."""
_BANDS = 5
"""Bands of frequencies in which a layer's own detail is measured."""
_LEAST_SPACE = 200.0
"""Pixels in which no detail can be measured."""
_LEAST_DETAIL = 1e-3
"""Least detail beside that which is expected, and one over the most."""


class Knowledge(NamedTuple):
    """The statistics of pictures, and the response of the sensor's pixels."""

    power: OnCanvas  # Mean of its DFT is the variance; white = 1
    aperture: OnCanvas  # Response of a pixel behind the lens


class Sheet(NamedTuple):
    """A layer on a canvas of its own."""

    window: Window  # Place of the canvas at the time 0
    matte: Mask  # On the canvas; 1 for the background
    # Of each part of the frames, or one for all where nothing moves
    responses: Complex[np.ndarray, "parts m k"]
    ways: Int[np.ndarray, "parts 2"]  # Way in whole pixels until each part
    # The same of whole frames
    of_frames: Complex[np.ndarray, "frames m k"]
    until: Int[np.ndarray, "frames 2"]
    power: Float[np.ndarray, "m k"]

    @property
    def size(self) -> tuple[int, int]:
        """Pixels of the canvas."""
        return self.window.rows, self.window.columns

    def spectrum(self, light: np.ndarray) -> np.ndarray:
        """Half of the DFT of what the layer emits."""
        return rfftn(self.matte * light)

    def shown(self, spectrum: np.ndarray, part: int) -> np.ndarray:
        """Light of the layer in a part of a frame."""
        return irfftn(spectrum * self.responses[part % len(self.responses)], self.size)

    def gathered(self, shown: Sequence[np.ndarray]) -> np.ndarray:
        """The adjoint of `shown`, of all parts, on the layer's pixels."""
        if len(self.responses) == 1:
            total = np.conj(self.responses[0]) * rfftn(sum(shown))
        else:
            pairs = zip(self.responses, shown, strict=True)
            total = sum(np.conj(one) * rfftn(part) for one, part in pairs)
        return self.matte * irfftn(total, self.size)

    def filtered(self, light: np.ndarray, response: np.ndarray) -> np.ndarray:
        """Light through a real response on the canvas."""
        return irfftn(rfftn(light) * response, self.size)


@dataclass(frozen=True, eq=False)
class Sight:
    """The parts of layers that frames see."""

    stills: Stills
    sheets: list[Sheet]  # The background, then the things
    shares: list[list[np.ndarray]]  # Share of each sheet's pixels that each part of frames sees
    inverse: Float[np.ndarray, "frames rows columns"]  # 1 over the noise
    means: list[float]  # Level of each sheet about which its light is sought

    @staticmethod
    def of(stills: Stills, arrangement: Arrangement | None, known: Knowledge) -> "Sight":
        """That of the things of an arrangement, or of one picture at rest."""
        inverse = np.stack(
            [
                1 / stills.noise(np.maximum(smoothed(one, 1.5), 0), k)
                for k, one in enumerate(stills.light)
            ]
        ).astype(np.float32)
        ground = _ground(stills, known)
        sheets = [ground]
        if arrangement is not None:
            sheets += [
                _sheet(stills, thing.matte, thing.velocity, known) for thing in arrangement.things
            ]
        order = [] if arrangement is None else arrangement.order
        shares = _shares(stills, sheets, order)
        pairs = zip(sheets, shares, strict=True)
        sheets = [_of_own_detail(sheet, seen, stills) for sheet, seen in pairs]
        means = [_mean(sheet, seen, stills) for sheet, seen in zip(sheets, shares, strict=True)]
        return Sight(stills, sheets, shares, inverse, means)

    def along(
        self, number: int, velocity: np.ndarray, order: list[int], known: Knowledge
    ) -> "Sight":
        """That where one of the things moves at another velocity, on the same canvas."""
        sheets, own = self.sheets.copy(), self.sheets[number + 1]
        sheets[number + 1] = _moving(self.stills, own.window, own.matte, velocity, known)
        return replace(self, sheets=sheets, shares=_shares(self.stills, sheets, order))

    def frames(self, layers: Layers) -> np.ndarray:
        """Light of the frames that layers give, in which the mean level counts as they do."""
        total = np.zeros(self.stills.light.shape, np.float32)
        for sheet, shares, light in zip(self.sheets, self.shares, layers, strict=True):
            spectrum = sheet.spectrum(light)
            same = sheet.shown(spectrum, 0) if len(sheet.responses) == 1 else None
            for k, part in enumerate(self.stills.parts):
                shown = sheet.shown(spectrum, k) if same is None else same
                seen = np.float32(part.share) * shares[k] * shown
                sheet.window.aside(sheet.ways[k]).add(total[part.frame], seen)
        return total

    def layers(self, frames: np.ndarray) -> Layers:
        """The adjoint of `frames`."""
        gathered = []
        for sheet, shares in zip(self.sheets, self.shares, strict=True):
            each = zip(self.stills.parts, sheet.ways, shares, strict=True)
            parts = [
                np.float32(part.share) * share * sheet.window.aside(way).cut(frames[part.frame])
                for part, way, share in each
            ]
            gathered.append(sheet.gathered(parts))
        return gathered

    def densities(self) -> Layers:
        r"""Signal by noise of each layer's pixels, $\sum_k 1/N_k$ of what frames see of them."""
        found = []
        for sheet, shares in zip(self.sheets, self.shares, strict=True):
            total = np.zeros(sheet.size, np.float32)
            for k, seen in enumerate(in_frames(self.stills, shares)):
                here = sheet.window.aside(sheet.until[k]).cut(self.inverse[k])
                total += seen**2 * here
            found.append(total * sheet.matte**2)
        return found


def _shares(stills: Stills, sheets: list[Sheet], order: list[int]) -> list[list[np.ndarray]]:
    """Share of each sheet's pixels that each part of frames sees, of things in an order."""
    clear = [np.ones(stills.shape, np.float32) for _ in stills.parts]
    shares: list[list[np.ndarray]] = [[] for _ in sheets]
    for number in order:
        sheet = sheets[number + 1]
        opacity = rfftn(sheet.matte)
        for k, way in enumerate(sheet.ways):
            here = sheet.window.aside(way)
            shares[number + 1].append(here.cut(clear[k]))
            cover = np.clip(sheet.shown(opacity, k), 0, 1)
            less = np.ones_like(clear[k])
            here.add(less, -cover)
            clear[k] *= less
    ground = sheets[0]
    shares[0] = [
        ground.window.aside(way).cut(one) for way, one in zip(ground.ways, clear, strict=True)
    ]
    return shares


def in_frames(stills: Stills, shares: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Shares of a layer's pixels that frames see, by those of their parts."""
    seen = [np.zeros_like(shares[0]) for _ in range(stills.count)]
    for part, share in zip(stills.parts, shares, strict=True):
        seen[part.frame] += np.float32(part.share) * share
    return seen


def _canvas(window: Window) -> Window:
    """A part of a picture with a border and a size of which the DFT is fast."""
    wide = window.wider(_BORDER)
    rows, columns = (scipy.fft.next_fast_len(n, real=True) for n in wide[2:])
    return wide._replace(rows=rows, columns=columns)


def _ground(stills: Stills, known: Knowledge) -> Sheet:
    """The sheet of a picture at rest."""
    none, window = np.zeros(2), Window.whole(stills.shape)
    if stills.rests.all() and not np.any(stills.ways(none)):
        window = _canvas(window)
        size = window.rows, window.columns
        response = known.aperture(size).astype(np.complex64)[None]
        matte, ways = np.ones(size, np.float32), np.zeros((stills.count, 2), int)
        power = known.power(size).astype(np.float32)
        return Sheet(window, matte, response, ways, response, ways, power)
    reach = math.ceil(max(float(np.max(np.abs(part.way(none)))) for part in stills.parts)) + 2
    window = _canvas(window.wider(reach))
    matte = np.ones((window.rows, window.columns), np.float32)
    return _moving(stills, window, matte, none, known)


def _sheet(stills: Stills, matte: Mask, velocity: np.ndarray, known: Knowledge) -> Sheet:
    """The sheet of a thing."""
    blurs = [float(np.hypot(*part.blur(velocity))) for part in stills.parts]
    window = _canvas(Window.around(matte, 2).wider(math.ceil(max(blurs) / 2)))
    own = window.cut(matte.astype(np.float32))
    return _moving(stills, window, own, velocity, known)


def _moving(
    stills: Stills, window: Window, matte: Mask, velocity: np.ndarray, known: Knowledge
) -> Sheet:
    """The sheet of what moves on the sensor."""
    size = window.rows, window.columns
    (down, across), aperture = frequencies_on(size), known.aperture(size)
    ways = np.array([part.way(velocity) for part in stills.parts])
    whole, until = (np.floor(x).astype(int) for x in (ways, stills.ways(velocity)))
    responses, of_frames = [], [np.zeros(1)] * stills.count
    for part, way, first in zip(stills.parts, ways, whole, strict=True):
        rest, blur = way - first, part.blur(velocity)
        turns = down * rest[0] + across * rest[1]
        passed = aperture * np.sinc(down * blur[0] + across * blur[1])
        responses.append((passed * np.exp(-2j * np.pi * turns)).astype(np.complex64))
        aside = first - until[part.frame]
        turns = down * aside[0] + across * aside[1]
        own = part.share * responses[-1] * np.exp(-2j * np.pi * turns)
        of_frames[part.frame] = of_frames[part.frame] + own.astype(np.complex64)
    power = known.power(size).astype(np.float32)
    return Sheet(window, matte, np.stack(responses), whole, np.stack(of_frames), until, power)


def _mean(sheet: Sheet, shares: list[np.ndarray], stills: Stills) -> float:
    """Mean light of a layer, where frames see it."""
    light, seen = 0.0, 1e-9
    for k, share in enumerate(in_frames(stills, shares)):
        weight = (sheet.matte * share) ** 4 * stills.weights[k]
        light += float(np.sum(weight * sheet.window.aside(sheet.until[k]).cut(stills.light[k])))
        seen += float(np.sum(weight))
    return light / seen if seen > 1e-6 else float(np.mean(stills.light))


def _of_own_detail(sheet: Sheet, shares: list[np.ndarray], stills: Stills) -> Sheet:
    r"""A sheet with the power that its layer shows, band by band.

    Noise is independent from frame to frame: products of two are, but for it, those of the
    picture, $\sum_{j \ne k} \bar R_j\hat g_j R_k\bar{\hat g_k}$ of $S \sum_{j \ne k}|R_j R_k|^2$.
    Of one frame the noise is subtracted.
    """
    taper = smoothed(sheet.matte * (np.max(shares, axis=0) > 0), _TAPER)
    taper = np.clip(2 * taper - 1, 0, 1)
    space = float(np.sum(taper**2))
    if space < _LEAST_SPACE:
        return sheet
    gathered, alone, density, own = 0.0, 0.0, 0.0, 0.0
    for k, share in enumerate(in_frames(stills, shares)):
        light = sheet.window.aside(sheet.until[k]).cut(stills.light[k])
        weight = taper * share
        level = float(np.sum(weight * light) / max(float(np.sum(weight)), 1e-9))
        response = sheet.of_frames[k % len(sheet.of_frames)]
        shown = np.conj(response) * rfftn(weight * (light - level)) * stills.weights[k]
        passed = np.abs(response) ** 2 * stills.weights[k]
        gathered, density = gathered + shown, density + passed
        noise = space * float(stills.noise(np.float32(level), k)) * np.abs(response) ** 2
        alone = alone + (np.abs(shown) ** 2 if stills.count > 1 else noise)
        own = own + (passed**2 if stills.count > 1 else 0.0)
    shown, told = np.abs(gathered) ** 2 - alone, space * sheet.power * (density**2 - own)
    down, across = frequencies_on(sheet.size)
    radius = np.hypot(down, across)
    edges = np.geomspace(max(2 / math.sqrt(space), 0.01), 0.5, _BANDS + 1)
    places, scales = [], []
    for low, high in itertools.pairwise(edges.tolist()):
        inside = (radius >= low) & (radius < high)
        ratio = float(np.sum(shown[inside]) / max(float(np.sum(told[inside])), 1e-30))
        places.append(math.log(math.sqrt(low * high)))
        scales.append(math.log(min(max(ratio, _LEAST_DETAIL), 1 / _LEAST_DETAIL)))
    scale = np.exp(np.interp(np.log(np.maximum(radius, 1e-6)), places, scales))
    return sheet._replace(power=(sheet.power * scale).astype(np.float32))


@dataclass(frozen=True, eq=False)
class Misfit:
    """The misfit of layers, and the errors that the likeliest ones are expected to have."""

    sight: Sight
    data: Layers  # What frames tell of the layers, about the mean level
    densities: Layers
    errors: Layers  # Expected squared error of each pixel by the likeliest layers

    @staticmethod
    def of(sight: Sight) -> "Misfit":
        """That of the frames."""
        pairs = zip(sight.sheets, sight.means, strict=True)
        level = sight.frames([np.full(sheet.size, mean, np.float32) for sheet, mean in pairs])
        data = sight.layers(sight.inverse * (sight.stills.light - level))
        densities = sight.densities()
        pairs = zip(sight.sheets, densities, strict=True)
        errors = [_expected(sheet, density) for sheet, density in pairs]
        return Misfit(sight, data, densities, errors)

    def curvature(self, layers: Layers) -> Layers:
        """The curvature of the misfit, applied to layers."""
        return self.sight.layers(self.sight.inverse * self.sight.frames(layers))

    def preconditioner(self, prior: "Prior") -> Layers:
        """Responses on the canvases that nearly undo the curvature of the misfit and a prior."""
        pairs = zip(self.densities, prior.responses, strict=True)
        return [1 / (float(np.mean(density)) + response) for density, response in pairs]

    def solved(self, target: Layers, start: Layers, prior: "Prior", *, most: int = 200) -> Layers:
        """The layers whose misfit and prior balance a target, by conjugate gradients."""
        sheets, layers = self.sight.sheets, [one.copy() for one in start]
        inverses = self.preconditioner(prior)

        def image(of: Layers) -> Layers:
            return [a + b for a, b in zip(self.curvature(of), prior.of(sheets, of), strict=True)]

        def turned(of: Layers) -> Layers:
            each = zip(sheets, of, inverses, strict=True)
            return [sheet.filtered(one, inverse) for sheet, one, inverse in each]

        residual = [a - b for a, b in zip(target, image(layers), strict=True)]
        step = turned(residual)
        size = _product(residual, step)
        least = _TOLERANCE**2 * _product(target, turned(target))
        for _ in range(most):
            if size <= least:
                break
            along = image(step)
            stride = size / _product(step, along)
            layers = [a + stride * b for a, b in zip(layers, step, strict=True)]
            residual = [a - stride * b for a, b in zip(residual, along, strict=True)]
            other = turned(residual)
            following = _product(residual, other)
            step = [a + following / size * b for a, b in zip(other, step, strict=True)]
            size = following
        return layers

    def likeliest(self, target: Layers, share: float = 1.0) -> Layers:
        """The layers of least misfit and a share of the prior of pictures, for a target."""
        prior = Prior([share / sheet.power for sheet in self.sight.sheets], share)
        return self.solved(target, [np.zeros_like(one) for one in target], prior)


class Prior(NamedTuple):
    """A quadratic prior: through a response on the canvas, and a weight of each pixel beside it."""

    responses: Layers  # Mean curvature at each frequency, both parts together
    share: float = 1.0  # Of the inverse power
    # Weight of the light of each pixel, or of its differences
    weights: Layers | None = None
    differences: bool = False

    def of(self, sheets: list[Sheet], layers: Layers) -> Layers:
        """The prior's curvature on layers."""
        found = []
        for number, (sheet, light) in enumerate(zip(sheets, layers, strict=True)):
            own = sheet.filtered(light, self.share / sheet.power)
            if self.weights is not None:
                weight = self.weights[number]
                if self.differences:
                    own = own + pulled(weight * steps(light))
                else:
                    own = own + weight * light
            found.append(own)
        return found


def _product(one: Layers, other: Layers) -> float:
    return sum(float(np.vdot(a, b)) for a, b in zip(one, other, strict=True))


def _expected(sheet: Sheet, density: np.ndarray) -> np.ndarray:
    """Squared error that the likeliest picture is expected to leave, by its density."""
    response = np.mean(np.abs(sheet.of_frames) ** 2, axis=0)
    most = max(float(density.max()), 1e-6)
    grid = most * np.geomspace(1e-4, 1, 13)
    levels = [_error(sheet, response, each) for each in grid.tolist()]
    nearest = np.log(np.maximum(density, grid[0]))
    return np.exp(np.interp(nearest, np.log(grid), np.log(levels))).astype(np.float32)


def _error(sheet: Sheet, response: np.ndarray, density: float) -> float:
    return float(mean_over_dft(sheet.power / (1 + sheet.power * response * density), *sheet.size))


def steps(light: np.ndarray) -> Float[np.ndarray, "2 m n"]:
    """Differences between neighbours, down and across."""
    return np.stack([np.roll(light, -1, axis) - light for axis in (0, 1)])


def pulled(differences: Float[np.ndarray, "2 m n"]) -> np.ndarray:
    """The adjoint of `steps`."""
    return sum(np.roll(one, 1, axis) - one for axis, one in enumerate(differences))  # type: ignore[return-value]


def light_of(misfit: Misfit, decoder: AbstractDecoder) -> Layers:
    """Light of the layers by a decoder, white = 1."""
    means, start = misfit.sight.means, misfit.likeliest(misfit.data)
    if isinstance(decoder, TotalVariationDecoder):
        start = _by_total_variation(misfit, decoder, start)
    elif isinstance(decoder, PlugAndPlayDecoder):
        start = _by_denoiser(misfit, decoder, start)
    return [one + np.float32(mean) for one, mean in zip(start, means, strict=True)]


def explaining(misfit: Misfit) -> Layers:
    """Light by which the layers explain the frames as well as they may, noise included."""
    found = zip(misfit.likeliest(misfit.data, WEAK), misfit.sight.means, strict=True)
    return [one + np.float32(mean) for one, mean in found]


def _by_total_variation(misfit: Misfit, decoder: TotalVariationDecoder, start: Layers) -> Layers:
    """The minimum of `TotalVariationDecoder`, where each pixel has an error of its own."""
    sheets, errors = misfit.sight.sheets, misfit.errors
    weights = [EDGES * decoder.strength / THRESHOLD / error for error in errors]
    thresholds = [THRESHOLD * np.sqrt(error) for error in errors]
    responses = []
    for sheet, weight in zip(sheets, weights, strict=True):
        down, across = frequencies_on(sheet.size)
        turns = 4 - 2 * np.cos(2 * np.pi * down) - 2 * np.cos(2 * np.pi * across)
        responses.append(SMOOTH / sheet.power + float(np.mean(weight)) * turns.astype(np.float32))
    prior = Prior(responses, SMOOTH, weights, differences=True)
    layers, splits = start, [steps(one) for one in start]
    duals = [np.zeros_like(one) for one in splits]
    for _ in range(decoder.num_iterations):
        each = zip(misfit.data, weights, splits, duals, strict=True)
        target = [data + pulled(weight * (split - dual)) for data, weight, split, dual in each]
        layers = misfit.solved(target, layers, prior, most=3)
        for number, light in enumerate(layers):
            gap = steps(light) + duals[number]
            size = np.sqrt(np.sum(gap**2, axis=0))
            short = np.maximum(1 - thresholds[number] / np.maximum(size, 1e-12), 0)
            splits[number] = gap * short
            duals[number] = gap - splits[number]
    return layers


def _by_denoiser(misfit: Misfit, decoder: PlugAndPlayDecoder, start: Layers) -> Layers:
    """The steps of `PlugAndPlayDecoder`, where each pixel has an error of its own."""
    layers, means, sheets = start, misfit.sight.means, misfit.sight.sheets
    for fall in decoder.falling.tolist():
        weights = [decoder.strength / (fall**2 * error) for error in misfit.errors]
        flat = [
            np.full_like(s.power, float(np.mean(w))) for s, w in zip(sheets, weights, strict=True)
        ]
        prior = Prior(flat, 0.0, weights)
        each = zip(misfit.data, weights, layers, strict=True)
        target = [data + weight * light for data, weight, light in each]
        layers = misfit.solved(target, layers, prior, most=6)
        layers = [
            _denoised(decoder, light + mean, fall * np.sqrt(error), sheet.matte) - mean
            for light, error, sheet, mean in zip(layers, misfit.errors, sheets, means, strict=True)
        ]
    return layers


def _denoised(
    decoder: PlugAndPlayDecoder, light: np.ndarray, sigma: np.ndarray, matte: Mask
) -> np.ndarray:
    """A denoised layer, each pixel at the level of noise nearest to its own."""
    inside = np.log(sigma[matte > 0.01])
    low, high = float(inside.min()), float(inside.max())
    count = min(_LEVELS, 1 + round((high - low) / math.log(1.5)))
    levels = np.linspace(low, high, 2 * count + 1)[1::2]
    nearest = np.argmin(np.abs(np.log(sigma)[..., None] - levels), axis=-1)
    out = light.copy()
    for number, level in enumerate(np.exp(levels).tolist()):
        mask = nearest == number
        if mask.any():
            part = Window.around(mask, _BORDER)
            clean = decoder.denoised(part.of(light).astype(np.float64), level)
            part.of(out)[part.of(mask)] = clean[part.of(mask)]
    return out
