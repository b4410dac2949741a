r"""The expected capture of a picture of two layers, of which one hides part of the other.

The objects, of share $p$ and speed $s_1$, lie in front of a background of speed $s_0$. The matte
that says where they are is random, with exponential widths of mean $W$:
$S_m(g) = p(1 - p)\,2\ell/(1 + (2\pi g\ell)^2)$, $\ell = W(1 - p)$. With the texture $S$ of both
layers, whose means are $\Delta\mu$ apart, the picture has three uncorrelated parts: the objects,
of power $S_o = p^2 S + S * S_m + (\Delta\mu)^2 S_m$, which move at $s_1$; the background,
$(1 - p)^2 S$, at $s_0$; and their beat, in which a wave of the background at $f - g$ times one of
the matte at $g$ has the frequency $f$ and moves at the effective speed $s_0 + (g/f)(s_1 - s_0)$.
A capture of a rigid texture is known by its transfer function $H_s(f)$, and so is that of the beat:
it is the capture of many speeds, with weights that depend on the frequency,
$\int S(f - g)\,S_m(g)\,|H_{s_0 + (g/f)(s_1 - s_0)}|^2\,dg = S_r \sum_k W_k |H_{s_k}|^2$ at $f$.
The integral is by Gauss-Legendre rules about the two peaks of its integrand, and the transfer
functions at its nodes are interpolated from those at $s_k$, which lie densely between the layers'
speeds and ever more sparsely beyond. To all other parts the beat is one more, with the moments of
its own. These change slowly with the frequency, so that a search computes them at few frequencies,
densest at the lowest, and interpolates.

The decoder wants both layers sharp, each displaced as kernels are aligned, by $D(s)$. In the mean
response the weights of aligned transfer functions hence have the phases
$e^{-2\pi i f[(1 - u)D(s_0) + u D(s_1) - D(s_k)]}$, $u = (s_k - s_0)/(s_1 - s_0)$.
"""

import math
from collections.abc import Callable
from functools import lru_cache, reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from mishutter._core.compiling import compiled
from mishutter.evaluation.ensembles import at_each_error, error_weights, without_tolerances
from mishutter.model.motion import AbstractMotion
from mishutter.model.occlusion import LayerShares, Occlusion
from mishutter.model.optics import NUM_FREQUENCIES
from mishutter.model.scene import Scene, picture_power
from mishutter.model.texture import CORNER_FREQUENCY

LEAST_EFFECTIVE_SPEEDS = 129
"""Least number of effective speeds that an expected error takes."""
_LEAST_OF_MANY_PAIRS = 65
"""Least number of them where pairs of speeds are so many that their table would not fit."""
SEARCHED_EFFECTIVE_SPEEDS = 25
"""Number of effective speeds that a search takes; its design is measured with all of them. The
error is exact to 0.1 dB, and to 0.25 dB where optics are soft."""
_EVEN_BELOW = 0.02
"""Frequency below which the frequencies of a search lie in even steps, cycles/px."""
_NEIGHBOURS = 6
"""Effective speeds, or frequencies, that a value is interpolated from."""


Wave = tuple[Array, Array]
"""Cosine and sine of a wave."""


