"""The command that hands a design to the electronics: `export`."""

import math
import sys
from collections.abc import Mapping
from enum import Enum
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mishutter._core.checks import Unquoted, require, three_digits
from mishutter._core.files import writable_folder, write_text
from mishutter._core.progress import note, working
from mishutter.cli.console import print_table, start_jax, write_json
from mishutter.cli.help import TABLE
from mishutter.cli.laboratory import CeilingOption, FloorOption
from mishutter.cli.options import JsonOption, OutOption, as_design, option

if TYPE_CHECKING:
    from mishutter.design.design import Design
    from mishutter.hardware.drive import DriveTable
    from mishutter.hardware.triggers import FrameTable


class FormatName(Enum):
    """The formats of `--format`."""

    CSV = "csv"
    COLUMN = "column"
    KEYSIGHT = "keysight"
    RIGOL = "rigol"
    SIGLENT = "siglent"
    NPY = "npy"
    PULSES = "pulses"


_BY_CONTENT = {
    FormatName.CSV: "",
    FormatName.COLUMN: "the exposure and the levels' transmittances",
    FormatName.KEYSIGHT: "the scale of positions and the levels' transmittances",
    FormatName.RIGOL: "the exposure and the levels' transmittances",
    FormatName.SIGLENT: "the levels' transmittances",
    FormatName.NPY: "the exposure, the scale of positions and the levels' transmittances",
    FormatName.PULSES: "the exposure",
}
"""Numbers that a file of each format does not hold, and that its reader needs."""
_TO_LIMIT = "set max_acceleration_g or max_acceleration_px_per_s2 in [limits] of the scene"


def export(
    design: Annotated[
        Path, typer.Argument(metavar="DESIGN.json", parser=as_design, help="Saved design.")
    ],
    *,
    out: OutOption = None,
    json: JsonOption = False,
    num_steps: Annotated[
        int | None,
        option(
            TABLE,
            "--steps N",
            "Number of equal steps of the exposure [default: the device's slots, or 256].",
            min=1,
            max=100_000,
        ),
    ] = None,
    num_levels: Annotated[
        int | None,
        option(
            TABLE,
            "--levels N",
            "Number of drive levels [default: 2 with --format pulses, otherwise the "
            "device's, or 256].",
            min=2,
            max=1 << 24,
        ),
    ] = None,
    floor: FloorOption = 0.0,
    ceiling: CeilingOption = 1.0,
    form: Annotated[
        FormatName,
        option(
            TABLE,
            "--format NAME",
            "csv: names, units, one row per step. column: one column from -1 to 1. keysight: "
            "CSV of shutter, position and gate. rigol: .RAF. siglent: CSV for EasyWave. npy: "
            "array of (channels, samples). pulses: closed and open time of each pulse, us.",
        ),
    ] = FormatName.CSV,
    returns: Annotated[
        bool,
        option(
            TABLE,
            "--return",
            "Let stage.csv end where it begins, for exposures that are repeated.",
        ),
    ] = False,
) -> None:
    """Write the drive table of a saved design: one level per step, and its effect on the level.

    For a burst the table is open in each frame and closed between frames. --out also writes the
    path of the stage, from rest to rest, and the triggers of a burst.
    """
    pulses = form is FormatName.PULSES
    levels = 2 if pulses and num_levels is None else num_levels
    if pulses and (levels, floor, ceiling) != (2, 0.0, 1.0):
        got = f"{levels} levels from {floor:g} to {ceiling:g}"
        raise ValueError(f"`--format pulses` must have 2 levels from 0 to 1; got {got}.")
    if form in (FormatName.RIGOL, FormatName.NPY) and out is None and not json:
        raise ValueError(f"`--out` must be given for a binary file; got --format {form.value}.")
    start_jax()
    from mishutter.design.design import Design
    from mishutter.hardware.drive import drive_table

    saved = Design.load(design)
    folder = None if out is None else writable_folder(out)
    if saved.sequence is None:
        table = drive_table(
            saved,
            num_steps=num_steps,
            num_levels=levels,
            floor=floor,
            ceiling=ceiling,
            carries_error=pulses,
        )
        files = [] if folder is None else _write(table, folder, form, returns=returns)
        if _BY_CONTENT[form]:
            exposure, scale = float(saved.motion.half_exposure) * 2e3, table.position_scale
            numbers = f"{exposure!r} ms, 1 is {scale!r} px, levels from {floor:g} to {ceiling:g}"
            note(f"not in the file: {_BY_CONTENT[form]} ({numbers})")
        _note_what_to_set(table, form)
    else:
        unset = {"--levels": num_levels is None, "--floor": floor == 0, "--ceiling": ceiling == 1}
        table = _frames(saved, unset, num_steps, form)
        files = [] if folder is None else _write(table, folder, form, returns=returns)
    _note_motion_at_ends(table, form)
    _deliver(table, files, folder, form, as_json=json)


