"""What commands print, note and write of an answer, without computing one."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray
from support.bad_drives import HALF_MS, STEPS, table, trace
from support.bursts import a_burst_design
from support.command_line import SMALL_SCENE
from support.designs import MOTION
from support.drive import a_design
from support.plane import a_plane_design

from mishutter import (
    BurstMode,
    FreeMotion,
    HannShutter,
    Limits,
    LinearMotion,
    Scene,
    Sensor,
    StillCamera,
)
from mishutter._core.files import ONE_EXPOSURE
from mishutter.cli import (
    app,
    camera,
    export,
    laboratory,
    plane_command,
    restore_command,
    sweep_command,
    tables,
)
from mishutter.cli.laboratory import CameraFiles, cameras
from mishutter.decoding.decoders.speed import SpeedEstimate
from mishutter.decoding.frame_velocity import VelocityEstimate
from mishutter.decoding.objects.restored import FoundObject
from mishutter.decoding.restored_frames import RestoredFrames
from mishutter.evaluation.metrics import METRICS
from mishutter.pictures.images import Capture

COVARIANCE = np.array([[130.0, -60.0], [-60.0, 70.0]])
"""Of which the longer half axis is 13.1 px/s."""


def a_speed(**others):
    speeds = np.array([-300.0, 431.6])
    given = {"doubt": "", "misfit": 1.07} | others
    return SpeedEstimate(431.6, 12.3, True, speeds, np.array([0.2, 0.8]), **given)


def a_velocity(trusted=True, doubt=""):
    velocity = np.array([431.6, -1208.2])
    return VelocityEstimate(velocity, COVARIANCE, trusted, velocity[None], np.ones(1), doubt, 1.07)


def test_a_speed_is_told_with_its_error_and_trust():
    """Of one axis and of two, found or told; where nothing is told, for all speeds."""
    told = a_speed()._replace(error=0.0)
    nothing = a_speed()._replace(weights=np.array([0.5, 0.5]))
    doubted = a_velocity(False, "two fit")
    for estimate, in_burst, words in (
        (a_speed(), False, ("432 +- 12", "trusted")),
        (told, False, ("431.6, as told", "trusted")),
        (told._replace(speed=0.0304, error=4e-2), False, ("0.03 +- 0.04", "trusted")),
        (told._replace(speed=1500.26, error=0.31), False, ("1,500.3 +- 0.31", "trusted")),
        (told._replace(speed=1500.26, error=2.3), False, ("1,500 +- 2.3", "trusted")),
        (nothing, False, ("none", "restored for all speeds of the scene")),
        (a_velocity(), True, ("432, -1,208 +- 13", "trusted")),
        (doubted, True, ("432, -1,208 +- 13", "not trusted, but used")),
        (
            a_speed()._replace(trusted=False),
            False,
            ("432 +- 12", "not trusted: restored for all likely speeds"),
        ),
    ):
        assert camera.speed_found(estimate, in_burst=in_burst) == words
    trust = {"trusted": True, "doubt": "", "misfit": 1.07}
    own = {"speed_px_per_s": 431.6, "error_px_per_s": 12.3}
    assert camera.estimate_document(a_speed()) == own | trust
    assert camera.estimate_document(nothing) == dict.fromkeys(own) | trust
    document = camera.estimate_document(doubted)
    assert document["velocity_px_per_s"] == [431.6, -1208.2]
    assert document["covariance_px2_per_s2"] == COVARIANCE.tolist()
    greatest = np.sqrt(np.linalg.eigvalsh(COVARIANCE)[1])
    assert document["error_px_per_s"] == pytest.approx(greatest)
    assert (document["trusted"], document["doubt"]) == (False, "two fit")


def test_objects_are_told_along_rows_and_columns(capsys):
    """With error, size and trust, in a table and a document; none is said in a line."""
    objects = (
        FoundObject(np.array([431.6, -12.0]), COVARIANCE, 431.6, 1210.0, (40.0, 71.5), True, ""),
        FoundObject(
            np.array([-90.0, 3.5]), np.zeros((2, 2)), -90.0, 640.0, (9.0, 8.0), False, "dim"
        ),
    )
    light = np.zeros((4, 5, 1))
    found = RestoredFrames(light, None)
    found.objects = objects
    camera.print_objects(found)
    rows = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert "1 432, -12 +- 13 1,210 trusted" in rows
    assert "2 -90, 3.5, as told 640 not trusted: dim" in rows
    first, second = camera.objects_document(found)["objects"]
    assert first["velocity_px_per_s"] == [431.6, -12.0]
    assert first["error_px_per_s"] == pytest.approx(np.sqrt(np.linalg.eigvalsh(COVARIANCE)[1]))
    assert (first["area_px"], first["place_px"]) == (1210.0, [40.0, 71.5])
    assert (second["speed_px_per_s"], second["trusted"], second["doubt"]) == (-90.0, False, "dim")
    camera.print_objects(RestoredFrames(light, None))
    assert "no object moves" in capsys.readouterr().err
    camera.print_objects(None)
    assert camera.objects_document(None) == {}
    assert "".join(capsys.readouterr()) == ""


def test_a_velocity_outside_those_of_the_scene_asks_for_its_unit(capsys):
    """By its size, in whatever direction."""
    scene = a_plane_design().scene
    fastest = float(scene.max_speed)
    laboratory.warn_beyond(scene, (-0.6 * fastest, 0.79 * fastest))
    assert capsys.readouterr().err == ""
    laboratory.warn_beyond(scene, (-0.7 * fastest, 0.8 * fastest))
    size = fastest * np.hypot(0.7, 0.8)
    assert f"--speed is {size:,.5g} px/s in all; the scene's go up to" in capsys.readouterr().err


@pytest.mark.parametrize("readout", [None, 2e-3])
def test_a_global_shutter_is_assumed_where_rows_would_change_the_speed(readout, capsys):
    """Of things that go along columns, by the square of their speed; in the plane by the part."""
    for axis, found, words in (
        ("rows", a_speed(), None),
        ("columns", a_speed(), f"speed by {431.6**2 * 1e-5:.2g} px/s"),
        ("columns", a_speed()._replace(speed=60.0), None),
        (
            "rows",
            a_velocity(),
            f"velocity by {np.hypot(431.6, 1208.2) * 1208.2 * 1e-5:.2g} px/s",
        ),
    ):
        sensor = Sensor(axis=axis, readout=readout)
        scene = Scene([-300.0, 500.0], photon_rate=1e5, read_noise=3.0, sensor=sensor)
        restore_command._note_shutter(scene, found)
        err = " ".join(capsys.readouterr().err.split())
        assert (words is not None and readout is None) == ("global shutter" in err)
        if words is not None and readout is None:
            assert words in err


def test_files_of_a_camera_stand_for_its_parts(tmp_path, capsys):
    """The drive table's motion is that of the trace; numbers of each reach what they are of."""
    (tmp_path / "scene.toml").write_text(SMALL_SCENE)
    a_design(HannShutter()).save(tmp_path / "design.json")
    np.save(tmp_path / "drive.npy", np.array([[-1.0, 0.5, 1.0, 0.0], [0.0, 0.0, 0.0, 0.0]]))
    (tmp_path / "trace.csv").write_text(trace(lambda time, level: (time + 3, 5 - level)))
    files = CameraFiles(
        drive=tmp_path / "drive.npy",
        measured=tmp_path / "trace.csv",
        exposure_ms=2 * HALF_MS,
        position_scale_px=7.0,
        floor=0.1,
        ceiling=0.8,
        middle_ms=3.0,
        closed=4.7,
        opened=2.7,
    )
    found = cameras(None, tmp_path / "design.json", files)
    assert list(found.designs) == ["as designed", "as driven", "as measured"]
    driven, measured = found.designs["as driven"], found.designs["as measured"]
    steps = np.asarray(driven.command.transmittances)
    np.testing.assert_allclose(steps, 0.1 + 0.7 * np.array([0, 0.75, 1, 0.5]))
    assert float(measured.motion.half_exposure) == pytest.approx(HALF_MS / 1e3)
    assert float(measured.motion.acceleration) == float(driven.motion.acceleration) == 0
    tau = np.linspace(-0.95, 0.95, 21)
    hann = np.cos(np.pi * tau / 2) ** 2
    np.testing.assert_allclose(measured.command.transmittance(tau), hann, atol=0.01)
    assert "Measured by trace.csv" in measured.ending
    assert found.trace.time.size == 241
    assert found.profile.closed == 4.7
    odd = CameraFiles(measured=tmp_path / "trace.csv", middle_ms=3.0)
    capsys.readouterr()
    alone = cameras(None, tmp_path / "design.json", odd).designs["as measured"]
    assert "trace.csv: it falls where the shutter opens" in capsys.readouterr().err
    assert float(alone.motion.acceleration) == float(MOTION.acceleration)
    a_plane_design().save(tmp_path / "plane.json")
    with pytest.raises(ValueError, match="--drive` must be left out for a design of frames"):
        cameras(None, tmp_path / "plane.json", CameraFiles(drive=tmp_path / "drive.npy"))
    with pytest.raises(ValueError, match="--measured` must be left out for a design of frames"):
        cameras(None, tmp_path / "plane.json", CameraFiles(measured=tmp_path / "trace.csv"))
    assert list(cameras(None, tmp_path / "plane.json", CameraFiles()).designs) == ["as designed"]
    assert len(table().splitlines()) == STEPS + 2


