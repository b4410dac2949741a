"""Each option of each command reaches the function that it is for, with the value that was said.

The commands are run as users run them, up to a function of the package: what that makes of its
arguments is tested beside it. An option that has no case here fails the last test.
"""

import contextlib
import functools
import inspect
import pydoc
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
import pytest
import typer
from support.command_line import SMALL_SCENE
from support.rows import verdict

import mishutter as ms
from mishutter import cli
from mishutter.cli.app import app
from mishutter.design.design import given_design
from mishutter.model.shutters.kinds import baselines


class ReachedError(Exception):
    """Ends a command at the function that a case looks at."""


class Named(NamedTuple):
    """The function that an option reaches, and the argument in which its value stands there.

    Attributes:
        target: The function, by its address.
        name: The argument, or a part of it, as `motion.half_exposure`.
    """

    target: str
    name: str


def plain(value: Any) -> Any:
    """A value as the table writes it: a path by its name, a table by its keys, ours by its kind."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, list):
        return [plain(each) for each in value]
    if isinstance(value, Mapping):
        return [*value]
    if isinstance(value, eqx.Module):
        return type(value).__name__
    if isinstance(value, jax.Array) and jax.dtypes.issubdtype(value.dtype, jax.dtypes.prng_key):
        return int(jax.random.key_data(value)[-1])
    if isinstance(value, jax.Array | np.ndarray):
        return np.round(value, 9).tolist()
    return value() if inspect.ismethodwrapper(value) else value


SEARCH, COMPARE = "mishutter.search.search.optimise", "mishutter.report.comparison.compare"
SWEEP, PLAN = "mishutter.sweeps.run.sweep", "mishutter.search.planning.plan"
CAPTURE = "mishutter.decoding.restoration.capture_and_restore"
RESTORE = "mishutter.decoding.restoration.restored_capture"
EXPLORE = "mishutter.explore.server.serve"
TABLE, FIT = "mishutter.hardware.drive.drive_table", "mishutter.hardware.calibration.estimation.fit"
READ_DRIVE = "mishutter.hardware.drive.design_from_drive"
READ_TRACE = "mishutter.hardware.trace_files.read_trace"
READ_PATH = "mishutter.hardware.recorded_paths.read_path"
READ_PICTURE = "mishutter.pictures.images.read_picture"
READ_CAPTURES = "mishutter.pictures.images.read_captures"
STAGE = "mishutter.hardware.drive_files.path_csv"
PROFILE = "mishutter.hardware.traces.measured_profile"
MEASURE = "mishutter.measurement.measurement.measure"
TABLES = "mishutter.report.comparison.comparison_tables"
PHOTOGRAPHS = "mishutter.report.restored.photographs"
REPRODUCE = "mishutter.paper.reproduction.reproduce"

GIVEN, ON_PICTURES = "--design design.json", "--pictures photo.png --pictures other.png"
LOSS = ("--loss known-speed", "loss", "KnownSpeedLoss")
LABORATORY = [
    ("--drive drive.csv", Named(READ_DRIVE, "path"), "drive.csv"),
    ("--measured trace.csv", Named(READ_TRACE, "path"), "trace.csv"),
    ("--measured-column diode", Named(READ_TRACE, "column"), "diode", "--measured trace.csv"),
    ("--exposure-ms 14.6", Named(READ_DRIVE, "half_exposure"), 7.3e-3, "--drive drive.csv"),
    ("--half-exposure-ms 7.3", Named(READ_DRIVE, "half_exposure"), 7.3e-3, "--drive drive.csv"),
    ("--position-scale-px 31", Named(READ_DRIVE, "position_scale"), 31.0, "--drive drive.csv"),
    ("--floor 0.07", Named(READ_DRIVE, "floor"), 0.07, "--drive drive.csv"),
    ("--ceiling 0.83", Named(READ_DRIVE, "ceiling"), 0.83, "--drive drive.csv"),
    ("--mid-exposure-ms 0.4", Named(PROFILE, "middle"), 4e-4, "--measured trace.csv"),
    ("--closed-level 0.021", Named(PROFILE, "closed"), 0.021, "--measured trace.csv"),
    ("--open-level 1.49", Named(PROFILE, "opened"), 1.49, "--measured trace.csv"),
]
JUDGED = [
    ("--pictures photos", Named(COMPARE, "pictures.__len__"), 3),
    ("--decoder total-variation", Named(COMPARE, "decoder"), "TotalVariationDecoder", ON_PICTURES),
    ("--noise-seeds 3", Named(PHOTOGRAPHS, "num_seeds"), 3),
    ("--every-photograph", Named(PHOTOGRAPHS, "every"), True),
]
OPTIONS = {
    "optimise": [
        (LOSS[0], Named(SEARCH, LOSS[1]), LOSS[2]),
        ("--free shutter", Named(SEARCH, "free"), ("shutter",)),
        ("--coefficients 7", Named(SEARCH, "num_coefficients"), 7),
        ("--starts 3", Named(SEARCH, "num_starts"), 3),
        ("--steps 5", Named(SEARCH, "max_steps"), 5),
        ("--seed 8", Named(SEARCH, "seed"), 8),
        *JUDGED,
        ("--verbose", Named(PLAN, "loss"), "ExpectedErrorLoss"),
    ],
    "compare": [
        ("--design design.json", Named(COMPARE, "shutters"), ["design"]),
        ("--shutter tukey:0.3", Named(COMPARE, "shutters"), ["tukey:0.3"]),
        (LOSS[0], Named(COMPARE, LOSS[1]), LOSS[2]),
        *LABORATORY,
        *JUDGED,
        ("--verbose", Named(TABLES, "rows.__len__"), 3),
    ],
    "sweep": [
        ("--acceleration 1e4:4e4:3", Named(SWEEP, "accelerations"), [1e4, 2.5e4, 4e4]),
        ("--stage-acceleration 2e4:8e4:3", Named(SWEEP, "accelerations"), [1e4, 2.5e4, 4e4]),
        ("--exposure 4.4:5.2:3", Named(SWEEP, "half_exposures"), [2.2e-3, 2.4e-3, 2.6e-3]),
        ("--half-exposure 2.2:2.6:3", Named(SWEEP, "half_exposures"), [2.2e-3, 2.4e-3, 2.6e-3]),
        ("--velocity -90:70:2", Named(SWEEP, "velocities"), [-90.0, 70.0]),
        ("--log", Named(SWEEP, "accelerations"), [1e4, 2e4, 4e4], "--acceleration 1e4:4e4:3"),
        ("--optimise", Named(SWEEP, "optimise"), True),
        (LOSS[0], Named(SWEEP, LOSS[1]), LOSS[2], "--optimise"),
        ("--shutter tukey:0.3", Named(SWEEP, "shutters"), [*baselines(), "tukey:0.3"]),
        ("--coefficients 7", Named(SWEEP, "num_coefficients"), 7),
        ("--store map.zarr", Named(SWEEP, "store"), "map.zarr"),
        ("--scheduler 127.0.0.1:8786", Named(SWEEP, "scheduler"), "127.0.0.1:8786"),
    ],
    "plan": [
        (LOSS[0], Named(PLAN, LOSS[1]), LOSS[2]),
        ("--free shutter", Named(PLAN, "free"), ("shutter",)),
        ("--fixed", Named(PLAN, "free"), ()),
        ("--coefficients 7", Named(PLAN, "shutter.num_coefficients"), 7),
    ],
    "simulate": [
        ("--subject other.png", Named(READ_PICTURE, "path"), "other.png"),
        ("--white 4095", Named(READ_PICTURE, "white"), 4095.0, "--subject other.png"),
        ("--linear", Named(READ_PICTURE, "linear"), True, "--subject other.png"),
        ("--design design.json", Named(CAPTURE, "motion.motion.half_exposure"), 9.7e-3),
        ("--shutter tukey:0.3", Named(CAPTURE, "motion.shutter"), "TukeyShutter"),
        *LABORATORY,
        ("--speed 37", Named(CAPTURE, "speed"), 37.0),
        ("--decoder wiener", Named(CAPTURE, "decoder"), "WienerDecoder"),
        ("--noiseless", Named(CAPTURE, "key"), None),
        ("--full-well 1900", Named(CAPTURE, "full_well"), 1900.0),
        ("--adc-bits 11", Named(CAPTURE, "adc_bits"), 11),
        ("--seed 8", Named(CAPTURE, "key"), 8),
    ],
    "restore": [
        ("--design other.json", Named(RESTORE, "design.motion.half_exposure"), 8.1e-3),
        (
            "--scene scene.toml",
            Named(RESTORE, "design.scene.limits.max_half_exposure"),
            17e-3,
            GIVEN,
        ),
        (
            "--shutter tukey:0.3",
            Named(RESTORE, "design.shutter"),
            "TukeyShutter",
            "--scene scene.toml",
        ),
        *((*case[:3], " ".join([*case[3:], GIVEN])) for case in LABORATORY),
        ("--black 103", Named(READ_CAPTURES, "black"), 103.0, GIVEN),
        ("--white 4095", Named(READ_CAPTURES, "white"), 4095.0, GIVEN),
        ("--linear", Named(READ_CAPTURES, "linear"), True, GIVEN),
        ("--decoder wiener", Named(RESTORE, "decoder"), "WienerDecoder", GIVEN),
        ("--speed 37", Named(RESTORE, "speed"), 37.0, GIVEN),
        ("--stage-path encoder.csv", Named(READ_PATH, "path"), "encoder.csv", GIVEN),
        (
            "--stage-scale-px -0.3",
            Named(READ_PATH, "scale"),
            -0.3,
            f"{GIVEN} --stage-path encoder.csv",
        ),
    ],
    "explore": [
        ("--port 8765", Named(EXPLORE, "port"), 8765),
        ("--host 0.0.0.0", Named(EXPLORE, "host"), "0.0.0.0"),
    ],
    "reproduce": [("--quick", Named(REPRODUCE, "quick"), True)],
    "export": [
        ("--steps 19", Named(TABLE, "num_steps"), 19),
        ("--levels 5", Named(TABLE, "num_levels"), 5),
        ("--floor 0.07", Named(TABLE, "floor"), 0.07),
        ("--ceiling 0.83", Named(TABLE, "ceiling"), 0.83),
        ("--format pulses", Named(TABLE, "carries_error"), True),
        ("--return", Named(STAGE, "returns"), True, "--out drive"),
    ],
    "measure": [
        ("--frames-per-s 61", Named(MEASURE, "frames_per_s"), 61.0),
        ("--exposure-ms 3", Named(MEASURE, "exposure"), 3e-3),
        ("--dark dark.tif", Named(MEASURE, "dark"), ["dark.tif"]),
        ("--flat flat.tif", Named(MEASURE, "flats"), ["flat.tif"]),
        ("--black 63", Named(MEASURE, "black"), 63.0),
        ("--white 4095", Named(MEASURE, "white"), 4095.0),
        ("--pixel-pitch-um 3.5", Named(MEASURE, "pixel_pitch"), 3.5e-6),
        ("--px-per-mm 7", Named(MEASURE, "px_per_mm"), 7.0),
        ("--readout-ms 12", Named(MEASURE, "readout"), 0.012),
        ("--rows-read up", Named(MEASURE, "rows_read"), "up"),
    ],
    "fit": [
        ("--design other.json", Named(FIT, "motion.half_exposure"), 8.1e-3),
        ("--drive drive.csv", Named(READ_DRIVE, "path"), "drive.csv", "--json"),
        ("--coefficients 7", Named(FIT, "num_coefficients"), 7),
        ("--redesign", Named(SEARCH, "free"), "shutter", "--json"),
    ],
}
"""Cases by command: words, where their value goes, the value, and words that stand there always.

