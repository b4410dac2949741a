"""Scenes in the units that people have, against what a pocket calculator makes of them."""

import numpy as np
import pytest

from mishutter.model.scene import read_scene
from mishutter.model.scene_file import read_speed
from mishutter.model.scene_units import SceneWarning, View, read_noise_from_dynamic_range

WHOLE = """
[speeds]
{speeds}
[light]
{light}
[sensor]
{sensor}
{view}
[limits]
max_half_exposure_ms = 20
{limits}
"""
DEFAULTS = {
    "speeds": "list_px_per_s = [100, 300]",
    "light": "photon_rate_per_s = 1e5",
    "sensor": "read_noise_e = 4\npixel_pitch_um = 5",
    "view": "",
    "limits": "",
}


def scene_of(folder, **parts):
    """The scene of a file with some parts in place of others."""
    path = folder / "scene.toml"
    path.write_text(WHOLE.format(**DEFAULTS | parts))
    return read_scene(path)


@pytest.mark.parametrize(
    ("view", "speed", "expected"),
    [
        # 0.9 mm/s at 20 times are 18 mm/s on the sensor: 3,600 px/s of 5 um.
        ("magnification = 20", "0.9 mm_per_s", 3600.0),
        ("magnification = 20", "300 um_per_s", 1200.0),
        # A belt at 1.2 m/s, 0.8 m from a lens of 16 mm, which shows it 16/784 times as large.
        ("distance_m = 0.8\nfocal_length_mm = 16", "1.2 m_per_s", 1200 * 16 / 784 / 5e-3),
        # A car at 90 km/h, 40 m away, goes 25 m/s.
        ("distance_m = 40\nfocal_length_mm = 16", "90 km_per_h", 25e3 * 16 / 39984 / 5e-3),
        # A ruler in the picture needs no pitch.
        ("px_per_mm = 2.5", "1.2 m_per_s", 3000.0),
        # A camera that turns by 3 degrees a second behind 50 mm.
        ("focal_length_mm = 50", "3 deg_per_s", np.deg2rad(3) * 50 / 5e-3),
        ("", "77 px_per_s", 77.0),
    ],
)
def test_speeds_are_those_of_things(tmp_path, view, speed, expected):
    """As the file's view shows them."""
    number, unit = speed.split()
    pitch = "" if "px" in view else "pixel_pitch_um = 5"
    parts = {"view": f"[view]\n{view}", "sensor": f"read_noise_e = 4\n{pitch}"}
    scene = scene_of(tmp_path, speeds=f"list_{unit} = [0, {number}]", **parts)
    assert float(scene.max_speed) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("speeds", "fastest"),
    [
        ("uniform = { min_mm_per_s = 0, max_mm_per_s = 0.9, count = 3 }", 3600.0),
        # Three equal steps over three deviations to either side are two deviations apart.
        ("normal = { mean_mm_per_s = 0, deviation_mm_per_s = 0.9, count = 3 }", 7200.0),
    ],
)
def test_every_form_of_speeds_has_units(tmp_path, speeds, fastest):
    """As a list has."""
    scene = scene_of(tmp_path, speeds=speeds, view="[view]\nmagnification = 20")
    assert float(scene.max_speed) == pytest.approx(fastest, rel=1e-12)


@pytest.mark.parametrize(
    ("view", "width", "expected"),
    [
        # 40 mm at a hundredth are 0.4 mm on the sensor: 80 px of 5 um.
        ("magnification = 0.01", "object_width_mm = 40", 80.0),
        ("magnification = 20", "object_width_um = 7.3", 29.2),
        ("distance_m = 0.8\nfocal_length_mm = 16", "object_width_m = 0.05", 50 * 16 / 784 / 5e-3),
        ("px_per_mm = 2.5", "object_width_mm = 40", 100.0),
        ("px_per_mm = 2.5", "object_width_px = 40", 40.0),
    ],
)
def test_widths_are_those_of_objects(tmp_path, view, width, expected):
    """As large as the picture shows them."""
    section = f"[view]\n{view}\n[occlusion]\nfront_share = 0.4\n{width}"
    layers = scene_of(tmp_path, view=section).occlusion
    assert float(layers.object_width) == pytest.approx(expected, rel=1e-12)
    own = f"[view]\n{view}\n[objects]\n{width.removeprefix('object_')}"
    assert float(scene_of(tmp_path, view=own).objects.width) == pytest.approx(expected, rel=1e-12)


