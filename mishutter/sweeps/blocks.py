"""One block of a sweep: its points sorted into tiles, the tiles shared out over devices."""

from collections.abc import Iterable, Iterator
from functools import partial
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array

from mishutter._core import compiled, in_threads, num_threads
from mishutter.sweeps.grid import REASONS, Block, Grid
from mishutter.sweeps.layout import Chosen, Kit, Layout
from mishutter.sweeps.points import SceneNumbers, Tile, TileSizes
from mishutter.sweeps.search import Searcher, basis_shutters, coefficients_of
from mishutter.sweeps.tables import Tables
from mishutter.sweeps.tiles import TileMetrics, measure_tile

Arrays = dict[str, np.ndarray]
_TILES_PER_DEVICE = 8
"""Tiles that a device does in one call: the same however many devices share the work."""


@final
class Engine:
    """What the blocks of a grid share: tables of the shutters and one compiled program.

    Args:
        grid: The sweep.
    """

    def __init__(self, grid: Grid):
        self.grid = grid
        self.layout = Layout(grid)
        self.sizes = self.layout.tile_sizes
        self.fixed = self.layout.kit(list(grid.shutters.values()))
        self.searcher = None
        if grid.search is not None:
            basis = self.layout.kit(basis_shutters(grid.search))
            self.searcher = Searcher(self.layout, basis, grid.search)
        self.mesh = Mesh(np.array(jax.devices()), ("tiles",))
        self.num_threads = num_threads(self.mesh.devices)

    def computed(self, blocks: Iterable[Block]) -> Iterator[Arrays]:
        """The variables of blocks, in order; with a search some blocks at a time."""
        return in_threads(self.compute, blocks, self.num_threads if self.searcher else 1)

    def compute(self, block: Block) -> Arrays:
        """Every variable of a block, NaN outside the limits; a scene's axis left out."""
        grid, layout = self.grid, self.layout
        place, inside = grid.place(block), layout.inside(block)
        light = np.asarray(self.fixed.tables.efficiency)
        arrays = self._metrics(block, self.fixed, None, light[None, None])
        arrays["num_taps"] = np.where(inside, layout.num_taps[block.scene][place], 0)
        arrays["dft_length"] = np.where(inside, layout.dft_length[block.scene][place], 0)
        arrays["outside"] = layout.outside[block.scene][place]
        if self.searcher is not None:
            basis = self.searcher.basis
            boxes, arrays["loss"] = self.searcher.search(block)
            arrays["coefficients"] = coefficients_of(boxes, self.searcher.settings)
            light = boxes @ np.asarray(basis.tables.efficiency)
            for name, values in self._metrics(block, basis, boxes, light[..., None]).items():
                arrays[name] = np.concatenate([arrays[name], values], axis=2)
        if grid.full_well is not None:
            self._overflow(arrays, block, grid.full_well)
        return {key: arrays[key].astype(dtype) for key, dtype in grid.variables.items()}

    def _metrics(
        self, block: Block, kit: Kit, boxes: np.ndarray | None, efficiency: np.ndarray
    ) -> Arrays:
        """Metrics of a kit's shutters, or of one mixture of them at each point.

        Args:
            block: The points.
            kit: The shutters.
            boxes: Shares of them at each point, shape `(a, t, k)`; None for each alone.
            efficiency: Light let through; broadcasts against `(a, t, k)`.
        """
        grid, inside = self.grid, self.layout.inside(block)
        count = efficiency.shape[2]
        shape = (*inside.shape, count)
        light = grid.dimensions("expected_psnr")[len(grid.dimensions("efficiency")) :]
        tail = {"expected_psnr": tuple(grid.sizes[name] for name in light)}
        arrays = {name: np.full((*shape, *tail.get(name, ())), np.nan) for name in grid.metrics}
        arrays["efficiency"] = np.where(inside[..., None], efficiency, np.nan)
        tiles = self.layout.tiles(block, kit.tile_size)
        if not tiles or not (self.sizes.kernels or self.sizes.spectra):
            return arrays
        found = self._measured(block, kit, tiles, boxes)
        values = _finished(found, self.layout.num_supported(block, tiles, kit.tile_size))
        for number, (rows, column) in enumerate(tiles):
            for name in values.keys() & arrays.keys():
                part = values[name][number, : rows.size]
                arrays[name][rows, column] = part.reshape(arrays[name][rows, column].shape)
        return arrays

    def _measured(
        self, block: Block, kit: Kit, tiles: list[Chosen], boxes: np.ndarray | None
    ) -> TileMetrics:
        """What the tiles sum up to, some tiles a call."""
        scene = self.layout.scenes[block.scene]
        numbers = self.layout.scene_numbers(scene, symmetric=kit.symmetric)
        num_tiles = _TILES_PER_DEVICE * self.mesh.size

        def measured(start: int) -> TileMetrics:
            some = tiles[start : start + num_tiles]
            stacked = self.layout.stacked(block, some, kit, num_tiles)
            shares = _mixtures(boxes, some, num_tiles, kit.tile_size).astype(self.grid.dtype)
            found = _measure_tiles(
                kit.tables, numbers, stacked, jnp.asarray(shares), self.sizes, self.mesh
            )
            return jax.tree.map(np.asarray, found)

        num_threads = self.num_threads if self.searcher is None else 1
        parts = list(in_threads(measured, range(0, len(tiles), num_tiles), num_threads))
        return jax.tree.map(lambda *x: np.concatenate(x)[: len(tiles)], *parts)

    def _overflow(self, arrays: Arrays, block: Block, full_well: float) -> None:
        """Leave out what fills a white pixel."""
        grid, scene = self.grid, self.layout.scenes[block.scene]
        half = grid.half_exposures[grid.place(block)[1]]
        by_light = grid.photon_rates is not None
        own = np.array([float(scene.photon_rate)])
        rates = own if grid.photon_rates is None else grid.photon_rates
        electrons = arrays["efficiency"][..., None] * 2 * half[:, None, None] * rates
        full = electrons > full_well
        bits = np.where(full, np.uint8(1 << REASONS.index("full_well")), np.uint8(0))
        bits = bits | arrays["outside"][:, :, None, None]
        arrays["outside"] = bits if by_light else bits[..., 0]
        for name in grid.metrics:
            if by_light and name == "expected_psnr":
                arrays[name][full] = np.nan
            else:
                arrays[name][np.all(full, axis=3)] = np.nan


