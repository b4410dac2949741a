"""Losses: their bounds, what cannot be gained by dimming, and their derivatives."""

import equinox as eqx
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
    FoundSpeedLoss,
    IdealDevice,
    KnownSpeedLoss,
    Limits,
    Occlusion,
    ParabolicMotion,
    RectShutter,
    Scene,
    SplineShutter,
    StillCamera,
    Texture,
    Tolerances,
    TukeyShutter,
    WorstSpeedLoss,
    blur_kernel,
    condition_number,
    evaluate,
    optimise,
)
from mishutter.evaluation import losses, speed_knowledge
from mishutter.evaluation.errors import LinearErrors
from mishutter.evaluation.found_speed import open_time, smear_difference
from mishutter.evaluation.losses import smooth_condition_number, value_of

# Terms of a loss, each checked against its definition; a loss returns their weighted sum.
from mishutter.evaluation.needs import ONLY_SPECTRA, Plan, sizes
from mishutter.evaluation.response import compute_response, folded
from mishutter.evaluation.views import sampled_view
from mishutter.search.planning import plan

LOSSES = {
    "design": DesignLoss(condition=0.1, invariance=0.7, efficiency=0.9),
    "expected_error": ExpectedErrorLoss(),
    "known_speed": KnownSpeedLoss(),
    "found_speed": FoundSpeedLoss(0.7),
    "worst_speed": WorstSpeedLoss(),
}


def test_every_loss_is_among_them():
    """One that is missing is one that nothing tests; a sum is of those, a function a user's."""
    covered = {type(loss) for loss in LOSSES.values()}
    covered |= {losses.WeightedSum, losses.FunctionLoss}
    of_decoders = final_classes(speed_knowledge, AbstractLoss)
    assert covered == final_classes(losses, AbstractLoss) | of_decoders


PROFILE = np.array([0.1, 0.55, 0.8, 1.0, 0.9, 0.35])


@pytest.mark.slow
@pytest.mark.parametrize("stroke", [3.0, 45.0, 130.0])
@pytest.mark.parametrize("shutter", [RectShutter(), TukeyShutter(0.4)], ids=["rect", "tukey"])
def test_smoothed_condition_number_keeps_its_bound(stroke, shutter):
    """True value <= smoothed value <= F^(1/200) times the true value."""
    motion = type(MOTION)(acceleration=stroke / 1e-4, half_exposure=1e-2)
    kernel = blur_kernel(shutter, motion, num_taps=160)
    smooth = float(smooth_condition_number(jnp.fft.rfft(kernel, 640)))
    true = float(condition_number(kernel, num_frequencies=640))
    assert true * (1 - 1e-12) <= smooth <= true * 321 ** (1 / 200)


@pytest.mark.slow
def test_the_expected_error_is_in_units_of_the_contrast():
    """20 dB are a factor of 10, over the picture's deviation; without one there is no error."""
    shutter = TukeyShutter(0.6)
    for deviation in (0.13, 0.31):
        scene = Scene(
            [-700.0, 250.0], photon_rate=2e5, read_noise=4.0, picture=Texture(deviation=deviation)
        )
        psnr = float(evaluate(scene, MOTION, shutter).expected_psnr)
        found = float(ExpectedErrorLoss()(scene, MOTION, shutter))
        assert np.isclose(found, 10 ** (-psnr / 20) / deviation, rtol=1e-12)
    grey = Scene([-700.0, 250.0], photon_rate=2e5, read_noise=4.0, picture=Texture(deviation=0.0))
    assert float(ExpectedErrorLoss()(grey, MOTION, shutter)) == 0


