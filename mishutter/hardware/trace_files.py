"""Traces as instruments write them: a block of numbers in text, with headings and settings.

Oscilloscopes export text of many layouts, and the reader knows none by its maker. The block is the
run of lines that hold numbers in the same columns. Its headings, and the settings above it or
beside it, name the column of times and its unit, or the length of a step where there is none.
"""

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import Unquoted, require
from mishutter._core.columns import text_of
from mishutter._core.files import contents
from mishutter.hardware.traces import Trace, has_two_levels, require_samples

_UNITS = {"ns": 1e-9, "us": 1e-6, "\u03bcs": 1e-6, "ms": 1e-3}
_UNITS |= dict.fromkeys(("s", "sec", "second", "seconds"), 1.0)
"""Units of time, case-folded, which makes one of both micro signs; s."""
METRES = {"nm": 1e-9, "um": 1e-6, "\u03bcm": 1e-6, "mm": 1e-3, "m": 1.0}
"""Units of places beside pixels, case-folded; m."""
_ENCODERS = ("counts", "count", "cts", "steps", "pulses", "volts", "volt", "v", "mv")
"""Units of an encoder, case-folded, of which a scale says the length."""
_TIMES = ("time", "t", "zeit", "temps", "tiempo", "tempo")
"""Names of a column of times, case-folded."""
_INTERVALS = ("sampleinterval", "samplinginterval", "samplingperiod", "sampleperiod")
_INTERVALS += ("increment", "interval", "xinc", "xincr", "xincrement", "tinc", "deltax", "dt")
_STARTS = ("start", "xorg", "xorigin", "xzero", "x0", "t0")
_CLOCK_UNITS = ("horizontalunits", "horizontalunit", "horzunits", "hunits", "hunit")
_CLOCK_UNITS += ("xunits", "xunit", "xunitlabel", "timeunits", "timeunit")
"""Settings as makers name them, by their letters and digits alone, case-folded."""
_OVERRANGE = 9.9e37
"""Number that stands for a signal out of range, as SCPI has it for an infinite one."""
_SIGNS = dict.fromkeys([*range(0x2010, 0x2016), 0x2212, 0xFF0D], "-") | {0xFF0B: "+"}
_SIGNS |= dict.fromkeys([0x066B, 0xFF0E], ".") | {0xFF0C: ",", 0x221E: "inf"}
"""Signs beside the digits of a number, and those that `float` knows in their place."""


