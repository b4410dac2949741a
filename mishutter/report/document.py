"""A comparison for programs and for people: one document, pictures in a folder."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mishutter._core import strict_json, write_text
from mishutter.design import (
    BEST_CODED_STILL,
    BEST_PANNED_SNAPSHOT,
    BEST_SNAPSHOT,
    BEST_TUKEY,
    OWN_BEST_MOTION,
    Comparison,
    Design,
    Row,
)
from mishutter.model import (
    Scene,
)
from mishutter.report.photographs import ENSEMBLE, Photographs, shown_speeds
from mishutter.restore import RestoredPhotograph


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
    """Rows to show on the photograph and in pictures: rect, Hann, the best rivals, the given."""
    wanted = dict.fromkeys(("rect", "Hann", *names, BEST_TUKEY, BEST_SNAPSHOT))
    held = {row.name: row for row in comparison.rows if row.reading == OWN_BEST_MOTION}
    panned = held.get(BEST_PANNED_SNAPSHOT)
    if panned is not None and float(panned.motion.velocity) != 0:
        wanted[BEST_PANNED_SNAPSHOT] = None
    if BEST_CODED_STILL in held:
        wanted[BEST_CODED_STILL] = None
    return {name: comparison.row(name, OWN_BEST_MOTION) for name in wanted}


def document(report: Report) -> dict[str, Any]:
    """Everything in a report as plain numbers, lists and text."""
    levels = {} if report.photographs is None else report.photographs.levels
    photographs = {
        decoder: {name: _photograph_document(result) for name, result in results.items()}
        for decoder, results in levels.items()
    }
    found = {} if report.design is None else {"design": report.design.to_dict()}
    return found | {"comparison": report.comparison.to_dict(), "photographs": photographs}


def _photograph_document(result: RestoredPhotograph) -> dict[str, Any]:
    return {
        "speeds_px_per_s": result.speeds,
        "psnr_db": result.psnr,
        "linear_psnr_db": result.linear_psnr,
        "standard_error_db": result.standard_error,
        "mean_linear_psnr_db": result.mean_psnr,
        "expected_of_ensemble_filter_db": result.expected_psnr,
    }


def write_report(report: Report, folder: Path) -> list[str]:
    """Designs, profiles and pictures into a folder; the names of the files.

    Pictures of a photograph that an earlier run left there, and this one has none for, go.

    Raises:
        OSError: if a file cannot be written.
    """
    from mishutter.report import plots

    rows = shown_rows(report.comparison, report.names)
    main = {name: rows[name] for name in ("rect", "Hann", *report.names)}
    designs = {name: (row.motion, row.shutter) for name, row in main.items()}
    speeds = shown_speeds(report.scene.speeds)
    figures = {
        "profile.png": plots.plot_profiles(designs),
        "kernels.png": plots.plot_kernels(designs, speeds),
        "transfer.png": plots.plot_transfer(designs, list(dict.fromkeys((speeds[0], speeds[-1])))),
    }
    if report.photographs is not None:
        figures["psnr.png"] = plots.plot_psnr(report.photographs.levels[ENSEMBLE], linear=True)
        side_by_side = {name: report.photographs.shown[name] for name in main}
        figures["photograph.png"] = plots.plot_photograph(side_by_side, speeds[-1], linear=True)
    if report.design is not None:
        loss_name = report.design.loss_name.split("(")[0]
        figures["history.png"] = plots.plot_history(report.design.history, loss_name=loss_name)
        report.design.save(folder / "design.json")
        report.design.write_profile(folder / "profile.csv")
    for name, figure in figures.items():
        plots.save_figure(figure, folder / name)
    write_text(folder / "report.json", strict_json(document(report)) + "\n")
    for name in {"psnr.png", "photograph.png"} - set(figures):
        (folder / name).unlink(missing_ok=True)
    written = ["report.json", *figures]
    return written if report.design is None else ["design.json", "profile.csv", *written]
