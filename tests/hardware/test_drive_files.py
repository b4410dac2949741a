"""Drive tables there and back: what each format keeps.

A format keeps a drive to its own resolution: text and arrays to rounding, a Rigol word to
half of 1/16,383, a list of pulses to the step. What a file lacks is that of the design.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.bad_drives import npy
from support.designs import MOTION, SCENE
from support.drive import a_design

from mishutter import (
    ChippedShutter,
    IdealDevice,
    ParabolicMotion,
    Scene,
    SplineShutter,
    drive_table,
    evaluate,
    read_drive,
)
from mishutter.hardware.drive import design_from_drive
from mishutter.hardware.drive_files import DRIVE_FORMATS, DriveWarning

PANNING = MOTION.panned(-713.0)
OTHER = ParabolicMotion(acceleration=3.7e4, half_exposure=MOTION.half_exposure, velocity=55.0)
"""A motion that no file here holds."""
LEVELS = {"floor": 0.02, "ceiling": 0.85}
HALF = float(MOTION.half_exposure)

KEEPS = {
    "csv": (1e-8, True),
    "column": (1e-15, False),
    "keysight": (1e-15, True),
    "rigol": (0.83 / 2 / 16383 * (1 + 1e-9), False),
    "siglent": (1e-15, False),
    "npy": (1e-15, True),
}
"""Largest error of a transmittance, and whether positions travel."""


def a_table(**options):
    design = replace(a_design(SplineShutter([0.2, 0.7, 0.9, 1.0, 0.4])), motion=PANNING)
    return drive_table(design, num_steps=37, **options)


@pytest.mark.parametrize("form", KEEPS)
def test_a_table_comes_back_to_the_resolution_of_its_format(form, tmp_path):
    """Transmittances and, where they travel, positions are those that were written."""
    table = a_table(num_levels=19, **LEVELS)
    path = tmp_path / f"table{DRIVE_FORMATS[form]}"
    table.save(path, form=form)
    found = read_drive(path, OTHER, position_scale=table.position_scale, **LEVELS)
    error, moves = KEEPS[form]
    steps = np.asarray(found.shutter.transmittances)
    np.testing.assert_allclose(steps, table.transmittance, rtol=0, atol=error)
    assert float(found.motion.half_exposure) == pytest.approx(HALF, rel=1e-9)
    wanted = PANNING if moves else OTHER
    for name in ("acceleration", "velocity"):
        assert float(getattr(found.motion, name)) == pytest.approx(
            float(getattr(wanted, name)), rel=1e-6
        )


def test_every_format_is_held_to_its_resolution():
    """A new format has a line here, but pulses, which are of two levels."""
    assert {*KEEPS, "pulses"} == set(DRIVE_FORMATS)


@pytest.mark.parametrize("form", ["column", "keysight", "npy"])
def test_two_to_a_power_of_levels_come_back_bit_for_bit(form, tmp_path):
    """Drives that binary numbers hold are the same bits, there and back."""
    table = a_table(num_levels=(1 << 8) + 1)
    path = tmp_path / f"table{DRIVE_FORMATS[form]}"
    table.save(path, form=form)
    found = read_drive(path, PANNING)
    assert np.array_equal(np.asarray(found.shutter.transmittances), table.transmittance)
    if form != "keysight":
        assert found.motion is PANNING


def test_pulses_come_back_bit_for_bit(tmp_path):
    """Steps open and closed are the same after their list of widths; the light is kept."""
    table = a_table(num_levels=2, carries_error=True)
    assert abs(np.sum(table.transmittance) - np.sum(table.wanted)) <= 0.5
    table.save(tmp_path / "pulses.csv", form="pulses")
    found = read_drive(tmp_path / "pulses.csv", PANNING)
    assert np.array_equal(np.asarray(found.shutter.transmittances), table.transmittance)


@pytest.mark.parametrize("chips", [[0.0] * 5, [1.0] * 5, [0.3, 0.4]], ids=["0", "1", "rounds to 0"])
def test_pulses_of_one_level_come_back(chips, tmp_path):
    """A shutter that never opens has a list without a pulse, one that never closes a whole one."""
    table = drive_table(a_design(ChippedShutter(chips)), num_steps=5, num_levels=2)
    table.save(tmp_path / "pulses.csv", form="pulses")
    found = read_drive(tmp_path / "pulses.csv", PANNING)
    assert found.shutter.transmittances.tolist() == [table.transmittance[0]]
    assert found.motion is PANNING


def test_pulses_of_any_edges_keep_their_light(tmp_path):
    """Edges on no grid are averaged over small steps: every pulse lasts as long as it did."""
    text = "wait,width\nus,us\n137.31,411.07\n1213.9,77.7\n3000.123,9000.456\n"
    (tmp_path / "mine.csv").write_text(text)
    shutter = read_drive(tmp_path / "mine.csv", MOTION).shutter
    open_us = 411.07 + 77.7 + 9000.456
    assert float(shutter.efficiency()) == pytest.approx(open_us / (HALF * 2e6), rel=1e-12)
    assert shutter.transmittances.size == 2048
    begin = (137.31 + 411.07 + 1213.9 + 77.7 + 3000.123) / (HALF * 1e6) - 1
    assert float(shutter.transmittance(begin - 0.002)) == 0
    assert float(shutter.transmittance(begin + 0.002)) == 1


def test_levels_with_errors_carried_are_within_one_of_the_sum():
    """Error diffusion: the sum of the levels up to each step is nearest to that of the profile."""
    table = a_table(num_levels=5, carries_error=True)
    behind = np.cumsum(table.level) - np.cumsum(4 * table.wanted)
    assert np.max(np.abs(behind)) <= 0.5 + 1e-9
    assert table.level.min() >= 0
    assert table.level.max() <= 4


def test_a_keysight_file_is_what_its_maker_describes(tmp_path):
    """A parameter header, a data header, values in [-1, 1], and a marker that falls at the end."""
    table = a_table(num_levels=9)
    table.save(tmp_path / "keysight.csv", form="keysight")
    rate, names, *rows = (tmp_path / "keysight.csv").read_text("utf-8").splitlines()
    assert float(rate.removeprefix("SampleRate=")) == pytest.approx(37 / (2 * HALF))
    assert names == "Y1,Y2,SampleMarker1"
    numbers = np.array([[float(x) for x in row.split(",")] for row in rows])
    assert numbers.shape == (38, 3)
    assert np.all(np.abs(numbers) <= 1)
    assert np.max(np.abs(numbers[:, 1])) == 1
    assert numbers[:, 2].tolist() == [1] * 37 + [0]


def test_a_siglent_file_is_as_others_write_it(tmp_path):
    """Settings, seven empty lines, names in line 13, then times in s and values in [-1, 1]."""
    path = tmp_path / "siglent.csv"
    a_table(num_levels=9).save(path, form="siglent")
    lines = path.read_text("utf-8").splitlines()
    assert lines[0] == "data length,37"
    assert float(lines[1].removeprefix("frequency,")) == pytest.approx(1 / (2 * HALF))
    assert lines[2:13] == ["amp,2", "offset,0", "phase,0", *[""] * 7, "xpos,value"]
    numbers = np.array([[float(x) for x in line.split(",")] for line in lines[13:]])
    np.testing.assert_allclose(numbers[:, 0], np.arange(37) * 2 * HALF / 37, rtol=1e-9)
    assert np.all(np.abs(numbers[:, 1]) <= 1)
    text = path.read_text("utf-8")
    for change, message in (
        (("amp,2", "amp,5"), "have amp,2, by which values are from -1 to 1; got amp,5"),
        (("data length,37", "data length,36"), "hold its data length, 36 values; got 37"),
        (("frequency,", "frequency,-"), "have a frequency above 0 Hz; got '-"),
        (("phase,0", "phase,90"), "have phase,0, by which values begin with the exposure; got ph"),
        (("amp,2", "amp,2\nAMP,4"), "have each of its settings once; got amp,2"),
    ):
        path.write_text(text.replace(*change))
        with pytest.raises(ValueError, match=message):
            read_drive(path, OTHER)


def test_a_rigol_file_is_what_its_maker_describes(tmp_path):
    """Two bytes a point, low byte first, from 0x0000, the low level, to 0x3FFF, the high one."""
    chips = replace(a_design(ChippedShutter([0.0, 1.0, 0.25])), motion=MOTION)
    drive_table(chips, num_steps=3).save(tmp_path / "table.RAF", form="rigol")
    word = round(64 / 255 * 0x3FFF)
    expected = bytes([0x00, 0x00, 0xFF, 0x3F, word & 0xFF, word >> 8])
    assert (tmp_path / "table.RAF").read_bytes() == expected


@pytest.mark.parametrize("length", [8192, 16384])
def test_a_rigol_file_that_is_filled_up_is_read_by_its_steps(length, tmp_path):
    """The zeros up to a generator's length are no part of the exposure, where that is told."""
    path, profile = tmp_path / "drive.RAF", np.array([0, 3000, 16383, 0, 9001, 0])
    words = np.zeros(length, "<u2")
    words[: profile.size] = profile
    path.write_bytes(words.tobytes())
    with pytest.raises(ValueError, match=rf"got {length} words, the last {length - 5} of them 0"):
        read_drive(path, MOTION)
    found = read_drive(path, MOTION, num_steps=6, **LEVELS).shutter.transmittances
    np.testing.assert_allclose(found, 0.02 + 0.83 * profile / 16383, rtol=1e-12)
    design = design_from_drive(path, SCENE, MOTION, num_steps=6)
    np.testing.assert_allclose(design.shutter.transmittances, profile / 16383, rtol=1e-12)
    with pytest.raises(ValueError, match="hold zeros alone after 4 steps; got 1 other words"):
        read_drive(path, MOTION, num_steps=4)


