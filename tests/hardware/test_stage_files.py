"""Steps of the path of a stage, from rest to rest."""

import numpy as np
import pytest

from mishutter import ParabolicMotion, stage_path
from mishutter.hardware.stage_files import path_steps

PATH = stage_path(ParabolicMotion(acceleration=3.1e4, half_exposure=7e-3), max_acceleration=9.3e4)


def test_the_first_and_the_last_step_are_at_rest():
    """No step before the first would still be in the path, nor one after the last."""
    first, last = PATH.exposure
    step = (last - first) / 37
    times = first + step * path_steps(PATH, first, step, 37)
    assert times[0] <= PATH.times[0] < times[1]
    assert times[-2] < PATH.times[-1] <= times[-1]
    np.testing.assert_allclose(PATH.at(times[[0, -1]])[1], 0, atol=1e-9)


@pytest.mark.parametrize("num_before", [3, 7, 11])
def test_rounding_adds_no_step_to_a_path_that_ends_at_one(num_before):
    """A run-up of so many steps has so many, whichever way their lengths are rounded."""
    first, last = PATH.exposure
    step = (first - PATH.times[0]) / num_before
    count = int(np.ceil((last - first) / step))
    assert path_steps(PATH, first, step, count)[0] == -num_before
    backwards = path_steps(PATH, PATH.times[-1] - 5 * step, step, 2)
    assert backwards[-1] == 5


def test_a_run_up_of_too_many_steps_is_refused():
    """A stage that runs up slowly for a short exposure would fill a disk with its path."""
    with pytest.raises(ValueError, match=r"run-up and a run-out of at most 100000 steps; got \d+"):
        path_steps(PATH, PATH.exposure[0], 1e-9, 2)


def test_a_run_out_of_too_many_steps_is_refused():
    """So it is where a path begins at the first light and takes long to come to rest behind it."""
    with pytest.raises(ValueError, match=r"run-up and a run-out of at most 100000 steps; got \d+"):
        path_steps(PATH, PATH.times[0], 1e-9, 2)