@pytest.mark.slow
def test_a_decoder_that_is_told_the_speed_leaves_less():
    """Its loss is that of the metric, and below that of one filter; so it is within tolerances."""
    shutter, picture = TukeyShutter(0.6), Texture(deviation=0.17)
    light = {"photon_rate": 2e5, "read_noise": 4.0, "picture": picture}
    scene = Scene([-700.0, 250.0], **light)
    told, untold = KnownSpeedLoss(), ExpectedErrorLoss()
    level = float(evaluate(scene, MOTION, shutter).known_speed_psnr)
    found = float(told(scene, MOTION, shutter))
    assert np.isclose(found, 10 ** (-level / 20) / 0.17, rtol=1e-12)
    assert found < float(untold(scene, MOTION, shutter))
    built = Scene([-700.0, 250.0], **light, tolerances=Tolerances(acceleration=0.04, speed=60.0))
    assert found < float(told(built, MOTION, shutter)) < float(untold(built, MOTION, shutter))
    one = Scene([250.0], **light, tolerances=Tolerances(acceleration=0.04, speed=60.0))
    np.testing.assert_allclose(told(one, MOTION, shutter), untold(one, MOTION, shutter), rtol=1e-12)


@pytest.mark.slow
def test_a_decoder_that_finds_the_speed_keeps_a_share_of_what_being_told_brings():
    """In decibels, by the metric too; a share of 0 is one filter, and of 1 is being told.

    Where the blur differs by less than a photograph's own softness, it keeps nothing of it.
    """
    light = {"photon_rate": 2e5, "read_noise": 4.0, "picture": Texture(deviation=0.17)}
    near = evaluate(Scene([-700.0, 250.0], **light), MOTION, TukeyShutter(0.6))
    assert float(near.found_speed_psnr) == float(near.expected_psnr) < float(near.known_speed_psnr)
    scene = Scene([-700.0 - 60.0 / float(MOTION.exposure), 250.0], **light)
    shutter, metrics = TukeyShutter(0.6), evaluate(scene, MOTION, TukeyShutter(0.6))
    told, untold = float(metrics.known_speed_psnr), float(metrics.expected_psnr)
    assert float(metrics.found_speed_psnr) == pytest.approx(untold + 0.8 * (told - untold))
    for share in (0.0, 0.35, 0.8, 1.0):
        level = untold + share * (told - untold)
        loss = float(FoundSpeedLoss(share)(scene, MOTION, shutter))
        assert loss == pytest.approx(10 ** (-level / 20) / 0.17, rel=1e-12)
    with pytest.raises(ValueError, match=r"must be from 0 to 1; got 1\.2"):
        FoundSpeedLoss(1.2)


def test_smear_counts_while_the_shutter_is_open():
    """Dark ends of an exposure, and a device that passes a part of the light, change nothing."""
    scene = Scene([-700.0, 250.0, -900.0], [0.4, 0.6, 0.0], photon_rate=2e5, read_noise=4.0)
    device = IdealDevice(transmission=0.4)
    dim = Scene([-700.0, 250.0], photon_rate=2e5, read_noise=4.0, device=device)
    cameras = [(scene, 0.01, 1.0), (scene, 0.02, 0.5), (dim, 0.02, 0.2), (dim, 0.01, 1.0)]
    for place, half, efficiency in cameras:
        time = open_time(place, np.asarray(half), np.asarray(efficiency))
        difference = smear_difference(place.speeds, place.weights, time)
        assert float(difference) == pytest.approx(0.02 * 450)


@pytest.mark.parametrize("loss", [FoundSpeedLoss(), ExpectedErrorLoss(alignment="free")])
def test_losses_of_pictures_that_move_as_a_whole_refuse_a_background(loss):
    """One speed is no picture's there, and speeds have no places of their own."""
    layers = Occlusion(front_share=0.4, object_width=70.0)
    scene = Scene([-700.0, 250.0], photon_rate=2e5, read_noise=4.0, occlusion=layers)
    text = r"`scene` must move as a whole for .*; got objects in front of a background\."
    with pytest.raises(ValueError, match=text) as caught:
        loss(scene, MOTION, TukeyShutter(0.6))
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("tolerances", [None, Tolerances(acceleration=0.04, speed=60.0)])
def test_errors_of_speeds_have_the_expected_error_for_a_mean(tolerances):
    """By the scene's weights; the worst of those that occur is the loss, smoothed from above."""
    light = {"photon_rate": 2e5, "read_noise": 4.0, "picture": Texture(deviation=0.17)}
    speeds, weights = [-700.0, 250.0, 1900.0, 9000.0], [3.0, 2.0, 1.0, 0.0]
    scene = Scene(speeds, weights, **light, tolerances=tolerances)
    view = sampled_view(scene, MOTION, TukeyShutter(0.6), ONLY_SPECTRA, sizes(scene, MOTION))
    parts = view.scene, view.motion, compute_response(view)
    errors = LinearErrors(*parts).unknown_by_speed
    mean = float(jnp.sum(view.scene.weights * errors))
    assert mean == pytest.approx(float(LinearErrors(*parts).unknown), rel=1e-12)
    worst = float(jnp.max(errors[:3]))
    assert float(errors[3]) > worst
    loss = float(WorstSpeedLoss()(scene, MOTION, TukeyShutter(0.6)))
    assert 1 - 1e-9 <= loss / (worst**0.5 / 0.17) <= 3 ** (1 / 2000)
    if tolerances is None:
        level = float(evaluate(scene, MOTION, TukeyShutter(0.6)).worst_speed_psnr)
        assert level == pytest.approx(-10 * np.log10(worst), abs=1e-9)


