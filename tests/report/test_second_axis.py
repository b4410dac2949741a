"""Frames in the plane along either axis, at the ends of their ranges, and off their centre."""

from dataclasses import replace

import numpy as np
import pytest
from support.plane import a_plane_design, scene_of, stage_paths

from mishutter import (
    Design,
    Exposures,
    Limits,
    ListedVelocities,
    PlaneFrames,
    Scene,
    exposures_psnr,
    frame_table,
)
from mishutter.evaluation.ceilings import exposures_ceiling
from mishutter.evaluation.registration import loss_of_width
from mishutter.report.in_plane import answer_in_plane
from mishutter.search.plane_frames import PlaneSearch


def stills(times, exposure) -> PlaneFrames:
    """Frames at rest."""
    exposures = np.full(len(times), exposure)
    return PlaneFrames(np.array(times), exposures, np.ones(1), np.zeros((2, 2)))


@pytest.mark.parametrize("velocity", [(800.0, 0.0), (0.0, -800.0)])
def test_a_place_turns_the_waves_of_its_own_axis(velocity):
    """Frames that are blurred lose at the borders by their own levels, whatever the direction.

    Things move by 1.6 px within a frame and by 80 px between two: in which of the two a point is
    seen decides its level, as few are seen in a part of a frame. A place along rows turns no wave
    of vertical frequency.
    """
    scene = Scene.any_direction(ListedVelocities([velocity]), photon_rate=1e6, read_noise=9.0)
    both = stills([-0.05, 0.05], 2e-3)
    of_both, of_one = (
        10 ** (-float(exposures_psnr(scene, frames)) / 10) for frames in (both, stills([0.0], 2e-3))
    )
    loss = loss_of_width(scene, both, width=200.0)
    assert loss == pytest.approx(10 * np.log10(0.6 + 0.4 * of_one / of_both), rel=0.01)


@pytest.mark.parametrize("slug", ["A", "B"])
def test_the_ceiling_of_what_hardly_moves_is_one_still(slug):
    """At 1 px/s no path is better than none, and the budget over velocities does not bind."""
    scene = scene_of(slug)
    slow = Scene.any_direction(1.0, photon_rate=scene.photon_rate, read_noise=scene.read_noise)
    level = float(exposures_psnr(slow, stills([0.0], 0.013)))
    assert exposures_ceiling(slow, np.array([0.013])) == pytest.approx(level, abs=1e-3)


def test_a_list_off_centre_is_read_with_what_its_stage_does(tmp_path):
    """The camera turns with the mean velocity, and the stage of the saved design does the rest."""
    law = ListedVelocities([[900.0, 300.0], [1100.0, 500.0]])
    limits = Limits(max_half_exposure=0.01, max_acceleration=9e5, pans="camera")
    design = a_plane_design(law, limits)
    design.save(tmp_path / "design.json")
    read = Design.load(tmp_path / "design.json")
    use = read.sequence.use_within(limits)
    assert use != design.sequence.frames.use(limits)  # of a stage that pans by itself
    travels = [
        np.ptp(path.at(np.linspace(*path.times[[0, -1]], 40_001))[0]) for path in stage_paths(read)
    ]
    assert use.travel == pytest.approx(max(travels), rel=1e-3)
    speeds = [np.max(np.abs(path.at(path.times)[1])) for path in stage_paths(read)]
    assert use.top_speed == pytest.approx(max(speeds), rel=1e-6)


def test_places_of_triggers_are_those_of_the_frames():
    """Along each axis, at mid-exposure of each of three unequal frames, but for a constant."""
    design = a_plane_design()
    places = frame_table(design, num_steps=97).places
    wanted = np.asarray(design.sequence.frames.place(np.array(design.sequence.times)))
    assert list(places) == ["stage x / px", "stage y / px"]
    for own, place in zip(places.values(), wanted, strict=True):
        np.testing.assert_allclose(np.diff(own), np.diff(place), atol=1e-6)
    assert np.min(np.abs(np.diff(wanted))) > 0.1


def test_what_a_sensor_loses_stands_in_the_gain():
    """0.7 dB by its width are taken from the level of the formula, and from the gain over one."""
    design = a_plane_design()
    burst = replace(design.sequence, width_loss=0.7)
    assert burst.level == pytest.approx(27.25 - 0.7)
    assert replace(burst, width_loss=None).level == 27.25
    one = Exposures("stills", stills([0.0], 0.003), psnr=24.5)
    answer = answer_in_plane(design.scene, PlaneSearch(one, (burst,), 28.0))
    told = answer.to_dict()["options"][-1]
    assert told["gain_db"] == pytest.approx(27.25 - 0.7 - 24.5)
    assert told["width_loss_db"] == 0.7


