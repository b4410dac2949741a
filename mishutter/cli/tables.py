"""Tables of a comparison on a terminal: the verdict, the rows, and the photograph."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from mishutter.cli.console import print_table, print_text

if TYPE_CHECKING:
    from mishutter.evaluation import ToleranceCosts
    from mishutter.hardware import Design
    from mishutter.model import DecoderSpeed
    from mishutter.report import Comparison, Report
    from mishutter.restore import RestoredPhotograph
    from mishutter.search import Row


def print_comparison(report: "Report") -> None:
    """Prints the verdict, its tables and the outcome of the search."""
    from mishutter.search import OWN_BEST_MOTION, fills

    comparison = report.comparison
    print_text(comparison.verdict)
    if report.measured is not None:
        print_text("\n".join(report.measured.lines()))
    print_text()
    for reading in dict.fromkeys(row.reading for row in comparison.rows):
        rows = [row for row in comparison.rows if row.reading == reading]
        cells = [_cells(comparison, row) for row in rows]
        columns = _columns(comparison)
        if reading == OWN_BEST_MOTION:
            print_table(reading.capitalize(), columns, [*cells, _ceiling(comparison, columns)])
            print_text(_level_notes(rows[0]) + _FOOT)
            if comparison.costs is not None:
                print_text("within dB  expected within the tolerances; gain dB compares these")
            print_text()
            _print_purchases(comparison)
            if comparison.costs is not None:
                _print_costs(comparison.costs)
        else:
            print_table(reading.capitalize(), columns, cells)
            print_table(f"Kernels, {reading}", _OF_KERNELS, [_kernel_cells(row) for row in rows])
            print_text(_condition_note(rows))
            full = [row.name for row in rows if fills(report.scene, row.motion, row.shutter)]
            if full:
                print_text(f"White fills a pixel on this motion: {', '.join(full)}.")
        print_text()
    if report.design is not None:
        print_text(f"{_design_line(report.design)}\n")


COLUMNS = (
    "shutter",
    "PSNR dB",
    "gain dB",
    "worst speed",
    "light",
    "stroke px",
    "pan px/s",
    "open ms",
)
"""Columns of a comparison's rows."""
_OF_DECODER = {
    "unknown": "PSNR dB      expected of one linear filter for all speeds\n",
    "found": "PSNR dB      expected of a decoder that finds the speed in the picture\n",
    "told": "PSNR dB      expected of a linear filter that is told the speed\n",
}
_AT_WORST = "PSNR dB      expected at the worst of the speeds, of one linear filter for all\n"
_WORST_OF_DECODER = {
    "unknown": "worst speed  PSNR dB at the worst of the speeds, of one linear filter for all\n",
    "found": "worst speed  PSNR dB of a decoder that finds the speed is known in the mean alone\n",
    "told": "worst speed  PSNR dB at the worst of the speeds, of a filter that is told it\n",
}
_GAIN = "gain dB      over the best snapshot, at rest or panned\n"
_FOOT = """\
PSNR         of linear light, white = 1
light        share that the shutter passes
stroke px    travel of the stage over the exposure, from end to end
pan px/s     velocity at mid-exposure
open ms      from first to last light
ceiling      nothing exceeds it"""
_OF_KERNELS = ("shutter", "condition", "kernel diff", "relative", "bound")


def _level_notes(row: "Row") -> str:
    """The meaning of the first three columns of numbers, which all rows share."""
    level = _AT_WORST if row.at_worst else _OF_DECODER[row.speed]
    return level + _GAIN + _WORST_OF_DECODER[row.speed]


def _columns(comparison: "Comparison") -> tuple[str, ...]:
    return COLUMNS if comparison.costs is None else (*COLUMNS, "within dB")


def _print_purchases(comparison: "Comparison") -> None:
    """Prints the best row of each purchase, and the notes at the foot of both tables."""
    rows = [
        [f"{purchase}: {name}", *numbers[:3], *numbers[4:]]
        for purchase, row in comparison.rivals.items()
        for name, *numbers in [_cells(comparison, row, comparison.over_nothing(row.level))]
    ]
    columns = ("purchase: its best", *_columns(comparison)[1:4], *_columns(comparison)[5:])
    print_table("The gain of each purchase over buying nothing", columns, rows)
    for line in comparison.notes:
        print_text(line)


