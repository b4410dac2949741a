"""A shutter stays in [0, 1], is nothing outside its exposure, and integrates to itself."""

import inspect
from functools import partial

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Array
from support.cases import MOTIONS, SHUTTERS
from support.classes import final_classes, final_classes_in

import mishutter
from mishutter import (
    AbstractShutter,
    ChippedShutter,
    ExpectedErrorLoss,
    GaussianShutter,
    HannShutter,
    ParabolicMotion,
    Scene,
    SplineShutter,
    TukeyShutter,
    binned_exposure,
    blur_kernel,
    transfer_function,
)
from mishutter.model import shutters
from mishutter.model.motion import AbstractMotion

# Other folders get this class from `piecewise` alone, and none needs its name.
from mishutter.model.shutters.base import AbstractAdjustableShutter, SampledShutter, piecewise
from mishutter.model.shutters.polynomials import PolynomialShutter

EFFICIENCY = 1e-14
"""A sum of a few dozen numbers below one."""
INTERPOLATION = 1e-11
"""Degree 5 on 64 pieces, for a smooth profile."""

TAU = np.linspace(-1.2, 1.2, 241)


def test_every_shutter_and_motion_is_among_the_cases():
    """A class that is missing from the cases is a class that nothing tests."""
    covered = {type(case.shutter()) for case in SHUTTERS.values()} | {
        SampledShutter,
        PolynomialShutter,
    }
    assert covered == final_classes_in(shutters, AbstractShutter)
    assert {type(m()) for m in MOTIONS.values()} == final_classes(mishutter, AbstractMotion)


@pytest.mark.parametrize("slug", SHUTTERS)
def test_transmittance_is_a_transmittance(slug):
    """In [0, 1], zero outside the exposure, and of the argument's shape."""
    value = np.asarray(SHUTTERS[slug].shutter().transmittance(TAU))
    assert value.shape == TAU.shape
    assert np.all((value >= 0) & (value <= 1))
    assert np.all(value[np.abs(TAU) > 1] == 0)


@pytest.mark.parametrize("slug", SHUTTERS)
def test_efficiency_is_half_the_integral(slug):
    """Against the reference's antiderivative."""
    case = SHUTTERS[slug]
    assert abs(float(case.shutter().efficiency()) - float(case.reference().total / 2)) < EFFICIENCY


