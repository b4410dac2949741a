"""The verdict of a scene: which camera to build, in words, and the notes that stand below it."""

import math
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from mishutter.design import Design
from mishutter.evaluation import FAN, REGION, SINE, SWEEP, FrameTimes, StillBurst, StillBursts
from mishutter.model import (
    AbstractDevice,
    FrameSequence,
    Scene,
    SplineShutter,
    command_of,
)
from mishutter.search import (
    BEST_MOVING_BURST,
    BEST_SNAPSHOT,
    BEST_STILL_BURST,
    LEAST_SHOWN,
    SHAPED_ON_FREE_PATH,
    SHUTTER,
    SNAPSHOTS,
    STAGE,
    WORTH_IT,
    Entry,
    Row,
    best_row,
    beyond_limits,
    forbids_free_path,
    moves_rather,
    pays,
    simplest,
    taken_names,
)

_WIDTH = 80
"""Columns of a line of a verdict."""
_SAID_LOSS = 0.05
"""Loss of a burst on a real sensor from which on a verdict says it; dB."""
PLAIN_RATE, MOST_RATE = 30.0, 1000.0
"""Frame rate that every camera has, and the greatest that a verdict looks for; 1/s."""


class PlainStills(NamedTuple):
    """Registered frames of a camera at rest beside the camera of a verdict.

    Attributes:
        best: The best of them at the `PLAIN_RATE` within the longest exposure; None of a camera
            that states its own rate, whose bursts are among the rows.
        equal_rate: The least frame rate at which such frames have the level of the camera; 1/s.
            None where no rate up to `MOST_RATE` has.
    """

    best: StillBurst | None
    equal_rate: float | None


def plain_stills(scene: Scene, choice: Row) -> PlainStills | None:
    """The frames at rest that any camera could take in place of a row.

    None for a scene with a background: frames that are aligned for its objects blur that.

    Args:
        scene: The scene.
        choice: The row, whose level they are to equal.
    """
    if scene.occlusion is not None:
        return None
    bursts = StillBursts(scene, at_worst=choice.at_worst)
    rate = bursts.rate_that_equals(choice.level, most=MOST_RATE)
    return PlainStills(bursts.best(PLAIN_RATE) if scene.burst is None else None, rate)


class Bursts(NamedTuple):
    """The bursts of a scene's camera, of which one may be worth taking.

    Attributes:
        still: The best of a sensor at rest.
        top: The one to take if any is: the best, or that at rest where moving gains little.
        equal_stills: The least number of stills in the time of that burst which have its level;
            None where none has, or it is at rest.
        in_parts: Whether the picture has a background, whose edges do not count for bursts.
        width: Width of the sensor; px. None where the scene does not say it.
    """

    still: Row
    top: Row
    equal_stills: int | None = None
    in_parts: bool = False
    width: float | None = None

    @property
    def width_loss(self) -> float:
        """Loss of the burst to take by things that leave the sensor; dB."""
        return self.top.sequence.width_loss or 0.0  # type: ignore[union-attr]

    @property
    def registration_loss(self) -> float:
        """Its loss by the error of the speed that its frames tell; dB."""
        return self.top.sequence.registration_loss or 0.0  # type: ignore[union-attr]


def bursts_of(scene: Scene, rows: Sequence[Row]) -> Bursts | None:
    """The bursts among the rows of a scene; None without any.

    Args:
        scene: The scene.
        rows: The rows at their own best motions.
    """
    by_name = {row.name: row for row in rows}
    still, moving = by_name.get(BEST_STILL_BURST), by_name.get(BEST_MOVING_BURST)
    if still is None or still.sequence is None:
        return None
    in_parts, width = scene.occlusion is not None, scene.sensor.width
    width = None if width is None else float(width)
    if (
        moving is None
        or moving.sequence is None
        or not moves_rather(moving.sequence, still.sequence, moving.margin_over(still))
    ):
        return Bursts(still, still, in_parts=in_parts, width=width)
    window = moving.sequence.duration
    stills = StillBursts(scene, at_worst=moving.at_worst, window=window)
    count = stills.number_that_equals(moving.level, most=math.ceil(MOST_RATE * window))
    return Bursts(still, moving, count, in_parts, width)


