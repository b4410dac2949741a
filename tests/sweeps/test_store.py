"""A store loses at most the blocks under way, is resumed bit for bit, and is its sweep's own."""

import errno
import json
import logging
import os
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from support.command_line import SMALL_SCENE
from support.sweeps import SCENE, asked_for, grid, many

import mishutter
from mishutter import GaussianShutter, Limits, Scene, Sensor, cli, sweep

# Writes that fail, which no argument of `sweep` brings about.
from mishutter.sweeps.store import StoredBlocks, saved_points


@pytest.fixture(scope="module")
def whole():
    """The sweep of several blocks, in memory."""
    return sweep(SCENE, **many())


@pytest.mark.slow
def test_a_store_holds_what_memory_holds(whole, tmp_path):
    """Bit for bit, with the same labels and attributes."""
    stored = sweep(SCENE, **many(store=tmp_path / "a.zarr"))
    assert stored.load().identical(whole)


@pytest.mark.slow
def test_a_store_is_opened_as_what_the_sweep_returned(whole, tmp_path):
    """By xarray alone, without a warning, and without the marks of blocks beside the variables."""
    stored = sweep(SCENE, **many(store=tmp_path / "a.zarr"))
    opened = xarray.open_zarr(tmp_path / "a.zarr").load()
    assert opened.identical(stored.load())
    assert opened.identical(whole)


@pytest.mark.slow
def test_a_store_of_velocities(tmp_path):
    """Also of those that scenes have of their own; it is refused to a sweep of others."""
    slow = Scene([90.0, 350.0], photon_rate=1e4, read_noise=1.0, limits=SCENE.limits)
    few = grid(metrics=["expected_psnr"], accelerations=[0.0, 3e4])
    for name, own in {"own": None, "given": [-300.0, 120.0]}.items():
        asked = few | {"velocities": own}
        stored = sweep([SCENE, slow], **asked, store=tmp_path / name)
        assert stored.load().identical(sweep([SCENE, slow], **asked))
    with pytest.raises(ValueError, match=r"with velocities: None; got \[-300.0, 120.0\]"):
        sweep([SCENE, slow], **few, store=tmp_path / "given")


@pytest.mark.slow
def test_two_that_begin_at_once_share_a_store(whole, tmp_path, monkeypatch):
    """Where another process makes the store first, it is that one that is written to."""
    place = tmp_path / "a.zarr"
    rename, begun = os.rename, []

    def later(source, target):
        if not begun:
            begun.append(target)
            sweep(SCENE, **many(store=place))
        rename(source, target)

    # The other process begins just before this one has made its store.
    monkeypatch.setattr(os, "rename", later)
    assert sweep(SCENE, **many(store=place)).load().identical(whole)
    assert os.listdir(tmp_path) == ["a.zarr"]


def test_only_missing_blocks_are_computed(whole, tmp_path, monkeypatch, caplog):
    """After an interrupt the rest is computed and the result is the uninterrupted one."""
    place, written = tmp_path / "a.zarr", []
    write = StoredBlocks.write

    def interrupted(self, block, arrays):
        if len(written) == 2:
            raise KeyboardInterrupt
        written.append(block)
        write(self, block, arrays)

    with monkeypatch.context() as patch:
        # An interrupt between two blocks, whose time depends on the machine.
        patch.setattr(StoredBlocks, "write", interrupted)
        with pytest.raises(KeyboardInterrupt):
            sweep(SCENE, **many(store=place))
    kept, every = saved_points(place)
    assert 0 < kept < every == whole.outside.size
    with caplog.at_level(logging.INFO, logger="mishutter.sweep"):
        again = sweep(SCENE, **many(store=place))
    assert caplog.messages == [f"{kept} of {every} points are in '{place}' already"]
    assert again.load().identical(whole)


MADE = replace(asked_for(150, 2), velocities=np.array([-3.0, 4.0]))
"""A grid of four blocks, in two frames."""


def made(block):
    """Arrays of a block of that grid without computing them; NaNs of one frame have a sign."""
    draw, arrays = np.random.default_rng(tuple(block)), {}
    for name, dtype in MADE.variables.items():
        whole = np.empty([MADE.sizes[d] for d in MADE.dimensions(name)], bool)
        arrays[name] = draw.normal(9, 4, whole[MADE.region(block, name)].shape).astype(dtype)
    if block.frame == 1:
        arrays["expected_psnr"][:] = -np.nan
    return arrays