def _print_costs(costs: "ToleranceCosts") -> None:
    """Prints the cost of each tolerance to the best design, and a sentence on the largest."""
    rows = [
        [row.name, row.size, f"{row.cost:.3f}", f"{row.unaware_cost:.3f}"] for row in costs.rows
    ]
    columns = ("tolerance", "1 sigma", "costs dB", "unaware dB")
    print_table("Cost of each tolerance to the best design", columns, rows)
    print_text(costs.verdict)
    print_text("unaware dB  cost by a decoder for a camera without errors")


def _ceiling(comparison: "Comparison", columns: "Sequence[str]") -> list[str]:
    gain = comparison.over_snapshot(comparison.ceiling)
    return ["ceiling", f"{comparison.ceiling:.2f}", f"{gain:+.2f}", *[""] * len(columns[3:])]


def _cells(comparison: "Comparison", row: "Row", gain: float | None = None) -> list[str]:
    """The cells of a row; the gain is over the best snapshot by default."""
    from mishutter.report import level_or_dash

    gain = comparison.over_snapshot(row.level) if gain is None else gain
    last = "" if row.within is None else f"{row.within:.2f}"
    return [
        row.name if row.num_frames == 1 else f"{row.name}, {row.num_frames} frames",
        f"{row.psnr:.2f}",
        f"{round(gain, 2) + 0.0:+.2f}",
        level_or_dash(row.worst_psnr),
        f"{float(row.metrics.efficiency):.3f}",
        f"{row.stroke:.1f}",
        f"{round(float(row.motion.velocity)) + 0:d}",
        f"{float(row.motion.exposure) * 1e3:.2f}",
        *([] if comparison.costs is None else [last]),
    ]


def _kernel_cells(row: "Row") -> list[str]:
    m = row.metrics
    return [
        row.name,
        f"{float(m.condition_number):.2f}",
        f"{float(m.kernel_difference):.4f}",
        f"{float(m.relative_kernel_difference):.3f}",
        f"{float(m.bound_share):.3f}",
    ]


def _condition_note(rows: "list[Row]") -> str:
    places: dict[str, list[str]] = {}
    for row in rows:
        place = f"phase {float(row.metrics.phase):g} px over {row.metrics.dft_length} DFT points"
        places.setdefault(place, []).append(row.name)
    most = max(places, key=lambda place: len(places[place]))
    others = [f", of {' and '.join(places[p])} at {p}" for p in places if p != most]
    return f"Condition at {most}{''.join(others)}."


def print_photographs(
    photographs: "Mapping[str, Mapping[str, RestoredPhotograph]]",
    decoder_speed: "DecoderSpeed" = "unknown",
) -> None:
    """Prints the PSNR of the scene's photograph as each design and decoder restored it."""
    knowing = {"unknown": "", "found": " at the speed found", "told": ", told the speed"}
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
        title = f"Photograph, restored by the {next(iter(photographs))} filter"
        title += knowing[decoder_speed]
    else:
        columns = photographs
        rows = [
            [name, *(f"{restored[name].mean_psnr:.2f}" for restored in photographs.values())]
            for name in results
        ]
        title = f"Photograph, restored at {speeds.size} speeds{knowing[decoder_speed]}"
    print_table(f"{title}: PSNR dB, linear light, own best motion", ["shutter", *columns], rows)
    if len(photographs) == 1:
        print_text(_OF_PHOTOGRAPH)


_OF_PHOTOGRAPH = (
    "exp.: expected of pictures with the detail and the mean level of this one inside its\n"
    "borders. Other tables: expected of the scene's mean spectrum, over all its speeds."
)


def _design_line(design: "Design") -> str:
    at_most = "" if design.motion.accelerates_constantly else "at most "
    return (
        f"{design.outcome}\n"
        f"Loss {design.loss:.6g} ({design.best_start_loss:.6g} at the best start, "
        f"{len(design.history)} in history), gradient {design.certificate:.1e}.\n"
        f"a = {at_most}{float(design.motion.greatest_acceleration) / 2:.6g} px/s^2, "
        f"v = {float(design.motion.velocity) + 0.0:.6g} px/s, "
        f"T = {float(design.motion.half_exposure) * 1e3:.4g} ms."
    )
