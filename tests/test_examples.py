"""Examples in docstrings of the functions that people begin with run, and print what they show."""

import doctest

import pytest

import mishutter

NAMES = (
    *("optimise", "Scene", "blur_kernel", "transfer_function", "evaluate", "ceiling", "sweep"),
    *("simulate_capture", "deconvolve", "restore_photograph", "estimate_speed", "drive_table"),
)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_an_example_prints_what_it_shows(name):
    """Typed line by line into a fresh Python, by numbers that both precisions have."""
    found = getattr(mishutter, name)
    (example,) = doctest.DocTestFinder(recurse=False).find(found, name, module=False, globs={})
    assert example.examples
    result = doctest.DocTestRunner().run(example)
    assert (result.attempted, result.failed) == (len(example.examples), 0)