def filled(place):
    """The blocks that a store of that grid lacks, and its data set with them written."""
    blocks = StoredBlocks(MADE, place)
    missing = blocks.missing()
    for block in missing:
        blocks.write(block, made(block))
    return [tuple(block) for block in missing], blocks.dataset().load()


def flipped(file):
    """Changes one bit in the middle of a file."""
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 4
    file.write_bytes(content)


def renamed(file):
    """Changes one letter in the description of a sweep."""
    content = file.read_bytes()
    assert b"half_exposures" in content
    file.write_bytes(content.replace(b"half_exposures", b"half_exposurez"))


def cut(file):
    """Leaves the first half of a file."""
    os.truncate(file, file.stat().st_size // 2)


def lost(place):
    """Removes a file, or a folder and everything in it."""
    shutil.rmtree(place) if place.is_dir() else place.unlink()


ALL = [(0, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0)]
CHUNK = "expected_psnr/c/0/0/1/0/0/0"
DAMAGE = [
    (CHUNK, flipped, [(0, 1, 0)]),
    (CHUNK, cut, [(0, 1, 0)]),
    (CHUNK, lost, [(0, 1, 0)]),
    ("progress/done/c/1/0/0", flipped, [(1, 0, 0)]),
    ("expected_psnr/zarr.json", cut, []),
    ("velocity/c/0", flipped, []),
    ("progress/done/zarr.json", lost, []),
]
"""Files of that store, and the blocks that are computed again where one is damaged."""


def test_damage_is_found_and_made_good(tmp_path, caplog):
    """A block is named and computed again; other files follow from the sweep."""
    place = tmp_path / "a.zarr"
    missing, whole = filled(place)
    assert missing == ALL
    assert filled(place)[0] == []
    for name, damage, computed in DAMAGE:
        caplog.clear()
        damage(place / name)
        missing, again = filled(place)
        assert again.identical(whole), (name, damage)
        assert missing == computed, (name, damage)
        message = f"blocks damaged in '{place}' are computed again: {[*computed, ()][0]}"
        assert caplog.messages == ([message] if computed else []), (name, damage)


def test_folders_that_are_lost_are_made_good(tmp_path):
    """A variable, its chunks, a coordinate or every mark; a chunk of another block is no better."""
    place = tmp_path / "a.zarr"
    _, whole = filled(place)
    for name, computed in {"expected_psnr": ALL[:2], "shutter": [], "progress/done": ALL}.items():
        lost(place / name)
        missing, again = filled(place)
        assert again.identical(whole), name
        # Chunks of nothing but NaN, as those of the second frame, are not written.
        assert missing == computed, name
    chunks = place / "expected_psnr" / "c" / "0" / "0"
    shutil.copytree(chunks / "0", chunks / "1", dirs_exist_ok=True)
    missing, again = filled(place)
    assert missing == [(0, 1, 0)]
    assert again.identical(whole)


def test_a_store_that_does_not_say_its_sweep_is_refused(tmp_path):
    """One line names it where its first file is lost, cut or changed; it is left as it is."""
    place = tmp_path / "a.zarr"
    filled(place)
    root = place / "zarr.json"
    right = root.read_text("utf-8")
    attributes = {"attributes": {"sweep": "[7]"}}
    reasons = {
        "damaged or of something else": ["", right[:300], right.replace('\\"scenes', "?"), "[3]"],
        "of something else": [json.dumps(attributes), json.dumps({"attributes": {"title": "x"}})],
        "with format: ": [right.replace('\\"format\\": 4', '\\"format\\": 3')],
        "with half exposures: ": [right.replace("[1.0, 2.0], ", "[1.0, 3.0], ", 1)],
    }
    for reason, texts in reasons.items():
        for text in texts:
            assert text != right
            root.write_text(text, "utf-8")
            with pytest.raises(ValueError, match=reason) as caught:
                filled(place)
            assert f"'{place}'" in str(caught.value)
            assert "\n" not in str(caught.value)
            assert root.read_text("utf-8") == text
    lost(root)
    with pytest.raises(ValueError, match=r"which has no zarr\.json"):
        filled(place)


def test_whoever_opens_a_store_is_told_of_a_flipped_bit(tmp_path):
    """Of a block or of a coordinate: Zarr checks the sum of each chunk."""
    place = tmp_path / "a.zarr"
    filled(place)
    for name in ("expected_psnr/c/0/0/0/0/0/0", "acceleration/c/0"):
        flipped(place / name)
        with pytest.raises(ValueError, match="checksum do not match"):
            xarray.open_zarr(place, chunks=None, consolidated=False).load()
        filled(place)


@pytest.mark.slow
def test_no_damage_changes_a_result(tmp_path):
    """Every file flipped, cut and lost: the result is the same, or one line names the store."""
    place = tmp_path / "a.zarr"
    _, whole = filled(place)
    root = place / "zarr.json"
    content = root.read_bytes()
    for damage in (renamed, cut, lost):
        damage(root)
        with pytest.raises(ValueError, match=rf".*'{place}'"):
            filled(place)
        root.write_bytes(content)
    for file in [file for file in place.rglob("*") if file.is_file() and file != root]:
        for damage in (flipped, cut, lost):
            damage(file)
            assert filled(place)[1].identical(whole), (file, damage)


def test_a_full_disk_while_a_store_is_made(tmp_path, monkeypatch):
    """One line names the folder, and nothing is left of it; with room it is made."""
    resource = pytest.importorskip("resource")
    place = tmp_path / "deep" / "a.zarr"
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        # The system refuses longer files, as a full disk refuses more of them.
        resource.setrlimit(resource.RLIMIT_FSIZE, (200, limits[1]))
        with pytest.raises(OSError, match=r"can be written; got '.*a\.zarr': File too large"):
            StoredBlocks(MADE, place)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(place.parent.iterdir()) == []

    def full(source, target):
        raise OSError(errno.ENOSPC, "No space left on device", str(source))

    with monkeypatch.context() as patch:
        # A disk that is full of everything but the name of the folder.
        patch.setattr(os, "rename", full)
        with pytest.raises(OSError, match=r"got '.*a\.zarr': No space left on device"):
            StoredBlocks(MADE, place)
    assert list(place.parent.iterdir()) == []
    assert filled(place)[0] == ALL


def test_a_full_disk_while_a_block_is_written(tmp_path):
    """The error names the store, and the block is one that was never written."""
    resource = pytest.importorskip("resource")
    blocks = StoredBlocks(MADE, tmp_path / "a.zarr")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200, limits[1]))
        with pytest.raises(OSError, match=r"File too large: '.*a\.zarr'"):
            blocks.write(MADE.blocks()[0], made(MADE.blocks()[0]))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert filled(tmp_path / "a.zarr")[0] == ALL


