"""`simulate` and `restore` of a design in the plane, from a scene to the picture."""

import json
from dataclasses import replace

import numpy as np
import pytest
from support.bursts import a_burst_design
from support.command_line import SMALL_SCENE, messages, refused
from support.plane import a_plane_design, stage_paths

import mishutter as ms
from mishutter import cli
from mishutter.pictures.images import write_picture

BACTERIUM = """
[speeds]
any_direction = { max_um_per_s = 40 }
[view]
magnification = 40
[light]
photon_rate_per_s = 2000
[sensor]
read_noise_e = 1.6
pixel_pitch_um = 6.5
[limits]
max_travel_px = 60
max_exposure_ms = 10
[burst]
frames_per_s = 100
window_ms = 40
[picture]
path = "photo.png"
"""

STABILISER = """
[speeds]
any_direction = { max_px_per_s = 220 }
[light]
photon_rate_per_s = 3000
[sensor]
read_noise_e = 1.5
pixel_pitch_um = 1.4
[limits]
max_travel_px = 36
max_acceleration_g = 0.05
max_exposure_ms = 62.5
[burst]
frames_per_s = 16
window_ms = 500
[picture]
path = "photo.png"
"""
"""A hand moves a dark scene by up to 110 px over eight frames of an image stabiliser's camera."""


@pytest.fixture
def desk(tmp_path, monkeypatch):
    """A folder with a photograph and a design in the plane, of slow things."""
    monkeypatch.chdir(tmp_path)
    write_picture("photo.png", ms.example_picture().light[120:248, 300:420])
    design = a_plane_design(ms.EvenVelocities(400.0, 300.0))
    replace(design, scene=replace(design.scene, photon_rate=2e5)).save("design.json")
    return tmp_path


def printed(capsys, *arguments) -> dict:
    """The document that a command prints."""
    assert cli.main([*arguments, "--json"]) == 0
    out, _ = capsys.readouterr()
    return json.loads(out)


@pytest.mark.slow
def test_frames_are_written_and_restored(desk, capsys):
    """With the velocity found in them; what a camera has written is restored as what was taken."""
    taken = printed(
        capsys, "simulate", "--design", "design.json", "--subject", "photo.png", "--speed=210,-160"
    )
    frames = [f"simulation/frame_{k}.png" for k in (1, 2, 3)]
    assert taken["files"] == [
        *(f"frame_{k}.png" for k in (1, 2, 3)),
        "restored.png",
        "side_by_side.png",
    ]
    assert taken["found"]["trusted"]
    assert taken["found"]["misfit"] == pytest.approx(1, abs=0.2)
    x, y = taken["found"]["velocity_px_per_s"]
    error = taken["found"]["error_px_per_s"]
    assert np.hypot(x - 210, y + 160) < 5 * error < 50
    found = printed(capsys, "restore", *frames, "--design", "design.json")
    own = found["found"]["frame_1.png"]
    assert np.hypot(own["velocity_px_per_s"][0] - x, own["velocity_px_per_s"][1] - y) < 3 * error
    first, second = (ms.read_picture(f"{x}/restored.png").light for x in ("simulation", "restored"))
    assert float(ms.psnr(first, second)) > 40
    # A velocity that is told is taken, in the units that speeds have.
    told = ["--speed=210px/s,-160", "--decoder", "total-variation", "--out", "told"]
    assert cli.main(["restore", *frames, "--design", "design.json", *told]) == 0
    light, truth = (ms.read_picture(name).light for name in ("told/restored.png", "photo.png"))
    assert float(ms.psnr(truth, light)) > float(ms.psnr(truth, second)) > 20


def test_words_are_those_of_commands(desk, capsys):
    """A scene of another kind of motion, a decoder of rows and too few steps, by their options."""
    camera = ["--design", "design.json"]
    (desk / "axis.toml").write_text(SMALL_SCENE)
    a_burst_design().save("axis.json")
    in_plane = "must be for things that move in any direction, as those of the scene do"
    for command in (["simulate", "axis.toml"], ["restore", "photo.png", "--scene", "axis.toml"]):
        line = refused(capsys, *command, *camera)
        assert "`--design` must be for things that move along one axis, as those" in line
        assert "got 'design.json', for things in any direction" in line
    (desk / "plane.toml").write_text(BACTERIUM)
    line = refused(capsys, "simulate", "plane.toml", "--design", "axis.json", "--speed", "1,2")
    assert f"`--design` {in_plane}; got 'axis.json', for things along one axis" in line
    for command in (["simulate", "--subject", "photo.png"], ["restore", "photo.png"]):
        line = refused(capsys, *command, *camera, "--decoder", "wiener")
        assert "`--decoder` must be ensemble or total-variation where" in line
    line = refused(capsys, "export", "design.json", "--steps", "1")
    assert "`--steps` must leave each of 3 frames a step" in line


@pytest.mark.slow
def test_mistakes_get_a_line(desk, capsys):
    """A velocity without a direction, data of one axis, a frame too few, and fast things."""
    camera = ["--design", "design.json"]
    line = refused(capsys, "simulate", *camera, "--subject", "photo.png", "--speed", "1500")
    assert "`--speed` must be a velocity along rows and columns, as 1500,-800" in line
    line = refused(capsys, "simulate", *camera, "--drive", "drive.csv")
    assert "`--drive` must be left out for a design of frames alone" in line
    line = refused(capsys, "restore", "photo.png", "photo.png", *camera)
    assert "`CAPTURE` must" in line
    write_picture("other.png", ms.example_picture().light[:128, :120])
    line = refused(capsys, "restore", "photo.png", "other.png", *camera)
    assert "`CAPTURE` must be the 3 frames of the burst; got 2" in line
    line = refused(capsys, "simulate", "--speed", "210,-160")
    assert "`--speed` must be a number of px/s" in line
    line = refused(capsys, "compare", *camera)
    assert "must be a design of one exposure" in line