class _Block(NamedTuple):
    """Lines of numbers, and the lines above them."""

    header: list[list[str]]  # Cells of the lines above
    lines: list[str]  # Lines of numbers
    columns: tuple[int, ...]  # Columns that are numbers in each of them
    separator: str | None  # Character between cells; None for white space

    @staticmethod
    def of(lines: list[str], name: str) -> "_Block":
        """The lines of numbers of a file, by those columns that most of its lines have."""
        lines = [line for line in lines if line.strip()]
        requirement = "hold lines of numbers in columns, as those of times and levels are"
        require(bool(lines), name, requirement, Unquoted("an empty file"))
        # Nine lines, spread over the file, tell the separator and the columns.
        places = np.unique(np.linspace(0, len(lines) - 1, 9).astype(int))
        sample = [lines[k] for k in places[::-1]]
        separator = _separator(sample)
        rows = [_cells(line, separator) for line in sample]
        numbers = ((row, _numeric(row)) for row in rows)
        patterns = Counter((own, _begins_with_name(row, own[0])) for row, own in numbers if own)
        require(bool(patterns), name, requirement, Unquoted(lines[0]))
        (columns, are_named), _ = patterns.most_common(1)[0]

        def holds(line: str) -> bool:
            row = _cells(line, separator)
            is_setting = not are_named and _begins_with_name(row, columns[0])
            return set(columns) <= set(_numeric(row)) and not is_setting

        stop = next(k for k in range(len(lines), 0, -1) if holds(lines[k - 1]))
        first = next(k for k in range(stop) if all(map(holds, lines[k : min(k + 3, stop)])))
        header = [_heading_cells(line, separator) for line in lines[:first]]
        named = (row for row in header if len(row) > 1)
        ragged = next((row for row in named if len(_numeric(row)) == len(row)), None)
        requirement = "hold as many numbers in each line (decimal commas need another separator)"
        require(ragged is None, name, requirement, Unquoted(",".join(ragged or ())))
        return _Block(header, lines[first:stop], columns, separator)

    def numbers(self, column: int, name: str) -> np.ndarray:
        """The numbers of a column, of a file of a name; shape `(n,)`."""
        has_commas = self.separator != "," or '"' in self.lines[0]
        has_commas = has_commas and any("," in line for line in self.lines)
        try:
            numbers = np.loadtxt(
                self.lines,
                delimiter=self.separator,
                quotechar='"',
                usecols=column,
                converters=(lambda cell: float(cell.replace(",", "."))) if has_commas else None,
                ndmin=1,
            )
        except ValueError:
            numbers = np.array([np.nan])
        if np.all(np.abs(numbers) < _OVERRANGE):
            return numbers
        rows = (line for line in self.lines if not line.lstrip().startswith("#"))
        return np.array([_checked(line, self.separator, column, name) for line in rows])

    def headings(self) -> tuple[list[str], list[str]]:
        """Cells that name the columns, and those below them that hold their units, if any do."""
        rows = (row for row in self.header if not _is_setting(row, self.columns))
        above, below = ([], [], *rows)[-2:]
        is_named = any(_split(cell)[0].casefold() in _TIMES for cell in below)
        is_unit = any(_bare(cell) in _UNITS for cell in below)
        if not is_named and (is_unit or _numeric(below)):
            names, units = above, below
        else:
            names, units = below, []
        # A line of one cell is the last of the settings, above columns without names.
        return (names if sum(map(bool, names)) > 1 else []), units

    def time_by_settings(self, names: Sequence[str], name: str) -> tuple[list[int], np.ndarray]:
        """The column of no level, if there is one, and the times, of a block without units."""
        settings = dict(self.settings())
        unit = next((settings[key][0] for key in _CLOCK_UNITS if settings.get(key)), "")
        own_factor = _UNITS.get(_bare(unit))
        requirement = "have its times in s, ms, us or ns"
        require(own_factor is not None or not unit, name, requirement, Unquoted(unit))
        factor = 1.0 if own_factor is None else own_factor
        interval = _quantity(settings, _INTERVALS, "sample interval", factor, name)
        start = _quantity(settings, _STARTS, "start", factor, name) or 0.0
        clocks = [c for c in self.columns if _split(_at(names, c))[0].casefold() in _TIMES]
        requirement = self.how_to_name_times()
        rows = [",".join(row) for row in self.header[-2:]]
        got = Unquoted(" / ".join(rows) or self.lines[0])
        column = (*clocks, *self.columns)[0]
        is_time = bool(clocks) or (interval is None and len(self.columns) > 1)
        has_times = own_factor is not None and is_time
        require(has_times or interval is not None, name, requirement, got)
        numbers = self.numbers(column, name)
        times = _in_seconds(numbers, factor)
        if has_times or interval is None:
            return [column], times
        step = (numbers[-1] - numbers[0]) / max(numbers.size - 1, 1)
        if len(self.columns) > 1 and abs(step * factor - interval) <= 0.01 * interval:
            return [column], times
        if len(self.columns) > 1 and bool(np.all(np.diff(numbers) == 1)):
            return [column], start + interval * numbers
        return [], start + interval * np.arange(numbers.size)

    def how_to_name_times(self) -> str:
        """The requirement on a file that does not say the times of its levels."""
        if len(self.columns) == 1:
            how = "as `Sample Interval,1e-5 s` above its numbers would"
            return f"give the time from one of its levels to the next, {how}"
        places = dict(zip(self.columns, ("time (s)", "level"), strict=False))
        heading = ",".join(places.get(c, "") for c in range(max(places) + 1))
        how = f"as `{heading}` above its numbers would say"
        return f"name s, ms, us or ns as the unit of a column of times, {how}"

    def settings(self) -> Iterator[tuple[str, list[str]]]:
        """Settings and their values: beside their names, below them, or after `=` in one cell.

        They stand above the block, or beside its first 64 lines.
        """
        first = self.columns[0]
        beside = [_cells(line, self.separator)[:first] for line in self.lines[:64]]
        rows = [row for row in (*self.header, *beside) if row]
        for row in rows:
            yield _key(row[0]), [cell for cell in row[1:] if cell]
            for cell in row:
                for sign in "=:":
                    key, _, value = cell.partition(sign)
                    if value:
                        yield _key(key), [value.strip()]
        for above, below in pairwise(self.header):
            # A line of names holds no number: `Sample Interval 1e-5` is none, in white space.
            for key, value in () if _numeric(above) else zip(above, below, strict=False):
                if _key(key) in (*_INTERVALS, *_STARTS) and _number(value) is not None:
                    yield _key(key), [value]


