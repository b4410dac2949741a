"""Drive tables: levels that a shutter can be given, and what is lost by them."""

import csv
import inspect
import io
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from scipy.signal import lsim
from support.designs import MOTION, SCENE
from support.drive import a_design

from mishutter import (
    ChippedShutter,
    Design,
    FirstOrderDevice,
    FreeMotion,
    HannShutter,
    Limits,
    LinearMotion,
    ParabolicMotion,
    Scene,
    SecondOrderStage,
    StillCamera,
    SwitchedDevice,
    cli,
    drive_table,
    evaluate,
)
from mishutter.model.sensor import Sensor


def test_step_means_are_the_integral_of_the_profile():
    """A Hann profile's mean over a step has a closed form, in order of time."""
    edges = np.linspace(-1, 1, 8)
    antiderivative = edges / 2 + np.sin(np.pi * edges) / (2 * np.pi)
    means = np.diff(antiderivative) / np.diff(edges)
    assert np.allclose(drive_table(a_design(HannShutter()), num_steps=7).wanted, means, rtol=1e-12)
    chips = drive_table(a_design(ChippedShutter([0.1, 0.7, 0.4])), num_steps=3)
    assert np.allclose(chips.wanted, [0.1, 0.7, 0.4], rtol=1e-12)


def test_a_long_table_of_many_pieces_holds_means():
    """Of 100,000 steps and 97 chips on another grid: time and memory go by their sum."""
    levels = np.random.default_rng(4).uniform(size=97)
    table = drive_table(a_design(ChippedShutter(levels)), num_steps=100_000)
    edges = np.linspace(0, 97, 100_001)
    passed = np.interp(edges, np.arange(98), np.concatenate([[0.0], np.cumsum(levels)]))
    np.testing.assert_allclose(table.wanted, np.diff(passed) / np.diff(edges), atol=1e-9)


@pytest.mark.parametrize("num_levels", [2, 6])
def test_a_table_that_carries_its_error_is_diffused(num_levels):
    """From the first step on, the light let through is that of the profile to half a level."""
    made = {"num_steps": 83, "num_levels": num_levels, "floor": 0.01, "ceiling": 0.9}
    table = drive_table(a_design(HannShutter()), carries_error=True, **made)
    aimed = np.clip(0.9 * table.wanted, 0.01, 0.9)
    lacking = np.cumsum(table.transmittance - aimed)
    assert np.max(np.abs(lacking)) <= 0.501 * 0.89 / (num_levels - 1)


def _scene(**parts):
    return Scene([-900.0, 900.0], photon_rate=1e5, read_noise=4.0, **parts)


STAGED = {
    "parabola": MOTION,
    "panned": MOTION.panned(700.0),
    "free": FreeMotion(accelerations=[3e5, 1e5, 2e5], half_exposure=0.008, velocity=-90.0),
}


