"""Descents from many starts at once, of which the worse are given up on the way."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, ArrayLike

from mishutter._core import compiled, in_threads, num_processors
from mishutter.search.objective import AbstractObjective
from mishutter.search.solvers import check_finite

Progress = Callable[[int, float], None]
_STEPS_PER_CALL, _CALLS_TO_TELL, _PATIENCE = 10, 2, 3
_NUM_LAST, _LAST_SHARE = 4, 0.125
"""Starts that are never given up, and their share of many: several, as those that lead early
may end in one place."""
_TOGETHER = 16
_MARGIN = 0.02
_TOLERANCE = 1e-7


class Descent(NamedTuple):
    """Where a descent from every start ended.

    Attributes:
        boxes: Final points; shape `(starts, size)`.
        losses: Their losses; shape `(starts,)`.
        history: Smallest loss so far after each step.
        trail: The best of the points after each step; shape `(steps, size)`.
    """

    boxes: np.ndarray
    losses: np.ndarray
    history: np.ndarray
    trail: np.ndarray


def descend(
    objective: AbstractObjective,
    starts: Array,
    *,
    max_steps: int,
    progress: Progress | None = None,
) -> Descent:
    r"""Optimistix BFGS from every start at once, the worse ones only as long as it takes to tell.

    The box is reached through $x = \sin^2\theta$, whose bounds are ordinary points: a
    solver arrives there, and leaves again, at finite $\theta$. Starts on a bound, where
    the derivative by $\theta$ vanishes, are moved inside by 0.02.

    After 20 steps, and every 10 from there on, the worse half of the starts is given up,
    until four are left, or an eighth (successive halving: Karnin, Koren and Somekh, ICML 2013).

    Raises:
        NonFiniteLossError: if a loss or gradient at an accepted point is not finite.
    """
    size = _part_size(objective, len(starts))
    state = jax.tree.map(np.array, _start(starts))
    history: list[np.ndarray] = []
    trail: list[np.ndarray] = []
    num_going, num_last, steps_left = len(starts), num_lasting(len(starts)), max_steps
    while steps_left > 0:
        count = np.int32(min(_STEPS_PER_CALL, steps_left))
        shares = _shared_out(objective, np.flatnonzero(~state.done), size)
        parts = (_part(state, rows, size) for rows in shares)
        advance = partial(_advanced, objective, count)
        num_threads = min(num_processors(), len(shares))
        calls = in_threads(advance, parts, num_threads, first_alone=not history)
        each_met, finite = [], np.ones(len(starts), bool)
        for rows, (moved, met, is_finite) in zip(shares, calls, strict=True):
            _write_back((state, finite), rows, (moved, is_finite))
            each_met.append(met)
        check_finite(finite)
        steps_left -= _STEPS_PER_CALL
        lowest, theta = _best_of(each_met)
        history.append(lowest)
        trail.append(np.sin(theta) ** 2)
        if progress is not None and lowest.size:
            progress(max_steps - max(0, steps_left), float(lowest[-1]))
        if len(history) >= _CALLS_TO_TELL:
            num_going = min(num_going, max(num_last, math.ceil(num_going / 2)))
            state.done[np.argsort(state.loss, kind="stable")[num_going:]] = True
        if np.all(state.done) or _settled(state.loss, state.done, history):
            break
    lowest = np.minimum.accumulate(np.concatenate(history))
    return Descent(np.sin(state.theta) ** 2, state.loss, lowest, np.concatenate(trail))


def num_lasting(num_starts: int) -> int:
    """How many of so many starts are never given up."""
    return min(num_starts, max(_NUM_LAST, math.ceil(num_starts * _LAST_SHARE)))


def _part_size(objective: AbstractObjective, num_starts: int) -> int:
    """How many starts one call advances, at most.

    Starts that a batch advances together stay together, so that the number of processors does
    not change their roundings; an accelerator advances all at once.
    """
    num_parts = min(num_processors(), num_starts)
    if objective.batches:
        num_parts = math.ceil(num_starts / _TOGETHER) if jax.default_backend() == "cpu" else 1
    return math.ceil(num_starts / num_parts)


def _shared_out(objective: AbstractObjective, rows: np.ndarray, size: int) -> list[np.ndarray]:
    """Starts that still go on, in as few parts as hold them, or in as many as go on at a time."""
    num_parts = math.ceil(rows.size / size)
    if not objective.batches:
        num_parts = min(num_processors(), rows.size)
    return np.array_split(rows, num_parts)


def _part(state: "_State", rows: np.ndarray, size: int) -> "_State":
    """Some starts, filled up to a `size` by copies of one that go nowhere."""
    part = jax.tree.map(lambda x: x[np.resize(rows, size)], state)
    part.done[rows.size :] = True
    return part


def _write_back(arrays: Any, rows: np.ndarray, parts: Any) -> None:
    """Put what was found of some starts in their rows."""
    for whole, part in zip(jax.tree.leaves(arrays), jax.tree.leaves(parts), strict=True):
        whole[rows] = np.asarray(part)[: rows.size]


def _best_of(each_met: "Sequence[_Met]") -> tuple[np.ndarray, np.ndarray]:
    """The least loss of several parts after each step, until none goes on, and where."""
    losses, places = np.stack([x.loss for x in each_met]), np.stack([x.theta for x in each_met])
    taken = np.any(np.isfinite(losses), axis=0)
    best = np.argmin(losses[:, taken], axis=0), np.arange(np.sum(taken))
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
    """The least loss after each of some steps, infinite for those not taken, and where it was."""

    loss: Array | np.ndarray
    theta: Array | np.ndarray


_SOLVER = optx.BFGS(rtol=_TOLERANCE, atol=_TOLERANCE)


def _in_angles(objective: AbstractObjective):
    return lambda theta, args: (objective(jnp.sin(theta) ** 2), None)


def _solver_state(theta: Array) -> Any:
    """Optimistix's own state at angles of one start, which knows nothing of the function yet."""
    scalar = jax.ShapeDtypeStruct((), theta.dtype)
    return _SOLVER.init(lambda y, _: (jnp.sum(y), None), theta, None, {}, scalar, None, frozenset())


@compiled
def _start(starts: Array) -> _State:
    theta = jnp.arcsin(jnp.sqrt(jnp.clip(starts, _MARGIN, 1 - _MARGIN)))
    state = eqx.filter_vmap(_solver_state)(theta)
    # Optimistix takes JAX's default for its step size, which would widen the angles.
    leaves = jax.tree.leaves(eqx.filter(state, eqx.is_array))
    memory = [x.astype(theta.dtype) if eqx.is_inexact_array(x) else x for x in leaves]
    not_known = jnp.full(theta.shape[0], jnp.finfo(theta.dtype).max)
    return _State(theta, not_known, memory, jnp.zeros(theta.shape[0], bool))


def _advanced(
    objective: AbstractObjective, num_steps: ArrayLike, state: _State
) -> tuple[_State, "_Met", np.ndarray]:
    """`_advance` by at most so many steps, waited for."""
    state, met, finite = _advance(objective, state, num_steps, _STEPS_PER_CALL)
    return state, _Met(*(np.asarray(x) for x in met)), np.asarray(finite)


@compiled
def _advance(objective: AbstractObjective, state: _State, num_steps: ArrayLike, capacity: int):
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
    met = _Met(jnp.full(capacity, jnp.inf, dtype), jnp.zeros((capacity, size), dtype))
    first = (jnp.zeros((), jnp.int32), state, met, jnp.ones_like(state.done))
    _, state, met, finite = jax.lax.while_loop(unfinished, body, first)
    return state, met, finite
