r"""Noise by photon transfer: the variance of a level against its mean.

A level $m$ of $e$ electrons and black $b$ is $m = b + k e$, where the system gain $k$ is the levels
of an electron, and its temporal variance is $k(m - b) + s^2$ with the temporal dark noise $s$, read
noise and rounding, in levels (EMVA 1288). Both are taken from differences of frames of the same
scene, over blocks of pixels, without those in which something moves: those whose differences are
not those of independent pixels, or beyond what noise makes of a block in a thousand. A block in
which something moves strongly rejects those around it.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage, stats

from mishutter.measurement.estimates import Estimate
from mishutter.measurement.steady import PART, SIDE, Steady
from mishutter.pictures.registration.windows import means

_CLUSTER = 4
"""Blocks along a side of what is resampled together."""
_FREEDOM = (SIDE // PART) ** 2 * (PART**2 - 1)
"""Degrees of freedom of a block's variance about the means of its quarters."""
_BINS = 16
_LEAST_BLOCKS = 60
"""Fewest blocks at rest from which a law is taken."""
_COLUMNS = ("mean", "variance", "parts", "texture", "is_whole", "cluster")


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of pixels in pairs of frames."""

    mean: Float[np.ndarray, "blocks"]  # Mean level
    variance: Float[np.ndarray, "blocks"]  # Temporal variance of a level
    # Squares of the differences of the quarters' means, added up
    parts: Float[np.ndarray, "blocks"]
    texture: Float[np.ndarray, "blocks"]  # Variance of the level over the block
    is_whole: Bool[np.ndarray, "blocks"]  # Whether no pixel is cut off
    cluster: Int[np.ndarray, "blocks"]  # Number of what is resampled together
    shape: tuple[int, int, int]  # Pairs, and rows and columns of blocks

    def moves(self, law: "Law") -> Bool[np.ndarray, "blocks"]:
        """Whether something moves in a block, by a law of the noise."""
        expected = law(self.mean)
        # Where noise differs over a block, fewer pixels make its sums, which spread more.
        few = 1 + law.gain**2 * self.texture / expected**2
        quarters = (SIDE // PART) ** 2
        shift = self.parts / (2 * expected / PART**2)
        spread = self.variance / expected * _FREEDOM
        # What moves a little shows in several blocks side by side, beside others of the level.
        whole = np.flatnonzero(self.is_whole)
        order = whole[np.argsort(self.mean[whole])]
        bins = [part for part in np.array_split(order, _BINS) if part.size]
        levels = [float(np.median(self.mean[part])) for part in bins]
        usual = np.interp(self.mean, levels, [float(np.median(spread[part])) for part in bins])
        unusual = (spread / np.maximum(usual, 1.0)).reshape(self.shape)
        around = ndimage.uniform_filter1d(unusual, 3, axis=1, mode="nearest")
        around = ndimage.uniform_filter1d(around, 3, axis=2, mode="nearest").ravel()
        chances = (
            stats.chi2.sf(shift / few, quarters / few),
            stats.chi2.sf(spread / few, _FREEDOM / few),
            stats.chi2.sf(9 * _FREEDOM * around / few, 9 * _FREEDOM / few),
        )
        least = np.min(chances, axis=0)
        # Noise is beyond 1e-3 in a block of a thousand, which is left out; beyond 1e-6 something
        # moves so strongly that its neighbours are too.
        is_strong = (least < 1e-6).reshape(self.shape)
        grown = np.asarray(ndimage.binary_dilation(is_strong, np.ones((1, 3, 3))), bool)
        return grown.ravel() | (least < 1e-3)

    def __add__(self, other: "Blocks") -> "Blocks":
        """The blocks of both; their pairs are counted as one shape that nothing is asked of."""
        own, others = ([getattr(x, name) for name in _COLUMNS] for x in (self, other))
        others[-1] = others[-1] + 1 + (self.cluster.max() if self.cluster.size else 0)
        joined = map(np.concatenate, zip(own, others, strict=True))
        columns = dict(zip(_COLUMNS, joined, strict=True))
        return Blocks(**columns, shape=(1, 1, self.mean.size + other.mean.size))

    def where(self, chosen: np.ndarray) -> "Blocks":
        """The chosen ones."""
        columns = {name: getattr(self, name)[chosen] for name in _COLUMNS}
        return Blocks(**columns, shape=(1, 1, int(np.sum(chosen))))


@dataclass(frozen=True)
class Law:
    """The line `dark + gain * level` of the variance, which is at least `floor`."""

    dark: float
    gain: float
    floor: float

    def __call__(self, level: np.ndarray | np.floating | float) -> np.ndarray:
        """Variance of a level."""
        return np.asarray(np.maximum(self.dark + self.gain * np.asarray(level), self.floor))

    def of_unit_noise(self, frames: np.ndarray) -> Float[np.ndarray, "frames rows columns"]:
        r"""Levels of unit noise: $\int dm/\sqrt{d + k m}$, the variance-stabilising transform."""
        middle = float(np.mean(frames))
        rise = self.gain * float(np.ptp(frames))
        # So small a share of the variance counts as no rise.
        if abs(rise) < 0.02 * float(self(np.array(middle))):
            return (frames / np.sqrt(self(np.array(middle)))).astype(np.float32)
        return (2 / self.gain * np.sqrt(self(frames))).astype(np.float32)

    def exceeds_steps(self, level: np.ndarray, step: float) -> Bool[np.ndarray, "..."]:
        """Whether noise spreads a level over several steps, whose rounding adds its own."""
        # Below 0.4 steps, without that of rounding, the place between steps decides it.
        return self(level) >= (0.4**2 + 1 / 12) * step**2


@dataclass(frozen=True, eq=False)
class Transfer:
    """A law of the noise that was fitted to blocks at rest."""

    law: Law  # The line
    blocks: Blocks  # The blocks at rest
    clip: Blocks  # Those of the clip's pairs of frames, whether at rest or not
    share: float  # Share of the clip's whole blocks that is at rest
    # Lines of resampled blocks, `dark` and `gain`; shape `(resamples, 2)`
    lines: Float[np.ndarray, "resamples 2"]
    curvature: Estimate  # Variance at either end of the levels that is square in the level
    # Whether a block of the clip is at rest and whole; shape `(pairs, rows, columns)`
    at_rest: Bool[np.ndarray, "pairs rows columns"]
    error: float = 0.0  # Error of the variance besides, of all blocks alike; a share

    def curve(self) -> Float[np.ndarray, "4 bins"]:
        """Mean level, variance, its error, and number of blocks, in bins of equally many blocks."""
        order = np.argsort(self.blocks.mean)
        bins = [part for part in np.array_split(order, _BINS) if part.size]
        level = np.array([self.blocks.mean[part].mean() for part in bins])
        variance = np.array([self.blocks.variance[part].mean() for part in bins])
        count = np.array([part.size for part in bins])
        # Each frame is in two pairs, by which means over these vary 1.5 times as much.
        error = self.law(level) * np.sqrt(2 / _FREEDOM * 1.5 / count)
        return np.stack([level, variance, error, count.astype(float)])


def pairs_of(count: int, lag: int = 1) -> list[tuple[int, int]]:
    """Numbers of frames that follow each other, so many frames apart."""
    return [(k, k + lag) for k in range(count - lag)]


def blocks_of(
    frames: Steady, pairs: Iterable[tuple[int, int]], ends: tuple[float, float]
) -> Blocks:
    """The blocks of pairs of frames, by their numbers.

    A frame that was divided by its exposure g has the variance (d + k m) / g^2 of its own level m,
    so that a pair's variance over the mean of 1 / g^2 lies on the line of single frames, at the
    mean level that is weighted so.
    """
    columns: list[tuple[np.ndarray, ...]] = []
    shape = (0, 0)
    dead = _dead(frames.levels)
    for i, j in pairs:
        weights = 1 / frames.gains[[i, j]] ** 2
        scale = float(weights.mean())
        first, second = frames.levels[i], frames.levels[j]
        difference = (frames.same[j] - frames.same[i]) / np.float32(np.sqrt(scale))
        one, other = (weights / weights.sum()).astype(np.float32)
        middle = one * first + other * second
        mean = means(middle, SIDE)
        parts = means(difference, PART)
        within = means(difference * difference, PART) - parts * parts
        variance = means(within, SIDE // PART) * (PART**2 / (PART**2 - 1) / 2)
        is_cut = (np.minimum(first, second) <= ends[0]) | (np.maximum(first, second) >= ends[1])
        shape = mean.shape
        squares = means(parts * parts, SIDE // PART) * (SIDE // PART) ** 2
        texture = np.maximum(means(middle.astype(np.float64) ** 2, SIDE) - mean**2, 0)
        is_whole = means((is_cut | dead).astype(np.float32), SIDE) == 0
        columns.append(tuple(map(np.ravel, (mean, variance, squares, texture, is_whole))))
    rows, cols = np.indices(shape)
    across = -(-shape[1] // _CLUSTER)
    cluster = (rows // _CLUSTER * across + cols // _CLUSTER).ravel()
    joined = dict(zip(_COLUMNS, map(np.concatenate, zip(*columns, strict=True)), strict=False))
    joined["cluster"] = np.tile(cluster, len(columns))
    return Blocks(**joined, shape=(len(columns), shape[0], shape[1]))


def _dead(frames: np.ndarray) -> Bool[np.ndarray, "rows columns"]:
    """Rows, columns and blocks that are stuck: their levels never change, where others' do."""
    constant = frames.max(axis=0) == frames.min(axis=0)
    dead = np.zeros(constant.shape, bool)
    for axis in (0, 1):
        share = constant.mean(axis=axis, keepdims=True)
        dead |= (share > 0.9) & (np.median(share) < 0.5)
    share = means(constant, SIDE)
    # Of fewer frames, noise that spans few steps may leave many pixels as they are.
    if len(frames) >= 4 and np.median(share) < 0.1:
        rows, columns = (SIDE * n for n in share.shape)
        dead[:rows, :columns] |= np.kron(share > 0.5, np.ones((SIDE, SIDE), bool))
    return dead


