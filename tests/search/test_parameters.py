"""Numbers without bounds are designs within the limits, and designs are numbers."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from mishutter import (
    DesignParameters,
    ExpectedErrorLoss,
    FirstOrderDevice,
    HannShutter,
    Limits,
    ParabolicMotion,
    Scene,
    SplineShutter,
    StillCamera,
    TukeyShutter,
)
from mishutter.search.space import beyond_limits

LIMITS = Limits(max_stroke=37.3, max_top_speed=5200.0, max_half_exposure=0.021, max_pan=910.0)
STAGE = Limits(
    max_stroke=37.3, max_half_exposure=0.021, max_travel=71.9, max_acceleration=7.1e5, max_pan=0.0
)
SPEEDS = [-310.0, 420.0, 1130.0]
PLAIN = Scene(SPEEDS, photon_rate=1.3e5, read_noise=4.1, limits=LIMITS)
SCENES = {
    "pans": PLAIN,
    "stage": Scene(SPEEDS, photon_rate=1.3e5, read_noise=4.1, limits=STAGE),
    "device": Scene(
        SPEEDS,
        photon_rate=1.3e5,
        read_noise=4.1,
        limits=LIMITS,
        device=FirstOrderDevice(rise_time=7e-4, fall_time=1.3e-3),
    ),
}
MOTION = ParabolicMotion(acceleration=1.1e5, half_exposure=0.0093, velocity=87.0)


@pytest.mark.parametrize("slug", SCENES)
def test_no_number_leaves_the_limits(slug):
    """However large, infinite too: stroke, speed, exposure, pan and the run-up of a stage hold."""
    parameters = DesignParameters(SCENES[slug], shutter=TukeyShutter(0.37))
    draws = np.random.default_rng(5).normal(0, 9, (24, parameters.size))
    design = eqx.filter_jit(parameters.design)
    for numbers in draws:
        motion, shutter = design(jnp.asarray(numbers))
        assert beyond_limits(SCENES[slug], motion, shutter) == ()
    ends = np.where(draws > 0, np.inf, -np.inf)
    motions = jax.vmap(lambda row: parameters.space.at(jax.nn.sigmoid(row))[1])(jnp.asarray(ends))
    assert np.all(np.isfinite([motions.half_exposure, motions.acceleration, motions.velocity]))


@pytest.mark.parametrize("free", [None, ("shutter", "acceleration"), "half_exposure"])
def test_a_design_is_its_numbers(free):
    """There and back, with a fixed pan or a free one: to rounding, in one form each."""
    parameters = DesignParameters(PLAIN, MOTION, SplineShutter([0.3, 0.8, 0.6, 0.9]), free=free)
    numbers = np.random.default_rng(6).normal(0, 2, parameters.size)
    motion, shutter = parameters.design(numbers)
    np.testing.assert_allclose(parameters.numbers(motion, shutter), numbers, rtol=1e-9)


def test_parts_that_are_not_free_stay():
    """The velocity and the exposure of the motion, and the shutter, are those that were given."""
    parameters = DesignParameters(PLAIN, MOTION, HannShutter(), free="acceleration")
    motion, shutter = parameters.design([0.7])
    assert float(motion.half_exposure) == pytest.approx(0.0093, rel=1e-12)
    assert float(motion.velocity) == 87.0
    assert shutter == HannShutter()
    assert motion.acceleration != MOTION.acceleration


def test_a_design_at_a_limit_begins_beside_it():
    """The fullest motion is at the end of its coordinate, a number that would be infinite."""
    fullest = ParabolicMotion.from_stroke(37.3, half_exposure=0.021)
    parameters = DesignParameters(PLAIN, fullest, HannShutter(), free="acceleration")
    assert 6.0 < float(parameters.start[0]) < 7.0
    motion, _ = parameters.design(parameters.start)
    assert 0.99 * 37.3 < float(motion.stroke) < 37.3


def test_numbers_are_differentiable():
    """Every number moves the design, under `jit` with the parameters as an argument."""
    parameters = DesignParameters(PLAIN, MOTION, TukeyShutter(0.37))

    @eqx.filter_jit
    @jax.grad
    def slopes(numbers):
        motion, shutter = parameters.design(numbers)
        return motion.stroke * shutter.efficiency() + motion.velocity

    assert np.all(np.abs(slopes(jnp.asarray([0.3, -0.4, 0.9, 0.2]))) > 1e-6)


@pytest.mark.slow
def test_a_loss_holds_every_design_of_the_box():
    """It is the loss of every design, of one that spreads light too far for a traced loss too."""
    limits = Limits(max_stroke=37.3, max_half_exposure=0.31)
    scene = Scene(SPEEDS, photon_rate=1.3e5, read_noise=4.1, limits=limits)
    free = ("half_exposure", "acceleration")
    parameters = DesignParameters(scene, MOTION, HannShutter(), free=free)
    compiled = jax.jit(parameters.loss())
    for numbers in ([-0.7, 0.4], [9.0, -9.0]):
        expected = ExpectedErrorLoss()(scene, *parameters.design(numbers))
        assert float(compiled(jnp.asarray(numbers))) == pytest.approx(float(expected), rel=1e-5)

    @jax.jit
    def by_itself(numbers):
        return ExpectedErrorLoss()(scene, *parameters.design(numbers))

    with pytest.raises(Exception, match="must spread light over at most"):
        by_itself(jnp.asarray([9.0, -9.0])).block_until_ready()


@pytest.mark.slow
def test_an_optimiser_without_bounds_ends_within_the_limits():
    """Steps of any size of optax lower a loss of one's own, and none leaves the limits."""
    parameters = DesignParameters(PLAIN, MOTION, TukeyShutter(0.37))

    def short(scene, motion, shutter):
        return ExpectedErrorLoss()(scene, motion, shutter) + 3.0 * motion.half_exposure

    value_and_slope = jax.jit(jax.value_and_grad(parameters.loss(short)))
    solver, numbers = optax.adam(0.9), parameters.start
    state, (first, _) = solver.init(numbers), value_and_slope(numbers)
    for _ in range(30):
        _, slope = value_and_slope(numbers)
        with jax.numpy_dtype_promotion("standard"):
            change, state = solver.update(slope, state)
        numbers = optax.apply_updates(numbers, change)
        assert beyond_limits(PLAIN, *parameters.design(numbers)) == ()
    assert value_and_slope(numbers)[0] < first - 0.01


