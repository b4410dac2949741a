"""What a plan changes in the results that it was made for, found by computing both."""

from dataclasses import replace

import jax
import numpy as np

from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.errors import LinearErrors
from mishutter.evaluation.losses import AbstractLoss, value_of
from mishutter.evaluation.metrics import _as_designed
from mishutter.evaluation.needs import EVERY_PART, ONLY_SPECTRA, Plan, sizes
from mishutter.evaluation.response import Records, compute_response
from mishutter.evaluation.views import sampled_view
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.search.planning import plan

_NAMES = (
    "condition_number",
    "kernel_difference",
    "relative_kernel_difference",
    "efficiency",
)


def plan_for(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter, loss: AbstractLoss | None = None
) -> Plan:
    """The plan that a measurement of a loss makes, or one of all metrics."""
    if loss is not None:
        return plan(scene, motion, shutter, loss=loss).sizes
    return sampled_view(scene, motion, shutter, EVERY_PART).plan


def metrics_by(
    plan: Plan | None, scene: Scene, motion: AbstractMotion, shutter: AbstractShutter
) -> dict[str, jax.Array]:
    """The metrics of a camera without errors, by a plan; with everything computed without one."""
    own = sizes(scene, motion) if plan is None else plan
    view = sampled_view(without_tolerances(scene), motion, shutter, EVERY_PART, own)
    return _as_designed(view.scene, view.motion, Records.of(view), view.plan)[0]


def squared_error_within(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter, *, plan: Plan
) -> jax.Array:
    """The squared error of a design within the scene's tolerances."""
    view = sampled_view(scene, motion, shutter, ONLY_SPECTRA, plan)
    response, count = compute_response(view), view.plan.num_frequencies
    return LinearErrors(view.scene, view.motion, response, count).unknown


def plan_error(
    plan: Plan,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    loss: AbstractLoss | None = None,
) -> float:
    r"""Largest relative change of a result by a plan, $\max_i |x_i - y_i| / |y_i|$.

    The $y_i$ are the loss, or all metrics, computed in full; the $x_i$ what the plan makes of them.
    The expected PSNR counts as the squared error that it stands for. A result of 0 or infinity
    that became another changes without end.
    """
    full = results(everything(plan, scene, motion), scene, motion, shutter, loss)
    return relative_change(results(plan, scene, motion, shutter, loss), full)


def everything(plan: Plan, scene: Scene, motion: AbstractMotion) -> Plan:
    """The full computation whose results those of a plan stand for.

    The length of the DFT is a choice of the plan's, unless no full kernel fits in it.
    """
    full = sizes(scene, motion)
    fits = plan.dft_length >= full.num_taps
    full = replace(full, loss_dft_length=plan.loss_dft_length)
    return replace(full, dft_length=plan.dft_length) if fits else full


def results(
    plan: Plan,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    loss: AbstractLoss | None,
) -> np.ndarray:
    """The loss, or all metrics, as a plan has them computed; shape `(n,)`."""
    if loss is not None:
        return np.array([float(value_of(loss, scene, motion, shutter, plan))])
    return results_of(metrics_by(plan, scene, motion, shutter))


def results_of(metrics: dict[str, jax.Array]) -> np.ndarray:
    """The metrics that are compared, as numbers that are never negative; shape `(n,)`.

    The share of the bound is a least response, which is known to the rounding of the largest: 1.
    """
    squared = 10 ** (-float(metrics["expected_psnr"]) / 10)
    least = 1 + np.sqrt(float(metrics["bound_share"]))
    return np.array([squared, least, *(float(metrics[name]) for name in _NAMES)])


def relative_change(found: np.ndarray, before: np.ndarray, full: np.ndarray | None = None) -> float:
    """Largest change of one of several results, relative to `before` or to `full`."""
    scale = np.abs(before if full is None else full)
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.where(found == before, 0.0, np.abs(found - before) / scale)
    return float(np.max(np.where(np.isnan(change), np.inf, change)))
