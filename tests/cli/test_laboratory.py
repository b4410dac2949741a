"""Files that go to a laboratory and come back, through the command line.

Whatever is wrong with one is said in one line, before anything is computed or written.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from support.bad_drives import DRIVES, TRACES, trace
from support.command_line import SMALL_SCENE, messages, refused
from support.designs import MOTION, SCENE
from support.drive import a_design
from support.exports import HALF as PULSE_HALF
from support.exports import pulse, tektronix_mso
from support.rows import made_up

from mishutter import (
    Design,
    DesignLoss,
    ExpectedErrorLoss,
    FirstOrderDevice,
    HannShutter,
    RectShutter,
    Scene,
    SplineShutter,
    cli,
    read_drive,
)

# A comparison searches for minutes; the tests read what it would be given.
from mishutter.cli import app
from mishutter.cli.laboratory import AS_DESIGNED, AS_MEASURED, Cameras, note_other_device
from mishutter.design.design import GIVEN, given_design
from mishutter.hardware.traces import MeasuredProfile, Trace
from mishutter.model.scene import in_sensor_frame, scene_text
from mishutter.report import measured
from mishutter.report.comparison import Comparison
from mishutter.report.documents import Report
from mishutter.search.rivals import is_finished

LEVEL = (0.55 + 0.3 * np.sin(np.arange(11 * 90) * 0.37).reshape(11, 90)) * 255


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("laboratory")
    Image.fromarray(LEVEL.astype(np.uint8)).save(place / "photo.png")
    (place / "scene.toml").write_text(SMALL_SCENE)
    a_design(SplineShutter([0.2, 0.7, 0.9, 1.0, 0.4])).save(place / "design.json")
    return place


def content(value):
    return value if isinstance(value, bytes) else value.encode()


@pytest.mark.parametrize("slug", DRIVES)
def test_each_bad_table_is_one_line(slug, folder, tmp_path, capsys):
    """The line names the file, what must hold, and what came."""
    name, text, message = DRIVES[slug]
    (tmp_path / name).write_bytes(content(text))
    given = ["compare", folder / "scene.toml", "--design", folder / "design.json"]
    line = refused(capsys, *given, "--drive", tmp_path / name)
    assert message in line
    assert str(tmp_path / name) in line


@pytest.mark.parametrize("slug", TRACES)
def test_each_bad_trace_is_one_line(slug, folder, tmp_path, capsys):
    """Traces that are not of the exposure, or of no shutter, are refused as tables are."""
    text, message = TRACES[slug]
    (tmp_path / "trace.csv").write_text(text)
    given = ["simulate", folder / "scene.toml", "--design", folder / "design.json"]
    out = tmp_path / "out"
    line = refused(capsys, *given, "--measured", tmp_path / "trace.csv", "--out", out)
    assert message in line
    assert not out.exists()


def test_a_design_is_simulated_on_its_own_scene(folder, tmp_path, capsys):
    """Without a scene file the sensor's noise is that of the design's scene, not the built-in's."""
    own = Design.load(folder / "design.json")
    (tmp_path / "own.toml").write_text(scene_text(own.scene))
    given = ["--design", folder / "design.json", "--subject", folder / "photo.png"]

    def captured(*scene):
        out = tmp_path / str(len(scene))
        assert cli.main(["simulate", *map(str, [*scene, *given, "--out", out])]) == 0
        return (out / "captured.png").read_bytes()

    assert captured() == captured(tmp_path / "own.toml")


