"""The command `restore`: captures that a real camera has taken."""

import itertools
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from mishutter._core.checks import Unquoted, require
from mishutter._core.files import writable_folder
from mishutter._core.progress import note, progress_bar
from mishutter.cli.camera import (
    NUM_TICKS,
    WHY_RESTORING,
    estimate_document,
    objects_document,
    print_objects,
    speed_found,
)
from mishutter.cli.console import AGAIN, interruptible, print_table, start_jax, write_json
from mishutter.cli.help import CAMERA, DESIGN, PICTURES
from mishutter.cli.laboratory import (
    CameraFiles,
    cameras,
    speed_for,
    takes_camera_files,
    warn_beyond,
)
from mishutter.cli.options import (
    DECODERS,
    DecoderName,
    JsonOption,
    PicturesOutOption,
    as_path,
    design_option,
    named_decoder,
    option,
    path_option,
    scene_of,
)

if TYPE_CHECKING:
    import numpy as np

    from mishutter.decoding.restoration import Estimate
    from mishutter.design.design import Design
    from mishutter.hardware.recorded_paths import PathDifference
    from mishutter.model.exposures import Exposures
    from mishutter.model.scene import Scene
    from mishutter.pictures.images import Capture


@takes_camera_files
def restore(
    captures: Annotated[
        list[Path],
        typer.Argument(
            metavar="CAPTURE",
            parser=as_path,
            help="Captures as PNG, JPEG, TIFF, BMP, WebP, PGM or PPM, or a folder of them, in the "
            "order of the numbers in their names; each page of a TIFF is one capture.",
            show_default=False,
        ),
    ],
    *,
    design: Annotated[
        Path | None,
        design_option(
            DESIGN,
            "--design FILE",
            "Saved design by which the camera was built. Its scene is used unless --scene is "
            "given.",
        ),
    ] = None,
    scene_file: Annotated[
        Path | None,
        path_option(DESIGN, "--scene SCENE.toml", "Scene of the captures [default: the design's]."),
    ] = None,
    shutter: Annotated[
        str | None,
        option(
            DESIGN,
            "--shutter NAME[:VALUE]",
            "Shutter to use with the scene's motion, without --design.",
        ),
    ] = None,
    files: CameraFiles,
    stage_path: Annotated[
        Path | None,
        path_option(
            CAMERA,
            "--stage-path FILE",
            "Path that an encoder recorded, in place of the planned one: text with columns "
            "`time (ms)` and `x (um)`, and `y (um)` of two axes, in any such units, px, or those "
            "of --stage-scale-px. "
            "--mid-exposure-ms is the reading of its clock at the middle of the burst.",
        ),
    ] = None,
    stage_scale: Annotated[
        float | None,
        option(
            CAMERA,
            "--stage-scale-px PX",
            "Pixels that a place of 1 in --stage-path is, for an encoder in counts or volts; below "
            "0 where it counts backwards.",
        ),
    ] = None,
    black: Annotated[
        float,
        option(
            PICTURES,
            "--black VALUE",
            "Value of black in the file: the offset that the camera adds to every pixel.",
        ),
    ] = 0.0,
    white: Annotated[
        float | None,
        option(
            PICTURES,
            "--white VALUE",
            "Value of white in the file with the shutter open for the whole exposure; for a "
            "burst, in its longest frame [default: the largest value of its bit depth].",
        ),
    ] = None,
    linear: Annotated[
        bool,
        option(
            PICTURES,
            "--linear",
            "Read the file's values as linear light, as in raw files, not as gamma-coded.",
        ),
    ] = False,
    decoder: Annotated[
        DecoderName,
        option(
            PICTURES,
            "--decoder NAME",
            f"Decoder: {DECODERS}. If the scene's decoder finds or knows the speed, the speed is "
            "found first.",
        ),
    ] = DecoderName.ENSEMBLE,
    speed_text: Annotated[
        list[str] | None,
        option(
            PICTURES,
            "--speed SPEED",
            "Speed of the whole picture, if it is known: px/s, or with a unit of --scene, "
            "such as 0.9m/s. For a design in the plane its velocity, such as 1500,-800. Of objects "
            "one each: --speed 900 --speed=-400.",
        ),
    ] = None,
    objects: Annotated[
        bool,
        option(
            PICTURES,
            "--objects",
            "Restore the frames of a burst object by object before a background at rest "
            "[default: as the scene's [occlusion] or [objects] says].",
        ),
    ] = False,
    outlines: Annotated[
        Path | None,
        path_option(
            PICTURES,
            "--outlines FILE",
            "Picture of the objects' outlines at the middle of the burst, if they are known: black "
            "is the background, and each other value an object.",
        ),
    ] = None,
    out: PicturesOutOption = Path("restored"),
    json: JsonOption = False,
) -> None:
    """Restore captures of a real camera.

    Each capture is restored on its own. If the design takes a burst, the captures are its frames in
    their order, and one picture is restored from all of them. Where its scene has a background,
    objects are found in them, with their velocities, and restored one by one.
    """
    start_jax()
    from mishutter.decoding.restoration import restored_capture
    from mishutter.decoding.restored_frames import shows_objects
    from mishutter.pictures.images import read_captures, read_labels, write_picture
    from mishutter.report.objects import write_objects
    from mishutter.report.plots import camera_text, plot_capture, save_figure, shown_name

    camera, apart = _camera(scene_file, design, files, shutter), None
    if stage_path is not None:
        camera, apart = _recorded(camera, stage_path, files, stage_scale)
    else:
        requirement = "be left out without --stage-path"
        require(stage_scale is None, "--stage-scale-px", requirement, stage_scale)
    burst = camera.sequence
    each = [speed_for(camera, text, scene_file) for text in speed_text or []]
    labels_told = None if outlines is None else read_labels(outlines)
    is_by_object = (objects or len(each) > 1 or labels_told is not None) or None
    shown = burst is not None and shows_objects(camera.scene, burst.frames, is_by_object)
    if burst is not None and not shown:
        _note_whole(camera.scene)
    speed = None if not each else each if shown else each[0]
    paths = itertools.chain(*map(_files_of, captures))
    read = (read_captures(path, black=black, white=white, linear=linear) for path in paths)
    seen = list(itertools.chain(*read))
    labels = _Label.of_all(seen)
    for one in each:
        warn_beyond(camera.scene, one)
    method, folder = named_decoder(decoder, camera.scene), writable_folder(out)
    written, found, by_object = [], {}, None
    is_one = len(seen) == 1 or burst is not None
    for capture, label, light in _together(seen, labels, burst):
        names = label.name if burst is None else _names_of(labels)
        with (
            interruptible(lambda: AGAIN),
            progress_bar(f"restoring {names}", NUM_TICKS, WHY_RESTORING) as update,
        ):
            result = restored_capture(
                light,
                camera,
                decoder=method,
                speed=speed,  # type: ignore[arg-type]
                outlines=labels_told,
                by_object=is_by_object,
                progress=lambda text, share, update=update: update(int(share * NUM_TICKS), text),
            )
        _note_brightness(names, result.light)
        stem = "" if is_one else f"{label.stem}_"
        write_picture(folder / f"{stem}restored.png", result.light)
        written.append(f"{stem}restored.png")
        if capture.is_tiff:
            capture.write_like(folder / f"{stem}restored.tif", result.light)
            written.append(f"{stem}restored.tif")
        figure = plot_capture(
            None,
            {
                each.stem: one.light
                for each, one in (zip(labels, seen, strict=True) if is_one else [(label, capture)])
            },
            result.light,
            camera=f"{shown_name(names)}: {camera_text(camera)}",
            decoder=f"by the {decoder.value} decoder",
        )
        save_figure(figure, folder / f"{stem}side_by_side.png")
        written.append(f"{stem}side_by_side.png")
        written += write_objects(folder, result.by_object)
        by_object = result.by_object
        found[label.name] = result.found
        if result.found is not None:
            if result.found.doubt:
                note(f"warning: {names}: {result.found.doubt}")
            _note_shutter(camera.scene, result.found)
    if json:
        speeds = {
            name: None if each is None else estimate_document(each) for name, each in found.items()
        }
        path = {} if apart is None else {"path": apart._asdict()}
        document = {"decoder": decoder.value, "files": written, "found": speeds}
        write_json(document | path | objects_document(by_object))
    else:
        rows = [
            [
                name if burst is None else _names_of(labels),
                *speed_found(each, in_burst=burst is not None),
            ]
            for name, each in found.items()
            if each is not None
        ]
        if rows:
            title = "Speed found" if speed is None else "Speed"
            print_table(title, ["capture" if burst is None else "frames", "px/s", ""], rows)
        print_objects(by_object)
    note(f"{folder}: {', '.join(written)}")


