r"""Drive tables as files that laboratories load; `csv` and `npy` are also read back.

| format | file | travels with it |
|---|---|---|
| `csv` | names, units, one row a step | half exposure, transmittance, position |
| `column` | one column, -1 to 1 | drive |
| `keysight` | `SampleRate=` and columns | half exposure, drive, position, gate |
| `rigol` | 16-bit little-endian words, the low 14 bits | drive |
| `siglent` | EasyWave CSV: settings, then time and drive | drive, half exposure |
| `npy` | (channels, samples): drive, position, gate | those |
| `pulses` | time closed and time open of each pulse, us | open and closed |

A drive of -1 is the lowest level, whose transmittance is the floor, and one of 1 the highest,
whose transmittance is the ceiling: these are the levels. Positions are in [-1, 1], and the scale
is how many pixels 1 stands for. Of a stage of two axes `csv` and `npy` have both positions, and
`keysight` has them in place of the drive, for which its gate stands; the other formats hold the
drive alone. `docs/drive_formats.md` quotes the makers' descriptions.
"""

import io
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from mishutter._core.checks import (
    Unquoted,
    fields_text,
    require,
    require_finite,
)
from mishutter._core.columns import cells, number_rows, text_lines
from mishutter._core.files import contents, write_bytes
from mishutter.design.design import Design, package_version
from mishutter.hardware.stage_files import MAX_STEPS, path_csv
from mishutter.model.exposures import Exposures
from mishutter.model.frame_path import Lights
from mishutter.model.motion import AbstractMotion, ParabolicMotion, steady
from mishutter.model.shutters.chips import ChippedShutter
from mishutter.model.stages import StagePath

_WORDS = (1 << 14) - 1
_SAME = 1e-8
"""Relative difference of two times below which they are one, written to nine digits."""
_COLUMNS = {"begin": "ms", "transmittance": "1", "sensor_position": "px"}
"""Units of the columns of a table that are read; the others follow from these."""


class DriveWarning(UserWarning):
    """A drive table is read, but may have been meant otherwise."""


class Drive(NamedTuple):
    """A drive table as it was read: the profile that is sent, and the sensor's motion.

    Attributes:
        shutter: Equal steps of the exposure.
        motion: The motion in the file; numbers that it lacks are those of the intended motion.
    """

    shutter: ChippedShutter
    motion: AbstractMotion


class _Samples(NamedTuple):
    """The contents of a file: transmittance or drive of equal steps, and perhaps more."""

    half_exposure: float | None = None  # Half the exposure; s
    drive: Float[np.ndarray, "steps"] | None = None  # Drive of each step, from -1 to 1
    transmittance: Float[np.ndarray, "steps"] | None = None  # Transmittance of each step
    # Position of the sensor at the beginning of each step; px
    position: Float[np.ndarray, "steps"] | None = None
    share: Float[np.ndarray, "steps"] | None = None  # Position on a scale from -1 to 1

    def half(self, motion: AbstractMotion, argument: float | None, name: str) -> float:
        """The half exposure of a file, or the reader's argument, which may not differ from it."""
        own = self.half_exposure
        if own is None:
            return float(motion.half_exposure) if argument is None else argument
        is_same = argument is None or abs(argument - own) <= 1e-6 * own
        requirement = f"have the half exposure that was given, {argument or own:g} s"
        require(is_same, name, requirement, Unquoted(f"{own:g} s"))
        return own

    @property
    def doubt(self) -> str | None:
        """A sentence about what a file may mean otherwise than it is read."""
        least = -1.0 if self.drive is None else float(np.min(self.drive))
        # A shutter that stays open has the same drive, 1, on a scale from 0 to 1.
        if not 0 <= least < 1:
            return None
        return (
            f"its shutter never closes: its least drive is {least:g}, where -1 is closed and 1 "
            "is open; a drive from 0 for closed to 1 for open must be doubled, less 1"
        )


# Writing


STEPS = 256
"""Steps of an exposure in a table whose number of them nobody says."""