def _mixtures(
    boxes: np.ndarray | None, tiles: list[Chosen], num_tiles: int, tile_size: int
) -> np.ndarray:
    """Shares of the basis at the points of tiles; shape `(tiles, j, k)`, or nothing."""
    if boxes is None:
        return np.zeros((num_tiles, 0))
    mixtures = np.zeros((num_tiles, tile_size, boxes.shape[2]))
    for number, (rows, column) in enumerate(tiles):
        mixtures[number, : rows.size] = boxes[rows, column]
    return mixtures


@compiled
def _measure_tiles(
    tables: Tables,
    scene: SceneNumbers,
    tiles: Tile,
    mixtures: Array,
    sizes: TileSizes,
    mesh: Mesh,
) -> TileMetrics:
    """Metrics of tiles; each device does its share, one tile after the other."""
    spread, whole = PartitionSpec("tiles"), PartitionSpec()

    @partial(
        jax.shard_map,
        mesh=mesh,
        in_specs=(whole, whole, spread, spread),
        out_specs=spread,
        check_vma=False,
    )
    def share(tables: Tables, scene: SceneNumbers, tiles: Tile, mixtures: Array) -> TileMetrics:
        return jax.lax.map(
            lambda pair: measure_tile(tables, scene, sizes, *pair), (tiles, mixtures)
        )

    return share(tables, scene, tiles, mixtures)


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
