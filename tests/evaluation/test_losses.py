"""Losses: their bounds, what cannot be gained by dimming, and their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.classes import final_classes
from support.designs import MOTION, SCENE, SMALL
from support.plan_check import plan_error

from mishutter import (
    AbstractLoss,
    ChippedShutter,
    DesignLoss,
    ExpectedErrorLoss,
    ParabolicMotion,
    RectShutter,
    Scene,
    SplineShutter,
    TukeyShutter,
    blur_kernel,
    condition_number,
    evaluate,
    losses,
)
from mishutter.evaluation.losses.design import smooth_condition_number

LOSSES = {
    "design": DesignLoss(condition=0.1, invariance=0.7, efficiency=0.9),
    "expected_error": ExpectedErrorLoss(),
}


def test_every_loss_is_among_them():
    """One that is missing is one that nothing tests; a sum is of those."""
    covered = {type(loss) for loss in LOSSES.values()} | {losses.WeightedSum}
    assert covered == final_classes(losses, AbstractLoss)


PROFILE = np.array([0.1, 0.55, 0.8, 1.0, 0.9, 0.35])


@pytest.mark.parametrize("stroke", [3.0, 45.0, 130.0])
@pytest.mark.parametrize("shutter", [RectShutter(), TukeyShutter(0.4)], ids=["rect", "tukey"])
def test_smoothed_condition_number_keeps_its_bound(stroke, shutter):
    """True value <= smoothed value <= F^(1/200) times the true value."""
    motion = type(MOTION)(acceleration=stroke / 1e-4, half_exposure=1e-2)
    kernel = blur_kernel(shutter, motion, num_taps=160)
    smooth = float(smooth_condition_number(jnp.fft.rfft(kernel, 640)))
    true = float(condition_number(kernel, num_frequencies=640))
    assert true * (1 - 1e-12) <= smooth <= true * 321 ** (1 / 200)


def test_the_expected_error_is_in_units_of_the_contrast():
    """20 dB are a factor of 10, over the picture's deviation; without one there is no error."""
    shutter = TukeyShutter(0.6)
    for deviation in (0.13, 0.31):
        scene = Scene([-700.0, 250.0], photon_rate=2e5, read_noise=4.0, deviation=deviation)
        psnr = float(evaluate(scene, MOTION, shutter).expected_psnr)
        found = float(ExpectedErrorLoss()(scene, MOTION, shutter))
        assert np.isclose(found, 10 ** (-psnr / 20) / deviation, rtol=1e-12)
    grey = Scene([-700.0, 250.0], photon_rate=2e5, read_noise=4.0, deviation=0.0)
    assert float(ExpectedErrorLoss()(grey, MOTION, shutter)) == 0


def test_a_spectral_zero_counts_as_the_working_precision():
    """Of the largest response, and so does a response that is nothing but zeros."""
    eps = np.finfo(float).eps
    smooth = float(smooth_condition_number(jnp.fft.rfft(jnp.ones(4), 8)))
    assert 1 / eps <= smooth * (1 + 1e-12) <= 5 ** (1 / 200) / eps * (1 + 1e-9)
    assert float(smooth_condition_number(jnp.zeros(5, complex))) == 1 / eps


@pytest.mark.parametrize("share", [0.5, 0.01, 1e-6])
@pytest.mark.parametrize("slug", LOSSES)
def test_dimming_the_shutter_gains_nothing(slug, share):
    """A loss rises, or stays, when every transmittance is scaled down."""
    loss = LOSSES[slug]
    bright = loss(SCENE, MOTION, ChippedShutter(PROFILE), plan=SMALL)
    dim = loss(SCENE, MOTION, ChippedShutter(share * PROFILE), plan=SMALL)
    assert float(dim) > float(bright)


def test_condition_and_invariance_do_not_see_the_scale():
    """The first two terms are those of the open shutter, however dim it is made."""
    loss = DesignLoss(condition=0.3, invariance=1.0, efficiency=0.0)
    values = [
        float(loss(SCENE, MOTION, ChippedShutter(share * PROFILE), plan=SMALL))
        for share in (1.0, 1e-3)
    ]
    assert np.isclose(*values, rtol=1e-10)


