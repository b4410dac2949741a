"""Waves from polynomials are waves to rounding, however many turns they have made."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np

from mishutter.sweeps.waves import cosine, paired_waves, waves

EPS = np.finfo(float).eps
POSITION = np.array([-41.3, -0.6, 0.0, 0.07, 12.9])
FREQUENCY = (np.arange(32) + 0.5) / 512 + 0.375


def test_cosine_to_rounding():
    """Against 30 digits, at turns of either sign that are and are not whole quarters."""
    turns = np.concatenate([np.linspace(-2.6, 2.7, 1001), np.arange(-9, 9) / 4, [0.0]])
    with mpmath.workdps(30):
        exact = [float(mpmath.cos(2 * mpmath.pi * mpmath.mpf(x))) for x in turns]
    np.testing.assert_allclose(cosine(jnp.asarray(turns)), exact, rtol=0, atol=2 * EPS)


def test_waves_at_equal_steps():
    """Products of coarse and fine waves, as near as the number of turns is known."""
    angle = 2 * np.pi * FREQUENCY[:, None] * POSITION
    allowed = 8 * EPS * (1 + np.max(np.abs(angle)))
    real, imag = jax.jit(waves)(jnp.asarray(FREQUENCY), jnp.asarray(POSITION))
    np.testing.assert_allclose(real, np.cos(angle), rtol=0, atol=allowed)
    np.testing.assert_allclose(imag, np.sin(angle), rtol=0, atol=allowed)


def test_paired_waves_stand_side_by_side():
    """Cosines first, sines behind, on the last axis."""
    position = jnp.asarray(np.stack([POSITION, 0.3 - POSITION]))
    found = paired_waves(jnp.asarray(FREQUENCY), position)
    both = jnp.concatenate(waves(jnp.asarray(FREQUENCY), position), axis=-1)
    assert found.shape == (32, 2, 10)
    np.testing.assert_allclose(found, both, rtol=0, atol=1e3 * EPS)
