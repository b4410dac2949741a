"""Every notebook runs from top to bottom under the strict settings, and holds no output."""

import os
import shutil
import sys
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

import mishutter

FOLDER = Path(__file__).parent.parent / "notebooks"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))
TIMEOUT = 900

STRICT = {
    "JAX_NUMPY_DTYPE_PROMOTION": "strict",
    "JAX_NUMPY_RANK_PROMOTION": "raise",
    "JAX_PLATFORMS": "cpu",
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
}


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
def test_it_runs(name, tmp_path, monkeypatch):
    """Its cells run in order in a fresh kernel, its pictures are seen, and its claim holds."""
    path = os.pathsep.join([str(Path(mishutter.__file__).parent.parent), *sys.path])
    for key, value in (STRICT | {"PYTHONPATH": path}).items():
        monkeypatch.setenv(key, value)
    for scene in FOLDER.glob("*.toml"):
        shutil.copy(scene, tmp_path)
    notebook = nbformat.read(FOLDER / name, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=TIMEOUT,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    )
    client.execute()
    outputs = [out.data for c in notebook.cells if c.cell_type == "code" for out in _shown(c)]
    drawn = [data for data in outputs if data["text/plain"].endswith("Axes>")]
    assert drawn
    assert all("image/png" in data for data in drawn)


def _shown(cell):
    return [out for out in cell.outputs if "data" in out]
