"""The rules of the house that a linter does not know, checked on the source text."""

import ast
from pathlib import Path

import pytest

import mishutter

PACKAGE = Path(mishutter.__file__).parent

LAYERS = """
__init__ __main__ cli cli_camera cli_export cli_sweep cli_plan cli_options report reproduce
reproduce_page reproduce_figures reproduce_capture plots_sweep plots trade_offs sweep sweep_cluster
sweep_store sweep_blocks sweep_search sweep_layout sweep_tiles sweep_spectra sweep_waves
sweep_kernels sweep_points sweep_tables sweep_grid simulation photographs
restoration compare optimise planning
plan_tolerance plan_check many_starts search_starts solvers objective plan_items design_space drive
design design_schema losses decoders metrics simulate tiles layers_file layers frames cells quality
noise rows response nodes picture_plan plan lengths speeds scene_file scene_schema schema pictures
png tiff upright scene alignment spectrum descent kernel rates arms path motion shutters doubleword
terminal compiling memory programs shelf files threads waves types
""".split()
"""Imports point downwards in this list only, from one module or folder to a later one."""

UPWARD = {("scene", "scene_file"), ("layers", "layers_file"), ("shutters.base", "shutters.sampled")}
"""Imports inside a function that may point upwards: a constructor that reads files, and a
method whose default needs a sibling."""

MAX_LINES = 330

FILES = sorted(PACKAGE.rglob("*.py"))
TREES = {path: ast.parse(path.read_text()) for path in FILES}


def module_name(path: Path) -> str:
    name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
    return name.removesuffix(".__init__")


def every_file(test):
    return pytest.mark.parametrize("path", FILES, ids=module_name)(test)


def imported(node: ast.AST) -> list[str]:
    """Modules of the package that an import statement names, without the package's name."""
    if isinstance(node, ast.ImportFrom):
        if node.module == "mishutter":
            return [alias.name for alias in node.names]
        names = [node.module or ""]
    elif isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    else:
        return []
    return [n.removeprefix("mishutter.") for n in names if n.startswith("mishutter.")]


def layer(module: str) -> int:
    return LAYERS.index(module.split(".")[0])


@every_file
def test_every_module_has_its_place(path):
    """A module is in the list of layers, so that what may import it is decided."""
    assert module_name(path).split(".")[0] in LAYERS


@every_file
def test_imports_point_downwards(path):
    """No module imports one that stands above it, functions' own imports included."""
    source = module_name(path)
    targets = {t for node in ast.walk(TREES[path]) for t in imported(node)}
    upward = {
        t
        for t in targets
        if t.split(".")[0] != source.split(".")[0]
        and t.split(".")[0] in LAYERS
        and layer(t) < layer(source)
        and (source, t) not in UPWARD
    }
    assert not upward


@every_file
def test_no_assert_and_no_super(path):
    """The package raises what its user can read, and adds behaviour by wrapping."""
    for node in ast.walk(TREES[path]):
        assert not isinstance(node, ast.Assert), f"assert in line {node.lineno}"
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id != "super", f"super() in line {node.lineno}"


@every_file
def test_a_file_has_one_job(path):
    """A file that grows past about 300 lines took on a second job."""
    assert len(path.read_text().splitlines()) <= MAX_LINES


@every_file
def test_no_future_annotations(path):
    """Postponed annotations break `eqx.AbstractVar` and shape checks at run time."""
    assert "from __future__ import annotations" not in path.read_text()


CLASSES = [
    pytest.param(node, id=f"{module_name(path)}.{node.name}")
    for path in FILES
    for node in ast.walk(TREES[path])
    if isinstance(node, ast.ClassDef)
]


def bases(node: ast.ClassDef) -> list[str]:
    return [ast.unparse(base) for base in node.bases]


def is_module(node: ast.ClassDef) -> bool:
    return any(b == "eqx.Module" or b.split(".")[-1].startswith("Abstract") for b in bases(node))


@pytest.mark.parametrize("node", CLASSES)
def test_classes_are_abstract_or_final(node):
    """A class is an interface, named so, or final, marked so; only interfaces are derived from."""
    if not is_module(node):
        return
    decorators = {ast.unparse(d) for d in node.decorator_list}
    abstract = node.name.removeprefix("_").startswith("Abstract")
    assert abstract != bool(decorators & {"final", "typing.final"})


def is_field(statement: ast.stmt) -> bool:
    if not isinstance(statement, ast.AnnAssign):
        return False
    return not ast.unparse(statement.annotation).startswith(("eqx.Abstract", "ClassVar"))


@pytest.mark.parametrize("node", CLASSES)
def test_fields_sit_in_the_final_class(node):
    """An interface says by `AbstractVar` what must be there and holds nothing itself."""
    if is_module(node) and node.name.startswith("Abstract"):
        assert not [ast.unparse(s) for s in node.body if is_field(s)]


def public_names() -> list[str]:
    tree = TREES[PACKAGE / "__init__.py"]
    return [a.asname or a.name for n in tree.body if isinstance(n, ast.ImportFrom) for a in n.names]


def test_public_names_are_re_exported_one_a_line():
    """`__init__.py` holds imports of the form `X as X`, the version, and nothing else."""
    for node in TREES[PACKAGE / "__init__.py"].body:
        if isinstance(node, ast.ImportFrom):
            assert len(node.names) == 1
            assert node.names[0].name == node.names[0].asname
        else:
            assert isinstance(node, ast.Expr) or ast.unparse(node).startswith("__version__")


@pytest.mark.parametrize("name", public_names())
def test_public_names_are_documented(name):
    """Every public class and function says what it is in one sentence."""
    value = getattr(mishutter, name)
    if callable(value):
        first = (value.__doc__ or "").strip().split("\n")[0]
        assert first.endswith((".", ":"))
    else:
        assert any(f"\n{name} = " in path.read_text() for path in FILES)