WRONG = {
    "`DesignParameters.design(numbers=...)` must have shape (4,); got shape (3,)": lambda: (
        DesignParameters(PLAIN, MOTION, TukeyShutter(0.37)).design([0.1, 0.2, 0.3])
    ),
    "`DesignParameters.design(numbers=...)` must be finite; got nan": lambda: DesignParameters(
        PLAIN, MOTION, HannShutter(), free="acceleration"
    ).design([np.nan]),
    "`DesignParameters.numbers(shutter=...)` must be a TukeyShutter with 1 number": lambda: (
        DesignParameters(PLAIN, MOTION, TukeyShutter(0.37)).numbers(MOTION, HannShutter())
    ),
    "`DesignParameters(free=...)` must name some of": lambda: DesignParameters(PLAIN, free="taper"),
    "`DesignParameters(free=...)` must leave a still camera at rest": lambda: DesignParameters(
        PLAIN, StillCamera(half_exposure=0.003), free="acceleration"
    ),
    "`DesignParameters(shutter=...)` must have parameters": lambda: DesignParameters(
        PLAIN, MOTION, HannShutter(), free="shutter"
    ),
}


@pytest.mark.parametrize("message", WRONG)
def test_what_is_no_design_is_refused(message):
    """One line names the argument, what must hold and what came."""
    with pytest.raises(ValueError, match=re.escape(message)):
        WRONG[message]()
