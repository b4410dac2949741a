"""Storage for the blocks of a sweep: in memory, or in a Zarr store that can be resumed.

A store is a Zarr group that xarray opens. Its attribute `sweep` describes the sweep; a store of
another sweep is refused. A block's arrays are chunks of their own. Its mark in `progress/done`,
their checksum, is written last: a block whose arrays do not have that checksum is computed again.
The marks are in a group of their own, so that xarray shows the variables alone. All other files
follow from the sweep, and are written anew where they differ from what they should be. Each chunk
has a checksum of its own besides, so that a damaged one is an error to whoever reads it.
"""

import errno
import json
import logging
import os
import tempfile
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np

from mishutter._core.checks import Unquoted, describe, require
from mishutter._core.files import write_bytes
from mishutter.evaluation.metrics import METRICS
from mishutter.sweeps.grid import REASONS, Block, Grid

if TYPE_CHECKING:
    import xarray

Arrays = dict[str, np.ndarray]
_LOG = logging.getLogger("mishutter.sweep")
_DONE = "progress/done"
_ROOT = "zarr.json"
_SUBJECT = "sweep(store=...)"
_MEANINGS = {
    "acceleration": ("parameter a of x = a t^2", "px/s^2"),
    "half_exposure": ("half the exposure, T", "s"),
    "velocity": ("velocity of the sensor at mid-exposure, v", "px/s"),
    "photon_rate": ("photo-electrons a second at a white pixel", "1/s"),
    "read_noise": ("standard deviation of the read noise", "electron"),
    "shutter": ("shutter", "1"),
    "scene": ("scene", "1"),
    "coefficient": ("B-spline coefficient of the optimised profile", "1"),
    "num_taps": ("taps of the kernels", "1"),
    "dft_length": ("points of the DFT of the condition number", "1"),
    "loss": ("loss of the optimised profile", "1"),
    "coefficients": ("B-spline coefficients of the optimised profile", "1"),
    "converged": ("whether the search for the profile converged", "1"),
    "outside": ("why a point is left out; 0 where it is not", "1"),
}
"""Long names and units of coordinates, and of variables that are no metrics."""


@final
class MemoryBlocks:
    """Blocks in memory, for a sweep without a store, which computes them all."""

    def __init__(self, grid: Grid):
        self.grid = grid
        sizes = grid.sizes
        self.arrays = {
            name: np.zeros([sizes[d] for d in grid.dimensions(name)], dtype)
            for name, dtype in grid.variables.items()
        }

    def missing(self) -> list[Block]:
        """Blocks that the sweep has still to compute, in their order."""
        return self.grid.blocks()

    def write(self, block: Block, arrays: Arrays) -> None:
        """Keeps the results of a block."""
        for name, values in arrays.items():
            region = self.grid.region(block, name)
            self.arrays[name][region] = values

    def dataset(self) -> "xarray.Dataset":
        """All variables on the whole grid, with axes, units and attributes."""
        return _labelled(self.grid, self.arrays)


@final
class StoredBlocks:
    """Blocks in a Zarr store, in which an earlier run may have put some."""

    def __init__(self, grid: Grid, path: str | Path, *, make: bool = True):
        import zarr

        self.grid, self.path = grid, Path(path)
        is_there = self.path.exists()
        is_folder, got = not is_there or self.path.is_dir(), Unquoted(f"a file, '{path}'")
        require(is_folder, _SUBJECT, "be a folder", got)
        attributes = dataset_attributes(grid)
        if make and not (is_there and any(self.path.iterdir())):
            try:
                _create(_files(grid, attributes), self.path)
            except OSError as error:
                got = f"'{path}': {error.strerror or type(error).__name__}"
                raise OSError(
                    f"`{_SUBJECT}` must be a folder that can be written; got {got}."
                ) from None
        stored = _stored_attributes(self.path)
        _check_same(stored["sweep"], json.loads(json.dumps(grid.describe())), self.path)
        if make:
            # Versions are those of the run that began the store, and need not be those of this one.
            versions = {"versions": stored.get("versions", attributes["versions"])}
            _mend(_files(grid, attributes | versions), self.path)
        self.group = zarr.open_group(self.path, mode="r+", use_consolidated=False)

    def missing(self) -> list[Block]:
        missing, damaged = [], []
        for block in self.grid.blocks():
            try:
                mark = int(self._array(_DONE)[tuple(block)])
                is_there = mark != 0
                regions = {name: self.grid.region(block, name) for name in self.grid.variables}
                arrays = {name: self._array(name)[region] for name, region in regions.items()}
                is_whole = is_there and mark == _checksum(arrays)
            except ValueError:  # A chunk does not have its own checksum.
                is_there, is_whole = True, False
            missing += [] if is_whole else [block]
            damaged += [tuple(block)] if is_there and not is_whole else []
        if damaged:
            names = ", ".join(map(str, damaged[:3])) + (", ..." if damaged[3:] else "")
            _LOG.warning("blocks damaged in '%s' are computed again: %s", self.path, names)
        return missing

    def write(self, block: Block, arrays: Arrays) -> None:
        try:
            for name, values in arrays.items():
                region = self.grid.region(block, name)
                self._array(name)[region] = values
            self._array(_DONE)[tuple(block)] = _checksum(arrays)
        except OSError as error:
            if error.filename is None:  # A full disk does not say where it is full.
                error.filename = str(self.path)
            raise

    def _array(self, name: str) -> Any:
        return self.group[name]

    def dataset(self) -> "xarray.Dataset":
        import xarray

        dataset = xarray.open_zarr(self.path, chunks=None, consolidated=False)
        return dataset[list(self.grid.variables)]


