"""The plan of a scene leaves out the work that cannot change a result."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import reduce
from itertools import product

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core import compiled, require_known
from mishutter.evaluation import (
    SEARCHED_EFFECTIVE_SPEEDS,
    AbstractLoss,
    AbstractResponseLoss,
    Item,
    LossFunction,
    Plan,
    WeightedSum,
    as_loss,
    coarser,
    distinct_speeds,
    extent,
    folds_speeds,
    larger,
    power_on_grid,
    require_sizes,
    size_class,
    sized_for,
    sizes,
)
from mishutter.model import (
    AbstractAdjustableShutter,
    AbstractMotion,
    AbstractShutter,
    Scene,
    simplified,
)
from mishutter.search.space import FREE_NAMES, DesignSpace, design_space, search_frame


@dataclass(frozen=True)
class Needs:
    """The numbers that a loss, or all metrics, are made from.

    Attributes:
        kernels: Whether they are made from a kernel.
        differences: Whether they are made from kernels of moving objects.
        spectra: Whether they are made from transfer functions.
        only_error: Whether the transfer functions serve the expected error alone, to which a
            frequency without power adds nothing.
        num_terms: Number of terms of the loss.
        num_weighty: Number of terms that have a weight.
    """

    kernels: bool = True
    differences: bool = True
    spectra: bool = True
    only_error: bool = False
    num_terms: int = 1
    num_weighty: int = 1


def needs_of(loss: AbstractLoss | None) -> Needs:
    """The needs of a loss; everything without a loss, or for one of a user's own."""
    if loss is None:
        return Needs()
    every = loss.needed(skips=False) if isinstance(loss, WeightedSum) else [(loss, 1.0)]
    weighty = loss.needed(skips=True) if isinstance(loss, WeightedSum) else every
    terms = [term for term, _ in weighty if isinstance(term, AbstractResponseLoss)]
    if len(terms) < len(weighty):
        return Needs(num_terms=len(every), num_weighty=len(weighty))
    skipping = Plan(1, 1, 1, 1, skips=True)
    parts = [term.parts(skipping) for term in terms]
    errors = [t.decoder_speed is not None for t, p in zip(terms, parts, strict=True) if p.spectra]
    return Needs(
        kernels=any(part.kernels for part in parts),
        differences=any(part.differences for part in parts),
        spectra=any(part.spectra for part in parts),
        only_error=all(errors),
        num_terms=len(every),
        num_weighty=len(weighty),
    )


def plan(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    loss: LossFunction | None = None,
    free: str | Iterable[str] = (),
) -> Plan:
    """Plan the computation of a scene, with the reason for each part that is left out.

    The plan leaves out only work that changes a result by no more than rounding.

    Args:
        scene: Speeds, light, noise, spectrum and limits; concrete.
        motion: Motion of the sensor; where it is free, the motion to start from.
        shutter: Transmittance over the exposure; where it is free, the profile to start from.
        loss: The loss whose value is planned; by default all metrics that `evaluate` measures.
        free: Parts that a search may move: `"shutter"`, `"path"`, `"half_exposure"`,
            `"velocity"`, `"acceleration"`.

    Returns:
        The plan. It prints as a table, and every `plan=` takes it.

    Raises:
        ValueError: if `free` names what cannot move.

    Examples:
        >>> from mishutter import HannShutter, Limits, ParabolicMotion, Scene, plan
        >>> limits = Limits(max_stroke=20, max_half_exposure=0.02)
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=5, limits=limits)
        >>> motion = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
        >>> print(" ".join(str(plan(scene, motion, HannShutter())).splitlines()[1].split()[:6]))
        speeds 9 5 4 mirrored: a
    """
    require_known("plan", motion=motion)
    names = (free,) if isinstance(free, str) else tuple(free)
    scene, motion = search_frame(scene, motion, names)
    space = design_space(scene, motion, shutter, names) if names else None
    loss = None if loss is None else as_loss(loss, "plan(loss=...)")
    return exact_plan(scene, motion, shutter, needs_of(loss), space)


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
    space: DesignSpace, box: Float[np.ndarray, "size"]
) -> tuple[AbstractShutter, AbstractMotion]:
    """The design at a point of the box."""
    motion = _motion_at(space, box)
    if space.device is None and not space.num_profile_coordinates:
        return space.shutter, motion
    return _shutter_at(space, box, motion.half_exposure), motion


def _motion_at(space: DesignSpace, box: Float[np.ndarray, "size"]) -> AbstractMotion:
    """The motion at a point of the box, of the kind that its numbers make it."""
    alone = space.of_motion
    return simplified(_of_motion(alone, box[space.size - alone.size :]))


@compiled
def _of_motion(space: DesignSpace, box: Float[Array | np.ndarray, "size"]) -> AbstractMotion:
    return space.at(jnp.asarray(box))[1]


@compiled
def _shutter_at(
    space: DesignSpace,
    box: Float[Array | np.ndarray, "size"],
    half_exposure: Float[Array, ""],
) -> AbstractShutter:
    return space.shutter_at(jnp.asarray(box), half_exposure)


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


