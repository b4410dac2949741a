"""A scene file means what its key names say, and every mistake in one is named in one line."""

import math
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import imagecodecs
import numpy as np
import pytest
from support.bad_scenes import EXAMPLE, LINES, edited

from mishutter import (
    BurstMode,
    FirstOrderDevice,
    FreeMotion,
    HannShutter,
    IdealDevice,
    Limits,
    MeasurementErrors,
    Objects,
    Occlusion,
    Optics,
    ParabolicMotion,
    Scene,
    SecondOrderStage,
    Sensor,
    SwitchedDevice,
    Texture,
    Tolerances,
)
from mishutter.model.limits import LEAST_STROKE
from mishutter.model.scene import (
    example_scene,
    read_scene,
    scene_of_tables,
    scene_tables,
    scene_text,
)
from mishutter.model.scene_file import example_scene_text
from mishutter.model.scene_units import SceneWarning
from mishutter.pictures.images import (
    example_picture,
    read_picture,
    row_power_spectrum,
    write_picture,
)


def written(folder, text, name="scene.toml"):
    path = folder / name
    path.write_text(text)
    return path


def test_units_of_the_built_in_scene():
    """Milliseconds become seconds, and a stroke becomes an acceleration."""
    scene = example_scene()
    assert scene.motion.half_exposure == pytest.approx(0.01, rel=1e-15)
    assert scene.motion.stroke == pytest.approx(45, rel=1e-14)
    assert scene.limits.max_half_exposure == pytest.approx(0.04, rel=1e-15)
    assert scene.limits.min_half_exposure == pytest.approx(5e-4, rel=1e-15)
    assert (float(scene.limits.max_stroke), float(scene.limits.max_top_speed)) == (45, 2e4)
    assert (float(scene.photon_rate), float(scene.read_noise)) == (1e5, 8)
    np.testing.assert_allclose(scene.speeds, np.arange(-4, 5) * 1125.0, rtol=1e-14)
    np.testing.assert_allclose(scene.weights, np.full(9, 1 / 9), rtol=1e-14)


def test_a_picture_gives_the_spectrum(tmp_path):
    """The photograph's own rows replace the assumed spectrum, mean and deviation."""
    scene = Scene.load(str(written(tmp_path, EXAMPLE)))
    spectrum = row_power_spectrum(example_picture(), 256)
    assert scene.picture.path == "example"
    assert scene.picture.mean_level == pytest.approx(spectrum.mean_level, rel=1e-12)
    assert scene.picture.deviation == pytest.approx(spectrum.deviation, rel=1e-12)
    np.testing.assert_allclose(scene.picture.power_spectrum, spectrum.power_spectrum, rtol=1e-12)


@pytest.mark.parametrize("speed", ["found", "known"])
def test_a_file_names_the_decoder(speed, tmp_path):
    """What it knows of the speed is kept by the file that is written; a third word is refused."""
    text = f'{EXAMPLE}\n[decoder]\nspeed = "{speed}"\n'
    scene = Scene.load(str(written(tmp_path, text)))
    assert scene.decoder_speed == speed
    again = read_scene(written(tmp_path, scene_text(scene), "again.toml"))
    assert again.decoder_speed == speed
    with pytest.raises(ValueError, match=r"`\[decoder\] speed` must be .*; got 'guessed'"):
        read_scene(written(tmp_path, text.replace(speed, "guessed")))


def test_picture_paths_start_at_the_file(tmp_path, monkeypatch):
    """A relative path is taken from the scene file's folder, wherever one stands."""
    folder = tmp_path / "scenes"
    folder.mkdir()
    light = np.random.default_rng(3).uniform(0.1, 0.7, (13, 37))
    write_picture(folder / "photo.png", light)
    path = written(folder, edited("path", 'path = "photo.png"'))
    monkeypatch.chdir("/")
    scene = read_scene(path)
    assert scene.picture.path == str(folder / "photo.png")
    assert scene.picture.mean_level == pytest.approx(light.mean(), abs=1e-4)
    monkeypatch.chdir(folder)
    assert read_scene("scene.toml").picture.path == str(folder / "photo.png")