@dataclass(frozen=True)
class Case:
    """The rows of a scene that a verdict is about.

    Attributes:
        rows: The rows at their own best motions, without a burst.
        choice: The `row_to_build`.
        own: The best row of the user's shutters and designs; None without any.
        snapshot: The best snapshot.
        most: The ceiling; dB.
        stills: Frames at rest that could take its place; None where a verdict is silent on them.
        bursts: The bursts that could take its place; None without any.
    """

    rows: Sequence[Row]
    choice: Row
    own: Row | None
    snapshot: Row
    most: float
    stills: PlainStills | None = None
    bursts: Bursts | None = None

    @property
    def is_coded(self) -> bool:
        """Whether a camera is to be built, and not a snapshot to be used."""
        return self.choice.name not in SNAPSHOTS

    @cached_property
    def top(self) -> Row:
        """The best of all rows."""
        return best_row(self.rows)

    @cached_property
    def nearest_simpler(self) -> Row | None:
        """The best of the rows that are simpler than the choice; None without one that is coded."""
        simpler = [row for row in self.rows if row is not self.own and self._is_simpler(row)]
        nearest = best_row(simpler) if simpler else self.choice
        return None if nearest is self.choice or nearest.name in SNAPSHOTS else nearest

    def _is_simpler(self, row: Row) -> bool:
        """Whether a row is simpler, or as simple with a fixed profile in place of a free one."""
        if row.is_simpler_than(self.choice):
            return True
        parts = self.choice.required_hardware
        is_free = isinstance(command_of(self.choice.shutter), SplineShutter)
        is_fixed = not isinstance(command_of(row.shutter), SplineShutter)
        return row.required_hardware == parts and SHUTTER in parts and is_free and is_fixed

    @property
    def burst_pays(self) -> bool:
        """Whether a burst is worth taking in place of the choice.

        Before a background bursts are told more than a single exposure, with which they do not
        compare.
        """
        if self.bursts is None or (burst := self.bursts.top.sequence) is None:
            return False
        top = self.bursts.top
        gain = math.inf if self.bursts.in_parts else top.margin_over(self.choice)
        return pays(burst, gain, builds=self.is_coded)

    @property
    def takes_burst(self) -> bool:
        """Whether the verdict is to take a burst: its decoder knows the speed anyway."""
        return self.burst_pays and self.choice.decoder.knows_speed

    @property
    def is_below_stills(self) -> bool:
        """Whether plain stills are better than the camera to build."""
        best = self.stills.best if self.stills is not None else None
        if best is None or not self.is_coded or best.num_frames == 1:
            return False
        return best.psnr > self.choice.level

    @property
    def is_below_burst(self) -> bool:
        """Whether a burst that is told no more is better than the camera to build."""
        bursts = self.bursts
        if bursts is None or bursts.in_parts or not self.burst_pays:
            return False
        return bursts.top.level > self.choice.level

    @property
    def level(self) -> str:
        """The level of the choice, in words."""
        at_worst = " at the worst speed" if self.choice.at_worst else ""
        return f"{self.choice.level:.2f} dB{at_worst}"


class Rule(NamedTuple):
    """A sentence of the verdict, and the cases in which it stands there."""

    applies: Callable[[Case], bool]
    sentence: Callable[[Case], str]


def _do_not_build(case: Case) -> str:
    return (
        "Do not build a coded camera for this scene: nothing beats a snapshot by "
        f"{WORTH_IT} dB.\n"
        f"Use an ordinary shutter: {case.choice.setting}, {case.level}. "
        f"Ceiling: {case.most:.2f} dB."
    )


def _pan(case: Case) -> str:
    """The gain of a pan over a snapshot at rest, and the part that makes it."""
    at_rest = next(row for row in case.rows if row.name == BEST_SNAPSHOT)
    part = "a camera that turns" if case.choice.turns else STAGE
    return (
        f"The pan brings {case.choice.margin_over(at_rest):.2f} dB and takes {part}: "
        f"at rest it has {at_rest.level:.2f} dB."
    )


def _build(case: Case) -> str:
    gain = case.choice.margin_over(case.snapshot)
    headline = (
        f"Build {case.choice.name}: {case.level}, {gain:.2f} dB above the {case.snapshot.name}"
    )
    # Whoever reads one sentence learns that an ordinary camera does more.
    if case.is_below_stills:
        return textwrap.fill(f"{headline}, but below {_stills(case)}", _WIDTH)
    if case.is_below_burst:
        top: Row = case.bursts.top  # type: ignore[union-attr]
        frames = f"{top.num_frames} frames, registered by object: {top.level:.2f} dB"
        return textwrap.fill(f"{headline}, but below {frames}.", _WIDTH)
    return f"{headline}."


