"""The frames of a burst as a laboratory needs them: their triggers, and the path of the stage."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from mishutter._core.checks import fields_text, require, require_positive_int
from mishutter._core.files import write_bytes
from mishutter.design.design import Design, package_version, sequence_to_dict
from mishutter.evaluation.sequences import lights_of, psnr_of_frames
from mishutter.hardware.drive_files import MAX_STEPS, drive_bytes
from mishutter.hardware.stage_files import path_csv, path_steps, pitch_of
from mishutter.model.sequences import FrameSequence
from mishutter.model.stages import StagePath

_STEPS_OF_A_FRAME = 256


@dataclass(frozen=True, eq=False)
class FrameTable:
    """A burst in equal steps from its first light to its last, on the clock of its middle.

    Attributes:
        design: The design, which has a `sequence`.
        begin: Beginning of each step; s.
        frame: The frame that is exposed in each step, counted from 1; 0 between frames, where the
            gate is closed for at least one step: a camera that is exposed for as long as its
            trigger is high would take frames that touch for one.
    """

    design: Design
    begin: Float[np.ndarray, "n"]
    frame: Int[np.ndarray, "n"]

    num_levels = 2
    """Levels of the shutter: open, and closed between frames."""

    def __repr__(self) -> str:
        """One line, without the numbers of each step."""
        return fields_text(self)

    @property
    def sequence(self) -> FrameSequence:
        """The frames."""
        return self.design.sequence  # type: ignore[return-value]

    @property
    def lights(self) -> list[tuple[float, float]]:
        """First and last light of each frame, exactly; s."""
        return lights_of(self.sequence.frames)

    @property
    def gated_lights(self) -> list[tuple[float, float]]:
        """First and last light of each frame by the gate; s."""
        step = self.exposure / self.begin.size
        numbers = range(1, self.sequence.num_frames + 1)
        own = (self.begin[self.frame == number] for number in numbers)
        return [(float(each[0]), float(each[-1] + step)) for each in own]

    @property
    def gated_psnr(self) -> float:
        """PSNR of the frames by the gate, whose closed steps are dead time; dB."""
        lights = self.gated_lights
        return psnr_of_frames(self.design.scene, self.sequence.frames, lights=lights)

    @property
    def exposure(self) -> float:
        """Time that the steps share; s."""
        return self.sequence.duration

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
    def path(self) -> StagePath | None:
        """The path of the stage from rest to rest; None where no limit says how it moves."""
        return self.design.scene.limits.stage_path_of_frames(self.sequence)

    @property
    def position(self) -> Float[np.ndarray, "n"]:
        """Position of the stage at the beginning of each step; px."""
        return np.zeros(self.begin.size) if self.path is None else self.path.at(self.begin)[0]

    @property
    def position_scale(self) -> float:
        """Position that a value of 1 stands for in the formats of -1 to 1; px."""
        return float(np.max(np.abs(self.position))) or 1.0

    def to_csv(self) -> str:
        """The table as text: a line of names, a line of units, then one a step."""
        velocity = np.zeros(self.begin.size) if self.path is None else self.path.at(self.begin)[1]
        lines = ["begin,frame,sensor_position,sensor_velocity", "ms,1,px,px/s"]
        rows = zip(self.begin * 1e3, self.frame, self.position, velocity, strict=True)
        lines += [f"{t:.9g},{k:d},{x:.9g},{u:.9g}" for t, k, x, u in rows]
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

        Rows are at the steps of the table. Where the scene says how its stage follows, the last
        column is the command for it.
        """
        path = self.path
        if path is None:
            return None
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
        return path_csv(path, times, parts, scene.limits.stage, pitch_of(scene))

    @property
    def travel_beyond_limit(self) -> float | None:
        """Travel of the path where it is more than the limits allow; px. None elsewhere."""
        return self.design.scene.limits.travel_beyond(self.path)

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
            "sequence": sequence_to_dict(self.sequence),
        }


def frame_table(design: Design, *, num_steps: int | None = None) -> FrameTable:
    """The triggers of a burst's frames, and its stage, in equal steps.

    Args:
        design: The design, which has a `sequence`.
        num_steps: Steps from the first light to the last, at most 100,000; by default 256 for each
            frame. Triggers are rounded to them, and frames that touch end a step early;
            `FrameTable.frames_csv` has them exactly.

    Raises:
        ValueError: if the design has no `sequence`, or a count is out of its range or leaves a
            frame without a step.
    """
    subject = "frame_table(design=...)"
    require(isinstance(design, Design), subject, "be a `Design`", design)
    has_frames = design.sequence is not None
    require(has_frames, subject, "hold the frames of a burst", design.sequence)
    sequence: FrameSequence = design.sequence  # type: ignore[assignment]
    count = _STEPS_OF_A_FRAME * sequence.num_frames if num_steps is None else num_steps
    require_positive_int("frame_table(num_steps=...)", count)
    require(count <= MAX_STEPS, "frame_table(num_steps=...)", f"be at most {MAX_STEPS}", count)
    lights = lights_of(sequence.frames)
    begin = lights[0][0] + sequence.duration / count * np.arange(count)
    middles, frame = begin + sequence.duration / count / 2, np.zeros(count, int)
    for number, (first, last) in enumerate(lights, 1):
        frame[(middles > first) & (middles < last)] = number
    touches = (frame[:-1] > 0) & (frame[1:] > 0) & (frame[1:] != frame[:-1])
    frame[:-1][touches] = 0
    lasting = np.unique(frame[frame > 0]).size
    requirement = f"leave each of {sequence.num_frames} frames a step, and one between two"
    require(lasting == sequence.num_frames, "frame_table(num_steps=...)", requirement, count)
    return FrameTable(design, begin, frame)
