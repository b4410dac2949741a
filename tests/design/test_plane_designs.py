"""A design of frames in the plane: its file, and the paths of its stage from rest to rest."""

import json
from dataclasses import fields, replace

import equinox as eqx
import numpy as np
import pytest
from support.bursts import a_burst_design
from support.command_line import refused
from support.plane import a_plane_design, stage_paths

from mishutter import (
    Design,
    EvenVelocities,
    Limits,
    ListedVelocities,
    OneExposure,
    RingOfVelocities,
    frame_table,
    plot_design,
)
from mishutter._core.files import strict_json
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
    frames = replace(design.sequence.frames, lead=0.0017)
    design = replace(design, sequence=replace(design.sequence, frames=frames, **losses))
    design.save(tmp_path / "design.json")
    read = Design.load(tmp_path / "design.json")
    assert eqx.tree_equal(read.scene, design.scene)
    assert eqx.tree_equal(read.sequence.frames, design.sequence.frames)
    assert (read.sequence.kind, read.sequence.num_axes) == (design.sequence.kind, 2)
    assert {name: getattr(read.sequence, name) for name in losses} == losses
    assert read.sequence.psnr == design.sequence.psnr
    limits = design.scene.limits
    assert read.sequence.use_within(limits) == design.sequence.frames.use(limits)


def test_the_stage_goes_from_rest_to_rest_through_the_path():
    """It is where the frames want it but for a constant, at rest at both ends, about 0."""
    design = a_plane_design()
    begin, end = design.exposures.lights[0][0], design.exposures.lights[-1][1]
    time = np.linspace(begin, end, 97)[1:-1]
    wanted = np.asarray(design.sequence.frames.place(time))
    for path, place in zip(stage_paths(design), wanted, strict=True):
        own, _ = path.at(time)
        np.testing.assert_allclose(own - own[0], place - place[0], atol=1e-6)
        assert path.exposure == pytest.approx((begin, end))
        np.testing.assert_array_equal(path.at(path.times[[0, -1]])[1], 0)
        every = path.at(np.linspace(path.times[0], path.times[-1], 40001))[0]
        assert np.min(every) == pytest.approx(-np.max(every), abs=0.02)
    speeds = [np.max(np.abs(path.accelerations)) for path in stage_paths(design)]
    assert max(speeds) == pytest.approx(float(design.scene.limits.max_acceleration), rel=1e-6)


def test_a_stage_has_no_path_that_no_limit_sets():
    """At rest there is none, and none through velocities that jump; else the way's own rate."""
    design = a_plane_design()
    free = replace(design.scene, limits=Limits(max_half_exposure=0.01))
    unlimited = Design(free, design.sequence)
    rates = [np.max(np.abs(path.accelerations)) for path in stage_paths(unlimited)]
    gains = np.abs(np.diff(design.sequence.frames.velocities)) / design.sequence.frames.durations
    assert max(rates) == pytest.approx(np.max(gains), rel=1e-9)
    jumps = eqx.tree_at(
        lambda x: (x.durations, x.velocities),
        design.sequence.frames,
        (np.array([0.02, 0.0, 0.03]), np.array([[300.0, 300, -90, -90], [0.0, 40, 40, 40]])),
    )
    for frames in (jumps, eqx.tree_at(lambda x: x.velocities, jumps, np.zeros((2, 4)))):
        other = Design(free, replace(design.sequence, frames=frames))
        assert not stage_paths(other)


def test_a_camera_that_turns_leaves_the_rest_to_its_stage():
    """The stage makes the path less the pan, which is the mean velocity of the things."""
    law = ListedVelocities([[900.0, 300.0], [1100.0, 500.0]])
    turning = Limits(max_half_exposure=0.01, max_acceleration=9e5, pans="camera")
    by_stage = a_plane_design(law, Limits(max_half_exposure=0.01, max_acceleration=9e5))
    scene = replace(by_stage.scene, limits=turning)
    by_camera = Design(
        scene, exposures_in_plane(scene, "two sines", by_stage.sequence.frames, 27.25)
    )
    time = np.linspace(-0.015, 0.015, 7)
    for whole, rest, pan in zip(
        stage_paths(by_stage), stage_paths(by_camera), (1000.0, 400.0), strict=True
    ):
        apart = whole.at(time)[0] - rest.at(time)[0]
        np.testing.assert_allclose(np.diff(apart), pan * np.diff(time), rtol=1e-6)
    for design in (by_stage, by_camera):
        ways = [path.at(np.linspace(*path.times[[0, -1]], 9001))[0] for path in stage_paths(design)]
        travel = max(float(np.ptp(way)) for way in ways)
        assert design.sequence.travel == pytest.approx(travel, rel=1e-3)
        whole = exposures_in_plane(design.scene, "two sines", design.sequence.frames, 27.25)
        assert whole.travel == pytest.approx(travel, rel=1e-3)
    assert by_camera.sequence.travel > by_stage.sequence.travel + 10


