"""A camera that was built with errors is found again from what it records.

Pictures are made without the package's kernel, by a sum over instants. The coverage of the error
bars over many trials is the benchmark's; here one draw lies where the error bars say.
"""

from dataclasses import replace
from functools import cache

import equinox as eqx
import imagecodecs
import jax.numpy as jnp
import numpy as np
import pytest
import tifffile
from support.designs import SCENE
from support.laboratory import (
    BLUR,
    BUILT,
    COMMAND,
    HALF,
    PROFILE,
    SENT,
    SPEEDS,
    centred,
    expected,
    recorded,
    steep_profiles,
)

from mishutter import (
    FirstOrderDevice,
    FittedCamera,
    FreeMotion,
    HannShutter,
    Limits,
    ParabolicMotion,
    Scene,
    SensorLevels,
    SplineShutter,
    StillCamera,
    TargetPicture,
    evaluate,
    fit,
)
from mishutter.design.design import GIVEN

# The starts of a fit, of which it returns the end of the best.
from mishutter.hardware.calibration.estimation import Estimate
from mishutter.hardware.calibration.likelihood import Setting, _strength_and_place
from mishutter.hardware.calibration.measurements import Measurements, read_measurements

# The model of a recording; a fit returns only the numbers that minimise its misfit.
from mishutter.hardware.calibration.response import FINE, MOVED, collected, kernels
from mishutter.hardware.traces import Trace
from mishutter.pictures.images import PictureWarning

ELECTRONS = 1e5
SENSOR = SensorLevels(read_noise=3.0)
COUNT = 9


@cache
def scale():
    """Light that was sent over that of the profile, which a fit gives it."""
    return float(COMMAND.efficiency()) / float(PROFILE.efficiency())


def pictures(seed, speeds=SPEEDS, target="point", told=True, sensor=SENSOR):
    rng = np.random.default_rng(seed)
    found = []
    for k, speed in enumerate(speeds):
        share = expected(speed, target, position=35.2 + 3 * k)
        level = recorded(share, ELECTRONS, rng, per_level=sensor.electrons_per_level)
        found.append(TargetPicture(level, target, speed if told else None, f"picture {k}"))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("target", ["point", "edge"])
@pytest.mark.parametrize("blur", [BLUR, 0.31])
def test_expected_levels_are_those_of_a_sum_over_instants(target, blur):
    """Points and edges of the exact kernel are what 20,000 instants add up to, to 3e-6.

    Behind a lens that blurs by little more than two taps, light that lay evenly in each would be
    off by 7e-5 of all light.
    """
    relative = jnp.asarray(SPEEDS) - BUILT.velocity
    a = float(BUILT.acceleration)
    coefficients = PROFILE.coefficients
    taps = kernels(coefficients, BUILT.acceleration, BUILT.half_exposure, relative, 800)
    begin = 41.3 - relative**2 / (4 * a) - MOVED / FINE
    edge = jnp.full(len(SPEEDS), target == "edge")
    found = np.asarray(collected(taps, begin, jnp.asarray(blur), edge, 112))
    for row, speed in zip(found, SPEEDS, strict=True):
        truth = expected(speed, target, position=41.3, blur=blur)
        np.testing.assert_allclose(row, truth, rtol=0, atol=3e-6)


def scores(camera):
    """Distances from the truth in error bars."""
    truth = {
        "acceleration_px_per_s2": float(BUILT.acceleration),
        "velocity_px_per_s": float(BUILT.velocity),
        "lens_blur_px": BLUR,
        "delay_ms": -float(BUILT.velocity) / (2 * float(BUILT.acceleration)) * 1e3,
    }
    own = [
        (camera.estimates[n].value - value) / camera.estimates[n].error
        for n, value in truth.items()
    ]
    profile = np.asarray(PROFILE.coefficients) * scale()
    return np.array([*own, *((camera.coefficients - profile) / camera.coefficient_errors)])


@pytest.fixture(scope="module")
def camera():
    """The camera of points at known speeds."""
    return fit(pictures(4), SENT, COMMAND, sensor=SENSOR, num_coefficients=COUNT)


