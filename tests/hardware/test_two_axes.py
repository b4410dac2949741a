"""The drive of a stage of two axes: its path, its formats and its servo."""

import csv
import io
import json
import re
from dataclasses import replace
from itertools import groupby

import equinox as eqx
import numpy as np
import pytest
from support.bursts import a_burst_design
from support.plane import a_plane_design, stage_paths

from mishutter import (
    Design,
    Limits,
    SecondOrderStage,
    Sensor,
    cli,
    exposures_psnr,
    frame_table,
)
from mishutter.hardware.drive_files import DRIVE_FORMATS, WITH_POSITIONS, drive_bytes
from mishutter.hardware.stage_files import with_way_back

PITCH = Sensor(pixel_pitch=4.8e-6)


def columns_of(text):
    """Columns of a table by name, without its line of units; numbers where they are numbers."""
    rows = list(csv.DictReader(io.StringIO(text)))[1:]
    names = [name for name in rows[0] if name != "part"]
    numbers = {name: np.array([float(row[name]) for row in rows]) for name in names}
    return numbers | {"part": [row.get("part") for row in rows]}


def test_both_axes_are_where_the_frames_want_them():
    """In every step the places are those of the path but for a constant, in px, um and mm/s."""
    design = a_plane_design(sensor=PITCH)
    own = columns_of(frame_table(design).stage_csv())
    parts = [part for part, _ in groupby(own["part"])]
    assert parts[:3] == ["rest", "run-up", "frame 1"]
    assert parts[-3:] == ["frame 3", "run-out", "rest"]
    lit = np.array([part.startswith("frame") for part in own["part"]])
    time = own["time"][lit] / 1e3
    for axis, place in zip("xy", np.asarray(design.sequence.frames.place(time)), strict=True):
        found = own[f"sensor_position_{axis}"][lit]
        np.testing.assert_allclose(found - found[9], place - place[9], atol=2e-6)
        inner = slice(5, 60)
        rates = np.gradient(found, time)[inner]
        np.testing.assert_allclose(own[f"sensor_velocity_{axis}"][lit][inner], rates, atol=3)
        np.testing.assert_allclose(own[f"sensor_position_{axis}_um"][lit], 4.8 * found, rtol=1e-6)
        speeds = own[f"sensor_velocity_{axis}"], own[f"sensor_velocity_{axis}_mm_per_s"]
        np.testing.assert_allclose(speeds[1], 4.8e-3 * speeds[0], rtol=1e-6)


@pytest.mark.parametrize("axes", ["each", "disc"])
@pytest.mark.parametrize("jerk", [None, 2e5])
def test_the_stage_goes_back_to_where_it_began(axes, jerk):
    """Each axis in the same time, from rest to rest, as fast as one of the limits lets it."""
    x, y = stage_paths(a_plane_design())
    x = x._replace(positions=x.positions - np.linspace(0, 7.3, x.positions.size))
    limits = Limits(max_acceleration=4e4, max_top_speed=170.0, max_jerk=jerk, axes=axes)
    paths = {"_x": x, "_y": y}
    back = with_way_back(paths, limits)
    start, end = x.times[-1], back["_x"].times[-1]
    time = np.linspace(start, end, 4001)
    moved = np.array([path.at(time) for path in back.values()])
    np.testing.assert_array_equal(back["_x"].times, back["_y"].times)
    for path, own, (place, speed) in zip(back.values(), paths.values(), moved, strict=True):
        assert path.positions[-1] == pytest.approx(path.positions[0], abs=1e-9)
        assert place[0] == pytest.approx(own.positions[-1], abs=1e-9)
        assert speed[[0, -1]].tolist() == [0.0, 0.0]
        np.testing.assert_allclose(np.gradient(place, time)[1:-1], speed[1:-1], atol=0.1)
    size = np.hypot if axes == "disc" else np.maximum
    rates = np.abs(np.gradient(moved[:, 1], time, axis=1))
    jerks = np.abs([path.jerks[-4:] for path in back.values()])
    uses = [
        np.max(size(*np.abs(moved[:, 1]))) / 170.0,
        np.max(size(*rates)) / 4e4,
        0.0 if jerk is None else np.max(size(*jerks)) / jerk,
    ]
    assert max(uses) == pytest.approx(1, abs=2e-3)


def test_a_stage_that_is_back_has_no_way():
    """Its path stays as it is; rest is where it stands still, before and after all else."""
    x, y = stage_paths(a_plane_design())
    limits = Limits(max_acceleration=4e4, max_top_speed=170.0)
    assert with_way_back({"_x": x}, limits) == {"_x": x}
    for returns in (False, True):
        own = columns_of(frame_table(a_plane_design()).stage_csv(returns=returns))
        rests = np.array([part == "rest" for part in own["part"]])
        speeds = np.hypot(own["sensor_velocity_x"], own["sensor_velocity_y"])
        assert rests[0]
        assert rests[-1]
        assert np.max(speeds[rests]) < 1e-6
        assert np.sum(rests) <= 3
        arrives = own["time"] > 1e3 * y.times[-1] + 1e-6
        back = [part == "return" for part in own["part"]]
        np.testing.assert_array_equal(back, arrives & ~rests)
        assert np.any(back) == returns


