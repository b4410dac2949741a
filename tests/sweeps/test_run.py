"""A sweep's numbers are those of `evaluate`, its limits are masks, its mistakes one line."""

import os
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from support.sweeps import (
    ACCELERATIONS,
    HALF_EXPOSURES,
    LIMITS,
    SCENE,
    SHUTTERS,
    differences,
    grid,
    inside_points,
    motion_at,
)

import mishutter
from mishutter import (
    RASKAR_CODE,
    ChippedShutter,
    ExpectedErrorLoss,
    FirstOrderDevice,
    GaussianShutter,
    HannShutter,
    Limits,
    Occlusion,
    Scene,
    SplineShutter,
    Tolerances,
    TukeyShutter,
    evaluate,
    optimise,
    sweep,
)
from mishutter.evaluation.metrics import METRICS
from mishutter.model.shutters.base import AbstractShutter

# A grid's limits before anything on it is computed.
from mishutter.sweeps.grid import REASONS, Frame, outside_limits


@pytest.fixture(scope="module")
def swept():
    """The small sweep, in memory."""
    return sweep(SCENE, **grid())


@pytest.mark.slow
def test_numbers_are_those_of_evaluate(swept):
    """Every metric at every point within limits, a camera at rest among them."""
    points = inside_points(swept)
    assert len(points) == 13
    assert differences(swept, SCENE, SHUTTERS, points) == []


@pytest.mark.slow
def test_limits_are_masks_with_a_reason(swept):
    """A point is NaN where a limit is broken, and only there; the bits name every limit."""
    a, half = ACCELERATIONS[:, None], HALF_EXPOSURES[None]
    bits = swept.outside.values
    assert list(swept.outside.attrs["flag_masks"]) == [1 << bit for bit in range(9)]
    names = swept.outside.attrs["flag_meanings"].split()
    exposures = ["exposure_too_short", "exposure_too_long"]
    of_stage = ["travel", "acceleration"]
    of_limits = ["stroke", "top_speed", *exposures, "full_well", "pan", *of_stage]
    assert names == [*of_limits, "blur_too_long"]
    broken = {
        "stroke": a * half**2 > float(LIMITS.max_stroke),
        "top_speed": 2 * a * half + 135.0 > float(LIMITS.max_top_speed),
        "exposure_too_short": np.broadcast_to(half < 1e-3, bits.shape),
        "exposure_too_long": np.broadcast_to(half > 0.02, bits.shape),
    }
    for bit, name in enumerate(names[:4]):
        np.testing.assert_array_equal((bits >> bit) & 1, broken[name])
    for name in ("expected_psnr", "condition_number", "efficiency"):
        np.testing.assert_array_equal(
            np.isnan(swept[name].values), np.broadcast_to(bits[..., None] > 0, (5, 6, 2))
        )


AT_A_LIMIT = {
    "stroke": lambda x: (9e4 * x, 1e-2, 0.0),
    "top_speed": lambda x: ((2e6 - 5e5) / 3 * x, 3e-3, -1e3 * x),
    "exposure_too_short": lambda x: (3e4, 1e-3 / x, 0.0),
    "exposure_too_long": lambda x: (1e4, 0.02 * x, 0.0),
    "pan": lambda x: (1e4, 3e-3, -1.5e3 * x),
}


@pytest.mark.parametrize("reason", AT_A_LIMIT)
def test_a_point_at_a_limit_is_within_it(reason):
    """To a rounding of a thousand millionth, and no more."""
    for beyond, bits in ((1e-10, 0), (1e-8, 1 << REASONS.index(reason))):
        a, half, velocity = AT_A_LIMIT[reason](1 + beyond)
        frame = Frame(scene_with([0.0], max_pan=1.5e3, pans="camera"), velocity)
        found = outside_limits(frame, np.array([a]), np.array([half]))
        assert found.item() == bits


def test_labels_and_units(swept):
    """Dimensions are named, coordinates carry units, attributes say how to do it again."""
    assert swept.expected_psnr.dims == ("acceleration", "half_exposure", "shutter")
    assert swept.acceleration.attrs["units"] == "px/s^2"
    assert swept.half_exposure.attrs["units"] == "s"
    assert swept.expected_psnr.attrs["units"] == "dB"
    assert all(name in swept.attrs["versions"] for name in ("jax", "numpy", "equinox"))
    assert all(name in swept.attrs["sweep"] for name in ("photon_rate", "max_stroke", "Hann"))