@pytest.mark.parametrize("slug", SHUTTERS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_precision_follows_the_parameters(slug, dtype):
    """A shutter of float32 parameters computes in float32, also with float64 switched on."""
    shutter = SHUTTERS[slug].shutter(dtype)
    assert shutter.transmittance(TAU.astype(dtype)).dtype == dtype
    if SHUTTERS[slug].parameters.size:
        assert shutter.efficiency().dtype == dtype


@pytest.mark.parametrize("slug", SHUTTERS)
def test_box_coordinates_rebuild_the_shutter(slug):
    """`at(box())` is the same profile, for every shutter that a solver may move."""
    shutter = SHUTTERS[slug].shutter()
    if not isinstance(shutter, AbstractAdjustableShutter):
        return
    box = shutter.box()
    assert np.all((box >= 0) & (box <= 1))
    again = shutter.at(box).transmittance(TAU)
    np.testing.assert_allclose(again, shutter.transmittance(TAU), atol=1e-13)


@pytest.mark.parametrize(
    ("shutter", "piece", "distance", "bend"),
    [(HannShutter(), 0, 1.0, -(np.pi**2) / 2), (GaussianShutter(0.4), 1, 0.0, -1 / 0.16)],
)
def test_a_profile_bends_at_its_very_middle(shutter, piece, distance, bend):
    """Its second derivative there is that of the curve, on whichever side it is counted."""

    def height(distance):
        return shutter.piece_mean(jnp.array(piece), jnp.array(True), distance, jnp.zeros(()))

    found = jax.grad(jax.grad(height))(jnp.array(distance))
    np.testing.assert_allclose(found, bend, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("sigma", [0.05, 0.4, 5.0])
def test_means_of_a_gaussian_are_exact(sigma, dtype):
    """Over intervals of every width and place, and in their slopes, against 30 digits."""
    random, shutter = np.random.default_rng(0), GaussianShutter(dtype(sigma))
    width = np.minimum(10.0 ** random.uniform(-6, 0, 400), 1).astype(dtype)
    centre = width / 2 + (1 - width) * (random.uniform(size=400) ** 2).astype(dtype)

    def mean(centre, width):
        return shutter.piece_mean(jnp.array(1), jnp.array(True), centre, width)

    def exact(centre, width):
        ends = ((centre + side * width / 2) / (mp.sqrt(2) * own) for side in (-1, 1))
        below, above = map(mp.erfc, ends)
        return (below - above) * own * mp.sqrt(mp.pi / 2) / width

    with mp.workdps(30):
        own = mp.mpf(float(shutter.sigma))
        points = [tuple(map(mp.mpf, map(float, pair))) for pair in zip(centre, width, strict=True)]
        expected = np.array([float(exact(*point)) for point in points])
        slopes = [[float(mp.diff(exact, p, n)) for p in points[::8]] for n in ((1, 0), (0, 1))]
    allowed = (8 + 3 * (centre / sigma) ** 2) * np.finfo(dtype).eps * expected
    found = np.asarray(jax.vmap(mean)(centre, width))
    assert np.all(np.abs(found - expected) <= allowed + np.finfo(dtype).tiny)
    if dtype is np.float64:
        for argument, slope in enumerate(slopes):
            found = jax.vmap(jax.grad(mean, argument))(centre[::8], width[::8])
            np.testing.assert_allclose(found, slope, rtol=1e-12, atol=1e-13)


@given(st.lists(st.floats(-1e6, 1e6), min_size=9, max_size=9))
@settings(max_examples=30, deadline=None)
def test_any_parameters_are_a_spline_shutter(parameters):
    """Folding keeps the profile in [0, 1] wherever a solver steps."""
    value = np.asarray(SplineShutter(np.array(parameters)).transmittance(TAU))
    assert np.all((value >= 0) & (value <= 1))


def test_parameters_beyond_an_end_fold_back_from_it():
    """As far within as they are beyond it, at 0 as at 1, and again at the next end."""
    folded = SplineShutter([-0.2, 0.3, 1.2, 1.9, 2.4, -1.7]).coefficients
    np.testing.assert_allclose(folded, [0.2, 0.3, 0.8, 0.1, 0.4, 0.3], atol=1e-12)


def test_splines_hold_a_rect_and_fit_a_hann():
    """All ones are fully open, edges included; 24 coefficients follow a Hann to 2e-3."""
    rect = SplineShutter(np.ones(9)).transmittance(np.array([-1.0, 0.3, 1.0]))
    np.testing.assert_array_equal(rect, np.ones(3))
    fit = SplineShutter.fit(HannShutter())
    np.testing.assert_allclose(fit.transmittance(TAU), HannShutter().transmittance(TAU), atol=2e-3)
    mirrored = SplineShutter.fit(TukeyShutter(0.4), 17, symmetric=True)
    np.testing.assert_array_equal(mirrored.coefficients, np.asarray(mirrored.coefficients)[::-1])


def test_a_symmetric_fit_of_a_one_sided_profile():
    """It is that of the mean of the profile and its mirror image."""
    chips = np.array([0.1, 0.9, 0.6, 0.3])
    found = SplineShutter.fit(ChippedShutter(chips), 13, symmetric=True)
    mirrored = SplineShutter.fit(ChippedShutter((chips + chips[::-1]) / 2), 13)
    np.testing.assert_allclose(found.coefficients, mirrored.coefficients, atol=1e-9)


def test_a_fit_is_the_best_within_bounds():
    """Where a coefficient could move, moving it does not help: the residual says so."""
    chips, count = ChippedShutter([0.0, 1.0, 0.25, 0.0]), 11
    fit = SplineShutter.fit(chips, count)
    tau = (np.arange(16 * (count - 3)) + 0.5) / (8 * (count - 3)) - 1
    basis = np.stack([fit.at(row).transmittance(tau) for row in jnp.eye(count)])
    slope = basis @ np.asarray(fit.transmittance(tau) - chips.transmittance(tau))
    coefficients = np.asarray(fit.coefficients)
    assert np.any(coefficients == 0)
    assert np.all(slope[coefficients > 0] < 1e-8)
    assert np.all(slope[coefficients < 1] > -1e-8)


class OwnHann(AbstractShutter):
    """A shutter as a user writes it: its transmittance alone."""

    def transmittance(self, tau):
        inside = jnp.abs(tau) <= 1
        return jnp.where(inside, jnp.cos(jnp.pi / 2 * jnp.where(inside, tau, 0)) ** 2, 0.0)


class Amplifier(AbstractShutter):
    """What a user writes by mistake: somewhere it is no transmittance."""

    values: Array

    def transmittance(self, tau):
        return jnp.interp(jnp.asarray(tau), jnp.linspace(-1, 1, self.values.size), self.values)


class Constant(AbstractShutter):
    """One that forgets its argument."""

    def transmittance(self, tau):
        return jnp.ones(())


class WrittenInNumPy(AbstractShutter):
    """One whose numbers have to be known."""

    def transmittance(self, tau):
        return np.cos(np.asarray(tau))


class Complex(AbstractShutter):
    """One with an imaginary part."""

    def transmittance(self, tau):
        return jnp.exp(1j * jnp.asarray(tau, complex))


@pytest.mark.parametrize(
    ("shutter", "message"),
    [
        (
            Amplifier(np.array([0.0, 2.0, 0.0])),
            r"`Amplifier.transmittance` must lie in .*got 2",
        ),
        (Amplifier(np.array([0.5, -0.1, 0.5])), r"must lie in \[0, 1\]; got -0.1"),
        (Amplifier(np.array([0.5, np.nan, 0.5])), r"must lie in \[0, 1\]; got nan"),
        (Constant(), r"must have the shape of its argument; got shape \(\)"),
        (
            WrittenInNumPy(),
            r"`WrittenInNumPy.transmittance` must be made of .* those of `jax.numpy`",
        ),
        (Complex(), r"must be real; got complex128"),
    ],
)
def test_a_shutter_of_ones_own_that_is_none(shutter, message):
    """It is refused wherever it is integrated or fitted, by its name."""
    motion = ParabolicMotion(acceleration=37.0, half_exposure=1.1)
    for use in (
        shutter.efficiency,
        lambda: SplineShutter.fit(shutter, 7),
        lambda: blur_kernel(shutter, motion, num_taps=9),
        lambda: binned_exposure(shutter, motion, speed=0.0, edges=np.arange(5.0)),
        lambda: transfer_function(shutter, motion, speed=0.0, frequency=0.1),
    ):
        with pytest.raises(ValueError, match=message):
            use()


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [int, bool])
def test_a_shutter_of_ones_own_may_be_of_integers(dtype):
    """Open and closed as 1 and 0 are the light that they stand for."""

    class HalfOpen(AbstractShutter):
        def transmittance(self, tau):
            return (jnp.asarray(tau) >= 0).astype(dtype)

    motion = ParabolicMotion(acceleration=37.0, half_exposure=1.1)
    own = blur_kernel(HalfOpen(), motion, speed=13.0, num_taps=19)
    chips = blur_kernel(ChippedShutter([0.0, 1.0]), motion, speed=13.0, num_taps=19)
    assert abs(float(HalfOpen().efficiency()) - 0.5) < EFFICIENCY
    np.testing.assert_allclose(own, chips, rtol=0, atol=EFFICIENCY)


@pytest.mark.slow
def test_a_shutter_of_ones_own_is_integrated():
    """Through its interpolant, to what a smooth profile allows."""
    motion = ParabolicMotion(acceleration=37.0, half_exposure=1.1)
    edges = np.linspace(-8.0, 61.0, 24)
    own = binned_exposure(OwnHann(), motion, speed=13.0, edges=edges)
    exact = binned_exposure(HannShutter(), motion, speed=13.0, edges=edges)
    np.testing.assert_allclose(own, exact, atol=INTERPOLATION)
    assert abs(float(OwnHann().efficiency()) - 0.5) < INTERPOLATION


def test_an_interpolant_is_as_near_as_it_says():
    """At most max|w^(6)| / (64^6 2^5 6!) from a Hann profile, all over its pieces."""
    offset = np.linspace(0, 2 / 64, 21)
    pieces = piecewise(OwnHann()).piece_transmittance(jnp.broadcast_to(offset, (64, 21)))
    tau = np.linspace(-1, 1, 65)[:-1, None] + offset
    bound = np.pi**6 / 2 / (64**6 * 2**5 * 720)
    np.testing.assert_allclose(pieces, HannShutter().transmittance(tau), rtol=0, atol=1.01 * bound)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ChippedShutter(np.zeros((2, 3))), "must be one row of at least one chip"),
        (lambda: ChippedShutter(np.zeros(0)), "must be one row of at least one chip"),
        (lambda: ChippedShutter(np.array([0.2, 1.3])), r"must be from 0 to 1"),
        (lambda: ChippedShutter(np.array([0.2, np.nan])), r"must be finite"),
        (lambda: GaussianShutter(0.01), r"must lie in \[0.05, 5.0\]"),
        (lambda: GaussianShutter(5.1), r"must lie in \[0.05, 5.0\]"),
        (lambda: TukeyShutter(1.2), r"must be from 0 to 1"),
        (lambda: GaussianShutter(np.array([0.3, 0.4])), r"must be a scalar; got shape \(2,\)\."),
        (lambda: GaussianShutter(0.4j), "must be real numbers; got 0.4j"),
        (lambda: TukeyShutter(np.array([0.1, 0.2])), "must be a scalar"),
        (lambda: TukeyShutter(0.3 + 0.1j), "must be real numbers; got"),
        (lambda: ChippedShutter(np.array(["1", "0"])), "must be real numbers; got"),
        (lambda: SplineShutter(np.ones(3)), "must be one row for at least 4 coefficients"),
        (lambda: SplineShutter(np.array([0.1, 0.2, np.inf, 0.3])), "must be finite"),
        (lambda: SplineShutter.fit(HannShutter(), 3), "must be at least 4"),
        (lambda: SplineShutter.fit(HannShutter(), 0), "must be a positive integer"),
    ],
)
def test_wrong_parameters_are_named(make, message):
    """One sentence with the argument, what must hold and what came."""
    with pytest.raises(ValueError, match=message):
        make()