@pytest.mark.parametrize(
    ("told", "coded"), [("white = 4095", 2.2), ("white = 4000.5\nlinear = true", 1.0)]
)
def test_a_picture_is_read_as_its_keys_say(told, coded, tmp_path):
    """Twelve bits in sixteen have their white, and numbers that are light are taken as it."""
    levels = np.random.default_rng(6).integers(90, 4000, (13, 37)).astype(np.uint16)
    (tmp_path / "photo.png").write_bytes(imagecodecs.png_encode(levels))
    scene = Scene.load(written(tmp_path, edited("path", f'path = "photo.png"\n{told}')))
    light = (levels / scene.picture.white) ** coded
    assert scene.picture.mean_level == pytest.approx(light.mean(), rel=1e-5)
    assert scene.picture.deviation == pytest.approx(light.std(), rel=1e-5)
    np.testing.assert_allclose(scene.picture.photograph().light[..., 0], light, rtol=1e-5)
    again = read_scene(written(tmp_path, scene_text(scene), "again.toml"))
    assert eqx.tree_equal(again.picture.mean_level, scene.picture.mean_level)
    assert (again.picture.white, again.picture.linear) == (
        scene.picture.white,
        scene.picture.linear,
    )


def test_without_a_picture_levels_may_be_given(tmp_path):
    """A scene without a photograph states its mean and deviation, or takes the defaults."""
    plain = EXAMPLE.replace('path = "example"', "")
    assert read_scene(written(tmp_path, plain)).picture.power_spectrum is None
    stated = read_scene(written(tmp_path, edited("path", "mean_level = 0.31\ndeviation = 0.17")))
    assert (float(stated.picture.mean_level), float(stated.picture.deviation)) == (0.31, 0.17)


def test_a_normal_distribution_has_its_moments(tmp_path):
    """Centres of equal steps over three deviations keep mean and width, but for what is cut off."""
    form = "normal = { mean_px_per_s = 300, deviation_px_per_s = 800, count = 61 }"
    scene = read_scene(written(tmp_path, edited("uniform", form)))
    mean = float(np.sum(scene.weights * scene.speeds))
    variance = float(np.sum(scene.weights * (scene.speeds - 300) ** 2))
    cut = 1 - 2 * 3 * np.exp(-4.5) / np.sqrt(2 * np.pi) / 0.9973
    assert mean == pytest.approx(300, rel=1e-12)
    assert variance == pytest.approx(800**2 * cut, rel=2e-3)


def test_a_list_keeps_its_weights(tmp_path):
    """Listed speeds occur as often as their weights say, on any scale, or equally often."""
    form = "list_px_per_s = [0, 1500, -700]\nweights = [5, 3, 2]"
    scene = read_scene(written(tmp_path, edited("uniform", form)))
    np.testing.assert_allclose(scene.weights, [0.5, 0.3, 0.2], rtol=1e-14)
    equal = read_scene(written(tmp_path, edited("uniform", "list_px_per_s = [0, 1500, -700]")))
    np.testing.assert_allclose(equal.weights, np.full(3, 1 / 3), rtol=1e-14)


def test_one_speed_is_a_range_of_one_end(tmp_path):
    """A scene of one speed may be written as a range from it to itself."""
    form = "uniform = { min_px_per_s = 300, max_px_per_s = 300, count = 1 }"
    assert read_scene(written(tmp_path, edited("uniform", form))).speeds.tolist() == [300.0]


def without_stage(text):
    """A scene file whose stage takes any path within the stroke and the top speed."""
    return re.sub(r"^max_(travel|acceleration)_.*\n", "", text, flags=re.MULTILINE)


def test_without_a_motion_the_limits_are_used_up(tmp_path):
    """The default motion is the longest stroke at the highest speed, within the exposures."""
    text = re.sub(r"\[motion\].*?(?=\n#)", "", without_stage(EXAMPLE), flags=re.DOTALL)
    scene = read_scene(written(tmp_path, text))
    assert scene.motion.stroke == pytest.approx(45, rel=1e-12)
    assert scene.motion.top_speed == pytest.approx(2e4, rel=1e-12)


@pytest.mark.parametrize(
    ("limit", "stroke", "top_speed"),
    [("max_exposure_ms = 6", 30, 2e4), ("min_exposure_ms = 18", 45, 1e4)],
)
def test_without_a_motion_an_exposure_may_be_the_limit(limit, stroke, top_speed, tmp_path):
    """Where it is too short for the stroke, or too long for the speed."""
    text = without_stage(edited(limit.split()[0], limit))
    text = re.sub(r"\[motion\].*?(?=\n#)", "", text, flags=re.DOTALL)
    motion = read_scene(written(tmp_path, text)).motion
    assert motion.stroke == pytest.approx(stroke, rel=1e-12)
    assert motion.top_speed == pytest.approx(top_speed, rel=1e-12)


def test_the_optics_cut_off_where_they_say(tmp_path):
    """In cycles a pixel."""
    path = written(tmp_path, edited("cutoff", "cutoff_cycles_per_px = 0.31"))
    assert float(read_scene(path).optics.cutoff_frequency) == 0.31


