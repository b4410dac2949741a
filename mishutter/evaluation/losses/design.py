"""The weighted loss of condition number, invariance and efficiency."""

from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import is_concrete, require
from mishutter.evaluation.losses.base import AbstractResponseLoss, Parts
from mishutter.evaluation.metrics import kernel_differences
from mishutter.evaluation.needs import Plan
from mishutter.evaluation.response import Response
from mishutter.model import AbstractMotion, Scene

_SHARPNESS = 200


def _plain(weight: Any) -> Any:
    """The number in a scalar array whose value is known; other weights as they are."""
    scalar = is_concrete(weight) and np.ndim(weight) == 0 and hasattr(weight, "dtype")
    return weight.item() if scalar else weight


@final
class DesignLoss(AbstractResponseLoss):
    r"""$w_1\,\tilde\kappa + w_2\,\Delta + w_3\,(1 - \eta)$.

    $\tilde\kappa$ is the condition number of the still object's kernel with its maximum
    and minimum smoothed, $\Delta$ the relative cross-speed kernel difference and $\eta$
    the efficiency. All are dimensionless; dimming the shutter leaves the first two as
    they are and raises the third, so closing it gains nothing.

    With $P_f = |H(f)|^2$ over $F$ DFT frequencies and $\beta = 200$,
    $\tilde\kappa^2 = (\sum P_f^\beta)^{1/\beta} (\sum P_f^{-\beta})^{1/\beta}$, hence
    $\kappa \le \tilde\kappa \le F^{1/\beta}\kappa$: at most 2.5 % too large for 129
    frequencies. The DFT is as long for every motion, as the scene's limits let kernels be:
    a longer kernel is folded onto it. A spectral zero counts as
    $|H| = \varepsilon\max|H|$, the working precision.

    It knows nothing of light and noise: of a camera at rest it is least at the shortest
    exposure. A search by it moves the profile alone unless it is told otherwise, on a motion
    that the expected error has chosen.

    Args:
        condition: $w_1$, at least 0; a number, not an array that is traced.
        invariance: $w_2$, at least 0.
        efficiency: $w_3$, at least 0.

    Raises:
        ValueError: if a weight is negative or not finite.
    """

    condition: float = eqx.field(default=0.1, converter=_plain)
    invariance: float = eqx.field(default=1.0, converter=_plain)
    efficiency: float = eqx.field(default=1.0, converter=_plain)

    def __check_init__(self) -> None:
        requirement = "be a finite plain number of at least 0"
        for name in ("condition", "invariance", "efficiency"):
            value = getattr(self, name)
            number = isinstance(value, int | float) and 0 <= value < float("inf")
            require(number, f"DesignLoss({name}=...)", requirement, value)

    @property
    def sees_light(self) -> bool:
        return False

    def parts(self, plan: Plan) -> Parts:
        every = not plan.skips
        moving = every or bool(self.invariance)
        return Parts(moving or bool(self.condition), spectra=False, differences=moving)

    def of_response(
        self, scene: Scene, motion: AbstractMotion, response: Response, plan: Plan
    ) -> Array:
        loss = self.efficiency * (1 - response.efficiency)
        if self.condition:
            loss += self.condition * smooth_condition_number(response.still_spectrum)
        if self.invariance:
            loss += self.invariance * kernel_differences(scene, motion, response)[1]
        return loss


def smooth_condition_number(spectrum: Array) -> Array:
    """Condition number with soft extremes; see `DesignLoss` for its bounds. Scalar."""
    power = spectrum.real**2 + spectrum.imag**2
    brightest = jax.lax.stop_gradient(jnp.max(power))
    lit = brightest > 0
    floor = jnp.finfo(power.dtype).eps ** 2
    share = jnp.where(lit, power / jnp.where(lit, brightest, 1.0), 0) + floor
    least = jax.lax.stop_gradient(jnp.min(share))
    # Powers by repeated squaring, of numbers up to 1, are many times quicker than exponentials
    # of logarithms.
    sums = jnp.sum(share**_SHARPNESS) * jnp.sum((least / share) ** _SHARPNESS)
    logarithm = jnp.log(sums) / _SHARPNESS - jnp.log(least)
    return jnp.where(lit, jnp.exp(logarithm / 2), 1 / jnp.finfo(power.dtype).eps)