def transfer_of(clip: Blocks, others: Blocks | None, step: float) -> Transfer | None:
    """The law of the noise, by blocks at rest; None if too few are."""
    floor = max(step**2 / 24, 1e-12)
    law = _first_law(clip, floor)
    if law is None:
        return None
    chosen, blocks = clip.is_whole, clip
    for _ in range(8):
        chosen = clip.is_whole & ~clip.moves(law)
        blocks = clip.where(chosen & law.exceeds_steps(clip.mean, step))
        if others is not None:
            blocks = blocks + others.where(others.is_whole & law.exceeds_steps(others.mean, step))
        if blocks.mean.size < _LEAST_BLOCKS:
            return None
        dark, gain = _Sums.of(blocks, law).lines()[0]
        law = replace(law, dark=float(dark), gain=float(gain))
    sums = _Sums.of(blocks, law)
    count = len(sums.each)
    times = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), size=400)
    curvature = float(sums.curvatures()[0]), float(sums.curvatures(times).std())
    share = float(np.sum(chosen) / max(np.sum(clip.is_whole), 1))
    at_rest = chosen.reshape(clip.shape)
    return Transfer(law, blocks, clip, share, sums.lines(times), Estimate(*curvature), at_rest)


def rough_law(clip: Blocks, step: float) -> Law:
    """A law by the quietest blocks, where too little stands still: enough to weigh residuals."""
    floor = max(step**2 / 24, 1e-12)
    law = _first_law(clip, floor)
    if law is not None and law.gain >= 0:
        return law
    return Law(float(np.quantile(clip.variance, 0.25)), 0.0, floor)


