"""The path of a stage as an encoder recorded it, in place of the planned one."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest
import tifffile
from support.bursts import SEQUENCE, a_burst_design
from support.command_line import refused
from support.plane import a_plane_design, stage_paths

import mishutter as ms
from mishutter import cli
from mishutter.design.design import given_design
from mishutter.hardware.recorded_paths import (
    RecordedPath,
    _Spline,
    read_path,
    with_recorded_path,
)

CLOCK = 0.7
"""The middle of the frames on the encoder's clock; s."""


def recorded(paths, count=900, noise=0.0, bend=0.0):
    """Samples of paths on another clock, about another place, with noise and a bend."""
    time = np.linspace(-0.034, 0.033, count)
    rng = np.random.default_rng(5)
    place = np.array([path.at(time)[0] for path in paths])
    place = place + bend * np.sin(2 * np.pi * 40 * time + np.arange(len(paths))[:, None])
    return RecordedPath(time + CLOCK, place + 6.5 + noise * rng.standard_normal(place.shape))


def test_frames_in_the_plane_are_where_the_encoder_was():
    """Within a thousandth of a pixel, at any time; level and difference follow."""
    design = a_plane_design()
    path = recorded(stage_paths(design), bend=0.4)
    built, apart = with_recorded_path(design, path, middle=CLOCK)
    begin, end = design.exposures.lights[0][0], design.exposures.lights[-1][1]
    time = np.linspace(begin, end, 61)[1:-1]
    wanted = [np.interp(time, path.time - CLOCK, row) for row in path.place]
    own = np.asarray(built.sequence.frames.place(time))
    for row, place in zip(own, wanted, strict=True):
        np.testing.assert_allclose(row - row[7], place - place[7], atol=1e-3)
    np.testing.assert_array_equal(built.sequence.frames.times, design.sequence.frames.times)
    assert built.sequence.kind == design.sequence.kind
    assert apart.doubt == ""
    bend = 0.4 * np.sin(2 * np.pi * 40 * time + np.arange(2)[:, None])
    bend = bend - np.mean(bend, axis=1)[:, None]
    assert apart.rms == pytest.approx(np.sqrt(np.mean(np.sum(bend**2, axis=0))), rel=0.02)
    assert apart.greatest == pytest.approx(np.max(np.hypot(*bend)), rel=0.05)


def test_a_camera_that_turns_pans_along_both_axes():
    """Its pan, which differs along rows and columns, is added to the path of the stage."""
    law = ms.ListedVelocities(np.array([[900.0, -400.0], [1100.0, -100.0]]), np.array([0.5, 0.5]))
    limits = ms.Limits(max_half_exposure=0.01, max_acceleration=9e5, pans="camera")
    design = a_plane_design(law, limits)
    pan = np.array(design.sequence.pan)
    assert pan[0] > -2 * pan[1] > 0
    path = recorded(stage_paths(design))
    built, apart = with_recorded_path(design, path, middle=CLOCK)
    assert apart.rms < 2e-3
    times = np.linspace(-0.012, 0.01, 7)
    wanted, own = (np.asarray(each.sequence.frames.place(times)) for each in (design, built))
    np.testing.assert_allclose(own - own[:, :1], wanted - wanted[:, :1], atol=5e-3)


def test_a_doubt_names_the_travel_of_the_axis_that_goes_furthest():
    """Be it the first or the second: ten times as far as a path may differ from it."""
    design = a_plane_design()
    velocities = design.sequence.frames.velocities
    for own in (velocities, velocities[::-1]):
        frames = replace(design.sequence.frames, velocities=own)
        turned = replace(design, sequence=replace(design.sequence, frames=frames))
        path = recorded(stage_paths(turned))
        _, apart = with_recorded_path(turned, path._replace(place=-path.place), middle=CLOCK)
        assert "which travels 5.59 px" in apart.doubt


def test_the_noise_of_an_encoder_is_averaged():
    """Ten thousand samples with an error of a tenth of a pixel tell the path to a twentieth."""
    design = a_plane_design()
    path = recorded(stage_paths(design), count=10_000, noise=0.1)
    built, apart = with_recorded_path(design, path, middle=CLOCK)
    assert apart.rms < 1 / 20
    levels = [float(ms.exposures_psnr(design.scene, x.sequence)) for x in (design, built)]
    assert levels[1] == pytest.approx(levels[0], abs=0.01)