@pytest.mark.slow
def test_points_at_known_speeds_show_the_camera(camera):
    """Motion, delay, lens and profile lie within their error bars, and the residuals are noise."""
    assert np.all(np.abs(scores(camera)) < 4)
    assert np.mean(np.abs(scores(camera)) < 2) > 0.75
    assert abs(camera.reduced_chi_squared - 1) < 0.25
    assert camera.doubt is None
    assert 0.003 < camera.chance < 0.997
    assert camera.estimates["acceleration_px_per_s2"].error < 0.01 * float(BUILT.acceleration)
    assert camera.estimates["lens_blur_px"].error < 0.01
    assert len(camera.not_identifiable) == 2
    assert "only v - 2 a d is seen" in camera.not_identifiable[1]
    built = camera.design(SCENE)
    assert built.loss_name == GIVEN
    assert float(built.scene.optics.lens_blur) == camera.lens_blur
    assert np.isfinite(float(built.metrics.expected_psnr))


@pytest.mark.slow
def test_one_speed_at_rest_sees_only_the_sum_of_both_branches():
    """What a single picture of an object that the sensor does not pan with leaves open is named."""
    light = expected(0.0, "point", position=40.0, motion=SENT, shutter=COMMAND)
    level = recorded(light, ELECTRONS, np.random.default_rng(8))
    camera = fit([TargetPicture(level)], SENT, COMMAND, sensor=SENSOR, num_coefficients=COUNT)
    said = " ".join(camera.not_identifiable)
    assert "only w(t) + w(-t) is seen" in said
    assert "velocity: not determined by the measurements" in said
    assert np.all(np.isinf(camera.coefficient_errors[:4]))
    assert np.isinf(camera.estimates["velocity_px_per_s"].error)
    assert np.isfinite(camera.estimates["lens_blur_px"].error)


@pytest.mark.slow
def test_points_of_one_unknown_speed_join_those_of_known_ones():
    """The speed that pictures share is found too, and the camera as if it had been told."""
    told = pictures(4, (-2500.0, 0.0, 2700.0))
    given = told + pictures(5, (1300.0, 1300.0), told=False)
    camera = fit(given, SENT, COMMAND, sensor=SENSOR, num_coefficients=COUNT)
    assert np.all(np.abs(scores(camera)) < 4)
    speed, error = camera.estimates["speed_px_per_s"]
    assert abs(speed - 1300.0) < 4 * error < 60
    assert abs(camera.reduced_chi_squared - 1) < 0.25
    assert len(camera.not_identifiable) == 2


@pytest.mark.slow
def test_one_unknown_speed_shows_a_camera_or_its_mirror():
    """Where no speed is told, the speed over the sensor and the profile are, or both mirrored."""
    given = pictures(5, (1300.0,) * 3, told=False)
    camera = fit(given, SENT, COMMAND, sensor=SENSOR, num_coefficients=COUNT)
    speed, error = camera.estimates["speed_px_per_s"]
    assert abs(abs(speed) - (1300.0 - float(BUILT.velocity))) < 3 * error < 300
    profile = np.asarray(PROFILE.coefficients)[:: int(np.sign(speed))] * scale()
    assert np.all(np.abs(camera.coefficients - profile) < 3 * camera.coefficient_errors)
    assert np.min(camera.coefficients) > -0.02
    assert np.isinf(camera.estimates["velocity_px_per_s"].error)
    assert any(said.startswith("sign of the speed") for said in camera.not_identifiable)


@pytest.mark.slow
def test_edges_show_the_camera():
    """An edge shows what a point shows, less sharply, by the same program."""
    given = pictures(6, target="edge")
    camera = fit(given, SENT, COMMAND, sensor=SENSOR, num_coefficients=COUNT)
    assert np.all(np.abs(scores(camera)) < 4)
    assert abs(camera.reduced_chi_squared - 1) < 0.25
    assert camera.estimates["lens_blur_px"].error < 0.02
    assert camera.estimates["acceleration_px_per_s2"].error < 0.02 * float(BUILT.acceleration)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 19])
def test_error_bars_of_edges_are_those_of_the_likelihood(seed):
    """Noise that hides a jump of the profile tells of too good a view; error bars see through it.

    In these draws the velocity is 3 to 4 of Fisher's error bars off, and the last coefficient 4
    to 6: information grows with the profile's end, which came out too high or too low.
    """
    given = pictures(seed, target="edge")
    camera = fit(given, SENT, COMMAND, sensor=SENSOR, num_coefficients=COUNT)
    assert np.all(np.abs(scores(camera)) < 2.5)
    assert camera.estimates["velocity_px_per_s"].error < 0.05 * float(SENT.top_speed)
    assert np.max(camera.coefficient_errors) < 0.25


@cache
def leaking():
    return SplineShutter(0.05 + 0.9 * SplineShutter.fit(HannShutter(), 12).coefficients)