def test_progress_counts_what_was_found(tmp_path):
    """Points found in the store are done at once."""
    calls = []
    place = tmp_path / "a.zarr"
    sweep(SCENE, **grid(store=place, progress=lambda done, total: calls.append((done, total))))
    sweep(SCENE, **grid(store=place, progress=lambda done, total: calls.append((done, total))))
    assert calls == [(0, 30), (30, 30), (30, 30)]


OTHERS = {
    "accelerations": ({"accelerations": [1e4, 2e4]}, "with accelerations: [10000.0, 20000.0]"),
    "shutters": ({"shutters": {"rect": GaussianShutter(0.3)}}, "with shutters, rect, "),
    "metrics": ({"metrics": ["efficiency"]}, "with metrics: ['efficiency']"),
}


def test_a_store_of_one_scene_without_a_name_is_not_one_of_a_list(tmp_path):
    """The results of a list have one dimension more."""
    few = grid(metrics=["efficiency"], store=tmp_path / "a.zarr")
    sweep(SCENE, **few)
    with pytest.raises(ValueError, match="with named scenes: True; got False"):
        sweep([SCENE], **few)


@pytest.mark.parametrize("slug", OTHERS)
def test_a_store_of_another_sweep_is_refused(slug, tmp_path):
    """By what differs."""
    sweep(SCENE, **grid(store=tmp_path / "a.zarr", metrics=["expected_psnr"]))
    arguments, message = OTHERS[slug]
    asked = {"metrics": ["expected_psnr"]} | arguments
    with pytest.raises(ValueError, match="must hold the same sweep") as caught:
        sweep(SCENE, **grid(store=tmp_path / "a.zarr", **asked))
    assert message in str(caught.value)


