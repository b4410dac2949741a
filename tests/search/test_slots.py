"""Changes of a shutter's slots: all of them are what its device can make."""

import itertools

import numpy as np

from mishutter import SwitchedDevice

# The changes of one step: a search over them takes seconds, and ends among the best alone.
from mishutter.search.slots import _changes

SLOTS = np.array([0, 0, 0, 1, 1, 1, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0])


def test_no_change_makes_a_run_too_short():
    """Runs between the ends stay open for two slots and closed for three, never the reverse."""
    device = SwitchedDevice(num_slots=SLOTS.size, min_open=2, min_closed=3)
    rows = SLOTS + _changes(SLOTS, 1, device)
    assert len(rows)
    inner = [
        (level, len(list(run)))
        for row in rows.tolist()
        for level, run in list((k, list(g)) for k, g in itertools.groupby(row))[1:-1]
    ]
    assert min(length for level, length in inner if level == 1) == 2
    assert min(length for level, length in inner if level == 0) == 3
