"""Examples in docstrings run, and print what they show."""

import doctest
import inspect

import pytest

import mishutter

FOUND = [
    example
    for name in dir(mishutter)
    if not inspect.ismodule(getattr(mishutter, name))
    for example in doctest.DocTestFinder().find(
        getattr(mishutter, name), name, module=False, globs={}
    )
    if example.examples
]
"""Examples of all public names, and of what a class has."""


def test_main_functions_have_examples():
    """What people begin with shows how it is called."""
    begun_with = {"Scene", "optimise", "evaluate", "simulate_capture", "restore", "sweep"}
    assert begun_with <= {example.name for example in FOUND}


@pytest.mark.slow
@pytest.mark.parametrize("example", FOUND, ids=lambda example: example.name)
def test_an_example_prints_what_it_shows(example):
    """Typed line by line into a fresh Python, by numbers that both precisions have."""
    result = doctest.DocTestRunner().run(example)
    assert (result.attempted, result.failed) == (len(example.examples), 0)