@pytest.mark.parametrize("motion", STAGED.values(), ids=STAGED)
@pytest.mark.parametrize("most", [None, 1.3e6])
def test_the_path_of_the_stage_leads_from_rest_through_the_exposure_to_rest(motion, most):
    """Its rows are at the table's steps too, its slopes its velocities, its bends the limit's."""
    scene = _scene(limits=Limits(max_acceleration=most))
    table = drive_table(a_design(HannShutter(), motion=motion, scene=scene), num_steps=50)
    names, units, *rows = csv.reader(io.StringIO(table.stage_csv()))
    assert names == ["time", "part", "sensor_position", "sensor_velocity"]
    assert units == ["ms", "", "px", "px/s"]
    parts = [row[1] for row in rows]
    assert [part for part, _ in groupby(parts)] == ["rest", "run-up", "exposure", "run-out", "rest"]
    time, position, velocity = (np.array([float(row[i]) for row in rows]) for i in (0, 2, 3))
    exposed = np.flatnonzero(np.array(parts) == "exposure")
    assert exposed.size == 300
    exposed = exposed[::6]
    np.testing.assert_allclose(time[exposed], table.begin * 1e3, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(position[exposed], table.position, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(velocity[exposed], table.velocity, rtol=1e-7, atol=1e-4)
    assert velocity[0] == velocity[-1] == 0
    step = (time[1] - time[0]) * 1e-3
    greatest = float(motion.greatest_acceleration) if most is None else most
    rates = np.abs(np.diff(velocity)) / step
    assert greatest * 0.9 < np.max(rates) < greatest * (1 + 1e-5)
    moved = np.cumsum((velocity[1:] + velocity[:-1]) / 2) * step
    np.testing.assert_allclose(position[1:] - position[0], moved, atol=2 * greatest * step**2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["parabola", "free"])
def test_a_stage_is_sent_what_brings_it_onto_the_path(name, tmp_path):
    """The last column is that, and a saved design knows what comes of sending the path itself.

    The free path pans.
    """
    motion = STAGED[name]
    stage = SecondOrderStage(bandwidth=45.0, damping=0.6)
    design = a_design(HannShutter(), motion=motion, scene=_scene(limits=Limits(stage=stage)))
    design.save(tmp_path / "design.json")
    table = drive_table(Design.load(tmp_path / "design.json"), num_steps=64)
    names, units, *rows = csv.reader(io.StringIO(table.stage_csv()))
    assert (names[-1], units[-1]) == ("sent_position", "px")
    time, position, sent = (np.array([float(row[i]) for row in rows]) for i in (0, 2, 4))
    path = design.scene.limits.stage_path(motion)
    np.testing.assert_allclose(position, path.at(time * 1e-3)[0], atol=1e-4)
    inside = np.array([row[1] == "exposure" for row in rows])[:-1] & (np.abs(time[:-1]) < 7)
    wanted = stage.sent_for(path, time * 1e-3)
    np.testing.assert_allclose(sent[:-1][inside], wanted[:-1][inside], rtol=1e-6, atol=1e-3)
    blind = table.blind_metrics()
    made = evaluate(design.scene, stage.made_of(path), HannShutter())
    assert float(blind.expected_psnr) == pytest.approx(float(made.expected_psnr), abs=1e-9)
    found = table.to_dict()["metrics_of_blind_stage"]["expected_psnr"]
    assert found == float(blind.expected_psnr)
    assert abs(found - float(evaluate(design.scene, motion, HannShutter()).expected_psnr)) > 0.1


def test_a_camera_turns_beside_a_stage_that_is_sent_the_path_itself():
    """What it turns by, things are slower by: the level is that of these at no pan."""
    pan, stage, speeds = 400.0, SecondOrderStage(bandwidth=45.0, damping=0.6), [-900.0, 700.0]
    levels = []
    of_camera = MOTION.panned(pan), speeds, "camera"
    for motion, seen, pans in (of_camera, (MOTION, np.array(speeds) - pan, "stage")):
        limits = Limits(stage=stage, pans=pans)
        scene = Scene(seen, photon_rate=1e5, read_noise=4.0, limits=limits)
        table = drive_table(a_design(HannShutter(), motion=motion, scene=scene))
        levels.append(float(table.blind_metrics().expected_psnr))
    assert levels[0] == pytest.approx(levels[1], abs=1e-6)


def test_a_document_gives_the_settling_time_in_ms():
    """A thousandth remains after ln(1000) time constants of the slower step."""
    device = FirstOrderDevice(rise_time=2e-4, fall_time=3.1e-4, delay=7e-5)
    table = drive_table(a_design(HannShutter(), scene=_scene(device=device)), num_steps=9)
    found = table.to_dict()["settling_time_ms"]
    assert found == pytest.approx(0.07 + 0.31 * np.log(1000) / np.log(9), rel=1e-6)


@pytest.mark.parametrize("motion", STAGED.values(), ids=STAGED)
def test_a_stage_beside_a_shutter_of_few_slots_is_sent_enough_to_stay_on_its_path(motion):
    """An oscillator that is sent the rows, joined by straight lines, is within 0.1 px of 15."""
    stage = SecondOrderStage(bandwidth=60.0, damping=0.5)
    scene = _scene(limits=Limits(stage=stage), device=SwitchedDevice(num_slots=12))
    table = drive_table(a_design(HannShutter(), motion=motion, scene=scene))
    assert table.begin.size == 12
    _, _, *rows = csv.reader(io.StringIO(table.stage_csv()))
    time, position, sent = (np.array([float(row[i]) for row in rows]) for i in (0, 2, 4))
    pull, drag = stage.natural_frequency**2, 2 * 0.5 * stage.natural_frequency
    servo = [[0, 1], [-pull, -drag]], [[0], [pull]], [[1, 0]], [[0]]
    made = lsim(servo, sent, (time - time[0]) * 1e-3, [position[0], 0])[1]
    exposed = np.array([row[1] == "exposure" for row in rows])
    assert np.ptp(position[exposed]) > 8
    np.testing.assert_allclose(made[exposed], position[exposed], atol=0.1)


@pytest.mark.parametrize("most", [None, 1.3e6])
def test_a_path_beyond_the_limit_on_travel_is_told_of(most, tmp_path, capsys):
    """Without a limit on the acceleration a search counts no run-up, and the table has one."""
    limits = Limits(max_travel=31.0, max_acceleration=most)
    design = a_design(HannShutter(), motion=MOTION, scene=_scene(limits=limits))
    travel = limits.stage_path(MOTION).travel
    assert (travel > 31.0) == (most is None)
    design.save(tmp_path / "design.json")
    given = ["export", str(tmp_path / "design.json"), "--steps", "9", "--out", str(tmp_path)]
    assert cli.main(given) == 0
    said = capsys.readouterr().err
    assert (f"stage.csv travels {travel:.4g} px" in said) == (most is None)


def test_a_stage_whose_response_is_not_known_is_sent_the_path():
    """There is no column for it, and no figure."""
    table = drive_table(a_design(HannShutter(), scene=_scene()), num_steps=5)
    assert table.blind_metrics() is None
    assert "metrics_of_blind_stage" not in table.to_dict()


def test_a_sensor_without_acceleration_has_no_run_up():
    """At rest there is no path, and a pan's has the acceleration that the stage is given."""
    resting = a_design(HannShutter(), motion=StillCamera(half_exposure=0.01))
    assert drive_table(resting, num_steps=5).stage_csv() is None
    panning = resting.with_one(motion=LinearMotion(half_exposure=0.01, velocity=300.0))
    assert drive_table(panning, num_steps=5).stage_csv() is None
    limited = replace(panning, scene=_scene(limits=Limits(max_acceleration=1e5)))
    path = drive_table(limited, num_steps=50).stage_csv()
    assert path is not None
    assert "run-up" in path


def test_a_table_has_the_steps_and_levels_of_its_device():
    """Unless others are asked for."""
    scene = _scene(device=SwitchedDevice(num_slots=48))
    design = a_design(HannShutter(), scene=scene)
    table = drive_table(design)
    assert (table.begin.size, table.num_levels) == (48, 2)
    table = drive_table(design, num_steps=7, num_levels=5)
    assert (table.begin.size, table.num_levels) == (7, 5)


def test_a_shutter_is_driven_at_its_own_times_whatever_the_sensor_reads():
    """It lights all rows at once, where the triggers of frames begin the row that is read first."""
    design = a_design(HannShutter())
    rows = replace(design, scene=_scene(sensor=Sensor(readout=0.004)))
    for table in map(drive_table, (design, rows)):
        half = float(design.motion.half_exposure)
        assert table.lights[0] == pytest.approx((-half, half))
        assert table.lead == 0


def test_a_shutter_needs_no_drive_only_if_it_never_closes():
    """One that is at its highest level for some steps alone needs one."""
    open_for = {(1.0, 1.0, 1.0): True, (1.0, 0.3, 1.0): False, (0.0, 0.0, 0.6): False}
    for levels, is_open in open_for.items():
        table = drive_table(a_design(ChippedShutter(levels)), num_steps=3, num_levels=11)
        assert table.is_open == is_open


@pytest.mark.parametrize("velocity", [2300.0, -2300.0])
def test_the_scale_of_positions_is_the_furthest_either_way(velocity):
    """A stage that begins below its middle is furthest there."""
    motion = ParabolicMotion(acceleration=900.0, half_exposure=7e-3, velocity=velocity)
    table = drive_table(a_design(HannShutter(), motion=motion), num_steps=9)
    time = 7e-3 * (np.arange(9) / 4.5 - 1)
    furthest = np.max(np.abs(900 * time**2 + velocity * time))
    assert table.position_scale == pytest.approx(furthest, rel=1e-6)


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
    position = float(MOTION.sag) * (time / half) ** 2
    velocity = float(MOTION.top_speed) * time / half
    sent = table.transmittance
    columns = (time * 1e3, table.wanted, table.level, sent, sent, position, velocity)
    lines = table.to_csv().splitlines()
    rows = [[float(cell) for cell in line.split(",")] for line in lines[2:]]
    assert lines[1] == "ms,1,1,1,1,px,px/s"
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
    for motion in (MOTION.panned(-713.0), LinearMotion(half_exposure=half, velocity=-713.0)):
        table = drive_table(a_design(HannShutter(), motion=motion), num_steps=8)
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


def test_a_shutter_alone_is_noa_design():
    """A table is of a profile on a motion."""
    with pytest.raises(
        ValueError, match=r"`drive_table\(design=...\)` must be a `Design`; got Hann"
    ):
        inspect.unwrap(drive_table)(HannShutter())
