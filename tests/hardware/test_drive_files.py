"""Drive tables as files: what each format keeps, and what comes back of `csv` and `npy`.

A format keeps a drive to its own resolution: text and arrays to rounding, a Rigol word to
half of 1/16,383, a list of pulses to the step. What a file lacks is that of the design.
"""

from dataclasses import replace

import numpy as np
import pytest
from support.bad_drives import HALF_MS, STEPS, table
from support.designs import MOTION, SCENE
from support.drive import a_design

from mishutter import (
    ChippedShutter,
    FreeMotion,
    IdealDevice,
    Limits,
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

KEEPS = {"csv": 1e-8, "npy": 1e-15}
"""Largest error of a transmittance in the formats that are read back."""


def rows_below(path, heading):
    """Numbers of a text file below as many lines of heading."""
    return np.loadtxt(path, delimiter=",", skiprows=heading, ndmin=2)


DRIVES_OF = {
    "csv": lambda path: rows_below(path, 2)[:, 2] / 9 - 1,
    "column": lambda path: rows_below(path, 0)[:, 0],
    "keysight": lambda path: rows_below(path, 2)[:-1, 0],
    "rigol": lambda path: np.frombuffer(path.read_bytes(), "<u2") * 2 / 16383 - 1,
    "siglent": lambda path: rows_below(path, 13)[:, 1],
    "npy": lambda path: np.load(path)[0, :-1],
}
"""Drives, from -1 to 1, of a file of each format with 19 levels, as a generator takes them."""


def a_table(**options):
    design = a_design(SplineShutter([0.2, 0.7, 0.9, 1.0, 0.4]), motion=PANNING)
    return drive_table(design, num_steps=37, **options)


@pytest.mark.parametrize("form", DRIVES_OF)
def test_a_file_holds_the_drives_of_its_table(form, tmp_path):
    """Level 0 is -1 and the highest level 1, to rounding, or to half a word of 14 bits."""
    table = a_table(num_levels=19)
    path = tmp_path / f"table{DRIVE_FORMATS[form]}"
    table.save(path, form=form)
    error = (1 + 1e-9) / 16383 if form == "rigol" else 1e-15
    np.testing.assert_allclose(DRIVES_OF[form](path), table.level / 9 - 1, rtol=0, atol=error)


@pytest.mark.parametrize("form", KEEPS)
def test_a_table_comes_back_to_the_resolution_of_its_format(form, tmp_path):
    """Transmittances and positions are those that were written."""
    table = a_table(num_levels=19, **LEVELS)
    path = tmp_path / f"table{DRIVE_FORMATS[form]}"
    table.save(path, form=form)
    found = read_drive(path, OTHER, position_scale=table.position_scale, **LEVELS)
    steps = np.asarray(found.shutter.transmittances)
    np.testing.assert_allclose(steps, table.transmittance, rtol=0, atol=KEEPS[form])
    assert float(found.motion.half_exposure) == pytest.approx(HALF, rel=1e-9)
    for name in ("acceleration", "velocity"):
        assert float(getattr(found.motion, name)) == pytest.approx(
            float(getattr(PANNING, name)), rel=1e-6
        )


def test_every_format_is_held_to_its_drives():
    """A new format has a line here, but pulses, which are of two levels."""
    assert {*DRIVES_OF, "pulses"} == set(DRIVE_FORMATS)


def test_two_to_a_power_of_levels_come_back_bit_for_bit(tmp_path):
    """Drives that binary numbers hold are the same bits, there and back."""
    table = a_table(num_levels=(1 << 8) + 1)
    table.save(tmp_path / "table.npy", form="npy")
    found = read_drive(tmp_path / "table.npy", PANNING)
    assert np.array_equal(np.asarray(found.shutter.transmittances), table.transmittance)
    assert found.motion is PANNING


@pytest.mark.parametrize(
    ("shutter", "steps"),
    [
        (SplineShutter([0.2, 0.7, 0.9, 1.0, 0.4]), 37),
        (ChippedShutter([0.0] * 5), 5),
        (ChippedShutter([1.0] * 5), 5),
        (ChippedShutter([0.3, 0.4]), 5),
    ],
    ids=["spline", "0", "1", "rounds to 0"],
)
def test_pulses_last_as_long_as_the_table_is_open(shutter, steps, tmp_path):
    """A row is the time closed before a pulse, and its width; us. The light is kept."""
    table = drive_table(a_design(shutter), num_steps=steps, num_levels=2, carries_error=True)
    assert abs(np.sum(table.transmittance) - np.sum(table.wanted)) <= 0.5
    table.save(tmp_path / "pulses.csv", form="pulses")
    lines = (tmp_path / "pulses.csv").read_text("utf-8").splitlines()
    assert lines[:2] == ["wait,width", "us,us"]
    turns = np.cumsum([float(x) for line in lines[2:] for x in line.split(",")])
    middles = (np.arange(steps) + 0.5) * HALF * 2e6 / steps
    assert np.array_equal(np.searchsorted(turns, middles) % 2, table.transmittance)


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


def test_a_rigol_file_is_what_its_maker_describes(tmp_path):
    """Two bytes a point, low byte first, from 0x0000, the low level, to 0x3FFF, the high one."""
    chips = a_design(ChippedShutter([0.0, 1.0, 0.25]), motion=MOTION)
    drive_table(chips, num_steps=3).save(tmp_path / "table.RAF", form="rigol")
    word = round(64 / 255 * 0x3FFF)
    expected = bytes([0x00, 0x00, 0xFF, 0x3F, word & 0xFF, word >> 8])
    assert (tmp_path / "table.RAF").read_bytes() == expected


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


FROM_0_TO_1 = {"binary": [0, 0, 1, 1, 0], "graded": [0.004, 0.3, 0.97, 0.31], "half": [0.5, 0.5]}


@pytest.mark.parametrize("slug", FROM_0_TO_1)
def test_a_drive_that_never_closes_is_said(slug, tmp_path):
    """Numbers from 0 to 1 are drives of a shutter that is half open at least; one word says so."""
    drives = np.array(FROM_0_TO_1[slug])
    path = tmp_path / "array.npy"
    np.save(path, drives[None])
    least = f"array.npy: its shutter never closes: its least drive is {drives.min():g}, where -1"
    with pytest.warns(DriveWarning, match=least):
        found = read_drive(path, MOTION).shutter
    np.testing.assert_allclose(found.transmittances, (drives + 1) / 2, rtol=1e-12)
    with pytest.warns(DriveWarning, match=least):
        design_from_drive(path, SCENE, MOTION)


def test_a_shutter_that_stays_open_or_closes_is_not_doubted(tmp_path):
    """A drive of 1 throughout is open on either scale, and one below 0 is from -1 to 1."""
    for drives in ([1, 1, 1], [0.2, 0.9, -0.01]):
        np.save(tmp_path / "mine.npy", np.array([drives], float))
        steps = np.asarray(read_drive(tmp_path / "mine.npy", MOTION).shutter.transmittances)
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
    np.save(tmp_path / "mine.npy", np.full((1, 3), -0.5))
    with pytest.raises(ValueError, match=message):
        read_drive(tmp_path / "mine.npy", MOTION, **arguments)


@pytest.mark.parametrize("form", ["column", "keysight", "rigol", "siglent", "pulses"])
def test_a_file_for_a_generator_is_not_read_back(form, tmp_path):
    """The line names the formats that are."""
    path = tmp_path / f"table{DRIVE_FORMATS[form]}"
    a_table(num_levels=2).save(path, form=form)
    with pytest.raises(ValueError, match=r"must be (a drive table in csv, .* or npy|text, as CSV)"):
        read_drive(path, MOTION)


def test_formats_that_do_not_fit_are_refused():
    """An unknown format, and a list of pulses for a shutter of many levels."""
    with pytest.raises(ValueError, match=r"save\(form=...\)` must be one of csv, column, .*'raf'"):
        a_table().save("never", form="raf")
    with pytest.raises(ValueError, match=r"must be open or closed in each step .*; got 256 levels"):
        a_table().save("never", form="pulses")


def test_a_table_beside_a_camera_that_turns_is_of_the_stage_alone(tmp_path):
    """Its places have no pan, in the table and its file; what is read back has the camera's."""
    limits = Limits(max_half_exposure=0.02, max_acceleration=2e6, pans="camera")
    scene = Scene([-300.0, 900.0], photon_rate=1e5, read_noise=10.0, limits=limits)
    design = a_design(ChippedShutter([0.2, 1.0]), motion=PANNING, scene=scene)
    table = drive_table(design, num_steps=30)
    time = HALF * (np.arange(30) / 15 - 1)
    a = float(MOTION.acceleration)
    np.testing.assert_allclose(table.position, a * time**2, atol=1e-9)
    np.testing.assert_allclose(table.velocity, 2 * a * time, atol=1e-9)
    assert table.position_scale == pytest.approx(a * HALF**2)
    for form in ("csv", "npy"):
        path = tmp_path / f"table.{form}"
        table.save(path, form=form)
        scale = {"position_scale": table.position_scale} if form == "npy" else {}
        found = design_from_drive(path, scene, PANNING, **scale).motion
        assert float(found.velocity) == pytest.approx(-713.0, rel=1e-6)
        assert float(found.acceleration) == pytest.approx(a, rel=1e-6)
    limits = Limits(max_half_exposure=0.02, max_acceleration=2e6)
    at_stage = Scene([-300.0, 900.0], photon_rate=1e5, read_noise=10.0, limits=limits)
    other = drive_table(replace(design, scene=at_stage), num_steps=30)
    np.testing.assert_allclose(other.position, a * time**2 - 713 * time, atol=1e-9)


def test_positions_that_leave_their_path_are_refused(tmp_path):
    """By more than a thousandth of their travel, on a parabola and on the path that was given."""
    free = FreeMotion(accelerations=[3e5, 1e5, 2e5], half_exposure=HALF, velocity=-90.0)
    begin = HALF * (np.arange(24) / 12 - 1)
    for motion, words in ((MOTION, "along v t"), (free, "on the free path that was given")):
        place = np.asarray(motion.position(begin))
        share = 1e-3 * (1 + np.ptp(place))
        for aside, is_refused in ((0.5 * share, False), (2.5 * share, True)):
            bent = place + aside * np.where(np.arange(24) == 12, 1.0, 0.0)
            scale = float(np.max(np.abs(bent)))
            np.save(tmp_path / "mine.npy", np.stack([np.full(24, -0.5), bent / scale]))
            told = {"position_scale": scale}
            if not is_refused:
                read_drive(tmp_path / "mine.npy", motion, **told)
                continue
            with pytest.raises(ValueError, match=f"move the sensor {words}"):
                read_drive(tmp_path / "mine.npy", motion, **told)


def test_a_column_that_nothing_reads_may_be_anything(tmp_path):
    """A table with a column of one's own beside those of `export` is read as without it."""
    rows = {k: f"{-HALF_MS + 2 * HALF_MS * k / STEPS:.9g},0.5,{k % 7}" for k in range(STEPS)}
    places = tmp_path / "plain.csv", tmp_path / "own.csv"
    places[0].write_text(table())
    places[1].write_text(table(rows, names="begin,transmittance,lamp", units="ms,1,A"))
    motion = ParabolicMotion(acceleration=1e5, half_exposure=HALF_MS * 1e-3)
    plain, own = (read_drive(place, motion) for place in places)
    np.testing.assert_array_equal(own.shutter.transmittances, plain.shutter.transmittances)
    assert own.motion is plain.motion is motion
