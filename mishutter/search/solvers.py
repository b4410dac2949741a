"""The loss and its gradient at points of the unit box, and a polish of the best of them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from mishutter._core.compiling import compiled
from mishutter.search.objective import AbstractObjective
from mishutter.search.space import Bends

_GAP = 64
"""Distance from a bend, in roundings of a coordinate, at which the side is certain."""
_NEAR = 1e-3
"""Distance from a bend within which a polish beside it begins at it. A kink stops a polish so close
to the bend that the rest of the way would count as none."""


class NonFiniteLossError(ArithmeticError):
    """A loss or its gradient was not finite where the solver had to know it."""


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
    """Losses at a few points, by the program that the polish needs anyway."""
    each = [loss_and_gradient(objective, point) for point in boxes]
    losses, gradients = (np.stack(part) for part in zip(*each, strict=True))
    bad = np.flatnonzero(~(np.isfinite(losses) & np.all(np.isfinite(gradients), axis=1)))
    if bad.size:
        raise NonFiniteLossError(
            "The loss and its gradient must be finite; got a NaN or an infinity from start "
            f"{bad[0]} ({bad.size} of {losses.size} starts)."
        )
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
    index, gap = bends.coordinate, _GAP * np.finfo(point.dtype).eps
    at_point = [place for place in bends.places if abs(point[index] - place) <= 2 * gap]
    if not at_point:
        return projected_gradient_norm(point, loss_and_gradient(objective, point)[1])
    # At the bend itself rounding would decide on the side.
    before, after = max(at_point[0] - gap, 0), min(at_point[0] + gap, 1)
    norms = []
    for place, clip in ((before, np.maximum), (after, np.minimum)):
        beside = point.copy()
        beside[index] = place
        slope = np.array(loss_and_gradient(objective, beside)[1])
        slope[index] = clip(slope[index], 0)
        norms.append(projected_gradient_norm(point, slope))
    return max(norms)


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
    theta = jnp.arcsin(jnp.sqrt(jnp.clip(point, 0.02, 1 - 0.02))).astype(float)
    solver = optx.BFGS(rtol=1e-7, atol=1e-7)
    end = optx.minimise(loss, solver, theta, max_steps=max_steps, throw=False)
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
    """Whether a projected-gradient norm certifies a minimum: at most 0.001 of the loss."""
    return certificate <= 1e-3 * abs(loss)


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
        tol=1e-9,
        options={"maxiter": max_steps, "maxcor": min(30, point.size)},  # steps that it remembers
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
    """
    end = end._replace(certificate=certificate_at(objective, end.point, bends))
    low, high = np.zeros_like(end.point), np.ones_like(end.point)
    bounds, index = [(low, high)], bends.coordinate
    if bends.places.size:
        nearest = bends.places[np.argmin(np.abs(bends.places - end.point[index]))]
        gap = _GAP * np.finfo(end.point.dtype).eps
        to_bend, from_bend = high.copy(), low.copy()
        to_bend[index], from_bend[index] = max(nearest - gap, 0), min(nearest + gap, 1)
        bounds += [(low, to_bend), (from_bend, high)]
    for low, high in bounds:
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
