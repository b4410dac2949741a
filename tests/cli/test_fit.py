"""`fit` from the command line: files in, the camera and its pictures out."""

import json
import re

import numpy as np
import pytest
from support.bad_drives import npy
from support.command_line import refused
from support.drive import a_design
from support.exports import HALF as PULSE_HALF
from support.exports import keysight, pulse
from support.laboratory import COMMAND, expected, recorded

from mishutter import Design, FittedCamera, ParabolicMotion, Scene, SplineShutter, cli

# A fit whose transmittance exceeds 1 needs a bench that is wrong; its text is checked alone.
from mishutter.cli import fit_command
from mishutter.hardware.calibration import estimation
from mishutter.measurement.estimates import Estimate

SPEEDS = (-1500.0, 0.0, 1700.0)
HEAD = "[sensor]\nread_noise_e = 3\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("bench")
    a_design(COMMAND).save(place / "design.json")
    motion = Design.load(place / "design.json").motion
    rng, listed = np.random.default_rng(5), [HEAD]
    for k, speed in enumerate(SPEEDS):
        light = expected(speed, "point", position=30.2, columns=88, motion=motion, shutter=COMMAND)
        np.save(place / f"{k}.npy", recorded(light, 1e5, rng)[None])
        listed.append(f'[[picture]]\npath = "{k}.npy"\nspeed_px_per_s = {speed}\n')
    (place / "bench.toml").write_text("\n".join(listed))
    return place


def test_a_camera_is_fitted_and_kept(folder, tmp_path, capsys):
    """Numbers with error bars, a picture, a design on a scene behind its lens, and a scene."""
    given = [folder / "bench.toml", "--design", folder / "design.json", "--coefficients", "9"]
    assert cli.main(["fit", *map(str, given), "--json", "--out", str(tmp_path)]) == 0
    document = json.loads(capsys.readouterr().out)
    value, error = (
        document["estimates"]["lens_blur_px"]["value"],
        document["estimates"]["lens_blur_px"]["error"],
    )
    assert abs(value - 0.62) < 4 * error < 0.1
    assert list(document["expected_psnr_db"]) == ["as designed", "as built"]
    kept = sorted(p.name for p in tmp_path.iterdir())
    assert kept == ["as_built.json", "as_built.toml", "fit.png"]
    built = Design.load(tmp_path / "as_built.json")
    scene = Scene.load(tmp_path / "as_built.toml")
    assert float(scene.motion.acceleration) == pytest.approx(float(built.motion.acceleration))
    np.testing.assert_array_equal(scene.speeds, built.scene.speeds)
    assert float(scene.optics.lens_blur) == pytest.approx(value, rel=1e-12)
    assert float(built.scene.optics.lens_blur) == pytest.approx(value, rel=1e-12)
    assert float(built.metrics.expected_psnr) == pytest.approx(
        document["expected_psnr_db"]["as built"], abs=1e-6
    )


@pytest.mark.slow
def test_all_cameras_stand_side_by_side(folder, tmp_path, capsys):
    """As designed, as driven by a table of two levels, as built, and designed again for that."""
    design = folder / "design.json"
    table = ["export", design, "--levels", "2", "--steps", "16", "--out", tmp_path / "table"]
    assert cli.main([*map(str, table)]) == 0
    capsys.readouterr()
    given = [folder / "bench.toml", "--design", design, "--coefficients", "9", "--redesign"]
    files = ["--drive", tmp_path / "table" / "drive.csv", "--out", tmp_path / "out"]
    code = cli.main(["fit", *map(str, (*given, *files))])
    out, err = capsys.readouterr()
    assert code == 0, err
    table = out[out.index("Expected behind this lens") :]
    names = ["as designed", "as driven", "as built", "re-designed for what was built"]
    levels = {n: float(re.search(rf"{n} +(\d+\.\d+)", table)[1]) for n in names}
    assert levels["as driven"] < levels["as designed"] - 0.02
    assert levels["re-designed for what was built"] >= levels["as built"]
    assert "Not identifiable: gain and transmittance apart" in out
    again = Design.load(tmp_path / "out" / "redesigned.json")
    built = Design.load(tmp_path / "out" / "as_built.json")
    assert again.motion.acceleration == built.motion.acceleration
    found = float(again.metrics.expected_psnr)
    assert found == pytest.approx(levels["re-designed for what was built"], abs=6e-3)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_trace_is_brought_upright_for_the_fit(sign, folder, tmp_path, capsys, monkeypatch):
    """The fit takes few samples in which light is upwards; what is odd of them is a note."""
    time, level = pulse(9000)
    text = keysight(time * 0.01 / PULSE_HALF, sign * level)
    (tmp_path / "scope.csv").write_text(text)
    listed = (folder / "bench.toml").read_text("utf-8").replace('path = "', f'path = "{folder}/')
    (tmp_path / "bench.toml").write_text(listed + '[trace]\npath = "scope.csv"\n')
    taken = []

    def stop(found, *_, **__):
        taken.append(found.trace)
        raise ValueError("enough")

    # The trace is whole before the fit, which would take the longer part of the test.
    monkeypatch.setattr(estimation, "fit", stop)
    given = [tmp_path / "bench.toml", "--design", folder / "design.json"]
    assert cli.main(["fit", *map(str, given)]) == 2
    assert ("it is read as inverted" in capsys.readouterr().err) == (sign < 0)
    (trace,) = taken
    assert trace.time.size < 4500
    middle = np.abs(trace.time) < 1e-3
    assert np.mean(trace.level[middle]) > np.mean(trace.level[:99]) + 1


