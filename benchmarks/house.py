"""How many of the package's files does a call run through, and what do the folders hold?

Each call is traced in a process of its own, with nothing compiled: a file counts if one of its
functions runs. Run `python -m benchmarks.house`; `python -m benchmarks.house ROOT` counts the
source text of another checkout and traces nothing.

The counts of a folder, of itself and, where marked, of its tests:

- files, lines: of Python;
- face: names that its `__init__` hands on;
- Any: uses of `typing.Any`;
- shapes: jaxtyping shapes, `Float[Array, "n"]`;
- free: `isinstance(..., FreeMotion)`;
- starred: calls with `*name` or `**name` where `name` is a display assigned in the same function;
- wide: functions of more than five positional parameters;
- words: participles as variables (found, known, given, kept, left, seen, lit, wanted, moved;
  `left` counts where there is no `right`);
- light: variables, parameters and fields of this name;
- begins: docstrings that begin with What, Of or Where;
- inner: imports of modules inside a folder, by its tests;
- private: private names that its tests import or patch.
"""

import ast
import inspect
import multiprocessing
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mishutter as ms

PACKAGE = Path(ms.__file__).parent


# Imported before calls are followed.
PUBLIC = [getattr(ms, name) for name in ms.__all__]
SCENE = ms.example_scene()
MOTION = SCENE.motion
GRID: dict[str, Any] = {"accelerations": [1e5, 4e5], "half_exposures": [0.005, 0.01]}
CALLS = {
    "blur_kernel": lambda: ms.blur_kernel(ms.HannShutter(), MOTION, num_taps=50),
    "optimise": lambda: ms.optimise(SCENE, num_starts=2, max_steps=20),
    "sweep": lambda: ms.sweep(SCENE, **GRID),
}

PARTICIPLES = {"found", "known", "given", "kept", "left", "seen", "lit", "wanted", "moved"}
SHAPES = {"Float", "Complex", "Inexact", "Int", "UInt", "Bool", "Num", "Shaped"}
COLUMNS = ("files", "lines", "face", "Any", "shapes", "free", "starred", "wide", "words", "light")
COLUMNS += ("begins", "inner", "private")


def files_of(name: str) -> list[str]:
    """Files whose functions a call runs, in any thread."""
    seen = set()

    def profile(frame, event, _):
        is_function = frame.f_code.co_flags & inspect.CO_OPTIMIZED
        if event == "call" and is_function and frame.f_code.co_filename.startswith(str(PACKAGE)):
            seen.add(str(Path(frame.f_code.co_filename).relative_to(PACKAGE)))

    threading.setprofile(profile)
    sys.setprofile(profile)
    CALLS[name]()
    sys.setprofile(None)
    return sorted(seen)


Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


def functions(tree: ast.AST) -> Iterator[Function]:
    """Every function of a file, methods and inner ones included."""
    return (node for node in ast.walk(tree) if isinstance(node, Function))


def names_of(tree: ast.AST) -> Iterator[ast.Name | ast.arg]:
    """Variables where they are assigned, and parameters."""
    for node in ast.walk(tree):
        if isinstance(node, ast.arg) or (
            isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
        ):
            yield node


def name_of(node: ast.Name | ast.arg) -> str:
    """The name of a variable or parameter."""
    return node.arg if isinstance(node, ast.arg) else node.id


def uses_of_any(tree: ast.AST) -> list[ast.AST]:
    """Uses of `Any`."""
    return [n for n in ast.walk(tree) if isinstance(n, ast.Name) and n.id == "Any"]


def shapes(tree: ast.AST) -> list[ast.AST]:
    """Arrays that are annotated with a shape."""
    subscripts = (n for n in ast.walk(tree) if isinstance(n, ast.Subscript))
    return [n for n in subscripts if isinstance(n.value, ast.Name) and n.value.id in SHAPES]


def free_motions(tree: ast.AST) -> list[ast.AST]:
    """Questions whether a motion is a free path."""
    calls = (n for n in ast.walk(tree) if isinstance(n, ast.Call))
    return [
        n
        for n in calls
        if ast.unparse(n.func) == "isinstance" and "FreeMotion" in ast.unparse(n.args[1])
    ]


def starred(tree: ast.AST) -> list[ast.AST]:
    """Displays that are assigned to a name and opened in a later call."""
    opened = {}
    for function in functions(tree):
        displays = {
            name_of(target)
            for node in ast.walk(function)
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple | ast.Dict)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for call in (n for n in ast.walk(function) if isinstance(n, ast.Call)):
            parts = [a.value for a in call.args if isinstance(a, ast.Starred)]
            parts += [k.value for k in call.keywords if k.arg is None]
            for part in parts:
                if isinstance(part, ast.Name) and part.id in displays:
                    opened[part.lineno, part.col_offset] = part
    return [*opened.values()]


