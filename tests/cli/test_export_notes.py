"""What `export` tells to set by hand, in the units that it names."""

import pytest
from support.bursts import a_burst_design
from support.drive import a_design

from mishutter import FirstOrderDevice, Limits, TukeyShutter, drive_table, frame_table
from mishutter.cli.export import FormatName, _note_what_to_set, _write
from mishutter.design.design import given_design


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
