"""What the sensor makes of the light that falls on it: electrons, full well, numbers."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mishutter.motion import AbstractMotion
from mishutter.scene import Scene
from mishutter.types import require, require_positive_int


def white_electrons(scene: Scene, motion: AbstractMotion) -> Array:
    r"""Photo-electrons of a white pixel in a fully open exposure, $p = \text{rate}\cdot 2T$."""
    return scene.photon_rate * motion.exposure


def noise_variance(
    scene: Scene, motion: AbstractMotion, efficiency: ArrayLike, mean_level: ArrayLike | None = None
) -> Array:
    r"""$N = \eta\bar f/p + (\sigma/p)^2$ per pixel, in units of a fully open exposure."""
    electrons = white_electrons(scene, motion)
    level = scene.mean_level if mean_level is None else mean_level
    return jnp.asarray((efficiency * level + scene.read_noise**2 / electrons) / electrons)


def recorded(
    light: Array,
    electrons: ArrayLike,
    read_noise: ArrayLike,
    *,
    key: Array | None,
    full_well: float | None = None,
    adc_bits: int | None = None,
) -> Array:
    r"""What a sensor records of `light`, in units of a fully open exposure of white.

    $g = \mathrm{Poisson}(p f)/p + \mathrm{Normal}(0, (\sigma/p)^2)$ (4). A full well cuts
    the electrons off before the read noise comes in; a converter of $b$ bits rounds to
    $2^b - 1$ equal steps from none to the full well (to white, where there is none) and
    records nothing below or above.

    Args:
        light: Light without noise; any shape.
        electrons: $p$, e-.
        read_noise: $\sigma$, e-.
        key: JAX key of the noise; None for none.
        full_well: Most electrons a pixel holds, e-; None for no limit.
        adc_bits: Bits of the converter; None for no rounding.

    Returns:
        Shape and dtype of `light`.

    Raises:
        ValueError: if the full well is not positive or the bits are not from 1 to 24.
    """
    p = jnp.asarray(electrons, light.dtype)
    shot_key, read_key = (None, None) if key is None else jax.random.split(key)
    shot = light * p
    if shot_key is not None:
        shot = jax.random.poisson(shot_key, jnp.maximum(shot, 0)).astype(light.dtype)
    if full_well is not None:
        require(full_well > 0, "simulate_capture(full_well=...)", "be above 0 e-", full_well)
        shot = jnp.minimum(shot, full_well)
    if read_key is not None:
        sigma = jnp.asarray(read_noise, light.dtype)
        shot = shot + sigma * jax.random.normal(read_key, light.shape, light.dtype)
    lit = p > 0
    value = jnp.where(lit, shot / jnp.where(lit, p, 1), light)
    if adc_bits is None:
        return value
    require_positive_int("simulate_capture(adc_bits=...)", adc_bits)
    require(adc_bits <= 24, "simulate_capture(adc_bits=...)", "be at most 24", adc_bits)
    top = jnp.ones_like(p) if full_well is None else full_well / p
    steps = 2**adc_bits - 1
    return jnp.round(jnp.clip(value / top, 0, 1) * steps) / steps * top