def test_limits_of_the_stage_are_by_the_pitch(tmp_path):
    """A stroke in mm and a top speed in mm/s of the sensor itself, whatever it looks at."""
    limits = "max_stroke_mm = 0.2\nmax_top_speed_mm_per_s = 30"
    view = "[view]\nmagnification = 20"
    found = scene_of(tmp_path, limits=limits, view=view).limits
    assert float(found.max_stroke) == pytest.approx(40, rel=1e-14)
    assert float(found.max_top_speed) == pytest.approx(6000, rel=1e-14)
    assert float(scene_of(tmp_path).limits.max_stroke) == 200
    limits = 'pans = "camera"\nmax_pan_deg_per_s = 2'
    found = scene_of(tmp_path, limits=limits, view="[view]\nfocal_length_mm = 50").limits
    assert float(found.max_pan) == pytest.approx(np.deg2rad(2) * 50 / 5e-3, rel=1e-14)


def test_a_motion_and_its_tolerances_in_units_of_the_stage(tmp_path):
    """A sag of 0.2 mm and a pan of 3 mm/s on 5 um; errors of the stage and of a belt."""
    sections = """[motion]
half_exposure_ms = 10
sag_mm = 0.2
velocity_mm_per_s = 3
[tolerances]
velocity_mm_per_s = 0.05
object_speed_km_per_h = 0.108
[view]
magnification = 0.02"""
    scene = scene_of(tmp_path, view=sections, limits="max_stroke_px = 80")
    assert float(scene.motion.sag) == pytest.approx(40, rel=1e-12)
    assert float(scene.motion.velocity) == pytest.approx(600, rel=1e-14)
    assert float(scene.tolerances.velocity) == pytest.approx(10, rel=1e-14)
    assert float(scene.tolerances.speed) == pytest.approx(120, rel=1e-14)
    turning = """[motion]
half_exposure_ms = 10
stroke_px = 30
velocity_deg_per_s = 2
[view]
focal_length_mm = 50"""
    scene = scene_of(tmp_path, view=turning, limits='pans = "camera"')
    assert float(scene.motion.velocity) == pytest.approx(np.deg2rad(2) * 50 / 5e-3, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("-77", -77.0),
        ("1.5e2 px/s", 150.0),
        ("0.9mm/s", 3600.0),
        ("-730 um/s", -2920.0),
        ("730 \u00b5m/s", 2920.0),
        ("730\u03bcm/s", 2920.0),
        ("-0.9e-3 m/s", -3600.0),
        ("0.0036 km/h", 4000.0),
    ],
)
def test_a_speed_as_text(tmp_path, text, expected):
    """A number is in px/s, and one with a unit is converted as the scene's own speeds are."""
    scene_of(tmp_path, view="[view]\nmagnification = 20")
    speed = read_speed(text, tmp_path / "scene.toml", "--speed")
    assert speed == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "0.9 furlongs",
            "`--speed` must be a number of px/s, or one with its unit, as 0.9m/s: px/s, um/s, "
            "mm/s, m/s, km/h or deg/s; got '0.9 furlongs'.",
        ),
        (
            "2 m/s",
            "`[view]` must hold magnification, px_per_mm, or distance_m and focal_length_mm, "
            "where --speed in m/s is given; got nothing.",
        ),
        ("2e7", "`--speed` must be at most 1e+07 px/s; got 20000000.0."),
    ],
)
def test_a_speed_without_a_meaning_is_named(text, line):
    """By what it is, what must hold, and what came."""
    with pytest.raises(ValueError, match="must") as caught:
        read_speed(text, None, "--speed")
    assert str(caught.value) == line


