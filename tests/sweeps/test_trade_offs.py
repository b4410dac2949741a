"""What a sweep says of its scene: fronts, best points, gains, and the known results."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import xarray
from support.sweeps import LIMITS, SCENE, SHUTTERS, grid

from mishutter import (
    RASKAR_CODE,
    ChippedShutter,
    ExpectedErrorLoss,
    HannShutter,
    Limits,
    LinearMotion,
    ParabolicMotion,
    RectShutter,
    Scene,
    Sensor,
    StillCamera,
    Texture,
    Tolerances,
    TukeyShutter,
    best_points,
    evaluate,
    example_scene,
    gain_over,
    gain_over_snapshot,
    light_map,
    optimise,
    pareto_front,
    sweep,
)
from mishutter.sweeps.trade_offs import best_snapshots

EXPOSURE_FOUND = 1e-3
"""Relative error of the best exposure where the error is flat."""
SNAPSHOT_FOUND = 1e-4
"""Difference of two searches for the best snapshot where the error is flat; dB."""
SNAPSHOT_BOUND = 1.1717
"""Most that any shutter gains over the best snapshot in RMSE: known speed, Poisson noise."""


@pytest.fixture(scope="module")
def swept():
    """The small sweep."""
    return sweep(SCENE, **grid())


@pytest.mark.slow
def test_best_points_are_the_extremes(swept):
    """The best point of a metric is its largest or smallest value of all shutters."""
    best = best_points(swept)
    assert float(best["expected_psnr"].expected_psnr) == float(swept.expected_psnr.max())
    assert float(best["condition_number"].condition_number) == float(swept.condition_number.min())
    point = best["expected_psnr"]
    assert best_points(swept, "expected_psnr")["expected_psnr"].identical(point)
    motion = ParabolicMotion(
        acceleration=float(point.acceleration),
        half_exposure=float(point.half_exposure),
        velocity=float(point.velocity),
    )
    again = evaluate(SCENE, motion, SHUTTERS[str(point.shutter.values)])
    assert float(again.expected_psnr) == pytest.approx(float(point.expected_psnr), rel=1e-9)


def test_a_best_point_at_an_end_of_its_range_says_so():
    """At either end, of each range; not where a point inside is as good, nor of a single value."""
    shape = (2, 3, 4, 2)
    names = ("velocity", "acceleration", "half_exposure", "shutter")
    coordinates = {name: np.arange(size) + 7.0 for name, size in zip(names, shape, strict=True)}
    ends = {
        (1, 1, 2, 1): "velocity",
        (0, 2, 1, 0): "velocity, acceleration",
        (1, 0, 3, 1): "velocity, acceleration, half_exposure",
    }
    for place, text in ends.items():
        for sense, metric in ((1, "expected_psnr"), (-1, "condition_number")):
            values = np.full(shape, 3.0 * sense)
            values[place] = 5.0 * sense
            values[0, 1, 1, 0] = np.nan
            dataset = xarray.Dataset({metric: (names, values)}, coordinates)
            assert best_points(dataset)[metric].at_end_of == text
    coordinates["velocity"] = np.array([9.0])
    values = np.full((1, 3, 4, 2), 3.0)
    values[0, 0, 1, 1] = values[0, 1, 3, 0] = 5.0
    dataset = xarray.Dataset({"efficiency": (names, values)}, coordinates)
    assert best_points(dataset)["efficiency"].at_end_of == ""
    # The ends of two are as good as each other; nothing is beyond an acceleration of 0.
    values = np.full((1, 3, 4, 2), 3.0)
    values[0, 0, [0, 3], 1] = 5.0
    dataset = xarray.Dataset({"efficiency": (names, values)}, coordinates)
    assert best_points(dataset)["efficiency"].at_end_of == "acceleration"
    still = dataset.assign_coords(acceleration=[0.0, 7.0, 8.0])
    assert best_points(still)["efficiency"].at_end_of == ""


@pytest.mark.slow
def test_nothing_betters_a_pareto_front(swept):
    """No point of the sweep is better under both objectives, and every other point is bettered."""
    names = ("expected_psnr", "relative_kernel_difference")
    front = pareto_front(swept, names)
    psnr = swept.expected_psnr.values.ravel()
    difference = swept.relative_kernel_difference.values.ravel()
    kept = np.stack([front[name].values for name in names])
    for p, d in zip(psnr, difference, strict=True):
        if np.isnan(p):
            continue
        better = np.any((kept[0] >= p) & (kept[1] <= d) & ((kept[0] > p) | (kept[1] < d)))
        on_it = np.any((kept[0] == p) & (kept[1] == d))
        assert better != on_it
    assert np.all(np.diff(kept[0]) >= 0)
    assert {"acceleration", "half_exposure", "shutter"} <= set(front.coords)


def test_a_front_of_ones_own_senses(swept):
    """What is usually wanted large may be wanted small; of equals in one the other decides."""
    front = pareto_front(swept, {"expected_psnr": "min", "efficiency": "min"})
    least = swept.expected_psnr.where(swept.efficiency == swept.efficiency.min()).min()
    assert float(front.expected_psnr.min()) == float(swept.expected_psnr.min())
    assert float(front.efficiency.min()) == float(swept.efficiency.min())
    assert float(least) in front.expected_psnr.values
    assert front.sizes["point"] == np.unique(front.efficiency).size
    assert np.all(np.diff(front.expected_psnr) <= 0)


@pytest.mark.slow
def test_the_best_snapshot_of_what_is_known_in_a_trace():
    """A function that JAX compiles may ask for it where the scene is not traced."""
    alone = best_snapshots(SCENE, [3e3, 4e4])
    level = jax.jit(lambda x: x * best_snapshots(SCENE, [3e3, 4e4]).expected_psnr.values)(1.7)
    np.testing.assert_array_equal(level, 1.7 * alone.expected_psnr.values)


MISTAKES = {
    "no-psnr": (lambda d: gain_over(d[["efficiency"]], "Hann"), "must hold expected_psnr among"),
    "no-psnr-here": (lambda d: gain_over_snapshot(d[["efficiency"]], SCENE), "must hold expected_"),
    "no-psnr-lit": (lambda d: light_map(d[["efficiency"]], SCENE), "must hold expected_psnr among"),
    "no-light": (lambda d: light_map(d, SCENE), "must have photon rates and read noises; got"),
    "no-shutter": (lambda d: gain_over(d, "Tukey"), "must be one of rect, Hann; got 'Tukey'"),
    "one-objective": (lambda d: pareto_front(d, ["efficiency"]), "must name at least two metrics"),
    "sense": (
        lambda d: pareto_front(d, {"efficiency": "large", "outside": "min"}),
        "`pareto_front(objectives=...)` must say max or min; got 'large'",
    ),
    "one-name": (lambda d: pareto_front(d, "efficiency"), "must name at least two metrics"),
    "dimensions": (
        lambda d: pareto_front(d, {"efficiency": "max", "outside": "min"}),
        "`pareto_front(objectives=...)` must be over the same dimensions; got",
    ),
    "metric": (
        lambda d: best_points(d, ["beauty"]),
        "must be metrics of the sweep, expected_psnr,",
    ),
    "dark": (lambda d: best_snapshots(SCENE, [-1.0]), "`best_snapshots(photon_rates=...)` must be"),
    "noise": (
        lambda d: best_snapshots(SCENE, None, [np.nan]),
        "must be finite, at least 0 and one",
    ),
}


@pytest.mark.parametrize("slug", MISTAKES)
def test_mistakes(slug, swept):
    """What a sweep does not say is refused by what it lacks."""
    ask, message = MISTAKES[slug]
    with pytest.raises(ValueError, match="must") as caught:
        ask(swept)
    assert message in str(caught.value)


@pytest.mark.slow
def test_nothing_within_limits(swept):
    """There is no best point then, the front is empty, and gains are unknown."""
    none = swept.where(False)
    assert best_points(none) == {}
    assert pareto_front(none, ["efficiency", "expected_psnr"]).sizes["point"] == 0
    assert bool(gain_over(none, "Hann").isnull().all())
    assert bool(gain_over_snapshot(none, SCENE).isnull().all())


def test_gain_over_a_shutter(swept):
    """A shutter gains nothing over itself and the difference over another."""
    gain = gain_over(swept, "Hann")
    assert float(abs(gain.sel(shutter="Hann")).max()) == 0
    difference = swept.expected_psnr.sel(shutter="rect") - swept.expected_psnr.sel(shutter="Hann")
    np.testing.assert_array_equal(gain.sel(shutter="rect"), difference)


def limited(speeds, weights=None, light=(2e5, 4.0), full_well=None, **limits):
    """A scene of some speeds, light and limits."""
    given = {"max_stroke": 45.0, "max_top_speed": 2e4, "min_half_exposure": 2e-4}
    rate, noise = light
    most = Limits(**given | limits, max_half_exposure=0.04)
    light = {"photon_rate": rate, "read_noise": noise, "sensor": Sensor(full_well=full_well)}
    return Scene(speeds, weights, **light, limits=most)


UNLIKE = [-3000.0, -400.0, 0.0, 300.0, 350.0, 2800.0], [0.05, 0.1, 0.1, 0.3, 0.4, 0.05]
SNAPSHOTS = {
    "built-in": None,
    "one-way": limited(np.linspace(500.0, 3000.0, 6)),
    "lopsided": limited(*UNLIKE),
    "slow-pan": limited(np.linspace(500.0, 3000.0, 6), max_pan=700.0),
    "top-speed": limited([-2000.0, -1500.0, 400.0], max_top_speed=900.0),
    "full-well": limited(*UNLIKE, full_well=300.0),
    "no-pan": limited(*UNLIKE, max_pan=0.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("slug", SNAPSHOTS)
def test_the_best_snapshot_is_that_of_optimise(slug):
    """What a search over exposure and velocity finds, and `evaluate` measures."""
    scene = SNAPSHOTS[slug] or example_scene()
    best = best_snapshots(scene)
    half, velocity = best.half_exposure.item(), best.velocity.item()
    most = min(float(scene.limits.max_pan), float(scene.limits.max_top_speed))
    assert abs(velocity) <= most
    exact = evaluate(scene, LinearMotion(half_exposure=half, velocity=velocity), RectShutter())
    assert best.expected_psnr.item() == pytest.approx(float(exact.expected_psnr), abs=1e-9)
    # A search takes a pan of 0 for a camera at rest.
    middle = float(scene.fullest_motion.velocity) or min(most, 30.0)
    start = LinearMotion(half_exposure=2e-3, velocity=middle)
    free = ("half_exposure", "velocity")[: 2 if most else 1]
    found = optimise(scene, start, RectShutter(), loss=ExpectedErrorLoss(), free=free)
    psnr = float(found.metrics.expected_psnr)
    assert best.expected_psnr.item() == pytest.approx(psnr, abs=SNAPSHOT_FOUND)
    assert half == pytest.approx(float(found.motion.half_exposure), rel=EXPOSURE_FOUND)


@pytest.mark.slow
def test_best_snapshots_under_each_light():
    """Are those of a scene of that light, of velocities of their own."""
    rates, noises = [2e3, 6e5], [0.0, 90.0]
    best = best_snapshots(limited(*UNLIKE), rates, noises)
    for rate in rates:
        for noise in noises:
            one = best_snapshots(limited(*UNLIKE, light=(rate, noise)))
            at = best.sel(photon_rate=rate, read_noise=noise)
            psnr = one.expected_psnr.item()
            assert at.expected_psnr.item() == pytest.approx(psnr, abs=SNAPSHOT_FOUND)
    assert np.unique(best.velocity).size > 1


@pytest.mark.slow
def test_a_snapshot_that_pans_at_one_of_two_speeds():
    """Of two speeds without a common path the frequent one is followed, not their middle."""
    scene = limited([-900.0, 2100.0], [0.1, 0.9], light=(1e3, 6.0), pans="camera")
    assert best_snapshots(scene).velocity.item() == pytest.approx(2100.0, rel=0.05)
    at_middle = LinearMotion(half_exposure=1e-3, velocity=600.0)
    held = optimise(scene, at_middle, RectShutter(), free="half_exposure")
    gain = best_snapshots(scene).expected_psnr.item() - float(held.metrics.expected_psnr)
    assert gain > 0.1


@pytest.mark.slow
def test_gain_over_the_best_snapshot(swept):
    """At each point it is the PSNR less one number, named for a picture."""
    gain = gain_over_snapshot(swept, SCENE)
    level = float(best_snapshots(SCENE).expected_psnr[0, 0])
    np.testing.assert_allclose(gain, swept.expected_psnr - level, rtol=1e-12)
    assert gain.attrs == {"long_name": "gain over best snapshot", "units": "dB"}  # read by pictures


@pytest.mark.slow
def test_nothing_is_gained_where_there_is_nothing_to_restore():
    """Of a picture without detail every PSNR is infinite, and every gain within limits 0."""
    plain = Scene(
        [0.0, 310.0], photon_rate=2e5, read_noise=6.0, picture=Texture(deviation=0.0), limits=LIMITS
    )
    found = sweep(plain, **grid(metrics=["expected_psnr"]))
    inside = found.outside.values == 0
    assert np.all(np.isinf(found.expected_psnr.values[inside]))
    for gain in (gain_over(found, "Hann"), gain_over_snapshot(found, plain)):
        assert np.all(gain.values[inside] == 0)
        assert np.all(np.isnan(gain.values[~inside]))


def test_equal_levels_have_no_gain_infinite_too():
    """The difference of two infinities is none, and that of an infinity and a number infinite."""
    levels = [[np.inf, np.inf], [31.5, np.inf], [33.0, 30.25]]
    found = xarray.Dataset(
        {"expected_psnr": (("point", "shutter"), levels)}, {"shutter": ["rect", "Hann"]}
    )
    gain = gain_over(found, "Hann").sel(shutter="rect")
    np.testing.assert_array_equal(gain, [0, -np.inf, 2.75])


LIGHT_SCENE = Scene.uniform(
    max_speed=3000.0,
    num_speeds=5,
    photon_rate=1e6,
    read_noise=3.0,
    limits=Limits(
        max_stroke=45.0, max_top_speed=3e4, min_half_exposure=5e-5, max_half_exposure=0.02
    ),
)


@pytest.fixture(scope="module")
def lit():
    """The gain over the snapshot from dim to bright and from quiet to noisy."""
    windows = {"rect": RectShutter(), "Hann": HannShutter(), "Tukey": TukeyShutter(0.5)}
    found = sweep(
        LIGHT_SCENE,
        accelerations=np.geomspace(5e4, 5e6, 9),
        half_exposures=np.geomspace(1e-3, 2e-2, 7),
        shutters=windows,
        metrics=["expected_psnr"],
        photon_rates=np.geomspace(3e4, 3e9, 6),
        read_noises=[0.0, 3.0, 30.0, 100.0],
    )
    return light_map(found, LIGHT_SCENE)


@pytest.mark.slow
def test_coding_pays_where_read_noise_dominates(lit):
    """The gain over the best snapshot rises with read noise and falls with light, to a loss."""
    gain = lit.gain.transpose("photon_rate", "read_noise").values
    assert np.all(np.isfinite(gain))
    dim_and_noisy, bright_and_quiet = gain[0, -1], gain[-1, 0]
    assert np.max(gain) > 0 > bright_and_quiet
    assert np.unravel_index(np.argmax(gain), gain.shape)[1] > 0
    assert dim_and_noisy > bright_and_quiet
    assert np.all(gain[-1] < 0)


@pytest.mark.slow
def test_the_map_names_its_points(lit):
    """The best point of each cell is one of the sweep's."""
    assert set(np.unique(lit.shutter.values.astype(str))) <= {"rect", "Hann", "Tukey"}
    assert lit.acceleration.dims == lit.gain.dims


