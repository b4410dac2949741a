"""What a terminal shows.

Pinned by what a reader needs, every number whole and every name as it is, however narrow
the terminal and whatever its encoding.
"""

import io
import re
import signal
import sys
import time
import warnings

import pytest

# The face is `main` alone, and no command prints names and widths as awkward as these.
from mishutter.cli.console import (
    doubts_as_notes,
    ends_when_asked,
    error_line,
    print_table,
    take_any_text,
    write_error,
)
from mishutter.hardware.drive_files import DriveWarning
from mishutter.pictures.images import PictureWarning

COLUMNS = ("shutter", "PSNR dB", "snapshot +dB", "kernel diff", "relative", "light", "open ms")
ROWS = [
    ["[red]:bow: x[/]", "26.87", "+1.55", "0.0023", "0.117", "0.757", "18.31"],
    ["best snapshot", "25.32", "+0.00", "0.2584", "0.775", "1.000", "1.68"],
]


class Terminal(io.StringIO):
    """Standard output of someone who watches."""

    def isatty(self):
        return True


@pytest.mark.parametrize(
    ("argument", "shown"),
    [
        ("Limits(max_jerk=...)", "[limits] max_jerk_px_per_s3"),
        ("Sensor(full_well=...)", "[sensor] full_well_e"),
        ("Optics(cutoff_frequency=...)", "[optics] cutoff_cycles_per_px"),
        ("BurstMode(max_frames=...)", "[burst] max_frames"),
        # A key in ms would stand beside a number in s.
        ("BurstMode(window=...)", "window"),
        ("stage_path(max_jerk=...)", "max_jerk"),
    ],
)
def test_a_number_of_a_scene_is_named_by_its_key(argument, shown):
    """What a search refuses long after the file was read is still found in the file."""
    line = error_line(ValueError(f"`{argument}` must be at most 2; got 3."))
    assert line == f"`{shown}` must be at most 2; got 3"


@pytest.mark.parametrize("width", [20, 44, 60, 80, 132])
def test_no_number_is_cut(width, monkeypatch):
    """Columns that a terminal has no room for go on below; names hold no markup."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("TERM", "dumb")
    print_table("Own best motion", COLUMNS, ROWS)
    text = terminal.getvalue()
    assert text.count("Own best motion") == 1
    for name, *numbers in ROWS:
        found = [line for line in text.splitlines() if line.strip().startswith(name)]
        assert " ".join(line.replace(name, "") for line in found).split() == numbers
    if width >= 44:
        assert max(map(len, text.splitlines())) <= width


def test_a_long_text_is_broken(monkeypatch):
    """A first column that is wider than the terminal has its lines broken, none of it lost."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setenv("COLUMNS", "60")
    monkeypatch.setenv("TERM", "dumb")
    claim = "Hann gains 3 to 8 dB over rect by thirty iterations on every photograph"
    print_table("Published statements", ["statement", ""], [[claim, "not met"]])
    words = re.findall(r"\w+", terminal.getvalue())
    assert sorted(words) == sorted(
        re.findall(r"\w+", f"Published statements statement {claim} not met")
    )


def test_letters_that_an_encoding_lacks(monkeypatch):
    """They are replaced; the rest of the result is not lost with them."""
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="ascii"))
    take_any_text()
    print_table("Best points", ["best", "a px/s²"], [["café", "1e+05"]])
    sys.stdout.flush()
    assert b"caf?" in raw.getvalue()
    assert b"px/s?" in raw.getvalue()
    assert b"1e+05" in raw.getvalue()


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # open until the process ends
def test_closed_streams(monkeypatch):
    """A result that nobody reads, and an error that nobody sees, are no bug."""
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    take_any_text()
    print_table("Best points", ["best", "loss"], [["rect", "0.2318"]])
    write_error("nobody sees it")


class Sending:
    """A signal comes while this is taken away."""

    def __init__(self, number):
        self.number = number

    def __del__(self):
        signal.raise_signal(self.number)


def work_after(garbage):
    """Much longer than the moment after which a signal comes again."""
    del garbage
    time.sleep(20)


@pytest.mark.parametrize(
    ("number", "raised"),
    [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)],
    ids=["interrupt", "termination"],
)
def test_a_signal_among_garbage_is_not_lost(number, raised):
    """It ends what is under way a moment later, and prints nothing."""
    with pytest.raises(raised), ends_when_asked():
        work_after(Sending(number))


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("kind", [PictureWarning, DriveWarning])
def test_a_doubt_about_a_file_is_one_note(kind, capsys):
    """Warnings of the package are lines without a place in its code, each once; others stay."""
    with doubts_as_notes():
        for sentence in ("a.csv: it may be meant otherwise", "b.csv: so may this") * 2:
            warnings.warn(sentence, kind, stacklevel=1)
    said = "a.csv: it may be meant otherwise\nb.csv: so may this\n"
    assert capsys.readouterr().err == said
    with pytest.warns(UserWarning, match="of another"), doubts_as_notes():
        warnings.warn("of another", UserWarning, stacklevel=1)
    assert capsys.readouterr().err == ""
