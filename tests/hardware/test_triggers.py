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
from support.plane import a_plane_design

from mishutter import (
    Design,
    Limits,
    SecondOrderStage,
    Sensor,
    cli,
    frame_table,
    simulate_frames,
)
from mishutter.evaluation.levels import exposures_psnr
from mishutter.hardware.drive_files import DRIVE_FORMATS, drive_bytes
from mishutter.model.frame_path import TimedFrame
from mishutter.model.motion import StillCamera

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


@pytest.mark.parametrize("rows_read", ["down", "up"])
def test_a_trigger_begins_the_row_that_is_read_first(rows_read, tmp_path):
    """That row of a capture is where the two files say between each trigger's begin and end."""
    readout, slope = 0.004, 0.003
    sensor = Sensor(readout=readout, rows_read=rows_read)
    a_burst_design(sensor=sensor).save(tmp_path / "design.json")
    design = Design.load(tmp_path / "design.json")
    table = frame_table(design)
    ramp = np.tile(0.2 + slope * np.arange(160.0), (5, 1))
    taken = np.asarray(simulate_frames(ramp, design.scene, design.sequence.frames, speed=0.0))
    first, last = (0, -1) if rows_read == "down" else (-1, 0)
    rows = rows_of(table.stage_csv())
    time, place = ([float(row[name]) for row in rows] for name in ("time", "sensor_position"))
    triggers = rows_of(table.frames_csv())
    # Pictures stand where a straight line between the frames is at the begin of their clock.
    ends = 1e3 * np.array([LIGHTS[0][1], LIGHTS[1][0]])
    middle = np.interp(0.0, ends, np.interp(ends, time, place))
    for frame, trigger in zip(taken, triggers, strict=True):
        instants = np.linspace(float(trigger["begin"]), float(trigger["end"]), 2001)
        for row, delay in ((first, 0.0), (last, 1e3 * readout)):
            way = np.mean(np.interp(instants + delay, time, place)) - middle
            moved = np.mean(ramp[row] - frame[row], where=np.arange(160) % 120 > 39) / slope
            assert moved == pytest.approx(way, abs=0.01), (row, trigger["frame"])
    assert abs(float(triggers[0]["begin"]) - 1e3 * (LIGHTS[0][0] - readout / 2)) < 1e-6


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


def _touching(**others):
    """Three frames that touch, of two lengths."""
    halves = (0.0031, 0.0031, 0.0052)
    times = (-0.0083, -0.0021, 0.0062)
    frames = [
        TimedFrame(StillCamera(half_exposure=half), time)
        for half, time in zip(halves, times, strict=True)
    ]
    return a_burst_design(replace(SEQUENCE, frames=tuple(frames), travel=0.0), **others)


@pytest.mark.parametrize("num_steps", [None, 23, 114])
def test_frames_that_touch_have_a_pulse_each(num_steps):
    """The gate closes for a step between them, in the table, its list of pulses and its file."""
    table = frame_table(_touching(), num_steps=num_steps)
    gate = table.gate.astype(int)
    assert np.sum(np.diff(np.r_[0, gate, 0]) > 0) == 3
    assert np.sum(gate == 0) == 2
    assert len(rows_of(drive_bytes(table, "pulses").decode())) == 3
    lit = [end - begin for begin, end in table.gated_lights]
    step = table.exposure / gate.size
    wanted = np.array([0.0062, 0.0062, 0.0104]) - [step, step, 0.0]
    np.testing.assert_allclose(lit, wanted, atol=1e-9 if num_steps == 114 else 1.01 * step)
    triggers = [float(row["exposure"]) for row in rows_of(table.frames_csv())]
    np.testing.assert_allclose(triggers, [6.2, 6.2, 10.4])


def test_the_level_counts_a_gate_that_closes():
    """By the formula of all frames, at the exposures that the gate leaves."""
    design = _touching()
    table = frame_table(design, num_steps=57)
    cameras = [StillCamera(half_exposure=(end - begin) / 2) for begin, end in table.gated_lights]
    level = exposures_psnr(design.scene, [TimedFrame(each, 0.0) for each in cameras])
    assert table.gated_psnr == pytest.approx(float(level), abs=1e-3)
    whole = exposures_psnr(design.scene, design.sequence.frames)
    assert abs(whole - table.gated_psnr) > 0.02
    assert table.to_dict()["gated_psnr_db"] == table.gated_psnr


