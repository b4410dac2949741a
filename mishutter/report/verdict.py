"""The verdict of a scene: which camera to build, in words, and the notes that stand below it."""

from collections.abc import Iterable, Mapping, Sequence

from mishutter.hardware import Design
from mishutter.model import AbstractDevice, FirstOrderShutter, Scene, SplineShutter, command_of
from mishutter.search import (
    BEST_SNAPSHOT,
    SHAPED_ON_FREE_PATH,
    SNAPSHOTS,
    Entry,
    Row,
    best_row,
    beyond_limits,
    plainest,
    taken_names,
)

_WORTH_IT = 0.1
"""Gain over an ordinary snapshot below which a coded camera is not worth building; dB."""
LEAST_SHOWN = 0.005
"""Least gain that two decimals show; dB."""


def verdict_lines(
    rows: Sequence[Row], choice: Row, own: Row | None, snapshot: Row, most: float
) -> list[str]:
    """Sentences on the camera to build, the ceiling, and the cameras beside it.

    Args:
        rows: The rows at their own best motions, without a burst.
        choice: The `row_to_build`.
        own: The best row of the user's shutters and designs; None without any.
        snapshot: The best snapshot.
        most: The ceiling; dB.
    """
    beside = _beside(rows, choice, own)
    at_worst = " at the worst speed" if choice.at_worst else ""
    if choice.name in SNAPSHOTS:
        return [
            "Do not build a coded camera for this scene: nothing beats a snapshot by "
            f"{_WORTH_IT} dB.",
            f"Use an ordinary shutter: {choice.setting}, {choice.level:.2f} dB{at_worst}. "
            f"Ceiling: {most:.2f} dB.",
            *_of_pan(rows, choice),
            *beside,
        ]
    reach = (
        f"It takes {_in_words(choice.takes)}: {choice.setting}. Ceiling: {most:.2f} dB."
        if own is not None and choice.takes < own.takes
        else f"It is {max(most - choice.level, 0.0):.2f} dB below what any path and any shutter "
        f"could reach ({most:.2f} dB)."
    )
    return [
        f"Build {choice.name}: {choice.level:.2f} dB{at_worst}, "
        f"{choice.lead_over(snapshot):.2f} dB above the {snapshot.name}.",
        reach,
        *beside,
    ]


def _of_pan(rows: Sequence[Row], snapshot: Row) -> list[str]:
    """The sentence on the gain of a panned snapshot over one at rest."""
    at_rest = next(row for row in rows if row.name == BEST_SNAPSHOT)
    gain = snapshot.lead_over(at_rest)
    if gain < LEAST_SHOWN:
        return []
    return [f"The pan alone brings {gain:.2f} dB: a snapshot at rest has {at_rest.level:.2f} dB."]


def row_to_build(rows: Sequence[Row], own: Row | None, snapshot: Row) -> Row:
    """The row to build: the plainest of all that are about as good as the best.

    Rows within `_WORTH_IT` of the best are about as good, and a coded camera must exceed the best
    snapshot by that much. Among equally good and plain rows the best of the user's is preferred.
    If that one is worth building, it is also preferred to a profile on a free path, which asks more
    of a stage.

    Args:
        rows: The rows at their own best motions, without a burst.
        own: The best row of the user's shutters and designs; None without any.
        snapshot: The best snapshot.
    """
    top = best_row(rows)
    if own is not None and own.lead_over(snapshot) >= _WORTH_IT:
        top = best_row(row for row in rows if row.name != SHAPED_ON_FREE_PATH)
    if top.lead_over(snapshot) < _WORTH_IT:
        return snapshot
    if own is not None and own.takes <= top.takes:
        if top.lead_over(own) < _WORTH_IT <= own.lead_over(snapshot):
            top = own
    worth = [row for row in rows if row.lead_over(snapshot) >= _WORTH_IT]
    return plainest(worth, top, within=_WORTH_IT)


def _beside(rows: Sequence[Row], choice: Row, own: Row | None) -> list[str]:
    """Sentences on a better camera than the one to build, and on the nearest simpler one."""
    lines, top = [], best_row(rows)
    is_coded = choice.name not in SNAPSHOTS
    if choice.speed == "found" and choice.hides_speed:
        lines.append("No speed can be found: the blur differs too little over the speeds.")
    elif choice.speed != "unknown" and choice.takes == {"a stage"} and is_coded:
        knows = "finds" if choice.speed == "found" else "is told"
        lines.append(f"A stage and a decoder that {knows} the speed: no shutter is needed.")
    is_other = own is not None and own is not choice and is_coded
    if own is not None and is_other and own.takes == choice.takes:
        lines.append(f"{_capitalised(own.name)} takes as much and has {own.level:.2f} dB.")
    gain = top.lead_over(choice)
    if gain >= LEAST_SHOWN:
        more = top.takes - choice.takes
        with_more = f" with {_in_words(more)} too" if more else ""
        lines.append(
            f"{_capitalised(top.name)} has {top.level:.2f} dB{with_more}: {gain:.2f} more."
        )
    simpler = [row for row in rows if row is not own and _is_simpler(row, choice)]
    nearest = best_row(simpler) if simpler else choice
    if is_coded and nearest is not choice and nearest.name not in SNAPSHOTS:
        below = choice.lead_over(nearest)
        side = f"{abs(below):.2f} dB {'below' if below >= 0 else 'above'} it"
        lines.append(f"The nearest simpler camera, {nearest.name}, is {side}.")
    return lines


