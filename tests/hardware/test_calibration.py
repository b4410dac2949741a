"""The steps of a fit of a camera, each against a sum or a formula of its own."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.optimize import least_squares, minimize_scalar
from scipy.special import erf
from scipy.stats import chi2
from support.laboratory import COMMAND, HALF, PROFILE, SENT, centred, expected

from mishutter import Limits, ParabolicMotion, SensorLevels, TargetPicture
from mishutter.hardware.calibration.estimation import (
    _camera,
    _limits_with,
    _measurements,
    _sentences,
)
from mishutter.hardware.calibration.likelihood import (
    Setting,
    Solution,
    Ties,
    _linearised,
    _moments,
    _residuals,
    _spline_means,
    _strength_and_place,
    _trace_samples,
)
from mishutter.hardware.calibration.measurements import Measurements, read_measurements
from mishutter.hardware.calibration.response import FINE, MOVED, collected, kernels
from mishutter.hardware.calibration.uncertainty import error_bars
from mishutter.hardware.traces import Trace
from mishutter.model.shutters.spline import spline_knots

COUNT = 9
PANNED = ParabolicMotion(acceleration=SENT.acceleration, half_exposure=HALF, velocity=-350.0)
SENSOR = SensorLevels(read_noise=3.0)


def spline(coefficients, tau):
    """A profile of any coefficients, without bounds."""
    return BSpline(spline_knots(len(coefficients)), coefficients, 3)(tau)


@pytest.mark.parametrize("blur", [0.0, 0.7])
def test_pixels_collect_what_each_tap_lights(blur):
    """Of a point and of an edge, whose kernels begin between pixels, by a sum over each tap."""
    taps = np.random.default_rng(3).uniform(-0.1, 1, (2, 21))
    begin, width = np.array([2.37, 3.81]), np.hypot(blur, 1e-3)
    is_edge = np.array([False, True])
    found = collected(*map(jnp.asarray, (taps, begin, blur)), is_edge, 9)
    edges = np.arange(10.0)
    for row, own, first, edge in zip(found, taps, begin, is_edge, strict=True):
        places = first + (np.arange(21 * 400) + 0.5) / (400 * FINE)
        x = edges[:, None] - places
        z = x / width
        share = (1 + erf(z / np.sqrt(2))) / 2
        if edge:
            share = x * share + width * np.exp(-z * z / 2) / np.sqrt(2 * np.pi)
        wanted = np.diff(share, axis=0) @ np.repeat(own, 400) / 400
        np.testing.assert_allclose(row, wanted, atol=2e-5 if blur else 3e-3)


def test_kernels_have_the_moments_of_the_path():
    """Of profiles out of [0, 1] too, by a mean over instants of the way from the vertex."""
    coefficients = np.array([-0.4, 0.3, 1.6, 0.8, 0.5, 1.2, -0.2, 0.6, 0.9])
    relative = np.array([-1700.0, 0.0, 2900.0])
    a = float(SENT.acceleration)
    taps = kernels(*map(jnp.asarray, (coefficients, a, HALF, relative)), 900)
    tau = (np.arange(400_000) + 0.5) / 200_000 - 1
    weight = spline(coefficients, tau)
    edges = (np.arange(taps.shape[1] + 1) - MOVED) / FINE
    for row, speed in zip(np.asarray(taps), relative, strict=True):
        way = a * (tau * HALF - speed / (2 * a)) ** 2
        for power in range(3):
            within = np.diff(edges ** (power + 1)) / (power + 1) * FINE
            assert row @ within == pytest.approx(np.mean(weight * way**power), rel=1e-4)


def test_means_over_a_profile_are_integrals():
    """Of each B-spline, and of the time and its square under a profile that is not even."""
    tau = (np.arange(20_000) + 0.5) / 10_000 - 1
    each = np.array([np.mean(spline(row, tau)) for row in np.eye(COUNT)])
    np.testing.assert_allclose(_spline_means(COUNT), each, atol=1e-8)
    weight = spline(np.linspace(0.2, 0.9, COUNT) ** 2, tau)
    means = [np.sum(weight * tau**power) / np.sum(weight) for power in (1, 2)]
    np.testing.assert_allclose(_moments(np.linspace(0.2, 0.9, COUNT) ** 2), means, rtol=1e-5)


@pytest.mark.parametrize("step", [70.0, -40.0])
def test_the_step_of_an_edge_and_its_place(step):
    """Of levels that rise, or fall, between two pixels."""
    share = np.clip(np.arange(41) + 1 - 17.3, 0, 1)
    strength, place = _strength_and_place(90 + step * share, True)
    assert (strength, place) == pytest.approx((step, 17.3))


@cache
def pictures():
    """Places of a point and an edge, and pictures of them without noise."""
    found = []
    for k, (speed, target) in enumerate(((-1900.0, "point"), (2300.0, "edge"))):
        place = centred(speed, motion=PANNED) + 2.3 * k
        where = {"position": place, "motion": PANNED, "shutter": COMMAND, "blur": 0.5}
        level = 60 + 1e5 * expected(speed, target, **where)
        name = ("first picture", "second picture")[k]
        found.append((place, TargetPicture(level, target, speed, name)))
    return found


@pytest.fixture(scope="module")
def setting():
    """The problem of a camera whose pictures are those of what was sent, with a trace."""
    time = np.linspace(-1.3, 1.3, 160) * HALF
    trace = Trace(time, 0.4 + 1.7 * np.asarray(COMMAND.transmittance(time / HALF)))
    given = tuple(picture for _, picture in pictures())
    return Setting.of(Measurements(given, SENSOR, trace), PANNED, COMMAND, COUNT)


def test_a_fit_begins_where_the_targets_are(setting):
    """Pictures of the camera that was sent have its places, gains and backgrounds at the start."""
    scales = setting.arrays.scales
    start = setting.start(setting.coefficients, 0.0) * scales
    found = start[4 + COUNT : -2].reshape(2, 3)
    np.testing.assert_allclose(found[:, 0], [place for place, _ in pictures()], atol=0.05)
    np.testing.assert_allclose(found[:, 1], 1e5, rtol=1e-3)
    np.testing.assert_allclose(found[:, 2], 60, atol=0.5)
    assert start[:4] == pytest.approx([float(SENT.acceleration), -350.0, 0, 0.5])
    assert start[-2:] == pytest.approx([1.7, 0.4], rel=0.25)  # it is never fully open
    start[-2:] = 1.7, 0.4
    residuals = setting.residuals(start / scales, np.full((2, 112), 1e3))
    assert np.max(np.abs(residuals[:224])) < 0.5  # of levels of up to 60,000
    assert np.max(np.abs(residuals[224:384] * setting.arrays.trace_deviation)) < 1e-3
    np.testing.assert_allclose(residuals[384:], 0, atol=1e-6)


def test_a_trace_is_seen_within_the_exposure_and_outside_it():
    """By its own B-splines there, and by its dark; the error of a level is the trace's."""
    rng = np.random.default_rng(8)
    time = np.linspace(-1.3, 1.4, 1500) * HALF
    light = np.asarray(PROFILE.transmittance(time / HALF))
    level = 0.4 + 1.7 * light + 0.03 * rng.standard_normal(time.size)
    levels, rows, noise = _trace_samples(Trace(time, level), HALF, COUNT)
    inside = np.abs(time) <= HALF
    np.testing.assert_array_equal(levels, np.r_[level[inside], level[~inside]])
    np.testing.assert_allclose(rows[: inside.sum()] @ PROFILE.coefficients, light[inside])
    assert not rows[inside.sum() :].any()
    assert noise == pytest.approx(0.03, rel=0.1)