def test_an_acceleration_may_be_given(tmp_path):
    """That of the stage, or the `a` of `x = a t^2`, which is half of it."""
    for line in ("stage_acceleration_px_per_s2 = 6.2e5", "acceleration_px_per_s2 = 3.1e5"):
        path = written(tmp_path, edited("stroke_px", line))
        assert read_scene(path).motion.acceleration == pytest.approx(3.1e5, rel=1e-14)


def test_a_velocity_may_be_given(tmp_path):
    """`velocity_px_per_s` is the `v` of `x = v t + a t^2`, within the largest pan and top speed."""
    turned = edited("max_stroke_px", 'max_stroke_px = 45\npans = "camera"')
    for velocity in (-11000.0, 0.0, 700.5):
        pans = turned.replace("\nstroke_px", f"\nvelocity_px_per_s = {velocity}\nstroke_px")
        motion = read_scene(written(tmp_path, pans)).motion
        assert float(motion.velocity) == velocity
        assert float(motion.top_speed) == pytest.approx(9000 + abs(velocity), rel=1e-12)
    assert float(example_scene().motion.velocity) == 0


@pytest.mark.parametrize("velocity", [0.0, 310.7, -700.5])
def test_a_sag_may_be_given(tmp_path, velocity):
    """`sag_px` is $aT^2$ whatever the pan, also in mm; so is the stroke of a still stage."""
    lines = f"sag_px = 31.7\nvelocity_px_per_s = {velocity}"
    motion = read_scene(written(tmp_path, edited("stroke_px", lines))).motion
    assert float(motion.sag) == pytest.approx(31.7, rel=1e-14)
    in_mm = lines.replace("sag_px = 31.7", "sag_mm = 0.1")
    scene = read_scene(written(tmp_path, edited("stroke_px", in_mm)))
    pitch = 0.1 / float(scene.motion.sag)
    assert 1e3 * pitch == pytest.approx(3.45, rel=1e-12)
    if velocity == 0:
        still = read_scene(written(tmp_path, edited("stroke_px", "stroke_px = 31.7"))).motion
        assert float(still.acceleration) == float(motion.acceleration)


def test_the_stroke_holds_the_pan_of_the_stage(tmp_path):
    """A stage that pans needs room for that; where the camera turns the stage does not."""
    pans = edited("max_stroke_px", 'max_stroke_px = 45\npans = "{}"')
    pans = pans.replace("\nstroke_px = 45", "\nvelocity_px_per_s = 300\nsag_px = 43")
    read = {}
    for kind in ("stage", "camera"):
        path = written(tmp_path, pans.replace("{}", kind))
        if kind == "stage":
            with pytest.raises(
                ValueError, match=r"max_stroke_px = 45; got 46\.\d+ px, the pan inc"
            ):
                read_scene(path)
        else:
            read[kind] = read_scene(path)
    scene = read["camera"]
    assert scene.limits.pans == "camera"
    assert float(scene.motion.stroke) > 45 > float(scene.motion.sag)
    (tmp_path / "again.toml").write_text(scene_text(scene))
    assert read_scene(tmp_path / "again.toml").limits.pans == "camera"
    with pytest.raises(ValueError, match="pans"):
        read_scene(written(tmp_path, pans.replace("{}", "tripod")))


def test_the_largest_pan_may_be_given(tmp_path):
    """It is the top speed unless it is given; a motion that pans faster is refused."""
    assert float(example_scene().limits.max_pan) == 2e4
    for most in (0.0, 300.0):
        text = edited("max_stroke_px", f"max_stroke_px = 45\nmax_pan_px_per_s = {most}")
        assert float(read_scene(written(tmp_path, text)).limits.max_pan) == most
    for velocity in (-301.0, 300.01):
        pans = text.replace("\nstroke_px", f"\nvelocity_px_per_s = {velocity}\nsag_px")
        subject = "`[motion] velocity_px_per_s`"
        message = (
            f"{subject} must keep the pan within max_pan_px_per_s = 300; got {abs(velocity):g}"
        )
        with pytest.raises(ValueError, match=re.escape(message)):
            read_scene(written(tmp_path, pans))


