"""Tolerances: an ensemble of errors by quadrature, against cameras that are off at random.

The random cameras share no formula with the package: their stage is late, its path is added up in
time, and every step of their drive has an error of its own.
"""

from collections import namedtuple
from dataclasses import replace
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm, qmc
from support.designs import MOTION, SCENE, SMALL
from support.plan_check import squared_error_within

from mishutter import (
    ExpectedErrorLoss,
    LinearMotion,
    ParabolicMotion,
    RectShutter,
    Scene,
    StillCamera,
    Tolerances,
    TukeyShutter,
    evaluate,
    optimise,
    tolerance_costs,
)
from mishutter.blur.quadrature import exposure_quadrature
from mishutter.evaluation import tolerances as module

# Members of an ensemble and their weights; metrics hold only means over them.
from mishutter.evaluation.ensembles import drive_variance, ensemble_of, ensemble_weights
from mishutter.evaluation.losses import value_of
from mishutter.evaluation.response import spectra_of
from mishutter.evaluation.tolerances import ToleranceCost, ToleranceCosts
from mishutter.model.scene import in_sensor_frame
from mishutter.model.tolerances import TOLERANCE_NAMES

SHUTTER = TukeyShutter(0.6)
LOOSE = Tolerances(
    acceleration=0.06,
    velocity=170.0,
    delay=3e-4,
    speed=130.0,
    transmittance=0.08,
    drive_step=4e-4,
)


def _with(tolerances, scene=SCENE):
    return eqx.tree_at(lambda s: s.tolerances, scene, tolerances, is_leaf=lambda x: x is None)


def _moments(tolerances, num_cameras=256, num_times=600):
    """Mean response and mean power of cameras that are off at random; shape `(64,)` each."""
    frequency = (np.arange(64) + 0.5) / 128
    a, half = float(MOTION.acceleration), float(MOTION.half_exposure)
    times = (np.arange(num_times) + 0.5) / num_times * 2 * half - half
    window = np.asarray(SHUTTER.transmittance(times / half))
    normal = norm.ppf(qmc.Sobol(4, seed=5).random(num_cameras))
    steps = np.minimum(((times + half) / float(tolerances.drive_step)).astype(int), 10**6)
    random = np.random.default_rng(11)
    mean, power = np.zeros(64, complex), np.zeros(64)
    for acceleration, velocity, delay, fast in normal:
        own = a * (1 + float(tolerances.acceleration) * acceleration)
        pan, late = float(tolerances.velocity) * velocity, float(tolerances.delay) * delay
        errors = random.normal(size=steps[-1] + 1) * float(tolerances.transmittance)
        light = (window + errors[steps]) / num_times
        for speed in np.asarray(SCENE.speeds):
            seen = speed + float(tolerances.speed) * fast
            path = own * (times - late) ** 2 + pan * (times - late) - seen * times
            vertex = late + (seen - pan) / (2 * own)
            lowest = own * (vertex - late) ** 2 + pan * (vertex - late) - seen * vertex
            response = np.exp(-2j * np.pi * np.outer(frequency, path - lowest)) @ light
            mean += response
            power += np.abs(response) ** 2
    return mean / (num_cameras * SCENE.speeds.size), power / (num_cameras * SCENE.speeds.size)


def _error(mean, power):
    """Error of the best filter by the moments of the response, written anew."""
    frequency = (np.arange(64) + 0.5) / 128
    spectrum = 1 / (frequency**2 + 0.01**2)
    spectrum *= 0.2**2 / spectrum.mean()
    electrons = float(SCENE.photon_rate) * 2 * float(MOTION.half_exposure)
    noise = float(SHUTTER.efficiency()) * 0.25 / electrons
    noise += (float(SCENE.read_noise) / electrons) ** 2
    aperture = np.sinc(frequency) ** 2
    total = spectrum * power * aperture + noise
    return np.mean(spectrum * (1 - spectrum * np.abs(mean) ** 2 * aperture / total))


@pytest.mark.slow
def test_an_ensemble_is_that_of_cameras_at_random():
    """Every tolerance at once costs what cameras that are off at random lose: to 4 % of it."""
    expected = float(squared_error_within(_with(LOOSE), MOTION, SHUTTER, plan=SMALL))
    nominal = float(squared_error_within(SCENE, MOTION, SHUTTER, plan=SMALL))
    error = _error(*_moments(LOOSE))
    assert error > 1.02 * nominal
    assert expected - nominal == pytest.approx(error - nominal, rel=0.04)


