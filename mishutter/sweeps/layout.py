"""Where the points of a sweep are and what each needs: limits, sizes, tiles, folded scenes."""

from functools import cached_property
from typing import NamedTuple, final

import jax.numpy as jnp
import numpy as np

from mishutter.evaluation import (
    is_symmetric,
    num_frequencies,
    occurring_speeds,
    picture_power,
    require_sizes,
    rounding,
    sizes,
    spread_of,
    whole_px,
)
from mishutter.model import ParabolicMotion, Scene, settled
from mishutter.sweeps.grid import KERNEL_METRICS, SPECTRUM_METRICS, Block, Grid, outside_limits
from mishutter.sweeps.kernels import TAPS
from mishutter.sweeps.points import PARTS, SceneNumbers, Tile, TileSizes
from mishutter.sweeps.tables import Rules, Tables, tabulate

_TILE_SIZES = range(64, 15, -1)


class Kit(NamedTuple):
    """Shutters ready to be measured.

    Attributes:
        tables: Their tables.
        rules: Their quadrature rules.
        symmetric: Whether all of them are.
        tile_size: Accelerations of a tile.
    """

    tables: Tables
    rules: Rules
    symmetric: bool
    tile_size: int


class Chosen(NamedTuple):
    """Points of a block that make a tile: some accelerations of one half exposure."""

    rows: np.ndarray
    column: int


