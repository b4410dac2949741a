"""Each option of each command reaches the function that it is for, with the value that was said.

The commands are run as users run them, up to a function of the package: what that makes of its
arguments is tested beside it. An option that has no case here fails the last test.
"""

import contextlib
import inspect
import pydoc
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

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


class ReachedError(Exception):
    """Ends a command at the function that a case looks at."""


@dataclass(frozen=True)
class Option:
    """A case: the words of an option, the function that it reaches, and a look at its arguments.

    Attributes:
        words: Option and value.
        target: The function, by its address.
        look: The part of the arguments that the option decides.
        value: What `look` sees with the option, and does not see without it.
        beside: Words that stand there with the option and without it.
    """

    words: list[str]
    target: str
    look: Callable[[dict[str, Any]], Any]
    value: Any
    beside: tuple[str, ...] = ()


def _named(name: str) -> Callable[[dict[str, Any]], Any]:
    return lambda arguments: arguments[name]


def _type_of(name: str) -> Callable[[dict[str, Any]], str]:
    return lambda arguments: type(arguments[name]).__name__


def _shutter_taken(arguments: dict[str, Any]) -> str:
    return type(arguments["motion"].shutter).__name__


def _row(name: str) -> Callable[[dict[str, Any]], Any]:
    return lambda arguments: (
        None if arguments[name] is None else np.round(arguments[name], 9).tolist()
    )


def _opens_a_browser(arguments: dict[str, Any]) -> bool:
    import webbrowser

    opened = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(webbrowser, "open", opened.append)
        arguments["ready"]("http://127.0.0.1:8765")
    return bool(opened)


SEARCH, COMPARE = "mishutter.search.search.optimise", "mishutter.report.comparison.compare"
SWEEP, PLAN = "mishutter.sweeps.run.sweep", "mishutter.search.planning.plan"
CAPTURE, EXPLORE = (
    "mishutter.decoding.simulation.capture_and_restore",
    "mishutter.explore.server.serve",
)
TABLE, FIT = "mishutter.hardware.drive.drive_table", "mishutter.hardware.calibration.estimation.fit"
READ_DRIVE, READ_TRACE = (
    "mishutter.hardware.drive.design_from_drive",
    "mishutter.hardware.trace_files.read_trace",
)
STAGE = "mishutter.hardware.drive_files.path_csv"
PROFILE, READ_PICTURE = (
    "mishutter.hardware.traces.measured_profile",
    "mishutter.pictures.images.read_picture",
)
TABLES = "mishutter.report.comparison.comparison_tables"
PHOTOGRAPHS = "mishutter.report.restored.photographs"