"""A shutter that never closes, which was sent a Hann profile; all of it is of 12 coefficients."""
ELSEWHERE = {
    "slower-stage": (0.948, 0.114, (-260.0, 40.0, 1710.0, 2700.0), 0.55, 1e5),
    "panning-stage": (0.976, 0.119, (640.0, 2230.0, 830.0, 2700.0), 0.78, 3e5),
    "faster-objects": (0.915, 0.104, (2650.0, 2110.0, -1240.0, 2700.0), 0.83, 3e5),
}


@pytest.mark.slow
@pytest.mark.parametrize("slug", ELSEWHERE)
def test_no_fit_ends_in_a_minimum_beside_the_right_one(slug):
    """A camera is found whose pictures, but for a step in some, are those of other cameras.

    From the camera that was sent, the minimiser ends 13 error bars off in acceleration and 14 in
    velocity, at 1.5 in chi squared for each free level, or at a stage that accelerates backwards.
    """
    acceleration, velocity, speeds, blur, electrons = ELSEWHERE[slug]
    a = acceleration * float(SENT.acceleration)
    v = velocity * float(SENT.top_speed)
    built = ParabolicMotion(acceleration=a, half_exposure=HALF, velocity=v)
    rng, given = np.random.default_rng(4), []
    for speed in speeds:
        where = {"position": centred(speed, motion=built, columns=128) + 0.3, "columns": 128}
        light = expected(speed, "point", blur=blur, motion=built, shutter=leaking(), **where)
        given.append(TargetPicture(recorded(light, electrons, rng), "point", speed))
    camera = fit(given, SENT, HannShutter(), sensor=SENSOR, num_coefficients=12)
    truth = {"acceleration_px_per_s2": a, "velocity_px_per_s": v, "lens_blur_px": blur}
    for name, value in truth.items():
        each = camera.estimates[name]
        assert abs(each.value - value) < 3 * each.error, name
    assert camera.doubt is None
    assert abs(camera.reduced_chi_squared - 1) < 0.2


def shown(built, profile, speeds, target, rng, *, blur=0.7, electrons=1e5, columns=136):
    """Pictures of a camera, each at a place of its own."""
    found = []
    for speed in speeds:
        place = centred(speed, motion=built, columns=columns) + rng.uniform(-0.5, 0.5)
        options = {"position": place, "columns": columns, "blur": blur}
        light = expected(speed, target, motion=built, shutter=profile, **options)
        found.append(TargetPicture(recorded(light, electrons, rng), target, speed))
    return found


def within(camera, built, profile, blur, bars):
    """Whether motion, lens and profile are those of a camera that was sent a Hann profile."""
    truth = {
        "acceleration_px_per_s2": float(built.acceleration),
        "velocity_px_per_s": float(built.velocity),
        "lens_blur_px": blur,
    }
    each = [(camera.estimates[name], value) for name, value in truth.items()]
    sent = float(SplineShutter.fit(HannShutter(), camera.coefficients.size).efficiency())
    light = sent / float(profile.efficiency())
    off = (camera.coefficients - light * profile.coefficients) / camera.coefficient_errors
    return max(np.abs(off).max(), *(abs(e.value - value) / e.error for e, value in each)) < bars


def test_a_fit_begins_with_profiles_of_several_shapes():
    """They open evenly, late and early, or as the trace does, and all let the light sent pass."""
    rng = np.random.default_rng(8)
    time = np.linspace(-1.3, 1.3, 160) * HALF
    trace = Trace(time, 0.4 + 1.7 * np.asarray(PROFILE.transmittance(time / HALF)))
    data = Measurements(tuple(shown(BUILT, PROFILE, SPEEDS[:1], "point", rng)), SENSOR, trace)
    profiles = Setting.of(data, SENT, COMMAND, COUNT).likely_profiles()
    tau = np.linspace(-1, 1, 41)
    light = float(COMMAND.efficiency())
    shapes = np.array([COMMAND.transmittance(tau), *(light * (1 + k * tau) for k in (0, 1, -1))])
    made = light / float(PROFILE.efficiency()) * PROFILE.transmittance(tau)
    for shape, coefficients in zip([*shapes, made], profiles, strict=True):
        profile = 2 * SplineShutter(coefficients / 2).transmittance(tau)  # some are above 1
        np.testing.assert_allclose(profile, shape, rtol=0, atol=1e-6)