def test_the_jacobian_is_that_of_differences(setting):
    """Of a point of a known speed and an edge of an unknown one, and of a trace."""
    rows, aims = setting.pins
    arrays = setting.arrays._replace(
        deviation=setting.noise(np.asarray(setting.arrays.levels)),
        is_unknown=np.array([False, True]),
        ties=rows,
        aims=aims,
    )
    values = setting.start(setting.coefficients, 0.0)
    values[2] = 0.4
    values = values * (1 + 0.01 * np.random.default_rng(3).standard_normal(values.size))
    residual, matrix = map(np.asarray, _linearised(jnp.asarray(values), arrays, setting.num_taps))

    def at(values):
        return np.asarray(_residuals(arrays, jnp.asarray(values), setting.num_taps))

    np.testing.assert_allclose(residual, at(values), atol=1e-9)
    for k in range(values.size):
        step = np.eye(values.size)[k] * 1e-5
        slope = (at(values + step) - at(values - step)) / 2e-5
        np.testing.assert_allclose(matrix[:, k], slope, atol=1e-4 * np.abs(slope).max() + 1e-9)


def test_the_delay_has_its_slopes(setting):
    """That of a stage whose velocity is as sent: v less 2 a d is seen."""
    values = setting.start(setting.coefficients, 0.0)
    values[:2] = 1.1, -0.2
    delay, slopes = setting.delay(values)
    a, v = 1.1 * float(SENT.acceleration), -0.2 * float(SENT.top_speed)
    assert v == pytest.approx(-350.0 - 2 * a * delay)
    for k in range(3):
        step = np.eye(values.size)[k] * 1e-6
        apart = setting.delay(values + step)[0] - setting.delay(values - step)[0]
        assert slopes[k] == pytest.approx(apart / 2e-6, rel=1e-6, abs=1e-12)