@pytest.mark.slow
def test_a_scene_is_answered_simulated_and_restored(desk, capsys):
    """From its file to a picture that is better than the frames, by the velocity found in them."""
    (desk / "scene.toml").write_text(BACTERIUM, encoding="utf-8")
    answer = printed(capsys, "optimise", "scene.toml", "--out", "answer")
    assert "4 frames" in answer["verdict"]
    design = ["--design", "answer/recommended.json"]
    told = ["--speed=26um/s,-17um/s", "--out", "taken"]
    taken = printed(capsys, "simulate", "scene.toml", *design, *told)
    assert taken["found"]["trusted"], taken["found"]["doubt"]
    truth = ms.read_picture("photo.png").light
    frames = [name for name in taken["files"] if name.startswith("frame")]
    assert cli.main(["restore", *(f"taken/{x}" for x in frames), *design, "--out", "out"]) == 0
    assert "trusted" in capsys.readouterr().out
    levels = [float(ms.psnr(truth, ms.read_picture(f"taken/{x}").light)) for x in frames]
    restored = float(ms.psnr(truth, ms.read_picture("out/restored.png").light))
    assert restored > max(levels) + 3


def a_dark_photo() -> np.ndarray:
    """A picture as small as the drift over it, in a file and as it is."""
    write_picture("photo.png", ms.example_picture().light[100:220, 290:418])
    with open("stabiliser.toml", "w", encoding="utf-8") as file:
        file.write(STABILISER)
    return ms.read_picture("photo.png").light


@pytest.mark.slow
def test_an_image_stabiliser_is_answered_driven_simulated_and_restored(desk, capsys):
    """By four commands: the drift is nearly the sensor, and the velocity is found all the same."""
    truth = a_dark_photo()
    answer = printed(capsys, "optimise", "stabiliser.toml", "--out", "answer")
    assert "8 frames while the stage" in answer["verdict"]
    design = ["--design", "answer/recommended.json"]
    drive = printed(capsys, "export", "answer/recommended.json", "--out", "lab")
    assert "stage.csv" in drive["files"]
    taken = printed(
        capsys, "simulate", "stabiliser.toml", *design, "--speed=148,-121", "--out", "taken"
    )
    frames = [f"taken/{name}" for name in taken["files"] if name.startswith("frame")]
    found = printed(capsys, "restore", *frames, *design, "--out", "out")["found"]["frame_1.png"]
    assert found["trusted"], found["doubt"]
    off = np.array(found["velocity_px_per_s"]) - np.array([148, -121])
    assert np.hypot(*off) * 0.5 < 1
    levels = [float(ms.psnr(truth, ms.read_picture(name).light)) for name in frames]
    restored = float(ms.psnr(truth, ms.read_picture("out/restored.png").light))
    assert restored > max(levels) + 5


@pytest.mark.slow
def test_a_velocity_beyond_the_scene_is_a_warning(desk, capsys):
    """Its unit may have been forgotten; what lies beyond the picture is said where it moves."""
    camera = ["--design", "design.json", "--subject", "photo.png"]
    assert cli.main(["simulate", *camera, "--speed=410,150"]) == 0
    _, errors = capsys.readouterr()
    mirrored = "the sensor is as large as the picture, which goes on mirrored beyond its borders"
    assert sum(mirrored in x for x in messages(errors)) == 1
    assert any(
        "--speed is 436.58 px/s in all; the scene's go up to 400" in x for x in messages(errors)
    )


@pytest.mark.slow
def test_frames_are_restored_by_the_recorded_path(desk, capsys):
    """Where the stage strayed, its record restores better than the plan; one axis is refused."""
    design = ms.Design.load("design.json")
    time = np.linspace(-0.02, 0.02, 800)
    stray = 1.5 * np.sin(2 * np.pi * 45 * time + np.array([[0.3], [1.9]]))
    place = np.array([path.at(time)[0] for path in stage_paths(design)]) + stray
    built, _ = ms.with_recorded_path(design, ms.RecordedPath(time, place))
    lines = [f"{1e3 * t:.6f},{x:.6f},{y:.6f}" for t, x, y in zip(time, *place, strict=True)]
    (desk / "encoder.csv").write_text("\n".join(["t (ms),x (px),y (px)", *lines]), "utf-8")
    built.save("built.json")
    subject = ["--subject", "photo.png", "--speed=210,-160"]
    printed(capsys, "simulate", "--design", "built.json", *subject, "--out", "taken")
    frames = [f"taken/frame_{k}.png" for k in (1, 2, 3)]
    command = ["restore", *frames, "--design", "design.json", "--speed=210,-160"]
    path = ["--stage-path", "encoder.csv"]
    apart = printed(capsys, *command, *path, "--out", "recorded")["path"]
    assert 1 < apart["rms"] < apart["greatest"] < 3
    printed(capsys, *command, "--out", "planned")
    truth = ms.read_picture("photo.png").light
    planned, recorded = (
        float(ms.psnr(truth, ms.read_picture(f"{x}/restored.png").light))
        for x in ("planned", "recorded")
    )
    assert recorded > planned + 1
    (desk / "one.csv").write_text("t (ms),x (px)\n0,1\n1,2", "utf-8")
    line = refused(capsys, *command, "--stage-path", "one.csv")
    assert "must have columns x and y, for a stage of two axes, under a line such as" in line
    assert line.rstrip().endswith("`time (ms),x (um),y (um)`; got x")
