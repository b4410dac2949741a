"""The plan of a scene leaves out the work that cannot change a result."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import reduce
from itertools import product
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.compiling import compiled
from mishutter.evaluation.losses import (
    AbstractLoss,
    AbstractResponseLoss,
    LossFunction,
    WeightedSum,
    as_loss,
)
from mishutter.evaluation.needs import (
    Plan,
    coarser,
    distinct_speeds,
    extent,
    folds_speeds,
    larger,
    require_sizes,
    size_class,
    sized_for,
    sizes,
)
from mishutter.model.motion import AbstractMotion, simplified
from mishutter.model.scene import Scene, power_on_grid
from mishutter.model.shutters.base import AbstractAdjustableShutter, AbstractShutter
from mishutter.search.space import FREE_NAMES, DesignSpace, design_space, search_frame


@dataclass(frozen=True)
class Needs:
    """The numbers that a loss, or all metrics, are made from."""

    kernels: bool  # Whether they are made from a kernel
    differences: bool  # Whether they are made from kernels of moving objects
    spectra: bool  # Whether they are made from transfer functions
    # Whether the transfer functions serve the expected error alone, to which a frequency without
    # power adds nothing
    only_error: bool


def needs_of(loss: AbstractLoss) -> Needs:
    """The needs of a loss; everything for one of a user's own."""
    terms = [term for term, _ in loss.needed] if isinstance(loss, WeightedSum) else [loss]
    of_response = [term for term in terms if isinstance(term, AbstractResponseLoss)]
    if len(of_response) < len(terms):
        return Needs(kernels=True, differences=True, spectra=True, only_error=False)
    spectral = [term for term in of_response if term.parts.spectra]
    return Needs(
        kernels=any(term.parts.kernels for term in of_response),
        differences=any(term.parts.differences for term in of_response),
        spectra=bool(spectral),
        only_error=all(term.decoder_speed is not None for term in spectral),
    )


class SearchPlan(NamedTuple):
    """The plan of a search, and what it is for."""

    sizes: Plan  # The parts to compute
    scene: Scene  # The scene, in the frame of the search
    needs: Needs  # The numbers that the loss is made from
    space: DesignSpace | None  # The designs that may be searched; None where nothing moves

    @property
    def skips(self) -> list[str]:
        """The parts that are left out and why, each a sentence."""
        return [*_of_speeds(self), *_of_kernels(self), *_of_spectra(self), *_of_search(self)]


def plan(
    scene: Scene,  # concrete
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    loss: LossFunction,
    free: str | Iterable[str] = (),
) -> SearchPlan:
    """Plans the computation of a loss, and leaves out only what changes it by rounding at most.

    Raises:
        ValueError: if `free` names what cannot move.
    """
    names = (free,) if isinstance(free, str) else tuple(free)
    scene, motion = search_frame(scene, motion, names)
    space = design_space(scene, motion, shutter, names) if names else None
    needs = needs_of(as_loss(loss, "plan(loss=...)"))
    return SearchPlan(_exact_sizes(scene, motion, shutter, needs, space), scene, needs, space)


def full_sizes(scene: Scene, motion: AbstractMotion, space: DesignSpace | None) -> Plan:
    """Everything, in sizes that hold every design of a space."""
    if space is None:
        return sizes(scene, motion)
    dtype = space.dtype
    corners = [corner.astype(dtype) for corner in _corners(space)]
    spaces = [space]
    if "acceleration" in space.free and "path" not in space.free:
        spaces.append(space.without_acceleration())
    motions = [_motion_at(each, corner) for each in spaces for corner in corners]
    return reduce(larger, [sizes(scene, motion) for motion in motions])


def design_at(
    space: DesignSpace, point: Float[np.ndarray, "size"]
) -> tuple[AbstractShutter, AbstractMotion]:
    """The design at a point of the box."""
    motion = _motion_at(space, point)
    if space.device is None and not space.num_profile_coordinates:
        return space.shutter, motion
    return _shutter_at(space, point, motion.half_exposure), motion


def _motion_at(space: DesignSpace, point: Float[np.ndarray, "size"]) -> AbstractMotion:
    """The motion at a point of the box, of the kind that its numbers make it."""
    alone = space.of_motion
    return simplified(_of_motion(alone, point[space.size - alone.size :]))


@compiled
def _of_motion(space: DesignSpace, point: Float[Array | np.ndarray, "size"]) -> AbstractMotion:
    return space.at(jnp.asarray(point))[1]


@compiled
def _shutter_at(
    space: DesignSpace,
    point: Float[Array | np.ndarray, "size"],
    half_exposure: Float[Array, ""],
) -> AbstractShutter:
    return space.shutter_at(jnp.asarray(point), half_exposure)