def test_light_in_electrons_or_lux(tmp_path):
    """White that fills a pixel in a time; 100 lx of sunlight on white paper behind f/2.8."""
    filled = scene_of(tmp_path, light="white_e = 9000\nwhite_ms = 5")
    assert float(filled.photon_rate) == pytest.approx(1.8e6, rel=1e-14)
    lux = "illuminance_lux = 100\nf_number = 2.8\nquantum_efficiency = 0.6"
    # 1 umol of photons is 6.02e17; a pixel is 25e-12 m^2.
    expected = 100 / (4 * 2.8**2) / 54 * 6.02214076e17 * 25e-12 * 0.6
    assert float(scene_of(tmp_path, light=lux).photon_rate) == pytest.approx(expected, rel=1e-9)
    near = scene_of(
        tmp_path, light=lux + "\nlens_transmission = 0.9", view="[view]\nmagnification = 1"
    )
    assert float(near.photon_rate) == pytest.approx(0.9 * expected / 4, rel=1e-9)
    ruler = scene_of(tmp_path, light=lux, view="[view]\npx_per_mm = 200")
    assert float(ruler.photon_rate) == pytest.approx(expected / 4, rel=1e-9)


def test_read_noise_of_a_dynamic_range(tmp_path):
    """60 dB below a full well of 9,000 e- are 9 e-."""
    scene = scene_of(tmp_path, sensor="dynamic_range_db = 60\nfull_well_e = 9000")
    assert float(scene.read_noise) == pytest.approx(9.0, rel=1e-14)


@pytest.mark.parametrize(
    ("parts", "line"),
    [
        (
            {"speeds": "list_m_per_s = [1]"},
            "[view]` must hold magnification, px_per_mm, or distance_m and focal_length_mm, where "
            "[speeds] in m_per_s is given; got nothing.",
        ),
        (
            {"speeds": "list_m_per_s = [1]", "view": "[view]\ndistance_m = 2"},
            "[view] focal_length_mm` must be given where distance_m is; got nothing.",
        ),
        (
            {"speeds": "list_deg_per_s = [1]"},
            "[view] focal_length_mm` must be given where [speeds] in deg_per_s is; got nothing.",
        ),
        (
            {"speeds": "list_deg_per_s = [1]\nlist_px_per_s = [1]"},
            "[speeds] list_deg_per_s` must not stand beside list_px_per_s; got [1.0].",
        ),
        (
            {"speeds": "uniform = { min_px_per_s = 0, max_m_per_s = 1, count = 3 }"},
            "[speeds] uniform` must be in one unit; got min_px_per_s and max_m_per_s.",
        ),
        (
            {"speeds": "uniform = { max_m_per_s = 1, count = 3 }"},
            "[speeds] uniform.min_m_per_s` must be given; got nothing.",
        ),
        (
            {"speeds": "list_m_per_s = [1e6]", "view": "[view]\npx_per_mm = 4"},
            "[speeds]` must be at most 1e+07 px/s; got 4000000000.0.",
        ),
        (
            {"light": "photon_rate_per_s = 1e5\nwhite_e = 3"},
            "[light]` must hold one of photon_rate_per_s, white_e and illuminance_lux; got "
            "photon_rate_per_s and white_e.",
        ),
        (
            {"light": "white_e = 3"},
            "[light] white_ms` must be given where white_e is; got nothing.",
        ),
        (
            {"light": "photon_rate_per_s = 3\nf_number = 2"},
            "[light] f_number` must stand beside illuminance_lux; got 2.0.",
        ),
        (
            {"light": "white_e = 9000\nwhite_ms = 5\nlens_transmission = 0.8"},
            "[light] lens_transmission` must stand beside illuminance_lux; got 0.8.",
        ),
        (
            {
                "limits": "max_pan_px_per_s = 11\n[motion]\nhalf_exposure_ms = 3\nsag_px = 2\n"
                "velocity_mm_per_s = 3"
            },
            "[motion] velocity_mm_per_s` must keep the pan within max_pan_px_per_s = 11; got 600 "
            "px/s.",
        ),
        (
            {
                "limits": 'pans = "camera"\nmax_pan_px_per_s = 11\n[motion]\n'
                "half_exposure_ms = 3\nsag_px = 2\nvelocity_deg_per_s = 2\n",
                "view": "[view]\nfocal_length_mm = 50",
            },
            "[motion] velocity_deg_per_s` must keep the pan within max_pan_px_per_s = 11; got "
            "349.066 px/s.",
        ),
        (
            {"sensor": "read_noise_e = 4\ndynamic_range_db = 60"},
            "[sensor] dynamic_range_db` must not stand beside read_noise_e; got 60.0.",
        ),
        (
            {"sensor": "dynamic_range_db = 60"},
            "[sensor] full_well_e` must be given where dynamic_range_db is; got nothing.",
        ),
        ({"sensor": "full_well_e = 60"}, "[sensor] read_noise_e` must be given; got nothing."),
        (
            {"limits": "max_stroke_px = 3\nmax_stroke_mm = 3"},
            "[limits] max_stroke_mm` must not stand beside max_stroke_px; got 3.0.",
        ),
        (
            {"limits": "[motion]\nhalf_exposure_ms = 3\nstroke_px = 2\nvelocity_deg_per_s = 1"},
            '[motion] velocity_deg_per_s` must stand beside [limits] pans = "camera": a stage does '
            "not turn; got 1.0.",
        ),
        (
            {"limits": "max_stroke_mm = 900"},
            "[limits] max_stroke_mm` must be 0, without a stage, or lie in 0.001 to 10000 px; "
            "got 180000.0.",
        ),
        (
            {"limits": "max_pan_deg_per_s = 2", "view": "[view]\nfocal_length_mm = 50"},
            '[limits] max_pan_deg_per_s` must stand beside pans = "camera": a stage does not '
            "turn; got 2.0.",
        ),
    ],
)
def test_wrong_combinations_are_named(tmp_path, parts, line):
    """By the key, what must hold, and what came."""
    with pytest.raises(ValueError, match="must") as caught:
        scene_of(tmp_path, **parts)
    assert str(caught.value).partition(": `")[2] == line


