"""A sensor that pans sees every speed less its velocity, and nothing else changes.

Each result on a motion with a velocity is held to that on the motion without it, of a scene
whose speeds the test has shifted, and each derivative by the velocity also to a difference.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import LIMITS, SMALL
from support.plan_check import metrics_by, plan_for

from mishutter import (
    DesignLoss,
    ExpectedErrorLoss,
    Limits,
    LinearMotion,
    ParabolicMotion,
    Scene,
    TukeyShutter,
    evaluate,
)
from mishutter.evaluation.losses import value_of

# A search's loss at one point; a design holds only that of its minimum.
from mishutter.search.objective import SpectralObjective
from mishutter.search.space import design_space

RELATIVE = {np.float64: 1e-11, np.float32: 2e-5}
"""Two ways to round the same speeds, carried through a loss or a metric."""
BY_DIFFERENCE = 2e-6
"""Central differences of a loss in float64."""

HALF = 0.0113
SPEEDS = np.array([-1300.0, 240.0, 700.0, 1900.0])
WEIGHTS = np.array([0.1, 0.4, 0.3, 0.2])
PARABOLA = partial(ParabolicMotion, acceleration=19.0 / HALF**2, half_exposure=HALF)
LINE = partial(LinearMotion, half_exposure=HALF)
PARKED = partial(ParabolicMotion, acceleration=0.0, half_exposure=HALF)
KINDS = {"parabola": PARABOLA, "line": LINE, "parabola without acceleration": PARKED}
LOSSES = {
    "design": DesignLoss(condition=0.1, invariance=0.7, efficiency=0.9),
    "expected error": ExpectedErrorLoss(),
}
VELOCITIES = [0.0, 413.0, -2600.0, 7e6]
DTYPES = {"float64": np.float64, "float32": np.float32}


def scene(speeds=SPEEDS):
    """A scene of the given speeds, in their precision."""
    cast = np.asarray(speeds).dtype.type if isinstance(speeds, np.ndarray) else jnp.asarray
    numbers = {"photon_rate": 2e5, "read_noise": 5.0}
    numbers = {k: cast(v) for k, v in numbers.items()}
    return Scene(speeds, WEIGHTS.astype(speeds.dtype), limits=LIMITS, **numbers)


def in_precision(motion, dtype):
    """The motion with numbers of a precision."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), motion)


def assert_alike(first, second, dtype):
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True):
        assert one.dtype == dtype
        np.testing.assert_allclose(one, other, rtol=RELATIVE[dtype], atol=RELATIVE[dtype])


