r"""The largest number at which an increasing function stays within 1, with its derivatives.

It is bracketed by bisection. Between the ends $g(x, p) = 1$ makes it a function of the parameters,

$$\frac{dx}{dp} = -\frac{\partial g/\partial p}{\partial g/\partial x},$$

and derivatives of any order follow, as the rule is made of functions that have them.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_NUM_HALVINGS = 60


@eqx.filter_custom_jvp
def largest_within_one(
    low: Float[Array, ""],
    high: Float[Array, ""],
    parameters: Any,
    *,
    function: Callable[[Float[Array, ""], Any], Float[Array, ""]],
) -> Float[Array, ""]:
    """Largest $x$ of an interval with $g(x, p) <= 1$; the lower end where there is none; scalar.

    Args:
        low: Lower end.
        high: Upper end.
        parameters: $p$, a tree.
        function: $g$, which never falls as $x$ rises.
    """

    def halved(step: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = jnp.where(step == 0, ends[1], (ends[0] + ends[1]) / 2)
        is_within = function(middle, parameters) <= 1
        return jnp.where(is_within, middle, ends[0]), jnp.where(is_within, ends[1], middle)

    return jax.lax.fori_loop(0, _NUM_HALVINGS + 1, halved, (low, high))[0]


@largest_within_one.def_jvp
def _largest_within_one_jvp(
    primals: tuple[Array, Array, Any],
    tangents: tuple[Array | None, Array | None, Any],
    *,
    function: Callable[[Array, Any], Array],
) -> tuple[Array, Array]:
    low, high, parameters = primals
    root = largest_within_one(low, high, parameters, function=function)
    _, slope = jax.jvp(lambda x: function(x, parameters), (root,), (jnp.ones_like(root),))
    _, change = eqx.filter_jvp(lambda p: function(root, p), (parameters,), tangents[2:])
    if change is None:  # the function does not depend on what the parameters' tangents move
        change = jnp.zeros_like(root)
    rises = slope > 0
    between = jnp.where(rises, -change / jnp.where(rises, slope, 1.0), 0.0)
    of_low, of_high = (jnp.zeros_like(root) if t is None else t for t in tangents[:2])
    at_end = jnp.where(root > low, of_high, of_low)
    return root, jnp.where((root > low) & (root < high), between, at_end)