def test_why_a_design_has_no_path_is_said():
    """Of a stage at rest, also below a camera that pans, and of one that pans without a limit."""
    still = a_design(HannShutter(), motion=StillCamera(half_exposure=0.01))
    assert export._without_path(still) == "the stage stays at rest"
    panning = still.with_one(motion=LinearMotion(half_exposure=0.01, velocity=-312.5))
    assert "the stage pans at -312.5 px/s, and no limit" in export._without_path(panning)
    scene = Scene([-300.0], photon_rate=1e5, read_noise=3.0, limits=Limits(pans="camera"))
    words = export._without_path(replace(panning, scene=scene))
    assert words == "the stage stays at rest"


def test_losses_of_a_drive_stand_beside_the_design(capsys):
    """Those of the design first, as driven, and of a stage that is sent its path itself."""
    document = {
        "decoder_speed": "unknown",
        "level": [0, 1, 2],
        "num_levels": 5,
    }
    for index, key in enumerate(("metrics_of_design", "metrics", "metrics_of_blind_stage")):
        document[key] = {
            "psnr_of_decoder": 30.25 - index,
            "condition_number": 7.5 + index,
            "relative_kernel_difference": 0.125 * (1 + index),
            "efficiency": 0.5 - 0.125 * index,
        }
    export._print_losses(document)
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip()]
    assert lines[0] == ["3", "steps,", "5", "levels"]
    assert [row[-3:] for row in lines if row[0] in ("expected", "condition", "efficiency")] == [
        ["30.25", "29.25", "28.25"],
        ["7.5", "8.5", "9.5"],
        ["0.5", "0.375", "0.25"],
    ]


