"""Blocks as tasks of a cluster: the same numbers, and a worker may die."""

import os
import pickle
import sys
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from support.command_line import refused
from support.sweeps import SCENE, asked_for, grid

import mishutter
from mishutter import AbstractShutter, sweep

# What a worker runs, which `sweep` reaches only through a scheduler.
from mishutter.sweeps.cluster import check_workers, compute_task
from mishutter.sweeps.store import StoredBlocks

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


@pytest.fixture
def worker():
    """A client of one worker in this process."""
    from distributed import Client

    with Client(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as made:
        yield made


@pytest.mark.slow
def test_two_workers_give_the_same(cluster, tmp_path, monkeypatch):
    """As arrays sent back to an address's caller, and in a store that they write to.

    Its path is from where the client is, which the workers are not.
    """
    from distributed import Client

    monkeypatch.chdir(tmp_path)
    alone = sweep(SCENE, **many())
    assert sweep(SCENE, **many(scheduler=cluster.scheduler_address)).identical(alone)
    with Client(cluster) as client:
        stored = sweep(SCENE, **many(scheduler=client, store="a.zarr"))
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


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer(monkeypatch, tmp_path, capsys):
    """One line within seconds, in Python and on the command line, and no store is made."""
    # The test would take the package's own ten seconds twice.
    monkeypatch.setattr("mishutter.sweeps.cluster._SECONDS_TO_ANSWER", 1)
    address = "tcp://127.0.0.1:9"
    with pytest.raises(ValueError, match=r"must be a scheduler that answers within 1 s; got"):
        sweep(SCENE, **many(scheduler=address, store=tmp_path / "a.zarr"))
    assert not any(tmp_path.iterdir())
    arguments = ["sweep", "--acceleration", "1e5:2e5:2", "--half-exposure", "5:6:2"]
    line = refused(capsys, *arguments, "--scheduler", address)
    assert line.startswith("mishutter: error: `--scheduler` must be a scheduler")


def test_without_the_extra(monkeypatch):
    """A missing package is named with how to install it."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ValueError, match=r"must have distributed installed, by pip install"):
        sweep(SCENE, **many(scheduler="tcp://127.0.0.1:9"))


def test_workers_of_another_version_are_refused(worker, monkeypatch):
    """Before any block is computed, with both versions and the worker named."""
    # A worker in this process cannot have another version installed.
    monkeypatch.setattr("mishutter.sweeps.cluster.package_version", lambda: "0.0.7")
    message = rf"must have workers with mishutter 0\.0\.7; got {mishutter.__version__} on inproc://"
    with pytest.raises(ValueError, match=message):
        sweep(SCENE, **many(scheduler=worker))


@pytest.mark.slow
def test_a_cluster_that_is_lost_on_the_way(worker, tmp_path):
    """One line, and what was computed before is kept."""
    from distributed import Future

    def lose(done, total):
        if done:
            worker.cancel([Future(key, worker) for key in worker.futures])

    given = many(store=tmp_path / "a.zarr")
    with pytest.raises(ConnectionError, match=r"must last as long as the sweep; got \S+. With"):
        sweep(SCENE, **given, scheduler=worker, progress=lose)
    computed = []
    again = sweep(SCENE, **given, progress=lambda done, total: computed.append(done))
    assert computed[0] > 0
    assert again.load().identical(sweep(SCENE, **many()))


def test_a_scheduler_without_workers_is_waited_for_aloud(caplog):
    """Who waits for the first worker is told so."""
    from distributed import Client

    with Client(n_workers=0, processes=False, dashboard_address=None) as client:
        check_workers(client)
    assert "no worker has joined the scheduler yet: waiting for one" in caplog.messages


def test_a_store_that_a_worker_does_not_see(tmp_path):
    """It is refused before its block is computed, and none is made in its place."""
    asked = asked_for(3, 4)
    refusals = {"away": r"all workers share; got .*away', not found on", ".": "be a sweep's store"}
    for place, text in refusals.items():
        with pytest.raises(ValueError, match=text):
            compute_task(pickle.dumps(asked), asked.blocks()[0], str(tmp_path / place), True)
    assert not any(tmp_path.iterdir())


@pytest.mark.slow
def test_blocks_that_workers_wrote_elsewhere_are_missed(worker, tmp_path, monkeypatch):
    """A sweep does not end as if they were there."""
    # A worker in this process has no other disk to write to.
    monkeypatch.setattr(StoredBlocks, "write", lambda *_: None)
    with pytest.raises(ValueError, match="which lacks 6 of the 6 blocks that they wrote"):
        sweep(SCENE, **many(scheduler=worker, store=tmp_path / "a.zarr"))


class _Parabola(AbstractShutter):
    """A shutter as a user writes one in a script."""

    depth: float

    def transmittance(self, tau):
        tau = jnp.asarray(tau)
        return jnp.where(jnp.abs(tau) <= 1, 1 - self.depth * tau**2, 0.0)


@pytest.mark.slow
def test_shutters_of_a_script_cannot_be_sent(worker, monkeypatch):
    """A worker makes their class anew and Equinox then loses its fields; of a module they go."""
    shutters = {"mine": _Parabola(0.7)}
    few = many(scheduler=worker, shutters=shutters, accelerations=[3e4, 9e4])
    assert bool(sweep(SCENE, **few).expected_psnr.notnull().any())
    # The class of a script, whose module is the one that Python was started with.
    monkeypatch.setattr(_Parabola, "__module__", "__main__")
    message = "from modules that workers can import; got _Parabola of a script or notebook"
    with pytest.raises(ValueError, match=message):
        sweep(SCENE, **few)