ONE_WAY = limited([400.0, 900.0, 1200.0], max_stroke=9.0, max_top_speed=4e3)
PANS = [0.0, 300.0, 800.0, 1100.0]


@pytest.fixture(scope="module")
def panned():
    """A sweep over velocities under several lights."""
    lights = {"photon_rates": [1e4, 1e6], "read_noises": [3.0, 30.0]}
    metrics = ["expected_psnr", "kernel_difference"]
    return sweep(ONE_WAY, **grid(velocities=PANS, metrics=metrics, **lights))


@pytest.mark.slow
def test_points_and_fronts_of_velocities(panned):
    """The best of all velocities, each with its own."""
    part = panned.isel(photon_rate=0, read_noise=0)
    best = best_points(part)["expected_psnr"]
    assert float(best.expected_psnr) == float(part.expected_psnr.max())
    alone = {pan: part.sel(velocity=pan) for pan in PANS}
    levels = {pan: float(alone[pan].expected_psnr.max()) for pan in PANS}
    assert float(best.velocity) == max(levels, key=lambda pan: levels[pan]) == 800.0
    front = pareto_front(part, ("expected_psnr", "kernel_difference"))
    for point in range(front.sizes["point"]):
        at = front.isel(point=point)
        label = {n: at[n].item() for n in ("acceleration", "half_exposure", "shutter")}
        found = alone[at.velocity.item()].sel(label)
        assert found.expected_psnr.item() == at.expected_psnr.item()
    singles = [pareto_front(one, ("expected_psnr", "kernel_difference")) for one in alone.values()]
    values = np.concatenate([[x.expected_psnr, x.kernel_difference] for x in singles], axis=1)
    for psnr, difference in zip(front.expected_psnr, front.kernel_difference, strict=True):
        assert not np.any((values[0] > float(psnr)) & (values[1] < float(difference)))