def _frames(
    design: "Design", unset: Mapping[str, bool], num_steps: int | None, form: FormatName
) -> "FrameTable":
    """The triggers of a burst, for which some options must have their defaults."""
    from mishutter.hardware.drive_files import WITH_POSITIONS
    from mishutter.hardware.triggers import frame_table

    for name, is_default in unset.items():
        requirement = "be left out for a burst, whose shutter is open or closed"
        require(is_default, name, requirement, Unquoted("an option"))
    table = frame_table(design, num_steps=num_steps)
    if len(table.paths) == 2 and form.value not in WITH_POSITIONS:
        note(
            f"--format {form.value} has no channels for a stage: it holds the triggers alone, and "
            "stage.csv of --out both axes"
        )
    return table


def _deliver(
    table: "DriveTable | FrameTable",
    files: list[str],
    folder: Path | None,
    form: FormatName,
    *,
    as_json: bool,
) -> None:
    """Prints a table where no folder holds it, or what it does to the level."""
    from mishutter.hardware.drive_files import drive_bytes
    from mishutter.hardware.triggers import FrameTable

    if folder is None and not as_json:
        sys.stdout.write(drive_bytes(table, form.value).decode())
        return
    if isinstance(table, FrameTable):
        if table.lead:
            note(
                "a trigger begins the exposure of the row that is read first: the middle one comes "
                f"{table.lead * 1e3:.4g} ms later, and the last {table.lead * 2e3:.4g} ms"
            )
        step = table.step
        touching = sum(after - before < step for (_, before), (after, _) in pairwise(table.lights))
        if touching:
            which = "1 frame, which" if touching == 1 else f"{touching} frames, which"
            note(
                f"the gate closes for one step of {step * 1e3:.3g} ms at the end of {which} the "
                "next one follows at once: a camera that exposes while its trigger is high has "
                f"{table.gated_psnr:.2f} dB in place of {table.exposures.psnr:.2f}; frames.csv has "
                "the exact times, for a camera that times its exposures itself"
            )
    with working("measuring the shutter as driven"):
        document = table.to_dict() | {"files": files}
    if as_json:
        write_json(document)
    elif isinstance(table, FrameTable):
        _print_frames(table)
    else:
        _print_losses(document)
    if files:
        note(f"{folder}: {', '.join(files)}")


def _note_motion_at_ends(table: "DriveTable | FrameTable", form: FormatName) -> None:
    """Notes that samples of a stage hold no run-up, where it moves at the first or last light."""
    import numpy as np

    if form not in (FormatName.KEYSIGHT, FormatName.NPY):
        return
    ends = table.begin[0] + np.array([0.0, table.exposure])
    speeds = np.array([path.at(ends)[1] for path in table.paths.values()])
    if np.any(abs(speeds) > 1):
        first, last = (", ".join(f"{speed:,.0f}" for speed in each) for each in speeds.T)
        note(
            f"--format {form.value} has no run-up: its places begin at {first} px/s and end at "
            f"{last} px/s; stage.csv of --out goes from rest to rest"
        )


def _note_ends(table: "DriveTable | FrameTable", *, returns: bool) -> None:
    """Notes where each axis of a stage ends that does not end where it begins."""
    from mishutter.hardware.stage_files import ways_of, with_way_back

    ways = ways_of(table.paths)
    if max(map(abs, ways.values())) < 0.005:
        return
    names = {"": "the stage"} if len(ways) == 1 else {end: end.strip("_") for end in ways}
    words = ", ".join(f"{names[end]} {round(way, 2) + 0.0:+.2f} px" for end, way in ways.items())
    if returns:
        (path, *_), limits = table.paths.values(), table.design.scene.limits
        (back, *_) = with_way_back(table.paths, limits).values()
        then = f"goes back in {1e3 * (back.times[-1] - path.times[-1]):.3g} ms"
    else:
        then = "--return adds the way back"
    note(f"stage.csv comes to rest away from where it begins: {words}; {then}")


