"""Power of a picture on the frequency grid, and the share of it that the best filter loses."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import all_concrete, device_constant, is_concrete, namespace_of
from mishutter.model import CORNER_FREQUENCY, Scene, frequencies, on_steps

_DOUBLE = np.dtype(np.float64)


def picture_power(scene: Scene, num_frequencies: int, dtype: np.dtype) -> Array:
    """The `power_on_grid` of a scene that may be traced."""
    given = scene.power_spectrum, scene.cutoff_frequency, scene.deviation, scene.occlusion
    known = all_concrete(given)
    if known:
        return device_constant(power_on_grid(scene, num_frequencies, dtype))
    return jnp.asarray(_power(scene, num_frequencies, dtype))


def power_on_grid(scene: Scene, num_frequencies: int, dtype: np.dtype = _DOUBLE) -> np.ndarray:
    r"""Power spectrum of the picture's rows on the frequency grid; shape `(m,)`.

    $1/(f^2 + 0.01^2)$ where the scene brings none; no power above the cutoff of the optics.
    It is scaled so that $2\int_0^{1/2} S\,df$, its mean over the grid, is the variance.
    """
    return np.asarray(_power(scene, num_frequencies, dtype))


def _power(scene: Scene, num_frequencies: int, dtype: np.dtype) -> Any:
    if scene.occlusion is not None and scene.occlusion.shares is not None:
        return scene.occlusion.shares.power.astype(dtype)
    given = scene.power_spectrum, scene.cutoff_frequency, scene.deviation
    space = np if all_concrete(given) else jnp
    spectrum = spectrum_on_grid(scene, num_frequencies, dtype)
    cutoff, deviation = (space.asarray(x, dtype) for x in given[1:])
    frequency = frequencies(num_frequencies).astype(dtype)
    power = space.where(frequency <= cutoff, spectrum, 0)
    total = space.mean(power)
    lit = total > 0
    return power / space.where(lit, total, 1.0) * deviation**2


def spectrum_on_grid(scene: Scene, num_frequencies: int, dtype: np.dtype) -> Array | np.ndarray:
    """Power that the scene brings, on any scale, or $1/(f^2 + 0.01^2)$; by NumPy where known."""
    given = scene.power_spectrum
    if given is None:
        return 1 / (frequencies(num_frequencies).astype(dtype) ** 2 + CORNER_FREQUENCY**2)
    space = np if is_concrete(given) else jnp
    return on_steps(space.asarray(given, dtype), num_frequencies)


def lost_share(signal: Any, coherent: Any, spread: Any, noise: Any) -> Any:
    r"""Share of the picture's power that the best single linear filter loses; of any shape.

    $(Sv + N)/(S(|m|^2 + v) + N)$, which the filter $G = S\bar m/(S(|m|^2 + v) + N)$ leaves. No
    term of this form cancels another. All is lost where there is neither signal nor noise.

    Args:
        signal: Power of the picture, $S$.
        coherent: Power of the mean response over speeds, $|m|^2$.
        spread: Variance of the response over speeds, $v$.
        noise: Power of the noise, $N$.
    """
    return share(signal * spread + noise, signal * (coherent + spread) + noise)


def share(part: Any, total: Any) -> Any:
    """`part / total`, and 1 where both are 0."""
    space, dark = namespace_of(total), total <= 0
    if space is np:
        return np.divide(part, total, where=~dark, out=np.ones_like(total))
    # The derivative of a quotient squares its divisor, so the divisor is scaled to nearly 1.
    scale = jax.lax.stop_gradient(1 / jnp.where(dark, 1.0, total))
    return jnp.where(dark, 1.0, (part * scale) / jnp.where(dark, 1.0, total * scale))
