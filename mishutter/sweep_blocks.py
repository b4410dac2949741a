"""One block of a sweep: its points sorted into tiles, the tiles shared out over devices."""

from functools import partial
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from mishutter.metrics import picture_power
from mishutter.motion import ParabolicMotion, settled
from mishutter.plan import NUM_FREQUENCIES, is_symmetric, sizes
from mishutter.scene import Scene
from mishutter.sweep_grid import (
    KERNEL_METRICS,
    REASONS,
    SPECTRUM_METRICS,
    Block,
    Grid,
    outside_limits,
)
from mishutter.sweep_kernels import TAPS
from mishutter.sweep_points import SceneNumbers, Tile, TileSizes
from mishutter.sweep_tables import Tables, tabulate
from mishutter.sweep_tiles import TileMetrics, measure_tile

Arrays = dict[str, np.ndarray]
_TILE_SIZES = range(32, 15, -1)
_TILES_PER_DEVICE = 8
"""Tiles that a device does in one call: the same however many devices share the work."""


class Chosen(NamedTuple):
    """Points of a block that make a tile: some accelerations of one half exposure."""

    rows: np.ndarray
    column: int


@final
class Engine:
    """What the blocks of a grid share: tables of the shutters and one compiled program.

    Args:
        grid: The sweep.
    """

    def __init__(self, grid: Grid):
        self.grid = grid
        scenes = list(grid.scenes.values())
        a, half = grid.accelerations, grid.half_exposures
        self.outside = [outside_limits(scene, a, half) for scene in scenes]
        plans = [
            _point_sizes(x, a, half, b == 0) for x, b in zip(scenes, self.outside, strict=True)
        ]
        self.num_taps = [plan[0] for plan in plans]
        self.dft_length = [plan[1] for plan in plans]
        shutters = list(grid.shutters.values())
        self.symmetric = all(is_symmetric(shutter) for shutter in shutters)
        self.tables, self.rules = tabulate(shutters, self._max_bandwidth(), grid.dtype)
        self.sizes = self._tile_sizes()
        rows = min(a.size, grid.block_shape[0])
        self.tile_size = min(_TILE_SIZES, key=lambda size: -(-rows // size) * size)
        self.tile_size = min(self.tile_size, rows)
        self.mesh = Mesh(np.array(jax.devices()), ("tiles",))
        self.num_tiles = _TILES_PER_DEVICE * self.mesh.size

    def compute(self, block: Block) -> Arrays:
        """Every variable of a block, NaN outside the limits; a scene's axis left out."""
        grid = self.grid
        place = grid.place(block)
        bits = self.outside[block.scene][place]
        inside = bits == 0
        tiles = self._tiles(block)
        arrays = self._scattered(block, self._measured(block, tiles), tiles)
        arrays["num_taps"] = np.where(inside, self.num_taps[block.scene][place], 0)
        arrays["dft_length"] = np.where(inside, self.dft_length[block.scene][place], 0)
        arrays["outside"] = bits
        if grid.search is not None:
            from mishutter.sweep_search import search_block

            found = search_block(self, block)
            for name, values in found.items():
                joined = name in grid.metrics
                arrays[name] = np.concatenate([arrays[name], values], 2) if joined else values
        if grid.full_well is not None:
            self._overflow(arrays, block)
        return {key: arrays[key].astype(dtype) for key, dtype in grid.variables.items()}

    def scene_numbers(self, scene: Scene, *, symmetric: bool) -> SceneNumbers:
        """A scene's speeds folded, and as many in number for every scene of the grid."""
        grid, dtype = self.grid, self.grid.dtype
        count = max(_folded(other, symmetric)[0].size for other in grid.scenes.values())
        speeds, weights = _folded(scene, symmetric)
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
            picture_power(scene, NUM_FREQUENCIES, dtype),
            scene.mean_level.astype(dtype),
            *(jnp.asarray(values, dtype) for values in light),
        )

    def tile_of(self, block: Block, chosen: Chosen | None) -> Tile:
        """A tile's numbers: what is computed, and how much of it; an empty tile for None."""
        grid = self.grid
        if chosen is None:
            size = self.tile_size
            return Tile(np.ones(size), np.ones(()), *(np.zeros((), np.int32) for _ in range(5)))
        rows, columns = grid.place(block)
        a = grid.accelerations[rows][chosen.rows]
        half = grid.half_exposures[columns][chosen.column]
        stroke = a * half * half
        smear = float(list(grid.scenes.values())[block.scene].max_speed) * float(half)
        level = self.rules.level(float(2 * stroke.max() + smear))
        at = (rows.start + chosen.rows, columns.start + chosen.column)
        most = self.num_taps[block.scene][at].max()
        taps = min(np.max(_reach(stroke, smear)) + 1, most)
        still = min(stroke.max() + 1, most)
        length = self.sizes.lengths.index(self.dft_length[block.scene][at][0])
        whole = (level, self.rules.num_chunks[level], -(-taps // TAPS), -(-still // TAPS), length)
        padded = self._padded(a)
        return Tile(padded, np.asarray(half), *(np.asarray(x, np.int32) for x in whole))

    def _padded(self, accelerations: np.ndarray) -> np.ndarray:
        return np.pad(accelerations, (0, self.tile_size - accelerations.size), "edge")

    def _stroke(self, block: Block, chosen: Chosen) -> np.ndarray:
        rows, columns = self.grid.place(block)
        half = self.grid.half_exposures[columns][chosen.column]
        return self._padded(self.grid.accelerations[rows][chosen.rows]) * half * half

    def _tiles(self, block: Block) -> list[Chosen]:
        rows, columns = self.grid.place(block)
        allowed = self.outside[block.scene][rows, columns] == 0
        lengths = self.dft_length[block.scene][rows, columns]
        return [
            Chosen(index[start : start + self.tile_size], column)
            for column in range(allowed.shape[1])
            for length in np.unique(lengths[:, column])
            for index in [np.flatnonzero(allowed[:, column] & (lengths[:, column] == length))]
            for start in range(0, index.size, self.tile_size)
        ]

    def _measured(self, block: Block, tiles: list[Chosen]) -> TileMetrics | None:
        """Metrics of all tiles, as many at once as a full block has."""
        if not tiles:
            return None
        scene = list(self.grid.scenes.values())[block.scene]
        numbers = self.scene_numbers(scene, symmetric=self.symmetric)
        parts = []
        for start in range(0, len(tiles), self.num_tiles):
            some = tiles[start : start + self.num_tiles]
            filled = [*some, *[None] * (self.num_tiles - len(some))]
            stacked = self.stacked(block, filled)
            part = _measure_tiles(self.tables, numbers, stacked, self.sizes, self.mesh)
            parts.append(jax.tree.map(np.asarray, part))
        return jax.tree.map(lambda *x: np.concatenate(x)[: len(tiles)], *parts)

    def stacked(self, block: Block, tiles: list[Chosen | None]) -> Tile:
        """Tiles on one leading axis."""
        each = [self.tile_of(block, chosen) for chosen in tiles]
        dtypes = [self.grid.dtype] * 2 + [np.dtype(np.int32)] * 5
        columns = zip(zip(*each, strict=True), dtypes, strict=True)
        return Tile(*(jnp.asarray(np.stack(x), dtype) for x, dtype in columns))

    def _scattered(self, block: Block, found: TileMetrics | None, tiles: list[Chosen]) -> Arrays:
        """Metrics of tiles put back where their points stand."""
        grid = self.grid
        shape = self.outside[block.scene][grid.place(block)].shape
        efficiency = np.asarray(self.tables.efficiency)
        light = grid.dimensions("expected_psnr")[len(grid.dimensions("efficiency")) :]
        tail = {"expected_psnr": tuple(grid.sizes[name] for name in light)}
        arrays = {
            name: np.full((*shape, efficiency.size, *tail.get(name, ())), np.nan)
            for name in {*grid.metrics, "efficiency"}
        }
        if found is None:
            return arrays
        stroke = np.stack([self._stroke(block, chosen) for chosen in tiles])
        half = grid.half_exposures[grid.place(block)[1]][[chosen.column for chosen in tiles]]
        smear = float(list(grid.scenes.values())[block.scene].max_speed) * half[:, None]
        values = _finished(found, _num_supported(stroke, smear))
        for number, (rows, column) in enumerate(tiles):
            for name in arrays:
                if name == "efficiency":
                    arrays[name][rows, column] = efficiency
                else:
                    part = values[name][number, : rows.size]
                    arrays[name][rows, column] = part.reshape(arrays[name][rows, column].shape)
        return arrays

    def _overflow(self, arrays: Arrays, block: Block) -> None:
        """Leave out what fills a white pixel."""
        grid = self.grid
        scene = list(grid.scenes.values())[block.scene]
        half = grid.half_exposures[grid.place(block)[1]]
        by_light = grid.photon_rates is not None
        rates = np.atleast_1d(grid.photon_rates if by_light else float(scene.photon_rate))
        electrons = arrays["efficiency"][..., None] * 2 * half[:, None, None] * rates
        full = electrons > grid.full_well
        bits = np.where(full, np.uint8(1 << REASONS.index("full_well")), np.uint8(0))
        bits = bits | arrays["outside"][:, :, None, None]
        arrays["outside"] = bits if by_light else bits[..., 0]
        for name in grid.metrics:
            values = arrays[name]
            if by_light and name == "expected_psnr":
                values[full] = np.nan
            else:
                values[np.all(full, axis=3)] = np.nan

    def _max_bandwidth(self) -> float:
        """Fastest `2A + B` that a point within limits asks for; px."""
        a, half = self.grid.accelerations[:, None], self.grid.half_exposures[None]
        most = 0.0
        for scene, bits in zip(self.grid.scenes.values(), self.outside, strict=True):
            velocity = 2 * a * half * half + float(scene.max_speed) * half
            most = max(most, float(np.max(velocity, where=bits == 0, initial=0.0)))
        return most

    def _tile_sizes(self) -> TileSizes:
        a, half = self.grid.accelerations[:, None], self.grid.half_exposures[None]
        inside = np.any([bits == 0 for bits in self.outside], axis=0)
        stroke = float(np.max(a * half * half, where=inside, initial=0.0))
        lengths = np.unique(
            np.concatenate(
                [x[b == 0] for x, b in zip(self.dft_length, self.outside, strict=True)] + [[256]]
            )
        )
        return TileSizes(
            lengths=tuple(int(x) for x in lengths),
            still_taps=-(-(int(stroke) + 2) // TAPS) * TAPS,
            kernels=any(name in KERNEL_METRICS for name in self.grid.metrics),
            spectra=any(name in SPECTRUM_METRICS for name in self.grid.metrics),
        )


@eqx.filter_jit
def _measure_tiles(
    tables: Tables, scene: SceneNumbers, tiles: Tile, sizes: TileSizes, mesh: Mesh
) -> TileMetrics:
    """Metrics of tiles; each device does its share, one tile after the other."""
    spread, whole = PartitionSpec("tiles"), PartitionSpec()

    @partial(
        jax.shard_map, mesh=mesh, in_specs=(whole, whole, spread), out_specs=spread, check_vma=False
    )
    def share(tables: Tables, scene: SceneNumbers, tiles: Tile) -> TileMetrics:
        return jax.lax.map(lambda tile: measure_tile(tables, scene, sizes, tile), tiles)

    return share(tables, scene, tiles)


def _folded(scene: Scene, symmetric: bool) -> tuple[np.ndarray, np.ndarray]:
    """Distinct sizes of the speeds that occur, and how often each does in either direction."""
    speeds, weights = (np.asarray(x, np.float64) for x in (scene.speeds, scene.weights))
    speeds, weights = speeds[weights > 0], weights[weights > 0]
    sizes, index = np.unique(np.abs(speeds), return_inverse=True)
    forward = np.bincount(index, weights * (speeds >= 0), sizes.size)
    back = np.bincount(index, weights * (speeds < 0), sizes.size)
    return sizes, (forward + back)[None] if symmetric else np.stack([forward, back])


def _finished(found: TileMetrics, num_supported: np.ndarray) -> Arrays:
    """Metrics from what the tiles summed."""
    with np.errstate(divide="ignore", invalid="ignore"):
        raw = np.sqrt(np.asarray(found.squared_difference) / num_supported[..., None])
        level = np.sqrt(np.asarray(found.squared_kernel) / num_supported[..., None])
        return {
            "condition_number": np.asarray(found.condition_number),
            "kernel_difference": raw,
            "relative_kernel_difference": np.where(level > 0, raw / level, 0.0),
            "expected_psnr": -10 * np.log10(np.asarray(found.squared_error)),
            "bound_share": np.asarray(found.bound_share),
        }


def _num_supported(stroke: np.ndarray, smear: np.ndarray) -> np.ndarray:
    """Taps that light of the fastest object falls on; the shape of `stroke`."""
    moving = stroke > 0
    far = (2 * stroke + smear) ** 2 / np.where(moving, 4 * stroke, 1.0)
    return np.maximum(np.ceil(np.where(moving, far, 2 * smear)), 1)


def _reach(stroke: np.ndarray, smear: float) -> np.ndarray:
    """Taps that the fastest object's kernel spans, from the point of alignment; px."""
    moving = stroke > 0
    far = (2 * stroke + smear) ** 2 / np.where(moving, 4 * stroke, 1.0)
    return np.where(moving, far, 2 * np.ceil(smear) + 1)


def _point_sizes(
    scene: Scene, accelerations: np.ndarray, half_exposures: np.ndarray, inside: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Taps and DFT length that `evaluate` takes at each point; shape `(a, t)` each.

    They depend on whole pixels of the longest kernel alone, so one point is asked for each.
    """
    stroke = accelerations[:, None] * half_exposures[None] ** 2
    smear = float(scene.max_speed) * half_exposures[None]
    with np.errstate(over="ignore"):
        far = (2 * stroke + smear) ** 2 / np.where(stroke > 0, 4 * stroke, np.inf)
    longest = np.maximum(np.maximum(far, 2 * smear), 4 * float(scene.limits.max_stroke))
    whole = np.where(inside, np.minimum(np.ceil(longest), 1 << 14), -1.0)
    num_taps, length = np.zeros(whole.shape, np.int32), np.zeros(whole.shape, np.int32)
    for value in np.unique(whole[inside]):
        same = whole == value
        row, column = np.argwhere(same)[0]
        point = (accelerations[row], half_exposures[column])
        a, half = (np.asarray(x, scene.speeds.dtype) for x in point)
        motion = ParabolicMotion(acceleration=a, half_exposure=half)
        plan = sizes(scene, settled(motion))
        num_taps[same], length[same] = plan.num_taps, plan.dft_length
    return num_taps, length