STEEP = ["decays", "ramps", "opens half-way", "leaks", "lags", "is held"]


@pytest.mark.slow
@pytest.mark.parametrize("target", ["point", "edge"])
@pytest.mark.parametrize("kind", STEEP)
def test_a_steep_profile_is_found_where_a_symmetric_one_was_sent(kind, target):
    """The stage is off too, and the profile of the light sent explains it with another stage."""
    rng = np.random.default_rng([STEEP.index(kind), target == "edge"])
    profile = steep_profiles(rng)[kind]
    a, v = float(SENT.acceleration) * rng.uniform(0.88, 1.12), rng.uniform(-300, 300)
    built = ParabolicMotion(acceleration=a, half_exposure=HALF, velocity=v)
    given = shown(built, profile, (2700.0, *rng.uniform(-2700, 2700, 3)), target, rng)
    camera = fit(given, SENT, HannShutter(), sensor=SENSOR, num_coefficients=12)
    assert within(camera, built, profile, 0.7, bars=4)
    assert camera.doubt is None


@pytest.mark.slow
def test_a_fit_whose_residuals_are_too_great_is_doubted():
    """A speed that was told wrongly is a doubt that goes wherever the camera goes."""
    given = pictures(4)
    given[1] = replace(given[1], speed=SPEEDS[1] + 160.0)
    with pytest.warns(UserWarning, match=r"^fit: residuals are implausibly large: chi squared"):
        camera = fit(given, SENT, COMMAND, sensor=SENSOR, num_coefficients=COUNT)
    assert "in picture 1. The numbers may be wrong by many error bars. Check" in camera.doubt
    assert camera.chance < 1e-4
    assert camera.reduced_chi_squared > 1.3
    assert camera.to_dict()["doubt"] == camera.doubt
    assert "# Implausible: residuals are implausibly large" in camera.scene_text(SCENE)
    assert "which it does not explain" in camera.design(SCENE).ending


@pytest.mark.slow
def test_a_fit_whose_residuals_are_too_small_is_doubted():
    """Noise below what the sensor's figures say is said: error bars are made of those."""
    sensor = replace(SENSOR, electrons_per_level=0.5)
    with pytest.warns(UserWarning, match=r"^fit: residuals are implausibly small: chi squared"):
        camera = fit(pictures(4), SENT, COMMAND, sensor=sensor, num_coefficients=COUNT)
    assert camera.reduced_chi_squared < 0.7
    assert camera.chance > 0.999


@pytest.mark.slow
def test_a_scene_file_of_what_was_built_is_ready(camera, tmp_path):
    """It loads with the fitted motion, within limits that were too narrow, and is evaluated."""
    limits = Limits(
        max_stroke=30.0,
        max_top_speed=6100.0,
        max_pan=0.0,
        max_travel=70.0,
        max_acceleration=6.1e5,
        max_jerk=1e10,
        max_half_exposure=0.02,
    )
    device = FirstOrderDevice(rise_time=1.3e-3, fall_time=0.4e-3, transmission=0.85, delay=2e-4)
    scene = eqx.tree_at(lambda s: s.limits, SCENE, limits)
    scene = eqx.tree_at(lambda s: s.device, scene, device, is_leaf=lambda leaf: leaf is None)
    text = camera.scene_text(scene)
    place = tmp_path / "built.toml"
    place.write_text(text)
    built = Scene.load(place)
    for name in ("acceleration", "velocity", "half_exposure"):
        value = float(getattr(camera.motion, name))
        assert float(getattr(built.motion, name)) == pytest.approx(value, rel=1e-12)
    assert eqx.tree_equal(built.device, scene.device, rtol=1e-12)
    assert "# lens_blur_px = 0.6" in text
    assert float(built.optics.lens_blur) == pytest.approx(camera.lens_blur, rel=1e-12)
    assert "# Wider than the scene's, as the camera was: max_stroke, max_top_speed, max_pan" in text
    assert "# Not identifiable: gain and transmittance apart" in text
    found = evaluate(built, built.motion, camera.shutter)
    assert np.isfinite(float(found.expected_psnr))


