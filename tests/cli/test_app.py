"""The command line: every mistake is one line and exit code 2; results are whole.

Mistakes are made in-process, where they are quick, and a few in a process of their own, to
see that nothing else reaches the terminal.
"""

import contextlib
import io
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from importlib.metadata import version
from platform import python_version

import equinox as eqx
import jax
import numpy as np
import pytest
from PIL import Image
from support.bad_scenes import LINES, edited
from support.command_line import (
    SMALL_SCENE,
    SMALL_SEARCH,
    environment,
    messages,
    no_constant,
    refused,
)
from support.drive import a_design

from mishutter import (
    HannShutter,
    cli,
    example_scene,
    read_scene,
)
from mishutter._core.progress import working
from mishutter.cli.options import as_design

# The face is `main` alone, which never waits long enough without a bar to say so.
from mishutter.design.design import Design
from mishutter.model.shutters import kinds
from mishutter.pictures.images import write_picture

STILL_SCENE = f"[speeds]\nlist_px_per_s = [0]\n[light]{SMALL_SCENE.partition('[light]')[2]}"


@pytest.fixture(scope="module")
def still_scene(small_scene):
    """The same scene in which nothing moves, for which half is compiled."""
    path = small_scene.with_name("still.toml")
    path.write_text(STILL_SCENE)
    return path


@pytest.fixture(scope="module")
def small_scene(tmp_path_factory):
    """A scene file with a photograph, small enough to be designed for in a test."""
    folder = tmp_path_factory.mktemp("scene")
    rows = np.random.default_rng(5).normal(size=(9, 150)).cumsum(axis=1)
    write_picture(folder / "photo.png", 0.5 + 0.4 * np.sin(rows / 3))
    path = folder / "scene.toml"
    path.write_text(SMALL_SCENE)
    return path


@pytest.mark.parametrize("slug", [*LINES][::29])
def test_scene_mistakes(slug, tmp_path, capsys):
    """Mistakes in a scene file, of which its own tests hold all, reach the terminal as a line."""
    start, replacement, message = LINES[slug]
    path = tmp_path / "scene.toml"
    path.write_text(edited(start, replacement))
    assert message in refused(capsys, "compare", path)


USAGE = {
    "unknown-command": (["desing"], "must be one of those of --help; got 'desing'"),
    "unknown-option": (
        ["optimise", "--oput", "x"],
        "every option must be one of those of --help, perhaps `--out`; got '--oput'",
    ),
    "option-like-a-former-one": (
        ["sweep", "--accelerations", "1e4:1e5:2"],
        "perhaps `--stage-acceleration`; got '--accelerations'",
    ),
    "option-of-no-likeness": (["--bad"], "must be one of those of --help; got '--bad'"),
    "option-without-value": (
        ["optimise", "--out"],
        "`--out` must be followed by a value; got nothing",
    ),
    "switch-with-value": (["plan", "--json=1"], "`--json` must stand alone; got a value"),
    "no-design": (["export"], "`DESIGN.json` must be given; got nothing"),
    "two-scenes": (
        ["optimise", "a.toml", "b.toml"],
        "there must be no further argument; got: unexpected extra argument(s) (b.toml)",
    ),
    "starts-as-text": (
        ["optimise", "--starts", "few"],
        "`--starts` must be a whole number; got 'few'",
    ),
    "no-starts": (["optimise", "--starts", "0"], "`--starts` must be at least 1; got '0'"),
    "no-steps": (["optimise", "--steps=0"], "`--steps` must be at least 1; got '0'"),
    "few-coefficients": (
        ["optimise", "--coefficients", "3"],
        "`--coefficients` must be at least 4; got '3'",
    ),
    "many-levels": (
        ["export", "--levels", "16777217"],
        "`--levels` must be at most 16777216; got '16777217'",
    ),
    "negative-seed": (["optimise", "--seed", "-1"], "`--seed` must be at least 0; got '-1'"),
    "speed-as-text": (["simulate", "--speed", "x"], "`--speed` must be a number of px/s, or"),
    "unknown-loss": (
        ["optimise", "--loss", "beauty"],
        "'known-speed', 'found-speed', 'worst-speed', 'design'; got 'beauty'",
    ),
    "loss-of-no-search": (
        ["sweep", "--loss", "worst-speed"],
        "`--loss` must stand beside --optimise; got 'worst-speed' alone",
    ),
    "unknown-freedom": (
        ["optimise", "--free", "price"],
        "`--free` must be one of 'shutter', 'acceleration', 'half_exposure', 'velocity', 'path'; "
        "got 'price'",
    ),
    "missing-scene": (["optimise", "no.toml"], "must exist; got: file not found"),
    "scene-a-folder": (["optimise", "/"], "'/' must be accessible; got: "),
    "shutter-unknown": (["compare", "--shutter", "hamming"], "must be one of rect, hann, "),
    "shutter-value": (["compare", "--shutter", "tukey:wide"], "must have a finite number after"),
    "shutter-nan": (["compare", "--shutter", "tukey:nan"], "must have a finite number after"),
    "shutter-range": (["compare", "--shutter", "tukey:1.5"], "error: `taper` must"),
    "shutter-no-value": (["compare", "--shutter", "hann:0.5"], "must give hann no parameter"),
    "missing-design": (["compare", "--design", "no.json"], "must exist; got: file not found"),
    "out-unnamed": (["optimise", "--out", ""], "`--out` must be a path of at least one character"),
    "scene-unnamed": (["plan", ""], "`SCENE.toml` must be a path of at least one character; got"),
    "free-and-fixed": (
        ["plan", "--fixed", "--free", "shutter"],
        "`--free` must be left out with --fixed; got 'shutter'",
    ),
    "out-under-nothing": (["compare", "--out", "/dev/null/x"], "must be a writable folder"),
}


