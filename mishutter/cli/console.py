"""Output of the terminal: one line for an error, strict JSON, a table."""

import gc
import io
import os
import re
import shlex
import shutil
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from pydantic import ValidationError
from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

from mishutter._core.checks import describe, own_message
from mishutter._core.compiling import keep_compiled_programs
from mishutter._core.files import strict_json
from mishutter._core.progress import note
from mishutter._core.validation import requirement

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

AGAIN = "no result was saved; the same command starts again, with what it has compiled so far"
"""Message of an interrupt of work that saves nothing before its end."""
_OF_PYTHON = re.compile(r"`([A-Za-z_.]+)\((\w+)=\.\.\.\)`")
"""An argument of a function as errors name it."""
_OF_COMMANDS = {"path": "the path", "capture": "the capture", "captures": "the captures"}
"""Words for arguments that commands have by other names than functions."""
_PARSER: Any = sys.modules[typer.BadParameter.__module__]
"""The errors of the command line parser, whichever Click it was built on."""


def error_line(
    error: BaseException, arguments: Sequence[str] = (), options: Mapping[str, str] | None = None
) -> str | None:
    """The line `<requirement>; got <value>` for an error of the user's; None for a bug.

    Args:
        error: What was raised.
        arguments: The command line.
        options: Options of its command by the names that functions have for them.
    """
    line = _line_of(error, arguments)
    # Whoever types commands knows no names of functions.
    words = _OF_COMMANDS | {name: f"`{option}`" for name, option in (options or {}).items()}

    def known(each: re.Match[str]) -> str:
        kind, name = each.groups()
        return words.get(name, f"`{_scene_keys().get((kind, name), name)}`")

    return line and _OF_PYTHON.sub(known, line)


@cache
def _scene_keys() -> dict[tuple[str, str], str]:
    """Keys of scene files by the arguments for which they stand, of those with the same unit."""
    from mishutter.model.scene_file import key_of_arguments

    return key_of_arguments()


def _line_of(error: BaseException, arguments: Sequence[str]) -> str | None:
    """The same, with arguments of functions as errors name them."""
    if isinstance(error, _PARSER.UsageError):
        return _one_line(_usage_line(error, arguments))
    if type(error).__name__ == "EquinoxRuntimeError":
        return _one_line(own_message(error))
    if isinstance(error, OSError) and error.strerror:
        # What the package writes has a name, but for standard output.
        name = f"'{error.filename}'" if error.filename is not None else "the output"
        if isinstance(error, FileNotFoundError):
            return f"{name} must exist; got: file not found"
        return f"{name} must be accessible; got: {error.strerror}"
    own = type(error).__module__.startswith("mishutter.")
    return _one_line(str(error)) if own or isinstance(error, ValueError | OSError) else None


def _usage_line(error: Any, arguments: Sequence[str]) -> str:
    """The line for an error of the command line parser, from what the error holds."""
    if isinstance(error, _PARSER.NoSuchOption):
        params = [] if error.ctx is None else error.ctx.command.params
        shown = [
            name for each in params if not getattr(each, "hidden", False) for name in each.opts
        ]
        near, got = (
            _perhaps(get_close_matches(error.option_name, shown)),
            describe(error.option_name),
        )
        return f"every option must be one of those of --help{near}; got {got}"
    if isinstance(error, _PARSER.BadOptionUsage):
        is_last = arguments[-1] == error.option_name
        must = "be followed by a value; got nothing" if is_last else "stand alone; got a value"
        return f"`{error.option_name}` must {must}"
    if isinstance(error, _PARSER.BadParameter):
        hint = error.param.get_error_hint().replace("'", "`")
        return f"{hint} must {_value_line(error)}"
    commands = getattr(error.ctx.command, "commands", None)
    if commands is None:
        return f"there must be no further argument; got: {error.message.removeprefix('Got ')}"
    name = next((text for text in arguments if not text.startswith("-")), "")
    near = _perhaps(get_close_matches(name, commands))
    return f"the command must be one of those of --help{near}; got {describe(name)}"


def _perhaps(names: Sequence[str] | None) -> str:
    return f", perhaps `{names[0]}`" if names else ""


def _value_line(error: Any) -> str:
    """The requirement on an argument's value, and the value."""
    if isinstance(error, _PARSER.MissingParameter):
        return "be given; got nothing"
    if not isinstance(error.__cause__, ValidationError):
        return error.message
    problem = error.__cause__.errors()[0]
    choices = problem["msg"].partition(" is not ")[2].removesuffix(".")
    must = f"be {choices}" if choices else requirement(problem)
    return f"{must}; got {describe(problem['input'])}"


def _one_line(message: str) -> str:
    text = " ".join(message.split()).removesuffix(".")
    return text if "; got" in text else f"the command line must be valid; got: {text}"


def write_error(line: str) -> None:
    """The one line of an error, on standard error."""
    note(f"mishutter: error: {line}")


@contextmanager
def doubts_as_notes() -> Iterator[None]:
    """Turns each warning about a file into one note, however often it is raised.

    JAX's warnings that it cannot keep a program, one for each, become one note too.
    """
    notes: set[str] = set()
    of_cache = re.compile(r"Error writing persistent compilation cache .*?\[Errno \d+\] ([^:]+)")
    with warnings.catch_warnings():
        otherwise = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
            text = str(message)
            not_kept = of_cache.match(text)
            if not_kept is not None:
                text = f"compiled programs cannot be kept for later runs: {not_kept[1]}"
            elif not category.__module__.startswith("mishutter."):
                otherwise(message, category, *place)
                return
            if text not in notes:
                notes.add(text)
                note(text)

        warnings.showwarning = show
        yield


