r"""Speeds and accelerations of a scene within its tolerances, and the noise of a shutter's drive.

Each error of the acceleration, $a(1 + \epsilon)$, is a sensor on another parabola. About each of
the scene's speeds lie those of all errors that a speed may have, normally distributed with the
variance $\sigma_s^2 + \sigma_v^2 + (2a\sigma_d)^2$: that of the speed itself, of the velocity and
of a delay $d$, which is a velocity of $2ad$. Gauss-Hermite rules stand for both distributions.
"""

from collections.abc import Callable
from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter.blur import safe_sqrt
from mishutter.model import (
    AbstractMotion,
    ParabolicMotion,
    Scene,
    Tolerances,
    frequency_grid,
    steady,
)

_NUM_VELOCITIES = 32
"""Velocities over an exposure at which the noise of a drive is taken: to 1e-6 of it where light
crosses up to 8 px in a step."""


def without_tolerances(scene: Scene) -> Scene:
    """The scene of a camera that is built as it was designed."""
    if scene.tolerances is None:
        return scene
    return eqx.tree_at(lambda s: s.tolerances, scene, None)


def ensemble_weights(scene: Scene) -> Array:
    """Weights of the transfer functions of a scene, in their order; shape `(k * n,)`."""
    if scene.tolerances is None:
        return scene.weights
    return (jnp.asarray(error_weights(scene))[:, None] * scene.weights[None]).ravel()


def error_weights(scene: Scene) -> np.ndarray:
    """How often each error within the tolerances occurs, whatever the speed; shape `(k,)`."""
    tolerances = scene.tolerances
    if tolerances is None:
        return np.ones(1, scene.weights.dtype)
    of_acceleration = _normal(tolerances.num_accelerations)[1]
    of_speed = _normal(tolerances.num_speeds)[1]
    return np.multiply.outer(of_acceleration, of_speed).ravel().astype(scene.weights.dtype)


def ensemble_of(
    speeds: Array, tolerances: Tolerances, motion: AbstractMotion, dtype: np.dtype
) -> tuple[Array, Array]:
    """Accelerations and speeds within tolerances, in the order of `ensemble_weights`.

    Args:
        speeds: Speeds of the scene, px/s; shape `(s,)`.
        tolerances: Tolerances, `seen_from` the motion.
        motion: Motion of the sensor, without velocity.
        dtype: Precision of the results.

    Returns:
        Accelerations, px/s^2, shape `(k,)`, and speeds at each of them, px/s, shape `(k, n)`.
    """
    a = steady(motion).acceleration.astype(dtype)
    of = {name: getattr(tolerances, name).astype(dtype) for name in ("acceleration", "delay")}
    epsilon, error = (
        jnp.asarray(_normal(count)[0], dtype)
        for count in (tolerances.num_accelerations, tolerances.num_speeds)
    )
    # No sensor runs backwards: an error beyond the acceleration itself leaves it at rest.
    accelerations = a * jnp.maximum(1 + of["acceleration"] * epsilon, 0)
    of_sensor = jnp.where(a > 0, tolerances.velocity.astype(dtype), 0.0)
    constant = tolerances.speed.astype(dtype) ** 2 + of_sensor**2
    deviation = safe_sqrt(constant + (2 * accelerations * of["delay"]) ** 2)
    offsets = deviation[:, None] * error[None]
    shifted = offsets[:, :, None] + speeds.astype(dtype)[None, None]
    return accelerations, shifted.reshape(offsets.shape[0], -1)


def at_each_error(
    function: Callable[[AbstractMotion, Array], Array],
    speeds: Array,
    tolerances: Tolerances,
    motion: AbstractMotion,
) -> Array:
    """Values of a function of the motion and speeds at each acceleration of `ensemble_of`.

    Args:
        function: Function of a motion and of speeds, px/s, shape `(n,)`.
        speeds: Speeds of the scene, px/s; shape `(s,)`.
        tolerances: Tolerances, `seen_from` the motion.
        motion: Motion of the sensor, without velocity.
    """
    dtype = np.dtype(speeds.dtype)
    half = motion.half_exposure.astype(dtype)

    def at_error(acceleration: Array, speeds: Array) -> Array:
        moved = ParabolicMotion(acceleration=acceleration, half_exposure=half)
        return function(moved, speeds)

    return jax.vmap(at_error)(*ensemble_of(speeds, tolerances, motion, dtype))


def drive_variance(
    scene: Scene, motion: AbstractMotion, efficiency: Array, num_frequencies: int
) -> Array:
    r"""Variance of a transfer function by errors of the transmittance; shape `(m,)`.

    Errors of variance $\sigma^2$ in steps of $\Delta$ add $\frac1{2T}\int_{\text{step}}
    e^{-2\pi i f x}dt$ each, so that the variance of their sum is $\sigma^2\frac{\Delta}{2T}$ times
    the mean over the exposure of $\operatorname{sinc}^2(f\,\dot x\,\Delta)$, but for the curvature
    of the path within a step. On a parabola the velocities $\dot x$ are uniformly distributed
    over $-s \pm 2aT$. A shutter that lets all light through has no drive.
    """
    dtype = np.dtype(efficiency.dtype)
    tolerances = scene.tolerances
    if tolerances is None:
        return jnp.zeros(num_frequencies, dtype)
    nodes, shares = (x.astype(dtype) for x in np.polynomial.legendre.leggauss(_NUM_VELOCITIES))
    step = jnp.minimum(tolerances.drive_step.astype(dtype), motion.exposure.astype(dtype))
    velocity = motion.speed_gain.astype(dtype) * nodes[None] - scene.speeds.astype(dtype)[:, None]
    frequency = frequency_grid(num_frequencies, dtype)
    passed = jnp.sinc(frequency[:, None, None] * (step * velocity)[None]) ** 2
    weights = scene.weights.astype(dtype)[:, None] * (shares / 2)[None]
    mean = jnp.sum(passed * weights[None], axis=(1, 2))
    variance = tolerances.transmittance.astype(dtype) ** 2 * (step / motion.exposure.astype(dtype))
    return jnp.where(efficiency < 1, variance, 0.0) * mean


@lru_cache
def _normal(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Hermite rule of the standard normal distribution; shape `(count,)` each."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return nodes, weights / weights.sum()