@pytest.mark.parametrize("readout", [0.0, 4e-3])
def test_a_gate_opens_on_the_path_of_the_middle_row(readout):
    """Triggers are on the clock of the first row; a gate of exact steps costs nothing there."""
    design = a_burst_design(sensor=Sensor(readout=readout))
    table = frame_table(design, num_steps=269)
    np.testing.assert_allclose(table.gated_lights, np.array(LIGHTS) - readout / 2, atol=1e-7)
    whole = float(exposures_psnr(design.scene, design.sequence))
    assert table.gated_psnr == pytest.approx(whole, abs=1e-3)


def test_export_says_what_a_gate_costs(tmp_path, capsys):
    """And which file has exact times, for a camera that needs no gate."""
    _touching().save(tmp_path / "design.json")
    assert cli.main(["export", str(tmp_path / "design.json"), "--out", str(tmp_path / "out")]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "the gate closes for one step of 0.0297 ms at the end of 2 frames" in said
    assert "frames.csv has the exact times" in said


def test_a_frame_needs_a_step():
    """Fewer steps than leave each frame one are refused."""
    with pytest.raises(ValueError, match=r"leave each of 3 frames a step, and one between two"):
        frame_table(_touching(), num_steps=3)


def test_the_stage_has_micrometres_where_the_pitch_is_known():
    """Beside the pixels: the path and what is sent, um, and the velocity, mm/s."""
    stage = SecondOrderStage(bandwidth=90, damping=0.7)
    limits = Limits(max_stroke=40, max_half_exposure=0.012, max_acceleration=1.4e6, stage=stage)
    sensor = Sensor(pixel_pitch=3.45e-6)
    text = frame_table(a_burst_design(limits=limits, sensor=sensor)).stage_csv()
    units = dict(zip(*(line.split(",") for line in text.splitlines()[:2]), strict=True))
    assert units["sensor_position_um"] == units["sent_position_um"] == "um"
    assert units["sensor_velocity_mm_per_s"] == "mm/s"
    rows = rows_of(text)
    for name, other, scale in (
        ("sensor_position", "sensor_position_um", 3.45),
        ("sent_position", "sent_position_um", 3.45),
        ("sensor_velocity", "sensor_velocity_mm_per_s", 3.45e-3),
    ):
        px, metric = ([float(row[key]) for row in rows] for key in (name, other))
        np.testing.assert_allclose(metric, scale * np.array(px), rtol=1e-7, atol=1e-9)
    assert "um" not in frame_table(a_burst_design(limits=limits)).stage_csv().splitlines()[1]


@pytest.mark.parametrize("readout", [None, 4e-3])
@pytest.mark.parametrize("made", [a_burst_design, a_plane_design])
def test_places_of_frames_are_those_of_the_path_at_their_middles(made, readout):
    """Along one axis and along two, beside the names of what is there."""
    sensor = {} if readout is None else {"sensor": Sensor(readout=readout)}
    table = frame_table(made(**sensor))
    rows = rows_of(table.stage_csv())
    time = np.array([float(row["time"]) for row in rows]) / 1e3
    middles = np.array(table.exposures.times)
    ends = [""] if made is a_burst_design else ["_x", "_y"]
    names = [f"stage {end[1:]} / px" if end else "sensor there / px" for end in ends]
    assert list(table.places) == names
    for end, places in zip(ends, table.places.values(), strict=True):
        path = [float(row[f"sensor_position{end}"]) for row in rows]
        np.testing.assert_allclose(places, np.interp(middles, time, path), atol=2e-3)
    lights = table.lights
    half = 0.0 if readout is None else readout / 2
    np.testing.assert_allclose(np.mean(lights, axis=1), middles - half, atol=1e-12)


def test_a_table_says_what_it_is_of():
    """The frames of each step, the level by the gate, and the document of the design's frames."""
    table = frame_table(a_burst_design(), num_steps=269)
    document = table.to_dict()
    assert document["frame"] == table.frame.tolist()
    assert document["gated_psnr_db"] == table.gated_psnr
    assert document.keys() > a_burst_design().frames_document.keys()
    np.testing.assert_array_equal(table.level, table.frame > 0)
    np.testing.assert_array_equal(table.transmittance, table.frame > 0)
    assert table.num_levels == 2
    assert frame_table(a_burst_design()).begin.size == 2 * 256
    for count, line in ((0, "be a positive integer"), (100_001, "be at most 100000")):
        with pytest.raises(ValueError, match=line):
            frame_table(a_burst_design(), num_steps=count)