def test_the_worst_speed_is_one_that_occurs():
    """A weight of 0 leaves a speed out, however bad, also where nothing is left out."""
    light = {"photon_rate": 2e5, "read_noise": 4.0}
    never = Scene([-700.0, 250.0, 9000.0], [0.6, 0.4, 0.0], **light)
    scene = Scene([-700.0, 250.0], [0.6, 0.4], **light)
    loss, shutter = WorstSpeedLoss(), TukeyShutter(0.6)
    for by in (sizes(never, MOTION), None):
        values = [float(value_of(loss, each, MOTION, shutter, by)) for each in (never, scene)]
        assert values[0] == pytest.approx(values[1], rel=1e-9)
    dark = Scene([-700.0, 250.0], [0.6, 0.4], photon_rate=0.0, read_noise=0.0)
    assert float(loss(dark, MOTION, shutter)) == pytest.approx(1.0, rel=1e-3)
    assert float(loss(dark, MOTION, shutter)) >= float(ExpectedErrorLoss()(dark, MOTION, shutter))


def test_a_spectral_zero_counts_as_the_working_precision():
    """Of the largest response, and so does a response that is nothing but zeros."""
    eps = np.finfo(float).eps
    smooth = float(smooth_condition_number(jnp.fft.rfft(jnp.ones(4), 8)))
    assert 1 / eps <= smooth * (1 + 1e-12) <= 5 ** (1 / 200) / eps * (1 + 1e-9)
    assert float(smooth_condition_number(jnp.zeros(5, complex))) == 1 / eps


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.5, 0.01, 1e-6])
@pytest.mark.parametrize("slug", LOSSES)
def test_dimming_the_shutter_gains_nothing(slug, share):
    """A loss rises, or stays, when every transmittance is scaled down."""
    loss = LOSSES[slug]
    bright = value_of(loss, SCENE, MOTION, ChippedShutter(PROFILE), SMALL)
    dim = value_of(loss, SCENE, MOTION, ChippedShutter(share * PROFILE), SMALL)
    assert float(dim) > float(bright)


