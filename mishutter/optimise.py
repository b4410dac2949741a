"""The design search: many starts, a polish, and an honest end."""

from enum import Enum
from functools import lru_cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter.design import Design
from mishutter.design_space import FREE_NAMES, DesignSpace, design_space
from mishutter.losses.base import AbstractLoss
from mishutter.metrics import evaluate
from mishutter.motion import AbstractMotion, StillCamera
from mishutter.objective import objective_of
from mishutter.plan import Plan, sized_for, sizes
from mishutter.scene import Scene
from mishutter.shutters.base import AbstractAdjustableShutter, AbstractShutter
from mishutter.shutters.spline import SplineShutter
from mishutter.shutters.windows import (
    GaussianShutter,
    HannShutter,
    RectShutter,
    TriangleShutter,
    TukeyShutter,
)
from mishutter.solvers import Progress, batched_loss, descend, polish
from mishutter.types import require, require_positive_int

_CERTIFIED = 1e-3


class Outcome(Enum):
    """How a search ended."""

    CONVERGED = "The search converged: the projected gradient is below its tolerance."
    STEPS_USED = "The search used up its steps before the projected gradient fell below tolerance."
    STALLED = "The search stopped where no step lowered the loss, short of its tolerance."


class SearchFailedError(RuntimeError):
    """A search with `throw=True` did not converge."""


def optimise(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    loss: AbstractLoss,
    free: tuple[str, ...] = FREE_NAMES,
    num_starts: int = 16,
    seed: int = 0,
    max_steps: int = 300,
    progress: Progress | None = None,
    throw: bool = False,
    plan: Plan | None = None,
) -> Design:
    r"""Search for the design of least loss within the scene's limits.

    Optimistix BFGS descends from many starts at once: the given design, the baselines'
    profiles, then random ones. The best is polished by jaxopt's box-constrained
    L-BFGS-B. The result is never worse than the best start.

    Args:
        scene: Speeds, light, noise and limits.
        motion: Motion to start from; a `StillCamera` stays at rest.
        shutter: Profile to start from; its kind is kept.
        loss: What is made small.
        free: What may move: `"shutter"`, `"acceleration"`, `"half_exposure"`.
        num_starts: How many descents.
        seed: Of the random starts.
        max_steps: Steps of the descent, and of the polish, at most.
        progress: Called with the step and the smallest loss so far.
        throw: Whether an end other than convergence raises.
        plan: What to compute; sized for the whole space by default.

    Returns:
        The best design found, how the search ended in a sentence, and the
        projected-gradient norm as the certificate.

    Raises:
        ValueError: if `free` names nothing that can move, or a count is not positive.
        NonFiniteLossError: if the loss or its gradient is not finite.
        SearchFailedError: if `throw` and the search did not converge.
    """
    require_positive_int("optimise(num_starts=...)", num_starts)
    require_positive_int("optimise(max_steps=...)", max_steps)
    require(isinstance(loss, AbstractLoss), "optimise(loss=...)", "be a loss", loss)
    space = design_space(scene, motion, shutter, free)
    plan = _sizes_of_space(scene, space) if plan is None else plan
    objective = objective_of(loss, scene.bare(), space, plan)
    starts = start_boxes(space, num_starts, seed)
    descent = descend(objective, jnp.asarray(starts), max_steps=max_steps, progress=progress)
    first = np.asarray(batched_loss(objective, jnp.asarray(starts)))
    candidates = np.concatenate([descent.boxes, starts])
    losses = np.concatenate([descent.losses, first])
    best = int(np.nanargmin(losses))
    polished = polish(objective, candidates[best], max_steps=max_steps)
    box, value = candidates[best], float(losses[best])
    if polished.loss <= value:
        box, value = polished.box, polished.loss
    outcome = _outcome(polished.certificate, value, polished.num_steps >= max_steps)
    if throw and outcome is not Outcome.CONVERGED:
        raise SearchFailedError(outcome.value)
    found_shutter, found_motion = _design_at(space, jnp.asarray(box))
    return Design(
        shutter=found_shutter,
        motion=found_motion,
        scene=scene,
        loss=value,
        metrics=evaluate(scene, found_motion, found_shutter),
        history=np.append(descent.history, value),
        converged=outcome is Outcome.CONVERGED,
        outcome=outcome.value,
        certificate=polished.certificate,
        loss_name=repr(loss),
        best_start_loss=float(np.min(first)),
    )