@pytest.mark.parametrize("pans", ["stage", "camera"])
def test_a_burst_along_one_axis_is_where_the_encoder_was(pans):
    """Place, velocity and path of each frame; a camera that turns adds its pan to the stage."""
    design, pan = a_burst_design(), 150.0 * (pans == "camera")
    design = replace(design, sequence=replace(design.sequence, pan=pan))
    path = design.sequence.stage_paths_within(design.scene.limits).get("")
    built, apart = with_recorded_path(design, recorded([path]), middle=CLOCK)
    pairs = list(zip(design.sequence.frames, built.sequence.frames, strict=True))
    shift = pairs[0][1].position - pairs[0][0].position
    for planned, frame in pairs:
        assert (frame.time, frame.exposure) == (planned.time, pytest.approx(planned.exposure))
        tau = np.linspace(-0.49, 0.49, 9) * planned.exposure
        own = frame.position + np.asarray(frame.motion.position(tau))
        wanted = planned.position + np.asarray(planned.motion.position(tau))
        np.testing.assert_allclose(own - shift, wanted, atol=2e-3)
    assert apart.rms < 1e-3


def test_a_frame_counts_in_the_difference_as_long_as_it_is_exposed():
    """Of a stage that is 0.8 px aside in the first of 4.2 and 13.6 ms, and not in the second."""
    design = a_burst_design()
    path = recorded([design.sequence.stage_paths_within(design.scene.limits).get("")], count=4000)
    aside = 0.8 * np.clip((path.time - CLOCK + 0.0065) / 0.008, 0, 1)
    _, apart = with_recorded_path(design, path._replace(place=path.place - aside), middle=CLOCK)
    share = 4.2 / 17.8
    assert apart.rms == pytest.approx(0.8 * np.sqrt(share * (1 - share)), rel=0.01)
    assert apart.greatest == pytest.approx(0.8 * (1 - share), rel=0.01)


def test_a_record_is_smoothed_alike_from_all_sides():
    """Run backwards, with axes exchanged, in larger pixels and on another clock."""
    rng = np.random.default_rng(7)
    time = np.sort(rng.uniform(-0.013, 0.012, 90))
    place = np.cumsum(rng.normal(size=(2, 90)), axis=1)
    lights = [(-0.0105, -0.0041), (0.0012, 0.0093)]
    back = [(-end, -begin) for begin, end in lights[::-1]]
    own = _Spline.through(RecordedPath(time, place), lights, 0.0, "own")
    turned = _Spline.through(RecordedPath(-time[::-1], place[:, ::-1]), back, 0.0, "back")
    other = _Spline.through(RecordedPath(time + 0.3, 4 - 3 * place[::-1]), lights, 0.3, "other")
    at = np.linspace(-0.0105, 0.0093, 37)
    np.testing.assert_allclose(turned.place(-at), own.place(at), atol=1e-9)
    np.testing.assert_allclose(turned.velocities[:, ::-1], -own.velocities, rtol=1e-6)
    np.testing.assert_allclose(other.place(at), 4 - 3 * own.place(at)[::-1], atol=1e-8)
    np.testing.assert_allclose(other.velocities, -3 * own.velocities[::-1], rtol=1e-6)
    np.testing.assert_allclose(other.knots, own.knots, atol=1e-12)


def test_frames_that_touch_have_no_time_between_them():
    """Three of two lengths, at rest, before which the stage had gone elsewhere."""
    halves, times = (0.0031, 0.0031, 0.0052), (-0.0083, -0.0021, 0.0062)
    frames = tuple(
        ms.TimedFrame(ms.StillCamera(half_exposure=half), time)
        for half, time in zip(halves, times, strict=True)
    )
    design = a_burst_design(replace(SEQUENCE, frames=frames, travel=0.0))
    time = np.linspace(-0.014, 0.015, 4000)
    place = 40.0 * (time + 0.0114) + 900.0 * (time + 0.0114) ** 2
    built, apart = with_recorded_path(design, RecordedPath(time, place[None]))
    for frame, planned in zip(built.sequence.frames, frames, strict=True):
        tau = np.linspace(-0.99, 0.99, 9) * planned.exposure / 2
        own = frame.position + np.asarray(frame.motion.position(tau))
        np.testing.assert_allclose(own, np.interp(planned.time + tau, time, place), atol=1e-6)
    lit = (time > -0.0114) & (time < 0.0114)
    assert apart.rms == pytest.approx(np.std(place[lit]), rel=0.01)