def _is_simpler(row: Row, choice: Row) -> bool:
    """Whether a row is plainer, or as plain with a fixed profile in place of a free one."""
    if row.is_plainer_than(choice):
        return True
    is_free = "a shutter" in choice.takes and isinstance(command_of(choice.shutter), SplineShutter)
    is_fixed = not isinstance(command_of(row.shutter), SplineShutter)
    return row.takes == choice.takes and is_free and is_fixed


def _in_words(takes: frozenset[str]) -> str:
    """The parts that a row takes, in words."""
    return " and ".join(sorted(takes, reverse=True)) or "neither stage nor shutter"


def _capitalised(name: str) -> str:
    """A name at the beginning of a sentence; the user's own names stay as they are."""
    return f"{name[0].upper()}{name[1:]}" if name in (*taken_names(), "optimised") else name


def comparison_notes(
    scene: Scene, entries: Mapping[str, Entry], rows: Sequence[Row], burst: Row | None
) -> tuple[str, ...]:
    """Sentences for the foot of the tables.

    Args:
        scene: The scene, whose device loses light.
        entries: Shutters and designs of the user, by name.
        rows: The rows at their own best motions, without a burst.
        burst: The best burst; None where the scene has none.
    """
    notes = [
        *device_notes(scene.device),
        *_blind_drive_notes(scene, entries),
        *_limit_notes(scene, rows),
        *_tolerance_notes(scene, rows),
    ]
    return tuple(notes if burst is None else [*notes, _burst_note(burst)])


def device_notes(device: AbstractDevice | None) -> list[str]:
    """Sentences on the transmission of a shutter, its speed, and the levels that it holds.

    Args:
        device: The device; None for a shutter that follows at once and loses no light, for which
            there are no sentences.
    """
    notes: list[str] = []
    if device is None:
        return notes
    t, closed = float(device.transmission), float(device.transmission * device.leakage)
    if t != 1 or closed != 0:
        notes.append(
            f"The shutter passes {t:.1%} of the light when open, {closed:.2%} when closed."
        )
    if isinstance(device, FirstOrderShutter):
        rise, fall = (float(x) * 1e3 for x in (device.rise_time, device.fall_time))
        late = "" if device.delay is None else f", {float(device.delay) * 1e3:.3g} ms late"
        notes.append(f"It rises from 10 to 90 % in {rise:.3g} ms and falls in {fall:.3g} ms{late}.")
    if device.num_slots is not None:
        levels = "any level" if device.levels is None else f"one of {device.levels} levels"
        notes.append(f"It holds {levels} over each of {device.num_slots} slots.")
    return notes


def _blind_drive_notes(scene: Scene, entries: Mapping[str, Entry]) -> list[str]:
    """Levels of designs for a device that follows every command, sent to the scene's device."""
    if scene.device is None:
        return []
    levels = [entry.blind_psnr for entry in entries.values() if isinstance(entry, Design)]
    return [
        f"Sent blindly, the design for a device that follows at once has {level:.2f} dB."
        for level in dict.fromkeys(levels)
        if level is not None
    ]


def _limit_notes(scene: Scene, rows: Iterable[Row]) -> list[str]:
    """The limits of the scene that rows exceed; a camera as built may exceed some."""
    notes = []
    for row in rows:
        beyond = beyond_limits(scene, row.motion, row.shutter)
        names = ", ".join(name.replace("_", " ") for name in beyond)
        notes += [f"{row.name} is outside the scene's limits: {names}."] if beyond else []
    return notes


def _tolerance_notes(scene: Scene, rows: Sequence[Row]) -> list[str]:
    """Sentences on the cameras and the decoders for which tolerances are not computed."""
    if scene.tolerances is None:
        return []
    notes = ["No free path is compared: tolerances are those of a parabola."]
    if all(row.within is None for row in rows):
        notes.append("Levels are without tolerances: those need one filter and the mean of speeds.")
    return notes


def _burst_note(row: Row) -> str:
    """The level of a burst whose frames are aligned without error."""
    return (
        f"A burst of {row.num_frames} frames of {float(row.motion.exposure) * 1e3:.3g} ms, "
        f"aligned perfectly at no cost, reaches {row.level:.2f} dB."
    )