def test_a_camera_has_its_numbers_in_their_units(setting):
    """Values and errors by the scale of each, the delay in ms, and what is not determined."""
    scales, count = setting.arrays.scales, setting.arrays.scales.size
    values = setting.start(setting.coefficients, 0.0)
    values[3] = -0.62
    noise = np.full((2, 112), 3.0)
    expected = np.array(setting.profiles) + 3 * np.array([[0.5], [-1.5]])
    solution = Solution(0.0, values, np.zeros(0), np.zeros((0, count)), expected, noise)
    errors = np.linspace(0.01, 0.02, count)
    errors[4 + COUNT + 3] = 0.4  # the place of the second picture
    camera = _camera(setting, solution, errors, 2e-5, np.zeros((0, count)))
    names = ["acceleration_px_per_s2", "velocity_px_per_s", None, "lens_blur_px"]
    names += [None] * COUNT + [
        f"{name}_{k}" for k in (0, 1) for name in ("position_px", "gain", "background")
    ]
    for k, name in enumerate(names):
        if name is not None:
            error = np.inf if k == 4 + COUNT + 3 else errors[k] * scales[k]
            value = abs(values[k] * scales[k])
            found = camera.estimates[name]
            assert (abs(found.value), found.error) == pytest.approx((value, error))
    np.testing.assert_allclose(camera.coefficient_errors, errors[4 : 4 + COUNT])
    delay = camera.estimates["delay_ms"]
    assert delay == pytest.approx((1e3 * setting.delay(values)[0], 0.02), abs=1e-9)
    assert camera.not_identifiable[-1] == "position 1: not determined by the measurements"
    assert camera.chi_squared == pytest.approx(112 * (0.5**2 + 1.5**2))
    # The speed, of which none is unknown, and the light that was sent are pinned.
    degrees = 224 - (count - 2)
    assert camera.reduced_chi_squared == pytest.approx(camera.chi_squared / degrees)
    assert camera.chance == pytest.approx(chi2.sf(camera.chi_squared, degrees))
    squares = camera.doubt.partition(" of fits, and ")[2]
    assert squares.startswith("2.25 in second picture")
    tau = np.linspace(-1, 1, 5)
    low, high = camera.band(tau)
    np.testing.assert_allclose((low + high) / 2, spline(camera.coefficients, tau))
    np.testing.assert_allclose((high - low) / 4, spline(camera.coefficient_errors, tau))


