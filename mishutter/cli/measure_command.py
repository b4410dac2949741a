"""The command that makes a scene file from a clip: `measure`."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from mishutter._core.checks import require
from mishutter._core.files import writable_folder
from mishutter._core.progress import note
from mishutter.cli.console import print_table, print_text, write_json
from mishutter.cli.help import CAMERA, OUTPUT, PICTURES
from mishutter.cli.options import JsonOption, as_path, option, path_option
from mishutter.model.sensor import RowsRead

if TYPE_CHECKING:
    from mishutter.measurement.scene import Measurement


def measure(
    clip: Annotated[
        list[Path],
        typer.Argument(
            metavar="CLIP",
            parser=as_path,
            help="Frames of a camera at rest: uncompressed PNG, TIFF (each page), PGM or .npy "
            "files, or a folder of them, in the order of their numbers.",
            show_default=False,
        ),
    ],
    *,
    frames_per_s: Annotated[float, option(CAMERA, "--frames-per-s F", "Frame rate of the clip.")],
    exposure_ms: Annotated[
        float | None,
        option(
            CAMERA,
            "--exposure-ms T",
            "Exposure of each frame. Without it the photon rate is a lower limit.",
        ),
    ] = None,
    dark: Annotated[
        list[Path] | None,
        path_option(
            CAMERA,
            "--dark DARK",
            "Dark frame, with the lens covered and the same settings; repeat for more. Two or"
            " more determine the read noise; without any it is an interval.",
        ),
    ] = None,
    flat: Annotated[
        list[Path] | None,
        path_option(
            CAMERA,
            "--flat FLAT",
            "Flat fields in pairs of equal exposure, as in EMVA 1288; repeat for more.",
        ),
    ] = None,
    black: Annotated[
        float | None,
        option(PICTURES, "--black LEVEL", "Black level, if it is known without --dark."),
    ] = None,
    white: Annotated[
        float | None,
        option(
            PICTURES,
            "--white LEVEL",
            "White level [default: the largest value of the files' bit depth].",
        ),
    ] = None,
    pixel_pitch_um: Annotated[
        float | None, option(CAMERA, "--pixel-pitch-um P", "Pixel pitch of the sensor.")
    ] = None,
    px_per_mm: Annotated[
        float | None,
        option(
            CAMERA,
            "--px-per-mm M",
            "Pixels per millimetre of the scene, by a ruler in the picture.",
        ),
    ] = None,
    readout_ms: Annotated[
        float | None,
        option(
            CAMERA,
            "--readout-ms R",
            "Time from the first row to the last of a sensor whose rows are exposed one after "
            "another.",
        ),
    ] = None,
    rows_read: Annotated[
        str, option(CAMERA, "--rows-read WAY", "Whether its rows are read down or up.")
    ] = "down",
    out: Annotated[
        Path,
        path_option(
            OUTPUT,
            "--out SCENE.toml",
            "Scene file to write, with its picture, the velocities and two plots beside it.",
        ),
    ],
    json: JsonOption = False,
) -> None:
    """Measure noise, velocities and texture from a clip, and write a scene file.

    The camera must stand still, and its levels must be proportional to light. Each number comes
    with its error; one that the clip does not show is left out, with the reason and a remedy.
    """
    from mishutter.measurement.measurement import measure as measured
    from mishutter.report.measurement_plots import plot_motion, plot_noise
    from mishutter.report.plots import save_figure

    is_way = rows_read in get_args(RowsRead)
    require(is_way, "--rows-read", "be 'down' or 'up'", rows_read)
    require(out.suffix.lower() == ".toml", "--out", "end in `.toml`", str(out))
    folder = writable_folder(out.parent)
    measurement = measured(
        clip,
        frames_per_s=frames_per_s,
        exposure=None if exposure_ms is None else exposure_ms * 1e-3,
        dark=dark or None,
        flats=flat or None,
        black=black,
        white=white,
        pixel_pitch=None if pixel_pitch_um is None else pixel_pitch_um * 1e-6,
        px_per_mm=px_per_mm,
        readout=None if readout_ms is None else readout_ms * 1e-3,
        rows_read=rows_read,  # type: ignore[arg-type]
        progress=True,
    )
    files = [*measurement.save(folder / out.name), "noise.png", "motion.png"]
    save_figure(plot_noise(measurement), folder / "noise.png")
    save_figure(plot_motion(measurement), folder / "motion.png")
    if json:
        write_json(measurement.to_dict() | {"files": files})
    else:
        _print(measurement, out)
    note(f"{folder}: {', '.join(files)}")


def _print(measurement: "Measurement", out: Path) -> None:
    for sentence in measurement.sentences:
        print_text(sentence)
    columns = ["object", "right px/s", "+-", "down px/s", "+-", "area px", "residual"]
    rows = [
        [
            str(number),
            f"{each.velocity[1]:.1f}",
            f"{each.error[1]:.2g}",
            f"{each.velocity[0]:.1f}",
            f"{each.error[0]:.2g}",
            str(each.area),
            f"{each.residual:.2f}",
        ]
        for number, each in enumerate(measurement.motion.objects, 1)
    ]
    if rows:
        print_table("Moving objects", columns, rows)
    command = f"mishutter optimise {shlex.quote(str(out))}"
    if measurement.missing:
        keys = " and ".join(measurement.missing)
        print_text(f"Add {keys} to {out}: the clip does not show them. Then: {command}")
    else:
        print_text(f"Next: write the limits of your stage into {out}, then {command}")
