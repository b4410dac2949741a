"""The kernel against the slow evaluation of every piece at every tap, for every shutter."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.cases import SHUTTERS
from support.dense_kernel import exposure, unit_edges
from support.helpers import (
    FORWARD_AGAINST_REVERSE,
    NUM_TAPS,
    TAP_OF_LARGEST,
    TAP_RELATIVE,
    random_point,
)

from mishutter import ParabolicMotion, binned_exposure, blur_kernel
from mishutter._core import DoubleWord, two_sum

NUM_POINTS = 25


@partial(jax.jit, static_argnums=(0, 1))
def both(make, frame, parameters, a, T, s, v, positions):
    """Taps of the package, and of the dense evaluation."""
    shutter = make(parameters)
    motion = ParabolicMotion(acceleration=a, half_exposure=T, velocity=v)
    if frame == "vertex":
        first = positions[0]
        taps = blur_kernel(shutter, motion, speed=s, num_taps=NUM_TAPS, phase=first)
        edges = unit_edges(first, NUM_TAPS)
    else:
        taps = binned_exposure(shutter, motion, speed=s, edges=positions)
        edges = DoubleWord(positions, jnp.zeros_like(positions))
    relative = two_sum(s, -v)
    return taps, exposure(shutter, a, T, relative, edges, from_vertex=frame == "vertex")


@pytest.mark.slow
@pytest.mark.parametrize("slug", SHUTTERS)
def test_taps_are_those_of_the_dense_evaluation(slug):
    """Within the tolerances of either, over the domain."""
    rng = np.random.default_rng(29)
    for _ in range(NUM_POINTS):
        point = random_point(rng, np.float64, slug)
        if point.is_at_rest:  # where the dense evaluation divides by nothing
            continue
        motion = point.acceleration, point.half_exposure, point.speed, point.velocity
        make, parameters = SHUTTERS[slug].make, SHUTTERS[slug].parameters
        taps, expected = map(np.asarray, both(make, point.frame, parameters, *motion, point.taps))
        allowed = TAP_RELATIVE[np.float64] * expected
        allowed = np.maximum(allowed, TAP_OF_LARGEST[np.float64] * expected.max())
        assert np.all(np.abs(taps - expected) <= 2 * allowed), point


@pytest.mark.slow
@pytest.mark.parametrize("slug", ["tukey", "chips"])
def test_forward_and_reverse_mode_agree(slug):
    """By motion, speed, velocity, edges and the shutter's parameters, batched over directions."""
    edges = jnp.linspace(-9.0, 60.0, 23)

    def taps(x, shift, parameters):
        motion = ParabolicMotion(acceleration=x[0], half_exposure=x[1], velocity=x[3])
        shutter = SHUTTERS[slug].make(parameters)
        return binned_exposure(shutter, motion, speed=x[2], edges=edges + shift)

    forward = jax.jit(jax.jacfwd(taps, argnums=(0, 1, 2)))
    reverse = jax.jit(jax.jacrev(taps, argnums=(0, 1, 2)))
    for speeds in ((0.0, 0.0), (57.0, 0.0), (-410.0, 0.0), (310.7, 253.1)):
        motion = jnp.array([310.0, 0.31, *speeds])
        point = motion, jnp.zeros(23), jnp.asarray(SHUTTERS[slug].parameters)
        for f, r in zip(forward(*point), reverse(*point), strict=True):
            allowed = FORWARD_AGAINST_REVERSE * np.max(np.abs(f))
            np.testing.assert_allclose(f, r, atol=allowed, err_msg=str(speeds))
