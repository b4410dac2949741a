"""Pages for people name what exists, and their code runs and shows what they say.

Modules name the paper that they cite.
"""

import ast
import json
import re
import tomllib
from pathlib import Path

import pytest
from support.pages import Reader, blocks, here_documents, is_shown

from mishutter.model.scene_file import example_scene_text

# Pages register shutters, which the next page is not to find.
from mishutter.model.shutters import kinds

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), ROOT / ".pre-commit-config.yaml"]
)

TEXTS = {page: page.read_text(encoding="utf-8") for page in PAGES}

TITLE = "Improved motion invariant imaging with time varying shutter functions"

FILE = re.compile(r"(?<![\w./*:-])([\w.-]+(?:/[\w.-]+)+\.(?:py|toml|ipynb|png|md))\b")
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)\)")
FUNCTION = re.compile(r"`([\w/]+\.py)` → ((?:`\w+`(?:, | and )?)+)")


def located(name: str, page: Path) -> Path | None:
    """The file of a path that counts from the page's folder, the checkout or the package."""
    places = (page.parent / name, ROOT / name, ROOT / "mishutter" / name)
    return next((place for place in places if place.exists()), None)


def test_files_that_a_page_names_exist():
    """A file that moved is followed by every page that leads to it; what changed may be history."""
    for page, text in TEXTS.items():
        links = [link for link in LINK.findall(text) if not (page.parent / link).exists()]
        assert not links, page
        if page.name != "CHANGELOG.md":
            names = FILE.findall(LINK.sub("", text))
            assert not [name for name in names if not located(name, page)], page


def test_functions_are_where_a_page_says():
    """A journey through the code passes functions and classes that its files define."""
    named = [(page, *names) for page, text in TEXTS.items() for names in FUNCTION.findall(text)]
    assert named
    for page, name, functions in named:
        path = located(name, page)
        assert path, name
        tree = ast.parse(path.read_text(encoding="utf-8"))
        kinds = ast.FunctionDef | ast.ClassDef
        defined = {node.name for node in ast.walk(tree) if isinstance(node, kinds)}
        assert set(re.findall(r"`(\w+)`", functions)) <= defined, name


RUNNABLE = {"python", "sh"}
OTHER_LANGUAGES = {"text", "console", "math", "toml", "yaml"}
CODE = [page for page in PAGES if page.name != "CONTRIBUTING.md"]
TUTORIAL = ROOT / "docs" / "tutorial.md"
NEEDS = [
    pytest.param(page, package, id=f"{page.relative_to(ROOT)}-{package or 'all'}")
    for page in CODE
    for package in sorted({n for b in blocks(page) for n in b.needs}, key=str)
]


def test_blocks_are_of_a_kind_that_is_checked():
    """No block escapes by a language that nothing runs; commands that are only shown are few."""
    for page in PAGES:
        for block in blocks(page):
            assert block.language in RUNNABLE | OTHER_LANGUAGES, page
            if block.language == "toml":
                tomllib.loads(block.text)
            if block.language == "console":
                assert all(line.startswith("$ ") for line in block.text.splitlines()), page


OUTPUT = """Build optimised: 24.93 dB.
It is 2.37 dB below.

 shutter     PSNR dB
 ───────────────────
 optimised     24.93
 rect          24.56

Loss 0.28352.
28 px at 3,550 px/s
"""
SHOWN = {
    "whole": OUTPUT,
    "without rules and empty lines": "\n".join(OUTPUT.replace("─", "").split("\n\n")),
    "a cut at the end": "Build optimised: 24.93 dB.\n…",
    "a cut at the beginning": "…\nrect  24.56\nLoss 0.28352.\n28 px at 3,550 px/s",
    "cuts on all sides": "…\nshutter PSNR dB\n…\nrect 24.56\n…",
    "the next of three digits": "…\nrect 24.55\n…\n28 px at 3,560 px/s",
}
NOT_SHOWN = {
    "a last digit further on": OUTPUT.replace("24.56", "24.58"),
    "another of two digits": "…\n27 px at 3,550 px/s",
    "another of two digits that are not 0": "…\n28 px at 3,400 px/s",
    "a digit less": OUTPUT.replace("0.28352", "0.2835"),
    "an end that is not said to be cut": "Build optimised: 24.93 dB.\nIt is 2.37 dB below.",
    "a beginning that is not": "Loss 0.28352.\n28 px at 3,550 px/s",
    "a line that is left out between": OUTPUT.replace("It is 2.37 dB below.\n", ""),
    "another order": "…\nrect 24.56\noptimised 24.93\n…",
    "a line too many": OUTPUT + "And more.",
}


@pytest.mark.parametrize("slug", SHOWN)
def test_a_page_may_leave_out_what_it_says_it_does(slug):
    """Lines of output that a page leaves out are a line of their own, `…`."""
    assert is_shown(SHOWN[slug], OUTPUT)


@pytest.mark.parametrize("slug", NOT_SHOWN)
def test_a_page_shows_every_line_and_digit(slug):
    """A page that shows another digit, or stops without a word, is found."""
    assert not is_shown(NOT_SHOWN[slug], OUTPUT)


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """The folder that the pages' commands work in, and what those that ran there wrote."""
    folder = tmp_path_factory.mktemp("desk")
    (folder / "slides.toml").write_text(here_documents(TUTORIAL)["slides.toml"])
    return folder, {}