def exact_plan(
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
    exact = exact if space is None else coarser(exact)
    items = items_of(scene, shutter, full, exact, needs=needs, space=space)
    return replace(exact, items=items)


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


def items_of(
    scene: Scene,
    shutter: AbstractShutter,
    full: Plan,
    exact: Plan,
    *,
    needs: Needs,
    space: DesignSpace | None,
) -> tuple[Item, ...]:
    """The table of an exact plan, beside a full one."""
    return (
        _speeds_item(scene, exact.folds, exact.still),
        _kernels_item(needs, exact.still),
        _taps_item(full, exact, needs, space),
        Item(
            "DFT length",
            *_pair(full.dft_length),
            "four times the longest kernel; real taps, "
            f"hence {full.dft_length // 2 + 1} frequencies",
        ),
        *_spectra_items(full, exact, needs, space),
        *_layers_items(exact, needs),
        *_terms_items(needs),
        *_search_items(shutter, space),
        _precision_item(scene),
    )


def _pair(count: int) -> tuple[str, str]:
    return str(count), str(count)


def _speeds_item(scene: Scene, folds: bool, still: bool) -> Item:
    count, never = scene.speeds.size, int(np.sum(np.asarray(scene.weights) == 0))
    num_distinct = distinct_speeds(scene, folds=False)[0].size
    num_computed = distinct_speeds(scene, folds=folds)[0].size
    why = []
    if never:
        why.append(f"{never} never occur")
    if count - never > num_distinct:
        why.append(f"{count - never - num_distinct} repeated")
    if num_distinct > num_computed:
        mirrored = num_distinct - num_computed
        why.append(f"{mirrored} mirrored: a symmetric shutter does the same to +s and -s")
    if still:
        why.append("nothing moves")
    return Item("speeds", str(count), str(num_computed), "; ".join(why) or "each occurs once")


def _kernels_item(needs: Needs, still: bool) -> Item:
    if not needs.kernels:
        return Item("kernels", "all", "none", "the loss is made from transfer functions")
    if still:
        return Item("kernels", "all", "at rest", "nothing moves: no invariance to measure")
    if not needs.differences:
        return Item("kernels", "all", "at rest", "invariance has no weight")
    return Item("kernels", "all", "all", "invariance is measured")


def _taps_item(full: Plan, exact: Plan, needs: Needs, space: DesignSpace | None) -> Item:
    if not needs.kernels:
        return Item("taps", str(full.num_taps), "0", "no kernel is computed")
    return Item("taps", str(full.num_taps), str(exact.num_taps), _reach(space))


def _reach(space: DesignSpace | None) -> str:
    if space is None:
        return "what the fastest object reaches on this motion"
    if set(space.free) == {"shutter"}:
        return "what any object reaches that this motion keeps up with"
    return "the motion is free within the limits"


def _spectra_items(full: Plan, exact: Plan, needs: Needs, space: DesignSpace | None) -> list[Item]:
    if not needs.spectra:
        return [
            Item("frequencies", str(full.num_frequencies), "0", "no transfer function is needed"),
            Item("nodes in time", str(full.num_nodes), "0", "no transfer function is needed"),
        ]
    if exact.num_kept is not None:
        why = "the picture on the sensor holds no power above"
    else:
        why = "all hold power" if needs.only_error else "the bound's share needs all"
    count = str(exact.num_kept or full.num_frequencies)
    reach = _reach(space) if needs.only_error else "beside a zero the bound's share shows them"
    return [
        Item("frequencies", str(full.num_frequencies), count, why),
        Item("nodes in time", str(full.num_nodes), str(exact.num_nodes), reach),
    ]


def _layers_items(exact: Plan, needs: Needs) -> list[Item]:
    """The row on the background that edges of objects uncover; none for scenes without edges."""
    count = exact.num_effective_speeds
    if not count:
        return []
    if not needs.spectra:
        return [Item("effective speeds", str(count), "0", "no transfer function is needed")]
    beat = "background that edges uncover moves at speeds in between and beyond, by the exposure"
    why = f"{beat}; {SEARCHED_EFFECTIVE_SPEEDS} are enough for a search"
    return [Item("effective speeds", *_pair(count), why)]


def _terms_items(needs: Needs) -> list[Item]:
    count, weighty = needs.num_terms, needs.num_weighty
    if count == weighty == 1:
        return []
    why = "the others have weight 0" if weighty < count else "each has weight"
    return [Item("terms of the loss", str(count), str(weighty), why)]


def _search_items(shutter: AbstractShutter, space: DesignSpace | None) -> list[Item]:
    if space is None:
        return []
    every = [name for name in FREE_NAMES if name != "path" or name in space.free]
    fixed = [name for name in every if name not in space.free]
    why = f"{', '.join(fixed)} not free" if fixed else "all are free"
    items = [Item("free parameters", str(len(every)), str(len(space.free)), why)]
    linear = isinstance(shutter, AbstractAdjustableShutter) and shutter.linear
    if linear and set(space.free) == {"shutter"}:
        why = "each coordinate's response is computed once, before the search"
        items.append(Item("a step of the search", "responses", "one product", why))
    return items


def _precision_item(scene: Scene) -> Item:
    name = np.dtype(scene.speeds.dtype).name
    return Item("precision", name, name, "as given")