def write_json(document: Mapping[str, object]) -> None:
    """Writes one strict JSON document to standard output."""
    sys.stdout.write(strict_json(document) + "\n")


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Prints a table; its first column is text, the others are numbers.

    Columns that do not fit follow in a second table beside a repeated first column, so that no
    number is cut. The first column is wrapped at half the width of the terminal then.
    """
    console = _console()
    # A table would break its title at its own width.
    console.print(title, style="bold", markup=False, highlight=False, soft_wrap=True)
    cells = [
        [line for row in rows for line in str(row[index]).splitlines()]
        for index in range(len(columns))
    ]
    full = [max(map(cell_len, (name, *texts))) for name, texts in zip(columns, cells, strict=True)]
    least = [
        max(map(cell_len, ("", *name.split(), *texts)))
        for name, texts in zip(columns, cells, strict=True)
    ]
    least[0] = min(full[0], max(console.width // 2, 16))
    for part in _parts(least, console.width):
        room = max(console.width, _across(least, part))
        widths = full if _across(full, part) <= room else least
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
        for index in part:
            justify = "right" if index else "left"
            table.add_column(columns[index], justify=justify, width=widths[index])
        for row in rows:
            table.add_row(*(row[index] for index in part))
        console.width = room
        console.print(table)


def _parts(widths: Sequence[int], room: int) -> list[list[int]]:
    """Divides the columns of a table into parts that fit; the first column begins each part."""
    parts = [[0]]
    for index in range(1, len(widths)):
        if len(parts[-1]) > 1 and _across(widths, [*parts[-1], index]) > room:
            parts.append([0])
        parts[-1].append(index)
    return parts


def _across(widths: Sequence[int], part: Sequence[int]) -> int:
    """Width of a table of some columns, gaps included."""
    return 1 + sum(widths[index] + 2 for index in part)


def print_text(text: str = "") -> None:
    """Prints a line of results."""
    _console().print(text, soft_wrap=True)


def _console() -> Console:
    """A console without markup: the name of a design may hold brackets and colons."""
    columns, height = shutil.get_terminal_size()
    has_width = sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit()
    width = columns if has_width else 80
    # Rich takes a terminal without control codes for 80 columns wide unless it gets both.
    return Console(
        file=sys.stdout, width=width, height=height, markup=False, emoji=False, highlight=False
    )


def take_any_text() -> None:
    """Makes standard output and error accept every character, or drop all where they are closed.

    Otherwise an encoding that lacks one letter of a name or a unit would lose the whole result.
    """
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


@contextmanager
def closable_output() -> Iterator[None]:
    """Lets the reader of the output leave before its end, as `head` does."""
    streams = sys.stdout, sys.stderr  # Typer puts others in their place
    try:
        yield
    except BrokenPipeError:
        pass
    except SystemExit as ending:
        if not isinstance(ending.__context__, BrokenPipeError):
            raise
    finally:
        for stream in streams:
            try:
                stream.flush()
            except OSError:  # a closed pipe or a full disk: Python would try once more at its end
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class InterruptedWorkError(Exception):
    """An interrupt by the user; its message says what was saved and how to go on."""


@contextmanager
def interruptible(text: Callable[[], str]) -> Iterator[None]:
    """Turns an interrupt into an `InterruptedWorkError` that says what it leaves behind."""
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedWorkError(text()) from None


@contextmanager
def ends_when_asked() -> Iterator[None]:
    """Turns SIGTERM into `SystemExit`, so that no file is half written.

    A signal that arrives while Python collects garbage, which JAX causes often, raises an error
    that Python drops: the signal is sent once more then.
    """

    def end(*_: object) -> None:
        raise SystemExit(128 + signal.SIGTERM)

    def send_again(dropped: "UnraisableHookArgs") -> None:
        signals = {KeyboardInterrupt: signal.SIGINT, SystemExit: signal.SIGTERM}
        number = signals.get(dropped.exc_type)
        if number is None:
            before_hook(dropped)
        else:
            # By then the garbage is collected.
            threading.Timer(0.05, os.kill, (os.getpid(), number)).start()

    if threading.current_thread() is not threading.main_thread():  # Python signals no other
        yield
        return
    before, before_hook = signal.signal(signal.SIGTERM, end), sys.unraisablehook
    sys.unraisablehook = send_again
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
        sys.unraisablehook = before_hook


def start_jax() -> None:
    """Sets 64-bit numbers, and keeps compiled programs for later runs.

    Raises:
        ValueError: if an environment variable asks for a device that this machine does not have.
    """
    import jax

    try:
        jax.devices()
    except (RuntimeError, AssertionError):
        # JAX would end with a long traceback, whose last line need not name the variable.
        names = ("JAX_PLATFORMS", "JAX_PLATFORM_NAME")
        asked = {name: os.environ[name] for name in names if os.environ.get(name)}
        if not asked:
            raise
        requirement = "must name a kind of device that this machine has; got"
        raise ValueError(
            f"{' and '.join(f'`{name}`' for name in asked)} {requirement} "
            + " and ".join(map(repr, asked.values()))
        ) from None
    # What JAX traces lives on: collections that look through it at Python's usual pace take a
    # twelfth of a run's processor time.
    gc.set_threshold(50_000, 20, 100)
    jax.config.update("jax_enable_x64", True)
    keep_compiled_programs()


def next_step(scene_file: Path | None, folder: Path | None, design: str) -> str:
    """The command that goes on from an answer: to a folder of files, or from its design."""
    if folder is not None:
        export = ["mishutter", "export", str(folder / design), "--out", str(folder / "lab")]
        return f"{shlex.join(export)}  # the files that drive the camera"
    scene, name = ([], "design") if scene_file is None else ([str(scene_file)], scene_file.stem)
    again = shlex.join(["mishutter", "optimise", *scene, "--out", name])
    return f"{again}  # the design, pictures and a report"
