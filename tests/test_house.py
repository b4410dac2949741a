"""The rules of the house that a linter does not know, checked on the source text."""

import ast
import importlib
import pydoc
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import mishutter

PACKAGE = Path(mishutter.__file__).parent

FLOORS = [
    {"cli"},
    {"paper", "explore"},
    {"report"},
    {"sweeps", "decoding"},
    {"hardware"},
    {"search", "measurement"},
    {"camera"},
    {"design"},
    {"evaluation"},
    {"blur"},
    {"model"},
    {"pictures"},
    {"_core"},
]
"""Folders from the top floor down; a folder imports only those on lower floors."""

FOLDERS = set().union(*FLOORS)

FILES = sorted(PACKAGE.rglob("*.py"))
TEXTS = {path: path.read_text(encoding="utf-8") for path in FILES}
TREES = {path: ast.parse(text) for path, text in TEXTS.items()}


def module_name(path: Path) -> str:
    name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
    return name.removesuffix(".__init__")


def imported(tree: ast.AST) -> list[str]:
    """Modules of the package that a file's import statements name."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            found += [node.module or ""]
        elif isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
    return [name for name in found if name.split(".")[0] == "mishutter"]


def floor(folder: str) -> int:
    return next(i for i, folders in enumerate(FLOORS) if folder in folders)


def public_imports() -> list[ast.ImportFrom]:
    """The imports that a type checker reads; at run time each name is imported when asked for."""
    stub = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))
    return [node for node in stub.body if isinstance(node, ast.ImportFrom)]


def public_names() -> list[str]:
    return [a.name for node in public_imports() if node.module for a in node.names]


def wrong_imports(path: Path) -> list[str]:
    """Imports of a file that go upwards, or name a folder in place of the module in it."""
    folder, *inside = module_name(path).split(".")
    if not inside and path.parent == PACKAGE:  # the public face, and `python -m mishutter`
        return []
    others = [name.split(".")[1:] for name in imported(TREES[path])]
    return [
        f"{module_name(path)} imports {'.'.join([target, *module])}"
        for target, *module in others
        if target != folder and (not module or floor(target) <= floor(folder))
    ]


def test_imports_point_downwards():
    """A file imports the module that defines a name, from its own folder or a lower floor."""
    assert not [line for path in FILES for line in wrong_imports(path)]
    assert any(imported(tree) for tree in TREES.values())


def test_few_modules_lie_at_the_top():
    """A module belongs to a folder; the top holds the public names and `python -m mishutter`."""
    assert len(list(PACKAGE.glob("*.py"))) <= 6


def test_no_public_name_is_that_of_a_folder():
    """`mishutter.sweep` is the function whatever was imported before it."""
    assert not [name for name in public_names() if name in FOLDERS]


def test_a_folder_names_nothing():
    """Its `__init__` says what it is for: whoever imports one module reads no others.

    That of the command line has its entry, and that of reports the pictures, for users.
    """
    own = {PACKAGE, PACKAGE / "cli", PACKAGE / "report"}
    doors = [path for path in FILES if path.name == "__init__.py" and path.parent not in own]
    assert len(doors) >= len(FOLDERS) - 2
    assert [module_name(path) for path in doors if len(TREES[path].body) != 1] == []


def imported_across() -> list[tuple[str, str, str]]:
    """File, module and name of each name that a file imports from another folder."""
    return [
        (module_name(path), node.module, alias.name)
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mishutter.")
        for alias in node.names
        if node.module.split(".")[1] != module_name(path).split(".")[0]
    ]


def test_no_private_name_is_imported_from_another_folder():
    """What begins with an underscore is of its own folder."""
    assert len(imported_across()) > 100
    assert [each for each in imported_across() if each[2].startswith("_")] == []


def is_forbidden(node: ast.AST) -> bool:
    """Whether a node is an `assert` or a call of `super`."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return node.func.id == "super"
    return isinstance(node, ast.Assert)


def test_no_assert_and_no_super():
    """The package raises what its user can read, and adds behaviour by wrapping."""
    nodes = [(path, node) for path, tree in TREES.items() for node in ast.walk(tree)]
    assert not [f"{module_name(p)}:{node.lineno}" for p, node in nodes if is_forbidden(node)]


