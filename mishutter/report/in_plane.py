"""The answer of a search in the plane: options, verdict, document and picture."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Array

from mishutter._core.files import FORMER, RECOMMENDED, strict_json, write_text
from mishutter.design.design import PlaneDesign, plane_burst_to_dict
from mishutter.evaluation.sequences import LONG
from mishutter.model.scene import Scene
from mishutter.plane.bursts import PlaneBurst
from mishutter.report import plots
from mishutter.report.verdict import (
    camera_words,
    counted,
    detail_words,
    objects_words,
    order_at_rest,
    order_line,
    paragraph,
    points_that_leave,
    snapshot_line,
    stage_adds,
    stage_does,
    stage_numbers,
    table_of_levels,
)
from mishutter.search.frame_ties import FREE
from mishutter.search.plane_frames import PlaneSearch
from mishutter.search.rows import simplest_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class PlaneReport:
    """The options of a scene of any direction."""

    scene: Scene  # The scene
    search: PlaneSearch  # The best frames of each kind of way

    @property
    def options(self) -> tuple[PlaneBurst, ...]:
        """The snapshot and the frames by what they need, in the order of their levels."""
        few = (self.search.snapshot, *self.search.simplest)
        free = [burst for burst in few if burst.kind == FREE]
        two = [x for x in self.search.bursts if x.num_axes == 2 and x.kind != FREE]
        # Beside a free path stands what a stage of two resonant axes does.
        beside = [max(two, key=lambda burst: burst.level)] if free and two else []
        several = [x for x in (*few, *beside) if x is few[0] or x.num_frames > 1 or x.num_axes]
        # What needs more axes than another and is no better is no option.
        worth = [
            x
            for x in several
            if not any(y.num_axes < x.num_axes and y.level >= x.level for y in several)
        ]
        return tuple(sorted(worth, key=lambda burst: burst.level))

    @property
    def choice(self) -> PlaneBurst:
        """The option to take: a simpler one where another is less than 0.2 dB better.

        A free path is the least simple: no resonant stage follows it.
        """
        first = self.search.snapshot
        ranks = ((x, (x.num_axes, x.kind == FREE, x is not first)) for x in self.options)
        return simplest_of((x.level, rank, x) for x, rank in ranks)

    @property
    def design(self) -> PlaneDesign:
        """The option to take, with the scene."""
        return PlaneDesign(self.scene, self.choice)

    def text(self) -> str:
        """The answer: what to take, the options, and what it assumes."""
        first, choice = self.search.snapshot, self.choice
        level = f"{choice.level:.1f} dB"
        gain = choice.level - first.level
        headline = snapshot_line(first.lengths, level)
        if choice is not first:
            order = order_at_rest(choice, self.scene.limits)
            if choice.num_axes:
                order = f"{counted(choice)}{_way(choice)}"
            headline = order_line(order, level, (gain,))
        needs = ("registration", "registration, stage", "registration, stage of two axes")
        rows = [
            (
                _name(x),
                x.level,
                None if x is first else x.level - first.level,
                "nothing" if x is first else needs[x.num_axes],
            )
            for x in self.options
        ]
        most = self.search.ceiling
        ceiling = ("ceiling of any path", most, most - first.level, "-")
        table = table_of_levels([*rows, ceiling], "mean over all velocities")
        return "\n\n".join([headline, table, "\n".join(self._sentences())])

    def _sentences(self) -> list[str]:
        choice, scene = self.choice, self.scene
        law = scene.velocities
        width, longest = scene.registered_width, float(np.max(choice.exposures))
        within = float(scene.max_speed) * longest
        leave = "things that enter and leave are not counted (else say [sensor] width_px)"
        said = [
            detail_words(scene),
            "" if law is None else law.words,
            objects_words(scene, choice),
            "velocities are found from the frames without error",
            leave if width is None else "",
            f"borders cost more than is counted: things move by {within:.0f} px within a frame"
            if width is not None and choice.num_axes and within > LONG * width
            else "",
            *camera_words(
                scene, frames=choice is not self.search.snapshot, stage=choice.num_axes > 0
            ),
        ]
        sentences = [
            self._stage_words(choice),
            points_that_leave(scene, choice.width_loss),
            f"Assumes: {'; '.join(filter(None, said))}.",
        ]
        if scene.decoder_speed == "unknown":
            sentences.insert(
                1,
                "One filter for all velocities is not offered: no moving camera beats the best "
                "still frame by it where things move in any direction.",
            )
        return [paragraph(sentence) for sentence in sentences if sentence]

    def _stage_words(self, choice: PlaneBurst) -> str:
        """The gain by the stage, and the demands on it."""
        if not choice.num_axes:
            return ""
        use, pitch = choice.use, self.scene.sensor.pixel_pitch
        travel, top_speed = _at_most(use.travel), _at_most(use.top_speed)
        numbers = stage_numbers(travel, top_speed, float(use.acceleration), pitch)
        is_limited = self.scene.limits.max_acceleration is not None
        run_up = "included" if is_limited else "at once: say [limits] max_acceleration_px_per_s2"
        together = "both axes" if self.scene.limits.axes == "disc" else "each axis"
        without = max((x.level for x in self.options if not x.num_axes), default=choice.level)
        return (
            f"{stage_adds(choice.level - without)} It travels {numbers}, {together}, run-up from "
            f"rest {run_up}."
        )

    def to_dict(self) -> dict[str, object]:
        """The answer as plain numbers and text."""
        first = self.search.snapshot
        law = self.scene.velocities
        return {
            "velocities": {} if law is None else law.table,
            "verdict": self.text(),
            "choice": self.choice.kind,
            "ceiling_db": self.search.ceiling,
            "options": [_document(x, first) for x in self.options],
            "ways": [_document(x, first) for x in self.search.bursts],
            "frames": plane_burst_to_dict(self.choice),
        }

    def plot(self) -> "Figure":
        """Draws the choice: its path in the plane and in time, and the velocities it takes."""
        return plots.plot_plane(self.scene, self.choice, self.text().split("\n", 1)[0])


def _at_most(value: Array | np.ndarray | float) -> float:
    """A number rounded up to two digits: those after these a search does not settle."""
    if not value > 0:  # A camera that turns leaves its stage where it is.
        return 0.0
    size = 10.0 ** (math.floor(math.log10(float(value))) - 1)
    return math.ceil(float(value) / size - 1e-6) * size


def _way(burst: PlaneBurst) -> str:
    return stage_does(burst.kind, f"{_at_most(burst.use.travel):g} px")


def _name(burst: PlaneBurst) -> str:
    if not burst.num_axes:
        what = "snapshot" if burst.num_frames == 1 else counted(burst)
        return f"{what} at rest, {burst.lengths}"
    # The needs say how many axes move, and the sentence below how far.
    return f"{counted(burst)}{_way(burst).partition(' over ')[0]}, {burst.lengths}"


def _document(burst: PlaneBurst, first: PlaneBurst) -> dict[str, object]:
    return {
        "kind": burst.kind,
        "name": _name(burst),
        "num_frames": burst.num_frames,
        "num_axes": burst.num_axes,
        "psnr_db": burst.psnr,
        "width_loss_db": burst.width_loss,
        "gain_db": burst.level - first.level,
        "travel_px": float(burst.use.travel),
        "top_speed_px_per_s": float(burst.use.top_speed),
    }


def write_plane_report(
    report: PlaneReport, folder: Path, *, wrote: Callable[[str], None] = lambda name: None
) -> list[str]:
    """Writes the design, the document and the picture of an answer; returns the files' names."""
    report.design.save(folder / RECOMMENDED)
    wrote(RECOMMENDED)
    write_text(folder / "report.json", strict_json(report.to_dict()) + "\n")
    wrote("report.json")
    plots.save_figure(report.plot(), folder / "answer.png")
    wrote("answer.png")
    for name in FORMER:
        (folder / name).unlink(missing_ok=True)
    return [RECOMMENDED, "report.json", "answer.png"]
