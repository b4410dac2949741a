"""The command that hands a design to the electronics: `export`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mishutter._core import writable_folder
from mishutter.cli.console import note, print_table, print_text, start_jax, working, write_json
from mishutter.cli.options import JsonOption, OutOption, as_path

if TYPE_CHECKING:
    from mishutter.design import DriveTable


def export(
    design: Annotated[
        Path, typer.Argument(metavar="DESIGN.json", parser=as_path, help="Saved design.")
    ],
    out: OutOption = None,
    json: JsonOption = False,
    num_steps: Annotated[
        int, typer.Option("--steps", min=1, max=100_000, help="Equal steps of the exposure.")
    ] = 256,
    num_levels: Annotated[
        int, typer.Option("--levels", min=2, max=1 << 24, help="Drive levels.")
    ] = 256,
    floor: Annotated[
        float, typer.Option("--floor", help="Transmittance of the lowest level.")
    ] = 0.0,
    ceiling: Annotated[
        float, typer.Option("--ceiling", help="Transmittance of the highest level.")
    ] = 1.0,
) -> None:
    """Drive table of a saved design: the level of each step, and what is lost by it."""
    start_jax()
    from mishutter.design import Design, drive_table

    saved = Design.load(design)
    folder = None if out is None else writable_folder(out)
    table = drive_table(
        saved,
        num_steps=num_steps,
        num_levels=num_levels,
        floor=floor,
        ceiling=ceiling,
    )
    files = [] if folder is None else _write(table, folder)
    if folder is None and not json:
        print_text(table.to_csv().rstrip("\n"))
        return
    with working("measuring the shutter as driven"):
        document = table.to_dict() | {"files": files}
    if json:
        write_json(document)
    else:
        _print_losses(document)
    if files:
        note(f"{folder}: {', '.join(files)}")


def _write(table: "DriveTable", folder: Path) -> list[str]:
    from mishutter.report import plot_drive, save_figure

    table.save(folder / "drive.csv")
    save_figure(plot_drive(table), folder / "drive.png")
    return ["drive.csv", "drive.png"]


def _print_losses(document: dict[str, Any]) -> None:
    wanted, driven = document["metrics_of_design"], document["metrics"]
    rows = [
        [name, f"{wanted[field]:.4g}", f"{driven[field]:.4g}"]
        for name, field in (
            ("expected PSNR / dB", "expected_psnr"),
            ("condition number", "condition_number"),
            ("relative kernel difference", "relative_kernel_difference"),
            ("efficiency", "efficiency"),
        )
    ]
    title = f"{len(document['level'])} steps, {document['num_levels']} levels"
    print_table(title, ["figure", "design", "as driven"], rows)
