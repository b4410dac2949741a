"""`restore` from the command line: captures that a camera has taken, in any file that is read."""

import json
import re

import jax
import numpy as np
import pytest
import tifffile
from support.bursts import a_burst_design
from support.command_line import SMALL_SCENE, refused

import mishutter as ms
from mishutter import cli
from mishutter.design.design import given_design
from mishutter.pictures.images import read_captures, write_picture

SCENE = ms.Scene([0.0, 310.0, -190.0], photon_rate=2.3e6, read_noise=4.7)
MOTION = ms.ParabolicMotion(acceleration=6e4, half_exposure=9.7e-3)
SPEED = 310.0


@pytest.fixture(scope="module")
def picture():
    return ms.example_picture().light[40:104, :200]


@pytest.fixture
def desk(tmp_path, monkeypatch, picture):
    """A folder with a saved design and two captures, one of them of floating-point numbers."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(SMALL_SCENE.partition("[picture]")[0], encoding="utf-8")
    given_design(SCENE, MOTION, ms.HannShutter(), "Given.").save(tmp_path / "design.json")
    for name, speed in (("a", SPEED), ("b", -190.0)):
        seen = ms.simulate_capture(
            picture, SCENE, MOTION, ms.HannShutter(), speed=speed, key=jax.random.key(2)
        )
        tifffile.imwrite(tmp_path / f"{name}.tif", np.asarray(seen, np.float32), photometric="rgb")
        # A camera of 12 bits that states its numbers in linear light.
        counts = np.clip(np.asarray(seen[..., 0]) * 4095, 0, 4095).round().astype(np.uint16)
        tifffile.imwrite(tmp_path / f"{name}12.tif", counts)
    return tmp_path


def level(picture, path):
    return float(ms.psnr(picture, ms.read_picture(path).light))


def test_a_capture_becomes_a_picture(desk, picture, capsys):
    """By what `deconvolve` makes of it, also of noise below black; the same in 12 linear bits."""
    (seen,) = (each.light for each in read_captures("a.tif"))
    assert seen.min() < 0
    assert cli.main(["restore", "a.tif", "--design", "design.json", "--out", "out"]) == 0
    restored = ms.read_picture("out/restored.png").light
    wanted = np.clip(ms.deconvolve(seen, SCENE, MOTION, ms.HannShutter()), 0, 1)
    np.testing.assert_allclose(restored, wanted, atol=2e-3)
    assert level(picture, "out/restored.png") > float(ms.psnr(picture, seen)) + 6
    told = ["--white", "4095", "--linear", "--out", "bits"]
    assert cli.main(["restore", "a12.tif", "--design", "design.json", *told]) == 0
    grey = ms.read_picture("bits/restored.png").light[..., 0]
    np.testing.assert_allclose(grey, restored[..., 0], atol=0.04)
    assert (desk / "out" / "side_by_side.png").exists()


def test_the_speed_is_found_or_told(desk, picture, capsys):
    """Each capture has its own; a filter of the true speed is better than one for all."""
    many = ["restore", "a.tif", "b.tif", "--design", "design.json"]
    assert cli.main([*many, "--decoder", "speed-finding", "--out", "found", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["found"].keys() == {"a.tif", "b.tif"}
    assert set(document["files"]) == {
        f"{name}_{kind}"
        for name in "ab"
        for kind in ("restored.png", "restored.tif", "side_by_side.png")
    }
    for told, out in ([], "all"), (["--speed", str(SPEED)], "told"):
        assert cli.main(["restore", "a.tif", "--design", "design.json", *told, "--out", out]) == 0
    assert level(picture, "told/restored.png") > level(picture, "all/restored.png") + 0.1


@pytest.mark.parametrize("is_linear", [True, False])
def test_black_of_a_camera(desk, picture, is_linear):
    """What a camera adds to its numbers is taken off, and noise below it stays below black."""
    seen = np.asarray(read_captures("a.tif")[0].light)
    coded = seen if is_linear else np.copysign(np.abs(seen) ** (1 / 2.2), seen)
    counts = np.rint(103 + coded * (3721 - 103)).astype(np.uint16)
    assert counts.min() < 103
    tifffile.imwrite("c.tif", counts, photometric="rgb")
    told = ["--white", "3721", *(["--linear"] if is_linear else [])]
    for black in ("103", "0"):
        given = ["restore", "c.tif", "--design", "design.json", *told, "--black", black]
        assert cli.main([*given, "--out", black]) == 0
    assert cli.main(["restore", "a.tif", "--design", "design.json", "--out", "light"]) == 0
    wanted = level(picture, "light/restored.png")
    assert level(picture, "103/restored.png") == pytest.approx(wanted, abs=0.05)
    assert level(picture, "0/restored.png") < wanted - 0.2


@pytest.mark.parametrize("kind", ["whole", "floating"])
def test_a_tiff_in_the_numbers_of_the_capture(desk, kind):
    """Of 16 bits or floating-point, unclipped, with black, white and the size of a pixel kept."""
    seen = np.asarray(read_captures("a.tif")[0].light)[..., :1]
    numbers, black, white = {
        "whole": (np.rint(103 + seen * 1618).astype(np.uint16), 103.0, 1721.0),
        "floating": ((seen * 0.37 - 0.02).astype(np.float32), -0.02, 0.35),
    }[kind]
    scale = {"resolution": (3.07, 3.07), "metadata": {"unit": "um"}}
    tifffile.imwrite("c.tif", numbers[..., 0], imagej=True, **scale)
    levels = ["--black", str(black), "--white", str(white)]
    told = [*levels, "--linear", "--design", "design.json", "--out", "out"]
    assert cli.main(["restore", "c.tif", *told]) == 0
    light = ms.deconvolve((numbers - black) / (white - black), SCENE, MOTION, ms.HannShutter())
    with tifffile.TiffFile("out/restored.tif") as file:
        found = file.asarray()
        assert file.imagej_metadata["unit"] == "um"
        assert file.pages[0].resolution == pytest.approx((3.07, 3.07), rel=1e-6)
    assert found.dtype == numbers.dtype
    wanted = black + np.asarray(light)[..., 0] * (white - black)
    assert wanted.min() < black
    np.testing.assert_allclose(found, wanted, atol=0.51 if kind == "whole" else 1e-5)


def test_each_page_of_a_stack_is_a_capture(desk, capsys):
    """Pages of any count come back, each as it does alone, under numbers that sort."""
    pages = np.stack([tifffile.imread(f"{name}12.tif") for name in "ab"] * 5)
    tifffile.imwrite("stack.tif", pages, photometric="minisblack")
    told = ["--white", "4095", "--linear", "--design", "design.json", "--json"]
    assert cli.main(["restore", "stack.tif", *told, "--out", "out"]) == 0
    streams = capsys.readouterr()
    document = json.loads(streams.out)
    assert "several pictures" not in streams.err
    assert list(document["found"])[:2] == ["stack.tif 01", "stack.tif 02"]
    assert len(document["files"]) == 30
    assert cli.main(["restore", "b12.tif", *told, "--out", "alone"]) == 0
    alone = tifffile.imread("alone/restored.tif")
    np.testing.assert_array_equal(tifffile.imread("out/stack_10_restored.tif"), alone)


def test_a_scene_and_a_shutter(desk, capsys):
    """Without a design the scene's motion and a named shutter are the camera."""
    given = ["restore", "a.tif", "--scene", "scene.toml", "--shutter", "rect", "--out", "out"]
    assert cli.main(given) == 0
    assert (desk / "out" / "restored.png").exists()


