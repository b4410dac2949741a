"""The command `plan`: what a scene needs computed."""

from typing import TYPE_CHECKING, Annotated

import typer

from mishutter.cli.console import folded, print_text, start_jax, working, write_json
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
        bool, typer.Option("--fixed", help="Nothing may move: the plan of one measurement.")
    ] = False,
    num_coefficients: CoefficientsOption = 24,
) -> None:
    """Show what a search for this scene computes, what it skips and why."""
    if fixed and free:
        given = ", ".join(name.value for name in free)
        raise ValueError(f"`--free` must be left out with --fixed; got '{given}'.")
    start_jax()
    scene = scene_of(scene_file)
    chosen = loss_of(loss, scene)
    with working("planning"):
        found = plan_of_search(scene, chosen, free, num_coefficients, fixed=fixed)
    if json:
        write_json(found.to_dict())
    else:
        print_text(plan_text(found))


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
