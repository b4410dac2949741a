"""The command `plan`: what a scene needs computed."""

from typing import TYPE_CHECKING, Annotated

import typer

from mishutter.cli.console import folded, print_text, start_jax, working, write_json
from mishutter.cli.options import (
    CoefficientsOption,
    FreeOption,
    JsonOption,
    LossName,
    LossOption,
    SceneArgument,
    loss_of,
    moved,
    scene_of,
)

if TYPE_CHECKING:
    from mishutter.evaluation import Plan


def plan(
    scene_file: SceneArgument = None,
    json: JsonOption = False,
    loss: LossOption = LossName.EXPECTED_ERROR,
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
    from mishutter.design import plan as planned
    from mishutter.design import starting_shutter

    scene = scene_of(scene_file)
    start, chosen = starting_shutter(scene, num_coefficients), loss_of(loss)
    with working("planning"):
        motion, names = moved(free, scene, start, chosen)
        found = planned(scene, motion, start, loss=chosen, free=() if fixed else names)
    if json:
        write_json(found.to_dict())
    else:
        print_text(plan_text(found))


def plan_text(found: "Plan") -> str:
    """The table of a plan, its reasons folded, and what all of it may change."""
    header, *rows = str(found).splitlines()
    lines = [folded(line, header.index("why")) for line in (header, *rows)]
    return "\n".join([*lines, "All together change nothing beyond rounding."])