class Problem(Setting):
    """A camera of one number and others, whose residuals are simple functions of them."""

    coefficients = np.zeros(1)
    is_pinned = np.array([False, False, True, False, False])
    rows = np.random.default_rng(4).normal(size=(40, 5)) * [1.0, 3.0, 0.0, 2.0, 0.5]

    def __init__(self, bend):
        object.__setattr__(self, "bend", bend)

    def function(self, values):
        bent = np.array(values, float)
        if self.bend:
            bent[0] = self.bend * (1 - np.exp(-values[0] / self.bend))
        return self.rows @ bent

    def matrix(self, values):
        slopes = np.ones(5)
        slopes[0] = np.exp(-values[0] / self.bend) if self.bend else 1.0
        return self.rows * slopes

    def noise(self, expected):
        return expected

    def residuals(self, values, noise):
        return self.function(values)

    def delay(self, values):
        return float(0.3 * values[0] - 0.2 * values[1]), np.array([0.3, -0.2, 0, 0, 0])

    def solved(self, values, noise, ties, pull=None):
        pulls = [] if pull is None else [(pull[0][None], np.array([pull[1]]))]

        def all_rows(values):
            parts = [ties.rows @ values - ties.aims, *(row @ values - at for row, at in pulls)]
            return np.concatenate([self.function(values), *parts])

        end = least_squares(all_rows, values, xtol=1e-14, ftol=1e-14, gtol=1e-14)
        rest = all_rows(end.x)[: 40 + len(ties.rows)]
        return Solution(float(np.sum(rest**2)), end.x, rest[:40], self.matrix(end.x), noise, noise)


def test_error_bars_of_linear_residuals_are_fishers():
    """And that of the delay goes by both its numbers; a number that nothing shows has none."""
    problem = Problem(0.0)
    first = problem.solved(np.full(5, 0.01), np.ones(1), Ties(np.zeros((0, 5)), np.zeros(0)))
    _, errors, of_delay, blind = error_bars(problem, first)
    seen = [0, 1, 3, 4]
    covariance = np.linalg.inv(problem.rows[:, seen].T @ problem.rows[:, seen])
    np.testing.assert_allclose(errors[seen], np.sqrt(np.diag(covariance)), rtol=1e-6)
    assert errors[2] == pytest.approx(3)
    np.testing.assert_allclose(np.abs(blind), [[0, 0, 1, 0, 0]], atol=1e-9)
    slopes = np.array([0.3, -0.2, 0, 0])
    assert of_delay == pytest.approx(np.sqrt(slopes @ covariance @ slopes), rel=1e-6)


def test_error_bars_of_other_residuals_are_those_of_the_likelihood():
    """Of a number whose residuals grow ever less one way: of its end there, where it is farther."""
    problem = Problem(0.45)
    first = problem.solved(np.zeros(5), np.ones(1), Ties(np.zeros((0, 5)), np.zeros(0)))
    best, errors, _, _ = error_bars(problem, first)
    seen = [0, 1, 3, 4]
    fisher = np.sqrt(np.linalg.inv(problem.rows[:, seen].T @ problem.rows[:, seen])[0, 0])

    def rise(value):
        """Least rise of chi squared at a value of the first number."""
        fixed = problem.bend * (1 - np.exp(-value / problem.bend)) / fisher
        return fixed**2

    def pulled(value):
        return rise(value) + (value / fisher - 4) ** 2

    end = minimize_scalar(pulled, bounds=(0, 4 * fisher), method="bounded").x
    assert best.values[0] == pytest.approx(0, abs=1e-6)
    assert errors[0] == pytest.approx(end / np.sqrt(rise(end)), rel=1e-3)
    assert errors[0] > 1.2 * fisher


