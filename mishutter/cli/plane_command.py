"""The part of `optimise` for things that move in any direction."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from mishutter._core.checks import Unquoted, require
from mishutter._core.files import RECOMMENDED, writable_folder
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


def _require_frames(scene: "Scene") -> None:
    """Refuses a camera without time for the two frames that tell a velocity."""
    from mishutter.evaluation.bursts import FrameTimes

    if scene.decoder_speed == "known":
        return
    burst, tell = scene.burst, "things in any direction: two frames tell a velocity"
    if burst is None:
        require(False, "[burst]", f"be given for {tell}", Unquoted("nothing"))
        return
    is_several = burst.max_frames is None or burst.max_frames > 1
    require(is_several, "[burst] max_frames", f"be at least 2 for {tell}", burst.max_frames)
    times = FrameTimes.of(scene, burst)
    least = 1e3 * (times.period + times.shortest)
    requirement = (
        f"be at least {least:.4g}, in which {float(burst.frames_per_s):g} frames/s make two"
    )
    got = Unquoted(f"{1e3 * times.window:.4g}")
    require(times.holds_several, "[burst] window_ms", requirement, got)


def optimise_in_plane(
    scene: "Scene", scene_file: Path | None, out: Path | None, *, as_json: bool
) -> None:
    """Searches for frames, prints the answer, and writes its files."""
    from mishutter.report.in_plane import PlaneReport, write_plane_report
    from mishutter.search.plane_frames import best_in_plane

    _require_frames(scene)
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
            print_text(f"Next: {next_step(scene_file, folder, RECOMMENDED)}")
    files = []
    if folder is not None:
        files = write_plane_report(
            report, folder, wrote=lambda name: note(f"wrote {folder / name}")
        )
    if as_json:
        write_json(report.to_dict() | {"files": files})
