"""Minimisation over the unit box: many starts at once, then a polish of the winner."""

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from mishutter.compiling import quick_to_compile
from mishutter.objective import AbstractObjective

Progress = Callable[[int, float], None]
_STEPS_PER_CALL, _PATIENCE = 10, 3
_MARGIN = 0.02
_TOLERANCE = 1e-7


class NonFiniteLossError(ArithmeticError):
    """A loss or its gradient was not finite where the solver had to know it."""


class Descent(NamedTuple):
    """Where a descent from every start ended.

    Attributes:
        boxes: Final points; shape `(starts, size)`.
        losses: Their losses; shape `(starts,)`.
        history: Smallest loss so far after each step.
        trail: The best of the points after each step; shape `(steps, size)`.
        num_unfinished: Starts that still moved when the steps were used up.
    """

    boxes: np.ndarray
    losses: np.ndarray
    history: np.ndarray
    trail: np.ndarray
    num_unfinished: int


def descend(
    objective: AbstractObjective,
    starts: Array,
    *,
    max_steps: int,
    progress: Progress | None = None,
) -> Descent:
    r"""Optimistix BFGS from every start at once.

    The box is reached through $x = \sin^2\theta$, whose bounds are ordinary points: a
    solver arrives there, and leaves again, at finite $\theta$. Starts on a bound, where
    the derivative by $\theta$ vanishes, are moved inside by 0.02.

    Raises:
        NonFiniteLossError: if a loss or gradient at an accepted point is not finite.
    """
    state = _start(objective, starts)
    history: list[np.ndarray] = []
    trail: list[np.ndarray] = []
    steps_left = max_steps
    while steps_left > 0:
        count = min(_STEPS_PER_CALL, steps_left)
        state, met, finite, done = _advance(objective, state, jnp.asarray(count), _STEPS_PER_CALL)
        _check_finite(finite)
        steps_left -= count
        taken = np.isfinite(met.loss)
        history.append(np.asarray(met.loss)[taken])
        trail.append(np.sin(np.asarray(met.theta)[taken]) ** 2)
        if progress is not None and history[-1].size:
            progress(max_steps - steps_left, float(history[-1][-1]))
        if bool(np.all(np.asarray(done))) or _settled(state, history):
            break
    boxes = np.sin(np.asarray(state.theta)) ** 2
    losses = np.asarray(state.solver.f_info.f)
    lowest = np.minimum.accumulate(np.concatenate(history))
    unfinished = int(np.sum(~np.asarray(state.done)))
    return Descent(boxes, losses, lowest, np.concatenate(trail), unfinished)


def _settled(state: "_State", history: list[np.ndarray]) -> bool:
    """Whether the best start has converged and no other overtook it for three calls since."""
    best = int(np.argmin(np.asarray(state.solver.f_info.f)))
    if not bool(np.asarray(state.done)[best]) or len(history) <= _PATIENCE:
        return False
    before = float(np.min(np.concatenate(history[:-_PATIENCE])))
    latest = float(np.min(np.concatenate(history)))
    return before - latest <= _TOLERANCE * abs(latest)


@final
class _State(eqx.Module):
    theta: Array
    solver: Any
    done: Array


class _Met(NamedTuple):
    """The least loss after each of some steps, NaN for those not taken, and where it was."""

    loss: Array
    theta: Array


_SOLVER = optx.BFGS(rtol=_TOLERANCE, atol=_TOLERANCE)


def _in_angles(objective: AbstractObjective):
    return lambda theta, args: (objective(jnp.sin(theta) ** 2), None)


@quick_to_compile
def _start(objective: AbstractObjective, starts: Array) -> _State:
    theta = jnp.arcsin(jnp.sqrt(jnp.clip(starts, _MARGIN, 1 - _MARGIN)))
    scalar = jax.ShapeDtypeStruct((), theta.dtype)
    function = _in_angles(objective)
    state = eqx.filter_vmap(
        lambda y: _SOLVER.init(function, y, None, {}, scalar, None, frozenset())
    )(theta)
    return _State(theta, state, jnp.zeros(theta.shape[0], bool))


