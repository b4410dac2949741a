"""The share of a picture's power that is lost, by NumPy and by JAX alike."""

import jax
import jax.numpy as jnp
import numpy as np

from mishutter.evaluation.errors import residual_fraction


def test_the_lost_share_is_that_of_the_best_filter():
    """It is what `G = S conj(m) / (S (|m|^2 + v) + N)` leaves, term by term."""
    rng = np.random.default_rng(5)
    responses = rng.normal(size=(4, 30)) + 1j * rng.normal(size=(4, 30))
    weights = np.array([0.1, 0.4, 0.2, 0.3])[:, None]
    signal, noise = rng.uniform(0.1, 3.0, 30), 0.37
    mean = np.sum(weights * responses, axis=0)
    passed = np.sum(weights * abs(responses) ** 2, axis=0)
    gain = signal * np.conj(mean) / (signal * passed + noise)
    missed = np.sum(weights * abs(1 - gain * responses) ** 2, axis=0)
    left = missed + noise / signal * abs(gain) ** 2
    numbers = signal, abs(mean) ** 2, passed - abs(mean) ** 2, noise
    np.testing.assert_allclose(residual_fraction(*numbers), left, rtol=1e-12)
    np.testing.assert_allclose(residual_fraction(*map(jnp.asarray, numbers)), left, rtol=1e-12)


def test_all_is_lost_in_the_dark_without_noise():
    """Where there is neither signal nor noise the share is 1, and its derivative is finite."""
    dark, lit = np.array([0.0, 2.0]), np.array([0.3, 0.3])
    np.testing.assert_array_equal(residual_fraction(dark, lit, 0.0 * lit, 0.0), [1.0, 0.0])

    def total(signal):
        return jnp.sum(residual_fraction(signal, jnp.asarray(lit), jnp.asarray(0.1 * lit), 0.0))

    assert np.all(np.isfinite(jax.grad(total)(jnp.asarray(dark))))