OPTIONS = {
    "no-file": (["compare", "--drive", "no.csv"], "'no.csv' must exist"),
    "a-folder": (["compare", "--drive", "."], "must be accessible"),
    "two-designs": (
        ["compare", "--drive", "no.csv", "--design", "a", "--design", "b"],
        "`--design` must be given at most once with --drive or --measured",
    ),
    "shutter-too": (
        ["simulate", "--drive", "no.csv", "--shutter", "hann"],
        "`--shutter` must be left out with --drive or --measured; got 'hann'",
    ),
    "half-exposure": (
        ["compare", "--drive", "{d}", "--half-exposure-ms", "0"],
        "error: `--half-exposure-ms` must be above 0; got 0.0",
    ),
    "exposure": (
        ["compare", "--drive", "{d}", "--exposure-ms", "-2"],
        "error: `--exposure-ms` must be above 0; got -2.0",
    ),
    "both-exposures": (
        ["compare", "--drive", "{d}", "--exposure-ms", "36", "--half-exposure-ms", "18"],
        "`--half-exposure-ms` must not stand beside --exposure-ms; got 18.0",
    ),
    "length-of-a-trace": (
        ["simulate", "--measured", "no.csv", "--exposure-ms", "18"],
        "`--exposure-ms` must stand beside --drive: a trace is as long as the design's exposure, "
        "or the scene's; got 18.0",
    ),
    "floor": (["compare", "--drive", "{d}", "--floor", "2"], "must lie in [0, 1); got 2.0"),
    "bytes-to-the-terminal": (
        ["export", "{j}", "--format", "rigol"],
        "`--out` must be given for a binary file; got --format rigol",
    ),
    "pulses-of-levels": (
        ["export", "{j}", "--format", "pulses", "--levels", "9"],
        "`--format pulses` must have 2 levels from 0 to 1; got 9 levels from 0 to 1",
    ),
    "one-level": (["export", "{j}", "--levels", "1"], "; got '1'"),
    "ceiling-of-export": (
        ["export", "{j}", "--ceiling", "0"],
        "must lie above the floor 0 and up to 1; got 0.0",
    ),
    "no-such-format": (["export", "{j}", "--format", "wav"], "; got 'wav'"),
}


@pytest.mark.parametrize("slug", OPTIONS)
def test_each_wrong_option_is_one_line(slug, folder, tmp_path, capsys):
    """What a reader is told is checked before its file is measured."""
    arguments, message = OPTIONS[slug]
    np.save(tmp_path / "d.npy", np.array([[0.5, -0.5]]))
    places = {"d": tmp_path / "d.npy", "j": folder / "design.json"}
    assert message in refused(capsys, *(a.format(**places) for a in arguments))


