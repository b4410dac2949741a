"""The part of the gain by being told the speed that a decoder keeps which finds it in the picture.

Photographs of many cameras say how large it is (`benchmarks/speed.py`). A speed shows where the
blur differs over the speeds by more than a photograph may be soft by itself.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core import as_array_like, namespace_of
from mishutter.model import AbstractMotion, Scene

FOUND_SHARE = 0.8
"""Share of the gain by being told the speed, in decibels, that a decoder keeps which finds it."""
LEAST_DIFFERENCE = 29.0
"""Smear, px, up to whose difference no speed is found: a photograph may be as soft by itself."""
_ENOUGH_DIFFERENCE = 36.0
"""Smear, px, from whose difference on the whole `FOUND_SHARE` of the gain is kept."""

Number = Float[Array | np.ndarray, ""] | float
"""One number, of NumPy where it is known."""
Speeds = Float[Array | np.ndarray, "n"]


def open_time(scene: Scene, half_exposure: Number, efficiency: Number) -> Number:
    r"""Time for which an open shutter would let as much light through, $2T\eta/t$; s, scalar.

    Args:
        scene: The scene, whose device has the transmission $t$: an open shutter needs none.
        half_exposure: $T$; s.
        efficiency: Throughput $\eta$ behind the device.
    """
    open_share = efficiency
    if scene.device is not None:
        transmission = as_array_like(efficiency, scene.device.transmission)
        open_share = namespace_of(efficiency).minimum(efficiency / transmission, 1.0)
    return 2 * as_array_like(efficiency, half_exposure) * open_share


def smear_difference(speeds: Speeds, weights: Speeds, open_time: Number) -> Number:
    r"""Difference of the smear over an exposure between the fastest and the slowest object; px.

    $\max|s| - \min|s|$ over the speeds that occur, as both signs of one have blurs of one size,
    times the `open_time`: dark ends of an exposure tell no speed.

    Args:
        speeds: Speeds $s$ relative to the sensor; px/s.
        weights: Probability of each.
        open_time: The time; s.
    """
    space, sizes, occurs = namespace_of(speeds), abs(speeds), weights > 0
    slowest = space.min(space.where(occurs, sizes, np.inf))
    return open_time * (space.max(space.where(occurs, sizes, 0.0)) - slowest)


def found_share(difference: Number, share: float = FOUND_SHARE) -> Number:
    r"""Share of the gain by being told the speed that a decoder keeps which finds it, in decibels.

    0 up to $d_0$ = 29 px of the `smear_difference` $d$, where the blur differs too little over the
    speeds to tell one; $(3 - 2x)x^2$ of the whole share, $x = (d - d_0)/(d_1 - d_0)$, to $d_1$ = 36
    px; and all of it from there on.

    Args:
        difference: $d$; px.
        share: The share where the blur differs by enough.
    """
    x = (difference - LEAST_DIFFERENCE) / (_ENOUGH_DIFFERENCE - LEAST_DIFFERENCE)
    x = namespace_of(difference).clip(x, 0.0, 1.0)
    return share * (3 - 2 * x) * x**2


def found_psnr(untold: ArrayLike, told: ArrayLike, share: ArrayLike) -> Float[Array, ""]:
    """PSNR expected of a decoder that finds the speed, by those of two others; dB.

    Args:
        untold: PSNR of one filter for all speeds; dB.
        told: PSNR of a filter that is told the speed; dB.
        share: The `found_share`.
    """
    untold, told = jnp.asarray(untold), jnp.asarray(told)
    share = jnp.asarray(share, told.dtype)
    return jnp.where(told == untold, untold, untold + share * (told - untold))


def found_share_of(
    scene: Scene, motion: AbstractMotion, efficiency: Number, share: float = FOUND_SHARE
) -> Float[Array, ""]:
    """The `found_share` of a throughput, of a scene in the frame of the sensor."""
    time = open_time(scene, motion.half_exposure, efficiency)
    return jnp.asarray(found_share(smear_difference(scene.speeds, scene.weights, time), share))
