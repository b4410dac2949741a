"""`mishutter sweep`: every mistake is one line, results are whole, and it can be resumed."""

import json

import numpy as np
import pytest
import xarray
from support.command_line import SMALL_SCENE, no_constant, refused

from mishutter import Limits, Scene, cli
from mishutter.cli.sweep_command import (
    _COLUMNS,
    _OTHER_METRICS,
    _halves,
    _point_of,
    _rows,
)
from mishutter.evaluation.metrics import METRICS
from mishutter.model.scene_file import example_scene_text

RANGES = ["--acceleration", "3e4:1.2e5:2", "--exposure", "6:18:2"]

MISTAKES = {
    "two-parts": (["--acceleration", "1:2"], "`--acceleration` must be A:B:N, two numbers and a"),
    "text": (["--exposure", "a:b:c"], "`--exposure` must be A:B:N, two numbers and a"),
    "empty": (["--acceleration", "1e4:2e4:0"], "`--acceleration` must hold at least one value"),
    "reversed": (["--half-exposure", "9:3:4"], "`--half-exposure` must ascend from A to B; got"),
    "nan": (["--acceleration", "nan:1e5:3"], "must run between finite numbers; got 'nan:1e5:3'"),
    "negative": (["--acceleration=-1:1e5:3"], "`--acceleration` must be at least 0; got"),
    "velocity": (["--velocity", "-1:2"], "`--velocity` must be A:B:N, two numbers and a count"),
    "velocity-reversed": (["--velocity", "-1:-9:4"], "`--velocity` must ascend from A to B; got"),
    "velocity-inf": (["--velocity", "0:inf:4"], "must run between finite numbers; got '0:inf:4'"),
    "both": (
        ["--exposure", "6:18:2", "--half-exposure", "3:9:2"],
        "`--half-exposure` must not stand beside --exposure; got '3:9:2'",
    ),
    "no-time": (["--half-exposure", "0:3:3"], "`--half-exposure` must be above 0; got '0:3:3'"),
    "one-of-many": (["--acceleration", "1e4:2e4:1"], "must hold two values or more from A to B"),
    "log-zero": (["--log", "--acceleration", "0:1e5:3"], "must begin above 0 with --log; got"),
    "many": (
        ["--acceleration", "1:2:1000000000000"],
        "must make at most 10,000,000 points; got 1,",
    ),
    "many-together": (["--acceleration", "1:2:9000000"], "points; got 360,000,000"),
    "shutter": (["--shutter", "hamming"], "must be one of rect, hann, "),
    "out": (["--out", "/dev/null/x"], "must be a writable folder"),
    "store": (
        ["--store", "/dev/null/x"],
        "must be a folder that can be written; got '/dev/null/x':",
    ),
}


@pytest.mark.parametrize("slug", MISTAKES)
def test_mistakes(slug, capsys):
    """A range that is none, and what the other commands refuse too."""
    arguments, message = MISTAKES[slug]
    assert message in refused(capsys, "sweep", *arguments)


def test_a_store_that_is_a_file(tmp_path, capsys):
    """It is refused, and not touched."""
    file = tmp_path / "file"
    file.write_text("in the way")
    assert "must be a folder; got" in refused(capsys, "sweep", *RANGES, "--store", file)
    assert file.read_text("utf-8") == "in the way"


@pytest.fixture
def scene_file(tmp_path):
    """A small scene without a photograph."""
    path = tmp_path / "scene.toml"
    path.write_text(SMALL_SCENE.split("[picture]")[0])
    return str(path)


def test_the_stroke_of_a_point_holds_its_pan():
    """From its lowest to its highest position, and within the limit that it is counted by."""
    scene = Scene([410.0], photon_rate=1e5, read_noise=3.0, limits=Limits(max_stroke=90.0))
    point = xarray.Dataset(
        {name: 0.5 for name in (*METRICS, "over_snapshot", "over_hann")},
        {"shutter": "rect", "acceleration": 2.1e5, "half_exposure": 9.7e-3, "velocity": 2900.0},
    ).assign_coords(at_end_of="")
    shown = _point_of(point, scene, "expected_psnr")
    time = np.linspace(-9.7e-3, 9.7e-3, 100_001)
    assert shown["stroke_px"] == pytest.approx(np.ptp(2900 * time + 2.1e5 * time**2), rel=1e-8)
    assert shown["top_speed_px_per_s"] == pytest.approx(2900 + 2 * 2.1e5 * 9.7e-3, rel=1e-12)


