"""The quadrature over the exposure, for shutters whose pieces move, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter import TukeyShutter
from mishutter.blur.quadrature import lit_nodes

PHASE_PER_NODE = 1.6
"""Radians: a little less than a plan allows each node."""


def by_nodes(taper, turn, num_nodes, dtype=np.float64):
    """Half the integral of w cos(turn tau)."""
    nodes = lit_nodes(TukeyShutter(taper), num_nodes, np.dtype(dtype))
    return jnp.sum(nodes.light * jnp.cos(jnp.asarray(turn, dtype) * nodes.tau))


def closed_form(taper, turn):
    """The same: a rect of length 2 - taper, rounded by half a cosine of length taper."""
    x = taper * turn / np.pi
    rounding = np.pi / 4 if x == 1 else np.cos(np.pi * x / 2) / (1 - x**2)
    return np.sin(turn * (1 - taper / 2)) / turn * rounding


@pytest.mark.parametrize("num_nodes", [40, 64, 200, 1000, 1025])
@pytest.mark.parametrize("taper", [0.0, 1e-12, 0.01, 1 / 3, 0.5, 0.77, 1 - 1e-12, 1.0])
def test_a_shutter_whose_pieces_move(taper, num_nodes):
    """Panels that pieces share are as exact wherever the pieces end, also where one is empty."""
    for share in (1.0, 0.31):
        turn = share * PHASE_PER_NODE / 2 * (num_nodes - 12)
        assert float(by_nodes(taper, turn, num_nodes)) == pytest.approx(
            closed_form(taper, turn), abs=2e-14
        )


@pytest.mark.parametrize("taper", [0.1, 0.5, 0.93])
def test_derivative_by_the_taper(taper):
    """The derivative by what moves the pieces, against a difference of the closed form."""
    found = jax.grad(by_nodes)(taper, 90.0, 200)
    step = 1e-6
    difference = closed_form(taper + step, 90.0) - closed_form(taper - step, 90.0)
    assert float(found) == pytest.approx(difference / (2 * step), rel=1e-6, abs=1e-8)


def test_few_nodes_are_left_over():
    """Pieces of no matter which lengths together take little more than as many were asked for."""
    nodes = lit_nodes(TukeyShutter(0.3), 1024, np.dtype(np.float32))
    assert nodes.tau.dtype == nodes.light.dtype == np.float32
    assert nodes.tau.size < 1.2 * 1024