def _first_law(clip: Blocks, floor: float) -> Law | None:
    """The line through the lower quartiles of the variance at some levels."""
    blocks = clip.where(clip.is_whole)
    if blocks.mean.size < _LEAST_BLOCKS:
        return None
    order = np.argsort(blocks.mean)
    bins = np.array_split(order, 12)
    level = np.array([np.median(blocks.mean[part]) for part in bins])
    variance = np.array([np.quantile(blocks.variance[part], 0.25) for part in bins])
    if np.ptp(level) <= 1e-6 * abs(level).max():
        return Law(float(variance.mean()), 0.0, floor)
    weights = 1 / np.maximum(variance, floor)
    gain, dark = np.polyfit(level, variance, 1, w=weights)
    return Law(float(dark), float(gain), floor)


class _Sums(NamedTuple):
    r"""Sums of weighted least squares of the variance $v$ over the level, in each cluster."""

    # Sums of $w x^j$, j = 0 to 4, and of $w v x^j$, j = 0 to 2
    each: Float[np.ndarray, "clusters 8"]
    middle: float  # Level at which $x$ is 0
    reach: float  # Distance from there to either end, where $x$ is 1 or -1

    @staticmethod
    def of(blocks: Blocks, law: Law) -> "_Sums":
        """The sums of some blocks, weighted by a law."""
        low, high = float(blocks.mean.min()), float(blocks.mean.max())
        middle, reach = (low + high) / 2, max((high - low) / 2, 1e-6 * abs(high), 1e-12)
        x, weight = (blocks.mean - middle) / reach, 1 / law(blocks.mean) ** 2
        columns = [weight * x**j for j in range(5)]
        columns += [blocks.variance * column for column in columns[:3]]
        count = int(blocks.cluster.max()) + 1
        each = np.stack([np.bincount(blocks.cluster, c, count) for c in columns], axis=1)
        return _Sums(each, middle, reach)

    def _fitted(self, degree: int, times: np.ndarray | None) -> np.ndarray:
        """Coefficients of polynomials in `x`, each cluster taken so many times."""
        sums = self.each.sum(axis=0)[None] if times is None else times @ self.each
        order = np.add.outer(range(degree + 1), range(degree + 1))
        inverse = np.linalg.pinv(sums[:, order], rcond=1e-9, hermitian=True)
        return np.einsum("nij,nj->ni", inverse, sums[:, 5 : 6 + degree])

    def lines(self, times: np.ndarray | None = None) -> Float[np.ndarray, "n 2"]:
        """Intercept and slope of each; a level alone has no slope."""
        value, rise = self._fitted(1, times).T
        gain = rise / self.reach
        return np.stack([value - gain * self.middle, gain], axis=1)

    def curvatures(self, times: np.ndarray | None = None) -> Float[np.ndarray, "n"]:
        """The part of each that is square in the level, at the ends of the levels."""
        return self._fitted(2, times)[:, 2]