def a_camera(**changes):
    """A fitted camera whose fifth coefficient is above 1."""
    motion = ParabolicMotion(acceleration=3.1e5, half_exposure=0.01, velocity=-180.0)
    coefficients = np.array([0.05, 0.3, 0.71, 0.97, 1.06, 0.94, 0.66, 0.27, 0.08])
    numbers = {
        "shutter": SplineShutter(np.minimum(coefficients, 1)),
        "coefficients": coefficients,
        "coefficient_errors": np.linspace(0.017, 0.033, 9),
        "estimates": {"lens_blur_px": Estimate(0.62, 0.01)},
        "not_identifiable": (),
        "names": ("a.csv",),
        "levels": (np.arange(9.0),),
        "expected": (np.arange(9.0),),
        "noise": (np.ones(9),),
        "chi_squared": 5.0,
        "num_free": 3,
    }
    return FittedCamera(motion=motion, **numbers | changes)


def test_a_transmittance_above_1_is_printed_with_its_meaning(capsys):
    """1.06 is told in error bars above an open shutter; coefficients up to 1 take no sentence."""
    fit_command._print(a_camera(), {"as built": 27.3})
    out = " ".join(capsys.readouterr().out.split())
    assert "Transmittance 4, of 1.06, is 2.4 error bars above an open shutter. A fit" in out
    assert "transmittance 3 0.9700 0.023 transmittance 4 1.0600 0.025" in out
    fit_command._print(a_camera(coefficients=np.linspace(0, 1, 9)), {"as built": 27.3})
    assert "above an open" not in capsys.readouterr().out


def test_the_acceleration_is_that_of_the_stage(capsys):
    """Twice `a` with twice its error, in the table and in the document, which has `a` too."""
    named = {"acceleration_px_per_s2": Estimate(3.1e5, 700.0), "delay_ms": Estimate(0.2, 0.01)}
    camera = a_camera(estimates=named)
    fit_command._print(camera, {"as built": 27.3})
    (row,) = (x for x in capsys.readouterr().out.splitlines() if "acceleration_px_per_s2" in x)
    assert re.findall(r"[\w.+]+", row) == ["stage_acceleration_px_per_s2", "620000", "1.4e+03"]
    found = camera.to_dict()["estimates"]
    assert found["stage_acceleration_px_per_s2"] == {"value": 6.2e5, "error": 1400.0}
    assert found["acceleration_px_per_s2"]["value"] == 3.1e5


@pytest.mark.parametrize("chi_squared", [5.0, 91.0])
def test_the_doubt_comes_before_the_numbers(chi_squared, capsys):
    """How well the camera explains its pictures is read before 28 rows of what it is."""
    camera = a_camera(chi_squared=chi_squared)
    fit_command._print(camera, {"as built": 27.3})
    first, *others = capsys.readouterr().out.splitlines()
    chi = f"Chi squared for each free level: {camera.reduced_chi_squared:.3f}, which"
    assert first.startswith(chi)
    assert ("IMPLAUSIBLE, see the warning" in " ".join([first, *others])) == (chi_squared == 91.0)
    assert not any("Chi squared" in line for line in others)


