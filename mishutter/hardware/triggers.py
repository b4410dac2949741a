"""The frames of a burst as a laboratory needs them: their triggers, and the path of the stage."""

from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float, Int

from mishutter._core.checks import require, require_positive_int
from mishutter._core.columns import table_text
from mishutter.design.design import Design
from mishutter.evaluation.levels import exposures_psnr
from mishutter.hardware.drive_files import STEPS, AbstractTable, first_lights
from mishutter.hardware.stage_files import MAX_STEPS
from mishutter.model.frame_path import Lights


@final
@dataclass(frozen=True, eq=False, repr=False)
class FrameTable(AbstractTable):
    """A burst in equal steps from its first light to its last, on the clock of its middle.

    Of rows that are exposed one after another it is the light of the first, which a trigger begins.

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

    @property
    def gated_lights(self) -> Lights:
        """First and last light of each frame by the gate; s."""
        numbers = range(1, len(self.lights) + 1)
        own = (self.begin[self.frame == number] for number in numbers)
        return [(float(each[0]), float(each[-1] + self.step)) for each in own]

    @property
    def gated_psnr(self) -> float:
        """PSNR of the frames by the gate, whose closed steps are dead time; dB."""
        scene, lead = self.design.scene, self.lead
        lights = [(begin + lead, end + lead) for begin, end in self.gated_lights]
        return float(exposures_psnr(scene, self.exposures, lights=lights))

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

    @property
    def places(self) -> dict[str, np.ndarray]:
        """Places at mid-exposure of each frame, by their names and unit."""
        middles, taken = np.array(self.exposures.times), self.exposures
        if not taken.in_plane:
            return {"sensor there / px": taken.place(middles[:, None])[0, :, 0]}
        return {f"stage {end[1:]} / px": path.at(middles)[0] for end, path in self.paths.items()}

    @property
    def position(self) -> Float[np.ndarray, "n"] | Float[np.ndarray, "2 n"]:
        """Position of the stage at the beginning of each step, along each of two axes; px."""
        return self._along(0)

    def _along(self, order: int) -> np.ndarray:
        """Positions, or velocities, at the beginnings of the steps."""
        rows = [path.at(self.begin)[order] for path in self.paths.values()]
        rows = np.array(rows or np.zeros((len(self.exposures.axes), self.begin.size)))
        return rows if len(rows) == 2 else rows[0]

    def to_csv(self) -> str:
        """The table as text: a line of names, a line of units, then one a step."""
        columns = {("begin", "ms"): self.begin * 1e3, ("frame", "1"): self.frame}
        for order, (what, unit) in enumerate((("position", "px"), ("velocity", "px/s"))):
            rows = np.atleast_2d(self._along(order))
            ends = self.exposures.axes
            columns |= {(f"sensor_{what}{x}", unit): y for x, y in zip(ends, rows, strict=True)}
        return table_text(columns)

    def frames_csv(self) -> str:
        """When each frame is to be exposed, exactly."""
        begin, end = 1e3 * np.transpose(self.lights)
        numbers = np.arange(1, begin.size + 1)
        columns = {("begin", "ms"): begin, ("end", "ms"): end, ("exposure", "ms"): end - begin}
        return table_text({("frame", "1"): numbers} | columns)

    def to_dict(self) -> dict[str, object]:
        """The table as plain numbers."""
        return {
            **self.head,
            "frame": self.frame.tolist(),
            "gated_psnr_db": self.gated_psnr,
            **self.design.frames_document,
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
    is_design = isinstance(design, Design)
    require(is_design, subject, "be a `Design`", design)
    require(design.sequence is not None, subject, "hold the frames of a burst", design.sequence)
    lights = first_lights(design)
    count = STEPS * len(lights) if num_steps is None else num_steps
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