def _write(
    table: "DriveTable | FrameTable", folder: Path, form: FormatName, *, returns: bool
) -> list[str]:
    """Writes a table, its triggers, its picture and the path of its stage; returns their names."""
    from mishutter.hardware.drive_files import DRIVE_FORMATS
    from mishutter.hardware.triggers import FrameTable
    from mishutter.report.plots import plot_drive, plot_frames, save_figure

    files = [f"drive{DRIVE_FORMATS[form.value]}"]
    table.save(folder / files[0], form=form.value)
    if isinstance(table, FrameTable):
        write_text(folder / "frames.csv", table.frames_csv())
        save_figure(plot_frames(table), folder / "drive.png")
        files += ["frames.csv", "drive.png"]
    else:
        save_figure(plot_drive(table), folder / "drive.png")
        files += ["drive.png"]
    if table.exposures.turning:
        note(f"{table.exposures.turning} meanwhile, which no file here makes it do")
    path = table.stage_csv(returns=returns)
    if path is not None:
        write_text(folder / "stage.csv", path)
        _note_ends(table, returns=returns)
        beyond = table.travel_beyond_limit
        if beyond is not None:
            note(
                f"stage.csv travels {beyond:.4g} px, beyond the limit on travel: limit the "
                "acceleration too, or the search assumes a run-up without travel"
            )
        return [*files, "stage.csv"]
    if not isinstance(table, FrameTable):
        note(f"no stage.csv: {_without_path(table.design)}")
    elif table.exposures.moves:
        note(f"no stage.csv: no limit sets the run-up of the stage to its velocity: {_TO_LIMIT}")
    return files


def _print_frames(table: "FrameTable") -> None:
    """Prints when frames are exposed, and where the sensor or its stage is then."""
    taken = table.exposures
    # A tenth of the shortest exposure is shown.
    decimals = max(2, 1 - math.floor(math.log10(1e3 * min(taken.exposures))))
    rows = [
        [
            str(k),
            f"{time * 1e3:.{decimals}f}",
            three_digits(exposure * 1e3),
            *(f"{x:.2f}" for x in places),
        ]
        for k, (time, exposure, *places) in enumerate(
            zip(taken.times, taken.exposures, *table.places.values(), strict=True), 1
        )
    ]
    columns = ["frame", "mid-exposure / ms", "exposure / ms", *table.places]
    print_table(f"Frames: {taken.text}", columns, rows)


def _note_what_to_set(table: "DriveTable", form: FormatName) -> None:
    """Notes the settings that no file holds: the sample rate, and the level before the exposure."""
    if table.is_open:
        note("the shutter stays open for the whole exposure and needs no drive")
        return
    count, exposure = table.level.size, table.exposure
    if form in (FormatName.COLUMN, FormatName.RIGOL, FormatName.NPY):  # files without times
        note(
            f"set the generator to {count / exposure:,.6g} samples a second: {count} samples in "
            f"{exposure * 1e3:.5g} ms, or {1 / exposure:.5g} repetitions a second"
        )
    if table.settling_time > 0:
        note(
            f"set the shutter to level {table.level[0]} at least "
            f"{table.settling_time * 1e3:.3g} ms before the exposure: the design assumes that it "
            "has settled there"
        )


def _without_path(design: "Design") -> str:
    """The reason for which a design has no path of the stage, in words."""
    velocity = float(design.motion.velocity)
    if velocity == 0 or design.scene.limits.pans == "camera":
        return "the stage stays at rest"
    return f"the stage pans at {velocity:g} px/s, and no limit sets its run-up: {_TO_LIMIT}"


def _print_losses(document: Mapping[str, Any]) -> None:
    """Prints the metrics of a design beside those of its drive table."""
    from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE

    aside = SPEED_KNOWLEDGE[document["decoder_speed"]].aside
    columns = {"design": "metrics_of_design", "as driven": "metrics"}
    if "metrics_of_blind_stage" in document:
        columns["stage sent its path"] = "metrics_of_blind_stage"
    rows = [
        [name, *(f"{document[key][field]:.4g}" for key in columns.values())]
        for name, field in (
            (f"expected PSNR{aside} / dB", "psnr_of_decoder"),
            ("condition number", "condition_number"),
            ("relative kernel difference", "relative_kernel_difference"),
            ("efficiency", "efficiency"),
        )
    ]
    title = f"{len(document['level'])} steps, {document['num_levels']} levels"
    print_table(title, ["figure", *columns], rows)