@pytest.mark.parametrize("slug", USAGE)
def test_usage_mistakes(slug, capsys):
    """A mistake on the command line is answered in the same form."""
    arguments, message = USAGE[slug]
    assert message in refused(capsys, *arguments)


DESIGNS = {
    "empty": ("", "must be a JSON file; got: "),
    "cut-short": ('{"format": 1, "mishutter": ', "must be a JSON file; got: "),
    "a-list": ("[1, 2]", "must be a design saved by mishutter; got"),
    "another-file": ('{"name": "x"}', "must be a design saved by mishutter; got"),
    "another-version": ('{"format": 99}', "must be of design format 2; got"),
    "incomplete": ('{"format": 2}', "design.json: `scene` must be given; got nothing"),
    "brackets-without-end": ("[" * 100_000, "must be a JSON file; got: brackets nested too"),
    "digits-without-end": ('{"format": 1' + "0" * 5000 + "}", "must be a JSON file; got: Exceeds"),
}


@pytest.mark.parametrize("slug", DESIGNS)
def test_design_mistakes(slug, tmp_path, capsys):
    """A file that is no design, or one of another version, is refused by what it lacks."""
    text, message = DESIGNS[slug]
    path = tmp_path / "design.json"
    path.write_text(text)
    assert message in refused(capsys, "compare", "--design", path)


def one_pixel(path):
    Image.new("L", (1, 1), 128).save(path)


def narrow(path):
    Image.new("L", (3, 300), 128).save(path)


PICTURES = {
    "one-pixel": ("photo.png", one_pixel, "must have rows of at least 8 px; got"),
    "narrow": ("photo.png", narrow, "must have rows of at least 8 px; got"),
}


@pytest.mark.parametrize("slug", PICTURES)
def test_picture_mistakes(slug, tmp_path, capsys):
    """A photograph that cannot be used is refused before anything is computed."""
    name, write, message = PICTURES[slug]
    write(tmp_path / name)
    path = tmp_path / "scene.toml"
    path.write_text(edited("path", f'path = "{name}"'))
    assert message in refused(capsys, "optimise", path)


def test_the_output_folder_is_tried_before_the_search(tmp_path, capsys, monkeypatch):
    """A folder that takes no files is refused before anything is computed."""
    place = tmp_path / "file"
    place.write_text("in the way")
    # Its first step fails if it begins.
    monkeypatch.setattr("mishutter.search.planning.plan", None)
    line = refused(capsys, "optimise", "--out", place)
    assert "`--out` must be a writable folder; got" in line