def test_every_argument_that_decides_the_numbers_is_part_of_a_store(tmp_path):
    """Another value of any of them is another sweep, named by the argument."""
    plain = grid(metrics=["expected_psnr"], accelerations=[3e4, 9e4], half_exposures=[1e-3, 3e-3])
    sweep(SCENE, **plain, store=tmp_path / "a.zarr")
    others = {
        "half_exposures": [1e-3, 2e-3],
        "velocities": [40.0],
        "photon_rates": [1e5],
        "read_noises": [2.0],
    }
    for name, value in others.items():
        with pytest.raises(ValueError, match=f"with {name.replace('_', '.')}: "):
            sweep(SCENE, **(plain | {name: value}), store=tmp_path / "a.zarr")


def test_a_store_of_another_scene_is_refused(tmp_path):
    """The number that differs is named."""
    sweep(SCENE, **grid(store=tmp_path / "a.zarr", metrics=["expected_psnr"]))
    brighter = Scene(
        SCENE.speeds, SCENE.weights, photon_rate=3e5, read_noise=6.0, limits=SCENE.limits
    )
    with pytest.raises(ValueError, match=r"photon_rate.*300000.*got.*200000"):
        sweep(brighter, **grid(store=tmp_path / "a.zarr", metrics=["expected_psnr"]))


def test_what_is_no_store_is_refused(tmp_path):
    """A file, and a folder of something else."""
    file = tmp_path / "file"
    file.write_text("in the way")
    with pytest.raises(ValueError, match=r"must be a folder; got a file, '"):
        sweep(SCENE, **grid(store=file))
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "x").write_text("mine")
    with pytest.raises(ValueError, match=r"must be a sweep's store; got"):
        sweep(SCENE, **grid(store=tmp_path / "folder"))


def test_a_store_before_anything_is_computed(tmp_path):
    """What is missing is no number, and the folder is as open as any new one."""
    before = os.umask(0o026)
    try:
        empty = StoredBlocks(asked_for(3, 4), tmp_path / "a.zarr")
    finally:
        os.umask(before)
    assert (tmp_path / "a.zarr").stat().st_mode & 0o777 == 0o751
    assert bool(empty.dataset().expected_psnr.isnull().all())


def test_points_of_whole_blocks_are_counted(tmp_path):
    """Of the last rows and columns there are fewer than in other blocks."""
    blocks = StoredBlocks(asked_for(150, 70), tmp_path / "a.zarr")
    assert blocks.grid.block_shape == (128, 32)
    assert saved_points(tmp_path / "a.zarr") == (0, 150 * 70)
    for number, place in enumerate(((0, 0, 1), (0, 1, 2)), 1):
        blocks.group["progress/done"][place] = number
    assert saved_points(tmp_path / "a.zarr") == (128 * 32 + 22 * 6, 150 * 70)


def test_blocks_cover_the_grid_once():
    """Every point of every variable belongs to one block, whatever the sizes."""
    for rows, columns, pans in ((1, 1, 1), (300, 2, 3), (129, 70, 2), (5, 900, 1)):
        made = replace(asked_for(rows, columns), velocities=np.arange(pans) - 1.0)
        count = np.zeros([made.sizes[d] for d in made.dimensions("expected_psnr")])
        for block in made.blocks():
            count[made.region(block, "expected_psnr")] += 1
        assert np.all(count == 1)


SCRIPT = """
import sys, jax
jax.config.update("jax_enable_x64", True)
sys.path.insert(0, {folder!r})
from support.sweeps import SCENE, many
from mishutter import sweep
import time
def progress(done, total):
    print(done, flush=True)
    if done:
        time.sleep(30)
sweep(SCENE, **many(store={store!r}, progress=progress))
"""