def _requires_less(case: Case) -> bool:
    own = case.own
    return own is not None and case.choice.required_hardware < own.required_hardware


def _parts(case: Case) -> str:
    parts = _in_words(case.choice.required_hardware)
    return f"It takes {parts}: {case.choice.setting}. Ceiling: {case.most:.2f} dB."


def _room(case: Case) -> str:
    room = max(case.most - case.choice.level, 0.0)
    return (
        f"It is {room:.2f} dB below what any path and any shutter could reach ({case.most:.2f} dB)."
    )


def _needs_no_shutter(case: Case) -> bool:
    needs_stage_alone = case.is_coded and case.choice.required_hardware == {STAGE}
    return needs_stage_alone and case.choice.decoder.knows_speed and not case.choice.hides_speed


def _no_shutter(case: Case) -> str:
    verb = case.choice.decoder.verb
    return f"A stage and a decoder that {verb} the speed: no shutter is needed."


def _own_is_no_simpler(case: Case) -> bool:
    own, choice = case.own, case.choice
    if own is None or own is choice or not case.is_coded:
        return False
    return own.required_hardware == choice.required_hardware


def _own(case: Case) -> str:
    own: Row = case.own  # type: ignore[assignment]
    return f"{_capitalised(own.name)} takes as much and has {own.level:.2f} dB."


def _more(case: Case) -> str:
    """The best of all rows, where that is not the choice, and what it takes too."""
    more = case.top.required_hardware - case.choice.required_hardware
    with_more = f" with {_in_words(more)} too" if more else ""
    return (
        f"{_capitalised(case.top.name)} has {case.top.level:.2f} dB{with_more}: "
        f"{case.top.margin_over(case.choice):.2f} more."
    )


def _simpler(case: Case) -> str:
    nearest: Row = case.nearest_simpler  # type: ignore[assignment]
    below = case.choice.margin_over(nearest)
    side = f"{abs(below):.2f} dB {'below' if below >= 0 else 'above'} it"
    return f"The nearest simpler camera, {nearest.name}, is {side}."


def _stills_pay(case: Case) -> bool:
    """Whether frames at rest may take the place of the camera, or gain on a snapshot."""
    if case.stills is None or case.stills.best is None or case.is_below_stills:
        return False
    gains = case.stills.best.psnr - case.choice.level >= WORTH_IT
    return case.is_coded or (gains and case.stills.best.num_frames > 1)


def _stills(case: Case) -> str:
    """The level of a plain burst, whose frames have to be registered, and the rate that is enough.

    One filter for all speeds registers nothing: objects on their own would have to be, one by one.
    """
    stills: PlainStills = case.stills  # type: ignore[assignment]
    best: StillBurst = stills.best  # type: ignore[assignment]
    count, level, rate = best.num_frames, best.psnr, stills.equal_rate
    if case.choice.decoder.knows_speed:
        frames = f"{count} registered stills at {PLAIN_RATE:.0f} frames/s"
    else:
        frames = f"{count} stills at {PLAIN_RATE:.0f} frames/s, registered by object"
    said = f"{frames}: {level:.2f} dB"
    if count == 1:
        said = f"Of {PLAIN_RATE:.0f} frames/s no more than one pays within the longest exposure"
    elif not case.is_coded:
        return f"{said}, {level - case.choice.level:.2f} above it."
    equal = f"{MOST_RATE:.0f} frames/s do not" if rate is None else f"{math.ceil(rate)} frames/s"
    return f"{said}; {equal} equal it."


def _are_outrun(case: Case) -> bool:
    """Whether stills of a camera that is faster than the scene's equal the one to build."""
    if case.stills is None or case.bursts is None or not case.is_coded:
        return False
    is_fast_enough = case.bursts.still.level >= case.choice.level
    return case.stills.equal_rate is not None and not is_fast_enough


def _rate(case: Case) -> str:
    """The frame rate at which frames at rest equal the camera to build."""
    rate: float = case.stills.equal_rate  # type: ignore[union-attr, assignment]
    return f"Registered stills at {math.ceil(rate)} frames/s equal {case.choice.name}."