def test_what_a_picture_says_of_the_noise_of_its_rows(setting):
    """Shot noise above black, read noise and rounding, over the number of its rows."""
    sensor = SensorLevels(electrons_per_level=2.5, read_noise=4.0, black_level=30.0)
    level = np.array([10.0, 30.0, 430.0])
    for is_rounded in (False, True):
        wanted = np.array([0, 0, 400]) / 2.5 + (4 / 2.5) ** 2 + is_rounded / 12
        np.testing.assert_allclose(sensor.variance(level, is_rounded), wanted)
    profiles, one = np.array(setting.profiles), setting.measurements.pictures
    four = tuple(replace(each, levels=np.tile(each.levels, (4, 1))) for each in one)
    often = replace(setting, measurements=setting.measurements._replace(pictures=four))
    variance = np.array([SENSOR.variance(row, False) for row in profiles])
    np.testing.assert_allclose(setting.noise(profiles), np.sqrt(variance))
    np.testing.assert_allclose(often.noise(profiles), np.sqrt(variance / 4))


def test_a_speed_that_no_picture_is_told_is_found_beside_the_velocity():
    """One is as sent, the sign of the other is open without a trace, and neither has an error."""
    given = tuple(replace(picture, speed=None) for _, picture in pictures())
    setting = Setting.of(Measurements(given, SENSOR), PANNED, COMMAND, COUNT)
    names, (rows, aims) = setting.names, setting.pins
    pinned = [names[int(np.argmax(np.abs(row)))] for row in rows[np.sum(rows != 0, axis=1) == 1]]
    assert pinned == ["velocity", "swing of the trace", "dark of the trace"]
    top = float(SENT.top_speed)
    assert aims[0] / rows[0, 1] * setting.arrays.scales[1] == pytest.approx(-350.0)
    assert setting.arrays.scales[1] == setting.arrays.scales[2] == pytest.approx(top)
    said = [note.partition(":")[0] for note in setting.notes]
    assert said[:2] == ["velocity and speed apart", "sign of the speed"]
    values = setting.start(setting.coefficients, 0.3)
    assert values[2] == 0.3
    count = values.size
    expected = np.array(setting.profiles)
    solution = Solution(0.0, values, np.zeros(0), np.zeros((0, count)), expected, expected)
    errors = np.linspace(0.01, 0.02, count)
    camera = _camera(setting, solution, errors, 2e-5, np.zeros((0, count)))
    assert camera.estimates["velocity_px_per_s"].error == np.inf
    assert camera.estimates["delay_ms"].error == np.inf
    assert camera.estimates["speed_px_per_s"] == pytest.approx((0.3 * top, errors[2] * top))


def test_what_is_seen_of_a_profile_is_said():
    """Combinations of its coefficients alone are counted; odd ones leave the even part seen."""
    names = ("a", "b", *(f"transmittance {k}" for k in range(4)), *(f"x{k}" for k in range(3)))
    names = ("acceleration", "velocity", "speed", "lens blur", *names[2:])
    is_blind = np.zeros(len(names), bool)
    is_blind[[1, 4, 7, 9]] = True
    odd = np.zeros((2, len(names)))
    odd[0, 4:8] = np.array([1, 0, 0, -1]) / np.sqrt(2)
    odd[1, 4:8] = np.array([0, 1, -1, 0]) / np.sqrt(2)
    found = _sentences(is_blind, odd, names, 4)
    assert found[:2] == [
        "velocity: not determined by the measurements",
        "x1: not determined by the measurements",
    ]
    (said,) = found[2:]
    assert said.startswith("transmittance: 2 combinations of the coefficients 0, 3")
    assert said.endswith(", only w(t) + w(-t) is seen")
    mixed = odd.copy()
    mixed[0, 4:8] = [0.5, 0.5, 0.5, 0.5]
    mixed[1] = 0
    mixed[1, [0, 5]] = 0.8, 0.6  # beside the stage, which is no combination of the profile alone
    (said,) = _sentences(is_blind, mixed, names, 4)[2:]
    assert said == "transmittance: 1 combinations of the coefficients 0, 3"
    is_blind[4:8] = False
    assert len(_sentences(is_blind, odd, names, 4)) == 2