@pytest.mark.slow
def test_gains_of_velocities(panned):
    """Each is over the one snapshot that may pan too; a map takes the best of them."""
    gain = gain_over_snapshot(panned, ONE_WAY)
    assert gain.dims == panned.expected_psnr.dims
    level = best_snapshots(ONE_WAY, [1e4, 1e6], [3.0, 30.0]).expected_psnr
    np.testing.assert_allclose(gain, panned.expected_psnr - level, rtol=1e-12)
    assert float(abs(gain_over(panned, "Hann").sel(shutter="Hann")).max()) == 0
    worth = light_map(panned, ONE_WAY)
    over = ("velocity", "acceleration", "half_exposure", "shutter")
    np.testing.assert_array_equal(worth.gain, gain.max(over))
    label = {name: worth[name] for name in over}
    assert all(worth[name].dims == worth.gain.dims for name in over)
    np.testing.assert_array_equal(gain.sel(label), worth.gain)


LIT = {"photon_rate": [1.1e4, 3e6], "read_noise": [2.0, 21.0]}


def test_gains_of_a_light_that_was_selected_are_over_the_snapshot_in_that_light():
    """Not over one in the scene's own light, whatever that is."""
    names = ("acceleration", "shutter", *LIT)
    values = np.random.default_rng(3).uniform(10, 30, (3, 2, 2, 2))
    dataset = xarray.Dataset({"expected_psnr": (names, values)}, LIT)
    whole = gain_over_snapshot(dataset, ONE_WAY)
    for selected in ({"photon_rate": 0}, {"photon_rate": 1, "read_noise": 1}):
        part = gain_over_snapshot(dataset.isel(selected), ONE_WAY)
        assert part.dims == dataset.expected_psnr.isel(selected).dims
        np.testing.assert_allclose(part, whole.isel(selected), rtol=1e-12)


