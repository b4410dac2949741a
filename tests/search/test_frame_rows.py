"""The level of frames by rows, against sums over their instants and differences."""

from dataclasses import replace

import numpy as np
import pytest

from mishutter import BurstMode, Limits, Scene, Sensor
from mishutter.evaluation.bursts import FrameTimes
from mishutter.evaluation.levels import rows_of
from mishutter.search import moving_frames
from mishutter.search.frame_levels import Frames, Levels, Shape
from mishutter.search.frame_limits import Room
from mishutter.search.frame_rows import RowLevels, errors_by_rows
from mishutter.search.frame_search import Descent
from mishutter.search.frame_ties import FREE
from mishutter.search.moving_frames import best_moving_burst, sequence_of

READOUT = 0.008
LIMITS = Limits(
    max_stroke=60.0,
    max_travel=90.0,
    max_acceleration=9e5,
    max_top_speed=4e3,
    max_half_exposure=0.02,
)
LIGHT = {"photon_rate": 1e5, "read_noise": 5.0}


def of_limits(limits, readout=READOUT):
    """A scene of three speeds behind a sensor of a readout time, s."""
    burst = BurstMode(frames_per_s=60.0, max_frames=3, window=0.05)
    sensor = Sensor(readout=readout)
    weights = [0.2, 0.5, 0.3]
    return Scene(
        [-900.0, 200.0, 2100.0], weights, limits=limits, burst=burst, sensor=sensor, **LIGHT
    )


def frames(pan=0.0):
    """Frames that accelerate, with a way back between the first two."""
    exposure, gap = np.array([0.009, 0.011, 0.006]), np.array([0.0071, 0.0062])
    velocity = np.array([[300.0, 900.0, 1100.0], [800.0, 200.0, -300.0], [-500.0, 100.0, 400.0]])
    place = np.array([14.0, 17.0, 19.0])
    return Frames(exposure, velocity[..., None] + pan, gap, place[:, None], np.array([pan]))


def room_of(scene):
    """The room that its limits leave."""
    return Room.of(scene.limits, FrameTimes.of(scene, scene.burst), 2100.0)


@pytest.mark.parametrize("pan", [0.0, 350.0])
@pytest.mark.parametrize("travel", [90.0, 9.0])
def test_rows_see_the_path_that_is_driven(travel, pan):
    """The closed form has the sums over instants, and the search the path that a stage follows."""
    limits = replace(LIMITS, max_travel=travel, max_stroke=travel)
    if pan:
        limits = replace(limits, pans="camera", max_pan=pan)
    scene, own = of_limits(limits), frames(pan)
    sequence = sequence_of(own, FREE)
    path, levels = sequence.path_for_rows(READOUT, limits), Levels.on_axis(scene)
    closed = errors_by_rows(levels, path, READOUT)
    rows = rows_of(scene, sequence, "a test")
    summed = sum(share * levels.errors_at(each) for share, each in rows)
    np.testing.assert_allclose(closed, summed, rtol=1e-6)
    goes_on = sequence.for_rows(READOUT, limits).path.lead > 0
    assert goes_on == (travel == 90.0)
    room, shape = room_of(scene), Shape(3, 2, 1)
    driven, other = (
        RowLevels(levels, room, READOUT, each).slope(
            lambda x: room.split(x, shape)[0], room.joined(own)
        )[0]
        for each in (goes_on, not goes_on)
    )
    wanted = 10 * np.log10(np.sum(closed))
    assert driven == pytest.approx(wanted, abs=0.01)  # between frames it may be less gentle
    assert abs(other - wanted) > 0.03


@pytest.mark.parametrize("goes_on", [True, False])
@pytest.mark.parametrize("readout", [0.003, READOUT, 0.016])
def test_the_slope_by_rows_is_that_of_the_level(readout, goes_on):
    """By every number: exposures, velocities, gaps, places and the velocity of a camera."""
    scene, shape = of_limits(LIMITS, readout), Shape(3, 2, 1)
    room = room_of(scene)
    by_rows = RowLevels(Levels.on_axis(scene), room, readout, goes_on)

    def error(x):
        return by_rows.slope(lambda z: room.split(z, shape)[0], x)

    x = room.joined(frames(120.0))
    step = 1e-6 * np.eye(x.size)
    wanted = [(error(x + each)[0] - error(x - each)[0]) / 2e-6 for each in step]
    slope = error(x)[1]
    assert np.sum(np.abs(wanted) > 1e-3) == x.size - 1  # the travel's place aside
    np.testing.assert_allclose(slope, wanted, atol=2e-5 * np.max(np.abs(wanted)))


def test_rows_that_are_read_at_once_are_all_alike():
    """Without a readout level and slope are those of a global shutter."""
    scene, shape, own = of_limits(LIMITS, 0.0), Shape(3, 2, 1), frames()
    levels, room = Levels.on_axis(scene), room_of(scene)
    x = room.joined(own)
    wanted = Descent(levels, room, shape)._error(x)
    at_once = Descent(levels, room, shape, RowLevels(levels, room, 1e-12, goes_on=True))._error(x)
    assert at_once[0] == pytest.approx(wanted[0], abs=1e-9)
    np.testing.assert_allclose(at_once[1], wanted[1], atol=1e-6)


def test_a_search_by_rows_gains_and_keeps_the_limits(monkeypatch):
    """It climbs on from the ends of a global shutter, and is never below the best of them."""
    limits = Limits(
        max_stroke=60.0, max_travel=100.0, max_acceleration=4e5, max_half_exposure=1 / 30
    )
    burst = BurstMode(frames_per_s=30.0, max_frames=2, window=1 / 15)
    light = {"photon_rate": 3e4, "read_noise": 4.0, "sensor": Sensor(readout=0.033)}
    scene = Scene([-1500.0, 200.0, 1300.0], [0.4, 0.3, 0.3], limits=limits, burst=burst, **light)
    former, by_rows = [], moving_frames._by_rows

    def noted(scene, found, *others):
        former.extend(each.level for each in found)
        return by_rows(scene, found, *others)

    monkeypatch.setattr(moving_frames, "_by_rows", noted)
    best = best_moving_burst(scene)
    assert best is not None
    assert best.psnr > max(former) + 0.03
    assert best.share_of(limits) <= 1 + 1e-7


def test_a_global_shutter_has_no_descents_by_rows(monkeypatch):
    """Nor has a stage of limited jerk, each frame of which has no numbers of its own."""
    monkeypatch.setattr(moving_frames, "_by_rows", None)
    scene = replace(
        of_limits(LIMITS), burst=BurstMode(frames_per_s=60.0, max_frames=2, window=0.05)
    )
    together = replace(scene, sensor=Sensor())
    jerky = replace(scene, limits=replace(LIMITS, max_jerk=1e9))
    assert best_moving_burst(together).moves
    assert best_moving_burst(jerky).moves