def test_a_rigol_file_may_be_closed_at_both_of_its_ends(tmp_path):
    """A profile of a generator's own length whose ends are alike is not taken for one filled up."""
    path, words = tmp_path / "drive.RAF", np.zeros(8192, "<u2")
    words[2500:5900] = 11000
    path.write_bytes(words.tobytes())
    steps = np.asarray(read_drive(path, MOTION).shutter.transmittances)
    assert steps.mean() == pytest.approx(11000 / 16383 * 3400 / 8192, rel=1e-12)


def test_steps_that_are_told_are_those_of_the_file(tmp_path):
    """A file that is not filled up has its own number of steps."""
    path = tmp_path / "drive.csv"
    a_table().save(path, form="column")
    assert read_drive(path, MOTION, num_steps=37).shutter.transmittances.shape == (37,)
    with pytest.raises(ValueError, match="must have the 36 steps that were given; got 37"):
        read_drive(path, MOTION, num_steps=36)


@pytest.mark.parametrize(
    "markers", [("SampleMarker1", "SampleMarker2"), ("SyncMarker2", "SampleMarker1", "SyncMarker1")]
)
def test_a_keysight_file_may_have_more_markers(markers, tmp_path):
    """`SampleMarker1` is the gate; markers of another output say nothing of the exposure."""
    drive, gate = [-0.9, 0.3, 0.7, -0.2], [1, 1, 1, 0]
    columns = {name: gate if name == "SampleMarker1" else [0, 1, 0, 1] for name in markers}
    rows = zip(drive, *columns.values(), strict=True)
    text = "\n".join(",".join(map(str, row)) for row in rows)
    head = f"SampleRate=200\nSetConfig=true\nY1,{','.join(markers)}\n"
    (tmp_path / "drive.csv").write_text(head + text + "\n")
    found = read_drive(tmp_path / "drive.csv", OTHER)
    np.testing.assert_allclose(found.shutter.transmittances, [0.05, 0.65, 0.85], rtol=1e-12)
    assert float(found.motion.half_exposure) == pytest.approx(3 / 200 / 2)