@pytest.mark.parametrize(("most", "speed"), [(130.0, 130.0), (5000.0, np.hypot(1000, 400))])
def test_a_camera_turns_no_faster_than_it_can(most, speed):
    """Along the mean velocity of the things, with its speed or the fastest that it turns at."""
    law = ListedVelocities([[900.0, 300.0], [1100.0, 500.0]])
    pan = turned_by(law, Limits(pans="camera", max_pan=most))
    np.testing.assert_allclose(pan, speed * np.array([5.0, 2.0]) / np.sqrt(29))
    assert not turned_by(law, Limits(max_pan=most)).any()


def test_a_file_of_frames_alone_that_is_not_whole_is_refused(tmp_path):
    """One line says which keys are not whole."""
    plane = tmp_path / "plane.json"
    a_plane_design().save(plane)
    data = json.loads(plane.read_text("utf-8"))
    data["plane"]["exposures_s"] = [0.01]
    plane.write_text(json.dumps(data))
    with pytest.raises(ValueError, match="3 frames have as many exposures"):
        Design.load(plane)
    data["plane"]["exposures_s"] *= 3
    last = data["plane"]["velocities_px_per_s"][1].pop()
    plane.write_text(json.dumps(data))
    with pytest.raises(ValueError, match="64 pieces have 65 velocities along each axis"):
        Design.load(plane)
    data["plane"]["velocities_px_per_s"][1].append(last)
    del data["velocities"]
    plane.write_text(json.dumps(data))
    with pytest.raises(ValueError, match=r"scene\.speeds` must be given, or `velocities` in any"):
        Design.load(plane)


def test_a_command_along_one_axis_refuses_it(tmp_path, capsys):
    """`compare` names the file and what it holds."""
    a_plane_design().save(tmp_path / "plane.json")
    line = refused(capsys, "compare", "--design", str(tmp_path / "plane.json"))
    assert (
        "plane.json` must be a design of one exposure along one axis; got a design of frames alone"
        in line
    )


OF_ONE = (*(each.name for each in fields(OneExposure)), "metrics", "levels", "command", "converged")


@pytest.mark.parametrize("name", OF_ONE)
@pytest.mark.parametrize("slug", ["plane", "axis"])
def test_frames_alone_say_what_they_have_in_place_of_one_exposure(slug, name):
    """In a line that names `.sequence`; along an axis too."""
    burst = a_burst_design()
    design = {"plane": a_plane_design(), "axis": Design(burst.scene, burst.sequence)}[slug]
    with pytest.raises(ValueError, match=r"be asked of one exposure .*frames are in `\.sequence`"):
        getattr(design, name)


def test_frames_alone_along_an_axis_come_back_from_their_file(tmp_path):
    """With scene and frames as they were; and a design has one or the other."""
    burst = a_burst_design()
    design = Design(burst.scene, burst.sequence)
    design.save(tmp_path / "design.json")
    read = Design.load(tmp_path / "design.json")
    assert strict_json(read.to_dict()) == strict_json(design.to_dict())
    assert repr(read) == repr(design) == f"Design({design.sequence!r})"
    assert design.exposures.text in str(read)
    assert frame_table(read).to_csv() == frame_table(burst).to_csv()
    with pytest.raises(ValueError, match="have a `sequence` or `one` exposure; got neither"):
        replace(read, sequence=None)


def test_its_figure_has_the_path_and_its_velocities():
    """One panel for each, and one for the places in time, in which each exposure is shaded."""
    plane, hodograph, below = plot_design(a_plane_design()).axes
    assert (plane.get_title(), hodograph.get_title()) == ("path of the stage", "velocities")
    assert len(below.lines) == 2
    assert len(below.patches) == 3