@pytest.mark.slow
@pytest.mark.parametrize("precision", DTYPES)
@pytest.mark.parametrize("velocity", VELOCITIES)
@pytest.mark.parametrize("kind", KINDS)
def test_metrics_and_losses_are_those_of_shifted_speeds(kind, velocity, precision):
    """Of every kind of motion, with velocities of either sign and beyond any limit."""
    dtype = DTYPES[precision]
    shifted = SPEEDS.astype(dtype)
    moved = shifted + dtype(velocity)
    shifted = moved - dtype(velocity)
    shutter = TukeyShutter(jnp.asarray(0.37, dtype))
    panning = in_precision(KINDS[kind](velocity=velocity), dtype)
    still = in_precision(KINDS[kind](), dtype)
    for measure in (evaluate, partial(metrics_by, None)):
        found = measure(scene(moved), panning, shutter)
        assert_alike(found, measure(scene(shifted), still, shutter), dtype)
    for loss in LOSSES.values():
        found = loss(scene(moved), panning, shutter)
        assert_alike(found, loss(scene(shifted), still, shutter), dtype)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slug", "kind"), [("design", "parabola"), ("design", "line"), ("expected error", "parabola")]
)
def test_gradients_are_those_of_shifted_speeds(slug, kind):
    """By acceleration, exposure, shutter, speeds and velocity, with all of them traced."""
    loss, make = LOSSES[slug], KINDS[kind]

    def value(x, speeds, velocity):
        motion = make(velocity=velocity, half_exposure=HALF * x[0])
        if kind == "parabola":
            motion = eqx.tree_at(lambda m: m.acceleration, motion, motion.acceleration * x[1])
        return value_of(loss, scene(speeds), motion, TukeyShutter(x[2]), SMALL)

    x, velocity = jnp.array([0.97, 1.04, 0.37]), jnp.asarray(413.0)
    of_all = jax.jit(jax.value_and_grad(value, argnums=(0, 1, 2)))
    found, (by_x, by_speeds, by_velocity) = of_all(x, jnp.asarray(SPEEDS), velocity)
    expected, (x_slope, speed_slope, _) = of_all(x, jnp.asarray(SPEEDS - 413.0), jnp.zeros(()))
    assert_alike((found, by_x, by_speeds), (expected, x_slope, speed_slope), np.float64)
    np.testing.assert_allclose(by_velocity, -jnp.sum(speed_slope), rtol=1e-9)

    step = 1e-2
    ends = (of_all(x, jnp.asarray(SPEEDS), velocity + side * step)[0] for side in (1, -1))
    difference = (next(ends) - next(ends)) / (2 * step)
    np.testing.assert_allclose(by_velocity, difference, rtol=BY_DIFFERENCE, atol=1e-12)
    assert by_velocity != 0

    def along(velocity):
        return value(x, jnp.asarray(SPEEDS), velocity)

    np.testing.assert_allclose(jax.jacfwd(along)(velocity), by_velocity, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("slug", LOSSES)
def test_a_gradient_by_velocity_alone_with_a_plan_of_its_own(slug):
    """Of a known scene, plain and under `jit`, against a difference; in both precisions."""
    loss = LOSSES[slug]
    for dtype in DTYPES.values():
        motion = in_precision(PARABOLA(), dtype)
        there = scene(SPEEDS.astype(dtype))

        def value(velocity, motion=motion, there=there, dtype=dtype):
            panning = eqx.tree_at(lambda m: m.velocity, motion, velocity)
            return loss(there, panning, TukeyShutter(jnp.asarray(0.37, dtype)))

        slope = jax.grad(value)(jnp.asarray(413.0, dtype))
        assert slope.dtype == dtype
        if dtype is np.float64:
            difference = (value(413.01) - value(412.99)) / 0.02
            np.testing.assert_allclose(slope, difference, rtol=BY_DIFFERENCE)
            exact = slope
        np.testing.assert_allclose(slope, exact, rtol=3e-3)
        traced = jax.jit(jax.value_and_grad(value))(jnp.asarray(413.0, dtype))
        assert np.all(np.isfinite(traced))


@pytest.mark.slow
def test_velocities_in_a_batch():
    """Metrics and losses `vmap` over velocities, of zero, far and all but equal to a speed."""
    velocities = jnp.array([0.0, 413.0, -2600.0, 700.0, 700.0 * (1 + 1e-15)])

    def both(velocity):
        given = scene(), PARABOLA(velocity=velocity), TukeyShutter(0.37)
        losses = [value_of(loss, *given, SMALL) for loss in LOSSES.values()]
        return losses, evaluate(*given)

    batch = jax.vmap(both)(velocities)
    for index, velocity in enumerate(velocities):
        one = jax.tree.map(lambda x, i=index: x[i], batch)
        assert_alike(one, both(velocity), np.float64)


def test_the_loss_of_a_search_is_that_of_shifted_speeds():
    """Whatever part of it is computed from spectra that were written down before."""
    losses = []
    for speeds, velocity in ((SPEEDS, 413.0), (SPEEDS - 413.0, 0.0)):
        seen, motion = scene(speeds), PARABOLA(velocity=velocity)
        space = design_space(seen, motion, TukeyShutter(0.37), "half_exposure")
        objective = SpectralObjective(LOSSES["expected error"], seen, space, None, SMALL)
        losses.append(np.asarray(objective(space.point_of(space.shutter, motion))))
    np.testing.assert_allclose(*losses, rtol=1e-12)


def test_plans_are_those_of_shifted_speeds():
    """A plan is as large as the speeds over the sensor ask for, not those of the objects."""
    far = scene(SPEEDS + 2**20)
    found = plan_for(far, PARABOLA(velocity=2.0**20), TukeyShutter(0.37))
    assert found == plan_for(scene(), PARABOLA(), TukeyShutter(0.37))


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("kind", ["parabola", "line"])
def test_a_velocity_that_is_no_number_is_refused(kind, wrong):
    """By the name of the motion and of the argument; so is one that is a row."""
    name = "ParabolicMotion" if kind == "parabola" else "LinearMotion"
    with pytest.raises(ValueError, match=rf"`{name}\(velocity=...\)` must be finite; got "):
        KINDS[kind](velocity=wrong)
    with pytest.raises(ValueError, match=rf"`{name}\(velocity=...\)` must be (a|one) "):
        KINDS[kind](velocity=np.ones(2))


def test_the_largest_pan():
    """It is the top speed unless it is given, may be 0, and bounds the fullest motion."""
    assert float(Limits(max_top_speed=321.0).max_pan) == 321
    for most, velocity in ((0.0, 0.0), (77.0, 77.0), (1e4, 160.5)):
        limits = Limits(max_top_speed=321.0, max_pan=most)
        for sign in (1, -1):
            motion = limits.fullest_motion(sign * 1e6)
            assert float(motion.velocity) == sign * velocity
            assert float(motion.top_speed) <= 321 * (1 + 1e-12)
            assert float(motion.stroke) <= float(limits.max_stroke) * (1 + 1e-12)
    for wrong, message in ((-1.0, "at least 0"), (float("nan"), "finite")):
        with pytest.raises(ValueError, match=rf"`Limits\(max_pan=...\)` must be {message}; got "):
            Limits(max_pan=wrong)
