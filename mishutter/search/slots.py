"""A command of few levels, searched slot by slot.

A profile of any levels is rounded by error diffusion, and changed wherever a change of one slot, or
of two near one another, lowers the loss, until none does. All changes are measured at once, and as
many of the best are made as lower the loss together.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from mishutter.model.devices import AbstractDevice
from mishutter.model.slots import runs_are_long_enough
from mishutter.search.objective import AbstractObjective
from mishutter.search.starts import POINTS_AT_ONCE, screened


def searched_slots(
    objective: AbstractObjective, levels: Float[np.ndarray, "n"], device: AbstractDevice
) -> Float[np.ndarray, "n"]:
    """Levels of the slots at which no change of one or two lowers the loss."""
    steps = (device.levels or 2) - 1
    slots = np.rint(np.asarray(levels, np.float64) * steps).astype(np.int64)

    def losses_of(rows: Int[np.ndarray, "k n"]) -> Float[np.ndarray, "k"]:
        return screened(objective, (rows / steps).astype(levels.dtype))

    best = float(losses_of(slots[None])[0])
    for _ in range(200):
        changes = _changes(slots, steps, device)
        if not len(changes):
            break
        losses = losses_of(slots + changes)
        order = np.argsort(losses, kind="stable")
        # A smaller fall is not worth another round; the loss may be negative.
        order = order[losses[order] < best * (1 - np.sign(best) * 1e-7)]
        together = _together(changes[order])
        if not len(together):
            break
        # Each lowers the loss by itself, but all together may overshoot: the first one, the first
        # two and so on are measured.
        rows = slots + np.cumsum(together, axis=0)
        rows = rows[_allowed(rows, steps, device)]
        losses = losses_of(rows)
        lowest = int(np.argmin(losses))
        slots, best = rows[lowest], float(losses[lowest])
    return (slots / steps).astype(levels.dtype)


def _changes(
    slots: Int[np.ndarray, "n"], steps: int, device: AbstractDevice
) -> Int[np.ndarray, "k n"]:
    """Changes of one slot by a level, of two in opposite directions, and of runs."""
    unit = np.eye(slots.size, dtype=np.int64)
    changes = [unit, -unit]
    for apart in range(1, 4):  # the shift of an opening, in slots
        shift = unit[apart:] - unit[:-apart]
        changes += [shift, -shift]
    # Where runs have a least length, a single slot may not change.
    for length in {device.min_open, device.min_closed} - {1}:
        run = np.stack([unit[i : i + length].sum(axis=0) for i in range(slots.size - length + 1)])
        changes += [run, -run]
    if max(device.min_open, device.min_closed) > 1:  # a whole run, one slot later or earlier
        edges = np.flatnonzero(np.diff(slots))
        rises = np.diff(slots)[edges]
        for side, sign in ((0, 1), (1, -1)):
            at_edges = unit[edges + side] * (sign * rises)[:, None]
            changes.append(at_edges[1:] + at_edges[:-1])
    every = np.concatenate(changes)
    return every[_allowed(slots + every, steps, device)]


def _allowed(
    rows: Int[np.ndarray, "k n"], steps: int, device: AbstractDevice
) -> Bool[np.ndarray, "k"]:
    """Whether the device can make each row of levels."""
    inside = np.all((rows >= 0) & (rows <= steps), axis=1)
    return inside & runs_are_long_enough(rows, device.min_open, device.min_closed)


def _together(changes: Int[np.ndarray, "k n"]) -> np.ndarray:
    """The first of some changes, and those after it that touch no slot near an earlier one."""
    is_touched, together = np.zeros(changes.shape[1], bool), []
    for change in changes:
        slots = np.flatnonzero(change)
        # Two changes near one another may each lower the loss, and together raise it.
        near = slice(max(0, slots[0] - 2), slots[-1] + 3)
        if not is_touched[near].any():
            is_touched[slots[0] : slots[-1] + 1] = True
            together.append(change)
        if len(together) == POINTS_AT_ONCE:
            break
    return np.array(together)