def wide(tree: ast.AST) -> list[ast.AST]:
    """Functions of more than five positional parameters, beside `self` and `cls`."""

    def count(node: Function) -> int:
        parameters = [a.arg for a in (*node.args.posonlyargs, *node.args.args)]
        return len([name for name in parameters if name not in ("self", "cls")])

    return [node for node in functions(tree) if count(node) > 5]


def participles(tree: ast.AST) -> list[ast.AST]:
    """Variables and parameters that are called by a participle; `left` is one without `right`."""
    sides = {node.lineno for node in names_of(tree) if name_of(node) == "right"}
    return [
        node
        for node in names_of(tree)
        if name_of(node) in PARTICIPLES
        and not (name_of(node) == "left" and any(abs(node.lineno - k) < 3 for k in sides))
    ]


def lights(tree: ast.AST) -> list[ast.AST]:
    """Variables and parameters of the name `light`."""
    return [node for node in names_of(tree) if name_of(node) == "light"]


def beginnings(tree: ast.AST) -> list[ast.AST]:
    """Docstrings that begin with What, Of or Where; those of constants count too."""
    texts = (n for n in ast.walk(tree) if isinstance(n, ast.Expr))
    return [
        n
        for n in texts
        if isinstance(n.value, ast.Constant)
        and isinstance(n.value.value, str)
        and n.value.value.lstrip().split(" ")[0] in ("What", "Of", "Where")
    ]


def inner_imports(tree: ast.AST) -> list[ast.AST]:
    """Imports past a folder's `__init__`."""
    imports = (n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom))
    return [n for n in imports if (n.module or "").startswith("mishutter.") and _is_inner(n)]


def _is_inner(node: ast.ImportFrom) -> bool:
    parts = (node.module or "").split(".")[1:]
    folder = PACKAGE.joinpath(*parts)
    if len(parts) != 1:
        return len(parts) > 1
    modules = {alias.name for alias in node.names if (folder / f"{alias.name}.py").exists()}
    return bool(modules - {*_face(folder)})


def _face(folder: Path) -> Iterator[str]:
    """Names that a folder's `__init__` hands on, some of which are those of its modules too."""
    tree = ast.parse((folder / "__init__.py").read_text())
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
    return (alias.name for node in imports for alias in node.names)


def private_names(tree: ast.AST) -> list[ast.AST]:
    """Private names of the package that a test imports, and whatever it patches."""
    found: list[ast.AST] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mishutter"):
            found += [node for alias in node.names if alias.name.startswith("_")]
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "monkeypatch.setattr":
            found += [node]
    return found


IN_PACKAGE: dict[str, Callable[[ast.AST], list[ast.AST]]] = {
    "Any": uses_of_any,
    "shapes": shapes,
    "free": free_motions,
    "starred": starred,
    "wide": wide,
    "words": participles,
    "light": lights,
    "begins": beginnings,
}
IN_TESTS: dict[str, Callable[[ast.AST], list[ast.AST]]] = {
    "inner": inner_imports,
    "private": private_names,
}


def counts(root: Path, folder: str) -> Counter[str]:
    """The counts of a folder of a checkout."""
    total: Counter[str] = Counter()
    for top, rules in (("mishutter", IN_PACKAGE), ("tests", IN_TESTS)):
        for path in sorted((root / top / folder).rglob("*.py")):
            text = path.read_text()
            tree = ast.parse(text)
            total.update({name: len(rule(tree)) for name, rule in rules.items()})
            if top == "mishutter":
                total.update(files=1, lines=text.count("\n"))
    total["face"] = len([*_face(root / "mishutter" / folder)])
    return total


def table(root: Path) -> str:
    """The counts of every folder of a checkout, and their sums."""
    folders = sorted(path.parent.name for path in (root / "mishutter").glob("*/__init__.py"))
    rows = {folder: counts(root, folder) for folder in folders}
    rows["all"] = sum(rows.values(), Counter())
    lines = ["".join([f"{'':12}", *(f"{name:>8}" for name in COLUMNS)])]
    for folder, row in rows.items():
        lines.append("".join([f"{folder:12}", *(f"{row[name]:8}" for name in COLUMNS)]))
    return "\n".join(lines)


def main() -> None:
    """Count and print."""
    if len(sys.argv) > 1:
        print(table(Path(sys.argv[1])))
        return
    print(table(PACKAGE.parent), end="\n\n")
    for name in CALLS:
        with multiprocessing.get_context("spawn").Pool(1) as alone:
            files = alone.apply(files_of, (name,))
        print(f"{name}: {len(files)} files\n    {' '.join(files)}")


if __name__ == "__main__":
    main()