@pytest.mark.slow
def test_few_nodes_are_enough():
    """Five and three nodes come to within 0.001 dB of many where the errors cost 0.2 dB."""
    fine = replace(LOOSE, num_speeds=21, num_accelerations=11)
    levels = [
        -10 * np.log10(float(squared_error_within(_with(t), MOTION, SHUTTER, plan=SMALL)))
        for t in (LOOSE, fine)
    ]
    assert levels[0] == pytest.approx(levels[1], abs=1e-3)


def test_a_late_stage_is_another_velocity():
    """A delay of d is a velocity of -2ad: the ensembles of both are one."""
    delay = Tolerances(delay=2.5e-4)
    velocity = Tolerances(velocity=2 * float(MOTION.acceleration) * 2.5e-4)
    speeds = [
        ensemble_of(SCENE.speeds, t, MOTION, np.dtype(np.float64))[1] for t in (delay, velocity)
    ]
    np.testing.assert_allclose(*speeds, rtol=1e-14)
    late = np.linspace(-1, 1, 7) * 0.01
    a, v, d = float(MOTION.acceleration), 310.0, 2.5e-4
    path = a * (late - d) ** 2 + v * (late - d)
    other = a * late**2 + (v - 2 * a * d) * late + a * d**2 - v * d
    np.testing.assert_allclose(path, other, rtol=1e-12)


def test_weights_are_those_of_a_normal_distribution():
    """Mean and variance of the speeds are those of the scene and of its tolerances together."""
    found = ensemble_of(SCENE.speeds, LOOSE, MOTION, np.dtype(np.float64))
    accelerations, speeds = map(np.asarray, found)
    weights = np.asarray(ensemble_weights(_with(LOOSE))).reshape(speeds.shape)
    assert weights.sum() == pytest.approx(1, rel=1e-14)
    share = weights.sum(axis=1)
    a = float(MOTION.acceleration)
    assert float(share @ accelerations) == pytest.approx(a, rel=1e-14)
    assert share @ (accelerations / a - 1) ** 2 == pytest.approx(0.06**2, rel=1e-12)
    late = (2 * a * 3e-4) ** 2 * (1 + 0.06**2)
    variance = np.var(np.asarray(SCENE.speeds)) + 170.0**2 + 130.0**2 + late
    assert np.sum(weights * speeds**2) == pytest.approx(variance, rel=1e-12)


def test_the_noise_of_a_drive():
    """Its variance is the sum over steps of the squares of their own responses."""
    scene = _with(Tolerances(transmittance=0.07, drive_step=2.5e-4))
    found = np.asarray(drive_variance(scene, MOTION, jnp.asarray(0.6), 64))
    frequency = (np.arange(64) + 0.5) / 128
    edges = np.arange(81) * 2.5e-4 - 0.01
    nodes, shares = np.polynomial.legendre.leggauss(24)
    times = edges[:-1, None] + (nodes + 1) / 2 * 2.5e-4
    path = float(MOTION.acceleration) * times**2 - np.asarray(SCENE.speeds)[:, None, None] * times
    waves = np.exp(-2j * np.pi * frequency[:, None, None, None] * path)
    each = np.abs(waves @ (shares / 2)) ** 2 / 80**2
    np.testing.assert_allclose(found, 0.07**2 * each.sum(axis=2).mean(axis=1), rtol=2e-3)


def test_an_open_shutter_has_no_drive():
    """And a sensor at rest no error of its velocity: a snapshot pays for objects alone."""
    scene = _with(replace(LOOSE, speed=0.0, num_speeds=5))
    still, shutter = StillCamera(half_exposure=1e-3), RectShutter()
    pan = LinearMotion(half_exposure=1e-3, velocity=400.0)
    errors = [
        float(squared_error_within(seen, motion, shutter, plan=SMALL))
        for seen in (SCENE, scene)
        for motion in (still, pan)
    ]
    assert errors[2] == pytest.approx(errors[0], rel=1e-12)
    assert errors[3] > 1.001 * errors[1]


@pytest.mark.slow
def test_tolerances_of_nothing_cost_nothing():
    """All at 0, on as many nodes, is the camera without; and without any the metrics say none."""
    nothing = Tolerances(num_speeds=5, num_accelerations=3)
    metrics = evaluate(_with(nothing), MOTION, SHUTTER)
    assert float(metrics.toleranced_psnr) == pytest.approx(float(metrics.expected_psnr), rel=1e-12)
    plain = evaluate(SCENE, MOTION, SHUTTER)
    assert plain.toleranced_psnr is None
    assert "toleranced" not in repr(plain)
    assert float(plain.expected_psnr) == float(metrics.expected_psnr)


@pytest.mark.slow
def test_costs_of_what_is_known_in_a_trace():
    """A function that JAX compiles may ask for them where none of their arguments is traced."""
    scene = _with(Tolerances(acceleration=0.06, delay=3e-4))
    alone, found = tolerance_costs(scene, MOTION, SHUTTER), []

    def asks(x):
        found.append(tolerance_costs(scene, MOTION, SHUTTER))
        return x * found[0].rows[-1].cost

    assert jax.jit(asks)(1.7) == pytest.approx(1.7 * alone.rows[-1].cost, rel=1e-9)
    assert found[0].text() == alone.text()


