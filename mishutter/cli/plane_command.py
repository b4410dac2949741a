"""The part of `optimise` for things that move in any direction."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from mishutter._core.checks import Unquoted, require
from mishutter._core.progress import progress_bar
from mishutter.cli.console import AGAIN, interruptible

if TYPE_CHECKING:
    from mishutter.model.scene import Scene
    from mishutter.report.documents import Report


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


def optimised_in_plane(scene: "Scene") -> "Report":
    """Searches for frames, and compares them."""
    from mishutter.report.documents import Report
    from mishutter.report.in_plane import compare_in_plane

    _require_frames(scene)
    with (
        interruptible(lambda: AGAIN),
        progress_bar("frames in the plane", 1, "compiling (first run only)") as counter,
    ):
        work = "ways of the stage"
        counter.next(work)
        result = compare_in_plane(scene, progress=lambda share: counter.within(work, share))
    return Report(scene, result, ())