@pytest.mark.parametrize("slug", LOSSES)
def test_gradients_agree_with_differences(slug):
    """By profile, acceleration and half exposure, against central differences."""
    loss = LOSSES[slug]

    def value(x):
        motion = type(MOTION)(
            acceleration=MOTION.acceleration * x[0], half_exposure=MOTION.half_exposure * x[1]
        )
        return loss(SCENE, motion, SplineShutter(x[2:]), plan=SMALL)

    point = jnp.concatenate([jnp.array([1.03, 0.97]), jnp.asarray(PROFILE) * 0.9 + 0.03])
    gradient = jax.jit(jax.grad(value))(point)
    compiled = jax.jit(value)
    for index in range(point.size):
        step = jnp.zeros_like(point).at[index].set(1e-5)
        difference = (compiled(point + step) - compiled(point - step)) / 2e-5
        assert np.isclose(gradient[index], difference, rtol=2e-6, atol=2e-8)


@pytest.mark.parametrize("slug", LOSSES)
def test_a_profile_alone_may_be_traced(slug):
    """Of a scene and a motion that are known a loss makes its own plan under `jit` as well."""
    loss = LOSSES[slug]

    def value(profile):
        return loss(SCENE, MOTION, SplineShutter(profile))

    profile = jnp.asarray(PROFILE)
    found = jax.jit(jax.value_and_grad(value))(profile)
    for one, other in zip(found, jax.value_and_grad(value)(profile), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-13)


def test_losses_add_and_take_factors():
    """A sum of weighted losses is the weighted sum of their values."""
    first, second = LOSSES.values()
    combined = 0.25 * first + second * 3.0
    shutter = TukeyShutter(0.6)
    expected = 0.25 * first(SCENE, MOTION, shutter, plan=SMALL) + 3.0 * second(
        SCENE, MOTION, shutter, plan=SMALL
    )
    assert np.isclose(combined(SCENE, MOTION, shutter, plan=SMALL), expected, rtol=1e-14)
    doubled = 2.0 * combined + second
    expected = 2.0 * expected + second(SCENE, MOTION, shutter, plan=SMALL)
    assert np.isclose(doubled(SCENE, MOTION, shutter, plan=SMALL), expected, rtol=1e-14)
    assert sum([0.25 * first, second * 3.0]) == combined
    with pytest.raises(TypeError, match="unsupported operand"):
        1 + first


@pytest.mark.parametrize("plan", [SMALL, None])
def test_a_sum_without_any_weight_is_nothing(plan):
    """Whether or not terms that weigh nothing are left out."""
    first, second = LOSSES.values()
    assert float((0.0 * first + second * 0.0)(SCENE, MOTION, RectShutter(), plan=plan)) == 0


def test_a_weight_of_zero_leaves_its_term_out():
    """Efficiency alone is the light that is lost."""
    loss = DesignLoss(condition=0.0, invariance=0.0, efficiency=1.0)
    shutter = TukeyShutter(0.6)
    assert np.isclose(loss(SCENE, MOTION, shutter, plan=SMALL), 1 - shutter.efficiency())


@pytest.mark.parametrize("weight", [np.float32(0.5), np.array(0.5), jnp.asarray(0.5)])
def test_a_weight_may_be_a_scalar_array(weight):
    """The number that it holds is the weight."""
    assert DesignLoss(condition=weight) == DesignLoss(condition=0.5)


@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf"), "1", np.array(-0.5)])
def test_weights_out_of_range_are_refused(weight):
    """A weight is a finite number of at least 0."""
    with pytest.raises((ValueError, TypeError), match="condition"):
        DesignLoss(condition=weight)


def test_a_closed_shutter_is_finite_and_bad():
    """A closed shutter is worse than any open one, with a finite gradient."""
    for loss in LOSSES.values():
        value, gradient = jax.value_and_grad(
            lambda chips, loss=loss: loss(SCENE, MOTION, ChippedShutter(chips), plan=SMALL)
        )(jnp.zeros(4))
        assert np.isfinite(value)
        assert np.all(np.isfinite(gradient))
        assert float(value) > float(loss(SCENE, MOTION, RectShutter(), plan=SMALL))


