"""A comparison for programs and for people: one document, pictures in a folder."""

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mishutter._core import strict_json, write_text
from mishutter.hardware import Design
from mishutter.model import Scene, scene_picture
from mishutter.report.comparison import Comparison
from mishutter.report.layered import layered_captures, layered_scene
from mishutter.report.photographs import (
    ENSEMBLE,
    Photographs,
    pictured_speeds,
    shown_speeds,
)
from mishutter.restore import RestoredPhotograph
from mishutter.search import (
    BEST_BURST,
    BEST_CODED_STILL,
    BEST_PANNED_SNAPSHOT,
    BEST_TUKEY,
    OWN_BEST_MOTION,
    SNAPSHOTS,
    Row,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST_ROWS = 5
"""Of a picture with a row for each design, at most."""


@dataclass(frozen=True)
class Report:
    """A comparison and what the photograph showed of it.

    Attributes:
        scene: The scene that was photographed.
        comparison: The shutters side by side.
        names: The given shutters among them.
        photographs: Results of the photograph for each on its own best motion; None for none.
        design: The design that was searched for; None for none.
    """

    scene: Scene
    comparison: Comparison
    names: tuple[str, ...]
    photographs: Photographs | None = None
    design: Design | None = None


def shown_rows(comparison: Comparison, names: tuple[str, ...]) -> dict[str, Row]:
    """Rows to photograph: those of `pictured_rows`, every snapshot and the coded still."""
    held = _at_best(comparison)
    others = (n for n in (*SNAPSHOTS, BEST_CODED_STILL) if n in held)
    wanted = dict.fromkeys((*pictured_rows(comparison, names), *others))
    return {name: held[name] for name in wanted}


def pictured_rows(comparison: Comparison, names: tuple[str, ...]) -> dict[str, Row]:
    """Rows that pictures show, the first of them where not all fit.

    The first of the given shutters; its rivals, the better snapshot, the best Tukey and the best
    of all; the other given ones; Hann and rect.
    """
    held = _at_best(comparison)
    rivals = [name for name in held if name not in names and name != BEST_BURST]
    level = {name: row.level for name, row in held.items()}.__getitem__
    snapshot = max((name for name in SNAPSHOTS if name in held), key=level)
    best = max(rivals, key=level)
    wanted = dict.fromkeys((*names[:1], snapshot, BEST_TUKEY, best, *names[1:], "Hann", "rect"))
    return {name: held[name] for name in wanted}


def _at_best(comparison: Comparison) -> dict[str, Row]:
    """Rows on their own best motions; a panned snapshot that does not pan is no other one."""
    held = {row.name: row for row in comparison.rows if row.reading == OWN_BEST_MOTION}
    if BEST_PANNED_SNAPSHOT in held and float(held[BEST_PANNED_SNAPSHOT].motion.velocity) == 0:
        del held[BEST_PANNED_SNAPSHOT]
    return held


def document(report: Report) -> dict[str, Any]:
    """Everything in a report as plain numbers, lists and text."""
    levels = {} if report.photographs is None else report.photographs.levels
    photographs = {
        decoder: {name: _photograph_document(result) for name, result in results.items()}
        for decoder, results in levels.items()
    }
    found = {} if report.design is None else {"design": report.design.to_dict()}
    return found | {"comparison": report.comparison.to_dict(), "photographs": photographs}


def _layered(report: Report, rows: dict[str, Row]) -> "Figure":
    """The slowest of the scene's objects behind a typical one, by the design and the snapshot."""
    from mishutter.report import plots

    slowest, typical = shown_speeds(report.scene)[0], pictured_speeds(report.scene)[0]
    scene = report.scene
    seen = layered_scene(scene_picture(scene), slowest, typical, scene.axis)
    few = {name: row for name, row in rows.items() if name in (*report.names[:1], *SNAPSHOTS)}
    captures = layered_captures(seen, scene.along_rows(), few)
    return plots.plot_layers(seen, captures, axis=scene.axis)


def _photograph_document(result: RestoredPhotograph) -> dict[str, Any]:
    return {
        "speeds_px_per_s": result.speeds,
        "psnr_db": result.psnr,
        "linear_psnr_db": result.linear_psnr,
        "standard_error_db": result.standard_error,
        "mean_linear_psnr_db": result.mean_psnr,
        "expected_of_ensemble_filter_db": result.expected_psnr,
        "expected_of_its_own_detail_db": result.own_expected_psnr,
    }


def write_report(report: Report, folder: Path) -> list[str]:
    """Designs, profiles and pictures into a folder; the names of the files.

    Pictures of a photograph that an earlier run left there, and this one has none for, go.

    Raises:
        OSError: if a file cannot be written.
    """
    from mishutter.report import plots

    rows = pictured_rows(report.comparison, report.names)
    designs = {name: (row.motion, row.shutter) for name, row in rows.items()}
    few = dict(itertools.islice(designs.items(), _MOST_ROWS))
    figures = {
        "profile.png": plots.plot_profiles(designs),
        "kernels.png": plots.plot_kernels(few, shown_speeds(report.scene)),
        "transfer.png": plots.plot_transfer(report.scene, designs),
    }
    if report.photographs is not None:
        figures["psnr.png"] = plots.plot_psnr(report.photographs.levels[ENSEMBLE], linear=True)
        seen = {name: report.photographs.shown[name] for name in few}
        speeds = pictured_speeds(report.scene)
        figures["photograph.png"] = plots.plot_photograph(
            seen, speeds, linear=True, axis=report.scene.axis
        )
    if report.photographs is not None and report.design is not None:
        figures = {"layers.png": _layered(report, rows)} | figures
    if report.design is not None:
        report.design.save(folder / "design.json")
        report.design.write_profile(folder / "profile.csv")
    for name, figure in figures.items():
        plots.save_figure(figure, folder / name)
    write_text(folder / "report.json", strict_json(document(report)) + "\n")
    for name in {"psnr.png", "photograph.png", "layers.png"} - set(figures):
        (folder / name).unlink(missing_ok=True)
    written = ["report.json", *figures]
    return written if report.design is None else ["design.json", "profile.csv", *written]
