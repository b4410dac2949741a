"""A burst for a laboratory: triggers of its frames, and the path of its stage."""

import csv
import io
import json
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from support.bursts import SEQUENCE, a_burst_design
from support.command_line import refused

from mishutter import Limits, SecondOrderStage, cli, frame_table
from mishutter.hardware import DRIVE_FORMATS, drive_bytes
from mishutter.model import StillCamera, TimedFrame

LIGHTS = [(-0.0111, -0.0069), (0.0022, 0.0158)]


def rows_of(text):
    return list(csv.DictReader(io.StringIO(text)))[1:]


def test_triggers_are_exact_in_their_file_and_rounded_in_the_table():
    """Each frame begins and ends within half a step of its own time."""
    table = frame_table(a_burst_design(), num_steps=269)
    triggers = [
        [float(row[name]) for name in ("begin", "end")] for row in rows_of(table.frames_csv())
    ]
    np.testing.assert_allclose(triggers, 1e3 * np.array(LIGHTS), rtol=1e-6)
    step = 0.0269 / 269
    for number, (first, last) in enumerate(LIGHTS, 1):
        own = table.begin[table.frame == number]
        assert own[0] == pytest.approx(first, abs=0.51 * step)
        assert own[-1] + step == pytest.approx(last, abs=0.51 * step)
    assert list(np.unique(table.frame)) == [0, 1, 2]


def test_the_stage_is_where_the_frames_want_it():
    """From rest to rest, each row in its part; the second frame falls by its own parabola."""
    rows = rows_of(frame_table(a_burst_design()).stage_csv())
    parts = [part for part, _ in groupby(row["part"] for row in rows)]
    assert parts == ["rest", "frame 1", "between frames", "frame 2", "run-out", "rest"]
    second = [row for row in rows if row["part"] == "frame 2"]
    time = np.array([float(row["time"]) for row in second]) / 1e3 - 0.009
    place = [float(row["sensor_position"]) for row in second]
    np.testing.assert_allclose(place, 2.5 - 2.3e5 * time**2, atol=2e-4)
    first = [float(row["sensor_position"]) for row in rows if row["part"] == "frame 1"]
    np.testing.assert_allclose(first, 1.5, atol=1e-9)


def test_a_stage_that_follows_late_is_sent_more():
    """The command of its own column is another path; without a limit there is none."""
    own, sent = {}, {}
    for name, stage in (("none", None), ("late", SecondOrderStage(bandwidth=90, damping=0.7))):
        limits = Limits(max_stroke=40, max_half_exposure=0.012, max_acceleration=1.4e6, stage=stage)
        rows = rows_of(frame_table(a_burst_design(limits=limits)).stage_csv())
        own[name] = [float(row["sensor_position"]) for row in rows]
        sent[name] = [float(row.get("sent_position", "nan")) for row in rows]
    assert own["late"] == own["none"]
    assert np.max(np.abs(np.subtract(sent["late"], own["late"]))) > 1
    unlimited = Limits(max_stroke=40, max_half_exposure=0.012)
    assert frame_table(a_burst_design(limits=unlimited)).stage_csv() is None


@pytest.mark.parametrize("form", DRIVE_FORMATS)
def test_every_format_opens_in_frames_alone(form, tmp_path):
    """Its channel, or its gate, or its pulses, are on for as long as the frames."""
    table = frame_table(a_burst_design(), num_steps=269)
    written = drive_bytes(table, form)
    if form == "pulses":
        rows = rows_of(written.decode())
        widths = [float(row["width"]) for row in rows]
        np.testing.assert_allclose(widths, [4200.0, 13600.0], rtol=1e-6)
    if form == "npy":
        channels = np.load(io.BytesIO(written))
        np.testing.assert_array_equal(channels[2, :-1], table.frame > 0)
        np.testing.assert_array_equal(channels[0, :-1], np.where(table.frame > 0, 1, -1))
        np.testing.assert_allclose(channels[1, :-1] * table.position_scale, table.position)
    if form == "column":
        np.testing.assert_array_equal(np.loadtxt(io.BytesIO(written)) > 0, table.frame > 0)


def test_export_writes_them(tmp_path, capsys):
    """The frames are printed; options of levels are refused for what they do not do."""
    a_burst_design().save(tmp_path / "design.json")
    out = tmp_path / "out"
    command = ["export", str(tmp_path / "design.json")]
    assert cli.main([*command, "--out", str(out), "--json", "--steps", "269"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["files"] == ["drive.csv", "frames.csv", "drive.png", "stage.csv"]
    assert {path.name for path in out.iterdir()} == set(document["files"])
    assert len(document["begin_ms"]) == 269
    for option in (["--levels", "4"], ["--floor", "0.1"], ["--ceiling", "0.9"]):
        assert option[0] in refused(capsys, *command, *option)


def test_a_design_without_frames_has_no_table():
    """And its stills need no stage."""
    with pytest.raises(ValueError, match="hold the frames of a burst"):
        frame_table(a_burst_design(None))
    still = [TimedFrame(StillCamera(half_exposure=0.002), time) for time in (-0.01, 0.01)]
    stills = replace(SEQUENCE, frames=tuple(still), travel=0.0)
    assert frame_table(a_burst_design(stills)).stage_csv() is None