def test_a_table_of_points_speaks_of_whole_exposures():
    """And says once what is the best by several metrics, unless at other ends of its ranges."""
    scene = Scene([410.0], photon_rate=1e5, read_noise=3.0, limits=Limits(max_stroke=90.0))
    numbers = dict.fromkeys((*METRICS, "over_snapshot", "over_hann"), 0.5)
    place = {"shutter": "rect", "acceleration": 2.1e5, "half_exposure": 9.75e-3, "velocity": 0.0}
    ends = {"expected_psnr": "", "bound_share": "", "condition_number": "half_exposure"}
    best = {
        name: _point_of(
            xarray.Dataset(numbers, place).assign_coords(at_end_of=end), scene, "expected_psnr"
        )
        for name, end in ends.items()
    }
    forms = [METRICS[name].form for name in _OTHER_METRICS]
    rows = _rows(best, forms)
    assert [row[0] for row in rows] == ["expected_psnr\nbound_share", "condition_number"]
    exposure = _COLUMNS.index("open ms")
    assert [row[exposure] for row in rows] == ["19.5", "19.5*"]
    assert len(rows[0]) == len(_COLUMNS) + len(_OTHER_METRICS)
    assert best["bound_share"]["half_exposure_ms"] == pytest.approx(9.75)


@pytest.mark.slow
def test_json_and_a_store(scene_file, tmp_path, capsys):
    """One strict document; run again, everything is found in the store."""
    command = ["sweep", scene_file, *RANGES, "--json", "--store", str(tmp_path / "a.zarr")]
    assert cli.main(command) == 0
    first = capsys.readouterr()
    document = json.loads(first.out, parse_constant=no_constant)
    assert document["num_points"] == 4
    assert set(document["best"]["expected_psnr"]) >= {"shutter", "stroke_px", "over_snapshot"}
    # Of two values, both are ends.
    assert document["best"]["expected_psnr"]["at_end_of"] == "acceleration, half_exposure"
    assert "already" not in first.err
    assert cli.main(command) == 0
    second = capsys.readouterr()
    assert f"4 of 4 points are in '{tmp_path / 'a.zarr'}' already" in second.err
    assert second.out == first.out


@pytest.mark.slow
def test_a_range_with_zero_and_one_point(scene_file, tmp_path, capsys):
    """A camera at rest is in the table; so is a grid of a single point, pictures and all."""
    options = ["--acceleration", "0:0:1", "--half-exposure", "3:3:1", "--out", str(tmp_path / "d")]
    assert cli.main(["sweep", scene_file, *options]) == 0
    assert sorted(path.name for path in (tmp_path / "d").iterdir()) == ["map.png", "pareto.png"]
    out = capsys.readouterr().out
    assert "Best points of the sweep" in out
    assert "expected_psnr" in out
    assert "*" not in out
    assert cli.main(["sweep", scene_file, "--acceleration", "3e4:9e4:2", *options[2:4]]) == 0
    out = capsys.readouterr().out
    best = next(line for line in out.splitlines() if line.startswith(" expected_psnr"))
    # Of two accelerations, twice $a$ of the paper, both are ends; the exposure is the only one.
    assert best.split()[3:5] == ["1.8e+05*", "6"]
    assert "Best points of the sweep (* at an end of its range)" in out


