"""Options of files that come back from a laboratory: drive tables and photodiodes' traces."""

import functools
import inspect
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from mishutter._core.checks import Unquoted, require
from mishutter._core.progress import note
from mishutter.cli.help import CAMERA
from mishutter.cli.options import option, path_option, scene_of

if TYPE_CHECKING:
    from mishutter.design.design import Design
    from mishutter.hardware.traces import MeasuredProfile, Trace
    from mishutter.model.motion import AbstractMotion
    from mishutter.model.scene import Scene

AS_DESIGNED = "as designed"
AS_DRIVEN = "as driven"
AS_MEASURED = "as measured"

FloorOption = Annotated[
    float, option(CAMERA, "--floor SHARE", "Transmittance of the lowest level.")
]
CeilingOption = Annotated[
    float, option(CAMERA, "--ceiling SHARE", "Transmittance of the highest level.")
]


class CameraFiles(NamedTuple):
    """Files of one camera beside its design, and the numbers that these files lack."""

    drive: Annotated[
        Path | None,
        path_option(
            CAMERA,
            "--drive FILE",
            "Drive table, csv or npy of `export`; the design supplies what the file lacks.",
        ),
    ] = None
    measured: Annotated[
        Path | None,
        path_option(
            CAMERA,
            "--measured FILE",
            "Photodiode trace that replaces the shutter: text, as exported by an oscilloscope.",
        ),
    ] = None
    column: Annotated[
        str | None,
        option(
            CAMERA,
            "--measured-column NAME",
            "Column of the trace that holds levels [default: the only one, or `level`].",
        ),
    ] = None
    exposure_ms: Annotated[
        float | None,
        option(
            CAMERA,
            "--exposure-ms MS",
            "Exposure of a drive table without times [default: the design's or the scene's].",
        ),
    ] = None
    half_exposure_ms: Annotated[
        float | None,
        option(CAMERA, "--half-exposure-ms MS", "Half of this, of version 0.2.", hidden=True),
    ] = None
    position_scale_px: Annotated[
        float | None,
        option(
            CAMERA,
            "--position-scale-px PX",
            "Displacement in px that 1 stands for, in a drive table whose positions are in "
            "[-1, 1].",
        ),
    ] = None
    floor: FloorOption = 0.0
    ceiling: CeilingOption = 1.0
    middle_ms: Annotated[
        float,
        option(
            CAMERA, "--mid-exposure-ms MS", "Reading of the oscilloscope's clock at mid-exposure."
        ),
    ] = 0.0
    closed: Annotated[
        float | None,
        option(
            CAMERA,
            "--closed-level LEVEL",
            "Level of the trace where the shutter is closed [default: the mean outside the "
            "exposure].",
        ),
    ] = None
    opened: Annotated[
        float | None,
        option(
            CAMERA,
            "--open-level LEVEL",
            "Level of the trace where the shutter is open; below --closed-level if the "
            "photodiode is inverted [default: the extreme of its fit].",
        ),
    ] = None

    @property
    def half_exposure(self) -> float | None:
        """Half of the exposure that a drive table lacks, by whichever option says it; s."""
        whole, half = self.exposure_ms, self.half_exposure_ms
        is_alone = whole is None or half is None
        require(is_alone, "--half-exposure-ms", "not stand beside --exposure-ms", half)
        for name, value in (("--exposure-ms", whole), ("--half-exposure-ms", half)):
            require(value is None or value > 0, name, "be above 0", value)
        return whole * 5e-4 if whole is not None else half and half * 1e-3

    def require_table(self) -> None:
        """Raises `ValueError` if there are numbers of a drive table but no table."""
        numbers = {
            "--exposure-ms": self.exposure_ms,
            "--half-exposure-ms": self.half_exposure_ms,
            "--position-scale-px": self.position_scale_px,
        }
        requirement = (
            "stand beside --drive: a trace is as long as the design's exposure, or the scene's"
        )
        for name, value in numbers.items():
            require(self.drive is not None or value is None, name, requirement, value)

    def trace_and_profile(
        self, motion: "AbstractMotion", path: Path
    ) -> "tuple[Trace, MeasuredProfile]":
        """A trace and the profile that it shows; every oddity is noted on standard error."""
        from mishutter.hardware.trace_files import read_trace
        from mishutter.hardware.traces import measured_profile

        trace = read_trace(path, column=self.column)
        profile = measured_profile(
            trace,
            half_exposure=float(motion.half_exposure),
            middle=self.middle_ms * 1e-3,
            closed=self.closed,
            opened=self.opened,
            name=str(path),
        )
        for sentence in profile.notes:
            note(f"{path}: {sentence}")
        return trace, profile


def takes_camera_files(command: Callable[..., None]) -> Callable[..., None]:
    """Gives a command the options of `CameraFiles`, which reach it as its argument `files`.

    Typer reads the options of a command from its signature, where those of the files take the
    place of `files`.
    """
    own = inspect.signature(command)
    options = [
        option.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for option in inspect.signature(CameraFiles).parameters.values()
    ]
    names = [option.name for option in options]

    @functools.wraps(command)
    def with_files(*args: object, **kwargs: Any) -> None:
        files = CameraFiles(**{name: kwargs.pop(name) for name in names})
        command(*args, files=files, **kwargs)

    every = [[each] if each.name != "files" else options for each in own.parameters.values()]
    parameters = [each for group in every for each in group]
    with_files.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]
    return with_files