def test_limits_hold_a_camera_as_it_was_built():
    """Those below what it does are widened to it, by name, and no others."""
    motion = ParabolicMotion(acceleration=3e5, half_exposure=HALF, velocity=-240.0)
    tight = Limits(
        max_stroke=20.0,
        max_top_speed=5e3,
        max_pan=100.0,
        max_travel=30.0,
        max_acceleration=5e5,
        max_jerk=1e9,
        max_half_exposure=0.5 * HALF,
    )
    wide, names = _limits_with(tight, motion)
    assert set(names) == {
        *("max_stroke", "max_top_speed", "max_pan", "max_travel"),
        *("max_acceleration", "max_half_exposure"),
    }
    assert float(wide.max_jerk) == 1e9
    uses = wide.demands(motion)
    assert all(use.is_met(1e-9) for use in uses.values())
    assert float(wide.max_acceleration) == pytest.approx(6e5)
    assert float(wide.max_pan) == pytest.approx(240)
    assert float(wide.max_stroke) == pytest.approx(float(uses["stroke"].taken))
    wider, names = _limits_with(wide, motion)
    assert names == []
    for name in ("max_stroke", "max_top_speed", "max_travel"):
        assert float(getattr(wider, name)) == float(getattr(wide, name))


def test_targets_along_columns_are_those_along_rows_exchanged():
    """With as many rows that show the same; a point may not go beyond its ends."""
    levels = np.random.default_rng(3).integers(0, 9, (3, 20)) + 60.0
    levels[:, 8:12] += 4000
    along = TargetPicture(levels, "point", 0.0)
    turned = TargetPicture(levels.T, "point", 0.0, axis="columns")
    np.testing.assert_array_equal(turned.levels, along.levels)
    np.testing.assert_allclose(along.profile(SENSOR), levels.mean(axis=0))
    assert along.is_rounded
    assert not replace(along, levels=levels + 0.25).is_rounded
    with pytest.raises(ValueError, match="have at least 16 rows"):
        TargetPicture(levels[:, :15].T, "point", 0.0, axis="columns")


def test_a_trace_beside_pictures_is_the_fits_own():
    """A pair of rows, and a sensor without a number where none is told."""
    given = [picture for _, picture in pictures()]
    found = _measurements(given, None, ([0.0, 1.0, 2.0], [0.0, 3.0, 1.0]))
    assert found.sensor == SensorLevels()
    np.testing.assert_array_equal(found.trace.level, [0, 3, 1])
    assert _measurements(given, SENSOR, None).sensor is SENSOR


def test_a_list_of_measurements_has_its_numbers(tmp_path):
    """Of the sensor, of targets along columns, of a speed that is told or not, and of a trace."""
    random = np.random.default_rng(3)
    first, second = random.integers(0, 900, (2, 21, 4)).astype(float)
    second += 0.25
    (tmp_path / "a.csv").write_text("\n".join(",".join(map(str, row)) for row in first))
    np.save(tmp_path / "b.npy", second)
    rows = "\n".join(f"{t},{t**2},{-t}" for t in range(40))
    (tmp_path / "t.csv").write_text(f"time (ms),CH1,CH2\n{rows}\n")
    (tmp_path / "bench.toml").write_text(
        """
        [[picture]]
        path = "a.csv"
        target = "edge"
        speed_px_per_s = -2400
        [[picture]]
        path = "b.npy"
        [sensor]
        electrons_per_level = 2.5
        read_noise_e = 3.5
        black_level = 60
        full_level = 4000
        axis = "columns"
        [trace]
        path = "t.csv"
        column = "CH2"
        """
    )
    found = read_measurements(tmp_path / "bench.toml")
    edge, point = found.pictures
    assert (edge.target, edge.speed, edge.is_rounded) == ("edge", -2400.0, True)
    assert (point.target, point.speed, point.is_rounded) == ("point", None, False)
    np.testing.assert_array_equal(edge.levels, first.T)
    np.testing.assert_array_equal(point.levels, second.T)
    assert found.sensor == SensorLevels(2.5, 3.5, 60.0, 4000.0)
    np.testing.assert_allclose(found.trace.time, np.arange(40) / 1e3)
    np.testing.assert_array_equal(found.trace.level, -np.arange(40.0))