Blocks = MemoryBlocks | StoredBlocks
"""Blocks that were computed, and those that still have to be."""


def _labelled(grid: Grid, arrays: Arrays) -> "xarray.Dataset":
    """Whole arrays of every variable with their dimensions, coordinates and attributes."""
    import xarray

    axes = {
        "scene": np.array(list(grid.scenes), dtype=object),
        "velocity": grid.velocities,
        "acceleration": grid.accelerations,
        "half_exposure": grid.half_exposures,
        "shutter": np.array(grid.shutter_names, dtype=object),
        "photon_rate": grid.photon_rates,
        "read_noise": grid.read_noises,
    }
    if grid.search is not None:
        axes["coefficient"] = np.arange(grid.search.num_coefficients)
    coordinates: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, object]]] = {
        name: ((name,), np.asarray(axes[name]), attributes_of(name)) for name in grid.sizes
    }
    if grid.velocities is None:  # a coordinate of each scene
        velocities = np.array([frame.velocity for frame in grid.frames])
        velocities = velocities.reshape([*grid.frame_sizes.values()])
        coordinates["velocity"] = (tuple(grid.frame_sizes), velocities, attributes_of("velocity"))
    variables = {
        name: (grid.dimensions(name), values, attributes_of(name))
        for name, values in arrays.items()
    }
    return xarray.Dataset(variables, coordinates, dataset_attributes(grid))


def attributes_of(name: str) -> dict[str, Any]:
    """Name and unit of a variable, and the meanings of its flags."""
    of_metrics = {metric.name: (metric.meaning, metric.unit) for metric in METRICS.values()}
    long_name, unit = (of_metrics | _MEANINGS)[name]
    attributes: dict[str, Any] = {"long_name": long_name, "units": unit}
    if name == "outside":
        attributes["flag_masks"] = [1 << bit for bit in range(len(REASONS))]
        attributes["flag_meanings"] = " ".join(REASONS)
    return attributes


def dataset_attributes(grid: Grid) -> dict[str, object]:
    """Attributes that make a sweep reproducible."""
    from importlib.metadata import version

    return {
        "title": "acceleration and exposure of a motion-invariant camera",
        "versions": json.dumps({name: version(name) for name in ("jax", "numpy", "equinox")}),
        "sweep": json.dumps(grid.describe()),
        "level": grid.level,
    }