@pytest.mark.parametrize(
    ("view", "value", "unit", "expected"),
    [
        # As a file has it, above: 16/784 of 1.2 m/s on pixels of 5 um.
        (
            View(distance=0.8, focal_length=0.016, pixel_pitch=5e-6),
            1.2,
            "m/s",
            1200 * 16 / 784 / 5e-3,
        ),
        (
            View(distance=40, focal_length=0.016, pixel_pitch=5e-6),
            [90.0, -45.0],
            "km/h",
            np.array([1, -0.5]) * 25e3 * 16 / 39984 / 5e-3,
        ),
        (View(magnification=20, pixel_pitch=6.45e-6), 0.9, "mm/s", 0.9 * 20 / 6.45e-3),
        (View(magnification=20, pixel_pitch=6.5e-6), 730, "um/s", 0.73 * 20 / 6.5e-3),
        (View(px_per_mm=2.5), 730, "\u00b5m/s", 1.825),
        (View(px_per_mm=2.5), 1.2, "m/s", 3000.0),
        (View(focal_length=0.05, pixel_pitch=5e-6), 3, "deg/s", np.deg2rad(3) * 50 / 5e-3),
        (View(), 77, "px/s", 77.0),
    ],
)
def test_speeds_in_python(view, value, unit, expected):
    """The figures of a file with the same view, of one speed or several."""
    assert view.speed(value, unit) == pytest.approx(expected, rel=1e-14)


def test_lengths_in_python():
    """An object of 40 mm at a hundredth, and a stage of 250 um at 0.8 g, whatever it looks at."""
    view = View(magnification=0.01, pixel_pitch=5e-6)
    assert view.length(40, "mm") == pytest.approx(80, rel=1e-14)
    assert view.length(730, "um") == pytest.approx(1.46, rel=1e-14)
    assert view.stage(250, "um") == pytest.approx(50, rel=1e-14)
    assert view.stage(0.25, "mm") == pytest.approx(50, rel=1e-14)
    assert view.stage(30, "mm/s") == pytest.approx(6000, rel=1e-14)
    assert view.stage(0.8, "g") == pytest.approx(0.8 * 9.80665 / 5e-6, rel=1e-14)


