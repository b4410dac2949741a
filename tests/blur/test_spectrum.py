"""Transfer function and condition number: identities, published figures, errors by text."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.cases import SHUTTERS

from mishutter import (
    ChippedShutter,
    HannShutter,
    ParabolicMotion,
    StillCamera,
    binned_exposure,
    condition_number,
    transfer_function,
)

IDENTITY = 1e-13
"""Two routes to the same number of modulus below one."""
ALIASES = 8e-5
"""What is left out beyond the 100th alias."""

MOTION = ParabolicMotion(acceleration=310.0, half_exposure=0.31)
FREQUENCY = np.array([0.0, 0.013, -0.21, 0.47, 3.1, 4.1])


@pytest.mark.slow
@pytest.mark.parametrize("slug", ["gaussian", "chips", "spline-symmetric"])
def test_zero_frequency_is_the_efficiency(slug):
    """And opposite frequencies are conjugate."""
    shutter = SHUTTERS[slug].shutter()
    both = np.concatenate([FREQUENCY, -FREQUENCY])
    response = np.asarray(transfer_function(shutter, MOTION, speed=71.0, frequency=both))
    np.testing.assert_allclose(response[0], complex(shutter.efficiency()), atol=IDENTITY)
    np.testing.assert_allclose(response[6:], response[:6].conj(), atol=IDENTITY)


@pytest.mark.slow
def test_it_is_the_transform_of_the_kernel():
    """The Fourier series of the exact taps is the transfer function times the aperture."""
    edges = np.arange(-41.0, 60.0)
    taps = np.asarray(binned_exposure(HannShutter(), MOTION, speed=71.0, edges=edges))
    orders = np.arange(-100, 101)
    aliases = FREQUENCY[:4, None] + orders
    others = np.asarray(transfer_function(HannShutter(), MOTION, speed=71.0, frequency=aliases))
    folded = np.sum(others * np.sinc(aliases) * (-1.0) ** orders, axis=1)
    phases = np.exp(-2j * np.pi * FREQUENCY[:4, None] * (edges[:-1] + 0.5))
    np.testing.assert_allclose(phases @ taps, folded, atol=ALIASES)


@pytest.mark.slow
@pytest.mark.parametrize("slug", ["tukey", "spline-symmetric"])
def test_forward_and_reverse_mode_agree(slug):
    """By motion, speed, frequency and shutter, on both sides of every regime."""
    case = SHUTTERS[slug]

    def parts(x):
        motion = ParabolicMotion(acceleration=x[0], half_exposure=x[1])
        response = transfer_function(
            case.make(x[4] * case.parameters), motion, speed=x[2], frequency=x[3] * FREQUENCY
        )
        return jnp.concatenate([response.real, response.imag])

    modes = jax.jit(jax.jacfwd(parts)), jax.jit(jax.jacrev(parts))
    for speed in (0.0, 140.0):
        x = jnp.array([310.0, 0.31, speed, 1.1, 0.97])
        forward, reverse = (mode(x) for mode in modes)
        assert np.all(np.isfinite(forward))
        np.testing.assert_allclose(forward, reverse, atol=1e-12 * np.max(np.abs(forward)))


@pytest.mark.slow
def test_vmap_jit_and_blocks_change_nothing():
    """Speeds under `vmap`, speeds by broadcasting and many frequencies at once."""
    shutter = SHUTTERS["flutter"].shutter()
    speeds = jnp.array([-30.0, 0.0, 211.0])
    frequency = jnp.linspace(-1.7, 2.9, 700)

    def row(speed):
        return transfer_function(shutter, MOTION, speed=speed, frequency=frequency)

    plain = jnp.stack([row(s) for s in speeds])
    np.testing.assert_allclose(jax.jit(jax.vmap(row))(speeds), plain, atol=IDENTITY)
    np.testing.assert_allclose(
        transfer_function(
            shutter, MOTION, speed=speeds[:, None], frequency=jnp.tile(frequency, (3, 1))
        ),
        plain,
        atol=IDENTITY,
    )


@pytest.mark.parametrize(("velocity", "speed"), [(9e3, -8e3), (-8e3, 9e3)])
def test_a_pan_against_an_object_is_its_speed_over_the_sensor(velocity, speed):
    """Nodes are as many as its phase turns, some 180 times at the highest frequency."""
    panned, still = (
        ParabolicMotion(acceleration=3e4, half_exposure=0.01, velocity=v) for v in (velocity, 0.0)
    )
    found, wanted = (
        transfer_function(HannShutter(), motion, speed=s, frequency=FREQUENCY[:4])
        for motion, s in ((panned, speed), (still, speed - velocity))
    )
    np.testing.assert_allclose(found, wanted, atol=10 * IDENTITY)


def test_lists_are_arrays():
    """A list of taps, speeds or frequencies is the row that it looks like."""
    taps, speeds, frequency = [0.1, 0.5, 0.3], [3.0, -50.0], [0.11, 0.37]
    assert condition_number(taps) == condition_number(np.array(taps))
    found = transfer_function(HannShutter(), MOTION, speed=speeds, frequency=frequency)
    given = {"speed": np.array(speeds), "frequency": np.array(frequency)}
    assert jnp.array_equal(found, transfer_function(HannShutter(), MOTION, **given))


@pytest.mark.slow
def test_still_and_closed_cameras():
    """No motion: the efficiency at every frequency. Nothing open: zero."""
    still = StillCamera(half_exposure=0.02)
    flat = transfer_function(HannShutter(), still, speed=0.0, frequency=FREQUENCY)
    np.testing.assert_allclose(flat, np.full(6, 0.5), atol=IDENTITY)
    closed = transfer_function(ChippedShutter(np.zeros(5)), MOTION, speed=3.0, frequency=FREQUENCY)
    assert not np.any(closed)


@pytest.mark.parametrize(
    ("kernel", "length", "expected"),
    [
        (np.ones(4), None, np.inf),
        (np.zeros(3), None, np.inf),
        (np.array([0.0, 1e-200, 0.0]), None, 1.0),
        (np.array([0.7]), 1, 1.0),
        (np.array([3.0, 1.0]), 2, 2.0),
        (np.array([0.5 + 2.0**-44, 2.0**-44 - 0.5]), 2, 2.0**43),
    ],
)
def test_condition_number_of_simple_kernels(kernel, length, expected):
    """A zero response is `inf`, a small one a number, and no derivative a NaN."""
    value = condition_number(kernel, num_frequencies=length)
    assert np.allclose(value, expected)
    gradient = jax.grad(lambda h: condition_number(h, num_frequencies=length))(jnp.asarray(kernel))
    assert np.all(np.isfinite(gradient))


@pytest.mark.parametrize(("num_taps", "length"), [(3, 1024), (256, 1024), (257, 2048)])
def test_the_default_length_is_four_times_the_kernel(num_taps, length):
    """A power of two, at least 1024: a dip of the response is seen, however long the kernel."""
    kernel = 1 + np.cos(0.1 * np.arange(num_taps) ** 2)
    by_default = condition_number(kernel)
    assert by_default == condition_number(kernel, num_frequencies=length)
    assert by_default != condition_number(kernel, num_frequencies=2 * length)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: condition_number(np.ones((2, 2))), "must be one row of at least one tap"),
        (lambda: condition_number(np.array([1.0, np.nan])), "must be finite"),
        (lambda: condition_number(np.ones(5), num_frequencies=3), "must be at least the 5 taps"),
        (lambda: condition_number(np.ones(5), num_frequencies=0), "must be a positive integer"),
        (
            lambda: transfer_function(HannShutter(), MOTION, speed=np.inf, frequency=0.1),
            r"transfer_function\(speed=...\)` must be finite",
        ),
        (
            lambda: transfer_function(HannShutter(), MOTION, speed=0.1, frequency=np.nan),
            r"transfer_function\(frequency=...\)` must be finite",
        ),
        (
            lambda: transfer_function(
                HannShutter(), MOTION, speed=np.ones(2), frequency=np.ones((5, 3))
            ),
            r"must broadcast with shape \(5, 3\); got shape \(2,\)\.",
        ),
    ],
)
def test_wrong_arguments_are_named(call, message):
    """One sentence with the argument, what must hold and what came."""
    with pytest.raises(ValueError, match=message):
        call()
