"""The command `restore`: captures that a real camera has taken."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mishutter._core import Unquoted, note, progress_bar, require, writable_folder
from mishutter.cli.camera import DecoderName, estimate_document, named_decoder, speed_found
from mishutter.cli.console import AGAIN, interruptible, print_table, start_jax, write_json
from mishutter.cli.help import DESIGN, OUTPUT, PICTURES
from mishutter.cli.laboratory import (
    CameraFiles,
    cameras,
    takes_camera_files,
)
from mishutter.cli.options import JsonOption, as_path, scene_of

if TYPE_CHECKING:
    import numpy as np

    from mishutter.design import Design
    from mishutter.model import FrameSequence

_TICKS = 100
_MOST_ABOVE_WHITE = 0.01
"""Share of a restored picture that may be brighter than white without a word."""


@takes_camera_files
def restore(
    captures: Annotated[
        list[Path],
        typer.Argument(
            metavar="CAPTURE",
            parser=as_path,
            help="Captures: PNG, JPEG, TIFF, BMP, WebP, PGM or PPM.",
            show_default=False,
        ),
    ],
    *,
    design: Annotated[
        Path | None,
        typer.Option(
            "--design",
            metavar="FILE",
            parser=as_path,
            rich_help_panel=DESIGN,
            help="Saved design that the camera was built by; its scene is taken without --scene.",
        ),
    ] = None,
    scene_file: Annotated[
        Path | None,
        typer.Option(
            "--scene",
            metavar="SCENE.toml",
            parser=as_path,
            rich_help_panel=DESIGN,
            help="Scene of the captures [default: the design's].",
        ),
    ] = None,
    shutter: Annotated[
        str | None,
        typer.Option(
            "--shutter",
            metavar="NAME[:VALUE]",
            rich_help_panel=DESIGN,
            help="Shutter of the scene's own motion, without --design.",
        ),
    ] = None,
    files: CameraFiles,
    white: Annotated[
        float | None,
        typer.Option(
            "--white",
            metavar="VALUE",
            rich_help_panel=PICTURES,
            help="Number in the file of white, were the shutter open for the whole exposure, of a "
            "burst in its longest frame [default: the greatest number of its bit depth].",
        ),
    ] = None,
    linear: Annotated[
        bool,
        typer.Option(
            "--linear",
            rich_help_panel=PICTURES,
            help="Read the file's numbers as linear light, as of raw files, not as gamma-coded.",
        ),
    ] = False,
    decoder: Annotated[
        DecoderName,
        typer.Option(
            "--decoder",
            metavar="NAME",
            rich_help_panel=PICTURES,
            help="Decoder: ensemble, wiener, richardson-lucy, tikhonov, total-variation or "
            "speed-finding; where the scene's decoder finds or knows the speed, it is found first.",
        ),
    ] = DecoderName.ENSEMBLE,
    speed_text: Annotated[
        str | None,
        typer.Option(
            "--speed",
            metavar="SPEED",
            rich_help_panel=PICTURES,
            help="Speed of all that is seen, where it is known: px/s, or with a unit of --scene, "
            "such as 0.9m/s.",
        ),
    ] = None,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            metavar="DIR",
            parser=as_path,
            rich_help_panel=OUTPUT,
            help="Folder for the pictures.",
        ),
    ] = Path("restored"),
    json: JsonOption = False,
) -> None:
    """Restore captures that a camera has taken, each by itself.

    Of a design that takes a burst, the captures are its frames, in their order, which together
    become one picture.
    """
    start_jax()
    from mishutter.decoding import restored_capture
    from mishutter.model import read_speed
    from mishutter.pictures import read_capture, write_picture
    from mishutter.report import camera_text, plot_capture, save_figure, shown_name

    stems = [path.stem for path in captures]
    require(len(set(stems)) == len(stems), "CAPTURE", "be of different names", stems)
    camera = _camera(scene_file, design, files, shutter)
    speed = None if speed_text is None else read_speed(speed_text, scene_file, "--speed")
    seen = {path: read_capture(path, white=white, linear=linear) for path in captures}
    folder, method = writable_folder(out), named_decoder(decoder)
    written, found = [], {}
    for path, capture in _together(seen, camera.sequence).items():
        with (
            interruptible(lambda: AGAIN),
            progress_bar(f"restoring {path.name}", _TICKS) as update,
        ):
            result = restored_capture(
                capture,
                camera,
                decoder=method,
                speed=speed,
                progress=lambda text, share, update=update: update(int(share * _TICKS), text),
            )
        _note_brightness(path, result.light)
        is_one = len(seen) == 1 or camera.sequence is not None
        stem = "" if is_one else f"{path.stem}_"
        write_picture(folder / f"{stem}restored.png", result.light)
        figure = plot_capture(
            None,
            {each.stem: seen[each] for each in (seen if is_one else [path])},
            result.light,
            camera=f"{shown_name(path.name)}: {camera_text(camera)}",
            decoder=f"by the {decoder.value} decoder",
        )
        save_figure(figure, folder / f"{stem}side_by_side.png")
        written += [f"{stem}restored.png", f"{stem}side_by_side.png"]
        found[path.name] = result.found
        if result.found is not None and result.found.doubt:
            note(f"warning: {path}: {result.found.doubt}")
    if json:
        speeds = {
            name: None if each is None else estimate_document(each) for name, each in found.items()
        }
        write_json({"decoder": decoder.value, "files": written, "found": speeds})
    else:
        rows = [
            [name, *speed_found(each, camera.sequence)]
            for name, each in found.items()
            if each is not None
        ]
        if rows:
            print_table("Speed found", ["capture", "px/s", ""], rows)
    note(f"{folder}: {', '.join(written)}")


def _together(
    seen: "dict[Path, np.ndarray]", sequence: "FrameSequence | None"
) -> "dict[Path, np.ndarray]":
    """Captures by themselves, or the frames of a burst as one, by the name of the first.

    A camera of one gain records a frame in the units of white in the longest.
    """
    import numpy as np

    if sequence is None:
        return seen
    got = Unquoted(f"{len(seen)}")
    is_whole = len(seen) == sequence.num_frames
    require(is_whole, "CAPTURE", f"be the {sequence.num_frames} frames of the burst", got)
    first, sizes = next(iter(seen)), {path: each.shape for path, each in seen.items()}
    for path, size in sizes.items():
        require(size == sizes[first], str(path), f"be as large as {first.name}", size)
    lights = zip(sequence.lights, seen.values(), strict=True)
    return {first: np.stack([capture / one for one, capture in lights])}


def _camera(
    scene_file: Path | None, design: Path | None, files: CameraFiles, shutter: str | None
) -> "Design":
    """The camera as measured, driven or designed, whichever was last; or a named shutter."""
    from mishutter.design import given_design
    from mishutter.model import named_shutter

    scene = None if scene_file is None else scene_of(scene_file)
    built = [*cameras(scene, design, files).designs.values()]
    if built:
        require(shutter is None, "--shutter", "be left out where files give the shutter", shutter)
        return built[-1]
    if scene is None or shutter is None:
        raise ValueError("`--design, --drive, --measured or --shutter` must be given; got None.")
    return given_design(scene, scene.motion, named_shutter(shutter), f"Given: {shutter}.")


def _note_brightness(path: Path, light: "np.ndarray") -> None:
    """Notes a picture that is brighter than white: its file's white is that of another exposure."""
    share = float((light > 1).mean())
    if share > _MOST_ABOVE_WHITE:
        note(
            f"warning: {path}: {share:.0%} of the restored picture is brighter than white; "
            "`--white` is the file's number of white in an exposure with the shutter open"
        )