def _burst(case: Case) -> str:
    """The burst to take: a sensor moves where that gains something over frames at rest."""
    bursts: Bursts = case.bursts  # type: ignore[assignment]
    top, still = bursts.top, bursts.still
    prefix = "" if case.choice.decoder.knows_speed else "If objects are registered, "
    if top is still:
        setting = top.sequence.setting  # type: ignore[union-attr]
        number = "still" if setting.startswith("1 ") else "stills"
        stills = setting.replace(" of ", f" {number} of ", 1)
        sentence = f"{prefix}do not move: {stills} have {top.level:.2f} dB"
        if not bursts.in_parts:
            above = top.margin_over(case.choice)
            side = "above" if above >= 0 else "below"
            sentence += f", {abs(above):.2f} dB {side} the best of one exposure"
        return paragraph(f"{sentence}.")
    count = bursts.equal_stills
    many = f"as much as {count}" if count is not None else "more than any number of"
    return paragraph(
        f"{prefix}take {_frames_in_words(top)}: {top.level:.2f} dB, "
        f"{top.margin_over(still):.2f} dB above the best still burst "
        f"({still.sequence.setting}), {many} stills in the same time."  # type: ignore[union-attr]
    )


def _frames_in_words(row: Row) -> str:
    """The frames of a burst and what the stage does, in words."""
    sequence: FrameSequence = row.sequence  # type: ignore[assignment]
    number = "frame" if sequence.setting.startswith("1 ") else "frames"
    setting = sequence.setting.replace(" of ", f" {number} of ", 1)
    way = f"{sequence.travel:.3g} px"
    verbs = {
        SINE: f"swings {way} on a sine",
        SWEEP: f"sweeps {way} once",
        FAN: f"goes {way} at a constant speed in each",
    }
    return f"{setting} while the stage {verbs.get(sequence.kind, f'swings {way}')}"


def _of_one_exposure(case: Case) -> str:
    """The best of one exposure, beside a burst to take."""
    best = _capitalised(case.choice.name)
    return f"{best}, of one exposure, has {case.level}: {case.choice.setting}."


def _leaves(case: Case) -> str:
    """The cost of things that leave the sensor, also to the frames at rest that are compared."""
    bursts: Bursts = case.bursts  # type: ignore[assignment]
    sentence = (
        f"On a sensor of {bursts.width:,.6g} px, points that leave it cost "
        f"{bursts.width_loss:.2f} dB"
    )
    if bursts.top is not bursts.still:
        still: FrameSequence = bursts.still.sequence  # type: ignore[assignment]
        sentence += f", and the best still burst {still.width_loss or 0.0:.2f} dB"
    return paragraph(f"{sentence}.")


def _registers(case: Case) -> str:
    bursts: Bursts = case.bursts  # type: ignore[assignment]
    return (
        f"Registration by {REGION} x {REGION} px costs {bursts.registration_loss:.2f} dB at the "
        "worst speed."
    )


def paragraph(sentence: str) -> str:
    """Sentences in lines of a verdict's width, the first with a capital."""
    return textwrap.fill(f"{sentence[0].upper()}{sentence[1:]}", _WIDTH)


_OF_FRAMES = (
    Rule(lambda case: case.burst_pays, _burst),
    Rule(
        lambda case: case.burst_pays and case.bursts.width_loss >= _SAID_LOSS,  # type: ignore[union-attr]
        _leaves,
    ),
    Rule(
        lambda case: case.burst_pays and case.bursts.registration_loss >= _SAID_LOSS,  # type: ignore[union-attr]
        _registers,
    ),
)
_OF_BURSTS = (
    *_OF_FRAMES,
    Rule(lambda case: case.takes_burst, _of_one_exposure),
    Rule(
        lambda case: case.burst_pays and case.bursts.in_parts,  # type: ignore[union-attr]
        lambda case: "Bursts are told both speeds and which part is which: edges do not count.",
    ),
)
RULES = (
    Rule(lambda case: not case.is_coded, _do_not_build),
    Rule(lambda case: not case.is_coded and case.choice.pans, _pan),
    Rule(lambda case: case.is_coded, _build),
    Rule(lambda case: case.is_coded and _requires_less(case), _parts),
    Rule(lambda case: case.is_coded and not _requires_less(case), _room),
    Rule(
        lambda case: case.choice.hides_speed,
        lambda case: "No speed can be found: the blur differs too little over the speeds.",
    ),
    Rule(_needs_no_shutter, _no_shutter),
    Rule(_own_is_no_simpler, _own),
    Rule(lambda case: case.top.margin_over(case.choice) >= LEAST_SHOWN, _more),
    Rule(lambda case: case.is_coded and case.nearest_simpler is not None, _simpler),
    Rule(_stills_pay, _stills),
    *_OF_FRAMES,
    _OF_BURSTS[-1],
    Rule(_are_outrun, _rate),
)
"""The sentences of a verdict, in their order."""