@pytest.mark.slow
def test_shutters_without_symmetry():
    """A flutter code, a one-sided profile and a narrow window are as exact as the rest."""
    profile = 0.5 + 0.45 * np.sin(1.7 * np.arange(9) + 0.3)
    shutters = {
        "flutter": ChippedShutter(RASKAR_CODE),
        "spline": SplineShutter(profile),
        "narrow": GaussianShutter(0.07),
    }
    found = sweep(SCENE, **grid(shutters=shutters, accelerations=[2.1e4, 9e4]))
    assert differences(found, SCENE, shutters, inside_points(found)[::3]) == []


@pytest.mark.slow
@pytest.mark.parametrize("fall_time", [1.1e-3, 3e-3])
def test_what_lags_is_measured_at_its_own_exposure(fall_time):
    """A device's time is another share of each exposure, and so is the light of one profile."""
    device = FirstOrderDevice(rise_time=1.1e-3, fall_time=fall_time, num_slots=16, leakage=0.02)
    scene = eqx.tree_at(lambda s: s.device, SCENE, device, is_leaf=lambda x: x is None)
    found = sweep(scene, **grid(accelerations=[0.0, 9e4]))
    points = inside_points(found)
    assert len({column for _, column in points}) > 1
    assert differences(found, scene, SHUTTERS, points[1::3]) == []


@pytest.mark.slow
def test_profiles_are_found_through_a_lag():
    """The best profile at a point is of what is sent, and its numbers are of the light."""
    device = FirstOrderDevice(rise_time=1.1e-3, fall_time=1.1e-3, num_slots=16)
    scene = eqx.tree_at(lambda s: s.device, SCENE, device, is_leaf=lambda x: x is None)
    axes = grid(accelerations=[9e4], half_exposures=HALF_EXPOSURES[3:4])
    found = sweep(scene, **axes, optimise=True, num_coefficients=8)
    point = found.isel(acceleration=0, half_exposure=0).sel(shutter="optimised")
    sent = SplineShutter(point.coefficients.values)
    motion = motion_at(found, 0, 0)
    again = evaluate(scene, motion, sent)
    assert float(point.expected_psnr) == pytest.approx(float(again.expected_psnr), abs=1e-6)
    best = optimise(scene, motion, sent, free="shutter")
    assert 0 <= float(best.metrics.expected_psnr) - float(point.expected_psnr) < 0.01


class Ramp(AbstractShutter):
    """A shutter of one's own: only its transmittance is known."""

    def transmittance(self, tau):
        tau = jnp.asarray(tau, jnp.result_type(float))
        return jnp.where(jnp.abs(tau) <= 1, 0.5 + 0.3 * tau**3, 0.0)


@pytest.mark.slow
def test_a_shutter_of_ones_own():
    """It is interpolated as `evaluate` does it."""
    shutters = {"ramp": Ramp()}
    found = sweep(SCENE, **grid(shutters=shutters, accelerations=[9e4]))
    assert differences(found, SCENE, shutters, inside_points(found)[:2]) == []


@pytest.mark.slow
def test_light_and_noise_are_dimensions():
    """Each light and read noise gives what a scene of that light and noise gives."""
    rates, noises = [3e3, 2e5], [0.0, 6.0, 40.0]
    found = sweep(SCENE, **grid(photon_rates=rates, read_noises=noises))
    assert found.expected_psnr.dims[-2:] == ("photon_rate", "read_noise")
    for rate in rates:
        for noise in noises:
            scene = Scene(
                SCENE.speeds, SCENE.weights, photon_rate=rate, read_noise=noise, limits=LIMITS
            )
            part = found.sel(photon_rate=rate, read_noise=noise)
            assert differences(part, scene, SHUTTERS, inside_points(found)[5:7]) == []


@pytest.mark.slow
def test_scenes_of_different_speeds():
    """Scenes are a dimension, and fewer speeds in one of them change nothing."""
    scenes = {"all": SCENE, "slow": Scene([0.0, 90.0], photon_rate=1e4, read_noise=1.0)}
    found = sweep(scenes, **grid())
    for name, scene in scenes.items():
        part = found.sel(scene=name)
        assert differences(part, scene, SHUTTERS, inside_points(part)[::7]) == []


def scene_with(speeds, **limits):
    """A scene of other speeds and limits."""
    given = {"max_stroke": 9.0, "max_top_speed": 4e3, "min_half_exposure": 1e-3}
    most = Limits(**given | limits, max_half_exposure=0.02)
    return Scene(speeds, photon_rate=2e5, read_noise=6.0, limits=most)


