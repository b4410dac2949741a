"""A design of frames in the plane: its file, and the paths of its stage from rest to rest."""

import json
from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest
from support.bursts import a_burst_design
from support.command_line import refused
from support.plane import a_plane_design

from mishutter import (
    Design,
    EvenVelocities,
    Limits,
    ListedVelocities,
    PlaneDesign,
    RingOfVelocities,
    plot_design,
)
from mishutter.model.exposures import exposures_in_plane, turned_by

LAWS = {
    "ellipse": EvenVelocities(1700.0, 1100.0, angle=0.3),
    "ring": RingOfVelocities(930.0),
    "list": ListedVelocities([[900.0, 310.0], [-1100.0, 500.0]], [1.0, 2.0]),
}


@pytest.mark.parametrize("slug", LAWS)
def test_a_design_comes_back_from_its_file(slug, tmp_path):
    """Scene, law of velocities, frames, path and level are those that were saved, bit for bit."""
    design = a_plane_design(LAWS[slug])
    losses = {"registration_loss": 0.023, "width_loss": 0.31}
    frames = replace(design.frames, lead=0.0017)
    design = replace(design, sequence=replace(design.sequence, frames=frames, **losses))
    design.save(tmp_path / "design.json")
    read = PlaneDesign.load(tmp_path / "design.json")
    assert eqx.tree_equal(read.scene, design.scene)
    assert eqx.tree_equal(read.frames, design.frames)
    assert (read.sequence.kind, read.sequence.num_axes) == (design.sequence.kind, 2)
    assert {name: getattr(read.sequence, name) for name in losses} == losses
    assert read.sequence.psnr == design.sequence.psnr
    assert read.sequence.use_within(read.scene.limits) == design.frames.use(design.scene.limits)


def test_the_stage_goes_from_rest_to_rest_through_the_path():
    """It is where the frames want it but for a constant, at rest at both ends, about 0."""
    design = a_plane_design()
    begin, end = design.exposures.lights[0][0], design.exposures.lights[-1][1]
    time = np.linspace(begin, end, 97)[1:-1]
    wanted = np.asarray(design.frames.place(time))
    for path, place in zip(design.stage_paths, wanted, strict=True):
        own, _ = path.at(time)
        np.testing.assert_allclose(own - own[0], place - place[0], atol=1e-6)
        assert path.exposure == pytest.approx((begin, end))
        np.testing.assert_array_equal(path.at(path.times[[0, -1]])[1], 0)
        every = path.at(np.linspace(path.times[0], path.times[-1], 40001))[0]
        assert np.min(every) == pytest.approx(-np.max(every), abs=0.02)
    speeds = [np.max(np.abs(path.accelerations)) for path in design.stage_paths]
    assert max(speeds) == pytest.approx(float(design.scene.limits.max_acceleration), rel=1e-6)


def test_a_stage_has_no_path_that_no_limit_sets():
    """At rest there is none, and none through velocities that jump; else the way's own rate."""
    design = a_plane_design()
    free = replace(design.scene, limits=Limits(max_half_exposure=0.01))
    unlimited = PlaneDesign(free, design.sequence)
    rates = [np.max(np.abs(path.accelerations)) for path in unlimited.stage_paths]
    gains = np.abs(np.diff(design.frames.velocities)) / design.frames.durations
    assert max(rates) == pytest.approx(np.max(gains), rel=1e-9)
    jumps = eqx.tree_at(
        lambda x: (x.durations, x.velocities),
        design.frames,
        (np.array([0.02, 0.0, 0.03]), np.array([[300.0, 300, -90, -90], [0.0, 40, 40, 40]])),
    )
    for frames in (jumps, eqx.tree_at(lambda x: x.velocities, jumps, np.zeros((2, 4)))):
        other = PlaneDesign(free, replace(design.sequence, frames=frames))
        assert other.stage_paths is None


