"""The loss and its gradient at points of the unit box, and a polish of the best of them."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import compiled
from mishutter.search.objective import (
    AbstractObjective,
    Exposure,
    Exposures,
    SpectralObjective,
)
from mishutter.search.space import Bends

_POINTS_A_CALL = 16
_MEMORY = 30
"""Steps that L-BFGS-B remembers; more than coordinates say nothing new."""
_TOLERANCE = 1e-9
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
) -> tuple[np.floating, np.ndarray]:
    """Loss and gradient at a point of the box; scalar and `(size,)`."""
    losses, gradients = _losses_and_gradients(objective, np.asarray(box)[None])
    return losses[0], gradients[0]


def _losses_and_gradients(
    objective: AbstractObjective, boxes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Losses and gradients at as many points as one call takes; shapes `(n,)`, `(n, size)`."""
    room = np.zeros((_POINTS_A_CALL, *boxes.shape[1:]), boxes.dtype)
    room[: len(boxes)] = boxes
    count = np.asarray(len(boxes))
    if isinstance(objective, SpectralObjective) and objective.shares_its_loss:
        found = _by_parts(objective, room, count)
    else:
        found = _one_by_one(objective, room, count)
    losses, gradients = (np.asarray(part)[: len(boxes)] for part in found)
    return losses, gradients


def _by_parts(
    objective: SpectralObjective, boxes: np.ndarray, count: np.ndarray
) -> tuple[Array, Array | np.ndarray]:
    """Losses and gradients by the chain rule, whose longer part to compile sees no shutter.

    One program of it serves every kind of shutter and of motion.
    """
    space, exposures = objective.space, objective.exposures
    points = space.widened(boxes)
    seen = _seen(exposures, points, count)
    losses, slopes = _one_by_one(objective.seen.at, seen, count)
    gradients = np.asarray(_pulled_back(exposures, (points, slopes), count))
    return losses, space.narrowed(gradients)


@compiled
def _seen(exposures: Exposures, boxes: ArrayLike, count: ArrayLike) -> Exposure:
    return _at_first(exposures.at, boxes, count)


@compiled
def _pulled_back(exposures: Exposures, points: tuple[ArrayLike, Exposure], count: ArrayLike):
    def one(point: tuple[Array, Exposure]) -> Array:
        box, slope = point
        return jax.vjp(exposures.at, box)[1](slope)[0]

    return _at_first(one, points, count)


@compiled
def _one_by_one(function: Callable[[Any], Array], points: Any, count: ArrayLike) -> Any:
    """Values and gradients of a function at the first of some points, the rest 0."""
    return _at_first(jax.value_and_grad(function), points, count)


def _at_first(function: Callable[[Any], Any], points: Any, count: ArrayLike) -> Any:
    """Results of a function at the first of some points, the rest 0."""
    points = jax.tree.map(jnp.asarray, points)
    num_points = jax.tree.leaves(points)[0].shape[0]

    def at_one(index: ArrayLike) -> Any:
        return function(jax.tree.map(lambda x: x[index], points))

    def one(index: Array, found: Any) -> Any:
        return jax.tree.map(lambda all_, x: all_.at[index].set(x), found, at_one(index))

    like = jax.eval_shape(at_one, 0)
    nothing = jax.tree.map(lambda x: jnp.zeros((num_points, *x.shape), x.dtype), like)
    return jax.lax.fori_loop(0, count, one, nothing)


def losses_at(objective: AbstractObjective, boxes: np.ndarray) -> np.ndarray:
    """Losses at a few points, by the program that the polish needs anyway; shape `(n,)`.

    Raises:
        NonFiniteLossError: if a loss or its gradient is not finite.
    """
    calls = range(0, len(boxes), _POINTS_A_CALL)
    each = [_losses_and_gradients(objective, boxes[i : i + _POINTS_A_CALL]) for i in calls]
    losses, gradients = (np.concatenate(part) for part in zip(*each, strict=True))
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


class Polished(NamedTuple):
    """A point after the polish, its loss, its certificate and the steps it took."""

    box: np.ndarray
    loss: float
    certificate: float
    num_steps: int


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

    unit = 0.0

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
    )
    point = np.clip(end.x.astype(box.dtype), low, high)
    loss, gradient = value_and_gradient(point)
    certificate = projected_gradient_norm(point, np.asarray(gradient))
    return Polished(point, float(loss), certificate, int(end.nit))


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
            end = Polished(found.box, found.loss, certificate, end.num_steps + found.num_steps)
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
