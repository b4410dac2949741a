"""Kernels where formulae degenerate: finite derivatives, NaN kept, mirror images."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter import (
    ChippedShutter,
    FirstOrderDevice,
    FreeMotion,
    HannShutter,
    ParabolicMotion,
    TukeyShutter,
    binned_exposure,
    blur_kernel,
)

HALF_EXPOSURE = 0.25
CHIPS = np.array([0.2, 0.9, 0.0, 1.0])
EDGES = {
    "edges on breakpoints": np.array([-16.0, -7.0, 0.0, 4.0, 9.0, 16.0]),
    "one tap": np.array([-3.7, 5.1]),
    "all dark": np.array([400.0, 401.5, 403.0]),
}
MOTIONS = {  # acceleration and speed: the sag is 16 px, and at a speed of 128 the vertex at the end
    "at rest": (0.0, 0.0),
    "no acceleration": (0.0, 41.0),
    "an object at rest": (256.0, 0.0),
    "vertex within": (256.0, 64.0),
    "vertex at the end": (256.0, 128.0),
    "vertex beyond": (256.0, -301.0),
    "hardly accelerated": (1e-300, 41.0),
}


def _taps(x, edges):
    """Both frames, by acceleration, exposure, speed, velocity, a shift, and chips."""
    motion = ParabolicMotion(acceleration=x[0], half_exposure=x[1], velocity=x[3])
    shutter = ChippedShutter(x[5:])
    sensor = binned_exposure(shutter, motion, speed=x[2], edges=edges + x[4])
    options = {"speed": x[2], "num_taps": edges.size, "phase": edges[0] + x[4]}
    return jnp.concatenate([sensor, blur_kernel(shutter, motion, **options)])


@jax.jit
def _derivatives(x, edges):
    taps = lambda x: _taps(x, edges)  # noqa: E731
    return taps(x), jax.jacfwd(taps)(x), jax.jacrev(taps)(x), jax.jacfwd(jax.jacrev(taps))(x)


@pytest.mark.slow
@pytest.mark.parametrize("edges", EDGES)
def test_no_derivative_is_a_nan(edges):
    """First ones in either mode, which agree, and second ones, wherever the vertex lies."""
    for name, (acceleration, speed) in MOTIONS.items():
        x = jnp.array([acceleration, HALF_EXPOSURE, speed + 3.0, 3.0, 0.0, *CHIPS])
        taps, forward, reverse, second = _derivatives(x, jnp.asarray(EDGES[edges]))
        for values in (taps, forward, reverse, second):
            assert np.all(np.isfinite(values)), name
        size = np.max(np.abs(forward), axis=0, keepdims=True)
        assert np.all(np.abs(forward - reverse) <= 1e-11 * size), name
        if edges == "all dark":
            assert not np.any(taps[:2])
            assert not np.any(forward[:2])


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("sag", [1e-3, 1e-7, 1e-9])
def test_light_within_one_tap_stays_there(sag, dtype):
    """No derivative of a tap that holds the whole path, whose vertex moves by 1/(2 sag) px a px.

    The two branches lose and gain the same light by that, which rounding must not tell.
    """
    edges, half = jnp.array([-3.0, -0.3, 0.2, 1.7, 4.0], dtype), dtype(HALF_EXPOSURE)

    def weighted(x):
        motion = ParabolicMotion(acceleration=x[0] / half**2, half_exposure=half)
        taps = binned_exposure(HannShutter(), motion, speed=x[1] / half, edges=edges)
        return jnp.array([0.3, -2.0, 1.1, 0.7], dtype) @ taps

    at = jnp.array([sag, 0.2 * sag], dtype)
    assert not np.any(jax.grad(weighted)(at))
    assert not np.any(jax.jacfwd(weighted)(at))


def _of_free_path(x, edges):
    rates = x[0] * jnp.array([1.0, -0.4, 0.7])
    motion = FreeMotion(accelerations=rates, half_exposure=x[1], velocity=x[3])
    shutter = TukeyShutter(x[5])
    sensor = binned_exposure(shutter, motion, speed=x[2], edges=edges + x[4])
    return jnp.concatenate(
        [sensor, blur_kernel(shutter, motion, speed=x[2], num_taps=4, phase=-0.3 + x[4])]
    )


@pytest.mark.parametrize("taps", [_taps, _of_free_path], ids=["parabola", "free"])
def test_nan_is_never_a_number(taps):
    """In a number of the motion, the speed, the shift or the shutter: every tap is NaN."""
    x = jnp.array([256.0, HALF_EXPOSURE, 47.0, 3.0, 0.1, 0.4])
    edges = jnp.array([-19.0, -8.3, 0.4, 11.0])
    found = jax.jit(jax.vmap(lambda x: taps(x, edges)))
    each = found(jnp.where(jnp.eye(6, dtype=bool), jnp.nan, x[None]))
    assert np.all(np.isfinite(found(x[None])))
    assert np.all(np.isnan(each))


def test_a_traced_negative_acceleration_is_the_mirror_image():
    """From the vertex taps count the way the sensor turns; from mid-exposure all are mirrored."""
    edges, shutter = np.array([-23.0, -7.1, -1.3, 2.9, 14.0]), ChippedShutter(CHIPS)

    @jax.jit
    def both(a, s, edges):
        motion = ParabolicMotion(acceleration=a, half_exposure=HALF_EXPOSURE, velocity=0.1 * s)
        kernel = blur_kernel(shutter, motion, speed=s, num_taps=23, phase=-0.3)
        return kernel, binned_exposure(shutter, motion, speed=s, edges=edges)

    kernel, light = both(256.0, 47.0, edges)
    mirrored_kernel, mirrored_light = both(-256.0, -47.0, -edges[::-1])
    assert float(jnp.sum(kernel)) > 0.4
    np.testing.assert_allclose(mirrored_kernel, kernel, atol=1e-15)
    np.testing.assert_allclose(mirrored_light, light[::-1], atol=1e-15)


@pytest.mark.slow
def test_no_light_is_lost_where_the_vertex_is_on_a_breakpoint_of_a_device_that_lags():
    """Pieces of its state may have no length, and the taps sum to the efficiency all the same."""
    half = 0.01
    motion = ParabolicMotion(acceleration=45 / half**2, half_exposure=half)
    device = FirstOrderDevice(rise_time=0.4e-3, fall_time=1.2e-3, leakage=0.001)
    shutter = device.behind(HannShutter(), half, np.dtype(np.float64))
    for speed in (-2250.0, -4500.0, 1125.0):
        taps = blur_kernel(shutter, motion, speed=speed, num_taps=110)
        np.testing.assert_allclose(jnp.sum(taps), shutter.efficiency(), rtol=1e-13)
