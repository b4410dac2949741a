"""Pages for people name files and functions that exist, and modules the paper that they cite."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), ROOT / ".pre-commit-config.yaml"]
)

TITLE = "Improved motion invariant imaging with time varying shutter functions"

FILE = re.compile(r"(?<![\w./*:-])([\w.-]+(?:/[\w.-]+)+\.(?:py|toml|ipynb|png|md))\b")
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)\)")
FUNCTION = re.compile(r"`([\w/]+\.py)` → ((?:`\w+`(?:, | and )?)+)")


def every_page(test):
    return pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)(test)


def located(name: str, page: Path) -> Path | None:
    """The file of a path that counts from the page's folder, the checkout or the package."""
    places = (page.parent / name, ROOT / name, ROOT / "mishutter" / name)
    return next((place for place in places if place.exists()), None)


@every_page
def test_files_that_a_page_names_exist(page):
    """A file that moved is followed by every page that leads to it; what changed may be history."""
    text = page.read_text()
    links = [link for link in LINK.findall(text) if not (page.parent / link).exists()]
    assert not links
    if page.name != "CHANGELOG.md":
        assert not [name for name in FILE.findall(LINK.sub("", text)) if not located(name, page)]


@every_page
def test_functions_are_where_a_page_says(page):
    """A journey through the code passes functions and classes that its files define."""
    for name, functions in FUNCTION.findall(page.read_text()):
        path = located(name, page)
        assert path, name
        tree = ast.parse(path.read_text())
        kinds = ast.FunctionDef | ast.ClassDef
        defined = {node.name for node in ast.walk(tree) if isinstance(node, kinds)}
        assert set(re.findall(r"`(\w+)`", functions)) <= defined, name


MODULES = [*sorted((ROOT / "mishutter").rglob("*.py")), ROOT / "benchmarks" / "rivals.py"]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_modules_that_speak_of_the_paper_name_it(path):
    """Equations and sections of the paper are citations only where its title stands beside them."""
    text = path.read_text()
    if re.search(r"\b[Tt]he\s+paper\b", text):
        assert TITLE in text