def test_velocities_that_never_occur_are_not_the_fastest():
    """With the weights 0 and 1 the fastest is the second's, and so is the axis."""
    law = ListedVelocities([[900.0, 0.0], [-60.0, 80.0]], [0.0, 1.0])
    assert law.fastest == pytest.approx(100)
    assert law.axis % np.pi == pytest.approx(np.arctan2(80, -60) % np.pi)
    scene = Scene.any_direction(law, photon_rate=3e4, read_noise=9.0)
    assert float(scene.max_speed) == pytest.approx(100)


@pytest.mark.parametrize("unit", [(1.0, 0.0), (0.0, 1.0), (0.6, -0.8)])
def test_one_axis_of_a_stage_lies_along_the_path(unit):
    """Whatever its direction: 3 px at 200 to 400 px/s in 10 ms, without a limit on the run-up."""
    velocities = np.outer(unit, [200.0, 400.0])
    frames = PlaneFrames(np.zeros(1), np.array([0.01]), np.array([0.01]), velocities)
    use = frames.use(Limits(max_half_exposure=0.01, axes="one"))
    assert (use.stroke, use.top_speed) == pytest.approx((3.0, 400.0))
    assert use.acceleration == pytest.approx(2e4)


@pytest.mark.parametrize(("axes", "size"), [("each", np.maximum), ("disc", np.hypot)])
def test_a_stage_runs_up_to_the_first_velocity_and_out_from_the_last(axes, size):
    """At 1e5 px/s^2, each in its own time, along both axes together."""
    velocities = np.array([[100.0, -500.0], [-200.0, 300.0]])
    frames = PlaneFrames(np.zeros(1), np.array([0.01]), np.array([0.01]), velocities)
    limits = Limits(max_half_exposure=0.01, max_acceleration=1e5, axes=axes)
    knots = frames.knots(limits)
    up, out = size(*np.abs(velocities)) / 1e5
    np.testing.assert_allclose(knots.durations, [up, 0.01, out])
    for path, own in zip(frames.stage_paths(limits), velocities, strict=True):
        assert path.times[-1] - path.exposure[1] == pytest.approx(out)
        np.testing.assert_allclose(path.at(np.array(path.exposure))[1], own)
        np.testing.assert_allclose(path.accelerations[[0, -1]], [own[0] / up, -own[1] / out])


@pytest.mark.parametrize("turn", [0.0, 0.1, 0.7, 1.9])
def test_two_axes_together_hold_a_path_in_any_direction(turn):
    """As one number: no less than along the path, and no more than by a half of 16 directions."""
    unit = np.array([np.cos(turn), np.sin(turn)])
    velocities = np.outer(unit, [200.0, 400.0])
    frames = PlaneFrames(np.zeros(1), np.array([0.01]), np.array([0.01]), velocities)
    disc, each = (Limits(max_half_exposure=0.01, axes=axes) for axes in ("disc", "each"))
    most = 1 / np.cos(np.pi / 32) + 1e-6
    for found, wanted in zip(frames.use(disc)[1:4], (3.0, 400.0, 2e4), strict=True):
        assert 1 - 1e-6 <= found / wanted <= most
    for found, wanted in zip(frames.use(each)[1:4], (3.0, 400.0, 2e4), strict=True):
        assert found == pytest.approx(wanted * np.max(np.abs(unit)))
    assert frames.acceleration(disc) == pytest.approx(2e4)
    assert frames.acceleration(each) == pytest.approx(2e4 * np.max(np.abs(unit)))
    assert frames.top_speed == pytest.approx(400)


def test_stills_ask_for_no_path_whatever_the_limits():
    """Along neither axis, though the acceleration is limited."""
    limits = Limits(max_half_exposure=0.01, max_acceleration=1e5)
    assert stills([-0.01, 0.01], 0.005).stage_paths(limits) == []


@pytest.mark.parametrize("ends", [(400.0, 100.0), (100.0, 400.0)])
def test_a_path_without_room_to_go_on_lasts_for_all_rows(ends):
    """Whichever of the run-up and the run-out is shorter: 4 ms before and after the light."""
    velocities = np.array([ends, (0.0, 0.0)])
    frames = PlaneFrames(np.zeros(1), np.array([0.01]), np.array([0.01]), velocities)
    limits = Limits(max_half_exposure=0.01, max_acceleration=1e5, max_stroke=2.6)
    rows = frames.for_rows(0.008, limits)
    assert rows.bends[0] <= -0.009 + 1e-9
    assert rows.bends[-1] >= 0.009 - 1e-9
    time = np.linspace(-0.009, 0.009, 19)
    place = np.asarray(rows.place(time))[0]
    run_up, run_out = np.square(ends) / 2e5
    assert place[-1] - place[0] == pytest.approx(run_up + 2.5 + run_out)
    own = np.asarray(frames.place(time[4:15]))[0]
    np.testing.assert_allclose(place[4:15] - place[4], own, atol=1e-9)