@pytest.mark.slow
def test_no_filter_beats_the_best():
    """An unaware decoder loses more than one that knows, and costs grow with the tolerance."""
    costs = tolerance_costs(_with(LOOSE), MOTION, SHUTTER)
    assert [row.name for row in costs.rows] == [
        "acceleration",
        "velocity",
        "delay",
        "speed",
        "transmittance",
        "all",
    ]
    for row in costs.rows:
        assert 0 < row.cost < row.unaware_cost
    assert costs.rows[-1].cost > costs.largest.cost
    errors = {"acceleration", "velocity", "delay", "speed", "transmittance"}
    tighter = Tolerances(
        **{name: getattr(LOOSE, name) / 2 for name in errors}, drive_step=LOOSE.drive_step
    )
    # Half the error is a quarter of its power, of which a larger one costs a little less.
    for row, half in zip(
        costs.rows, tolerance_costs(_with(tighter), MOTION, SHUTTER).rows, strict=True
    ):
        assert 0.24 * row.cost < half.cost < 0.4 * row.cost
    assert costs.largest.name in costs.verdict
    assert "6 %" in costs.text()


@pytest.mark.slow
def test_the_error_of_a_filter():
    """It is the mean of |1 - GH|^2 over cameras and the noise through G, of either filter."""
    scene = _with(replace(LOOSE, transmittance=0.0))
    costs = tolerance_costs(scene, MOTION, SHUTTER)
    frequency = (np.arange(512) + 0.5) / 1024
    spectrum = 1 / (frequency**2 + 0.01**2)
    spectrum *= 0.2**2 / spectrum.mean()
    electrons = float(SCENE.photon_rate) * 2 * float(MOTION.half_exposure)
    noise = float(SHUTTER.efficiency()) * 0.25 / electrons
    noise += (float(SCENE.read_noise) / electrons) ** 2
    nodes = exposure_quadrature(SHUTTER, 512, np.dtype(np.float64))

    def response(seen):
        return np.asarray(spectra_of(seen, nodes, MOTION, 512)) * np.sinc(frequency)

    def best_filter(seen):
        weights, spectra = np.asarray(ensemble_weights(seen))[:, None], response(seen)
        power = (weights * np.abs(spectra) ** 2).sum(0)
        return spectrum * (weights * spectra).sum(0).conj() / (spectrum * power + noise)

    spectra, weights = response(scene), np.asarray(ensemble_weights(scene))[:, None]
    for filtering, cost in (
        (best_filter(scene), costs.rows[-1].cost),
        (best_filter(SCENE), costs.rows[-1].unaware_cost),
    ):
        left = (weights * np.abs(1 - filtering * spectra) ** 2).sum(0)
        error = np.mean(spectrum * left + np.abs(filtering) ** 2 * noise)
        assert costs.expected_psnr - cost == pytest.approx(-10 * np.log10(error), abs=1e-3)


def test_a_pan_sees_its_own_error_as_one_of_speeds():
    """In the frame of the sensor the errors of speed and velocity add up as squares."""
    moved = LinearMotion(half_exposure=2e-3, velocity=700.0)
    seen, _ = in_sensor_frame(_with(LOOSE), moved)
    assert float(seen.tolerances.speed) == pytest.approx(np.hypot(170.0, 130.0), rel=1e-14)
    assert float(seen.tolerances.velocity) == 0
    still, _ = in_sensor_frame(_with(LOOSE), LinearMotion(half_exposure=2e-3, velocity=0.0))
    assert float(still.tolerances.speed) == 130.0


@pytest.mark.slow
def test_the_loss_is_differentiable_and_compiles():
    """By the numbers of the motion, under `jit`, as differences say; also without acceleration."""
    loss, scene = ExpectedErrorLoss(), _with(LOOSE)

    @jax.jit
    def value(a):
        motion = ParabolicMotion(acceleration=a, half_exposure=MOTION.half_exposure)
        return value_of(loss, scene, motion, SHUTTER, SMALL)

    a, step = MOTION.acceleration, 20.0
    difference = (value(a + step) - value(a - step)) / (2 * step)
    assert float(jax.grad(value)(a)) == pytest.approx(float(difference), rel=1e-6)
    assert np.isfinite(jax.grad(value)(jnp.zeros_like(a)))


