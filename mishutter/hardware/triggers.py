"""The frames of a burst as a laboratory needs them: their triggers, and the path of the stage."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from mishutter._core.checks import fields_text, require, require_positive_int
from mishutter._core.files import write_bytes
from mishutter.design.design import Design, package_version, sequence_to_dict
from mishutter.evaluation.sequences import lights_of, psnr_of_frames
from mishutter.hardware.drive_files import MAX_STEPS, drive_bytes
from mishutter.hardware.stage_files import path_csv, path_steps, pitch_of
from mishutter.model.stages import StagePath
from mishutter.plane.design import PlaneDesign, burst_to_dict
from mishutter.plane.levels import plane_psnr

_STEPS_OF_A_FRAME = 256
_ONE, _BOTH = ("",), ("_x", "_y")
"""Endings of the columns of a stage of one axis, and of those along rows and columns."""


@dataclass(frozen=True, eq=False)
class FrameTable:
    """A burst in equal steps from its first light to its last, on the clock of its middle.

    Attributes:
        design: The design, which has a `sequence`, or one of frames in the plane.
        begin: Beginning of each step; s.
        frame: The frame that is exposed in each step, counted from 1; 0 between frames, where the
            gate is closed for at least one step: a camera that is exposed for as long as its
            trigger is high would take frames that touch for one.
    """

    design: Design | PlaneDesign
    begin: Float[np.ndarray, "n"]
    frame: Int[np.ndarray, "n"]

    num_levels = 2
    """Levels of the shutter: open, and closed between frames."""

    def __repr__(self) -> str:
        """One line, without the numbers of each step."""
        return fields_text(self)

    @property
    def lights(self) -> list[tuple[float, float]]:
        """First and last light of each frame, exactly; s."""
        return _lights(self.design)

    @property
    def text(self) -> str:
        """The frames in words, and their level."""
        return _frames(self.design).text

    @property
    def psnr(self) -> float:
        """PSNR of the frames, registered; dB."""
        return _frames(self.design).psnr

    @property
    def moves(self) -> bool:
        """Whether the sensor moves during some frame."""
        return _frames(self.design).moves

    @property
    def gated_lights(self) -> list[tuple[float, float]]:
        """First and last light of each frame by the gate; s."""
        step = self.exposure / self.begin.size
        numbers = range(1, len(self.lights) + 1)
        own = (self.begin[self.frame == number] for number in numbers)
        return [(float(each[0]), float(each[-1] + step)) for each in own]

    @property
    def gated_psnr(self) -> float:
        """PSNR of the frames by the gate, whose closed steps are dead time; dB."""
        lights, design = self.gated_lights, self.design
        if isinstance(design, PlaneDesign):
            begin, end = np.transpose(lights)
            where = lambda x: (x.times, x.exposures)  # noqa: E731
            gated = eqx.tree_at(where, design.frames, ((begin + end) / 2, end - begin))
            return float(plane_psnr(design.scene, gated))
        return psnr_of_frames(design.scene, _frames(design).frames, lights=lights)

    @property
    def exposure(self) -> float:
        """Time that the steps share; s."""
        return self.lights[-1][1] - self.lights[0][0]

    @property
    def gate(self) -> Bool[np.ndarray, "n"]:
        """Whether a frame is exposed in each step."""
        return self.frame > 0

    @property
    def level(self) -> Int[np.ndarray, "n"]:
        """Level of the shutter in each step."""
        return self.gate.astype(int)

    @property
    def transmittance(self) -> Float[np.ndarray, "n"]:
        """Transmittance at that level."""
        return self.gate.astype(float)

    @cached_property
    def paths(self) -> dict[str, StagePath]:
        """The path of the stage along each axis, from rest to rest, by the ending of its columns.

        There is none where the stage stays at rest, or no limit says how it moves.
        """
        design = self.design
        if isinstance(design, PlaneDesign):
            return dict(zip(_BOTH, design.stage_paths or (), strict=False))
        path = design.scene.limits.stage_path_of_frames(_frames(design))
        return {} if path is None else {"": path}

    @property
    def places(self) -> dict[str, list[float]]:
        """Places at mid-exposure of each frame, by their names and unit."""
        design = self.design
        if isinstance(design, PlaneDesign):
            middles = np.mean(self.lights, axis=1)
            every = {
                f"stage {end[1:]} / px": path.at(middles)[0] for end, path in self.paths.items()
            }
            return {name: places.tolist() for name, places in every.items()}
        return {"sensor there / px": [frame.position for frame in _frames(design).frames]}

    @property
    def position(self) -> Float[np.ndarray, "n"] | Float[np.ndarray, "2 n"]:
        """Position of the stage at the beginning of each step, along each of two axes; px."""
        return self._along(0)

    def _along(self, order: int) -> np.ndarray:
        """Positions, or velocities, at the beginnings of the steps."""
        ends = _BOTH if isinstance(self.design, PlaneDesign) else _ONE
        rows = [path.at(self.begin)[order] for path in self.paths.values()]
        rows = np.array(rows or np.zeros((len(ends), self.begin.size)))
        return rows if len(rows) == 2 else rows[0]

    @property
    def position_scale(self) -> float:
        """Position that a value of 1 stands for in the formats of -1 to 1; px."""
        return float(np.max(np.abs(self.position))) or 1.0

    def to_csv(self) -> str:
        """The table as text: a line of names, a line of units, then one a step."""
        places, velocities = (np.atleast_2d(self._along(order)) for order in (0, 1))
        ends = _BOTH if len(places) == 2 else _ONE
        names = [f"sensor_{what}{end}" for what in ("position", "velocity") for end in ends]
        units = [unit for unit in ("px", "px/s") for _ in ends]
        lines = [",".join(["begin,frame", *names]), ",".join(["ms,1", *units])]
        rows = zip(self.begin * 1e3, self.frame, *places, *velocities, strict=True)
        lines += [",".join([f"{t:.9g},{k:d}", *(f"{x:.9g}" for x in own)]) for t, k, *own in rows]
        return "\n".join(lines) + "\n"

    def frames_csv(self) -> str:
        """When each frame is to be exposed, exactly."""
        lines = ["frame,begin,end,exposure", "1,ms,ms,ms"]
        for number, (begin, end) in enumerate(self.lights, 1):
            numbers = (f"{time * 1e3:.9g}" for time in (begin, end, end - begin))
            lines.append(",".join([str(number), *numbers]))
        return "\n".join(lines) + "\n"

    def stage_csv(self) -> str | None:
        """The path of the stage from rest to rest; None where no limit says how it moves.

        Rows are at the steps of the table. Where the scene says how its stage follows, a column
        has the command for each axis.
        """
        if not self.paths:
            return None
        path = next(iter(self.paths.values()))  # Axes begin and end at the same times.
        step = self.exposure / self.begin.size
        times = self.begin[0] + step * path_steps(path, self.begin[0], step, self.begin.size)
        parts = np.full(times.size, "between frames", object)
        parts[times < path.exposure[0] - step / 2] = "run-up"
        parts[times > path.exposure[1] - step / 2] = "run-out"
        for number, (begin, end) in enumerate(self.lights, 1):
            parts[(times > begin - step / 2) & (times < end - step / 2)] = f"frame {number}"
        near = 1e-6 * step
        parts[(times <= path.times[0] + near) | (times >= path.times[-1] - near)] = "rest"
        scene = self.design.scene
        return path_csv(self.paths, times, parts, scene.limits.stage, pitch_of(scene))

    @property
    def travel_beyond_limit(self) -> float | None:
        """Travel of an axis where it is more than the limits allow; px. None elsewhere."""
        limits = self.design.scene.limits
        beyond = [limits.travel_beyond(path) for path in self.paths.values()]
        return max((each for each in beyond if each is not None), default=None)

    def save(self, path: str | Path, *, form: str = "csv") -> None:
        """Write the table in a format that a laboratory loads, whole or not at all.

        Args:
            path: The file.
            form: One of `DRIVE_FORMATS`, of which each has a channel that is open in frames and
                closed between them.

        Raises:
            ValueError: if there is no such format.
            OSError: if the file cannot be written.
        """
        write_bytes(path, drive_bytes(self, form))

    def to_dict(self) -> dict[str, Any]:
        """The table as plain numbers."""
        return {
            "mishutter": package_version(),
            "step_ms": self.exposure * 1e3 / self.begin.size,
            "position_scale_px": self.position_scale,
            "begin_ms": (self.begin * 1e3).tolist(),
            "frame": self.frame.tolist(),
            "gated_psnr_db": self.gated_psnr,
            "sensor_position_px": self.position.tolist(),
            **self._document,
        }

    @property
    def _document(self) -> dict[str, Any]:
        """The frames as plain numbers."""
        if isinstance(self.design, PlaneDesign):
            return {"plane": burst_to_dict(self.design.burst)}
        return {"sequence": sequence_to_dict(_frames(self.design))}


def _frames(design: Design | PlaneDesign) -> Any:
    """The frames of a design, which know their level."""
    return design.burst if isinstance(design, PlaneDesign) else design.sequence


def _lights(design: Design | PlaneDesign) -> list[tuple[float, float]]:
    """First and last light of each frame of a design; s."""
    return design.lights if isinstance(design, PlaneDesign) else lights_of(_frames(design).frames)


def frame_table(design: Design | PlaneDesign, *, num_steps: int | None = None) -> FrameTable:
    """The triggers of a burst's frames, and its stage, in equal steps.

    Args:
        design: The design, which has a `sequence`, or one of frames in the plane.
        num_steps: Steps from the first light to the last, at most 100,000; by default 256 for each
            frame. Triggers are rounded to them, and frames that touch end a step early;
            `FrameTable.frames_csv` has them exactly.

    Raises:
        ValueError: if the design has no `sequence`, or a count is out of its range or leaves a
            frame without a step.
    """
    subject = "frame_table(design=...)"
    is_design = isinstance(design, Design | PlaneDesign)
    require(is_design, subject, "be a `Design`, or a `PlaneDesign`", design)
    has_frames = _frames(design) is not None
    require(has_frames, subject, "hold the frames of a burst", _frames(design))
    lights = _lights(design)
    count = _STEPS_OF_A_FRAME * len(lights) if num_steps is None else num_steps
    require_positive_int("frame_table(num_steps=...)", count)
    require(count <= MAX_STEPS, "frame_table(num_steps=...)", f"be at most {MAX_STEPS}", count)
    duration = lights[-1][1] - lights[0][0]
    begin = lights[0][0] + duration / count * np.arange(count)
    middles, frame = begin + duration / count / 2, np.zeros(count, int)
    for number, (first, last) in enumerate(lights, 1):
        frame[(middles > first) & (middles < last)] = number
    touches = (frame[:-1] > 0) & (frame[1:] > 0) & (frame[1:] != frame[:-1])
    frame[:-1][touches] = 0
    lasting = np.unique(frame[frame > 0]).size
    requirement = f"leave each of {len(lights)} frames a step, and one between two"
    require(lasting == len(lights), "frame_table(num_steps=...)", requirement, count)
    return FrameTable(design, begin, frame)