def test_no_dictionary_is_spread_into_a_public_constructor():
    """A type checker sees which arguments are given; files are read by `made_of` alone."""
    names = {*public_names(), *(name for _, _, name in imported_across())}
    classes = {name for name in names if name[0].isupper()}
    assert {"Scene", "Limits", "RestoredPhotograph"} <= classes
    spread = [
        (path.name, ast.unparse(node.func))
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and any(each.arg is None for each in node.keywords)
    ]
    assert [(path, name) for path, name in spread if name.split(".")[-1] in classes] == []


def num_positional(node: ast.FunctionDef) -> int:
    """Positional parameters of a function beside `self` and `cls`."""
    names = [argument.arg for argument in (*node.args.posonlyargs, *node.args.args)]
    return len([name for name in names if name not in ("self", "cls")])


def test_functions_have_five_positional_parameters_at_most():
    """A call of more is read wrongly: arguments that travel together are one record."""
    functions = [
        (path, node)
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
    ]
    assert max(num_positional(node) for _, node in functions) > 3
    assert not [f"{module_name(p)}.{f.name}" for p, f in functions if num_positional(f) > 5]


def test_docstrings_are_sentences():
    """A reader who meets one alone learns what is there: none begins with What, Of or Where."""
    first_words = {
        f"{module_name(path)}:{node.lineno}": node.value.value.lstrip().split(" ")[0]
        for path, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if isinstance(node.value.value, str)
    }
    assert not [place for place, word in first_words.items() if word in ("What", "Of", "Where")]


def test_no_future_annotations():
    """Postponed annotations break `eqx.AbstractVar` and shape checks at run time."""
    statement = "from __future__ import annotations"
    assert not [module_name(path) for path, text in TEXTS.items() if statement in text]


@cache
def classes() -> dict[str, ast.ClassDef]:
    """The package's classes by their names: a worker that tests none of this looks for none."""
    return {
        f"{module_name(path)}.{node.name}": node
        for path in FILES
        for node in ast.walk(TREES[path])
        if isinstance(node, ast.ClassDef)
    }


def bases(node: ast.ClassDef) -> list[str]:
    return [ast.unparse(base) for base in node.bases]


def is_module(node: ast.ClassDef) -> bool:
    return any(b == "eqx.Module" or b.split(".")[-1].startswith("Abstract") for b in bases(node))


def test_text_is_read_by_its_encoding():
    """Files of the repository are UTF-8, which not every system assumes."""
    folders = ("mishutter", "tests", "benchmarks", "docs")
    root = Path(__file__).parents[1]
    files = [path for each in folders for path in (root / each).rglob("*.py")]
    bare = "read_text(" + ")"
    assert not [str(path) for path in files if bare in path.read_text(encoding="utf-8")]


def test_classes_are_abstract_or_final():
    """A class is an interface, named so, or final, marked so; only interfaces are derived from."""
    modules = {name: node for name, node in classes().items() if is_module(node)}
    assert modules
    for name, node in modules.items():
        decorators = {ast.unparse(d) for d in node.decorator_list}
        abstract = node.name.removeprefix("_").startswith("Abstract")
        assert abstract != bool(decorators & {"final", "typing.final"}), name


def is_field(statement: ast.stmt) -> bool:
    if not isinstance(statement, ast.AnnAssign):
        return False
    return not ast.unparse(statement.annotation).startswith(("eqx.Abstract", "ClassVar"))


def test_fields_sit_in_the_final_class():
    """An interface says by `AbstractVar` what must be there and holds nothing itself."""
    interfaces = {n: node for n, node in classes().items() if node.name.startswith("Abstract")}
    assert interfaces
    for name, node in interfaces.items():
        if is_module(node):
            assert not [ast.unparse(s) for s in node.body if is_field(s)], name


def test_public_names_are_re_exported_one_a_line():
    """`__init__.pyi` holds imports of the form `X as X`, and `dir` has their names."""
    for node in public_imports():
        assert len(node.names) == 1
        assert node.names[0].name == node.names[0].asname
    folders = {node.names[0].name for node in public_imports() if node.module is None}
    assert folders < FOLDERS
    assert sorted(dir(mishutter)) == sorted([*public_names(), *folders])


