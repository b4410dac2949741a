"""The part of `optimise` for things that move in any direction."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from mishutter._core.checks import Unquoted, require
from mishutter._core.files import writable_folder
from mishutter._core.progress import note, progress_bar
from mishutter.cli.console import (
    AGAIN,
    closable_output,
    interruptible,
    next_step,
    print_text,
    write_json,
)

if TYPE_CHECKING:
    from mishutter.model.scene import Scene


def refuse_in_plane(options: Mapping[str, object]) -> None:
    """Refuses options of searches along one axis."""
    for name, value in options.items():
        requirement = "be left out for things that move in any direction"
        require(not value, name, requirement, Unquoted("it"))


def optimise_in_plane(
    scene: "Scene", scene_file: Path | None, out: Path | None, *, as_json: bool
) -> None:
    """Searches for frames, prints the answer, and writes its files."""
    from mishutter.plane.search import best_in_plane
    from mishutter.report.in_plane import PlaneReport, write_plane_report

    folder = None if out is None else writable_folder(out)
    with (
        interruptible(lambda: AGAIN),
        progress_bar("frames in the plane", 1, "compiling (first run only)") as counter,
    ):
        work = "ways of the stage"
        counter.next(work)
        search = best_in_plane(scene, progress=lambda share: counter.within(work, share))
    report = PlaneReport(scene, search)
    if not as_json:
        with closable_output():
            print_text(report.text())
            print_text(f"Next: {next_step(scene_file, folder)}")
    files = []
    if folder is not None:
        files = write_plane_report(
            report, folder, wrote=lambda name: note(f"wrote {folder / name}")
        )
    if as_json:
        write_json(report.to_dict() | {"files": files})
