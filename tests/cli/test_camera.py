"""`simulate` and `reproduce` from the command line: any picture in, whole files out.

A picture of any shape is captured and restored, or refused in one line.
"""

import json
import signal
import subprocess
import sys
import time
import warnings
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from support.bursts import a_burst_design
from support.command_line import SMALL_SCENE, environment, messages, refused
from support.videos import film

import mishutter as ms
from mishutter import cli
from mishutter.cli.camera import _error_words
from mishutter.cli.laboratory import warn_beyond

# No message tells this limit to a pixel, and a test just below it would decode 150 megapixels.
from mishutter.pictures.images import MAX_PIXELS

ROWS, COLUMNS = 11, 43
CODED = np.random.default_rng(9).integers(0, 256, (ROWS, COLUMNS, 4)).astype(np.uint8)
DEEP = CODED[..., :3].astype(np.uint16) * 253 + 7
WROTE = {"captured.png", "restored.png", "side_by_side.png"}
RUN = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
RUN += "from mishutter.cli import main; sys.exit(main())"
"""A command that takes SIGINT also where its parent was started to ignore it."""
MEASURED = "import resource, sys; from mishutter.cli import main; code = main(); "
MEASURED += "sys.stderr.write(str(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)); "
MEASURED += "sys.exit(code)"


def saved(array, **options):
    return lambda path: Image.fromarray(array).save(path, **options)


def cmyk(path):
    Image.fromarray(CODED[..., :3]).convert("CMYK").save(path)


def float_tiff(light):
    import tifffile

    return lambda path: tifffile.imwrite(path, light.astype(np.float32))


