"""The loss and its gradient at points of the unit box, and a polish of the best of them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike

from mishutter._core import compiled
from mishutter.search.objective import AbstractObjective
from mishutter.search.space import Bends

_MEMORY = 30
"""Steps that L-BFGS-B remembers; more than coordinates say nothing new."""
_TOLERANCE = 1e-9
_SOLVER, _MARGIN = optx.BFGS(rtol=1e-7, atol=1e-7), 0.02
_CERTIFIED = 1e-3
"""Largest projected gradient of a minimum, as a share of the loss."""
_GAP = 64
"""Roundings of a coordinate off a bend, where a loss knows which side it is on."""
_NEAR = 1e-3
"""Distance from a bend within which a polish beside it begins at it: one that was held up by a
kink ends so close that the way there is too short to be told from none."""


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


def loss_and_gradient(
    objective: AbstractObjective, box: Array | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Loss and gradient at a point of the box; scalar and `(size,)`."""
    loss, gradient = _loss_and_gradient(objective, box)
    return np.asarray(loss), np.asarray(gradient)


@compiled
def _loss_and_gradient(objective: AbstractObjective, box: ArrayLike) -> tuple[Array, Array]:
    return jax.value_and_grad(objective)(jnp.asarray(box))


def losses_at(objective: AbstractObjective, boxes: np.ndarray) -> np.ndarray:
    """Losses at a few points, by the program that the polish needs anyway; shape `(n,)`.

    Raises:
        NonFiniteLossError: if a loss or its gradient is not finite.
    """
    each = [loss_and_gradient(objective, box) for box in boxes]
    losses, gradients = (np.stack(part) for part in zip(*each, strict=True))
    check_finite(np.isfinite(losses) & np.all(np.isfinite(gradients), axis=1))
    return losses


def projected_gradient_norm(box: np.ndarray, gradient: np.ndarray) -> float:
    r"""$\max|x - P(x - g)|$, the certificate of a minimum in the box: 0 at one."""
    return float(np.max(np.abs(box - np.clip(box - gradient, 0, 1)), initial=0.0))


def certificate_at(objective: AbstractObjective, box: np.ndarray, bends: Bends) -> float:
    """The projected-gradient norm at a point of the box.

    At a bend it is that of the slopes by which the loss falls on either side: none at a
    minimum, though the slopes differ and neither is 0.
    """
    before, after = _beside(box, bends)
    slopes = [np.array(loss_and_gradient(objective, side)[1]) for side in (before, after)]
    if before is not after:
        for slope, clip in zip(slopes, (np.maximum, np.minimum), strict=True):
            slope[bends.coordinate] = clip(slope[bends.coordinate], 0)
    return max(projected_gradient_norm(box, slope) for slope in slopes)


def _beside(box: np.ndarray, bends: Bends) -> tuple[np.ndarray, np.ndarray]:
    """Points before and after a bend that a point lies at, or itself twice where it lies at none.

    Next to a bend roundings tell which side a point is on.
    """
    gap = _GAP * np.finfo(box.dtype).eps
    for place in bends.places:
        if abs(box[bends.coordinate] - place) <= 2 * gap:
            before, after = box.copy(), box.copy()
            before[bends.coordinate] = max(place - gap, 0)
            after[bends.coordinate] = min(place + gap, 1)
            return before, after
    return box, box


def minimise(
    objective: AbstractObjective, box: np.ndarray, *, max_steps: int
) -> tuple[np.ndarray, int]:
    r"""A minimum by Optimistix BFGS, and the steps it took.

    The box is reached through $x = \sin^2\theta$, whose bounds are ordinary points: a
    solver arrives there, and leaves again, at finite $\theta$. A start on a bound, where
    the derivative by $\theta$ vanishes, is moved inside by 0.02.

    Args:
        objective: The function to be minimised.
        box: Where to begin; shape `(size,)`.
        max_steps: Steps, at most.
    """
    point, num_steps = _minimised(objective, box, max_steps)
    return np.asarray(point), int(num_steps)


@compiled
def _minimised(objective: AbstractObjective, box: ArrayLike, max_steps: int) -> tuple[Array, Array]:
    box = jnp.asarray(box)

    def loss(theta: Array, _: None) -> Array:
        return objective(jnp.sin(theta).astype(box.dtype) ** 2).astype(theta.dtype)

    # Optimistix takes JAX's default precision for its step size, whatever that of the angles.
    theta = jnp.arcsin(jnp.sqrt(jnp.clip(box, _MARGIN, 1 - _MARGIN))).astype(float)
    end = optx.minimise(loss, _SOLVER, theta, max_steps=max_steps, throw=False)
    return jnp.sin(end.value).astype(box.dtype) ** 2, end.stats["num_steps"]