def test_frames_are_told_by_their_middles(capsys):
    """Mid-exposure, exposure and place of each, of one axis and of two."""
    from mishutter import frame_table

    for made in (a_burst_design, a_plane_design):
        found = frame_table(made())
        export._print_frames(found)
        rows = [line.split() for line in capsys.readouterr().out.splitlines()]
        exposures = np.asarray(found.exposures.exposures)
        for k, (time, exposure) in enumerate(zip(found.exposures.times, exposures, strict=True)):
            places = [f"{row[k]:.2f}" for row in found.places.values()]
            wanted = [str(k + 1), f"{1e3 * float(time):.2f}", f"{1e3 * exposure:.3g}", *places]
            assert wanted in rows


def test_a_photograph_has_its_quality_in_both_codings():
    """Linear and gamma-coded, of what was restored against what was photographed."""
    from mishutter import Picture, psnr

    light = np.full((4, 9, 1), 0.25, np.float32)
    found = camera._quality(Picture(light), light + 0.05)
    assert [*found] == ["PSNR / dB, linear light", "PSNR / dB, gamma-coded"]
    linear, coded = found.values()
    assert linear == pytest.approx(-20 * np.log10(0.05), abs=1e-3)
    apart = 0.3 ** (1 / 2.2) - 0.25 ** (1 / 2.2)
    assert coded == pytest.approx(-20 * np.log10(apart), abs=1e-3)
    assert linear == pytest.approx(float(psnr(light, light + 0.05)))