BAD = {
    "saturated": (
        lambda row: TargetPicture(np.minimum(row, 4095), name="x"),
        r"`x` must stay below the full level 4095 in every pixel; got 4095",
    ),
    "no-edge": (
        lambda row: TargetPicture(np.full(112, 100.0), "edge", name="x"),
        r"`x` must hold an edge: levels at its ends that differ by more than the noise; got 100 a",
    ),
    "no-point": (
        lambda row: TargetPicture(np.full(112, 100.0), name="x"),
        r"`x` must hold a point: light above the level of its ends; got 0 above",
    ),
    "edge-as-a-point": (
        lambda row: TargetPicture(np.cumsum(row) / 100, name="x"),
        r"`x` must hold a point: the same level at both ends; got",
    ),
    "cut-off": (
        lambda row: TargetPicture(row[37:], name="x"),
        r"`x` must end in 4 columns that the blur does not reach; got levels that change by",
    ),
}


@pytest.mark.parametrize("slug", BAD)
def test_pictures_of_no_use_are_refused(slug):
    """One line says what must hold."""
    row = recorded(expected(0.0, "point", position=35.0), ELECTRONS, np.random.default_rng(1))
    made, message = BAD[slug]
    sensor = SensorLevels(read_noise=3.0, full_level=4095.0 if slug == "saturated" else np.inf)
    with pytest.raises(ValueError, match=message):
        fit([made(row)], SENT, COMMAND, sensor=sensor)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("share", "is_refused"), [(1.02, True), (0.98, False)])
def test_the_ends_of_a_picture_change_by_six_times_its_noise_at_most(side, share, is_refused):
    """From two columns to the next two, be it at the first or at the last."""
    sensor, row = SensorLevels(read_noise=3.0), np.where(np.arange(40) < 20, 100.3, 400.7)
    row[:2] -= share * 6 * np.sqrt(np.max(sensor.variance(row, False)) / 5)
    picture = TargetPicture(np.tile(row[::side], (5, 1)), "edge", name="x")
    if is_refused:
        with pytest.raises(ValueError, match="columns that the blur does not reach"):
            picture.profile(sensor)
    else:
        np.testing.assert_allclose(picture.profile(sensor), row[::side])


def test_arguments_of_a_fit_are_checked():
    """A camera at rest has no kernel from its vertex, and a profile has four coefficients."""
    picture = pictures(2, SPEEDS[:1])
    with pytest.raises(ValueError, match=r"fit\(motion=...\)` must have a sag of at least 1 px"):
        fit(picture, StillCamera(half_exposure=HALF), COMMAND, sensor=SENSOR)
    path = FreeMotion(accelerations=[3e4, 5e5], half_exposure=HALF)
    with pytest.raises(ValueError, match=r"fit\(motion=...\)` must be a parabola; got Free"):
        fit(picture, path, COMMAND, sensor=SENSOR)
    with pytest.raises(ValueError, match=r"fit\(num_coefficients=...\)` must be at least 4; got 3"):
        fit(picture, SENT, COMMAND, sensor=SENSOR, num_coefficients=3)
    with pytest.raises(ValueError, match=r"must hold at least one `TargetPicture`; got \[\]"):
        fit([], SENT, COMMAND)
    with pytest.raises(ValueError, match=r"TargetPicture\(target=...\)` must be point or edge"):
        TargetPicture(np.zeros(99), "line")


@pytest.mark.parametrize("argument", ["sensor", "trace"])
def test_measurements_have_a_sensor_and_a_trace_of_their_own(argument):
    """One beside them would not count, and is refused."""
    measurements = Measurements(tuple(pictures(2, SPEEDS[:1])), SENSOR)
    beside = {"sensor": SensorLevels(read_noise=7.0), "trace": (np.arange(9.0), np.ones(9))}
    line = rf"fit\({argument}=...\)` must be left out beside `Measurements`, which have their own"
    with pytest.raises(ValueError, match=line):
        fit(measurements, SENT, COMMAND, **{argument: beside[argument]})


@pytest.mark.parametrize(("shortest", "longest"), [(0.3, 0.7), (1.6, 2.9)])
def test_limits_of_a_fitted_scene_hold_its_exposure(shortest, longest, tmp_path):
    """Of a scene whose exposures are all shorter, or all longer, than that of the camera."""
    limits = Limits(
        max_stroke=300.0, min_half_exposure=shortest * HALF, max_half_exposure=longest * HALF
    )
    row = np.full(40, 3.0)
    camera = FittedCamera(
        motion=SENT,
        shutter=PROFILE,
        coefficients=np.full(9, 0.5),
        coefficient_errors=np.full(9, 0.1),
        estimates={"lens_blur_px": Estimate(0.62, 0.03)},
        not_identifiable=(),
        names=("row",),
        levels=(row,),
        expected=(row + 1,),
        noise=(np.ones(40),),
        chi_squared=40.0,
        num_free=9,
    )
    place = tmp_path / "built.toml"
    place.write_text(camera.scene_text(eqx.tree_at(lambda s: s.limits, SCENE, limits)))
    assert float(Scene.load(place).motion.half_exposure) == pytest.approx(HALF, rel=1e-6)
    name = "max_half_exposure" if longest < 1 else "min_half_exposure"
    assert f"# Wider than the scene's, as the camera was: {name}" in place.read_text("utf-8")


