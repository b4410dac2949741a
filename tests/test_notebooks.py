"""Every notebook runs from top to bottom under the strict settings, and holds no output."""

import nbformat
import pytest

from docs.builder.notebooks import FOLDER, executed

NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))


def cells(name, kind):
    notebook = nbformat.read(FOLDER / name, as_version=4)
    return [cell for cell in notebook.cells if cell.cell_type == kind]


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_no_stored_output(name):
    """What a notebook shows is made when it is run."""
    assert all(not c.outputs and c.execution_count is None for c in cells(name, "code"))


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_ends_with_its_claim(name):
    """The last cell asserts what the notebook set out to show."""
    assert "assert " in cells(name, "code")[-1].source


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_runs(name):
    """Its cells run in order in a fresh kernel, its pictures are seen, and its claim holds."""
    executed(name)
