"""Blocks of code in pages for people, and a small shell that runs their commands here."""

import contextlib
import io
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import jax

from mishutter import cli

_FENCE = re.compile(r"^```([\w.]*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_HERE = re.compile(r"^cat > (\S+) <<'END'\n(.*?)^END\n", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"\d[\d,]*(?:\.\d+)?")
_IMPORT = re.compile(r"^(?:from|import) (?:mishutter\.)?(torch|deepinv|scico)\b", re.MULTILINE)

NOT_RUN = {
    "pip": "what it installs is here already",
    "pytest": "it would run itself",
    "pre-commit": "it changes the checkout",
    "python": "it makes an environment, the site or all benchmarks",
    ".": "it enters an environment",
    ".ci/run": "it would run itself",
}
"""Programs on pages that tests do not run, nor what stands behind them in a line, and why."""


@dataclass(frozen=True)
class Block:
    """A block of code: its language, its text, and the optional packages that it imports."""

    language: str
    text: str
    needs: frozenset[str]


def blocks(page: Path) -> list[Block]:
    """The blocks of a page, from top to bottom."""
    return [
        Block(language, text, frozenset(_IMPORT.findall(text)))
        for language, text in _FENCE.findall(page.read_text(encoding="utf-8"))
    ]


def here_documents(page: Path) -> dict[str, str]:
    """The files that the commands of a page write, by name."""
    return {name: text for b in blocks(page) for name, text in _HERE.findall(b.text)}


class Reader:
    """Someone who runs a page's blocks in turn, in one folder and one Python.

    A command that another page has run in the same folder is remembered by what it wrote.
    """

    def __init__(self, remembered: dict[str, str]):
        self.names = {"__name__": "page"}
        self.output = ""
        self._remembered = remembered

    def run(self, block: Block) -> None:
        """Run a block, and keep what it writes."""
        stream = io.StringIO()
        as_users = jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard")
        with contextlib.redirect_stdout(stream), as_users[0], as_users[1]:
            if block.language == "python":
                exec(compile(block.text, "page", "exec"), self.names)
            else:
                self._run_commands(block.text)
        self.output = stream.getvalue()

    def _run_commands(self, text: str) -> None:
        for name, content in _HERE.findall(text):
            Path(name).write_text(content, encoding="utf-8")
        lines = _HERE.sub("", text).replace("\\\n", " ").splitlines()
        for line in lines:
            commands = [shlex.split(c, comments=True) for c in line.split(" && ")]
            if not any(words[:1] and words[0] in NOT_RUN for words in commands):
                for words in filter(None, commands):
                    self._run_command(words)

    def _run_command(self, words: list[str]) -> None:
        arguments, target = (words[1:-2], words[-1]) if words[-2:-1] == [">"] else (words[1:], None)
        if words[0] == "sed":
            edited = subprocess.run(["sed", *arguments], capture_output=True, text=True, check=True)
            Path(str(target)).write_text(edited.stdout, encoding="utf-8")
            return
        assert words[0] == "mishutter", words
        command = shlex.join(arguments)
        if command not in self._remembered:
            stream = io.StringIO()
            with contextlib.redirect_stdout(stream):
                assert cli.main(arguments) == 0
            self._remembered[command] = stream.getvalue()
        if target is None:
            sys.stdout.write(self._remembered[command])
        else:
            Path(target).write_text(self._remembered[command])


CUT = "…"
"""A line of a page that stands for lines of output which it leaves out."""


def is_shown(shown: str, output: str) -> bool:
    """Whether a page shows what was written: every line and digit of it, but where it says so.

    Blanks count once, and empty lines and rules of tables not at all. Processors round otherwise:
    the last of three digits or more may be the next one.
    """
    written = iter(_lines(output))
    is_cut = False
    for line in _lines(shown):
        if line == CUT:
            is_cut = True
        elif not _alike(line, next((x for x in written if not is_cut or _alike(line, x)), "")):
            return False
        else:
            is_cut = False
    return is_cut or next(written, None) is None


def _alike(shown: str, written: str) -> bool:
    """Whether two lines are the same but for the last of three digits or more."""
    if _NUMBER.sub("0", shown) != _NUMBER.sub("0", written):
        return False
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(written), strict=True)
    return all(one == other or _is_next(one, other) for one, other in pairs)


def _is_next(one: str, other: str) -> bool:
    """Whether two numbers have the same digits but for the last of three or more, by 1."""
    places = [len(each.partition(".")[2]) for each in (one, other)]
    last, next_ = (int(re.sub(r"[.,]", "", each)) for each in (one, other))
    while places == [0, 0] and last % 10 == next_ % 10 == 0:  # 3,550 is of three digits
        last, next_ = last // 10, next_ // 10
    return places[0] == places[1] and abs(last - next_) == 1 and min(last, next_) >= 100


def _lines(text: str) -> list[str]:
    lines = (" ".join(line.split()) for line in text.splitlines())
    return [line for line in lines if line.strip("─")]