`--out` and `--json` are held by the tests of each command's files."""
# `test_objects.py` restores by the last two.
HELD_ELSEWHERE = {"--out", "--json", "--help", "--objects", "--outlines", "--no-browser"}
REQUIRED = {
    "reproduce": ["--out", "page"],
    "restore": ["other.png"],
    "export": ["design.json"],
    "fit": ["measurements.toml", "--design", "design.json"],
    "measure": ["clip.tif", "--frames-per-s", "50", "--out", "found.toml"],
}
"""Arguments without which a command does not begin."""


@pytest.fixture(scope="module")
def designs():
    """Two saved cameras of the small scene, with exposures of their own."""
    scene = ms.Scene([0.0, 310.0, -190.0], photon_rate=2.3e5, read_noise=4.7)
    motions = (ms.ParabolicMotion(acceleration=6e4, half_exposure=x) for x in (9.7e-3, 8.1e-3))
    return [given_design(scene, motion, ms.HannShutter(), "Given.") for motion in motions]


@pytest.fixture
def desk(tmp_path, monkeypatch, designs):
    """A folder with a scene, its photograph, designs and a trace, in which the commands run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(SMALL_SCENE, encoding="utf-8")
    for name in ("photo.png", "other.png"):
        ms.write_picture(tmp_path / name, ms.example_picture().light[:90, :120])
    (tmp_path / "photos").mkdir()
    for name in ("c.png", "a.jpg", "b.png", ".hidden"):  # the last is no picture
        (tmp_path / "photos" / name).write_bytes((tmp_path / "photo.png").read_bytes())
    designs[0].save(tmp_path / "design.json")
    designs[1].save(tmp_path / "other.json")
    times = np.linspace(-0.018, 0.018, 301)
    levels = 0.02 + 1.5 * np.clip(np.cos(np.pi * times / 0.026), 0, None) ** 2
    lines = [f"{t:.6f},{x:.6f}" for t, x in zip(times, levels, strict=True)]
    (tmp_path / "trace.csv").write_text("\n".join(["time (s),diode", *lines]), encoding="utf-8")
    (tmp_path / "drive.csv").write_text("0.1\n0.2\n", encoding="utf-8")
    return tmp_path


def stub(monkeypatch, designs, target):
    """Answers at once for what takes long and is not the function that a case looks at."""
    camera = SimpleNamespace(
        seen_through_lens=lambda scene: scene,
        design=lambda scene: designs[1],
        motion=designs[1].motion,
        doubt="",
        to_dict=dict,
    )
    comparison = verdict({"optimised": 26.0, "Hann": 25.7, "best snapshot": 26.3}, "optimised")
    answers = {
        SEARCH: designs[0],
        COMPARE: comparison,
        FIT: camera,
        "mishutter.hardware.calibration.measurements.read_measurements": SimpleNamespace(
            trace=None
        ),
    }
    for address, answer in answers.items():
        if address != target:
            monkeypatch.setattr(address, lambda *_, answer=answer, **__: answer)


def arguments_of(monkeypatch, target, words):
    """The arguments with which a command calls a function; none if it ends without."""
    calls = []
    signature = inspect.signature(pydoc.locate(target))

    def reached(*args, **kwargs):
        call = signature.bind(*args, **kwargs)
        call.apply_defaults()
        calls.append(call.arguments)
        raise ReachedError

    with monkeypatch.context() as patch, contextlib.suppress(ReachedError):
        patch.setattr(target, reached)
        cli.main(words)
    return calls[0] if calls else None


def seen(arguments: dict[str, Any], place: Named) -> Any:
    """What stands at a place, as the table writes it."""
    name, *parts = place.name.split(".")
    return plain(functools.reduce(getattr, parts, arguments[name]))


CASES = [
    pytest.param(command, case, id=f"{command} {case[0].split()[0]}")
    for command, cases in OPTIONS.items()
    for case in cases
]


@pytest.mark.parametrize(("command", "case"), CASES)
def test_an_option_reaches_its_function(command, case, desk, designs, monkeypatch):
    """Its value is there with the option, and not without it."""
    option, place, value, *beside = case
    stub(monkeypatch, designs, place.target)
    first = REQUIRED.get(command, ["scene.toml"])
    words = [command, *first, *" ".join(beside).split()]
    wanted = pytest.approx(value) if isinstance(value, float) else value
    assert seen(arguments_of(monkeypatch, place.target, [*words, *option.split()]), place) == wanted
    without = arguments_of(monkeypatch, place.target, words)
    assert without is None or seen(without, place) != wanted


def test_a_browser_is_opened_unless_it_is_declined(desk, designs, monkeypatch):
    """At the address of the page, once it is served."""
    opened = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    for words in ([], ["--no-browser"]):
        arguments_of(monkeypatch, EXPLORE, ["explore", "scene.toml", *words])["ready"]("http://a")
    assert opened == ["http://a"]


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--decoder", "wiener"], "`--decoder` must stand beside --pictures; got 'wiener'"),
        (["--pictures", "photo.png"], "must be two or more, for a standard error; got 1"),
        (["--pictures", "photo.png", "--pictures", "nowhere.png"], "nowhere.png"),
        (["--pictures", "photos", "--pictures", "scene.toml"], "scene.toml"),
    ],
)
@pytest.mark.parametrize("command", ["optimise", "compare"])
def test_what_cannot_judge_is_told_before_a_search(command, words, line, desk, monkeypatch, capsys):
    """One line on standard error, and nothing is searched."""
    called = []
    for address in (SEARCH, COMPARE):
        monkeypatch.setattr(address, lambda *_, **__: called.append(1))
    assert cli.main([command, "scene.toml", *words]) == 2
    (told,) = capsys.readouterr().err.strip().splitlines()
    assert line in told
    assert not called


def test_every_option_has_a_case():
    """An option that is added is passed on, or a test says what else it does."""
    commands = typer.main.get_command(app).commands
    for name, command in commands.items():
        options = {max(p.opts, key=len) for p in command.params if p.opts[0].startswith("-")}
        held = {case[0].split()[0] for case in OPTIONS.get(name, [])}
        assert options - HELD_ELSEWHERE == held, name