def test_a_table_edited_by_hand_is_taken_as_it_is(tmp_path):
    """Columns that are not needed may go, and a transmittance that changed is what is sent."""
    path = tmp_path / "mine.csv"
    path.write_text("begin,transmittance\nms,1\n-15,0.25\n-5,1\n5,0.125\n")
    found = design_from_drive(path, SCENE, MOTION)
    assert np.asarray(found.command.transmittances).tolist() == [0.25, 1, 0.125]
    assert float(found.motion.half_exposure) == pytest.approx(0.015)
    assert float(found.motion.acceleration) == float(MOTION.acceleration)
    expected = evaluate(SCENE, found.motion, ChippedShutter([0.25, 1.0, 0.125]))
    assert float(found.metrics.expected_psnr) == float(expected.expected_psnr)


def test_a_units_suffix_of_a_sample_rate_counts(tmp_path):
    """`SampleRate = 0.6 kHz`, as Keysight's own example writes it, is 600 a second."""
    path = tmp_path / "mine.csv"
    for key in ("SampleRate = ", "sample_rate=", "Sample Rate="):
        path.write_text(f"{key}0.6 kHz\nY1\n" + "-0.5\n" * 12)
        assert float(read_drive(path, MOTION).motion.half_exposure) == pytest.approx(0.01)


@pytest.mark.parametrize(
    "key", ["SamplingRate", "SamplingFrequency", "Sample_Clock", "dt", "SampleInterval"]
)
def test_a_setting_that_is_not_read_is_said(key, tmp_path):
    """A time that hides in an unknown setting is not passed over, with a known rate or without."""
    path = tmp_path / "mine.csv"
    for others, half, without in (
        ("", HALF, True),
        ("SetConfig=true\nSampleRate=700\n", 0.01, False),
    ):
        path.write_text(f"{others}{key}=5000\nY1\n" + "-0.5\n0.25\n" * 7)
        with pytest.warns(
            DriveWarning, match=rf"has settings that are not read, {key}=5000"
        ) as told:
            found = read_drive(path, MOTION)
        assert float(found.motion.half_exposure) == pytest.approx(half)
        assert (
            "and no SampleRate: its exposure is the design's" in str(told[0].message)
        ) == without
    a_table(num_levels=9).save(path, form="siglent")
    path.write_text(path.read_text("utf-8").replace("offset,0", f"{key},3200\noffset,0"))
    with pytest.warns(DriveWarning, match=f"settings that are not read, {key},3200$"):
        assert float(read_drive(path, OTHER).motion.half_exposure) == pytest.approx(HALF)


