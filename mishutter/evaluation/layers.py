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
speeds and ever more sparsely beyond.

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

from mishutter._core import compiled
from mishutter.evaluation.ensembles import at_each_error, error_weights, without_tolerances
from mishutter.evaluation.power import picture_power
from mishutter.model import (
    CORNER_FREQUENCY,
    NUM_FREQUENCIES,
    AbstractMotion,
    LayerShares,
    Occlusion,
    Scene,
)

LEAST_EFFECTIVE_SPEEDS, _MOST_EFFECTIVE_SPEEDS = 129, 513
"""Numbers of effective speeds that an expected error takes, at least and at most."""
SEARCHED_EFFECTIVE_SPEEDS = 65
"""Number of effective speeds that a search takes; its design is measured with all of them. The
error is exact to 0.01 dB for designs worth building, and to 0.2 dB for exposures over which objects
travel 130 px."""
_BEAT_STEP = 0.8
"""Travel of neighbouring effective speeds against each other in half the exposure, px, by which an
expected error is known to 1e-4 dB."""
_EFFECTIVE_SPEEDS_OF_DECODERS = 97
"""Number of effective speeds that a decoder's filter takes; its error is exact to 0.01 dB."""
_MOST_WEIGHTS = 40_000
"""Effective speeds times pairs of speeds, at most: their table takes 80 MB at 256 frequencies."""
_FURTHEST, _GROWTH = 512.0, 7.7
"""The furthest effective speed, in half ranges of the layers' speeds, and the logarithm by which
steps grow up to it, about."""
_NEIGHBOURS = 6
"""Effective speeds that a transfer function is interpolated from."""
_NODES_A_PEAK = 96
"""Nodes of the quadrature about either peak of the beat."""


def num_effective_speeds(travel: float) -> int:
    """Odd number of effective speeds by which an expected error is known to 1e-4 dB, as a rule.

    Args:
        travel: Travel of the fastest layer in half the exposure, against the middle of all; px.
    """
    finest = _FURTHEST * _GROWTH / math.sinh(_GROWTH)
    count = 1 + 2 * math.ceil(finest * travel / _BEAT_STEP)
    return min(max(count, LEAST_EFFECTIVE_SPEEDS), _MOST_EFFECTIVE_SPEEDS)


class Frequencies(NamedTuple):
    """Frequencies in equal steps, cycles/px; static.

    Attributes:
        first: The lowest.
        step: Step between neighbours.
        number: How many.
        num_known: Frequencies of the grid that the texture is known on.
    """

    first: float
    step: float
    number: int
    num_known: int

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
        return np.maximum(every, self.step / 16).astype(dtype)


class Background(NamedTuple):
    """Speeds that a background may have, px/s, and how often each occurs; shape `(b,)` each."""

    speeds: Array | np.ndarray
    weights: Array | np.ndarray


def background_of(scene: Scene) -> Background:
    """The background of a scene, whose objects may be folded to one direction already."""
    occlusion: Occlusion = scene.occlusion  # type: ignore[assignment]
    if occlusion.shares is not None:
        return Background(occlusion.shares.background_speeds, occlusion.shares.background_weights)
    if occlusion.background == "moving":
        return Background(scene.speeds, scene.weights)
    still = jnp.asarray(occlusion.background_speed, scene.speeds.dtype)[None]
    return Background(still, jnp.ones(1, scene.speeds.dtype))


