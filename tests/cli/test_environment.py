"""What surrounds the command: devices that are not there, a full disk, an early interrupt."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import jax
import pytest
from support.command_line import SMALL_SCENE, environment, messages, refused
from support.drive import a_design

from mishutter import HannShutter

PROJECT = Path(__file__).parents[2] / "pyproject.toml"
LIMITED = (
    "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (900, 900)); "
    "from mishutter.cli import main; sys.exit(main())"
)


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SMALL_SCENE.replace('path = "photo.png"', "mean_level = 0.23"))
    return path


def run(*command, **variables):
    done = subprocess.run(
        [sys.executable, *map(str, command)],
        capture_output=True,
        text=True,
        env=environment(**variables),
        check=False,
    )
    return done.returncode, done.stdout, messages(done.stderr)


@pytest.mark.parametrize(
    ("variables", "raised", "line"),
    [
        ({"JAX_PLATFORMS": "cuda"}, AssertionError(), "`JAX_PLATFORMS` must name .*; got 'cuda'"),
        ({"JAX_PLATFORMS": "tpu"}, RuntimeError("x"), "`JAX_PLATFORMS` must name .*; got 'tpu'"),
        (
            {"JAX_PLATFORMS": "", "JAX_PLATFORM_NAME": "gpu"},
            RuntimeError("x"),
            "`JAX_PLATFORM_NAME` must name a kind of device that this machine has; got 'gpu'",
        ),
        (
            {"JAX_PLATFORMS": "cpu", "JAX_PLATFORM_NAME": "gpu"},
            RuntimeError("x"),
            "`JAX_PLATFORMS` and `JAX_PLATFORM_NAME` must name .*; got 'cpu' and 'gpu'",
        ),
    ],
)
def test_a_device_that_is_not_there(variables, raised, line, scene, monkeypatch, capsys):
    """The variable that asks for it is named, whatever JAX raises."""

    def devices():
        raise raised

    # JAX asks for its devices once a process.
    monkeypatch.setattr(jax, "devices", devices)
    monkeypatch.delenv("JAX_PLATFORM_NAME", raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert re.search(line, refused(capsys, "plan", scene))


@pytest.mark.slow
def test_a_device_that_jax_does_not_find(scene):
    """One line and exit code 2, from a process of its own."""
    variables = {"JAX_PLATFORMS": "", "JAX_PLATFORM_NAME": "gpu"}
    if any(device.platform == "gpu" for device in jax.devices()):
        pytest.skip("this machine has the device")
    code, out, (line,) = run("-m", "mishutter", "plan", scene, **variables)
    assert (code, out) == (2, "")
    assert line.startswith("mishutter: error: `JAX_PLATFORM_NAME` must name a kind of device")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="no device is full there")
def test_output_that_finds_no_room():
    """A redirected result that the disk does not take is an error of one line."""
    arguments = [sys.executable, "-m", "mishutter", "example"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            arguments,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(),
            check=False,
        )
    assert done.returncode == 2
    assert messages(done.stderr) == [
        "mishutter: error: the output must be accessible; got: No space left on device"
    ]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="files have no greatest size there")
def test_a_file_that_finds_no_room(tmp_path):
    """The file is named that was to be written, and no part of it is left."""
    a_design(HannShutter()).save(tmp_path / "design.json")
    out = tmp_path / "out"
    given = ["export", tmp_path / "design.json", "--steps", "99", "--out", out]
    file = out / "drive.csv"
    # Python and JAX would keep the parts of bytecode and programs for which there is room.
    nothing_else = {"PYTHONDONTWRITEBYTECODE": "1", "JAX_ENABLE_COMPILATION_CACHE": "false"}
    code, _, said = run("-c", LIMITED, *given, **nothing_else)
    assert code == 2
    assert said[-1] == f"mishutter: error: '{file}' must be accessible; got: File too large"
    assert not list(out.iterdir())


@pytest.mark.parametrize("start", [["-m", "mishutter"], ["-c", "{script}"]])
def test_an_interrupt_of_the_imports(start, tmp_path):
    """It ends the command with its code and without a word, however that is started."""
    (tmp_path / "typer.py").write_text("import signal; signal.raise_signal(signal.SIGINT); 1 / 0")
    module, _, function = tomllib.loads(PROJECT.read_text("utf-8"))["project"]["scripts"][
        "mishutter"
    ].partition(":")
    script = f"import sys; from {module} import {function}; sys.exit({function}())"
    command = [part.format(script=script) for part in start]
    path = os.pathsep.join([str(tmp_path), environment()["PYTHONPATH"]])
    assert run(*command, "plan", PYTHONPATH=path) == (130, "", [])