def read_through(page, packages, desk, monkeypatch):
    """Run the blocks of a page in turn, without those that need other packages and their output."""
    folder, remembered = desk
    monkeypatch.chdir(folder)
    # A shutter that a page registers leaves with it.
    monkeypatch.setattr(kinds, "KINDS", list(kinds.KINDS))
    reader = Reader(remembered)
    is_read = True
    for block in blocks(page):
        if block.language in RUNNABLE:
            is_read = not block.needs - packages
            if is_read:
                reader.run(block)
        elif block.language == "text" and is_read:
            assert is_shown(block.text, reader.output), f"{block.text}\n\n{reader.output}"


ON_EACH_PYTHON = {"README.md", "verdict.md"}


def with_marks(page):
    marks = [pytest.mark.shown] if page.name in ON_EACH_PYTHON else []
    return pytest.param(page, id=page.stem, marks=marks)


@pytest.mark.slow
@pytest.mark.parametrize("page", [with_marks(page) for page in CODE if blocks(page)])
def test_code_runs_and_shows_what_the_page_says(page, desk, monkeypatch):
    """A reader who types a page's blocks in turn sees what it shows."""
    read_through(page, frozenset(), desk, monkeypatch)


@pytest.mark.parametrize(("page", "package"), NEEDS)
def test_code_for_other_packages_runs(page, package, desk, monkeypatch):
    """Where a package is installed that the tests do not ask for, blocks that import it run."""
    pytest.importorskip(package, reason=f"{package} is not installed")
    others = frozenset({"torch", package})
    read_through(page, others, desk, monkeypatch)


MODULES = [*sorted((ROOT / "mishutter").rglob("*.py")), ROOT / "benchmarks" / "rivals.py"]


def test_modules_that_speak_of_the_paper_name_it():
    """Equations and sections of the paper are citations only where its title stands beside them."""
    for path in MODULES:
        text = path.read_text(encoding="utf-8")
        if re.search(r"\b[Tt]he\s+paper\b", text):
            assert TITLE in text, path


SCENES = {
    "the built-in scene": example_scene_text(),
    **{
        f"notebooks/{path.name}": path.read_text(encoding="utf-8")
        for path in (ROOT / "notebooks").glob("*.toml")
    },
    **{
        f"{name} of {page.relative_to(ROOT)}": text
        for page in CODE
        for name, text in here_documents(page).items()
        if name.endswith(".toml")
    },
}


def test_a_scene_whose_sensor_moves_says_what_its_stage_does():
    """Its travel from rest to rest and its acceleration, without which it could not be built."""
    limits = {slug: tomllib.loads(text).get("limits", {}) for slug, text in SCENES.items()}
    moving = {slug: keys for slug, keys in limits.items() if "max_stroke_px" in keys}
    assert moving
    for slug, keys in moving.items():
        assert keys.keys() & {"max_travel_px", "max_travel_mm"}, slug
        assert keys.keys() & {"max_acceleration_px_per_s2", "max_acceleration_g"}, slug


def test_the_verdict_has_the_gains_that_were_measured():
    """The page has the benchmark's table, line by line."""
    measured = (
        (ROOT / "benchmarks" / "results" / "gains.md").read_text(encoding="utf-8").splitlines()
    )
    page = (ROOT / "docs" / "verdict.md").read_text(encoding="utf-8").splitlines()
    pictures = ("| as a whole", "| before a still background", "| both layers move")
    rows = [line for line in page if line.startswith(pictures)]
    assert len(rows) > len(pictures)
    assert set(rows) <= set(measured)


def test_the_page_of_bursts_has_the_figures_that_were_measured():
    """Each row of its tables is one of the benchmark's."""
    results = ROOT / "benchmarks" / "results"
    measured = [
        line
        for name in ("bursts.md", "bursts_photographs.md", "many_frames.md", "strips.md")
        for line in (results / name).read_text(encoding="utf-8").splitlines()
    ]
    page = (ROOT / "docs" / "bursts.md").read_text(encoding="utf-8").splitlines()
    rows = [line for line in page if line.startswith("| ")]
    assert len(rows) > 30
    assert set(rows) <= set(measured)


def test_six_scenes_have_the_figures_that_were_measured():
    """The page quotes the benchmark digit by digit; a row over two rivals is over the better."""
    measured = json.loads(
        (ROOT / "benchmarks" / "results" / "scenes.json").read_text(encoding="utf-8")
    )["rows"]
    page = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if " dB" not in line]
    shown = {row[0]: row[1:] for row in rows if len(row) == _SIX_COLUMNS}
    assert len(measured) == 6
    for row in measured:
        over = [row[f"over {rival}"] for rival in ("Hann", "rect", "best Tukey")]
        snapshot = min((row[f"over best {kind}snapshot"] for kind in ("", "panned ")), key=float)
        others = [row[name] for name in ("before a still half", "both layers move")]
        gains = [*over, snapshot, row["over best coded still"], *others, row["through 40 %"]]
        gains = [gain.replace("+0.00", "0") for gain in gains]
        gains.insert(5, row["ceiling dB"])
        name = next(name for name in shown if name.split(":")[0] == row["scene"].split(":")[0])
        assert shown[name] == [row["optimised dB"], *gains]


_SIX_COLUMNS = 11
