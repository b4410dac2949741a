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

LARGEST = {np.float64: 3.5, np.float32: 3.0}
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
        point = random_path(rng, dtype, slug, largest=2.5)
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
    frequency = np.array([-0.3, 0.0, 0.01, 0.5, 3.0, 100.0])
    edges = np.linspace(-50.0, 190.0, 41)
    for speed in (0.0, 33.0, 120.0, -300.0):
        kernels = [
            blur_kernel(shutter, m, speed=speed, num_taps=120, phase=-0.3) for m in (parabola, path)
        ]
        np.testing.assert_allclose(*kernels, atol=1e-14)
    for speed in (33.0, 500.0):
        light = [binned_exposure(shutter, m, speed=speed, edges=edges) for m in (parabola, path)]
        np.testing.assert_allclose(*light, atol=1e-14)
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
def test_no_light_of_an_object_that_rests_but_for_rounding_is_lost():
    """The sensor keeps pace on a piece that is the lowest place, to roundings of either sign."""
    half, rates = 0.0122, 45 / 0.0122**2 * np.array([1.3, 0.2, -0.7, 1.9, 0.0, 1.1])
    motion = FreeMotion(accelerations=rates, half_exposure=half)
    pace = float(motion.velocity_at(np.array(0.5 * half)))
    for speed in np.nextafter(pace, pace + np.array([-1.0, 0.0, 1.0])):
        taps = blur_kernel(HannShutter(), motion, speed=speed, num_taps=220)
        assert float(jnp.sum(taps)) == pytest.approx(0.5, abs=1e-13)


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


def test_all_light_falls_on_the_taps_of_a_path_that_begins_straight():
    """Its first pieces too, whichever way it bends after them, seen or not by what moves."""
    for bends in ([0.0, 40.0, -15.0], [0.0, -25.0, 30.0], [0.0, 40.0, 15.0]):
        motion = FreeMotion(accelerations=bends, half_exposure=0.7)
        for speed in (0.0, 9.0):
            taps = binned_exposure(
                HannShutter(), motion, speed=speed, edges=np.linspace(-60.0, 60.0, 25)
            )
            assert float(jnp.sum(taps)) == pytest.approx(0.5, abs=1e-12)
