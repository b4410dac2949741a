"""Blocks of a sweep as tasks of a `dask.distributed` cluster."""

import logging
import pickle
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import jax

from mishutter.sweep_blocks import Arrays, Engine
from mishutter.sweep_grid import Block, Grid
from mishutter.sweep_store import AbstractBlocks, StoredBlocks

_SECONDS_TO_ANSWER = 10
_RETRIES = 3
_engines: dict[str, Engine] = {}


def connection(scheduler: Any) -> AbstractContextManager:
    """A client of a scheduler, for as long as it is used; None where there is none.

    Raises:
        ValueError: if `distributed` is not installed or no scheduler answers.
    """
    if scheduler is None:
        return nullcontext()
    try:
        from distributed import Client
    except ImportError:
        raise ValueError(
            "`sweep(scheduler=...)` must have distributed installed, by "
            "pip install 'mishutter[cluster]'; got no such package."
        ) from None
    own = not isinstance(scheduler, Client)
    return _connected(Client, scheduler) if own else nullcontext(scheduler)


def compute_remotely(
    grid: Grid, missing: list[Block], blocks: AbstractBlocks, client: Any, store: str | None
) -> Iterator[Block]:
    """Compute blocks on a cluster, in whatever order they are finished.

    With a store its workers write to it; without one they send what they found. A block
    whose worker dies goes to another.
    """
    import cloudpickle
    from distributed import as_completed

    packed = cloudpickle.dumps(grid)
    wide = bool(jax.config.jax_enable_x64)  # type: ignore[attr-defined]
    tasks = {
        client.submit(compute_task, packed, block, store, wide, pure=False, retries=_RETRIES): block
        for block in missing
    }
    for task in as_completed(list(tasks)):
        arrays = task.result()
        if arrays is not None:
            blocks.write(tasks[task], arrays)
        task.release()
        yield tasks[task]


def compute_task(packed: bytes, block: Block, store: str | None, wide: bool) -> Arrays | None:
    """One block on a worker, at the client's precision; written if there is a store.

    The grid is unpacked under that precision, or its numbers would be narrowed.
    """
    with jax.enable_x64(wide):
        grid = pickle.loads(packed)
        engine = _engines.get(grid.key)
        if engine is None:
            _engines.clear()
            engine = _engines[grid.key] = Engine(grid)
        arrays = engine.compute(block)
        if store is None:
            return arrays
        StoredBlocks(grid, store).write(block, arrays)
        return None


def _connected(client: Any, address: Any) -> Any:
    """A client of the scheduler at an address, which must answer within seconds."""
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        return client(str(address), timeout=_SECONDS_TO_ANSWER)
    except (OSError, ValueError, TimeoutError):
        raise ValueError(
            f"`sweep(scheduler=...)` must be a scheduler that answers within "
            f"{_SECONDS_TO_ANSWER} s; got '{address}'."
        ) from None
    finally:
        logger.setLevel(level)
