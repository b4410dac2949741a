"""Every command of the program is run to its end, in the form that its page or its help shows."""

import re
import shlex
import signal
import subprocess
import sys
import urllib.request

import numpy as np
import pytest
from support.clips import ClipOf, Thing
from support.command_line import SMALL_SCENE, environment
from support.drive import a_design
from support.laboratory import COMMAND
from typer.main import get_command

from mishutter import cli, example_picture
from mishutter.cli.app import app
from mishutter.pictures.images import write_picture

COMMANDS = {
    "example": ("example", "[speeds]", ()),
    "compare": ("compare still.toml --design camera.json --noise-seeds 0", "dB", ()),
    "sweep": (
        "sweep still.toml --acceleration 1e3:9e3:2 --half-exposure 3:5:2 --shutter hann --out maps",
        "Best points",
        ("maps/map.png",),
    ),
    "plan": ("plan still.toml", "px", ()),
    "simulate": (
        "simulate --design camera.json --subject photo.png --speed 310 --out shot",
        "PSNR",
        ("shot/captured.png", "shot/restored.png"),
    ),
    "restore": (
        "restore photo.png --design camera.json --out restored",
        "restored.png",
        ("restored/restored.png", "restored/side_by_side.png"),
    ),
    "export": (
        "export camera.json --levels 16 --steps 8 --out drive",
        "16 levels",
        ("drive/drive.csv", "drive/stage.csv"),
    ),
    "measure": (
        "measure clip.npy --frames-per-s 50 --exposure-ms 4 --white 4095 --out found.toml",
        "mishutter optimise",
        ("found.toml", "noise.png", "motion.png"),
    ),
}
"""What is typed, a word of what it says, and the files that it writes."""
ELSEWHERE = {"optimise": "test_app.py", "fit": "test_fit.py", "reproduce": "../paper"}
"""Those that tests of their numbers run to the end."""


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder with a scene in which nothing moves, a photograph, a clip and a design."""
    place = tmp_path_factory.mktemp("desk")
    speeds, others = SMALL_SCENE.split("[light]")
    assert "list_px_per_s" in speeds
    (place / "still.toml").write_text(f"[speeds]\nlist_px_per_s = [0]\n[light]{others}")
    write_picture(place / "photo.png", example_picture().light[100:109, :150])
    things = (Thing((61, 75), (21, 27), (5.0, 170.0)),)
    clip = ClipOf(things, size=(128, 160), background="coins.png", num_frames=4)
    np.save(place / "clip.npy", clip.levels())
    a_design(COMMAND).save(place / "camera.json")
    return place


def test_every_command_is_among_them():
    """One that is missing is one that may end in a traceback unseen."""
    assert {*COMMANDS, *ELSEWHERE, "explore"} == set(get_command(app).commands)


@pytest.mark.parametrize("name", COMMANDS)
def test_it_runs_to_its_end(name, desk, monkeypatch, capsys):
    """It ends with 0, says what it found, and writes its files."""
    line, word, files = COMMANDS[name]
    monkeypatch.chdir(desk)
    assert cli.main(shlex.split(line)) == 0
    assert word in "".join(capsys.readouterr())
    assert [file for file in files if not (desk / file).is_file()] == []


def test_explore_starts_answers_and_stops(desk):
    """It says where its page is, which is served, and an interrupt ends it without a traceback."""
    command = [sys.executable, "-m", "mishutter", "explore", "still.toml", "--no-browser"]
    with subprocess.Popen(
        command,
        cwd=desk,
        env=environment(),
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        address = process.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", address)
        with urllib.request.urlopen(address) as page:
            assert page.status == 200
            assert b"mishutter" in page.read()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate()
    assert process.returncode == 130
    assert "Traceback" not in errors