def _recorded(
    camera: "Design", stage_path: Path, files: CameraFiles, scale: float | None
) -> "tuple[Design, PathDifference]":
    """A camera whose stage was where an encoder recorded it; notes how far that is off."""
    from mishutter.hardware.recorded_paths import read_path, with_recorded_path
    from mishutter.hardware.stage_files import pitch_of

    num_axes = len(camera.exposures.axes)
    pitch = pitch_of(camera.scene)
    path = read_path(stage_path, num_axes=num_axes, pixel_pitch=pitch, scale=scale)
    middle = files.middle_ms * 1e-3
    recorded, apart = with_recorded_path(camera, path, middle=middle, name=str(stage_path))
    note(f"the recorded path is {apart.text} from the planned one, wherever the whole stands")
    if apart.doubt:
        note(f"warning: {stage_path}: {apart.doubt}")
    return recorded, apart


class _Label(NamedTuple):
    """The name of a capture in messages, and in names of files."""

    name: str
    stem: str

    @staticmethod
    def of_all(seen: "list[Capture]") -> "list[_Label]":
        """Labels of captures, with those of their folders where files have the same name."""
        stems = [capture.stem for capture in seen]
        if len(set(stems)) == len(stems):
            return [_Label(capture.name, capture.stem) for capture in seen]
        folders = [capture.path.resolve().parent.name for capture in seen]
        labels = [
            _Label(f"{folder}/{capture.name}", f"{folder}_{capture.stem}")
            for folder, capture in zip(folders, seen, strict=True)
        ]
        names = [label.name for label in labels]
        require(len(set(labels)) == len(labels), "CAPTURE", "be of different names", names)
        return labels


