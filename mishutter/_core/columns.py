"""Columns of numbers in text: a line of names, a line of units, then one line a row."""

import codecs
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from mishutter._core.checks import Unquoted, require


def table_text(columns: Mapping[tuple[str, str], Iterable[object]]) -> str:
    """Columns, by their names and units, as text; numbers have nine digits."""
    lines = [*zip(*columns, strict=True)]
    rows = zip(*columns.values(), strict=True)
    lines += [[x if isinstance(x, str) else f"{x:.9g}" for x in row] for row in rows]
    return "".join(f"{','.join(line)}\n" for line in lines)


def text_of(content: bytes, name: str) -> str:
    """Text of a file in UTF-8 or, by its byte order mark, UTF-16; otherwise in Latin-1.

    Latin-1 has a character for every byte, so that no symbol beside the numbers is an error.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = content.decode("utf-16", errors="replace")
    else:
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")
    # Binary files contain control characters, which text does not.
    is_text = re.search("[\0-\x08\x0e-\x19\x1b-\x1f]", text) is None
    requirement = "be text, as CSV is, in UTF-8, UTF-16 or Latin-1"
    require(is_text, name, requirement, Unquoted("other bytes"))
    return text


def text_lines(content: bytes, name: str) -> list[str]:
    """Lines of a text file that are not empty; at least one."""
    lines = [line.strip() for line in text_of(content, name).splitlines() if line.strip()]
    require(bool(lines), name, "hold at least one line", Unquoted("an empty file"))
    return lines


def cells(line: str) -> list[str]:
    """The values of a line, between commas."""
    return [cell.strip() for cell in line.split(",")]


def number_rows(lines: Sequence[str], count: int, name: str) -> np.ndarray:
    """Rows of finite numbers, `count` in each; shape `(rows, count)`."""
    require(bool(lines), name, "hold at least one row of numbers", Unquoted("none"))
    requirement = f"hold {count} {'number' if count == 1 else 'numbers'} a row"
    try:
        numbers = np.loadtxt(lines, delimiter=",", ndmin=2, comments=None)
    except ValueError as error:  # it tells a row that is shorter or longer, or what is no number
        # NumPy counts the rows of words from 0, unlike those of other lengths.
        reason = str(error).partition(";")[0].partition(" to float64")[0].removesuffix(".")
        raise ValueError(f"`{name}` must {requirement}; got: {reason}.") from None
    require(numbers.shape[1] == count, name, requirement, Unquoted(f"{numbers.shape[1]}"))
    is_finite = np.isfinite(numbers).all(axis=1)
    got = Unquoted(lines[int(np.argmin(is_finite))])
    require(bool(is_finite.all()), name, "hold finite numbers", got)
    return numbers