@pytest.mark.parametrize(
    "command",
    [
        ["optimise", "no.toml"],
        ["optimise", "/"],
        ["compare", "no.toml"],
        ["compare", "--design", "no.json"],
        ["simulate", "no.toml"],
        ["simulate", "--subject", "no.png"],
        ["export", "no.json"],
    ],
    ids=" ".join,
)
def test_no_folder_is_made_for_what_cannot_be_read(command, tmp_path, capsys):
    """Nothing is left behind where the input is missing."""
    refused(capsys, *command, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("place", "arguments", "told"),
    [
        ("search.bursts.shown_bursts", ["optimise"], "the same command starts again"),
        ("report.comparison.compare", ["compare"], "the same command starts again"),
        (
            "decoding.restoration.capture_and_restore",
            ["simulate", "--out", "x"],
            "the same command starts",
        ),
        (
            "paper.reproduction.reproduce",
            ["reproduce", "--out", "x"],
            "the same command starts again",
        ),
        (
            "sweeps.run.sweep",
            ["sweep"],
            "with --store PATH a sweep goes on where it was interrupted",
        ),
        (
            "sweeps.run.sweep",
            ["sweep", "--store", "s.zarr"],
            "no result was saved; the same command starts again",
        ),
        (
            "sweeps.run.sweep",
            ["sweep", "--store", "begun"],
            "144 of 400 points are saved in begun; the same command goes on",
        ),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else "",
)
def test_an_interrupt_says_what_was_kept_and_how_to_go_on(
    place, arguments, told, monkeypatch, capsys, tmp_path
):
    """One line, whatever was under way."""

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    (tmp_path / "begun").mkdir()
    monkeypatch.setattr("mishutter.sweeps.store.saved_points", lambda path: (144, 400))
    # A signal would have to come while it runs, at a time that depends on the machine.
    monkeypatch.setattr(f"mishutter.{place}", interrupt)
    assert cli.main(arguments) == 130
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = messages(err)
    assert re.fullmatch(rf"mishutter: interrupted: .*{re.escape(told)}.*", line)


@pytest.mark.slow
def test_an_interrupt_after_the_search_keeps_the_design(still_scene, monkeypatch, capsys, tmp_path):
    """What took longest is in the folder, and the line holds the command that goes on from it."""
    compared = []

    def interrupt(_, motion, entries, *others, **judged):
        compared.append((motion, entries))
        raise KeyboardInterrupt

    # A signal would have to come between two steps of the command.
    monkeypatch.setattr("mishutter.cli.app._compared", interrupt)
    out = tmp_path / "a folder"
    arguments = ["optimise", str(still_scene), "--out", str(out), *SMALL_SEARCH]
    assert cli.main(arguments) == 130
    told = capsys.readouterr().err
    command = shlex.split(told.split("`")[1])
    assert command[:3] == ["mishutter", "compare", str(still_scene)]
    assert cli.main(command[1:]) == 130
    (motion, found), (again, read) = compared
    assert eqx.tree_equal(again, motion)
    assert eqx.tree_equal(read["one_exposure"].shutter, found["optimised"].shutter)


def test_a_termination_is_143(monkeypatch):
    """SIGTERM unwinds a command, which takes away what it has begun to write."""

    def terminated(*_, **__):
        os.kill(os.getpid(), signal.SIGTERM)
        raise AssertionError

    # The first step of a command is where the signal comes.
    monkeypatch.setattr("mishutter.model.scene.example_scene", terminated)
    with pytest.raises(SystemExit, match="143"):
        cli.main(["compare"])
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_a_bug_shows_itself(monkeypatch):
    """What is no mistake of the user's keeps its traceback."""

    def fail(*_, **__):
        raise TypeError("a bug")

    # No command has a known bug.
    monkeypatch.setattr("mishutter.model.scene.example_scene", fail)
    with pytest.raises(TypeError, match="a bug"):
        cli.main(["compare"])


@contextlib.contextmanager
def unread():
    """The end of a pipe to write to, whose reader has left."""
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as stream:
        yield stream


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["example"], ["compare", "-h"]])
def test_a_reader_that_leaves_is_no_failure(arguments, monkeypatch):
    """The parser's text, a table's and plain text alike end with 0, and nothing is left to say."""
    with unread() as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        assert cli.main(arguments) == 0
        stream.flush()


def test_an_error_that_nobody_reads_is_2(monkeypatch):
    """Where standard error goes into the same pipe."""
    with unread() as stream:
        for name in ("stdout", "stderr"):
            monkeypatch.setattr(sys, name, stream)
        assert cli.main(["optimise", "no.toml"]) == 2


@pytest.mark.slow
def test_a_process_whose_reader_leaves_says_nothing_of_it():
    """`mishutter example | head -1` ends with 0, and its end does not complain of the pipe."""
    command = [sys.executable, "-m", "mishutter", "example"]
    with unread() as stream:
        done = subprocess.run(
            command, stdout=stream, stderr=subprocess.PIPE, env=environment(), check=False
        )
    assert done.returncode == 0
    assert done.stderr == b""