class _Fineness(NamedTuple):
    """Numbers by which the beat is sampled; static."""

    num_speeds: int  # Number of effective speeds, odd
    furthest: float  # The furthest of them, in half ranges of the layers' speeds
    growth: float  # Logarithm by which steps grow up to it, about
    num_knots: int | None  # Number of frequencies that it is computed at, at most; None for all

    @staticmethod
    def of(count: int, num_pairs: int) -> "_Fineness":
        """The fineness of so many effective speeds, or as many as their table can hold.

        Speeds beyond the furthest of a search are of the beat at the lowest frequencies alone.
        """
        if count <= SEARCHED_EFFECTIVE_SPEEDS:
            return _Fineness(SEARCHED_EFFECTIVE_SPEEDS, 4.0, 2.1, 24)
        # The table of 40,000 weights takes 80 MB at 256 frequencies.
        most = max(_LEAST_OF_MANY_PAIRS, 40_000 // num_pairs)
        count = min(max(count, _LEAST_OF_MANY_PAIRS), most)
        # The number is odd, so that one of the speeds is the middle one.
        return _Fineness((count - 1) | 1, 512.0, 7.7, None)

    def knots_among(self, number: int) -> tuple[int, ...] | None:
        """Places of the frequencies among so many, densest at the lowest; None for all."""
        if self.num_knots is None:
            return None
        first, last = _along_knots(np.array([0, number - 1]), number)
        steps = np.sinh(np.linspace(first, last, self.num_knots)) * _EVEN_BELOW
        return tuple(np.unique(np.round(2 * number * steps - 0.5).astype(int)).tolist())


def num_effective_speeds(travel: float) -> int:
    """Odd number of effective speeds by which an expected error is known to 1e-4 dB, as a rule."""
    every = _Fineness.of(LEAST_EFFECTIVE_SPEEDS, 1)
    finest = every.furthest * every.growth / math.sinh(every.growth)
    # Neighbours travel 0.8 px against each other in half the exposure.
    count = 1 + 2 * math.ceil(finest * travel / 0.8)
    return min(max(count, LEAST_EFFECTIVE_SPEEDS), 513)


class Frequencies(NamedTuple):
    """Frequencies in equal steps, cycles/px; static."""

    first: float  # The lowest
    step: float  # Step between neighbours
    number: int  # How many
    num_known: int  # Frequencies of the grid that the texture is known on

    @staticmethod
    def of_grid(num_frequencies: int) -> "Frequencies":
        """The grid of expected errors: centres of so many steps in (0, 0.5)."""
        step = 0.5 / num_frequencies
        return Frequencies(step / 2, step, num_frequencies, num_frequencies)

    @staticmethod
    def of_dft(length: int) -> "Frequencies":
        """The frequencies of the DFT of so many pixels, from 0."""
        return Frequencies(0.0, 1 / length, length // 2 + 1, NUM_FREQUENCIES)

    def values(self, dtype: np.dtype) -> np.ndarray:
        """The frequencies, of which 0 stands for one far below the others; shape `(m,)`."""
        every = self.first + self.step * np.arange(self.number)
        # An effective speed divides by the frequency.
        return np.maximum(every, self.step / 16).astype(dtype)


class Background(NamedTuple):
    """Speeds that a background may have, px/s, and how often each occurs; shape `(b,)` each."""

    speeds: Array | np.ndarray
    weights: Array | np.ndarray

    @staticmethod
    def of(scene: Scene) -> "Background":
        """The background of a scene, whose objects may be folded to one direction already."""
        occlusion: Occlusion = scene.occlusion  # type: ignore[assignment]
        if (shares := occlusion.shares) is not None:
            return Background(shares.background_speeds, shares.background_weights)
        if occlusion.background == "moving":
            return Background(scene.speeds, scene.weights)
        still = jnp.asarray(occlusion.background_speed, scene.speeds.dtype)[None]
        return Background(still, jnp.ones(1, scene.speeds.dtype))

    def behind(
        self,
        scene: Scene,
        grid: Frequencies | None = None,  # None for that of pictures
        num_effective_speeds: int = SEARCHED_EFFECTIVE_SPEEDS,  # 25, or 65 at least
        *,
        folds: bool = False,  # Whether `+s` and `-s` are taken for one effective speed
    ) -> Scene:
        """A scene of two layers that knows the `LayerShares` of its picture."""
        grid = grid or Frequencies.of_grid(NUM_FREQUENCIES)
        fineness = _Fineness.of(num_effective_speeds, scene.speeds.size * np.size(self.speeds))
        occlusion = scene.occlusion.with_shares(None)  # type: ignore[union-attr]
        shares = _shares(scene.with_occlusion(None), occlusion, self, grid, fineness, folds=folds)
        return scene.with_occlusion(occlusion.with_shares(shares))


@compiled
def _shares(
    scene: Scene,
    occlusion: Occlusion,
    background: Background,
    grid: Frequencies,
    fineness: _Fineness,
    *,
    folds: bool,
) -> LayerShares:
    dtype = np.dtype(scene.speeds.dtype)
    frequency = jnp.asarray(grid.values(dtype))
    power = picture_power(scene, grid.num_known, dtype)
    # Rounding must not cut off a frequency that lies at the cutoff.
    passes = frequency <= scene.optics.cutoff_frequency.astype(dtype) * (1 + 1e-6)
    texture = jnp.where(passes, _texture_at(power, frequency), 0)
    front = occlusion.front_share.astype(dtype)
    behind = 1 - front
    speeds, weights = (jnp.asarray(x, dtype) for x in background)
    nodes = _Nodes.of(scene, speeds, weights, fineness, folds=folds)
    knots = fineness.knots_among(grid.number)
    some = slice(None) if knots is None else np.array(knots)
    num_pairs = speeds.size, scene.speeds.size
    if occlusion.object_width is None:
        total, objects, own = texture, front * texture, behind * texture
        same = jnp.zeros_like(texture)
        beat = jnp.zeros((*num_pairs, 0, frequency[some].size), dtype)
        effective = jnp.zeros(0, dtype)
    else:
        width = occlusion.object_width.astype(dtype)
        # A matte that covers everything has no power, whatever its length, which must not be 0.
        length = width * jnp.where(behind > 0, behind, 1.0)

        def matte(frequency: Array) -> Array:
            """Power spectrum of the matte."""
            return front * behind * 2 * length / (1 + (2 * jnp.pi * frequency * length) ** 2)

        corner = 1 / (2 * jnp.pi * length)
        at_matte, step = _matte_rule(frequency, corner, scene.optics.cutoff_frequency)
        beside = _texture_at(power, frequency[:, None] - at_matte)
        mass = beside * matte(at_matte) * step
        same = jnp.sum(mass, axis=1)
        levels = occlusion.level_difference.astype(dtype) ** 2 * matte(frequency)
        objects = levels + front**2 * texture + same
        own = behind**2 * texture
        total = jnp.where(passes, objects + own + same, 0)
        ratio = at_matte / frequency[:, None]
        at_knots, ratio = mass[some], ratio[some]

        def pair(each: tuple[Array, Array]) -> Array:
            of_background, of_object = each
            difference = of_object - of_background
            # At equal speeds the beat moves as both layers do: `_texture_weights` counts it there.
            mass_of_beat = jnp.where(difference != 0, at_knots, 0)
            return nodes.shared(of_background + ratio * difference, mass_of_beat)

        pairs = jnp.meshgrid(speeds, scene.speeds.astype(dtype), indexing="ij")
        # Pairs of speeds are computed one at a time, which bounds the memory for their nodes.
        beat = jax.lax.map(pair, (pairs[0].ravel(), pairs[1].ravel()))
        beat = beat.reshape(*num_pairs, fineness.num_speeds, -1)
        effective = nodes.speeds
    divisor = jnp.where(total > 0, total, 1.0)
    whole = jnp.where(total > 0, 1 / divisor, 0)
    objects, own, same = (part * whole for part in (objects, own, same))
    return LayerShares(
        power=total,
        objects=objects,
        background=own,
        same=same,
        beat=beat * whole[some][None, None, None],
        background_speeds=speeds,
        background_weights=weights,
        speeds=effective,
        first=grid.first,
        step=grid.step,
        folds=folds,
        knots=knots,
    )


class _Nodes(NamedTuple):
    r"""Effective speeds $c + Rd\sinh(bk)/\sinh(bn)$, $k = -n \dots n$."""

    middle: Array  # $c$, px/s
    scale: Array  # $Rd/\sinh(bn)$, px/s
    growth: float  # $bn$
    num: int  # $2n + 1$

    @staticmethod
    def of(
        scene: Scene, speeds: Array, weights: Array, fineness: _Fineness, *, folds: bool
    ) -> "_Nodes":
        """Those about the speeds of a scene's objects and of its background."""
        every = jnp.concatenate([scene.speeds.astype(speeds.dtype), speeds])
        occurs = jnp.concatenate([scene.weights > 0, weights > 0])
        slowest = jnp.min(jnp.where(occurs, every, jnp.inf))
        fastest = jnp.max(jnp.where(occurs, every, -jnp.inf))
        if folds:  # the same in both directions
            fastest = jnp.maximum(jnp.abs(slowest), jnp.abs(fastest))
            slowest = -fastest
        half = (fastest - slowest) / 2
        scale = jnp.where(half > 0, half, 1.0) * (fineness.furthest / math.sinh(fineness.growth))
        return _Nodes((slowest + fastest) / 2, scale, fineness.growth, fineness.num_speeds)

    @property
    def speeds(self) -> Array:
        """The effective speeds, ascending; px/s, shape `(k,)`."""
        steps = np.arange(self.num) - self.num // 2
        places = np.sinh(steps * (self.growth / (self.num // 2)))
        return self.middle + self.scale * places.astype(self.middle.dtype)

    def shared(self, speed: Array, mass: Array) -> Array:
        """Sums of a mass at some speeds, `(m, g)`, shared among the neighbours; `(k, m)`."""
        rate = (self.num // 2) / self.growth
        place = jnp.arcsinh((speed - self.middle) / self.scale) * rate + self.num // 2
        first, shares = _interpolation(jnp.clip(place, 0, self.num - 1), self.num)
        rows = np.arange(speed.shape[0], dtype=np.int32)[:, None] * self.num
        index = rows + first
        total = jnp.zeros(speed.shape[0] * self.num, mass.dtype)
        for number, share in enumerate(shares):
            total = total.at[(index + number).ravel()].add((mass * share).ravel())
        return total.reshape(speed.shape[0], self.num).T


def _interpolation(place: Array, count: int) -> tuple[Array, list[Array]]:
    """First of the neighbours of places among so many numbers, and the share that each has of it.

    The polynomial of degree 5 through six of them (Lagrange).
    """
    first = jnp.clip(jnp.floor(place) - (_NEIGHBOURS // 2 - 1), 0, count - _NEIGHBOURS)
    t, each = place - first, range(_NEIGHBOURS)
    shares = []
    for own in each:
        others = [(t - other) / (own - other) for other in each if other != own]
        shares.append(reduce(jnp.multiply, others))
    return first.astype(np.int32), shares


def _matte_rule(frequency: Array, corner: Array, cutoff: Array) -> tuple[Array, Array]:
    """Nodes about the matte's peak at 0 and about the texture's, where it is at `frequency`.

    Frequencies of the matte, cycles/px, and their steps, for each frequency; `(m, g)` each.
    """
    rule = np.polynomial.legendre.leggauss(96)
    nodes, weights = (x[None].astype(frequency.dtype) for x in rule)
    f, cutoff = frequency[:, None], cutoff.astype(frequency.dtype)
    # Beyond these the lens has taken all of the texture.
    low, high = f - cutoff, f + cutoff
    # Each peak has nodes up to half way to the other.
    between = jnp.clip(f / 2, low, high)

    def about(
        centre: Array, width: Array | float, ends: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        # In this coordinate a Lorentzian is smooth, its peak and its long tails alike.
        begin, end = (jnp.arcsinh((x - centre) / width) for x in ends)
        place = begin + (end - begin) * (nodes + 1) / 2
        step = width * jnp.cosh(place) * (end - begin) * weights / 2
        return centre + width * jnp.sinh(place), step

    of_matte = about(jnp.zeros_like(f), corner, (low, between))
    of_texture = about(f, CORNER_FREQUENCY, (between, high))
    places, steps = zip(of_matte, of_texture, strict=True)
    return jnp.concatenate(places, axis=1), jnp.concatenate(steps, axis=1)


def _texture_at(texture: Array, frequency: Array) -> Array:
    """Power spectrum of the texture at any frequencies, by interpolation on its grid."""
    # A power spectrum is even, so that polynomials may run on beyond either end.
    mirrored = jnp.concatenate([texture[:3][::-1], texture, texture[-2:][::-1]])
    place = jnp.abs(frequency) * (2 * texture.size) + 2.5
    first, shares = _interpolation(place, mirrored.size)
    values = [share * mirrored[first + number] for number, share in enumerate(shares)]
    # Beside a steep fall a polynomial may dip below 0.
    return jnp.maximum(reduce(jnp.add, values), 0)


def computed_speeds(scene: Scene) -> Array:
    """Speeds that transfer functions are computed at, px/s; shape `(r,)`.

    They are the scene's; of two layers, then that of a still background, then the effective.
    """
    shares = None if scene.occlusion is None else scene.occlusion.shares
    if shares is None:
        return scene.speeds
    more = shares.speeds[shares.speeds.size // 2 :] if shares.folds else shares.speeds
    if not _background_is_prior(scene):
        more = jnp.concatenate([shares.background_speeds, more])
    return jnp.concatenate([scene.speeds, more.astype(scene.speeds.dtype)])


def _background_is_prior(scene: Scene) -> bool:
    return scene.occlusion is not None and scene.occlusion.background == "moving"


class LayerMoments(NamedTuple):
    """Mean response and its spread, of all speeds of the objects together or of each."""

    mean: Complex[Array, "objects frequencies"]  # $m$, aligned; complex, shape `(o, m)`
    spread: Float[Array, "objects frequencies"]  # $v$: the power of a capture is $S_r(|m|^2 + v)$

    @staticmethod
    def of(
        scene: Scene, motion: AbstractMotion, spectra: Complex[Array, "rows kept"], *, of_each: bool
    ) -> "LayerMoments":
        r"""Moments of a capture of two layers, by transfer functions at the `computed_speeds`.

        $m = \sum W_r H_r + W_b m_b$ over the rigid textures and the beat, whose own moments $m_b$
        and $v_b$ are known at fewer frequencies, and
        $v = \sum W_r |H_r - m|^2 + W_b(|m_b - m|^2 + v_b)$; over the tolerances, each weight is
        that of an error too.
        """
        shares: LayerShares = scene.occlusion.shares  # type: ignore[union-attr]
        real, num_kept = np.dtype(spectra.real.dtype), spectra.shape[1]
        every = spectra.reshape(error_weights(scene).size, -1, num_kept)
        errors = jnp.asarray(error_weights(scene), real)
        textures, weight = _texture_weights(scene, num_kept, real, of_each=of_each)
        rows, beat_rows = every[:, : textures.shape[1]], every[:, textures.shape[1] :]
        shared = (x.astype(spectra.dtype) for x in (errors, textures))
        mean = jnp.einsum("e,orf,erf->of", *shared, rows)
        beat = None
        if shares.speeds.size:
            beat = _beat_moments(scene, motion, beat_rows, of_each=of_each)
            mean = mean + weight.astype(mean.dtype) * beat.mean
        # Deviations are squared, because where blurs are alike the mean of squares and the square
        # of the mean nearly cancel.
        deviations = _squared(rows[None] - mean[:, None, None])
        spread = jnp.einsum("e,orf,oerf->of", errors, textures, deviations)
        if beat is not None:
            spread = spread + weight * (_squared(beat.mean - mean) + beat.spread)
        return LayerMoments(mean, spread)

    @staticmethod
    def on_dft(
        scene: Scene,  # concrete
        motion: AbstractMotion,
        length: int,
        responses: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ) -> "LayerMoments":
        """Moments of a capture of two layers on the grid of a DFT; NumPy arrays of shape `(1, m)`.

        They are of the camera as it was designed, without the errors that its tolerances allow.
        """
        scene, grid = without_tolerances(scene), Frequencies.of_dft(length)
        # A filter of so many effective speeds is exact to 0.01 dB.
        scene = Background.of(scene).behind(scene, grid, 97)
        speeds = np.asarray(computed_speeds(scene))
        # The beat moves fast where its waves are long beside those of the matte, and there alone:
        # each speed occurs up to some frequency. The effective speeds come last among all.
        occurs = np.any(np.asarray(scene.occlusion.shares.beat) != 0, axis=(0, 1))  # type: ignore[union-attr]
        num_effective, number = occurs.shape
        counts = np.full(speeds.size, number)
        highest = number - np.argmax(occurs[:, ::-1], axis=1)
        counts[speeds.size - num_effective :] = np.where(np.any(occurs, axis=1), highest, 0)
        spectra = responses(speeds, counts)
        moments = _moments(scene, motion, jnp.asarray(spectra), of_each=False)
        return jax.tree.map(np.asarray, moments)


def _squared(value: Array) -> Array:
    return value.real**2 + value.imag**2


_moments = compiled(LayerMoments.of)


def _texture_weights(
    scene: Scene, num_kept: int, dtype: np.dtype, *, of_each: bool
) -> tuple[Float[Array, "moments rows kept"], Float[Array, "moments kept"]]:
    """Weights of the textures that move rigidly, `(o, r, f)`, and of the beat, `(o, f)`."""
    shares: LayerShares = scene.occlusion.shares  # type: ignore[union-attr]
    objects, own, same = (
        x[:num_kept].astype(dtype) for x in (shares.objects, shares.background, shares.same)
    )
    prior, behind = (x.astype(dtype) for x in (scene.weights, shares.background_weights))
    speeds, background = (x.astype(dtype) for x in (scene.speeds, shares.background_speeds))
    chosen = jnp.eye(speeds.size, dtype=dtype) if of_each else prior[None]
    apart = behind @ (background[:, None] != speeds[None]).astype(dtype)
    together = objects[None] + (jnp.sum(behind) - apart)[:, None] * same[None]
    together = chosen[:, :, None] * together[None]
    beat = (chosen @ apart)[:, None] * same[None]
    if _background_is_prior(scene):
        return together + prior[None, :, None] * own[None, None], beat
    alone = jnp.broadcast_to(own[None, None], (chosen.shape[0], background.size, num_kept))
    return jnp.concatenate([together, alone], axis=1), beat


def _beat_moments(
    scene: Scene,
    motion: AbstractMotion,
    spectra: Complex[Array, "errors nodes kept"],
    *,
    of_each: bool,
) -> LayerMoments:
    r"""Moments of the beat alone, $m_b = \sum V_k H_k$ and $v_b = \sum W_k|H_k|^2 - |m_b|^2$.

    $v_b = \sum W_k|H_k - m_b|^2 + 2\operatorname{Re}(\bar m_b\sum (W_k - V_k) H_k)$, where $V_k$ is
    $W_k$ with the phases of displaced layers.
    """
    shares: LayerShares = scene.occlusion.shares  # type: ignore[union-attr]
    dtype = np.dtype(spectra.real.dtype)
    knots = _Knots.of(shares, spectra.shape[2])
    prior, behind = (x.astype(dtype) for x in (scene.weights, shares.background_weights))
    beat = shares.beat[..., : knots.places.size].astype(dtype)
    nothing = jnp.zeros((error_weights(scene).size, *beat.shape[1:]), dtype)

    def added(sums: tuple[Array, ...], one: tuple[Array, ...]) -> tuple[tuple[Array, ...], None]:
        """Sums over the background's speeds; one at a time keeps waves in a processor's cache."""
        weight, of_one, distance = one
        weighted = (weight * of_one)[None]
        parts = weighted, *(weighted * part for part in knots.waves(distance, shares))
        return tuple(total + part for total, part in zip(sums, parts, strict=True)), None

    each = behind, beat, jnp.moveaxis(_distances(scene, motion, dtype), 1, 0)
    sums = jax.lax.scan(added, (nothing,) * 3, each)[0]
    if not of_each:
        sums = (jnp.sum(x * prior[None, :, None, None], axis=1, keepdims=True) for x in sums)
    power, real, imag = (_folded(x, shares) for x in sums)
    whole = jnp.sum(power, axis=2, keepdims=True)
    unit = 1 / jnp.where(whole > 0, whole, 1.0)
    weight = jnp.asarray(error_weights(scene), dtype)[:, None, None, None] * unit
    power, real, imag = (weight * x for x in (power, real, imag))
    response = knots.of_each(spectra)[:, None]
    mean = jnp.sum(jax.lax.complex(real, imag) * response, axis=(0, 2))
    missed = jnp.sum(jax.lax.complex(power - real, -imag) * response, axis=(0, 2))
    deviation = _squared(response - mean[None, :, None])
    spread = jnp.sum(power * deviation, axis=(0, 2))
    spread = spread + 2 * (mean.real * missed.real + mean.imag * missed.imag)
    return LayerMoments(*(knots.between(x) for x in (mean, spread)))


def _distances(
    scene: Scene, motion: AbstractMotion, dtype: np.dtype
) -> Float[Array, "errors background objects nodes"]:
    """Distances by which waves of the beat are displaced from where they are aligned; px."""
    shares: LayerShares = scene.occlusion.shares  # type: ignore[union-attr]
    parts = [x.astype(dtype) for x in (shares.background_speeds, scene.speeds, shares.speeds)]
    background, objects, nodes = parts
    ends, speeds = np.cumsum([background.size, objects.size]), jnp.concatenate(parts)

    def alignment(motion: AbstractMotion, speeds: Array) -> Array:
        return jnp.asarray(motion.alignment(speeds))

    if scene.tolerances is None:
        places = alignment(motion, speeds)[None]
    else:
        places = at_each_error(alignment, speeds, scene.tolerances, motion).reshape(-1, speeds.size)
    behind, front, between = jnp.split(-places, ends, axis=1)
    difference = objects[None] - background[:, None]
    moves = (difference != 0)[..., None]
    place = (nodes[None, None] - background[:, None, None]) / jnp.where(
        moves, difference[..., None], 1.0
    )
    place, moves = place[None], moves[None]
    of_layers = (1 - place) * behind[..., None, None] + place * front[:, None, :, None]
    return jnp.where(moves, of_layers - between[:, None, None], 0.0)


class _Knots(NamedTuple):
    """Frequencies at which the beat is computed, and polynomials that lead from one to the next."""

    places: np.ndarray  # Their places among all frequencies, ascending; shape `(c,)`
    shares: np.ndarray | None  # Their shares at each frequency, `(c, f)`; None if all are knots

    @staticmethod
    def of(shares: LayerShares, num_kept: int) -> "_Knots":
        """Those among so many frequencies, the lowest."""
        return _knots(shares.knots, shares.power.size, num_kept)

    def waves(self, distance: Array, shares: LayerShares) -> tuple[Array, Array]:
        """Cosine and sine of the waves that distances displace, px, `(..., c)`.

        Where each frequency is a knot, a wave is turned from one to the next: a product costs less
        than a cosine.
        """
        dtype = np.dtype(distance.dtype)
        if self.shares is not None:
            omega = -2 * np.pi * (shares.first + shares.step * self.places)
            angle = distance[..., None] * omega.astype(dtype)[(None,) * distance.ndim]
            return jnp.cos(angle), jnp.sin(angle)
        begin, step = (distance * (-2 * np.pi * f) for f in (shares.first, shares.step))
        c, s = jnp.cos(step), jnp.sin(step)

        def turned(wave: Wave, _: None) -> tuple[Wave, Wave]:
            cosine, sine = wave
            return (cosine * c - sine * s, sine * c + cosine * s), wave

        first = jnp.cos(begin), jnp.sin(begin)
        waves = jax.lax.scan(turned, first, None, self.places.size)[1]
        cosine, sine = (jnp.moveaxis(part, 0, -1) for part in waves)
        return cosine, sine

    def of_each(self, values: Array) -> Array:
        """Values at the knots by those at each frequency, the last axis."""
        return values if self.shares is None else values[..., self.places]

    def between(self, values: Array) -> Array:
        """Values at each frequency, `(o, f)`, by those at the knots, `(o, c)`; real or complex."""
        if self.shares is None:
            return values
        shares = self.shares.astype(values.real.dtype)
        if not jnp.iscomplexobj(values):
            return values @ shares
        return jax.lax.complex(values.real @ shares, values.imag @ shares)


def _along_knots(places: np.ndarray, number: int) -> np.ndarray:
    """Coordinate in which knots have equal steps: of a logarithm's, but at low frequencies."""
    return np.arcsinh((places + 0.5) / (2 * number * _EVEN_BELOW))


@lru_cache
def _knots(knots: tuple[int, ...] | None, number: int, num_kept: int) -> _Knots:
    if knots is None:
        return _Knots(np.arange(num_kept), None)
    places = np.array([place for place in knots if place < num_kept])
    along, every = (_along_knots(x, number) for x in (places, np.arange(num_kept)))
    count = min(_NEIGHBOURS, places.size)
    first = np.searchsorted(along, every) - count // 2
    near = np.clip(first, 0, places.size - count)[:, None] + np.arange(count)
    nodes = along[near]
    shares = np.zeros((places.size, num_kept))
    for own in range(count):
        others = np.delete(nodes, own, axis=1)
        share = np.prod((every[:, None] - others) / (nodes[:, own, None] - others), axis=1)
        shares[near[:, own], np.arange(num_kept)] = share
    return _Knots(places, shares)


def _folded(weights: Array, shares: LayerShares) -> Array:
    """Weights of effective speeds, `(..., k, f)`, those of both directions together."""
    if not shares.folds:
        return weights
    middle = shares.speeds.size // 2
    both = weights[..., middle + 1 :, :] + weights[..., :middle, :][..., ::-1, :]
    return jnp.concatenate([weights[..., middle : middle + 1, :], both], axis=-2)
