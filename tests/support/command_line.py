"""The command line as tests run it."""

import os
import re
import sys
from pathlib import Path

import mishutter
from mishutter import cli

SMALL_SCENE = """
[speeds]
list_px_per_s = [0, 310, -190]
weights = [0.4, 0.35, 0.25]
[light]
photon_rate_per_s = 2.3e5
[sensor]
read_noise_e = 4.7
[limits]
max_stroke_px = 7.3
max_top_speed_px_per_s = 1300
min_half_exposure_ms = 2.1
max_half_exposure_ms = 17
[motion]
half_exposure_ms = 13
stroke_px = 6.1
[picture]
path = "photo.png"
"""


_SIGN_OF_LIFE = re.compile(r"[a-z ]+( \.\.\.|: (.+, )?\d+ of \d+ after \d+ s.*)")

SMALL_SEARCH = ["--starts", "2", "--steps", "3", "--coefficients", "6", "--noise-seeds", "1"]


def environment(**others):
    """The environment of a process that finds the package under test."""
    path = os.pathsep.join([str(Path(mishutter.__file__).parent.parent), *sys.path])
    return os.environ | {"PYTHONPATH": path} | others


def refused(capsys, *arguments):
    """The one line that a refused command writes, beside signs of life."""
    code = cli.main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    assert code == 2
    assert out == ""
    lines = messages(err)
    assert len(lines) == 1, err
    assert re.fullmatch(r"mishutter: error: .+; got.*", lines[0])
    return lines[0]


def messages(errors):
    """Lines on standard error other than signs of life, which come where a machine is slow."""
    return [line for line in errors.splitlines() if not _SIGN_OF_LIFE.fullmatch(line)]


def no_constant(token):
    raise ValueError(f"{token} is no JSON")