def test_efficiency_has_a_derivative():
    """By a chip's transmittance it is that chip's share of the exposure."""
    gradient = jax.grad(lambda w: ChippedShutter(w).efficiency())(jnp.full(5, 0.3))
    np.testing.assert_allclose(gradient, np.full(5, 0.2), rtol=1e-14)


def _light_of_a_taper(name, taper):
    shutter, motion = TukeyShutter(taper), ParabolicMotion(acceleration=2.1e5, half_exposure=0.01)
    if name == "efficiency":
        return shutter.efficiency()[None]
    if name == "kernel":
        return blur_kernel(shutter, motion, speed=700.0, num_taps=40)
    if name == "transfer":
        waves = transfer_function(shutter, motion, speed=700.0, frequency=np.array([0.03, 0.2]))
        return jnp.concatenate([waves.real, waves.imag])
    scene = Scene([-900.0, 0.0, 900.0], photon_rate=1e5, read_noise=10.0)
    return ExpectedErrorLoss()(scene, motion, shutter)[None]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["efficiency", "kernel", "transfer", "loss"])
def test_a_ramp_that_is_hardly_one_has_a_slope(name):
    """The derivative by a taper of 0, or of one whose inverse is past all numbers, is one-sided."""
    found = jax.jacfwd(partial(_light_of_a_taper, name))
    step = 1e-6
    rise = _light_of_a_taper(name, step) - _light_of_a_taper(name, 0.0)
    for taper in (0.0, 1e-300, 1e-17, 1e-9):
        np.testing.assert_allclose(found(taper), rise / step, rtol=1e-3, atol=1e-4)


def test_a_spline_is_fitted_to_a_shutter():
    """Anything else is named."""
    fit = inspect.unwrap(SplineShutter.fit)
    with pytest.raises(ValueError, match=r"fit\(shutter=...\)` must be a shutter; got 3"):
        fit(3)


@pytest.mark.slow
def test_a_spline_is_fitted_within_a_program():
    """A shutter that is known stays known where JAX compiles what uses its fit."""
    fit = lambda tau: SplineShutter.fit(HannShutter(), 7).transmittance(tau)  # noqa: E731
    assert float(jax.jit(fit)(jnp.asarray(0.31))) == pytest.approx(float(fit(0.31)), rel=1e-12)