@eqx.filter_jit
def _design_at(space: DesignSpace, box: Array) -> tuple[AbstractShutter, AbstractMotion]:
    return space.at(box)


def _outcome(certificate: float, loss: float, steps_used: bool) -> Outcome:
    if certificate <= _CERTIFIED * max(1.0, abs(loss)):
        return Outcome.CONVERGED
    return Outcome.STEPS_USED if steps_used else Outcome.STALLED


def _sizes_of_space(scene: Scene, space: DesignSpace) -> Plan:
    """Sizes that hold every design of the space."""
    corners = [_design_at(space, jnp.asarray(corner, space.max_speed.dtype)) for corner in _corners(space)]
    plans = [sizes(scene, motion) for _, motion in corners]
    if "acceleration" in space.free:
        stroke = float(space.limits.max_stroke)
        plans.append(sized_for(4 * stroke, 3 * stroke))
    return max(plans, key=lambda plan: (plan.num_nodes, plan.num_taps))


def _corners(space: DesignSpace) -> list[np.ndarray]:
    profile = np.full(space.num_profile_coordinates, 0.5)
    num_motion = space.size - profile.size
    return [
        np.concatenate([profile, [(corner >> axis) & 1 for axis in range(num_motion)]])
        for corner in range(1 << num_motion)
    ]


def start_boxes(space: DesignSpace, num_starts: int, seed: int) -> np.ndarray:
    """Points to descend from; shape `(num_starts, size)`.

    The given design first, then the baselines' profiles and random ones, at the given
    motion and at random motions by turns.
    """
    given = np.asarray(space.box(space.shutter, space.motion))
    count = space.num_profile_coordinates
    profiles = _baseline_boxes(space)
    random = np.random.default_rng(seed)
    boxes = np.tile(given, (num_starts, 1))
    for index in range(1, num_starts):
        if count:
            named = index <= len(profiles)
            profile = profiles[index - 1] if named else _random_profile(random, count)
            boxes[index, :count] = profile
        if index % 2 or not count:
            boxes[index, count:] = random.uniform(size=given.size - count)
    return boxes


def _random_profile(random: np.random.Generator, count: int) -> np.ndarray:
    """White noise and a random walk about one half, mixed: profiles of every roughness."""
    roughness = random.uniform()
    noise = random.standard_normal(count)
    walk = np.cumsum(noise) / np.sqrt(count)
    return np.clip(0.5 + roughness * noise / 2 + (1 - roughness) * walk, 0, 1)


def _baseline_boxes(space: DesignSpace) -> list[np.ndarray]:
    shutter = space.shutter
    if not ("shutter" in space.free and isinstance(shutter, SplineShutter)):
        return []
    fits = _window_fits(shutter.num_coefficients, shutter.symmetric)
    return [np.asarray(fit.box()) for fit in fits]


@lru_cache
def _window_fits(num_coefficients: int, symmetric: bool) -> tuple[SplineShutter, ...]:
    windows = (
        HannShutter(),
        TukeyShutter(0.5),
        RectShutter(),
        TriangleShutter(),
        GaussianShutter(),
        TukeyShutter(0.25),
        TukeyShutter(0.75),
    )
    return tuple(
        SplineShutter.fit(window, num_coefficients, symmetric=symmetric) for window in windows
    )


def adjustable_start(scene: Scene, num_coefficients: int = 24) -> AbstractAdjustableShutter:
    """The profile a search starts from: symmetric if the scene's speeds are."""
    speeds, weights = np.asarray(scene.speeds), np.asarray(scene.weights)
    order, mirrored = np.argsort(speeds), np.argsort(-speeds)
    symmetric = np.allclose(speeds[order], -speeds[mirrored]) and np.allclose(
        weights[order], weights[mirrored]
    )
    return SplineShutter.fit(TukeyShutter(0.5), num_coefficients, symmetric=bool(symmetric))


def snapshot_motion(scene: Scene) -> StillCamera:
    """A camera at rest in the middle of the scene's exposures."""
    low, high = scene.limits.min_half_exposure, scene.limits.max_half_exposure
    return StillCamera(half_exposure=jnp.sqrt(low * high))


