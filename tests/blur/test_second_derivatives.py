"""Second derivatives of kernels, by differences of first ones and of 300-digit references.

Arguments are in natural units, in which a step of 1 changes taps by about their own size. Their
entries are compared with the largest, as an optimiser's step is made of all of them.
"""

import itertools
from functools import partial

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from support import reference
from support.cases import SHUTTERS
from support.helpers import direction_of

from mishutter import (
    FreeMotion,
    HannShutter,
    ParabolicMotion,
    RectShutter,
    TukeyShutter,
    binned_exposure,
    blur_kernel,
)

SECOND_OF_LARGEST = 1e-6
"""What is asked of second derivatives; found are 1e-11 and less."""
EXACT_OF_LARGEST = 1e-11
"""Taps of a stroke of up to 1e4 px, which lose four digits in their plain difference."""
STEP = 2e-3
"""Of differences, whose error is that of the fourth power."""
HALF_EXPOSURE = 0.31
NUM_TAPS = 23


def numbers(kernel):
    """A number that every tap decides, and that is not linear in any."""
    return jnp.cos(1.3 * jnp.arange(kernel.size, dtype=float)) @ kernel + 3 * jnp.sum(kernel**2)


def weighed(slug, frame, point, x):
    """A number of a kernel at `x` natural units from a point, which shutters are moved by too."""
    stroke, share, first = point
    case, unit = SHUTTERS[slug], jnp.minimum(1.0, 1 / stroke)
    moved = case.parameters * (1 + 0.1 * direction_of(case.parameters) * x[4])
    a, T = stroke / HALF_EXPOSURE**2 * (1 + unit * x[0]), HALF_EXPOSURE * (1 + unit * x[1])
    gain = 2 * stroke / HALF_EXPOSURE
    motion, speed = ParabolicMotion(acceleration=a, half_exposure=T), gain * (share + unit * x[2])
    if frame == "vertex":
        options = {"speed": speed, "num_taps": NUM_TAPS, "phase": first + x[3]}
        return numbers(blur_kernel(case.make(moved), motion, **options))
    edges = first + 1.1 * jnp.arange(NUM_TAPS + 1, dtype=float)
    edges = edges + x[3] * jnp.cos(1.7 * jnp.arange(NUM_TAPS + 1, dtype=float))
    return numbers(binned_exposure(case.make(moved), motion, speed=speed, edges=edges))


POINTS = {
    "vertex": [
        (14.7, 0.0, -0.37),
        (14.7, 0.07, -1.61),
        (14.7, -0.63, 0.23),
        (8.3, 1.7, 3.31),
        (0.83, -0.41, -2.37),
        (312.7, 0.31, 151.37),
    ],
    "sensor": [
        (14.7, 0.0, -3.37),
        (14.7, -0.63, -9.23),
        (2.3, 3.7, -11.31),
        (0.83, 0.11, -12.37),
        (312.7, 1.31, -451.37),
    ],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slug", "frame"),
    [
        ("rect", "vertex"),
        ("hann", "sensor"),
        ("triangle", "vertex"),
        ("tukey", "sensor"),
        ("spline", "vertex"),
        ("chips", "sensor"),
    ],
)
def test_hessians_are_differences_of_gradients(slug, frame):
    """By motion, speed, edges and the shutter, at any speed of either sign and any stroke."""
    slope = jax.jit(jax.grad(partial(weighed, slug, frame), 1))
    second = jax.jit(jax.hessian(partial(weighed, slug, frame), 1))
    origin, steps = jnp.zeros(5), np.eye(5)
    for point in POINTS[frame]:
        point = jnp.array(point)
        wide, narrow = (
            np.stack([slope(point, h * e) - slope(point, -h * e) for e in steps]) / (2 * h)
            for h in (2 * STEP, STEP)
        )
        differences = (4 * narrow - wide) / 3
        found = np.asarray(second(point, origin))
        largest = np.max(np.abs(differences))
        assert largest > 0
        np.testing.assert_allclose(found, differences, atol=SECOND_OF_LARGEST * largest)
        np.testing.assert_allclose(found, found.T, atol=1e-10 * largest)


@jax.jit
def hessian_of_taps(a, T, s, first):
    """By the relative change of acceleration and half exposure, the speed and the phase."""

    def taps(x):
        motion = ParabolicMotion(acceleration=a * (1 + x[0]), half_exposure=T * (1 + x[1]))
        speed = s + 2 * a * T * x[2]
        return blur_kernel(HannShutter(), motion, speed=speed, num_taps=6, phase=first + x[3])

    return jax.jacfwd(jax.jacrev(taps))(jnp.zeros(4))


