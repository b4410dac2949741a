"""The command that lists the parts of a computation: `plan`."""

from typing import TYPE_CHECKING, Annotated, Any

from mishutter._core.progress import working
from mishutter.cli.console import print_table, print_text, start_jax, write_json
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
    option,
    scene_of,
)

if TYPE_CHECKING:
    from mishutter.evaluation.losses import AbstractLoss
    from mishutter.model.scene import Scene
    from mishutter.search.planning import SearchPlan


def plan(
    scene_file: SceneArgument = None,
    *,
    json: JsonOption = False,
    loss: LossOption = None,
    free: FreeOption = None,
    fixed: Annotated[
        bool, option(MOVES, "--fixed", "Plan a single evaluation instead of a search.")
    ] = False,
    num_coefficients: CoefficientsOption = 24,
) -> None:
    """Show a scene in pixels and seconds, and which parts of a search are computed or skipped."""
    if fixed and free:
        parts = ", ".join(name.value for name in free)
        raise ValueError(f"`--free` must be left out with --fixed; got '{parts}'.")
    start_jax()
    scene = scene_of(scene_file)
    if scene.velocities is not None:
        from mishutter.search.plane_frames import search_words

        text = search_words(scene)
        search: dict[str, Any] = {"search": text}
    else:
        chosen = loss_of(loss, scene)
        with working("planning"):
            parts = plan_of_search(scene, chosen, free, num_coefficients, fixed=fixed)
        search, text = {"skipped": parts.skips} | vars(parts.sizes), plan_text(parts)
    if json:
        write_json({"scene": understood(scene)} | search)
    else:
        print_table("The scene as understood", ("key", "value"), understood_rows(scene))
        print_text(f"\n{text}")


def understood(scene: "Scene") -> dict[str, object]:
    """A scene in pixels, seconds and electrons, whatever the units of its file."""
    from mishutter.model.scene import scene_tables

    tables = scene_tables(scene)
    sections = (tables[name] for name in ("light", "sensor", "limits"))
    speeds: dict[str, object] = {"speeds_px_per_s": scene.speeds.tolist()}
    if scene.velocities is not None:
        speeds = {"velocities": scene.velocities.words}
    return speeds | {key: value for section in sections for key, value in section.items()}


def understood_rows(scene: "Scene") -> list[list[str]]:
    """The rows of a table of the `understood` scene, in which two ends stand for all speeds."""
    rows = understood(scene)
    if scene.velocities is None:
        speeds = scene.speeds.tolist()
        ends = dict.fromkeys((min(speeds), max(speeds)))
        between = " to ".join(f"{speed:,.5g}" for speed in ends)
        del rows["speeds_px_per_s"]
        rows = {f"{len(speeds)} speeds_px_per_s": between} | rows
    return [[key, f"{x:,.5g}" if isinstance(x, float) else f"{x}"] for key, x in rows.items()]


def plan_of_search(
    scene: "Scene",
    loss: "AbstractLoss",
    free: list[FreeName] | None,
    num_coefficients: int,
    *,
    fixed: bool = False,
) -> "SearchPlan":
    """The plan of the first search of `optimise`, or of one measurement if all is fixed."""
    from mishutter.search.planning import plan as planned
    from mishutter.search.search import moved_by_default, starting_shutter

    motion, names, start = scene.motion, names_of(free), starting_shutter(scene, num_coefficients)
    if names is None:
        motion, names = moved_by_default(scene, None, start, loss)
    return planned(scene, motion, start, loss=loss, free=() if fixed else names)


def plan_text(parts: "SearchPlan") -> str:
    """The parts that a plan skips and why, and a bound on the changes by it."""
    return "\n".join([*parts.skips, "Together these skips change nothing beyond rounding."])
