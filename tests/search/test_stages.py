"""Searches within what a stage reaches from rest: every point of the box keeps its limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import LIMITS, MOTION, SCENE

from mishutter import Limits, ParabolicMotion, RectShutter, Scene, TukeyShutter, optimise
from mishutter.model.scene import in_sensor_frame

# Bounds of a search, and of a grid before anything on it is computed.
from mishutter.search.space import beyond_limits, design_space
from mishutter.sweeps.grid import REASONS, Frame, outside_limits

NUMBERS = {
    "max_stroke": 45.0,
    "max_top_speed": 2e4,
    "min_half_exposure": 5e-4,
    "max_half_exposure": 0.04,
}
STAGES = {
    "travel": {"max_travel": 41.0, "max_acceleration": 1.2e6},
    "jerk": {"max_travel": 41.0, "max_acceleration": 1.2e6, "max_jerk": 2e9},
}
FREE = {
    "all": (0.0, ("half_exposure", "velocity", "acceleration")),
    "held-pan": (500.0, ("half_exposure", "acceleration")),
    "held-acceleration": (300.0, ("half_exposure",)),
}


def _scene(stage):
    limits = Limits(**NUMBERS, **stage)
    return Scene.uniform(
        max_speed=4500.0, num_speeds=5, photon_rate=1e5, read_noise=8.0, limits=limits
    )


@pytest.mark.slow
@pytest.mark.parametrize("free", FREE.values(), ids=FREE)
@pytest.mark.parametrize("stage", STAGES.values(), ids=STAGES)
def test_every_design_is_within_the_stage(stage, free):
    """At corners and inside, some use all of it, and slopes are those of differences."""
    scene, (velocity, names) = _scene(stage), free
    motion = ParabolicMotion(acceleration=2e4, half_exposure=0.01, velocity=velocity)
    frame, start = (scene, motion) if "velocity" in names else in_sensor_frame(scene, motion)
    space = design_space(frame, start, RectShutter(), names)

    @jax.jit
    def numbers(point):
        found = space.at(point)[1]
        return jnp.stack([found.acceleration, found.half_exposure, found.velocity])

    random = np.random.default_rng(7)
    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * space.size), axis=-1).reshape(-1, space.size)
    boxes = np.concatenate([corners, random.uniform(size=(40, space.size))])
    shares = []
    for point in boxes:
        a, half, v = numbers(jnp.asarray(point))
        found = ParabolicMotion(acceleration=a, half_exposure=half, velocity=v)
        if "velocity" not in names:
            found = found.panned(velocity)
        assert not beyond_limits(scene, found, RectShutter())
        shares.append(float(scene.limits.stage_share(a, half, found.velocity)))
    assert max(shares) > 0.6
    slopes = np.asarray(jax.jacrev(numbers)(jnp.asarray(boxes[-1])))
    for index in range(space.size):
        step = 1e-6 * np.eye(space.size)[index]
        ends = (np.asarray(numbers(jnp.asarray(boxes[-1] + sign * step))) for sign in (1, -1))
        difference = np.subtract(*ends) / 2e-6
        scale = np.abs(difference).max() + 1e-9
        np.testing.assert_allclose(slopes[:, index], difference, atol=1e-6 * scale)


@pytest.mark.slow
def test_bends_are_where_another_limit_holds():
    """The largest acceleration has a kink at each bend of travel, acceleration and stroke."""
    scene = _scene(STAGES["travel"])
    motion = ParabolicMotion(acceleration=2e4, half_exposure=0.01)
    space = design_space(scene, motion, RectShutter(), ("half_exposure", "acceleration"))
    low, high = 5e-4, 0.04
    shares = np.linspace(0.001, 0.999, 1999)
    times = jnp.asarray(low * (high / low) ** shares)
    # Kinks lie in the bound itself; a box holds only shares of it.
    most = np.log(np.asarray(jax.vmap(lambda t: space._acceleration_bounds(t)[1])(times)))
    turns = np.abs(np.diff(most, 2))
    kinks = shares[1:-1][turns > 50 * np.median(turns) + 1e-4]
    assert kinks.size
    for kink in kinks:
        assert np.min(np.abs(space.bends.places - kink)) < 1e-3


@pytest.mark.slow
def test_a_design_within_a_stage():
    """The search ends within a stage that the design without one does not fit."""
    limits = {name: getattr(LIMITS, name) for name in NUMBERS}
    stage = Limits(**limits, max_travel=9.0, max_acceleration=6e5)
    speeds = np.asarray(SCENE.speeds)
    scene = Scene(speeds, photon_rate=1e5, read_noise=10.0, limits=stage)
    free = ("half_exposure", "acceleration")
    held = optimise(scene, MOTION, TukeyShutter(0.6), free=free)
    roomy = optimise(SCENE, MOTION, TukeyShutter(0.6), free=free)
    assert not beyond_limits(scene, held.motion, held.shutter)
    assert beyond_limits(scene, roomy.motion, roomy.shutter)
    assert held.loss > roomy.loss
    assert held.converged


def test_a_sweep_says_why_a_point_is_outside():
    """Travel and acceleration have bits of their own."""
    frame = Frame(_scene(STAGES["travel"]), 200.0)
    accelerations, halves = np.array([1e4, 5.9e5, 6.1e5]), np.array([2e-3, 1.2e-2])
    bits = outside_limits(frame, accelerations, halves)
    travel, acceleration = (1 << REASONS.index(name) for name in ("travel", "acceleration"))
    assert (bits & acceleration > 0).tolist() == [[False, False], [False, False], [True, True]]
    assert (bits & travel > 0).tolist() == [[False, False], [False, True], [False, True]]