PICTURE = '[[picture]]\npath = "{0}"\n'
BAD = {
    "no-picture": (HEAD, b"", "`picture` must be given; got nothing"),
    "no-such-target": (
        PICTURE + 'target = "line"\n',
        b"1",
        "`picture[0].target` must be 'point' o",
    ),
    "speed-in-km-h": (PICTURE + "speed_km_per_h = 3\n", b"1", "must hold known keys only"),
    "half-an-array": (PICTURE, b"\x93NUMPY\x01", "must be a whole .npy file; got: "),
    "words": (
        PICTURE,
        b"1,2\n3,dark\n",
        "numbers a row; got: could not convert string 'dark'",
    ),
    "ragged": (
        PICTURE,
        b"1,2\n3\n",
        "hold 2 numbers a row; got: the number of columns changed",
    ),
    "narrow": (PICTURE, b"1,2,3\n", "must have at least 16 columns; got 3"),
    "saturated": (
        PICTURE + "\n[sensor]\nfull_level = 4095\n",
        (",".join(["0"] * 20 + ["4095"] * 3 + ["0"] * 20)).encode(),
        "must stay below the full level 4095 in every pixel; got 4095.0",
    ),
    "no-edge": (
        PICTURE + 'target = "edge"\n',
        ",".join(["7"] * 40).encode(),
        "must hold an edge: levels at its ends that differ by more than the noise; got 7 and 7",
    ),
    "not-toml": ("[[picture]\n", b"1", "bench.toml must be a TOML file; got: "),
    "not-text": (
        PICTURE,
        b"\x89PNG\r\n\x1a\n\x00",
        "must hold the levels of a picture as CSV or .npy; got ",
    ),
    "no-such-file": (
        '[[picture]]\npath = "gone.csv"\n',
        b"1",
        "gone.csv' must exist; got: file not found",
    ),
    "empty": (PICTURE, b"", "must hold at least one line; got an empty file"),
    "complex": (PICTURE, npy(np.zeros((2, 40), complex)), "must hold real numbers; got complex128"),
    "a-cube": (PICTURE, npy(np.zeros((2, 3, 40))), "must have rows; got shape (2, 3, 40)"),
    "nan": (PICTURE, npy(np.full((2, 40), np.nan)), "must be finite; got nan at [0, 0]"),
    "speed-of-light": (
        PICTURE + "speed_px_per_s = 3e8\n",
        b"1",
        "`picture[0].speed_px_per_s` must be at most 1e+07; got 300000000.0",
    ),
    "a-tiff": (PICTURE, b"II*\0\x08\0\0\0", "a picture as CSV or .npy; got a file that is neither"),
    "no-electrons": (
        "[sensor]\nelectrons_per_level = 0\n" + PICTURE,
        b"1",
        "`sensor.electrons_per_level` must be above 0; got 0",
    ),
    "noise-below-nothing": (
        "[sensor]\nread_noise_e = -3\n" + PICTURE,
        b"1",
        "`sensor.read_noise_e` must be at least 0; got -3",
    ),
    "unequal-widths": (
        PICTURE + '[[picture]]\npath = "{2}"\n',
        ",".join(["0"] * 20 + ["900"] * 3 + ["0"] * 25).encode(),
        "must have pictures of equally many columns; got [43, 48]",
    ),
    "cut-off": (
        PICTURE,
        ",".join(["0"] * 20 + [str(900 * k) for k in range(20)]).encode(),
        "must end in 4 columns that the blur does not reach; got levels that change by",
    ),
    "edge-as-a-point": (
        PICTURE,
        ",".join(["7"] * 20 + ["900"] * 20).encode(),
        "must hold a point: the same level at both ends; got 7 and 900",
    ),
    "trace-in-minutes": (
        PICTURE + '\n[trace]\npath = "{1}"\n',
        b"time,level\nmin,V\n0,2\n1,3\n",
        "must name s, ms, us or ns as the unit of a column of times, as `time (s),level` above ",
    ),
    "trace-unordered": (
        PICTURE + '\n[trace]\npath = "{1}"\n',
        b"time,level\nms,V\n1,2\n0,3\n",
        "must have times that ascend; got",
    ),
}


@pytest.mark.parametrize("slug", BAD)
def test_each_bad_file_is_one_line(slug, folder, tmp_path, capsys):
    """Twenty-five lists of measurements, pictures and traces that are none."""
    text, content, message = BAD[slug]
    good = ",".join(["0"] * 20 + ["900"] * 3 + ["0"] * 20).encode()
    (tmp_path / "picture").write_bytes(good if "trace" in slug else content)
    (tmp_path / "trace").write_bytes(content)
    (tmp_path / "good").write_bytes(good)
    (tmp_path / "bench.toml").write_text(text.format("picture", "trace", "good"))
    given = ["fit", tmp_path / "bench.toml", "--design", folder / "design.json"]
    assert message in refused(capsys, *given)