@pytest.mark.parametrize(
    "motion",
    [
        ms.ParabolicMotion(acceleration=3.1e4, half_exposure=7e-3, velocity=90.0),
        ms.FreeMotion(accelerations=[9e4, 1e4, -4e4, 2e4], half_exposure=7e-3, velocity=90.0),
    ],
    ids=["parabola", "free path"],
)
def test_one_exposure_takes_a_recorded_path(motion):
    """Its motion is the recorded one, with the velocity at mid-exposure."""
    scene = ms.Scene([-300.0, 500.0], photon_rate=1e5, read_noise=3.0)
    design = given_design(scene, motion, ms.HannShutter(), "Given.")
    time = np.linspace(-0.008, 0.008, 400)
    place = np.asarray(motion.position(time))[None] + 3
    built, apart = with_recorded_path(design, RecordedPath(time, place))
    tau = np.linspace(-0.007, 0.007, 11)
    np.testing.assert_allclose(built.motion.position(tau), motion.position(tau), atol=1e-6)
    assert float(built.motion.velocity) == pytest.approx(90.0, rel=1e-6)
    assert apart.greatest < 1e-6
    assert "at most" in apart.text


def test_a_path_far_from_the_planned_one_is_doubted():
    """The sign of an axis, and a clock that is half a frame off, are no path of these frames."""
    design = a_plane_design()
    path = recorded(stage_paths(design))
    flipped = path._replace(place=path.place * [[1.0], [-1.0]])
    for wrong, middle in ((flipped, CLOCK), (path, CLOCK + 0.005)):
        _, apart = with_recorded_path(design, wrong, middle=middle)
        assert f"is {apart.rms:.3g} px r.m.s. from the planned one" in apart.doubt
        assert apart.rms > 1


def test_its_own_files_are_read_back(tmp_path):
    """`stage.csv`, whose columns are in ms, px and um, is the planned path."""
    for name, axes, design in (("two", 2, a_plane_design()), ("one", 1, a_burst_design())):
        file = tmp_path / f"{name}.csv"
        file.write_text(ms.frame_table(design).stage_csv(), encoding="utf-8")
        _, apart = with_recorded_path(design, read_path(file, num_axes=axes))
        assert apart.greatest < 1e-4


@pytest.mark.parametrize(
    ("heading", "unit"),
    [("time (us),x (um),y (um)", (1e6, 4.8)), ("t/s;stage_x_nm;stage_y_nm", (1.0, 4.8e3))],
)
def test_files_of_encoders_are_read_in_their_units(heading, unit, tmp_path):
    """Times and places by their headings, whatever separates them."""
    path, file = recorded(stage_paths(a_plane_design()), count=40), tmp_path / "path.csv"
    sign = ";" if ";" in heading else ","
    rows = np.transpose([unit[0] * path.time, *(unit[1] * path.place)])
    lines = [sign.join(f"{x:.9g}" for x in row) for row in rows]
    file.write_text("\n".join([heading, *lines]), encoding="utf-8")
    read = read_path(file, num_axes=2, pixel_pitch=4.8e-6)
    np.testing.assert_allclose(read.time, path.time, rtol=1e-8)
    np.testing.assert_allclose(read.place, path.place, rtol=1e-7)


@pytest.mark.parametrize("scale", [0.031, -0.47])
def test_counts_and_volts_have_a_scale(scale, tmp_path):
    """One number is so many pixels on both axes, whatever the headings say of its unit."""
    path, file = recorded(stage_paths(a_plane_design()), count=40), tmp_path / "path.csv"
    rows = np.transpose([1e3 * path.time, *(path.place / scale)])
    lines = [",".join(f"{x:.9g}" for x in row) for row in rows]
    for heading in ("time (ms),x,y", "time (ms),x (V),y (V)", "time (ms),x (um),y (um)"):
        file.write_text("\n".join([heading, *lines]), encoding="utf-8")
        read = read_path(file, num_axes=2, scale=scale)
        np.testing.assert_allclose(read.place, path.place, rtol=1e-7)
    for wrong in (0.0, np.nan):
        with pytest.raises(ValueError, match=r"`read_path\(scale=...\)` must be"):
            read_path(file, num_axes=2, scale=wrong)


REFUSED = {
    "two axes for one": (1, "time (ms),x (px),y (px)\n0,1,2\n1,2,3", "one column of places"),
    "one axis for two": (2, "time (ms),x (px)\n0,1\n1,2", "have columns x and y"),
    "no pitch": (1, "time (ms),x (um)\n0,1\n1,2", "pixel_pitch_um"),
    "no unit": (1, "time (ms),x\n0,1\n1,2", "have the unit of x by its heading"),
    "counts": (1, "time (ms),x (counts)\n0,1\n1,2", "or a scale for counts and volts: `--stage"),
    "names": (1, "time (ms),encoder 1,encoder 2\n0,1,1\n1,2,2", "such as `time .ms.,x .um."),
    "falling times": (1, "time (ms),x (px)\n0,1\n1,2\n0.5,3", "have times that ascend"),
}


