"""What builds the documentation site: its generated pages are whole, and no broken link passes."""

import ast
import inspect
import re

import pytest
from pydantic import BaseModel

import mishutter
from docs.builder.citing import citing_page
from docs.builder.links import broken_links
from docs.builder.pages import ROOT, generated, with_links, write_pages, written
from docs.builder.reference import public_names, scene_page, section_of, unit
from mishutter.model.scene_schema import SceneFile


def keys(section: type[BaseModel]):
    """The keys of a section and of all sections in it, each with what it holds."""
    for key, field in section.model_fields.items():
        yield key, field
        if section_of(field) is not None:
            yield from keys(section_of(field))


def test_every_scene_key_stands_on_its_page_with_unit_default_and_range():
    """The page is made from the schema: a key that is added there is on it."""
    page = scene_page()
    for section, whole in SceneFile.model_fields.items():
        part = page.split(f"## `[{section}]`")[1].split("\n## ")[0]
        for key, field in keys(section_of(whole)):
            row = re.search(rf"^\| `{key}` \| (.*) \| (.*) \| (.+) \|$", part, re.MULTILINE)
            assert row, key
            assert row[1] == unit(key)
            assert (row[2] == "must be given") == field.is_required()
    numbers = [
        key for key, field in keys(SceneFile) if "_per_" in key or key.endswith(("_ms", "_e"))
    ]
    assert len(numbers) > 15
    assert all(map(unit, numbers))


def test_every_public_name_is_on_a_page_of_the_reference():
    """A name that is added to the package is documented."""
    named = {name for names in public_names().values() for name in names}
    flat = {name for name in dir(mishutter) if not inspect.ismodule(getattr(mishutter, name))}
    assert flat <= named


def parameters():
    """Public functions and methods that have a docstring of their own, with their parameters."""
    for name in dir(mishutter):
        public = getattr(mishutter, name)
        members = vars(public) if inspect.isclass(public) else {}
        methods = {f"{name}.{m}": getattr(f, "__func__", f) for m, f in members.items()}
        own = {name: public} if inspect.isfunction(public) else methods
        for called, function in own.items():
            is_shown = inspect.isfunction(function) and not called.partition(".")[2].startswith("_")
            if is_shown and function.__doc__:
                names = inspect.signature(function).parameters
                yield called, function.__doc__, [n for n in names if n not in ("self", "cls")]


def test_every_argument_is_explained():
    """Pages show them with their types, by what stands in the docstring."""
    shown = list(parameters())
    assert len(shown) > 100
    for called, text, names in shown:
        explained = set(re.findall(r"^\s+\*{0,2}(\w+):", text, re.MULTILINE))
        assert set(names) <= explained, called


