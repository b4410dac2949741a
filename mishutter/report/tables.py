"""A comparison for people and programs: tables, one document, pictures in a folder."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mishutter._core import strict_json, write_text
from mishutter.cli.console import print_table, print_text
from mishutter.design import BEST_SNAPSHOT, BEST_TUKEY, OWN_BEST_MOTION, Comparison, Design, Row
from mishutter.model import (
    Scene,
)
from mishutter.report.photographs import ENSEMBLE, Photographs
from mishutter.restore import RestoredPhotograph


@dataclass(frozen=True)
class Report:
    """A comparison and what the photograph showed of it.

    Attributes:
        scene: What was photographed.
        comparison: The shutters side by side.
        names: The given shutters among them.
        photographs: What the photograph showed of each on its own best motion; None for none.
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


def print_report(report: Report) -> None:
    """The comparison, the photograph's table and the verdict, on standard output."""
    comparison = report.comparison
    snapshot = float(comparison.row(BEST_SNAPSHOT).metrics.expected_psnr)
    for reading in dict.fromkeys(row.reading for row in comparison.rows):
        rows = [row for row in comparison.rows if row.reading == reading]
        cells = [_cells(row, snapshot) for row in rows]
        num_columns = len(_COLUMNS) - all(row.loss is None for row in rows)
        cut = [row[:num_columns] for row in cells]
        print_table(reading.capitalize(), _COLUMNS[:num_columns], cut)
        print_text(_condition_note(rows))
        print_text()
    if report.photographs is not None:
        _print_photographs(report.photographs.levels)
    if report.design is not None:
        print_text(_design_line(report.design))
    print_text(comparison.verdict)


_COLUMNS = (
    "shutter",
    "PSNR dB",
    "snapshot +dB",
    "condition",
    "kernel diff",
    "relative",
    "light",
    "bound",
    "stroke px",
    "open ms",
    "loss",
)


def _cells(row: Row, snapshot: float) -> list[str]:
    m = row.metrics
    level = float(m.expected_psnr)
    return [
        row.name,
        f"{level:.2f}",
        f"{0.0 if level == snapshot else level - snapshot:+.2f}",
        f"{float(m.condition_number):.2f}",
        f"{float(m.kernel_difference):.4f}",
        f"{float(m.relative_kernel_difference):.3f}",
        f"{float(m.efficiency):.3f}",
        f"{float(m.bound_share):.3f}",
        f"{float(row.motion.stroke):.1f}",
        f"{float(row.motion.exposure) * 1e3:.2f}",
        "" if row.loss is None else f"{row.loss:.4f}",
    ]


def _condition_note(rows: list[Row]) -> str:
    places: dict[str, list[str]] = {}
    for row in rows:
        place = f"phase {row.metrics.phase:g} px over {row.metrics.dft_length} DFT points"
        places.setdefault(place, []).append(row.name)
    most = max(places, key=lambda place: len(places[place]))
    others = [f", of {' and '.join(places[p])} at {p}" for p in places if p != most]
    condition = f"condition at {most}{''.join(others)}"
    return f"PSNR expected of the best single linear filter; {condition}."


def _print_photographs(
    photographs: Mapping[str, Mapping[str, RestoredPhotograph]],
) -> None:
    names = list(next(iter(photographs.values())))
    rows = [
        [name, *(f"{results[name].mean_psnr:.2f}" for results in photographs.values())]
        for name in names
    ]
    title = "Photograph, restored at every speed: PSNR dB, linear light, own best motion"
    print_table(title, ["shutter", *photographs], rows)
    print_text()


def _design_line(design: Design) -> str:
    return (
        f"{design.outcome} Loss {design.loss:.6g} ({design.best_start_loss:.6g} at the best "
        f"start, {len(design.history)} in its history), projected gradient "
        f"{design.certificate:.1e}; a = {float(design.motion.acceleration):.6g} px/s^2, "
        f"T = {float(design.motion.half_exposure) * 1e3:.4g} ms."
    )


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
    speeds = plots.shown_speeds(report.scene.speeds)
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