def _files_of(path: Path) -> list[Path]:
    """A file, or the pictures of a folder."""
    from mishutter.pictures.files import PICTURE_FORMATS, pictures_in

    if not path.is_dir():
        return [path]
    files = pictures_in(path)
    require(bool(files), "CAPTURE", f"be a folder with pictures as {PICTURE_FORMATS}", str(path))
    return files


def _names_of(labels: list[_Label]) -> str:
    """The frames of a burst in words: the first and the last."""
    names = [label.name for label in labels]
    return names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"


def _together(
    seen: "list[Capture]", labels: list[_Label], burst: "Exposures | None"
) -> "list[tuple[Capture, _Label, np.ndarray]]":
    """Light of captures by themselves, or of the frames of a burst beside the first of them."""
    import numpy as np

    if burst is None:
        return [(one, label, one.light) for one, label in zip(seen, labels, strict=True)]
    got = Unquoted(f"{len(seen)}")
    is_whole = len(seen) == burst.num_frames
    require(is_whole, "CAPTURE", f"be the {burst.num_frames} frames of the burst", got)
    first, size = labels[0].name, seen[0].light.shape
    for each, label in zip(seen, labels, strict=True):
        shape = each.light.shape
        require(shape[:2] == size[:2], label.name, f"be as large as {first}", shape[:2])
        colours = Unquoted(f"{shape[2]} beside {size[2]}")
        require(shape == size, label.name, f"have as many colours as {first}", colours)
    light = np.stack(burst.of_own_whites(each.light for each in seen))
    _note_frames(labels, light)
    return [(seen[0], labels[0], light)]


def _note_frames(labels: list[_Label], light: "np.ndarray") -> None:
    """Notes what shows that frames are not those of the burst, or are read in another way."""
    import numpy as np

    numbers = [[*map(int, re.findall(r"\d+", each.stem))] for each in labels]
    if len({*map(len, numbers)}) == 1 and numbers != sorted(numbers):
        names = ", ".join(each.stem for each in labels)
        note(f"warning: frames whose names are out of order are used in the order given: {names}")
    means = np.maximum(light.mean(axis=(1, 2, 3)), 1e-6)
    dark, bright = int(np.argmin(means)), int(np.argmax(means))
    ratio = float(means[bright] / means[dark])
    if ratio > 1.6:  # more than what enters and leaves brings
        note(
            f"warning: by their exposures {labels[bright].name} is {ratio:.2g} times as bright as "
            f"{labels[dark].name}: check the order and the exposures, or give `--black`, `--white` "
            "or `--linear`"
        )


def _camera(
    scene_file: Path | None, design: Path | None, files: CameraFiles, shutter: str | None
) -> "Design":
    """The camera as measured, driven or designed, whichever was last; or a named shutter."""
    scene = None if scene_file is None else scene_of(scene_file)
    if any((design, files.drive, files.measured)):
        require(shutter is None, "--shutter", "be left out where files give the shutter", shutter)
    elif scene is not None and shutter is None:
        raise ValueError("`--design, --drive, --measured or --shutter` must be given; got None.")
    return [*cameras(scene, design, files, window=shutter).designs.values()][-1]


def _note_shutter(scene: "Scene", found: "Estimate") -> None:
    """Notes that rows are taken to be exposed together, where their delay would change the speed.

    Frames at rest cannot show it: with rows read one after another they are those of another speed.
    """
    import numpy as np

    from mishutter.decoding.frame_velocity import VelocityEstimate

    in_plane = isinstance(found, VelocityEstimate)
    if scene.sensor.readout is not None or not (in_plane or scene.sensor.axis == "columns"):
        return
    along = found.velocity[1] if isinstance(found, VelocityEstimate) else found.speed
    off = abs(found.speed * float(np.asarray(along))) * 1e-5
    if off >= 0.05:
        what = "velocity" if in_plane else "speed"
        note(
            f"assumes a global shutter: each 10 us from row to row would change the {what} by "
            f"{off:.2g} px/s; `[sensor] readout_ms` tells it"
        )


def _note_whole(scene: "Scene") -> None:
    """Notes that one speed restores one of the things that a scene has before its background."""
    if scene.occlusion is not None:
        note(
            "warning: all of the frames is restored at one speed, what moves at another is not; "
            "things are found before a background at rest, as --objects takes it to be"
        )


def _note_brightness(name: str, light: "np.ndarray") -> None:
    """Notes a picture that is brighter than white: its file's white is that of another exposure."""
    share = float((light > 1).mean())
    if share > 0.01:
        note(
            f"warning: {name}: {share:.0%} of the restored picture is brighter than white; "
            "`--white` is the value of white in the file with the shutter open all the time"
        )
