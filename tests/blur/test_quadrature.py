"""The quadrature over the exposure, for shutters whose pieces move, against closed forms."""

import itertools
from fractions import Fraction
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.cases import SHUTTERS

from mishutter import TukeyShutter
from mishutter.blur.quadrature import exposure_quadrature

PHASE_PER_NODE = 1.6
"""Radians: a little less than a plan allows each node."""


@partial(jax.jit, static_argnames="num_nodes")
def by_nodes(taper, turn, num_nodes):
    """Half the integral of w cos(turn tau), of a taper that is traced."""
    nodes = exposure_quadrature(TukeyShutter(taper), num_nodes, np.dtype(float))
    return jnp.sum(nodes.weight * jnp.cos(turn * nodes.tau))


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


SOME = ["rect", "hann", "triangle", "gaussian", "tukey", "spline"]
PATH_ENDS = (Fraction(-1), Fraction(-1, 3), Fraction(2, 7), Fraction(1))


@pytest.mark.parametrize("ends", [(), PATH_ENDS], ids=["parabola", "path"])
@pytest.mark.parametrize("num_nodes", [64, 284, 1000])
@pytest.mark.parametrize("slug", SOME)
def test_nodes_of_a_known_shutter_are_as_exact(slug, num_nodes, ends):
    """By NumPy, against short panels over the shutter itself, as fast as a plan allows."""
    shutter, dtype = SHUTTERS[slug].shutter(), np.dtype(float)
    turn = PHASE_PER_NODE / 2 * (num_nodes - 48) * np.linspace(0, 1, 12)

    def sums(tau, light):
        return np.exp(1j * turn[:, None] * (tau + 1) ** 2 / 4) @ light

    nodes = exposure_quadrature(shutter, num_nodes, dtype, ends)
    cuts = np.asarray(shutter.breakpoints(dtype))
    cuts = np.unique([np.linspace(*pair, 101) for pair in itertools.pairwise(cuts)])
    place, weight = np.polynomial.legendre.leggauss(24)
    half = np.diff(cuts)[:, None] / 2
    tau = (cuts[:-1, None] + half * (1 + place)).ravel()
    light = (half * weight / 2).ravel() * np.asarray(shutter.transmittance(tau))
    found = sums(np.asarray(nodes.tau), np.asarray(nodes.weight))
    np.testing.assert_allclose(found, sums(tau, light), rtol=0, atol=1e-14)
    np.testing.assert_allclose(nodes.efficiency, shutter.efficiency(), rtol=1e-14)
    assert nodes.tau.size <= max(num_nodes + 192, 512)


def test_few_nodes_are_left_over():
    """Pieces of no matter which lengths together take little more than as many were asked for."""
    nodes = exposure_quadrature(TukeyShutter(0.3), 1024, np.dtype(np.float32))
    assert nodes.tau.dtype == nodes.weight.dtype == np.float32
    assert nodes.tau.size < 1.2 * 1024
