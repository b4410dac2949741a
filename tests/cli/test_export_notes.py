"""What `export` tells to set by hand, in the units that it names."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.bursts import SEQUENCE, a_burst_design
from support.drive import a_design
from support.plane import a_plane_design

from mishutter import (
    FirstOrderDevice,
    Limits,
    Sensor,
    StillCamera,
    TimedFrame,
    TukeyShutter,
    drive_table,
    frame_table,
)
from mishutter.cli.export import (
    FormatName,
    _deliver,
    _note_ends,
    _note_motion_at_ends,
    _note_what_to_set,
    _print_frames,
    _write,
)
from mishutter.design.design import given_design


@pytest.mark.parametrize(
    ("scale", "shown"), [(1.0, ("-30.00", "-7.50")), (1e-3, ("-0.0300", "-0.0075"))]
)
def test_frames_of_microseconds_have_times_of_their_own(scale, shown, capsys):
    """The middle of a frame is told to a tenth of the shortest exposure."""
    exposures = SimpleNamespace(
        times=np.array([-0.03, -0.0075]) * scale,
        exposures=np.array([4e-3, 3e-3]) * scale,
        text="two",
    )
    _print_frames(SimpleNamespace(exposures=exposures, places={}))
    out = capsys.readouterr().out
    assert all(f" {time} " in out for time in shown)


def test_a_shutter_stands_at_its_first_level_for_its_settling_time(capsys):
    """The delay and the time to a thousandth of a step, in ms, before the exposure."""
    device = FirstOrderDevice(rise_time=1.7e-3, fall_time=4.1e-3, num_slots=16, delay=0.6e-3)
    plain = a_design(TukeyShutter(0.4))
    scene = type(plain.scene)(
        plain.scene.speeds,
        photon_rate=1e5,
        read_noise=10.0,
        limits=plain.scene.limits,
        device=device,
    )
    design = given_design(scene, plain.motion, TukeyShutter(0.4), "Given.")
    table = drive_table(design)
    _note_what_to_set(table, FormatName("npy"))
    said = " ".join(capsys.readouterr().err.split())
    assert f"at least {float(device.settling_time) * 1e3:.3g} ms before the exposure" in said
    assert 5 < float(device.settling_time) * 1e3 < 50
    assert f"samples in {table.exposure * 1e3:.5g} ms" in said


@pytest.mark.parametrize("travel", [3.0, None])
def test_a_burst_says_that_its_stage_travels_too_far(travel, tmp_path, capsys):
    """Beside the table that has the path; without a limit there is nothing to say."""
    limits = Limits(max_travel=travel, max_acceleration=1.4e6, max_stroke=40.0)
    table = frame_table(a_burst_design(limits=limits), num_steps=13)
    assert "stage.csv" in _write(table, tmp_path, FormatName("csv"))
    assert (tmp_path / "stage.csv").exists()
    said = " ".join(capsys.readouterr().err.split())
    assert ("stage.csv travels" in said) == (travel is not None)


@pytest.mark.parametrize(
    ("pan", "words"), [(-1250.0, "-1,250"), ((880.0, -35.5), "880, -35.5"), (0.0, None)]
)
def test_a_camera_that_turns_is_told_of(pan, words, tmp_path, capsys):
    """Beside the files, which are for the stage and the shutter."""
    design = a_plane_design() if np.ndim(pan) else a_burst_design()
    own = replace(design, sequence=replace(design.sequence, pan=pan))
    _write(frame_table(own, num_steps=64), tmp_path, FormatName("csv"))
    said = " ".join(capsys.readouterr().err.split())
    if words is None:
        assert "the camera turns" not in said
    else:
        assert f"the camera turns at {words} px/s meanwhile" in said


def test_a_trigger_is_of_the_row_that_is_read_first(capsys):
    """The middle row comes half of the readout later, and the last all of it; so in a document."""
    table = frame_table(a_burst_design(sensor=Sensor(readout=5e-3)), num_steps=64)
    _deliver(table, [], None, FormatName("csv"), as_json=True)
    out, err = capsys.readouterr()
    said = " ".join(err.split())
    assert "the middle one comes 2.5 ms later, and the last 5 ms" in said
    assert json.loads(out)["gated_psnr_db"] == pytest.approx(table.gated_psnr)
    _deliver(frame_table(a_burst_design()), [], None, FormatName("csv"), as_json=True)
    assert "row that is read first" not in capsys.readouterr().err


@pytest.mark.parametrize("form", ["npy", "keysight", "csv"])
def test_samples_that_begin_in_motion_say_how_fast(form, capsys):
    """At the first light and at the last, for formats that have no run-up."""
    table = frame_table(a_burst_design(), num_steps=64)
    (path,) = table.paths.values()
    _note_motion_at_ends(table, FormatName(form))
    said = " ".join(capsys.readouterr().err.split())
    first, last = path.at(np.array([-0.0111, 0.0158]))[1]
    words = f"its places begin at {first:,.0f} px/s and end at {last:,.0f} px/s"
    assert (words in said) == (form != "csv")
    assert abs(last) > 1000


@pytest.mark.parametrize("returns", [False, True])
def test_a_stage_that_ends_elsewhere_is_told_of(returns, capsys):
    """How far from its beginning along each axis, and in what time it is back."""
    limits = Limits(max_half_exposure=0.01, max_acceleration=9e5)
    table = frame_table(a_plane_design(limits=limits))
    _note_ends(table, returns=returns)
    said = " ".join(capsys.readouterr().err.split())
    x, y = (path.positions[-1] - path.positions[0] for path in table.paths.values())
    assert f"x {round(x, 2) + 0.0:+.2f} px, y {y:+.2f} px" in said
    way = max(abs(x), abs(y))
    h = max(np.sqrt(way / 1.8e6), way / 2 / float(limits.max_top_speed))
    assert (f"goes back in {4e3 * h:.3g} ms" in said) == returns


def test_a_burst_whose_stage_has_no_limit_has_no_path(tmp_path, capsys):
    """Which is said, with what sets one; stills have none without a word."""
    limits = Limits(max_stroke=40.0, max_half_exposure=0.012)
    stills = [TimedFrame(StillCamera(half_exposure=0.002), time) for time in (-0.01, 0.01)]
    at_rest = replace(SEQUENCE, frames=tuple(stills), travel=0.0)
    for sequence, is_said in ((SEQUENCE, True), (at_rest, False)):
        table = frame_table(a_burst_design(sequence, limits=limits), num_steps=13)
        files = _write(table, tmp_path, FormatName("csv"))
        assert files == ["drive.csv", "frames.csv", "drive.png"]
        said = "no limit sets the run-up of the stage" in " ".join(capsys.readouterr().err.split())
        assert said == is_said