def test_white_of_another_exposure(desk, capsys):
    """A restored picture brighter than white is said to be."""
    given = ["restore", "a12.tif", "--design", "design.json", "--out", "out"]
    assert cli.main([*given, "--white", "1500", "--linear"]) in (0, 2)
    assert cli.main([*given, "--white", "2100", "--linear"]) == 0
    assert "brighter than white" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["a.tif"], "`--design or --scene` must be given"),
        (["a.tif", "--scene", "scene.toml"], "`--design, --drive, --measured or --shutter` must"),
        (["a.tif", "--design", "design.json", "--shutter", "hann"], "`--shutter` must be left out"),
        (["a.tif", "a.tif", "--design", "design.json"], "must be of different names"),
        (["c.tif", "--design", "design.json"], "c.tif"),
        (["a12.tif", "--design", "design.json", "--black", "7e4"], "be above black, 70000"),
    ],
)
def test_refusals(desk, capsys, words, message):
    """What is missing, or one too many, is named in one line, and nothing is written."""
    assert message in refused(capsys, "restore", *words, "--out", "out")
    assert not (desk / "out").exists()


@pytest.fixture
def burst_desk(tmp_path, monkeypatch, capsys, picture):
    """A folder with the design of a burst and its frames, and what `simulate` said of them."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(
        "[speeds]\nlist_px_per_s = [-700, 0, 900]\n[light]\nphoton_rate_per_s = 1.3e6\n"
        "[sensor]\nread_noise_e = 3.1\n",
        encoding="utf-8",
    )
    a_burst_design().save(tmp_path / "design.json")
    write_picture(tmp_path / "subject.png", picture)
    told = ["--subject", "subject.png", "--speed", "640", "--design", "design.json"]
    assert cli.main(["simulate", "scene.toml", *told, "--out", "taken", "--json"]) == 0
    return tmp_path, json.loads(capsys.readouterr().out)


def test_a_burst_is_simulated_and_restored(burst_desk, picture, capsys):
    """Frames as a camera of one gain records them, of unlike exposures, become one picture."""
    _, document = burst_desk
    names = ["frame_1.png", "frame_2.png", "restored.png", "side_by_side.png"]
    assert document["files"] == names
    assert document["found"]["speed_px_per_s"] == pytest.approx(640, abs=5)
    first, second = (read_captures(f"taken/frame_{k}.png")[0].light for k in (1, 2))
    design = a_burst_design()
    light = ms.simulate_frames(picture, design.scene, design.sequence.frames, speed=640.0)
    own = float(np.mean(light[0]) / np.mean(light[1]))
    assert float(np.mean(first) / np.mean(second)) == pytest.approx(own * 4.2 / 13.6, rel=0.02)
    captures = ["taken/frame_1.png", "taken/frame_2.png", "--design", "design.json"]
    assert cli.main(["restore", *captures, "--out", "back", "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["files"] == ["restored.png", "side_by_side.png"]
    assert again["found"]["frame_1.png"]["speed_px_per_s"] == pytest.approx(640, abs=5)
    simulated = document["quality"]["PSNR / dB, linear light"]
    assert level(picture, "back/restored.png") == pytest.approx(simulated, abs=0.5)


def test_frames_of_a_burst_come_together(burst_desk, capsys):
    """One too few is refused, and frames of another size; footage is no photograph."""
    folder, _ = burst_desk
    alone = ["restore", "taken/frame_1.png", "--design", "design.json", "--out", "no"]
    assert "the 2 frames of the burst; got 1" in refused(capsys, *alone)
    write_picture("small.png", np.full((5, 7, 3), 0.5))
    other = ["restore", "taken/frame_1.png", "small.png", "--design", "design.json", "--out", "no"]
    assert "be as large as frame_1.png" in refused(capsys, *other)
    (folder / "footage").mkdir()
    for k in (0, 1):
        write_picture(f"footage/{k}.png", np.full((5, 7, 3), 0.5))
    moving = ["simulate", "--subject", "footage", "--design", "design.json"]
    assert "be a photograph or layers for a burst" in refused(capsys, *moving)


def test_a_burst_of_layers(burst_desk, picture, capsys):
    """The frames show each layer by its own speed, and all are restored by what speed they tell."""
    folder, _ = burst_desk
    write_picture(folder / "object.png", picture[:20, :50])
    (folder / "street.toml").write_text(
        '[[layers]]\npicture = "subject.png"\n'
        '[[layers]]\npicture = "object.png"\nspeed_px_per_s = 900.0\nleft = 70\ntop = 13\n'
    )
    told = ["--subject", "street.toml", "--design", "design.json", "--noiseless", "--json"]
    assert cli.main(["simulate", "scene.toml", *told, "--out", "street"]) == 0
    assert json.loads(capsys.readouterr().out)["files"][0] == "frame_1.png"
    design, layers = a_burst_design(), ms.Layers.load("street.toml")
    light = ms.simulate_frames(layers, design.scene, design.sequence.frames)
    seen = read_captures("street/frame_1.png")[0].light
    np.testing.assert_allclose(seen, np.clip(light[0] * 4.2 / 13.6, 0, 1), atol=4e-3)


def test_frames_of_one_name_in_folders(burst_desk, capsys):
    """Are told apart by their folders, in files that hold one each; the same file twice is not."""
    folder, _ = burst_desk
    for k in (1, 2):
        (folder / f"{k}").mkdir()
        (folder / "taken" / f"frame_{k}.png").rename(folder / f"{k}" / "img.png")
    told = ["--design", "design.json", "--out", "back", "--json"]
    assert cli.main(["restore", "1/img.png", "2/img.png", *told]) == 0
    found = json.loads(capsys.readouterr().out)["found"]
    assert found["1/img.png"]["speed_px_per_s"] == pytest.approx(640, abs=5)
    assert found["1/img.png"]["misfit"] > 0
    twice = refused(capsys, "restore", "1/img.png", "1/img.png", *told[:-1])
    assert "must be of different names" in twice


def test_a_folder_holds_the_frames(burst_desk, capsys):
    """In the order of their numbers, 2 before 10; the table and a warning name them all."""
    folder, _ = burst_desk
    (folder / "frames").mkdir()
    for old, new in (("frame_1", "f2"), ("frame_2", "f10")):
        (folder / "taken" / f"{old}.png").rename(folder / "frames" / f"{new}.png")
    command = ["restore", "frames", "--design", "design.json", "--out", "back"]
    assert cli.main(command) == 0
    out, err = capsys.readouterr()
    assert re.search(r"f2.png to f10.png +64\d \+- \d", out)
    assert re.search(r"Speed found\s+frames +px/s", out)
    assert "warning" not in err
    assert cli.main([*command, "--speed", "905"]) == 0
    out, err = capsys.readouterr()
    assert re.search(r"Speed\s+frames +px/s", out)
    assert re.search(r"f2.png to f10.png +905, as told +not trusted, but used", out)
    assert "warning: f2.png to f10.png: " in err
    assert err.startswith("warning: --speed is 905 px/s; the scene's are -700 to 900 px/s.")
    (folder / "empty").mkdir()
    line = refused(capsys, "restore", "empty", *command[2:])
    assert "`CAPTURE` must be a folder with pictures as PNG, JPEG" in line


def test_frames_that_do_not_fit_are_warned_of(burst_desk, capsys):
    """Frames of two pictures have no speed to trust; a grey one beside colour is refused."""
    folder, _ = burst_desk
    (first,) = read_captures("taken/frame_1.png")
    write_picture("taken/frame_2.png", np.roll(first.light[::-1], 31, axis=1) * 13.6 / 4.2)
    told = ["--design", "design.json", "--out", "back"]
    assert cli.main(["restore", "taken/frame_1.png", "taken/frame_2.png", *told]) == 0
    streams = capsys.readouterr()
    assert "do not fit one picture at one speed (misfit" in streams.err
    assert "not trusted" in streams.out
    grey = np.asarray(first.light, np.float32)[..., 0]
    tifffile.imwrite(folder / "grey.tif", grey)
    line = refused(capsys, "restore", "taken/frame_1.png", "grey.tif", *told)
    assert "`grey.tif` must have as many colours as frame_1.png; got 1 beside 3" in line


def test_frames_of_one_stack(burst_desk, capsys):
    """A burst may come as the pages of one TIFF, and its picture goes back as one."""
    frames = [np.asarray(read_captures(f"taken/frame_{k}.png")[0].light) for k in (1, 2)]
    stack = np.rint(np.stack(frames) * 50000 + 211).astype(np.uint16)
    tifffile.imwrite("burst.tif", stack, photometric="rgb")
    told = ["--black", "211", "--white", "50211", "--linear", "--design", "design.json", "--json"]
    assert cli.main(["restore", "burst.tif", *told, "--out", "back"]) == 0
    streams = capsys.readouterr()
    assert "warning" not in streams.err
    document = json.loads(streams.out)
    assert document["files"] == ["restored.png", "restored.tif", "side_by_side.png"]
    assert document["found"]["burst.tif 1"]["speed_px_per_s"] == pytest.approx(640, abs=5)


@pytest.mark.parametrize(
    ("names", "options", "words"),
    [
        (["frame_2", "frame_1"], [], "are used in the order given: frame_2, frame_1"),
        (["dim_1", "frame_2"], [], "frame_2.png is"),
        (["frame_1", "frame_2"], ["--black", "9000"], "times as bright as frame_1.png"),
    ],
)
def test_frames_that_are_not_those_of_the_burst(burst_desk, capsys, names, options, words):
    """Another order, exposure or black shows in the order of names, or in brightness."""
    (first,) = read_captures("taken/frame_1.png")
    write_picture("taken/dim_1.png", first.light * 0.57)
    given = [f"taken/{name}.png" for name in names]
    told = ["--design", "design.json", "--out", "back", *options]
    assert cli.main(["restore", *given, *told]) == 0
    assert words in capsys.readouterr().err