def test_every_page_can_be_reached_from_the_site_s_menu():
    """The menu names each page that is written or generated, and no other."""
    menu = set(
        re.findall(r"[\w/]+\.md$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    )
    reference = {f"reference/{module}.md" for module in public_names()}
    assert menu == {*written().values(), *generated().values(), *reference}


def test_links_lead_to_the_site_s_pages(tmp_path):
    """A page links to pages, to generated ones for sources, and to copies of other files."""
    write_pages(tmp_path)
    page = (tmp_path / "index.md").read_text(encoding="utf-8")
    assert "](tutorial.md)" in page
    assert "](citing.md)" in page
    assert "](files/LICENSE)" in page
    assert (tmp_path / "files" / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    below = (tmp_path / "researchers" / "maps.md").read_text(encoding="utf-8")
    assert "](../notebooks/03_acceleration_and_exposure.md)" in below
    cell = "[kernels](../docs/researchers/kernels.md#deepinv)"
    page = with_links(cell, "notebooks/04_capture_and_restore.ipynb", tmp_path)
    assert page == "[kernels](../researchers/kernels.md#deepinv)"


def test_every_work_has_an_entry_of_bibtex():
    """Each work of `CITATION.cff`, by what is known of it and no more."""
    (text,) = re.findall(r"^```bibtex\n(.*?)^```$", citing_page(), re.MULTILINE | re.DOTALL)
    own, paper, levin = text.strip().split("\n\n")
    assert own.startswith("@misc{mishutter,\n  author = {{The mishutter developers}},")
    assert "version" in own
    assert "doi = " not in paper
    assert "year = " not in paper
    assert "names neither authors" in paper
    assert levin.startswith("@article{levin2008,\n  author = {Levin, Anat and Sand, Peter and ")
    assert "\n  year = {2008},\n  doi = {10.1145/1399504.1360670},\n}" in levin


PAGE = '<html><body><h1 id="a">A</h1>{}</body></html>'
WRONG = {
    "a page that is not there": ('<a href="gone.html">x</a>', "links to gone.html"),
    "an anchor that is not there": ('<a href="b.html#c">x</a>', "no such anchor"),
    "an anchor on the page itself": ('<a href="#c">x</a>', "no such anchor"),
    "a picture that is not there": ('<img src="gone.png">', "links to gone.png"),
    "a script from elsewhere": ('<script src="https://x.org/a.js"></script>', "loads https"),
    "a font from elsewhere": ('<link rel="stylesheet" href="//x.org/a.css">', "loads //x.org"),
}


@pytest.mark.parametrize("slug", WRONG)
def test_a_broken_link_is_found(slug, tmp_path):
    """So is what would be loaded from elsewhere."""
    html, problem = WRONG[slug]
    (tmp_path / "b.html").write_text(PAGE.format(""))
    (tmp_path / "index.html").write_text(PAGE.format(html))
    (line,) = broken_links(tmp_path)
    assert line.startswith("index.html: ")
    assert problem in line


def test_a_link_that_holds_is_none(tmp_path):
    """Neither are pages elsewhere that a reader may choose to open."""
    (tmp_path / "b.html").write_text(PAGE.format(""))
    links = '<a href="b.html#a">x</a> <a href="#a">x</a> <a href="https://x.org">x</a>'
    (tmp_path / "index.html").write_text(PAGE.format(links))
    assert not broken_links(tmp_path)


def test_formulae_become_mathml():
    """Between single dollars and in fences, but neither in code nor where a price is meant."""
    pytest.importorskip("latex2mathml", reason="the docs extra is not installed")
    markdown = pytest.importorskip("markdown", reason="the docs extra is not installed")
    from docs.builder import mathematics

    text = "Of $\\frac12\\int w$ and $x_v$, not `$x$`; 3 $ and 4 $."
    html = markdown.markdown(text, extensions=[mathematics.makeExtension()])
    assert html.count("<math") == 2
    assert "<mfrac>" in html
    assert "<code>$x$</code>" in html
    assert "3 $ and 4 $." in html
    assert 'display="block"' in mathematics.fence("x(t) = a t^2\n", "math")


def formulae(inline):
    """Formulae of pages and docstrings, each with where it stands."""
    files = [
        ROOT / "README.md",
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "mishutter").rglob("*.py"),
    ]
    for path in files:
        text = path.read_text(encoding="utf-8")
        prose = [text]
        if path.suffix == ".py":
            documented = ast.Module | ast.ClassDef | ast.FunctionDef
            nodes = [n for n in ast.walk(ast.parse(text)) if isinstance(n, documented)]
            prose = [ast.get_docstring(node) or "" for node in nodes]
        for each in prose:
            for formula in re.findall(r"^```math\n(.*?)^```", each, re.MULTILINE | re.DOTALL):
                yield path.name, formula
            for formula in re.findall(inline, re.sub(r"```.*?```|`[^`]*`", "", each, flags=re.S)):
                yield path.name, formula


def test_every_formula_is_one_that_can_be_shown():
    """No TeX is left in what a reader sees: the builder knows fences and single dollars."""
    pytest.importorskip("latex2mathml", reason="the docs extra is not installed")
    from docs.builder import mathematics

    assert not [
        page.name for page in (ROOT / "docs").rglob("*.md") if "$$" in page.read_text("utf-8")
    ]
    shown = list(formulae(mathematics.INLINE))
    assert len(shown) > 300
    for name, formula in shown:
        assert "merror" not in mathematics.fence(formula), name
    with pytest.raises(ValueError, match=r"can be converted; got `2 \\arg\\min_f f`"):
        mathematics.fence(r"2 \arg\min_f f")


def test_bars_of_an_absolute_value_stand_close():
    """Both are fences: a bar by itself counts as a relation, which has room on its sides."""
    pytest.importorskip("latex2mathml", reason="the docs extra is not installed")
    from docs.builder import mathematics

    for formula in ("|u| = 2Ar", r"\lvert v\rvert + 3"):
        assert mathematics.fence(formula).count('<mo form="prefix" stretchy="false">&#x0007C;') == 2