@pytest.mark.parametrize("form", ["csv", "column", "keysight", "rigol", "siglent", "npy", "pulses"])
def test_export_writes_each_format(form, folder, tmp_path, capsys):
    """Each makes a file and a picture and says what the file lacks; `csv` and `npy` are read."""
    given = ["export", folder / "design.json", "--format", form, "--steps", "24"]
    assert cli.main([*map(str, given), "--json", "--out", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert ("not in the file: " in err) == (form != "csv")
    exposure = document["exposure_ms"]
    assert (f"({exposure!r} ms, 1 is " in err) == (form != "csv")
    name, picture, path = document["files"]
    assert (picture, path) == ("drive.png", "stage.csv")
    design = Design.load(folder / "design.json")
    assert exposure == pytest.approx(1e3 * float(design.motion.exposure))
    assert (tmp_path / name).stat().st_size > 0
    if form in ("csv", "npy"):
        scale = document["position_scale_px"]
        found = read_drive(tmp_path / name, design.motion, position_scale=scale)
        steps = np.asarray(found.shutter.transmittances)
        np.testing.assert_allclose(steps, document["transmittance"], atol=1e-8)


@pytest.mark.parametrize("form", ["column", "keysight", "rigol", "siglent"])
def test_export_says_what_to_set(form, folder, tmp_path, capsys):
    """A format without time is told of with the rate of its samples, 24 in 20 ms."""
    given = ["export", folder / "design.json", "--format", form, "--steps", "24"]
    assert cli.main([*map(str, given), "--json", "--out", str(tmp_path)]) == 0
    set_to = "set the generator to 1,200 samples a second: 24 samples in 20 ms, or 50 repetitions"
    assert (set_to in capsys.readouterr().err) == (form in {"column", "rigol"})


def test_export_of_an_open_shutter_says_so(tmp_path, capsys):
    """Its table holds one level, which needs no drive."""
    a_design(RectShutter()).save(tmp_path / "design.json")
    assert cli.main(["export", str(tmp_path / "design.json"), "--steps", "4"]) == 0
    said = messages(capsys.readouterr().err)
    assert said == ["the shutter stays open for the whole exposure and needs no drive"]


def test_export_prints_the_level_of_the_designs_decoder(folder, tmp_path, capsys):
    """One that knows the speed is not judged by one filter for all."""
    design = Design.load(folder / "design.json").with_one(loss_name="KnownSpeedLoss()")
    design.save(tmp_path / "design.json")
    given = ["export", str(tmp_path / "design.json"), "--out", str(tmp_path)]
    assert cli.main(given) == 0
    out, _ = capsys.readouterr()
    line = next(line for line in out.splitlines() if "speed known / dB" in line)
    assert f"{float(design.metrics.known_speed_psnr):.4g}" in line
    assert cli.main([*given, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["decoder_speed"] == "known"
    assert document["metrics_of_design"]["psnr_of_decoder"] == pytest.approx(
        float(design.metrics.known_speed_psnr)
    )


def test_a_design_for_another_shutter_is_noted(folder, tmp_path, capsys):
    """The scene's device stands in the place of the design's, and both are told."""
    design = Design.load(folder / "design.json")
    note_other_device(tmp_path, design, design.scene)
    assert capsys.readouterr().err == ""
    device = FirstOrderDevice(rise_time=1e-3, fall_time=2e-3, delay=3e-4)
    note_other_device(
        tmp_path, design, Scene(SCENE.speeds, photon_rate=1e5, read_noise=10.0, device=device)
    )
    assert capsys.readouterr().err == (
        f"{tmp_path}: using the scene's shutter, not the design's. Design: It follows at once "
        "and loses no light. Scene: It rises from 10 to 90 % in 1 ms and falls in 2 ms, 0.3 ms "
        "late. It holds any level over each of 64 slots.\n"
    )


def test_text_goes_to_the_terminal(folder, capsys):
    """Without a folder the file itself is the result, and nothing else is on standard output."""
    design = str(folder / "design.json")
    assert cli.main(["export", design, "--format", "column", "--steps", "5"]) == 0
    out, err = capsys.readouterr()
    assert [-1 <= float(line) <= 1 for line in out.splitlines()] == [True] * 5
    assert "(20.0 ms, 1 is 22.0 px, " in err


@pytest.mark.slow
def test_simulate_tells_designed_driven_and_measured(folder, tmp_path, capsys):
    """The trace's camera is captured and restored; the PSNR of all three stands beside it."""
    cli.main(["export", str(folder / "design.json"), "--out", str(tmp_path), "--levels", "2"])
    (tmp_path / "trace.csv").write_text(trace())
    capsys.readouterr()
    given = ["simulate", folder / "scene.toml", "--design", folder / "design.json"]
    files = ["--drive", tmp_path / "drive.csv", "--measured", tmp_path / "trace.csv"]
    code = cli.main([str(x) for x in (*given, *files, "--json", "--out", tmp_path / "out")])
    out, err = capsys.readouterr()
    assert code == 0, err
    levels = json.loads(out)["expected_psnr_db"]
    assert list(levels) == ["as designed", "as driven", "as measured"]
    assert levels["as driven"] < levels["as designed"] - 0.01
    assert (tmp_path / "out" / "restored.png").exists()


def test_compare_takes_designed_driven_and_measured(folder, tmp_path, capsys, monkeypatch):
    """All three are compared as they are, the designed one on its own motion; none is tuned."""
    given = ["compare", folder / "scene.toml", "--design", folder / "design.json"]
    assert cli.main(["export", str(given[3]), "--out", str(tmp_path), "--levels", "3"]) == 0
    (tmp_path / "trace.csv").write_text(trace())
    seen = []
    # The cameras are whole before the comparison, which searches for minutes.
    monkeypatch.setattr(app, "_compared", lambda *given, **others: seen.append(given))
    monkeypatch.setattr(app, "_beside_design", lambda *given: None)
    monkeypatch.setattr(app, "_deliver", lambda *given: None)
    files = ["--drive", tmp_path / "drive.csv", "--measured", tmp_path / "trace.csv"]
    assert cli.main([str(x) for x in (*given, *files)]) == 0, capsys.readouterr().err
    scene, motion, cameras, *_ = seen[0]
    assert list(cameras) == ["as designed", "as driven", "as measured"]
    for camera in cameras.values():
        assert camera.loss_name == GIVEN
        assert camera.scene is scene
        for name in ("acceleration", "half_exposure"):
            assert float(getattr(camera.motion, name)) == pytest.approx(
                float(getattr(motion, name))
            )
    levels = np.asarray(cameras["as driven"].command.transmittances)
    assert set(np.rint(levels * 2)) == {0.0, 1.0, 2.0}
    hann = np.asarray(HannShutter().transmittance(np.linspace(-1, 1, 99)))
    found = np.asarray(cameras["as measured"].command.transmittance(np.linspace(-1, 1, 99)))
    np.testing.assert_allclose(found, hann, atol=3e-3)


def test_an_export_of_several_channels_is_read_by_options(folder, tmp_path, capsys, monkeypatch):
    """A channel by name, an inverted photodiode by its levels, and what is odd as a note."""
    time, level = pulse()
    time = time * 13e-3 / PULSE_HALF  # the scene's exposure
    (tmp_path / "scope.csv").write_text(tektronix_mso(time, np.minimum(level, 1.1), channels=2))
    seen = []
    # The cameras are whole before the comparison, which searches for minutes.
    monkeypatch.setattr(app, "_compared", lambda *given, **others: seen.append(given))
    monkeypatch.setattr(app, "_beside_design", lambda *given: None)
    monkeypatch.setattr(app, "_deliver", lambda *given: None)
    files = ["compare", folder / "scene.toml", "--measured", tmp_path / "scope.csv"]
    line = refused(capsys, *files)
    assert "must have one column of levels, or be read with the name of one as its `column`" in line
    levels = ["--closed-level", "-0.05", "--open-level", "-1.25"]
    given = [str(x) for x in (*files, "--measured-column", "CH2", *levels)]
    assert cli.main(given) == 0
    assert "scope.csv: it is clipped, with 0.15 of its samples at exactly -1.1: what" in (
        capsys.readouterr().err
    )
    tau = np.linspace(-0.35, 0.35, 9)
    found = np.asarray(seen[0][2]["as measured"].command.transmittance(tau))
    wanted = np.minimum(np.cos(np.pi * tau / 2) ** 3, (1.1 - 0.05) / 1.2)
    np.testing.assert_allclose(found, wanted, atol=0.02)


def test_a_camera_that_is_given_is_not_tuned():
    """A comparison leaves the motion of hardware as it is, whatever the scene and the loss."""
    camera = given_design(SCENE, MOTION, HannShutter(), "Built.")
    other = in_sensor_frame(SCENE, MOTION.panned(100.0))[0]
    for loss in (ExpectedErrorLoss(), DesignLoss()):
        assert is_finished(camera, other, loss)


def test_a_measured_shutter_is_judged_at_its_own_best_motion(monkeypatch):
    """Rows at the same motion have the same names; without a trace nothing is added."""
    own, seen = made_up({AS_DESIGNED: 24.1, AS_MEASURED: 23.7}), []
    same = [replace(row, reading="same motion") for row in own]
    report = Report(SCENE, Comparison((*own, *same), "V.", 0.1, 31.0), ())
    monkeypatch.setattr(measured, "measured_camera", lambda _, rows, *a, **b: seen.append(rows))
    assert app._beside_design(report, Cameras({}), 0.0) is report
    trace = Trace(np.arange(9.0), np.ones(9))
    profile = MeasuredProfile(SplineShutter([0.2, 0.9, 0.8, 0.1]), 0.01, 0.0, 1.0)
    app._beside_design(report, Cameras({}, trace, profile), 0.0)
    assert all(seen[0][row.name] is row for row in own)