@pytest.mark.parametrize("as_json", [True, False])
def test_the_best_of_a_sweep_is_told_in_whole_exposures(as_json, monkeypatch, capsys):
    """Beside the best snapshot, and how many points are within the limits."""
    scene = Scene([410.0], photon_rate=1e5, read_noise=3.0, limits=Limits(max_stroke=90.0))
    numbers = {name: 0.5 for name in (*METRICS, "over_snapshot", "over_hann")}
    place = {"shutter": "rect", "acceleration": 2.1e5, "half_exposure": 9.75e-3, "velocity": 60.0}
    point = xarray.Dataset(numbers, place).assign_coords(at_end_of="half_exposure")
    corner = ("row", "column")
    snapshot = {"expected_psnr": 27.25, "half_exposure": 3.5e-3, "velocity": -120.0}
    found = xarray.Dataset({name: (corner, [[x]]) for name, x in snapshot.items()})
    gain = xarray.DataArray([0.0, 1.0, 2.0], dims="point")
    made = {
        "best_points": lambda gains: {"expected_psnr": point},
        "best_snapshots": lambda *_, **__: found,
        "gain_over": lambda *_: gain,
        "over_snapshots": lambda *_: gain,
        "level_of": lambda *_: "expected_psnr",
    }
    for name, function in made.items():
        monkeypatch.setattr(f"mishutter.sweeps.trade_offs.{name}", function)
    dataset = xarray.Dataset({"outside": ("point", [0, 2, 0]), "expected_psnr": 27.0})
    sweep_command._deliver(dataset, scene, None, as_json)
    out = capsys.readouterr().out
    if not as_json:
        assert "Best points of the sweep (* at an end of its range)" in out
        assert "19.5*" in out
        return
    document = json.loads(out)
    assert (document["num_points"], document["num_within_limits"]) == (3, 2)
    assert document["best_snapshot"] == {
        "expected_psnr": 27.25,
        "exposure_ms": 7.0,
        "half_exposure_ms": 3.5,
        "velocity_px_per_s": -120.0,
    }
    best = document["best"]["expected_psnr"]
    assert (best["exposure_ms"], best["half_exposure_ms"]) == pytest.approx((19.5, 9.75))
    assert best["stage_acceleration_px_per_s2"] == 2 * best["acceleration_px_per_s2"] == 4.2e5


def test_an_interrupt_after_the_search_names_its_design(tmp_path):
    """And the scene, as a shell takes them; without a folder, how to keep it."""
    assert "with --out DIR the design is saved" in app._after_search(None, None)
    folder = tmp_path / "two words"
    words = f"`mishutter compare my.toml --design '{folder / ONE_EXPOSURE}'` continues from it"
    assert words in app._after_search(Path("my.toml"), folder)
    assert "compare --design" in app._after_search(None, folder)


def test_the_whole_table_says_how_the_search_ended(capsys):
    """Of a parabola by its acceleration, of a free path by the greatest, and what is full."""
    for motion, words in (
        (MOTION.panned(-30.5), "Stage 440000 px/s^2, v = -30.5 px/s, open for 20 ms."),
        (
            FreeMotion(accelerations=[3e5, 1e5], half_exposure=0.008),
            "Stage at most 600000 px/s^2, v = 0 px/s, open for 16 ms.",
        ),
    ):
        design = a_design(HannShutter(), motion=motion)
        table = SimpleNamespace(
            title="Rows", columns=["name", "dB"], rows=[["a", "1"]], notes=["n"]
        )
        comparison = SimpleNamespace(
            text=lambda: "The answer.", details=[], tables=[table], rows=[]
        )
        measured = SimpleNamespace(lines=lambda: ["As measured: 26.38 dB."])
        report = SimpleNamespace(
            comparison=comparison, measured=measured, design=design, scene=design.scene
        )
        tables.print_comparison(report, verbose=True, next_step="go on")
        out = capsys.readouterr().out
        for said in ("The answer.", "As measured: 26.38 dB.", "Next: go on", words):
            assert said in out
        assert "Loss 0.3 (0.3 at the best start), gradient 1.0e-09." in out
        tables.print_comparison(report)
        assert "Stage" not in capsys.readouterr().out