GOOD = {
    "rgb-16": ("a.png", lambda p: ms.write_picture(p, DEEP / 65535), (ROWS, COLUMNS, 3)),
    "rgba-8": ("a.png", saved(CODED), (ROWS, COLUMNS, 3)),
    "bilevel": ("a.png", saved(CODED[..., 0] > 99), (ROWS, COLUMNS, 1)),
    "cmyk-jpeg": ("a.jpg", cmyk, (ROWS, COLUMNS, 3)),
    "float-tiff": ("a.tif", float_tiff(CODED[..., 0] / 255), (ROWS, COLUMNS, 1)),
    "one-row": ("a.png", saved(CODED[:1, :, 0]), (1, COLUMNS, 1)),
    "one-column": ("a.png", saved(CODED[:, :1, 0]), (ROWS, 1, 1)),
    "one-pixel": ("a.png", saved(CODED[:1, :1, 0]), (1, 1, 1)),
    "narrow": ("a.png", saved(np.ascontiguousarray(CODED[:, :5, :3])), (ROWS, 5, 3)),
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A scene without a picture, of short kernels."""
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    path.write_text(SMALL_SCENE.partition("[picture]")[0])
    return path


@pytest.mark.parametrize("slug", GOOD)
def test_a_picture_is_captured_and_restored(slug, tmp_path, scene, capsys):
    """A picture of any kind, down to one pixel, is captured and restored in its own shape."""
    name, write, shape = GOOD[slug]
    write(tmp_path / name)
    out = tmp_path / "out"
    arguments = ["simulate", scene, "--subject", tmp_path / name, "--out", out, "--json"]
    assert cli.main([str(argument) for argument in arguments]) == 0
    document = json.loads(capsys.readouterr().out)
    assert set(document["files"]) == {p.name for p in out.iterdir()} == WROTE
    assert ms.read_picture(out / "restored.png").light.shape == shape


def test_a_capture_says_what_it_is_of(tmp_path, scene, capsys, monkeypatch):
    """The shutter, the motion, the speed, the decoder and the PSNR that is printed."""
    figures = []
    # Titles of the figure are text; in the file they are pixels.
    monkeypatch.setattr(
        "mishutter.report.plots.save_figure", lambda figure, _: figures.append(figure)
    )
    saved(np.ascontiguousarray(CODED[..., :3]))(tmp_path / "a.png")
    arguments = ["--subject", tmp_path / "a.png", "--shutter", "tukey:0.3", "--speed", "700"]
    arguments += ["--decoder", "wiener", "--out", tmp_path / "out", "--json"]
    assert cli.main(["simulate", str(scene), *map(str, arguments)]) == 0
    quality = json.loads(capsys.readouterr().out)["quality"]
    _, captured, restored = (axes.get_title() for axes in figures[0].axes)
    motion = ms.Scene.load(scene).motion
    how = f"{motion.exposure * 1e3:.3g} ms, stroke {motion.stroke:.3g} px, object at 700 px/s"
    name, *camera = captured.splitlines()
    assert (name, " ".join(camera)) == ("captured", f"by tukey:0.3 shutter: {how}")
    level = quality["PSNR / dB, linear light"]
    assert restored.rstrip() == f"restored\nby the wiener decoder, {level:.2f} dB (linear light)"


def bomb(path):
    Image.new("1", (20000, MAX_PIXELS // 20000 + 1)).save(path)


def cut(path):
    saved(np.ascontiguousarray(CODED[..., :3]))(path)
    path.write_bytes(path.read_bytes()[:200])


def wrong_matte(path):
    saved(CODED[..., 0])(path.with_name("back.png"))
    saved(CODED[:4, :, 0])(path.with_name("matte.png"))
    back = '[[layers]]\npicture = "back.png"\n'
    path.write_text(back + back + 'matte = "matte.png"\n')


def no_light(path):
    light = CODED[..., 0] / 255
    light[3, 4] = np.nan
    float_tiff(light)(path)


def two_sizes(path):
    path.mkdir()
    saved(CODED[..., 0])(path / "1.png")
    saved(CODED[:5, :, 0])(path / "2.png")


BAD = {
    "nan": ("a.tif", no_light, 'must hold finite pixels; got "NaN or infinite pixels'),
    "above-white": (
        "a.tif",
        float_tiff(CODED[..., 0] / 50),
        "must hold values from 0 to white, 1; got",
    ),
    "bomb": ("a.png", bomb, "at most 150 megapixels; got"),
    "cut": ("a.jpg", cut, "must name a whole PNG, JPEG, TIFF"),
    "text": ("a.png", lambda p: p.write_text("none"), "must name a whole PNG, JPEG, TIFF"),
    "missing": ("a.png", lambda p: None, "not found"),
    "matte": ("a.toml", wrong_matte, "must be as large as its picture, 43 x 11 px; got"),
    "layers": ("a.toml", lambda p: p.write_text("[[layers]]"), "picture` must be given; got"),
    "no-frames": ("frames", lambda p: p.mkdir(), "must hold pictures; got"),
    "frames-differ": ("frames", two_sizes, "must all have shape (11, 43, 1); got"),
    "no-video": ("a.mp4", lambda p: p.write_text("none"), "must name a whole video; got"),
}


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("slug", BAD)
def test_what_cannot_be_captured(slug, tmp_path, scene, capsys):
    """What is no picture, layered scene or footage is refused in one line, and writes nothing."""
    name, write, message = BAD[slug]
    write(tmp_path / name)
    out = tmp_path / "out"
    line = refused(capsys, "simulate", scene, "--subject", tmp_path / name, "--out", out)
    assert message in line
    assert not list(out.glob("*"))


USAGE = {
    "long-blur": (["--speed", "1e7"], "must blur over at most 8192 px; got"),
    "decoder": (["--decoder", "magic"], "; got 'magic'"),
    "bits": (["--adc-bits", "25"], "`--adc-bits` must be at most 24; got '25'"),
    "full-well": (["--full-well", "0"], "; got '0'"),
    "shutter-unnamed": (["--shutter", ""], "must be one of rect, hann, "),
    "shutter-and-design": (
        ["--design", "d.json", "--shutter", "hann"],
        "`--shutter` must be left out with --design; got 'hann'",
    ),
    "white": (["--white", "-3"], "error: `--white` must be above 0; got -3"),
    "seed": (
        ["--seed", str(1 << 63)],
        "`--seed` must be at most 9223372036854775807; got '9223372036854775808'",
    ),
    "no-subject": (["--subject", ""], "`--subject` must be a path of at least one character"),
    "no-design": (["--design", ""], "`--design` must be a path of at least one character"),
}


@pytest.mark.parametrize("slug", USAGE)
def test_simulate_usage(slug, tmp_path, scene, capsys):
    """An option out of its range is refused in one line."""
    arguments, message = USAGE[slug]
    saved(CODED[..., 0])(tmp_path / "a.png")
    given = ["simulate", scene, "--subject", tmp_path / "a.png", "--out", tmp_path, *arguments]
    assert message in refused(capsys, *given)


def test_layers_have_their_own_speeds(tmp_path, scene, capsys):
    """A speed on the command line is that of a photograph."""
    saved(CODED[..., 0])(tmp_path / "a.png")
    (tmp_path / "a.toml").write_text('[[layers]]\npicture = "a.png"')
    given = ["simulate", scene, "--subject", tmp_path / "a.toml", "--out", tmp_path / "out"]
    line = refused(capsys, *given, "--speed", "500")
    assert "`--speed` must be given with a photograph only; got 500" in line


@pytest.mark.parametrize("subject", ["a.png", "a.toml", "frames"])
def test_quality_is_that_of_a_photograph(subject, tmp_path, scene, capsys):
    """What moves in layers or footage is nowhere at once: there is no truth, and a note says so."""
    (tmp_path / "frames").mkdir()
    for name in ("a.png", "frames/1.png", "frames/2.png"):
        saved(CODED[..., 0])(tmp_path / name)
    (tmp_path / "a.toml").write_text('[[layers]]\npicture = "a.png"')
    given = ["simulate", scene, "--subject", tmp_path / subject, "--out", tmp_path / "out"]
    assert cli.main([str(argument) for argument in [*given, "--json"]]) == 0
    printed = capsys.readouterr()
    assert ("quality" in json.loads(printed.out)) == (subject == "a.png")
    assert ("no PSNR: " in printed.err) == (subject != "a.png")


@pytest.mark.filterwarnings("default::mishutter.pictures.images.PictureWarning")
def test_a_picture_of_few_bits_is_noted_and_may_be_told(tmp_path, scene, capsys):
    """Untold, one line says what its white may be; `--white` and `--linear` make it light."""
    import tifffile

    deep = CODED[..., :3].astype(np.uint16) * 16 + 5
    tifffile.imwrite(tmp_path / "a.tif", deep, photometric="rgb")
    given = ["simulate", scene, "--subject", tmp_path / "a.tif", "--noiseless", "--out"]
    levels = []
    for told in ([], ["--white", "4095"], ["--white", "4095", "--linear"]):
        out = tmp_path / f"out{len(told)}"
        assert cli.main([str(word) for word in (*given, out, *told, "--json")]) == 0
        said = [line for line in messages(capsys.readouterr().err) if "bits in 16" in line]
        assert len(said) == (not told)
        levels.append(ms.read_picture(out / "restored.png").light.mean())
    assert levels[0] < 0.01
    assert levels[1] == pytest.approx(((deep / 4095) ** 2.2).mean(), rel=0.05)
    assert levels[2] == pytest.approx((deep / 4095).mean(), rel=0.05)


def test_numbers_are_told_where_the_picture_is_named(tmp_path, scene, capsys):
    """Options speak of the subject's file: other pictures have keys where their files are named."""
    (tmp_path / "a.toml").write_text('[[layers]]\npicture = "a.png"')
    for told in (["--white", "900"], ["--linear"]):
        for subject in ([], ["--subject", tmp_path / "a.toml"]):
            line = refused(capsys, "simulate", scene, *subject, *told, "--out", tmp_path / "out")
            assert f"`{told[0]}` must be a key of the file that names the pictures" in line


def test_simulate_needs_a_subject(tmp_path, scene, capsys):
    """A scene without a picture needs one on the command line."""
    assert "`--subject` must be given" in refused(capsys, "simulate", scene, "--out", tmp_path)


def test_reproduce_usage(capsys):
    """`reproduce` needs a folder that takes files, and says so before it computes."""
    assert "; got" in refused(capsys, "reproduce")
    line = refused(capsys, "reproduce", "--out", "/dev/null/x")
    assert "`--out` must be a writable folder; got" in line


@pytest.mark.slow
def test_one_frame_of_video(tmp_path, scene):
    """A video of one frame, and a folder of one picture, are footage like any other."""
    film(tmp_path / "one.m4v", "-pix_fmt", "yuv420p", num_frames=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # FFmpeg's pipes
        (tmp_path / "frames").mkdir()
        saved(CODED[..., 0])(tmp_path / "frames" / "1.png")
        for name, shape in (("one.m4v", (96, 160, 3)), ("frames", (ROWS, COLUMNS, 1))):
            out = tmp_path / f"out of {name}"
            arguments = ["simulate", scene, "--subject", tmp_path / name, "--out", out, "--json"]
            assert cli.main([str(argument) for argument in arguments]) == 0
            assert ms.read_picture(out / "restored.png").light.shape == shape


def photograph(path, rows):
    """A photograph of 2,000 columns and some rows, enlarged from a shipped one."""
    light = ms.example_picture().light ** (1 / 2.2)
    small = Image.fromarray(np.rint(light * 255).astype(np.uint8))
    small.resize((2000, rows), Image.Resampling.BICUBIC).save(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("when", "sent", "code"),
    [
        ("computing", signal.SIGINT, 130),
        ("writing", signal.SIGTERM, 143),
    ],
)
def test_an_interrupt_leaves_no_half_written_file(when, sent, code, tmp_path, scene):
    """A signal ends it with its code and no traceback; what is in the folder, if any, is whole."""
    photograph(tmp_path / "a.jpg", 3500)
    out = tmp_path / "out"
    arguments = ["simulate", scene, "--subject", tmp_path / "a.jpg", "--out", out, "--noiseless"]
    command = [sys.executable, "-c", RUN, *map(str, arguments)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment())
    deadline = time.monotonic() + 120
    pattern = ".captured.png.*" if when == "writing" else "."
    while process.poll() is None and time.monotonic() < deadline:
        if out.is_dir() and (when == "computing" or list(out.glob(pattern))):
            break
        time.sleep(0.002)
    time.sleep(0.5 if when == "computing" else 0)
    process.send_signal(sent)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == code
    assert "Traceback" not in errors
    assert not list(out.glob(".*"))
    assert {ms.read_picture(path).light.shape for path in out.iterdir()} <= {(3500, 2000, 3)}


@pytest.mark.slow
def test_memory_grows_with_the_picture_alone(tmp_path, scene):
    """A pixel more takes at most 100 bytes: 24 megapixels of RGB stay within 4 GiB."""
    peaks = []
    for rows in (400, 2000):
        photograph(tmp_path / "a.jpg", rows)
        given = {"--subject": tmp_path / "a.jpg", "--out": tmp_path / "out"}
        arguments = ["simulate", scene, *(word for pair in given.items() for word in pair)]
        command = [sys.executable, "-c", MEASURED, *map(str, arguments), "--noiseless"]
        done = subprocess.run(
            command, capture_output=True, text=True, env=environment(), check=True
        )
        peaks.append(1024 * int(done.stderr.split()[-1]))
    assert peaks[1] - peaks[0] < 100 * 2000 * 1600


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (0.0, "less than 0.01"),
        (1.9e-15, "less than 0.01"),
        (0.126, "0.13"),
        (16.4, "16"),
        (3e4, "30,000"),
    ],
)
def test_errors_of_speeds_are_numbers_that_mean_something(error, words):
    """Frames without noise have no error but that of rounding."""
    assert _error_words(error) == f"+- {words}"


