"""`measure` from the command line: a clip in, a scene file and its pictures out."""

import json

import numpy as np
import pytest
import tifffile
from PIL import Image
from support.clips import ClipOf, Thing
from support.command_line import refused
from support.places import PLACES, best_frames

from mishutter import Scene, cli, measure
from mishutter.measurement.scene import Measurement
from mishutter.report.measurement_plots import plot_motion, plot_noise

CLIP = ClipOf(
    (Thing((96, 120), (40, 52), (9.0, 260.0)),),
    size=(192, 240),
    background="coins.png",
    num_frames=4,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("clips")
    tifffile.imwrite(place / "clip.tif", CLIP.levels(), photometric="minisblack")
    tifffile.imwrite(place / "dark.tif", CLIP.dark(), photometric="minisblack")
    return place


def words(folder, *others):
    given = ["measure", folder / "clip.tif", "--frames-per-s", "50", "--exposure-ms", "4"]
    given += ["--white", "4095", "--dark", folder / "dark.tif", *others]
    return [str(word) for word in given]


def test_json_has_every_number(folder, tmp_path, capsys):
    """One strict document, with the files."""
    others = ["--out", tmp_path / "found.toml", "--json", "--readout-ms", "4"]
    assert cli.main(words(folder, *others)) == 0
    assert "readout_ms = 4  # as given" in (tmp_path / "found.toml").read_text("utf-8")
    document = json.loads(capsys.readouterr().out)
    assert document["noise"]["electrons_at_white"]["value"] == pytest.approx(3000, rel=0.05)
    assert document["objects"][0]["right_px_per_s"] == pytest.approx(260, abs=5)
    names = ["found.toml", "motion.png", "noise.png", "picture.png", "velocities.csv"]
    assert sorted(document["files"]) == sorted(path.name for path in tmp_path.iterdir()) == names
    assert document["missing"] == []


def test_a_clip_without_a_number_says_which_key_to_fill(folder, tmp_path, capsys):
    """The file is written all the same, and the plot says why."""
    rng = np.random.default_rng(2)
    flat = rng.poisson(np.full((5, 96, 96), 900)).astype(np.uint16)
    np.save(tmp_path / "flat.npy", flat)
    given = ["measure", tmp_path / "flat.npy", "--frames-per-s", "9", "--out", tmp_path / "s.toml"]
    assert cli.main([str(word) for word in given]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "Add [light] photon_rate_per_s and [sensor] read_noise_e to" in text
    assert "lie within a factor of 1" in text


def test_mistakes_get_a_line(folder, tmp_path, capsys):
    """A scene file of another name, a JPEG, a missing file."""
    Image.fromarray(np.zeros((60, 70), np.uint8)).save(tmp_path / "a.jpg")
    given = ["--frames-per-s", "50", "--out"]
    for clip, out, line in (
        (folder / "clip.tif", tmp_path / "scene.txt", "`--out` must end in `.toml`"),
        (tmp_path / "a.jpg", tmp_path / "s.toml", "got a JPEG"),
        (tmp_path / "none.tif", tmp_path / "s.toml", "not found"),
    ):
        assert line in refused(capsys, "measure", clip, *given, out)


def test_plots_show_what_is_not_known():
    """Noise of a clip in which nothing stands still has a picture too."""
    rng = np.random.default_rng(7)
    frames = rng.integers(100, 4000, (3, 64, 72)).astype(np.uint16)
    found = measure(frames, frames_per_s=20.0)
    assert isinstance(found, Measurement)
    assert plot_noise(found).axes[0].get_title().startswith("Photon transfer: ")
    assert "at rest" in plot_motion(found).axes[0].get_title()


@pytest.mark.slow
@pytest.mark.parametrize("name", PLACES)
def test_a_scene_comes_back_from_its_clip(name, tmp_path):
    """The frames to take are the same, and their level within 0.3 dB."""
    place = PLACES[name]
    clip = place.clip
    for file, levels in (("clip.tif", clip.levels()), ("dark.tif", clip.dark())):
        tifffile.imwrite(tmp_path / file, levels, photometric="minisblack")
    given = ["measure", tmp_path / "clip.tif", "--frames-per-s", place.frames_per_s]
    given += ["--exposure-ms", place.exposure * 1e3, "--white", clip.full]
    given += ["--dark", tmp_path / "dark.tif", "--out", tmp_path / "found.toml"]
    assert cli.main([str(word) for word in given]) == 0
    found = Scene.load(tmp_path / "found.toml")
    (option, level), (truth, right) = map(best_frames, (found, place.scene_like(found)))
    assert option == truth
    assert level == pytest.approx(right, abs=0.3)
