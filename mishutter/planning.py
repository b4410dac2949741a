"""The plan of a scene: what is left out of a computation because it cannot change a result."""

from collections.abc import Iterable
from dataclasses import replace
from functools import reduce

import jax
import numpy as np
from jaxtyping import Array

from mishutter.compiling import seldom_run
from mishutter.design_space import DesignSpace, design_space
from mishutter.lengths import extent, size_class
from mishutter.losses.base import AbstractLoss
from mishutter.motion import AbstractMotion, settled
from mishutter.plan import (
    Plan,
    is_symmetric,
    larger,
    nothing_moves,
    power_on_grid,
    sized_for,
    sizes,
)
from mishutter.plan_check import WrongPlanError, check_plan
from mishutter.plan_items import STOPS_AT_NOISE, Needs, items_of, needs_of
from mishutter.plan_tolerance import toleranced
from mishutter.scene import Scene
from mishutter.shutters.base import AbstractShutter
from mishutter.types import require, require_known


def plan(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    loss: AbstractLoss | None = None,
    free: str | Iterable[str] = (),
    tolerance: float = 0.0,
) -> Plan:
    """What a scene needs computed, and why the rest can be left out.

    With `tolerance = 0` only what cannot change a result beyond rounding is left out. With
    a positive one Richardson-Lucy also stops where what it leaves unexplained is noise;
    that changes a restored picture by about as much.

    Args:
        scene: Speeds, light, noise, spectrum and limits; concrete.
        motion: Motion of the sensor; where it is free, that to start from.
        shutter: Transmittance over the exposure; where it is free, that to start from.
        loss: What the plan is for: its value, or all that `evaluate` measures.
        free: What a search may move: `"shutter"`, `"acceleration"`, `"half_exposure"`.
        tolerance: Largest relative change of a result; at least 0.

    Returns:
        The plan. It prints as a table, and every `plan=` takes it.

    Raises:
        ValueError: if `tolerance` is negative or not finite, or `free` names what cannot
            move.
    """
    number = isinstance(tolerance, int | float) and 0 <= tolerance < float("inf")
    require(number, "plan(tolerance=...)", "be a finite number of at least 0", tolerance)
    require_known("plan", motion=motion)
    names = (free,) if isinstance(free, str) else tuple(free)
    motion = settled(motion)
    space = design_space(scene, motion, shutter, names) if names else None
    needs = needs_of(loss)
    exact = replace(exact_plan(scene, motion, shutter, needs, space), tolerance=tolerance)
    if tolerance == 0:
        return exact
    found = toleranced(
        exact,
        scene,
        motion,
        shutter,
        loss,
        fewer_frequencies=needs.only_error and needs.spectra,
        fewer_taps=space is None and needs.kernels,
        fewer_speeds=(needs.spectra or needs.differences) and not exact.still,
        single=space is None,
    )
    if space is None and found.num_kept not in (None, exact.num_kept):
        found = _with_fewer_nodes(found, scene, motion)
    kept = _confirmed(found, exact, scene, motion, shutter, loss)
    return replace(kept, items=(*kept.items, STOPS_AT_NOISE))


def _with_fewer_nodes(found: Plan, scene: Scene, motion: AbstractMotion) -> Plan:
    """Only the nodes that the frequencies ask for which are left."""
    share = (found.num_kept or found.num_frequencies) / found.num_frequencies
    count = min(found.num_nodes, _sizes_of_motion(scene, motion, share, alone=True).num_nodes)
    items = [
        replace(item, kept=str(count)) if item.name == "nodes in time" else item
        for item in found.items
    ]
    return replace(found, num_nodes=count, items=tuple(items))


def _confirmed(
    found: Plan,
    exact: Plan,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    loss: AbstractLoss | None,
) -> Plan:
    """A plan that keeps its bound at the design at hand, or the exact one."""
    try:
        check_plan(found, scene, motion, shutter, loss=loss)
    except WrongPlanError:
        return exact
    return found


def full_sizes(scene: Scene, motion: AbstractMotion, space: DesignSpace | None) -> Plan:
    """Everything, in sizes that hold every design of a space."""
    if space is None:
        return sizes(scene, motion)
    dtype = space.max_speed.dtype
    corners = [design_at(space, jax.device_put(corner.astype(dtype))) for corner in _corners(space)]
    return reduce(larger, [sizes(scene, moved) for _, moved in corners])


@seldom_run
def design_at(space: DesignSpace, box: Array) -> tuple[AbstractShutter, AbstractMotion]:
    """The design at a point of the box."""
    return space.at(box)


def _corners(space: DesignSpace) -> list[np.ndarray]:
    profile = np.full(space.num_profile_coordinates, 0.5)
    num_motion = space.size - profile.size
    return [
        np.concatenate([profile, [(corner >> axis) & 1 for axis in range(num_motion)]])
        for corner in range(1 << num_motion)
    ]


def exact_plan(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    needs: Needs,
    space: DesignSpace | None,
) -> Plan:
    """What can be left out without any change."""
    full = full_sizes(scene, motion, space)
    folds, still = is_symmetric(shutter), nothing_moves(scene)
    num_kept = _frequencies_with_power(scene, full) if needs.only_error else full.num_frequencies
    num_taps, num_nodes = full.num_taps, full.num_nodes
    if space is None or set(space.free) == {"shutter"}:
        tight = _sizes_of_motion(scene, motion, num_kept / full.num_frequencies, space is None)
        num_taps = min(num_taps, tight.num_taps)
        num_nodes = min(num_nodes, tight.num_nodes) if needs.only_error else num_nodes
    kept = replace(
        full,
        num_taps=num_taps,
        num_nodes=num_nodes,
        num_kept=num_kept if num_kept < full.num_frequencies else None,
        skips=True,
        folds=folds,
        still=still,
    )
    return replace(kept, items=items_of(scene, shutter, full, kept, needs, space))


def _sizes_of_motion(scene: Scene, motion: AbstractMotion, share: float, alone: bool) -> Plan:
    """Sizes for one motion, to one of two an octave, so that near scenes share a program.

    Where a search follows, they hold every speed that the motion keeps up with, so that
    scenes of other speeds share its program too.
    """
    reach, velocity, _ = extent(scene, motion)
    a, half = float(motion.acceleration), float(motion.half_exposure)
    longest = 0.0 if alone else 4 * a * half * half
    tight = sized_for(max(reach, longest), share * max(velocity, longest))
    return replace(
        tight, num_taps=size_class(tight.num_taps), num_nodes=size_class(tight.num_nodes)
    )


def _frequencies_with_power(scene: Scene, full: Plan) -> int:
    """How many of the lowest frequencies hold all power, to one of two sizes an octave."""
    lit = np.flatnonzero(power_on_grid(scene, full.num_frequencies))
    last = lit[-1] + 1 if lit.size else 1
    return min(full.num_frequencies, size_class(max(16, int(last))))
