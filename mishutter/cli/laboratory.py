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
        help="Drive table, in any format of `export`; the design supplies what the file lacks.",
    ),
]
MeasuredOption = Annotated[
    Path | None,
    typer.Option(
        "--measured",
        metavar="FILE",
        rich_help_panel=CAMERA,
        parser=as_path,
        help="Photodiode trace that replaces the shutter: text, as an oscilloscope exports it.",
    ),
]
ColumnOption = Annotated[
    str | None,
    typer.Option(
        "--measured-column",
        metavar="NAME",
        rich_help_panel=CAMERA,
        help="Column of the trace that holds levels [default: the only one, or `level`].",
    ),
]
HalfExposureOption = Annotated[
    float | None,
    typer.Option(
        "--half-exposure-ms",
        metavar="MS",
        rich_help_panel=CAMERA,
        help="Half exposure of a table without times [default: the design's or the scene's].",
    ),
]
PositionScaleOption = Annotated[
    float | None,
    typer.Option(
        "--position-scale-px",
        metavar="PX",
        rich_help_panel=CAMERA,
        help="Position in px that 1 stands for, in a table with positions in [-1, 1].",
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
        help="Number of steps of the exposure, for a Rigol file that is padded with zeros.",
    ),
]
MiddleOption = Annotated[
    float,
    typer.Option(
        "--mid-exposure-ms",
        metavar="MS",
        rich_help_panel=CAMERA,
        help="Time of mid-exposure on the clock of the trace.",
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
        help="Level of the trace where the shutter is open; below --closed-level if the "
        "photodiode is inverted [default: the extreme of its fit].",
    ),
]


class CameraFiles(NamedTuple):
    """Files of one camera, and the numbers that these files lack.

    Attributes:
        design: Saved design.
        drive: Drive table.
        measured: Trace.
        half_exposure_ms: Half exposure of a table without times.
        position_scale_px: Position that 1 stands for, in a table with positions in [-1, 1].
        floor: Transmittance of the lowest level.
        ceiling: Transmittance of the highest level.
        num_steps: Steps of the exposure, for a file that is padded with zeros.
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


def cameras(scene: "Scene", files: CameraFiles) -> "dict[str, Design]":
    """The camera as designed, as driven and as measured, for each of which there is a file."""
    from mishutter.evaluation import transmittance
    from mishutter.hardware import GIVEN, Design

    _require_table(files)
    designs: dict[str, Design] = {}
    motion = scene.motion
    if files.design is not None:
        saved = Design.load(files.design)
        motion = saved.motion
        profile = transmittance(scene, motion, saved.command)
        designs[AS_DESIGNED] = replace(saved, scene=scene, shutter=profile, loss_name=GIVEN)
    half_exposure = None if files.half_exposure_ms is None else files.half_exposure_ms * 1e-3
    if files.drive is not None:
        driven = Design.from_drive(
            files.drive,
            scene,
            motion,
            half_exposure=half_exposure,
            position_scale=files.position_scale_px,
            floor=files.floor,
            ceiling=files.ceiling,
            num_steps=files.num_steps,
        )
        motion = driven.motion
        designs[AS_DRIVEN] = driven
    if files.measured is not None:
        designs[AS_MEASURED] = _measured(scene, motion, files, files.measured)
    return designs


def _require_table(files: CameraFiles) -> None:
    """Raises `ValueError` if there are numbers of a drive table but no table."""
    numbers = {
        "--half-exposure-ms": files.half_exposure_ms,
        "--position-scale-px": files.position_scale_px,
        "--drive-steps": files.num_steps,
    }
    requirement = (
        "stand beside --drive: a trace is as long as the design's exposure, or the scene's"
    )
    for name, value in numbers.items():
        require(files.drive is not None or value is None, name, requirement, value)


def _measured(scene: "Scene", motion: "AbstractMotion", files: CameraFiles, path: Path) -> "Design":
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
