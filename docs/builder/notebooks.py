"""Notebooks, run from top to bottom, as pages with what they show."""

import base64
import os
import re
import shutil
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

from docs.builder.pages import ROOT, with_links

FOLDER = ROOT / "notebooks"
TIMEOUT = 900

STRICT = {
    "JAX_NUMPY_DTYPE_PROMOTION": "strict",
    "JAX_NUMPY_RANK_PROMOTION": "raise",
    "JAX_PLATFORMS": "cpu",
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    "TF_CPP_MIN_LOG_LEVEL": "3",
}
"""Settings under which notebooks are run."""


def executed(name: str) -> NotebookNode:
    """A notebook with its outputs, run in a fresh kernel and an empty folder.

    Raises:
        CellExecutionError: if a cell raises, as the last one does where its claim does not hold.
        ValueError: if a figure that a cell ends with is not seen.
    """
    notebook = nbformat.read(FOLDER / name, as_version=4)
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    with tempfile.TemporaryDirectory() as folder:
        for scene in FOLDER.glob("*.toml"):
            shutil.copy(scene, folder)
        client = NotebookClient(
            notebook,
            timeout=TIMEOUT,
            kernel_name="python3",
            resources={"metadata": {"path": folder}},
        )
        client.execute(env=os.environ | STRICT | {"PYTHONPATH": path})
    drawn = [data for data in _shown(notebook) if data.get("text/plain", "").endswith("Axes>")]
    if not drawn or not all("image/png" in data for data in drawn):
        raise ValueError(f"notebooks/{name} must show the figures that it draws.")
    return notebook


def _shown(notebook: NotebookNode) -> list[NotebookNode]:
    cells = (cell for cell in notebook.cells if cell.cell_type == "code")
    return [output.data for cell in cells for output in cell.outputs if "data" in output]


def write_notebook(name: str, pages: Path) -> None:
    """Write a notebook as a page of the site: run, with its pictures."""
    folder = pages / "notebooks"
    folder.mkdir(parents=True, exist_ok=True)
    stem = Path(name).stem
    parts = []
    pictures = 0
    for cell in executed(name).cells:
        if cell.cell_type == "markdown":
            text = with_links(cell.source, f"notebooks/{name}", pages)
            parts.append(_with_blank_lines(text))
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for output in cell.outputs:
            data = output.get("data", {})
            if output.output_type == "stream" and output.name == "stdout":
                parts.append(_text(output.text))
            elif "image/png" in data:
                picture = f"{stem}_{pictures}.png"
                pictures += 1
                (folder / picture).write_bytes(base64.b64decode(data["image/png"]))
                parts.append(f"![A picture drawn by the cell above]({picture})")
            elif "text/plain" in data:
                parts.append(_text(data["text/plain"]))
    note = f"*Run when this page was built; the notebook is `notebooks/{name}`.*"
    title, *rest = parts[0].split("\n", 1)
    (folder / f"{stem}.md").write_text("\n\n".join([title, note, *rest, *parts[1:]]) + "\n")


def _text(text: str) -> str:
    plain = re.sub(r"\x1b\[[\d;]*m", "", text).rstrip()
    return f"```text\n{plain}\n```"


def _with_blank_lines(source: str) -> str:
    """Markdown whose lists begin after a blank line, as Python's Markdown wants them."""
    return re.sub(r"(?m)^(?!- )(.+)\n(?=- )", r"\1\n\n", source)
