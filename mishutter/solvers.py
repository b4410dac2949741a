"""Minimisation over the unit box: many starts at once, then a polish of the winner."""

import warnings
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from mishutter.compiling import quick_to_compile, seldom_run
from mishutter.objective import AbstractObjective
from mishutter.threads import in_threads, num_processors

Progress = Callable[[int, float], None]
_STEPS_PER_CALL, _PATIENCE = 10, 3
_TOGETHER = 16
_MARGIN = 0.02
_TOLERANCE = 1e-7
_MEMORY = 10
"""Steps that L-BFGS-B remembers; more than coordinates say nothing new, and each number of them
has JAX compile what jaxopt makes of it."""


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
    states = [_start(part) for part in _shared_out(objective, starts)]
    history: list[np.ndarray] = []
    trail: list[np.ndarray] = []
    losses, done = np.zeros(len(starts)), np.zeros(len(starts), bool)
    steps_left = max_steps
    while steps_left > 0:
        count = jnp.asarray(min(_STEPS_PER_CALL, steps_left))
        advance = partial(_advanced, objective, count)
        calls = in_threads(advance, states, num_processors(), first_alone=not history)
        states, each_met, each_finite = zip(*calls, strict=True)
        _check_finite(np.concatenate(each_finite)[: len(starts)])
        steps_left -= _STEPS_PER_CALL
        lowest, theta = _best_of(each_met)
        history.append(lowest)
        trail.append(np.sin(theta) ** 2)
        if progress is not None and lowest.size:
            progress(max_steps - max(0, steps_left), float(lowest[-1]))
        losses, done = (
            np.concatenate([np.asarray(x) for x in each])[: len(starts)]
            for each in zip(*((state.loss, state.done) for state in states), strict=True)
        )
        if bool(np.all(done)) or _settled(losses, done, history):
            break
    theta = np.concatenate([np.asarray(state.theta) for state in states])[: len(starts)]
    lowest = np.minimum.accumulate(np.concatenate(history))
    num_unfinished = int(np.sum(~done))
    return Descent(np.sin(theta) ** 2, losses, lowest, np.concatenate(trail), num_unfinished)


def _shared_out(objective: AbstractObjective, starts: Array) -> list[Array]:
    """Starts in parts of one size for the processors; the last is repeated to fill its part.

    Those that are at hand together stay together: a few, whose number does not depend on the
    machine as their roundings might, or on an accelerator all.
    """
    num_parts = min(num_processors(), len(starts))
    if objective.batches:
        num_parts = -(-len(starts) // _TOGETHER) if jax.default_backend() == "cpu" else 1
    size = -(-len(starts) // num_parts)
    padded = np.pad(np.asarray(starts), ((0, -len(starts) % size), (0, 0)), "edge")
    return [jax.device_put(part) for part in padded.reshape(-1, size, starts.shape[1])]


def _best_of(each_met: "Sequence[_Met]") -> tuple[np.ndarray, np.ndarray]:
    """The least loss of several parts after each step, until none goes on, and where."""
    losses, places = np.stack([x.loss for x in each_met]), np.stack([x.theta for x in each_met])
    taken = np.any(np.isfinite(losses), axis=0)
    best = np.nanargmin(losses[:, taken], axis=0), np.arange(np.sum(taken))
    return losses[:, taken][best], places[:, taken][best]


def _settled(losses: np.ndarray, done: np.ndarray, history: list[np.ndarray]) -> bool:
    """Whether the best start has converged and no other overtook it for three calls since."""
    if not done[np.argmin(losses)] or len(history) <= _PATIENCE:
        return False
    before = float(np.min(np.concatenate(history[:-_PATIENCE])))
    latest = float(np.min(np.concatenate(history)))
    return before - latest <= _TOLERANCE * abs(latest)


class _State(NamedTuple):
    """Where the descents are: angles, losses, the arrays of the solver, and which have ended."""

    theta: Array
    loss: Array
    memory: list[Array]
    done: Array


class _Met(NamedTuple):
    """The least loss after each of some steps, NaN for those not taken, and where it was."""

    loss: Array | np.ndarray
    theta: Array | np.ndarray


_SOLVER = optx.BFGS(rtol=_TOLERANCE, atol=_TOLERANCE)


def _in_angles(objective: AbstractObjective):
    return lambda theta, args: (objective(jnp.sin(theta) ** 2), None)


def _solver_state(theta: Array) -> Any:
    """Optimistix's own state at angles of one start, which knows nothing of the function yet."""
    scalar = jax.ShapeDtypeStruct((), theta.dtype)
    return _SOLVER.init(lambda y, _: (jnp.sum(y), None), theta, None, {}, scalar, None, frozenset())


@seldom_run
def _start(starts: Array) -> _State:
    theta = jnp.arcsin(jnp.sqrt(jnp.clip(starts, _MARGIN, 1 - _MARGIN)))
    state = eqx.filter_vmap(_solver_state)(theta)
    memory = jax.tree.leaves(eqx.filter(state, eqx.is_array))
    return _State(theta, state.f_info.f, memory, jnp.zeros(theta.shape[0], bool))


def _advanced(
    objective: AbstractObjective, num_steps: Array, state: _State
) -> tuple[_State, "_Met", np.ndarray]:
    """`_advance` by at most so many steps, waited for."""
    state, met, finite = _advance(objective, state, num_steps, _STEPS_PER_CALL)
    return state, _Met(*(np.asarray(x) for x in met)), np.asarray(finite)


@quick_to_compile
def _advance(objective: AbstractObjective, state: _State, num_steps: Array, capacity: int):
    function = _in_angles(objective)
    like = eqx.filter_eval_shape(_solver_state, state.theta[0])
    dynamic, static = eqx.partition(like, lambda x: isinstance(x, jax.ShapeDtypeStruct))
    remembered = jax.tree.structure(dynamic)

    def solver(memory: list[Array]) -> Any:
        return eqx.combine(remembered.unflatten(memory), static)

    def step(state: _State) -> _State:
        before = solver(state.memory)
        moved, after, _ = _SOLVER.step(function, state.theta, None, {}, before, frozenset())
        ended, _ = _SOLVER.terminate(function, moved, None, {}, after, frozenset())
        memory = jax.tree.leaves(eqx.filter(after, eqx.is_array))
        return _State(moved, after.f_info.f, memory, ended)

    def one(state: _State) -> _State:
        return jax.lax.cond(state.done, lambda: state, lambda: step(state))

    def body(carry):
        count, state, met, finite = carry
        state = jax.vmap(one)(state) if objective.batches else jax.lax.map(one, state)
        gradient = solver(state.memory).f_info.grad
        finite &= jnp.isfinite(state.loss) & jnp.all(jnp.isfinite(gradient), axis=1)
        best = jnp.argmin(state.loss)
        met = _Met(
            met.loss.at[count].set(state.loss[best]), met.theta.at[count].set(state.theta[best])
        )
        return count + 1, state, met, finite

    def unfinished(carry):
        count, state, _, finite = carry
        return (count < num_steps) & jnp.any(~state.done) & jnp.all(finite)

    dtype, size = state.theta.dtype, state.theta.shape[1]
    met = _Met(jnp.full(capacity, jnp.nan, dtype), jnp.zeros((capacity, size), dtype))
    first = (jnp.zeros((), jnp.int32), state, met, jnp.ones_like(state.done))
    _, state, met, finite = jax.lax.while_loop(unfinished, body, first)
    return state, met, finite


def _check_finite(finite: Array | np.ndarray) -> None:
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
    _check_finite(np.array([np.isfinite(f) and np.all(np.isfinite(g)) for f, g in pairs]))
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