def read_trace(path: str | Path, *, column: str | None = None) -> Trace:
    """Read a trace from text, as an oscilloscope exports it: numbers in columns under a header.

    Columns are separated by commas, semicolons, tabs or white space; with any but the first,
    decimals may have commas. Digits may be those of any script. The header names a unit of time
    (s, ms, us or ns) for one column, or a sample interval where there is no such column; then time
    counts from the first sample where the header gives no time for that. Lines of settings above,
    and lines without numbers above and below, are ignored.

    Args:
        path: A file in UTF-8, UTF-16 or Latin-1.
        column: Name of the column of levels; by default the only one, or that named `level`.

    Raises:
        ValueError: if the file does not name its columns, a number is missing or out of the
            instrument's range, times fall, or it is a list of transitions.
        OSError: if it cannot be read.
    """
    columns = timed_columns(path)
    block, name, levels = columns.block, columns.name, columns.others
    chosen = _chosen(levels, columns.headings, column, name)
    trace = Trace(columns.time, block.numbers(chosen, name))
    trace.require_ascending(name)
    if len(levels) > 1 and has_two_levels(trace.level):
        rows = (_cells(line, block.separator) for line in block.lines)
        require_samples(np.array([[_at(row, c) for c in levels] for row in rows]), name)
    return trace


class TimedColumns(NamedTuple):
    """Columns of numbers in a file, one of which, or its settings, are their times."""

    name: str  # Name of the file
    block: _Block  # Its lines
    headings: Sequence[str]  # Cells that name its columns
    units: Sequence[str]  # Cells below them that hold their units
    others: Sequence[int]  # Columns of numbers that are no times
    time: Float[np.ndarray, "n"]  # s

    @property
    def names(self) -> list[str]:
        """Names of the other columns without their units, case-folded."""
        return [_place_of(_at(self.headings, column))[0] for column in self.others]

    def numbers(self, name: str) -> Float[np.ndarray, "n"]:
        """The numbers of a column."""
        return self.block.numbers(self._column(name), self.name)

    def unit(self, name: str) -> str:
        """The unit of a column of places, by the line below the headings or by its heading."""
        column = self._column(name)
        return _bare(_at(self.units, column)) or _place_of(_at(self.headings, column))[1]

    def _column(self, name: str) -> int:
        return self.others[self.names.index(name)]


def _place_of(heading: str) -> tuple[str, str]:
    """Name and unit of a heading such as `x (um)` or `stage_x_um`, case-folded."""
    heading = heading.strip().casefold()
    name, _, last = heading.rpartition("_")
    if heading.endswith((")", "]")):  # of any unit, such as counts
        own, unit = _split(heading)
        return own.strip(), _bare(unit)
    for own, unit in (_split(heading), (name, last)):
        if _bare(unit) in ("px", *METRES, *_ENCODERS):
            return own.strip(), _bare(unit)
    return heading, ""


