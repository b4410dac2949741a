"""What a file in the cache is known by tells any two calls apart that may differ."""

import os

import numpy as np
import pytest

from mishutter import HannShutter, TukeyShutter
from mishutter._core.shelf import NotTold, Shelf, description
from mishutter.evaluation.needs import Plan


@pytest.mark.parametrize("value", [1, 1.0, True, "1", (1,), [1], None, np.float64(1.0)])
def test_no_two_values_share_a_description(value):
    """One, one point nought, true and the like are told apart."""
    others = [1, 1.0, True, "1", (1,), [1], None, np.float64(1.0), {"1": 1}, frozenset((1,))]
    own = list(description(value))
    same = [x for x in others if list(description(x)) == own]
    assert [(type(x), x) for x in same] == [(type(value), value)]


def told(value, **how):
    return list(description(value, **how))


def test_numbers_are_told_apart_where_they_are_asked_for():
    """By kind two tapers are one, by value they are two; dtype and shape always tell."""
    assert told(TukeyShutter(0.3)) == told(TukeyShutter(0.7))
    assert told(TukeyShutter(0.3), by_value=True) != told(TukeyShutter(0.7), by_value=True)
    row = np.arange(6.0)
    others = [row.reshape(2, 3), row.astype(np.float32), row[::-1], row + 1e-16, -row]
    for other in others:
        assert told(row, by_value=True) != told(other, by_value=True)
    assert told(row[::2], by_value=True) == told(row[::2].copy(), by_value=True)


def test_the_order_of_a_mapping_tells():
    """Rows of a table come in the order that they were given in."""
    assert told({"a": 1, "b": 2}) != told({"b": 2, "a": 1})


def test_what_equality_leaves_out_is_part_of_the_value():
    """Two plans that compute the same sizes may allow for different changes of the result."""
    exact, loose = (Plan(64, 128, 32, 65, tolerance=tolerance) for tolerance in (0.0, 0.01))
    assert exact == loose
    assert told(exact) == told(loose)
    assert told(exact, by_value=True) != told(loose, by_value=True)


def test_what_is_not_the_packages_is_not_told():
    """Its source may change without the folder's doing so."""
    with pytest.raises(NotTold):
        told(lambda: None)

    class Own(TukeyShutter):
        pass

    with pytest.raises(NotTold):
        told(Own(0.3))


def test_there_is_no_place_without_a_folder():
    """Nor for what cannot be told."""
    shelf = Shelf(by_value=True, most_bytes=1000)
    assert shelf.place_of(HannShutter()) is None


@pytest.fixture
def shelf(tmp_path):
    """An empty one, of three files of a thousand bytes."""
    shelf = Shelf(by_value=True, most_bytes=3200)
    shelf.open(tmp_path)
    return shelf


def kept(shelf, number, size=1000):
    """A file on it."""
    path = shelf.place_of(number)
    shelf.keep(path, bytes([number]) * size)
    return path


def test_a_file_is_read_as_it_was_written_or_not_at_all(shelf):
    """No bit of it may have turned: in a program it may end the process."""
    path = kept(shelf, 7)
    assert shelf.read(path) == b"\7" * 1000
    whole = path.read_bytes()
    for place in (0, 40, len(whole) - 1):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(ValueError, match=r"must be as it was written; got something else"):
            shelf.read(path)


def test_what_was_read_longest_ago_goes_first(shelf):
    """There is a most that all may take; the one just kept stays."""
    paths = [kept(shelf, number) for number in range(3)]
    for number, path in enumerate(paths):
        os.utime(path, (number, 1000))
    shelf.read(paths[0])
    assert paths[0].stat().st_mtime == 1000
    paths.append(kept(shelf, 3))
    assert [path.exists() for path in paths] == [True, False, True, True]


def test_a_large_file_does_not_take_small_ones_with_it(shelf):
    """What took minutes to work out may be a few bytes, beside pictures that took a moment."""
    paths = kept(shelf, 0, size=10), kept(shelf, 1, size=2000)
    for number, path in enumerate(paths):
        os.utime(path, (number, 1000))
    paths += (kept(shelf, 2, size=2000),)
    assert [path.exists() for path in paths] == [True, False, True]


def test_what_alone_takes_more_is_not_kept(shelf):
    """It would cost all others their place, and then its own."""
    paths = kept(shelf, 0), kept(shelf, 1, size=3200)
    assert [path.exists() for path in paths] == [True, False]