def test_the_servo_of_each_axis_is_sent_more():
    """A servo that is sent the column of an axis makes that axis, by its own equation."""
    servo = SecondOrderStage(bandwidth=170.0, damping=0.6)
    limits = Limits(max_half_exposure=0.01, max_acceleration=9e5, stage=servo)
    own = columns_of(frame_table(a_plane_design(limits=limits), num_steps=4096).stage_csv())
    step = np.diff(own["time"])[0] / 1e3
    omega = servo.natural_frequency
    for axis in "xy":
        place, speed = own[f"sensor_position_{axis}"], own[f"sensor_velocity_{axis}"]
        rate = np.gradient(speed, step)
        sent = place + servo.delay * speed + rate / omega**2
        inner = [part == "frame 2" for part in own["part"]]
        np.testing.assert_allclose(own[f"sent_position_{axis}"][inner], sent[inner], atol=0.03)
        assert np.max(np.abs(own[f"sent_position_{axis}"] - place)) > 0.3


@pytest.mark.parametrize("form", DRIVE_FORMATS)
def test_formats_have_a_channel_for_each_axis(form):
    """Both positions, over one scale, beside the gate; formats of one channel hold the gate."""
    table = frame_table(a_plane_design(), num_steps=311)
    written, scale = drive_bytes(table, form), table.position_scale
    gate = table.frame > 0
    assert scale == np.max(np.abs(table.position))
    assert table.position.shape == (2, 311)
    if form == "npy":
        channels = np.load(io.BytesIO(written))
        np.testing.assert_allclose(channels[1:3, :-1] * scale, table.position)
        np.testing.assert_array_equal(channels[[0, 3], :-1], [2.0 * gate - 1, gate])
    elif form == "keysight":
        _, names, *rows = written.decode().splitlines()
        assert names == "Y1,Y2,SampleMarker1"
        numbers = np.array([row.split(",") for row in rows], float).T
        np.testing.assert_allclose(numbers[:2, :-1] * scale, table.position)
        np.testing.assert_array_equal(numbers[2, :-1], gate)
    elif form == "csv":
        own = columns_of(written.decode())
        rows = [own[f"sensor_position_{axis}"] for axis in "xy"]
        np.testing.assert_allclose(rows, table.position, rtol=1e-6, atol=1e-7)
    else:
        assert form not in WITH_POSITIONS
        assert written == drive_bytes(_of_one_axis(table), form)


def _of_one_axis(table):
    """The same triggers of a stage at rest."""
    frames = eqx.tree_at(lambda x: x.velocities, table.design.sequence.frames, np.zeros((2, 65)))
    burst = replace(table.design.sequence, frames=frames)
    return frame_table(Design(table.design.scene, burst), num_steps=311)


def test_a_gate_costs_what_its_frames_lose():
    """Frames that touch end a step early; the level is that of frames of these lengths."""
    design = a_plane_design()
    times, exposures = np.array([-0.011, 0.0, 0.011]), np.full(3, 0.011)
    whole = eqx.tree_at(
        lambda x: (x.times, x.exposures), design.sequence.frames, (times, exposures)
    )
    design = Design(design.scene, replace(design.sequence, frames=whole))
    table = frame_table(design, num_steps=66)
    step = 0.033 / 66
    short = exposures - [step, step, 0]
    gated = eqx.tree_at(
        lambda x: (x.times, x.exposures), whole, (times - [step / 2, step / 2, 0], short)
    )
    assert table.gated_psnr == pytest.approx(float(exposures_psnr(design.scene, gated)), abs=1e-6)
    assert table.gated_psnr < float(exposures_psnr(design.scene, whole)) - 0.01


def test_export_writes_both_axes(tmp_path, capsys):
    """Files, places at mid-exposure and the document; a line names a format of one channel."""
    a_plane_design(sensor=PITCH).save(tmp_path / "design.json")
    command = ["export", str(tmp_path / "design.json")]
    assert cli.main([*command, "--out", str(tmp_path / "lab")]) == 0
    out, err = capsys.readouterr()
    assert "stage x / px  stage y / px" in out
    assert "channels" not in err
    _, y = (path.positions[-1] - path.positions[0] for path in stage_paths(a_plane_design()))
    assert f"away from where it begins: x +0.00 px, y {y:+.2f} px; --return adds" in err
    assert cli.main([*command, "--out", str(tmp_path / "back"), "--return", "--format", "npy"]) == 0
    err = capsys.readouterr().err
    assert re.search(r"; goes back in \d+(\.\d+)? ms", err)
    assert re.search(
        r"--format npy has no run-up: its places begin at -?[\d,]+, -?[\d,]+ px/s", err
    )
    own = columns_of((tmp_path / "back" / "stage.csv").read_text("utf-8"))
    assert [part for part, _ in groupby(own["part"])][-3:] == ["run-out", "return", "rest"]
    for axis in "xy":
        places = own[f"sensor_position_{axis}"]
        assert places[-1] == pytest.approx(places[0], abs=1e-6)
    written = {path.name for path in (tmp_path / "lab").iterdir()}
    assert written == {"drive.csv", "frames.csv", "drive.png", "stage.csv"}
    assert cli.main([*command, "--format", "siglent", "--json"]) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert np.shape(document["sensor_position_px"]) == (2, 3 * 256)
    assert document["plane"]["kind"] == "two sines"
    assert "--format siglent has no channels for a stage" in err
    a_burst_design().save(tmp_path / "axis.json")
    assert cli.main(["export", str(tmp_path / "axis.json"), "--format", "siglent"]) == 0
    assert "no channels" not in capsys.readouterr().err