MIDDLES = {
    "symmetric": (scene_with([-500.0, 0.0, 500.0]), 0.0),
    "one-way": (scene_with([400.0, 900.0, 1200.0], pans="camera"), 800.0),
    "other-way": (scene_with([-400.0, -900.0], pans="camera"), -650.0),
    "fast": (scene_with([9e3, 1.1e4], pans="camera"), 2e3),
    "slow-pan": (scene_with([400.0, 1200.0], max_pan=300.0, pans="camera"), 300.0),
    "no-pan": (scene_with([400.0, 1200.0], max_pan=0.0), 0.0),
}


@pytest.mark.slow
def test_each_scene_is_measured_from_the_middle_of_its_speeds():
    """As far as its sensor may pan; the velocity is a coordinate of it."""
    scenes = {name: scene for name, (scene, _) in MIDDLES.items()}
    few = grid(accelerations=[9e4], half_exposures=[3.1e-3])
    found = sweep(scenes, **few)
    assert found.velocity.dims == ("scene",)
    assert found.velocity.attrs["units"] == "px/s"
    for name, (scene, velocity) in MIDDLES.items():
        part, alone = found.sel(scene=name), sweep(scene, **few, metrics="efficiency")
        assert float(part.velocity) == velocity == float(alone.velocity)
        assert alone.velocity.dims == ()
        assert differences(part, scene, SHUTTERS, inside_points(part)) == []
        assert len(inside_points(part)) == 1


@pytest.mark.slow
def test_velocities_are_a_dimension():
    """Between scene and acceleration, of numbers that `evaluate` gives of each pan."""
    velocities = [-420.0, 0.0, 260.0, 3300.0]
    scenes = {"all": SCENE, "one-way": scene_with([400.0, 1200.0], max_pan=300.0)}
    found = sweep(scenes, **grid(velocities=velocities))
    assert found.expected_psnr.dims[:3] == ("scene", "velocity", "acceleration")
    assert found.outside.dims[:2] == ("scene", "velocity")
    np.testing.assert_array_equal(found.velocity, velocities)
    for name, scene in scenes.items():
        for velocity in velocities:
            part = found.sel(scene=name, velocity=velocity)
            points = inside_points(part)[::4]
            assert differences(part, scene, SHUTTERS, points) == []
            a, half = ACCELERATIONS[:, None], HALF_EXPOSURES[None]
            fast = 2 * a * half + abs(velocity) > 4e3
            np.testing.assert_array_equal((part.outside & 2) > 0, fast)
            pans = abs(velocity) > float(scene.limits.max_pan)
            np.testing.assert_array_equal((part.outside & 32) > 0, np.full(fast.shape, pans))
            np.testing.assert_array_equal(part.expected_psnr[..., 0].isnull(), part.outside > 0)
    one = sweep(SCENE, **grid(velocities=velocities))
    assert one.expected_psnr.dims == ("velocity", "acceleration", "half_exposure", "shutter")
    for name in one.data_vars:
        np.testing.assert_array_equal(one[name], found[name].sel(scene="all"))


@pytest.mark.slow
def test_a_velocity_in_single_precision():
    """Leaves numbers in the precision of the scene, beside limits of 64 bits."""
    speeds = np.array([400.0, 1200.0], np.float32)
    light = {"photon_rate": np.float32(2e5), "read_noise": np.float32(6.0)}
    narrow = Scene(speeds, **light, limits=LIMITS)
    few = grid(accelerations=[9e4], half_exposures=[3.1e-3], velocities=[700.1])
    found = sweep(narrow, **few)
    assert found.expected_psnr.dtype == np.float32
    wide = sweep(scene_with([400.0, 1200.0]), **few)
    np.testing.assert_allclose(found.expected_psnr, wide.expected_psnr, rtol=1e-5)


def filling(scene, full_well):
    """A scene of pixels that hold no more than some electrons."""
    well = np.asarray(full_well)
    return eqx.tree_at(lambda s: s.sensor.full_well, scene, well, is_leaf=lambda x: x is None)


def test_full_well():
    """A white pixel that overflows leaves the point out, shutter by shutter."""
    found = sweep(filling(SCENE, 2000.0), **grid())
    electrons = 2e5 * 2 * found.half_exposure * found.efficiency
    full = (found.outside & 16) > 0
    brightest = found.efficiency.notnull() & (electrons > 2000.0)
    assert bool(full.any())
    assert not bool(brightest.any())
    open_only = full.sel(shutter="rect") & ~full.sel(shutter="Hann")
    assert bool(open_only.any())