def timed_columns(path: str | Path) -> TimedColumns:
    """The columns of a file beside its times, as `read_trace` reads them."""
    name = str(path)
    block = _Block.of(text_of(contents(path), name).splitlines(), name)
    names, units = block.headings()
    factors = {c: _factor(_at(units, c), _at(names, c)) for c in block.columns}
    clocks = [c for c, factor in factors.items() if factor is not None]
    if clocks:
        factor = factors[clocks[0]]
        time = _in_seconds(block.numbers(clocks[0], name), factor or 1.0)
    else:
        clocks, time = block.time_by_settings(names, name)
    others = [c for c in block.columns if c not in clocks]
    unnamed = [c for c in others if names and not _at(names, c)]
    requirement = "have a name above each column of numbers (decimal commas need another separator)"
    require(not unnamed, name, requirement, Unquoted(block.lines[0]))
    return TimedColumns(name, block, names, units, others, time)


def _in_seconds(numbers: np.ndarray, factor: float) -> np.ndarray:
    # Divides by the reciprocal where that is whole: 1e-3 is not exact, 1000 is.
    return numbers / round(1 / factor)


def _at(cells: Sequence[str], column: int) -> str:
    return cells[column] if column < len(cells) else ""


def _begins_with_name(row: Sequence[str], column: int) -> bool:
    """Whether the number in a column is the value of a name before it, as in `"Probe",5`.

    A setting beside a sample has its own value before the sample, or nothing directly before it.
    """
    before = row[:column]
    # A cell with a letter that is no time of day: `%Probe`, `1st probe`.
    name = r"\D*[^\W\d_]|\d[^:]*[^\W\d_][^:]*$"
    return bool(before) and re.match(name, before[-1]) is not None and not _numeric(before)


def _separator(sample: Sequence[str]) -> str | None:
    """The separator with which most lines are of numbers alone."""
    often = [s for s in "\t;," if 2 * sum(s in line for line in sample) > len(sample)]

    def count(separator: str | None) -> int:
        rows = [[c for c in _cells(line, separator) if c] for line in sample]
        return sum(bool(row) and len(_numeric(row)) == len(row) for row in rows)

    return max([*often, None], key=count)


def _heading_cells(line: str, separator: str | None) -> list[str]:
    """Cells of a line above the numbers, which may have a separator that the numbers have not."""
    if separator is None or separator not in line:
        others = "\t;," if separator else "\t;,:="
        separator = next((s for s in others if s in line), None)
    return [cell.lstrip("#% ") for cell in _cells(line, separator)]


