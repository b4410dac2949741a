"""Files: as readable as any, strict JSON, told apart by as little of their paths as does it."""

import contextlib
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from mishutter import Design, Scene
from mishutter._core.files import is_own_folder, short_names, strict_json, write_text

resource = pytest.importorskip("resource") if os.name == "posix" else None


def test_a_file_has_the_permissions_of_any_new_one(tmp_path):
    """Not those of the temporary one that it was, which nobody else may read."""
    before = os.umask(0o026)
    try:
        write_text(tmp_path / "a.txt", "x")
    finally:
        os.umask(before)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o640


@contextlib.contextmanager
def room_of(size):
    """Files take so many bytes and no more, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.skipif(os.name != "posix", reason="files have no greatest size there")
def test_a_file_for_which_there_is_no_room_is_named(tmp_path):
    """Its folder is left as it was: the file that had the name before, and nothing else."""
    path = tmp_path / "a.txt"
    write_text(path, "as before")
    with room_of(3000), pytest.raises(OSError, match=re.escape(f"File too large: '{path}'")):
        write_text(path, "too long" * 600)
    assert path.read_text("utf-8") == "as before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_whose_folder_is_missing_is_named(tmp_path):
    """Not the temporary file beside it."""
    path = tmp_path / "none" / "a.txt"
    with pytest.raises(FileNotFoundError, match=re.escape(f"No such file or directory: '{path}'")):
        write_text(path, "x")


def test_numbers_that_json_has_no_token_for():
    """They are text, or nothing, in whatever holds them."""
    document = {"a": np.array([0.5, -np.inf]), "b": (np.nan, float("inf")), "c": np.float32(0.25)}
    expected = {"a": [0.5, "-Infinity"], "b": [None, "Infinity"], "c": 0.25}
    assert json.loads(strict_json(document)) == expected


@pytest.mark.parametrize(
    ("paths", "taken", "names"),
    [
        (["A/design.json"], [], ["design"]),
        (["A/design.json", "B/design.json"], [], ["A/design", "B/design"]),
        (["A/x/a.json", "B/x/a.json", "B/b.json"], [], ["A/x/a", "B/x/a", "b"]),
        (["out/Hann.json", "out/best snapshot.json"], ["Hann"], ["out/Hann", "best snapshot"]),
        (["A/design.json", "A/design.json"], [], ["design"]),
        (["/a/b.json", "/a/b.txt"], [], ["/a/b.json", "/a/b.txt"]),
    ],
)
def test_names_of_files(paths, taken, names):
    """The end of the path that no other file and no window is called by."""
    found = short_names(map(Path, paths), taken)
    assert [str(path) for path in found.values()] == list(dict.fromkeys(paths))
    assert list(found) == names


@pytest.mark.parametrize("read", [Scene.load, Design.load])
def test_a_file_without_an_end_is_refused(read):
    """Reading stops where no scene and no design would still go on."""
    with pytest.raises(ValueError, match=r"^/dev/zero must be a file of at most 64 MiB; got more"):
        read("/dev/zero")


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="permissions are of another kind there")
def test_only_its_owner_may_write_to_a_folder_whose_files_are_run(tmp_path, monkeypatch):
    """Whatever the umask; a folder of another user is not taken, though it may take files."""
    before = os.umask(0)
    try:
        assert is_own_folder(tmp_path / "new")
    finally:
        os.umask(before)
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o700
    (tmp_path / "new").chmod(0o777)
    assert is_own_folder(tmp_path / "new")
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o755
    (tmp_path / "file").write_text("")
    assert not is_own_folder(tmp_path / "file")
    # A test can give its files to another user only where it is root.
    monkeypatch.setattr(os, "getuid", lambda: tmp_path.stat().st_uid + 1)
    assert not is_own_folder(tmp_path / "new")


def test_a_folder_that_depends_on_the_current_one_is_not_taken(tmp_path, monkeypatch):
    """It would be the current folder's `~` for a user without a home, whoever that belongs to."""
    monkeypatch.chdir(tmp_path)
    assert not is_own_folder(Path("~", ".cache"))
    assert list(tmp_path.iterdir()) == []