@pytest.mark.parametrize("function", [gain_over_snapshot, light_map])
def test_gains_of_several_scenes_are_not_over_a_snapshot_of_one(function):
    """The scenes have snapshots of their own: a scene is selected first."""
    names = ("scene", "acceleration", "shutter", *LIT)
    dataset = xarray.Dataset({"expected_psnr": (names, np.full((2, 3, 2, 2, 2), 17.0))}, LIT)
    with pytest.raises(ValueError, match=r"\(dataset=...\)` must be of one scene; got 2 scenes\."):
        function(dataset, ONE_WAY)


@pytest.mark.slow
def test_a_pan_that_a_snapshot_may_do_is_no_gain():
    """Of a one-way scene at rest the snapshot that pans is ahead of the one that may not."""
    held = limited([400.0, 900.0, 1200.0], max_stroke=9.0, max_top_speed=4e3, max_pan=0.0)
    found = sweep(held, **grid(metrics=["expected_psnr"]))
    assert float(found.velocity) == 0
    over_held, over_panned = (float(gain_over_snapshot(found, x).max()) for x in (held, ONE_WAY))
    assert over_held - over_panned > 1


KNOWN_SPEED = Scene(
    [1500.0],
    photon_rate=1e7,
    read_noise=0.0,
    picture=Texture(deviation=0.01),
    limits=Limits(
        max_stroke=1e3,
        max_top_speed=1e6,
        min_half_exposure=1e-5,
        max_half_exposure=0.05,
        max_pan=0.0,
    ),
)


