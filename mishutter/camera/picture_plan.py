"""Equal colours of a picture, computed once and copied to every channel."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import is_concrete
from mishutter.evaluation import Automatic, Plan, require_plan


def skips(plan: Plan | Automatic | None) -> bool:
    """Whether an argument `plan=` leaves out what changes nothing."""
    require_plan(plan)
    return plan.skips if isinstance(plan, Plan) else plan is not None


def distinct_colours(light: Array, plan: Plan | Automatic | None) -> Array:
    """A picture, or one of its colours where all are the same and `plan` skips.

    Args:
        light: Shape `(rows, columns)` or `(..., rows, columns, channels)`.
        plan: The caller's own argument `plan=`.

    Returns:
        Shape of `light`, with one channel where the colours are equal.
    """
    if not (skips(plan) and light.ndim > 2 and light.shape[-1] > 1 and is_concrete(light)):
        return light
    colours = np.asarray(light)
    alike = bool(np.all(colours == colours[..., :1]))
    return jnp.asarray(colours[..., :1]) if alike else light


def every_colour(light: Array, like: ArrayLike) -> Array:
    """`light` with as many channels as `like`."""
    if light.ndim < 3 or light.shape[-1] == jnp.shape(like)[-1]:
        return light
    return jnp.broadcast_to(light, (*light.shape[:-1], jnp.shape(like)[-1]))