def _cells(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return re.sub(r"\s+(?=[(\[])", "", line).split()
    try:
        row = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except csv.Error:  # a cell of 128 KiB or more, which is no number
        row = [line]
    return [cell.strip() for cell in row]


def _numeric(cells: Sequence[str]) -> tuple[int, ...]:
    """Places of the cells that are numbers."""
    return tuple(k for k, cell in enumerate(cells) if _number(cell) is not None)


def _number(cell: str) -> float | None:
    """The number in a cell, in the digits of any script."""
    text = cell.strip()
    text = text if text.isascii() else text.translate(_SIGNS)
    try:
        return float(text if "." in text else text.replace(",", "."))
    except ValueError:
        return None


def _checked(line: str, separator: str | None, column: int, name: str) -> float:
    """The number of a line, which is refused where it is no number or stands for none.

    This is slower than NumPy's reader, which knows neither all digits nor which line it refuses.
    """
    number = _number(_at(_cells(line, separator), column))
    requirement = "hold numbers alone from the first row of them to the last"
    require(number is not None, name, requirement, Unquoted(line))
    requirement = (
        f"hold finite numbers below {_OVERRANGE:g}, others being an instrument's sign for a "
        "signal out of its range"
    )
    value = float(number or 0.0)
    require(abs(value) < _OVERRANGE, name, requirement, Unquoted(line))
    return value


# The headings and settings beside the block


def _is_setting(row: Sequence[str], columns: Sequence[int]) -> bool:
    """Whether a line above the numbers names no columns.

    It begins beside the columns and has numbers or nothing above some, as `"Probe",5` does, or
    gives the unit or the steps of time, as `"HUnit","s"` does.
    """
    cells = [_at(row, column) for column in columns]
    is_beside = any(row[: columns[0]]) and not all(c and _number(c) is None for c in cells)
    has_value = any(_bare(cell) in _UNITS or _number(cell) is not None for cell in row[1:])
    is_of_time = has_value and _key(row[0]) in (*_CLOCK_UNITS, *_INTERVALS, *_STARTS)
    return is_beside or is_of_time


def _split(heading: str) -> tuple[str, str]:
    """Name and unit of a heading such as `time (s)`, `Time(s)`, `in s`, `time/ms` or `time_us`."""
    pattern = r"(.*?)[\s_]*(?:[(\[]([^)\]]*)[)\]]|\bin\s+(\S+)|/\s*(\S+)|_(\w+))"
    match = re.fullmatch(pattern, heading.strip())
    if match is None:
        return heading.strip(), ""
    name, *units = match.groups()
    return name, next(unit.strip() for unit in units if unit is not None)


def _bare(unit: str) -> str:
    return unit.strip("()[]\"' ").casefold()


def _factor(unit: str, heading: str) -> float | None:
    """Seconds in the unit of a column, by the cell of units or the heading; None for another.

    `time/s` is a time in s, and `Counts/s` a rate.
    """
    name, own_unit = _split(heading)
    is_quotient = heading.replace(" ", "").endswith(f"/{own_unit}")
    is_rate = is_quotient and name.casefold() not in _TIMES
    return _UNITS.get(_bare(unit), None if is_rate else _UNITS.get(_bare(own_unit)))


def _chosen(levels: Sequence[int], names: Sequence[str], column: str | None, name: str) -> int:
    """The column of levels."""
    got = Unquoted("none: the times at which a shutter moves are no trace")
    require(bool(levels), name, "have a column of levels beside the times", got)
    got = Unquoted(", ".join(_at(names, c) or "one without a name" for c in levels))
    if column is None:
        alone = levels if len(levels) == 1 else _of_name(levels, names, "level")
        own_names = {_at(names, c).casefold() for c in levels} - {""}
        if len(own_names) < len(levels):
            requirement = "have one column of levels, or a line of their names above its numbers"
        else:
            requirement = (
                "have one column of levels, or be read with the name of one as its `column` or "
                "`--measured-column`"
            )
    else:
        alone = _of_name(levels, names, column)
        requirement = f"have one column of levels of the name {column}"
    require(len(alone) == 1, name, requirement, got)
    return alone[0]


def _of_name(columns: Sequence[int], names: Sequence[str], name: str) -> list[int]:
    folded = name.strip().casefold()
    texts = {c: (_at(names, c), _split(_at(names, c))[0]) for c in columns}
    return [c for c, each in texts.items() if folded in [text.casefold() for text in each]]


def _key(text: str) -> str:
    """Letters and digits of a name: `Sample Interval`, `sample_interval` and `SampleInterval`."""
    return re.sub(r"[\W_]+", "", text.casefold())


def _quantity(
    settings: dict[str, list[str]], keys: Sequence[str], noun: str, factor: float, name: str
) -> float | None:
    """A time among the settings, in its own unit or, without one, in that of the clock; s."""
    # A number and its unit, perhaps behind the name of a source, as in `Analog:1.2E-05`.
    pattern = r"(?:[a-z]\w*:)?\s*([-+]?[\d.,]+(?:e[-+]?\d+)?)\s*([^\W\d]*)"
    for key in keys:
        first, *others = settings.get(key) or [""]
        match = re.fullmatch(pattern, first, re.IGNORECASE)
        number = None if match is None else _number(match[1])
        if match is None or number is None:
            continue
        got = Unquoted(",".join([first, *others]))
        is_one = all(_number(other) in (None, number) for other in others)
        require(is_one, name, f"have one {noun} for all of its columns", got)
        unit = match[2] or next((text for text in others[:1] if _number(text) is None), "")
        is_known = not unit or _bare(unit) in _UNITS
        require(is_known, name, f"have its {noun} in s, ms, us or ns", got)
        return number * (_UNITS[_bare(unit)] if unit else factor)
    return None
