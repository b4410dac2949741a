"""A command of few levels, searched slot by slot.

A profile that any level may be sent of is rounded by error diffusion, and changed wherever a change
of one slot, or of two near one another, lowers the loss, until none does. All changes are measured
at once, and as many of the best as lower the loss together are made.
"""

from typing import NamedTuple

import numpy as np

from mishutter.model import AbstractDevice, runs_are_long_enough
from mishutter.search.cover import screened
from mishutter.search.objective import AbstractObjective

_FURTHEST = 3
"""Slots between the two that a change moves light between."""
_MAX_ROUNDS = 200
_LEAST_FALL = 1e-7
"""Fall of the loss, as a share of it, for which another round is worth its time."""
_AT_ONCE = 64


class SearchedSlots(NamedTuple):
    """Levels of the slots, `(n,)`, their loss, and the loss that the search began with."""

    levels: np.ndarray
    loss: float
    first_loss: float


def searched_slots(
    objective: AbstractObjective, levels: np.ndarray, device: AbstractDevice
) -> SearchedSlots:
    """Levels of the slots at which no change of one or two lowers the loss.

    Args:
        objective: The loss by the level of each slot.
        levels: Levels to begin with, of those that the device has; shape `(n,)`.
        device: Whose levels they are, and how many slots in a row they are held.
    """
    steps = (device.levels or 2) - 1
    slots = np.rint(np.asarray(levels, np.float64) * steps).astype(np.int64)

    def losses(rows: np.ndarray) -> np.ndarray:
        return screened(objective, (rows / steps).astype(levels.dtype))

    best = first = float(losses(slots[None])[0])
    for _ in range(_MAX_ROUNDS):
        changes = _changes(slots, steps, device)
        if not len(changes):
            break
        found = losses(slots + changes)
        order = np.argsort(found, kind="stable")
        order = order[found[order] < best * (1 - np.sign(best) * _LEAST_FALL)]
        together = _together(changes[order])
        if not len(together):
            break
        rows = slots + np.cumsum(together, axis=0)
        rows = rows[_allowed(rows, steps, device)]
        found = losses(rows)
        lowest = int(np.argmin(found))
        slots, best = rows[lowest], float(found[lowest])
    return SearchedSlots((slots / steps).astype(levels.dtype), best, first)


def _changes(slots: np.ndarray, steps: int, device: AbstractDevice) -> np.ndarray:
    """Changes of one slot by a level, of two in opposite directions, and of runs; `(k, n)`."""
    unit = np.eye(slots.size, dtype=np.int64)
    changes = [unit, -unit]
    for apart in range(1, _FURTHEST + 1):
        moved = unit[apart:] - unit[:-apart]
        changes += [moved, -moved]
    for length in {device.min_open, device.min_closed} - {1}:
        run = np.stack([unit[i : i + length].sum(axis=0) for i in range(slots.size - length + 1)])
        changes += [run, -run]
    if max(device.min_open, device.min_closed) > 1:  # a whole run, one slot later or earlier
        edges = np.flatnonzero(np.diff(slots))
        rises = np.diff(slots)[edges]
        for shift in (0, 1):
            at = unit[edges + shift] * (rises if shift == 0 else -rises)[:, None]
            changes.append(at[1:] + at[:-1])
    every = np.concatenate(changes)
    return every[_allowed(slots + every, steps, device)]


def _allowed(rows: np.ndarray, steps: int, device: AbstractDevice) -> np.ndarray:
    """Whether rows of levels are such that the device has; `(k, n)` to `(k,)`."""
    inside = np.all((rows >= 0) & (rows <= steps), axis=1)
    return inside & runs_are_long_enough(rows, device.min_open, device.min_closed)


def _together(changes: np.ndarray) -> np.ndarray:
    """The first of some changes, and those after it that touch no slot near one before."""
    taken, chosen = np.zeros(changes.shape[1], bool), []
    for change in changes:
        at = np.flatnonzero(change)
        near = slice(max(0, at[0] - 2), at[-1] + 3)
        if not taken[near].any():
            taken[at[0] : at[-1] + 1] = True
            chosen.append(change)
        if len(chosen) == _AT_ONCE:
            break
    return np.array(chosen)