def test_stages_have_units(tmp_path):
    """Travel in px or mm, acceleration and jerk in px or g, by the pitch of the pixels."""
    built_in = example_scene().limits
    assert float(built_in.max_travel) == pytest.approx(250 / 3.45, rel=1e-14)
    assert float(built_in.max_acceleration) == pytest.approx(0.8 * 9.80665e6 / 3.45, rel=1e-14)
    assert built_in.max_jerk is None
    text = edited("max_travel_mm", "max_travel_mm = 0.5\nmax_jerk_g_per_s = 900")
    text = text.replace("max_acceleration_g = 0.8", "max_acceleration_g = 0.4")
    with pytest.raises(ValueError, match=r"`\[sensor\] pixel_pitch_um` must be given where \[lim"):
        read_scene(written(tmp_path, text.replace("pixel_pitch_um = 3.45\n", "")))
    limits = read_scene(written(tmp_path, text)).limits
    assert float(limits.max_travel) == pytest.approx(500 / 3.45, rel=1e-14)
    assert float(limits.max_acceleration) == pytest.approx(0.4 * 9.80665e6 / 3.45, rel=1e-14)
    assert float(limits.max_jerk) == pytest.approx(900 * 9.80665e6 / 3.45, rel=1e-14)
    with pytest.raises(ValueError, match="must leave the stage room to run up and out"):
        read_scene(written(tmp_path, edited("max_travel_mm", "max_travel_px = 44")))
    both = edited("max_travel_mm", "max_travel_mm = 1\nmax_travel_px = 300")
    with pytest.raises(ValueError, match="max_travel_mm` must not stand beside max_travel_px"):
        read_scene(written(tmp_path, both))


def test_tolerances_have_units(tmp_path):
    """Shares, px/s and microseconds; what is left out is 0, and without a section there is none."""
    section = (
        "\n[tolerances]\nacceleration_share = 0.03\ndelay_us = 120\nobject_speed_px_per_s = 210\n"
    )
    driven = "transmittance = 0.02\ndrive_step_us = 50\n"
    found = read_scene(written(tmp_path, EXAMPLE + section + driven)).tolerances
    assert float(found.acceleration) == 0.03
    assert float(found.delay) == pytest.approx(1.2e-4, rel=1e-14)
    assert (float(found.speed), float(found.velocity)) == (210, 0)
    assert float(found.transmittance) == 0.02
    assert float(found.drive_step) == pytest.approx(5e-5, rel=1e-14)
    assert example_scene().tolerances is None
    message = "`[tolerances] drive_step_us` must be given where transmittance has an error"
    with pytest.raises(ValueError, match=re.escape(message)):
        read_scene(written(tmp_path, EXAMPLE + section + "transmittance = 0.02\n"))


def test_a_file_says_what_hides_what(tmp_path):
    """Share, width, background and level of objects; without the section there is no background."""
    keys = "front_share = 0.31\nobject_width_px = 73\nlevel_difference = -0.07\n"
    path = written(tmp_path, f'{EXAMPLE}\n[occlusion]\n{keys}background = "moving"\n')
    wanted = Occlusion(
        front_share=0.31, object_width=73.0, level_difference=-0.07, background="moving"
    )
    assert eqx.tree_equal(read_scene(path).occlusion, wanted)
    plain = written(tmp_path, f"{EXAMPLE}\n[occlusion]\nfront_share = 0.31\n")
    assert eqx.tree_equal(read_scene(plain).occlusion, Occlusion(front_share=0.31))
    assert example_scene().occlusion is None


def test_the_narrower_of_sensor_and_object_counts(tmp_path):
    """Frames are registered within it; a scene without widths has none, and no width is refused."""
    bare = read_scene(written(tmp_path, EXAMPLE))
    assert bare.registered_width is None
    told = read_scene(written(tmp_path, f"{EXAMPLE}\n[objects]\nwidth_px = 71\n"))
    assert told.registered_width == 71
    for width, least in ((430.0, 71.0), (33.0, 33.0)):
        sensor = Sensor(width=width)
        scene = eqx.tree_at(lambda s: s.sensor, told, sensor, is_leaf=lambda x: x is None)
        assert scene.registered_width == least
    with pytest.raises(ValueError, match=r"`\[objects\] width_px` must be given; got nothing"):
        read_scene(written(tmp_path, f"{EXAMPLE}\n[objects]\n"))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("object_width_px = 30", "`[occlusion] front_share` must be given"),
        ("front_share = 1.1", "`[occlusion] front_share` must be at most 1; got 1.1"),
        ("front_share = 0.3\nobject_width_px = 0", "`[occlusion] object_width_px` must be above 0"),
        (
            "front_share = 0.3\nobject_width_px = 9\nobject_width_m = 2",
            "`[occlusion] object_width_m` must not stand beside object_width_px; got 2",
        ),
        (
            "front_share = 0.3\nobject_width_mm = 9",
            "where [occlusion] object_width_mm is given; got nothing",
        ),
        (
            "front_share = 0.3\nlevel_difference = 0.1",
            "`[occlusion] level_difference` must stand beside object_width_px",
        ),
        (
            'front_share = 0.3\nbackground = "moves"',
            "`[occlusion] background` must be 'still' or 'moving'; got 'moves'",
        ),
        ("front_share = 0.3\nobjects_width_px = 9", "perhaps `[occlusion] object_width_px`"),
        (
            'front_share = 0.3\n[decoder]\nspeed = "found"',
            "`[decoder] speed` must be 'unknown' or 'known' beside [occlusion]",
        ),
    ],
)
def test_layers_that_cannot_be_are_named(keys, message, tmp_path):
    """Each in one line that begins with the key."""
    path = written(tmp_path, f"{EXAMPLE}\n[occlusion]\n{keys}\n")
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        read_scene(path)
    assert "\n" not in str(caught.value)