def verdict_of(case: Case) -> str:
    """The verdict in a few lines: each rule that applies to the case says its sentence."""
    rules = _OF_BURSTS if case.takes_burst else RULES
    return "\n".join(rule.sentence(case) for rule in rules if rule.applies(case))


def row_to_build(rows: Sequence[Row], own: Row | None, snapshot: Row) -> Row:
    """The row to build: the simplest of all that are about as good as the best.

    Rows within `WORTH_IT` of the best are about as good, and a coded camera must exceed the best
    snapshot by that much; of snapshots the one at rest is preferred to a pan that buys a stage for
    a gain that nobody sees. Among equally good and simple rows the best of the user's is preferred.
    If that one is worth building, it is also preferred to a profile on a free path, which asks more
    of a stage.

    Args:
        rows: The rows at their own best motions, without a burst.
        own: The best row of the user's shutters and designs; None without any.
        snapshot: The best snapshot.
    """
    top = best_row(rows)
    if own is not None and own.margin_over(snapshot) >= WORTH_IT:
        top = best_row(row for row in rows if row.name != SHAPED_ON_FREE_PATH)
    if top.margin_over(snapshot) < WORTH_IT:
        at_rest = [row for row in rows if row.name == BEST_SNAPSHOT]
        return simplest(at_rest, snapshot, within=LEAST_SHOWN)
    if own is not None and own.required_hardware <= top.required_hardware:
        if top.margin_over(own) < WORTH_IT <= own.margin_over(snapshot):
            top = own
    worth = [row for row in rows if row.margin_over(snapshot) >= WORTH_IT]
    return simplest(worth, top, within=WORTH_IT)


def _in_words(parts: frozenset[str]) -> str:
    """Parts of a camera, in words."""
    return " and ".join(sorted(parts, reverse=True)) or "neither stage nor shutter"


def _capitalised(name: str) -> str:
    """A name at the beginning of a sentence; the user's own names stay as they are."""
    return f"{name[0].upper()}{name[1:]}" if name in (*taken_names(), "optimised") else name


def comparison_notes(
    scene: Scene,
    entries: Mapping[str, Entry],
    rows: Sequence[Row],
    *,
    free_paths: bool = False,
) -> tuple[str, ...]:
    """Sentences for the foot of the tables.

    Args:
        scene: The scene, whose device loses light.
        entries: Shutters and designs of the user, by name.
        rows: The rows at their own best motions, without a burst.
        free_paths: Whether free paths were asked for.
    """
    return (
        *device_notes(scene.device),
        *_blind_drive_notes(scene, entries),
        *_limit_notes(scene, rows),
        *_tolerance_notes(scene, rows),
        *_path_notes(scene, free_paths),
        *_burst_notes(scene),
    )


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
    if device.lag_words:
        notes.append(device.lag_words)
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
    notes = []
    if all(row.within is None for row in rows):
        notes.append("Levels are without tolerances: those need one filter and the mean of speeds.")
    return notes


def _path_notes(scene: Scene, free_paths: bool) -> list[str]:
    """The reason for which free paths that were asked for are not compared."""
    reason = forbids_free_path(scene)
    return [f"No free path is compared: {reason}."] if free_paths and reason else []


def _burst_notes(scene: Scene) -> list[str]:
    """The sentence on a camera that is too slow for a burst."""
    if scene.burst is None or FrameTimes.of(scene, scene.burst).holds_several:
        return []
    rate = float(scene.burst.frames_per_s)
    return [f"No burst is compared: of {rate:.3g} frames/s only one has its time in the window."]