def test_full_well_under_several_lights():
    """What overflows in bright light alone is left out there alone."""
    lit = {"accelerations": [3e4, 9e4], "photon_rates": [3e3, 2e5, 5e7]}
    found = sweep(filling(SCENE, 2000.0), **grid(**lit))
    light = xarray.DataArray([3e3, 2e5, 5e7], dims="photon_rate")
    within = (found.outside & 15) == 0
    full = within & (found.efficiency * 2 * found.half_exposure * light > 2000.0)
    full |= within.all("photon_rate") & found.efficiency.isnull()
    assert found.outside.dims == (*found.efficiency.dims, "photon_rate")
    np.testing.assert_array_equal((found.outside & 16) > 0, full.transpose(*found.outside.dims))
    known = found.expected_psnr.notnull()
    np.testing.assert_array_equal(known, (found.outside == 0).transpose(*known.dims))
    some = (found.outside == 0).any("photon_rate")
    assert bool((some & full.any("photon_rate")).any())
    np.testing.assert_array_equal(found.condition_number.notnull(), some)


def test_one_point_and_no_point():
    """A grid of one point is a sweep, and one with none within limits is all NaN."""
    one = sweep(SCENE, **grid(accelerations=[9e4], half_exposures=[7e-3]))
    assert differences(one, SCENE, SHUTTERS, [(0, 0)]) == []
    none = sweep(SCENE, **grid(accelerations=[9e4], half_exposures=[0.5]))
    assert bool(none.expected_psnr.isnull().all())
    assert int(none.outside[0, 0]) == 1 + 2 + 8


def test_numbers_that_overflow_are_outside():
    """A stroke beyond the largest number is beyond the limits, and says nothing more."""
    points = {"accelerations": [0.0, 9e4, 1.7e308], "half_exposures": [7e-3, 1e300]}
    found = sweep(SCENE, **grid(**points))
    assert differences(found, SCENE, SHUTTERS, inside_points(found)) == []
    assert inside_points(found) == [(0, 0), (1, 0)]


TOO_LONG = {
    "kernels": ([-2e7, 900.0, 2e7], [20.0, 3e4], None, [(0, 1), (1, 1)]),
    "spectra": ([-3e6, 1e5, 3e6], [0.0], ["expected_psnr"], [(0, 1)]),
    "neither": ([-2500.0, 900.0, 2500.0], [20.0], ["efficiency"], []),
}
"""Speeds, accelerations, metrics, and the points whose light falls too far to compute these."""


@pytest.mark.slow
@pytest.mark.parametrize("slug", TOO_LONG)
def test_a_point_that_is_too_long_to_compute_is_left_out(slug):
    """Light of one speed falls over at most 65,536 px, of all over 93,600; others are computed."""
    speeds, accelerations, metrics, too_long = TOO_LONG[slug]
    scene = Scene(speeds, photon_rate=2e5, read_noise=6.0, limits=LIMITS)
    axes = {"accelerations": accelerations, "half_exposures": [1e-3, 0.02 if metrics else 2e-3]}
    found = sweep(scene, **grid(**axes), metrics=metrics)
    bit = found.outside.attrs["flag_meanings"].split().index("blur_too_long")
    marked = [tuple(index) for index in np.argwhere((found.outside.values >> bit) & 1)]
    assert marked == too_long
    if metrics is None:
        assert differences(found, scene, SHUTTERS, inside_points(found)) == []
    for name in found.data_vars:
        if name not in ("outside", "num_taps", "dft_length"):
            nothing = np.all(np.isnan(found[name].values), axis=-1)
            np.testing.assert_array_equal(nothing, found.outside.values > 0)


def test_the_windows_of_a_sweep_that_names_none():
    """The baselines and a Tukey window."""
    few = {"accelerations": [9e4], "half_exposures": [7e-3], "metrics": "efficiency"}
    found = sweep(SCENE, **few).efficiency.sel(acceleration=9e4, half_exposure=7e-3)
    wanted = {"rect": 1.0, "Hann": 0.5, "triangle": 0.5, "Gaussian": 0.495, "Tukey": 0.75}
    assert list(found.shutter.values) == list(wanted)
    np.testing.assert_allclose(found, list(wanted.values()), atol=1e-3)