@pytest.mark.slow
def test_velocities(scene_file, capsys):
    """The table and the document say the velocity of each best point, and of the best snapshot."""
    command = ["sweep", scene_file, *RANGES]
    assert cli.main([*command, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {best["velocity_px_per_s"] for best in document["best"].values()} == {60.0}
    snapshot = document["best_snapshot"]["velocity_px_per_s"]
    assert -190 < snapshot < 310
    assert cli.main([*command, "--velocity", "-100:80:3", "--log", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["num_points"] == 12
    assert document["best_snapshot"]["velocity_px_per_s"] == snapshot
    for best in document["best"].values():
        velocity, a = best["velocity_px_per_s"], best["acceleration_px_per_s2"]
        assert velocity in (-100.0, -10.0, 80.0)
        gain = 2 * a * best["half_exposure_ms"] * 1e-3
        assert best["top_speed_px_per_s"] == pytest.approx(gain + abs(velocity))
    assert document["best"]["expected_psnr"]["velocity_px_per_s"] == 80.0
    assert cli.main([*command, "--velocity", "80:80:1"]) == 0
    out = capsys.readouterr().out
    assert "px/s" in out
    assert "80.0" in out


OUTSIDE = {
    "far": (
        ["1e9:2e9:2", "1:9:2"],
        "got 4 outside them, 4 by stroke, 4 by top speed, 2 by exposure",
    ),
    "overflow": (["1e308:1.7e308:3", "3:9:2"], "got 6 outside them, 6 by stroke, 6 by top speed"),
    "long": (["0:1e5:3", "1e300:1e308:2"], "6 by exposure too long"),
    "short": ([None, "1e-310:1e-309:2"], "got 80 outside them, 80 by exposure too short"),
    "too-long": ([None, "1e300:1e305:2"], "80 by exposure too long"),
    "pan": ([None, None, "-5000:-1400:2"], "3200 by top speed, 3200 by pan"),
}


@pytest.mark.parametrize(
    ("slug", "also"),
    [*((slug, "--store") for slug in OUTSIDE), *(("far", word) for word in ("--json", "--out"))],
)
def test_nothing_within_limits(slug, also, scene_file, tmp_path, capsys):
    """One line names the limits that are broken, whatever was asked for, and nothing is made."""
    ranges, message = OUTSIDE[slug]
    place = tmp_path / "new"
    options = [also] if also == "--json" else [also, place] if also else []
    names = "--acceleration", "--half-exposure", "--velocity"
    for name, text in zip(names, ranges, strict=False):
        options += [name, text] if text else []
    line = refused(capsys, "sweep", scene_file, *options)
    assert "must reach a point within the scene's limits; got " in line
    assert message in line
    assert not place.exists()


@pytest.mark.slow
def test_points_of_a_sensor_that_hardly_accelerates_are_mapped(capsys):
    """Kernels are no longer than their smear, however far beyond the exposure a vertex lies."""
    ranges = ["--acceleration", "1:2:2", "--half-exposure", "0.6:0.7:2"]
    assert cli.main(["sweep", *ranges, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["num_within_limits"] == document["num_points"] == 4
    assert cli.main(["sweep", *ranges[:3], "41:42:2"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines()[-1].endswith("got 4 outside them, 4 by exposure too long")


@pytest.mark.slow
def test_pictures_and_optimised_profiles(scene_file, tmp_path, capsys):
    """`--optimise --out` writes the announced pictures, and the search is at least as good."""
    out = tmp_path / "made"
    options = [*RANGES, "--optimise", "--coefficients", "8", "--json", "--out", str(out)]
    assert cli.main(["sweep", scene_file, *options]) == 0
    document = json.loads(capsys.readouterr().out, parse_constant=no_constant)
    assert document["best"]["expected_psnr"]["shutter"] == "optimised"
    assert sorted(document["files"]) == sorted(path.name for path in out.iterdir())


@pytest.mark.slow
def test_points_are_judged_by_the_scenes_decoder(scene_file, tmp_path, capsys):
    """Levels, gains and pictures are its own, and a line says of which decoder they are."""
    with open(scene_file, "a") as file:
        file.write('\n[decoder]\nspeed = "known"\n')
    command = ["sweep", scene_file, *RANGES]
    assert cli.main([*command, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    best = document["best"]["known_speed_psnr"]
    level = document["best_snapshot"]["known_speed_psnr"]
    assert best["over_snapshot"] == pytest.approx(best["known_speed_psnr"] - level, abs=1e-9)
    assert "expected_psnr" not in {*document["best"], *best}
    assert cli.main([*command, "--out", str(tmp_path / "d")]) == 0
    out = capsys.readouterr().out
    assert "PSNR dB: PSNR of the best linear decoder that knows the speed, linear light." in out
    assert (tmp_path / "d" / "map.png").exists()


def test_whole_exposures_are_twice_their_halves():
    """Of 6 to 18 ms, as halves of 3 to 9 ms; both become half exposures in seconds."""
    ranges = ("6:18:3", None), (None, "3:9:3")
    for whole, half in ranges:
        options = ("--exposure", whole), ("--half-exposure", half)
        found = _halves(*options, False, "above 0", 1e-3)
        np.testing.assert_allclose(found, [0.003, 0.006, 0.009])


def test_things_in_any_direction_are_refused_before_anything_is_written(tmp_path, capsys):
    """One line, and no store: a sweep is along one axis."""
    text = example_scene_text().split("[motion]")[0]
    before = "uniform = { min_px_per_s = -4500, max_px_per_s = 4500, count = 9 }"
    assert before in text
    path, store = tmp_path / "disc.toml", tmp_path / "a.zarr"
    path.write_text(text.replace(before, "any_direction = { max_px_per_s = 2500 }"))
    assert cli.main(["sweep", str(path), "--store", str(store)]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    (line,) = shown.err.splitlines()
    assert "`scene` must move along one axis here" in line
    assert not store.exists()
