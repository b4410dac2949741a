"""The rows of a burst's stage, on the clock of its triggers."""

import csv
import io

import numpy as np
import pytest
from support.bursts import SEQUENCE, a_burst_design

from mishutter import Limits, frame_table
from mishutter.hardware.drive_files import DRIVE_FORMATS


def columns_of(text):
    """Columns of a table by name, without its line of units."""
    rows = list(csv.DictReader(io.StringIO(text)))[1:]
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def test_a_stage_steps_as_its_triggers_do():
    """Every step of the table is a row of the stage, and as many between as a path asks for.

    Two exposures have 512 rows at least, as the table of one has 256: 40 in each of 13 steps.
    """
    table = frame_table(a_burst_design(), num_steps=13)
    path = columns_of(table.stage_csv())
    time, begin = path["time"].astype(float), 1e3 * table.begin
    step = SEQUENCE.duration * 1e3 / 13
    np.testing.assert_allclose(np.diff(time), step / 40, rtol=1e-5)
    (first,) = np.flatnonzero(np.isclose(time, begin[0]))
    np.testing.assert_allclose(time[first : first + 520 : 40], begin, rtol=1e-6)
    own = columns_of(table.to_csv())
    for name in ("sensor_position", "sensor_velocity"):
        rows = path[name][first : first + 520 : 40].astype(float)
        np.testing.assert_allclose(rows, own[name].astype(float), rtol=1e-6, atol=1e-6)


def test_the_table_has_its_own_units():
    """Times are ms, and a frame's exposure is its end less its beginning."""
    table = frame_table(a_burst_design(), num_steps=13)
    triggers = {name: x.astype(float) for name, x in columns_of(table.frames_csv()).items()}
    np.testing.assert_allclose(triggers["exposure"], [4.2, 13.6], rtol=1e-9)
    np.testing.assert_allclose(triggers["begin"], [-11.1, 2.2], rtol=1e-9)
    document = table.to_dict()
    assert document["step_ms"] == pytest.approx(26.9 / 13, rel=1e-12)
    np.testing.assert_allclose(document["begin_ms"], 1e3 * table.begin, rtol=1e-12)
    assert document["position_scale_px"] == np.max(np.abs(document["sensor_position_px"]))
    assert set(DRIVE_FORMATS) >= {"csv", "pulses"}


def test_a_travel_beyond_the_limit_is_its_length():
    """That of the whole path, with the run-up, where a limit on travel is below it; else none."""
    others = {"max_stroke": 40.0, "max_half_exposure": 0.012, "max_acceleration": 1.4e6}
    whole = np.ptp(frame_table(a_burst_design()).paths[""].at(np.linspace(-0.05, 0.05, 20001))[0])
    for travel, found in ((0.9 * whole, whole), (1.1 * whole, None)):
        table = frame_table(a_burst_design(limits=Limits(max_travel=travel, **others)))
        beyond = table.travel_beyond_limit
        assert beyond == (None if found is None else pytest.approx(found, rel=1e-3))