def _create(files: dict[str, bytes], path: Path) -> None:
    """Make a store beside its place, then move it there in one step."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        whole = Path(folder) / path.name
        _mend(files, whole)
        try:
            os.rename(whole, path)
        except OSError as error:
            # Another process may have made it meanwhile; the caller checks that it is the same.
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise


def _mend(files: dict[str, bytes], path: Path) -> None:
    """Write those files of a store anew that are missing or not what they should be."""
    for name, content in files.items():
        file = path / name
        if not file.is_file() or file.read_bytes() != content:
            file.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(file, content)


def _files(grid: Grid, attributes: dict[str, object]) -> dict[str, bytes]:
    """Every file of a store without blocks, by its path in there."""
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec
    from zarr.core.buffer import Buffer
    from zarr.storage import MemoryStore

    files: dict[str, Buffer] = {}
    store = MemoryStore(files)
    codecs = ZstdCodec(), Crc32cCodec()
    empty = _labelled(grid, {}).assign_attrs(attributes)
    encoding = {key: {"compressors": codecs} for key in empty.variables}
    empty.to_zarr(store, mode="w", zarr_format=3, consolidated=False, encoding=encoding)
    group = zarr.open_group(store, mode="r+")
    rows, columns = grid.block_shape
    of_block = dict.fromkeys(grid.frame_sizes, 1)
    of_block |= {"acceleration": rows, "half_exposure": columns}
    for name, dtype in grid.variables.items():
        dimensions = grid.dimensions(name)
        group.create_array(
            name,
            shape=[grid.sizes[d] for d in dimensions],
            chunks=tuple(of_block.get(d, grid.sizes[d]) for d in dimensions),
            dtype=dtype,
            fill_value=np.nan if dtype.kind == "f" else 0,
            dimension_names=dimensions,
            attributes=attributes_of(name),
            compressors=codecs,
        )
    group.create_array(
        _DONE,
        shape=np.array(grid.blocks()).max(axis=0) + 1,
        chunks=(1, 1, 1),
        dtype=np.uint32,
        fill_value=0,
        dimension_names=("block_frame", "block_acceleration", "block_half_exposure"),
        compressors=codecs,
    )
    with warnings.catch_warnings():
        # Zarr has consolidated metadata, which xarray looks for, and its specification not yet.
        warnings.filterwarnings("ignore", "Consolidated metadata")
        zarr.consolidate_metadata(store)
    return {name: content.to_bytes() for name, content in files.items()}


def _checksum(arrays: Arrays) -> int:
    """Checksum of the arrays of a block; all NaNs count as one, whatever their bits."""
    checksum = 0
    for name in sorted(arrays):
        values = np.where(np.isnan(arrays[name]), np.nan, arrays[name])
        checksum = zlib.crc32(values.tobytes(), checksum)
    return checksum


def saved_points(path: Path) -> tuple[int, int]:
    """Points of the blocks that a sweep's store holds, and of all."""
    import zarr

    sweep = _stored_attributes(path)["sweep"]
    done: Any = zarr.open_group(path, mode="r", use_consolidated=False)[_DONE]
    is_done, sizes = done[...] != 0, []
    axes = sweep["accelerations"], sweep["half_exposures"]
    for axis, most, count in zip(axes, sweep["block_shape"], is_done.shape[1:], strict=True):
        sizes.append(np.minimum(most, len(axis) - most * np.arange(count)))
    points = np.broadcast_to(np.outer(*sizes), is_done.shape)
    return int(points[is_done].sum()), int(points.sum())


def _stored_attributes(path: Path) -> dict[str, Any]:
    """The attributes of a sweep's store, whose `sweep` is opened."""
    try:
        attributes = dict(json.loads((path / _ROOT).read_bytes())["attributes"])
        return attributes | {"sweep": dict(json.loads(attributes["sweep"]))}
    except FileNotFoundError:
        got = f"'{path}', which has no {_ROOT}"
    except (ValueError, TypeError, KeyError):
        got = f"'{path}', whose {_ROOT} is damaged or of something else"
    raise ValueError(f"`{_SUBJECT}` must be a sweep's store; got {got}.")


def _check_same(stored: dict[str, object], current: dict[str, object], path: Path) -> None:
    """Refuse a store of another sweep, by the first part that differs.

    An argument that an earlier version did not have is one that is not given.
    """
    theirs = dict(_leaves({name: stored.get(name) for name in current}))
    ours = dict(_leaves(current))
    for place in {**ours, **theirs}:
        want, got = ours.get(place), theirs.get(place)
        if want != got:
            words = ", ".join([place[0].replace("_", " "), *place[1:]])
            raise ValueError(
                f"`{_SUBJECT}` must hold the same sweep, with {words}: {_short(want)}; got "
                f"{_short(got)} in '{path}'."
            )


def _leaves(value: object, *place: str) -> Iterator[tuple[tuple[str, ...], object]]:
    """The parts of a description that are no tables, each behind the names that lead to it."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield from _leaves(part, *place, name)
    else:
        yield place, value


def _short(value: object) -> str:
    if isinstance(value, list) and len(value) > 4:
        return f"{len(value)} from {value[0]} to {value[-1]}"
    return describe(value)
