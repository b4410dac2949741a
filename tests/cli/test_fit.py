"""`fit` from the command line: files in, the camera and its pictures out."""

import json

import numpy as np
import pytest
from support.command_line import refused
from support.drive import a_design
from support.laboratory import COMMAND, expected, recorded

from mishutter import Design, cli

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
    """Numbers with error bars, a picture, and a design that loads, on a scene through its lens."""
    given = [folder / "bench.toml", "--design", folder / "design.json", "--coefficients", "9"]
    assert cli.main(["fit", *map(str, given), "--json", "--out", str(tmp_path)]) == 0
    document = json.loads(capsys.readouterr().out)
    value, error = (
        document["estimates"]["lens_blur_px"]["value"],
        document["estimates"]["lens_blur_px"]["error"],
    )
    assert abs(value - 0.62) < 4 * error < 0.1
    assert list(document["expected_psnr_db"]) == ["as designed", "as built"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["as_built.json", "fit.png"]
    built = Design.load(tmp_path / "as_built.json")
    designed = Design.load(folder / "design.json")
    assert built.scene.deviation < designed.scene.deviation
    assert float(built.metrics.expected_psnr) == pytest.approx(
        document["expected_psnr_db"]["as built"], abs=1e-6
    )


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
    "words": (PICTURE, b"1,2\n3,dark\n", "must hold numbers alone below its heading; got 'dark'"),
    "ragged": (PICTURE, b"1,2\n3\n", "must hold 2 values a row; got 1 in '3'"),
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
    "trace-unordered": (
        PICTURE + '\n[trace]\npath = "{1}"\n',
        b"time,level\nms,V\n1,2\n0,3\n",
        "must have times that ascend; got",
    ),
}


@pytest.mark.parametrize("slug", BAD)
def test_each_bad_file_is_one_line(slug, folder, tmp_path, capsys):
    """Lists of measurements, pictures and traces that are none."""
    text, content, message = BAD[slug]
    good = ",".join(["0"] * 20 + ["900"] * 3 + ["0"] * 20).encode()
    (tmp_path / "picture").write_bytes(good if "trace" in slug else content)
    (tmp_path / "trace").write_bytes(content)
    (tmp_path / "bench.toml").write_text(text.format("picture", "trace"))
    given = ["fit", tmp_path / "bench.toml", "--design", folder / "design.json"]
    assert message in refused(capsys, *given)