@pytest.mark.parametrize(
    ("speed", "warns"), [(1.2, True), (0.0, False), (310.0, False), (411.0, True)]
)
def test_a_speed_outside_those_of_the_scene_asks_for_its_unit(speed, warns, capsys):
    """Also one between 0 and the slowest; 0 is a picture at rest."""
    scene = ms.Scene([290.0, 400.0], photon_rate=1e5, read_noise=3)
    warn_beyond(scene, speed)
    told = capsys.readouterr().err
    assert ("the scene's are 290 to 400 px/s. Is its unit missing" in told) == warns


def test_messages_of_commands_hold_no_names_of_functions(tmp_path, scene, monkeypatch, capsys):
    """A folder without pictures, and an argument that a function refuses."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "adir").mkdir()
    line = refused(capsys, "simulate", scene, "--subject", "adir", "--out", "out")
    assert "error: the path must hold pictures; got folder 'adir', which has none" in line


def test_frames_before_a_background_are_refused_before_they_are_taken(tmp_path, capsys):
    """The line names the file that can be simulated."""
    design = a_burst_design()
    layers = ms.Occlusion(front_share=0.4, object_width=80.0)
    scene = replace(design.scene, decoder_speed="known", occlusion=layers)
    replace(design, scene=scene).save(tmp_path / "recommended.json")
    ms.write_picture(tmp_path / "a.png", CODED[..., 0] / 255)
    given = ["--design", tmp_path, "--subject", tmp_path / "a.png", "--out", tmp_path / "out"]
    line = refused(capsys, "simulate", *given)
    assert "as one_exposure.json beside an answer" in line
    assert "capturing" not in line
