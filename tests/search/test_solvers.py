"""Losses and gradients of a search: right for every kind of shutter; windows share programs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import MOTION, SCENE, SMALL
from support.programs import compiled_programs

from mishutter import (
    ExpectedErrorLoss,
    GaussianShutter,
    HannShutter,
    RectShutter,
    SplineShutter,
    StillCamera,
    TukeyShutter,
)
from mishutter.evaluation.needs import needed_speeds

# Steps of the search, checked one by one; its face returns only a finished design.
from mishutter.search.objective import DesignObjective, SpectralObjective, objective_of
from mishutter.search.search import free_by_default
from mishutter.search.solvers import loss_and_gradient
from mishutter.search.space import design_space

STILL = StillCamera(half_exposure=float(np.sqrt(5e-4 * 0.03)))
DESIGNS = {
    "spline": (MOTION, SplineShutter.fit(TukeyShutter(0.45), 10, symmetric=True)),
    "Tukey": (MOTION, TukeyShutter(0.37)),
    "Gaussian": (MOTION, GaussianShutter(0.43)),
    "Hann": (MOTION, HannShutter()),
    "rect": (MOTION, RectShutter()),
    "at rest": (STILL, RectShutter()),
}


def _objectives(name):
    """The objective of a search and the loss of the design itself; size of their box."""
    motion, shutter = DESIGNS[name]
    space = design_space(SCENE, motion, shutter, free_by_default(SCENE, motion, shutter))
    scene, loss = needed_speeds(SCENE, MOTION, shutter), ExpectedErrorLoss()
    spectral = objective_of(loss, scene, space, SMALL)
    assert isinstance(spectral, SpectralObjective)
    return spectral, DesignObjective(loss, scene, space, SMALL), space.size


@pytest.mark.slow
@pytest.mark.parametrize("name", DESIGNS)
def test_a_gradient_by_spectra_is_that_of_the_loss(name):
    """Loss and gradient agree with those of the whole loss of each design, differentiated."""
    spectral, whole, size = _objectives(name)
    point = np.random.default_rng(11).uniform(0.15, 0.85, size)
    loss, gradient = loss_and_gradient(spectral, point)
    expected_loss, expected = jax.jit(jax.value_and_grad(whole))(jnp.asarray(point))
    assert np.isclose(loss, expected_loss, rtol=1e-12)
    assert np.allclose(gradient, expected, rtol=1e-9, atol=1e-11 * np.max(np.abs(expected)))


@pytest.mark.slow
def test_windows_that_are_held_share_a_program(caplog):
    """That of the loss by their quadrature nodes, which takes the longest to compile."""
    jax.clear_caches()
    with compiled_programs(caplog) as programs:
        for name in ("Hann", "rect"):
            spectral, _, size = _objectives(name)
            loss_and_gradient(spectral, np.full(size, 0.4))
    assert sum("loss_and_gradient" in name for name in programs) == 1