class Polished(NamedTuple):
    """A point after the polish, its loss and certificate, and the loss after each step."""

    box: np.ndarray
    loss: float
    certificate: float
    history: np.ndarray

    @property
    def num_steps(self) -> int:
        """How many steps it took."""
        return self.history.size


def is_minimum(certificate: float, loss: float) -> bool:
    """Whether a projected-gradient norm is small enough for a minimum of such a loss."""
    return certificate <= _CERTIFIED * abs(loss)


def polish(
    objective: AbstractObjective,
    box: np.ndarray,
    *,
    max_steps: int,
    low: np.ndarray | None = None,
    high: np.ndarray | None = None,
) -> Polished:
    """SciPy's box-constrained L-BFGS-B, in the box's own coordinates.

    The loss is divided by its value at the start: the solver's tolerances are absolute, and
    would stop it short where the light is bright and the loss small.

    Args:
        objective: The function to be minimised.
        box: Where to begin; shape `(size,)`.
        max_steps: Steps, at most.
        low: Bounds in place of those of the unit box, inside it; shape `(size,)`.
        high: The same above.

    Raises:
        NonFiniteLossError: if the loss or gradient is not finite on the way.
    """
    from scipy.optimize import minimize

    def value_and_gradient(x):
        loss, gradient = loss_and_gradient(objective, np.asarray(x, box.dtype))
        if not (np.isfinite(loss) and np.all(np.isfinite(gradient))):
            raise NonFiniteLossError(
                "The loss and its gradient must be finite; got a NaN or an infinity "
                "while polishing."
            )
        return loss, gradient

    unit, history = 0.0, []

    def relative(x):
        nonlocal unit
        loss, gradient = value_and_gradient(x)
        unit = unit or abs(float(loss)) or 1.0
        return float(loss / unit), np.asarray(gradient / unit, np.float64)

    low = np.zeros_like(box) if low is None else low
    high = np.ones_like(box) if high is None else high
    end = minimize(
        relative,
        np.clip(box, low, high),
        jac=True,
        method="L-BFGS-B",
        bounds=np.stack([low, high], axis=1),
        tol=_TOLERANCE,
        options={"maxiter": max_steps, "maxcor": min(_MEMORY, box.size)},
        callback=lambda intermediate_result: history.append(intermediate_result.fun * unit),
    )
    point = np.clip(end.x.astype(box.dtype), low, high)
    loss, gradient = value_and_gradient(point)
    certificate = projected_gradient_norm(point, np.asarray(gradient))
    return Polished(point, float(loss), certificate, np.array(history))


def finished(
    objective: AbstractObjective, end: Polished, bends: Bends, *, max_steps: int
) -> Polished:
    """A polish that stopped short of a minimum, gone on with.

    It is begun anew, which forgets curvatures that mislead it, then on either side of
    the nearest bend: a kink holds up a solver that takes slopes for those all around.

    Raises:
        NonFiniteLossError: if the loss or gradient is not finite on the way.
    """
    end = end._replace(certificate=certificate_at(objective, end.box, bends))
    for low, high in _sides(end.box, bends):
        if is_minimum(end.certificate, end.loss) or end.num_steps >= max_steps:
            break
        left = max_steps - end.num_steps
        near_low, near_high = end.box - low < _NEAR, high - end.box < _NEAR
        start = np.where((low > 0) & near_low, low, np.where((high < 1) & near_high, high, end.box))
        found = polish(objective, start, max_steps=left, low=low, high=high)
        if found.loss <= end.loss:
            certificate = certificate_at(objective, found.box, bends)
            history = np.concatenate([end.history, found.history])
            end = Polished(found.box, found.loss, certificate, history)
    return end


def _sides(box: np.ndarray, bends: Bends) -> list[tuple[np.ndarray, np.ndarray]]:
    """Bounds of the whole box, and of its parts before and after the bend nearest to a point."""
    low, high = np.zeros_like(box), np.ones_like(box)
    if not bends.places.size:
        return [(low, high)]
    nearest = bends.places[np.argmin(np.abs(bends.places - box[bends.coordinate]))]
    gap = _GAP * np.finfo(box.dtype).eps
    to_bend, from_bend = high.copy(), low.copy()
    to_bend[bends.coordinate] = max(nearest - gap, 0)
    from_bend[bends.coordinate] = min(nearest + gap, 1)
    return [(low, high), (low, to_bend), (from_bend, high)]