@quick_to_compile
def _advance(objective: AbstractObjective, state: _State, num_steps: Array, capacity: int):
    function = _in_angles(objective)
    dynamic, static = eqx.partition(state, eqx.is_array)

    def step(state: _State) -> _State:
        moved, after, _ = _SOLVER.step(function, state.theta, None, {}, state.solver, frozenset())
        ended, _ = _SOLVER.terminate(function, moved, None, {}, after, frozenset())
        return _State(moved, after, ended)

    def one(arrays: _State) -> _State:
        kept = lambda: arrays  # noqa: E731
        moved = lambda: eqx.filter(step(eqx.combine(arrays, static)), eqx.is_array)  # noqa: E731
        return jax.lax.cond(arrays.done, kept, moved)

    def body(carry):
        count, arrays, met, finite = carry
        arrays = jax.vmap(one)(arrays) if objective.batches else jax.lax.map(one, arrays)
        loss, gradient = arrays.solver.f_info.f, arrays.solver.f_info.grad
        finite &= jnp.isfinite(loss) & jnp.all(jnp.isfinite(gradient), axis=1)
        best = jnp.argmin(loss)
        met = _Met(met.loss.at[count].set(loss[best]), met.theta.at[count].set(arrays.theta[best]))
        return count + 1, arrays, met, finite

    def unfinished(carry):
        count, arrays, _, finite = carry
        return (count < num_steps) & jnp.any(~arrays.done) & jnp.all(finite)

    dtype, size = state.theta.dtype, state.theta.shape[1]
    met = _Met(jnp.full(capacity, jnp.nan, dtype), jnp.zeros((capacity, size), dtype))
    first = (jnp.zeros((), jnp.int32), dynamic, met, jnp.ones_like(state.done))
    _, arrays, met, finite = jax.lax.while_loop(unfinished, body, first)
    return eqx.combine(arrays, static), met, finite, arrays.done


def _check_finite(finite: Array | np.ndarray) -> None:
    bad = np.flatnonzero(~np.asarray(finite))
    if bad.size:
        raise NonFiniteLossError(
            f"The loss and its gradient must be finite; got a NaN or an infinity from start "
            f"{bad[0]} ({bad.size} of {np.asarray(finite).size} starts)."
        )


@quick_to_compile
def loss_and_gradient(objective: AbstractObjective, box: Array) -> tuple[Array, Array]:
    """Loss and gradient at a point of the box; scalar and `(size,)`."""
    return jax.value_and_grad(objective)(box)


def losses_at(objective: AbstractObjective, boxes: np.ndarray) -> np.ndarray:
    """Losses at a few points, by the program that the polish needs anyway; shape `(n,)`.

    Raises:
        NonFiniteLossError: if a loss or its gradient is not finite.
    """
    pairs = [loss_and_gradient(objective, jnp.asarray(box)) for box in boxes]
    _check_finite(np.array([np.isfinite(f) and np.all(np.isfinite(g)) for f, g in pairs]))
    return np.array([float(loss) for loss, _ in pairs])


def projected_gradient_norm(box: np.ndarray, gradient: np.ndarray) -> float:
    r"""$\max|x - P(x - g)|$, the certificate of a minimum in the box: 0 at one."""
    return float(np.max(np.abs(box - np.clip(box - gradient, 0, 1)), initial=0.0))


def certificate_at(objective: AbstractObjective, box: np.ndarray) -> float:
    """The projected-gradient norm at a point of the box."""
    return projected_gradient_norm(
        box, np.asarray(loss_and_gradient(objective, jnp.asarray(box))[1])
    )


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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import jaxopt

    def value_and_gradient(x):
        loss, gradient = loss_and_gradient(objective, jnp.asarray(x, box.dtype))
        if not (np.isfinite(loss) and np.all(np.isfinite(gradient))):
            raise NonFiniteLossError(
                "The loss and its gradient must be finite; got a NaN or an infinity "
                "while polishing."
            )
        return loss, gradient

    solver = jaxopt.ScipyBoundedMinimize(
        fun=value_and_gradient,
        value_and_grad=True,
        method="L-BFGS-B",
        maxiter=max_steps,
        jit=False,
        tol=1e-9,
    )
    low, high = np.zeros_like(box), np.ones_like(box)
    point, info = solver.run(jnp.asarray(box), bounds=(low, high))
    point = np.clip(np.asarray(point), 0, 1)
    loss, gradient = value_and_gradient(point)
    certificate = projected_gradient_norm(point, np.asarray(gradient))
    return Polished(point, float(loss), certificate, int(info.iter_num))
