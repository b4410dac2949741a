"""Taps, transfer functions and their derivatives on free paths, against 80 and 100 digits.

Paths have pieces of positive, zero and negative acceleration, and two without a length. Seeds are
fixed, so a failure names its point and can be repeated.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.cases import SHUTTERS
from support.free_paths import (
    DURATIONS,
    NUM_TAPS,
    errors,
    random_path,
    transfer_errors,
)

from mishutter import (
    FreeMotion,
    HannShutter,
    ParabolicMotion,
    RectShutter,
    TukeyShutter,
    binned_exposure,
    blur_kernel,
    transfer_function,
)

# The runs of a path, which taps follow one by one.
from mishutter.blur.free_path import runs

LARGEST = {np.float64: 8.0, np.float32: 6.0}
"""Longest stroke, as a power of ten px."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slug", "dtype", "seed"),
    [("flutter", np.float32, 12), ("tukey", np.float64, 3)],
)
def test_taps_and_derivatives(slug, dtype, seed):
    """By every acceleration, the exposure, speed, velocity and position, at 5 points."""
    rng = np.random.default_rng(seed)
    for _ in range(5):
        point = random_path(rng, dtype, slug, largest=LARGEST[dtype])
        of_taps, of_slopes = errors(point)
        assert of_taps <= 1, point
        assert of_slopes <= 1, point


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slug", "dtype"),
    [
        ("rect", np.float32),
        ("hann", np.float64),
        ("tukey", np.float32),
        ("chips", np.float64),
        ("spline", np.float64),
    ],
)
def test_taps_and_derivatives_over_the_domain(slug, dtype):
    """A longer sweep, of 10 points each."""
    rng = np.random.default_rng(17)
    for _ in range(10):
        point = random_path(rng, dtype, slug, largest=LARGEST[dtype])
        assert max(errors(point)) <= 1, point


@pytest.mark.slow
@pytest.mark.parametrize(("slug", "dtype"), [("hann", np.float64), ("chips", np.float32)])
def test_transfer_function(slug, dtype):
    """And its derivatives, at frequencies from far below to far above a cycle a path."""
    rng = np.random.default_rng(5)
    for _ in range(4):
        point = random_path(rng, dtype, slug, largest=4.0)
        frequencies = np.append(10 ** rng.uniform(-4, 0.5, 2), 0.0).astype(dtype)
        of_values, of_slopes = transfer_errors(point, frequencies)
        assert of_values <= 1, point
        assert of_slopes <= 1, point


@pytest.mark.slow
def test_forwards_and_backwards():
    """Reverse mode gives the derivatives of forward mode."""
    accelerations, parameters = np.array([3.0, -2.0, 0.0, 4.0]), np.array(0.4)

    def taps(accelerations, T, speed, parameter):
        motion = FreeMotion(accelerations=accelerations, half_exposure=T, velocity=0.3)
        return blur_kernel(TukeyShutter(parameter), motion, speed=speed, num_taps=9, phase=-0.2)

    arguments = accelerations, np.array(1.7), np.array(0.9), parameters
    forwards = jax.jacfwd(taps, argnums=(0, 1, 2, 3))(*arguments)
    backwards = jax.jacrev(taps, argnums=(0, 1, 2, 3))(*arguments)
    for forward, backward in zip(forwards, backwards, strict=True):
        np.testing.assert_allclose(forward, backward, rtol=1e-12, atol=1e-14)
    step = 1e-5
    around = [taps(*arguments[:3], parameters + sign * step) for sign in (1, -1)]
    np.testing.assert_allclose(forwards[3], (around[0] - around[1]) / (2 * step), atol=1e-8)


@pytest.mark.slow
def test_equal_accelerations_are_a_parabola():
    """Kernels of objects that the sensor keeps up with, exposures and responses of any."""
    shutter = TukeyShutter(0.3)
    parabola = ParabolicMotion(acceleration=700.0, half_exposure=0.25, velocity=33.0)
    path = FreeMotion.fit(parabola, num_pieces=5)
    frequency = np.array([-0.3, 0.0, 0.01, 0.5, 3.0, 100.0, 1e4])
    edges = np.linspace(-50.0, 190.0, 41)
    for speed in (0.0, 33.0, 120.0, -300.0):
        kernels = [
            blur_kernel(shutter, m, speed=speed, num_taps=120, phase=-0.3) for m in (parabola, path)
        ]
        np.testing.assert_allclose(*kernels, atol=1e-15)
    for speed in (33.0, 500.0):
        light = [binned_exposure(shutter, m, speed=speed, edges=edges) for m in (parabola, path)]
        np.testing.assert_allclose(*light, atol=1e-15)
        responses = [
            transfer_function(shutter, m, speed=speed, frequency=frequency)
            for m in (parabola, path)
        ]
        np.testing.assert_allclose(*responses, atol=1e-14)


