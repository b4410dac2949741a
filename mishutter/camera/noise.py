"""The sensor turns light into electrons, cuts them off at its full well, and rounds them."""

from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import (
    as_numpy,
    device_constant,
    is_concrete,
    namespace_of,
    require,
    require_positive_int,
)
from mishutter._core.compiling import compiled, outside_trace
from mishutter._core.parallel import num_processors


def recorded(
    irradiance: Float[Array | np.ndarray, "*pixels"],
    electrons: ArrayLike,
    read_noise: ArrayLike,
    *,
    key: Array | None,  # None for none
    full_well: float | None = None,  # None for no limit
    adc_bits: int | None = None,  # None for no rounding
) -> Float[Array, "*pixels"]:
    r"""An irradiance as a sensor records it, in units of a fully open exposure of white.

    $g = \mathrm{Poisson}(p f)/p + \mathrm{Normal}(0, (\sigma/p)^2)$ (4). A full well cuts
    the electrons off before the read noise comes in; a converter of $b$ bits rounds to
    $2^b - 1$ equal steps from none to the full well (to white, where there is none) and
    records nothing below or above.
    """
    irradiance, electrons = as_numpy(irradiance, electrons)
    space = namespace_of(electrons)
    shot, read_key = irradiance * space.asarray(electrons, irradiance.dtype), None
    if key is not None:
        shot_key, read_key = _keys(key)
        shot = shot_electrons(shot_key, shot)
    return _digitised(
        shot, irradiance, electrons, read_noise, read_key, full_well=full_well, adc_bits=adc_bits
    )


@compiled
def _keys(key: Array) -> tuple[Array, Array]:
    """Keys of shot noise and of read noise."""
    first, second = jax.random.split(key)
    return first, second


def fixed_key() -> Array:
    """The key of noise where none is given: `jax.random.key(0)` of JAX's own generator."""
    with outside_trace():
        words = device_constant(np.zeros(2, np.uint32))
        return jax.random.wrap_key_data(words, impl="threefry2x32")


def shot_electrons(
    key: Array, mean: Float[Array | np.ndarray, "*pixels"]
) -> Float[Array, "*pixels"]:
    """Poisson numbers of some means, 0 where a mean is negative; in their precision.

    NumPy draws them, on every core: on two it takes a quarter of the time of JAX's own.
    The same key gives the same numbers under `jit` and `vmap`. They differentiate as their
    mean does, the noise being constant.
    """
    typed = jnp.issubdtype(key.dtype, jax.dtypes.prng_key)
    return _counted(jax.random.key_data(key) if typed else key, mean)


@jax.custom_jvp
def _counted(words: Array, mean: Array | np.ndarray) -> Array:
    if is_concrete(words) and is_concrete(mean):
        return jax.device_put(_drawn(words, mean))
    like = jax.ShapeDtypeStruct(mean.shape, mean.dtype)
    return jax.pure_callback(_drawn, like, words, mean, vmap_method="sequential")


@_counted.defjvp
def _counted_jvp(primals, tangents):
    return _counted(*primals), tangents[1]


def _drawn(words: Array | np.ndarray, mean: Array | np.ndarray) -> np.ndarray:
    """Runs of 65,536 pixels, each by a generator of its own, so that threads change no number."""
    expected = np.maximum(np.asarray(mean, np.float64), 0).ravel()
    runs = np.array_split(expected, -(-expected.size // (1 << 16)) or 1)
    seeds = np.random.SeedSequence(np.asarray(words).ravel().tolist()).spawn(len(runs))
    with ThreadPoolExecutor(num_processors()) as pool:
        counts = list(pool.map(_poisson, seeds, runs))
    return np.concatenate(counts).astype(mean.dtype).reshape(mean.shape)


def _poisson(seed: np.random.SeedSequence, expected: np.ndarray) -> np.ndarray:
    rng, most = np.random.default_rng(seed), 1e15  # beyond which the distribution is a normal one
    counts = rng.poisson(np.minimum(expected, most)).astype(np.float64)
    is_large = expected > most
    if np.any(is_large):
        spread = np.sqrt(expected) * rng.standard_normal(expected.shape)
        counts = np.where(is_large, expected + spread, counts)
    return counts


@compiled
def _digitised(
    electrons: Array | np.ndarray,
    irradiance: Array | np.ndarray,
    white: ArrayLike,
    read_noise: ArrayLike,
    key: Array | None,
    *,
    full_well: float | None,
    adc_bits: int | None,
) -> Array:
    """Electrons as they are read out, in units of a fully open exposure of white."""
    if full_well is not None:
        is_limit, requirement = 0 < full_well < np.inf, "be above 0 e- and finite"
        require(is_limit, "simulate_capture(full_well=...)", requirement, full_well)
        electrons = jnp.minimum(electrons, full_well)
    if key is not None:
        sigma = jnp.asarray(read_noise, irradiance.dtype)
        electrons = electrons + sigma * jax.random.normal(key, irradiance.shape, irradiance.dtype)
    p = jnp.asarray(white, irradiance.dtype)
    has_light = p > 0
    value = jnp.where(has_light, electrons / jnp.where(has_light, p, 1), irradiance)
    if adc_bits is None:
        return value
    require_positive_int("simulate_capture(adc_bits=...)", adc_bits)
    require(adc_bits <= 24, "simulate_capture(adc_bits=...)", "be at most 24", adc_bits)
    top = jnp.ones_like(p) if full_well is None else full_well / p
    steps = 2**adc_bits - 1
    return jnp.round(jnp.clip(value / top, 0, 1) * steps) / steps * top
