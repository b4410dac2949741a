"""Blocks of a sweep as tasks of a `dask.distributed` cluster."""

import dataclasses
import logging
import pickle
import platform
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax

from mishutter._core.checks import Unquoted, require
from mishutter.design.design import package_version
from mishutter.sweeps.blocks import Arrays, Engine
from mishutter.sweeps.grid import Block, Grid
from mishutter.sweeps.store import Blocks, StoredBlocks

if TYPE_CHECKING:
    from distributed import Client, Future

_LOG = logging.getLogger("mishutter.sweep")
_SECONDS_TO_ANSWER = 10
_SHARED = "`sweep(store=...)` must be a folder that all workers share"
_engines: dict[str, Engine] = {}


@contextmanager
def connection(scheduler: object) -> "Iterator[Client]":
    """A client of a scheduler, which must answer within seconds, for as long as it is used."""
    try:
        from distributed import Client
    except ImportError:
        raise ValueError(
            "`sweep(scheduler=...)` must have distributed installed, by "
            "pip install 'mishutter[cluster]'; got no such package."
        ) from None
    if isinstance(scheduler, Client):
        yield scheduler
        return
    # The client's log of a lost connection would repeat an error that is raised here.
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        try:
            client = Client(str(scheduler), timeout=_SECONDS_TO_ANSWER)
        except (OSError, ValueError, TimeoutError):
            raise ValueError(
                f"`sweep(scheduler=...)` must be a scheduler that answers within "
                f"{_SECONDS_TO_ANSWER} s; got '{scheduler}'."
            ) from None
        with client as connected:
            yield connected
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def compute_remotely(
    grid: Grid, missing: list[Block], blocks: Blocks, client: "Client", store: str | None
) -> Iterator[Block]:
    """Compute blocks on a cluster, in whatever order they are finished.

    With a store its workers write to it; without one they send their results. A block whose worker
    dies goes to another.
    """
    import cloudpickle
    from distributed import as_completed

    if missing:
        check_workers(client)
        _check_sendable(grid)
    packed = cloudpickle.dumps(grid)
    wide = bool(jax.config.jax_enable_x64)  # type: ignore[attr-defined]
    tasks = {
        client.submit(compute_task, packed, block, store, wide, pure=False, retries=3): block
        for block in missing
    }
    for task in as_completed(list(tasks)):
        arrays = _result(task)
        if arrays is not None:
            blocks.write(tasks[task], arrays)
        task.release()
        yield tasks[task]
    if store is not None:
        num_lost = len(set(missing) & set(blocks.missing()))
        if num_lost:
            got = f"'{store}', which lacks {num_lost} of the {len(missing)} blocks that they wrote"
            raise ValueError(f"{_SHARED}; got {got}.")


def _result(task: "Future") -> Arrays | None:
    """The result of a worker for a block."""
    from distributed import KilledWorker

    try:
        return task.result()
    except KilledWorker:
        got = "workers that died, one after the other, of the same block: their logs say why"
    except CancelledError as error:
        got = getattr(error, "reason", "cancelled blocks")
    raise ConnectionError(
        f"`sweep(scheduler=...)` must last as long as the sweep; got {got}. With a store the same "
        "sweep goes on where it stopped."
    )


def check_workers(client: Any) -> None:
    """Refuse workers without this version of the package: one without any dies of a block."""
    workers = client.get_versions(packages=["mishutter"])["workers"]
    if not workers:
        _LOG.warning("no worker has joined the scheduler yet: waiting for one")
    ours, subject = package_version(), "sweep(scheduler=...)"
    for address, versions in workers.items():
        theirs = versions["packages"]["mishutter"] or "unknown"
        got = Unquoted(f"{theirs} on {address}")
        require(theirs == ours, subject, f"have workers with mishutter {ours}", got)


def _check_sendable(grid: Grid) -> None:
    """Refuse parts whose class is made anew on a worker, where Equinox does not know its fields."""

    def stays_here(part: object) -> bool:
        is_own = type(part).__module__ == "__main__"
        return isinstance(part, eqx.Module) and is_own and bool(dataclasses.fields(part))

    parts = jax.tree.leaves((grid.shutters, grid.search), is_leaf=stays_here)
    kinds = sorted({type(part).__name__ for part in parts if stays_here(part)})
    requirement = "have its shutters and loss from modules that workers can import"
    got = Unquoted(f"{', '.join(kinds)} of a script or notebook")
    require(not kinds, "sweep(scheduler=...)", requirement, got)


def compute_task(packed: bytes, block: Block, store: str | None, wide: bool) -> Arrays | None:
    """One block on a worker, at the client's precision; written if there is a store.

    The grid is unpacked under that precision, or its numbers would be narrowed.
    """
    with jax.enable_x64(wide):
        grid = pickle.loads(packed)
        if store is not None and not Path(store).exists():
            raise ValueError(f"{_SHARED}; got '{store}', not found on {platform.node()}.")
        # A worker opens the client's store, and never makes one of its own.
        blocks = None if store is None else StoredBlocks(grid, store, make=False)
        engine = _engines.get(grid.key)
        if engine is None:
            _engines.clear()
            engine = _engines[grid.key] = Engine(grid)
        arrays = engine.compute(block)
        if blocks is None:
            return arrays
        blocks.write(block, arrays)
        return None