def test_only_the_metrics_asked_for(swept):
    """Metrics left out change nothing of those kept but how a program rounds."""
    for metrics in (["expected_psnr"], "expected_psnr"):
        some = sweep(SCENE, **grid(metrics=metrics))
        assert set(some.data_vars) == {"expected_psnr", "outside"}
        np.testing.assert_allclose(some.expected_psnr, swept.expected_psnr, rtol=1e-14)


@pytest.mark.slow
def test_single_precision(swept):
    """A scene of 32-bit numbers gives 32-bit results, near those of 64 bits."""
    narrow = Scene(
        np.asarray(SCENE.speeds, np.float32),
        np.asarray(SCENE.weights, np.float32),
        photon_rate=np.float32(2e5),
        read_noise=np.float32(6.0),
        limits=LIMITS,
    )
    found = sweep(narrow, **grid())
    assert found.expected_psnr.dtype == np.float32
    np.testing.assert_allclose(found.expected_psnr, swept.expected_psnr, rtol=1e-5)


MISTAKES = {
    "empty": ({"accelerations": []}, "`sweep(accelerations=...)` must hold at least one value"),
    "reversed": ({"half_exposures": [2e-3, 1e-3]}, "must ascend without repeats; got"),
    "nan": ({"accelerations": [1e4, np.nan]}, "`sweep(accelerations=...)` must be finite; got"),
    "velocity-nan": ({"velocities": [np.inf]}, "`sweep(velocities=...)` must be finite; got"),
    "velocity-text": (
        {"velocities": np.array(["fast"])},
        "`sweep(velocities=...)` must be one row of numbers",
    ),
    "velocity-twice": ({"velocities": [1.0, 1.0]}, "must ascend without repeats; got"),
    "no-velocity": ({"velocities": []}, "`sweep(velocities=...)` must hold at least one value"),
    "negative": ({"accelerations": [-1.0, 1e4]}, "must be at least 0; got"),
    "no-time": ({"half_exposures": [0.0, 1.0]}, "`sweep(half_exposures=...)` must be above 0; got"),
    "text": ({"accelerations": np.array(["fast"])}, "must be one row of numbers; got"),
    "table": ({"accelerations": np.ones((1, 1))}, "must be one row; got shape (1, 1)"),
    "metric": ({"metrics": ["beauty"]}, "`sweep(metrics=...)` must name some of condition_number"),
    "no-metric": ({"metrics": []}, "`sweep(metrics=...)` must name some of"),
    "shutter": ({"shutters": {"x": 3}}, "must hold at least one shutter and nothing else; got"),
    "dark": ({"photon_rates": [-1.0]}, "`sweep(photon_rates=...)` must be at least 0; got"),
    "both": (
        {"optimise": True, "read_noises": [1.0]},
        "must be False where photon_rates or read_noises are given; use scenes for them; got True",
    ),
    "name": (
        {"optimise": True, "shutters": {"optimised": TukeyShutter()}},
        "`sweep(shutters=...)` must have other names; got 'optimised'",
    ),
    "seed": (
        {"optimise": True, "seed": -1},
        "`sweep(seed=...)` must be a whole number of at least 0; got -1",
    ),
    "steps": ({"optimise": True, "max_steps": 0}, "must be a positive integer; got 0"),
    "loss": (
        {"optimise": True, "loss": ExpectedErrorLoss},
        "`sweep(loss=...)` must be a loss or a function of scene, motion and shutter; got",
    ),
}


@pytest.mark.parametrize("slug", MISTAKES)
def test_mistakes(slug):
    """What cannot be swept is refused before anything is computed."""
    arguments, message = MISTAKES[slug]
    with pytest.raises(ValueError, match="must") as caught:
        sweep(SCENE, **grid(**arguments))
    assert message in str(caught.value)


def test_no_scene():
    """An empty list of scenes is refused."""
    line = r"must hold at least one scene, as `Scene.load\(path\)` reads one from a file, and"
    with pytest.raises(ValueError, match=line):
        sweep([], **grid())


def run_python(code, **variables):
    """Standard output of a process of its own."""
    path = os.pathsep.join([str(Path(mishutter.__file__).parent.parent), *sys.path])
    environment = os.environ | {"PYTHONPATH": path} | variables
    command = [sys.executable, "-c", code]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True)


SWEEP_TO_FILE = """
import sys, jax
jax.config.update("jax_enable_x64", True)
sys.path.insert(0, {folder!r})
from support.sweeps import SCENE, grid
from mishutter import sweep
found = sweep(SCENE, **grid(accelerations={accelerations!r}))
import numpy as np
np.savez({path!r}, **{{name: found[name].values for name in found.data_vars}})
print(len(jax.devices()))
"""


