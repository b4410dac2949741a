"""Tables of a comparison on a terminal: the verdict, the rows, and the photograph."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from mishutter.cli.console import print_table, print_text

if TYPE_CHECKING:
    from mishutter.decoding.photographs import RestoredPhotograph
    from mishutter.model.decoder_speeds import DecoderSpeed
    from mishutter.report.documents import Report


def print_comparison(report: "Report", *, verbose: bool = False, next_step: str = "") -> None:
    """Prints the answer, and where it is `verbose` every table and the outcome of the search."""
    from mishutter.search.rows import SAME_MOTION
    from mishutter.search.space import fills

    comparison = report.comparison
    print_text(comparison.text())
    if report.measured is not None:
        print_text("\n".join(report.measured.lines()))
    if next_step:
        print_text(f"Next: {next_step}")
    if not verbose:
        return
    print_text("\n".join(["", *comparison.details, ""] if comparison.details else [""]))
    for table in comparison.tables:
        print_table(table.title, table.columns, table.rows)
        print_text("\n".join([*table.notes, ""]))
    same = [row for row in comparison.rows if row.reading == SAME_MOTION]
    full = [row.name for row in same if fills(report.scene, row.motion, row.shutter)]
    if full:
        print_text(f"White fills a pixel on this motion: {', '.join(full)}.\n")
    if report.design is not None:
        design = report.design
        at_most = "" if design.motion.accelerates_constantly else "at most "
        print_text(
            f"{design.ending}\n"
            f"Loss {design.loss:.6g} ({design.best_start_loss:.6g} at the best start), "
            f"gradient {design.certificate:.1e}.\n"
            f"Stage {at_most}{float(design.motion.greatest_acceleration):.6g} px/s^2, "
            f"v = {float(design.motion.velocity) + 0.0:.6g} px/s, "
            f"open for {float(design.motion.exposure) * 1e3:.4g} ms.\n"
        )


def print_photographs(
    photographs: "Mapping[str, Mapping[str, RestoredPhotograph]]",
    decoder_speed: "DecoderSpeed" = "unknown",
) -> None:
    """Prints the PSNR of the scene's photograph as each design and decoder restored it."""
    from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE

    aside = SPEED_KNOWLEDGE[decoder_speed].aside
    results = next(iter(photographs.values()))
    speeds = next(iter(results.values())).speeds
    if len(photographs) == 1:
        columns = {f"{speed:g} px/s": index for index, speed in enumerate(speeds)}
        rows = [
            [
                name,
                *(f"{result.linear_psnr[index]:.2f}" for index in columns.values()),
                *(f"{result.own_expected_psnr[index]:.2f}" for index in columns.values()),
            ]
            for name, result in results.items()
        ]
        columns |= {f"exp. {name.removesuffix(' px/s')}": index for name, index in columns.items()}
        title = f"Photograph, restored by the {next(iter(photographs))} filter{aside}"
    else:
        columns = photographs
        rows = [
            [name, *(f"{restored[name].mean_psnr:.2f}" for restored in photographs.values())]
            for name in results
        ]
        title = f"Photograph, restored at {speeds.size} speeds{aside}"
    print_table(f"{title}: PSNR dB, linear light, own best motion", ["shutter", *columns], rows)
    if len(photographs) == 1:
        print_text(
            "exp.: expected for pictures with the detail and the mean level of this one inside "
            "its\nborders. Other tables: expected for the scene's mean spectrum, over all its "
            "speeds."
        )
