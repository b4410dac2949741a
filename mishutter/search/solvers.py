"""The loss and its gradient at points of the unit box, and a polish of the best of them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from mishutter._core.compiling import compiled
from mishutter.search.objective import AbstractObjective
from mishutter.search.space import Bends

_MEMORY = 30
"""Steps that L-BFGS-B remembers, at most one for each coordinate."""
_TOLERANCE = 1e-9
_SOLVER, _MARGIN = optx.BFGS(rtol=1e-7, atol=1e-7), 0.02
_CERTIFIED = 1e-3
"""Largest projected gradient of a minimum, as a share of the loss."""
_GAP = 64
"""Distance from a bend, in roundings of a coordinate, at which the side is certain."""
_NEAR = 1e-3
"""Distance from a bend within which a polish beside it begins at it. A kink stops a polish so close
to the bend that the rest of the way would count as none."""


class NonFiniteLossError(ArithmeticError):
    """A loss or its gradient was not finite where the solver had to know it."""


def check_finite(finite: Bool[np.ndarray, "n"]) -> None:
    """Raises `NonFiniteLossError`, with the first of the starts that are not finite."""
    bad = np.flatnonzero(~finite)
    if bad.size:
        raise NonFiniteLossError(
            f"The loss and its gradient must be finite; got a NaN or an infinity from start "
            f"{bad[0]} ({bad.size} of {finite.size} starts)."
        )


def loss_and_gradient(
    objective: AbstractObjective, point: Float[Array | np.ndarray, "size"]
) -> tuple[Float[np.ndarray, ""], Float[np.ndarray, "size"]]:
    """Loss and gradient at a point of the box."""
    loss, gradient = _loss_and_gradient(objective, point)
    return np.asarray(loss), np.asarray(gradient)


@compiled
def _loss_and_gradient(
    objective: AbstractObjective, point: Float[Array | np.ndarray, "size"]
) -> tuple[Float[Array, ""], Float[Array, "size"]]:
    return jax.value_and_grad(objective)(jnp.asarray(point))


def losses_at(
    objective: AbstractObjective, boxes: Float[np.ndarray, "n size"]
) -> Float[np.ndarray, "n"]:
    """Losses at a few points, by the program that the polish needs anyway.

    Raises:
        NonFiniteLossError: if a loss or its gradient is not finite.
    """
    each = [loss_and_gradient(objective, point) for point in boxes]
    losses, gradients = (np.stack(part) for part in zip(*each, strict=True))
    check_finite(np.isfinite(losses) & np.all(np.isfinite(gradients), axis=1))
    return losses


def projected_gradient_norm(
    point: Float[np.ndarray, "size"], gradient: Float[np.ndarray, "size"]
) -> float:
    r"""$\max|x - P(x - g)|$, which is 0 at a minimum in the box and certifies it."""
    return float(np.max(np.abs(point - np.clip(point - gradient, 0, 1)), initial=0.0))


def certificate_at(
    objective: AbstractObjective, point: Float[np.ndarray, "size"], bends: Bends
) -> float:
    """The projected-gradient norm at a point of the box.

    At a bend only slopes count by which the loss falls on either side: a minimum has none, though
    the slopes differ and neither is 0.
    """
    before, after = _beside(point, bends)
    slopes = [np.array(loss_and_gradient(objective, side)[1]) for side in (before, after)]
    if before is not after:
        for slope, clip in zip(slopes, (np.maximum, np.minimum), strict=True):
            slope[bends.coordinate] = clip(slope[bends.coordinate], 0)
    return max(projected_gradient_norm(point, slope) for slope in slopes)


def _beside(
    point: Float[np.ndarray, "size"], bends: Bends
) -> tuple[Float[np.ndarray, "size"], Float[np.ndarray, "size"]]:
    """Points before and after the bend at a point, or the point twice where there is no bend.

    At the bend itself rounding would decide on the side.
    """
    gap = _GAP * np.finfo(point.dtype).eps
    for place in bends.places:
        if abs(point[bends.coordinate] - place) <= 2 * gap:
            before, after = point.copy(), point.copy()
            before[bends.coordinate] = max(place - gap, 0)
            after[bends.coordinate] = min(place + gap, 1)
            return before, after
    return point, point


def minimise(
    objective: AbstractObjective, point: Float[np.ndarray, "size"], *, max_steps: int
) -> tuple[Float[np.ndarray, "size"], int]:
    r"""A minimum by Optimistix BFGS, and the number of steps.

    The box is reached through $x = \sin^2\theta$, whose bounds are ordinary points: a
    solver arrives there, and leaves again, at finite $\theta$. A start on a bound, where
    the derivative by $\theta$ vanishes, is moved inside by 0.02.
    """
    end, num_steps = _minimised(objective, point, max_steps)
    return np.asarray(end), int(num_steps)


@compiled
def _minimised(
    objective: AbstractObjective, point: Float[Array | np.ndarray, "size"], max_steps: int
) -> tuple[Float[Array, "size"], Int[Array, ""]]:
    point = jnp.asarray(point)

    def loss(theta: Float[Array, "size"], _: None) -> Float[Array, ""]:
        return objective(jnp.sin(theta).astype(point.dtype) ** 2).astype(theta.dtype)

    # Optimistix takes JAX's default precision for its step size, whatever that of the angles.
    theta = jnp.arcsin(jnp.sqrt(jnp.clip(point, _MARGIN, 1 - _MARGIN))).astype(float)
    end = optx.minimise(loss, _SOLVER, theta, max_steps=max_steps, throw=False)
    return jnp.sin(end.value).astype(point.dtype) ** 2, end.stats["num_steps"]


class Polished(NamedTuple):
    """A point after the polish, its loss and certificate, and the loss after each step."""

    point: Float[np.ndarray, "size"]
    loss: float
    certificate: float
    history: Float[np.ndarray, "steps"]

    @property
    def num_steps(self) -> int:
        """Number of steps of the polish."""
        return self.history.size


def is_minimum(certificate: float, loss: float) -> bool:
    """Whether a projected-gradient norm certifies a minimum of a loss."""
    return certificate <= _CERTIFIED * abs(loss)


def polish(
    objective: AbstractObjective,
    point: Float[np.ndarray, "size"],
    *,
    max_steps: int,
    low: Float[np.ndarray, "size"] | None = None,  # its own by default
    high: Float[np.ndarray, "size"] | None = None,  # its own by default
) -> Polished:
    """SciPy's box-constrained L-BFGS-B, in the box's own coordinates.

    The loss is divided by its value at the start: the solver's tolerances are absolute, and would
    stop it short in bright light, where the loss is small.

    Raises:
        NonFiniteLossError: if the loss or gradient is not finite on the way.
    """
    from scipy.optimize import minimize

    def value_and_gradient(
        x: Float[np.ndarray, "size"],
    ) -> tuple[Float[np.ndarray, ""], Float[np.ndarray, "size"]]:
        loss, gradient = loss_and_gradient(objective, np.asarray(x, point.dtype))
        # With a NaN the solver would stay where it is for every step that it has, and report
        # nothing.
        if not (np.isfinite(loss) and np.all(np.isfinite(gradient))):
            raise NonFiniteLossError(
                "The loss and its gradient must be finite; got a NaN or an infinity "
                "while polishing."
            )
        return loss, gradient

    unit, history = 0.0, []

    def relative(x: Float[np.ndarray, "size"]) -> tuple[float, Float[np.ndarray, "size"]]:
        nonlocal unit
        loss, gradient = value_and_gradient(x)
        unit = unit or abs(float(loss)) or 1.0
        return float(loss / unit), np.asarray(gradient / unit, np.float64)

    low = np.zeros_like(point) if low is None else low
    high = np.ones_like(point) if high is None else high
    end = minimize(
        relative,
        np.clip(point, low, high),
        jac=True,
        method="L-BFGS-B",
        bounds=np.stack([low, high], axis=1),
        tol=_TOLERANCE,
        options={"maxiter": max_steps, "maxcor": min(_MEMORY, point.size)},
        callback=lambda intermediate_result: history.append(intermediate_result.fun * unit),
    )
    lowest = np.clip(end.x.astype(point.dtype), low, high)
    loss, gradient = value_and_gradient(lowest)
    certificate = projected_gradient_norm(lowest, np.asarray(gradient))
    return Polished(lowest, float(loss), certificate, np.array(history))


def finished(
    objective: AbstractObjective, end: Polished, bends: Bends, *, max_steps: int
) -> Polished:
    """The continuation of a polish that stopped short of a minimum.

    The solver begins anew, which forgets misleading curvatures, then on either side of the nearest
    bend: a kink stops a solver that expects the same slope on both sides.

    Raises:
        NonFiniteLossError: if the loss or gradient is not finite on the way.
    """
    end = end._replace(certificate=certificate_at(objective, end.point, bends))
    for low, high in _sides(end.point, bends):
        if is_minimum(end.certificate, end.loss) or end.num_steps >= max_steps:
            break
        near_low, near_high = end.point - low < _NEAR, high - end.point < _NEAR
        start = np.where(
            (low > 0) & near_low, low, np.where((high < 1) & near_high, high, end.point)
        )
        num_steps = max_steps - end.num_steps
        after = polish(objective, start, max_steps=num_steps, low=low, high=high)
        if after.loss <= end.loss:
            certificate = certificate_at(objective, after.point, bends)
            history = np.concatenate([end.history, after.history])
            end = Polished(after.point, after.loss, certificate, history)
    return end


def _sides(
    point: Float[np.ndarray, "size"], bends: Bends
) -> list[tuple[Float[np.ndarray, "size"], Float[np.ndarray, "size"]]]:
    """Bounds of the whole box, and of its parts before and after the bend nearest to a point."""
    low, high = np.zeros_like(point), np.ones_like(point)
    if not bends.places.size:
        return [(low, high)]
    nearest = bends.places[np.argmin(np.abs(bends.places - point[bends.coordinate]))]
    gap = _GAP * np.finfo(point.dtype).eps
    to_bend, from_bend = high.copy(), low.copy()
    to_bend[bends.coordinate] = max(nearest - gap, 0)
    from_bend[bends.coordinate] = min(nearest + gap, 1)
    return [(low, high), (low, to_bend), (from_bend, high)]