@pytest.mark.slow
def test_four_devices_give_the_same(tmp_path):
    """Designs shared out over four devices give the bits that one device gives."""
    asked = {"folder": str(Path(__file__).parents[1]), "path": str(tmp_path / "4.npz")}
    accelerations = [k * 1e4 for k in range(40)]
    code = SWEEP_TO_FILE.format(accelerations=accelerations, **asked)
    done = run_python(code, JAX_NUM_CPU_DEVICES="4")
    assert done.stdout.strip() == "4"
    assert len(jax.devices()) == 1
    one = sweep(SCENE, **grid(accelerations=accelerations))
    for name, values in np.load(asked["path"]).items():
        np.testing.assert_array_equal(one[name].values, values, err_msg=name)


def test_importing_the_package_stays_light():
    """xarray, Zarr, dask and matplotlib are imported where they are used."""
    code = "import mishutter, sys; print(*sys.modules)"
    loaded = set(run_python(code).stdout.split())
    assert not loaded & {"xarray", "zarr", "dask", "distributed", "matplotlib"}


WITHIN = Tolerances(
    acceleration=0.07, velocity=31.0, delay=2e-4, transmittance=0.02, drive_step=4e-4
)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tolerances", "before a background"])
def test_every_metric_can_be_swept(name):
    """The numbers of each are those of `evaluate`, the levels of all decoders among them."""
    if name == "tolerances":
        scene = eqx.tree_at(lambda s: s.tolerances, SCENE, WITHIN, is_leaf=lambda x: x is None)
        metrics = list(METRICS)
    else:
        scene = SCENE.with_occlusion(Occlusion(front_share=0.37))
        metrics = [metric.name for metric in METRICS.values() if not metric.within_tolerances]
    axes = grid(accelerations=[0.0, 9e4], half_exposures=[3.1e-3, 7e-3])
    found = sweep(scene, **axes, metrics=metrics)
    assert set(metrics) <= set(found.data_vars)
    assert differences(found, scene, SHUTTERS, inside_points(found)) == []


def test_a_level_within_tolerances_asks_for_tolerances():
    """Without any the metric is no choice, and the message names those that are."""
    with pytest.raises(ValueError, match=r"must name some of .*bound_share; got 'toler"):
        sweep(SCENE, **grid(), metrics="toleranced_psnr")


def decoded(name):
    """The scene with another decoder."""
    light = {"photon_rate": 2e5, "read_noise": 6.0, "limits": LIMITS}
    return Scene(SCENE.speeds, SCENE.weights, **light, decoder_speed=name)


OF_DECODERS = {
    "unknown": {"expected_psnr", "worst_speed_psnr"},
    "found": {"found_speed_psnr"},
    "known": {"known_speed_psnr", "worst_known_speed_psnr"},
}


@pytest.mark.parametrize("name", OF_DECODERS)
def test_by_default_the_levels_are_those_of_the_scenes_decoder(name):
    """They are its own and no other's, and the data set says which one judges."""
    scene = decoded(name)
    axes = grid(accelerations=[9e4], half_exposures=[3.1e-3], shutters={"Hann": HannShutter()})
    found = sweep(scene, **axes)
    levels = {metric.name for metric in METRICS.values() if metric.unit == "dB"}
    assert levels & set(found.data_vars) == OF_DECODERS[name]
    assert found.attrs["level"] in OF_DECODERS[name]
    assert {"condition_number", "efficiency", "bound_share"} <= set(found.data_vars)


@pytest.mark.slow
def test_the_profiles_and_the_numbers_are_of_one_decoder():
    """What the loss of an optimised point says is the level that the data set has there."""
    scene = decoded("known")
    axes = grid(accelerations=[9e4], half_exposures=[3.1e-3], shutters={"Hann": HannShutter()})
    for loss, name in ((None, "known_speed_psnr"), (ExpectedErrorLoss(), "expected_psnr")):
        found = sweep(scene, **axes, optimise=True, loss=loss, num_coefficients=8)
        assert found.attrs["level"] == name
        own = found.sel(shutter="optimised")
        error = float(own.loss.item() * scene.picture.deviation)
        assert -20 * np.log10(error) == pytest.approx(own[name].item(), abs=1e-3)
        assert own[name].item() >= found.sel(shutter="Hann")[name].item()
