"""Files are told apart by as little of their paths as does it."""

from pathlib import Path

import pytest

from mishutter.files import short_names


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
