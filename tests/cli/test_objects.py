"""Layers, frames and back: `simulate` and `restore` of things before a background."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from support.command_line import refused
from support.moving_things import texture

import mishutter as ms
from mishutter import cli
from mishutter.design.design import given_design

FRAMES = tuple(
    ms.TimedFrame(ms.StillCamera(half_exposure=half), time)
    for half, time in ((8e-3, -0.03), (2e-3, -0.01), (8e-3, 0.01), (2e-3, 0.03))
)
SPEED, LEFT, TOP = 430.0, 47, 31


def design(frames=FRAMES):
    scene = ms.Scene.uniform(
        max_speed=900.0,
        num_speeds=3,
        photon_rate=2e5,
        read_noise=6.0,
        burst=ms.BurstMode(frames_per_s=50.0, max_frames=4),
        occlusion=ms.Occlusion(front_share=0.2, object_width=50.0),
    )
    own = given_design(scene, ms.StillCamera(half_exposure=2e-3), ms.RectShutter(), "Given.")
    return replace(own, sequence=ms.Exposures("own", frames, 0.0, 31.0, 30.0))


def layers():
    random = np.random.default_rng(7)
    down, across = np.mgrid[:50, :50] - 24.5
    matte = np.clip(23.5 - np.hypot(down, across), 0, 1).astype(np.float32)
    ground, thing = texture(random, 128)[:112], texture(random, 64, 0.5)[:50, :50]
    return ms.Layers(
        (
            ms.Layer(ms.Picture(ground[..., None].astype(np.float32))),
            ms.Layer(ms.Picture(thing[..., None].astype(np.float32), matte), SPEED, LEFT, TOP),
        )
    )


def truth():
    back, front = layers().layers
    picture = back.picture.light[..., 0].copy()
    there = picture[TOP : TOP + 50, LEFT : LEFT + 50]
    there += front.matte * (front.picture.light[..., 0] - there)
    return picture


def test_a_layered_scene_is_written_as_it_is_read(tmp_path):
    """Speeds, places, mattes and light come back from the files."""
    names = ms.write_layers(tmp_path, layers())
    assert sorted(each.name for each in tmp_path.iterdir()) == sorted(names)
    back = ms.read_layers(tmp_path / "layers.toml").layers
    for found, wanted in zip(back, layers().layers, strict=True):
        assert (found.speed, found.left, found.top) == (wanted.speed, wanted.left, wanted.top)
        np.testing.assert_allclose(found.matte, wanted.matte, atol=1e-4)
        np.testing.assert_allclose(found.picture.light, wanted.picture.light, atol=1e-4)


@pytest.mark.slow
def test_frames_of_layers_become_layers(tmp_path, monkeypatch, capsys):
    """The chain of commands finds the thing, its speed and place, and a far better picture."""
    monkeypatch.chdir(tmp_path)
    ms.write_layers(tmp_path, layers())
    design().save(tmp_path / "design.json")
    told = ["--design", "design.json"]
    assert cli.main(["simulate", *told, "--subject", "layers.toml", "--out", "shot"]) == 0
    frames = [f"shot/frame_{k}.png" for k in (1, 2, 3, 4)]
    capsys.readouterr()
    assert cli.main(["restore", *frames, *told, "--out", "found", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    (own,) = document["objects"]
    assert own["trusted"]
    assert abs(own["speed_px_per_s"] - SPEED) < 4 * own["error_px_per_s"] < 20
    with open("found/objects.csv", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert float(row["velocity along rows (px/s)"]) == pytest.approx(
        own["speed_px_per_s"], rel=1e-4
    )
    assert {"labels.png", "trust.png", "restored.png", "layers.toml"} <= set(document["files"])
    wanted = truth()
    restored = ms.read_picture("found/restored.png").light[..., 0]
    short = ms.read_picture(frames[1]).light[..., 0]
    assert float(ms.psnr(wanted, restored)) > float(ms.psnr(wanted, short)) + 6
    # The layers that were found are simulated again.
    again = ["simulate", *told, "--subject", "found/layers.toml", "--out", "again", "--json"]
    assert cli.main(again) == 0
    (second,) = json.loads(capsys.readouterr().out)["objects"]
    assert second["speed_px_per_s"] == pytest.approx(own["speed_px_per_s"], abs=5)
    # A speed that is told is taken, as are outlines.
    assert cli.main(["restore", *frames, *told, "--speed", "425", "--out", "told", "--json"]) == 0
    (known,) = json.loads(capsys.readouterr().out)["objects"]
    assert (known["speed_px_per_s"], known["error_px_per_s"]) == (425.0, 0.0)
    outlines = ["--outlines", "found/labels.png"]
    assert cli.main(["restore", *frames, *told, *outlines, "--out", "drawn", "--json"]) == 0
    (drawn,) = json.loads(capsys.readouterr().out)["objects"]
    assert drawn["speed_px_per_s"] == pytest.approx(SPEED, abs=6)


def test_a_sensor_that_moves_before_a_background_is_refused():
    """One line says that the sensor has to be at rest in two frames."""
    scene, moving = design().scene, ms.ParabolicMotion(acceleration=1e5, half_exposure=5e-3)
    frames = [ms.TimedFrame(moving, time) for time in (-0.01, 0.01)]
    text = "must be of a sensor at rest twice, or `speed` and `outlines` be given"
    with pytest.raises(ValueError, match=text):
        ms.restore_frames(np.ones((2, 20, 30)), scene, frames)


def test_one_exposure_has_no_objects(tmp_path, monkeypatch, capsys):
    """`--objects` needs a burst."""
    monkeypatch.chdir(tmp_path)
    replace(design(), sequence=None).save(tmp_path / "design.json")
    ms.write_layers(tmp_path, layers())
    told = ["restore", "layer_0.png", "--design", "design.json", "--objects"]
    assert "one exposure" in refused(capsys, *told)


def test_frames_before_a_background_that_moves_are_warned_of(tmp_path, monkeypatch, capsys):
    """They are restored at one speed, at which what moves at another is a double picture."""
    monkeypatch.chdir(tmp_path)
    own = design(FRAMES[1::2])
    moving = ms.Occlusion(front_share=0.2, object_width=50.0, background="moving")
    replace(own, scene=own.scene.with_occlusion(moving)).save(tmp_path / "design.json")
    for name in ("frame_1.png", "frame_2.png"):
        ms.write_picture(name, texture(np.random.default_rng(7), 32))
    told = ["frame_1.png", "frame_2.png", "--design", "design.json", "--speed", "0"]
    assert cli.main(["restore", *told]) == 0
    err = capsys.readouterr().err
    assert "warning: all of the frames is restored at one speed" in err
    assert "as --objects takes it to be" in err