def test_a_camera_that_turns_leaves_the_rest_to_its_stage():
    """The stage makes the path less the pan, which is the mean velocity of the things."""
    law = ListedVelocities([[900.0, 300.0], [1100.0, 500.0]])
    turning = Limits(max_half_exposure=0.01, max_acceleration=9e5, pans="camera")
    by_stage = a_plane_design(law, Limits(max_half_exposure=0.01, max_acceleration=9e5))
    scene = replace(by_stage.scene, limits=turning)
    by_camera = PlaneDesign(scene, exposures_in_plane(scene, "two sines", by_stage.frames, 27.25))
    time = np.linspace(-0.015, 0.015, 7)
    for whole, rest, pan in zip(
        by_stage.stage_paths, by_camera.stage_paths, (1000.0, 400.0), strict=True
    ):
        apart = whole.at(time)[0] - rest.at(time)[0]
        np.testing.assert_allclose(np.diff(apart), pan * np.diff(time), rtol=1e-6)
    for design in (by_stage, by_camera):
        ways = [path.at(np.linspace(*path.times[[0, -1]], 9001))[0] for path in design.stage_paths]
        travel = max(float(np.ptp(way)) for way in ways)
        assert design.sequence.travel == pytest.approx(travel, rel=1e-3)
        whole = exposures_in_plane(design.scene, "two sines", design.frames, 27.25)
        assert whole.travel == pytest.approx(travel, rel=1e-3)
    assert by_camera.sequence.travel > by_stage.sequence.travel + 10


@pytest.mark.parametrize(("most", "speed"), [(130.0, 130.0), (5000.0, np.hypot(1000, 400))])
def test_a_camera_turns_no_faster_than_it_can(most, speed):
    """Along the mean velocity of the things, with its speed or the fastest that it turns at."""
    law = ListedVelocities([[900.0, 300.0], [1100.0, 500.0]])
    pan = turned_by(law, Limits(pans="camera", max_pan=most))
    np.testing.assert_allclose(pan, speed * np.array([5.0, 2.0]) / np.sqrt(29))
    assert not turned_by(law, Limits(max_pan=most)).any()


def test_each_kind_of_design_refuses_the_file_of_the_other(tmp_path):
    """One line names what it is, and says which keys are not whole."""
    plane, axis = tmp_path / "plane.json", tmp_path / "axis.json"
    a_plane_design().save(plane)
    a_burst_design().save(axis)
    with pytest.raises(ValueError, match="be a design along one axis; got a design in the plane"):
        Design.load(plane)
    with pytest.raises(ValueError, match="be a design in the plane; got a design along one axis"):
        PlaneDesign.load(axis)
    data = json.loads(plane.read_text("utf-8"))
    data["plane"]["exposures_s"] = [0.01]
    plane.write_text(json.dumps(data))
    with pytest.raises(ValueError, match="3 frames have as many exposures"):
        PlaneDesign.load(plane)
    data["plane"]["exposures_s"] *= 3
    last = data["plane"]["velocities_px_per_s"][1].pop()
    plane.write_text(json.dumps(data))
    with pytest.raises(ValueError, match="64 pieces have 65 velocities along each axis"):
        PlaneDesign.load(plane)
    data["plane"]["velocities_px_per_s"][1].append(last)
    del data["velocities"]
    plane.write_text(json.dumps(data))
    with pytest.raises(ValueError, match="`velocities` must be given; got nothing"):
        PlaneDesign.load(plane)


def test_a_command_along_one_axis_refuses_it(tmp_path, capsys):
    """`compare` names the file and what it holds."""
    a_plane_design().save(tmp_path / "plane.json")
    line = refused(capsys, "compare", "--design", str(tmp_path / "plane.json"))
    assert "got a design in the plane" in line


def test_its_figure_has_the_path_and_its_velocities():
    """One panel for each, and one for the places in time, in which each exposure is shaded."""
    plane, hodograph, below = plot_design(a_plane_design()).axes
    assert (plane.get_title(), hodograph.get_title()) == ("path of the stage", "velocities")
    assert len(below.lines) == 2
    assert len(below.patches) == 3
