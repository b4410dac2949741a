"""Share of the gain from knowing the speed that a decoder keeps if it finds the speed itself.

`benchmarks/speed.py` measures the share on photographs, for several cameras. A speed can be found
only if the blur differs between speeds by more than the softness that a photograph has of its own.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import as_array_like, namespace_of
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene

FOUND_SHARE = 0.8
"""Share of the gain from knowing the speed, in decibels, that a speed-finding decoder keeps."""
LEAST_DIFFERENCE = 29.0
"""Greatest `smear_difference` at which no speed is found: photographs may be as soft; px."""

Number = Float[Array | np.ndarray, ""] | float
"""One number; a NumPy scalar where it is concrete."""
Speeds = Float[Array | np.ndarray, "n"]


def open_time(scene: Scene, half_exposure: Number, efficiency: Number) -> Number:
    r"""Time in which an open shutter would pass as much light, $2T\eta/t$; s, scalar."""
    # An open shutter needs no device, and loses none of its light.
    open_share = efficiency
    if scene.device is not None:
        transmission = as_array_like(efficiency, scene.device.transmission)
        open_share = namespace_of(efficiency).minimum(efficiency / transmission, 1.0)
    return 2 * as_array_like(efficiency, half_exposure) * open_share


def smear_difference(speeds: Speeds, weights: Speeds, open_time: Number) -> Number:
    r"""Difference of the smear over an exposure between the fastest and the slowest object; px.

    $\max|s| - \min|s|$ over the speeds that occur, times the `open_time`. The sign does not count,
    because $s$ and $-s$ smear equally far; nor do dark ends of the exposure, which tell no speed.
    """
    space, sizes, occurs = namespace_of(speeds), abs(speeds), weights > 0
    slowest = space.min(space.where(occurs, sizes, np.inf))
    return open_time * (space.max(space.where(occurs, sizes, 0.0)) - slowest)


def found_share(difference: Number, share: float = FOUND_SHARE) -> Number:
    r"""Share of the gain from knowing the speed, in decibels, that finding the speed keeps.

    It depends on the `smear_difference` $d$. Up to $d_0$ = 29 px it is 0, as the blur differs too
    little between speeds to tell them apart. From there to $d_1$ = 36 px it is $(3 - 2x)x^2$ of
    the whole share, with $x = (d - d_0)/(d_1 - d_0)$; beyond, it is the whole share.
    """
    x = (difference - LEAST_DIFFERENCE) / (36.0 - LEAST_DIFFERENCE)
    # The cubic has slopes of 0 at both ends, so that a search meets no kink.
    x = namespace_of(difference).clip(x, 0.0, 1.0)
    return share * (3 - 2 * x) * x**2


def found_psnr(unknown: ArrayLike, known: ArrayLike, share: ArrayLike) -> Float[Array, ""]:
    """PSNR expected of a decoder that finds the speed, from the PSNRs of two others; dB."""
    unknown, known = jnp.asarray(unknown), jnp.asarray(known)
    share = jnp.asarray(share, known.dtype)
    # Two levels that are infinite have no difference: it would be NaN.
    return jnp.where(known == unknown, unknown, unknown + share * (known - unknown))


def found_share_of(
    scene: Scene, motion: AbstractMotion, efficiency: Number, share: float = FOUND_SHARE
) -> Float[Array, ""]:
    """The `found_share` of a camera with this throughput; the scene is in the sensor's frame."""
    return jnp.asarray(found_share(smear_difference_of(scene, motion, efficiency), share))


def smear_difference_of(scene: Scene, motion: AbstractMotion, efficiency: Number) -> Number:
    """The `smear_difference` of a camera with this throughput, in the sensor's frame; px."""
    time = open_time(scene, motion.half_exposure, efficiency)
    return smear_difference(scene.speeds, scene.weights, time)