def test_single_precision():
    """A scene of single precision has levels of single precision."""
    single = jax.tree.map(lambda x: x.astype(np.float32), (_with(LOOSE), MOTION, SHUTTER))
    error = squared_error_within(*single, plan=SMALL)
    assert error.dtype == np.float32
    double = squared_error_within(_with(LOOSE), MOTION, SHUTTER, plan=SMALL)
    assert float(error) == pytest.approx(float(double), rel=2e-4)


@pytest.mark.slow
def test_a_design_for_its_tolerances():
    """Within them it is better than the design without, whose own loss it cannot beat."""
    loose = Tolerances(velocity=500.0)
    scene = _with(loose)
    options = {"num_starts": 2, "max_steps": 60, "free": ("acceleration", "half_exposure")}
    plain = optimise(SCENE, MOTION, SHUTTER, **options)
    robust = optimise(scene, MOTION, SHUTTER, **options)
    within = evaluate(scene, plain.motion, plain.shutter).toleranced_psnr
    assert float(robust.metrics.toleranced_psnr) > float(within) + 0.02
    assert float(robust.metrics.expected_psnr) < float(plain.metrics.expected_psnr)
    ratio = np.sqrt(10 ** (-float(robust.metrics.toleranced_psnr) / 10)) / 0.2
    assert robust.loss == pytest.approx(ratio, rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "requirement"),
    [
        ({"delay": -1e-6}, r"`Tolerances\(delay=...\)` must be at least 0"),
        ({"speed": np.nan}, r"`Tolerances\(speed=...\)` must be finite"),
        ({"velocity": np.ones(2)}, r"`Tolerances\(velocity=...\)` must be a scalar"),
        ({"transmittance": 0.1}, r"`Tolerances\(drive_step=...\)` must be above 0 where"),
        ({"num_speeds": 0}, r"`Tolerances\(num_speeds=...\)` must be a positive integer"),
        ({"delay": 3e-5, "num_speeds": 1}, r"num_speeds=...\)` must be at least 2, for errors"),
        (
            {"acceleration": 0.02, "num_accelerations": 1},
            r"`Tolerances\(num_accelerations=...\)` must be at least 2, for errors above 0; got 1",
        ),
    ],
)
def test_tolerances_that_are_none(arguments, requirement):
    """One line says which number is out of its range."""
    with pytest.raises(ValueError, match=requirement):
        Tolerances(**arguments)


def test_a_scene_takes_tolerances_alone():
    """And costs are asked of a scene that has some."""
    with pytest.raises((ValueError, TypeError), match="tolerances"):
        Scene([1.0], photon_rate=1e5, read_noise=1.0, tolerances=3)
    with pytest.raises(ValueError, match="must have tolerances; got none"):
        tolerance_costs(SCENE, MOTION, SHUTTER)


def test_a_cost_of_nothing_has_no_sign():
    """Rounding leaves some costs a little below 0, which a table shows as 0."""
    row = ToleranceCost("delay", "4 us", -2e-16, -3e-16)
    assert "-0.000" not in ToleranceCosts(31.0, (row,)).text()


def test_the_largest_cost_is_that_of_one_tolerance():
    """Whatever their order, and never that of all together; none where there is none."""
    delay, scale, every = (
        ToleranceCost(name, "1 %", cost, cost + 0.1)
        for name, cost in (("delay", 0.31), ("stage_scale", 0.07), ("all", 0.44))
    )
    for rows in ((delay, scale, every), (scale, delay, every)):
        assert ToleranceCosts(31.0, rows).largest == delay
    assert ToleranceCosts(31.0, ()).largest is None


def test_each_cost_is_of_its_tolerance_alone(monkeypatch):
    """The last is of all of them; levels are 10 log10 of errors without, within, and unaware."""
    view = namedtuple("view", "scene motion plan")
    monkeypatch.setattr(module, "sampled_view", lambda scene, motion, *_: view(scene, motion, None))
    monkeypatch.setattr(module, "Records", SimpleNamespace(of=lambda view: view.scene.tolerances))

    def errors(scene, motion, own, without, plan):
        assert without is None
        total = sum(float(getattr(own, name)) > 0 for name in TOLERANCE_NAMES)
        return 1e-3, 1e-3 * 2**total, 1e-3 * 3**total

    monkeypatch.setattr(module, "_errors", errors)
    costs = tolerance_costs(_with(LOOSE), MOTION, SHUTTER)
    assert costs.expected_psnr == pytest.approx(30)
    names = [name for name in TOLERANCE_NAMES if float(getattr(LOOSE, name)) > 0]
    assert [row.name for row in costs.rows] == [*names, "all"]
    for count, row in zip([*[1] * len(names), len(names)], costs.rows, strict=True):
        assert row.cost == pytest.approx(10 * np.log10(2) * count)
        assert row.unaware_cost == pytest.approx(10 * np.log10(3) * count)