def _corners(space: DesignSpace) -> list[Float[np.ndarray, "size"]]:
    """Corners of the motion's coordinates, and the middle velocity, at which two speeds are one.

    A path travels furthest with all of its acceleration in one piece, or in one of each half.
    """
    profile = np.full(space.num_profile_coordinates, 0.5)
    paths = np.eye(space.num_path_coordinates)
    if paths.size and not space.path_mirrors:
        first, last = np.split(paths, 2)
        pairs = [one + other for one, other in product(first[[0, -1]], last[[0, -1]])]
        paths = np.concatenate([paths, pairs])
    shapes = [np.concatenate([profile, path]) for path in paths] or [profile]
    ends = [(0, 0.5, 1) if name == "velocity" else (0, 1) for name in space.free_of_motion]
    return [np.concatenate(corner) for corner in product(shapes, product(*ends))]


def _exact_sizes(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    needs: Needs,
    space: DesignSpace | None,
) -> Plan:
    """The plan that leaves out all work that cannot change a result."""
    full = full_sizes(scene, motion, space)
    pans = space is not None and "velocity" in space.free
    one_sided = space is not None and "path" in space.free and not space.path_mirrors
    folds = folds_speeds(scene, motion, shutter) and not (pans or one_sided)
    still = not pans and scene.nothing_moves
    num_kept = full.num_frequencies
    if needs.spectra and needs.only_error:
        require_sizes(full.num_taps, num_kept, kernels=False, spectra=True)
        num_kept = _frequencies_with_power(scene, full)
    num_taps, num_nodes = full.num_taps, full.num_nodes
    if space is None or set(space.free) == {"shutter"}:
        tight = _sizes_of_motion(scene, motion, num_kept / full.num_frequencies, space is None)
        num_taps = min(num_taps, tight.num_taps)
        num_nodes = min(num_nodes, tight.num_nodes) if needs.only_error else num_nodes
    exact = replace(
        full,
        num_taps=num_taps,
        num_nodes=num_nodes,
        num_kept=num_kept if num_kept < full.num_frequencies else None,
        skips=True,
        folds=folds,
        still=still,
    )
    return exact if space is None else coarser(exact)


def _sizes_of_motion(scene: Scene, motion: AbstractMotion, share: float, alone: bool) -> Plan:
    """Sizes for one motion, rounded to two an octave, so that near scenes share a program.

    Where a search follows, they hold every speed that the motion keeps up with, so that
    scenes of other speeds share its program too.
    """
    travel, longest = extent(scene, motion), 0.0 if alone else 4 * float(motion.sag)
    tight = sized_for(max(travel.reach, longest), share * max(travel.velocity, longest))
    return replace(
        tight, num_taps=size_class(tight.num_taps), num_nodes=size_class(tight.num_nodes)
    )


def _frequencies_with_power(scene: Scene, full: Plan) -> int:
    """Number of the lowest frequencies that hold all power, rounded to two sizes an octave."""
    places = np.flatnonzero(power_on_grid(scene, full.num_frequencies))
    last = places[-1] + 1 if places.size else 1
    return min(full.num_frequencies, size_class(max(16, int(last))))


def _of_speeds(found: SearchPlan) -> list[str]:
    scene, count = found.scene, found.scene.speeds.size
    num_distinct = distinct_speeds(scene, folds=False)[0].size
    num_computed = distinct_speeds(scene, folds=found.sizes.folds)[0].size
    num_absent = int(np.sum(np.asarray(scene.weights) == 0))
    reasons = {
        "never occur": num_absent,
        "occur twice": count - num_absent - num_distinct,
        "mirror others, to which a symmetric shutter does the same": num_distinct - num_computed,
    }
    why = ", ".join(f"{number} {reason}" for reason, number in reasons.items() if number)
    return [f"{num_computed} of {count} speeds are computed: {why}."] if why else []


def _of_kernels(found: SearchPlan) -> list[str]:
    if not found.needs.kernels:
        return ["No kernel is computed: the loss is made from transfer functions."]
    if found.sizes.still:
        return ["One kernel is computed: nothing moves."]
    if not found.needs.differences:
        return ["One kernel is computed: invariance has no weight."]
    return []


def _of_spectra(found: SearchPlan) -> list[str]:
    plan = found.sizes
    if not found.needs.spectra:
        return ["No transfer function is computed: the loss is made from kernels."]
    if plan.num_kept is None:
        return []
    of_all = f"{plan.num_kept:,} of {plan.num_frequencies:,} frequencies are computed"
    return [f"{of_all}: the picture on the sensor holds no power above."]


def _of_search(found: SearchPlan) -> list[str]:
    if found.space is None:
        return []
    fixed = [name for name in FREE_NAMES if name not in found.space.free and name != "path"]
    sentences = [f"These parts are fixed: {', '.join(fixed)}."] if fixed else []
    shutter = found.space.shutter
    linear = isinstance(shutter, AbstractAdjustableShutter) and shutter.linear
    if linear and found.space.free == ("shutter",):
        why = "each coefficient's response is computed once, before the search"
        sentences.append(f"A step of the search is one matrix product: {why}.")
    return sentences
