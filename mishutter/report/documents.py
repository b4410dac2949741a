"""Files of a comparison: one document for programs, and pictures for people."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from mishutter._core.files import FORMER, ONE_EXPOSURE, RECOMMENDED, strict_json, write_text
from mishutter.decoding.photographs import RestoredPhotograph
from mishutter.design.design import Design
from mishutter.model.scene import Scene
from mishutter.report import plots
from mishutter.report.comparison import Comparison
from mishutter.report.measured import MeasuredCamera
from mishutter.report.restored import ENSEMBLE, Photographs, pictured_speeds, shown_speeds
from mishutter.report.verdict import option_name
from mishutter.search.rows import (
    BEST_SNAPSHOT,
    OWN_BEST_MOTION,
    SHUTTER,
    SNAPSHOTS,
    Row,
    cameras_of,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DOCUMENT = "report.json"
_PICTURES = frozenset(
    f"{name}.png" for name in ("profile", "kernels", "transfer", "psnr", "answer", "photograph")
)
"""Pictures of which a run may write fewer than an earlier one."""
_MOST_ROWS = 3
"""Most rows of a picture that has one for each design."""


@dataclass(frozen=True)
class Report:
    """A comparison, and the scene's photograph as its designs restored it."""

    scene: Scene  # The scene that was photographed
    comparison: Comparison  # The shutters side by side
    names: tuple[str, ...]  # The user's shutters among them
    # The photograph restored by each on its own best motion; None without one
    photographs: Photographs | None = None
    design: Design | None = None  # The result of a search; None without one
    # A measured shutter beside its design; None without a trace
    measured: MeasuredCamera | None = None
    every: bool = False  # Whether pictures show designs that the answer does not recommend

    @property
    def rows(self) -> dict[str, Row]:
        """Rows that pictures show; a picture without room for all shows the first of them.

        They are the best option and the best snapshot at rest. Where that option is one exposure
        that is designed, or where every one is wanted, the user's shutters and the best of the
        others follow.
        """
        comparison = self.comparison
        rows = {row.name: row for row in comparison.rows if row.reading == OWN_BEST_MOTION}
        choice = [] if comparison.choice is None else [comparison.choice.name]
        order = [*choice, BEST_SNAPSHOT]
        if self.every or comparison.is_coded:
            coded = {
                name: row
                for name, row in rows.items()
                if row.is_of_one_exposure and name not in (*self.names, *SNAPSHOTS)
            }
            # Searches that end in one place differ by rounding; the first of them is pictured.
            best = [max(coded, key=lambda name: round(coded[name].level, 3))] if coded else []
            order += [*self.names, *best]
        return {name: rows[name] for name in dict.fromkeys(order) if name in rows}

    @property
    def cameras(self) -> dict[str, Row]:
        """The pictured rows of one exposure, those of the same camera once, by all its names."""
        cameras = cameras_of(row for row in self.rows.values() if row.is_of_one_exposure)
        return {" = ".join(row.name for row in camera): camera[0] for camera in cameras}

    @property
    def photograph_levels(self) -> dict[str, dict[str, RestoredPhotograph]]:
        """How well the photograph was restored, by decoder, then by all names of a camera."""
        levels = {} if self.photographs is None else self.photographs.levels
        return {
            decoder: {name: results[row.name] for name, row in self.cameras.items()}
            for decoder, results in levels.items()
        }

    @property
    def one_exposure(self) -> Design | None:
        """The design of the search as one exposure, without the frames that may be better.

        None where the answer is frames whatever one exposure reaches, so that none was searched.
        """
        if self.design is None or not self.names:
            return None
        return replace(self.design, sequence=None)

    @property
    def recommended(self) -> Design | None:
        """The best option as a design; None without a search, and where nothing is recommended."""
        choice = self.comparison.choice
        if choice is not None and choice.is_in_plane:
            return Design(self.scene, choice.exposures)
        if self.design is None or choice is None:
            return None
        if choice.sequence is not None:
            return replace(self.design, sequence=choice.sequence)
        return self.one_exposure if choice.name in self.names else choice.design

    @property
    def file_to_build(self) -> str:
        """Name of the file that holds the best option, once a report with a design is written."""
        return ONE_EXPOSURE if self.recommended is None else RECOMMENDED

    def plot(self) -> "Figure":
        """Draws the best option under the first line of the answer; all rows without one."""
        choice = self.comparison.choice
        if choice is None:
            return self.comparison.plot()
        return plots.plot_option(self.scene, choice, self.comparison.verdict.splitlines()[0])

    def to_dict(self) -> dict[str, object]:
        """Everything in a report as plain numbers, lists and text."""
        levels = {} if self.photographs is None else self.photographs.levels
        design = {} if self.design is None else {"design": self.design.to_dict()}
        measured = {} if self.measured is None else {"as_measured": self.measured.to_dict()}
        photographs: dict[str, object] = {}
        for decoder, results in levels.items():
            photographs[decoder] = {
                name: {
                    "speeds_px_per_s": result.speeds,
                    "psnr_db": result.psnr,
                    "linear_psnr_db": result.linear_psnr,
                    "standard_error_db": result.standard_error,
                    "mean_linear_psnr_db": result.mean_psnr,
                    "expected_of_ensemble_filter_db": result.expected_psnr,
                    "expected_of_its_own_detail_db": result.own_expected_psnr,
                    "doubts": result.doubts.tolist(),
                }
                for name, result in results.items()
            }
        law, answer = self.scene.velocities, self.comparison.to_dict()
        velocities = {} if law is None else {"velocities": law.table}
        return {
            **design,
            **velocities,
            **answer,
            # Programs look for the answer here too.
            "comparison": answer,
            **measured,
            "photographs": photographs,
        }