def test_a_byte_order_mark_is_no_error(tmp_path):
    """Editors on Windows begin a file with one."""
    path = tmp_path / "scene.toml"
    path.write_bytes(b"\xef\xbb\xbf" + EXAMPLE.encode())
    assert read_scene(path).speeds.size == 9


@pytest.mark.parametrize("slug", LINES)
def test_mistakes_are_named(slug, tmp_path):
    """Each mistake is refused in one line that says what must hold and what came."""
    start, replacement, message = LINES[slug]
    path = written(tmp_path, edited(start, replacement))
    with pytest.raises((ValueError, OSError), match=re.escape(message)) as caught:
        read_scene(path)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_text(tmp_path):
    """Bytes that are no UTF-8 are refused by name."""
    path = tmp_path / "scene.toml"
    path.write_bytes(b"\xff\xd8\xff\xe0")
    with pytest.raises(ValueError, match="must be UTF-8 text; got byte 0"):
        read_scene(path)


def test_a_picture_that_is_missing_is_told_with_the_scene_that_names_it(tmp_path):
    """The kind of error stays what it was."""
    path = tmp_path / "scene.toml"
    path.write_text(edited("path = ", 'path = "no.png"'))
    with pytest.raises(FileNotFoundError, match=r"scene\.toml: .*no\.png', not found"):
        read_scene(path)


@pytest.mark.parametrize(
    ("keys", "device"),
    [
        ("transmission = 0.4", IdealDevice(transmission=0.4)),
        (
            "rise_ms = 2.5\nleakage = 0.1\nlevels = 16",
            FirstOrderDevice(rise_time=2.5e-3, fall_time=2.5e-3, leakage=0.1, levels=16),
        ),
        (
            "rise_ms = 2.0\nfall_ms = 7.0\ndelay_ms = 0.5\nnum_slots = 32",
            FirstOrderDevice(rise_time=2e-3, fall_time=7e-3, delay=5e-4, num_slots=32),
        ),
        ("num_slots = 96", SwitchedDevice(num_slots=96)),
        ("min_open_slots = 3", SwitchedDevice(min_open=3)),
        ("levels = 5\nnum_slots = 96", IdealDevice(levels=5, num_slots=96)),
    ],
)
def test_what_a_shutter_is_made_with(tmp_path, keys, device):
    """Keys tell the kind of device, and milliseconds become seconds."""
    scene = Scene.load(str(written(tmp_path, f"{EXAMPLE}\n[shutter]\n{keys}\n")))
    assert type(scene.device) is type(device)
    assert str(vars(scene.device)) == str(vars(device))


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ("delay_ms = 1.0", r"\[shutter\] delay_ms` must stand beside rise_ms or fall_ms"),
        ("rise_ms = 1.0\nmin_open_slots = 2", r"\[shutter\] min_open_slots` must be left to"),
        (
            "num_slots = 64\nmin_open_slots = 65",
            r"\[shutter\] min_open_slots` must be at most num_slots = 64; got 65\.",
        ),
        (
            "min_closed_slots = 129",
            r"\[shutter\] min_closed_slots` must be at most num_slots = 128; got 129\.",
        ),
        ("rise_ms = -1.0", r"\[shutter\] rise_ms"),
        ("num_slots = 1", r"\[shutter\] num_slots"),
    ],
)
def test_keys_that_no_shutter_has_together(tmp_path, keys, text):
    """Are named in one line."""
    with pytest.raises(ValueError, match=text):
        Scene.load(str(written(tmp_path, f"{EXAMPLE}\n[shutter]\n{keys}\n")))


def test_a_device_that_holds_any_level_is_written_as_one_without_lag(tmp_path):
    """Slots alone are of a shutter that is open or closed, which shows another light."""
    device = IdealDevice(num_slots=12, transmission=0.8, leakage=0.03)
    scene = Scene([30.0], photon_rate=3.1e5, read_noise=4.3, device=device)
    (tmp_path / "scene.toml").write_text(scene_text(scene))
    read = Scene.load(tmp_path / "scene.toml")
    tau = np.linspace(-0.97, 0.95, 53)
    wanted, light = (s.light(HannShutter(), 0.01).transmittance(tau) for s in (scene, read))
    np.testing.assert_allclose(light, wanted, atol=1e-12)