@pytest.mark.slow
def test_an_object_at_rest_on_the_sensor_for_a_while():
    """All the light of a piece over which the sensor keeps pace falls on one tap, the lowest."""
    motion = FreeMotion(accelerations=[5.0, 0.0, 9.0], half_exposure=1.0, durations=[1.0, 2.0, 1.0])
    taps = np.asarray(blur_kernel(RectShutter(), motion, num_taps=4))
    expected = 0.5 + (1 / np.sqrt(5) + 1 / np.sqrt(9)) / 2
    np.testing.assert_allclose(taps[0], expected, rtol=1e-14)
    np.testing.assert_allclose(np.sum(taps), 1, rtol=1e-14)


@pytest.mark.slow
def test_a_path_upside_down():
    """The exposure of a path in a mirror is that of the path, in the other order."""
    edges = np.sort(np.random.default_rng(2).uniform(-3, 3, 12))
    row = np.array([4.0, -1.5, 0.0, -6.0, 2.5])
    paths = [FreeMotion(accelerations=sign * row, half_exposure=1.1) for sign in (1, -1)]
    shutter = SHUTTERS["spline"].shutter()
    light = binned_exposure(shutter, paths[0], speed=0.7, edges=edges)
    mirrored = binned_exposure(shutter, paths[1], speed=-0.7, edges=-edges[::-1])
    np.testing.assert_allclose(light, mirrored[::-1], rtol=1e-12)


def test_runs_end_where_a_path_begins_to_bend_the_other_way():
    """Pieces at constant velocity belong to the run before them, the first ones to that after."""
    cases = [
        ([0.0, 0.0, 2.0, 0.0, -3.0, -1.0, 0.0, 4.0], [0, 4, 7], [4, 7, 8], [1, -1, 1]),
        ([0.0, -2.0, -1.0, 5.0], [0, 3], [3, 4], [-1, 1]),
        ([-0.0, 1.0, 0.0, 2.0], [0], [4], [1]),
        ([3.0, -1.0, 2.0, -4.0], [0, 1, 2, 3], [1, 2, 3, 4], [1, -1, 1, -1]),
    ]
    for accelerations, first, past, direction in cases:
        motion = FreeMotion(accelerations=accelerations, half_exposure=0.3)
        assert motion.num_runs == len(first)
        place = jnp.arange(len(accelerations), dtype=jnp.int32)
        found = runs(motion.accelerations, place, motion.num_runs)
        for values, expected in zip(found, (first, past, direction), strict=True):
            np.testing.assert_array_equal(values, expected)


def test_all_light_falls_on_the_taps_of_a_path_that_begins_straight():
    """Its first pieces too, whichever way it bends after them, seen or not by what moves."""
    for bends in ([0.0, 40.0, -15.0], [0.0, -25.0, 30.0], [0.0, 40.0, 15.0]):
        motion = FreeMotion(accelerations=bends, half_exposure=0.7)
        for speed in (0.0, 9.0):
            taps = binned_exposure(
                HannShutter(), motion, speed=speed, edges=np.linspace(-60.0, 60.0, 25)
            )
            assert float(jnp.sum(taps)) == pytest.approx(0.5, abs=1e-12)


@pytest.mark.slow
def test_runs_of_known_and_of_unknown_accelerations():
    """Known signs make one run of a path that bends one way; the taps are those of many runs."""
    row = np.array([2.0, 0.0, 1.0, 3.0, 0.0, 0.5, 1.0, 4.0])
    motion = FreeMotion(accelerations=row, half_exposure=1.3, durations=DURATIONS)
    assert motion.num_runs == 1
    assert FreeMotion(accelerations=[1.0, 0.0, -1.0, 2.0], half_exposure=1.0).num_runs == 3

    @jax.jit
    def unknown(row):
        motion = FreeMotion(accelerations=row, half_exposure=1.3, durations=DURATIONS)
        return blur_kernel(HannShutter(), motion, speed=0.8, num_taps=NUM_TAPS, phase=-0.6)

    known = blur_kernel(HannShutter(), motion, speed=0.8, num_taps=NUM_TAPS, phase=-0.6)
    np.testing.assert_allclose(known, unknown(jnp.asarray(row)), atol=1e-16)