FROM_0_TO_1 = {"binary": [0, 0, 1, 1, 0], "graded": [0.004, 0.3, 0.97, 0.31], "half": [0.5, 0.5]}


@pytest.mark.parametrize("slug", FROM_0_TO_1)
def test_a_drive_that_never_closes_is_said(slug, tmp_path):
    """Numbers from 0 to 1 are drives of a shutter that is half open at least; one word says so."""
    drives = np.array(FROM_0_TO_1[slug])
    column = "".join(f"{x}\n" for x in drives)
    files = {
        "column.csv": column.encode(),
        "keysight.csv": b"SampleRate=700\nY1\n" + column.encode(),
        "array.npy": npy(drives[None]),
    }
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
        least = f"its shutter never closes: its least drive is {drives.min():g}, where -1 is closed"
        with pytest.warns(DriveWarning, match=f"{name}: {least}"):
            found = read_drive(tmp_path / name, MOTION).shutter
        np.testing.assert_allclose(found.transmittances, (drives + 1) / 2, rtol=1e-12)
        with pytest.warns(DriveWarning, match=least):
            design_from_drive(tmp_path / name, SCENE, MOTION)


def test_a_shutter_that_stays_open_or_closes_is_not_doubted(tmp_path):
    """A drive of 1 throughout is open on either scale, and one below 0 is from -1 to 1."""
    for drives in ([1, 1, 1], [0.2, 0.9, -0.01]):
        (tmp_path / "mine.csv").write_text("".join(f"{x}\n" for x in drives))
        steps = np.asarray(read_drive(tmp_path / "mine.csv", MOTION).shutter.transmittances)
        np.testing.assert_allclose(steps, (np.array(drives) + 1) / 2, rtol=1e-12)


def test_what_is_driven_through_a_device_loses_its_light(tmp_path):
    """A table is of what is sent: the scene's device makes of it what light sees."""
    scene = replace_device(IdealDevice(transmission=0.4, leakage=0.03))
    path = tmp_path / "mine.csv"
    path.write_text("begin,transmittance\nms,1\n-10,0\n0,1\n")
    found = design_from_drive(path, scene, MOTION)
    assert float(found.shutter.efficiency()) == pytest.approx(0.4 * (0.03 + 0.97 * 0.5))
    assert np.asarray(found.command.transmittances).tolist() == [0, 1]


def replace_device(device):
    return Scene(
        SCENE.speeds,
        SCENE.weights,
        photon_rate=1e5,
        read_noise=10.0,
        limits=SCENE.limits,
        device=device,
    )


def test_a_time_that_is_told_may_not_contradict_the_file(tmp_path):
    """A table in the wrong unit is found out where its half exposure is told too."""
    path = tmp_path / "mine.csv"
    path.write_text("begin,transmittance\nms,1\n-15,0.25\n-5,1\n5,0.125\n")
    with pytest.raises(ValueError, match=r"must have the half exposure that was given, 0.15 s; go"):
        read_drive(path, MOTION, half_exposure=0.15)


BAD = {
    "half": ({"half_exposure": 0.0}, r"read_drive\(half_exposure=...\)` must be above 0; got 0.0"),
    "scale": ({"position_scale": -1.0}, r"position_scale=...\)` must be above 0; got -1.0"),
    "scale-nan": ({"position_scale": np.nan}, r"position_scale=...\)` must be finite; got nan"),
    "floor": ({"floor": 1.0}, r"read_drive\(floor=...\)` must lie in \[0, 1\); got 1.0"),
}


@pytest.mark.parametrize("slug", BAD)
def test_what_a_reader_is_told_is_checked(slug, tmp_path):
    """Numbers that no table has are named."""
    arguments, message = BAD[slug]
    (tmp_path / "mine.csv").write_text("0.5\n")
    with pytest.raises(ValueError, match=message):
        read_drive(tmp_path / "mine.csv", MOTION, **arguments)


def test_formats_that_do_not_fit_are_refused():
    """An unknown format, and a list of pulses for a shutter of many levels."""
    with pytest.raises(ValueError, match=r"save\(form=...\)` must be one of csv, column, .*'raf'"):
        a_table().save("never", form="raf")
    with pytest.raises(ValueError, match=r"must be open or closed in each step .*; got 256 levels"):
        a_table().save("never", form="pulses")
