"""What is installed computes right numbers, and what is imported is declared."""

import ast
import sys
import tomllib
from importlib.metadata import packages_distributions, version
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
REQUIRED = [Requirement(text) for text in PROJECT["dependencies"]]
EXTRAS = [
    Requirement(t)
    for name in ("cluster", "explore", "video")
    for t in PROJECT["optional-dependencies"][name]
]
BRIDGES = [
    Requirement(t) for name in ("torch", "deepinv") for t in PROJECT["optional-dependencies"][name]
]
"""Packages of users whom `mishutter.torch` meets in theirs, and this one with another extra."""
NEVER_IMPORTED = {"jaxlib", "scikit-image"}
"""A package that is declared for a build of it to avoid, and one whose photographs are read."""


@pytest.mark.parametrize("count", [16_384, 20_000, 70_001])
@pytest.mark.parametrize("width", [2, 3, 5])
def test_jaxlib_sums_small_products_rightly(count, width):
    """The sum of squares of many small matrix products is right; jaxlib 0.10.2 gets it wrong."""
    random = np.random.default_rng(width)
    matrix, rows = random.standard_normal((width, width)), random.standard_normal((count, width))
    squares = jax.jit(jax.vmap(lambda row: jnp.sum((jnp.asarray(matrix) @ row) ** 2)))
    expected = np.sum((rows @ matrix.T) ** 2, axis=1)
    np.testing.assert_allclose(np.asarray(squares(jnp.asarray(rows))), expected, rtol=1e-10)


def imported() -> set[str]:
    """Top-level names that the package imports, its own and the standard library's left out."""
    names = set()
    for path in (ROOT / "mishutter").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module or "")
    return {name.split(".")[0] for name in names} - {"mishutter", *sys.stdlib_module_names}


@pytest.mark.slow
def test_what_is_imported_is_declared_and_the_reverse():
    """A plain install brings every package that some line imports, and no other."""
    owners = packages_distributions()
    used = {canonicalize_name(owners.get(name, [name])[0]) for name in imported()}
    declared = {canonicalize_name(r.name) for r in (*REQUIRED, *EXTRAS, *BRIDGES)}
    assert used == declared - NEVER_IMPORTED - {PROJECT["name"]}


@pytest.mark.parametrize("requirement", REQUIRED, ids=lambda r: r.name)
def test_what_is_installed_is_what_is_declared(requirement):
    """These tests speak of versions that a plain install allows."""
    assert requirement.specifier.contains(version(requirement.name))


@pytest.mark.parametrize("path", sorted((ROOT / ".ci").glob("constraints-*.txt")), ids=str)
def test_constraints_hold_every_package_in_a_version_that_is_allowed(path):
    """`pip install . -c FILE` takes what was tested, and is never refused."""
    lines = (
        line.partition("==")
        for line in path.read_text(encoding="utf-8").splitlines()
        if line[:1] != "#"
    )
    known = {name: number for name, _, number in lines}
    for requirement in (*REQUIRED, *EXTRAS):
        assert known[canonicalize_name(requirement.name)] in requirement.specifier