def test_condition_and_invariance_do_not_see_the_scale():
    """The first two terms are those of the open shutter, however dim it is made."""
    loss = DesignLoss(condition=0.3, invariance=1.0, efficiency=0.0)
    values = [
        float(value_of(loss, SCENE, MOTION, ChippedShutter(share * PROFILE), SMALL))
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
        return value_of(loss, SCENE, motion, SplineShutter(x[2:]), SMALL)

    point = jnp.concatenate([jnp.array([1.03, 0.97]), jnp.asarray(PROFILE) * 0.9 + 0.03])
    of_both = jax.jit(jax.value_and_grad(value))
    gradient = of_both(point)[1]
    for index in range(point.size):
        step = jnp.zeros_like(point).at[index].set(1e-5)
        difference = (of_both(point + step)[0] - of_both(point - step)[0]) / 2e-5
        assert np.isclose(gradient[index], difference, rtol=2e-6, atol=2e-8)


KINDS = ["design", "expected_error", "found_speed"]
"""A loss of kernels, one of spectra, and one of spectra and smear."""


@pytest.mark.slow
@pytest.mark.parametrize("slug", KINDS)
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
    first, second, *_ = LOSSES.values()
    combined = 0.25 * first + second * 3.0
    shutter = TukeyShutter(0.6)
    given = SCENE, MOTION, shutter, SMALL
    expected = 0.25 * value_of(first, *given) + 3.0 * value_of(second, *given)
    assert np.isclose(value_of(combined, *given), expected, rtol=1e-14)
    doubled = 2.0 * combined + second
    expected = 2.0 * expected + value_of(second, *given)
    assert np.isclose(value_of(doubled, *given), expected, rtol=1e-14)
    assert sum([0.25 * first, second * 3.0]) == combined
    with pytest.raises(TypeError, match="unsupported operand"):
        1 + first


def test_a_sum_without_any_weight_is_nothing():
    """One of its terms is left."""
    first, second, *_ = LOSSES.values()
    assert float((0.0 * first + second * 0.0)(SCENE, MOTION, RectShutter())) == 0


def test_a_weight_of_zero_leaves_its_term_out():
    """Efficiency alone is the light that is lost."""
    loss = DesignLoss(condition=0.0, invariance=0.0, efficiency=1.0)
    shutter = TukeyShutter(0.6)
    assert np.isclose(value_of(loss, SCENE, MOTION, shutter, SMALL), 1 - shutter.efficiency())


def test_a_weight_may_be_a_scalar_array():
    """The number that it holds is the weight."""
    for weight in (np.float32(0.5), np.array(0.5), jnp.asarray(0.5)):
        assert DesignLoss(condition=weight) == DesignLoss(condition=0.5)


@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf"), "1", np.array(-0.5)])
def test_weights_out_of_range_are_refused(weight):
    """A weight is a finite number of at least 0."""
    with pytest.raises((ValueError, TypeError), match="condition"):
        DesignLoss(condition=weight)


@pytest.mark.slow
def test_a_closed_shutter_is_finite_and_bad():
    """A closed shutter is worse than any open one, with a finite gradient."""
    for loss in LOSSES.values():
        value, gradient = jax.value_and_grad(
            lambda chips, loss=loss: value_of(loss, SCENE, MOTION, ChippedShutter(chips), SMALL)
        )(jnp.zeros(4))
        assert np.isfinite(value)
        assert np.all(np.isfinite(gradient))
        assert float(value) > float(value_of(loss, SCENE, MOTION, RectShutter(), SMALL))


def test_a_loss_of_ones_own_is_one_small_class():
    """A class with a call composes with the package's losses."""

    class Darkness(AbstractLoss):
        def __call__(self, scene, motion, shutter):
            return 1 - shutter.efficiency()

    loss = Darkness() + 2.0 * Darkness()
    assert np.isclose(loss(SCENE, MOTION, TukeyShutter(0.5)), 0.75)


def test_losses_subtract_and_are_divided():
    """As they add and take factors: each is a weighted sum."""
    error, design = LOSSES["expected_error"], LOSSES["design"]
    shutter = TukeyShutter(0.5)
    x, y = (float(value_of(loss, SCENE, MOTION, shutter, SMALL)) for loss in (error, design))
    for loss, value in ((-error, -x), (error - 0.3 * design, x - 0.3 * y), (design / 4, y / 4)):
        assert np.isclose(value_of(loss, SCENE, MOTION, shutter, SMALL), value, rtol=1e-14)


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


@pytest.mark.slow
def test_a_loss_of_ones_own_takes_a_scene_a_motion_and_a_shutter():
    """A class of it, or a function; also in a sum and in a search, which hands out no plan."""

    class Dark(AbstractLoss):
        def __call__(self, scene, motion, shutter):
            return 1 - shutter.efficiency()

    class WithOptions(AbstractLoss):
        def __call__(self, scene, motion, shutter, *, plan=None, **options):
            assert plan is None
            assert not options
            return 1 - shutter.efficiency()

    def closed(scene, motion, shutter):
        return 1 - shutter.efficiency()

    given = SCENE, MOTION, TukeyShutter(0.5)
    both = Dark() + WithOptions()
    assert np.isclose(value_of(both, *given, SMALL), 0.5)
    options = {"free": "shutter", "num_starts": 2, "max_steps": 20}
    for loss in (Dark(), both, closed):
        assert optimise(*given, loss=loss, **options).loss < 1e-3
    assert plan(*given, loss=closed).sizes.num_taps > 1
    with pytest.raises(ValueError, match=r"must be a loss or a function of scene, "):
        optimise(*given, loss=ExpectedErrorLoss)


def test_what_is_no_loss_is_named_wherever_it_is_computed():
    """Within a sum and by a plan too, by the class that gave it."""

    class Many(AbstractLoss):
        def __call__(self, scene, motion, shutter):
            return jnp.ones(3)

    line = "`Many.__call__` must give one real number; got 'float64 of shape "
    with pytest.raises(ValueError, match=line):
        (ExpectedErrorLoss() + Many())(SCENE, MOTION, RectShutter())
    with pytest.raises(ValueError, match=line):
        plan_error(SMALL, SCENE, MOTION, RectShutter(), loss=Many())


def _by_motion(loss, scene, shutter, plan=None):
    """A loss of the acceleration and half exposure, as a function of an array of the two."""

    def value(point):
        motion = ParabolicMotion(acceleration=point[0], half_exposure=point[1])
        return value_of(loss, scene, motion, shutter, plan)

    return value


_TUKEY = TukeyShutter(0.4)
_OTHERS = {
    "rect": (RectShutter(), np.float64),
    "spline": (SplineShutter(PROFILE), np.float64),
    "float32": (_TUKEY, np.float32),
}
every_loss_and_shutter = pytest.mark.parametrize(
    ("slug", "shutter", "dtype"),
    [
        *(pytest.param(slug, _TUKEY, np.float64, id=slug) for slug in LOSSES),
        *(
            pytest.param(slug, *others, id=f"{slug}, {name}")
            for slug in ("design", "expected_error")
            for name, others in _OTHERS.items()
        ),
    ],
)
"""Every loss by one shutter; one of kernels and one of spectra by the others and in float32."""


@pytest.mark.slow
@every_loss_and_shutter
def test_a_traced_sensor_without_acceleration_is_a_still_camera(slug, shutter, dtype):
    """Aligned at mid-exposure, with the slope by exposure of one that is known to be still."""
    scene = Scene(np.array([-1900.0, 0.0, 700.0], dtype), photon_rate=1e5, read_noise=10.0)
    shutter = jax.tree.map(lambda x: x.astype(dtype), shutter)
    traced = _by_motion(LOSSES[slug], scene, shutter, SMALL)

    def known(half_exposure):
        return value_of(
            LOSSES[slug], scene, StillCamera(half_exposure=half_exposure), shutter, SMALL
        )

    half = np.asarray(1.3e-2, dtype)
    expected = jax.jit(jax.value_and_grad(known))(half)
    found = jax.jit(jax.vmap(jax.value_and_grad(traced)))
    # The last is the longest stroke that has no square in the precision.
    strokes = np.array([0.0, 1e-300, np.finfo(dtype).tiny], dtype)
    points = np.stack([strokes / half**2, np.full_like(strokes, half)], axis=1)
    values, slopes = found(points)
    rounding = 1e-11 if dtype is np.float64 else 2e-5
    np.testing.assert_allclose(values, np.full(3, expected[0]), rtol=rounding)
    largest = max(abs(float(expected[1])), float(expected[0] / half))
    np.testing.assert_allclose(slopes[:, 1], np.full(3, expected[1]), atol=rounding * largest)
    assert np.all(np.isfinite(slopes))


@pytest.mark.slow
@every_loss_and_shutter
def test_a_scene_at_rest_does_not_see_a_short_stroke(slug, shutter, dtype):
    """Its loss is one for all strokes from 0 on, with no slope, whoever traces the motion."""
    scene = Scene(np.zeros(2, dtype), photon_rate=1e5, read_noise=10.0)
    shutter = jax.tree.map(lambda x: x.astype(dtype), shutter)
    value, half = _by_motion(LOSSES[slug], scene, shutter, SMALL), dtype(1e-2)
    strokes = np.array([0.0, 1e-310, 1e-200, 1e-131, 1e-100, 1e-20, 1e-12])
    points = np.stack([strokes / 1e-4, np.full_like(strokes, half)], axis=1).astype(dtype)
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(value)))(points)
    known = value(points[0])
    rounding = 1e-12 if dtype is np.float64 else 1e-6
    np.testing.assert_allclose(values, np.full(strokes.size, known), rtol=rounding)
    assert np.all(np.abs(slopes[:, 0]) <= 1e-6 * values * half**2)
    assert np.all(np.isfinite(slopes))
    assert float(known) < 2