def started(store):
    """A process that sweeps into a store, and waits after each of its blocks."""
    folder = str(Path(__file__).parents[1])
    path = os.pathsep.join([str(Path(mishutter.__file__).parent.parent), *sys.path])
    code = SCRIPT.format(folder=folder, store=str(store))
    return subprocess.Popen(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_a_killed_sweep_goes_on(name, whole, tmp_path, caplog):
    """A signal after the first block; the next run computes the others only."""
    store = tmp_path / "a.zarr"
    process = started(store)
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "0"
    assert int(process.stdout.readline()) > 0
    process.send_signal(getattr(signal, name))
    process.communicate(timeout=600)
    before = sum(1 for _ in store.glob("progress/done/c/**/*") if _.is_file())
    assert before >= 1
    kept, every = saved_points(store)
    with caplog.at_level(logging.INFO, logger="mishutter.sweep"):
        again = sweep(SCENE, **many(store=store))
    assert f"{kept} of {every} points are in '{store}' already" in caplog.text
    assert again.load().identical(whole)


def test_the_store_says_what_it_holds(tmp_path):
    """Its attribute is the whole request, as JSON."""
    import zarr

    sweep(SCENE, **grid(store=tmp_path / "a.zarr"))
    attributes = zarr.open_group(tmp_path / "a.zarr", mode="r").attrs
    request = json.loads(str(attributes["sweep"]))
    assert request["shutters"]["Hann"] == {"kind": "HannShutter"}
    assert request["scenes"]["0"]["read_noise"] == 6.0


RANGES = ["--acceleration", "3e4:3e5:300", "--half-exposure", "2.5:5:2"]

READ_ONLY_HALF_WAY = """
import ctypes, os, sys
MAY_WRITE_ANYWHERE, DROP_FROM_BOUND = 1, 24
if os.geteuid() == 0 and len(sys.argv) == 1:
    # The superuser's right to ignore permissions ends with the next program.
    if ctypes.CDLL(None).prctl(DROP_FROM_BOUND, MAY_WRITE_ANYWHERE, 0, 0, 0):
        sys.exit(77)
    os.execv(sys.executable, [*sys.orig_argv, "bound"])
from mishutter import cli
from mishutter.sweeps.store import StoredBlocks, saved_points
write = StoredBlocks.write

def once(self, block, arrays):
    write(self, block, arrays)
    for folder, _, _ in os.walk(self.path):
        os.chmod(folder, 0o555)

StoredBlocks.write = once
sys.exit(cli.main({command!r}))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="drops a right that only Linux has apart")
def test_a_store_made_read_only_half_way(tmp_path, capsys):
    """One line and exit code 2; made writable again, the rest is computed, bit for bit."""
    store, other = tmp_path / "a.zarr", tmp_path / "whole.zarr"
    scene = tmp_path / "scene.toml"
    scene.write_text(SMALL_SCENE.split("[picture]")[0])
    command = ["sweep", str(scene), *RANGES]
    code = READ_ONLY_HALF_WAY.format(command=[*command, "--store", str(store)])
    path = os.pathsep.join([str(Path(mishutter.__file__).parent.parent), *sys.path])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == 77:
        pytest.skip("the superuser's right to write anywhere cannot be dropped here")
    for folder, _, _ in os.walk(store):
        os.chmod(folder, 0o755)
    errors = [line for line in done.stderr.splitlines() if "error" in line]
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert len(errors) == 1
    assert errors[0].startswith(f"mishutter: error: '{store}")
    assert errors[0].endswith("must be accessible; got: Permission denied")
    kept, every = saved_points(store)
    assert 0 < kept < every
    assert cli.main([*command, "--store", str(store)]) == 0
    assert f"{kept} of {every} points are in '{store}' already" in capsys.readouterr().err
    assert cli.main([*command, "--store", str(other)]) == 0
    found, right = (xarray.open_zarr(x, chunks=None, consolidated=False) for x in (store, other))
    assert found.load().identical(right.load())


@contextmanager
def described_scene(store):
    """The scene that a store was begun with, as its file holds it; changes are written there."""
    file = store / "zarr.json"
    document = json.loads(file.read_text(encoding="utf-8"))
    described = json.loads(document["attributes"]["sweep"])
    (scene,) = described["scenes"].values()
    yield scene
    document["attributes"]["sweep"] = json.dumps(described)
    file.write_text(json.dumps(document), encoding="utf-8")


@pytest.mark.parametrize(("part", "argument"), [("sensor", "width"), ("limits", "max_jerk")])
def test_arguments_of_later_versions_are_not_given_in_a_store(part, argument, tmp_path):
    """Which goes on, but not with one that is given: this decides what a sweep computes."""
    scene = Scene(SCENE.speeds, photon_rate=2e5, read_noise=6.0)
    asked = grid(store=tmp_path / "a.zarr", metrics=["efficiency"], accelerations=[3e4])
    share = sweep(scene, **asked).efficiency.values
    with described_scene(tmp_path / "a.zarr") as held:
        assert held[part].pop(argument) is None
    np.testing.assert_array_equal(sweep(scene, **asked).efficiency, share)
    given = (
        {"sensor": Sensor(width=700.0)} if part == "sensor" else {"limits": Limits(max_jerk=9e9)}
    )
    with pytest.raises(ValueError, match=rf"{argument}.*[79]00.*got.*None"):
        sweep(Scene(scene.speeds, photon_rate=2e5, read_noise=6.0, **given), **asked)
