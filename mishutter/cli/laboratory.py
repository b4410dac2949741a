"""Options of files that come back from a laboratory: drive tables and photodiodes' traces."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from mishutter._core import require
from mishutter.cli.console import note
from mishutter.cli.help import CAMERA
from mishutter.cli.options import as_path

if TYPE_CHECKING:
    from mishutter.hardware import Design
    from mishutter.model import AbstractMotion, Scene

AS_DESIGNED = "as designed"
AS_DRIVEN = "as driven"
AS_MEASURED = "as measured"

DriveOption = Annotated[
    Path | None,
    typer.Option(
        "--drive",
        metavar="FILE",
        rich_help_panel=CAMERA,
        parser=as_path,
        help="Drive table, in any format of `export`; what it does not hold is the design's.",
    ),
]
MeasuredOption = Annotated[
    Path | None,
    typer.Option(
        "--measured",
        metavar="FILE",
        rich_help_panel=CAMERA,
        parser=as_path,
        help="Photodiode's trace in place of the shutter: text, as an oscilloscope exports it.",
    ),
]
ColumnOption = Annotated[
    str | None,
    typer.Option(
        "--measured-column",
        metavar="NAME",
        rich_help_panel=CAMERA,
        help="Column of levels of the trace [default: the only one, or that named level].",
    ),
]
HalfExposureOption = Annotated[
    float | None,
    typer.Option(
        "--half-exposure-ms",
        metavar="MS",
        rich_help_panel=CAMERA,
        help="Half exposure of a table without time [default: the design's or the scene's].",
    ),
]
PositionScaleOption = Annotated[
    float | None,
    typer.Option(
        "--position-scale-px",
        metavar="PX",
        rich_help_panel=CAMERA,
        help="Position at 1, of a table with positions in [-1, 1].",
    ),
]
FloorOption = Annotated[
    float,
    typer.Option(
        "--floor",
        metavar="SHARE",
        rich_help_panel=CAMERA,
        help="Transmittance of the lowest level.",
    ),
]
CeilingOption = Annotated[
    float,
    typer.Option(
        "--ceiling",
        metavar="SHARE",
        rich_help_panel=CAMERA,
        help="Transmittance of the highest level.",
    ),
]
StepsOption = Annotated[
    int | None,
    typer.Option(
        "--drive-steps",
        metavar="N",
        rich_help_panel=CAMERA,
        min=1,
        help="Steps of the exposure, of a Rigol file that a generator has filled up with zeros.",
    ),
]
MiddleOption = Annotated[
    float,
    typer.Option(
        "--mid-exposure-ms",
        metavar="MS",
        rich_help_panel=CAMERA,
        help="Mid-exposure on the clock of the trace.",
    ),
]
ClosedOption = Annotated[
    float | None,
    typer.Option(
        "--closed-level",
        metavar="LEVEL",
        rich_help_panel=CAMERA,
        help="Level of the trace where the shutter is closed [default: the mean outside the "
        "exposure].",
    ),
]
OpenOption = Annotated[
    float | None,
    typer.Option(
        "--open-level",
        metavar="LEVEL",
        rich_help_panel=CAMERA,
        help="Level of the trace where the shutter is open, below --closed-level by an inverted "
        "photodiode [default: the extreme of its fit].",
    ),
]


class Files(NamedTuple):
    """Files of one camera, and what their readers were told.

    Attributes:
        design: Saved design.
        drive: Drive table.
        measured: Trace.
        half_exposure_ms: Of a table without time.
        position_scale_px: Of positions in [-1, 1].
        floor: Transmittance of the lowest level.
        ceiling: Transmittance of the highest level.
        num_steps: Steps of the exposure, of a file that is filled up.
        middle_ms: Mid-exposure on the clock of the trace.
        closed: Level of the trace where the shutter is closed.
        opened: Level of the trace where the shutter is open.
        column: Name of the trace's column of levels.
    """

    design: Path | None
    drive: Path | None
    measured: Path | None
    half_exposure_ms: float | None
    position_scale_px: float | None
    floor: float
    ceiling: float
    num_steps: int | None
    middle_ms: float
    closed: float | None
    opened: float | None
    column: str | None

    @property
    def is_from_laboratory(self) -> bool:
        """Whether there is anything but a design."""
        return self.drive is not None or self.measured is not None


def cameras(scene: "Scene", files: Files) -> "dict[str, Design]":
    """The camera as designed, as driven and as measured, as far as there is a file of each."""
    from mishutter.hardware import GIVEN, Design

    _require_table(files)
    found: dict[str, Design] = {}
    motion = scene.motion
    if files.design is not None:
        saved = Design.load(files.design)
        motion = saved.motion
        light = scene.light(saved.command, motion)
        found[AS_DESIGNED] = replace(saved, scene=scene, shutter=light, loss_name=GIVEN)
    told = None if files.half_exposure_ms is None else files.half_exposure_ms * 1e-3
    if files.drive is not None:
        driven = Design.from_drive(
            files.drive,
            scene,
            motion,
            half_exposure=told,
            position_scale=files.position_scale_px,
            floor=files.floor,
            ceiling=files.ceiling,
            num_steps=files.num_steps,
        )
        motion = driven.motion
        found[AS_DRIVEN] = driven
    if files.measured is not None:
        found[AS_MEASURED] = _measured(scene, motion, files, files.measured)
    return found


def _require_table(files: Files) -> None:
    """Refuse what is told of a drive table where there is none."""
    told = {
        "--half-exposure-ms": files.half_exposure_ms,
        "--position-scale-px": files.position_scale_px,
        "--drive-steps": files.num_steps,
    }
    requirement = (
        "stand beside --drive: a trace is as long as the design's exposure, or the scene's"
    )
    for name, value in told.items():
        require(files.drive is not None or value is None, name, requirement, value)


def _measured(scene: "Scene", motion: "AbstractMotion", files: Files, path: Path) -> "Design":
    from mishutter.hardware import given_design, measured_profile, read_trace

    profile = measured_profile(
        read_trace(path, column=files.column),
        half_exposure=float(motion.half_exposure),
        middle=files.middle_ms * 1e-3,
        closed=files.closed,
        opened=files.opened,
        name=str(path),
    )
    for sentence in profile.notes:
        note(f"{path}: {sentence}")
    outcome = f"Measured by {path.name}."
    return given_design(scene, motion, profile.shutter, outcome, is_measured=True)