@pytest.mark.parametrize("suffix", ["tif", "pgm"])
def test_further_pictures_of_a_file_are_said(tmp_path, suffix):
    """Only the first is a picture of the target: a stack is to be averaged before."""
    levels = np.random.default_rng(8).integers(90, 4000, (3, 7, 33), np.uint16)
    path = tmp_path / f"stack.{suffix}"
    if suffix == "tif":
        tifffile.imwrite(path, levels, photometric="minisblack")
    else:
        maps = [b"P5 33 7 65535\n" + each.astype(">u2").tobytes() for each in levels]
        path.write_bytes(b"".join(maps))
    (tmp_path / "bench.toml").write_text(f'[[picture]]\npath = "{path.name}"\n')
    with pytest.warns(PictureWarning, match="holds several pictures, of which the first is read"):
        (found,) = read_measurements(tmp_path / "bench.toml").pictures
    np.testing.assert_array_equal(found.levels, levels[0])


@pytest.mark.slow
def test_a_trace_and_one_speed_show_what_the_speed_alone_does_not():
    """With a photodiode's trace a single picture at rest leaves nothing of the profile open."""
    light = expected(0.0, "point", position=40.0)
    rng = np.random.default_rng(8)
    time = np.sort(rng.uniform(-1.2, 1.2, 240)) * HALF
    level = 0.3 + 2.1 * np.asarray(PROFILE.transmittance(time / HALF))
    trace = Trace(time, level + 0.02 * rng.standard_normal(time.size))
    picture = TargetPicture(recorded(light, ELECTRONS, rng))
    camera = fit([picture], SENT, COMMAND, sensor=SENSOR, trace=trace, num_coefficients=COUNT)
    assert len(camera.not_identifiable) == 2
    assert np.all(np.abs(scores(camera)) < 4)
    assert np.max(camera.coefficient_errors) < 0.03


@pytest.mark.parametrize("suffix", ["tif", "png", "pgm"])
def test_pictures_are_files_of_a_camera(tmp_path, suffix):
    """Their numbers are the levels: neither a gamma nor the depth of the file counts."""
    levels = np.random.default_rng(8).integers(90, 4000, (7, 33), np.uint16)
    path = tmp_path / f"left.{suffix}"
    {
        "tif": lambda: tifffile.imwrite(path, levels),
        "png": lambda: path.write_bytes(imagecodecs.png_encode(levels)),
        "pgm": lambda: path.write_bytes(b"P5 33 7 65535\n" + levels.astype(">u2").tobytes()),
    }[suffix]()
    bench = tmp_path / "bench.toml"
    bench.write_text(f'[[picture]]\npath = "left.{suffix}"\nspeed_px_per_s = -2400\n')
    (found,) = read_measurements(bench).pictures
    np.testing.assert_array_equal(found.levels, levels)
    assert found.is_rounded


def test_a_picture_in_colour_has_no_levels(tmp_path):
    """It is refused, and not read as a mean of its colours."""
    tifffile.imwrite(tmp_path / "c.tif", np.ones((7, 33, 3), np.uint16), photometric="rgb")
    (tmp_path / "bench.toml").write_text('[[picture]]\npath = "c.tif"\n')
    with pytest.raises(ValueError, match="be a grey picture; got colours in "):
        read_measurements(tmp_path / "bench.toml")


@pytest.mark.parametrize(("rise", "place"), [(0.0, 17.3), (3.0, 20.5), (-3.0, 20.5)])
def test_a_point_is_over_the_background_at_both_its_ends(rise, place):
    """The sum of a point of 600 levels, before a background that rises along the rows."""
    x = np.arange(41) + 0.5
    point = 600 / np.sqrt(8 * np.pi) * np.exp(-((x - place) ** 2) / 8)
    strength, centroid = _strength_and_place(90 + rise * (x - 20.5) + point, False)
    assert strength == pytest.approx(600, abs=0.5)
    assert rise or centroid == pytest.approx(place, abs=0.01)