def test_a_loss_of_ones_own_is_one_small_class():
    """A class with a call composes with the package's losses."""

    class Darkness(AbstractLoss):
        def __call__(self, scene, motion, shutter, *, plan=None):
            return 1 - shutter.efficiency()

    loss = Darkness() + 2.0 * Darkness()
    assert np.isclose(loss(SCENE, MOTION, TukeyShutter(0.5)), 0.75)


def test_losses_subtract_and_are_divided():
    """As they add and take factors: each is a weighted sum."""
    error, design = LOSSES["expected_error"], LOSSES["design"]
    shutter = TukeyShutter(0.5)
    x, y = (float(loss(SCENE, MOTION, shutter, plan=SMALL)) for loss in (error, design))
    for loss, value in ((-error, -x), (error - 0.3 * design, x - 0.3 * y), (design / 4, y / 4)):
        assert np.isclose(loss(SCENE, MOTION, shutter, plan=SMALL), value, rtol=1e-14)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda loss: loss * loss,
        lambda loss: loss / loss,
        lambda loss: loss - 1,
        lambda loss: "3" * loss,
    ],
)
def test_what_is_no_number_is_no_factor(wrong):
    """It is refused where it is written, not where the loss is computed."""
    with pytest.raises(TypeError, match=r"unsupported operand|can't multiply|be a loss"):
        wrong(ExpectedErrorLoss())


def test_a_loss_of_ones_own_takes_a_plan():
    """One that does not is refused when it is made, in one line; others may ignore it."""

    class Planless(AbstractLoss):
        def __call__(self, scene, motion, shutter):
            return 1 - shutter.efficiency()

    class Indifferent(AbstractLoss):
        def __call__(self, scene, motion, shutter, **options):
            return 1 - shutter.efficiency()

    line = (
        r"^`Planless.__call__` must take `plan` by name, .*; got \(self, scene, motion, shutter\)."
    )
    with pytest.raises(ValueError, match=line):
        Planless()
    assert np.isclose(Indifferent()(SCENE, MOTION, TukeyShutter(0.5), plan=SMALL), 0.25)


def test_what_is_no_loss_is_named_wherever_it_is_computed():
    """Within a sum and by a plan too, by the class that gave it."""

    class Many(AbstractLoss):
        def __call__(self, scene, motion, shutter, *, plan=None):
            return jnp.ones(3)

    line = "`Many.__call__` must give one real number; got 'float64 of shape "
    with pytest.raises(ValueError, match=line):
        (ExpectedErrorLoss() + Many())(SCENE, MOTION, RectShutter())
    with pytest.raises(ValueError, match=line):
        plan_error(SMALL, SCENE, MOTION, RectShutter(), loss=Many())


@pytest.mark.parametrize("read_noise", [0.0, 2.0, 1e20])
@pytest.mark.parametrize("photon_rate", [1e-30, 1e12, 1e25])
def test_the_expected_error_holds_in_any_light(photon_rate, read_noise):
    """In single precision too, in which squares of such numbers are 0 or infinite."""

    def value_and_slopes(dtype):
        scene = Scene(
            np.array([-700.0, 250.0], dtype), photon_rate=photon_rate, read_noise=read_noise
        )

        def error(of):
            motion = ParabolicMotion(acceleration=1e5 * of[0], half_exposure=1e-2 * of[1])
            return ExpectedErrorLoss()(scene, motion, TukeyShutter(of[2]), plan=SMALL)

        return jax.value_and_grad(error)(jnp.asarray([1.1, 0.9, 0.3], dtype))

    value, slopes = value_and_slopes(np.float64)
    single, single_slopes = value_and_slopes(np.float32)
    assert value > 0
    assert np.isclose(single, value, rtol=1e-5)
    np.testing.assert_allclose(single_slopes, slopes, rtol=1e-4, atol=1e-6 * value)
