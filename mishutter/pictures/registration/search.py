"""Velocities that explain what frames show, and where each of them does.

Beginning with rest, the velocity is taken that explains most of the tiles better than those before
it, until none does. Every pixel of a reference frame then belongs to the velocity along which the
frames about it differ least.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from mishutter.pictures.registration.sweep import ANY, Limits, Region, Smoothed, Sweep, swept
from mishutter.pictures.registration.windows import Window

WINDOW = 4
"""Frames that are swept at once."""
AROUND = 2
"""Frames to either side of the reference by which pixels are labelled."""
SEPARATE = 0.5
"""Distance of velocities over the labelled frames within which they are one; px."""
EXPLAINED = 4.0
"""Residual over noise along the best velocity beyond which none explains a pixel."""
_MOST = 12
"""Velocities that are looked for, at most."""
_PLACES = 7
"""Velocities near another that are tried along each axis."""
_REST = 0.15
"""Residual over noise by which rest may be worse, where nothing tells."""
_SMOOTHING = 2.5
"""Gaussian that the residuals of pixels are averaged under; px."""
_FAR = 50.0
"""Residual over noise of a pixel that is not seen, and the greatest that counts."""


class Found(NamedTuple):
    """Velocities that were found, and where."""

    velocities: list[Float[np.ndarray, "2"]]  # Down and across, rest first
    labels: Int[np.ndarray, "rows columns"]  # Number of the velocity that explains a pixel best
    # Residual over noise along that, by the frames nearest to the reference
    least: Float[np.ndarray, "rows columns"]
    sweeps: list[Sweep]  # Those that were searched


def searched(
    frames: Float[np.ndarray, "frames rows columns"],
    smooth: tuple[Smoothed, Smoothed],
    reference: int,
    least_area: int,
    limits: Limits = ANY,
) -> Found:
    """The velocities of what is seen in one of several frames of unit noise.

    Args:
        frames: The frames.
        smooth: They under a narrow Gaussian, and under a wider one.
        reference: Number of the frame.
        least_area: Pixels of the least thing.
        limits: Velocities that are looked for.
    """
    fine, count = smooth[0], len(frames)
    search, sweeps = Search.of(smooth, reference, 1, least_area, limits), []
    # What is slow is swept over as long a time as there is.
    for stride in sorted({1, max(1, (count - 1) // (WINDOW - 1))}):
        numbers = _window(count, reference, stride)
        own = list(numbers).index(reference)
        for sweep in swept(frames[numbers], fine.times[numbers], own, limits):
            sweeps.append(sweep)
            search.over(sweep)
    # Velocities less than a step of the sweeps apart, or from rest, leave changes unexplained.
    everywhere = np.ones(frames.shape[1:], bool)
    search.about_found(2 * sweeps[-1].step, everywhere)
    velocities, labels = search.velocities, np.argmin(search.costs, axis=0)
    least = np.min(search.costs, axis=0)
    # What seems to rest there may differ between frames that are farther apart.
    stride = (count - 1) // (2 * AROUND)
    if stride > 1:
        slow = Search.of(smooth, reference, stride, least_area, limits)
        slow.about_found(2 * sweeps[-1].step, labels == 0)
        own = np.argmin(slow.costs, axis=0)
        labels = np.where((labels == 0) & (own > 0), len(velocities) - 1 + own, labels)
        velocities = velocities + slow.velocities[1:]
    return Found(velocities, labels, least, sweeps)


def explained(
    fine: Smoothed, velocities: Float[np.ndarray, "n 2"], reference: int
) -> Int[np.ndarray, "rows columns"]:
    """Number of the one of some velocities, from 1, that explains a pixel best; 0 for rest."""
    near = around(len(fine.times), reference, 1)
    rest = _costs(fine, np.zeros(2), reference, near)
    each = [_costs(fine, velocity, reference, near) + _REST for velocity in velocities]
    return np.argmin([rest, *each], axis=0)


def around(count: int, reference: int, stride: int) -> list[int]:
    """Numbers of the frames by which pixels of one are labelled."""
    numbers = (reference + stride * n for n in range(-AROUND, AROUND + 1))
    return [k for k in numbers if 0 <= k < count]


class Search(NamedTuple):
    """A search for the velocities of what is seen in a reference frame."""

    fine: Smoothed
    rough: Smoothed
    reference: int
    around: Sequence[int]  # Frames by which pixels are labelled
    least_area: int  # Pixels of the least thing
    limits: Limits  # Velocities that are looked for
    velocities: list[np.ndarray]  # Those that were found, rest first
    costs: list[np.ndarray]  # Residual of each pixel along each

    @staticmethod
    def of(
        smooth: tuple[Smoothed, Smoothed],
        reference: int,
        stride: int,
        least_area: int,
        limits: Limits = ANY,
    ) -> "Search":
        """A search that begins with rest, by frames about one that are so many apart."""
        fine, rough = smooth
        near = around(len(fine.times), reference, stride)
        search = Search(fine, rough, reference, near, least_area, limits, [], [])
        search.add(np.zeros(2), _costs(fine, np.zeros(2), reference, near))
        return search

    @property
    def reach(self) -> float:
        """Time to the farthest frame by which pixels are labelled."""
        return self.fine.reach(self.reference, self.around)

    def add(self, velocity: np.ndarray, cost: np.ndarray) -> None:
        """Add a velocity."""
        self.velocities.append(velocity)
        self.costs.append(cost)

    def over(self, sweep: Sweep) -> None:
        """Add the velocities of a sweep that explain most of the tiles, one after the other."""
        current = sweep.logarithms[np.all(sweep.velocities == 0, axis=1)][0]
        for velocity in self.velocities[1:]:
            current = _explained(current, sweep, velocity)
        tried, misses = sweep.near(np.zeros(2), 0.9), 0
        while len(self.velocities) <= _MOST and misses < 4:
            gain = _gain(sweep, current)
            gain[tried] = 0
            best = int(gain.argmax())
            if gain[best] < 0.4:  # over all tiles, in logarithms of residuals
                break
            tried |= sweep.near(sweep.velocities[best], 0.9)
            tiles = current - sweep.logarithms[best] > 0.2 + sweep.margin  # those of its own
            shape = self.costs[0].shape
            mask = sweep.mask(tiles, shape) if tiles.any() else np.ones(shape, bool)
            velocity = self.refined(sweep.velocities[best], sweep.step, mask)
            if self.is_new(velocity):
                current = _explained(current, sweep, velocity)
            else:
                misses += 1

    def about_found(self, width: float, where: Bool[np.ndarray, "rows columns"]) -> None:
        """Add velocities near those that were found, of parts that none of these explains.

        Two things that touch are one such part until the first of them is explained.
        """
        is_new = True
        while is_new and len(self.velocities) <= _MOST:
            is_left = where & (np.min(self.costs, axis=0) > EXPLAINED / 2)
            changes = ndimage.binary_opening(is_left, iterations=2)
            parts = np.empty(changes.shape, np.int32)
            ndimage.label(changes, output=parts)
            sizes = np.bincount(parts.ravel())
            large = [n for n in range(1, sizes.size) if sizes[n] >= self.least_area // 2]
            news = [self.is_new(self.best_of_part(parts == n, width)) for n in large]
            is_new = any(news)

    def best_of_part(
        self, part: Bool[np.ndarray, "rows columns"], width: float
    ) -> Float[np.ndarray, "2"]:
        """The velocity that explains most of a part, which may hold several things.

        It is one near those that explain pixels of the part best so far.
        """
        window = Window.around(part, 0)
        steps = self.limits.grid(np.linspace(-0.5, 0.5, _PLACES) * width)
        near = np.unique(np.argmin(self.costs, axis=0)[part])
        grid = [self.velocities[n] + step for n in near.tolist() for step in steps]

        def logarithms(velocity: np.ndarray) -> np.ndarray:
            costs = _costs(self.rough, velocity, self.reference, self.around, window)
            return np.log(np.maximum(costs, 0.8))[window.of(part)]

        current = np.min([logarithms(velocity) for velocity in self.velocities], axis=0)
        leads = [current - logarithms(velocity) for velocity in grid]
        best = int(np.argmax([np.sum(np.maximum(lead - 0.1, 0)) for lead in leads]))
        own = part.copy()
        own[part] = leads[best] > 0.3
        own = own if own.any() else part
        return self.refined(grid[best], width / (_PLACES - 1), own)

    def refined(self, velocity: np.ndarray, width: float, mask: np.ndarray) -> np.ndarray:
        """The best velocity of a part of the picture, within a width about one."""
        region = Region(self.rough, self.reference, self.around, mask, self.limits)
        velocity = region.best_of_grid(velocity, width)
        velocity = region.descended(velocity, 0.25 * width, 0.2 / self.reach)
        fine = region._replace(frames=self.fine)
        return fine.descended(velocity, 0.2 / self.reach, 0.05 / self.reach)

    def is_new(self, velocity: np.ndarray) -> bool:
        """Whether a velocity explains what none before it does; if so, it is added."""
        cost, won = self.won(velocity)
        if won.sum() < self.least_area:
            return False
        # Between the velocities of two things it explains one of them better.
        region = Region(self.fine, self.reference, self.around, won, self.limits)
        velocity = region.descended(velocity, 0.4 / self.reach, 0.05 / self.reach)
        cost, won = self.won(velocity)
        apart = min(np.hypot(*(velocity - other)) for other in self.velocities) * self.reach
        is_new = bool(won.sum() >= self.least_area and apart >= SEPARATE)
        if is_new:
            self.add(velocity, cost)
        return is_new

    def won(self, velocity: np.ndarray) -> tuple[np.ndarray, Bool[np.ndarray, "rows columns"]]:
        """Residual of each pixel along a velocity, and the pixels that only it explains."""
        cost = _costs(self.fine, velocity, self.reference, self.around) + _REST
        won = (cost < 0.7 * np.min(self.costs, axis=0)) & (cost < EXPLAINED)
        return cost, np.asarray(ndimage.binary_opening(won, iterations=2), bool)


def _explained(current: np.ndarray, sweep: Sweep, velocity: np.ndarray) -> np.ndarray:
    """Logarithms of the residuals of tiles after one more velocity."""
    near = sweep.near(velocity, 1.1)
    return np.minimum(current, sweep.logarithms[near].min(axis=0)) if near.any() else current


def _window(count: int, reference: int, stride: int) -> np.ndarray:
    """Numbers of the frames that are swept, the reference among them."""
    earlier, later = reference // stride, (count - 1 - reference) // stride
    length = min(WINDOW, earlier + 1 + later)
    before = max(min(length // 2, earlier), length - 1 - later)
    return reference + stride * (np.arange(length) - before)


def _gain(sweep: Sweep, current: np.ndarray) -> Float[np.ndarray, "velocities"]:
    """Logarithms of residuals by which each velocity is better, over all tiles."""
    logarithms = sweep.logarithms
    gains = np.where(np.isfinite(logarithms), current - logarithms - sweep.margin, 0)
    return np.maximum(gains, 0).sum(axis=(1, 2), where=np.isfinite(gains))


def _costs(
    fine: Smoothed,
    velocity: np.ndarray,
    reference: int,
    around: Sequence[int],
    window: Window | None = None,
) -> Float[np.ndarray, "rows columns"]:
    """Residual over noise of each pixel along a velocity, by all frames or those of one side.

    What hides a pixel, or is hidden by it, is often on one side alone.
    """
    window = Window.whole(fine.coefficients.shape) if window is None else window
    values, seen = fine.along(velocity, reference, around, window)
    numbers = np.array(around)
    sides = {
        tuple(numbers),
        tuple(numbers[numbers <= reference]),
        tuple(numbers[numbers >= reference]),
    }
    least = np.full(values.shape[1:], _FAR)
    for side in sides:
        if len(side) < 2:
            continue
        chosen = np.isin(numbers, side)
        count = seen[chosen].sum(axis=0)
        mean = np.where(seen[chosen], values[chosen], 0).sum(axis=0) / np.maximum(count, 1)
        squares = np.where(seen[chosen], (values[chosen] - mean) ** 2, 0).sum(axis=0)
        residual = np.minimum(squares / np.maximum(count - 1, 1) / fine.variance, _FAR)
        known = (count > 1).astype(float)
        total = ndimage.gaussian_filter(residual * known, _SMOOTHING)
        weight = ndimage.gaussian_filter(known, _SMOOTHING)
        least = np.minimum(least, np.where(weight > 0.3, total / np.maximum(weight, 1e-3), _FAR))
    return least
