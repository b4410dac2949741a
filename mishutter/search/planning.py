"""The plan of a scene leaves out the work that cannot change a result."""

from collections.abc import Iterable
from dataclasses import replace
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
    EVERY_PART,
    ONLY_SPECTRA,
    Extent,
    Parts,
    Plan,
    distinct_speeds,
    folds_speeds,
    size_class,
    sizes,
)
from mishutter.model.motion import AbstractMotion, simplified
from mishutter.model.scene import Scene, power_on_grid
from mishutter.model.shutters.base import AbstractAdjustableShutter, AbstractShutter
from mishutter.search.space import FREE_NAMES, DesignSpace, design_space, search_frame


def needs_of(loss: AbstractLoss) -> tuple[Parts, bool]:
    """Parts that a loss is made from, and whether spectra serve the expected error alone."""
    terms = [term for term, _ in loss.needed] if isinstance(loss, WeightedSum) else [loss]
    of_response = [term for term in terms if isinstance(term, AbstractResponseLoss)]
    if len(of_response) < len(terms):  # a loss of the user's own may be made from everything
        return EVERY_PART, False
    parts = Parts.of_all(term.parts for term in of_response)
    return parts, all(term.decoder_speed is not None for term in of_response if term.parts.spectra)


class SearchPlan(NamedTuple):
    """The plan of a search, and what it is for."""

    sizes: Plan  # The parts to compute
    scene: Scene  # The scene, in the frame of the search
    parts: Parts  # The parts of a response that the loss is made from
    space: DesignSpace | None  # The designs that may be searched; None where nothing moves

    @property
    def skips(self) -> list[str]:
        """The parts that are left out and why, each a sentence."""
        sizes, parts, scene = self.sizes, self.parts, self.scene
        skips, num_speeds = [], scene.speeds.size
        num_distinct = distinct_speeds(scene, folds=False)[0].size
        num_computed = distinct_speeds(scene, folds=sizes.folds)[0].size
        num_absent = int(np.sum(np.asarray(scene.weights) == 0))
        same = "to which a symmetric shutter does the same"
        reasons = [
            (num_absent, "never occur"),
            (num_speeds - num_absent - num_distinct, "occur twice"),
            (num_distinct - num_computed, f"mirror others, {same}"),
        ]
        why = ", ".join(f"{number} {reason}" for number, reason in reasons if number)
        if why:
            skips.append(f"{num_computed} of {num_speeds} speeds are computed: {why}.")
        if not parts.kernels:
            skips.append("No kernel is computed: the loss is made from transfer functions.")
        elif sizes.still:
            skips.append("One kernel is computed: nothing moves.")
        elif not parts.differences:
            skips.append("One kernel is computed: invariance has no weight.")
        if not parts.spectra:
            skips.append("No transfer function is computed: the loss is made from kernels.")
        elif sizes.num_kept is not None:
            of_all = f"{sizes.num_kept:,} of {sizes.num_frequencies:,} frequencies are computed"
            skips.append(f"{of_all}: the picture on the sensor holds no power above.")
        if self.space is None:
            return skips
        free, shutter = self.space.free, self.space.shutter
        fixed = [name for name in FREE_NAMES if name not in free]
        if fixed:
            skips.append(f"These parts are fixed: {', '.join(fixed)}.")
        linear = isinstance(shutter, AbstractAdjustableShutter) and shutter.linear
        if linear and free == ("shutter",):
            why = "each coefficient's response is computed once, before the search"
            skips.append(f"A step of the search is one matrix product: {why}.")
        return skips


def plan(
    scene: Scene,  # concrete
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    loss: LossFunction,
    free: str | Iterable[str] = (),
) -> SearchPlan:
    """Plans the computation of a loss, and leaves out only what changes it by rounding at most."""
    names = (free,) if isinstance(free, str) else tuple(free)
    scene, motion = search_frame(scene, motion, names)
    space = design_space(scene, motion, shutter, names) if names else None
    parts, only_error = needs_of(as_loss(loss, "plan(loss=...)"))
    own = _exact_sizes(scene, motion, shutter, space, spectra=parts.spectra, only_error=only_error)
    return SearchPlan(own, scene, parts, space)


def full_sizes(scene: Scene, motion: AbstractMotion, space: DesignSpace | None) -> Plan:
    """Everything, in sizes that hold every design of a space."""
    if space is None:
        return sizes(scene, motion)
    # Corners of the motion's coordinates, and the middle velocity, at which two speeds are one.
    ends = [(0, 0.5, 1) if name == "velocity" else (0, 1) for name in space.free_of_motion]
    profile = np.full(space.num_profile_coordinates, 0.5)
    corners = [np.append(profile, point).astype(space.dtype) for point in product(*ends)]
    spaces = [space]
    if "acceleration" in space.free:
        spaces.append(space.without_acceleration())
    motions = [_motion_at(each, corner) for each in spaces for corner in corners]
    return reduce(Plan.holding, [sizes(scene, motion) for motion in motions])


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


_shutter_at = compiled(DesignSpace.shutter_at)


def _exact_sizes(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    space: DesignSpace | None,
    *,
    spectra: bool,
    only_error: bool,
) -> Plan:
    """The plan that leaves out all work that cannot change a result."""
    full = full_sizes(scene, motion, space)
    pans = space is not None and "velocity" in space.free
    folds = folds_speeds(scene, motion, shutter) and not pans
    still = not pans and scene.nothing_moves
    num_kept = full.num_frequencies
    if spectra and only_error:
        full.require_feasible(ONLY_SPECTRA)
        powers = np.flatnonzero(power_on_grid(scene, full.num_frequencies))
        last = int(powers[-1]) + 1 if powers.size else 1
        num_kept = min(full.num_frequencies, size_class(max(16, last)))
    num_taps, num_nodes = full.num_taps, full.num_nodes
    if space is None or set(space.free) == {"shutter"}:
        # Where a search follows, the sizes hold every speed that the motion keeps up with. So, and
        # by rounding to two sizes an octave, scenes of other speeds share a program.
        reach, velocity, _ = map(float, Extent.of(scene, motion))
        longest = 0.0 if space is None else 4 * float(motion.sag)
        velocity = num_kept / full.num_frequencies * max(velocity, longest)
        tight = Plan.of_travel(max(reach, longest), velocity)
        num_taps = min(num_taps, size_class(tight.num_taps))
        if only_error:
            num_nodes = min(num_nodes, size_class(tight.num_nodes))
    exact = replace(
        full,
        num_taps=num_taps,
        num_nodes=num_nodes,
        num_kept=num_kept if num_kept < full.num_frequencies else None,
        skips=True,
        folds=folds,
        still=still,
    )
    return exact if space is None else exact.coarser()