@pytest.mark.slow
def test_no_flutter_beats_the_best_snapshot_by_more_than_the_bound():
    """A camera at rest, one known speed, shot noise alone: at most 1.1717 in RMSE."""
    random = np.random.default_rng(4)
    shutters = {"flutter": ChippedShutter(RASKAR_CODE), "Hann": HannShutter()}
    shutters |= {
        str(index): ChippedShutter(random.integers(0, 2, 12).astype(float)) for index in range(4)
    }
    found = sweep(
        KNOWN_SPEED,
        accelerations=[0.0],
        half_exposures=np.geomspace(1e-5, 0.05, 60),
        shutters=shutters,
        metrics=["expected_psnr"],
    )
    gain = float(gain_over_snapshot(found, KNOWN_SPEED).max())
    assert gain <= 20 * np.log10(SNAPSHOT_BOUND)


@pytest.mark.slow
def test_the_best_snapshot_of_a_known_speed_is_one_pixel_long():
    """Shot noise alone, bright light: 1.09 px of motion where nothing else blurs.

    That figure is of an ideal sampler. The pixel's own aperture, which the expected error
    includes, asks a little more of the high frequencies: the minimum of
    `mean(1 / (sinc(f L) sinc(f))^2) / L` over f up to 0.5 is taken beside it.
    """
    bright = Scene([1500.0], photon_rate=1e12, read_noise=0.0, limits=KNOWN_SPEED.limits)
    best = best_snapshots(bright)
    found = 1500.0 * 2 * float(best.half_exposure[0, 0])
    f = (np.arange(256) + 0.5) / 512
    length = np.linspace(0.5, 2, 3001)
    cost = np.mean(1 / np.sinc(f * length[:, None]) ** 2, axis=1) / length
    assert length[np.argmin(cost)] == pytest.approx(1.09, abs=0.005)
    cost = np.mean(1 / (np.sinc(f * length[:, None]) * np.sinc(f)) ** 2, axis=1) / length
    assert found == pytest.approx(length[np.argmin(cost)], rel=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["found", "known"])