LABORATORY = [
    Option(["--drive", "drive.csv"], READ_DRIVE, lambda a: a["path"].name, "drive.csv"),
    Option(["--measured", "trace.csv"], READ_TRACE, lambda a: a["path"].name, "trace.csv"),
    Option(
        ["--measured-column", "diode"],
        READ_TRACE,
        _named("column"),
        "diode",
        ("--measured", "trace.csv"),
    ),
    *(
        Option([name, said], READ_DRIVE, _named(argument), value, ("--drive", "drive.csv"))
        for name, said, argument, value in (
            ("--exposure-ms", "14.6", "half_exposure", pytest.approx(7.3e-3)),
            ("--half-exposure-ms", "7.3", "half_exposure", pytest.approx(7.3e-3)),
            ("--position-scale-px", "31", "position_scale", 31.0),
            ("--floor", "0.07", "floor", 0.07),
            ("--ceiling", "0.83", "ceiling", 0.83),
        )
    ),
    *(
        Option([name, said], PROFILE, _named(argument), value, ("--measured", "trace.csv"))
        for name, said, argument, value in (
            ("--mid-exposure-ms", "0.4", "middle", pytest.approx(4e-4)),
            ("--closed-level", "0.021", "closed", 0.021),
            ("--open-level", "1.49", "opened", 1.49),
        )
    ),
]
MEASURE = "mishutter.measurement.measurement.measure"
READ_CAPTURES = "mishutter.pictures.images.read_captures"
READ_PATH = "mishutter.hardware.recorded_paths.read_path"
RESTORE, GIVEN = "mishutter.decoding.simulation.restored_capture", ("--design", "design.json")
ON_PICTURES = ("--pictures", "photo.png", "--pictures", "other.png")
JUDGED = [
    Option(["--pictures", "photos"], COMPARE, lambda a: len(a["pictures"]), 3),
    Option(
        ["--decoder", "total-variation"],
        COMPARE,
        _type_of("decoder"),
        "TotalVariationDecoder",
        ON_PICTURES,
    ),
]
LOSS = (["--loss", "known-speed"], _type_of("loss"), "KnownSpeedLoss")
OPTIONS = {
    "optimise": [
        Option(LOSS[0], SEARCH, *LOSS[1:]),
        Option(["--free", "shutter"], SEARCH, _named("free"), ("shutter",)),
        Option(["--coefficients", "7"], SEARCH, _named("num_coefficients"), 7),
        Option(["--starts", "3"], SEARCH, _named("num_starts"), 3),
        Option(["--steps", "5"], SEARCH, _named("max_steps"), 5),
        Option(["--seed", "8"], SEARCH, _named("seed"), 8),
        Option(["--noise-seeds", "3"], PHOTOGRAPHS, _named("num_seeds"), 3),
        Option(["--every-photograph"], PHOTOGRAPHS, _named("every"), True),
        *JUDGED,
        Option(["--verbose"], PLAN, lambda a: "loss" in a, True),
    ],
    "compare": [
        Option(["--design", "design.json"], COMPARE, lambda a: [*a["shutters"]], ["design"]),
        Option(["--shutter", "tukey:0.3"], COMPARE, lambda a: [*a["shutters"]], ["tukey:0.3"]),
        *LABORATORY,
        Option(LOSS[0], COMPARE, *LOSS[1:]),
        Option(["--noise-seeds", "3"], PHOTOGRAPHS, _named("num_seeds"), 3),
        Option(["--every-photograph"], PHOTOGRAPHS, _named("every"), True),
        *JUDGED,
        Option(["--verbose"], TABLES, lambda a: "rows" in a, True),
    ],
    "sweep": [
        Option(["--acceleration", "1e4:4e4:3"], SWEEP, _row("accelerations"), [1e4, 2.5e4, 4e4]),
        Option(
            ["--stage-acceleration", "2e4:8e4:3"],
            SWEEP,
            _row("accelerations"),
            [1e4, 2.5e4, 4e4],
        ),
        Option(
            ["--exposure", "4.4:5.2:3"],
            SWEEP,
            _row("half_exposures"),
            [2.2e-3, 2.4e-3, 2.6e-3],
        ),
        Option(
            ["--half-exposure", "2.2:2.6:3"],
            SWEEP,
            _row("half_exposures"),
            [2.2e-3, 2.4e-3, 2.6e-3],
        ),
        Option(["--velocity", "-90:70:2"], SWEEP, _row("velocities"), [-90.0, 70.0]),
        Option(
            ["--log"],
            SWEEP,
            _row("accelerations"),
            [1e4, 2e4, 4e4],
            ("--acceleration", "1e4:4e4:3"),
        ),
        Option(["--optimise"], SWEEP, _named("optimise"), True),
        Option(LOSS[0], SWEEP, *LOSS[1:], ("--optimise",)),
        Option(
            ["--shutter", "tukey:0.3"],
            SWEEP,
            lambda a: "tukey:0.3" in (a["shutters"] or {}),
            True,
        ),
        Option(["--coefficients", "7"], SWEEP, _named("num_coefficients"), 7),
        Option(
            ["--store", "map.zarr"], SWEEP, lambda a: a["store"] and a["store"].name, "map.zarr"
        ),
        Option(["--scheduler", "127.0.0.1:8786"], SWEEP, _named("scheduler"), "127.0.0.1:8786"),
    ],
    "plan": [
        Option(LOSS[0], PLAN, *LOSS[1:]),
        Option(["--free", "shutter"], PLAN, _named("free"), ("shutter",)),
        Option(["--fixed"], PLAN, _named("free"), ()),
        Option(["--coefficients", "7"], PLAN, lambda a: a["shutter"].num_coefficients, 7),
    ],
    "simulate": [
        Option(["--subject", "other.png"], READ_PICTURE, lambda a: a["path"].name, "other.png"),
        Option(
            ["--white", "4095"], READ_PICTURE, _named("white"), 4095.0, ("--subject", "other.png")
        ),
        Option(["--linear"], READ_PICTURE, _named("linear"), True, ("--subject", "other.png")),
        Option(
            ["--design", "design.json"],
            CAPTURE,
            lambda a: float(a["motion"].motion.half_exposure),
            pytest.approx(9.7e-3),
        ),
        Option(["--shutter", "tukey:0.3"], CAPTURE, _shutter_taken, "TukeyShutter"),
        *LABORATORY,
        Option(["--speed", "37"], CAPTURE, _named("speed"), 37.0),
        Option(["--decoder", "wiener"], CAPTURE, _type_of("decoder"), "WienerDecoder"),
        Option(["--noiseless"], CAPTURE, _named("key"), None),
        Option(["--full-well", "1900"], CAPTURE, _named("full_well"), 1900.0),
        Option(["--adc-bits", "11"], CAPTURE, _named("adc_bits"), 11),
        Option(["--seed", "8"], CAPTURE, lambda a: a["key"] == jax.random.key(8), True),
    ],
    "restore": [
        Option(
            ["--design", "other.json"],
            RESTORE,
            lambda a: float(a["design"].motion.half_exposure),
            pytest.approx(8.1e-3),
        ),
        Option(
            ["--scene", "scene.toml"],
            RESTORE,
            lambda a: float(a["design"].scene.limits.max_half_exposure),
            pytest.approx(17e-3),
            GIVEN,
        ),
        Option(
            ["--shutter", "tukey:0.3"],
            RESTORE,
            lambda a: type(a["design"].shutter).__name__,
            "TukeyShutter",
            ("--scene", "scene.toml"),
        ),
        *(replace(each, beside=(*each.beside, *GIVEN)) for each in LABORATORY),
        Option(["--black", "103"], READ_CAPTURES, _named("black"), 103.0, GIVEN),
        Option(["--white", "4095"], READ_CAPTURES, _named("white"), 4095.0, GIVEN),
        Option(["--linear"], READ_CAPTURES, _named("linear"), True, GIVEN),
        Option(["--decoder", "wiener"], RESTORE, _type_of("decoder"), "WienerDecoder", GIVEN),
        Option(["--speed", "37"], RESTORE, _named("speed"), 37.0, GIVEN),
        Option(
            ["--stage-path", "encoder.csv"], READ_PATH, _named("path"), Path("encoder.csv"), GIVEN
        ),
        Option(
            ["--stage-scale-px", "-0.3"],
            READ_PATH,
            _named("scale"),
            -0.3,
            (*GIVEN, "--stage-path", "encoder.csv"),
        ),
    ],
    "explore": [
        Option(["--port", "8765"], EXPLORE, _named("port"), 8765),
        Option(["--host", "0.0.0.0"], EXPLORE, _named("host"), "0.0.0.0"),
        Option(["--no-browser"], EXPLORE, _opens_a_browser, False),
    ],
    "reproduce": [
        Option(["--quick"], "mishutter.paper.reproduction.reproduce", _named("quick"), True)
    ],
    "export": [
        Option(["--steps", "19"], TABLE, _named("num_steps"), 19),
        Option(["--levels", "5"], TABLE, _named("num_levels"), 5),
        Option(["--floor", "0.07"], TABLE, _named("floor"), 0.07),
        Option(["--ceiling", "0.83"], TABLE, _named("ceiling"), 0.83),
        Option(["--format", "pulses"], TABLE, _named("carries_error"), True),
        Option(["--return"], STAGE, _named("returns"), True, ("--out", "drive")),
    ],
    "measure": [
        Option(["--frames-per-s", "61"], MEASURE, _named("frames_per_s"), 61.0),
        Option(["--exposure-ms", "3"], MEASURE, _named("exposure"), pytest.approx(3e-3)),
        Option(["--dark", "dark.tif"], MEASURE, _named("dark"), [Path("dark.tif")]),
        Option(["--flat", "flat.tif"], MEASURE, _named("flats"), [Path("flat.tif")]),
        Option(["--black", "63"], MEASURE, _named("black"), 63.0),
        Option(["--white", "4095"], MEASURE, _named("white"), 4095.0),
        Option(["--pixel-pitch-um", "3.5"], MEASURE, _named("pixel_pitch"), pytest.approx(3.5e-6)),
        Option(["--px-per-mm", "7"], MEASURE, _named("px_per_mm"), 7.0),
        Option(["--readout-ms", "12"], MEASURE, _named("readout"), pytest.approx(0.012)),
        Option(["--rows-read", "up"], MEASURE, _named("rows_read"), "up"),
    ],
    "fit": [
        Option(
            ["--design", "other.json"],
            FIT,
            lambda a: float(a["motion"].half_exposure),
            pytest.approx(8.1e-3),
        ),
        Option(
            ["--drive", "drive.csv"], READ_DRIVE, lambda a: a["path"].name, "drive.csv", ("--json",)
        ),
        Option(["--coefficients", "7"], FIT, _named("num_coefficients"), 7),
        Option(["--redesign"], SEARCH, _named("free"), "shutter", ("--json",)),
    ],
}
"""Cases by command. `--out` and `--json` are held by the tests of each command's files."""
# `test_objects.py` restores by the last two.
HELD_ELSEWHERE = {"--out", "--json", "--help", "--objects", "--outlines"}
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


CASES = [
    pytest.param(command, option, id=f"{command} {option.words[0]}")
    for command, options in OPTIONS.items()
    for option in options
]


@pytest.mark.parametrize(("command", "option"), CASES)
def test_an_option_reaches_its_function(command, option, desk, designs, monkeypatch):
    """Its value is there with the option, and not without it."""
    stub(monkeypatch, designs, option.target)
    first = REQUIRED.get(command, ["scene.toml"])
    words = [command, *first, *option.beside]
    with_it = arguments_of(monkeypatch, option.target, [*words, *option.words])
    assert option.look(with_it) == option.value
    without = arguments_of(monkeypatch, option.target, words)
    assert without is None or option.look(without) != option.value


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
        held = {option.words[0] for option in OPTIONS.get(name, [])}
        assert options - HELD_ELSEWHERE == held, name
