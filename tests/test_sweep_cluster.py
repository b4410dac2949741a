"""Blocks as tasks of a cluster: the same numbers, and a worker may die."""

import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from helpers_sweep import SCENE, grid
from test_cli import refused

import mishutter
from mishutter import sweep

pytestmark = pytest.mark.filterwarnings("ignore")


def many(**others):
    """A sweep of six blocks."""
    given = {"accelerations": np.arange(1, 701) * 2e3, "half_exposures": [2e-3, 5e-3]}
    return grid(**given | others)


@pytest.fixture
def cluster(monkeypatch):
    """Two worker processes that find the package under test."""
    from distributed import LocalCluster

    path = os.pathsep.join([str(Path(mishutter.__file__).parent.parent), *sys.path])
    monkeypatch.setenv("PYTHONPATH", path)
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as made:
        yield made


@pytest.mark.slow
def test_two_workers_give_the_same(cluster, tmp_path):
    """As arrays sent back to an address's caller, and in a store that a client writes to."""
    from distributed import Client

    alone = sweep(SCENE, **many())
    assert sweep(SCENE, **many(scheduler=cluster.scheduler_address)).identical(alone)
    with Client(cluster) as client:
        stored = sweep(SCENE, **many(scheduler=client, store=tmp_path / "a.zarr"))
        assert stored.load().identical(alone)


@pytest.mark.slow
def test_a_dead_worker_is_survived(cluster, tmp_path):
    """One of the two is killed after the first block; the other ends the sweep."""
    from distributed import Client

    killed = []

    def kill_one(done, total):
        if done and not killed:
            worker = next(iter(cluster.workers.values()))
            killed.append(worker.pid)
            os.kill(worker.pid, 9)
            time.sleep(0.5)

    with Client(cluster) as client:
        stored = sweep(
            SCENE, **many(scheduler=client, store=tmp_path / "a.zarr", progress=kill_one)
        )
    assert killed
    assert stored.load().identical(sweep(SCENE, **many()))


def test_a_scheduler_that_does_not_answer(monkeypatch, tmp_path, capsys):
    """One line within seconds, in Python and on the command line, and no store is made."""
    monkeypatch.setattr("mishutter.sweep_cluster._SECONDS_TO_ANSWER", 1)
    address = "tcp://127.0.0.1:9"
    with pytest.raises(ValueError, match=r"must be a scheduler that answers within 1 s; got"):
        sweep(SCENE, **many(scheduler=address, store=tmp_path / "a.zarr"))
    assert not any(tmp_path.iterdir())
    arguments = ["sweep", "--acceleration", "1e5:2e5:2", "--half-exposure", "5:6:2"]
    line = refused(capsys, *arguments, "--scheduler", address)
    assert line.startswith("mishutter: error: `sweep(scheduler=...)` must be a scheduler")


def test_without_the_extra(monkeypatch):
    """A missing package is named with how to install it."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"must have distributed installed, by pip install"):
        sweep(SCENE, **many(scheduler="tcp://127.0.0.1:9"))