def test_gains_are_by_the_sweeps_own_decoder(name):
    """The best snapshot is tuned and judged by the decoder that judges the points."""
    limits = Limits(max_stroke=40.0, max_half_exposure=0.025)
    light = {"photon_rate": 2e5, "read_noise": 6.0, "limits": limits, "decoder_speed": name}
    scene = Scene.uniform(max_speed=2100.0, num_speeds=3, **light)
    axes = {"accelerations": [4e4], "half_exposures": [0.0171], "shutters": SHUTTERS}
    found = sweep(scene, **axes)
    level = found.attrs["level"]
    best = best_snapshots(scene)
    motion = StillCamera(half_exposure=float(best.half_exposure.item()))
    again = evaluate(scene, motion, RectShutter())
    assert best[level].item() == pytest.approx(float(getattr(again, level)), abs=1e-6)
    gain = gain_over_snapshot(found, scene).sel(shutter="Hann").item()
    own = found[level].sel(shutter="Hann").item()
    assert gain == pytest.approx(own - best[level].item(), abs=1e-9)
    over = gain_over(found, "rect").sel(shutter="Hann").item()
    assert over == pytest.approx(own - found[level].sel(shutter="rect").item(), abs=1e-9)


@pytest.mark.parametrize(
    ("level", "is_kept"), [("expected_psnr", False), ("toleranced_psnr", True)]
)
def test_snapshots_are_judged_within_tolerances_where_their_level_is(monkeypatch, level, is_kept):
    """By others as a camera without errors."""
    scenes = []

    def searched(search):
        scenes.append(search.scene)
        raise InterruptedError

    monkeypatch.setattr("mishutter.sweeps.trade_offs.snapshots", searched)
    with pytest.raises(InterruptedError):
        best_snapshots(replace(SCENE, tolerances=Tolerances(speed=90.0)), level=level)
    assert [scene.tolerances is not None for scene in scenes] == [is_kept]
