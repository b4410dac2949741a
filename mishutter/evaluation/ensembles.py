r"""Speeds and accelerations of a scene within its tolerances, and the noise of a shutter's drive.

Each error of the acceleration, $a(1 + \epsilon)$, is a sensor on another parabola. The errors of
the speeds, which include those of the sensor's velocity, are normally distributed with the variance
$\sigma_s^2 + \sigma_v^2 + (2a\sigma_d)^2$ of the speed itself, of the velocity and of a delay $d$,
which is a velocity of $2ad$. Gauss-Hermite rules stand for both distributions.
"""

from collections.abc import Callable
from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.slopes import safe_sqrt
from mishutter.model.motion import AbstractMotion, ParabolicMotion, steady
from mishutter.model.optics import frequency_grid
from mishutter.model.scene import Scene
from mishutter.model.tolerances import Tolerances


def without_tolerances(scene: Scene) -> Scene:
    """The scene of a camera that is built as it was designed."""
    if scene.tolerances is None:
        return scene
    return eqx.tree_at(lambda s: s.tolerances, scene, None)


def ensemble_weights(scene: Scene) -> Float[Array, "rows"]:
    """Weights of the transfer functions of a scene, in their order."""
    if scene.tolerances is None:
        return scene.weights
    return (jnp.asarray(error_weights(scene))[:, None] * scene.weights[None]).ravel()


def error_weights(scene: Scene) -> Float[np.ndarray, "k"]:
    """Frequency of occurrence of each error within the tolerances, the same for all speeds."""
    tolerances = scene.tolerances
    if tolerances is None:
        return np.ones(1, scene.weights.dtype)
    of_acceleration = _normal(tolerances.num_accelerations)[1]
    of_speed = _normal(tolerances.num_speeds)[1]
    return np.multiply.outer(of_acceleration, of_speed).ravel().astype(scene.weights.dtype)


def ensemble_of(
    speeds: Float[Array, "s"], tolerances: Tolerances, motion: AbstractMotion, dtype: np.dtype
) -> tuple[Float[Array, "k"], Float[Array, "k n"]]:
    """Accelerations and speeds within tolerances, in the order of `ensemble_weights`."""
    a = steady(motion).acceleration.astype(dtype)
    acceleration, delay = (x.astype(dtype) for x in (tolerances.acceleration, tolerances.delay))
    epsilon, error = (
        jnp.asarray(_normal(count)[0], dtype)
        for count in (tolerances.num_accelerations, tolerances.num_speeds)
    )
    # No sensor runs backwards: an error beyond the acceleration itself leaves it at rest.
    accelerations = a * jnp.maximum(1 + acceleration * epsilon, 0)
    of_sensor = jnp.where(a != 0, tolerances.velocity.astype(dtype), 0.0)
    constant = tolerances.speed.astype(dtype) ** 2 + of_sensor**2
    deviation = safe_sqrt(constant + (2 * accelerations * delay) ** 2)
    offsets = deviation[:, None] * error[None]
    shifted = offsets[:, :, None] + speeds.astype(dtype)[None, None]
    return accelerations, shifted.reshape(offsets.shape[0], -1)


def at_each_error(
    function: Callable[[AbstractMotion, Float[Array, "n"]], Float[Array, "..."]],
    speeds: Float[Array, "s"],
    tolerances: Tolerances,
    motion: AbstractMotion,
) -> Float[Array, "k ..."]:
    """Values of a function of the motion and speeds at each acceleration of `ensemble_of`."""
    dtype = np.dtype(speeds.dtype)
    half = motion.half_exposure.astype(dtype)

    def at_error(acceleration: Float[Array, ""], speeds: Float[Array, "n"]) -> Float[Array, "..."]:
        own = ParabolicMotion(acceleration=acceleration, half_exposure=half)
        return function(own, speeds)

    return jax.vmap(at_error)(*ensemble_of(speeds, tolerances, motion, dtype))


def drive_variance(
    scene: Scene, motion: AbstractMotion, efficiency: Float[Array, ""], num_frequencies: int
) -> Float[Array, "{num_frequencies}"]:
    r"""Variance of a transfer function by errors of the transmittance.

    Errors of variance $\sigma^2$ in steps of $\Delta$ add $\frac1{2T}\int_{\text{step}}
    e^{-2\pi i f x}dt$ each, so that the variance of their sum is $\sigma^2\frac{\Delta}{2T}$ times
    the mean over the exposure of $\operatorname{sinc}^2(f\,\dot x\,\Delta)$, but for the curvature
    of the path within a step. On a parabola the velocities $\dot x$ are uniformly distributed
    over $-s \pm 2aT$. A shutter that passes all light has no drive.
    """
    dtype = np.dtype(efficiency.dtype)
    tolerances = scene.tolerances
    if tolerances is None:
        return jnp.zeros(num_frequencies, dtype)
    # 32 velocities give the noise to 1e-6 of it, for light that crosses up to 8 px in a step.
    nodes, shares = (x.astype(dtype) for x in np.polynomial.legendre.leggauss(32))
    step = jnp.minimum(tolerances.drive_step.astype(dtype), motion.exposure.astype(dtype))
    velocity = motion.speed_gain.astype(dtype) * nodes[None] - scene.speeds.astype(dtype)[:, None]
    frequency = frequency_grid(num_frequencies, dtype)
    attenuation = jnp.sinc(frequency[:, None, None] * (step * velocity)[None]) ** 2
    weights = scene.weights.astype(dtype)[:, None] * (shares / 2)[None]
    mean = jnp.sum(attenuation * weights[None], axis=(1, 2))
    variance = tolerances.transmittance.astype(dtype) ** 2 * (step / motion.exposure.astype(dtype))
    return jnp.where(efficiency < 1, variance, 0.0) * mean


@lru_cache
def _normal(count: int) -> tuple[Float[np.ndarray, "{count}"], Float[np.ndarray, "{count}"]]:
    """Nodes and weights of the Gauss-Hermite rule of the standard normal distribution."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(count)
    return nodes, weights / weights.sum()