def test_a_star_imports_the_public_names():
    """All that `dir` lists and that type checkers expect of the stub, each the same object."""
    names: dict[str, object] = {}
    exec("from mishutter import *", names)
    assert set(names) >= set(public_names())
    assert all(names[name] is getattr(mishutter, name) for name in dir(mishutter))


def test_a_star_imports_nothing_else():
    """Not what the package needs itself, where no name was used before it."""
    lines = "from mishutter import *; n = {*dir()}; import mishutter; print(*n - {*dir(mishutter)})"
    found = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True)
    assert all(re.fullmatch("__.*__", name) for name in found.stdout.split()), found.stdout
    assert found.returncode == 0, found.stderr


def test_help_has_every_name_once_in_a_line_of_its_own():
    """By what it is for; the text of `help(mishutter)` holds no more of a class or function."""
    page = mishutter.__doc__ or ""
    *groups, folders = page.split("\n\n")[2:]
    lines = [line for group in groups for line in group.splitlines()[1:]]
    names = [line.split()[0] for line in lines]
    assert sorted(names) == sorted(public_names())
    assert all(len(line.split()) > 2 for line in lines)
    assert max(map(len, page.splitlines())) <= 100
    assert {*" ".join(folders.split()).partition("package ")[2].split(", ")} == {
        node.names[0].name for node in public_imports() if node.module is None
    }
    text = pydoc.plain(pydoc.render_doc(mishutter))
    assert len(text.splitlines()) < 200
    assert "ndarray(" not in text
    assert "optimise(scene" not in text.replace("`optimise(example_scene())`", "")


@pytest.mark.parametrize(
    ("asked", "near"),
    [("optimize", "optimise"), ("Optimise", "optimise"), ("HanShutter", "HannShutter")],
)
def test_a_name_that_is_not_there_is_answered_with_the_nearest(asked, near):
    """In American spelling, or with a letter that is wrong."""
    message = f"module 'mishutter' has no attribute '{asked}'; did you mean '{near}'?"
    with pytest.raises(AttributeError, match=re.escape(message)):
        getattr(mishutter, asked)


def test_public_names_are_those_that_a_type_checker_reads():
    """A name that is imported when it is asked for is the one of the folder it is said to be of."""
    for node in public_imports():
        name, folder = node.names[0].name, node.module
        if folder is not None:
            of_folder = getattr(importlib.import_module(f"mishutter.{folder}"), name)
            assert getattr(mishutter, name) is of_folder, name


def test_importing_the_package_imports_none_of_its_folders():
    """`import mishutter` costs nothing until a name is used, and refuses what it does not have."""
    own = "[name for name in sys.modules if name.startswith('mishutter.')]"
    code = f"import sys, mishutter; assert not {own}; mishutter.model; mishutter.Scene"
    subprocess.run([sys.executable, "-c", code], check=True)
    with pytest.raises(AttributeError, match="has no attribute 'shutters'"):
        mishutter.shutters  # type: ignore[attr-defined]  # noqa: B018


def test_public_names_are_documented():
    """Every public class and function says what it is in one sentence."""
    for name in public_names():
        value = getattr(mishutter, name)
        if callable(value):
            first = (value.__doc__ or "").strip().split("\n")[0]
            assert first.endswith((".", ":")), name
        else:
            assert any(f"\n{name} = " in text for text in TEXTS.values()), name


def test_a_search_loads_no_laboratory():
    """Drive formats, traces and calibration are for those who build, and a capture for pictures."""
    loads = "import sys, mishutter.search.search; print(*sorted(sys.modules))"
    run = subprocess.run([sys.executable, "-c", loads], capture_output=True, text=True, check=True)
    loaded = [name for name in run.stdout.split() if name.startswith("mishutter.")]
    assert "mishutter.design" in loaded
    assert not [name for name in loaded if name.split(".")[1] in ("hardware", "camera", "decoding")]


def test_the_help_of_the_main_function_fits_a_screen():
    """60 lines hold the arguments of `optimise`, and what it does with them.

    Python 3.13 writes each argument on a line of its own, and longer types than one line takes.
    """
    run = "import mishutter; help(mishutter.optimise)"
    page = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, check=True)
    lines = page.stdout.splitlines()
    signature = lines[: next(i for i, line in enumerate(lines) if "->" in line) + 1]
    assert len(signature) <= 20
    assert len(lines) - len(signature) <= 57
