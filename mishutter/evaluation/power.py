"""Power of a picture on the frequency grid, and the share of it that the best filter loses."""

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core import all_concrete, device_constant, is_concrete
from mishutter.model import CORNER_FREQUENCY, Scene, frequencies, on_steps

_DOUBLE = np.dtype(np.float64)


Powers = TypeVar("Powers", Array, np.ndarray)


def picture_power(
    scene: Scene, num_frequencies: int, dtype: np.dtype
) -> Float[Array, "{num_frequencies}"]:
    """The `power_on_grid` of a scene that may be traced."""
    if all_concrete((_numbers(scene), scene.occlusion)):
        return device_constant(power_on_grid(scene, num_frequencies, dtype))
    return jnp.asarray(_power(scene, num_frequencies, dtype))


def power_on_grid(
    scene: Scene, num_frequencies: int, dtype: np.dtype = _DOUBLE
) -> Float[np.ndarray, "{num_frequencies}"]:
    r"""Power spectrum of the picture's rows on the frequency grid.

    $1/(f^2 + 0.01^2)$ for a scene without a spectrum; no power above the cutoff of the optics.
    It is scaled so that $2\int_0^{1/2} S\,df$, its mean over the grid, is the variance.
    """
    return np.asarray(_power(scene, num_frequencies, dtype))


def _power(
    scene: Scene, num_frequencies: int, dtype: np.dtype
) -> Float[Array | np.ndarray, "{num_frequencies}"]:
    if scene.occlusion is not None and scene.occlusion.shares is not None:
        return scene.occlusion.shares.power.astype(dtype)
    numbers = _numbers(scene)
    space = np if all_concrete(numbers) else jnp
    spectrum = spectrum_on_grid(scene, num_frequencies, dtype)
    cutoff, deviation = (space.asarray(x, dtype) for x in numbers[1:])
    frequency = frequencies(num_frequencies).astype(dtype)
    power = space.where(frequency <= cutoff, spectrum, 0)
    total = space.mean(power)
    return power / space.where(total > 0, total, 1.0) * deviation**2


def _numbers(scene: Scene) -> tuple[Array | None, Array, Array]:
    """The numbers that the spectrum is made of."""
    picture = scene.picture
    return picture.power_spectrum, scene.optics.cutoff_frequency, picture.deviation


def spectrum_on_grid(
    scene: Scene, num_frequencies: int, dtype: np.dtype
) -> Float[Array | np.ndarray, "{num_frequencies}"]:
    """The scene's power spectrum, on any scale, or $1/(f^2 + 0.01^2)$; by NumPy if concrete."""
    spectrum = scene.picture.power_spectrum
    if spectrum is None:
        return 1 / (frequencies(num_frequencies).astype(dtype) ** 2 + CORNER_FREQUENCY**2)
    space = np if is_concrete(spectrum) else jnp
    return on_steps(space.asarray(spectrum, dtype), num_frequencies)


def lost_share(
    signal: Float[Powers, "*#shape"],
    coherent: Float[Powers, "*#shape"],
    spread: Float[Powers, "*#shape"],
    noise: Float[Powers, "*#shape"] | float,
) -> Float[Powers, "*#shape"]:
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


def share(
    part: Float[Powers, "*#shape"], total: Float[Powers, "*#shape"], *, of_nothing: float = 1.0
) -> Float[Powers, "*#shape"]:
    """`part / total`, and the share `of_nothing` where both are 0."""
    dark = total <= 0
    if isinstance(total, np.ndarray):
        return np.divide(part, total, where=~dark, out=np.full_like(total, of_nothing))
    # The derivative of a quotient squares its divisor, so the divisor is scaled to nearly 1.
    scale = jax.lax.stop_gradient(1 / jnp.where(dark, 1.0, total))
    return jnp.where(dark, of_nothing, (part * scale) / jnp.where(dark, 1.0, total * scale))
