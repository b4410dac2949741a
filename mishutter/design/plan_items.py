"""What a loss is made from, and the lines of a plan's table: what is kept, and why."""

from dataclasses import dataclass

import numpy as np

from mishutter.design.space import DesignSpace
from mishutter.evaluation import (
    AbstractLoss,
    AbstractResponseLoss,
    ExpectedErrorLoss,
    Item,
    Plan,
    WeightedSum,
    distinct_speeds,
)
from mishutter.model import AbstractAdjustableShutter, AbstractShutter, Scene

STOPS_AT_NOISE = Item(
    "decoder steps", "all", "to noise", "what Richardson-Lucy leaves then is noise", bound=None
)


@dataclass(frozen=True)
class Needs:
    """What a loss, or all metrics, are made from.

    Attributes:
        kernels: Whether a kernel is.
        differences: Whether kernels of moving objects are.
        spectra: Whether transfer functions are.
        only_error: Whether these only serve the expected error, which a frequency
            without power adds nothing to.
        terms: Terms of the loss that were given, and that have weight.
    """

    kernels: bool = True
    differences: bool = True
    spectra: bool = True
    only_error: bool = False
    terms: tuple[int, int] = (1, 1)


def needs_of(loss: AbstractLoss | None) -> Needs:
    """What a loss is made from; everything where that is not known."""
    if loss is None:
        return Needs()
    given = loss.needed(skips=False) if isinstance(loss, WeightedSum) else [(loss, 1.0)]
    kept = loss.needed(skips=True) if isinstance(loss, WeightedSum) else given
    count = len(given), len(kept)
    terms = [term for term, _ in kept]
    if not all(isinstance(term, AbstractResponseLoss) for term in terms):
        return Needs(terms=count)
    skipping = Plan(1, 1, 1, 1, skips=True)
    parts = [term.parts(skipping) for term in terms]  # type: ignore[attr-defined]
    errors = [isinstance(t, ExpectedErrorLoss) for t, p in zip(terms, parts, strict=True) if p[1]]
    kernels, spectra, differences = (any(flags) for flags in zip(*parts, strict=True))
    return Needs(kernels, differences, spectra, all(errors), count)


def items_of(
    scene: Scene,
    shutter: AbstractShutter,
    full: Plan,
    kept: Plan,
    needs: Needs,
    space: DesignSpace | None,
) -> tuple[Item, ...]:
    """The table of an exact plan, beside a full one."""
    return (
        _speeds_item(scene, kept.folds, kept.still),
        _kernels_item(needs, kept.still),
        _taps_item(full, kept, needs, space),
        Item(
            "DFT length",
            *_pair(full.dft_length),
            "four times the longest kernel; real taps, "
            f"hence {full.dft_length // 2 + 1} frequencies",
        ),
        *_spectra_items(full, kept, needs, space),
        *_terms_items(needs),
        *_search_items(shutter, space),
        _precision_item(scene),
    )


def _pair(count: int) -> tuple[str, str]:
    return str(count), str(count)


def _speeds_item(scene: Scene, folds: bool, still: bool) -> Item:
    given, weights = np.asarray(scene.speeds), np.asarray(scene.weights)
    every = distinct_speeds(scene, folds=False)[0].size
    kept = distinct_speeds(scene, folds=folds)[0].size
    why = []
    never = int(np.sum(weights == 0))
    if never:
        why.append(f"{never} never occur")
    if given.size - never > every:
        why.append(f"{given.size - never - every} repeated")
    if every > kept:
        why.append(f"{every - kept} mirrored: a symmetric shutter does the same to +s and -s")
    if still:
        why.append("nothing moves")
    return Item("speeds", str(given.size), str(kept), "; ".join(why) or "each occurs once")


def _kernels_item(needs: Needs, still: bool) -> Item:
    if not needs.kernels:
        return Item("kernels", "all", "none", "the loss is made from transfer functions")
    if still:
        return Item("kernels", "all", "at rest", "nothing moves: no invariance to measure")
    if not needs.differences:
        return Item("kernels", "all", "at rest", "invariance has no weight")
    return Item("kernels", "all", "all", "invariance is measured")


def _taps_item(full: Plan, kept: Plan, needs: Needs, space: DesignSpace | None) -> Item:
    if not needs.kernels:
        return Item("taps", str(full.num_taps), "0", "no kernel is computed")
    return Item("taps", str(full.num_taps), str(kept.num_taps), _reach(space))


def _reach(space: DesignSpace | None) -> str:
    if space is None:
        return "what the fastest object reaches on this motion"
    if set(space.free) == {"shutter"}:
        return "what any object reaches that this motion keeps up with"
    return "the motion is free within the limits"


def _spectra_items(full: Plan, kept: Plan, needs: Needs, space: DesignSpace | None) -> list[Item]:
    if not needs.spectra:
        return [
            Item("frequencies", str(full.num_frequencies), "0", "no transfer function is needed"),
            Item("nodes in time", str(full.num_nodes), "0", "no transfer function is needed"),
        ]
    if kept.num_kept is not None:
        why = "the picture on the sensor holds no power above"
    else:
        why = "all hold power" if needs.only_error else "the bound's share needs all"
    count = str(kept.num_kept or full.num_frequencies)
    reach = _reach(space) if needs.only_error else "beside a zero the bound's share shows them"
    return [
        Item("frequencies", str(full.num_frequencies), count, why),
        Item("nodes in time", str(full.num_nodes), str(kept.num_nodes), reach),
    ]


def _terms_items(needs: Needs) -> list[Item]:
    given, kept = needs.terms
    if given == kept == 1:
        return []
    why = "the others have weight 0" if kept < given else "each has weight"
    return [Item("terms of the loss", str(given), str(kept), why)]


def _search_items(shutter: AbstractShutter, space: DesignSpace | None) -> list[Item]:
    if space is None:
        return []
    fixed = [
        name for name in ("shutter", "acceleration", "half_exposure") if name not in space.free
    ]
    why = f"{', '.join(fixed)} not free" if fixed else "all are free"
    items = [Item("free parameters", "3", str(3 - len(fixed)), why)]
    linear = isinstance(shutter, AbstractAdjustableShutter) and shutter.linear
    if linear and set(space.free) == {"shutter"}:
        why = "each coordinate's response is computed once, before the search"
        items.append(Item("a step of the search", "responses", "one product", why))
    return items


def _precision_item(scene: Scene) -> Item:
    name = np.dtype(scene.speeds.dtype).name
    return Item("precision", name, name, "as given")