class Cameras(NamedTuple):
    """One camera as its files describe it."""

    # The camera as designed, as driven and as measured, each only if it has a file
    designs: "dict[str, Design]"
    trace: "Trace | None" = None  # The trace of the camera as measured; None without one
    # The profile that the trace shows; None without a trace
    profile: "MeasuredProfile | None" = None


def speed_for(camera: "Design", text: str, scene_file: Path | None) -> float | tuple[float, float]:
    """The speed of what a camera sees, or its velocity where that sees two axes; px/s."""
    from mishutter.model.scene_file import read_speed, read_velocity

    read = read_speed if len(camera.exposures.axes) == 1 else read_velocity
    return read(text, scene_file, "--speed")


def warn_beyond(scene: "Scene", speed: float | tuple[float, float]) -> None:
    """Warns of a speed in px/s outside the scene's range: its unit may have been forgotten."""
    if isinstance(speed, tuple):
        size, fastest = math.hypot(*speed), float(scene.max_speed)
        if size > fastest:
            note(
                f"warning: --speed is {size:,.5g} px/s in all; the scene's go up to {fastest:,.5g} "
                "px/s. Is its unit missing, as in 0.9m/s,0.2m/s?"
            )
        return
    slowest, fastest = float(scene.speeds.min()), float(scene.speeds.max())
    # 0 is the default, and a picture at rest.
    if speed != 0 and not slowest <= speed <= fastest:
        note(
            f"warning: --speed is {speed:g} px/s; the scene's are {slowest:g} to {fastest:g} px/s. "
            "Is its unit missing, as in 0.9m/s?"
        )


def note_other_device(path: Path, design: "Design", scene: "Scene") -> None:
    """Notes that a scene's device replaces the device that a design was made for."""
    import equinox as eqx

    from mishutter.report.verdict import device_notes

    if eqx.tree_equal(design.scene.device, scene.device):
        return
    ideal = ["It follows at once and loses no light."]
    own, taken = (" ".join(device_notes(each.device) or ideal) for each in (design.scene, scene))
    note(f"{path}: using the scene's shutter, not the design's. Design: {own} Scene: {taken}")


def _require_alike(scene: "Scene | None", design: Path | None, *, in_plane: bool) -> None:
    """Refuse a design along one axis for things in any direction, and the other way round."""
    if scene is None or design is None:
        return
    ways, moves = {False: "along one axis", True: "in any direction"}, scene.velocities is not None
    requirement = f"be for things that move {ways[moves]}, as those of the scene do"
    got = Unquoted(f"{design.name!r}, for things {ways[in_plane]}")
    require(in_plane == moves, "--design", requirement, got)


def cameras(
    scene: "Scene | None",
    design: Path | None,
    files: CameraFiles,
    *,
    window: str | None = None,
    of_example: bool = False,
) -> Cameras:
    """The camera as designed, as driven and as measured, each only if it has a file.

    Without any of these it has a window of some name. Without a scene it is the design's, and of an
    example without a design the built-in one.
    """
    from mishutter.design.design import GIVEN, Design, given_design
    from mishutter.evaluation.views import transmittance
    from mishutter.hardware.drive import design_from_drive
    from mishutter.model.shutters.kinds import named_shutter

    files.require_table()
    saved = None if design is None else Design.load(design)
    if scene is None and saved is not None:
        scene = saved.scene
    elif scene is None and of_example:
        scene = scene_of(None)
    in_plane = saved is not None and saved.scene.velocities is not None
    _require_alike(scene, design, in_plane=in_plane)
    if saved is not None and saved.one is None:
        for name, path in (("--drive", files.drive), ("--measured", files.measured)):
            requirement = "be left out for a design of frames alone: its table is of one exposure"
            require(path is None, name, requirement, str(path))
        return Cameras({AS_DESIGNED: replace(saved, scene=scene)})
    designs: dict[str, Design] = {}
    motion = None
    if design is not None and saved is not None and scene is not None:
        note_other_device(design, saved, scene)
        motion = saved.motion
        profile = transmittance(scene, motion, saved.command)
        taken = replace(saved, scene=scene)
        designs[AS_DESIGNED] = taken.with_one(shutter=profile, loss_name=GIVEN)
    if scene is None:
        raise ValueError("`--design or --scene` must be given; got None.")
    motion = scene.motion if motion is None else motion
    if files.drive is not None:
        driven = design_from_drive(
            files.drive,
            scene,
            motion,
            half_exposure=files.half_exposure,
            position_scale=files.position_scale_px,
            floor=files.floor,
            ceiling=files.ceiling,
        )
        motion = driven.motion
        designs[AS_DRIVEN] = driven
    if files.measured is None and not designs and window is not None:
        origin = f"Given: {window}."
        designs[window] = given_design(scene, motion, named_shutter(window), origin)
    if files.measured is None:
        return Cameras(designs)
    trace, profile = files.trace_and_profile(motion, files.measured)
    origin = f"Measured by {files.measured.name}."
    camera = given_design(scene, motion, profile.shutter, origin, is_measured=True)
    return Cameras(designs | {AS_MEASURED: camera}, trace, profile)