SLOW = ParabolicMotion(acceleration=2.0 / 1e-4, half_exposure=1e-2)
"""Its fastest object, of SCENE, is aligned some 60 times as far away as it travels itself."""
LIMITED = Scene(SCENE.speeds, photon_rate=1e5, read_noise=10.0, limits=Limits(max_stroke=4.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("loss", "used"),
    [
        (ExpectedErrorLoss(), "nodes"),
        (DesignLoss(condition=1.0, invariance=0.0), "taps at rest"),
        (DesignLoss(condition=0.0, invariance=0.0), "light"),
    ],
)
def test_a_traced_motion_is_not_refused_for_taps_that_a_loss_does_not_use(loss, used):
    """Slower than its fastest object it has the value and slope of a motion that is known."""
    at = jnp.array([SLOW.acceleration, SLOW.half_exposure])
    value = _by_motion(loss, LIMITED, TukeyShutter(0.4))
    for traced, known in zip(
        jax.jit(jax.value_and_grad(value))(at), jax.value_and_grad(value)(at), strict=True
    ):
        np.testing.assert_allclose(traced, known, rtol=1e-9)
    with pytest.raises(RuntimeError, match="must keep light within 20 px of where it is aligned"):
        eqx.filter_jit(_by_motion(DesignLoss(), LIMITED, TukeyShutter(0.4)))(at)


@pytest.mark.parametrize(
    ("loss", "factor", "line"),
    [
        (ExpectedErrorLoss(), 40, "be passed at no more than 36 px per half exposure where"),
        (DesignLoss(condition=1.0, invariance=0.0), 40, "keep light within 20 px of where"),
    ],
)
def test_a_traced_motion_is_refused_for_what_a_loss_uses(loss, factor, line):
    """In one line, when it is run."""
    at = jnp.array([SLOW.acceleration * factor, SLOW.half_exposure])
    with pytest.raises(RuntimeError, match=line):
        eqx.filter_jit(_by_motion(loss, LIMITED, TukeyShutter(0.4)))(at)


@pytest.mark.slow
@pytest.mark.parametrize("slug", KINDS)
def test_a_traced_motion_is_shared_out_over_devices(slug):
    """`jax.shard_map` of a loss and its slopes changes nothing, and is refused as well."""
    batch = jax.vmap(jax.value_and_grad(_by_motion(LOSSES[slug], SCENE, TukeyShutter(0.4))))
    mesh = jax.make_mesh((1,), ("design",), axis_types=(jax.sharding.AxisType.Auto,))
    along = jax.sharding.PartitionSpec("design")
    shared = jax.jit(jax.shard_map(batch, mesh=mesh, in_specs=along, out_specs=along))
    points = jnp.array([[22.0 / 1e-4, 1e-2], [18.0 / 1e-4, 1.1e-2]])
    for one, other in zip(shared(points), jax.jit(batch)(points), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    with pytest.raises((RuntimeError, ValueError), match=r"`motion` must (be passed|keep light)"):
        jax.block_until_ready(shared(points.at[1, 0].mul(100.0)))


@pytest.mark.slow
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
            return value_of(ExpectedErrorLoss(), scene, motion, TukeyShutter(of[2]), SMALL)

        return jax.value_and_grad(error)(jnp.asarray([1.1, 0.9, 0.3], dtype))

    value, slopes = value_and_slopes(np.float64)
    single, single_slopes = value_and_slopes(np.float32)
    assert value > 0
    assert np.isclose(single, value, rtol=1e-5)
    np.testing.assert_allclose(single_slopes, slopes, rtol=1e-4, atol=1e-6 * value)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_loss_has_one_value(seed):
    """That of a design is the loss called on it, planned or in full, whatever the motion.

    Objects that no motion of the space keeps up with ask a search for longer kernels than they
    ask of the design; a camera at rest and the speeds of a scene ask for others again.
    """
    random = np.random.default_rng(seed)
    stroke, fastest = random.uniform(5, 30), random.uniform(3000, 9000)
    limits = Limits(max_stroke=stroke, max_top_speed=4000.0, max_half_exposure=0.03)
    scene = Scene(
        fastest * random.uniform(-1, 1, 3), photon_rate=1e5, read_noise=5.0, limits=limits
    )
    half = random.uniform(0.002, 0.02)
    motion = ParabolicMotion(
        acceleration=random.uniform(0.3, 1) * stroke / half**2, half_exposure=half
    )
    motion = StillCamera(half_exposure=half) if seed else motion
    loss = DesignLoss(condition=random.uniform(0.1, 1))
    design = optimise(scene, motion, TukeyShutter(0.4), loss=loss, num_starts=2, max_steps=4)
    given = scene, design.motion, design.shutter
    for by in (None, sizes(scene, design.motion), plan(*given, loss=loss).sizes):
        value = float(value_of(loss, *given, by))
        assert value == pytest.approx(design.loss, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("num_taps", [100, 1024, 1025, 3000])
def test_a_long_kernel_is_folded_onto_its_transform(num_taps):
    """Which has every sample of the spectrum that a longer one has there."""
    kernel = np.random.default_rng(0).uniform(0, 1, num_taps)
    plan_of_loss = Plan(num_taps, 4096, 64, 64, loss_dft_length=1024)
    whole = np.exp(-2j * np.pi * np.outer(np.arange(513), np.arange(num_taps)) / 1024)
    spectrum = np.fft.rfft(*folded(jnp.asarray(kernel), plan_of_loss))
    np.testing.assert_allclose(spectrum, whole @ kernel, atol=1e-9)


@pytest.mark.slow
def test_memory_of_many_designs():
    """17,000 designs at 5 speeds on the default limits stay within 4 GiB.

    Forward and reverse mode take at most 2 MiB a design.
    """
    scene = Scene.uniform(max_speed=2000.0, num_speeds=5, photon_rate=1e5, read_noise=4.0)

    def loss(chips):
        return ExpectedErrorLoss()(scene, scene.motion, ChippedShutter(chips))

    def memory(function, num_designs):
        chips = jax.ShapeDtypeStruct((num_designs, 12), float)
        return jax.jit(function).lower(chips).compile().memory_analysis().temp_size_in_bytes

    assert memory(jax.vmap(loss), 17_000) < 3.5 * 2**30
    assert memory(jax.vmap(jax.grad(loss)), 1000) < 1000 * 2**21
    assert memory(lambda x: jax.jvp(jax.vmap(loss), (x,), (x,)), 1000) < 1000 * 2**21


@pytest.mark.slow
def test_the_hessian_of_a_loss_of_kernels_and_spectra_by_the_motion():
    """Symmetric, and what differences of the gradient give, in natural units."""
    loss = DesignLoss() + 0.3 * ExpectedErrorLoss()

    def of_motion(x):
        motion = ParabolicMotion(
            acceleration=2.3e5 * (1 + x[0]), half_exposure=5.1e-3 * (1 + x[1]), velocity=1e3 * x[2]
        )
        return loss(SCENE, motion, TukeyShutter(0.4))

    point, slope = jnp.array([0.0, 0.0, 0.03]), jax.jit(jax.grad(of_motion))
    wide, narrow = (
        np.stack([slope(point + x) - slope(point - x) for x in h * jnp.eye(3)]) / (2 * h)
        for h in (2e-4, 1e-4)
    )
    differences = (4 * narrow - wide) / 3
    largest = np.max(np.abs(differences))
    found = np.asarray(jax.jit(jax.hessian(of_motion))(point))
    np.testing.assert_allclose(found, differences, atol=1e-6 * largest)
    np.testing.assert_allclose(found, found.T, atol=1e-10 * largest)