@pytest.mark.parametrize(
    ("stroke", "share", "first"),
    [
        (29.3, 0.0, -0.43),
        (29.3, 1e-7, 7.31),
        (29.3, -0.83, 1.17),
        (3.1, 1.9, 3.77),
        (0.13, 0.27, -2.9),
        (8.3e3, 0.31, 2310.37),
        (8.3e3, -0.003, -1.97),
    ],
)
def test_second_derivatives_of_taps_are_exact(stroke, share, first):
    """Each against the reference's, to the largest of all taps."""
    T = 0.31
    a = stroke / T**2
    s = 2 * a * T * share

    def taps(x):
        edges = [mp.mpf(first) + x[3] + k for k in range(7)]
        motion = mp.mpf(a) * (1 + x[0]), mp.mpf(T) * (1 + x[1]), s + mp.mpf(2 * a * T) * x[2]
        row = reference.exposures(reference.hann(), *motion, edges, from_vertex=True)
        return np.array(row)

    step, exact = mp.mpf("1e-40"), np.zeros((6, 4, 4))
    for i, j in itertools.product(range(4), repeat=2):
        one, other = ([step * (k == place) for k in range(4)] for place in (i, j))
        corners = [
            p * q * taps([p * x + q * y for x, y in zip(one, other, strict=True)])
            for p, q in itertools.product((1, -1), repeat=2)
        ]
        exact[:, i, j] = np.array(sum(corners) / (4 * step**2), float)
    found = hessian_of_taps(a, T, s, first)
    np.testing.assert_allclose(found, exact, atol=EXACT_OF_LARGEST * np.max(np.abs(exact)))


@pytest.mark.slow
def test_modes_agree_under_vmap():
    """Forward over reverse, reverse over reverse and forward over forward, to rounding."""
    points = jnp.array(POINTS["vertex"][:3])

    def hessians(outer, inner):
        def second(point):
            return outer(inner(partial(weighed, "tukey", "vertex", point)))(jnp.zeros(5))

        return jax.jit(jax.vmap(second))(points)

    modes = [(jax.jacfwd, jax.jacrev), (jax.jacrev, jax.jacrev), (jax.jacfwd, jax.jacfwd)]
    first, *others = (hessians(*mode) for mode in modes)
    for other in others:
        np.testing.assert_allclose(other, first, atol=1e-11 * np.max(np.abs(first)))


@pytest.mark.slow
def test_where_an_edge_lies_on_the_vertex():
    """Its share is infinite, and left out: second derivatives are those of the other edges."""
    motion = ParabolicMotion(acceleration=45.0, half_exposure=1.0)

    def taps(phase):
        return blur_kernel(RectShutter(), motion, num_taps=5, phase=phase)

    second = np.asarray(jax.jacfwd(jax.jacfwd(taps))(0.0))
    edges = np.arange(1.0, 6.0)
    curvature = -0.25 * edges**-1.5 / np.sqrt(45.0)
    np.testing.assert_allclose(second, np.diff(curvature, prepend=0.0), rtol=1e-12)


@pytest.mark.slow
def test_an_edge_that_meets_a_step_has_the_derivatives_of_one_side():
    """As first ones have: where an edge meets the end of the exposure, the kernel has a kink."""
    motion = ParabolicMotion(acceleration=16.0, half_exposure=1.0)

    def taps(phase):
        return blur_kernel(RectShutter(), motion, num_taps=17, phase=phase)

    found = np.asarray(jax.jacfwd(jax.jacfwd(taps))(0.0))[15]
    before, after = (-0.25 * x**-1.5 / 4 for x in (15.0, 16.0))
    assert min(abs(found - (after - before)), abs(found + before)) < 1e-12


def on_free_path(x):
    """A number of a kernel by accelerations, exposure, speed, phase and taper, in their units."""
    rates = jnp.array([310.0, -90.0, 210.0]) * (1 + x[0] * jnp.array([1.0, -0.7, 0.4]))
    motion = FreeMotion(accelerations=rates, half_exposure=0.31 * (1 + x[1]), velocity=7.0)
    options = {"speed": 13.0 + 60 * x[2], "num_taps": NUM_TAPS, "phase": -0.37 + x[3]}
    return numbers(blur_kernel(TukeyShutter(0.43 + x[4]), motion, **options))


@pytest.mark.slow
def test_a_free_path_has_second_derivatives():
    """By everything that moves a crossing or a breakpoint, as differences of first ones."""
    slope, step = jax.jit(jax.grad(on_free_path)), 1e-5
    sides = [(slope(step * e) - slope(-step * e)) / (2 * step) for e in np.eye(5)]
    found = jax.jit(jax.hessian(on_free_path))(jnp.zeros(5))
    largest = np.max(np.abs(sides))
    np.testing.assert_allclose(found, sides, atol=SECOND_OF_LARGEST * largest)
    np.testing.assert_allclose(found, found.T, atol=1e-11 * largest)


@pytest.mark.slow
def test_second_derivatives_within_a_scan():
    """Those of a kernel at each speed in turn are those of a batch of speeds."""

    def weight(stroke, mapped):
        motion = ParabolicMotion(acceleration=stroke / 0.3**2, half_exposure=0.3)
        kernels = mapped(
            lambda speed: blur_kernel(HannShutter(), motion, speed=speed, num_taps=9),
            jnp.array([0.0, 3.0]),
        )
        return jnp.sum(kernels @ jnp.cos(jnp.arange(9.0)))

    within = jax.lax.map, lambda f, x: jax.vmap(f)(x)
    scanned, batched = (float(jax.hessian(weight)(7.3, mapped)) for mapped in within)
    assert scanned != 0
    np.testing.assert_allclose(scanned, batched, rtol=1e-12)
