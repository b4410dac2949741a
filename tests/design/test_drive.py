"""Drive tables: levels that a shutter can be given, and what is lost by them."""

import csv
import inspect
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from support.designs import MOTION, SCENE
from support.drive import a_design

from mishutter import (
    ChippedShutter,
    HannShutter,
    LinearMotion,
    SplineShutter,
    cli,
    drive_table,
    evaluate,
)
from mishutter.design.drive import step_means
from mishutter.model import panned


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("design") / "design.json"
    a_design(SplineShutter([0.2, 0.7, 0.9, 1.0, 0.4])).save(path)
    return path


def test_step_means_are_the_integral_of_the_profile():
    """A Hann profile's mean over a step has a closed form, in order of time."""
    edges = np.linspace(-1, 1, 8)
    antiderivative = edges / 2 + np.sin(np.pi * edges) / (2 * np.pi)
    means = np.diff(antiderivative) / np.diff(edges)
    assert np.allclose(step_means(HannShutter(), 7), means, rtol=1e-12)
    assert np.allclose(step_means(ChippedShutter([0.1, 0.7, 0.4]), 3), [0.1, 0.7, 0.4], rtol=1e-12)


def test_levels_are_the_nearest_between_floor_and_ceiling():
    """Each step's transmittance is within half a level of the scaled profile."""
    table = drive_table(
        a_design(HannShutter()), num_steps=37, num_levels=11, floor=0.02, ceiling=0.85
    )
    aimed = np.clip(0.85 * table.wanted, 0.02, 0.85)
    assert np.max(np.abs(table.transmittance - aimed)) <= 0.83 / 10 / 2 + 1e-12
    assert table.level.min() == 0
    assert table.level.max() == 10


def test_the_table_is_in_the_units_that_it_names():
    """Milliseconds from mid-exposure, and the sensor at a t^2 px with 2 a t px/s there."""
    table = drive_table(a_design(HannShutter()), num_steps=8, num_levels=11)
    half = float(MOTION.half_exposure)
    time = half * (np.arange(8) / 4 - 1)
    position = float(MOTION.stroke) * (time / half) ** 2
    velocity = float(MOTION.top_speed) * time / half
    columns = (time * 1e3, table.wanted, table.level, table.transmittance, position, velocity)
    lines = table.to_csv().splitlines()
    rows = [[float(cell) for cell in line.split(",")] for line in lines[2:]]
    assert lines[1] == "ms,1,1,1,px,px/s"
    np.testing.assert_allclose(rows, np.transpose(columns), rtol=1e-8)
    document = table.to_dict()
    assert document["step_ms"] == pytest.approx(2e3 * half / 8)
    np.testing.assert_allclose(document["begin_ms"], columns[0])
    np.testing.assert_allclose(document["sensor_position_px"], position)
    np.testing.assert_allclose(document["sensor_velocity_px_per_s"], velocity)


def test_the_sensor_of_a_table_pans():
    """It is at v t + a t^2 px, with v + 2 a t px/s; one of no acceleration at v t."""
    half = float(MOTION.half_exposure)
    time = half * (np.arange(8) / 4 - 1)
    for motion in (panned(MOTION, -713.0), LinearMotion(half_exposure=half, velocity=-713.0)):
        table = drive_table(replace(a_design(HannShutter()), motion=motion), num_steps=8)
        a = float(motion.acceleration)
        position, velocity = -713.0 * time + a * time**2, -713.0 + 2 * a * time
        document = table.to_dict()
        np.testing.assert_allclose(document["sensor_position_px"], position, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(document["sensor_velocity_px_per_s"], velocity, rtol=1e-12)
        rows = [[float(x) for x in line.split(",")] for line in table.to_csv().splitlines()[2:]]
        np.testing.assert_allclose(np.array(rows)[:, -2:], np.c_[position, velocity], rtol=1e-8)


def test_a_fine_table_measures_as_the_design():
    """With many steps and levels nothing is lost; with two levels something is."""
    design = a_design(HannShutter())
    fine = drive_table(design, num_steps=512, num_levels=1 << 16)
    coarse = drive_table(design, num_steps=16, num_levels=2)
    wanted = float(evaluate(SCENE, MOTION, HannShutter()).expected_psnr)
    assert abs(float(fine.metrics().expected_psnr) - wanted) < 1e-3
    assert float(coarse.metrics().expected_psnr) < wanted - 0.05


BAD = {
    "no-steps": ({"num_steps": 0}, r"num_steps=...\)` must be a positive integer; got 0"),
    "steps": ({"num_steps": 100_001}, r"num_steps=...\)` must be at most 100000; got 100001"),
    "levels": ({"num_levels": 1}, r"num_levels=...\)` must be at least 2; got 1"),
    "floor": ({"floor": -0.1}, r"floor=...\)` must lie in \[0, 1\); got -0.1"),
    "floor-nan": ({"floor": float("nan")}, r"floor=...\)` must be finite; got nan"),
    "ceiling": (
        {"floor": 0.4, "ceiling": 0.3},
        r"must lie above the floor 0.4 and up to 1; got 0.3",
    ),
    "ceiling-high": ({"ceiling": 1.1}, r"must lie above the floor 0 and up to 1; got 1.1"),
}


@pytest.mark.parametrize("slug", BAD)
def test_what_no_hardware_has_is_refused(slug):
    """Counts and transmittances out of their range are named."""
    arguments, message = BAD[slug]
    with pytest.raises(ValueError, match=message):
        drive_table(a_design(HannShutter()), **arguments)


def test_the_command_prints_the_table(saved, capsys):
    """Without a folder the table itself is the result: names, units, one line a step."""
    assert cli.main(["export", str(saved), "--steps", "9", "--levels", "5"]) == 0
    names, units, *rows = csv.reader(io.StringIO(capsys.readouterr().out))
    assert names[0] == "begin"
    assert units[0] == "ms"
    assert len(rows) == 9
    assert {int(row[2]) for row in rows} <= set(range(5))


def test_the_command_writes_table_and_picture(saved, tmp_path, capsys):
    """With a folder, both files are there and the losses are one JSON document."""
    code = cli.main(["export", str(saved), "--steps", "9", "--json", "--out", str(tmp_path)])
    document = json.loads(capsys.readouterr().out)
    assert code == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["drive.csv", "drive.png"]
    assert len(document["level"]) == 9
    assert document["metrics"]["efficiency"] == pytest.approx(
        document["metrics_of_design"]["efficiency"], rel=0.01
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export"], "got nothing"),
        (["export", "no.json"], "No such file or directory"),
        (["export", "{saved}", "--levels", "1"], "; got '1'"),
        (
            ["export", "{saved}", "--ceiling", "0"],
            "must lie above the floor 0 and up to 1; got 0.0",
        ),
        (["export", "{saved}", "--out", "/dev/null/x"], "must be a folder that takes files"),
    ],
)
def test_mistakes_are_one_line(arguments, message, saved, capsys):
    """Exit code 2, nothing on standard output, one line on standard error."""
    code = cli.main([argument.format(saved=saved) for argument in arguments])
    out, err = capsys.readouterr()
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err


def test_a_shutter_alone_is_noa_design():
    """A table is of a profile on a motion."""
    with pytest.raises(
        ValueError, match=r"`drive_table\(design=...\)` must be a `Design`; got Hann"
    ):
        inspect.unwrap(drive_table)(HannShutter())