WITHOUT_BURST = example_scene_text().replace("[burst]\nframes_per_s = 15\n", "")


def test_the_built_in_camera_states_the_rate_of_its_data_sheet():
    """Its frames are as many as the window of one exposure holds."""
    burst = example_scene().burst
    assert float(burst.frames_per_s) == 15
    assert burst.max_frames is burst.window is None


@pytest.mark.parametrize(
    ("keys", "burst"),
    [
        ("frames_per_s = 130\nmax_frames = 3", BurstMode(frames_per_s=130.0, max_frames=3)),
        ("frames_per_s = 130", BurstMode(frames_per_s=130.0)),
        (
            "frames_per_s = 130\nmax_frames = 3\nwindow_ms = 17\ndead_time_ms = 0.7",
            BurstMode(frames_per_s=130.0, max_frames=3, window=0.017, dead_time=7e-4),
        ),
    ],
)
def test_frames_have_a_section(keys, burst, tmp_path):
    """Its window and its dead time may be left out."""
    path = tmp_path / "scene.toml"
    path.write_text(WITHOUT_BURST + f"\n[burst]\n{keys}\n")
    assert eqx.tree_equal(Scene.load(path).burst, burst)


@pytest.mark.parametrize("unit", ["px", "mm"])
def test_a_stroke_of_zero_is_a_camera_without_a_stage(unit, tmp_path):
    """It becomes the least stroke that a stage may have; what lies between them is refused."""
    text = example_scene_text().split("[motion]")[0]
    assert "max_stroke_px = 45" in text
    for stroke in (0, 3e-7):
        edited = text.replace("max_stroke_px = 45", f"max_stroke_{unit} = {stroke}")
        path = written(tmp_path, edited)
        if stroke:
            with pytest.raises(ValueError, match=rf"max_stroke_{unit}` must be 0, without a stage"):
                Scene.load(path)
        else:
            assert float(Scene.load(path).limits.max_stroke) == LEAST_STROKE


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("[burst]\nmax_frames = 0\nframes_per_s = 9", r"`\[burst\] max_frames` must be at least 1"),
        ("[burst]\nmax_frames = 3", r"`\[burst\] frames_per_s` must be given; got nothing"),
        (
            "[burst]\nframes_per_s = 125\nmax_frames = 3\ndead_time_ms = 8",
            r"`\[burst\] dead_time_ms` must be shorter than the 8 ms from frame to frame; got 8",
        ),
        (
            "[burst]\nframes_per_s = 130\nmax_frames = 3\nmax_pan_px_per_s = 9",
            r"perhaps `\[limits\] max_pan_px_per_s`",
        ),
    ],
)
def test_a_burst_that_a_file_cannot_have(keys, message, tmp_path):
    """One line names the key, also of one that another section has."""
    path = tmp_path / "scene.toml"
    path.write_text(WITHOUT_BURST + f"\n{keys}\n")
    with pytest.raises(ValueError, match=message):
        Scene.load(path)


@pytest.mark.parametrize(
    ("table", "word", "key"),
    [
        ("limits", "frames", "[burst] max_frames"),
        ("sensor", "window", "[burst] window_ms"),
        ("light", "rolling_shutter", "[sensor] readout_ms"),
        ("burst", "fps", "[burst] frames_per_s"),
        ("limits", "stage", "[limits] max_stroke_px"),
    ],
)
def test_words_for_a_key_are_known_in_every_table(table, word, key, tmp_path):
    """Where a table has no key that is nearly the word."""
    text = WITHOUT_BURST + "\n[burst]\nframes_per_s = 9\n"
    path = written(tmp_path, text.replace(f"\n[{table}]", f"\n[{table}]\n{word} = 4 #"))
    with pytest.raises(ValueError, match=re.escape(f"perhaps `{key}`; got '{word}'")):
        read_scene(path)