def test_a_design_whose_reader_leaves_is_kept(still_scene, tmp_path, monkeypatch):
    """`mishutter optimise --out DIR 2>&1 | head -1` ends with 0 and all files."""
    options = [str(still_scene), *SMALL_SEARCH, "--out", str(tmp_path / "kept")]
    with unread() as stream:
        for name in ("stdout", "stderr"):
            monkeypatch.setattr(sys, name, stream)
        assert cli.main(["optimise", *options]) == 0
    assert {file.name for file in (tmp_path / "kept").iterdir()} > {
        "recommended.json",
        "answer.png",
    }


@pytest.mark.slow
def test_nothing_else_reaches_the_terminal():
    """A process of its own writes one line on standard error and nothing on output."""
    command = [sys.executable, "-m", "mishutter", "optimise", "no.toml"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment(), check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = messages(done.stderr)
    assert line.startswith("mishutter: error: ")


@pytest.mark.slow
def test_without_a_cache_folder(small_scene, tmp_path):
    """Where the user's cache folder takes no files, nothing is kept and nothing said of it."""
    (tmp_path / "file").write_text("in the way")
    command = [sys.executable, "-m", "mishutter", "plan", str(small_scene), "--json"]
    elsewhere = environment(XDG_CACHE_HOME=str(tmp_path / "file"))
    done = subprocess.run(command, capture_output=True, text=True, env=elsewhere, check=False)
    assert done.returncode == 0
    assert not messages(done.stderr)
    assert "num_taps" in json.loads(done.stdout)


@pytest.mark.slow
def test_programs_are_found_again(still_scene, tmp_path):
    """In the user's cache folder or where the user says, without a word; when cut, made anew."""
    command = [sys.executable, "-m", "mishutter", "plan", str(still_scene), "--json"]
    own, chosen = tmp_path / "own", tmp_path / "chosen"
    others = {"XDG_CACHE_HOME": str(own), "TF_CPP_MIN_LOG_LEVEL": "1"}  # as JAX chooses
    variables = environment(JAX_COMPILATION_CACHE_DIR=str(chosen), **others)

    def kept(variables, folder):
        done = subprocess.run(command, capture_output=True, text=True, env=variables, check=True)
        assert not messages(done.stderr)
        found = sorted(path.name for path in folder.rglob("*-cache"))
        assert found == sorted(path.name for path in tmp_path.rglob("*-cache"))
        return found

    assert kept(variables, chosen)
    shutil.rmtree(chosen)
    del variables["JAX_COMPILATION_CACHE_DIR"]
    found = []
    for _ in range(2):
        found.append(kept(variables, own / "mishutter" / "jax"))
        for path in own.rglob("*-cache"):
            assert path.stat().st_size > 99
            path.write_bytes(path.read_bytes()[:99])
    assert found[0] == found[1] != []


COMMANDS = ("example", "optimise", "compare", "plan", "simulate", "sweep", "reproduce", "export")


def test_the_version_is_shown(capsys):
    """`--version` says which one is installed, and the versions of what computes."""
    assert cli.main(["--version"]) == 0
    names = ", ".join(f"{name} {version(name)}" for name in ("mishutter", "jax", "jaxlib"))
    assert capsys.readouterr().out == f"{names}, Python {python_version()}\n"


@pytest.mark.parametrize("command", ["optimise", "compare", "simulate", "sweep", "plan", "fit"])
def test_help_lists_options_by_what_they_are_for(command, capsys):
    """No option but `--help` is without a group; commands stand in groups too."""
    assert cli.main([command, "--help"]) == 0
    shown = capsys.readouterr().out
    ungrouped = shown.partition("\nOptions:\n")[2].split()
    assert [word for word in ungrouped if word.startswith("--")] == ["--help"]
    assert cli.main(["--help"]) == 0
    groups = re.findall(r"^(\w+):$", capsys.readouterr().out, re.MULTILINE)
    assert groups == ["Options", "Begin", "Design", "See", "Build"]


def test_help_names_arguments_as_a_reader_writes_them(capsys):
    """One that may be left out is in one pair of brackets; none has the name of a Python type."""
    usages = {"plan": "[SCENE.toml]", "restore": "{CAPTURE}...", "export": "{DESIGN.json}"}
    for command, argument in {**usages, "explore": "[SCENE.toml]"}.items():
        assert cli.main([command, "--help"]) == 0
        shown = capsys.readouterr().out
        assert shown.startswith(f"Usage: mishutter {command} [OPTIONS] {argument}\n")
        assert "<" not in shown.replace("<=", "")


@pytest.mark.parametrize(
    ("words", "found"),
    [("mishutter opt", "optimise"), ("mishutter optimise --loss w", "worst-speed")],
)
def test_a_shell_completes_commands_and_values(words, found, monkeypatch, capsys):
    """As bash asks for it; names of losses among them."""
    monkeypatch.setenv("_MISHUTTER_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    with pytest.raises(SystemExit, match="0"):
        cli.main([])
    assert capsys.readouterr().out.split() == [found]


def test_help_names_every_command(capsys):
    """`--help` lists the commands; so does nothing."""
    shown = []
    for asked in (["--help"], []):
        assert cli.main(asked) == 0
        shown.append(capsys.readouterr().out)
    assert all(name in shown[0] for name in COMMANDS)
    assert shown[0] == shown[1]


def test_the_nearest_command_is_named(capsys):
    """Where a word is spelled as others spell it."""
    assert cli.main(["optimize"]) == 2
    line = "the command must be one of those of --help, perhaps `optimise`; got 'optimize'"
    assert capsys.readouterr().err == f"mishutter: error: {line}\n"


def test_the_example_is_a_scene(capsys, tmp_path):
    """The one that is used where none is given."""
    assert cli.main(["example"]) == 0
    path = tmp_path / "mine.toml"
    path.write_text(capsys.readouterr().out)
    written, built_in = read_scene(path), example_scene()
    assert eqx.tree_equal(written, built_in)


@pytest.fixture(scope="module")
def optimised(small_scene, tmp_path_factory):
    """Output folder and standard output of one small search with `--json`.

    `jax_debug_nans` would end it with an operation that makes a NaN.
    """
    folder = tmp_path_factory.mktemp("out") / "made" / "here"
    command = ["optimise", str(small_scene), "--json", "--out", str(folder), *SMALL_SEARCH]
    jax.clear_caches()  # what is compiled without the flag is not looked at
    with jax.debug_nans(True), contextlib.redirect_stdout(io.StringIO()) as stream:
        assert cli.main(command) == 0
    return folder, stream.getvalue()


@pytest.mark.slow
def test_json_is_one_strict_document(optimised):
    """Standard output holds one document, without NaN or Infinity tokens."""
    _, text = optimised
    document = json.loads(text, parse_constant=no_constant)
    names = {row["name"] for row in document["comparison"]["rows"]}
    assert {"optimised", "rect", "Hann", "best Tukey", "best snapshot"} <= names
    assert np.isfinite(document["comparison"]["gain_db"])
    assert "best snapshot" in document["photographs"]["ensemble"]


@pytest.mark.slow
def test_a_saved_design_has_the_same_metrics(optimised):
    """`one_exposure.json` loads back to the metrics that were printed."""
    folder, text = optimised
    printed = json.loads(text)["design"]["metrics"]
    loaded = Design.load(folder / "one_exposure.json").metrics
    for name in ("condition_number", "expected_psnr", "efficiency", "bound_share"):
        assert float(getattr(loaded, name)) == pytest.approx(printed[name], rel=1e-12)


@pytest.mark.slow
def test_what_is_judged_is_what_is_saved(optimised):
    """The row of the design is the design, also where the search was cut short."""
    _, text = optimised
    document = json.loads(text)
    rows = [row for row in document["comparison"]["rows"] if row["name"] == "optimised"]
    assert [row["motion"] for row in rows] == 2 * [document["design"]["motion"]]
    assert rows[0]["loss"] == document["design"]["loss"]


@pytest.mark.slow
def test_the_profile_has_its_units(optimised):
    """The CSV names its columns, then their units, then spans the exposure in ms."""
    folder, _ = optimised
    names, units, *rows = (folder / "profile.csv").read_text("utf-8").splitlines()
    design = Design.load(folder / "one_exposure.json")
    assert names == "time,tau,transmittance"
    assert units == "ms,1,1"
    time, tau, _ = np.array([[float(cell) for cell in row.split(",")] for row in rows]).T
    half = 1e3 * float(design.motion.half_exposure)
    np.testing.assert_allclose(time, np.linspace(-half, half, len(rows)), atol=1e-8 * half)
    np.testing.assert_allclose(tau, np.linspace(-1, 1, len(rows)), atol=1e-8)


@pytest.mark.slow
def test_files_are_whole(optimised):
    """The folder holds the files that were announced, pictures that open, nothing else."""
    folder, text = optimised
    announced = json.loads(text)["files"]
    assert sorted(announced) == sorted(path.name for path in folder.iterdir())
    for path in folder.glob("*.png"):
        with Image.open(path) as picture:
            picture.load()
    json.loads((folder / "report.json").read_text("utf-8"), parse_constant=no_constant)


@pytest.mark.slow
def test_compare_reads_designs_back(optimised, small_scene, capsys):
    """`compare` shows saved designs, of any name, at the metrics they were saved with."""
    folder, _ = optimised
    other = folder.parent / "Hann.json"
    other.write_bytes((folder / "one_exposure.json").read_bytes())
    design = Design.load(folder / "one_exposure.json")
    options = ["--design", str(folder / "one_exposure.json"), "--design", str(other)]
    options += ["--noise-seeds", "0"]
    assert cli.main(["compare", str(small_scene), *options, "--verbose"]) == 0
    out, err = capsys.readouterr()
    assert not messages(err)
    verdict, tables = out.split("Own best motion")
    own_best, _ = tables.split("Same motion")
    lines = {line.split()[0]: line for line in own_best.splitlines() if line.split()}
    assert "Hann" in lines
    assert "one_exposure = made/Hann" in lines["one_exposure"]
    assert f"{float(design.metrics.expected_psnr):.2f}" in lines["one_exposure"]
    assert re.match(r"Take .*: [\d.]+ dB", verdict)
    assert " one_exposure: " in verdict  # a saved design is an option by its name


@pytest.mark.parametrize("is_terminal", [True, False])
def test_what_cannot_be_counted_gives_a_sign_of_life(monkeypatch, is_terminal):
    """A person at a terminal is told what goes on; a file of messages is not filled with it."""
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: is_terminal, raising=False)
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    with working("counting the grains of sand"):
        time.sleep(0.01)
    assert ("counting the grains of sand" in stream.getvalue()) == is_terminal


OWN_SHUTTER = """
from typing import final
import jax
import jax.numpy as jnp
from mishutter import AbstractShutter, register_shutter

@register_shutter
@final
class DimShutter(AbstractShutter):
    light: jax.Array

    def transmittance(self, tau):
        return self.light + 0.0 * jnp.asarray(tau)
"""


@pytest.mark.parametrize("words", [["--import", "own_{}"], ["--import=own_{}"]], ids=len)
def test_a_design_of_an_own_shutter_names_its_module(words, tmp_path, monkeypatch, capsys):
    """The line says what to import; with that, before or after the command, it is read."""
    monkeypatch.chdir(tmp_path)
    name = f"own_{len(words)}"
    (tmp_path / f"{name}.py").write_text(OWN_SHUTTER)
    design = a_design(HannShutter()).to_dict()
    design["shutter"] = {"kind": "DimShutter", "module": name, "light": 0.75}
    (tmp_path / "own.json").write_text(json.dumps(design))
    command = ["export", "own.json", "--steps", "3"]
    before = list(kinds.KINDS)
    try:
        assert cli.main(command) == 2
        assert f"a module that is imported, as by `--import {name}`" in capsys.readouterr().err
        told = [word.format(len(words)) for word in words]
        for given in ([*command, *told], [*told, *command]):
            assert cli.main(given) == 0
            assert ",0.75," in capsys.readouterr().out
        saved = Design.load("own.json").to_dict()["shutter"]
        assert saved == design["shutter"]
    finally:
        kinds.KINDS[:] = before
    assert cli.main([*command, "--import", "nobodys_module"]) == 2
    assert "must be a module that can be imported" in capsys.readouterr().err


def test_a_folder_and_names_of_another_version_are_designs(tmp_path, capsys):
    """A folder stands for its recommendation, whichever version wrote it."""
    a_design(HannShutter()).save(tmp_path / "design.json")
    for asked in (tmp_path, tmp_path / "recommended.json", tmp_path / "build.json"):
        assert as_design(asked) == tmp_path / "design.json"
    assert "recommended.json is design.json in this folder" in capsys.readouterr().err
    for name in ("build.json", "recommended.json"):
        a_design(HannShutter()).save(tmp_path / name)
        assert as_design(tmp_path) == tmp_path / name
    assert as_design(tmp_path / "design.json") == tmp_path / "design.json"
    assert as_design(tmp_path / "other.json") == tmp_path / "other.json"