def test_light_and_noise_in_python():
    """100 lx behind f/2.8 as in a file, nearer by a magnification of 1; 72 dB below 40,000 e-."""
    expected = 100 / (4 * 2.8**2) / 54 * 6.02214076e17 * 25e-12 * 0.6
    light = {"illuminance": 100, "f_number": 2.8, "quantum_efficiency": 0.6}
    far, near = View(pixel_pitch=5e-6), View(magnification=1, pixel_pitch=5e-6)
    assert far.photon_rate(**light) == pytest.approx(expected, rel=1e-9)
    dim = near.photon_rate(**light, lens_transmission=0.9)
    assert dim == pytest.approx(0.9 * expected / 4, rel=1e-9)
    assert read_noise_from_dynamic_range(dynamic_range=72, full_well=4e4) == pytest.approx(
        10.0475, rel=1e-5
    )


@pytest.mark.parametrize(
    ("call", "line"),
    [
        (
            lambda: View(magnification=2, distance=3),
            "`View(...)` must hold one of magnification, px_per_mm and distance; got magnification "
            "and distance.",
        ),
        (
            lambda: View(distance=3),
            "`View(focal_length=...)` must be given where distance is; got nothing.",
        ),
        (
            lambda: View(distance=0.02, focal_length=0.025),
            "`View(distance=...)` must be beyond the focal length, 0.025 m; got 0.02.",
        ),
        (
            lambda: View(pixel_pitch=-5e-6),
            "`View(pixel_pitch=...)` must be a number above 0; got -5e-06.",
        ),
        (
            lambda: View(magnification=20).speed(0.9, "mm/s"),
            "`View(pixel_pitch=...)` must be given where a speed in mm/s is; got nothing.",
        ),
        (
            lambda: View(pixel_pitch=5e-6).length(0.9, "mm"),
            "`View(...)` must hold magnification, px_per_mm, or distance and focal_length, where a "
            "length in mm is given; got nothing.",
        ),
        (
            lambda: View(px_per_mm=3).speed(0.9, "mph"),
            "`View.speed(unit=...)` must be one of px/s, um/s, mm/s, m/s, km/h, deg/s; got 'mph'.",
        ),
        (
            lambda: View(px_per_mm=3).speed(float("nan"), "m/s"),
            "`View.speed(value=...)` must be finite; got nan.",
        ),
        (
            lambda: View(pixel_pitch=5e-6).photon_rate(
                illuminance=300, f_number=2.8, quantum_efficiency=60
            ),
            "`View.photon_rate(quantum_efficiency=...)` must be above 0 and at most 1; got 60.",
        ),
        (
            lambda: View(pixel_pitch=5e-6).photon_rate(
                illuminance=[300.0, -20.0], f_number=2.8, quantum_efficiency=0.6
            ),
            "`View.photon_rate(illuminance=...)` must be above 0; got [300.0, -20.0].",
        ),
        (
            lambda: read_noise_from_dynamic_range(dynamic_range=72, full_well=-4e4),
            "`read_noise_from_dynamic_range(full_well=...)` must be above 0; got -40000.0.",
        ),
        (
            lambda: read_noise_from_dynamic_range(dynamic_range=float("nan"), full_well=4e4),
            "`read_noise_from_dynamic_range(dynamic_range=...)` must be finite; got nan.",
        ),
    ],
)
def test_a_view_without_a_meaning_is_named(call, line):
    """By the argument of Python, what must hold, and what came."""
    with pytest.raises(ValueError, match="must") as caught:
        call()
    assert str(caught.value) == line


def test_a_distance_in_millimetres_is_doubted():
    """Of 800 m a pixel behind a lens of 16 mm covers 275 mm, of 0.8 m a quarter of one."""
    camera = {"focal_length": 16e-3, "pixel_pitch": 5.5e-6}
    with pytest.warns(SceneWarning, match=r"at distance = 800 a pixel covers 275 mm of things"):
        View(distance=800.0, **camera)
    assert View(distance=0.8, **camera).speed(1.0, "mm/s") == pytest.approx(3.71, rel=1e-3)