ONE_OF_EACH = Scene(
    [0.0, 1700.0, -900.0],
    [0.5, 0.2, 0.3],
    photon_rate=3.1e5,
    read_noise=4.3,
    picture=Texture(mean_level=0.31, deviation=0.17),
    optics=Optics(cutoff_frequency=0.41, lens_blur=0.73),
    sensor=Sensor(full_well=7100.0, axis="columns", width=1930.0),
    limits=Limits(
        max_stroke=37.0,
        max_pan=250.0,
        max_travel=120.0,
        max_jerk=2e10,
        stage=SecondOrderStage(bandwidth=43.0, damping=0.35),
    ),
    burst=BurstMode(frames_per_s=240.0, max_frames=6, window=0.031, dead_time=3e-4),
    tolerances=Tolerances(acceleration=0.02, delay=1.5e-4, transmittance=0.03, drive_step=5e-5),
    occlusion=Occlusion(front_share=0.4, object_width=83.0, level_difference=0.06),
    objects=Objects(width=71.0),
    errors=MeasurementErrors(photon_rate=2.1e3, read_noise=0.3, speed=4.0, front_share=0.05),
    motion=ParabolicMotion(acceleration=2.9e5, half_exposure=0.0105, velocity=-210.0),
)
"""A scene with a part of every kind but a device."""
SAVED = {
    "ideal": replace(
        ONE_OF_EACH, device=IdealDevice(transmission=0.7, leakage=0.02, levels=5, num_slots=33)
    ),
    "gradual": replace(
        ONE_OF_EACH,
        device=FirstOrderDevice(rise_time=1.5e-3, fall_time=0.5e-3, num_slots=48, delay=2.5e-4),
        occlusion=Occlusion(front_share=0.83, background="moving"),
    ),
    "switched": replace(
        ONE_OF_EACH, device=SwitchedDevice(num_slots=96, min_open=3, min_closed=2, leakage=0.01)
    ),
    "photograph": example_scene,
}


@pytest.mark.parametrize("slug", SAVED)
def test_a_saved_scene_is_loaded(slug, tmp_path):
    """Every number of a scene has a key, and comes back, over a file that was there."""
    scene = SAVED[slug] if isinstance(SAVED[slug], Scene) else SAVED[slug]()
    (tmp_path / "scene.toml").write_text("An older file.")
    scene.save(tmp_path / "scene.toml")
    assert eqx.tree_equal(Scene.load(tmp_path / "scene.toml"), scene, rtol=1e-12)


def test_comments_stand_where_they_are_told(tmp_path):
    """At the head and above a section, and change nothing."""
    text = scene_text(ONE_OF_EACH, {"": ["First."], "motion": ['a = "1"']})
    assert text.startswith("# First.\n\n[speeds]\n")
    assert '\n# a = "1"\n[motion]\n' in text
    assert eqx.tree_equal(Scene.load(written(tmp_path, text)), ONE_OF_EACH, rtol=1e-12)


def test_a_photograph_is_found_from_a_saved_scene_in_another_folder(tmp_path, monkeypatch):
    """Its path is taken from where one stands, in Python, and is whole in the file."""
    (tmp_path / "here").mkdir()
    light = np.random.default_rng(3).uniform(0.1, 0.7, (13, 37))
    write_picture(tmp_path / "here" / "photo.png", light)
    monkeypatch.chdir(tmp_path / "here")
    texture = Texture.of_photograph(read_picture("photo.png"), "photo.png")
    Scene([310.0], photon_rate=2e5, read_noise=3.0, picture=texture).save("../scene.toml")
    read = Scene.load(tmp_path / "scene.toml").picture
    assert read.path == str(tmp_path / "here" / "photo.png")
    np.testing.assert_allclose(read.power_spectrum, texture.power_spectrum, rtol=1e-12)


FREE = FreeMotion(accelerations=[3e5, 1e5, 2e5], half_exposure=0.008, velocity=-90.0)
NOT_HELD = {
    "free-motion": ({"motion": FREE}, r"`Scene\(motion=...\)` must be one that .* holds; got Free"),
    "spectrum": (
        {"picture": Texture(power_spectrum=[0.4, 0.0, 1.3])},
        r"`Scene\(picture=...\)` must be one that a scene file holds; got Texture\(",
    ),
    "nodes": (
        {"tolerances": Tolerances(speed=30.0, num_speeds=7)},
        r"`Scene\(tolerances=...\)` must be one that a scene file holds; got Tolerances\(",
    ),
    "dark": ({"photon_rate": 0.0}, "photon_rate_per_s` must be above 0; got 0.0"),
    "fast": ({"speeds": [3e7]}, "must be at most .*; got"),
}


@pytest.mark.parametrize("slug", NOT_HELD)
def test_a_scene_that_a_file_does_not_hold_is_not_saved(slug, tmp_path):
    """The part is named in one line, and nothing is written."""
    parts, message = NOT_HELD[slug]
    scene = Scene(**{"speeds": [310.0, -40.0], "photon_rate": 2e5, "read_noise": 3.0} | parts)
    with pytest.raises(ValueError, match=message) as raised:
        scene.save(tmp_path / "scene.toml")
    assert "\n" not in str(raised.value)
    assert not any(tmp_path.iterdir())


