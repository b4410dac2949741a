"""The loss and its gradient at points of the unit box, and a polish of the best of them."""

import warnings
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter.compiling import quick_to_compile
from mishutter.objective import AbstractObjective

_MEMORY = 10
"""Steps that L-BFGS-B remembers; more than coordinates say nothing new, and each number of them
has JAX compile what jaxopt makes of it."""


class NonFiniteLossError(ArithmeticError):
    """A loss or its gradient was not finite where the solver had to know it."""


def check_finite(finite: Array | np.ndarray) -> None:
    """Raise `NonFiniteLossError`, with the first of those starts that are not finite."""
    bad = np.flatnonzero(~np.asarray(finite))
    if bad.size:
        raise NonFiniteLossError(
            f"The loss and its gradient must be finite; got a NaN or an infinity from start "
            f"{bad[0]} ({bad.size} of {np.asarray(finite).size} starts)."
        )


@quick_to_compile
def loss_and_gradient(objective: AbstractObjective, box: Array | np.ndarray) -> tuple[Array, Array]:
    """Loss and gradient at a point of the box; scalar and `(size,)`."""
    return jax.value_and_grad(objective)(jnp.asarray(box))


def losses_at(objective: AbstractObjective, boxes: np.ndarray) -> np.ndarray:
    """Losses at a few points, by the program that the polish needs anyway; shape `(n,)`.

    Raises:
        NonFiniteLossError: if a loss or its gradient is not finite.
    """
    pairs = [loss_and_gradient(objective, box) for box in boxes]
    check_finite(np.array([np.isfinite(f) and np.all(np.isfinite(g)) for f, g in pairs]))
    return np.array([float(loss) for loss, _ in pairs])


def projected_gradient_norm(box: np.ndarray, gradient: np.ndarray) -> float:
    r"""$\max|x - P(x - g)|$, the certificate of a minimum in the box: 0 at one."""
    return float(np.max(np.abs(box - np.clip(box - gradient, 0, 1)), initial=0.0))


def certificate_at(objective: AbstractObjective, box: np.ndarray) -> float:
    """The projected-gradient norm at a point of the box."""
    return projected_gradient_norm(box, np.asarray(loss_and_gradient(objective, box)[1]))


class Polished(NamedTuple):
    """A point after the polish, its loss, its certificate and the steps it took."""

    box: np.ndarray
    loss: float
    certificate: float
    num_steps: int


def polish(objective: AbstractObjective, box: np.ndarray, *, max_steps: int) -> Polished:
    """Jaxopt's box-constrained L-BFGS-B, in the box's own coordinates.

    Raises:
        NonFiniteLossError: if the loss or gradient is not finite on the way.
    """

    def value_and_gradient(x):
        loss, gradient = loss_and_gradient(objective, np.asarray(x, box.dtype))
        if not (np.isfinite(loss) and np.all(np.isfinite(gradient))):
            raise NonFiniteLossError(
                "The loss and its gradient must be finite; got a NaN or an infinity "
                "while polishing."
            )
        return loss, gradient

    solver = imported_jaxopt().ScipyBoundedMinimize(
        fun=value_and_gradient,
        value_and_grad=True,
        method="L-BFGS-B",
        maxiter=max_steps,
        jit=False,
        tol=1e-9,
        options={"maxcor": min(_MEMORY, box.size)},
    )
    low, high = np.zeros_like(box), np.ones_like(box)
    point, info = solver.run(jax.device_put(box), bounds=(low, high))
    point = np.clip(np.asarray(point), 0, 1)
    loss, gradient = value_and_gradient(point)
    certificate = projected_gradient_norm(point, np.asarray(gradient))
    return Polished(point, float(loss), certificate, int(info.iter_num))


@lru_cache
def imported_jaxopt() -> Any:
    """Jaxopt, without its farewell."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import jaxopt
    return jaxopt