@pytest.mark.parametrize("slug", REFUSED)
def test_a_file_that_is_no_path_is_refused(slug, tmp_path):
    """One line names the file, and what it must hold."""
    axes, text, line = REFUSED[slug]
    (tmp_path / "path.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=line):
        read_path(tmp_path / "path.csv", num_axes=axes)


@pytest.mark.parametrize("heading", ["x_counts", "x (counts)", "x/counts", "stage_x_mV", "X in V"])
def test_headings_of_places_are_read_as_those_of_times(heading, tmp_path):
    """With their unit behind any sign; without a scale the unit is told."""
    file = tmp_path / "path.csv"
    file.write_text(f"time_ms,{heading}\n0,1\n1,3\n2,4\n")
    np.testing.assert_allclose(read_path(file, scale=0.5).place, [[0.5, 1.5, 2.0]])
    with pytest.raises(
        ValueError, match=r"or a scale for counts and volts: .*; got (counts|mv|v)\."
    ):
        read_path(file)


def test_a_path_that_misses_an_exposure_is_refused():
    """By the times of either clock, and by the samples of an exposure."""
    design = a_plane_design()
    path = recorded(stage_paths(design), count=900)
    with pytest.raises(ValueError, match=r"reach over all exposures, -16.5 to 16.5 ms by its cl"):
        with_recorded_path(design, path)
    few = RecordedPath(path.time[::40], path.place[:, ::40])
    with pytest.raises(ValueError, match=r"have at least 8 samples in each exposure; got \d"):
        with_recorded_path(design, few, middle=CLOCK)
    with pytest.raises(ValueError, match=r"have places along 2 axes; got 1"):
        with_recorded_path(design, RecordedPath(path.time, path.place[:1]))


def test_restore_takes_the_recorded_path(tmp_path, monkeypatch, capsys):
    """Frames of a stage that strayed are restored better by its record, which the page states."""
    monkeypatch.chdir(tmp_path)
    design = a_burst_design(sensor=ms.Sensor(pixel_pitch=4.8e-6))
    design.save("design.json")
    path = design.sequence.stage_paths_within(design.scene.limits).get("")
    strayed = recorded([path], bend=2.5)
    built, _ = with_recorded_path(design, strayed, middle=CLOCK)
    rows = zip(strayed.time * 1e3, strayed.place[0] * 4.8, strict=True)
    lines = ["time (ms),x (um)", *(f"{t:.9g},{x:.9g}" for t, x in rows)]
    (tmp_path / "encoder.csv").write_text("\n".join(lines), encoding="utf-8")
    picture = ms.example_picture().light[40:72, :260]
    frames, key = built.sequence.frames, jax.random.key(3)
    seen = ms.simulate_frames(picture, design.scene, frames, speed=900.0, key=key)
    seen = design.sequence.of_one_gain(np.asarray(seen))
    for index, frame in enumerate(seen):
        tifffile.imwrite(f"{index}.tif", np.asarray(frame, np.float32), photometric="rgb")
    command = ["restore", "0.tif", "1.tif", "--design", "design.json", "--speed", "900"]
    assert cli.main([*command, "--out", "planned", "--json"]) == 0
    assert "path" not in json.loads(capsys.readouterr().out)
    taken = ["--stage-path", "encoder.csv", "--mid-exposure-ms", f"{1e3 * CLOCK}"]
    assert cli.main([*command, *taken, "--out", "recorded", "--json"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)["path"]
    assert 0.5 < found["rms"] < found["greatest"] < 3
    assert f"{found['rms']:.2g} px r.m.s." in err
    levels = {}
    for name in ("planned", "recorded"):
        light = ms.read_picture(f"{name}/restored.png").light
        columns = light.shape[1]
        inner = slice(columns // 4, 3 * columns // 4)
        # The picture is wherever the whole path stands.
        levels[name] = max(
            float(ms.psnr(picture[:, inner.start + k : inner.stop + k], light[:, inner]))
            for k in range(-30, 31)
        )
    assert levels["recorded"] > levels["planned"] + 1
    assert "reach over all exposures" in refused(capsys, *command, *taken[:2])
    scaled = ["--stage-scale-px", str(1 / 4.8)]
    assert "be left out without --stage-path" in refused(capsys, *command, *scaled)
    assert cli.main([*command, *taken, *scaled, "--out", "scaled", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["path"]["rms"] == pytest.approx(found["rms"])