def write_report(
    report: Report, folder: Path, *, wrote: Callable[[str], None] = lambda name: None
) -> list[str]:
    """Writes designs, profiles and pictures to a folder; returns the names of the files.

    Pictures that an earlier run wrote are deleted if this report has none of their name, and so
    are its designs under the names of an earlier version.
    """
    writers = _writers(report)
    for name, write in writers.items():
        write(folder / name)
        wrote(name)
    older = _PICTURES if report.recommended is None else {*_PICTURES, *FORMER, ONE_EXPOSURE}
    for name in older - set(writers):
        (folder / name).unlink(missing_ok=True)
    return list(writers)


def _writers(report: Report) -> dict[str, Callable[[Path], None]]:
    """A function for each file that writes it, by the file's name, in the order of writing."""
    writers: dict[str, Callable[[Path], None]] = {}
    if report.recommended is not None:
        writers[RECOMMENDED] = report.recommended.save
    if report.design is not None and report.one_exposure is not None:
        writers[ONE_EXPOSURE] = report.one_exposure.save
        # Beside frames to take, the profile of one exposure would be that of another camera.
        if report.every or report.comparison.sequence is None:
            writers["profile.csv"] = report.design.write_profile
    writers[_DOCUMENT] = partial(_write_document, report)

    def save(drawn: "Callable[[], Figure]", path: Path) -> None:
        plots.save_figure(drawn(), path)

    return writers | {name: partial(save, drawn) for name, drawn in _drawings(report).items()}


def _write_document(report: Report, path: Path) -> None:
    write_text(path, strict_json(report.to_dict()) + "\n")


def _drawings(report: Report) -> "dict[str, Callable[[], Figure]]":
    """A function for each picture that draws it, by the name of its file."""
    scene, comparison = report.scene, report.comparison
    drawings: dict[str, Callable[[], Figure]] = {}
    choice = comparison.choice
    if choice is not None:
        drawings["answer.png"] = report.plot
    if report.photographs is not None:
        shown = report.photographs.shown
        few = dict(itertools.islice(report.rows.items(), _MOST_ROWS))
        restored = {option_name(row): shown[name] for name, row in few.items()}
        asides = {
            option_name(row): ", registered" if row.num_frames > 1 else row.decoder.aside
            for row in few.values()
        }
        drawings["photograph.png"] = lambda: plots.plot_photograph(
            restored, pictured_speeds(scene), axis=scene.sensor.axis, asides=asides
        )
    if scene.velocities is not None or not (report.every or comparison.is_coded):
        return drawings
    designs = {name: (row.motion, row.shutter) for name, row in report.cameras.items()}
    knowledge = next(iter(report.cameras.values())).decoder.name
    levels_of_answer = {name: row.level for name, row in report.cameras.items()}
    some = dict(itertools.islice(designs.items(), _MOST_ROWS))
    drawings |= {
        "profile.png": lambda: plots.plot_profiles(
            designs,
            explains_ears=choice is not None and SHUTTER in choice.required_hardware,
        ),
        "kernels.png": lambda: plots.plot_kernels(some, shown_speeds(scene)),
        "transfer.png": lambda: plots.plot_transfer(scene, designs, knowledge, levels_of_answer),
    }
    if report.photographs is not None:
        levels = report.photograph_levels
        drawings["psnr.png"] = lambda: plots.plot_psnr(levels[ENSEMBLE])
    return drawings