def first_lights(design: Design) -> Lights:
    """First and last light of each exposure in the row that is read first, as triggers begin it."""
    lead = _lead(design)
    return [(begin - lead, end - lead) for begin, end in design.exposures.lights]


def _lead(design: Design) -> float:
    """Time from the first row to the middle one of frames, which triggers begin; s."""
    return 0.0 if design.sequence is None else design.scene.sensor.readout_time / 2


class AbstractTable(ABC):
    """Equal steps of time from the first light of a design's exposures to the last."""

    design: Design
    begin: Float[np.ndarray, "n"]  # Beginning of each step; s
    level: Int[np.ndarray, "n"]  # Level of the shutter in each
    num_levels: int
    transmittance: Float[np.ndarray, "n"]  # Transmittance at that level
    gate: Bool[np.ndarray, "n"]  # Whether light is recorded in each step
    # Position of the stage at the beginning of each step, along each of two axes; px
    position: Float[np.ndarray, "*axes n"]

    @abstractmethod
    def to_csv(self) -> str:
        """The table as text: a line of names, a line of units, then one a step."""

    def __repr__(self) -> str:
        return fields_text(self)

    @property
    def exposures(self) -> Exposures:
        """The exposures of the design."""
        return self.design.exposures

    @property
    def lights(self) -> Lights:
        """First and last light of each exposure, exactly, in the row that is read first; s."""
        return first_lights(self.design)

    @property
    def lead(self) -> float:
        """Time from the first row's light to that of the middle one; s."""
        return _lead(self.design)

    @property
    def exposure(self) -> float:
        """Time that the steps share; s."""
        return self.lights[-1][1] - self.lights[0][0]

    @property
    def step(self) -> float:
        """Time of a step; s."""
        return self.exposure / self.begin.size

    @cached_property
    def paths(self) -> dict[str, StagePath]:
        """The path of the stage along each axis, from rest to rest, by the ending of its columns.

        There is none where the stage stays at rest, or no limit says how it moves.
        """
        return self.exposures.stage_paths(self.design.scene)

    def stage_csv(self, *, returns: bool = False) -> str | None:
        """The path of the stage from rest to rest as text; None where there is none.

        Rows are at the steps of the table, and as many between each two as make 256 of an exposure
        in fewer steps: a stage that is sent so few positions leaves its path. Where the scene says
        how its stage follows, a column has the command for each axis.

        Args:
            returns: Whether the path goes back to where it began, within the limits of the stage.
        """
        count = self.begin.size * -(-STEPS * len(self.lights) // self.begin.size)
        lights = {f"frame {number}": lit for number, lit in enumerate(self.lights, 1)}
        if self.exposures.shutter is not None:
            lights = {"exposure": self.lights[0]}
        return path_csv(self.paths, lights, count, self.design.scene, returns=returns)

    @property
    def head(self) -> dict[str, object]:
        """The part that documents of all tables share, as plain numbers."""
        return {
            "mishutter": package_version(),
            "step_ms": self.step * 1e3,
            "position_scale_px": self.position_scale,
            "begin_ms": (self.begin * 1e3).tolist(),
            "sensor_position_px": self.position.tolist(),
        }

    @property
    def position_scale(self) -> float:
        """Position that a value of 1 stands for in the formats of -1 to 1; px."""
        return float(np.max(np.abs(self.position))) or 1.0

    @property
    def travel_beyond_limit(self) -> float | None:
        """Travel of an axis in `stage_csv` where it is more than the limits allow; px.

        That may be where they let a stage run up at once. None elsewhere.
        """
        limits = self.design.scene.limits
        beyond = [limits.travel_beyond(path) for path in self.paths.values()]
        return max((each for each in beyond if each is not None), default=None)

    def save(self, path: str | Path, *, form: str = "csv") -> None:
        """Write the table in a format that a laboratory loads, whole or not at all.

        Args:
            path: The file.
            form: One of `DRIVE_FORMATS`, of which each has a channel that is open in exposures and
                closed between them.

        Raises:
            ValueError: if there is no such format, or pulses are asked for of more than two levels.
            OSError: if the file cannot be written.
        """
        write_bytes(path, drive_bytes(self, form))


def drive_bytes(table: AbstractTable, form: str) -> bytes:
    """A drive table as a file of one of `DRIVE_FORMATS`."""
    require(form in _WRITERS, "DriveTable.save(form=...)", f"be one of {', '.join(_WRITERS)}", form)
    return _WRITERS[form](table)


def _keysight(table: AbstractTable) -> bytes:
    rate = table.level.size / table.exposure
    # Of a stage of two axes both outputs are places, and the gate alone is the shutter.
    channels = _channels(table)[-3:]
    rows = [f"{y1!r},{y2!r},{gate:.0f}" for y1, y2, gate in channels.T.tolist()]
    return "\n".join([f"SampleRate={rate!r}", "Y1,Y2,SampleMarker1", *rows, ""]).encode()


def _siglent(table: AbstractTable) -> bytes:
    count, exposure = table.level.size, table.exposure
    settings = [f"data length,{count}", f"frequency,{1 / exposure!r}", "amp,2", "offset,0"]
    rows = [f"{k * exposure / count:.9e},{y!r}" for k, y in enumerate(_drive(table).tolist())]
    return "\n".join([*settings, "phase,0", *[""] * 7, "xpos,value", *rows, ""]).encode()


def _npy(table: AbstractTable) -> bytes:
    file = io.BytesIO()
    np.save(file, _channels(table), allow_pickle=False)
    return file.getvalue()


def _pulse_list(table: AbstractTable) -> bytes:
    is_binary = bool(np.all((table.transmittance == 0) | (table.transmittance == 1)))
    requirement = "be open or closed in each step for pulses: of 2 levels from 0 to 1"
    got = Unquoted(f"{table.num_levels} levels")
    require(is_binary, "DriveTable.save(form='pulses')", requirement, got)
    step = table.exposure * 1e6 / table.level.size
    turns = np.flatnonzero(np.diff(np.pad(table.transmittance, 1))) * step
    opens, closes = turns[::2], turns[1::2]
    waits = opens - np.concatenate([[0.0], closes])[: opens.size]
    rows = [f"{a!r},{b!r}" for a, b in np.transpose([waits, closes - opens]).tolist()]
    return "\n".join(["wait,width", "us,us", *rows, ""]).encode()


_WRITERS: dict[str, Callable[[AbstractTable], bytes]] = {
    "csv": lambda table: table.to_csv().encode(),
    "column": lambda table: "".join(f"{y!r}\n" for y in _drive(table).tolist()).encode(),
    "keysight": _keysight,
    "rigol": lambda table: np.rint((_drive(table) + 1) / 2 * _WORDS).astype("<u2").tobytes(),
    "siglent": _siglent,
    "npy": _npy,
    "pulses": _pulse_list,
}
DRIVE_FORMATS = {
    "csv": ".csv",
    "column": ".csv",
    "keysight": ".csv",
    "rigol": ".RAF",
    "siglent": ".csv",
    "npy": ".npy",
    "pulses": ".csv",
}
"""Formats of a drive table, and how their files end."""
WITH_POSITIONS = ("csv", "keysight", "npy")
"""Formats with channels for the places of a stage beside the shutter."""


def _drive(table: AbstractTable) -> np.ndarray:
    return 2 * table.level / (table.num_levels - 1) - 1


def _channels(table: AbstractTable) -> np.ndarray:
    """Drive, places along each axis over their scale, and gate; the last sample closes."""
    places = np.atleast_2d(table.position) / table.position_scale
    rows = [[*_drive(table), -1.0], *([*place, place[-1]] for place in places)]
    return np.array([*rows, [*table.gate.astype(float), 0.0]])


# Reading


def read_drive(
    path: str | Path,
    motion: AbstractMotion,
    *,
    half_exposure: float | None = None,
    position_scale: float | None = None,
    floor: float = 0.0,
    ceiling: float = 1.0,
) -> Drive:
    """Read a drive table in `csv` or `npy`, unchanged, also one that was edited.

    The contents say which format it is.

    Args:
        path: The file.
        motion: The motion that it was made for: a file without time, or without the sensor's
            position, says nothing of it.
        half_exposure: $T$, s, of an array, which holds no time; that of `motion` by default.
        position_scale: Position at a value of 1 in an array, px; without it they are left out.
        floor: Transmittance of the lowest level of an array, which holds drives alone.
        ceiling: Transmittance of its highest level.

    Raises:
        ValueError: if the file is none of them, or an argument is out of its range.
        OSError: if it cannot be read.

    Warns:
        DriveWarning: if its drives, from -1 to 1, never close the shutter further than by half.
    """
    require(isinstance(motion, AbstractMotion), "read_drive(motion=...)", "be a motion", motion)
    for key, value in (("half_exposure", half_exposure), ("position_scale", position_scale)):
        if value is not None:
            require_finite(f"read_drive({key}=...)", value)
            require(value > 0, f"read_drive({key}=...)", "be above 0", value)
    require_levels("read_drive", floor, ceiling)
    name = str(path)
    samples = _samples(contents(path), name)
    half = samples.half(motion, half_exposure, name)
    if samples.drive is not None:
        steps = floor + (ceiling - floor) * (samples.drive + 1) / 2
    else:
        steps = np.asarray(samples.transmittance)
    require(len(steps) <= MAX_STEPS, name, f"hold at most {MAX_STEPS} steps", len(steps))
    position = samples.position
    if samples.share is not None and position_scale is not None:
        position = samples.share * position_scale
    drive = Drive(ChippedShutter(steps), _motion(position, half, motion, name))
    if samples.doubt is not None:
        warnings.warn(f"{name}: {samples.doubt}", DriveWarning, stacklevel=2)
    return drive


def require_levels(function: str, floor: float, ceiling: float) -> None:
    """Refuse transmittances of the lowest and the highest level that are out of range."""
    for name, value in (("floor", floor), ("ceiling", ceiling)):
        require_finite(f"{function}({name}=...)", value)
    require(0 <= floor < 1, f"{function}(floor=...)", "lie in [0, 1)", floor)
    subject = f"{function}(ceiling=...)"
    require(floor < ceiling <= 1, subject, f"lie above the floor {floor:g} and up to 1", ceiling)


def _samples(content: bytes, name: str) -> _Samples:
    if content.startswith(b"\x93NUMPY"):
        return _from_npy(content, name)
    return _from_table(text_lines(content, name), name)


def _within(noun: str, values: np.ndarray, least: float, name: str) -> np.ndarray:
    """Values that lie between `least` and 1."""
    outside = (values < least) | (values > 1)
    worst = values[np.argmax(outside)] if outside.any() else 0.0
    require(not outside.any(), name, f"hold {noun} in [{least:g}, 1] alone", worst)
    return values


def _from_table(lines: list[str], name: str) -> _Samples:
    names, units = (cells(line) for line in (*lines, "")[:2])
    is_table = names.count("begin") == names.count("transmittance") == 1
    requirement = "be a drive table in csv, with one column begin and one transmittance, or npy"
    require(is_table, name, requirement, lines[0])
    own = dict(zip(names, units, strict=False))
    for column, unit in _COLUMNS.items():
        is_known = column not in names or own.get(column) == unit
        requirement = f"have `{column}` in {unit} by its second line"
        require(is_known, name, requirement, own.get(column, Unquoted("no unit")))
    columns = dict(zip(names, number_rows(lines[2:], len(names), name).T, strict=True))
    transmittance = _within("a transmittance", columns["transmittance"], 0.0, name)
    # Steps are equal and begin at -T.
    begin = columns["begin"] / 1e3
    count, half = begin.size, -float(begin[0])
    requirement = "begin before mid-exposure, at a time below 0"
    require(half > 0, name, requirement, Unquoted(f"{begin[0] * 1e3:g} ms"))
    step = 2 * half / count
    is_aside = np.abs(begin - (np.arange(count) * step - half)) > step / 1000 + _SAME * half
    first = int(np.argmax(is_aside))
    span = f"{count} from {-half * 1e3:g} to {half * 1e3:g} ms"
    got = Unquoted(f"{begin[first] * 1e3:g} ms in row {first + 1}")
    require(not is_aside.any(), name, f"have equal steps without a gap, {span}", got)
    return _Samples(half, transmittance=transmittance, position=columns.get("sensor_position"))


def _gated(
    drive: np.ndarray, share: np.ndarray | None, gate: np.ndarray | None, name: str
) -> tuple[np.ndarray, np.ndarray | None]:
    """Drive and position while the gate is open, all in their range."""
    if gate is not None:
        is_binary = (gate == 0) | (gate == 1)
        other = gate[np.argmin(is_binary)]
        require(bool(is_binary.all()), name, "have a gate of 0 and 1", other)
        edges = int(np.count_nonzero(np.diff(np.pad(gate, 1))))
        requirement = "have its gate open once, without a gap"
        require(edges == 2, name, requirement, Unquoted(f"{edges // 2} openings"))
        drive = drive[gate == 1]
        share = None if share is None else share[gate == 1]
    drive = _within("a drive", drive, -1.0, name)
    return drive, None if share is None else _within("a position", share, -1.0, name)


def _from_npy(content: bytes, name: str) -> _Samples:
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except (ValueError, EOFError, OSError, SyntaxError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{name} must be a whole .npy file; got: {reason}.") from None
    shape = getattr(array, "shape", ())
    has_channels = len(shape) == 2 and 1 <= shape[0] <= 3 and shape[1] >= 1
    requirement = "be an array of (channels, samples) of 1 to 3 channels"
    require(has_channels, name, requirement, Unquoted(f"shape {shape}"))
    require(array.dtype.kind in "fiu", name, "hold real numbers", Unquoted(array.dtype))
    numbers = array.astype(np.float64)
    is_finite = np.isfinite(numbers)
    require(bool(is_finite.all()), name, "hold finite numbers", numbers[~is_finite][:1])
    share, gate = (numbers[k] if len(numbers) > k else None for k in (1, 2))
    drive, share = _gated(numbers[0], share, gate, name)
    return _Samples(drive=drive, share=share)


def _motion(
    position: np.ndarray | None, half: float, motion: AbstractMotion, name: str
) -> AbstractMotion:
    """Motion of a sensor that follows positions at the beginning of each step."""
    intended_half = float(motion.half_exposure)
    if not motion.accelerates_constantly and position is not None:
        path = np.asarray(motion.position(_step_begins(position.size) * half))
        _require_follows(position, path, "on the free path that was given", name)
    if position is None or position.size < 3 or not motion.accelerates_constantly:
        if abs(half - intended_half) <= _SAME * intended_half:
            return motion
        a, v = steady(motion).acceleration, motion.velocity
        return ParabolicMotion(acceleration=a, half_exposure=half, velocity=v)
    powers = np.vander(_step_begins(position.size), 3)
    (sag, drift, start), *_ = np.linalg.lstsq(powers, position, rcond=None)
    _require_follows(position, powers @ (sag, drift, start), "along v t + a t^2", name)
    sag, drift = (0.0 if abs(x) < 1e-6 else float(x) for x in (sag, drift))
    requirement = "accelerate the sensor towards positive positions, or not at all"
    require(sag >= 0, name, requirement, Unquoted(f"a sag of {sag:.3g} px"))
    acceleration, velocity = sag / half**2, drift / half
    return ParabolicMotion(acceleration=acceleration, half_exposure=half, velocity=velocity)


def _step_begins(num_steps: int) -> np.ndarray:
    """Beginnings of equal steps of the exposure, in half exposures from its middle."""
    return np.arange(num_steps) * (2 / num_steps) - 1


def _require_follows(position: np.ndarray, path: np.ndarray, phrase: str, name: str) -> None:
    """Refuse positions that are aside of a path, by more than a thousandth of their travel."""
    distance = float(np.max(np.abs(path - position)))
    is_near = distance <= 1e-3 * (1 + float(np.ptp(position)))
    got = Unquoted(f"a path up to {distance:.3g} px aside")
    require(is_near, name, f"move the sensor {phrase}", got)