def test_whole_exposures_are_twice_the_half(tmp_path):
    """Halves, of earlier versions, are read in place of whole exposures, not beside them."""
    text = edited("max_exposure_ms", "max_half_exposure_ms = 17")
    text = re.sub(r"^min_exposure_ms.*", "min_half_exposure_ms = 1.5", text, flags=re.MULTILINE)
    text = re.sub(r"^exposure_ms.*", "half_exposure_ms = 9.5", text, flags=re.MULTILINE)
    scene = read_scene(written(tmp_path, text))
    assert float(scene.limits.max_half_exposure) == pytest.approx(0.017, rel=1e-15)
    assert float(scene.limits.min_half_exposure) == pytest.approx(0.0015, rel=1e-15)
    assert float(scene.motion.half_exposure) == pytest.approx(0.0095, rel=1e-15)
    both = edited("max_exposure_ms", "max_half_exposure_ms = 17\nmax_exposure_ms = 34")
    line = r"`\[limits\] max_exposure_ms` must not stand beside max_half_exposure_ms; got 34"
    with pytest.raises(ValueError, match=line):
        read_scene(written(tmp_path, both))


def test_a_key_of_a_photographer_is_answered_with_the_table(tmp_path):
    """`iso` is near to no key, and to `axis` least of all."""
    with pytest.raises(ValueError, match=r"known keys only \(read_noise_e, .*\); got 'iso'"):
        read_scene(written(tmp_path, edited("read_noise_e", "read_noise_e = 3\niso = 400")))


@pytest.mark.parametrize(
    ("key", "line", "doubt"),
    [
        ("read_noise_e", "read_noise_e = 5\nwidth_px = 0.5", "the sensor is 0.5 px wide"),
        (
            "read_noise_e",
            "read_noise_e = 5\nfull_well_e = 3",
            "a pixel is full at 3 e-, below 5 e- of read noise",
        ),
    ],
)
def test_numbers_that_no_camera_has_are_doubted(key, line, doubt, tmp_path):
    """The scene is read with them, and one line says so."""
    others = re.sub(r"^full_well_e.*\n", "", EXAMPLE, flags=re.MULTILINE)
    text = re.sub(rf"^{key}.*", line, others, flags=re.MULTILINE)
    with pytest.warns(SceneWarning, match=doubt):
        read_scene(written(tmp_path, text))


def test_a_kind_of_picture_stands_for_one_that_is_shipped():
    """Print has finer detail than a photograph, and a scene of it is written and read back."""
    photograph = Texture()
    scenes = {}
    for kind in ("photograph", "print", "cells"):
        text = edited("path = ", f'like = "{kind}"')
        scenes[kind] = scene_of_tables(tomllib.loads(text), "a.toml", Path())
    assert eqx.tree_equal(scenes["photograph"].picture, photograph)
    details = {kind: scene.picture.detail for kind, scene in scenes.items()}
    assert details["print"] < 5 < 17 < details["photograph"] < 18 < details["cells"] < 25
    page = scenes["print"]
    assert scene_tables(page)["picture"] == {"like": "print"}
    assert page.picture.photograph().light.shape == (191, 384, 1)


def test_detail_is_the_period_that_leaves_a_tenth_of_the_power():
    """In closed form for the spectrum of photographs, whose integral is an arc tangent."""
    share = 0.9 * math.atan(0.5 / 0.01)
    assert Texture().detail == pytest.approx(1 / (0.01 * math.tan(share)), rel=0.01)
    assert Texture(power_spectrum=[1.0, 1.0]).detail == pytest.approx(1 / 0.45, rel=1e-6)


def test_a_camera_without_a_stage_is_written_as_one():
    """As the 0 that its file had, and not as the stroke that stands for it."""
    scene = Scene.uniform(max_speed=9.0, photon_rate=1e4, read_noise=2, limits=Limits(max_stroke=0))
    assert scene_tables(scene)["limits"]["max_stroke_px"] == 0


def test_a_background_of_things_in_any_direction_stands_still():
    """One that moves is refused with what to leave out, and a still one is written and read."""
    text = "[speeds]\nany_direction = { max_px_per_s = 90 }\n[light]\nphoton_rate_per_s = 1e4\n"
    text += "[sensor]\nread_noise_e = 2\n[occlusion]\nfront_share = 0.4\nobject_width_px = 31\n"
    scene = scene_of_tables(tomllib.loads(text), "a.toml", Path())
    again = scene_of_tables(tomllib.loads(scene_text(scene)), "a.toml", Path())
    assert eqx.tree_equal(again.occlusion, Occlusion(front_share=0.4, object_width=31.0))
    moving = tomllib.loads(text + 'background = "moving"\n')
    with pytest.raises(
        ValueError, match=r"background` must be 'still' .*\(leave \[occlusion\] out"
    ):
        scene_of_tables(moving, "a.toml", Path())