@pytest.mark.parametrize("count", [1, 2])
def test_photographs_stand_beside_what_was_expected(count, capsys):
    """At each speed, of one decoder; of several, their means over speeds."""
    speeds, linear = np.array([-300.0, 500.0]), np.array([27.25, 28.75])
    result = SimpleNamespace(
        speeds=speeds, linear_psnr=linear, own_expected_psnr=linear + 1.5, mean_psnr=27.93
    )
    decoders = ["ensemble", "wiener"][:count]
    tables.print_photographs({name: {"hann": result} for name in decoders})
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    own = ["27.25", "28.75", "28.75", "30.25"] if count == 1 else ["27.93", "27.93"]
    assert ["hann", *own] in lines


@pytest.mark.parametrize(
    ("burst", "line"),
    [
        (None, r"`\[burst\]` must be given for things in any direction"),
        ({"frames_per_s": 55.0, "max_frames": 1}, "max_frames` must be at least 2"),
        (
            {"frames_per_s": 55.0, "window": 0.012},
            r"window_ms` must be at least 1\d\.\d+, in which",
        ),
    ],
)
def test_things_in_any_direction_need_time_for_two_frames(burst, line):
    """Unless the decoder is told the velocity, or the burst has the time."""
    scene = a_plane_design().scene
    bare = replace(scene, burst=None if burst is None else BurstMode(**burst))
    known = replace(bare, decoder_speed="known")
    plane_command._require_frames(known)
    plane_command._require_frames(replace(scene, burst=BurstMode(frames_per_s=55.0, window=0.08)))
    with pytest.raises(ValueError, match=line):
        plane_command._require_frames(bare)
    plane_command.refuse_in_plane({"--free": None, "--loss": False})
    with pytest.raises(ValueError, match="`--loss` must be left out for things that move in any"):
        plane_command.refuse_in_plane({"--free": None, "--loss": "design"})


def a_capture(name, *shape, level=0.4):
    light = np.full(shape, level, np.float32)
    return Capture(light, Path(name), "", 0.0, 1.0, 1.0, is_whole=False)


def test_frames_of_a_burst_are_alike():
    """As many as it has, of one size and as many colours; the odd one is named beside the first."""
    burst, first = a_burst_design().exposures, a_capture("a.tif", 4, 6, 1)
    for others, line in (
        (["b.tif", 4, 7, 1], r"`b.tif` must be as large as a.tif; got \(4, 7\)"),
        (["b.tif", 4, 6, 3], "`b.tif` must have as many colours as a.tif; got 3 beside 1"),
    ):
        seen = [first, a_capture(*others)]
        with pytest.raises(ValueError, match=line):
            restore_command._together(seen, restore_command._Label.of_all(seen), burst)
    with pytest.raises(ValueError, match="must be the 2 frames of the burst; got 1"):
        restore_command._together([first], restore_command._Label.of_all([first]), burst)
    both = [first, a_capture("b.tif", 4, 6, 1, level=0.7)]
    labels = restore_command._Label.of_all(both)
    ((capture, label, light),) = restore_command._together(both, labels, burst)
    assert (capture, label) == (first, labels[0])
    np.testing.assert_allclose(light, np.stack(burst.of_own_whites(x.light for x in both)))
    alone = restore_command._together(both, labels, None)
    assert [(one, each) for one, each, _ in alone] == list(zip(both, labels, strict=True))


@pytest.mark.parametrize("ratio", [1.5, 1.75])
def test_frames_that_differ_in_light_are_warned_of(ratio, capsys):
    """The brighter is named beside the darker, whichever comes first; so is an order of names."""
    seen = [a_capture(f"{name}.tif", 4, 6, 1) for name in ("f2", "f10", "f7")]
    labels = restore_command._Label.of_all(seen)
    light = np.array([0.4, 0.4 / ratio, 0.3])[:, None, None, None] * np.ones((3, 4, 6, 1))
    restore_command._note_frames(labels, light)
    err = " ".join(capsys.readouterr().err.split())
    assert ("f2.tif is 1.8 times as bright as f10.tif" in err) == (ratio > 1.6)
    assert "names are out of order are used in the order given: f2, f10, f7" in err
    restore_command._note_frames(labels[:2], 0 * light[:2] + 0.3)
    assert capsys.readouterr().err == ""
