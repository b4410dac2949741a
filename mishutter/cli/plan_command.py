"""The command `plan`: what a scene needs computed."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from mishutter.cli.console import folded, print_table, print_text, start_jax, working, write_json
from mishutter.cli.help import MOVES
from mishutter.cli.options import (
    CoefficientsOption,
    FreeName,
    FreeOption,
    JsonOption,
    LossOption,
    SceneArgument,
    loss_of,
    names_of,
    scene_of,
)

if TYPE_CHECKING:
    from mishutter.evaluation import AbstractLoss, Plan
    from mishutter.model import Scene


def plan(
    scene_file: SceneArgument = None,
    json: JsonOption = False,
    loss: LossOption = None,
    free: FreeOption = None,
    fixed: Annotated[
        bool,
        typer.Option(
            "--fixed",
            rich_help_panel=MOVES,
            help="Nothing may move: the plan of one measurement.",
        ),
    ] = False,
    num_coefficients: CoefficientsOption = 24,
) -> None:
    """Show how a scene is understood, what a search for it computes, and what it skips and why."""
    if fixed and free:
        given = ", ".join(name.value for name in free)
        raise ValueError(f"`--free` must be left out with --fixed; got '{given}'.")
    start_jax()
    scene = scene_of(scene_file)
    chosen = loss_of(loss, scene)
    with working("planning"):
        found = plan_of_search(scene, chosen, free, num_coefficients, fixed=fixed)
    if json:
        write_json({"scene": understood(scene)} | found.to_dict())
    else:
        print_table("The scene, as it is understood", ("key", "value"), understood_rows(scene))
        print_text()
        print_text(plan_text(found))


def understood(scene: "Scene") -> dict[str, Any]:
    """A scene in pixels, seconds and electrons, whatever the units of its file."""
    limits = scene.limits
    numbers = {
        "speeds_px_per_s": scene.speeds.tolist(),
        "photon_rate_per_s": float(scene.photon_rate),
        "read_noise_e": float(scene.read_noise),
        "axis": scene.axis,
        "max_stroke_px": float(limits.max_stroke),
        "max_top_speed_px_per_s": float(limits.max_top_speed),
        "max_pan_px_per_s": float(limits.max_pan),
    }
    others = {
        "full_well_e": scene.full_well,
        "max_travel_px": limits.max_travel,
        "max_acceleration_px_per_s2": limits.max_acceleration,
        "max_jerk_px_per_s3": limits.max_jerk,
    }
    return numbers | {key: float(value) for key, value in others.items() if value is not None}


def understood_rows(scene: "Scene") -> list[list[str]]:
    """The rows of a table of what is `understood`."""
    rows = understood(scene)
    speeds = rows.pop("speeds_px_per_s")
    between = " to ".join(f"{speed:,.5g}" for speed in dict.fromkeys((min(speeds), max(speeds))))
    shown = {key: x if isinstance(x, str) else f"{x:,.5g}" for key, x in rows.items()}
    return [[f"{len(speeds)} speeds_px_per_s", between], *([key, x] for key, x in shown.items())]


def plan_of_search(
    scene: "Scene",
    loss: "AbstractLoss",
    free: list[FreeName] | None,
    num_coefficients: int,
    *,
    fixed: bool = False,
) -> "Plan":
    """The plan of what `optimise` searches first, or of one measurement where all is fixed."""
    from mishutter.search import moved_by_default, starting_shutter
    from mishutter.search import plan as planned

    motion, names, start = scene.motion, names_of(free), starting_shutter(scene, num_coefficients)
    if names is None:
        motion, names = moved_by_default(scene, None, start, loss)
    return planned(scene, motion, start, loss=loss, free=() if fixed else names)


def plan_text(found: "Plan") -> str:
    """The table of a plan, its reasons folded, and what all of it may change."""
    header, *rows = str(found).splitlines()
    lines = [folded(line, header.index("why")) for line in (header, *rows)]
    return "\n".join([*lines, "All together change nothing beyond rounding."])