@final
class Layout:
    """The points of a grid.

    Args:
        grid: The sweep.
    """

    def __init__(self, grid: Grid):
        self.grid = grid
        self.scenes = list(grid.scenes.values())
        self.max_speeds = [float(scene.max_speed) for scene in self.scenes]
        a, half = grid.accelerations, grid.half_exposures
        self.outside = [outside_limits(scene, a, half) for scene in self.scenes]
        points = zip(self.scenes, self.outside, strict=True)
        plans = [_point_sizes(scene, a, half, bits == 0) for scene, bits in points]
        self.num_taps = [plan[0] for plan in plans]
        self.dft_length = [plan[1] for plan in plans]
        self.num_frequencies = [plan[2] for plan in plans]
        require_sizes(
            *(max(int(x.max()) for x in each) for each in (self.num_taps, self.num_frequencies)),
            kernels=self.tile_sizes.kernels,
            spectra=self.tile_sizes.spectra or grid.search is not None,
            subject="sweep(accelerations=...)",
        )

    def inside(self, block: Block) -> np.ndarray:
        """Which points of a block are within limits; shape `(a, t)`."""
        return self.outside[block.scene][self.grid.place(block)] == 0

    def kit(self, shutters: list) -> Kit:
        """Tables of shutters, fine enough for every point."""
        symmetric = self.grid.skips and all(is_symmetric(shutter) for shutter in shutters)
        bandwidth = self._max_bandwidth()
        tables, rules = tabulate(shutters, bandwidth, self.grid.dtype, symmetric=symmetric)
        rows = self.grid.block_shape[0]
        size = min(_TILE_SIZES, key=lambda size: -(-rows // size) * size)
        return Kit(tables, rules, symmetric, min(size, rows))

    @cached_property
    def tile_sizes(self) -> TileSizes:
        """What is static in the program of the tiles."""
        stroke = self._largest(lambda a, half, fastest: a * half * half)
        lengths, grids = (
            np.unique(
                np.concatenate(
                    [[256], *(x[bits == 0] for x, bits in zip(each, self.outside, strict=True))]
                )
            )
            for each in (self.dft_length, self.num_frequencies)
        )
        taps = int(stroke) + 2 if self.grid.skips else max(int(x.max()) for x in self.num_taps)
        return TileSizes(
            lengths=tuple(int(x) for x in lengths),
            grids=tuple(int(x) for x in grids),
            still_taps=-(-taps // TAPS) * TAPS,
            kernels=any(name in KERNEL_METRICS for name in self.grid.metrics),
            spectra=any(name in SPECTRUM_METRICS for name in self.grid.metrics),
        )

    def tiles(self, block: Block, tile_size: int) -> list[Chosen]:
        """A block's points within limits, some of one exposure and of the same sizes at a time."""
        allowed = self.inside(block)
        each = (self.dft_length[block.scene], self.num_frequencies[block.scene])
        kinds = np.stack([x[self.grid.place(block)] for x in each], axis=2)
        return [
            Chosen(index[start : start + tile_size], column)
            for column in range(allowed.shape[1])
            for kind in np.unique(kinds[:, column], axis=0)
            for same in [np.all(kinds[:, column] == kind, axis=1)]
            for index in [np.flatnonzero(allowed[:, column] & same)]
            for start in range(0, index.size, tile_size)
        ]

    def stacked(self, block: Block, tiles: list[Chosen], kit: Kit, count: int) -> Tile:
        """Tiles on one leading axis, with empty ones up to a count."""
        each = [self._tile(block, chosen, kit) for chosen in tiles]
        nothing = (np.ones(kit.tile_size), np.ones(()), *[np.zeros(PARTS)] * 2, *[np.zeros(())] * 4)
        each += [nothing] * (count - len(each))
        dtypes = [self.grid.dtype] * 2 + [np.dtype(np.int32)] * 6
        columns = zip(zip(*each, strict=True), dtypes, strict=True)
        return Tile(*(jnp.asarray(np.stack(x).astype(dtype)) for x, dtype in columns))

    def num_supported(self, block: Block, tiles: list[Chosen], tile_size: int) -> np.ndarray:
        """Taps that light of the fastest object falls on; shape `(tiles, j)`."""
        stroke = np.stack([self._stroke(block, chosen, tile_size) for chosen in tiles])
        half = self._halves(block)[[chosen.column for chosen in tiles]]
        smear = self.max_speeds[block.scene] * half[:, None]
        moving = stroke > 0
        far = (2 * stroke + smear) ** 2 / np.where(moving, 4 * stroke, 1.0)
        return np.where(moving, np.maximum(np.ceil(far), 1), 2 * np.ceil(smear - 0.5) + 1)

    def scene_numbers(self, scene: Scene, *, symmetric: bool) -> SceneNumbers:
        """A scene's speeds folded, and as many in number for every scene of the grid."""
        grid, dtype = self.grid, self.grid.dtype
        skips = grid.skips
        count = max(folded(other, symmetric, skips)[0].size for other in self.scenes)
        speeds, weights = folded(scene, symmetric, skips)
        spare = count - speeds.size
        own = (scene.photon_rate, scene.read_noise)
        light = [
            np.atleast_1d(np.asarray(mine if given is None else given))
            for mine, given in zip(own, (grid.photon_rates, grid.read_noises), strict=True)
        ]
        return SceneNumbers(
            jnp.asarray(np.pad(speeds, (0, spare), "edge"), dtype),
            jnp.asarray(np.pad(weights, ((0, 0), (0, spare))), dtype),
            scene.max_speed.astype(dtype),
            self._powers(scene),
            scene.mean_level.astype(dtype),
            *(jnp.asarray(values, dtype) for values in light),
        )

    def _tile(self, block: Block, chosen: Chosen, kit: Kit) -> tuple[np.ndarray, ...]:
        """A tile's numbers: what is computed, and how much of it."""
        rows, columns = self.grid.place(block)
        half = float(self._halves(block)[chosen.column])
        stroke = self._stroke(block, chosen, kit.tile_size)
        smear = self.max_speeds[block.scene] * half
        bandwidths = float(2 * stroke.max() + smear) * np.arange(1, PARTS + 1) / PARTS
        levels = kit.rules.levels(bandwidths)
        at = (rows.start + chosen.rows, columns.start + chosen.column)
        taps = still = self.num_taps[block.scene][at].max()
        if self.grid.skips:
            taps, still = min(np.max(_reach(stroke, smear)) + 1, taps), min(stroke.max() + 1, still)
        else:
            levels = np.full(PARTS, levels[-1])
        length = self.tile_sizes.lengths.index(self.dft_length[block.scene][at][0])
        grid = self.tile_sizes.grids.index(self.num_frequencies[block.scene][at][0])
        chunks = kit.rules.num_chunks[levels], -(-taps // TAPS), -(-still // TAPS)
        whole = (levels, *chunks, length, grid)
        padded = self._padded(block, chosen, kit.tile_size)
        return padded, np.asarray(half), *(np.asarray(x) for x in whole)

    def _powers(self, scene: Scene) -> jnp.ndarray:
        """Power of the picture on every frequency grid, with zeros after; `(g, m)`."""
        grids = self.tile_sizes.grids
        each = [np.asarray(picture_power(scene, count, self.grid.dtype)) for count in grids]
        return jnp.asarray(np.stack([np.pad(x, (0, max(grids) - x.size)) for x in each]))

    def _halves(self, block: Block) -> np.ndarray:
        return self.grid.half_exposures[self.grid.place(block)[1]]

    def _padded(self, block: Block, chosen: Chosen, tile_size: int) -> np.ndarray:
        a = self.grid.accelerations[self.grid.place(block)[0]][chosen.rows]
        return np.pad(a, (0, tile_size - a.size), "edge")

    def _stroke(self, block: Block, chosen: Chosen, tile_size: int) -> np.ndarray:
        half = self._halves(block)[chosen.column]
        return self._padded(block, chosen, tile_size) * half * half

    def _max_bandwidth(self) -> float:
        """Fastest `2A + B` that a point within limits asks for; px."""
        return self._largest(lambda a, half, fastest: 2 * a * half * half + fastest * half)

    @np.errstate(over="ignore")
    def _largest(self, value) -> float:
        """Largest value of a function of acceleration, half exposure and speed within limits."""
        a, half = self.grid.accelerations[:, None], self.grid.half_exposures[None]
        each = zip(self.max_speeds, self.outside, strict=True)
        return max(
            float(np.max(value(a, half, fastest), where=bits == 0, initial=0.0))
            for fastest, bits in each
        )


def folded(scene: Scene, symmetric: bool, skips: bool) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of the speeds, and how often each occurs in either direction.

    Each size that occurs once, where what cannot change a result is skipped.
    """
    speeds, weights = (np.asarray(x, np.float64) for x in (scene.speeds, scene.weights))
    if not skips:
        return np.abs(speeds), np.stack([weights * (speeds >= 0), weights * (speeds < 0)])
    speeds, weights = speeds[weights > 0], weights[weights > 0]
    sizes, index = np.unique(np.abs(speeds), return_inverse=True)
    begins = np.diff(sizes, prepend=-np.inf) > rounding(sizes, np.asarray(scene.speeds).dtype)
    sizes, index = sizes[begins], (np.cumsum(begins) - 1)[index]
    forward = np.bincount(index, weights * (speeds >= 0), sizes.size)
    back = np.bincount(index, weights * (speeds < 0), sizes.size)
    return sizes, (forward + back)[None] if symmetric else np.stack([forward, back])


def _reach(stroke: np.ndarray, smear: float) -> np.ndarray:
    """Taps that the fastest object's kernel spans, from the point of alignment; px."""
    moving = stroke > 0
    far = (2 * stroke + smear) ** 2 / np.where(moving, 4 * stroke, 1.0)
    return np.where(moving, far, 2 * np.ceil(smear) + 1)


@np.errstate(over="ignore", invalid="ignore")
def _point_sizes(
    scene: Scene, accelerations: np.ndarray, half_exposures: np.ndarray, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Taps, DFT length and frequencies that `evaluate` takes at each point; shape `(a, t)` each.

    They depend on whole pixels alone, of the longest kernel and of the spread of all light, so
    one point is asked for each.
    """
    stroke = accelerations[:, None] * half_exposures[None] ** 2
    smear = float(scene.max_speed) * half_exposures[None]
    far = (2 * stroke + smear) ** 2 / np.where(stroke > 0, 4 * stroke, np.inf)
    longest = np.maximum(np.maximum(far, 2 * smear), 4 * float(scene.limits.max_stroke))
    whole = np.where(inside, np.minimum(np.ceil(longest), 1 << 17), -1.0)
    num_taps, length, count = (np.zeros(whole.shape, np.int32) for _ in range(3))
    for value in np.unique(whole[inside]):
        same = whole == value
        row, column = np.argwhere(same)[0]
        point = (accelerations[row], half_exposures[column])
        a, half = (np.asarray(x, scene.speeds.dtype) for x in point)
        motion = ParabolicMotion(acceleration=a, half_exposure=half)
        plan = sizes(scene, settled(motion))
        num_taps[same], length[same] = plan.num_taps, plan.dft_length
    half = np.broadcast_to(half_exposures, stroke.shape)
    spread = np.where(inside, whole_px(spread_of(occurring_speeds(scene), stroke, half)), -1.0)
    for value in np.unique(spread[inside]):
        count[spread == value] = num_frequencies(scene, value)
    return num_taps, length, count