class LayerSampling(NamedTuple):
    """Frequencies and effective speeds at which the shares of two layers are computed; static.

    Attributes:
        grid: The frequencies.
        num_effective_speeds: How many effective speeds; a table takes 65 at least.
        folds: Whether `+s` and `-s` are taken for one effective speed.
    """

    grid: Frequencies
    num_effective_speeds: int = SEARCHED_EFFECTIVE_SPEEDS
    folds: bool = False

    def within_memory(self, num_pairs: int) -> "LayerSampling":
        """The sampling with an odd number of effective speeds, whose table has a bounded size.

        Args:
            num_pairs: Number of pairs of a speed of the objects and one of the background.
        """
        most = max(SEARCHED_EFFECTIVE_SPEEDS, _MOST_WEIGHTS // num_pairs)
        count = min(max(self.num_effective_speeds, SEARCHED_EFFECTIVE_SPEEDS), most)
        return self._replace(num_effective_speeds=(count - 1) | 1)


def with_shares(
    scene: Scene, background: Background, sampling: LayerSampling | None = None
) -> Scene:
    """A scene of two layers that knows the `LayerShares` of its picture.

    Args:
        scene: The scene, with the speeds that its objects are computed at.
        background: Its background.
        sampling: Frequencies and effective speeds of the shares; by default those of a picture's
            power, and the fewest.
    """
    sampling = sampling or LayerSampling(Frequencies.of_grid(NUM_FREQUENCIES))
    sampling = sampling.within_memory(scene.speeds.size * np.size(background.speeds))
    occlusion = scene.occlusion.with_shares(None)  # type: ignore[union-attr]
    shares = _shares(scene.with_occlusion(None), occlusion, background, sampling)
    return scene.with_occlusion(occlusion.with_shares(shares))


@compiled
def _shares(
    scene: Scene, occlusion: Occlusion, background: Background, sampling: LayerSampling
) -> LayerShares:
    grid, count, folds = sampling
    dtype = np.dtype(scene.speeds.dtype)
    frequency = jnp.asarray(grid.values(dtype))
    power = picture_power(scene, grid.num_known, dtype)
    passes = frequency <= scene.cutoff_frequency.astype(dtype) * (1 + 1e-6)
    texture = jnp.where(passes, _texture_at(power, frequency), 0)
    front = occlusion.front_share.astype(dtype)
    behind = 1 - front
    speeds, weights = (jnp.asarray(x, dtype) for x in background)
    nodes = _Nodes.between(_spanned(scene, speeds, weights, folds=folds), count)
    num_backgrounds, num_objects = speeds.size, scene.speeds.size
    if occlusion.object_width is None:
        total, objects, own = texture, front * texture, behind * texture
        same = jnp.zeros_like(texture)
        beat = jnp.zeros((grid.number, num_backgrounds, num_objects, 0), dtype)
        effective = jnp.zeros(0, dtype)
    else:
        width = occlusion.object_width.astype(dtype)
        length = width * jnp.where(behind > 0, behind, 1.0)

        def matte(frequency: Array) -> Array:
            """Power spectrum of the matte."""
            return front * behind * 2 * length / (1 + (2 * jnp.pi * frequency * length) ** 2)

        rule = _matte_rule(frequency, 1 / (2 * jnp.pi * length), scene.cutoff_frequency)
        beside = _texture_at(power, frequency[:, None] - rule.matte)
        mass = beside * matte(rule.matte) * rule.step
        same = jnp.sum(mass, axis=1)
        levels = occlusion.level_difference.astype(dtype) ** 2 * matte(frequency)
        objects = levels + front**2 * texture + same
        own = behind**2 * texture
        total = jnp.where(passes, objects + own + same, 0)
        ratio = rule.matte / frequency[:, None]

        def pair(each: tuple[Array, Array]) -> Array:
            of_background, of_object = each
            difference = of_object - of_background
            mass_of_beat = jnp.where(difference != 0, mass, 0)
            return nodes.shared(of_background + ratio * difference, mass_of_beat)

        pairs = jnp.meshgrid(speeds, scene.speeds.astype(dtype), indexing="ij")
        beat = jax.lax.map(pair, (pairs[0].ravel(), pairs[1].ravel()))
        beat = jnp.moveaxis(beat, -1, 0).reshape(grid.number, num_backgrounds, num_objects, count)
        effective = nodes.speeds
    divisor = jnp.where(total > 0, total, 1.0)
    whole = jnp.where(total > 0, 1 / divisor, 0)
    objects, own, same = (part * whole for part in (objects, own, same))
    return LayerShares(
        power=total,
        objects=objects,
        background=own,
        same=same,
        beat=beat * whole[:, None, None, None],
        background_speeds=speeds,
        background_weights=weights,
        speeds=effective,
        first=grid.first,
        step=grid.step,
        folds=folds,
    )


def _spanned(scene: Scene, speeds: Array, weights: Array, *, folds: bool) -> tuple[Array, Array]:
    """The slowest and the fastest of two layers; the same in both directions where these fold."""
    every = jnp.concatenate([scene.speeds.astype(speeds.dtype), speeds])
    occurs = jnp.concatenate([scene.weights > 0, weights > 0])
    slowest = jnp.min(jnp.where(occurs, every, jnp.inf))
    fastest = jnp.max(jnp.where(occurs, every, -jnp.inf))
    if folds:
        fastest = jnp.maximum(jnp.abs(slowest), jnp.abs(fastest))
        slowest = -fastest
    return slowest, fastest


class _Nodes(NamedTuple):
    r"""Effective speeds $c + Rd\sinh(bk)/\sinh(bn)$, $k = -n \dots n$.

    Attributes:
        middle: $c$, px/s.
        scale: $Rd/\sinh(bn)$, px/s.
        num: $2n + 1$.
    """

    middle: Array
    scale: Array
    num: int

    @staticmethod
    def between(ends: tuple[Array, Array], count: int) -> "_Nodes":
        half = (ends[1] - ends[0]) / 2
        half = jnp.where(half > 0, half, 1.0)
        return _Nodes((ends[0] + ends[1]) / 2, half * (_FURTHEST / math.sinh(_GROWTH)), count)

    @property
    def speeds(self) -> Array:
        """The effective speeds, ascending; px/s, shape `(k,)`."""
        steps = np.arange(self.num) - self.num // 2
        places = np.sinh(steps * (_GROWTH / (self.num // 2)))
        return self.middle + self.scale * places.astype(self.middle.dtype)

    def shared(self, speed: Array, mass: Array) -> Array:
        """Sums of a mass at some speeds, `(m, g)`, shared among the neighbours; `(k, m)`."""
        rate = (self.num // 2) / _GROWTH
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


class _MatteRule(NamedTuple):
    """Frequencies of the matte, cycles/px, and their steps, for each frequency; `(m, g)` each."""

    matte: Array
    step: Array


def _matte_rule(frequency: Array, corner: Array, cutoff: Array) -> _MatteRule:
    """Nodes about the matte's peak at 0 and about the texture's, where it is at `frequency`."""
    nodes, weights = (x[None].astype(frequency.dtype) for x in _gauss_legendre(_NODES_A_PEAK))
    f, cutoff = frequency[:, None], cutoff.astype(frequency.dtype)
    low, high = f - cutoff, f + cutoff
    between = jnp.clip(f / 2, low, high)

    def about(centre: Array, width: Array | float, ends: tuple[Array, Array]) -> _MatteRule:
        begin, end = (jnp.arcsinh((x - centre) / width) for x in ends)
        place = begin + (end - begin) * (nodes + 1) / 2
        step = width * jnp.cosh(place) * (end - begin) * weights / 2
        return _MatteRule(centre + width * jnp.sinh(place), step)

    of_matte = about(jnp.zeros_like(f), corner, (low, between))
    of_texture = about(f, CORNER_FREQUENCY, (between, high))
    return _MatteRule(
        jnp.concatenate([of_matte.matte, of_texture.matte], axis=1),
        jnp.concatenate([of_matte.step, of_texture.step], axis=1),
    )


@lru_cache
def _gauss_legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(count)


def _texture_at(texture: Array, frequency: Array) -> Array:
    """Power spectrum of the texture at any frequencies, by interpolation on its grid."""
    mirrored = jnp.concatenate([texture[:3][::-1], texture, texture[-2:][::-1]])
    place = jnp.abs(frequency) * (2 * texture.size) + 2.5
    first, shares = _interpolation(place, mirrored.size)
    values = [share * mirrored[first + number] for number, share in enumerate(shares)]
    return jnp.maximum(reduce(jnp.add, values), 0)


class ComputedSpeeds(NamedTuple):
    """Speeds that transfer functions are computed at, px/s, and which occur; shape `(r,)` each."""

    speeds: Array
    occurs: Array


def computed_speeds(scene: Scene) -> ComputedSpeeds:
    """The speeds of a scene; of two layers, then that of a still background, then the effective."""
    shares = None if scene.occlusion is None else scene.occlusion.shares
    if shares is None:
        return ComputedSpeeds(scene.speeds, scene.weights > 0)
    more = shares.speeds[shares.speeds.size // 2 :] if shares.folds else shares.speeds
    if not _background_is_prior(scene):
        more = jnp.concatenate([shares.background_speeds, more])
    speeds = jnp.concatenate([scene.speeds, more.astype(scene.speeds.dtype)])
    occurs = jnp.concatenate([scene.weights > 0, np.ones(more.size, bool)])
    return ComputedSpeeds(speeds, occurs)


def _background_is_prior(scene: Scene) -> bool:
    return scene.occlusion is not None and scene.occlusion.background == "moving"


class LayerMoments(NamedTuple):
    """Mean response and its spread, of all speeds of the objects together or of each.

    Attributes:
        mean: $m$, aligned; complex, shape `(o, m)`.
        spread: $v$, so that the power of a capture is $S_r(|m|^2 + v)$; shape `(o, m)`.
    """

    mean: Complex[Array, "objects frequencies"]
    spread: Float[Array, "objects frequencies"]


def layer_moments(
    scene: Scene, motion: AbstractMotion, spectra: Complex[Array, "rows kept"], *, told: bool
) -> LayerMoments:
    r"""Moments of a capture of two layers, by transfer functions at the `computed_speeds`.

    $m = \sum V_r H_r$ and $v = \sum W_r |H_r|^2 - |m|^2 = \sum W_r |H_r - m|^2
    + 2\operatorname{Re}(\bar m \sum (W_r - V_r) H_r)$, where $V_r$ is $W_r$ with the phases of
    displaced layers; over the tolerances, each weight is that of an error too.

    Args:
        scene: The scene, `with_shares`.
        motion: Motion of the sensor, without velocity.
        spectra: Transfer functions at all errors and speeds, at the lowest of the frequencies.
        told: Whether the decoder is told the objects' speed, and moments are of each.
    """
    real = np.dtype(spectra.real.dtype)
    every = spectra.reshape(error_weights(scene).size, -1, spectra.shape[1])
    errors = jnp.asarray(error_weights(scene), real)
    direct, coherent = _row_weights(scene, motion, spectra.shape[1], real, told=told)
    mean = jnp.einsum("e,eorf,erf->of", errors.astype(spectra.dtype), coherent, every)
    deviation = every[None] - mean[:, None, None]
    power = deviation.real**2 + deviation.imag**2
    spread = jnp.einsum("e,orf,oerf->of", errors, direct, power)
    missed = direct[None].astype(spectra.dtype) - coherent
    lost = jnp.einsum("e,eorf,erf->of", errors.astype(spectra.dtype), missed, every)
    return LayerMoments(mean, spread + 2 * (mean.real * lost.real + mean.imag * lost.imag))


def moments_on_dft(
    scene: Scene,
    motion: AbstractMotion,
    length: int,
    responses: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> LayerMoments:
    """Moments of a capture of two layers on the grid of a DFT; NumPy arrays of shape `(1, m)`.

    They are of the camera as it was designed, without the errors that its tolerances allow.

    Args:
        scene: Scene of two layers, seen from the motion; concrete.
        motion: Motion of the sensor, without velocity.
        length: Pixels of the DFT.
        responses: Function that gives responses at some speeds on its grid, aligned, `(s, m)`, of
            each at so many of the lowest frequencies at least.
    """
    scene, grid = without_tolerances(scene), Frequencies.of_dft(length)
    sampling = LayerSampling(grid, _EFFECTIVE_SPEEDS_OF_DECODERS)
    scene = with_shares(scene, background_of(scene), sampling)
    speeds = np.asarray(computed_speeds(scene).speeds)
    spectra = responses(speeds, _num_occurring(scene, speeds.size))
    return jax.tree.map(np.asarray, _moments_on_dft(scene, motion, jnp.asarray(spectra)))


def _num_occurring(scene: Scene, num_speeds: int) -> np.ndarray:
    """Number of the lowest frequencies at which each of the `computed_speeds` occurs, at most.

    The beat moves fast where its waves are long beside those of the matte, and there alone.
    """
    occurs = np.any(np.asarray(scene.occlusion.shares.beat) != 0, axis=(1, 2))  # type: ignore[union-attr]
    number, num_effective = occurs.shape
    counts = np.full(num_speeds, number)
    highest = number - np.argmax(occurs[::-1], axis=0)
    counts[num_speeds - num_effective :] = np.where(np.any(occurs, axis=0), highest, 0)
    return counts


@compiled
def _moments_on_dft(scene: Scene, motion: AbstractMotion, spectra: Array) -> LayerMoments:
    return layer_moments(scene, motion, spectra, told=False)


def _row_weights(
    scene: Scene, motion: AbstractMotion, num_kept: int, dtype: np.dtype, *, told: bool
) -> tuple[Array, Array]:
    """Weights $W$ of powers, `(o, r, f)`, and $V$ of amplitudes, `(e, o, r, f)`, complex."""
    shares: LayerShares = scene.occlusion.shares  # type: ignore[union-attr]
    objects, own, same, beat = (
        x[:num_kept].astype(dtype)
        for x in (shares.objects, shares.background, shares.same, shares.beat)
    )
    num_objects, prior = scene.speeds.size, scene.weights.astype(dtype)
    behind = shares.background_weights.astype(dtype)
    chosen = jnp.eye(num_objects, dtype=dtype) if told else prior[None]
    complex_type = np.result_type(dtype, np.complex64)
    beat = behind[None, :, None, None] * beat
    powers = jnp.einsum("on,fbnk->okf", chosen, beat)
    amplitudes = _beat_amplitudes(scene, motion, beat)
    amplitudes = jnp.einsum("on,enkf->eokf", chosen.astype(complex_type), amplitudes)
    powers, amplitudes = (_folded(x, shares) for x in (powers, amplitudes))
    speeds, background = (x.astype(dtype) for x in (scene.speeds, shares.background_speeds))
    meets = (background[:, None] == speeds[None]).astype(dtype) * behind[:, None]
    as_one = objects[None] + jnp.sum(meets, axis=0)[:, None] * same[None]
    together = chosen[:, :, None] * as_one[None]
    if _background_is_prior(scene):
        rows = [together + prior[None, :, None] * own[None, None]]
    else:
        alone = jnp.broadcast_to(own[None, None], (chosen.shape[0], background.size, num_kept))
        rows = [together, alone]
    lines = jnp.concatenate(rows, axis=1)
    direct = jnp.concatenate([lines, powers], axis=1)
    repeated = jnp.broadcast_to(lines, (amplitudes.shape[0], *lines.shape)).astype(complex_type)
    return direct, jnp.concatenate([repeated, amplitudes], axis=2)


def _beat_amplitudes(
    scene: Scene, motion: AbstractMotion, beat: Float[Array, "kept background objects nodes"]
) -> Complex[Array, "errors objects nodes kept"]:
    """Weights of the beat with the phases that displace its waves from where they are aligned."""
    shares: LayerShares = scene.occlusion.shares  # type: ignore[union-attr]
    dtype = np.dtype(beat.dtype)
    parts = [x.astype(dtype) for x in (shares.background_speeds, scene.speeds, shares.speeds)]
    background, objects, nodes = parts
    ends = np.cumsum([background.size, objects.size])
    displacements = _displacements(scene, motion, jnp.concatenate(parts))
    behind, front, between = jnp.split(displacements, ends, axis=1)
    difference = objects[None] - background[:, None]
    moves = (difference != 0)[..., None]
    place = (nodes[None, None] - background[:, None, None]) / jnp.where(
        moves, difference[..., None], 1.0
    )
    place, moves = place[None], moves[None]
    of_layers = (1 - place) * behind[..., None, None] + place * front[:, None, :, None]
    angle = jnp.where(moves, of_layers - between[:, None, None], 0.0)
    begin, step = (angle * (-2 * np.pi * f) for f in (shares.first, shares.step))
    turn = jnp.cos(step), jnp.sin(step)

    def turned(
        wave: tuple[Array, Array], weights: Array
    ) -> tuple[tuple[Array, Array], tuple[Array, ...]]:
        """Waves of the next frequency of the grid; a product costs less than a cosine."""
        (cosine, sine), (c, s) = wave, turn
        sums = tuple(jnp.sum(weights[None] * part, axis=1) for part in wave)
        return (cosine * c - sine * s, sine * c + cosine * s), sums

    first = jnp.cos(begin), jnp.sin(begin)
    real, imag = jax.lax.scan(turned, first, beat)[1]
    return jnp.moveaxis(jax.lax.complex(real, imag), 0, -1)


def _displacements(scene: Scene, motion: AbstractMotion, speeds: Array) -> Array:
    """Distances by which objects of some speeds are displaced, at each error; px, `(e, s)`."""

    def on(motion: AbstractMotion, speeds: Array) -> Array:
        return jnp.asarray(motion.side_by_side(speeds).displacement)

    if scene.tolerances is None:
        return on(motion, speeds)[None]
    return at_each_error(on, speeds, scene.tolerances, motion).reshape(-1, speeds.size)


def _folded(weights: Array, shares: LayerShares) -> Array:
    """Weights of effective speeds, `(..., k, f)`, those of both directions together."""
    if not shares.folds or not shares.speeds.size:
        return weights
    middle = shares.speeds.size // 2
    return weights[..., middle:, :].at[..., 1:, :].add(weights[..., :middle, :][..., ::-1, :])
